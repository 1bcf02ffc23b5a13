"""What a search says, whatever was observed: whether something is missing, verdict, probabilities."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rtcal.finder.effects import Effect
from rtcal.support.arguments import checked
from rtcal.support.results import Result


@dataclass(frozen=True)
class Detection:
    """Evidence in nats that something is other than stated, whatever it is.

    Attributes
    ----------
    score : float
    threshold : float
        Score that few rooms exceed in which nothing is other than stated.
    noise : float or None
        Of positions, that a single pair is noisier than assumed and nothing else is other; None where
        that was not tried.
    means : float or None
        Of means over positions, where positions decide; None where they were not asked.
    """

    score: float
    threshold: float
    noise: float | None = None
    means: float | None = None

    @property
    def verdict(self) -> str | None:
        """What is said where nothing is detected, "none" or "hint"; None where something is."""
        if self.score > self.threshold:
            return None
        return "hint" if max(self.score, self.noise or 0.0) > 0 else "none"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding(Result):
    """What a search found: `MeansFinding` of means, `PositionsFinding` of every position.

    Attributes
    ----------
    verdict : {"none", "hint", "named", "family", "ambiguous", "unknown"}
        ``named``: an effect whose probability is at least 0.9, and that passes every check.
        ``family``: a family of that probability, but no member, or one with a doubt about its size or
        fit. ``ambiguous``: something is missing, and effects of several families explain it.
        ``unknown``: the model lacks something that no effect of the library explains. ``hint``: the
        score does not exceed the threshold but is above 0, or a check has failed (``reasons``).
    family : str or None
        The family whose probability is at least 0.9.
    probabilities : mapping of str to float
        Of "none", "coefficients", "unknown" and each effect, the most probable first.
    families : mapping of str to float
        The same of each family. "added absorption" has the families whose names begin with it.
    detection : Detection
        The evidence that something is other than stated, and its threshold.
    reasons : tuple of str
        Why what is most probable is not claimed, or not by its name.
    notes : tuple of str
        What was dropped and assumed, and reasons to doubt the result, whatever it is.
    effects : mapping of str to Effect
        The effects that were tried, by name.
    """

    verdict: str
    family: str | None
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    detection: Detection
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    effects: Mapping[str, Effect]

    @property
    def score(self) -> float:
        """The evidence in nats that must exceed the ``threshold``."""
        return self.detection.score

    @property
    def threshold(self) -> float:
        """Score that few rooms exceed in which nothing is other than stated."""
        return self.detection.threshold

    @property
    def detected(self) -> bool:
        """Whether something is other than stated, whatever it is."""
        return self.verdict not in ("none", "hint")

    @property
    @abstractmethod
    def can_be_added(self) -> bool:
        """Whether ``apply`` has something to add."""

    @property
    @abstractmethod
    def can_be_verified(self) -> bool:
        """Whether `rtcal.finder.verify` can compare the gap with and without what was found."""

    @property
    @abstractmethod
    def reason_for_none(self) -> str | None:
        """Why there is nothing to add, in words; None where there is something."""

    @property
    @abstractmethod
    def headline(self) -> str:
        """The verdict in a sentence or two."""

    @checked
    def percent(self, name: str) -> str:
        """The probability of an effect, or of "none", in percent."""
        return f"{100 * self.probabilities.get(name, 0.0):.0f} %"

    @property
    def _scored(self) -> str:
        return f"{self.score:+.1f} nats, threshold {self.threshold:.1f}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "verdict": self.verdict,
            "family": self.family,
            "probabilities": dict(self.probabilities),
            "families": dict(self.families),
            "score": self.score,
            "threshold": self.threshold,
            "reasons": list(self.reasons),
            "notes": list(self.notes),
        }
