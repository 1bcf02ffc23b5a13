"""How often the finder with a geometry was right in rooms that were not used to make it.

The figures are those of docs/where_study.md (`python -m benchmarks.where table`).
"""

from __future__ import annotations

from collections.abc import Sequence

DETECTED = {"without level": (3, 17), "with level": (4, 17)}
"""Rooms in which something was detected, and rooms in which something was hidden."""
FLAGGED = {"without level": (3, 13), "with level": (2, 13)}
"""Rooms in which something was detected, and rooms in which nothing was hidden."""


def sentence(match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data.

    >>> sentence(["t20", "edt"])[:45]
    'In simulated rooms that were not used to make'
    """
    data = "with level" if "level" in match else "without level"
    detected, flagged = DETECTED[data], FLAGGED[data]
    return (
        "In simulated rooms that were not used to make this finder, it detected "
        f"{detected[0]} of {detected[1]} hidden effects, and flagged {flagged[0]} of {flagged[1]} "
        "rooms that lacked nothing: take a finding as a place to look at."
    )
