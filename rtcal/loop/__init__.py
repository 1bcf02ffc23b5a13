"""Calibrate a simulator: the closed loop on the mean T20, or every position by Gauss-Newton steps."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.loop.calibrate import LoopResult as LoopResult
    from rtcal.loop.control_runs import ControlRuns as ControlRuns
    from rtcal.loop.positions_result import PositionsPrediction as PositionsPrediction
    from rtcal.loop.positions_result import PositionsPredictions as PositionsPredictions
    from rtcal.loop.positions_result import PositionsResult as PositionsResult
    from rtcal.loop.positions_result import predict_positions as predict_positions
    from rtcal.loop.rules import Rule as Rule
    from rtcal.loop.state import STATUSES as STATUSES
    from rtcal.loop.state import Loop as Loop
    from rtcal.loop.state import Step as Step
    from rtcal.loop.state import start as start
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
