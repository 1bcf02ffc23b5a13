"""Faces and objects on walls: where they lie or stand, how they are cut in, and what lies outside.

Where a closed object touches a face, the room has neither what it covers of that face nor its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.io.mend.faces import (
    ANY_SHARE,
    CONTACT,
    MOST_PLACES,
    OFFSET,
    SAME,
    Face,
    FaceSet,
    Mending,
    Polygon,
    best_plane,
    extent_of,
    loops_of,
    polygons_of,
    ring_of,
    shapely,
)
from rtcal.io.mend.shell import shell_of, volume_by_rays
from rtcal.io.mend.welding import flattened, rejoined, settled
from rtcal.simulators.geometry import PLANARITY, WELD, Edge, Polyhedron, vector_area, winding_number
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array

_FACING = -0.999
"""Largest product of the normals of faces that face each other."""
_BEFORE = 5e-4
"""Distance in m before a face at which there is air, or behind it at which there is none."""
COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""
_MOST_OF_ROOM = 1 / 3
"""Largest share of the walls that an object covers; faces that cover more divide a room in two."""
_DONE = {
    "object": "closed objects stand by themselves",
    "overlay": "faces on a larger one take its area",
    "open bottom": "objects with an open bottom stand on a face, and take its area",
    "panel": "free panels are reflectors with two sides",
    "outside": "components outside the room are left out",
    "partly outside": "components that reach through a wall are left out; their areas, and whether "
    "the room has them, are uncertain",
    "through": "objects that reach through a wall end there",
}
_LOOSE = "components hang free, or are walls that do not meet the others"
Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""
Foot = list[tuple[int, Any]]
"""The faces on which an object stands, and the shape of it on each."""


class Walls:
    """The faces of a shell and of the objects on it, to be found by where they are."""

    def __init__(self, shell: FaceSet) -> None:
        self.mend, self.shell = shell.mend, FaceSet(shell.mend)
        self.planes, self.size = list[Polygon](), 0.0
        self._boxes, self._part_of = np.zeros((0, 2, 3)), np.zeros(0, dtype=int)
        self.add(shell)

    def add(self, part: FaceSet) -> None:
        """Add the faces of the shell, or of an object in it."""
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin = 2 * OFFSET + self.mend.weld
        boxes = [(p.min(axis=0) - margin, p.max(axis=0) + margin) for p in part.polygons]
        number = self._part_of.max(initial=-1) + 1
        self._boxes = np.concatenate([self._boxes, boxes])
        self._part_of = np.concatenate([self._part_of, np.full(len(boxes), number)])
        self.planes += map(Polygon, part.polygons)
        self.shell.extend(part)
        self.size += part.size

    def near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return the number and the plane of each face that may touch what has these corners."""
        return [(i, self.planes[i]) for i in np.flatnonzero(self._near(corners)).tolist()]

    def of_parts_near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return all faces of the shell and of each object of which one may touch these corners."""
        near = np.isin(self._part_of, self._part_of[self._near(corners)])
        return [(i, self.planes[i]) for i in np.flatnonzero(near).tolist()]

    def _near(self, corners: Array) -> Array:
        low, high = corners.min(axis=0), corners.max(axis=0)
        return np.asarray(((self._boxes[:, 0] <= high) & (low <= self._boxes[:, 1])).all(axis=1))


def overlaid_on(walls: Walls, part: FaceSet) -> list[tuple[int, list[Cut], float]] | None:
    """Return the pieces of a plane component on each wall, and how far they are; None if on none."""
    mend, corners = part.mend, part.points
    normal, thick = best_plane(corners)
    if thick > max(mend.weld, PLANARITY):
        return None
    found = list[tuple[int, list[Cut], float]]()
    for i, wall in walls.near(corners):
        distance = wall.thickness(corners)
        if abs(float(wall.normal @ normal)) < 0.99 or distance > OFFSET:
            continue
        pieces: list[Cut] = [
            (piece, material, name)
            for face, material, name in part.rows()
            for piece in polygons_of(common(wall, mend.points[face], mend.weld), mend.weld**2)
        ]
        if pieces:
            found.append((i, pieces, distance))
    nearest = min((distance for *_, distance in found), default=0.0)
    found = [each for each in found if each[2] <= nearest + mend.weld]
    total = sum(float(piece.area) for _, pieces, _ in found for piece, _, _ in pieces)
    return found if found and total >= COVERED * part.size else None


def common(wall: Polygon, corners: Array, snap: float) -> Any:
    """Return what a polygon and a wall have in common; its corners near the wall's are those."""
    return shapely().snap(wall.polygon(corners), wall.shape, snap).intersection(wall.shape)


def add_piece(part: FaceSet, wall: Polygon, piece: Any, material: str, name: str) -> None:
    """Add a piece in a wall's plane, in triangles if it has holes."""
    whole = not piece.interiors
    rings = [piece] if whole else polygons_of(shapely().constrained_delaunay_triangles(piece))
    for ring in rings:
        part.add(part.mend.new_points(wall.lifted(ring_of(ring))), material, name)


def cut(shell: FaceSet, cuts: Mapping[int, Sequence[Cut]]) -> FaceSet:
    """Return the shell with what lies on its faces in their place, the smaller first."""
    mend, out = shell.mend, FaceSet(shell.mend)
    for i, (face, material, name) in enumerate(shell.rows()):
        if i not in cuts:
            out.add(face, material, name)
            continue
        wall = Polygon(mend.points[face])
        taken = shapely().Polygon()
        smaller = sorted(cuts[i], key=lambda c: float(c[0].area))
        for shape, own, called in [*smaller, (wall.shape, material, name)]:
            for piece in polygons_of(shape.difference(taken), mend.weld**2):
                if own is not None:
                    add_piece(out, wall, piece, own, called)
            taken = taken.union(shape)
    return out


def standing_on(
    walls: Walls, part: FaceSet
) -> tuple[Foot, FaceSet, list[tuple[str, float]]] | None:
    """Return the footprint of an open object on each wall, its faces there, and how sure they are.

    It stands on the walls if its open edges lie on them and it rises from them: a panel's do not. Its
    faces that lie on a wall go. Its others gain or lose what lies between them and the wall: of each
    material there the standard uncertainty of its area in m².
    """
    if part.is_plane:
        return None  # a sheet, whose boundary its open edges are
    mend = part.mend
    on = [overlaid_on(walls, FaceSet(mend, [face], [""], [""])) for face in part.faces]
    part = part.kept([o is None or any(far > mend.weld for *_, far in o) for o in on])
    edges = part.open_edges()
    if not loops_of(edges) or part.is_plane:
        return None
    foot = _foot_of(walls, part, edges)
    if foot is None:
        return None
    found, moved = foot
    shift = {v: float(np.linalg.norm(point - mend.points[v])) for v, point in moved.items()}
    unsure: dict[str, float] = {}  # its open edges are all as far off, so their parts add
    for (a, b), face in edges.items():
        gained = ANY_SHARE * extent_of(mend.points[[a, b]]) * max(shift[a], shift[b])
        unsure[part.materials[face]] = unsure.get(part.materials[face], 0.0) + gained
    for v, point in moved.items():
        mend.points[v] = point
    return found, flattened(part), [*unsure.items()]


def ends_at_walls(walls: Walls, part: FaceSet) -> bool:
    """Return whether all open edges of a component are at walls: they are meant to close with them."""
    corners = {v for edge in part.open_edges() for v in edge}
    return not part.is_plane and all(_on_walls(walls, v)[1] for v in corners)


def _on_walls(walls: Walls, corner: int) -> tuple[Array, list[Polygon]]:
    """Return a corner moved onto the walls near it, one of each direction, and these."""
    point = walls.mend.points[corner]
    near = [(abs(float(wall.away(point))), i, wall) for i, wall in walls.near(point[np.newaxis])]
    used = list[Polygon]()
    for away, _, wall in sorted(near, key=lambda each: each[:2]):
        is_near = away <= OFFSET and wall.beside(point) <= OFFSET
        if is_near and all(abs(float(wall.normal @ other.normal)) < 0.99 for other in used):
            used.append(wall)
    for wall in 4 * used:
        point = wall.onto(point)
    return point, used


def _foot_of(
    walls: Walls, part: FaceSet, edges: Mapping[Edge, int]
) -> tuple[Foot, dict[int, Array]] | None:
    """Return what an object covers of each wall to which it is open, and its corners there.

    Its open edges divide the walls into pieces. Neighbours are of one side, but for those that meet at
    an open edge; the side of less area is covered. None if the open edges are not all on walls.
    """
    moved = {v: _on_walls(walls, v)[0] for v in sorted({v for e in edges for v in e})}
    mend = Mending(part.mend.drawn, part.mend.weld, points=part.mend.points)
    for v, point in moved.items():
        mend.points[v] = point
    lines = dict[int, list[Any]]()
    for edge in edges:
        on = _walls_of(walls, mend.points[[*edge]])
        if not on:
            return None
        for i, line in on:
            lines.setdefault(i, []).append(line)
    scene, pieces = FaceSet(mend), Foot()
    for i, wall in walls.of_parts_near(part.points):
        if i not in lines:
            scene.add(mend.new_points(wall.corners), "", str(len(pieces)))
            pieces.append((i, wall.shape))
            continue
        net = shapely().union_all([wall.shape.boundary, *lines[i]])
        for piece in polygons_of(shapely().polygonize([net]), SAME):
            if wall.shape.contains(piece.representative_point()):
                for ring in (piece.exterior, *piece.interiors):
                    scene.add(mend.new_points(wall.lifted(ring_of(ring))), "", str(len(pieces)))
                pieces.append((i, piece))
    for face in part.faces:
        scene.add(face, "", _OBJECT)
    covered = _covered(scene, [float(piece.area) for _, piece in pieces])
    if not 0 < sum(float(pieces[k][1].area) for k in covered) <= _MOST_OF_ROOM * walls.size:
        return None
    return [pieces[k] for k in covered], moved


_OBJECT = "object"


def _walls_of(walls: Walls, ends: Array) -> list[tuple[int, Any]]:
    """Return the walls on which an edge (2, 3) lies, with its line in each one's axes.

    The line is as much longer at both ends as corners may lie apart, so that it divides the wall.
    """
    weld, found = walls.mend.weld, []
    for i, wall in walls.near(ends):
        flat = ends @ wall.axes.T
        line = shapely().LineString(flat)
        on = line.intersection(wall.shape.buffer(WELD))
        if wall.thickness(ends) <= weld and float(on.length) > 0.5 * line.length:
            along = (flat[1] - flat[0]) * (weld + SAME) / line.length
            found.append((i, shapely().LineString([flat[0] - along, flat[1] + along])))
    return found


def _covered(scene: FaceSet, areas: Sequence[float]) -> list[int]:
    """Return the pieces of walls that an object covers; none if it does not divide them in two."""
    scene = rejoined(scene)
    links: list[list[tuple[int, int]]] = [[] for _ in areas]
    for faces in scene.owners().values():
        of_walls = [int(scene.names[k]) for k in faces if scene.names[k] != _OBJECT]
        if len(of_walls) == 2:
            first, second = of_walls
            crossing = (len(faces) - 2) % 2
            links[first].append((second, crossing))
            links[second].append((first, crossing))
    side: dict[int, int] = {}
    covered = list[int]()
    for start in range(len(areas)):
        if start in side:
            continue
        side[start], joined = 0, [start]
        for here in joined:  # the list grows during the loop
            for there, crossing in links[here]:
                if there not in side:
                    side[there] = side[here] ^ crossing
                    joined.append(there)
                elif side[there] != side[here] ^ crossing:
                    return []
        sizes = [sum(areas[k] for k in joined if side[k] == s) for s in (0, 1)]
        covered += [k for k in joined if side[k] == int(np.argmin(sizes))]
    return covered


def _within_walls(room: Polyhedron, part: FaceSet) -> FaceSet | None:
    """Return what is in the room of an object that reaches through walls; None where that is unclear.

    It is cut at a wall unless the wall's plane crosses it elsewhere in the room, too.
    """
    mend, is_cut = part.mend, False
    limit = OFFSET + mend.weld
    for numbers in room.faces:
        wall = Polygon(room.vertices[list(numbers)])
        away, own = wall.away(mend.points), wall.away(part.points)
        edges = [(a, b) for a, b in part.edges if away[a] * away[b] < 0]
        if not own.min() < -limit < limit < own.max() or not edges:
            continue  # what was before this wall may be cut off already
        start, end = np.array(edges).T
        shares = (away[start] / (away[start] - away[end]))[:, np.newaxis]
        crossing = mend.points[start] + shares * (mend.points[end] - mend.points[start])
        on = [wall.beside(point) <= mend.weld for point in crossing]
        section = shapely().MultiPoint(crossing @ wall.axes.T).convex_hull
        elsewhere = room.contains(crossing) & ~np.array(on)
        if elsewhere.any() or not section.intersects(wall.shape):
            continue
        new = dict(zip(edges, mend.new_points(crossing), strict=True))
        part, is_cut = _before(part, away, new), True
    return part if is_cut and part.faces else None


def _before(part: FaceSet, away: Array, new: Mapping[Edge, int]) -> FaceSet:
    """Return the faces of an object before a plane; ``new`` are the corners where its edges cross."""
    out = FaceSet(part.mend)
    for face, material, name in part.rows():
        left: Face = []
        for a, b in zip([face[-1], *face[:-1]], face, strict=True):
            if (edge := (min(a, b), max(a, b))) in new:
                left.append(new[edge])
            if away[b] <= 0:
                left.append(b)
        if len(left) > 2:
            out.add(left, material, name)
    return out


def _volume_over(walls: Walls, stood: FaceSet, feet: Foot) -> float:
    """Return the volume in m³ between the faces of an object and its footprints."""
    whole = stood.of(range(len(stood.faces)))
    for i, piece in feet:
        add_piece(whole, walls.planes[i], piece, "", "")
    try:
        return float(whole.polyhedron().volume)
    except DataError:  # the footprint was drawn a little beside it
        return volume_by_rays(whole.polygons)[0]


def _add_slab(shell: FaceSet, face: Face, material: str, name: str) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    mend = shell.mend
    plane = Polygon(mend.points[face])
    half = plane.normal * THICKNESS / 2
    for piece in polygons_of(plane.shape.buffer(-THICKNESS / 2, join_style="mitre")):
        corners = plane.lifted(ring_of(piece))
        front, back = mend.new_points(corners + half), mend.new_points(corners - half)
        shell.add(front, material, name)
        shell.add(back[::-1], material, f"{name} back")
        for k in range(len(front)):
            shell.add((front[k], front[k - 1], back[k - 1], back[k]), material, f"{name} edge")


def _kind_of(walls: Walls, part: FaceSet) -> tuple[str, Any]:
    """Return what a component is beside these walls, with its pieces or its foot on them."""
    if not part.open_edges():
        return "object", None
    if (pieces := overlaid_on(walls, part)) is not None:
        return "overlay", pieces
    if (foot := standing_on(walls, part)) is not None:
        return "open bottom", foot
    return "panel", None


def note_loose(shell: FaceSet, others: Sequence[FaceSet]) -> None:
    """Note what else there is where the shell is open; nothing is cut, since nothing is in a room."""
    walls = Walls(shell)
    for part in others:
        kind, _ = _kind_of(walls, part)
        done = _LOOSE if kind == "panel" else _DONE[kind]
        shell.mend.found(kind, done, part.names[:1], part.size)


def with_others(shell: FaceSet, others: Sequence[FaceSet]) -> FaceSet:
    """Return the shell with overlays, objects and panels; what lies outside is left out."""
    if not others:
        return shell
    mend, hull, walls = shell.mend, shell.polyhedron(), Walls(shell)
    cuts: dict[int, list[Cut]] = {}
    panels, outside = list[FaceSet](), FaceSet(mend)

    def note(
        kind: str, part: FaceSet, volume: float = 0.0, surface: float = 0.0, unsure: Any = ()
    ) -> None:
        mend.found(kind, _DONE[kind], part.names[:1], part.size, volume, surface, 0.0, unsure)

    for part in _in_order([_ending_at_walls(hull, part) for part in others]):
        if not is_within(mend, hull, part.points):
            reaches = _reaches_into(hull, part)
            shares = zip(part.materials, np.multiply(ANY_SHARE, part.areas), strict=True)
            note("partly outside" if reaches else "outside", part, unsure=shares if reaches else ())
            if part.open_edges():
                outside.extend(part)
            continue
        kind, on = _kind_of(walls, part)
        if kind == "object":
            walls.add(part)
        elif kind == "overlay":
            for wall, pieces, _ in on:
                cuts.setdefault(wall, []).extend(pieces)
            rows = [(*piece, far) for _, pieces, far in on for piece in pieces]
            moved = sum(far * float(shape.area) for shape, *_, far in rows)
            # The reveal from the wall to the face is not drawn; it may be of the face's material.
            reveals = [(m, ANY_SHARE * far * float(shape.length)) for shape, m, _, far in rows]
            note(kind, part, moved, -part.size, reveals)
        elif kind == "open bottom":
            feet, stood, unsure = on
            for wall, footprint in feet:
                cuts.setdefault(wall, []).append((footprint, None, ""))
            covered = sum(float(footprint.area) for _, footprint in feet)
            note(kind, part, -_volume_over(walls, stood, feet), stood.size - covered, unsure)
            walls.add(stood)
        elif ends_at_walls(walls, part):
            raise mend.refused(
                f'"{part.names[0]}" and the faces joined to it end at walls on all sides, and what '
                "they enclose with them is not found, or is over a third of the room: draw the missing "
                "faces, or, if they divide the room, leave the other side out"
            )
        else:
            panels.append(part)
            note(kind, part, -THICKNESS * part.size, part.size)
    shell = walls.shell
    _require_shell(shell, outside)
    if cuts:
        shell = settled(cut(shell, cuts))
    for part in panels:
        for row in part.rows():
            _add_slab(shell, *row)
    return shell


def _ending_at_walls(hull: Polyhedron, part: FaceSet) -> FaceSet:
    """Return a component, or of an object that reaches through the walls what is in the room."""
    mend = part.mend
    if part.is_plane or is_within(mend, hull, part.points):
        return part
    inside = _within_walls(hull, part)
    if inside is None or not is_within(mend, hull, inside.points):
        return part
    mend.found("through", _DONE["through"], part.names[:1], part.size - inside.size)
    return inside


def _require_shell(shell: FaceSet, outside: FaceSet) -> None:
    """Raise MeshError if what is left out as outside are the walls, and the shell is an object."""
    if not outside.faces:
        return
    around, held = outside.points, shell.points
    encloses = (around.min(axis=0) <= held.min(axis=0)).all()
    encloses &= (around.max(axis=0) >= held.max(axis=0)).all()
    if encloses and outside.size > shell.size:
        raise shell.mend.refused(
            f'the largest closed part, which begins with "{shell.names[0]}", is no room: faces of '
            f"{rounded(outside.size, 3)} m² lie around it and do not close. Draw each wall once, and "
            "let neighbours have the same corners"
        )


def _in_order(parts: Sequence[FaceSet]) -> list[FaceSet]:
    """Return closed objects first, then open ones from large to small, then plane ones as drawn.

    Each may stand or lie on those before.
    """

    def key(part: FaceSet) -> tuple[bool, bool, float]:
        return bool(part.open_edges()), part.is_plane, 0.0 if part.is_plane else -part.size

    return sorted(parts, key=key)


def is_within(mend: Mending, hull: Polyhedron, corners: Array) -> bool:
    """Return whether a component is in the room: its corners, but for those at the walls, are."""
    outside = corners[~hull.contains(corners)]
    return not (hull.wall_distance(outside) > OFFSET + mend.weld).any()


def _reaches_into(hull: Polyhedron, part: FaceSet) -> bool:
    """Return whether an edge of a component is in the room, and not merely at its walls."""
    ends = part.mend.points[part.edges]
    shares = np.linspace(0, 1, 9)[:, np.newaxis, np.newaxis]
    points = (ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    inside = points[hull.contains(points)]
    return bool((hull.wall_distance(inside) > OFFSET + part.mend.weld).any())


@dataclass
class _Contact:
    """A face of an object before a face of a larger one, or of the room.

    ``gap`` is the width in m of the air between them; below 0 where the object reaches through.
    """

    face: int
    wall: int
    gap: float


def _of_geometry(mend: Mending, geometry: Polyhedron) -> FaceSet:
    """Return the faces of a room, whose vertices become the points."""
    mend.points = np.array(geometry.vertices)
    return FaceSet(mend, map(list, geometry.faces), geometry.materials, geometry.names)


def objects_are_within(mend: Mending, geometry: Polyhedron) -> bool:
    """Return whether every closed object of a room is in it."""
    shell, objects = shell_of(_of_geometry(mend, geometry))
    if not objects:
        return True
    hull = shell.polyhedron()
    return all(is_within(mend, hull, part.points) for part in objects)


def without_contacts(mend: Mending, geometry: Polyhedron) -> Polyhedron:
    """Return a room without the parts of its faces on which closed objects stand or lie.

    A face of an object that is up to ``weld`` before a face of the room or of a larger object, or that
    reaches through it by up to `OFFSET`, is moved onto it. What they share is taken from both. A
    wider gap up to `OFFSET` is noted.
    """
    part = _of_geometry(mend, geometry)
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
    for weld in (2 * WELD, part.mend.weld):
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
        return abs(sum(float(p[0] @ vector_area(p)) for p in polygons))

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
    through = OFFSET + mend.weld
    limits = -through, max(OFFSET, mend.weld)
    for k, members in enumerate(groups):
        solid = geometry.triangles[np.isin(geometry.triangle_faces, members)]
        for i in members:
            near = ((low - through <= high[i]) & (low[i] <= high + through)).all(axis=1)
            near &= (rank < k) | ((rank == k) & (np.arange(len(rank)) < i))
            near &= geometry.normals @ geometry.normals[i] < _FACING
            for j in np.flatnonzero(near).tolist():
                wall, into, is_same = walls[j], -geometry.normals[j], rank[j] == k
                away = (polygons[i] - polygons[j].mean(axis=0)) @ into
                least, most = (-WELD, WELD) if is_same else limits
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
                elif abs(float(winding_number(behind, solid)[0])) > 0.5:
                    yield _Contact(i, j, float(away.max()))


def _shared(part: FaceSet, contact: _Contact) -> list[Any]:
    """Return the shapes, in the wall's axes, that both faces have; not those as narrow as a sliver."""
    wall = Polygon(part.corners(contact.wall))
    shape = common(wall, part.corners(contact.face), WELD)
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
