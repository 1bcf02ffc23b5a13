"""Rooms from a mesh: Wavefront OBJ with material names.

Read are ``v`` (x y z, in ``unit``), ``f`` (corners, negative ones count back), ``usemtl`` (the
material of the faces that follow), ``o`` and ``g`` (their name), comments and lines continued
by a backslash. Texture, normals, curves, material libraries and smoothing mean nothing here and are
passed over. The result is the polyhedron that the tracers take: closed, of plane faces.

Source: Wavefront Technologies, Advanced Visualizer Manual, Appendix B1, "Object Files (.obj)".
"""

from __future__ import annotations

import os
import re

from rtcal.acoustics.materials import text_name
from rtcal.errors import DataError
from rtcal.io.source import MAX_TEXT, as_text, number, readable, shown
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.files import read_bytes, write_text

MAX_FACES = 1500
"""A room for geometrical acoustics has tens to hundreds of faces; closing more takes too long."""

_PASSED = {
    "vt",
    "vn",
    "vp",
    "mtllib",
    "s",
    "p",
    "l",
    "cstype",
    "deg",
    "bmat",
    "step",
    "curv",
    "curv2",
    "surf",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "mg",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "shadow_obj",
    "trace_obj",
    "ctech",
    "stech",
    "maplib",
    "usemap",
}


def read(path: str | os.PathLike[str], *, unit: float = 1.0) -> Polyhedron:
    """Read a room; DataError names file, line and rule, or says where the walls do not close.

    ``unit`` is the length of the file's unit in m: 0.001 for a model in mm.
    """
    return parse(read_bytes(path, MAX_TEXT), os.fspath(path), unit=unit)


def parse(content: bytes, path: str = "OBJ file", *, unit: float = 1.0) -> Polyhedron:
    """Return the room of a file's content; see `read`."""
    if not 0 < unit < float("inf"):
        raise DataError(f"unit = {unit:g} m is not finite and above 0")
    vertices: list[tuple[float, ...]] = []
    faces: list[list[int]] = []
    materials: list[str] = []
    names: list[str] = []
    material, group = "", ""
    line, held = 0, ""
    for raw in as_text(content).split("\n"):
        line += 1
        place = f"{path}, line {line}"
        if raw.rstrip("\r").endswith("\\"):
            held += raw.rstrip("\r")[:-1] + " "
            continue
        raw, held = held + raw, ""
        keyword, *rests = raw.split("#", 1)[0].split(None, 1) or [""]
        rest = rests[0].strip() if rests else ""
        if keyword == "v":
            if len(vertices) >= 4 * MAX_FACES:
                raise DataError(f"{place}: more than {4 * MAX_FACES} vertices")
            tokens = rest.split()
            if not 3 <= len(tokens) <= 7:
                raise DataError(f"{place}: v has {len(tokens)} numbers; x y z are needed")
            vertices.append(tuple(unit * number(t, place) for t in tokens[:3]))
        elif keyword == "f":
            if len(faces) >= MAX_FACES:
                raise DataError(f"{place}: more than {MAX_FACES} faces; simplify the model")
            if not material:
                raise DataError(f"{place}: a face without a material; usemtl must stand before it")
            faces.append([_corner(t, len(vertices), place) for t in rest.split()])
            if not 3 <= len(faces[-1]) <= 100:
                raise DataError(f"{place}: a face of {len(faces[-1])} corners; 3 to 100 are read")
            materials.append(material)
            names.append(f"{group or 'face'} {len(faces)}")
        elif keyword == "usemtl":
            material = text_name(f"{place}: usemtl", readable(rest))
            if not material:
                raise DataError(f"{place}: usemtl lacks the material's name")
        elif keyword in ("o", "g"):
            group = text_name(f"{place}: {keyword}", readable(rest))
        elif keyword and keyword not in _PASSED:
            raise DataError(f'{place}: "{shown(keyword)}" is no keyword of an OBJ file')
    if not faces:
        raise DataError(f"{path}, line {line}: there is no face; a room has at least 4")
    try:
        return Polyhedron(vertices=vertices, faces=faces, materials=materials, names=names)  # type: ignore[arg-type]
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def write(polyhedron: Polyhedron, path: str | os.PathLike[str]) -> None:
    """Write a room as OBJ in m, whole or not at all; reading it back gives the same room."""
    for material in polyhedron.materials:
        if not material or material.strip() != material or not material.isprintable():
            raise DataError(f"material {material!r}: a name in an OBJ file is one line of text")
    lines = ["# m; written by rtcal"]
    lines += ["v " + " ".join(repr(float(x)) for x in vertex) for vertex in polyhedron.vertices]
    last = None
    for face, material in zip(polyhedron.faces, polyhedron.materials, strict=True):
        if material != last:
            lines.append(f"usemtl {material}")
            last = material
        lines.append("f " + " ".join(str(v + 1) for v in face))
    write_text(path, "\n".join(lines) + "\n")


def _corner(token: str, n_vertices: int, place: str) -> int:
    match = re.fullmatch(r"(-?\d{1,9})(?:/-?\d{0,9}){0,2}", token, re.ASCII)
    if match is None:
        raise DataError(f'{place}: "{shown(token)}" is no corner: vertex, or vertex/texture/normal')
    index = int(match.group(1))
    index = index - 1 if index > 0 else n_vertices + index
    if not 0 <= index < n_vertices or match.group(1) in ("0", "-0"):
        raise DataError(
            f"{place}: the corner {match.group(1)} is no vertex; {n_vertices} stand above"
        )
    return index
