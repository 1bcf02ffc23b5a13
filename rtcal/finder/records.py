"""Counts of the finder's right claims, in simulated and in measured rooms, by kind of data.

The counts are those of ``records.json``, which `python -m benchmarks.records` writes from judged rooms
that were not used to make the finder (benchmarks/studies/means and pairs).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from scipy.special import betaincinv

from rtcal.acoustics.room import Room
from rtcal.finder.case import Case
from rtcal.finder.evidence import relative_sigma
from rtcal.finder.model import LEVELS

TIMES, ALL = "T20, EDT and T30 of one configuration", "several configurations, C80 or G"
RUN = "a simulation by another program"
"""Means over positions. As they are stated the rooms have several configurations, C80 or G."""
IN_SITU, HANDBOOK = "measured in situ", "from a handbook"
"""How a room's coefficients are stated, where positions are compared."""
WITHOUT_LEVEL, WITH_LEVEL = "without level", "with level"
FILE = "records.json"


@dataclass(frozen=True)
class Share:
    """A number of rooms, cases or findings, and the total from which it is counted."""

    count: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval of the share (Clopper and Pearson 1934).

        Examples
        --------
        >>> low, high = Share(0, 7).interval
        >>> print(f"{low:.2f} to {high:.2f}")
        0.00 to 0.41
        """
        k, n = self.count, self.of
        if n == 0:
            return 0.0, 1.0
        low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, 0.025))
        high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 0.975))
        return low, high


@cache
def stored() -> Mapping[str, Any]:
    """Return the contents of `FILE`."""
    text = resources.files("rtcal.finder").joinpath(FILE).read_text(encoding="utf-8")
    out: dict[str, Any] = json.loads(text)
    return out


def record_of(*kind: str) -> dict[str, Share]:
    """Return how often findings from one kind of data were right, in rooms with known answers.

    "ambiguous" is right if the true effect is among the candidates; "surface" is the most probable
    surface of a detected absorber.
    """
    table = stored()
    for key in kind:
        table = table[key]
    counts = {"detected": table["detected"], "flagged": table["flagged"], **table["right"]}
    return {what: Share(*both) for what, both in counts.items()}


def data_of(case: Case) -> str:
    """Return the name of the kind of data that a case has, as the records of right answers use it.

    >>> import rtcal as rt
    >>> data_of(rt.datasets.hidden_room()[0])
    'several configurations, C80 or G'
    """
    if case.has_run:
        return RUN
    first, *others = case.configurations
    return ALL if others or not {*LEVELS}.isdisjoint(first.measured.values) else TIMES


def statement_of(room: Room) -> str:
    """Return "from a handbook" or "measured in situ", as a room's input sigma suggests."""
    return HANDBOOK if relative_sigma(room) > 0.95 else IN_SITU
