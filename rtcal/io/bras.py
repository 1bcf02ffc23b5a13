"""BRAS CSV: absorption coefficients of the Benchmark for Room Acoustical Simulation.

A file holds one material, as the data base publishes them. Its rows are frequencies, absorption and, if
known, scattering; its name is the file's::

    20, 25, 31.5, 40
    0.069, 0.055, 0.04, 0.023
    0.1, 0.1, 0.1, 0.1

Or it holds a table with a header: a column ``material``, one column per band, and further columns, by
which rows can be selected::

    room,set,material,20,25,31.5
    CR2,initial,ceiling,0.069,0.055,0.04

Source: Aspoeck, Brinkmann, Ackermann, Weinzierl, Vorlaender, "BRAS - Benchmark for Room Acoustical
Simulation", doi 10.14279/depositonce-6726.3 (surface descriptions).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.files.disk import read_bytes
from rtcal.io import material_list
from rtcal.io.material_list import Format, ListedMaterial, MaterialList, Token
from rtcal.io.table_columns import nearest_band
from rtcal.io.text import MAX_TEXT, decode, lines, number, shown
from rtcal.support import checks
from rtcal.support.errors import DataError

__all__ = ["DECIMALS", "MAX_BANDS", "parse", "read", "write"]
__dir__ = __all__.copy

DECIMALS = 3
MAX_BANDS = 100


def parse(
    content: bytes, path: str = "BRAS file", *, where: Mapping[str, str] | None = None
) -> MaterialList:
    """Return the materials of a file's content; DataError names file, line and rule.

    ``where`` selects rows of a table: ``where={"room": "CR2", "set": "initial"}``.
    """
    text, where = decode(content, path), checks.text_by_name("where", where)
    rows: list[tuple[int, list[Token]]] = []
    for line, start, raw in lines(text.characters):
        if raw.strip():
            rows.append((line, _cells(raw, start)))
    if not rows:
        raise DataError(f"{path}, line 1: empty; frequencies, or the names of columns, are needed")
    line, header = rows[0]
    if len(header) > MAX_BANDS:
        raise DataError(f"{path}, line {line}: {len(header)} columns; at most {MAX_BANDS} are read")
    if re.match(r"[\d.]", header[0][0]):
        return MaterialList(path=path, text=text, materials=(_single_material(rows, path, where),))
    return MaterialList(path=path, text=text, materials=_table(rows, path, where))


def _cells(raw: str, start: int) -> list[Token]:
    """Return the cells of a line that begins at position ``start``."""
    cells = []
    for characters in raw.split(","):
        begin = start + len(characters) - len(characters.lstrip())
        content = characters.strip()
        cells.append((content, begin, begin + len(content)))
        start += len(characters) + 1
    return cells


def _bands(cells: Sequence[Token], place: str, what: str) -> tuple[float, ...]:
    """Return the bands in Hz; frequencies in the published tables are off by up to 3 %."""
    frequencies = material_list.numbers(cells, place)
    nominal = [nearest_band(f) or f if f > 0 else f for f in frequencies]
    return tuple(map(float, bands.as_bands(nominal, f"{place}: {what}")))


def _single_material(
    rows: list[tuple[int, list[Token]]], path: str, where: Mapping[str, str] | None
) -> ListedMaterial:
    if where:
        raise DataError(f"{path}: holds one material and no columns to select by")
    if not 2 <= len(rows) <= 3:
        raise DataError(
            f"{path}, line {rows[-1][0]}: {len(rows)} rows; the rows are frequencies, "
            "absorption and, if known, scattering"
        )
    bands_of = _bands(rows[0][1], f"{path}, line {rows[0][0]}", "frequencies")
    found = []
    for (line, row), name in zip(rows[1:], ("alpha", "scattering"), strict=False):
        place = f"{path}, line {line}"
        found.append(material_list.coefficients(row, place, name=name))
        if len(row) != len(bands_of):
            raise DataError(f"{place}: {len(row)} values for {len(bands_of)} frequencies")
    scattering, of_scattering = found[1] if len(found) > 1 else (None, ())
    return ListedMaterial(
        name=Path(path).stem,
        line=rows[1][0],
        alpha=found[0][0],
        centre_frequencies=bands_of,
        spans=found[0][1],
        decimals=DECIMALS,
        scattering=scattering,
        scattering_spans=of_scattering,
    )


def _table(
    rows: list[tuple[int, list[Token]]], path: str, where: Mapping[str, str]
) -> tuple[ListedMaterial, ...]:
    line, header = rows[0]
    names = [c[0] for c in header]
    for wanted in ("material", *where):
        if names.count(wanted) != 1:
            raise DataError(f'{path}, line {line}: column "{shown(wanted)}" is not there once')
    columns = [i for i, n in enumerate(names) if re.match(r"[\d.]", n)]
    frequencies = _bands([header[i] for i in columns], f"{path}, line {line}", "the bands' columns")
    materials = []
    for line, cells in rows[1:]:
        place = f"{path}, line {line}"
        if len(cells) != len(header):
            raise DataError(f"{place}: {len(cells)} cells; the header has {len(header)}")
        if any(cells[names.index(c)][0] != v for c, v in where.items()):
            continue
        alpha, spans = material_list.coefficients([cells[i] for i in columns], place)
        materials.append(
            ListedMaterial(
                name=cells[names.index("material")][0],
                line=line,
                alpha=alpha,
                centre_frequencies=frequencies,
                spans=spans,
                decimals=DECIMALS,
            )
        )
    if not materials:
        raise DataError(f"{path}, line {line}: no row is selected")
    return tuple(materials)


def _new(room: Room) -> bytes:
    rows = ["material," + ",".join(f"{f:g}" for f in room.centre_frequencies)]
    for i, name in enumerate(room.materials):
        if "," in name or not name.isprintable() or name.strip() != name or not name:
            raise DataError(f"material {name!r}: a name in this table has no comma, on one line")
        rows.append(name + "," + ",".join(f"{a:.{DECIMALS}f}" for a in room.alpha[i]))
    return ("\n".join(rows) + "\n").encode("utf-8")


_FORMAT = Format(parse=parse, new=_new)
read, write = _FORMAT.read, _FORMAT.write


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
        (line, [cell.strip() for cell in raw.split(",")])
        for line, _, raw in lines(decode(content, place).characters)
        if raw.strip()
    ]
    if not rows or rows[0][1] != ["material", "sigma"]:
        return {m.name: m for m in parse(content, place).materials}
    sigma: dict[str, ListedMaterial | float] = {}
    for line, cells in rows[1:]:
        if len(cells) != 2:
            raise DataError(f"{place}, line {line}: {len(cells)} cells; the header has 2")
        if cells[0] in sigma:
            raise DataError(f'{place}, line {line}: "{cells[0]}" is given twice')
        value = number(cells[1], f"{place}, line {line}")
        if not 0 <= value <= 1:
            raise DataError(f"{place}, line {line}: sigma {value:g} is not in [0, 1]")
        sigma[cells[0]] = value
    return sigma
