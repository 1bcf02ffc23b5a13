"""Compiled loops of the shoebox simulators, which have the same in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.support.speed import compiled
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


@compiled(reorder=True)
def blocks(
    delays: NDArray[np.int64],
    source_delays: NDArray[np.int64],
    tap_delays: NDArray[np.int64],
    lines: Array,
    reflection: NDArray[Any],
    injected: Array,
    heard: Array,
    n: int,
) -> NDArray[Any]:
    """Return the response (n_bands, n); arguments as in the NumPy function."""
    n_bands = lines.shape[2]
    block, longest = delays.min(), delays.max()
    # Incoming waves by port. The buffer fits the processor's cache. It is shifted to its start when
    # full, so that no block wraps around and the loops over samples vectorise.
    kept = 2 * longest + block
    incoming = np.empty((6, 5, kept), reflection.dtype)
    pressure = np.empty(block, reflection.dtype)
    out = np.zeros((n_bands, n + tap_delays.max() + block), reflection.dtype)
    for b in range(n_bands):
        incoming[:] = 0.0
        base = 0
        for start in range(0, n, block):
            if start + block + longest - base > kept:
                left = kept - (start - base)
                for k in range(6):
                    for j in range(5):
                        for i in range(left):
                            incoming[k, j, i] = incoming[k, j, i + start - base]
                        for i in range(left, kept):
                            incoming[k, j, i] = 0.0
                base = start
            offset = start - base
            for k in range(6):
                waves = incoming[k, :, offset : offset + block]
                for i in range(block):
                    pressure[i] = 0.4 * (
                        waves[0, i] + waves[1, i] + waves[2, i] + waves[3, i] + waves[4, i]
                    )
                beta = reflection[k, b]
                tapped = out[b, start + tap_delays[k] : start + tap_delays[k] + block]
                gain = heard[k, b] * beta
                if start <= source_delays[k] < start + block:
                    # A (p+ + p_S / 2) adds p_S / 2 at each port, and p_S to the node's pressure.
                    pressure[source_delays[k] - start] += injected[k, b] / 2
                    tapped[source_delays[k] - start] += gain * injected[k, b] / 2
                for i in range(block):
                    tapped[i] += gain * pressure[i]
                for j in range(5):
                    to = j + 1 if j >= k else j
                    port = k - 1 if k > to else k
                    arrival = offset + delays[k, j]
                    leaving = incoming[to, port, arrival : arrival + block]
                    loss = beta * lines[k, j, b]
                    for i in range(block):
                        leaving[i] = loss * (pressure[i] - waves[j, i])
    return out[:, :n]
