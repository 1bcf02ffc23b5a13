"""Membrane and Helmholtz absorbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Absorber, Limits, Parameters
from rtcal.support.types import Array, read_only_view


@dataclass(frozen=True)
class Resonator(Absorber):
    """A membrane or Helmholtz absorber: a0 / (1 + Q² (f/f0 - f0/f)²) (Cox & D'Antonio)."""

    name: ClassVar[str] = "resonator"
    family: ClassVar[str] = "added absorption, low"
    odds: ClassVar[float] = 0.7
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.05, 0.15)
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 6
    parameter_units: ClassVar[Mapping[str, str]] = {"area": " m²", "resonance": " Hz"}

    def limits(self, room: Room | None) -> Limits:
        """Return an area of wall, 1 Hz to 100 kHz and Q from 0.01 to 1000."""
        return {**super().limits(room), "resonance": (1.0, 1e5), "quality": (0.01, 1e3)}

    def kinds(self) -> Sequence[Parameters]:
        """Return 60 to 500 Hz and Q from 0.8 to 3.5, with a0 = 0.8."""
        both = product(np.geomspace(60, 500, 8).tolist(), (0.8, 1.6, 3.5))
        return [{"resonance": f0, "quality": q} for f0, q in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha, averaged over each octave."""
        return resonance_alpha(tuple(frequencies), parameters["resonance"], parameters["quality"])


@lru_cache(maxsize=256)
def resonance_alpha(frequencies: tuple[float, ...], resonance: float, quality: float) -> Array:
    """Return a resonator's alpha with a0 = 0.8, averaged over each octave, (n_bands,)."""
    x = np.array(frequencies)[:, None] * 2.0 ** np.linspace(-0.45, 0.45, 9) / resonance
    return read_only_view((0.8 / (1 + quality**2 * (x - 1 / x) ** 2)).mean(1))


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
