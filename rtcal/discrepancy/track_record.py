"""How often a verdict was right in rooms that were not used to make the finder.

The figures are those of the judging rooms of both hidden worlds, with T20, EDT and T30, and of the
measured cases (docs/discrepancy_study.md; `python -m benchmarks.second_world both`,
`python -m benchmarks.real_rooms`).
"""

from __future__ import annotations

NAMED = (57, 57)
"""Single names that were right, and single names claimed."""
FAMILY = (95, 98)
"""Families that were right, and families claimed."""
AMBIGUOUS = (182, 198)
"""Sets that held the truth, and sets of candidates where nothing was claimed."""
MISSED = (357, 707)
"""Rooms in which nothing was detected, and rooms in which something was hidden."""
FLAGGED = (10, 359)
"""Rooms in which something was detected, and rooms in which nothing was hidden."""
MEASURED = (0, 46)
"""Wrong claims, and cases, in measured rooms."""
SET_FAMILIES = (70, 73)
"""Families that were right, and families claimed, by a search for several effects in 50 rooms with two
and 60 with one (`python -m benchmarks.several_effects table`)."""
FAMILY_SETS = (5, 8)
"""Sets of families that were right, and sets claimed, by the same search."""
_ROOMS = "In simulated rooms that were not used to make the finder,"


def sentence(verdict: str) -> str:
    """Return how often such a verdict was right; "" where nothing was counted.

    >>> sentence("named")[:48]
    'In simulated rooms that were not used to make th'
    """
    measured = f"In {MEASURED[1]} measured cases {MEASURED[0] or 'none'} was wrong."
    missed = (
        f"{_ROOMS} {MISSED[0]} of {MISSED[1]} hidden effects were not detected: this is no proof."
    )
    return {
        "none": missed,
        "hint": missed,
        "named": f"{_ROOMS} {NAMED[0]} of {NAMED[1]} such names were right. {measured}",
        "family": f"{_ROOMS} {FAMILY[0]} of {FAMILY[1]} such families were right. {measured}",
        "ambiguous": f"{_ROOMS} {AMBIGUOUS[0]} of {AMBIGUOUS[1]} such sets held the truth.",
        "unknown": f"{_ROOMS} {FLAGGED[0] or 'none'} of {FLAGGED[1]} that lacked nothing was flagged.",
    }[verdict]


def of_sets(families: bool, together: bool) -> list[str]:
    """Return how often claims of `rtcal.discrepancy.find_several` were right: families, and sets."""
    out = []
    if families:
        right, of = SET_FAMILIES
        out.append(f"{_ROOMS} {right} of {of} such families were right.")
    if together:
        right, of = FAMILY_SETS
        out.append(f"{_ROOMS} {right} of {of} such sets of families were right.")
    return out
