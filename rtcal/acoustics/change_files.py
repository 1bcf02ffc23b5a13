"""A file of variants: what may be changed in a room, in TOML.

::

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
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.acoustics import room_files
from rtcal.acoustics.changes import (
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
from rtcal.acoustics.materials import Material
from rtcal.acoustics.room import Room
from rtcal.acoustics.targets import Target, target_of
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries, toml_table
from rtcal.support.errors import DataError

Catalogue = Callable[[str, Any], Material]
"""Returns the catalogue's material of a name for centre frequencies in Hz."""
_KINDS = ("cover", "add", "remove", "open", "air", "volume")
_MATERIAL = ("alpha", "sigma", "catalogue", "source")


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


@checked
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
    file = Entries("", toml_table(content), ("variant",), ("material", "target"))
    new = new_materials(file, room, catalogue)
    variants: list[Variant] = []
    for place, table in tables(file, "variant"):
        entry = Entries(f"{place}: ", table, ("change",), ("name", "cost"))
        made = tuple(
            _change(f"{place}, {where}", each, room, new) for where, each in tables(entry, "change")
        )
        try:
            changed(room, made)
        except DataError as error:
            raise DataError(f"{place}, {error}") from error
        name = entry.text("name", "; ".join(map(str, made)))
        cost = entry.number("cost") if "cost" in entry else None
        try:
            variants.append(Variant(name, made, cost))
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
    file = Entries("", toml_table(content), (), ("variant", "material", "target"))
    if "target" not in file:
        return None
    return stated_target(file, room)


def stated_target(file: Entries, room: Room) -> Target:
    """Return the target that a file states in its table."""
    return target_of(
        file.entries("target", (), ("standard", "group", "low", "high")),
        room.volume,
        room.centre_frequencies,
    )


def tables(file: Entries, key: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Return each ``[[key]]`` with its place in messages."""
    return [(f"[[{key}]] {i + 1}", table) for i, table in enumerate(file.listed(key, []))]


def new_materials(file: Entries, room: Room, catalogue: Catalogue | None) -> dict[str, Material]:
    """Return the materials that a file states, by name; DataError for a name given twice."""
    new: dict[str, Material] = {}
    for place, table in tables(file, "material"):
        material = new_material(place, table, room, catalogue)
        if material.name in new:
            raise DataError(f'material "{material.name}" is given twice')
        new[material.name] = material
    return new


def material_name(entry: Entries, key: str, room: Room, new: Mapping[str, Material]) -> str:
    """Return the material that a file names; DataError if neither room nor file has it."""
    name = entry.text(key)
    if name not in (*room.materials, *new, OPENING):
        raise DataError(
            f'{entry.place}{key} = "{name}" is no material; the room has {", ".join(room.materials)}; '
            f"the file has {', '.join(new) or 'none'}"
        )
    return name


def new_material(
    place: str, table: Any, room: Room, catalogue: Catalogue | None, more: tuple[str, ...] = ()
) -> Material:
    """Return a material of a file; ``more`` are further keys of its table."""
    entry = Entries(f"{place}: ", table, ("name",), (*_MATERIAL, *more))
    name = entry.text("name")
    if "catalogue" in entry:
        if catalogue is None:
            raise DataError(f'{place}: no catalogue to look "{entry.text("catalogue")}" up in')
        if both := [key for key in ("alpha", "sigma") if key in entry]:
            raise DataError(f"{place}: catalogue and {both[0]} are both stated; a material has one")
        try:
            found = catalogue(entry.text("catalogue"), room.centre_frequencies)
        except DataError as error:
            raise DataError(f"{place}: {error}") from error
        return Material(name, found.alpha, found.sigma, source=found.source)
    own = {key: table[key] for key in ("name", "alpha", "sigma", "source") if key in table}
    return room_files.material(place, own, room.centre_frequencies, None)


def _change(place: str, table: Any, room: Room, new: Mapping[str, Material]) -> Change:
    entry = Entries(f"{place}: ", table, (), (*_KINDS, "by", "area"))
    kinds = [kind for kind in _KINDS if kind in entry]
    if len(kinds) != 1:
        raise DataError(f"{place} has {len(kinds)} of {', '.join(_KINDS)}; a change is one of them")
    kind = kinds[0]
    takes = {"cover": ("by", "area"), "add": ("area",), "remove": ("area",), "open": ("area",)}
    Entries(f"{place}: ", table, (kind,), takes.get(kind, ()))
    if kind == "air":
        air = room_files.air(f"{place}: air", table["air"])
        if air is None:
            raise DataError(f"{place}: air is empty")
        return Climate(air)
    if kind == "volume":
        return NewVolume(entry.number("volume"))
    surface = material_name(entry, kind, room, new)
    area = entry.number("area") if "area" in entry else None
    if kind == "cover":
        by = material_name(entry, "by", room, new)
        return Cover(surface, new.get(by, by), area)
    if kind == "remove":
        return Remove(surface, area)
    if kind == "open":
        return Open(surface, area)
    return Add(new.get(surface, surface), entry.number("area"))
