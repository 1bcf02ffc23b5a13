"""The verdicts that an observer could reach with the finder's beliefs, of data drawn from that belief.

    # development rooms, in situ
    python -m benchmarks.studies.pairs.where_ideal run --cache out --out rows.json.gz
    python -m benchmarks.studies.pairs.where_ideal table  # of the stored run

In each room absorbers, apertures and misplaced receivers are drawn from the prior, with their sizes
and places, and what is measured from the likelihood. So prior and likelihood are exactly right, and no
rule says more (Bayes). The same observer then judges the same draws by their means over positions.
Rooms as stated are drawn beside them: their scores set the threshold, which one in twenty exceeds.
What was measured in these rooms sets the scales of the errors alone, and what is hidden is not used.
"""

from __future__ import annotations

import argparse
import gzip
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

from benchmarks.studies.fits.positions_table import bootstrap
from benchmarks.studies.geometric_world.load import IN_SITU, load
from benchmarks.studies.pairs.where import case_of, prepared
from benchmarks.studies.pairs.where_figures import ABSORBERS, DATA
from rtcal.finder.claim import LIKELY
from rtcal.finder.evidence import NONE, UNKNOWN
from rtcal.finder.positions.problem import (
    COUPLED,
    POSITION,
    Likelihood,
    PositionsHypotheses,
    PositionsProblem,
    ShiftHypothesis,
    SpreadHypothesis,
    uneven_amount,
)
from rtcal.finder.positions.search import evaluate, scores, weights
from rtcal.support.types import Array

STORED = Path(__file__).with_name("where_ideal.json.gz")
DRAWS = 12
"""Rooms of each kind, with and without something hidden, that are drawn in one geometry."""
FALSE_ALARMS = 0.05
HIDDEN = (*ABSORBERS, COUPLED.name, POSITION)
"""Effects that are drawn: those that benchmarks/studies/geometric_world hides."""
Likelihoods = tuple[Likelihood, list[Likelihood], list[Likelihood]]
Row = dict[str, Any]


def log_sums(labels: Sequence[str], log: Array) -> dict[str, Array]:
    """Return the log of the sum of exponentials of each label's rows of ``log`` (n, ...)."""
    rows: dict[str, list[int]] = {}
    for i, label in enumerate(labels):
        rows.setdefault(label, []).append(i)
    return {label: np.asarray(logsumexp(log[some], axis=0)) for label, some in rows.items()}


def drawn(
    numbers: PositionsProblem,
    likelihood: Likelihood,
    every: PositionsHypotheses,
    rng: np.random.Generator,
) -> tuple[list[ShiftHypothesis | SpreadHypothesis | None], np.ndarray]:
    """Draw `DRAWS` rooms with something hidden and as many as stated, and what is measured in them.

    Returns what is hidden and the residuals (n_values, 2 DRAWS).
    """
    chances: list[tuple[float, ShiftHypothesis | SpreadHypothesis, int]] = [
        (float(odds), shift, row)
        for shift in every.shifts
        if shift.effect in HIDDEN
        for row, odds in enumerate(shift.odds)
    ]
    chances += [
        (float(odds), spread, row)
        for spread in every.spreads
        if spread.effect in HIDDEN
        for row, odds in enumerate(spread.odds)
    ]
    odds = np.array([chance for chance, _, _ in chances])
    kept = np.flatnonzero(numbers.used)
    factor = np.linalg.cholesky(likelihood.covariance[np.ix_(kept, kept)])
    out = np.zeros((len(numbers.used), 2 * DRAWS))
    out[kept] = factor @ rng.standard_normal((len(kept), 2 * DRAWS))
    levels = likelihood.levels
    chosen = rng.choice(len(levels.log_weights), 2 * DRAWS, p=np.exp(levels.log_weights))
    out += levels.shifts[:, chosen]
    hidden: list[ShiftHypothesis | SpreadHypothesis | None] = []
    for column, choice in enumerate(rng.choice(len(odds), DRAWS, p=odds / odds.sum())):
        _, what, row = chances[choice]
        hidden.append(what)
        if isinstance(what, SpreadHypothesis):
            drawn_errors = what.columns @ rng.standard_normal(what.columns.shape[1])
            out[what.rows, column] += what.scales[row] * drawn_errors
        else:
            out[:, column] += shifted(likelihood, what, row, rng)
    return [*hidden, *[None] * DRAWS], out


def shifted(
    likelihood: Likelihood, shift: ShiftHypothesis, row: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw the shift of a hypothesis with the errors of its spectrum and of its place, (n,)."""
    exact = likelihood.changes(shift)[row]
    factor = 1 + rng.multivariate_normal(np.zeros(len(shift.error)), shift.error)
    change = exact @ likelihood.amount * shift.uneven[row]
    place = likelihood.uneven @ rng.standard_normal(likelihood.uneven.shape[1])
    return np.asarray((exact * factor[:, np.newaxis] + np.outer(change, place)).ravel())


def averaged(numbers: PositionsProblem, likelihoods: Likelihoods) -> tuple[np.ndarray, Likelihoods]:
    """Return the matrix of the means over pairs, and the likelihoods of the means."""
    p, i, k = numbers.shape
    names = numbers.data.observations.parameters
    mean = np.kron(np.eye(k * p), np.full((1, i), 1 / i))
    within = np.kron(np.eye(p), np.full((1, i), 1 / i))

    def of(likelihood: Likelihood) -> Likelihood:
        return Likelihood(
            mean @ likelihood.covariance @ mean.T,
            numbers.used.reshape(-1, i).all(axis=1),
            {name: within @ nodes for name, nodes in likelihood.nodes.items()},
            uneven=within @ likelihood.uneven,
            amount=uneven_amount(names, 1),
            levels=likelihood.levels._replace(shifts=mean @ likelihood.levels.shifts),
        )

    stated, off, unknown = likelihoods
    return mean, (of(stated), [of(one) for one in off], [of(one) for one in unknown])


def spread_of_means(spread: SpreadHypothesis, mean: np.ndarray) -> SpreadHypothesis:
    moved = mean[:, spread.rows]
    rows = np.flatnonzero(np.abs(moved).sum(axis=1))
    return replace(spread, rows=rows, columns=moved[rows] @ spread.columns)


def said(
    likelihoods: Likelihoods,
    every: PositionsHypotheses,
    residuals: np.ndarray,
    hidden: Sequence[ShiftHypothesis | SpreadHypothesis | None],
    n_surfaces: int,
) -> list[Row]:
    """Return what the observer says of each draw."""
    drawn = [weights(evaluate(likelihoods, every, r), every, temper=1.0) for r in residuals.T]
    score, posterior = [scores(each, every)[0] for each in drawn], np.transpose(drawn)
    by_surface = log_sums(every.by_row("surface"), posterior)
    families = log_sums(every.by_row("family"), posterior)
    nowhere = np.full(residuals.shape[1], -np.inf)
    surfaces = np.array([by_surface.get(j, nowhere) for j in range(n_surfaces)])
    names = [name for name in families if name not in (NONE, UNKNOWN)]
    by_family = np.array([families[name] for name in names])
    chance = np.exp(surfaces - logsumexp(surfaces, axis=0))
    out = []
    for column, what in enumerate(hidden):
        row: Row = {"score": round(float(score[column]), 2)}
        if what is not None:
            best = names[int(by_family[:, column].argmax())]
            row |= {"effect": what.effect, "family": best == what.family}
        if isinstance(what, ShiftHypothesis) and what.effect in ABSORBERS:
            order = np.argsort(-chance[:, column])
            held = np.cumsum(chance[order, column])
            row["rank"] = int(np.flatnonzero(order == what.surface)[0])
            row["candidates"] = int(np.searchsorted(held, LIKELY)) + 1
        out.append(row)
    return out


def of_room(index: int, data: str, cache: Path) -> list[Row]:
    """Return what positions and means say of the rooms that are drawn in a room's geometry."""
    case = case_of(load(0, index, IN_SITU), data)
    numbers, every = prepared(case, cache)
    likelihoods = numbers.likelihoods()
    hidden, residuals = drawn(numbers, likelihoods[0], every, np.random.default_rng([index, 22]))
    mean, of_means = averaged(numbers, likelihoods)
    fewer = replace(every, spreads=[spread_of_means(s, mean) for s in every.spreads])
    n = len(case.faces)
    return [
        {"room": index, "data": data, "positions": positions, "means": means}
        for positions, means in zip(
            said(likelihoods, every, residuals, hidden, n),
            said(of_means, fewer, mean @ residuals, hidden, n),
            strict=True,
        )
    ]


Line = tuple[float, float, float, int]


def over_rooms(rows: Sequence[Row], value: Callable[[Row], float]) -> Line:
    """Return a mean with its 95 % interval over rooms, and the number of rows."""
    rooms = sorted({row["room"] for row in rows})
    groups = [[value(row) for row in rows if row["room"] == room] for room in rooms]
    total, number = np.array([[sum(g), len(g)] for g in groups]).T
    line = bootstrap(lambda i: float(total[i].sum() / number[i].sum()), len(rooms))
    return (*line, len(rows))


def figures(hidden: Sequence[Row], by: str, limit: float) -> dict[str, Line]:
    """Return the figures of positions or means, ``by``, above a threshold."""
    caught = [row for row in hidden if row[by]["score"] > limit]
    placed = [row for row in caught if "rank" in row[by]]
    return {
        f"{by}: detected": over_rooms(hidden, lambda r: r[by]["score"] > limit),
        f"{by}: right family, of the detected": over_rooms(caught, lambda r: r[by]["family"]),
        f"{by}: right surface first, of absorbers detected": over_rooms(
            placed, lambda r: r[by]["rank"] == 0
        ),
        f"{by}: right surface among the two most probable": over_rooms(
            placed, lambda r: r[by]["rank"] < 2
        ),
        f"{by}: right surface among the candidates": over_rooms(
            placed, lambda r: r[by]["rank"] < r[by]["candidates"]
        ),
        f"{by}: candidates, mean": over_rooms(placed, lambda r: r[by]["candidates"]),
    }


def lines(rows: Sequence[Row], data: str) -> dict[str, Line]:
    """Return the figures of one kind of data by name."""
    rows = [row for row in rows if row["data"] == data]
    hidden = [row for row in rows if "effect" in row["means"]]
    limits = {
        by: float(np.quantile([r[by]["score"] for r in rows if r not in hidden], 1 - FALSE_ALARMS))
        for by in ("positions", "means")
    }

    def above(row: Row, by: str) -> bool:
        return bool(row[by]["score"] > limits[by])

    placed = [row for row in hidden if above(row, "means") and "rank" in row["means"]]
    return {
        **figures(hidden, "positions", limits["positions"]),
        **figures(hidden, "means", limits["means"]),
        "detected by means, placed by positions: right surface first": over_rooms(
            placed, lambda r: r["positions"]["rank"] == 0
        ),
        "detected by positions more than by means": over_rooms(
            hidden, lambda r: float(above(r, "positions")) - float(above(r, "means"))
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("run", "table"))
    parser.add_argument("--cache", type=Path, help="folder of control runs and weighings")
    parser.add_argument("--out", type=Path, default=STORED, help="file of the rows")
    parser.add_argument("--rooms", type=int, default=40)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "run":
        rows: list[Row] = []
        for index in range(given.rooms):
            for data in DATA:
                rows += of_room(index, data, given.cache)
            content = json.dumps(rows, separators=(",", ":")).encode()
            given.out.write_bytes(gzip.compress(content, mtime=0))
            print(index, flush=True)
        return
    rows = json.loads(gzip.decompress(given.out.read_bytes()))
    for data, words in DATA.items():
        print(f"{words}: {len({row['room'] for row in rows})} rooms")
        for name, (value, low, high, n) in lines(rows, data).items():
            print(f"  {name:56} {value:.2f} [{low:.2f}, {high:.2f}] of {n}")


if __name__ == "__main__":
    main()
