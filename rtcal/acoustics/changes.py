"""Changes of a room: what is covered, added, removed or opened; other air, another volume."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.directions import facing
from rtcal.acoustics.room import Material, Room
from rtcal.acoustics.scene import Scene
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import without_looks
from rtcal.support.types import Array

OPENING = "opening"
"""Name of the material of what is opened: alpha = 1, exactly."""
MOST_ADDED = 10.0
"""Largest area that is added, in shares of the room's surface: more is a slip of the decimal point."""
MOST_VOLUME = 100.0
"""Largest ratio of the volumes before and after: more is a slip of the unit."""
_SAME_AREA = 1e-6
"""Relative difference below which what comes in has the area of what goes out."""
_ROUNDING = 1e-9
"""Relative difference below which an area is the whole area."""


class Change(ABC):
    """A change of a room; it makes the room that it leads to."""

    @abstractmethod
    def apply(self, room: Room) -> Room:
        """Return the changed room; DataError if the room does not allow the change."""


@dataclass(frozen=True)
class Cover(Change):
    """A surface is covered: what lies below it no longer absorbs. The total surface stays.

    The relative error of the covering area is that of the surface's area.

    Parameters
    ----------
    surface : str
        A material of the room.
    by : Material or str
        What covers it; a str is a material of the room.
    area : float, optional
        m²; the whole surface, which is then replaced, if not given.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["wall", "floor"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> Cover("wall", "floor", 10).apply(room).areas.tolist()
    [64.0, 30.0]
    """

    surface: str
    by: Material | str
    area: float | None = None

    def __post_init__(self) -> None:
        checks.text("Cover: surface", self.surface)
        _check_material("Cover: by", self.by)
        _check_area("Cover", self.area)

    def apply(self, room: Room) -> Room:
        """Return the room with the surface covered."""
        area = _taken(room, self.surface, self.area)
        left = _with_less(room, self.surface, area)
        return _added(left, room, self.by, area, _area_sigma(room, self.surface))

    def __str__(self) -> str:
        return f'cover {_amount(self.area)} of "{self.surface}" by "{_name(self.by)}"'


@dataclass(frozen=True)
class Add(Change):
    """Something free-standing is added: the total surface grows, and nothing is covered.

    Parameters
    ----------
    material : Material or str
        A str is a material of the room.
    area : float
        m² of surface that the sound reaches: both sides of a baffle; at most 10 times the room's
        surface. Its relative error is that of the room's material, and 0 of a new one.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1]],
    ...             sigma=[[0.02]], centre_frequencies=[1000])
    >>> Add(Material("baffle", [0.9], [0.1]), 12).apply(room).total_area
    106.0
    """

    material: Material | str
    area: float

    def __post_init__(self) -> None:
        _check_material("Add: material", self.material)
        checks.positive("Add: area", self.area, "m²")

    def apply(self, room: Room) -> Room:
        """Return the room with what is added."""
        most = MOST_ADDED * room.total_area
        if self.area > most:
            raise DataError(
                f"area = {self.area:g} m² is more than {most:g} m², {MOST_ADDED:g} times the room's "
                "surface"
            )
        name = _name(self.material)
        error = _area_sigma(room, name) if name in room.materials else 0.0
        return _added(room, room, self.material, self.area, error)

    def __str__(self) -> str:
        return f'add {_amount(self.area)} of "{_name(self.material)}"'


@dataclass(frozen=True)
class Remove(Change):
    """Something free-standing is removed: the total surface shrinks.

    Parameters
    ----------
    material : str
        A material of the room.
    area : float, optional
        m²; all of it if not given.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["wall", "seats"], areas=[94, 8],
    ...             alpha=[[0.1], [0.5]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> Remove("seats").apply(room).materials
    ('wall',)
    """

    material: str
    area: float | None = None

    def __post_init__(self) -> None:
        checks.text("Remove: material", self.material)
        _check_area("Remove", self.area)

    def apply(self, room: Room) -> Room:
        """Return the room without it."""
        left = _with_less(room, self.material, _taken(room, self.material, self.area))
        if left is None:
            raise DataError("the room would have no surface")
        return left

    def __str__(self) -> str:
        return f'remove {_amount(self.area)} of "{self.material}"'


@dataclass(frozen=True)
class Open(Change):
    """A part of a surface is opened: alpha = 1 there, exactly.

    Parameters
    ----------
    surface : str
        A material of the room.
    area : float, optional
        m²; all of it if not given.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1]],
    ...             sigma=[[0.02]], centre_frequencies=[1000])
    >>> print(Open("wall", 4).apply(room).absorption_area)
    [13.]
    """

    surface: str
    area: float | None = None

    def __post_init__(self) -> None:
        checks.text("Open: surface", self.surface)
        _check_area("Open", self.area)

    def apply(self, room: Room) -> Room:
        """Return the room with the opening."""
        return self.cover(room).apply(room)

    def cover(self, room: Room) -> Cover:
        """Return the opening as what covers the surface, in the room's bands."""
        opening = Material(OPENING, [1.0] * room.n_bands, [0.0] * room.n_bands)
        return Cover(self.surface, opening, self.area)

    def __str__(self) -> str:
        return f'open {_amount(self.area)} of "{self.surface}"'


@dataclass(frozen=True)
class Climate(Change):
    """Another climate: temperature, humidity and pressure of the air.

    Examples
    --------
    >>> str(Climate(Air(26, 60)))
    'air of 26 °C and 60 %'
    """

    air: Air

    def __post_init__(self) -> None:
        checks.instance("Climate: air", self.air, Air)

    def apply(self, room: Room) -> Room:
        """Return the room in this air."""
        return room.with_air(self.air)

    def __str__(self) -> str:
        return f"air of {self.air.temperature:g} °C and {self.air.humidity:g} %"


@dataclass(frozen=True)
class NewVolume(Change):
    """Another volume in m³. The surfaces stay: `Add` and `Remove` change them.

    Examples
    --------
    >>> str(NewVolume(180))
    'volume of 180 m³'
    """

    volume: float

    def __post_init__(self) -> None:
        checks.positive("NewVolume: volume", self.volume, "m³")

    def apply(self, room: Room) -> Room:
        """Return the room with this volume; DataError for one a hundred times as small or large."""
        least, most = room.volume / MOST_VOLUME, room.volume * MOST_VOLUME
        if not least <= self.volume <= most:
            raise DataError(
                f"volume = {self.volume:g} m³ is not from {least:g} to {most:g} m³: the room has "
                f"{room.volume:g} m³"
            )
        return room.replace(volume=self.volume)

    def __str__(self) -> str:
        return f"volume of {self.volume:g} m³"


def changed(room: Room, changes: Change | Sequence[Change]) -> Room:
    """Return the room after one or several changes, in their order.

    The room has neither single surfaces nor a scene: these do not say what was covered where.

    Raises
    ------
    DataError
        If the room lacks a surface or as much of it, or a new material has other coefficients than
        the room's of this name.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> panel = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> after = changed(room, [Cover("ceiling", panel, 20), Open("windows", 2)])
    >>> after.materials[-2:], round(after.total_area - room.total_area, 6)
    (('panel', 'opening'), 0.0)
    """
    listed = (changes,) if isinstance(changes, Change) else tuple(changes)
    after = _bare(room)
    for change in listed:
        after = _applied(change, after)
    return after


DIRECTIONS = ("x", "y", "z", "free", "unknown")
FREE, UNKNOWN = 3, 4
"""What stands free faces every way; of the rest it is not known which way."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A room, and which way its materials face: areas in m², (n_materials, 5), by `DIRECTIONS`."""

    room: Room
    areas: Array


def placed(before: Room, changes: Sequence[Change] | Room, like: Placed | None = None) -> Placed:
    """Return the room after changes, and which way its materials then face.

    What covers a surface faces as the surface does; where a part of a material is covered that faces
    several ways, each way as much of it.

    Parameters
    ----------
    before : Room
        `rtcal.acoustics.directions.facing` says which way its materials face.
    changes : sequence of Change, or Room
        A Room is the changed room itself.
    like : Placed, optional
        Another state, where the room itself does not say: its materials face as they do there. What
        comes in faces as what it takes the place of, and stands free where nothing went out.

    Raises
    ------
    DataError
        As `changed`.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["wall", "ceiling"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> placed(room, [Cover("ceiling", "wall", 5)]).areas.tolist()
    [[37.0, 37.0, 5.0, 0.0, 0.0], [0.0, 0.0, 15.0, 0.0, 0.0]]
    """
    shares = facing(before)
    towards = np.zeros((before.n_materials, len(DIRECTIONS)))
    known = ~np.isnan(shares).any(axis=1)
    towards[known, :3] = shares[known]
    towards[~known, UNKNOWN] = 1.0
    if like is not None:
        if not before.surfaces and before.dimensions is None:
            # Names alone say less than the other state does.
            known &= np.array([m not in like.room.materials for m in before.materials])
        _like(towards, before, np.flatnonzero(~known).tolist(), like)
    start = Placed(before, towards * before.areas[:, np.newaxis])
    if isinstance(changes, Room):
        return placed(changes, (), start)
    faces = dict(zip(before.materials, start.areas, strict=True))
    room = _bare(before)
    for change in changes:
        after = _applied(change, room)
        single = change.cover(room) if isinstance(change, Open) else change
        if isinstance(single, Cover):
            row = room.material_index(single.surface)
            moved = faces[single.surface] * (
                _taken(room, single.surface, single.area) / room.areas[row]
            )
            faces[single.surface] = faces[single.surface] - moved
            by = _name(single.by)
            faces[by] = faces.get(by, 0.0) + moved
        elif isinstance(single, Add):
            by = _name(single.material)
            free = np.zeros(len(DIRECTIONS))
            free[FREE] = single.area
            faces[by] = faces.get(by, 0.0) + free
        elif isinstance(single, Remove):
            row = room.material_index(single.material)
            left = 1 - _taken(room, single.material, single.area) / room.areas[row]
            faces[single.material] = faces[single.material] * left
        room = after
    rows = np.array([faces[name] for name in room.materials])
    # The room's own areas, to the last digit.
    return Placed(room, rows * (room.areas / rows.sum(axis=1))[:, np.newaxis])


def _like(towards: Array, room: Room, unknown: Sequence[int], other: Placed) -> None:
    """Fill in which way materials face, (n_materials, 5), from another state of the room."""
    shares = dict(zip(other.room.materials, other.areas, strict=True))
    has = dict(zip(room.materials, room.areas.tolist(), strict=True))
    lost = {
        name: own * (1 - has.get(name, 0.0) / own.sum())
        for name, own in shares.items()
        if own.sum() > has.get(name, 0.0) * (1 + _ROUNDING)
    }
    new = []
    for row in unknown:
        name = room.materials[row]
        same = [m for m, gone in lost.items() if abs(gone.sum() / has[name] - 1) < _SAME_AREA]
        if name in shares:
            if not shares[name][UNKNOWN] or towards[row, UNKNOWN]:
                towards[row] = shares[name] / shares[name].sum()
        elif len(same) == 1:
            gone = lost.pop(same[0])
            towards[row] = gone / gone.sum()
        else:
            new.append(row)
    gone = sum(lost.values(), np.zeros(len(DIRECTIONS)))
    area = sum(has[room.materials[row]] for row in new)
    for row in new:
        covering = min(gone.sum() / area, 1.0)
        towards[row] = covering * gone / max(gone.sum(), 1e-300)
        towards[row, FREE] += 1 - covering


def _bare(room: Room) -> Room:
    return room.replace(surfaces=(), scene=Scene(), dimensions=None, calibration=None)


def _applied(change: Change, room: Room) -> Room:
    if not isinstance(change, Change):
        raise DataError(f"change = {checks.shown(change)} is not a rtcal Change")
    try:
        return change.apply(room)
    except DataError as error:
        raise DataError(f"{change}: {error}") from error


def _name(material: Material | str) -> str:
    return material if isinstance(material, str) else material.name


def _check_material(place: str, value: object) -> None:
    if not isinstance(value, Material | str):
        raise DataError(f"{place} = {checks.shown(value)} is no Material and no name of one")


def _check_area(kind: str, area: object) -> None:
    if area is not None:
        checks.positive(f"{kind}: area", area, "m²")


def _amount(area: float | None) -> str:
    return "all" if area is None else f"{area:g} m²"


def _taken(room: Room, surface: str, area: float | None) -> float:
    """Return the area in m² that is taken of a surface; DataError if it has less."""
    has = float(room.areas[room.material_index(surface)])
    if area is None:
        return has
    if area > has * (1 + _ROUNDING):
        raise DataError(f'area = {area:g} m² is more than the {has:g} m² of "{surface}"')
    return has if area > has * (1 - _ROUNDING) else area


def _with_less(room: Room, surface: str, area: float) -> Room | None:
    """Return the room with less of a surface; None if nothing is left."""
    row = room.material_index(surface)
    areas = np.array(room.areas)
    areas[row] -= area
    if areas[row] > 0:
        return room.replace(areas=areas)
    kept = [i for i in range(room.n_materials) if i != row]
    return with_materials(room, (), kept) if kept else None


def _area_sigma(room: Room, material: str) -> float:
    return float(room.area_sigma[room.material_index(material)])


def _added(
    left: Room | None, before: Room, material: Material | str, area: float, area_sigma: float
) -> Room:
    """Return what is left of a room with more of a material, whose area has a relative error.

    ``before`` has the str's coefficients. The errors of two areas of one material add up.
    """
    new = _material(before, material)
    further = [Further(new, area, area_sigma)]
    if left is None:
        return with_materials(before, further, ())
    if new.name in left.materials:
        row, areas, errors = (
            left.materials.index(new.name),
            left.areas.copy(),
            left.area_sigma.copy(),
        )
        errors[row] = (errors[row] * areas[row] + area_sigma * area) / (areas[row] + area)
        areas[row] += area
        return left.replace(areas=areas, area_sigma=errors)
    return with_materials(left, further)


@dataclass(frozen=True)
class Further:
    """A further material of a room: its area in m², and that area's relative standard deviation."""

    material: Material
    area: float
    area_sigma: float = 0.0


def with_materials(
    room: Room,
    further: Sequence[Further],
    kept: Sequence[int] | None = None,
    areas: Array | Sequence[float] | None = None,
    **changes: Any,
) -> Room:
    """Return a room with some of its materials, and further ones after them.

    Every array by material has their rows. Without scattering of all materials the room has none.

    Parameters
    ----------
    room : Room
    further : sequence of Further
    kept : sequence of int, optional
        Rows of the materials that stay; all if not given.
    areas : array (n_kept,), optional
        Their areas in m²; those of the room if not given.
    **changes
        Other fields of the room, as for `Room.replace`.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1]],
    ...             sigma=[[0.02]], centre_frequencies=[1000])
    >>> panel = Further(Material("panel", [0.9], [0.1]), 10)
    >>> print(with_materials(room, [panel], areas=[84]).absorption_area)
    [17.4]
    """
    rows = list(range(room.n_materials) if kept is None else kept)
    names, new = [room.materials[i] for i in rows], [f.material for f in further]

    def joined(name: str, own: Array) -> Array:
        return np.vstack([own[rows], *(_row(room, m.name, name, getattr(m, name)) for m in new)])

    bounded = room.alpha_min is not None or any(np.any(np.asarray(m.alpha_min) > 0) for m in new)
    scatter = None if any(m.scattering is None for m in new) else room.scattering
    stated = {
        "materials": [*names, *(m.name for m in new)],
        "areas": [*(room.areas[rows] if areas is None else areas), *(f.area for f in further)],
        "area_sigma": [*room.area_sigma[rows], *(f.area_sigma for f in further)],
        "alpha": joined("alpha", room.alpha),
        "sigma": joined("sigma", room.sigma),
        "alpha_min": joined("alpha_min", least_alpha(room)) if bounded else None,
        "scattering": None if scatter is None else joined("scattering", scatter),
        "material_correlation": {
            pair: r for pair, r in room.material_correlation.items() if {*pair} <= {*names}
        },
        "sources": {
            **{m: source for m, source in room.sources.items() if m in names},
            **{m.name: m.source for m in new if m.source},
        },
    }
    return room.replace(**(stated | changes))


def least_alpha(room: Room) -> Array:
    """Return the lower bounds of alpha, (n_materials, n_bands)."""
    return np.zeros_like(room.alpha) if room.alpha_min is None else room.alpha_min


def new_name(taken: Iterable[str], wanted: str) -> str:
    """Return a name that looks like none that is taken: the wanted one, or that with a number.

    Examples
    --------
    >>> new_name(["wall"], "panel"), new_name(["panel", "panel (2)"], "panel")
    ('panel', 'panel (3)')
    """
    numbered = (wanted if n == 1 else f"{wanted} ({n})" for n in count(1))
    seen = {without_looks(name) for name in taken}
    return next(name for name in numbered if without_looks(name) not in seen)


def _row(room: Room, material: str, name: str, values: float | Sequence[float]) -> Array:
    """Return a new material's values, (n_bands,)."""
    if name == "alpha_min":
        return np.broadcast_to(values, room.n_bands)
    if np.shape(values) != (room.n_bands,):
        raise DataError(
            f'{name}["{material}"] has shape {np.shape(values)}; the room has {room.n_bands} bands'
        )
    return np.asarray(values)


def _material(room: Room, material: Material | str) -> Material:
    """Return a material of the room by its name, or a new one after a check against the room's."""
    if isinstance(material, str):
        row = room.material_index(material)
        return Material(
            material,
            room.alpha[row].tolist(),
            room.sigma[row].tolist(),
            0.0 if room.alpha_min is None else room.alpha_min[row].tolist(),
            None if room.scattering is None else room.scattering[row].tolist(),
            room.sources.get(material, ""),
        )
    if material.name in room.materials:
        row = room.materials.index(material.name)
        for name in ("alpha", "sigma"):
            if not np.array_equal(getattr(room, name)[row], getattr(material, name)):
                raise DataError(
                    f'{name} of "{material.name}" is not that of the room\'s material of this name'
                )
    return material
