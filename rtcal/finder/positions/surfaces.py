"""The surfaces of a geometry on which something may stand.

A mesh divides a wall into triangles. So coplanar faces of one material are one surface, unless the user
says otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError

FLAT = 0.01
"""Largest distance in m of two parallel faces from one plane, and largest sine between their normals.
Mesh files round corners to a millimetre."""
_HORIZONTAL = 0.7
"""Smallest vertical part of the normal of a floor or ceiling: sloped by up to 45 degrees."""

Faces = NDArray[np.int64]


def of_geometry(
    geometry: Polyhedron, stated: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Faces]:
    """Return each surface's faces by its name: the name of its largest face.

    Parameters
    ----------
    geometry : Polyhedron
    stated : mapping of str to sequence of str, optional
        Names of the faces of each surface, in place of the coplanar faces of one material. Faces that
        it leaves out are no surface.

    Raises
    ------
    DataError
        For a face that the geometry lacks, a face in two surfaces, or a surface without a face.
    """
    if stated is not None:
        return _stated(geometry, checks.mapped("surfaces", stated))
    groups: list[list[int]] = []
    for i in range(len(geometry.faces)):
        for group in groups:
            if _joined(geometry, group[0], i):
                group.append(i)
                break
        else:
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
    """Return a note of the surfaces that hold faces of other names; "" without any.

    Faces that differ in their number alone are one wall's triangles.
    """
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
        "State surfaces to tell them apart."
    )


def _stem(name: str) -> str:
    """Return the name of a face without its number."""
    return re.sub(r" \d+$", "", name)


def _unnumbered(name: str, others: Sequence[str]) -> str:
    """Return "wall" for "wall 2" if the surface has a face of that name, too."""
    stem = _stem(name)
    return stem if stem in others else name


def _joined(geometry: Polyhedron, first: int, other: int) -> bool:
    """Return whether two faces lie in one plane, face the same way and have one material."""
    if geometry.materials[first] != geometry.materials[other]:
        return False
    normal = geometry.normals[first]
    if np.linalg.norm(np.cross(normal, geometry.normals[other])) > FLAT:
        return False
    corners = geometry.vertices[list(geometry.faces[other])]
    apart = (corners - geometry.vertices[geometry.faces[first][0]]) @ normal
    return bool(normal @ geometry.normals[other] > 0 and np.abs(apart).max() < FLAT)


def _stated(geometry: Polyhedron, stated: Mapping[str, Sequence[str]]) -> dict[str, Faces]:
    if not stated:
        raise DataError("surfaces is empty; it names at least one surface")
    taken: set[str] = set()
    out: dict[str, Faces] = {}
    for name, faces in stated.items():
        members = []
        for face in checks.listed(f'surfaces["{name}"]', faces):
            if face not in geometry.names:
                raise DataError(f'surfaces["{name}"] has "{face}", which is no face')
            if face in taken:
                raise DataError(f'surfaces: face "{face}" stands in two surfaces')
            taken.add(face)
            members += [i for i, other in enumerate(geometry.names) if other == face]
        if not members:
            raise DataError(f'surfaces["{name}"] has no face')
        out[str(name)] = np.array(members, dtype=np.int64)
    return out


def kind(geometry: Polyhedron, faces: Faces) -> str:
    """Return "floor", "ceiling" or "wall", by the mean normal."""
    upward = float(np.average(geometry.normals[faces, 2], weights=geometry.face_areas[faces]))
    if upward < -_HORIZONTAL:
        return "floor"
    return "ceiling" if upward > _HORIZONTAL else "wall"
