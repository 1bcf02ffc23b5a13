"""The third hidden world: L-shaped rooms and boxes, simulated by another group's engine.

The engine is misuka 0.1.0 (Jüterbock, Finnendahl, Worchel et al. 2025, doi 10.1121/2.0002193): paths
from each microphone with the source sampled at every reflection, and surfaces whose absorption and
scattering differ by band. It shares no code with rtcal, which imports nothing of it either. Its
licence is for research (PolyForm Noncommercial 1.0.0), so it has an environment of its own:

    python -m venv misuka && misuka/bin/pip install misuka==0.1.0 numpy numba scipy
    misuka/bin/python -m benchmarks.studies.third_world.generate 1

It needs LLVM 16 or later (``DRJIT_LIBLLVM_PATH``). The catalogue, the measuring noise and the way in
which parameters are read off an echogram are the second world's.

A room is drawn from the seed (population, kind, index). Frozen on 2026-11-23, before any finder read a
room of it. Every second room was measured in two configurations. Half of the rooms state a
handbook's coefficients with 30 %, half those found in situ, with 10 %; the uncertainty of what was
measured is stated in half of each.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.studies.second_world import rooms as second
from benchmarks.studies.second_world.rooms import (
    BANDS,
    CEILINGS,
    COMMON,
    FLOORS,
    PARAMETERS,
    PARTS,
    WALLS,
    N,
)

KINDS = ("nothing", "porous", "opening", "coupled room", "noise floor", "material")
COUNTS = {
    1: {k: {"nothing": 16}.get(k, 7) for k in KINDS},
    # Drawn on 2026-11-24, before any finder read a room of them.
    2: {k: {"nothing": 16}.get(k, 6) for k in KINDS},
    3: {k: {"nothing": 16}.get(k, 6) for k in KINDS},
    # Drawn on 2026-11-27, for the rule of that day.
    13: {k: {"nothing": 24}.get(k, 5) for k in KINDS},
}
RADIUS = 0.4
"""Of the source in m: a sphere that reflects and radiates alike from everywhere."""
WIDTH = 0.0025
"""Of a bin in s."""
PATHS = 2**12
"""Per microphone and band."""
HIDDEN = -1


@dataclass
class Strip:
    """Part of a wall, from ``begin`` to ``end`` in m along it; of a material, or `HIDDEN`."""

    wall: int
    begin: float
    end: float
    material: int


@dataclass
class Made:
    """A room while it is drawn: the true scene, and what is stated of it."""

    plan: np.ndarray  # (n, 2), anticlockwise
    boxes: list[np.ndarray]  # rectangles that make the plan: low and high corner
    height: float
    names: list[str]
    owner: dict[str, int]  # material of floor and ceiling
    strips: list[Strip]
    mu: np.ndarray  # stated, (n_materials, n_bands)
    alpha: np.ndarray  # true
    scattering: float
    climate: tuple[float, float]
    truth: dict[str, Any]
    hidden: np.ndarray | None = None  # (n_bands,); None where the strip is an aperture
    second: tuple[int, float, np.ndarray] | None = None  # wall, depth in m, alpha
    noise_floor_db: float | None = None
    areas: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def lengths(self) -> np.ndarray:
        return np.linalg.norm(np.roll(self.plan, -1, axis=0) - self.plan, axis=1)

    @property
    def floor(self) -> float:
        return float(sum(np.prod(box[1] - box[0]) for box in self.boxes))

    @property
    def volume(self) -> float:
        return self.floor * self.height

    @property
    def absorption(self) -> float:
        """S alpha in m², mean of 500 Hz to 2 kHz."""
        return float(self.areas @ self.alpha[:, 2:5].mean(1))


def plan_of(rng: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return a plan of area 1, anticlockwise, and the rectangles that it is made of."""
    long = second.log_uniform(rng, 1.0, 2.2)
    if rng.random() < 0.4:
        plan = np.array([[0, 0], [long, 0], [long, 1], [0, 1]], float)
        boxes = [np.array([[0, 0], [long, 1]])]
    else:
        a, b = long * rng.uniform(0.35, 0.7), rng.uniform(0.4, 0.7)
        plan = np.array([[0, 0], [long, 0], [long, b], [a, b], [a, 1], [0, 1]], float)
        boxes = [np.array([[0, 0], [long, b]]), np.array([[0, b], [a, 1]])]
    scale = 1 / np.sqrt(sum(np.prod(box[1] - box[0]) for box in boxes))
    return plan * scale, [box * scale for box in boxes]


def draw(rng: np.random.Generator, in_situ: bool) -> Made:
    """Draw a room with nothing hidden in it."""
    volume = second.log_uniform(rng, 100, 3000)
    height = float(np.clip(volume ** (1 / 3) * rng.uniform(0.4, 0.8), 2.5, 10))
    plan, boxes = plan_of(rng)
    scale = np.sqrt(volume / height)
    names: list[str] = []
    rows: list[tuple[float, ...]] = []

    def material(table: dict[str, tuple[float, ...]]) -> int:
        name = str(rng.choice(list(table)))
        if name not in names:
            names.append(name)
            rows.append(table[name])
        return names.index(name)

    floor = material(FLOORS)
    soft = rows[0][3] > 0.3  # a soft floor below a soft ceiling is a non-diffuse room by itself
    ceiling = material({k: v for k, v in CEILINGS.items() if not (soft and v[3] > 0.3)})
    usual = [material(WALLS), material(WALLS)]
    lengths = np.linalg.norm(np.roll(plan, -1, axis=0) - plan, axis=1) * scale
    strips = []
    for w, length in enumerate(lengths.tolist()):
        part = rng.uniform(0.1, 0.4) * length if rng.random() < 0.6 else 0.0
        if part:
            strips.append(Strip(w, 0.0, part, material(PARTS)))
        strips.append(Strip(w, part, length, usual[int(w == 1 or rng.random() < 0.3)]))
    catalogue = np.clip(np.array(rows), 0.01, 0.95)
    alpha = second.true_alpha(
        rng, catalogue, float(np.exp(0.1 * rng.standard_normal())), 0.04 * rng.standard_normal()
    )
    found = np.clip(alpha * np.exp(0.08 * rng.standard_normal(alpha.shape)), 0.01, 0.97)
    made = Made(
        plan * scale,
        [box * scale for box in boxes],
        height,
        names,
        {"floor": floor, "ceiling": ceiling},
        strips,
        found if in_situ else catalogue,
        alpha,
        float(rng.uniform(0.3, 0.7)),
        (float(rng.uniform(17, 26)), float(rng.uniform(25, 65))),
        {"in_situ": in_situ},
    )
    made.areas = areas_of(made)
    return made


def areas_of(made: Made) -> np.ndarray:
    """Return the area of each material in m², before anything is hidden."""
    areas = np.zeros(len(made.names))
    for material in made.owner.values():
        areas[material] += made.floor
    for strip in made.strips:
        areas[strip.material] += (strip.end - strip.begin) * made.height
    return areas


def cover(made: Made, rng: np.random.Generator, area: float) -> Strip:
    """Hide a strip of this area at the end of an outer wall; at most 80 % of what is there."""
    outer = [s for s in made.strips if s.wall not in (2, 3) or len(made.plan) == 4]
    last = [s for s in outer if s.end > made.lengths[s.wall] - 1e-9]
    free = np.array([0.8 * (s.end - s.begin) * made.height for s in last])
    chosen = [s for s, f in zip(last, free, strict=True) if f >= area]
    of = chosen[int(rng.integers(len(chosen)))] if chosen else last[int(np.argmax(free))]
    width = min(area, float(free[last.index(of)])) / made.height
    strip = Strip(of.wall, of.end - width, of.end, HIDDEN)
    of.end = strip.begin
    made.strips.append(strip)
    made.truth |= {"wall": of.wall, "size": width * made.height}
    return strip


def hide(kind: str, rng: np.random.Generator, in_situ: bool) -> Made:
    """Draw a room and hide one thing of this kind in it."""
    made = draw(rng, in_situ)
    truth = made.truth
    truth["kind"] = kind
    wanted = second.log_uniform(rng, 0.12, 1.0) * made.absorption
    if kind == "porous":
        depth, flow = second.log_uniform(rng, 0.02, 0.15), second.log_uniform(rng, 4, 40)
        curve = second.porous(depth, flow)
        cover(made, rng, wanted / max(curve[2:5].mean(), 0.2))
        made.hidden = np.clip(curve * second.smooth(rng, 0.12), 0.02, 0.99)
        truth |= {"depth": depth, "flow": flow}
    elif kind == "opening":
        cover(made, rng, wanted)
        made.hidden = np.full(N, 0.995)
    elif kind == "coupled room":
        strip = cover(made, rng, wanted)
        volume = second.log_uniform(rng, 0.25, 2.5) * made.volume
        mean = second.log_uniform(rng, 0.03, 0.25)
        tilt = np.exp(0.1 * rng.standard_normal() * second.OCTAVES)
        depth = volume / (made.lengths[strip.wall] * made.height)
        made.second = (strip.wall, depth, np.clip(mean * tilt, 0.01, 0.8))
        truth |= {"volume": volume, "alpha": mean}
    elif kind == "noise floor":
        made.noise_floor_db = float(rng.uniform(-56, -30))
        truth["level"] = made.noise_floor_db
    elif kind == "material":  # one material is another one of its table
        tables = [FLOORS, CEILINGS, WALLS, PARTS]
        least = 0.12 * made.absorption
        others = [
            (i, other)
            for i, name in enumerate(made.names)
            for table in tables
            if name in table
            for other, row in table.items()
            if abs(made.areas[i] * (np.mean(row[2:5]) - made.alpha[i, 2:5].mean())) >= least
        ]
        i, other = others[int(rng.integers(len(others)))]
        row = next(np.array(t[other]) for t in tables if other in t)
        made.alpha[i] = np.clip(row * second.smooth(rng, 0.12), 0.01, 0.97)
        truth |= {"material": made.names[i], "is": other}
    return made


def inside(made: Made, point: np.ndarray, margin: float) -> bool:
    """Whether a point is in the plan, this far from every wall."""
    if not any((point > box[0]).all() and (point < box[1]).all() for box in made.boxes):
        return False
    begin, step = made.plan, np.roll(made.plan, -1, axis=0) - made.plan
    at = np.clip(((point - begin) * step).sum(1) / (step**2).sum(1), 0, 1)
    return bool((np.linalg.norm(begin + at[:, None] * step - point, axis=1) > margin).all())


def places(made: Made, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a source and three receivers that see it."""
    low, high = made.plan.min(0), made.plan.max(0)

    def point(others: list[np.ndarray], apart: float) -> np.ndarray:
        for attempt in range(20000):
            flat = rng.uniform(low, high)
            seen = all(
                inside(made, flat + t * (other[:2] - flat), 0.05)
                for other in others[:1]
                for t in np.linspace(0, 1, 41)
            )
            tight = 0.7 ** (attempt // 2000)
            far = all(np.linalg.norm(flat - other[:2]) > apart * tight for other in others)
            if seen and far and inside(made, flat, 0.6):
                return np.append(flat, rng.uniform(1.1, 1.8))
        raise ValueError("no place for a source or receiver")

    points: list[np.ndarray] = []
    for _ in range(4):
        points.append(point(points, 0.25 * made.volume ** (1 / 3)))
    return points[0], np.array(points[1:])


def measured(made: Made, alpha: np.ndarray, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return what a configuration states: parameters (3 pairs, n_bands) with noise, distances in m."""
    from benchmarks.studies.third_world.engine import echogram

    source, receivers = places(made, np.random.default_rng([seed, 7]))
    c, air = second.speed_of_sound(made.climate[0]), second.attenuation(*made.climate)
    surface = made.areas.sum()
    mean = np.clip((made.areas @ alpha).min() / surface, 0.01, 0.9)
    longest = 0.161 * made.volume / (surface * mean)
    if made.second is not None:
        longest = max(longest, 0.027 * made.truth["volume"] ** (1 / 3) / made.truth["alpha"])
    length = float(np.clip(1.4 * longest, 0.8, 6.0))
    distance = np.linalg.norm(receivers - source, axis=1)
    values = np.empty((len(receivers), N, len(PARAMETERS)))
    for r, receiver in enumerate(receivers):
        echo = echogram(made, alpha, source, receiver, length, c, seed + r)
        bins = np.arange(echo.shape[1])
        echo = echo * np.exp(-air[:, None] * c * WIDTH * (bins + 0.5))
        delay = float(distance[r]) / c
        echo[:, : int(delay / WIDTH)] = 0.0
        echo[:, int(delay / WIDTH)] += np.exp(-air * distance[r]) / (4 * np.pi * distance[r] ** 2)
        for k in range(N):
            values[r, k] = second.evaluate(echo[k], WIDTH, delay, made.noise_floor_db)
    out: dict[str, np.ndarray] = {}
    for i, name in enumerate(PARAMETERS):
        value = values[:, :, i]
        both = rng.standard_normal(N) * COMMON[name]
        if name in ("t20", "edt", "t30"):
            theory = {"t20": 0.88, "edt": 1.6, "t30": 0.55}[name] / np.sqrt(0.71 * BANDS * value)
            out[name] = value * np.exp(both / 2 + theory / 3 * rng.standard_normal(value.shape))
        else:
            out[name] = value + both / 2 + 0.3 * rng.standard_normal(value.shape)
    return second.as_measured(out, distance)


def facing_of(made: Made) -> np.ndarray:
    """Return the share of each material's area whose normal is along x, y and z."""
    facing = np.zeros((len(made.names), 3))
    for material in made.owner.values():
        facing[material, 2] += made.floor
    steps = np.roll(made.plan, -1, axis=0) - made.plan
    of_wall = {s.wall: s.material for s in made.strips if s.material != HIDDEN and s.begin > 0}
    for s in made.strips:
        main = of_wall.get(s.wall, next(x.material for x in made.strips if x.wall == s.wall))
        owner = main if s.material == HIDDEN else s.material
        facing[owner, int(abs(steps[s.wall][0]) > 1e-9)] += (s.end - s.begin) * made.height
    return facing / facing.sum(1, keepdims=True)


def build(population: int, kind: int, index: int) -> dict[str, Any]:
    """Return {"case": what a user knows and measured, "truth": what the finder never sees}."""
    rng = np.random.default_rng([2026, 3, population, kind, index])
    in_situ, statement = index % 4 < 2, ("stated", "pairs")[index // 4 % 2]
    made = hide(KINDS[kind], rng, in_situ)
    sigma = np.maximum((0.1 if in_situ else 0.3) * made.mu, 0.02)
    case: dict[str, Any] = {
        "room": {
            "volume": made.volume,
            "centre_frequencies": BANDS,
            "material": [
                {"name": n, "area": area, "alpha": mu, "sigma": s}
                for n, area, mu, s in zip(made.names, made.areas, made.mu, sigma, strict=True)
            ],
            "air": {"temperature": round(made.climate[0]), "humidity": round(made.climate[1])},
        },
        "equation": "eyring",
        "facing": facing_of(made),
        "configuration": [],
    }
    if statement == "stated":
        case["uncertainty"] = {"time": 0.03, "level": 0.6}
    seed = int(rng.integers(2**30))
    configurations: list[tuple[str, np.ndarray, dict[str, Any]]] = [("A", made.alpha, {})]
    if index % 2:  # a second configuration: the largest material behind something known better
        j = int(np.argmax(made.areas))
        mu = np.clip(made.mu[j] + 0.25 * np.linspace(0.3, 1.2, N), 0.02, 0.9)
        known = np.maximum(0.1 * mu, 0.02)
        alpha = made.alpha.copy()
        alpha[j] = np.clip(mu + known * rng.standard_normal(N), 0.01, 0.95)
        change = {made.names[j]: {"alpha": mu, "sigma": known}}
        configurations.append(("B", alpha, {"changes": change}))
    for k, (name, alpha, more) in enumerate(configurations):
        found = measured(made, alpha, seed + 10 * k, rng)
        case["configuration"].append({"name": name, **found, **more})
    truth = made.truth | {
        "alpha": made.alpha,
        "statement": statement,
        "scattering": made.scattering,
        "walls": len(made.plan),
        "seed": [population, kind, index],
    }
    return second.plain({"case": case, "truth": truth})
