"""Equations that are not functions of the mean absorption coefficient: forward prediction only.

They give no linear target, so they are calibrated like a simulator, in the closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import AXES, Room
from rtcal.errors import DataError, ModelError
from rtcal.support import checks
from rtcal.support.types import Array


@dataclass(frozen=True)
class NonlinearEquation:
    """What Millington-Sette, Fitzroy and Arau-Puchades share: constant, air, and no inverse.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; the room's air tells it if it is not given.
    """

    speed_of_sound: float | None = None

    name: ClassVar[str] = ""

    def __post_init__(self) -> None:
        c = self.speed_of_sound
        if c is not None and not 0 < checks.number("speed_of_sound", c) < np.inf:
            raise DataError(f"speed_of_sound = {c:g} m/s is not finite and above 0")

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Raise ModelError: T does not fix S'alpha in this equation."""
        raise ModelError(
            f"{self.name}'s equation is not a function of the mean absorption coefficient, so T does "
            "not tell S'alpha; calibrate it in the closed loop with calibrate_simulator"
        )

    def _times(self, room: Room, exponents: Array) -> Array:
        """T in s for absorption exponents (..., n_bands), the air in the denominator."""
        c = self.speed_of_sound or room.speed_of_sound
        air = 4 * room.air_attenuation * room.volume
        with np.errstate(divide="ignore"):
            return np.asarray(
                24 * np.log(10) / c * room.volume / (room.total_area * exponents + air)
            )


@dataclass(frozen=True)
class Millington(NonlinearEquation):
    """Millington and Sette: S a = -sum S_i ln(1 - alpha_i).

    The mean is taken over the exponents, not over the coefficients; one surface with alpha = 1 makes T
    zero. Equal to Eyring's if and only if all coefficients are equal.

    References
    ----------
    G. Millington, J. Acoust. Soc. Am. 4, 69-82 (1932); W. J. Sette, ibid. 193-210 (1932).

    Examples
    --------
    >>> room = Room(name="box", volume=100, materials=["a", "b"], areas=[60, 40],
    ...             alpha=[[0.3], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Millington(speed_of_sound=343).reverberation_time(room).round(4))
    [0.2775]
    """

    name: ClassVar[str] = "Millington"

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""
        checks.instance("room", room, Room)
        with np.errstate(divide="ignore"):
            exponents = -np.log1p(-room.alpha)
        return self._times(room, room.areas @ exponents / room.total_area)


@dataclass(frozen=True)
class _ByAxis(NonlinearEquation):
    """Equations that treat the pairs of surfaces across each axis apart."""

    def _axes(self, room: Room) -> tuple[Array, Array]:
        """Shares of the area (3, 1), and T of each axis' mean coefficient (3, n_bands)."""
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
        with np.errstate(divide="ignore"):
            exponents = -np.log1p(-np.minimum(absorbed / areas[:, np.newaxis], 1.0))
        return areas[:, np.newaxis] / areas.sum(), self._times(room, exponents)


@dataclass(frozen=True)
class Fitzroy(_ByAxis):
    """Fitzroy: the arithmetic mean of the axes' Eyring times, weighted by their areas.

    T = sum (S_x / S) T_x,  T_x = (24 ln 10 / c) V / (-S ln(1 - alpha_x) + 4 m V).

    References
    ----------
    D. Fitzroy, J. Acoust. Soc. Am. 31, 893-897 (1959).
    """

    name: ClassVar[str] = "Fitzroy"

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); ModelError where a surface has no axis."""
        shares, times = self._axes(room)
        return np.asarray(np.sum(shares * times, axis=0))


@dataclass(frozen=True)
class ArauPuchades(_ByAxis):
    """Arau-Puchades: the geometric mean of the axes' Eyring times, weighted by their areas.

    T = product T_x^(S_x / S),  T_x as in `Fitzroy`.

    References
    ----------
    H. Arau-Puchades, Acustica 65, 163-180 (1988).
    """

    name: ClassVar[str] = "Arau-Puchades"

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); ModelError where a surface has no axis."""
        shares, times = self._axes(room)
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.sum(shares * np.log(times), axis=0)))
