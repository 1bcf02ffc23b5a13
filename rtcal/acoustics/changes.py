"""Changes of a room: what is covered, added, removed or opened; other air, another volume.

Files of variants and of treatments, in TOML, state what may be changed, and its cost; docs/files.md
describes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import msgspec
import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.directions import facing
from rtcal.acoustics.room import (
    AirTable,
    Material,
    MaterialTable,
    Room,
    StatedSigma,
    air,
    by_material,
    material,
    refuse_repeats,
)
from rtcal.acoustics.scene import Scene
from rtcal.acoustics.targets import Target, TargetTable, target_of
from rtcal.files.schema import FileTable, Number, read, toml_table
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


class Change:
    """A change of a room: what goes out of it, and what comes in.

    Another change than an exchange of areas has its own `apply`.
    """

    def goes(self, room: Room) -> tuple[str, float] | None:
        """Return the material that goes out, and its area in m²; None if nothing does."""
        return None

    def comes(self, room: Room) -> Further | None:
        """Return what comes in; None if nothing does."""
        return None

    def apply(self, room: Room) -> Room:
        """Return the changed room; DataError if the room does not allow the change.

        The errors of two areas of one material add up.
        """
        goes, comes = self.goes(room), self.comes(room)
        areas, errors, further = room.areas.copy(), room.area_sigma.copy(), []
        if goes is not None:
            areas[room.material_index(goes[0])] -= goes[1]
        if comes is not None and comes.material.name in room.materials:
            row = room.material_index(comes.material.name)
            sigma = errors[row] * areas[row] + comes.area_sigma * comes.area
            areas[row] += comes.area
            errors[row] = sigma / areas[row]
        elif comes is not None:
            further.append(comes)
        kept = np.flatnonzero(areas > 0).tolist()
        if not kept and not further:
            raise DataError("the room would have no surface")
        sigma = [*errors[kept], *(f.area_sigma for f in further)]
        return with_materials(room, further, kept, areas[kept], area_sigma=sigma)


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
        _check(self, "surface", self.surface, self.area, self.by)

    def goes(self, room: Room) -> tuple[str, float]:
        """Return the surface."""
        return self.surface, _taken(room, self.surface, self.area)

    def comes(self, room: Room) -> Further:
        """Return what covers it."""
        name, area = self.goes(room)
        error = float(room.area_sigma[room.material_index(name)])
        return Further(_material(room, self.by), area, error)

    def __str__(self) -> str:
        return f'cover {_amount(self.area)} of "{self.surface}" by "{_name(self.by)}"'


@dataclass(frozen=True)
class Open(Cover):
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

    by: Material | str = field(default=OPENING, init=False)

    def __str__(self) -> str:
        return f'open {_amount(self.area)} of "{self.surface}"'


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
        _check(self, "material", _name(self.material), self.area, self.material)

    def comes(self, room: Room) -> Further:
        """Return what is added; DataError for more than `MOST_ADDED` times the room's surface."""
        most = MOST_ADDED * room.total_area
        if self.area > most:
            raise DataError(
                f"area = {self.area:g} m² is more than {most:g} m², {MOST_ADDED:g} times the room's "
                "surface"
            )
        new = _material(room, self.material)
        errors = dict(zip(room.materials, room.area_sigma.tolist(), strict=True))
        return Further(new, self.area, errors.get(new.name, 0.0))

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
        _check(self, "material", self.material, self.area)

    def goes(self, room: Room) -> tuple[str, float]:
        """Return what is removed."""
        return self.material, _taken(room, self.material, self.area)

    def __str__(self) -> str:
        return f'remove {_amount(self.area)} of "{self.material}"'


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
        has = f": the room has {room.volume:g} m³"
        checks.between("volume", self.volume, least, most, "m³", has)
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
    return placed(room, (changes,) if isinstance(changes, Change) else tuple(changes)).room


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
    room = before.replace(surfaces=(), scene=Scene(), dimensions=None, calibration=None)
    for change in changes:
        if not isinstance(change, Change):
            raise DataError(f"change = {checks.shown(change)} is not a rtcal Change")
        try:
            goes, comes = change.goes(room), change.comes(room)
            after = change.apply(room)
        except DataError as error:
            raise DataError(f"{change}: {error}") from error
        moved = np.zeros(len(DIRECTIONS))
        moved[FREE] = 0.0 if comes is None else comes.area
        if goes is not None:
            name, area = goes
            moved = faces[name] * (area / room.areas[room.material_index(name)])
            faces[name] = faces[name] - moved
        if comes is not None:
            by = comes.material.name
            faces[by] = faces.get(by, 0.0) + moved
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


def _name(material: Material | str) -> str:
    return material.name if isinstance(material, Material) else material


def _check(change: Change, key: str, name: str, area: float | None, by: object = "") -> None:
    kind = type(change).__name__
    checks.text(f"{kind}: {key}", name)
    if not isinstance(by, Material | str):
        raise DataError(f"{kind}: by = {checks.shown(by)} is no Material and no name of one")
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
        return np.vstack([own[rows], by_material(name, new, room.n_bands)])

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


def _material(room: Room, material: Material | str) -> Material:
    """Return a material of the room by its name, or a new one after a check against the room's."""
    if material == OPENING and OPENING not in room.materials:
        return Material(OPENING, [1.0] * room.n_bands, [0.0] * room.n_bands)
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


Catalogue = Callable[[str, Any], Material]
"""Returns the catalogue's material of a name for centre frequencies in Hz."""
_TAKES = {
    "cover": ("by", "area"),
    "add": ("area",),
    "remove": ("area",),
    "open": ("area",),
    "air": (),
    "volume": (),
}
"""Kinds of change in a file, and the further keys that each may have."""


class NewMaterial(FileTable):
    """A material that is not in the room: alpha and sigma, or a name in the catalogue."""

    name: str
    alpha: list[Number] | None = None
    sigma: StatedSigma | None = None
    catalogue: str | None = None
    source: str = ""


class ChangeTable(FileTable):
    """A change: one of the keys of `_TAKES`, and what belongs to it."""

    cover: str | None = None
    by: str | None = None
    add: str | None = None
    remove: str | None = None
    open: str | None = None
    area: Number | None = None
    air: AirTable | None = None
    volume: Number | None = None


class VariantTable(FileTable):
    """A variant; its name is that of its changes if it states none."""

    change: list[ChangeTable]
    name: str | None = None
    cost: Number | None = None


class VariantsFile(FileTable):
    """A file of variants."""

    variant: list[VariantTable] = []
    material: list[NewMaterial] = []
    target: TargetTable | None = None


class TreatmentTable(FileTable):
    """A treatment, with the fields of `Treatment`."""

    name: str
    material: str
    largest: Number
    cost: Number
    covers: str | None = None
    unit: Number | None = None


class TreatmentsFile(FileTable):
    """A file of treatments."""

    treatment: list[TreatmentTable]
    target: TargetTable
    material: list[NewMaterial] = []
    probability: Number = 0.8


@dataclass(frozen=True)
class Variant:
    """A named list of changes, and what it costs, in any currency.

    Examples
    --------
    >>> from rtcal.prediction import Open
    >>> Variant("window open", (Open("windows", 2.0),)).name
    'window open'
    """

    name: str
    changes: tuple[Change, ...]
    cost: float | None = None

    def __post_init__(self) -> None:
        if self.cost is not None and not 0 <= checks.number("cost", self.cost) < np.inf:
            raise DataError(f"cost = {self.cost:g} is not finite and 0 or more")


def read_variants(
    content: str, room: Room, catalogue: Catalogue | None = None
) -> tuple[Variant, ...]:
    """Return the variants of a TOML text.

    Parameters
    ----------
    content : str
    room : Room
        Its bands are those of the new materials.
    catalogue : callable, optional
        Returns a material for a name and bands, such as `rtcal.datasets.catalogue.material`.

    Raises
    ------
    DataError
        For an unknown key, a value that breaks a rule, a material that is nowhere stated, a name that
        is given twice, or a change that the room does not allow.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> variants = read_variants('''
    ... [[variant]]
    ... name = "window open"
    ... [[variant.change]]
    ... open = "windows"
    ... area = 2
    ... ''', room)
    >>> print(variants[0].changes[0])
    open 2 m² of "windows"
    """
    file = read(VariantsFile, toml_table(content))
    new = new_materials(file.material, room, catalogue)
    variants: list[Variant] = []
    for i, table in enumerate(file.variant, start=1):
        place = f"variant {i}" if table.name is None else f'variant "{table.name}"'
        try:
            made = tuple(_change(change, room, new) for change in table.change)
            changed(room, made)
            name = "; ".join(map(str, made)) if table.name is None else table.name
            variants.append(Variant(name, made, table.cost))
        except DataError as error:
            raise DataError(f"{place}: {error}") from error
    if not variants:
        raise DataError("no [[variant]]; the file has at least one")
    refuse_repeated_names("variants", variants)
    return tuple(variants)


def refuse_repeated_names(place: str, listed: Sequence[Variant | Treatment]) -> None:
    """Raise DataError if two variants or treatments have one name."""
    names = [each.name for each in listed]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DataError(f'{place} has "{twice}" twice; each has a name of its own')


def read_target(content: str, room: Room) -> Target | None:
    """Return the target of a TOML text of variants; None if it states none. Raises as `target_of`."""
    stated = read(VariantsFile, toml_table(content)).target
    return None if stated is None else target_of(stated, room.volume, room.centre_frequencies)


def new_materials(
    tables: Sequence[NewMaterial], room: Room, catalogue: Catalogue | None
) -> dict[str, Material]:
    """Return the materials that a file states, by name; DataError for a name given twice."""
    refuse_repeats(tables)
    return {table.name: _new_material(table, room, catalogue) for table in tables}


def _material_name(key: str, name: str, room: Room, new: Mapping[str, Material]) -> str:
    """Return the material that a file names; DataError if neither room nor file has it."""
    if name not in (*room.materials, *new, OPENING):
        raise DataError(
            f'{key} = "{name}" is no material; the room has {", ".join(room.materials)}; '
            f"the file has {', '.join(new) or 'none'}"
        )
    return name


def _new_material(table: NewMaterial, room: Room, catalogue: Catalogue | None) -> Material:
    place = f'material "{table.name}"'
    if table.catalogue is None:
        stated = {"name": table.name, "alpha": table.alpha, "sigma": table.sigma}
        own = read(MaterialTable, {**stated, "source": table.source}, f"{place}:")
        return material(own, room.centre_frequencies, None)
    if catalogue is None:
        raise DataError(f'{place}: no catalogue to look "{table.catalogue}" up in')
    if both := [key for key in ("alpha", "sigma") if getattr(table, key) is not None]:
        raise DataError(f"{place}: catalogue and {both[0]} are both stated; a material has one")
    try:
        found = catalogue(table.catalogue, room.centre_frequencies)
    except DataError as error:
        raise DataError(f"{place}: {error}") from error
    return Material(table.name, found.alpha, found.sigma, source=found.source)


def _change(table: ChangeTable, room: Room, new: Mapping[str, Material]) -> Change:
    stated = {k: v for k, v in msgspec.structs.asdict(table).items() if v is not None}
    kinds = [kind for kind in _TAKES if kind in stated]
    if len(kinds) != 1:
        raise DataError(f"a change has {len(kinds)} of {', '.join(_TAKES)}; it is one of them")
    (kind,) = kinds
    if extra := [key for key in stated if key not in (kind, *_TAKES[kind])]:
        raise DataError(f"{kind} has {extra[0]}, which has no meaning there")
    if kind == "air":
        return Climate(air(table.air) or Air())
    if kind == "volume":
        return NewVolume(stated["volume"])
    surface = _material_name(kind, stated[kind], room, new)
    if kind == "remove":
        return Remove(surface, table.area)
    if kind == "open":
        return Open(surface, table.area)
    needed = "by" if kind == "cover" else "area"
    if needed not in stated:
        raise DataError(f"{kind} lacks {needed}")
    if kind == "add":
        return Add(new.get(surface, surface), stated["area"])
    by = _material_name("by", stated["by"], room, new)
    return Cover(surface, new.get(by, by), table.area)


MOST_COST = 1e9
"""Largest cost per m²: larger numbers are slips, and leave no digits to the others."""
MOST_PANELS = 500
"""Most whole panels of a treatment: with more, whole ones are no rule that costs anything."""


@dataclass(frozen=True)
class Treatment:
    """A material that may be put into the room.

    Parameters
    ----------
    name : str
    material : Material or str
        A str is a material of the room.
    largest : float
        Largest area in m².
    cost : float
        Per m², in any currency; 0 or more.
    covers : str, optional
        The room's material that it covers; free-standing if not given.
    unit : float, optional
        Area of one panel in m²; any area if not given.

    Raises
    ------
    DataError
        If a number breaks a rule, or a unit is larger than the largest area.

    Examples
    --------
    >>> panel = Material("panel", [0.9], [0.1])
    >>> Treatment("on the ceiling", panel, largest=40, cost=90, covers="ceiling", unit=1.44).unit
    1.44
    """

    name: str
    material: Material | str
    largest: float
    cost: float
    covers: str | None = None
    unit: float | None = None

    def __post_init__(self) -> None:
        place = f'treatment "{self.name}": '
        checks.positive(f"{place}largest", self.largest, "m²")
        checks.between(f"{place}cost", self.cost, 0, MOST_COST, why=" per m²")
        if self.unit is None:
            return
        if checks.positive(f"{place}unit", self.unit, "m²") > self.largest:
            raise DataError(
                f"{place}unit = {self.unit:g} m² is more than largest = {self.largest:g} m²"
            )
        if self.largest > MOST_PANELS * self.unit:
            raise DataError(
                f"{place}unit = {self.unit:g} m² allows more than {MOST_PANELS} panels in largest = "
                f"{self.largest:g} m²; left out, any area may be had"
            )

    def change(self, area: float) -> Change:
        """Return the change that puts so many m² of it into the room."""
        if self.covers is None:
            return Add(self.material, area)
        return Cover(self.covers, self.material, area)

    @property
    def material_name(self) -> str:
        """The name of its material."""
        return self.material if isinstance(self.material, str) else self.material.name


def read_treatments(
    content: str, room: Room, catalogue: Catalogue | None = None
) -> tuple[tuple[Treatment, ...], Target, float]:
    """Return the treatments, the target and the probability of a TOML text.

    Parameters are those of `rtcal.prediction.read_variants`, and so are the errors.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> treatments, target, probability = read_treatments('''
    ... [target]
    ... standard = "ANSI S12.60"
    ... [[treatment]]
    ... name = "more floor"
    ... material = "floor"
    ... covers = "plaster"
    ... largest = 10
    ... cost = 20
    ... ''', room)
    >>> treatments[0].covers, target.high[2], probability
    ('plaster', np.float64(0.6), 0.8)
    """
    file = read(TreatmentsFile, toml_table(content))
    new = new_materials(file.material, room, catalogue)
    treatments = []
    for table in file.treatment:
        place = f'treatment "{table.name}": '
        named = _material_name(f"{place}material", table.material, room, new)
        if table.covers is not None:
            _material_name(f"{place}covers", table.covers, room, {})
        stated = msgspec.structs.asdict(table)
        treatments.append(Treatment(**{**stated, "material": new.get(named, named)}))
    target = target_of(file.target, room.volume, room.centre_frequencies)
    return tuple(treatments), target, file.probability


def check_treatments(treatments: Sequence[Treatment], room: Room) -> tuple[Treatment, ...]:
    """Return the treatments; DataError for none, two of one name, or one that does not fit the room."""
    listed = tuple(treatments)
    for treatment in listed:
        if not isinstance(treatment, Treatment):
            raise DataError(f"treatment = {checks.shown(treatment)} is not a rtcal Treatment")
    if not listed:
        raise DataError("treatments is empty; there is at least one")
    refuse_repeated_names("treatments", listed)
    for treatment in listed:
        if treatment.covers is not None:
            has = float(room.areas[room.material_index(treatment.covers)])
            if treatment.largest > has * (1 + 1e-9):
                raise DataError(
                    f'treatment "{treatment.name}": largest = {treatment.largest:g} m² is more than '
                    f'the {has:g} m² of "{treatment.covers}"'
                )
        elif treatment.largest > (most := MOST_ADDED * room.total_area):
            raise DataError(
                f'treatment "{treatment.name}": largest = {treatment.largest:g} m² is more than '
                f"{most:g} m², {MOST_ADDED:g} times the room's surface"
            )
    return listed
