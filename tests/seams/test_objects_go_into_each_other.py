"""A law: what one part makes, the next takes: geometry, room, file, case."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.errors import DataError
from rtcal.io import obj, position_files
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


def test_areas_by_material_are_in_any_order() -> None:
    stated = {
        "name": "box",
        "volume": 60,
        "materials": ["floor", "rest"],
        "alpha": {"rest": [0.6], "floor": [0.4]},
        "sigma": [[0.1], [0.1]],
        "centre_frequencies": [1000],
    }
    room = rt.Room(areas={"rest": 74, "floor": 20}, **stated)
    assert room.areas.tolist() == [20, 74]
    assert room.alpha.tolist() == [[0.4], [0.6]]
    with pytest.raises(DataError, match="areas: keys are floor, walls; the room has floor, rest"):
        rt.Room(areas={"floor": 20, "walls": 74}, **stated)


def test_both_kinds_of_case_read_their_file(tmp_path) -> None:
    shape = geometry()
    room = rt.Room.from_geometry(
        shape, name="box", materials=MATERIALS, centre_frequencies=BANDS, air=rt.Air()
    )
    room.save(str(tmp_path / "room.toml"))
    shape.save(tmp_path / "room.obj")
    points = {"S1": (1.0, 1.0, 1.5)}, {"R1": (3.0, 4.0, 1.2), "R2": (1.0, 4.0, 1.2)}
    (tmp_path / "positions.toml").write_text(position_files.text(*points), encoding="utf-8")
    pairs = [("S1", "R1"), ("S1", "R2")]
    values = {"t20": np.array([[0.8, 0.7], [0.82, 0.71]])}
    rt.Measurement(centre_frequencies=BANDS, values=values, pairs=pairs).save(
        str(tmp_path / "pairs.csv")
    )
    (tmp_path / "where.toml").write_text(
        'room = "room.toml"\ngeometry = "room.obj"\npositions = "positions.toml"\n'
        'measured = "pairs.csv"\nscattering = 0.4\npaths = 400\n',
        encoding="utf-8",
    )
    (tmp_path / "gap.toml").write_text(
        'room = "room.toml"\n[[configuration]]\nname = "as it is"\nmeasured = "pairs.csv"\n',
        encoding="utf-8",
    )
    assert rt.where.Case.from_file(tmp_path / "where.toml").pairs == tuple(pairs)
    assert rt.discrepancy.Case.from_file(str(tmp_path / "gap.toml")).room.volume == room.volume
    with pytest.raises(DataError, match=r"where\.toml: .*rtcal\.where\.Case\.from_file"):
        rt.discrepancy.Case.from_file(str(tmp_path / "where.toml"))
    with pytest.raises(DataError, match=r"gap\.toml: "):
        rt.where.Case.from_file(tmp_path / "gap.toml")
