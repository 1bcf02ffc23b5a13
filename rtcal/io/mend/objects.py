"""Components in the shell: overlays, objects with an open bottom, panels, and what lies outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.io.mend.faces import ANY_SHARE, Face, Mending, Unclosed, Work
from rtcal.io.mend.polygons import (
    area_of,
    axes_of,
    edges_of,
    normal_of,
    open_edges,
    polygon_of,
    polygons_of,
    sorted_edge,
    volume_by_rays,
)
from rtcal.io.mend.walls import (
    Cut,
    Walls,
    at_walls,
    cut,
    is_plane,
    lifted,
    new_points,
    overlaid_on,
    standing_on,
    volume_over,
    within_walls,
)
from rtcal.io.mend.welding import settled
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.text import rounded
from rtcal.support.types import Array

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
