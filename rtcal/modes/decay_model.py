"""The decays of a room's modes as functions of its coefficients, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.modes.frequency import AtFrequencies
from rtcal.modes.paris import admittance, admittance_slope
from rtcal.modes.room_modes import Poles, RoomModes
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class DecayModel:
    """The room's poles as functions of alpha in its bands."""

    room: Room
    modes: RoomModes
    correlation: float
    phases: Array
    chosen: tuple[int, ...] | None = None
    known: dict[bytes, tuple[Array, Array, Array]] = field(default_factory=dict)

    @cached_property
    def at(self) -> AtFrequencies:
        """The coefficients at the modes' frequencies, those that complete the shapes as well."""
        return AtFrequencies.of(self.room, self.modes.frequencies, self.correlation)

    @cached_property
    def rows(self) -> list[int]:
        """The material of each wall."""
        return [self.room.material_index(m) for m in self.modes.materials]

    def poles(self, alpha: Array) -> Poles:
        """Return the poles; the admittance between the modes' frequencies is interpolated."""
        f = self.modes.frequencies
        beta = self.beta(self.at.alpha(alpha))

        def admittances(frequency: float) -> NDArray[np.complex128]:
            return np.array([np.interp(frequency, f, row) for row in beta])[self.rows]

        return self.modes.poles(admittances, self.chosen)

    def beta(self, alpha: Array) -> NDArray[np.complex128]:
        """Return the admittance of each material, of alpha (n_materials, n_frequencies)."""
        return np.stack([admittance(a, p) for a, p in zip(alpha, self.phases, strict=True)])

    def linear(self, alpha: Array) -> tuple[Array, Array, Array]:
        """Return the chosen modes' decays, their slopes by alpha in the bands, and the remainder.

        (n_modes,), (n_modes, n_materials * n_bands) and (n_modes, n_modes), in 1/s.
        """
        key = alpha.tobytes()
        if key not in self.known:
            self.known[key] = self._linear(alpha)
        return self.known[key]

    def _linear(self, alpha: Array) -> tuple[Array, Array, Array]:
        poles, columns = self.poles(alpha), list(self.chosen or ())
        at = self.at.alpha(alpha)[:, columns]
        beta_slope = np.stack(
            [admittance_slope(a, p) for a, p in zip(at, self.phases, strict=True)]
        )
        by_material = np.zeros((len(columns), self.room.n_materials), dtype=complex)
        for wall, row in enumerate(self.rows):
            by_material[:, row] += poles.slopes[:, wall]
        # Of delta by alpha at the mode's own frequency.
        slope = -(by_material * beta_slope.T).real
        matrix = slope[:, :, np.newaxis] * self.at.slope()[:, columns].transpose(1, 0, 2)
        in_sigmas = slope * self.at.sigma[:, columns].T
        remainder = (in_sigmas @ in_sigmas.T) * self.at.remainder[np.ix_(columns, columns)]
        air = self.room.air_attenuation * self.modes.speed_of_sound / 2
        decays = poles.decays + np.interp(poles.frequencies, self.room.centre_frequencies, air)
        return decays, matrix.reshape(len(columns), -1), remainder
