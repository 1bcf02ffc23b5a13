"""The geometry of a room's scene: its mesh, or the box of its dimensions."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from rtcal.acoustics.changes import facing
from rtcal.acoustics.room import Directivity, Room
from rtcal.io import balloon, obj, units
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import (
    PathTracing,
    area_doubt,
    refuse_other_unit,
    volume_doubt,
)
from rtcal.simulators.shoebox import box_of
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["path_tracing", "read"]
__dir__ = __all__.copy


def read(room: Room) -> Polyhedron:
    """Return the geometry of a room: its mesh, or a box with the room's dimensions.

    For a box the room needs one surface per wall. Raises DataError for the reasons of
    `rtcal.io.obj.read`, for a mesh with an unknown material, and for a room without mesh and
    dimensions.
    """
    checks.instance("room", room, Room)
    if room.scene.mesh is not None:
        geometry = obj.read(room.scene.mesh, unit=room.scene.unit, leaks=room.scene.leaks)
        for face, material in zip(geometry.names, geometry.materials, strict=True):
            try:
                room.material_index(material)
            except DataError as error:
                raise DataError(f'{os.fspath(room.scene.mesh)}, face "{face}": {error}') from error
        return geometry
    if room.dimensions is None:
        raise DataError(
            f'room "{room.name}" has neither a mesh nor dimensions: write [geometry] with mesh = '
            '"room.obj" into its file'
        )
    return box_of(room)


def directions(room: Room) -> Array:
    """Return shares of each material's area that face x, y and z, (n_materials, 3); NaN if unknown."""
    stated = facing(room)
    if room.scene.mesh is None or np.isfinite(stated).all():
        return stated
    try:
        of_mesh = facing(room, read(room))
    except DataError:  # told by `mesh_doubt`
        return stated
    return np.where(np.isnan(of_mesh), stated, of_mesh)


def mesh_doubt(room: Room) -> str:
    """Return in a sentence how a room's areas or volume differ from those of its mesh, or ""."""
    if checks.instance("room", room, Room).scene.mesh is None:
        return ""
    try:
        geometry = read(room)
    except units.UnitError:
        raise
    except DataError as error:
        return f"the room's areas and volume could not be compared with its mesh: {error}"
    refuse_other_unit(geometry, room)
    return ". ".join(filter(None, (volume_doubt(geometry, room), area_doubt(geometry, room))))


def path_tracing(room: Room, **options: Any) -> PathTracing:
    """Return a path tracing of a room whose file has its geometry, sources and receivers.

    ``options`` are further arguments of `PathTracing`, such as ``n_paths``. If the room states a file
    with the directivity of a source, this file is read. Raises DataError for a room without sources and
    receivers, and for the reasons of `read`, `rtcal.io.balloon.read` and `PathTracing`.

    Examples
    --------
    >>> import rtcal as rt
    >>> box = rt.Room(name="box", volume=60, dimensions=(4, 5, 3), materials=["plaster"], areas=[94],
    ...               alpha=[[0.1]], sigma=[[0.02]], centre_frequencies=[1000], scattering=[[0.3]],
    ...               scene=rt.Scene(sources={"S1": (1, 1, 1.5)}, receivers={"R1": (3, 4, 1.2)}))
    >>> path_tracing(box, n_paths=160).pairs
    (('S1', 'R1'),)
    """
    if not checks.instance("room", room, Room).scene.sources:
        raise DataError(
            f'room "{room.name}" has no positions of sources and receivers: write [sources] and '
            "[receivers] into its file, with a line such as S1 = [1.2, 3.4, 1.5] for each"
        )
    geometry = read(room)
    refuse_other_unit(geometry, room)  # before a position that is then outside the room
    return PathTracing(
        geometry=geometry,
        room=room,
        sources=room.scene.sources,
        receivers=room.scene.receivers,
        **{"directivity": directivity(room), **options},
    )


def directivity(room: Room) -> dict[str, Any]:
    """Return the directivities of a room's sources, read from their files; raises as `balloon.read`."""
    return {
        name: balloon.read(of.file, room.centre_frequencies, of.aim, of.up)
        if isinstance(of, Directivity) and of.file is not None
        else of
        for name, of in room.scene.directivity.items()
    }
