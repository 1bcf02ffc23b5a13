"""Posterior densities as plain arrays: the input of the marginals and the sampler."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.support.sampler import JointTruncatedNormal
from rtcal.support.types import Array

POINTS = 801
"""Points of each density; an odd number for Simpson's rule."""


@dataclass(frozen=True, eq=False)
class Marginals:
    """The distributions of a band's coefficients.

    ``points`` and the distribution function ``cumulative`` at them, (n, points); ``mean`` (n,);
    ``covariance`` (n, n), with zeros off its diagonal unless it was requested.
    """

    points: Array
    cumulative: Array
    mean: Array
    covariance: Array


def integrated(t: Array, density: Array) -> Marginals:
    """Return distribution function, means and variances of densities at points, (n, points).

    Simpson's rule for the moments. For the distribution function it is the trapezoidal rule with the
    first correction of Euler and Maclaurin. A density may jump at its ends only.
    """
    step = (t[:, 1:2] - t[:, :1]) / 3
    weight = density * step * np.array([1.0, *[4.0, 2.0] * ((POINTS - 3) // 2), 4.0, 1.0])
    weight /= weight.sum(axis=1, keepdims=True)
    mean = np.sum(weight * t, axis=1)
    variance = np.sum(weight * (t - mean[:, np.newaxis]) ** 2, axis=1)
    slope = np.gradient(density, axis=1, edge_order=2)
    cells = (density[:, 1:] + density[:, :-1]) / 2 - np.diff(slope, axis=1) / 12
    cumulative = np.cumsum(np.maximum(cells, 0.0), axis=1)
    cumulative = np.concatenate([np.zeros((len(t), 1)), cumulative], axis=1)
    return Marginals(t, cumulative / cumulative[:, -1:], mean, np.diag(variance))


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
