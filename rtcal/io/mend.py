"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge;
4. a face on a larger one (a window on its wall, up to `OFFSET` before it) takes its area;
5. corners of an object near a wall are moved onto it, up to `OFFSET` from its open bottom and up to
   ``weld`` from a face;
6. the room is the largest space between all faces, as thin plates, by manifold3d. What faces it counts:
   not what lies outside, not the part of an object behind a wall, and neither of two faces that touch.
   A panel that has the room on both sides becomes a reflector, `THICKNESS` thick.

Each is a `Defect` with its number, area and effects on V and S. What cannot be mended safely is
refused, and the message says how to mend it in the program that drew it. All other defects are listed
with it, so that they can be mended in one go. Needs shapely and manifold3d (``rtcal[mesh]``) where a
face is to be cut.

Walls that are drawn as closed solids, as building models and CAD programs do, bound material: the room
is the largest space outside all solids. The volume of a room whose faces do not
close is taken by lines through what is drawn: parallel lines in three directions cross the walls.
Between its first and second crossing, its third and fourth, a line is in the room. A line with an odd
number of crossings went through a hole, and takes the mean of its neighbours. Where holes face each
other a direction is wrong and the others are not, so their spread is the uncertainty.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

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
from rtcal.support.errors import DataError
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
_SHOWN = 1e-6
"""Smallest effect in m³ and m² that is printed: smaller ones are rounding."""
_OF_ANY_SHARE = ("overlay", "contact")
"""Kinds of defects of whose effect on V any share may be meant."""

Face = list[int]


@dataclass(frozen=True)
class Faces:
    """Hold the faces of a mesh as they are drawn, with the corners (n, 3) in m of each face.

    ``path`` is the file's name, ``notes`` are notes on how it was read. ``unit`` is the length of the
    file's unit in m if it is known.
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

    ``places`` are names or corners of the first few defects, ``area`` is the area of the faces in m².
    The effects are the changes of volume in m³ and surface in m² by the repair. The uncertainties are
    standard uncertainties that remain: of the volume in m³, and of each material's area in m².
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
        both = (*self.area_uncertainty.items(), *other.area_uncertainty.items())
        return Defect(
            self.kind,
            self.number + other.number,
            self.area + other.area,
            volume,
            self.area_effect + other.area_effect,
            float(ANY_SHARE * abs(volume)) if self.kind in _OF_ANY_SHARE else u,
            (*self.places, *other.places)[:MOST_PLACES],
            self.done,
            combined(both),
        )

    def __str__(self) -> str:
        """Return the defect as one line."""
        u = float(np.linalg.norm([*self.area_uncertainty.values()]))
        parts = [f"{self.number} {self.done}", *[f"{rounded(self.area, 3)} m²"] * bool(self.area)]
        for symbol, value, unit in (("V", self.volume_effect, "m³"), ("S", self.area_effect, "m²")):
            if abs(value) > _SHOWN:
                parts.append(f"{symbol} {'-' if value < 0 else '+'}{rounded(abs(value), 3)} {unit}")
        for symbol, value, unit in (("V", self.volume_uncertainty, "m³"), ("S", u, "m²")):
            if value > _SHOWN:
                parts.append(f"u({symbol}) {rounded(value, 2)} {unit}")
        more = ", ..." if self.number > len(self.places) else ""
        at = f" ({', '.join(self.places)}{more})" if self.places else ""
        return f"{self.kind}: {', '.join(parts)}{at}"


@dataclass(frozen=True)
class Mended:
    """Hold the geometry of a room that was read from a mesh, and the defects that were repaired.

    ``geometry`` is None if the walls do not close, so that the room cannot be traced. Its ``volume`` in
    m³ is then estimated by rays (`volume_by_rays`), and its ``areas`` in m² by material are those of
    all faces as drawn. ``size`` are the lengths along x, y and z in m of the box around the room.
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
        total, u = sum(self.areas.values()), self.volume_uncertainty
        spread = f" ± {rounded(u, 2)}"
        if self.geometry is None:
            head = (
                f"V = {rounded(self.volume, 4)}{spread} m³ estimated with rays, S = {total:.6g} "
                "m² as drawn"
            )
            head += ", not closed"
        else:
            head = f"V = {self.volume:.6g}{spread * (u > _SHOWN)} m³, S = {total:.6g} m²"
            head += f", {len(self.geometry.faces)} faces"
        head += f", x × y × z = {' × '.join(rounded(x, 3) for x in self.size)} m"
        rows = [f"{area:10.3f} m²  {name}" for name, area in self.areas.items()]
        found = [f"  {defect}" for defect in self.defects] or ["  none"]
        return "\n".join([head, *rows, "defects:", *found])


class MeshError(DataError):
    """Report a mesh that cannot be made a closed room.

    ``reason`` is why, ``defects`` are all defects that were found. ``edges`` (n, 2, 3) are the open
    edges in m. ``unclosed`` is the room as it is drawn, if it has walls around it, and ``leaking`` its
    geometry with the holes, if its faces are plane.
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
    "contact": "faces of closed objects touch others: the room has neither there",
}
_LOOSE = "components hang free, or are walls that do not meet the others"


class Mending:
    """One mesh while it is mended; ``points`` are the corners in m of all its parts.

    ``repeated`` are faces that are drawn twice, and the materials that they have then.
    """

    def __init__(self, drawn: Faces, weld: float, largest_hole: float | None = None) -> None:
        self.drawn, self.path = drawn, drawn.path
        self.weld, self.largest_hole = weld, largest_hole
        self.points: Array = np.zeros((0, 3))
        self.repeated = FaceSet(self), list[str]()
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
        """Note a defect at these places, with its effects in m², m³ and m²; those of a kind are one.

        ``unsure`` are materials with a standard uncertainty of area in m² each.
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

    @cached_property
    def bend(self) -> float:
        """The largest distance of a corner from the plane in m; 0.0 where it is rounding."""
        bend = self.thickness(self.corners)
        return bend if bend > SAME else 0.0

    def thickness(self, points: Array) -> float:
        """Return the largest distance in m of points from the plane."""
        return float(np.abs(self.away(points)).max())

    def onto(self, points: Array) -> Array:
        """Return points (..., 3) moved onto the plane."""
        return np.asarray(points - self.away(points)[..., np.newaxis] * self.normal)

    def polygon(self, corners: Array) -> Any:
        """Return corners (n, 3) as a shape in the axes, made valid."""
        polygon = shapely().Polygon(corners @ self.axes.T)
        return polygon if polygon.is_valid else polygon.buffer(0)

    def beside(self, point: Array) -> float:
        """Return the distance in m in the plane of a point (3,) from the polygon."""
        return float(self.shape.distance(shapely().Point(*(self.axes @ point))))

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
    """Some faces of a mesh that is mended, by the numbers of their corners."""

    def __init__(
        self,
        mend: Mending,
        faces: Iterable[Face] = (),
        materials: Iterable[str] = (),
        names: Iterable[str] = (),
    ) -> None:
        self.mend = mend
        self.faces, self.materials, self.names = [*faces], [*materials], [*names]

    def add(self, face: Face, material: str, name: str) -> None:
        """Add a face of these corners."""
        self.faces.append(face)
        self.materials.append(material)
        self.names.append(name)

    def extend(self, other: FaceSet) -> None:
        """Add another's faces."""
        for row in other.rows():
            self.add(*row)

    def rows(self) -> Iterator[tuple[Face, str, str]]:
        """Return each face with its material and name."""
        return zip(self.faces, self.materials, self.names, strict=True)

    def of(self, index: Iterable[int]) -> FaceSet:
        """Return the faces of these numbers."""
        rows = [(self.faces[i], self.materials[i], self.names[i]) for i in index]
        return FaceSet(self.mend, *zip(*rows, strict=True)) if rows else FaceSet(self.mend)

    def kept(self, which: Any) -> FaceSet:
        """Return the faces that are to be kept."""
        return self.of(np.flatnonzero(which).tolist())

    def corners(self, i: int) -> Array:
        """Return the corners of a face in m, (n, 3)."""
        return np.asarray(self.mend.points[self.faces[i]])

    @property
    def polygons(self) -> list[Array]:
        """The corners of each face in m, (n, 3)."""
        return [self.mend.points[face] for face in self.faces]

    @property
    def areas(self) -> Array:
        """The area of each face in m², (n,)."""
        return np.asarray(np.linalg.norm(vector_areas(self.mend.points, self.faces), axis=1))

    @property
    def size(self) -> float:
        """The area in m²."""
        return float(self.areas.sum())

    @property
    def points(self) -> Array:
        """All corners in m, each once, (n, 3)."""
        return np.asarray(self.mend.points[sorted({v for face in self.faces for v in face})])

    @property
    def is_plane(self) -> bool:
        """Whether all corners are near one plane: a sheet."""
        return best_plane(self.points)[1] <= self.mend.weld

    def triangles(self) -> tuple[Array, Array]:
        """Return triangles that cover the faces, (n, 3, 3), and the number of each one's face."""
        found = [(i, t) for i, p in enumerate(self.polygons) for t in triangulate(p)]
        corners = [self.mend.points[[self.faces[i][k] for k in t]] for i, t in found]
        index = np.array([i for i, _ in found], dtype=int)
        return np.asarray(np.array(corners).reshape(-1, 3, 3)), index

    def owners(self) -> dict[Edge, list[int]]:
        """Return the numbers of the faces that meet at each edge, divided at all corners on it."""
        owners = edge_owners(self.mend.points, self.faces)
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


def simplified(face: Face) -> Face:
    """Return a face without repeated corners and without spikes a, b, a."""
    k = 0
    while k < len(face) > 2:
        if face[k] == face[k - 1] or face[k - 1] == face[(k + 1) % len(face)]:
            del face[k]
            k = -1
        k += 1
    return face


_MOST_OPEN = 5000
"""Largest number of open edges whose loops are sought."""


def loops_of(edges: Iterable[Edge]) -> list[Face] | None:
    """Return the loops of some edges, where several meet the shortest; None if one is open."""
    edges = [*edges]
    neighbours: dict[int, set[int]] = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    if any(len(n) % 2 for n in neighbours.values()) or len(edges) > _MOST_OPEN:
        return None
    loops = []
    for first in sorted(neighbours):
        while neighbours[first]:
            found = (_shortest(neighbours, first, n) for n in sorted(neighbours[first]))
            loops.append(min(found, key=len))
            for a, b in edges_of(loops[-1]):
                neighbours[a].discard(b)
                neighbours[b].discard(a)
    return loops


def _shortest(neighbours: Mapping[int, set[int]], first: int, second: int) -> Face:
    """Return the shortest loop that begins with an edge; every corner has an even number of edges."""
    before = {second: first}
    queue = [second]
    for here in queue:  # the list grows during the loop
        for there in sorted(neighbours[here]):
            if there == first and here != second:
                loop = [first, here]
                while loop[-1] != second:
                    loop.append(before[loop[-1]])
                return loop
            if there not in before and there != first:
                before[there] = here
                queue.append(there)
    raise AssertionError("an edge of an even graph is in a loop")  # pragma: no cover


# -- faces that nearly meet


def welded(mend: Mending) -> FaceSet:
    """Return the faces with corners within ``weld`` of each other as one."""
    drawn = np.concatenate([np.asarray(p, dtype=float) for p in mend.drawn.polygons])
    if not np.isfinite(drawn).all():
        raise DataError(
            f"{mend.path}: a corner has a coordinate that is not finite; export the mesh again"
        )
    _, first, of_drawn, count = np.unique(
        drawn, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    label = np.full(len(first), -1)
    groups: list[list[int]] = []
    near = cKDTree(drawn[first]).query_ball_point(drawn[first], mend.weld)
    for i in np.argsort(first).tolist():  # as they are drawn
        if label[i] < 0:
            groups.append([k for k in near[i] if label[k] < 0])
            label[groups[-1]] = len(groups) - 1
    order = label[of_drawn.ravel()]
    sums = np.zeros((len(groups), 3))
    np.add.at(sums, label, drawn[first] * count[:, np.newaxis])
    mend.points = sums / np.bincount(label, count)[:, np.newaxis]
    for k in np.flatnonzero(np.bincount(label) == 1):  # to the last bit
        mend.points[k] = drawn[first[groups[k][0]]]
    shifts = np.linalg.norm(mend.points[order] - drawn, axis=1)
    ends = np.cumsum([len(p) for p in mend.drawn.polygons])
    faces = [each.tolist() for each in np.split(order, ends[:-1])]
    part = FaceSet(mend, faces, mend.drawn.materials, mend.drawn.names)
    moved = np.unique(order[shifts > 1e-4]).tolist()
    if moved:
        own = np.array([area_of(np.asarray(p)) for p in mend.drawn.polygons])
        off = np.array([each.mean() for each in np.split(shifts, ends[:-1])])
        # A corner moves the area by half of its neighbours' distance; none is drawn better than others.
        across = [
            np.linalg.norm(np.roll(p, 1, axis=0) - np.roll(p, -1, axis=0)) / 2
            for p in map(np.asarray, mend.drawn.polygons)
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
    part = FaceSet(mend, map(simplified, part.faces), part.materials, part.names)
    sizes, counts = part.areas, np.array([len(f) for f in part.faces])
    corners, starts = mend.points[np.concatenate(part.faces)], np.cumsum(counts) - counts
    low, high = (f.reduceat(corners, starts, axis=0) for f in (np.minimum, np.maximum))
    narrow = (counts < 3) | (sizes < mend.weld * np.linalg.norm(high - low, axis=1) / 2)
    for i in np.flatnonzero(narrow & (counts > 2)):
        narrow[i] = sizes[i] < mend.weld * extent_of(mend.points[part.faces[i]]) / 2
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
        corners = np.concatenate([np.asarray(p) for p in mend.drawn.polygons])
        across = np.linalg.norm(np.ptp(corners, axis=0))
        raise mend.refused(
            f"every face is narrower than the weld distance of {mend.weld * 1000:g} mm: as read, "
            f"the mesh is {across * 1000:.2g} mm across. Give a larger --unit, such as 1 for a "
            "mesh drawn in m, or a smaller --weld"
        )
    return part.kept(~narrow)


def without_repetitions(part: FaceSet) -> FaceSet:
    """Return the faces without those that are drawn twice, which are kept to be noted."""
    seen: dict[frozenset[int], int] = {}
    firsts = [seen.setdefault(frozenset(face), i) for i, face in enumerate(part.faces)]
    again = [i for i, first in enumerate(firsts) if first != i]
    part.mend.repeated = part.of(again), [part.materials[firsts[i]] for i in again]
    return part.kept([first == i for i, first in enumerate(firsts)])


def note_repetitions(mend: Mending, unseen: Collection[frozenset[int]] = ()) -> None:
    """Note the faces that are drawn twice; ``unseen`` faces, which two objects share, are contacts."""
    part, materials = mend.repeated
    for row, other, area in zip(part.rows(), materials, part.areas.tolist(), strict=True):
        face, own, name = row
        if frozenset(face) in unseen:
            mend.found("contact", [f'"{name}" on another'], area, 0.0, -2 * area)
            continue
        # Of two materials either may be the one that is meant.
        unsure = [(m, area / np.sqrt(2)) for m in (own, other) if own != other]
        name += f", {own} on {other}" if own != other else ""
        mend.found("twice", [name], area, 0.0, -area, unsure=unsure)


def snapped(part: FaceSet) -> FaceSet:
    """Return the faces with corners that are near an edge moved onto it."""
    mend, before = part.mend, part.areas
    moved: dict[int, float] = {}
    for _ in range(4):
        shift = _snap(part)
        moved |= {v: max(moved.get(v, 0.0), distance) for v, distance in shift.items()}
        if not shift:
            break
    if moved:
        shifts = [float(np.mean([moved.get(v, 0.0) for v in face])) for face in part.faces]
        changes = np.subtract(before, part.areas).tolist()
        mend.found(
            "joint",
            [mend.place(v) for v in moved],
            done=f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
            uncertainty=float(np.linalg.norm(np.multiply(before, shifts))),
            unsure=zip(part.materials, changes, strict=True),
        )
    return cleaned(part)


def _snap(part: FaceSet) -> dict[int, float]:
    """Move corners that are near an edge onto it, and return by how much in m each."""
    mend = part.mend
    edges = sorted({edge for face in part.faces for edge in edges_of(face)})
    ends = mend.points[np.array(edges)]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = cKDTree(mend.points).query_ball_point(ends.mean(axis=1), lengths / 2 + mend.weld)
    best: dict[int, tuple[float, Array]] = {}
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
            if distance[k] < best.get(corners[k], (np.inf,))[0]:
                best[corners[k]] = float(distance[k]), feet[k]
    for v, (_, foot) in best.items():
        mend.points[v] = foot
    return {v: distance for v, (distance, _) in best.items()}


def joined(part: FaceSet) -> FaceSet:
    """Return the faces with neighbours in one plane and of one material and name as one polygon.

    A group grows from its largest triangle, in whose plane all its corners are.
    """
    mend, points = part.mend, part.mend.points
    if len(part.faces) < 8 or not all(len(f) == 3 for f in part.faces):
        return part
    sides: dict[Edge, list[int]] = {}
    for i, face in enumerate(part.faces):
        for edge in edges_of(face):
            sides.setdefault(edge, []).append(i)
    normals = vector_areas(points, part.faces)
    sizes = np.linalg.norm(normals, axis=1)
    normals /= sizes[:, np.newaxis]
    links: list[list[int]] = [[] for _ in part.faces]
    for i, j in (pair for pair in sides.values() if len(pair) == 2):
        if part.materials[i] == part.materials[j] and abs(normals[i] @ normals[j]) > 0.99:
            links[i].append(j)
            links[j].append(i)
    done = [False] * len(part.faces)
    out = FaceSet(mend)
    for first in np.argsort(-sizes, kind="stable").tolist():
        if done[first]:
            continue
        done[first] = True
        members, normal = [first], normals[first]
        offset = float(points[part.faces[first][0]] @ normal)
        for i in members:  # the list grows during the loop
            for j in links[i]:
                away = points[part.faces[j]] @ normal - offset
                if not done[j] and np.abs(away).max() < PLANARITY * 0.45:
                    done[j] = True
                    members.append(j)
        for face in outlined(mend, [part.faces[i] for i in members]):
            out.add(face, part.materials[first], part.names[first])
    return out


def outlined(mend: Mending, faces: list[Face]) -> list[Face]:
    """Return faces of one plane as one polygon; unchanged if it has a hole or several parts."""
    if len(faces) == 1:
        return faces
    count = Counter(edge for face in faces for edge in edges_of(face))
    loops = loops_of([edge for edge, n in count.items() if n == 1])
    if loops is None or len(loops) != 1:
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
    for face, material, name in part.rows():
        corners = mend.points[face]
        off = Polygon(corners).thickness(corners)
        if off <= PLANARITY * 0.9:
            out.add(face, material, name)
            continue
        pieces = [[face[k] for k in piece] for piece in triangulate(corners)]
        for piece in pieces:
            out.add(piece, material, name)
        if off > mend.weld:  # else it is a joint's, noted already
            area, folded = area_of(corners), sum(area_of(mend.points[piece]) for piece in pieces)
            mend.found("bent", [name], area, unsure=[(material, folded - area)])
    return out


# -- the shell, and its holes

_HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = (
    "close the hole with a face, or delete the faces at its edge if they are none of the room's"
)


def shell_of(part: FaceSet) -> tuple[FaceSet, list[FaceSet]]:
    """Return the shell of the room, which may have holes, and the other components.

    The shell encloses all: its box is the largest, and no flat component's is a room's. A face between
    it and an object is its, too.
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
    for part in others if missing else ():
        if {*part.open_edges()} <= missing and len(part.faces) == 1:
            shell.extend(part)
    return shell, [p for p in others if p.faces[0] not in shell.faces]


def without_holes(part: FaceSet, others: Sequence[FaceSet]) -> FaceSet:
    """Return the shell with its small holes closed; MeshError for a large one."""
    mend, missing = part.mend, part.open_edges()
    if not missing:
        return part
    largest = _HOLE_SHARE * part.size if mend.largest_hole is None else mend.largest_hole
    loops = loops_of(missing)
    if loops is None:
        a, b = next(iter(missing))
        raise mend.refused(
            f"{len(missing)} open edges, the first from {mend.place(a)} to {mend.place(b)}, do not "
            f"bound a hole: faces are missing or cross each other there; {_LOOPS}",
            missing,
        )
    areas = {k: area_of(mend.points[loop]) for k, loop in enumerate(loops)}
    large = sorted((k for k in areas if areas[k] > largest), key=lambda k: -areas[k])
    if large:
        each = "; ".join(
            f"hole of {rounded(areas[k], 3)} m² at {mend.place(loops[k][0])}, beside "
            f'"{part.names[missing[edges_of(loops[k][:2])[0]]]}"'
            for k in large[:MOST_PLACES]
        )
        more = f" ({len(large)} holes in all)" if len(large) > MOST_PLACES else ""
        raise mend.refused(
            f"{each}{more}; only holes up to {rounded(largest, 3)} m² are closed automatically. "
            f"{_hint(part, loops[large[0]], others)}",
            missing,
        )
    for loop, area in zip(loops, areas.values(), strict=True):
        ends = mend.points[[*loop, loop[0]]]
        longest = int(np.argmax(np.linalg.norm(np.diff(ends, axis=0), axis=1)))
        beside = edges_of([loop[longest], loop[longest - len(loop) + 1]])[0]
        material = part.materials[missing[beside]]
        mend.found(
            "hole",
            [f"at {mend.place(loop[0])}, {material}"],
            area,
            surface=area,
            uncertainty=area**1.5 / 4,
            unsure=[(material, ANY_SHARE * area)],  # it may be of another material
        )
        part.add(loop, material, "closed hole")
    part = flattened(part)
    if again := part.open_edges():
        a, b = next(iter(again))
        raise mend.refused(
            f"a hole at {mend.place(a)} to {mend.place(b)} cannot be closed by one face; {_LOOPS}",
            again,
        )
    return part


def _hint(part: FaceSet, loop: Face, others: Sequence[FaceSet]) -> str:
    """Return how a hole may be mended: faces whose corners nearly meet its edges ask for a weld."""
    points, own = part.mend.points, {v for face in part.faces for v in face}
    beside = sorted({v for other in others for face in other.faces for v in face} - own)
    if beside:
        away, _ = cKDTree(points[beside]).query(points[loop])
        if (distance := float(np.median(away))) < _NEAR:
            return (
                f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: use --weld "
                f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            )
    enough = rounded(1.01 * area_of(points[loop]), 3)  # more than the area, as printed
    return f"In your program, {_LOOPS}; or use --hole {enough}"


def as_drawn(shell: FaceSet, others: Sequence[FaceSet], error: MeshError) -> MeshError:
    """Return the error of a shell that is open with the room as it is drawn: V by rays.

    Rays cross the shell and closed objects. They cross all faces where the shell has less than half of
    the area: then the walls do not meet.
    """
    areas: dict[str, float] = {}
    for part in (shell, *others):
        for area, material in zip(part.areas.tolist(), part.materials, strict=True):
            areas[material] = areas.get(material, 0.0) + area
    is_whole = 2 * shell.size > sum(areas.values())
    crossed = [p for p in others if not is_whole or not p.open_edges()]
    volume, u = volume_by_rays([p for part in (shell, *crossed) for p in part.polygons])
    size, notes = tuple(np.ptp(shell.points, axis=0).tolist()), shell.mend.drawn.notes
    error.unclosed = Mended(None, volume, u, areas, size, error.defects, notes)
    named = [(p.materials, p.polygons) for p in (shell, *crossed)]
    faces = [
        (f"{m} {i}", m, q) for part in named for i, (m, q) in enumerate(zip(*part, strict=True), 1)
    ]
    with suppress(DataError):  # that the faces bound nothing is in the message
        error.leaking = Polyhedron.from_polygons(faces, leaks=True)
    return error


_LINES = 64
"""Lines along each side of the picture, 4096 in each direction."""
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians about x, y and z, so that no line lies in a wall."""
_NEIGHBOURHOOD = 9
_GUESSED = 0.3
"""Relative standard uncertainty of the part of lines with an odd number of crossings."""


def volume_by_rays(polygons: Sequence[Array]) -> tuple[float, float]:
    """Return the volume in m³ within polygons, (n, 3) in m each, and its standard uncertainty in m³."""
    corners = np.concatenate(
        [
            polygon[np.array(triangulate(polygon), dtype=int).reshape(-1, 3)]
            for polygon in map(np.asarray, polygons)
        ]  # a polygon without area has no triangle
    )
    if not len(corners):
        return 0.0, 0.0
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
    if not step.all():
        return 0.0, 1.0
    lines, depths = [], []
    for a, b, c in corners:
        first, second = b - a, c - a
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < 1e-12:
            continue
        ends = np.array([a, b, c])[:, :2]
        start = np.ceil((ends.min(axis=0) - low[:2]) / step - 0.5).astype(int)
        stop = np.floor((ends.max(axis=0) - low[:2]) / step + 0.5).astype(int)
        (i, k), (m, n) = start.clip(0), stop.clip(max=_LINES)
        rows, columns = np.mgrid[i:m, k:n]
        x = low[0] + step[0] * (rows + 0.5) - a[0]
        y = low[1] + step[1] * (columns + 0.5) - a[1]
        u = (x * second[1] - y * second[0]) / area
        v = (first[0] * y - first[1] * x) / area
        met = (u >= 0) & (v >= 0) & (u + v <= 1)
        lines.append((rows * _LINES + columns)[met])
        depths.append((a[2] + u * first[2] + v * second[2])[met])
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

_FACING = -0.999
"""Largest product of the normals of faces that face each other."""
_BEFORE = 5e-4
"""Distance in m before a face at which there is air."""
COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""
_LEAST_ENCLOSED = 0.99
"""Least share of the shell's volume that spaces between faces have, if no face has a gap around it."""
_MOST_OF_ROOM = 1 / 3
"""Largest share of the walls that an object has behind it: faces that have more divide a room."""
Cut = tuple[Any, str, str]
"""A shape on a face, with the material and the name of what lies there."""


class Walls:
    """The faces of a shell and of the objects in it, to be found by where they are.

    ``outward`` are normals out of the room's air (n, 3), and 0 where both sides may be in it.
    """

    def __init__(self, shell: FaceSet, normals: Array) -> None:
        self.mend, self.all = shell.mend, FaceSet(shell.mend)
        self.planes, self.outward = list[Polygon](), np.zeros((0, 3))
        self._boxes = np.zeros((0, 2, 3))
        self.add(shell, normals)

    def add(self, part: FaceSet, normals: Array | None = None) -> None:
        """Add the faces of the shell, or of an object in it."""
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin = 2 * OFFSET + self.mend.weld
        boxes = [(p.min(axis=0) - margin, p.max(axis=0) + margin) for p in part.polygons]
        self._boxes = np.concatenate([self._boxes, boxes])
        self.planes += map(Polygon, part.polygons)
        outward = np.zeros((len(boxes), 3)) if normals is None else normals
        self.outward = np.concatenate([self.outward, outward])
        self.all.extend(part)

    def near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return the number and the plane of each face that may touch an object with these corners."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        near = ((self._boxes[:, 0] <= high) & (low <= self._boxes[:, 1])).all(axis=1)
        return [(i, self.planes[i]) for i in np.flatnonzero(near).tolist()]


def overlaid_on(walls: Walls, part: FaceSet) -> list[tuple[int, list[Cut], float]] | None:
    """Return the pieces of a plane component on each wall, and how far they are; None if on none."""
    mend, corners = part.mend, part.points
    normal, thick = best_plane(corners)
    if thick > max(mend.weld, PLANARITY):
        return None
    found = list[tuple[int, list[Cut], float]]()
    for i, wall in walls.near(corners):
        distance = wall.thickness(corners)
        if abs(float(wall.normal @ normal)) < 0.99 or distance > OFFSET:
            continue
        pieces: list[Cut] = [
            (piece, material, name)
            for face, material, name in part.rows()
            for piece in polygons_of(common(wall, mend.points[face], mend.weld), mend.weld**2)
        ]
        if pieces:
            found.append((i, pieces, distance))
    nearest = min((distance for *_, distance in found), default=0.0)
    found = [each for each in found if each[2] <= nearest + mend.weld]
    total = sum(float(piece.area) for _, pieces, _ in found for piece, _, _ in pieces)
    return found if found and total >= COVERED * part.size else None


def common(wall: Polygon, corners: Array, snap: float) -> Any:
    """Return the part that a polygon shares with a wall; corners near the wall's are moved to them."""
    return shapely().snap(wall.polygon(corners), wall.shape, snap).intersection(wall.shape)


def put_on_walls(walls: Walls, part: FaceSet, outward: Array, n_shell: int) -> FaceSet:
    """Return a closed object whose faces within ``weld`` of a wall that they face are moved onto it.

    So are those that reach through it by up to `OFFSET`: contacts. Wider gaps up to `OFFSET`, over a
    whole face and to one of the ``n_shell`` faces of the shell, are noted. ``outward`` are the faces'
    normals out of the air.
    """
    mend, gaps, widest = part.mend, list[tuple[str, float]](), 0.0
    for i, normal in enumerate(outward):
        size = area_of(part.corners(i))
        for j, wall in walls.near(part.corners(i)):
            corners, of_wall = part.corners(i), walls.outward[j]
            away = -(corners - wall.corners.mean(axis=0)) @ of_wall
            if not of_wall.any():  # of an open object, on either of whose sides this one may be
                of_wall = wall.normal * -np.sign(wall.normal @ normal)
                away = np.abs(wall.away(corners))
            deepest = mend.weld + OFFSET * (j < n_shell)
            if of_wall @ normal > _FACING or away.min() < -deepest:
                continue
            shapes = polygons_of(common(wall, corners, FINE))
            shapes = [s for s in shapes if s.area > mend.weld * extent_of(ring_of(s)) / 2]
            shared, gap = sum(float(s.area) for s in shapes), float(away.max())
            place = f'"{part.names[i]}" %s "{walls.all.names[j]}"'
            if shapes and gap <= mend.weld:
                # What the object's other faces have gained or lost there.
                longer = ANY_SHARE * wall.thickness(corners) * sum(float(s.length) for s in shapes)
                mend.points[part.faces[i]] = wall.onto(corners) + wall.bend * of_wall
                unsure = [(part.materials[i], longer)]
                mend.found("contact", [place % "on"], shared, 0.0, -2 * shared, unsure=unsure)
            elif shared > COVERED * size and gap <= OFFSET and j < n_shell:
                gaps.append((place % "before", size))
                widest = max(widest, gap)
    if gaps:
        mend.found(
            "gap",
            [place for place, _ in gaps],
            sum(size for _, size in gaps),
            done=f"faces of closed objects are up to {widest * 1000:.2g} mm in front of a wall, "
            f"and both areas are counted; use --weld {1.1 * widest:.2g} if they touch",
        )
    return flattened(part)


def stood_on_walls(walls: Walls, part: FaceSet) -> tuple[FaceSet, list[tuple[str, float]]]:
    """Return an open object whose open edges within `OFFSET` of walls are moved onto them.

    Its faces gain or lose what lies between them and the wall: of each material there the standard
    uncertainty of its area in m².
    """
    mend, edges, middle = part.mend, part.open_edges(), part.points.mean(axis=0)
    for corners in part.faces:
        for i, _, far in overlaid_on(walls, FaceSet(mend, [corners], [""], [""])) or ():
            if far <= mend.weld:
                mend.points[corners] = walls.planes[i].onto(mend.points[corners])
    shift: dict[int, float] = {}
    for v in sorted({v for edge in edges for v in edge}):
        point, used = mend.points[v], list[Polygon]()
        near = [
            (abs(float(wall.away(point))), i, wall) for i, wall in walls.near(point[np.newaxis])
        ]
        for away, _, wall in sorted(near, key=lambda each: each[:2]):
            is_near = away <= OFFSET and wall.beside(point) <= OFFSET
            if is_near and all(abs(float(wall.normal @ other.normal)) < 0.99 for other in used):
                used.append(wall)
        for wall in 4 * used:
            point = wall.onto(point)
        point = point - sum(np.sign(w.away(middle)) * w.bend * w.normal for w in used)
        shift[v] = float(np.linalg.norm(point - mend.points[v]))
        mend.points[v] = point
    unsure: dict[str, float] = {}  # its open edges are all as far off, so their parts add
    for (a, b), face in edges.items():
        gained = ANY_SHARE * extent_of(mend.points[[a, b]]) * max(shift[a], shift[b])
        unsure[part.materials[face]] = unsure.get(part.materials[face], 0.0) + gained
    return flattened(part), [*unsure.items()]


_PLATE = 1e-5
"""Thickness in m of the plates that faces are made of: far above rounding, and below `FINE`."""


@dataclass
class Cell:
    """A space between faces, or a surface in it, whose ``volume`` in m³ is below 0 then.

    ``triangles`` (n, 3, 3) are corners in m. ``sides`` (n,) are 2 i for the front of face i, which its
    normal leaves, 2 i + 1 for its back, and -1 for edges.
    """

    volume: float
    triangles: Array
    sides: Array

    def seen(self, n: int) -> Array:
        """Return the area in m² of the front and the back of each of n faces around it, (n, 2)."""
        edges = self.triangles[:, 1:] - self.triangles[:, :1]
        sizes = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        known = self.sides >= 0
        areas = np.bincount(self.sides[known], sizes[known], 2 * n)
        return np.asarray(areas, dtype=float).reshape(n, 2)


def cells_of(part: FaceSet) -> list[Cell]:
    """Return the spaces that faces enclose, the largest first.

    Each triangle is a thin plate, which reaches over its neighbours' edges. The spaces are the cavities
    in the union of all plates.
    """
    needed = (
        "objects in a room and walls drawn as solids need manifold3d: pip install 'rtcal[mesh]'"
    )
    manifold = library(needed, "manifold3d")
    corners, index = part.triangles()
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
        surfaces.append(Cell(-surface.volume(), found, sides))
    cells = sorted((s for s in surfaces if s.volume > 0), key=lambda s: s.volume)
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


def faces_around(cell: Cell, part: FaceSet, cuts: Mapping[int, Sequence[Cut]]) -> FaceSet:
    """Return what of some faces is around a cell, with what lies on them in its place.

    Of a face with the cell on both sides a plate of `THICKNESS` is made.
    """
    mend, out = part.mend, FaceSet(part.mend)
    flat = cell.triangles.reshape(-1, 3)
    away, number = cKDTree(mend.points).query(flat)
    is_new = away > max(FINE, mend.weld / 10)
    new, of_new = weld_vertices(flat[is_new])
    number[is_new] = len(mend.points) + of_new
    number = number.reshape(-1, 3)
    # Where plates cross, a corner is off by half of their thickness.
    edges = cell.triangles - np.roll(cell.triangles, 1, axis=1)
    normals = np.cross(edges[:, 0], edges[:, 1])
    sizes, longest = (np.linalg.norm(x, axis=-1) for x in (normals, edges))
    wide = (cell.sides >= 0) & (sizes > FINE * longest.max(axis=1))
    at: dict[int, list[tuple[Array, float]]] = {}
    for k in np.flatnonzero(wide & (number >= len(mend.points)).any(axis=1)):
        normal = normals[k] / sizes[k]
        for v in number[k]:
            plane = normal, float(cell.triangles[k, 0] @ normal) - _PLATE / 2
            at.setdefault(v - len(mend.points), []).append(plane)
    for v, planes in at.items():
        if v >= 0:
            of_planes, offsets = map(np.array, zip(*planes, strict=True))
            new[v] += np.linalg.lstsq(of_planes, offsets - of_planes @ new[v], rcond=1e-2)[0]
    mend.new_points(new)
    around: dict[int, tuple[list[Face], list[Face]]] = {}
    for face, side in zip(number.tolist(), cell.sides.tolist(), strict=True):
        if side >= 0 and len({*face}) == 3:
            around.setdefault(side // 2, ([], []))[side % 2].append(face)
    for i, both in sorted(around.items()):
        material, name = part.materials[i], part.names[i]
        if i not in cuts and not all(both):
            for face in outlined(mend, both[0] or both[1]):
                out.add(face, material, name)
            continue
        wall = Polygon(part.corners(i))
        front, back = (
            shapely().union_all([wall.polygon(mend.points[face]) for face in side]) for side in both
        )
        for piece in polygons_of(front.intersection(back), mend.weld**2):
            _add_plate(out, wall, piece, material, name)
        once, taken = front.symmetric_difference(back), shapely().Polygon()
        smaller = sorted(cuts.get(i, ()), key=lambda c: float(c[0].area))
        for shape, own, called in [*smaller, (once, material, name)]:
            for piece in polygons_of(shape.intersection(once).difference(taken), mend.weld**2):
                _add_piece(out, wall, piece, own, called)
            taken = taken.union(shape)
    return flattened(out.kept([2 * area_of(p) > FINE * extent_of(p) for p in out.polygons]))


def _add_piece(part: FaceSet, wall: Polygon, piece: Any, material: str, name: str) -> None:
    """Add a piece in a wall's plane, in triangles if it has holes."""
    whole = not piece.interiors
    rings = [piece] if whole else polygons_of(shapely().constrained_delaunay_triangles(piece))
    for ring in rings:
        part.add(part.mend.new_points(wall.lifted(ring_of(ring))), material, name)


def _add_plate(part: FaceSet, plane: Polygon, shape: Any, material: str, name: str) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    mend, half = part.mend, plane.normal * THICKNESS / 2
    for piece in polygons_of(shape.buffer(-THICKNESS / 2, join_style="mitre")):
        corners = plane.lifted(ring_of(piece))
        front, back = mend.new_points(corners + half), mend.new_points(corners - half)
        part.add(front, material, name)
        part.add(back[::-1], material, f"{name} back")
        for k in range(len(front)):
            part.add([front[k], front[k - 1], back[k - 1], back[k]], material, f"{name} edge")


@dataclass
class _Placed:
    """A component in the room: its ``faces`` among all, and whether it is open, and within the walls.

    ``unsure`` are standard uncertainties of area in m² by material.
    """

    part: FaceSet
    faces: slice
    is_open: bool
    is_in: bool
    unsure: Sequence[tuple[str, float]]


def room_of(
    shell: FaceSet, others: Sequence[FaceSet], as_it_is: Polyhedron | None = None
) -> Polyhedron:
    """Return the room in a closed shell, with the objects, panels and overlays in it.

    ``as_it_is`` is the room itself if no object touches another face. Raises DataError if the faces
    around it do not close.
    """
    mend, hull = shell.mend, shell.polyhedron()
    for part in others:
        if 2 * _volume(part) > hull.volume and hull.contains(part.points).all():
            outer, shell, hull = shell, part, part.polyhedron()
            others = [outer, *(p for p in others if p is not part)]
            break  # the walls are drawn with their thickness
    walls, cuts = Walls(shell, hull.normals), dict[int, list[Cut]]()
    placed, outside = list[_Placed](), list[FaceSet]()
    for part in sorted(others, key=lambda p: (p.is_plane, 0.0 if p.is_plane else -p.size)):
        is_in, is_plane, is_open = is_within(hull, part), part.is_plane, bool(part.open_edges())
        unsure, outward = list[tuple[str, float]](), None
        if is_plane and not is_in:
            reaches = _reaches_into(hull, part)
            kind = "partly outside" if reaches else "outside"
            shares = zip(part.materials, (reaches * ANY_SHARE * part.areas).tolist(), strict=True)
            mend.found(kind, part.names[:1], part.size, unsure=shares)
            outside.append(part)
            continue
        if is_open and (on := overlaid_on(walls, part)) is not None:
            for wall, pieces, _ in on:
                cuts.setdefault(wall, []).extend(pieces)
            each = [(shape, m, far) for _, pieces, far in on for shape, m, _ in pieces]
            moved = sum(far * float(shape.area) for shape, _, far in each)
            # The reveal from the wall to the face is not drawn; it may be of the face's material.
            reveals = [(m, ANY_SHARE * far * float(shape.length)) for shape, m, far in each]
            mend.found("overlay", part.names[:1], part.size, moved, -part.size, unsure=reveals)
            continue
        if not is_open:
            part = put_on_walls(walls, part, -part.polyhedron().normals, len(shell.faces))
            outward = -part.polyhedron().normals
        elif not is_plane:
            part, unsure = stood_on_walls(walls, part)
        first = len(walls.planes)
        walls.add(part, outward)
        faces = slice(first, len(walls.planes))
        placed.append(_Placed(part, faces, is_open, is_in, unsure))
    if as_it_is is not None and not any(d.kind == "contact" for d in mend.defects):
        return as_it_is
    triangles, faces_of = shell.triangles()
    cell, unseen = Cell(hull.volume, triangles, 2 * faces_of), set[frozenset[int]]()
    if placed:
        cell, *enclosed = cells_of(walls.all)
        if cell.volume + sum(c.volume for c in enclosed) < _LEAST_ENCLOSED * hull.volume:
            raise DataError(
                "the walls do not close: there is a gap between faces of objects or walls"
            )
        _require_one_room(mend, [cell, *enclosed], walls, len(shell.faces))
        around = cell.seen(len(walls.planes)).sum(axis=1)
        rows = zip(walls.all.faces, around.tolist(), strict=True)
        unseen = {frozenset(face) for face, seen in rows if seen < SAME}
        outside += _noted(placed, cell, enclosed, len(walls.planes))
    note_repetitions(mend, unseen)
    _require_shell(shell, outside)
    return faces_around(cell, walls.all, cuts).polyhedron()


def _volume(part: FaceSet) -> float:
    """Return the volume in m³ of a component; 0.0 if it is open."""
    try:
        return 0.0 if part.open_edges() else float(part.polyhedron().volume)
    except DataError:
        return 0.0


def _require_one_room(mend: Mending, cells: Sequence[Cell], walls: Walls, n_shell: int) -> None:
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


def _noted(
    placed: Sequence[_Placed], room: Cell, enclosed: Sequence[Cell], n: int
) -> list[FaceSet]:
    """Note what the components are by which of their sides the room has; return those outside it."""
    volume, covered = np.zeros(len(placed)), np.zeros(len(placed))
    for cell in enclosed:
        seen = cell.seen(n).sum(axis=1)
        shares = [float(seen[p.faces].sum()) for p in placed]
        k = int(np.argmax(shares))
        volume[k] += cell.volume
        covered[k] += seen.sum() - shares[k]
    outside, of_room = list[FaceSet](), room.seen(n)
    for k, p in enumerate(placed):
        mend, names, size = p.part.mend, p.part.names[:1], p.part.size
        both = 2 * float(of_room[p.faces].min(axis=1).sum())
        once = float(of_room[p.faces].sum()) - both
        if once + both < SAME:
            if frozenset(p.part.faces[0]) not in map(frozenset, mend.repeated[0].faces):
                mend.found("outside", names, size)
                outside += [p.part] * p.is_open
            continue
        if not p.is_in:
            mend.found("through", names, size - once - both / 2)
        if both > mend.weld**2:
            mend.found("panel", names, both / 2, -THICKNESS * both / 2, both / 2)
        if p.is_open and once > both:
            surface = once - float(covered[k])
            mend.found("open bottom", names, size, -float(volume[k]), surface, unsure=p.unsure)
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


def is_within(hull: Polyhedron, part: FaceSet) -> bool:
    """Return whether a component is in the room: its corners, but for those at the walls, are."""
    outside = part.points[~hull.contains(part.points)]
    return not (hull.wall_distance(outside) > OFFSET + part.mend.weld).any()


def _reaches_into(hull: Polyhedron, part: FaceSet) -> bool:
    """Return whether an edge of a component is in the room, and not merely at its walls."""
    ends = part.mend.points[[edge for face in part.faces for edge in edges_of(face)]]
    shares = np.linspace(0, 1, 9)[:, np.newaxis, np.newaxis]
    points = (ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    inside = points[hull.contains(points)]
    return bool((hull.wall_distance(inside) > OFFSET + part.mend.weld).any())


# -- walls that are drawn as solids

_THIN = 0.8
"""Mean chord in m, 4 V / S, below which a solid is a wall or a slab: that of a wall is twice its
thickness at most, that of a cube of 5 m³ is 1.1 m."""
_LEAST_SHARE = 0.05
"""Least volume of the room, as a share of that of the box around the solids."""


def room_between(part: FaceSet) -> FaceSet | None:
    """Return the faces around the largest cavity between closed solids, which is noted.

    None if the faces are not several closed solids, or if one is a room that may hold the others.
    Raises MeshError if all solids are thin and enclose no cavity, so that their faces bound material
    and not air.
    """
    mend = part.mend
    groups = _solids(part.faces)
    if groups is None or len(groups) < 2:
        return None
    try:
        solids = [part.of(group).polyhedron() for group in groups]
    except DataError:  # a solid that reaches through itself
        return None
    thin = [4 * s.volume < _THIN * float(np.sum(s.face_areas)) for s in solids]
    if not any(thin):
        return None

    def is_air(cell: Cell) -> bool:
        """Return whether a space is in no solid, just before its largest triangle."""
        a, b, c = np.moveaxis(cell.triangles, 1, 0)
        normals = np.cross(b - a, c - a)  # out of the plates, and so into the space
        k = int(np.argmax(np.linalg.norm(normals, axis=1)))
        point = cell.triangles[k].mean(axis=0) + _BEFORE * normal_of(cell.triangles[k])
        return all(abs(winding_number(point[np.newaxis], s.triangles)[0]) < 0.5 for s in solids)

    cavities = [cell for cell in cells_of(part) if is_air(cell)]
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
    mend.found("solids", [part.names[group[0]] for group in groups], done=done)
    return faces_around(room, part, {})


def _solids(faces: Sequence[Face]) -> list[list[int]] | None:
    """Return the faces of each solid: in the file's order, until each edge has two faces.

    None if some edge has one face only in the end.
    """
    solids: list[list[int]] = []
    solid: list[int] = []
    open_edges: set[Edge] = set()
    for i, face in enumerate(faces):
        solid.append(i)
        open_edges.symmetric_difference_update(edges_of(face))
        if not open_edges:
            solids.append(solid)
            solid = []
    return None if solid else solids


def mended(faces: Faces, *, weld: float = WELD, largest_hole: float | None = None) -> Mended:
    """Return the closed room that the faces of a mesh bound, with the defects that were repaired.

    Faces that close as they are drawn are not changed; closed objects stand in the room, without the
    parts that touch other faces. Corners within ``weld`` (m) of each other become one. Holes up to
    ``largest_hole`` (m²) are closed, by default 1 % of the area of the walls. Raises MeshError for a
    mesh without a closed room; it names the defect, the place and the repair.
    """
    for name, value, unit in (("weld", weld, "m"), ("largest_hole", largest_hole or 0.0, "m²")):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} {unit} must be finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: the mesh has no face; a room needs at least 4")
    if len(faces.polygons) > 20 * MOST_FACES:
        raise DataError(
            f"{faces.path}: has {len(faces.polygons)} faces; at most {20 * MOST_FACES} are read"
        )
    if (closed := _closed_as_drawn(faces, weld)) is not None:
        return closed
    drawn = welded(Mending(faces, max(weld, SAME), largest_hole))
    part = room_between(drawn) or drawn
    part = flattened(snapped(joined(without_repetitions(part))))
    mend, (shell, others) = part.mend, shell_of(part)
    try:
        shell = without_holes(shell, others)
    except MeshError as error:
        note_repetitions(mend)
        # What else there is; nothing is cut, since nothing is in a room.
        walls = Walls(shell, np.zeros((len(shell.faces), 3)))
        for part in others:
            kind = "panel" if part.open_edges() else "object"
            kind = "overlay" if kind == "panel" and overlaid_on(walls, part) else kind
            shell.mend.found(kind, part.names[:1], part.size, done=_LOOSE * (kind == "panel"))
        refused = mend.refused(error.reason)
        refused.edges = error.edges
        raise as_drawn(shell, others, refused) from None
    try:
        if len(part.faces) > MOST_FACES:
            raise mend.refused(f"{len(part.faces)} faces; at most {MOST_FACES}: simplify the model")
        return mend.result(room_of(shell, others))
    except DataError as error:
        refused = error if isinstance(error, MeshError) else mend.refused(f"after mending, {error}")
        raise as_drawn(shell, others, refused) from error


def _closed_as_drawn(faces: Faces, weld: float) -> Mended | None:
    """Return the room of faces that close as they are drawn, its objects within; None of others."""
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    mend = Mending(faces, max(weld, SAME))
    polygons = zip(numbered(faces.names), faces.materials, faces.polygons, strict=True)
    try:
        geometry = Polyhedron.from_polygons(list(polygons))
        mend.points = np.array(geometry.vertices)
        part = FaceSet(mend, map(list, geometry.faces), geometry.materials, geometry.names)
        shell, others = shell_of(part)
        hull = shell.polyhedron()
        if not all(is_within(hull, other) for other in others):
            return None
        return mend.result(room_of(shell, others, geometry))
    except DataError:  # not closed, or a defect that is named later
        return None
