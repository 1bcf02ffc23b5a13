"""The output of ``rtcal apply``: the case with the effect, its room and the printed text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtcal.finder.means.corrected import corrected_room, not_in_room
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.recalibrated import table
from rtcal.finder.means.recalibration import recalibrate

_KEPT = ("verdict", "effect", "named", "family", "candidates", "sets", "probabilities", "evidence")
"""Entries of a finding that are stored with the correction."""


@dataclass(frozen=True)
class Correction:
    """The text, its record, and the files to write by path; no files if there is nothing to add."""

    text: str
    record: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of the text as plain values and arrays."""
        return dict(self.record)


def correct(finding: MeansFinding, case_path: str, room_path: str | None = None) -> Correction:
    """Add the named effects, or the most probable ones, to a finding's case, and calibrate it.

    Parameters
    ----------
    finding : MeansFinding
    case_path : str
        Path of the case with the effect (JSON).
    room_path : str, optional
        Path of the room with the effect (TOML).
    """
    said = finding.to_dict()
    record: dict[str, Any] = {k: said[k] for k in _KEPT if k in said}
    if (nothing := finding.reason_for_none) is not None:
        record |= {"sentence": nothing, "written": []}
        return Correction(f"{nothing}\nNothing is written.", record)
    corrected = finding.apply()
    calibrated = recalibrate(corrected, finding.discrepancy)
    files = {case_path: corrected.to_json().encode()}
    absent: list[str] = []
    if room_path is not None:
        files[room_path] = corrected_room(corrected).to_text(Path(room_path).parent).encode()
        absent = not_in_room(corrected)
    sentence = finding.added
    lines = [
        sentence,
        *table(corrected.room, {"corrected": calibrated}),
        *(f"  note: {note}" for note in finding.notes),
        *(f"  not in {room_path}: {line}" for line in absent),
        f"Written: {', '.join(files)}",
    ]
    record |= {
        "sentence": sentence,
        "present": [p.to_dict() for p in corrected.applied],
        "calibrated": calibrated.to_dict(),
        "written": list(files),
        "notes": list(finding.notes),
        "not_in_room": absent,
    }
    return Correction("\n".join(lines), record, files)
