"""Sets of effects, several in the model at once: their evidence and their probabilities.

A hypothesis here is a set of rows of `MeansHypotheses`, each of another effect. There are some 200,000
pairs, so all are screened in closed form, and the best of each two effects are evaluated as `evidence`
does. The screen adds the changes that the effects cause alone. With C = L L' the covariance under
"none", M = U U' the misfit of an effect's change and W = L⁻¹ U, a pair costs one system of a few rows
(Woodbury) in place of a factorisation.

The likelihood has its full power, where the search for one effect coarsens it
(`likelihood.COARSENING`): that guards against what else the model lacks, which a set has in it. Chosen
by raising the sets' probabilities of development rooms to powers, without a new search: of the families
that reached 0.9, 42 of 45 were right at full power, 25 of 26 at the coarsened one. Both of two effects
were claimed in 5 of 36 rooms, and in 1.

The number of effects is Poisson, cut at a largest number. Given the number, a set has the product of
its effects' odds. Coefficients that are off together stand beside any set, with their own prior.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from rtcal.acoustics.bands import correlation
from rtcal.finder.case import Case
from rtcal.finder.claim import Names, families_of, family_of, most_probable_first
from rtcal.finder.effects import AppliedEffect, Effect, added, changed_states
from rtcal.finder.evidence import student
from rtcal.finder.means.problem import (
    COMMON_CORRELATION,
    MeansEvidence,
    MeansHypotheses,
    MeansProblem,
    Moments,
    distances,
    log_likelihoods,
    misfit_columns,
    predict_hypotheses,
    predict_states,
    state,
    unknown_evidence,
)
from rtcal.finder.model import RoomState, predict
from rtcal.finder.prior import COEFFICIENTS, EXPECTED, NONE, UNKNOWN, Prior
from rtcal.support.types import Array


def compare(problem: MeansProblem) -> MeansProblem:
    """Return a problem of sets: with errors of the direct sound (`DIRECT_SOUND`) and the grids."""
    case, predicted = problem.case, problem.predicted
    columns = np.zeros((*predicted.features.shape[1:], case.room.n_bands))
    over_bands = np.linalg.cholesky(correlation(case.room.centre_frequencies, COMMON_CORRELATION))
    for i, c in enumerate(case.configurations):
        base, at = state(case, c), distances(case, c)
        levels = (base.direct_db + 1.0, base.direct_db - 1.0)
        up, down = predict([replace(base, direct_db=level) for level in levels], at).features
        columns[i] = 0.5 * DIRECT_SOUND * (up - down)[:, :, None] * over_bands
    flat = columns.reshape(-1, columns.shape[-1])
    predicted = replace(predicted, applied=predicted.applied + flat @ flat.T)
    return replace(problem, predicted=predicted, cells=_cells(problem))


def _cells(problem: MeansProblem) -> Array:
    """Return the changes of the features over each hypothesis's cell of the grid.

    The standard deviation of an even distribution is the step over sqrt(12). Without it, what lies
    between the grid's points would look like a second effect.
    """
    predicted = problem.predicted
    c, f, b = problem.places
    features = predicted.features[:, c, f, b]
    steps: list[Array] = []
    for name, effect in predicted.effects.items():
        rows, grid = predicted.rows[name], predicted.grid(name)
        for k, parameter in enumerate(p for p in grid[0] if p not in effect.discrete):
            if k == len(steps):
                steps.append(np.zeros_like(features))
            others = [p for p in grid[0] if p != parameter]
            keys = list(map(itemgetter(*others), grid)) if others else [()] * len(grid)
            lines: dict[Any, list[int]] = {}
            for j in np.argsort(list(map(itemgetter(parameter), grid))):
                lines.setdefault(keys[j], []).append(rows[j])
            for line in lines.values():
                if len(line) > 1:
                    steps[k][line] = np.gradient(features[line], axis=0)
    if not steps:
        return np.zeros((*features.shape, 0))
    return np.asarray(np.stack(steps, axis=-1) / np.sqrt(12))


DIRECT_SOUND = 6.0
"""Standard deviation of the direct sound's level in dB, in every set; alike in neighbouring octaves.
Objects between source and receiver shade it, and the directivity of a source may be 6 dB (ISO 3382-1,
Table 1, 4 kHz). No formula has either in it, so that C80 and G would speak for a second effect."""
Indices = NDArray[np.intp]
Rows = tuple[int, ...]
"""A set of effects with their parameters: rows of `MeansHypotheses`, in the order in which they act."""
_AT_ONCE = 256


def acting_order(case: Case, predicted: MeansHypotheses) -> tuple[list[str], frozenset[str]]:
    """Return the effects' names in the order in which they act on a state, and those that bend it.

    Another equation comes first, since absorbers are added in its terms; then whatever contradicts
    what the room states; then what is added to it. A set holds one effect at most that replaces the
    decay's shape.
    """
    base = state(case, case.configurations[0])
    changed = {
        name: changed_states(effect, base, predicted.grid(name)[:1])[0]
        for name, effect in predicted.effects.items()
    }

    def rank(name: str) -> tuple[bool, bool]:
        contradicts = predicted.effects[name].contradicts(case.room)
        return changed[name].equation == base.equation, not contradicts

    bends = frozenset(name for name, made in changed.items() if made.shape is not None)
    return sorted(changed, key=rank), bends


class Screen:
    """Log likelihoods of pairs from the changes that each effect causes alone.

    With a ``base``, of pairs beside the effects of these rows. Row 0, "none", is a member that changes
    nothing.
    """

    def __init__(self, compared: MeansProblem, base: Rows = ()) -> None:
        predicted, change, amount = compared.predicted, compared.changes, compared.amounts
        _, f, b = compared.places
        alpha, other = compared.covariance_of(0)
        smooth = predicted.spectrum_errors[:, :, :2].take(b, 1)
        error = misfit_columns(change, amount, f, smooth)
        residual = compared.residual(0)
        for i in base:
            residual = residual - change[i]
            other = other + compared.error_of_change(slice(i, i + 1))[0]
        factor = np.linalg.cholesky(alpha + other)
        self._half = float(np.log(np.diag(factor)).sum())
        self._m = len(factor)

        def whitened(rows: Array) -> Array:
            flat = rows.reshape(-1, self._m)
            return np.asarray(solve_triangular(factor, flat.T, lower=True).T.reshape(rows.shape))

        self._z = whitened(residual[None])[0]
        self._v = whitened(change)
        self._w = whitened(np.concatenate([error, compared.cells], axis=2).swapaxes(1, 2))
        self._own = self._w @ self._w.swapaxes(1, 2)

    def pairs(self, first: Indices, second: Indices) -> Array:
        """Return the log likelihoods of every row of ``first`` with every one of ``second``."""
        a, b, r = len(first), len(second), self._w.shape[1]
        left = self._z - self._v[first]
        v, w1, w2 = self._v[second], self._w[first], self._w[second]
        # I + W' W, bordered by W' r and r' r: one Cholesky factor has its determinant and, squared in
        # its last element, what the misfit leaves of r' r.
        bordered = np.empty((a, b, 2 * r + 1, 2 * r + 1))
        bordered[:, :, :r, :r] = self._own[first][:, None]
        bordered[:, :, r:-1, r:-1] = self._own[second]
        bordered[:, :, r:-1, :r] = np.tensordot(w2, w1, axes=(2, 2)).transpose(2, 0, 1, 3)
        diagonal = np.arange(2 * r)
        bordered[:, :, diagonal, diagonal] += 1.0
        bordered[:, :, -1, :r] = (w1 @ left[:, :, None])[:, None, :, 0] - np.einsum(
            "arm,bm->abr", w1, v, optimize=True
        )
        bordered[:, :, -1, r:-1] = (
            np.einsum("am,brm->abr", left, w2, optimize=True) - (w2 @ v[:, :, None])[None, :, :, 0]
        )
        bordered[:, :, -1, -1] = (left**2).sum(1)[:, None] - 2 * left @ v.T + (v**2).sum(1)
        roots = np.diagonal(np.linalg.cholesky(bordered), axis1=2, axis2=3)
        half, square = np.log(roots[..., :-1]).sum(-1), roots[..., -1] ** 2
        return student(square, self._half + half, self._m, coarsened=False)


def evaluate_sets(compared: MeansProblem, sets: Sequence[Rows], *, off: bool) -> Array:
    """Return the log likelihoods of sets in nats, each with all of its effects in the state.

    (n_sets, 2): with the coefficients as stated, and off together; -inf without ``off``.
    """
    begins, possible = range(0, len(sets), _AT_ONCE), list[NDArray[np.bool_]]()

    def parts() -> Iterator[Moments]:
        for begin in begins:
            of, finite = moments(compared, sets[begin : begin + _AT_ONCE])
            possible.append(finite)
            yield of

    values = compared.observed.values[None]
    both = log_likelihoods(parts(), values, [values.shape[1]], off=off, coarsened=False)
    log = np.stack([of_all[0, :, 0] for of_all in both], axis=1)
    return np.where(np.concatenate(possible)[:, None], log, -np.inf)


def moments(compared: MeansProblem, sets: Sequence[Rows]) -> tuple[Moments, NDArray[np.bool_]]:
    """Return the moments with all effects of a set in the state, and which sets are possible, (n,).

    A set that is not has no finite features; its moments are 0 and the unit matrix.
    """
    most = max(map(len, sets))
    members = [np.array([rows[k] if k < len(rows) else 0 for rows in sets]) for k in range(most)]
    if most < 2:
        # These are predicted already.
        of = compared.moments(members[0] if most else np.zeros(len(sets), dtype=int), members)
    else:
        made = predict_states(compared.case, states_of(compared, sets))
        of = compared.moments(np.arange(len(sets)), members, made)
    possible = np.asarray(np.isfinite(of.mean).all(1) & np.isfinite(of.covariance).all((1, 2)))
    of.mean[~possible], of.covariance[~possible] = 0.0, np.eye(of.mean.shape[1])
    of.common[~possible] = 0.0
    return of, possible


def states_of(compared: MeansProblem, sets: Sequence[Rows]) -> list[list[RoomState]]:
    """Return the states of sets in each configuration; what is removed there is left out."""
    predicted, out = compared.predicted, []
    for where in compared.case.configurations:
        made: dict[Rows, RoomState] = {(): state(compared.case, where)}
        for length in range(1, max(map(len, sets)) + 1):
            groups: dict[tuple[Rows, str], list[int]] = {}
            for rows in dict.fromkeys(s[:length] for s in sets if len(s) >= length):
                groups.setdefault((rows[:-1], predicted.names[rows[-1]]), []).append(rows[-1])
            for (before, name), last in groups.items():
                effect = predicted.effects[name]
                states = [made[before]] * len(last)
                if not (where.suspect_removed and effect.removable):
                    grid = [predicted.parameters[i] for i in last]
                    states = added(effect, made[before], grid)
                made |= {(*before, i): s for i, s in zip(last, states, strict=True)}
        out.append([made[rows] for rows in sets])
    return out


def unknown_beside(compared: MeansProblem, rows: Indices) -> Array:
    """Return the log evidence of single hypotheses with an unknown effect beside them, (n_rows,)."""
    used, out = compared.observed.used, []
    for i in rows.tolist():
        alpha, other = compared.covariance_of(i)
        residual = compared.residual(i)
        ends = [len(residual)]
        value = unknown_evidence(residual[None], alpha + other, used, ends, coarsened=False)
        out.append(value[0, 0])
    return np.array(out)


def averaged_alpha(compared: MeansProblem, likely: Sequence[tuple[Rows, float]]) -> Array:
    """Return the posterior mean of alpha over sets with these probabilities, (n_materials, n_bands).

    Under each set, features and coefficients are jointly normal, with the moments that the evidence
    has: E[alpha | y] = mu + Sigma G' C^-1 (y - mean), G = d features / d alpha. Each set has its
    probability as its weight (Hoeting et al. 1999). So T bends the coefficients only as far as neither
    an effect nor the model's error explains it. Coefficients stay within 0 and 1.
    """
    sets = [rows for rows, _ in likely]
    of, possible = moments(compared, sets)
    across = covariance_with_alpha(compared, sets)
    weights = np.array([p for _, p in likely]) * possible
    out = np.array(compared.case.room.alpha)
    for k in np.flatnonzero(weights):
        explained = np.linalg.solve(of.covariance[k], compared.observed.values - of.mean[k])
        out += weights[k] / weights.sum() * np.tensordot(explained, across[k], axes=1)
    return np.clip(out, 0.0, 1.0)


def covariance_with_alpha(compared: MeansProblem, sets: Sequence[Rows]) -> Array:
    """Return G Sigma, the prior's covariance of the features in use and alpha, under each set.

    (n_sets, n_used, n_materials, n_bands).
    """
    room, (c, f, b) = compared.case.room, compared.places
    made = predict_states(compared.case, states_of(compared, sets))
    # What stands where a configuration changed a material is another one.
    changed = [[m in at.changes for m in room.materials] for at in compared.case.configurations]
    per_alpha = -np.where(np.array(changed)[:, :, None], 0.0, made.jacobian)
    slopes = made.slopes[:, c, f, b][..., None] * per_alpha[:, c, :, b].swapaxes(0, 1)
    jacobian = np.zeros((*slopes.shape, room.n_bands))
    jacobian[:, np.arange(len(b)), :, b] = slopes.swapaxes(0, 1)
    rho = correlation(room.centre_frequencies, room.band_correlation)
    return np.asarray((jacobian * room.sigma) @ rho * room.sigma)


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
        places = predicted.rows[name]
        weighted = log[places] + predicted.log_weights[places]
        share = p * np.exp(weighted - logsumexp(weighted))
        off[name,] = float(evidence.off_given(name))
        rows[name,] = (int(places[np.argmax(log[places])]),)
        likely += [((int(i),), float(w)) for i, w in zip(places, share, strict=True)]
    likely = sorted(likely, key=itemgetter(1), reverse=True)[:_LIKELY]
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
        self.order, self._apart = acting_order(compared.case, predicted)
        self._rows = {n: predicted.rows[n] for n in self.order}
        self._weights = predicted.log_weights
        with np.errstate(divide="ignore"):
            self._prior_off = np.log([1 - prior.off, prior.off])
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
            AppliedEffect(predicted.effects[n], predicted.parameters[i])
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
