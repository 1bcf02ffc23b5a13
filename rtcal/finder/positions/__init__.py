"""Say where: what is other than stated in a geometry, and on which surface.

    >>> import rtcal as rt
    >>> case = rt.where.Case.from_room(room, measured)     # doctest: +SKIP
    >>> print(rt.where.find(case))                         # doctest: +SKIP

docs/where.md has the method and what it can and cannot do.
"""

from rtcal.where.advice import Place, next_position
from rtcal.where.candidate import Candidate
from rtcal.where.case import Case
from rtcal.where.corrected import Corrected
from rtcal.where.find import EFFECTS, find
from rtcal.where.finding import Finding
from rtcal.where.verification import LEAST_PAIRS, Verification, verify

__all__ = [
    "EFFECTS",
    "LEAST_PAIRS",
    "Candidate",
    "Case",
    "Corrected",
    "Finding",
    "Place",
    "Verification",
    "find",
    "next_position",
    "verify",
]
