"""Effects of the measurement: noise in the decays, and a source that is not omnidirectional."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Effect, Limits, Parameters
from rtcal.finder.model import RoomState


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
