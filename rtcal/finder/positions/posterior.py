"""The evidence and the weight of every hypothesis, and whether something is other than stated.

The positions decide; means over them tell the family, too.

A noisy pair is no evidence that the room is other than stated. In rooms that lack nothing, one pair
often errs by more than is assumed, and the other pairs do not.

One effect in one place is weighed against another: a hypothesis at positions has a place, and no sets
are formed as on means (`rtcal.finder.means.sets`).

Something that no effect explains is no rival of the effects: a room may lack both. Its larger error is
weighed alone and beside every effect, and is as probable in both ways, so that "unknown" has what is
left where no effect explains the measurement better than larger errors do. Taken as a rival only, it
won where the right surface explained most of what was measured and errors were larger than assumed.

The evidence is linear in the shifts and Gaussian in the errors:

    y - f(mu) = d_h + J (alpha - mu) + e,   e of covariance R + D,

y is what was measured and f(mu) what is simulated as stated, d_h the shift of hypothesis h. The
prior of alpha and the error of d_h are integrated. All values are ordered (band, parameter, pair).

A shift of band k is a mixture of the shifts at the nodes of one response, and no parameter of a band
depends on another band. So each hypothesis needs products of nodes alone: N' K⁻¹ N and N' K⁻¹ r.

How much the room scatters is integrated, too: what it changes is no straight line, so it is simulated
at several levels, and every density is their mean (`ScatteringLevels`).

The error of d_h has two parts. Each band's shift is larger or smaller by a factor
(`ShiftHypothesis.error`), and reaches pairs more or less than if it were spread evenly
(`rtcal.finder.positions.hypotheses`).

All hypotheses share one covariance and differ in a product. Those on means
(`rtcal.finder.means.problem`) have a covariance each, since a closed form gives the derivatives by
alpha of every one.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics.directions import facing
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import observable
from rtcal.acoustics.priors import NORMAL_90
from rtcal.finder.case import PARAMETERS, Case, Configuration, spread_where_unknown
from rtcal.finder.claim import most_probable_first, with_added
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.evidence import Label, bounded, log_mixture, with_columns
from rtcal.finder.finding import Candidate
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.search import find as find_by_means
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.prior import COEFFICIENTS, NO_EFFECT, NONE, SCALES, UNKNOWN
from rtcal.support.errors import DataError
from rtcal.support.types import Array

TEMPER = 1.25
"""Divisor of log evidences: the mean square of a hypothesis' standardised projection in control rooms
(`python -m benchmarks.studies.pairs.where_threshold`). It would be 1 if few control runs told their
covariance without error."""
TOLD_TEMPER = 2.0
"""Divisor of log evidences where effects and surfaces are told apart. Their probabilities are then as
often right as they say (`python -m benchmarks.studies.pairs.where_temper`). The shifts of two
surfaces differ by less than the simulator errs by, in ways that control runs do not show."""
MEANS_POWER = 0.5
"""Power of the families' probabilities by means over positions, which are multiplied into those of the
positions (`python -m benchmarks.studies.pairs.where_temper`). Both see the same T, so neither
counts in full."""
LEAST_BY_MEANS = 1e-3
"""Least probability of a family by means: they have other effects, and err by more than they know."""
_NEGLIGIBLE = 15.0
"""Evidence in nats by which larger errors are less likely than those assumed, from which they are not
weighed beside each effect."""
_TINY = 1e-9
"""Prior probability below which nothing else than a noisy pair is tried."""


@dataclass(frozen=True, eq=False)
class PositionsHypotheses:
    """All hypotheses as one table; evidence and posterior weights are arrays (n, n_draws) of its rows.

    The rows are "none", coefficients that are off together, something that no effect explains, each
    spread, each shift with each of its sizes, and, where something may be ``unknown``, each of these
    once more with it beside. ``off`` is the probability of coefficients that are off together.
    """

    shifts: Sequence[ShiftHypothesis]
    spreads: Sequence[SpreadHypothesis]
    off: float
    unknown: bool = True

    @cached_property
    def effects(self) -> list[str]:
        """The effect of each row."""
        of_spreads, of_shifts = [s.effect for s in self.spreads], [s.effect for s in self.shifts]
        return self._by_row((NONE, COEFFICIENTS, UNKNOWN), of_spreads, of_shifts)

    @cached_property
    def families(self) -> list[str]:
        """The family of each row."""
        of_spreads, of_shifts = [MEASUREMENT] * len(self.spreads), [s.family for s in self.shifts]
        return self._by_row((NONE, COEFFICIENTS, UNKNOWN), of_spreads, of_shifts)

    @cached_property
    def surfaces(self) -> list[int]:
        """The number of the surface of each row; -1 where it is of none."""
        of_shifts = [-1 if s.surface is None else s.surface for s in self.shifts]
        return self._by_row((-1, -1, -1), [-1] * len(self.spreads), of_shifts)

    def _by_row(
        self, first: Sequence[Label], of_spreads: Sequence[Label], of_shifts: Sequence[Label]
    ) -> list[Label]:
        sizes = zip(of_shifts, self.shifts, strict=True)
        each = [label for label, shift in sizes for _ in shift.odds]
        return [*first, *of_spreads, *each, *(each if self.unknown else ())]

    def of_shifts(self, values: Array) -> tuple[Array, Array]:
        """Return the rows of the shifts, and those of the shifts with something unknown beside."""
        first = 3 + len(self.spreads)
        second = first + sum(len(s.odds) for s in self.shifts)
        return values[first:second], values[second:]

    @cached_property
    def log_prior(self) -> Array:
        """Log prior probability of each row, (n,); those of all rows but the first two sum to 1 - p.

        p is that of no effect. "none" has the rest of it beside coefficients that are off together.
        """
        of_shifts = np.concatenate([np.zeros(0), *(s.odds for s in self.shifts)])
        of_spreads = [s.odds for s in self.spreads]
        unknown = ODDS[UNKNOWN] if self.unknown else 0.0
        total, of_effects = unknown + sum(of_spreads) + of_shifts.sum(), of_shifts.sum()
        # Over all effects that nothing explains everything is as probable as something unknown alone,
        # but no more than a half.
        beside = min(unknown / of_effects, 0.5) if of_effects > 0 else 0.0
        both = [(1 - beside) * of_shifts, *([beside * of_shifts] if self.unknown else [])]
        odds = np.concatenate([[unknown], of_spreads, *both])
        off = max(self.off, 1e-300)
        nothing = NO_EFFECT * np.array([1 - off, off])
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.concatenate([nothing, (1 - NO_EFFECT) * odds / total])))


def evaluate(likelihoods: Likelihoods, hypotheses: PositionsHypotheses, residuals: Array) -> Array:
    """Return the log evidence of residuals (n_values, n_draws) by hypothesis, (n, n_draws)."""
    stated, off, unknown = likelihoods
    as_stated = stated.of(residuals)
    none, shifts = stated.stated(as_stated), stated.each_shifted(hypotheses.shifts, as_stated)
    as_off = [(one, one.of(residuals)) for one in off]
    shares = np.log([share for _, share in SCALES])[:, np.newaxis]
    together = logsumexp(shares + [one.stated(r) for one, r in as_off], axis=0)
    if len(shifts) and hypotheses.off > 0:
        of_scales = [one.each_shifted(hypotheses.shifts, r) for one, r in as_off]
        others = logsumexp(shares[..., np.newaxis] + of_scales, axis=0)
        shifts = log_mixture(shifts, others, hypotheses.off)
    as_unknown = [(one, one.of(residuals)) for one in unknown]

    def over_scales(values: Sequence[Array]) -> Array:
        return np.asarray(logsumexp(np.array(values), axis=0) - np.log(len(values)))

    alone = over_scales([one.stated(r) for one, r in as_unknown])
    beside = np.full_like(shifts, -np.inf) if hypotheses.unknown else shifts[:0]
    # Errors that explain even less than what nothing explains do so beside an effect, too.
    if len(beside) and not (alone < none - _NEGLIGIBLE).all():
        beside = over_scales([one.each_shifted(hypotheses.shifts, r) for one, r in as_unknown])
    spreads = [stated.spread(spread, as_stated) for spread in hypotheses.spreads]
    return np.concatenate([[none, together, alone, *spreads], shifts, beside])


def scores(posterior: Array, hypotheses: PositionsHypotheses) -> tuple[Array, Array]:
    """Return the evidence in nats that something is other than stated, and that a pair is noisy.

    Both (n_draws,), from log posterior weights. A noisy pair is no evidence of the first, which is
    against nothing or such a pair; that of the second is against nothing. Where nothing else is tried,
    the first is 0.
    """
    none, noisy = posterior[0], np.array(hypotheses.effects) == NOISE
    other = ~noisy
    other[0] = False
    of_pair = np.logaddexp.reduce(posterior[noisy], axis=0, initial=-np.inf)
    nothing = np.logaddexp(none, of_pair)
    of_noise = np.logaddexp.reduce(hypotheses.log_prior[noisy], initial=-np.inf)
    prior = np.logaddexp(none, of_noise)  # of nothing
    score = np.zeros_like(prior)
    if (prior < -_TINY).all():
        score = logsumexp(posterior[other], axis=0) - nothing - np.log1p(-np.exp(prior)) + prior
    return np.asarray(score), np.asarray(of_pair - none)


def weights(evidence: Array, hypotheses: PositionsHypotheses, temper: float = TEMPER) -> Array:
    """Return log posterior weights, the weight of "none" being its prior, (n, n_draws).

    Log evidences are divided by ``temper``.
    """
    return np.asarray(hypotheses.log_prior[:, np.newaxis] + (evidence - evidence[0]) / temper)


def gain(other: Array, evidence: Array, hypotheses: PositionsHypotheses) -> Array:
    """Return the evidence in nats for another likelihood, whatever the room lacks, (n_draws,)."""
    more = [logsumexp(weights(each, hypotheses), axis=0) for each in (other, evidence)]
    return np.asarray(more[0] - more[1] + (other[0] - evidence[0]) / TEMPER)


def with_families(
    posterior: Array, hypotheses: PositionsHypotheses, families: Mapping[str, float]
) -> Array:
    """Return weights times the probabilities of their families by means, to `MEANS_POWER`.

    A logarithmic pool of two opinions (Genest & Zidek 1986).
    """
    least = [max(families.get(family, 0.0), LEAST_BY_MEANS) for family in hypotheses.families]
    return np.asarray(posterior + MEANS_POWER * np.log(least)[:, np.newaxis])


THRESHOLD = 2.5
"""Of the evidence of the positions, in nats. In situ 1 of 23 rooms for development with nothing hidden
exceeds it without level, and 1 with it (`python -m benchmarks.studies.pairs.where_decides`)."""
OF_PROGRAMS = 13.0
"""The same where another program's values are compared, which errs in ways that control runs do not
show. Of 17 participants' models of PTB's studio as it was, an earlier version flagged one."""


def evidence_of_means(
    case: PositionsCase,
    effects: Sequence[Effect] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> MeansFinding | None:
    """Return what `rtcal.find` says of the means over positions.

    None where that finder has nothing to compare: no T, or none that can be trusted.
    """
    try:
        return find_by_means(of_means(case), effects, cache=cache)
    except DataError:
        return None


def unconfirmed(means: MeansFinding) -> str:
    """Return what means over positions claim where positions claim nothing; "" without that."""
    name = means.effect or means.family
    if name is None:
        return ""
    probability = (means.probabilities if means.effect else means.families)[name]
    return (
        f"Means over positions claim {name} ({100 * probability:.0f} %), which the differences "
        "between positions do not confirm."
    )


def of_means(case: PositionsCase) -> Case:
    """Return the case without its geometry; DataError where it has no T that can be trusted."""
    measured, tracer = case.in_room, case.simulator
    names = [observable(name).stand_in or name for name in case.match]
    rows = [measured.pairs.index(pair) for pair in case.pairs]

    def some(table: dict[str, Array]) -> dict[str, Array]:
        return {n: np.asarray(v)[rows] for n, v in table.items() if n in PARAMETERS and n in names}

    kept = Measurement(
        centre_frequencies=measured.centre_frequencies,
        values=some(dict(measured.values)),
        pairs=case.pairs,
        uncertainty=some(dict(measured.uncertainty)),
        common_uncertainty={
            n: v for n, v in measured.common_uncertainty.items() if n in PARAMETERS and n in names
        },
    )
    distances = [math.dist(tracer.sources[s], tracer.receivers[r]) for s, r in case.pairs]
    return Case(
        room=case.room,
        configurations=[
            Configuration(name="measured", measured=kept, distances=np.array(distances))
        ],
        facing=spread_where_unknown(facing(case.room, case.geometry)),
    )


_SPACING = 0.1
"""Standard deviation of ln size within the grid's distance, which is 0.26."""


@dataclass(frozen=True, eq=False)
class Summary:
    """Probabilities of everything that may be other than stated; see `PositionsFinding`.

    ``on_surfaces`` is the probability that something stands on a surface, ``unexplained`` that of
    something that no effect explains, alone or beside an effect.
    """

    candidates: tuple[Candidate, ...]
    probabilities: dict[str, float]
    families: dict[str, float]
    surfaces: dict[str, float]
    on_surfaces: float
    unexplained: float


def summary_of(case: PositionsCase, hypotheses: PositionsHypotheses, posterior: Array) -> Summary:
    """Return what the weights of a single set of residuals say."""
    chances = np.exp(posterior[:, 0] - logsumexp(posterior[:, 0]))
    of_shifts, beside = hypotheses.of_shifts(chances)
    unexplained = float(chances[2] + beside.sum())
    if len(beside):
        of_shifts = of_shifts + beside
    ends = np.cumsum([len(shift.odds) for shift in hypotheses.shifts])
    grouped: dict[tuple[str, int | None, str], list[tuple[ShiftHypothesis, Array]]] = {}
    for shift, some in zip(hypotheses.shifts, np.split(of_shifts, ends)[: len(ends)], strict=True):
        grouped.setdefault((shift.effect, shift.surface, shift.place), []).append((shift, some))
    candidates = [_candidate(case, members) for members in grouped.values()]
    places: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for spread, chance in zip(hypotheses.spreads, chances[3:].tolist(), strict=False):
        places.setdefault((spread.effect, spread.place), []).append(
            (chance, spread.size, spread.unit)
        )
    candidates += [_misplaced(*place, members) for place, members in places.items()]
    for effect, chance in zip((COEFFICIENTS, UNKNOWN), chances[1:3].tolist(), strict=True):
        if chance > 0:
            candidates.append(Candidate(effect=effect, family=effect, probability=chance))
    candidates.sort(key=lambda c: -c.probability)
    probabilities = {NONE: float(chances[0])}
    families = dict(probabilities)
    surfaces = dict.fromkeys(case.faces, 0.0)
    for c in candidates:
        probabilities[c.effect] = probabilities.get(c.effect, 0.0) + c.probability
        families[c.family] = families.get(c.family, 0.0) + c.probability
        if c.surface is not None:
            surfaces[c.surface] += c.probability
    on_surfaces = sum(surfaces.values())
    shares = {n: p / on_surfaces if on_surfaces > 0 else 0.0 for n, p in surfaces.items()}
    return Summary(
        tuple(candidates),
        most_probable_first(probabilities),
        with_added(families),
        most_probable_first(shares),
        on_surfaces,
        unexplained,
    )


def _shares(chances: Array) -> Array:
    """Return probabilities over their sum, equal ones where all are 0."""
    total = chances.sum()
    return chances / total if total > 0 else np.full(len(chances), 1 / len(chances))


def _candidate(case: PositionsCase, members: Sequence[tuple[ShiftHypothesis, Array]]) -> Candidate:
    """Return the candidate of an effect in one place: spread over a surface, and on its parts."""
    shift = members[0][0]
    chances = np.concatenate([some for _, some in members])
    sizes = np.concatenate([member.sizes for member, _ in members])
    total = float(chances.sum())
    share = _shares(chances)
    likely = int(np.argmax(share))
    signed = bool((sizes <= 0).any())
    scale = sizes if signed else np.log(sizes)
    mean = float(share @ scale)
    more = 0.0 if signed else _SPACING**2 + shift.size_error**2
    deviation = float(np.sqrt(share @ (scale - mean) ** 2 + more))
    ends = [mean, mean - NORMAL_90 * deviation, mean + NORMAL_90 * deviation]
    size, low, high = ends if signed else np.exp(ends).tolist()
    surface = None if shift.surface is None else list(case.faces)[shift.surface]
    if surface is not None and shift.unit == "m²":  # no more stands on a surface than it has
        size, low, high = (min(each, case.areas[surface]) for each in (size, low, high))
    return Candidate(
        effect=shift.effect,
        family=shift.family,
        surface=surface,
        place=surface or shift.place,
        probability=total,
        size=size,
        low=low,
        high=high,
        unit=shift.unit,
        parameters=[p for member, _ in members for p in member.parameters][likely],
        spectrum=np.asarray(share @ np.concatenate([member.spectra for member, _ in members])),
        parts=tuple(
            (case.divided.parts[member.part].middle, float(some.sum()))
            for member, some in members
            if member.part is not None
        ),
    )


def _misplaced(effect: str, place: str, members: Sequence[tuple[float, float, str]]) -> Candidate:
    """Return a candidate of the measurement: its sizes are those that are tried."""
    chances = np.array([chance for chance, _, _ in members])
    sizes = np.array([size for _, size, _ in members])
    total = float(chances.sum())
    share = _shares(chances)
    likely = sizes[share >= min(0.05, share.max())]
    size = float(np.clip(share @ sizes, likely.min(), likely.max()))
    return Candidate(
        effect=effect,
        family=MEASUREMENT,
        place=place,
        probability=total,
        size=size,
        low=float(likely.min()),
        high=float(likely.max()),
        unit=members[0][2],
    )


POSITION, NOISE, MEASUREMENT = "position", "noise", "measurement"
ODDS = {
    POSITION: 0.5,
    NOISE: 0.5,
    UNKNOWN: 0.5,
    "air": 1.0,
    "volume": 1.0,
    COEFFICIENTS: 1.0,
}
"""Prior odds against an effect of odds 1; those of the absorbers are their classes'."""


@dataclass(frozen=True, eq=False)
class ShiftHypothesis:
    """Hypotheses of one effect in one place, with their sizes.

    Attributes
    ----------
    effect, family : str
    surface : int or None
        Number of the surface; None for the whole room.
    response : str
        Which of the responses is interpolated.
    weights : array (n_hypotheses, n_bands, n_nodes)
        Shift of band k is weights[:, k] @ the response's nodes of band k.
    odds : array (n_hypotheses,)
        Prior odds of each within its effect; over all surfaces they are normalised to 1.
    sizes : array (n_hypotheses,)
    unit : str
    parameters : sequence of mapping
    spectra : array (n_hypotheses, n_bands)
        Alpha of what stands on the surface; empty for the whole room.
    error : array (n_bands, n_bands)
        Covariance of the relative error of the change, band by band.
    uneven : array (n_hypotheses,)
        How far pairs may hear more or less of it; see `rtcal.finder.positions.hypotheses`.
    size_error : float
        Standard deviation of ln size that the effect's description leaves open.
    place : str
        The material whose coefficients are off.
    part : int or None
        Number of the part of the surface; None for all of it.
    divisible : bool
        Whether it may stand on a part of its surface alone.
    """

    effect: str
    family: str
    surface: int | None
    response: str
    weights: Array
    odds: Array
    sizes: Array
    unit: str
    parameters: Sequence[Parameters]
    spectra: Array
    error: Array
    uneven: Array
    size_error: float = 0.0
    place: str = ""
    part: int | None = None
    divisible: bool = False

    def some(self, which: slice) -> ShiftHypothesis:
        """Return some of the hypotheses."""
        return replace(
            self,
            weights=self.weights[which],
            odds=self.odds[which],
            sizes=self.sizes[which],
            parameters=self.parameters[which],
            spectra=self.spectra[which],
            uneven=self.uneven[which],
        )


@dataclass(frozen=True, eq=False)
class SpreadHypothesis:
    """A hypothesis that some values err by more: their covariance grows by ``columns columns'``.

    ``rows`` are the values' numbers in the order (band, parameter, pair), ``columns`` (n_rows,
    n_errors) are their errors, one standard deviation each. ``place`` names the source, receiver or
    pair.
    """

    effect: str
    place: str
    size: float
    unit: str
    rows: NDArray[np.int64]
    columns: Array
    odds: float


def interpolation(nodes: Sequence[float], at: Array) -> Array:
    """Return the nodes' weights (..., n_nodes) in a linear interpolation that is 0 at 0.

    Beyond the nodes the value at the last one is taken.
    """
    every = np.array(sorted([*nodes, 0.0]))
    position = np.clip(at, every[0], every[-1])
    right = np.clip(np.searchsorted(every, position), 1, len(every) - 1)
    share = (position - every[right - 1]) / (every[right] - every[right - 1])
    out = np.zeros((*np.shape(at), len(every)))
    np.put_along_axis(out, right[..., np.newaxis], share[..., np.newaxis], -1)
    np.put_along_axis(out, right[..., np.newaxis] - 1, (1 - share)[..., np.newaxis], -1)
    kept = [int(np.flatnonzero(every == node)[0]) for node in nodes]
    return np.asarray(out[..., kept])


_AT_ONCE = 256
"""Hypotheses in one product: their matrices fill some 10 MB."""


@dataclass(frozen=True, eq=False)
class ScatteringLevels:
    """Shifts of the whole room if it scatters more or less than is assumed.

    Attributes
    ----------
    shifts : array (n, n_levels)
        In the order (band, parameter, pair).
    log_weights : array (n_levels,)
        Log prior probabilities of the levels.
    """

    shifts: Array
    log_weights: Array

    @classmethod
    def assumed(cls, n: int) -> ScatteringLevels:
        """Return the assumed level alone, for ``n`` values."""
        return cls(np.zeros((n, 1)), np.zeros(1))

    @property
    def covariance(self) -> Array:
        """Covariance of the shifts over the levels, (n, n)."""
        weights = np.exp(self.log_weights)
        off = self.shifts - (self.shifts @ weights)[:, np.newaxis]
        return np.asarray((off * weights) @ off.T)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Sets of residuals as one likelihood takes them, at each level one after the other.

    Attributes
    ----------
    pull : array (n, n_levels n_draws)
        K⁻¹ r, K the covariance.
    square : array (n_levels n_draws,)
        r' K⁻¹ r.
    """

    pull: Array
    square: Array


@dataclass(eq=False)
class Likelihood:
    """The density of residuals (n,) under one covariance of everything but the hypothesis.

    Parameters
    ----------
    covariance : array (n, n)
        In the order (band, parameter, pair).
    used : bool array (n,)
        Which values were measured; the others say nothing.
    nodes : mapping of str to array (n_bands, n_values, n_nodes)
        Shifts at the nodes of each response, by band.
    uneven : array (n_values, n_columns)
        Deviations by pair at a change of 1 of the absorption; see `rtcal.finder.positions.hypotheses`.
    amount : array (n_values,)
        Weights of a band's shift in that change.
    levels : ScatteringLevels
    """

    covariance: Array
    used: NDArray[np.bool_]
    nodes: Mapping[str, Array]
    uneven: Array
    amount: Array
    levels: ScatteringLevels
    inverse: Array = field(init=False)
    half: float = field(init=False)
    _products: dict[str, Array] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        both = np.outer(self.used, self.used)
        kept = np.where(both, self.covariance, 0.0) + np.diag(np.where(self.used, 0.0, 1.0))
        factor = np.linalg.cholesky(kept)
        self.half = float(np.log(np.diag(factor)).sum())
        # A value that was not measured has a residual of any size: its row is 0.
        self.inverse = np.where(both, np.linalg.inv(kept), 0.0)

    @property
    def number(self) -> int:
        """Number of values that were measured."""
        return int(self.used.sum())

    def of(self, residuals: Array) -> Residuals:
        """Return residuals (n, n_draws) as the other methods take them."""
        by_level = residuals[:, np.newaxis] - self.levels.shifts[..., np.newaxis]
        measured = np.where(self.used[:, np.newaxis], by_level.reshape(len(residuals), -1), 0.0)
        pull = np.asarray(self.inverse @ measured)
        return Residuals(pull, np.asarray(np.einsum("nm,nm->m", measured, pull)))

    def with_one_level(self) -> Likelihood:
        """Return the normal likelihood whose covariance has that of the levels."""
        covariance = self.covariance + self.levels.covariance
        levels = ScatteringLevels.assumed(len(covariance))
        return Likelihood(
            covariance, self.used, self.nodes, uneven=self.uneven, amount=self.amount, levels=levels
        )

    def stated(self, residuals: Residuals) -> Array:
        """Return the log density if nothing is other than stated, (n_draws,)."""
        return self._log(residuals.square, self.half)

    def shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        """Return the log density by hypothesis, (n_hypotheses, n_draws)."""
        if len(shift.weights) <= _AT_ONCE:
            return self._shifted(shift, residuals)
        parts = range(0, len(shift.weights), _AT_ONCE)
        return np.concatenate(
            [self._shifted(shift.some(slice(p, p + _AT_ONCE)), residuals) for p in parts]
        )

    def each_shifted(self, shifts: Sequence[ShiftHypothesis], residuals: Residuals) -> Array:
        """Return `shifted` of each, one after the other."""
        n_draws = len(residuals.square) // len(self.levels.log_weights)
        return np.concatenate(
            [np.zeros((0, n_draws)), *(self.shifted(s, residuals) for s in shifts)]
        )

    def _shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        projected, forms = self._forms(shift, residuals)
        error = np.asarray(np.linalg.cholesky(shift.error + 1e-9 * np.eye(len(shift.error))))
        whole = residuals.square - 2 * projected.sum(1)
        whole = whole + forms.sum((1, 2))[:, np.newaxis]
        left = projected - forms.sum(2)[:, :, np.newaxis]
        inner = error.T @ forms @ error
        turned = error.T @ left
        if shift.uneven.any():
            inner, turned = self._with_uneven(shift, residuals, error, inner, turned)
        return self._log(*with_columns(whole, self.half, turned, inner))

    def _with_uneven(
        self,
        shift: ShiftHypothesis,
        residuals: Residuals,
        error: Array,
        inner: Array,
        turned: Array,
    ) -> tuple[Array, Array]:
        """Return products with K⁻¹ of the errors' columns, those of the pairs after the bands'."""
        nodes = self.nodes[shift.response]
        n_columns = self.uneven.shape[1]
        change = np.einsum("hkn,kn->hk", shift.weights, np.einsum("v,kvn->kn", self.amount, nodes))
        change = change * shift.uneven[:, np.newaxis]
        both = (change[:, :, np.newaxis] * change[:, np.newaxis]).reshape(len(change), -1)
        pairs = (both @ self._uneven_products).reshape(-1, n_columns, n_columns)
        cross = self._uneven_node_products(shift.response)  # (k, c, l, n): band k, column c
        mixed = np.einsum("hk,kcln->hcln", change, cross, optimize=True)
        mixed = np.einsum("hcln,hln->hcl", mixed, shift.weights, optimize=True)
        pulled = residuals.pull.reshape(len(nodes), nodes.shape[1], -1)
        by_column = np.einsum("vc,kvm->kcm", self.uneven, pulled)
        toward = np.einsum("hk,kcm->hcm", change, by_column, optimize=True)
        toward = toward - mixed.sum(axis=2)[:, :, np.newaxis]
        side = mixed @ error
        joined = np.concatenate(
            [
                np.concatenate([inner, side.swapaxes(1, 2)], axis=2),
                np.concatenate([side, pairs], axis=2),
            ],
            axis=1,
        )
        return joined, np.concatenate([turned, toward], axis=1)

    def inverse_with_place(self, shift: ShiftHypothesis, row: int) -> Array:
        """Return the inverse of the covariance with the error of a hypothesis' place, (n, n)."""
        nodes = self.nodes[shift.response]
        change = np.einsum("kn,kvn,v->k", shift.weights[row], nodes, self.amount)
        columns = np.multiply.outer(change * shift.uneven[row], self.uneven)
        columns = columns.reshape(-1, self.uneven.shape[1])
        pulled = self.inverse @ columns
        inner = np.eye(columns.shape[1]) + columns.T @ pulled
        return np.asarray(self.inverse - pulled @ np.linalg.solve(inner, pulled.T))

    @cached_property
    def _uneven_products(self) -> Array:
        """W' K⁻¹ W by pairs of bands, (n_bands², n_columns²), W being `uneven`."""
        n_values, n_columns = self.uneven.shape
        n_bands = len(self.inverse) // n_values
        inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
        half = np.einsum("vc,kvlw->kclw", self.uneven, inverse, optimize=True)
        full = np.einsum("kclw,wd->klcd", half, self.uneven, optimize=True)
        return np.asarray(full.reshape(n_bands**2, n_columns**2))

    def _uneven_node_products(self, response: str) -> Array:
        """Return W' K⁻¹ N, (n_bands, n_columns, n_bands, n_nodes)."""
        key = f"uneven {response}"
        if key not in self._products:
            nodes = self.nodes[response]
            n_bands, n_values, _ = nodes.shape
            inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
            half = np.einsum("kvlw,lwn->kvln", inverse, nodes, optimize=True)
            self._products[key] = np.einsum("vc,kvln->kcln", self.uneven, half, optimize=True)
        return self._products[key]

    def spread(self, spread: SpreadHypothesis, residuals: Residuals) -> Array:
        """Return the log density with some errors wider, (n_draws,)."""
        kept = self.used[spread.rows]
        rows, columns = spread.rows[kept], spread.columns[kept]
        across, inner = columns.T @ residuals.pull[rows], self.inverse[np.ix_(rows, rows)]
        return self._log(
            *with_columns(residuals.square, self.half, across, columns.T @ inner @ columns)
        )

    def forms(self, shift: ShiftHypothesis) -> Array:
        """Return d' K⁻¹ d by pairs of bands, (n_hypotheses, n_bands, n_bands)."""
        products = self._node_products(shift.response)
        right = np.einsum("kmln,hln->hkml", products, shift.weights, optimize=True)
        return np.asarray((shift.weights[..., np.newaxis] * right).sum(axis=2))

    def _forms(self, shift: ShiftHypothesis, residuals: Residuals) -> tuple[Array, Array]:
        nodes = self.nodes[shift.response]
        pulled = residuals.pull.reshape(len(nodes), nodes.shape[1], -1)
        by_node = nodes.swapaxes(1, 2) @ pulled
        return np.asarray(shift.weights.swapaxes(0, 1) @ by_node).swapaxes(0, 1), self.forms(shift)

    def _node_products(self, response: str) -> Array:
        """Return N' K⁻¹ N, (n_bands, n_nodes, n_bands, n_nodes)."""
        if response not in self._products:
            nodes = self.nodes[response]
            n_bands, n_values, _ = nodes.shape
            inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
            half = np.einsum("krls,lsn->krln", inverse, nodes, optimize=True)
            self._products[response] = np.einsum("krm,krln->kmln", nodes, half, optimize=True)
        return self._products[response]

    def _log(self, square: Array, half: Array | float) -> Array:
        """Return the log density from chi-squares by level and ln sqrt|C|: the mean over the levels.

        (..., n_levels n_draws) to (..., n_draws).
        """
        log = bounded(square, half, self.number)
        weights = self.levels.log_weights[:, np.newaxis]
        by_level = log.reshape(*log.shape[:-1], len(weights), -1) + weights
        return np.asarray(np.logaddexp.reduce(by_level, axis=-2))


Likelihoods = tuple[Likelihood, list[Likelihood], list[Likelihood]]
"""With coefficients as stated, off together, and of something that no effect explains."""


def flat(values: Array) -> Array:
    """Return values (n_parameters, n_pairs, n_bands) in the order (band, parameter, pair), (n,)."""
    return np.asarray(np.moveaxis(values, 2, 0).reshape(-1))


def band_first(values: Array) -> Array:
    """Return shifts (n_parameters, n_pairs, n_bands, n_nodes) by band, (n_bands, n_values, n_nodes)."""
    moved = np.moveaxis(values, 2, 0)
    return np.asarray(moved.reshape(len(moved), -1, values.shape[-1]))


def reordered(covariance: Array, shape: Sequence[int]) -> Array:
    """Return a covariance over (parameter, pair, band) in the order (band, parameter, pair)."""
    p, i, k = shape
    order = np.moveaxis(np.arange(p * i * k).reshape(p, i, k), 2, 0).reshape(-1)
    return np.asarray(covariance[np.ix_(order, order)])
