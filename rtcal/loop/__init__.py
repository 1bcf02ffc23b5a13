"""The closed loop: calibrate a simulator by moving the target of an equation's calibration."""

from rtcal.loop.calibrate import calibrate_simulator
from rtcal.loop.result import LoopResult
from rtcal.loop.rules import Rule
from rtcal.loop.state import STATUSES, Loop, Step, start

__all__ = ["STATUSES", "Loop", "LoopResult", "Rule", "Step", "calibrate_simulator", "start"]
