"""Millington and Sette's equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations.base import LinearEquation, MeanEquation, register
from rtcal.acoustics.equations.eyring import Eyring
from rtcal.support.arguments import checked
from rtcal.support.types import Array


@register
@dataclass(frozen=True)
class Millington(MeanEquation):
    """Millington and Sette: S a = -sum S_i ln(1 - alpha_i), a mean over the walls' exponents.

    One surface with alpha = 1
    makes T zero. T equals Eyring's if and only if all coefficients are equal. T does not determine
    S'alpha, so a calibration needs the closed loop.

    References
    ----------
    G. Millington, J. Acoust. Soc. Am. 4, 69-82 (1932); W. J. Sette, ibid. 193-210 (1932).

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=100, materials=["a", "b"], areas=[60, 40],
    ...             alpha=[[0.3], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Millington(speed_of_sound=343).reverberation_time(room).round(4))
    [0.2775]
    """

    name: ClassVar[str] = "Millington"
    key: ClassVar[str] = "millington"
    # An opening has alpha = 1 and would make T zero; 0.999 counts it as 6.9 times its area.
    largest_alpha: ClassVar[float] = 0.999

    @checked
    def contribution(self, alpha: Array) -> Array:
        """Return the wall's exponent -ln(1 - alpha), infinite at 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.asarray(alpha, dtype=float)))

    @checked
    def coefficient(self, contribution: Array) -> Array:
        """Return 1 - exp(-contribution)."""
        return np.asarray(-np.expm1(-np.asarray(contribution, dtype=float)))

    @checked
    def contribution_slope(self, alpha: Array) -> Array:
        """Return 1 / (1 - alpha)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.asarray(alpha, dtype=float)))

    def linear(self) -> LinearEquation:
        """Return Eyring's equation, which has the same T for equal coefficients."""
        return Eyring(self.speed_of_sound)

    def diffuse_field(self) -> MeanEquation:
        """Return Eyring's equation: a small open window does not make T zero in a diffuse field."""
        return Eyring(self.speed_of_sound)
