"""The calibration QP without a solver: exact for millions of rooms, and the paper's closed forms.

`solve` takes one band of many rooms: minimise ½ sum ((alpha - mu)/sigma)² subject to S'alpha = b and
lower <= alpha <= upper. That is a continuous quadratic knapsack: alpha = clip(mu - D S sigma², lower,
upper) with one multiplier D. The closed form comes first. If it leaves the box, variable fixing
follows (Bitran & Hax 1981; Kiwiel 2008): fix the violators of the dominant side at their bounds, solve
for the other coefficients, and repeat. Two or three rounds are usual. No solver runs, and no result
depends on a tolerance. For coupled bands, a T within limits or several configurations of a room use
`rtcal.Calibration`.

`least_squares`, `maximum_likelihood` and `scaling` are the paper's: their answers satisfy S'alpha = b
exactly and may lie outside [0, 1]. They take one band ``(n_materials,)`` with a scalar target, or
``(n_materials, n_bands)`` with ``(n_bands,)``.

Nothing here shares code with `rtcal.Calibration`: the tests check one by the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["OK", "least_squares", "maximum_likelihood", "multiplier", "scaling", "solve"]
__dir__ = __all__.copy

OK, BELOW, ABOVE, BAD_INPUT = 0, 1, 2, 3
"""Values of ``status``: solved; target below, or above, the range of the bounds; invalid input."""

EPS = float(np.finfo(float).eps)
LEAST_SIGMA = 1e-140
"""Smallest standard deviation above 0. The squares of smaller ones, times an area, round to 0."""


class Answer(NamedTuple):
    """Calibrated coefficients of many rooms and bands, as `solve` returns them.

    ``alpha`` (..., n) are the coefficients, ``multiplier`` (...) is D in 1/m² (see `solve`), and
    ``status`` (...) is `OK`, `BELOW`, `ABOVE` or `BAD_INPUT`. Where it is not `OK`, the others are NaN.
    """

    alpha: Array
    multiplier: Array
    status: NDArray[np.int8]


def solve(
    mu: ArrayLike,
    sigma: ArrayLike,
    areas: ArrayLike,
    target: ArrayLike,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = 1.0,
    *,
    uncertainty: ArrayLike = 0.0,
) -> Answer:
    """Return the calibrated coefficients of many rooms and bands at once, without a solver.

    Each band is one problem: minimise ½ sum ((alpha - mu) / sigma)² with S'alpha = b within the bounds.
    The answer is alpha = clip(mu - D S sigma², lower, upper), with the areas S and one number D. With
    an ``uncertainty`` u the term ½ (S'alpha - b)² / u² replaces S'alpha = b, and D = (S'alpha - b) /
    u².

    Parameters
    ----------
    mu, sigma : array (..., n)
        Input coefficients and their standard deviations. A coefficient with sigma = 0 stays at mu,
        which must be within the bounds. With sigma > 0, mu may be outside.
    areas : array (..., n)
        Areas S in m², not negative.
    target : array (...)
        Absorption area b that the measured T needs, in m².
    lower, upper : float or array (..., n)
        Bounds of the coefficients, finite.
    uncertainty : float or array (...)
        Standard uncertainty u of the absorption area b in m², 0 for an exact match.

    Returns
    -------
    Answer
        ``alpha`` (..., n), the ``multiplier`` D (...) in 1/m², and a ``status`` (...) per problem: 0
        solved, 1 or 2 if b is below or above what the bounds allow, 3 for invalid values: NaN, a
        negative area, a negative sigma or one below 1e-140, lower above upper, or a fixed mu outside
        the bounds. With a status other than 0, alpha and D are NaN.

        The bounds allow b from b_min = sum S lower to b_max = sum S upper. Because sums are rounded, a
        b that differs from b_min or b_max by at most 16 n eps sum |S bound|, with eps = 2.2e-16, counts
        as equal to it if u = 0, and has the status 0. All coefficients are then at their bounds, which
        many values of D give; the one nearest to 0 is returned.

    Raises
    ------
    DataError
        If shapes do not fit, or a value is no number or masked. Invalid values of single problems raise
        no error.

    References
    ----------
    Bellows & Katz (2025), Eqs. 19 to 25, with the bounds kept. Bitran & Hax (1981), Management
    Science 27, 431; Kiwiel (2008), Math. Program. 112, 473.

    Examples
    --------
    The paper's Fig. 3b, then a target that the closed form cannot reach within the bounds:

    >>> alpha, multiplier, status = solve([0.6, 0.5], [0.05, 0.1], [47, 47], [37.6, 10.0])
    >>> print(alpha.round(3))
    [[0.54  0.26 ]
     [0.213 0.   ]]
    >>> print(status)
    [0 0]
    """
    given = {"mu": mu, "sigma": sigma, "areas": areas, "lower": lower, "upper": upper}
    vectors = [checks.array(name, x) for name, x in given.items()]
    scalars = [checks.array("target", target), checks.array("uncertainty", uncertainty)]
    if any(x.ndim == 0 for x in vectors[:3]):
        raise DataError(
            "mu, sigma and areas need at least one axis, which holds the coefficients: (..., n)"
        )
    try:
        (n,) = np.broadcast_shapes(*(x.shape[-1:] for x in vectors))
        batch = np.broadcast_shapes(*(x.shape[:-1] for x in vectors), *(x.shape for x in scalars))
    except ValueError as error:
        shapes = ", ".join(str(x.shape) for x in vectors + scalars)
        raise DataError(
            "the shapes of mu, sigma, areas, lower, upper (..., n) and target, uncertainty (...) do "
            f"not fit: {shapes}"
        ) from error
    multiplier, status = np.empty(batch), np.empty(batch, np.int8)
    rows, alpha = int(np.prod(batch, dtype=int)), np.empty((*batch, n))
    m, g, s, low, high = (_rows(x, batch, n) for x in vectors)
    b, slack = (_rows(x[..., np.newaxis], batch, 1)[:, 0] for x in scalars)
    a, d, code = alpha.reshape(rows, n), multiplier.reshape(rows), status.reshape(rows)
    with np.errstate(over="ignore"):
        endless = ~np.isfinite(slack**2)
    if endless.any():
        b = np.where(endless, np.nan, b)  # invalid, whatever the kernel makes of infinity
    if g.size and np.nanmin(g, initial=1.0) < LEAST_SIGMA:
        b = np.where(((g > 0) & (g < LEAST_SIGMA)).any(axis=-1), np.nan, b)
    for x in (m, g, s, b, low, high, slack):
        x.setflags(write=False)  # else the kernel is compiled anew for each mixture of the two
    from rtcal.calibration import exact_kernel

    exact_kernel.solve_rows(m, g, s, b, low, high, slack, a, d, code)
    return Answer(alpha, multiplier, status)


def _rows(x: Array, batch: tuple[int, ...], n: int) -> Array:
    """Return ``x`` as contiguous rows (rows, n), or (1, n) if all rows are the same."""
    if x.size == x.shape[-1] if x.ndim else True:
        return np.ascontiguousarray(np.broadcast_to(x.reshape(-1), (n,))).reshape(1, n)
    return np.ascontiguousarray(np.broadcast_to(x, (*batch, n))).reshape(-1, n)


def least_squares(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return the coefficients nearest to the input that have a given absorption area, without sigma.

    All coefficients count as equally uncertain: alpha = mu - C S with C = (S'mu - b) / S'S (Bellows &
    Katz 2025, Eqs. 9, 10). ``mu`` (n_materials,) or (n_materials, n_bands) are the input coefficients,
    ``areas`` S (n_materials,) are in m², and ``target`` b, a number or (n_bands,), is the absorption
    area in m². Coefficients may be below 0 or above 1. Raises DataError if shapes do not fit, a value
    is not finite, or an area is not above 0.

    Examples
    --------
    >>> print(least_squares([0.4, 0.6], [20, 74], 33.6).round(2))
    [0.34 0.36]
    """
    return maximum_likelihood(mu, np.ones_like(_finite("mu", mu)), areas, target)


def maximum_likelihood(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return the most likely coefficients that have a given absorption area, without bounds.

    The coefficients are alpha = mu - D S sigma² with D = (S'mu - b) / sum S² sigma² (Bellows & Katz
    2025, Eqs. 22 to 25). They may be below 0 or above 1; `solve` keeps bounds.

    Parameters
    ----------
    mu, sigma : array (n_materials,) or (n_materials, n_bands)
        Input coefficients and their standard deviations; a coefficient with sigma = 0 does not change.
    areas : array (n_materials,)
        Areas S in m².
    target : float or array (n_bands,)
        Absorption area b that the measured T needs, in m².

    Raises
    ------
    DataError
        If shapes do not fit, a value is not finite, an area is not above 0, a sigma is below 0, or all
        sigma of a band are 0.

    Examples
    --------
    >>> print(maximum_likelihood([0.6, 0.5], [0.05, 0.1], [47, 47], 37.6).round(2))
    [0.54 0.26]
    """
    d = multiplier(mu, sigma, areas, target)
    mu, sigma, areas = (np.asarray(x, dtype=float) for x in (mu, sigma, areas))
    along = areas if mu.ndim == 1 else areas[:, np.newaxis]
    return np.asarray(mu - d * along * sigma**2)


def multiplier(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return the number D in 1/m² by which `maximum_likelihood` changes each coefficient.

    The calibrated coefficients are mu - D S sigma². D = (S'mu - b) / sum S² sigma² is one number, or
    (n_bands,) (Bellows & Katz 2025, Eqs. 23 to 25). ``mu`` and ``sigma`` are the input coefficients and
    their standard deviations, (n_materials,) or (n_materials, n_bands). ``areas`` S (n_materials,) are
    in m², and ``target`` b is the absorption area in m² that the measured T needs, a number or
    (n_bands,). Errors are those of `maximum_likelihood`.
    """
    mu, areas, target = _checked(mu, areas, target)
    sigma = _finite("sigma", sigma)
    if sigma.shape != mu.shape:
        raise DataError(f"sigma has shape {sigma.shape}; it must be {mu.shape}, as mu")
    if (sigma < 0).any():
        raise DataError(f"sigma has {sigma.min():g}; every sigma must be 0 or more")
    spread = areas**2 @ sigma**2
    if np.any(spread == 0):
        raise DataError(
            "all sigma of a band are 0, so no coefficient of this band can change; give at least "
            "one above 0"
        )
    return np.asarray((areas @ mu - target) / spread)


def scaling(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return the coefficients times one factor that gives a required absorption area, without bounds.

    The coefficients are alpha = mu b / S'mu (Bellows & Katz 2025, Eqs. 36, 37). ``mu`` (n_materials,)
    or (n_materials, n_bands) are the input coefficients, ``areas`` S (n_materials,) are in m², and
    ``target`` b, a number or (n_bands,), is the required absorption area in m². Coefficients may exceed
    1.

    Raises
    ------
    DataError
        If shapes do not fit, a value is not finite, an area is not above 0, or S'mu = 0, so that no
        factor gives b.

    Examples
    --------
    >>> print(scaling([0.2, 0.4], [20, 20], 6.0).round(2))
    [0.1 0.2]
    """
    mu, areas, target = _checked(mu, areas, target)
    absorption_area = areas @ mu
    if np.any(absorption_area == 0):
        raise DataError(
            "S'mu = 0: the absorption of the input coefficients is 0, so no factor scales "
            "it to the target. Give a coefficient above 0"
        )
    return np.asarray(mu * (target / absorption_area))


def _checked(mu: Array, areas: Array, target: Array | float) -> tuple[Array, Array, Array]:
    mu, areas = _finite("mu", mu), _finite("areas", areas)
    target = _finite("target", target)
    if mu.ndim not in (1, 2) or areas.shape != mu.shape[:1] or target.shape != mu.shape[1:]:
        raise DataError(
            f"mu {mu.shape}, areas {areas.shape} and target {target.shape} do not fit: "
            "(n_materials,) and a scalar target, or (n_materials, n_bands) and (n_bands,)"
        )
    if (areas <= 0).any():
        raise DataError(f"areas has {areas.min():g} m²; every area must be above 0")
    return mu, areas, target


def _finite(name: str, values: object) -> Array:
    array = checks.array(name, values)
    if not np.isfinite(array).all():
        raise DataError(f"{name} has a value that is not finite")
    return array
