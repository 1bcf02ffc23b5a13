"""Probabilities of sets of effects: prior on their number and kinds, times their evidence.

The number of effects is Poisson, cut at a largest number. Given the number, a set has the product of
its effects' odds. Coefficients that are off together stand beside any set, with their own prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial

import numpy as np
from scipy.special import logsumexp

from rtcal.finder.claim import Names, families_of, family_of, most_probable_first
from rtcal.finder.effects import Effect
from rtcal.finder.effects.checks import AppliedEffect
from rtcal.finder.means.evidence import MeansEvidence
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.means.sets import (
    Rows,
    Screen,
    acting_order,
    compare,
    evaluate_sets,
    shapes,
    unknown_beside,
)
from rtcal.finder.prior import COEFFICIENTS, EXPECTED, NONE, UNKNOWN, Prior
from rtcal.support.types import Array

MOST = 3


@dataclass(frozen=True)
class Kept:
    """The parameters of two effects that are evaluated, if these have the probability ``least``.

    The most probable ones of the screen, until they have a ``share`` of the two effects' probability;
    at most so many. The screen estimates the others' share.
    """

    least: float
    share: float
    most: int

    def last(self, log_others: Array) -> int:
        """Return the last row, of ln of the evidence of all over that of the rows up to each."""
        enough = np.flatnonzero(log_others <= -np.log(self.share))
        return min(int(enough[0]) if len(enough) else len(log_others) - 1, self.most - 1)


KEPT = (Kept(0.0, 0.5, 16), Kept(1e-3, 0.99, 96))
"""How many parameters of two effects are evaluated: few of each two, more of those that are probable
among the pairs."""
UNEXPLAINED = 0.05
"""Probability of the residuals under the best pair below which three effects are tried: the usual level
of a test of fit."""
_BESIDE = 60  # single hypotheses that are evaluated with an unknown effect beside them
_PAIRS_OF_THREE = 3  # pairs that a third effect is added to
_LIKELY = 100  # hypotheses with their parameters that a plan goes on from
_KEPT_THIRD = 8  # parameters of the third effect that are evaluated
DISTINCT = 0.1
"""Odds against the best set from which two effects no longer stand for one another."""


@dataclass(frozen=True, eq=False)
class SetPosterior:
    """The posterior of sets of effects.

    ``sets`` maps each set, as names in the order in which they act, to its probability, the most
    probable first; () is "none". ``rows`` maps it to its most probable parameters. ``off`` maps it to
    the probability of coefficients that are off together beside it. ``likely`` are the most probable
    rows with their probabilities, unknown effects left out; they sum to 1.
    """

    sets: Mapping[Names, float]
    off: Mapping[Names, float]
    rows: Mapping[Names, Rows]
    order: Names
    likely: Sequence[tuple[Rows, float]]

    def best(self, effects: Mapping[str, Effect], families: Names = ()) -> Names:
        """Return the most probable set that has an effect and no unknown one, of these families."""
        return next(
            s
            for s in self.sets
            if s and UNKNOWN not in s and (not families or families_of(s, effects) == families)
        )

    def effects(self) -> dict[str, float]:
        """Return the probability of each effect that it is there at all, the most probable first.

        "none" is that of no effect, and coefficients as stated.
        """
        out: dict[str, float] = {}
        for names, p in self.sets.items():
            for name in names:
                out[name] = out.get(name, 0.0) + p
        out[COEFFICIENTS] = sum(p * self.off[names] for names, p in self.sets.items())
        out[NONE] = self.sets[()] * (1 - self.off[()])
        return most_probable_first(out)

    def families(self, effects: Mapping[str, Effect]) -> dict[str, float]:
        """Return the probability of each family that one of it is there, the most probable first."""
        out: dict[str, float] = {}
        for names, p in self.sets.items():
            of = {family_of(name, effects) for name in names}
            of |= {f.split(",")[0] for f in of}
            for family in of:
                out[family] = out.get(family, 0.0) + p
        every = self.effects()
        out |= {name: every[name] for name in (COEFFICIENTS, NONE)}
        return most_probable_first(out)

    def stand_ins(self, best: Names) -> dict[str, tuple[str, ...]]:
        """Return, for each effect of a set, the effects that explain the data as well.

        They take its place in the set with odds of at least `DISTINCT` against it.
        """
        out = {}
        for name in best:
            others = set(best) - {name}
            out[name] = tuple(
                next(iter(set(names) - others))
                for names, p in self.sets.items()
                if len(names) == len(best) and names != best and others < set(names)
                if p >= DISTINCT * self.sets[best]
            )
        return out


def single_posterior(evidence: MeansEvidence, probabilities: Mapping[str, float]) -> SetPosterior:
    """Return what the data say of sets of one, from the ``probabilities`` of a single effect.

    "coefficients" among these is the empty set with coefficients that are off together.
    """
    nothing = probabilities[NONE] + probabilities[COEFFICIENTS]
    sets: dict[Names, float] = {(): nothing}
    off = {(): probabilities[COEFFICIENTS] / nothing if nothing else 0.0, (UNKNOWN,): 0.0}
    rows: dict[Names, Rows] = {(): (), (UNKNOWN,): ()}
    likely: list[tuple[Rows, float]] = [((), nothing)]
    log, predicted = evidence.by_hypothesis(), evidence.problem.predicted
    for name, p in probabilities.items():
        if name in (NONE, COEFFICIENTS):
            continue
        sets[name,] = p
        if name == UNKNOWN:
            continue
        places = evidence.rows[name]
        with np.errstate(divide="ignore"):
            weighted = log[places] + np.log(predicted.weights[places])
        share = p * np.exp(weighted - logsumexp(weighted))
        off[name,] = float(evidence.off_given(name))
        rows[name,] = (int(places[np.argmax(log[places])]),)
        likely += [((int(i),), float(w)) for i, w in zip(places, share, strict=True)]
    likely = sorted(likely, key=lambda one: -one[1])[:_LIKELY]
    total = sum(p for _, p in likely)
    order = tuple(predicted.effects)
    return SetPosterior(
        most_probable_first(sets), off, rows, order, [(r, p / total) for r, p in likely]
    )


def posterior_of_sets(
    compared: MeansProblem,
    prior: Prior,
    *,
    expected: float = EXPECTED,
    most: int = MOST,
) -> SetPosterior:
    """Return the probabilities of sets of up to ``most`` effects.

    Three effects are tried where the best two do not explain the measurement (`UNEXPLAINED`).
    """
    tables = _Tables(compared, prior)
    if most > 1:
        tables.add_pairs()
    if most > 2 and not tables.explained():
        tables.add_triples()
    weight = log_prior(prior, tables.order, expected, most)
    total = {s: v + weight(s) for s, v in tables.log.items()}
    norm = float(logsumexp(list(total.values())))
    probability = {s: float(np.exp(v - norm)) for s, v in total.items()}
    likely = tables.likely(weight)
    return SetPosterior(
        most_probable_first(probability), tables.off, tables.best, tuple(tables.order), likely
    )


class _Tables:
    """Log evidence of each set, its probability of coefficients off together, and its best rows."""

    def __init__(self, compared: MeansProblem, prior: Prior) -> None:
        self._compared = compared
        predicted = compared.predicted
        self.order = acting_order(compared.case, predicted)
        names = np.array(predicted.names)
        self._rows = {n: np.flatnonzero(names == n) for n in self.order}
        with np.errstate(divide="ignore"):
            self._weights = np.log(predicted.weights)
            self._prior_off = np.log([1 - prior.off, prior.off])
        self._apart = shapes(compared.case, predicted)
        self._log_odds = prior.log_probability
        self._unknown = bool(np.isfinite(prior.log_probability[UNKNOWN]))
        self.log: dict[Names, float] = {}
        self.off: dict[Names, float] = {}
        self.best: dict[Names, Rows] = {}
        self._by_rows: dict[Rows, float] = {}
        self._evaluated: dict[Rows, Array] = {}
        alone: dict[Names, list[Rows]] = {(): [()]}
        alone |= {(n,): [(int(i),) for i in rows] for n, rows in self._rows.items()}
        self._evaluate(alone, dict.fromkeys(alone, 0.0))
        if self._unknown:
            self.log[UNKNOWN,] = float(unknown_beside(compared, np.array([0]))[0])
            self.off[UNKNOWN,], self.best[UNKNOWN,] = self.off[()], ()

    def likely(self, weight: Callable[[Names], float]) -> list[tuple[Rows, float]]:
        """Return the most probable rows with their probabilities."""
        names = self._compared.predicted.names
        log = {rows: v + weight(tuple(names[i] for i in rows)) for rows, v in self._by_rows.items()}
        most = sorted(log, key=lambda rows: -log[rows])[:_LIKELY]
        norm = float(logsumexp([log[rows] for rows in most]))
        return [(rows, float(np.exp(log[rows] - norm))) for rows in most]

    def add_pairs(self) -> None:
        """Add every two effects, and every effect with an unknown one beside it."""
        screen = Screen(self._compared)
        screened: dict[Names, tuple[Array, list[Rows]]] = {}
        for a, b in combinations(self.order, 2):
            if {a, b} <= self._apart:
                continue
            first, second = self._rows[a], self._rows[b]
            table = screen.pairs(first, second)
            table = table + self._weights[first][:, None] + self._weights[second]
            likeliest = np.argsort(-table, axis=None)[: KEPT[-1].most]
            i, j = np.unravel_index(likeliest, table.shape)
            rows: list[Rows] = list(zip(first[i].tolist(), second[j].tolist(), strict=True))
            # Of each row, ln of the evidence of all over that of the rows up to it.
            share = logsumexp(table) - np.logaddexp.accumulate(table[i, j])
            screened[a, b] = np.asarray(share), rows
        for kept in KEPT:
            # Those that are probable enough, among the pairs.
            likely = self._likely_pairs(kept.least) if kept.least else list(screened)
            last = {s: kept.last(screened[s][0]) for s in likely}
            self._evaluate(
                {s: screened[s][1][: last[s] + 1] for s in likely},
                {s: float(screened[s][0][last[s]]) for s in likely},
            )
        if self._unknown:
            self._add_unknown()

    def _likely_pairs(self, least: float) -> list[Names]:
        """Return the pairs that have at least this probability among the pairs."""
        log = {
            s: v + float(self._log_odds[s[0]] + self._log_odds[s[1]])
            for s, v in self.log.items()
            if len(s) == 2 and UNKNOWN not in s
        }
        norm = float(logsumexp(list(log.values())))
        return [s for s, v in log.items() if v >= norm + np.log(least)]

    def _add_unknown(self) -> None:
        log = np.array([self._by_rows.get((i,), -np.inf) for i in range(len(self._weights))])
        beside = np.argsort(-log)[:_BESIDE]
        values = unknown_beside(self._compared, beside)
        for n in self.order:
            at = np.flatnonzero(np.isin(beside, self._rows[n]))
            if len(at):
                i = beside[at]
                others = self.log[n,] - float(logsumexp(log[i]))
                self.log[n, UNKNOWN] = float(logsumexp(values[at] + self._weights[i])) + others
                self.off[n, UNKNOWN], self.best[n, UNKNOWN] = self.off[n,], self.best[n,]

    def explained(self) -> bool:
        """Return whether the most probable two effects explain the measurement."""
        names = self._likeliest_pairs(1)[0]
        case, predicted = self._compared.case, self._compared.predicted
        added = [
            AppliedEffect.of(predicted.effects[n], predicted.parameters[i])
            for n, i in zip(names, self.best[names], strict=True)
        ]
        with_both = replace(case, applied=(*case.applied, *added))
        predicted = predict_hypotheses(with_both, [])
        both = compare(replace(self._compared, case=with_both, predicted=predicted))
        return both.goodness_of_fit(0)[1] >= UNEXPLAINED

    def _likeliest_pairs(self, n: int) -> list[Names]:
        pairs: list[Names] = [s for s in self.log if len(s) == 2 and UNKNOWN not in s]
        return sorted(pairs, key=lambda s: -self.log[s])[:n]

    def add_triples(self) -> None:
        """Add a third effect to the likeliest pairs, at the pairs' best parameters."""
        for pair in self._likeliest_pairs(_PAIRS_OF_THREE):
            base = self.best[pair]
            screen = Screen(self._compared, base)
            chosen: dict[Names, list[Rows]] = {}
            share: dict[Names, float] = {}
            for n in self.order:
                if n in pair or (n in self._apart and self._apart & set(pair)):
                    continue
                table = screen.pairs(self._rows[n], np.array([0]))[:, 0]
                table = table + self._weights[self._rows[n]]
                kept = np.argsort(-table)[:_KEPT_THIRD]
                names = tuple(sorted((*pair, n), key=self.order.index))
                place = names.index(n)
                chosen[names] = [
                    (*base[:place], int(i), *base[place:]) for i in self._rows[n][kept]
                ]
                share[names] = float(logsumexp(table) - logsumexp(table[kept]))
            weight = float(self._weights[list(base)].sum())
            at_best = float(self._values([base])[0].max()) + weight
            self._evaluate(chosen, {k: v + self.log[pair] - at_best for k, v in share.items()})

    def _values(self, sets: Sequence[Rows]) -> Array:
        """Return ln likelihood times prior of "off", (n_sets, 2): as stated, and off together."""
        new = [rows for rows in dict.fromkeys(sets) if rows not in self._evaluated]
        if new:
            off = bool(np.isfinite(self._prior_off[1]))
            both = evaluate_sets(self._compared, new, off=off) + self._prior_off
            self._evaluated |= dict(zip(new, both, strict=True))
        return np.array([self._evaluated[rows] for rows in sets])

    def _evaluate(
        self, chosen: Mapping[Names, Sequence[Rows]], share: Mapping[Names, float]
    ) -> None:
        """Evaluate sets of rows; ``share`` is ln of all parameters' evidence over the chosen ones'."""
        every = [rows for sets in chosen.values() for rows in sets]
        if not every:
            return
        values = self._values(every)
        weighted = values + np.array([self._weights[list(rows)].sum() for rows in every])[:, None]
        start = 0
        for names, sets in chosen.items():
            part = slice(start, start + len(sets))
            start = part.stop
            self._by_rows |= {
                rows: float(v) + share[names]
                for rows, v in zip(sets, np.logaddexp(*weighted[part].T), strict=True)
            }
            evidence = float(logsumexp(weighted[part])) + share[names]
            # A third effect is tried beside several pairs; the best stays.
            if np.isfinite(evidence) and (
                len(names) < 3 or evidence > self.log.get(names, -np.inf)
            ):
                self.log[names] = evidence
                self.off[names] = float(
                    np.exp(logsumexp(weighted[part, 1]) - logsumexp(weighted[part]))
                )
                self.best[names] = sets[int(np.argmax(np.logaddexp(*values[part].T)))]


def log_prior(
    prior: Prior, order: Sequence[str], expected: float, most: int
) -> Callable[[Names], float]:
    """Return the function from a set to its prior log probability."""
    listed = [*order, UNKNOWN]
    odds = {n: float(np.exp(prior.log_probability[n])) for n in listed}
    # Elementary symmetric polynomials: the sum over sets of so many effects.
    sums = np.zeros(most + 1)
    sums[0] = 1.0
    for n in listed:
        sums[1:] += odds[n] * sums[:-1]
    number = np.array([expected**n / factorial(n) for n in range(most + 1)])
    number /= number.sum()

    def of(names: Names) -> float:
        with np.errstate(divide="ignore"):
            log_odds = sum(float(np.log(odds[n])) for n in names)
            return float(np.log(number[len(names)]) + log_odds - np.log(sums[len(names)]))

    return of
