"""Small real rooms that ship with rtcal; source and licence stand beside the data."""

from __future__ import annotations

from pathlib import Path

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room

_HERE = Path(__file__).parent


def path(name: str) -> Path:
    """Return the path of a shipped file, for example ``path("bras_cr2/room.toml")``."""
    return _HERE / name


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
