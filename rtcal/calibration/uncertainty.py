"""What `rtcal.posterior` and the plausibility take from a solution: densities and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.equations import LinearEquation
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.core import Solution
from rtcal.calibration.instance import Instance
from rtcal.calibration.measured import Measured
from rtcal.calibration.terms import ExactMatch, PriorDeviation, SoftMatch, match_matrix
from rtcal.calibration.twin import Twin
from rtcal.errors import ModelError
from rtcal.posterior.density import CoupledBands, IndependentBands, TruncatedNormal
from rtcal.posterior.sensitivities import Optimality, linear_estimate_sigma
from rtcal.support.types import Array

Assemble = Callable[[Sequence[Measured]], Instance]

_STEP = 1e-5
"""Relative step of T in central differences: their error is of the order of its square."""


def density(solution: Solution) -> IndependentBands | CoupledBands:
    """Return the density of the unknowns given the measurement.

    Raises ModelError if the objective is not a log-density.
    """
    twin = solution.twin
    prior = _prior(solution)
    if not isinstance(prior, PriorDeviation) or prior.sigma is not None:
        raise ModelError(
            f"{prior!r} is no log-density of what is known of alpha: it has no posterior. Use "
            'method "soft" or "mle"'
        )
    if _independent(twin, prior):
        return _independent_bands(solution)
    instance, layout = twin.instance, twin.instance.layout
    missing = np.full_like(instance.target, np.nan)
    unmeasured = replace(instance, target=missing, time=missing)
    return CoupledBands(
        rows=layout.rows,
        n_bands=layout.n_bands,
        further=layout.further,
        posterior=_truncated_normal(twin, solution.unknowns),
        prior=_truncated_normal(
            Twin(unmeasured, twin.objective, twin.row_constraints), solution.unknowns
        ),
    )


def optimality(
    solution: Solution, data: Sequence[Measured], assemble: Assemble, *, bounds: bool
) -> Optimality:
    """Return the optimality conditions at the answer and their derivatives with respect to T.

    Without ``bounds`` no unknown counts as being at a bound, and u_b is kept where T changes: the
    error of a linear estimate needs both. With them u_b = |db/dT| u_T follows T.
    """
    twin, u = solution.twin, solution.unknowns
    instance = twin.instance
    equality = twin.row_lower == twin.row_upper
    multipliers = solution.multipliers.rows
    free = twin.movable & (solution.active == 0) if bounds else twin.movable
    active = equality | (np.abs(multipliers) > 0)
    active &= np.asarray(twin.squares @ (twin.sigma * free) ** 2) > 0
    upper = (multipliers > 0) | equality
    gradient_by_time = np.zeros((len(u), instance.time.size))
    limit_by_time = np.zeros((len(active), instance.time.size))
    for place in np.flatnonzero(np.isfinite(instance.time).ravel()):
        before, after = (
            _with_time(solution, data, assemble, int(place), factor, noise_follows=bounds)
            for factor in (1 - _STEP, 1 + _STEP)
        )
        width = 2 * _STEP * instance.time.ravel()[place]
        gradient_by_time[:, place] = (after.gradient(u) - before.gradient(u)) / width
        limits = [np.where(upper, t.row_upper, t.row_lower) for t in (before, after)]
        changing = active & np.isfinite(limits[0]) & np.isfinite(limits[1])
        limit_by_time[changing, place] = (limits[1] - limits[0])[changing] / width
    return Optimality(
        rows=instance.layout.rows,
        n_bands=instance.layout.n_bands,
        n_configurations=instance.layout.n_configurations,
        curvature=twin.curvature(u),
        matrix=twin.matrix,
        scale=twin.sigma,
        free=free,
        active=active,
        gradient_by_time=gradient_by_time,
        limit_by_time=limit_by_time,
    )


def estimate_sigma(
    solution: Solution,
    configurations: Configurations,
    equation: LinearEquation,
    data: Sequence[Measured],
    assemble: Assemble,
) -> Array:
    """Return the standard deviation of the linear estimate's error, (size,) over the unknowns.

    The prior's covariance is the room's, also for a method that assumes another one. An unknown
    uncertainty of T counts as 0.
    """
    slopes = [
        equation.target_sensitivity(room, measured.reverberation_time)
        for room, measured in zip(configurations.rooms, data, strict=True)
    ]
    by_time = optimality(solution, data, assemble, bounds=False).derivative()
    by_target = np.nan_to_num(np.ravel(slopes))
    gain = by_time / np.where(by_target != 0, by_target, 1.0)
    return linear_estimate_sigma(gain, *_covariances(solution, configurations))


def innovation(solution: Solution, configurations: Configurations) -> tuple[Array, Array]:
    """Return b - S'mu in m², (n_configurations * n_bands,), and its covariance S'KS + U.

    K is the prior's covariance with the room's sigma and correlations, and U that of b (0 where
    unknown). The sizes of effects have their own prior. Where nothing was matched b is NaN. An
    unreachable band counts with the b that its T asks for, or with the end that was taken if no b
    has that T.
    """
    instance = solution.twin.instance
    target = instance.target.copy()
    for band in solution.unreachable:
        if np.isfinite(band.target):
            place = instance.layout.centre_frequencies.index(band.frequency)
            target[band.configuration, place] = band.target
    *_, covariance = _covariances(solution, configurations)
    return target.ravel() - match_matrix(instance) @ instance.mu, covariance


def _prior(solution: Solution) -> object:
    return next(term for term in solution.twin.objective.terms if term.is_prior)


def _independent(twin: Twin, prior: PriorDeviation) -> bool:
    """Whether no term couples bands and each band has at most one matched sum."""
    layout = twin.instance.layout
    return (
        layout.n_configurations == 1
        and not layout.further
        and not prior.correlated()
        and all(isinstance(t, PriorDeviation | SoftMatch) for t in twin.objective.terms)
        and all(isinstance(r, ExactMatch) for r in twin.row_constraints)
        and len(twin.objective.terms) + len(twin.row_constraints) <= 2
    )


def _independent_bands(solution: Solution) -> IndependentBands:
    instance, u = solution.twin.instance, solution.unknowns
    alpha, sigma = instance.alpha(u), instance.alpha(instance.scale)
    areas, target = instance.areas[0], instance.target[0]
    multiplier = np.nan_to_num(solution.match_multipliers[0])
    noise = np.zeros(instance.layout.n_bands)
    weights = [
        weight
        for term, weight in zip(solution.twin.objective.terms, instance.weights, strict=True)
        if isinstance(term, SoftMatch)
    ]
    for weight in weights:
        # A weight other than 1 says that u_b is another one; at 0 the match says nothing.
        noise = np.nan_to_num(instance.target_uncertainty[0]) / np.sqrt(max(weight, 1e-300))
        residual = areas @ alpha - np.nan_to_num(target)
        multiplier = np.divide(residual, noise**2, out=np.zeros_like(residual), where=noise > 0)
    at_bound = (solution.active.reshape(alpha.shape) != 0) | (sigma == 0)
    return IndependentBands(
        rows=instance.layout.rows,
        mu=instance.alpha(instance.mu),
        sigma=sigma,
        lower=instance.alpha(instance.lower),
        upper=instance.alpha(instance.upper),
        alpha=alpha,
        areas=areas,
        target=target,
        noise=noise,
        multiplier=multiplier,
        at_end=(noise == 0) & at_bound.all(axis=0),
    )


def _truncated_normal(twin: Twin, u: Array) -> TruncatedNormal:
    return TruncatedNormal(
        point=u,
        gradient=twin.gradient(u),
        curvature=twin.curvature(u),
        scale=twin.sigma,
        lower=twin.lower,
        upper=twin.upper,
        matrix=twin.matrix,
        row_lower=twin.row_lower,
        row_upper=twin.row_upper,
    )


def _with_time(
    solution: Solution,
    data: Sequence[Measured],
    assemble: Assemble,
    place: int,
    factor: float,
    *,
    noise_follows: bool,
) -> Twin:
    """The same problem with one T multiplied by ``factor``."""
    twin = solution.twin
    configuration, band = divmod(place, twin.instance.layout.n_bands)
    times = data[configuration].reverberation_time.copy()
    times[band] *= factor
    changed = list(data)
    changed[configuration] = replace(data[configuration], reverberation_time=times)
    instance = assemble(changed)
    if not noise_follows:
        instance = replace(instance, target_uncertainty=twin.instance.target_uncertainty)
    return Twin(instance, twin.objective, twin.row_constraints)


def _covariances(solution: Solution, configurations: Configurations) -> tuple[Array, Array, Array]:
    """The room's sigma over the unknowns (size,), K S (size, n_rows), and S'KS + U."""
    instance = solution.twin.instance
    layout, room = instance.layout, configurations.union
    sigma = np.concatenate([room.sigma[layout.first].ravel(), instance.further(instance.sigma)])
    prior = _prior(solution)
    if not (isinstance(prior, PriorDeviation) and prior.correlated()):
        # A method that leaves the correlations out of its objective (lse) is judged with them.
        prior = PriorDeviation(
            band_correlation=room.band_correlation, material_correlation=room.material_correlation
        )
    match = match_matrix(instance)
    cross = sigma[:, np.newaxis] * prior.correlate(sigma[:, np.newaxis] * match.T.toarray(), layout)
    noise = np.nan_to_num(instance.target_uncertainty).ravel() ** 2
    return sigma, cross, np.asarray(match @ cross + np.diag(noise))
