"""Units, colours and names of layers in meshes are read as the format says, or refused by name."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from rtcal.io import mesh, units
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
COLOURS = {"floor": (200, 30, 10), "ceiling": (0, 255, 0), "walls": (0, 0, 255)}


def dxf(unit: int | None, length: float) -> str:
    head = "" if unit is None else f"0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n{unit}\n0\nENDSEC\n"
    rows = []
    for name, face in EVERY:
        rows.append(f"0\n3DFACE\n8\n{name}\n")
        for k, corner in enumerate(CORNERS[list(face)] / length):
            rows += [f"{10 * (axis + 1) + k}\n{float(x)!r}\n" for axis, x in enumerate(corner)]
    return f"{head}0\nSECTION\n2\nENTITIES\n{''.join(rows)}0\nENDSEC\n0\nEOF\n"


def require_box(done: mesh.Mended, areas: dict[str, float] = AREAS) -> None:
    assert done.size == pytest.approx(SIZE, rel=1e-6)
    assert done.volume == pytest.approx(60, rel=1e-6)
    assert done.areas == pytest.approx(areas, rel=1e-6)


ROOMS = [code for code, length in units.OF_DXF.items() if length is not None]


@pytest.mark.parametrize("code", ROOMS)
def test_the_same_room_in_every_unit_of_dxf(code: int, tmp_path: Path) -> None:
    path = tmp_path / "room.dxf"
    length = units.OF_DXF[code]
    assert length is not None
    path.write_text(dxf(code, length))
    require_box(mesh.room(path))
    assert not any("no unit" in note for note in mesh.room(path).notes)


@pytest.mark.parametrize(
    ("code", "length"), [(21, 0.3048006096), (8, 2.54e-8), (15, 10), (3, 1609.344)]
)
def test_units_of_dxf_are_those_of_the_reference(code: int, length: float) -> None:
    assert units.OF_DXF[code] == pytest.approx(length, rel=1e-9)


@pytest.mark.parametrize("code", [25, 99, -1])
def test_a_unit_that_dxf_does_not_have_is_refused(code: int, tmp_path: Path) -> None:
    path = tmp_path / "room.dxf"
    path.write_text(dxf(code, 1.0))
    with pytest.raises(DataError, match=rf"line 8: \$INSUNITS = {code} is not a unit of DXF"):
        mesh.room(path)
    require_box(mesh.room(path, unit=1.0))


def test_a_unit_that_is_not_stated_is_said_with_the_box_that_it_gives(tmp_path: Path) -> None:
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


def ply(order: str, *, colours: bool = True, triangles: int = 1) -> bytes:
    """A box of quads, the first few of them as two triangles."""
    faces = []
    for i, (name, (a, b, c, d)) in enumerate(EVERY):
        halves = [(a, b, c), (a, c, d)] if i < triangles else [(a, b, c, d)]
        faces += [(corners, COLOURS[name]) for corners in halves]
    head = [
        f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y",
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices",
        *[f"property uchar {c}" for c in ("red", "green", "blue") if colours],
        "end_header\n",
    ]
    start = "\n".join(head).encode()
    if order == "ascii":
        rows = [" ".join(f"{x:g}" for x in corner) for corner in CORNERS]
        for corners, colour in faces:
            rows.append(" ".join(map(str, (len(corners), *corners, *(colour if colours else ())))))
        return start + "\n".join(rows).encode() + b"\n"
    sign = "<" if "little" in order else ">"
    body = b"".join(struct.pack(f"{sign}3f", *corner) for corner in CORNERS)
    for corners, colour in faces:
        body += struct.pack(f"{sign}B{len(corners)}i", len(corners), *corners)
        body += struct.pack("3B", *colour) if colours else b""
    return start + body


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("triangles", [0, 1, 6])
def test_colours_of_a_ply_are_its_materials(order: str, triangles: int, tmp_path: Path) -> None:
    path = tmp_path / "room.ply"
    path.write_bytes(ply(order, triangles=triangles))
    require_box(
        mesh.room(path),
        {"colour #c81e0a": 20.0, "colour #00ff00": 20.0, "colour #0000ff": 54.0},
    )
    path.write_bytes(ply(order, triangles=triangles, colours=False))
    require_box(mesh.room(path), {"room": 94.0})


def gltf(materials: list[dict[str, object]]) -> bytes:
    """A box with y up, whose floor, ceiling and walls have the first, second and third material."""
    points = (CORNERS[:, [0, 2, 1]] * [1, 1, -1]).astype("<f4")
    data = points.tobytes()
    views: list[dict[str, int]] = [{"buffer": 0, "byteLength": len(data)}]
    accessors: list[dict[str, object]] = [
        {
            "bufferView": 0,
            "componentType": 5126,
            "count": 8,
            "type": "VEC3",
            "min": points.min(axis=0).tolist(),
            "max": points.max(axis=0).tolist(),
        }
    ]
    primitives = []
    for i, faces in enumerate(FACES.values()):
        index = [v for a, b, c, d in faces for v in (a, b, c, a, c, d)]
        made = struct.pack(f"<{len(index)}H", *index)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(made)})
        data += made
        accessors.append(
            {"bufferView": i + 1, "componentType": 5123, "count": len(index), "type": "SCALAR"}
        )
        primitives.append({"attributes": {"POSITION": 0}, "indices": i + 1, "material": i})
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
        "materials": materials,
        "meshes": [{"primitives": primitives}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    return json.dumps(tree).encode()


@pytest.mark.parametrize(
    ("materials", "names"),
    [
        ([{"name": "oak"}, {"name": "lime"}, {"name": "brick"}], ["oak", "lime", "brick"]),
        (
            [
                {"pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1]}}
                for r, g, b in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
            ],
            ["colour #ff0000", "colour #00ff00", "colour #0000ff"],
        ),
        ([{}, {}, {}], ["material 1", "material 2", "material 3"]),
        (
            [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}] * 2 + [{"name": "brick"}],
            ["material 1", "material 2", "brick"],
        ),
    ],
)
def test_materials_of_gltf_stay_apart(
    materials: list[dict[str, object]], names: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "room.gltf"
    path.write_bytes(gltf([dict(m) for m in materials]))
    require_box(mesh.room(path), dict(zip(names, AREAS.values(), strict=True)))
