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
    from rtcal.finder.case import Case

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
    return _hidden("closed" if closed else "case", "truth")


def named_room() -> tuple[Case, dict[str, Any]]:
    """Return a case in which the finder names what is hidden, and the truth.

    It is the first such room by the rule of `benchmarks/shipped_cases.py`. The tracer is not rtcal's,
    and the coefficients are drawn about the stated ones with the stated sigma.
    """
    return _hidden("named", "named_truth")


def untold_room() -> tuple[Case, dict[str, Any]]:
    """Return a case in which something is hidden and the data do not tell, and the truth.

    It is drawn as `named_room`: the first by that rule in which the finder claims nothing.
    """
    return _hidden("not_told", "not_told_truth")


def _hidden(case: str, truth: str) -> tuple[Case, dict[str, Any]]:
    from rtcal.finder.case import Case

    folder = path("hidden_room")
    return (
        Case.from_file(str(folder / f"{case}.json")),
        json.loads((folder / f"{truth}.json").read_text(encoding="utf-8")),
    )
