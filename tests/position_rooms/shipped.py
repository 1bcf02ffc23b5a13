"""Measurements in the room of `rtcal example where`: by this folder's tracer, not by rtcal's.

    python -m tests.position_rooms.shipped    # writes rtcal/datasets/where_room; a minute

The room is the L-shaped one of `rtcal.datasets.examples`, with a curtain on its west wall. It differs
from its model further, as in `tests.position_rooms.rooms`. The coefficients are drawn about the stated
ones with the stated sigma, the scattering is another, and sources and receivers stand 0.05 m from where
they are stated. Half of the differences between teams is common to all pairs. Nothing is chosen: it is
the one draw of `SEED`.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.datasets import examples
from rtcal.datasets.shipped import path
from tests.position_rooms import parameters
from tests.position_rooms.rooms import OFF, REFLECTIONS, WIDTH, attenuation
from tests.position_rooms.tracer import Scene, trace

SEED = 37
SHARE = 0.5
SCATTERING = 0.3
CURTAIN = (0.35, 0.60, 0.85, 0.90)
CURTAIN_SIDES = (1.8, 6.2)
"""Along the west wall in m, over the whole height: 14.1 m²."""
LENGTH = 2.0  # of the echograms, s
RADIUS = 0.3  # of the receivers, m
TEMPERATURE, HUMIDITY = 21.0, 45.0


def surfaces() -> list[tuple[str, np.ndarray]]:
    """Return the material and the polygon of each convex part of the room."""
    inner = examples._PLAN[3]  # the corner that points inwards cuts the floor into two rectangles
    parts = (
        ((0.0, 0.0), (9.0, 0.0), (9.0, inner[1]), (0.0, inner[1])),
        ((0.0, inner[1]), inner, (inner[0], 8.0), (0.0, 8.0)),
    )
    out = []
    for part in parts:
        for name, height in (("parquet", 0.0), ("ceiling", examples._HEIGHT)):
            out.append((name, np.array([(*corner, height) for corner in part])))
    shape = examples._l_shape()
    for name, material, face in zip(shape.names, shape.materials, shape.faces, strict=True):
        if name == "west":
            low, high = CURTAIN_SIDES
            for a, b, of in ((8.0, high, material), (high, low, "curtain"), (low, 0.0, material)):
                out.append((of, np.array(examples._wall((0.0, a), (0.0, b)))))
        elif name not in ("floor", "ceiling"):
            out.append((material, shape.vertices[list(face)]))
    return out


def off(rng: np.random.Generator, points: dict[str, Any]) -> np.ndarray:
    """Return the points moved by `OFF` in random directions."""
    step = rng.standard_normal((len(points), 3))
    return np.array(list(points.values())) + OFF * step / np.linalg.norm(step, axis=1)[:, None]


def measure() -> tuple[Measurement, dict[str, Any]]:
    """Return what is measured at the pairs, and the truth."""
    rng = np.random.default_rng(SEED)
    room = examples._rehearsal_room(examples._l_shape())
    alpha = np.clip(room.alpha + room.sigma * rng.standard_normal(room.alpha.shape), 0.01, 0.99)
    rows = dict(zip(room.materials, alpha, strict=True)) | {"curtain": CURTAIN}
    parts = surfaces()
    sources, receivers = off(rng, examples._SOURCES), off(rng, examples._RECEIVERS)
    scene = Scene(
        polygons=[polygon for _, polygon in parts],
        alpha=np.array([rows[material] for material, _ in parts]),
        scattering=np.full(len(parts), SCATTERING),
        air=attenuation(TEMPERATURE, HUMIDITY, examples._BANDS),
        c=331.3 * np.sqrt(1 + TEMPERATURE / 273.15),
        receivers=receivers,
        radius=RADIUS,
        vectors=True,
    )
    free_path = 4 * room.volume / room.total_area
    n_rays = int(REFLECTIONS * free_path / (scene.c * LENGTH))
    energy = np.concatenate(
        [
            trace(scene, x, n_rays, SEED + k, width=WIDTH, length=LENGTH)
            for k, x in enumerate(sources)
        ]
    )
    values = parameters.measure(rng, energy, WIDTH, examples._BANDS, SHARE)
    measured = Measurement(
        centre_frequencies=examples._BANDS,
        pairs=[(s, r) for s in examples._SOURCES for r in examples._RECEIVERS],
        values={name: values[name].round(4) for name in parameters.PARAMETERS},
    )
    truth = {name: np.round(row, 4).tolist() for name, row in rows.items()}
    return measured, {"alpha": truth, "scattering": SCATTERING, "seed": SEED}


if __name__ == "__main__":
    measured, truth = measure()
    path("where_room").mkdir(exist_ok=True)
    path("where_room/pairs.csv").write_text(measured.to_text(), encoding="utf-8")
    path("where_room/truth.json").write_text(json.dumps(truth) + "\n", encoding="utf-8")
