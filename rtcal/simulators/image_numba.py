"""Weighing of image sources, compiled; `rtcal.simulators.image_source` does the same in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support.jit import compiled
from rtcal.support.types import Array


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
    """Return the energy of each bin, (n_bands, n_bins); arguments as in the NumPy function."""
    # Unsigned indices need no check for negative values, which would take half of the time.
    unsigned = np.uint64
    return _weigh(x, y, z, rows.view(unsigned), starts.view(unsigned), bins, weights, n_bins)


@compiled(reorder=True)
def _weigh(
    x: Array,
    y: Array,
    z: Array,
    rows: NDArray[np.uint64],
    starts: NDArray[np.uint64],
    bins: NDArray[np.uint32],
    weights: Array,
    n_bins: int,
) -> Array:
    out = np.zeros((len(x), n_bins))
    for run in range(len(rows)):
        begin, first = starts[run], rows[run, 2]
        for band in range(len(x)):  # the inner loops stay within the run: its images are cached
            reflected = x[band, rows[run, 0]] * y[band, rows[run, 1]]
            for i in range(starts[run + 1] - begin):
                out[band, bins[begin + i]] += reflected * z[band, first + i] * weights[begin + i]
    return out
