"""The calibration QP without a solver: exact for millions of rooms, and the paper's closed forms.

`solve` takes one band of many rooms: minimise ½ sum ((alpha - mu)/sigma)² subject to S'alpha = b and
lower <= alpha <= upper. That is a continuous quadratic knapsack: alpha = clip(mu - D S sigma², lower,
upper) with one multiplier D. The closed form comes first. If it leaves the box, variable fixing
follows (Bitran & Hax 1981; Kiwiel 2008): fix the violators of the dominant side at their bounds, solve
for the other coefficients, and repeat. Two or three rounds are usual. No solver runs, and no result
depends on a tolerance. Tolerances and soft matches are supported. For coupled bands or several
configurations of a room use `rtcal.Calibration`.

`least_squares`, `maximum_likelihood` and `scaling` are the paper's: their answers satisfy S'alpha = b
exactly and may lie outside [0, 1]. They take one band ``(n_materials,)`` with a scalar target, or
``(n_materials, n_bands)`` with ``(n_bands,)``.

Nothing here shares code with `rtcal.Calibration`: the tests check one by the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtcal.support import checks, speed
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.types import Array

__all__ = [
    "ABOVE",
    "BAD_INPUT",
    "BELOW",
    "OK",
    "Answer",
    "least_squares",
    "maximum_likelihood",
    "multiplier",
    "scaling",
    "solve",
]
__dir__ = __all__.copy

OK, BELOW, ABOVE, BAD_INPUT = 0, 1, 2, 3
"""Values of ``status``: solved; target below or above what the bounds allow; invalid datum."""

EPS = float(np.finfo(float).eps)
LEAST_SIGMA = 1e-140
"""Least sigma above 0. The squares of smaller ones, times an area, round to 0."""
CHUNK = 4096  # rows per step of the NumPy engine, so that its temporaries fit into the cache


class Answer(NamedTuple):
    """The minimisers of a batch.

    ``alpha`` (..., n); ``multiplier`` D (...) in 1/m²; ``status`` (...) of `OK`, `BELOW`, `ABOVE`,
    `BAD_INPUT`. Where status is not 0, alpha and multiplier are NaN.
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
    tolerance: ArrayLike = 0.0,
    uncertainty: ArrayLike = 0.0,
    engine: str = "auto",
    out: Array | None = None,
) -> Answer:
    """Return the exact minimisers of a batch of calibration QPs, one band each.

    alpha = clip(mu - D S sigma², lower, upper) with S'alpha = b; with an ``uncertainty`` u the
    objective has ½ (S'alpha - b)²/u² in place of the equality (then D = (S'alpha - b)/u²); with a
    ``tolerance`` t it is |S'alpha - b| <= t.

    Parameters
    ----------
    mu, sigma : array (..., n)
        Prior means and standard deviations. A coefficient with sigma = 0 is fixed at mu, which must
        lie within the bounds. With sigma > 0, mu may lie outside them.
    areas : array (..., n)
        m², not negative.
    target : array (...)
        b in m².
    lower, upper : float or array (..., n)
        Bounds, finite.
    tolerance, uncertainty : float or array (...)
        m², 0 for an exact match; at most one of the two may be above 0.
    engine : {"auto", "numba", "numpy"}
        The compiled kernel where numba is installed, or the NumPy engine.
    out : array (..., n), optional
        C-contiguous float64 of the answer's shape; written and returned as ``alpha``.

    Returns
    -------
    Answer
        ``alpha, multiplier, status``. b within 16 n eps sum |S bound| of the least or largest S'alpha
        that the bounds allow counts as that end. At an end any multiplier of an interval is optimal;
        the one nearest 0 is returned.

    Raises
    ------
    DataError
        If shapes do not fit, a value is not a number or masked, ``out`` cannot be written to, or both
        ``tolerance`` and ``uncertainty`` are stated. A row with NaN, a negative area, a negative
        sigma, one above 0 and below `LEAST_SIGMA`, lower above upper or a fixed mu outside the bounds
        raises no error: its status is 3.
    MissingDependencyError
        With ``engine="numba"`` where numba is not installed.

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
    vectors = [
        checks.array(name, x)
        for x, name in (
            (mu, "mu"),
            (sigma, "sigma"),
            (areas, "areas"),
            (lower, "lower"),
            (upper, "upper"),
        )
    ]
    scalars = [
        checks.array(name, x)
        for x, name in (
            (target, "target"),
            (tolerance, "tolerance"),
            (uncertainty, "uncertainty"),
        )
    ]
    if any(x.ndim == 0 for x in vectors[:3]):
        raise DataError("mu, sigma and areas need at least one axis, the coefficients: (..., n)")
    if np.any(scalars[1] != 0) and np.any(scalars[2] != 0):
        raise DataError("give a tolerance or an uncertainty, not both: they are two models")
    try:
        (n,) = np.broadcast_shapes(*(x.shape[-1:] for x in vectors))
        batch = np.broadcast_shapes(*(x.shape[:-1] for x in vectors), *(x.shape for x in scalars))
    except ValueError as error:
        shapes = ", ".join(str(x.shape) for x in vectors + scalars)
        raise DataError(
            "the shapes of mu, sigma, areas, lower, upper (..., n) and target, tolerance, "
            f"uncertainty (...) do not fit: {shapes}"
        ) from error
    alpha = np.empty((*batch, n)) if out is None else out
    if not isinstance(alpha, np.ndarray) or np.ma.isMaskedArray(alpha):
        raise DataError("out is not an array that can be written to")
    if alpha.shape != (*batch, n) or alpha.dtype != float or not alpha.flags.c_contiguous:
        raise DataError(f"out must be C-contiguous float64 of shape {(*batch, n)}")
    if not alpha.flags.writeable:
        raise DataError("out is read-only; the answer is written to it")
    multiplier, status = np.empty(batch), np.empty(batch, np.int8)
    rows = int(np.prod(batch, dtype=int))
    m, g, s, low, high = (_rows(x, batch, n) for x in vectors)
    b, give, slack = (_rows(x[..., np.newaxis], batch, 1)[:, 0] for x in scalars)
    a, d, code = alpha.reshape(rows, n), multiplier.reshape(rows), status.reshape(rows)
    with np.errstate(over="ignore"):
        endless = ~np.isfinite(slack**2)
    if endless.any():
        b = np.where(endless, np.nan, b)  # invalid, whatever the engine makes of infinity
    if g.size and np.nanmin(g, initial=1.0) < LEAST_SIGMA:
        b = np.where(((g > 0) & (g < LEAST_SIGMA)).any(axis=-1), np.nan, b)
    data = (m, g, s, b, low, high, give, slack)
    if _engine(engine) == "numba":
        from rtcal.calibration import exact_kernel

        exact_kernel.solve_rows(*data, a, d, code)
    else:
        for start in range(0, rows, CHUNK):
            part = slice(start, start + CHUNK)
            few = [x[part] if len(x) > 1 else x for x in data]
            _solve_chunk(few, a[part], d[part], code[part])
    return Answer(alpha, multiplier, status)


def _engine(name: str) -> str:
    if name not in ("auto", "numba", "numpy"):
        raise DataError(f'engine = "{name}" is not one of "auto", "numba", "numpy"')
    if name == "numba" and not speed.available():
        raise MissingDependencyError('engine="numba" needs numba: pip install "rtcal[fast]"')
    return "numpy" if name == "numpy" or not speed.available() else "numba"


def _rows(x: Array, batch: tuple[int, ...], n: int) -> Array:
    """Return ``x`` as contiguous rows (rows, n), or (1, n) if all rows are the same."""
    if x.size == x.shape[-1] if x.ndim else True:
        return np.ascontiguousarray(np.broadcast_to(x.reshape(-1), (n,))).reshape(1, n)
    return np.ascontiguousarray(np.broadcast_to(x, (*batch, n))).reshape(-1, n)


def _solve_chunk(
    data: Sequence[Array], alpha: Array, multiplier: Array, status: NDArray[np.int8]
) -> None:
    """Solve some rows with NumPy, by the arithmetic of `exact_kernel.solve_rows`."""
    m, g, s, b, low, high, give, slack = data
    rows, n = alpha.shape
    with np.errstate(all="ignore"):  # rows with bad input get NaN below
        held = g == 0
        bottom, top = np.where(held, m, low), np.where(held, m, high)
        w = s * g * g
        least, most = _sum(s * bottom), _sum(s * top)
        near = 16 * n * EPS * _sum(s * np.maximum(abs(bottom), abs(top)))
        base, spread = _sum(s * m), _sum(s * w)
        sound = (s >= 0) & (g >= 0) & (low <= high) & (bottom >= low) & (top <= high)
        total = base + spread + least + most + near + b + slack * slack + give
        good = sound.all(axis=-1) & np.isfinite(total) & (give >= 0) & (slack >= 0)
        clipped = np.clip(m, low, high)
        start = _sum(s * clipped)
        inside = (give > 0) & (abs(start - b) <= give)
        b = b + np.where(inside, 0.0, np.where(start > b, give, -give))
        exact = slack == 0
        below, above = exact & (b < least - near), exact & (b > most + near)
        at_low = exact & (b <= least + near) & (b - least <= most - b)
        at_high = exact & (b >= most - near) & ~at_low
        d = (base - b) / (spread + slack * slack)
        a = m - d[:, np.newaxis] * w
        outside = ((a < low) | (a > high)).any(axis=-1)
        free = w > 0
        ends = ((at_low, low, np.max, -np.inf), (at_high, high, np.min, np.inf))
        for at, bound, extreme, never in ends:
            if np.any(at):
                leaves = extreme(np.where(free, (m - bound) / w, never), axis=-1)
                d = np.where(at, np.where(np.isfinite(leaves), leaves, 0.0), d)
                a = np.where(at[:, np.newaxis], np.where(free, bound, clipped), a)
    code = np.where(below, BELOW, np.where(above, ABOVE, OK))
    code = np.where(inside, OK, code)
    status[:] = np.where(good, code, BAD_INPUT)
    multiplier[:] = np.where(inside, 0.0, d)
    alpha[:] = np.where(inside[:, np.newaxis], clipped, a)
    fixing = good & (code == OK) & outside & ~inside & ~at_low & ~at_high
    if np.any(fixing):
        pick = np.flatnonzero(np.broadcast_to(fixing, (rows,)))
        row = [
            x[pick] if len(x) > 1 else np.broadcast_to(x, (pick.size, *x.shape[1:]))
            for x in (m, np.asarray(w), s, low, high, b, slack * slack)
        ]
        alpha[pick], multiplier[pick] = _fix(*row)
    unsolved = status != OK
    alpha[unsolved] = np.nan
    multiplier[unsolved] = np.nan


def _sum(x: Array) -> Array:
    return np.asarray(x.sum(axis=-1))


def _fix(
    m: Array, w: Array, s: Array, low: Array, high: Array, b: Array, slack: Array
) -> tuple[Array, Array]:
    """Variable fixing on rows that the closed form leaves outside the box; return alpha and D."""
    free = w.copy()  # weights S sigma² of free coefficients, 0 of others
    base = np.where(
        w > 0, m, np.clip(m, low, high)
    )  # mu of free coefficients, the bound of pegged ones
    rows = np.arange(len(m))  # not solved yet
    for _ in range(m.shape[1] + 1):
        ss, lo, hi, ff, base_now = (x[rows] for x in (s, low, high, free, base))
        spread = _sum(ss * ff) + slack[rows]
        stuck = spread == 0
        d = (_sum(ss * base_now) - b[rows]) / np.where(stuck, 1.0, spread)
        a = base_now - d[:, np.newaxis] * ff
        under, over = _sum(ss * np.maximum(lo - a, 0.0)), _sum(ss * np.maximum(a - hi, 0.0))
        # If the clipped S'a is too large, D must rise, so coefficients at their lower bound stay there.
        to_low = (a < lo) & (under >= over)[:, np.newaxis]
        to_high = (a > hi) & (under <= over)[:, np.newaxis]
        base[rows] = np.where(to_low, lo, np.where(to_high, hi, base_now))
        free[rows] = np.where(to_low | to_high, 0.0, ff)
        rows = rows[~stuck & ((under > 0) | (over > 0))]
        if rows.size == 0:
            break
    # The free coefficients' share is a small difference of large areas: compensated summation.
    spread = _sum(s * free) + slack
    stuck = spread == 0
    d = _excess(s, base, b) / np.where(stuck, 1.0, spread)
    alpha = np.clip(base - d[:, np.newaxis] * free, low, high)
    alpha[stuck], d[stuck] = base[stuck], _meeting(*(x[stuck] for x in (m, w, low, high, base)))
    return alpha, d


def _meeting(m: Array, w: Array, low: Array, high: Array, a: Array) -> Array:
    """Return D if all coefficients are at bounds: the optimal D nearest 0."""
    bound, safe = (w > 0) & (low < high), np.where(w > 0, w, 1.0)
    start = np.where(bound & (a == low), (m - low) / safe, -np.inf).max(axis=-1)
    stop = np.where(bound & (a != low), (m - high) / safe, np.inf).min(axis=-1)
    d = np.where(abs(start) <= abs(stop), start, stop)
    return np.where(np.isfinite(d), d, 0.0)


def _excess(s: Array, a: Array, b: Array) -> Array:
    """Return S'a - b as if summed in twice the precision (Dekker's product, Knuth's sum)."""
    product = s * a
    (s_high, s_low), (a_high, a_low) = _split(s), _split(a)
    error = s_low * a_low - (((product - s_high * a_high) - s_low * a_high) - s_high * a_low)
    total, lost = -b, _sum(error)
    for i in range(s.shape[-1]):
        larger = total + product[:, i]
        part = larger - total
        lost = lost + (total - (larger - part)) + (product[:, i] - part)
        total = larger
    return np.asarray(total + lost)


def _split(x: Array) -> tuple[Array, Array]:
    cut = 134217729.0 * x  # 2^27 + 1: halves of 26 bits, whose products do not round
    high = cut - (cut - x)
    return high, x - high


def least_squares(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return the coefficients nearest to ``mu`` with S'alpha = b (Bellows & Katz 2025, Eqs. 9, 10).

    alpha = mu - C S,  C = (S'mu - b) / S'S.

    Examples
    --------
    >>> print(least_squares([0.4, 0.6], [20, 74], 33.6).round(2))
    [0.34 0.36]
    """
    return maximum_likelihood(mu, np.ones_like(_finite("mu", mu)), areas, target)


def maximum_likelihood(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return the likeliest coefficients with S'alpha = b (Bellows & Katz 2025, Eqs. 22 to 25).

    alpha = mu - D S sigma²,  D = (S'mu - b) / sum S² sigma².

    Parameters
    ----------
    mu, sigma : array (n_materials,) or (n_materials, n_bands)
        Prior means and standard deviations; a coefficient with sigma = 0 does not change.
    areas : array (n_materials,)
        m².
    target : float or array (n_bands,)
        b in m².

    Raises
    ------
    DataError
        If shapes do not fit, a value is not finite, or all sigma of a band are 0.

    Examples
    --------
    >>> print(maximum_likelihood([0.6, 0.5], [0.05, 0.1], [47, 47], 37.6).round(2))
    [0.54 0.26]
    """
    mu, areas, target = _checked(mu, areas, target)
    sigma = _finite("sigma", sigma)
    if sigma.shape != mu.shape:
        raise DataError(f"sigma has shape {sigma.shape}; mu has {mu.shape}")
    if (sigma < 0).any():
        raise DataError(f"sigma has {sigma.min():g}, which is not 0 or more")
    weight = _along(areas, mu) * sigma**2
    room_to_move = areas @ weight
    if np.any(room_to_move == 0):
        raise DataError("all sigma of a band are 0; no coefficient there can move")
    return np.asarray(mu - multiplier(mu, sigma, areas, target) * weight)


def multiplier(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return D = (S'mu - b) / sum S² sigma² in 1/m², a scalar or (n_bands,) (Eqs. 23 to 25)."""
    mu, areas, target = _checked(mu, areas, target)
    sigma = _finite("sigma", sigma)
    if sigma.shape != mu.shape or (sigma < 0).any():
        raise DataError(f"sigma has not the shape {mu.shape} of mu, or a value below 0")
    spread = areas**2 @ sigma**2
    if np.any(spread == 0):
        raise DataError("all sigma of a band are 0; no coefficient there can move")
    return np.asarray((areas @ mu - target) / spread)


def scaling(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return all coefficients scaled alike, alpha = mu b / S'mu (Bellows & Katz 2025, Eqs. 36, 37).

    Raises
    ------
    DataError
        If shapes do not fit, or S'mu = 0: no factor then gives b.

    Examples
    --------
    >>> print(scaling([0.2, 0.4], [20, 20], 6.0).round(2))
    [0.1 0.2]
    """
    mu, areas, target = _checked(mu, areas, target)
    absorption_area = areas @ mu
    if np.any(absorption_area == 0):
        raise DataError("S'mu = 0: scaling cannot reach any target from there")
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
        raise DataError(f"areas has {areas.min():g} m², which is not above 0")
    return mu, areas, target


def _finite(name: str, values: object) -> Array:
    array = checks.array(name, values)
    if not np.isfinite(array).all():
        raise DataError(f"{name} has a value that is not finite")
    return array


def _along(areas: Array, mu: Array) -> Array:
    return areas if mu.ndim == 1 else areas[:, np.newaxis]
