"""A directional source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Effect, Limits, Parameters
from rtcal.finder.model import RoomState


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
