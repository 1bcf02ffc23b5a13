"""The measured T as a calibration sees it: in the room's bands, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import SUMMARY, Measurement, fingerprint
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.types import Array


@dataclass(frozen=True)
class Measured:
    """Measured T in the room's bands.

    ``reverberation_time`` and ``uncertainty`` in s, (n_bands,), NaN where missing or unknown;
    ``parameter`` per band ``"t20"``, ``"t30"`` or ``""``; ``ignored`` the measured bands in Hz that
    the room lacks; ``fingerprint`` names the data.
    """

    reverberation_time: Array
    uncertainty: Array
    parameter: tuple[str, ...]
    ignored: tuple[float, ...]
    fingerprint: str


def times_in_room(room: Room, measured: Measurement | Sequence[float] | Array) -> Measured:
    """Return the measured T in the room's bands; NaN where a band has none.

    Raises
    ------
    DataError
        For a wrong shape, a T that is not above 0, or no band in common.
    """
    if isinstance(measured, Measurement):
        decay = measured.decay_time()
        places = [bands.index(measured.centre_frequencies, f) for f in room.centre_frequencies]
        mean = np.array([np.nan if p is None else decay.mean[p] for p in places])
        spread = np.array([np.nan if p is None else decay.uncertainty[p] for p in places])
        used = tuple("" if p is None else decay.parameter[p] for p in places)
        ignored = tuple(
            float(f)
            for f in measured.centre_frequencies
            if bands.index(room.centre_frequencies, f) is None
        )
        if not np.isfinite(mean).any():
            have = ", ".join(bands.label(f) for f in measured.centre_frequencies)
            raise DataError(
                f"the measurement (T20 or T30 at {have}) and the room have no band in common"
            )
        return Measured(mean, spread, used, ignored, measured.fingerprint)
    try:
        times = np.array(measured, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"measured is not a list of T in s: {error}") from error
    if times.shape != (room.n_bands,):
        raise DataError(f"measured T has shape {times.shape}; the room asks for ({room.n_bands},)")
    if (bad := np.isinf(times) | (times <= 0)).any():
        k = int(np.argmax(bad))
        band = bands.label(room.centre_frequencies[k])
        raise DataError(f"T[{band}] = {times[k]:g} s is not finite and above 0")
    if not np.isfinite(times).any():
        raise DataError("measured T is missing in every band; there is nothing to calibrate to")
    return Measured(
        times,
        np.full(times.shape, np.nan),
        tuple("t20" if here else "" for here in np.isfinite(times)),
        (),
        fingerprint(room.centre_frequencies, ((SUMMARY, SUMMARY),), {"t20": times[np.newaxis]}),
    )


def refuse_twice(room: Room, data: Measured) -> None:
    """Raise DataError if the room was calibrated on exactly these data already."""
    if room.calibration is not None and room.calibration.measured == data.fingerprint:
        raise DataError(
            f'room "{room.name}" was already calibrated on exactly these data; doing so again would '
            "count them twice. Calibrate the room as it was before, or on other data"
        )
