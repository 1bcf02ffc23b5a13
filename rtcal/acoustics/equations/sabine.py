"""Sabine's equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from rtcal.acoustics.equations.base import LinearEquation, MeanEquation, register
from rtcal.acoustics.equations.eyring import Eyring


@register
@dataclass(frozen=True)
class Sabine(LinearEquation):
    """Sabine's equation: a = mean alpha (Sabine 1922; Bellows & Katz 2025, Eqs. 2 and 5).

    E and h of a `MeanEquation` are both the identity.

    Examples
    --------
    >>> from rtcal.acoustics.equations import PAPER_SPEED_OF_SOUND
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.2], [0.4]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Sabine(speed_of_sound=PAPER_SPEED_OF_SOUND).reverberation_time(room).round(2))
    [0.29]
    """

    name: ClassVar[str] = "Sabine"
    key: ClassVar[str] = "sabine"

    def diffuse_field(self) -> MeanEquation:
        """Return Eyring's equation: Sabine's T stays above 0 where every wall absorbs everything."""
        return Eyring(self.speed_of_sound)
