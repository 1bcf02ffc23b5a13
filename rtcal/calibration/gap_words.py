"""The gap that a calibration leaves, in a sentence, with what takes it up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.acoustics.quality import MET
from rtcal.support.types import Array


def numbers(values: Sequence[float | None] | Array) -> Array:
    """Return the values as an array, NaN where one is missing."""
    return np.array([np.nan if v is None else v for v in values])


def remaining_gap(record: Mapping[str, Any]) -> str:
    """Return that the calibrated room lacks the measured T, where it does, and to what the gap belongs.

    "" where T is met in every band that has one, and where nothing asks for T. ``record`` is as for
    `rtcal.calibration.table.text_table`.
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
    if not record["room_taken_as_exact"]:
        return f"{said}. {_taken_up(record)}"
    if record["unreachable"]:
        return f"{said}. No coefficients within their limits reach that time."
    return f"{said}. The uncertainty of the measured time allows them."


_GROUPS = {
    "volume": "volume",
    "areas": "areas",
    "temperature": "climate",
    "humidity": "climate",
    "coefficients": "",
}
"""What takes up a gap, by the first word of what a room states of its uncertainty."""
_SAID_SHARE = 0.2


def _taken_up(record: Mapping[str, Any]) -> str:
    """Return which of the room's uncertainties takes up the gap, with what is stated of it."""
    shares = record.get("gap_shares", {})
    stated: dict[str, list[str]] = {}
    for words in record.get("room_uncertainty", "").split(", "):
        stated.setdefault(_GROUPS.get(words.partition(" ")[0], ""), []).append(words)
    causes = [
        "the measured time"
        if group == "T"
        else f"the {group} ({', '.join(w.removeprefix(f'{group} ') for w in stated.get(group, []))})"
        for group in sorted(shares, key=lambda g: -float(shares[g]))
        if shares[group] >= _SAID_SHARE
    ]
    check = " Check that first." if shares.get("T", 0.0) < 1 - _SAID_SHARE else ""
    return f"What is stated as uncertain explains them: {' and '.join(causes)}.{check}"
