"""Faces of models drawn in CAD programs: a DXF file, and one space of a building model (IFC).

Of DXF (text) 3D faces, polyface meshes and meshes are read; the layer is the material. That is the
entities 3DFACE, POLYLINE as a polyface or polygon mesh with its VERTEX entities, and MESH, outside
blocks. Others, such as lines, texts and solids (ACIS), are counted in a note.

Of IFC, by ifcopenshell (``rtcal[ifc]``), one space is read and what bounds it. A space is a closed
solid. The model says which wall, slab or covering bounds each of its faces, and where doors and windows
are (`IfcRelSpaceBoundary`). A face's material is named after the element: its material, or the name of
its layers. A door or window is a face that lies on its wall's; the mender gives it its area. Faces that
nothing bounds are "floor", "ceiling" and "wall"; where one space opens into another they are "opening".

Sources: Autodesk, "DXF Reference", 2012, ENTITIES: group codes of 3DFACE, POLYLINE, VERTEX, MESH;
ISO 16739-1:2018, IfcRelSpaceBoundary, IfcConnectionSurfaceGeometry.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from rtcal.acoustics.materials import text_name
from rtcal.io import budget, units
from rtcal.io.mend import Faces
from rtcal.io.mend.polygons import axes_of, normal_of, polygon_of, shapely
from rtcal.io.text import decode, lines, number, shown
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MAX_IFC = 2**25
"""Largest size in bytes of a building model: ifcopenshell takes some eight times as much memory."""
_SAME = 1e-9  # m, of one point
_LARGEST_GAP = 0.1  # m, of an outline's ends; one that leaves out its last edge is longer
_CROSSED = 1e-3  # share of an outline's area by which its parts must differ in their turning
_POINT = re.compile(r"-?\d[\d.e+-]*")
Pair = tuple[int, str, int]
"""Group code, value, and line."""


def dxf_faces(content: bytes, path: str, unit: float | None) -> Faces:
    """Return the faces of a DXF file; DataError names the line."""
    if content.startswith(b"AutoCAD Binary DXF"):
        raise DataError(f"{path}: binary DXF; save it as text (ASCII) DXF")
    stated = _unit(_pairs(content, path), path, is_refused=unit is None)
    length = unit if unit is not None else stated if stated is not None else 1.0
    polygons: list[Array] = []
    layers: list[str] = []
    others: Counter[str] = Counter()
    mesh: list[list[Pair]] | None = None
    for entity in _entities(_pairs(content, path)):
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
        if len(polygons) > budget.MAX_FACES:
            raise DataError(f"{path}, line {entity[0][2]}: more than {budget.MAX_FACES} faces")
    left_out = ", ".join(f"{n} {shown(kind)}" for kind, n in others.most_common(5))
    if not polygons:
        raise DataError(
            f"{path}: no 3D face{f' (but {left_out})' if left_out else ''}; in your program, convert "
            "solids and surfaces to meshes or 3D faces"
        )
    notes = units.notes(length, stated, unit)
    notes += [f"no faces, left out: {left_out}"] if left_out else []
    names = [f"{layer} {i}" for i, layer in enumerate(layers, 1)]
    known = None if unit is None and stated is None else length
    return Faces(path, [p * length for p in polygons], layers, names, tuple(notes), known)


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
    rows = ((n, raw.strip()) for n, _, raw in lines(decode(content, path).characters))
    for (n, code), (_, value) in zip(rows, rows, strict=False):
        try:
            yield int(code), value, n
        except ValueError as error:
            raise DataError(f'{path}, line {n}: "{shown(code)}" is no group code of DXF') from error


def _unit(pairs: Iterator[Pair], path: str, *, is_refused: bool) -> float | None:
    """Return the length of the header's unit in m, None without one; DataError if it is not known."""
    for (code, value, _), (_, following, line) in pairwise(pairs):
        if code == 2 and value == "ENTITIES":
            break
        if code == 9 and value == "$INSUNITS":
            place = f"{path}, line {line + 1}"
            stated = number(following, place)
            if stated not in units.OF_DXF and is_refused:
                raise DataError(
                    f"{place}: $INSUNITS = {following} is no unit of DXF, which has 0 to "
                    f"{max(units.OF_DXF)}; state its length in m, such as unit = 0.01"
                )
            return units.OF_DXF.get(int(stated))
    return None


def _entities(pairs: Iterator[Pair]) -> Iterator[list[Pair]]:
    """Yield the entities of the section ENTITIES, each as its pairs from the name on."""
    section, entity = "", list[Pair]()
    for pair in pairs:
        code, value, _ = pair
        if code == 0:
            if entity and section == "ENTITIES":
                yield entity
            entity = []
            if value == "SECTION":
                section = next(pairs, (0, "", 0))[1]
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


_NEAR = 0.3
"""Largest distance in m of a boundary from the face that it bounds: boundaries may lie in a wall."""
_FILLINGS = ("IfcDoor", "IfcWindow")
_STEEP = 0.7
"""Largest vertical part of a wall's normal."""


@dataclass(frozen=True)
class _Boundary:
    """A polygon (n, 3) in m of an element that bounds a space."""

    corners: Array
    material: str
    is_filling: bool
    is_covering: bool


def ifc_faces(path: str, unit: float | None, space: str | None, weld: float) -> Faces:
    """Return the faces of one space of a building model, with the materials that bound it.

    ``space`` is its name, long name or both; it may be left out where there is one space. An outline
    whose ends are within ``weld`` (m) of each other is closed, and a note says so.

    Raises DataError for a file that cannot be read, a model without spaces, an outline that crosses
    itself, and a space that is not named or not known: the message lists those of the model.
    MissingDependencyError without ifcopenshell.
    """
    ifcopenshell = library(
        "IFC needs ifcopenshell: pip install 'rtcal[ifc]'; or export glTF of the room",
        "ifcopenshell",
        "ifcopenshell.geom",
        "ifcopenshell.util.element",
        "ifcopenshell.util.placement",
        "ifcopenshell.util.unit",
    )
    if unit is not None:
        raise DataError(f"{path}: a building model states its unit: leave --unit out")
    try:
        size = os.stat(path).st_size
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    budget.require(size, MAX_IFC, "bytes", path, "export one storey, or the room alone")
    try:
        model = ifcopenshell.open(path)
        length = float(ifcopenshell.util.unit.calculate_unit_scale(model))
        spaces = {_title(s): s for s in model.by_type("IfcSpace")}
    except Exception as error:  # ifcopenshell raises what its parser raises
        raise DataError(
            f"{path}: cannot be read as IFC: it is damaged, or no IFC 2x3 or 4. Export the model "
            "again, or glTF of the room"
        ) from error
    chosen = _chosen(path, spaces, space)
    place = f'{path}: space "{shown(chosen)}"'
    gap, open_by = _close_outlines(spaces[chosen], length, weld, place)
    try:
        triangles = _triangles(ifcopenshell, spaces[chosen])
        boundaries, unknown = _boundaries(ifcopenshell, spaces[chosen], length)
    except (RuntimeError, ValueError, AttributeError, IndexError) as error:
        why = "it has none, or its solid is not closed"
        if open_by:
            why = f"its outline is {_open(open_by)}"
        raise DataError(
            f"{place} has no shape that can be read: {why}. Draw it again in your program, or export "
            "glTF of the room"
        ) from error
    if len(triangles) > budget.MAX_FACES:
        raise DataError(f"{path}: {len(triangles)} triangles; at most {budget.MAX_FACES}")
    polygons: list[Array] = []
    materials: list[str] = []
    for corners in triangles:
        polygons.append(corners)
        materials.append(_material_at(corners, boundaries))
    names = list(materials)
    for filling in (b for b in boundaries if b.is_filling):
        polygons.append(_on_face(filling.corners, triangles))
        materials.append(filling.material)
        names.append(filling.material)
    notes = [f'space "{shown(chosen)}" of {len(spaces)}']
    if gap:
        notes.append(f"its outline was open by {1000 * gap:.2g} mm and is closed (--weld)")
    if open_by:
        notes.append(f"an edge closes its outline, which is {_open(open_by)}")
    if unknown:
        notes.append(f"{unknown} boundaries have a form that is not read")
    if not boundaries:
        notes.append("the model does not say what bounds it: faces are floor, ceiling and wall")
    return Faces(path, polygons, materials, names, tuple(notes), length)


def _title(space: Any) -> str:
    parts = dict.fromkeys(str(p) for p in (space.Name, space.LongName) if p)
    return text_name("a space", " ".join(parts)) or f"space {space.id()}"


def _chosen(path: str, spaces: dict[str, Any], wanted: str | None) -> str:
    if not spaces:
        raise DataError(
            f"{path}: the model has no space (IfcSpace); export rooms with it, or glTF of the room"
        )
    if wanted is None and len(spaces) == 1:
        return next(iter(spaces))
    listed = ", ".join(f'"{shown(name)}"' for name in spaces)
    found = [n for n, s in spaces.items() if wanted in (n, s.Name, s.LongName)]
    if wanted is None:
        raise DataError(f"{path}: which space? State --space; the model has {listed}")
    if len(found) != 1:
        many = "is no space" if not found else f"are {len(found)} spaces"
        raise DataError(f'{path}: --space "{shown(wanted)}" {many} of the model; it has {listed}')
    return found[0]


def _close_outlines(space: Any, length: float, weld: float, place: str) -> tuple[float, float]:
    """Close the outlines of a space whose ends are nearly one point.

    Returned are the largest gaps in m: of those that were closed, and of wider ones (`_LARGEST_GAP`).
    ``length`` is the model's unit in m. Raises DataError for an outline that crosses itself, since the
    library keeps one part of it, or has fewer than three corners.
    """
    closed = wider = 0.0
    for profile in space.file.traverse(space):
        if not profile.is_a("IfcArbitraryClosedProfileDef"):
            continue
        for curve in (profile.OuterCurve, *(getattr(profile, "InnerCurves", None) or ())):
            points = _corners(curve)
            if points is None:
                continue
            gap = float(np.linalg.norm(points[-1] - points[0])) * length
            ends_meet = gap <= max(weld, _SAME)
            ring = points[:-1] if ends_meet else points
            if len(ring) < 3:
                raise DataError(f"{place}: its outline has {len(ring)} corners; three are needed")
            _refuse_crossing(ring * length, place)
            if not ends_meet:
                wider = max(wider, gap if gap <= _LARGEST_GAP else 0.0)
            elif gap > _SAME:
                closed = max(closed, gap)
                _join_ends(curve)
    return closed, wider


def _open(gap: float) -> str:
    return f"open by {1000 * gap:.3g} mm (--weld {1.1 * gap:.2g} makes its ends one point)"


def _refuse_crossing(ring: Array, place: str) -> None:
    """Raise DataError for an outline (n, 2) in m that crosses itself, not for one that touches."""
    outline = shapely().Polygon(ring)
    x, y = ring.T
    turned = (
        abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    )  # parts that turn back count less
    covered = float(shapely().make_valid(outline).area)
    if abs(turned - covered) > _CROSSED * covered:
        at = _POINT.findall(shapely().is_valid_reason(outline))[:2]
        where = " and ".join(
            f"{name} = {float(c):.3g} m" for name, c in zip("xy", at, strict=False)
        )
        raise DataError(
            f"{place}: its outline crosses itself{' at ' * bool(where)}{where}; draw it again in your "
            "program"
        )


def _corners(curve: Any) -> Array | None:
    """Return the corners of an outline in the plane, (n, 2), in the model's unit; None for arcs."""
    if curve.is_a("IfcPolyline"):
        return np.array([point.Coordinates[:2] for point in curve.Points], dtype=float)
    if curve.is_a("IfcIndexedPolyCurve") and not curve.Segments:
        return np.array(curve.Points.CoordList, dtype=float)[:, :2]
    return None


def _join_ends(curve: Any) -> None:
    """Make the last point of an outline its first."""
    if curve.is_a("IfcPolyline"):
        curve.Points = (*curve.Points[:-1], curve.Points[0])
    else:
        listed = curve.Points.CoordList
        curve.Points.CoordList = (*listed[:-1], listed[0])


def _triangles(ifcopenshell: Any, space: Any) -> Array:
    """Return the triangles of a space in m, (n, 3, 3)."""
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    shape = ifcopenshell.geom.create_shape(settings, space).geometry
    points = np.array(shape.verts, dtype=float).reshape(-1, 3)
    return np.asarray(points[np.array(shape.faces, dtype=int).reshape(-1, 3)])


def _boundaries(ifcopenshell: Any, space: Any, length: float) -> tuple[list[_Boundary], int]:
    """Return the boundaries of a space, and the number of those that are not read."""
    placement = np.array(ifcopenshell.util.placement.get_local_placement(space.ObjectPlacement))
    found, unknown = [], 0
    for relation in space.BoundedBy or ():
        surface = getattr(relation.ConnectionGeometry, "SurfaceOnRelatingElement", None)
        local = _polygon_of_surface(ifcopenshell, surface)
        if local is None:
            unknown += 1
            continue
        element = relation.RelatedBuildingElement
        virtual = relation.PhysicalOrVirtualBoundary == "VIRTUAL"
        corners = (np.column_stack([local, np.ones(len(local))]) @ placement.T)[:, :3] * length
        found.append(
            _Boundary(
                corners=corners,
                material="opening" if virtual or element is None else _named(ifcopenshell, element),
                is_filling=element is not None and element.is_a() in _FILLINGS,
                is_covering=element is not None and element.is_a("IfcCovering"),
            )
        )
    return found, unknown


def _polygon_of_surface(ifcopenshell: Any, surface: Any) -> Array | None:
    """Return the corners of a plane surface in the space's coordinates; None for other surfaces."""
    if surface is None:
        return None
    if surface.is_a("IfcCurveBoundedPlane"):
        flat, position = surface.OuterBoundary, surface.BasisSurface.Position
        if not flat.is_a("IfcPolyline"):
            return None
        points = _points(flat)
    elif surface.is_a("IfcSurfaceOfLinearExtrusion"):
        curve, position = surface.SweptCurve.Curve, surface.Position
        if not curve.is_a("IfcPolyline") or len(curve.Points) != 2:
            return None
        along = np.array(surface.ExtrudedDirection.DirectionRatios, dtype=float)
        along *= surface.Depth / np.linalg.norm(along)
        line = _points(curve)
        points = np.concatenate([line, line[::-1] + along])
    else:
        return None
    if position is None:
        return points
    matrix = np.array(ifcopenshell.util.placement.get_axis2placement(position))
    return np.asarray((np.column_stack([points, np.ones(len(points))]) @ matrix.T)[:, :3])


def _points(line: Any) -> Array:
    points = [(*point.Coordinates, 0.0, 0.0)[:3] for point in line.Points]
    return np.array(points[:-1] if points[0] == points[-1] else points, dtype=float)


def _named(ifcopenshell: Any, element: Any) -> str:
    """Return the name of an element's material or layers, or its own without its number."""
    material = ifcopenshell.util.element.get_material(element, should_skip_usage=True)
    name = getattr(material, "LayerSetName", None) or getattr(material, "Name", None)
    if not name:
        own = str(element.Name or element.is_a()[3:])
        head, _, tail = own.rpartition(":")
        name = head if head and tail.isdigit() else own
    return text_name("a material", str(name)) or "unnamed"


def _material_at(corners: Array, boundaries: list[_Boundary]) -> str:
    """Return the material of a triangle: of what covers most of it, coverings and the nearest first."""
    normal = normal_of(corners)
    axes = axes_of(normal)
    own = polygon_of(corners, axes)
    best, name = (0, 0, 0.0), ""
    for boundary in boundaries:
        if boundary.is_filling or not _beside(boundary.corners, corners, normal):
            continue
        shared = own.intersection(polygon_of(boundary.corners, axes)).area / own.area
        away = abs(float((boundary.corners.mean(axis=0) - corners[0]) @ normal))
        rank = (int(shared > 0.5), int(boundary.is_covering), shared - away)
        if shared > 0 and (not name or rank > best):
            best, name = rank, boundary.material
    if name:
        return name
    if abs(normal[2]) < _STEEP:
        return "wall"
    return "ceiling" if normal[2] > 0 else "floor"


def _beside(corners: Array, face: Array, normal: Array) -> bool:
    """Return whether a polygon is parallel to a face and near its plane."""
    away = np.abs((corners - face[0]) @ normal).max()
    return bool(abs(normal_of(corners) @ normal) > 0.99 and away < _NEAR)


def _on_face(corners: Array, triangles: Array) -> Array:
    """Return a polygon moved onto the plane of the nearest face that is parallel to it."""
    normal = normal_of(corners)
    near = [t for t in triangles if _beside(corners, t, normal_of(t))]
    if not near:
        return corners
    away = min(((t[0] - corners.mean(axis=0)) @ normal for t in near), key=abs)
    return np.asarray(corners + normal * away)
