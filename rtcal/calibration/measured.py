"""The measured T in a room's bands, as a calibration takes it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rtcal.acoustics import bands, marks
from rtcal.acoustics.marks import TrustMark, bent_decays
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import REVERBERATION, TARGET, parameter_label
from rtcal.acoustics.room import Room, fingerprint, of_pairs
from rtcal.support import checks
from rtcal.support.errors import DataError, OtherBandsWarning
from rtcal.support.text import as_sentence, shortened
from rtcal.support.types import Array

_FEW_VALUES = 4
"""Fewer values of T20 and T30 may be equal by rounding."""


@dataclass(frozen=True, repr=False, eq=False)
class MeasuredTimes:
    """Measured T of a room in s and its standard uncertainty, (n_bands,) each, NaN where missing."""

    centre_frequencies: Array  # the room's, in Hz
    reverberation_time: Array  # s
    uncertainty: Array  # s
    parameter: tuple[str, ...]  # "t20", "t30" or ""
    measured: Measurement | None = None  # what was measured, in its own bands; None of a list of T

    def __repr__(self) -> str:
        n, data = np.count_nonzero(np.isfinite(self.reverberation_time)), self.fingerprint
        return f"<MeasuredTimes: {n} of {len(self.parameter)} bands, data {shortened(data)}>"

    @cached_property
    def ignored(self) -> tuple[float, ...]:
        """Measured bands in Hz that the room does not have."""
        if self.measured is None:
            return ()
        stated = self.measured.centre_frequencies
        return tuple(bands.unused(stated, self.centre_frequencies).tolist())

    @cached_property
    def fingerprint(self) -> str:
        """Texts that identify the measured data (T, and T20 and T30 at each pair); "" without T."""
        if not np.isfinite(self.reverberation_time).any():
            return ""
        labels = [f"{f:g}" for f in self.centre_frequencies.tolist()]
        names = [fingerprint("T", dict(zip(labels, self.reverberation_time.tolist(), strict=True)))]
        if self.measured is not None and not self.measured.is_summary:
            at_pairs = self.measured.in_bands(self.centre_frequencies)
            names += [
                of_pairs(o.key, at_pairs.pairs, at_pairs.values[o.key], self.centre_frequencies)
                for o in REVERBERATION
                if o.key in at_pairs.values
            ]
        return " ".join(names)

    @cached_property
    def caution(self) -> str:
        """Cautions about T from other bands, a T30 that copies T20, and equal positions; else ""."""
        if self.measured is None:
            return ""
        stated = self.measured.centre_frequencies
        rule = bands.rule(stated, self.centre_frequencies, "T")
        said = rule, copied(self.measured), *marks.given_twice(self.measured)
        return " ".join(as_sentence(each) for each in said if each)

    @cached_property
    def bent(self) -> tuple[TrustMark, ...]:
        """Cautions about bands with a curved decay."""
        if self.measured is None:
            return ()
        return bent_decays(self.measured.in_bands(self.centre_frequencies))

    @cached_property
    def mistyped(self) -> tuple[TrustMark, ...]:
        """Cautions about likely typing errors of T, of single values or of their mean."""
        frequencies, of = self.centre_frequencies, self.measured
        name, found = "T", list[TrustMark]()
        if of is not None:
            matched = {p: v for p, v in of.values.items() if p in self.parameter}
            alone = Measurement(
                centre_frequencies=of.centre_frequencies, values=matched, pairs=of.pairs
            )
            name, found = "the mean T", marks.in_measurement(alone)

        def in_room(error: TrustMark) -> TrustMark:
            distance = np.abs(np.log(frequencies / np.asarray(error.frequency, dtype=float)))
            return replace(error, frequency=float(frequencies[np.argmin(distance)]))

        own = tuple(marks.of_row(frequencies, self.reverberation_time, name, " s"))
        return tuple(map(in_room, found)) or own


def times_in_room(room: Room, measured: Measurement | Sequence[float] | Array) -> MeasuredTimes:
    """Return the measured T and its uncertainty in s in the room's bands; NaN in a band without T.

    ``measured`` is a `Measurement`, whose bands are converted to those of ``room``, or T in s,
    (n_bands,). Raises DataError for a wrong shape, a T that is not above 0, an uncertainty larger than
    its T, or a measurement without T in any band of the room.
    """
    frequencies = room.centre_frequencies
    if isinstance(measured, Measurement):
        measured.refuse_other_units()
        there = measured.in_bands(frequencies)
        time, uncertainty = there.reverberation_time, there.reverberation_time_uncertainty
        if not np.isfinite(time).any():
            parameters = ", ".join(parameter_label(p) for p in measured.values)
            raise DataError(
                f"the measurement has {parameters} but no T20 or T30 in any band of the "
                "room. Add T20 or T30; other parameters cannot replace them"
            )
        parameter = there.reverberation_parameter
        return MeasuredTimes(frequencies, time, uncertainty, parameter, measured)
    try:
        times = checks.array("measured", measured).copy()
    except DataError as error:
        raise DataError(f"measured must be a list of T in s: {error}") from error
    if times.shape != (room.n_bands,):
        raise DataError(
            f"measured T has shape {times.shape}; it must be ({room.n_bands},), one value per "
            "band of the room"
        )
    if (bad := np.isinf(times) | (times <= 0)).any():
        k = int(np.argmax(bad))
        raise DataError(
            f"T[{bands.label(frequencies[k])}] = {times[k]:g} s must be finite and above 0"
        )
    if not np.isfinite(times).any():
        raise DataError("measured T is missing in every band; give it in at least one")
    parameter = tuple(TARGET.key if finite else "" for finite in np.isfinite(times))
    return MeasuredTimes(frequencies, times, np.full(times.shape, np.nan), parameter)


def notes_of_bands(room: Room, measured: Measurement) -> list[str]:
    """Return notes on measured bands that are converted or left out, and bands of the room without T.

    Raises DataError if ``room`` and ``measured`` have no band in common.
    """
    wanted = room.centre_frequencies
    in_room = measured.in_bands(wanted)
    told = bands.notes(measured.centre_frequencies, wanted)
    lacking = wanted[np.isnan(in_room.reverberation_time)]
    if lacking.size:
        told.append(f"no T was measured at {', '.join(bands.labels(lacking))}")
    return told


def tell_data(room: Room, measured: Measurement) -> None:
    """Warn about bands that are converted, left out or without T."""
    if told := notes_of_bands(room, measured):
        warnings.warn("; ".join(told), OtherBandsWarning, stacklevel=checks.stack_level())


def copied(measured: Measurement) -> str:
    """Return a caution if T20 and T30 are the same numbers; otherwise ""."""
    t20, t30 = (measured.values.get(o.key, np.full(1, np.nan)) for o in REVERBERATION)
    both = (
        np.isfinite(t20) & np.isfinite(t30) if t20.shape == t30.shape else np.zeros(1, dtype=bool)
    )
    if both.sum() < _FEW_VALUES or not np.array_equal(t20[both], t30[both]):
        return ""
    return (
        "T30 equals T20 in every value, so one is a copy of the other, and whether the decay is curved "
        "is unknown"
    )


def no_times(room: Room) -> MeasuredTimes:
    """Return measured times that are NaN in every band, for a calibration without T."""
    nothing = np.full(room.n_bands, np.nan)
    return MeasuredTimes(room.centre_frequencies, nothing, nothing, ("",) * room.n_bands)


def data_history(room: Room, data: MeasuredTimes) -> str:
    """Return the texts that identify all data to which the room was calibrated, with the new data."""
    before = [] if room.calibration is None else [room.calibration.measured]
    return " ".join([*before, data.fingerprint])
