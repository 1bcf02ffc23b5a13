"""A patch on a surface: the same geometry with a part of one surface as faces of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import count

import numpy as np

from rtcal.simulators import polygons
from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.simulators.polygons import Plane, is_face
from rtcal.support.errors import DataError
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
    parts = {i: polygons.convex_parts(geometry, i) for i in flat}
    every = [part for some in parts.values() for part in some]
    if area >= LARGEST * sum(map(polygons.area, every)):
        return None
    normal = geometry.normals[flat[0]]
    plane = Plane.of(geometry, flat)
    centre = _middle(plane, normal, every) if at is None else _on(at, normal, every)
    sides = plane.half_planes(centre, _scale(plane, centre, every, area))
    taken = set(geometry.names)
    pieces: list[Polygon] = []
    for i, (other, made_of) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        if not any(is_face(polygons.inside(part, sides)) for part in parts.get(i, ())):
            pieces.append((other, made_of, geometry.vertices[list(geometry.faces[i])]))
            continue
        rim = [other]
        for part in parts[i]:
            inner, outer = polygons.divided(part, sides)
            if is_face(inner):
                pieces.append((_new_name(name, taken), material, inner))
            for piece in outer:
                pieces.append((rim.pop() if rim else _new_name(other, taken), made_of, piece))
    return Polyhedron.from_polygons(pieces)


def _new_name(name: str, taken: set[str]) -> str:
    """Return a name that no face has, and keep it."""
    new = next(n for k in count(1) if (n := name if k == 1 else f"{name} {k}") not in taken)
    taken.add(new)
    return new


def face_at(geometry: Polyhedron, point: Array) -> tuple[int, float]:
    """Return the face nearest to a point, and its distance in m."""
    distances = [_away(point, geometry, i) for i in range(len(geometry.faces))]
    nearest = int(np.argmin(distances))
    return nearest, distances[nearest]


def _away(point: Array, geometry: Polyhedron, face: int) -> float:
    """Return a point's distance in m from a face."""
    return polygons.distance(point, geometry.normals[face], polygons.convex_parts(geometry, face))


def _in_one_plane(geometry: Polyhedron, faces: list[int], at: Array | None) -> list[int]:
    """Return the faces in the plane of the largest one, or of the one nearest to a point."""
    first = max(faces, key=lambda i: float(geometry.face_areas[i]))
    if at is not None:
        first = min(faces, key=lambda i: _away(at, geometry, i))
    normal, origin = geometry.normals[first], geometry.vertices[geometry.faces[first][0]]
    return [
        i
        for i in faces
        if geometry.normals[i] @ normal > 1 - 1e-4
        and np.abs((geometry.vertices[list(geometry.faces[i])] - origin) @ normal).max() < 0.01
    ]


def _scale(plane: Plane, centre: Array, parts: Sequence[Array], area: float) -> float:
    """Return the scale at which the rectangle about a point holds an area of the surface."""
    low, high = 0.0, 2.0  # twice the bounding rectangle about any of its points covers it
    for _ in range(_HALVINGS):
        scale = (low + high) / 2
        sides = plane.half_planes(centre, scale)
        if sum(polygons.area(polygons.inside(part, sides)) for part in parts) < area:
            low = scale
        else:
            high = scale
    return (low + high) / 2


def _middle(plane: Plane, normal: Array, parts: Sequence[Array]) -> Array:
    """Return the middle of the bounding rectangle, or if it is off the surface of the largest part."""
    if polygons.distance(plane.middle, normal, parts) < WELD:
        return plane.middle
    return np.asarray(max(parts, key=polygons.area).mean(axis=0))


def _on(point: Array, normal: Array, parts: Sequence[Array]) -> Array:
    """Return the place of the surface nearest to a point; DataError if that is far."""
    if (distance := polygons.distance(point, normal, parts)) > NEAR:
        raise DataError(
            f"at = ({', '.join(f'{x:g}' for x in point)}) m is {distance:.2g} m from the surface; the "
            f"limit is {NEAR:g} m"
        )
    return np.asarray(point + ((parts[0][0] - point) @ normal) * normal)
