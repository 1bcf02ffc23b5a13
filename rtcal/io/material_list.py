"""Material lists of other programs: a room from a list, and calibrated coefficients back into it.

Each format (`catt`, `odeon`, `pyroomacoustics`, `bras`) has its grammar: where the materials and every
number stand. The rest is for all formats: bands are converted, numbers are written, and what rounding
does to T is stated. Only numbers that change are written; all other bytes stay.

Sources: CATT-Acoustic v8.0 User's Manual (CATT 2007), its shoebox and tutorial hall, and the lists that
I-Simpa's documentation reads; ODEON Room Acoustics Software User's Manual, "Materials" (Odeon A/S), and
the reader of Just4RIR (Sorbonne Universite, 2018), which reads ODEON's own library; pyroomacoustics
0.10.1, ``data/materials.json`` and ``parameters.Material``; Aspoeck, Brinkmann, Ackermann, Weinzierl,
Vorlaender, "BRAS - Benchmark for Room Acoustical Simulation", doi 10.14279/depositonce-6726.3.
`docs/material_lists.md` has the grammars, and what was not checked in the programs.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands, marks
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.priors import SigmaRule
from rtcal.acoustics.room import Material, Room, Surface, above_one_hint, times_of
from rtcal.files.disk import read_bytes, write_bytes
from rtcal.files.schema import TABLE, kind_of
from rtcal.io import budget
from rtcal.io.table_columns import nearest_band
from rtcal.io.text import MAX_TEXT, Text, decode, lines, number, shown
from rtcal.support import checks, text
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.types import Array

Span = tuple[int, int]
"""Positions in a file's text at which a number starts and ends."""
Token = tuple[str, int, int]
"""Characters of a number or cell, and their positions in the text."""


@dataclass(frozen=True, kw_only=True)
class ListedMaterial:
    """Hold one material of a program's material list.

    ``name`` is its name in the file, and ``line`` its line, from 1. ``alpha`` and ``scattering``
    (n_bands,) are coefficients from 0 to 1, in the bands ``centre_frequencies`` in Hz. ``spans`` and
    ``scattering_spans`` are the positions of their numbers in the file's text, and ``scattering_place``
    is where scattering can be inserted. ``unit`` is the factor from a number in the file to the
    coefficient, 0.01 for percent. ``decimals`` is the number of decimals to write; None for all.
    ``source`` is the origin of the coefficients, "" for the list itself. ``doubt`` is a reason not to
    use them, "" without one. ``sigma`` is the standard deviation of all coefficients, 0 where they are
    exact by definition; None leaves it to a rule.
    """

    name: str
    line: int
    alpha: tuple[float, ...]
    centre_frequencies: tuple[float, ...]
    spans: tuple[tuple[int, int], ...]
    unit: float = 1.0
    decimals: int | None = None
    scattering: tuple[float, ...] | None = None
    scattering_spans: tuple[tuple[int, int], ...] = ()
    scattering_place: int | None = None
    source: str = ""
    doubt: str = ""
    sigma: float | None = None

    @classmethod
    def of(
        cls,
        name: str,
        line: int,
        place: str,
        centre_frequencies: Sequence[float],
        row: Sequence[Token],
        scatters: Sequence[Token] | None = None,
        unit: float = 1.0,
        **more: Any,
    ) -> ListedMaterial:
        """Return the material of a row of coefficients and, if known, one of scattering.

        ``name`` is the material's name, ``line`` its line from 1, and ``place`` the place in messages.
        ``row`` and ``scatters`` are the numbers of the text in the bands ``centre_frequencies`` in Hz.
        ``unit`` is the factor from a number to the coefficient, and ``more`` are further fields of the
        material.
        """
        alpha, spans = coefficients(row, place, unit)
        of_scattering = coefficients(scatters or (), place, unit, "scattering")
        return cls(
            name=name,
            line=line,
            alpha=alpha,
            centre_frequencies=tuple(centre_frequencies),
            spans=spans,
            unit=unit,
            scattering=None if scatters is None else of_scattering[0],
            scattering_spans=of_scattering[1],
            **more,
        )

    def in_bands(self, values: Sequence[float], wanted: Array, place: str) -> Array:
        """Return one value per band of this material in other bands; DataError names the place.

        ``values`` has one value per band of the material, ``wanted`` are the other bands' centre
        frequencies in Hz, and ``place`` is the place in messages.
        """
        try:
            return bands.Conversion(self.centre_frequencies, wanted).mean(np.array(values))
        except DataError as error:
            raise DataError(f"{place}: {error}") from error

    def with_decimals(self, decimals: int) -> ListedMaterial:
        """Return the material with its numbers written to these decimals of the coefficient.

        ``decimals`` is the number of decimals of the coefficient from 0 to 1.
        """
        least = 2 if self.unit == 0.01 else 0
        if not least <= decimals <= 15:
            raise DataError(
                f"decimals = {decimals} must be from {least} to 15"
                + (", because the file has at least whole percents" if least else "")
            )
        return replace(self, decimals=decimals - least)

    def rounded(self, alpha: float) -> tuple[str, float]:
        """Return the text of a written number, and the coefficient that is read from it.

        ``alpha`` is the coefficient to write.
        """
        if self.decimals is None:
            return repr(alpha / self.unit), alpha
        text = f"{alpha / self.unit:.{self.decimals}f}"
        return text, coefficient(float(text), self.unit)


@dataclass(frozen=True, kw_only=True)
class MaterialList:
    """Hold the ``materials`` in a simulation program's file, in its order, and the file's ``text``.

    ``path`` is the name of the file in messages. ``aliases`` maps further names of materials to the
    names in the file. ``scattering_text`` is a function that returns the text of scattering
    coefficients, one per band, to write at `ListedMaterial.scattering_place`.
    """

    path: str
    text: Text = field(repr=False)
    materials: tuple[ListedMaterial, ...]
    aliases: Mapping[str, str] = field(default_factory=dict)
    scattering_text: Callable[[Sequence[str]], str] = " ".join

    def __post_init__(self) -> None:
        first: dict[str, int] = {}
        for material in self.materials:
            place = f"{self.path}, line {material.line}: a material's name"
            if not text_name(place, material.name).strip():
                raise DataError(f"{place} has {material.name!r}; a name must not be blank")
            if material.name in first:
                raise DataError(
                    f'{self.path}, line {material.line}: "{material.name}" is given twice, first '
                    f"on line {first[material.name]}"
                )
            first[material.name] = material.line
        if not self.materials:
            raise DataError(f"{self.path}, line 1: the list has no material")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the materials in the file's order, without aliases."""
        return tuple(m.name for m in self.materials)

    def room(
        self,
        *,
        name: str,
        volume: float,
        areas: Mapping[str, float] | Sequence[Surface],
        centre_frequencies: Sequence[float] | None = None,
        sigma_rule: SigmaRule | None = None,
        sigma: Mapping[str, ListedMaterial | float] | None = None,
        scattering: float | None = None,
        others: Mapping[str, ListedMaterial] | None = None,
        air: Air | None = None,
    ) -> Room:
        """Return a room of these materials.

        ``volume`` is in m³. ``areas`` are areas in m² by a material's name or alias, or surfaces, such
        as those of a mesh. ``centre_frequencies`` are the room's bands in Hz; None means the bands that
        all its materials have. ``sigma`` has the known uncertainties of alpha, by material;
        a material's own sigma counts next, and ``sigma_rule`` gives all others (None means max(0.3
        alpha, 0.01)). ``scattering`` is the
        coefficient of materials without one; with None, the room has scattering only if all its
        materials have. ``others`` are materials from another source, by name. ``air`` is the room's
        air; None for air that absorbs nothing.
        """
        if isinstance(areas, Mapping):
            areas = [Surface(n, n, area) for n, area in areas.items()]
        others = others or {}
        used = {s.material: others.get(s.material) or self.listed(s.material) for s in areas}
        if doubts := [m.doubt for m in used.values() if m.doubt]:
            raise DataError(doubts[0])
        if not used:
            raise DataError(
                f"{self.path}: no areas are given; a room needs the area of at least one material"
            )
        if centre_frequencies is None:
            centre_frequencies = _common_bands(used.values())
            if not centre_frequencies:
                raise DataError(f"{self.path}: no band is common to all materials of the room")
        wanted = bands.as_bands(centre_frequencies)
        all_scatter = all(m.scattering is not None or scattering is not None for m in used.values())
        materials = []
        for of, listed in used.items():
            place = f'material "{of}"'
            alpha = listed.in_bands(listed.alpha, wanted, place)
            spread = (sigma_rule or SigmaRule()).sigma(alpha, wanted)
            stated = (sigma or {}).get(of, listed.sigma)
            if isinstance(stated, ListedMaterial):
                spread = stated.in_bands(stated.alpha, wanted, f"sigma of {place}")
            elif stated is not None:
                spread = np.full(len(wanted), stated)
            scatters = None
            if all_scatter:
                rows = listed.scattering or (scattering,) * len(listed.centre_frequencies)
                scatters = listed.in_bands(rows, wanted, place).tolist()  # type: ignore[arg-type]
            source = listed.source or self.path
            materials.append(Material(of, alpha.tolist(), spread.tolist(), 0.0, scatters, source))
        return Room.from_surfaces(
            name=name,
            volume=volume,
            surfaces=list(areas),
            materials=materials,
            centre_frequencies=wanted,
            air=air,
        )

    def listed(self, name: str) -> ListedMaterial:
        """Return the material of a name or alias; DataError if the list has none."""
        target = self.aliases.get(name, name)
        for material in self.materials:
            if material.name == target:
                return material
        names = ", ".join([*self.names, *self.aliases])
        raise DataError(f'"{name}" is not a material of {self.path}, which has {names}')

    def with_entries(self, entries: Mapping[str, str], room: Room) -> MaterialList:
        """Return the list with other names for a room's materials; see `rtcal.io.catt.write`.

        ``entries`` maps names of the ``room``'s materials to names or aliases in the list.
        """
        if unknown := [name for name in entries if name not in room.materials]:
            raise DataError(
                f'entries: "{unknown[0]}" is not a material of the room, which has '
                f"{', '.join(room.materials)}"
            )
        names = {name: self.listed(entry).name for name, entry in entries.items()}
        listed = replace(self, aliases={**self.aliases, **names}).with_spellings(room.materials)
        there = {*listed.names, *listed.aliases}
        if missing := [name for name in room.materials if name not in there]:
            raise DataError(
                f'"{missing[0]}" is not a material of {self.path}, which has '
                f"{', '.join(listed.names)}. Name the one that is meant: "
                f'entries={{"{missing[0]}": "NAME"}}'
            )
        return listed

    def with_spellings(self, names: Iterable[str]) -> MaterialList:
        """Return the list with aliases for ``names`` that it has with blanks in place of underscores.

        Exporters of meshes write ``ceiling_plaster`` for "ceiling plaster", or the reverse.
        """
        there = {*self.names, *self.aliases}
        aliases = dict(self.aliases)
        for name in names:
            spelt = name.replace("_", " ").split()
            alike = {self.listed(n).name for n in there if n.replace("_", " ").split() == spelt}
            if name not in there and len(alike) == 1:
                aliases[name] = alike.pop()
        return replace(self, aliases=aliases)

    def with_room(self, room: Room) -> tuple[bytes, Room, tuple[str, ...]]:
        """Return the file with a room's coefficients, the room as a program reads it, and omissions.

        The omissions are the names of materials for which the file can have no scattering; if there is
        one, the room as it is read has no scattering at all. Octaves of the file get the means of the
        room's third-octaves, and third-octaves the value of their octave. A number is replaced only if
        the coefficient, rounded to the file's decimals, differs from it.
        """
        common = _common_bands(map(self.listed, room.materials))
        if common and bands.rule(room.centre_frequencies, common, "alpha"):  # of another width
            obtainable = bands.obtainable(room.centre_frequencies, common)
            room = room.in_bands(obtainable) if obtainable.size else room
        shared = [f for f in room.centre_frequencies if f in common]
        if not shared:
            raise DataError(
                f"{self.path}: none of the room's bands, "
                f"{', '.join(bands.labels(room.centre_frequencies))}, "
                "is one of all its materials in the list"
            )
        asked: dict[Span, tuple[float | str, str]] = {}
        written: dict[Span, str] = {}

        def put(span: Span, value: float | str, place: str, characters: str | None) -> None:
            """Write characters for a value; DataError if another name of the material has another."""
            before, first = asked.setdefault(span, (value, place))
            if before != value:
                raise DataError(
                    f"{place} = {value}, but {first} has {before}, and both are the same entry of the "
                    "list: give one of them an entry of its own in the program"
                )
            if characters is not None:
                written[span] = characters

        stated = {"alpha": room.alpha, "scattering": room.scattering}
        tables = {name: np.array(table) for name, table in stated.items() if table is not None}
        lacking = list[str]()
        for i, name in enumerate(room.materials):
            material = self.listed(name)
            columns = [bands.index(room.centre_frequencies, f) for f in material.centre_frequencies]
            for quantity, table in tables.items():
                spans, values, at = material.spans, material.alpha, material.scattering_place
                if quantity == "scattering":
                    spans, values = material.scattering_spans, material.scattering or ()
                if not spans:
                    in_room = [k for k in columns if k is not None]
                    if at is None or len(in_room) < len(columns):
                        lacking.append(name)
                        continue
                    rounded = [material.rounded(float(table[i, k])) for k in in_room]
                    inserted = self.scattering_text([characters for characters, _ in rounded])
                    put((at, at), inserted, f'{self.path}: scattering["{name}"]', inserted)
                    table[i, in_room] = [value for _, value in rounded]
                for k, span, before in zip(columns, spans, values, strict=bool(spans)):
                    if k is None:
                        continue
                    characters, as_read = material.rounded(value := float(table[i, k]))
                    same = before in (value, as_read)
                    place = f"{self.path}: {room.place(quantity, i, k)}"
                    put(span, value, place, None if same else characters)
                    table[i, k] = before if same else as_read
        scattering = None if lacking else tables.get("scattering")
        room_as_read = room.replace(alpha=tables["alpha"], scattering=scattering)
        if len(shared) < room.n_bands:
            room_as_read = room_as_read.in_bands(shared)
        changed = _edited(self.text.characters, written)
        return self.text.encode(changed), room_as_read, tuple(lacking)


def _common_bands(materials: Iterable[ListedMaterial]) -> list[float]:
    """Return the bands in Hz that all materials have."""
    return sorted(set.intersection(*(set(m.centre_frequencies) for m in materials)))


def _edited(text: str, changes: Mapping[Span, str]) -> str:
    """Return a text with other characters at some positions."""
    pieces, position = list[str](), 0
    for (start, end), characters in sorted(changes.items()):
        pieces += [text[position:start], characters]
        position = end
    return "".join([*pieces, text[position:]])


def coefficient(value: float, unit: float) -> float:
    """Return the coefficient for a number in a file.

    Percent are divided by 100, so that 7 gives exactly the float 0.07.
    """
    return value / round(1 / unit) if unit < 1 else value


def tokens(pattern: str, text: str, start: int) -> list[Token]:
    """Return the matches of a pattern in a part of a file's text that begins at position ``start``."""
    return [(m[0], start + m.start(), start + m.end()) for m in re.finditer(pattern, text)]


def numbers(row: Sequence[Token], place: str) -> tuple[float, ...]:
    """Return the numbers of a row; DataError, which names ``place``, for a text that is no number."""
    return tuple(number(token, place) for token, _, _ in row)


def coefficients(
    row: Sequence[Token], place: str, unit: float = 1.0, name: str = "alpha"
) -> tuple[tuple[float, ...], tuple[Span, ...]]:
    """Return the coefficients of a row, and the start and end of each number in the file's text."""
    values = numbers(row, place)
    for value in values:
        if not 0 <= coefficient(value, unit) <= 1:
            hint = above_one_hint(coefficient(value, unit)) if name == "alpha" else ""
            instead = f". In this list write {1 / unit:g} for it" if hint else ""
            raise DataError(
                f"{place}: {name} {value:g} must be from 0 to {1 / unit:g}{hint}{instead}"
            )
    spans = tuple((start, end) for _, start, end in row)
    return tuple(coefficient(value, unit) for value in values), spans


MOST_NAMED = 5
RECORD = "the record of the calibration"
LOST = {
    "name": "name",
    "author": "author",
    "areas and volume": "areas volume surfaces dimensions",
    "sigma": "sigma",
    "uncertainties of areas, volume and climate": "area_sigma volume_sigma common_area_sigma "
    "common_alpha_sigma climate_sigma",
    "alpha_min": "alpha_min",
    "correlations": "band_correlation material_correlation",
    "what scattering means": "scattering_model",
    "air": "air",
    "where coefficients are from": "sources",
    "coefficients that were above 1": "clipped",
    RECORD: "calibration",
    "mesh": "scene.mesh",
    "sources and receivers": "scene.sources",
    "directivity of sources": "scene.directivity",
    "uncertainty of positions": "scene.position_uncertainty",
    "names of surfaces": "scene.surfaces",
}
"""Properties of a room that no material list holds, in words, with the room's fields."""


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """Hold a room as a program reads it from a written material list, and the effect of rounding on T.

    ``template`` is the list whose numbers were changed; None for a new list. ``room`` is the exported
    room in the file's bands. ``reverberation_time`` (n_bands,) is T of ``room`` in s by ``equation``,
    and ``reverberation_time_as_read`` that of the room as the program reads it. ``bands_not_written``
    are bands of the room in Hz that the file does not have for every material. ``lost`` are properties
    of the room that the file cannot hold.

    ``path`` is the written file, and ``notes`` are cautions, one sentence each.
    """

    path: str
    template: str | None
    equation: str
    room: Room
    reverberation_time: Array
    reverberation_time_as_read: Array
    bands_not_written: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()

    @property
    def change(self) -> Array:
        """Change of T in JND by the conversion to the file's bands and decimals, (n_bands,)."""
        return marks.gap_jnd(self.reverberation_time_as_read, self.reverberation_time)

    def __str__(self) -> str:
        if self.template is None:
            done = f"{self.path} is a new list"
        elif self.template == self.path:
            done = f"The coefficients in {self.path} were replaced"
        else:
            done = f"{self.path} is {self.template} with its coefficients replaced"
        if np.isfinite(self.change).any():
            done += (
                f". As the program reads them (rounded, in its bands), T by {self.equation}'s equation "
                f"changes by at most {np.nanmax(np.abs(self.change)):.2f} JND"
            )
        cells = [
            [f"{before:.4f}", f"{after:.4f}", text.number(change, "+.2f")]
            for before, after, change in zip(
                self.reverberation_time, self.reverberation_time_as_read, self.change, strict=True
            )
        ]
        names = bands.labels(self.room.centre_frequencies)
        rows = [
            *text.wrapped(f"{done}."),
            *text.table(
                [*zip(names, cells, strict=True)],
                header=("band", ["T / s", "T as read / s", "change / JND"]),
            ),
        ]
        if self.bands_not_written:
            missing = ", ".join(bands.labels(self.bands_not_written))
            rows.append(f"The file does not have the bands {missing}, so they are not written.")
        lost = f"The file cannot hold {', '.join(self.lost)}: keep the room's file, too."
        again = (
            "Do not calibrate a room made of this file to the same measurement again: that would "
            "count the measurement twice, and rtcal could not notice."
        )
        for note in (*self.notes, lost, *[again] * (RECORD in self.lost)):
            rows += text.wrapped(text.as_sentence(note))
        return "\n".join(rows)


@dataclass(frozen=True, kw_only=True)
class Format:
    """Read and write the material lists of one simulation program, with `read` and `write`.

    `rtcal.io.catt`, `odeon`, `pyroomacoustics` and `bras` are the formats that rtcal has. The
    fields are the functions in which formats differ.
    """

    parse: Callable[..., MaterialList]
    """Function of a file's content, its path, and further arguments of `read`: the materials in it."""
    new: Callable[[Room, Sequence[str]], bytes]
    """Function of a room and its materials' names in the list: the content of a new list."""
    bands: Callable[[Room], Sequence[float]] = lambda _: ()
    """Function of a room: the bands in Hz of a new list, () for the room's own."""
    readable: Callable[[str], str] = str
    """Function of a material's name: the name that the program can read."""
    prepared: Callable[[MaterialList, Room], MaterialList] = lambda listed, _: listed
    """Function of a list and a room: the list with the changes that are needed before it is written."""

    def read(self, path: str | os.PathLike[str], **selected: Any) -> MaterialList:
        """Return the materials of a program's file.

        ``selected`` are further arguments of this format, such as ``where`` for BRAS. Raises DataError,
        which names the file, the line and the rule.
        """
        content = read_bytes(path, MAX_TEXT)
        try:
            return self.parse(content, os.fspath(path), **selected)
        except DataError as error:
            if kind := _kind(content, path, self):
                raise DataError(f"{error}. The file is {kind}") from error
            raise

    def write(
        self,
        room: Room,
        path: str | os.PathLike[str],
        *,
        template: str | os.PathLike[str] | None = None,
        equation: LinearEquation | None = None,
        decimals: int | None = None,
        missing_bands: str = "refuse",
        entries: Mapping[str, str] | None = None,
        **selected: Any,
    ) -> ExportReport:
        """Write a room's coefficients into a program's material list, and return a report on it.

        The list is a copy of ``template``, or of the existing file at ``path``, in which only the
        numbers of alpha and scattering that change are replaced. Without either, a new list is written.

        Raises DataError for a material that the file does not have, and for a file that cannot be read
        or written.

        Parameters
        ----------
        room : Room
            Room whose coefficients are written.
        path, template : path
            Paths of the list to write, and of the list whose text is kept.
        equation : LinearEquation, optional
            Reverberation equation with which the report shows the effect of rounding on T; by default
            Eyring's.
        decimals : int, optional
            Number of decimals of a coefficient, 3 for a tenth of a percent; by default that of the
            format.
        missing_bands : {"refuse", "nearest"}
            What to do if the room lacks a band that a new list needs: raise an error, or write the
            coefficients of the nearest band.
        entries : mapping of str to str, optional
            Names in the file of materials that have another name there, by the name in the room.
        selected
            Further arguments of this format, as for `read`.
        """
        whole = checks.instance("room", room, Room)
        room = whole.without_pieces
        checks.choice("missing_bands", missing_bands, ("refuse", "nearest"))
        entries = checks.text_by_name("entries", entries)
        equation = Eyring() if equation is None else equation
        checks.instance("equation", equation, LinearEquation)
        if decimals is not None:
            decimals = checks.whole("decimals", decimals, 0)
        notes: list[str] = []
        if template is None and checks.path("path", path).exists():
            template = path
        if template is not None:
            listed = self.prepared(self.read(template, **selected), room)
        else:
            in_new_bands, notes = _in_new_bands(
                room, self.bands(room), missing_bands, os.fspath(path)
            )
            taken = {entries.get(name, name) for name in room.materials}
            renamed: dict[str, str] = {}
            for i, name in enumerate(room.materials):
                new = self.readable(name)
                if name in entries or new == name:
                    continue
                while new in taken:
                    new = f"{new}_{i + 1}"
                taken.add(new)
                renamed[name] = new
            entries |= renamed
            names = [entries.get(name, name) for name in room.materials]
            if renamed:
                pairs = [f'"{name}" is {new}' for name, new in renamed.items()]
                some = text.first_of(pairs, MOST_NAMED)
                notes.append(f"names are changed to those that the program reads: {some}")
            in_file = in_new_bands.replace(materials=names, surfaces=())
            listed = self.parse(self.new(in_file, room.materials))
        listed = listed.with_entries(entries, room)
        if decimals is not None:
            rounded = tuple(m.with_decimals(decimals) for m in listed.materials)
            listed = replace(listed, materials=rounded)
        content, as_read, lacking = listed.with_room(room)
        notes += _without_measured_time(whole, equation)
        if whole.pieces:
            notes.append(
                f"The list has surfaces alone, and T is without {', '.join(whole.pieces)}: draw what "
                "stands for them in the program"
            )
        time = equation.reverberation_time(room)
        between = room.centre_frequencies, as_read.centre_frequencies
        rule = bands.rule(*between, "alpha")
        if rule:
            time = bands.Conversion(*between).mean(time, TARGET.averaging)
            notes.append(f"{rule}; T of the room by the mean of 1/T")
        else:
            time = time[np.isin(*between)]
        time_as_read = equation.reverberation_time(as_read)
        write_bytes(path, content)
        if template is not None:
            notes += _replaced_scattering(listed, self.prepared(self.read(path, **selected), room))
        return ExportReport(
            path=os.fspath(path),
            template=None if template is None else os.fspath(template),
            equation=equation.name,
            room=as_read,
            reverberation_time=time,
            reverberation_time_as_read=time_as_read,
            bands_not_written=tuple(map(float, bands.unused(*between))),
            notes=tuple(notes),
            lost=(*_lost(room, lacking), *(["[[object]]"] if whole.pieces else [])),
        )


def _kind(content: bytes, path: str | os.PathLike[str], tried: Format) -> str:
    """Return what a file is that is no list of the format that was tried; "" if that is not known."""
    for name, other in {"catt": catt, "odeon": odeon, "pyroomacoustics": pyroomacoustics}.items():
        if other is not tried:
            with suppress(DataError):
                other.parse(content)
                return f"a list of {name}: `rtcal import {name}` reads it"
    if re.search(rb"(?m)^usemtl ", content):
        return "a mesh: give it as --mesh, beside the list of its materials"
    if tried is not bras and content.startswith(b"material,"):
        return "a table of bras: `rtcal import bras` reads it"
    found = kind_of(path)
    return "" if tried is bras and found == TABLE else found


def _replaced_scattering(listed: MaterialList, as_written: MaterialList) -> tuple[str, ...]:
    """Return a note on the materials of a changed list that have another scattering now."""
    after = {m.name: m.scattering for m in as_written.materials}
    changed = [
        f"{m.name} ({np.mean(m.scattering):.2f}, now {np.mean(now):.2f})"
        for m in listed.materials
        if m.scattering is not None
        and (now := after.get(m.name)) is not None
        and now != m.scattering
    ]
    if not changed:
        return ()
    return (
        "The room's scattering replaced the list's, which a fit to positions changes too. Means over "
        f"the bands: {text.first_of(changed, MOST_NAMED)}",
    )


def _without_measured_time(room: Room, equation: LinearEquation) -> list[str]:
    """Return a note where a calibrated room lacks the T that it was calibrated to, by half a JND."""
    if room.calibration is None or room.calibration.equation != equation.name:
        return []
    gap = marks.gap_jnd(equation.reverberation_time(room), times_of(room))
    left = np.abs(gap) >= marks.MET
    if not left.any():
        return []
    each = ", ".join(
        f"{bands.label(f)} {g:+.1f} JND"
        for f, g in zip(room.centre_frequencies[left], gap[left], strict=True)
    )
    return [
        f"The room as exported does not have the measured T ({each}). The calibration left this gap, "
        "as to an uncertain volume: see its page before you simulate"
    ]


def _lost(room: Room, lacking: Sequence[str]) -> tuple[str, ...]:
    """Return what a room states and no list of materials holds, after ``lacking`` scattering."""

    def is_stated(owner: Any, name: str) -> bool:
        first, _, rest = name.partition(".")
        value = getattr(owner, first)
        if rest:
            return is_stated(value, rest)
        if isinstance(value, np.ndarray):
            return bool(value.any())
        return bool(value) and value != {f.name: f.default for f in fields(owner)}[name]

    of = "" if len(lacking) == room.n_materials else f" of {', '.join(lacking)}"
    return (
        *((f"scattering{of}",) if lacking else ()),
        *(words for words, names in LOST.items() if any(is_stated(room, n) for n in names.split())),
    )


def _in_new_bands(
    room: Room, needed: Sequence[float], missing_bands: str, path: str
) -> tuple[Room, list[str]]:
    """Return the room in the bands of a new file, with notes on bands that were filled."""
    if not needed:
        return room, []
    obtainable = bands.obtainable(room.centre_frequencies, needed)
    missing = [f for f in needed if f not in obtainable]
    if missing and (missing_bands == "refuse" or not obtainable.size):
        raise DataError(
            f"{path}: a new list of this program needs {bands.label(missing[0])}, which "
            "the room does not have. Write into an existing list instead, or use "
            'missing_bands="nearest"'
        )
    converted = room.in_bands(obtainable)
    nearest = {f: int(np.argmin(np.abs(np.log(obtainable / f)))) for f in needed}
    notes = list[str]()
    for k in dict.fromkeys(nearest[f] for f in missing):
        lacking = bands.hertz([f for f in missing if nearest[f] == k])
        notes.append(
            f"at {lacking}, which the room does not have, alpha is that at {bands.label(obtainable[k])}"
        )
    tables = {n: getattr(converted, n) for n in ("alpha", "sigma", "alpha_min", "scattering")}
    return converted.replace(
        centre_frequencies=np.asarray(needed),
        **{n: t[:, [*nearest.values()]] for n, t in tables.items() if t is not None},
    ), notes


__all__ = ["bras", "catt", "dictionaries", "odeon", "pyroomacoustics", "read_sigma"]
__dir__ = __all__.copy

_OCTAVES = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
_OF_CATT, _OF_ODEON = _OCTAVES[1:], _OCTAVES[:8]
_DECIMALS = {"catt": 1, "odeon": 5, "bras": 3}
"""Decimals of a written number; of CATT's of a percentage, and its fractions (ABS1) get two more."""

# -- CATT-Acoustic: ABS name = <6 to 8 percents> L <scattering> {r g b} ; rtcal: "name in the room"

_NAME = r"[^\s=<>{};:]+"
_STATEMENT = re.compile(rf"[ \t]*(?:(ABS1?)[ \t]+)?({_NAME})[ \t]*=[ \t]*(.*)", re.I | re.S)
_NO_STATEMENT = re.compile(r"[ \t]*ABS1?(?![^\s=<>])", re.I)
_VALUES = re.compile(
    r"<([^<>]*)>[ \t]*(?:L[ \t]*<([^<>]*)>[ \t]*)?(?:\{(?:[ \t]*\d{1,3}\b){3}[ \t]*\}[ \t]*)?",
    re.I | re.ASCII,
)
_COUNTS = ([6], [7], [8], [6, 0], [6, 1], [6, 2])
"""Numbers of values before and after the colon, which stands before the octaves of 8 and 16 kHz."""
_OF_ROOM = re.compile(r'[ \t]*rtcal:[ \t]*("(?:[^"\\]|\\u[0-9a-f]{4}|\\["\\])+")[ \t]*', re.ASCII)
"""Comment of a statement whose material has a name in the room that CATT does not read, as JSON."""


def _parse_catt(content: bytes, path: str = "CATT file") -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule."""
    text = decode(content, path)
    aliases: dict[str, tuple[str, int]] = {}
    of_room: dict[str, str] = {}
    listed: list[ListedMaterial] = []
    for line, start, match, own in _statements(text.characters, path):
        place, (_, name, value) = f"{path}, line {line}", match.groups()
        if value.startswith("<"):
            listed.append(_of_statement(match, start, line, place))
            if own not in ("", name):
                of_room[name] = own
        elif not re.fullmatch(_NAME, value):
            raise DataError(
                f'{place}: "{shown(value)}" is neither <6 to 8 values> nor another name'
            )
        elif name in aliases:
            raise DataError(f'{place}: "{name}" is given twice')
        else:
            aliases[name] = (value, line)
    names = {material.name for material in listed}
    for name, (target, line) in aliases.items():
        if name in names:
            raise DataError(f'{path}, line {line}: "{name}" is given twice')
        if target not in names:
            raise DataError(
                f'{path}, line {line}: "{name}" refers to "{target}", which must be a material '
                "of the file with values of its own"
            )
    every = {name: target for name, (target, _) in aliases.items()} | {n: n for n in of_room}
    return MaterialList(
        path=path,
        text=text,
        materials=tuple(replace(m, name=of_room.get(m.name, m.name)) for m in listed),
        aliases={name: of_room.get(target, target) for name, target in every.items()},
        scattering_text=lambda values: f" L <{_in_groups(values)}>",
    )


def _statements(characters: str, path: str) -> Iterator[tuple[int, int, re.Match[str], str]]:
    """Yield the line and the start of each ABS statement, its keyword, name and value, and a name.

    The last is the material's name in the room that the list was written for, "" where it is the same.
    """
    for line, start, raw in lines(characters):
        code, _, comment = raw.partition(";")
        code = code.rstrip()
        match = _STATEMENT.fullmatch(code)
        if match and (match[1] is not None or match[3].startswith("<")):
            own = _OF_ROOM.fullmatch(comment)
            yield line, start, match, json.loads(own[1]) if own else ""
        elif _NO_STATEMENT.match(code):
            raise DataError(
                f'{path}, line {line}: "{shown(code)}" is not an ABS statement; write ABS '
                "name = <6 to 8 values>"
            )


def _of_statement(match: re.Match[str], start: int, line: int, place: str) -> ListedMaterial:
    """Return the material of a statement of a line that begins at position ``start``."""
    keyword, name, value = match.groups()
    in_percent = (keyword or "ABS").upper() == "ABS"
    found = _VALUES.fullmatch(value)
    if not found:
        raise DataError(
            f'{place}: "{shown(value)}" must be <6 to 8 values>; L <as many values>, the scattering, '
            "and a colour {r g b} may follow"
        )
    offset = start + match.start(3)
    rows = [
        _of_octaves(of, offset + found.start(k), place)
        for k, of in enumerate(found.groups(), 1)
        if of is not None
    ]
    if len({*map(len, rows)}) > 1:
        raise DataError(
            f"{place}: {len(rows[0])} values of absorption, but {len(rows[1])} of scattering; give "
            "the same number of both"
        )
    percents = numbers(rows[0], place)
    at_most_one = in_percent and 0 < max(percents) <= 1
    doubt, note = "", f"{place}: at most 1 %, since ABS is in percent"
    if at_most_one and any(percent != int(percent) for percent in percents):
        written, start_of_it = shown(found[1], 80), f"ABS1 {shown(name)} ="
        fractions = " ".join(f"{percent / 100:g}" for percent in percents)
        doubt = (
            f'{place}: "{shown(name)} = <{written}>" is at most 1 %, since ABS is in percent; write '
            f'"{start_of_it} <{written}>" if the values are fractions, or '
            f'"{start_of_it} <{fractions}>" if they are percents'
        )
    return ListedMaterial.of(
        name,
        line,
        place,
        _OF_CATT[: len(percents)],
        rows[0],
        rows[1] if len(rows) > 1 else None,
        unit=0.01 if in_percent else 1.0,
        decimals=_DECIMALS["catt"] + (0 if in_percent else 2),
        scattering_place=offset + found.end(1) + 1,
        source=note if at_most_one else "",
        doubt=doubt,
    )


def _of_octaves(characters: str, start: int, place: str) -> list[Token]:
    """Return the numbers of a list in a text, which begins at position ``start``."""
    row = tokens(r"[^\s:]+", characters, start)
    numbers(row, place)
    if [len(part.split()) for part in characters.split(":")] not in _COUNTS:
        raise DataError(
            f"{place}: {len(row)} values, but 6 to 8 are needed, for the octaves from 125 Hz, and a "
            "colon only after the sixth"
        )
    return row


def _with_own_values(listed: MaterialList, room: Room) -> MaterialList:
    """Return the list with own values for each alias whose coefficients the room has otherwise."""
    aliases = {n: t for n, t in listed.aliases.items() if n in room.materials}
    tables = [room.alpha] if room.scattering is None else [room.alpha, room.scattering]
    rows = {n: np.hstack([t[i] for t in tables]) for i, n in enumerate(room.materials)}
    statements = {
        of_room or match[2]: (start, match)
        for _, start, match, of_room in _statements(listed.text.characters, "")
    }
    own: dict[Span, str] = {}
    for name, target in aliases.items():
        others = (row for n, row in rows.items() if target in (n, aliases.get(n)))
        if name in statements and any((row != rows[name]).any() for row in others):
            (start, match), (_, of) = statements[name], statements[target]
            own[start + match.start(1), start + match.end(3)] = f"{of[1] or 'ABS'} {name} = {of[3]}"
    if not own:
        return listed
    return _parse_catt(listed.text.encode(_edited(listed.text.characters, own)), listed.path)


def _bands_of_new_catt(room: Room) -> tuple[float, ...]:
    """Return the octaves 125 Hz to 4 kHz, and 8 and 16 kHz if the room has them."""
    obtainable = bands.obtainable(room.centre_frequencies, _OF_CATT)
    n_bands = next((i for i in (6, 7) if _OF_CATT[i] not in obtainable), 8)
    return _OF_CATT[:n_bands]


def _new_catt(room: Room, own: Sequence[str]) -> bytes:
    def percents(row: Array) -> str:
        return _in_groups([f"{100 * value:.{_DECIMALS['catt']}f}" for value in row])

    rows = ["; Absorption, %, in octaves from 125 Hz; written by rtcal"]
    for i, (name, of_room) in enumerate(zip(room.materials, own, strict=True)):
        if not re.fullmatch(_NAME, name) or not name.isascii():
            raise DataError(
                f'material "{name}": a name for CATT-Acoustic must be ASCII without spaces and '
                "without = < > { } ; :"
            )
        scattering = "" if room.scattering is None else f" L <{percents(room.scattering[i])}>"
        comment = "" if of_room == name else f" ; rtcal: {json.dumps(of_room)}"
        rows.append(f"ABS {name} = <{percents(room.alpha[i])}>{scattering}{comment}")
    return ("\r\n".join(rows) + "\r\n").encode("ascii")


def _in_groups(texts: Sequence[str]) -> str:
    """Return the numbers of a list, with a colon before 8 kHz."""
    return " ".join(texts[:6]) + (" : " + " ".join(texts[6:]) if texts[6:] else "")


catt = Format(
    parse=_parse_catt,
    new=_new_catt,
    bands=_bands_of_new_catt,
    readable=lambda name: re.sub(r"[^!-~]|[=<>{};:]", "_", name),
    prepared=_with_own_values,
)
"""Format of CATT-Acoustic's geometry files (``.GEO``) and material lists, with their ABS lines."""

# -- ODEON: a number and a description, then a line with the octaves 63 Hz to 8 kHz

_LARGEST_NUMBER = 2**31 - 1
_HEAD = re.compile(r"[ \t]*(\d{1,10})[ \t]+(\S(?:.*\S)?)[ \t]*", re.ASCII)


def _parse_odeon(content: bytes, path: str = "ODEON file") -> MaterialList:
    """Return the materials of a library's content. DataError names file, line and rule."""
    text = decode(content, path)
    rows = [row for row in lines(text.characters) if row[2].strip()]
    materials: list[ListedMaterial] = []
    names: dict[int, str] = {}
    for (line, _, raw), values in zip_longest(rows[::2], rows[1::2]):
        place, head = f"{path}, line {line}", _HEAD.fullmatch(raw)
        if head is None or int(head[1]) > _LARGEST_NUMBER:
            raise DataError(
                f'{place}: "{shown(raw)}" must be a number, up to {_LARGEST_NUMBER}, and a description'
            )
        if int(head[1]) in names:
            raise DataError(f"{place}: number {int(head[1])} is given twice")
        n, start, characters = values or (line, 0, "")
        row = tokens(r"\S+", characters, start)
        if len(row) != len(_OF_ODEON):
            raise DataError(
                f"{path}, line {n}: a description must be followed by a line of 8 values, for the "
                f"octaves 63 Hz to 8 kHz, but this has {len(row)}"
            )
        names[int(head[1])] = head[2]
        name, place = f"{int(head[1])} {head[2]}", f"{path}, line {n}"
        decimals = _DECIMALS["odeon"]
        materials.append(ListedMaterial.of(name, line, place, _OF_ODEON, row, decimals=decimals))
    times = Counter(names.values())
    aliases = {name: f"{n} {name}" for n, name in names.items() if times[name] == 1}
    return MaterialList(path=path, text=text, materials=tuple(materials), aliases=aliases)


def _new_odeon(room: Room, *_: object) -> bytes:
    """Return a new library; names without a number get numbers from 10001 on."""
    rows = []
    for i, name in enumerate(room.materials):
        if not (name.isprintable() and name.strip() == name and name):
            raise DataError(f"material {name!r}: an ODEON description must be one line of text")
        numbered = re.match(r"\d{1,10} \S", name, re.ASCII)
        rows.append(name if numbered else f"{10001 + i} {name}")
        rows.append("\t" + "\t".join(f"{a:.{_DECIMALS['odeon']}f}" for a in room.alpha[i]))
    return Text("", codec="cp1252").encode("\r\n".join(rows) + "\r\n")


odeon = Format(parse=_parse_odeon, new=_new_odeon, bands=lambda _: _OF_ODEON)
"""Format of ODEON's material list (``.Li8``), with the octaves from 63 to 8000 Hz."""

# -- pyroomacoustics: objects with "coeffs", their "center_freqs" or those of the outermost object

_COEFFS = re.compile(r'"coeffs"\s*:\s*\[([^\]\[{}]*)\]')


def _parse_pyroomacoustics(content: bytes, path: str = "JSON file") -> MaterialList:
    """Return the materials of a JSON file's content; DataError names the line and the rule."""
    text = decode(content, path)
    whole, entries = _json(text.characters, path)
    of_file = whole.get("center_freqs") if isinstance(whole, dict) else None
    rows = [*_COEFFS.finditer(text.characters)]
    if len(rows) != len(entries):
        raise DataError(f'{path}, line 1: each "coeffs" must be one list of numbers')
    found: dict[bool, list[ListedMaterial]] = {True: [], False: []}
    for match, (keys, entry) in zip(rows, entries, strict=True):
        row = tokens(r"[^\s,]+", match[1], match.start(1))
        if not row:
            continue
        line = text.characters.count("\n", 0, row[0][1]) + 1
        place, of_scattering = f"{path}, line {line}", keys[:1] == ("scattering",)
        coefficients(row, place, name="scattering" if of_scattering else "alpha")
        centres = entry.get("center_freqs", of_file)
        if not isinstance(centres, list) or not centres:
            raise DataError(f"{place}: these coefficients have no center_freqs")
        of_bands = numbers([(json.dumps(value), 0, 0) for value in centres], place)
        frequencies = bands.as_bands(of_bands, f"{place}: center_freqs")
        # In pyroomacoustics, a shorter list begins at the lowest band of its data base.
        shorter = "center_freqs" not in entry and len(row) < len(frequencies)
        if len(row) != len(frequencies) and not shorter:
            raise DataError(
                f"{place}: {len(row)} coefficients, but {len(frequencies)} center_freqs; "
                "give the same number of both"
            )
        name, its = keys[-1] if keys else "material", frequencies[: len(row)].tolist()
        found[of_scattering].append(ListedMaterial.of(name, line, place, its, row))
    scattering: dict[tuple[str, tuple[float, ...]], ListedMaterial] = {}
    for of in found[True]:
        scattering.setdefault((of.name, of.centre_frequencies), of)
    materials = []
    for of in found[False]:
        if own := scattering.get((of.name, of.centre_frequencies)):
            of = replace(of, scattering=own.alpha, scattering_spans=own.spans)
        materials.append(of)
    return MaterialList(path=path, text=text, materials=tuple(materials))


def _json(text: str, path: str) -> tuple[Any, list[tuple[tuple[str, ...], dict[str, Any]]]]:
    """Return what a JSON text holds, and each object with a list ``coeffs`` with its keys, in order."""
    found: list[tuple[tuple[str, ...], dict[str, Any]]] = []

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if twice := [key for key, times in Counter(k for k, _ in pairs).items() if times > 1]:
            raise DataError(f'{path}, line 1: the key "{shown(twice[0])}" is given twice')
        return dict(pairs)

    def search(value: Any, keys: tuple[str, ...]) -> None:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            if key == "coeffs" and isinstance(inner, list):
                found.append((keys, value))
            elif isinstance(inner, (dict, list)):
                search(inner, (*keys, str(key)))

    try:
        whole = json.loads(text, object_pairs_hook=once)
        if isinstance(whole, (dict, list)):
            search(whole, ())
    except RecursionError as error:
        raise DataError(f"{path}, line 1: its objects are nested too deeply") from error
    except ValueError as error:
        line = getattr(error, "lineno", 1)
        raise DataError(f"{path}, line {line}: not valid JSON: {error}") from error
    return whole, found


def dictionaries(room: Room) -> dict[str, dict[str, Any]]:
    """Return the arguments of ``pyroomacoustics.Material`` by material; the library is not imported."""
    frequencies = [float(f) for f in room.centre_frequencies]
    tables = {"energy_absorption": room.alpha, "scattering": room.scattering}
    return {
        name: {
            key: {
                "description": name,
                "coeffs": [float(value) for value in table[i]],
                "center_freqs": frequencies,
            }
            for key, table in tables.items()
            if table is not None
        }
        for i, name in enumerate(room.materials)
    }


def _new_pyroomacoustics(room: Room, *_: object) -> bytes:
    content: dict[str, Any] = {"center_freqs": [float(f) for f in room.centre_frequencies]}
    group = "Input" if room.calibration is None else "Calibrated"
    for name, of_material in dictionaries(room).items():
        for key, entry in of_material.items():
            of_key = content.setdefault(key.removeprefix("energy_"), {group: {}})
            of_key[group][name] = entry
    return (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode("utf-8")


pyroomacoustics = Format(parse=_parse_pyroomacoustics, new=_new_pyroomacoustics)
"""Format of the material tables of pyroomacoustics (JSON)."""

# -- BRAS: rows of frequencies, absorption and scattering; or a table with the column "material"

_MAX_COLUMNS = 100


def _parse_bras(
    content: bytes, path: str = "BRAS file", *, where: Mapping[str, str] | None = None
) -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule."""
    text, where = decode(content, path), checks.text_by_name("where", where)
    (place, _, header), *rows = _rows_of(text, path)
    names, decimals = [name for name, *_ in header], _DECIMALS["bras"]
    columns = [i for i, name in enumerate(names) if re.match(r"[\d.]", name)]
    is_table = len(columns) < len(header)
    for wanted in ("material", *where) if is_table else ():
        if names.count(wanted) != 1:
            raise DataError(f'{place}: column "{shown(wanted)}" must occur exactly once')
    # Frequencies in the published tables are off by up to 3 %.
    stated = numbers([header[i] for i in columns], place)
    nominal = [nearest_band(f) or f if f > 0 else f for f in stated]
    frequencies = tuple(map(float, bands.as_bands(nominal, f"{place}: frequencies")))
    if is_table:
        materials = [
            ListedMaterial.of(
                cells[names.index("material")][0],
                line,
                of_row,
                frequencies,
                [cells[i] for i in columns],
                decimals=decimals,
            )
            for of_row, line, cells in rows
            if all(cells[names.index(column)][0] == entry for column, entry in where.items())
        ]
        if not materials:
            raise DataError(f"{place}: no row fits the selection (where)")
        return MaterialList(path=path, text=text, materials=tuple(materials))
    if where or not 1 <= len(rows) <= 2:
        raise DataError(
            f"{place}: has {1 + len(rows)} rows of numbers; give 2 or 3: frequencies, absorption and, "
            'if known, scattering; where selects from a table with a column "material" alone'
        )
    (of_row, line, row), scatters = rows[0], rows[1][2] if len(rows) > 1 else None
    material = ListedMaterial.of(
        Path(path).stem, line, of_row, frequencies, row, scatters, decimals=decimals
    )
    return MaterialList(path=path, text=text, materials=(material,))


def _rows_of(text: Text, path: str) -> list[tuple[str, int, list[Token]]]:
    """Return the rows of a table as place, line and cells; DataError for one of another width."""
    rows = list[tuple[str, int, list[Token]]]()
    for line, start, raw in lines(text.characters):
        if not raw.strip():
            continue
        place = f"{path}, line {line}"
        cells = [
            (cell.strip(), begin + len(cell) - len(cell.lstrip()), begin + len(cell.rstrip()))
            for cell, begin, _ in tokens(r"(?:^|(?<=,))[^,]*", raw, start)
        ]
        budget.require(len(cells), _MAX_COLUMNS, "columns", place)
        if rows and len(cells) != len(rows[0][2]):
            raise DataError(
                f"{place}: this row has {len(cells)} cells, but the header has {len(rows[0][2])}"
            )
        rows.append((place, line, cells))
    if not rows:
        raise DataError(f"{path}, line 1: this line is empty; it must have the names of columns")
    return rows


def _new_bras(room: Room, *_: object) -> bytes:
    rows = ["material," + ",".join(f"{f:g}" for f in room.centre_frequencies)]
    for i, name in enumerate(room.materials):
        if "," in name or not name.isprintable() or name.strip() != name or not name:
            raise DataError(
                f"material {name!r}: a name in this table must not have a comma, a line "
                "break, or a blank at an end"
            )
        rows.append(",".join([name, *(f"{a:.{_DECIMALS['bras']}f}" for a in room.alpha[i])]))
    return ("\n".join(rows) + "\n").encode("utf-8")


bras = Format(parse=_parse_bras, new=_new_bras)
"""Format of the BRAS data base's materials (CSV): one material per file, or a table of several.

``where`` in `Format.read` selects rows of a table by further columns."""


def read_sigma(path: str | os.PathLike[str]) -> dict[str, ListedMaterial | float]:
    """Return the standard uncertainty sigma of each material's alpha in a CSV file, by material.

    A row has one number per material, under ``material,sigma``, or one per band, under
    ``material,125,250,500``. DataError names the file, the line and the rule.
    """
    content, place = read_bytes(path, MAX_TEXT), os.fspath(path)
    (_, _, header), *rows = _rows_of(decode(content, place), place)
    if [name for name, *_ in header] != ["material", "sigma"]:
        return {m.name: m for m in bras.parse(content, place).materials}
    sigma: dict[str, ListedMaterial | float] = {}
    for where, _, ((name, *_), (cell, *_)) in rows:
        if name in sigma:
            raise DataError(f'{where}: "{name}" is given twice')
        sigma[name] = value = number(cell, where)
        if not 0 <= value <= 1:
            raise DataError(f"{where}: sigma {value:g} must be from 0 to 1")
    return sigma
