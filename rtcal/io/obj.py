"""Rooms from a mesh: Wavefront OBJ with material names.

The keywords that are read:

- ``v``: a corner x y z, in ``unit``;
- ``f``: a face by the numbers of its corners; negative numbers count back;
- ``usemtl``: the material of the faces that follow;
- ``o`` and ``g``: the name of the faces that follow, in place of their material's; "wall", "wall 2"
  and so on.

A comment may state the unit ("# File units = inches"). Lines continued by a backslash are allowed.
Texture, normals, curves, material libraries and smoothing are ignored. The result is a polyhedron for
the tracers: closed, with plane faces.

Source: Wavefront Technologies, Advanced Visualizer Manual, Appendix B1, "Object Files (.obj)".
"""

from __future__ import annotations

import os
import re
from collections import Counter

from rtcal.files.disk import read_bytes
from rtcal.io.text import MAX_TEXT, decode, lines, number, shown
from rtcal.io.units import check_volume, in_comments
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError

__all__ = ["read"]
__dir__ = __all__.copy

MAX_FACES = 1500
"""Largest number of faces of a room; rooms for geometrical acoustics have tens to hundreds."""

_IGNORED = frozenset(
    re.findall(
        r"\w+",
        "vt vn vp mtllib s p l cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con mg "
        "bevel c_interp d_interp lod shadow_obj trace_obj ctech stech maplib usemap",
    )
)
"""Texture, normals, curves, material libraries and smoothing."""
_NAMING = re.compile(r"\s*(?:usemtl|o|g)\s")
_BEHIND_NAME = re.compile(r"\s#(?:\s|$)")
_BEHIND_NUMBERS = re.compile("#")


def read(
    path: str | os.PathLike[str], *, unit: float | None = None, leaks: bool = False
) -> Polyhedron:
    """Return the geometry of a room in an OBJ file, whose walls must be closed.

    ``path`` is that of the file. ``unit`` is the length of the file's unit in m: 0.001 for a model in
    mm; by default it is what a comment states, or else 1. If ``leaks`` is True, the walls may have
    small holes, and the volume lacks what they cut off.
    Raises DataError, which names the file, the line and the rule, or the edge at which the walls do not
    close.
    """
    return parse(read_bytes(path, MAX_TEXT), os.fspath(path), unit=unit, leaks=leaks)


def parse(
    content: bytes, path: str = "OBJ file", *, unit: float | None = None, leaks: bool = False
) -> Polyhedron:
    """Return the geometry of a room from the content of an OBJ file; see `read`.

    ``content`` is the text as bytes, and ``path`` its name in messages. ``unit`` and ``leaks`` (by
    default False) are those of `read`.
    """
    if unit is None:
        unit = in_comments(content, path) or 1.0
    unit = checks.positive("unit", unit, "m")
    vertices, polygons, materials, names, line = drawn(content, path, unit, "", MAX_FACES)
    if not polygons:
        raise DataError(f"{path}, line {line}: the mesh has no face; a room needs at least 4")
    try:
        room = Polyhedron(
            vertices=vertices,  # type: ignore[arg-type]
            faces=polygons,
            materials=materials,
            names=names,
            leaks=leaks,
        )
    except DataError as error:
        raise DataError(
            f"{path}: {error}; `rtcal import check {path}` lists all defects and repairs those it can"
        ) from error
    check_volume(room.volume, unit, path)
    return room


def drawn(
    content: bytes, path: str, unit: float, otherwise: str, most: int
) -> tuple[list[tuple[float, ...]], list[list[int]], list[str], list[str], int]:
    """Return corners in m, faces, their materials and names, and the number of the last line."""
    vertices: list[tuple[float, ...]] = []
    faces: list[list[int]] = []
    materials: list[str] = []
    names: list[str] = []
    members: Counter[str] = Counter()
    material, group = otherwise, ""
    line, continued = 1, ""
    for line, _, raw in lines(decode(content, path).characters):
        place = f"{path}, line {line}"
        if raw.endswith("\\"):
            continued += raw[:-1] + " "
            continue
        statement, continued = continued + raw, ""
        # A name may have a #, as colours of materials do; before a space it begins a comment.
        comment = _BEHIND_NAME if _NAMING.match(statement) else _BEHIND_NUMBERS
        words = comment.split(statement, 1)[0].split(None, 1) or [""]
        keyword, arguments = words[0], words[1].strip() if len(words) > 1 else ""
        if keyword == "v":
            if len(vertices) >= 4 * most:
                raise DataError(f"{place}: has more than {4 * most} vertices; simplify the model")
            tokens = arguments.split()
            if not 3 <= len(tokens) <= 7:
                raise DataError(f"{place}: v has {len(tokens)} numbers; it must have x y z")
            vertices.append(tuple(unit * number(t, place) for t in tokens[:3]))
        elif keyword == "f":
            if len(faces) >= most:
                raise DataError(f"{place}: has more than {most} faces; simplify the model")
            if not material:
                raise DataError(
                    f"{place}: this face has no material; write usemtl MATERIAL before it"
                )
            faces.append([_corner(t, len(vertices), place) for t in arguments.split()])
            if not 3 <= len(faces[-1]) <= 100:
                raise DataError(
                    f"{place}: this face has {len(faces[-1])} corners; it must have 3 to 100"
                )
            materials.append(material)
            name = group or material
            members[name] += 1
            names.append(name if members[name] == 1 else f"{name} {members[name]}")
        elif keyword == "usemtl":
            material = text_name(f"{place}: usemtl", arguments)
            if not material:
                raise DataError(f"{place}: usemtl needs the name of a material")
        elif keyword in ("o", "g"):
            group = text_name(f"{place}: {keyword}", arguments)
        elif keyword and keyword not in _IGNORED:
            raise DataError(f'{place}: "{shown(keyword)}" is not a keyword of an OBJ file')
    return vertices, faces, materials, names, line


def _corner(token: str, n_vertices: int, place: str) -> int:
    match = re.fullmatch(r"(-?\d{1,9})(?:/-?\d{0,9}){0,2}", token, re.ASCII)
    if match is None:
        raise DataError(
            f'{place}: "{shown(token)}" is not a corner; write vertex or vertex/texture/normal'
        )
    index = int(match.group(1))
    index = index - 1 if index > 0 else n_vertices + index
    if not 0 <= index < n_vertices or match.group(1) in ("0", "-0"):
        raise DataError(
            f"{place}: the corner {match.group(1)} refers to a vertex that is not defined; "
            f"{n_vertices} are defined before this line"
        )
    return index
