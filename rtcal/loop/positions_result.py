"""The result of a calibration to every position."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.calibration.result import CalibrationResult
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.measured_pairs import MeasuredPairs
from rtcal.simulators.observations import Observations
from rtcal.support.types import Array

_COVERED = 1.6449
"""Half the width of a 90 % interval in standard deviations of a normal distribution."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A Gauss-Newton step: where it was linearised, the derivatives, the share taken, the answer."""

    alpha: Array
    matrix: Array
    share: float
    answer: CalibrationResult


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsResult:
    """A simulator calibrated to what every position heard."""

    prior: Room
    simulator: str
    simulations: int
    alpha: Array
    data: MeasuredPairs
    before: Observations
    after: Observations
    controls: ControlRuns | None
    covariance: Array
    innovation: Array
    steps: tuple[Linearised, ...]
    notes: tuple[str, ...]

    @cached_property
    def sigma(self) -> Array:
        """Posterior standard deviation of alpha, (n_materials, n_bands)."""
        return self.steps[-1].answer.posterior_sigma

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """Ends of the 90 % interval of alpha; None without control runs."""
        if self.controls is None:
            return None
        half = _COVERED * self.sigma
        return np.clip(self.alpha - half, 0, 1), np.clip(self.alpha + half, 0, 1)

    def _gap(self, model: Observations) -> Array:
        measured = self.data.observations
        return np.stack(
            [gap_jnd(model.natural(p), measured.natural(p), p) for p in measured.parameters]
        )

    @property
    def gap_before(self) -> Array:
        """Gap to the measured values in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.before)

    @property
    def gap_after(self) -> Array:
        """Gap to the measured values in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.after)
