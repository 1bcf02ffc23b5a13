"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge;
4. a face on a larger one (a window on its wall, up to `OFFSET` before it) takes its area;
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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.io.mend.faces import (
    MOST_FACES,
    SAME,
    WELD,
    Defect,
    Faces,
    FaceSet,
    Mended,
    Mending,
    MeshError,
    numbered,
)
from rtcal.io.mend.shell import as_drawn, shell_of, without_holes
from rtcal.io.mend.solids import room_between
from rtcal.io.mend.walls import note_loose, objects_are_within, with_others, without_contacts
from rtcal.io.mend.welding import flattened, joined, snapped, welded, without_repetitions
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError

__all__ = ["WELD", "Defect", "Faces", "Mended", "MeshError", "mended"]
__dir__ = __all__.copy


def mended(faces: Faces, *, weld: float = WELD, largest_hole: float | None = None) -> Mended:
    """Return the closed room of some faces, and every defect.

    Faces that close as they are drawn are taken as they are: closed objects are in the room, without
    what they share with the faces that they touch.

    Parameters
    ----------
    faces : Faces
    weld : float
        Distance in m within which corners are one.
    largest_hole : float, optional
        Largest area in m² of a hole that is closed; by default 1 % of the shell's area.

    Raises
    ------
    MeshError
        For a mesh without a closed room. It names the defect, where, and how to mend it.
    MissingDependencyError
        Without shapely, if a face must be cut.
    """
    for name, value, unit in (("weld", weld, "m"), ("largest_hole", largest_hole or 0.0, "m²")):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} {unit} is not finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: there is no face; a room has at least 4")
    if len(faces.polygons) > 20 * MOST_FACES:
        raise DataError(f"{faces.path}: {len(faces.polygons)} faces; at most {20 * MOST_FACES}")
    if (closed := _closed_as_drawn(faces, weld)) is not None:
        return closed
    between = room_between(faces, weld)
    faces, solids = (faces, ()) if between is None else between
    mend = Mending(faces, max(weld, SAME), largest_hole)
    part = without_repetitions(welded(mend))
    part = flattened(snapped(without_repetitions(joined(part))))
    shell, others = shell_of(part)
    geometry = _closed(shell, others)
    if any(geometry.contains([point])[0] for point in mend.buried):
        raise mend.refused(
            "two closed rooms have a wall in common: leave one of them out, or delete that wall"
        )
    done = mend.result(without_contacts(mend, geometry))
    return replace(done, defects=(*solids, *done.defects))


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


def _closed_as_drawn(faces: Faces, weld: float) -> Mended | None:
    """Return the room of faces that close as they are drawn, its objects within; None of others."""
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    mend = Mending(faces, max(weld, SAME))
    polygons = zip(numbered(faces.names), faces.materials, faces.polygons, strict=True)
    try:
        geometry = Polyhedron.from_polygons(list(polygons))
    except DataError:  # not closed, or a defect that is named later
        return None
    if not objects_are_within(mend, geometry):
        return None
    return mend.result(without_contacts(mend, geometry))
