"""Faces and objects on walls: where they lie or stand, how they are cut in, and what lies outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.io.mend.faces import (
    ANY_SHARE,
    SAME,
    Face,
    Mending,
    Unclosed,
    Work,
    area_of,
    axes_of,
    edges_of,
    extent_of,
    loops_of,
    normal_of,
    open_edges,
    owners,
    plane_of,
    polygon_of,
    polygons_of,
    shapely,
    sorted_edge,
    volume_by_rays,
)
from rtcal.io.mend.welding import flattened, resnapped, rewelded, settled
from rtcal.simulators.facets import WELD
from rtcal.simulators.geometry import PLANARITY, Polyhedron
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array

COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""


class Walls:
    """The faces of a shell, to be found by where they are."""

    def __init__(self, mend: Mending, shell: Work) -> None:
        self.faces, self._mend = shell.faces, mend
        starts = np.cumsum([0, *map(len, shell.faces)])[:-1]
        corners = mend.points[np.concatenate(shell.faces)]
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin = 2 * mend.offset + mend.weld
        self._low = np.minimum.reduceat(corners, starts) - margin
        self._high = np.maximum.reduceat(corners, starts) + margin

    def near(self, corners: Array) -> list[tuple[int, Array]]:
        """Return the number and the corners of each face that may touch what has these corners."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        near = ((self._low <= high) & (low <= self._high)).all(axis=1)
        return [(i, self._mend.points[self.faces[i]]) for i in np.flatnonzero(near).tolist()]


def overlaid_on(
    mend: Mending, walls: Walls, part: Work
) -> list[tuple[int, list[Cut], float]] | None:
    """Return the pieces of a plane component on each wall; None if it lies on none."""
    corners = mend.corners(part)
    normal, thick = plane_of(corners)
    if thick > max(mend.weld, PLANARITY):
        return None
    found = list[tuple[int, list[Cut], float]]()
    for i, base in walls.near(corners):
        wall = normal_of(base)
        distance = np.abs((corners - base.mean(axis=0)) @ wall).max()
        if abs(float(wall @ normal)) < 0.99 or distance > mend.offset:
            continue
        axes = axes_of(wall)
        ground = polygon_of(base, axes)
        pieces = list[Cut]()
        for own, material, name in zip(part.faces, part.materials, part.names, strict=True):
            shape = shapely().snap(polygon_of(mend.points[own], axes), ground, mend.weld)
            for piece in polygons_of(shape.intersection(ground)):
                if piece.area > mend.weld**2:
                    pieces.append((piece, material, name))
        if pieces:
            found.append((i, pieces, float(distance)))
    nearest = min((distance for _, _, distance in found), default=0.0)
    found = [each for each in found if each[2] <= nearest + mend.weld]
    total = sum(float(piece.area) for _, pieces, _ in found for piece, _, _ in pieces)
    size = sum(area_of(mend.points[f]) for f in part.faces)
    if not found or total < COVERED * size:
        return None
    return found


def add_piece(mend: Mending, added: Work, wall: Face, piece: Any, material: str, name: str) -> None:
    """Add a piece in a wall's plane, in triangles if it has holes."""
    axes = axes_of(normal_of(mend.points[wall]))
    rings = (
        [piece.exterior]
        if not piece.interiors
        else [t.exterior for t in polygons_of(shapely().constrained_delaunay_triangles(piece))]
    )
    for ring in rings:
        flat = np.array(ring.coords)[:-1]
        added.add(new_points(mend, lifted(mend, flat, wall, axes)), material, name)


def lifted(mend: Mending, flat: Array, wall: Face, axes: Array) -> Array:
    """Return points of a wall's plane, (n, 2), in space; those on its boundary as it is drawn."""
    base, normal = mend.points[wall], normal_of(mend.points[wall])
    lifted = np.asarray(flat @ axes + normal * float(base.mean(axis=0) @ normal))
    for k in range(len(wall)):
        start, along = axes @ base[k - 1], axes @ (base[k] - base[k - 1])
        share = np.clip((flat - start) @ along / (along @ along), 0, 1)
        away = np.linalg.norm(flat - start - share[:, np.newaxis] * along, axis=1)
        on_edge = away < 1e-5
        lifted[on_edge] = base[k - 1] + share[on_edge, np.newaxis] * (base[k] - base[k - 1])
    return lifted


def new_points(mend: Mending, corners: Array) -> list[int]:
    """Add corners (n, 3) in m, and return their numbers."""
    first = len(mend.points)
    mend.points = np.concatenate([mend.points, corners])
    return list(range(first, first + len(corners)))


def cut(mend: Mending, shell: Work, cuts: Mapping[int, Sequence[Cut]]) -> Work:
    """Return the shell with what lies on its faces in their place, the smaller first."""
    out = Work()
    for i, (face, material, name) in enumerate(
        zip(shell.faces, shell.materials, shell.names, strict=True)
    ):
        if i not in cuts:
            out.add(face, material, name)
            continue
        ground = polygon_of(mend.points[face], axes_of(normal_of(mend.points[face])))
        taken = shapely().Polygon()
        for shape, own, called in [
            *sorted(cuts[i], key=lambda c: float(c[0].area)),
            (ground, material, name),
        ]:
            for piece in polygons_of(shape.difference(taken)):
                if own is not None and piece.area > mend.weld**2:
                    add_piece(mend, out, face, piece, own, called)
            taken = taken.union(shape)
    return out


def is_plane(mend: Mending, part: Work) -> bool:
    """Return whether a component is a sheet: all its corners are near one plane."""
    return plane_of(mend.corners(part))[1] <= mend.weld


def standing_on(
    mend: Mending, walls: Walls, part: Work
) -> tuple[list[tuple[int, Any]], Work, list[tuple[str, float]]] | None:
    """Return the footprint of an open object on each wall, its faces there, and how sure they are.

    It stands on the walls if its open edges lie on them and it rises from them: a panel's do not. Its
    faces that lie on a wall go. Its others gain or lose what lies between them and the wall: of each
    material there the standard uncertainty of its area in m².
    """
    if is_plane(mend, part):
        return None  # a sheet, whose boundary its open edges are
    part = part.kept([not _lies_on(mend, walls, face) for face in part.faces])
    loops = loops_of(open_edges(mend, part))
    if not loops or is_plane(mend, part):
        return None
    feet = [_foot_of(mend, walls, loop) for loop in loops]
    found = [each for foot in feet if foot is not None for each in foot[0]]
    moved = {v: point for foot in feet if foot is not None for v, point in foot[1].items()}
    if None in feet:
        several = _feet_of(mend, walls, part)
        if several is None:
            return None
        found, moved = several
    shift = {v: float(np.linalg.norm(point - mend.points[v])) for v, point in moved.items()}
    unsure: dict[str, float] = {}  # its open edges are all as far off, so their parts add
    for (a, b), face in open_edges(mend, part).items():
        gained = ANY_SHARE * extent_of(mend.points[[a, b]]) * max(shift[a], shift[b])
        unsure[part.materials[face]] = unsure.get(part.materials[face], 0.0) + gained
    for v, point in moved.items():
        mend.points[v] = point
    return found, flattened(mend, part), [*unsure.items()]


def _lies_on(mend: Mending, walls: Walls, face: Face) -> bool:
    """Return whether a face lies on walls, within the distance within which corners are one."""
    flat = overlaid_on(mend, walls, Work([face], [""], [""]))
    return flat is not None and all(distance <= mend.weld for _, _, distance in flat)


def _foot_of(
    mend: Mending, walls: Walls, loop: Face
) -> tuple[list[tuple[int, Any]], dict[int, Array]] | None:
    """Return what an open edge encloses on the nearest walls, and its corners there; else None."""
    corners, size = mend.points[loop], area_of(mend.points[loop])
    away = {i: (corners - b.mean(axis=0)) @ normal_of(b) for i, b in walls.near(corners)}
    over = dict[int, list[Any]]()
    for i, distance in away.items():
        if np.abs(distance).max() <= mend.offset:
            base = mend.points[walls.faces[i]]
            axes = axes_of(normal_of(base))
            common = polygon_of(corners, axes).intersection(polygon_of(base, axes))
            over[i] = [p for p in polygons_of(common) if p.area > SAME]
    nearest = min((float(np.abs(away[i]).max()) for i in over if over[i]), default=np.inf)
    found, moved = list[tuple[int, Any]](), dict[int, Array]()
    for i, pieces in over.items():
        if np.abs(away[i]).max() > nearest + mend.weld:
            continue  # a wall behind the nearest, such as the back of a board
        found += [(i, piece) for piece in pieces]
        base = mend.points[walls.faces[i]]
        axes, normal = axes_of(normal_of(base)), normal_of(base)
        ground = polygon_of(base, axes)
        for v, distance in zip(loop, away[i], strict=True):
            if ground.distance(shapely().Point(*(axes @ mend.points[v]))) < SAME:
                moved[v] = mend.points[v] - normal * float(distance)
    if sum(piece.area for _, piece in found) < COVERED * size or len(moved) < len(loop):
        return None
    return found, moved


_MOST_OF_ROOM = 1 / 3
"""Largest share of the walls that an object covers; faces that cover more divide a room in two."""


def at_walls(mend: Mending, walls: Walls, part: Work) -> bool:
    """Return whether all open edges of a component are at walls: they are meant to close with them."""
    corners = sorted({v for edge in open_edges(mend, part) for v in edge})
    return all(_on_walls(mend, walls, v)[1] for v in corners)


def _on_walls(mend: Mending, walls: Walls, corner: int) -> tuple[Array, list[int]]:
    """Return a corner moved onto the walls near it, one of each direction, and their numbers."""
    point, near = mend.points[corner], list[tuple[float, int]]()
    for i, base in walls.near(point[np.newaxis]):
        axes, normal = axes_of(normal_of(base)), normal_of(base)
        away = abs(float((point - base.mean(axis=0)) @ normal))
        beside = polygon_of(base, axes).distance(shapely().Point(*(axes @ point)))
        if max(away, beside) <= mend.offset:
            near.append((away, i))
    used = list[int]()
    normals = list[Array]()
    for _, i in sorted(near):
        base = mend.points[walls.faces[i]]
        normal = normal_of(base)
        if all(abs(float(normal @ other)) < 0.99 for other in normals):
            normals.append(normal)
            used.append(i)
    for _ in range(4):
        for i in used:
            base = mend.points[walls.faces[i]]
            normal = normal_of(base)
            point = point - normal * float((point - base.mean(axis=0)) @ normal)
    return point, used


def _feet_of(
    mend: Mending, walls: Walls, part: Work
) -> tuple[list[tuple[int, Any]], dict[int, Array]] | None:
    """Return what an object that is open to several walls covers of each, and its corners there.

    Its open edges divide the walls into pieces. Neighbours are of one side, but for those that meet at
    an open edge; the side of less area is covered. None if the open edges are not all on walls.
    """
    edges = list(open_edges(mend, part))
    moved = {v: _on_walls(mend, walls, v)[0] for v in sorted({v for e in edges for v in e})}
    fine = Mending(mend.drawn, mend.weld, 0.0, None)
    fine.points = np.array(mend.points)
    for v, point in moved.items():
        fine.points[v] = point
    lines = dict[int, list[Any]]()
    for edge in edges:
        on = _walls_of(fine, walls, edge)
        if not on:
            return None
        for i, line in on:
            lines.setdefault(i, []).append(line)
    scene, pieces = _divided(fine, walls, lines)
    for face in part.faces:
        scene.add(face, "", _OBJECT)
    side = _sides(fine, scene, len(pieces))
    if side is None:
        return None
    sizes = [0.0, 0.0]
    for (i, piece), k in zip(pieces, side, strict=True):
        sizes[k] += area_of(fine.points[walls.faces[i]]) if piece is None else float(piece.area)
    covered = int(np.argmin(sizes))
    if not 0 < sizes[covered] <= _MOST_OF_ROOM * sum(sizes):
        return None
    found = list[tuple[int, Any]]()
    for (i, piece), k in zip(pieces, side, strict=True):
        if k == covered:
            base = fine.points[walls.faces[i]]
            whole = polygon_of(base, axes_of(normal_of(base))) if piece is None else piece
            found.append((i, whole))
    return found, moved


_OBJECT = "object"


def _walls_of(mend: Mending, walls: Walls, edge: tuple[int, int]) -> list[tuple[int, Any]]:
    """Return the walls on which an edge lies, with its line in each one's axes.

    The line is as much longer at both ends as corners may lie apart, so that it divides the wall.
    """
    ends, found = mend.points[list(edge)], []
    for i, base in walls.near(ends):
        axes, normal = axes_of(normal_of(base)), normal_of(base)
        flat = ends @ axes.T
        along = flat[1] - flat[0]
        line = shapely().LineString(flat)
        on = np.abs((ends - base.mean(axis=0)) @ normal).max() <= mend.weld
        ground = polygon_of(base, axes)
        if on and float(line.intersection(ground.buffer(WELD)).length) > 0.5 * line.length:
            along *= (mend.weld + SAME) / np.linalg.norm(along)
            found.append((i, shapely().LineString([flat[0] - along, flat[1] + along])))
    return found


def _divided(
    mend: Mending, walls: Walls, lines: Mapping[int, Sequence[Any]]
) -> tuple[Work, list[tuple[int, Any]]]:
    """Return the walls' pieces between lines, each named by its number; and wall and shape of each."""
    scene, pieces = Work(), list[tuple[int, Any]]()
    for i, face in enumerate(walls.faces):
        if i not in lines:
            scene.add(face, "", str(len(pieces)))
            pieces.append((i, None))
            continue
        axes = axes_of(normal_of(mend.points[face]))
        ground = polygon_of(mend.points[face], axes)
        net = shapely().union_all([ground.boundary, *lines[i]])
        for piece in polygons_of(shapely().polygonize([net])):
            if piece.area > SAME and ground.contains(piece.representative_point()):
                for ring in (piece.exterior, *piece.interiors):
                    flat = np.array(ring.coords)[:-1]
                    corners = new_points(mend, lifted(mend, flat, face, axes))
                    scene.add(corners, "", str(len(pieces)))
                pieces.append((i, piece))
    return scene, pieces


def _sides(mend: Mending, scene: Work, number: int) -> list[int] | None:
    """Return the side, 0 or 1, of each piece of the walls; None if an object does not divide them."""
    scene = resnapped(mend, rewelded(mend, scene))
    links: list[list[tuple[int, int]]] = [[] for _ in range(number)]
    for faces in owners(mend, scene.faces).values():
        of_walls = [int(scene.names[k]) for k in faces if scene.names[k] != _OBJECT]
        if len(of_walls) == 2:
            first, second = of_walls
            crossing = (len(faces) - 2) % 2
            links[first].append((second, crossing))
            links[second].append((first, crossing))
    side = [-1] * number
    for start in range(number):
        if side[start] >= 0:
            continue
        side[start] = 0
        queue = [start]
        for here in queue:  # the list grows during the loop
            for there, crossing in links[here]:
                if side[there] < 0:
                    side[there] = side[here] ^ crossing
                    queue.append(there)
                elif side[there] != side[here] ^ crossing:
                    return None
    return side


def within_walls(mend: Mending, room: Polyhedron, part: Work) -> Work | None:
    """Return what is in the room of an object that reaches through walls; None where that is unclear.

    It is cut at a wall unless the wall's plane crosses it elsewhere in the room, too.
    """
    limit, is_cut = mend.offset + mend.weld, False
    for numbers, normal in zip(room.faces, room.normals, strict=True):
        wall = room.vertices[list(numbers)]
        away = (mend.points - wall.mean(axis=0)) @ normal
        own = away[sorted({v for face in part.faces for v in face})]
        if not own.min() < -limit < limit < own.max():
            continue
        edges = sorted({sorted_edge(*e) for face in part.faces for e in edges_of(face)})
        edges = [(a, b) for a, b in edges if away[a] * away[b] < 0]
        if not edges:
            continue  # what was before this wall is cut off already
        shares = np.array([away[a] / (away[a] - away[b]) for a, b in edges])[:, np.newaxis]
        start, end = (mend.points[[edge[k] for edge in edges]] for k in (0, 1))
        crossing = start + shares * (end - start)
        axes = axes_of(normal)
        ground = polygon_of(wall, axes)
        on = [ground.distance(shapely().Point(*flat)) <= mend.weld for flat in crossing @ axes.T]
        section = shapely().MultiPoint(crossing @ axes.T).convex_hull
        elsewhere = room.contains(crossing) & ~np.array(on)
        if elsewhere.any() or not section.intersects(ground):
            continue
        new = dict(zip(edges, new_points(mend, crossing), strict=True))
        part, is_cut = _before(part, away, new), True
    return part if is_cut and part.faces else None


def _before(part: Work, away: Array, new: Mapping[tuple[int, int], int]) -> Work:
    """Return the faces of an object before a plane; ``new`` are the corners where its edges cross."""
    out = Work()
    for face, material, name in zip(part.faces, part.materials, part.names, strict=True):
        left: Face = []
        for a, b in edges_of(face):
            if sorted_edge(a, b) in new:
                left.append(new[sorted_edge(a, b)])
            if away[b] <= 0:
                left.append(b)
        if len(left) > 2:
            out.add(left, material, name)
    return out


def volume_over(mend: Mending, walls: Walls, stood: Work, feet: Sequence[tuple[int, Any]]) -> float:
    """Return the volume in m³ between the faces of an object and its footprints."""
    whole = Work(list(stood.faces), list(stood.materials), list(stood.names))
    for i, piece in feet:
        add_piece(mend, whole, walls.faces[i], piece, "", "")
    polygons = [mend.points[face] for face in whole.faces]
    try:
        closed = Polyhedron.from_polygons(
            [(str(k), str(k), polygon) for k, polygon in enumerate(polygons)]
        )
    except DataError:  # the footprint was drawn a little beside it
        return volume_by_rays(polygons)[0]
    return float(closed.volume)


THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""


def add_slab(mend: Mending, shell: Work, face: Face, material: str, name: str) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    axes = axes_of(normal_of(mend.points[face]))
    inner = polygon_of(mend.points[face], axes).buffer(-THICKNESS / 2, join_style="mitre")
    for piece in polygons_of(inner):
        half = normal_of(mend.points[face]) * THICKNESS / 2
        corners = lifted(mend, np.array(piece.exterior.coords)[:-1], face, axes)
        front = new_points(mend, corners + half)
        back = new_points(mend, corners - half)
        shell.add(front, material, name)
        shell.add(back[::-1], material, f"{name} back")
        for k in range(len(front)):
            j = (k + 1) % len(front)
            shell.add((front[j], front[k], back[k], back[j]), material, f"{name} edge")


def tell_turned(mend: Mending, geometry: Polyhedron) -> None:
    """Note the drawn faces whose orientation differs from that of most."""
    normals = {
        _key_of(np.asarray(p)): normal_of(np.asarray(p)) for p in mend.drawn.polygons if len(p) > 2
    }
    agree = {}
    for name, face, normal in zip(geometry.names, geometry.faces, geometry.normals, strict=True):
        drawn = normals.get(_key_of(geometry.vertices[list(face)]))
        if drawn is not None:
            agree[name] = float(drawn @ normal) > 0
    against = [n for n, same in agree.items() if not same]
    if len(against) > len(agree) / 2:
        against = [n for n, same in agree.items() if same]
    if against:
        mend.found("turned", "faces with the other orientation than most are turned", against)


def _key_of(corners: Array) -> tuple[float, ...]:
    return tuple(np.round(corners.mean(axis=0), 3).tolist())


_LOOSE = {
    "object": "closed objects stand by themselves",
    "overlay": "components lie on larger faces",
    "open bottom": "objects with an open bottom stand on faces",
    "panel": "components hang free, or are walls that do not meet the others",
}


def tell_loose(mend: Mending, shell: Work, others: Sequence[Work]) -> None:
    """Note what else there is where the shell is open; nothing is cut, since nothing is in a room."""
    told: dict[str, list[tuple[str, float]]] = {}
    walls = Walls(mend, shell)
    for part in others:
        if not open_edges(mend, part):
            kind = "object"
        elif overlaid_on(mend, walls, part) is not None:
            kind = "overlay"
        elif standing_on(mend, walls, part) is not None:
            kind = "open bottom"
        else:
            kind = "panel"
        size = _size(mend, part)
        told.setdefault(kind, []).append((part.names[0], size))
    for kind, rows in told.items():
        mend.found(kind, _LOOSE[kind], [name for name, _ in rows], sum(size for _, size in rows))


def unclosed_room(mend: Mending, shell: Work, others: Sequence[Work]) -> Unclosed:
    """Return the room whose shell is open: V by rays, areas as drawn.

    Rays cross the shell and closed objects. They cross all faces where the shell has less than half of
    the area: then the walls do not meet.
    """
    areas: dict[str, float] = {}
    for part in (shell, *others):
        for face, material in zip(part.faces, part.materials, strict=True):
            areas[material] = areas.get(material, 0.0) + area_of(mend.points[face])
    whole = 2 * sum(area_of(mend.points[f]) for f in shell.faces) > sum(areas.values())
    crossed = [p for p in others if not whole or not open_edges(mend, p)]
    polygons = [mend.points[face] for part in (shell, *crossed) for face in part.faces]
    volume, uncertainty = volume_by_rays(polygons)
    size = tuple(np.ptp(mend.corners(shell), axis=0).tolist())
    return Unclosed(volume, uncertainty, areas, tuple(mend.defects), mend.drawn.notes, size)


def with_others(mend: Mending, shell: Work, others: Sequence[Work]) -> Work:
    """Return the shell with overlays, objects and panels; what lies outside is left out."""
    if not others:
        return shell
    hull = Polyhedron(
        vertices=mend.points, faces=[tuple(f) for f in shell.faces], materials=shell.materials
    )
    cuts: dict[int, list[Cut]] = {}
    panels, outside = list[Work](), Work()
    told: dict[str, list[tuple[str, float, float, float]]] = {}
    reveals: list[tuple[str, float]] = []
    across: list[tuple[str, float]] = []
    feet_unsure: list[tuple[str, float]] = []
    shell = shell.of(range(len(shell.faces)))
    walls = Walls(mend, shell)

    def tell(kind: str, part: Work, size: float, volume: float, surface: float) -> None:
        told.setdefault(kind, []).append((part.names[0], size, volume, surface))

    beyond: list[tuple[str, float]] = []
    for k, part in enumerate(others := list(others)):
        if not is_plane(mend, part) and not within(mend, hull, mend.corners(part)):
            inside = within_walls(mend, hull, part)
            if inside is not None and within(mend, hull, mend.corners(inside)):
                beyond.append((part.names[0], _size(mend, part) - _size(mend, inside)))
                others[k] = inside
    if beyond:
        done = "objects that reach through a wall end there"
        names, sizes = zip(*beyond, strict=True)
        mend.found("through", done, names, sum(sizes))
    for part in _in_order(mend, others):
        size = _size(mend, part)
        if not within(mend, hull, mend.corners(part)):
            is_across = _reaches_into(mend, hull, part)
            tell("partly outside" if is_across else "outside", part, size, 0.0, 0.0)
            if open_edges(mend, part):
                outside.extend(part)
            if is_across:
                across += [
                    (str(m), ANY_SHARE * area_of(mend.points[f]))
                    for m, f in zip(part.materials, part.faces, strict=True)
                ]
        elif not open_edges(mend, part):
            shell.extend(part)
            walls = Walls(mend, shell)
        elif (flat := overlaid_on(mend, walls, part)) is not None:
            moved = 0.0
            for wall, pieces, distance in flat:
                cuts.setdefault(wall, []).extend(pieces)
                moved += sum(distance * piece.area for piece, _, _ in pieces)
                # The reveal from the wall to the face is not drawn; it may be of the face's material.
                reveals += [(str(m), ANY_SHARE * distance * p.length) for p, m, _ in pieces]
            tell("overlay", part, size, moved, -size)
        elif (foot := standing_on(mend, walls, part)) is not None:
            feet, stood, moved_by = foot
            feet_unsure += moved_by
            for wall, footprint in feet:
                cuts.setdefault(wall, []).append((footprint, None, ""))
            covered = sum(footprint.area for _, footprint in feet)
            rise = _size(mend, stood)
            volume = volume_over(mend, walls, stood, feet)
            tell("open bottom", part, size, -volume, rise - covered)
            shell.extend(stood)
            walls = Walls(mend, shell)
        elif not is_plane(mend, part) and at_walls(mend, walls, part):
            raise mend.refused(
                f'"{part.names[0]}" and the faces joined to it end at walls on all sides, and what '
                "they enclose with them is not found, or is over a third of the room: draw the missing "
                "faces, or, if they divide the room, leave the other side out"
            )
        else:
            panels.append(part)
            tell("panel", part, size, -THICKNESS * size, size)
    unsure = {"overlay": reveals, "partly outside": across, "open bottom": feet_unsure}
    _require_shell(mend, shell, outside)
    _tell_others(mend, told, unsure)
    shell = cut(mend, shell, cuts)
    if cuts:
        shell = settled(mend, shell)
    for part in panels:
        for face, material, name in zip(part.faces, part.materials, part.names, strict=True):
            add_slab(mend, shell, face, material, name)
    return shell


def _size(mend: Mending, part: Work) -> float:
    """Return the area of a component in m²."""
    return sum(area_of(mend.points[face]) for face in part.faces)


def _require_shell(mend: Mending, shell: Work, outside: Work) -> None:
    """Raise MeshError if what is left out as outside are the walls, and the shell is an object."""
    if not outside.faces:
        return
    around, within_them = mend.corners(outside), mend.corners(shell)
    larger = _size(mend, outside)
    encloses = (around.min(axis=0) <= within_them.min(axis=0)).all()
    encloses &= (around.max(axis=0) >= within_them.max(axis=0)).all()
    if encloses and larger > _size(mend, shell):
        raise mend.refused(
            f'the largest closed part, which begins with "{shell.names[0]}", is no room: faces of '
            f"{rounded(larger, 3)} m² lie around it and do not close. Draw each wall once, and let "
            "neighbours have the same corners"
        )


def _in_order(mend: Mending, parts: Sequence[Work]) -> list[Work]:
    """Return closed objects first, then open ones from large to small, then plane ones as drawn.

    Each may stand or lie on those before.
    """

    def key(part: Work) -> tuple[bool, bool, float]:
        plane = is_plane(mend, part)
        size = 0.0 if plane else _size(mend, part)
        return bool(open_edges(mend, part)), plane, -size

    return sorted(parts, key=key)


def _tell_others(
    mend: Mending,
    told: Mapping[str, Sequence[tuple[str, float, float, float]]],
    unsure: Mapping[str, Sequence[tuple[str, float]]],
) -> None:
    words = {
        "overlay": "faces on a larger one take its area",
        "open bottom": "objects with an open bottom stand on a face, and take its area",
        "panel": "free panels are reflectors with two sides",
        "outside": "components outside the room are left out",
        "partly outside": "components that reach through a wall are left out; their areas, and whether "
        "the room has them, are uncertain",
    }
    for kind, rows in told.items():
        area, volume, surface = np.sum([row[1:] for row in rows], axis=0).tolist()
        uncertainty = abs(volume) / np.sqrt(3) if kind == "overlay" else 0.0
        names = [row[0] for row in rows]
        mend.found(
            kind,
            words[kind],
            names,
            area,
            volume,
            surface,
            float(uncertainty),
            unsure=unsure.get(kind, ()),
        )


def within(mend: Mending, hull: Polyhedron, corners: Array) -> bool:
    """Return whether a component is in the room: its corners, but for those at the walls, are."""
    outside = corners[~hull.contains(corners)]
    return not (hull.wall_distance(outside) > mend.offset + mend.weld).any()


def _reaches_into(mend: Mending, hull: Polyhedron, part: Work) -> bool:
    """Return whether an edge of a component is in the room, and not merely at its walls."""
    ends = mend.points[sorted({sorted_edge(*e) for face in part.faces for e in edges_of(face)})]
    shares = np.linspace(0, 1, 9)[:, np.newaxis, np.newaxis]
    points = (ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    inside = points[hull.contains(points)]
    return bool((hull.wall_distance(inside) > mend.offset + mend.weld).any())
