"""The folder of a calibration: the calibrated room, all numbers, the figure of T(f)."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rtcal.errors import MissingDependencyError
from rtcal.report import figures
from rtcal.support.files import make_folder, spare, write_all

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

ROOM, NUMBERS, FIGURE = "room.toml", "result.json", "reverberation_time.png"
FILES = (ROOM, NUMBERS, FIGURE)


def refuse_inputs(folder: Path, inputs: Sequence[str | os.PathLike[str]]) -> None:
    """Raise DataError if `write` would overwrite one of the files that a calibration reads."""
    spare([folder / name for name in FILES], inputs)


def write(result: CalibrationResult, folder: Path) -> list[Path]:
    """Write room, numbers and figure, all or none, and return their paths.

    Without matplotlib there is no figure, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    contents = {
        folder / ROOM: result.room.to_text().encode(),
        folder / NUMBERS: result.to_json().encode(),
    }
    try:
        figure = figures.reverberation_time(result)
        contents[folder / FIGURE] = figures.rendered(figure, "png")
    except MissingDependencyError as error:
        warnings.warn(f"no figure: {error}", stacklevel=2)
    make_folder(folder)
    write_all(contents)
    return list(contents)
