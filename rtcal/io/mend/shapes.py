"""Polygons in space and in their plane. No other module imports shapely."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.simulators import triangles
from rtcal.support.errors import MissingDependencyError
from rtcal.support.types import Array


def area_of(corners: Array) -> float:
    """Return the area of a plane polygon in m²."""
    return float(np.linalg.norm(triangles.vector_area(corners)))


def normal_of(corners: Array) -> Array:
    """Return the unit normal of a polygon; that of a point is upward."""
    area = triangles.vector_area(corners)
    size = float(np.linalg.norm(area))
    return np.asarray(area / size if size else np.array([0.0, 0.0, 1.0]))


def plane_of(corners: Array) -> tuple[Array, float]:
    """Return the normal of the plane that fits some points best, and their largest distance from it."""
    away = corners - corners.mean(axis=0)
    normal = np.linalg.svd(away, full_matrices=False)[2][-1]
    return np.asarray(normal), float(np.abs(away @ normal).max())


def extent_of(corners: Array) -> float:
    """Return the largest distance of two corners in m."""
    return float(np.linalg.norm(corners[:, np.newaxis] - corners[np.newaxis], axis=-1).max())


def axes_of(normal: Array) -> Array:
    """Return two unit vectors of the plane, (2, 3)."""
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def polygon_of(corners: Array, axes: Array) -> Any:
    """Return the polygon of corners in a plane of two axes, made valid."""
    polygon = shapely().Polygon(corners @ axes.T)
    return polygon if polygon.is_valid else polygon.buffer(0)


def polygons_of(shape: Any) -> list[Any]:
    """Return the polygons of a shape, without the points and lines at which shapes touch."""
    parts = getattr(shape, "geoms", [shape])
    return [p for p in parts if p.geom_type == "Polygon" and not p.is_empty]


def shapely() -> Any:
    """Return the library; MissingDependencyError without it."""
    try:
        import shapely
    except ImportError as error:
        raise MissingDependencyError(
            "a face is to be cut, which needs shapely: pip install 'rtcal[mesh]'"
        ) from error
    return shapely
