"""The error of what is compared with the measurement: scattering, noise, and what control runs tell.

The scattering of each material is not known. The traced paths tell what it changes
(`PathTracing.scattering_jacobian`), with the prior of a calibration to every position
(`rtcal.loop.scattering`). Control runs tell the rest, without the noise of their few paths. What is
compared has noise of its own, and so have the derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.loop.control_runs import MODELS, ControlRuns
from rtcal.loop.scattering import MaterialScattering, basis
from rtcal.support.types import Array

OWN = 0.1
"""Share of the control runs' variance that is each value's own. Without it, combinations of values
decide that hardly differ between so few runs."""
COMMON = 0.25
"""Share of the variance common to all pairs that is assumed. Control runs scatter from hardly at all to
nearly everything, by which T of the whole room differs most."""


@dataclass(frozen=True, eq=False)
class SimulatorError:
    """The simulator's error at the pairs and parameters of a search.

    Attributes
    ----------
    runs : ControlRuns
        Without their noise.
    rest : array (n, n)
        Covariance by the scattering of the materials and by noise, n = parameters x pairs x bands.
    common : float
        Share of the variance common to all pairs that is assumed.
    """

    runs: ControlRuns
    rest: Array
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
        """Return the covariance, (n, n), from all runs but some."""
        kept = np.ones(len(self.runs.errors), dtype=bool)
        if without is not None:
            kept[without] = False
        runs = replace(self.runs, errors=self.assumed[kept], levels=None, models=())
        covariance = runs.covariance()
        of_runs = (1 - OWN) * covariance + OWN * np.diag(np.diag(covariance))
        return np.asarray(of_runs + self.rest)

    def scattering(self, levels: Array) -> Array:
        """Return the shifts where the level changes by these, (parameters, pairs, bands, levels).

        All pairs have the mean shift: what their slopes differ by is mostly the noise of the few runs.
        """
        columns, shape = self._columns, self.runs.errors.shape[1:]
        if columns is None:
            return np.zeros((*shape, len(levels)))
        means = self.runs.errors.mean(axis=2)
        slope = np.linalg.lstsq(columns, means.reshape(len(columns), -1), rcond=None)[0][-1]
        every = np.broadcast_to(slope.reshape(shape[0], 1, shape[2]), shape)
        return np.asarray(every[..., np.newaxis] * levels)


def simulator_error(
    controls: ControlRuns, noise: Array, scattering: Array, scattering_noise: Array, tracings: int
) -> SimulatorError:
    """Return the error of the mean of some tracings.

    Parameters
    ----------
    controls : ControlRuns
        With as many paths as a group of the tracings.
    noise : array (n_groups, n_parameters, n_pairs, n_bands)
        Deviations of all groups of paths from the mean of their tracing.
    scattering : array (n_parameters, n_pairs, n_bands, n_materials)
        Derivatives by the log odds of each material's scattering coefficient.
    scattering_noise : array (n_groups, n_parameters, n_pairs, n_bands, n_materials)
        Deviations of those of all groups of paths from the mean of their tracing.
    tracings : int
    """
    free = len(noise) - tracings
    variance = (noise**2).sum(axis=0).mean(axis=1) / free  # (n_parameters, n_bands)
    slope = scattering.reshape(-1, scattering.shape[-1])
    materials = MaterialScattering(slope=slope, traced=np.zeros(slope.shape[1]))
    # A control run is the difference of two tracings. The noise of one is taken off: with that of both,
    # what was measured was likelier by 5 nats in 27 rooms, and the right surface less likely.
    runs = controls.without_noise(variance)
    # Parameters and bands share the paths, and the pairs of a source, too. So do the derivatives: what
    # they err by counts as often as the scattering that they belong to may be other.
    of_slopes = scattering_noise @ np.linalg.cholesky(materials.prior)
    errors = np.concatenate([noise[..., np.newaxis], of_slopes], axis=-1)
    of_noise = sum(
        replace(controls, errors=errors[..., column], levels=None, models=()).covariance()
        for column in range(errors.shape[-1])
    )
    return SimulatorError(runs, materials.covariance + of_noise / free)
