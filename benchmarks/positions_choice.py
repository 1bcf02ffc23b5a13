"""What chose the calibration to every position: the wide prior in rooms that are not judged.

    python -m benchmarks.positions_choice run --variant "this version" --folder out  # resumes
    python -m benchmarks.positions_choice table                                      # what is stored

A variant has other numbers in `rtcal.loop.scattering`. The version before is stored alone.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.positions import (
    FITTED,
    HELD_OUT,
    JUDGING_PATHS,
    MORE_PATHS,
    PATHS,
    KeptTraces,
    calibrate,
    calibrated,
    error,
    mean_gap,
    rounded,
)
from benchmarks.positions_table import read
from rtcal.loop import scattering
from tests.position_rooms.generate import HERE
from tests.position_rooms.load import at, load, true_alpha, without_noise

STORED = HERE / "choice.jsonl"
ROOMS = (*((0, i) for i in range(10)), (1, 14), (1, 15), (1, 18))
"""Population and number: all of development, and three in which the version before had large gaps."""
VARIANTS: dict[str, dict[str, float]] = {
    "all of the common error": {"COMMON_LEFT": 1.0},
    "0.4 of the common error": {"COMMON_LEFT": 0.4},
    "this version": {},
}


def judged(population: int, index: int) -> dict[str, Any]:
    """Return errors of alpha and gaps at held-out pairs in a room, of every position and T20 alone."""
    case, truth = load(population, index, "wide"), true_alpha(population, index, "wide")
    held_out = at(without_noise(population, index, "wide"), HELD_OUT)
    judge = case.simulator(HELD_OUT, n_paths=JUDGING_PATHS)
    row: dict[str, Any] = {"population": population, "index": index}
    for method in ("t20", "positions"):
        n_paths = PATHS if method == "positions" else MORE_PATHS * PATHS
        every = case.simulator(n_paths=n_paths)
        some = every if method == "positions" else case.simulator(FITTED, n_paths=n_paths)
        full = calibrate(method, every, case.room, case.measured)
        controls = getattr(full, "controls", None)
        half = calibrate(method, some, case.room, case.measured_at(FITTED), controls)
        tracer = calibrated(judge, half) if method == "positions" else judge
        row[f"error, {method}"] = error(case.room, full.alpha, truth)
        row[f"gap, {method}"] = mean_gap(tracer, half.alpha, held_out)
    return row


def run(variant: str, folder: Path) -> None:
    """Append the rooms of a variant that are missing."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "choice.jsonl"
    done = {(r["variant"], r["population"], r["index"]) for r in read(target)}
    for name, number in VARIANTS[variant].items():
        setattr(scattering, name, number)
    for population, index in ROOMS:
        if (variant, population, index) not in done:
            with KeptTraces():
                row = {"variant": variant, **rounded(judged(population, index))}
            with target.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(row, flush=True)


def table(rows: list[dict[str, Any]]) -> None:
    """Print the median error and the gap, every position over T20 alone, by variant."""
    print("variant | rooms | error, median | gap, ratio of sums | gap, median")
    for variant in dict.fromkeys(r["variant"] for r in rows):
        chosen = [r for r in rows if r["variant"] == variant]

        def of(name: str, chosen: list[dict[str, Any]] = chosen) -> np.ndarray:
            return np.array([r[name] for r in chosen])

        errors = of("error, positions") / of("error, t20")
        gaps, base = of("gap, positions"), of("gap, t20")
        print(
            variant,
            len(chosen),
            f"{np.median(errors):.2f}",
            f"{gaps.sum() / base.sum():.2f}",
            f"{np.median(gaps / base):.2f}",
            sep=" | ",
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=["run", "table"])
    parser.add_argument("--variant", choices=list(VARIANTS), default="this version")
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "run":
        run(arguments.variant, arguments.folder or Path("positions_choice"))
    else:
        table(read(arguments.folder / "choice.jsonl" if arguments.folder else STORED))


if __name__ == "__main__":
    main()
