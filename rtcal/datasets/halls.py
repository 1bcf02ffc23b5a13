"""Invented halls for case studies and benchmarks, and rooms made of boxes. None models a real room.

`lecture_hall` has the published data of the paper's lecture hall (Bellows & Katz 2025, Sect. 4.1): 23
surfaces, 334 m³, ratio 66.6 of largest to smallest area. The paper has no plan and no areas. The
stochastic study uses the areas ``lecture_hall().geometry.face_areas``. `hard_hall` resembles the Palais
des Papes (hard parallel walls), `theatre` the Athenee (thirty materials, very uneven absorption).
`corridor` is long and thin, so that its decay depends on the scattering model.

Their materials stand in halls.csv. Absorption coefficients are rounded textbook values, scattering
coefficients are estimates, one per material; sigma is the paper's three tiers 0.01, 0.05 and 0.1
(Sect. 4.3.1).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.bands import octaves
from rtcal.acoustics.room import Material, Room
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError

__all__ = ["BANDS", "Hall", "corridor", "hard_hall", "lecture_hall", "polyhedron", "theatre"]
__dir__ = __all__.copy

Point = tuple[float, float, float]
BANDS = octaves(125, 8000)


@dataclass(frozen=True, eq=False)
class Hall:
    """A hall to simulate: geometry, room, and named sources and receivers (x, y, z in m).

    ``held_out`` are receivers that a calibration does not see.
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Point]
    receivers: Mapping[str, Point]
    held_out: Mapping[str, Point]

    def __repr__(self) -> str:
        counts = f"{len(self.sources)} sources, {len(self.receivers)} receivers"
        return f"<Hall {self.room!r}: {counts}, {len(self.held_out)} held out>"


def _hall(
    name: str,
    geometry: Polyhedron,
    materials: str,
    sources: Mapping[str, Point],
    receivers: Mapping[str, Point],
    held_out: Mapping[str, Point],
    dimensions: Point | None = None,
) -> Hall:
    """Return a hall with the ``materials`` of this name in halls.csv."""
    table = resources.files("rtcal.datasets").joinpath("halls.csv").read_text(encoding="utf-8")
    rows = [row for row in csv.DictReader(table.splitlines()) if row["hall"] == materials]
    room = Room.from_surfaces(
        name=name,
        volume=geometry.volume,
        surfaces=geometry.surfaces,
        materials=[
            Material(
                row["material"],
                [float(row[f"{f:g}"]) for f in BANDS],
                [float(row["sigma"])] * len(BANDS),
                scattering=[float(row["scattering"])] * len(BANDS),
            )
            for row in rows
        ],
        centre_frequencies=BANDS,
        air=Air(20, 50),
        dimensions=dimensions,
    )
    return Hall(geometry, room, sources, receivers, held_out)


def lecture_hall() -> Hall:
    """Return a lecture hall of 23 surfaces, 334 m³, largest to smallest area 66.6.

    The hall is raked, 11 m deep and 8.9 m wide. Its width is chosen for the volume, and the width
    of the projection window for the ratio of areas.
    """
    depth, stage, rise, rake_end, front, height = 11.0, 2.8, 1.05, 9.8, 3.6, 3.9
    section = depth * height - stage * (height - front) / 2
    section -= (rake_end - stage) * rise / 2 + (depth - rake_end) * rise
    width = 334 / section
    window_height = 0.75
    window = float(np.hypot(rake_end - stage, rise)) * width / 66.6 / window_height
    left, right = (width - 4.8) / 2, (width + 4.8) / 2  # the blackboard's
    west, east = (width - window) / 2, (width + window) / 2  # the projection window's

    def across(y0: float, z0: float, y1: float, z1: float) -> list[Point]:
        return [(0, y0, z0), (width, y0, z0), (width, y1, z1), (0, y1, z1)]

    def front_wall(x0: float, x1: float, z0: float, z1: float) -> list[Point]:
        return [(x0, 0, z0), (x1, 0, z0), (x1, 0, z1), (x0, 0, z1)]

    def side(x: float, *outline: tuple[float, float]) -> list[Point]:
        return [(x, y, z) for y, z in outline]

    below = [(stage, 0.0), (rake_end, rise), (depth, rise), (depth, 1.6)]
    above = [(depth, height), (stage, height), (0.0, front)]
    top = height - window_height
    geometry = Polyhedron.from_polygons(
        [
            ("stage floor", "linoleum", across(0, 0, stage, 0)),
            ("seating", "desks and chairs", across(stage, 0, rake_end, rise)),
            ("rear aisle", "linoleum", across(rake_end, rise, depth, rise)),
            ("reflector", "gypsum board", across(0, front, stage, height)),
            ("main ceiling", "perforated ceiling", across(stage, height, rake_end, height)),
            ("rear ceiling", "gypsum board", across(rake_end, height, depth, height)),
            ("rear wall, lower", "wood panelling", across(depth, rise, depth, 2.25)),
            (
                "rear wall, upper",
                "painted plaster",
                [
                    (0, depth, 2.25),
                    (width, depth, 2.25),
                    (width, depth, height),
                    (east, depth, height),
                    (east, depth, top),
                    (west, depth, top),
                    (west, depth, height),
                    (0, depth, height),
                ],
            ),
            (
                "projection window",
                "glass",
                [
                    (west, depth, top),
                    (east, depth, top),
                    (east, depth, height),
                    (west, depth, height),
                ],
            ),
            ("front wall, left", "painted plaster", front_wall(0, left, 0, front)),
            ("front wall, right", "painted plaster", front_wall(right, width, 0, front)),
            ("front wall, lower", "wood panelling", front_wall(left, right, 0, 0.8)),
            ("blackboard", "blackboard", front_wall(left, right, 0.8, 2.2)),
            ("front wall, upper", "painted plaster", front_wall(left, right, 2.2, front)),
            ("wainscot", "wood panelling", side(0, (0, 0), *below, (0, 1.6))),
            (
                "left wall, front",
                "painted plaster",
                side(0, (0, 1.6), (1.4, 1.6), (1.4, 3), (0, 3)),
            ),
            ("windows", "glass", side(0, (1.4, 1.6), (9.8, 1.6), (9.8, 3), (1.4, 3))),
            (
                "left wall, rear",
                "painted plaster",
                side(0, (9.8, 1.6), (depth, 1.6), (depth, 3), (9.8, 3)),
            ),
            ("left wall, upper", "painted plaster", side(0, (0, 3), (depth, 3), *above)),
            ("door", "metal door", side(width, (0.6, 0), (1.6, 0), (1.6, 2.1), (0.6, 2.1))),
            ("panelling", "wood panelling", side(width, (1.9, 0), *below, (1.9, 1.6))),
            ("notice board", "wood panelling", side(width, (4, 1.6), (9, 1.6), (9, 2.8), (4, 2.8))),
            (
                "right wall",
                "painted plaster",
                side(
                    width,
                    (0, 0),
                    (0.6, 0),
                    (0.6, 2.1),
                    (1.6, 2.1),
                    (1.6, 0),
                    (1.9, 0),
                    (1.9, 1.6),
                    (4, 1.6),
                    (4, 2.8),
                    (9, 2.8),
                    (9, 1.6),
                    (depth, 1.6),
                    *above,
                ),
            ),
        ]
    )
    return _hall(
        "lecture hall (invented)",
        geometry,
        "lecture_hall",
        sources={"S1": (4.4, 1.6, 1.5), "S2": (2.2, 1.1, 1.5)},
        receivers={
            "R1": (3.0, 4.2, 1.5),
            "R2": (6.1, 6.0, 1.7),
            "R3": (2.3, 7.9, 2.0),
            "R4": (6.7, 9.0, 2.1),
        },
        held_out={"R5": (5.2, 4.9, 1.6), "R6": (1.9, 5.8, 1.7), "R7": (4.8, 8.6, 2.1)},
    )


def hard_hall() -> Hall:
    """Return a hard hall with parallel walls, 40 x 14 x 10 m, a platform and chairs on its floor.

    The absorption is on the floor, and sound remains between the smooth parallel walls above it.
    The decay is therefore longer than by Sabine's equation.
    """
    x, y, z = (0.0, 40.0), (0.0, 14.0), (0.0, 10.0)
    geometry = polyhedron(
        air=[(x, y, z)],
        solid=[((0, 8), (2, 12), (0, 0.8))],
        paint=[
            ("wall", "limestone", (x, y, z)),
            ("floor", "stone floor", (x, y, (0, 0))),
            ("vault", "stone vault", (x, y, (10, 10))),
            ("platform", "wooden platform", ((0, 8), (2, 12), (0, 0.8))),
            ("audience", "chairs", ((11, 27), (2.5, 11.5), (0, 0))),
            *(
                (f"window {i + 1}", "leaded glass", ((a, a + 2), (14, 14), (4, 8)))
                for i, a in enumerate((5.0, 13.0, 21.0, 29.0))
            ),
            ("door", "oak door", ((34, 37), (0, 0), (0, 4))),
        ],
    )
    return _hall(
        "hard hall (invented)",
        geometry,
        "hard_hall",
        sources={"S1": (4.0, 7.0, 2.3), "S2": (6.0, 4.5, 2.3)},
        receivers={
            "R1": (12.5, 5.2, 1.2),
            "R2": (17.0, 9.1, 1.2),
            "R3": (22.0, 4.1, 1.2),
            "R4": (26.0, 8.2, 1.2),
            "R5": (32.0, 6.3, 1.2),
        },
        held_out={"R6": (14.5, 8.4, 1.2), "R7": (20.0, 6.1, 1.2), "R8": (29.0, 9.6, 1.2)},
    )


def theatre() -> Hall:
    """Return a theatre with two tiers, boxes, a fly tower and thirty materials.

    Drapes and seats absorb strongly, ceiling and parapets hardly. The proscenium opening alone connects
    stage and auditorium.
    """
    hall, house = ((-7.0, 7.0), (0.0, 15.0), (0.0, 11.0)), ((-8.0, 8.0), (-9.5, -0.5), (0.9, 15.0))
    solid: list[Box] = []
    paint: list[tuple[str, str, Box]] = [
        ("auditorium wall", "auditorium wall", hall),
        ("auditorium ceiling", "auditorium ceiling", ((-7, 7), (0, 15), (11, 11))),
        ("dome", "dome", ((-3, 3), (4, 11), (11, 11))),
        ("aisle", "aisle carpet", ((-7, 7), (0, 15), (0, 0))),
        ("orchestra", "orchestra floor", ((-5, 5), (0, 2), (0, 0))),
        ("stalls", "stalls seats", ((-4, 4), (2.5, 13), (0, 0))),
        ("rear wall, stalls", "rear wall, stalls", ((-7, 7), (15, 15), (0, 3))),
        ("doors", "entrance doors", ((-1.5, 1.5), (15, 15), (0, 2.4))),
        ("proscenium wall", "proscenium", ((-7, 7), (0, 0), (0, 11))),
        ("forestage front", "forestage", ((-4.5, 4.5), (0, 0), (0, 0.9))),
        ("fly tower", "fly tower walls", house),
        ("wing", "wing walls", ((-8, 8), (-9.5, -0.5), (0.9, 7))),
        ("stage wall, front", "fire curtain", ((-8, 8), (-0.5, -0.5), (0.9, 15))),
        ("backcloth", "backcloth", ((-5, 5), (-9.5, -9.5), (0.9, 9))),
        ("drapes", "drapes", ((-8, -8), (-8, -1), (0.9, 8))),
        ("drapes", "drapes", ((8, 8), (-8, -1), (0.9, 8))),
        ("grid", "grid", ((-8, 8), (-9.5, -0.5), (15, 15))),
        ("stage floor", "stage floor", ((-8, 8), (-9.5, -0.5), (0.9, 0.9))),
        ("proscenium reveal", "proscenium reveal", ((-4.5, 4.5), (-0.5, 0), (0.9, 7.9))),
    ]
    for tier, floor, label in ((3.0, 3.3, "first"), (6.2, 6.5, "second")):
        top = floor + 0.8
        slabs = [
            ((-7.0, 7.0), (11.5, 15.0)),
            ((-7.0, -5.2), (4.0, 11.5)),
            ((5.2, 7.0), (4.0, 11.5)),
        ]
        rails = [
            ((-5.2, 5.2), (11.5, 11.7)),
            ((-5.4, -5.2), (4.0, 11.7)),
            ((5.2, 5.4), (4.0, 11.7)),
        ]
        solid += [(a, b, (tier, floor)) for a, b in slabs]
        solid += [(a, b, (tier, top)) for a, b in rails]
        paint += [
            (
                f"{label} tier parapet",
                f"{label} tier parapet",
                ((-5.4, 5.4), (4, 11.7), (tier, top)),
            ),
            (f"{label} tier soffit", f"{label} tier soffit", ((-7, 7), (4, 15), (tier, tier))),
            (f"{label} tier front", f"{label} tier parapet", ((-7, 7), (4, 4), (tier, floor))),
            (
                f"rear wall, {label} tier",
                f"rear wall, {label} tier",
                ((-7, 7), (15, 15), (floor, floor + 2.9)),
            ),
            (f"{label} tier seats", f"{label} tier seats", ((-7, 7), (11.5, 15), (floor, floor))),
            (f"{label} tier boxes", f"{label} tier boxes", ((-7, -5.2), (4, 11.5), (floor, floor))),
            (f"{label} tier boxes", f"{label} tier boxes", ((5.2, 7), (4, 11.5), (floor, floor))),
        ]
        for y in (6.5, 9.0):  # thin walls between the boxes
            for a in ((-7.0, -5.4), (5.4, 7.0)):
                solid.append((a, (y, y + 0.1), (floor, floor + 1.8)))
                paint.append(
                    ("partition", "box partitions", (a, (y, y + 0.1), (floor, floor + 1.8)))
                )
    solid.append(((-2.0, 2.0), (-7.0, -6.7), (0.9, 4.0)))
    paint.append(("set", "set", ((-2, 2), (-7, -6.7), (0.9, 4))))
    geometry = polyhedron(
        air=[hall, ((-4.5, 4.5), (-0.5, 0.0), (0.9, 7.9)), house], solid=solid, paint=paint
    )
    return _hall(
        "theatre (invented)",
        geometry,
        "theatre",
        sources={"S1": (0.4, -2.2, 2.4), "S2": (-1.8, -4.0, 2.4)},
        receivers={
            "R1": (1.2, 4.1, 1.2),
            "R2": (-2.3, 7.6, 1.2),
            "R3": (2.9, 10.4, 1.2),
            "R4": (-1.1, 13.1, 4.5),
            "R5": (1.6, 13.4, 7.7),
        },
        held_out={"R6": (-1.4, 5.2, 1.2), "R7": (1.9, 8.7, 1.2), "R8": (2.4, 12.6, 4.5)},
    )


def corridor() -> Hall:
    """Return a corridor of 40 x 2.4 x 3 m with absorbing ceiling tiles."""
    dimensions = (40.0, 2.4, 3.0)
    geometry = Polyhedron.shoebox(
        dimensions,
        {
            "west": "end wall",
            "east": "end wall",
            "south": "plaster",
            "north": "plaster",
            "floor": "vinyl floor",
            "ceiling": "ceiling tiles",
        },
    )
    return _hall(
        "corridor (invented)",
        geometry,
        "corridor",
        sources={"S1": (4.0, 1.0, 1.5)},
        receivers={
            "R1": (8.0, 1.4, 1.3),
            "R2": (14.0, 1.1, 1.3),
            "R3": (22.0, 1.3, 1.3),
            "R4": (33.0, 1.2, 1.3),
        },
        held_out={"R5": (11.0, 1.3, 1.3), "R6": (27.0, 1.1, 1.3)},
        dimensions=dimensions,
    )


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
