"""How often the finder with a geometry was right in rooms that were not used to make it.

The figures are those of docs/where_study.md: in situ `python -m benchmarks.where table`, from a
handbook `python -m benchmarks.where table --rooms first`.
"""

from __future__ import annotations

from collections.abc import Sequence

from rtcal.acoustics.observables import LEVEL
from rtcal.acoustics.room import Room
from rtcal.finder.positions.prior import HANDBOOK, IN_SITU, statement

DETECTED = {
    IN_SITU: {"without level": (12, 44), "with level": (15, 44)},
    HANDBOOK: {"without level": (2, 12), "with level": (3, 12)},
}
"""Rooms in which something was detected, and rooms in which something was hidden."""
FLAGGED = {
    IN_SITU: {"without level": (0, 29), "with level": (0, 29)},
    HANDBOOK: {"without level": (1, 8), "with level": (1, 8)},
}
"""Rooms in which something was detected, and rooms in which nothing was hidden."""
SURFACE = {
    IN_SITU: {"without level": (6, 11), "with level": (11, 13)},
    HANDBOOK: {"without level": (2, 2), "with level": (2, 3)},
}
"""Rooms in which the most probable surface was right, and rooms with an absorber detected."""
PATHS = 6000
"""Paths from each source in all of these rooms."""
JUDGED = {IN_SITU: "it", HANDBOOK: "an earlier version of it"}
"""What was judged in rooms of each kind."""


def sentence(room: Room, match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data."""
    data = "with level" if LEVEL.key in match else "without level"
    stated = statement(room)
    detected, flagged = DETECTED[stated][data], FLAGGED[stated][data]
    right = SURFACE[stated][data]
    return (
        f"In simulated rooms with coefficients {stated} that were not used to make this finder, "
        f"{JUDGED[stated]} detected {detected[0]} of {detected[1]} hidden effects, flagged "
        f"{flagged[0]} of {flagged[1]} rooms that lacked nothing, and put {right[0]} of {right[1]} "
        f"absorbers that it detected on the correct surface. It traced {PATHS} paths from each source."
    )
