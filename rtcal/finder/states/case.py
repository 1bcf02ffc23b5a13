"""Two states of one room: what was measured before and after, at the same positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from rtcal.acoustics.directivity import Directivity
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.finder.states.differences import Differences
from rtcal.simulators import observations
from rtcal.simulators.path_tracing import PathTracing
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
    simulator : PathTracing, optional
        Of the same room, with every source's directivity: then surfaces are told apart.
    match : sequence of str
        Parameters that tell surfaces apart, where both states have them. Of the level, both states have
        one reference.

    Attributes
    ----------
    differences : Differences
        What the two states differ by, in the room's bands.

    Raises
    ------
    DataError
        If no pair, or no T20 or T30 in a band of the room, is in both; if the simulator is of another
        room, or lacks a measured pair.

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
    simulator: PathTracing | None = None
    match: Sequence[str] = MATCH
    differences: Differences = field(init=False, metadata=NOT_SAVED)

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("before", self.before, Measurement).refuse_large_uncertainty()
        checks.instance("after", self.after, Measurement).refuse_large_uncertainty()
        checks.instance("equation", self.equation, LinearEquation)
        object.__setattr__(self, "match", observations.checked_parameters(self.match))
        object.__setattr__(self, "differences", Differences.of(self.room, self.before, self.after))
        if self.simulator is not None:
            checks.instance("simulator", self.simulator, PathTracing)
            if self.simulator.room is not self.room:
                raise DataError("simulator is of another room; make it with this one")
            lacking = [p for p in self.differences.pairs if p not in self.simulator.pairs]
            if lacking:
                raise DataError(f"simulator lacks {' to '.join(lacking[0])}, which was measured")

    @property
    def sources_unstated(self) -> tuple[str, ...]:
        """The measured sources whose directivity is not stated, or unknown."""
        if self.simulator is None:
            return ()
        stated = self.simulator.directivity
        sources = dict.fromkeys(source for source, _ in self.differences.pairs)
        return tuple(s for s in sources if not isinstance(stated.get(s), Directivity))
