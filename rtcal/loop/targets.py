"""The targets of a closed loop: the range of the equation's T, and each band's next target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.loop.rules import next_target
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
