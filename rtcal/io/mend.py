"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge; a
   hole across an edge or a corner of the room is closed in each of its two or three planes;
4. a face on a larger one (a window on its wall, up to `OFFSET` before it) takes its area;
5. corners of an object near a wall are moved onto it, up to `OFFSET` from its open bottom and up to
   ``weld`` from a face;
6. the room is the largest space between all faces, as thin plates, by manifold3d. What faces it counts:
   not what lies outside, not the part of an object behind a wall, and neither of two faces that touch.
   A panel that has the room on both sides becomes a reflector, `THICKNESS` thick.

Each is a `Defect` with its number, area and effects on V and S. What cannot be mended safely is
refused, and the message says how to mend it in the program that drew it, with all other defects.

Walls that are drawn as closed solids, as building models do, bound material: the room is the largest
space outside all solids. The volume of a room whose faces do not close is taken by lines that cross
what is drawn, in three directions: between its first and second crossing, its third and fourth, a line
is in the room. One with an odd number went through a hole, and takes the mean of its neighbours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import combinations, compress, pairwise, product
from operator import add
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rtcal.io import budget
from rtcal.simulators.geometry import (
    PLANARITY,
    Edge,
    Polyhedron,
    edge_owners,
    triangulate,
    vector_area,
    vector_areas,
    winding_number,
)
from rtcal.simulators.geometry import WELD as FINE
from rtcal.simulators.geometry import area as area_of
from rtcal.simulators.geometry import welded as weld_vertices
from rtcal.support import library
from rtcal.support.errors import DataError, RtcalError
from rtcal.support.text import listed, rounded
from rtcal.support.types import Array

__all__ = ["WELD", "Defect", "Faces", "Mended", "MeshError", "mended"]
__dir__ = __all__.copy


WELD = 0.01
"""Default distance in m within which corners become one: models are drawn to the centimetre."""
OFFSET = 0.05
"""Default distance in m within which a face counts as lying on another: the depth of a window's
frame."""
MOST_FACES = 6000
MOST_PLACES = 5
SAME = 1e-6
"""Distance in m, and area in m², below which two are the same."""
ANY_SHARE = 1 / np.sqrt(3)
"""Of an area of which any share may count, all shares alike: rms of what is missing or too much."""
_SHOWN = 1e-6  # Smallest effect in m³ and m² that is printed: smaller ones are rounding


class Face(NamedTuple):
    """A face: the numbers of its corners, its material and its name."""

    corners: list[int]
    material: str
    name: str


@dataclass(frozen=True)
class Faces:
    """Hold the faces of a mesh as they are drawn.

    ``polygons`` has the corners (n, 3) in m of each face, ``materials`` its material and ``names`` its
    name. ``path`` is the file's name, and ``notes`` say how the file was read. ``unit`` is the length
    of the file's unit in m; None if it is not known.
    """

    path: str
    polygons: Sequence[Array]
    materials: Sequence[str]
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    unit: float | None = None


@dataclass(frozen=True)
class Defect:
    """Hold one kind of defect of a mesh and its repair, in words.

    ``number`` is how often the defect was found, ``places`` are names or corners of the first few, and
    ``area`` is the area of their faces in m². The repair changed the room's volume by ``volume_effect``
    in m³ and its surface by ``area_effect`` in m². ``volume_uncertainty`` in m³ and
    ``area_uncertainty`` in m², by material, are the standard uncertainties that remain.
    """

    kind: str
    number: int
    area: float
    volume_effect: float
    area_effect: float
    volume_uncertainty: float
    places: tuple[str, ...]
    done: str
    area_uncertainty: Mapping[str, float] = field(default_factory=dict)

    def __add__(self, other: Defect) -> Defect:
        """Return defects of one kind as one."""
        volume = self.volume_effect + other.volume_effect
        u = float(np.hypot(self.volume_uncertainty, other.volume_uncertainty))
        if self.kind == "overlay":  # any share of it is meant
            u = float(ANY_SHARE * abs(volume))
        return replace(
            self,
            number=self.number + other.number,
            area=self.area + other.area,
            volume_effect=volume,
            area_effect=self.area_effect + other.area_effect,
            volume_uncertainty=u,
            places=(*self.places, *other.places)[:MOST_PLACES],
            area_uncertainty=combined(
                (*self.area_uncertainty.items(), *other.area_uncertainty.items())
            ),
        )

    def __str__(self) -> str:
        """Return the defect as one line."""
        parts = [f"{self.number} {self.done}", *[f"{rounded(self.area, 3)} m²"] * bool(self.area)]
        for symbol, value, unit in (("V", self.volume_effect, "m³"), ("S", self.area_effect, "m²")):
            if abs(value) > _SHOWN:
                parts.append(f"{symbol} {'-' if value < 0 else '+'}{rounded(abs(value), 3)} {unit}")
        if self.volume_uncertainty > _SHOWN:
            parts.append(f"u(V) {rounded(self.volume_uncertainty, 2)} m³")
        unsure = {name: u for name, u in self.area_uncertainty.items() if u > _SHOWN}
        each = [
            f"{rounded(u, 2)} m²{f' of {name}' * (len(unsure) > 1)}" for name, u in unsure.items()
        ]
        parts += [f"u(S) {listed(each)}"] if each else []
        more = ", ..." if self.number > len(self.places) else ""
        at = f" ({', '.join(self.places)}{more})" if self.places else ""
        return f"{self.kind}: {', '.join(parts)}{at}"


@dataclass(frozen=True)
class Mended:
    """Hold the geometry of a room that was read from a mesh, and the defects that were repaired.

    ``volume`` is in m³, and ``areas`` are in m² by material. If the walls do not close, ``geometry`` is
    None, the volume is estimated with rays, and the areas are those of all faces as drawn. ``size`` has
    the lengths in m of the box around the room, along x, y and z.

    ``volume_uncertainty`` is the standard uncertainty of the volume in m³. ``defects`` are the faults
    of the mesh, and ``notes`` are cautions, one sentence each.
    """

    geometry: Polyhedron | None
    volume: float
    volume_uncertainty: float
    areas: Mapping[str, float]
    size: tuple[float, ...]
    defects: tuple[Defect, ...]
    notes: tuple[str, ...] = ()

    @property
    def area_uncertainty(self) -> dict[str, float]:
        """Standard uncertainty in m² of the areas that repairs made uncertain, by material."""
        return combined(each for d in self.defects for each in d.area_uncertainty.items())

    def __str__(self) -> str:
        """Return V, S, the areas of the materials, and each defect."""
        total, u = f"S = {sum(self.areas.values()):.6g} m²", self.volume_uncertainty
        spread = f" ± {rounded(u, 2)}"
        head = f"V = {rounded(self.volume, 4)}{spread} m³ estimated with rays, {total} as drawn"
        head += ", not closed"
        if self.geometry is not None:
            head = f"V = {self.volume:.6g}{spread * (u > _SHOWN)} m³, {total}"
            head += f", {len(self.geometry.faces)} faces"
        head += f", x × y × z = {' × '.join(rounded(x, 3) for x in self.size)} m"
        rows = [f"{area:10.3f} m²  {name}" for name, area in self.areas.items()]
        found = ["Defects:", *(f"  {defect}" for defect in self.defects)]
        return "\n".join([head, *rows, *(found if self.defects else ["Defects: none"])])


class MeshError(DataError):
    """Report a mesh that cannot be made a closed room.

    ``reason`` is why. ``defects`` are all defects that were found, and ``edges`` (n, 2, 3) are the open
    edges in m. If there are walls around the room, ``unclosed`` is the room as it is drawn, with an
    estimated volume. If, moreover, all faces are plane, ``leaking`` is its geometry with the holes.
    """

    reason = ""
    defects: tuple[Defect, ...] = ()
    edges: Array = np.zeros((0, 2, 3))
    unclosed: Mended | None = None
    leaking: Polyhedron | None = None


def combined(parts: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the root of the sum of squares by name, without zeros."""
    total: dict[str, float] = {}
    for name, part in parts:
        total[name] = float(np.hypot(total.get(name, 0.0), part))
    return {name: u for name, u in total.items() if u > 0}


_DONE = {
    "bent": "faces that are not plane are divided into triangles",
    "hole": "holes are closed with their neighbour's material",
    "twice": "faces drawn twice are taken once",
    "object": "closed objects stand by themselves",
    "overlay": "faces on a larger one take its area",
    "open bottom": "objects with an open bottom stand on a face, and take its area",
    "panel": "free panels are reflectors with two sides",
    "outside": "components outside the room are left out",
    "partly outside": "components that reach through a wall are left out; their areas, and whether "
    "the room has them, are uncertain",
    "through": "objects that reach through a wall end there",
    "gap": "faces of closed objects are in front of a wall, and both areas are counted; use --weld as "
    "given if they touch",
    "contact": "faces of closed objects touch others: the room has neither there",
}
_LOOSE = "components hang free, or are walls that do not meet the others"


class Mending:
    """Hold a mesh while it is repaired.

    ``drawn`` are its faces, ``weld`` and ``largest_hole`` the options in m and m². ``points`` (n, 3)
    are the corners in m. ``repeated`` are faces that are drawn twice, with the material of the one that
    is kept.
    """

    def __init__(
        self,
        drawn: Faces,
        weld: float,
        largest_hole: float | None = None,
        *,
        is_trial: bool = False,
    ) -> None:
        self.drawn, self.path = drawn, drawn.path
        self.weld, self.largest_hole = weld, largest_hole
        self.is_trial, self.bent_rim = is_trial, ""
        self.points: Array = np.zeros((0, 3))
        self.repeated = list[tuple[Face, str]]()
        self._found: dict[tuple[str, str], Defect] = {}

    @property
    def defects(self) -> tuple[Defect, ...]:
        """What was found, each kind once."""
        return tuple(self._found.values())

    def found(
        self,
        kind: str,
        places: Sequence[str],
        area: float = 0.0,
        volume: float = 0.0,
        surface: float = 0.0,
        *,
        uncertainty: float = 0.0,
        unsure: Iterable[tuple[str, float]] = (),
        done: str = "",
    ) -> None:
        """Note defects of one ``kind`` at the given ``places``.

        ``area``, and the change of the room's ``surface``, are in m², that of its ``volume`` in m³;
        then the standard ``uncertainty`` of the volume, and by material that of the area (``unsure``).
        """
        done, u, places = done or _DONE[kind], combined(unsure), tuple(places)
        none = self._found.get((kind, done)) or Defect(kind, 0, 0.0, 0.0, 0.0, 0.0, (), done)
        this = Defect(kind, len(places), area, volume, surface, uncertainty, places, done, u)
        self._found[kind, done] = none + this

    def refused(self, message: str, edges: Iterable[Edge] = ()) -> MeshError:
        """Return the error that says what is wrong; all defects that were found are in it, too."""
        found = self.defects
        others = f". Found, too: {'; '.join(map(str, found))}" if found else ""
        error = MeshError(f"{self.path}: {message}{others}")
        error.reason, error.defects = message, found
        error.edges = self.points[np.array([*edges], dtype=int).reshape(-1, 2)]
        return error

    def new_points(self, corners: Array) -> list[int]:
        """Add corners (n, 3) in m, and return their numbers."""
        first = len(self.points)
        self.points = np.concatenate([self.points, corners])
        return [*range(first, len(self.points))]

    def place(self, corner: int) -> str:
        """Return a corner's coordinates in words."""
        return "(" + ", ".join(f"{x:.4g}" for x in self.points[corner]) + ") m"

    def result(self, geometry: Polyhedron) -> Mended:
        """Return the closed room with what was found."""
        defects = self.defects
        u = float(np.sqrt(sum(d.volume_uncertainty**2 for d in defects)))
        size = tuple(np.ptp(geometry.triangles, axis=(0, 1)).tolist())
        return Mended(
            geometry, float(geometry.volume), u, geometry.areas, size, defects, self.drawn.notes
        )


class Polygon:
    """A plane polygon of ``corners``, (n, 3) in m, and shapes in the two ``axes`` of its plane."""

    def __init__(self, corners: Array) -> None:
        self.corners, self.normal = corners, normal_of(corners)
        self._middle = corners.mean(axis=0)

    @cached_property
    def axes(self) -> Array:
        """Two unit vectors of the plane, (2, 3)."""
        other = np.eye(3)[int(np.argmin(np.abs(self.normal)))]
        first = np.cross(self.normal, other)
        first /= np.linalg.norm(first)
        return np.array([first, np.cross(self.normal, first)])

    @cached_property
    def shape(self) -> Any:
        """The polygon itself as a shape in the axes."""
        return self.polygon(self.corners)

    def away(self, points: Array) -> Array:
        """Return the distance in m of points (..., 3) from the plane, above 0 along the normal."""
        return np.asarray((points - self._middle) @ self.normal)

    def thickness(self, points: Array) -> float:
        """Return the largest distance in m of points from the plane."""
        return float(np.abs(self.away(points)).max())

    def polygon(self, corners: Array) -> Any:
        """Return corners (n, 3) as a shape in the axes, made valid."""
        polygon = shapely().Polygon(corners @ self.axes.T)
        return polygon if polygon.is_valid else polygon.buffer(0)

    def common(self, corners: Array) -> Any:
        """Return the part that another polygon of these corners shares with this one, as a shape."""
        return self.polygon(corners).intersection(self.shape)

    def lifted(self, flat: Array) -> Array:
        """Return points of the axes, (n, 2), in space; those on the polygon's edge as it is drawn."""
        base = self.corners
        lifted = np.asarray(flat @ self.axes + self.normal * float(self._middle @ self.normal))
        for k in range(len(base)):
            start, along = self.axes @ base[k - 1], self.axes @ (base[k] - base[k - 1])
            share = np.clip((flat - start) @ along / (along @ along), 0, 1)
            away = np.linalg.norm(flat - start - share[:, np.newaxis] * along, axis=1)
            on_edge = away < 1e-5
            lifted[on_edge] = base[k - 1] + share[on_edge, np.newaxis] * (base[k] - base[k - 1])
        return lifted


class FaceSet:
    """Some faces of a mesh that is repaired."""

    def __init__(self, mend: Mending, faces: Iterable[Face] = ()) -> None:
        self.mend, self.faces = mend, [*faces]

    def kept(self, which: Any) -> FaceSet:
        """Return the faces that are to be kept."""
        return FaceSet(self.mend, compress(self.faces, which))

    @property
    def loops(self) -> list[list[int]]:
        """The numbers of the corners of each face."""
        return [face.corners for face in self.faces]

    @property
    def materials(self) -> list[str]:
        """The material of each face."""
        return [face.material for face in self.faces]

    @property
    def names(self) -> list[str]:
        """The name of each face."""
        return [face.name for face in self.faces]

    @property
    def polygons(self) -> list[Array]:
        """The corners of each face in m, (n, 3)."""
        return [self.mend.points[corners] for corners in self.loops]

    @property
    def areas(self) -> Array:
        """The area of each face in m², (n,)."""
        return np.asarray(np.linalg.norm(vector_areas(self.mend.points, self.loops), axis=1))

    @property
    def size(self) -> float:
        """The area in m²."""
        return float(self.areas.sum())

    @property
    def corners(self) -> list[int]:
        """The numbers of all corners, each once."""
        return sorted({v for corners in self.loops for v in corners})

    @property
    def points(self) -> Array:
        """All corners in m, each once, (n, 3)."""
        return np.asarray(self.mend.points[self.corners])

    @property
    def is_plane(self) -> bool:
        """Whether all corners are near one plane: a sheet."""
        return best_plane(self.points)[1] <= self.mend.weld

    def owners(self) -> dict[Edge, list[int]]:
        """Return the numbers of the faces that meet at each edge, divided at all corners on it."""
        owners = edge_owners(self.mend.points, self.loops)
        return {edge: [i for i, _ in sides] for edge, sides in owners.items()}

    def open_edges(self) -> dict[Edge, int]:
        """Return the edges, divided at all corners, of an odd number of faces, and one face of each."""
        return {e: sides[0] for e, sides in self.owners().items() if len(sides) % 2}

    def components(self) -> list[FaceSet]:
        """Return the faces of each component: faces are joined where two meet in an edge."""
        n = len(self.faces)
        pairs = np.array([s for s in self.owners().values() if len(s) == 2], dtype=int)
        links = coo_array((np.ones(len(pairs)), pairs.reshape(-1, 2).T), shape=(n, n))
        number, label = connected_components(links, directed=False)
        return [self.kept(label == k) for k in range(number)]

    def polyhedron(self) -> Polyhedron:
        """Return the closed room of the faces; DataError if they do not close."""
        named = zip(numbered(self.names), self.materials, self.polygons, strict=True)
        return Polyhedron.from_polygons(list(named))


def numbered(names: Sequence[str]) -> list[str]:
    """Return the names with numbers that make them unique: "wall", "wall 2" and so on."""
    count: dict[str, int] = {}
    taken = set(names)
    unique = []
    for name in names:
        count[name] = count.get(name, 0) + 1
        new = name
        while count[name] > 1 and new in taken:
            new = f"{name} {count[name]}"
            count[name] += new in taken
        taken.add(new)
        unique.append(new)
    return unique


def normal_of(corners: Array) -> Array:
    """Return the unit normal of a polygon; that of a point is upward."""
    area = vector_area(corners)
    size = float(np.linalg.norm(area))
    return np.asarray(area / size if size else np.array([0.0, 0.0, 1.0]))


def best_plane(corners: Array) -> tuple[Array, float]:
    """Return the normal of the plane that fits some points best, and their largest distance from it."""
    away = corners - corners.mean(axis=0)
    normal = np.linalg.svd(away, full_matrices=False)[2][-1]
    return np.asarray(normal), float(np.abs(away @ normal).max())


def extent_of(corners: Array) -> float:
    """Return the largest distance of two corners in m."""
    return float(np.linalg.norm(corners[:, np.newaxis] - corners[np.newaxis], axis=-1).max())


def polygons_of(shape: Any, least: float = 0.0) -> list[Any]:
    """Return the polygons of a shape above an area, without points and lines at which shapes touch."""
    parts = getattr(shape, "geoms", [shape])
    return [p for p in parts if p.geom_type == "Polygon" and p.area > least]


def ring_of(shape: Any) -> Array:
    """Return the corners of a shape's boundary, (n, 2)."""
    return np.array(getattr(shape, "exterior", shape).coords)[:-1]


def shapely() -> Any:
    """Return the library; MissingDependencyError without it."""
    return library("a face is to be cut, which needs shapely: pip install 'rtcal[mesh]'", "shapely")


def edges_of(face: Sequence[int]) -> list[Edge]:
    """Return the edges of a face, each with its lower corner first."""
    return [(a, b) if a < b else (b, a) for a, b in zip([face[-1], *face[:-1]], face, strict=True)]


def simplified(corners: list[int]) -> list[int]:
    """Return a face's corners without repeated ones and without spikes a, b, a."""
    k = 0
    while k < len(corners) > 2:
        if corners[k - 1] in (corners[k], corners[(k + 1) % len(corners)]):
            del corners[k]
            k = -1
        k += 1
    return corners


def loops_of(edges: Iterable[Edge]) -> list[list[int]]:
    """Return the loops of some edges, each the shortest through an edge.

    The edges of an odd number of some faces have loops alone: an even number of them meets in a corner.
    """
    neighbours: dict[int, set[int]] = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)

    def remove(loop_edges: Iterable[Edge]) -> None:
        for a, b in loop_edges:
            neighbours[a].discard(b)
            neighbours[b].discard(a)

    loops: list[list[int]] = []
    for first in sorted(neighbours):
        while neighbours[first]:
            second = min(neighbours[first])
            remove([(first, second)])
            before, queue = {second: second}, [second]
            for here in queue:  # the list grows during the loop
                new = sorted(n for n in neighbours[here] if n not in before)
                before |= dict.fromkeys(new, here)
                queue += new
                if first in new:
                    break
            loop = [first]
            while loop[-1] != second:
                loop.append(before[loop[-1]])
            loops.append(loop)
            remove(edges_of(loop))
    return loops


# -- faces that nearly meet


def welded(mend: Mending) -> FaceSet:
    """Return the faces with corners within ``weld`` of each other as one."""
    polygons = [np.asarray(p, dtype=float) for p in mend.drawn.polygons]
    drawn = np.concatenate(polygons)
    if not np.isfinite(drawn).all():
        raise DataError(
            f"{mend.path}: a corner has a coordinate that is not finite; export the mesh again"
        )
    _, first, of_drawn = np.unique(drawn, axis=0, return_index=True, return_inverse=True)
    label, number = np.full(len(first), -1), 0
    near = cKDTree(drawn[first]).query_ball_point(drawn[first], mend.weld)
    for i in np.argsort(first).tolist():  # as they are drawn
        if label[i] < 0:
            label[[k for k in near[i] if label[k] < 0]] = number
            number += 1
    order = label[of_drawn.ravel()]
    mend.points = np.zeros((number, 3))
    np.add.at(mend.points, label, drawn[first])
    mend.points /= np.bincount(label)[:, np.newaxis]
    shifts = np.linalg.norm(mend.points[order] - drawn, axis=1)
    ends = np.cumsum([len(p) for p in polygons])
    corners = (each.tolist() for each in np.split(order, ends[:-1]))
    part = FaceSet(mend, map(Face, corners, mend.drawn.materials, mend.drawn.names))
    moved = np.unique(order[shifts > 1e-4]).tolist()
    if moved:
        own = np.array([area_of(p) for p in polygons])
        off = np.array([each.mean() for each in np.split(shifts, ends[:-1])])
        # A corner moves the area by half of its neighbours' distance; none is drawn better than others.
        across = [
            np.linalg.norm(np.roll(p, 1, axis=0) - np.roll(p, -1, axis=0)) / 2 for p in polygons
        ]
        each = float(np.sqrt(np.mean(shifts**2)))
        mend.found(
            "joint",
            [mend.place(k) for k in moved],
            done=f"corners that lay up to {2 * shifts.max() * 1000:.2g} mm apart are joined",
            uncertainty=float(np.linalg.norm(own * off)),
            unsure=[(m, each * float(a)) for m, a in zip(part.materials, across, strict=True)],
        )
    return cleaned(part)


def cleaned(part: FaceSet) -> FaceSet:
    """Return the faces without repeated corners, and without slivers."""
    mend = part.mend
    part = FaceSet(mend, [f._replace(corners=simplified(f.corners)) for f in part.faces])
    sizes, counts = part.areas, np.array([len(corners) for corners in part.loops])
    corners, starts = mend.points[np.concatenate(part.loops)], np.cumsum(counts) - counts
    low, high = (f.reduceat(corners, starts, axis=0) for f in (np.minimum, np.maximum))
    narrow = (counts < 3) | (sizes < mend.weld * np.linalg.norm(high - low, axis=1) / 2)
    slivers, areas = part.kept(narrow), sizes[narrow].tolist()
    if slivers.faces:
        mend.found(
            "sliver",
            slivers.names,
            sum(areas),
            surface=-sum(areas),
            done=f"faces narrower than {mend.weld * 1000:g} mm are dropped",
            unsure=[(m, ANY_SHARE * a) for m, a in zip(slivers.materials, areas, strict=True)],
        )
    if narrow.all():
        across = np.linalg.norm(np.ptp(np.concatenate(list(mend.drawn.polygons)), axis=0))
        raise mend.refused(
            f"every face is narrower than the weld distance of {mend.weld * 1000:g} mm: as read, "
            f"the mesh is {across * 1000:.2g} mm across. Give a larger --unit, such as 1 for a "
            "mesh drawn in m, or a smaller --weld"
        )
    return part.kept(~narrow)


def without_repetitions(part: FaceSet) -> FaceSet:
    """Return the faces without those that are drawn a second time, which are kept for a note."""
    first: dict[frozenset[int], Face] = {}
    for face in part.faces:
        if first.setdefault(frozenset(face.corners), face) is not face:
            part.mend.repeated.append((face, first[frozenset(face.corners)].material))
    return FaceSet(part.mend, first.values())


def note_repetitions(mend: Mending, unseen: Collection[frozenset[int]] = ()) -> None:
    """Note the faces that are drawn again; ``unseen`` faces, which two objects share, are contacts."""
    for (corners, own, name), other in mend.repeated:
        area = area_of(mend.points[corners])
        if frozenset(corners) in unseen:
            mend.found("contact", [f'"{name}" on another'], area, 0.0, -2 * area)
            continue
        # Of two materials either may be the one that is meant.
        unsure = [(m, area / np.sqrt(2)) for m in (own, other) if own != other]
        name += f", {own} on {other}" if own != other else ""
        mend.found("twice", [name], area, 0.0, -area, unsure=unsure)


def _snapped(part: FaceSet) -> FaceSet:
    """Return the faces, with corners that are near an edge moved onto this edge."""
    mend, before = part.mend, part.areas
    edges = np.array(sorted({edge for corners in part.loops for edge in edges_of(corners)}))
    moved: dict[int, float] = {}
    for _ in range(4):
        ends = mend.points[edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        near = cKDTree(mend.points).query_ball_point(ends.mean(axis=1), lengths / 2 + mend.weld)
        nearest: dict[int, tuple[float, Array]] = {}
        for (start, end), length, corners in zip(ends, lengths, near, strict=True):
            if len(corners) < 3 or length <= 2 * mend.weld:
                continue
            points, along = mend.points[corners], (end - start) / length
            position = (points - start) @ along
            feet = start + position[:, np.newaxis] * along
            distance = np.linalg.norm(points - feet, axis=1)
            beside = (distance > SAME) & (distance <= mend.weld)
            beside &= (mend.weld < position) & (position < length - mend.weld)
            for k in np.flatnonzero(beside).tolist():
                if distance[k] < nearest.get(corners[k], (np.inf,))[0]:
                    nearest[corners[k]] = float(distance[k]), feet[k]
        for v, (off, foot) in nearest.items():
            mend.points[v], moved[v] = foot, max(moved.get(v, 0.0), off)
    if moved:
        shifts = [float(np.mean([moved.get(v, 0.0) for v in corners])) for corners in part.loops]
        changes = np.subtract(before, part.areas).tolist()
        mend.found(
            "joint",
            [mend.place(v) for v in moved],
            done=f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
            uncertainty=float(np.linalg.norm(np.multiply(before, shifts))),
            unsure=zip(part.materials, changes, strict=True),
        )
    return cleaned(part)


def _joined(part: FaceSet) -> FaceSet:
    """Return the faces of a mesh of triangles, with neighbours in one plane joined to one polygon."""
    mend, points, faces = part.mend, part.mend.points, part.faces
    if len(faces) < 8 or not all(len(face.corners) == 3 for face in faces):
        return part
    sides: dict[Edge, list[int]] = {}
    for i, face in enumerate(faces):
        for edge in edges_of(face.corners):
            sides.setdefault(edge, []).append(i)
    is_done = [False] * len(faces)
    out = FaceSet(mend)
    for first in np.argsort(-part.areas, kind="stable").tolist():
        if is_done[first]:
            continue
        is_done[first] = True
        members, plane = [first], Polygon(points[faces[first].corners])
        for i in members:  # the list grows during the loop
            for j in (
                k for e in edges_of(faces[i].corners) if len(sides[e]) == 2 for k in sides[e]
            ):
                is_alike = not is_done[j] and faces[j].material == faces[first].material
                if is_alike and plane.thickness(points[faces[j].corners]) < PLANARITY * 0.45:
                    is_done[j] = True
                    members.append(j)
        loops = outlined(mend, [faces[i].corners for i in members])
        out.faces += [faces[first]._replace(corners=loop) for loop in loops]
    return out


def outlined(mend: Mending, faces: list[list[int]]) -> list[list[int]]:
    """Return faces of one plane as one polygon; unchanged if it has a hole or several parts."""
    if len(faces) == 1:
        return faces
    count = Counter(edge for corners in faces for edge in edges_of(corners))
    loops = loops_of(edge for edge, n in count.items() if n % 2)
    if len(loops) != 1:
        return faces
    (loop,) = loops
    corners = mend.points[loop]
    # T-junctions find corners on a straight line by themselves.
    a, b = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    bent = np.linalg.norm(np.cross(a, b), axis=1)
    bent = bent > 1e-5 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return [np.array(loop)[bent].tolist() if bent.sum() > 2 else loop]


def flattened(part: FaceSet) -> FaceSet:
    """Return the faces with those that are not plane divided into triangles."""
    mend, out = part.mend, FaceSet(part.mend)
    for face in part.faces:
        corners = mend.points[face.corners]
        off = Polygon(corners).thickness(corners)
        if off <= PLANARITY * 0.9:
            out.faces.append(face)
            continue
        pieces = [[face.corners[k] for k in piece] for piece in triangulate(corners)]
        out.faces += [face._replace(corners=piece) for piece in pieces]
        if off > mend.weld:  # else it is a joint's, noted already
            area, folded = area_of(corners), sum(area_of(mend.points[piece]) for piece in pieces)
            mend.found("bent", [face.name], area, unsure=[(face.material, folded - area)])
    return out


# -- the shell, and its holes

_HOLE_SHARE = 0.01  # Largest area of a hole that is closed, over the area of the shell
_NEAR = 0.2  # Distance in m within which a hole's edge and another face are meant to meet
_LOOPS = (
    "close the hole with a face, or delete the faces at its edge if they are not part of the room"
)


def _shell_of(part: FaceSet) -> tuple[FaceSet, list[FaceSet]]:
    """Return the shell of a room, which may have holes, and the other components of the mesh.

    The shell is the component with the largest box around it that is not flat, and any single face that
    fills a hole between this component and an object.
    """
    mend = part.mend
    parts = part.components()
    points = [p.points for p in parts]
    boxes = [float(np.prod(np.sort(np.ptp(p, axis=0))[1:])) for p in points]
    solid = [i for i, p in enumerate(points) if best_plane(p)[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused(
            "the faces do not enclose a volume: draw the walls, the floor and the ceiling"
        )
    main = max(solid, key=lambda i: (round(boxes[i], 3), parts[i].size))
    shell, others = parts[main], [p for i, p in enumerate(parts) if i != main]
    missing = {*shell.open_edges()}
    own = [p for p in others if len(p.faces) == 1 and missing and {*p.open_edges()} <= missing]
    shell.faces += [p.faces[0] for p in own]
    return shell, [p for p in others if p not in own]


def without_holes(part: FaceSet, others: Sequence[FaceSet]) -> FaceSet:
    """Return the shell with its small holes closed; MeshError for a large one."""
    mend, missing, holes = part.mend, part.open_edges(), _holes(part)
    largest = _HOLE_SHARE * part.size if mend.largest_hole is None else mend.largest_hole
    large = sorted((h for h in holes if h.area > largest), key=lambda h: -h.area)
    if large:
        _note_others(part, others)
        each = "; ".join(
            f"hole of {rounded(hole.area, 3)} m² at {mend.place(hole.loop[0])}, beside "
            f'"{part.faces[missing[edges_of(hole.loop[:2])[0]]].name}"'
            for hole in large[:MOST_PLACES]
        )
        more = f" ({len(large)} holes in all)" if len(large) > MOST_PLACES else ""
        raise mend.refused(
            f"{each}{more}; only holes up to {rounded(largest, 3)} m² are closed automatically. "
            f"{_hint(part, large[0], others)}",
            missing,
        )
    for hole in holes:
        at, u = [f"at {mend.place(hole.loop[0])}, {hole.beside}"], hole.area**1.5 / 4
        unsure = hole.unsure.items()
        mend.found("hole", at, hole.area, surface=hole.area, uncertainty=u, unsure=unsure)
        if len(hole.lids) == 1 and _is_bent(part, hole.loop):
            mend.bent_rim = mend.place(hole.loop[0])
        apex = mend.new_points(hole.apex)
        part.faces += [Face(lid.corners + apex, lid.material, "closed hole") for lid in hole.lids]
    return flattened(part) if holes else part


def _is_bent(part: FaceSet, rim: list[int]) -> bool:
    """Return whether the corners of a hole's rim are in no plane."""
    return best_plane(part.mend.points[rim])[1] > max(part.mend.weld, PLANARITY)


class _Lid(NamedTuple):
    """A face that closes a hole: corners at its rim, material and area in m²."""

    corners: list[int]
    material: str
    area: float


class _Hole(NamedTuple):
    """A hole: its rim, the faces that close it, and a corner that they share, (0 or 1, 3) in m."""

    loop: list[int]
    lids: list[_Lid]
    apex: Array

    @property
    def area(self) -> float:
        """Area in m² of the lids."""
        return sum(lid.area for lid in self.lids)

    @property
    def beside(self) -> str:
        """The materials beside the hole."""
        return " and ".join(dict.fromkeys(lid.material for lid in self.lids))

    @property
    def unsure(self) -> dict[str, float]:
        """Standard uncertainty in m² by material: any share of the hole, one for all, is of it."""
        areas = dict.fromkeys((lid.material for lid in self.lids), 0.0)
        for lid in self.lids:
            areas[lid.material] += float(ANY_SHARE * lid.area)
        return areas


_MOST_FOLDS = 24
"""Largest number of corners in two planes of which two or three are sought that divide a rim."""


def _holes(part: FaceSet) -> list[_Hole]:
    """Return the holes of a shell."""
    missing = part.open_edges()
    return [_hole(part, missing, loop) for loop in loops_of(missing)]


def _hole(part: FaceSet, missing: Mapping[Edge, int], loop: list[int]) -> _Hole:
    """Return a hole with the faces that close it.

    A rim in two planes of its neighbours has a face in each, and one in three has three, which meet in
    the corner of these planes. Any other rim, such as a plane one, has one face.
    """
    points, n, none = part.mend.points, len(loop), np.zeros((0, 3))
    rim, tolerance = points[loop], max(part.mend.weld, PLANARITY)

    def closed(runs: Sequence[Sequence[int]], apex: Array) -> _Hole:
        lids = []
        for run in runs:
            corners = [loop[i % n] for i in run]
            edge = max(
                (e for e in edges_of(corners) if e in missing),
                key=lambda e: extent_of(points[[*e]]),
            )
            area = area_of(np.concatenate([points[corners], apex]))
            lids.append(_Lid(corners, part.faces[missing[edge]].material, area))
        return _Hole(loop, lids, apex)

    def size(hole: _Hole) -> tuple[float, float]:
        # Of corners on both planes, those nearest to each other: else a side runs back.
        sides = (extent_of(points[[lid.corners[0], lid.corners[-1]]]) for lid in hole.lids)
        return round(hole.area, 6), sum(sides)

    whole = closed([range(n)], none)
    if not _is_bent(part, loop):
        return whole
    planes = list[Polygon]()
    for face in dict.fromkeys(missing[edge] for edge in edges_of(loop)):
        plane = Polygon(points[part.faces[face].corners])
        if all(
            abs(plane.normal @ p.normal) <= _FACING or p.thickness(plane.corners) > tolerance
            for p in planes
        ):
            planes.append(plane)
    on = np.array([np.abs(plane.away(rim)) <= tolerance for plane in planes])
    folds = np.flatnonzero(on.sum(axis=0) > 1).tolist()
    for number in (2, 3) if len(folds) <= _MOST_FOLDS else ():
        found = list[_Hole]()
        for cuts in combinations(folds, number):
            runs = [range(a, b + 1) for a, b in pairwise([*cuts, cuts[0] + n])]
            holds = [np.flatnonzero(on[:, np.array(run) % n].all(axis=1)).tolist() for run in runs]
            for chosen in product(*holds):
                apex = _apex(rim, [planes[k] for k in chosen], tolerance) if number == 3 else none
                if len({*chosen}) == number and len(apex) == number - 2:
                    found.append(closed(runs, apex))
        if found := [hole for hole in found if min(lid.area for lid in hole.lids) > SAME]:
            return min(found, key=size)
    return whole


def _apex(rim: Array, planes: Sequence[Polygon], tolerance: float) -> Array:
    """Return the corner in which three planes meet, (1, 3) in m; (0, 3) if there is none by the rim."""
    normals, near = np.array([plane.normal for plane in planes]), rim.mean(axis=0)
    if abs(np.linalg.det(normals)) < 1 - _FACING:
        return np.zeros((0, 3))
    apex = near - np.linalg.solve(normals, [float(plane.away(near)) for plane in planes])
    away = np.linalg.norm(rim - apex, axis=1)
    is_near = tolerance < away.min() and away.max() <= 2 * extent_of(rim)
    return apex[np.newaxis] if is_near else np.zeros((0, 3))


def _note_others(shell: FaceSet, others: Sequence[FaceSet]) -> None:
    """Note what there is beside a shell that is open; nothing is cut, since nothing is in a room."""
    note_repetitions(shell.mend)
    walls = Walls(shell)
    for part in others:
        is_open = bool(part.open_edges())
        kind = "object" if not is_open else "overlay" if _overlaid_on(walls, part) else "panel"
        shell.mend.found(kind, part.names[:1], part.size, done=_LOOSE * (kind == "panel"))


def _hint(part: FaceSet, hole: _Hole, others: Sequence[FaceSet]) -> str:
    """Return how a hole may be mended; of the options only one that was tried."""
    mend, points = part.mend, part.mend.points
    beside = sorted({v for other in others for v in other.corners} - {*part.corners})
    if beside:
        away, _ = cKDTree(points[beside]).query(points[hole.loop])
        if (distance := float(np.median(away))) < _NEAR:
            weld = f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            cure = "let them meet in your program"
            if _closes(mend, float(weld), mend.largest_hole):
                cure = f"use --weld {weld}"
            return f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: {cure}"
    enough = rounded(1.01 * hole.area, 3)  # more than the area, as printed
    by_hand = f"In your program, {_LOOPS}"
    if _closes(mend, mend.weld, float(enough)):
        return f"{by_hand}; or use --hole {enough}"
    bent = f"{_BENT_RIM} and --hole cannot close it. " if _is_bent(part, hole.loop) else ""
    return bent + by_hand


_BENT_RIM = "The hole's rim is not plane,"


def _closes(mend: Mending, weld: float, largest_hole: float | None) -> bool:
    """Return whether the mesh can be mended with these options; not tried within such a trial."""
    if mend.is_trial:
        return False
    trial = Mending(mend.drawn, max(weld, SAME), largest_hole, is_trial=True)
    try:
        _closed_room(trial)
    except RtcalError:
        return False
    return True


def as_drawn(shell: FaceSet, others: Sequence[FaceSet], error: MeshError) -> MeshError:
    """Return the error of a shell that does not close, with the room as drawn and its estimated volume.

    If the shell has less than half of the area, the rays cross all faces, and not only closed ones.
    """
    areas = Counter[str]()
    for part in (shell, *others):
        for area, material in zip(part.areas.tolist(), part.materials, strict=True):
            areas[material] += area
    is_whole = 2 * shell.size > areas.total()
    crossed = [p for p in others if not is_whole or not p.open_edges()]
    drawn = FaceSet(shell.mend, [face for part in (shell, *crossed) for face in part.faces])
    volume, u = volume_by_rays(drawn.polygons)
    size, notes = tuple(np.ptp(shell.points, axis=0).tolist()), shell.mend.drawn.notes
    error.unclosed = Mended(
        None, volume, u, areas, size, (*error.defects, *_left_open(shell)), notes
    )
    faces = [
        (f"{m} {i}", m, polygon)
        for i, (m, polygon) in enumerate(zip(drawn.materials, drawn.polygons, strict=True), 1)
    ]
    with suppress(DataError):  # that the faces bound nothing is in the message
        error.leaking = Polyhedron.from_polygons(faces, leaks=True)
    return error


def _left_open(shell: FaceSet) -> list[Defect]:
    """Return the holes of a shell that is taken as it is drawn; their area is not in S."""
    found = list[Defect]()
    for h in _holes(shell):
        at, done = (f"at {shell.mend.place(h.loop[0])}, {h.beside}",), "left as drawn and not in S"
        found.append(Defect("open hole", 1, h.area, 0.0, 0.0, 0.0, at, done, h.unsure))
    return [reduce(add, found)] if found else []


_LINES = 64  # Lines along each side of the picture, 4096 in each direction
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians about x, y and z, so that no line lies in a wall."""
_AT_ONCE = 250  # Triangles that are crossed with all lines at once
_NEIGHBOURHOOD = 9
_GUESSED = 0.3  # Relative standard uncertainty of the part of lines with an odd number of crossings


def volume_by_rays(polygons: Sequence[Array]) -> tuple[float, float]:
    """Return the volume in m³ within polygons, (n, 3) in m each, and its standard uncertainty in m³."""
    triangles = (np.array(triangulate(p), dtype=int).reshape(-1, 3) for p in polygons)
    corners = np.concatenate([np.asarray(p)[t] for p, t in zip(polygons, triangles, strict=True)])
    corners = corners @ Rotation.from_euler("xyz", _TILT).as_matrix().T
    found = [_along(np.roll(corners, k, axis=2)) for k in range(3)]
    volumes, unknown = (np.array(column) for column in zip(*found, strict=True))
    weights = np.clip(1 - unknown, 1e-3, None) ** 4
    weights /= weights.sum()
    volume = float(weights @ volumes)
    spread = float(weights @ (volumes - volume) ** 2)
    guessed = _GUESSED * volume * float(weights @ unknown)
    return volume, float(np.sqrt(spread + guessed**2 + (volume / _LINES**1.5) ** 2))


def _along(corners: Array) -> tuple[float, float]:
    """Return the volume by lines along the last axis, and the share of the lines that are unknown."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    step = (high - low)[:2] / _LINES
    grid = np.indices((_LINES, _LINES)).reshape(2, -1).T
    places = (low[:2] + step * (grid + 0.5))[:, np.newaxis]
    lines, depths = [], []
    for part in np.array_split(corners, len(corners) // _AT_ONCE + 1):
        a, first, second = part[:, 0], part[:, 1] - part[:, 0], part[:, 2] - part[:, 0]
        area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        x, y = np.moveaxis(places - a[:, :2], -1, 0)
        u = (x * second[:, 1] - y * second[:, 0]) / area
        v = (first[:, 0] * y - first[:, 1] * x) / area
        line, triangle = np.nonzero((u >= 0) & (v >= 0) & (u + v <= 1))
        along = a[:, 2] + u * first[:, 2] + v * second[:, 2]
        lines.append(line)
        depths.append(along[line, triangle])
    line, depth = np.concatenate(lines), np.concatenate(depths)
    order = np.lexsort((depth, line))
    line, depth = line[order], depth[order]
    crossings = np.bincount(line, minlength=_LINES**2)
    rank = np.arange(len(line)) - (np.cumsum(crossings) - crossings)[line]
    lengths = np.bincount(line, np.where(rank % 2, depth, -depth), _LINES**2)
    unknown, known = crossings % 2 == 1, crossings % 2 == 0
    known &= lengths > 0
    if not known.any():
        return 0.0, 1.0
    near, number = (
        uniform_filter(each.reshape(_LINES, _LINES), _NEIGHBOURHOOD, mode="constant").ravel()
        for each in (np.where(known, lengths, 0.0), known.astype(float))
    )
    mean = np.full(len(lengths), lengths[known].mean())
    np.divide(near, number, out=mean, where=number > 0.5 / _NEIGHBOURHOOD**2)
    total = lengths[known].sum() + mean[unknown].sum()
    return float(total * step.prod()), float(unknown.sum() / (unknown | known).sum())


# -- what is in the room

_FACING = 0.999  # Least product of the normals of planes that count as parallel
_BEFORE = 5e-4  # Distance in m before a face at which there is air
COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""
_LEAST_ENCLOSED = 0.99
"""Least share of the shell's volume that spaces between faces have, if no face has a gap around it."""
_MOST_OF_ROOM = 1 / 3
"""Largest share of the walls that an object has behind it: faces that have more divide a room."""


class _Cut(NamedTuple):
    """Hold a piece of a face that lies on a wall.

    ``wall`` is its number, ``shape`` is in the wall's plane, and ``away`` its distance in m.
    """

    wall: int
    shape: Any
    face: Face
    away: float


class Walls:
    """The faces of a shell and of the objects in it, with a search for those near a place."""

    def __init__(self, shell: FaceSet) -> None:
        self.mend, self.all = shell.mend, FaceSet(shell.mend)
        self.planes, self._boxes = list[Polygon](), np.zeros((0, 2, 3))
        self.add(shell)

    def add(self, part: FaceSet) -> slice:
        """Add the faces of the shell, or of an object in it, and return their numbers."""
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin, first = 2 * OFFSET + self.mend.weld, len(self.planes)
        boxes = [(p.min(axis=0) - margin, p.max(axis=0) + margin) for p in part.polygons]
        self._boxes = np.concatenate([self._boxes, boxes])
        self.planes += map(Polygon, part.polygons)
        self.all.faces += part.faces
        return slice(first, len(self.planes))

    def near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return the number and the plane of each face that may touch an object with these corners."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        near = ((self._boxes[:, 0] <= high) & (low <= self._boxes[:, 1])).all(axis=1)
        return [(i, self.planes[i]) for i in np.flatnonzero(near).tolist()]


def _overlaid_on(walls: Walls, part: FaceSet) -> list[_Cut]:
    """Return the pieces of a plane component on the walls that it lies on; empty if it lies on none."""
    mend, corners = part.mend, part.points
    normal, thick = best_plane(corners)
    if thick > max(mend.weld, PLANARITY):
        return []
    cuts = [
        _Cut(i, piece, face, away)
        for i, wall in walls.near(corners)
        if (away := wall.thickness(corners)) <= OFFSET and abs(wall.normal @ normal) > 0.99
        for face in part.faces
        for piece in polygons_of(wall.common(mend.points[face.corners]), mend.weld**2)
    ]
    nearest = min((cut.away for cut in cuts), default=0.0)
    cuts = [cut for cut in cuts if cut.away <= nearest + mend.weld]
    return cuts if sum(cut.shape.area for cut in cuts) >= COVERED * part.size else []


def _put_on_walls(walls: Walls, part: FaceSet, n_shell: int) -> None:
    """Move faces of a closed object that are near a wall, and parallel to it, onto this wall.

    A face is near if it is at most ``weld`` in front of a wall, or reaches at most `OFFSET` through one
    of the first ``n_shell`` walls, the walls of the room. A larger gap, up to `OFFSET`, is only noted.
    """
    mend = part.mend
    onto: dict[int, list[Polygon]] = {}
    for face, outward in zip(part.faces, part.polyhedron().normals, strict=True):
        corners = mend.points[face.corners]
        for j, wall in walls.near(corners):
            size, to_wall = area_of(corners), wall.normal * np.sign(wall.normal @ outward)
            away = (wall.corners.mean(axis=0) - corners) @ to_wall
            if to_wall @ outward < _FACING or away.min() < -mend.weld - OFFSET * (j < n_shell):
                continue
            shapes = polygons_of(wall.common(corners))
            shapes = [s for s in shapes if s.area > mend.weld * extent_of(ring_of(s)) / 2]
            shared, gap = sum(float(s.area) for s in shapes), float(away.max())
            place = f'"{face.name}" %s "{walls.all.faces[j].name}"'
            if shapes and gap <= mend.weld:
                # What the object's other faces have gained or lost there.
                longer = ANY_SHARE * wall.thickness(corners) * sum(float(s.length) for s in shapes)
                for v in face.corners:
                    onto.setdefault(v, []).append(wall)
                unsure = [(face.material, longer)]
                mend.found("contact", [place % "on"], shared, 0.0, -2 * shared, unsure=unsure)
            elif shared > COVERED * size and gap <= OFFSET and j < n_shell:
                mend.found("gap", [f"{place % 'before'} (--weld {1.1 * gap:.2g})"], size)
    _move(part, onto)


def _stand_on_walls(walls: Walls, part: FaceSet) -> Mapping[str, float]:
    """Move open edges of an open object that are at most `OFFSET` from walls onto these walls."""
    mend, edges = part.mend, part.open_edges()
    onto: dict[int, list[Polygon]] = {v: [] for edge in edges for v in edge}
    for v, used in onto.items():
        point = mend.points[v]
        for _, wall in walls.near(point[np.newaxis]):
            beside = wall.shape.distance(shapely().Point(*(wall.axes @ point)))
            if abs(wall.away(point)) <= OFFSET and beside <= OFFSET:
                used.append(wall)
    for face in part.faces:
        for cut in _overlaid_on(walls, FaceSet(mend, [face])):
            for v in face.corners * (cut.away <= mend.weld):
                onto.setdefault(v, []).append(walls.planes[cut.wall])
    shift = _move(part, onto)
    unsure = Counter[str]()  # its open edges are all as far off, so their parts add
    for (a, b), i in edges.items():
        gained = ANY_SHARE * extent_of(mend.points[[a, b]]) * max(shift[a], shift[b])
        unsure[part.faces[i].material] += gained
    return unsure


def _move(part: FaceSet, onto: Mapping[int, Sequence[Polygon]]) -> dict[int, float]:
    """Move corners of an object onto walls, and return by how much in m each.

    Of parallel walls the nearest counts. The object reaches through a wall that is bent.
    """
    mend, middle, shift = part.mend, part.points.mean(axis=0), dict[int, float]()
    for v, walls in onto.items():
        point, used = mend.points[v], list[Polygon]()
        for wall in sorted(walls, key=lambda wall: abs(float(wall.away(point)))):
            if all(abs(wall.normal @ other.normal) < 0.99 for other in used):
                used.append(wall)
        through = [np.sign(wall.away(middle)) * wall.thickness(wall.corners) for wall in used]
        off = np.add([wall.away(point) for wall in used], through)
        normals = np.reshape([wall.normal for wall in used], (-1, 3))
        move = np.linalg.lstsq(normals, off)[0]
        mend.points[v], shift[v] = point - move, float(np.linalg.norm(move))
    return shift


_PLATE = 1e-5
"""Thickness in m of the plates that faces are made of: far above rounding, and below `FINE`."""


@dataclass
class _Cell:
    """Hold a space that faces enclose.

    ``volume`` is in m³; below 0 for the outside of faces that hang free in a space. ``triangles`` (n,
    3, 3) are the corners in m of the triangles around the space. ``sides`` (n,) has the side of a face
    that each belongs to: 2 i for the front of face i, 2 i + 1 for its back, and -1 for an edge.
    """

    volume: float
    triangles: Array
    sides: NDArray[np.int64]

    def seen(self, n: int) -> Array:
        """Return the area in m² of front and back of each of n faces around this space, (n, 2)."""
        edges = self.triangles[:, 1:] - self.triangles[:, :1]
        sizes = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        known = self.sides >= 0
        areas = np.bincount(self.sides[known], sizes[known], 2 * n)
        return np.asarray(areas, dtype=float).reshape(n, 2)


def _cells_of(part: FaceSet) -> list[_Cell]:
    """Return the spaces that faces enclose, the largest first.

    They are the cavities in the union of thin plates, one for each triangle, which overlap at edges.
    """
    needed = (
        "objects in a room and walls drawn as solids need manifold3d: pip install 'rtcal[mesh]'"
    )
    manifold = library(needed, "manifold3d")
    found = [(i, p[list(t)]) for i, p in enumerate(part.polygons) for t in triangulate(p)]
    index, corners = (np.array(column) for column in zip(*found, strict=True))
    centre = corners.mean(axis=(0, 1))  # far from the origin a plate's thickness would be rounding
    corners = corners - centre
    edges = np.roll(corners, -1, axis=1) - corners
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    normals = np.cross(edges[:, 0], edges[:, 1])[:, np.newaxis]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    after = np.cross(edges, normals)
    before = np.roll(after, 1, axis=1)
    sharp = np.maximum(1 + np.sum(after * before, axis=2, keepdims=True), 0.05)
    corners = corners + _PLATE / 10 * (after + before) / sharp
    half = _PLATE / 2 * normals
    plates = np.concatenate([corners + half, corners - half], axis=1)
    # Each plane of each plate has a number: triangles of one number may become one.
    planes = 5 * np.arange(len(index))[:, np.newaxis] + np.array([0, 1, 2, 2, 3, 3, 4, 4])
    faces = [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 3], [2, 3, 0]]
    made = [
        manifold.Manifold(manifold.Mesh64(plate, np.array(faces, np.uint64), face_id=of))
        for plate, of in zip(plates, planes.astype(np.uint64), strict=True)
    ]
    surfaces = []
    for surface in manifold.Manifold.batch_boolean(made, manifold.OpType.Add).decompose():
        mesh = surface.to_mesh64()
        found = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts, int)]
        of, plane = np.divmod(np.asarray(mesh.face_id, np.int64), 5)
        sides = np.where(plane < 2, 2 * index[of] + plane, -1)
        surfaces.append(_Cell(-surface.volume(), found + centre, sides))
    cells = sorted((s for s in surfaces if s.volume > SAME), key=lambda s: s.volume)
    inner = [s for s in surfaces if s.volume < 0]
    for cell in cells:  # what hangs free is in the smallest cell around it
        points = np.array([s.triangles[0, 0] for s in inner]).reshape(-1, 3)
        around = np.abs(winding_number(points, cell.triangles)) > 0.5
        held = [
            s for s, is_in in zip(inner, around, strict=True) if is_in and -s.volume < cell.volume
        ]
        inner = [s for s in inner if not any(s is other for other in held)]
        cell.volume += sum(s.volume for s in held)
        cell.triangles = np.concatenate([cell.triangles, *[s.triangles for s in held]])
        cell.sides = np.concatenate([cell.sides, *[s.sides for s in held]])
    return sorted(cells, key=lambda cell: -cell.volume)


def _faces_around(cell: _Cell, part: FaceSet, overlays: Sequence[_Cut] = ()) -> FaceSet:
    """Return the faces of ``part``, or pieces of them, that are around a space.

    ``overlays`` replace the part of a face that they cover. A face with the space on both of its sides
    becomes a plate of the thickness `THICKNESS`.
    """
    mend, out = part.mend, FaceSet(part.mend)
    flat = cell.triangles.reshape(-1, 3)
    away, number = cKDTree(mend.points).query(flat)
    is_new = away > max(FINE, mend.weld / 10)
    new, of_new = weld_vertices(flat[is_new])
    number[is_new] = np.array(mend.new_points(new), dtype=int)[of_new]
    _sharpen(mend, cell, number.reshape(-1, 3), len(mend.points) - len(new))
    around: dict[int, tuple[list[list[int]], list[list[int]]]] = {}
    for corners, side in zip(number.reshape(-1, 3).tolist(), cell.sides.tolist(), strict=True):
        if side >= 0 and len({*corners}) == 3:
            around.setdefault(side // 2, ([], []))[side % 2].append(corners)
    for i, both in sorted(around.items()):
        face, cuts = part.faces[i], [cut for cut in overlays if cut.wall == i]
        if not cuts and not all(both):
            out.faces += [face._replace(corners=c) for c in outlined(mend, both[0] or both[1])]
            continue
        wall = Polygon(mend.points[face.corners])
        front, back = (
            shapely().union_all([wall.polygon(mend.points[corners]) for corners in side])
            for side in both
        )
        for piece in polygons_of(front.intersection(back), mend.weld**2):
            _add_plate(out, wall, piece, face)
        left = front.symmetric_difference(back)
        for cut in sorted(cuts, key=lambda cut: float(cut.shape.area)):
            _add_pieces(out, wall, left.intersection(cut.shape), cut.face)
            left = left.difference(cut.shape)
        _add_pieces(out, wall, left, face)
    return flattened(out.kept([2 * area_of(p) > FINE * extent_of(p) for p in out.polygons]))


def _sharpen(mend: Mending, cell: _Cell, number: Array, first: int) -> None:
    """Move a cell's corners from this number on, where plates cross, by half of their thickness."""
    edges = cell.triangles - np.roll(cell.triangles, 1, axis=1)
    normals = np.cross(edges[:, 0], edges[:, 1])
    sizes, longest = (np.linalg.norm(x, axis=-1) for x in (normals, edges))
    wide = (cell.sides >= 0) & (sizes > FINE * longest.max(axis=1))
    at: dict[int, list[int]] = {}
    for k, corner in np.argwhere(wide[:, np.newaxis] & (number >= first)):
        at.setdefault(number[k, corner], []).append(k)
    for v, around in at.items():
        planes = normals[around] / sizes[around, np.newaxis]
        off = np.sum(planes * (mend.points[v] - cell.triangles[around, 0]), axis=1) + _PLATE / 2
        mend.points[v] -= np.linalg.lstsq(planes, off, rcond=1e-2)[0]


def _add_pieces(part: FaceSet, wall: Polygon, shape: Any, face: Face) -> None:
    """Add the pieces of a shape in a wall's plane, in triangles if they have holes."""
    for piece in polygons_of(shape, part.mend.weld**2):
        triangles = shapely().constrained_delaunay_triangles(piece) if piece.interiors else piece
        for ring in polygons_of(triangles):
            corners = part.mend.new_points(wall.lifted(ring_of(ring)))
            part.faces.append(face._replace(corners=corners))


def _add_plate(part: FaceSet, plane: Polygon, shape: Any, face: Face) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    mend, half = part.mend, plane.normal * THICKNESS / 2
    for piece in polygons_of(shape.buffer(-THICKNESS / 2, join_style="mitre")):
        corners = plane.lifted(ring_of(piece))
        front, back = mend.new_points(corners + half), mend.new_points(corners - half)
        edges = [[front[k], front[k - 1], back[k - 1], back[k]] for k in range(len(front))]
        part.faces += [Face(front, *face[1:]), Face(back[::-1], face.material, f"{face.name} back")]
        part.faces += [Face(edge, face.material, f"{face.name} edge") for edge in edges]


class _Placed(NamedTuple):
    """A component in the room: its ``faces`` among all, and uncertainties in m² by material."""

    part: FaceSet
    faces: slice
    is_open: bool
    is_in: bool
    unsure: Mapping[str, float]


def _room_of(
    shell: FaceSet, others: Sequence[FaceSet], as_it_is: Polyhedron | None = None
) -> Polyhedron:
    """Return the room in a closed shell, with the objects, panels and overlays in it.

    ``as_it_is``, the geometry of all faces as drawn, is returned if no object touches another face.
    """
    mend, n = shell.mend, sum(len(part.faces) for part in (shell, *others))
    if n > MOST_FACES:
        raise mend.refused(
            f"the mesh has {n} faces, but at most {MOST_FACES} are read: simplify the model"
        )
    hull, walls, overlays = shell.polyhedron(), Walls(shell), list[_Cut]()
    placed, outside = list[_Placed](), list[FaceSet]()
    for part in sorted(others, key=lambda p: (p.is_plane, 0.0 if p.is_plane else -p.size)):
        is_in, is_open = is_within(hull, part), bool(part.open_edges())
        if part.is_plane and not is_in:
            # Whether an edge is in the room, and not merely at its walls.
            ends = mend.points[[edge for corners in part.loops for edge in edges_of(corners)]]
            along = np.linspace(0, 1, 9)[:, np.newaxis, np.newaxis]
            points = (ends[:, 0] + along * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
            reaches = not _at_walls(hull, points[hull.contains(points)], mend.weld)
            kind = "partly outside" if reaches else "outside"
            shares = zip(part.materials, (reaches * ANY_SHARE * part.areas).tolist(), strict=True)
            mend.found(kind, part.names[:1], part.size, unsure=shares)
            outside.append(part)
            continue
        if is_open and (cuts := _overlaid_on(walls, part)):
            moved = sum(cut.away * float(cut.shape.area) for cut in cuts)
            # The reveal from the wall to the face is not drawn; it may be of the face's material.
            reveals = [(c.face.material, ANY_SHARE * c.away * float(c.shape.length)) for c in cuts]
            mend.found("overlay", part.names[:1], part.size, moved, -part.size, unsure=reveals)
            overlays += cuts
            continue
        unsure: Mapping[str, float] = {}
        if not is_open:
            _put_on_walls(walls, part, len(shell.faces))
        elif not part.is_plane:
            unsure = _stand_on_walls(walls, part)
        placed.append(_Placed(part, walls.add(part), is_open, is_in, unsure))
    touch = any(defect.kind == "contact" for defect in mend.defects)
    # A room of less than half of the shell's volume is the space in walls drawn with their thickness.
    if as_it_is is not None and not touch and 2 * as_it_is.volume > hull.volume:
        return as_it_is
    cells = [_Cell(hull.volume, hull.triangles, 2 * hull.triangle_faces)]
    unseen = set[frozenset[int]]()
    if placed:
        cells = _cells_of(walls.all)
        if sum(cell.volume for cell in cells) < _LEAST_ENCLOSED * hull.volume:
            raise DataError(
                "the walls do not close: there is a gap between faces of objects or walls"
            )
        _require_one_room(mend, cells, walls, len(shell.faces))
        around = cells[0].seen(len(walls.planes)).sum(axis=1)
        unseen = {
            frozenset(c) for c, seen in zip(walls.all.loops, around, strict=True) if seen < SAME
        }
        outside += _noted(placed, cells, len(walls.planes))
        if around[: len(shell.faces)].sum() < SAME:
            mend.found("outside", shell.names[:1], shell.size)
    note_repetitions(mend, unseen)
    _require_shell(shell, outside)
    return _faces_around(cells[0], walls.all, overlays).polyhedron()


def _require_one_room(mend: Mending, cells: Sequence[_Cell], walls: Walls, n_shell: int) -> None:
    """Raise MeshError if two spaces each have much of the walls around all, and nothing beyond them."""
    n = len(walls.planes)
    seen = [cell.seen(n) for cell in cells]
    beyond = np.sum(seen, axis=0)[:, ::-1]
    most = _MOST_OF_ROOM * float(walls.all.areas[:n_shell].sum())
    alone = [float(np.clip(own - beyond, 0, None).sum()) for own in seen]
    for cell, own, around in zip(cells[1:], seen[1:], alone[1:], strict=True):
        divides = min(alone[0], around) > most and 2 * cell.volume > cells[0].volume
        if divides and own[:n_shell].sum() > SAME:
            sizes = f"{rounded(cells[0].volume, 3)} and {rounded(cell.volume, 3)} m³"
            raise mend.refused(
                f"two closed rooms of {sizes} share a wall. Delete one of the rooms; or delete "
                "that wall if they are one room"
            )


def _noted(placed: Sequence[_Placed], cells: Sequence[_Cell], n: int) -> list[FaceSet]:
    """Note what the components are by which of their sides the room has; return those outside it."""
    volume, covered = np.zeros(len(placed)), np.zeros(len(placed))
    for cell in cells[1:]:
        seen = cell.seen(n).sum(axis=1)
        shares = [float(seen[p.faces].sum()) for p in placed]
        k = int(np.argmax(shares))
        volume[k] += cell.volume
        covered[k] += seen.sum() - shares[k]
    outside, of_room = list[FaceSet](), cells[0].seen(n)
    for k, p in enumerate(placed):
        mend, names, size = p.part.mend, p.part.names[:1], p.part.size
        both = 2 * float(of_room[p.faces].min(axis=1).sum())
        once = float(of_room[p.faces].sum()) - both
        if once + both < SAME:
            again = {frozenset(face.corners) for face, _ in mend.repeated}
            if frozenset(p.part.faces[0].corners) not in again:
                mend.found("outside", names, size)
                outside += [p.part] * p.is_open
            continue
        if not p.is_in:
            mend.found("through", names, size - once - both / 2)
        if both > mend.weld**2:
            mend.found("panel", names, both / 2, -THICKNESS * both / 2, both / 2)
        if p.is_open and once > both:
            surface = once - float(covered[k])
            mend.found(
                "open bottom", names, size, -float(volume[k]), surface, unsure=p.unsure.items()
            )
    return outside


def _require_shell(shell: FaceSet, outside: Sequence[FaceSet]) -> None:
    """Raise MeshError if what is left out as outside are the walls, and the shell is an object."""
    if not outside:
        return
    around, held = np.concatenate([p.points for p in outside]), shell.points
    encloses = (around.min(axis=0) <= held.min(axis=0)).all()
    encloses &= (around.max(axis=0) >= held.max(axis=0)).all()
    size = sum(p.size for p in outside)
    if encloses and size > shell.size:
        raise shell.mend.refused(
            f'the largest closed part, which begins with "{shell.names[0]}", is not the room: '
            f"faces of {rounded(size, 3)} m² around it are not closed. Draw each wall once, and "
            "let neighbours have the same corners"
        )


def _at_walls(hull: Polyhedron, points: Array, weld: float) -> bool:
    """Return whether points (n, 3) are all at the walls of a room."""
    return not (hull.wall_distance(points) > OFFSET + weld).any()


def is_within(hull: Polyhedron, part: FaceSet) -> bool:
    """Return whether all corners of a component are in the room or at its walls."""
    return _at_walls(hull, part.points[~hull.contains(part.points)], part.mend.weld)


# -- walls that are drawn as solids

_THIN = 0.8
"""Mean chord in m, 4 V / S, below which a solid is a wall or a slab: that of a wall is twice its
thickness at most, that of a cube of 5 m³ is 1.1 m."""
_LONGEST = 150.0
"""Longest side in m of a building that is drawn in m; a longer one is taken as in mm, cm or inches."""
_THIN_SHARE = 0.08
"""The same chord as a share of the longest side, for such a mesh: that of a room of 10 m."""
_LEAST_SHARE = 0.05  # Least volume of the room, as a share of that of the box around the solids


def _room_between(part: FaceSet) -> FaceSet | None:
    """Return the faces around the largest cavity between closed solids, such as walls drawn as solids.

    None if there are no such solids, or one may be the room. MeshError if all are thin and enclose
    none.
    """
    mend = part.mend
    groups = _solids(part)
    if len(groups) < 2:
        return None
    try:
        solids = [group.polyhedron() for group in groups]
    except DataError:  # a solid that reaches through itself
        return None
    longest = float(np.ptp(mend.points, axis=0).max())
    chord = _THIN if longest < _LONGEST else _THIN_SHARE * longest
    thin = [4 * s.volume < chord * float(np.sum(s.face_areas)) for s in solids]
    if not any(thin):
        return None
    cavities = list[_Cell]()
    for cell in _cells_of(part):
        triangle = max(cell.triangles, key=area_of)
        before = triangle.mean(axis=0) + _BEFORE * normal_of(triangle)  # out of its plate
        if not any(solid.contains([before]).any() for solid in solids):
            cavities.append(cell)
    box = float(np.prod(np.ptp(mend.points, axis=0)))
    if not cavities or cavities[0].volume < _LEAST_SHARE * box:
        if not all(thin):
            return None
        raise MeshError(
            f"{mend.path}: the mesh consists of {len(solids)} solids, such as walls and slabs, "
            "which do not enclose a room. In your program, close the openings and gaps between "
            f"the solids, or draw the room's inner faces; --weld {rounded(10 * mend.weld, 2)} "
            "closes gaps of that width in m"
        )
    room, *others = cavities
    done = f"closed solids: the room is the cavity of {rounded(room.volume, 4)} m³ between them"
    if others:
        sizes = listed([f"{rounded(c.volume, 3)} m³" for c in others])
        done += f", the largest; {'another' if len(others) == 1 else 'others'} of {sizes} left out"
    mend.found("solids", [group.faces[0].name for group in groups], done=done)
    return _faces_around(room, part)


def _solids(part: FaceSet) -> list[FaceSet]:
    """Return the faces of each solid: in the file's order, until each edge has two faces."""
    solids, open_edges = list[FaceSet](), set[Edge]()
    for face in part.faces:
        if not open_edges:
            solids.append(FaceSet(part.mend))
        solids[-1].faces.append(face)
        open_edges.symmetric_difference_update(edges_of(face.corners))
    return [] if open_edges else solids


def mended(faces: Faces, *, weld: float = WELD, largest_hole: float | None = None) -> Mended:
    """Return the room that the faces of a mesh enclose, and the defects of the mesh that were repaired.

    Corners up to ``weld`` in m apart become one. Holes up to ``largest_hole`` in m² are closed; None is
    1 % of the area. Raises MeshError if the faces enclose no room, with the defect, the place and the
    repair.
    """
    for name, value, unit in (("weld", weld, "m"), ("largest_hole", largest_hole or 0.0, "m²")):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} {unit} must be finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: the mesh has no face; a room needs at least 4")
    most = 20 * MOST_FACES
    budget.require(len(faces.polygons), most, "faces", faces.path, "simplify the model")
    if (closed := _closed_as_drawn(faces, weld)) is not None:
        return closed
    return _closed_room(Mending(faces, max(weld, SAME), largest_hole))


def _closed_room(mend: Mending) -> Mended:
    """Return the room that a mesh encloses after all repairs; MeshError if there is none."""
    drawn = welded(mend)
    part = _room_between(drawn) or drawn
    part = flattened(_snapped(_joined(without_repetitions(part))))
    mend, (shell, others) = part.mend, _shell_of(part)
    try:
        shell = without_holes(shell, others)
        return mend.result(_room_of(shell, others))
    except DataError as error:
        if mend.is_trial:
            raise
        rim = f"the hole at {mend.bent_rim} has a rim that is not plane; " if mend.bent_rim else ""
        message = f"after mending, {rim}{error}"
        refused = error if isinstance(error, MeshError) else mend.refused(message)
        raise as_drawn(
            shell, others, refused
        ) from None  # an error that is its own cause has no end


def _closed_as_drawn(faces: Faces, weld: float) -> Mended | None:
    """Return the room of faces that close as they are drawn, its objects within; None of others."""
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    mend = Mending(faces, max(weld, SAME))
    polygons = zip(numbered(faces.names), faces.materials, faces.polygons, strict=True)
    try:
        geometry = Polyhedron.from_polygons(list(polygons))
        mend.points = np.array(geometry.vertices)
        corners = map(list, geometry.faces)
        part = FaceSet(mend, map(Face, corners, geometry.materials, geometry.names))
        shell, others = _shell_of(part)
        hull = shell.polyhedron()
        if not all(is_within(hull, other) for other in others):
            return None
        return mend.result(_room_of(shell, others, geometry))
    except DataError:  # not closed, or a defect that is named later
        return None
