"""The first state, which calibrates: its absorption area, and by how much ln T shifts with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Baseline:
    """The absorption of the first state, in the bands in which both states were measured.

    Attributes
    ----------
    equation : LinearEquation
    total_area : float
        S in m².
    area : array (n_bands,)
        The surfaces' absorption area b in m², by the equation from T before.
    air : array (n_bands,)
        4 m V in m².
    """

    equation: LinearEquation
    total_area: float
    area: Array
    air: Array

    @classmethod
    def of(
        cls, room: Room, equation: LinearEquation, times: Array, bands: NDArray[np.bool_]
    ) -> Baseline:
        """Return the baseline of a room with T ``times`` in s, (n_bands,), in some of its bands.

        Raises InfeasibleError where no coefficients give T.
        """
        area = equation.absorption_area(room, np.where(bands, times, np.nan))[bands]
        return cls(equation, room.total_area, area, 4 * room.air_attenuation[bands] * room.volume)

    def after(self, size: Array) -> Array:
        """Return the surfaces' absorption area after a change in m², (..., n_bands).

        What is added covers surfaces: b + (S - b) (1 - exp(-size / (S - b))). What is removed, of a
        size below 0, leaves b exp(size / b). To first order both are b + size.
        """
        left = self._left(size)
        return np.asarray(self.area + np.sign(size) * left * -np.expm1(-np.abs(size) / left))

    def shift(self, size: Array, of_air: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the shift of ln T and its derivative by ln |size|, both (..., n_bands).

        Parameters
        ----------
        size : array (..., n_bands)
            Absorption area in m², before it saturates: of surfaces, or of the air.
        of_air : array (..., 1) of bool
            Of which it is.
        """
        mean = self.after(np.where(of_air, 0.0, size)) / self.total_area
        whole = self.whole(mean * self.total_area) + np.where(of_air, size, 0.0)
        before = self.whole(self.area)
        by_area = size * np.exp(-np.abs(size) / self._left(size)) * self.equation.slope(mean)
        slope = -np.where(of_air, size, by_area) / whole
        return np.asarray(-np.log(whole / before)), np.asarray(slope)

    def whole(self, area: Array) -> Array:
        """Return S a + 4 m V in m², of the surfaces' absorption area in m²."""
        exponent = self.equation.exponent(area / self.total_area)
        return np.asarray(self.total_area * exponent + self.air)

    def _left(self, size: Array) -> Array:
        """What there is to cover, or to remove, in m²."""
        left = np.where(size > 0, self.total_area - self.area, self.area)
        return np.maximum(left, 1e-6 * self.total_area)
