"""Which way a room's surfaces face: across x, y or z."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from rtcal.acoustics.materials import AXES
from rtcal.acoustics.room import Room
from rtcal.support.types import Array

_LEVEL = re.compile(r"(?<![a-z])(floor|ceiling)", re.IGNORECASE)
_WALL = re.compile(r"(?<![a-z])walls?(?![a-z])", re.IGNORECASE)
_FILLED = 0.05
"""Share of a box's floor and ceiling that may be missing where these are taken as all known."""


class Faces(Protocol):
    """The part of a geometry that says where its materials face: one entry of each per face."""

    @property
    def materials(self) -> Sequence[str]:
        """Name of the material of each face."""
        ...

    @property
    def face_areas(self) -> Array:
        """Area of each face in m², (n_faces,)."""
        ...

    @property
    def normals(self) -> Array:
        """Normal of each face, of length 1, (n_faces, 3)."""
        ...


def facing(room: Room, geometry: Faces | None = None) -> Array:
    """Return each material's shares of area across x, y and z, (n_materials, 3); NaN where unknown.

    In this order: the faces of a geometry (an oblique one counts by the squares of its normal),
    a surface's ``axis``, a name of a surface or of a material that says floor or ceiling. Where a name
    says wall, x and y share it; in a box of stated dimensions they share it by the area that is left
    there, and once floor and ceiling are covered whatever else there is stands across x and y.

    Parameters
    ----------
    room : Room
    geometry : Faces, optional
        Its faces take the place of the room's surfaces. Its materials are named as the room's; one
        that it lacks is unknown.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "ceiling", "paint", "desk"],
    ...             areas=[20, 20, 54, 5], alpha=[[0.1]] * 4, sigma=[[0.02]] * 4,
    ...             centre_frequencies=[1000])
    >>> print(facing(room)[:3])
    [[ 0.  0.  1.]
     [ 0.  0.  1.]
     [nan nan nan]]
    >>> print(facing(room.replace(dimensions=(4, 5, 3)))[2].round(2))
    [0.56 0.44 0.  ]
    """
    if geometry is not None:
        return _of_faces(room, geometry)
    known, unknown = np.zeros((room.n_materials, 3)), np.zeros(room.n_materials)
    walls = np.zeros(room.n_materials)
    stands = {surface.material for surface in room.surfaces}
    listed = [
        *((s.name, s.material, s.area, s.axis) for s in room.surfaces),
        *(
            (m, m, float(area), None)
            for m, area in zip(room.materials, room.areas, strict=True)
            if m not in stands
        ),
    ]
    for name, material, area, axis in listed:
        row = room.material_index(material)
        if axis is not None:
            known[row, AXES.index(axis)] += area
            continue
        says = [
            kind
            for kind, words in (("level", _LEVEL), ("wall", _WALL))
            if words.search(name) or words.search(material)
        ]
        if says == ["level"]:
            known[row, 2] += area
        elif says == ["wall"]:
            walls[row] += area
        else:
            unknown[row] += area
    box = _box(room)
    if box is None:
        known[:, :2] += walls[:, np.newaxis] / 2
    else:
        left = np.maximum(box - known.sum(axis=0), 0.0)
        if left[2] <= _FILLED * box[2]:
            # Floor and ceiling are known: what is left of the surfaces are walls.
            walls, unknown = walls + unknown, np.zeros_like(unknown)
        upright = left[:2] if left[:2].sum() > 0 else box[:2]
        known[:, :2] += walls[:, np.newaxis] * upright / upright.sum()
    total = known.sum(axis=1) + unknown
    with np.errstate(invalid="ignore", divide="ignore"):
        found = known / total[:, np.newaxis]
    found[unknown > 0] = np.nan
    return found


def _of_faces(room: Room, geometry: Faces) -> Array:
    sums = np.zeros((room.n_materials, 3))
    rows = {name: row for row, name in enumerate(room.materials)}
    for name, area, normal in zip(
        geometry.materials, geometry.face_areas, geometry.normals, strict=True
    ):
        if name in rows:
            sums[rows[name]] += area * np.asarray(normal) ** 2
    total = sums.sum(axis=1, keepdims=True)
    return np.where(total > 0, sums / np.where(total > 0, total, 1.0), np.nan)


def _box(room: Room) -> Array | None:
    """Return a box's areas across x, y and z in m², both walls of each; None without dimensions."""
    if room.dimensions is None:
        return None
    x, y, z = room.dimensions
    return 2 * np.array([y * z, x * z, x * y])
