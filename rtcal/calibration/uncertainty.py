"""Densities and derivatives of a solution, for `rtcal.posterior` and the plausibility."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.stats import truncnorm

from rtcal.acoustics.equations import LinearEquation
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.convex_program import Solution
from rtcal.calibration.numpy_model import NumpyModel
from rtcal.calibration.posterior import Densities, Optimality, linear_estimate_sigma
from rtcal.calibration.problem_data import MeasuredTimes, ProblemData
from rtcal.calibration.terms import (
    ExactMatch,
    LinearObservations,
    PriorDeviation,
    RoomMatch,
    SoftMatch,
    match_matrix,
)
from rtcal.support.errors import ModelError
from rtcal.support.truncated import Density
from rtcal.support.types import Array

Assemble = Callable[[Sequence[MeasuredTimes]], ProblemData]

_STEP = 1e-5
"""Relative step of T in central differences: their error is of the order of its square."""


def density(solution: Solution) -> Densities:
    """Return the densities of the unknowns with the measurement and without it.

    Raises ModelError if the objective is not a log-density.
    """
    model = solution.model
    prior = _prior(solution)
    if not isinstance(prior, PriorDeviation) or prior.sigma is not None:
        raise ModelError(
            f"{prior!r} is no log-density of what is known of alpha: it has no posterior. Use "
            'method "soft" or "mle"'
        )
    data, layout = model.data, model.data.layout
    missing = np.full_like(data.target, np.nan)
    unmeasured = replace(data, target=missing, time=missing)
    return Densities(
        rows=layout.rows,
        n_bands=layout.n_bands,
        further=layout.further,
        separate=_independent(model, prior),
        posterior=_density(model, solution.unknowns),
        prior=_density(
            NumpyModel(unmeasured, model.objective, model.row_constraints), solution.unknowns
        ),
    )


def optimality(
    solution: Solution, measured_times: Sequence[MeasuredTimes], assemble: Assemble, *, bounds: bool
) -> Optimality:
    """Return the optimality conditions at the answer and their derivatives with respect to T.

    Without ``bounds``, no unknown counts as being at a bound and the covariance of b does not depend on
    T, as the error of a linear estimate requires. With ``bounds``, u_b = |db/dT| u_T depends on T.
    """
    model, u = solution.model, solution.unknowns
    data = model.data
    equality = model.row_lower == model.row_upper
    multipliers = solution.multipliers.rows
    free = model.movable & (solution.active == 0) if bounds else model.movable
    active = equality | (np.abs(multipliers) > 0)
    active &= np.asarray(model.squares @ (model.sigma * free) ** 2) > 0
    upper = (multipliers > 0) | equality
    before, after = (
        _with_times(solution, measured_times, assemble, factor, noise_follows=bounds)
        for factor in (1 - _STEP, 1 + _STEP)
    )
    width = 2 * _STEP * data.time.ravel()
    # But for a RoomMatch, each row of a match depends on its own T alone, and no other term on any.
    pull_by_time = np.zeros((data.time.size, data.time.size))
    for term, weight in zip(model.objective.terms, data.weights, strict=True):
        if isinstance(term, RoomMatch):
            pull_by_time += weight * _by_every_time(term.pull(u, data), data, before, after, width)
        elif isinstance(term, SoftMatch):
            change = term.pull(u, after.data) - term.pull(u, before.data)
            pull_by_time += np.diag(weight * np.nan_to_num(change.ravel() / width))
    gradient_by_time = match_matrix(data).T @ pull_by_time
    limits = [np.where(upper, m.row_upper, m.row_lower) for m in (before, after)]
    changing = active & np.isfinite(limits[0]) & np.isfinite(limits[1])
    limit_by_time = np.zeros((len(active), data.time.size))
    for row in np.flatnonzero(changing & (model.row_place >= 0)):
        place = model.row_place[row]
        limit_by_time[row, place] = (limits[1][row] - limits[0][row]) / width[place]
    return Optimality(
        rows=data.layout.rows,
        n_bands=data.layout.n_bands,
        n_configurations=data.layout.n_configurations,
        curvature=model.curvature(u),
        matrix=model.matrix,
        scale=model.sigma,
        free=free,
        active=active,
        gradient_by_time=gradient_by_time,
        limit_by_time=limit_by_time,
    )


def _by_every_time(
    pull: Array, data: ProblemData, before: NumpyModel, after: NumpyModel, width: Array
) -> Array:
    """Return the derivatives of a `RoomMatch`'s pull by every T, (n_matches, n_matches).

    The pull is C⁻¹(S'alpha - b). b, u_b and the changes of one row depend on its own T alone.
    """

    def by_time(name: str) -> Array:
        change = getattr(after.data, name) - getattr(before.data, name)
        return np.asarray(np.nan_to_num(change.reshape(-1, len(width)) / width))

    pull, noise = np.nan_to_num(pull.ravel()), np.nan_to_num(data.target_uncertainty.ravel())
    of_noise = 2 * noise * by_time("target_uncertainty")[0] * pull
    difference = np.diag(by_time("target")[0] + of_noise)
    if data.room_changes.size:
        changes, moved = data.room_changes, by_time("room_changes")
        difference += (changes.T @ moved) * pull + np.diag(moved.T @ (changes @ pull))
    return np.asarray(-data.match_whitener.T @ (data.match_whitener @ difference))


def estimate_sigma(
    solution: Solution,
    configurations: Configurations,
    equation: LinearEquation,
    measured_times: Sequence[MeasuredTimes],
    assemble: Assemble,
) -> Array:
    """Return the standard deviation of the linear estimate's error, (size,) over the unknowns.

    The prior's covariance is the room's, also if the method assumes another covariance. An unknown
    uncertainty of T counts as 0. With linear observations it is the Gaussian posterior's, with the
    objective's prior.
    """
    if any(isinstance(t, LinearObservations) for t in solution.model.objective.terms):
        return _gaussian_sigma(solution.model, solution.unknowns)
    gain = _gain(solution, configurations, equation, measured_times, assemble)
    return linear_estimate_sigma(gain, *_covariances(solution, configurations))


def estimate_covariance(
    solution: Solution,
    configurations: Configurations,
    equation: LinearEquation,
    measured_times: Sequence[MeasuredTimes],
    assemble: Assemble,
) -> Array:
    """Return the covariance of the error of `estimate_sigma`, (n_bands, n_materials, n_materials)."""
    layout = solution.model.data.layout
    gain = _gain(solution, configurations, equation, measured_times, assemble)
    sigma, shift, prior = _room_prior(solution, configurations)
    _, cross, innovation = _covariances(solution, configurations)
    n = layout.n_alpha
    columns = np.eye(len(sigma), n) * sigma[:n]
    whole = sigma[:n, np.newaxis] * prior.correlate(columns, layout)[:n]
    whole = whole + np.outer(shift[:n], shift[:n])
    change = gain[:n] @ cross[:n].T
    whole = whole - change - change.T + gain[:n] @ innovation @ gain[:n].T
    rows = np.array(layout.rows) * layout.n_bands
    return np.array([whole[np.ix_(rows + k, rows + k)] for k in range(layout.n_bands)])


def _gain(
    solution: Solution,
    configurations: Configurations,
    equation: LinearEquation,
    measured_times: Sequence[MeasuredTimes],
    assemble: Assemble,
) -> Array:
    """Return d u / d b in 1/m², (size, n_matches), without bounds."""
    slopes = [
        equation.target_sensitivity(room, measured.reverberation_time)
        for room, measured in zip(configurations.rooms, measured_times, strict=True)
    ]
    by_time = optimality(solution, measured_times, assemble, bounds=False).derivative()
    by_target = np.nan_to_num(np.ravel(slopes))
    return np.asarray(by_time / np.where(by_target != 0, by_target, 1.0))


def _gaussian_sigma(model: NumpyModel, u: Array) -> Array:
    """Return the square root of the diagonal of the inverse curvature, within the equalities.

    An uncertain target of an equality adds its share.
    """
    free = model.movable
    covariance = np.linalg.inv(_dense(model.curvature(u).whole())[np.ix_(free, free)])
    exact = (model.row_lower == model.row_upper) & (model.row_norm > 0)
    if exact.any():
        rows = _dense(model.matrix[exact][:, free])
        across = covariance @ rows.T
        gain = np.linalg.solve(rows @ across, across.T).T
        covariance = covariance - gain @ across.T + (gain * _row_noise(model)[exact] ** 2) @ gain.T
    sigma = np.zeros(len(u))
    sigma[free] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return sigma


def gaussian_interval(solution: Solution, sigma: Array, mass: float) -> tuple[Array, Array]:
    """Return the ends of the unknowns' intervals, (size,) each, of a normal density within the box.

    ``sigma`` (size,) is the standard deviation without the box. Each interval holds the answer.
    """
    u, model = solution.unknowns, solution.model
    free = sigma > 0
    spread = np.where(free, sigma, 1.0)
    mean = unbounded(solution, spread)
    low, high = (model.lower - mean) / spread, (model.upper - mean) / spread
    ends = [truncnorm.ppf(share, low, high) for share in ((1 - mass) / 2, (1 + mass) / 2)]
    lower, upper = (np.where(free, mean + spread * end, u) for end in ends)
    return np.minimum(lower, u), np.maximum(upper, u)


def unbounded(solution: Solution, sigma: Array) -> Array:
    """Return where the unknowns would be without the box, (size,): m sigma² beyond a bound.

    m is the bound's multiplier, ``sigma`` (size,) the standard deviation without the box.
    """
    held = solution.multipliers.upper - solution.multipliers.lower
    return np.asarray(solution.unknowns + held * sigma**2)


def _row_noise(model: NumpyModel) -> Array:
    """Standard uncertainty of what each row is equal to in m², (n_rows,); 0 where it is unknown."""
    noise = np.append(np.nan_to_num(model.data.target_uncertainty).ravel(), 0.0)
    return np.asarray(noise[model.row_place])


def _dense(matrix: Any) -> Array:
    """A matrix as an array; a vector is its diagonal."""
    if sp.issparse(matrix):
        return np.asarray(matrix.toarray())
    return np.diag(matrix) if matrix.ndim == 1 else np.asarray(matrix)


def innovation(solution: Solution, configurations: Configurations) -> tuple[Array, Array]:
    """Return b - S'mu in m², (n_configurations * n_bands,), and its covariance S'KS + U.

    K is the prior's covariance with the room's sigma and correlations. U is that of b through T (0
    where unknown) and through the volume, areas and climate that the room calls uncertain. The sizes
    of effects have their own prior. b is NaN in a band without a match. An unreachable band counts with
    the b of its measured T, or with the nearest reachable b if no b has that T.
    """
    data = solution.model.data
    target = data.target.copy()
    for band in solution.unreachable:
        if np.isfinite(band.target):
            place = data.layout.centre_frequencies.index(band.frequency)
            target[band.configuration, place] = band.target
    *_, covariance = _covariances(solution, configurations)
    return target.ravel() - match_matrix(data) @ data.mu, covariance


def _prior(solution: Solution) -> object:
    return next(term for term in solution.model.objective.terms if term.is_prior)


def _independent(model: NumpyModel, prior: PriorDeviation) -> bool:
    """Whether no term couples bands and each band has at most one matched sum."""
    layout = model.data.layout
    return (
        layout.n_configurations == 1
        and not layout.further
        and not prior.correlated()
        and all(isinstance(t, PriorDeviation | SoftMatch) for t in model.objective.terms)
        and not any(isinstance(t, RoomMatch) for t in model.objective.terms)
        and all(isinstance(r, ExactMatch) for r in model.row_constraints)
        and len(model.objective.terms) + len(model.row_constraints) <= 2
    )


def _density(model: NumpyModel, u: Array) -> Density:
    """The density of the unknowns: a match with an uncertain b gives its sum to within u_b."""
    equal = model.row_lower == model.row_upper
    layout = model.data.layout
    names = np.argsort(np.argsort([layout.materials[i] for i in layout.first]))
    rank = (names[:, np.newaxis] * layout.n_bands + np.arange(layout.n_bands)).ravel()
    return Density(
        point=u,
        gradient=model.gradient(u),
        curvature=model.curvature(u).whole(),
        scale=model.sigma,
        lower=model.lower,
        upper=model.upper,
        matrix=model.matrix,
        row_lower=model.row_lower,
        row_upper=model.row_upper,
        row_noise=np.where(equal, _row_noise(model), 0.0),
        rank=np.append(rank, np.arange(layout.n_alpha, len(u))),
    )


def _with_times(
    solution: Solution,
    measured_times: Sequence[MeasuredTimes],
    assemble: Assemble,
    factor: float,
    *,
    noise_follows: bool,
) -> NumpyModel:
    """Return the same problem with every T multiplied by ``factor``."""
    model = solution.model
    data = assemble(
        [replace(m, reverberation_time=factor * m.reverberation_time) for m in measured_times]
    )
    if not noise_follows:
        held = model.data
        data = replace(
            data, target_uncertainty=held.target_uncertainty, room_changes=held.room_changes
        )
    return NumpyModel(data, model.objective, model.row_constraints)


def _room_prior(
    solution: Solution, configurations: Configurations
) -> tuple[Array, Array, PriorDeviation]:
    """The prior's sigma over the unknowns, what all have in common (size,), and their correlation."""
    data = solution.model.data
    layout, room = data.layout, configurations.union
    sigma = np.concatenate([room.sigma[layout.first].ravel(), data.further(data.sigma)])
    prior = _prior(solution)
    if not (isinstance(prior, PriorDeviation) and prior.correlated()):
        # The plausibility uses the room's correlations, also for a method without them (lse).
        prior = PriorDeviation(
            band_correlation=room.band_correlation, material_correlation=room.material_correlation
        )
    return sigma, np.where(sigma > 0, data.common_shift, 0.0), prior


def _covariances(solution: Solution, configurations: Configurations) -> tuple[Array, Array, Array]:
    """The prior's sigma over the unknowns (size,), K S (size, n_rows), and S'KS + U."""
    data = solution.model.data
    layout = data.layout
    sigma, shift, prior = _room_prior(solution, configurations)
    match = match_matrix(data)
    cross = sigma[:, np.newaxis] * prior.correlate(sigma[:, np.newaxis] * match.T.toarray(), layout)
    cross = cross + np.outer(shift, match @ shift)
    total = np.hypot(sigma, shift)
    return total, cross, np.asarray(match @ cross + data.target_covariance)
