"""The gap where alpha cannot close it, with and without the effect, and the doubts that follow.

Plain calibration meets T20 of the first configuration whatever the model lacks. What is left of the
other features is what alpha cannot absorb. The linear model of `evidence` gives it without a QP;
`verify` gives it with one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.observables import observable
from rtcal.finder.candidate import Size
from rtcal.finder.case import Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.means.evidence import MeansEvidence, evaluate
from rtcal.finder.means.hypotheses import MeansHypotheses
from rtcal.finder.means.likelihood import MeansProblem, log_density
from rtcal.finder.model import FEATURES
from rtcal.support.types import Array

GROSS = np.log(2.0)
"""Change of ln T, a factor of two, beyond which a mistake in what is stated is the first suspicion."""
SHOWN = 4.6
"""Evidence in nats, odds of 100 to one, from which features other than T show an effect."""
SURPRISING = 1e-3
"""Probability of the residuals below which the best effect does not explain them."""


@dataclass(frozen=True)
class Objection:
    """A reason against a claim, and what it speaks against.

    ``of`` is "size" or "fit" where it leaves the effect's family as probable as it is, else "effect".
    """

    words: str
    of: Literal["size", "fit", "effect"]


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
    if gap.grows:
        words = (
            f"with {name} in the model the gap that alpha cannot close grows from {gap.before:.2f} to "
            f"{gap.after:.2f} JND"
        )
        return [Objection(words, "effect")]
    if gap.contradicts:
        words = (
            f"decay shape, level and the other configurations speak against {name} "
            f"({gap.predictive:.1f} nats)"
        )
        return [Objection(words, "effect")]
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


def gross(problem: MeansProblem, gap: GapCheck) -> list[Objection]:
    """Return a doubt where T is twice or half the model's.

    None where decay shape, level and the other configurations show the effect by themselves: a noise
    floor may make T six times as long, and a wrong volume does not bend the decay.
    """
    off = problem.observed.features - problem.predicted.features[0]
    change = float(np.nanmedian(off[:, 0]))
    if abs(change) <= GROSS or gap.predictive > SHOWN:
        return []
    words = (
        f"T is {np.exp(change):.2g} times the model's: look for a mistake in volume, areas, "
        "coefficients and units before any effect is believed"
    )
    return [Objection(words, "effect")]


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
    def grows(self) -> bool:
        """Whether the gap grows by more than its uncertainty and more than a little."""
        return self.after - self.before > max(LITTLE, self.uncertainty)

    @property
    def contradicts(self) -> bool:
        """Whether what alpha cannot fit contradicts the effect."""
        return self.predictive < CONTRADICTED


def gap_check(problem: MeansProblem, i: int, scale: float) -> GapCheck:
    """Return the gap under "none" and under hypothesis ``i``.

    With a ``scale`` other than 1, hypothesis ``i`` has coefficients that are off together.
    """
    c, f, _ = problem.places
    fitted = (c == 0) & (f == 0)
    if fitted.all():
        return GapCheck(np.nan, np.nan, np.nan, 0.0)
    jnd = np.array([observable(name).jnd for name in FEATURES])[f[~fitted]]
    gaps, moves, density = [], [], []
    for row, factor, exact in ((0, 1.0, True), (i, scale, False)):
        alpha, other = problem.covariance_of(row, factor)
        whole = alpha + other
        against = alpha if exact else whole
        gain = np.linalg.solve(
            _plus(against[np.ix_(fitted, fitted)]), alpha[np.ix_(fitted, ~fitted)]
        ).T
        residual = problem.residual(row)
        gaps.append((residual[~fitted] - gain @ residual[fitted]) / jnd)
        moves.append(np.concatenate([-gain, np.eye(int((~fitted).sum()))], axis=1) / jnd[:, None])
        kept = np.flatnonzero(fitted)
        density.append(
            log_density(residual, whole) - log_density(residual[kept], whole[np.ix_(kept, kept)])
        )
        noise = other
    order = np.concatenate([np.flatnonzero(fitted), np.flatnonzero(~fitted)])
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
