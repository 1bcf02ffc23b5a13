"""Rooms made of boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""(x from, to), (y from, to), (z from, to) in m."""

Rectangle = tuple[tuple[int, int], tuple[int, int]]


def polyhedron(
    air: Sequence[Box], solid: Sequence[Box], paint: Sequence[tuple[str, str, Box]]
) -> Polyhedron:
    """Return the room of the ``air`` boxes without the ``solid`` boxes.

    ``paint`` is a sequence of (surface, material, region). A wall belongs to the last region that
    contains its middle. Raises DataError if no region does.
    """
    boxes = [*air, *solid, *(region for _, _, region in paint)]
    # Rounded, so that 3.3 + 2.9 and 6.2 are one line.
    lines = [np.unique(np.round([lim for b in boxes for lim in b[axis]], 6)) for axis in range(3)]
    middles = [(line[:-1] + line[1:]) / 2 for line in lines]
    full = np.zeros(tuple(len(m) + 2 for m in middles), dtype=bool)  # a solid layer all round
    inner = full[1:-1, 1:-1, 1:-1]
    for group, value in ((air, True), (solid, False)):
        for box in group:
            within = [(m > lo) & (m < hi) for m, (lo, hi) in zip(middles, box, strict=True)]
            inner[np.ix_(*within)] = value
    faces: dict[tuple[int, int, bool, int], set[tuple[int, int]]] = {}
    for axis in range(3):
        # A wall stands wherever air and solid meet along the axis.
        cells = np.moveaxis(full, axis, 0)[:, 1:-1, 1:-1]
        u, v = (a for a in range(3) if a != axis)
        for plane, i, j in np.argwhere(cells[1:] != cells[:-1]):
            middle = np.empty(3)
            middle[axis], middle[u], middle[v] = lines[axis][plane], middles[u][i], middles[v][j]
            key = (axis, int(plane), bool(cells[plane, i, j]), _painted(middle, paint))
            faces.setdefault(key, set()).add((int(i), int(j)))
    polygons = []
    count: dict[str, int] = {}
    for (axis, plane, _, k), wall_cells in faces.items():
        u, v = (a for a in range(3) if a != axis)
        for (i0, i1), (j0, j1) in _rectangles(wall_cells):
            corners = np.empty((4, 3))
            corners[:, axis] = lines[axis][plane]
            corners[:, u] = lines[u][[i0, i1, i1, i0]]
            corners[:, v] = lines[v][[j0, j0, j1, j1]]
            surface, material, _ = paint[k]
            count[surface] = count.get(surface, 0) + 1
            name = surface if count[surface] == 1 else f"{surface} {count[surface]}"
            polygons.append((name, material, corners))
    return Polyhedron.from_polygons(polygons)


def _painted(middle: np.ndarray, paint: Sequence[tuple[str, str, Box]]) -> int:
    for k in reversed(range(len(paint))):
        region = np.array(paint[k][2])
        if ((middle >= region[:, 0] - 1e-9) & (middle <= region[:, 1] + 1e-9)).all():
            return k
    raise DataError(f"no paint covers the wall at {middle.tolist()} m")


def _rectangles(cells: set[tuple[int, int]]) -> list[Rectangle]:
    """Cover cells with few rectangles: each is the longest run along j, extended along i."""
    left = set(cells)
    rectangles = []
    while left:
        i0, j0 = min(left)
        j1 = j0 + 1
        while (i0, j1) in left:
            j1 += 1
        i1 = i0 + 1
        while all((i1, j) in left for j in range(j0, j1)):
            i1 += 1
        left -= {(i, j) for i in range(i0, i1) for j in range(j0, j1)}
        rectangles.append(((i0, i1), (j0, j1)))
    return rectangles
