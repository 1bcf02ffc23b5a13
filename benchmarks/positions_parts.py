"""Which of the simulator's errors costs how much, on the development rooms.

    python -m benchmarks.positions_parts run --folder out     # can be resumed
    python -m benchmarks.positions_parts table                # of the stored run, or --folder out

A calibration to every position is told, one after the other, what it does not know: how each surface
scatters, and where sources and receivers stand. The error of alpha and the gap at the held-out pairs
stand beside those of T20 alone, and beside the error that a simulator without any error has.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.positions import (
    FITTED,
    HELD_OUT,
    JUDGING_PATHS,
    MATCH,
    PATHS,
    KeptTraces,
    calibrate,
    calibrated,
    error,
    knowing,
    least_error,
    mean_gap,
    rounded,
)
from benchmarks.positions_table import read
from rtcal.loop import control_runs
from rtcal.loop.positions import MORE_PATHS, precise
from rtcal.simulators import PathTracing
from tests.position_rooms.generate import HERE, order
from tests.position_rooms.load import (
    RECEIVERS,
    SOURCES,
    PositionRoom,
    at,
    load,
    stored,
    true_alpha,
    without_noise,
)
from tests.position_rooms.rooms import PRIORS

STORED = HERE / "population_0_parts.jsonl"
TOLD = ("nothing", "scattering", "scattering and places")
WITH_GAP = TOLD[:2]
_POPULATION = 0


def placed(tracer: PathTracing, index: int) -> PathTracing:
    """Return the tracer with the true places."""
    truth = stored(_POPULATION, "truth")[index]["truth"]
    sources, receivers = (
        dict(zip(names, np.array(truth[kind], dtype=float), strict=True))
        for kind, names in (("sources", SOURCES), ("receivers", RECEIVERS))
    )
    return replace(tracer, sources=sources, receivers={r: receivers[r] for r in tracer.receivers})


def told_of(case: PositionRoom, index: int, told: str) -> tuple[PathTracing, dict[str, Any]]:
    """Return the tracer and the options of a calibration that is told something."""
    tracer = case.simulator(n_paths=PATHS)
    if told == "nothing":
        return tracer, {"controls": runs_of(tracer, case, control_runs._varied)}
    tracer = knowing(tracer, _POPULATION, index)
    if told != "scattering":
        tracer = placed(tracer, index)
    controls = runs_of(tracer, case, as_told(moved=told == "scattering"))
    return tracer, {"controls": controls, "fit_scattering": False}


Varied = Callable[[PathTracing, np.random.Generator, int, float], PathTracing]


def as_told(moved: bool) -> Varied:
    """Return control runs' variation of paths, alpha and, if ``moved``, places alone."""
    varied = control_runs._varied

    def known(
        base: PathTracing, rng: np.random.Generator, run: int, uncertainty: float
    ) -> PathTracing:
        other = varied(base, rng, run, uncertainty)
        other = replace(other, scattering=base.scattering, scattering_model=base.scattering_model)
        return other if moved else replace(other, sources=base.sources, receivers=base.receivers)

    return known


def runs_of(tracer: PathTracing, case: PositionRoom, varied: Varied) -> Any:
    """Return control runs that are varied in this way."""
    module: Any = control_runs
    before, module._varied = module._varied, varied
    try:
        return control_runs.control_runs(precise(tracer), case.room, MATCH)
    finally:
        module._varied = before


def judged(index: int, prior: str) -> dict[str, Any]:
    """Return the figures of a room with a prior."""
    case, truth = load(_POPULATION, index, prior), true_alpha(_POPULATION, index, prior)
    held_out = at(without_noise(_POPULATION, index, prior), HELD_OUT)
    judge = case.simulator(HELD_OUT, n_paths=JUDGING_PATHS)

    many = MORE_PATHS * PATHS
    alone = calibrate("t20", case.simulator(n_paths=many), case.room, case.measured)
    half = calibrate(
        "t20", case.simulator(FITTED, n_paths=many), case.room, case.measured_at(FITTED)
    )
    row: dict[str, Any] = {
        "index": index,
        "prior": prior,
        "volume": round(case.room.volume),
        "error of T20 alone": error(case.room, alone.alpha, truth),
        "gap of T20 alone": mean_gap(judge, half.alpha, held_out),
        "least error": least_error(_POPULATION, index, prior),
    }
    for told in TOLD:
        tracer, options = told_of(case, index, told)
        result = rt.calibrate_simulator(tracer, case.room, case.measured, match=MATCH, **options)
        row[f"error, told {told}"] = error(case.room, result.alpha, truth)
        if told not in WITH_GAP:
            continue
        fitted = case.measured_at(FITTED)
        half_of_it: Any = rt.calibrate_simulator(tracer, case.room, fitted, match=MATCH, **options)
        known = knowing(judge, _POPULATION, index)
        tracer = calibrated(judge, half_of_it) if told == "nothing" else known
        row[f"gap, told {told}"] = mean_gap(tracer, half_of_it.alpha, held_out)
    return row


def run(folder: Path) -> None:
    """Append the rows that are missing."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "parts.jsonl"
    done = {(r["index"], r["prior"]) for r in read(target)}
    for prior in PRIORS:
        for index in order(_POPULATION):
            if (index, prior) not in done:
                with KeptTraces():
                    row = rounded(judged(index, prior))
                with target.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
                print(row, flush=True)


def table(rows: list[dict[str, Any]]) -> None:
    """Print errors and gaps over those of T20 alone, by room and their medians."""
    for prior in PRIORS:
        of_prior = [r for r in rows if r["prior"] == prior]
        if not of_prior:
            continue
        print(f"\n{prior} prior: error of alpha / T20 alone, and gap / T20 alone")
        names = ("a simulator without error", *(f"told {t}" for t in TOLD))
        print("m³", *names, *(f"gap, told {t}" for t in WITH_GAP), sep=" | ")
        ratios = []
        for r in of_prior:
            errors = np.array([r["least error"], *(r[f"error, told {t}"] for t in TOLD)])
            gaps = np.array([r[f"gap, told {t}"] for t in WITH_GAP])
            ratios.append([*errors / r["error of T20 alone"], *gaps / r["gap of T20 alone"]])
            print(r["volume"], *(f"{x:.2f}" for x in ratios[-1]), sep=" | ")
        print("median", *(f"{x:.2f}" for x in np.median(ratios, axis=0)), sep=" | ")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=["run", "table"])
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "run":
        run(arguments.folder or Path("positions_parts"))
    else:
        table(read(arguments.folder / "parts.jsonl" if arguments.folder else STORED))


if __name__ == "__main__":
    main()
