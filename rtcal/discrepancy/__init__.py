"""Find where simulation and measurement disagree, name what is missing, add it, verify.

    >>> import rtcal as rt
    >>> case = rt.discrepancy.Case.from_file("case.toml")     # doctest: +SKIP
    >>> print(rt.discrepancy.find(case))                      # doctest: +SKIP

docs/discrepancy.md has the method and what it can and cannot do.
"""

from rtcal.discrepancy.bootstrap import Threshold, control_rooms
from rtcal.discrepancy.case import Case, Change, Configuration, Present
from rtcal.discrepancy.effects import Absorber, Effect, library
from rtcal.discrepancy.finding import Finding, find

__all__ = [
    "Absorber", "Case", "Change", "Configuration", "Effect", "Finding", "Present", "Threshold",
    "control_rooms", "find", "library",
]  # fmt: skip
