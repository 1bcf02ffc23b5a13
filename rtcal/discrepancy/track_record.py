"""How often a verdict was right in rooms that were not used to make the finder.

The figures are those of the judging rooms of both hidden worlds, with T20, EDT and T30, and of the
measured cases (docs/discrepancy_study.md; `python -m benchmarks.second_world table`,
`python -m benchmarks.real_rooms`).
"""

from __future__ import annotations

NAMED = (17, 17)
"""Single names that were right, and single names claimed."""
FAMILY = (18, 18)
"""Families that were right, and families claimed."""
AMBIGUOUS = (38, 41)
"""Sets that held the truth, and sets of candidates where nothing was claimed."""
MISSED = (134, 210)
"""Rooms in which nothing was detected, and rooms in which something was hidden."""
FLAGGED = (0, 104)
"""Rooms in which something was detected, and rooms in which nothing was hidden."""
MEASURED = (0, 46)
"""Wrong claims, and cases, in measured rooms."""


def sentence(verdict: str) -> str:
    """Return how often such a verdict was right; "" where nothing was counted.

    >>> sentence("named")[:48]
    'In simulated rooms that were not used to make th'
    """
    rooms = "In simulated rooms that were not used to make the finder,"
    measured = f"In {MEASURED[1]} measured cases {MEASURED[0] or 'none'} was wrong."
    missed = (
        f"{rooms} {MISSED[0]} of {MISSED[1]} hidden effects were not detected: this is no proof."
    )
    return {
        "none": missed,
        "hint": missed,
        "named": f"{rooms} {NAMED[0]} of {NAMED[1]} such names were right. {measured}",
        "family": f"{rooms} {FAMILY[0]} of {FAMILY[1]} such families were right. {measured}",
        "ambiguous": f"{rooms} {AMBIGUOUS[0]} of {AMBIGUOUS[1]} such sets held the truth.",
        "unknown": f"{rooms} {FLAGGED[0] or 'none'} of {FLAGGED[1]} that lacked nothing was flagged.",
    }[verdict]
