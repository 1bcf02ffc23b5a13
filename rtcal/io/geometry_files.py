"""The geometry of a room's file: its mesh, or the box of its dimensions."""

from __future__ import annotations

import os

from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.io import obj
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.support.arguments import checked


@checked
def read(room: Room, mesh: str | os.PathLike[str] | None = None, unit: float = 1.0) -> Polyhedron:
    """Return the mesh (OBJ), or the box of a room with dimensions and a surface per wall.

    ``unit`` is the length of the mesh's unit in m. Raises DataError as `rtcal.io.obj.read`, for a
    mesh with a material that the room lacks, and for a room without a mesh that states no dimensions.
    """
    if mesh is not None:
        geometry = obj.read(mesh, unit=unit)
        for face, material in zip(geometry.names, geometry.materials, strict=True):
            try:
                room.material_index(material)
            except DataError as error:
                raise DataError(f'{os.fspath(mesh)}, face "{face}": {error}') from error
        return geometry
    if room.dimensions is None:
        raise DataError(f'room "{room.name}" states no dimensions: give its mesh')
    if room.n_materials == 1:
        return Polyhedron.shoebox(room.dimensions, room.materials[0])
    walls = {s.name: s.material for s in room.surfaces if s.name in SHOEBOX_WALLS}
    return Polyhedron.shoebox(room.dimensions, walls)
