"""The calibration QP with bounds, solved exactly for millions of rooms at once; see `solve`."""

from rtcal.calibration.exact.batch import ABOVE, BAD_INPUT, BELOW, OK, Answer, solve

__all__ = ["ABOVE", "BAD_INPUT", "BELOW", "OK", "Answer", "solve"]
__dir__ = __all__.copy
