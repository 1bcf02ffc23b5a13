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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.io.mend.faces import (
    ANY_SHARE,
    CONTACT,
    MOST_FACES,
    MOST_PLACES,
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
    area_of,
    axes_of,
    extent_of,
    normal_of,
    numbered,
    parts_of,
    polygon_of,
    polygons_of,
    shapely,
    shell_of,
    without_holes,
)
from rtcal.io.mend.walls import (
    COVERED,
    Cut,
    cut,
    lifted,
    tell_loose,
    tell_turned,
    unclosed_room,
    with_others,
    within,
)
from rtcal.io.mend.welding import flattened, joined, settled, snapped, welded, without_repetitions
from rtcal.simulators import facets
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError
from rtcal.support.types import Array

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


_FACING = -0.999
"""Largest product of the normals of faces that face each other."""

_BEFORE = 5e-4
"""Distance in m before a face at which there is air, or behind it at which there is none."""


@dataclass
class _Contact:
    """A face of an object before a face of a larger one, or of the room."""

    face: int
    wall: int
    gap: float
    """Width in m of the air between them; below 0 where the object reaches through the wall."""


def objects_within(mend: Mending, geometry: Polyhedron) -> bool:
    """Return whether every closed object of a room is in it."""
    shell, objects = shell_of(mend, _work(mend, geometry))
    if not objects:
        return True
    faces = [tuple(face) for face in shell.faces]
    hull = Polyhedron(vertices=mend.points, faces=faces, materials=shell.materials)
    return all(within(mend, hull, mend.corners(part)) for part in objects)


def without_contacts(mend: Mending, geometry: Polyhedron) -> Polyhedron:
    """Return a room without the parts of its faces on which closed objects stand or lie.

    A face of an object that is up to ``weld`` before a face of the room or of a larger object, or that
    reaches through it by up to ``offset``, is moved onto it. What they share is taken from both. A
    wider gap up to ``offset`` is told.
    """
    work = _work(mend, geometry)
    parts = _by_size(mend, work)
    contacts = list(_contacts(mend, geometry, parts))
    touching = [c for c in contacts if c.gap <= mend.weld]
    _tell_gaps(mend, work, [c for c in contacts if c.gap > mend.weld], parts[0])
    if not touching:
        return geometry
    moved = [_moved(mend, work, contact) for contact in touching]
    cuts: dict[int, list[Cut]] = {}
    area, places, unsure = 0.0, [], []
    for contact, distance in zip(touching, moved, strict=True):
        shared = _shared(mend, work, contact)
        for shape in shared:
            cuts.setdefault(contact.wall, []).append((shape, None, ""))
            cuts.setdefault(contact.face, []).append((_seen(mend, work, contact, shape), None, ""))
            # What the object's other faces have gained or lost there.
            longer = ANY_SHARE * distance * float(shape.length)
            unsure.append((work.materials[contact.face], longer))
        if shared:
            area += sum(float(shape.area) for shape in shared)
            places.append(f'"{work.names[contact.face]}" on "{work.names[contact.wall]}"')
    if not cuts:
        return geometry
    try:
        mended = _without(mend, work, cuts)
    except DataError as error:
        raise mend.refused(
            f"closed objects touch other faces, and both faces cannot be cut there ({error}). Draw the "
            f"objects without those faces: {'; '.join(places[:MOST_PLACES])}"
        ) from error
    volume = mended.volume - geometry.volume
    mend.found(
        "contact",
        CONTACT,
        places,
        area,
        volume,
        float(np.sum(mended.face_areas) - np.sum(geometry.face_areas)),
        abs(volume) / np.sqrt(3),
        unsure=unsure,
    )
    return mended


def _moved(mend: Mending, work: Work, contact: _Contact) -> float:
    """Move a face of an object onto its wall, and return the largest distance in m."""
    base, own = mend.points[work.faces[contact.wall]], work.faces[contact.face]
    normal = normal_of(base)
    away = (mend.points[own] - base.mean(axis=0)) @ normal
    mend.points[own] -= away[:, np.newaxis] * normal
    return float(np.abs(away).max())


def _without(mend: Mending, work: Work, cuts: Mapping[int, Sequence[Cut]]) -> Polyhedron:
    """Return the room without some shapes of its faces; its joints may be as rough as ``weld``."""
    for weld in (2 * facets.WELD, mend.weld):
        fine = Mending(mend.drawn, weld, 0.0, None)
        fine.points = np.array(mend.points)
        left = settled(fine, cut(fine, work, cuts))
        try:
            return Polyhedron(
                vertices=fine.points,
                faces=[tuple(f) for f in left.faces],
                materials=left.materials,
                names=numbered(left.names),
            )
        except DataError as error:
            refused = error
    raise refused


def _work(mend: Mending, geometry: Polyhedron) -> Work:
    """Return a room's faces as those that are worked on."""
    mend.points = np.array(geometry.vertices)
    faces = [list(face) for face in geometry.faces]
    return Work(faces, list(geometry.materials), list(geometry.names))


def _by_size(mend: Mending, work: Work) -> list[list[int]]:
    """Return the faces of each closed surface: the room's first, then the objects', large to small."""

    def volume(part: Sequence[int]) -> float:
        polygons = [mend.points[work.faces[i]] - mend.points[0] for i in part]
        return abs(sum(float(p[0] @ facets.vector_area(p)) for p in polygons))

    return sorted(parts_of(mend, work), key=lambda part: (-volume(part), part))


def _contacts(
    mend: Mending, geometry: Polyhedron, parts: Sequence[Sequence[int]]
) -> Iterator[_Contact]:
    """Yield the faces of objects that face one of the room's or of a larger object nearby.

    Of one closed surface, they are those that lie on each other with no air between them.
    """
    polygons = [mend.points[list(face)] for face in geometry.faces]
    low = np.array([p.min(axis=0) for p in polygons])
    high = np.array([p.max(axis=0) for p in polygons])
    rank = np.empty(len(polygons), dtype=int)
    for k, part in enumerate(parts):
        rank[list(part)] = k
    through = mend.offset + mend.weld
    for k, part in enumerate(parts):
        solid = geometry.triangles[np.isin(geometry.triangle_faces, part)]
        for i in part:
            near = ((low - through <= high[i]) & (low[i] <= high + through)).all(axis=1)
            near &= (rank < k) | ((rank == k) & (np.arange(len(rank)) < i))
            near &= geometry.normals @ geometry.normals[i] < _FACING
            for j in np.flatnonzero(near).tolist():
                away = (polygons[i] - polygons[j].mean(axis=0)) @ -geometry.normals[j]
                if not (-through <= away.min() and away.max() <= max(mend.offset, mend.weld)):
                    continue
                is_same = rank[j] == k
                if is_same and np.abs(away).max() > facets.WELD:
                    continue
                inner = _inner_point(polygons[i], polygons[j])
                if inner is None:
                    continue
                if is_same:
                    before = inner - _BEFORE * geometry.normals[[i, j]]
                    if not geometry.contains(before).any():
                        yield _Contact(i, j, 0.0)
                    continue
                # A thin object on the other side of a thin wall is not behind this face of it.
                behind = inner - (max(away.max(), 0.0) + _BEFORE) * geometry.normals[j]
                if abs(float(facets.winding_number(behind, solid)[0])) > 0.5:
                    yield _Contact(i, j, float(away.max()))


def _inner_point(corners: Array, wall: Array) -> Array | None:
    """Return a point, (1, 3), of a face's plane that is before another; None if none is."""
    axes, normal = axes_of(normal_of(wall)), normal_of(wall)
    common = polygon_of(corners, axes).intersection(polygon_of(wall, axes))
    pieces = polygons_of(common)
    if not pieces:
        return None
    flat = np.array(max(pieces, key=lambda p: float(p.area)).representative_point().coords)
    return np.asarray(flat @ axes + normal * float(wall.mean(axis=0) @ normal))


def _shared(mend: Mending, work: Work, contact: _Contact) -> list[Any]:
    """Return the shapes, in the wall's axes, that both faces have; not those as narrow as a sliver."""
    own, wall = mend.points[work.faces[contact.face]], mend.points[work.faces[contact.wall]]
    axes = axes_of(normal_of(wall))
    ground = polygon_of(wall, axes)
    shape = shapely().snap(polygon_of(own, axes), ground, facets.WELD).intersection(ground)
    return [p for p in polygons_of(shape) if p.area > mend.weld * extent_of(_ring(p)) / 2]


def _ring(piece: Any) -> Array:
    """Return the boundary of a shape, (n, 2)."""
    return np.array(piece.exterior.coords)[:-1]


def _seen(mend: Mending, work: Work, contact: _Contact, shape: Any) -> Any:
    """Return a shape of the wall's axes in those of the object's face."""
    wall = work.faces[contact.wall]
    axes = axes_of(normal_of(mend.points[wall]))
    own = axes_of(normal_of(mend.points[work.faces[contact.face]]))
    return shapely().transform(shape, lambda flat: lifted(mend, flat, wall, axes) @ own.T)


def _tell_gaps(
    mend: Mending, work: Work, contacts: Sequence[_Contact], shell: Sequence[int]
) -> None:
    """Tell of objects that are as near to a wall as a window may be, over a whole face."""
    walls = {*shell}
    names, area, widest = [], 0.0, 0.0
    for contact in contacts:
        size = area_of(mend.points[work.faces[contact.face]])
        shared = sum(float(p.area) for p in _shared(mend, work, contact))
        if contact.wall in walls and shared > COVERED * size:
            names.append(f'"{work.names[contact.face]}" before "{work.names[contact.wall]}"')
            area += size
            widest = max(widest, contact.gap)
    if names:
        mend.found(
            "gap",
            f"faces of closed objects are up to {widest * 1000:.2g} mm before a wall, and both count; "
            f"state --weld {1.1 * widest:.2g} if they touch",
            names,
            area,
        )
