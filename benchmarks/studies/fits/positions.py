"""The calibration to every position beside T20 alone, on the frozen position rooms.

    python -m benchmarks.studies.fits.positions run --folder out --number 20  # can be resumed
    python -m benchmarks.studies.fits.positions table  # of the stored run, or --folder out

`run` fits all pairs for alpha, and those of three receivers
for the gaps at the other three. A method is "t20" (the loop of `rtcal.calibrate_simulator`) or
"positions" (the same with ``match``). The gaps of the stated and of the true alpha stand beside them.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.fits.positions_table import (
    FITTING,
    GAPS,
    JUDGED,
    complete,
    print_bound,
    read,
    stored_run,
    table,
)
from benchmarks.studies.position_rooms.load import (
    PRIORS,
    PositionRoom,
    at,
    load,
    stored,
    true_alpha,
    without_noise,
)
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.measurement import Measurement
from rtcal.loop.measured_pairs import ControlRuns, simulated_controls, trace_ahead
from rtcal.loop.positions import MORE_PATHS, precise
from rtcal.simulators import PathTracing, path_tracing
from rtcal.simulators.base import Observations
from rtcal.simulators.path_tracing import ScatteringModel

MATCH = ("t20", "edt", "c80", "ts", "level")
FITTED, HELD_OUT = ("R1", "R2", "R3"), ("R4", "R5", "R6")
PATHS = 8000
"""Of the simulator that is calibrated to every position, which weighs `MORE_PATHS` times as many. The
loop on T20 alone gets as many as are weighed."""
JUDGING_PATHS = 32000
"""Of the simulations that judge. With 8000, EDT of a pair has a noise of some 6 %: more than a JND."""
SEED = 100
"""Of the simulations that judge; a calibration uses others."""


class Traces:
    """Counts the traces of the path tracer while it is entered."""

    def __enter__(self) -> Traces:
        self.number, self._trace = 0, path_tracing.trace

        def counted(*args: Any, **options: Any) -> Any:
            self.number += 1
            return self._trace(*args, **options)

        path_tracing.trace = counted
        return self

    def __exit__(self, *_: object) -> None:
        path_tracing.trace = self._trace


class KeptTraces:
    """Keeps a room's traces while it is entered: they do not depend on alpha, nor on its prior."""

    def __enter__(self) -> KeptTraces:
        self._trace, self._kept = path_tracing.trace, dict[tuple[Any, ...], path_tracing.Paths]()

        def kept(geometry: Any, *points: np.ndarray, **options: Any) -> path_tracing.Paths:
            key = (
                geometry.vertices.tobytes(),
                *(x.tobytes() for x in points),
                *(
                    x.tobytes() if isinstance(x, np.ndarray) else x
                    for name, x in sorted(options.items())
                    if name not in ("longest", "workers")
                ),
            )
            if key not in self._kept or self._kept[key].longest < options["longest"]:
                self._kept[key] = self._trace(geometry, *points, **options)
            return self._kept[key]

        path_tracing.trace = kept
        return self

    def __exit__(self, *_: object) -> None:
        path_tracing.trace = self._trace


def calibrate(
    method: str,
    simulator: PathTracing,
    room: rt.Room,
    measured: Measurement,
    controls: ControlRuns | None = None,
    cache: Path | None = None,
) -> Any:
    """Return the result of "t20" or "positions", which may have its control runs already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if method == "t20":
            return rt.calibrate_simulator(simulator, room, measured)
        return rt.calibrate_positions(
            simulator, room, measured, match=MATCH, controls=controls, cache=cache
        )


def simulated(simulator: PathTracing, alpha: np.ndarray, like: Measurement) -> Measurement:
    """Return what a tracer hears at the pairs of a measurement; G is that of a source of unit power."""
    return predicted(simulator.observe(alpha, ("edt", "c80", "level"), seed=SEED), like)


def predicted(observations: Observations, like: Measurement) -> Measurement:
    """Return what is heard at the pairs of a measurement."""
    rows = [observations.pairs.index(pair) for pair in like.pairs]
    return Measurement(
        centre_frequencies=like.centre_frequencies,
        values={p: observations.natural("level" if p == "g" else p)[rows] for p in GAPS},
        pairs=like.pairs,
    )


def mean_gaps(model: Measurement, measured: Measurement) -> dict[str, float]:
    """Return the mean absolute gap over pairs and bands per parameter, in JND."""
    return {
        p: float(np.nanmean(np.abs(gap_jnd(model.values[p], measured.values[p], p)))) for p in GAPS
    }


def error(room: rt.Room, alpha: np.ndarray, truth: np.ndarray) -> float:
    """Return the area-weighted RMSE of alpha over surfaces and bands."""
    return float(np.sqrt(np.average(((alpha - truth) ** 2).mean(1), weights=room.areas)))


def judged(
    population: int, index: int, prior: str, methods: Sequence[str], folder: Path
) -> list[dict[str, Any]]:
    """Return a row per method for one room and prior."""
    case = load(population, index, prior)
    truth = true_alpha(population, index, prior)
    held_out = case.measured_at(HELD_OUT), at(without_noise(population, index, prior), HELD_OUT)
    judge = case.simulator(HELD_OUT, n_paths=JUDGING_PATHS, workers=1)
    rows = []
    for method in methods:
        row: dict[str, Any] = {
            "index": index,
            "prior": prior,
            "method": method,
            "surfaces": case.room.n_materials,
            "bands": case.room.n_bands,
            "volume": round(case.room.volume),
            "prior_error": error(case.room, case.room.alpha, truth),
        }
        tracer = judge
        if method in FITTING:
            figures, half = fitted(method, case, truth, folder / "controls")
            row |= figures
            alpha = half.alpha
            tracer = calibrated(judge, half) if method == "positions" else judge
        else:
            alpha = case.room.alpha if method == "stated" else truth
            tracer = knowing(judge, population, index) if method == "perfect" else judge
        heard = simulated(tracer, alpha, held_out[0])
        row["gap"], row["gap_without_noise"] = (mean_gaps(heard, m) for m in held_out)
        if method == "positions":
            foretold = predicted(half.predicted, held_out[0])
            row["predicted"], row["predicted_without_noise"] = (
                mean_gaps(foretold, m) for m in held_out
            )
        rows.append(row)
    return rows


def knowing(tracer: PathTracing, population: int, index: int) -> PathTracing:
    """Return the tracer with the room's true scattering."""
    hidden = stored(population, "truth")[index]["truth"]
    model: ScatteringModel = "vector" if hidden["vectors"] else "random"
    return replace(tracer, scattering=np.array(hidden["scattering"]), scattering_model=model)


def calibrated(judge: PathTracing, result: Any) -> PathTracing:
    """Return the judging tracer with the scattering that a calibration fitted."""
    tracer = result.tracer
    return replace(judge, scattering=tracer.scattering, scattering_model=tracer.scattering_model)


def fitted(
    method: str, case: PositionRoom, truth: np.ndarray, cache: Path
) -> tuple[dict[str, Any], Any]:
    """Return the figures of a fit to all pairs, and the result of a fit to half of them.

    Times and traces are without those of the control runs, which ``cache`` has; see `charged`.
    """
    n_paths = PATHS if method == "positions" else MORE_PATHS * PATHS
    simulator = case.simulator(n_paths=n_paths)
    with Traces() as traces:
        clock, processor = time.perf_counter(), time.process_time()
        result = calibrate(method, simulator, case.room, case.measured, cache=cache)
        row: dict[str, Any] = {
            "seconds": time.perf_counter() - clock,
            "processor": time.process_time() - processor,
            "traces": traces.number,
            "error": error(case.room, result.alpha, truth),
        }
    if method == "t20":  # it takes the mean over all of the simulator's pairs
        simulator = case.simulator(FITTED, n_paths=n_paths)
    controls = getattr(result, "controls", None)
    half = calibrate(method, simulator, case.room, case.measured_at(FITTED), controls)
    if method == "positions" and result.interval is not None:
        low, high = result.interval
        row["covered"] = int(((low <= truth) & (truth <= high)).sum())
        row["coefficients"] = int(truth.size)
    return row, half


def make_controls(folder: Path, population: int, index: int) -> None:
    """Make the control runs of a room for both priors, and write how long those of the first took.

    They do not depend on how a calibration uses them.
    """
    target = folder / "controls.jsonl"
    if index in {r["index"] for r in read(target)}:
        return
    rows = []
    for prior in PRIORS:
        case = load(population, index, prior)
        simulator = precise(case.simulator(n_paths=PATHS))
        trace_ahead(simulator, case.room.alpha, 0)
        clock, processor = time.perf_counter(), time.process_time()
        with Traces() as traces:
            simulated_controls(simulator, case.room, MATCH, cache=folder / "controls")
        rows.append(
            {
                "index": index,
                "seconds": time.perf_counter() - clock,
                "processor": time.process_time() - processor,
                "traces": traces.number,
            }
        )
    with target.open("a", encoding="utf-8") as file:
        file.write(json.dumps(rounded(rows[0])) + "\n")


def charged(rows: list[dict[str, Any]], controls: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows; those of every position with times and traces of the control runs, too."""
    of_room = {r["index"]: r for r in controls}
    costs = ("seconds", "processor", "traces")
    return [
        row | {c: row[c] + of_room[row["index"]][c] for c in costs}
        if row["method"] == "positions"
        else row
        for row in rows
    ]


def run(folder: Path, population: int, indices: Sequence[int], methods: Sequence[str]) -> None:
    """Judge the rooms that are not in the folder's results yet; written after each."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "results.jsonl"
    done = {(r["index"], r["prior"], r["method"]) for r in read(target)}
    for index in indices:
        with KeptTraces():
            make_controls(folder, population, index)
            for prior in PRIORS:
                missing = [m for m in methods if (index, prior, m) not in done]
                if not missing:
                    continue
                rows = judged(population, index, prior, missing, folder)
                rows = charged(rows, read(folder / "controls.jsonl"))
                with target.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(rounded(row)) + "\n" for row in rows)
                errors = (f"{r['method']} {r.get('error', 0):.4f}" for r in rows)
                print(index, prior, *errors, flush=True)


def rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=["run", "table"])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--population", type=int, default=JUDGED)
    parser.add_argument("--number", type=int, default=60, help="the first rooms")
    parser.add_argument("--methods", default="stated,truth,perfect,t20,positions")
    arguments = parser.parse_args()
    population = arguments.population

    def file_of(part: str) -> Path:
        """Return where a part of a run is: in the folder, or else stored."""
        return (
            arguments.folder / f"{part}.jsonl" if arguments.folder else stored_run(population, part)
        )

    if arguments.command == "run":
        indices = list(stored(population, "rooms"))[: arguments.number]
        folder = arguments.folder or Path("positions_run")
        run(folder, population, indices, arguments.methods.split(","))
    else:
        table(read(file_of("results")))
        print_bound(read(file_of("bound")), complete(read(file_of("results"))))


if __name__ == "__main__":
    main()
