"""Directivity: the energy that a sound source radiates in each direction, band by band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries
from rtcal.support.types import Array, read_only

LARGEST_INDEX = 25.0
"""Largest directivity index in dB. Horns for long throws have some 20 dB at 8 kHz."""
_KEYS = ("index", "aim")


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Directivity:
    """A loudspeaker that radiates a lobe, with more energy along its axis than on average.

    Its energy at the angle theta from the axis, over that of an omnidirectional source of the same
    power, is (n + 1) ((1 + cos theta) / 2)^n with n = 10^(index / 10) - 1 (docs/path_tracing.md).

    Parameters
    ----------
    index : float or array (n_bands,)
        Directivity index in dB per octave band, 0 (omnidirectional) to 25: the level on the axis less
        that of an omnidirectional source of the same power.
    aim : (x, y, z)
        Direction of the axis in the room's coordinates, of any length.

    Raises
    ------
    DataError
        For an index outside its range, or an aim of length 0.

    Notes
    -----
    The lobe is that of a first-order source (cardioid) for an index of 3 dB. It has no side lobes. A
    measured loudspeaker had 1.2, 0.5, 3, 7 and 7.7 dB from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0).

    Examples
    --------
    >>> speaker = Directivity(index=[0, 6], aim=(1, 0, 0))
    >>> print(speaker.gain([[1, 0, 0], [-1, 0, 0]]).round(2))
    [[1.   3.98]
     [1.   0.  ]]
    """

    index: Any
    aim: Sequence[float]

    def __post_init__(self) -> None:
        index = np.atleast_1d(checks.array("index", self.index))
        if index.ndim != 1 or not index.size:
            raise DataError(f"index has shape {index.shape}; it is one value, or one per band")
        wrong = np.flatnonzero(~((index >= 0) & (index <= LARGEST_INDEX)))
        if wrong.size:
            raise DataError(
                f"index[{wrong[0]}] = {index[wrong[0]]:g} dB is not from 0 to {LARGEST_INDEX:g} dB"
            )
        aim = checks.array("aim", self.aim)
        if aim.shape != (3,) or not np.isfinite(aim).all() or not np.linalg.norm(aim) > 0:
            raise DataError(f"aim = {checks.shown(self.aim)} is not a direction (x, y, z)")
        object.__setattr__(self, "index", read_only(index))
        object.__setattr__(self, "aim", tuple(aim.tolist()))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Directivity):
            return NotImplemented
        return self.aim == other.aim and np.array_equal(self.index, other.index)

    def gain(self, directions: ArrayLike) -> Array:
        """Return the energy in each direction over an omnidirectional source's, (n, n_bands).

        ``directions`` (n, 3) have any length; n_bands is 1 for an index that is one value.
        """
        vectors = np.asarray(directions, dtype=float)
        cosine = vectors @ self.aim / np.linalg.norm(vectors, axis=-1) / np.linalg.norm(self.aim)
        power = 10 ** (self.index / 10)
        half = np.clip((1 + cosine) / 2, 0, 1)[..., np.newaxis]
        return np.asarray(power * half ** (power - 1))

    def for_bands(self, n_bands: int, place: str) -> Directivity:
        """Return it with an index for each of ``n_bands``; DataError if it has another number."""
        if len(self.index) not in (1, n_bands):
            raise DataError(
                f"{place}.index has {len(self.index)} values; the room has {n_bands} bands"
            )
        return Directivity(index=np.broadcast_to(self.index, n_bands), aim=self.aim)

    def in_band(self, band: int) -> Directivity:
        """Return the lobe of one band by its number."""
        return Directivity(index=self.index[band], aim=self.aim)

    def to_dict(self) -> dict[str, Any]:
        """Return index and aim as plain values."""
        return {"index": self.index.tolist(), "aim": list(self.aim)}

    @classmethod
    def from_dict(cls, data: Any, place: str = "directivity") -> Directivity:
        """Return the directivity of a table as `to_dict` gives it; DataError begins with ``place``."""
        entries = Entries(f"{place}.", data, _KEYS, ())
        per_band = isinstance(entries.values["index"], list | tuple)
        index = entries.array("index", (None,)) if per_band else entries.number("index")
        aim = entries.array("aim", (3,)).tolist()
        try:
            return cls(index=index, aim=aim)
        except DataError as error:
            raise DataError(f"{place}.{error}") from None
