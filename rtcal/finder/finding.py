"""An effect that explains the data, and the base of what a search returns."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.effects import CoupledRoom, Effect
from rtcal.support import blocks
from rtcal.support.blocks import Block
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

End = Literal["", "least", "most"]
"""At which end of what is tried the data allow any size."""


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a size with its unit and its 90 % interval; a ratio as so many times.

    Examples
    --------
    >>> amount(2.0, "of the stated area"), amount(12.3, "m²", (8.0, 17.0))
    ('2 times the stated area', '12.3 m² (90 %: 8 to 17)')
    >>> amount(0.875, "of its area covered", (0.47, 1.0))
    '0.875 of its area covered (90 %: 0.47 to 1)'
    """
    times = unit.replace("of the stated ", "times the stated ")
    ends = "" if interval is None else f" (90 %: {interval[0]:.3g} to {interval[1]:.3g})"
    return f"{value:.3g} {times}{ends}"


@dataclass(frozen=True)
class Size:
    """Size of an effect: mean and 90 % interval, in ``unit``.

    ``end`` is "least" where the data allow any size above ``low``, "most" where they allow any below
    ``high``: the evidence does not fall within what is tried, and physics does not end there.
    """

    mean: float
    low: float
    high: float
    unit: str
    end: End = ""

    @property
    def words(self) -> str:
        """The size with its interval.

        Examples
        --------
        >>> Size(12.3, 8.0, 17.0, "m²").words
        '12.3 m² (90 %: 8 to 17)'
        >>> Size(61.0, 26.0, 109.0, "m²", "least").words
        'at least 26 m² (95 %)'
        """
        if self.end:
            value = self.low if self.end == "least" else self.high
            return f"at {self.end} {amount(value, self.unit)} (95 %)"
        return amount(self.mean, self.unit, (self.low, self.high))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        ends = {name: json_numbers(getattr(self, name)) for name in ("mean", "low", "high")}
        return {**vars(self), **ends, "end": self.end or None}


Point = tuple[float, float, float]
LOCATED = 0.5
"""Share of a candidate's probability from which a part of its surface is where it stands."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect that explains the data, of positions in one place.

    Attributes
    ----------
    effect, family : str
    surface : str or None
        None for the whole room, the measurement, and of means over positions.
    place : str
        The surface's name; of the measurement's errors "receiver R1", "source S1" or "S1 to R1"; "" for
        the whole room.
    probability : float
    size, low, high : float
        Posterior mean and 90 % interval, in ``unit``; NaN for coefficients off together and for
        "unknown".
    unit, end : str, as of a `Size`
    parameters : mapping of str to float
        The most probable ones.
    spectrum : array (n_bands,) or (0,)
        Posterior mean alpha of what stands on the surface.
    parts : tuple of (middle, probability)
        Of a large surface: the middle (x, y, z) of each part in m, and the probability that it stands
        on this part alone. With the rest of its probability it is spread over the surface.
    """

    effect: str
    family: str
    probability: float
    surface: str | None = None
    place: str = ""
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    end: End = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    spectrum: Array = field(default_factory=lambda: np.zeros(0))
    parts: tuple[tuple[Point, float], ...] = ()

    @property
    def middle(self) -> Point | None:
        """Middle in m of the part that holds at least half of the probability; None without one."""
        middle, probability = max(self.parts, key=lambda part: part[1], default=(None, 0.0))
        return middle if probability >= LOCATED * self.probability else None

    @property
    def about(self) -> str:
        """The middle in words; "" without one."""
        if self.middle is None:
            return ""
        return f", most probably about ({', '.join(f'{x:.1f}' for x in self.middle)}) m"

    @property
    def title(self) -> str:
        """Effect and place, as a sentence names them."""
        if self.surface is not None:
            return f'{self.effect} on "{self.surface}"'
        return f"{self.effect} of {self.place}" if self.place else self.effect

    @property
    def can_be_added(self) -> bool:
        """Whether it stands on a surface and a room of one geometry can have it."""
        return self.surface is not None and self.effect != CoupledRoom.name

    @property
    def in_words(self) -> str:
        """Size with its interval; "" where there is none."""
        if not np.isfinite(self.size):
            return ""
        return Size(self.size, self.low, self.high, self.unit, self.end).words

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            **{k: v for k, v in vars(self).items() if k not in _CONVERTED},
            **{k: json_numbers(getattr(self, k)) for k in ("size", "low", "high")},
            "parameters": dict(self.parameters),
            "spectrum": json_numbers(self.spectrum),
            "parts": [{"middle": list(m), "probability": p} for m, p in self.parts],
        }


_CONVERTED = ("size", "low", "high", "spectrum", "parameters", "parts")


LEAST_ADDED = 0.3
"""Probability below which ``apply`` adds an effect only where it is stated by its name. Of first
candidates with less 9 of 41 were right."""
_NOTHING = 0.1
"""Probability that nothing is other than stated, from which a verdict says it first."""
NATS = "2.3 nats are odds of ten to one"
LEAST_PAIRS = 4
"""Fewest pairs of a verification at held-out pairs: half of them have to find it again."""


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
    parts : mapping of str to Detection
        Of means over positions, the same from a part of the data, by what it is: what a part detects is
        detected. The score and threshold above are those of all data.

    Raises
    ------
    ModelError
        For a score that is no finite number.
    """

    score: float
    threshold: float
    noise: float | None = None
    means: float | None = None
    parts: Mapping[str, Detection] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("score", "noise", "means"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ModelError(
                    f"the evidence that something is other than stated ({name}) is {value} nats, no "
                    "finite number: the errors of the model or of the measurement cannot be weighed"
                )

    @property
    def deciding(self) -> str | None:
        """The part of the data that detects most where all data detect nothing; None without one."""
        excess = {words: part.score - part.threshold for words, part in self.parts.items()}
        most = max(excess, key=lambda words: excess[words], default="")
        return most if self.score <= self.threshold and excess.get(most, 0.0) > 0 else None

    @property
    def verdict(self) -> str | None:
        """The verdict where nothing is detected, "none" or "hint"; None where something is."""
        if self.score > self.threshold or self.deciding is not None:
            return None
        return "hint" if max(self.score, self.noise or 0.0) > 0 else "none"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding(Result):
    """The result of a search: `MeansFinding` of means, `PositionsFinding` of every position.

    Attributes
    ----------
    verdict : {"none", "hint", "named", "family", "ambiguous", "unknown"}
        ``named``: an effect whose probability is at least 0.9, and that passes every check.
        ``family``: a family of that probability, but no member, or one with a doubt about its size or
        fit. ``ambiguous``: something is missing, and effects of several families explain it.
        ``unknown``: the model lacks something that no effect of the library explains. ``hint``: the
        score does not exceed the threshold but is above 0, nothing missing has a third of the
        probability, no effect and no family has (both of means over positions), or a check has failed
        (``reasons``).
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
    candidates : tuple of Candidate
        What explains the data, the most probable first.
    """

    verdict: str
    family: str | None
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    detection: Detection
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    effects: Mapping[str, Effect]
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate | None:
        """The most probable candidate; None where the verdict is "none"."""
        return self.candidates[0] if self.candidates and self.verdict != "none" else None

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
    def undecided(self) -> str:
        """Why ``apply`` must be told what it is to add, in words; "" where it need not be."""
        return ""

    @property
    @abstractmethod
    def headline(self) -> str:
        """The verdict in a sentence or two."""

    @property
    @abstractmethod
    def what(self) -> str:
        """The effect that was found, in a few words."""

    @abstractmethod
    def blocks(self) -> list[Block]:
        """Return the headline, and what else is printed."""

    def __str__(self) -> str:
        return "\n".join(blocks.lines(self.blocks()))

    def _repr_html_(self) -> str:
        return blocks.notebook(self.headline, self.blocks()[1:])

    def __repr__(self) -> str:
        """Return one line: verdict, what was found, score and threshold."""
        score = f"{self.score:+.1f} nats, threshold {self.threshold:.1f}"
        return f"<{type(self).__name__} {self.verdict}: {self.what}; {score}>"

    @property
    def or_nothing(self) -> str:
        """Behind a verdict, the probability of "none" from `_NOTHING` on, in words; else ""."""
        probable = self.verdict != "none" and self.probabilities.get("none", 0.0) >= _NOTHING
        return f" (nothing: {self.percent('none')})" if probable else ""

    def support_of(self, best: str, rivals: Sequence[str]) -> str:
        """Return verdict, what is best and what else explains the data, in words."""
        said = f"{self.verdict}: {best}"
        return f"{said}; {', '.join(rivals)}, not told apart" if rivals else said

    def percent(self, name: str) -> str:
        """The probability of an effect, or of "none", in percent."""
        return f"{100 * self.probabilities.get(name, 0.0):.0f} %"

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
