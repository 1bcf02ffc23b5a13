"""COLLADA (.dae), which SketchUp writes: polygons with the names of their materials, by pycollada.

trimesh reads COLLADA, too, but not the materials' names. The unit and the axis that is up are those
that the file states.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from rtcal.acoustics.materials import text_name
from rtcal.io.mend import Faces
from rtcal.io.mend.faces import unit_notes
from rtcal.support.errors import DataError
from rtcal.support.lazy import library
from rtcal.support.types import Array

MAX_FACES = 100_000


def faces(content: bytes, path: str, unit: float | None, otherwise: str) -> Faces:
    """Return the faces of a COLLADA file; those without a material are of ``otherwise``."""
    needed = "COLLADA needs pycollada: pip install 'rtcal[mesh]'"
    collada = library(needed, "collada", "collada.common", "collada.lineset")
    try:
        model = collada.Collada(
            io.BytesIO(content),
            ignore=[collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError],
        )
        drawn = [
            (name or geometry.original.name, _name(part, otherwise), polygon.vertices)
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
    if len(drawn) > MAX_FACES:
        raise DataError(f"{path}: {len(drawn)} faces; at most {MAX_FACES}: simplify the model")
    length = unit if unit is not None else float(stated or 1.0)
    notes = unit_notes(length, None if stated is None else float(stated), unit)
    turned = up == "Y_UP"
    if turned:
        notes.append("y is up in the file: its z is here -y")
    polygons, materials, names = [], [], []
    for name, material, corners in drawn:
        points = np.array(corners, dtype=float) * length
        if turned:
            points = points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
        polygons.append(points)
        materials.append(text_name(f"{path}: a material", material))
        names.append(text_name(f"{path}: a part", name) or "part")
    return Faces(path, polygons, materials, names, tuple(notes))


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
