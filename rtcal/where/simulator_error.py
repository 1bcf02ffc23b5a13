"""The error of what is compared with the measurement, as control runs tell it.

Control runs have fewer paths than what is compared. Their noise is taken off. A separate covariance of
what depends on the scattering did not pay: control runs that it had not seen lay further outside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.loop.control_runs import MODELS, ControlRuns
from rtcal.loop.scattering import basis
from rtcal.support.types import Array

OWN = 0.5
"""Share of the variance that is each value's own. Without it, combinations of values decide that hardly
differ between so few runs. In four development rooms the log likelihood ratio of the true change then
was 37, 17, 0 and -26 nats, and with it 50, 12, 6 and 8."""
COMMON = 0.25
"""Share of the variance common to all pairs that is assumed. Control runs scatter from hardly at all to
nearly everything, by which T of the whole room differs most. What was measured in an empty development
room is likelier by 60 nats than with all of it (`python -m benchmarks.where_threshold --measured`).
The pairs' own part stays: with less of it another volume took the place of an open window."""


@dataclass(frozen=True, eq=False)
class SimulatorError:
    """The simulator's error at the pairs and parameters of a search.

    Attributes
    ----------
    runs : ControlRuns
        Without their noise.
    common : float
        Share of the variance common to all pairs that is assumed.
    """

    runs: ControlRuns
    common: float = COMMON

    @property
    def assumed(self) -> Array:
        """The errors, what is common to all pairs as large as is assumed; (n_runs, p, i, k)."""
        return self.runs.with_common(self.common**0.5).errors

    @property
    def _columns(self) -> Array | None:
        """What depends on the scattering of each run, (n_runs, 3)."""
        if self.runs.levels is None:
            return None
        return basis(self.runs.levels, [MODELS.index(m) for m in self.runs.models])

    def covariance(self, without: NDArray[np.int64] | None = None) -> Array:
        """Return the covariance, (n, n), n = parameters x pairs x bands, from all runs but some."""
        kept = np.ones(len(self.runs.errors), dtype=bool)
        if without is not None:
            kept[without] = False
        runs = replace(self.runs, errors=self.assumed[kept], levels=None, models=())
        covariance = runs.covariance()
        return np.asarray((1 - OWN) * covariance + OWN * np.diag(np.diag(covariance)))

    def scattering(self, levels: Array) -> Array:
        """Return the shifts where the level changes by these, (parameters, pairs, bands, levels)."""
        columns, shape = self._columns, self.runs.errors.shape[1:]
        if columns is None:
            return np.zeros((*shape, len(levels)))
        rows = self.runs.errors.reshape(len(columns), -1)
        slope = np.linalg.lstsq(columns, rows, rcond=None)[0][-1]
        return np.asarray(slope.reshape(*shape, 1) * levels)


def simulator_error(controls: ControlRuns, noise: Array, more_paths: int) -> SimulatorError:
    """Return the error of a tracing with ``more_paths`` times the paths of the control runs.

    Parameters
    ----------
    controls : ControlRuns
        Each the difference of two tracings with as many paths.
    noise : array (n_groups, n_parameters, n_pairs, n_bands)
        Deviations from their mean of as many paths.
    more_paths : int
    """
    variance = (noise**2).sum(axis=0).mean(axis=1) / (len(noise) - 1)  # (n_parameters, n_bands)
    # Each error is the difference of two tracings; what is compared has more paths.
    return SimulatorError(controls.without_noise((2 - 1 / more_paths) * variance))
