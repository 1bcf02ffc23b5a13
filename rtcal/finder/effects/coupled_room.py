"""An opening in a wall, and a second room behind one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import (
    Absorber,
    Effect,
    Limits,
    Parameters,
    all_surfaces,
    first_decay,
    middle_absorption,
)
from rtcal.finder.model import Decay, RoomState, covered, rates, speeds
from rtcal.support.types import Array


@dataclass(frozen=True)
class CoupledRoom(Effect):
    """A second room behind an aperture: two energy balances (Kuttruff; Cremer & Mueller)."""

    name: ClassVar[str] = "coupled room"
    family: ClassVar[str] = "field"
    alone: ClassVar[bool] = False
    formula_error: ClassVar[float] = 0.35
    odds: ClassVar[float] = 0.5
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.2, 0.1, 0.3)
    size: ClassVar[str] = "aperture"
    unit: ClassVar[str] = "m²"
    removable: ClassVar[bool] = True
    size_error: ClassVar[float] = 0.4
    parameter_units: ClassVar[Mapping[str, str]] = {"aperture": " m²", "volume": " m³"}
    stands_on: ClassVar[Sequence[str]] = ("wall", "ceiling")
    not_in_simulator: ClassVar[str | None] = (
        "the simulator has no second room; draw it in its geometry"
    )

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return apertures of 0.05 to 1.2 A, rooms of 0.2 to 3 V, alpha of 0.02 to 0.3."""
        area = middle_absorption(state)
        return [
            {"aperture": float(a * area), "volume": float(v * state.volume), "alpha": float(e)}
            for a, v, e in product(
                np.geomspace(0.05, 1.2, 8), np.geomspace(0.2, 3, 4), np.geomspace(0.02, 0.3, 4)
            )
        ]

    def limits(self, room: Room | None) -> Limits:
        """Return an aperture in the surfaces, and a room of 1 l or more that reflects something."""
        return {"aperture": (0.0, all_surfaces(room)), "volume": (1e-3, 1e8), "alpha": (0.0, 0.999)}

    def wall_area(self, parameters: Parameters) -> float:
        """Return the aperture."""
        return float(parameters["aperture"])

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room coupled to the other one."""
        return replace(state, shape=CoupledDecay(**parameters))


@dataclass(frozen=True)
class CoupledDecay:
    """The decay with a second room of ``volume`` in m³ and ``alpha`` behind an ``aperture`` in m².

    V1 dE1/dt = -(c/4) (A1 + S) E1 + (c/4) S E2, and the same with 1 and 2 exchanged. The second room
    has the surface of a cube (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982).
    """

    aperture: float
    volume: float
    alpha: float

    def __call__(self, state: RoomState) -> Decay:
        """Return the state's decay, of two terms."""
        return first_decay(self.together([state], [self]))

    @staticmethod
    def together(states: Sequence[RoomState], shapes: Sequence[CoupledDecay]) -> Decay:
        """Return the decays of many states, each with its shape: (n, n_bands, 2)."""
        c, opening = speeds(states)[:, None], np.ones_like(states[0].frequencies)
        aperture = np.array([[s.aperture] for s in shapes])
        volume = np.array([[s.volume] for s in shapes])
        first_volume = np.array([[s.volume] for s in states])
        alpha, air = np.array([[s.alpha] for s in shapes]), np.array([s.air for s in states])
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
class Opening(Absorber):
    """An opening: the energy that leaves does not return (Sabine; Kuttruff)."""

    name: ClassVar[str] = "opening"
    family: ClassVar[str] = "added absorption, flat"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.05, 0.05)
    steps: ClassVar[int] = 14

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        """Return alpha = 1."""
        return np.ones_like(frequencies)
