"""A seated audience."""

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
