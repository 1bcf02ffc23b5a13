"""The loops over trials in NumPy, as in `rtcal.studies.trials_kernel`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support.types import Array


def outside(z: Array, low: Array, high: Array, indices: NDArray[np.intp]) -> int:
    """Write the flat indices of ``z`` below ``low`` or above ``high``; return their number."""
    found = np.flatnonzero((z < low[:, np.newaxis]) | (z > high[:, np.newaxis]))
    indices[: found.size] = found
    return found.size


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
    along = rows @ z
    delta = along[0]
    sums = np.zeros((3, 4))
    sums[0] = (along * delta).sum(-1)
    for k, direction in enumerate(q):
        out = np.flatnonzero((delta < least[k]) | (delta > most[k]))
        sums[2, k] = out.size
        d = np.interp(delta[out], table[k], multiplier[k])
        truth = mu[:, np.newaxis] + sigma[:, np.newaxis] * z[:, out]
        error = np.clip(mu[:, np.newaxis] - d * direction[:, np.newaxis], 0, 1) - truth
        free = mu[:, np.newaxis] - delta[out] / reach[k] * direction[:, np.newaxis] - truth
        sums[1, k] = np.sum(error**2) - np.sum(free**2)
    return float(np.einsum("it,it,i->", z, z, sigma**2)), sums
