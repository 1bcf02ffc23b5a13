"""The folder of a calibration to every position: the calibrated room, all numbers, two figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rtcal.report import positions_figures
from rtcal.report.result_folder import ROOM, write_with_figures
from rtcal.support.results import NUMBERS

if TYPE_CHECKING:
    from rtcal.loop.positions_result import PositionsResult
    from rtcal.simulators.geometry import Polyhedron

PLAN, SHIFTS = "plan.png", "shifts.png"
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
    draw = {
        PLAN: lambda: positions_figures.plan(result, geometry, sources, receivers),
        SHIFTS: lambda: positions_figures.shifts(result),
    }
    return write_with_figures(result, folder, draw)
