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
from functools import cached_property, partial

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
from rtcal.finder.evidence import log_mixture
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
class PositionsEvidence:
    """Log evidence of every hypothesis, or its log posterior weight, for n_draws sets of residuals.

    ``none`` (n_draws,). ``shifts`` has an array (n_hypotheses, n_draws) for each `ShiftHypothesis`,
    ``spreads`` an array (n_draws,) for each `SpreadHypothesis`. ``beside`` has that of ``shifts`` where
    something is other than stated that no effect explains, too; it is empty where that is not tried.
    """

    none: Array
    coefficients: Array
    unknown: Array
    shifts: list[Array]
    spreads: list[Array]
    beside: list[Array] = field(default_factory=list)

    @property
    def total(self) -> Array:
        """Log of the sum over all hypotheses, (n_draws,)."""
        every = [self.none, self.coefficients, self.unknown, *self.spreads]
        every += [np.asarray(logsumexp(w, axis=0)) for w in (*self.shifts, *self.beside)]
        return np.asarray(logsumexp(np.array(every), axis=0))


@dataclass(frozen=True, eq=False)
class PositionsHypotheses:
    """All hypotheses with their prior log probabilities, given that something is other than stated."""

    shifts: Sequence[ShiftHypothesis]
    spreads: Sequence[SpreadHypothesis]
    off: float
    unknown: bool = True

    @cached_property
    def total(self) -> float:
        """Sum of all odds."""
        odds = sum(float(s.odds.sum()) for s in self.shifts) + sum(s.odds for s in self.spreads)
        return odds + self.unknown_odds

    @property
    def unknown_odds(self) -> float:
        """Odds of something that no effect explains."""
        return ODDS[UNKNOWN] if self.unknown else 0.0

    @property
    def unexplained(self) -> float:
        """Prior probability that no effect explains everything, where there is one.

        Over all effects it is that of something unknown alone, but no larger than a half.
        """
        of_effects = sum(float(s.odds.sum()) for s in self.shifts)
        return min(self.unknown_odds / of_effects, 0.5) if of_effects > 0 else 0.0

    def log_prior(self, odds: Array | float) -> Array:
        """Return the log prior probability of hypotheses with these odds."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.asarray(odds) / self.total * (1 - NO_EFFECT)))


def evaluate(
    likelihoods: Likelihoods, hypotheses: PositionsHypotheses, residuals: Array
) -> PositionsEvidence:
    """Return the evidence of residuals (n, n_draws)."""
    stated, off, unknown = likelihoods
    as_stated = stated.of(residuals)
    as_off = [one.of(residuals) for one in off]
    shares = np.log([share for _, share in SCALES])
    together = logsumexp(
        [s + one.stated(r) for s, one, r in zip(shares, off, as_off, strict=True)], axis=0
    )
    none = stated.stated(as_stated)

    shifts = stated.each_shifted(hypotheses.shifts, as_stated)
    if shifts and hypotheses.off > 0:
        others = [
            np.concatenate(one.each_shifted(hypotheses.shifts, r))
            for one, r in zip(off, as_off, strict=True)
        ]
        of_scales = logsumexp([s + each for s, each in zip(shares, others, strict=True)], axis=0)
        mixed = log_mixture(np.concatenate(shifts), of_scales, hypotheses.off)
        shifts = np.split(mixed, np.cumsum([len(each) for each in shifts])[:-1])

    as_unknown = [one.of(residuals) for one in unknown]

    def over_scales(values: Sequence[Array]) -> Array:
        return np.asarray(logsumexp(np.array(values), axis=0) - np.log(len(values)))

    alone = over_scales([u.stated(r) for u, r in zip(unknown, as_unknown, strict=True)])
    beside: list[Array] = []
    if hypotheses.unknown and (alone < none - _NEGLIGIBLE).all():
        # Larger errors explain what an effect leaves even less than what nothing explains.
        beside = [np.full_like(of_shift, -np.inf) for of_shift in shifts]
    elif hypotheses.unknown:
        of_unknown = [
            one.each_shifted(hypotheses.shifts, r)
            for one, r in zip(unknown, as_unknown, strict=True)
        ]
        beside = [over_scales(each) for each in zip(*of_unknown, strict=True)]

    return PositionsEvidence(
        none=none,
        coefficients=np.asarray(together),
        unknown=alone,
        shifts=shifts,
        spreads=[stated.spread(spread, as_stated) for spread in hypotheses.spreads],
        beside=beside,
    )


def scores(posterior: PositionsEvidence, hypotheses: PositionsHypotheses) -> tuple[Array, Array]:
    """Return the evidence in nats that something is other than stated, and that a pair is noisy.

    Both (n_draws,). A noisy pair is no evidence of the first, which is against nothing or such a pair;
    that of the second is against nothing. Where nothing else is tried, the first is 0.
    """
    noisy = [np.full_like(posterior.none, -np.inf)]
    other, odds = [posterior.coefficients, posterior.unknown], 0.0
    for spread, weight in zip(hypotheses.spreads, posterior.spreads, strict=True):
        (noisy if spread.effect == NOISE else other).append(weight)
        odds += spread.odds if spread.effect == NOISE else 0.0
    both = (*posterior.shifts, *posterior.beside)
    other += [np.asarray(logsumexp(by_size, axis=0)) for by_size in both]
    of_pair = logsumexp(np.array(noisy), axis=0)
    nothing = np.logaddexp(posterior.none, of_pair)
    prior = np.logaddexp(posterior.none, hypotheses.log_prior(odds))  # of nothing
    score = np.zeros_like(prior)
    if (prior < -_TINY).all():
        score = logsumexp(np.array(other), axis=0) - nothing - np.log1p(-np.exp(prior)) + prior
    return np.asarray(score), np.asarray(of_pair - posterior.none)


def weights(
    evidence: PositionsEvidence, hypotheses: PositionsHypotheses, temper: float = TEMPER
) -> PositionsEvidence:
    """Return log posterior weights, the weight of "none" being its prior.

    Log evidences are divided by ``temper``.
    """
    off = max(hypotheses.off, 1e-300)

    def relative(values: Array) -> Array:
        return np.asarray((values - evidence.none) / temper)

    def of_shifts(values: Sequence[Array], share: float) -> list[Array]:
        return [
            hypotheses.log_prior(share * s.odds)[:, np.newaxis] + relative(e)
            for s, e in zip(hypotheses.shifts, values, strict=True)
        ]

    unexplained = hypotheses.unexplained

    return PositionsEvidence(
        none=np.full_like(evidence.none, np.log(NO_EFFECT * (1 - off))),
        coefficients=np.log(NO_EFFECT * off) + relative(evidence.coefficients),
        unknown=hypotheses.log_prior(hypotheses.unknown_odds) + relative(evidence.unknown),
        shifts=of_shifts(evidence.shifts, 1 - unexplained if evidence.beside else 1.0),
        spreads=[
            hypotheses.log_prior(s.odds) + relative(e)
            for s, e in zip(hypotheses.spreads, evidence.spreads, strict=True)
        ],
        beside=of_shifts(evidence.beside, unexplained) if evidence.beside else [],
    )


def gain(
    other: PositionsEvidence, evidence: PositionsEvidence, hypotheses: PositionsHypotheses
) -> Array:
    """Return the evidence in nats for another likelihood, whatever the room lacks, (n_draws,)."""
    more = weights(other, hypotheses).total - weights(evidence, hypotheses).total
    return np.asarray(more + (other.none - evidence.none) / TEMPER)


def either(
    evidence: PositionsEvidence, other: PositionsEvidence, share: float
) -> PositionsEvidence:
    """Return the evidence where a second likelihood holds with the probability ``share``."""
    mixed = partial(log_mixture, share=share)
    return PositionsEvidence(
        none=mixed(evidence.none, other.none),
        coefficients=mixed(evidence.coefficients, other.coefficients),
        unknown=mixed(evidence.unknown, other.unknown),
        shifts=[mixed(*both) for both in zip(evidence.shifts, other.shifts, strict=True)],
        spreads=[mixed(*both) for both in zip(evidence.spreads, other.spreads, strict=True)],
        beside=[mixed(*both) for both in zip(evidence.beside, other.beside, strict=True)],
    )


def with_families(
    posterior: PositionsEvidence, hypotheses: PositionsHypotheses, families: Mapping[str, float]
) -> PositionsEvidence:
    """Return weights times the probabilities of their families by means, to `MEANS_POWER`.

    A logarithmic pool of two opinions (Genest & Zidek 1986).
    """

    def factor(family: str) -> float:
        return MEANS_POWER * float(np.log(max(families.get(family, 0.0), LEAST_BY_MEANS)))

    by_shift = [factor(shift.family) for shift in hypotheses.shifts]
    return PositionsEvidence(
        none=posterior.none + factor(NONE),
        coefficients=posterior.coefficients + factor(COEFFICIENTS),
        unknown=posterior.unknown + factor(UNKNOWN),
        shifts=[w + f for w, f in zip(posterior.shifts, by_shift, strict=True)],
        spreads=[w + factor(MEASUREMENT) for w in posterior.spreads],
        beside=[w + f for w, f in zip(posterior.beside, by_shift, strict=False)],
    )


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


def summary_of(
    case: PositionsCase, hypotheses: PositionsHypotheses, posterior: PositionsEvidence
) -> Summary:
    """Return what the weights of a single set of residuals say."""
    total = float(posterior.total[0])
    names = list(case.faces)
    grouped: dict[tuple[str, int | None, str], list[tuple[ShiftHypothesis, Array]]] = {}
    chances = [np.exp(logs[:, 0] - total) for logs in posterior.shifts]
    beside = [np.exp(logs[:, 0] - total) for logs in posterior.beside]
    unexplained = float(np.exp(posterior.unknown[0] - total)) + sum(float(b.sum()) for b in beside)
    if beside:
        chances = [one + more for one, more in zip(chances, beside, strict=True)]
    for shift, of_shift in zip(hypotheses.shifts, chances, strict=True):
        key = (shift.effect, shift.surface, shift.place)
        grouped.setdefault(key, []).append((shift, of_shift))
    candidates = [_candidate(case, members) for members in grouped.values()]
    places: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for spread, log in zip(hypotheses.spreads, posterior.spreads, strict=True):
        chance = float(np.exp(log[0] - total))
        places.setdefault((spread.effect, spread.place), []).append(
            (chance, spread.size, spread.unit)
        )
    for (effect, place), members in places.items():
        candidates.append(_misplaced(effect, place, members))
    for effect, log in ((COEFFICIENTS, posterior.coefficients), (UNKNOWN, posterior.unknown)):
        chance = float(np.exp(log[0] - total))
        if chance > 0:
            candidates.append(Candidate(effect=effect, family=effect, probability=chance))
    candidates.sort(key=lambda c: -c.probability)
    probabilities = {NONE: float(np.exp(posterior.none[0] - total))}
    families = dict(probabilities)
    surfaces = dict.fromkeys(names, 0.0)
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
    """A hypothesis that some values err by more: their covariance grows by ``covariance``.

    ``rows`` are the values' numbers in the order (band, parameter, pair). ``place`` names the
    source, receiver or pair.
    """

    effect: str
    place: str
    size: float
    unit: str
    rows: NDArray[np.int64]
    covariance: Array
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
    log_determinant: float = field(init=False)
    _products: dict[str, Array] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        both = np.outer(self.used, self.used)
        kept = np.where(both, self.covariance, 0.0) + np.diag(np.where(self.used, 0.0, 1.0))
        factor = np.linalg.cholesky(kept)
        self.log_determinant = 2 * float(np.log(np.diag(factor)).sum())
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
        return self._log(residuals.square, 0.0)

    def shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        """Return the log density by hypothesis, (n_hypotheses, n_draws)."""
        if len(shift.weights) <= _AT_ONCE:
            return self._shifted(shift, residuals)
        parts = range(0, len(shift.weights), _AT_ONCE)
        return np.concatenate(
            [self._shifted(shift.some(slice(p, p + _AT_ONCE)), residuals) for p in parts]
        )

    def each_shifted(self, shifts: Sequence[ShiftHypothesis], residuals: Residuals) -> list[Array]:
        """Return `shifted` of each."""
        return [self.shifted(shift, residuals) for shift in shifts]

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
        inner = inner + np.eye(inner.shape[-1])
        factor = np.linalg.cholesky(inner)
        gained = np.linalg.solve(factor, turned)
        whole = whole - np.einsum("hkm,hkm->hm", gained, gained)
        more = 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return self._log(whole, more[:, np.newaxis])

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
        rows = spread.rows[self.used[spread.rows]]
        if not len(rows):
            return self.stated(residuals)
        kept = self.used[spread.rows]
        added = spread.covariance[np.ix_(kept, kept)]
        inside = self.inverse[np.ix_(rows, rows)]
        pulled = residuals.pull[rows]
        inner = np.eye(len(rows)) + added @ inside
        gained = np.einsum("rm,rm->m", pulled, np.linalg.solve(inner, added @ pulled))
        return self._log(residuals.square - gained, float(np.linalg.slogdet(inner)[1]))

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

    def _log(self, square: Array, more: Array | float) -> Array:
        """Return the log density of chi-squares by level, ``more`` added to the log determinant.

        (..., n_levels n_draws) to (..., n_draws), the mean over the levels. Normal up to the number of
        values; beyond it as if the errors were larger throughout, since few control runs say how large
        they are.
        """
        n = self.number
        excess = np.log(np.maximum(square / n, 1.0))
        fit = np.where(square <= n, square / 2, n / 2 * (1 + excess))
        log = -fit - (self.log_determinant + more) / 2
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
