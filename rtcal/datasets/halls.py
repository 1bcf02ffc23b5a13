"""Invented halls for case studies and benchmarks, none of which models a real room.

`lecture_hall` has the published data of the paper's lecture hall (Bellows & Katz 2025, Sect. 4.1): 23
surfaces, 334 m³, ratio 66.6 of largest to smallest area. The paper has no plan and no areas. The
stochastic study uses the areas ``lecture_hall().geometry.face_areas``. `hard_hall` resembles the Palais
des Papes (hard parallel walls), `theatre` the Athenee (thirty materials, very uneven absorption).
`corridor` is long and thin, so that its decay depends on the scattering model.

Each is a room's file and a mesh in the folder ``halls``. Absorption coefficients are rounded textbook
values, scattering coefficients are estimates, one per material; sigma is the paper's three tiers 0.01,
0.05 and 0.1 (Sect. 4.3.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rtcal.acoustics.room import Room, Scene
from rtcal.datasets.examples import path
from rtcal.io import obj
from rtcal.simulators.geometry import Polyhedron

__all__ = ["corridor", "hard_hall", "lecture_hall", "theatre"]
__dir__ = __all__.copy


@dataclass(frozen=True, eq=False)
class Hall:
    """Hold a hall to simulate: geometry, room, and named sources and receivers (x, y, z in m).

    ``held_out`` are the names of receivers that a calibration must not use.

    ``geometry`` is the hall's mesh, ``room`` has its materials and coefficients, and ``sources`` and
    ``receivers`` map names to positions.
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Sequence[float]]
    receivers: Mapping[str, Sequence[float]]
    held_out: Mapping[str, Sequence[float]]

    def __repr__(self) -> str:
        counts = f"{len(self.sources)} sources, {len(self.receivers)} receivers"
        return f"<Hall {self.room!r}: {counts}, {len(self.held_out)} held out>"


def _hall(name: str, *held_out: str) -> Hall:
    """Return the hall of a file; ``held_out`` are names of its receivers."""
    stated = Room.from_file(str(path(f"halls/{name}.toml")))
    geometry, scene = obj.read(str(stated.scene.mesh)), stated.scene
    receivers = dict(scene.receivers)
    apart = {receiver: receivers.pop(receiver) for receiver in held_out}
    # The scene is that of the hall, so that a study may choose among its places.
    room = stated.replace(surfaces=geometry.surfaces, scene=Scene())
    return Hall(geometry, room, scene.sources, receivers, apart)


def lecture_hall() -> Hall:
    """Return a raked lecture hall of 334 m³ with 23 surfaces, like that of Bellows & Katz (2025).

    The hall is 11 m deep and 8.9 m wide. Its largest surface is 66.6 times as large as its smallest.
    The `Hall` has the geometry, the room with nine materials, two sources and seven receivers, of which
    three are ``held_out``.
    """
    return _hall("lecture_hall", "R5", "R6", "R7")


def hard_hall() -> Hall:
    """Return a hard hall with parallel walls, 40 x 14 x 10 m, a platform and chairs on its floor.

    The absorption is on the floor, and sound remains between the smooth parallel walls above it.
    The decay is therefore longer than by Sabine's equation. The `Hall` has the geometry, the room with
    seven materials, two sources and eight receivers, of which three are ``held_out``.
    """
    return _hall("hard_hall", "R6", "R7", "R8")


def theatre() -> Hall:
    """Return a theatre with two tiers, boxes, a fly tower and thirty materials.

    Drapes and seats absorb strongly, ceiling and parapets hardly. Stage and auditorium are connected by
    the proscenium opening only. The `Hall` has the geometry, the room of 4312 m³, two sources and eight
    receivers, of which three are ``held_out``.
    """
    return _hall("theatre", "R6", "R7", "R8")


def corridor() -> Hall:
    """Return a corridor of 40 x 2.4 x 3 m with absorbing ceiling tiles.

    The `Hall` has the geometry, the room with four materials, one source and six receivers, of which
    two are ``held_out``.
    """
    return _hall("corridor", "R5", "R6")
