"""The compiled loop of `rtcal.calibration.exact`: it solves the rows one by one, in one thread."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support.speed import compiled
from rtcal.support.types import Array

EPS = float(np.finfo(float).eps)
# The values of `exact`, which cannot be taken from there: it imports this module.
OK, BELOW, ABOVE, BAD_INPUT, PENDING = 0, 1, 2, 3, -1
STRIP = 64  # rows
LARGEST = float(np.finfo(float).max)
ROUNDING = 1e-13  # error of alpha up to which sums are not compensated
SPLIT = 134217729.0  # 2^27 + 1: halves of 26 bits, whose products do not round


@compiled(reorder=True)
def solve_rows(
    mu: Array,
    sigma: Array,
    areas: Array,
    target: Array,
    lower: Array,
    upper: Array,
    uncertainty: Array,
    alpha: Array,
    multiplier: Array,
    status: NDArray[np.int8],
) -> None:
    """Solve the problem of `rtcal.calibration.exact.solve` for each row, and write the answers.

    Inputs are ``mu``, ``sigma``, ``areas`` in m², ``lower`` and ``upper``, each (n_rows, n), and
    ``target`` and its standard ``uncertainty`` in m², each (n_rows,). An input with a single row is
    used for all rows. Answers are written into ``alpha`` (n_rows, n), ``multiplier`` D in 1/m²
    (n_rows,) and ``status`` (n_rows,).
    """
    rows, n = alpha.shape
    weight = np.empty(n)
    free, base_of = np.empty(n), np.empty(n)
    step_mu, step_sigma, step_areas = mu.shape[0] > 1, sigma.shape[0] > 1, areas.shape[0] > 1
    step_lower, step_upper, step_target = lower.shape[0] > 1, upper.shape[0] > 1, target.size > 1
    step_uncertainty = uncertainty.size > 1
    largest = 0.0
    # The closed form is inline, since a function call costs as much as a solution. The rows that it
    # does not solve follow while the strip is still in the cache.
    for start in range(0, rows, STRIP):
        stop = min(start + STRIP, rows)
        for r in range(start, stop):
            m, g, s = mu[r * step_mu], sigma[r * step_sigma], areas[r * step_areas]
            low, high, a = lower[r * step_lower], upper[r * step_upper], alpha[r]
            u = uncertainty[r * step_uncertainty]
            if r == 0 or step_lower or step_upper:
                largest = 0.0
                for i in range(n):
                    largest = max(largest, abs(low[i]), abs(high[i]))
            base = spread = area = variance = 0.0
            for i in range(n):
                v = g[i] * g[i]
                w = s[i] * v
                weight[i] = w
                base += s[i] * m[i]
                spread += s[i] * w
                area += s[i]
                variance += v
            d = (base - target[r * step_target]) / (spread + u * u)
            violations = 0
            room = 0.0
            for i in range(n):
                x = m[i] - d * weight[i]
                a[i] = x
                # Written so that NaN counts as a violation.
                violations += not ((x >= low[i]) & (x <= high[i]) & (s[i] >= 0) & (g[i] >= 0))
                room += weight[i] * (x - low[i]) * (high[i] - x)
            # If b counts as an end (see `exact.solve`), `room` is less than this.
            least_room = 32 * n * EPS * area * largest * largest * variance
            solved = violations == 0 and room > least_room
            multiplier[r] = d
            status[r] = OK if solved and u >= 0 else PENDING
        for r in range(start, stop):
            if status[r] == PENDING:
                status[r], multiplier[r] = careful(
                    mu[r * step_mu],
                    sigma[r * step_sigma],
                    areas[r * step_areas],
                    lower[r * step_lower],
                    upper[r * step_upper],
                    target[r * step_target],
                    uncertainty[r * step_uncertainty],
                    weight,
                    free,
                    base_of,
                    alpha[r],
                )


@compiled(reorder=True, inner=True)
def careful(
    m: Array,
    g: Array,
    s: Array,
    low: Array,
    high: Array,
    b: float,
    u: float,
    w: Array,
    free: Array,
    base: Array,
    a: Array,
) -> tuple[int, float]:
    """Solve a row that the closed form does not solve; return status and multiplier."""
    n = m.size
    for i in range(n):
        w[i] = s[i] * g[i] * g[i]
    least = most = size = total = 0.0
    bad = 0
    for i in range(n):
        # Local variables first: a choice between values can be vectorised, one between loads cannot.
        mean, spread, area, floor, ceiling = m[i], g[i], s[i], low[i], high[i]
        bottom = mean if spread == 0 else floor
        top = mean if spread == 0 else ceiling
        least += area * bottom
        most += area * top
        size += area * (abs(bottom) if abs(bottom) > abs(top) else abs(top))
        total += area * mean + area * area * spread * spread
        sound = (area >= 0) & (spread >= 0) & (floor <= bottom) & (bottom <= top) & (top <= ceiling)
        bad += not sound
    # A NaN or an infinity anywhere makes this NaN or infinite (isfinite would be optimised away).
    total += least + most + b + u * u
    if bad > 0 or not abs(total) <= LARGEST or u < 0:
        a[:] = np.nan
        return BAD_INPUT, np.nan
    near = 16 * n * EPS * size
    if u == 0 and (b <= least + near or b >= most - near):
        return at_end(m, g, w, low, high, b, least, most, near, a)
    return OK, fix(m, w, s, low, high, b, u * u, free, base, a)


@compiled(reorder=False, inner=True)
def at_end(
    m: Array,
    g: Array,
    w: Array,
    low: Array,
    high: Array,
    b: float,
    least: float,
    most: float,
    near: float,
    a: Array,
) -> tuple[int, float]:
    """Write the only feasible point for a b at an end; return status and multiplier."""
    below, above = b < least - near, b > most + near
    if below or above:
        a[:] = np.nan
        return (BELOW if below else ABOVE), np.nan
    bottom = b - least <= most - b
    d = 0.0
    first = True
    for i in range(m.size):
        bound = low[i] if bottom else high[i]
        if w[i] > 0:
            a[i] = bound
            leaves = (m[i] - bound) / w[i]
            if first or (leaves > d if bottom else leaves < d):
                d = leaves
                first = False
        else:  # fixed at mu if sigma = 0; without an area, the point nearest mu
            a[i] = m[i] if g[i] == 0 else min(max(m[i], low[i]), high[i])
    return OK, d


@compiled(reorder=True, inner=True)
def fix(
    m: Array,
    w: Array,
    s: Array,
    low: Array,
    high: Array,
    b: float,
    slack: float,
    free: Array,
    base: Array,
    a: Array,
) -> float:
    """Return the multiplier D of one problem with bounds, by fixing coefficients that violate a bound.

    Each round fixes all coefficients below their lower bounds, or all above their upper bounds: those
    whose violations add up to more absorption area. The problem has the input ``m``, the weights ``w``
    = S sigma², the areas ``s`` and the bounds ``low`` and ``high``, each (n,), and the required
    absorption area ``b``. ``slack`` is the deviation from b that counts as rounding. The coefficients a
    = base - D free are written into ``a`` (n,). Two arrays (n,) are overwritten: ``free`` has w,
    or 0 for fixed coefficients, and ``base`` has m, or the bound of fixed coefficients.
    """
    n = m.size
    for i in range(n):
        free[i] = w[i]
        base[i] = m[i]
        if w[i] == 0:
            base[i] = min(max(m[i], low[i]), high[i])
    d = spread = 0.0
    for _ in range(n + 1):
        excess, spread = -b, slack
        for i in range(n):
            excess += s[i] * base[i]
            spread += s[i] * free[i]
        if spread == 0:
            break
        d = excess / spread
        under = over = 0.0
        for i in range(n):
            x, floor, ceiling = base[i] - d * free[i], low[i], high[i]
            under += s[i] * (floor - x if x < floor else 0.0)
            over += s[i] * (x - ceiling if x > ceiling else 0.0)
        if under == 0 and over == 0:
            break
        # If the clipped S'a is too large, D must rise, so coefficients at their lower bound stay there.
        if under >= over:
            for i in range(n):
                kept, weight, floor = base[i], free[i], low[i]
                outside = kept - d * weight < floor
                base[i] = floor if outside else kept
                free[i] = 0.0 if outside else weight
        if under <= over:
            for i in range(n):
                kept, weight, ceiling = base[i], free[i], high[i]
                outside = kept - d * weight > ceiling
                base[i] = ceiling if outside else kept
                free[i] = 0.0 if outside else weight
    if spread == 0:
        for i in range(n):
            a[i] = base[i]
        return meeting(m, w, low, high, a)
    # The free coefficients' share may be a small difference of large areas: compensated summation.
    size, largest = abs(b), 0.0
    for i in range(n):
        weight = free[i]
        size += s[i] * abs(base[i])
        largest = weight if weight > largest else largest
    if n * EPS * size * largest > ROUNDING * spread:
        d = excess_of(s, base, b) / spread
    for i in range(n):
        x, floor, ceiling = base[i] - d * free[i], low[i], high[i]
        a[i] = floor if x < floor else (ceiling if x > ceiling else x)
    return d


@compiled(reorder=False, inner=True)
def meeting(m: Array, w: Array, low: Array, high: Array, a: Array) -> float:
    """Return D of the optimum at which all coefficients are at bounds; of several, the nearest to 0."""
    start, stop = -np.inf, np.inf
    for i in range(m.size):
        if w[i] > 0 and low[i] < high[i]:
            if a[i] == low[i]:
                start = max(start, (m[i] - low[i]) / w[i])
            else:
                stop = min(stop, (m[i] - high[i]) / w[i])
    d = start if abs(start) <= abs(stop) else stop
    return d if np.isfinite(d) else 0.0


@compiled(reorder=False)
def excess_of(s: Array, a: Array, b: float) -> float:
    """Return S'a - b with the accuracy of twice the precision (Dekker's product, Knuth's sum)."""
    total, lost = -b, 0.0
    for i in range(s.size):
        product = s[i] * a[i]
        cut = SPLIT * s[i]
        s_high = cut - (cut - s[i])
        cut = SPLIT * a[i]
        a_high = cut - (cut - a[i])
        s_low, a_low = s[i] - s_high, a[i] - a_high
        error = s_low * a_low - (((product - s_high * a_high) - s_low * a_high) - s_high * a_low)
        larger = total + product
        part = larger - total
        lost += ((total - (larger - part)) + (product - part)) + error
        total = larger
    return total + lost
