"""People who stand or sit about in the room, each an object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import (
    AbsorbingObject,
    Limits,
    Parameters,
    interpolate_octaves,
    middle_absorption,
)
from rtcal.finder.model import RoomState

PER_PERSON = (0.08, 0.15, 0.29, 0.56, 0.85, 0.98, 0.95, 0.95)
"""Absorption area of one person in m², 63 Hz to 8 kHz: the mean of an audience of 0.72 and of 1 person
per m² (Vorländer, Auralization, 2008, appendix), each over its number of persons. The ends are
extrapolated."""
AT_1_KHZ = PER_PERSON[4]


@dataclass(frozen=True)
class People(AbsorbingObject):
    """People as objects, each with an absorption area (Vorländer 2008).

    Seats and rows are not among them: an `Audience` covers floor.
    """

    name: ClassVar[str] = "people"
    family: ClassVar[str] = "added absorption, rising"
    odds: ClassVar[float] = 0.5
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.12, 0.12)
    size: ClassVar[str] = "persons"
    size_error: ClassVar[float] = 0.35  # tables differ by half: how they stand, what they wear
    unit: ClassVar[str] = "persons"
    parameter_units: ClassVar[Mapping[str, str]] = {"persons": " persons"}

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return as many as make 0.08 to 1.3 times the room's absorption area at 1 kHz."""
        counts = np.geomspace(0.08, 1.3, 10) * middle_absorption(state) / AT_1_KHZ
        return [{"persons": float(n)} for n in counts]

    def limits(self, room: Room | None) -> Limits:
        """Return 0 or more: objects need no wall."""
        return {self.size: (0.0, np.inf)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the people."""
        each = interpolate_octaves(state.frequencies, PER_PERSON)
        return state.with_objects(parameters["persons"] * each)
