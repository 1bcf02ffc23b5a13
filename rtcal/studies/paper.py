"""The paper's printed numbers: Bellows & Katz (2025), Tables 1 to 3."""

from __future__ import annotations

import numpy as np

from rtcal.studies.study import analytic_emse
from rtcal.support.types import Array

__all__ = [
    "SIGMA_R",
    "TABLE_1_EMSE",
    "TABLE_1_MU",
    "TABLE_1_SIGMA",
    "TABLE_2",
    "TABLE_3",
    "table_1_range",
]
__dir__ = __all__.copy

SIGMA_R = (0.01, 0.05, 0.1)
"""Uncertainties of the stated coefficients in its Tables 2 and 3."""

TABLE_2: dict[str, tuple[float, ...]] = {
    "none": (0.0, 0.0, 0.0),
    "scaling": (4.4, 5.4, 6.4),
    "lse": (8.7, 8.7, 8.7),
    "mle": (14.8, 14.3, 13.2),
}
"""Calibration scores of the shoebox in percent, by sigma_r."""

TABLE_3: dict[str, tuple[float, ...]] = {
    "none": (0.0, 0.0, 0.0),
    "scaling": (-1.2, -0.8, -0.3),
    "lse": (2.2, 2.2, 2.2),
    "mle": (3.8, 3.7, 3.3),
}
"""Calibration scores of the lecture hall in percent, by sigma_r."""

TABLE_1_MU = (0.66, 0.45, 0.88, 0.83, 0.12, 0.52)
TABLE_1_SIGMA = (0.04, 0.07, 0.06, 0.01, 0.05, 0.06)
TABLE_1_EMSE: dict[str, float] = {
    "none": 26.8e-4,
    "scaling": 25.0e-4,
    "lse": 22.0e-4,
    "mle": 20.0e-4,
}
"""Mean square error of the coefficients of Table 1's room, by method."""
_HALF_DIGIT = 0.005


def table_1_range(areas: Array) -> tuple[Array, Array]:
    """Return the least and the most EMSE, (4,), that Table 1's printed mu and sigma allow.

    mu and sigma are uniform within half of their last digit. EMSE is in closed form, and the range
    is its central 98 % of 4000 draws.
    """
    rng = np.random.default_rng(0)
    shape = (4000, len(TABLE_1_MU))
    mu = np.array(TABLE_1_MU) + rng.uniform(-_HALF_DIGIT, _HALF_DIGIT, shape)
    sigma = np.array(TABLE_1_SIGMA) + rng.uniform(-_HALF_DIGIT, _HALF_DIGIT, shape)
    emse = analytic_emse(mu, sigma, np.asarray(areas, dtype=float))
    low, high = np.quantile(emse, [0.01, 0.99], axis=0)
    return low, high
