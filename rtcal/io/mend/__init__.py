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

import numpy as np

from rtcal.io.mend.contacts import objects_within, without_contacts
from rtcal.io.mend.faces import (
    MOST_FACES,
    OFFSET,
    SAME,
    WELD,
    Defect,
    Faces,
    Mended,
    Mending,
    MeshError,
    Unclosed,
    Work,
    numbered,
)
from rtcal.io.mend.objects import tell_loose, tell_turned, unclosed_room, with_others
from rtcal.io.mend.polygons import shell_of, without_holes
from rtcal.io.mend.welding import flattened, joined, snapped, welded, without_repetitions
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError

__all__ = [
    "OFFSET",
    "WELD",
    "Defect",
    "Faces",
    "Mended",
    "MeshError",
    "Unclosed",
    "closed",
    "mended",
]
__dir__ = __all__.copy


@checked
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
    return _mended(Mending(faces, max(weld, SAME), offset, largest_hole))


def closed(faces: Faces, *, weld: float = WELD, offset: float = OFFSET) -> Mended | None:
    """Return the room of faces that close as they are drawn; None if they do not.

    Closed objects are in it, without what they share with the faces that they touch.
    """
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    try:
        polygons = zip(numbered(faces.names), faces.materials, faces.polygons, strict=True)
        geometry = Polyhedron.from_polygons(list(polygons))
    except DataError:  # not closed, or a defect that `mended` names
        return None
    mender = Mending(faces, max(weld, SAME), offset, None)
    if not objects_within(mender, geometry):
        return None
    tell_turned(mender, geometry)
    geometry = without_contacts(mender, geometry)
    return Mended(geometry, tuple(mender.defects), faces.notes)


def _mended(mend: Mending) -> Mended:
    work = welded(mend)
    work = without_repetitions(mend, work)
    work = without_repetitions(mend, joined(mend, work))
    work = snapped(mend, work)
    work = flattened(mend, work)
    mend.used = sorted({v for face in work.faces for v in face})
    shell, others = shell_of(mend, work)
    try:
        shell = without_holes(mend, shell)
    except MeshError as error:
        tell_loose(mend, shell, others)
        refused = mend.told(error)
        refused.unclosed = unclosed_room(mend, shell, others)
        raise refused from None
    try:
        geometry = _geometry(mend, with_others(mend, shell, others))
    except DataError as error:
        refused = error if isinstance(error, MeshError) else mend.refused(f"after mending, {error}")
        refused.unclosed = unclosed_room(mend, shell, others)
        raise refused from error
    if any(geometry.contains([point])[0] for point in mend.buried):
        raise mend.refused(
            "two closed rooms have a wall in common: leave one of them out, or delete that wall"
        )
    tell_turned(mend, geometry)
    geometry = without_contacts(mend, geometry)
    return Mended(geometry, tuple(mend.defects), mend.drawn.notes)


def _geometry(mend: Mending, shell: Work) -> Polyhedron:
    if len(shell.faces) > MOST_FACES:
        raise mend.refused(f"{len(shell.faces)} faces; at most {MOST_FACES}: simplify the model")
    return Polyhedron(
        vertices=mend.points,
        faces=[tuple(f) for f in shell.faces],
        materials=shell.materials,
        names=numbered(shell.names),
    )
