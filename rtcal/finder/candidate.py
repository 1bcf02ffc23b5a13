"""An effect that explains the data, its probability and its size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from rtcal.finder.effects.whole_room import CoupledRoom
from rtcal.support.files import json_numbers
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
        return {**vars(self), "end": self.end or None}


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
    unit : str
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
        return amount(self.size, self.unit, (self.low, self.high))

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
