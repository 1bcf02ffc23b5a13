"""An opening in a wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rtcal.finder.effects.base import Absorber, Parameters
from rtcal.support.types import Array


@dataclass(frozen=True)
class Opening(Absorber):
    """An opening: the energy that leaves does not return (Sabine; Kuttruff)."""

    name: ClassVar[str] = "opening"
    family: ClassVar[str] = "added absorption, flat"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.05, 0.05)
    steps: ClassVar[int] = 14

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha = 1."""
        return np.ones_like(frequencies)
