"""The second hidden world: rooms of many shapes, catalogue coefficients, errors that catalogues have.

It shares no code and no distribution with `studies/hidden_world`, and imports nothing of rtcal. It was
frozen on 2026-11-22, before the finder's priors were made. A room is drawn from the seed
(population, kind, index). Population 0 is for development, population 1 for judging.

What differs from the first world:

- shapes: prisms over convex floor plans of four to six corners, long and flat ones among them, with
  level or sloping ceilings; people and furniture are boxes on the floor, absorbers are strips;
- coefficients: a catalogue's, stated with handbook sigma (30 %, at least 0.02). The true ones differ
  by a factor and a tilt common to all materials, by a heavy-tailed factor per material and by a
  rough part per band;
- noise: a part common to all pairs of a band, of the size found between measuring teams, and a part
  per pair after theory;
- statements: a third of the cases state an uncertainty, a third give values per pair without one, a
  third give means over the pairs without one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.studies.second_world.rays import HIDDEN, Scene, Walls, trace

BANDS = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
N = len(BANDS)
OCTAVES = np.log2(BANDS / 1000)

# Absorption coefficients at 125 Hz to 4 kHz, as reprinted in many handbooks (among them Everest, The
# Master Handbook of Acoustics, appendix; Bies & Hansen, Engineering Noise Control, Table 7.1).
FLOORS = {
    "linoleum": (0.02, 0.03, 0.03, 0.03, 0.03, 0.02),
    "wood floor": (0.15, 0.11, 0.10, 0.07, 0.06, 0.07),
    "parquet": (0.04, 0.04, 0.07, 0.06, 0.06, 0.07),
    "carpet": (0.02, 0.06, 0.14, 0.37, 0.60, 0.65),
    "carpet on felt": (0.08, 0.24, 0.57, 0.69, 0.71, 0.73),
    "marble": (0.01, 0.01, 0.01, 0.01, 0.02, 0.02),
}
CEILINGS = {
    "plaster": (0.013, 0.015, 0.02, 0.03, 0.04, 0.05),
    "plaster on lath": (0.14, 0.10, 0.06, 0.05, 0.04, 0.03),
    "gypsum board": (0.29, 0.10, 0.05, 0.04, 0.07, 0.09),
    "mineral tile": (0.30, 0.35, 0.55, 0.70, 0.70, 0.65),
    "concrete": (0.02, 0.03, 0.03, 0.03, 0.04, 0.05),
}
WALLS = {
    "brick": (0.03, 0.03, 0.03, 0.04, 0.05, 0.07),
    "painted block": (0.10, 0.05, 0.06, 0.07, 0.09, 0.08),
    "coarse block": (0.36, 0.44, 0.31, 0.29, 0.39, 0.25),
    "plywood": (0.28, 0.22, 0.17, 0.09, 0.10, 0.11),
    "wall plaster": (0.013, 0.015, 0.02, 0.03, 0.04, 0.05),
    "drywall": (0.29, 0.10, 0.05, 0.04, 0.07, 0.09),
}
PARTS = {
    "window": (0.35, 0.25, 0.18, 0.12, 0.07, 0.04),
    "plate glass": (0.18, 0.06, 0.04, 0.03, 0.02, 0.02),
    "door": (0.14, 0.10, 0.06, 0.08, 0.10, 0.10),
    "light drape": (0.03, 0.04, 0.11, 0.17, 0.24, 0.35),
    "felt panel": (0.10, 0.25, 0.60, 0.85, 0.90, 0.85),
}
SEATED = np.array([0.60, 0.74, 0.88, 0.96, 0.93, 0.85])  # audience in upholstered seats
CURTAIN = np.array([0.07, 0.31, 0.49, 0.75, 0.70, 0.60])  # medium velour, draped to half its area
FURNITURE = np.array([0.25, 0.35, 0.45, 0.50, 0.55, 0.55])
# Between teams (round robin at PTB's studio, Bork 2005): relative of T30 and EDT, dB of C80 and G.
COMMON = {
    "t30": np.array([0.046, 0.035, 0.027, 0.021, 0.017, 0.013]),
    "edt": np.array([0.10, 0.08, 0.06, 0.05, 0.04, 0.033]),
    "c80": np.array([0.83, 0.70, 0.58, 0.48, 0.41, 0.35]),
    "g": np.array([2.0, 1.5, 1.1, 0.85, 0.68, 0.55]),
}
COMMON["t20"] = COMMON["t30"]
PARAMETERS = ("t20", "edt", "t30", "c80", "g")

KINDS = (
    "nothing",
    "coefficients",
    "air",
    "opening",
    "audience",
    "furniture",
    "porous",
    "resonator",
    "curtain",
    "membrane",
    "area",
    "volume",
    "formula",
    "coupled room",
    "non-diffuse field",
    "noise floor",
    "unknown",
)
COUNTS = {
    0: {k: {"nothing": 50, "coefficients": 16}.get(k, 8) for k in KINDS},
    1: {k: {"nothing": 120, "coefficients": 40}.get(k, 20) for k in KINDS},
    # Fresh rooms that judge sizes beyond the grid.
    2: {k: {"nothing": 24}.get(k, 3) for k in KINDS},
    # Sizes beyond those of the others (`BEYOND`): drawn on 2026-11-23, before any finder read them.
    3: dict.fromkeys(KINDS, 0)
    | {"nothing": 24, "opening": 8, "porous": 8, "curtain": 8}
    | {"non-diffuse field": 16, "noise floor": 12},
}
BEYOND = {3}
"""Populations in which an absorber adds 1 to 4 times the room's absorption, a field scatters 0.003 to
0.02, and a noise floor stands at -40 to -22 dB."""
STATEMENTS = ("stated", "pairs", "means")


def attenuation(temperature: float, humidity: float) -> np.ndarray:
    """Return the air's energy attenuation in 1/m (ISO 9613-1, at one atmosphere)."""
    t, f2 = temperature + 273.15, BANDS**2
    vapour = humidity * 10.0 ** (4.6151 - 6.8346 * (273.16 / t) ** 1.261)  # molar, in %
    slow = (293.15 / t) ** 0.5 * (9 + 280 * vapour * np.exp(-4.17 * ((293.15 / t) ** (1 / 3) - 1)))
    fast = 24 + 4.04e4 * vapour * (0.02 + vapour) / (0.391 + vapour)
    classical = 1.84e-11 * (t / 293.15) ** 0.5
    relaxing = 0.01275 * np.exp(-2239.1 / t) * fast / (fast**2 + f2)
    relaxing = relaxing + 0.1068 * np.exp(-3352.0 / t) * slow / (slow**2 + f2)
    # 8.686 dB per neper; m = alpha_dB / (10 lg e) = 2 alpha_neper
    return 2 * f2 * (classical + (293.15 / t) ** 2.5 * relaxing)


def speed_of_sound(temperature: float) -> float:
    return float(331.3 * np.sqrt(1 + temperature / 273.15))


def area_of(polygon: np.ndarray) -> float:
    if len(polygon) < 3:
        return 0.0
    spokes = polygon[1:] - polygon[0]
    return float(0.5 * np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(0)))


def beyond(polygon: np.ndarray, along: np.ndarray, least: float) -> np.ndarray:
    """Return the part of a convex polygon (n, 3) where along . x >= least."""
    kept: list[np.ndarray] = []
    height = polygon @ along - least
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if height[i] >= 0:
            kept.append(polygon[i])
        if height[i] * height[j] < 0:
            share = height[i] / (height[i] - height[j])
            kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
    return np.array(kept).reshape(-1, 3)


def cut_of(polygon: np.ndarray, along: np.ndarray, area: float) -> float:
    """Return the b at which the part with along . x >= b has this area."""
    low, high = float((polygon @ along).min()), float((polygon @ along).max())
    for _ in range(60):
        middle = (low + high) / 2
        if area_of(beyond(polygon, along, middle)) > area:
            low = middle
        else:
            high = middle
    return (low + high) / 2


@dataclass
class Room:
    """A room while it is drawn: its true scene, what is stated of it, and what was hidden."""

    polygons: list[np.ndarray]  # one per wall: floor, ceiling, then the sides
    walls: Walls
    materials: list[str]
    owner: np.ndarray  # (n_walls, 2): material of the main and the second part, -1 for none
    areas: np.ndarray  # (n_materials,)
    alpha: np.ndarray  # true, (n_materials, n_bands)
    mu: np.ndarray
    climate: tuple[float, float]
    volume: float
    vectors: bool
    stated: dict[str, Any] = field(default_factory=dict)
    truth: dict[str, Any] = field(default_factory=dict)
    boxes: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    box_alpha: np.ndarray | None = None
    second: Walls | None = None
    aperture: int = -1
    air: np.ndarray | None = None
    noise_floor_db: float | None = None

    @property
    def absorption(self) -> float:
        """S alpha in m², mean of 500 Hz to 2 kHz."""
        return float(self.areas @ self.alpha[:, 2:5].mean(1))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.random())


def floor_plan(rng: np.random.Generator) -> np.ndarray:
    """Return a convex floor plan (n, 2), anticlockwise, of area 1."""
    long = log_uniform(rng, 1.0, 3.5)
    kind = rng.integers(4)
    if kind == 0:
        plan = np.array([[0, 0], [long, 0], [long, 1], [0, 1]], float)
    elif kind == 1:  # a fan
        narrow = rng.uniform(0.15, 0.35)
        plan = np.array([[0, narrow], [long, 0], [long, 1], [0, 1 - narrow]])
    elif kind == 2:  # no two walls parallel
        shift = rng.uniform(0.03, 0.25, 4)
        plan = np.array([[shift[0], 0], [long, shift[1]], [long - shift[2], 1], [0, 1 - shift[3]]])
    else:  # a hexagon: a box with its corners cut at one end
        a, b = rng.uniform(0.1, 0.3, 2)
        plan = np.array([[0, b], [a, 0], [long - a, 0], [long, b], [long, 1 - b], [0, 1]], float)
    x, y = plan.T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (plan - plan.mean(0)) @ turn.T / np.sqrt(area)


def faces(plan: np.ndarray, heights: np.ndarray) -> list[np.ndarray]:
    """Return floor, ceiling and sides of a prism whose ceiling is a plane of these corner heights."""
    floor = np.column_stack([plan, np.zeros(len(plan))])
    top = np.column_stack([plan, heights])
    sides = [
        np.array([floor[i], floor[j], top[j], top[i]])
        for i in range(len(plan))
        for j in [(i + 1) % len(plan)]
    ]
    return [floor[::-1], top, *sides]


def planes(polygons: list[np.ndarray], inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return outward unit normals and distances of polygons around a point."""
    normals = []
    for p in polygons:
        n = np.cross(p[1] - p[0], p[2] - p[0])
        n = n / np.linalg.norm(n)
        normals.append(n if n @ (p[0] - inside) > 0 else -n)
    out = np.array(normals)
    return out, np.array([n @ p[0] for n, p in zip(out, polygons, strict=True)])


def smooth(rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return a factor per band whose logarithm has this spread and changes smoothly."""
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    return np.exp(spread * np.linalg.cholesky(0.8**lag + 1e-9 * np.eye(N)) @ rng.standard_normal(N))


def true_alpha(rng: np.random.Generator, mu: np.ndarray, common: float, tilt: float) -> np.ndarray:
    """Return the coefficients that the room has where the catalogue says mu."""
    factor = common * np.exp(tilt * OCTAVES)
    out = np.empty_like(mu)
    for i in range(len(mu)):
        own = np.exp(0.12 * np.clip(rng.standard_t(3), -5, 5))
        out[i] = mu[i] * factor * own * smooth(rng, 0.12) * np.exp(0.04 * rng.standard_normal(N))
    return np.clip(out, 0.005, 0.99)


def draw(rng: np.random.Generator, dead: bool | None = None, wrong: bool = False) -> Room:
    """Draw a room with nothing hidden in it; ``wrong``: coefficients that are off together."""
    volume = log_uniform(rng, 90, 7000)
    low = rng.random() < 0.3
    height = float(np.clip(volume ** (1 / 3) * rng.uniform(0.35, 0.8), 2.4, 3.2 if low else 14))
    plan = floor_plan(rng) * np.sqrt(volume / height)
    slope = rng.normal(0, 0.06, 2) if rng.random() < 0.4 else np.zeros(2)
    heights = np.maximum(height + plan @ slope, 2.2)
    # A plane through the corners: the clipped heights of more than three corners may not lie in one.
    fit, *_ = np.linalg.lstsq(np.column_stack([plan, np.ones(len(plan))]), heights, rcond=None)
    heights = np.column_stack([plan, np.ones(len(plan))]) @ fit
    polygons = faces(plan, heights)
    inside = np.array([*plan.mean(0), 0.5 * heights.min()])
    normals, offsets = planes(polygons, inside)
    sizes = np.array([area_of(p) for p in polygons])
    volume = float(
        sum(s * (o - n @ inside) for s, n, o in zip(sizes, normals, offsets, strict=True)) / 3
    )

    names: list[str] = []
    rows: list[tuple[float, ...]] = []

    def material(table: dict[str, tuple[float, ...]]) -> int:
        name = str(rng.choice(list(table)))
        if name not in names:
            names.append(name)
            rows.append(table[name])
        return names.index(name)

    owner = np.full((len(polygons), 2), -1)
    # A soft floor below a soft ceiling is a non-diffuse room by itself: such a ceiling is hard here.
    owner[0, 0] = material(FLOORS)
    soft = rows[0][3] > 0.3
    owner[1, 0] = material({k: v for k, v in CEILINGS.items() if not (soft and v[3] > 0.3)})
    usual = [material(WALLS), material(WALLS)]
    for w in range(2, len(polygons)):
        owner[w, 0] = usual[1 if w == 2 else int(rng.random() < 0.3)]
    owner[-1, 0] = usual[0]
    for w in range(2, len(polygons)):
        if rng.random() < 0.55:
            owner[w, 1] = material(PARTS)
    if len(names) < 4:
        owner[2, 1] = material(PARTS)
    mu = np.clip(np.array(rows), 0.01, 0.95)
    common, tilt = np.exp(0.10 * rng.standard_normal()), 0.04 * rng.standard_normal()
    if wrong:
        common = np.exp(rng.choice([-1, 1]) * rng.uniform(0.2, 0.45))
        tilt = 0.12 * rng.standard_normal()
    alpha = true_alpha(rng, mu, common, tilt)

    cuts = np.zeros((len(polygons), 2, 4))
    cuts[:, :, 3] = 1.0  # 0 . x >= 1: nowhere
    areas = np.zeros(len(names))
    parts = np.zeros((len(polygons), 3, N))
    for w, polygon in enumerate(polygons):
        parts[w, :] = alpha[owner[w, 0]]
        second = 0.0
        if owner[w, 1] >= 0:
            second = rng.uniform(0.1, 0.45) * sizes[w]
            along = polygon[1] - polygon[0]
            along = along / np.linalg.norm(along)
            cuts[w, 0] = [*along, cut_of(polygon, along, second)]
            parts[w, 1] = alpha[owner[w, 1]]
            areas[owner[w, 1]] += second
        areas[owner[w, 0]] += sizes[w] - second
    # An ordinary room scatters; what scatters less is the kind "non-diffuse field".
    scattering = np.clip(
        rng.uniform(0.4, 0.8) + 0.1 * rng.standard_normal(len(polygons)), 0.3, 0.95
    )
    climate = (float(rng.uniform(17, 26)), float(rng.uniform(25, 65)))
    made = Room(
        polygons,
        Walls(normals, offsets, cuts, parts, scattering),
        names,
        owner,
        areas,
        alpha,
        mu,
        climate,
        volume,
        bool(rng.random() < 0.5),
    )
    made.stated = {"volume": volume, "areas": areas.copy(), "air": climate, "equation": "eyring"}
    made.truth = {"common": float(common), "tilt": float(tilt)}
    return made


def strip(
    made: Room, rng: np.random.Generator, area: float, spectrum: np.ndarray, walls: list[int]
) -> float:
    """Put a strip of this area on one of the walls, at the end away from its second material.

    Return its area: at most 80 % of what the main material leaves.
    """
    sizes = np.array([area_of(p) for p in made.polygons])
    free = [sizes[w] - area_of(second_part(made, w)) for w in walls]
    order = [w for w, f in zip(walls, free, strict=True) if 0.8 * f >= area]
    w = int(rng.choice(order)) if order else walls[int(np.argmax(free))]
    area = min(area, 0.8 * free[walls.index(w)])
    polygon = made.polygons[w]
    along = polygon[0] - polygon[1]
    along = along / np.linalg.norm(along)
    made.walls.cuts[w, 1] = [*along, cut_of(polygon, along, area)]
    made.walls.alpha[w, HIDDEN] = np.clip(spectrum, 0.0, 1.0)
    made.truth["wall"] = w
    return area


def second_part(made: Room, wall: int) -> np.ndarray:
    """Return the polygon of a wall's second material; empty where it has none."""
    cut = made.walls.cuts[wall, 0]
    return beyond(made.polygons[wall], cut[:3], cut[3])


def porous(depth: float, flow: float) -> np.ndarray:
    """Return the coefficient of a layer in m and kPa s/m², a curve drawn through catalogue values.

    Half of its top where the depth is a sixteenth of a wavelength, steeper for denser layers.
    """
    x = BANDS * depth / 343 * 16
    return 0.95 * x**1.6 / (1 + x**1.6) * (0.9 + 0.1 * np.tanh(flow / 15))


def peak(resonance: float, width: float, top: float) -> np.ndarray:
    """Return a resonant absorber's coefficient: a bell over the logarithm of the frequency."""
    within = np.log2(BANDS)[:, None] + np.linspace(-0.5, 0.5, 21)
    return (top * np.exp(-0.5 * ((within - np.log2(resonance)) / width) ** 2)).mean(1)


def on_floor(made: Room, rng: np.random.Generator, count: int, size: np.ndarray) -> int:
    """Stand boxes on the floor, clear of walls; return how many found a place."""
    boxes: list[np.ndarray] = []
    low, high = made.polygons[0].min(0), made.polygons[0].max(0)
    side = made.walls.normals[2:], made.walls.offsets[2:]
    for _ in range(60 * count):
        if len(boxes) == count:
            break
        corner = np.append(rng.uniform(low[:2], high[:2] - size[:2]), 0.0)
        both = np.concatenate([corner, corner + size])
        corners = np.array(
            [[both[0], both[1]], [both[3], both[1]], [both[3], both[4]], [both[0], both[4]]]
        )
        flat = np.column_stack([corners, np.zeros(4)])
        clear = (flat @ side[0].T < side[1] - 0.1).all()
        apart = all((both[:2] > b[3:5]).any() or (both[3:5] < b[:2]).any() for b in boxes)
        if clear and apart:
            boxes.append(both)
    made.boxes = np.array(boxes).reshape(-1, 6)
    return len(boxes)


def behind(
    made: Room, rng: np.random.Generator, wall: int, volume: float, alpha: np.ndarray
) -> None:
    """Open the hidden strip of a side wall to a second room of this volume, a box behind it."""
    p = made.polygons[wall]
    n, d = made.walls.normals[wall], made.walls.offsets[wall]
    along = (p[1] - p[0]) / np.linalg.norm(p[1] - p[0])
    width, height = float(np.linalg.norm(p[1] - p[0])), float(min(p[2][2], p[3][2]))
    deep = volume / (width * height)
    normals = np.array([-n, n, -along, along, [0, 0, -1.0], [0, 0, 1.0]])
    offsets = np.array([-d, d + deep, -(along @ p[0]), along @ p[1], 0.0, height])
    cuts = np.zeros((6, 2, 4))
    cuts[:, :, 3] = 1.0
    cuts[0, 1] = made.walls.cuts[wall, 1]
    made.second = Walls(
        normals, offsets, cuts, np.tile(alpha, (6, 3, 1)), np.full(6, float(rng.uniform(0.2, 0.6)))
    )
    made.aperture = wall


def hide(kind: str, rng: np.random.Generator, large: bool = False) -> Room:
    """Draw a room and hide one thing of this kind in it; ``large``: see `BEYOND`."""
    made = draw(rng, wrong=kind == "coefficients")
    sides = list(range(2, len(made.polygons)))
    rough = smooth(rng, 0.12)  # members of a family differ from the catalogue's curve
    share = log_uniform(rng, *((1.0, 4.0) if large else (0.12, 1.0)))
    wanted = share * made.absorption
    truth = made.truth
    truth["kind"] = kind
    if kind == "air":
        climate = (float(rng.uniform(8, 33)), float(rng.uniform(10, 90)))
        made.air = attenuation(*climate)
        truth |= {"temperature": climate[0], "humidity": climate[1]}
        if rng.random() < 0.6:
            made.stated["air"] = None
    elif kind == "opening":
        truth["size"] = strip(made, rng, wanted, np.ones(N), sides)
    elif kind == "audience":
        if rng.random() < 0.5:
            truth["size"] = strip(made, rng, wanted / 0.9, SEATED * rough, [0])
        else:
            size = np.array([0.5, 0.5, 1.2])
            skin = size[0] * size[1] + 2 * size[2] * (size[0] + size[1])
            count = int(np.clip(round(wanted / (0.33 * skin)), 1, 120))
            made.box_alpha = np.clip(0.37 * SEATED * rough, 0.02, 0.99)
            truth["persons"] = on_floor(made, rng, count, size)
    elif kind == "furniture":
        size = rng.uniform([0.5, 0.5, 0.5], [1.6, 1.0, 1.6])
        skin = size[0] * size[1] + 2 * size[2] * (size[0] + size[1])
        count = int(np.clip(round(wanted / (0.5 * skin)), 1, 80))
        made.box_alpha = np.clip(FURNITURE * rough, 0.02, 0.99)
        placed = on_floor(made, rng, count, size)
        truth |= {"pieces": placed, "size": float(placed * skin * made.box_alpha[2:5].mean())}
    elif kind == "porous":
        depth, flow = log_uniform(rng, 0.015, 0.15), log_uniform(rng, 4, 40)
        curve = porous(depth, flow)
        size = strip(made, rng, wanted / max(curve[2:5].mean(), 0.2), curve * rough, [1, *sides])
        truth |= {"size": size, "depth": depth, "flow": flow}
    elif kind == "resonator":
        resonance, width = log_uniform(rng, 80, 450), float(rng.uniform(0.35, 1.0))
        curve = peak(resonance, width, float(rng.uniform(0.6, 0.95)))
        size = strip(made, rng, wanted / max(curve.max(), 0.3), np.maximum(curve, 0.04), sides)
        truth |= {"size": size, "resonance": resonance, "width": width}
    elif kind == "curtain":
        truth["size"] = strip(made, rng, wanted / 0.65, CURTAIN * rough, sides)
    elif kind == "membrane":
        resonance = log_uniform(rng, 70, 250)
        curve = peak(resonance, 0.8, float(rng.uniform(0.35, 0.7))) + 0.06
        size = strip(made, rng, wanted / curve.max(), curve, sides)
        truth |= {"size": size, "resonance": resonance}
    elif kind == "area":
        weight = made.areas * made.alpha[:, 2:5].mean(1)
        j = int(rng.choice(len(weight), p=weight / weight.sum()))
        ratio = float(np.exp(rng.choice([-1, 1]) * rng.uniform(np.log(1.25), np.log(2.2))))
        made.stated["areas"][j] /= ratio
        truth |= {"material": j, "ratio": ratio}
    elif kind == "volume":
        ratio = float(np.exp(rng.choice([-1, 1]) * rng.uniform(np.log(1.1), np.log(1.4))))
        made.stated["volume"] /= ratio
        truth["ratio"] = ratio
    elif kind == "formula":
        made.stated["equation"] = "sabine" if rng.random() < 0.7 else "millington"
        truth["stated"] = made.stated["equation"]
    elif kind == "coupled room":
        wall = int(rng.choice(sides))
        size = strip(made, rng, wanted, np.ones(N), [wall])
        volume = log_uniform(rng, 0.25, 2.5) * made.volume
        low = np.clip(
            log_uniform(rng, 0.03, 0.25) * np.exp(0.1 * rng.standard_normal() * OCTAVES), 0.01, 0.8
        )
        behind(made, rng, wall, volume, low)
        truth |= {"size": size, "volume": volume, "alpha": float(low.mean())}
    elif kind == "non-diffuse field":
        low = log_uniform(rng, *((0.003, 0.02) if large else (0.01, 0.12)))
        made.walls = replace(made.walls, scattering=np.full(len(made.polygons), low))
        made.vectors = False
        truth["scattering"] = low
    elif kind == "noise floor":
        made.noise_floor_db = float(rng.uniform(*((-40, -22) if large else (-58, -32))))
        truth["level"] = made.noise_floor_db
    elif kind == "unknown":  # a system that adds energy around one band
        gain = peak(log_uniform(rng, 400, 2500), 0.7, 0.35 * share)
        size = strip(made, rng, 0.5 * made.absorption, np.zeros(N), [1])
        made.walls.alpha[1, HIDDEN] = -gain
        truth["size"] = size
    return made


def slope_time(level_db: np.ndarray, t: np.ndarray, first: float, last: float) -> float:
    """Return the decay time of the line through 40 levels between two, NaN if not reached.

    The times at the levels are interpolated, so that a step in the decay counts as one.
    """
    if level_db.min() > last:
        return float("nan")
    levels = np.linspace(first, last, 40)
    at = np.interp(-levels, -level_db, t)
    if at[-1] - at[0] < 4 * (t[1] - t[0]):
        return float("nan")
    return float(-60 / np.polyfit(at, levels, 1)[0])


def evaluate(
    echogram: np.ndarray, width: float, delay: float, floor_db: float | None
) -> list[float]:
    """Return T20, EDT, T30 in s, C80 and G in dB of one receiver and band."""
    density = echogram[int(delay / width) :]
    strength = 10 * np.log10(4 * np.pi * 100 * density.sum())

    def decay(x: np.ndarray) -> np.ndarray:
        rest = np.cumsum(x[::-1])[::-1]
        return 10 * np.log10(np.maximum(rest / rest[0], 1e-12))

    t = width * np.arange(len(density))
    if floor_db is not None:
        # A constant level below that of the first 50 ms, over a record of twice the decay time.
        clean = slope_time(decay(density), t, -5, -25)
        last = len(density) if np.isnan(clean) else max(round(2 * clean / width), 40)
        density, t = density[:last], t[:last]
        density = density + density[: round(0.05 / width)].mean() * 10 ** (floor_db / 10)
    level = decay(density)
    split = round(0.08 / width)
    early, late = density[:split].sum(), density[split:].sum()
    clarity = 10 * np.log10(max(early, 1e-30) / max(late, 1e-30))
    edt = 6 * float(np.interp(10, -level, t)) if level.min() < -10 else float("nan")
    t20, t30 = (slope_time(level, t, -5, last) for last in (-25, -35))
    return [t20, edt, t30, clarity, strength]


def places(made: Room, rng: np.random.Generator, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Draw a source and five receivers, clear of walls, boxes and one another."""
    low = np.min([p.min(0) for p in made.polygons], axis=0)
    high = np.max([p.max(0) for p in made.polygons], axis=0)

    def point(margin: float, others: list[np.ndarray], apart: float) -> np.ndarray:
        for attempt in range(4000):
            x = rng.uniform(low, high)
            x[2] = min(x[2], rng.uniform(1.1, 1.8))
            tight = 0.5 ** (attempt // 1000)
            inside = (made.walls.normals @ x < made.walls.offsets - margin).all()
            free = not any((x > b[:3] - 0.1).all() and (x < b[3:] + 0.1).all() for b in made.boxes)
            if inside and free and all(np.linalg.norm(x - o) > apart * tight for o in others):
                return x
        raise ValueError("no place for a source or receiver")

    source = point(0.5, [], 0.0)
    receivers: list[np.ndarray] = []
    for _ in range(5):
        receivers.append(point(radius + 0.05, [source, *receivers], 0.25 * made.volume ** (1 / 3)))
    return source, np.array(receivers)


def measure(
    made: Room,
    walls: Walls,
    climate: tuple[float, float],
    seed: int,
    rng: np.random.Generator,
    n_rays: int = 8000,
) -> tuple[dict[str, Any], np.ndarray]:
    """Return parameters (5 pairs, n_bands) with noise, and distances in m."""
    radius = float(np.clip(0.09 * made.volume ** (1 / 3), 0.3, 0.9))
    source, receivers = places(made, np.random.default_rng([seed, 7]), radius)
    c = speed_of_sound(climate[0])
    air = attenuation(*climate) if made.air is None else made.air
    surface = sum(area_of(p) for p in made.polygons)
    mean = np.clip((made.areas @ made.alpha).min() / surface, 0.01, 0.9)
    longest = 0.161 * made.volume / (surface * mean)
    if made.second is not None:
        longest = max(longest, 0.027 * made.truth["volume"] ** (1 / 3) / made.truth["alpha"])
    length = float(np.clip(1.6 * longest, 0.8, 12.0))
    width = 0.0025
    scene = Scene(
        walls,
        air,
        source,
        receivers,
        made.volume,
        made.vectors,
        made.boxes,
        made.box_alpha,
        made.second,
        made.aperture,
    )
    echo = trace(scene, n_rays, seed, radius=radius, width=width, length=length, c=c)
    distance = np.linalg.norm(receivers - source, axis=1)
    values = np.array(
        [
            [
                evaluate(echo[r, b], width, (distance[r] - radius) / c, made.noise_floor_db)
                for b in range(N)
            ]
            for r in range(len(receivers))
        ]
    )
    out: dict[str, Any] = {}
    bandwidth = 0.71 * BANDS
    for i, name in enumerate(PARAMETERS):
        value = values[:, :, i]
        both = rng.standard_normal(N) * COMMON[name]
        if name in ("t20", "edt", "t30"):
            theory = {"t20": 0.88, "edt": 1.6, "t30": 0.55}[name] / np.sqrt(bandwidth * value)
            # Repeats of a deterministic source: a third of what noise-like responses would scatter.
            out[name] = value * np.exp(both / 2 + theory / 3 * rng.standard_normal(value.shape))
        else:
            out[name] = value + both / 2 + 0.3 * rng.standard_normal(value.shape)
    return out, distance


def as_measured(values: dict[str, Any], distances: Any = None) -> dict[str, Any]:
    """Return what a configuration states of values (n_pairs, n_bands) or of means (n_bands,)."""
    rows = {name: np.atleast_2d(table) for name, table in values.items()}
    pairs = [("S", f"R{i + 1}") for i in range(len(rows["t20"]))]
    stated = {} if distances is None else {"distances": distances}
    return {**stated, "measured": {"pairs": pairs, "values": rows}}


def plain(value: Any) -> Any:
    """Return JSON's types; numbers with five digits, None for what is not finite."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.bool_ | np.integer):
        return value.item()
    if isinstance(value, float | np.floating):
        return float(f"{value:.5g}") if np.isfinite(value) else None
    return value


def build(population: int, kind: int, index: int) -> dict[str, Any]:
    """Return {"case": what a user knows and measured, "truth": what the finder never sees}."""
    rng = np.random.default_rng([2026, population, kind, index])
    made = hide(KINDS[kind], rng, population in BEYOND)
    statement = STATEMENTS[index % 3]
    normals = made.walls.normals**2
    facing = np.zeros((len(made.materials), 3))
    for w, polygon in enumerate(made.polygons):
        whole = area_of(polygon)
        second = area_of(second_part(made, w))
        facing[made.owner[w, 0]] += (whole - second) * normals[w]
        if made.owner[w, 1] >= 0:
            facing[made.owner[w, 1]] += second * normals[w]
    climate, sigmas = made.stated["air"], np.maximum(0.3 * made.mu, 0.02)
    room = {
        "volume": made.stated["volume"],
        "centre_frequencies": BANDS,
        "material": [
            {"name": n, "area": area, "alpha": mu, "sigma": sigma}
            for n, area, mu, sigma in zip(
                made.materials, made.stated["areas"], made.mu, sigmas, strict=True
            )
        ],
        "air": None
        if climate is None
        else {"temperature": round(climate[0]), "humidity": round(climate[1])},
    }
    case: dict[str, Any] = {
        "room": room,
        "equation": made.stated["equation"],
        "facing": facing / facing.sum(1, keepdims=True),
        "configuration": [],
    }
    if statement == "stated":
        case["uncertainty"] = {"time": 0.03, "level": 0.6}
    seed = int(rng.integers(2**31))
    truth = made.truth | {
        "alpha": made.alpha,
        "areas": made.areas,
        "volume": made.volume,
        "statement": statement,
        "scattering": made.walls.scattering,
        "vectors": made.vectors,
        "seed": [population, kind, index],
    }
    configurations = [("A", made.walls, made.climate, {})]
    if index % 2:  # a second configuration: the largest material behind something known better
        j = int(np.argmax(made.areas))
        mu = np.clip(made.mu[j] + 0.25 * np.linspace(0.3, 1.2, N), 0.02, 0.9)
        sigma = np.maximum(0.1 * mu, 0.02)
        covered = np.clip(mu + sigma * rng.standard_normal(N), 0.01, 0.95)
        alpha = made.walls.alpha.copy()
        for w in range(len(made.polygons)):
            for part in (0, 1):
                if made.owner[w, part] == j:
                    alpha[w, part] = covered
        change = {made.materials[j]: {"alpha": mu, "sigma": sigma}}
        configurations.append(
            ("B", replace(made.walls, alpha=alpha), made.climate, {"changes": change})
        )
        truth["alpha_b"] = covered
    for k, (name, walls, climate, more) in enumerate(configurations):
        values, distances = measure(made, walls, climate, seed + k, rng)
        measured = as_measured(values, distances)
        if statement == "means":
            measured = as_measured({p: np.nanmean(v, axis=0) for p, v in values.items()})
        case["configuration"].append({"name": name, **measured, **more})
    return plain({"case": case, "truth": truth})
