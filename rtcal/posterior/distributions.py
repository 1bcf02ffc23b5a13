"""What is known of alpha after the calibration: uncertainty, sensitivity, identifiability.

`posterior` gives the distribution within the bounds: exact marginals by FFT where the priors are
independent and each band has one matched row, else samples. `estimate_sigma` is the cheap linear
answer that the calibrated room carries; `sensitivity` is how the answer follows T.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.instance import Flags, Instance
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.terms import ExactMatch, PriorDeviation, SoftMatch, match_matrix
from rtcal.calibration.twin import Twin
from rtcal.errors import DataError, ModelError
from rtcal.posterior.marginals import POINTS, marginals, unmatched
from rtcal.posterior.sampler import sample
from rtcal.support import checks
from rtcal.support.types import Array

_STEP = 1e-5
"""Relative step of T in the differences that tell how the problem's numbers follow T."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """The distribution of alpha given the measurement.

    Attributes
    ----------
    mean, sigma : array (n_materials, n_bands)
    correlation : array (n_bands, n_materials, n_materials)
        Between materials in one band.
    points, cumulative : array (n_materials, n_bands, n_points)
        The distribution function of every coefficient.
    prior_sigma : array (n_materials, n_bands)
        Before the measurement, within the bounds.
    samples : array (n_samples, n_materials, n_bands), optional
        Where sampling was needed.
    effects : dict of str to array (n_samples,)
        Samples of the sizes of further unknowns.
    """

    mean: Array
    sigma: Array
    correlation: Array
    points: Array
    cumulative: Array
    prior_sigma: Array
    samples: Array | None = None
    effects: dict[str, Array] = field(default_factory=dict)

    def quantile(self, probability: float) -> Array:
        """Return the quantile of every coefficient, (n_materials, n_bands)."""
        checks.number("probability", probability)
        if not 0 < probability < 1:
            raise DataError(f"probability = {probability:g} is not between 0 and 1")
        out = np.empty_like(self.mean)
        for i, k in np.ndindex(*out.shape):
            out[i, k] = np.interp(probability, self.cumulative[i, k], self.points[i, k])
        return out

    def interval(self, level: float = 0.9) -> tuple[Array, Array]:
        """Return the ends of the central credible interval, both (n_materials, n_bands)."""
        checks.number("level", level)
        if not 0 < level < 1:
            raise DataError(f"level = {level:g} is not between 0 and 1")
        return self.quantile((1 - level) / 2), self.quantile((1 + level) / 2)

    @property
    def identifiability(self) -> Array:
        """1 - posterior variance / prior variance, (n_materials, n_bands).

        1: the measurement tells the coefficient; 0: it was not learnt at all, and what the
        calibration says of it is what was stated before. Slightly below 0 where the measurement
        moves a coefficient away from a bound that had cut its prior short.
        """
        before = self.prior_sigma**2
        ratio = np.divide(self.sigma**2, before, out=np.ones_like(before), where=before > 0)
        return np.asarray(1 - ratio)


def posterior(
    result: CalibrationResult | JointResult, n_samples: int = 4000, seed: int = 0
) -> Posterior:
    """Return the posterior distribution of a calibration's coefficients.

    The prior is normal with the room's sigma, truncated to the bounds; the error of b is normal
    with u_b (0 with an exact match).

    Parameters
    ----------
    result : CalibrationResult or JointResult
    n_samples : int
        Where sampling is needed.
    seed : int

    Raises
    ------
    ModelError
        If the objective is no log-density of what is known: a prior with one sigma for all
        (`lse`), or a `HuberDeviation`.
    SolverError
        If sampling was needed and its chains disagree.
    DataError
        If ``result`` is none, or ``n_samples`` or ``seed`` no whole number.

    Examples
    --------
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2(), method="soft")
    >>> low, high = posterior(result).interval(0.9)
    >>> bool(((low < result.alpha) & (result.alpha < high)).all())
    True
    """
    joint = _joint(result)
    checks.whole("n_samples", n_samples, 1)
    checks.whole("seed", seed, 0)
    prior = next(t for t in joint.solution.twin.objective.terms if t.is_prior)
    if not isinstance(prior, PriorDeviation) or prior.sigma is not None:
        raise ModelError(
            f"{prior!r} is no log-density of what is known of alpha: it has no posterior. Use "
            'method "soft" or "mle"'
        )
    return marginal_posterior(joint) or _sampled(joint, n_samples, seed)


def marginal_posterior(result: JointResult) -> Posterior | None:
    """Return the posterior where it takes no sampling, else None: `posterior`'s quick half.

    That is one matched row a band and independent priors with their own sigma.
    """
    twin = result.solution.twin
    prior = next(t for t in twin.objective.terms if t.is_prior)
    if not isinstance(prior, PriorDeviation) or prior.sigma is not None:
        return None
    return _by_fft(result) if _one_row_a_band(twin, prior) else None


def _joint(result: CalibrationResult | JointResult) -> JointResult:
    if not isinstance(result, CalibrationResult | JointResult):
        raise DataError(f"result = {result!r} is not the result of a calibration")
    return result.joint if isinstance(result, CalibrationResult) else result


def _one_row_a_band(twin: Twin, prior: PriorDeviation) -> bool:
    layout = twin.instance.layout
    return (
        layout.n_configurations == 1
        and not layout.further
        and not prior.correlated()
        and all(isinstance(t, PriorDeviation | SoftMatch) for t in twin.objective.terms)
        and all(isinstance(r, ExactMatch) for r in twin.row_constraints)
        and len(twin.objective.terms) + len(twin.row_constraints) <= 2
    )


def _by_fft(result: JointResult) -> Posterior:
    solution = result.solution
    instance, u = solution.twin.instance, solution.unknowns
    layout = instance.layout
    alpha, scale = instance.alpha(u), instance.alpha(instance.scale)
    mu, lower, upper = (instance.alpha(v) for v in (instance.mu, instance.lower, instance.upper))
    areas, target = instance.areas[0], instance.target[0]
    soft = [
        w
        for t, w in zip(solution.twin.objective.terms, instance.weights, strict=True)
        if isinstance(t, SoftMatch)
    ]
    pull = np.nan_to_num(solution.match_multipliers[0])
    noise = np.zeros(layout.n_bands)
    if soft:
        # A weight other than 1 says that u_b is another one.
        noise = np.nan_to_num(instance.target_uncertainty[0]) / np.sqrt(max(soft[0], 1e-300))
        miss = areas @ alpha - np.nan_to_num(target)
        pull = np.divide(miss, noise**2, out=np.zeros_like(miss), where=noise > 0)
    shape = (layout.n_rows, layout.n_bands)
    points, cumulative = np.zeros((*shape, POINTS)), np.zeros((*shape, POINTS))
    mean, sigma, before = alpha.copy(), np.zeros(shape), np.zeros(shape)
    correlation = np.tile(np.eye(layout.n_rows), (layout.n_bands, 1, 1))
    points[...], cumulative[...] = alpha[:, :, np.newaxis], np.linspace(0, 1, POINTS)
    for k in range(layout.n_bands):
        free = np.flatnonzero(scale[:, k] > 0)
        if not len(free):
            continue
        own = (mu[free, k], scale[free, k], lower[free, k], upper[free, k])
        known = float(areas @ np.where(scale[:, k] > 0, 0.0, alpha[:, k]))
        alone = unmatched(*own)
        before[free, k] = np.sqrt(np.diag(alone.covariance))
        if not np.isfinite(target[k]):
            found = alone
        elif not soft and (solution.active.reshape(shape)[free, k] != 0).all():
            continue  # b at an end of its reach leaves one answer
        else:
            found = marginals(
                *own, areas[free], float(target[k]) - known, float(noise[k]), float(pull[k])
            )
        points[free, k], cumulative[free, k] = (
            found.points,
            _distribution(found.points, found.density),
        )
        mean[free, k] = found.mean
        spread = np.sqrt(np.diag(found.covariance))
        sigma[free, k] = spread
        correlation[k][np.ix_(free, free)] = found.covariance / np.outer(spread, spread)
    rows = list(layout.rows)
    return Posterior(
        mean[rows],
        sigma[rows],
        correlation[:, rows][:, :, rows],
        points[rows],
        cumulative[rows],
        before[rows],
    )


def _distribution(points: Array, density: Array) -> Array:
    width = np.diff(points, axis=-1)
    cells = 0.5 * (density[:, 1:] + density[:, :-1]) * width
    total = np.concatenate([np.zeros((len(points), 1)), np.cumsum(cells, axis=1)], axis=1)
    return np.asarray(total / total[:, -1:])


def _sampled(result: JointResult, n_samples: int, seed: int) -> Posterior:
    solution = result.solution
    twin, layout = solution.twin, solution.twin.instance.layout
    drawn = sample(twin, solution.unknowns, n_samples, seed)
    alpha = drawn[:, : layout.n_alpha].reshape(-1, layout.n_rows, layout.n_bands)
    alpha = alpha[:, list(layout.rows)]
    ordered = np.moveaxis(np.sort(alpha, axis=0), 0, -1)
    levels = (np.arange(len(drawn)) + 0.5) / len(drawn)
    sigma = alpha.std(axis=0, ddof=1)
    correlation = np.empty((layout.n_bands, alpha.shape[1], alpha.shape[1]))
    for k in range(layout.n_bands):
        centred = (alpha[:, :, k] - alpha[:, :, k].mean(axis=0)) / np.where(
            sigma[:, k] > 0, sigma[:, k], 1.0
        )
        correlation[k] = centred.T @ centred / (len(drawn) - 1)
        np.fill_diagonal(correlation[k], 1.0)
    # The prior of the same terms without the measurement, in the same box.
    blind = replace(
        twin.instance,
        target=np.full_like(twin.instance.target, np.nan),
        time=np.full_like(twin.instance.time, np.nan),
    )
    prior = Twin(blind, twin.objective, twin.row_constraints)
    before = sample(prior, solution.unknowns, n_samples, seed + 1)
    return Posterior(
        mean=alpha.mean(axis=0),
        sigma=sigma,
        correlation=correlation,
        points=ordered,
        cumulative=np.broadcast_to(levels, ordered.shape),
        prior_sigma=layout.expand(before.std(axis=0, ddof=1)),
        samples=alpha,
        effects={name: drawn[:, layout.n_alpha + p] for p, name in enumerate(layout.further)},
    )


def estimate_sigma(result: JointResult) -> Array:
    """Return the standard deviation of the estimate's error, (size,) over the unknowns.

    The estimate is linear where no bound is active: its error is (1 - B S')(mu - alpha) + B e with
    B = d alpha / db, S' the matched rows and e the error of b. With the prior's covariance K and
    the uncertainty U of b,  cov = (1 - B S') K (1 - B S')' + B U B'.  Where T's uncertainty is
    unknown it counts as 0. Right for every method, also for one whose own sigma is not the room's.
    """
    slopes = _slopes(result)
    gain = _by_time(result, bounds=False) / np.where(slopes != 0, slopes, 1.0)
    sigma, spread, middle = _known(result)
    variance = sigma**2 - 2 * np.sum(gain * spread, axis=1) + np.sum((gain @ middle) * gain, axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def miss(result: JointResult) -> tuple[Array, Array]:
    """Return how far b is from what was known, and the covariance that it should have.

    b - S'mu in m², (n_configurations * n_bands,), NaN where nothing was matched; and S'KS + U, K the
    prior's covariance with the room's own sigma and the stated correlations, U that of b (0 where
    unknown). An effect counts with its own prior. An unreachable band counts with the b that its T
    asks for, not with the end that was taken (but with the end where no b has that T).
    """
    instance = result.solution.twin.instance
    *_, covariance = _known(result)
    target = instance.target.copy()
    for beyond in result.solution.unreachable:
        band = instance.layout.centre_frequencies.index(beyond.frequency)
        if np.isfinite(beyond.target):
            target[beyond.configuration, band] = beyond.target
    return target.ravel() - match_matrix(instance) @ instance.mu, covariance


def _known(result: JointResult) -> tuple[Array, Array, Array]:
    """The prior's sigma over the unknowns; K S; S'KS + U: with what the room states of itself."""
    instance = result.solution.twin.instance
    layout = instance.layout
    room = result.configurations.union
    sigma = np.concatenate([room.sigma[layout.first].ravel(), instance.further(instance.sigma)])
    prior = next(t for t in result.solution.twin.objective.terms if t.is_prior)
    if not (isinstance(prior, PriorDeviation) and prior.correlated()):
        # A method that leaves the correlations out of its objective (lse) is judged with them.
        prior = PriorDeviation(
            band_correlation=room.band_correlation, material_correlation=room.material_correlation
        )
    match = match_matrix(instance)
    spread = sigma[:, np.newaxis] * prior.correlate(
        sigma[:, np.newaxis] * match.T.toarray(), layout
    )
    noise = np.nan_to_num(instance.target_uncertainty).ravel() ** 2
    return sigma, spread, np.asarray(match @ spread + np.diag(noise))


def sensitivity(result: CalibrationResult | JointResult) -> Array:
    """Return d alpha / d T in 1/s, (n_materials, n_bands, n_configurations, n_bands).

    For an independent prior matched exactly: d alpha_F / db = S_F sigma_F² / sum over free of
    S² sigma², times db/dT. Coefficients at a bound stay there: it is valid until the next bound.
    """
    joint = _joint(result)
    layout = joint.solution.twin.instance.layout
    by_time = _by_time(joint, bounds=True)[: layout.n_alpha]
    shape = (layout.n_rows, layout.n_bands, layout.n_configurations, layout.n_bands)
    return np.asarray(by_time.reshape(shape)[list(layout.rows)])


def _slopes(result: JointResult) -> Array:
    """db/dT of every matched row, (rows,); 0 where T is missing."""
    rooms = result.configurations.rooms
    slopes: Array = np.array(
        [
            result.equation.target_sensitivity(room, own.reverberation_time)
            for room, own in zip(rooms, result.data, strict=True)
        ]
    )
    return np.asarray(np.nan_to_num(slopes).ravel())


def _by_time(result: JointResult, *, bounds: bool) -> Array:
    """D u / d T, (size, rows of T): the derivative of the optimality conditions.

    H du + A' dy = -d(gradient), A du = d(limits), over the unknowns that are free and the rows
    that are active; with ``bounds=False`` as if no unknown were at a bound, and with u_b kept, as
    the error of a linear estimate needs it (else u_b = |db/dT| u_T follows T too).
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
        ends = [_at_time(result, int(place), s, bounds) for s in (1 - _STEP, 1 + _STEP)]
        width = 2 * _STEP * instance.time.ravel()[place]
        d_gradient[:, place] = (ends[1].gradient(u) - ends[0].gradient(u)) / width
        limits = [np.where(upper, t.row_upper, t.row_lower) for t in ends]
        here = active & np.isfinite(limits[0]) & np.isfinite(limits[1])
        d_limit[here, place] = (limits[1][here] - limits[0][here]) / width
    return _kkt_solve(twin, u, free, active, d_gradient, d_limit)


def _at_time(result: JointResult, place: int, factor: float, noise_follows: bool) -> Twin:
    """The twin of the same problem with one T multiplied by ``factor``."""
    configuration, band = divmod(place, result.solution.twin.instance.layout.n_bands)
    data = list(result.data)
    times = data[configuration].reverberation_time.copy()
    times[band] *= factor
    data[configuration] = replace(data[configuration], reverberation_time=times)
    twin = result.solution.twin
    new: Instance = result.assemble(data)
    if not noise_follows:
        new = replace(new, target_uncertainty=twin.instance.target_uncertainty)
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
