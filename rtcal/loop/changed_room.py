"""A simulator in a changed room: what was covered is another mixture of materials on the same walls.

Where the new material lies on a surface is not known to the room. It is spread evenly over all walls
of the material that it covers, so every wall's coefficient is a mean by area, and a tracer weighs the
paths that it has. How the walls scatter stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rtcal.acoustics.changes import Change, Climate, Cover, Open, changed
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.loop.places import Move
from rtcal.prediction.assumptions import Assumptions
from rtcal.prediction.estimate import Rooms
from rtcal.simulators.base import Simulator
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class ChangedRoom:
    """A room, what is changed in it, and which materials its walls then have.

    Raises DataError for a change that a simulator does not know the place of.

    Attributes
    ----------
    before : Room
        With the prior's coefficients.
    changes : tuple of Change
    assumptions : Assumptions
    """

    before: Room
    changes: tuple[Change, ...]
    assumptions: Assumptions

    def __post_init__(self) -> None:
        for change in self.changes:
            if not isinstance(change, (Cover, Open, Climate)):
                raise DataError(
                    f"{change}: a simulator does not know where; state the changed room's own mesh, or "
                    "predict T by an equation"
                )
        _ = self._mixed  # raises where the room does not allow a change

    @cached_property
    def after(self) -> Room:
        """The changed room, with the prior's coefficients."""
        return changed(self.before, self.changes)

    @cached_property
    def _rooms(self) -> Rooms:
        return Rooms([self.before, self.after], Eyring(), self.assumptions)

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials, and then the new ones."""
        return self._rooms.materials

    @cached_property
    def _mixed(self) -> tuple[Array, tuple[Move, ...]]:
        """Shares of the materials in what each was, and what each partial cover moved of them."""
        mixture = np.eye(self.before.n_materials, len(self.materials))
        moves = []
        for change in self.changes:
            cover = change.cover(self.before) if isinstance(change, Open) else change
            if not isinstance(cover, Cover):
                continue
            name = cover.by if isinstance(cover.by, str) else cover.by.name
            old, new = self.materials.index(cover.surface), self.materials.index(name)
            has = float(self.before.areas @ mixture[:, old])
            share = 1.0 if cover.area is None else min(cover.area / has, 1.0)
            moved = share * mixture[:, old]
            mixture[:, new] += moved
            mixture[:, old] -= moved
            if share < 1:
                moves.append((old, new, moved))
        return mixture, tuple(moves)

    @property
    def moves(self) -> tuple[Move, ...]:
        """Each partial cover: from which material, to which, and its share of each wall."""
        return self._mixed[1]

    @property
    def mixture(self) -> Array:
        """Share of each material in what was each of the room's, (n_before, n_materials)."""
        return self._mixed[0]

    def all_alpha(self, alpha: Array) -> Array:
        """Return coefficients of all materials for those of the room's, (n_materials, n_bands)."""
        return np.vstack([alpha, self._rooms.stacked("alpha")[len(alpha) :]])

    def by_areas(self, alpha: Array) -> Array:
        """Return d(alpha of the walls) / d ln(each partly covered area), (n_covers, n_before, n_bands).

        ``alpha`` is that of all materials.
        """
        rows = [moved[:, np.newaxis] * (alpha[new] - alpha[old]) for old, new, moved in self.moves]
        return np.array(rows).reshape(-1, self.before.n_materials, self.before.n_bands)

    @property
    def cover_sigma(self) -> Array:
        """Relative error of each partial cover's area, (n_covers,): that of the surface below it."""
        return self._rooms.area_sigma[[old for old, *_ in self.moves]]

    @property
    def new_sigma(self) -> Array:
        """Sigma of the new materials, (n_new, n_bands), at least the assumed one but where it is 0."""
        return self._rooms.sigma[self.before.n_materials :]

    def simulator(self, simulator: Simulator) -> Simulator:
        """Return the simulator with the air after the change."""
        if self.after.air == self.before.air or not isinstance(simulator, PathTracing):
            if self.after.air != self.before.air:
                raise DataError(
                    "another climate takes a path tracing: the simulator keeps its own air"
                )
            return simulator
        return replace(simulator, room=simulator.room.with_air(self.after.air))
