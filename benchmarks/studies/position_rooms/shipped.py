"""Measurements in the room of `rtcal example where`: by this folder's tracer, not by rtcal's.

    python -m benchmarks.studies.position_rooms.shipped    # writes rtcal/datasets/where_room; a minute

The room is L-shaped, with a curtain on its west wall. It differs from its model further, as in
`studies.position_rooms.rooms`. The coefficients are drawn about the stated ones with the stated sigma.
The scattering is another, and sources and receivers stand 0.05 m from where they are stated. Half of
the differences between teams is common to all pairs. Nothing is chosen: it is the one draw of `SEED`.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from benchmarks.studies.position_rooms import parameters
from benchmarks.studies.position_rooms.rooms import OFF, REFLECTIONS, WIDTH, attenuation
from benchmarks.studies.position_rooms.tracer import Scene, trace
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.acoustics.room import Scene as StatedScene
from rtcal.datasets.examples import path
from rtcal.simulators.geometry import Polyhedron

SEED = 37
SHARE = 0.5
SCATTERING = 0.3
CURTAIN = (0.35, 0.60, 0.85, 0.90)
CURTAIN_SIDES = (1.8, 6.2)
"""Along the west wall in m, over the whole height: 14.1 m²."""
LENGTH = 2.0  # of the echograms, s
RADIUS = 0.3  # of the receivers, m
TEMPERATURE, HUMIDITY = 21.0, 45.0

PLAN = ((0.0, 0.0), (9.0, 0.0), (9.0, 4.0), (5.0, 4.0), (5.0, 8.0), (0.0, 8.0))
HEIGHT = 3.2
WALLS = ("south", "east", "step", "inner", "north", "west")
BANDS = np.array([250.0, 500.0, 1000.0, 2000.0])
STATED = {
    "parquet": (0.05, 0.06, 0.08, 0.08),
    "ceiling": (0.20, 0.25, 0.30, 0.30),
    "plaster": (0.08, 0.06, 0.05, 0.05),
    "glass": (0.15, 0.10, 0.06, 0.05),
}
SOURCES = {"S1": (1.5, 1.3, 1.5), "S2": (7.8, 2.9, 1.5)}
RECEIVERS = {
    "R1": (3.2, 2.2, 1.2),
    "R2": (6.2, 1.1, 1.2),
    "R3": (2.2, 4.4, 1.2),
    "R4": (3.9, 6.6, 1.2),
    "R5": (1.1, 6.9, 1.2),
    "R6": (8.0, 1.0, 1.2),
}


def l_shape() -> Polyhedron:
    """Return the L-shaped room as its model states it."""
    faces = [("floor", "parquet", _level(0.0)), ("ceiling", "ceiling", _level(HEIGHT))]
    for name, start, end in zip(WALLS, PLAN, (*PLAN[1:], PLAN[0]), strict=True):
        faces.append((name, "glass" if name == "east" else "plaster", _wall(start, end)))
    return Polyhedron.from_polygons(faces)


def _level(height: float) -> list[tuple[float, ...]]:
    return [(*corner, height) for corner in PLAN]


def _wall(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[float, ...]]:
    return [(*start, 0.0), (*end, 0.0), (*end, HEIGHT), (*start, HEIGHT)]


def stated_room(geometry: Polyhedron) -> Room:
    """Return the room as its model states it."""
    alpha = np.array([STATED[name] for name in geometry.areas])
    return Room(
        name="rehearsal room",
        volume=geometry.volume,
        materials=list(geometry.areas),
        areas=np.array(list(geometry.areas.values())),
        alpha=alpha,
        sigma=np.maximum(0.2 * alpha, 0.01).round(4),
        centre_frequencies=BANDS,
        air=Air(TEMPERATURE, HUMIDITY),
        scattering=np.full(alpha.shape, 0.4),
        scene=StatedScene(mesh="room.obj", sources=SOURCES, receivers=RECEIVERS),
    )


def surfaces() -> list[tuple[str, np.ndarray]]:
    """Return the material and the polygon of each convex part of the room."""
    inner = PLAN[3]  # the corner that points inwards cuts the floor into two rectangles
    parts = (
        ((0.0, 0.0), (9.0, 0.0), (9.0, inner[1]), (0.0, inner[1])),
        ((0.0, inner[1]), inner, (inner[0], 8.0), (0.0, 8.0)),
    )
    out = []
    for part in parts:
        for name, height in (("parquet", 0.0), ("ceiling", HEIGHT)):
            out.append((name, np.array([(*corner, height) for corner in part])))
    shape = l_shape()
    for name, material, face in zip(shape.names, shape.materials, shape.faces, strict=True):
        if name == "west":
            low, high = CURTAIN_SIDES
            for a, b, of in ((8.0, high, material), (high, low, "curtain"), (low, 0.0, material)):
                out.append((of, np.array(_wall((0.0, a), (0.0, b)))))
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
    room = stated_room(l_shape())
    alpha = np.clip(room.alpha + room.sigma * rng.standard_normal(room.alpha.shape), 0.01, 0.99)
    rows = dict(zip(room.materials, alpha, strict=True)) | {"curtain": CURTAIN}
    parts = surfaces()
    sources, receivers = off(rng, SOURCES), off(rng, RECEIVERS)
    scene = Scene(
        polygons=[polygon for _, polygon in parts],
        alpha=np.array([rows[material] for material, _ in parts]),
        scattering=np.full(len(parts), SCATTERING),
        air=attenuation(TEMPERATURE, HUMIDITY, BANDS),
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
    values = parameters.measure(rng, energy, WIDTH, BANDS, SHARE)
    measured = Measurement(
        centre_frequencies=BANDS,
        pairs=[(s, r) for s in SOURCES for r in RECEIVERS],
        values={name: values[name].round(4) for name in parameters.PARAMETERS},
    )
    truth = {name: np.round(row, 4).tolist() for name, row in rows.items()}
    return measured, {"alpha": truth, "scattering": SCATTERING, "seed": SEED}


if __name__ == "__main__":
    measured, truth = measure()
    path("where_room").mkdir(exist_ok=True)
    geometry = l_shape()
    path("where_room/room.obj").write_text(geometry.to_text(), encoding="utf-8")
    path("where_room/room.toml").write_text(stated_room(geometry).to_text(), encoding="utf-8")
    path("where_room/pairs.csv").write_text(measured.to_text(), encoding="utf-8")
    path("where_room/truth.json").write_text(json.dumps(truth) + "\n", encoding="utf-8")
