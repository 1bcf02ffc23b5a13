"""Storage of traced paths, and the meaning of a scattering coefficient for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.directivity import Directivity
from rtcal.support.types import Array

ScatteringModel = Literal["random", "vector"]
"""How a wall with the scattering coefficient s reflects a path.

``"random"``: with probability s in a random direction after Lambert's law, else specularly (Heinz
1993; Vorlaender 2008, Sect. 11.3). ``"vector"``: along s·Lambert + (1 - s)·specular, both unit
vectors (Christensen & Rindel 2005, Forum Acusticum; also pyroomacoustics). The two models agree at
s = 0 and s = 1 only.
"""

LARGEST_CODE = int(np.iinfo(np.uint16).max)
"""Largest number of an event."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Paths from one source: wall hits and receptions in order.

    ``events[starts[i]:starts[i + 1]]`` belongs to path i. A wall hit is the number of the face, plus
    n_faces where the path was scattered under the model "random". A reception is 2 n_faces + receiver.
    ``lengths`` (m) and ``weights`` (1/m²) have one value per reception. All arrays are read-only.
    """

    events: NDArray[np.uint16]
    starts: NDArray[np.int64]
    lengths: NDArray[np.float32]
    weights: NDArray[np.float32]
    directions: Array  # (n_paths, 3), in which they left the source
    lost: int  # paths that left through a gap; they have no events
    free_paths: tuple[float, float, float]  # number, sum in m, sum of squares in m²

    def __post_init__(self) -> None:
        for values in (*self.arrays, self.directions):
            values.setflags(write=False)

    @cached_property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Events, starts, lengths and weights, as the kernels take them."""
        return self.events, self.starts, self.lengths, self.weights

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return sum(x.nbytes for x in self.arrays)


def aimed(batches: Sequence[Batch], lobe: Directivity, n_codes: int) -> tuple[Batch, ...]:
    """Return the paths of a source with this directivity, of one band.

    Events of ``n_codes`` and above are receptions.
    """
    gains = lobe.gain(np.concatenate([batch.directions for batch in batches]))[:, 0]
    ends = np.cumsum([len(batch.directions) for batch in batches])[:-1]
    out = []
    for batch, gain in zip(batches, np.split(gains, ends), strict=True):
        path = np.repeat(np.arange(len(gain)), np.diff(batch.starts))[batch.events >= n_codes]
        out.append(replace(batch, weights=batch.weights * gain[path].astype(np.float32)))
    return tuple(out)


def joined(
    batches: Sequence[Batch],
) -> tuple[NDArray[np.uint16], NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Return the arrays of several batches as those of one."""
    before = np.cumsum([0, *(len(batch.events) for batch in batches)])
    starts = [batch.starts[:-1] + begin for batch, begin in zip(batches, before, strict=False)]
    return (
        np.concatenate([batch.events for batch in batches]),
        np.concatenate([*starts, before[-1:]]),
        np.concatenate([batch.lengths for batch in batches]),
        np.concatenate([batch.weights for batch in batches]),
    )
