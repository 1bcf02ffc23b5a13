"""The room of `make demo` and `rtcal example diagnose`, measured by pyroomacoustics' ray tracer.

    python -m benchmarks.studies.pairs.seminar_room    # writes rtcal/datasets/seminar_room

Its model has acoustic panels on ceiling and back wall. In the room that is simulated, plasterboard
hangs below the panels of the ceiling. Besides, each coefficient is off by its stated sigma, surfaces
scatter less, sources and receivers stand 0.05 m from where they are stated, and every value has the
noise of a measurement. The room was made, and not drawn: what is hidden is large enough to be named.
"""

from __future__ import annotations

import json

import numpy as np

import rtcal as rt
from rtcal.datasets.examples import path
from rtcal.simulators import Polyhedron, RayTracing
from rtcal.simulators.base import observe

SEED = 1
SIZE = (11.0, 7.5, 3.6)
BANDS = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
PANELS = "acoustic panels"
WALLS = {
    "west": "plaster",
    "east": PANELS,
    "south": "plaster",
    "north": "glass",
    "floor": "linoleum",
    "ceiling": PANELS,
}
STATED = {
    "plaster": (0.04, 0.05, 0.05, 0.06, 0.06, 0.07),
    PANELS: (0.30, 0.55, 0.75, 0.80, 0.80, 0.75),
    "glass": (0.20, 0.15, 0.10, 0.07, 0.05, 0.04),
    "linoleum": (0.02, 0.03, 0.03, 0.03, 0.04, 0.04),
}
HIDDEN = {"plasterboard": (0.08, 0.07, 0.05, 0.04, 0.04, 0.04)}
SCATTERING, TRUE_SCATTERING = 0.3, 0.25
OFF = 0.05  # m
NOISE = {"t20": 0.03, "edt": 0.05, "ts": 0.04, "c80": 0.4}  # relative; C80 in dB
SOURCES = {"S1": (1.8, 2.2, 1.6), "S2": (8.9, 5.2, 1.6)}
RECEIVERS = {
    "R1": (4.4, 4.9, 1.2),
    "R2": (6.1, 1.6, 1.2),
    "R3": (9.6, 2.0, 1.2),
    "R4": (3.1, 6.3, 1.2),
}


def room_of(walls: dict[str, str], alpha: dict[str, tuple[float, ...]]) -> rt.Room:
    """Return the box with these materials on its walls."""
    box = Polyhedron.shoebox(SIZE, walls)
    rows = np.array([alpha[name] for name in box.areas])
    return rt.Room(
        name="seminar room",
        volume=box.volume,
        materials=list(box.areas),
        areas=np.array(list(box.areas.values())),
        alpha=rows,
        sigma=np.maximum(0.2 * rows, 0.01).round(4),
        centre_frequencies=BANDS,
        air=rt.Air(21.0, 45.0),
        scattering=np.full(rows.shape, SCATTERING),
        scene=rt.Scene(mesh="room.obj", sources=SOURCES, receivers=RECEIVERS),
    )


def measure() -> tuple[rt.Measurement, dict[str, object]]:
    """Return what is measured at the pairs, and what is true of the room."""
    rng = np.random.default_rng(SEED)
    stated = room_of(WALLS, STATED)
    drawn = stated.alpha + stated.sigma * rng.standard_normal(stated.alpha.shape)
    rows = dict(zip(stated.materials, np.clip(drawn, 0.01, 0.99), strict=True)) | HIDDEN
    walls = WALLS | {"ceiling": "plasterboard"}

    def off(points: dict[str, tuple[float, ...]]) -> dict[str, tuple[float, ...]]:
        step = rng.standard_normal((len(points), 3))
        moved = np.array([*points.values()]) + OFF * step / np.linalg.norm(step, axis=1)[:, None]
        return dict(zip(points, map(tuple, moved.tolist()), strict=True))

    tracer = RayTracing(
        room=room_of(walls, rows),
        geometry=Polyhedron.shoebox(SIZE, walls),
        sources=off(SOURCES),
        receivers=off(RECEIVERS),
        scattering=TRUE_SCATTERING,
        n_rays=40_000,
    )
    true = tracer.room.alpha
    seen = observe(tracer, true, tuple(NOISE), seed=SEED)
    values = {}
    for name, size in NOISE.items():
        value = seen.natural(name)
        scale = 1.0 if name == "c80" else value
        values[name] = (value + size * scale * rng.standard_normal(value.shape)).round(4)
    measured = rt.Measurement(centre_frequencies=BANDS, pairs=seen.pairs, values=values)
    truth = {name: np.round(row, 4).tolist() for name, row in rows.items()}
    return measured, {"hidden": "plasterboard on ceiling", "alpha": truth, "seed": SEED}


if __name__ == "__main__":
    measured, truth = measure()
    folder = path("seminar_room")
    folder.mkdir(exist_ok=True)
    texts = {
        "room.obj": Polyhedron.shoebox(SIZE, WALLS).to_text(),
        "room.toml": room_of(WALLS, STATED).to_text(),
        "pairs.csv": measured.to_text(),
        "truth.json": json.dumps(truth) + "\n",
    }
    for name, content in texts.items():
        (folder / name).write_text(content, encoding="utf-8")
