"""The surfaces of a geometry on which something may stand, their parts, and patches on them.

A mesh divides a wall into triangles. So coplanar faces of one material are one surface, unless the user
says otherwise. A long surface is cut into quarters along its longer side, and every two quarters that
touch are a part. The geometry is divided for the weighing only: the same paths are traced in it. A
patch is a part of one surface as faces of their own, in the same geometry.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, product

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Surface
from rtcal.simulators import geometry as facets
from rtcal.simulators.geometry import WELD, Plane, Polyhedron, convex_parts, cut_face
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

FLAT = 0.01
"""Largest distance in m of two parallel faces from one plane, and largest sine between their normals.
Mesh files round corners to a millimetre."""
_HORIZONTAL = 0.7
"""Smallest vertical part of the normal of a floor or ceiling: sloped by up to 45 degrees."""
Faces = NDArray[np.int64]


def of_geometry(
    geometry: Polyhedron, stated: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Faces]:
    """Return the numbers of the faces of each surface of a geometry, by the surface's name.

    Without ``stated`` names of faces, a surface has the faces of one material in one plane. Raises
    DataError for an unknown face, a face in two surfaces, and a surface without faces.
    """
    if stated is not None:
        return _stated(geometry, checks.mapped("surfaces", stated))
    groups: list[list[int]] = []
    firsts: dict[str, list[int]] = {}  # of each material, the numbers of its groups
    for i, material in enumerate(geometry.materials):
        own = firsts.setdefault(material, [])
        joined = _joined(geometry, [groups[k][0] for k in own], i)
        if joined.any():
            groups[own[int(joined.argmax())]].append(i)
        else:
            own.append(len(groups))
            groups.append([i])
    out: dict[str, Faces] = {}
    for group in groups:
        largest = max(group, key=lambda i: float(geometry.face_areas[i]))
        name = _unnumbered(geometry.names[largest], [geometry.names[i] for i in group])
        if name in out:  # a mesh may name all faces alike
            name = f"{name} ({largest + 1})"
        out[name] = np.array(group, dtype=np.int64)
    return out


def merged(geometry: Polyhedron, surfaces: Mapping[str, Faces]) -> str:
    """Return a note on the surfaces that consist of faces with different names; "" without any."""
    said = []
    for name, faces in surfaces.items():
        every = [geometry.names[i] for i in faces]
        alike = {name, _stem(name)}
        others = [n for n in every if not {n, _stem(n)} & alike]
        if others:
            named = dict.fromkeys(_unnumbered(n, others) for n in others)
            said.append(f"{', '.join(named)} as part of {name}")
    if not said:
        return ""
    return (
        f"Taken together, since they lie in one plane and have one material: {'; '.join(said)}. "
        "Name surfaces in [geometry.surfaces] to distinguish them."
    )


def _stem(name: str) -> str:
    """Return the name of a face without its number."""
    return re.sub(r" \d+$", "", name)


def _unnumbered(name: str, others: Sequence[str]) -> str:
    """Return "wall" for "wall 2" if the surface has a face of that name, too."""
    stem = _stem(name)
    return stem if stem in others else name


def stated_surfaces(geometry: Polyhedron) -> list[Surface]:
    """Return a room's surfaces, as `of_geometry` finds them, in the form of the room's file."""
    drawn = geometry.surfaces
    surfaces = []
    for name, faces in of_geometry(geometry).items():
        largest = drawn[max(faces, key=lambda i: drawn[i].area)]
        area = sum(drawn[i].area for i in faces)
        surfaces.append(Surface(name, largest.material, area, largest.axis))
    return surfaces


def _joined(geometry: Polyhedron, firsts: Sequence[int], other: int) -> NDArray[np.bool_]:
    """Return whether a face lies in the plane of each of some others, and faces the same way."""
    if not firsts:
        return np.zeros(0, dtype=bool)
    normals, normal = geometry.normals[firsts], geometry.normals[other]
    points = geometry.vertices[[geometry.faces[first][0] for first in firsts]]
    corners = geometry.vertices[list(geometry.faces[other])]
    apart = np.einsum("cfk,fk->cf", corners[:, np.newaxis] - points, normals)
    parallel = np.linalg.norm(np.cross(normals, normal), axis=1) <= FLAT
    return np.asarray(parallel & (normals @ normal > 0) & (np.abs(apart).max(axis=0) < FLAT))


def _stated(geometry: Polyhedron, stated: Mapping[str, Sequence[str]]) -> dict[str, Faces]:
    if not stated:
        raise DataError("surfaces is empty; name at least one surface")
    taken: set[str] = set()
    out: dict[str, Faces] = {}
    for name, faces in stated.items():
        members = []
        for face in checks.listed(f'surfaces["{name}"]', faces):
            if face not in geometry.names:
                raise DataError(f'surfaces["{name}"] has "{face}", which is not a face of the mesh')
            if face in taken:
                raise DataError(f'surfaces: face "{face}" is in two surfaces; leave it out of one')
            taken.add(face)
            members += [i for i, other in enumerate(geometry.names) if other == face]
        if not members:
            raise DataError(f'surfaces["{name}"] has no face; give it at least one')
        out[str(name)] = np.array(members, dtype=np.int64)
    return out


def kind(geometry: Polyhedron, faces: Faces) -> str:
    """Return "floor", "ceiling" or "wall", by the mean normal of a surface's faces."""
    upward = float(np.average(geometry.normals[faces, 2], weights=geometry.face_areas[faces]))
    if upward < -_HORIZONTAL:
        return "floor"
    return "ceiling" if upward > _HORIZONTAL else "wall"


LONG = 2.0
"""Length of a surface that is divided, in mean free paths of the room. A part is half as long."""
QUARTERS = 4


@dataclass(frozen=True, eq=False)
class Part:
    """Hold a part of a surface: its faces in the divided geometry, area in m² and middle in m."""

    surface: int
    faces: Faces
    area: float
    middle: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Divided:
    """Hold a geometry whose long surfaces are divided, with the faces and the parts of each surface."""

    geometry: Polyhedron
    surfaces: tuple[Faces, ...]
    parts: tuple[Part, ...]


def divided(geometry: Polyhedron, surfaces: Mapping[str, Faces]) -> Divided:
    """Return the geometry with its long surfaces divided into parts."""
    number = np.full(len(geometry.faces), -1)
    cuts: dict[int, tuple[Array, Array]] = {}  # direction and ends of a long surface's quarters
    for j, faces in enumerate(surfaces.values()):
        number[faces] = j
        largest_first = np.argsort(-geometry.face_areas[faces], kind="stable")
        plane = Plane.of(geometry, faces[largest_first].tolist())
        length = plane.size.max()
        if length > LONG * geometry.mean_free_path:
            axis = (plane.along, plane.across)[int(np.argmax(plane.size))]
            start = float(plane.middle @ axis) - length / 2
            cuts[j] = axis, start + np.arange(1, QUARTERS) / QUARTERS * length
    pieces: list[Polygon] = []
    places: list[tuple[int, int]] = []  # surface and quarter of each piece
    for i, (name, material) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        j, corners = int(number[i]), geometry.vertices[list(geometry.faces[i])]
        cut = [(0, corners)]
        if j in cuts:
            axis, ends = cuts[j]
            reach = corners @ axis
            within = ends[(ends > reach.min() + WELD) & (ends < reach.max() - WELD)]
            made = cut_face(geometry, i, [(axis, float(end)) for end in within])
            cut = [(int(np.searchsorted(ends, (piece @ axis).mean())), piece) for piece in made]
        for quarter, piece in cut:
            pieces.append((f"{name} ({len(pieces) + 1})", material, piece))
            places.append((j, quarter))
    solid, parts = Polyhedron.from_polygons(pieces), list[Part]()
    owner, quarters = np.array(places).T
    for j, first in product(cuts, range(QUARTERS - 1)):
        faces = np.flatnonzero((owner == j) & (quarters >= first) & (quarters <= first + 1))
        if not len(faces):
            continue
        convex = [piece for i in faces.tolist() for piece in convex_parts(solid, i)]
        middles = [piece.mean(axis=0) for piece in convex]
        middle = np.average(middles, axis=0, weights=[facets.area(piece) for piece in convex])
        normal = solid.normals[faces[np.argmax(solid.face_areas[faces])]]
        x, y, z = _middle_on(middle, normal, convex).tolist()
        parts.append(Part(j, faces, float(solid.face_areas[faces].sum()), (x, y, z)))
    of_surfaces = tuple(np.flatnonzero(owner == j) for j in range(len(surfaces)))
    return Divided(solid, of_surfaces, tuple(parts))


def _middle_on(middle: Array, normal: Array, parts: Sequence[Array]) -> Array:
    """Return a middle of convex pieces in one plane, or if it is off them that of the largest."""
    if facets.distance_in_plane(middle, normal, parts) < WELD:
        return middle
    return np.asarray(max(parts, key=facets.area).mean(axis=0))


LARGEST_PATCH = 0.95
"""Largest share of a surface that is drawn as a patch. The rim around a larger one is narrower than
2.5 % of the surface's width."""
NEAR = 0.1
"""Largest distance in m between a point that a user gives and the surface that it is on."""
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
    """Return the geometry with a patch of ``area`` m² on one surface; None if that is too small.

    It is a rectangle with the surface's proportions about ``at`` (3,), cut off at the edge.
    """
    from scipy.optimize import brentq

    own = [int(i) for i in faces]
    first = max(own, key=lambda i: float(geometry.face_areas[i]))
    if at is not None:
        first = min(own, key=lambda i: _away(at, geometry, i))
    flat = [i for i in own if _joined(geometry, [first], i)[0]]
    parts = {i: convex_parts(geometry, i) for i in flat}
    every = [part for some in parts.values() for part in some]
    if area >= LARGEST_PATCH * sum(map(facets.area, every)):
        return None
    normal = geometry.normals[flat[0]]
    plane = Plane.of(geometry, flat)
    centre = _middle_on(plane.middle, normal, every) if at is None else _on(at, normal, every)

    def excess(scale: float) -> float:
        """Return by how much the bounding rectangle at this scale holds more than the area."""
        sides = plane.half_planes(centre, scale)
        return sum(facets.area(facets.inside(part, sides)) for part in every) - area

    # Twice the bounding rectangle about any of its points covers it.
    sides = plane.half_planes(centre, float(brentq(excess, 0.0, 2.0)))
    taken = set(geometry.names)
    pieces: list[Polygon] = []
    for i, (other, made_of) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        if not any(facets.is_face(facets.inside(part, sides)) for part in parts.get(i, ())):
            pieces.append((other, made_of, geometry.vertices[list(geometry.faces[i])]))
            continue
        rim = [other]
        for part in parts[i]:
            inner, outer = facets.divided(part, sides)
            if facets.is_face(inner):
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
    """Return the number of the face nearest to a point (3,) in m, and its distance in m."""
    distances = [_away(point, geometry, i) for i in range(len(geometry.faces))]
    nearest = int(np.argmin(distances))
    return nearest, distances[nearest]


def _away(point: Array, geometry: Polyhedron, face: int) -> float:
    """Return a point's distance in m from a face."""
    return facets.distance_in_plane(point, geometry.normals[face], convex_parts(geometry, face))


def _on(point: Array, normal: Array, parts: Sequence[Array]) -> Array:
    """Return the place of the surface nearest to a point; DataError if that is far."""
    if (distance := facets.distance_in_plane(point, normal, parts)) > NEAR:
        raise DataError(
            f"at = ({', '.join(f'{x:g}' for x in point)}) m is {distance:.2g} m away from the "
            f"surface; at most {NEAR:g} m is allowed"
        )
    return np.asarray(point + ((parts[0][0] - point) @ normal) * normal)
