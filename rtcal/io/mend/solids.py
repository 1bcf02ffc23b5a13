"""The room between walls that are drawn as closed solids, as building models and CAD programs do.

Each wall, slab and column is a closed solid of its own. The union of all solids has an outer surface
and one around each cavity; the largest cavity is the room. Needs manifold3d (``rtcal[mesh]``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from rtcal.io.mend.faces import (
    MOST_PLACES,
    Defect,
    Faces,
    Mending,
    MeshError,
    edges_of,
)
from rtcal.io.mend.welding import welded
from rtcal.simulators.geometry import Polyhedron, winding_number
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.text import listed, rounded
from rtcal.support.types import Array

_THIN = 0.8
"""Mean chord in m, 4 V / S, below which a solid is a wall or a slab: that of a wall is twice its
thickness at most, that of a cube of 5 m³ is 1.1 m."""
_LEAST_SHARE = 0.05
"""Least volume of the room, as a share of that of the box around the solids."""


def room_between(drawn: Faces, weld: float) -> tuple[Faces, tuple[Defect]] | None:
    """Return the faces around the largest cavity between closed solids, and what was done.

    None if the faces are not several closed solids, or if one is a room that may hold the others.

    Raises
    ------
    MeshError
        If all solids are thin and enclose no cavity: their faces bound material and not air.
    MissingDependencyError
        Without manifold3d.
    """
    mend = Mending(drawn, weld)
    try:
        part = welded(mend)
    except DataError:  # a corner that is not finite, or nothing but slivers: `mended` says so
        return None
    groups = _solids(part.faces)
    if groups is None or len(groups) < 2:
        return None
    try:
        solids = [part.of(group).polyhedron() for group in groups]
    except DataError:  # a solid that reaches through itself
        return None
    thin = [4 * s.volume < _THIN * float(np.sum(s.face_areas)) for s in solids]
    if not any(thin):
        return None
    cavities = _cavities(solids, groups)
    box = float(np.prod(np.ptp(mend.points, axis=0)))
    if not cavities or cavities[0].volume < _LEAST_SHARE * box:
        if not all(thin):
            return None
        raise MeshError(
            f"{drawn.path}: the faces bound {len(solids)} solids, such as walls and slabs, and these "
            "enclose no cavity: what is inside them is material and not air, so no room can be made. "
            "In your program, close the openings and gaps between the solids, or draw the room's "
            f"inner faces; --weld {rounded(10 * weld, 2)} closes gaps of that width in m"
        )
    room, *others = cavities
    materials, names = ([of[i] for i in room.faces] for of in (part.materials, part.names))
    done = f"closed solids: the room is the cavity of {rounded(room.volume, 4)} m³ between them"
    if others:
        sizes = listed([f"{rounded(c.volume, 3)} m³" for c in others])
        done += f", the largest; {'another' if len(others) == 1 else 'others'} of {sizes} left out"
    first = tuple(part.names[group[0]] for group in groups[:MOST_PLACES])
    defect = Defect("solids", len(groups), 0.0, 0.0, 0.0, 0.0, first, done)
    faces = Faces(drawn.path, list(room.triangles), materials, names, drawn.notes, drawn.unit)
    return faces, (defect,)


def _solids(faces: Sequence[Sequence[int]]) -> list[list[int]] | None:
    """Return the faces of each solid: in the file's order, until each edge has two faces.

    None if some edge has one face only in the end.
    """
    solids: list[list[int]] = []
    solid: list[int] = []
    open_edges: set[tuple[int, int]] = set()
    for i, face in enumerate(faces):
        solid.append(i)
        open_edges.symmetric_difference_update(edges_of(face))
        if not open_edges:
            solids.append(solid)
            solid = []
    return None if solid else solids


@dataclass(frozen=True)
class _Cavity:
    """A cavity in the union of solids, and the free solids in it.

    ``volume`` is in m³, without the free solids. ``triangles`` (n, 3, 3) are corners in m, ``faces``
    the number of the face that each is a part of.
    """

    volume: float
    triangles: Array
    faces: list[int]


def _cavities(solids: Sequence[Polyhedron], groups: Sequence[Sequence[int]]) -> list[_Cavity]:
    """Return the cavities in the union of solids, the largest first; ``groups`` are their faces."""
    manifold = library(
        "walls that are drawn as solids need manifold3d: pip install 'rtcal[mesh]'", "manifold3d"
    )
    made = []
    for solid, group in zip(solids, groups, strict=True):
        # A solid's normals point out of it, as manifold3d asks.
        corners, index = np.unique(solid.triangles.reshape(-1, 3), axis=0, return_inverse=True)
        of_face = np.array(group)[solid.triangle_faces].astype(np.uint64)
        of_corners = index.reshape(-1, 3).astype(np.uint64)
        made.append(manifold.Manifold(manifold.Mesh64(corners, of_corners, face_id=of_face)))
    surfaces = []
    for surface in reduce(add, made).decompose():  # one by one: all at once leaves spikes at joints
        mesh = surface.to_mesh64()
        corners = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts, int)]
        surfaces.append(_Cavity(-surface.volume(), corners, np.asarray(mesh.face_id, int).tolist()))
    found = []
    for cavity in (s for s in surfaces if s.volume > 0):  # around it normals point inward
        held = [
            s
            for s in surfaces
            if s.volume < 0 and abs(winding_number(s.triangles[0, :1], cavity.triangles)[0]) > 0.5
        ]
        whole = [cavity, *held]
        triangles = np.concatenate([s.triangles for s in whole])
        faces = [face for s in whole for face in s.faces]
        found.append(_Cavity(sum(s.volume for s in whole), triangles, faces))
    return sorted(found, key=lambda cavity: -cavity.volume)
