"""The scattering of a path tracing, fitted beside the absorption.

Nobody states how a room scatters as a tracer takes it. Control runs differ in it, so they tell how
every observation depends on the level of scattering, under both meanings of the coefficient. What was
measured then tells which level is likely, and the room is traced once more with it. What is left of
the simulator's error is what the level does not explain, and how uncertain the level is. The noise of
the control runs is no part of it.

In five development rooms the log-likelihood of what was measured was 9 to 21 nats higher without that
noise, with `_pooled` coefficients, and with the likeliest scale of the error. In eight it was 15 nats
higher in sum with errors that grow where little is scattered, and runs far from the line counting less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from rtcal.loop.control_runs import MODELS, SCATTERING, ControlRuns, scattering_around
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.paths import ScatteringModel
from rtcal.support.types import Array

_COEFFICIENTS = 3
"""Of every value's dependence on scattering: a constant, one for the other model, and a slope. In ten
development rooms polynomials of degree 2 for each model predicted unfitted pairs less well."""
_PASSES = 2
"""Times that the weights of the control runs are found anew."""
_POWERS = (-4.0, 0.5)
"""Limits of the power of the level that a variance is proportional to."""
_RIDGE = 0.3
"""Draws the powers towards 0: variance of ln of a run's mean square (1.2) over that of a power (4)."""
_FREEDOM = 4
"""Degrees of freedom of Student's t distribution."""
_NEGLIGIBLE = 1e-4
"""Probability of a level below which its covariance does not count."""
_GRID = 31
"""Levels tried, from 0.1 to 0.85. Their mean is rounded to one of them: nearly the same data then have
the same paths."""


@dataclass(frozen=True, kw_only=True)
class Scattering:
    """Level of scattering that what was measured tells.

    Attributes
    ----------
    model : {"random", "vector"}
        Meaning of the coefficients; see `rtcal.simulators.paths.ScatteringModel`.
    level : float
        Mean coefficient over the surfaces, by area. It is the level with which this tracer predicts
        best, and no measurement of the room's scattering.
    """

    model: ScatteringModel
    level: float

    def __str__(self) -> str:
        return f"{self.level:.2f} ({self.model})"


@dataclass(frozen=True, kw_only=True, eq=False)
class ScatteringFit:
    """The likely scattering, what it adds to every value, and the errors that are left.

    Attributes
    ----------
    scattering : Scattering
    shift : array (n_parameters, n_pairs, n_bands)
    covariance : array (n, n)
        Of the simulator's error with the shift, n = parameters x pairs x bands.
    """

    scattering: Scattering
    shift: Array
    covariance: Array


def fitted(
    controls: ControlRuns,
    innovation: Array,
    expected: Array,
    used: NDArray[np.int64],
    noise: Array,
) -> ScatteringFit | None:
    """Return what the scattering explains of the difference from what was measured.

    None if the control runs are too few, or do not differ in scattering.

    Parameters
    ----------
    controls : ControlRuns
        Errors of the simulator with the scattering stated.
    innovation : array (n_used,)
        What was measured less what this simulator hears with the prior.
    expected : array (n_used, n_used)
        Its covariance without the simulator's error.
    used : int array (n_used,)
        Which of all n values of the control runs were measured.
    noise : array (n_parameters, n_bands)
        Variance of a run's values by its finite number of paths.
    """
    if controls.levels is None or len(controls.errors) < 4 * _COEFFICIENTS:
        return None
    line = _line(controls.errors, controls.levels, controls.models)
    if line is None:
        return None
    left = replace(controls, errors=line.left)
    covariance = left.without_noise(noise).covariance()
    coefficients, share = _pooled(line.coefficients, line.left, np.array(np.diag(line.spread)))
    of_coefficients = left.with_own(np.sqrt(share.mean(axis=0))).covariance()
    levels = np.tile(np.linspace(*SCATTERING, _GRID), len(MODELS))
    models = np.repeat(np.arange(len(MODELS)), _GRID)
    rows = basis(levels, models)
    shifts = rows @ coefficients.reshape(_COEFFICIENTS, -1)
    # What a few runs leave uncertain of the coefficients: the leverage of the level.
    leverage = np.sum(rows @ line.spread * rows, axis=1)
    size = shifts.shape[1] // len(line.power)  # values of a parameter
    deviations = np.repeat(line.deviation(levels), size, axis=1)

    def at(i: int) -> Array:
        """Return the covariance of the errors with a level and model."""
        of_level = covariance + leverage[i] * of_coefficients
        return np.asarray(deviations[i][:, np.newaxis] * of_level * deviations[i])

    logs = [
        log_likelihood(innovation - shifts[i, used], expected + at(i)[np.ix_(used, used)])
        for i in range(len(rows))
    ]
    probability = np.exp(np.array(logs) - max(logs))
    probability /= probability.sum()
    model = int(np.argmax(np.bincount(models, probability)))
    within = np.where(models == model, probability, 0.0)
    within /= within.sum()
    level = float(levels[np.argmin(np.abs(levels - within @ levels))])
    scattering = Scattering(model=MODELS[model], level=level)
    shift = shifts[np.argmax((models == model) & (levels == level))]
    away = shifts - shift
    uncertain = (away.T * probability) @ away
    for i in np.flatnonzero(probability > _NEGLIGIBLE):
        uncertain += probability[i] * at(int(i))
    return ScatteringFit(
        scattering=scattering,
        shift=shift.reshape(controls.errors.shape[1:]),
        covariance=np.asarray(uncertain),
    )


@dataclass(frozen=True)
class _Line:
    """Control runs' errors as a straight line over the level of scattering, and what it leaves.

    ``coefficients`` (3, n_parameters, n_pairs, n_bands) belong to `basis`, ``spread`` (3, 3) is their
    covariance over the variance of what is left. ``left``, as the errors, is divided by `deviation`.
    """

    coefficients: Array
    spread: Array
    left: Array
    power: Array
    middle: float

    def deviation(self, levels: ArrayLike) -> Array:
        """Return the deviations from the line over those at the middle, (n, n_parameters)."""
        ratio = np.asarray(levels, dtype=float)[:, np.newaxis] / self.middle
        return np.asarray(ratio ** (self.power / 2))


def _line(errors: Array, levels: Array, models: Sequence[ScatteringModel]) -> _Line | None:
    """Fit the errors (n_runs, ...) by weighted least squares; None if the runs do not tell the line.

    Where little is scattered, a room departs most from the line: the variance of T20's error is about
    inverse to the level squared, that of C80's hardly depends on it. So each parameter's variance is a
    power of the level. Runs far from the line count less, as under Student's t distribution.
    """
    runs, n_parameters = errors.shape[:2]
    columns = basis(levels, [MODELS.index(m) for m in models])
    if np.linalg.matrix_rank(columns) < _COEFFICIENTS:
        return None
    middle = float(np.exp(np.mean(np.log(levels))))
    log_level = np.log(levels / middle)
    power, weight = np.zeros(n_parameters), np.ones((runs, n_parameters))
    for last in (False,) * _PASSES + (True,):
        root = np.sqrt(weight) * np.exp(-0.5 * np.outer(log_level, power))
        coefficients, left = np.empty((_COEFFICIENTS, *errors.shape[1:])), np.empty_like(errors)
        spread = np.zeros((_COEFFICIENTS, _COEFFICIENTS))
        for p in range(n_parameters):
            weighted = root[:, p, np.newaxis] * columns
            values = errors[:, p].reshape(runs, -1)
            solved = np.linalg.lstsq(weighted, root[:, p, np.newaxis] * values, rcond=None)[0]
            off = root[:, p, np.newaxis] * (values - columns @ solved)
            coefficients[:, p] = solved.reshape(coefficients[:, p].shape)
            left[:, p] = np.sqrt(runs / (runs - _COEFFICIENTS)) * off.reshape(left[:, p].shape)
            spread += np.linalg.inv(weighted.T @ weighted) / n_parameters
        if last:
            break
        deviation = np.sqrt((left**2).mean(axis=(0, 2), keepdims=True))
        square = ((left / np.where(deviation > 0, deviation, 1.0)) ** 2).mean(axis=(2, 3))
        logs = np.log(np.maximum(square / root**2, 1e-12))
        power = log_level @ (logs - logs.mean(axis=0)) / (log_level @ log_level + _RIDGE)
        power = np.clip(power, *_POWERS)
        weight = (_FREEDOM + 1) / (_FREEDOM + square / weight)
    return _Line(coefficients, spread, left, power, middle)


def _pooled(coefficients: Array, left: Array, spread: Array) -> tuple[Array, Array]:
    """Draw the coefficients of all pairs towards their mean, as far as noise makes them differ.

    Parameters
    ----------
    coefficients : array (3, n_parameters, n_pairs, n_bands)
    left : array (n_runs, n_parameters, n_pairs, n_bands)
        What the coefficients leave of the errors.
    spread : array (3,)
        Variance of each coefficient over that of what is left.

    Returns
    -------
    coefficients : array (3, n_parameters, n_pairs, n_bands)
    share : array (3, n_parameters)
        Of the differences between pairs that is kept: signal over signal and noise (James & Stein
        1961, with the variances estimated).
    """
    common = coefficients.mean(axis=2, keepdims=True)
    noise = ((left - left.mean(axis=2, keepdims=True)) ** 2).mean(axis=0).sum(axis=(1, 2))
    noise = spread[:, np.newaxis] * noise
    differences = ((coefficients - common) ** 2).sum(axis=(2, 3))
    share = np.divide(noise, differences, out=np.ones_like(noise), where=differences > noise)
    share = 1 - share
    return common + share[..., np.newaxis, np.newaxis] * (coefficients - common), share


def log_likelihood(residual: Array, covariance: Array) -> float:
    """Return the normal log-likelihood without its constant."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, residual, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(factor)).sum())


def with_scattering(tracer: PathTracing, scattering: Scattering) -> PathTracing:
    """Return the tracer with another level of scattering; surfaces and bands differ as before."""
    level = scattering_around(tracer.scattering, tracer.room.areas, scattering.level)
    return replace(tracer, scattering=level, scattering_model=scattering.model)


def basis(levels: ArrayLike, models: ArrayLike) -> Array:
    """Return the columns that a value depends on, (n, 3): nearly orthogonal over the control runs."""
    level, model = np.asarray(levels, dtype=float), np.asarray(models, dtype=float)
    return np.stack([np.ones_like(level), model - 0.5, level - np.mean(SCATTERING)], axis=1)
