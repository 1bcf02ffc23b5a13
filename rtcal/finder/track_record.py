"""The track record: how often answers were right in rooms not used to make the finder.

The figures of means over positions are those of the judging rooms of both hidden worlds, and of the
measured cases (docs/discrepancy_study.md; `benchmarks.second_world both`, `benchmarks.real_rooms`,
`benchmarks.several_effects table`). Those of positions are of docs/where_study.md: in situ
`python -m benchmarks.where table`, from a handbook `python -m benchmarks.where table --rooms first`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rtcal.acoustics.observables import LEVEL
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import HANDBOOK_SIGMA
from rtcal.finder.case import Case
from rtcal.finder.configuration import LEVELS

TIMES, ALL = "T20, EDT and T30 of one configuration", "several configurations, C80 or G"
"""Means over positions. As they are stated the rooms have several configurations, C80 or G."""
IN_SITU, HANDBOOK = "measured in situ", "from a handbook"
"""How a room's coefficients are stated, where positions are compared."""
WITHOUT_LEVEL, WITH_LEVEL = "without level", "with level"
PATHS, LATER_PATHS = 6000, 8000
"""Paths from each source in the rooms of `POSITIONS` and of `LATER`."""
_ROOMS = "In simulated rooms that were not used to make the finder,"
Share = tuple[int, int]
"""A number of rooms, cases or claims, and of how many it is."""


@dataclass(frozen=True)
class TrackRecord:
    """Counts in judged rooms with data of one kind.

    Attributes
    ----------
    detected : (int, int)
        Rooms in which something was detected, and rooms in which something was hidden.
    flagged : (int, int)
        Rooms in which something was detected, and rooms in which nothing was hidden.
    right : mapping of str to (int, int)
        By what is claimed, claims that were right, and claims. An "ambiguous" set is right if it holds
        the truth, a "surface" if the absorber that was detected is on it.
    """

    detected: Share
    flagged: Share
    right: Mapping[str, Share]


MEANS = {
    TIMES: TrackRecord(
        detected=(350, 707),
        flagged=(10, 359),
        right={"named": (57, 57), "family": (95, 98), "ambiguous": (182, 198)},
    ),
    ALL: TrackRecord(
        detected=(333, 707),
        flagged=(6, 359),
        right={"named": (79, 80), "family": (149, 151), "ambiguous": (88, 111)},
    ),
}
"""Of a search for one effect by means over positions, by data."""
MEASURED = (0, 46)
"""Wrong claims, and cases, in measured rooms."""
SEVERAL = {"families": (70, 73), "sets of families": (5, 8)}
"""Claims that were right, and claims, of a search for several effects by means, in 50 rooms with two
effects and 60 with one."""
POSITIONS = {
    (IN_SITU, WITHOUT_LEVEL): TrackRecord((12, 44), (0, 29), {"surface": (6, 11)}),
    (IN_SITU, WITH_LEVEL): TrackRecord((15, 44), (0, 29), {"surface": (11, 13)}),
    (HANDBOOK, WITHOUT_LEVEL): TrackRecord((2, 12), (1, 8), {"surface": (2, 2)}),
    (HANDBOOK, WITH_LEVEL): TrackRecord((3, 12), (1, 8), {"surface": (2, 3)}),
}
"""Of a search at every position, by the coefficients' source and by data."""
LATER = {
    WITHOUT_LEVEL: TrackRecord((5, 9), (0, 6), {"surface": (3, 5)}),
    WITH_LEVEL: TrackRecord((5, 9), (0, 6), {"surface": (4, 5)}),
}
"""Of a later version of that search in fewer rooms measured in situ, by data."""


def data_of(case: Case) -> str:
    """Return which of the two kinds of data a case has.

    >>> import rtcal as rt
    >>> data_of(rt.datasets.hidden_room()[0])
    'several configurations, C80 or G'
    """
    first, *others = case.configurations
    return ALL if others or not {*LEVELS}.isdisjoint(first.measured.values) else TIMES


def of_means(verdict: str, data: str) -> str:
    """Return how often such a verdict was right with such data, `TIMES` or `ALL`.

    >>> print(of_means("named", TIMES))
    In simulated rooms that were not used to make the finder, with T20, EDT and T30 of one \
configuration, 57 of 57 such names were right. In 46 measured cases none was wrong.
    """
    record, rooms = MEANS[data], f"{_ROOMS} with {data},"
    if verdict == "unknown":
        flagged, empty = record.flagged
        return f"{rooms} {flagged or 'none'} of {empty} that lacked nothing was flagged."
    if verdict not in record.right:
        detected, hidden = record.detected
        missed = hidden - detected
        return f"{rooms} {missed} of {hidden} hidden effects were not detected: this is no proof."
    right, of = record.right[verdict]
    if verdict == "ambiguous":
        return f"{rooms} {right} of {of} such sets held the truth."
    names = "names" if verdict == "named" else "families"
    measured = f"In {MEASURED[1]} measured cases {MEASURED[0] or 'none'} was wrong."
    return f"{rooms} {right} of {of} such {names} were right. {measured}"


def of_several(claimed: Sequence[str]) -> str:
    """Return how often claims beside others were right, of the kinds in `SEVERAL`."""
    said = [f"{_ROOMS} {SEVERAL[k][0]} of {SEVERAL[k][1]} such {k} were right." for k in claimed]
    return " ".join(said)


def statement(room: Room) -> str:
    """Return `IN_SITU` or `HANDBOOK`: which of the judged rooms a room resembles.

    By the mean sigma over the mean alpha, weighted by area: a handbook's is `HANDBOOK_SIGMA`.
    """
    relative = float((room.areas @ room.sigma).sum() / (room.areas @ room.alpha).sum())
    return HANDBOOK if relative > 0.95 * HANDBOOK_SIGMA else IN_SITU


def of_positions(room: Room, match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data."""
    stated, data = statement(room), WITH_LEVEL if LEVEL.key in match else WITHOUT_LEVEL
    record = POSITIONS[stated, data]
    right = record.right["surface"]
    said = (
        f"In simulated rooms with coefficients {stated} that were not used to make this finder, an "
        f"earlier version of it detected {record.detected[0]} of {record.detected[1]} hidden "
        f"effects, flagged {record.flagged[0]} of {record.flagged[1]} rooms that lacked nothing, and "
        f"put {right[0]} of {right[1]} absorbers that it detected on the correct surface. It traced "
        f"{PATHS} paths from each source."
    )
    if stated == HANDBOOK:
        return said
    later = LATER[data]
    return (
        f"{said} A later one, with {LATER_PATHS}, detected {later.detected[0]} of {later.detected[1]}, "
        f"flagged {later.flagged[0]} of {later.flagged[1]}, and put {later.right['surface'][0]} of "
        f"{later.right['surface'][1]} there."
    )
