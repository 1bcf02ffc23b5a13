"""Say where: what is other than stated in a geometry, and on which surface.

    >>> import rtcal as rt
    >>> case = rt.finder.positions.PositionsCase.from_room(room, measured)     # doctest: +SKIP
    >>> print(rt.finder.positions.find(case))                         # doctest: +SKIP

docs/where.md has the method and what it can and cannot do.
"""

from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.corrected import Corrected
from rtcal.finder.positions.finding import Place, PositionsFinding, next_position
from rtcal.finder.positions.search import EFFECTS, find
from rtcal.finder.positions.verification import PositionsVerification, verify

__all__ = [
    "EFFECTS",
    "Corrected",
    "Place",
    "PositionsCase",
    "PositionsFinding",
    "PositionsVerification",
    "find",
    "next_position",
    "verify",
]
__dir__ = __all__.copy
