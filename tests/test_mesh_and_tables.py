"""Meshes with material names, and tables of measured values."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rtcal.finder.positions.surfaces import of_geometry
from rtcal.io import catt, mesh, obj
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.support.errors import DataError
from tests import fuzz

FOLDER = Path(__file__).parent / "meshes"
ROOMS = tomllib.loads((FOLDER / "rooms.toml").read_text("utf-8"))


@pytest.mark.parametrize("name", ROOMS)
def test_a_file_has_the_room_that_is_drawn(name):
    """Every format, and what stands for the materials in it: layers, colours, groups, objects."""
    done, drawn = mesh.room(FOLDER / name), ROOMS[name]
    assert done.volume == pytest.approx(drawn["volume"], rel=1e-6)
    assert np.ptp(done.geometry.vertices, axis=0) == pytest.approx(drawn["size"], rel=1e-6)
    assert done.areas == pytest.approx(drawn["areas"], rel=1e-6)
    assert any("not faces: 1 LINE" in note for note in done.notes) == name.endswith(".dxf")


def test_a_stated_unit_replaces_the_file_s():
    done = mesh.room(FOLDER / "mesh.dxf", unit=0.01)
    assert done.volume == pytest.approx(1000 * ROOMS["mesh.dxf"]["volume"], rel=1e-9)
    assert "a unit of 0.001 m, but 0.01 m was given" in done.notes[0]


def test_a_mesh_in_another_unit_is_refused():
    in_mm = Polyhedron.shoebox((5000, 4000, 3000), "plaster")
    vertices = "".join("v " + " ".join(f"{x:g}" for x in v) + "\n" for v in in_mm.vertices)
    faces = "".join("f " + " ".join(str(i + 1) for i in f) + "\n" for f in in_mm.faces)
    content = (vertices + "usemtl plaster\n" + faces).encode()
    with pytest.raises(DataError, match=r"V = 6e\+10 m³ .* 60 m³ in mm \(unit = 0.001\)"):
        obj.parse(content)
    assert obj.parse(content, unit=0.001).volume == pytest.approx(60, rel=1e-12)
    with pytest.raises(DataError, match=r"V = 2e-09 m³ must be from 0.001 .* 2 m³ in m \(unit ="):
        obj.parse(fuzz.OBJ[0], unit=0.001)


def test_a_room_of_a_mesh_and_a_list():
    box = obj.parse(fuzz.OBJ[0])
    listed = catt.parse(b"ABS wood = <10 10 10 10 10 10>\nABS brick = <2 2 2 2 2 2>\n")
    room = listed.room(name="box", volume=box.volume, areas=box.surfaces)
    assert room.absorption_area == pytest.approx([0.36] * 6, rel=1e-12)
    assert {s.axis for s in room.surfaces} == {"x", "y", "z"}


def test_a_written_mesh_reads_back(tmp_path):
    first = Polyhedron.shoebox((5.1, 7.3, 3.7), "plaster")
    first.save(tmp_path / "a.obj")
    again = obj.read(tmp_path / "a.obj")
    assert again.volume == first.volume
    assert again.areas == first.areas
    assert np.array_equal(again.vertices, first.vertices)


def test_faces_without_a_group_have_the_name_of_their_material():
    materials = {**dict.fromkeys(SHOEBOX_WALLS, "plaster"), "floor": "parquet", "ceiling": "tiles"}
    box = Polyhedron.shoebox((4, 5, 3), materials)
    text = re.sub(r"(?m)^[go] .*\n", "", box.to_text())
    read = obj.parse(text.encode())
    assert read.names == ("plaster", "plaster 2", "plaster 3", "plaster 4", "parquet", "tiles")
    assert [*of_geometry(read)] == [*read.names]
