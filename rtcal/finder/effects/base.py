"""The base class of the effects, and functions that several effects share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.room import LARGEST, Room
from rtcal.finder.model import RoomState, covered
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

Parameters = Mapping[str, float]
Kind = tuple[tuple[str, float], ...]
"""The parameters of an absorber but for its size."""
Limits = Mapping[str, tuple[float, float]]
"""Least and largest possible value of each parameter."""


class Effect(ABC):
    """Something that a model may lack.

    An effect states its parameters (`grid`), how it changes a room's state (`change`), its words, its
    form in a corrected room and its form in the QP. A new effect is a subclass in one file and one
    line in `library`.

    Attributes
    ----------
    name : str
    size : str
        The parameter that says how much of the effect there is.
    unit : str
        The size's unit, as text that follows the value.
    neutral : float
        The size that changes nothing. NaN where there is none: the effect then has no size interval.
    removable : bool
        Whether it can be taken out of the room.
    discrete : sequence of str
        Parameters without values between those of the grid.
    size_error : float
        Standard deviation of ln size that the effect's physics leaves open (of the size itself where
        it can be negative): where an opening is, how an object scatters. Chosen on the development
        rooms (benchmarks/studies/hidden_world, population 0), so that 90 % intervals hold the true
        size.
    parameter_units : mapping of str to str
        Units of the parameters, as text that follows the value.
    parameter_values : mapping of str to sequence of str
        Words for the values 0, 1, ... of a discrete parameter.
    family : str
        The effects that change the measurement alike; "added absorption, ..." names three of one kind.
    alone : bool
        Whether the effect is claimed by its own name. Otherwise its family is: in development rooms of
        benchmarks/studies/second_world, a coupled room and a non-diffuse field pass for each other at
        any probability, since both formulas are rough.
    odds : float
        Prior odds against the other effects of the library, most of which have 1.
    spectrum_error : (float, float, float)
        Standard deviations of the relative error of the effect's change: common to all bands, a tilt
        per octave from 1 kHz, and rough, of which half is left an octave away.
    formula_error : float
        Standard deviation of the relative error of the change of each feature by itself: errors of the
        formula that no two features share. From the prototype, of half of a variance of 0.15².
    largest_share : float
        Largest share of all surfaces that the effect is believed to take.
    stands_on : sequence of str
        The kinds of surfaces on which it may stand, of "floor", "wall" and "ceiling". With positions it
        is sought on each of them; an effect without any is sought by means over positions alone.
    shares : sequence of float
        Shares of a surface that are tried, of an effect that takes absorption away from it.
    needs_directions : bool
        Whether it acts by the directions in which surfaces face. In a room of which nothing says them
        it is not judged.
    not_in_simulator : str or None
        Why a simulator of a room cannot have the effect; None where it can, or has it already. Asked
        only of effects that no material can represent.
    """

    name: ClassVar[str]
    size: ClassVar[str]
    unit: ClassVar[str]
    neutral: ClassVar[float] = 0.0
    removable: ClassVar[bool] = False
    discrete: ClassVar[Sequence[str]] = ()
    size_error: ClassVar[float] = 0.25
    parameter_units: ClassVar[Mapping[str, str]] = {}
    parameter_values: ClassVar[Mapping[str, Sequence[str]]] = {}
    family: ClassVar[str] = "of your own"
    alone: ClassVar[bool] = True
    odds: ClassVar[float] = 1.0
    formula_error: ClassVar[float] = 0.106
    largest_share: ClassVar[float] = 0.25
    stands_on: ClassVar[Sequence[str]] = ()
    shares: ClassVar[Sequence[float]] = ()
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.106, 0.0, 0.0)
    needs_directions: ClassVar[bool] = False
    not_in_simulator: ClassVar[str | None] = (
        "it bends the decay, which no material of a simulator does; without make the case's own "
        "model is the simulator"
    )

    @abstractmethod
    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the parameters to try."""

    @abstractmethod
    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the effect in it."""

    def changes(self, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
        """Return the room with the effect in it, for each set of parameters."""
        return [self.change(state, theta) for theta in grid]

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return what may stand on a surface: parameters without a size, and alpha, (n_bands,)."""
        return []

    def density(self, parameters: Parameters, state: RoomState) -> float:
        """Return the prior density of the parameters, but for a factor: 1 everywhere.

        It is a density per unit of ln of each parameter that is above 0, and of any other parameter
        itself; of a discrete parameter, a probability.
        """
        return 1.0

    def densities(self, grid: Sequence[Parameters], state: RoomState) -> Array:
        """Return the `density` of each set of parameters, (n,)."""
        return np.array([self.density(theta, state) for theta in grid], dtype=float)

    def limits(self, room: Room | None) -> Limits:
        """Return where the physics of the parameters ends, in this room; None: in any room.

        A size is sought and stated within them, and a case refuses parameters outside. A parameter
        that is not among them may have any value; by default, none is.
        """
        return {}

    def size_limits(self, room: Room) -> tuple[float, float]:
        """Return the least and the largest possible size in this room."""
        return self.limits(room).get(self.size, (-np.inf, np.inf))

    def prior_odds(self, room: Room) -> float:
        """Return the prior odds of the effect in this room, against the others: `odds`."""
        return self.odds

    def wall_area(self, parameters: Parameters) -> float:
        """Return the area of wall in m² that the effect takes; 0 where it takes none."""
        return 0.0

    def title(self, parameters: Parameters, room: Room) -> str:
        """Return the effect's name in a sentence."""
        return self.name

    def material(self, parameters: Parameters, room: Room) -> str | None:
        """Return the material that the parameters refer to, None without one."""
        return None

    def describe(self, parameters: Parameters, without: str = "") -> str:
        """Return the parameters in words, except the one named ``without``."""
        return ", ".join(
            self._described(name, value) for name, value in parameters.items() if name != without
        )

    def _described(self, name: str, value: float) -> str:
        words = self.parameter_values.get(name, ())
        if value in range(len(words)):
            return words[int(value)]
        return f"{name.replace('_', ' ')} {value:.3g}{self.parameter_units.get(name, '')}"

    def contradicts(self, room: Room) -> bool:
        """Return whether it replaces what the room states, as an area, instead of adding to it."""
        return False

    def air(self, stated: Air | None, parameters: Parameters) -> Air | None:
        """Return the air of the corrected room."""
        return stated

    def errors_over_bands(self, frequencies: Array) -> Array:
        """Return the relative errors of the effect's change, one standard deviation each.

        (n_bands, 2 + n_bands): common to all bands, a tilt, and those that a rough spectrum has.
        """
        common, tilt, rough = self.spectrum_error
        octaves = np.log2(frequencies / 1000)
        lag = np.abs(np.subtract.outer(octaves, octaves))
        smooth = np.stack([np.full(len(octaves), common), tilt * octaves], axis=1)
        return np.concatenate([smooth, rough * np.linalg.cholesky(0.5**lag)], axis=1)

    def error_over_bands(self, frequencies: Array) -> Array:
        """Return the covariance of the relative error of the effect's change, (n_bands, n_bands)."""
        errors = self.errors_over_bands(frequencies)
        return np.asarray(errors @ errors.T)

    def added_absorption(self, without: RoomState, with_effect: RoomState) -> Array | None:
        """Return the absorption area that the effect adds in m², (n_bands,).

        The QP then has the effect's size as an unknown. None, the default, keeps the size fixed: the
        effect changes the QP's target instead.
        """
        return None


class AbsorbingObject(Effect):
    """An effect that adds absorption in proportion to its size, and can be taken out of the room."""

    removable: ClassVar[bool] = True

    def limits(self, room: Room | None) -> Limits:
        """Return 0 or more: objects need no wall."""
        return {self.size: (0.0, np.inf)}

    def added_absorption(self, without: RoomState, with_effect: RoomState) -> Array | None:
        """Return the difference of the absorption areas in m², (n_bands,)."""
        added = with_effect.surface_absorption - without.surface_absorption
        return np.asarray(added + with_effect.objects - without.objects)


class Absorber(AbsorbingObject):
    """A surface with a spectrum of its own in place of wall; a subclass has ``name`` and `spectrum`.

    Areas are tried from ``least`` to ``most`` times the room's absorption area at 500 to 2000 Hz.
    """

    size: ClassVar[str] = "area"
    unit: ClassVar[str] = "m²"
    parameter_units: ClassVar[Mapping[str, str]] = {"area": " m²"}
    stands_on: ClassVar[Sequence[str]] = ("wall", "ceiling")
    least: ClassVar[float] = 0.05
    most: ClassVar[float] = 1.2
    steps: ClassVar[int] = 10

    @abstractmethod
    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha, (n_bands,), which the size does not change."""

    def limits(self, room: Room | None) -> Limits:
        """Return an area from 0 to that of all surfaces."""
        return {self.size: (0.0, all_surfaces(room))}

    def wall_area(self, parameters: Parameters) -> float:
        """Return the absorber's area."""
        return float(parameters[self.size])

    def kinds(self) -> Sequence[Parameters]:
        """Return the grid of the parameters other than the area; a single set without any."""
        return [{}]

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return every kind with its alpha."""
        return [(dict(k), self._checked_alpha(frequencies, k)) for k in self.kinds()]

    def _checked_alpha(self, frequencies: Array, parameters: Parameters) -> Array:
        alpha = self.spectrum(frequencies, parameters)
        return checked_spectrum(self.name, alpha, frequencies)

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return every kind with every area."""
        sizes = np.geomspace(self.least, self.most, self.steps) * middle_absorption(state)
        return [{**kind, self.size: float(a)} for kind, a in product(self.kinds(), sizes)]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the absorber in place of wall."""
        return self.changes(state, [parameters])[0]

    def changes(self, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
        """Return the room with the absorber in place of wall, for each set of parameters."""
        if type(self).change is not Absorber.change:
            return super().changes(state, grid)
        spectra: dict[Kind, Array] = {}
        kinds = [tuple((k, v) for k, v in theta.items() if k != self.size) for theta in grid]
        for kind, theta in zip(kinds, grid, strict=True):
            if kind not in spectra:
                spectra[kind] = self._checked_alpha(state.frequencies, theta)
        areas = np.array([theta[self.size] for theta in grid])
        return covered([state] * len(grid), areas, np.array([spectra[kind] for kind in kinds]))


def checked_spectrum(name: str, alpha: object, frequencies: Array) -> Array:
    """Return an absorber's alpha, (n_bands,), in [0, 1]; DataError naming effect, place and rule."""
    where = f'effect "{name}": spectrum'
    array = checks.array(where, alpha)
    if array.shape != frequencies.shape:
        raise DataError(
            f"{where} has shape {array.shape}; it is (n_bands,) = ({len(frequencies)},)"
        )
    # A comparison with NaN is false, so that NaN is refused too.
    if not (array.min() >= 0 and array.max() <= 1):
        k = int(np.argmin((array >= 0) & (array <= 1)))
        raise DataError(f"{where} at {bands.label(frequencies[k])} = {array[k]:g} is not in [0, 1]")
    return array


def all_surfaces(room: Room | None) -> float:
    """Return the area of all surfaces in m²; of any room, the largest that a room may have."""
    return LARGEST if room is None else room.total_area


def middle_absorption(state: RoomState) -> float:
    """Return S'alpha at 500 to 2000 Hz in m², averaged over bands; over all bands if it has none."""
    area = state.areas @ state.alpha
    middle = bands.is_middle(state.frequencies)
    return float(area[middle].mean() if middle.any() else area.mean())


def interpolate_octaves(frequencies: Array, octaves: Sequence[float]) -> Array:
    """Interpolate values at 63 Hz to 8 kHz, linearly over the logarithm of the frequency."""
    centres = np.log(62.5 * 2.0 ** np.arange(8))
    return np.asarray(np.interp(np.log(frequencies), centres, octaves))
