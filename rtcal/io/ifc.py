"""Faces of one space of a building model (IFC), with the materials that bound it.

By ifcopenshell (``rtcal[ifc]``) one space is read and what bounds it. A space is a closed
solid. The model says which wall, slab or covering bounds each of its faces, and where doors and windows
are (`IfcRelSpaceBoundary`). A face's material is named after the element: its material, or the name of
its layers. A door or window is a face that lies on its wall's; the mender gives it its area. Faces that
nothing bounds are "floor", "ceiling" and "wall"; where one space opens into another they are "opening".

Source: ISO 16739-1:2018, IfcRelSpaceBoundary, IfcConnectionSurfaceGeometry.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.files.disk import reason
from rtcal.io import budget
from rtcal.io.mend import Faces, Polygon, normal_of, shapely
from rtcal.io.text import shown
from rtcal.support import library
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MAX_IFC = 2**25
"""Largest size in bytes of a building model; ifcopenshell needs some eight times as much memory."""
_SAME = 1e-9  # m, of one point
_LARGEST_GAP = 0.1  # m, of an outline's ends; one that leaves out its last edge is longer
_CROSSED = 1e-3  # share of an outline's area by which its parts must differ in their turning
_POINT = re.compile(r"-?\d[\d.e+-]*")


_NEAR = 0.3
"""Largest distance in m of a boundary from the face that it bounds: boundaries may lie in a wall."""
_FILLINGS = ("IfcDoor", "IfcWindow")
_STEEP = 0.7  # Largest vertical part of a wall's normal


@dataclass(frozen=True)
class _Boundary:
    """A polygon (n, 3) in m of an element that bounds a space."""

    corners: Array
    material: str
    is_filling: bool
    is_covering: bool


def faces(path: str, unit: float | None, space: str | None, weld: float) -> Faces:
    """Return the faces of one space in a building model (IFC), with their materials.

    ``space`` is a name, a long name or both; None if there is one. Gaps up to ``weld`` in m are closed.
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
        raise DataError(f"{path}: a building model (IFC) contains its unit: leave --unit out")
    try:
        size = os.stat(path).st_size
    except OSError as error:
        raise DataError(f"{path}: {reason(error)}") from error
    budget.require(size, MAX_IFC, "bytes", path, "export one storey, or the room alone")
    _require_sound(path)
    spaces: dict[str, Any] = {}
    with budget.parsing(path, "IFC 2x3 or 4", "Export the model again, or the room as glTF"):
        model = ifcopenshell.open(path)
        length = float(ifcopenshell.util.unit.calculate_unit_scale(model))
        for each in model.by_type("IfcSpace"):
            parts = dict.fromkeys(str(p) for p in (each.Name, each.LongName) if p)
            spaces[text_name("a space", " ".join(parts)) or f"space {each.id()}"] = each
    if not 0 < length < np.inf:
        raise DataError(f"{path}: its unit of length is {length:g} m, but must be above 0")
    chosen = _chosen(path, spaces, space)
    place = f'{path}: space "{shown(chosen)}"'
    gap, open_by = _close_outlines(spaces[chosen], length, weld, place)
    try:
        settings = ifcopenshell.geom.settings()
        settings.set("use-world-coords", True)
        element = ifcopenshell.geom.create_shape(settings, spaces[chosen])
        shape = element.geometry  # 0.8.1 frees it with the element
        points = np.array(shape.verts, dtype=float).reshape(-1, 3)
        triangles = np.asarray(points[np.array(shape.faces, dtype=int).reshape(-1, 3)])
        boundaries, unknown = _boundaries(ifcopenshell, spaces[chosen], length)
    except (RuntimeError, ValueError, AttributeError, IndexError) as error:
        why = "it has none, or its solid is not closed"
        if open_by:
            why = f"its outline is {_open(open_by)}"
        raise DataError(
            f"{place} has no shape that can be read: {why}. Draw it again in your program, or "
            "export the room as glTF"
        ) from error
    budget.require(len(triangles), budget.MAX_FACES, "triangles", path, "simplify the model")
    polygons: list[Array] = []
    materials: list[str] = []
    for corners in triangles:
        polygons.append(corners)
        materials.append(_material_at(corners, boundaries))
    names = list(materials)
    for filling in (b for b in boundaries if b.is_filling):
        # It is moved onto the plane of the nearest face that is parallel to it.
        corners, normal = filling.corners, normal_of(filling.corners)
        near = [t for t in triangles if _beside(corners, Polygon(t))]
        away = min(((t[0] - corners.mean(axis=0)) @ normal for t in near), key=abs, default=0.0)
        polygons.append(np.asarray(corners + normal * away))
        materials.append(filling.material)
        names.append(filling.material)
    notes = [f'space "{shown(chosen)}" of {len(spaces)}']
    if gap:
        notes.append(f"its outline was open by {1000 * gap:.2g} mm and is closed (--weld)")
    if open_by:
        notes.append(f"an edge closes its outline, which is {_open(open_by)}")
    if unknown:
        notes.append(f"{unknown} boundaries have a shape that rtcal cannot read, or no element")
    if not boundaries:
        notes.append(
            "the model does not give the elements around the room, so its faces are named floor, "
            "ceiling and wall"
        )
    return Faces(path, polygons, materials, names, tuple(notes), length)


def _chosen(path: str, spaces: dict[str, Any], wanted: str | None) -> str:
    if not spaces:
        raise DataError(
            f"{path}: the model has no space (IfcSpace); export it with its rooms, or export "
            "the room as glTF"
        )
    if wanted is None and len(spaces) == 1:
        return next(iter(spaces))
    listed = ", ".join(f'"{shown(name)}"' for name in spaces)
    found = [n for n, s in spaces.items() if wanted in (n, s.Name, s.LongName)]
    if wanted is None:
        raise DataError(f"{path}: the model has several spaces; name one with --space: {listed}")
    if len(found) != 1:
        many = "is no space" if not found else f"are {len(found)} spaces"
        raise DataError(f'{path}: --space "{shown(wanted)}" {many} of the model; it has {listed}')
    return found[0]


def _close_outlines(space: Any, length: float, weld: float, place: str) -> tuple[float, float]:
    """Close the outlines of a space whose ends are nearly one point.

    Returned are the largest gaps in m: of those that were closed, and of wider ones (`_LARGEST_GAP`).
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
                raise DataError(
                    f"{place}: its outline has {len(ring)} corners; at least three are needed"
                )
            _refuse_crossing(ring[:, :2] * length, place)
            if not ends_meet:
                wider = max(wider, gap if gap <= _LARGEST_GAP else 0.0)
            elif gap > _SAME:
                closed = max(closed, gap)
                if curve.is_a("IfcPolyline"):
                    curve.Points = (*curve.Points[:-1], curve.Points[0])
                else:
                    listed = curve.Points.CoordList
                    curve.Points.CoordList = (*listed[:-1], listed[0])
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
    """Return the corners of an outline, (n, 3), in the model's unit; None for one with arcs."""
    if curve.is_a("IfcPolyline"):
        rows = [point.Coordinates for point in curve.Points]
    elif curve.is_a("IfcIndexedPolyCurve") and not curve.Segments:
        rows = curve.Points.CoordList
    else:
        return None
    return np.array([(*row, 0.0, 0.0)[:3] for row in rows], dtype=float)


_END = b"END-ISO-10303-21;"
_DEEPEST = 1000
"""Most entities that refer to each other in a row: ifcopenshell follows them on the stack."""


def _require_sound(path: str) -> None:
    """Raise DataError for a file that is cut off or whose entities refer to each other without an end.

    ifcopenshell would follow an entity that refers to itself until the process ends.
    """
    content = re.sub(rb"'[^']*'", b"", Path(path).read_bytes())
    if _END not in content[-1000:].upper().replace(b" ", b""):
        raise DataError(
            f"{path}: cannot be read as IFC: its last line, {_END.decode()}, is missing, so it "
            "is cut off or not IFC 2x3 or 4. Copy or export the model again"
        )
    statements = re.findall(rb"^\s*#(\d+)\s*=([^;]*);", content, re.MULTILINE)
    order = TopologicalSorter({own: re.findall(rb"#(\d+)", to) for own, to in statements})
    deep = 0
    try:
        order.prepare()
    except CycleError as error:
        at = error.args[1][0].decode()
        raise DataError(f"{path}: #{at} refers to itself. Export the model again") from error
    while order.is_active():
        order.done(*order.get_ready())
        deep += 1
    if deep > _DEEPEST:
        raise DataError(
            f"{path}: {deep} entities refer to each other in a row; at most {_DEEPEST} are read"
        )


def _boundaries(ifcopenshell: Any, space: Any, length: float) -> tuple[list[_Boundary], int]:
    """Return the boundaries of a space, and the number of those that are not read."""
    placement = np.array(ifcopenshell.util.placement.get_local_placement(space.ObjectPlacement))
    found, relations = [], [*(space.BoundedBy or ())]
    for relation in relations:
        surface = getattr(relation.ConnectionGeometry, "SurfaceOnRelatingElement", None)
        local = _polygon_of_surface(ifcopenshell, surface)
        element, kind = relation.RelatedBuildingElement, relation.PhysicalOrVirtualBoundary
        if local is None or (element is None and kind == "PHYSICAL"):
            continue
        is_open = element is None or kind == "VIRTUAL"
        found.append(
            _Boundary(
                corners=_placed(local, placement) * length,
                material="opening" if is_open else _named(ifcopenshell, element),
                is_filling=element is not None and element.is_a() in _FILLINGS,
                is_covering=element is not None and element.is_a("IfcCovering"),
            )
        )
    return found, len(relations) - len(found)


def _placed(points: Array, matrix: Any) -> Array:
    """Return points (n, 3) moved by a matrix (4, 4)."""
    return np.asarray((np.column_stack([points, np.ones(len(points))]) @ np.array(matrix).T)[:, :3])


def _polygon_of_surface(ifcopenshell: Any, surface: Any) -> Array | None:
    """Return the corners of a plane surface in the space's coordinates; None for other surfaces."""
    if surface is not None and surface.is_a("IfcCurveBoundedPlane"):
        points, position = _corners(surface.OuterBoundary), surface.BasisSurface.Position
        if points is not None and (points[0] == points[-1]).all():
            points = points[:-1]
    elif surface is not None and surface.is_a("IfcSurfaceOfLinearExtrusion"):
        points, position = _corners(surface.SweptCurve.Curve), surface.Position
        if points is not None and len(points) == 2:
            along = np.array(surface.ExtrudedDirection.DirectionRatios, dtype=float)
            along *= surface.Depth / np.linalg.norm(along)
            points = np.concatenate([points, points[::-1] + along])
        else:
            points = None
    else:
        return None
    if points is None or position is None:
        return points
    return _placed(points, ifcopenshell.util.placement.get_axis2placement(position))


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
    plane, best, name = Polygon(corners), (0, 0, 0.0), ""
    for boundary in boundaries:
        if boundary.is_filling or not _beside(boundary.corners, plane):
            continue
        shared = plane.shape.intersection(plane.polygon(boundary.corners)).area / plane.shape.area
        away = abs(float(plane.away(boundary.corners).mean()))
        rank = (int(shared > 0.5), int(boundary.is_covering), shared - away)
        if shared > 0 and (not name or rank > best):
            best, name = rank, boundary.material
    if name:
        return name
    if abs(plane.normal[2]) < _STEEP:
        return "wall"
    return "ceiling" if plane.normal[2] > 0 else "floor"


def _beside(corners: Array, plane: Polygon) -> bool:
    """Return whether a polygon is parallel to a face and near its plane."""
    parallel = abs(normal_of(corners) @ plane.normal) > 0.99
    return bool(parallel and plane.thickness(corners) < _NEAR)
