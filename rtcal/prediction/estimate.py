"""The most probable coefficients, volume, areas and equation error, from measured states of a room.

With the unknowns of `rtcal.acoustics.states`, each measured state gives per band

    ln T = ln T(alpha, V, S, m) + g + e,  var e = u_T² / T² + own².

The estimate is the posterior's mode within 0 <= alpha <= 1, by Gauss-Newton steps; its covariance is
that of the linear estimate there, without the bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.states import Flags, Rooms, State, refuse_counted_twice
from rtcal.support.errors import SolverError
from rtcal.support.sampler import samples_of_normal
from rtcal.support.types import Array

_STEPS = 60
_SETTLED = 1e-9
"""Largest last step of alpha, ln V, ln S and g."""
_NEAR = 2.0
"""Distance of a coefficient from a bound, in standard deviations, below which the bound counts."""
_MATTERS = 0.1
"""Share of the whole standard deviation from which a coefficient counts."""
_LEAST = 1e-9
"""Least standard deviation of a measured ln T: an exact one would divide by 0."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The posterior of a room's unknowns, per band.

    Attributes
    ----------
    mode : array (n_bands, size)
        The most probable unknowns within the bounds.
    free : array (n_bands, size)
        The mode without the bounds, of the model that is linear at ``mode``.
    covariance : array (n_bands, size, size)
        Of the linear estimate.
    gain : array (n_bands, size, n_measured)
        d(estimate) / d(ln T measured), 0 where T is missing.
    gradient : array (n_bands, n_measured, size)
        Of the measured states' ln T; 0 where T is missing.
    noise : array (n_bands, n_measured)
        Variance of each measured ln T, without the equation's own error.
    """

    mode: Array
    free: Array
    covariance: Array
    gain: Array
    gradient: Array
    noise: Array


def estimated_change(rooms: Rooms, states: Sequence[State]) -> Estimate:
    """Return the posterior given the measured T of the first rooms, which are the states'.

    Raises
    ------
    DataError
        If a measured T would count twice.
    ModelError
        If the equation gives no T for coefficients on the way.
    SolverError
        If the steps do not settle.
    """
    refuse_counted_twice(rooms.rooms, states)
    mean, covariance = rooms.prior
    n_bands = len(mean)
    measured = np.array([np.log(s.reverberation_time) for s in states]).reshape(-1, n_bands).T
    assumed = rooms.assumptions
    u = [s.log_uncertainty(assumed.time) for s in states]
    known = np.isfinite(measured)
    noise: Array = np.where(known, np.array(u).reshape(-1, n_bands).T ** 2, 0.0)
    # A missing T has gradient 0: its variance does not matter, but must not be 0.
    variance = np.where(known, np.maximum(noise + assumed.own**2, _LEAST**2), 1.0)
    mode = mean
    for _ in range(_STEPS):
        value, gradient = _linearised(rooms, len(states), mode)
        gradient = np.where(known[..., np.newaxis], gradient, 0.0)
        at_prior = value + np.einsum("kcs,ks->kc", gradient, mean - mode)
        residual = np.where(known, measured - at_prior, 0.0)
        across = covariance @ gradient.swapaxes(1, 2)
        spread = gradient @ across + variance[:, np.newaxis] * np.eye(len(states))
        gain = np.linalg.solve(spread, across.swapaxes(1, 2)).swapaxes(1, 2)
        free = mean + np.einsum("ksc,kc->ks", gain, residual)
        after = _within(rooms, free, gradient, residual, variance)
        moved, mode = np.max(np.abs(after - mode)), after
        if moved < _SETTLED:
            break
    else:
        raise SolverError(f"the estimate did not settle: its last step was {moved:.1g}")
    posterior = covariance - gain @ across.swapaxes(1, 2)
    return Estimate(mode, free, posterior, np.asarray(gain), gradient, noise)


def _linearised(rooms: Rooms, n_measured: int, mode: Array) -> tuple[Array, Array]:
    """Return ln T of the measured states, (n_bands, n_measured), and their gradients."""
    values = np.empty((len(mode), n_measured))
    gradients = np.empty((len(mode), n_measured, rooms.size))
    for c in range(n_measured):
        values[:, c], gradients[:, c] = rooms.log_time(c, mode)
    return values, gradients


def _within(rooms: Rooms, free: Array, gradient: Array, residual: Array, variance: Array) -> Array:
    """Return the linear model's mode within the bounds of alpha: ``free`` where that keeps them.

    ``residual`` is the measured ln T less that of the prior's mean, 0 where missing.
    """
    from scipy.optimize import lsq_linear

    n = len(rooms.materials)
    beyond = ((free[:, :n] < rooms.lower.T) | (free[:, :n] > 1)).any(axis=1)
    mean, covariance = rooms.prior
    out = free.copy()
    for k in np.flatnonzero(beyond).tolist():
        moving = np.flatnonzero(np.diagonal(covariance[k]) > 0)
        of_prior = np.linalg.inv(np.linalg.cholesky(covariance[k][np.ix_(moving, moving)]))
        weight = 1 / np.sqrt(variance[k])
        low, high = np.full(rooms.size, -np.inf), np.full(rooms.size, np.inf)
        low[:n], high[:n] = rooms.lower[:, k], 1.0
        fitted = lsq_linear(
            np.vstack([of_prior, weight[:, np.newaxis] * gradient[k][:, moving]]),
            np.concatenate([np.zeros(len(moving)), weight * residual[k]]),
            ((low - mean[k])[moving], (high - mean[k])[moving]),
            method="bvls",
        )
        out[k, moving] = mean[k, moving] + fitted.x
    return out


def near_bounds(rooms: Rooms, found: Estimate, weights: Array, whole: Array) -> Flags:
    """Return in which bands the bounds change the distribution of a weighted sum, (n_bands,) of bool.

    Parameters
    ----------
    rooms : Rooms
    found : Estimate
    weights : array (n_bands, n_materials)
        d(sum) / d alpha.
    whole : array (n_bands,)
        The sum's standard deviation.
    """
    n = len(rooms.materials)
    sigma = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2)[:, :n], 0))
    alpha = found.free[:, :n]
    near = np.minimum(alpha - rooms.lower.T, 1 - alpha) < _NEAR * sigma
    matters = np.abs(weights) * sigma > _MATTERS * whole[:, np.newaxis]
    return np.asarray((near & matters & (sigma > 0)).any(axis=1))


def samples(rooms: Rooms, found: Estimate, band: int, number: int) -> Array:
    """Return samples of a band's unknowns within the bounds of alpha, (number, size)."""
    n = len(rooms.materials)
    lower, upper = np.full(rooms.size, -np.inf), np.full(rooms.size, np.inf)
    lower[:n], upper[:n] = rooms.lower[:, band], 1.0
    return samples_of_normal(
        found.free[band], found.covariance[band], (lower, upper), found.mode[band], number, band
    )
