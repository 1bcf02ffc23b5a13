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
    out = np.zeros(n_bins)
    for run in range(len(rows)):
        begin, end = starts[run], starts[run + 1]
        left = x[rows[run, 0]] * y[rows[run, 1]]
        last = z[rows[run, 2] : rows[run, 2] + end - begin]
        when, weight = bins[begin:end], weights[begin:end]
        for i in range(len(last)):
            out[when[i]] += left * last[i] * weight[i]
    return out
