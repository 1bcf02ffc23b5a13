"""Absorbers: porous and resonating ones, an opening, people, an audience and furniture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import (
    Absorber,
    AbsorbingObject,
    Limits,
    Parameters,
    all_surfaces,
    interpolate_octaves,
    middle_absorption,
)
from rtcal.finder.model import RoomState
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

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the objects."""
        spectrum = interpolate_octaves(state.frequencies, self.SPECTRUM)
        return state.with_objects(parameters["absorption_area"] * spectrum)


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
