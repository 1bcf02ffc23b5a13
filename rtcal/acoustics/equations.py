"""Reverberation equations and their inversion to the linear target S'alpha = b.

Every equation here is T = (24 ln 10 / c) V / (S a + 4 m V), with the absorption exponent a a
function of the mean absorption coefficient S'alpha / S alone. Inverted for a measured T, that is
one linear equality in alpha (Bellows & Katz 2025, Eqs. 1 to 6).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.errors import DataError, InfeasibleError, ModelError, of_bands
from rtcal.support import checks
from rtcal.support.types import Array

PAPER_SPEED_OF_SOUND = 24 * np.log(10) / 0.164
"""336.97 m/s: gives the paper's rounded constant 0.164 s/m; only to reproduce its numbers."""

# Towards 36, 1 - exp(-a) rounds to 1 and the mean coefficient no longer tells T; up to 25 it tells
# T to 1e-6, and no room is so dead.
_LARGEST_EXPONENT = 25.0


@runtime_checkable
class Equation(Protocol):
    """Anything that predicts the reverberation time of a room."""

    name: ClassVar[str]

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""
        ...


@dataclass(frozen=True)
class LinearEquation(ABC):
    """An equation in which T depends on alpha only through S'alpha.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; the room's air tells it if it is not given.
    """

    speed_of_sound: float | None = None

    name: ClassVar[str] = ""

    @property
    def largest_mean_alpha(self) -> float:
        """The mean coefficient up to which T falls; the inverse knows only this branch."""
        return 1.0

    def __post_init__(self) -> None:
        c = self.speed_of_sound
        if c is not None and not 0 < checks.number("speed_of_sound", c) < np.inf:
            raise DataError(f"speed_of_sound = {c:g} m/s is not finite and above 0")

    @abstractmethod
    def exponent(self, mean_alpha: Array) -> Array:
        """Return the absorption exponent a of the mean coefficient S'alpha / S."""

    @abstractmethod
    def mean_alpha(self, exponent: Array) -> Array:
        """Return the mean coefficient that has this exponent: the inverse of `exponent`.

        NaN where no mean coefficient has it.
        """

    @abstractmethod
    def slope(self, mean_alpha: Array) -> Array:
        """Return d exponent / d mean_alpha."""

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); infinite where nothing absorbs (Eqs. 1 to 3)."""
        checks.instance("room", room, Room)
        return self.time(room, room.absorption_area)

    def time(self, room: Room, absorption_area: Array) -> Array:
        """Return T in s for the surfaces' absorption area S'alpha in m², both (..., n_bands)."""
        constant = self._constant(room)
        exponent = self.exponent(absorption_area / room.total_area)
        total = room.total_area * exponent + 4 * room.air_attenuation * room.volume
        with np.errstate(divide="ignore"):
            return np.asarray(constant * room.volume / total)

    def target(self, room: Room, t: Array) -> Array:
        """Return b in m², (..., n_bands), for T in s, without a check of what can be reached.

        b is below 0 where T is longer than the air alone allows, and NaN where T is NaN or where
        no mean absorption coefficient has the exponent that T asks for.
        """
        with np.errstate(over="ignore"):
            total = self._constant(room) * room.volume / np.asarray(t, dtype=float)
        exponent = (total - 4 * room.air_attenuation * room.volume) / room.total_area
        return np.asarray(room.total_area * self.mean_alpha(exponent))

    def target_sensitivity(self, room: Room, t: Array) -> Array:
        """Return db/dT in m²/s, (n_bands,): negative, since a longer T needs less absorption."""
        t = np.asarray(t, dtype=float)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            total_slope = -self._constant(room) * room.volume / t**2
            return np.asarray(total_slope / self.slope(self.target(room, t) / room.total_area))

    def air_share(self, room: Room, absorption_area: Array) -> Array:
        """Return the air's share 4mV / (S a + 4mV) of the whole absorption, (n_bands,)."""
        air = 4 * room.air_attenuation * room.volume
        total = room.total_area * self.exponent(absorption_area / room.total_area) + air
        return np.asarray(np.divide(air, total, out=np.zeros_like(air), where=total > 0))

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Return the absorption area b that the surfaces need for T (Eqs. 5 and 6).

        Parameters
        ----------
        room : Room
        t : array (n_bands,)
            Measured T in s; NaN where missing.

        Returns
        -------
        array (n_bands,)
            b in m², from 0 to the total area; NaN where T is.

        Raises
        ------
        DataError
            If T has another shape, is infinite, or is not above 0.
        InfeasibleError
            If no coefficients from 0 to 1 give T; the message says which T would do.
        """
        checks.instance("room", room, Room)
        t = checks.array("T", t)
        if t.shape != (room.n_bands,):
            raise DataError(f"T has shape {t.shape}; the room's bands ask for ({room.n_bands},)")
        for frequency, value in zip(room.centre_frequencies, t, strict=True):
            if np.isinf(value) or value <= 0:
                raise DataError(
                    f"T[{bands.label(frequency)}] = {value:g} s is not finite and above 0"
                )
        b = self.target(room, t)
        longest = self.time(room, np.zeros(room.n_bands))
        top = self.largest_mean_alpha * room.total_area
        shortest = self.time(room, np.full(room.n_bands, top))
        for i in range(room.n_bands):
            if np.isnan(t[i]) or 0 <= b[i] <= top * (1 + 1e-15):
                continue
            why = "longer than the air alone allows" if t[i] > longest[i] else "too short"
            raise InfeasibleError(
                f"T[{bands.label(room.centre_frequencies[i])}] = {t[i]:.4g} s is {why} in "
                f"{self.name}'s equation: T from {shortest[i]:.4g} to {longest[i]:.4g} s would do"
            )
        return b

    def _constant(self, room: Room) -> float:
        """24 ln 10 / c in s/m."""
        checks.instance("room", room, Room)
        return float(24 * np.log(10) / (self.speed_of_sound or room.speed_of_sound))


@dataclass(frozen=True)
class Sabine(LinearEquation):
    """Sabine's equation: a = mean alpha (Sabine 1922; Bellows & Katz 2025, Eqs. 2 and 5).

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.2], [0.4]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Sabine(speed_of_sound=PAPER_SPEED_OF_SOUND).reverberation_time(room).round(2))
    [0.29]
    """

    name: ClassVar[str] = "Sabine"

    def exponent(self, mean_alpha: Array) -> Array:
        """Return the mean coefficient itself."""
        return np.asarray(mean_alpha)

    def mean_alpha(self, exponent: Array) -> Array:
        """Return the exponent itself."""
        return np.asarray(exponent)

    def slope(self, mean_alpha: Array) -> Array:
        """Return 1."""
        return np.ones_like(mean_alpha)


@dataclass(frozen=True)
class Eyring(LinearEquation):
    """Eyring's equation: a = -ln(1 - mean alpha) (Eyring 1930; Bellows & Katz 2025, Eqs. 3, 6).

    Examples
    --------
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Eyring(speed_of_sound=343).reverberation_time(room).round(4))
    [0.5484]
    """

    name: ClassVar[str] = "Eyring"

    @property
    def largest_mean_alpha(self) -> float:
        """1 - exp(-25): beyond, the mean coefficient tells T only to rounding."""
        return float(-np.expm1(-_LARGEST_EXPONENT))

    def exponent(self, mean_alpha: Array) -> Array:
        """Return -ln(1 - mean alpha), infinite at 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.minimum(mean_alpha, 1.0)))

    def mean_alpha(self, exponent: Array) -> Array:
        """Return 1 - exp(-exponent); NaN above 25, where it would lose T to rounding."""
        with np.errstate(over="ignore"):
            mean = -np.expm1(-np.asarray(exponent, dtype=float))
        return np.asarray(np.where(np.asarray(exponent) > _LARGEST_EXPONENT, np.nan, mean))

    def slope(self, mean_alpha: Array) -> Array:
        """Return 1 / (1 - mean alpha)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.minimum(mean_alpha, 1.0)))


@dataclass(frozen=True)
class Kuttruff(LinearEquation):
    """Kuttruff's equation: a = a' (1 - gamma² a' / 2), a' = -ln(1 - mean alpha).

    gamma² is the relative variance of the free paths. The exponent peaks at a' = 1 / gamma², for
    gamma² = 0.4 at a mean coefficient of 0.918; beyond it the equation does not hold, and a T shorter
    than there is refused.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; the room's air tells it if it is not given.
    path_variance : float
        gamma², above 0 and at most 1; 0.4 suits rooms of usual proportions.

    References
    ----------
    H. Kuttruff, Room Acoustics, 5th ed. (2009), Eqs. 5.23 to 5.25.

    Examples
    --------
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Kuttruff(speed_of_sound=343).reverberation_time(room).round(4))
    [0.574]
    """

    path_variance: float = 0.4

    name: ClassVar[str] = "Kuttruff"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < checks.number("path_variance", self.path_variance) <= 1:
            raise DataError(f"path_variance = {self.path_variance:g} is not above 0 and at most 1")

    @property
    def largest_mean_alpha(self) -> float:
        """1 - exp(-1 / gamma²), where T is shortest."""
        return float(-np.expm1(-1 / self.path_variance))

    def exponent(self, mean_alpha: Array) -> Array:
        """Return a' (1 - gamma² a' / 2); ModelError beyond the peak, where it does not hold."""
        beyond = np.atleast_1d(mean_alpha) > self.largest_mean_alpha * (1 + 1e-12)
        if beyond.any():
            error = ModelError(
                f"a mean absorption coefficient of {np.max(mean_alpha):.3f} is beyond "
                f"{self.largest_mean_alpha:.3f}, up to which Kuttruff's equation holds"
            )
            raise of_bands(error, np.flatnonzero(beyond.reshape(-1, beyond.shape[-1]).any(axis=0)))
        eyring = -np.log1p(-np.asarray(mean_alpha, dtype=float))
        return np.asarray(eyring * (1 - self.path_variance * eyring / 2))

    def mean_alpha(self, exponent: Array) -> Array:
        """Return the mean coefficient on the lower branch; NaN for an exponent above the peak."""
        # 2 gamma² a before the peak; written as a quotient, small exponents keep their digits.
        inside = 1 - 2 * self.path_variance * np.asarray(exponent, dtype=float)
        inside = np.where(inside < 0, np.where(inside > -1e-14, 0.0, np.nan), inside)
        eyring = 2 * np.asarray(exponent, dtype=float) / (1 + np.sqrt(inside))
        return np.asarray(-np.expm1(-eyring))

    def slope(self, mean_alpha: Array) -> Array:
        """Return (1 - gamma² a') / (1 - mean alpha), 0 at the peak."""
        eyring = -np.log1p(-np.asarray(mean_alpha, dtype=float))
        return np.asarray((1 - self.path_variance * eyring) / (1 - np.asarray(mean_alpha)))
