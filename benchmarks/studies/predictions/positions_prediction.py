"""The quality of predictions at positions: another tracer's rooms, several changes in each.

    python -m benchmarks.studies.predictions.positions_prediction development --rooms 8  # to choose by
    python -m benchmarks.studies.predictions.positions_prediction third --rows third.jsonl  # once
    # what is stored
    python -m benchmarks.studies.predictions.positions_prediction told --rows third.jsonl

The rule stands in this folder's README.md and was written first. The hidden tracer is that of
`studies.position_rooms`, which shares no code with rtcal: all states of a room weigh the same rays.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import rtcal as rt
from benchmarks.studies.position_rooms import parameters, rooms, shapes
from benchmarks.studies.position_rooms.tracer import Scene, trace
from rtcal.acoustics.observables import observable
from rtcal.loop.predicted import PositionsPrediction, predict_positions
from rtcal.prediction import Change, Variant
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.base import observe
from rtcal.support.types import Array

WORLDS = {"development": 0, "third": 3}
"""Seeds of the rooms; 1 and 2 were those of two worlds that earlier versions were judged in."""
BANDS = parameters.OCTAVES[3:6]
MATCH = ("t20", "edt", "c80", "ts", "level")
CHANGES = 8
WORK = 8e6
_WIDTH = 0.001
_SPREAD = 0.1


@dataclass(frozen=True)
class World:
    """A room and its changes as stated, what was measured, and the truth after each."""

    tracer: PathTracing
    measured: rt.Measurement
    variants: tuple[Variant, ...]
    before: dict[str, Array]
    after: tuple[dict[str, Array], ...]
    scattering: Array
    vectors: bool


def world(part: str, index: int) -> World:
    """Draw a room, its coefficients from their prior, and changes; trace all states at once."""
    rng = np.random.default_rng([2026, 40, WORLDS[part], index])
    polygons = shapes.box(rng, float(np.exp(rng.uniform(np.log(100), np.log(1200)))) ** (1 / 3))
    stated = rooms.stated_alpha(rng, 6, BANDS)
    drawn = rooms.within_box(rng, stated, 0.3 * stated)
    climate = (float(np.round(rng.uniform(17, 25), 1)), float(np.round(rng.uniform(30, 60))))
    cube_root = shapes.volume(polygons) ** (1 / 3)
    radius = float(np.clip(0.065 * cube_root, 0.3, 0.8))
    sources, receivers = rooms.places(rng, polygons, radius)
    receivers = receivers[:3]
    scattering = rooms.scattering(rng, 1, 6)
    shares = rng.uniform(0.2, 0.8, 6)
    areas = np.array([shapes.area(p) for p in polygons])
    parts = [shapes.split(p, share) for p, share in zip(polygons, shares, strict=True)]
    column = {0: np.vstack([drawn, drawn])}
    variants = []
    for n in range(CHANGES):
        panel, true_panel = _panel(rng)
        walls = rng.permutation(6)[: 2 if n >= 6 else 1]
        whole = n in (4, 5)
        alpha = column[0].copy()
        covers = []
        for w in walls.tolist():
            alpha[w] = true_panel
            if whole:
                alpha[w + 6] = true_panel
            material = rt.Material("panel", panel.tolist(), [_SPREAD] * len(BANDS))
            area = None if whole else float(shares[w] * areas[w])
            covers.append(Change(cover=f"surface {w + 1}", by=material, area=area))
        column[n + 1] = alpha
        variants.append(Variant(f"change {n + 1}", tuple(covers)))
    n_states = len(column)
    scene = Scene(
        [p[0] for p in parts] + [p[1] for p in parts],
        np.concatenate([column[n] for n in range(n_states)], axis=1),
        np.concatenate([scattering, scattering]),
        np.tile(rooms.attenuation(*climate, BANDS), n_states),
        331.3 * np.sqrt(1 + climate[0] / 273.15),
        receivers,
        radius,
        bool(rng.random() < 0.5),
    )
    length = float(np.clip(1.3 * rooms.eyring(scene).max(), 0.5, 12.0))
    free_path = 4 * shapes.volume(polygons) / areas.sum()
    n_rays = int(np.clip(WORK * free_path / (scene.c * length), 10_000, 400_000))
    energy = np.concatenate(
        [trace(scene, s, n_rays, 7 + k, width=_WIDTH, length=length) for k, s in enumerate(sources)]
    )
    states = [energy[:, n * len(BANDS) : (n + 1) * len(BANDS)] for n in range(n_states)]
    share = rng.uniform(0.3, 0.8)
    heard = parameters.measure(rng, states[0], _WIDTH, BANDS, share)
    tracer = _stated(
        polygons, stated, climate, rooms.moved(rng, sources), rooms.moved(rng, receivers)
    )
    measured = rt.Measurement(
        centre_frequencies=BANDS,
        values=heard,
        pairs=tracer.pairs,
        common_uncertainty=common_of_all_pairs(heard, share),
    )
    truth = [parameters.evaluate(state, _WIDTH) for state in states]
    return World(
        tracer, measured, tuple(variants), truth[0], tuple(truth[1:]), scattering, scene.vectors
    )


def common_of_all_pairs(heard: dict[str, Array], share: float) -> dict[str, Array]:
    """The uncertainty that all pairs share, as the team knows it: in the unit, (n_bands,)."""
    which = np.searchsorted(parameters.OCTAVES, BANDS)
    return {
        p: share * parameters.BETWEEN_TEAMS[p][which] * (1 if p in ("c80", "g") else v.mean(axis=0))
        for p, v in heard.items()
    }


def _panel(rng: np.random.Generator) -> tuple[Array, Array]:
    """A new material: stated coefficients, and true ones that err by 0.1, bands correlated."""
    octave = np.log2(BANDS / 1000)
    panel = np.clip(rng.uniform(0.3, 0.85) + rng.uniform(-0.1, 0.15) * octave, 0.1, 0.95)
    noise = np.linalg.cholesky(0.7 ** np.abs(np.subtract.outer(octave, octave)))
    return panel, np.clip(panel + _SPREAD * noise @ rng.standard_normal(len(BANDS)), 0.02, 0.98)


def _stated(polygons, alpha, climate, sources, receivers) -> PathTracing:
    corners = np.unique(np.round(np.concatenate(polygons), 6), axis=0)

    def number(x: Array) -> int:
        return int(np.argmin(((corners - x) ** 2).sum(1)))

    names = [f"surface {i + 1}" for i in range(len(polygons))]
    geometry = Polyhedron(
        vertices=corners, faces=[[number(x) for x in p] for p in polygons], materials=names
    )
    room = rt.Room(
        name="hidden",
        volume=geometry.volume,
        materials=names,
        areas=geometry.face_areas,
        alpha=alpha,
        sigma=0.3 * alpha,
        centre_frequencies=BANDS,
        air=rt.Air(*climate),
        scattering=np.full(alpha.shape, 0.4),
    )
    named = [
        {f"{k}{i + 1}": p for i, p in enumerate(points)}
        for k, points in (("S", sources), ("R", receivers))
    ]
    return PathTracing(
        geometry=geometry, room=room, sources=named[0], receivers=named[1], n_paths=1000
    )


def truth_of(heard: dict[str, Array]) -> Array:
    """Return the truth as observed, (n_parameters, n_pairs + 1, n_bands); the mean stands last."""
    values = np.array([observable(p).observed(heard["g" if p == "level" else p]) for p in MATCH])
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def scored(index: int, part: str) -> list[dict[str, Array]]:
    """Return errors and half widths of the means over the pairs, of every change of a room, in JND.

    Each (n_parameters, n_bands); also the share of the pairs that are within their intervals.
    """
    made = world(part, index)
    tracer, room = made.tracer, made.tracer.room
    result = rt.calibrate_positions(tracer, room, made.measured, MATCH)
    found = predict_positions(result, made.variants, wanted=MATCH).predictions
    rows = []
    for prediction, heard in zip(found, made.after, strict=True):
        truth = truth_of(heard)
        stated = stated_alone(tracer, prediction)
        inside = (truth >= prediction.low) & (truth <= prediction.high)
        rows.append(
            {
                "z": ((prediction.middle - truth) / prediction.sigma)[:, -1],
                "inside": inside[:, -1],
                "at pairs": inside[:, :-1].mean(axis=1),
                "error": in_jnd(prediction, prediction.middle - truth)[:, -1],
                "stated": in_jnd(prediction, stated - truth)[:, -1],
                "half": in_jnd(prediction, (prediction.high - prediction.low) / 2)[:, -1],
            }
        )
    return rows


def stated_alone(tracer: PathTracing, prediction: PositionsPrediction) -> Array:
    """Return what the simulator hears after the change with the coefficients stated."""
    from rtcal.loop.predicted import ChangedRoom

    room = ChangedRoom(tracer.room, prediction.changes)
    walls = room.walls(tracer.room.alpha)
    values = observe(tracer, walls, MATCH, seed=5).values
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def in_jnd(prediction: PositionsPrediction, differences: Array) -> Array:
    """Return differences of observed values in JND, (n_parameters, n_pairs + 1, n_bands)."""
    rows = []
    for p, row in zip(MATCH, differences, strict=True):
        kind, own = observable(p), prediction.at_pairs(p)
        rows.append(row / kind.of_observed(np.broadcast_to(kind.jnd_of(own), own.shape), own))
    return np.array(rows)


def tell(rows: list[dict[str, Array]]) -> None:
    means = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    print(
        f"{len(rows)} changes; means over the pairs: error, stated (rms, JND), half width, coverage, z"
    )
    for i, p in (*enumerate(MATCH), (slice(None), "all")):
        row = {name: values[:, i] for name, values in means.items()}
        print(
            f"{p}: {rms(row['error']):.2f}, {rms(row['stated']):.2f}, "
            f"{np.median(row['half']):.1f}, {row['inside'].mean():.3f}, {rms(row['z']):.2f}"
        )
    ratio = rms(means["error"]) / rms(means["stated"])
    pairs = means["at pairs"].mean()
    by_room = means["inside"].reshape(-1, CHANGES, *means["inside"].shape[1:]).mean(axis=(1, 2, 3))
    spread = by_room.std(ddof=1) / np.sqrt(len(by_room)) if len(by_room) > 1 else np.nan
    print(
        f"error / stated {ratio:.2f}; coverage {means['inside'].mean():.3f} ± {spread:.3f}, "
        f"at single pairs {pairs:.3f}",
        flush=True,
    )


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def stored(path: Path) -> dict[int, list[dict[str, Array]]]:
    """Return the rows of the rooms of a file; none of a file that is not there."""
    lines = path.read_text().splitlines() if path.exists() else []
    found = {}
    for room in map(json.loads, lines):
        found[room["room"]] = [{k: np.array(v) for k, v in row.items()} for row in room["changes"]]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=(*WORLDS, "told"))
    parser.add_argument("--rooms", type=int, default=25)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rows", type=Path, nargs="+", help="file to which each room is added")
    stated = parser.parse_args()
    kept = {n: rows for path in stated.rows or () for n, rows in stored(path).items()}
    wanted = [] if stated.part == "told" else range(stated.first, stated.first + stated.rooms)
    start = time.process_time()
    for index in wanted:
        if index in kept:
            continue
        try:
            kept[index] = scored(index, stated.part)
        except rt.errors.RtcalError as error:
            print(f"room {index}: {error}", flush=True)
            continue
        print(f"room {index}: {time.process_time() - start:.0f} s of processor time", flush=True)
        if stated.rows:
            rows = [{k: (1.0 * v).round(4).tolist() for k, v in row.items()} for row in kept[index]]
            with stated.rows[0].open("a") as file:
                file.write(json.dumps({"room": index, "changes": rows}) + "\n")
    tell([row for _, rows in sorted(kept.items()) for row in rows])


if __name__ == "__main__":
    main()
