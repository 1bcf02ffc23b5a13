"""A curtain that hangs before a wall, or free in the room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Absorber, Limits, Parameters, read_only
from rtcal.support.types import Array

_MASS = 0.4
"""Surface mass of the fabric in kg/m²: velour and molton have 0.3 to 0.5."""
_IMPEDANCE_OF_AIR = 413.0


@dataclass(frozen=True)
class Curtain(Absorber):
    """A curtain with air behind it: flow resistance, mass and airspace (Ingard 1994; Kuttruff 2016).

    The fabric's impedance is r and i omega m in parallel; behind it stands -i cot(k d cos theta), of
    plane waves in the airspace. Far from a wall the mean over a band is that of a curtain that hangs
    free and absorbs on both sides.
    """

    name: ClassVar[str] = "curtain"
    family: ClassVar[str] = "added absorption, rising"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.12, 0.15)
    largest_share: ClassVar[float] = 0.5
    stands_on: ClassVar[Sequence[str]] = ("wall",)
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 7
    parameter_units: ClassVar[Mapping[str, str]] = {
        "area": " m²",
        "airspace": " m",
        "flow_resistance": " ρc",
    }

    def limits(self, room: Room | None) -> Limits:
        """Return an area of wall, 1 mm to 100 m of air and 0.001 to 1000 rho c."""
        return {**super().limits(room), "airspace": (1e-3, 100.0), "flow_resistance": (1e-3, 1e3)}

    def kinds(self) -> Sequence[Parameters]:
        """Return 0.05 to 0.6 m of air and 0.4 to 2.5 rho c of flow resistance."""
        both = product((0.05, 0.17, 0.6), (0.4, 1.0, 2.5))
        return [{"airspace": d, "flow_resistance": r} for d, r in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return the statistical alpha."""
        return _alpha(tuple(frequencies), parameters["airspace"], parameters["flow_resistance"])


@lru_cache(maxsize=256)
def _alpha(frequencies: tuple[float, ...], airspace: float, resistance: float) -> Array:
    """Return the statistical alpha, averaged over each octave, (n_bands,)."""
    inside = np.array(frequencies)[:, None, None] * 2.0 ** np.linspace(-0.45, 0.45, 9)[:, None]
    omega = 2 * np.pi * inside
    mass = 1j * omega * _MASS / _IMPEDANCE_OF_AIR
    fabric = resistance * mass / (resistance + mass)
    angles = np.radians(np.linspace(1, 78, 30))
    cosine = np.cos(angles)
    phase = omega / 343.2 * airspace * cosine
    impedance = fabric - 1j / (np.tan(phase) * cosine)
    absorbed = 1 - np.abs((impedance * cosine - 1) / (impedance * cosine + 1)) ** 2
    weight = np.sin(2 * angles)
    return read_only(np.clip((absorbed @ weight / weight.sum()).mean(-1), 0, 1))
