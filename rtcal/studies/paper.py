"""Bellows & Katz (2025): its random rooms (Sect. 3.4) and estimators, its printed rooms and numbers.

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

The printed rooms and numbers are surface areas and Tables 1 to 3.
The paper gives the shoebox (5 x 7 x 3 m) in full, but of its lecture hall only N = 23, V = 334 m³ and
the ratio 66.6 of its largest to its smallest area. `LECTURE_HALL` is a stand-in: a plausible closed
hall with exactly these numbers. `random_hall` draws further halls with the same numbers, to show how
much the scores depend on the areas that the paper does not state. Areas are in m².
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rtcal.support import checks
from rtcal.support.normal import FINE, truncated_moments
from rtcal.support.types import Array

__all__ = ["LECTURE_HALL", "SHOEBOX", "TABLE_2", "TABLE_3", "random_hall", "table_1_range"]
__dir__ = __all__.copy

Sampling = Literal["sigma_r", "sigma_n"]
"""Rule that keeps the mean coefficient mu from 0 and 1: by 2 sigma_r, or by 2 sigma of each surface, as
the paper's text says."""
SAMPLINGS: tuple[Sampling, ...] = get_args(Sampling)

SIGMA_LIMIT = 0.25
"""Value of sigma_r, or of a surface's sigma, from which no mu is possible."""


def redrawn_share(sigma_r: float, sampling: Sampling = "sigma_r") -> float:
    """Return the share of random sigma that leave no possible mu and are drawn again.

    mu is the input coefficient and sigma its uncertainty. With the ``sampling`` "sigma_n", a sigma of
    `SIGMA_LIMIT` or more is drawn again: the share is exp(-1 / (32 sigma_r²)). With "sigma_r" it is 0.
    """
    if sampling == "sigma_r":
        return 0.0
    return float(np.exp(-(SIGMA_LIMIT**2) / (2 * sigma_r**2)))


def realisations(
    rng: np.random.Generator, count: int, n: int, sigma_r: float, sampling: Sampling = "sigma_r"
) -> tuple[Array, Array]:
    """Return random input coefficients mu and their uncertainty sigma, (count, n) each.

    sigma has a Rayleigh distribution with the scale ``sigma_r``, mu a uniform one. With the
    ``sampling`` "sigma_r", mu is from 2 sigma_r to 1 - 2 sigma_r. With "sigma_n", it is from 2 sigma to
    1 - 2 sigma, and a sigma of 0.25 or more is drawn again.
    """
    below = 1 - redrawn_share(sigma_r, sampling)
    sigma = sigma_r * np.sqrt(-2 * np.log1p(-below * (1 - rng.random((count, n)))))
    if sampling == "sigma_r":
        return 2 * sigma_r + (1 - 4 * sigma_r) * rng.random((count, n)), sigma
    sigma = np.minimum(sigma, np.nextafter(SIGMA_LIMIT, 0))  # rounding at the far end
    return 2 * sigma + (1 - 4 * sigma) * rng.random((count, n)), sigma


def trials(rng: np.random.Generator, mu: Array, sigma: Array, z: Array) -> None:
    """Fill ``z`` (n, trials) with random (alpha - mu)/sigma of normal alpha truncated to 0 to 1.

    ``mu`` and ``sigma`` are (n,). Values outside 0 to 1 are drawn again. With the sampling "sigma_n"
    these are at most one in twenty, because mu is at least 2 sigma from 0 and 1. With "sigma_r" a
    surface may have more.
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
    from rtcal.studies import trials_kernel

    indices = np.empty(z.size, np.intp)
    return indices[: trials_kernel.outside(z, low, high, indices)]


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


def _expected_errors(second_moment: Array, q: Array, areas: Array) -> Array:
    """Return the expected mean square error (EMSE) without and with each calibration, (..., 4).

    ``second_moment`` (..., n, n) is G = E ee' of the error e of the input coefficients. ``q`` (..., 3,
    n) are the directions of three calibrations without bounds, and ``areas`` S (n,) are in m². n EMSE =
    tr G - 2 q'GS/(S'q) + |q|² S'GS/(S'q)².
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
    """Hold what all trials of one realisation, with its mu and sigma, have in common.

    ``q`` (3, n) are the directions of the three calibrations. ``delta`` and ``multiplier`` (3, 2 n) are
    tables of the change of the absorption area, delta(D) = S'(mu - clip(mu - D q, 0, 1)), over the
    multiplier D. For delta from ``least`` to ``most`` (3,), no coefficient reaches 0 or 1, and the
    closed form holds.
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
    """Hold sums over trials, from which the errors of three calibrations follow.

    ``squares`` is e'e of the errors e before calibration. ``products`` (4,) are delta², and delta e'q
    of each calibration, with the error delta = S'e of the absorption area and the calibration's
    direction q. ``change`` (3,) is e'e of the bounded minus that of the unbounded estimate. ``active``
    (3,) is the number of trials in which these two estimates differ.
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
    from rtcal.studies import trials_kernel

    # e = mu - alpha* = -sigma z; the rows give delta = S'e and e'q from z
    rows = -np.vstack([room.areas * room.sigma, room.q * room.sigma])
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


def analytic_emse(mu: Array, sigma: Array, areas: Array) -> Array:
    """Return the expected mean square error (EMSE) of alpha for four methods, (..., 4).

    The last axis has the methods in this order: no calibration, scaling, least squares (LSE) and
    maximum likelihood (MLE), without bounds. ``mu`` and ``sigma`` (..., n) are the input coefficients
    and their standard deviations, ``areas`` (n,) the surface areas in m². The formula is Eq. 30 of
    Bellows & Katz (2025), with a term that the equation omits: mu is not the mean of the truncated
    normal distribution of alpha.
    """
    # Integrated, since the closed forms (Eqs. 14 and 31) lose all digits in the tails.
    mean, variance = truncated_moments(mu, sigma**2, 0.0, 1.0, FINE)
    bias = mu - mean
    second = bias[..., :, np.newaxis] * bias[..., np.newaxis, :]
    second += np.eye(areas.size) * variance[..., np.newaxis, :]
    return _expected_errors(second, directions(mu, sigma, areas), areas)


SIGMA_R = (0.01, 0.05, 0.1)
"""Scales sigma_r of the uncertainty of the input coefficients in Tables 2 and 3 of the paper."""

TABLE_2: dict[str, tuple[float, ...]] = {
    "none": (0.0, 0.0, 0.0),
    "scaling": (4.4, 5.4, 6.4),
    "lse": (8.7, 8.7, 8.7),
    "mle": (14.8, 14.3, 13.2),
}
"""Calibration scores of the shoebox in percent, by sigma_r, as printed in the paper's Table 2."""

TABLE_3: dict[str, tuple[float, ...]] = {
    "none": (0.0, 0.0, 0.0),
    "scaling": (-1.2, -0.8, -0.3),
    "lse": (2.2, 2.2, 2.2),
    "mle": (3.8, 3.7, 3.3),
}
"""Calibration scores of the lecture hall in percent, by sigma_r, as printed in the paper's Table 3."""

TABLE_1_MU = (0.66, 0.45, 0.88, 0.83, 0.12, 0.52)
TABLE_1_SIGMA = (0.04, 0.07, 0.06, 0.01, 0.05, 0.06)
TABLE_1_EMSE: dict[str, float] = {
    "none": 26.8e-4,
    "scaling": 25.0e-4,
    "lse": 22.0e-4,
    "mle": 20.0e-4,
}
"""Mean square error of the coefficients of the room in the paper's Table 1, by method."""
_HALF_DIGIT = 0.005


def table_1_range(areas: Array) -> tuple[Array, Array]:
    """Return the lowest and the highest error of alpha that Table 1 of Bellows & Katz (2025) allows.

    Both are (4,): the mean square errors of the four methods of `analytic_emse`. The table prints
    mu and sigma of six surfaces with two decimals; here they are varied at random within half of
    their last digit, 4000 times, and the errors are the 1st and the 99th percentile. ``areas`` (6,)
    are in m².
    """
    rng = np.random.default_rng(0)
    shape = (4000, len(TABLE_1_MU))
    mu = np.array(TABLE_1_MU) + rng.uniform(-_HALF_DIGIT, _HALF_DIGIT, shape)
    sigma = np.array(TABLE_1_SIGMA) + rng.uniform(-_HALF_DIGIT, _HALF_DIGIT, shape)
    emse = analytic_emse(mu, sigma, checks.array("areas", areas))
    low, high = np.quantile(emse, [0.01, 0.99], axis=0)
    return low, high


SHOEBOX: tuple[float, ...] = (35.0, 35.0, 21.0, 21.0, 15.0, 15.0)
"""Surface areas in m² of a box of 105 m³: floor and ceiling 7 x 5 m, walls 7 x 3 m and 5 x 3 m."""

HALL_VOLUME, HALL_SURFACES, HALL_RATIO = 334.0, 23, 66.6
"""The paper's lecture hall: volume in m³, number of surfaces, ratio of largest to smallest area."""

LECTURE_HALL: dict[str, float] = {
    # A closed box of 12.5 x 8 x 3.34 m = 334 m³: floor and ceiling 100 m², walls 41.75 and 26.72 m².
    "seats": 59.94,
    "floor in front": 20.0,
    "aisles": 12.06,
    "podium": 8.0,
    "perforated ceiling": 52.0,
    "plain ceiling": 33.0,
    "lights and grilles": 15.0,
    "windows": 18.0,
    "plaster, window side": 14.75,
    "radiators": 6.0,
    "curtain": 3.0,
    "wood panels": 24.0,
    "plaster, door side": 13.55,
    "double door": 4.2,
    "blackboard": 9.6,
    "plaster, front": 9.0,
    "screen": 6.0,
    "front door": 2.12,
    "absorber": 12.0,
    "plaster, rear": 8.8,
    "control window": 2.92,
    "rear door": 2.1,
    "notice board": 0.9,
}


def random_hall(seed: int) -> tuple[float, ...]:
    """Return the surface areas in m² of a random hall like the lecture hall of Bellows & Katz (2025).

    The hall is a box of 334 m³ with random proportions, and its faces are cut at random into 23
    surfaces, of which the largest is 66.6 times as large as the smallest. ``seed`` is that of the
    random numbers.
    """
    rng = np.random.default_rng(checks.whole("seed", seed, 0))
    height, proportion = rng.uniform(3.0, 5.0), rng.uniform(1.0, 1.8)
    width = np.sqrt(HALL_VOLUME / height / proportion)
    length = proportion * width
    faces = np.repeat([length * width, length * height, width * height], 2)
    counts = 1 + rng.multinomial(HALL_SURFACES - 6, faces / faces.sum())
    cuts = [rng.uniform(0.2, 1.0, k) for k in counts]

    def cut(exponent: float) -> np.ndarray:
        return np.concatenate(
            [face * c**exponent / np.sum(c**exponent) for face, c in zip(faces, cuts, strict=True)]
        )

    low, high = 0.0, 20.0  # the ratio grows with the exponent
    for _ in range(100):
        middle = (low + high) / 2
        areas = cut(middle)
        low, high = (middle, high) if np.ptp(np.log(areas)) < np.log(HALL_RATIO) else (low, middle)
    return tuple(cut(high).tolist())


HALL_SEEDS = (1, 2, 3, 4, 5)
"""Seeds of the five random halls that are reported."""
