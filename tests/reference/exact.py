"""The exact batch in NumPy, by the arithmetic of `rtcal.calibration.exact_kernel`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.calibration.exact import ABOVE, BAD_INPUT, BELOW, EPS, OK
from rtcal.support.types import Array


def solve_rows(
    m: Array,
    g: Array,
    s: Array,
    b: Array,
    low: Array,
    high: Array,
    slack: Array,
    alpha: Array,
    multiplier: Array,
    status: NDArray[np.int8],
) -> None:
    """Solve some rows; see `rtcal.calibration.exact_kernel.solve_rows`."""
    rows, n = alpha.shape
    with np.errstate(all="ignore"):  # rows with bad input get NaN below
        held = g == 0
        bottom, top = np.where(held, m, low), np.where(held, m, high)
        w = s * g * g
        least, most = _sum(s * bottom), _sum(s * top)
        near = 16 * n * EPS * _sum(s * np.maximum(abs(bottom), abs(top)))
        base, spread = _sum(s * m), _sum(s * w)
        sound = (s >= 0) & (g >= 0) & (low <= high) & (bottom >= low) & (top <= high)
        total = base + spread + least + most + near + b + slack * slack
        good = sound.all(axis=-1) & np.isfinite(total) & (slack >= 0)
        clipped = np.clip(m, low, high)
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
    status[:] = np.where(good, code, BAD_INPUT)
    multiplier[:] = d
    alpha[:] = a
    fixing = good & (code == OK) & outside & ~at_low & ~at_high
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
