"""Files that declare more than the budget are refused before they are loaded, in 2 s and 300 MB."""

import io
import json
import struct
import subprocess
import sys
import time
import tomllib
import zipfile

import pytest

from rtcal.io import mesh, tables
from rtcal.support.errors import DataError
from tests.corpus import book


def workbook(sheet, **others):
    """A workbook of one sheet with this XML below its root."""
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    with zipfile.ZipFile(io.BytesIO(book({"T": [[1]]}))) as good:
        parts = {name: good.read(name) for name in good.namelist()}
    parts["xl/worksheets/sheet1.xml"] = f'<worksheet xmlns="{space}">{sheet}</worksheet>'.encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in (parts | others).items():
            made.writestr(name, content)
    return stream.getvalue()


def cell(place):
    return f'<c r="{place}"><v>1</v></c>'


def instances(levels):
    """A COLLADA file of one tetrahedron, ten times in a node that stands ten times in the next."""
    nodes = '<node id="k0"><instance_geometry url="#g"/></node>' + "".join(
        f'<node id="k{k}">{f"""<instance_node url="#k{k - 1}"/>""" * 10}</node>'
        for k in range(1, levels)
    )
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><library_geometries>
<geometry id="g"><mesh><source id="p"><float_array id="a" count="12">0 0 0 4 0 0 0 4 0 0 0 4
</float_array><technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 1 2 3 2 0 3</p>
</triangles></mesh></geometry></library_geometries><library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="s"><node><instance_node url="#k{levels - 1}"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
""".encode()


def cycle():
    """Return a 3MF whose objects hold each other ten times."""
    parts = [f'<component objectid="{k}"/>' for k in (*[1] * 9, 2)]
    objects = [
        f'<object id="{k}"><components>{"".join(parts)}</components></object>' for k in (1, 2)
    ]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(
            "3D/3dmodel.model",
            '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
            f'{"".join(objects)}</resources><build><item objectid="1"/></build></model>',
        )
    return stream.getvalue()


HOSTILE = {
    "cycle.3mf": cycle,
    "instances.dae": lambda: instances(9),
    "merged.xlsx": lambda: workbook(
        f'<sheetData><row r="1">{cell("A1")}</row></sheetData><mergeCells count="1"><mergeCell '
        'ref="A1:XFD1048576"/></mergeCells>'
    ),
    "merged_often.xlsx": lambda: workbook(
        f'<sheetData><row r="1">{cell("A1")}</row></sheetData><mergeCells>'
        + "".join(f'<mergeCell ref="A{9000 * k + 1}:T{9000 * k + 8000}"/>' for k in range(9))
        + "</mergeCells>"
    ),
    "far.xlsx": lambda: workbook(
        f'<sheetData><row r="1">{cell("A1")}</row><row r="20000">{cell("OJ20000")}</row></sheetData>'
    ),
    "cells.xlsx": lambda: workbook(
        "<sheetData>"
        + "".join(f'<row r="{n}">' + "<c><v>1</v></c>" * 300 + "</row>" for n in range(1, 1500))
        + "</sheetData>"
    ),
    "unpacked.xlsx": lambda: workbook("<sheetData/>", **{"xl/media/x.bin": bytes(2**25)}),
    "faces.ply": lambda: (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 900000000\nproperty list uchar int vertex_index\nend_header\n"
    ),
    "corners.off": lambda: b"OFF\n900000000 6 0\n0 0 0\n",
    "triangles.stl": lambda: bytes(80) + struct.pack("<I", 400_000) + bytes(50 * 400_000),
}

CHILD = """
import json, resource, sys, time
from pathlib import Path
from rtcal.io import mesh, tables, sofa
from rtcal.support.errors import DataError
import openpyxl, trimesh, plyfile, netCDF4  # their own size is not the files'
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
rows = {}
for path in sorted(Path(sys.argv[1]).iterdir()):
    read = {".xlsx": tables.read, ".sofa": sofa.read}.get(path.suffix, mesh.read)
    start = time.process_time()
    try:
        read(path)
        said = "read"
    except DataError as error:
        said = str(error)
    rows[path.name] = said, time.process_time() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"rows": rows, "megabytes": peak - before}))
"""


def sofa_of(path, samples):
    """A SOFA file that declares responses and holds none: they compress to nothing."""
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(path, "w") as data:
        data.setncatts({"Conventions": "SOFA", "SOFAConventions": "SingleRoomSRIR"})
        for name, size in {"M": 1, "R": 1, "N": samples}.items():
            data.createDimension(name, size)
        data.createVariable("Data.IR", "f8", ("M", "R", "N"), zlib=True, fill_value=0.0)


@pytest.mark.long
def test_what_is_declared_beyond_the_budget_is_refused_before_it_is_loaded(tmp_path):
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name, made in HOSTILE.items():
        (folder / name).write_bytes(made())
    sofa_of(folder / "samples.sofa", 10**9)
    with open(folder / "large.ifc", "wb") as stream:
        stream.truncate(2**31)
    child = subprocess.run(
        [sys.executable, "-c", CHILD, str(folder)], capture_output=True, text=True, check=True
    )
    told = json.loads(child.stdout)
    assert {*told["rows"]} == {*HOSTILE, "samples.sofa", "large.ifc"}
    for name, (said, seconds) in told["rows"].items():
        assert name in said, f"{name}: {said}"
        assert "at most" in said or "several parents" in said, f"{name}: {said}"
        assert seconds < 8, f"{name} took {seconds:.1f} s"
    assert told["megabytes"] < 300


ENTITY = b'<?xml version="1.0"?>\n<!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>\n<x>&b;</x>'


@pytest.mark.parametrize(
    ("name", "part"),
    [("a.dae", ""), ("a.3mf", "3D/3dmodel.model"), ("a.xlsx", "xl/worksheets/sheet1.xml")],
)
def test_an_entity_of_xml_is_refused_by_its_line(name, part, tmp_path):
    pytest.importorskip("collada")
    (tmp_path / name).write_bytes(workbook("", **{part: ENTITY}) if part else ENTITY)
    place = rf"{name}: {part}, line 2" if part else f"{name}, line 2"
    with pytest.raises(DataError, match=f"{place}: declares an XML entity"):
        (tables if part.startswith("xl") else mesh).read(tmp_path / name)


def test_instances_of_instances_are_read(tmp_path):
    pytest.importorskip("collada")
    path = tmp_path / "instances.dae"
    path.write_bytes(instances(3))
    assert len(mesh.read(path).polygons) == 400
    path.write_bytes(instances(9))
    start = time.process_time()
    with pytest.raises(DataError, match="faces, but at most"):
        mesh.read(path)
    assert time.process_time() - start < 2


def test_a_text_larger_than_any_toml_of_ours_is_not_parsed_as_one(tmp_path, monkeypatch):
    path = tmp_path / "line.csv"
    path.write_bytes(b"a" * 2**23)
    monkeypatch.setattr(tomllib, "loads", lambda _: pytest.fail("parsed as TOML"))
    with pytest.raises(DataError, match=r"line\.csv: the file has more than"):
        tables.read(path)


def test_a_loop_of_symbolic_links_is_refused_by_its_name(tmp_path, rtcal):
    path = tmp_path / "loop.csv"
    path.symlink_to(path)
    for command in (("table",), ("calibrate", path), ("report",)):
        assert "loop.csv: Too many levels of symbolic links" in rtcal.refused(*command, path)
