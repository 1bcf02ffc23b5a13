"""Air that the model lacks, or has for another climate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Effect, Limits, Parameters, read_only
from rtcal.finder.model import RoomState
from rtcal.support.types import Array


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
    return read_only(air.attenuation(frequencies)), air.speed_of_sound
