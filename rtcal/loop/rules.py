"""The steps of a closed loop, and the rules for a band's next target.

All functions but `next_target` work with decay rates R = 1/T in 1/s. A rule takes, for one band, the
past targets, the simulated rates, the measured rate, and the lowest and highest target that the
equation can give. It returns the next target.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label, span
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.loop.matched import Matched
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

STATUSES = (
    "converged",
    "no measured T",
    "by modes",
    "too few modes",
    "unreachable",
    "not converging",
    "not confirmed",
)
"""Status of a band. Only a `LoopResult` has the last one: the loop itself has no confirmation."""

LEFT_ALONE = STATUSES[:4]
"""Statuses of bands of which the loop asks nothing more."""

MAX_DECIMALS = 12
"""Largest number of decimals of alpha that a program reads."""

CLOSE_TARGETS = np.log(1.1)
"""If log targets with and without a simulated T20 are closer, another simulation gains little: T is
then known within 10 %, two JND."""

STUCK_STEPS = 3
"""Steps with different coefficients and the same T20 after which T does not depend on alpha."""

_AT_LIMIT = 1e-9  # relative; rounding of a target that was set to the limit


def check_decimals(decimals: object) -> None:
    """Refuse a number of decimals that is not from 1 to 12; None is all of them."""
    if decimals is not None and checks.whole("decimals", decimals, 1) > MAX_DECIMALS:
        raise DataError(f"decimals = {decimals} is more than {MAX_DECIMALS}")


def band_goals(tolerance: float, noise: Array) -> Array:
    """Return the gap in JND at which a band is done, (n_bands,): the tolerance less the noise.

    The goal is at least half the tolerance, since no gap below a large noise can be shown. Unknown
    noise (NaN) counts as large. ``noise`` is the simulator's standard error in JND.
    """
    return np.fmax(tolerance - noise, tolerance / 2)


def band_statuses(
    gap: Array,
    goals: Array,
    target: Array,
    limits: tuple[Array, Array],
    blocked: NDArray[np.bool_],
    measured: NDArray[np.bool_],
) -> tuple[str, ...]:
    """Return the status of each band before a confirmation.

    Parameters
    ----------
    gap, goals : array (n_bands,)
        Gap of the best step and its goal in JND. NaN if no step has a T20.
    target : array (n_bands,)
        Target of the last step in s.
    limits : pair of arrays (n_bands,)
        Shortest and longest T in s that the equation can give.
    blocked : bool array (n_bands,)
        Whether more simulations cannot help for another reason.
    measured : bool array (n_bands,)
        Whether T was measured.
    """
    shortest, longest = limits
    at_limit = ((gap < 0) & (target >= longest * (1 - _AT_LIMIT))) | (
        (gap > 0) & (target <= shortest * (1 + _AT_LIMIT))
    )
    status = np.select(
        [~measured, np.abs(gap) <= goals, blocked | at_limit],
        ["no measured T", "converged", "unreachable"],
        "not converging",
    )
    return tuple(status.tolist())


def confirmed_statuses(
    status: tuple[str, ...], gap: Array, noise: Array, tolerance: float
) -> tuple[str, ...]:
    """Return the statuses after a simulation with fresh random numbers.

    A converged band is confirmed if the noise is within the tolerance, and the gap within tolerance
    plus noise. A larger noise would confirm any gap. Gap and noise, (n_bands,), are in JND.
    """
    kept = (noise <= tolerance) & (np.abs(gap) <= tolerance + noise)
    return tuple(
        "not confirmed" if before == "converged" and not within else before
        for before, within in zip(status, kept, strict=True)
    )


def stuck_bands(alpha: Array, simulated: Array) -> NDArray[np.bool_]:
    """Return whether T20 stayed the same in the last `STUCK_STEPS` steps although alpha changed.

    ``alpha`` (n_steps, n_materials, n_bands), ``simulated`` T20 (n_steps, n_bands); the result is
    (n_bands,).
    """
    if len(simulated) < STUCK_STEPS:
        return np.zeros(simulated.shape[1], dtype=bool)
    changed = (np.diff(alpha[-STUCK_STEPS:], axis=0) != 0).any(axis=1).all(axis=0)
    same = (np.diff(simulated[-STUCK_STEPS:], axis=0) == 0).all(axis=0)
    return np.asarray(changed & same)


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One simulation.

    Attributes
    ----------
    target : array (n_bands,)
        T in s that the equation was calibrated to, NaN without a measured T.
    alpha : array (n_materials, n_bands)
        Coefficients as simulated.
    simulated : array (n_bands,)
        Simulated T in s of what is matched, NaN if these coefficients give none.
    noise : array (n_bands,)
        Standard error of it in s; 0 if the simulator states none, NaN if it is unknown.
    heard : dict of parameter to array (n_bands,)
        Means of all parameters that are shown, as simulated, matched or not.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array
    heard: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("target", "alpha", "simulated", "noise"):
            values = read_only(checks.array(f"step: {name}", getattr(self, name)))
            object.__setattr__(self, name, values)
        n = self.target.shape
        shapes = {"simulated": self.simulated.shape, "noise": self.noise.shape}
        heard = {
            checks.text("step: a parameter of heard", parameter): checks.array(
                f"step: heard[{checks.shown(parameter)}]", values
            )
            for parameter, values in checks.mapped("step: heard", self.heard).items()
        }
        shapes |= {f"heard[{checks.shown(p)}]": values.shape for p, values in heard.items()}
        if len(n) != 1 or self.alpha.ndim != 2 or self.alpha.shape[1:] != n:
            raise DataError(
                f"step: target has shape {n} and alpha {self.alpha.shape}; they are (n_bands,) and "
                "(n_materials, n_bands)"
            )
        for name, shape in shapes.items():
            if shape != n:
                raise DataError(f"step: {name} has shape {shape}; that of target is {n}")
        object.__setattr__(self, "heard", heard)


def simulated_time(
    measurement: Measurement, frequencies: Array, matched: Matched, steps: Sequence[Step]
) -> Array:
    """Return the simulated T of what is matched in s, (n_bands,), NaN where some pair has none.

    Parameters
    ----------
    measurement : Measurement
    frequencies : array (n_bands,)
        The room's bands in Hz.
    matched : Matched
    steps : sequence of Step
        Earlier steps.

    Raises
    ------
    DataError
        For other bands, or a matched parameter that is missing. A measured band may lack it only if
        it has one in an earlier step, and some measured band has one now.
    """
    checks.instance("what was simulated", measurement, Measurement)
    if not np.array_equal(measurement.centre_frequencies, frequencies):
        raise DataError(
            f"what was simulated has {span(measurement.centre_frequencies)}; the room has "
            f"{span(frequencies)}"
        )
    for parameter in matched.shares:
        if parameter not in measurement.values:
            raise DataError(f"what was simulated has no {parameter_label(parameter)}")
    measured = np.isfinite(matched.wanted)
    missing = {
        parameter: np.isnan(measurement.values[parameter]) & measured & (share > 0)
        for parameter, share in matched.shares.items()
    }
    lost = np.any([absent.any(axis=0) for absent in missing.values()], axis=0)
    earlier = np.zeros(lost.shape, dtype=bool)
    for step in steps:
        earlier |= np.isfinite(step.simulated)
    refused = lost if lost[measured].all() else lost & ~earlier
    for parameter, absent in missing.items():
        for pair, k in np.argwhere(absent & refused)[:1].tolist():
            raise DataError(
                f"simulated {parameter_label(parameter)}[{' to '.join(measurement.pairs[pair])}, "
                f"{label(frequencies[k])}] is missing, but T was measured there"
            )
    return np.where(lost, np.nan, matched.combined(measurement.mean))


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
