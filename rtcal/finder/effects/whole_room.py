"""Effects of the whole room: air that was left out, an uneven field, and a second room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import (
    Effect,
    Limits,
    Parameters,
    all_surfaces,
    first_decay,
    middle_absorption,
)
from rtcal.finder.model import Decay, RoomState, covered, rates, speeds, surface_absorption
from rtcal.support.types import Array, read_only_view


@dataclass(frozen=True)
class OmittedAir(Effect):
    """Air absorption that the model lacks, or has for another climate (ISO 9613-1)."""

    name: ClassVar[str] = "air"
    family: ClassVar[str] = "climate"
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.03, 0.0, 0.03)
    size: ClassVar[str] = "humidity"
    unit: ClassVar[str] = "% at the temperature"
    neutral: ClassVar[float] = np.nan
    size_error: ClassVar[float] = 0.0
    parameter_units: ClassVar[Mapping[str, str]] = {"temperature": " °C", "humidity": " %"}
    INDOORS: ClassVar[Mapping[str, tuple[float, float, float]]] = {
        "temperature": (15.0, 30.0, 3.0),
        "humidity": (20.0, 70.0, 10.0),
    }

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return 10 to 35 °C and 8 to 95 %."""
        temperatures = (10.0, 14.0, 18.0, 22.0, 26.0, 30.0, 35.0)
        humidities = (8.0, 13.0, 20.0, 27.0, 35.0, 45.0, 57.0, 70.0, 95.0)
        return [{"temperature": t, "humidity": h} for t, h in product(temperatures, humidities)]

    def limits(self, room: Room | None) -> Limits:
        """Return the range of ISO 9613-1."""
        return {"temperature": (-20.0, 50.0), "humidity": (1.01, 100.0)}

    def density(self, parameters: Parameters, state: RoomState) -> float:
        """Return the density of an indoor climate: even over `INDOORS`, normal tails beyond it."""
        out = 1.0
        for name, (low, high, tail) in self.INDOORS.items():
            value = parameters[name]
            beyond = max(low - value, value - high, 0.0) / tail
            out *= float(np.exp(-0.5 * beyond**2)) * value  # per unit of ln
        return out

    def prior_odds(self, room: Room) -> float:
        """Return 3 where the room states no climate, and 0.3 where it does.

        Every room has air. A stated climate was measured, and its uncertainty is in the covariance of
        every hypothesis (`Case.climate_uncertainty`).
        """
        return 3.0 if room.air is None else 0.3

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with this air: its attenuation and its speed of sound."""
        attenuation, speed = _climate(
            tuple(state.frequencies), parameters["temperature"], parameters["humidity"]
        )
        return replace(state, air=attenuation, speed_of_sound=speed)

    def describe(self, parameters: Parameters, without: str = "") -> str:
        """Return the climate, with what is known of it."""
        return (
            f"{super().describe(parameters, without)} (found together: only the attenuation that "
            "they give is known well)"
        )

    def contradicts(self, room: Room) -> bool:
        """Return whether the room states another climate."""
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


_TERMS = 12
"""Number of terms of the decay; a dozen give it to seven digits."""
_ORDER = 5
"""Number of polar angles, and of azimuths, of the directions."""


@dataclass(frozen=True)
class NonDiffuse(Effect):
    """Uneven absorption and little scattering: each direction decays at its own rate."""

    name: ClassVar[str] = "non-diffuse field"
    family: ClassVar[str] = "field"
    alone: ClassVar[bool] = False
    formula_error: ClassVar[float] = 0.35
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.2, 0.1, 0.3)
    size: ClassVar[str] = "scattering"
    unit: ClassVar[str] = "as scattering coefficient"
    neutral: ClassVar[float] = 1.0
    size_error: ClassVar[float] = 0.5
    # A simulator with geometry has such a field by itself.
    not_in_simulator: ClassVar[str | None] = None

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return s = 0.01 to 0.3."""
        return [{"scattering": float(s)} for s in np.geomspace(0.01, 0.3, 9)]

    def limits(self, room: Room | None) -> Limits:
        """Return 0 to 1."""
        return {"scattering": (0.0, 1.0)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with this scattering."""
        return replace(state, shape=DirectionalDecay(**parameters))


@dataclass(frozen=True)
class DirectionalDecay:
    """The direction-resolved decay of a box whose walls have this scattering coefficient.

    dE(u)/dt = -r(u) E - nu (E - <E>), with r(u) = c sum_i |u_i| A_i / 2V over the axes, A_i the
    absorption area of the walls that face along i, and nu = s c S / 4V; after Nilsson 2004 and
    EN 12354-6, D.
    """

    scattering: float

    def __call__(self, state: RoomState) -> Decay:
        """Return the state's decay, a term for each direction."""
        return first_decay(self.together([state], [self]))

    @staticmethod
    def together(states: Sequence[RoomState], shapes: Sequence[DirectionalDecay]) -> Decay:
        """Return the decays of many states, each with its shape: (n, n_bands, n_directions)."""
        u, weight = _directions()
        c = speeds(states)[:, None]
        volume = np.array([[s.volume] for s in states])
        area = np.array([[s.total_area] for s in states])
        # Shares of the surfaces' absorption by axis; equal shares where they absorb nothing.
        by_axis = np.array(
            [
                (s.facing * s.areas[:, None]).T @ alpha / (s.areas @ alpha)
                for s in states
                for alpha in [np.maximum(s.alpha, 1e-9)]
            ]
        )
        absorbed = by_axis * surface_absorption(states)[:, None, :]
        rate = c[:, :, None] / (2 * volume[:, :, None]) * (u.T @ absorbed).swapaxes(1, 2)
        nothing = np.zeros_like(states[0].air)
        everywhere = c * np.array([s.air + (s.objects + nothing) / (4 * s.volume) for s in states])
        nu = np.array([[s.scattering] for s in shapes]) * c * area / (4 * volume)
        terms, share = _terms(rate + nu[:, :, None], nu, np.sqrt(weight))
        return Decay(share / volume[:, :, None], np.maximum(terms + everywhere[..., None], 1e-3))


def _terms(diagonal: Array, nu: Array, root: Array) -> tuple[Array, Array]:
    """Rates and shares of root' exp(-M t) root, M = diag(``diagonal``) - ``nu`` root root'.

    As many as Lanczos' steps from ``root``: a dozen give the decay to seven digits.
    """
    basis = np.zeros((*diagonal.shape[:-1], _TERMS, len(root)))
    small = np.zeros((*diagonal.shape[:-1], _TERMS, _TERMS))
    q = np.broadcast_to(root, diagonal.shape)
    for j in range(_TERMS):
        basis[..., j, :] = q
        w = diagonal * q - nu[..., None] * (q @ root)[..., None] * root
        small[..., j, j] = (w * q).sum(-1)
        for _ in range(2):  # once more, against rounding
            w = w - (np.swapaxes(basis, -1, -2) @ (basis @ w[..., None]))[..., 0]
        length = np.linalg.norm(w, axis=-1)
        if j + 1 < _TERMS:
            small[..., j, j + 1] = small[..., j + 1, j] = length
            q = w / np.maximum(length, 1e-300)[..., None]
    values, vectors = np.linalg.eigh(small)
    return values, vectors[..., 0, :] ** 2


@cache
def _directions() -> tuple[Array, Array]:
    """Directions of one octant, (3, n), and their weights: Gauss points in cos(polar angle)."""
    nodes, gauss = np.polynomial.legendre.leggauss(_ORDER)
    z = 0.5 * (nodes + 1)
    azimuth = (np.arange(_ORDER) + 0.5) * np.pi / 2 / _ORDER  # midpoints
    rho = np.sqrt(1 - z**2)
    u = np.stack(
        [
            np.outer(rho, np.cos(azimuth)),
            np.outer(rho, np.sin(azimuth)),
            np.outer(z, np.ones(_ORDER)),
        ]
    ).reshape(3, -1)
    return u, np.outer(gauss / 2, np.full(_ORDER, 1 / _ORDER)).ravel()


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
