"""Moments and distribution functions of tabulated densities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.support.types import Array

POINTS = 801
"""Points of each density; an odd number for Simpson's rule."""
_DRAWS = 100_000


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


def probability_within(below: Array, above: Array, correlation: Array) -> float:
    """Return the probability that standard normal errors are all within limits, (n,) each.

    Of 100,000 draws: its error is at most 0.0016.

    Examples
    --------
    >>> limit = np.full(2, 1.645)
    >>> round(probability_within(-limit, limit, np.eye(2)), 2)
    0.81
    """
    root = np.linalg.cholesky(correlation)
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, len(root))) @ root.T
    return float(((drawn >= below) & (drawn <= above)).all(axis=1).mean())
