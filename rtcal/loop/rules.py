"""The rules for a band's next target in the closed loop.

`secant` and `safeguarded` work with decay rates R = 1/T in 1/s. A rule takes, for one band, the past
targets, the simulated rates, the measured rate, and the lowest and highest target that the equation can
give. It returns the next target.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from rtcal.support.types import Array

Rule = Literal["secant", "safeguarded"]

# Limits of d log(rate) / d log(target). The slope is 1 if the simulator is proportional to the
# equation, and about 0.5 in halls with concentrated absorption (docs/closed_loop.md). Other slopes are
# mostly noise of two close points. Over 60 random shoeboxes with Fitzroy's, Arau-Puchades' and
# Millington's equations as simulators, 98 % of the slopes are 0.82 to 9.6. Limits twice as wide, and no
# limits, give the same mean number of simulations, 2.75. Limits of 0.6 to 1.5 give 2.58, but 0.6 is
# above the slopes of those halls.
_SLOPES = (0.3, 3.0)


def secant(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target by the secant through the last two points.

    It may leave the range of the equation, and may be negative.

    References
    ----------
    Bellows & Katz 2025, Eqs. 38 to 40.
    """
    if len(targets) == 1:
        return float(2 * wanted - rates[-1])
    rise = rates[-1] - rates[-2]
    if rise == 0:
        return float(targets[-1])
    return float(targets[-1] - (rates[-1] - wanted) * (targets[-1] - targets[-2]) / rise)


def safeguarded(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target by a secant in logarithms, kept within its bracket.

    The first slope is 1, later slopes are clipped. The bracket lies between the highest target
    whose rate was too low and the lowest whose rate was too high. A step that leaves the bracket
    goes to its middle, or to the end of the range of the equation.
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


RULES: dict[str, Callable[[Array, Array, float, float, float], float]] = {
    "secant": secant,
    "safeguarded": safeguarded,
}


def next_target(
    rule: str, targets: Array, times: Array, wanted: float, shortest: float, longest: float
) -> float:
    """Return the next target T in s of a band, within the range of the equation.

    Parameters
    ----------
    rule : str
        A key of `RULES`.
    targets, times : array (n_steps,)
        Targets so far, and the simulated T for them, in s.
    wanted : float
        Measured T in s.
    shortest, longest : float
        Range of T in s that the equation can give.
    """
    rate = RULES[rule](1 / targets, 1 / times, 1 / wanted, 1 / longest, 1 / shortest)
    if rate <= 0:  # the secant rule has no valid target: keep the last one
        rate = 1 / float(targets[-1])
    return float(np.clip(1 / rate, shortest, longest))
