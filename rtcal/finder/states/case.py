"""Two states of one room: what was measured before and after, at the same positions."""

from __future__ import annotations

from dataclasses import dataclass, field

from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.finder.states.differences import Differences
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.objects import NOT_SAVED


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A room that was measured twice, at the same positions with the same equipment.

    Parameters
    ----------
    room : Room
        Its volume, areas and air. Its coefficients do not count: the first state calibrates.
    before, after : Measurement
        Means over positions, or pairs. The pairs that both have are compared, source by source.
    equation : LinearEquation
        Turns T into an absorption area; Eyring's unless given. Sabine's overstates the change of a
        room that absorbs much.

    Attributes
    ----------
    differences : Differences
        What the two states differ by, in the room's bands.

    Raises
    ------
    DataError
        If no pair, or no T20 or T30 in a band of the room, is in both.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> before = rt.Measurement.from_values([500, 1000], t20=[1.5, 1.4])
    >>> after = rt.Measurement.from_values([500, 1000], t20=[1.1, 0.9])
    >>> case = rt.finder.states.Case(room=room, before=before, after=after)
    >>> print(case.differences.change.round(2))
    [[-0.31 -0.44]]
    """

    room: Room
    before: Measurement
    after: Measurement
    equation: LinearEquation = field(default_factory=Eyring)
    differences: Differences = field(init=False, metadata=NOT_SAVED)

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("before", self.before, Measurement).refuse_large_uncertainty()
        checks.instance("after", self.after, Measurement).refuse_large_uncertainty()
        checks.instance("equation", self.equation, LinearEquation)
        object.__setattr__(self, "differences", Differences.of(self.room, self.before, self.after))
