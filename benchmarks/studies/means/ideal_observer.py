"""The effects that an observer could name with the finder's beliefs, of rooms drawn from that belief.

    # two effects, or one
    python -m benchmarks.studies.means.ideal_observer --folder out --population 0 --rooms 24
    python -m benchmarks.studies.means.ideal_observer --folder out --chain  # one, or none

The second takes the rooms that `benchmarks.studies.means.chain run` left in this folder. Each has
the effect that is hidden in it, or any where it is not of the library, with a size from the prior.

Two effects, or one, and their parameters are drawn from the finder's prior, and the features from its
likelihood, in rooms whose control rooms stand. So prior and likelihood are exactly right, and no other
rule names more sets rightly (Bayes). What is named less in the hidden world is what the model errs by.
Neither what was measured in these rooms nor what is hidden in them is used.
"""

from __future__ import annotations

import argparse
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.studies.means.chain import data_sets, made, steps, table
from benchmarks.studies.means.chain import rooms as chain_rooms
from benchmarks.studies.means.judging import NOTHING, row_of
from benchmarks.studies.means.second_world import truth_of
from benchmarks.studies.means.several_effects import LEVEL
from benchmarks.studies.means.several_effects_rooms import rooms
from rtcal.finder import Case, library
from rtcal.finder.claim import by_family_sets, families_of, numbers_of
from rtcal.finder.means import search
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import (
    MeansProblem,
    Members,
    ObservedFeatures,
    acting_order,
    compare,
    estimate_discrepancy,
    moments,
    observe,
    posterior_of_sets,
    predict_hypotheses,
)
from rtcal.finder.means.verdict import TWO
from rtcal.finder.prior import UNKNOWN, Prior, prior_of
from rtcal.support.errors import DataError


def drawn(compared: MeansProblem, prior: Prior, number: int, rng: np.random.Generator) -> Members:
    """So many effects with their parameters, from the prior."""
    predicted = compared.predicted
    order, apart = acting_order(compared.case, predicted)
    odds = np.exp([prior.log_probability[n] for n in order])
    while True:
        kinds = np.sort(rng.choice(len(order), number, replace=False, p=odds / odds.sum()))
        if len({order[k] for k in kinds} & apart) < 2:
            break
    out = []
    for k in kinds:
        rows = predicted.rows[order[k]]
        weights = np.exp(predicted.log_weights[rows])
        out.append(int(rows[rng.choice(len(rows), p=weights / weights.sum())]))
    return tuple(out)


def measured(compared: MeansProblem, rows: Members, rng: np.random.Generator) -> MeansProblem:
    """The problem with features that are drawn from the likelihood of a set."""
    of, _ = moments(compared, [rows])
    factor = np.linalg.cholesky(of.covariance[0])
    features = compared.observed.features.copy()
    features[compared.observed.used] = of.mean[0] + factor @ rng.standard_normal(len(factor))
    return replace(compared, observed=replace(compared.observed, features=features))


def believed(case: Case, controls: list[ControlRooms]) -> tuple[MeansProblem, Prior]:
    """The finder's likelihood and prior in a room."""
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, library())
    problem = MeansProblem(case, observed, predicted, estimate_discrepancy(case, controls))
    return compare(problem), prior_of(case.room, library(), {})


def examined(
    case: Case, controls: list[ControlRooms], number: int, rng: np.random.Generator
) -> tuple[float, bool, bool]:
    """Return what an observer says of a room that is drawn with so many effects.

    The log odds of two or more effects; whether the most probable families of two are right; and
    whether a search for sets would claim them.
    """
    compared, prior = believed(case, controls)
    rows = drawn(compared, prior, number, rng)
    posterior = posterior_of_sets(measured(compared, rows, rng), prior, most=2)
    truth = families_of(
        tuple(compared.predicted.names[i] for i in rows), compared.predicted.effects
    )
    sets = by_family_sets(posterior.sets, compared.predicted.effects)
    likeliest = next(s for s in sets if len(s) == 2 and UNKNOWN not in s)
    numbers = numbers_of(posterior.sets)
    less, more = sum(numbers[:2]), sum(numbers[2:])
    claimed = more >= TWO
    return float(np.log(more / less)), likeliest == truth, claimed


def one_effect(
    compared: MeansProblem, prior: Prior, hidden: str, rng: np.random.Generator
) -> Members:
    """A hidden effect with its parameters, or any effect of the library, from the prior."""
    if hidden not in compared.predicted.rows:
        return drawn(compared, prior, 1, rng)
    rows = compared.predicted.rows[hidden]
    weights = np.exp(compared.predicted.log_weights[rows])
    return (int(rng.choice(rows, p=weights / weights.sum())),)


def found(
    case: Case, controls: list[ControlRooms], hidden: str, rng: np.random.Generator
) -> dict[str, Any]:
    """Return what the finder says of each data set of a room that has this effect, as a row."""
    compared, prior = believed(case, controls)
    rows = () if hidden == NOTHING else one_effect(compared, prior, hidden, rng)
    table = measured(compared, rows, rng).observed.features

    def as_drawn(some: Case) -> tuple[ObservedFeatures, list[str]]:
        of, notes = observe(some)
        features = np.where(of.used, table[: len(of.features)], np.nan)
        return replace(of, features=features), notes

    row: dict[str, Any] = {"truth": [compared.predicted.names[rows[0]] if rows else NOTHING]}
    with mock.patch.object(search, "observe", as_drawn):
        for data, some, theirs in data_sets(case, controls):
            row[data] = row_of(search.find(some, controls=theirs))
    return row


def chain(folder: Path, seed: int) -> None:
    """Print `benchmarks.studies.means.chain table` of the rooms as an observer finds them."""
    rows = {}
    for number, room in enumerate((*chain_rooms(50, 3, (1, 2)), *chain_rooms(24, 5, (3,)))):
        truth, case, controls = made(folder, room)
        known, rng = truth_of(room[0], truth), np.random.default_rng([seed, number])
        if known is None:
            continue
        (hidden, *_) = known[0]
        with suppress(DataError):  # no band can be trusted
            row = found(case, controls, hidden, rng)
            rows["_".join(map(str, room))] = {**row, "statement": known[1]}
    table(rows, "ideal observer")
    steps(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--rooms", type=int, default=24)
    parser.add_argument("--chain", action="store_true")
    parser.add_argument("--seed", type=int, default=0, help="of a chain")
    parser.add_argument("--part", default="0/1", help="1/3: the second of three parts of the rooms")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.chain:
        chain(Path(given.folder), given.seed)
        return
    first, parts = (int(x) for x in given.part.split("/"))
    every = list(rooms(given.folder, given.population, given.rooms, double=True))[: given.rooms]
    pairs, singles = [], []
    for index, case, _, controls in every[first::parts]:
        rng = np.random.default_rng(index)
        pairs.append(examined(case, controls, 2, rng))
        singles.append(examined(case, controls, 1, rng))
        told = sum(right for _, right, _ in pairs)
        named = sum(right and claimed for _, right, claimed in pairs)
        wrong = sum(claimed for _, _, claimed in singles)
        # The log odds that one of 20 rooms with one effect passes.
        limit = float(np.quantile([odds for odds, _, _ in singles], 1 - LEVEL, method="higher"))
        possible = sum(right and odds > limit for odds, right, _ in pairs)
        print(
            f"{len(pairs)} rooms. Two effects, families right: {told} told that there are two, {named} "
            f"claimed, {possible} if {LEVEL:g} of rooms with one effect may get a second. "
            f"One effect: two claimed in {wrong}",
            flush=True,
        )


if __name__ == "__main__":
    main()
