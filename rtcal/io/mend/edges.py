"""Edges, the faces at them, the components that they join, and holes: closed where they are small."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from rtcal.io.mend.faces import ANY_SHARE, MOST_PLACES, SAME, Edge, Face, Mending, Work
from rtcal.io.mend.shapes import area_of, normal_of, plane_of
from rtcal.simulators.geometry import PLANARITY, Polyhedron, edge_owners
from rtcal.support.errors import DataError
from rtcal.support.text import rounded


def shell_of(mend: Mending, work: Work) -> tuple[Work, list[Work]]:
    """Return the shell of the room, which may have holes, and the other components."""
    parts = [work.of(members) for members in parts_of(mend, work)]
    sizes = [float(np.prod(np.sort(np.ptp(mend.corners(p), axis=0))[1:])) for p in parts]
    areas = [sum(area_of(mend.points[f]) for f in p.faces) for p in parts]
    # The shell encloses all: its box is the largest, and no flat component's is a room's.
    solid = [i for i, p in enumerate(parts) if plane_of(mend.corners(p))[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused("no faces enclose a volume: draw the walls, the floor and the ceiling")
    main = max(solid, key=lambda i: (round(sizes[i], 3), areas[i]))
    outer = _volume(mend, parts[main])
    for i in solid:
        if i != main and 2 * sizes[i] > sizes[main] and _is_around(mend, parts[main], parts[i]):
            inner = _volume(mend, parts[i])
            if outer > inner > outer / 2 and outer - inner < THICKEST * areas[i]:
                main = i  # the walls are drawn with their thickness
                break
    return parts[main], [p for i, p in enumerate(parts) if i != main]


THICKEST = 0.6
"""Mean distance in m between two closed surfaces up to which they are both sides of the walls."""


def _is_around(mend: Mending, outer: Work, inner: Work) -> bool:
    """Return whether the box around one component holds another."""
    around, held = mend.corners(outer), mend.corners(inner)
    low, high = around.min(axis=0), around.max(axis=0)
    return bool((low < held.min(axis=0)).all() and (held.max(axis=0) < high).all())


def _volume(mend: Mending, part: Work) -> float:
    """Return the volume in m³ of a component; 0.0 if it is open."""
    names = [str(k) for k in range(len(part.faces))]
    polygons = [mend.points[face] for face in part.faces]
    try:
        return float(Polyhedron.from_polygons([*zip(names, names, polygons, strict=True)]).volume)
    except DataError:
        return 0.0


def parts_of(mend: Mending, work: Work) -> list[list[int]]:
    """Return the faces of each component: faces are joined where two meet in an edge."""
    links: list[list[int]] = [[] for _ in work.faces]
    for sides in owners(mend, work.faces).values():
        if len(sides) == 2:
            links[sides[0]].append(sides[1])
            links[sides[1]].append(sides[0])
    done = [False] * len(work.faces)
    parts = []
    for first in range(len(work.faces)):
        if done[first]:
            continue
        done[first] = True
        part = [first]
        for i in part:  # the list grows during the loop
            for j in links[i]:
                if not done[j]:
                    done[j] = True
                    part.append(j)
        parts.append(sorted(part))
    return parts


MOST_OPEN = 5000
"""Largest number of open edges whose loops are sought."""


def owners(mend: Mending, faces: Sequence[Face]) -> dict[Edge, list[int]]:
    """Return the faces at each piece of an edge, which every corner on it divides."""
    owners = edge_owners(mend.points, faces)
    return {edge: [i for i, _ in sides] for edge, sides in owners.items()}


def open_edges(mend: Mending, work: Work) -> dict[Edge, int]:
    """Return the pieces of edges at which one face, or an odd number, meets; with one of them."""
    return {e: s[0] for e, s in owners(mend, work.faces).items() if len(s) % 2}


def edges_of(face: Sequence[int]) -> Iterable[Edge]:
    """Return the edges of a face, each from the corner before."""
    return ((face[k - 1], face[k]) for k in range(len(face)))


def sorted_edge(a: int, b: int) -> Edge:
    """Return an edge with its lower corner first."""
    return (min(a, b), max(a, b))


def simplified(face: Face) -> Face:
    """Return a face without repeated corners and without spikes a, b, a."""
    changed = True
    while changed and len(face) > 2:
        changed = False
        for k in range(len(face)):
            if face[k] == face[k - 1] or face[k - 1] == face[(k + 1) % len(face)]:
                del face[k]
                changed = True
                break
    return face


def one_loop(
    faces: Sequence[Face], owners: Mapping[Edge, Sequence[int]], members: set[int]
) -> Face | None:
    """Return the boundary of joined faces, if it is one loop that meets each corner once."""
    boundary = {
        sorted_edge(a, b): 0
        for face in faces
        for a, b in edges_of(face)
        if sum(i in members for i in owners[sorted_edge(a, b)]) == 1
    }
    loops = loops_of(boundary)
    return loops[0] if loops is not None and len(loops) == 1 else None


def loops_of(edges: Mapping[Edge, int]) -> list[Face] | None:
    """Return the loops of some edges, where several meet the shortest; None if one is open."""
    neighbours: dict[int, set[int]] = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    if any(len(n) % 2 for n in neighbours.values()) or len(edges) > MOST_OPEN:
        return None
    loops = []
    for first in sorted(neighbours):
        while neighbours[first]:
            loop = min(
                (_shortest(neighbours, first, n) for n in sorted(neighbours[first])), key=len
            )
            for a, b in zip(loop, [*loop[1:], loop[0]], strict=True):
                neighbours[a].discard(b)
                neighbours[b].discard(a)
            loops.append(loop)
    return loops


def _shortest(neighbours: Mapping[int, set[int]], first: int, second: int) -> Face:
    """Return the shortest loop that begins with an edge; every corner has an even number of edges."""
    before = {second: first}
    queue = [second]
    for here in queue:  # the list grows during the loop
        for there in sorted(neighbours[here]):
            if there == first and here != second:
                loop = [first, here]
                while loop[-1] != second:
                    loop.append(before[loop[-1]])
                return loop
            if there not in before and there != first:
                before[there] = here
                queue.append(there)
    raise AssertionError("an edge of an even graph is in a loop")  # pragma: no cover


HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = "close the hole with a face, or delete the faces around it"


def without_holes(mend: Mending, work: Work) -> Work:
    """Return the shell with its small holes closed; MeshError for a large one."""
    missing = open_edges(mend, work)
    if not missing:
        return work
    total = sum(area_of(mend.points[f]) for f in work.faces)
    largest = HOLE_SHARE * total if mend.largest_hole is None else mend.largest_hole
    loops = loops_of(missing)
    if loops is None:
        a, b = next(iter(missing))
        raise mend.refused(
            f"{len(missing)} open edges, the first from {mend.place(a)} to {mend.place(b)}, do not "
            f"bound a hole: faces are missing or cross each other there; {_LOOPS}",
            list(missing),
        )
    large = [loop for loop in loops if area_of(mend.points[loop]) > largest]
    if large:
        each = "; ".join(
            f"hole of {rounded(area_of(mend.points[loop]), 3)} m² at {mend.place(loop[0])}, beside "
            f'"{work.names[missing[sorted_edge(loop[0], loop[1])]]}"'
            for loop in sorted(large, key=lambda v: -area_of(mend.points[v]))[:MOST_PLACES]
        )
        more = f" ({len(large)} holes in all)" if len(large) > MOST_PLACES else ""
        raise mend.refused(
            f"{each}{more}; holes up to {rounded(largest, 3)} m² are "
            f"closed. {_hint(mend, large, work)}",
            list(missing),
        )
    closed, area, spread, unsure = [], 0.0, 0.0, []
    for loop in loops:
        size = area_of(mend.points[loop])
        longest = max(
            zip(loop, [*loop[1:], loop[0]], strict=True),
            key=lambda e: float(np.linalg.norm(mend.points[e[0]] - mend.points[e[1]])),
        )
        beside = missing[sorted_edge(*longest)]
        area += size
        spread += (size**1.5 / 4) ** 2
        closed.append(f"at {mend.place(loop[0])}, {work.materials[beside]}")
        unsure.append((work.materials[beside], ANY_SHARE * size))  # it may be of another material
        _fill(mend, work, loop, work.materials[beside])
    mend.found(
        "hole",
        "holes are closed with their neighbour's material",
        closed,
        area,
        surface=area,
        uncertainty=float(np.sqrt(spread)),
        unsure=unsure,
    )
    if again := open_edges(mend, work):
        a, b = next(iter(again))
        raise mend.refused(
            f"a hole at {mend.place(a)} to {mend.place(b)} cannot be closed by one face; {_LOOPS}",
            list(again),
        )
    return work


def _hint(mend: Mending, loops: Sequence[Face], work: Work) -> str:
    """Return how holes may be mended: faces whose corners nearly meet the edges ask for a weld."""
    loop = max(loops, key=lambda v: area_of(mend.points[v]))
    own = {v for face in work.faces for v in face}
    others = [v for v in mend.used if v not in own]
    if others:
        away, _ = cKDTree(mend.points[others]).query(mend.points[loop])
        if (distance := float(np.median(away))) < _NEAR:
            return (
                f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: state --weld "
                f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            )
    enough = rounded(1.01 * area_of(mend.points[loop]), 3)  # more than the area, as printed
    return f"In your program, {_LOOPS}; or state --hole {enough}"


def _fill(mend: Mending, work: Work, loop: Face, material: str) -> None:
    corners = mend.points[loop]
    off = np.abs((corners - corners.mean(axis=0)) @ normal_of(corners)).max()
    if off <= PLANARITY * 0.9 and area_of(corners) > SAME:
        work.add(loop, material, "closed hole")
        return
    # A narrow or warped loop: a strip of triangles from its ends, which meets every edge.
    low, high = 0, len(loop) - 1
    front = True
    while high - low >= 2:
        triangle = (
            (loop[low], loop[low + 1], loop[high])
            if front
            else (loop[low], loop[high - 1], loop[high])
        )
        if area_of(mend.points[list(triangle)]) > SAME**1.5:
            work.add(triangle, material, "closed hole")
        low, high = (low + 1, high) if front else (low, high - 1)
        front = not front
