"""Polygons in space and in their plane, and the volume of a room whose faces do not close.

No other module imports shapely. The volume is taken by lines through what is drawn: parallel lines in
three directions cross the walls. Between its first and second crossing, its third and fourth, a line is
in the room. A line with an odd number of crossings went through a hole, and takes the mean of its
neighbours. Where holes face each other a direction is wrong and the others are not, so their spread is
the uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rtcal.simulators import triangles
from rtcal.support.lazy import library
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
    return library("a face is to be cut, which needs shapely: pip install 'rtcal[mesh]'", "shapely")


_LINES = 64
"""Lines along each side of the picture, 4096 in each direction."""
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians, so that no line lies in a wall."""
_NEIGHBOURS = 4
_GUESSED = 0.3
"""Relative standard uncertainty of the part that lines with an odd number of crossings tell."""


def volume_by_rays(polygons: Sequence[Array]) -> tuple[float, float]:
    """Return the volume in m³ that polygons (n, 3) in m enclose, and its standard uncertainty.

    >>> from rtcal.simulators import Polyhedron
    >>> box = Polyhedron.shoebox((4, 5, 3), "plaster")
    >>> open_box = [box.vertices[list(face)] for face in box.faces[:-1]]
    >>> volume, uncertainty = volume_by_rays(open_box)
    >>> bool(abs(volume - 60) < 2 * uncertainty < 2)
    True
    """
    corners = np.concatenate(
        [
            polygon[np.array(triangles.triangulate(polygon), dtype=int).reshape(-1, 3)]
            for polygon in map(np.asarray, polygons)
        ]  # a polygon without area has no triangle
    )
    if not len(corners):
        return 0.0, 0.0
    corners = corners @ _turned().T
    found = [_along(np.roll(corners, k, axis=2)) for k in range(3)]
    volumes, unknown = (np.array(column) for column in zip(*found, strict=True))
    weights = np.clip(1 - unknown, 1e-3, None) ** 4
    weights /= weights.sum()
    volume = float(weights @ volumes)
    spread = float(weights @ (volumes - volume) ** 2)
    guessed = _GUESSED * volume * float(weights @ unknown)
    return volume, float(np.sqrt(spread + guessed**2 + (volume / _LINES**1.5) ** 2))


def _turned() -> Array:
    """Return a small rotation, (3, 3)."""
    matrix = np.eye(3)
    for k, angle in enumerate(_TILT):
        i, j = (k + 1) % 3, (k + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        matrix = turn @ matrix
    return matrix


def _along(corners: Array) -> tuple[float, float]:
    """Return the volume by lines along the last axis, and the share of the lines that are unknown."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    step = (high - low)[:2] / _LINES
    if not step.all():
        return 0.0, 1.0
    middles = [low[k] + step[k] * (np.arange(_LINES) + 0.5) for k in range(2)]
    crossings: list[list[list[float]]] = [[[] for _ in range(_LINES)] for _ in range(_LINES)]
    for a, b, c in corners:
        first, second = b - a, c - a
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < 1e-12:
            continue
        ends = np.array([a, b, c])[:, :2]
        start = np.ceil((ends.min(axis=0) - low[:2]) / step - 0.5).astype(int)
        stop = np.floor((ends.max(axis=0) - low[:2]) / step - 0.5).astype(int)
        rows, columns = (
            np.arange(max(s, 0), min(e, _LINES - 1) + 1) for s, e in zip(start, stop, strict=True)
        )
        x, y = np.meshgrid(middles[0][rows] - a[0], middles[1][columns] - a[1], indexing="ij")
        u = (x * second[1] - y * second[0]) / area
        v = (first[0] * y - first[1] * x) / area
        for i, k in np.argwhere((u >= 0) & (v >= 0) & (u + v <= 1)):
            depth = a[2] + u[i, k] * first[2] + v[i, k] * second[2]
            crossings[rows[i]][columns[k]].append(float(depth))
    lengths = np.zeros((_LINES, _LINES))
    for i in range(_LINES):
        for k in range(_LINES):
            at = sorted(crossings[i][k])
            odd = len(at) % 2 == 1
            lengths[i, k] = np.nan if odd else sum(at[1::2]) - sum(at[::2])
    unknown = np.isnan(lengths)
    inside = unknown | (lengths > 0)
    if not (lengths > 0).any():
        return 0.0, 1.0
    return float(_filled(lengths).sum() * step.prod()), float(unknown.sum() / inside.sum())


def _filled(lengths: Array) -> Array:
    """Return the lengths with those of unknown lines as the mean of their known neighbours."""
    known = lengths > 0
    mean = float(lengths[known].mean())
    filled = np.nan_to_num(lengths, nan=0.0)
    for i, k in np.argwhere(np.isnan(lengths)):
        near = np.s_[
            max(i - _NEIGHBOURS, 0) : i + _NEIGHBOURS + 1,
            max(k - _NEIGHBOURS, 0) : k + _NEIGHBOURS + 1,
        ]
        beside = lengths[near][known[near]]
        filled[i, k] = beside.mean() if beside.size else mean
    return filled
