"""The gap where alpha cannot close it, the doubts that follow, and what would decide.

Plain calibration meets T20 of the first configuration whatever the model lacks. What is left of the
other features is what alpha cannot absorb. The linear model of `evidence` gives it without a QP;
`verify` gives it with one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from rtcal.acoustics import bands
from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.observables import observable
from rtcal.finder.case import Case
from rtcal.finder.claim import CLAIMED, DISTINCT_NATS
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.finding import Size
from rtcal.finder.means.evidence import MeansEvidence, evaluate
from rtcal.finder.means.hypotheses import MeansHypotheses
from rtcal.finder.means.likelihood import (
    Factorization,
    MeansProblem,
    alpha_covariance,
    log_densities,
    log_density,
)
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import COEFFICIENTS, UNKNOWN
from rtcal.support.types import Array

GROSS = np.log(1.8)
"""Change of ln T beyond which a mistake in what is stated is the first suspicion. A box that is entered
twice as large has twice the T, or a little less with air."""
MISTAKE = 1.5
"""Standard deviation of ln T by a mistake in what is stated: factors of 2 to 20 are usual."""
SHOWN = 4.6
"""Evidence in nats, odds of 100 to one, from which features other than T show an effect."""
SURPRISING = 1e-3
"""Probability of the residuals below which the best effect does not explain them."""


@dataclass(frozen=True)
class Objection:
    """A reason against a claim, and what it speaks against.

    ``of`` is "size", "fit" or "stated" where it leaves the effect's family as probable as it is, else
    "effect". "stated" doubts what the model states, and is said before the claim. A ``mistake`` is that
    T is far off, whatever of the claim is left.
    """

    words: str
    of: Literal["size", "fit", "stated", "effect"]
    mistake: bool = False


def mistake_in(found: Sequence[Objection]) -> str:
    """Return the doubt that T is far off, in words; "" without one."""
    return next((doubt.words for doubt in found if doubt.mistake), "")


def end_of_range(name: str, size: Size | None) -> list[Objection]:
    """Return a doubt where the data do not bound the size."""
    if size is None or not size.end:
        return []
    larger = "larger" if size.end == "least" else "smaller"
    words = f"{name}: {size.words}; the measurement does not tell it from any {larger} size"
    return [Objection(words, "size")]


def too_large(case: Case, effect: Effect, parameters: Parameters) -> list[Objection]:
    """Return a doubt where the effect needs more wall than a room has for it."""
    share = effect.wall_area(parameters) / case.room.total_area
    if share <= effect.largest_share:
        return []
    words = (
        f"{effect.name}: it would be {100 * share:.0f} % of all surfaces; at most "
        f"{100 * effect.largest_share:.0f} % is believed"
    )
    return [Objection(words, "size")]


def unexplained(name: str, times: float, probability: float) -> list[Objection]:
    """Return a doubt where the residuals are larger than all uncertainties allow."""
    if probability >= SURPRISING:
        return []
    words = (
        f"{name} is the best of the effects and does not explain the measurement: with it in the "
        f"model it is {times:.1f} times as far off as all uncertainties allow. Check volume, "
        "areas, coefficients, units and bands"
    )
    return [Objection(words, "fit")]


def gap_against(name: str, gap: GapCheck) -> list[Objection]:
    """Return a doubt where the gap grows, or where what alpha cannot fit contradicts the effect."""
    ends = f"from {gap.before:.2f} to {gap.after:.2f} JND"
    if gap.grows:
        words = f"with {name} in the model the gap that alpha cannot close grows {ends}"
        return [Objection(words, "effect")]
    if gap.contradicts:
        words = (
            f"decay shape, level and the other configurations speak against {name} "
            f"({gap.predictive:.1f} nats)"
        )
        return [Objection(words, "effect")]
    if gap.growth >= 0.5:
        words = (
            f"with {name} in the model the gap that alpha cannot close may grow, {ends}: by more than "
            f"{LITTLE:g} JND with a probability of {100 * gap.growth:.0f} %"
        )
        return [Objection(words, "fit")]
    return []


def below_schroeder(case: Case) -> Array:
    """Return which bands lie below Schroeder's frequency, (n_configurations, n_bands)."""
    out = []
    for c in case.configurations:
        limit = schroeder_limit(case, c.measured.decay_time().mean)
        out.append(case.room.centre_frequencies < limit)
    return np.array(out)


def schroeder_limit(case: Case, times: Array) -> float:
    """Return Schroeder's frequency in Hz for a configuration's T."""
    middle = mid_frequency_time(times, case.room.centre_frequencies)
    return float(schroeder_frequency(np.array(middle), case.room.volume))


def decided_below_schroeder(
    evidence: MeansEvidence, predicted: MeansHypotheses, name: str
) -> list[Objection]:
    """Return a doubt where the evidence for ``name`` comes from bands below Schroeder's frequency.

    ``predicted`` holds the hypotheses of that effect.
    """
    problem, nats = evidence.problem, evidence.nats(name)
    case, observed = problem.case, problem.observed
    low = below_schroeder(case)
    used = np.logical_and(observed.used, np.logical_not(low)[:, None, :])
    if not low.any() or (used == observed.used).all() or not used.any():
        return []
    kept = used[observed.used]
    part = replace(observed, used=used, covariance=observed.covariance[np.ix_(kept, kept)])
    above = replace(problem, observed=part, predicted=predicted)
    rest = evaluate(above, evidence.prior_off).nats(name)
    if rest >= 0.5 * nats or rest >= DISTINCT_NATS:
        return []
    places = bands.labels(case.room.centre_frequencies[low.any(0)])
    words = (
        f"{name} rests on {', '.join(places)}, below Schroeder's frequency, where no field is diffuse: "
        f"without them its evidence is {rest:+.1f} nats instead of {nats:+.1f}"
    )
    return [Objection(words, "effect")]


def gross(evidence: MeansEvidence, name: str, gap: GapCheck) -> list[Objection]:
    """Return a doubt where T is about twice or half the model's.

    It leaves the effect's family claimed where the effect explains the data better than a factor that
    is alike in all bands, as most mistakes in what is stated are. None where the effect explains them
    better than other units of T do, and decay shape, level and the other configurations show it by
    themselves: a noise floor may make T six times as long, and a wrong volume does not bend the decay.
    """
    problem = evidence.problem
    off = problem.observed.features - problem.predicted.features[0]
    change = float(np.nanmedian(off[:, 0]))
    if abs(change) <= GROSS:
        return []
    of_units, of_room = evidence_of_factors(problem)
    best = float(evidence.by_effect()[name])
    if gap.predictive > SHOWN and best - of_units > DISTINCT_NATS:
        return []
    words = f"T is {np.exp(change):.2g} times the model's: look for a mistake in volume, areas, "
    if best - max(of_units, of_room) > DISTINCT_NATS:
        return [Objection(f"{words}coefficients and units first", "stated", mistake=True)]
    words = f"{words}coefficients and units before any effect is believed"
    return [Objection(words, "effect", mistake=True)]


def evidence_of_factors(problem: MeansProblem) -> tuple[float, float]:
    """Return the log evidence of a factor alike in all bands, in nats: of times, and of all features.

    The first is a mistake in the units of T. The second is one in volume, areas or coefficients, and
    the other features follow T.
    """
    _, f, _ = problem.places
    alpha, other = problem.covariance_of(0)
    directions = np.array([f == 0, problem.slopes[0]], dtype=float)
    more = MISTAKE**2 * np.einsum("di,dj->dij", directions, directions)
    rows = np.broadcast_to(problem.residual(0), (2, 1, len(f)))
    factorization = Factorization(alpha + other + more)
    ((densities, _),) = log_densities(factorization, rows, 1, [len(f)])
    of_units, of_room = densities[:, 0].tolist()
    return of_units, of_room


LITTLE = 0.1
"""Change of the mean gap in JND that is little, whatever its uncertainty."""
CONTRADICTED = -3.0
"""Evidence in nats under which the features that alpha cannot fit contradict the effect."""
_DRAWS = 64


@dataclass(frozen=True)
class GapCheck:
    """Mean absolute gap in JND over what alpha cannot absorb; NaN where nothing of it was measured.

    ``uncertainty`` is the standard deviation of ``after - before`` by measurement and model error,
    ``predictive`` the evidence of the effect over "none" in those features, given the fitted T20.
    """

    before: float
    after: float
    uncertainty: float
    predictive: float

    @property
    def shrinks(self) -> bool:
        """Whether the gap shrinks by more than its uncertainty, and the prediction gets better."""
        return self.before - self.after > self.uncertainty and self.predictive > 0

    @property
    def growth(self) -> float:
        """Probability that the gap grows by more than a little; 0 where nothing was measured of it."""
        grown = self.after - self.before - LITTLE
        if not self.uncertainty > 0:
            return float(grown > 0)
        return float(ndtr(grown / self.uncertainty))

    @property
    def grows(self) -> bool:
        """Whether the gap grows by more than a little, as surely as a claim must be."""
        return self.growth >= CLAIMED

    @property
    def contradicts(self) -> bool:
        """Whether what alpha cannot fit contradicts the effect."""
        return self.predictive < CONTRADICTED


def gap_check(
    problem: MeansProblem, i: int, scale: float, held: NDArray[np.bool_] | None = None
) -> GapCheck:
    """Return the gap under "none" and under hypothesis ``i``.

    With a ``scale`` other than 1, hypothesis ``i`` has coefficients that are off together. ``held``
    (n_used,) are the features that count, by default all that alpha cannot fit; the evidence is of
    these, given the others.
    """
    c, f, _ = problem.places
    fitted = (c == 0) & (f == 0)
    held = ~fitted if held is None else held
    if not held.any():
        return GapCheck(np.nan, np.nan, np.nan, 0.0)
    jnd = np.array([observable(name).jnd for name in FEATURES])[f[held]]
    kept = np.flatnonzero(~held)
    gaps, moves, density = [], [], []
    for row, factor, exact in ((0, 1.0, True), (i, scale, False)):
        alpha, other = problem.covariance_of(row, factor)
        whole = alpha + other
        against = alpha if exact else whole
        gain = np.linalg.solve(
            _plus(against[np.ix_(fitted, fitted)]), alpha[np.ix_(fitted, held)]
        ).T
        residual = problem.residual(row)
        gaps.append((residual[held] - gain @ residual[fitted]) / jnd)
        moves.append(np.concatenate([-gain, np.eye(int(held.sum()))], axis=1) / jnd[:, None])
        density.append(
            log_density(residual, whole) - log_density(residual[kept], whole[np.ix_(kept, kept)])
        )
        noise = other
    order = np.concatenate([np.flatnonzero(fitted), np.flatnonzero(held)])
    root = np.linalg.cholesky(_plus(noise[np.ix_(order, order)]))
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, len(order))) @ root.T
    before, after = (np.abs(g + drawn @ m.T).mean(1) for g, m in zip(gaps, moves, strict=True))
    return GapCheck(
        float(np.abs(gaps[0]).mean()),
        float(np.abs(gaps[1]).mean()),
        float(np.std(after - before)),
        float(density[1] - density[0]),
    )


def _plus(covariance: Array) -> Array:
    """Return the matrix with a trace on its diagonal, so that it can be inverted where sigma is 0."""
    size = len(covariance)
    return np.asarray(covariance + 1e-9 * (1.0 + np.trace(covariance) / size) * np.eye(size))


USUAL = np.array([0.015, 0.03, 0.02, 0.5, 0.5])
"""Standard uncertainty of a mean over four positions that is not measured yet, by feature."""


def separation(
    predicted: MeansHypotheses, covariance: Array, mask: Array, first: int, second: str
) -> float:
    """Return the expected evidence in nats against effect ``second`` if ``first`` is true.

    It is ½ min d' C⁻¹ d over the parameters of ``second``, with the masked features.
    """
    rows = [i for i, n in enumerate(predicted.names) if n == second]
    inverse = np.linalg.inv(covariance[np.ix_(mask, mask)])
    d = predicted.features[rows].reshape(len(rows), -1)[:, mask]
    d = d - predicted.features[first].ravel()[mask]
    return float(0.5 * np.einsum("ni,ij,nj->n", d, inverse, d).min())


def covariance_of_all(problem: MeansProblem, i: int) -> Array:
    """Return the covariance of all features under hypothesis ``i``, also of those not measured."""
    observed = problem.observed
    variances = np.broadcast_to(USUAL[None, :, None] ** 2, observed.used.shape).copy()
    variances[observed.used] = np.diag(observed.covariance)
    of_alpha = alpha_covariance(problem.predicted, i)
    return np.asarray(of_alpha + problem.discrepancy.covariance + np.diag(variances.ravel()))


def with_features(used: Array, features: Sequence[str]) -> Array:
    """Return which features are in use, (n_configurations, n_features, n_bands), with further ones."""
    more = used.copy()
    more[:, [FEATURES.index(f) for f in features]] = True
    return more


_PARAMETERS = {"EDT and T30": ("edt", "t30"), "C80": ("c80",), "G": ("g",)}


def _in_words(kind: str) -> str:
    return "G, with a calibrated source" if kind == "G" else kind


NO_STEP = "none: these data do not show that anything is missing"
"""The advice where the data do not say enough to call something missing."""


def next_measurement(evidence: MeansEvidence, candidates: Sequence[str]) -> str:
    """Return the measurement that would decide between the candidates."""
    problem, predicted = evidence.problem, evidence.problem.predicted
    named = [c for c in candidates if c not in (UNKNOWN, COEFFICIENTS)]
    if candidates and candidates[0] == COEFFICIENTS:
        return (
            "look for another source of the coefficients, first for the material with the largest "
            "product of area and sigma; or measure with and without a known absorber"
        )
    if not named:
        return (
            "these data leave nothing to tell apart. That does not confirm the model"
            if not candidates
            else "see in the residuals which band and parameter disagree, and measure these again"
        )
    best = named[0]
    removed = any(c.suspect_removed for c in problem.case.configurations)
    rows = evidence.rows[best]
    first = int(rows[np.argmax(evidence.by_hypothesis()[rows])])
    if len(named) == 1:
        if not predicted.effects[best].removable:
            return f"confirm it where it can be looked up or measured by itself ({best})"
        if removed:
            return f"nothing more to confirm it: it was measured with and without it ({best})"
        return f"confirm it: measure once without it ({best})"
    rival = named[1]
    used = problem.observed.used
    covariance = covariance_of_all(problem, first)
    now = separation(predicted, covariance, used.ravel(), first, rival)
    options = []
    for kind, features in _PARAMETERS.items():
        more = with_features(used, features)
        if more.sum() > used.sum():
            nats = separation(predicted, covariance, more.ravel(), first, rival)
            options.append((nats, _in_words(kind)))
    removable = {n: predicted.effects[n].removable and not removed for n in (best, rival)}
    if len(set(removable.values())) == 2:
        suspect = best if removable[best] else rival
        return (
            f"measure with and without one of them ({suspect}). If it is that, T changes, and the "
            "uncertainty of alpha cancels in the difference"
        )
    if options and max(options)[0] > now + 1:
        gain, label = max(options)
        return (
            f"measure {label}: with it {best} and {rival} would differ by {gain:.1f} nats instead of "
            f"{now:.1f}"
        )
    if all(removable.values()):
        return (
            f"measure once without each of these, one at a time: {best}, {rival}. The uncertainty of "
            "alpha cancels in the difference"
        )
    return (
        f"look at the room: {best} and {rival} predict the same in every parameter, and one of them "
        "can be seen, or measured with a rule"
    )
