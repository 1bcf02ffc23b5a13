"""Parts of large surfaces, on each of which something may stand alone.

Two ends of a long wall are heard as two places. So a long surface is cut into quarters along its longer
side, and every two quarters that touch are a part: its first half, its middle and its last half. The
geometry is divided for the weighing only. Its faces lie in the same planes and have the same materials,
so the same paths are traced in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rtcal.finder.positions.surfaces import Faces
from rtcal.simulators import polygons
from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.simulators.polygons import Plane
from rtcal.support.types import Array

LONG = 2.0
"""Length of a surface that is divided, in mean free paths of the room. A part is half as long."""
QUARTERS = 4


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a surface.

    Attributes
    ----------
    surface : int
        Number of its surface.
    faces : int array
        Its faces in the divided geometry.
    area : float
        m².
    middle : (x, y, z)
        A point in its middle, in m.
    """

    surface: int
    faces: Faces
    area: float
    middle: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Divided:
    """A geometry whose long surfaces are divided.

    Attributes
    ----------
    geometry : Polyhedron
    surfaces : tuple of int arrays
        Faces of each surface in it.
    parts : tuple of Part
        Of all surfaces that are divided, surface by surface.
    """

    geometry: Polyhedron
    surfaces: tuple[Faces, ...]
    parts: tuple[Part, ...]


def divided(geometry: Polyhedron, surfaces: Mapping[str, Faces]) -> Divided:
    """Return the geometry with its long surfaces divided."""
    pieces: list[tuple[str, str, Array]] = []
    number = np.full(len(geometry.faces), -1)
    planes: dict[int, Plane] = {}
    for j, faces in enumerate(surfaces.values()):
        number[faces] = j
        plane = _plane(geometry, faces)
        if plane.size.max() > LONG * geometry.mean_free_path:
            planes[j] = plane
    places: list[tuple[int, int]] = []  # surface and quarter of each piece
    for i, (name, material) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        cut = [(0, geometry.vertices[list(geometry.faces[i])])]
        if number[i] in planes:
            cut = _quarters(geometry, i, planes[int(number[i])])
        for quarter, piece in cut:
            pieces.append((f"{name} ({len(pieces) + 1})", material, piece))
            places.append((int(number[i]), quarter))
    solid = Polyhedron.from_polygons(pieces)
    owner, quarters = np.array(places).T
    return Divided(
        geometry=solid,
        surfaces=tuple(np.flatnonzero(owner == j) for j in range(len(surfaces))),
        parts=tuple(part for j in planes for part in _parts(solid, j, owner, quarters)),
    )


def _plane(geometry: Polyhedron, faces: Faces) -> Plane:
    """Return the plane of a surface's largest face, and the rectangle that bounds the surface."""
    largest_first = np.argsort(-geometry.face_areas[faces], kind="stable")
    return Plane.of(geometry, faces[largest_first].tolist())


def _quarters(geometry: Polyhedron, face: int, plane: Plane) -> list[tuple[int, Array]]:
    """Return the pieces of a face, and in which quarter of the surface's longer side each lies."""
    side = int(np.argmax(plane.size))
    axis = (plane.along, plane.across)[side]
    start = float(plane.middle @ axis) - plane.size[side] / 2
    ends = start + np.arange(1, QUARTERS + 1) / QUARTERS * plane.size[side]
    ends[-1] = np.inf
    corners = geometry.vertices[list(geometry.faces[face])]
    reach = corners @ axis
    first, last = np.searchsorted(ends, [reach.min() + WELD, reach.max() - WELD]).tolist()
    if first == last:
        return [(first, corners)]
    out = []
    for polygon in polygons.convex_parts(geometry, face):
        left = polygon
        for quarter, end in enumerate(ends):
            piece, left = polygons.cut(left, axis, end)
            if polygons.is_face(piece):
                out.append((quarter, piece))
            if not polygons.is_face(left):
                break
    return out


def _parts(geometry: Polyhedron, surface: int, owner: Faces, quarters: Faces) -> list[Part]:
    """Return the parts of a surface, without those that have no face."""
    out = []
    for first in range(QUARTERS - 1):
        inside = (owner == surface) & (quarters >= first) & (quarters <= first + 1)
        faces = np.flatnonzero(inside)
        if len(faces):
            area = float(geometry.face_areas[faces].sum())
            out.append(Part(surface, faces, area, _middle(geometry, faces)))
    return out


def _middle(geometry: Polyhedron, faces: Faces) -> tuple[float, float, float]:
    """Return the middle of some faces, or if it is off them that of the largest convex piece."""
    convex = [piece for i in faces.tolist() for piece in polygons.convex_parts(geometry, i)]
    areas = [polygons.area(piece) for piece in convex]
    middles = np.array([piece.mean(axis=0) for piece in convex])
    middle = np.average(middles, axis=0, weights=areas)
    largest = int(np.argmax(areas))
    normal = geometry.normals[faces[np.argmax(geometry.face_areas[faces])]]
    off = polygons.distance(middle, normal, convex)
    x, y, z = (middle if off < WELD else middles[largest]).tolist()
    return x, y, z
