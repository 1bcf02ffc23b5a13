"""How often the finder with a geometry was right in rooms that were not used to make it.

The figures are those of docs/where_study.md (`python -m benchmarks.where table`).
"""

from __future__ import annotations

from collections.abc import Sequence

from rtcal.acoustics.room import Room
from rtcal.where.prior import HANDBOOK, IN_SITU, statement

DETECTED = {
    IN_SITU: {"without level": (0, 1), "with level": (0, 1)},
    HANDBOOK: {"without level": (3, 17), "with level": (4, 17)},
}
"""Rooms in which something was detected, and rooms in which something was hidden."""
FLAGGED = {
    IN_SITU: {"without level": (0, 1), "with level": (0, 1)},
    HANDBOOK: {"without level": (3, 13), "with level": (2, 13)},
}
"""Rooms in which something was detected, and rooms in which nothing was hidden."""
SURFACE = {
    IN_SITU: {"without level": (0, 1), "with level": (0, 1)},
    HANDBOOK: {"without level": (1, 3), "with level": (2, 4)},
}
"""Rooms in which the most probable surface was right, and rooms with an absorber detected."""


def sentence(room: Room, match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data."""
    data = "with level" if "level" in match else "without level"
    stated = statement(room)
    detected, flagged = DETECTED[stated][data], FLAGGED[stated][data]
    right = SURFACE[stated][data]
    return (
        f"In simulated rooms with coefficients {stated} that were not used to make this finder, it "
        f"detected {detected[0]} of {detected[1]} hidden effects, flagged {flagged[0]} of "
        f"{flagged[1]} rooms that lacked nothing, and put {right[0]} of {right[1]} absorbers that it "
        "detected on the right surface."
    )
