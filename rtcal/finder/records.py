"""Counts of the finder's right claims, in simulated and in measured rooms, by kind of data.

The counts are those of ``records.json``, which `python -m benchmarks.records` writes from judged rooms
that were not used to make the finder (docs/discrepancy_study.md, docs/where_study.md).
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
from rtcal.finder.prior import relative_sigma

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


@dataclass(frozen=True)
class TrackRecord:
    """Counts in judged rooms with data of one kind.

    Attributes
    ----------
    detected : Share
        Rooms in which something was detected, of the rooms in which something was hidden.
    flagged : Share
        Rooms in which something was detected, of the rooms in which nothing was hidden.
    right : mapping of str to Share
        By what is claimed, claims that were right, of the claims. An "ambiguous" set is right if it
        holds the truth. A "surface" is the most probable one of an absorber that was detected, whether
        it was claimed or not.
    """

    detected: Share
    flagged: Share
    right: Mapping[str, Share]

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrackRecord:
        """Return the record of plain values, as `FILE` has them."""
        return cls(
            Share(*data["detected"]),
            Share(*data["flagged"]),
            {claimed: Share(*counts) for claimed, counts in data["right"].items()},
        )


@cache
def stored() -> Mapping[str, Any]:
    """Return the contents of `FILE`."""
    text = resources.files("rtcal.finder").joinpath(FILE).read_text(encoding="utf-8")
    out: dict[str, Any] = json.loads(text)
    return out


def data_of(case: Case) -> str:
    """Return which of the two kinds of data a case has.

    >>> import rtcal as rt
    >>> data_of(rt.datasets.hidden_room()[0])
    'several configurations, C80 or G'
    """
    first, *others = case.configurations
    return ALL if others or not {*LEVELS}.isdisjoint(first.measured.values) else TIMES


def record_of_means(verdict: str, data: str) -> str:
    """Return how often such a verdict was right with such data, `TIMES` or `ALL`.

    >>> print(record_of_means("unknown", TIMES))
    In simulated rooms that were not used to make the finder, by an earlier version of it with \
T20, EDT and T30 of one configuration, 10 of 359 rooms that lack nothing were flagged (1 to 5 %, 95 % \
interval).
    """
    record = TrackRecord.from_dict(stored()["means"][data])
    rooms = (
        "In simulated rooms that were not used to make the finder, by an earlier version of it with "
        f"{data},"
    )
    if verdict == "unknown":
        flagged = record.flagged
        return (
            f"{rooms} {flagged.count} of {flagged.of} rooms that lack nothing were flagged "
            f"({flagged.in_words})."
        )
    if verdict not in record.right:
        missed = Share(record.detected.of - record.detected.count, record.detected.of)
        return (
            f"{rooms} {missed.count} of {missed.of} hidden effects were not detected "
            f"({missed.in_words}), so this is no proof that nothing is missing."
        )
    right = record.right[verdict]
    if verdict == "ambiguous":
        return f"{rooms} {_given(right, 'sets of candidates', 'held the truth')}"
    kind = {"named": "effects", "family": "families"}[verdict]
    return f"{rooms} {_given(right, kind, 'were right')} {_in_measured_rooms()}"


def _given(right: Share, kind: str, was: str) -> str:
    """Return claims made, claims right, and the interval, in a sentence without its beginning."""
    return f"{right.of} {kind} were claimed, and {right.count} {was} ({right.in_words})."


def _in_measured_rooms() -> str:
    """Return how many claims were made in measured rooms, and how many of them were wrong."""
    measured = stored()["measured"]
    wrong = Share(measured["wrong"], measured["claims"])
    number = (
        "none was" if wrong.count == 0 else f"{wrong.count} {'was' if wrong.count == 1 else 'were'}"
    )
    return (
        f"In measured rooms, {wrong.of} effects or families were claimed in {measured['cases']} cases, "
        f"and {number} wrong (error rate {wrong.in_words})."
    )


def record_of_several(claimed: Sequence[str]) -> str:
    """Return how often claims beside others were right: "families", "sets of families"."""
    rooms = (
        "In simulated rooms with one or two effects that were not used to make the finder, by an "
        "earlier version of it,"
    )
    said = [f"{rooms} {_given(Share(*stored()['several'][k]), k, 'were right')}" for k in claimed]
    return " ".join(said)


def statement_of(room: Room) -> str:
    """Return `IN_SITU` or `HANDBOOK`: which of the judged rooms a room resembles.

    By `rtcal.finder.prior.relative_sigma`: a handbook's is 1.
    """
    return HANDBOOK if relative_sigma(room) > 0.95 else IN_SITU


def record_of_positions(room: Room, match: Sequence[str]) -> str:
    """Return how often hidden effects were detected and empty rooms flagged, with such data."""
    stated, data = statement_of(room), WITH_LEVEL if LEVEL.key in match else WITHOUT_LEVEL
    record = TrackRecord.from_dict(stored()["positions"][stated][data])
    right = record.right
    return (
        f"In simulated rooms with coefficients {stated} that were not used to make the finder, "
        f"{record.detected.count} of {record.detected.of} hidden effects were detected "
        f"({record.detected.in_words}), and {record.flagged.count} of {record.flagged.of} rooms that "
        f"lack nothing were flagged ({record.flagged.in_words}). "
        f"{_given(right['family'], 'effects or families', 'were right')} "
        f"{_given(right['surface claimed'], 'surfaces', 'were right')} Of {right['surface'].of} "
        f"absorbers that were detected, {right['surface'].count} are on the most probable surface "
        f"({right['surface'].in_words})."
    )
