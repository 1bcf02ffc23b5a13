"""Material lists of CATT-Acoustic, ODEON, pyroomacoustics and BRAS: one grammar each, over one list.

**CATT-Acoustic**, the ``ABS`` statements of a geometry file (.GEO) or a material list::

    ABS carpet   = <2 4 8 20 35 40> {98 209 44}           ; percent, 125 Hz to 4 kHz
    ABS audience = <68 75 82 85 86 86> L <30 40 50 60 70 80> {128 128 0}
    ABS drape    = <3 4 11 17 24 35 : 40 45>              ; with 8 and 16 kHz
    ABS1 panel   = <0.28 0.22 0.17 0.09 0.10 0.11>              ; fractions
    ABS floorabs = carpet                                 ; another name for carpet

**ODEON**, a material library (.Li8), two lines for each material::

    103 Rough concrete
        0.02000 0.03000 0.03000 0.03000 0.04000 0.07000 0.07000 0.07000

The first line is a number and a description, the second has eight coefficients for the octaves 63 Hz to
8 kHz, all separated by blanks or tabs. Empty lines between materials are kept. A material's name is its
number and description; the description alone suffices where no other material has it.

**pyroomacoustics**, its JSON data base of materials. A material is an object with ``coeffs``; its name
is its key. Its bands are its own ``center_freqs``, else those of the file's outermost object::

    {"center_freqs": [125, 250, 500, 1000, 2000],
     "absorption": {"Walls": {"brick": {"description": "", "coeffs": [0.02, 0.03, 0.03, 0.04, 0.05]}}},
     "scattering": {"diffuser": {"coeffs": [0.1, 0.2, 0.3, 0.4, 0.5]}}}

A single object, ``{"description": ..., "coeffs": [...], "center_freqs": [...]}``, is a material named
"material". Objects below an outermost ``scattering`` are the scattering of the material of the same
name and bands.

**BRAS** (CSV), one material as the data base publishes them, named after its file: rows of frequencies,
absorption and, if known, scattering; or a table, of which rows can be selected by further columns::

    20, 25, 31.5, 40                     room,set,material,20,25,31.5
    0.069, 0.055, 0.04, 0.023            CR2,initial,ceiling,0.069,0.055,0.04
    0.1, 0.1, 0.1, 0.1

Sources: CATT-Acoustic v8.0 User's Manual (CATT 2007), its shoebox and tutorial hall, and the lists that
I-Simpa's documentation reads; ODEON Room Acoustics Software User's Manual, "Materials" (Odeon A/S), and
the reader of Just4RIR (Sorbonne Universite, 2018), which reads ODEON's own library; pyroomacoustics
0.10.1, ``data/materials.json`` and ``parameters.Material``; Aspoeck, Brinkmann, Ackermann, Weinzierl,
Vorlaender, "BRAS - Benchmark for Room Acoustical Simulation", doi 10.14279/depositonce-6726.3.
`docs/io.md` lists what was not checked in the programs.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.files.disk import read_bytes
from rtcal.io.material_list import (
    Format,
    ListedMaterial,
    MaterialList,
    Token,
    coefficients,
    numbers,
    tokens,
)
from rtcal.io.table_columns import nearest_band
from rtcal.io.text import MAX_TEXT, Text, decode, line_of, lines, number, shown
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["bras", "catt", "dictionaries", "odeon", "pyroomacoustics", "read_sigma"]
__dir__ = __all__.copy

_OCTAVES = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
_OF_CATT, _OF_ODEON = _OCTAVES[1:], _OCTAVES[:8]
_DECIMALS = {"catt": 1, "odeon": 5, "bras": 3}
"""Decimals of a written number; of CATT's of a percentage, and its fractions (ABS1) get two more."""

# -- CATT-Acoustic

_NAME = r"[^\s=<>{};:]+"
_STATEMENT = re.compile(rf"[ \t]*(?:(ABS1?)[ \t]+)?({_NAME})[ \t]*=[ \t]*(.*)", re.I | re.S)
_NO_STATEMENT = re.compile(r"[ \t]*ABS1?(?![^\s=<>])", re.I)
_LIST = re.compile(r"<([^<>]*)>[ \t]*")
_SCATTERING = re.compile(r"L[ \t]*", re.I)
_COLOUR = re.compile(r"\{[ \t]*\d{1,3}[ \t]+\d{1,3}[ \t]+\d{1,3}[ \t]*\}[ \t]*", re.ASCII)


def _parse_catt(content: bytes, path: str = "CATT file") -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule."""
    text = decode(content, path)
    aliases: dict[str, tuple[str, int]] = {}
    listed: list[ListedMaterial] = []
    for line, start, match in _statements(text.characters, path):
        place, (_, name, value) = f"{path}, line {line}", match.groups()
        if value.startswith("<"):
            listed.append(_of_statement(match, start, line, place))
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
                f'{path}, line {line}: "{target}", which "{name}" stands for, is no material of '
                "the file with values of its own"
            )
    return MaterialList(
        path=path,
        text=text,
        materials=tuple(listed),
        aliases={name: target for name, (target, _) in aliases.items()},
        scattering_text=lambda values: f" L <{_in_groups(values)}>",
    )


def _statements(characters: str, path: str) -> Iterator[tuple[int, int, re.Match[str]]]:
    """Yield the line and the start of each ABS statement, and its keyword, name and value.

    Raises DataError for a line that begins as one and is none.
    """
    for line, start, raw in lines(characters):
        code = raw.split(";", 1)[0].rstrip()
        match = _STATEMENT.fullmatch(code)
        if match and (match[1] is not None or match[3].startswith("<")):
            yield line, start, match
        elif _NO_STATEMENT.match(code):
            raise DataError(
                f'{path}, line {line}: "{shown(code)}" is no ABS statement: ABS name = <6 to 8 values>'
            )


def _of_statement(match: re.Match[str], start: int, line: int, place: str) -> ListedMaterial:
    """Return the material of a statement of a line that begins at position ``start``."""
    keyword, name, value = match.groups()
    offset, in_percent = start + match.start(3), (keyword or "ABS").upper() == "ABS"
    unit = 0.01 if in_percent else 1.0
    of_alpha = _LIST.match(value)
    if not of_alpha:
        raise DataError(f'{place}: "{shown(value)}" lacks the closing >')
    row = _list_of_octaves(of_alpha, offset, place)
    end, second = of_alpha.end(), None
    if letter := _SCATTERING.match(value, end):
        of_scattering = _LIST.match(value, letter.end())
        if not of_scattering:
            raise DataError(f"{place}: L, the scattering, lacks its <6 to 8 values>")
        end = of_scattering.end()
        second = _list_of_octaves(of_scattering, offset, place, " of L, the scattering")
        if len(second) != len(row):
            raise DataError(
                f"{place}: {len(row)} absorption and {len(second)} scattering values; the numbers must "
                "be equal"
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
        raise DataError(f'{place}: "{shown(value[end:])}" after the values is no colour {{r g b}}')
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
            f"{place}: the : stands after {wrong[0]} values; it separates the 6 octaves to 4 kHz from "
            "8 and 16 kHz"
        )
    row = [token for token in row if token[0] != ":"]
    numbers(row, place)
    if not 6 <= len(row) <= 8:
        raise DataError(f"{place}: {len(row)} values{which}; 6 to 8 octaves from 125 Hz are needed")
    return row


def _with_own_values(listed: MaterialList, room: Room) -> MaterialList:
    """Return the list with values of its own for each alias whose coefficients the room has otherwise.

    ``ABS wallabs = plaster`` becomes plaster's own list of values, which is then changed.
    """
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
    statements = {match[2]: (start, match) for _, start, match in _statements(characters, "")}
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


def _new_catt(room: Room) -> bytes:
    def percents(row: Array) -> str:
        return _in_groups([f"{100 * value:.{_DECIMALS['catt']}f}" for value in row])

    rows = ["; Absorption, %, in octaves from 125 Hz; written by rtcal"]
    for i, name in enumerate(room.materials):
        if not re.fullmatch(_NAME, name) or not name.isascii():
            raise DataError(
                f'material "{name}": a name for CATT-Acoustic is ASCII, without spaces and none '
                "of = < > { } ; :"
            )
        scattering = "" if room.scattering is None else f" L <{percents(room.scattering[i])}>"
        rows.append(f"ABS {name} = <{percents(room.alpha[i])}>{scattering}")
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

# -- ODEON

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
                raise DataError(f"{place}: empty; the line after a description has 8 coefficients")
        elif head is None:
            head = _HEAD.fullmatch(raw)
            if head is None or int(head[1]) > _LARGEST_NUMBER:
                raise DataError(
                    f'{place}: "{shown(raw)}" is not a number, up to {_LARGEST_NUMBER}, and a '
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
                    f"{place}: {len(row)} values; there are 8, for the octaves 63 Hz to 8 kHz"
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


def _new_odeon(room: Room) -> bytes:
    """Return a new library; names without a number get numbers from 10001 on."""
    rows = []
    for i, name in enumerate(room.materials):
        if not (name.isprintable() and name.strip() == name and name):
            raise DataError(f"material {name!r}: an ODEON description is one line of text")
        numbered = re.match(r"\d{1,10} \S", name, re.ASCII)
        rows.append(name if numbered else f"{10001 + i} {name}")
        rows.append("\t" + "\t".join(f"{a:.{_DECIMALS['odeon']}f}" for a in room.alpha[i]))
    return Text("", codec="cp1252").encode("\r\n".join(rows) + "\r\n")


odeon = Format(parse=_parse_odeon, new=_new_odeon, bands=lambda _: _OF_ODEON)

# -- pyroomacoustics

_MAX_DEPTH = 32
_LITERAL = re.compile(r'"(?:[^"\\]|\\.)*"|-?(?:Infinity|\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)|NaN', re.S)
Keys = tuple[str | int, ...]
"""The path to a value: keys of objects and indices of lists."""


def _parse_pyroomacoustics(content: bytes, path: str = "JSON file") -> MaterialList:
    """Return the materials of a JSON file's content; DataError names the line and the rule."""
    text = decode(content, path)
    whole = _located(text.characters, path)
    of_file = whole.get("center_freqs") if isinstance(whole, dict) else None
    found: dict[bool, list[tuple[int, ListedMaterial, list[Token]]]] = {True: [], False: []}
    for keys, entry in _objects(whole, (), path):
        stated = entry.get("coeffs")
        if not isinstance(stated, list) or not stated:
            continue
        row = [_token(value, path, text.characters) for value in stated]
        line = line_of(text.characters, row[0][1])
        place, of_scattering = f"{path}, line {line}", keys[:1] == ("scattering",)
        coefficients(row, place, name="scattering" if of_scattering else "alpha")
        centres = entry.get("center_freqs", of_file)
        if not isinstance(centres, list) or not centres:
            raise DataError(f"{place}: these coefficients have no center_freqs")
        of_bands = numbers([_token(value, path, text.characters) for value in centres], place)
        frequencies = bands.as_bands(of_bands, f"{place}: center_freqs")
        # In pyroomacoustics, a shorter list begins at the lowest band of its data base.
        shorter = "center_freqs" not in entry and len(row) < len(frequencies)
        if len(row) != len(frequencies) and not shorter:
            raise DataError(f"{place}: {len(row)} coefficients for {len(frequencies)} center_freqs")
        name = str(keys[-1]) if keys else "material"
        its = frequencies[: len(row)].tolist()
        material = ListedMaterial.of(name, line, place, its, row)
        found[of_scattering].append((row[0][1], material, row))
    scattering: dict[tuple[str, tuple[float, ...]], ListedMaterial] = {}
    for _, of, _ in sorted(found[True], key=lambda one: one[0]):
        scattering.setdefault((of.name, of.centre_frequencies), of)
    materials = []
    for _, of, _ in sorted(found[False], key=lambda one: one[0]):
        if own := scattering.get((of.name, of.centre_frequencies)):
            of = replace(of, scattering=own.alpha, scattering_spans=own.spans)
        materials.append(of)
    return MaterialList(path=path, text=text, materials=tuple(materials))


def _located(text: str, path: str) -> Any:
    """Return what a JSON text holds; its numbers are tokens, with their place in the text.

    json asks for a number's value in the order of the text, in which the pattern finds them, too.
    """
    literals = (m for m in _LITERAL.finditer(text) if not m[0].startswith('"'))
    last = 0

    def token(characters: str) -> Token:
        nonlocal last
        match = next(literals)
        last = match.start()
        return characters, match.start(), match.end()

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if twice := [key for key, times in Counter(k for k, _ in pairs).items() if times > 1]:
            line = line_of(text, last)
            raise DataError(f'{path}, line {line}: the key "{shown(twice[0])}" is given twice')
        return dict(pairs)

    try:
        return json.loads(
            text, parse_float=token, parse_int=token, parse_constant=token, object_pairs_hook=once
        )
    except RecursionError as error:
        raise DataError(f"{path}, line 1: nested deeper than {_MAX_DEPTH} levels") from error
    except (ValueError, StopIteration) as error:
        line = getattr(error, "lineno", 1)
        raise DataError(f"{path}, line {line}: not valid JSON: {error}") from error


def _token(value: Any, path: str, text: str) -> Token:
    """Return the token of a number; DataError for another value."""
    if isinstance(value, tuple):
        return value
    written = json.dumps(value)
    line = line_of(text, max(text.find(written), 0))
    raise DataError(f'{path}, line {line}: "{shown(written)}" is not a finite number')


def _objects(value: Any, keys: Keys, path: str) -> Iterator[tuple[Keys, dict[str, Any]]]:
    """Yield each object with its path."""
    if len(keys) > _MAX_DEPTH:
        raise DataError(f"{path}, line 1: nested deeper than {_MAX_DEPTH} levels")
    if isinstance(value, dict):
        yield keys, value
    if isinstance(value, (dict, list)):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _objects(entry, (*keys, key), path)


def dictionaries(room: Room) -> dict[str, dict[str, Any]]:
    """Return the arguments of ``pyroomacoustics.Material`` by material; the library is not imported.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1, 0.2]],
    ...             sigma=[[0.01, 0.02]], centre_frequencies=[500, 1000])
    >>> dictionaries(room)["wall"]["energy_absorption"]["coeffs"]
    [0.1, 0.2]
    """
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


def _new_pyroomacoustics(room: Room) -> bytes:
    content: dict[str, Any] = {"center_freqs": [float(f) for f in room.centre_frequencies]}
    for name, of_material in dictionaries(room).items():
        for key, entry in of_material.items():
            of_key = content.setdefault(key.removeprefix("energy_"), {"Calibrated": {}})
            of_key["Calibrated"][name] = entry
    return (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode("utf-8")


pyroomacoustics = Format(parse=_parse_pyroomacoustics, new=_new_pyroomacoustics)

# -- BRAS

_MAX_BANDS = 100


def _parse_bras(
    content: bytes, path: str = "BRAS file", *, where: Mapping[str, str] | None = None
) -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule.

    ``where`` selects rows of a table: ``where={"room": "CR2", "set": "initial"}``.
    """
    text, where = decode(content, path), checks.text_by_name("where", where)
    rows = [
        (f"{path}, line {line}", line, _cells(raw, start))
        for line, start, raw in lines(text.characters)
        if raw.strip()
    ]
    if not rows:
        raise DataError(f"{path}, line 1: empty; frequencies, or the names of columns, are needed")
    place, _, header = rows[0]
    if len(header) > _MAX_BANDS:
        raise DataError(f"{place}: {len(header)} columns; at most {_MAX_BANDS} are read")
    if not re.match(r"[\d.]", header[0][0]):
        return MaterialList(path=path, text=text, materials=_of_bras_table(rows, where))
    if where:
        raise DataError(f"{path}: holds one material and no columns to select by")
    if not 2 <= len(rows) <= 3:
        raise DataError(
            f"{rows[-1][0]}: {len(rows)} rows; the rows are frequencies, absorption and, if known, "
            "scattering"
        )
    frequencies = _bands_of(header, place, "frequencies")
    for place, _, row in rows[1:]:
        if len(row) != len(frequencies):
            numbers(row, place)
            raise DataError(f"{place}: {len(row)} values for {len(frequencies)} frequencies")
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
            raise DataError(f'{place}: column "{shown(wanted)}" is not there once')
    columns = [i for i, name in enumerate(names) if re.match(r"[\d.]", name)]
    frequencies = _bands_of([header[i] for i in columns], place, "the bands' columns")
    materials = []
    for place, line, cells in rows[1:]:
        if len(cells) != len(header):
            raise DataError(f"{place}: {len(cells)} cells; the header has {len(header)}")
        if any(cells[names.index(column)][0] != entry for column, entry in where.items()):
            continue
        row, name = [cells[i] for i in columns], cells[names.index("material")][0]
        materials.append(
            ListedMaterial.of(name, line, place, frequencies, row, decimals=_DECIMALS["bras"])
        )
    if not materials:
        raise DataError(f"{rows[-1][0]}: no row is selected")
    return tuple(materials)


def _new_bras(room: Room) -> bytes:
    rows = ["material," + ",".join(f"{f:g}" for f in room.centre_frequencies)]
    for i, name in enumerate(room.materials):
        if "," in name or not name.isprintable() or name.strip() != name or not name:
            raise DataError(f"material {name!r}: a name in this table has no comma, on one line")
        rows.append(",".join([name, *(f"{a:.{_DECIMALS['bras']}f}" for a in room.alpha[i])]))
    return ("\n".join(rows) + "\n").encode("utf-8")


bras = Format(parse=_parse_bras, new=_new_bras)


def read_sigma(path: str | os.PathLike[str]) -> dict[str, ListedMaterial | float]:
    """Return sigma by material of a CSV file, whose bands may differ from the room's.

    A row has one number per material, or one per band::

        material,sigma           material,125,250,500
        brick,0.02               brick,0.02,0.02,0.03

    Raises
    ------
    DataError
        Naming file, line and rule.
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
            raise DataError(f"{where}: {len(cells)} cells; the header has 2")
        if cells[0] in sigma:
            raise DataError(f'{where}: "{cells[0]}" is given twice')
        sigma[cells[0]] = value = number(cells[1], where)
        if not 0 <= value <= 1:
            raise DataError(f"{where}: sigma {value:g} is not in [0, 1]")
    return sigma
