"""The certificate: how far an answer is from optimal, computed here from the terms' NumPy twins.

No solver's word is taken. Whoever holds the certificate can check the answer with a few lines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.calibration.layout import Layout
from rtcal.calibration.numpy_model import Multipliers, NumpyModel
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
        No coefficient is farther than this from the optimum: sigma sqrt(2 gap / m), by strong
        convexity, with whatever the multipliers leave unbalanced counted into the gap.
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
    miss = np.maximum(np.maximum(model.row_lower - values, values - model.row_upper), 0.0)
    outside = np.maximum(np.maximum(model.lower - u, u - model.upper), 0.0)
    relative = np.divide(miss, model.row_norm, out=miss.copy(), where=model.row_norm > 0)
    bands = model.row_band
    primal = _by_band(outside, layout, np.max)
    np.maximum.at(primal, bands, relative)

    gradient, pull = model.gradient(u), np.asarray(matrix.T @ multipliers.rows)
    force = gradient + pull
    dual = _by_band(np.abs(sigma * (force - multipliers.lower + multipliers.upper)), layout, np.max)
    slack_lower, slack_upper = u - model.lower, _finite(model.upper - u)
    gap = _gap(multipliers.lower, multipliers.upper, slack_lower, slack_upper)
    row_gap = _row_gap(model, multipliers.rows, values)
    total_gap = _by_band(gap, layout, np.sum)
    np.add.at(total_gap, bands, row_gap)

    # For the bound every imbalance is given to the box, whatever the multipliers said: then the
    # Lagrangian is stationary at u, and 1/2 sum m (du / sigma)² is at most the gap. An unknown
    # without an upper side takes its imbalance by completing its own square instead.
    force = np.where(model.movable, force, 0.0)
    m = model.convexity
    open_above = np.isinf(model.upper) & (force < 0)
    own = np.divide((force * sigma) ** 2, m, out=np.zeros_like(m), where=open_above)
    force = np.where(open_above, 0.0, force)
    repaired = _by_band(
        own
        + _gap(
            np.maximum(force, 0.0),
            np.maximum(-force, 0.0),
            np.maximum(slack_lower, 0.0),
            np.maximum(slack_upper, 0.0),
        ),
        layout,
        np.sum,
    )
    free = (model.movable & (u > model.lower) & (u < model.upper)).astype(float)
    reach = np.sqrt(np.asarray(model.squares @ (sigma * free) ** 2))
    # S'alpha itself is known to rounding only.
    rounding = (model.entries + 1) * _EPS * np.asarray(model.absolute @ np.abs(u))
    off = np.divide(miss + rounding, reach, out=np.zeros_like(miss), where=reach > 0)
    steepness = float(np.linalg.norm(gradient * sigma))
    extra = np.abs(multipliers.rows) * (miss + rounding) + steepness * off + row_gap
    distance = np.zeros(layout.n_bands)
    np.add.at(repaired, bands, extra)
    np.add.at(distance, bands, off)
    if not model.separate(u):  # bands are coupled: their gaps count together
        repaired = np.full(layout.n_bands, repaired.sum())
        distance = np.full(layout.n_bands, distance.sum())
    strength = data.alpha(m)
    spread = np.divide(
        2 * np.maximum(repaired, 0),
        strength,
        out=np.full_like(strength, np.nan),
        where=strength > 0,
    )
    bound = data.alpha(sigma) * (np.sqrt(spread) + distance)
    return Certificate(
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=np.abs(total_gap),
        alpha_error_bound=layout.expand(bound.ravel()),
    )


def _by_band(values: Array, layout: Layout, reduce: Callable[..., Any]) -> Array:
    """Reduce over the rows of alpha; a further unknown counts in every band."""
    alpha = values[: layout.n_alpha].reshape(layout.n_rows, layout.n_bands)
    further = np.repeat(values[layout.n_alpha :, np.newaxis], layout.n_bands, axis=1)
    return np.asarray(reduce(np.concatenate([alpha, further]), axis=0), dtype=float)


def _finite(slack: Array) -> Array:
    """Slack of the box; of a side that is not there, 0."""
    return np.where(np.isfinite(slack), slack, 0.0)


def _gap(lower: Array, upper: Array, slack_lower: Array, slack_upper: Array) -> Array:
    return np.asarray(lower * slack_lower + upper * slack_upper)


def _row_gap(model: NumpyModel, rows: Array, values: Array) -> Array:
    """Multiplier times slack of the inequality rows."""
    slack = np.where(rows > 0, model.row_upper - values, values - model.row_lower)
    equality = (model.row_lower == model.row_upper) | (rows == 0)
    return np.where(equality, 0.0, np.abs(rows) * np.maximum(np.where(equality, 0.0, slack), 0.0))
