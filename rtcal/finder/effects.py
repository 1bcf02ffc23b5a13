"""The library of effects that may be missing from a model, and the rules that each must obey.

Absorbers are porous layers, curtains, resonators, panels, an opening, people, an audience and
furniture. The other effects are a wrong area, volume or equation, a covered material, air absorption
that was left out, a field that is not diffuse, a second room, noise, and a directional source. What
they differ by are the rows of `LIBRARY`; a class has the acoustics of one. An error message names the
effect and the rule.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from math import inf, isfinite
from operator import itemgetter
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.changes import NOT_KNOWN
from rtcal.acoustics.equations import Eyring, MeanEquation, Millington, Sabine, mean_equation
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import LARGEST, LARGEST_PIECE, Room
from rtcal.finder.model import (
    Decay,
    DirectionalDecay,
    RoomState,
    covered,
    rates,
    speeds,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, RtcalError
from rtcal.support.text import rounded, shortened
from rtcal.support.types import Array, put, read_only_view

Parameters = Mapping[str, float]
Limits = Mapping[str, tuple[float, float]]
"""Smallest and largest possible value of each parameter of an effect, by the parameter's name."""
SURFACES = ("floor", "wall", "ceiling")
HARD = 0.04
"""Absorption coefficient of a hard cover: wood, plaster or glass at middle frequencies."""
SEATED_ALPHA = 0.86
"""Absorption coefficient of a seated audience at 1 kHz (Beranek 1996)."""
RATIOS = (5e-4, 2e3)
"""Smallest and largest ratio of a true area or volume to the input value: a wrong unit is a factor of
1000."""
_RISING, _FLAT, _LOW = (f"added absorption, {kind}" for kind in ("rising", "flat", "low"))
_USUAL = (0.106, 0.0, 0.0)
_AT_1_KHZ, _COVERED = "m² of absorption area at 1 kHz", "of its area covered"
_SCATTERING, _LEVEL = "as scattering coefficient", "dB relative to the start of the decay"

COLUMNS = ("family", "odds", "spectrum_error", "size", "unit", "neutral", "size_error")
LIBRARY: Mapping[str, tuple[Any, ...]] = {
    "air": (
        "climate",
        1.0,
        (0.03, 0, 0.03),
        "humidity",
        "% humidity at the temperature",
        np.nan,
        0,
    ),
    "opening": (_FLAT, 1.0, (0.1, 0.05, 0.05), "area", "m²", 0.0, 0.25),
    "audience": (_RISING, 0.5, (0.1, 0.12, 0.12), "absorption_area", _AT_1_KHZ, 0.0, 0.25),
    # Tables of people differ by half: how they stand, what they wear.
    "people": (_RISING, 0.5, (0.1, 0.12, 0.12), "persons", "persons", 0.0, 0.35),
    "furniture": (_FLAT, 1.0, (0.1, 0.12, 0.12), "absorption_area", _AT_1_KHZ, 0.0, 0.25),
    "porous": (_RISING, 1.0, (0.1, 0.1, 0.12), "area", "m²", 0.0, 0.25),
    "curtain": (_RISING, 1.0, (0.1, 0.12, 0.15), "area", "m²", 0.0, 0.25),
    "resonator": (_LOW, 0.7, (0.1, 0.05, 0.15), "area", "m²", 0.0, 0.25),
    "membrane": (_LOW, 0.5, (0.1, 0.08, 0.2), "area", "m²", 0.0, 0.25),
    # A cover has 0.02 to 0.1, not HARD: some 6 % of what a panel absorbs. Its size_error was chosen on
    # twelve rooms as in tests/seams/test_turned_panels.py; with 0.25 T is 12 % off.
    "covered surface": ("less absorption", 0.5, (0.1, 0.08, 0.1), "share", _COVERED, 0.0, 0.1),
    "area": ("scale", 1.0, _USUAL, "ratio", "of the input area", 1.0, 0.0),
    "volume": ("scale", 1 / 3, _USUAL, "ratio", "of the input volume", 1.0, 0.04),
    "formula": ("scale", 1.0, _USUAL, "equation", "0 Sabine, 1 Eyring, 2 Millington", np.nan, 0.0),
    "coupled room": ("field", 0.5, (0.2, 0.1, 0.3), "aperture", "m²", 0.0, 0.4),
    "non-diffuse field": ("field", 1.0, (0.2, 0.1, 0.3), "scattering", _SCATTERING, 1.0, 0.5),
    "noise floor": ("measurement", 1.0, _USUAL, "level", _LEVEL, -90.0, 1.2),
    "direct sound": ("measurement", 0.5, _USUAL, "gain", "dB", 0.0, 1.0),
}
"""The `COLUMNS` of each effect, as `Effect` describes them, in the order in which effects are tried."""


@dataclass(frozen=True)
class Parameter:
    """Describe a parameter of an effect, such as the thickness of a porous layer."""

    tried: Sequence[float] = ()
    """Values of the parameter that are tried; empty where the effect derives them from the room."""
    within: tuple[float, float] = (-inf, inf)
    """Smallest and largest value that are physically possible in any room."""
    unit: str = ""
    """Unit of the parameter, as text that follows its value."""
    words: Sequence[str] = ()
    """Words that are printed in place of the values 0, 1, ...."""
    discrete: bool = False
    """Whether the parameter has no values between those that are tried."""
    most_in: Callable[[Room], float] | None = None
    """Function that returns the largest value in a room; None where it is that of ``within``."""
    label: str = ""
    """Name in print, if it is another one than the parameter's."""

    def shown(self, name: str, value: float) -> str:
        """Return a parameter's value as text: ``thickness 0.06 m``, or the word for the value.

        ``name`` is the parameter's name, and ``value`` is in its `unit`.
        """
        if value in range(len(self.words)):
            return self.words[int(value)]
        label = self.label or name.replace("_", " ")
        return f"{label} {rounded(value, 3)}{' ' * bool(self.unit)}{self.unit}"

    def limits(self, room: Room | None) -> tuple[float, float]:
        """Return the smallest and the largest value in a room, or (None) in any room."""
        least, most = self.within
        return least, most if room is None or self.most_in is None else self.most_in(room)


def _all_surfaces(room: Room | None) -> float:
    """Return the area of all surfaces of a room in m², or the largest that rtcal allows."""
    return LARGEST if room is None else room.total_area


class Effect(ABC):
    """Describe something that may be missing from a room's model, such as an opening or a curtain.

    An effect has parameters, one of which is its size (for example its area), and a method `change`
    that adds it to the acoustic state of a room. `rtcal.find` tries every effect with many values of
    its parameters. For an effect of your own, write a subclass.
    """

    name: ClassVar[str]
    size: ClassVar[str]
    """Name of the parameter that gives the amount of the effect, such as its area."""
    unit: ClassVar[str]
    """Unit of this amount, as text that follows the value."""
    parameters: ClassVar[Mapping[str, Parameter]] = {}
    """Parameters of the effect, by name."""
    neutral: ClassVar[float] = 0.0
    """Amount with which the effect changes nothing. NaN without one; it has no interval then."""
    removable: ClassVar[bool] = False
    """Whether the object can be taken out of the room."""
    size_error: ClassVar[float] = 0.25
    """Standard deviation of ln size (of the size itself where it can be negative) from the
    simplified physics. Chosen on simulated rooms (benchmarks/studies/hidden_world), so that 90 %
    intervals hold."""
    family: ClassVar[str] = "of your own"
    """Name of the group of effects that change the measurement in a similar way. Several groups of
    added absorption have names that begin with "added absorption, "."""
    alone: ClassVar[bool] = True
    """Whether the effect may be identified by its own name. If not, only its group is: the
    equations for a coupled room and for a non-diffuse field are too rough to distinguish them."""
    odds: ClassVar[float] = 1.0
    """Odds of the effect before the measurement, relative to the usual ones, which have 1."""
    spectrum_error: ClassVar[tuple[float, float, float]] = _USUAL
    """Three standard deviations of the relative error of the effect's change: of an error common to all
    bands, of an error that grows per octave from 1 kHz, and of an error per band with a correlation of
    0.5 between neighbouring octaves."""
    formula_error: ClassVar[float] = 0.106
    """Standard deviation of the relative error of the effect's change in each parameter by itself."""
    takes_wall: ClassVar[bool] = False
    """Whether the size of the effect is an area of wall that it replaces."""
    largest_share: ClassVar[float] = 0.25
    """Largest share of all surfaces of the room that the effect is assumed to cover."""
    stands_on: ClassVar[Sequence[str]] = ()
    """Kinds of surfaces on which the effect may be: "floor", "wall" and "ceiling". At positions it is
    tried on each of them; an effect without any is tried only for means over positions."""
    shares: ClassVar[Sequence[float]] = ()
    """Shares of a surface that are tried, for an effect that takes absorption away from the surface."""
    needs_directions: ClassVar[bool] = False
    """Whether the effect is tried only where it is known in which directions surfaces face."""
    in_geometry: ClassVar[bool] = False
    """Whether a geometrical program already includes the effect, so that it cannot be missing from its
    run."""
    not_in_simulator: ClassVar[str | None] = (
        "it bends the decay, which no material of a simulator does; without make the case's own "
        "model is the simulator"
    )
    """Reason why a simulator of a room cannot have an effect that no material can represent, or
    None."""
    remark: ClassVar[str] = ""
    """Remark that is printed after the parameter values."""

    def __init_subclass__(cls, row: str = "") -> None:
        """Set what a row of `LIBRARY` states."""
        if row:
            for name, value in zip(("name", *COLUMNS), (row, *LIBRARY[row]), strict=True):
                setattr(cls, name, value)

    @property
    def discrete(self) -> list[str]:
        """Names of the parameters that can only have the values that are tried, such as a material."""
        return [name for name, of in self.parameters.items() if of.discrete]

    @property
    def kinds(self) -> list[Parameters]:
        """Every combination of the tried values of parameters, by name; one empty one without any."""
        tried = {name: of.tried for name, of in self.parameters.items() if len(of.tried)}
        return [dict(zip(tried, values, strict=True)) for values in product(*tried.values())]

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the parameter sets that are tried in a room without the effect; by default `kinds`."""
        return self.kinds

    @abstractmethod
    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the effect added, by values for each of its parameters."""

    def changes(self, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
        """Return the states of the room with the effect, one per parameter set."""
        return [self.change(state, theta) for theta in grid]

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return parameter values and alpha (n_bands,) of what is tried on a surface, if any."""
        return []

    def density(self, parameters: Mapping[str, Array], state: RoomState) -> Array | float:
        """Return how probable n combinations of parameter values are before the measurement.

        The result is a probability density that need not be normalised: (n,), or one number for all; by
        default 1. ``parameters`` has n values of each parameter, by name, and ``state`` is the room
        without the effect. For a parameter above 0 it is the density of the parameter's logarithm; for
        a discrete parameter it is a probability.
        """
        return 1.0

    def limits(self, room: Room | None) -> Limits:
        """Return the ends of parameters that have any, by name, in a room or (None) in any room."""
        return {name: of.limits(room) for name, of in self.parameters.items()}

    def size_limits(self, room: Room) -> tuple[float, float]:
        """Return the smallest and the largest possible size of the effect in a room, in its unit."""
        return self.limits(room).get(self.size, (-inf, inf))

    def prior_odds(self, room: Room) -> float:
        """Return how probable the effect is before the measurement, relative to a usual effect."""
        return self.odds

    def title(self, parameters: Parameters, room: Room) -> str:
        """Return the effect's name for a sentence, such as ``area of "plaster"``."""
        material = self.material(parameters, room)
        return self.name if material is None else f'{self.name} of "{material}"'

    def material(self, parameters: Parameters, room: Room) -> str | None:
        """Return the name of the material that the effect is about, by its number; None without one."""
        number = int(parameters.get("material", -1))
        return room.materials[number] if 0 <= number < room.n_materials else None

    def unit_in(self, parameters: Parameters, room: Room) -> str:
        """Return the unit of the effect's size in a room; by default `unit`."""
        return self.unit

    def describe(self, parameters: Parameters, without: str = "") -> str:
        """Return the parameter values as text, without the material and the one named ``without``."""
        known = {self.size: Parameter(unit=self.unit), **self.parameters}
        in_order = [*self.parameters, *(name for name in parameters if name not in self.parameters)]
        shown = ", ".join(
            known.get(name, Parameter()).shown(name, parameters[name])
            for name in in_order
            if name in parameters and name not in (without, "material")
        )
        return shown + self.remark

    def contradicts(self, room: Room) -> bool:
        """Return whether the effect replaces an input value of the room, such as an area."""
        return False

    def air(self, stated: Air | None, parameters: Parameters) -> Air | None:
        """Return the air of the room with the effect; by default the room's own, which may be None."""
        return stated

    def errors_over_bands(self, frequencies: Array) -> Array:
        """Return by how much the effect's equation may err in each band, (n_bands, 2 + n_bands).

        The errors are relative to the change of T20, C80 and G that the effect causes. Each column is
        one standard deviation of an independent error: column 0 is the same in all bands, column 1
        grows with the distance from 1 kHz in octaves, and the other columns together are an error per
        band with a correlation of 0.5 between neighbouring octaves. ``frequencies`` (n_bands,) are in
        Hz.
        """
        common, tilt, rough = self.spectrum_error
        octaves = np.log2(frequencies / 1000)
        lag = np.abs(np.subtract.outer(octaves, octaves))
        smooth = np.stack([np.full(len(octaves), common), tilt * octaves], axis=1)
        return np.concatenate([smooth, rough * np.linalg.cholesky(0.5**lag)], axis=1)

    def error_over_bands(self, frequencies: Array) -> Array:
        """Return the covariance of the errors of `errors_over_bands`, (n_bands, n_bands)."""
        errors = self.errors_over_bands(frequencies)
        return np.asarray(errors @ errors.T)


class AbsorbingObject(Effect):
    """Describe missing objects whose absorption is proportional to their number, such as people.

    A subclass gives in ``each`` the absorption area of one object in m² at the octaves from 63 Hz
    to 8 kHz, and in ``of_one`` its mean from 500 to 2000 Hz. ``steps`` numbers of objects are
    tried, which absorb from ``least`` to ``most`` times as much as the room.
    """

    removable: ClassVar[bool] = True
    least: ClassVar[float] = 0.05
    most: ClassVar[float] = 1.2
    steps: ClassVar[int] = 10
    of_one: ClassVar[float] = 1.0
    each: ClassVar[Sequence[float]] = (1.0,) * 8

    def limits(self, room: Room | None) -> Limits:
        """Return the limits of each parameter, by name; a size is 0 or more."""
        return {self.size: (0.0, inf), **super().limits(room)}

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the numbers of objects that are tried in a room, with every combination in `kinds`."""
        sizes = np.geomspace(self.least, self.most, self.steps) * middle_absorption(state)
        sizes = (sizes / self.of_one).tolist()
        return [{**kind, self.size: a} for kind, a in product(self.kinds, sizes)]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the objects added."""
        each = _interpolate_octaves(state.frequencies, self.each)
        return state.with_objects(parameters[self.size] * each)


class Absorber(AbsorbingObject):
    """Describe a missing absorber that covers an area of wall, such as a porous layer.

    A subclass gives its ``name``, and in `spectrum` its absorption coefficient per band.
    """

    size: ClassVar[str] = "area"
    unit: ClassVar[str] = "m²"
    takes_wall: ClassVar[bool] = True
    stands_on: ClassVar[Sequence[str]] = ("wall", "ceiling")

    @abstractmethod
    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha of the absorber, (n_bands,), at frequencies in Hz, whatever its area."""

    def limits(self, room: Room | None) -> Limits:
        """Return the limits of all parameters; the area is from 0 to that of all surfaces, in m²."""
        return {**super().limits(room), self.size: (0.0, _all_surfaces(room))}

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return alpha of the absorber on a surface, (n_bands,), for each of its `kinds`."""
        return [(kind, self._checked_alpha(frequencies, kind)) for kind in self.kinds]

    def _checked_alpha(self, frequencies: Array, parameters: Parameters) -> Array:
        where = f'effect "{self.name}": spectrum'
        alpha = checks.array(where, self.spectrum(frequencies, parameters))
        _refuse(where, alpha, [frequencies.shape], 0.0, 1.0, bands.labels(frequencies))
        return alpha

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the absorber in place of an equal area of wall."""
        return self.changes(state, [parameters])[0]

    def changes(self, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
        """Return the states of the room with the absorber, one per parameter set."""
        if type(self).change is not Absorber.change:
            return super().changes(state, grid)
        others = [name for name in grid[0] if name != self.size]
        kinds = [tuple(theta[name] for name in others) for theta in grid]
        spectra = {
            kind: self._checked_alpha(state.frequencies, theta)
            for kind, theta in dict(zip(kinds, grid, strict=True)).items()
        }
        areas = np.array([theta[self.size] for theta in grid])
        return covered([state] * len(grid), areas, np.array([spectra[kind] for kind in kinds]))


def middle_absorption(state: RoomState) -> float:
    """Return the absorption area in m² of the materials from 500 to 2000 Hz, or over all bands."""
    area = state.areas @ state.alpha
    return float(area[bands.is_middle(state.frequencies)].mean())


def _interpolate_octaves(frequencies: Array, octaves: Sequence[float]) -> Array:
    """Return octave values from 63 Hz to 8 kHz at other frequencies, linear in the log frequency."""
    centres = np.log(62.5 * 2.0 ** np.arange(8))
    return np.asarray(np.interp(np.log(frequencies), centres, octaves))


def _statistical(normal: NDArray[np.complex128], angles: Array) -> Array:
    """Return alpha in diffuse sound by impedances times the cosine, (n_bands, n_inside, n_angles)."""
    weight = np.sin(2 * angles)
    absorbed = 1 - np.abs((normal - 1) / (normal + 1)) ** 2
    return np.asarray(np.clip((absorbed @ weight / weight.sum()).mean(-1), 0, 1))


def _resonance(frequencies: Array, resonance: float, quality: float, peak: float) -> Array:
    """Return alpha = peak / (1 + Q² (f/f0 - f0/f)²), averaged over each octave, (n_bands,)."""
    x = frequencies[:, None] * 2.0 ** np.linspace(-0.45, 0.45, 9) / resonance
    return np.asarray((peak / (1 + quality**2 * (x - 1 / x) ** 2)).mean(1))


@dataclass(frozen=True)
class OmittedAir(Effect, row="air"):
    """Describe air absorption that is missing from the model, or a wrong climate (ISO 9613-1)."""

    parameters = {
        "temperature": Parameter((10.0, 14.0, 18.0, 22.0, 26.0, 30.0, 35.0), (-20.0, 50.0), "°C"),
        "humidity": Parameter(
            (8.0, 13.0, 20.0, 27.0, 35.0, 45.0, 57.0, 70.0, 95.0), (1.01, 100.0), "%"
        ),
    }
    remark = " (found together: only the attenuation that they give is known well)"
    INDOORS: ClassVar[Mapping[str, tuple[float, float, float]]] = {
        "temperature": (15.0, 30.0, 3.0),
        "humidity": (20.0, 70.0, 10.0),
    }

    def density(self, parameters: Mapping[str, Array], state: RoomState) -> Array | float:
        """Return the density: even in 15 to 30 °C and 20 to 70 %, with normal tails outside."""
        out: Array | float = 1.0
        for name, (low, high, tail) in self.INDOORS.items():
            value = np.asarray(parameters[name])
            beyond = np.maximum(np.maximum(low - value, value - high), 0.0) / tail
            out = out * np.exp(-0.5 * beyond**2) * value  # per unit of ln
        return out

    def prior_odds(self, room: Room) -> float:
        """Return the odds: 3 without an input climate, because every room has air, and 0.3 with one.

        These odds are for errors larger than `Case.climate_uncertainty`, which is always allowed
        for.
        """
        return 3.0 if room.air is None else 0.3

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the attenuation and the speed of sound of this climate."""
        climate = parameters["temperature"], parameters["humidity"]
        attenuation, speed = _climate(tuple(state.frequencies), *climate)
        return replace(state, air=attenuation, speed_of_sound=speed)

    def contradicts(self, room: Room) -> bool:
        """Return whether the room's input has a climate, which this effect replaces."""
        return room.air is not None

    def air(self, stated: Air | None, parameters: Parameters) -> Air | None:
        """Return the air of this climate."""
        return Air(parameters["temperature"], parameters["humidity"])


@lru_cache(maxsize=256)
def _climate(
    frequencies: tuple[float, ...], temperature: float, humidity: float
) -> tuple[Array, float]:
    """Return the air's energy attenuation in 1/m, (n_bands,), and its speed of sound in m/s."""
    air = Air(temperature, humidity)
    return read_only_view(air.attenuation(frequencies)), air.speed_of_sound


@dataclass(frozen=True)
class Opening(Absorber, row="opening"):
    """Describe a missing opening with alpha = 1, through which sound does not return (Kuttruff)."""

    steps = 14

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha = 1 in each band, (n_bands,)."""
        return np.ones_like(frequencies)


@dataclass(frozen=True)
class Audience(AbsorbingObject, row="audience"):
    """Describe a missing audience in upholstered seats, by its absorption area (Beranek 1996)."""

    stands_on = ("floor",)
    parameters = {  # at most, people cover all surfaces
        "absorption_area": Parameter(
            within=(0.0, SEATED_ALPHA * LARGEST),
            unit=_AT_1_KHZ,
            most_in=lambda room: SEATED_ALPHA * room.total_area,
        )
    }
    # Relative to 1 kHz, 63 Hz to 8 kHz.
    SEATED: ClassVar[tuple[float, ...]] = (0.30, 0.42, 0.58, 0.80, 1.0, 1.07, 1.05, 0.97)
    least, most = 0.08, 1.3

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the audience added."""
        ((_, alpha),) = self.on_surface(state.frequencies)
        return state.covered(parameters["absorption_area"] / SEATED_ALPHA, alpha)

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return the audience's alpha, (n_bands,), as the only combination of parameters."""
        seated = _interpolate_octaves(frequencies, self.SEATED)
        return [({}, np.minimum(SEATED_ALPHA * seated, 1.0))]


@dataclass(frozen=True)
class People(AbsorbingObject, row="people"):
    """Describe missing people, each with an absorption area (Vorländer 2008), not in rows of seats.

    It is the mean of an audience of 0.72 and of 1 person per m² (Auralization, appendix), each over its
    number of persons. The ends are extrapolated.
    """

    each = (0.08, 0.15, 0.29, 0.56, 0.85, 0.98, 0.95, 0.95)
    of_one = each[4]
    least, most = 0.08, 1.3


@dataclass(frozen=True)
class Furniture(AbsorbingObject, row="furniture"):
    """Describe missing hard objects, such as tables, by their absorption area (EN 12354-6).

    EN 12354-6 gives A = V^(2/3) in m² of an object of V m³; here it falls to 0.45 towards 63 Hz.
    """

    each = (0.45, 0.6, 0.75, 0.88, 1.0, 1.08, 1.1, 1.1)
    most, steps = 1.1, 12


_SPEED = 343.2


@dataclass(frozen=True)
class Porous(Absorber, row="porous"):
    """Describe a missing porous layer on a rigid wall, by thickness and flow resistivity (Miki 1990).

    Sound in the layer travels only across it (local reaction), and arrives diffusely at angles up to
    78°. For fabric in front of an airspace see `Curtain`.
    """

    largest_share, stands_on = 0.5, SURFACES
    least, steps = 0.1, 7
    parameters = {
        "thickness": Parameter((0.01, 0.018, 0.033, 0.06, 0.11, 0.2), (1e-4, 10.0), "m"),
        "flow_resistivity": Parameter((4e3, 12e3, 40e3), (1.0, 1e9), "Pa s/m²"),
    }

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha of the layer at diffuse incidence, (n_bands,)."""
        # Averaged over the octave, as a measurement averages the narrow resonance of a thin layer.
        inside = frequencies[:, None] * 2.0 ** np.array([-0.33, 0.0, 0.33])
        ratio = inside / parameters["flow_resistivity"]
        k = 2 * np.pi * inside / _SPEED
        impedance = 1 + 0.0699 * ratio**-0.632 - 1j * 0.1071 * ratio**-0.632
        number = k * (1 + 0.1093 * ratio**-0.618 - 1j * 0.1597 * ratio**-0.618)
        z = -1j * impedance / np.tan(number * parameters["thickness"])
        angles = np.linspace(0, np.radians(78), 40)
        return _statistical(z[..., None] * np.cos(angles), angles)


_MASS = 0.4  # surface mass of the fabric in kg/m²: velour and molton have 0.3 to 0.5
_IMPEDANCE_OF_AIR = 413.0


@dataclass(frozen=True)
class Curtain(Absorber, row="curtain"):
    """Describe a missing curtain by flow resistance and airspace (Ingard 1994; Kuttruff 2016).

    The impedance of the fabric is its flow resistance r in parallel with that of its mass, i omega m; m
    is 0.4 kg/m². Behind the fabric is the impedance -i cot(k d cos theta) / cos theta of plane waves in
    an airspace of depth d. If d is large, the mean over a band is that of a curtain far from any wall.
    """

    largest_share, stands_on = 0.5, ("wall",)
    least, steps = 0.1, 7
    parameters = {
        "airspace": Parameter((0.05, 0.17, 0.6), (1e-3, 100.0), "m"),
        "flow_resistance": Parameter((0.4, 1.0, 2.5), (1e-3, 1e3), "ρc"),
    }

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha of the curtain at diffuse incidence, averaged over each octave, (n_bands,)."""
        inside = frequencies[:, None, None] * 2.0 ** np.linspace(-0.45, 0.45, 9)[:, None]
        omega, resistance = 2 * np.pi * inside, parameters["flow_resistance"]
        mass = 1j * omega * _MASS / _IMPEDANCE_OF_AIR
        fabric = resistance * mass / (resistance + mass)
        angles = np.radians(np.linspace(1, 78, 30))
        cosine = np.cos(angles)
        phase = omega / _SPEED * parameters["airspace"] * cosine
        return _statistical((fabric - 1j / (np.tan(phase) * cosine)) * cosine, angles)


@dataclass(frozen=True)
class Resonator(Absorber, row="resonator"):
    """Describe a missing resonance absorber by its frequency f0 and quality factor Q.

    alpha(f) = 0.8 / (1 + Q² (f/f0 - f0/f)²), averaged over each octave (Cox & D'Antonio).
    """

    least, steps = 0.1, 6
    parameters = {
        "resonance": Parameter(np.geomspace(60, 500, 8).tolist(), (1.0, 1e5), "Hz"),
        "quality": Parameter((0.8, 1.6, 3.5), (0.01, 1e3)),
    }

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha of the resonator, averaged over each octave, (n_bands,)."""
        return _resonance(frequencies, parameters["resonance"], parameters["quality"], 0.8)


_PEAK, _QUALITY = 0.55, 1.2
"""Of a panel: alpha at the resonance, of which catalogues have 0.3 to 0.7 for plywood and plasterboard
before air, and the quality factor, since these absorb over two octaves."""


@dataclass(frozen=True)
class Membrane(Absorber, row="membrane"):
    """Describe a missing panel in front of an airspace, such as plywood on battens.

    It resonates at 60 / sqrt(m d) Hz, with the mass m in kg/m² and the airspace d in m (Cox &
    D'Antonio). At the resonance alpha is 0.55.
    """

    largest_share = 0.5
    least, steps = 0.1, 6
    parameters = {
        "mass": Parameter((5.0, 10.0), (1e-3, 1e4), "kg/m²"),
        "airspace": Parameter((0.02, 0.06, 0.2), (1e-4, 10.0), "m"),
    }

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha of the panel, averaged over each octave, (n_bands,)."""
        resonance = 60 / (parameters["mass"] * parameters["airspace"]) ** 0.5
        return _resonance(frequencies, resonance, _QUALITY, _PEAK)


_MATERIAL = Parameter(within=(0.0, inf), discrete=True, most_in=lambda room: room.n_materials - 1.0)
"""Number of a material, from 0 for the room's first."""


class WrongStatement(Effect):
    """Describe a wrong input value of the room; ``material``, if it has one, is a material's number."""

    def contradicts(self, room: Room) -> bool:
        """Return True, because the effect replaces an input value."""
        return True


@dataclass(frozen=True)
class CoveredSurface(WrongStatement, row="covered surface"):
    """Describe a hard cover over a share of one material; the covered share has alpha = 0.04."""

    parameters = {
        "material": _MATERIAL,
        "share": Parameter(within=(0.0, 1.0), unit=_COVERED),
    }
    removable, stands_on = True, SURFACES
    shares = (0.12, 0.2, 0.33, 0.55, 0.9)

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return 0.12 to 0.9 of each material that absorbs twice as much as the cover."""
        middle = np.where(state.walls, state.alpha.mean(1), 0.0)
        rows = np.flatnonzero(middle > 2 * HARD)
        rows = rows if len(rows) else np.array([int(np.argmax(middle))])
        return [{"material": float(j), "share": s} for j, s in product(rows, self.shares)]

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return the cover's alpha, (n_bands,), as the only combination of parameters."""
        return [({}, np.full(len(frequencies), HARD))]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with this share of the material covered."""
        alpha, row = np.array(state.alpha), int(parameters["material"])
        share = parameters["share"]
        alpha[row] = (1 - share) * alpha[row] + share * np.minimum(HARD, alpha[row])
        return replace(state, alpha=alpha)


@dataclass(frozen=True)
class WrongArea(WrongStatement, row="area"):
    """Describe a wrong area or number of pieces of a material, by the ratio of true to input value."""

    parameters = {"material": _MATERIAL, "ratio": Parameter(within=RATIOS)}
    NUMBER: ClassVar[str] = "number"  # name in print of a wrong number of pieces
    OF_NUMBER: ClassVar[str] = "of the input number"  # unit of its ratio

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the combinations to try: each material with 0.35 to 2.9 times its input area."""
        ratios = [r for r in np.geomspace(0.35, 2.9, 12) if abs(r - 1) > 0.05]
        both = product(range(len(state.areas)), ratios)
        return [{"material": float(j), "ratio": float(r)} for j, r in both]

    def title(self, parameters: Parameters, room: Room) -> str:
        """Return the effect's name for a sentence: ``area of "plaster"``, ``number of "persons"``."""
        said = super().title(parameters, room)
        pieces = self.material(parameters, room) in room.pieces
        return said.replace(self.name, self.NUMBER, 1) if pieces else said

    def unit_in(self, parameters: Parameters, room: Room) -> str:
        """Return the unit of the ratio: "of the input area", or for pieces "of the input number"."""
        pieces = self.material(parameters, room) in room.pieces
        return self.OF_NUMBER if pieces else self.unit

    def density(self, parameters: Mapping[str, Array], state: RoomState) -> Array | float:
        """Return the density of ratios before the measurement: ln ratio is normal with sigma = 0.5."""
        return np.asarray(np.exp(-0.5 * (np.log(parameters["ratio"]) / 0.5) ** 2))

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the other area."""
        areas = state.areas.copy()
        areas[int(parameters["material"])] *= parameters["ratio"]
        return replace(state, areas=areas)


_LAST = 500.0  # decay of the energy in nepers after which it is too little for a double number


@dataclass(frozen=True)
class WrongVolume(WrongStatement, row="volume"):
    """Describe a wrong input volume, by the ratio of the true volume to the input volume.

    Most wrong volumes are gross mistakes with a typical ratio (`FACTORS`): half of the room was not
    drawn, a length is wrong, or feet were taken for metres. The others are small errors with the
    standard deviation of the input volume (`RoomState.volume_sigma`).
    """

    parameters = {"ratio": Parameter(within=RATIOS)}
    FACTORS: ClassVar[Mapping[float, float]] = {
        **{2.0: 0.35, 3.0: 0.05, 4.0: 0.025, 8.0: 0.05, 35.3: 0.0125, 1000.0: 0.0125}
    }
    """Factors of gross mistakes, with their shares of all gross mistakes: half or a third of the room,
    lengths twice as large, cubic feet, and another wrong unit. The inverse factors have the same
    shares."""
    GROSS: ClassVar[float] = 0.9
    """Probability that a wrong volume is a gross mistake, and not a small error."""
    WIDTH: ClassVar[float] = 0.05
    """Standard deviation of the ln of a gross mistake about the ln of its factor."""
    UNEVEN: ClassVar[float] = 0.01
    """Factor on the probability of a volume two to four times as large, where the directions of
    surfaces are unknown: an uneven sound field, which cannot be tried then, lengthens T as much."""
    steps: ClassVar[int] = 18

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the ratios to try: within four standard deviations of 1, and near gross mistakes."""
        near = self.near(state)
        about = self._mistakes()[:, np.newaxis] + self.WIDTH * np.linspace(-3, 3, self.steps // 2)
        end = np.log(near[-1]["ratio"]) + self.WIDTH
        # With less, sound ends before 80 ms, and there is no C80.
        shortest = np.log(0.08 * state.rate.max() / _LAST)
        far = [x for x in sorted({*about.ravel().tolist()}) if abs(x) > end and x > shortest]
        every = [*near, *({"ratio": float(np.exp(x))} for x in far)]
        return sorted(every, key=lambda theta: theta["ratio"])

    def near(self, state: RoomState) -> list[Parameters]:
        """Return volume ratios within four standard deviations of 1."""
        ratios = np.exp(state.volume_sigma * np.linspace(-4, 4, self.steps))
        return [{"ratio": r} for r in ratios.tolist()]

    def _mistakes(self) -> Array:
        """Return ln of the factors of gross mistakes, and of their inverses."""
        logs = np.log([*self.FACTORS])
        return np.concatenate([logs, -logs])

    def density(self, parameters: Mapping[str, Array], state: RoomState) -> Array | float:
        """Return the density of ln ratio before the measurement, not normalised."""
        logs = np.log(parameters["ratio"])

        def normal(about: Array | float, sigma: float) -> Array:
            return np.asarray(np.exp(-0.5 * ((logs - about) / sigma) ** 2) / sigma)

        shares = np.tile([*self.FACTORS.values()], 2)
        mistakes = self._mistakes()
        if not state.directions_known:
            shares = np.where((mistakes > 0) & (mistakes < np.log(5)), self.UNEVEN * shares, shares)
        of_mistakes = np.sum(
            [s * normal(x, self.WIDTH) for s, x in zip(shares, mistakes, strict=True)], axis=0
        )
        right = normal(0.0, state.volume_sigma)
        return np.asarray((1 - self.GROSS) * right + self.GROSS * of_mistakes)

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the other volume."""
        return replace(state, volume=state.volume * parameters["ratio"])


@dataclass(frozen=True)
class WrongFormula(WrongStatement, row="formula"):
    """Describe another reverberation equation than the model's: Sabine's, Eyring's or Millington's."""

    # Kuttruff's is left out: it needs the variance of the path lengths, which no case states.
    EQUATIONS: ClassVar[Sequence[type[MeanEquation]]] = (Sabine, Eyring, Millington)
    parameters = {
        "equation": Parameter(
            within=(0.0, len(EQUATIONS) - 1.0),
            words=[f"{e.name}'s equation" for e in EQUATIONS],
            discrete=True,
        )
    }
    in_geometry = True  # it computes no equation

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return each of these equations that the model does not use."""
        keys = [equation.key for equation in self.EQUATIONS]
        return [{"equation": float(i)} for i, key in enumerate(keys) if key != state.equation]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the other equation."""
        return replace(state, equation=self.EQUATIONS[int(parameters["equation"])].key)


@dataclass(frozen=True)
class CoupledRoom(Effect, row="coupled room"):
    """Describe a missing second room behind an aperture (`CoupledDecay`)."""

    alone, formula_error = False, 0.35
    # A room of 1 l or more that reflects something.
    parameters = {
        "aperture": Parameter(within=(0.0, LARGEST), unit="m²", most_in=_all_surfaces),
        "volume": Parameter(within=(1e-3, 1e8), unit="m³"),
        "alpha": Parameter(within=(0.0, 0.999)),
    }
    removable = takes_wall = True
    stands_on = ("wall", "ceiling")
    not_in_simulator = "the simulator has no second room; draw it in its geometry"

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return apertures of 0.05 to 1.2 times the room's absorption, and second rooms behind them."""
        apertures = np.geomspace(0.05, 1.2, 8) * middle_absorption(state)
        volumes = np.geomspace(0.2, 3, 4) * state.volume
        every = product(apertures.tolist(), volumes.tolist(), np.geomspace(0.02, 0.3, 4).tolist())
        return [dict(zip(self.parameters, values, strict=True)) for values in every]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room coupled to the second one."""
        return replace(state, shape=CoupledDecay(**parameters))


@dataclass(frozen=True)
class CoupledDecay:
    """Describe the decay of a room with a second room behind an aperture (Kuttruff 2016, Sect. 5.8).

    The second room has a ``volume`` V2 in m³, a mean absorption coefficient ``alpha``, and the surface
    area of a cube. The ``aperture`` S is in m². E1 and E2 are the energy densities in the rooms, A1 and
    A2 their absorption areas. Then V1 dE1/dt = -(c/4) (A1 + S) E1 + (c/4) S E2, and the same with 1 and
    2 exchanged (Cremer & Mueller 1982).
    """

    aperture: float
    volume: float
    alpha: float

    @staticmethod
    def together(states: Sequence[RoomState], shapes: Sequence[CoupledDecay]) -> Decay:
        """Return the decays of n states of a room, each with its own second room, (n, n_bands, 2)."""
        c, opening = speeds(states)[:, None], np.ones_like(states[0].frequencies)
        aperture, volume, alpha = (
            np.array([[getattr(s, name)] for s in shapes])
            for name in ("aperture", "volume", "alpha")
        )
        first_volume = np.array([[s.volume] for s in states])
        air = np.array([s.air for s in states])
        first = rates(covered(states, aperture[:, 0], np.tile(opening, (len(states), 1))))
        absorbed = -np.log1p(-alpha) * 6 * volume ** (2 / 3) + 4 * air * volume + aperture
        second = c * absorbed / (4 * volume)
        # The exchange is symmetric in E1 sqrt(V1) and E2 sqrt(V2).
        cross = c * aperture / (4 * np.sqrt(first_volume * volume))
        middle, half = (first + second) / 2, (first - second) / 2
        root = np.sqrt(half**2 + cross**2)
        both = np.stack([middle - root, middle + root], axis=-1)
        share = np.clip(0.5 * (1 + half / root), 0, 1)  # of E1 in the faster term
        weights = np.stack([1 - share, share], axis=-1) / first_volume[:, :, None]
        return Decay(weights, np.maximum(both, 1e-3))


@dataclass(frozen=True)
class NonDiffuse(Effect, row="non-diffuse field"):
    """Describe a non-diffuse field (`DirectionalDecay`), by the scattering coefficient of the walls."""

    alone, formula_error = False, 0.35
    parameters = {"scattering": Parameter(np.geomspace(0.01, 0.3, 9).tolist(), (0.0, 1.0))}
    needs_directions = True
    not_in_simulator = None  # with geometry it has such a field by itself

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with this scattering."""
        return replace(state, shape=DirectionalDecay(**parameters))


@dataclass(frozen=True)
class NoiseFloor(Effect, row="noise floor"):
    """Describe background noise in the measured decays that was not subtracted (ISO 3382-1).

    The integrated decay is then S(t) + N (t_end - t), with the noise power N and the end t_end of the
    response. Its length is the parameter ``record``, in reverberation times.
    """

    parameters = {
        "level": Parameter(np.linspace(-62, -30, 17).tolist(), (-200.0, 0.0), "dB"),
        "record": Parameter((1.5, 2.5), (0.1, 100.0), "times T", label="length of the responses"),
    }
    not_in_simulator = "a simulator's decay has no noise; take the noise off the measurement"

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with this noise in its decays."""
        return replace(state, floor_db=parameters["level"], record=parameters["record"])


@dataclass(frozen=True)
class DirectSound(Effect, row="direct sound"):
    """Describe a directional source, by the change of its direct sound in dB; T does not change."""

    # The limits are beyond any loudspeaker's directivity.
    parameters = {
        "gain": Parameter((-9.0, -6.0, -4.0, -2.0, 2.0, 4.0, 6.0, 9.0), (-40.0, 40.0), "dB")
    }
    not_in_simulator = None  # its source has a directivity of its own

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the state of the room with the direct sound changed by this number of dB."""
        return replace(state, direct_db=state.direct_db + parameters["gain"])


def library() -> tuple[Effect, ...]:
    """Return every effect that rtcal can try when it looks for what is missing from a model."""
    of_absorption = (OmittedAir, Opening, Audience, People, Furniture, Porous, Curtain, Resonator)
    others = (Membrane, CoveredSurface, WrongArea, WrongVolume, WrongFormula, CoupledRoom)
    kinds: tuple[type[Effect], ...] = (*of_absorption, *others, NonDiffuse, NoiseFloor, DirectSound)
    return tuple(kind() for kind in kinds)


# Checks of effects, which may be a user's own.


T = TypeVar("T")
_RULES = {
    "areas": (0.0, inf),
    "alpha": (0.0, 1.0),
    "air": (0.0, inf),
    "covering": (-inf, inf),
    "objects": (-inf, inf),
    "volume": (1e-6, inf),
    "speed_of_sound": (1e-6, inf),
    "record": (1e-6, inf),
    "direct_db": (-inf, inf),
    "floor_db": (-inf, inf),
}
"""Least and largest values of the fields of a state that are numbers."""
_MORE = 4  # sizes by which a grid goes on at once
IN_RUN = "a geometrical program computes none"
"""Reason, as a sentence, why an effect is not tried if a geometrical program simulated the model."""


def _rule(least: float, most: float) -> str:
    if np.isinf(least):
        return "finite"
    return f"finite and {least:g} or more" if np.isinf(most) else f"from {least:g} to {most:g}"


def _refuse(
    where: str,
    values: Any,
    shapes: Sequence[tuple[int, ...]],
    least: float,
    most: Any,
    labels: Sequence[str] = (),
) -> None:
    """Raise DataError for numbers of none of some ``shapes``, or outside their ends.

    ``most`` may be an array. ``labels`` are the names of the places along the last axis.
    """
    found = np.asarray(values)
    if found.dtype.kind not in "fiu" or found.shape not in shapes:
        raise DataError(f"{where} has shape {found.shape}; it must have {shapes[0]}")
    within = np.isfinite(found) & (found >= least) & (found <= most)
    if not within.all():
        at = tuple(np.argwhere(~within)[0])
        place = f" at {labels[at[-1]]}" if labels else ""
        rule = _rule(least, float(np.broadcast_to(most, found.shape)[at]))
        raise DataError(f"{where}{place} = {found[at]:.6g} must be {rule}")


def _run(where: str, call: Callable[[], T], parameters: Parameters | None = None) -> T:
    """Call a user's code; report whatever it raises in one line that names the effect."""
    try:
        return call()
    except RtcalError:
        raise
    except Exception as error:  # a user's code may raise anything
        what = " ".join(str(error).split())
        with_what = "" if parameters is None else f" with {', '.join(parameters) or 'no parameter'}"
        raise DataError(f"{where}{with_what} raises {type(error).__name__}: {what}") from error


def checked_effects(effects: object | None) -> tuple[Effect, ...]:
    """Return effects as a tuple, by default the library; DataError for an incomplete one."""
    if effects is None:
        return library()
    every: tuple[Any, ...] = checks.listed("effects", effects)
    if not every:
        raise DataError("effects is empty; give at least one")
    for i, effect in enumerate(every):
        _check(f"effects[{i}]", effect)
    names = [effect.name for effect in every]
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise DataError(f'effects has "{twice}" twice; give each effect a name of its own')
    return every


def _check(place: str, effect: Any) -> None:
    if not isinstance(effect, Effect):
        hint = f"; write {effect.__name__}()" if isinstance(effect, type) else ""
        raise DataError(f"{place} = {effect!r} is not an effect (rtcal.finder.Effect){hint}")
    for name in ("name", "size", "unit"):
        text = getattr(effect, name, None)
        blank = name != "unit" and not str(text).strip()
        if not isinstance(text, str) or blank or not text.isprintable():
            raise DataError(f"{place} = {effect!r}: {name} = {text!r} must be a text of one line")
    if effect.name in ("none", "unknown"):
        raise DataError(f'{place}: name = "{effect.name}" must not be the name of a verdict')
    where = f'effect "{effect.name}"'
    checks.number(f"{where}: neutral", effect.neutral)
    _refuse(f"{where}: size_error", checks.number(where, effect.size_error), [()], 0.0, inf)
    checks.flag(f"{where}: removable", effect.removable)
    for name, of in checks.mapped(f"{where}: parameters", effect.parameters).items():
        checks.instance(f"{where}: parameters[{name!r}]", of, Parameter)
    for kind in checks.listed(f"{where}: stands_on", effect.stands_on):
        checks.choice(f"{where}: stands_on", kind, SURFACES)
    for share in checks.listed(f"{where}: shares", effect.shares):
        checks.between(f"{where}: shares", share, 0.0, 1.0)


def judged_effects(
    effects: Sequence[Effect], directions_known: bool, geometrical: bool = False
) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that can be tried in a room, and why the others cannot, by name.

    Not tried are those that need unknown directions of surfaces, or that the geometrical program
    which simulated the model includes. Raises DataError if no effect is left.
    """
    lacking = {e.name: NOT_KNOWN for e in effects if e.needs_directions and not directions_known}
    lacking |= {e.name: IN_RUN for e in effects if e.in_geometry and geometrical}
    tried = tuple(e for e in effects if e.name not in lacking)
    if not tried:
        whys = "; ".join(dict.fromkeys(lacking.values()))
        raise DataError(
            f"rtcal cannot search for {', '.join(lacking)}, and no other effect is left: {whys}"
        )
    return tried, lacking


def columns(grid: Sequence[Parameters]) -> dict[str, Array]:
    """Return the values of each parameter by name, (n,) each, from n combinations of values."""
    return {name: np.array(list(map(itemgetter(name), grid))) for name in grid[0]}


def checked_grid(
    effect: Effect, state: RoomState, room: Room | None = None
) -> Sequence[Parameters]:
    """Return the parameter sets that an effect tries in a room, after a check.

    Sets outside the limits in this ``room`` (None: in any room) are left out, unless all are.
    Raises DataError for an empty grid, and for a set without the size or with other names or values
    than finite ones.
    """
    where = f'effect "{effect.name}": grid'
    grid = checks.listed(where, _run(where, lambda: effect.grid(state)))
    if not grid:
        raise DataError(f"{where} is empty; give at least one set of parameters")
    names = set(checks.mapped(where, grid[0]))
    if effect.size not in names:
        raise DataError(f'{where}: the parameter "{effect.size}", the effect\'s size, is missing')
    for theta in grid:
        if not isinstance(theta, Mapping) or set(theta) != names:
            raise DataError(
                f"{where} has {theta!r}; each entry must have {', '.join(map(str, names))}"
            )
    within, limits = np.ones(len(grid), dtype=bool), _limits(effect, room)
    for name, values in columns(grid).items():
        checked = checks.array(f"{where}: {name}", values)
        _refuse(f"{where}: {name}", checked, [within.shape], -inf, inf)
        least, most = limits.get(name, (-inf, inf))
        within &= (checked >= least) & (checked <= most)
    return [grid[i] for i in np.flatnonzero(within)] or grid


def beyond(
    effect: Effect, grid: Sequence[Parameters], likeliest: Parameters, room: Room
) -> list[Parameters]:
    """Return the parameter sets with up to four further sizes, if the last size fits best.

    They go on in the same steps within the limits of the ``room``, but not where the effect
    vanishes.
    """
    every, value = list(grid), likeliest[effect.size]
    sizes = np.unique([theta[effect.size] for theta in grid])
    if not isfinite(effect.neutral) or effect.size in effect.discrete or len(sizes) < 2:
        return every
    limits = _limits(effect, room).get(effect.size, (-inf, inf))
    logs = sizes[0] > 0
    for end, inner in ((-1, -2), (0, 1)):
        away = (sizes[end] - effect.neutral) * (sizes[end] - sizes[inner]) > 0
        if value == sizes[end] and away and value not in limits:
            last, inside = (np.log(sizes[[end, inner]])) if logs else sizes[[end, inner]]
            more = last + (last - inside) * np.arange(1, _MORE + 1)
            more = np.unique(np.clip(np.exp(more) if logs else more, *limits))
            at_end = [theta for theta in grid if theta[effect.size] == value]
            every += [{**theta, effect.size: float(s)} for theta in at_end for s in more]
    return every


def check_parameters(
    effect: Effect,
    parameters: Parameters,
    room: Room | None = None,
    interval: tuple[float, float] | None = None,
) -> None:
    """Raise DataError if a parameter, or an end of the size's interval, is outside its limits."""
    where, limits = f'effect "{effect.name}"', _limits(effect, room)
    place = "" if room is None else f' in "{shortened(room.name)}"'
    for name, (least, most) in limits.items():
        if name not in parameters:
            raise DataError(f'{where} has no "{name}"; it must have {", ".join(limits)}')
        ends = interval if name == effect.size and interval is not None else ()
        for i, value in enumerate((parameters[name], *ends)):
            if not (isfinite(value) and least <= value <= most):
                what = "size_interval" if i else name
                unit = effect.parameters.get(name, Parameter()).unit
                rule = _rule(least, most) + f" ({unit})" * bool(unit)
                raise DataError(f"{where}: {what} = {value:g} must be {rule}{place}")
        if name in effect.discrete and parameters[name] != int(parameters[name]):
            raise DataError(f"{where}: {name} = {parameters[name]:g} must be a whole number")


def _limits(effect: Effect, room: Room | None) -> Limits:
    where = f'effect "{effect.name}": limits'
    return checks.mapped(where, _run(where, lambda: effect.limits(room)))


def changed_states(effect: Effect, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
    """Return the states of a room with an effect, by parameter set; DataError for an impossible one."""
    where, state = f'effect "{effect.name}"', state.locked()
    made = added(effect, state, grid)
    for theta, after in zip(grid, made, strict=True):
        checks.instance(f"{where}: change returns {type(after).__name__}, which", after, RoomState)
        if after.equation is not state.equation:
            mean_equation(after.equation, f"{where}: change: equation")
        _check_shape(f"{where}: shape", after, state)
        for name, (least, most) in _RULES.items():
            value = getattr(after, name)
            if value is getattr(state, name) or value is None:
                continue
            usual = np.shape(getattr(state, name))
            ends: Any = most
            if name == "alpha" and state.walls is not True:  # pieces may have more than 1
                ends = np.where(state.walls, most, LARGEST_PIECE)[:, np.newaxis]
            shapes = (
                [usual, np.shape(state.air), ()] if name in ("covering", "objects") else [usual]
            )
            with_what = ", ".join(f"{k} = {v:.3g}" for k, v in theta.items())
            _refuse(f"{where}: change, with {with_what}: {name}", value, shapes, least, ends)
    return made


def _check_shape(where: str, after: RoomState, state: RoomState) -> None:
    """Raise DataError for a shape of the decay that is no function, or returns no possible `Decay`."""
    shape: Any = after.shape
    if shape is None or shape is state.shape or hasattr(shape, "together"):
        return
    if not callable(shape):
        raise DataError(
            f"{where} = {shape!r} must be a function of a RoomState that returns a Decay"
        )
    decay = checks.instance(f"{where} returns", _run(where, lambda: shape(after)), Decay)
    weights, rates = (checks.array(f"{where}: {n}", v) for n, v in vars(decay).items())
    n_bands = len(after.frequencies)
    fits = (n_bands, *weights.shape[1:2])
    _refuse(f"{where}: weights", weights, [fits], -inf, inf)
    _refuse(f"{where}: rates", rates, [fits], np.nextafter(0, 1), inf)


def added(effect: Effect, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
    """Return the states of a room with an effect as `changed_states` does, without checking them."""
    where, locked = f'effect "{effect.name}": change', state.locked()
    return _run(where, lambda: effect.changes(locked, grid), grid[0])


@dataclass(frozen=True)
class AppliedEffect:
    """Hold an effect that was added to a model, its parameters and the 90 % interval of its size.

    ``effect`` is an `Effect`, or the name of one in the library. Raises DataError for an unknown name,
    and for a parameter that is missing or outside the effect's limits (`Effect.limits`).
    """

    effect: Any
    """Effect, given by its name in the library or as an object. A case with an effect that is not in
    the library cannot be saved."""
    parameters: Mapping[str, float]  # values of the effect's parameters, by name
    size_interval: tuple[float, float] | None = None  # 90 % interval of the effect's size

    def __post_init__(self) -> None:
        effect: Any = self.effect
        if not isinstance(effect, Effect):
            name = checks.text("effect: name", effect)
            effect = next((e for e in library() if e.name == name), None)
            if effect is None:
                raise DataError(f'effect "{name}" is not in rtcal\'s library')
            put(self, effect=effect)
        for name, value in checks.mapped("effect: parameters", self.parameters).items():
            checks.number(f"effect: parameters[{name!r}]", value)
        if self.size_interval is not None:
            ends = checks.array("effect: size_interval", self.size_interval)
            if ends.shape != (2,) or not ends[0] <= ends[1]:
                raise DataError(
                    f"effect: size_interval = {self.size_interval!r} must be two numbers, "
                    "the smaller one first"
                )
        check_parameters(effect, self.parameters, interval=self.size_interval)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return str(self.effect.name)

    @property
    def size(self) -> float:
        """Value of the parameter that gives the amount of the effect."""
        return float(self.parameters[self.effect.size])

    def resized(self, size: float) -> AppliedEffect:
        """Return the effect with another size."""
        return replace(self, parameters={**self.parameters, self.effect.size: size})

    @property
    def size_sigma(self) -> float:
        """Standard deviation of the effect's size, from its 90 % interval; 0 without an interval."""
        if self.size_interval is None:
            return 0.0
        return (self.size_interval[1] - self.size_interval[0]) / (2 * NORMAL_90)

    def to_dict(self) -> dict[str, Any]:
        """Return the effect as plain values for JSON."""
        ends = None if self.size_interval is None else list(self.size_interval)
        return {"effect": self.name, "parameters": dict(self.parameters), "size_interval": ends}
