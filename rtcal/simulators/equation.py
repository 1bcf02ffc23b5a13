"""A reverberation equation as a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.equations import Equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.room import Room
from rtcal.simulators.base import RoomSimulator, check_alpha
from rtcal.support import checks
from rtcal.support.errors import DataError, of_bands
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class EquationSimulator(RoomSimulator):
    """Returns the T of a reverberation equation, also of one without a linear target.

    Parameters
    ----------
    equation : Equation
        For example Fitzroy's, which `rtcal.calibrate` cannot invert but the closed loop can.
    room : Room

    Examples
    --------
    >>> from rtcal.acoustics.equations import Eyring
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> simulator = EquationSimulator(Eyring(speed_of_sound=343), room)
    >>> print(simulator.simulate(room.alpha).values["t20"].round(4))
    [[0.5484]]
    """

    equation: Equation
    room: Room
    deterministic: ClassVar[bool] = True
    smooth: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if isinstance(self.equation, type) or not isinstance(self.equation, Equation):
            raise DataError(f"equation = {self.equation!r} is no Equation")
        checks.instance("room", self.room, Room)

    @property
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""
        return f"{self.equation.name}'s equation for {self.room.name}"

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return T in s for alpha (n_materials, n_bands) as a T20; the seed has no effect.

        Raises
        ------
        DataError
            For an infinite T, or an alpha that is not (n_materials, n_bands) or not in [0, 1].
        """
        checks.whole("seed", seed, 0)
        alpha = check_alpha(self, alpha)
        times = self.equation.reverberation_time(self.room.replace(alpha=alpha, calibration=None))
        if not (finite := np.isfinite(times)).all():
            error = DataError(f"{self.name} has no finite T: nothing absorbs")
            raise of_bands(error, np.flatnonzero(~finite))
        return Measurement.from_values(self.centre_frequencies, **{TARGET.key: times})
