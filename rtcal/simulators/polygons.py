"""Convex polygons in a plane: cutting, areas, distances. What a surface's faces are divided with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.simulators.triangles import vector_area
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Plane:
    """Axes in the plane of some faces, and the rectangle that bounds them.

    ``along`` is the direction of the longest edge of their outline. ``size`` (2,) are the rectangle's
    sides in m.
    """

    along: Array
    across: Array
    middle: Array
    size: Array

    @classmethod
    def of(cls, geometry: Polyhedron, faces: Sequence[int]) -> Plane:
        """Return the plane of faces, in that of the first of which the axes lie."""
        normal = geometry.normals[faces[0]]
        edges = outline(geometry, faces)
        edges = edges - (edges @ normal)[:, np.newaxis] * normal
        longest = edges[np.argmax(np.linalg.norm(edges, axis=1))]
        along = longest / np.linalg.norm(longest)
        across = np.cross(normal, along)
        corners = np.concatenate([geometry.vertices[list(geometry.faces[i])] for i in faces])
        ends = np.array([[f(corners @ axis) for f in (np.min, np.max)] for axis in (along, across)])
        height = float(corners[0] @ normal) * normal
        middle = ends.mean(axis=1) @ np.array([along, across]) + height
        return cls(along, across, middle, ends[:, 1] - ends[:, 0])

    def half_planes(self, centre: Array, scale: float) -> list[tuple[Array, float]]:
        """Return the sides of the bounding rectangle, scaled about a point: x @ normal <= offset."""
        return [
            (sign * axis, float(sign * centre @ axis + scale * side / 2))
            for axis, side in ((self.along, self.size[0]), (self.across, self.size[1]))
            for sign in (1.0, -1.0)
        ]


def outline(geometry: Polyhedron, faces: Sequence[int]) -> Array:
    """Return the edges (n, 3) of faces that no two of them share; all, where none is left.

    A mesh divides a wall into triangles, whose diagonals are no edges of the wall.
    """
    rings = [geometry.faces[i] for i in faces]
    every = [edge for ring in rings for edge in zip(ring, [*ring[1:], ring[0]], strict=True)]
    both = set(every)
    outer = [(a, b) for a, b in every if (b, a) not in both] or every
    start, end = np.array(outer).T
    return np.asarray(geometry.vertices[end] - geometry.vertices[start])


def convex_parts(geometry: Polyhedron, face: int) -> list[Array]:
    """Return a convex face as it is, another one as its triangles."""
    corners = geometry.vertices[list(geometry.faces[face])]
    edges = np.roll(corners, -1, axis=0) - corners
    if (np.cross(edges, np.roll(edges, -1, axis=0)) @ geometry.normals[face] >= 0).all():
        return [corners]
    return list(geometry.triangles[geometry.triangle_faces == face])


def area(part: Array) -> float:
    """Return the area of a polygon in m², 0 with fewer than three corners."""
    return float(np.linalg.norm(vector_area(part))) if len(part) > 2 else 0.0


def cut(part: Array, normal: Array, offset: float) -> tuple[Array, Array]:
    """Return the pieces of a convex polygon where x @ normal is below an offset, and above."""
    height = part @ normal - offset
    height[np.abs(height) < WELD] = 0.0
    below, above = [], []
    for k in range(len(part)):
        here, h, next_, g = part[k], height[k], part[k - len(part) + 1], height[k - len(part) + 1]
        if h <= 0:
            below.append(here)
        if h >= 0:
            above.append(here)
        if h * g < 0:
            crossing = here + h / (h - g) * (next_ - here)
            below.append(crossing)
            above.append(crossing)
    return np.array(below).reshape(-1, 3), np.array(above).reshape(-1, 3)


def divided(part: Array, sides: Sequence[tuple[Array, float]]) -> tuple[Array, list[Array]]:
    """Return the piece of a convex polygon within all sides, and the pieces beyond each."""
    outside = []
    for normal, offset in sides:
        part, beyond = cut(part, normal, offset)
        if is_face(beyond):
            outside.append(beyond)
    return part, outside


def inside(part: Array, sides: Sequence[tuple[Array, float]]) -> Array:
    """Return the piece of a convex polygon within all sides."""
    return divided(part, sides)[0]


def is_face(piece: Array) -> bool:
    """Return whether a piece is wider than `WELD`, below which corners are one."""
    if len(piece) < 3:
        return False
    length = float(np.linalg.norm(np.roll(piece, -1, axis=0) - piece, axis=1).max())
    return area(piece) > 0.5 * WELD * length


def distance(point: Array, normal: Array, parts: Sequence[Array]) -> float:
    """Return a point's distance in m from the nearest of some convex polygons in one plane."""
    return min(_distance_of(point, normal, part) for part in parts)


def _distance_of(point: Array, normal: Array, part: Array) -> float:
    flat = point - ((point - part[0]) @ normal) * normal
    edges = np.roll(part, -1, axis=0) - part
    if (np.cross(edges, flat - part) @ normal >= 0).all():
        return float(np.linalg.norm(point - flat))
    share = np.sum((point - part) * edges, axis=1) / np.maximum(np.sum(edges**2, axis=1), 1e-30)
    nearest = part + np.clip(share, 0.0, 1.0)[:, np.newaxis] * edges
    return float(np.linalg.norm(point - nearest, axis=1).min())
