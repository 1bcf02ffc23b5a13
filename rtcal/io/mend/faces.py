"""The faces of a mesh: as they are drawn, and as they are worked on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from rtcal.support.types import Array

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
        index = [i for i, keep in enumerate(which) if keep]
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
