"""What is known of alpha after the calibration: uncertainty, sensitivity, identifiability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.instance import Flags, Instance
from rtcal.calibration.result import JointResult
from rtcal.calibration.terms import match_matrix
from rtcal.calibration.twin import Twin
from rtcal.types import Array

_STEP = 1e-5
"""Relative step of T in the differences that tell how the problem's numbers follow T."""


def estimate_sigma(result: JointResult) -> Array:
    """Return the standard deviation of the estimate's error, (size,) over the unknowns.

    The estimate is linear where no bound is active: its error is (1 - B S')(mu - alpha) + B e with
    B = d alpha / db, S' the matched rows and e the error of b. With the prior's covariance K and
    the uncertainty U of b,  cov = (1 - B S') K (1 - B S')' + B U B'.  Where T's uncertainty is
    unknown it counts as 0. Right for every method, also for one whose own sigma is not the room's.
    """
    instance = result.solution.twin.instance
    layout = instance.layout
    slopes = _slopes(result)
    gain = _by_time(result, bounds=False) / np.where(slopes != 0, slopes, 1.0)
    room = result.configurations.union
    sigma = np.concatenate([
        room.sigma[layout.first].ravel(), instance.further(instance.sigma)
    ])  # fmt: skip
    prior = next(t for t in result.solution.twin.objective.terms if t.is_prior)
    match = match_matrix(instance)
    spread = sigma[:, np.newaxis] * prior.correlate(  # K S, (size, rows)
        sigma[:, np.newaxis] * match.T.toarray(), layout
    )
    noise = np.nan_to_num(instance.target_uncertainty).ravel() ** 2
    middle = match @ spread + np.diag(noise)
    variance = sigma**2 - 2 * np.sum(gain * spread, axis=1) + np.sum((gain @ middle) * gain, axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def sensitivity(result: JointResult) -> Array:
    """Return d alpha / d T in 1/s, (n_materials, n_bands, n_configurations, n_bands).

    For an independent prior matched exactly: d alpha_F / db = S_F sigma_F² / sum over free of
    S² sigma², times db/dT. Coefficients at a bound stay there: it is valid until the next bound.
    """
    layout = result.solution.twin.instance.layout
    by_time = _by_time(result, bounds=True)[: layout.n_alpha]
    shape = (layout.n_rows, layout.n_bands, layout.n_configurations, layout.n_bands)
    return np.asarray(by_time.reshape(shape)[list(layout.rows)])


def _slopes(result: JointResult) -> Array:
    """db/dT of every matched row, (rows,); 0 where T is missing."""
    rooms = result.configurations.rooms
    slopes: Array = np.array([
        result.equation.target_sensitivity(room, own.reverberation_time)
        for room, own in zip(rooms, result.data, strict=True)
    ])  # fmt: skip
    return np.asarray(np.nan_to_num(slopes).ravel())


def _by_time(result: JointResult, *, bounds: bool) -> Array:
    """D u / d T, (size, rows of T): the derivative of the optimality conditions.

    H du + A' dy = -d(gradient), A du = d(limits), over the unknowns that are free and the rows
    that are active; with ``bounds=False`` as if no unknown were at a bound.
    """
    solution = result.solution
    twin, u = solution.twin, solution.unknowns
    instance = twin.instance
    free = twin.movable & (solution.active == 0) if bounds else twin.movable
    active = (twin.row_lower == twin.row_upper) | (np.abs(solution.multipliers.rows) > 0)
    active &= np.asarray(twin.squares @ (twin.sigma * free) ** 2) > 0
    upper = (solution.multipliers.rows > 0) | (twin.row_lower == twin.row_upper)
    n_times = instance.time.size
    d_gradient = np.zeros((len(u), n_times))
    d_limit = np.zeros((len(active), n_times))
    for place in np.flatnonzero(np.isfinite(instance.time).ravel()):
        ends = [_at_time(result, int(place), s) for s in (1 - _STEP, 1 + _STEP)]
        width = 2 * _STEP * instance.time.ravel()[place]
        d_gradient[:, place] = (ends[1].gradient(u) - ends[0].gradient(u)) / width
        limits = [np.where(upper, t.row_upper, t.row_lower) for t in ends]
        here = active & np.isfinite(limits[0]) & np.isfinite(limits[1])
        d_limit[here, place] = (limits[1][here] - limits[0][here]) / width
    return _kkt_solve(twin, u, free, active, d_gradient, d_limit)


def _at_time(result: JointResult, place: int, factor: float) -> Twin:
    """The twin of the same problem with one T multiplied by ``factor``."""
    configuration, band = divmod(place, result.solution.twin.instance.layout.n_bands)
    data = list(result.data)
    times = data[configuration].reverberation_time.copy()
    times[band] *= factor
    data[configuration] = replace(data[configuration], reverberation_time=times)
    twin = result.solution.twin
    new: Instance = result.assemble(data)
    return Twin(new, twin.objective, twin.row_constraints)


def _kkt_solve(
    twin: Twin, u: Array, free: Flags, active: Flags, d_gradient: Array, d_limit: Array
) -> Array:
    scale = twin.sigma[free]
    curvature = twin.curvature(u)
    rows = sp.csr_array(twin.matrix)[active][:, free] * scale
    norm = np.sqrt(np.asarray((rows**2).sum(axis=1)).ravel())
    rows = sp.csr_array(sp.diags_array(1 / norm) @ rows)
    right = -d_gradient[free] * scale[:, np.newaxis]
    limit = d_limit[active] / norm[:, np.newaxis]
    out = np.zeros((len(u), d_gradient.shape[1]))
    if sp.issparse(curvature):
        from scipy.sparse.linalg import splu

        own = sp.csr_array(sp.diags_array(scale) @ curvature[free][:, free] @ sp.diags_array(scale))
        exact = sp.csc_array(sp.block_array([[own, rows.T], [rows, None]]))
        shift = 1e-12 * np.concatenate([np.ones(len(scale)), -np.ones(rows.shape[0])])
        factor = splu(sp.csc_array(exact + sp.diags_array(shift)))
        wanted = np.concatenate([right, limit])
        found = factor.solve(wanted)
        for _ in range(3):
            found = found + factor.solve(wanted - exact @ found)
        out[free] = scale[:, np.newaxis] * found[: len(scale)]
        return out
    diagonal = (curvature[free] * scale**2)[:, np.newaxis]
    schur = (rows / diagonal.ravel()) @ rows.T
    pull = np.linalg.lstsq(schur.toarray(), rows @ (right / diagonal) - limit, rcond=1e-12)[0]
    out[free] = scale[:, np.newaxis] * (right - rows.T @ pull) / diagonal
    return out
