"""Meshes of every format as `rtcal.io.mend.Faces`: what is drawn, with the names of its materials.

A format is one reader, which returns what a file draws in its own unit: OBJ, OFF and 3MF by own code,
DXF by ezdxf, COLLADA (.dae), which SketchUp writes, by pycollada, PLY by plyfile, STL and glTF by
trimesh (all ``rtcal[mesh]``). trimesh reads COLLADA, too, but not the materials' names. A mesh
without materials, such as STL, has one, named after its file. Objects of 3MF, which have names and no
materials, are materials. Of DXF (text) 3D faces, polyface and polygon meshes and meshes are read; the
layer is the material, and others, such as lines, blocks and solids (ACIS), are counted in a note.

The axes are turned so that z is up where the format says that y is (glTF, COLLADA).
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import numpy as np

from rtcal.files.disk import read_bytes
from rtcal.io import budget, ifc, obj, units
from rtcal.io.mend import WELD, Faces, Mended, MeshError, mended
from rtcal.io.text import decode, lines, number, shown
from rtcal.support import checks, library
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

__all__ = ["read", "room"]
__dir__ = __all__.copy

MAX_BYTES = 2**26
IFC = ".ifc"
_Y_UP = (".glb", ".gltf")
_WITH_COMMENTS = (".obj", ".off", ".ply", ".stl")
_TURNED = "y points up in the file, so its z became -y"
_REFUSED = {
    ".skp": "SketchUp's own format; export COLLADA (.dae) from it",
    ".blend": "Blender's own format; export glTF (.glb) from it",
    ".3dm": "Rhino's own format; export OBJ from it, one material per layer",
    ".dwg": "AutoCAD's own format; save it as DXF with 3D faces",
    ".fbx": "a format without a public description; export glTF (.glb)",
    ".geo": "CATT's list of materials goes before the mesh: rtcal import catt hall.geo --mesh hall.obj",
}
_SIMPLER = "simplify the model"
_JSON_CHUNK = 0x4E4F534A
_ROOMS = 1.5, 1000.0  # Least and largest length in m of the longest side of the box around a room


Row = tuple[str, str, Any]
"""Material, name and corners (n, 3) of a face, in the unit of the file."""


@dataclass
class _Drawn:
    """What a file draws, the length in m of the unit that it states, and whether y is up in it."""

    faces: Iterable[Row]
    unit: float | None = None
    y_is_up: bool = False
    notes: Sequence[str] = ()


def read(
    path: str | os.PathLike[str],
    *,
    unit: float | None = None,
    space: str | None = None,
    weld: float = WELD,
) -> Faces:
    """Return the faces of a mesh file as they are drawn, without a check that they enclose a room.

    The `Faces` have corners in m, material and name of each face, and notes on how the file was read.
    Raises DataError for a format that is not read, and for a broken file. Raises MissingDependencyError
    if the format needs trimesh or ifcopenshell, which is not installed.

    Parameters
    ----------
    path : path
        Path of the mesh: OBJ, DXF, DAE, PLY, 3MF, OFF, STL, GLB, GLTF or IFC.
    unit : float, optional
        Length of the file's unit in m; by default as stated in the file, or else 1.
    space : str, optional
        Name of the space to read, for a building model (IFC) with several spaces.
    weld : float
        For a building model: largest gap in m between the ends of a face's outline that counts as
        closed.
    """
    if unit is not None:
        unit = checks.positive("unit", unit, "m")
    ending = checks.path("path", path).suffix.lower()
    if ending == IFC:
        return ifc.faces(os.fspath(path), unit, space, weld)
    if space is not None:
        raise DataError(
            f"{path}: --space can be used only with a building model (IFC): leave it out"
        )
    if ending in _REFUSED:
        raise DataError(f"{path}: {_REFUSED[ending]}")
    if ending not in READERS:
        raise DataError(
            f'{path}: "{ending}" is not a mesh format; rtcal reads {", ".join((*READERS, IFC))}'
        )
    content, path = read_bytes(path, MAX_BYTES), os.fspath(path)
    drawn = READERS[ending](content, path, unit is not None)
    if ending in _WITH_COMMENTS:
        with suppress(DataError) if unit is not None else nullcontext():
            drawn.unit = units.in_comments(content, path)
    rows = [*drawn.faces]
    if not rows:
        raise DataError(f"{path}: the mesh has no face; a room needs at least 4")
    length = next((u for u in (unit, drawn.unit) if u is not None), 1.0)
    axes = np.eye(3) if not drawn.y_is_up else np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    polygons = [(np.asarray(corners, dtype=float) * length) @ axes for *_, corners in rows]
    notes = (*units.notes(length, drawn.unit, unit), *[_TURNED] * drawn.y_is_up, *drawn.notes)
    materials, names = (
        _named(path, [row[k] for row in rows], of, otherwise)
        for k, of, otherwise in ((0, "a material", Path(path).stem), (1, "a part", "part"))
    )
    known = None if unit is None and drawn.unit is None else length
    return Faces(path, polygons, materials, names, notes, known)


def _named(path: str, names: Sequence[str], of: str, otherwise: str) -> list[str]:
    """Return names as a room's file takes them."""
    taken = {name: text_name(f"{path}: {of}", name) or otherwise for name in {*names}}
    return [taken[name] for name in names]


def _parsing(path: str, kind: str) -> AbstractContextManager[None]:
    cure = "Export OBJ from your program, one material per layer"
    return budget.parsing(path, kind, cure, "mesh")


def room(
    path: str | os.PathLike[str],
    *,
    unit: float | None = None,
    space: str | None = None,
    weld: float = WELD,
    largest_hole: float | None = None,
) -> Mended:
    """Return the room that the faces of a mesh file enclose, and the defects that were repaired.

    ``path``, ``unit`` and ``space`` are those of `read`. Corners up to ``weld`` in m apart become one,
    and holes up to ``largest_hole`` in m² are closed, by default 1 % of the area of the walls. The
    result (`rtcal.io.mend.Mended`) has the ``geometry``, volume and areas, and the ``defects``. Raises
    the errors of `read`, and MeshError if the faces enclose no room.
    """
    faces = read(path, unit=unit, space=space, weld=weld)
    try:
        done = mended(faces, weld=weld, largest_hole=largest_hole)
    except MeshError as error:
        _doubt_first(error, faces)
        raise
    units.check_volume(done.volume, faces.unit or 1.0, os.fspath(path))
    return _with_doubts(done, faces)[1]


def _with_doubts(done: Mended, faces: Faces) -> tuple[str, Mended]:
    """Return the doubt about a room's size, if there is one, and the room with it among its notes."""
    is_stated = faces.unit is not None
    doubt = units.size_doubt(done.volume, done.size, faces.unit or 1.0, is_stated=is_stated)
    if doubt and done.geometry is None:
        doubt = f"by rays {doubt}"
    of_box = (
        "the file states no unit; metres (unit = 1) are assumed: the room is "
        f"{units.in_words(done.size)}"
    )
    box = "" if is_stated else of_box
    return doubt, replace(done, notes=(*filter(None, (doubt, box)), *done.notes))


def _doubt_first(error: MeshError, faces: Faces) -> None:
    """Begin the message of a refused mesh with the doubt about its size, if there is one."""
    doubt = ""
    if error.unclosed is not None:
        doubt, error.unclosed = _with_doubts(error.unclosed, faces)
    else:
        size = np.ptp(np.concatenate(list(faces.polygons)), axis=0)
        if np.isfinite(size).all() and not _ROOMS[0] < size.max() < _ROOMS[1]:
            doubt = f"as read with unit = {faces.unit or 1.0:g} it is {units.in_words(size)}"
    if doubt:
        error.args = (f"{faces.path}: {doubt}. {str(error).removeprefix(f'{faces.path}: ')}",)


def _obj(content: bytes, path: str, _unit: bool) -> _Drawn:
    points, polygons, materials, names, _ = obj.drawn(
        content, path, 1.0, Path(path).stem, budget.MAX_FACES
    )
    corners = (np.array([points[k] for k in face]) for face in polygons)
    return _Drawn(zip(materials, names, corners, strict=True))


def _off(content: bytes, path: str, _unit: bool) -> _Drawn:
    """Return the faces of an OFF file; colours, where faces have several, are the materials."""
    text = decode(content, path).characters
    rows = [(n, raw.partition("#")[0].split()) for n, _, raw in lines(text)]
    rows = [(n, words) for n, words in rows if words]
    if not rows or rows[0][1][0] != "OFF":
        raise DataError(f"{path}: cannot be read as off: its first word is not OFF")
    (n, head), *rows = [(n, w) for n, w in ((rows[0][0], rows[0][1][1:]), *rows[1:]) if w]
    n_points, n_faces = (_count(word, f"{path}, line {n}") for word in [*head, "", ""][:2])
    budget.require(n_points, budget.MAX_CORNERS, "corners", path, _SIMPLER)
    budget.require(n_faces, budget.MAX_FACES, "faces", path, _SIMPLER)
    if len(rows) < n_points + n_faces:
        raise DataError(
            f"{path}: has only {len(rows)} lines for {n_points} corners and {n_faces} faces; "
            "export it again"
        )
    corners = [[number(w, f"{path}, line {n}") for w in words[:3]] for n, words in rows[:n_points]]
    if short := [n for (n, _), corner in zip(rows, corners, strict=False) if len(corner) < 3]:
        raise DataError(f"{path}, line {short[0]}: a corner needs three numbers, x y z")
    points, faces = np.reshape(corners, (-1, 3)), list[Row]()
    for n, (size, *words) in rows[n_points : n_points + n_faces]:
        at = f"{path}, line {n}"
        count = _count(size, at)
        face = [_count(word, at) for word in [*words[:count], *[""] * (count - len(words))]]
        faces.append((" ".join(words[count:]), "", points[_known(face, n_points, at, path)]))
    several = len({colour for colour, *_ in faces}) > 1
    names = [f"colour {colour}" if several and colour else "" for colour, *_ in faces]
    return _Drawn([(name, name, face) for name, (*_, face) in zip(names, faces, strict=True)])


def _count(word: str, place: str) -> int:
    """Return a number of corners or faces, or of one of them."""
    if not word.isascii() or not word.isdigit() or len(word) > 9:
        raise DataError(f'{place}: "{shown(word)}" is not a number of corners or faces')
    return int(word)


_DXF = ("3DFACE", "POLYLINE", "VERTEX", "SEQEND", "MESH")
_KIND = re.compile(rb"^[ \t]*0[ \t]*\r?\n[ \t]*([A-Z0-9_]*[A-Z][A-Z0-9_]*)", re.MULTILINE)
"""An entity's name: the value of the group code 0."""
_INSUNITS = re.compile(rb"^\$INSUNITS[ \t]*\r?\n[ \t]*70[ \t]*\r?\n[ \t]*(\S+)", re.MULTILINE)


def _by_ezdxf(content: bytes, path: str, unit_is_stated: bool) -> _Drawn:
    """Return the faces in the model space of a DXF file, read entity by entity."""
    needed = "DXF needs ezdxf: pip install 'rtcal[mesh]'; OBJ does not"
    ezdxf = library(needed, "ezdxf", "ezdxf.addons.iterdxf", "ezdxf.render")
    if content.startswith(b"AutoCAD Binary DXF"):
        raise DataError(f"{path}: is a binary DXF; save it as text (ASCII) DXF")
    unit = None
    if found := _INSUNITS.search(content.partition(b"ENTITIES")[0]):
        place = f"{path}, line {content.count(bytes([10]), 0, found.start(1)) + 1}"
        code = number(found[1].decode("latin-1"), place)
        if code not in units.OF_DXF and not unit_is_stated:
            raise DataError(
                f"{place}: $INSUNITS = {code:g} is not a unit of DXF (0 to {max(units.OF_DXF)}); "
                "give the length of the unit in m, such as unit = 0.01"
            )
        unit = units.OF_DXF.get(int(code))
    section = content.partition(b"ENTITIES")[2].partition(b"ENDSEC")[0]
    others = Counter(k for k in map(bytes.decode, _KIND.findall(section)) if k not in _DXF)
    faces: list[Row] = []
    with _parsing(path, "DXF"):
        encoding = ezdxf.filemanagement.dxf_file_info(path).encoding
        for entity in ezdxf.addons.iterdxf.modelspace(path, types=_DXF):
            drawn = _faces_of_dxf(ezdxf, entity)
            if drawn is None:
                others[entity.dxftype()] += 1
                continue
            layer = decode(entity.dxf.layer.encode(encoding, "surrogateescape"), path).characters
            for face in drawn:
                corners = [corner.xyz for corner in face]
                faces.append((layer or "0", f"{layer or '0'} {len(faces) + 1}", corners))
            budget.require(len(faces), budget.MAX_FACES, "faces", path, _SIMPLER)
    left_out = ", ".join(f"{n} {shown(kind)}" for kind, n in others.most_common(5))
    if not faces:
        raise DataError(
            f"{path}: has no 3D face{f' (but {left_out})' if left_out else ''}; in your program, "
            "explode blocks, and convert solids and surfaces to meshes or 3D faces"
        )
    return _Drawn(
        faces, unit, notes=[f"left out, because they are not faces: {left_out}"] if left_out else []
    )


def _faces_of_dxf(ezdxf: Any, entity: Any) -> list[Sequence[Any]] | None:
    """Return the corners of each face of an entity; None for a polyline that is no mesh."""
    kind = entity.dxftype()
    if kind == "3DFACE":
        corners = (entity.dxf.get(f"vtx{k}") for k in range(4))
        return [[corner for corner in corners if corner is not None]]
    if kind == "MESH":
        return [*ezdxf.render.MeshBuilder.from_mesh(entity).faces_as_vertices()]
    if entity.is_poly_face_mesh or entity.is_polygon_mesh:
        return [face.wcs_vertices() for face in entity.virtual_entities()]
    return None


def _by_trimesh(content: bytes, path: str, _unit: bool) -> _Drawn:
    """Return the faces of a scene that trimesh reads; each triangle is a face."""
    needed = "this format needs trimesh: pip install 'rtcal[mesh]'; OBJ does not"
    trimesh = library(needed, "trimesh")
    ending, source = Path(path).suffix.lower(), io.BytesIO(content)
    if ending == ".stl":
        is_text = content[:5].lower() == b"solid" and b"facet" in content[:1000]
        n = content.count(b"facet normal") if is_text else (len(content) - 84) // 50
        budget.require(n, budget.MAX_FACES, "triangles", path, _SIMPLER)
    else:
        source = io.BytesIO(_prepared_gltf(content, path, ending))
    with _parsing(path, ending[1:]):
        resolver = trimesh.resolvers.FilePathResolver(path)
        scene = trimesh.load_scene(source, file_type=ending[1:], resolver=resolver, process=False)
        parts = [
            (str(name), scene.geometry[name], np.asarray(transform, dtype=float))
            for node in scene.graph.nodes_geometry
            for transform, name in [scene.graph[node]]
            if hasattr(scene.geometry[name], "faces")
        ]
    count = sum(len(g.faces) for _, g, _ in parts)
    budget.require(count, budget.MAX_FACES, "triangles", path, _SIMPLER)
    faces: list[Row] = []
    for name, geometry, transform in parts:
        points = np.asarray(geometry.vertices, dtype=float) @ transform[:3, :3].T + transform[:3, 3]
        own = getattr(getattr(getattr(geometry, "visual", None), "material", None), "name", None)
        for face in np.asarray(geometry.faces).tolist():
            faces.append((str(own or ""), name, points[_known(face, len(points), name, path)]))
    return _Drawn(faces, 1.0 if ending in _Y_UP else None, ending in _Y_UP)


_3MF = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def _by_3mf(content: bytes, path: str, unit_is_stated: bool) -> _Drawn:
    """Return the faces of a 3MF file; its objects, which have names, are the materials if several."""
    sizes = budget.members(content, path, "a 3MF file")
    stated, notes = "millimeter", list[str]()  # the format's default
    objects: dict[str | None, Any] = {}
    items: list[Any] = []
    with _parsing(path, "3mf"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in (name for name in sizes if name.lower().endswith(".model")):
            xml = budget.without_entities(archive.read(name), f"{path}: {name}")
            model = ElementTree.fromstring(xml)
            stated = model.get("unit", stated)
            objects |= {of.get("id", ""): of for of in model.iter(f"{_3MF}object")}
            items += model.iter(f"{_3MF}item")
            if next(model.iter(f"{_3MF}base"), None) is not None:
                notes = ["the file's materials are not read: each object becomes a material"]
    if not unit_is_stated and stated not in units.OF_3MF:
        raise DataError(
            f'{path}: unit "{shown(stated)}" is not one of 3MF ({listed([*units.OF_3MF])}); give '
            "the length of the unit in m, such as unit = 0.01"
        )

    def instance(of: Any) -> tuple[str | None, Array]:
        """The object that an item or component is of, and its matrix."""
        own = (of.get("transform") or "1 0 0 0 1 0 0 0 1 0 0 0").split()
        matrix = np.column_stack([np.reshape(own, (4, 3)).astype(float), [0, 0, 0, 1]])
        return of.get("objectid"), matrix

    @cache
    def drawn(number: str | None) -> tuple[str, Array, list[list[int]], list[tuple[Any, Array]]]:
        """An object's name, corners, faces and components."""
        of = objects[number]
        name = of.get("name") or f"object {of.get('id')}"
        corners = [[float(v.get(a)) for a in "xyz"] for v in of.iter(f"{_3MF}vertex")]
        faces = [[int(v.get(a)) for a in ("v1", "v2", "v3")] for v in of.iter(f"{_3MF}triangle")]
        for face in faces:
            _known(face, len(corners), name, path)
        components = [instance(part) for part in of.iter(f"{_3MF}component")]
        return name, np.reshape(corners, (-1, 3)), faces, components[::-1]

    def placed() -> Iterator[tuple[str | None, Array]]:
        left = [instance(item) for item in reversed(items)]
        while left:
            number, matrix = left.pop()
            yield number, matrix
            left += [(of, own @ matrix) for of, own in drawn(number)[3]]
            budget.require(len(left), budget.MAX_FACES, "parts", path, _SIMPLER)

    with _parsing(path, "3mf"):
        parts = _within_budget(placed(), lambda part: len(drawn(part[0])[2]), path)
        faces = [
            (name, corners[face] @ matrix[:3, :3] + matrix[3, :3])
            for number, matrix in parts
            for name, corners, of, _ in [drawn(number)]
            for face in of
        ]
    several = len({name for name, _ in faces}) > 1
    named = [(name if several else "", name, corners) for name, corners in faces]
    return _Drawn(named, units.OF_3MF.get(stated), notes=notes)


def _known(face: Sequence[int], n_points: int, part: str, path: str) -> list[int]:
    """Return a face's corners by their numbers; DataError for one of which the file has no point."""
    if len(face) < 3 or not 0 <= min(face) <= max(face) < n_points:
        raise DataError(
            f'{path}: part "{shown(part)}" has a face that refers to missing corners; export it '
            "again"
        )
    return [*face]


_Part = TypeVar("_Part")


def _within_budget(
    parts: Iterable[_Part], faces_of: Callable[[_Part], int], path: str
) -> list[_Part]:
    """Return the instances of parts; DataError if they, or their faces, are too many."""
    instances: list[_Part] = []
    count = 0
    for part in parts:
        count += faces_of(part)
        budget.require(max(len(instances), count), budget.MAX_FACES, "faces", path, _SIMPLER)
        instances.append(part)
    return instances


def _prepared_gltf(content: bytes, path: str, ending: str) -> bytes:
    """Return a glTF with a name for each material, and without pictures, within the budget."""
    head, rest = (content, b"")
    try:
        if ending == ".glb":
            magic, version, _, size, kind = struct.unpack("<4s4I", content[:20])
            if magic != b"glTF" or version != 2 or kind != _JSON_CHUNK:
                raise ValueError("no glTF 2.0")
            head, rest = content[20 : 20 + size], content[20 + size :]
        tree = json.loads(head)
        counts = [int(accessor["count"]) for accessor in tree.get("accessors", ())]
        children = Counter(k for node in tree.get("nodes", ()) for k in node.get("children", ()))
        coloured = [
            "".join(f"{round(255 * float(c)):02x}" for c in of.get("baseColorFactor", ())[:3])
            for material in tree.get("materials", ())
            for of in (material.get("pbrMetallicRoughness", {}),)
        ]
    except RecursionError as error:
        raise DataError(
            f"{path}: its JSON is nested too deeply for {ending[1:]}; export it again"
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError, struct.error) as error:
        raise DataError(f"{path}: cannot be read as {ending[1:]}: {error}") from error
    budget.require(sum(counts), 12 * budget.MAX_FACES, "numbers in its accessors", path, _SIMPLER)
    if shared := [k for k, n in children.items() if n > 1]:
        raise DataError(
            f"{path}: node {shared[0]} has several parents, but a glTF node may have only one; "
            "export it again"
        )
    for i, (material, colour) in enumerate(zip(tree.get("materials", ()), coloured, strict=True)):
        if not material.get("name"):
            alone = colour and coloured.count(colour) == 1
            material["name"] = f"colour #{colour}" if alone else f"material {i + 1}"
        for key in [k for k in material if "exture" in k]:
            del material[key]
        rough = material.get("pbrMetallicRoughness", {})
        for key in [k for k in rough if "exture" in k]:
            del rough[key]
    for key in ("images", "textures", "samplers"):
        tree.pop(key, None)
    made = json.dumps(tree).encode()
    if ending == ".gltf":
        return made
    made += b" " * (-len(made) % 4)
    size = 20 + len(made) + len(rest)
    return struct.pack("<4s4I", b"glTF", 2, size, len(made), _JSON_CHUNK) + made + rest


_PLY_GROUPS = {
    "layer_id": "layer",
    "material_index": "material",
    "material_indices": "material",
    "group_id": "group",
    "group": "group",
}
"""The element that a face's number is of, by the number's name."""


def _by_plyfile(content: bytes, path: str, _unit: bool) -> _Drawn:
    """Return the faces of a PLY file; its layers or groups, else its colours, are the materials."""
    plyfile = library("PLY needs plyfile: pip install 'rtcal[mesh]'", "plyfile")
    head = content[: max(content.find(b"end_header"), 0)]
    for of, n in re.findall(rb"^element (\w+) (\d{1,18})", head, re.MULTILINE):
        most = budget.MAX_CORNERS if of == b"vertex" else budget.MAX_FACES
        budget.require(int(n), most, f"elements {of.decode()}", path, _SIMPLER)
    with _parsing(path, "ply"):
        data = plyfile.PlyData.read(io.BytesIO(content))
        points = np.column_stack([data["vertex"][axis] for axis in "xyz"]).astype(float)
        face = data["face"]
        known = {p.name for p in face.properties}
        (index,) = [face[name] for name in ("vertex_indices", "vertex_index") if name in known]
        layers, colours = [""] * len(index), [""] * len(index)
        if numbered := next((name for name in _PLY_GROUPS if name in known), ""):
            kind = _PLY_GROUPS[numbered]
            rows = (row for e in data.elements if e.name == kind for row in e.data)
            texts = (next((v for v in row if np.ndim(v) == 1), ()) for row in rows)
            codes = (bytes(int(c) & 255 for c in text) for text in texts)
            names = [code.decode("utf-8", errors="replace").strip("\0 ") for code in codes]
            numbers = np.asarray(face[numbered], dtype=int).reshape(-1).tolist()
            layers = [(names[k] if 0 <= k < len(names) else "") or f"{kind} {k}" for k in numbers]
        elif {"red", "green", "blue"} <= known:
            rgb = np.column_stack([face[c] for c in ("red", "green", "blue")])
            rgb = np.round(255 * rgb) if rgb.dtype.kind == "f" else rgb
            colours = ["#" + "".join(f"{int(c):02x}" for c in row) for row in rgb.reshape(-1, 3)]
    several = len({*colours}) > 1
    faces: list[Row] = []
    for i, (face, layer, colour) in enumerate(zip(index, layers, colours, strict=True)):
        name = layer or (f"colour {colour}" if several and colour else "")
        corners = points[_known(face, len(points), name or f"face {i}", path)]
        faces.append((name, name, corners))
    return _Drawn(faces)


def _by_pycollada(content: bytes, path: str, _unit: bool) -> _Drawn:
    """Return the faces of a COLLADA file, with the unit and the axis up that it states."""
    needed = "COLLADA needs pycollada: pip install 'rtcal[mesh]'"
    collada = library(needed, "collada", "collada.common", "collada.lineset")
    with _parsing(path, "COLLADA"):
        ignored = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
        source = io.BytesIO(budget.without_entities(content, path))
        model = collada.Collada(source, ignore=ignored)
        lines_only = collada.lineset.LineSet, collada.lineset.BoundLineSet

        def n_faces(placed: tuple[str, Any]) -> int:
            geometry = placed[1]
            drawn = () if geometry is None else geometry.original.primitives
            return sum(len(part) for part in drawn if not isinstance(part, lines_only))

        nodes = model.scene.nodes if model.scene else ()
        placed = _within_budget(
            (part for node in nodes for part in _placed(node, np.eye(4), "")), n_faces, path
        )
        faces = [
            (_name(part), name or geometry.original.name, polygon)
            for name, geometry in placed
            if geometry is not None
            for part in geometry.primitives()
            if not isinstance(part, lines_only)
            for polygon in _polygons(part)
        ]
        stated, up = model.assetInfo.unitmeter, model.assetInfo.upaxis
    return _Drawn(faces, None if stated is None else float(stated), up == "Y_UP")


def _placed(node: Any, matrix: Array, name: str) -> Iterator[tuple[str, Any]]:
    """Yield each geometry below a node, placed, with the nearest node's name; None of a node."""
    children = getattr(node, "children", None)
    if children is None:  # an instance of a geometry, a camera, a light
        yield from ((name, geometry) for geometry in node.objects("geometry", matrix))
        return
    named = getattr(node, "node", node)  # of an instance of a node, that node
    own = named.name if named.name != named.id else None  # pycollada takes the id without a name
    yield name, None
    for child in children:
        yield from _placed(child, matrix @ node.matrix, own or name)


def _polygons(part: Any) -> Iterator[Array]:
    """Yield the corners (n, 3) of each polygon of a primitive."""
    if not len(part):
        return
    corners = part.vertex[part.vertex_index]
    if corners.ndim == 3:  # triangles
        yield from corners
    else:
        yield from (corners[start:end] for start, end in part.polyindex)


def _name(part: Any) -> str:
    """Return the name of a primitive's material: as bound in the scene, else its symbol."""
    bound = getattr(part, "material", None)
    name = getattr(bound, "name", None) or getattr(bound, "id", None)
    return str(name or getattr(part.original, "material", None) or "")


READERS: dict[str, Callable[[bytes, str, bool], _Drawn]] = {
    ".obj": _obj,
    ".dxf": _by_ezdxf,
    ".dae": _by_pycollada,
    ".ply": _by_plyfile,
    ".3mf": _by_3mf,
    ".off": _off,
    **dict.fromkeys((".stl", ".glb", ".gltf"), _by_trimesh),
}
"""Function that reads each file ending, from a file's content and name, and whether the unit is
given."""
