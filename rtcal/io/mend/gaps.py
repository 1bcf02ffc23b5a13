"""Holes of the shell: closed where they are small, refused where they are large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from rtcal.io.mend.edges import loops_of, open_edges, sorted_edge
from rtcal.io.mend.faces import ANY_SHARE, MOST_PLACES, SAME, Face, Mending, Work
from rtcal.io.mend.shapes import area_of, normal_of
from rtcal.simulators.geometry import PLANARITY
from rtcal.support.text import rounded

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
