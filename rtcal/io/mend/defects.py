"""Defects of a mesh, the error of one that is refused, and the room of one that is mended."""

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
        "partly outside", "outside".
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
                parts.append(f"{symbol} {effect:+.3g} {unit}")
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
        In m³, by rays (`rtcal.io.mend.rays`).
    areas : mapping of str to float
        Area of each material in m², every face once. What is missing is not in it.
    defects : sequence of Defect
    notes : sequence of str
    """

    volume: float
    volume_uncertainty: float
    areas: Mapping[str, float]
    defects: tuple[Defect, ...]
    notes: tuple[str, ...] = ()

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
            "not closed"
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
        head = f"V = {self.geometry.volume:.6g}{u} m³, S = {total:.6g} m², {n} faces"
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


def _listed(areas: Mapping[str, float], defects: Sequence[Defect]) -> list[str]:
    """Return lines of areas and of defects."""
    rows = [f"{area:10.3f} m²  {name}" for name, area in areas.items()]
    found = [f"  {defect}" for defect in defects] or ["  none"]
    return [*rows, "defects:", *found]
