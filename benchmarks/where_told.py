"""The gap at held-out pairs if what is hidden is told: the bound of what a correction can give.

    python -m benchmarks.where_told --folder out --statement "in situ" --number 20

The rooms are those of `benchmarks.where gaps`, with G. The corrected model has a patch with the true
area and alpha in the middle of the true surface, and is calibrated on half of the pairs. So is the
plain one. Rows are written to the folder; the last lines are their medians.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.where import HANDBOOK, STATEMENTS, Judging, case_of, plain, read
from benchmarks.where_figures import ABSORBERS, LARGE
from rtcal.finder.positions.candidate import Candidate
from rtcal.finder.positions.corrected import corrected
from rtcal.finder.positions.responses import precisely
from rtcal.finder.positions.verification import gap_in_jnd, halves_of, heard_calibrated
from tests.geometric_world.load import stored, truth


def told(judging: Judging, index: int) -> dict[str, Any]:
    """Return the mean gaps at held-out pairs in JND, plain and corrected by the truth."""
    case, true = case_of(judging.load(index), "level"), truth(judging.population, index)
    finding = rt.finder.positions.find(case, cache=judging.folder / "controls")
    surface = next(name for name, faces in case.faces.items() if true["surface"] in faces)
    hidden = Candidate(
        effect=true["kind"],
        family="",
        surface=surface,
        place=surface,
        probability=1.0,
        size=min(true["size"], case.areas[surface]),
        low=true["size"],
        high=true["size"],
        unit="m²",
        parameters={},
        spectrum=np.array(true["alpha_of_it"]),
    )
    gaps: dict[str, list[float]] = {"plain": [], "corrected": []}
    for half in halves_of(finding.pairs):
        fitted = case.only(half)
        left = [pair for pair in finding.pairs if pair not in half]
        models = {"plain": case.simulator, "corrected": corrected(fitted, hidden).simulator}
        for name, simulator in models.items():
            heard = heard_calibrated(fitted, precisely(simulator), finding, 0)
            gaps[name].append(float(np.nanmean(np.abs(gap_in_jnd(case, finding, heard, left)))))
    mean = {name: float(np.mean(values)) for name, values in gaps.items()}
    return {"index": index, "ratio": mean["corrected"] / mean["plain"], **mean}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--statement", choices=STATEMENTS, default=HANDBOOK)
    parser.add_argument("--number", type=int, default=250)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    judging = Judging(given.population, given.statement, given.folder)
    file = judging.file("told")
    done = {row["index"] for row in read(file)}
    for index in sorted(stored(given.population, "truth"))[: given.number]:
        true = truth(given.population, index)
        if true["kind"] not in ABSORBERS or true["effect_on_t"] <= LARGE or index in done:
            continue
        row = plain(told(judging, index))
        with file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
        print(row, flush=True)
    ratios = [row["ratio"] for row in read(file)]
    if ratios:
        print(f"{len(ratios)} rooms: corrected / plain {np.median(ratios):.2f}", end=", ")
        print(f"smaller in {np.mean(np.array(ratios) < 1):.0%}")


if __name__ == "__main__":
    main()
