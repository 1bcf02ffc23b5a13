"""Effects that can be hidden in a geometric room, as polygons. Nothing of rtcal.

A patch replaces a part of a surface; a curtain hangs free before its wall and absorbs on both sides;
an audience is flat, or a block of `BLOCK` in height that absorbs on its sides as well; an aperture is a
hole in a wall, behind which a second room stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from benchmarks.studies.position_rooms import shapes
from benchmarks.studies.position_rooms.tracer import MOST_CORNERS

BLOCK = 0.6  # height of an audience in m
MARGIN = 0.02  # between a patch and its surface's edges in m
SHAPES = 12
"""Aspect ratios that are tried for a rectangle before a strip is cut off instead."""


@dataclass
class Solid:
    """A room's polygons: each with the number of its row of alpha."""

    polygons: list[np.ndarray]
    owner: list[int]
    bodies: list[np.ndarray] = field(default_factory=list)
    """The polygons that stand in the room: positions keep clear of them."""


def halves(polygon: np.ndarray, along: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of a convex polygon where along . x is below and above ``at``; maybe empty."""
    reach = polygon @ along - at
    parts: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for i, p in enumerate(polygon):
        j = (i + 1) % len(polygon)
        if abs(reach[i]) < 1e-9:
            parts[0].append(p)
            parts[1].append(p)
            continue
        parts[int(reach[i] > 0)].append(p)
        if reach[i] * reach[j] < 0 and abs(reach[j]) >= 1e-9:
            between = p + reach[i] / (reach[i] - reach[j]) * (polygon[j] - p)
            parts[0].append(between)
            parts[1].append(between)
    below, above = (np.array(p).reshape(-1, 3) for p in parts)
    return below, above


def real(polygon: np.ndarray) -> bool:
    return len(polygon) >= 3 and shapes.area(polygon) > 1e-6


def axes(polygon: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return two axes in the plane, the first horizontal, and the outward normal."""
    n = shapes.vector_area(polygon)
    n = n / np.linalg.norm(n)
    if abs(n[2]) > 0.9:
        sides = np.roll(polygon, -1, axis=0) - polygon
        u = sides[np.argmax(np.linalg.norm(sides, axis=1))]
        u = u - (u @ n) * n
    else:
        u = np.cross([0.0, 0.0, 1.0], n)
    u = u / np.linalg.norm(u)
    return u, np.cross(n, u), n


def within(polygon: np.ndarray, points: np.ndarray, margin: float) -> bool:
    """Return whether points of its plane are in a convex polygon, and clear of its edges."""
    _, _, n = axes(polygon)
    sides = np.roll(polygon, -1, axis=0) - polygon
    inward = np.cross(n, sides)
    inward = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    return bool(((points[:, None, :] - polygon) * inward).sum(-1).min() >= margin)


def rectangle(rng: np.random.Generator, polygon: np.ndarray, area: float) -> np.ndarray | None:
    """Return a rectangle of this area somewhere in a convex polygon; None if none was met with."""
    u, v, _ = axes(polygon)
    corners = np.column_stack([polygon @ u, polygon @ v])
    low, high = corners.min(0), corners.max(0)
    for aspect in np.exp(rng.uniform(np.log(0.3), np.log(3.0), SHAPES)):
        half = np.array([np.sqrt(area * aspect), np.sqrt(area / aspect)]) / 2
        if (2 * half > high - low).any():
            continue
        for _ in range(20):
            x, y = rng.uniform(low + half, high - half)
            a, b = half
            plane = np.array([[x - a, y - b], [x + a, y - b], [x + a, y + b], [x - a, y + b]])
            base = polygon[0] - (polygon[0] @ u) * u - (polygon[0] @ v) * v
            points = base + plane[:, :1] * u + plane[:, 1:] * v
            if within(polygon, points, MARGIN):
                return np.asarray(points)
    return None


def strip(polygon: np.ndarray, area: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a strip of this area, cut across the polygon's longest side, and what is left."""
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        first, _ = shapes.split(polygon, middle)
        low, high = (middle, high) if shapes.area(first) < area else (low, middle)
    first, second = shapes.split(polygon, (low + high) / 2)
    return first, second


def frame(polygon: np.ndarray, hole: np.ndarray) -> list[np.ndarray]:
    """Return up to four convex polygons around a rectangle that lies in a convex polygon."""
    u, v, _ = axes(polygon)
    x, y = hole @ u, hole @ v
    left, rest = halves(polygon, u, float(x.min()))
    rest, right = halves(rest, u, float(x.max()))
    below, rest = halves(rest, v, float(y.min()))
    _, above = halves(rest, v, float(y.max()))
    return [p for p in (left, right, below, above) if real(p)]


def replace_part(
    rng: np.random.Generator, solid: Solid, surface: int, area: float, row: int
) -> None:
    """Give a part of a surface the alpha of another row: a rectangle, or else a strip."""
    polygon = solid.polygons[surface]
    part = rectangle(rng, polygon, area)
    if part is None:
        part, *others = strip(polygon, area)
    else:
        others = frame(polygon, part)
    put_back(solid, surface, others)
    solid.polygons.append(part)
    solid.owner.append(row)


def put_back(solid: Solid, surface: int, parts: list[np.ndarray]) -> None:
    """Replace a surface's polygon by its parts; the first keeps its number."""
    solid.polygons[surface] = parts[0]
    solid.polygons += parts[1:]
    solid.owner += [solid.owner[surface]] * (len(parts) - 1)


def hang(
    rng: np.random.Generator, solid: Solid, surface: int, area: float, row: int, gap: float
) -> bool:
    """Hang a curtain before a wall; False if it has no place there."""
    shell = [p.copy() for p in solid.polygons]
    _, _, n = axes(shell[surface])
    for _ in range(40):
        part = rectangle(rng, shell[surface], area)
        if part is None:
            return False
        curtain = part - gap * n
        others = [p for k, p in enumerate(shell) if k != surface]
        clear = all(shapes.distance(x, p) > MARGIN / 2 for x in curtain for p in others)
        if clear:
            solid.polygons.append(curtain)
            solid.owner.append(row)
            solid.bodies.append(curtain)
            return True
    return False


def seat(rng: np.random.Generator, solid: Solid, surface: int, area: float, row: int) -> bool:
    """Stand a block of audience on a level floor; False if it has no place there."""
    ground = rectangle(rng, solid.polygons[surface], area)
    if ground is None:
        return False
    top = ground + np.array([0, 0, BLOCK])
    sides = [np.array([ground[i], ground[(i + 1) % 4], top[(i + 1) % 4], top[i]]) for i in range(4)]
    put_back(solid, surface, frame(solid.polygons[surface], ground))
    solid.polygons += [top, *sides]
    solid.owner += [row] * 5
    solid.bodies += [top, *sides]
    return True


def open_to_a_second_room(
    rng: np.random.Generator, solid: Solid, surface: int, area: float, volume: float, row: int
) -> bool:
    """Cut a hole into a wall and put a box of this volume behind it; False if it has no place."""
    wall = solid.polygons[surface]
    hole = rectangle(rng, wall, area)
    if hole is None:
        return False
    u, v, n = axes(wall)
    base = wall[0] - (wall[0] @ u) * u - (wall[0] @ v) * v
    inner = np.array([[(hole @ a).min(), (hole @ a).max()] for a in (u, v)])
    outer = np.array([[(wall @ a).min(), (wall @ a).max()] for a in (u, v)])
    for share in np.linspace(1, 0.05, 40):
        (x0, x1), (y0, y1) = inner + share * (outer - inner)
        front = np.array(
            [base + x * u + y * v for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        )
        if within(wall, front, -1e-9):
            break
    else:
        return False
    back = front + volume / shapes.area(front) * n
    around = [
        np.array([front[i], front[(i + 1) % 4], back[(i + 1) % 4], back[i]]) for i in range(4)
    ]
    put_back(solid, surface, frame(wall, hole))
    solid.polygons += [back, *around]
    solid.owner += [row] * 5
    return True


def takes(polygon: np.ndarray) -> bool:
    """Return whether a part may be cut out: the tracer has a greatest number of corners."""
    return len(polygon) + 2 <= MOST_CORNERS
