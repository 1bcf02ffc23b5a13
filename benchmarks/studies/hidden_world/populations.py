"""Rooms with something hidden in them: what a user would know, what was measured, and the truth.

Fixed before any finder was written; only numbers tell the kinds apart outside this file. A room
is drawn from the seed (population, kind, index): population 0 is for development, 1 for the test.
Nothing of rtcal is imported: spectra, air and decay parameters here are the world's own.

Sizes are drawn log-uniformly over their whole range and none is rejected: where an area has to find
room on a wall, the walls absorb less, so that the size stands as drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.tracer import World, trace

BANDS = 125.0 * 2.0 ** np.arange(7)
C = 343.2
N = len(BANDS)

KINDS = {
    0: "nothing",
    1: "air",
    2: "opening",
    3: "audience",
    4: "furniture",
    5: "porous",
    6: "resonator",
    7: "area",
    8: "volume",
    9: "formula",
    10: "coupled",
    11: "nondiffuse",
    12: "noise",
    13: "unknown",  # an electroacoustic system that adds energy: in no library
}
SINGLE = range(14)
TOGGLED = {22: 2, 23: 3}  # measured with and without the suspect
TWINS = {35: 5, 38: 8, 40: 10}  # made so that something else looks the same; 40: the room is dead
DOUBLE = 50  # two of 1..12 at once
COUNTS = {
    0: {0: 80, **dict.fromkeys(range(1, 14), 10), 22: 10, 23: 10, DOUBLE: 12},
    1: {
        0: 203,
        **dict.fromkeys(range(1, 14), 25),
        22: 25,
        23: 25,
        **dict.fromkeys(TWINS, 10),
        DOUBLE: 50,
    },
    2: {0: 203},  # fresh rooms with nothing in them, for changes made after population 1 was seen
    # Fresh rooms that judge what was chosen after population 1 was seen. A quarter of its number.
    3: {0: 50, **dict.fromkeys(range(1, 14), 6), 22: 6, 23: 6},
    # Fresh rooms that judge sizes beyond the grid.
    4: {0: 24, **dict.fromkeys(range(1, 13), 4)},
}


@dataclass
class Hidden:
    """A room while it is being made: the world as it is, and the world as it is stated."""

    world: World
    areas: np.ndarray  # true, (6,)
    volume: float
    where: np.ndarray  # (6 walls, 6 materials), rows sum to 1
    alpha: np.ndarray  # true, (6, n_bands)
    mu: np.ndarray
    sigma: np.ndarray
    stated: dict[str, Any] = field(default_factory=dict)
    truth: list[dict[str, Any]] = field(default_factory=list)
    noise_floor_db: float | None = None


def air(f: np.ndarray, temperature: float, humidity: float) -> np.ndarray:
    """Energy attenuation, 1/m, after ISO 9613-1 at one atmosphere, written out again here."""
    kelvin = temperature + 273.15
    rel = kelvin / 293.15
    h = humidity * 10 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261)
    oxygen = 24 + 4.04e4 * h * (0.02 + h) / (0.391 + h)
    nitrogen = rel**-0.5 * (9 + 280 * h * np.exp(-4.170 * (rel ** (-1 / 3) - 1)))
    vib = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + f**2 / oxygen)
    vib = vib + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + f**2 / nitrogen)
    return 2 * f**2 * (1.84e-11 * rel**0.5 + rel**-2.5 * vib)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def wall_areas(size: np.ndarray) -> np.ndarray:
    x, y, z = size
    return np.array([y * z, y * z, x * z, x * z, x * y, x * y])


def draw_alpha(rng: np.random.Generator, mu: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """The truth, given what is known: normal within [0.005, 0.98], neighbouring octaves at 0.7."""
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    factor = np.linalg.cholesky(0.7**lag)
    out = np.empty_like(mu)
    for i in range(len(mu)):
        while True:
            out[i] = mu[i] + sigma[i] * (factor @ rng.standard_normal(N))
            if (out[i] > 0.005).all() and (out[i] < 0.98).all():
                break
    return out


def known(mu: np.ndarray) -> np.ndarray:
    return 0.01 + 0.07 * mu


def room(rng: np.random.Generator, mean_alpha: float) -> Hidden:
    """A box of 120 to 6000 m³ whose six materials are mixed over its walls."""
    volume = log_uniform(rng, 120, 6000)
    proportions = np.array([rng.uniform(1.2, 2.2), rng.uniform(0.8, 1.5), rng.uniform(0.45, 0.8)])
    size = proportions * (volume / np.prod(proportions)) ** (1 / 3)
    walls = wall_areas(size)
    where = 0.75 * np.eye(6) + 0.25 * rng.dirichlet(np.full(6, 0.5), 6)
    areas = walls @ where
    octaves = np.log2(BANDS / 1000)
    level = np.exp(rng.uniform(np.log(0.03), np.log(0.5), (6, 1)))
    mu = level * np.exp(rng.uniform(-0.25, 0.35, (6, 1)) * octaves)
    mu *= np.exp(rng.uniform(-0.08, 0.04, (6, 1)) * octaves**2)
    middle = areas @ mu[:, 2:5].mean(1) / areas.sum()
    mu = np.clip(mu * mean_alpha / middle, 0.02, 0.8)
    sigma = known(mu)
    alpha = draw_alpha(rng, mu, sigma)
    source = size * rng.uniform(0.15, 0.85, 3)
    radius = 0.5 * (volume / 200) ** 0.25
    source = np.clip(source, 0.8, size - 0.8)
    receivers: list[np.ndarray] = []
    while len(receivers) < 4:
        r = np.clip(size * rng.uniform(0.12, 0.88, 3), radius + 0.1, size - radius - 0.1)
        if np.linalg.norm(r - source) > max(radius + 0.5, 0.25 * volume ** (1 / 3)):
            receivers.append(r)
    climate = (rng.uniform(15, 25), rng.uniform(30, 65))
    world = World(
        size=size,
        alpha=where @ alpha,
        air=air(BANDS, *climate),
        scattering=rng.uniform(0.4, 0.9),
        source=source,
        receivers=np.array(receivers),
    )
    stated = {
        "volume": volume,
        "areas": areas,
        "air": {"temperature": climate[0], "humidity": climate[1]},
        "equation": "eyring",
    }
    return Hidden(world, areas, volume, where, alpha, mu, sigma, stated)


def middle_area(h: Hidden) -> float:
    return float(h.areas @ h.alpha[:, 2:5].mean(1))


def put(h: Hidden, rng: np.random.Generator, area: float, spectrum: np.ndarray, wall: int) -> None:
    """Put a rectangle of ``area`` on a wall; a size that does not fit is a mistake of this file."""
    axis = wall // 2
    one, two = {0: (1, 2), 1: (0, 2), 2: (0, 1)}[axis]
    a, b = h.world.size[one], h.world.size[two]
    share = area / (a * b)
    if share > 0.97:
        raise ValueError(f"{area:.1f} m² do not fit wall {wall}")
    stretch = np.exp(rng.uniform(-0.3, 0.3))
    wide = float(np.clip(np.sqrt(share) * stretch, share / 0.985, 0.985))
    high = share / wide
    p, q = rng.uniform(0, 1 - wide) * a, rng.uniform(0, 1 - high) * b
    rectangle = np.array([p, p + wide * a, q, q + high * b])
    h.world = replace(h.world, patch_wall=wall, patch=rectangle, patch_alpha=spectrum)


def largest(h: Hidden, walls: tuple[int, ...] = (0, 1, 2, 3, 4, 5)) -> tuple[int, float]:
    areas = wall_areas(h.world.size)
    wall = max(walls, key=lambda w: areas[w])
    return wall, float(areas[wall])


def absorbing(
    rng: np.random.Generator, size: float, top: float, walls: tuple[int, ...]
) -> tuple[Hidden, float, int]:
    """A room in which an absorber of ``size`` times its A, of coefficient ``top``, has a wall."""
    mean = log_uniform(rng, 0.08, 0.28)
    state = rng.bit_generator.state
    while True:
        rng.bit_generator.state = state
        h = room(rng, mean)
        wall, most = largest(h, walls)
        area = size * middle_area(h) / top
        if area < 0.9 * most:
            return h, area, wall
        mean *= 0.93


PEOPLE = np.array([0.30, 0.48, 0.66, 0.83, 0.90, 0.88, 0.82])
PERSON = np.array([0.16, 0.27, 0.42, 0.51, 0.56, 0.55, 0.52])
CHATTELS = np.array([0.55, 0.72, 0.86, 1.0, 1.08, 1.12, 1.12])


def add(h: Hidden | None, kind: int, rng: np.random.Generator) -> Hidden:
    """Hide one effect. Without a room, one is drawn that has the space; with one, what fits."""
    given = h

    def base() -> Hidden:
        return given or room(rng, log_uniform(rng, 0.08, 0.28))

    def space(size: float, top: float, walls: tuple[int, ...]) -> tuple[Hidden, float, int]:
        if given is None:
            return absorbing(rng, size, top, walls)
        wall, most = largest(given, walls)
        return given, min(size * middle_area(given) / top, 0.9 * most), wall

    if kind == 0:
        return base()
    jitter = np.exp(0.06 * rng.standard_normal(N))
    note: dict[str, Any] = {"kind": kind}
    if kind == 1:
        h = base()
        climate = (rng.uniform(5, 35), rng.uniform(5, 95))
        h.world = replace(h.world, air=air(BANDS, *climate))
        note |= {"temperature": climate[0], "humidity": climate[1]}
        if rng.random() < 0.5:
            h.stated["air"] = None
    elif kind == 2:
        size = log_uniform(rng, 0.05, 1.2)
        h, area, wall = space(size, 1.0, (0, 1, 2, 3, 4, 5))
        put(h, rng, area, np.ones(N), wall)
        note |= {"size": area}
    elif kind == 3:
        size = log_uniform(rng, 0.1, 1.2)
        if rng.random() < 0.5:
            spectrum = np.clip(PEOPLE * jitter, 0, 0.99)
            h, area, wall = space(size, float(spectrum[2:5].mean()), (4,))
            put(h, rng, area, spectrum, wall)
            note |= {"size": area}
        else:
            h = base()
            people = size * middle_area(h) / PERSON[2:5].mean()
            skin = 1.6 * people  # m²; a person's 1.6 m² absorb what PERSON says
            h.world = replace(h.world, objects_area=skin, objects_alpha=PERSON * jitter / 1.6)
            note |= {"persons": people}
    elif kind == 4:
        size = log_uniform(rng, 0.05, 1.0)
        h = base()
        area = size * middle_area(h)
        h.world = replace(
            h.world, objects_area=6 * area, objects_alpha=np.clip(CHATTELS * jitter / 6, 0, 1)
        )
        note |= {"size": area}
    elif kind == 5:
        size = log_uniform(rng, 0.1, 1.2)
        depth = log_uniform(rng, 0.01, 0.2)
        flow = log_uniform(rng, 3, 50)
        top = rng.uniform(0.85, 0.98)
        # Half of the top where the layer is about a fourteenth of a wave deep, a little sooner
        # when dense: a shape of catalogues, not of a theory.
        half = 24.0 / depth * (12 / flow) ** 0.15
        spectrum = top / (1 + (half / BANDS) ** 1.7) * jitter
        h, area, wall = space(size, 0.9, (0, 1, 2, 3, 4, 5))
        put(h, rng, area, np.clip(spectrum, 0.01, 0.99), wall)
        note |= {"size": area, "depth": depth, "flow": flow}
    elif kind == 6:
        size = log_uniform(rng, 0.1, 1.2)
        f0 = log_uniform(rng, 60, 500)
        q = log_uniform(rng, 0.7, 5)
        top = rng.uniform(0.6, 0.95)
        # The mean over the octave of a resonance's absorption.
        within = BANDS[:, None] * 2.0 ** np.linspace(-0.5, 0.5, 41)
        spectrum = (top / (1 + q**2 * (within / f0 - f0 / within) ** 2)).mean(1)
        h, area, wall = space(size, top, (0, 1, 2, 3, 4, 5))
        put(h, rng, area, np.clip(spectrum * jitter, 0, 0.99), wall)
        note |= {"size": area, "f0": f0, "q": q}
    elif kind == 7:
        x = log_uniform(rng, 0.4, 2.5)
        h = base()
        share = h.areas * h.alpha[:, 2:5].mean(1)
        j = int(rng.choice(6, p=share / share.sum()))
        h.stated["areas"] = np.where(np.arange(6) == j, h.areas / x, h.areas)
        note |= {"ratio": x, "material": j}
    elif kind == 8:
        x = log_uniform(rng, 0.7, 1.4)
        h = base()
        h.stated["volume"] = h.volume / x
        note |= {"ratio": x}
    elif kind == 9:
        h = given or room(rng, log_uniform(rng, 0.15, 0.42))
        h.stated["equation"] = "sabine" if rng.random() < 0.7 else "millington"
        note |= {"stated": h.stated["equation"]}
    elif kind == 10:
        size = log_uniform(rng, 0.05, 1.2)
        h, area, _ = space(size, 1.0, (1,))
        put(h, rng, area, np.ones(N), 1)
        h.world = replace(h.world, patch_alpha=None)
        width, height = h.world.size[1], h.world.size[2]
        volume = log_uniform(rng, 0.2, 3) * h.volume
        second = np.array([volume / (width * height), width, height])
        low = log_uniform(rng, 0.02, 0.3)
        tilt = np.exp(rng.uniform(-0.1, 0.2) * np.log2(BANDS / 1000))
        alpha = np.tile(np.clip(low * tilt, 0.01, 0.9), (6, 1))
        h.world = replace(h.world, second_size=second, second_alpha=alpha)
        note |= {"size": area, "volume": volume, "alpha": low}
    elif kind == 11:
        h = base()
        h.world = replace(h.world, scattering=log_uniform(rng, 0.01, 0.3))
        note |= {"scattering": h.world.scattering}
    elif kind == 12:
        h = base()
        h.noise_floor_db = float(rng.uniform(-60, -30))
        note |= {"level": h.noise_floor_db}
    else:
        h = base()
        size = log_uniform(rng, 0.1, 0.6)
        gain = np.array([0.1, 0.4, 1.0, 1.0, 0.5, 0.15, 0.02]) * size * middle_area(h)
        h.world = replace(h.world, objects_area=1.0, objects_alpha=-gain)
        note |= {"size": -float(gain[2:5].mean())}
    h.truth.append(note)
    return h


def twin(kind: int, rng: np.random.Generator) -> Hidden:
    """A room whose effect cannot be told from another by what is measured."""
    if kind == 40:
        h = add(None, 10, rng)
        h.world = replace(h.world, second_alpha=np.full((6, N), 0.95))
        h.truth[0]["alpha"] = 0.95
        return h
    h = add(None, TWINS[kind], rng)
    if kind == 35 and h.world.patch_alpha is not None:
        # A porous layer whose spectrum happens to be an audience's.
        h.world = replace(h.world, patch_alpha=np.clip(PEOPLE, 0, 0.99))
    return h


def make(population: int, kind: int, index: int) -> Hidden:
    rng = np.random.default_rng([population, kind, index])
    if kind in KINDS:
        return add(None, kind, rng)
    if kind in TOGGLED:
        return add(None, TOGGLED[kind], rng)
    if kind in TWINS:
        return twin(kind, rng)
    first, second = rng.choice(np.arange(1, 13), 2, replace=False)
    if first in (2, 3, 5, 6, 10) and second in (2, 3, 5, 6, 10):
        second = int(rng.choice([1, 4, 7, 8, 11, 12]))  # there is one rectangle a room
    if {int(first), int(second)} == {3, 4}:
        second = 12  # and one kind of object
    return add(add(None, int(first), rng), int(second), rng)


def fit(level_db: np.ndarray, low: float, high: float, width: float) -> float:
    within = (level_db <= low) & (level_db >= high)
    k = np.flatnonzero(within)
    if len(k) < 3:
        return float("nan")
    return float(-60 / np.polyfit(k * width, level_db[within], 1)[0])


def parameters(
    echogram: np.ndarray, start: int, width: float, floor_db: float | None
) -> dict[str, float]:
    """T20, T30, EDT, C80, G of one receiver and band, as a device without compensation would."""
    e = echogram[start:].copy()
    g = 10 * np.log10(4 * np.pi * 100 * e.sum())
    left = e[::-1].cumsum()[::-1]
    if floor_db is not None:
        # The floor as a device shows it: under the level at which the sound starts to decay, over
        # a record of twice the reverberation time.
        level = 10 * np.log10(np.maximum(left / left[0], 1e-30))
        t = fit(level, -5, -25, width)
        density = left[0] * 6 * np.log(10) / t * 10 ** (floor_db / 10)
        bins = round(2 * t / width)
        e = np.concatenate([e, np.zeros(max(bins - len(e), 0))])[: max(bins, 1)]
        e = e + density * width
        left = e[::-1].cumsum()[::-1]
    level = 10 * np.log10(np.maximum(left / left[0], 1e-30))
    early = round(0.08 / width)
    return {
        "t20": fit(level, -5, -25, width),
        "edt": fit(level, 0, -10, width),
        "t30": fit(level, -5, -35, width),
        "c80": 10 * np.log10(e[:early].sum() / e[early:].sum()),
        "g": g,
    }


def measure(h: Hidden, world: World, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    """Trace and evaluate, with 2 % on every time and 0.3 dB on every level."""
    width = 0.002
    surface = wall_areas(world.size)
    bare = (surface[:, None] * world.alpha).sum(0) + 4 * world.air * np.prod(world.size)
    longest = 0.161 * float(np.prod(world.size)) / bare.min()
    if world.second_size is not None and world.second_alpha is not None:
        area = wall_areas(world.second_size) @ world.second_alpha
        longest = max(longest, 0.161 * float(np.prod(world.second_size)) / area.min())
    radius = 0.5 * (h.volume / 200) ** 0.25
    found = trace(world, 6000, seed, width=width, length=max(1.1 * longest, 0.6), radius=radius)
    distances = np.linalg.norm(world.receivers - world.source, axis=1)
    names = ("t20", "edt", "t30", "c80", "g")
    values = np.empty((len(names), len(distances), N))
    for r, distance in enumerate(distances):
        start = int((distance - radius) / C / width)
        for b in range(N):
            one = parameters(found[r, b], start, width, h.noise_floor_db)
            values[:, r, b] = [one[n] for n in names]
    values[:3] *= np.exp(0.02 * rng.standard_normal(values[:3].shape))
    values[3:] += 0.3 * rng.standard_normal(values[3:].shape)
    return as_measured(dict(zip(names, values, strict=True)), distances)


def as_measured(values: dict[str, Any], distances: Any = None) -> dict[str, Any]:
    """Return what a configuration states of values (n_pairs, n_bands) or of means (n_bands,)."""
    rows = {name: np.atleast_2d(table) for name, table in values.items()}
    pairs = [("S", f"R{i + 1}") for i in range(len(rows["t20"]))]
    stated = {} if distances is None else {"distances": distances}
    return {**stated, "measured": {"pairs": pairs, "values": rows}}


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float | np.floating):
        # What cannot be read from a decay that never falls far enough was not measured.
        return None if not np.isfinite(value) else float(f"{value:.5g}")
    return value.item() if isinstance(value, np.generic) else value


def build(population: int, kind: int, index: int) -> dict[str, Any]:
    """Return {"case": what a user knows and measured, "truth": what the finder never sees}."""
    h = make(population, kind, index)
    rng = np.random.default_rng([population, kind, index, 1])
    materials = [f"material {i + 1}" for i in range(6)]
    sides = wall_areas(h.world.size)[:, None] * h.where
    facing = np.stack([sides[2 * a] + sides[2 * a + 1] for a in range(3)], 1)
    case: dict[str, Any] = {
        "room": {
            "volume": h.stated["volume"],
            "centre_frequencies": BANDS,
            "material": [
                {"name": n, "area": area, "alpha": mu, "sigma": sigma}
                for n, area, mu, sigma in zip(
                    materials, h.stated["areas"], h.mu, h.sigma, strict=True
                )
            ],
            "prior": {"band_correlation": 0.7},
            "air": h.stated["air"],
        },
        "equation": h.stated["equation"],
        "uncertainty": {"time": 0.02, "level": 0.3},
        "facing": facing / facing.sum(1, keepdims=True),
        "configuration": [],
    }
    first = {"name": "A", **measure(h, h.world, int(rng.integers(2**31)), rng)}
    case["configuration"].append(first)
    truth = {"alpha": h.alpha, "areas": h.areas, "volume": h.volume, "effects": h.truth}
    truth |= {"scattering": h.world.scattering, "seed": [population, kind, index]}
    if kind in TOGGLED:
        bare = replace(h.world, patch_wall=-1, patch_alpha=None, objects_area=0.0)
        second = {"name": "B", "suspect_removed": True}
        h.world = bare
    elif kind not in TWINS:
        # The material with most area is covered with another whose coefficients are known as well.
        j = int(np.argmax(h.areas))
        mu = np.clip(h.mu[j] + rng.uniform(0.15, 0.4) * np.linspace(0.4, 1.1, N), 0.02, 0.9)
        sigma = known(mu)
        alpha = h.alpha.copy()
        alpha[j] = draw_alpha(rng, mu[None], sigma[None])[0]
        h.world = replace(h.world, alpha=h.where @ alpha)
        second = {"name": "B", "changes": {materials[j]: {"alpha": mu, "sigma": sigma}}}
        truth["alpha_b"] = alpha[j]
    else:
        return plain({"case": case, "truth": truth})
    case["configuration"].append(second | measure(h, h.world, int(rng.integers(2**31)), rng))
    return plain({"case": case, "truth": truth})
