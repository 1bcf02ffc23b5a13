"""An equation as a simulator: the simplest one, and the closed loop's own test."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rtcal.acoustics.equations import Equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.errors import DataError, of_bands
from rtcal.simulators.base import check_alpha
from rtcal.support import checks
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class EquationSimulator:
    """Returns the T of a reverberation equation, also of one that no linear target belongs to.

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
    >>> found = EquationSimulator(Eyring(speed_of_sound=343), room).simulate(room.alpha)
    >>> print(found.values["t20"].round(4))
    [[0.5484]]
    """

    equation: Equation
    room: Room
    deterministic: bool = field(default=True, init=False)
    smooth: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.equation, Equation):
            raise DataError(f"equation = {self.equation!r} is no Equation")
        checks.instance("room", self.room, Room)

    @property
    def name(self) -> str:
        """What calibrated coefficients belong to."""
        return f"{self.equation.name}'s equation for {self.room.name}"

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials: rows of alpha."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """The room's bands in Hz: columns of alpha."""
        return self.room.centre_frequencies

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return T for alpha (n_materials, n_bands), in s, as a T20; DataError where it is infinite."""
        alpha = check_alpha(self, alpha)
        times = self.equation.reverberation_time(self.room.replace(alpha=alpha, calibration=None))
        if not (finite := np.isfinite(times)).all():
            error = DataError(f"{self.name} has no finite T: nothing absorbs")
            raise of_bands(error, np.flatnonzero(~finite))
        return Measurement.from_values(self.centre_frequencies, t20=times)
