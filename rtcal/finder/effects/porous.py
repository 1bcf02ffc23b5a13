"""Porous absorbers: a layer on a wall, and a curtain that hangs before it or free in the room."""

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
class Porous(Absorber):
    """A porous layer on a rigid wall, locally reacting, diffuse incidence up to 78° (Miki 1990).

    A curtain is not such a layer: it hangs free.
    """

    name: ClassVar[str] = "porous"
    largest_share: ClassVar[float] = 0.5
    stands_on: ClassVar[Sequence[str]] = ("floor", "wall", "ceiling")
    family: ClassVar[str] = "added absorption, rising"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.1, 0.12)
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 7
    parameter_units: ClassVar[Mapping[str, str]] = {
        "area": " m²",
        "thickness": " m",
        "flow_resistivity": " Pa s/m²",
    }

    def limits(self, room: Room | None) -> Limits:
        """Return an area of wall, 0.1 mm to 10 m and 1 Pa s/m² to 1 GPa s/m²."""
        return {**super().limits(room), "thickness": (1e-4, 10.0), "flow_resistivity": (1.0, 1e9)}

    def kinds(self) -> Sequence[Parameters]:
        """Return 10 to 200 mm and 4 to 40 kPa s/m²."""
        both = product((0.01, 0.018, 0.033, 0.06, 0.11, 0.2), (4e3, 12e3, 40e3))
        return [{"thickness": d, "flow_resistivity": r} for d, r in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return the statistical alpha."""
        thickness, resistivity = parameters["thickness"], parameters["flow_resistivity"]
        return _alpha(tuple(frequencies), thickness, resistivity)


@lru_cache(maxsize=256)
def _alpha(frequencies: tuple[float, ...], thickness: float, flow_resistivity: float) -> Array:
    """Return the statistical alpha of a layer, in m and Pa s/m², (n_bands,) (Miki 1990)."""
    # Averaged over the octave, as a measurement averages the narrow resonance of a thin layer.
    inside = np.array(frequencies)[:, None] * 2.0 ** np.array([-0.33, 0.0, 0.33])
    ratio = inside / flow_resistivity
    k = 2 * np.pi * inside / 343.2
    impedance = 1 + 0.0699 * ratio**-0.632 - 1j * 0.1071 * ratio**-0.632
    number = k * (1 + 0.1093 * ratio**-0.618 - 1j * 0.1597 * ratio**-0.618)
    z = -1j * impedance / np.tan(number * thickness)
    angles = np.linspace(0, np.radians(78), 40)
    normal, weight = z[..., None] * np.cos(angles), np.sin(2 * angles)
    absorbed = 1 - np.abs((normal - 1) / (normal + 1)) ** 2
    return read_only_view(np.clip((absorbed @ weight / weight.sum()).mean(-1), 0, 1))


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
        return _curtain_alpha(
            tuple(frequencies), parameters["airspace"], parameters["flow_resistance"]
        )


@lru_cache(maxsize=256)
def _curtain_alpha(frequencies: tuple[float, ...], airspace: float, resistance: float) -> Array:
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
    return read_only_view(np.clip((absorbed @ weight / weight.sum()).mean(-1), 0, 1))
