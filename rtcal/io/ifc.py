"""Building models (.ifc): one space and what bounds it, by ifcopenshell (``rtcal[ifc]``).

A space is a closed solid. The model says which wall, slab or covering bounds each of its faces, and
where doors and windows are (`IfcRelSpaceBoundary`). A face's material is named after the element:
its material, or the name of its layers. A door or window is a face that lies on its wall's; the mender
gives it its area. Faces that nothing bounds are "floor", "ceiling" and "wall"; where one space opens
into another they are "opening".

Source: ISO 16739-1:2018, IfcRelSpaceBoundary, IfcConnectionSurfaceGeometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.acoustics.materials import text_name
from rtcal.io.mend import Faces
from rtcal.io.mend.polygons import axes_of, normal_of, polygon_of
from rtcal.io.text import shown
from rtcal.support.errors import DataError
from rtcal.support.lazy import library
from rtcal.support.types import Array

MAX_FACES = 100_000
OPENING = "opening"
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


def faces(path: str, unit: float | None, space: str | None) -> Faces:
    """Return the faces of one space of a building model, with the materials that bound it.

    ``space`` is its name, long name or both; it may be left out where there is one space.

    Raises DataError for a file that cannot be read, a model without spaces, and a space that is not
    named or not known: the message lists those of the model. MissingDependencyError without
    ifcopenshell.
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
        model = ifcopenshell.open(path)
        length = float(ifcopenshell.util.unit.calculate_unit_scale(model))
        spaces = {_title(s): s for s in model.by_type("IfcSpace")}
    except Exception as error:  # ifcopenshell raises what its parser raises
        raise DataError(f"{path}: cannot be read as IFC: {error}") from error
    chosen = _chosen(path, spaces, space)
    try:
        triangles = _triangles(ifcopenshell, spaces[chosen])
        boundaries, unknown = _boundaries(ifcopenshell, spaces[chosen], length)
    except (RuntimeError, ValueError, AttributeError, IndexError) as error:
        raise DataError(f'{path}: space "{shown(chosen)}" has no shape: {error}') from error
    if len(triangles) > MAX_FACES:
        raise DataError(f"{path}: {len(triangles)} triangles; at most {MAX_FACES}")
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
    if unknown:
        notes.append(f"{unknown} boundaries have a form that is not read")
    if not boundaries:
        notes.append("the model does not say what bounds it: faces are floor, ceiling and wall")
    return Faces(path, polygons, materials, names, tuple(notes))


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
                material=OPENING if virtual or element is None else _named(ifcopenshell, element),
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
