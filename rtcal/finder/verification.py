"""Whether the gap shrinks with what was found in the model, whatever was observed."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from rtcal.finder.finding import Finding
from rtcal.support.results import Result


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
