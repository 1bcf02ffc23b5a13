"""A calibrated room with a mesh, for the tests of the room that a page shows."""

from pathlib import Path

import rtcal as rt
from rtcal.calibration.result import CalibrationResult
from rtcal.datasets.examples import example

MEASURED = [0.8, 0.7, 0.97, 0.71]


def calibrated(folder: Path, **other: object) -> CalibrationResult:
    """Return the example's L-shaped room of four materials, calibrated; ``other`` is replaced."""
    for name, content in example("where").files.items():
        (folder / name).write_bytes(content)
    room = rt.Room.from_file(folder / "room.toml")
    return rt.calibrate(room.replace(**other), MEASURED)
