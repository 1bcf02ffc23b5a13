"""The certificate: how far an answer is from optimal, computed here from the terms' NumPy twins.

No solver's word is taken. Whoever holds the certificate can check the answer with a few lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.calibration.twin import Multipliers, Twin
from rtcal.types import Array

_EPS = np.finfo(float).eps


@dataclass(frozen=True)
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
        No coefficient is farther than this from the optimum: sigma sqrt(2 gap), by strong
        convexity, with whatever the multipliers leave unbalanced counted into the gap. NaN where
        the objective holds no prior deviation.
    """

    primal_residual: Array
    dual_residual: Array
    duality_gap: Array
    alpha_error_bound: Array

    @property
    def worst(self) -> float:
        """The largest of the three residuals over all bands."""
        return float(max(np.max(r) for r in (
            self.primal_residual, self.dual_residual, self.duality_gap
        )))  # fmt: skip


def certify(twin: Twin, alpha: Array, multipliers: Multipliers, convexity: float) -> Certificate:
    """Return the certificate of an answer.

    Parameters
    ----------
    twin : Twin
    alpha : array (n_materials, n_bands)
    multipliers : Multipliers
    convexity : float
        The objective's modulus of strong convexity in (alpha - mu) / sigma: 1 for the prior
        deviation, 0 without it.
    """
    shape = alpha.shape
    n_bands = shape[1]
    flat = alpha.ravel()
    matrix, sigma = twin.matrix, twin.sigma
    values = np.asarray(matrix @ flat)
    miss = np.maximum(np.maximum(twin.row_lower - values, values - twin.row_upper), 0.0)
    outside = np.maximum(np.maximum(twin.lower - flat, flat - twin.upper), 0.0).reshape(shape)
    relative = np.divide(miss, twin.row_norm, out=miss.copy(), where=twin.row_norm > 0)
    bands = twin.row_band
    primal = outside.max(axis=0)
    np.maximum.at(primal, bands, relative)

    gradient, pull = twin.gradient(flat), np.asarray(matrix.T @ multipliers.rows)
    force = gradient + pull
    dual = np.abs(sigma * (force - multipliers.lower + multipliers.upper)).reshape(shape)
    slack_lower, slack_upper = flat - twin.lower, twin.upper - flat
    gap = _gap(multipliers.lower, multipliers.upper, slack_lower, slack_upper).reshape(shape)
    row_gap = _row_gap(twin, multipliers.rows, values)
    total_gap = gap.sum(axis=0)
    np.add.at(total_gap, bands, row_gap)

    # For the bound every imbalance is given to the box, whatever the multipliers said: then the
    # Lagrangian is stationary at alpha, and 1/2 convexity |dx|² is at most the gap.
    force = np.where(twin.movable, force, 0.0)
    repaired = _gap(
        np.maximum(force, 0.0), np.maximum(-force, 0.0),
        np.maximum(slack_lower, 0.0), np.maximum(slack_upper, 0.0),
    ).reshape(shape).sum(axis=0)  # fmt: skip
    free = (twin.movable & (flat > twin.lower) & (flat < twin.upper)).astype(float)
    reach = np.sqrt(np.asarray(twin.squares @ (sigma * free) ** 2))
    # S'alpha itself is known to rounding only.
    rounding = (twin.entries + 1) * _EPS * np.asarray(twin.absolute @ np.abs(flat))
    off = np.divide(miss + rounding, reach, out=np.zeros_like(miss), where=reach > 0)
    steepness = float(np.linalg.norm(gradient * sigma))
    extra = np.abs(multipliers.rows) * (miss + rounding) + steepness * off + row_gap
    distance = np.zeros(n_bands)
    np.add.at(repaired, bands, extra)
    np.add.at(distance, bands, off)
    if not _separate(twin):  # bands are coupled: their gaps count together
        repaired = np.full(n_bands, repaired.sum())
        distance = np.full(n_bands, distance.sum())
    if convexity > 0:
        bound = twin.instance.sigma * (np.sqrt(2 * np.maximum(repaired, 0) / convexity) + distance)
    else:
        bound = np.full(shape, np.nan)
    return Certificate(
        primal_residual=primal,
        dual_residual=dual.max(axis=0),
        duality_gap=np.abs(total_gap),
        alpha_error_bound=bound,
    )


def _gap(lower: Array, upper: Array, slack_lower: Array, slack_upper: Array) -> Array:
    return np.asarray(lower * slack_lower + upper * slack_upper)


def _row_gap(twin: Twin, rows: Array, values: Array) -> Array:
    """Multiplier times slack of the inequality rows."""
    slack = np.where(rows > 0, twin.row_upper - values, values - twin.row_lower)
    equality = (twin.row_lower == twin.row_upper) | (rows == 0)
    return np.where(equality, 0.0, np.abs(rows) * np.maximum(np.where(equality, 0.0, slack), 0.0))


def _separate(twin: Twin) -> bool:
    """Whether no term and no row couples two bands."""
    from rtcal.calibration.terms import ExactMatch, PriorDeviation

    return all(isinstance(t, PriorDeviation) for t in twin.objective.terms) and all(
        isinstance(r, ExactMatch) for r in twin.row_constraints
    )
