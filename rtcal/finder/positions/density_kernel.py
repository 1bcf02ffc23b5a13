"""The compiled loop of `rtcal.finder.positions.problem`: errors that a hypothesis has of its own.

Woodbury's identity (`rtcal.finder.evidence.with_columns`) takes a Cholesky factor of some 50 rows for
every one of thousands of hypotheses. One after the other, most of the time goes to calls and memory;
here `LANES` of them are eliminated side by side, by vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from rtcal.support.speed import compiled
from rtcal.support.types import Array

LANES = 32
"""Hypotheses that are eliminated together. With 16 and with 64 it takes up to a fifth longer."""


def of_own_errors(
    factor: Array, side: Array, change: Array, products: Array, across: Array
) -> tuple[Array, Array]:
    """Return x' M⁻¹ x and ln sqrt|M| of M = I + U' K⁻¹ U and x = U' K⁻¹ r, by hypothesis.

    U has two parts: columns of the change in each band, and columns W in each band by its change.
    ``factor`` (n, n_bands, n_bands) is U' K⁻¹ U of the first part, ``side`` (n, n_columns, n_bands)
    that of the second with the first, and ``products`` (n_columns, n_pairs, n_columns) that of the
    second per ``change`` (n, n_bands): W' K⁻¹ W of pairs of bands, in the order of `np.tril_indices`,
    the sum of both for two bands. ``across`` (n, n_bands + n_columns, m) is U' K⁻¹ r. The results are
    (n, m) and (n,).
    """
    n, size, m = across.shape
    explained, half = np.empty((n, m)), np.empty(n)
    # A constant number of lanes would be unrolled, and then not vectorised.
    rows, both = np.empty((size, size + m, LANES)), np.empty((products.shape[1] + 1, LANES))
    eliminate(factor, side, change, products, across, rows, both, explained, half)
    return explained, half


@compiled(reorder=True)
def eliminate(
    factor: Array,
    side: Array,
    change: Array,
    products: Array,
    across: Array,
    rows: Array,
    both: Array,
    explained: Array,
    half: Array,
) -> None:
    """Write what `of_own_errors` returns; the rows of M become those of the upper factor."""
    n, n_bands = change.shape
    n_columns, n_pairs, _ = products.shape
    size, m, lanes = n_bands + n_columns, across.shape[2], rows.shape[2]
    for begin in range(0, n, lanes):
        for lane in range(lanes):
            h = min(begin + lane, n - 1)  # the last one fills the lanes
            pair = 0
            for k in range(n_bands):
                for other in range(k + 1):
                    rows[other, k, lane] = factor[h, k, other]
                    both[pair, lane] = change[h, k] * change[h, other]
                    pair += 1
                for j in range(n_columns):
                    rows[k, n_bands + j, lane] = side[h, j, k]
            for i in range(size):
                for j in range(m):
                    rows[i, size + j, lane] = across[h, i, j]
            half[h] = 0.0
            for j in range(m):
                explained[h, j] = 0.0
        for i in range(n_columns):
            for j in range(i, n_columns):
                for lane in range(lanes):
                    rows[n_bands + i, n_bands + j, lane] = 0.0
            for pair in range(n_pairs):
                for j in range(i, n_columns):
                    product = products[i, pair, j]
                    for lane in range(lanes):
                        rows[n_bands + i, n_bands + j, lane] += product * both[pair, lane]
        for i in range(size):
            for above in range(i):
                for j in range(i, size + m):
                    for lane in range(lanes):
                        rows[i, j, lane] -= rows[above, i, lane] * rows[above, j, lane]
            for lane in range(lanes):
                both[n_pairs, lane] = 1.0 / math.sqrt(1.0 + rows[i, i, lane])
            for j in range(i + 1, size + m):
                for lane in range(lanes):
                    rows[i, j, lane] *= both[n_pairs, lane]
            for lane in range(min(lanes, n - begin)):
                half[begin + lane] -= math.log(both[n_pairs, lane])
                for j in range(m):
                    explained[begin + lane, j] += rows[i, size + j, lane] ** 2
