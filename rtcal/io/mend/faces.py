"""Defects of a mesh, and the mesh while it is mended: faces as drawn and as worked on, and limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rtcal.acoustics.room import Surface
from rtcal.simulators.geometry import Polyhedron
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
        In m³, by rays (`rtcal.io.mend.polygons`).
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
