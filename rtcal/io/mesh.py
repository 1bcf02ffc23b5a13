"""Meshes of every format as `rtcal.io.mend.Faces`: what is drawn, with the names of its materials.

A format is one reader: those of `obj` and `cad`; COLLADA (.dae), which SketchUp writes, by pycollada,
and the others by trimesh (both ``rtcal[mesh]``). trimesh reads COLLADA, too, but not the materials'
names. A mesh without materials, such as STL, has one, named after its file. Objects of 3MF, which have
names and no materials, are materials.

The axes are turned so that z is up where the format says that y is (glTF, COLLADA).
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.materials import text_name
from rtcal.io import cad, obj, units
from rtcal.io.mend import OFFSET, WELD, Faces, Mended, MeshError, closed, mended
from rtcal.io.mend.solids import room_between
from rtcal.io.text import shown
from rtcal.support import library
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.files import read_bytes
from rtcal.support.text import listed
from rtcal.support.types import Array

__all__ = ["read", "room"]
__dir__ = __all__.copy

MAX_BYTES = 2**26
BY_TRIMESH = (".ply", ".stl", ".glb", ".gltf", ".3mf", ".off")
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
_ROOMS = 1.5, 1000.0
"""Least and largest length in m of the longest side of the box around a room."""
_LAYERS = re.compile(rb"element layer|property \w+ layer_id")
"""What a PLY of I-Simpa has in its header. trimesh leaves it out."""


@checked
def read(
    path: str | os.PathLike[str], *, unit: float | None = None, space: str | None = None
) -> Faces:
    """Return the faces of a mesh.

    Parameters
    ----------
    path : path
    unit : float, optional
        Length of the file's unit in m; by default what the file states, else 1.
    space : str, optional
        Name of the space of a building model (IFC) that has several.

    Raises
    ------
    DataError
        For a format that is not read, with the way to one that is, and for a broken file.
    MissingDependencyError
        Without trimesh or ifcopenshell, for a format that it reads.
    """
    if unit is not None and not 0 < unit < float("inf"):
        raise DataError(f"unit = {unit:g} m is not finite and above 0")
    ending = Path(path).suffix.lower()
    if ending == IFC:
        return cad.ifc_faces(os.fspath(path), unit, space)
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


@checked
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
    faces = read(path, unit=unit, space=space)
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
    needed = "this format needs trimesh: pip install 'rtcal[mesh]'; OBJ and DXF do not"
    trimesh = library(needed, "trimesh")
    ending = Path(path).suffix.lower()
    try:
        scene = trimesh.load_scene(path, process=False)
        stated = getattr(scene, "units", None)
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
    if (count := sum(len(g.faces) for _, g, _ in parts)) > obj.MOST_DRAWN:
        raise DataError(f"{path}: {count} triangles; at most {obj.MOST_DRAWN}: simplify the model")
    notes = []
    if ending == ".ply" and _LAYERS.search(content[: content.find(b"end_header")]):
        notes.append(
            "the file's layers are not read, so all faces have one material; export OBJ, one material "
            "per layer"
        )
    turned = ending in _Y_UP
    in_file = 1.0 if turned else None  # glTF is in metres
    if ending == ".3mf":
        if unit is None and stated not in units.OF_3MF:
            raise DataError(
                f'{path}: unit "{shown(str(stated))}" is none of 3MF\'s, which are '
                f"{listed([*units.OF_3MF])}; state its length in m, such as unit = 0.01"
            )
        in_file = units.OF_3MF.get(str(stated))
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
        of_face = _materials(geometry, str(name) if by_object else Path(path).stem)
        part = text_name(f"{path}: a part", str(name)) or "part"
        for corners, material in zip(points[index], of_face, strict=True):
            polygons.append(corners)
            materials.append(text_name(f"{path}: a material", material))
            names.append(part)
    if not polygons:
        raise DataError(f"{path}: there is no face; a room has at least 4")
    known = None if unit is None and in_file is None else length
    return Faces(path, polygons, materials, names, tuple(notes), known)


def _z_up(points: Array) -> Array:
    """Return points (n, 3) of a file in which y is up."""
    return np.asarray(points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


def _materials(geometry: Any, otherwise: str) -> list[str]:
    """Return the material of each face: its name, else its colour where there are several."""
    n = len(geometry.faces)
    visual: Any = getattr(geometry, "visual", None)
    material = getattr(visual, "material", None)
    several = getattr(material, "materials", None)
    if several is not None and getattr(visual, "face_materials", None) is not None:
        return [str(several[k].name or otherwise) for k in visual.face_materials]
    if material is not None:
        name = getattr(material, "name", None)
        return [str(name) if name else otherwise] * n
    if getattr(visual, "kind", None) == "face":
        colours = ["#" + "".join(f"{c:02x}" for c in row[:3]) for row in visual.face_colors]
        if len(set(colours)) > 1:
            return [f"colour {c}" for c in colours]
    return [otherwise] * n


def _by_pycollada(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a COLLADA file, in the unit and with the axis up that it states."""
    needed = "COLLADA needs pycollada: pip install 'rtcal[mesh]'"
    collada = library(needed, "collada", "collada.common", "collada.lineset")
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
    if len(drawn) > obj.MOST_DRAWN:
        raise DataError(f"{path}: {len(drawn)} faces; at most {obj.MOST_DRAWN}: simplify the model")
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
    **dict.fromkeys(BY_TRIMESH, _by_trimesh),
}
"""The reader of each ending."""
