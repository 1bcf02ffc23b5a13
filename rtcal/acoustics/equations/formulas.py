"""The reverberation equations by name.

Sabine's, Eyring's, Millington and Sette's and Kuttruff's have one absorption exponent for the room, a
mean over its walls. Fitzroy's and Arau-Puchades' treat the surfaces of each axis separately. They are
not functions of a mean over all walls and give no linear target. They are calibrated like a simulator,
in the closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations.base import (
    LinearEquation,
    MeanEquation,
    ReverberationEquation,
    register,
)
from rtcal.acoustics.room import AXES, Room
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, ModelError, of_bands
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


@register
@dataclass(frozen=True)
class Sabine(LinearEquation):
    """Sabine's equation: a = mean alpha (Sabine 1922; Bellows & Katz 2025, Eqs. 2 and 5).

    E and h of a `MeanEquation` are both the identity.

    Examples
    --------
    >>> from rtcal.acoustics.equations import PAPER_SPEED_OF_SOUND
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.2], [0.4]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Sabine(speed_of_sound=PAPER_SPEED_OF_SOUND).reverberation_time(room).round(2))
    [0.29]
    """

    name: ClassVar[str] = "Sabine"
    key: ClassVar[str] = "sabine"

    def diffuse_field(self) -> MeanEquation:
        """Return Eyring's equation: Sabine's T stays above 0 where every wall absorbs everything."""
        return Eyring(self.speed_of_sound)


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


@dataclass(frozen=True)
class _AxisEquation(ReverberationEquation):
    """An equation that combines three times, one per axis."""

    def _axes(self, room: Room) -> tuple[Array, Array]:
        """Shares of the area (3, 1), and Eyring's T of each axis' mean coefficient (3, n_bands)."""
        if not checks.instance("room", room, Room).surfaces:
            raise ModelError(
                f"{self.name}'s equation needs the axis (x, y or z) of every surface; room "
                f'"{room.name}" has no surfaces'
            )
        areas, absorbed = np.zeros(3), np.zeros((3, room.n_bands))
        for surface in room.surfaces:
            if surface.axis is None:
                raise ModelError(
                    f"{self.name}'s equation needs the axis (x, y or z) of every surface; "
                    f'"{surface.name}" has none'
                )
            axis = AXES.index(surface.axis)
            areas[axis] += surface.area
            absorbed[axis] += surface.area * room.alpha[room.material_index(surface.material)]
        if (empty := areas == 0).any():
            missing = AXES[int(np.argmax(empty))]
            raise ModelError(f'{self.name}: no surface stands across the axis "{missing}"')
        exponents = Eyring().exponent(absorbed / areas[:, np.newaxis])
        return areas[:, np.newaxis] / areas.sum(), self._time(room, room.total_area * exponents)


@register
@dataclass(frozen=True)
class Fitzroy(_AxisEquation):
    """Fitzroy: the arithmetic mean of the axes' Eyring times, weighted by their areas.

    T = sum (S_x / S) T_x,  T_x = (24 ln 10 / c) V / (-S ln(1 - alpha_x) + 4 m V).

    References
    ----------
    D. Fitzroy, J. Acoust. Soc. Am. 31, 893-897 (1959).
    """

    name: ClassVar[str] = "Fitzroy"
    key: ClassVar[str] = "fitzroy"

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); ModelError where a surface has no axis."""
        shares, times = self._axes(room)
        return np.asarray(np.sum(shares * times, axis=0))


@register
@dataclass(frozen=True)
class ArauPuchades(_AxisEquation):
    """Arau-Puchades: the geometric mean of the axes' Eyring times, weighted by their areas.

    T = product T_x^(S_x / S),  T_x as in `Fitzroy`.

    References
    ----------
    H. Arau-Puchades, Acustica 65, 163-180 (1988).
    """

    name: ClassVar[str] = "Arau-Puchades"
    key: ClassVar[str] = "arau"

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); ModelError where a surface has no axis."""
        shares, times = self._axes(room)
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.sum(shares * np.log(times), axis=0)))
