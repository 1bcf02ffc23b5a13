"""The weight of every hypothesis by its evidence, and whether something is other than stated.

The positions decide; means over them tell the family, too.

A noisy pair is no evidence that the room is other than stated. In rooms that lack nothing, one pair
often errs by more than is assumed, and the other pairs do not.

One effect in one place is weighed against another: a hypothesis at positions has a place, and no sets
are formed as on means (`rtcal.finder.means.set_posterior`).

Something that no effect explains is no rival of the effects: a room may lack both. Its larger error is
weighed alone and beside every effect, and is as probable in both ways, so that "unknown" has what is
left where no effect explains the measurement better than larger errors do. Taken as a rival only, it
won where the right surface explained most of what was measured and errors were larger than assumed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from scipy.special import logsumexp

from rtcal.acoustics.directions import facing
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import observable
from rtcal.acoustics.priors import NORMAL_90
from rtcal.finder.case import PARAMETERS, Case, Configuration, spread_where_unknown
from rtcal.finder.claim import most_probable_first, with_added
from rtcal.finder.effects import Effect
from rtcal.finder.finding import Candidate
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.search import find as find_by_means
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.evidence import (
    MEASUREMENT,
    NOISE,
    ODDS,
    Likelihoods,
    ShiftHypothesis,
    SpreadHypothesis,
)
from rtcal.finder.prior import COEFFICIENTS, NO_EFFECT, NONE, SCALES, UNKNOWN, log_mixture
from rtcal.support.errors import DataError
from rtcal.support.types import Array

TEMPER = 1.25
"""Divisor of log evidences: the mean square of a hypothesis' standardised projection in control rooms
(`python -m benchmarks.where_threshold`). It would be 1 if few control runs told their covariance
without error."""
TOLD_TEMPER = 2.0
"""Divisor of log evidences where effects and surfaces are told apart. Their probabilities are then as
often right as they say (`python -m benchmarks.where_temper`). The shifts of two surfaces differ by less
than the simulator errs by, in ways that control runs do not show."""
MEANS_POWER = 0.5
"""Power of the families' probabilities by means over positions, which are multiplied into those of the
positions (`python -m benchmarks.where_temper`). Both see the same T, so neither counts in full."""
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
exceeds it without level, and 1 with it (`python -m benchmarks.where_decides`)."""
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
