"""Posterior densities as plain arrays: the input of the marginals and the sampler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class IndependentBands:
    """Independent truncated normal priors and one matched sum per band.

    Attributes
    ----------
    rows : tuple of int (n_materials,)
        The row of coefficients of each material; several materials may share a row.
    mu, sigma, lower, upper : array (n_rows, n_bands)
        The priors and their bounds; a fixed coefficient has sigma = 0.
    alpha : array (n_rows, n_bands)
        The calibrated coefficients.
    areas : array (n_rows,)
        S in m².
    target, noise : array (n_bands,)
        b and its standard uncertainty in m²; b is NaN without a match, noise 0 where it is unknown.
    exact : bool
        Whether S'alpha is what T says, to within the noise, whatever the priors say of it. They say
        how it is shared. Else prior and T are weighed against each other.
    multiplier : array (n_bands,)
        D in 1/m²: free coefficients are mu - D S sigma².
    """

    rows: tuple[int, ...]
    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    alpha: Array
    areas: Array
    target: Array
    noise: Array
    exact: bool
    multiplier: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTruncatedNormal:
    """A normal density within bounds, linear equalities and linear inequalities.

    The density of u is proportional to exp(-g'(u - p) - ½ (u - p)'H(u - p)).

    Attributes
    ----------
    point : array (size,)
        p, where the equalities hold.
    gradient : array (size,)
        g.
    curvature : array (size,) or sparse array (size, size)
        H; its diagonal if H is diagonal.
    scale : array (size,)
        The scale of each unknown; 0 for a fixed one.
    lower, upper : array (size,)
        The bounds.
    matrix : array or sparse array (n_rows, size)
    row_lower, row_upper : array (n_rows,)
        Limits of ``matrix @ u``; equal for an equality.
    """

    point: Array
    gradient: Array
    curvature: Any
    scale: Array
    lower: Array
    upper: Array
    matrix: Any
    row_lower: Array
    row_upper: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CoupledBands:
    """A density that couples bands, configurations or further unknowns.

    The unknowns are the coefficients, row by row with the bands last, and then the further ones.

    Attributes
    ----------
    rows : tuple of int (n_materials,)
        The row of coefficients of each material.
    n_bands : int
    further : tuple of str
        Names of the further unknowns.
    posterior, prior : TruncatedNormal
        With the measurement and without it.
    """

    rows: tuple[int, ...]
    n_bands: int
    further: tuple[str, ...]
    posterior: JointTruncatedNormal
    prior: JointTruncatedNormal
