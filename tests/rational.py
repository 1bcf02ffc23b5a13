"""The QP of one band solved in exact rational arithmetic: the truth that solvers are held against.

minimise sum ((a - mu) / sigma)², S'a = b, lower <= a <= upper. At the optimum
a(D) = clip(mu - D S sigma², lower, upper) with one D, and S'a(D) falls in D piece by piece, so the
piece that holds b is found by bisection over its breakpoints and solved exactly.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Literal


def solve(
    mu: Sequence[float],
    sigma: Sequence[float],
    areas: Sequence[float],
    target: float,
    lower: Sequence[float] | float = 0.0,
    upper: Sequence[float] | float = 1.0,
) -> list[Fraction] | Literal["below", "above"]:
    """Return the exact coefficients, or whether the target lies below or above all that is reachable.

    Coefficients with sigma = 0 stay at mu.
    """
    n = len(mu)
    low, high = (
        [Fraction(v) for v in (bound if isinstance(bound, Sequence) else [bound] * n)]
        for bound in (lower, upper)
    )
    mean, area, b = [Fraction(v) for v in mu], [Fraction(v) for v in areas], Fraction(target)
    weight = [s * Fraction(v) ** 2 for s, v in zip(area, sigma, strict=True)]
    low = [m if w == 0 else v for v, m, w in zip(low, mean, weight, strict=True)]
    high = [m if w == 0 else v for v, m, w in zip(high, mean, weight, strict=True)]

    def at(d: Fraction) -> list[Fraction]:
        return [
            min(max(m - d * w, lo), hi)
            for m, w, lo, hi in zip(mean, weight, low, high, strict=True)
        ]

    def reached(alpha: list[Fraction]) -> Fraction:
        return sum((s * a for s, a in zip(area, alpha, strict=True)), Fraction(0))

    if b < reached(low):
        return "below"
    if b > reached(high):
        return "above"
    breaks = sorted(
        {
            (m - v) / w
            for m, w, lo, hi in zip(mean, weight, low, high, strict=True)
            if w
            for v in (lo, hi)
        }
    )
    if not breaks:
        return mean
    first, last = 0, len(breaks) - 1  # S'a(breaks[first]) >= b >= S'a(breaks[last])
    while last - first > 1:
        middle = (first + last) // 2
        if reached(at(breaks[middle])) >= b:
            first = middle
        else:
            last = middle
    start, end = at(breaks[first]), at(breaks[last])
    span = reached(start) - reached(end)
    share = (reached(start) - b) / span if span else Fraction(0)
    return [x + share * (y - x) for x, y in zip(start, end, strict=True)]
