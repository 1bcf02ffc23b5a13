"""The shell of the room, and the other components of a mesh."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.edges import owners
from rtcal.io.mend.faces import Work
from rtcal.io.mend.mending import Mending
from rtcal.io.mend.shapes import area_of, plane_of


def shell_of(mend: Mending, work: Work) -> tuple[Work, list[Work]]:
    """Return the shell of the room, which may have holes, and the other components."""
    parts = [
        work.kept([i in set(p) for i in range(len(work.faces))]) for p in _parts_of(mend, work)
    ]
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
        parts.append(part)
    return parts
