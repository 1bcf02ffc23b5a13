"""Whether sources of which nothing is stated are omnidirectional, or loudspeakers that are aimed.

A lobe moves the level and the early parameters, and T hardly at all. So does much that a room may lack:
taken as omnidirectional, twelve aimed loudspeakers in a laboratory with nothing hidden passed for a
second room (docs/where_study.md). So what is detected with omnidirectional sources is compared with the
same where the sources have some lobe. It is an error of what is heard: its index is of the order of
`INDEX` and varies from band to band, its aim is any, and all sources may aim at the receivers together.
Where the lobes are likelier, the directivities are taken as unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.directivity import Directivity
from rtcal.acoustics.scene import UNKNOWN
from rtcal.finder.positions.case import Case
from rtcal.loop.measured_pairs import Pair
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.types import Array

INDEX = 6.0
"""Directivity index in dB of the lobes that are weighed. A measured two-way loudspeaker has 0.5 to 8 dB
from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0)."""
LIKELY = 2.5
"""Evidence in nats from which the sources are taken as loudspeakers."""
AIMS = (None, *(tuple(sign * axis) for axis in np.eye(3) for sign in (-1.0, 1.0)))
"""Where the lobes aim: all at the middle of the receivers, or along an axis."""


def lobes(tracer: PathTracing) -> list[dict[int, Directivity]]:
    """Return the lobes of the sources of which nothing is stated, for each of `AIMS`."""
    unstated = [s for s, name in enumerate(tracer.sources) if name not in tracer.directivity]
    middle = tracer.to_receivers.mean(axis=1)
    # A source in the middle of its receivers aims at none of them.
    middle[~middle.any(axis=1)] = np.eye(3)[0]
    return [
        {
            s: Directivity(index=INDEX, aim=tuple(middle[s]) if aim is None else aim)
            for s in unstated
        }
        for aim in AIMS
    ]


def covariance(nodes: Array, pairs: Sequence[Pair], frequencies: Array) -> Array:
    """Return the covariance of what lobes change, (n, n), in the order (band, parameter, pair).

    Parameters
    ----------
    nodes : array (n_bands, n_values, n_aims)
        Shifts by the lobes of `lobes`, in the order (parameter, pair).
    pairs : sequence of (source, receiver)
    frequencies : array (n_bands,)
    """
    n_bands, n_values, _ = nodes.shape
    of_source = np.array([source for source, _ in pairs] * (n_values // len(pairs)))
    same = of_source[:, np.newaxis] == of_source
    octaves = np.abs(np.subtract.outer(*(2 * [np.log2(frequencies)])))
    together, own = nodes[..., 0], nodes[..., 1:]
    every = np.einsum("kv,lw->kvlw", together, together)
    every += np.einsum("kva,lwa->kvlw", own, own) / own.shape[-1] * same[:, np.newaxis]
    every *= (0.7**octaves)[:, np.newaxis, :, np.newaxis]
    return np.asarray(every.reshape(n_bands * n_values, -1))


def as_unknown(case: Case) -> Case:
    """Return the case where the directivities of which nothing is stated are unknown."""
    stated = {
        name: case.simulator.directivity.get(name, UNKNOWN) for name in case.simulator.sources
    }
    return replace(case, simulator=replace(case.simulator, directivity=stated))


def in_words(nats: float) -> str:
    """Return a note that the sources are taken as loudspeakers; "" where they are not."""
    if nats <= LIKELY:
        return ""
    return (
        "Sources that are not omnidirectional explain what was measured better than what the room may "
        f"lack: {nats:+.1f} nats. So they are not taken as omnidirectional. State them with "
        "[directivity]; an omnidirectional source has the index 0."
    )
