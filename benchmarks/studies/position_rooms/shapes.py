"""Shapes of the position rooms: boxes, and four kinds of polyhedra. Nothing of rtcal.

A shape is a list of convex polygons (n, 3), wound so that normals point out of the room.
"""

from __future__ import annotations

import numpy as np

Polygons = list[np.ndarray]


def vector_area(polygon: np.ndarray) -> np.ndarray:
    """Return the area times the unit normal, in m²."""
    spokes = polygon[1:] - polygon[0]
    return 0.5 * np.cross(spokes[:-1], spokes[1:]).sum(0)


def area(polygon: np.ndarray) -> float:
    return float(np.linalg.norm(vector_area(polygon)))


def volume(polygons: Polygons) -> float:
    """Return the volume in m³ (divergence theorem); negative if normals point inward."""
    return float(sum(p[0] @ vector_area(p) for p in polygons) / 3)


def prism(plan: np.ndarray, heights: np.ndarray) -> Polygons:
    """Return floor, ceiling and walls over a convex plan (n, 2), wound anticlockwise.

    ``heights`` (n,) are the ceiling's at the corners; they lie in a plane.
    """
    floor = np.column_stack([plan, np.zeros(len(plan))])
    top = np.column_stack([plan, heights])
    n = len(plan)
    walls = [np.array([floor[i], floor[(i + 1) % n], top[(i + 1) % n], top[i]]) for i in range(n)]
    return [floor[::-1], top, *walls]


def box(rng: np.random.Generator, cube_root: float) -> Polygons:
    """Return a box, its ratios drawn: length to width 1 to 2.2, height 0.4 to 0.85 of the cube root."""
    height = max(2.4, cube_root * rng.uniform(0.4, 0.85))
    width = np.sqrt(cube_root**3 / height / rng.uniform(1.0, 2.2))
    length = cube_root**3 / height / width
    plan = np.array([[0, 0], [length, 0], [length, width], [0, width]])
    return prism(plan, np.full(4, height))


def hall(rng: np.random.Generator) -> Polygons:
    """Return a prism over a convex plan of four to seven corners, under a sloping ceiling."""
    n = int(rng.integers(4, 8))
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n
    plan = np.column_stack([rng.uniform(1.0, 1.9) * np.cos(angles), np.sin(angles)])
    height = rng.uniform(0.7, 1.3)
    return prism(plan, height + plan @ rng.uniform(-0.15, 0.15, 2))


def gable(rng: np.random.Generator) -> Polygons:
    """Return a room under a ridged roof."""
    length, eaves = rng.uniform(1.1, 2.2), rng.uniform(0.45, 0.8)
    at, ridge = rng.uniform(0.3, 0.7), eaves + rng.uniform(0.15, 0.5)
    section = np.array([[0, 0], [1, 0], [1, eaves], [at, ridge], [0, eaves]])
    return extruded([section], section, length)


def raked(rng: np.random.Generator) -> Polygons:
    """Return a room whose floor rises in its back part."""
    length, start = rng.uniform(1.2, 2.0), rng.uniform(0.3, 0.6)
    height, rise = rng.uniform(0.7, 1.0), rng.uniform(0.15, 0.3)
    x = start * length
    outline = np.array([[0, 0], [x, 0], [length, rise], [length, height], [x, height], [0, height]])
    front, back = outline[[0, 1, 4, 5]], outline[[1, 2, 3, 4]]
    return extruded([front, back], outline[[0, 1, 2, 3, 5]], 1.0)


def angle(rng: np.random.Generator) -> Polygons:
    """Return a room with an L for a plan."""
    a, b = rng.uniform(0.9, 1.6), rng.uniform(0.9, 1.3)
    x, y = a * rng.uniform(0.5, 0.75), b * rng.uniform(0.5, 0.75)
    height = rng.uniform(0.35, 0.6)
    outline = np.array([[0, 0], [a, 0], [a, y], [x, y], [x, b], [0, b]])
    long = np.array([[0, 0], [a, 0], [a, y], [x, y], [0, y]])
    short = np.array([[0, y], [x, y], [x, b], [0, b]])
    return extruded([long, short], outline, height)


def extruded(ends: Polygons, outline: np.ndarray, depth: float) -> Polygons:
    """Return a cross-section (n, 2), wound anticlockwise, drawn out along the third axis.

    ``ends`` are the convex parts of both ends.
    """

    def at(polygon: np.ndarray, z: float) -> np.ndarray:
        return np.column_stack([polygon, np.full(len(polygon), z)])

    sides = []
    for i, p in enumerate(outline):
        q = outline[(i + 1) % len(outline)]
        sides.append(np.array([[*p, 0], [*q, 0], [*q, depth], [*p, depth]]))
    return [at(p, 0.0)[::-1] for p in ends] + [at(p, depth) for p in ends] + sides


def upright(polygons: Polygons) -> Polygons:
    """Return an extruded section with its second axis up; the turn keeps the winding."""
    return [p[:, [2, 0, 1]] for p in polygons]


def split(polygon: np.ndarray, share: float) -> Polygons:
    """Return the two parts of a convex polygon, cut across its longest side."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    along = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    along = along / np.linalg.norm(along)
    reach = polygon @ along
    cut = reach.min() + share * (reach.max() - reach.min())
    parts: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for i, p in enumerate(polygon):
        q = polygon[(i + 1) % len(polygon)]
        a, b = reach[i] - cut, reach[(i + 1) % len(polygon)] - cut
        parts[int(a > 0)].append(p)
        if a * b < 0:
            between = p + a / (a - b) * (q - p)
            parts[0].append(between)
            parts[1].append(between)
    return [np.array(part) for part in parts]


KINDS = (hall, gable, raked, angle)


def polyhedron(rng: np.random.Generator, kind: int, cube_root: float, n: int) -> Polygons:
    """Return a polyhedron of ``n`` surfaces: the largest are cut in two until there are as many."""
    made = KINDS[kind](rng)
    if kind in (1, 2):
        made = upright(made)
    scale = cube_root / volume(made) ** (1 / 3)
    made = [scale * p for p in made]
    while len(made) < n:
        largest = int(np.argmax([area(p) for p in made]))
        made[largest : largest + 1] = split(made[largest], rng.uniform(0.3, 0.7))
    return made


def distance(point: np.ndarray, polygon: np.ndarray) -> float:
    """Return the distance of a point from a convex polygon in m."""
    n = vector_area(polygon)
    n = n / np.linalg.norm(n)
    height = n @ (point - polygon[0])
    foot = point - height * n
    sides = np.roll(polygon, -1, axis=0) - polygon
    if (np.cross(n, sides) * (foot - polygon)).sum(1).min() >= 0:
        return abs(float(height))
    t = np.clip(((point - polygon) * sides).sum(1) / (sides**2).sum(1), 0, 1)
    nearest = polygon + t[:, np.newaxis] * sides
    return float(np.linalg.norm(point - nearest, axis=1).min())
