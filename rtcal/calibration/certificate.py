"""The certificate: how far an answer is from the optimum, computed from the terms' NumPy descriptions.

It uses nothing that a solver states. A few lines of NumPy repeat it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.calibration.layout import Layout
from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.separable import separable
from rtcal.support.types import Array

_EPS = np.finfo(float).eps


@dataclass(frozen=True, repr=False)
class Certificate:
    """Residuals of the optimality conditions, each (n_bands,).

    Attributes
    ----------
    primal_residual : array
        The larger of |S'alpha - b| / sum S and the violation of the box.
    dual_residual : array
        max |sigma (gradient + S D - z_lower + z_upper)| over sigma > 0.
    duality_gap : array
        sum z_lower (alpha - lower) + z_upper (upper - alpha).
    alpha_error_bound : array (n_materials, n_bands)
        Largest possible distance of each coefficient from the optimum. If the problem is separable, the
        exact dual encloses the optimum (`rtcal.calibration.separable`); elsewhere strong convexity
        bounds the distance.
    """

    primal_residual: Array
    dual_residual: Array
    duality_gap: Array
    alpha_error_bound: Array

    @property
    def worst(self) -> float:
        """The largest of the three residuals over all bands."""
        return float(
            max(np.max(r) for r in (self.primal_residual, self.dual_residual, self.duality_gap))
        )

    def __repr__(self) -> str:
        return (
            f"<Certificate: worst residual {self.worst:.1e}, alpha within "
            f"{np.max(self.alpha_error_bound):.1e} of the optimum>"
        )


def certify(model: NumpyModel, u: Array, multipliers: Multipliers) -> Certificate:
    """Return the certificate of an answer.

    Parameters
    ----------
    model : NumpyModel
    u : array (size,)
        The unknowns.
    multipliers : Multipliers
    """
    data = model.data
    layout = data.layout
    u = u.ravel()
    matrix, sigma = model.matrix, model.sigma
    values = np.asarray(matrix @ u)
    violation = np.maximum(np.maximum(model.row_lower - values, values - model.row_upper), 0.0)
    outside = np.maximum(np.maximum(model.lower - u, u - model.upper), 0.0)
    relative = np.divide(violation, model.row_norm, out=violation.copy(), where=model.row_norm > 0)
    bands = model.row_band
    primal = by_band(outside, layout, np.max)
    np.maximum.at(primal, bands, relative)

    gradient, pull = model.gradient(u), np.asarray(matrix.T @ multipliers.rows)
    force = gradient + pull
    dual = by_band(np.abs(sigma * (force - multipliers.lower + multipliers.upper)), layout, np.max)
    slack_lower, slack_upper = u - model.lower, _finite(model.upper - u)
    gap = _gap(multipliers.lower, multipliers.upper, slack_lower, slack_upper)
    row_gap = _row_gap(model, multipliers.rows, values)
    total_gap = by_band(gap, layout, np.sum)
    np.add.at(total_gap, bands, row_gap)

    return Certificate(
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=np.abs(total_gap),
        alpha_error_bound=layout.expand(_error_bound(model, u, multipliers.rows, values)),
    )


def _error_bound(model: NumpyModel, u: Array, rows: Array, values: Array) -> Array:
    """Return the largest distance of each coefficient from the optimum, (n_alpha,)."""
    problem = separable(model)
    if problem is None:
        return _gap_bound(model, u, rows, values)
    below, above = (ends.T.ravel() for ends in problem.enclosure())
    alpha = u[: model.data.layout.n_alpha]
    return np.maximum(np.maximum(alpha - below, above - alpha), 0.0) + _EPS * np.abs(alpha)


def _gap_bound(model: NumpyModel, u: Array, rows: Array, values: Array) -> Array:
    """Bound the error by strong convexity, (n_alpha,).

    Let F be the gradient of the Lagrangian at u, and d the step to the optimum. The optimum's value
    is at most that at u, so that sum(F d + w d² / 2) is at most the gap of the rows, with
    w = m / sigma² the curvature's lower limit. Each summand has a least value within the box. What
    those of the other coefficients leave bounds the step of each one.
    """
    data = model.data
    layout, sigma, m = data.layout, model.sigma, model.convexity
    movable = model.movable & (m > 0)
    force = np.where(movable, model.stationarity(u, rows), 0.0) * sigma
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=model.movable)
    # In sigmas: the step's least and largest value, and the minimiser of F d + m d² / 2 between.
    low = np.minimum((model.lower - u) * inverse, 0.0)
    high = np.maximum(np.where(np.isinf(model.upper), np.inf, (model.upper - u)) * inverse, 0.0)
    step = np.clip(np.divide(-force, m, out=np.zeros_like(m), where=movable), low, high)
    least = np.where(movable, force * step + m * step**2 / 2, 0.0)
    excess, distance = _row_excess(model, u, rows, values)
    available = by_band(-least, layout, np.sum) + excess
    if not model.separate(u):  # bands are coupled: their gaps count together
        available = np.full(layout.n_bands, available.sum())
        distance = np.full(layout.n_bands, distance.sum())
    energy = np.maximum(available + data.alpha(least), 0.0)
    reach = np.maximum(
        _largest_step(data.alpha(force), data.alpha(m), energy, data.alpha(high)),
        _largest_step(-data.alpha(force), data.alpha(m), energy, -data.alpha(low)),
    )
    outside = np.maximum(np.maximum(model.lower - u, u - model.upper), 0.0)
    return np.asarray((data.alpha(sigma) * (reach + distance) + data.alpha(outside)).ravel())


def _largest_step(force: Array, m: Array, energy: Array, room: Array) -> Array:
    """Return the largest d from 0 to ``room`` with F d + m d² / 2 at most the energy.

    NaN where m is 0. Each root is written without a difference of nearly equal numbers.
    """
    root = np.sqrt(force**2 + 2 * m * energy)
    uphill = np.divide(2 * energy, root + force, out=np.zeros_like(root), where=root + force > 0)
    downhill = np.divide(root - force, m, out=np.full_like(root, np.nan), where=m > 0)
    step = np.where(force > 0, uphill, downhill)
    return np.where(m > 0, np.minimum(step, room), np.nan)


def _row_excess(model: NumpyModel, u: Array, rows: Array, values: Array) -> tuple[Array, Array]:
    """Return what violated rows add to the gap and to the distance in sigmas, both by band."""
    n_bands = model.data.layout.n_bands
    violation = np.maximum(np.maximum(model.row_lower - values, values - model.row_upper), 0.0)
    free = (model.movable & (u > model.lower) & (u < model.upper)).astype(float)
    reach = np.sqrt(np.asarray(model.squares @ (model.sigma * free) ** 2))
    # Rounding error of S'alpha.
    rounding = (model.entries + 1) * _EPS * np.asarray(model.absolute @ np.abs(u))
    off = np.divide(violation + rounding, reach, out=np.zeros_like(violation), where=reach > 0)
    steepness = float(np.linalg.norm(model.gradient(u) * model.sigma))
    excess, distance = np.zeros(n_bands), np.zeros(n_bands)
    extra = np.abs(rows) * (violation + rounding) + steepness * off + _row_gap(model, rows, values)
    np.add.at(excess, model.row_band, extra)
    np.add.at(distance, model.row_band, off)
    return excess, distance


def by_band(values: Array, layout: Layout, reduce: Callable[..., Any]) -> Array:
    """Reduce over the rows of alpha; a further unknown counts in every band."""
    alpha = values[: layout.n_alpha].reshape(layout.n_rows, layout.n_bands)
    further = np.repeat(values[layout.n_alpha :, np.newaxis], layout.n_bands, axis=1)
    return np.asarray(reduce(np.concatenate([alpha, further]), axis=0), dtype=float)


def _finite(slack: Array) -> Array:
    """Slack of the box; 0 for a side without bound."""
    return np.where(np.isfinite(slack), slack, 0.0)


def _gap(lower: Array, upper: Array, slack_lower: Array, slack_upper: Array) -> Array:
    return np.asarray(lower * slack_lower + upper * slack_upper)


def _row_gap(model: NumpyModel, rows: Array, values: Array) -> Array:
    """Multiplier times slack of the inequality rows."""
    slack = np.where(rows > 0, model.row_upper - values, values - model.row_lower)
    equality = (model.row_lower == model.row_upper) | (rows == 0)
    return np.where(equality, 0.0, np.abs(rows) * np.maximum(np.where(equality, 0.0, slack), 0.0))
