"""Materials and surfaces of a room, and checks of their input."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from rtcal.acoustics import bands
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Material:
    """A material and its prior.

    Parameters
    ----------
    name : str
    alpha : sequence (n_bands,)
        Random-incidence absorption coefficients, 0 to 1.
    sigma : sequence (n_bands,)
        Standard deviation of each coefficient, 0 or more; 0 for a coefficient that is exact.
    alpha_min : float or sequence (n_bands,)
        Lower bound of the calibrated coefficient.
    scattering : sequence (n_bands,), optional
        Random-incidence scattering coefficients, 0 to 1; only simulators use them.
    source : str
        Where the coefficients come from.
    """

    name: str
    alpha: Sequence[float]
    sigma: Sequence[float]
    alpha_min: float | Sequence[float] = 0.0
    scattering: Sequence[float] | None = None
    source: str = ""


@dataclass(frozen=True)
class Surface:
    """One surface of a room: its material, its area in m² and the axis it stands across.

    ``axis`` is ``"x"``, ``"y"`` or ``"z"``: the direction of its normal. Only equations that treat
    the axes apart (Fitzroy, Arau-Puchades) need it.
    """

    name: str
    material: str
    area: float
    axis: str | None = None

    def __post_init__(self) -> None:
        text_name("surface name", self.name)
        text_name("surface material", self.material)
        area = checks.positive(f'surface["{self.name}"].area', self.area, "m²")
        object.__setattr__(self, "area", area)
        if self.axis is not None and (not isinstance(self.axis, str) or self.axis not in AXES):
            raise DataError(f'surface["{self.name}"].axis = "{self.axis}" is not "x", "y" or "z"')


class Geometry(Protocol):
    """The part of a geometry that a room takes: its volume in m³ and its surfaces."""

    @property
    def volume(self) -> float:
        """Volume in m³."""
        ...

    @property
    def surfaces(self) -> Sequence[Surface]:
        """The faces, with material, area and axis."""
        ...


ARCHIVE = "archive"
"""Method in the record of a room whose coefficients come from an archive of other rooms."""
CHANGED = "changed"
"""Method in the record of a room whose coefficients were changed after their calibration."""


@dataclass(frozen=True)
class CalibrationRecord:
    """The calibration of a calibrated room, or the archive that its coefficients come from.

    ``measured`` identifies, per band, every T that the coefficients were calibrated to. A second
    calibration to the same T would count it twice and is refused.
    """

    method: str
    equation: str
    measured: str
    solver: str = ""
    version: str = ""


LONGEST_NAME = 200
"""Largest length of an author, and of what stands at the head of a page, in characters."""
_BIDIRECTIONAL = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows: a name could be read as another."""


def text_name(place: str, value: object) -> str:
    """Return a name; DataError unless it is text without characters that control how it is shown."""
    if not isinstance(value, str):
        raise DataError(f"{place} has {value!r}, which is not a text")
    if any(
        unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in _BIDIRECTIONAL for c in value
    ):
        raise DataError(f"{place} has {value!r}; a name has no control characters")
    return value


def short_name(place: str, value: object) -> str:
    """Return a name of at most `LONGEST_NAME` characters, as stands at the head of a page."""
    name = text_name(place, value)
    if len(name) > LONGEST_NAME:
        raise DataError(f"{place} has {len(name)} characters; at most {LONGEST_NAME} are allowed")
    return name


def array_of(name: str, value: object) -> Array:
    """Return an array of numbers, or raise DataError naming it."""
    return checks.array(name, value).copy()


def rows_of(name: str, rows: list[tuple[str, Sequence[float]]], n_bands: int) -> Array:
    """Return one row per material, (n_materials, n_bands), or raise DataError naming the material."""
    for material, row in rows:
        if np.ndim(row) != 1:
            raise DataError(f'{name}["{material}"] is not a list of one number per band')
        if len(row) != n_bands:
            raise DataError(
                f'{name}["{material}"] has {len(row)} values; the room has {n_bands} bands'
            )
    return array_of(name, [list(row) for _, row in rows])


def stacked(
    surfaces: Sequence[Surface], materials: Sequence[Material], centre_frequencies: Array
) -> dict[str, Any]:
    """Return the arguments of `Room` that surfaces and materials determine.

    A material's area is the sum over its surfaces; a material without a surface is left out.
    Raises DataError for a surface whose material is not among ``materials``.
    """
    for kind, members in ((Surface, surfaces), (Material, materials)):
        for i, member in enumerate(members):
            checks.instance(f"{kind.__name__.lower()}s[{i}]", member, kind)
    by_name = {m.name: m for m in materials}
    if len(by_name) < len(materials):
        twice = next(m.name for m in materials if by_name[m.name] is not m)
        raise DataError(f'material "{twice}" is given twice')
    for surface in surfaces:
        if surface.material not in by_name:
            raise DataError(
                f'surface["{surface.name}"].material = "{surface.material}" is not among the '
                f"materials: {', '.join(by_name)}"
            )
    covered = {s.material for s in surfaces}
    used = [m for m in by_name.values() if m.name in covered]
    n_bands = len(centre_frequencies)
    scattered = [(m.name, m.scattering) for m in used if m.scattering is not None]
    if scattered and len(scattered) < len(used):
        lacking = next(m.name for m in used if m.scattering is None)
        raise DataError(
            f'scattering["{lacking}"] is missing; state it for every material or for none'
        )
    floors = []
    for m in used:
        floor = array_of("alpha_min", m.alpha_min)
        if floor.shape not in ((), (n_bands,)):
            raise DataError(
                f'alpha_min["{m.name}"] has shape {floor.shape}; it is one number, or {n_bands}'
            )
        floors.append(np.broadcast_to(floor, (n_bands,)))
    return {
        "materials": [m.name for m in used],
        "areas": array_of(
            "areas", [np.sum([s.area for s in surfaces if s.material == m.name]) for m in used]
        ),
        "alpha": rows_of("alpha", [(m.name, m.alpha) for m in used], n_bands),
        "sigma": rows_of("sigma", [(m.name, m.sigma) for m in used], n_bands),
        "alpha_min": np.array(floors) if any(f.any() for f in floors) else None,
        "scattering": rows_of("scattering", scattered, n_bands) if scattered else None,
        "surfaces": tuple(surfaces),
        "sources": {m.name: m.source for m in used if m.source},
    }


def in_order(place: str, value: Any, materials: Sequence[str], frequencies: Array) -> Any:
    """Return the values of a mapping, DataFrame or Series in the room's order; others as they are.

    A mapping has the materials as keys. Rows are ordered by their labels if these are texts, which have
    to be the materials. Columns are ordered by theirs unless they are 0, 1, 2, ...: they have to be the
    bands, in Hz.

    Raises
    ------
    DataError
        If labels are not the room's materials or bands.
    """
    if isinstance(value, Mapping):
        _places(f"{place}: keys", list(value), list(materials))
        return [value[name] for name in materials]
    index = getattr(value, "index", None)
    if index is None or callable(index) or not hasattr(value, "to_numpy"):
        return value
    array = value.to_numpy()
    if array.shape[:1] == (len(materials),) and any(isinstance(name, str) for name in index):
        array = array[_places(f"{place}: rows", list(index), list(materials))]
    columns = list(getattr(value, "columns", ()))
    if columns != list(range(len(columns))) and len(columns) == len(frequencies):
        place = f"{place}: columns"
        array = array[:, _places(place, [_band(c) for c in columns], frequencies.tolist())]
    return array


def _band(label: object) -> object:
    """Return a column's label as a nominal frequency, or as it is if it is none."""
    try:
        return bands.nominal(float(str(label).removesuffix("Hz")))
    except ValueError:
        return label


def _places(place: str, labels: list[Any], wanted: list[Any]) -> list[int]:
    """Return where each of the wanted labels stands; DataError unless the labels are these."""
    if len(set(labels)) < len(labels) or set(labels) != set(wanted):
        others = shortened(", ".join(str(label) for label in labels), 60)
        needed = shortened(", ".join(f"{label}" for label in wanted), 60)
        raise DataError(f"{place} are {others}; the room has {needed}")
    return [int(np.flatnonzero([label == name for label in labels])[0]) for name in wanted]


LEAST, LARGEST = 1e-9, 1e9
"""Of volumes in m³, the largest of areas in m², too. Nothing that is built comes near either."""
LARGEST_LABORATORY_ALPHA = 2.0
"""ISO 354 gives up to some 1.3 for thick absorbers of 10 m² (edge effect); small objects give more."""


def above_one_hint(alpha: float) -> str:
    """Return what can be done about a coefficient above 1 that a laboratory may report; else "".

    Examples
    --------
    >>> above_one_hint(0.7), above_one_hint(-1.0)
    ('', '')
    """
    if not 1 < alpha <= LARGEST_LABORATORY_ALPHA:
        return ""
    return (
        ". Laboratories report such values (ISO 354, edge effect): a room that states above_one = "
        '"clip" takes them as 1 and says so, as `rtcal import library` does with product data'
    )
