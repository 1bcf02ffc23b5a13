"""The random rooms of Bellows & Katz (2025), Sect. 3.4, and the study's estimators.

A realisation draws a mean mu and a standard deviation sigma for every surface, the data of a
calibration. A trial draws the true coefficients from the truncated normal (mu, sigma) on [0, 1].

The paper's text draws mu from U(2 sigma_n, 1 - 2 sigma_n), with each surface's own sigma_n. Its scores
are those of U(2 sigma_R, 1 - 2 sigma_R), with the Rayleigh distribution's parameter. That is inferred
from the numbers alone (docs/studies.md), so a study can have either.

The estimators are one family: alpha = mu - D q with S'alpha = b. q = mu scales all coefficients alike
(Eq. 36), q = S is the least-squares estimate (Eq. 10), q = S sigma² the maximum-likelihood estimate
(Eq. 25). Unbounded, with e = mu - alpha* and delta = S'e, each leaves the error (I - q S'/(S'q)) e.
Bounded, alpha = clip(mu - D q, 0, 1): the exact minimiser of the QP with sigma² = q/S.

All trials of a realisation have the same mu and q. The piecewise linear delta(D) is therefore
tabulated once, and a trial that leaves the box needs one look-up. This is faster than `rtcal.exact`,
which solves each problem from its start; the tests compare the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rtcal.support import speed
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
    if speed.available():
        from rtcal.studies import trials_kernel

        indices = np.empty(z.size, np.intp)
        return indices[: trials_kernel.outside(z, low, high, indices)]
    return np.flatnonzero((z < low[:, np.newaxis]) | (z > high[:, np.newaxis]))


METHODS = ("none", "scaling", "lse", "mle")
CALIBRATIONS = METHODS[1:]


def directions(mu: Array, sigma: Array, areas: Array) -> Array:
    """Return q of each calibration, (..., 3, n)."""
    return np.stack([mu, np.broadcast_to(areas, mu.shape), areas * sigma**2], axis=-2)


_ROUNDING = 64 * float(np.finfo(float).eps)
"""Share of its summed terms below which an EMSE counts as rounding error and is set to 0.

A room of one surface has one unknown and one equation, so every calibration is exact there.
"""


def _rounded(value: Array, size: Array) -> Array:
    return np.where(np.abs(value) <= _ROUNDING * size, 0.0, value)


def expected_errors(second_moment: Array, q: Array, areas: Array) -> Array:
    """Return the EMSE of no and of each unbounded calibration, (..., 4), from E ee', (..., n, n).

    n EMSE = tr G - 2 q'GS/(S'q) + |q|² S'GS/(S'q)², G = E ee'.
    """
    n = areas.size
    total = np.trace(second_moment, axis1=-2, axis2=-1)[..., np.newaxis]
    along = second_moment @ areas  # E[delta e], (..., n)
    reach = q @ areas
    cross = (q * along[..., np.newaxis, :]).sum(-1) / reach
    spread = (along @ areas)[..., np.newaxis] * (q**2).sum(-1) / reach**2
    left = _rounded(total - 2 * cross + spread, total + 2 * np.abs(cross) + spread)
    return np.asarray(np.concatenate([total, left], axis=-1) / n)


@dataclass(frozen=True, eq=False)
class Realisation:
    """The data common to the trials of one realisation; the calibrations along the first axis of q.

    ``q`` (3, n); ``delta`` and ``multiplier`` (3, 2 n), the table of delta(D) = S'(mu - clip(mu - D q,
    0, 1)), increasing; ``least`` and ``most`` (3,), the ends of delta between which the closed form
    stays in the box.
    """

    mu: Array
    sigma: Array
    areas: Array
    q: Array
    delta: Array
    multiplier: Array
    least: Array
    most: Array


def tabulated(mu: Array, sigma: Array, areas: Array) -> list[Realisation]:
    """Tabulate a few realisations, mu and sigma (r, n)."""
    q = directions(mu, sigma, areas)
    top, bottom = (mu[:, np.newaxis] - 1) / q, mu[:, np.newaxis] / q  # D at which a bound is met
    points = np.sort(np.concatenate([top, bottom], axis=-1), axis=-1)  # (r, 3, 2 n)
    centre = mu[:, np.newaxis, np.newaxis]
    alpha = np.clip(centre - points[..., np.newaxis] * q[:, :, np.newaxis], 0, 1)
    delta = ((centre - alpha) * areas).sum(-1)
    reach = q @ areas
    least, most = top.max(-1) * reach, bottom.min(-1) * reach
    return [
        Realisation(mu[r], sigma[r], areas, q[r], delta[r], points[r], least[r], most[r])
        for r in range(len(mu))
    ]


@dataclass(frozen=True, eq=False)
class TrialSums:
    """Sums over trials.

    ``squares`` is e'e; ``products`` (4,) delta² and, by calibration, delta e'q; ``change`` (3,) e'e
    of the bounded minus that of the unbounded estimate; ``active`` (3,) the number of trials in
    which they differ.
    """

    squares: float
    products: Array
    change: Array
    active: Array

    def __add__(self, other: TrialSums) -> TrialSums:
        return TrialSums(
            self.squares + other.squares,
            self.products + other.products,
            self.change + other.change,
            self.active + other.active,
        )

    def errors(self, room: Realisation, trials: int) -> Array:
        """Return the sampled EMSE of none and the calibrations, unbounded and bounded, (7,)."""
        reach = room.q @ room.areas
        # |e - D q|² = |e|² - 2 D e'q + D²|q|² with D = delta/(S'q)
        length = (room.q**2).sum(-1)
        cross = 2 * self.products[1:] / reach
        spread = self.products[0] * length / reach**2
        size = self.squares + np.abs(cross) + spread
        unbounded = _rounded(self.squares - cross + spread, size)
        bounded = _rounded(unbounded + self.change, size)
        total = np.concatenate([[self.squares], unbounded, bounded])
        return np.asarray(total / (room.mu.size * trials))


def score(z: Array, room: Realisation) -> TrialSums:
    """Calibrate the trials ``z`` = (alpha* - mu)/sigma, (n, trials), and sum up their errors."""
    # e = mu - alpha* = -sigma z; the rows give delta = S'e and e'q from z
    rows = -np.vstack([room.areas * room.sigma, room.q * room.sigma])
    if speed.available():
        from rtcal.studies import trials_kernel

        squares, sums = trials_kernel.score(
            z,
            rows,
            room.mu,
            room.sigma,
            room.q,
            room.q @ room.areas,
            room.delta,
            room.multiplier,
            room.least,
            room.most,
        )
        return TrialSums(squares, sums[0], sums[1, :-1], sums[2, :-1])
    return _score(z, rows, room)


def _score(z: Array, rows: Array, room: Realisation) -> TrialSums:
    """The NumPy version of `trials_kernel.score`."""
    along = rows @ z
    delta = along[0]
    variance = room.sigma**2
    change, active = np.zeros(len(room.q)), np.zeros(len(room.q))
    for k, q in enumerate(room.q):
        out = np.flatnonzero((delta < room.least[k]) | (delta > room.most[k]))
        active[k] = out.size
        d = np.interp(delta[out], room.delta[k], room.multiplier[k])
        truth = room.mu[:, np.newaxis] + room.sigma[:, np.newaxis] * z[:, out]
        error = np.clip(room.mu[:, np.newaxis] - d * q[:, np.newaxis], 0, 1) - truth
        free = room.mu[:, np.newaxis] - delta[out] / (q @ room.areas) * q[:, np.newaxis] - truth
        change[k] = np.sum(error**2) - np.sum(free**2)
    squares = float(np.einsum("it,it,i->", z, z, variance))
    return TrialSums(squares, (along * delta).sum(-1), change, active)
