"""Counts of the finder's right claims, in simulated and in measured rooms, by kind of data.

The counts are those of ``records.json``, which `python -m benchmarks.records` writes from judged rooms
that were not used to make the finder (benchmarks/studies/means and pairs).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from scipy.stats import beta

from rtcal.acoustics.observables import LEVEL
from rtcal.acoustics.room import Room
from rtcal.finder.case import LEVELS, Case
from rtcal.finder.evidence import relative_sigma

TIMES, ALL = "T20, EDT and T30 of one configuration", "several configurations, C80 or G"
"""Means over positions. As they are stated the rooms have several configurations, C80 or G."""
IN_SITU, HANDBOOK = "measured in situ", "from a handbook"
"""How a room's coefficients are stated, where positions are compared."""
WITHOUT_LEVEL, WITH_LEVEL = "without level", "with level"
FILE = "records.json"


@dataclass(frozen=True)
class Share:
    """A number of rooms, cases or claims, and of how many it is."""

    count: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends of the 95 % interval (Clopper and Pearson 1934).

        Examples
        --------
        >>> low, high = Share(0, 7).interval
        >>> print(f"{low:.2f} to {high:.2f}")
        0.00 to 0.41
        """
        k, n = self.count, self.of
        if n == 0:
            return 0.0, 1.0
        low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
        high = 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))
        return low, high

    @property
    def in_words(self) -> str:
        """The interval in percent: "0 to 41 %, 95 % interval"."""
        low, high = self.interval
        return f"{100 * low:.0f} to {100 * high:.0f} %, 95 % interval"

    def said(self, of: str, was: str) -> str:
        """Return it as a clause: "3 of 18 rooms were flagged (4 to 41 %, 95 % interval)"."""
        return f"{self.count} of {self.of} {of} {was} ({self.in_words})"

    def claimed(self, kind: str, was: str = "were right") -> str:
        """Return claims made and claims right, in a sentence without its beginning."""
        return f"{self.of} {kind} were claimed, and {self.count} {was} ({self.in_words})."


@cache
def stored() -> Mapping[str, Any]:
    """Return the contents of `FILE`."""
    text = resources.files("rtcal.finder").joinpath(FILE).read_text(encoding="utf-8")
    out: dict[str, Any] = json.loads(text)
    return out


def record_of(*kind: str) -> dict[str, Share]:
    """Return the counts in judged rooms with data of one kind: its keys in `FILE`.

    "detected" are the rooms in which something was detected, of those in which something was hidden;
    "flagged" the same of those in which nothing was. The others are claims that were right, by what is
    claimed. An "ambiguous" set is right if it holds the truth. A "surface" is the most probable one of
    an absorber that was detected, whether it was claimed or not.
    """
    table = stored()
    for key in kind:
        table = table[key]
    counts = {"detected": table["detected"], "flagged": table["flagged"], **table["right"]}
    return {what: Share(*both) for what, both in counts.items()}


def data_of(case: Case) -> str:
    """Return which of the two kinds of data a case has.

    >>> import rtcal as rt
    >>> data_of(rt.datasets.hidden_room()[0])
    'several configurations, C80 or G'
    """
    first, *others = case.configurations
    return ALL if others or not {*LEVELS}.isdisjoint(first.measured.values) else TIMES


_ROOMS = "In simulated rooms {}that were not used to make the finder"


def record_of_means(verdict: str, data: str) -> str:
    """Return how often such a verdict was right with such data, `TIMES` or `ALL`.

    >>> print(record_of_means("unknown", TIMES)[:66])
    In simulated rooms that were not used to make the finder, with T20
    """
    record, rooms = record_of("means", data), _ROOMS.format("")
    rooms += f", with {data},"
    if verdict == "unknown":
        return f"{rooms} {record['flagged'].said('rooms that lack nothing', 'were flagged')}."
    if verdict not in record:
        missed = Share(record["detected"].of - record["detected"].count, record["detected"].of)
        not_detected = missed.said("hidden effects", "were not detected")
        return f"{rooms} {not_detected}, so this is no proof that nothing is missing."
    if verdict == "ambiguous":
        return f"{rooms} {record[verdict].claimed('sets of candidates', 'held the truth')}"
    kind = {"named": "effects", "family": "families"}[verdict]
    measured = stored()["measured"]
    wrong = Share(measured["wrong"], measured["claims"])
    was = {0: "none was", 1: "1 was"}.get(wrong.count, f"{wrong.count} were")
    return (
        f"{rooms} {record[verdict].claimed(kind)} In measured rooms, by an earlier version of it, "
        f"{wrong.of} effects or families were claimed in {measured['cases']} cases, and {was} wrong "
        f"(error rate {wrong.in_words})."
    )


def record_of_several(claimed: Sequence[str]) -> str:
    """Return how often claims beside others were right: "families", "sets of families"."""
    rooms = f"{_ROOMS.format('with one or two effects ')},"
    return " ".join(
        f"{rooms} {Share(*stored()['several'][kind]).claimed(kind)}" for kind in claimed
    )


def statement_of(room: Room) -> str:
    """Return `IN_SITU` or `HANDBOOK`: which of the judged rooms a room resembles.

    By `rtcal.finder.evidence.relative_sigma`: a handbook's is 1.
    """
    return HANDBOOK if relative_sigma(room) > 0.95 else IN_SITU


def record_of_positions(room: Room, match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data."""
    stated, data = statement_of(room), WITH_LEVEL if LEVEL.key in match else WITHOUT_LEVEL
    record = record_of("positions", stated, data)
    surface = record["surface"]
    return (
        f"{_ROOMS.format(f'with coefficients {stated} ')}, by an earlier version of it, "
        f"{record['detected'].said('hidden effects', 'were detected')}, and "
        f"{record['flagged'].said('rooms that lack nothing', 'were flagged')}. "
        f"{record['family'].claimed('effects or families')} "
        f"{record['surface claimed'].claimed('surfaces')} Of {surface.of} absorbers that "
        f"were detected, {surface.count} are on the most probable surface ({surface.in_words})."
    )
