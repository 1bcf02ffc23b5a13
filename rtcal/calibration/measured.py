"""The measured T that a calibration uses: in the room's bands, with its uncertainty."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import band_conversion, bands
from rtcal.acoustics.curvature import BentDecay, bent_decays
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import parameter_label
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.types import Array


@dataclass(frozen=True, repr=False)
class MeasuredTimes:
    """Measured T in the room's bands.

    ``reverberation_time`` and ``uncertainty`` in s, (n_bands,), NaN where missing or unknown;
    ``parameter`` is ``"t20"``, ``"t30"`` or ``""`` per band. ``ignored`` are the measured bands in Hz
    that the room lacks. ``fingerprint`` identifies the data. ``caution`` is a sentence if T was
    converted from bands of another width, else empty. ``bent`` are the bands whose decay is not
    straight.
    """

    reverberation_time: Array
    uncertainty: Array
    parameter: tuple[str, ...]
    ignored: tuple[float, ...]
    fingerprint: str
    caution: str
    bent: tuple[BentDecay, ...] = ()

    def __repr__(self) -> str:
        n = np.count_nonzero(np.isfinite(self.reverberation_time))
        return f"<MeasuredTimes: {n} of {len(self.parameter)} bands, data {self.fingerprint}>"


def times_in_room(room: Room, measured: Measurement | Sequence[float] | Array) -> MeasuredTimes:
    """Return the measured T in the room's bands; NaN where a band has none.

    Raises
    ------
    DataError
        For a wrong shape, a T that is not above 0, an uncertainty above the value, or no band in
        common.
    """
    if isinstance(measured, Measurement):
        measured.refuse_large_uncertainty()
        in_room = band_conversion.measurement_in_room_bands(measured, room.centre_frequencies)
        decay = in_room.decay_time()
        mean = decay.mean
        if not np.isfinite(mean).any():
            parameters = ", ".join(parameter_label(p) for p in measured.values)
            raise DataError(
                f"the measurement has {parameters}, but no T20 and no T30 in any band of the room"
            )
        stated, wanted = measured.centre_frequencies, room.centre_frequencies
        return MeasuredTimes(
            reverberation_time=mean,
            uncertainty=decay.uncertainty,
            parameter=decay.parameter,
            ignored=tuple(band_conversion.unused(stated, wanted).tolist()),
            fingerprint=_fingerprint(room, mean),
            caution=band_conversion.rule(stated, wanted, "T"),
            bent=bent_decays(in_room),
        )
    try:
        times = checks.array("measured", measured).copy()
    except DataError as error:
        raise DataError(f"measured is not a list of T in s: {error}") from error
    if times.shape != (room.n_bands,):
        raise DataError(f"measured T has shape {times.shape}; the room asks for ({room.n_bands},)")
    if (bad := np.isinf(times) | (times <= 0)).any():
        k = int(np.argmax(bad))
        band = bands.label(room.centre_frequencies[k])
        raise DataError(f"T[{band}] = {times[k]:g} s is not finite and above 0")
    if not np.isfinite(times).any():
        raise DataError("measured T is missing in every band; there is nothing to calibrate to")
    return MeasuredTimes(
        times,
        np.full(times.shape, np.nan),
        tuple("t20" if finite else "" for finite in np.isfinite(times)),
        (),
        _fingerprint(room, times),
        "",
    )


def no_times(room: Room) -> MeasuredTimes:
    """Return that no T was measured in any band: other observations alone are matched."""
    nothing = np.full(room.n_bands, np.nan)
    return MeasuredTimes(nothing, nothing, ("",) * room.n_bands, (), "", "")


def _fingerprint(room: Room, times: Array) -> str:
    """A short identifier of the T of every band; equal T from different files have the same."""
    digest = hashlib.sha256()
    for frequency, value in zip(room.centre_frequencies, times, strict=True):
        if np.isfinite(value):
            digest.update(f"{frequency:g} Hz {value:.9g} s;".encode())
    return digest.hexdigest()[:16]


def refuse_repeated_data(room: Room, data: MeasuredTimes) -> None:
    """Raise DataError if the room was calibrated on exactly these data already."""
    if room.calibration is not None and data.fingerprint in room.calibration.measured.split():
        raise DataError(
            f'room "{room.name}" was already calibrated on exactly these data; doing so again would '
            "count them twice. Calibrate the room as it was before, or on other data"
        )


def data_history(room: Room, data: MeasuredTimes) -> str:
    """Return the fingerprints of all data that the room was calibrated to, with these data."""
    before = [] if room.calibration is None else [room.calibration.measured]
    return " ".join([*before, data.fingerprint])
