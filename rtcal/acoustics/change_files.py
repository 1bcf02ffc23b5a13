"""Files of variants and of treatments: what may be changed in a room, and its cost, in TOML.

A file of variants::

    [[material]]                        # new materials, as in a room's file
    name = "panel"
    alpha = [0.2, 0.6, 0.9, 0.9, 0.9, 0.9]
    sigma = 0.1

    [[material]]
    name = "carpet"
    catalogue = "carpet_cotton"         # or by its name in the catalogue

    [target]                            # optional, as in a file of treatments: the probability of it
    low = 0.4
    high = 0.7

    [[variant]]
    name = "panels on the ceiling"
    cost = 1800                         # optional
    [[variant.change]]
    cover = "ceiling"                   # a material of the room
    by = "panel"                        # a new material, or one of the room
    area = 20                           # m²; left out: all of it

    [[variant.change]]                  # further changes follow in order
    add = "baffle"                      # free-standing: more surface
    area = 6
    # remove = "seats"                  # area: left out, all of it
    # open = "windows"
    # air = {temperature = 26, humidity = 60}
    # volume = 180                      # m³

A file of treatments::

    probability = 0.8                   # optional, 0.8 or more

    [target]
    standard = "DIN 18041"              # or "ANSI S12.60", which has no group
    group = "A3"                        # or in place of both: low and high in s, each one number or
                                        # one per band

    [[material]]                        # as in a file of variants
    name = "panel"
    alpha = [0.2, 0.6, 0.9, 0.9, 0.9, 0.9]
    sigma = 0.1

    [[treatment]]
    name = "panels on the ceiling"
    material = "panel"                  # a new material, or one of the room
    covers = "ceiling"                  # left out: free-standing
    largest = 40                        # m²
    cost = 90                           # per m²
    unit = 1.44                         # m²; optional: only whole panels
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.changes import (
    MOST_ADDED,
    OPENING,
    Add,
    Change,
    Climate,
    Cover,
    NewVolume,
    Open,
    Remove,
    changed,
)
from rtcal.acoustics.room import (
    AirTable,
    Material,
    MaterialTable,
    Room,
    StatedSigma,
    air,
    material,
    refuse_repeats,
)
from rtcal.acoustics.targets import Target, TargetTable, target_of
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.schema import FileTable, Number, read, toml_table

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
    refuse_repeated_names(variants)
    return tuple(variants)


def refuse_repeated_names(variants: Sequence[Variant]) -> None:
    """Raise DataError if two variants have one name."""
    names = [variant.name for variant in variants]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DataError(f'variants has "{twice}" twice; each has a name of its own')


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


LEAST = 0.8
"""Least probability that a design takes: below it the areas that keep it may be no convex set."""

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
        if not 0 <= checks.number(f"{place}cost", self.cost) <= MOST_COST:
            raise DataError(f"{place}cost = {self.cost:g} is not from 0 to {MOST_COST:g} per m²")
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
    """Return the treatments, each once.

    Raises DataError if there are none, two of a name that differ, or one that does not fit the room.
    """
    listed: tuple[Treatment, ...] = ()
    for treatment in treatments:
        if not isinstance(treatment, Treatment):
            raise DataError(f"treatment = {checks.shown(treatment)} is not a rtcal Treatment")
        same = next((t for t in listed if t.name == treatment.name), None)
        if same is not None and _stated(same) != _stated(treatment):
            raise DataError(f'treatments has two that are named "{same.name}", and they differ')
        listed = listed if same is not None else (*listed, treatment)
    if not listed:
        raise DataError("treatments is empty; there is at least one")
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


def _stated(treatment: Treatment) -> tuple[Any, ...]:
    """Return what a treatment states, in a form that compares."""
    material: Any = treatment.material
    if isinstance(material, Material):
        numbers = (material.alpha, material.sigma, material.alpha_min)
        material = (material.name, *(np.asarray(n, dtype=float).tolist() for n in numbers))
    return material, treatment.largest, treatment.cost, treatment.covers, treatment.unit
