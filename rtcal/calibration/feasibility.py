"""What can be reached: checked analytically, before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.calibration.instance import Flags, Instance
from rtcal.errors import InfeasibleError
from rtcal.types import Array


@dataclass(frozen=True)
class Unreachable:
    """A band whose measured T no coefficients within the bounds give.

    ``target`` is the absorption area b in m² that T asks for (NaN where none would do),
    ``lowest`` and ``highest`` what the bounds allow, ``shortest`` and ``longest`` the T in s that
    would do.
    """

    configuration: int
    frequency: float
    reverberation_time: float
    target: float
    lowest: float
    highest: float
    shortest: float
    longest: float

    def __str__(self) -> str:
        asked = "more absorption than any" if np.isnan(self.target) else f"{self.target:.4g} m²"
        off = ""
        if self.target < self.lowest:
            off = f", {self.lowest - self.target:.4g} m² too little"
        elif self.target > self.highest:
            off = f", {self.target - self.highest:.4g} m² too much"
        return (
            f"T[{bands.label(self.frequency)}] = {self.reverberation_time:.4g} s is beyond reach: "
            f"it asks the surfaces for {asked}, the bounds allow {self.lowest:.4g} to "
            f"{self.highest:.4g} m²{off}; T from {self.shortest:.4g} to {self.longest:.4g} s would do"
        )


def reach(instance: Instance) -> tuple[Array, Array]:
    """Return the least and the most S'alpha in m² within the box, each (n_configurations, n_bands).

    Coefficients with sigma = 0 are counted where they are.
    """
    lower = np.where(instance.scale > 0, instance.lower, instance.centre)
    upper = np.where(instance.scale > 0, instance.upper, instance.centre)
    return instance.areas @ lower, instance.areas @ upper


def end_tolerance(instance: Instance) -> Array:
    """Return how near to an end b counts as that end, in m², (n_configurations, n_bands).

    In floats the areas' sum exceeds the rational sum half of the time, so equality would be luck.
    """
    upper = np.where(instance.scale > 0, instance.upper, instance.centre)
    n = instance.areas.shape[1]
    return np.asarray(16 * n * np.finfo(float).eps * (instance.areas @ np.abs(upper)))


def settle(
    instance: Instance,
    rooms: tuple[Room, ...],
    times: Array,
    equation: LinearEquation,
    unreachable: str,
) -> tuple[Instance, Flags, Flags, tuple[Unreachable, ...]]:
    """Check every exactly matched target and pin the bands that stand at an end.

    Parameters
    ----------
    instance : Instance
    rooms : tuple of Room
        One a configuration.
    times : array (n_configurations, n_bands)
        Measured T in s.
    equation : LinearEquation
    unreachable : {"raise", "nearest"}

    Returns
    -------
    instance : Instance
        Unreachable targets moved to the nearest end, and coefficients at an end pinned there.
    at_lower, at_upper : array (n_materials, n_bands) of bool
        Coefficients that an end forces to a bound.
    unreachable : tuple of Unreachable

    Raises
    ------
    InfeasibleError
        With ``unreachable="raise"``, naming every band that cannot be reached.
    """
    asked = np.isfinite(times)
    low, high = reach(instance)
    tolerance = end_tolerance(instance)
    ceiling = equation.largest_mean_alpha * instance.areas.sum(axis=1)[:, np.newaxis]
    top = np.minimum(high, ceiling)
    target = instance.target
    too_low = asked & (target < low - tolerance)
    too_high = asked & (np.isnan(target) | (target > top + tolerance))
    found = []
    for c, k in np.argwhere(too_low | too_high):
        longest, shortest = (equation.time(rooms[c], area)[k] for area in (low[c], top[c]))
        found.append(Unreachable(
            int(c), float(rooms[c].centre_frequencies[k]), float(times[c, k]), float(target[c, k]),
            float(low[c, k]), float(top[c, k]), float(shortest), float(longest),
        ))  # fmt: skip
    if found and unreachable == "raise":
        raise InfeasibleError("; ".join(str(u) for u in found))
    at_low = asked & (too_low | (np.abs(target - low) <= tolerance))
    at_high = asked & (too_high | (np.abs(target - top) <= tolerance)) & ~at_low
    target = np.where(at_low, low, np.where(at_high, top, target))
    at_high &= top >= high - tolerance  # an equation's own ceiling is no end of the box
    movable = instance.scale > 0
    present = instance.areas[:, :, np.newaxis] > 0
    at_lower = movable & np.any(at_low[:, np.newaxis, :] & present, axis=0)
    at_upper = movable & np.any(at_high[:, np.newaxis, :] & present, axis=0) & ~at_lower
    values = np.where(at_lower, instance.lower, instance.upper)
    return (
        _with_target(instance, target).pin(at_lower | at_upper, values),
        at_lower,
        at_upper,
        tuple(found),
    )


def _with_target(instance: Instance, target: Array) -> Instance:
    from dataclasses import replace

    return replace(instance, target=target)
