"""The folder of a calibration: the calibrated room, all numbers, its figures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtcal.report import figures, loop_figures
from rtcal.support import checks
from rtcal.support.errors import MissingDependencyError
from rtcal.support.files import make_folder, write_all
from rtcal.support.results import NUMBERS

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult
    from rtcal.loop.positions_result import PositionsResult
    from rtcal.modes.result import ModesResult
    from rtcal.simulators.geometry import Polyhedron

ROOM, FIGURE = "room.toml", "reverberation_time.png"
FILES = (ROOM, NUMBERS, FIGURE)
PLAN, SHIFTS = "plan.png", "shifts.png"
POSITION_FILES = (ROOM, NUMBERS, PLAN, SHIFTS)


def write(result: CalibrationResult, folder: Path) -> list[Path]:
    """Write room, numbers and figure, all or none, and return their paths.

    Without matplotlib there is no figure, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    return write_with_figures(result, folder, {FIGURE: lambda: figures.reverberation_time(result)})


def write_positions(
    result: PositionsResult,
    folder: Path,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> list[Path]:
    """Write room, numbers and figures, all or none, and return their paths.

    Without matplotlib there are no figures, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    draw = {
        PLAN: lambda: loop_figures.plan(result, geometry, sources, receivers),
        SHIFTS: lambda: loop_figures.shifts(result),
    }
    return write_with_figures(result, folder, draw)


def write_with_figures(
    result: CalibrationResult | PositionsResult | ModesResult,
    folder: Path,
    draw: Mapping[str, Callable[[], Any]],
) -> list[Path]:
    """Write room, numbers and the figures that ``draw`` makes by file name; see `write`."""
    contents = {
        folder / ROOM: result.room.to_text(folder).encode(),
        folder / NUMBERS: result.to_json().encode(),
    }
    try:
        pictures = {name: figures.rendered(figure(), "png") for name, figure in draw.items()}
        contents |= {folder / name: picture for name, picture in pictures.items()}
    except MissingDependencyError as error:
        warnings.warn(f"no figure{'s' * (len(draw) > 1)}: {error}", stacklevel=checks.stack_level())
    make_folder(folder)
    write_all(contents)
    return list(contents)
