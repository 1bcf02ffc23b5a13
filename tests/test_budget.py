"""Files that declare more than the budget are refused before they are loaded, in 2 s and 300 MB."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

BOX = "0 0 0 5 0 0 0 4 0 5 4 0 0 0 3 5 0 3 0 4 3 5 4 3"


def archive(parts: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in parts.items():
            made.writestr(name, content)
    return stream.getvalue()


def workbook(sheet: str, **others: bytes) -> bytes:
    """A workbook of one sheet with this XML below its root."""
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    types = f"{package.replace('package', 'package')}/content-types"
    main = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    return archive(
        {
            "[Content_Types].xml": (
                f'<Types xmlns="{types}"><Default Extension="rels" ContentType='
                '"application/vnd.openxmlformats-package.relationships+xml"/><Override PartName='
                f'"/xl/workbook.xml" ContentType="{main}.sheet.main+xml"/><Override PartName='
                f'"/xl/worksheets/sheet1.xml" ContentType="{main}.worksheet+xml"/></Types>'
            ).encode(),
            "_rels/.rels": (
                f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" Type='
                f'"{relations}/officeDocument" Target="xl/workbook.xml"/></Relationships>'
            ).encode(),
            "xl/workbook.xml": (
                f'<workbook xmlns="{space}" xmlns:r="{relations}"><sheets><sheet name="T" '
                'sheetId="1" r:id="r1"/></sheets></workbook>'
            ).encode(),
            "xl/_rels/workbook.xml.rels": (
                f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" Type='
                f'"{relations}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>'
            ).encode(),
            "xl/worksheets/sheet1.xml": f'<worksheet xmlns="{space}">{sheet}</worksheet>'.encode(),
            **others,
        }
    )


def cell(place: str) -> str:
    return f'<c r="{place}"><v>1</v></c>'


def collada(depth: int) -> bytes:
    """Nodes of which each has two instances of the next, with a geometry in the last."""
    nodes = "".join(
        f'<node id="n{k}"><instance_node url="#n{k + 1}"/><instance_node url="#n{k + 1}"/></node>'
        for k in range(depth)
    )
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1"><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries>'
        '<geometry id="g"><mesh><source id="p"><float_array id="a" count="24">'
        f'{BOX}</float_array><technique_common><accessor source="#a" count="8" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>'
        '</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" '
        'source="#p"/></vertices><triangles count="1"><input semantic="VERTEX" source="#v" '
        'offset="0"/><p>0 2 3</p></triangles></mesh></geometry></library_geometries><library_nodes>'
        f'{nodes}<node id="n{depth}"><instance_geometry url="#g"/></node></library_nodes>'
        '<library_visual_scenes><visual_scene id="s"><node id="top"><instance_node url="#n0"/>'
        '</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/>'
        "</scene></COLLADA>"
    ).encode()


def model_3mf(depth: int) -> bytes:
    """Objects of which each has two components of the one before."""
    objects = "".join(
        f'<object id="{k}"><components><component objectid="{k - 1}"/><component objectid="{k - 1}"/>'
        "</components></object>"
        for k in range(2, depth)
    )
    return (
        '<model unit="meter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        '<resources><object id="1"><mesh><vertices><vertex x="0" y="0" z="0"/></vertices><triangles>'
        f'<triangle v1="0" v2="0" v3="0"/></triangles></mesh></object>{objects}</resources><build>'
        f'<item objectid="{depth - 1}"/></build></model>'
    ).encode()


def gltf(accessors: list[dict[str, object]], nodes: list[dict[str, object]]) -> bytes:
    primitive = {"attributes": {"POSITION": 0}}
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "accessors": accessors,
            "meshes": [{"primitives": [primitive]}],
            "nodes": nodes,
            "scenes": [{"nodes": [0]}],
            "scene": 0,
        }
    ).encode()


def glb(tree: bytes) -> bytes:
    tree += b" " * (-len(tree) % 4)
    return struct.pack("<4s4I", b"glTF", 2, 20 + len(tree), len(tree), 0x4E4F534A) + tree


MANY = {"componentType": 5126, "count": 10**9, "type": "VEC3"}
FEW = {"componentType": 5126, "count": 3, "type": "VEC3"}
DOUBLED = [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]

HOSTILE: dict[str, Callable[[], bytes]] = {
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
    "nodes.dae": lambda: collada(40),
    "unpacked.3mf": lambda: archive({"3D/3dmodel.model": model_3mf(3) + b" " * 2**26}),
    "components.3mf": lambda: archive({"3D/3dmodel.model": model_3mf(40)}),
    "accessor.gltf": lambda: gltf([MANY], [{"mesh": 0}]),
    "accessor.glb": lambda: glb(gltf([MANY], [{"mesh": 0}])),
    "nodes.gltf": lambda: gltf([FEW], list(DOUBLED)),
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
import openpyxl, trimesh, collada, plyfile, lxml, netCDF4  # their own size is not the files'
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


def sofa_of(path: Path, samples: int) -> None:
    """A SOFA file that declares responses and holds none: they compress to nothing."""
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(path, "w") as data:
        data.setncatts({"Conventions": "SOFA", "SOFAConventions": "SingleRoomSRIR"})
        for name, size in {"M": 1, "R": 1, "N": samples}.items():
            data.createDimension(name, size)
        data.createVariable("Data.IR", "f8", ("M", "R", "N"), zlib=True, fill_value=0.0)


@pytest.mark.long
def test_what_is_declared_beyond_the_budget_is_refused_before_it_is_loaded(tmp_path: Path) -> None:
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
        assert seconds < 20, f"{name} took {seconds:.1f} s"
    assert told["megabytes"] < 300


def test_what_is_within_the_budget_is_read(tmp_path: Path) -> None:
    from rtcal.io import workbook as workbooks

    content = workbooks.content({"T": [["f", "t"], *[[float(k), 1.0] for k in range(2000)]]})
    (sheet,) = workbooks.sheets(content, "t.xlsx", {})
    assert len(sheet.rows) == 2001
    assert np.isclose(float(sheet.rows[-1][1][0]), 1999)
