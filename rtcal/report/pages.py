"""The page of any saved result."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from rtcal.calibration.result import CalibrationResult
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.verification import MeansVerification
from rtcal.finder.positions.finding import PositionsFinding
from rtcal.finder.positions.verification import PositionsVerification
from rtcal.finder.states import StatesFinding
from rtcal.loop.positions_prediction import PositionsPrediction, PositionsPredictions
from rtcal.loop.positions_result import PositionsResult
from rtcal.loop.result import LoopResult
from rtcal.loop.state import Loop
from rtcal.modes.result import ModesResult
from rtcal.prediction.compared import Predictions
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction
from rtcal.report import finding_pages, gap_report, positions_page, prediction_page
from rtcal.report.document import Heading
from rtcal.report.page import calibration_page, loop_page
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.results import load

__all__ = ["page_of"]
__dir__ = __all__.copy


@checked
def page_of(
    path: str | os.PathLike[str],
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return the page of a saved result: its folder, its ``result.json``, or the state of a loop.

    The result does not hold the names of its files. So the page of a finding of means has its case as
    a file within it, and that of a finding at positions has no command to reproduce it.

    Raises
    ------
    DataError
        For a folder that has no result, a file that is none, or a result that has no page.
    """
    result = load(path)
    if isinstance(result, MeansFinding | MeansVerification):
        verified = result if isinstance(result, MeansVerification) else None
        found = result if isinstance(result, MeansFinding) else result.finding
        return gap_report.page(
            found, verified, gap_report.figures(found, verified), heading=heading
        )
    if isinstance(result, Loop | LoopResult):
        return loop_page(result, heading=heading, progress=progress)
    if isinstance(result, CalibrationResult):
        return calibration_page(result, heading=heading, progress=progress)
    head, step = heading or Heading(), progress or (lambda: None)
    if isinstance(result, PositionsFinding | PositionsVerification):
        proved = result if isinstance(result, PositionsVerification) else None
        where = result if isinstance(result, PositionsFinding) else result.finding
        return finding_pages.where_page(where, proved, finding_pages.drawn(where, proved), head)
    if isinstance(result, PositionsResult):
        return positions_page.page(result, head, step)
    if isinstance(result, ModesResult):
        return positions_page.modes_page(result, head, step)
    if isinstance(result, Prediction | Predictions | Design):
        return prediction_page.page(result, head, step)
    if isinstance(result, StatesFinding):
        return finding_pages.states_page(result, head, step)
    if isinstance(result, PositionsPrediction | PositionsPredictions):
        return prediction_page.page_at_positions(result, head, step)
    raise DataError(
        f'{Path(path)}: a result of the kind "{result.record_kind.rstrip(" 0123456789")}" has no page. '
        "Pages show a calibration, a loop, positions, modes, predictions, designs, findings and what "
        "changed; `rtcal learn` prints an archive"
    )
