"""Faces of a mesh while it is mended: planes, parts, edges and loops; what was found, and the room.

No other module but this one imports shapely.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rtcal.simulators.geometry import PLANARITY, Edge, Polyhedron, edge_owners, vector_area
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array

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
        In m³; of a room that does not close by rays (`rtcal.io.mend.shell`).
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
        """Standard uncertainty of each material's area in m² by mending, where it is not 0."""
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
        """Return the faces at each piece of an edge, which every corner on it divides."""
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


def area_of(corners: Array) -> float:
    """Return the area of a plane polygon in m²."""
    return float(np.linalg.norm(vector_area(corners)))


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
