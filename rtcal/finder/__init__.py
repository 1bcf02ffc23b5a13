"""Find what is missing from a room's model: compare it with a measurement, add the effect, check it.

    >>> import rtcal as rt
    >>> case = rt.finder.Case.from_file("case.toml")     # doctest: +SKIP
    >>> print(rt.find(case))                      # doctest: +SKIP

docs/discrepancy.md has the method and its limits.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.finder import positions as positions
    from rtcal.finder.case import Case as Case
    from rtcal.finder.case import ChangedMaterial as ChangedMaterial
    from rtcal.finder.case import Configuration as Configuration
    from rtcal.finder.case import PositionsCase as PositionsCase
    from rtcal.finder.case import StatesCase as StatesCase
    from rtcal.finder.case import case_of as case_of
    from rtcal.finder.diagnosis import Diagnosis as Diagnosis
    from rtcal.finder.effects import Absorber as Absorber
    from rtcal.finder.effects import Effect as Effect
    from rtcal.finder.effects import library as library
    from rtcal.finder.finding import Finding as Finding
    from rtcal.finder.means.engines import control_rooms as control_rooms
    from rtcal.finder.means.planning import plan as plan
    from rtcal.finder.means.recalibration import recalibrate as recalibrate
    from rtcal.finder.verification import verify as verify
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
