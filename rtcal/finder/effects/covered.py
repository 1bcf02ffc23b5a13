"""Less absorption than stated: a closed door, an added wall, a turned panel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.finder.effects.base import Limits, Parameters
from rtcal.finder.effects.stated import OfMaterial
from rtcal.finder.model import RoomState
from rtcal.support.types import Array

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
