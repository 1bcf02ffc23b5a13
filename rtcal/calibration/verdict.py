"""The verdict of a calibration, in words: the one statement that text, page and JSON share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.marks import MET, P_CONTRADICTION, agreement
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

LARGE_GAP = 3.0
"""A gap before calibration, in JND, that anyone hears. Agreement says little where it is allowed."""
_AGAINST = "The measurement contradicts what was stated of the materials"
_ALIKE = "The measurement agrees with what was stated only if all coefficients err the same way"
_SOMETHING = (
    "Something is missing from the model, or is stated wrongly, or is less certain than stated."
)
_OF_ROOM = (
    "surface_missing",
    "surface_beyond_sense",
    "dimensions",
    "wide_sigma",
    "equations_differ",
)
"""Marks of the whole room that leave open whether model and measurement agree."""


class CalibrationVerdict(NamedTuple):
    """The statement of a calibration on model and measurement, which all sentences follow.

    ``level`` is "agrees", "open" or "contradicts", ``heading`` a sentence without its point, and
    ``text`` the evidence.
    """

    level: Literal["agrees", "open", "contradicts"]
    heading: str
    text: str


def verdict(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return what a calibration shows: the one statement that text, page and JSON share.

    In this order: a likely typing error; a calibration that does not ask for T; a gap that remains;
    what p and z say of the materials, which a reservation about the whole room or about every band
    leaves open.

    Parameters
    ----------
    record : mapping
        As `rtcal.calibration.CalibrationResult.to_dict` returns it.
    """
    marks = record["trust_marks"]
    typed = [f"{m['frequency']:g} Hz: {m['text']}" for m in marks if m["kind"] == "typing_error"]
    if typed:
        more = f" Another {len(typed) - 1} such values are listed below." if typed[1:] else ""
        return CalibrationVerdict(
            "contradicts",
            f"Likely a typing error at {typed[0]}",
            "Check this value before anything else, and calibrate again. Every coefficient of its band "
            f"is computed with it.{more}",
        )
    after = np.abs(numbers(record["gap_after_jnd"]))
    compared = np.isfinite(after)
    if not record["matches_measured_time"]:
        off = f", and T is off by up to {after[compared].max():.1f} JND" if compared.any() else ""
        return CalibrationVerdict(
            "open",
            "Nothing in this calibration asks for the measured T",
            f"The coefficients follow the other terms alone{off}. Add terms.ExactMatch(), "
            "MatchWithin() or SoftMatch().",
        )
    of_materials = _of_materials(record)
    if left := remaining_gap(record):
        fact, _, cause = left.partition(". ")
        if of_materials.level == "contradicts":
            text = f"{cause} {of_materials.heading}. {of_materials.text}"
            return CalibrationVerdict("contradicts", fact, text)
        q, asks, p, together = _evidence(record)
        contradicted = p is not None and p < P_CONTRADICTION
        stated = "contradicted unless all coefficients err the same way"
        stated = (
            f"What was stated is {stated if contradicted else 'not contradicted'} ({q}); {asks}."
        )
        return CalibrationVerdict(
            "open", fact, f"{cause} {stated} {together if contradicted else ''}".rstrip()
        )
    f = np.asarray(record["centre_frequencies"])[compared]
    marked = {mark["frequency"] for mark in marks}
    reserved = any(mark["kind"] in _OF_ROOM for mark in marks) or marked >= set(f.tolist())
    if of_materials.level == "agrees" and reserved:
        heading = f"{of_materials.heading}, with reservations"
        return CalibrationVerdict("open", heading, of_materials.text)
    return of_materials


def _evidence(record: Mapping[str, Any]) -> tuple[str, str, float | None, str]:
    """Return Q and p in words, the bands whose z is large, p, and what errors in common explain."""
    found = record["plausibility"]
    p, p_together = found["p_value"], found["p_together"]
    free = found["degrees_of_freedom"]
    q = f"Q = {found['q']:.1f}, {free} degree{'s' * (free != 1)} of freedom"
    if p is not None:
        q += f", p = {p:.2g}"
    where = bands.hertz(_far(record))
    asks = (
        f"{f'at {where} the measurement asks' if where else 'in no band does the measurement ask'} for "
        "an absorption more than two standard deviations from the stated one"
    )
    together = ""
    if p is not None and p_together is not None and p_together >= 2 * p:
        together = (
            f"If all handbook values may be off by a common factor, p = {p_together:.2g}. `rtcal find` "
            "also allows for errors of the equation and of the measurement."
        )
    return q, asks, p, together


def _far(record: Mapping[str, Any]) -> list[float]:
    """Return the bands in Hz whose T asks for what was stated as unlikely, within the bounds."""
    marks = record["trust_marks"]
    return [m["frequency"] for m in marks if m["kind"] == "implausible"]


def _longer(record: Mapping[str, Any]) -> str:
    """Return what it most often means that z is negative in every band with T, of at least two."""
    z = numbers(record["plausibility"]["z"])
    known = z[np.isfinite(z)]
    if len(known) < 2 or not (known < 0).all():
        return ""
    return (
        "T is longer in every band than the stated coefficients give. Most often the equation then "
        "gives too little T for this room, because its absorption is unevenly distributed or its "
        "surfaces scatter little, or handbook coefficients are too high. A wrong volume or area is "
        "rarer."
    )


def _of_materials(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return what p and z say of the materials, where the calibrated room has the measured T."""
    q, asks, p, together = _evidence(record)
    found = record["plausibility"]
    far = bool(_far(record))
    if not found["degrees_of_freedom"]:
        return CalibrationVerdict(
            "open", "No T was measured in a band of the model", "There is no verdict."
        )
    if p is None:
        return CalibrationVerdict(
            "contradicts" if far else "open",
            _AGAINST if far else "No overall verdict",
            f"{as_sentence(asks)} There is no p-value for all bands together, because a coefficient "
            f"stands at a bound ({q}).",
        )
    agreed = agreement(p, found["p_together"])
    if agreed == "too good" and record.get("stated_by"):
        return CalibrationVerdict(
            "open",
            "The measurement agrees with coefficients that follow from a measurement of this room",
            f"The coefficients moved less than their stated uncertainty makes likely ({q}); {asks}. "
            "That is usual after a calibration or `rtcal apply`, and no evidence for the materials.",
        )
    if agreed == "too good":
        return CalibrationVerdict(
            "open",
            "Too good to be true: the measurement is nearer to what was stated than its uncertainty",
            "Over all bands the coefficients moved less than their stated uncertainty makes likely "
            f"({q}); {asks}. Either a sigma or the uncertainty of T is stated too large, or T was "
            "calculated from these coefficients.",
        )
    if agreed == "contradicts" or p < P_CONTRADICTION:
        against = agreed == "contradicts"
        said = (
            f"The coefficients had to move further than their stated uncertainty explains ({q}); "
            f"{asks}.",
            _longer(record) or (_SOMETHING if against else ""),
            together,
        )
        return CalibrationVerdict(
            "contradicts" if against else "open",
            _AGAINST if against else _ALIKE,
            " ".join(filter(None, said)),
        )
    within = (
        f"The coefficients moved no further than their stated uncertainty explains ({q}); {asks}."
    )
    gap = np.abs(numbers(record["gap_before_jnd"]))
    largest = float(np.max(gap, where=np.isfinite(gap), initial=0.0))
    if largest >= LARGE_GAP:
        return CalibrationVerdict(
            "open",
            "The measurement does not contradict what was stated of the materials",
            f"{within} The stated uncertainty allows even the gap of {largest:.1f} JND before, so this "
            "does not confirm the model.",
        )
    return CalibrationVerdict(
        "open" if far else "agrees",
        "The measurement agrees with what was stated of the materials"
        + (", with exceptions" if far else ""),
        within,
    )


def numbers(values: Sequence[float | None] | Array) -> Array:
    """Return the values as an array, NaN where one is missing."""
    return np.array([np.nan if v is None else v for v in values])


def remaining_gap(record: Mapping[str, Any]) -> str:
    """Return that the calibrated room lacks the measured T, where it does, and to what the gap belongs.

    "" where T is met in every band that has one, and where nothing asks for T. ``record`` is as for
    `rtcal.calibration.table.blocks_of`.
    """
    after, before = (np.abs(numbers(record[key])) for key in ("gap_after_jnd", "gap_before_jnd"))
    left = after >= MET  # not where there is no T
    if not left.any() or not record["matches_measured_time"]:
        return ""
    n, count = int(left.sum()), int(np.isfinite(after).sum())
    said = (
        f"The calibrated room does not have the measured reverberation time in {n} of {count} bands: "
        f"gaps of up to {after[left].max():.1f} JND remain"
    )
    grown = left & (after >= before + MET)
    if grown.any():
        said += f", in {int(grown.sum())} larger than before"
    if record["room_taken_as_exact"]:
        if record["unreachable"]:
            return f"{said}. No coefficients within their limits reach that time."
        return f"{said}. The uncertainty of the measured time allows them."
    uncertain = f" (stated: {words})" if (words := record.get("room_uncertainty")) else ""
    return f"{said}. What is stated as uncertain explains them{uncertain}. Check that first."
