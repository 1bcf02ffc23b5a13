"""Rooms bounded by plane walls: closed polyhedra, convex or not, with one material per face.

Tracers take a `Polyhedron`, and readers of meshes (OBJ) return one. Free-standing objects in the room
are further closed surfaces of the same polyhedron.

The arithmetic of plane polygons and triangles is below: areas, edges, cutting and distances.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.measurement import SAME_PLACE
from rtcal.acoustics.room import AXES, Surface
from rtcal.files.disk import write_text
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.types import Array

SHOEBOX_WALLS = ("west", "east", "south", "north", "floor", "ceiling")
"""Names of a shoebox's walls, in this order: x = 0, x = length, y = 0, y = width, z = 0, z = height."""

PLANARITY = 2e-3
"""Largest distance in m of a vertex from the plane of its face, twice the rounding to a millimetre."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Polyhedron:
    """Geometry of a room that is bounded by plane faces.

    The largest closed surface is the room; every other one is an object in it, whose volume is
    subtracted. Faces must be simple polygons, so that a wall with a hole needs two faces. They may have
    either orientation, and an edge may lie along several shorter ones. Faces that cut each other are
    not detected.

    Parameters
    ----------
    vertices : array (n_vertices, 3)
        Coordinates x, y, z of the vertices in m.
    faces : sequence of sequences of int
        Numbers of each face's vertices in order, counted from 0, (n_faces,).
    materials : sequence of str (n_faces,)
        Name of each face's material.
    names : sequence of str (n_faces,), optional
        Name of each face, by default "face 1", "face 2", ...
    leaks : bool
        Whether the walls may have small holes, as surveyed meshes have. The volume is then too small by
        the part that the holes cut off (`rtcal.simulators.path_tracing.by_chords` estimates it).

    Attributes
    ----------
    face_areas : array (n_faces,)
        Area of each face in m².
    normals : array (n_faces, 3)
        Unit normal of each face, which points out of the room's air.
    triangles : array (n_triangles, 3, 3)
        Corners of triangles that make up the faces, in m.
    triangle_faces : int array (n_triangles,)
        Face that each triangle belongs to.
    volume : float
        Volume of the room in m³, without the objects in it.

    Raises
    ------
    DataError
        If the walls do not close (the message names the edge), a face is not plane or has no area, a
        vertex does not exist, or an argument has a wrong type or shape.

    Examples
    --------
    >>> box = Polyhedron.shoebox((5, 7, 3), "plaster")
    >>> round(box.volume, 9), box.areas
    (105.0, {'plaster': 142.0})
    """

    vertices: Array
    faces: Sequence[Sequence[int]]
    materials: Sequence[str]
    names: Sequence[str] = ()
    leaks: bool = False
    face_areas: Array = field(init=False)
    normals: Array = field(init=False)
    triangles: Array = field(init=False)
    triangle_faces: NDArray[np.int64] = field(init=False)
    volume: float = field(init=False)

    def __repr__(self) -> str:
        return f"<Polyhedron: {self.volume:.4g} m³, {len(self.faces)} faces>"

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

        vertices, index = welded(_points("vertices", self.vertices))
        put("vertices", vertices)
        put("faces", checks.listed("faces", self.faces))
        put("materials", tuple(str(m) for m in checks.listed("materials", self.materials)))
        names = tuple(str(n) for n in checks.listed("names", self.names))
        put("names", names or tuple(f"face {i + 1}" for i in range(len(self.faces))))
        for name in ("materials", "names"):
            if len(getattr(self, name)) != len(self.faces):
                raise DataError(
                    f"{name} has {len(getattr(self, name))} values; give one for each of the "
                    f"{len(self.faces)} faces"
                )
        faces = [self._face(i, index) for i in range(len(self.faces))]
        checks.flag("leaks", self.leaks)
        faces = _turned_outward(vertices, faces, self.names, self.leaks)
        put("faces", tuple(faces))
        areas = vector_areas(vertices, faces)
        put("face_areas", np.linalg.norm(areas, axis=1))
        put("normals", areas / self.face_areas[:, np.newaxis])
        corners, owners = [], []
        for i, face in enumerate(faces):
            for triangle in triangulate(vertices[list(face)]):
                corners.append(vertices[[face[k] for k in triangle]])
                owners.append(i)
        put("triangles", np.array(corners))
        put("triangle_faces", np.array(owners, dtype=np.int64))
        put("volume", _volume(vertices, faces, areas))

    def _face(self, i: int, index: NDArray[np.int64]) -> tuple[int, ...]:
        """Return face i with merged vertices, without repetitions; DataError unless it is plane."""
        name = self.names[i]
        vertices = checks.listed(f'face "{name}"', self.faces[i])
        for v in vertices:
            if type(v) is int and 0 <= v < len(index):
                continue
            if checks.whole(f'a vertex of face "{name}"', v, 0) >= len(index):
                raise DataError(
                    f'face "{name}" has vertex {v}; vertices are numbered 0 to {len(index) - 1}'
                )
        merged = [int(index[v]) for v in vertices]
        face = tuple(v for k, v in enumerate(merged) if v != merged[k - 1])
        if len(face) < 3:
            raise DataError(f'face "{name}" has {len(face)} distinct vertices; it needs at least 3')
        corners = self.vertices[list(face)]
        area = vector_area(corners)
        size = float(np.linalg.norm(area))
        if size <= WELD**2:
            raise DataError(f'face "{name}" has no area: its vertices lie on one line')
        off = np.abs((corners - corners.mean(axis=0)) @ (area / size))
        if off.max() > PLANARITY:
            raise DataError(
                f'face "{name}" is not plane: its vertex {_place(corners[int(off.argmax())])} is '
                f"{off.max():.3g} m away from the plane; at most {PLANARITY:g} m is allowed"
            )
        return face

    @classmethod
    def shoebox(cls, dimensions: Sequence[float], materials: str | Mapping[str, str]) -> Polyhedron:
        """Return a box with one corner at the origin.

        ``dimensions`` are the length along x, the width along y and the height along z in m.
        ``materials`` is one name for all walls, or has the name of the material of each wall: "west" (x
        = 0), "east", "south" (y = 0), "north", "floor" and "ceiling". Raises DataError for a length
        that is not above 0, and for a wall without a material.
        """
        sides = checks.array("dimensions", dimensions)
        if sides.shape != (3,) or not (np.isfinite(sides) & (sides > 0)).all():
            raise DataError(f"dimensions = {dimensions!r} must be three finite lengths above 0 m")
        if isinstance(materials, str):
            materials = dict.fromkeys(SHOEBOX_WALLS, materials)
        materials = checks.mapped("materials", materials)
        if missing := [wall for wall in SHOEBOX_WALLS if wall not in materials]:
            raise DataError(f'materials of the shoebox: "{missing[0]}" is missing')
        # Vertex 4 i + 2 j + k stands at (i x, j y, k z).
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * sides
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return cls(
            vertices=corners,
            faces=faces,
            materials=[materials[wall] for wall in SHOEBOX_WALLS],
            names=SHOEBOX_WALLS,
        )

    @classmethod
    def from_polygons(
        cls, polygons: Iterable[tuple[str, str, Any]], *, leaks: bool = False
    ) -> Polyhedron:
        """Return a polyhedron from its faces, each given by its corners and not by their numbers.

        ``polygons`` has a (name, material, points) for each face, with its corners as points (n, 3) in
        m. ``leaks`` and the errors are those of `Polyhedron`.
        """
        polygons = checks.listed("polygons", polygons)
        if any(len(checks.listed("polygons", polygon)) != 3 for polygon in polygons):
            raise DataError("polygons must have a (name, material, points) for each face")
        points = [_points(f'face "{name}"', corners) for name, _, corners in polygons]
        starts = np.cumsum([0, *(len(p) for p in points)])
        return cls(
            vertices=np.concatenate(points) if points else np.zeros((0, 3)),
            faces=[range(a, b) for a, b in pairwise(starts)],
            materials=[material for _, material, _ in polygons],
            names=[name for name, _, _ in polygons],
            leaks=leaks,
        )

    @property
    def areas(self) -> dict[str, float]:
        """Area of each material in m², in the order of first appearance."""
        total: dict[str, float] = {}
        for material, area in zip(self.materials, self.face_areas, strict=True):
            total[material] = total.get(material, 0.0) + float(area)
        return total

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Faces as the surfaces of a `Room`: name, material, area and axis.

        The axis, "x", "y" or "z", is the one to which the face is perpendicular, and None for an
        oblique face.
        """
        axes = [
            AXES[int(np.argmax(np.abs(n)))] if np.abs(n).max() > 1 - 1e-6 else None
            for n in self.normals
        ]
        return tuple(
            Surface(name, material, float(area), axis)
            for name, material, area, axis in zip(
                self.names, self.materials, self.face_areas, axes, strict=True
            )
        )

    @property
    def mean_free_path(self) -> float:
        """Mean free path 4 V / S in a diffuse field in m (Kuttruff 2009, Eq. 5.4)."""
        return float(4 * self.volume / np.sum(self.face_areas))

    def contains(self, points: Any) -> NDArray[np.bool_]:
        """Return whether each point, (n_points, 3) in m, is in the room's air, (n_points,) of bool."""
        return np.asarray(winding_number(_points("points", points), self.triangles) > 0.5)

    def wall_distance(self, points: Any) -> Array:
        """Return the distance of each point from the nearest wall in m, (n_points,)."""
        return distance(_points("points", points), self.triangles)

    def to_text(self) -> str:
        """Return the geometry as text of an OBJ file in m, which `rtcal.io.obj.read` reads."""
        for material in self.materials:
            if not material or material.strip() != material or not material.isprintable():
                raise DataError(
                    f"material {material!r}: a name in an OBJ file must be one line of text "
                    "without blanks at its start or end"
                )
        rows = ["# m; written by rtcal"]
        rows += ["v " + " ".join(repr(float(x)) for x in vertex) for vertex in self.vertices]
        named = any(name != f"face {i}" for i, name in enumerate(self.names, 1))
        last = None
        for name, face, material in zip(self.names, self.faces, self.materials, strict=True):
            if named:
                rows.append(f"g {text_name('face', name)}")
            if material != last:
                rows.append(f"usemtl {material}")
                last = material
            rows.append("f " + " ".join(str(v + 1) for v in face))
        return "\n".join(rows) + "\n"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the geometry to an OBJ file in m; an error leaves no incomplete file."""
        write_text(path, self.to_text())

    def require_inside(self, kind: str, points: Mapping[str, Any]) -> Array:
        """Return points by name as an array (n_points, 3) in m, once all are found to be in the room.

        ``points`` are (x, y, z) in m by name, and ``kind`` is "source" or "receiver", for the message.
        Raises DataError for a point outside the room or within 0.1 mm of a wall.
        """
        if not checks.mapped(f"{kind}s", points):
            raise DataError(f"there is no {kind}; give at least one")
        places = np.array(
            [_points(f'{kind} "{name}"', [point])[0] for name, point in points.items()]
        )
        within = winding_number(places, self.triangles) > 0.5
        inside = within & (distance(places, self.triangles) > WELD)
        for name, place, free in zip(points, places, inside, strict=True):
            if not free:
                raise DataError(
                    f'{kind} "{name}" = {_place(place)} is outside the room: check this '
                    "position, and the size of the room"
                )
        return places

    def positions(
        self, sources: Mapping[str, Any], receivers: Mapping[str, Any]
    ) -> tuple[Array, Array]:
        """Return the positions of sources and receivers in m, (n, 3) each, once they are checked.

        ``sources`` and ``receivers`` are (x, y, z) in m by name. Raises DataError for a position
        outside the room or within 0.1 mm of a wall, and for a source within 1 cm of a receiver, where
        the direct sound would be too strong.
        """
        of_sources = self.require_inside("source", sources)
        of_receivers = self.require_inside("receiver", receivers)
        apart = np.linalg.norm(of_sources[:, np.newaxis] - of_receivers, axis=2)
        for s, r in np.argwhere(apart <= SAME_PLACE)[:1].tolist():
            raise DataError(
                f'source "{[*sources][s]}" and receiver "{[*receivers][r]}" are at the same '
                f"point; move one of them: {_place(of_sources[s])}"
            )
        return of_sources, of_receivers


def _points(place: str, values: Any) -> Array:
    try:
        points = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{place}: {error}; give each point as three numbers in m") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{place} has shape {points.shape}; points must have shape (n, 3)")
    if not np.isfinite(points).all():
        bad = points[~np.isfinite(points).all(axis=1)][0]
        raise DataError(f"{place}: {_place(bad)} must be finite")
    return points


def _place(point: Array) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ") m"


def _volume(vertices: Array, faces: Sequence[Sequence[int]], areas: Array) -> float:
    # Relative to a corner of the room, so that a model far from the origin loses no digits.
    first = np.array([vertices[face[0]] for face in faces]) - vertices[faces[0][0]]
    return float(np.sum(first * areas) / 3)


def _turned_outward(
    vertices: Array, faces: list[tuple[int, ...]], names: Sequence[str], leaks: bool
) -> list[tuple[int, ...]]:
    """Return the faces with normals out of the room's air; DataError if they do not close or leak."""
    if not faces:
        raise DataError("there is no face; a room needs at least 4")
    owners = edge_owners(vertices, faces)
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in faces]
    for (a, b), sides in owners.items():
        if (
            len(sides) % 2 and not leaks
        ):  # four faces meet in an edge of a wall that is an object's edge too
            raise DataError(
                f"the walls do not close: the edge from {_place(vertices[a])} to "
                f'{_place(vertices[b])} of "{names[sides[0][0]]}" belongs to {len(sides)} '
                f"face{'s' if len(sides) > 1 else ''}; in a closed room each edge must belong to "
                "two faces"
            )
        if len(sides) == 2:
            (i, forward_i), (j, forward_j) = sides
            neighbours[i].append((j, forward_i == forward_j))
            neighbours[j].append((i, forward_i == forward_j))
    turned, shells = _shells(neighbours, names)
    faces = [face[::-1] if turn else face for face, turn in zip(faces, turned, strict=True)]
    areas = vector_areas(vertices, faces)
    volumes = []
    for shell in shells:
        open_area = np.linalg.norm(areas[shell].sum(axis=0))
        if open_area > 1e-3 * np.abs(areas[shell]).sum() and not leaks:
            raise DataError(
                f'the walls do not close: "{names[shell[0]]}" and the faces joined to it do not '
                "enclose a volume"
            )
        volumes.append(_volume(vertices, [faces[i] for i in shell], areas[shell]))
    room = int(np.argmax(np.abs(volumes)))
    for k, (shell, volume) in enumerate(zip(shells, volumes, strict=True)):
        if (volume > 0) != (k == room):
            for i in shell:
                faces[i] = faces[i][::-1]
    return faces


def _shells(
    neighbours: list[list[tuple[int, bool]]], names: Sequence[str]
) -> tuple[list[bool], list[list[int]]]:
    """Return whether to reverse each face so that neighbours agree, and each closed surface."""
    turned: list[bool | None] = [None] * len(neighbours)
    shells: list[list[int]] = []
    for first in range(len(neighbours)):
        if turned[first] is not None:
            continue
        turned[first] = False
        shell = [first]
        for i in shell:  # the list grows during the loop
            for j, same_way in neighbours[i]:
                # Neighbours with the same direction along their edge have opposite orientations.
                turn = bool(turned[i]) != same_way
                if turned[j] is None:
                    turned[j] = turn
                    shell.append(j)
                elif turned[j] != turn:
                    raise DataError(
                        f'the walls do not close: "{names[i]}" and "{names[j]}" do not enclose '
                        "the same volume"
                    )
        shells.append(shell)
    return [bool(t) for t in turned], shells


@dataclass(frozen=True, eq=False)
class Plane:
    """Plane of some faces, with two axes in it and the rectangle that bounds the faces.

    ``along`` is one axis, the direction of the longest edge of the faces' outline. ``size`` (2,) has
    the rectangle's sides in m.
    """

    along: Array
    across: Array
    middle: Array
    size: Array

    @classmethod
    def of(cls, geometry: Polyhedron, faces: Sequence[int]) -> Plane:
        """Return the plane of some faces, which is that of the first of them."""
        normal = geometry.normals[faces[0]]
        edges = outline(geometry, faces)
        edges = edges - (edges @ normal)[:, np.newaxis] * normal
        longest = edges[np.argmax(np.linalg.norm(edges, axis=1))]
        along = longest / np.linalg.norm(longest)
        across = np.cross(normal, along)
        corners = np.concatenate([geometry.vertices[list(geometry.faces[i])] for i in faces])
        ends = np.array([[f(corners @ axis) for f in (np.min, np.max)] for axis in (along, across)])
        height = float(corners[0] @ normal) * normal
        middle = ends.mean(axis=1) @ np.array([along, across]) + height
        return cls(along, across, middle, ends[:, 1] - ends[:, 0])

    def half_planes(self, centre: Array, scale: float) -> list[tuple[Array, float]]:
        """Return the rectangle's sides, scaled about a point: x @ normal <= offset."""
        return [
            (sign * axis, float(sign * centre @ axis + scale * side / 2))
            for axis, side in ((self.along, self.size[0]), (self.across, self.size[1]))
            for sign in (1.0, -1.0)
        ]


def outline(geometry: Polyhedron, faces: Sequence[int]) -> Array:
    """Return the edges of the outline of faces, such as of a wall that is drawn as triangles.

    The edges are vectors (n, 3) in m. ``faces`` are the numbers of the faces. The outline has the edges
    that no two of the faces share, or all edges if there is none of these.
    """
    rings = [geometry.faces[i] for i in faces]
    every = [edge for ring in rings for edge in zip(ring, [*ring[1:], ring[0]], strict=True)]
    both = set(every)
    outer = [(a, b) for a, b in every if (b, a) not in both] or every
    start, end = np.array(outer).T
    return np.asarray(geometry.vertices[end] - geometry.vertices[start])


def convex_parts(geometry: Polyhedron, face: int) -> list[Array]:
    """Return convex polygons that make up a face: the face if it is convex, else its triangles."""
    corners = geometry.vertices[list(geometry.faces[face])]
    edges = np.roll(corners, -1, axis=0) - corners
    if (np.cross(edges, np.roll(edges, -1, axis=0)) @ geometry.normals[face] >= 0).all():
        return [corners]
    return list(geometry.triangles[geometry.triangle_faces == face])


WELD = 1e-4
"""Distance in m below which vertices are merged, because mesh files round their coordinates."""

Edge = tuple[int, int]

_NEXT, _LAST = np.array([[1, 2, 0], [2, 0, 1]])
"""Axes of the factors of a vector product."""


def vector_area(polygon: Array) -> Array:
    """Return the area of a plane polygon in m² times its unit normal, (3,).

    ``polygon`` (n, 3) are its vertices p_i in m. The result is ½ sum of p_i x p_(i+1) (Newell). Seen
    from the side to which the normal points, the vertices run counter-clockwise.
    """
    local = polygon - polygon[0]  # near the origin the products lose no digits
    after = np.concatenate((local[1:], local[:1]))
    # np.cross takes as long for one polygon as these lines for ten.
    crossed = local.take(_NEXT, 1) * after.take(_LAST, 1) - local.take(_LAST, 1) * after.take(
        _NEXT, 1
    )
    return np.asarray(0.5 * crossed.sum(axis=0))


def vector_areas(vertices: Array, faces: Sequence[Sequence[int]]) -> Array:
    """Return the area in m² times the unit normal of each face, (n_faces, 3)."""
    sizes = np.array([len(face) for face in faces], dtype=int)
    starts = np.cumsum(sizes) - sizes
    corners = vertices[np.array([v for face in faces for v in face], dtype=int)]
    local = corners - np.repeat(corners[starts], sizes, axis=0)
    after = np.roll(local, -1, axis=0)  # each first corner is 0, as the last one's next
    return np.asarray(0.5 * np.add.reduceat(np.cross(local, after), starts, axis=0))


def triangulate(polygon: Array) -> list[tuple[int, int, int]]:
    """Return triangles that cover a simple plane polygon, as indices of its vertices in its order."""
    normal = vector_area(polygon)
    if len(polygon) == 3:
        return [(0, 1, 2)] if normal.any() else []
    keep = np.delete(np.arange(3), np.argmax(np.abs(normal)))
    flat = polygon[:, keep]
    if vector_area(np.pad(flat, ((0, 0), (0, 1))))[2] < 0:
        flat = flat[:, ::-1]
    tiny = 1e-9 * float(np.abs(normal).max())  # three points on a line
    left = list(range(len(polygon)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        corner = _ear(flat, left, tiny)
        a, b, c = left[corner - 1], left[corner], left[(corner + 1) % len(left)]
        if abs(_turn(flat[a], flat[b], flat[c])) > tiny:
            triangles.append((a, b, c))
        left.pop(corner)
    if abs(_turn(*(flat[i] for i in left))) > tiny:
        triangles.append((left[0], left[1], left[2]))
    return triangles


def _turn(a: Array, b: Array, c: Array) -> float:
    """Return twice the signed area of the triangle: positive for a left turn."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _ear(flat: Array, left: Sequence[int], tiny: float) -> int:
    """Return the position in ``left`` of an ear, else of a straight corner."""
    straight = 0
    for position, corner in enumerate(left):
        before, after = left[position - 1], left[(position + 1) % len(left)]
        a, b, c = flat[before], flat[corner], flat[after]
        turn = _turn(a, b, c)
        if abs(turn) <= tiny:
            straight = position
        if turn <= tiny:
            continue
        others = [flat[i] for i in left if i not in (before, corner, after)]
        if not any(
            _turn(a, b, p) >= -tiny and _turn(b, c, p) >= -tiny and _turn(c, a, p) >= -tiny
            for p in others
        ):
            return position
    return straight


def winding_number(points: Array, triangles: Array) -> Array:
    """Return 1 for points inside a closed surface and 0 for points outside, (n_points,).

    This winding number is the sum of the triangles' solid angles over 4 pi (Van Oosterom & Strackee
    1983, IEEE Trans. Biomed. Eng. 30(2), Eq. 8). ``points`` (n_points, 3), ``triangles`` (n_triangles,
    3, 3).
    """
    corners = triangles[np.newaxis] - points[:, np.newaxis, np.newaxis, :]
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    la, lb, lc = np.linalg.norm([a, b, c], axis=-1)
    volume = np.sum(a * np.cross(b, c), axis=-1)
    denominator = (
        la * lb * lc
        + np.sum(a * b, axis=-1) * lc
        + np.sum(b * c, axis=-1) * la
        + np.sum(c * a, axis=-1) * lb
    )
    return np.asarray(np.sum(np.arctan2(volume, denominator), axis=-1) / (2 * np.pi))


def distance(points: Array, triangles: Array) -> Array:
    """Return the distance of each point from the nearest triangle in m, (n_points,)."""
    return np.asarray(np.min(distances(points, triangles), axis=-1))


def distances(points: Array, triangles: Array) -> Array:
    """Return the distance of each point from each triangle in m, (n_points, n_triangles)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    from_corners = [points[:, np.newaxis] - corner for corner in (a, b, c)]
    height = np.einsum("ptx,tx->pt", from_corners[0], normal)
    inside = np.ones(height.shape, dtype=bool)
    nearest = np.full(height.shape, np.inf)
    for away, edge in zip(from_corners, (b - a, c - b, a - c), strict=True):
        # The foot of the perpendicular is on the same side of the edge as the point itself.
        inside &= np.einsum("ptx,tx->pt", away, np.cross(normal, edge)) >= 0
        share = np.einsum("ptx,tx->pt", away, edge) / np.einsum("tx,tx->t", edge, edge)
        off = away - np.clip(share, 0, 1)[..., np.newaxis] * edge
        nearest = np.minimum(nearest, np.einsum("ptx,ptx->pt", off, off))
    nearest = np.sqrt(nearest)
    return np.asarray(np.where(inside, np.abs(height), nearest))


_PAIRS = 150_000
"""Rays times triangles that are compared at once: they stay in a processor's cache."""


def first_hit(p: Array, v: Array, planes: Array, sides: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the first triangle that each ray hits, and its distance in m, infinite without a hit.

    ``p`` and ``v`` (n_rays, 3) are the origins and directions of the rays. ``planes`` and ``sides`` are
    the planes and side functions of the triangles that `rtcal.simulators.path_tracing.planes_of`
    returns.
    """
    triangle, length = np.empty(len(p), dtype=np.int64), np.empty(len(p))
    step = max(1, _PAIRS // len(planes))
    for begin in range(0, len(p), step):
        part = slice(begin, begin + step)
        origin, along = p[part], v[part]
        approach = -(along @ planes[:, :3].T)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (origin @ planes[:, :3].T - planes[:, 3]) / approach
            met = (approach > 0) & (t >= -1e-9)
            a, b = (
                origin @ sides[:, i, :3].T + t * (along @ sides[:, i, :3].T) - sides[:, i, 3]
                for i in (0, 1)
            )
            met &= (a >= -1e-9) & (b >= -1e-9) & (a <= 1 + 1e-9) & (a + b <= 1 + 1e-9)
        t = np.where(met, t, np.inf)
        triangle[part] = np.argmin(t, axis=1)
        length[part] = t.min(axis=1)
    return triangle, length


def welded(vertices: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices without any two closer than `WELD`, and the new number of each old vertex."""
    index = np.zeros(len(vertices), dtype=np.int64)
    kept: list[int] = []
    is_kept = np.zeros(len(vertices), dtype=bool)
    for i, near in enumerate(_tree(vertices).query_ball_point(vertices, WELD, p=np.inf)):
        before = np.array([k for k in near if is_kept[k]], dtype=np.int64)
        before = before[(np.abs(vertices[before] - vertices[i]) < WELD).all(axis=1)]
        if before.size:
            index[i] = index[before].min()
        else:
            index[i], is_kept[i] = len(kept), True
            kept.append(i)
    return vertices[kept], index


def _tree(points: Array) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(points)


def edge_owners(
    vertices: Array, faces: Sequence[Sequence[int]]
) -> dict[Edge, list[tuple[int, bool]]]:
    """Return the faces at each piece of an edge, and the direction of each face along the piece.

    The key is the piece, as the numbers of its two vertices. Each face is its number, with True if the
    face's outline runs along the piece from the vertex with the lower number. Vertices of ``faces``
    that lie on an edge divide it into pieces. ``vertices`` (n, 3) are in m.
    """
    sides = [(i, face[k - 1], face[k]) for i, face in enumerate(faces) for k in range(len(face))]
    edges = list({(min(a, b), max(a, b)): None for _, a, b in sides})
    if not edges:
        return {}
    used = np.unique(edges)
    ends = vertices[np.array(edges)]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = _tree(vertices[used]).query_ball_point(ends.mean(axis=1), lengths / 2 + WELD)
    divided = {
        edge: [edge[0], *_between(vertices, edge, used[candidates]), edge[1]]
        for edge, candidates in zip(edges, near, strict=True)
    }
    owners: dict[Edge, list[tuple[int, bool]]] = {}
    for i, a, b in sides:
        chain = divided[a, b] if a < b else divided[b, a][::-1]
        for start, end in pairwise(chain):
            owners.setdefault((min(start, end), max(start, end)), []).append((i, start < end))
    return owners


def _between(vertices: Array, edge: Edge, candidates: NDArray[np.int64]) -> list[int]:
    """Return the candidates that lie on an edge between its ends, in order."""
    start, along = vertices[edge[0]], vertices[edge[1]] - vertices[edge[0]]
    length = float(np.linalg.norm(along))
    if len(candidates) < 3 or length <= 2 * WELD:
        return []
    local = vertices[candidates] - start
    position = local @ along / length
    distance = np.linalg.norm(local - position[:, np.newaxis] * along / length, axis=1)
    between = np.flatnonzero((distance < WELD) & (position > WELD) & (position < length - WELD))
    inner: list[int] = candidates[between[np.argsort(position[between])]].tolist()
    return inner


def area(part: Array) -> float:
    """Return the area of a polygon in m², 0 for fewer than three corners."""
    return float(np.linalg.norm(vector_area(part))) if len(part) > 2 else 0.0


def cut(part: Array, normal: Array, offset: float) -> tuple[Array, Array]:
    """Return the two pieces of a convex polygon where x @ normal is below and above an offset in m."""
    height = part @ normal - offset
    height[np.abs(height) < WELD] = 0.0
    below, above = [], []
    for k in range(len(part)):
        here, h, next_, g = part[k], height[k], part[k - len(part) + 1], height[k - len(part) + 1]
        if h <= 0:
            below.append(here)
        if h >= 0:
            above.append(here)
        if h * g < 0:
            crossing = here + h / (h - g) * (next_ - here)
            below.append(crossing)
            above.append(crossing)
    return np.array(below).reshape(-1, 3), np.array(above).reshape(-1, 3)


def cut_face(geometry: Polyhedron, face: int, edges: Sequence[tuple[Array, float]]) -> list[Array]:
    """Return the pieces into which lines cut a face, each with its vertices (n, 3) in m.

    ``face`` is the number of the face. Each of ``edges`` is a line (direction, offset), on which points
    x have x @ direction equal to the offset in m. Pieces are convex. Without any line the face is the
    only piece, and need not be convex.
    """
    if not edges:
        return [geometry.vertices[list(geometry.faces[face])]]
    pieces = convex_parts(geometry, face)
    for along, offset in edges:
        # What lies in the edge's own plane is on one side of it.
        both = [
            piece
            for whole in pieces
            for piece in (cut(whole, along, offset) if np.ptp(whole @ along) > WELD else [whole])
        ]
        pieces = [piece for piece in both if is_face(piece)]
    return pieces


def divided(part: Array, sides: Sequence[tuple[Array, float]]) -> tuple[Array, list[Array]]:
    """Return the piece of a convex polygon within all sides, and the pieces beyond each side."""
    outside = []
    for normal, offset in sides:
        part, beyond = cut(part, normal, offset)
        if is_face(beyond):
            outside.append(beyond)
    return part, outside


def inside(part: Array, sides: Sequence[tuple[Array, float]]) -> Array:
    """Return the piece of a convex polygon within all sides."""
    return divided(part, sides)[0]


def is_face(piece: Array) -> bool:
    """Return whether a piece is wider than `WELD`, below which corners are merged."""
    if len(piece) < 3:
        return False
    length = float(np.linalg.norm(np.roll(piece, -1, axis=0) - piece, axis=1).max())
    return area(piece) > 0.5 * WELD * length


def distance_in_plane(point: Array, normal: Array, parts: Sequence[Array]) -> float:
    """Return the distance in m of a point from the nearest of some convex polygons in one plane."""
    return min(_distance_of(point, normal, part) for part in parts)


def _distance_of(point: Array, normal: Array, part: Array) -> float:
    flat = point - ((point - part[0]) @ normal) * normal
    edges = np.roll(part, -1, axis=0) - part
    if (np.cross(edges, flat - part) @ normal >= 0).all():
        return float(np.linalg.norm(point - flat))
    share = np.sum((point - part) * edges, axis=1) / np.maximum(np.sum(edges**2, axis=1), 1e-30)
    nearest = part + np.clip(share, 0.0, 1.0)[:, np.newaxis] * edges
    return float(np.linalg.norm(point - nearest, axis=1).min())
