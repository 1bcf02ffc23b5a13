"""Are the stated probabilities right? What the likelihood's power and tails do to them, and their own.

    python -m benchmarks.studies.means.calibrated likelihood --folder out --step 4
    python -m benchmarks.studies.means.calibrated probabilities --folder out

``folder`` has the control rooms that `benchmarks.studies.means.second_world controls` keeps. Both
worlds' development rooms (population 0) are evaluated with settings of the likelihood (`COARSENING`
and `DEGREES`), or of the probabilities: their power where sigma is small (`prior.SHARPER`),
everywhere, and without the effects that the world never hides. A good setting has a small
calibration error and a large mean log probability of the truth (a proper score: Good 1952).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from unittest import mock

import numpy as np

from benchmarks.studies.means.judging import calibration_error, first_of, kept_controls, one
from benchmarks.studies.means.second_world import WORLDS, place, truth_of
from rtcal.finder import Case, library
from rtcal.finder import evidence as densities
from rtcal.finder.claim import posterior
from rtcal.finder.means.problem import (
    MeansProblem,
    estimate_discrepancy,
    evaluate,
    observe,
    predict_hypotheses,
)
from rtcal.finder.prior import Prior, prior_of, relative_sigma
from rtcal.support.speed import single_threaded_blas

CHOSEN = (densities.DEGREES, densities.COARSENING)
SETTINGS = (
    *((degrees, 50.0) for degrees in (3.0, 10.0, np.inf)),
    *((5.0, power) for power in (np.inf, 200.0, 100.0, 25.0, 50.0)),
)
SHARPER = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
ALIKE = 1.2
"""A power of the probabilities whatever sigma is."""
ABSENT = {
    1: ("curtain", "membrane", "covered surface", "direct sound", "coefficients"),
    2: ("covered surface", "direct sound"),
}
"""What no room of a world hides."""
LEAST = 1e-9
"""Smallest probability of the truth that is counted."""

Row = tuple[float, bool, float]
Rows = dict[tuple[str, str], list[Row]]


def row_of(evidence: Mapping[str, float], prior: Prior, name: str) -> Row:
    """Probability of the most probable answer, whether it is right, and that of the truth."""
    probabilities = posterior(evidence, prior)
    best = next(iter(probabilities))
    return probabilities[best], best == name, max(probabilities.get(name, 0.0), LEAST)


def powers(sigma: float) -> dict[str, float]:
    """Powers of the probabilities that are tried, ``sigma`` over a handbook's."""
    return {f"sharper {s:g}": 1 + s * (1 - sigma) for s in SHARPER} | {
        f"{ALIKE:g} everywhere": ALIKE
    }


def rows_of(what: str, folder: str, world: int, step: int) -> Rows:
    """Each setting's rows, by data and setting."""
    out: Rows = defaultdict(list)
    rooms, truths = (WORLDS[world].read(0, part) for part in ("case", "truth"))
    for index in range(0, len(rooms), step):
        kept = place(folder, world, 0, "controls", index, "npz")
        known = truth_of(world, truths[index])
        if known is None or not kept.exists():
            continue
        (name,) = known[0]
        whole = Case.from_dict(rooms[index])
        controls = kept_controls(whole, kept)
        for data, case, made in (
            ("one", one(whole), first_of(controls)),
            ("all", whole, controls),
        ):
            observed, _ = observe(case)
            predicted = predict_hypotheses(case, library())
            error = estimate_discrepancy(case, made)
            problem = MeansProblem(case, observed, predicted, error)
            prior = prior_of(case.room, library(), {})
            plain = replace(prior, sharpness=1.0)
            for degrees, power in SETTINGS if what == "likelihood" else [CHOSEN]:
                with mock.patch.multiple(densities, DEGREES=degrees, COARSENING=power):
                    evidence = evaluate(problem, prior.off)
                table = {k: float(v) for k, v in evidence.by_effect().items()}
                out[data, f"degrees {degrees:g}, n {power:g}"].append(row_of(table, plain, name))
            if what == "probabilities":
                for setting, exponent in powers(relative_sigma(case.room)).items():
                    row = row_of(table, replace(prior, sharpness=exponent), name)
                    out[data, setting].append(row)
                there = {k: v for k, v in table.items() if k not in ABSENT[world]}
                out[data, "what the world hides"].append(row_of(there, plain, name))
    return out


@single_threaded_blas()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("likelihood", "probabilities"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    given = parser.parse_args()
    worlds = [rows_of(given.what, given.folder, world, given.step) for world in WORLDS]
    print(
        "calibration error of the most probable answer, right less stated, log probability of truth"
    )
    print(f"{'data':5}{'':24}" + "".join(f"{x:>22}" for x in ("world 1", "world 2", "both")))
    for data, setting in worlds[0]:
        parts = [w[data, setting] for w in worlds]
        cells = ""
        for rows in (*parts, [row for part in parts for row in part]):
            stated, right, truth = zip(*rows, strict=True)
            error, _ = calibration_error(stated, right)
            bias = np.mean(right) - np.mean(stated)
            cells += f"{error:8.3f}{bias:+7.3f}{np.mean(np.log(truth)):7.3f}"
        print(f"{data:5}{setting:24}{cells} of {len(rows)}", flush=True)


if __name__ == "__main__":
    main()
