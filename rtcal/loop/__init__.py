"""Calibrate a simulator: the closed loop on the mean T20, or every position by Gauss-Newton steps."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.loop.closed import Loop as Loop
    from rtcal.loop.closed import start as start
    from rtcal.loop.measured_pairs import ControlRuns as ControlRuns
    from rtcal.loop.predicted import predict_positions as predict_positions
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
