"""The folder of a calibration to every position: the calibrated room, all numbers, two figures."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rtcal.errors import MissingDependencyError
from rtcal.report import figures, positions_figures
from rtcal.support.files import make_folder, write_all

if TYPE_CHECKING:
    from rtcal.loop.positions_result import PositionsResult
    from rtcal.simulators.geometry import Polyhedron

ROOM, NUMBERS, PLAN, SHIFTS = "room.toml", "result.json", "plan.png", "shifts.png"
FILES = (ROOM, NUMBERS, PLAN, SHIFTS)


def write(
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
    contents = {
        folder / ROOM: result.room.to_text().encode(),
        folder / NUMBERS: result.to_json().encode(),
    }
    try:
        for name, figure in (
            (PLAN, positions_figures.plan(result, geometry, sources, receivers)),
            (SHIFTS, positions_figures.shifts(result)),
        ):
            contents[folder / name] = figures.rendered(figure, "png")
    except MissingDependencyError as error:
        warnings.warn(f"no figures: {error}", stacklevel=2)
    make_folder(folder)
    write_all(contents)
    return list(contents)
