"""A `Room` as a shoebox with a source and receivers, for simulators that know no other shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.support import checks
from rtcal.support.types import Array

Point = Sequence[float]


@dataclass(frozen=True, eq=False)
class Shoebox:
    """Dimensions (3,) in m, the material's row of each of the six walls, and the places in it.

    ``sources`` (n_sources, 3) and ``receivers`` (n_receivers, 3) in m; ``pairs`` their names, sources
    first.
    """

    dimensions: Array
    walls: NDArray[np.int64]
    sources: Array
    receivers: Array
    pairs: tuple[tuple[str, str], ...]


def shoebox(room: Room, sources: Mapping[str, Point], receivers: Mapping[str, Point]) -> Shoebox:
    """Return the room as a shoebox.

    Its surfaces are named after `SHOEBOX_WALLS`, one a wall; a room of a single material needs no
    surfaces.

    Raises
    ------
    DataError
        If the room states no dimensions, a wall has no surface, the areas are not the box's (1 %),
        or a source or a receiver is outside.
    """
    checks.instance("room", room, Room)
    if room.dimensions is None:
        raise DataError(f'room "{room.name}" states no dimensions; a shoebox needs them')
    if room.n_materials == 1:
        materials = dict.fromkeys(SHOEBOX_WALLS, room.materials[0])
    else:
        named = {s.name: s.material for s in room.surfaces}
        if missing := [wall for wall in SHOEBOX_WALLS if wall not in named]:
            raise DataError(
                f'room "{room.name}" has no surface "{missing[0]}"; a shoebox of several materials '
                f"has one surface a wall: {', '.join(SHOEBOX_WALLS)}"
            )
        materials = {wall: named[wall] for wall in SHOEBOX_WALLS}
    box = Polyhedron.shoebox(room.dimensions, materials)
    for material, area in zip(room.materials, room.areas, strict=True):
        if abs(box.areas.get(material, 0.0) - area) > 0.01 * area:
            raise DataError(
                f'areas["{material}"] = {area:.4g} m², but its walls in the box of '
                f"{' x '.join(f'{d:g}' for d in room.dimensions)} m have "
                f"{box.areas.get(material, 0.0):.4g} m²"
            )
    return Shoebox(
        dimensions=np.asarray(room.dimensions, dtype=float),
        walls=np.array([room.material_index(materials[wall]) for wall in SHOEBOX_WALLS]),
        sources=box.require_inside("source", sources),
        receivers=box.require_inside("receiver", receivers),
        pairs=tuple((s, r) for s in sources for r in receivers),
    )
