"""Find what a model misses: compare it with measurements, name the effect, add it, verify it.

    >>> import rtcal as rt
    >>> case = rt.discrepancy.Case.from_file("case.toml")     # doctest: +SKIP
    >>> print(rt.discrepancy.find(case))                      # doctest: +SKIP

docs/discrepancy.md has the method and what it can and cannot do.
"""

from rtcal.discrepancy.bootstrap import Threshold, control_rooms
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.configuration import Change, Configuration
from rtcal.discrepancy.corrected import corrected_room, simulator
from rtcal.discrepancy.effects import Absorber, Effect, library
from rtcal.discrepancy.finding import Finding
from rtcal.discrepancy.planning import Plan, Proposal, plan
from rtcal.discrepancy.recalibrated import Recalibrated
from rtcal.discrepancy.recalibration import recalibrate
from rtcal.discrepancy.search import find
from rtcal.discrepancy.several import find_several
from rtcal.discrepancy.several_finding import SeveralFinding
from rtcal.discrepancy.verification import Verification, verify

__all__ = [
    "Absorber",
    "AppliedEffect",
    "Case",
    "Change",
    "Configuration",
    "Effect",
    "Finding",
    "Plan",
    "Proposal",
    "Recalibrated",
    "SeveralFinding",
    "Threshold",
    "Verification",
    "control_rooms",
    "corrected_room",
    "find",
    "find_several",
    "library",
    "plan",
    "recalibrate",
    "simulator",
    "verify",
]
