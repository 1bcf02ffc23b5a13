"""Units, colours and names of layers in meshes are read as the format says, or refused by name."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.io import geometry_files, mesh, obj, units
from rtcal.support.errors import DataError

SIZE = np.array([5.0, 4.0, 3.0])
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * SIZE
FACES = {
    "floor": [(0, 2, 3, 1)],
    "ceiling": [(4, 5, 7, 6)],
    "walls": [(0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)],
}
AREAS = {"floor": 20.0, "ceiling": 20.0, "walls": 54.0}
EVERY = [(name, face) for name, faces in FACES.items() for face in faces]


def dxf(unit, length):
    head = "" if unit is None else f"0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n{unit}\n0\nENDSEC\n"
    rows = []
    for name, face in EVERY:
        rows.append(f"0\n3DFACE\n8\n{name}\n")
        for k, corner in enumerate(CORNERS[list(face)] / length):
            rows += [f"{10 * (axis + 1) + k}\n{float(x)!r}\n" for axis, x in enumerate(corner)]
    return f"{head}0\nSECTION\n2\nENTITIES\n{''.join(rows)}0\nENDSEC\n0\nEOF\n"


def require_box(done, areas=AREAS):
    assert done.size == pytest.approx(SIZE, rel=1e-6)
    assert done.volume == pytest.approx(60, rel=1e-6)
    assert done.areas == pytest.approx(areas, rel=1e-6)


ROOMS = [code for code, length in units.OF_DXF.items() if length is not None]


@pytest.mark.parametrize("code", ROOMS)
def test_the_same_room_in_every_unit_of_dxf(code, tmp_path):
    path = tmp_path / "room.dxf"
    length = units.OF_DXF[code]
    assert length is not None
    path.write_text(dxf(code, length))
    require_box(mesh.room(path))
    assert not any("no unit" in note for note in mesh.room(path).notes)


@pytest.mark.parametrize(
    ("code", "length"), [(21, 0.3048006096), (8, 2.54e-8), (15, 10), (3, 1609.344)]
)
def test_units_of_dxf_are_those_of_the_reference(code, length):
    assert units.OF_DXF[code] == pytest.approx(length, rel=1e-9)


@pytest.mark.parametrize("code", [25, 99, -1])
def test_a_unit_that_dxf_does_not_have_is_refused(code, tmp_path):
    path = tmp_path / "room.dxf"
    path.write_text(dxf(code, 1.0))
    with pytest.raises(DataError, match=rf"line 8: \$INSUNITS = {code} is not a unit of DXF"):
        mesh.room(path)
    require_box(mesh.room(path, unit=1.0))


def test_a_unit_that_is_not_stated_is_said_with_the_box_that_it_gives(tmp_path):
    path = tmp_path / "room.dxf"
    for code in (None, 0):
        path.write_text(dxf(code, 1.0))
        done = mesh.room(path)
        require_box(done)
        assert (
            done.notes[0]
            == "the file states no unit; metres (unit = 1) are assumed: the room is 5 × 4 × 3 m"
        )
        assert not any("states no unit" in note for note in mesh.room(path, unit=1.0).notes)


def obj_text(head, length):
    corners = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in CORNERS / length]
    faces = [f"usemtl {name}\nf {' '.join(str(k + 1) for k in face)}" for name, face in EVERY]
    return "\n".join([head, *corners, *faces, ""])


def ply_text(head, length):
    lines = ["ply", "format ascii 1.0", f"comment {head}", "element vertex 8"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["element face 6", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in CORNERS / length]
    return "\n".join([*lines, *(f"4 {a} {b} {c} {d}" for _, (a, b, c, d) in EVERY), ""])


def stl_text(head, length):
    rows = [f"solid {head}"]
    for _, (a, b, c, d) in EVERY:
        for triangle in ((a, b, c), (a, c, d)):
            rows += ["facet normal 0 0 0", "outer loop"]
            rows += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in CORNERS[[*triangle]] / length]
            rows += ["endloop", "endfacet"]
    return "\n".join([*rows, "endsolid", ""])


@pytest.mark.parametrize(
    ("ending", "written", "head", "length"),
    [
        (".obj", obj_text, "# Exported from a sketch\n# File units = inches", 0.0254),
        (".obj", obj_text, "# units: Millimeters\r", 0.001),
        (".obj", obj_text, "# 7 units of furniture, each in a box", None),
        (".obj", obj_text, "# units: mm\n# File units = inches", None),
        (".obj", obj_text, "#units feet", 0.3048),
        (".obj", obj_text, "# Model, units are in mm", 0.001),
        (".obj", obj_text, "# All units in [inches]", 0.0254),
        (".obj", obj_text, "# 1 unit = 1 cm", 0.01),
        (".obj", obj_text, "# units in the file: none", None),
        (".ply", ply_text, "units: cm", 0.01),
        (".ply", ply_text, "units cm", 0.01),
        (".stl", stl_text, "hall units feet", 0.3048),
        (".stl", stl_text, "hall UNITS=feet", 0.3048),
        (".stl", stl_text, "hall", None),
    ],
)
def test_a_unit_in_a_comment_is_that_of_the_file(ending, written, head, length, tmp_path):
    path = tmp_path / f"room{ending}"
    path.write_text(written(head, length or 1.0))
    done = mesh.room(path)
    assert done.size == pytest.approx(SIZE, rel=1e-6)
    assert done.volume == pytest.approx(60, rel=1e-6)
    assert any("no unit" in note for note in done.notes) == (length is None)
    if ending == ".obj":
        assert obj.read(path).volume == pytest.approx(60, rel=1e-6)


@pytest.mark.parametrize("head", ["# units: furlongs", "# File units = 2.5 cm"])
def test_an_unknown_unit_in_a_comment_is_refused_unless_one_is_given(head, tmp_path):
    path = tmp_path / "room.obj"
    path.write_text(obj_text(head, 1.0))
    for reader in (mesh.room, obj.read):
        with pytest.raises(DataError, match=r"room.obj, line 1: the unit of .* is none of m, cm"):
            reader(path)
        assert reader(path, unit=1.0).volume == pytest.approx(60, rel=1e-6)


def test_a_room_keeps_the_unit_of_its_mesh(tmp_path, rtcal):
    path, out = tmp_path / "hall.obj", tmp_path / "room.toml"
    path.write_text(obj_text("# File units = inches", 0.0254))
    entries = [f"--catalogue={name}=rough_concrete" for name in FACES]
    rtcal("import", "catalogue", "--mesh", path, *entries, "--out", out)
    assert geometry_files.read(rt.Room.from_file(str(out))).volume == pytest.approx(60, rel=1e-6)


def test_a_name_with_a_number_sign_is_read_as_it_was_written():
    """Colours are names of materials where a file has no others."""
    sides = dict.fromkeys(("west", "east", "south", "north", "floor"), "colour #0ac80a")
    box = rt.simulators.Polyhedron.shoebox([5, 4, 3], {**sides, "ceiling": "tile #2"})
    read = obj.parse(box.to_text().encode())
    assert read.areas == pytest.approx({"colour #0ac80a": 74.0, "tile #2": 20.0})
    noted = box.to_text().replace("usemtl tile #2", "usemtl tile #2 # a note")
    assert obj.parse(noted.encode()).areas == read.areas
