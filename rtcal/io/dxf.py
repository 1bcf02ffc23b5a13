"""DXF (text): 3D faces, polyface meshes and meshes; the layer is the material.

Read are the entities 3DFACE, POLYLINE as a polyface or polygon mesh with its VERTEX entities, and
MESH, outside blocks. Others, such as lines, texts and solids (ACIS), are counted in a note.

Source: Autodesk, "DXF Reference", 2012, ENTITIES: group codes of 3DFACE, POLYLINE, VERTEX, MESH.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from rtcal.acoustics.materials import text_name
from rtcal.io.mend import Faces
from rtcal.io.mend.faces import unit_notes
from rtcal.io.text import decode, lines, number, shown
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MAX_FACES = 100_000
_UNITS = {1: 0.0254, 2: 0.3048, 4: 0.001, 5: 0.01, 6: 1.0, 14: 0.1}
"""Length in m of the header's $INSUNITS; others, and 0, are none."""

Pair = tuple[int, str, int]
"""Group code, value, and line."""


def faces(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a DXF file; DataError names the line."""
    if content.startswith(b"AutoCAD Binary DXF"):
        raise DataError(f"{path}: binary DXF; save it as text (ASCII) DXF")
    pairs = list(_pairs(content, path))
    stated = _unit(pairs, path)
    length = unit if unit is not None else stated if stated is not None else 1.0
    polygons: list[Array] = []
    layers: list[str] = []
    others: Counter[str] = Counter()
    mesh: list[list[Pair]] | None = None
    for entity in _entities(pairs):
        kind = entity[0][1]
        if kind == "3DFACE":
            codes = {code for code, _, _ in entity}
            corners = [_point(entity, k, path) for k in range(4) if 10 + k in codes]
            _add(polygons, layers, corners, entity, path)
        elif kind == "POLYLINE":
            mesh = [entity]
        elif kind == "VERTEX" and mesh is not None:
            mesh.append(entity)
        elif kind == "SEQEND":
            if mesh is not None:
                for corners in _of_polyline(mesh, path, others):
                    _add(polygons, layers, corners, mesh[0], path)
            mesh = None
        elif kind == "MESH":
            for corners in _of_mesh(entity, path):
                _add(polygons, layers, corners, entity, path)
        else:
            others[kind] += 1
        if len(polygons) > MAX_FACES:
            raise DataError(f"{path}, line {entity[0][2]}: more than {MAX_FACES} faces")
    left_out = ", ".join(f"{n} {shown(kind)}" for kind, n in others.most_common(5))
    if not polygons:
        raise DataError(
            f"{path}: no 3D face{f' (but {left_out})' if left_out else ''}; in your program, convert "
            "solids and surfaces to meshes or 3D faces"
        )
    notes = unit_notes(length, stated, unit)
    notes += [f"no faces, left out: {left_out}"] if left_out else []
    names = [f"{layer} {i}" for i, layer in enumerate(layers, 1)]
    return Faces(path, [p * length for p in polygons], layers, names, tuple(notes))


def _add(
    polygons: list[Array],
    layers: list[str],
    corners: Sequence[Sequence[float]],
    entity: Sequence[Pair],
    path: str,
) -> None:
    polygons.append(np.array(corners, dtype=float))
    layer = next((v for c, v, _ in entity if c == 8), "0")
    layers.append(text_name(f"{path}, line {entity[0][2]}: layer", layer) or "0")


def _pairs(content: bytes, path: str) -> Iterator[Pair]:
    """Yield the pairs of a group code and a value, each on two lines."""
    rows = [(n, raw.strip()) for n, _, raw in lines(decode(content, path).characters)]
    for (n, code), (_, value) in zip(rows[::2], rows[1::2], strict=False):
        try:
            yield int(code), value, n
        except ValueError as error:
            raise DataError(f'{path}, line {n}: "{shown(code)}" is no group code of DXF') from error


def _unit(pairs: Sequence[Pair], path: str) -> float | None:
    for (code, value, _), (_, following, line) in pairwise(pairs):
        if code == 9 and value == "$INSUNITS":
            return _UNITS.get(int(number(following, f"{path}, line {line}")))
    return None


def _entities(pairs: Sequence[Pair]) -> Iterator[list[Pair]]:
    """Yield the entities of the section ENTITIES, each as its pairs from the name on."""
    section, entity = "", list[Pair]()
    for i, pair in enumerate(pairs):
        code, value, _ = pair
        if code == 0:
            if entity and section == "ENTITIES":
                yield entity
            entity = []
            if value == "SECTION":
                section = pairs[i + 1][1] if i + 1 < len(pairs) else ""
            elif value in ("ENDSEC", "EOF"):
                section = ""
            elif section == "ENTITIES":
                entity = [pair]
        elif entity:
            entity.append(pair)


def _value(entity: Sequence[Pair], code: int, path: str, otherwise: float | None = None) -> float:
    for c, value, line in entity:
        if c == code:
            return number(value, f"{path}, line {line + 1}")
    if otherwise is None:
        place = f"{path}, line {entity[0][2]}"
        raise DataError(f"{place}: {entity[0][1]} lacks the group code {code}")
    return otherwise


def _point(entity: Sequence[Pair], k: int, path: str) -> list[float]:
    return [_value(entity, 10 * axis + k, path, 0.0 if axis == 3 else None) for axis in (1, 2, 3)]


def _of_polyline(
    mesh: Sequence[Sequence[Pair]], path: str, others: Counter[str]
) -> list[list[list[float]]]:
    """Return the polygons of a polyface mesh (flag 64) or of a polygon mesh of m x n (flag 16)."""
    flags = int(_value(mesh[0], 70, path, 0.0))
    points: list[list[float]] = []
    polygons: list[list[list[float]]] = []
    if not flags & (16 | 64):
        others["POLYLINE"] += 1
        return []
    for vertex in mesh[1:]:
        if int(_value(vertex, 70, path, 0.0)) & 192 == 128:  # a face of a polyface mesh
            index = [abs(int(_value(vertex, c, path, 0.0))) for c in (71, 72, 73, 74)]
            index = [k for k in index if k]
            if len(index) < 3 or max(index) > len(points):
                raise DataError(f"{path}, line {vertex[0][2]}: a face without its corners")
            polygons.append([points[k - 1] for k in index])
        else:
            points.append(_point(vertex, 0, path))
    if flags & 16:
        m, n = (int(_value(mesh[0], code, path)) for code in (71, 72))
        if m * n != len(points):
            raise DataError(
                f"{path}, line {mesh[0][2]}: {len(points)} corners of a mesh of {m} x {n}"
            )
        for i in range(m - (not flags & 1)):
            for k in range(n - (not flags & 32)):
                corners = [(i, k), (i + 1, k), (i + 1, k + 1), (i, k + 1)]
                polygons.append([points[(a % m) * n + b % n] for a, b in corners])
    return polygons


def _of_mesh(entity: Sequence[Pair], path: str) -> list[list[list[float]]]:
    """Return the polygons of a MESH: 92 corners, 93 the size of the list, then counts and corners."""
    n_points = int(_value(entity, 92, path))
    found: dict[int, list[float]] = {10: [], 20: [], 30: []}
    for code, value, line in entity:
        if code in found and len(found[code]) < n_points:
            found[code].append(number(value, f"{path}, line {line + 1}"))
    start = next((i for i, (code, _, _) in enumerate(entity) if code == 93), None)
    if start is None or len({n_points, *map(len, found.values())}) != 1:
        raise DataError(f"{path}, line {entity[0][2]}: MESH without its corners or faces")
    size = int(number(entity[start][1], f"{path}, line {entity[start][2] + 1}"))
    listed = [int(number(v, f"{path}, line {n + 1}")) for c, v, n in entity[start + 1 :] if c == 90]
    points = list(map(list, zip(*found.values(), strict=True)))
    polygons, i = [], 0
    while i < min(size, len(listed)):
        index = listed[i + 1 : i + 1 + listed[i]]
        if len(index) < 3 or not all(0 <= k < n_points for k in index):
            raise DataError(f"{path}, line {entity[0][2]}: MESH has a face without its corners")
        polygons.append([points[k] for k in index])
        i += 1 + listed[i]
    return polygons
