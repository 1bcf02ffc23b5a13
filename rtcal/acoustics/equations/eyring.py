"""Eyring's equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations.base import LinearEquation, register
from rtcal.support.arguments import checked
from rtcal.support.types import Array

# At an exponent of about 36, 1 - exp(-a) rounds to 1 and the mean coefficient does not determine T.
# At 25 it determines T to 1e-6. No real room has such an exponent.
_LARGEST_EXPONENT = 25.0


@register
@dataclass(frozen=True)
class Eyring(LinearEquation):
    """Eyring's equation: a = -ln(1 - mean alpha) (Eyring 1930; Bellows & Katz 2025, Eqs. 3, 6).

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Eyring(speed_of_sound=343).reverberation_time(room).round(4))
    [0.5484]
    """

    name: ClassVar[str] = "Eyring"
    key: ClassVar[str] = "eyring"

    @property
    def largest_mean(self) -> float:
        """1 - exp(-25): above it, the mean coefficient determines T only to rounding."""
        return float(-np.expm1(-_LARGEST_EXPONENT))

    @checked
    def exponent(self, mean: Array) -> Array:
        """Return -ln(1 - mean alpha), infinite at 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.minimum(mean, 1.0)))

    @checked
    def inverse(self, exponent: Array) -> Array:
        """Return 1 - exp(-exponent); NaN above 25, where it would lose T to rounding."""
        with np.errstate(over="ignore"):
            mean = -np.expm1(-np.asarray(exponent, dtype=float))
        return np.asarray(np.where(np.asarray(exponent) > _LARGEST_EXPONENT, np.nan, mean))

    @checked
    def slope(self, mean: Array) -> Array:
        """Return 1 / (1 - mean alpha)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.minimum(mean, 1.0)))
