"""The position rooms: what is stated of a room, what was measured in it, and the truth of it.

It imports nothing of rtcal. A room is drawn from the seed (population, index). Population 0, ten rooms,
is for development. Populations 1 and 2, sixty rooms each, are for judging; of 2 49 were judged.
Population 1 was frozen on 2026-11-22, before the calibration to every position was tried on it, 2 on
2026-11-23, before the version that fits the scattering of each material was judged. Even rooms are
boxes of six surfaces, odd ones polyhedra of 10 to 30. Every surface has a material of its own.

- Volumes: 120 to 5,000 m³, log-uniform in as many strata as rooms. Six octaves or eight.
- Scattering 0.1 to 0.8 of either published meaning, not stated; the same in all bands. In half of the
  judging rooms the surfaces' coefficients have nothing in common.
- Two truths per room, each drawn from its prior around the stated alpha: sigma = 0.3 alpha, and
  sigma = 0.01 + 0.07 alpha; normal in each surface and band, within [0, 1].
- Two sources and six receivers. Each stands 0.05 m from where it is stated, in a random direction.
- Measurement: `studies.position_rooms.parameters`. No uncertainty is stated. The errors common to all
  pairs are half of those between teams; in the judging rooms 0.3 to 0.8 of them, drawn per room.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.studies.position_rooms import parameters, shapes
from benchmarks.studies.position_rooms.tracer import Scene, planes, sees, trace
from benchmarks.studies.position_rooms.tracer import _next_surface as next_surface

COUNTS = {0: 10, 1: 60, 2: 60}
PRIORS = ("wide", "narrow")
WIDTH = 0.001  # of the bins, s
OFF = 0.05  # of the positions, m
REFLECTIONS = 2e7
"""Traced per source. By two seeds of four rooms, T20 and EDT then have a noise of about 1 % per pair,
C80 of 0.1 dB. At 4 kHz a measured T20 of 1 s scatters by 1.7 %."""


def sigma_of(prior: str, alpha: np.ndarray) -> np.ndarray:
    return 0.3 * alpha if prior == "wide" else 0.01 + 0.07 * alpha


def attenuation(temperature: float, humidity: float, f: np.ndarray) -> np.ndarray:
    """Return the air's energy attenuation in 1/m (ISO 9613-1, at one atmosphere)."""
    t = temperature + 273.15
    h = humidity * 10 ** (4.6151 - 6.8346 * (273.16 / t) ** 1.261)  # molar concentration, %
    oxygen = 24 + 4.04e4 * h * (0.02 + h) / (0.391 + h)
    nitrogen = (t / 293.15) ** -0.5 * (
        9 + 280 * h * np.exp(-4.170 * ((t / 293.15) ** (-1 / 3) - 1))
    )
    relaxation = 0.01275 * np.exp(-2239.1 / t) / (oxygen + f**2 / oxygen)
    relaxation = relaxation + 0.1068 * np.exp(-3352.0 / t) / (nitrogen + f**2 / nitrogen)
    decibels = 8.686 * f**2 * (1.84e-11 * (t / 293.15) ** 0.5 + (t / 293.15) ** -2.5 * relaxation)
    return decibels / (10 * np.log10(np.e))


def stated_alpha(rng: np.random.Generator, n: int, bands: np.ndarray) -> np.ndarray:
    """Return coefficients as tables have them: levels 0.02 to 0.5, smooth over frequency."""
    octave = np.log2(bands / 1000)
    level = np.exp(rng.uniform(np.log(0.02), np.log(0.5), n)) * np.exp(0.3 * rng.standard_normal())
    tilt, bend = 0.2 * rng.standard_normal((2, n, 1))
    shape = tilt * octave + 0.3 * bend * (octave**2 - 2) / 2
    rough = 0.15 * rng.standard_normal((n, len(bands)))
    return np.round(np.clip(level[:, np.newaxis] * np.exp(shape + rough), 0.015, 0.85), 3)


def within_box(rng: np.random.Generator, mean: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Draw from the normal distribution, again wherever it lies outside [0, 1]."""
    drawn = rng.normal(mean, sigma)
    while (outside := (drawn < 0) | (drawn > 1)).any():
        drawn[outside] = rng.normal(mean, sigma)[outside]
    return drawn


def eyring(scene: Scene) -> np.ndarray:
    """Return Eyring's T per column in s."""
    sizes = np.array([shapes.area(p) for p in scene.polygons])
    absorbed = -sizes.sum() * np.log(1 - sizes @ scene.alpha / sizes.sum())
    v = shapes.volume(scene.polygons)
    return 24 * np.log(10) / scene.c * v / (absorbed + 4 * scene.air * v)


def places(
    rng: np.random.Generator, polygons: shapes.Polygons, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Draw two sources and six receivers: clear of walls, apart, and each pair in sight."""
    corners = np.concatenate(polygons)
    low, high = corners.min(0), corners.max(0)
    size = shapes.volume(polygons) ** (1 / 3)
    normals, offsets, edges = planes(polygons)
    count = np.array([len(p) for p in polygons])
    top = low[2] + 0.75 * (high[2] - low[2])

    def point(margin: float) -> np.ndarray:
        while True:
            x = rng.uniform(low, [*high[:2], top])
            u = rng.standard_normal(3)
            surface, _ = next_surface(x, u / np.linalg.norm(u), normals, offsets, edges, count, -1)
            inside = surface >= 0 and normals[surface] @ u > 0
            if inside and min(shapes.distance(x, p) for p in polygons) > margin:
                return x

    while True:
        sources = np.array([point(0.5), point(0.5)])
        if np.linalg.norm(sources[0] - sources[1]) < 0.35 * size:
            continue
        receivers: list[np.ndarray] = []
        for _ in range(300):
            x = point(radius + 0.06)
            far = np.linalg.norm(sources - x, axis=1).min() > max(1.2, 0.25 * size)
            apart = all(np.linalg.norm(x - r) > 0.22 * size for r in receivers)
            scene = Scene(polygons, *[np.zeros(1)] * 3, 343.0, x[np.newaxis], radius, False)
            if far and apart and all(sees(scene, s)[0] for s in sources):
                receivers.append(x)
            if len(receivers) == 6:
                return sources, np.array(receivers)


def moved(rng: np.random.Generator, positions: np.ndarray) -> np.ndarray:
    """Return positions `OFF` away, each in a random direction, to a millimetre."""
    u = rng.standard_normal(positions.shape)
    return np.round(positions + OFF * u / np.linalg.norm(u, axis=1, keepdims=True), 3)


def scattering(rng: np.random.Generator, population: int, n: int) -> np.ndarray:
    """Return coefficients 0.1 to 0.8: about one level, or unrelated in half of the judging rooms."""
    if population > 0 and rng.random() < 0.5:
        return rng.uniform(0.1, 0.8, n)
    return np.clip(rng.uniform(0.1, 0.8) + rng.normal(0, 0.12, n), 0.1, 0.8)


def draw(population: int, index: int) -> tuple[dict[str, Any], Scene, np.ndarray, np.ndarray]:
    """Return what is stated, the true scene of both truths' columns, sources, true alphas."""
    rng = np.random.default_rng([20261122, population, index])
    stratum = (index // 2 + rng.random()) / (COUNTS[population] // 2)
    cube_root = (120.0 * (5000 / 120) ** stratum) ** (1 / 3)
    if index % 2:
        polygons = shapes.polyhedron(
            rng, (index // 2) % len(shapes.KINDS), cube_root, int(rng.integers(10, 31))
        )
    else:
        polygons = shapes.box(rng, cube_root)
    n = len(polygons)
    bands = parameters.OCTAVES if rng.random() < 0.5 else parameters.OCTAVES[1:7]
    alpha = stated_alpha(rng, n, bands)
    truths = np.array([within_box(rng, alpha, sigma_of(p, alpha)) for p in PRIORS])
    climate = (float(np.round(rng.uniform(17, 25), 1)), float(np.round(rng.uniform(30, 60))))
    radius = float(np.clip(0.065 * cube_root, 0.3, 0.8))
    sources, receivers = places(rng, polygons, radius)
    scene = Scene(
        polygons,
        np.concatenate(list(truths), axis=1),
        scattering(rng, population, n),
        np.tile(attenuation(*climate, bands), 2),
        331.3 * np.sqrt(1 + climate[0] / 273.15),
        receivers,
        radius,
        bool(rng.random() < 0.5),
    )
    corners = np.unique(np.round(np.concatenate(polygons), 6), axis=0)

    def number(x: np.ndarray) -> int:
        return int(np.argmin(((corners - x) ** 2).sum(1)))

    stated = {
        "kind": shapes.KINDS[(index // 2) % 4].__name__ if index % 2 else "box",
        "vertices": corners,
        "faces": [[number(x) for x in p] for p in polygons],
        "volume": round(shapes.volume(polygons), 3),
        "areas": [round(shapes.area(p), 4) for p in polygons],
        "bands": bands,
        "alpha": alpha,
        "air": climate,
        "sources": moved(rng, sources),
        "receivers": moved(rng, receivers),
    }
    return stated, scene, sources, truths


def build(population: int, index: int, work: float = REFLECTIONS) -> dict[str, Any]:
    """Return {"stated", "measured", "truth"} of a room; pairs run over receivers first."""
    stated, scene, sources, truths = draw(population, index)
    length = float(np.clip(1.3 * eyring(scene).max(), 0.5, 12.0))
    free_path = 4 * stated["volume"] / sum(stated["areas"])
    n_rays = int(np.clip(work * free_path / (scene.c * length), 20_000, 800_000))
    energy = np.concatenate(
        [
            trace(scene, x, n_rays, 1000 * index + k, width=WIDTH, length=length)
            for k, x in enumerate(sources)
        ]
    )
    rng = np.random.default_rng([20261122, population, index, 1])
    k = len(stated["bands"])
    common = rng.uniform(0.3, 0.8) if population > 0 else 0.5
    measured, exact = {}, {}
    for i, prior in enumerate(PRIORS):
        part = energy[:, i * k : (i + 1) * k]
        exact[prior] = parameters.evaluate(part, WIDTH)
        measured[prior] = parameters.measure(rng, part, WIDTH, stated["bands"], common)
    truth = {
        "alpha": dict(zip(PRIORS, truths, strict=True)),
        "values": exact,
        "scattering": scene.scattering,
        "vectors": scene.vectors,
        "common": common,
        "sources": sources,
        "receivers": scene.receivers,
        "n_rays": n_rays,
    }
    return {"stated": stated, "measured": measured, "truth": truth}


def bare(scene: Scene, alpha: float) -> Scene:
    """Return the scene with one alpha everywhere, in one column."""
    n = len(scene.polygons)
    return replace(scene, alpha=np.full((n, 1), alpha), air=np.zeros(1))
