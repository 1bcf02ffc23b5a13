"""Edges, the faces at them, the loops that they form, and the components that they join."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from rtcal.io.mend.faces import Edge, Face, Mending, Work
from rtcal.io.mend.shapes import area_of, plane_of
from rtcal.simulators.geometry import edge_owners


def shell_of(mend: Mending, work: Work) -> tuple[Work, list[Work]]:
    """Return the shell of the room, which may have holes, and the other components."""
    parts = [work.of(members) for members in _parts_of(mend, work)]
    sizes = [float(np.prod(np.sort(np.ptp(mend.corners(p), axis=0))[1:])) for p in parts]
    areas = [sum(area_of(mend.points[f]) for f in p.faces) for p in parts]
    # The shell encloses all: its box is the largest, and no flat component's is a room's.
    solid = [i for i, p in enumerate(parts) if plane_of(mend.corners(p))[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused("no faces enclose a volume: draw the walls, the floor and the ceiling")
    main = max(solid, key=lambda i: (round(sizes[i], 3), areas[i]))
    return parts[main], [p for i, p in enumerate(parts) if i != main]


def _parts_of(mend: Mending, work: Work) -> list[list[int]]:
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
