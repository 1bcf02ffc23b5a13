"""Meshes of every format as `rtcal.io.mend.Faces`: what is drawn, with the names of its materials.

A format is one reader: those of `obj` and `cad`; COLLADA (.dae), which SketchUp writes, by pycollada,
and the others by trimesh (both ``rtcal[mesh]``). trimesh reads COLLADA, too, but not the materials'
names. A mesh without materials, such as STL, has one, named after its file. Objects of 3MF, which have
names and no materials, are materials.

The axes are turned so that z is up where the format says that y is (glTF, COLLADA).
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from rtcal.files.disk import read_bytes
from rtcal.io import budget, cad, obj, units
from rtcal.io.mend import OFFSET, WELD, Faces, Mended, MeshError, closed, mended
from rtcal.io.mend.solids import room_between
from rtcal.io.text import decode, lines, number, shown
from rtcal.support import checks, library
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import listed
from rtcal.support.types import Array

__all__ = ["read", "room"]
__dir__ = __all__.copy

MAX_BYTES = 2**26
BY_TRIMESH = (".stl", ".glb", ".gltf", ".3mf")
IFC = ".ifc"
_Y_UP = (".glb", ".gltf")
_TURNED = "y is up in the file: its z is here -y"
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
_ROOMS = 1.5, 1000.0
"""Least and largest length in m of the longest side of the box around a room."""


def read(
    path: str | os.PathLike[str],
    *,
    unit: float | None = None,
    space: str | None = None,
    weld: float = WELD,
) -> Faces:
    """Return the faces of a mesh.

    Parameters
    ----------
    path : path
    unit : float, optional
        Length of the file's unit in m; by default what the file states, else 1.
    space : str, optional
        Name of the space of a building model (IFC) that has several.
    weld : float
        Largest gap in m between the ends of an outline in a building model that is closed.

    Raises
    ------
    DataError
        For a format that is not read, with the way to one that is, and for a broken file.
    MissingDependencyError
        Without trimesh or ifcopenshell, for a format that it reads.
    """
    if unit is not None:
        unit = checks.positive("unit", unit, "m")
    ending = checks.path("path", path).suffix.lower()
    if ending == IFC:
        return cad.ifc_faces(os.fspath(path), unit, space, weld)
    if space is not None:
        raise DataError(f"{path}: only a building model (IFC) has spaces: leave --space out")
    if ending in _REFUSED:
        raise DataError(f"{path}: {_REFUSED[ending]}")
    if ending not in READERS:
        raise DataError(
            f'{path}: "{ending}" is no format of a mesh; read are {", ".join((*READERS, IFC))}'
        )
    content = read_bytes(path, MAX_BYTES)
    return READERS[ending](content, os.fspath(path), unit)


def room(
    path: str | os.PathLike[str],
    *,
    unit: float | None = None,
    space: str | None = None,
    weld: float = WELD,
    offset: float = OFFSET,
    largest_hole: float | None = None,
) -> Mended:
    """Return the closed room of a mesh, with every defect that was mended; see `read` and `mended`.

    A mesh whose faces close as they are drawn is taken as it is.
    """
    faces = read(path, unit=unit, space=space, weld=weld)
    try:
        done = closed(faces, weld=weld, offset=offset)
        if done is None:
            between = room_between(faces, weld)
            faces, solids = (faces, ()) if between is None else between
            done = mended(faces, weld=weld, offset=offset, largest_hole=largest_hole)
            done = replace(done, defects=(*solids, *done.defects))
    except MeshError as error:
        _doubt_first(error, faces, os.fspath(path))
        raise
    taken = 1.0 if faces.unit is None else faces.unit
    units.check_volume(done.volume, taken, os.fspath(path))
    doubt = units.size_doubt(done.volume, done.size, taken, is_stated=faces.unit is not None)
    box = "" if faces.unit is not None else units.box_note(done.size)
    return replace(done, notes=(*filter(None, (doubt, box)), *done.notes))


def _doubt_first(error: MeshError, faces: Faces, path: str) -> None:
    """Begin the message of a refused mesh with the doubt about its size, if there is one."""
    taken = 1.0 if faces.unit is None else faces.unit
    unclosed = error.unclosed
    doubt = ""
    if unclosed is None:
        size = np.ptp(np.concatenate(list(faces.polygons)), axis=0)
        if np.isfinite(size).all() and not _ROOMS[0] < size.max() < _ROOMS[1]:
            doubt = f"as read with unit = {taken:g} it is {units.in_words(size)}"
    else:
        notes = unclosed.notes
        if faces.unit is None:
            notes = (units.box_note(unclosed.size), *notes)
        said = units.size_doubt(
            unclosed.volume, unclosed.size, taken, is_stated=faces.unit is not None
        )
        if said:
            doubt = f"by rays {said}"
            notes = (doubt, *notes)
        error.unclosed = replace(unclosed, notes=notes)
    if doubt:
        error.args = (f"{path}: {doubt}. {str(error).removeprefix(f'{path}: ')}",)


def _obj(content: bytes, path: str, unit: float | None) -> Faces:
    return obj.faces(content, path, unit, Path(path).stem)


def _by_trimesh(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a scene that trimesh reads; each triangle is a face."""
    needed = "this format needs trimesh: pip install 'rtcal[mesh]'; OBJ does not"
    trimesh = library(needed, "trimesh")
    ending = Path(path).suffix.lower()
    source: Any = path
    notes: list[str] = []
    stated = "meter"  # glTF's
    if ending == ".3mf":
        stated, notes = _head_of_3mf(content, path)
    elif ending == ".stl":
        _require_triangles(content, path)
    if ending in _Y_UP:
        source = io.BytesIO(_prepared_gltf(content, path, ending))
    try:
        resolver = trimesh.resolvers.FilePathResolver(path)
        scene = trimesh.load_scene(source, file_type=ending[1:], resolver=resolver, process=False)
        parts = [
            (name, geometry, np.asarray(transform, dtype=float))
            for node in scene.graph.nodes_geometry
            for transform, name in [scene.graph[node]]
            for geometry in [scene.geometry[name]]
            if hasattr(geometry, "faces")
        ]
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: trimesh reads this with another library ({error}): pip install 'rtcal[mesh]'"
        ) from error
    except Exception as error:  # trimesh raises what its parsers raise
        raise DataError(
            f"{path}: cannot be read as {ending[1:]}: {error}. Export OBJ from your program, one "
            "material per layer"
        ) from error
    count = sum(len(g.faces) for _, g, _ in parts)
    budget.require(count, budget.MAX_FACES, "triangles", path, _SIMPLER)
    turned = ending in _Y_UP
    in_file = None
    if ending != ".stl":
        if unit is None and stated not in units.OF_3MF:
            raise DataError(
                f'{path}: unit "{shown(stated)}" is none of 3MF\'s, which are '
                f"{listed([*units.OF_3MF])}; state its length in m, such as unit = 0.01"
            )
        in_file = units.OF_3MF.get(stated)
    length = next((u for u in (unit, in_file) if u is not None), 1.0)
    notes += units.notes(length, in_file, unit)
    notes += [_TURNED] * turned
    polygons: list[Array] = []
    materials: list[str] = []
    names: list[str] = []
    for name, geometry, transform in parts:
        points = np.asarray(geometry.vertices, dtype=float) @ transform[:3, :3].T + transform[:3, 3]
        points = points * length
        points = _z_up(points) if turned else points
        index = np.asarray(geometry.faces)
        if index.size and not 0 <= index.min() <= index.max() < len(points):
            raise DataError(f'{path}: part "{shown(str(name))}" has a face without its corners')
        # An object of 3MF has a name and no material: its author tells surfaces apart by it.
        by_object = ending == ".3mf" and len(parts) > 1
        material = _material(geometry) or (str(name) if by_object else Path(path).stem)
        polygons += list(points[index])
        materials += [text_name(f"{path}: a material", material)] * len(index)
        names += [text_name(f"{path}: a part", str(name)) or "part"] * len(index)
    if not polygons:
        raise DataError(f"{path}: there is no face; a room has at least 4")
    known = None if unit is None and in_file is None else length
    return Faces(path, polygons, materials, names, tuple(notes), known)


def _z_up(points: Array) -> Array:
    """Return points (n, 3) of a file in which y is up."""
    return np.asarray(points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


def _material(geometry: Any) -> str:
    """Return the name of a part's material; "" without one."""
    visual = getattr(geometry, "visual", None)
    return str(getattr(getattr(visual, "material", None), "name", None) or "")


def _require_triangles(content: bytes, path: str) -> None:
    """Raise DataError if an STL file has more triangles than the budget."""
    is_text = content[:5].lower() == b"solid" and b"facet" in content[:1000]
    n = content.count(b"facet normal") if is_text else (len(content) - 84) // 50
    budget.require(n, budget.MAX_FACES, "triangles", path, _SIMPLER)


def _head_of_3mf(content: bytes, path: str) -> tuple[str, list[str]]:
    """Return the unit of a 3MF file and what is not read of it; DataError beyond the budget."""
    sizes = budget.members(content, path, "a 3MF file")
    unit, notes = "millimeter", []  # the format's default
    faces: dict[str, int] = {}
    parts: dict[str, list[str]] = {}
    items: list[str] = []
    current = ""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in (n for n in sizes if n.lower().endswith(".model")):
            try:
                for event, element in ElementTree.iterparse(archive.open(name), ("start", "end")):
                    tag = element.tag.rpartition("}")[2]
                    if event == "end":
                        element.clear()
                    elif tag == "model":
                        unit = element.get("unit", unit)
                    elif tag == "object":
                        current = element.get("id", "")
                        faces[current], parts[current] = 0, []
                    elif tag == "triangle" and current:
                        faces[current] += 1
                    elif tag == "component" and current:
                        parts[current].append(element.get("objectid", ""))
                    elif tag == "item":
                        items.append(element.get("objectid", ""))
                    elif tag == "base":
                        notes = ["the file's materials are not read: its objects are the materials"]
            except (
                ElementTree.ParseError,
                zipfile.BadZipFile,
                zlib.error,
                NotImplementedError,
                EOFError,
                OSError,
                ValueError,
            ) as error:
                raise DataError(f"{path}: cannot be read as 3mf: {error}") from error
    total = budget.instances(faces, parts, items, path)
    budget.require(total, budget.MAX_FACES, "triangles", path, _SIMPLER)
    return unit, notes


def _off(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of an OFF file; colours, where faces have several, are the materials."""
    rows = [
        (n, words)
        for n, _, raw in lines(decode(content, path).characters)
        if (words := raw.split("#", 1)[0].split())
    ]
    if not rows or rows[0][1][0] != "OFF":
        raise DataError(f"{path}: cannot be read as off: its first word is not OFF")
    head = rows[0][1][1:]
    rows = rows[1:]
    if not head and rows:
        (_, head), *rows = rows
    try:
        n_points, n_faces = int(head[0]), int(head[1])
    except (IndexError, ValueError) as error:
        raise DataError(f"{path}: OFF has no number of corners and faces after it") from error
    budget.require(n_points, budget.MAX_CORNERS, "corners", path, _SIMPLER)
    budget.require(n_faces, budget.MAX_FACES, "faces", path, _SIMPLER)
    if len(rows) < n_points + n_faces:
        raise DataError(f"{path}: {len(rows)} lines for {n_points} corners and {n_faces} faces")
    length = 1.0 if unit is None else unit
    points = np.zeros((n_points, 3))
    for i, (n, words) in enumerate(rows[:n_points]):
        if len(words) < 3:
            raise DataError(
                f"{path}, line {n}: a corner has {len(words)} numbers; x y z are needed"
            )
        points[i] = [length * number(word, f"{path}, line {n}") for word in words[:3]]
    polygons, colours = [], []
    for n, words in rows[n_points : n_points + n_faces]:
        try:
            size, *index = (int(word) for word in words[: 1 + int(words[0])])
            if size < 3 or len(index) != size or not 0 <= min(index) <= max(index) < n_points:
                raise ValueError
        except ValueError as error:
            raise DataError(f"{path}, line {n}: a face without its corners") from error
        polygons.append(points[index])
        colours.append(" ".join(words[1 + size :]))
    if not polygons:
        raise DataError(f"{path}: there is no face; a room has at least 4")
    several = len(set(colours)) > 1
    stem = Path(path).stem
    materials = [f"colour {shown(c)}" if several and c else stem for c in colours]
    return Faces(path, polygons, materials, materials, tuple(units.notes(length, None, unit)), unit)


def _prepared_gltf(content: bytes, path: str, ending: str) -> bytes:
    """Return a glTF with a name for each material, and without pictures, within the budget.

    A material without a name has its colour's, where no other has that colour, else its number's.
    """
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
        coloured = [_gltf_colour(material) for material in tree.get("materials", ())]
    except (ValueError, TypeError, KeyError, AttributeError, struct.error, RecursionError) as error:
        raise DataError(f"{path}: cannot be read as {ending[1:]}: {error}") from error
    budget.require(sum(counts), 12 * budget.MAX_FACES, "numbers in its accessors", path, _SIMPLER)
    if shared := [k for k, n in children.items() if n > 1]:
        raise DataError(f"{path}: node {shared[0]} has several parents; a node of glTF has one")
    for i, (material, colour) in enumerate(zip(tree.get("materials", ()), coloured, strict=True)):
        if not material.get("name"):
            alone = colour and coloured.count(colour) == 1
            material["name"] = f"colour {colour}" if alone else f"material {i + 1}"
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


def _gltf_colour(material: Any) -> str:
    """Return the colour of a glTF material as #rrggbb; "" without one."""
    colour = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", ())
    return "#" + "".join(f"{round(255 * float(c)):02x}" for c in colour[:3]) if colour else ""


def _by_plyfile(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a PLY file; its layers (I-Simpa's), else its colours, are the materials."""
    plyfile = library("PLY needs plyfile: pip install 'rtcal[mesh]'", "plyfile")
    head = content[: max(content.find(b"end_header"), 0)]
    for of, n in re.findall(rb"^element (\w+) (\d{1,18})", head, re.MULTILINE):
        most = budget.MAX_CORNERS if of == b"vertex" else budget.MAX_FACES
        budget.require(int(n), most, f"elements {of.decode()}", path, _SIMPLER)
    try:
        data = plyfile.PlyData.read(io.BytesIO(content))
        points = np.column_stack([data["vertex"][axis] for axis in "xyz"]).astype(float)
        face = data["face"]
        (index,) = [face[p.name] for p in face.properties if p.name in _CORNERS_OF_PLY]
        materials = _ply_materials(data, face, Path(path).stem)
    except Exception as error:  # plyfile raises what its parser raises
        raise DataError(
            f"{path}: cannot be read as ply: {error}. Export OBJ from your program, one material per "
            "layer"
        ) from error
    length = 1.0 if unit is None else unit
    polygons = []
    for i, corners in enumerate(index):
        if len(corners) < 3 or not 0 <= min(corners) <= max(corners) < len(points):
            raise DataError(f"{path}: face {i} is without its corners")
        polygons.append(points[corners] * length)
    if not polygons:
        raise DataError(f"{path}: there is no face; a room has at least 4")
    materials = [text_name(f"{path}: a material", m) or "part" for m in materials]
    return Faces(path, polygons, materials, materials, tuple(units.notes(length, None, unit)), unit)


_CORNERS_OF_PLY = ("vertex_indices", "vertex_index")


def _ply_materials(data: Any, face: Any, otherwise: str) -> list[str]:
    """Return the material of each face of a PLY file."""
    known = {p.name for p in face.properties}
    n = len(face.data)
    if "layer_id" in known:
        names = [_ply_text(row) for e in data.elements if e.name == "layer" for row in e.data]
        numbers = np.asarray(face["layer_id"], dtype=int).reshape(-1)
        return [names[k] if 0 <= k < len(names) else f"layer {k}" for k in numbers.tolist()]
    if {"red", "green", "blue"} <= known:
        colours = np.column_stack([face[c] for c in ("red", "green", "blue")])
        if colours.dtype.kind == "f":
            colours = np.round(255 * colours)
        found = ["#" + "".join(f"{int(c):02x}" for c in row) for row in colours.reshape(n, 3)]
        if len(set(found)) > 1:
            return [f"colour {c}" for c in found]
    return [otherwise] * n


def _ply_text(row: Any) -> str:
    """Return the text in the first list of an element of a PLY file."""
    values = next((v for v in row if np.ndim(v) == 1), ())
    return bytes(int(c) & 255 for c in values).decode("utf-8", errors="replace").strip("\0 ")


def _by_pycollada(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a COLLADA file, in the unit and with the axis up that it states."""
    needed = "COLLADA needs pycollada: pip install 'rtcal[mesh]'"
    collada = library(needed, "collada", "collada.common", "collada.lineset")
    _require_instances(content, path)
    try:
        model = collada.Collada(
            io.BytesIO(content),
            ignore=[collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError],
        )
        drawn = [
            (name or geometry.original.name, _name(part, Path(path).stem), polygon.vertices)
            for node in (model.scene.nodes if model.scene else ())
            for name, geometry in _placed(node, np.eye(4), "")
            for part in geometry.primitives()
            if not isinstance(part, collada.lineset.BoundLineSet)
            for polygon in part
        ]
        stated, up = model.assetInfo.unitmeter, model.assetInfo.upaxis
    except Exception as error:  # pycollada raises what its parser raises
        raise DataError(f"{path}: cannot be read as COLLADA: {error}") from error
    if not drawn:
        raise DataError(f"{path}: there is no face; a room has at least 4")
    length = unit if unit is not None else float(stated or 1.0)
    in_file = None if stated is None else float(stated)
    notes = units.notes(length, in_file, unit)
    turned = up == "Y_UP"
    notes += [_TURNED] * turned
    polygons, materials, names = [], [], []
    for name, material, corners in drawn:
        points = np.array(corners, dtype=float) * length
        polygons.append(_z_up(points) if turned else points)
        materials.append(text_name(f"{path}: a material", material))
        names.append(text_name(f"{path}: a part", name) or "part")
    known = None if unit is None and stated is None else length
    return Faces(path, polygons, materials, names, tuple(notes), known)


def _require_instances(content: bytes, path: str) -> None:
    """Raise DataError if the instances of a COLLADA file have more faces than the budget."""
    faces: dict[str, int] = {}
    parts: dict[str, list[str]] = {}
    within: list[str] = []  # the ids of the nodes, geometries and scenes around an element
    scenes: list[str] = []
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(content), ("start", "end")):
            tag = element.tag.rpartition("}")[2]
            own = tag in ("node", "geometry", "visual_scene")
            if event == "end":
                within = within[:-1] if own else within
                element.clear()
                continue
            if own:
                name = element.get("id") or f"{tag} {len(faces)}"
                faces.setdefault(name, 0)
                parts.setdefault(name, [])
                if within:
                    parts[within[-1]].append(name)
                if tag == "visual_scene":
                    scenes.append(name)
                within = [*within, name]
            elif within and tag in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
                faces[within[-1]] += int(element.get("count") or 0)
            elif within and tag in ("instance_node", "instance_geometry", "instance_controller"):
                parts[within[-1]].append((element.get("url") or "").removeprefix("#"))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise DataError(f"{path}: cannot be read as COLLADA: {error}") from error
    total = budget.instances(faces, parts, scenes, path)
    budget.require(total, budget.MAX_FACES, "faces", path, _SIMPLER)


def _placed(node: Any, matrix: Array, name: str) -> Iterator[tuple[str, Any]]:
    """Yield each geometry below a node, in its place, with the name of the nearest node that has one.

    Programs name the objects of a scene by their nodes, and a geometry by its number.
    """
    children = getattr(node, "children", None)
    if children is None:  # an instance of a geometry, a camera, a light
        yield from ((name, geometry) for geometry in node.objects("geometry", matrix))
        return
    named = getattr(node, "node", node)  # of an instance of a node, that node
    own = named.name if named.name != named.id else None  # pycollada takes the id without a name
    for child in children:
        yield from _placed(child, matrix @ node.matrix, own or name)


def _name(part: Any, otherwise: str) -> str:
    """Return the name of a primitive's material: as bound in the scene, else its symbol."""
    bound = getattr(part, "material", None)
    name = getattr(bound, "name", None) or getattr(bound, "id", None)
    return str(name or getattr(part.original, "material", None) or otherwise)


READERS: dict[str, Callable[[bytes, str, float | None], Faces]] = {
    ".obj": _obj,
    ".dxf": cad.dxf_faces,
    ".dae": _by_pycollada,
    ".ply": _by_plyfile,
    ".off": _off,
    **dict.fromkeys(BY_TRIMESH, _by_trimesh),
}
"""The reader of each ending."""
