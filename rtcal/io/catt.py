"""CATT-Acoustic: the ``ABS`` statements of a geometry file (.GEO) or a material list.

::

    ABS carpet   = <2 4 8 20 35 40> {98 209 44}           ; percent, 125 Hz to 4 kHz
    ABS audience = <68 75 82 85 86 86> L <30 40 50 60 70 80> {128 128 0}
    ABS drape    = <3 4 11 17 24 35 : 40 45>              ; with 8 and 16 kHz
    ABS1 panel   = <0.28 0.22 0.17 0.09 0.10 0.11>              ; fractions
    ABS floorabs = carpet                                 ; another name for carpet

Sources: the examples in CATT-Acoustic v8.0 User's Manual (CATT 2007, the shoebox and the tutorial
hall) and the lists that I-Simpa's documentation reads. `docs/io.md` lists what was not
checked in the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from rtcal.acoustics import band_conversion
from rtcal.acoustics.room import Room
from rtcal.io import material_list
from rtcal.io.material_list import Format, ListedMaterial, MaterialList, Token
from rtcal.io.text import decode, lines, shown
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["parse", "read", "write"]
__dir__ = __all__.copy

BANDS = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
DECIMALS = 1
"""Decimals of a percentage that is written; fractions (ABS1) get two more."""

_NAME = r"[^\s=<>{};:]+"
_STATEMENT = re.compile(rf"[ \t]*(?:(ABS1?)[ \t]+)?({_NAME})[ \t]*=[ \t]*(.*)", re.I | re.S)
_LIST = re.compile(r"<([^<>]*)>[ \t]*")
_COLOUR = re.compile(r"\{[ \t]*\d{1,3}[ \t]+\d{1,3}[ \t]+\d{1,3}[ \t]*\}[ \t]*", re.ASCII)


def _statements(characters: str, path: str) -> Iterator[tuple[int, int, re.Match[str]]]:
    """Yield the line and the start of each ABS statement, and its keyword, name and value.

    Raises DataError for a line that begins as one and is none.
    """
    for line, start, raw in lines(characters):
        code = raw.split(";", 1)[0].rstrip()
        match = _STATEMENT.fullmatch(code)
        if match and (match[1] is not None or match[3].startswith("<")):
            yield line, start, match
        elif re.match(r"[ \t]*ABS1?(?![^\s=<>])", code, re.I):
            raise DataError(
                f'{path}, line {line}: "{shown(code)}" is no ABS statement: ABS name = <6 to 8 values>'
            )


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
    return parse(listed.text.encode(text), listed.path)


def parse(content: bytes, path: str = "CATT file") -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule."""
    text = decode(content, path)
    aliases: dict[str, tuple[str, int]] = {}
    listed: list[ListedMaterial] = []
    for line, start, match in _statements(text.characters, path):
        place, (keyword, name, value) = f"{path}, line {line}", match.groups()
        if value.startswith("<"):
            fraction = keyword is not None and keyword.upper() == "ABS1"
            listed.append(_material(name, value, start + match.start(3), fraction, place, line))
        elif not re.fullmatch(_NAME, value):
            raise DataError(
                f'{place}: "{shown(value)}" is neither <6 to 8 values> nor another name'
            )
        elif name in aliases:
            raise DataError(f'{place}: "{name}" is given twice')
        else:
            aliases[name] = (value, line)
    materials = {m.name: m for m in listed}
    for name, (target, line) in aliases.items():
        if name in materials:
            raise DataError(f'{path}, line {line}: "{name}" is given twice')
        if target not in materials:
            raise DataError(
                f'{path}, line {line}: "{target}", which "{name}" stands for, is no material of '
                "the file with values of its own"
            )
    return MaterialList(
        path=path,
        text=text,
        materials=tuple(listed),
        aliases={name: target for name, (target, _) in aliases.items()},
        scattering_text=lambda numbers: f" L <{_in_groups(numbers)}>",
    )


def _material(
    name: str, text: str, offset: int, fraction: bool, place: str, line: int
) -> ListedMaterial:
    unit = 1.0 if fraction else 0.01
    match = _LIST.match(text)
    if not match:
        raise DataError(f'{place}: "{shown(text)}" lacks the closing >')
    row = _row(match, offset, place)
    alpha, spans = material_list.coefficients(row, place, unit)
    tail, scattering, of_scattering = text[match.end() :], None, ()
    if tail[:1] in ("L", "l"):
        tail = tail[1:].lstrip(" \t")
        scattering_list = _LIST.match(tail)
        if not scattering_list:
            raise DataError(f"{place}: L, the scattering, lacks its <6 to 8 values>")
        begin = offset + len(text) - len(tail)
        scattering_row = _row(scattering_list, begin, place, " of L, the scattering")
        if len(scattering_row) != len(row):
            raise DataError(
                f"{place}: {len(row)} absorption and {len(scattering_row)} scattering values; "
                "the numbers must be equal"
            )
        scattering, of_scattering = material_list.coefficients(
            scattering_row, place, unit, "scattering"
        )
        tail = tail[scattering_list.end() :]
    if tail and not _COLOUR.fullmatch(tail):
        raise DataError(f'{place}: "{shown(tail)}" after the values is no colour {{r g b}}')
    values = material_list.numbers(row, place)
    at_most_one = not fraction and 0 < max(values) <= 1
    return ListedMaterial(
        name=name,
        line=line,
        alpha=alpha,
        centre_frequencies=BANDS[: len(row)],
        spans=spans,
        unit=unit,
        decimals=DECIMALS + 2 if fraction else DECIMALS,
        scattering=scattering,
        scattering_spans=of_scattering,
        scattering_place=offset + match.end(1) + 1,
        source=f"{place}: at most 1 %, since ABS is in percent" if at_most_one else "",
        doubt=_doubt(place, name, match[1], values) if at_most_one else "",
    )


def _row(match: re.Match[str], offset: int, place: str, which: str = "") -> list[Token]:
    """Return the tokens of a list of 6 to 8 numbers, which begins ``offset`` characters after 0."""
    row = material_list.tokens(r"[^\s:]+|:", match[1], offset + match.start(1))
    if wrong := [i for i, token in enumerate(row) if token[0] == ":" and i != 6]:
        raise DataError(
            f"{place}: the : stands after {wrong[0]} values; it separates the 6 octaves to 4 kHz from "
            "8 and 16 kHz"
        )
    row = [token for token in row if token[0] != ":"]
    material_list.numbers(row, place)
    if not 6 <= len(row) <= 8:
        raise DataError(f"{place}: {len(row)} values{which}; 6 to 8 octaves from 125 Hz are needed")
    return row


def _doubt(place: str, name: str, text: str, values: Sequence[float]) -> str:
    """Return why percents of at most 1 may be fractions; empty for whole percents."""
    if all(value == int(value) for value in values):
        return ""
    start = f"ABS1 {shown(name)} ="
    percents = " ".join(f"{value / 100:g}" for value in values)
    return (
        f'{place}: "{shown(name)} = <{shown(text, 80)}>" is at most 1 %, since ABS is in percent; '
        f'write "{start} <{shown(text, 80)}>" if the values are fractions, or '
        f'"{start} <{percents}>" if they are percents'
    )


def _bands_of_new_list(room: Room) -> tuple[float, ...]:
    """Return the octaves 125 Hz to 4 kHz, and 8 and 16 kHz if the room has them."""
    obtainable = band_conversion.obtainable(room.centre_frequencies, BANDS)
    n_bands = 6 if BANDS[6] not in obtainable else 7 if BANDS[7] not in obtainable else 8
    return BANDS[:n_bands]


def _new(room: Room) -> bytes:
    rows = ["; Absorption, %, in octaves from 125 Hz; written by rtcal"]
    for i, name in enumerate(room.materials):
        if not re.fullmatch(_NAME, name) or not name.isascii():
            raise DataError(
                f'material "{name}": a name for CATT-Acoustic is ASCII, without spaces and none '
                "of = < > { } ; :"
            )
        groups = [f"ABS {name} = <{_percents(room.alpha[i])}>"]
        if room.scattering is not None:
            groups.append(f"L <{_percents(room.scattering[i])}>")
        rows.append(" ".join(groups))
    return ("\r\n".join(rows) + "\r\n").encode("ascii")


def _percents(row: Array) -> str:
    return _in_groups([f"{100 * value:.{DECIMALS}f}" for value in row])


def _in_groups(texts: Sequence[str]) -> str:
    """Return the numbers of a list, with a colon before 8 kHz."""
    return " ".join(texts[:6]) + (" : " + " ".join(texts[6:]) if texts[6:] else "")


_FORMAT = Format(
    parse=parse,
    new=_new,
    bands=_bands_of_new_list,
    readable=lambda name: re.sub(r"[^!-~]|[=<>{};:]", "_", name),
    prepared=_with_own_values,
)
read, write = _FORMAT.read, _FORMAT.write
