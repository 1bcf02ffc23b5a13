"""Objects that stand free in the room."""

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
