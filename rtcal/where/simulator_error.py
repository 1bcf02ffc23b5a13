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
_LEAST = 0.1
"""Share of a variance that is left at least where noise is taken off."""


@dataclass(frozen=True, eq=False)
class SimulatorError:
    """The simulator's error at the pairs and parameters of a search.

    Attributes
    ----------
    runs : ControlRuns
        Without their noise.
    """

    runs: ControlRuns

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
        runs = replace(self.runs, errors=self.runs.errors[kept], levels=None, models=())
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
    errors, n_pairs = controls.errors, controls.errors.shape[2]
    variance = (noise**2).sum(axis=0).mean(axis=1) / (len(noise) - 1)  # (n_parameters, n_bands)
    common = errors.mean(axis=2, keepdims=True)
    own = errors - common
    left = _less(common, variance / n_pairs, more_paths) + _less(own, variance, more_paths)
    return SimulatorError(replace(controls, errors=left))


def _less(errors: Array, noise: Array, more_paths: int) -> Array:
    """Return the errors (runs, parameters, pairs, bands), scaled to the variance without noise."""
    variance = (errors**2).mean(axis=(0, 2))
    wanted = np.maximum(variance - 2 * noise, _LEAST * variance) + noise / more_paths
    share = np.divide(wanted, variance, out=np.ones_like(variance), where=variance > 0)
    return np.asarray(errors * np.sqrt(np.minimum(share, 1.0))[:, np.newaxis])
