"""The score that `rtcal.find` gives control rooms: rooms as stated that err as is assumed.

    python -m benchmarks.studies.pairs.where_threshold --cache out --statement "in situ" --rooms 0-11

They are drawn in the development rooms of studies/geometric_world. Their simulator's error is that
of control runs that the covariance has not seen. What catalogues err by in common has heavy tails
(Student's t), and their measurement errs as assumed. `TEMPER` is the mean square of a hypothesis'
standardised projection. `python -m benchmarks.studies.pairs.where_decides` has the scores of what
was measured.
"""

from __future__ import annotations

import argparse
import json
import warnings
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.geometric_world.load import HANDBOOK, IN_SITU, load, truth
from benchmarks.studies.pairs.where import case_of, prepared
from benchmarks.studies.pairs.where_figures import DATA
from rtcal.finder.positions.problem import (
    Likelihood,
    PositionsHypotheses,
    PositionsProblem,
    Residuals,
    ShiftHypothesis,
    flat,
)
from rtcal.finder.positions.search import TEMPER, evaluate, scores, weights

FOLDS, DRAWS = 4, 25
"""Groups of control runs that are left out in turn, and rooms that are drawn from each."""
FALSE_ALARMS = 0.05
"""Share of rooms with nothing hidden that may be flagged."""
TAILS = 4.0
"""Degrees of freedom of Student's t: now and then a table is of another product altogether."""


def folds(n_runs: int) -> list[np.ndarray]:
    """Return the groups of control runs: each has little and much scattering, and both models.

    The runs are ordered by scattering. Were a group the one with least, the covariance of all others
    would be tried on what it was not made for.
    """
    run = np.arange(n_runs)
    group = 2 * (run // 2 % 2) + (run + run // 4) % 2
    return [np.flatnonzero(group == g) for g in range(FOLDS)]


def drawn(numbers: PositionsProblem, fold: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw residuals of rooms that are as stated, (n_values, DRAWS), with the errors of some runs."""
    kept = np.flatnonzero(numbers.used)
    covariance = numbers.measurement[np.ix_(kept, kept)] + 1e-12 * np.eye(len(kept))
    unknowns = rng.standard_normal((numbers.alpha.shape[1], DRAWS))
    common = slice(len(unknowns) - numbers.together.shape[1], None)
    unknowns[common] = rng.standard_t(TAILS, unknowns[common].shape)
    out = numbers.alpha @ unknowns
    out[kept] += np.linalg.cholesky(covariance) @ rng.standard_normal((len(kept), DRAWS))
    chosen = fold[np.arange(DRAWS) % len(fold)]
    errors = np.array([flat(run) for run in numbers.error.assumed.errors[chosen]]) * numbers.scale
    return np.asarray(out + errors.T)


def control_scores(
    numbers: PositionsProblem, hypotheses: PositionsHypotheses, seed: int
) -> tuple[np.ndarray, float]:
    """Return the scores of control rooms, (FOLDS DRAWS,), and the mean square of the projections."""
    rng = np.random.default_rng([seed, 22])
    every, squares = [], []
    runs = numbers.error.runs
    for fold in folds(len(runs.errors)):
        others = replace(runs, errors=np.delete(runs.errors, fold, axis=0))
        unseen = copy(numbers)
        unseen.error = replace(numbers.error, runs=others)
        vars(unseen).pop("simulator_error", None)
        likelihoods = unseen.likelihoods()
        residuals = drawn(numbers, fold, rng)
        posterior = weights(evaluate(likelihoods, hypotheses, residuals), hypotheses)
        every.append(scores(posterior, hypotheses)[0])
        normal = likelihoods[0].with_one_level()
        observed = normal.of(residuals)
        squares += [
            np.mean(standardised(normal, shift, observed) ** 2)
            for shift in hypotheses.shifts
            if shift.surface is not None
        ]
    return np.concatenate(every), float(np.mean(squares))


def standardised(
    likelihood: Likelihood, shift: ShiftHypothesis, residuals: Residuals
) -> np.ndarray:
    """Return d' K⁻¹ r over its standard deviation, (n_hypotheses, n_draws)."""
    changes = likelihood.changes(shift).reshape(len(shift.weights), -1)
    square = np.einsum("hv,hv->h", changes @ likelihood.inverse, changes)
    size = np.sqrt(np.maximum(square, 1e-12))
    return np.asarray(changes @ residuals[0] / size[:, np.newaxis])


def of_room(index: int, statement: str, data: str, cache: Path) -> dict[str, Any]:
    """Return the scores of a development room's control rooms."""
    case = case_of(load(0, index, statement), data)
    drawn_scores, square = control_scores(*prepared(case, cache), index)
    return {
        "index": index,
        "statement": statement,
        "data": data,
        "kind": truth(0, index)["kind"],
        "square": square,
        "control_scores": drawn_scores.round(2).tolist(),
    }


def numbers_of(words: str) -> list[int]:
    """Return the numbers of "0-3,7"."""
    ends = [[int(n) for n in word.split("-")] for word in words.split(",")]
    return [n for first, *last in ends for n in range(first, (last or [first])[0] + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--statement", choices=(HANDBOOK, IN_SITU), default=IN_SITU)
    parser.add_argument("--rooms", default="0-11")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.cache.mkdir(parents=True, exist_ok=True)
    every, rows = [], []
    for index in numbers_of(given.rooms):
        for data in DATA:
            row = of_room(index, given.statement, data, given.cache)
            every += row.pop("control_scores")
            rows.append(row)
            print(json.dumps(row), flush=True)
    print(f"{len(every)} control rooms:", end=" ")
    print(f"{FALSE_ALARMS:.0%} exceed {np.quantile(every, 1 - FALSE_ALARMS):.2f} nats;", end=" ")
    print(f"mean square of projections {np.mean([r['square'] for r in rows]):.2f}", end="")
    print(f", divided by {TEMPER}")


if __name__ == "__main__":
    main()
