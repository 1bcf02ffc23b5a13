"""The library of effects that a model may lack: how each changes a room's state.

An effect of one's own is a small class with a name, what its parameters are, a grid of them, and
either a spectrum (`Absorber`) or a `change` of the state; see docs/discrepancy.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, Protocol

import numpy as np

from rtcal.discrepancy import shapes, spectra
from rtcal.discrepancy.effect_checks import check_spectrum
from rtcal.discrepancy.model import State
from rtcal.support.types import Array

Parameters = Mapping[str, float]


class Effect(Protocol):
    """Something that a model may lack.

    Attributes
    ----------
    name : str
    size : str
        The parameter that says how much of it there is.
    unit : str
        Of the size.
    neutral : float
        The size at which nothing is changed.
    removable : bool
        Whether it is a thing that could be taken out of the room.
    discrete : sequence of str
        Parameters that have no values between the grid's.
    size_error : float
        Standard deviation of ln size (of the size itself where it may be below 0) that the effect's
        physics leaves open, however well it is measured: where an opening is, how a thing
        scatters. From rooms made for development (tests/hidden_world, population 0).
    """

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def size(self) -> str:
        """Its size's name."""
        ...

    @property
    def unit(self) -> str:
        """Its size's unit."""
        ...

    @property
    def neutral(self) -> float:
        """The size that changes nothing; NaN where no size is one."""
        ...

    @property
    def removable(self) -> bool:
        """Whether it can be taken out of the room."""
        ...

    @property
    def discrete(self) -> Sequence[str]:
        """Parameters that have no values between the grid's."""
        ...

    @property
    def size_error(self) -> float:
        """What its physics leaves open of its size."""
        ...

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return the parameters that are tried, alike in probability."""
        ...

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with this effect in it."""
        ...


class Named:
    """What effects have where they say nothing else."""

    neutral: ClassVar[float] = 0.0
    removable: ClassVar[bool] = False
    discrete: ClassVar[Sequence[str]] = ()
    size_error: ClassVar[float] = 0.25


class Absorber(Named):
    """What puts a surface of some spectrum on a wall; a subclass gives name and `spectrum`.

    Sizes are tried from ``least`` to ``most`` times the room's absorption area at 500 to 2000 Hz.
    """

    name: ClassVar[str]
    size: ClassVar[str] = "area"
    unit: ClassVar[str] = "m²"
    removable: ClassVar[bool] = True
    least: ClassVar[float] = 0.05
    most: ClassVar[float] = 1.2
    steps: ClassVar[int] = 10

    def kinds(self) -> Sequence[Parameters]:
        """Return the other parameters' grid; one kind without any if not overridden."""
        return [{}]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha, (n_bands,)."""
        raise TypeError(f"{type(self).__name__} has no spectrum of its own")

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return every kind in every size."""
        sizes = np.geomspace(self.least, self.most, self.steps) * middle_absorption(state)
        return [{**kind, self.size: float(a)} for kind, a in product(self.kinds(), sizes)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with the absorber in place of wall."""
        alpha = self.spectrum(state.frequencies, parameters)
        alpha = check_spectrum(self.name, alpha, state.frequencies)
        return state.covered(parameters[self.size], alpha)


def middle_absorption(state: State) -> float:
    """Return the room's S'alpha at 500 to 2000 Hz in m², of all bands where it has none of these."""
    area = state.areas @ state.alpha
    middle = (state.frequencies > 440) & (state.frequencies < 2300)
    return float(area[middle].mean() if middle.any() else area.mean())


@dataclass(frozen=True)
class OmittedAir(Named):
    """Air absorption that the model has not, or has for another climate (ISO 9613-1)."""

    name: ClassVar[str] = "air"
    size: ClassVar[str] = "humidity"
    unit: ClassVar[str] = "% at the temperature"
    neutral: ClassVar[float] = np.nan
    size_error: ClassVar[float] = 0.0

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return 5 to 35 °C, 5 to 95 %."""
        return [
            {"temperature": t, "humidity": h}
            for t, h in product(
                (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0),
                (5.0, 8.0, 12.0, 18.0, 25.0, 35.0, 45.0, 60.0, 75.0, 95.0),
            )
        ]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with this air."""
        climate = parameters["temperature"], parameters["humidity"]
        return replace(state, air=spectra.air(tuple(state.frequencies), *climate))


@dataclass(frozen=True)
class Opening(Absorber):
    """An opening: what goes out does not come back (Sabine; Kuttruff)."""

    name: ClassVar[str] = "opening"
    steps: ClassVar[int] = 14

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha = 1."""
        return np.ones_like(frequencies)


@dataclass(frozen=True)
class Audience(Named):
    """People: seated, as an area; or standing, each with an absorption area (Beranek; EN 12354-6)."""

    name: ClassVar[str] = "audience"
    size: ClassVar[str] = "absorption_area"
    unit: ClassVar[str] = "m² at 1 kHz"
    removable: ClassVar[bool] = True
    discrete: ClassVar[Sequence[str]] = ("standing",)

    # Seated in upholstered rows, and persons standing (EN 12354-6, Table B.3), over 1 kHz.
    SEATED: ClassVar[tuple[float, ...]] = (0.30, 0.42, 0.58, 0.80, 1.0, 1.07, 1.05, 0.97)
    STANDING: ClassVar[tuple[float, ...]] = (0.2, 0.3, 0.5, 0.8, 1.0, 1.08, 1.06, 1.0)

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return 0.08 to 1.3 times the room's absorption, seated or standing."""
        sizes = np.geomspace(0.08, 1.3, 10) * middle_absorption(state)
        return [{"standing": s, "absorption_area": float(a)} for s, a in product((0.0, 1.0), sizes)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with the audience."""
        area = parameters["absorption_area"]
        if parameters["standing"]:
            return state.with_objects(area * spectra.between(state.frequencies, self.STANDING))
        top = 0.86  # alpha of a seated audience at 1 kHz (Beranek 1996)
        spectrum = np.minimum(top * spectra.between(state.frequencies, self.SEATED), 1.0)
        return state.covered(area / top, spectrum)


@dataclass(frozen=True)
class Furniture(Named):
    """Objects: A = V_obj^(2/3) each (EN 12354-6); less where they are small beside a wavelength."""

    name: ClassVar[str] = "furniture"
    size: ClassVar[str] = "absorption_area"
    unit: ClassVar[str] = "m² at 1 kHz"
    removable: ClassVar[bool] = True
    SPECTRUM: ClassVar[tuple[float, ...]] = (0.45, 0.6, 0.75, 0.88, 1.0, 1.08, 1.1, 1.1)

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return 0.05 to 1.1 times the room's absorption."""
        sizes = np.geomspace(0.05, 1.1, 12) * middle_absorption(state)
        return [{"absorption_area": float(a)} for a in sizes]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with the objects."""
        each = spectra.between(state.frequencies, self.SPECTRUM)
        return state.with_objects(parameters["absorption_area"] * each)


@dataclass(frozen=True)
class Porous(Absorber):
    """A porous layer on a rigid wall, locally reacting, diffuse to 78° (Miki 1990).

    A curtain is not such a layer: it hangs free.
    """

    name: ClassVar[str] = "porous"
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 7

    def kinds(self) -> Sequence[Parameters]:
        """Return 10 to 200 mm, 3 to 50 kPa s/m²."""
        both = product((0.01, 0.018, 0.033, 0.06, 0.11, 0.2), (4e3, 12e3, 40e3))
        return [{"thickness": d, "flow_resistivity": r} for d, r in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return the statistical alpha."""
        thickness, resistivity = parameters["thickness"], parameters["flow_resistivity"]
        return spectra.porous(tuple(frequencies), thickness, resistivity)


@dataclass(frozen=True)
class Resonator(Absorber):
    """A membrane or Helmholtz absorber: a0 / (1 + Q² (f/f0 - f0/f)²) (Cox & D'Antonio)."""

    name: ClassVar[str] = "resonator"
    least: ClassVar[float] = 0.1
    steps: ClassVar[int] = 6

    def kinds(self) -> Sequence[Parameters]:
        """Return 60 to 500 Hz, Q 0.7 to 5, a0 = 0.8."""
        both = product(np.geomspace(60, 500, 8).tolist(), (0.8, 1.6, 3.5))
        return [{"resonance": f0, "quality": q} for f0, q in both]

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha, averaged over each octave."""
        return spectra.resonator(tuple(frequencies), parameters["resonance"], parameters["quality"])


@dataclass(frozen=True)
class WrongArea(Named):
    """One material's area is another than stated, by a ratio."""

    name: ClassVar[str] = "area"
    size: ClassVar[str] = "ratio"
    unit: ClassVar[str] = "of the stated area"
    neutral: ClassVar[float] = 1.0
    discrete: ClassVar[Sequence[str]] = ("material",)
    size_error: ClassVar[float] = 0.0

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return each material at 0.4 to 2.5 times its area."""
        ratios = [r for r in np.geomspace(0.4, 2.5, 12) if abs(r - 1) > 0.05]
        both = product(range(len(state.areas)), ratios)
        return [{"material": float(j), "ratio": float(r)} for j, r in both]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with that area."""
        areas = state.areas.copy()
        areas[int(parameters["material"])] *= parameters["ratio"]
        return replace(state, areas=areas)


@dataclass(frozen=True)
class WrongVolume(Named):
    """The volume is another than stated, by a ratio."""

    name: ClassVar[str] = "volume"
    size: ClassVar[str] = "ratio"
    unit: ClassVar[str] = "of the stated volume"
    neutral: ClassVar[float] = 1.0
    size_error: ClassVar[float] = 0.04

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return 0.7 to 1.4."""
        return [{"ratio": float(r)} for r in np.geomspace(0.7, 1.4, 14)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with that volume."""
        return replace(state, volume=state.volume * parameters["ratio"])


@dataclass(frozen=True)
class WrongFormula(Named):
    """Another equation than the model's: Sabine's, Eyring's or Millington's."""

    name: ClassVar[str] = "formula"
    size: ClassVar[str] = "equation"
    unit: ClassVar[str] = "0 Sabine, 1 Eyring, 2 Millington"
    neutral: ClassVar[float] = np.nan
    discrete: ClassVar[Sequence[str]] = ("equation",)
    size_error: ClassVar[float] = 0.0
    EQUATIONS: ClassVar[tuple[str, ...]] = ("sabine", "eyring", "millington")

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return the equations that the model does not use."""
        return [{"equation": float(i)} for i, e in enumerate(self.EQUATIONS) if e != state.equation]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room under that equation."""
        return replace(state, equation=self.EQUATIONS[int(parameters["equation"])])


@dataclass(frozen=True)
class CoupledRoom(Named):
    """A second room behind an aperture: two energy balances (Kuttruff; Cremer & Mueller)."""

    name: ClassVar[str] = "coupled room"
    size: ClassVar[str] = "aperture"
    unit: ClassVar[str] = "m²"
    removable: ClassVar[bool] = True
    size_error: ClassVar[float] = 0.4

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return apertures of 0.05 to 1.2 A, rooms of 0.2 to 3 V, alpha 0.02 to 0.3."""
        area = middle_absorption(state)
        return [
            {"aperture": float(a * area), "volume": float(v * state.volume), "alpha": float(e)}
            for a, v, e in product(
                np.geomspace(0.05, 1.2, 8), np.geomspace(0.2, 3, 4), np.geomspace(0.02, 0.3, 4)
            )
        ]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room coupled to the other."""
        return replace(state, shape=shapes.Coupled(**parameters))


@dataclass(frozen=True)
class NonDiffuse(Named):
    """Uneven absorption and little scattering: each direction decays at its own rate."""

    name: ClassVar[str] = "non-diffuse field"
    size: ClassVar[str] = "scattering"
    unit: ClassVar[str] = "scattering coefficient"
    neutral: ClassVar[float] = 1.0
    size_error: ClassVar[float] = 0.5

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return s = 0.01 to 0.3."""
        return [{"scattering": float(s)} for s in np.geomspace(0.01, 0.3, 9)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with so little scattering."""
        return replace(state, shape=shapes.NonDiffuse(**parameters))


@dataclass(frozen=True)
class NoiseFloor(Named):
    """Noise in the measured decays that was not taken off: S(t) + N (t_end - t) (ISO 3382)."""

    name: ClassVar[str] = "noise floor"
    size: ClassVar[str] = "level"
    unit: ClassVar[str] = "dB under the start of the decay"
    neutral: ClassVar[float] = -90.0
    size_error: ClassVar[float] = 1.2

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return -60 to -30 dB over one to three reverberation times."""
        levels = np.linspace(-62, -30, 17).tolist()
        return [{"level": x, "record": r} for x, r in product(levels, (1.5, 2.5))]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with this noise in its decays."""
        return replace(state, floor_db=parameters["level"], record=parameters["record"])


@dataclass(frozen=True)
class Directivity(Named):
    """A source that is not omnidirectional: its direct sound, in C80 and G alone."""

    name: ClassVar[str] = "direct sound"
    size: ClassVar[str] = "gain"
    unit: ClassVar[str] = "dB"
    size_error: ClassVar[float] = 1.0

    def grid(self, state: State) -> Sequence[Parameters]:
        """Return -9 to +9 dB."""
        return [{"gain": g} for g in (-9.0, -6.0, -4.0, -2.0, 2.0, 4.0, 6.0, 9.0)]

    def change(self, state: State, parameters: Parameters) -> State:
        """Return the room with the direct sound so much stronger."""
        return replace(state, direct_db=state.direct_db + parameters["gain"])


def library() -> tuple[Effect, ...]:
    """Return every effect that rtcal knows."""
    return (
        OmittedAir(),
        Opening(),
        Audience(),
        Furniture(),
        Porous(),
        Resonator(),
        WrongArea(),
        WrongVolume(),
        WrongFormula(),
        CoupledRoom(),
        NonDiffuse(),
        NoiseFloor(),
        Directivity(),
    )
