"""Effects of the whole room and of its measurement, and what is stated wrongly of one material.

A wrong area, volume or equation, a covered material, air that was left out, a field that is not
diffuse, a second room, noise, and a source that is not omnidirectional.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import Eyring, MeanEquation, Millington, Sabine
from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Effect, Limits, Parameters, all_surfaces, middle_absorption
from rtcal.finder.model import (
    Decay,
    DirectionalDecay,
    RoomState,
    covered,
    first_decay,
    rates,
    speeds,
)
from rtcal.support.types import Array, read_only_view

_LAST = 500.0
"""Decay of the energy in nepers after which it is too little for a double number."""
RATIOS = (5e-4, 2e3)
"""Ratios of a true area or volume to the stated one: a unit taken for another is a factor of 1000."""


class WrongStatement(Effect):
    """An effect that contradicts what the room states."""

    family: ClassVar[str] = "scale"

    def contradicts(self, room: Room) -> bool:
        """Return True."""
        return True


class OfMaterial(WrongStatement):
    """An effect that contradicts what the room states of one material: parameter ``material``."""

    def limits(self, room: Room | None) -> Limits:
        """Return the rows of the room's materials."""
        return {"material": (0.0, np.inf if room is None else room.n_materials - 1.0)}

    def material(self, parameters: Parameters, room: Room) -> str | None:
        """Return the name of the material."""
        number = int(parameters.get("material", -1))
        return room.materials[number] if 0 <= number < room.n_materials else None

    def title(self, parameters: Parameters, room: Room) -> str:
        """Return the name with the material: ``area of "plaster"``."""
        material = self.material(parameters, room)
        return self.name if material is None else f'{self.name} of "{material}"'

    def describe(self, parameters: Parameters, without: str = "") -> str:
        """Return the parameters other than the material, which is in the title."""
        shown = {k: v for k, v in parameters.items() if k != "material"}
        return super().describe(shown, without)


@dataclass(frozen=True)
class WrongArea(OfMaterial):
    """The true area of one material, as a ratio of the stated one."""

    name: ClassVar[str] = "area"
    size: ClassVar[str] = "ratio"
    unit: ClassVar[str] = "of the stated area"
    neutral: ClassVar[float] = 1.0
    discrete: ClassVar[Sequence[str]] = ("material",)
    size_error: ClassVar[float] = 0.0

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return each material with 0.35 to 2.9 times its area."""
        ratios = [r for r in np.geomspace(0.35, 2.9, 12) if abs(r - 1) > 0.05]
        both = product(range(len(state.areas)), ratios)
        return [{"material": float(j), "ratio": float(r)} for j, r in both]

    def limits(self, room: Room | None) -> Limits:
        """Return a material of the room, and `RATIOS` of its area."""
        return {**super().limits(room), "ratio": RATIOS}

    def density(self, parameters: Parameters, state: RoomState) -> float:
        """Return a normal density of ln ratio, of standard deviation 0.5."""
        return float(np.exp(-0.5 * (np.log(parameters["ratio"]) / 0.5) ** 2))

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with that area."""
        areas = state.areas.copy()
        areas[int(parameters["material"])] *= parameters["ratio"]
        return replace(state, areas=areas)


@dataclass(frozen=True)
class WrongVolume(WrongStatement):
    """The true volume, as a ratio of the stated one.

    A stated volume is believed within its standard deviation (`RoomState.volume_sigma`). Beyond it only
    a gross mistake is, which is a factor: a half that was not drawn, a length for another, feet for
    metres.
    """

    FACTORS: ClassVar[Mapping[float, float]] = {
        2.0: 0.35,
        3.0: 0.05,
        4.0: 0.025,
        8.0: 0.05,
        35.3: 0.0125,
        1000.0: 0.0125,
    }
    """Factors of gross mistakes with their shares of these: of a half or a third of the room, of
    lengths twice as large, of cubic feet and of a unit. Their inverses have the same."""
    odds: ClassVar[float] = 1 / 3
    GROSS: ClassVar[float] = 0.9
    """Probability that a wrong volume is a gross mistake: within its standard deviation it is right."""
    WIDTH: ClassVar[float] = 0.05
    """Standard deviation of ln of a gross mistake about its factor."""
    UNEVEN: ClassVar[float] = 0.01
    """Factor of the probability of a volume two to four times as large where no directions are known:
    an uneven field, which is not judged then, makes T as much longer."""
    steps: ClassVar[int] = 18
    name: ClassVar[str] = "volume"
    size: ClassVar[str] = "ratio"
    unit: ClassVar[str] = "of the stated volume"
    neutral: ClassVar[float] = 1.0
    size_error: ClassVar[float] = 0.04

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return ratios within four standard deviations, and those about the `FACTORS`.

        Ratios with which sound would end before 80 ms are left out: they have no C80.
        """
        near = self.near(state)
        about = self._mistakes()[:, np.newaxis] + self.WIDTH * np.linspace(-3, 3, self.steps // 2)
        end = np.log(near[-1]["ratio"]) + self.WIDTH
        shortest = np.log(0.08 * state.rate.max() / _LAST)
        far = [x for x in sorted({*about.ravel().tolist()}) if abs(x) > end and x > shortest]
        every = [*near, *({"ratio": float(np.exp(x))} for x in far)]
        return sorted(every, key=lambda theta: theta["ratio"])

    def near(self, state: RoomState) -> list[Parameters]:
        """Return ratios within four standard deviations."""
        return [
            {"ratio": float(r)} for r in np.exp(state.volume_sigma * np.linspace(-4, 4, self.steps))
        ]

    def _mistakes(self) -> Array:
        """Return ln of the factors of gross mistakes, and of their inverses."""
        logs = np.log([*self.FACTORS])
        return np.concatenate([logs, -logs])

    def limits(self, room: Room | None) -> Limits:
        """Return `RATIOS`."""
        return {"ratio": RATIOS}

    def density(self, parameters: Parameters, state: RoomState) -> float:
        """Return the density of ln ratio; see `densities`."""
        return float(self.densities([parameters], state)[0])

    def densities(self, grid: Sequence[Parameters], state: RoomState) -> Array:
        """Return the density of ln ratio: normal about 0, and with `GROSS` about ln of the factors."""
        logs = np.log([theta["ratio"] for theta in grid])

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
        """Return the room with that volume."""
        return replace(state, volume=state.volume * parameters["ratio"])


@dataclass(frozen=True)
class WrongFormula(WrongStatement):
    """Another equation than the model's: Sabine's, Eyring's or Millington's."""

    name: ClassVar[str] = "formula"
    size: ClassVar[str] = "equation"
    # Kuttruff's is left out: it needs the variance of the path lengths, which no case states.
    EQUATIONS: ClassVar[Sequence[type[MeanEquation]]] = (Sabine, Eyring, Millington)
    unit: ClassVar[str] = ", ".join(f"{i} {e.name}" for i, e in enumerate(EQUATIONS))
    neutral: ClassVar[float] = np.nan
    discrete: ClassVar[Sequence[str]] = ("equation",)
    size_error: ClassVar[float] = 0.0
    parameter_values: ClassVar[Mapping[str, Sequence[str]]] = {
        "equation": [f"{e.name}'s equation" for e in EQUATIONS]
    }

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return the equations that the model does not use."""
        return [
            {"equation": float(i)} for i, e in enumerate(self.EQUATIONS) if e.key != state.equation
        ]

    def limits(self, room: Room | None) -> Limits:
        """Return the equations' numbers."""
        return {"equation": (0.0, len(self.EQUATIONS) - 1.0)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room under that equation."""
        return replace(state, equation=self.EQUATIONS[int(parameters["equation"])].key)


HARD = 0.04
"""alpha of what covers the material: wood, plaster or glass at middle frequencies."""


@dataclass(frozen=True)
class CoveredSurface(OfMaterial):
    """A share of one material that is covered by something hard: its absorption is not in the room."""

    name: ClassVar[str] = "covered surface"
    family: ClassVar[str] = "less absorption"
    odds: ClassVar[float] = 0.5
    spectrum_error: ClassVar[tuple[float, float, float]] = (0.1, 0.08, 0.1)
    size: ClassVar[str] = "share"
    unit: ClassVar[str] = "of its area covered"
    neutral: ClassVar[float] = 0.0
    removable: ClassVar[bool] = True
    # A cover has 0.02 to 0.1, not HARD: some 6 % of what a panel absorbs. Chosen on twelve rooms of
    # tests/seams/turned_panels.py, whose 90 % intervals hold all shares; with 0.25 T is 12 % off.
    size_error: ClassVar[float] = 0.1
    discrete: ClassVar[Sequence[str]] = ("material",)
    parameter_units: ClassVar[Mapping[str, str]] = {"share": " of its area covered"}
    stands_on: ClassVar[Sequence[str]] = ("floor", "wall", "ceiling")
    shares: ClassVar[Sequence[float]] = (0.12, 0.2, 0.33, 0.55, 0.9)

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return each material that is softer than the cover, covered by 0.12 to 0.9."""
        middle = state.alpha.mean(1)
        rows = np.flatnonzero(middle > 2 * HARD)
        rows = rows if len(rows) else np.array([int(np.argmax(middle))])
        return [{"material": float(j), "share": s} for j, s in product(rows, self.shares)]

    def limits(self, room: Room | None) -> Limits:
        """Return a material of the room, and a share from 0 to 1."""
        return {**super().limits(room), "share": (0.0, 1.0)}

    def on_surface(self, frequencies: Array) -> Sequence[tuple[Parameters, Array]]:
        """Return the cover's alpha."""
        return [({}, np.full(len(frequencies), HARD))]

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with that share of the material covered."""
        alpha, row = np.array(state.alpha), int(parameters["material"])
        share = parameters["share"]
        alpha[row] = (1 - share) * alpha[row] + share * np.minimum(HARD, alpha[row])
        return replace(state, alpha=alpha)


@dataclass(frozen=True)
class NoiseFloor(Effect):
    """Noise in the measured decays that was not subtracted: S(t) + N (t_end - t) (ISO 3382)."""

    name: ClassVar[str] = "noise floor"
    family: ClassVar[str] = "measurement"
    size: ClassVar[str] = "level"
    unit: ClassVar[str] = "dB relative to the start of the decay"
    neutral: ClassVar[float] = -90.0
    size_error: ClassVar[float] = 1.2
    parameter_units: ClassVar[Mapping[str, str]] = {"level": " dB", "record": " times T"}
    not_in_simulator: ClassVar[str | None] = (
        "a simulator's decay has no noise; take the noise off the measurement"
    )

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return -62 to -30 dB, over 1.5 and 2.5 reverberation times."""
        levels = np.linspace(-62, -30, 17).tolist()
        return [{"level": x, "record": r} for x, r in product(levels, (1.5, 2.5))]

    def limits(self, room: Room | None) -> Limits:
        """Return noise that is weaker than the start of the decay, over 0.1 T or longer."""
        return {"level": (-200.0, 0.0), "record": (0.1, 100.0)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with this noise in its decays."""
        return replace(state, floor_db=parameters["level"], record=parameters["record"])


@dataclass(frozen=True)
class DirectSound(Effect):
    """A source that is not omnidirectional: its direct sound, in C80 and G alone."""

    name: ClassVar[str] = "direct sound"
    family: ClassVar[str] = "measurement"
    odds: ClassVar[float] = 0.5
    size: ClassVar[str] = "gain"
    unit: ClassVar[str] = "dB"
    size_error: ClassVar[float] = 1.0
    parameter_units: ClassVar[Mapping[str, str]] = {"gain": " dB"}
    # A simulator's source has a directivity of its own.
    not_in_simulator: ClassVar[str | None] = None

    def grid(self, state: RoomState) -> Sequence[Parameters]:
        """Return -9 to +9 dB."""
        return [{"gain": g} for g in (-9.0, -6.0, -4.0, -2.0, 2.0, 4.0, 6.0, 9.0)]

    def limits(self, room: Room | None) -> Limits:
        """Return -40 to +40 dB, beyond any loudspeaker's directivity."""
        return {"gain": (-40.0, 40.0)}

    def change(self, state: RoomState, parameters: Parameters) -> RoomState:
        """Return the room with the direct sound so much stronger."""
        return replace(state, direct_db=state.direct_db + parameters["gain"])


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
    needs_directions: ClassVar[bool] = True
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
