"""How often a verdict was right in rooms that were not used to make the finder.

The figures are those of the judging rooms of both hidden worlds, and of the measured cases
(docs/discrepancy_study.md; `benchmarks.second_world both`, `benchmarks.real_rooms`).
Rooms with T20, EDT and T30 of one configuration are counted apart. As they are stated the rooms have
several configurations, C80 or G.
"""

from __future__ import annotations

from rtcal.finder.case import Case

TIMES, ALL = "T20, EDT and T30 of one configuration", "several configurations, C80 or G"
NAMED = {TIMES: (57, 57), ALL: (79, 80)}
"""Single names that were right, and single names claimed."""
FAMILY = {TIMES: (95, 98), ALL: (149, 151)}
"""Families that were right, and families claimed."""
AMBIGUOUS = {TIMES: (182, 198), ALL: (88, 111)}
"""Sets that held the truth, and sets of candidates where nothing was claimed."""
MISSED = {TIMES: (357, 707), ALL: (374, 707)}
"""Rooms in which nothing was detected, and rooms in which something was hidden."""
FLAGGED = {TIMES: (10, 359), ALL: (6, 359)}
"""Rooms in which something was detected, and rooms in which nothing was hidden."""
MEASURED = (0, 46)
"""Wrong claims, and cases, in measured rooms."""
SET_FAMILIES = (70, 73)
"""Families that were right, and families claimed, by a search for several effects in 50 rooms with two
and 60 with one (`python -m benchmarks.several_effects table`)."""
FAMILY_SETS = (5, 8)
"""Sets of families that were right, and sets claimed, by the same search."""
_ROOMS = "In simulated rooms that were not used to make the finder,"


def data_of(case: Case) -> str:
    """Return which of the two kinds of data a case has.

    >>> import rtcal as rt
    >>> data_of(rt.datasets.hidden_room()[0])
    'several configurations, C80 or G'
    """
    first, *others = case.configurations
    return ALL if others or not {"c80", "g"}.isdisjoint(first.measured.values) else TIMES


def sentence(verdict: str, data: str) -> str:
    """Return how often such a verdict was right with such data, `TIMES` or `ALL`.

    >>> print(sentence("named", TIMES))
    In simulated rooms that were not used to make the finder, with T20, EDT and T30 of one \
configuration, 57 of 57 such names were right. In 46 measured cases none was wrong.
    """
    measured = f"In {MEASURED[1]} measured cases {MEASURED[0] or 'none'} was wrong."
    rooms = f"{_ROOMS} with {data},"
    (missed, hidden), (flagged, empty) = MISSED[data], FLAGGED[data]
    said = {
        "named": "{} of {} such names were right. " + measured,
        "family": "{} of {} such families were right. " + measured,
        "ambiguous": "{} of {} such sets held the truth.",
    }
    counts = {"named": NAMED, "family": FAMILY, "ambiguous": AMBIGUOUS}
    if verdict in said:
        return f"{rooms} {said[verdict].format(*counts[verdict][data])}"
    if verdict == "unknown":
        return f"{rooms} {flagged or 'none'} of {empty} that lacked nothing was flagged."
    return f"{rooms} {missed} of {hidden} hidden effects were not detected: this is no proof."


def of_sets(families: bool, together: bool) -> list[str]:
    """Return how often claims of sets were right: families, and sets."""
    out = []
    if families:
        right, of = SET_FAMILIES
        out.append(f"{_ROOMS} {right} of {of} such families were right.")
    if together:
        right, of = FAMILY_SETS
        out.append(f"{_ROOMS} {right} of {of} such sets of families were right.")
    return out
