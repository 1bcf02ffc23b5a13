"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge;
4. a face on a larger one (a window on its wall, up to `OFFSET` before it) takes its area;
5. an object that stands on a face with an open bottom takes its footprint from that face;
6. a free panel becomes a reflector with two sides, `THICKNESS` thick;
7. what lies outside the shell is left out, and a solid that reaches through it ends there;
8. where a closed object touches a face, neither counts.

Each is a `Defect` with its number, area and effects on V and S. What cannot be mended safely is
refused, and the message says how to mend it in the program that drew it. All other defects are listed
with it, so that they can be mended in one go. Needs shapely
(``rtcal[mesh]``) where a face is to be cut.

Walls that are drawn as closed solids, as building models and CAD programs do, bound material: the room
is the largest cavity in the union of all solids (manifold3d). The volume of a room whose faces do not
close is taken by lines through what is drawn: parallel lines in three directions cross the walls.
Between its first and second crossing, its third and fourth, a line is in the room. A line with an odd
number of crossings went through a hole, and takes the mean of its neighbours. Where holes face each
other a direction is wrong and the others are not, so their spread is the uncertainty.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import add
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
    winding_number,
)
from rtcal.simulators.geometry import WELD as FINE
from rtcal.simulators.geometry import area as area_of
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.text import listed, rounded
from rtcal.support.types import Array

__all__ = ["WELD", "Defect", "Faces", "Mended", "MeshError", "mended"]
__dir__ = __all__.copy


WELD = 0.01
"""Default distance in m: models are drawn to the centimetre, and no wavelength is as short."""
OFFSET = 0.05
"""Default distance in m up to which a face lies on another: the depth of a window's frame."""
MOST_FACES = 6000
MOST_PLACES = 5
SAME = 1e-6
"""Distance in m, and area in m², below which two are one."""
ANY_SHARE = 1 / np.sqrt(3)
"""Of an area of which any share may count, all shares alike: rms of what is missing or too much."""
CONTACT = "faces of closed objects touch others: the room has neither there"
_SHOWN = 1e-6
"""Smallest effect in m³ and m² that is printed: smaller ones are rounding."""
_OF_ANY_SHARE = ("overlay", "contact")
"""Kinds of defects of whose effect on V any share may be meant."""

Face = list[int]


@dataclass(frozen=True)
class Faces:
    """The faces of a mesh as they are drawn.

    Parameters
    ----------
    path : str
        The file's name, for messages.
    polygons : sequence of array (n, 3)
        Corners in m.
    materials, names : sequence of str
    notes : sequence of str
        What the reader did: units, axes.
    unit : float, optional
        Length of the file's unit in m as the user, the file or its format states it.
    """

    path: str
    polygons: Sequence[Array]
    materials: Sequence[str]
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    unit: float | None = None


@dataclass(frozen=True)
class Defect:
    """A kind of defect, and what was done.

    Parameters
    ----------
    kind : str
        "joint", "sliver", "twice", "bent", "hole", "overlay", "open bottom", "panel",
        "partly outside", "outside", "through", "contact", "gap", "solids".
    number : int
    area : float
        Of the faces concerned, in m².
    volume_effect, area_effect : float
        Change of V in m³ and of S in m² by mending.
    volume_uncertainty : float
        Standard uncertainty of V in m³ that remains.
    places : sequence of str
        Names or corners of the first few.
    done : str
        What was done, in words.
    area_uncertainty : mapping of str to float
        Standard uncertainty of each material's area in m² that remains.
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
    """A room as it was read from a mesh, and what was mended.

    Parameters
    ----------
    geometry : Polyhedron or None
        None for a room whose walls do not close, as it is drawn: no tracer takes it.
    volume, volume_uncertainty : float
        In m³; of a room that does not close by rays (`volume_by_rays`).
    areas : mapping of str to float
        Area of each material in m². Where the walls do not close, every face once, and what is missing
        is not in it.
    size : sequence of float
        Lengths along x, y and z in m of the box around it.
    defects : sequence of Defect
    notes : sequence of str
        What the reader of the file did: units, axes.
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
            head = f"V = {rounded(self.volume, 4)}{spread} m³ by rays, S = {total:.6g} m² as drawn"
            head += ", not closed"
        else:
            head = f"V = {self.volume:.6g}{spread * (u > _SHOWN)} m³, S = {total:.6g} m²"
            head += f", {len(self.geometry.faces)} faces"
        head += f", x × y × z = {' × '.join(rounded(x, 3) for x in self.size)} m"
        rows = [f"{area:10.3f} m²  {name}" for name, area in self.areas.items()]
        found = [f"  {defect}" for defect in self.defects] or ["  none"]
        return "\n".join([head, *rows, "defects:", *found])


class MeshError(DataError):
    """A mesh that is refused.

    ``reason`` is why, ``defects`` are all that were found, ``edges`` (n, 2, 3) are where it is open, in
    m. ``unclosed`` is the room as it is drawn, if there is a shell.
    """

    reason = ""
    defects: tuple[Defect, ...] = ()
    edges: Array = np.zeros((0, 2, 3))
    unclosed: Mended | None = None


def combined(parts: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the root of the sum of squares by name, where it is not 0."""
    total: dict[str, float] = {}
    for name, part in parts:
        total[name] = float(np.hypot(total.get(name, 0.0), part))
    return {name: u for name, u in total.items() if u > 0}


class Mending:
    """One mesh while it is mended; ``points`` are the corners in m of all its parts.

    ``buried`` are points (3,) of faces that two closed objects had in common.
    """

    def __init__(
        self,
        drawn: Faces,
        weld: float,
        largest_hole: float | None = None,
        points: Array | None = None,
    ) -> None:
        self.drawn, self.path = drawn, drawn.path
        self.weld, self.largest_hole = weld, largest_hole
        self.points: Array = np.zeros((0, 3)) if points is None else np.array(points)
        self.buried: list[Array] = []
        self._found: dict[tuple[str, str], Defect] = {}

    @property
    def defects(self) -> tuple[Defect, ...]:
        """What was found, each kind once."""
        return tuple(self._found.values())

    def found(
        self,
        kind: str,
        done: str,
        places: Sequence[str],
        area: float = 0.0,
        volume: float = 0.0,
        surface: float = 0.0,
        uncertainty: float = 0.0,
        unsure: Iterable[tuple[str, float]] = (),
    ) -> None:
        """Note a defect at these places, with its effects in m², m³ and m²; those of a kind are one.

        ``unsure`` are materials with a standard uncertainty of area in m² each.
        """
        none = self._found.get((kind, done)) or Defect(kind, 0, 0.0, 0.0, 0.0, 0.0, (), done)
        u, places = combined(unsure), tuple(places)
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

    def new_points(self, corners: Array) -> range:
        """Add corners (n, 3) in m, and return their numbers."""
        first = len(self.points)
        self.points = np.concatenate([self.points, corners])
        return range(first, len(self.points))

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

    def onto(self, points: Array) -> Array:
        """Return points (..., 3) moved onto the plane."""
        return np.asarray(points - self.away(points)[..., np.newaxis] * self.normal)

    def polygon(self, corners: Array) -> Any:
        """Return corners (n, 3) as a shape in the axes, made valid."""
        polygon = shapely().Polygon(corners @ self.axes.T)
        return polygon if polygon.is_valid else polygon.buffer(0)

    def seen(self, shape: Any, other: Polygon) -> Any:
        """Return a shape in the axes of another polygon's plane in these axes."""
        return shapely().transform(shape, lambda flat: other.lifted(flat) @ self.axes.T)

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

    def add(self, face: Iterable[int], material: str, name: str) -> None:
        """Add a face of these corners."""
        self.faces.append(list(face))
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

    def kept(self, which: Sequence[bool]) -> FaceSet:
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
    def areas(self) -> list[float]:
        """The area of each face in m²."""
        return [area_of(polygon) for polygon in self.polygons]

    @property
    def size(self) -> float:
        """The area in m²."""
        return sum(self.areas)

    @property
    def points(self) -> Array:
        """All corners in m, each once, (n, 3)."""
        return np.asarray(self.mend.points[sorted({v for face in self.faces for v in face})])

    @property
    def is_plane(self) -> bool:
        """Whether all corners are near one plane: a sheet."""
        return best_plane(self.points)[1] <= self.mend.weld

    @property
    def edges(self) -> list[Edge]:
        """Each edge once, its lower corner first."""
        return sorted({edge for face in self.faces for edge in edges_of(face)})

    def owners(self) -> dict[Edge, list[int]]:
        """Return the numbers of the faces that meet at each edge, divided at all corners on it."""
        owners = edge_owners(self.mend.points, self.faces)
        return {edge: [i for i, _ in sides] for edge, sides in owners.items()}

    def open_edges(self) -> dict[Edge, int]:
        """Return the pieces of edges at which one face, or an odd number, meets; with one of them."""
        return {e: sides[0] for e, sides in self.owners().items() if len(sides) % 2}

    def components(self) -> list[list[int]]:
        """Return the faces of each component: faces are joined where two meet in an edge."""
        n = len(self.faces)
        pairs = np.array([s for s in self.owners().values() if len(s) == 2], dtype=int)
        links = coo_array((np.ones(len(pairs)), pairs.reshape(-1, 2).T), shape=(n, n))
        number, label = connected_components(links, directed=False)
        return [np.flatnonzero(label == k).tolist() for k in range(number)]

    def polyhedron(self) -> Polyhedron:
        """Return the closed room of the faces; DataError if they do not close."""
        named = zip(numbered(self.names), self.materials, self.polygons, strict=True)
        return Polyhedron.from_polygons(list(named))


def numbered(names: Sequence[str]) -> list[str]:
    """Return names of which no two are alike: "wall", "wall 2" and so on."""
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


def is_flat(corners: Array) -> bool:
    """Return whether a polygon is as plane as a room's face must be."""
    return Polygon(corners).thickness(corners) <= PLANARITY * 0.9


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
    return [(min(a, b), max(a, b)) for a, b in zip([face[-1], *face[:-1]], face, strict=True)]


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


def welded(mend: Mending) -> FaceSet:
    """Return the faces with corners within ``weld`` of each other as one."""
    drawn = np.concatenate([np.asarray(p, dtype=float) for p in mend.drawn.polygons])
    if not np.isfinite(drawn).all():
        raise DataError(f"{mend.path}: a corner is not finite")
    tree = cKDTree(drawn)
    index = np.full(len(drawn), -1)
    groups: list[list[int]] = []
    for i in range(len(drawn)):
        if index[i] < 0:
            near = [k for k in tree.query_ball_point(drawn[i], mend.weld) if index[k] < 0]
            index[near] = len(groups)
            groups.append(near)
    mend.points = np.array([drawn[g].mean(axis=0) for g in groups])
    shifts = np.linalg.norm(mend.points[index] - drawn, axis=1)
    moved = [k for k, g in enumerate(groups) if shifts[g].max() > 1e-4]
    part, first, spread, unsure = FaceSet(mend), 0, 0.0, []
    drawn_rows = zip(mend.drawn.polygons, mend.drawn.materials, mend.drawn.names, strict=True)
    for polygon, material, name in drawn_rows:
        corners = slice(first, first := first + len(polygon))
        points = np.asarray(polygon)
        spread += (area_of(points) * float(shifts[corners].mean())) ** 2
        # A corner moves the area by half of its neighbours' distance; none is drawn better than others.
        across = np.linalg.norm(np.roll(points, 1, axis=0) - np.roll(points, -1, axis=0)) / 2
        unsure.append((material, float(np.sqrt(np.mean(shifts**2)) * across)))
        part.add(map(int, index[corners]), material, name)
    if moved:
        mend.found(
            "joint",
            f"corners that lay up to {2 * shifts.max() * 1000:.2g} mm apart are joined",
            [mend.place(k) for k in moved],
            uncertainty=float(np.sqrt(spread)),
            unsure=unsure,
        )
    return cleaned(part)


def cleaned(part: FaceSet) -> FaceSet:
    """Return the faces without repeated corners, and without slivers."""
    mend = part.mend
    part = FaceSet(mend, map(simplified, part.faces), part.materials, part.names)
    narrow = [
        len(f) < 3 or area_of(mend.points[f]) < mend.weld * extent_of(mend.points[f]) / 2
        for f in part.faces
    ]
    slivers = part.kept(narrow)
    if slivers.faces:
        areas = [
            area if len(f) > 2 else 0.0
            for f, area in zip(slivers.faces, slivers.areas, strict=True)
        ]
        mend.found(
            "sliver",
            f"faces narrower than {mend.weld * 1000:g} mm are dropped",
            slivers.names,
            sum(areas),
            surface=-sum(areas),
            unsure=[(m, ANY_SHARE * a) for m, a in zip(slivers.materials, areas, strict=True)],
        )
    if all(narrow):
        corners = np.concatenate([np.asarray(p) for p in mend.drawn.polygons])
        across = np.linalg.norm(np.ptp(corners, axis=0))
        raise mend.refused(
            f"every face is narrower than the weld distance of {mend.weld * 1000:g} mm: as read, "
            f"the mesh is {across * 1000:.2g} mm across. State a larger --unit, such "
            "as 1 for a mesh drawn in m, or a smaller --weld"
        )
    return part.kept(np.logical_not(narrow).tolist())


def without_repetitions(part: FaceSet) -> FaceSet:
    """Return the faces without those that are drawn twice.

    Of two closed objects that stand on each other both faces go.
    """
    mend = part.mend
    seen: dict[frozenset[int], int] = {}
    firsts = [seen.setdefault(frozenset(face), i) for i, face in enumerate(part.faces)]
    pairs = [(first, i) for i, first in enumerate(firsts) if first != i]
    common = _between_objects(part, firsts, Counter(first for first, _ in pairs)) if pairs else ()
    kept = [first == i for i, first in enumerate(firsts)]
    for first, i in pairs:
        name, own, other = part.names[i], part.materials[i], part.materials[first]
        area = area_of(part.corners(i))
        if first in common:
            kept[first] = False
            mend.found(
                "contact", CONTACT, [f'"{name}" on "{part.names[first]}"'], area, 0.0, -2 * area
            )
            mend.buried.append(part.corners(i).mean(axis=0))
            continue
        # Of two materials either may be the one that is meant.
        unsure = [(m, area / np.sqrt(2)) for m in (own, other) if own != other]
        name += f", {own} on {other}" if own != other else ""
        mend.found(
            "twice", "faces drawn twice are taken once", [name], area, 0.0, -area, 0.0, unsure
        )
    return part.kept(kept)


def _between_objects(part: FaceSet, firsts: Sequence[int], copies: Counter[int]) -> set[int]:
    """Return the first of each two faces that two closed objects, or one and the room, have in common.

    Faces that are drawn twice are joined where no other face meets their edge. They are in common if
    an even number of other faces, and some, meet in each edge around them.
    """
    group = {first: {first} for first in copies}
    around: dict[int, list[int]] = {first: [] for first in copies}
    for sides in part.owners().values():
        drawn = [firsts[i] for i in sides]
        own = {first for first in drawn if first in copies}
        if len(own) > 1 and own.issuperset(drawn):
            joined = set[int]().union(*(group[first] for first in own))
            group.update(dict.fromkeys(joined, joined))
            continue
        for first in own:
            around[first].append(sum(other != first for other in drawn))
    common = set()
    for first, members in group.items():
        others = [n for member in members for n in around[member]]
        once = all(copies[member] == 1 for member in members)
        if once and others and all(n > 0 and n % 2 == 0 for n in others):
            common.add(first)
    return common


def snapped(part: FaceSet) -> FaceSet:
    """Return the faces with corners that are near an edge moved onto it."""
    mend, before = part.mend, part.areas
    moved = _snap(part)
    if moved:
        shifts = [float(np.mean([moved.get(v, 0.0) for v in face])) for face in part.faces]
        changes = np.subtract(before, part.areas).tolist()
        mend.found(
            "joint",
            f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
            [mend.place(v) for v in moved],
            uncertainty=float(np.linalg.norm(np.multiply(before, shifts))),
            unsure=zip(part.materials, changes, strict=True),
        )
    return cleaned(part)


def _snap(part: FaceSet) -> dict[int, float]:
    """Move corners that are near an edge onto it, and return by how much in m each."""
    moved: dict[int, float] = {}
    for _ in range(4):
        shift = _snap_once(part)
        moved |= {v: max(moved.get(v, 0.0), distance) for v, distance in shift.items()}
        if not shift:
            break
    return moved


def _snap_once(part: FaceSet) -> dict[int, float]:
    mend, edges = part.mend, part.edges
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


def rejoined(part: FaceSet) -> FaceSet:
    """Return the faces with the corners that cutting has made on older corners and edges nearby."""
    mend = part.mend
    used = sorted({v for face in part.faces for v in face})
    tree = cKDTree(mend.points[used])
    index: dict[int, int] = {}
    for k, v in enumerate(used):
        near = min(tree.query_ball_point(mend.points[v], mend.weld / 2))
        index[v] = index.get(used[near], used[near]) if near < k else v
    faces = [simplified([index[v] for v in face]) for face in part.faces]
    is_face = [len(f) > 2 and area_of(mend.points[f]) > SAME for f in faces]
    part = FaceSet(mend, faces, part.materials, part.names).kept(is_face)
    _snap(part)
    return part


def settled(part: FaceSet) -> FaceSet:
    """Return faces after cutting: joints closed, plane, and none so narrow that its corners are one."""
    part = flattened(rejoined(part))
    return part.kept([2 * area_of(p) > FINE * extent_of(p) for p in part.polygons])


def joined(part: FaceSet) -> FaceSet:
    """Return the faces with neighbours in one plane and of one material and name as one polygon."""
    mend = part.mend
    if len(part.faces) < 8 or not all(len(f) == 3 for f in part.faces):
        return part
    sides: dict[tuple[int, int], list[int]] = {}
    for i, face in enumerate(part.faces):
        for edge in edges_of(face):
            sides.setdefault(edge, []).append(i)
    links: list[list[int]] = [[] for _ in part.faces]
    for i, j in (pair for pair in sides.values() if len(pair) == 2):
        links[i].append(j)
        links[j].append(i)
    normals = np.array([normal_of(p) for p in part.polygons])
    done = [False] * len(part.faces)
    out = FaceSet(mend)
    for first in range(len(part.faces)):
        if done[first]:
            continue
        done[first] = True
        members, corners = [first], set(part.faces[first])
        for i in members:  # the list grows during the loop
            for j in links[i]:
                if (
                    not done[j]
                    and part.materials[j] == part.materials[first]
                    and abs(float(normals[j] @ normals[first])) > 0.99
                    and best_plane(mend.points[[*corners, *part.faces[j]]])[1] < PLANARITY * 0.9
                ):
                    corners |= set(part.faces[j])
                    done[j] = True
                    members.append(j)
        count = Counter(e for i in members for e in edges_of(part.faces[i]))
        loops = loops_of([edge for edge, n in count.items() if n == 1])
        if len(members) > 1 and loops is not None and len(loops) == 1:
            out.add(_straightened(mend, loops[0]), part.materials[first], part.names[first])
        else:
            out.extend(part.of(members))
    return out


def _straightened(mend: Mending, loop: Face) -> Face:
    """Return a polygon without corners on a straight line, which T-junctions find by themselves."""
    kept = []
    for k, v in enumerate(loop):
        before, after = mend.points[loop[k - 1]], mend.points[loop[(k + 1) % len(loop)]]
        a, b = mend.points[v] - before, after - mend.points[v]
        if np.linalg.norm(np.cross(a, b)) > 1e-5 * np.linalg.norm(a) * np.linalg.norm(b):
            kept.append(v)
    return kept if len(kept) > 2 else loop


def flattened(part: FaceSet) -> FaceSet:
    """Return the faces with those that are not plane divided into triangles."""
    mend, out = part.mend, FaceSet(part.mend)
    for face, material, name in part.rows():
        corners = mend.points[face]
        if is_flat(corners):
            out.add(face, material, name)
            continue
        pieces = [[face[k] for k in piece] for piece in triangulate(corners)]
        for piece in pieces:
            out.add(piece, material, name)
        off = np.abs((corners - corners.mean(axis=0)) @ normal_of(corners)).max()
        if off > mend.weld:  # else it is a joint's, noted already
            area, folded = area_of(corners), sum(area_of(mend.points[piece]) for piece in pieces)
            done = "faces that are not plane are divided into triangles"
            mend.found("bent", done, [name], area, unsure=[(material, folded - area)])
    return out


_THICKEST = 0.6
"""Mean distance in m between two closed surfaces up to which they are both sides of the walls."""
_HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = "close the hole with a face, or delete the faces around it"


def shell_of(part: FaceSet) -> tuple[FaceSet, list[FaceSet]]:
    """Return the shell of the room, which may have holes, and the other components."""
    mend = part.mend
    parts = [part.of(members) for members in part.components()]
    points = [p.points for p in parts]
    boxes = [float(np.prod(np.sort(np.ptp(p, axis=0))[1:])) for p in points]
    # The shell encloses all: its box is the largest, and no flat component's is a room's.
    solid = [i for i, p in enumerate(points) if best_plane(p)[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused("no faces enclose a volume: draw the walls, the floor and the ceiling")
    main = max(solid, key=lambda i: (round(boxes[i], 3), parts[i].size))
    outer = _volume(parts[main])
    low, high = points[main].min(axis=0), points[main].max(axis=0)
    for i in solid:
        is_within = (low < points[i].min(axis=0)).all() and (points[i].max(axis=0) < high).all()
        if i != main and 2 * boxes[i] > boxes[main] and is_within:
            inner = _volume(parts[i])
            if outer > inner > outer / 2 and outer - inner < _THICKEST * parts[i].size:
                main = i  # the walls are drawn with their thickness
                break
    return parts[main], [p for i, p in enumerate(parts) if i != main]


def _volume(part: FaceSet) -> float:
    """Return the volume in m³ of a component; 0.0 if it is open."""
    try:
        return float(part.polyhedron().volume)
    except DataError:
        return 0.0


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
            f"{each}{more}; holes up to {rounded(largest, 3)} m² are "
            f"closed. {_hint(part, loops[large[0]], others)}",
            missing,
        )
    for loop, area in zip(loops, areas.values(), strict=True):
        ends = mend.points[[*loop, loop[0]]]
        longest = int(np.argmax(np.linalg.norm(np.diff(ends, axis=0), axis=1)))
        material = part.materials[
            missing[edges_of([loop[longest], loop[longest - len(loop) + 1]])[0]]
        ]
        mend.found(
            "hole",
            "holes are closed with their neighbour's material",
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
                f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: state --weld "
                f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            )
    enough = rounded(1.01 * area_of(points[loop]), 3)  # more than the area, as printed
    return f"In your program, {_LOOPS}; or state --hole {enough}"


def as_drawn(shell: FaceSet, others: Sequence[FaceSet], error: MeshError) -> MeshError:
    """Return the error of a shell that is open with the room as it is drawn: V by rays.

    Rays cross the shell and closed objects. They cross all faces where the shell has less than half of
    the area: then the walls do not meet.
    """
    areas: dict[str, float] = {}
    for part in (shell, *others):
        for area, material in zip(part.areas, part.materials, strict=True):
            areas[material] = areas.get(material, 0.0) + area
    is_whole = 2 * shell.size > sum(areas.values())
    crossed = [p for p in others if not is_whole or not p.open_edges()]
    volume, u = volume_by_rays([p for part in (shell, *crossed) for p in part.polygons])
    size, notes = tuple(np.ptp(shell.points, axis=0).tolist()), shell.mend.drawn.notes
    error.unclosed = Mended(None, volume, u, areas, size, error.defects, notes)
    return error


_LINES = 64
"""Lines along each side of the picture, 4096 in each direction."""
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians about x, y and z, so that no line lies in a wall."""
_NEIGHBOURHOOD = 9
_GUESSED = 0.3
"""Relative standard uncertainty of the part of lines with an odd number of crossings."""


def volume_by_rays(polygons: Sequence[Array]) -> tuple[float, float]:
    """Return the volume in m³ that polygons (n, 3) in m enclose, and its standard uncertainty.

    >>> from rtcal.simulators import Polyhedron
    >>> box = Polyhedron.shoebox((4, 5, 3), "plaster")
    >>> open_box = [box.vertices[list(face)] for face in box.faces[:-1]]
    >>> volume, uncertainty = volume_by_rays(open_box)
    >>> bool(abs(volume - 60) < 2 * uncertainty < 2)
    True
    """
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


_FACING = -0.999
"""Largest product of the normals of faces that face each other."""
_BEFORE = 5e-4
"""Distance in m before a face at which there is air, or behind it at which there is none."""
COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""
_MOST_OF_ROOM = 1 / 3
"""Largest share of the walls that an object covers; faces that cover more divide a room in two."""
_DONE = {
    "object": "closed objects stand by themselves",
    "overlay": "faces on a larger one take its area",
    "open bottom": "objects with an open bottom stand on a face, and take its area",
    "panel": "free panels are reflectors with two sides",
    "outside": "components outside the room are left out",
    "partly outside": "components that reach through a wall are left out; their areas, and whether "
    "the room has them, are uncertain",
    "through": "objects that reach through a wall end there",
}
_LOOSE = "components hang free, or are walls that do not meet the others"
Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""
Foot = list[tuple[int, Any]]
"""The faces on which an object stands, and the shape of it on each."""


class Walls:
    """The faces of a shell and of the objects on it, to be found by where they are."""

    def __init__(self, shell: FaceSet) -> None:
        self.mend, self.shell = shell.mend, FaceSet(shell.mend)
        self.planes, self.size = list[Polygon](), 0.0
        self._boxes, self._part_of = np.zeros((0, 2, 3)), np.zeros(0, dtype=int)
        self.add(shell)

    def add(self, part: FaceSet) -> None:
        """Add the faces of the shell, or of an object in it."""
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin = 2 * OFFSET + self.mend.weld
        boxes = [(p.min(axis=0) - margin, p.max(axis=0) + margin) for p in part.polygons]
        number = self._part_of.max(initial=-1) + 1
        self._boxes = np.concatenate([self._boxes, boxes])
        self._part_of = np.concatenate([self._part_of, np.full(len(boxes), number)])
        self.planes += map(Polygon, part.polygons)
        self.shell.extend(part)
        self.size += part.size

    def near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return the number and the plane of each face that may touch what has these corners."""
        return [(i, self.planes[i]) for i in np.flatnonzero(self._near(corners)).tolist()]

    def of_parts_near(self, corners: Array) -> list[tuple[int, Polygon]]:
        """Return all faces of the shell and of each object of which one may touch these corners."""
        near = np.isin(self._part_of, self._part_of[self._near(corners)])
        return [(i, self.planes[i]) for i in np.flatnonzero(near).tolist()]

    def _near(self, corners: Array) -> Array:
        low, high = corners.min(axis=0), corners.max(axis=0)
        return np.asarray(((self._boxes[:, 0] <= high) & (low <= self._boxes[:, 1])).all(axis=1))


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
    """Return what a polygon and a wall have in common; its corners near the wall's are those."""
    return shapely().snap(wall.polygon(corners), wall.shape, snap).intersection(wall.shape)


def add_piece(part: FaceSet, wall: Polygon, piece: Any, material: str, name: str) -> None:
    """Add a piece in a wall's plane, in triangles if it has holes."""
    whole = not piece.interiors
    rings = [piece] if whole else polygons_of(shapely().constrained_delaunay_triangles(piece))
    for ring in rings:
        part.add(part.mend.new_points(wall.lifted(ring_of(ring))), material, name)


def cut(shell: FaceSet, cuts: Mapping[int, Sequence[Cut]]) -> FaceSet:
    """Return the shell with what lies on its faces in their place, the smaller first."""
    mend, out = shell.mend, FaceSet(shell.mend)
    for i, (face, material, name) in enumerate(shell.rows()):
        if i not in cuts:
            out.add(face, material, name)
            continue
        wall = Polygon(mend.points[face])
        taken = shapely().Polygon()
        smaller = sorted(cuts[i], key=lambda c: float(c[0].area))
        for shape, own, called in [*smaller, (wall.shape, material, name)]:
            for piece in polygons_of(shape.difference(taken), mend.weld**2):
                if own is not None:
                    add_piece(out, wall, piece, own, called)
            taken = taken.union(shape)
    return out


def standing_on(
    walls: Walls, part: FaceSet
) -> tuple[Foot, FaceSet, list[tuple[str, float]]] | None:
    """Return the footprint of an open object on each wall, its faces there, and how sure they are.

    It stands on the walls if its open edges lie on them and it rises from them: a panel's do not. Its
    faces that lie on a wall go. Its others gain or lose what lies between them and the wall: of each
    material there the standard uncertainty of its area in m².
    """
    if part.is_plane:
        return None  # a sheet, whose boundary its open edges are
    mend = part.mend
    on = [overlaid_on(walls, FaceSet(mend, [face], [""], [""])) for face in part.faces]
    part = part.kept([o is None or any(far > mend.weld for *_, far in o) for o in on])
    edges = part.open_edges()
    if not loops_of(edges) or part.is_plane:
        return None
    foot = _foot_of(walls, part, edges)
    if foot is None:
        return None
    found, moved = foot
    shift = {v: float(np.linalg.norm(point - mend.points[v])) for v, point in moved.items()}
    unsure: dict[str, float] = {}  # its open edges are all as far off, so their parts add
    for (a, b), face in edges.items():
        gained = ANY_SHARE * extent_of(mend.points[[a, b]]) * max(shift[a], shift[b])
        unsure[part.materials[face]] = unsure.get(part.materials[face], 0.0) + gained
    for v, point in moved.items():
        mend.points[v] = point
    return found, flattened(part), [*unsure.items()]


def ends_at_walls(walls: Walls, part: FaceSet) -> bool:
    """Return whether all open edges of a component are at walls: they are meant to close with them."""
    corners = {v for edge in part.open_edges() for v in edge}
    return not part.is_plane and all(_on_walls(walls, v)[1] for v in corners)


def _on_walls(walls: Walls, corner: int) -> tuple[Array, list[Polygon]]:
    """Return a corner moved onto the walls near it, one of each direction, and these."""
    point = walls.mend.points[corner]
    near = [(abs(float(wall.away(point))), i, wall) for i, wall in walls.near(point[np.newaxis])]
    used = list[Polygon]()
    for away, _, wall in sorted(near, key=lambda each: each[:2]):
        is_near = away <= OFFSET and wall.beside(point) <= OFFSET
        if is_near and all(abs(float(wall.normal @ other.normal)) < 0.99 for other in used):
            used.append(wall)
    for wall in 4 * used:
        point = wall.onto(point)
    return point, used


def _foot_of(
    walls: Walls, part: FaceSet, edges: Mapping[Edge, int]
) -> tuple[Foot, dict[int, Array]] | None:
    """Return what an object covers of each wall to which it is open, and its corners there.

    Its open edges divide the walls into pieces. Neighbours are of one side, but for those that meet at
    an open edge; the side of less area is covered. None if the open edges are not all on walls.
    """
    moved = {v: _on_walls(walls, v)[0] for v in sorted({v for e in edges for v in e})}
    mend = Mending(part.mend.drawn, part.mend.weld, points=part.mend.points)
    for v, point in moved.items():
        mend.points[v] = point
    lines = dict[int, list[Any]]()
    for edge in edges:
        on = _walls_of(walls, mend.points[[*edge]])
        if not on:
            return None
        for i, line in on:
            lines.setdefault(i, []).append(line)
    scene, pieces = FaceSet(mend), Foot()
    for i, wall in walls.of_parts_near(part.points):
        if i not in lines:
            scene.add(mend.new_points(wall.corners), "", str(len(pieces)))
            pieces.append((i, wall.shape))
            continue
        net = shapely().union_all([wall.shape.boundary, *lines[i]])
        for piece in polygons_of(shapely().polygonize([net]), SAME):
            if wall.shape.contains(piece.representative_point()):
                for ring in (piece.exterior, *piece.interiors):
                    scene.add(mend.new_points(wall.lifted(ring_of(ring))), "", str(len(pieces)))
                pieces.append((i, piece))
    for face in part.faces:
        scene.add(face, "", _OBJECT)
    covered = _covered(scene, [float(piece.area) for _, piece in pieces])
    if not 0 < sum(float(pieces[k][1].area) for k in covered) <= _MOST_OF_ROOM * walls.size:
        return None
    return [pieces[k] for k in covered], moved


_OBJECT = "object"


def _walls_of(walls: Walls, ends: Array) -> list[tuple[int, Any]]:
    """Return the walls on which an edge (2, 3) lies, with its line in each one's axes.

    The line is as much longer at both ends as corners may lie apart, so that it divides the wall.
    """
    weld, found = walls.mend.weld, []
    for i, wall in walls.near(ends):
        flat = ends @ wall.axes.T
        line = shapely().LineString(flat)
        on = line.intersection(wall.shape.buffer(FINE))
        if wall.thickness(ends) <= weld and float(on.length) > 0.5 * line.length:
            along = (flat[1] - flat[0]) * (weld + SAME) / line.length
            found.append((i, shapely().LineString([flat[0] - along, flat[1] + along])))
    return found


def _covered(scene: FaceSet, areas: Sequence[float]) -> list[int]:
    """Return the pieces of walls that an object covers; none if it does not divide them in two."""
    scene = rejoined(scene)
    n, pairs = len(areas), []
    for faces in scene.owners().values():
        of_walls = [int(scene.names[k]) for k in faces if scene.names[k] != _OBJECT]
        if len(of_walls) == 2:
            (first, second), is_crossed = of_walls, len(faces) % 2
            # A piece has two nodes, one for each side that it may be on.
            pairs += [(first, second + n * is_crossed), (first + n, second + n * (1 - is_crossed))]
    links = coo_array((np.ones(len(pairs)), np.array(pairs, int).reshape(-1, 2).T), (2 * n, 2 * n))
    _, label = connected_components(links, directed=False)
    if (label[:n] == label[n:]).any():
        return []
    sizes = np.bincount(label[:n], areas, 2 * n)  # of the pieces on each side
    return np.flatnonzero(sizes[label[:n]] < sizes[label[n:]]).tolist()


def _within_walls(room: Polyhedron, part: FaceSet) -> FaceSet | None:
    """Return what is in the room of an object that reaches through walls; None where that is unclear.

    It is cut at a wall unless the wall's plane crosses it elsewhere in the room, too.
    """
    mend, is_cut = part.mend, False
    limit = OFFSET + mend.weld
    for numbers in room.faces:
        wall = Polygon(room.vertices[list(numbers)])
        away, own = wall.away(mend.points), wall.away(part.points)
        edges = [(a, b) for a, b in part.edges if away[a] * away[b] < 0]
        if not own.min() < -limit < limit < own.max() or not edges:
            continue  # what was before this wall may be cut off already
        start, end = np.array(edges).T
        shares = (away[start] / (away[start] - away[end]))[:, np.newaxis]
        crossing = mend.points[start] + shares * (mend.points[end] - mend.points[start])
        on = [wall.beside(point) <= mend.weld for point in crossing]
        section = shapely().MultiPoint(crossing @ wall.axes.T).convex_hull
        elsewhere = room.contains(crossing) & ~np.array(on)
        if elsewhere.any() or not section.intersects(wall.shape):
            continue
        new = dict(zip(edges, mend.new_points(crossing), strict=True))
        part, is_cut = _before(part, away, new), True
    return part if is_cut and part.faces else None


def _before(part: FaceSet, away: Array, new: Mapping[Edge, int]) -> FaceSet:
    """Return the faces of an object before a plane; ``new`` are the corners where its edges cross."""
    out = FaceSet(part.mend)
    for face, material, name in part.rows():
        left: Face = []
        for a, b in zip([face[-1], *face[:-1]], face, strict=True):
            if (edge := (min(a, b), max(a, b))) in new:
                left.append(new[edge])
            if away[b] <= 0:
                left.append(b)
        if len(left) > 2:
            out.add(left, material, name)
    return out


def _volume_over(walls: Walls, stood: FaceSet, feet: Foot) -> float:
    """Return the volume in m³ between the faces of an object and its footprints."""
    whole = stood.of(range(len(stood.faces)))
    for i, piece in feet:
        add_piece(whole, walls.planes[i], piece, "", "")
    try:
        return float(whole.polyhedron().volume)
    except DataError:  # the footprint was drawn a little beside it
        return volume_by_rays(whole.polygons)[0]


def _add_slab(shell: FaceSet, face: Face, material: str, name: str) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    mend = shell.mend
    plane = Polygon(mend.points[face])
    half = plane.normal * THICKNESS / 2
    for piece in polygons_of(plane.shape.buffer(-THICKNESS / 2, join_style="mitre")):
        corners = plane.lifted(ring_of(piece))
        front, back = mend.new_points(corners + half), mend.new_points(corners - half)
        shell.add(front, material, name)
        shell.add(back[::-1], material, f"{name} back")
        for k in range(len(front)):
            shell.add((front[k], front[k - 1], back[k - 1], back[k]), material, f"{name} edge")


def _kind_of(walls: Walls, part: FaceSet) -> tuple[str, Any]:
    """Return what a component is beside these walls, with its pieces or its foot on them."""
    if not part.open_edges():
        return "object", None
    if (pieces := overlaid_on(walls, part)) is not None:
        return "overlay", pieces
    if (foot := standing_on(walls, part)) is not None:
        return "open bottom", foot
    return "panel", None


def note_loose(shell: FaceSet, others: Sequence[FaceSet]) -> None:
    """Note what else there is where the shell is open; nothing is cut, since nothing is in a room."""
    walls = Walls(shell)
    for part in others:
        kind, _ = _kind_of(walls, part)
        done = _LOOSE if kind == "panel" else _DONE[kind]
        shell.mend.found(kind, done, part.names[:1], part.size)


def with_others(shell: FaceSet, others: Sequence[FaceSet]) -> FaceSet:
    """Return the shell with overlays, objects and panels; what lies outside is left out."""
    if not others:
        return shell
    mend, hull, walls = shell.mend, shell.polyhedron(), Walls(shell)
    cuts: dict[int, list[Cut]] = {}
    panels, outside = list[FaceSet](), FaceSet(mend)

    def note(
        kind: str, part: FaceSet, volume: float = 0.0, surface: float = 0.0, unsure: Any = ()
    ) -> None:
        mend.found(kind, _DONE[kind], part.names[:1], part.size, volume, surface, 0.0, unsure)

    for part in _in_order([_ending_at_walls(hull, part) for part in others]):
        if not is_within(mend, hull, part.points):
            reaches = _reaches_into(hull, part)
            shares = zip(part.materials, np.multiply(ANY_SHARE, part.areas), strict=True)
            note("partly outside" if reaches else "outside", part, unsure=shares if reaches else ())
            if part.open_edges():
                outside.extend(part)
            continue
        kind, on = _kind_of(walls, part)
        if kind == "object":
            walls.add(part)
        elif kind == "overlay":
            for wall, pieces, _ in on:
                cuts.setdefault(wall, []).extend(pieces)
            rows = [(*piece, far) for _, pieces, far in on for piece in pieces]
            moved = sum(far * float(shape.area) for shape, *_, far in rows)
            # The reveal from the wall to the face is not drawn; it may be of the face's material.
            reveals = [(m, ANY_SHARE * far * float(shape.length)) for shape, m, _, far in rows]
            note(kind, part, moved, -part.size, reveals)
        elif kind == "open bottom":
            feet, stood, unsure = on
            for wall, footprint in feet:
                cuts.setdefault(wall, []).append((footprint, None, ""))
            covered = sum(float(footprint.area) for _, footprint in feet)
            note(kind, part, -_volume_over(walls, stood, feet), stood.size - covered, unsure)
            walls.add(stood)
        elif ends_at_walls(walls, part):
            raise mend.refused(
                f'"{part.names[0]}" and the faces joined to it end at walls on all sides, and what '
                "they enclose with them is not found, or is over a third of the room: draw the missing "
                "faces, or, if they divide the room, leave the other side out"
            )
        else:
            panels.append(part)
            note(kind, part, -THICKNESS * part.size, part.size)
    shell = walls.shell
    _require_shell(shell, outside)
    if cuts:
        shell = settled(cut(shell, cuts))
    for part in panels:
        for row in part.rows():
            _add_slab(shell, *row)
    return shell


def _ending_at_walls(hull: Polyhedron, part: FaceSet) -> FaceSet:
    """Return a component, or of an object that reaches through the walls what is in the room."""
    mend = part.mend
    if part.is_plane or is_within(mend, hull, part.points):
        return part
    inside = _within_walls(hull, part)
    if inside is None or not is_within(mend, hull, inside.points):
        return part
    mend.found("through", _DONE["through"], part.names[:1], part.size - inside.size)
    return inside


def _require_shell(shell: FaceSet, outside: FaceSet) -> None:
    """Raise MeshError if what is left out as outside are the walls, and the shell is an object."""
    if not outside.faces:
        return
    around, held = outside.points, shell.points
    encloses = (around.min(axis=0) <= held.min(axis=0)).all()
    encloses &= (around.max(axis=0) >= held.max(axis=0)).all()
    if encloses and outside.size > shell.size:
        raise shell.mend.refused(
            f'the largest closed part, which begins with "{shell.names[0]}", is no room: faces of '
            f"{rounded(outside.size, 3)} m² lie around it and do not close. Draw each wall once, and "
            "let neighbours have the same corners"
        )


def _in_order(parts: Sequence[FaceSet]) -> list[FaceSet]:
    """Return closed objects first, then open ones from large to small, then plane ones as drawn.

    Each may stand or lie on those before.
    """

    def key(part: FaceSet) -> tuple[bool, bool, float]:
        return bool(part.open_edges()), part.is_plane, 0.0 if part.is_plane else -part.size

    return sorted(parts, key=key)


def is_within(mend: Mending, hull: Polyhedron, corners: Array) -> bool:
    """Return whether a component is in the room: its corners, but for those at the walls, are."""
    outside = corners[~hull.contains(corners)]
    return not (hull.wall_distance(outside) > OFFSET + mend.weld).any()


def _reaches_into(hull: Polyhedron, part: FaceSet) -> bool:
    """Return whether an edge of a component is in the room, and not merely at its walls."""
    ends = part.mend.points[part.edges]
    shares = np.linspace(0, 1, 9)[:, np.newaxis, np.newaxis]
    points = (ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    inside = points[hull.contains(points)]
    return bool((hull.wall_distance(inside) > OFFSET + part.mend.weld).any())


@dataclass
class _Contact:
    """A face of an object before a face of a larger one, or of the room: the wall.

    ``gap`` is the width in m of the air between them; below 0 where the object reaches through.
    ``area`` is what both share in m².
    """

    face: int
    wall: int
    plane: Polygon
    gap: float
    area: float


def _of_geometry(mend: Mending, geometry: Polyhedron) -> FaceSet:
    """Return the faces of a room, whose vertices become the points."""
    mend.points = np.array(geometry.vertices)
    return FaceSet(mend, map(list, geometry.faces), geometry.materials, geometry.names)


def objects_are_within(mend: Mending, geometry: Polyhedron) -> bool:
    """Return whether every closed object of a room is in it."""
    shell, objects = shell_of(_of_geometry(mend, geometry))
    if not objects:
        return True
    hull = shell.polyhedron()
    return all(is_within(mend, hull, part.points) for part in objects)


def without_contacts(mend: Mending, geometry: Polyhedron) -> Polyhedron:
    """Return a room without the parts of its faces on which closed objects stand or lie.

    A face of an object that is up to ``weld`` before a face of the room or of a larger object, or that
    reaches through it by up to `OFFSET`, is moved onto it. What they share is taken from both. A
    wider gap up to `OFFSET` is noted.
    """
    part = _of_geometry(mend, geometry)
    groups = _by_size(part)
    contacts = [*_contacts(part, geometry, groups)]
    touching = [c for c in contacts if c.gap <= mend.weld]
    _note_gaps(part, [c for c in contacts if c.gap > mend.weld], groups[0] if groups else ())
    moved = []
    for c in touching:
        own = part.corners(c.face)
        moved.append(c.plane.thickness(own))
        mend.points[part.faces[c.face]] = c.plane.onto(own)
    cuts: dict[int, list[Cut]] = {}
    area, places, unsure = 0.0, [], []
    for c, distance in zip(touching, moved, strict=True):
        wall, own_plane = Polygon(part.corners(c.wall)), Polygon(part.corners(c.face))
        shapes = _shared(wall, part.corners(c.face), mend.weld)
        cuts.setdefault(c.wall, []).extend((shape, None, "") for shape in shapes)
        seen = [own_plane.seen(shape, wall) for shape in shapes]
        cuts.setdefault(c.face, []).extend((shape, None, "") for shape in seen)
        area += sum(float(shape.area) for shape in shapes)
        places += [f'"{part.names[c.face]}" on "{part.names[c.wall]}"'] * bool(shapes)
        # What the object's other faces have gained or lost there.
        longer = ANY_SHARE * distance * sum(float(shape.length) for shape in shapes)
        unsure.append((part.materials[c.face], longer))
    if not cuts:
        return geometry
    try:
        mended = _without(part, cuts)
    except DataError as error:
        raise mend.refused(
            f"closed objects touch other faces, and both faces cannot be cut there ({error}). Draw the "
            f"objects without those faces: {'; '.join(places[:MOST_PLACES])}"
        ) from error
    volume = mended.volume - geometry.volume
    surface = float(np.sum(mended.face_areas) - np.sum(geometry.face_areas))
    mend.found("contact", CONTACT, places, area, volume, surface, unsure=unsure)
    return mended


def _without(part: FaceSet, cuts: Mapping[int, Sequence[Cut]]) -> Polyhedron:
    """Return the room without some shapes of its faces; its joints may be as rough as ``weld``."""
    for weld in (2 * FINE, part.mend.weld):
        fine = Mending(part.mend.drawn, weld, points=part.mend.points)
        left = settled(cut(FaceSet(fine, *zip(*part.rows(), strict=True)), cuts))
        try:
            return left.polyhedron()
        except DataError as error:
            refused = error
    raise refused


def _by_size(part: FaceSet) -> list[list[int]]:
    """Return the faces of each closed surface: the room's first, then the objects', large to small."""

    def volume(members: Sequence[int]) -> float:
        polygons = [part.corners(i) - part.mend.points[0] for i in members]
        return abs(sum(float(p[0] @ vector_area(p)) for p in polygons))

    return sorted(part.components(), key=lambda members: (-volume(members), members))


def _contacts(
    part: FaceSet, geometry: Polyhedron, groups: Sequence[Sequence[int]]
) -> Iterator[_Contact]:
    """Yield the faces of objects that face one of the room's or of a larger object nearby.

    Of one closed surface, they are those that lie on each other with no air between them.
    """
    mend, polygons = part.mend, part.polygons
    walls = [Polygon(polygon) for polygon in polygons]
    low = np.array([p.min(axis=0) for p in polygons])
    high = np.array([p.max(axis=0) for p in polygons])
    rank = np.empty(len(polygons), dtype=int)
    for k, members in enumerate(groups):
        rank[list(members)] = k
    through = OFFSET + mend.weld
    limits = -through, max(OFFSET, mend.weld)
    for k, members in enumerate(groups):
        solid = geometry.triangles[np.isin(geometry.triangle_faces, members)]
        for i in members:
            near = ((low - through <= high[i]) & (low[i] <= high + through)).all(axis=1)
            near &= (rank < k) | ((rank == k) & (np.arange(len(rank)) < i))
            near &= geometry.normals @ geometry.normals[i] < _FACING
            for j in np.flatnonzero(near).tolist():
                wall, into, is_same = walls[j], -geometry.normals[j], rank[j] == k
                away = (polygons[i] - polygons[j].mean(axis=0)) @ into
                least, most = (-FINE, FINE) if is_same else limits
                if not least <= away.min() <= away.max() <= most:
                    continue
                shapes = _shared(wall, polygons[i], mend.weld)
                if not shapes:
                    continue
                area = sum(float(shape.area) for shape in shapes)
                point = max(shapes, key=lambda p: float(p.area)).representative_point()
                inner = wall.lifted(np.array(point.coords))
                # A thin object on the other side of a thin wall is not behind this face of it.
                behind = inner + (max(away.max(), 0.0) + _BEFORE) * into
                if is_same:
                    before = inner - _BEFORE * geometry.normals[[i, j]]
                    if not geometry.contains(before).any():
                        yield _Contact(i, j, wall, 0.0, area)
                elif abs(float(winding_number(behind, solid)[0])) > 0.5:
                    yield _Contact(i, j, wall, float(away.max()), area)


def _shared(wall: Polygon, corners: Array, weld: float) -> list[Any]:
    """Return the shapes, in the wall's axes, that both faces have; not those as narrow as a sliver."""
    shape = common(wall, corners, FINE)
    return [p for p in polygons_of(shape) if p.area > weld * extent_of(ring_of(p)) / 2]


def _note_gaps(part: FaceSet, contacts: Sequence[_Contact], shell: Sequence[int]) -> None:
    """Note the objects that are as near to a wall as a window may be, over a whole face."""
    areas = part.areas
    near = [c for c in contacts if c.wall in shell and c.area > COVERED * areas[c.face]]
    if near:
        widest = max(c.gap for c in near)
        part.mend.found(
            "gap",
            f"faces of closed objects are up to {widest * 1000:.2g} mm before a wall, and both count; "
            f"state --weld {1.1 * widest:.2g} if they touch",
            [f'"{part.names[c.face]}" before "{part.names[c.wall]}"' for c in near],
            sum(areas[c.face] for c in near),
        )


_THIN = 0.8
"""Mean chord in m, 4 V / S, below which a solid is a wall or a slab: that of a wall is twice its
thickness at most, that of a cube of 5 m³ is 1.1 m."""
_LEAST_SHARE = 0.05
"""Least volume of the room, as a share of that of the box around the solids."""


def room_between(part: FaceSet) -> FaceSet | None:
    """Return the faces around the largest cavity between closed solids, which is noted.

    None if the faces are not several closed solids, or if one is a room that may hold the others.

    Raises
    ------
    MeshError
        If all solids are thin and enclose no cavity: their faces bound material and not air.
    MissingDependencyError
        Without manifold3d.
    """
    mend, drawn = part.mend, part.mend.drawn
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
    cavities = _cavities(solids, groups)
    box = float(np.prod(np.ptp(mend.points, axis=0)))
    if not cavities or cavities[0].volume < _LEAST_SHARE * box:
        if not all(thin):
            return None
        raise MeshError(
            f"{drawn.path}: the faces bound {len(solids)} solids, such as walls and slabs, and these "
            "enclose no cavity: what is inside them is material and not air, so no room can be made. "
            "In your program, close the openings and gaps between the solids, or draw the room's "
            f"inner faces; --weld {rounded(10 * mend.weld, 2)} closes gaps of that width in m"
        )
    room, *others = cavities
    materials, names = ([of[i] for i in room.faces] for of in (part.materials, part.names))
    done = f"closed solids: the room is the cavity of {rounded(room.volume, 4)} m³ between them"
    if others:
        sizes = listed([f"{rounded(c.volume, 3)} m³" for c in others])
        done += f", the largest; {'another' if len(others) == 1 else 'others'} of {sizes} left out"
    faces = Faces(drawn.path, list(room.triangles), materials, names, drawn.notes, drawn.unit)
    mend = Mending(faces, mend.weld, mend.largest_hole)
    mend.found("solids", done, [part.names[group[0]] for group in groups])
    return welded(mend)


def _solids(faces: Sequence[Sequence[int]]) -> list[list[int]] | None:
    """Return the faces of each solid: in the file's order, until each edge has two faces.

    None if some edge has one face only in the end.
    """
    solids: list[list[int]] = []
    solid: list[int] = []
    open_edges: set[tuple[int, int]] = set()
    for i, face in enumerate(faces):
        solid.append(i)
        open_edges.symmetric_difference_update(edges_of(face))
        if not open_edges:
            solids.append(solid)
            solid = []
    return None if solid else solids


@dataclass(frozen=True)
class _Cavity:
    """A cavity in the union of solids, and the free solids in it.

    ``volume`` is in m³, without the free solids. ``triangles`` (n, 3, 3) are corners in m, ``faces``
    the number of the face that each is a part of.
    """

    volume: float
    triangles: Array
    faces: list[int]


def _cavities(solids: Sequence[Polyhedron], groups: Sequence[Sequence[int]]) -> list[_Cavity]:
    """Return the cavities in the union of solids, the largest first; ``groups`` are their faces."""
    manifold = library(
        "walls that are drawn as solids need manifold3d: pip install 'rtcal[mesh]'", "manifold3d"
    )
    made = []
    for solid, group in zip(solids, groups, strict=True):
        # A solid's normals point out of it, as manifold3d asks.
        corners, index = np.unique(solid.triangles.reshape(-1, 3), axis=0, return_inverse=True)
        of_face = np.array(group)[solid.triangle_faces].astype(np.uint64)
        of_corners = index.reshape(-1, 3).astype(np.uint64)
        made.append(manifold.Manifold(manifold.Mesh64(corners, of_corners, face_id=of_face)))
    surfaces = []
    for surface in reduce(add, made).decompose():  # one by one: all at once leaves spikes at joints
        mesh = surface.to_mesh64()
        corners = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts, int)]
        surfaces.append(_Cavity(-surface.volume(), corners, np.asarray(mesh.face_id, int).tolist()))
    found = []
    for cavity in (s for s in surfaces if s.volume > 0):  # around it normals point inward
        held = [
            s
            for s in surfaces
            if s.volume < 0 and abs(winding_number(s.triangles[0, :1], cavity.triangles)[0]) > 0.5
        ]
        whole = [cavity, *held]
        triangles = np.concatenate([s.triangles for s in whole])
        faces = [face for s in whole for face in s.faces]
        found.append(_Cavity(sum(s.volume for s in whole), triangles, faces))
    return sorted(found, key=lambda cavity: -cavity.volume)


def mended(faces: Faces, *, weld: float = WELD, largest_hole: float | None = None) -> Mended:
    """Return the closed room of some faces, and every defect.

    Faces that close as they are drawn are taken as they are: closed objects are in the room, without
    what they share with the faces that they touch.

    Parameters
    ----------
    faces : Faces
    weld : float
        Distance in m within which corners are one.
    largest_hole : float, optional
        Largest area in m² of a hole that is closed; by default 1 % of the shell's area.

    Raises
    ------
    MeshError
        For a mesh without a closed room. It names the defect, where, and how to mend it.
    MissingDependencyError
        Without shapely, if a face must be cut.
    """
    for name, value, unit in (("weld", weld, "m"), ("largest_hole", largest_hole or 0.0, "m²")):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} {unit} is not finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: there is no face; a room has at least 4")
    if len(faces.polygons) > 20 * MOST_FACES:
        raise DataError(f"{faces.path}: {len(faces.polygons)} faces; at most {20 * MOST_FACES}")
    if (closed := _closed_as_drawn(faces, weld)) is not None:
        return closed
    drawn = welded(Mending(faces, max(weld, SAME), largest_hole))
    part = room_between(drawn) or drawn
    mend = part.mend
    part = flattened(snapped(joined(without_repetitions(part))))
    shell, others = shell_of(part)
    geometry = _closed(shell, others)
    if any(geometry.contains([point])[0] for point in mend.buried):
        raise mend.refused(
            "two closed rooms have a wall in common: leave one of them out, or delete that wall"
        )
    return mend.result(without_contacts(mend, geometry))


def _closed(shell: FaceSet, others: Sequence[FaceSet]) -> Polyhedron:
    """Return the room of its shell and the other components; MeshError with the room as drawn."""
    mend = shell.mend
    try:
        shell = without_holes(shell, others)
    except MeshError as error:
        note_loose(shell, others)
        refused = mend.refused(error.reason)
        refused.edges = error.edges
        raise as_drawn(shell, others, refused) from None
    try:
        part = with_others(shell, others)
        if len(part.faces) > MOST_FACES:
            raise mend.refused(f"{len(part.faces)} faces; at most {MOST_FACES}: simplify the model")
        return part.polyhedron()
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
    except DataError:  # not closed, or a defect that is named later
        return None
    if not objects_are_within(mend, geometry):
        return None
    return mend.result(without_contacts(mend, geometry))
