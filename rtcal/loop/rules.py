"""Where to aim next: rules that move a target rate until the simulator's rate is the measured one.

R = 1/T in 1/s. A rule is given, for one band, the targets aimed at so far, the rates that the
simulator had for them, the wanted rate, and the range of targets that the equation can give.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from rtcal.support.types import Array

Rule = Literal["secant", "safeguarded", "regression"]
_SLOPES = (0.3, 3.0)  # of log rate over log target: beyond, two points lie too close to tell
_PRIOR_SPREAD = 0.3  # of the regression's slope about 1
_LONGEST_STEP = np.log(2.0)


def secant(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target of Bellows & Katz 2025, Eqs. 38 to 40, as they stand.

    May leave the range that the equation can give, and turn negative.
    """
    if len(targets) == 1:
        return float(2 * wanted - rates[-1])
    rise = rates[-1] - rates[-2]
    if rise == 0:
        return float(targets[-1])
    return float(targets[-1] - (rates[-1] - wanted) * (targets[-1] - targets[-2]) / rise)


def safeguarded(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target of a log-log secant: first slope 1, slope clamped, kept in its bracket.

    A step that leaves the bracket of what was too low and too high is halved into it.
    """
    u, v, w = np.log(targets), np.log(rates), np.log(wanted)
    slope = 1.0
    if len(u) > 1 and u[-1] != u[-2]:
        slope = float(np.clip((v[-1] - v[-2]) / (u[-1] - u[-2]), *_SLOPES))
    step = float(u[-1] + (w - v[-1]) / slope)
    below = float(np.max(u[v < w], initial=np.log(low)))
    above = float(np.min(u[v > w], initial=np.log(high)))
    if below < above and not below < step < above:
        at_end = (step <= below == np.log(low)) or (step >= above == np.log(high))
        step = min(max(step, below), above) if at_end else (below + above) / 2
    return float(np.exp(step))


def regression(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target of a ridge regression of log rate on log target over all points.

    The slope's prior is normal(1, 0.3²), the rates' noise 3 %; a step is a factor 2 at most.
    """
    u, v = np.log(targets), np.log(rates)
    du, dv = u - u.mean(), v - v.mean()
    prior, data = 1 / _PRIOR_SPREAD**2, 1 / 0.03**2
    slope = (prior + data * float(du @ dv)) / (prior + data * float(du @ du))
    step = u.mean() + (np.log(wanted) - v.mean()) / float(np.clip(slope, *_SLOPES))
    return float(np.exp(np.clip(step, u[-1] - _LONGEST_STEP, u[-1] + _LONGEST_STEP)))


RULES: dict[str, Callable[[Array, Array, float, float, float], float]] = {
    "secant": secant,
    "safeguarded": safeguarded,
    "regression": regression,
}
