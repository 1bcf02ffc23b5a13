"""The calibration problem: one convex QP, composed, built once, solved, certified."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.calibration.problem import CalibrationProblem as CalibrationProblem
    from rtcal.calibration.qp import forget as forget
    from rtcal.calibration.result import CalibrationResult as CalibrationResult
    from rtcal.calibration.result import JointResult as JointResult
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
