"""Weighing image sources, compiled; twin of the NumPy lines in `rtcal.simulators.image_source`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.jit import compiled
from rtcal.types import Array


@compiled(reorder=True)
def weigh(
    x: Array,
    y: Array,
    z: Array,
    rows: NDArray[np.int64],
    starts: NDArray[np.int64],
    bins: NDArray[np.uint32],
    weights: Array,
    n_bins: int,
) -> Array:
    """Return the energy of each bin, (n_bins,); arguments as in the NumPy twin."""
    # Neighbours on the last axis mostly fall into one bin: two sums, so that none waits for the other.
    even, odd = np.zeros(n_bins), np.zeros(n_bins)
    for run in range(len(rows)):
        begin, end = starts[run], starts[run + 1]
        left = x[rows[run, 0]] * y[rows[run, 1]]
        last = z[rows[run, 2] : rows[run, 2] + end - begin]
        when, weight = bins[begin:end], weights[begin:end]
        pairs = len(last) // 2 * 2
        for i in range(0, pairs, 2):
            even[when[i]] += left * last[i] * weight[i]
            odd[when[i + 1]] += left * last[i + 1] * weight[i + 1]
        if pairs < len(last):
            even[when[pairs]] += left * last[pairs] * weight[pairs]
    return even + odd
