"""A mesh while it is mended: its faces as drawn and as worked on, its limits, the defects so far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rtcal.io.mend.defects import Defect, MeshError, combined
from rtcal.support.types import Array

MOST_PLACES = 5
ANY_SHARE = 1 / np.sqrt(3)
"""Of an area of which any share may count, all shares alike: rms of what is missing or too much."""
_FOUND = ". Found, too: "


class Mending:
    """One mesh while it is mended; ``points`` are the corners in m."""

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
        unsure: Iterable[tuple[str, float]] = (),
    ) -> None:
        """Add a defect of these places, with its effects in m², m³ and m².

        ``unsure`` are materials with a standard uncertainty of area in m² each.
        """
        self.defects.append(
            Defect(
                kind,
                len(places) if number is None else number,
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
    """

    path: str
    polygons: Sequence[Array]
    materials: Sequence[str]
    names: Sequence[str]
    notes: tuple[str, ...] = ()


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


def unit_notes(length: float, in_file: float | None, stated: float | None) -> list[str]:
    """Return what is told of the unit in m that was taken, and of one that the file contradicts.

    >>> unit_notes(1.0, 0.0254, 1.0)
    ['the file states a unit of 0.0254 m, and 1 m was stated and taken']
    """
    if stated is not None and in_file is not None and stated != in_file:
        return [f"the file states a unit of {in_file:g} m, and {stated:g} m was stated and taken"]
    return [f"the file's unit is {length:g} m"] if length != 1.0 else []
