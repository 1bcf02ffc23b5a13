"""A patch on a surface: the same geometry with a part of one surface as faces of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from rtcal.errors import DataError
from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.simulators.triangles import vector_area
from rtcal.support.types import Array

LARGEST = 0.95
"""Largest share of a surface that is drawn as a patch. The rim around a larger one is narrower than
2.5 % of the surface's width."""
NEAR = 0.1
"""Largest distance in m of a stated place from its surface: how well places are measured."""
_HALVINGS = 60
"""Of the interval that holds the patch's scale: to the last digit."""

Polygon = tuple[str, str, Array]
"""Name, material and corners of a face."""


@dataclass(frozen=True, eq=False)
class _Plane:
    """Axes in the plane of some faces, and the rectangle that bounds them.

    ``along`` is the direction of the longest edge. ``size`` (2,) are the rectangle's sides in m.
    """

    along: Array
    across: Array
    middle: Array
    size: Array

    @classmethod
    def of(cls, normal: Array, parts: Sequence[Array]) -> _Plane:
        edges = np.concatenate([np.roll(p, -1, axis=0) - p for p in parts])
        longest = edges[np.argmax(np.linalg.norm(edges, axis=1))]
        along = longest / np.linalg.norm(longest)
        across = np.cross(normal, along)
        corners = np.concatenate(parts)
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


def patched(
    geometry: Polyhedron,
    faces: Iterable[int],
    area: float,
    material: str,
    name: str,
    at: Array | None = None,
) -> Polyhedron | None:
    """Return the geometry with a patch on a surface; None where the surface is too small for it.

    The patch is a rectangle in the proportions of the surface's bounding rectangle. It ends at the
    surface's edge, and is larger elsewhere instead. So its area is exact on a surface of any outline,
    which may consist of several faces in one plane.

    Parameters
    ----------
    geometry : Polyhedron
    faces : iterable of int
        The surface's faces. Those in the plane of the largest one have the patch, or with ``at`` those
        in the plane nearest to it.
    area : float
        m².
    material, name : str
        Of the patch.
    at : array (3,), optional
        Its middle in m; by default the middle of the surface.

    Raises
    ------
    DataError
        If ``at`` is further than `NEAR` from the surface.
    """
    flat = _in_one_plane(geometry, [int(i) for i in faces], at)
    parts = {i: _convex_parts(geometry, i) for i in flat}
    every = [part for some in parts.values() for part in some]
    if area >= LARGEST * sum(map(_area, every)):
        return None
    normal = geometry.normals[flat[0]]
    plane = _Plane.of(normal, every)
    centre = _middle(plane, normal, every) if at is None else _on(at, normal, every)
    sides = plane.half_planes(centre, _scale(plane, centre, every, area))
    taken = set(geometry.names)
    polygons: list[Polygon] = []
    for i, (other, made_of) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        if i not in parts or not any(_is_face(_inside(part, sides)) for part in parts[i]):
            polygons.append((other, made_of, geometry.vertices[list(geometry.faces[i])]))
            continue
        rim = [other]
        for part in parts[i]:
            inner, outer = _divided(part, sides)
            if _is_face(inner):
                polygons.append((_new_name(name, taken), material, inner))
            for piece in outer:
                polygons.append((rim.pop() if rim else _new_name(other, taken), made_of, piece))
    return Polyhedron.from_polygons(polygons)


def _new_name(name: str, taken: set[str]) -> str:
    """Return a name that no face has, and keep it."""
    new = next(n for k in count(1) if (n := name if k == 1 else f"{name} {k}") not in taken)
    taken.add(new)
    return new


def face_at(geometry: Polyhedron, point: Array) -> tuple[int, float]:
    """Return the face nearest to a point, and its distance in m."""
    distances = [
        _distance(point, geometry.normals[i], _convex_parts(geometry, i))
        for i in range(len(geometry.faces))
    ]
    nearest = int(np.argmin(distances))
    return nearest, distances[nearest]


def _in_one_plane(geometry: Polyhedron, faces: list[int], at: Array | None) -> list[int]:
    """Return the faces in the plane of the largest one, or of the one nearest to a point."""
    first = max(faces, key=lambda i: float(geometry.face_areas[i]))
    if at is not None:
        first = min(
            faces, key=lambda i: _distance(at, geometry.normals[i], _convex_parts(geometry, i))
        )
    normal, origin = geometry.normals[first], geometry.vertices[geometry.faces[first][0]]
    return [
        i
        for i in faces
        if geometry.normals[i] @ normal > 1 - 1e-4
        and np.abs((geometry.vertices[list(geometry.faces[i])] - origin) @ normal).max() < 0.01
    ]


def _convex_parts(geometry: Polyhedron, face: int) -> list[Array]:
    """Return a convex face as it is, another one as its triangles."""
    corners = geometry.vertices[list(geometry.faces[face])]
    edges = np.roll(corners, -1, axis=0) - corners
    if (np.cross(edges, np.roll(edges, -1, axis=0)) @ geometry.normals[face] >= 0).all():
        return [corners]
    return list(geometry.triangles[geometry.triangle_faces == face])


def _area(part: Array) -> float:
    return float(np.linalg.norm(vector_area(part))) if len(part) > 2 else 0.0


def _cut(part: Array, normal: Array, offset: float) -> tuple[Array, Array]:
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


def _divided(part: Array, sides: Sequence[tuple[Array, float]]) -> tuple[Array, list[Array]]:
    """Return the piece of a convex polygon within all sides, and the pieces beyond each."""
    outside = []
    for normal, offset in sides:
        part, beyond = _cut(part, normal, offset)
        if _is_face(beyond):
            outside.append(beyond)
    return part, outside


def _inside(part: Array, sides: Sequence[tuple[Array, float]]) -> Array:
    return _divided(part, sides)[0]


def _is_face(piece: Array) -> bool:
    """Return whether a piece is wider than `WELD`, below which corners are one."""
    if len(piece) < 3:
        return False
    length = float(np.linalg.norm(np.roll(piece, -1, axis=0) - piece, axis=1).max())
    return _area(piece) > 0.5 * WELD * length


def _scale(plane: _Plane, centre: Array, parts: Sequence[Array], area: float) -> float:
    """Return the scale at which the rectangle about a point holds an area of the surface."""
    low, high = 0.0, 2.0  # twice the bounding rectangle about any of its points covers it
    for _ in range(_HALVINGS):
        scale = (low + high) / 2
        sides = plane.half_planes(centre, scale)
        if sum(_area(_inside(part, sides)) for part in parts) < area:
            low = scale
        else:
            high = scale
    return (low + high) / 2


def _middle(plane: _Plane, normal: Array, parts: Sequence[Array]) -> Array:
    """Return the middle of the bounding rectangle, or if it is off the surface of the largest part."""
    if _distance(plane.middle, normal, parts) < WELD:
        return plane.middle
    return np.asarray(max(parts, key=_area).mean(axis=0))


def _on(point: Array, normal: Array, parts: Sequence[Array]) -> Array:
    """Return the place of the surface nearest to a point; DataError if that is far."""
    if (distance := _distance(point, normal, parts)) > NEAR:
        raise DataError(
            f"at = ({', '.join(f'{x:g}' for x in point)}) m is {distance:.2g} m from the surface; the "
            f"limit is {NEAR:g} m"
        )
    return np.asarray(point + ((parts[0][0] - point) @ normal) * normal)


def _distance(point: Array, normal: Array, parts: Sequence[Array]) -> float:
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
