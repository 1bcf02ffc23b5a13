"""An effect in one place, with its probability and size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rtcal.discrepancy.wording import amount
from rtcal.support.files import json_numbers
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect in one place.

    Attributes
    ----------
    effect, family : str
    surface : str or None
        None for the whole room and for the measurement.
    place : str
        The surface's name; of the measurement's errors "receiver R1", "source S1" or "S1 to R1"; "" for
        the whole room.
    probability : float
    size, low, high : float
        Posterior mean and 90 % interval, in ``unit``.
    unit : str
    parameters : mapping of str to float
        The most probable ones.
    spectrum : array (n_bands,) or (0,)
        Posterior mean alpha of what stands on the surface.
    """

    effect: str
    family: str
    surface: str | None
    place: str
    probability: float
    size: float
    low: float
    high: float
    unit: str
    parameters: Mapping[str, float]
    spectrum: Array

    @property
    def title(self) -> str:
        """Effect and place, as a sentence names them."""
        if self.surface is not None:
            return f'{self.effect} on "{self.surface}"'
        return f"{self.effect} of {self.place}" if self.place else self.effect

    @property
    def in_words(self) -> str:
        """Size with its interval."""
        return f"{amount(self.size, self.unit)} (90 %: {self.low:.3g} to {self.high:.3g})"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            **{k: v for k, v in vars(self).items() if k not in ("spectrum", "parameters")},
            "parameters": dict(self.parameters),
            "spectrum": json_numbers(self.spectrum),
        }
