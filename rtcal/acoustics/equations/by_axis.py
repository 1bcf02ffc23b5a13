"""Fitzroy's and Arau-Puchades' equations, which treat the surfaces of each axis separately.

They are not functions of a mean over all walls and give no linear target. They are calibrated like a
simulator, in the closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations.base import ReverberationEquation, register
from rtcal.acoustics.equations.by_mean import Eyring
from rtcal.acoustics.room import AXES, Room
from rtcal.support import checks
from rtcal.support.errors import ModelError
from rtcal.support.types import Array


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
