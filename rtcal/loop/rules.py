"""Rules for a band's next target, which the loop moves until the simulator has the measured T.

All functions but `next_target` work with decay rates R = 1/T in 1/s. A rule takes, for one band, the
past targets, the simulated rates, the measured rate, and the lowest and highest target that the
equation can give. It returns the next target.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.loop.steps import Step
from rtcal.support.types import Array

_FROM_BOUNDS = (
    1e-3  # share of the range of S'alpha; at the bounds T may be 0, or infinite without air
)
_BELOW_LARGEST_MEAN = 0.999  # of the mean coefficient at which the equation ends


def target_limits(room: Room, equation: LinearEquation) -> tuple[Array, Array]:
    """Return the shortest and the longest T in s that the equation can give within the bounds."""
    floor = np.zeros(room.alpha.shape) if room.alpha_min is None else room.alpha_min
    fixed = room.sigma == 0
    least = room.areas @ np.where(fixed, room.alpha, floor)
    most = room.areas @ np.where(fixed, room.alpha, 1.0)
    margin = _FROM_BOUNDS * (most - least)
    high = np.minimum(most - margin, _BELOW_LARGEST_MEAN * equation.largest_mean * room.total_area)
    return equation.time(room, high), equation.time(room, least + margin)


def target_without_t20(steps: Sequence[Step], wanted: Array, best_target: Array) -> Array:
    """Return the target without a simulated T20 that is nearest to the best one, (n_bands,).

    NaN for a band with a T20 in every step or in none.
    """
    targets = np.array([step.target for step in steps])
    simulated = np.array([np.isfinite(gap_jnd(step.simulated, wanted)) for step in steps])
    missing = ~simulated & np.isfinite(wanted)
    distance = np.where(missing, np.abs(np.log(targets / best_target)), np.inf)
    nearest = targets[np.argmin(distance, axis=0), np.arange(len(wanted))]
    both = missing.any(axis=0) & simulated.any(axis=0)
    return np.asarray(np.where(both, nearest, np.nan))


def next_targets(
    rule: str,
    steps: Sequence[Step],
    wanted: Array,
    best_target: Array,
    moving: NDArray[np.bool_],
    limits: tuple[Array, Array],
    prior_time: Array,
) -> Array:
    """Return the next target T in s, (n_bands,): the best one for bands that do not move.

    A band without any T20 so far takes the equation's T for the prior, ``prior_time``. A target
    goes at most halfway towards one without a T20.
    """
    target = best_target.copy()
    without_t20 = target_without_t20(steps, wanted, best_target)
    for k in np.flatnonzero(moving):
        shortest, longest = limits[0][k], limits[1][k]
        with_t20 = [step for step in steps if np.isfinite(step.simulated[k])]
        if not with_t20:
            target[k] = np.clip(prior_time[k], shortest, longest)
            continue
        proposed = next_target(
            rule,
            np.array([step.target[k] for step in with_t20]),
            np.array([step.simulated[k] for step in with_t20]),
            wanted[k],
            shortest,
            longest,
        )
        halfway = np.sqrt(target[k] * without_t20[k])
        # Without such a target, NaN makes the comparison False and the proposal stands.
        beyond = (proposed - halfway) * (without_t20[k] - target[k]) > 0
        target[k] = halfway if beyond else proposed
    return target


Rule = Literal["secant", "safeguarded", "regression"]

# Limits of d log(rate) / d log(target). The slope is 1 if the simulator is proportional to the
# equation, and about 0.5 in halls with concentrated absorption (docs/closed_loop.md). Other slopes are
# mostly noise of two close points. Over 60 random shoeboxes with Fitzroy's, Arau-Puchades' and
# Millington's equations as simulators, 98 % of the slopes are 0.82 to 9.6. Limits twice as wide, and no
# limits, give the same mean number of simulations: 2.75 (safeguarded) and 3.22 (regression). Limits of
# 0.6 to 1.5 give 2.58 and 3.15, but 0.6 is above the slopes of those halls.
_SLOPES = (0.3, 3.0)
# Standard deviations in the regression. 0.3 around a slope of 1 has both slopes above within two; with
# 0.15 and 0.6 the same study needs 3.23 and 3.22 simulations. 3 % is the noise of T20 with about 1000
# paths, from 1 % with 8000 (docs/path_tracing.md).
_SLOPE_SD = 0.3
_RATE_SD = 0.03
_LARGEST_STEP = np.log(2.0)


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


def regression(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return the next target by a ridge regression of log rate on log target over all points.

    The prior of the slope is normal with mean 1 and standard deviation 0.3; the rates have a
    standard deviation of 3 %. A step changes the target by a factor of 2 at most.
    """
    u, v = np.log(targets), np.log(rates)
    du, dv = u - u.mean(), v - v.mean()
    prior, data = 1 / _SLOPE_SD**2, 1 / _RATE_SD**2
    slope = (prior + data * float(du @ dv)) / (prior + data * float(du @ du))
    step = u.mean() + (np.log(wanted) - v.mean()) / float(np.clip(slope, *_SLOPES))
    return float(np.exp(np.clip(step, u[-1] - _LARGEST_STEP, u[-1] + _LARGEST_STEP)))


RULES: dict[str, Callable[[Array, Array, float, float, float], float]] = {
    "secant": secant,
    "safeguarded": safeguarded,
    "regression": regression,
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
