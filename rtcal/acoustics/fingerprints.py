"""The names of measured data, by which no room is calibrated twice on the same."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rtcal.acoustics.materials import ARCHIVE
from rtcal.acoustics.room import Room
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_SAME = 1e-4
"""Largest difference of the same data, relative above 1."""


def fingerprint(kind: str, values: Mapping[str, float]) -> str:
    """Return the name of data as a room's record keeps it: the values themselves, NaN left out.

    Examples
    --------
    >>> fingerprint("T", {"500": 1.92, "1000": 1.8801})
    'T:500=1.92000,1000=1.88010'
    """
    return f"{kind}:" + ",".join(f"{k}={v:.5f}" for k, v in values.items() if math.isfinite(v))


def of_times(room: Room, times: Array) -> str:
    """Return the name of T in s, (n_bands,), in the room's bands."""
    labels = (f"{f:g}" for f in room.centre_frequencies.tolist())
    return fingerprint("T", dict(zip(labels, times.tolist(), strict=True)))


def same_data(one: str, other: str) -> bool:
    """Whether two names are of the same data, to within a ten-thousandth in every value.

    No measurement is repeated so exactly; a program that rounds or converts changes less.

    Examples
    --------
    >>> same_data("T:500=1.92000", "T:500=1.92001"), same_data("T:500=1.92000", "T:500=1.93000")
    (True, False)
    """
    kinds, cells = zip(*(name.partition(":")[::2] for name in (one, other)), strict=True)
    if one == other or kinds[0] != kinds[1]:
        return one == other
    of_one, of_other = (
        dict(cell.split("=") for cell in cell_list.split(",") if "=" in cell) for cell_list in cells
    )
    return of_one.keys() == of_other.keys() and all(
        abs(float(v) - float(of_other[f])) <= _SAME * max(1.0, abs(float(v)))
        for f, v in of_one.items()
    )


def refuse_repeated_data(room: Room, *names: str) -> None:
    """Raise DataError if the room was calibrated already on the data of one of these names."""
    before = [] if room.calibration is None else room.calibration.measured.split()
    if any(same_data(old, new) for old in before for new in names):
        if room.calibration is not None and room.calibration.method == ARCHIVE:
            raise DataError(
                f'room "{room.name}" has the coefficients of an archive that has learned from these '
                "data; calibrating to them would count them twice. Leave their room out of the archive"
            )
        raise DataError(
            f'room "{room.name}" was already calibrated on these data; doing so again would '
            "count them twice. Take the room as it was before, or other data"
        )


def of_room(room: Room) -> list[bytes]:
    """Return a room's materials, areas, bands, air and prior as one comparable value."""
    numbers = (
        [room.volume, room.speed_of_sound],
        room.areas,
        room.centre_frequencies,
        room.air_attenuation,
        room.alpha,
        room.sigma,
    )
    return [*(m.encode() for m in room.materials), *(np.asarray(n).tobytes() for n in numbers)]
