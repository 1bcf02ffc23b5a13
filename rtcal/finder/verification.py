"""Whether the gap shrinks with what was found in the model, whatever was observed."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from rtcal.errors import DataError
from rtcal.finder.finding import LEAST_PAIRS, Finding
from rtcal.support.results import Result
from rtcal.support.types import Array

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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class HeldOutVerification(Verification):
    """Gaps at pairs that were not fitted: half of the pairs finds it again and predicts the others."""

    @property
    @abstractmethod
    def gains(self) -> Array:
        """By how much each pair's mean absolute gap shrinks, (n_seeds, n_pairs), in JND."""

    @property
    def gain(self) -> float:
        """By how much the mean absolute gap shrinks with what was found, in JND."""
        return float(self.gains.mean())

    @property
    def uncertainty(self) -> float:
        """Standard error of the gain over pairs and, of two seeds and more, over seeds, in JND."""
        gains = self.gains
        n_seeds, n_pairs = gains.shape
        of_pairs = gains.mean(axis=0).std(ddof=1) / np.sqrt(n_pairs)
        of_seeds = gains.mean(axis=1).std(ddof=1) / np.sqrt(n_seeds) if n_seeds > 1 else 0.0
        return float(np.hypot(of_pairs, of_seeds))

    @property
    def verdict(self) -> str:
        """``supported``, ``unproven`` or ``withdrawn``: the gap shrinks, hardly changes, or grows.

        By more than its uncertainty, one-sided, by Student's t over the pairs (`verdict_of`).
        """
        return verdict_of(self.gain, self.uncertainty, self.gains.shape[1])


def check_pairs(pairs: Sequence[object]) -> None:
    """Raise DataError for fewer than `LEAST_PAIRS` pairs."""
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"there are {len(pairs)} pairs; {LEAST_PAIRS} are needed, half of which predict the others"
        )
