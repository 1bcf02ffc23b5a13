"""The loop of scattering delay networks in NumPy."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators.shoebox import _NEIGHBOUR, _NODES, _PORTS
from rtcal.support.types import Array


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
    """Run the network in blocks of its smallest delay; return the response (n_bands, n).

    ``delays`` (6, 5), ``source_delays`` and ``tap_delays`` (6,) are in samples. ``lines`` (6, 5,
    n_bands), ``reflection``, ``injected`` and ``heard`` (6, n_bands) are gains.
    """
    block, longest = int(delays.min()), int(delays.max())
    # Incoming waves by port. A full buffer is shifted to its start.
    kept = longest + 64 * block
    incoming = np.zeros((_NODES, _PORTS, kept, lines.shape[-1]), reflection.dtype)
    out = np.zeros((n + int(tap_delays.max()) + block, lines.shape[-1]), reflection.dtype)
    base = 0
    for start in range(0, n, block):
        if start + block + longest - base > kept:
            left = kept - (start - base)
            incoming[:, :, :left] = incoming[:, :, start - base :].copy()
            incoming[:, :, left:] = 0
            base = start
        wave = incoming[:, :, start - base : start - base + block]
        pressure = 0.4 * wave.sum(axis=1)
        for k in np.flatnonzero(
            (source_delays >= start) & (source_delays < start + block)
        ).tolist():
            at = int(source_delays[k]) - start
            # A (p+ + p_S / 2) adds p_S / 2 at each port, and p_S to the node's pressure.
            pressure[k, at] += injected[k] / 2
            out[start + at + tap_delays[k]] += heard[k] * reflection[k] * injected[k] / 2
        outgoing = reflection[:, np.newaxis, np.newaxis] * (pressure[:, np.newaxis] - wave)
        for k in range(_NODES):
            tap = start + int(tap_delays[k])
            out[tap : tap + block] += heard[k] * reflection[k] * pressure[k]
            for j in range(_PORTS):
                to = _NEIGHBOUR[k, j]
                port = k - (k > to)
                at = start - base + int(delays[k, j])
                incoming[to, port, at : at + block] = lines[k, j] * outgoing[k, j]
    return out[:n].T
