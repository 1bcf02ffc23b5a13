"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge;
4. a face on a larger one (a window on its wall, up to ``offset`` before it) takes its area;
5. an object that stands on a face with an open bottom takes its footprint from that face;
6. a free panel becomes a reflector with two sides, `THICKNESS` thick;
7. what lies outside the shell is left out, and a solid that reaches through it ends there;
8. where a closed object touches a face, neither counts.

Each is a `Defect` with its number, area and effects on V and S. What cannot be mended safely is
refused, and the message says how to mend it in the program that drew it. All other defects are listed
with it, so that they can be mended in one go. Needs shapely
(``rtcal[mesh]``) where a face is to be cut.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.io.mend.contacts import objects_are_within, without_contacts
from rtcal.io.mend.faces import (
    MOST_FACES,
    OFFSET,
    SAME,
    WELD,
    Defect,
    Faces,
    FaceSet,
    Mended,
    Mending,
    MeshError,
    normal_of,
    numbered,
)
from rtcal.io.mend.shell import as_drawn, shell_of, without_holes
from rtcal.io.mend.walls import note_loose, with_others
from rtcal.io.mend.welding import flattened, joined, snapped, welded, without_repetitions
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["OFFSET", "WELD", "Defect", "Faces", "Mended", "MeshError", "closed", "mended"]
__dir__ = __all__.copy


def mended(
    faces: Faces,
    *,
    weld: float = WELD,
    offset: float = OFFSET,
    largest_hole: float | None = None,
) -> Mended:
    """Return the closed room of some faces, and every defect.

    Parameters
    ----------
    faces : Faces
    weld : float
        Distance in m within which corners are one.
    offset : float
        Distance in m up to which a face lies on another.
    largest_hole : float, optional
        Largest area in m² of a hole that is closed; by default 1 % of the shell's area.

    Raises
    ------
    MeshError
        For a mesh without a closed room. It names the defect, where, and how to mend it.
    MissingDependencyError
        Without shapely, if a face must be cut.
    """
    for name, value in (("weld", weld), ("offset", offset)):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} m is not finite and 0 or more")
    if largest_hole is not None and not 0 <= largest_hole < np.inf:
        raise DataError(f"largest_hole = {largest_hole:g} m² is not finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: there is no face; a room has at least 4")
    if len(faces.polygons) > 20 * MOST_FACES:
        raise DataError(f"{faces.path}: {len(faces.polygons)} faces; at most {20 * MOST_FACES}")
    mend = Mending(faces, max(weld, SAME), offset, largest_hole)
    part = without_repetitions(welded(mend))
    part = flattened(snapped(without_repetitions(joined(part))))
    shell, others = shell_of(part)
    geometry = _closed(shell, others)
    if any(geometry.contains([point])[0] for point in mend.buried):
        raise mend.refused(
            "two closed rooms have a wall in common: leave one of them out, or delete that wall"
        )
    _note_turned(mend, geometry)
    return mend.result(without_contacts(mend, geometry))


def _closed(shell: FaceSet, others: Sequence[FaceSet]) -> Polyhedron:
    """Return the room of its shell and the other components; MeshError with the room as drawn."""
    mend = shell.mend
    try:
        shell = without_holes(shell, others)
    except MeshError as error:
        note_loose(shell, others)
        refused = mend.refused(error.reason)
        refused.edges = error.edges
        raise as_drawn(shell, others, refused) from None
    try:
        part = with_others(shell, others)
        if len(part.faces) > MOST_FACES:
            raise mend.refused(f"{len(part.faces)} faces; at most {MOST_FACES}: simplify the model")
        return part.polyhedron()
    except DataError as error:
        refused = error if isinstance(error, MeshError) else mend.refused(f"after mending, {error}")
        raise as_drawn(shell, others, refused) from error


def closed(faces: Faces, *, weld: float = WELD, offset: float = OFFSET) -> Mended | None:
    """Return the room of faces that close as they are drawn; None if they do not.

    Closed objects are in it, without what they share with the faces that they touch.
    """
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    polygons = zip(numbered(faces.names), faces.materials, faces.polygons, strict=True)
    try:
        geometry = Polyhedron.from_polygons(list(polygons))
    except DataError:  # not closed, or a defect that `mended` names
        return None
    mend = Mending(faces, max(weld, SAME), offset)
    if not objects_are_within(mend, geometry):
        return None
    _note_turned(mend, geometry)
    return mend.result(without_contacts(mend, geometry))


def _note_turned(mend: Mending, geometry: Polyhedron) -> None:
    """Note the drawn faces whose orientation differs from that of most."""

    def key(corners: Array) -> tuple[float, ...]:
        return tuple(np.round(corners.mean(axis=0), 3).tolist())

    drawn = [np.asarray(polygon) for polygon in mend.drawn.polygons if len(polygon) > 2]
    normals = {key(polygon): normal_of(polygon) for polygon in drawn}
    agree: Mapping[str, bool] = {
        name: float(normals[key(corners)] @ normal) > 0
        for name, face, normal in zip(geometry.names, geometry.faces, geometry.normals, strict=True)
        if key(corners := geometry.vertices[list(face)]) in normals
    }
    most = 2 * sum(agree.values()) >= len(agree)
    if against := [name for name, same in agree.items() if same != most]:
        mend.found("turned", "faces with the other orientation than most are turned", against)
