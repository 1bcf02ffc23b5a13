"""The compiled loops over the trials of a study."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support.speed import compiled
from rtcal.support.types import Array

STRIP = 256  # trials per step: their sums stay in the innermost cache


@compiled(reorder=True)
def outside(z: Array, low: Array, high: Array, indices: NDArray[np.intp]) -> int:
    """Write the flat indices of ``z`` below ``low`` or above ``high``; return their number."""
    n, trials = z.shape
    count = 0
    for i in range(n):
        below, above = low[i], high[i]
        for start in range(0, trials, STRIP):
            x = z[i, start : start + STRIP]
            n_outside = 0
            for t in range(x.size):
                n_outside += (x[t] < below) | (x[t] > above)
            if n_outside > 0:
                for t in range(x.size):
                    if x[t] < below or x[t] > above:
                        indices[count] = i * trials + start + t
                        count += 1
    return count


@compiled(reorder=True)
def score(
    z: Array,
    rows: Array,
    mu: Array,
    sigma: Array,
    q: Array,
    reach: Array,
    table: Array,
    multiplier: Array,
    least: Array,
    most: Array,
) -> tuple[float, Array]:
    """Return e'e and, as rows: delta e'[S, q]; bounded minus unbounded e'e; trials that differ."""
    n, trials = z.shape
    sums = np.zeros((3, 4))
    s0, s1, s2, s3 = np.empty(STRIP), np.empty(STRIP), np.empty(STRIP), np.empty(STRIP)
    squares = 0.0
    for start in range(0, trials, STRIP):
        count = min(STRIP, trials - start)
        s0[:] = 0.0
        s1[:] = 0.0
        s2[:] = 0.0
        s3[:] = 0.0
        for i in range(n):
            x = z[i, start : start + count]
            square = 0.0  # a separate loop, since the order of a sum beside stores is not fixed
            for t in range(count):
                square += x[t] * x[t]
            squares += sigma[i] * sigma[i] * square
            add(s0, rows[0, i], x)
            add(s1, rows[1, i], x)
            add(s2, rows[2, i], x)
            add(s3, rows[3, i], x)
        sums[0, 0] += dot(s0, s0, count)
        sums[0, 1] += dot(s0, s1, count)
        sums[0, 2] += dot(s0, s2, count)
        sums[0, 3] += dot(s0, s3, count)
        for k in range(3):
            out = 0
            for t in range(count):
                out += (s0[t] < least[k]) | (s0[t] > most[k])
            if out == 0:
                continue
            sums[2, k] += out
            for t in range(count):
                delta = s0[t]
                if delta >= least[k] and delta <= most[k]:
                    continue
                first, last = 0, table.shape[1] - 1  # table[first] <= delta < table[last]
                while last - first > 1:
                    middle = (first + last) // 2
                    if table[k, middle] <= delta:
                        first = middle
                    else:
                        last = middle
                width = table[k, last] - table[k, first]
                share = (delta - table[k, first]) / width if width > 0 else 1.0
                bounded = (1 - share) * multiplier[k, first] + share * multiplier[k, last]
                free = delta / reach[k]
                change = 0.0
                for i in range(n):
                    truth = mu[i] + sigma[i] * z[i, start + t]
                    at = mu[i] - bounded * q[k, i]
                    at = 0.0 if at < 0.0 else (1.0 if at > 1.0 else at)
                    change += (at - truth) ** 2 - (mu[i] - free * q[k, i] - truth) ** 2
                sums[1, k] += change
    return squares, sums


@compiled(reorder=True, inner=True)
def add(total: Array, factor: float, x: Array) -> None:
    """Add ``factor`` times ``x`` to the first values of ``total``."""
    for t in range(x.size):
        total[t] += factor * x[t]


@compiled(reorder=True, inner=True)
def dot(x: Array, y: Array, count: int) -> float:
    """Return the product of the first ``count`` values."""
    total = 0.0
    for t in range(count):
        total += x[t] * y[t]
    return total
