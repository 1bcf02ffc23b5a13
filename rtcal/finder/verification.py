"""Whether the gap shrinks with what was found in the model, whatever was observed."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from scipy import stats

from rtcal.finder.finding import Finding
from rtcal.support.results import Result

_CONFIDENCE = 0.95
"""Of a gap over pairs that is said to shrink or to grow: one-sided, by Student's t."""


def verdict_of(gain: float, uncertainty: float, n_pairs: int) -> str:
    """Return the verdict on a gap that shrinks by ``gain``, with its standard error over the pairs.

    >>> verdict_of(0.5, 0.1, 8), verdict_of(0.1, 0.1, 8), verdict_of(-0.5, 0.1, 8)
    ('supported', 'unproven', 'withdrawn')
    """
    if abs(gain) <= uncertainty * float(stats.t.ppf(_CONFIDENCE, n_pairs - 1)):
        return "unproven"
    return "supported" if gain > 0 else "withdrawn"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Verification(Result):
    """The gap with and without what was found: `MeansVerification` or `PositionsVerification`.

    Attributes
    ----------
    finding : Finding
    """

    finding: Finding

    @property
    @abstractmethod
    def verdict(self) -> str:
        """``supported``: the gap shrinks by more than its uncertainty; ``withdrawn``: it grows.

        ``unproven``: it changes by less, or nothing was measured that tells.
        """

    @property
    @abstractmethod
    def sentence(self) -> str:
        """What became of the gap, in words; the verdict first."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "finding": self.finding.to_dict(),
        }
