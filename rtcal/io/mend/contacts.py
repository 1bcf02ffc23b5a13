"""Closed objects that touch a face: the room has neither what they cover of it nor their own there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.io.mend.faces import (
    ANY_SHARE,
    CONTACT,
    MOST_PLACES,
    FaceSet,
    Mending,
    Polygon,
    extent_of,
    polygons_of,
    ring_of,
)
from rtcal.io.mend.shell import shell_of
from rtcal.io.mend.walls import COVERED, Cut, common, cut, is_within
from rtcal.io.mend.welding import settled
from rtcal.simulators import facets
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError

_FACING = -0.999
"""Largest product of the normals of faces that face each other."""
_BEFORE = 5e-4
"""Distance in m before a face at which there is air, or behind it at which there is none."""


@dataclass
class _Contact:
    """A face of an object before a face of a larger one, or of the room.

    ``gap`` is the width in m of the air between them; below 0 where the object reaches through.
    """

    face: int
    wall: int
    gap: float


def objects_are_within(mend: Mending, geometry: Polyhedron) -> bool:
    """Return whether every closed object of a room is in it."""
    shell, objects = shell_of(FaceSet.of_geometry(mend, geometry))
    if not objects:
        return True
    hull = shell.polyhedron()
    return all(is_within(mend, hull, part.points) for part in objects)


def without_contacts(mend: Mending, geometry: Polyhedron) -> Polyhedron:
    """Return a room without the parts of its faces on which closed objects stand or lie.

    A face of an object that is up to ``weld`` before a face of the room or of a larger object, or that
    reaches through it by up to ``offset``, is moved onto it. What they share is taken from both. A
    wider gap up to ``offset`` is noted.
    """
    part = FaceSet.of_geometry(mend, geometry)
    groups = _by_size(part)
    contacts = [*_contacts(part, geometry, groups)]
    touching = [c for c in contacts if c.gap <= mend.weld]
    _note_gaps(part, [c for c in contacts if c.gap > mend.weld], groups[0] if groups else ())
    moved = [_move(part, contact) for contact in touching]
    cuts: dict[int, list[Cut]] = {}
    area, places, unsure = 0.0, [], []
    for contact, distance in zip(touching, moved, strict=True):
        wall, own = (Polygon(part.corners(i)) for i in (contact.wall, contact.face))
        shared = _shared(part, contact)
        for shape in shared:
            seen = own.seen(shape, wall)
            cuts.setdefault(contact.wall, []).append((shape, None, ""))
            cuts.setdefault(contact.face, []).append((seen, None, ""))
            # What the object's other faces have gained or lost there.
            longer = ANY_SHARE * distance * float(shape.length)
            unsure.append((part.materials[contact.face], longer))
        if shared:
            area += sum(float(shape.area) for shape in shared)
            places.append(f'"{part.names[contact.face]}" on "{part.names[contact.wall]}"')
    if not cuts:
        return geometry
    try:
        mended = _without(part, cuts)
    except DataError as error:
        raise mend.refused(
            f"closed objects touch other faces, and both faces cannot be cut there ({error}). Draw the "
            f"objects without those faces: {'; '.join(places[:MOST_PLACES])}"
        ) from error
    volume = mended.volume - geometry.volume
    surface = float(np.sum(mended.face_areas) - np.sum(geometry.face_areas))
    mend.found("contact", CONTACT, places, area, volume, surface, unsure=unsure)
    return mended


def _move(part: FaceSet, contact: _Contact) -> float:
    """Move a face of an object onto its wall, and return the largest distance in m."""
    wall, own = Polygon(part.corners(contact.wall)), part.corners(contact.face)
    part.mend.points[part.faces[contact.face]] = wall.onto(own)
    return wall.thickness(own)


def _without(part: FaceSet, cuts: Mapping[int, Sequence[Cut]]) -> Polyhedron:
    """Return the room without some shapes of its faces; its joints may be as rough as ``weld``."""
    for weld in (2 * facets.WELD, part.mend.weld):
        fine = Mending(part.mend.drawn, weld, points=part.mend.points)
        left = settled(cut(FaceSet(fine, *zip(*part.rows(), strict=True)), cuts))
        try:
            return left.polyhedron()
        except DataError as error:
            refused = error
    raise refused


def _by_size(part: FaceSet) -> list[list[int]]:
    """Return the faces of each closed surface: the room's first, then the objects', large to small."""

    def volume(members: Sequence[int]) -> float:
        polygons = [part.corners(i) - part.mend.points[0] for i in members]
        return abs(sum(float(p[0] @ facets.vector_area(p)) for p in polygons))

    return sorted(part.components(), key=lambda members: (-volume(members), members))


def _contacts(
    part: FaceSet, geometry: Polyhedron, groups: Sequence[Sequence[int]]
) -> Iterator[_Contact]:
    """Yield the faces of objects that face one of the room's or of a larger object nearby.

    Of one closed surface, they are those that lie on each other with no air between them.
    """
    mend, polygons = part.mend, part.polygons
    walls = [Polygon(polygon) for polygon in polygons]
    low = np.array([p.min(axis=0) for p in polygons])
    high = np.array([p.max(axis=0) for p in polygons])
    rank = np.empty(len(polygons), dtype=int)
    for k, members in enumerate(groups):
        rank[list(members)] = k
    through = mend.offset + mend.weld
    limits = -through, max(mend.offset, mend.weld)
    for k, members in enumerate(groups):
        solid = geometry.triangles[np.isin(geometry.triangle_faces, members)]
        for i in members:
            near = ((low - through <= high[i]) & (low[i] <= high + through)).all(axis=1)
            near &= (rank < k) | ((rank == k) & (np.arange(len(rank)) < i))
            near &= geometry.normals @ geometry.normals[i] < _FACING
            for j in np.flatnonzero(near).tolist():
                wall, into, is_same = walls[j], -geometry.normals[j], rank[j] == k
                away = (polygons[i] - polygons[j].mean(axis=0)) @ into
                least, most = (-facets.WELD, facets.WELD) if is_same else limits
                if not least <= away.min() <= away.max() <= most:
                    continue
                pieces = polygons_of(wall.polygon(polygons[i]).intersection(wall.shape))
                if not pieces:
                    continue
                point = max(pieces, key=lambda p: float(p.area)).representative_point()
                inner = wall.lifted(np.array(point.coords))
                # A thin object on the other side of a thin wall is not behind this face of it.
                behind = inner + (max(away.max(), 0.0) + _BEFORE) * into
                if is_same:
                    before = inner - _BEFORE * geometry.normals[[i, j]]
                    if not geometry.contains(before).any():
                        yield _Contact(i, j, 0.0)
                elif abs(float(facets.winding_number(behind, solid)[0])) > 0.5:
                    yield _Contact(i, j, float(away.max()))


def _shared(part: FaceSet, contact: _Contact) -> list[Any]:
    """Return the shapes, in the wall's axes, that both faces have; not those as narrow as a sliver."""
    wall = Polygon(part.corners(contact.wall))
    shape = common(wall, part.corners(contact.face), facets.WELD)
    return [p for p in polygons_of(shape) if p.area > part.mend.weld * extent_of(ring_of(p)) / 2]


def _note_gaps(part: FaceSet, contacts: Sequence[_Contact], shell: Sequence[int]) -> None:
    """Note the objects that are as near to a wall as a window may be, over a whole face."""
    areas = part.areas
    near = [
        c
        for c in contacts
        if c.wall in shell and sum(p.area for p in _shared(part, c)) > COVERED * areas[c.face]
    ]
    if near:
        widest = max(c.gap for c in near)
        part.mend.found(
            "gap",
            f"faces of closed objects are up to {widest * 1000:.2g} mm before a wall, and both count; "
            f"state --weld {1.1 * widest:.2g} if they touch",
            [f'"{part.names[c.face]}" before "{part.names[c.wall]}"' for c in near],
            sum(areas[c.face] for c in near),
        )
