"""The scattering of a path tracing, fitted beside the absorption.

Nobody states how a room scatters as a tracer takes it. The traced paths tell how every observation
depends on the scattering of each material (`PathTracing.scattering_jacobian`). So the scattering
coefficients are unknowns as alpha is, with a wide prior around those stated. A first linear step fits
them to what was measured. The room is traced once more with them, and the calibration's steps move them
on from there.

Control runs differ in scattering, too. They tell what the other meaning of the coefficients adds, and
which error is left: it is larger where less is scattered. The noise of the control runs is no part of
it. In five development rooms the log-likelihood of what was measured was 9 to 21 nats higher without
that noise, and with the likeliest scale of the error. In eight it was 15 nats higher in sum with errors
that grow where little is scattered, and runs far from the line counting less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from rtcal.loop.control_runs import MODELS, SCATTERING, ControlRuns, level, share_of_signal
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.tracer import ScatteringModel
from rtcal.support.files import json_numbers
from rtcal.support.types import Array

OWN, COMMON = 0.8, 1.0
"""Standard deviations of the log odds ln(s / (1 - s)): of a material's from the mean of all, and of
that mean from what is stated. Around 0.4 each leaves 0.23 to 0.60 within one deviation."""
_MOST = 3.0
"""Largest change of the log odds: from 0.4 to 0.03 or 0.93."""
COMMON_LEFT = 0.2
"""Share of the variance common to all pairs that is left, as materials' scattering counts apart. In
thirteen rooms the gap at held-out pairs was 0.73 times that of T20 alone with all of it, 0.68 with 0.4
and 0.66 with 0.2; the median error of alpha 0.92, 0.92 and 0.88 times."""
DIGITS = 1
"""To which log odds are rounded before the room is traced: nearly the same data then have the same
paths."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattering:
    """Scattering of a tracer, fitted with alpha. It is no measurement of the room's.

    Attributes
    ----------
    model : {"random", "vector"}
        Meaning of the coefficients; see `rtcal.simulators.tracer.ScatteringModel`.
    coefficients : array (n_materials, n_bands)
    sigma : array (n_materials, n_bands)
        Their posterior standard deviations, linear in the log odds; 0 where they are 0 or 1.
    mean : float
        Mean coefficient over the surfaces, by area.
    limited : tuple of int
        Numbers of the materials whose coefficients moved as far as they may.
    """

    model: ScatteringModel
    coefficients: Array
    sigma: Array
    mean: float
    limited: tuple[int, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return model, mean, coefficients and their sigma as text and numbers."""
        return {
            "model": self.model,
            "mean": self.mean,
            "coefficients": json_numbers(self.coefficients),
            "sigma": json_numbers(self.sigma),
        }

    def notes(self, materials: Sequence[str]) -> list[str]:
        """Return what is to be known of it; ``materials`` are the room's."""
        notes = [
            f"Scattering: {self}, fitted with alpha. It is no measurement: another seed or more paths "
            "may give other coefficients. Of both meanings of the coefficients, random and vector, the "
            f'fit takes the one under which the measurement is likelier: here "{self.model}".'
        ]
        if self.limited:
            names = ", ".join(materials[i] for i in self.limited)
            notes.append(
                f"The scattering of {names} moved as far as it may: the data do not tell it."
            )
        return notes

    def __str__(self) -> str:
        low, high = self.coefficients.min(), self.coefficients.max()
        return f"{self.mean:.2f} in the mean, {low:.2f} to {high:.2f} ({self.model})"


@dataclass(frozen=True, kw_only=True, eq=False)
class MaterialScattering:
    """Sensitivity of every value to the scattering of each material, around the traced one.

    Attributes
    ----------
    slope : array (n, n_materials)
        Derivatives of all values, n = parameters x pairs x bands, by the log odds.
    traced : array (n_materials,)
        Change of the log odds, from those stated to those traced.
    model : {"random", "vector"}
        With which they were traced.
    """

    slope: Array
    traced: Array
    model: ScatteringModel = "random"

    @property
    def prior(self) -> Array:
        """Covariance of the changes of the log odds, (n_materials, n_materials)."""
        n = len(self.traced)
        return np.asarray(OWN**2 * np.eye(n) + COMMON**2)

    @property
    def covariance(self) -> Array:
        """Covariance of the values by the scattering that is not known, (n, n)."""
        return np.asarray(self.slope @ self.prior @ self.slope.T)

    @property
    def back(self) -> Array:
        """Change of the values from the traced scattering to the stated one, (n,)."""
        return np.asarray(-self.slope @ self.traced)

    def likely(self, pull: Array) -> Array:
        """Return the likeliest change of the log odds from those stated, (n_materials,).

        ``pull`` (n,) is the inverse covariance of what was measured times what is left unexplained
        with the scattering stated; 0 where nothing was measured.
        """
        likeliest = self.prior @ (self.slope.T @ pull)
        return np.asarray(np.clip(likeliest, -_MOST, _MOST))

    def posterior(self, used: NDArray[np.int64], covariance: Array) -> Array:
        """Return the standard deviations of the log odds after what was measured, (n_materials,).

        ``covariance`` (n_used, n_used) is that of the values used, with alpha and scattering unknown.
        """
        across = self.slope[used] @ self.prior
        left = self.prior - across.T @ np.linalg.solve(covariance, across)
        return np.asarray(np.sqrt(np.maximum(np.diag(left), 0.0)))


def material_scattering(
    tracer: PathTracing, alpha: Array, parameters: Sequence[str], traced: Array, seed: int
) -> MaterialScattering:
    """Return how the values of a tracer depend on the scattering of each material.

    The differences between pairs are drawn towards their mean as far as they are noise. DataError for
    a tracer with another scattering model than "random".
    """
    groups = tracer.scattering_jacobian(alpha, parameters, number=2, seed=seed)
    slope = groups.mean(axis=0)
    common = slope.mean(axis=1, keepdims=True)
    off = (groups[0] - groups[1]) / 2
    noise = ((off - off.mean(axis=1, keepdims=True)) ** 2).mean(axis=(1, 2, 3), keepdims=True)
    share = share_of_signal(((slope - common) ** 2).mean(axis=(1, 2, 3), keepdims=True), noise)
    return MaterialScattering(
        slope=(common + share * (slope - common)).reshape(-1, slope.shape[-1]), traced=traced
    )


def scattered(tracer: PathTracing, log_odds: Array, model: ScatteringModel) -> PathTracing:
    """Return the tracer with other coefficients: their log odds are changed by ``log_odds``.

    (n_materials,), the same in all bands. Coefficients of 0 and 1 stay.
    """
    s = tracer.scattering
    odds = np.exp(log_odds)[:, np.newaxis]
    return replace(tracer, scattering=s * odds / (1 - s + s * odds), scattering_model=model)


def fitted(tracer: PathTracing, log_odds: Array, posterior: Array) -> Scattering:
    """Return the scattering of a tracer, whose log odds were changed and have standard deviations.

    Both (n_materials,).
    """
    s = tracer.scattering
    return Scattering(
        model=tracer.scattering_model,
        coefficients=s,
        sigma=s * (1 - s) * posterior[:, np.newaxis],
        mean=level(s, tracer.room.areas),
        limited=tuple(np.flatnonzero(np.abs(log_odds) >= _MOST).tolist()),
    )


@dataclass(frozen=True, eq=False)
class ErrorsByScattering:
    """The simulator's errors as control runs tell them, by level and model of scattering.

    Attributes
    ----------
    of_model : array (n_parameters, n_pairs, n_bands)
        What the model "vector" adds to every value.
    """

    of_model: Array
    _line: _Line
    _covariance: Array = field(repr=False)
    _of_coefficients: Array = field(repr=False)

    def covariance(self, level: float, model: ScatteringModel) -> Array:
        """Return the covariance of all values at a level of scattering, (n, n)."""
        at = np.clip(level, *SCATTERING)
        row = basis([at], [MODELS.index(model)])[0]
        # What a few runs leave uncertain of the coefficients: the leverage of the level.
        leverage = row @ self._line.spread @ row
        size = len(self._covariance) // len(self._line.power)  # values of a parameter
        deviation = np.repeat(self._line.deviation([at])[0], size)
        covariance = self._covariance + leverage * self._of_coefficients
        return np.asarray(deviation[:, np.newaxis] * covariance * deviation)


def errors_by_scattering(controls: ControlRuns, noise: Array) -> ErrorsByScattering | None:
    """Return how the errors of control runs depend on scattering.

    None if the runs are too few, or do not differ in scattering. ``noise`` (n_parameters, n_bands) is
    the variance of a run's values by its finite number of paths.
    """
    if controls.levels is None or len(controls.errors) < 4 * _COEFFICIENTS:
        return None
    line = _line(controls.errors, controls.levels, controls.models)
    if line is None:
        return None
    left = replace(controls, errors=line.left)
    coefficients, share = _pooled(line.coefficients, line.left, np.array(np.diag(line.spread)))
    return ErrorsByScattering(
        coefficients[1],
        line,
        left.without_noise(noise).with_common(COMMON_LEFT**0.5).covariance(),
        left.with_own(np.sqrt(share.mean(axis=0))).covariance(),
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
    share = share_of_signal(differences, noise)
    return common + share[..., np.newaxis, np.newaxis] * (coefficients - common), share


def log_likelihood(residual: Array, covariance: Array) -> float:
    """Return the normal log-likelihood without its constant."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, residual, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(factor)).sum())


def basis(levels: ArrayLike, models: ArrayLike) -> Array:
    """Return the columns that a value depends on, (n, 3): nearly orthogonal over the control runs."""
    level, model = np.asarray(levels, dtype=float), np.asarray(models, dtype=float)
    return np.stack([np.ones_like(level), model - 0.5, level - np.mean(SCATTERING)], axis=1)
