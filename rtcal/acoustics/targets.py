"""Ranges of T that a room is to meet: stated, or of a standard.

The standards were not at hand: their numbers are as secondary sources give them. Those of DIN 18041
were compared with two public ones. T of A1 to A3 stands on a manufacturer's page (setaplast.de, of the
edition of 2004), all volumes and the range by band in a program for its limits (Raumakustik-CAD by
redbluee). That program's constants of A2 to A5 have the other sign, with which T of speech would be
longer than on that page. Those of ANSI/ASA S12.60 are alike on pages of three firms (larsondavis.com,
armstrongceilings.com, robertandersongroup.com). ISO and ISO/TR have no numbers here: no public source
was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.files.disk import json_numbers
from rtcal.files.schema import FileTable, Number
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

DIN_18041 = {
    "A1": ("music", 0.45, 0.07, 30, 1000),
    "A2": ("speech and lectures", 0.37, -0.14, 50, 5000),
    "A3": ("teaching and communication", 0.32, -0.17, 30, 5000),
    "A4": ("teaching and communication, inclusive", 0.26, -0.14, 30, 500),
    "A5": ("sports", 0.75, -1.00, 200, 10_000),
}
"""Uses of group A of DIN 18041:2016-03, occupied rooms (A5: unoccupied): a and b of T = a lg V + b in
s, least and largest volume in m³."""
DIN_18041_TOLERANCE = {
    125.0: (0.65, 1.45),
    **dict.fromkeys((250.0, 500.0, 1000.0, 2000.0), (0.8, 1.2)),
    4000.0: (0.65, 1.2),
}
"""Range of T over the value at middle frequencies; A5 states only 250 to 2000 Hz."""
_DIN_SOURCE = (
    "DIN 18041:2016-03, group {}, {}: T = {:.2f} s at middle frequencies (after secondary sources)"
)
LONGEST = 100.0
"""Largest T of a target in s: more is no T of a room, but one in ms or in another unit."""
ANSI_S12_60 = ((283.0, 0.6), (566.0, 0.7))
"""Largest volume in m³ (10,000 and 20,000 ft³) and largest T in s, furnished and unoccupied."""
_ANSI_BANDS = (500.0, 1000.0, 2000.0)
_ANSI_SOURCE = "ANSI/ASA S12.60: at most {:g} s at 500, 1000 and 2000 Hz (after secondary sources)"


@dataclass(frozen=True, eq=False)
class Target:
    """A range of T per band.

    Parameters
    ----------
    low, high : array (n_bands,)
        In s; NaN where an end is open.
    source : str
        Where the range comes from.

    Raises
    ------
    DataError
        If an end is not above 0 or above 100 s, ``low`` is not below ``high``, or no band has a range.

    Examples
    --------
    >>> Target([0.5, 0.5], [0.8, float("nan")]).high
    array([0.8, nan])
    """

    low: Array
    high: Array
    source: str = "stated"

    def __post_init__(self) -> None:
        low, high = checks.array("low", self.low), checks.array("high", self.high)
        if low.shape != high.shape or low.ndim != 1:
            raise DataError(f"low has shape {low.shape} and high {high.shape}; both are (n_bands,)")
        for name, ends in (("low", low), ("high", high)):
            if (bad := (ends <= 0) | (ends > LONGEST)).any():
                raise DataError(
                    f"{name} = {ends[np.argmax(bad)]:g} s is not above 0 and at most {LONGEST:g} s, as "
                    "the T of a room is"
                )
        if (bad := low >= high).any():
            k = int(np.argmax(bad))
            raise DataError(f"low = {low[k]:g} s is not below high = {high[k]:g} s")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        if not self.bounded.any():
            raise DataError("no band has a range: every low and high is missing")

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Which bands have a range, (n_bands,) of bool."""
        return np.asarray(np.isfinite(self.low) | np.isfinite(self.high))

    def to_dict(self) -> dict[str, Any]:
        """Return the ends in s and their source as plain numbers and text."""
        ends = {"low": json_numbers(self.low), "high": json_numbers(self.high)}
        return {**ends, "source": self.source}

    def widened(self, factor: float) -> Target:
        """Return the range with both ends moved outwards by a factor of T, to 100 s at most."""
        return Target(self.low / factor, np.minimum(self.high * factor, LONGEST), self.source)


def din_18041(group: str, volume: float, centre_frequencies: Sequence[float] | Array) -> Target:
    """Return the range of T of DIN 18041:2016, group A, for octaves from 125 to 4000 Hz.

    T at middle frequencies is a lg V + b; the range is 0.8 to 1.2 of it from 250 to 2000 Hz, and wider
    at 125 and 4000 Hz. Other bands have no range.

    Parameters
    ----------
    group : {"A1", "A2", "A3", "A4", "A5"}
        Music, lectures, teaching, inclusive teaching, sports.
    volume : float
        m³
    centre_frequencies : sequence (n_bands,)
        Hz

    Raises
    ------
    DataError
        For another group, or a volume for which the standard states nothing.

    Examples
    --------
    >>> target = din_18041("A3", 180, [125, 500, 4000])
    >>> print(target.low.round(2), target.high.round(2))
    [0.36 0.44 0.36] [0.8  0.66 0.66]
    """
    if group not in DIN_18041:
        raise DataError(f'group = "{group}" is not one of {", ".join(DIN_18041)}')
    use, slope, offset, least, most = DIN_18041[group]
    checks.between("volume", volume, least, most, "m³", f", for which DIN 18041 states {group}")
    t = slope * np.log10(volume) + offset
    low, high = np.array(
        [
            DIN_18041_TOLERANCE.get(f if group != "A5" or 250 <= f <= 2000 else 0, [np.nan] * 2)
            for f in bands.as_bands(centre_frequencies).tolist()
        ]
    ).T
    return Target(t * low, t * high, _DIN_SOURCE.format(group, use, t))


def ansi_s12_60(volume: float, centre_frequencies: Sequence[float] | Array) -> Target:
    """Return the largest T of a classroom after ANSI/ASA S12.60: 0.6 s, above 283 m³ 0.7 s.

    Raises DataError above 566 m³, for which it states no T.

    Examples
    --------
    >>> ansi_s12_60(300, [250, 500]).high
    array([nan, 0.7])
    """
    for largest, t in ANSI_S12_60:
        if checks.positive("volume", volume, " m³") <= largest:
            f = bands.as_bands(centre_frequencies)
            high = np.where(np.isin(f, _ANSI_BANDS), t, np.nan)
            return Target(np.full(len(f), np.nan), high, _ANSI_SOURCE.format(t))
    raise DataError(f"volume = {volume:g} m³ is above 566 m³, up to which ANSI S12.60 states T")


class TargetTable(FileTable):
    """The target of a file: a standard, or the ends of the range in s."""

    standard: Literal["DIN 18041", "ANSI S12.60"] | None = None
    group: str | None = None
    low: Number | list[Number] | None = None
    high: Number | list[Number] | None = None


def target_of(table: TargetTable, volume: float, frequencies: Array) -> Target:
    """Return the target that a file states, in these bands in Hz.

    Raises DataError if it states both a standard and an end, a ``group`` that no stated standard has,
    and ends for another number of bands.
    """
    ends = {"low": table.low, "high": table.high}
    stated = [key for key, end in ends.items() if end is not None]
    if table.standard is not None and stated:
        raise DataError(
            f'target: standard = "{table.standard}" and {stated[0]} are both stated; a target has one'
        )
    if table.standard == "DIN 18041":
        return din_18041(table.group or "", volume, frequencies)
    if table.group is not None:
        raise DataError(f'target: group = "{table.group}" is of DIN 18041, which it does not state')
    if table.standard is not None:
        return ansi_s12_60(volume, frequencies)
    n = len(frequencies)
    for key, end in ends.items():
        if isinstance(end, list) and len(end) != n:
            raise DataError(f"target.{key} has {len(end)} values; the room has {n} bands")
    low, high = (np.full(n, np.nan if end is None else end) for end in ends.values())
    return Target(low, high)
