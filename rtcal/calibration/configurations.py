"""Configurations of one room: with the curtain open or drawn, with or without an audience."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import target_changes
from rtcal.acoustics.states import refuse_other_priors
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Configurations:
    """Several configurations of one room, which share their materials' coefficients.

    Parameters
    ----------
    rooms : sequence of Room
        One per configuration, each with its volume, air and areas. Materials of the same name are
        one unknown, so all rooms must state the same alpha and sigma for them.
    names : sequence of str, optional
        Names of the configurations; the rooms' names if not stated.

    Raises
    ------
    DataError
        If the bands differ, or a material's prior does.

    Examples
    --------
    >>> import numpy as np
    >>> room = Room(name="bare", volume=60, materials=["wall", "floor"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> covered = Room(name="mat on floor", volume=60, materials=["wall", "mat"], areas=[74, 20],
    ...             alpha=[[0.1], [0.6]], sigma=[[0.02], [0.01]], centre_frequencies=[1000])
    >>> Configurations([room, covered]).areas.tolist()
    [[74.0, 20.0, 0.0], [74.0, 0.0, 20.0]]
    """

    rooms: Sequence[Room]
    names: Sequence[str] = ()

    def __repr__(self) -> str:
        materials = {material for room in self.rooms for material in room.materials}
        return (
            f"<Configurations: {shortened(', '.join(self.names))}, {len(materials)} materials, "
            f"{bands.span(self.rooms[0].centre_frequencies)}>"
        )

    def __post_init__(self) -> None:
        if not isinstance(self.rooms, Iterable):
            raise DataError(f"rooms = {self.rooms!r} is not a list of rtcal.Room")
        rooms = tuple(self.rooms)
        if not rooms:
            raise DataError("rooms is empty; there is at least one configuration")
        for i, room in enumerate(rooms):
            if not isinstance(room, Room):
                raise DataError(f"rooms[{i}] = {room!r} is not a rtcal.Room")
        if isinstance(self.names, str) or not isinstance(self.names, Iterable):
            raise DataError(f"names = {self.names!r} is not a list of texts")
        names = tuple(str(n) for n in self.names) or tuple(r.name for r in rooms)
        if len(names) != len(rooms):
            raise DataError(f"{len(names)} names for {len(rooms)} configurations")
        object.__setattr__(self, "rooms", rooms)
        object.__setattr__(self, "names", names)
        refuse_other_priors(rooms, [f'configuration "{name}"' for name in names])
        if len(rooms) > 1:
            self._compare_priors()

    def _compare_priors(self) -> None:
        pairs = self._pairs()
        for name, room in zip(self.names, self.rooms, strict=True):
            if room.band_correlation != self.rooms[0].band_correlation:
                raise DataError(
                    f'configuration "{name}": band_correlation = {room.band_correlation:g}, but '
                    f'"{self.names[0]}" says {self.rooms[0].band_correlation:g}'
                )
            for key in ("volume_sigma", "common_area_sigma", "common_alpha_sigma"):
                stated, other = getattr(room, key), getattr(self.rooms[0], key)
                if stated != other:
                    raise DataError(
                        f'configuration "{name}": {key} = {stated:g}, but "{self.names[0]}" says '
                        f"{other:g}; it is one room"
                    )
            for (a, b), value in pairs.items():
                stated = room.material_correlation.get(
                    (a, b), room.material_correlation.get((b, a), 0.0)
                )
                if a in room.materials and b in room.materials and stated != value:
                    raise DataError(
                        f'configuration "{name}": material_correlation["{a}", "{b}"] = {stated:g}, but '
                        f"another configuration says {value:g}"
                    )

    def _pairs(self) -> dict[tuple[str, str], float]:
        """The correlations of two materials, from all configurations."""
        pairs: dict[tuple[str, str], float] = {}
        for room in self.rooms:
            for (a, b), value in room.material_correlation.items():
                pairs.setdefault((b, a) if (b, a) in pairs else (a, b), value)
        return pairs

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material of any configuration, in order of appearance."""
        return tuple(dict.fromkeys(m for room in self.rooms for m in room.materials))

    @cached_property
    def areas(self) -> Array:
        """Areas in m², (n_configurations, n_materials); 0 where a configuration lacks a material."""
        if len(self.rooms) == 1:
            return self.rooms[0].areas[np.newaxis]
        materials = self.materials
        areas = np.zeros((len(self.rooms), len(materials)))
        for c, room in enumerate(self.rooms):
            areas[c, [materials.index(m) for m in room.materials]] = room.areas
        return areas

    def target_changes(self, equation: LinearEquation, times: Array) -> Array:
        """Return `rtcal.acoustics.room_errors.target_changes`, (n_changes, n_configurations n_bands).

        Configurations share the volume and the areas; each has a climate of its own. Without any change
        where no room is uncertain. ``times`` is (n_configurations, n_bands) in s.
        """
        if not any(room.is_uncertain for room in self.rooms):
            return np.zeros((0, times.size))
        n, (c, k) = len(self.materials), times.shape
        changes = np.zeros((2 + n + 2 * c, c, k))
        for i, (room, t) in enumerate(zip(self.rooms, times, strict=True)):
            of_room = target_changes(equation, room, t)
            changes[:2, i] = of_room[:2]
            changes[[2 + self.materials.index(m) for m in room.materials], i] = of_room[2:-2]
            changes[2 + n + 2 * i : 4 + n + 2 * i, i] = of_room[-2:]
        return changes.reshape(len(changes), c * k)

    @cached_property
    def union(self) -> Room:
        """A room with every material once: its prior, its largest area and the largest error of it."""
        if len(self.rooms) == 1:
            return self.rooms[0]
        first = self.rooms[0]
        owners = [next(r for r in self.rooms if m in r.materials) for m in self.materials]
        rows = [r.materials.index(m) for r, m in zip(owners, self.materials, strict=True)]
        floors = [
            np.max(
                [
                    np.zeros(first.n_bands)
                    if r.alpha_min is None
                    else r.alpha_min[r.materials.index(m)]
                    for r in self.rooms
                    if m in r.materials
                ],
                axis=0,
            )
            for m in self.materials
        ]
        return Room(
            name=first.name,
            volume=first.volume,
            materials=self.materials,
            areas=self.areas.max(axis=0),
            alpha=np.array([r.alpha[i] for r, i in zip(owners, rows, strict=True)]),
            sigma=np.array([r.sigma[i] for r, i in zip(owners, rows, strict=True)]),
            centre_frequencies=first.centre_frequencies,
            air=next((r.air for r in self.rooms if r.air is not None), None),
            alpha_min=np.array(floors),
            band_correlation=first.band_correlation,
            material_correlation=self._pairs(),
            volume_sigma=first.volume_sigma,
            area_sigma=np.array(
                [
                    max(r.area_sigma[r.materials.index(m)] for r in self.rooms if m in r.materials)
                    for m in self.materials
                ]
            ),
            common_area_sigma=first.common_area_sigma,
            common_alpha_sigma=first.common_alpha_sigma,
            climate_sigma=tuple(np.max([r.climate_sigma for r in self.rooms], axis=0).tolist()),
        )
