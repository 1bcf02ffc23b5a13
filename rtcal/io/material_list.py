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
        scattering, of_scattering = None, tuple[Span, ...]()
        if scatters is not None:
            scattering, of_scattering = coefficients(scatters, place, unit, "scattering")
        return cls(
            name=name,
            line=line,
            alpha=alpha,
            centre_frequencies=tuple(centre_frequencies),
            spans=spans,
            unit=unit,
            scattering=scattering,
            scattering_spans=of_scattering,
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
        surfaces = (
            [Surface(n, n, a) for n, a in areas.items()]
            if isinstance(areas, Mapping)
            else list(areas)
        )
        others = others or {}
        used = {s.material: others.get(s.material) or self.listed(s.material) for s in surfaces}
        if doubts := [m.doubt for m in used.values() if m.doubt]:
            raise DataError(doubts[0])
        if not used:
            raise DataError(
                f"{self.path}: no areas are given; a room needs the area of at least one material"
            )
        if centre_frequencies is None:
            common = set.intersection(*(set(m.centre_frequencies) for m in used.values()))
            if not common:
                raise DataError(f"{self.path}: no band is common to all materials of the room")
            centre_frequencies = sorted(common)
        wanted = bands.as_bands(centre_frequencies)
        all_scatter = all(m.scattering is not None or scattering is not None for m in used.values())
        materials = []
        for material_name, listed in used.items():
            place = f'material "{material_name}"'
            alpha = listed.in_bands(listed.alpha, wanted, place)
            spread = (sigma_rule or SigmaRule()).sigma(alpha, wanted)
            stated = (sigma or {}).get(material_name, listed.sigma)
            if isinstance(stated, ListedMaterial):
                spread = stated.in_bands(stated.alpha, wanted, f"sigma of {place}")
            elif stated is not None:
                spread = np.full(len(wanted), stated)
            scatters = None
            if all_scatter:
                rows = listed.scattering or (scattering,) * len(listed.centre_frequencies)
                scatters = listed.in_bands(rows, wanted, place).tolist()  # type: ignore[arg-type]
            source = listed.source or self.path
            materials.append(
                Material(material_name, alpha.tolist(), spread.tolist(), 0.0, scatters, source)
            )
        return Room.from_surfaces(
            name=name,
            volume=volume,
            surfaces=surfaces,
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

    def _in_file_bands(self, room: Room, wanted: Sequence[float]) -> Room:
        """Return the room itself, or the room in the file's bands if they are of another width."""
        if not wanted or not bands.rule(room.centre_frequencies, wanted, "alpha"):
            return room
        obtainable = bands.obtainable(room.centre_frequencies, wanted)
        if not obtainable.size:
            raise DataError(
                f"{self.path}: none of its bands can be made from the room's bands, "
                f"{', '.join(bands.labels(room.centre_frequencies))}"
            )
        return room.in_bands(obtainable)

    def with_room(self, room: Room) -> tuple[bytes, Room, tuple[str, ...]]:
        """Return the file with a room's coefficients, the room as a program reads it, and omissions.

        The omissions are the names of materials for which the file can have no scattering; if there is
        one, the room as it is read has no scattering at all. Octaves of the file get the means of the
        room's third-octaves, and third-octaves the value of their octave. A number is replaced only if
        the coefficient, rounded to the file's decimals, differs from it.
        """
        common = set.intersection(*(set(self.listed(n).centre_frequencies) for n in room.materials))
        room = self._in_file_bands(room, sorted(common))
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

        tables = {"alpha": np.array(room.alpha)}
        if room.scattering is not None:
            tables["scattering"] = np.array(room.scattering)
        lacking = []
        for i, name in enumerate(room.materials):
            material = self.listed(name)
            frequencies = np.asarray(room.centre_frequencies)
            columns = [bands.index(frequencies, f) for f in material.centre_frequencies]
            in_room = [k for k in columns if k is not None]
            if not in_room:
                raise DataError(
                    f'{self.path}, line {material.line}: "{material.name}" has none of the '
                    "room's bands"
                )
            in_file = {"alpha": (material.spans, material.alpha)}
            at = material.scattering_place
            if material.scattering is not None and material.scattering_spans:
                in_file["scattering"] = material.scattering_spans, material.scattering
            elif "scattering" in tables and at is not None and len(in_room) == len(columns):
                row = tables["scattering"][i]
                rounded = [material.rounded(float(row[k])) for k in in_room]
                inserted = self.scattering_text([characters for characters, _ in rounded])
                put((at, at), inserted, f'{self.path}: scattering["{name}"]', inserted)
                row[in_room] = [value for _, value in rounded]
            elif "scattering" in tables:
                lacking.append(name)
            for quantity in [q for q in tables if q in in_file]:
                spans, stated = in_file[quantity]
                for k, span, before in zip(columns, spans, stated, strict=True):
                    if k is None:
                        continue
                    value = float(tables[quantity][i, k])
                    characters, as_read = material.rounded(value)
                    same = before in (value, as_read)
                    place = f"{self.path}: {room.place(quantity, i, k)}"
                    put(span, value, place, None if same else characters)
                    tables[quantity][i, k] = before if same else as_read
        scattering = None if lacking else tables.get("scattering")
        room_as_read = room.replace(alpha=tables["alpha"], scattering=scattering)
        shared = [f for f in room.centre_frequencies if f in common]
        if not shared:
            raise DataError(
                f"{self.path}: no band of the room is common to all materials of the list"
            )
        if len(shared) < room.n_bands:
            room_as_read = room_as_read.in_bands(shared)
        pieces, position = [], 0
        for (start, end), characters in sorted(written.items()):
            pieces += [self.text.characters[position:start], characters]
            position = end
        changed = "".join([*pieces, self.text.characters[position:]])
        return self.text.encode(changed), room_as_read, tuple(lacking)


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
    nearest = [int(np.argmin(np.abs(np.log(obtainable / f)))) for f in needed]
    taken = dict.fromkeys(k for f, k in zip(needed, nearest, strict=True) if f in missing)
    notes = [
        f"at {bands.hertz(lacking)}, which the room does not have, alpha is that at "
        f"{bands.label(obtainable[k])}"
        for k in taken
        for lacking in [
            [f for f, n in zip(needed, nearest, strict=True) if n == k and f in missing]
        ]
    ]
    tables = {n: getattr(converted, n) for n in ("alpha", "sigma", "alpha_min", "scattering")}
    return converted.replace(
        centre_frequencies=np.asarray(needed),
        **{n: t[:, nearest] for n, t in tables.items() if t is not None},
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
_LIST = re.compile(r"<([^<>]*)>[ \t]*")
_SCATTERING = re.compile(r"L[ \t]*", re.I)
_COLOUR = re.compile(r"\{[ \t]*\d{1,3}[ \t]+\d{1,3}[ \t]+\d{1,3}[ \t]*\}[ \t]*", re.ASCII)
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
    offset, in_percent = start + match.start(3), (keyword or "ABS").upper() == "ABS"
    unit = 0.01 if in_percent else 1.0
    of_alpha = _LIST.match(value)
    if not of_alpha:
        raise DataError(f'{place}: "{shown(value)}" has no closing >')
    row = _list_of_octaves(of_alpha, offset, place)
    end, second = of_alpha.end(), None
    if letter := _SCATTERING.match(value, end):
        of_scattering = _LIST.match(value, letter.end())
        if not of_scattering:
            raise DataError(f"{place}: L, the scattering, must be followed by <6 to 8 values>")
        end = of_scattering.end()
        second = _list_of_octaves(of_scattering, offset, place, " of L, the scattering")
        if len(second) != len(row):
            raise DataError(
                f"{place}: {len(row)} absorption values, but {len(second)} scattering "
                "values; give the same number of both"
            )
    material = ListedMaterial.of(
        name,
        line,
        place,
        _OF_CATT[: len(row)],
        row,
        second,
        unit,
        decimals=_DECIMALS["catt"] + (0 if in_percent else 2),
        scattering_place=offset + of_alpha.end(1) + 1,
    )
    if value[end:] and not _COLOUR.fullmatch(value, end):
        raise DataError(
            f'{place}: "{shown(value[end:])}" after the values is not a colour {{r g b}}'
        )
    percents = numbers(row, place)
    at_most_one = in_percent and 0 < max(percents) <= 1
    doubt = ""
    if at_most_one and any(percent != int(percent) for percent in percents):
        written, start_of_it = shown(of_alpha[1], 80), f"ABS1 {shown(name)} ="
        fractions = " ".join(f"{percent / 100:g}" for percent in percents)
        doubt = (
            f'{place}: "{shown(name)} = <{written}>" is at most 1 %, since ABS is in percent; write '
            f'"{start_of_it} <{written}>" if the values are fractions, or '
            f'"{start_of_it} <{fractions}>" if they are percents'
        )
    source = f"{place}: at most 1 %, since ABS is in percent" if at_most_one else ""
    return replace(material, source=source, doubt=doubt)


def _list_of_octaves(match: re.Match[str], offset: int, place: str, which: str = "") -> list[Token]:
    """Return the tokens of a list of 6 to 8 numbers in a text that begins at ``offset``."""
    row = tokens(r"[^\s:]+|:", match[1], offset + match.start(1))
    if wrong := [i for i, token in enumerate(row) if token[0] == ":" and i != 6]:
        raise DataError(
            f"{place}: the colon is after {wrong[0]} values; it must be after 6, between the "
            "octaves up to 4 kHz and those of 8 and 16 kHz"
        )
    row = [token for token in row if token[0] != ":"]
    numbers(row, place)
    if not 6 <= len(row) <= 8:
        raise DataError(
            f"{place}: {len(row)} values{which}, but 6 to 8 are needed, for the octaves from 125 Hz"
        )
    return row


def _with_own_values(listed: MaterialList, room: Room) -> MaterialList:
    """Return the list with own values for each alias whose coefficients the room has otherwise."""
    aliases = {n: t for n, t in listed.aliases.items() if n in room.materials}
    tables = [room.alpha] if room.scattering is None else [room.alpha, room.scattering]
    rows = {n: np.hstack([t[i] for t in tables]) for i, n in enumerate(room.materials)}
    own = {
        n
        for n, target in aliases.items()
        for other, row in rows.items()
        if target in (other, aliases.get(other)) and (row != rows[n]).any()
    }
    if not own:
        return listed
    characters, pieces, position = listed.text.characters, list[str](), 0
    statements = {
        of_room or match[2]: (start, match)
        for _, start, match, of_room in _statements(characters, "")
    }
    for name, (start, match) in statements.items():
        if name in own:
            _, of_target = statements[aliases[name]]
            pieces += [
                characters[position : start + match.start(1)],
                f"{of_target[1] or 'ABS'} {name} = {of_target[3]}",
            ]
            position = start + match.end(3)
    text = "".join([*pieces, characters[position:]])
    return _parse_catt(listed.text.encode(text), listed.path)


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
    materials: list[ListedMaterial] = []
    line_of_number: dict[int, int] = {}
    head: re.Match[str] | None = None
    line = 1
    for line, start, raw in lines(text.characters):
        place = f"{path}, line {line}"
        if not raw.strip():
            if head is not None:
                raise DataError(
                    f"{place}: this line is empty; the line after a description must have 8 "
                    "coefficients"
                )
        elif head is None:
            head = _HEAD.fullmatch(raw)
            if head is None or int(head[1]) > _LARGEST_NUMBER:
                raise DataError(
                    f'{place}: "{shown(raw)}" must be a number, up to {_LARGEST_NUMBER}, and a '
                    "description"
                )
            first = line_of_number.setdefault(int(head[1]), line)
            if first != line:
                raise DataError(
                    f"{place}: number {int(head[1])} is given twice, first on line {first}"
                )
        else:
            row = tokens(r"\S+", raw, start)
            if len(row) != len(_OF_ODEON):
                raise DataError(
                    f"{place}: this line has {len(row)} values, but must have 8, for the "
                    "octaves 63 Hz to 8 kHz"
                )
            its_name = f"{int(head[1])} {head[2]}"
            decimals = _DECIMALS["odeon"]
            materials.append(
                ListedMaterial.of(its_name, line - 1, place, _OF_ODEON, row, decimals=decimals)
            )
            head = None
    if head is not None:
        raise DataError(f"{path}, line {line}: its 8 coefficients are missing")
    named = [(m.name.split(" ", 1)[1], m.name) for m in materials]
    times = Counter(description for description, _ in named)
    aliases = {description: name for description, name in named if times[description] == 1}
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

_MAX_BANDS = 100


def _parse_bras(
    content: bytes, path: str = "BRAS file", *, where: Mapping[str, str] | None = None
) -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule."""
    text, where = decode(content, path), checks.text_by_name("where", where)
    rows = [
        (f"{path}, line {line}", line, _cells(raw, start))
        for line, start, raw in lines(text.characters)
        if raw.strip()
    ]
    if not rows:
        raise DataError(
            f"{path}, line 1: this line is empty; it must have the frequencies, or the "
            "names of columns"
        )
    place, _, header = rows[0]
    if len(header) > _MAX_BANDS:
        raise DataError(f"{place}: {len(header)} columns; at most {_MAX_BANDS} are read")
    if not re.match(r"[\d.]", header[0][0]):
        return MaterialList(path=path, text=text, materials=_of_bras_table(rows, where))
    if where:
        raise DataError(
            f"{path}: holds one material, so there are no columns to select from; leave where out"
        )
    if not 2 <= len(rows) <= 3:
        raise DataError(
            f"{rows[-1][0]}: {len(rows)} rows; give 2 or 3 rows: frequencies, absorption and, if "
            "known, scattering"
        )
    frequencies = _bands_of(header, place, "frequencies")
    for place, _, row in rows[1:]:
        if len(row) != len(frequencies):
            numbers(row, place)
            raise DataError(
                f"{place}: {len(row)} values, but {len(frequencies)} frequencies; give the "
                "same number of both"
            )
    (place, line, row), scatters = rows[1], rows[2][2] if len(rows) > 2 else None
    material = ListedMaterial.of(
        Path(path).stem, line, place, frequencies, row, scatters, decimals=_DECIMALS["bras"]
    )
    return MaterialList(path=path, text=text, materials=(material,))


def _cells(raw: str, start: int) -> list[Token]:
    """Return the cells of a line that begins at position ``start``."""
    cells = []
    for characters in raw.split(","):
        begin, content = start + len(characters) - len(characters.lstrip()), characters.strip()
        cells.append((content, begin, begin + len(content)))
        start += len(characters) + 1
    return cells


def _bands_of(cells: Sequence[Token], place: str, what: str) -> tuple[float, ...]:
    """Return the bands in Hz; frequencies in the published tables are off by up to 3 %."""
    nominal = [nearest_band(f) or f if f > 0 else f for f in numbers(cells, place)]
    return tuple(map(float, bands.as_bands(nominal, f"{place}: {what}")))


def _of_bras_table(
    rows: Sequence[tuple[str, int, list[Token]]], where: Mapping[str, str]
) -> tuple[ListedMaterial, ...]:
    place, _, header = rows[0]
    names = [cell for cell, *_ in header]
    for wanted in ("material", *where):
        if names.count(wanted) != 1:
            raise DataError(f'{place}: column "{shown(wanted)}" must occur exactly once')
    columns = [i for i, name in enumerate(names) if re.match(r"[\d.]", name)]
    frequencies = _bands_of([header[i] for i in columns], place, "the bands' columns")
    materials = []
    for place, line, cells in rows[1:]:
        if len(cells) != len(header):
            raise DataError(
                f"{place}: this row has {len(cells)} cells, but the header has {len(header)}"
            )
        if any(cells[names.index(column)][0] != entry for column, entry in where.items()):
            continue
        row, name = [cells[i] for i in columns], cells[names.index("material")][0]
        materials.append(
            ListedMaterial.of(name, line, place, frequencies, row, decimals=_DECIMALS["bras"])
        )
    if not materials:
        raise DataError(f"{rows[-1][0]}: no row fits the selection (where)")
    return tuple(materials)


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
    rows = [
        (f"{place}, line {line}", [cell.strip() for cell in raw.split(",")])
        for line, _, raw in lines(decode(content, place).characters)
        if raw.strip()
    ]
    if not rows or rows[0][1] != ["material", "sigma"]:
        return {m.name: m for m in bras.parse(content, place).materials}
    sigma: dict[str, ListedMaterial | float] = {}
    for where, cells in rows[1:]:
        if len(cells) != 2:
            raise DataError(f"{where}: this row has {len(cells)} cells, but the header has 2")
        if cells[0] in sigma:
            raise DataError(f'{where}: "{cells[0]}" is given twice')
        sigma[cells[0]] = value = number(cells[1], where)
        if not 0 <= value <= 1:
            raise DataError(f"{where}: sigma {value:g} must be from 0 to 1")
    return sigma
