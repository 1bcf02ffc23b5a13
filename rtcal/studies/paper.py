"""The paper's rooms and printed numbers: Bellows & Katz (2025), surface areas and Tables 1 to 3.

The paper gives the shoebox (5 x 7 x 3 m) in full, but of its lecture hall only N = 23, V = 334 m³ and
the ratio 66.6 of its largest to its smallest area. `LECTURE_HALL` is a stand-in: a plausible closed
hall with exactly these numbers. `random_hall` draws further halls with the same numbers, to show how
much the scores depend on the areas that the paper does not state. Areas are in m².
"""

from __future__ import annotations

import numpy as np

from rtcal.studies.study import analytic_emse
from rtcal.support import checks
from rtcal.support.types import Array

__all__ = [
    "HALL_SEEDS",
    "LECTURE_HALL",
    "SHOEBOX",
    "SIGMA_R",
    "TABLE_1_EMSE",
    "TABLE_1_MU",
    "TABLE_1_SIGMA",
    "TABLE_2",
    "TABLE_3",
    "random_hall",
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


SHOEBOX: tuple[float, ...] = (35.0, 35.0, 21.0, 21.0, 15.0, 15.0)
"""Floor and ceiling 7 x 5 m, walls 7 x 3 m and 5 x 3 m; V = 105 m³."""

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
    """Return the areas of a random closed hall with the paper's three numbers.

    The hall is a box of 334 m³ with random proportions. Each face has one of the 23 surfaces; the
    others are on random faces, in proportion to area. Each face is cut at random. One exponent then
    makes all cuts more or less uneven, until the ratio of largest to smallest area is 66.6.
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
"""Seeds of the five halls that are reported: the first five."""
