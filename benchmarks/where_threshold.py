"""The score that `rtcal.where.find` gives rooms that are as stated, and its thresholds.

    python -m benchmarks.where_threshold --cache out --measured --populations 0 2 --rooms 0-39 0-17
    python -m benchmarks.where_threshold --cache out --statement "in situ" --rooms 0-11

`--measured` scores what was measured in development rooms (populations 0 and 2 of
tests/geometric_world), by positions and by means over them. From the rooms with nothing hidden come the
thresholds of `rtcal.where.detection`, and from all of them what decides.

Else control rooms of the development rooms are drawn: their simulator's error is that of control runs
that the covariance has not seen, what catalogues err by in common has heavy tails (Student's t), and
their measurement errs as assumed. `TEMPER` is the mean square of a hypothesis' standardised projection.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.where import case_of, prepared
from benchmarks.where_figures import DATA
from rtcal.where.detection import MEANS, POSITIONS, evidence_of_means
from rtcal.where.model import Model
from rtcal.where.search import TEMPER, Hypotheses, evaluate, weights
from tests.geometric_world.load import HANDBOOK, IN_SITU, load, truth
from tests.geometric_world.rooms import NOTHING

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
    index: int, statement: str, data: str, cache: Path, draw: bool = True, population: int = 0
) -> dict[str, Any]:
    """Return the scores of a development room and of its control rooms.

    ``likelier`` is by how many nats the error common to all pairs makes what was measured likelier as
    it is assumed than with all of its variance.
    """
    case = case_of(load(population, index, statement), data)
    numbers, hypotheses = prepared(case, cache)
    drawn_scores, square = scores(numbers, hypotheses, index) if draw else (np.zeros(0), np.nan)
    evidence = evaluate(numbers.likelihoods(), hypotheses, numbers.residual[:, np.newaxis])
    means = None if draw else evidence_of_means(case, cache=cache)
    whole = replace(numbers, error=replace(numbers.error, common=1.0))
    return {
        "population": population,
        "index": index,
        "statement": statement,
        "data": data,
        "kind": truth(population, index)["kind"],
        "square": square,
        "likelier": log_density(numbers) - log_density(whole),
        "positions": float(weights(evidence, hypotheses).score[0]),
        "means": None if means is None else means.score,
        "control_scores": drawn_scores.round(2).tolist(),
    }


def said(rows: list[dict[str, Any]]) -> None:
    """Print which scores rooms with nothing hidden exceed, and how many others exceed them."""
    asked = [r for r in rows if r["means"] is not None]
    every = {
        "positions": np.array([r["positions"] for r in asked]),
        "means": np.array([r["means"] for r in asked]),
        **{
            f"means + {share} positions": np.array(
                [r["means"] + share * r["positions"] for r in asked]
            )
            for share in (0.1, 0.25, 0.5, 1.0)
        },
    }
    empty = np.array([r["kind"] == NOTHING for r in asked])
    print(f"{empty.sum()} with nothing hidden, {(~empty).sum()} with something, both kinds of data")
    for name, scores in every.items():
        limit = float(np.quantile(scores[empty], 1 - FALSE_ALARMS))
        tenth = float(np.quantile(scores[empty], 0.9))
        print(
            f"{name}: 5 % exceed {limit:.1f}, {(scores[~empty] > limit).mean():.2f} of the others;",
            end=" ",
        )
        print(f"10 % exceed {tenth:.1f}, {(scores[~empty] > tenth).mean():.2f}")
    for name, limit in (("positions", POSITIONS), ("means", MEANS)):
        over = every[name] > limit
        print(f"{name} over {limit}: {over[empty].mean():.3f} and {over[~empty].mean():.3f}")


def numbers_of(words: str) -> list[int]:
    """Return the numbers of "0-3,7"."""
    ends = [[int(n) for n in word.split("-")] for word in words.split(",")]
    return [n for first, *last in ends for n in range(first, (last or [first])[0] + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--statement", choices=(HANDBOOK, IN_SITU), default=IN_SITU)
    parser.add_argument("--rooms", nargs="+", default=["0-11"], help="numbers, by population")
    parser.add_argument("--populations", type=int, nargs="+", default=[0])
    parser.add_argument("--measured", action="store_true", help="score what was measured alone")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.cache.mkdir(parents=True, exist_ok=True)
    every, rows = [], []
    for population, numbers in zip(given.populations, given.rooms, strict=True):
        for index in numbers_of(numbers):
            for data in DATA:
                row = of_room(
                    index, given.statement, data, given.cache, not given.measured, population
                )
                every += row.pop("control_scores")
                rows.append(row)
                print(json.dumps(row), flush=True)
    if given.measured:
        said(rows)
        return
    print(f"{len(every)} control rooms:", end=" ")
    print(f"{FALSE_ALARMS:.0%} exceed {np.quantile(every, 1 - FALSE_ALARMS):.2f} nats;", end=" ")
    print(f"mean square of projections {np.mean([r['square'] for r in rows]):.2f}", end="")
    print(f", divided by {TEMPER}")


if __name__ == "__main__":
    main()
