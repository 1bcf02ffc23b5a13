"""The rooms that ship with rtcal. Their folders state source and licence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.arguments import checked

if TYPE_CHECKING:
    from rtcal.discrepancy.case import Case

_HERE = Path(__file__).parent


def path(name: str) -> Path:
    """Return the path of a shipped file, for example ``path("bras_cr2/room.toml")``."""
    return _HERE / checks.path("name", name)


def bras_cr2() -> tuple[Room, Measurement]:
    """Return the seminar room CR2 of the BRAS benchmark and its measured T30.

    Aspoeck, Brinkmann, Ackermann, Weinzierl, Vorlaender: BRAS - Benchmark for Room Acoustical
    Simulation, doi 10.14279/depositonce-6726.3, CC BY-SA 4.0.
    """
    folder = path("bras_cr2")
    return (
        Room.from_file(str(folder / "room.toml")),
        Measurement.from_file(str(folder / "measured.csv")),
    )


@checked
def hidden_room(*, closed: bool = False) -> tuple[Case, dict[str, Any]]:
    """Return a case with a hidden effect, and the truth: the effect and ``alpha``.

    It is a simulated room of six materials. The tracer is separate from rtcal's
    (`tests/hidden_world`). Configuration A is the room as it is. In B one material is covered with
    another one. In C everything that can be closed or taken out is closed or taken out.

    Parameters
    ----------
    closed : bool
        Return A and C. If False, A and B.
    """
    from rtcal.discrepancy.case import Case

    folder = path("hidden_room")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    return Case.from_file(str(folder / ("closed.json" if closed else "case.json"))), truth
