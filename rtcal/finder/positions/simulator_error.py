"""The error of what is compared with the measurement: scattering, noise, and what control runs tell.

The scattering of each material is not known, nor how it depends on frequency. The traced paths tell
what it changes (`PathTracing.scattering_jacobian`), with the prior of a calibration to every position
(`rtcal.loop.scattering`) for what all bands have in common, and as much for each band. Control runs
tell the rest, without the noise of their few paths. What is compared has noise of its own, and so have
the derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.scattering import MaterialScattering
from rtcal.support.types import Array

OWN = 0.1
"""Share of the control runs' variance that is each value's own. Without it, combinations of values
decide that hardly differ between so few runs."""
COMMON = 0.25
"""Share of the variance common to all pairs that is assumed. Control runs scatter from hardly at all to
nearly everything, by which T of the whole room differs most."""
BETWEEN_OCTAVES = 0.7
"""Correlation of the scattering's part of each band between bands an octave apart. Without that part
what was measured in a flat room that scatters little was less likely by 8 to 11 nats."""


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

    def covariance(self, without: NDArray[np.int64] | None = None) -> Array:
        """Return the covariance, (n, n), from all runs but some."""
        kept = np.ones(len(self.runs.errors), dtype=bool)
        if without is not None:
            kept[without] = False
        runs = replace(self.runs, errors=self.assumed[kept], levels=None, models=())
        covariance = runs.covariance()
        of_runs = (1 - OWN) * covariance + OWN * np.diag(np.diag(covariance))
        return np.asarray(of_runs + self.rest)


def simulator_error(
    controls: ControlRuns,
    noise: Array,
    scattering: Array,
    scattering_noise: Array,
    tracings: int,
    centre_frequencies: Array,
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
    centre_frequencies : array (n_bands,)
    """
    free = len(noise) - tracings
    variance = (noise**2).sum(axis=0).mean(axis=1) / free  # (n_parameters, n_bands)
    slope = _alike(scattering).reshape(-1, scattering.shape[-1])
    materials = MaterialScattering(slope=slope, traced=np.zeros(slope.shape[1]))
    # A control run is the difference of two tracings. The noise of one is taken off: with that of both,
    # what was measured was likelier by 5 nats in 27 rooms, and the right surface less likely.
    runs = controls.without_noise(variance)
    # Parameters and bands share the paths, and the pairs of a source, too. So do the derivatives: what
    # they err by counts as often as the scattering that they belong to may be other.
    by_material = _alike(scattering_noise) @ np.linalg.cholesky(materials.prior)
    of_noise, *of_slopes = (
        replace(controls, errors=errors, levels=None, models=()).covariance() / free
        for errors in (noise, *np.moveaxis(by_material, -1, 0))
    )
    of_bands = 1 + bands.correlation(centre_frequencies, BETWEEN_OCTAVES)
    of_bands = np.tile(of_bands, 2 * [len(slope) // len(of_bands)])
    return SimulatorError(runs, of_noise + (materials.covariance + sum(of_slopes)) * of_bands)


def _alike(derivatives: Array) -> Array:
    """Return the mean over pairs at each pair: what derivatives differ by there is mostly noise."""
    return np.broadcast_to(derivatives.mean(axis=-3, keepdims=True), derivatives.shape)
