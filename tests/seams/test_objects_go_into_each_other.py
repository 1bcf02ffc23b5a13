"""A law: what one part makes, the next takes: geometry, room, file, case."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.io import obj
from rtcal.simulators import Polyhedron

BANDS = [500.0, 1000.0]
MATERIALS = [
    rt.Material("plaster", alpha=[0.1, 0.2], sigma=[0.02, 0.02]),
    rt.Material("carpet", alpha=[0.3, 0.4], sigma=[0.05, 0.05]),
]


def geometry() -> Polyhedron:
    walls = dict.fromkeys(("west", "east", "south", "north", "ceiling"), "plaster")
    return Polyhedron.shoebox((4, 5, 3), {**walls, "floor": "carpet"})


def test_a_geometry_makes_a_room_and_a_file(tmp_path) -> None:
    shape = geometry()
    room = rt.Room.from_geometry(
        shape, name="box", materials=MATERIALS, centre_frequencies=BANDS, air=rt.Air()
    )
    assert room.volume == shape.volume
    assert dict(zip(room.materials, room.areas, strict=True)) == pytest.approx(shape.areas)
    shape.save(tmp_path / "room.obj")
    again = obj.read(tmp_path / "room.obj")
    np.testing.assert_allclose(again.vertices, shape.vertices)
    assert (again.materials, again.names) == (shape.materials, shape.names)


def test_one_room_file_serves_both_kinds_of_case(tmp_path) -> None:
    shape = geometry()
    points = {
        "sources": {"S1": (1.0, 1.0, 1.5)},
        "receivers": {"R1": (3, 4, 1.2), "R2": (1, 4, 1.2)},
    }
    room = rt.Room.from_geometry(
        shape, name="box", materials=MATERIALS, centre_frequencies=BANDS, air=rt.Air()
    ).replace(scene=rt.Scene(mesh=tmp_path / "room.obj", **points), scattering=np.full((2, 2), 0.4))
    room.save(str(tmp_path / "room.toml"))
    shape.save(tmp_path / "room.obj")
    pairs = (("S1", "R1"), ("S1", "R2"))
    values = {"t20": np.array([[0.8, 0.7], [0.82, 0.71]])}
    measured = rt.Measurement(centre_frequencies=BANDS, values=values, pairs=pairs)
    measured.save(str(tmp_path / "pairs.csv"))
    (tmp_path / "gap.toml").write_text(
        'room = "room.toml"\n[[configuration]]\nname = "as it is"\nmeasured = "pairs.csv"\n',
        encoding="utf-8",
    )
    read = rt.Room.from_file(str(tmp_path / "room.toml"))
    case = rt.finder.case_of(read, measured, tracing={"n_paths": 400})
    assert case.pairs == pairs
    assert case.geometry.areas == pytest.approx(shape.areas)
    again = rt.finder.Case.from_file(str(tmp_path / "gap.toml")).room
    assert again.scene == read.scene
