"""The score that `rtcal.where.find` gives rooms that are as stated, and its threshold.

    python -m benchmarks.where_threshold --cache out --statement "in situ" --number 12
    python -m benchmarks.where_threshold --cache out --rooms 2,4,6 --measured     # no control rooms

Control rooms of the development rooms (population 0 of tests/geometric_world) are drawn: their
simulator's error is that of control runs that the covariance has not seen, what catalogues err by in
common has heavy tails (Student's t), and their measurement errs as assumed. `THRESHOLDS` are the
quantiles over all rooms and both kinds of data, `TEMPER` the mean square of a hypothesis' standardised
projection.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.where import case_of
from benchmarks.where_figures import DATA
from rtcal.loop.control_runs import control_runs
from rtcal.where.find import every_hypothesis
from rtcal.where.model import Model, model
from rtcal.where.prior import statement as statement_of
from rtcal.where.responses import parameters, responses
from rtcal.where.search import FALSE_ALARMS, TEMPER, THRESHOLDS, Hypotheses, evaluate, weights
from tests.geometric_world.load import HANDBOOK, IN_SITU, load, truth

FOLDS, DRAWS = 4, 25
"""Groups of control runs that are left out in turn, and rooms that are drawn from each."""
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


def drawn(numbers: Model, fold: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw residuals of rooms that are as stated, (n_values, DRAWS), with the errors of some runs."""
    kept = np.flatnonzero(numbers.used)
    covariance = numbers.measurement[np.ix_(kept, kept)] + 1e-12 * np.eye(len(kept))
    unknowns = rng.standard_normal((numbers.alpha.shape[1], DRAWS))
    common = slice(len(unknowns) - numbers.together.shape[1], None)
    unknowns[common] = rng.standard_t(TAILS, unknowns[common].shape)
    out = numbers.alpha @ unknowns
    out[kept] += np.linalg.cholesky(covariance) @ rng.standard_normal((len(kept), DRAWS))
    chosen = fold[np.arange(DRAWS) % len(fold)]
    return np.asarray(out + numbers.errors[chosen].T)


def scores(numbers: Model, hypotheses: Hypotheses, seed: int) -> tuple[np.ndarray, float]:
    """Return the scores of control rooms, (FOLDS DRAWS,), and the mean square of the projections."""
    rng = np.random.default_rng([seed, 22])
    every, squares = [], []
    for fold in folds(len(numbers.errors)):
        likelihoods = numbers.likelihoods(fold)
        residuals = drawn(numbers, fold, rng)
        every.append(weights(evaluate(likelihoods, hypotheses, residuals), hypotheses).score)
        observed = likelihoods[0].of(residuals)
        squares += [
            np.mean(likelihoods[0].standardised(shift, observed) ** 2)
            for shift in hypotheses.shifts
            if shift.surface is not None
        ]
    return np.concatenate(every), float(np.mean(squares))


def log_density(numbers: Model) -> float:
    """Return the log density of what was measured if nothing is other than stated."""
    stated = numbers.likelihoods()[0]
    return float(stated.stated(stated.of(numbers.residual[:, np.newaxis]))[0])


def of_room(
    index: int, statement: str, data: str, cache: Path, draw: bool = True
) -> dict[str, Any]:
    """Return the scores of a development room and of its control rooms.

    ``likelier`` is by how many nats the error common to all pairs makes what was measured likelier as
    it is assumed than with all of its variance.
    """
    case = case_of(load(0, index, statement), data)
    controls: Any = control_runs(
        case.simulator,
        case.room,
        parameters(case),
        position_uncertainty=case.position_uncertainty,
        cache=cache,
    )
    made = responses(case, 0, cache)
    numbers = model(case, made, controls)
    hypotheses = every_hypothesis(case, made, numbers)
    drawn_scores, square = scores(numbers, hypotheses, index) if draw else (np.zeros(0), np.nan)
    evidence = evaluate(numbers.likelihoods(), hypotheses, numbers.residual[:, np.newaxis])
    whole = replace(numbers, error=replace(numbers.error, common=1.0))
    return {
        "index": index,
        "statement": statement,
        "data": data,
        "kind": truth(0, index)["kind"],
        "square": square,
        "likelier": log_density(numbers) - log_density(whole),
        "score": float(weights(evidence, hypotheses).score[0]),
        "control_scores": drawn_scores.round(2).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--statement", choices=(HANDBOOK, IN_SITU), default=IN_SITU)
    parser.add_argument("--rooms", default="", help="numbers of development rooms; else the first")
    parser.add_argument("--number", type=int, default=12)
    parser.add_argument("--measured", action="store_true", help="score what was measured alone")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    rooms = [int(i) for i in given.rooms.split(",") if i] or list(range(given.number))
    given.cache.mkdir(parents=True, exist_ok=True)
    every, squares = [], []
    for index in rooms:
        for data in DATA:
            row = of_room(index, given.statement, data, given.cache, not given.measured)
            every += row["control_scores"]
            squares.append(row["square"])
            print(json.dumps({k: v for k, v in row.items() if k != "control_scores"}), flush=True)
    if given.measured:
        return
    print(
        f"{len(every)} control rooms: {np.quantile(every, 1 - FALSE_ALARMS):.2f} nats are exceeded by"
    )
    limit = THRESHOLDS[statement_of(load(0, rooms[0], given.statement).room)]
    print(f"{FALSE_ALARMS:.0%}, {limit} by {np.mean(np.array(every) > limit):.1%};", end=" ")
    print(f"mean square of projections {np.mean(squares):.2f}, divided by {TEMPER}")


if __name__ == "__main__":
    main()
