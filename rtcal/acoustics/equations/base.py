"""The base class of the reverberation equations, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, InfeasibleError, ModelError
from rtcal.support.types import Array

PAPER_SPEED_OF_SOUND = 24 * np.log(10) / 0.164
"""Speed of sound (336.97 m/s) that gives the paper's rounded constant 0.164 s/m. It serves only to
reproduce the paper's numbers."""


@runtime_checkable
class Equation(Protocol):
    """Anything that predicts the reverberation time of a room."""

    name: ClassVar[str]

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""
        ...


@dataclass(frozen=True)
class ReverberationEquation(ABC):
    """Base of rtcal's equations, with the constant 24 ln 10 / c and the air's 4mV.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; from the room's air if it is not given.
    """

    speed_of_sound: float | None = None

    name: ClassVar[str] = ""
    key: ClassVar[str] = ""
    """Name of the equation in commands, cases and saved loops."""

    def __post_init__(self) -> None:
        c = self.speed_of_sound
        if c is not None and not 0 < checks.number("speed_of_sound", c) < np.inf:
            raise DataError(f"speed_of_sound = {c:g} m/s is not finite and above 0")

    @abstractmethod
    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Raise ModelError: T does not determine S'alpha in this equation."""
        raise ModelError(
            f"{self.name}'s equation is not a function of the mean absorption coefficient, so T does "
            "not tell S'alpha; calibrate it in the closed loop with calibrate_simulator"
        )

    def room_constant(self, room: Room) -> float:
        """Return 24 ln 10 / c in s/m."""
        checks.instance("room", room, Room)
        return float(24 * np.log(10) / (self.speed_of_sound or room.speed_of_sound))

    def _time(self, room: Room, absorbed: Array) -> Array:
        """T in s where the surfaces absorb S a = ``absorbed`` m², (..., n_bands); the air is added."""
        total = absorbed + 4 * room.air_attenuation * room.volume
        with np.errstate(divide="ignore"):
            return np.asarray(self.room_constant(room) * room.volume / total)


EQUATIONS: dict[str, type[ReverberationEquation]] = {}
"""Every equation by its key."""

E = TypeVar("E", bound=ReverberationEquation)


def register(equation: type[E]) -> type[E]:
    """Name an equation in `EQUATIONS`; a class decorator."""
    EQUATIONS[equation.key] = equation
    return equation


def equation_keys(kind: type[Any] = ReverberationEquation) -> tuple[str, ...]:
    """Return the keys of the equations that are of one class, in alphabetical order.

    Examples
    --------
    >>> from rtcal.acoustics.equations import LinearEquation
    >>> equation_keys(LinearEquation)
    ('eyring', 'kuttruff', 'sabine')
    """
    return tuple(sorted(key for key, e in EQUATIONS.items() if issubclass(e, kind)))


@dataclass(frozen=True)
class MeanEquation(ReverberationEquation, ABC):
    """An equation whose exponent is a function E of the mean of h(alpha) over the walls.

    E and h are the identity unless an equation defines them. All methods take arrays of any shape,
    element by element.
    """

    largest_alpha: ClassVar[float] = np.inf
    """The coefficient of one wall up to which h is finite in a room model."""

    @property
    def largest_mean(self) -> float:
        """The mean up to which the exponent rises and can be inverted."""
        return np.inf

    @checked
    def contribution(self, alpha: Array) -> Array:
        """Return h(alpha), the contribution of a wall to the mean."""
        return np.asarray(alpha)

    @checked
    def coefficient(self, contribution: Array) -> Array:
        """Return the alpha of a wall with this contribution: the inverse of `contribution`."""
        return np.asarray(contribution)

    @checked
    def contribution_slope(self, alpha: Array) -> Array:
        """Return dh / d alpha."""
        return np.ones_like(alpha)

    @checked
    def exponent(self, mean: Array) -> Array:
        """Return the absorption exponent a = E(mean)."""
        return np.asarray(mean)

    @checked
    def inverse(self, exponent: Array) -> Array:
        """Return the mean that has this exponent, NaN where none has: the inverse of `exponent`."""
        return np.asarray(exponent)

    @checked
    def slope(self, mean: Array) -> Array:
        """Return d exponent / d mean."""
        return np.ones_like(mean)

    @abstractmethod
    def linear(self) -> LinearEquation:
        """Return the equation that a calibration inverts for this one.

        A linear equation returns itself. Any other returns the linear equation that has the same T
        if all coefficients are equal.
        """

    def diffuse_field(self) -> MeanEquation:
        """Return the equation that the T of simulators follows in a diffuse field.

        Itself, unless this equation is theoretically wrong in a diffuse field. The difference between
        a simulator and the returned equation then shows the error of the room's model alone.
        """
        return self

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); infinite where nothing absorbs (Eqs. 1 to 3)."""
        checks.instance("room", room, Room)
        mean = room.areas @ self.contribution(room.alpha) / room.total_area
        return self._time(room, room.total_area * self.exponent(mean))


@dataclass(frozen=True)
class LinearEquation(MeanEquation):
    """An equation in which T depends on alpha only through S'alpha: h(alpha) = alpha.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; from the room's air if it is not given.
    """

    @property
    def largest_mean(self) -> float:
        """The mean coefficient up to which T falls; the inverse covers only this branch."""
        return 1.0

    def linear(self) -> LinearEquation:
        """Return the equation itself."""
        return self

    @checked
    def time(self, room: Room, absorption_area: Array) -> Array:
        """Return T in s for the surfaces' absorption area S'alpha in m², both (..., n_bands)."""
        checks.instance("room", room, Room)
        exponent = self.exponent(absorption_area / room.total_area)
        return self._time(room, room.total_area * exponent)

    @checked
    def target(self, room: Room, t: Array) -> Array:
        """Return b in m², (..., n_bands), for T in s, without a check that the bounds can reach it.

        b is below 0 where T is longer than the air alone allows, and NaN where T is NaN or where
        no mean absorption coefficient has the exponent that T asks for.
        """
        return np.asarray(room.total_area * self.inverse(self.exponent_of_time(room, t)))

    @checked
    def exponent_of_time(self, room: Room, t: Array) -> Array:
        """Return the absorption exponent (k V / T - 4 m V) / S that T in s asks for, (..., n_bands)."""
        with np.errstate(over="ignore"):
            total = self.room_constant(room) * room.volume / np.asarray(t, dtype=float)
        return np.asarray((total - 4 * room.air_attenuation * room.volume) / room.total_area)

    @checked
    def target_sensitivity(self, room: Room, t: Array) -> Array:
        """Return db/dT in m²/s, (n_bands,): negative, since a longer T needs less absorption."""
        t = np.asarray(t, dtype=float)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            total_slope = -self.room_constant(room) * room.volume / t**2
            return np.asarray(total_slope / self.slope(self.target(room, t) / room.total_area))

    @checked
    def air_share(self, room: Room, absorption_area: Array) -> Array:
        """Return the air's share 4mV / (S a + 4mV) of the whole absorption, (n_bands,)."""
        air = 4 * room.air_attenuation * room.volume
        total = room.total_area * self.exponent(absorption_area / room.total_area) + air
        return np.asarray(np.divide(air, total, out=np.zeros_like(air), where=total > 0))

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Return the absorption area b that the surfaces need for T (Eqs. 5 and 6).

        Parameters
        ----------
        room : Room
        t : array (n_bands,)
            Measured T in s; NaN where missing.

        Returns
        -------
        array (n_bands,)
            b in m², from 0 to the total area; NaN where T is.

        Raises
        ------
        DataError
            If T has another shape, is infinite, or is not above 0.
        InfeasibleError
            If no coefficients from 0 to 1 give T; the message says which T would do.
        """
        checks.instance("room", room, Room)
        t = checks.array("T", t)
        if t.shape != (room.n_bands,):
            raise DataError(f"T has shape {t.shape}; the room's bands ask for ({room.n_bands},)")
        for frequency, value in zip(room.centre_frequencies, t, strict=True):
            if np.isinf(value) or value <= 0:
                raise DataError(
                    f"T[{bands.label(frequency)}] = {value:g} s is not finite and above 0"
                )
        b = self.target(room, t)
        longest = self.time(room, np.zeros(room.n_bands))
        top = self.largest_mean * room.total_area
        shortest = self.time(room, np.full(room.n_bands, top))
        for i in range(room.n_bands):
            if np.isnan(t[i]) or 0 <= b[i] <= top * (1 + 1e-15):
                continue
            why = "longer than the air alone allows" if t[i] > longest[i] else "too short"
            raise InfeasibleError(
                f"T[{bands.label(room.centre_frequencies[i])}] = {t[i]:.4g} s is {why} in "
                f"{self.name}'s equation: T from {shortest[i]:.4g} to {longest[i]:.4g} s would do"
            )
        return b


def mean_equation(key: str, place: str = "equation") -> MeanEquation:
    """Return the equation with one exponent per room that has this key.

    Raises DataError, which names ``place``, for any other key.

    Examples
    --------
    >>> mean_equation("millington").name
    'Millington'
    """
    equation = EQUATIONS.get(key) if isinstance(key, str) else None
    if equation is None or not issubclass(equation, MeanEquation):
        raise DataError(f"{place} = {key!r} is not one of {', '.join(equation_keys(MeanEquation))}")
    return equation()
