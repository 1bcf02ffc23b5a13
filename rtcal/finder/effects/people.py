"""Objects in the room: people who stand or sit about, a seated audience, furniture."""

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
    all_surfaces,
    interpolate_octaves,
    middle_absorption,
)
from rtcal.finder.model import RoomState
from rtcal.support.types import Array

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


SEATED_ALPHA = 0.86
"""alpha of a seated audience at 1 kHz (Beranek 1996)."""


@dataclass(frozen=True)
class Audience(AbsorbingObject):
    """People in upholstered rows, as an area of floor that they cover (Beranek 1996)."""

    name: ClassVar[str] = "audience"
    family: ClassVar[str] = "added absorption, rising"
    odds: ClassVar[float] = 0.5  # the other half are `People`
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.12, 0.12)
    size: ClassVar[str] = "absorption_area"
    unit: ClassVar[str] = "m² of absorption area at 1 kHz"
    parameter_units: ClassVar[Mapping[str, str]] = {
        "absorption_area": " m² of absorption area at 1 kHz"
    }
    stands_on: ClassVar[Sequence[str]] = ("floor",)

    # Relative to 1 kHz, 63 Hz to 8 kHz.
    SEATED: ClassVar[tuple[float, ...]] = (0.30, 0.42, 0.58, 0.80, 1.0, 1.07, 1.05, 0.97)

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return 0.08 to 1.3 times the room's absorption area."""
        sizes = np.geomspace(0.08, 1.3, 10) * middle_absorption(state)
        return [{"absorption_area": float(a)} for a in sizes]

    def limits(self, room: Room | None) -> Limits:
        """Return what covers at most all surfaces."""
        return {self.size: (0.0, SEATED_ALPHA * all_surfaces(room))}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the audience."""
        return state.covered(
            parameters["absorption_area"] / SEATED_ALPHA, self._alpha(state.frequencies)
        )

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return the audience's alpha."""
        return [({}, self._alpha(frequencies))]

    def _alpha(self, frequencies: Array) -> Array:
        return np.minimum(SEATED_ALPHA * interpolate_octaves(frequencies, self.SEATED), 1.0)


@dataclass(frozen=True)
class Furniture(AbsorbingObject):
    """Objects: A = V_obj^(2/3) each (EN 12354-6), less where they are small beside a wavelength."""

    name: ClassVar[str] = "furniture"
    family: ClassVar[str] = "added absorption, flat"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.12, 0.12)
    size: ClassVar[str] = "absorption_area"
    unit: ClassVar[str] = "m² of absorption area at 1 kHz"
    parameter_units: ClassVar[Mapping[str, str]] = {
        "absorption_area": " m² of absorption area at 1 kHz"
    }
    SPECTRUM: ClassVar[tuple[float, ...]] = (0.45, 0.6, 0.75, 0.88, 1.0, 1.08, 1.1, 1.1)

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return 0.05 to 1.1 times the room's absorption area."""
        sizes = np.geomspace(0.05, 1.1, 12) * middle_absorption(state)
        return [{"absorption_area": float(a)} for a in sizes]

    def limits(self, room: Room | None) -> Limits:
        """Return 0 or more: objects need no wall."""
        return {self.size: (0.0, np.inf)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the objects."""
        spectrum = interpolate_octaves(state.frequencies, self.SPECTRUM)
        return state.with_objects(parameters["absorption_area"] * spectrum)
