"""A mesh as it comes to a closed room: every defect found, mended where that is safe, and listed.

Models for room acoustics are drawn for other programs: joints are rounded to a centimetre, windows lie
on walls, reflectors hang free, tables have no bottom. In this order

1. corners within ``weld`` of each other become one, and corners within ``weld`` of an edge are moved
   onto it;
2. faces narrower than ``weld`` (slivers) and faces drawn twice are dropped; faces that are not plane
   are divided into triangles;
3. small holes of the room's shell are closed, with the material of the face at their longest edge;
4. a face on a larger one (a window on its wall, up to ``offset`` before it) takes its area;
5. an object that stands on a face with an open bottom takes its footprint from that face;
6. a free panel becomes a reflector with two sides, `THICKNESS` thick;
7. what lies outside the shell is left out.

Each is a `Defect` with its number, area and effects on V and S. What cannot be mended safely is
refused, and the message says how to mend it in the program that drew it. Needs shapely
(``rtcal[mesh]``) where a face is to be cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from rtcal.errors import DataError, MissingDependencyError
from rtcal.simulators import triangles as _triangles
from rtcal.simulators.geometry import PLANARITY, Polyhedron
from rtcal.support.arguments import checked
from rtcal.support.types import Array

WELD = 0.01
"""Default distance in m: models are drawn to the centimetre, and no wavelength is as short."""
OFFSET = 0.05
"""Default distance in m up to which a face lies on another: the depth of a window's frame."""
HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""
COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
MOST_FACES = 6000
_SAME = 1e-6
_MOST_OPEN = 5000
"""Largest number of open edges whose loops are sought."""
_MOST_PLACES = 5
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = "close the hole with a face, or delete the faces around it"

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
    """

    path: str
    polygons: Sequence[Array]
    materials: Sequence[str]
    names: Sequence[str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Defect:
    """A kind of defect, and what was done.

    Parameters
    ----------
    kind : str
        "joint", "sliver", "twice", "bent", "hole", "overlay", "open bottom", "panel", "turned",
        "outside".
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
    """

    kind: str
    number: int
    area: float
    volume_effect: float
    area_effect: float
    volume_uncertainty: float
    places: tuple[str, ...]
    done: str

    def __str__(self) -> str:
        """Return the defect as one line."""
        parts = [f"{self.number} {self.done}"]
        if self.area:
            parts.append(f"{self.area:.3g} m²")
        for symbol, effect, unit in (
            ("V", self.volume_effect, "m³"),
            ("S", self.area_effect, "m²"),
        ):
            if effect:
                parts.append(f"{symbol} {effect:+.3g} {unit}")
        if self.volume_uncertainty:
            parts.append(f"u(V) {self.volume_uncertainty:.2g} m³")
        more = ", ..." if self.number > len(self.places) else ""
        at = f" ({', '.join(self.places)}{more})" if self.places else ""
        return f"{self.kind}: {', '.join(parts)}{at}"


class MeshError(DataError):
    """A mesh that is refused; ``defects`` are those found until then, ``edges`` where it is open."""

    defects: tuple[Defect, ...] = ()
    edges: Array = np.zeros((0, 2, 3))


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
    def volume_uncertainty(self) -> float:
        """Standard uncertainty of V in m³ by mending, the root of the sum of squares."""
        return float(np.sqrt(sum(d.volume_uncertainty**2 for d in self.defects)))

    def __str__(self) -> str:
        """Return V, S, the areas of the materials, and each defect."""
        total = float(np.sum(self.geometry.face_areas))
        u = f" ± {self.volume_uncertainty:.2g}" if self.volume_uncertainty else ""
        n = len(self.geometry.faces)
        head = f"V = {self.geometry.volume:.6g}{u} m³, S = {total:.6g} m², {n} faces"
        rows = [f"{area:10.3f} m²  {name}" for name, area in self.geometry.areas.items()]
        found = [f"  {defect}" for defect in self.defects] or ["  none"]
        return "\n".join([head, *rows, "defects:", *found])


@checked
def mended(
    faces: Faces,
    *,
    weld: float = WELD,
    offset: float = OFFSET,
    largest_hole: float | None = None,
) -> Mended:
    """Return the closed room of some faces, and every defect.

    Parameters
    ----------
    faces : Faces
    weld : float
        Distance in m within which corners are one.
    offset : float
        Distance in m up to which a face lies on another.
    largest_hole : float, optional
        Largest area in m² of a hole that is closed; by default 1 % of the shell's area.

    Raises
    ------
    MeshError
        For a mesh without a closed room. It names the defect, where, and how to mend it.
    MissingDependencyError
        Without shapely, if a face must be cut.
    """
    for name, value in (("weld", weld), ("offset", offset)):
        if not 0 <= value < np.inf:
            raise DataError(f"{name} = {value:g} m is not finite and 0 or more")
    if largest_hole is not None and not 0 <= largest_hole < np.inf:
        raise DataError(f"largest_hole = {largest_hole:g} m² is not finite and 0 or more")
    if not faces.polygons:
        raise DataError(f"{faces.path}: there is no face; a room has at least 4")
    if len(faces.polygons) > 20 * MOST_FACES:
        raise DataError(f"{faces.path}: {len(faces.polygons)} faces; at most {20 * MOST_FACES}")
    return _Mender(faces, max(weld, _SAME), offset, largest_hole).mended()


_Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""


def closed(faces: Faces) -> Mended | None:
    """Return the room of faces that close as they are drawn; None if they do not."""
    if not 4 <= len(faces.polygons) <= MOST_FACES // 4:
        return None
    try:
        polygons = zip(_numbered(faces.names), faces.materials, faces.polygons, strict=True)
        geometry = Polyhedron.from_polygons(list(polygons))
    except DataError:  # not closed, or a defect that `mended` names
        return None
    mender = _Mender(faces, _SAME, 0.0, None)
    mender.turned(geometry)
    return Mended(geometry, tuple(mender.defects), faces.notes)


@dataclass
class _Work:
    """The faces of one state of the work."""

    faces: list[Face] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def add(self, face: Iterable[int], material: str, name: str) -> None:
        self.faces.append(list(face))
        self.materials.append(material)
        self.names.append(name)

    def extend(self, other: _Work) -> None:
        self.faces += other.faces
        self.materials += other.materials
        self.names += other.names

    def kept(self, which: Sequence[bool]) -> _Work:
        index = [i for i, keep in enumerate(which) if keep]
        return _Work(
            [self.faces[i] for i in index],
            [self.materials[i] for i in index],
            [self.names[i] for i in index],
        )


class _Mender:
    """Mends one mesh, step by step; ``points`` are the corners in m."""

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

    def mended(self) -> Mended:
        work = self.welded()
        work = self.without_repetitions(work)
        work = self.joined(work)
        work = self.snapped(work)
        work = self.plane(work)
        self.used = sorted({v for face in work.faces for v in face})
        shell, others = self.shell(work)
        shell = self.with_others(shell, others)
        if len(shell.faces) > MOST_FACES:
            raise self.refused(
                f"{len(shell.faces)} faces; at most {MOST_FACES}: simplify the model"
            )
        try:
            geometry = Polyhedron(
                vertices=self.points,
                faces=[tuple(f) for f in shell.faces],
                materials=shell.materials,
                names=_numbered(shell.names),
            )
        except DataError as error:
            raise self.refused(f"after mending, {error}") from error
        self.turned(geometry)
        return Mended(geometry, tuple(self.defects), self.drawn.notes)

    def found(
        self,
        kind: str,
        done: str,
        places: Sequence[str],
        area: float = 0.0,
        volume: float = 0.0,
        surface: float = 0.0,
        uncertainty: float = 0.0,
        number: int | None = None,
    ) -> None:
        self.defects.append(
            Defect(
                kind,
                len(places) if number is None else number,
                area,
                volume,
                surface,
                uncertainty,
                tuple(places[:_MOST_PLACES]),
                done,
            )
        )

    def refused(self, message: str, edges: Sequence[Edge] = ()) -> MeshError:
        """Return the error that says what is wrong; the defects found before are in it, too."""
        others = f". Found before: {'; '.join(map(str, self.defects))}" if self.defects else ""
        error = MeshError(f"{self.path}: {message}{others}")
        error.defects = tuple(self.defects)
        error.edges = self.points[np.array(edges, dtype=int).reshape(-1, 2)]
        return error

    # -- 1: corners

    def welded(self) -> _Work:
        """Return the faces with corners within ``weld`` of each other as one."""
        drawn = np.concatenate([np.asarray(p, dtype=float) for p in self.drawn.polygons])
        if not np.isfinite(drawn).all():
            raise DataError(f"{self.path}: a corner is not finite")
        tree = cKDTree(drawn)
        index = np.full(len(drawn), -1)
        groups: list[list[int]] = []
        for i in range(len(drawn)):
            if index[i] < 0:
                near = [k for k in tree.query_ball_point(drawn[i], self.weld) if index[k] < 0]
                index[near] = len(groups)
                groups.append(near)
        self.points = np.array([drawn[g].mean(axis=0) for g in groups])
        shifts = np.linalg.norm(self.points[index] - drawn, axis=1)
        moved = [k for k, g in enumerate(groups) if shifts[g].max() > 1e-4]
        work, first, spread = _Work(), 0, 0.0
        for polygon, material, name in zip(
            self.drawn.polygons, self.drawn.materials, self.drawn.names, strict=True
        ):
            corners = slice(first, first + len(polygon))
            first += len(polygon)
            spread += (_area(np.asarray(polygon)) * float(shifts[corners].mean())) ** 2
            work.add(map(int, index[corners]), material, name)
        if moved:
            self.found(
                "joint",
                f"corners that lay up to {2 * shifts.max() * 1000:.2g} mm apart are joined",
                [self.place(k) for k in moved],
                uncertainty=float(np.sqrt(spread)),
            )
        return self.cleaned(work)

    def cleaned(self, work: _Work) -> _Work:
        """Return the faces without repeated corners, and without slivers."""
        kept, slivers, area = [], [], 0.0
        for i, face in enumerate(work.faces):
            work.faces[i] = face = _simple(face)
            size = _area(self.points[face]) if len(face) > 2 else 0.0
            narrow = len(face) < 3 or size < self.weld * _extent(self.points[face]) / 2
            kept.append(not narrow)
            if narrow:
                slivers.append(work.names[i])
                area += size
        if slivers:
            self.found(
                "sliver",
                f"faces narrower than {self.weld * 1000:g} mm are dropped",
                slivers,
                area,
                surface=-area,
            )
        if not any(kept):
            corners = np.concatenate([np.asarray(p) for p in self.drawn.polygons])
            across = np.linalg.norm(np.ptp(corners, axis=0))
            raise self.refused(
                f"every face is narrower than the weld distance of {self.weld * 1000:g} mm: as read, "
                f"the mesh is {across * 1000:.2g} mm across. State a larger --unit, such "
                "as 1 for a mesh drawn in m, or a smaller --weld"
            )
        return work.kept(kept)

    def snapped(self, work: _Work) -> _Work:
        """Return the faces with corners that are near an edge moved onto it."""
        moved: dict[int, float] = {}
        for _ in range(4):
            shift = self._snap_once(work)
            for corner, distance in shift.items():
                moved[corner] = max(moved.get(corner, 0.0), distance)
            if not shift:
                break
        if moved:
            size = sum(
                (_area(self.points[f]) * np.mean([moved.get(v, 0.0) for v in f])) ** 2
                for f in work.faces
            )
            self.found(
                "joint",
                f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
                [self.place(v) for v in moved],
                uncertainty=float(np.sqrt(size)),
            )
        return self.cleaned(work)

    def _snap_once(self, work: _Work) -> dict[int, float]:
        tree = cKDTree(self.points)
        best: dict[int, tuple[float, Array]] = {}
        for a, b in {(min(e), max(e)) for face in work.faces for e in _edges(face)}:
            start, along = self.points[a], self.points[b] - self.points[a]
            length = float(np.linalg.norm(along))
            near = tree.query_ball_point(start + along / 2, length / 2 + self.weld)
            for v in near:
                if v in (a, b):
                    continue
                position = float((self.points[v] - start) @ along) / length
                foot = start + along * position / length
                distance = float(np.linalg.norm(self.points[v] - foot))
                if (
                    _SAME < distance <= self.weld
                    and self.weld < position < length - self.weld
                    and distance < best.get(v, (np.inf,))[0]
                ):
                    best[v] = distance, foot
        for v, (_, foot) in best.items():
            self.points[v] = foot
        return {v: distance for v, (distance, _) in best.items()}

    # -- 2: faces

    def without_repetitions(self, work: _Work) -> _Work:
        """Return the faces without those that are drawn twice."""
        seen: dict[frozenset[int], int] = {}
        kept, twice, area = [], [], 0.0
        for i, face in enumerate(work.faces):
            key = frozenset(face)
            kept.append(key not in seen)
            if key in seen:
                area += _area(self.points[face])
                other = work.materials[seen[key]]
                differs = f", {work.materials[i]} on {other}" if work.materials[i] != other else ""
                twice.append(work.names[i] + differs)
            seen.setdefault(key, i)
        if twice:
            self.found("twice", "faces drawn twice are taken once", twice, area, surface=-area)
        return work.kept(kept)

    def joined(self, work: _Work) -> _Work:
        """Return the faces with neighbours in one plane and of one material and name as one polygon."""
        if len(work.faces) < 8 or not all(len(f) == 3 for f in work.faces):
            return work
        owners: dict[Edge, list[int]] = {}
        for i, face in enumerate(work.faces):
            for a, b in _edges(face):
                owners.setdefault((min(a, b), max(a, b)), []).append(i)
        normals = np.array([_normal(self.points[f]) for f in work.faces])
        group = np.full(len(work.faces), -1)
        out = _Work()
        links: list[list[int]] = [[] for _ in work.faces]
        for sides in owners.values():
            if len(sides) == 2:
                links[sides[0]].append(sides[1])
                links[sides[1]].append(sides[0])
        for first in range(len(work.faces)):
            if group[first] >= 0:
                continue
            group[first] = first
            members, corners = [first], set(work.faces[first])
            for i in members:  # the list grows during the loop
                for j in links[i]:
                    if (
                        group[j] < 0
                        and work.materials[j] == work.materials[first]
                        and abs(float(normals[j] @ normals[first])) > 0.99
                        and _plane(self.points[[*corners, *work.faces[j]]])[1] < PLANARITY * 0.9
                    ):
                        corners |= set(work.faces[j])
                        group[j] = first
                        members.append(j)
            loop = _one_loop([work.faces[i] for i in members], owners, set(members))
            if loop is not None and len(members) > 1:
                out.add(self._straightened(loop), work.materials[first], work.names[first])
            else:
                for i in members:
                    out.add(work.faces[i], work.materials[i], work.names[i])
        return out

    def _straightened(self, loop: Face) -> Face:
        """Return a polygon without corners on a straight line, which T-junctions find by themselves."""
        kept = []
        for k, v in enumerate(loop):
            before, after = self.points[loop[k - 1]], self.points[loop[(k + 1) % len(loop)]]
            a, b = self.points[v] - before, after - self.points[v]
            if np.linalg.norm(np.cross(a, b)) > 1e-5 * np.linalg.norm(a) * np.linalg.norm(b):
                kept.append(v)
        return kept if len(kept) > 2 else loop

    def plane(self, work: _Work) -> _Work:
        """Return the faces with those that are not plane divided into triangles."""
        out, bent, area = _Work(), [], 0.0
        for face, material, name in zip(work.faces, work.materials, work.names, strict=True):
            corners = self.points[face]
            off = np.abs((corners - corners.mean(axis=0)) @ _normal(corners)).max()
            if off <= PLANARITY * 0.9:
                out.add(face, material, name)
                continue
            if off > self.weld:  # else it is a joint's, told already
                bent.append(name)
                area += _area(corners)
            for triangle in _triangles.triangulate(corners):
                out.add((face[k] for k in triangle), material, name)
        if bent:
            self.found("bent", "faces that are not plane are divided into triangles", bent, area)
        return out

    # -- 3: the shell

    def shell(self, work: _Work) -> tuple[_Work, list[_Work]]:
        """Return the closed shell of the room, with its holes closed, and the other components."""
        parts = [work.kept([i in set(p) for i in range(len(work.faces))]) for p in self.parts(work)]
        sizes = [float(np.prod(np.sort(np.ptp(self._corners(p), axis=0))[1:])) for p in parts]
        areas = [sum(_area(self.points[f]) for f in p.faces) for p in parts]
        # The shell encloses all: its box is the largest, and no flat component's is a room's.
        solid = [i for i, p in enumerate(parts) if _plane(self._corners(p))[1] > 5 * self.weld]
        if not solid:
            raise self.refused(
                "no faces enclose a volume: draw the walls, the floor and the ceiling"
            )
        main = max(solid, key=lambda i: (round(sizes[i], 3), areas[i]))
        shell = self.without_holes(parts[main])
        return shell, [p for i, p in enumerate(parts) if i != main]

    def parts(self, work: _Work) -> list[list[int]]:
        """Return the faces of each component: faces are joined where two meet in an edge."""
        links: list[list[int]] = [[] for _ in work.faces]
        for sides in self.owners(work.faces).values():
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
            parts.append(part)
        return parts

    def owners(self, faces: Sequence[Face]) -> dict[Edge, list[int]]:
        """Return the faces at each piece of an edge, which every corner on it divides."""
        used = sorted({v for face in faces for v in face})
        tree = cKDTree(self.points[used])
        pieces: dict[Edge, list[int]] = {}
        divided: dict[Edge, list[int]] = {}
        for i, face in enumerate(faces):
            for a, b in _edges(face):
                low, high = min(a, b), max(a, b)
                if (low, high) not in divided:
                    divided[low, high] = self._divided(low, high, used, tree)
                for edge in pairwise(divided[low, high]):
                    pieces.setdefault((min(edge), max(edge)), []).append(i)
        return pieces

    def _divided(self, a: int, b: int, used: Sequence[int], tree: Any) -> list[int]:
        start, along = self.points[a], self.points[b] - self.points[a]
        length = float(np.linalg.norm(along))
        if length < 1e-9:
            return [a, b]
        between = []
        for k in tree.query_ball_point(start + along / 2, length / 2):
            v = used[k]
            position = float((self.points[v] - start) @ along) / length
            away = np.linalg.norm(self.points[v] - start - along * position / length)
            if v not in (a, b) and away < 1e-4 and 1e-4 < position < length - 1e-4:
                between.append((position, v))
        return [a, *(v for _, v in sorted(between)), b]

    def _corners(self, work: _Work) -> Array:
        return self.points[sorted({v for face in work.faces for v in face})]

    def open_edges(self, work: _Work) -> dict[Edge, int]:
        """Return the pieces of edges at which one face, or an odd number, meets; with one of them."""
        return {e: s[0] for e, s in self.owners(work.faces).items() if len(s) % 2}

    def without_holes(self, work: _Work) -> _Work:
        """Return the shell with its small holes closed; MeshError for a large one."""
        missing = self.open_edges(work)
        if not missing:
            return work
        total = sum(_area(self.points[f]) for f in work.faces)
        largest = HOLE_SHARE * total if self.largest_hole is None else self.largest_hole
        loops = _loops(missing)
        if loops is None:
            a, b = next(iter(missing))
            raise self.refused(
                f"{len(missing)} open edges, the first from {self.place(a)} to {self.place(b)}, do not "
                f"bound a hole: faces are missing or cross each other there; {_LOOPS}",
                list(missing),
            )
        large = [loop for loop in loops if _area(self.points[loop]) > largest]
        if large:
            each = "; ".join(
                f"hole of {_area(self.points[loop]):.3g} m² at {self.place(loop[0])}, beside "
                f'"{work.names[missing[_sorted(loop[0], loop[1])]]}"'
                for loop in sorted(large, key=lambda v: -_area(self.points[v]))[:_MOST_PLACES]
            )
            more = f" ({len(large)} holes in all)" if len(large) > _MOST_PLACES else ""
            raise self.refused(
                f"{each}{more}; holes up to {largest:.2g} m² are closed. {self.hint(large, work)}",
                list(missing),
            )
        closed, area, spread = [], 0.0, 0.0
        for loop in loops:
            size = _area(self.points[loop])
            longest = max(
                zip(loop, [*loop[1:], loop[0]], strict=True),
                key=lambda e: float(np.linalg.norm(self.points[e[0]] - self.points[e[1]])),
            )
            beside = missing[_sorted(*longest)]
            area += size
            spread += (size**1.5 / 4) ** 2
            closed.append(f"at {self.place(loop[0])}, {work.materials[beside]}")
            self._fill(work, loop, work.materials[beside])
        self.found(
            "hole",
            "holes are closed with their neighbour's material",
            closed,
            area,
            surface=area,
            uncertainty=float(np.sqrt(spread)),
        )
        if again := self.open_edges(work):
            a, b = next(iter(again))
            raise self.refused(
                f"a hole at {self.place(a)} to {self.place(b)} cannot be closed by one face; {_LOOPS}",
                list(again),
            )
        return work

    def hint(self, loops: Sequence[Face], work: _Work) -> str:
        """Return how holes may be mended: faces whose corners nearly meet the edges ask for a weld."""
        loop = max(loops, key=lambda v: _area(self.points[v]))
        own = {v for face in work.faces for v in face}
        others = [v for v in self.used if v not in own]
        if others:
            away, _ = cKDTree(self.points[others]).query(self.points[loop])
            if (distance := float(np.median(away))) < _NEAR:
                return (
                    f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: state --weld "
                    f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
                )
        return f"In your program, {_LOOPS}; or state --hole {_area(self.points[loop]) * 1.01:.2g}"

    def _fill(self, work: _Work, loop: Face, material: str) -> None:
        corners = self.points[loop]
        off = np.abs((corners - corners.mean(axis=0)) @ _normal(corners)).max()
        if off <= PLANARITY * 0.9 and _area(corners) > _SAME:
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
            if _area(self.points[list(triangle)]) > _SAME**1.5:
                work.add(triangle, material, "closed hole")
            low, high = (low + 1, high) if front else (low, high - 1)
            front = not front

    # -- 4 to 7: what is on and in the shell

    def with_others(self, shell: _Work, others: Sequence[_Work]) -> _Work:
        """Return the shell with overlays, objects and panels; what lies outside is left out."""
        if not others:
            return shell
        hull = Polyhedron(
            vertices=self.points, faces=[tuple(f) for f in shell.faces], materials=shell.materials
        )
        cuts: dict[int, list[_Cut]] = {}
        added, panels = _Work(), list[_Work]()
        told: dict[str, list[tuple[str, float, float, float]]] = {}

        def tell(kind: str, part: _Work, size: float, volume: float, surface: float) -> None:
            told.setdefault(kind, []).append((part.names[0], size, volume, surface))

        for part in others:
            size = sum(_area(self.points[f]) for f in part.faces)
            if not self._within(hull, self._corners(part)):
                tell("outside", part, size, 0.0, 0.0)
            elif not self.open_edges(part):
                added.extend(part)
            elif (flat := self._overlaid(shell, part)) is not None:
                moved = 0.0
                for wall, pieces, distance in flat:
                    cuts.setdefault(wall, []).extend(pieces)
                    moved += sum(distance * piece.area for piece, _, _ in pieces)
                tell("overlay", part, size, moved, -size)
            elif (foot := self._standing(shell, part)) is not None:
                prints, stood = foot
                for wall, footprint in prints:
                    cuts.setdefault(wall, []).append((footprint, None, ""))
                added.extend(stood)
                base = self.points[shell.faces[prints[0][0]]]
                covered = sum(footprint.area for _, footprint in prints)
                volume = -abs(_signed_volume(self, stood, base[0]))
                tell("open bottom", part, size, volume, size - covered)
            else:
                panels.append(part)
                tell("panel", part, size, -THICKNESS * size, size)
        self._tell_others(told)
        shell = self._cut(shell, cuts)
        shell.extend(added)
        if cuts:
            shell = self.plane(self._snapped(self._rewelded(shell)))
            shell = shell.kept([_area(self.points[f]) > _SAME for f in shell.faces])
        for part in panels:
            for face, material, name in zip(part.faces, part.materials, part.names, strict=True):
                self._slab(shell, face, material, name)
        return shell

    def _tell_others(self, told: Mapping[str, Sequence[tuple[str, float, float, float]]]) -> None:
        words = {
            "overlay": "faces on a larger one take its area",
            "open bottom": "objects with an open bottom stand on a face, and take its area",
            "panel": "free panels are reflectors with two sides",
            "outside": "components outside the room are left out",
        }
        for kind, rows in told.items():
            area, volume, surface = np.sum([row[1:] for row in rows], axis=0).tolist()
            uncertainty = abs(volume) / np.sqrt(3) if kind == "overlay" else 0.0
            names = [row[0] for row in rows]
            self.found(kind, words[kind], names, area, volume, surface, float(uncertainty))

    def _rewelded(self, work: _Work) -> _Work:
        """Return the faces with the corners that cutting has made on older ones that are near."""
        used = sorted({v for face in work.faces for v in face})
        tree = cKDTree(self.points[used])
        index: dict[int, int] = {}
        for k, v in enumerate(used):
            near = min(tree.query_ball_point(self.points[v], self.weld / 2))
            index[v] = index.get(used[near], used[near]) if near < k else v
        faces = [_simple([index[v] for v in face]) for face in work.faces]
        return _Work(faces, work.materials, work.names).kept(
            [len(f) > 2 and _area(self.points[f]) > _SAME for f in faces]
        )

    def _snapped(self, work: _Work) -> _Work:
        for _ in range(4):
            if not self._snap_once(work):
                break
        return work

    def _within(self, hull: Polyhedron, corners: Array) -> bool:
        """Return whether a component is in the room: its corners, but for those at the walls, are."""
        away = hull.wall_distance(corners) > self.offset + self.weld
        outside = ~hull.contains(corners)
        return not bool((away & outside).any())

    def _overlaid(self, shell: _Work, part: _Work) -> list[tuple[int, list[_Cut], float]] | None:
        """Return the pieces of a plane component on each face of the shell; None if it lies on none."""
        corners = self._corners(part)
        normal, thick = _plane(corners)
        if thick > max(self.weld, PLANARITY):
            return None
        total, found = 0.0, list[tuple[int, list[_Cut], float]]()
        for i, face in enumerate(shell.faces):
            base = self.points[face]
            wall = _normal(base)
            distance = np.abs((corners - base.mean(axis=0)) @ wall).max()
            if abs(float(wall @ normal)) < 0.99 or distance > self.offset:
                continue
            axes = _axes(wall)
            ground = _polygon(base, axes)
            pieces = list[_Cut]()
            for own, material, name in zip(part.faces, part.materials, part.names, strict=True):
                shape = _shapely().snap(_polygon(self.points[own], axes), ground, self.weld)
                for piece in _polygons(shape.intersection(ground)):
                    if piece.area > self.weld**2:
                        pieces.append((piece, material, name))
                        total += piece.area
            if pieces:
                found.append((i, pieces, float(distance)))
        size = sum(_area(self.points[f]) for f in part.faces)
        if not found or total < COVERED * size:
            return None
        return found

    def _standing(self, shell: _Work, part: _Work) -> tuple[list[tuple[int, Any]], _Work] | None:
        """Return the footprint of an object with an open bottom on each face, and its faces there."""
        loops = _loops(self.open_edges(part))
        if loops is None or len(loops) != 1:
            return None
        loop = loops[0]
        size = _area(self.points[loop])
        if size > 0.5 * sum(_area(self.points[f]) for f in part.faces):
            return None  # a sheet, whose boundary it is
        found, total, moved = [], 0.0, {}
        for i, face in enumerate(shell.faces):
            base = self.points[face]
            normal = _normal(base)
            away = (self.points[loop] - base.mean(axis=0)) @ normal
            if np.abs(away).max() > self.offset:
                continue
            axes = _axes(normal)
            ground = _polygon(base, axes)
            for piece in _polygons(_polygon(self.points[loop], axes).intersection(ground)):
                found.append((i, piece))
                total += piece.area
            for v, distance in zip(loop, away, strict=True):
                if ground.distance(_shapely().Point(*(axes @ self.points[v]))) < _SAME:
                    moved[v] = self.points[v] - normal * float(distance)
        if total < COVERED * size or len(moved) < len(loop):
            return None
        for v, point in moved.items():
            self.points[v] = point
        return found, self.plane(part)

    def _add_piece(self, added: _Work, wall: Face, piece: Any, material: str, name: str) -> None:
        """Add a piece in a wall's plane, in triangles if it has holes."""
        axes = _axes(_normal(self.points[wall]))
        rings = (
            [piece.exterior]
            if not piece.interiors
            else [t.exterior for t in _polygons(_shapely().constrained_delaunay_triangles(piece))]
        )
        for ring in rings:
            flat = np.array(ring.coords)[:-1]
            added.add(self._new_points(self._lifted(flat, wall, axes)), material, name)

    def _lifted(self, flat: Array, wall: Face, axes: Array) -> Array:
        """Return points of a wall's plane, (n, 2), in space; those on its boundary as it is drawn."""
        base, normal = self.points[wall], _normal(self.points[wall])
        lifted = np.asarray(flat @ axes + normal * float(base.mean(axis=0) @ normal))
        for k in range(len(wall)):
            start, along = axes @ base[k - 1], axes @ (base[k] - base[k - 1])
            share = np.clip((flat - start) @ along / (along @ along), 0, 1)
            away = np.linalg.norm(flat - start - share[:, np.newaxis] * along, axis=1)
            on_edge = away < 1e-5
            lifted[on_edge] = base[k - 1] + share[on_edge, np.newaxis] * (base[k] - base[k - 1])
        return lifted

    def _new_points(self, corners: Array) -> list[int]:
        first = len(self.points)
        self.points = np.concatenate([self.points, corners])
        return list(range(first, first + len(corners)))

    def _cut(self, shell: _Work, cuts: Mapping[int, Sequence[_Cut]]) -> _Work:
        """Return the shell with what lies on its faces in their place, the smaller first."""
        out = _Work()
        for i, (face, material, name) in enumerate(
            zip(shell.faces, shell.materials, shell.names, strict=True)
        ):
            if i not in cuts:
                out.add(face, material, name)
                continue
            ground = _polygon(self.points[face], _axes(_normal(self.points[face])))
            taken = _shapely().Polygon()
            for shape, own, called in [
                *sorted(cuts[i], key=lambda c: float(c[0].area)),
                (ground, material, name),
            ]:
                for piece in _polygons(shape.difference(taken)):
                    if own is not None and piece.area > self.weld**2:
                        self._add_piece(out, face, piece, own, called)
                taken = taken.union(shape)
        return out

    def _slab(self, shell: _Work, face: Face, material: str, name: str) -> None:
        """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
        axes = _axes(_normal(self.points[face]))
        inner = _polygon(self.points[face], axes).buffer(-THICKNESS / 2, join_style="mitre")
        for piece in _polygons(inner):
            half = _normal(self.points[face]) * THICKNESS / 2
            corners = self._lifted(np.array(piece.exterior.coords)[:-1], face, axes)
            front = self._new_points(corners + half)
            back = self._new_points(corners - half)
            shell.add(front, material, name)
            shell.add(back[::-1], material, f"{name} back")
            for k in range(len(front)):
                j = (k + 1) % len(front)
                shell.add((front[j], front[k], back[k], back[j]), material, f"{name} edge")

    def turned(self, geometry: Polyhedron) -> None:
        """Note the drawn faces whose orientation differs from that of most."""
        normals = {
            _key(np.asarray(p)): _normal(np.asarray(p)) for p in self.drawn.polygons if len(p) > 2
        }
        agree = {}
        for name, face, normal in zip(
            geometry.names, geometry.faces, geometry.normals, strict=True
        ):
            drawn = normals.get(_key(geometry.vertices[list(face)]))
            if drawn is not None:
                agree[name] = float(drawn @ normal) > 0
        against = [n for n, same in agree.items() if not same]
        if len(against) > len(agree) / 2:
            against = [n for n, same in agree.items() if same]
        if against:
            self.found("turned", "faces with the other orientation than most are turned", against)

    def place(self, corner: int) -> str:
        return "(" + ", ".join(f"{x:.4g}" for x in self.points[corner]) + ") m"


def _key(corners: Array) -> tuple[float, ...]:
    return tuple(np.round(corners.mean(axis=0), 3).tolist())


def _edges(face: Sequence[int]) -> Iterable[Edge]:
    return ((face[k - 1], face[k]) for k in range(len(face)))


def _sorted(a: int, b: int) -> Edge:
    return (min(a, b), max(a, b))


def _simple(face: Face) -> Face:
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


def _area(corners: Array) -> float:
    return float(np.linalg.norm(_triangles.vector_area(corners)))


def _normal(corners: Array) -> Array:
    area = _triangles.vector_area(corners)
    size = float(np.linalg.norm(area))
    return np.asarray(area / size if size else np.array([0.0, 0.0, 1.0]))


def _plane(corners: Array) -> tuple[Array, float]:
    """Return the normal of the plane that fits some points best, and their largest distance from it."""
    away = corners - corners.mean(axis=0)
    normal = np.linalg.svd(away, full_matrices=False)[2][-1]
    return np.asarray(normal), float(np.abs(away @ normal).max())


def _extent(corners: Array) -> float:
    """Return the largest distance of two corners in m."""
    return float(np.linalg.norm(corners[:, np.newaxis] - corners[np.newaxis], axis=-1).max())


def _axes(normal: Array) -> Array:
    """Return two unit vectors of the plane, (2, 3)."""
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def _polygon(corners: Array, axes: Array) -> Any:
    polygon = _shapely().Polygon(corners @ axes.T)
    return polygon if polygon.is_valid else polygon.buffer(0)


def _polygons(shape: Any) -> list[Any]:
    """Return the polygons of a shape, without the points and lines at which shapes touch."""
    parts = getattr(shape, "geoms", [shape])
    return [p for p in parts if p.geom_type == "Polygon" and not p.is_empty]


def _one_loop(
    faces: Sequence[Face], owners: Mapping[Edge, Sequence[int]], members: set[int]
) -> Face | None:
    """Return the boundary of joined faces, if it is one loop that meets each corner once."""
    boundary = {
        _sorted(a, b): 0
        for face in faces
        for a, b in _edges(face)
        if sum(i in members for i in owners[_sorted(a, b)]) == 1
    }
    loops = _loops(boundary)
    return loops[0] if loops is not None and len(loops) == 1 else None


def _loops(edges: Mapping[Edge, int]) -> list[Face] | None:
    """Return the loops of some edges, where several meet the shortest; None if one is open."""
    neighbours: dict[int, set[int]] = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    if any(len(n) % 2 for n in neighbours.values()) or len(edges) > _MOST_OPEN:
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


def _signed_volume(mender: _Mender, work: _Work, base: Array) -> float:
    """Return the volume between a component and a point of the plane that closes it."""
    faces = [mender.points[f] - base for f in work.faces]
    # Its faces may have either orientation: those away from its middle are taken as outward.
    middle = np.mean([f.mean(axis=0) for f in faces], axis=0)
    volume = 0.0
    for corners in faces:
        area = _triangles.vector_area(corners)
        sign = np.sign((corners.mean(axis=0) - middle) @ area)
        volume += float(sign * (corners[0] @ area)) / 3
    return volume


def _numbered(names: Sequence[str]) -> list[str]:
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


def _shapely() -> Any:
    try:
        import shapely
    except ImportError as error:
        raise MissingDependencyError(
            "a face is to be cut, which needs shapely: pip install 'rtcal[mesh]'"
        ) from error
    return shapely
