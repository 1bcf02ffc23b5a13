"""The misfit of each pair with all others, in a calibration to every position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from rtcal.support.types import Array

CONTRADICTION = 0.001
"""Probability, divided among the pairs, below which a pair contradicts all others."""


def rows_of_pairs(used: NDArray[np.bool_]) -> list[Any]:
    """Return the rows of each pair among the values used; ``used`` (n_parameters, n_pairs, n_bands)."""
    pair = np.broadcast_to(np.arange(used.shape[1])[:, np.newaxis], used.shape)[used]
    return [np.flatnonzero(pair == i) for i in range(used.shape[1])]


def chi_square(innovation: Array, covariance: Array, rows: list[Any]) -> tuple[Array, Array]:
    """Return the chi-square of each pair given all others, and its degrees of freedom, (n_pairs,).

    ``innovation`` (n_used,) is what was measured less what is expected, ``covariance`` its covariance.
    """
    precision = np.linalg.inv(covariance)
    pull = precision @ innovation
    values = [float(pull[r] @ np.linalg.solve(precision[np.ix_(r, r)], pull[r])) for r in rows]
    return np.array(values), np.array([max(len(r), 1) for r in rows])


def relative_misfit(square: Array, degrees: Array) -> Array:
    """Return chi-square over its degrees of freedom, relative to the upper quartile above 1.

    What a simulator misses differs between pairs; up to a quarter may be wrong.
    """
    ratio = square / degrees
    return np.asarray(ratio / max(1.0, float(np.quantile(ratio, 0.75, method="lower"))))


def contradicting(misfit: Array, degrees: Array) -> list[int]:
    """Return the pairs that contradict all others, the worst first."""
    chance = chi2.sf(misfit * degrees, degrees)
    return [int(i) for i in np.argsort(-misfit) if chance[i] < CONTRADICTION / len(misfit)]
