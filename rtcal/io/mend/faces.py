"""Faces of a mesh while it is mended: defects, polygons and edges, components, holes, and the volume.

The volume of a room whose faces do not close is taken by lines through what is drawn: parallel lines
in three directions cross the walls. Between its first and second crossing, its third and fourth, a line
is in the room. A line with an odd number of crossings went through a hole, and takes the mean of its
neighbours. Where holes face each other a direction is wrong and the others are not, so their spread is
the uncertainty. No other module imports shapely.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from rtcal.acoustics.room import Surface
from rtcal.simulators import facets
from rtcal.simulators.facets import edge_owners
from rtcal.simulators.geometry import PLANARITY, Polyhedron
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array

_SHOWN = 1e-6
"""Smallest effect in m³ and m² that is printed: smaller ones are rounding."""


@dataclass(frozen=True)
class Defect:
    """A kind of defect, and what was done.

    Parameters
    ----------
    kind : str
        "joint", "sliver", "twice", "bent", "hole", "overlay", "open bottom", "panel", "turned",
        "partly outside", "outside", "through", "contact", "gap".
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

    def __str__(self) -> str:
        """Return the defect as one line."""
        parts = [f"{self.number} {self.done}"]
        if self.area:
            parts.append(f"{rounded(self.area, 3)} m²")
        for symbol, effect, unit in (
            ("V", self.volume_effect, "m³"),
            ("S", self.area_effect, "m²"),
        ):
            if abs(effect) > _SHOWN:
                parts.append(
                    f"{symbol} {'-' if effect < 0 else '+'}{rounded(abs(effect), 3)} {unit}"
                )
        if self.volume_uncertainty > _SHOWN:
            parts.append(f"u(V) {rounded(self.volume_uncertainty, 2)} m³")
        if (u := float(np.linalg.norm([*self.area_uncertainty.values()]))) > _SHOWN:
            parts.append(f"u(S) {rounded(u, 2)} m²")
        more = ", ..." if self.number > len(self.places) else ""
        at = f" ({', '.join(self.places)}{more})" if self.places else ""
        return f"{self.kind}: {', '.join(parts)}{at}"


@dataclass(frozen=True)
class Unclosed:
    """A room whose walls do not close, as it is drawn: no tracer takes it.

    Parameters
    ----------
    volume, volume_uncertainty : float
        In m³, by rays (`rtcal.io.mend.faces`).
    areas : mapping of str to float
        Area of each material in m², every face once. What is missing is not in it.
    defects : sequence of Defect
    notes : sequence of str
    size : sequence of float
        Lengths along x, y and z in m of the box around it.
    """

    volume: float
    volume_uncertainty: float
    areas: Mapping[str, float]
    defects: tuple[Defect, ...]
    notes: tuple[str, ...] = ()
    size: tuple[float, ...] = ()

    @property
    def area_uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each material's area in m² by what was mended before."""
        return uncertain_areas(self.defects)

    @property
    def surfaces(self) -> list[Surface]:
        """The materials with their areas, as a room takes them."""
        return [Surface(name, name, area) for name, area in self.areas.items()]

    def __str__(self) -> str:
        """Return V, S, the areas of the materials, and each defect."""
        u, total = self.volume_uncertainty, sum(self.areas.values())
        head = (
            f"V = {rounded(self.volume, 4)} ± {rounded(u, 2)} m³ by rays, S = {total:.6g} m² as drawn, "
            f"not closed{_box(self.size)}"
        )
        return "\n".join([head, *_listed(self.areas, self.defects)])


class MeshError(DataError):
    """A mesh that is refused.

    ``defects`` are all that were found, ``edges`` (n, 2, 3) are where it is open, in m. ``unclosed`` is
    the room as it is drawn, if there is a shell.
    """

    defects: tuple[Defect, ...] = ()
    edges: Array = np.zeros((0, 2, 3))
    unclosed: Unclosed | None = None


@dataclass(frozen=True)
class Mended:
    """A closed room, and what was mended.

    Parameters
    ----------
    geometry : Polyhedron
    defects : sequence of Defect
    notes : sequence of str
        What the reader of the file did: units, axes.
    """

    geometry: Polyhedron
    defects: tuple[Defect, ...]
    notes: tuple[str, ...] = ()

    @property
    def volume(self) -> float:
        """V in m³."""
        return float(self.geometry.volume)

    @property
    def size(self) -> tuple[float, ...]:
        """Lengths along x, y and z in m of the box around the room."""
        return tuple(np.ptp(self.geometry.triangles, axis=(0, 1)).tolist())

    @property
    def areas(self) -> Mapping[str, float]:
        """Area of each material in m²."""
        return self.geometry.areas

    @property
    def volume_uncertainty(self) -> float:
        """Standard uncertainty of V in m³ by mending, the root of the sum of squares."""
        return float(np.sqrt(sum(d.volume_uncertainty**2 for d in self.defects)))

    @property
    def area_uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each material's area in m² by mending, where it is not 0."""
        return uncertain_areas(self.defects)

    def __str__(self) -> str:
        """Return V, S, the areas of the materials, and each defect."""
        total = float(np.sum(self.geometry.face_areas))
        u = f" ± {rounded(self.volume_uncertainty, 2)}" if self.volume_uncertainty > _SHOWN else ""
        n = len(self.geometry.faces)
        head = (
            f"V = {self.geometry.volume:.6g}{u} m³, S = {total:.6g} m², {n} faces{_box(self.size)}"
        )
        return "\n".join([head, *_listed(self.geometry.areas, self.defects)])


def combined(parts: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the root of the sum of squares by name, where it is not 0."""
    total: dict[str, float] = {}
    for name, part in parts:
        total[name] = float(np.hypot(total.get(name, 0.0), part))
    return {name: u for name, u in total.items() if u > 0}


def uncertain_areas(defects: Sequence[Defect]) -> dict[str, float]:
    """Return the standard uncertainty of each material's area in m² by all defects."""
    return combined(each for defect in defects for each in defect.area_uncertainty.items())


def _box(size: Sequence[float]) -> str:
    """Return the box around a room in words, which shows whether the unit is right."""
    return f", x × y × z = {' × '.join(rounded(x, 3) for x in size)} m" if size else ""


def _listed(areas: Mapping[str, float], defects: Sequence[Defect]) -> list[str]:
    """Return lines of areas and of defects."""
    rows = [f"{area:10.3f} m²  {name}" for name, area in areas.items()]
    found = [f"  {defect}" for defect in defects] or ["  none"]
    return [*rows, "defects:", *found]


MOST_PLACES = 5
ANY_SHARE = 1 / np.sqrt(3)
"""Of an area of which any share may count, all shares alike: rms of what is missing or too much."""
_FOUND = ". Found, too: "


CONTACT = "faces of closed objects touch others: the room has neither there"


class Mending:
    """One mesh while it is mended; ``points`` are the corners in m.

    ``buried`` are points (3,) of faces that two closed objects had in common.
    """

    def __init__(
        self, drawn: Faces, weld: float, offset: float, largest_hole: float | None
    ) -> None:
        self.path, self.weld, self.offset, self.largest_hole = (
            drawn.path,
            weld,
            offset,
            largest_hole,
        )
        self.defects: list[Defect] = []
        self.drawn = drawn
        self.points: Array = np.zeros((0, 3))
        self.used: list[int] = []
        self.buried: list[Array] = []

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
        """Add a defect of these places, with its effects in m², m³ and m².

        ``unsure`` are materials with a standard uncertainty of area in m² each.
        """
        self.defects.append(
            Defect(
                kind,
                len(places),
                area,
                volume,
                surface,
                uncertainty,
                tuple(places[:MOST_PLACES]),
                done,
                combined(unsure),
            )
        )

    def refused(self, message: str, edges: Sequence[Edge] = ()) -> MeshError:
        """Return the error that says what is wrong; all defects that were found are in it, too."""
        error = MeshError(f"{self.path}: {message}")
        error.edges = self.points[np.array(edges, dtype=int).reshape(-1, 2)]
        return self.told(error)

    def told(self, error: MeshError) -> MeshError:
        """Return an error of this mesh with all defects that were found."""
        reason = str(error).partition(_FOUND)[0]
        others = f"{_FOUND}{'; '.join(map(str, self.defects))}" if self.defects else ""
        complete = MeshError(f"{reason}{others}")
        complete.defects, complete.edges = tuple(self.defects), error.edges
        return complete

    def corners(self, work: Work) -> Array:
        """Return the corners of some faces in m, (n, 3)."""
        return self.points[sorted({v for face in work.faces for v in face})]

    def place(self, corner: int) -> str:
        """Return a corner's coordinates in words."""
        return "(" + ", ".join(f"{x:.4g}" for x in self.points[corner]) + ") m"


WELD = 0.01
"""Default distance in m: models are drawn to the centimetre, and no wavelength is as short."""
OFFSET = 0.05
"""Default distance in m up to which a face lies on another: the depth of a window's frame."""
MOST_FACES = 6000
SAME = 1e-6

Face = list[int]
Edge = tuple[int, int]


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


@dataclass
class Work:
    """The faces of one state of the work."""

    faces: list[Face] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def add(self, face: Iterable[int], material: str, name: str) -> None:
        """Add a face of these corners."""
        self.faces.append(list(face))
        self.materials.append(material)
        self.names.append(name)

    def extend(self, other: Work) -> None:
        """Add another's faces."""
        self.faces += other.faces
        self.materials += other.materials
        self.names += other.names

    def kept(self, which: Sequence[bool]) -> Work:
        """Return the faces that are to be kept."""
        return self.of([i for i, keep in enumerate(which) if keep])

    def of(self, index: Sequence[int]) -> Work:
        """Return the faces of these numbers."""
        return Work(
            [self.faces[i] for i in index],
            [self.materials[i] for i in index],
            [self.names[i] for i in index],
        )


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
    return float(np.linalg.norm(facets.vector_area(corners)))


def normal_of(corners: Array) -> Array:
    """Return the unit normal of a polygon; that of a point is upward."""
    area = facets.vector_area(corners)
    size = float(np.linalg.norm(area))
    return np.asarray(area / size if size else np.array([0.0, 0.0, 1.0]))


def plane_of(corners: Array) -> tuple[Array, float]:
    """Return the normal of the plane that fits some points best, and their largest distance from it."""
    away = corners - corners.mean(axis=0)
    normal = np.linalg.svd(away, full_matrices=False)[2][-1]
    return np.asarray(normal), float(np.abs(away @ normal).max())


def extent_of(corners: Array) -> float:
    """Return the largest distance of two corners in m."""
    return float(np.linalg.norm(corners[:, np.newaxis] - corners[np.newaxis], axis=-1).max())


def axes_of(normal: Array) -> Array:
    """Return two unit vectors of the plane, (2, 3)."""
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def polygon_of(corners: Array, axes: Array) -> Any:
    """Return the polygon of corners in a plane of two axes, made valid."""
    polygon = shapely().Polygon(corners @ axes.T)
    return polygon if polygon.is_valid else polygon.buffer(0)


def polygons_of(shape: Any) -> list[Any]:
    """Return the polygons of a shape, without the points and lines at which shapes touch."""
    parts = getattr(shape, "geoms", [shape])
    return [p for p in parts if p.geom_type == "Polygon" and not p.is_empty]


def shapely() -> Any:
    """Return the library; MissingDependencyError without it."""
    return library("a face is to be cut, which needs shapely: pip install 'rtcal[mesh]'", "shapely")


def shell_of(mend: Mending, work: Work) -> tuple[Work, list[Work]]:
    """Return the shell of the room, which may have holes, and the other components."""
    parts = [work.of(members) for members in parts_of(mend, work)]
    sizes = [float(np.prod(np.sort(np.ptp(mend.corners(p), axis=0))[1:])) for p in parts]
    areas = [sum(area_of(mend.points[f]) for f in p.faces) for p in parts]
    # The shell encloses all: its box is the largest, and no flat component's is a room's.
    solid = [i for i, p in enumerate(parts) if plane_of(mend.corners(p))[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused("no faces enclose a volume: draw the walls, the floor and the ceiling")
    main = max(solid, key=lambda i: (round(sizes[i], 3), areas[i]))
    outer = _volume(mend, parts[main])
    for i in solid:
        if i != main and 2 * sizes[i] > sizes[main] and _is_around(mend, parts[main], parts[i]):
            inner = _volume(mend, parts[i])
            if outer > inner > outer / 2 and outer - inner < THICKEST * areas[i]:
                main = i  # the walls are drawn with their thickness
                break
    return parts[main], [p for i, p in enumerate(parts) if i != main]


THICKEST = 0.6
"""Mean distance in m between two closed surfaces up to which they are both sides of the walls."""


def _is_around(mend: Mending, outer: Work, inner: Work) -> bool:
    """Return whether the box around one component holds another."""
    around, held = mend.corners(outer), mend.corners(inner)
    low, high = around.min(axis=0), around.max(axis=0)
    return bool((low < held.min(axis=0)).all() and (held.max(axis=0) < high).all())


def _volume(mend: Mending, part: Work) -> float:
    """Return the volume in m³ of a component; 0.0 if it is open."""
    names = [str(k) for k in range(len(part.faces))]
    polygons = [mend.points[face] for face in part.faces]
    try:
        return float(Polyhedron.from_polygons([*zip(names, names, polygons, strict=True)]).volume)
    except DataError:
        return 0.0


def parts_of(mend: Mending, work: Work) -> list[list[int]]:
    """Return the faces of each component: faces are joined where two meet in an edge."""
    links: list[list[int]] = [[] for _ in work.faces]
    for sides in owners(mend, work.faces).values():
        if len(sides) == 2:
            links[sides[0]].append(sides[1])
            links[sides[1]].append(sides[0])
    done = [False] * len(work.faces)
    parts = []
    for first in range(len(work.faces)):
        if done[first]:
            continue
        done[first] = True
        part = [first]
        for i in part:  # the list grows during the loop
            for j in links[i]:
                if not done[j]:
                    done[j] = True
                    part.append(j)
        parts.append(sorted(part))
    return parts


MOST_OPEN = 5000
"""Largest number of open edges whose loops are sought."""


def owners(mend: Mending, faces: Sequence[Face]) -> dict[Edge, list[int]]:
    """Return the faces at each piece of an edge, which every corner on it divides."""
    owners = edge_owners(mend.points, faces)
    return {edge: [i for i, _ in sides] for edge, sides in owners.items()}


def open_edges(mend: Mending, work: Work) -> dict[Edge, int]:
    """Return the pieces of edges at which one face, or an odd number, meets; with one of them."""
    return {e: s[0] for e, s in owners(mend, work.faces).items() if len(s) % 2}


def edges_of(face: Sequence[int]) -> Iterable[Edge]:
    """Return the edges of a face, each from the corner before."""
    return ((face[k - 1], face[k]) for k in range(len(face)))


def sorted_edge(a: int, b: int) -> Edge:
    """Return an edge with its lower corner first."""
    return (min(a, b), max(a, b))


def simplified(face: Face) -> Face:
    """Return a face without repeated corners and without spikes a, b, a."""
    changed = True
    while changed and len(face) > 2:
        changed = False
        for k in range(len(face)):
            if face[k] == face[k - 1] or face[k - 1] == face[(k + 1) % len(face)]:
                del face[k]
                changed = True
                break
    return face


def one_loop(
    faces: Sequence[Face], owners: Mapping[Edge, Sequence[int]], members: set[int]
) -> Face | None:
    """Return the boundary of joined faces, if it is one loop that meets each corner once."""
    boundary = {
        sorted_edge(a, b): 0
        for face in faces
        for a, b in edges_of(face)
        if sum(i in members for i in owners[sorted_edge(a, b)]) == 1
    }
    loops = loops_of(boundary)
    return loops[0] if loops is not None and len(loops) == 1 else None


def loops_of(edges: Mapping[Edge, int]) -> list[Face] | None:
    """Return the loops of some edges, where several meet the shortest; None if one is open."""
    neighbours: dict[int, set[int]] = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    if any(len(n) % 2 for n in neighbours.values()) or len(edges) > MOST_OPEN:
        return None
    loops = []
    for first in sorted(neighbours):
        while neighbours[first]:
            loop = min(
                (_shortest(neighbours, first, n) for n in sorted(neighbours[first])), key=len
            )
            for a, b in zip(loop, [*loop[1:], loop[0]], strict=True):
                neighbours[a].discard(b)
                neighbours[b].discard(a)
            loops.append(loop)
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


HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = "close the hole with a face, or delete the faces around it"


def without_holes(mend: Mending, work: Work) -> Work:
    """Return the shell with its small holes closed; MeshError for a large one."""
    missing = open_edges(mend, work)
    if not missing:
        return work
    total = sum(area_of(mend.points[f]) for f in work.faces)
    largest = HOLE_SHARE * total if mend.largest_hole is None else mend.largest_hole
    loops = loops_of(missing)
    if loops is None:
        a, b = next(iter(missing))
        raise mend.refused(
            f"{len(missing)} open edges, the first from {mend.place(a)} to {mend.place(b)}, do not "
            f"bound a hole: faces are missing or cross each other there; {_LOOPS}",
            list(missing),
        )
    large = [loop for loop in loops if area_of(mend.points[loop]) > largest]
    if large:
        each = "; ".join(
            f"hole of {rounded(area_of(mend.points[loop]), 3)} m² at {mend.place(loop[0])}, beside "
            f'"{work.names[missing[sorted_edge(loop[0], loop[1])]]}"'
            for loop in sorted(large, key=lambda v: -area_of(mend.points[v]))[:MOST_PLACES]
        )
        more = f" ({len(large)} holes in all)" if len(large) > MOST_PLACES else ""
        raise mend.refused(
            f"{each}{more}; holes up to {rounded(largest, 3)} m² are "
            f"closed. {_hint(mend, large, work)}",
            list(missing),
        )
    closed, area, spread, unsure = [], 0.0, 0.0, []
    for loop in loops:
        size = area_of(mend.points[loop])
        longest = max(
            zip(loop, [*loop[1:], loop[0]], strict=True),
            key=lambda e: float(np.linalg.norm(mend.points[e[0]] - mend.points[e[1]])),
        )
        beside = missing[sorted_edge(*longest)]
        area += size
        spread += (size**1.5 / 4) ** 2
        closed.append(f"at {mend.place(loop[0])}, {work.materials[beside]}")
        unsure.append((work.materials[beside], ANY_SHARE * size))  # it may be of another material
        _fill(mend, work, loop, work.materials[beside])
    mend.found(
        "hole",
        "holes are closed with their neighbour's material",
        closed,
        area,
        surface=area,
        uncertainty=float(np.sqrt(spread)),
        unsure=unsure,
    )
    if again := open_edges(mend, work):
        a, b = next(iter(again))
        raise mend.refused(
            f"a hole at {mend.place(a)} to {mend.place(b)} cannot be closed by one face; {_LOOPS}",
            list(again),
        )
    return work


def _hint(mend: Mending, loops: Sequence[Face], work: Work) -> str:
    """Return how holes may be mended: faces whose corners nearly meet the edges ask for a weld."""
    loop = max(loops, key=lambda v: area_of(mend.points[v]))
    own = {v for face in work.faces for v in face}
    others = [v for v in mend.used if v not in own]
    if others:
        away, _ = cKDTree(mend.points[others]).query(mend.points[loop])
        if (distance := float(np.median(away))) < _NEAR:
            return (
                f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: state --weld "
                f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            )
    enough = rounded(1.01 * area_of(mend.points[loop]), 3)  # more than the area, as printed
    return f"In your program, {_LOOPS}; or state --hole {enough}"


def _fill(mend: Mending, work: Work, loop: Face, material: str) -> None:
    corners = mend.points[loop]
    off = np.abs((corners - corners.mean(axis=0)) @ normal_of(corners)).max()
    if off <= PLANARITY * 0.9 and area_of(corners) > SAME:
        work.add(loop, material, "closed hole")
        return
    # A narrow or warped loop: a strip of triangles from its ends, which meets every edge.
    low, high = 0, len(loop) - 1
    front = True
    while high - low >= 2:
        triangle = (
            (loop[low], loop[low + 1], loop[high])
            if front
            else (loop[low], loop[high - 1], loop[high])
        )
        if area_of(mend.points[list(triangle)]) > SAME**1.5:
            work.add(triangle, material, "closed hole")
        low, high = (low + 1, high) if front else (low, high - 1)
        front = not front


_LINES = 64
"""Lines along each side of the picture, 4096 in each direction."""
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians, so that no line lies in a wall."""
_NEIGHBOURS = 4
_GUESSED = 0.3
"""Relative standard uncertainty of the part that lines with an odd number of crossings tell."""


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
            polygon[np.array(facets.triangulate(polygon), dtype=int).reshape(-1, 3)]
            for polygon in map(np.asarray, polygons)
        ]  # a polygon without area has no triangle
    )
    if not len(corners):
        return 0.0, 0.0
    corners = corners @ _turned().T
    found = [_along(np.roll(corners, k, axis=2)) for k in range(3)]
    volumes, unknown = (np.array(column) for column in zip(*found, strict=True))
    weights = np.clip(1 - unknown, 1e-3, None) ** 4
    weights /= weights.sum()
    volume = float(weights @ volumes)
    spread = float(weights @ (volumes - volume) ** 2)
    guessed = _GUESSED * volume * float(weights @ unknown)
    return volume, float(np.sqrt(spread + guessed**2 + (volume / _LINES**1.5) ** 2))


def _turned() -> Array:
    """Return a small rotation, (3, 3)."""
    matrix = np.eye(3)
    for k, angle in enumerate(_TILT):
        i, j = (k + 1) % 3, (k + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        matrix = turn @ matrix
    return matrix


def _along(corners: Array) -> tuple[float, float]:
    """Return the volume by lines along the last axis, and the share of the lines that are unknown."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    step = (high - low)[:2] / _LINES
    if not step.all():
        return 0.0, 1.0
    middles = [low[k] + step[k] * (np.arange(_LINES) + 0.5) for k in range(2)]
    crossings: list[list[list[float]]] = [[[] for _ in range(_LINES)] for _ in range(_LINES)]
    for a, b, c in corners:
        first, second = b - a, c - a
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < 1e-12:
            continue
        ends = np.array([a, b, c])[:, :2]
        start = np.ceil((ends.min(axis=0) - low[:2]) / step - 0.5).astype(int)
        stop = np.floor((ends.max(axis=0) - low[:2]) / step - 0.5).astype(int)
        rows, columns = (
            np.arange(max(s, 0), min(e, _LINES - 1) + 1) for s, e in zip(start, stop, strict=True)
        )
        x, y = np.meshgrid(middles[0][rows] - a[0], middles[1][columns] - a[1], indexing="ij")
        u = (x * second[1] - y * second[0]) / area
        v = (first[0] * y - first[1] * x) / area
        for i, k in np.argwhere((u >= 0) & (v >= 0) & (u + v <= 1)):
            depth = a[2] + u[i, k] * first[2] + v[i, k] * second[2]
            crossings[rows[i]][columns[k]].append(float(depth))
    lengths = np.zeros((_LINES, _LINES))
    for i in range(_LINES):
        for k in range(_LINES):
            at = sorted(crossings[i][k])
            odd = len(at) % 2 == 1
            lengths[i, k] = np.nan if odd else sum(at[1::2]) - sum(at[::2])
    unknown = np.isnan(lengths)
    inside = unknown | (lengths > 0)
    if not (lengths > 0).any():
        return 0.0, 1.0
    return float(_filled(lengths).sum() * step.prod()), float(unknown.sum() / inside.sum())


def _filled(lengths: Array) -> Array:
    """Return the lengths with those of unknown lines as the mean of their known neighbours."""
    known = lengths > 0
    mean = float(lengths[known].mean())
    filled = np.nan_to_num(lengths, nan=0.0)
    for i, k in np.argwhere(np.isnan(lengths)):
        near = np.s_[
            max(i - _NEIGHBOURS, 0) : i + _NEIGHBOURS + 1,
            max(k - _NEIGHBOURS, 0) : k + _NEIGHBOURS + 1,
        ]
        beside = lengths[near][known[near]]
        filled[i, k] = beside.mean() if beside.size else mean
    return filled
