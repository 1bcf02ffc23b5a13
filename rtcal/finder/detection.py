"""Whether something is missing at all: the evidence of it, and the threshold that it must exceed."""

from __future__ import annotations

from dataclasses import dataclass


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
