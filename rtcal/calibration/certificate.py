"""The certificate: how far an answer is from the optimum, computed from the terms' NumPy descriptions.

It uses nothing that a solver states. A few lines of NumPy repeat it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rtcal.calibration.error_bound import largest_error
from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.support.types import Array


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
    model : NumpyModel
    unknowns : array (size,)
        The answer.
    row_multipliers : array (n_rows,)
        Its multipliers of the rows.
    materials : tuple of int
        The materials of `alpha_error_bound`, by their index in the problem.
    """

    primal_residual: Array
    dual_residual: Array
    duality_gap: Array
    model: NumpyModel
    unknowns: Array
    row_multipliers: Array
    materials: tuple[int, ...]

    @cached_property
    def alpha_error_bound(self) -> Array:
        """No coefficient is farther than this from the optimum, (n_materials, n_bands).

        An enclosure, by the exact dual where the problem is separable, by strong convexity elsewhere
        (`rtcal.calibration.error_bound`). It is computed when it is first read.
        """
        bound = largest_error(self.model, self.unknowns, self.row_multipliers)
        return self.model.data.layout.expand(bound)[list(self.materials)]

    @cached_property
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
    primal = layout.by_band(outside, np.maximum.reduce)
    np.maximum.at(primal, bands, relative)

    gradient, pull = model.gradient(u), np.asarray(matrix.T @ multipliers.rows)
    force = gradient + pull
    unbalanced = np.abs(sigma * (force - multipliers.lower + multipliers.upper))
    dual = layout.by_band(unbalanced, np.maximum.reduce)
    slack_lower, slack_upper = u - model.lower, _finite(model.upper - u)
    gap = _gap(multipliers.lower, multipliers.upper, slack_lower, slack_upper)
    row_gap = _row_gap(model, multipliers.rows, values)
    total_gap = layout.by_band(gap, np.add.reduce)
    np.add.at(total_gap, bands, row_gap)

    return Certificate(
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=np.abs(total_gap),
        model=model,
        unknowns=u,
        row_multipliers=multipliers.rows,
        materials=tuple(range(len(layout.materials))),
    )


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
