"""The measured T that a calibration uses: in the room's bands, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import band_conversion, bands, fingerprints
from rtcal.acoustics.decay import BentDecay, bent_decays
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import REVERBERATION, TARGET
from rtcal.acoustics.parameters import parameter_label
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array

_FEW_VALUES = 4
"""Fewer values of T20 and T30 may be equal by rounding."""


@dataclass(frozen=True, repr=False)
class MeasuredTimes:
    """Measured T in the room's bands.

    ``reverberation_time`` and ``uncertainty`` in s, (n_bands,), NaN where missing or unknown;
    ``parameter`` is ``"t20"``, ``"t30"`` or ``""`` per band. ``ignored`` are the measured bands in Hz
    that the room lacks. ``fingerprint`` identifies the data. ``caution`` is a sentence if T was
    converted from bands of another width or T30 is a copy of T20, else empty. ``bent`` are the bands
    whose decay is not straight.
    """

    reverberation_time: Array
    uncertainty: Array
    parameter: tuple[str, ...]
    ignored: tuple[float, ...]
    fingerprint: str
    caution: str
    bent: tuple[BentDecay, ...] = ()

    def __repr__(self) -> str:
        n, data = np.count_nonzero(np.isfinite(self.reverberation_time)), self.fingerprint
        return f"<MeasuredTimes: {n} of {len(self.parameter)} bands, data {shortened(data)}>"


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
        cautions = (band_conversion.rule(stated, wanted, "T"), copied(measured))
        return MeasuredTimes(
            reverberation_time=mean,
            uncertainty=decay.uncertainty,
            parameter=decay.parameter,
            ignored=tuple(band_conversion.unused(stated, wanted).tolist()),
            fingerprint=fingerprints.of_times(room, mean),
            caution=". ".join(filter(None, cautions)),
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
        tuple(TARGET.key if finite else "" for finite in np.isfinite(times)),
        (),
        fingerprints.of_times(room, times),
        "",
    )


def copied(measured: Measurement) -> str:
    """Return a caution if T20 and T30 are the same numbers; "" else."""
    t20, t30 = (measured.values.get(o.key, np.full(1, np.nan)) for o in REVERBERATION)
    both = (
        np.isfinite(t20) & np.isfinite(t30) if t20.shape == t30.shape else np.zeros(1, dtype=bool)
    )
    if both.sum() < _FEW_VALUES or not np.array_equal(t20[both], t30[both]):
        return ""
    return (
        "T30 is T20 in every value, so one of them is a copy: whether the decay is bent is unknown"
    )


def no_times(room: Room) -> MeasuredTimes:
    """Return that no T was measured in any band: other observations alone are matched."""
    nothing = np.full(room.n_bands, np.nan)
    return MeasuredTimes(nothing, nothing, ("",) * room.n_bands, (), "", "")


def data_history(room: Room, data: MeasuredTimes) -> str:
    """Return the fingerprints of all data that the room was calibrated to, with these data."""
    before = [] if room.calibration is None else [room.calibration.measured]
    return " ".join([*before, data.fingerprint])
