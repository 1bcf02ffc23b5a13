"""People in the room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.discrepancy.effects.base import (
    AbsorbingObject,
    Parameters,
    interpolate_octaves,
    middle_absorption,
)
from rtcal.discrepancy.model import State

SEATED_ALPHA = 0.86
"""alpha of a seated audience at 1 kHz (Beranek 1996)."""


@dataclass(frozen=True)
class Audience(AbsorbingObject):
    """People: seated, as an area; or standing, each with an absorption area (Beranek; EN 12354-6)."""

    name: ClassVar[str] = "audience"
    family: ClassVar[str] = "added absorption, rising"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.12, 0.12)
    size: ClassVar[str] = "absorption_area"
    unit: ClassVar[str] = "m² at 1 kHz"
    discrete: ClassVar[Sequence[str]] = ("standing",)
    parameter_units: ClassVar[Mapping[str, str]] = {"absorption_area": " m² at 1 kHz"}
    parameter_values: ClassVar[Mapping[str, Sequence[str]]] = {"standing": ("seated", "standing")}

    # Relative to 1 kHz: seated in upholstered rows, and standing (EN 12354-6, Table B.3).
    SEATED: ClassVar[tuple[float, ...]] = (0.30, 0.42, 0.58, 0.80, 1.0, 1.07, 1.05, 0.97)
    STANDING: ClassVar[tuple[float, ...]] = (0.2, 0.3, 0.5, 0.8, 1.0, 1.08, 1.06, 1.0)

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return 0.08 to 1.3 times the room's absorption area, seated or standing."""
        sizes = np.geomspace(0.08, 1.3, 10) * middle_absorption(state)
        return [{"standing": s, "absorption_area": float(a)} for s, a in product((0.0, 1.0), sizes)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with the audience."""
        area = parameters["absorption_area"]
        if parameters["standing"]:
            return state.with_objects(area * interpolate_octaves(state.frequencies, self.STANDING))
        alpha = SEATED_ALPHA * interpolate_octaves(state.frequencies, self.SEATED)
        return state.covered(area / SEATED_ALPHA, np.minimum(alpha, 1.0))
