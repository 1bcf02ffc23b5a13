"""A membrane before an airspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Absorber, Limits, Parameters
from rtcal.finder.effects.resonator import resonance_alpha
from rtcal.support.types import Array

_PEAK = 0.55
"""alpha at the resonance. Catalogues have 0.3 to 0.7 for plywood and plasterboard before air."""
_QUALITY = 1.2
"""Plywood and plasterboard before air absorb over two octaves."""


@dataclass(frozen=True)
class Membrane(Absorber):
    """A panel before an airspace: resonance 60 / sqrt(m d) Hz (Kuttruff 2016; Cox & D'Antonio)."""

    name: ClassVar[str] = "membrane"
    family: ClassVar[str] = "added absorption, low"
    odds: ClassVar[float] = 0.5
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.08, 0.2)
    largest_share: ClassVar[float] = 0.5
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 6
    parameter_units: ClassVar[Mapping[str, str]] = {
        "area": " m²",
        "mass": " kg/m²",
        "airspace": " m",
    }

    def limits(self, room: Room | None) -> Limits:
        """Return an area of wall, 1 g/m² to 10 t/m² and 0.1 mm to 10 m of air."""
        return {**super().limits(room), "mass": (1e-3, 1e4), "airspace": (1e-4, 10.0)}

    def kinds(self) -> Sequence[Parameters]:
        """Return 5 and 10 kg/m² before 0.02 to 0.2 m of air: 42 to 190 Hz."""
        both = product((5.0, 10.0), (0.02, 0.06, 0.2))
        return [{"mass": m, "airspace": d} for m, d in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha, averaged over each octave."""
        resonance = 60 / (parameters["mass"] * parameters["airspace"]) ** 0.5
        return resonance_alpha(tuple(frequencies), resonance, _QUALITY) * (_PEAK / 0.8)
