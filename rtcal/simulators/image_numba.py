"""Weighing image sources, compiled; twin of the NumPy lines in `rtcal.simulators.image_source`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.jit import compiled
from rtcal.types import Array


@compiled(reorder=True)
def weigh(
    x: Array,
    yz: Array,
    along: NDArray[np.int64],
    across: NDArray[np.int64],
    weights: Array,
    starts: NDArray[np.int64],
) -> Array:
    """Return the energy of each bin, (n_bins,); arguments as in the NumPy twin."""
    out = np.zeros(len(starts))
    for b in range(len(starts)):
        end = starts[b + 1] if b + 1 < len(starts) else len(along)
        total = 0.0
        for i in range(starts[b], end):
            total += x[along[i]] * yz[across[i]] * weights[i]
        out[b] = total
    return out
