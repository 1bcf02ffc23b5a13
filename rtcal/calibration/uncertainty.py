"""Densities and derivatives of a solution, for `rtcal.posterior` and the plausibility."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.stats import truncnorm

from rtcal.calibration.measured import MeasuredTimes
from rtcal.calibration.posterior import Densities, Density, linear_estimate_sigma
from rtcal.calibration.qp import QP, System
from rtcal.calibration.solution import JointSolution
from rtcal.calibration.terms import (
    ExactMatch,
    LinearObservations,
    PriorDeviation,
    SoftMatch,
)
from rtcal.calibration.unknowns import Flags, Numbers
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

_STEP = 1e-5
"""Relative step of T in central differences: their error is of the order of its square."""
_ROUNDING = 1e-13
"""Curvature between two unknowns, of the root of the product of their own, that is rounding."""


def density(joint: JointSolution) -> Densities:
    """Return the densities of the unknowns with the measurement and without it.

    Raises ModelError if the objective is not a log-density.
    """
    prior, numbers, layout = joint.composition.prior, joint.numbers, joint.composition.layout
    if not isinstance(prior, PriorDeviation) or prior.sigma is not None:
        raise ModelError(
            f"{prior!r} is no log-density of what is known of alpha: it has no posterior. Use "
            'method "soft" or "mle"'
        )

    def unmeasured() -> Density:
        missing = np.full_like(numbers.target, np.nan)
        return _density(joint, replace(numbers, target=missing, time=missing))

    return Densities(
        rows=layout.rows,
        n_bands=layout.n_bands,
        further=layout.further,
        separate=_independent(joint, prior),
        posterior=_density(joint, numbers),
        prior=unmeasured,
    )


def by_time(joint: JointSolution, *, bounds: bool) -> Array:
    """Return du / dT in 1/s, (size, n_times), one T per configuration and band.

    Without ``bounds``, no unknown counts as being at a bound and the covariance of b does not depend on
    T, as the error of a linear estimate requires. With ``bounds``, u_b = |db/dT| u_T depends on T.

    The optimality conditions on the active set are differentiated: the matrices by differences.
    """
    qp, point, numbers = joint.qp, joint.solution.point, joint.numbers
    at = point.at.copy()
    if not bounds:
        at[qp.compiled.unknowns] = 0
    free = (at == 0) & ~qp.fixed
    system = System(qp, free, qp.equal | (point.y > 0))
    ends = [_with_times(joint, factor, bounds) for factor in (1 - _STEP, 1 + _STEP)]
    slopes = np.zeros((len(qp.compiled.unknowns), numbers.time.size))
    for place, time in enumerate(numbers.time.ravel()):
        if not all(np.isfinite(end.target.ravel()[place]) for end in ends):
            continue
        before, after = (joint.composition.qp(_at_one(numbers, end, place)) for end in ends)
        force = before.force(point.v, point.y) - after.force(point.v, point.y)
        limit = after.b - after.rows(point.v) - (before.b - before.rows(point.v))
        dv, _ = system.solve(force, limit)
        slopes[:, place] = numbers.sigma * dv[qp.compiled.unknowns] / (2 * _STEP * time)
    return slopes


def _with_times(joint: JointSolution, factor: float, noise_follows: bool) -> Numbers:
    """Return the same numbers with every T multiplied by ``factor``."""
    measured: Sequence[MeasuredTimes] = [
        replace(m, reverberation_time=factor * m.reverberation_time) for m in joint.measured_times
    ]
    numbers = joint.numbers_of(measured)
    if not noise_follows:
        held = joint.numbers
        numbers = replace(
            numbers, target_uncertainty=held.target_uncertainty, room_changes=held.room_changes
        )
    return numbers


def _at_one(numbers: Numbers, other: Numbers, place: int) -> Numbers:
    """Return the numbers with what depends on one T of other numbers."""
    changed = {}
    for name in ("time", "target", "target_uncertainty", "target_sensitivity"):
        values = getattr(numbers, name).copy()
        values.ravel()[place] = getattr(other, name).ravel()[place]
        changed[name] = values
    if numbers.room_changes.size:
        changes = numbers.room_changes.copy()
        changes[:, place] = other.room_changes[:, place]
        changed["room_changes"] = changes
    return replace(numbers, **changed)


def estimate_sigma(joint: JointSolution) -> Array:
    """Return the standard deviation of the linear estimate's error, (size,) over the unknowns.

    The prior's covariance is the room's, also if the method assumes another covariance. An unknown
    uncertainty of T counts as 0. With linear observations it is the Gaussian posterior's, with the
    objective's prior.
    """
    if any(isinstance(t, LinearObservations) for t in joint.composition.objective.terms):
        return _gaussian_sigma(joint)
    return linear_estimate_sigma(_gain(joint), *_covariances(joint))


def estimate_covariance(joint: JointSolution) -> Array:
    """Return the covariance of the error of `estimate_sigma`, (n_bands, n_materials, n_materials)."""
    layout, gain = joint.composition.layout, _gain(joint)
    sigma, shift, prior = _room_prior(joint)
    _, cross, innovation = _covariances(joint)
    n = layout.n_alpha
    columns = np.eye(len(sigma), n) * sigma[:n]
    whole = sigma[:n, np.newaxis] * prior.correlate(columns, layout)[:n]
    whole = whole + np.outer(shift[:n], shift[:n])
    change = gain[:n] @ cross[:n].T
    whole = whole - change - change.T + gain[:n] @ innovation @ gain[:n].T
    rows = np.array(layout.rows) * layout.n_bands
    return np.array([whole[np.ix_(rows + k, rows + k)] for k in range(layout.n_bands)])


def _gain(joint: JointSolution) -> Array:
    """Return d u / d b in 1/m², (size, n_matches), without bounds."""
    pairs = zip(joint.configurations.rooms, joint.measured_times, strict=True)
    slopes = [joint.equation.target_sensitivity(r, m.reverberation_time) for r, m in pairs]
    by_target = np.nan_to_num(np.ravel(slopes))
    return by_time(joint, bounds=False) / np.where(by_target != 0, by_target, 1.0)


def _gaussian_sigma(joint: JointSolution) -> Array:
    """Return the square root of the diagonal of the inverse curvature, within the equalities.

    An uncertain target of an equality adds its share.
    """
    qp, numbers = joint.qp, joint.numbers
    places = qp.compiled.unknowns
    at = joint.solution.point.at.copy()
    at[places] = 0
    system = System(qp, (at == 0) & ~qp.fixed, qp.equal)
    noise = _row_noise(joint)
    exact = np.flatnonzero(noise > 0)
    no_force, no_limit = np.zeros(len(qp.c)), np.zeros(len(qp.b))
    variance = np.array(
        [system.solve(_one(no_force, place), no_limit)[0][place] for place in places]
    )
    for row in exact.tolist():
        variance += (system.solve(no_force, _one(no_limit, row) * noise)[0][places]) ** 2
    return np.where(numbers.movable, numbers.sigma * np.sqrt(np.maximum(variance, 0.0)), 0.0)


def _one(zeros: Array, place: int) -> Array:
    """Return zeros with a 1 at one place."""
    one = zeros.copy()
    one[place] = 1.0
    return one


def gaussian_interval(joint: JointSolution, sigma: Array, mass: float) -> tuple[Array, Array]:
    """Return the ends of the unknowns' intervals, (size,) each, of a normal density within the box.

    ``sigma`` (size,) is the standard deviation without the box. Each interval holds the answer.
    """
    u, numbers = joint.solution.unknowns, joint.numbers
    free = sigma > 0
    spread = np.where(free, sigma, 1.0)
    mean = unbounded(joint, spread)
    low, high = (numbers.lower - mean) / spread, (numbers.upper - mean) / spread
    ends = [truncnorm.ppf(share, low, high) for share in ((1 - mass) / 2, (1 + mass) / 2)]
    lower, upper = (np.where(free, mean + spread * end, u) for end in ends)
    return np.minimum(lower, u), np.maximum(upper, u)


def unbounded(joint: JointSolution, sigma: Array) -> Array:
    """Return where the unknowns would be without the box, (size,): m sigma² beyond a bound.

    m is the bound's multiplier, ``sigma`` (size,) the standard deviation without the box.
    """
    point, places = joint.solution.point, joint.qp.compiled.unknowns
    held = (point.upper - point.lower)[places] * joint.numbers.inverse_sigma
    return np.asarray(joint.solution.unknowns + held * sigma**2)


def _row_noise(joint: JointSolution) -> Array:
    """Standard uncertainty of what each row is equal to in m², (n_rows,); 0 where it is unknown."""
    noise = np.zeros(len(joint.qp.b))
    of_target = np.nan_to_num(joint.numbers.target_uncertainty).ravel()
    for term, rows in joint.composition.rows_of:
        if isinstance(term, ExactMatch) and len(rows) == 1:
            noise[rows[0]] = of_target
    return np.where(joint.qp.row_size > 0, noise, 0.0)


def innovation(joint: JointSolution) -> tuple[Array, Array]:
    """Return b - S'mu in m², (n_configurations * n_bands,), and its covariance S'KS + U.

    K is the prior's covariance with the room's sigma and correlations. U is that of b through T (0
    where unknown) and through the volume, areas and climate that the room calls uncertain. The sizes
    of effects have their own prior. b is NaN in a band without a match. An unreachable band counts with
    the b of its measured T, or with the nearest reachable b if no b has that T.
    """
    numbers = joint.numbers
    target = numbers.target.copy()
    for band in joint.solution.unreachable:
        if np.isfinite(band.target):
            place = numbers.layout.centre_frequencies.index(band.frequency)
            target[band.configuration, place] = band.target
    *_, covariance = _covariances(joint)
    return target.ravel() - numbers.match_matrix @ numbers.mu, covariance


def _independent(joint: JointSolution, prior: PriorDeviation) -> bool:
    """Whether no term couples bands and each band has at most one matched sum."""
    composed = joint.composition
    parts = composed.objective.terms + tuple(composed.rows)
    return (
        composed.layout.n_configurations == 1
        and not composed.layout.further
        and not prior.correlated
        and all(type(t) in (PriorDeviation, SoftMatch) for t in composed.objective.terms)
        and all(type(r) is ExactMatch for r in composed.rows)
        and len(parts) <= 2
    )


def _reduced(qp: QP, x: Array) -> tuple[Array, Array, Flags]:
    """Return gradient and curvature by the unknowns' deviations at x, and the rows that remain.

    The other variables take their best value: those that a row defines, and those that are free.
    """
    places = qp.compiled.unknowns
    other = np.ones(len(qp.c), dtype=bool)
    other[places] = False
    defining = qp.magnitudes.rows(1.0 * other) > 0
    v = np.zeros(len(qp.c))
    v[places] = x
    system = System(qp, other, defining)
    dv, y = system.solve(-qp.gradient(v), qp.b - qp.rows(v))
    gradient = qp.force(v + dv, y)[places]
    P, A = qp.matrices
    across, rows = P[:, places].toarray(), A[:, places].toarray()
    change, pull = system.solve(-across, -rows)
    curvature = across[places] + P[places] @ change + A.T[places] @ pull
    return gradient, (curvature + curvature.T) / 2, ~defining & (qp.row_size > 0)


def _density(joint: JointSolution, numbers: Numbers) -> Density:
    """The density of the unknowns: a match with an uncertain b gives its sum to within u_b."""
    qp, u, layout = joint.composition.qp(numbers), joint.solution.unknowns, numbers.layout
    unit, places = numbers.inverse_sigma, joint.composition.compiled.unknowns
    x = np.where(numbers.sigma > 0, (u - numbers.mu) * unit, joint.solution.point.v[places])
    gradient, curvature, kept = _reduced(qp, x)
    # What rounding leaves of unknowns that nothing couples would make one part of them.
    size = np.sqrt(np.abs(np.diag(curvature)))
    curvature = np.where(np.abs(curvature) > _ROUNDING * np.outer(size, size), curvature, 0.0)
    own = sp.csr_array(qp.matrices[1][:, places] @ sp.diags_array(unit))[kept]
    limit = qp.b[kept] + own @ numbers.mu
    noise = _row_noise(joint)[kept]
    names = np.argsort(np.argsort([layout.materials[i] for i in layout.first]))
    rank = (names[:, np.newaxis] * layout.n_bands + np.arange(layout.n_bands)).ravel()
    return Density(
        point=u,
        gradient=gradient * unit,
        curvature=sp.csr_array(curvature * np.outer(unit, unit)),
        scale=np.where(numbers.movable, numbers.sigma, 0.0),
        lower=numbers.lower,
        upper=numbers.upper,
        matrix=own,
        row_lower=np.where(qp.equal[kept], limit, -np.inf),
        row_upper=limit,
        row_noise=noise,
        rank=np.append(rank, np.arange(layout.n_alpha, len(u))),
    )


def _room_prior(joint: JointSolution) -> tuple[Array, Array, PriorDeviation]:
    """The prior's sigma over the unknowns, what all have in common (size,), and their correlation."""
    numbers, room, prior = joint.numbers, joint.configurations.union, joint.composition.prior
    of_alpha = room.sigma[numbers.layout.first].ravel()
    sigma = np.concatenate([of_alpha, numbers.further(numbers.sigma)])
    if not (isinstance(prior, PriorDeviation) and prior.correlated):
        # The plausibility uses the room's correlations, also for a method without them (lse).
        prior = PriorDeviation(
            band_correlation=room.band_correlation, material_correlation=room.material_correlation
        )
    return sigma, np.where(sigma > 0, numbers.common_shift, 0.0), prior


def _covariances(joint: JointSolution) -> tuple[Array, Array, Array]:
    """The prior's sigma over the unknowns (size,), K S (size, n_rows), and S'KS + U."""
    numbers = joint.numbers
    sigma, shift, prior = _room_prior(joint)
    match = numbers.match_matrix
    columns = sigma[:, np.newaxis] * match.T.toarray()
    if prior.correlated:
        columns = prior.correlate(columns, numbers.layout)
    cross = sigma[:, np.newaxis] * columns + np.outer(shift, match @ shift)
    total = np.hypot(sigma, shift)
    return total, cross, np.asarray(match @ cross + numbers.target_covariance)
