"""Changes of a room, the T that they are to meet, and which way surfaces face: across x, y or z.

Files of variants and of treatments, in TOML, state what may be changed, its cost and a target;
docs/files.md describes them. A change has the same keys in a file and in Python.

The standards of targets were not at hand: their numbers are as secondary sources give them. Those of
DIN 18041 were compared with two public ones. T of A1 to A3 stands on a manufacturer's page
(setaplast.de, of the edition of 2004), all volumes and the range by band in a program for its limits
(Raumakustik-CAD by redbluee). That program's constants of A2 to A5 have the other sign, with which T of
speech would be longer than on that page. Those of ANSI/ASA S12.60 are alike on pages of three firms
(larsondavis.com, armstrongceilings.com, robertandersongroup.com). ISO and ISO/TR have no numbers here:
no public source was found.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import SigmaRule
from rtcal.acoustics.room import (
    AXES,
    Material,
    Piece,
    PriorTable,
    Room,
    Scene,
    Surface,
    lying_on,
    of_materials,
    refuse_too_many,
)
from rtcal.files.disk import json_numbers
from rtcal.files.schema import FileTable, Number, read, toml_table
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, put

DIN_18041 = {
    "A1": ("music", 0.45, 0.07, 30, 1000),
    "A2": ("speech and lectures", 0.37, -0.14, 50, 5000),
    "A3": ("teaching and communication", 0.32, -0.17, 30, 5000),
    "A4": ("teaching and communication, inclusive", 0.26, -0.14, 30, 500),
    "A5": ("sports", 0.75, -1.00, 200, 10_000),
}
"""Uses of group A of DIN 18041:2016-03 for occupied rooms (A5: unoccupied). Each has a and b of
T = a lg V + b in s, and the smallest and the largest volume V in m³."""
DIN_18041_TOLERANCE = {
    125.0: (0.65, 1.45),
    **dict.fromkeys((250.0, 500.0, 1000.0, 2000.0), (0.8, 1.2)),
    4000.0: (0.65, 1.2),
}
"""Range of T by band, over T at middle frequencies. For A5 the standard states 250 to 2000 Hz only."""
_DIN_SOURCE = (
    "DIN 18041:2016-03, group {}, {}: T = {:.2f} s at middle frequencies (after secondary sources)"
)
LONGEST = 100.0
"""Largest T of a target in s. A larger number is not T of a room in s, but in ms or another unit."""
ANSI_S12_60 = ((283.0, 0.6), (566.0, 0.7))
"""Largest volume in m³ (10,000 and 20,000 ft³) and largest T in s of a furnished, empty classroom."""
_ANSI_BANDS = (500.0, 1000.0, 2000.0)
_ANSI_SOURCE = "ANSI/ASA S12.60: at most {:g} s at 500, 1000 and 2000 Hz (after secondary sources)"


@dataclass(frozen=True, eq=False)
class Target:
    """Range in which the reverberation time T should be, per band.

    Parameters
    ----------
    low, high : array (n_bands,)
        Shortest and longest T in s; NaN where there is no such limit.
    source : str
        Source of the range, such as a standard.

    Raises
    ------
    DataError
        If a limit is not above 0 or is above 100 s, ``low`` is not below ``high``, or no band has a
        limit.

    Examples
    --------
    >>> Target([0.5, 0.5], [0.8, float("nan")]).high
    array([0.8, nan])
    """

    low: Array
    high: Array
    source: str = "given by you"

    def __post_init__(self) -> None:
        low, high = checks.array("low", self.low), checks.array("high", self.high)
        if low.shape != high.shape or low.ndim != 1:
            raise DataError(
                f"low has shape {low.shape} and high {high.shape}; both must be (n_bands,)"
            )
        for name, ends in (("low", low), ("high", high)):
            possible = ~((ends <= 0) | (ends > LONGEST))
            checks.entries(name, ends, possible, f"above 0 and at most {LONGEST:g} s", "s")
        checks.entries("low", low, ~(low >= high), lambda k: f"below high = {high[k]:g} s", "s")
        put(self, low=low, high=high)
        if not self.bounded.any():
            raise DataError("target: every low and high is missing; give both in at least one band")

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Bands in which T has a lower or an upper limit, (n_bands,) of bool."""
        return np.asarray(np.isfinite(self.low) | np.isfinite(self.high))

    def to_dict(self) -> dict[str, Any]:
        """Return a dict for JSON with ``low`` and ``high``, T in s per band, and the text ``source``.

        A limit that does not exist (NaN) is None.
        """
        ends = {"low": json_numbers(self.low), "high": json_numbers(self.high)}
        return {**ends, "source": self.source}

    def widened(self, factor: float) -> Target:
        """Return the range from ``low`` / ``factor`` to ``high`` times ``factor``, at most 100 s."""
        return Target(self.low / factor, np.minimum(self.high * factor, LONGEST), self.source)


def din_18041(group: str, volume: float, centre_frequencies: Sequence[float] | Array) -> Target:
    """Return the range of T that DIN 18041:2016 requires for a room of group A, per octave.

    The required T at middle frequencies is a lg V + b, with a and b of the group (`DIN_18041`).
    From 250 to 2000 Hz the range is 0.8 to 1.2 times this T. At 125 Hz it is 0.65 to 1.45 times and
    at 4000 Hz 0.65 to 1.2 times this T, but sports rooms (A5) have no range there. Other bands have
    no range.

    Parameters
    ----------
    group : {"A1", "A2", "A3", "A4", "A5"}
        Use of the room, in this order: music, lectures, teaching, inclusive teaching, sports.
    volume : float
        Volume V of the room in m³: 30 to 1000 for A1, 50 to 5000 for A2, 30 to 5000 for A3, 30 to 500
        for A4, and 200 to 10,000 for A5.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz.

    Raises
    ------
    DataError
        For any other group, and for a volume outside its range.

    Examples
    --------
    >>> target = din_18041("A3", 180, [125, 500, 4000])
    >>> print(target.low.round(2), target.high.round(2))
    [0.36 0.44 0.36] [0.8  0.66 0.66]
    """
    if group not in DIN_18041:
        raise DataError(f'group = "{group}" must be one of {", ".join(DIN_18041)}')
    use, slope, offset, least, most = DIN_18041[group]
    checks.between("volume", volume, least, most, "m³", f", for which DIN 18041 states {group}")
    t = slope * np.log10(volume) + offset
    low, high = np.array(
        [
            DIN_18041_TOLERANCE.get(f if group != "A5" or 250 <= f <= 2000 else 0, [np.nan] * 2)
            for f in bands.as_bands(centre_frequencies).tolist()
        ]
    ).T
    return Target(t * low, t * high, _DIN_SOURCE.format(group, use, t))


def ansi_s12_60(volume: float, centre_frequencies: Sequence[float] | Array) -> Target:
    """Return the range of T that ANSI/ASA S12.60 allows in a classroom: at most 0.6 or 0.7 s.

    The upper limit is 0.6 s up to a volume of 283 m³, and 0.7 s above it. It applies to the octaves
    500, 1000 and 2000 Hz, and is NaN in other bands; there is no lower limit. ``volume`` is in m³,
    and ``centre_frequencies`` (n_bands,) are in Hz. Raises DataError above 566 m³, where the
    standard states no T.

    Examples
    --------
    >>> ansi_s12_60(300, [250, 500]).high
    array([nan, 0.7])
    """
    for largest, t in ANSI_S12_60:
        if checks.positive("volume", volume, "m³") <= largest:
            f = bands.as_bands(centre_frequencies)
            high = np.where(np.isin(f, _ANSI_BANDS), t, np.nan)
            return Target(np.full(len(f), np.nan), high, _ANSI_SOURCE.format(t))
    raise DataError(
        f"volume = {volume:g} m³ is too large: ANSI S12.60 gives a T only for rooms up to 566 m³"
    )


class TargetTable(FileTable):
    """Target of T as a file states it: a standard, or the shortest and the longest T in s."""

    standard: Literal["DIN 18041", "ANSI S12.60"] | None = None
    group: str | None = None
    low: Number | list[Number] | None = None
    high: Number | list[Number] | None = None


def target_of(table: TargetTable, volume: float, frequencies: Array) -> Target:
    """Return the target range of T that a file states, by band.

    ``table`` is the file's table: a standard with its group of rooms, or the shortest and the longest T
    in s. ``volume`` is that of the room in m³, and ``frequencies`` (n_bands,) are the centre
    frequencies in Hz. Raises DataError if the file states both a standard and a limit of T, a ``group``
    without a standard that has groups, or limits for another number of bands.
    """
    ends = {"low": table.low, "high": table.high}
    stated = [key for key, end in ends.items() if end is not None]
    if table.standard is not None and stated:
        raise DataError(
            f'target: standard = "{table.standard}" and {stated[0]} are both given; give '
            "only one of them"
        )
    if table.standard == "DIN 18041":
        return din_18041(table.group or "", volume, frequencies)
    if table.group is not None:
        raise DataError(
            f'target: group = "{table.group}" belongs to DIN 18041: add standard = "DIN 18041", '
            "or leave group out"
        )
    if table.standard is not None:
        return ansi_s12_60(volume, frequencies)
    n = len(frequencies)
    for key, end in ends.items():
        if isinstance(end, list) and len(end) != n:
            raise DataError(
                f"target.{key} has {len(end)} values; give one for each of the room's {n} bands"
            )
    low, high = (np.full(n, np.nan if end is None else end) for end in ends.values())
    return Target(low, high)


OPENING = "opening"
"""Name of the material of an opening, whose alpha is exactly 1."""
MOST_ADDED = 10.0
"""Largest area that may be added, over the room's surface. More is a misplaced decimal point."""
MOST_VOLUME = 100.0
"""Largest ratio of the larger to the smaller of the volumes before and after. More is a wrong unit."""
_SAME_AREA = 1e-6
"""Relative difference below which what comes in has the area of what goes out."""
_CLOSED = 1e-3
"""Relative difference below which the surfaces are those of the box: nothing in it is free-standing."""
_ROUNDING = 1e-9
"""Relative difference below which an area is the whole area."""
_TAKES = {
    "cover": ("by", "area"),
    "add": ("area", "number"),
    "remove": ("area", "number"),
    "open": ("area",),
    "air": (),
    "volume": (),
}
"""Kinds of change, and the further keys of each."""
_UNITS = {"area": "m²", "volume": "m³", "number": "pieces"}


@dataclass(frozen=True, kw_only=True)
class Change:
    """One change of a room: exactly one of cover, add, remove, open, air and volume.

    Parameters
    ----------
    cover : str
        Material of the room that is covered and then no longer absorbs. The total surface stays.
    by : Material or str
        Covering material; a str names a material of the room. Its area is as uncertain as that of the
        covered material.
    add : Material or str
        Free-standing material that is brought in. The total surface grows, and nothing is covered.
    remove : str
        Free-standing material that is taken out, so that the total surface shrinks. A material that
        lies on a surface of the room ("floor: audience") uncovers that surface instead (`changed`).
    open : str
        Material of the room of which a part is opened, so that alpha is exactly 1 there.
    area : float
        Area in m² that is covered, removed or opened; the whole area of the material by default. For
        added material, the area that the sound reaches (both sides of a baffle), at most 10 times the
        room's surface. Its relative error is that of the room's material, and 0 for a new material.
    number : float
        Number of pieces, such as persons, that are added or removed in place of an area. No surface
        changes. The alpha of an added `Material` is then the absorption area of one piece in m²
        (`Piece`).
    air : Air
        Air after the change: its temperature, humidity and pressure.
    volume : float
        Volume after the change in m³. The surfaces stay.

    Raises
    ------
    DataError
        For no or several kinds of change, an argument that this kind of change does not have, or a
        value of the wrong type.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["wall", "floor"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> Change(cover="wall", by="floor", area=10).apply(room).areas.tolist()
    [64.0, 30.0]
    >>> Change(add=Material("baffle", [0.9], [0.1]), area=12).apply(room).total_area
    106.0
    >>> print(Change(open="wall", area=4), Change(air=Air(26, 60)), sep="; ")
    open 4 m² of "wall"; air of 26 °C and 60 %
    """

    cover: str | None = None
    by: Material | str | None = None
    add: Material | str | None = None
    remove: str | None = None
    open: str | None = None
    area: Number | None = None
    number: Number | None = None
    air: Air | None = None
    volume: Number | None = None

    def __post_init__(self) -> None:
        stated = {key: value for key, value in vars(self).items() if value is not None}
        kinds = [kind for kind in _TAKES if kind in stated]
        if len(kinds) != 1:
            raise DataError(
                f"a change must have exactly one of {', '.join(_TAKES)}; this one has {len(kinds)}"
            )
        kind = kinds[0]
        if extra := [key for key in stated if key not in (kind, *_TAKES[kind])]:
            raise DataError(f'a change of the kind "{kind}" does not use {extra[0]}: leave it out')
        if kind == "cover" and self.by is None:
            raise DataError("cover needs by, which is missing")
        amounts = len({"area", "number"} & {*stated})
        if kind == "add" and not amounts:
            raise DataError(
                "add needs an area in m², or a number if pieces ([[object]]) are added; "
                "both are missing"
            )
        if amounts == 2:
            raise DataError(f"{kind} has both area and number; give only one of them")
        for key, value in stated.items():
            place = f"change: {key}"
            if key in _UNITS:
                checks.positive(place, value, _UNITS[key])
            elif key == "air":
                checks.instance(place, value, Air)
            elif key in ("cover", "remove", "open"):
                checks.text(place, value)
            elif not isinstance(value, Material | str):
                raise DataError(
                    f"{place} = {checks.shown(value)} is neither a Material nor the name of one"
                )

    @property
    def kind(self) -> str:
        """Kind of the change: cover, add, remove, open, air or volume."""
        return next(kind for kind in _TAKES if getattr(self, kind) is not None)

    @property
    def surface(self) -> str | None:
        """Name of the room's material that loses area; None if no material does."""
        going = (self.cover, self.remove, self.open)
        return next((name for name in going if name is not None), None)

    @property
    def material(self) -> Material | str | None:
        """Material that comes into the room, or its name; None if no material does."""
        if self.open is not None:
            return OPENING
        return self.add if self.by is None else self.by

    def exchanged(self, room: Room) -> tuple[float, Material | None]:
        """Return the area in m² that is exchanged, and the added material with this area.

        The area is that of the change, or the whole area of the material of ``room`` that is covered,
        removed or opened; 0 if the change states none. The material is None if none is added. For
        pieces the number of pieces stands in place of the area. Raises DataError if the room has less
        of the material than is taken, if more than 10 times the room's surface is added, or if an area
        is given for pieces or a number for a surface.
        """
        taken, error = self.area or self.number or 0.0, 0.0
        stated = "area" if self.number is None else "number"
        for name in filter(None, (self.surface, name_of(self.material))):
            if name not in room.materials:
                continue
            if (name in room.pieces) != (stated == "number") and taken:
                of, key = "an area in m²", "area"
                if name in room.pieces:
                    of, key = "a number of pieces", "number"
                raise DataError(
                    f'{stated} = {taken:g} is given, but "{name}" has {of}: give {key} instead'
                )
            if name in room.pieces and self.kind not in ("add", "remove"):
                raise DataError(
                    f'{self.kind}: "{name}" has a number of pieces and no surface; pieces '
                    "can only be added or removed"
                )
        if self.surface is not None:
            row = room.material_index(self.surface)
            has, error = float(room.areas[row]), float(room.area_sigma[row])
            if taken > has * (1 + _ROUNDING):
                unit = " m²" if self.surface not in room.pieces else ""
                raise DataError(
                    f'{stated} = {taken:g}{unit} is more than the {has:g}{unit} of "{self.surface}"'
                )
            taken = has if not taken or taken > has * (1 - _ROUNDING) else taken
        if self.material is None:
            return taken, None
        new = _material(room, self.material)
        if self.surface is None:
            if self.number is None and taken > (most := MOST_ADDED * room.total_area):
                raise DataError(
                    f"area = {taken:g} m² is too large: at most {most:g} m², {MOST_ADDED:g} "
                    "times the room's surface, can be added"
                )
            if self.number is not None:
                refuse_too_many("number", taken, new.alpha, room.total_area)
            errors = dict(zip(room.materials, room.area_sigma.tolist(), strict=True))
            error = errors.get(new.name, 0.0)
        return taken, replace(new, area=taken, area_sigma=error)

    def apply(self, room: Room) -> Room:
        """Return the room after this change.

        If a material of the room gets more area, the errors of its old and its new area add up. Raises
        DataError if the room does not allow the change.
        """
        if self.air is not None:
            if room.air is None:
                raise DataError(
                    "air: the room has no air before the change, so that all absorption of the air "
                    "would count as a change. Give the room its air ([air] in its file)"
                )
            return room.with_air(self.air)
        if self.volume is not None:
            least, most = room.volume / MOST_VOLUME, room.volume * MOST_VOLUME
            has = f": the room has {room.volume:g} m³"
            checks.between("volume", self.volume, least, most, "m³", has)
            return room.replace(volume=self.volume)
        taken, comes = self.exchanged(room)
        rows = {name: room.material(name) for name in room.materials}
        if self.surface is not None:
            goes = rows[self.surface]
            rows[self.surface] = replace(goes, area=float(goes.area or 0) - taken)
        if comes is not None:
            both = (rows.get(comes.name, replace(comes, area=0.0)), comes)
            areas = [float(each.area or 0) for each in both]
            errors = [float(each.area_sigma or 0) for each in both]
            sigma = float(np.dot(errors, areas)) / sum(areas)
            rows[comes.name] = replace(both[0], area=sum(areas), area_sigma=sigma)
        left = [row for row in rows.values() if row.area]
        if not left:
            raise DataError("the change leaves the room without any surface; reduce its area")
        pieces = {*room.pieces, *([name_of(self.add)] if self.number and self.add else [])}
        return room.with_rows(left, pieces=[row.name for row in left if row.name in pieces])

    def __str__(self) -> str:
        if self.air is not None:
            return f"air of {self.air.temperature:g} °C and {self.air.humidity:g} %"
        if self.volume is not None:
            return f"volume of {self.volume:g} m³"
        amount = "all" if self.area is None else f"{self.area:g} m²"
        if self.number is not None:
            amount = f"{self.number:g}"
        by = "" if self.by is None else f' by "{name_of(self.by)}"'
        return f'{self.kind} {amount} of "{self.surface or name_of(self.material)}"{by}'


def name_of(material: Material | str | None) -> str:
    """Return the name of a material that is given as an object or by its name."""
    return material.name if isinstance(material, Material) else str(material)


def changed(room: Room, changes: Change | Sequence[Change]) -> Room:
    """Return the room after one or several changes, made in the given order.

    The changed room has neither single surfaces nor a scene, because a change does not state which part
    of a surface is covered.

    ``room`` is the room before, and ``changes`` is one `Change` or a sequence of them.

    Raises
    ------
    DataError
        If the room has less area of a material than a change takes, or if a new material has the name
        of a material of the room but other coefficients.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> panel = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> after = changed(
    ...     room, [Change(cover="ceiling", by=panel, area=20), Change(open="windows", area=2)])
    >>> after.materials[-2:], round(after.total_area - room.total_area, 6)
    (('panel', 'opening'), 0.0)
    """
    return placed(room, (changes,) if isinstance(changes, Change) else tuple(changes)).room


def uncovering(room: Room, changes: Sequence[Change]) -> list[Change]:
    """Return the changes, in which a covering replaces the removal of a material that lies on another.

    The material below, which becomes bare, then covers the removed one. The names of the room's
    surfaces state which material lies on which (`rtcal.acoustics.room.lying_on`); all other materials
    are free-standing. Raises DataError for an object that is no `Change`, and for a removed material
    of which only a part lies on others. In a closed box, DataError is also raised for a removed surface
    that lies on no other and that no change has added.
    """
    out = []
    added = {name_of(each.add) for each in changes if isinstance(each, Change)}
    closed = False
    if room.dimensions is not None:
        x, y, z = room.dimensions
        closed = abs(room.total_area / (2 * (x * y + y * z + z * x)) - 1) < _CLOSED
    for change in changes:
        is_area = checks.instance("change", change, Change).number is None
        name = (change.remove if is_area else None) or ""
        below = lying_on(room.surfaces, name)
        own = below.pop(None, 0.0)
        if name in room.materials and closed and not below and name not in room.pieces:
            own = float(room.areas[room.material_index(name)])
        if own and (below or (closed and name not in added)):
            raise DataError(
                f'{change}: {own:.4g} m² of "{name}" is a surface of the room, and the '
                "material under it is unknown. In place of remove, name the material that is "
                f'visible afterwards: cover = "{name}", by = "MATERIAL"'
            )
        if not below:
            out.append(change)
            continue
        total = sum(below.values())
        share = (change.area or total) / total
        is_all = change.area is None and len(below) == 1
        out += [
            Change(cover=name, by=material, area=None if is_all else share * area)
            for material, area in below.items()
        ]
    return out


DIRECTIONS = ("x", "y", "z", "free", "unknown")
FREE, UNKNOWN = 3, 4
"""Columns for free-standing material, which faces all directions, and for unknown directions."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Room, with the area of each material by direction (`DIRECTIONS`) in m², (n_materials, 5)."""

    room: Room
    areas: Array


def placed(
    before: Room,
    changes: Sequence[Change] | Room,
    like: Placed | None = None,
    shares: Array | None = None,
) -> Placed:
    """Return the room after changes, with the area of each material by the direction that it faces.

    ``changes`` are changes of the room ``before`` in the given order, or the changed room itself.
    ``shares`` (n_materials, 3) are the shares of each material's area that face x, y and z before the
    changes, by default those of `facing`. A covering faces the same way as the surface below it. If a
    part of a material that faces several directions is covered, each direction loses the same share.
    ``like`` is another state of the room, from which directions are taken that ``before`` does not
    give: a material of both states faces the same way in both; a new one faces the way of the material
    that it replaces, or is free-standing if it replaces none. Raises DataError as `changed` does.
    """
    shares = facing(before) if shares is None else shares
    towards = np.zeros((before.n_materials, len(DIRECTIONS)))
    known = ~np.isnan(shares).any(axis=1)
    towards[known, :3] = shares[known]
    towards[~known, UNKNOWN] = 1.0
    towards[~before.is_surface] = np.eye(len(DIRECTIONS))[FREE]
    known |= ~before.is_surface
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
    for change in uncovering(before, changes):
        again = change.material if change.open is None else None
        if isinstance(again, str) and again in {*before.materials} - {*room.materials}:
            # None of it is left, as where two materials are exchanged: it is still known.
            whole: Any = {"add" if change.by is None else "by": before.material(again)}
            change = replace(change, **whole)
        try:
            taken, comes = change.exchanged(room)
            after = change.apply(room)
        except DataError as error:
            raise DataError(f"{change}: {error}") from error
        moved = np.zeros(len(DIRECTIONS))
        moved[FREE] = 0.0 if comes is None else comes.area
        if (name := change.surface) is not None:
            moved = faces[name] * (taken / room.areas[room.material_index(name)])
            faces[name] = faces[name] - moved
        if comes is not None:
            faces[comes.name] = faces.get(comes.name, 0.0) + moved
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


def new_name(taken: Iterable[str], wanted: str) -> str:
    """Return the wanted name, followed by a number if it looks the same as one of the names taken.

    Examples
    --------
    >>> new_name(["wall"], "panel"), new_name(["panel", "panel (2)"], "panel")
    ('panel', 'panel (3)')
    """
    numbered = (wanted if n == 1 else f"{wanted} ({n})" for n in count(1))
    seen = {checks.without_looks(name) for name in taken}
    return next(name for name in numbered if checks.without_looks(name) not in seen)


def _material(room: Room, material: Material | str) -> Material:
    """Return a material of the room by its name, or a new one after a check against the room's."""
    if material == OPENING and OPENING not in room.materials:
        return Material(OPENING, [1.0] * room.n_bands, [0.0] * room.n_bands)
    if isinstance(material, str):
        return room.material(material)
    if material.name in room.materials:
        row = room.materials.index(material.name)
        stated = of_materials([material], room.centre_frequencies)
        for name in ("alpha", "sigma"):
            if not np.array_equal(getattr(room, name)[row], stated[name][0]):
                raise DataError(
                    f'{name} of "{material.name}" differs from the room\'s material of the '
                    "same name: use another name, or the room's values"
                )
    return material


Catalogue = Callable[[str, Any], Material]
"""Function that returns a catalogue's material from its name and centre frequencies in Hz."""


class NewMaterial(FileTable):
    """Material that is not in the room yet: its alpha and sigma, or its name in a catalogue."""

    name: str
    alpha: list[Number] | None = None
    sigma: Number | list[Number] | Literal["low", "moderate", "high"] | None = None
    catalogue: str | None = None
    source: str = ""

    def material(self, room: Room, catalogue: Catalogue | None) -> Material:
        """Return the material in the room's bands; DataError unless alpha has exactly one origin."""
        place = f'material "{self.name}"'
        if self.catalogue is None:
            if self.alpha is None:
                raise DataError(f"{place}: alpha is missing; give one coefficient per band")
            return Material(self.name, self.alpha, self.sigma, source=self.source)
        if catalogue is None:
            raise DataError(
                f'{place}: "{self.catalogue}" cannot be looked up, because no catalogue is loaded'
            )
        if both := [key for key in ("alpha", "sigma") if getattr(self, key) is not None]:
            raise DataError(
                f"{place}: catalogue and {both[0]} are both given; a material takes only one of "
                "them"
            )
        try:
            found = catalogue(self.catalogue, room.centre_frequencies)
        except DataError as error:
            raise DataError(f"{place}: {error}") from error
        return Material(self.name, found.alpha, found.sigma, source=found.source)


class VariantTable(FileTable):
    """Variant in a file. Its name is by default its changes; without changes it is the room."""

    change: list[Change] = []
    name: str | None = None
    cost: Number | None = None
    simulated: str | None = None


class NewPiece(FileTable):
    """`Piece` that is not in the room yet; the changes give its number."""

    name: str
    area_per_piece: list[Number]
    sigma: Number | list[Number] | None = None
    source: str = ""
    number: Number | None = None

    def material(self, room: Room, rule: SigmaRule | None) -> Material:
        """Return one piece as a material; DataError without sigma and a rule, and with a number."""
        if self.number is not None:
            raise DataError(
                f'object "{self.name}": number = {self.number:g} belongs to the change that adds it; '
                "leave it out here"
            )
        piece = Piece(self.name, 1.0, self.area_per_piece, self.sigma, self.source)
        return replace(piece.with_sigma(rule).as_material(), area=None)


class VariantsFile(FileTable):
    """Tables of a file of variants."""

    variant: list[VariantTable] = []
    material: list[NewMaterial] = []
    object: list[NewPiece] = []
    target: TargetTable | None = None
    prior: PriorTable | None = None


class TreatmentsFile(FileTable):
    """Tables of a file of treatments."""

    treatment: list[Treatment]
    target: TargetTable
    material: list[NewMaterial] = []
    probability: Number = 0.8
    prior: PriorTable | None = None


@dataclass(frozen=True)
class Variant:
    """Changes of a room that are planned together, to be compared with other variants.

    Parameters
    ----------
    name : str
        Name of the variant in printed text.
    changes : tuple of Change
        Changes in the order in which they are made; () for the room as it is.
    cost : float, optional
        Cost of the changes in any currency, 0 or more; by default unknown.
    simulated : Measurement, optional
        Values that a simulation program gave for the room after the changes.

    Raises
    ------
    DataError
        If ``cost`` or ``simulated`` breaks its rule.

    Examples
    --------
    >>> Variant("window open", (Change(open="windows", area=2.0),)).name
    'window open'
    """

    name: str
    changes: tuple[Change, ...]
    cost: float | None = None
    simulated: Measurement | None = None

    def __post_init__(self) -> None:
        if self.simulated is not None:
            checks.instance("simulated", self.simulated, Measurement)
        if self.cost is not None and not 0 <= checks.number("cost", self.cost) < np.inf:
            raise DataError(f"cost = {self.cost:g} must be finite and 0 or more")


def read_variants(
    content: str, room: Room, catalogue: Catalogue | None = None, folder: str | Path = ""
) -> tuple[tuple[Variant, ...], Target | None]:
    """Return the variants of a room that a TOML text states, and its target of T if it states one.

    ``content`` is the text. New materials in it must have one value per band of ``room``. ``catalogue``
    is a function that returns a material for a name and bands, as `rtcal.datasets.catalogue.material`
    does; with None the text cannot refer to a catalogue. ``folder`` is the folder to which paths of
    ``simulated`` files in the text are relative.

    Raises DataError for an unknown key, a value that breaks a rule, a material that is neither in the
    room nor in the text, a name that is given twice, a change that the room does not allow, and for the
    reasons of `target_of`.
    """
    file = read(VariantsFile, toml_table(content))
    new = _new_materials(file.material, room, catalogue, file.prior)
    of_one = [each.material(room, _rule(file.prior)) for each in file.object]
    names = [each.name for each in file.material] + [each.name for each in file.object]
    checks.distinct("the file's materials and objects", names)
    of_materials(of_one, room.centre_frequencies)
    new |= {piece.name: piece for piece in of_one}
    pieces = {piece.name for piece in of_one}
    for change in (c for table in file.variant for c in table.change):
        if name_of(change.add) in pieces and change.number is None:
            raise DataError(
                f'change: add = "{name_of(change.add)}" is an [[object]]: give its number'
            )
    variants: list[Variant] = []
    for i, table in enumerate(file.variant, start=1):
        place = f"variant {i}" if table.name is None else f'variant "{table.name}"'
        try:
            made = _with_materials(table.change, room, new)
            changed(room, made)
            of_changes = "; ".join(map(str, made)) or "no change"
            name = of_changes if table.name is None else table.name
            of_program = None
            if table.simulated is not None:
                of_program = Measurement.from_file(str(Path(folder) / table.simulated))
            variants.append(Variant(name, made, table.cost, of_program))
        except DataError as error:
            raise DataError(f"{place}: {error}") from error
    if not variants:
        raise DataError("the file has no [[variant]]; it must have at least one")
    checks.distinct("variants", [variant.name for variant in variants])
    if file.target is None:
        return tuple(variants), None
    return tuple(variants), target_of(file.target, room.volume, room.centre_frequencies)


def _rule(prior: PriorTable | None) -> SigmaRule | None:
    """Return the rule for sigma of what a file brings in; None if it states none."""
    if prior is None:
        return None
    if prior.band_correlation:
        raise DataError("prior.band_correlation belongs to the room's file: leave it out here")
    return prior


def _new_materials(
    stated: Sequence[NewMaterial],
    room: Room,
    catalogue: Catalogue | None,
    prior: PriorTable | None,
) -> dict[str, Material]:
    """Return the materials of a file by name, with their sigma, which may be by the file's rule.

    Raises DataError for a material that does not fit the room's bands, or that has no sigma.
    """
    checks.distinct("the file's materials", [each.name for each in stated])
    new = {each.name: each.material(room, catalogue) for each in stated}
    sigma = of_materials([*new.values()], room.centre_frequencies, _rule(prior))["sigma"]
    return {
        m.name: replace(m, sigma=of_one.tolist()) if m.sigma is None else m
        for m, of_one in zip(new.values(), sigma, strict=True)
    }


def _named(key: str, material: Any, room: Room, new: Mapping[str, Material]) -> Any:
    """Return what a file names: its own material, or the name of the room's; DataError for neither."""
    if isinstance(material, str) and material not in (*room.materials, *new, OPENING):
        raise DataError(
            f'{key} = "{material}" is not a known material. Materials of the room: '
            f"{', '.join(room.materials)}; of the file: "
            f"{', '.join(new) or 'none'}"
        )
    return new.get(name_of(material), material)


def _with_materials(
    stated: Sequence[Change], room: Room, new: Mapping[str, Material]
) -> tuple[Change, ...]:
    """Return changes of a file with the materials that they name; DataError for one that is none.

    What an earlier change brought in may be covered, removed or opened by a later one.
    """
    made: list[Change] = []
    for change in stated:
        there = {name: new[name] for name in (name_of(c.material) for c in made) if name in new}
        for key in ("cover", "remove", "open"):
            _named(key, getattr(change, key), room, there)
        comes = {k: _named(k, getattr(change, k), room, new) for k in ("add", "by")}
        made.append(replace(change, **comes))
    return tuple(made)


MOST_COST = 1e9
"""Largest cost per m². A larger number is a slip, and rounding would then hide the other costs."""
MOST_PANELS = 500
"""Largest number of whole panels of a treatment. With more, rounding to whole panels hardly matters."""


@dataclass(frozen=True)
class Treatment:
    """Material that may be put into the room, with its largest area and its cost.

    Parameters
    ----------
    name : str
        Name of the treatment.
    material : Material or str
        Material that is put in; a str names a material of the room.
    largest : float
        Largest area that may be put in, in m².
    cost : float
        Cost per m² in any currency, from 0 to 1e9.
    covers : str, optional
        Name of the room's material that is covered; the treatment is free-standing by default.
    unit : float, optional
        Area of one panel in m², if only whole panels are put in, at most 500; any area by default.

    Raises
    ------
    DataError
        If a number is outside its range, or one panel is larger than the largest area.

    Examples
    --------
    >>> panel = Material("panel", [0.9], [0.1])
    >>> Treatment("on the ceiling", panel, largest=40, cost=90, covers="ceiling", unit=1.44).unit
    1.44
    """

    name: str
    material: Material | str
    largest: Number
    cost: Number
    covers: str | None = None
    unit: Number | None = None

    def __post_init__(self) -> None:
        place = f'treatment "{self.name}": '
        checks.positive(f"{place}largest", self.largest, "m²")
        checks.between(f"{place}cost", self.cost, 0, MOST_COST, why=" per m²")
        if self.unit is None:
            return
        if checks.positive(f"{place}unit", self.unit, "m²") > self.largest:
            raise DataError(
                f"{place}unit = {self.unit:g} m², the area of one panel, is larger than "
                f"largest = {self.largest:g} m²"
            )
        if self.largest > MOST_PANELS * self.unit:
            raise DataError(
                f"{place}unit = {self.unit:g} m² would make more than {MOST_PANELS} panels in "
                f"largest = {self.largest:g} m²; give a larger unit, or leave it out to allow "
                "any area"
            )

    def change(self, area: float) -> Change:
        """Return the change that puts an area in m² of the treatment's material into the room.

        ``area`` is at most the treatment's ``largest``.
        """
        if self.covers is None:
            return Change(add=self.material, area=area)
        return Change(cover=self.covers, by=self.material, area=area)


def read_treatments(
    content: str, room: Room, catalogue: Catalogue | None = None
) -> tuple[tuple[Treatment, ...], Target, float]:
    """Return the treatments that a TOML text states, its target of T, and the required probability.

    The probability is that with which T must be within the target. ``content`` is the text; ``room``,
    ``catalogue`` and the errors are those of `read_variants`.
    """
    file = read(TreatmentsFile, toml_table(content))
    new, treatments = _new_materials(file.material, room, catalogue, file.prior), []
    for each in file.treatment:
        place = f'treatment "{each.name}": '
        _named(f"{place}covers", each.covers, room, {})
        treatments.append(
            replace(each, material=_named(f"{place}material", each.material, room, new))
        )
    target = target_of(file.target, room.volume, room.centre_frequencies)
    return tuple(treatments), target, file.probability


def check_treatments(treatments: Sequence[Treatment], room: Room) -> tuple[Treatment, ...]:
    """Return the treatments as a tuple, once they are checked.

    Raises DataError if there is no treatment, if two have the same name, or if one does not fit
    ``room``.
    """
    listed = tuple(treatments)
    for treatment in listed:
        checks.instance("treatment", treatment, Treatment)
    if not listed:
        raise DataError("treatments is empty; give at least one")
    checks.distinct("treatments", [treatment.name for treatment in listed])
    for treatment in listed:
        try:
            treatment.change(treatment.largest).exchanged(room)
        except DataError as error:
            raise DataError(f'treatment "{treatment.name}": largest: {error}') from error
    return listed


UNKNOWN_SHARE = 0.2
"""Largest share of the absorption area whose direction may be unknown, as of chairs and curtains."""
_WHOLE = 0.9
"""Share of a material's area whose direction must be known for the material's."""
NOT_KNOWN = (
    "nothing says in which direction the room's surfaces face: state axis for each [[surface]], "
    "dimensions or a mesh, or name the surfaces floor, ceiling and walls"
)
"""Sentence on why uneven absorption is not judged in a room whose surfaces have unknown directions."""


def facing(room: Room, geometry: Any = None) -> Array:
    """Return the shares of each material's area that face x, y and z, (n_materials, 3), NaN if unknown.

    With a ``geometry``, a `rtcal.simulators.Polyhedron`, the shares are those of its faces: an oblique
    face counts by the squares of its normal's components, and a material without a face is unknown.
    With None, the first of these rules that applies gives the direction of a surface: its ``axis``; its
    name or its material's, if that means floor, ceiling or wall (English, German, French, Spanish,
    Italian, Portuguese); its area, if faces of the box of the room's ``dimensions`` have the same. The
    last surfaces take the faces of the box that are left; without dimensions, a named floor or ceiling
    gives the box. Walls without a box face x and y by halves.
    """
    if geometry is not None:
        along = np.asarray(geometry.face_areas)[:, np.newaxis] * np.square(geometry.normals)
        return _by_material(room, geometry.materials, along, least=0.0)
    stands = {surface.material for surface in room.surfaces}
    surfaces = [
        *room.surfaces,
        *(
            Surface(name, name, float(area))
            for name, area in zip(room.materials, room.areas, strict=True)
            if name not in {*stands, *room.pieces}
        ),
    ]
    areas, materials = np.array([s.area for s in surfaces]), [s.material for s in surfaces]
    kinds = [kind_of(s.name) or kind_of(s.material) for s in surfaces]
    box, walls = None, np.array([0.5, 0.5, 0.0])
    if room.dimensions is not None:
        x, y, z = room.dimensions
        box = 2 * np.array([y * z, x * z, x * y])  # of both faces along x, y and z
        walls = box * [1, 1, 0] / (box[0] + box[1])
    level = np.eye(3)[2]
    ways = {FLOOR: level, CEILING: level, LEVEL: level, WALL: walls, None: np.full(3, np.nan)}
    shares = [
        ways[kind] if s.axis is None else np.eye(3)[AXES.index(s.axis)]
        for s, kind in zip(surfaces, kinds, strict=True)
    ]
    along = areas[:, np.newaxis] * shares
    if box is not None:
        along = _matched(areas, along, box)
    else:  # with the named floor or ceiling, as both; the other surfaces are its walls
        one = max(
            sum(s.area for s, k in zip(surfaces, kinds, strict=True) if k == kind)
            for kind in (FLOOR, CEILING)
        )
        if 0 < 2 * one < (total := sum(areas.tolist())):
            box = np.array([total / 2 - one, total / 2 - one, 2 * one])
    if box is not None:
        along = _rest(areas, along, box, materials)
    return _by_material(room, materials, along)


def enough_known(room: Room, shares: Array) -> bool:
    """Return whether most of the room's absorption area is of materials with a known direction.

    ``shares`` (n_materials, 3) are the shares of each material's area that face x, y and z, NaN if
    unknown, as `facing` returns them.
    """
    unknown = np.isnan(shares).any(axis=1) & room.is_surface
    absorbed = (room.areas[:, np.newaxis] * room.alpha).sum(axis=1)
    return bool((~unknown).any() and absorbed[unknown].sum() <= UNKNOWN_SHARE * absorbed.sum())


def _by_material(
    room: Room, materials: Sequence[str], along: Array, least: float = _WHOLE
) -> Array:
    """Return shares from the areas of surfaces along x, y and z, NaN where unknown.

    A material is known whose known surfaces have at least the share ``least`` of its area.
    """
    sums = np.zeros((room.n_materials, 3))
    for material, areas in zip(materials, along, strict=True):
        if material in room.materials and not np.isnan(areas[0]):
            sums[room.materials.index(material)] += areas
    total = sums.sum(axis=1, keepdims=True)
    known = (total > 0) & (total >= least * room.areas[:, np.newaxis])
    return np.asarray(np.divide(sums, total, out=np.full(sums.shape, np.nan), where=known))


FLOOR, CEILING, WALL, LEVEL = "floor", "ceiling", "wall", "floor and ceiling"
_WORDS = {
    FLOOR: "floor floors flooring boden böden fussboden bodenbelag sol plancher suelo piso pavimento "
    "chão soalho",
    CEILING: "ceiling ceilings roof decke decken dach plafond toit techo cielorraso soffitto tetto "
    "teto forro",
    WALL: "wall walls wand wände waende mauer mauern mur murs pared paredes muro muri parete pareti "
    "parede paredes",
}
_COMPOUNDS = {FLOOR: ("boden",), CEILING: ("decke", "decken"), WALL: ("wand", "wände")}
"""Parts of German words: Akustikdecke, Deckenplatten, Rückwand."""
_TO = frozenset(["to", "bis", "au", "à", "al", "ao"])
"""What stands between floor and ceiling in the name of something that reaches from one to the other."""
_NO_COMPOUNDS = ("leinwand", "vorwand", "gewand")


def kind_of(name: str) -> str | None:
    """Return "floor", "ceiling", "wall" or "floor and ceiling" if a name has a word for it, else None.

    Examples
    --------
    >>> kind_of("Akustikdecke"), kind_of("rear wall, wood"), kind_of("floor-to-ceiling window")
    ('ceiling', 'wall', None)
    """
    words = re.findall(r"[^\W\d_]+", name.lower().replace("ß", "ss"))
    kinds = {
        kind
        for kind, listed in _WORDS.items()
        for word in words
        if word in listed.split()
        or (
            word not in _NO_COMPOUNDS
            and (word.startswith(_COMPOUNDS[kind]) or word.endswith(_COMPOUNDS[kind]))
        )
    }
    if kinds == {FLOOR, CEILING} and not _TO.intersection(words):
        return LEVEL
    return kinds.pop() if len(kinds) == 1 else None


_NEAR = 0.02
"""Share by which an area may differ from that of the faces that it is."""
_AGREE = 0.05
"""Difference of the shares of two sets of faces below which they are one answer."""
_OF_REST = 0.1
"""Share by which the surfaces that are left may differ from the faces that are left."""


def _matched(areas: Array, along: Array, box: Array) -> Array:
    """Return the areas along the axes, also of surfaces with the area of faces of the box.

    All six faces are surfaces, or what is left of them is what is left of the surfaces.
    """
    # One material is usually on floor and ceiling, or on walls but for a corner of two, or on floor or
    # ceiling with all walls.
    every = np.array(list(product(range(3), repeat=3)))[1:]
    x, y, z = every.T
    combinations = every[(x + y == 0) | (x + y == 4) | ((z == 0) & ((x != 1) | (y != 1)))]
    face = box / 2
    left = np.round(np.clip((box - np.nansum(along, axis=0)) / face, 0, 2), 2)
    unknown = sorted(np.flatnonzero(np.isnan(along[:, 0])).tolist(), key=lambda i: float(areas[i]))
    least, best = np.inf, along
    for order in (unknown, unknown[::-1]):
        free, out, rest = left, along.copy(), 0.0
        for i in order:
            fits = combinations[(combinations <= free + _NEAR).all(axis=1)]
            fits = fits[np.abs(areas[i] / (fits @ face) - 1) <= _NEAR]
            shares = fits * face / (fits @ face)[:, np.newaxis]
            if len(fits) and np.ptp(shares, axis=0).max() < _AGREE:
                out[i] = areas[i] * shares.mean(axis=0)
                free = free - fits[0]
            else:
                rest += areas[i]
        remaining = float(np.maximum(free, 0) @ face)
        all_are = remaining <= _NEAR * face.sum() or abs(rest / remaining - 1) <= _OF_REST
        if all_are and rest < least:
            least, best = rest, out
    return best


_ONE_KIND = 0.05
"""Share of another direction in what is left, up to which it is of one kind."""


def _rest(areas: Array, along: Array, box: Array, materials: Sequence[str]) -> Array:
    """Return the areas along the axes, also of the surfaces that are what is left of a box.

    Where walls and floor or ceiling are left, several materials may be on either.
    """
    unknown = np.asarray(np.isnan(along).any(axis=1))
    left = np.maximum(box - np.nansum(along, axis=0), 0.0)
    if left.sum() == 0 or abs(areas[unknown].sum() / left.sum() - 1) > _OF_REST:
        return along
    shares = left / left.sum()
    of_walls = shares[0] + shares[1]
    if min(of_walls, 1 - of_walls) <= _ONE_KIND:
        shares = shares * ([1, 1, 0] if of_walls > 0.5 else [0, 0, 1])
    elif len({m for m, at in zip(materials, unknown, strict=True) if at}) > 1:
        return along
    return np.where(unknown[:, np.newaxis], areas[:, np.newaxis] * (shares / shares.sum()), along)
