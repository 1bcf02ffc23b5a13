"""Doubts: reasons for which a name is not claimed, though its probability would allow it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.trust import mid_frequency_time, schroeder_frequency
from rtcal.finder.case import Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.finding import Size
from rtcal.finder.means.evidence import evaluate
from rtcal.finder.means.features import Observed
from rtcal.finder.means.gap import GapCheck
from rtcal.finder.means.hypotheses import Hypotheses
from rtcal.finder.means.searched import Searched
from rtcal.finder.prior import NONE
from rtcal.support.types import Array

GROSS = np.log(2.0)
"""Change of ln T, a factor of two, beyond which a mistake in what is stated is the first suspicion."""
SHOWN = 4.6
"""Evidence in nats, odds of 100 to one, from which features other than T show an effect."""
SURPRISING = 1e-3
"""Probability of the residuals below which the best effect does not explain them."""


@dataclass(frozen=True)
class Doubt:
    """A reason against a claim, and what it speaks against.

    ``of`` is "size" or "fit" where it leaves the effect's family as probable as it is, else "effect".
    """

    words: str
    of: Literal["size", "fit", "effect"]


def end_of_range(name: str, size: Size | None) -> list[Doubt]:
    """Return a doubt where the data do not bound the size."""
    if size is None or not size.end:
        return []
    larger = "larger" if size.end == "least" else "smaller"
    words = f"{name}: {size.words}; the measurement does not tell it from any {larger} size"
    return [Doubt(words, "size")]


def too_large(case: Case, effect: Effect, parameters: Parameters) -> list[Doubt]:
    """Return a doubt where the effect needs more wall than a room has for it."""
    share = effect.wall_area(parameters) / case.room.total_area
    if share <= effect.largest_share:
        return []
    words = (
        f"{effect.name}: it would be {100 * share:.0f} % of all surfaces; at most "
        f"{100 * effect.largest_share:.0f} % is believed"
    )
    return [Doubt(words, "size")]


def unexplained(name: str, times: float, probability: float) -> list[Doubt]:
    """Return a doubt where the residuals are larger than all uncertainties allow."""
    if probability >= SURPRISING:
        return []
    words = (
        f"{name} is the best of the effects and does not explain the measurement: with it in the "
        f"model it is {times:.1f} times as far off as all uncertainties allow. Check volume, "
        "areas, coefficients, units and bands"
    )
    return [Doubt(words, "fit")]


def gap_against(name: str, gap: GapCheck) -> list[Doubt]:
    """Return a doubt where the gap grows, or where what alpha cannot fit contradicts the effect."""
    if gap.grows:
        words = (
            f"with {name} in the model the gap that alpha cannot close grows from {gap.before:.2f} to "
            f"{gap.after:.2f} JND"
        )
        return [Doubt(words, "effect")]
    if gap.contradicts:
        words = (
            f"decay shape, level and the other configurations speak against {name} "
            f"({gap.predictive:.1f} nats)"
        )
        return [Doubt(words, "effect")]
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


def decided_below_schroeder(searched: Searched, predicted: Hypotheses, name: str) -> list[Doubt]:
    """Return a doubt where the evidence for ``name`` comes from bands below Schroeder's frequency.

    ``predicted`` holds the hypotheses of that effect.
    """
    case, observed, nats = searched.case, searched.observed, searched.nats(name)
    low = below_schroeder(case)
    used = np.logical_and(observed.used, np.logical_not(low)[:, None, :])
    if not low.any() or (used == observed.used).all() or not used.any():
        return []
    kept = used[observed.used]
    part = replace(observed, used=used, covariance=observed.covariance[np.ix_(kept, kept)])
    error, off = searched.discrepancy, searched.evidence.prior_off
    table = evaluate(part, predicted, error, off).by_effect()
    rest = float(table[name] - table[NONE])
    if rest >= 0.5 * nats or rest >= DISTINCT_NATS:
        return []
    places = [bands.label(f) for f in case.room.centre_frequencies[low.any(0)]]
    words = (
        f"{name} rests on {', '.join(places)}, below Schroeder's frequency, where no field is diffuse: "
        f"without them its evidence is {rest:+.1f} nats instead of {nats:+.1f}"
    )
    return [Doubt(words, "effect")]


def gross(observed: Observed, predicted: Hypotheses, gap: GapCheck) -> list[Doubt]:
    """Return a doubt where T is twice or half the model's.

    None where decay shape, level and the other configurations show the effect by themselves: a noise
    floor may make T six times as long, and a wrong volume does not bend the decay.
    """
    change = float(np.nanmedian((observed.features - predicted.features[0])[:, 0]))
    if abs(change) <= GROSS or gap.predictive > SHOWN:
        return []
    words = (
        f"T is {np.exp(change):.2g} times the model's: look for a mistake in volume, areas, "
        "coefficients and units before any effect is believed"
    )
    return [Doubt(words, "effect")]
