"""The base class of the reverberation equations, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
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
