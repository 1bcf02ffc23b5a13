"""Kuttruff's equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations.base import LinearEquation, register
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, ModelError, of_bands
from rtcal.support.types import Array


@register
@dataclass(frozen=True)
class Kuttruff(LinearEquation):
    """Kuttruff's equation: a = a' (1 - gamma² a' / 2), a' = -ln(1 - mean alpha).

    gamma² is the relative variance of the free paths. The exponent peaks at a' = 1 / gamma², for
    gamma² = 0.4 at a mean coefficient of 0.918. The equation does not hold beyond the peak. A T
    shorter than at the peak is refused.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; from the room's air if it is not given.
    path_variance : float
        gamma², above 0 and at most 1; 0.4 suits rooms of usual proportions.

    References
    ----------
    H. Kuttruff, Room Acoustics, 5th ed. (2009), Eqs. 5.23 to 5.25.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Kuttruff(speed_of_sound=343).reverberation_time(room).round(4))
    [0.574]
    """

    path_variance: float = 0.4

    name: ClassVar[str] = "Kuttruff"
    key: ClassVar[str] = "kuttruff"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < checks.number("path_variance", self.path_variance) <= 1:
            raise DataError(f"path_variance = {self.path_variance:g} is not above 0 and at most 1")

    @property
    def largest_mean(self) -> float:
        """1 - exp(-1 / gamma²), where T is shortest."""
        return float(-np.expm1(-1 / self.path_variance))

    @checked
    def exponent(self, mean: Array) -> Array:
        """Return a' (1 - gamma² a' / 2); ModelError beyond the peak, where it does not hold."""
        beyond = np.atleast_1d(mean) > self.largest_mean * (1 + 1e-12)
        if beyond.any():
            error = ModelError(
                f"a mean absorption coefficient of {np.max(mean):.3f} is beyond "
                f"{self.largest_mean:.3f}, up to which Kuttruff's equation holds"
            )
            raise of_bands(error, np.flatnonzero(beyond.reshape(-1, beyond.shape[-1]).any(axis=0)))
        eyring = -np.log1p(-np.asarray(mean, dtype=float))
        return np.asarray(eyring * (1 - self.path_variance * eyring / 2))

    @checked
    def inverse(self, exponent: Array) -> Array:
        """Return the mean coefficient below the peak; NaN for an exponent above the peak's."""
        # The quotient keeps the digits of small exponents. Up to 1e-14 is rounding at the peak.
        inside = 1 - 2 * self.path_variance * np.asarray(exponent, dtype=float)
        inside = np.where(inside < 0, np.where(inside > -1e-14, 0.0, np.nan), inside)
        eyring = 2 * np.asarray(exponent, dtype=float) / (1 + np.sqrt(inside))
        return np.asarray(-np.expm1(-eyring))

    @checked
    def slope(self, mean: Array) -> Array:
        """Return (1 - gamma² a') / (1 - mean alpha), 0 at the peak."""
        eyring = -np.log1p(-np.asarray(mean, dtype=float))
        return np.asarray((1 - self.path_variance * eyring) / (1 - np.asarray(mean)))
