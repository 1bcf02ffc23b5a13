"""Derivatives of the answer with respect to the measured T, and the error of the linear estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rtcal.support import kkt
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.kkt import Hessian
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimality:
    """The optimality conditions at the answer, and their derivatives with respect to T.

    H du + A' dy = -dg and A du = dc, over the free unknowns u and the active rows A.

    Attributes
    ----------
    rows : tuple of int (n_materials,)
        The row of coefficients of each material.
    n_bands, n_configurations : int
    curvature : Hessian
        H.
    matrix : array or sparse array (n_rows, size)
    scale : array (size,)
        The scale of each unknown.
    free : array (size,) of bool
        Unknowns that may move.
    active : array (n_rows,) of bool
        Rows that hold with equality.
    gradient_by_time : array (size, n_times)
        d gradient / d T in 1/s, one T per configuration and band.
    limit_by_time : array (n_rows, n_times)
        d limit / d T in m²/s.
    """

    rows: tuple[int, ...]
    n_bands: int
    n_configurations: int
    curvature: Hessian
    matrix: Any
    scale: Array
    free: NDArray[np.bool_]
    active: NDArray[np.bool_]
    gradient_by_time: Array
    limit_by_time: Array

    def derivative(self) -> Array:
        """Return du / dT in 1/s, (size, n_times); 0 for unknowns that are not free."""
        import scipy.sparse as sp

        scale = self.scale[self.free]
        rows = sp.csr_array(self.matrix)[self.active][:, self.free] * scale
        norm = np.sqrt(np.asarray((rows**2).sum(axis=1)).ravel())
        rows = sp.csr_array(sp.diags_array(1 / norm) @ rows)
        force = -self.gradient_by_time[self.free] * scale[:, np.newaxis]
        limit = self.limit_by_time[self.active] / norm[:, np.newaxis]
        step, _ = kkt.solve(self.curvature.part(self.free, scale), rows, force, limit)
        out = np.zeros((len(self.scale), force.shape[1]))
        out[self.free] = scale[:, np.newaxis] * step
        return out


@runtime_checkable
class Optimal(Protocol):
    """A result that has optimality conditions."""

    def optimality(self) -> Optimality:
        """Return the optimality conditions at the answer."""


@checked
def sensitivity(result: Optimal) -> Array:
    """Return d alpha / d T in 1/s, (n_materials, n_bands, n_configurations, n_bands).

    The last two axes are those of T. Coefficients at a bound stay there: the derivative is valid until
    the next bound. For independent priors and an exact match, over the free coefficients F of the
    band,  d alpha_F / db = S_F sigma_F² / sum(S_F² sigma_F²),  times db/dT (docs/posterior.md).

    Parameters
    ----------
    result : CalibrationResult or JointResult

    Raises
    ------
    DataError
        If ``result`` is not the result of a calibration.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2())
    >>> slope = rt.posterior.sensitivity(result)
    >>> bool((slope[:, 2, 0, 2] <= 0).all())  # a longer T at 500 Hz needs less absorption there
    True
    """
    if not isinstance(result, Optimal):
        raise DataError(f"result = {result!r} is not the result of a calibration")
    conditions = result.optimality()
    n_rows = max(conditions.rows) + 1
    by_time = conditions.derivative()[: n_rows * conditions.n_bands]
    shape = (n_rows, conditions.n_bands, conditions.n_configurations, conditions.n_bands)
    return np.asarray(by_time.reshape(shape)[list(conditions.rows)])


_ROUNDING = 1e-7
"""Of the prior's sigma: what the difference of equal variances leaves. As an uncertainty it would let a
coefficient that T alone determines contradict the next T by millions of standard deviations."""


def linear_estimate_sigma(gain: Array, sigma: Array, cross: Array, innovation: Array) -> Array:
    """Return the standard deviation of a linear estimate's error, (size,).

    The estimate is mu + G (b - S'mu), its error (1 - G S')(mu - u) + G e, with e the error of b.
    With the prior's covariance K and the covariance U of e the error's covariance is
    (1 - G S') K (1 - G S')' + G U G'. It holds for any gain, also for one whose method assumes
    another sigma.

    Parameters
    ----------
    gain : array (size, n_rows)
        G = du / db in 1/m².
    sigma : array (size,)
        Square root of the diagonal of K.
    cross : array (size, n_rows)
        K S.
    innovation : array (n_rows, n_rows)
        S'KS + U, the covariance of b - S'mu.
    """
    variance = (
        sigma**2 - 2 * np.sum(gain * cross, axis=1) + np.sum((gain @ innovation) * gain, axis=1)
    )
    left = np.sqrt(np.maximum(variance, 0.0))
    return np.where(left > _ROUNDING * sigma, left, 0.0)
