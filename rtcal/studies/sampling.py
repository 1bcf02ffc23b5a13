"""The random rooms of Bellows & Katz (2025), Sect. 3.4: realisations and trials.

A realisation draws a mean mu and a standard deviation sigma for every surface, the data of a
calibration. A trial draws the true coefficients from the truncated normal (mu, sigma) on [0, 1].

The paper's text draws mu from U(2 sigma_n, 1 - 2 sigma_n), with each surface's own sigma_n. Its scores
are those of U(2 sigma_R, 1 - 2 sigma_R), with the Rayleigh distribution's parameter. That is inferred
from the numbers alone (docs/studies.md), so a study can have either.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rtcal.support import jit
from rtcal.support.types import Array

Sampling = Literal["sigma_r", "sigma_n"]
"""What keeps mu from 0 and 1: twice sigma_r, or twice the surface's own sigma_n, as the text reads."""
SAMPLINGS: tuple[Sampling, ...] = get_args(Sampling)

SIGMA_LIMIT = 0.25
"""Value of sigma_r, or of sigma_n, at which the interval of mu becomes empty."""


def redrawn_share(sigma_r: float, sampling: Sampling = "sigma_r") -> float:
    """Return the share of Rayleigh draws that are drawn again.

    With "sigma_n" these are the draws at or beyond `SIGMA_LIMIT`: exp(-1 / (32 sigma_r²)). With
    "sigma_r" there are none.
    """
    if sampling == "sigma_r":
        return 0.0
    return float(np.exp(-(SIGMA_LIMIT**2) / (2 * sigma_r**2)))


def realisations(
    rng: np.random.Generator, count: int, n: int, sigma_r: float, sampling: Sampling = "sigma_r"
) -> tuple[Array, Array]:
    """Return mu and sigma, each (count, n): sigma ~ Rayleigh(sigma_r), mu uniform.

    With "sigma_r" mu is from 2 sigma_r to 1 - 2 sigma_r, whatever sigma is. With "sigma_n" it is from
    2 sigma to 1 - 2 sigma, and sigma is redrawn while it is 0.25 or more. Inversion draws it in one
    step from the truncated distribution.
    """
    below = 1 - redrawn_share(sigma_r, sampling)
    sigma = sigma_r * np.sqrt(-2 * np.log1p(-below * (1 - rng.random((count, n)))))
    if sampling == "sigma_r":
        return 2 * sigma_r + (1 - 4 * sigma_r) * rng.random((count, n)), sigma
    sigma = np.minimum(sigma, np.nextafter(SIGMA_LIMIT, 0))  # rounding at the far end
    return 2 * sigma + (1 - 4 * sigma) * rng.random((count, n)), sigma


def trials(rng: np.random.Generator, mu: Array, sigma: Array, z: Array) -> None:
    """Fill ``z`` (n, trials) with (alpha - mu)/sigma of truncated normals on [0, 1].

    Standard normals outside the interval are drawn again. With "sigma_n" these are at most one in
    twenty, since mu is at least 2 sigma from the ends. With "sigma_r" one surface may have more.
    """
    rng.standard_normal(out=z)
    low, high = -mu / sigma, (1 - mu) / sigma
    again = outside(z, low, high)
    flat = z.reshape(-1)
    while again.size:
        row = again // z.shape[1]
        flat[again] = drawn = rng.standard_normal(again.size)
        again = again[(drawn < low[row]) | (drawn > high[row])]


def outside(z: Array, low: Array, high: Array) -> NDArray[np.intp]:
    """Return the flat indices of ``z`` (n, trials) below ``low`` or above ``high`` (n,)."""
    if jit.available():
        from rtcal.studies import trials_kernel

        indices = np.empty(z.size, np.intp)
        return indices[: trials_kernel.outside(z, low, high, indices)]
    return np.flatnonzero((z < low[:, np.newaxis]) | (z > high[:, np.newaxis]))
