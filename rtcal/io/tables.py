"""Tables of measured values in CSV, as measuring systems and spreadsheets write them.

The header decides between three shapes:

- *long*: one value per row, in the columns of the native file or their usual spellings;
- *bands across*: one row per parameter or position, one column per band;
- *bands down*: one row per band, one column per parameter.

Columns are separated by ``;``, tab or ``,``. Decimals may have a comma where columns are not separated
by one, or where the cell is quoted. Nothing is guessed: the result says how each column was read, and
an error says what must be stated.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import DECAY_TIMES, UNITS, plausible_time
from rtcal.errors import DataError
from rtcal.io.table_columns import (
    Column,
    column_of,
    frequency_of,
    nominal_band,
    parameter_of,
    scale_of,
)
from rtcal.io.text import MAX_TEXT, decode, number, shown
from rtcal.support.files import read_bytes
from rtcal.support.types import Array

MAX_COLUMNS, MAX_PAIRS = 200, 5000

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_MISSING = {"", "-", "--", "n/a", "na", "nan", "---"}


@dataclass(frozen=True)
class Table:
    """A measurement read from a table, and how each column was read."""

    measurement: Measurement
    columns: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(self.columns)


def read(
    path: str | os.PathLike[str], *, decay_time: str | None = None, parameter: str | None = None
) -> Table:
    """Return a table's measurement.

    Parameters
    ----------
    path : path
    decay_time : {"t20", "t30"}, optional
        What a column "RT60" or "T60" holds.
    parameter : str, optional
        What the values are where the table does not say it.

    Raises
    ------
    DataError
        Naming file, line and rule.
    """
    return parse(
        read_bytes(path, MAX_TEXT), os.fspath(path), decay_time=decay_time, parameter=parameter
    )


def write(measurement: Measurement, path: str | os.PathLike[str]) -> None:
    """Write the native CSV: one value per row."""
    measurement.save(os.fspath(path))


def parse(
    content: bytes,
    path: str = "table",
    *,
    decay_time: str | None = None,
    parameter: str | None = None,
) -> Table:
    """Return the measurement of a table's content; see `read`."""
    for name, choice, choices in (
        ("decay_time", decay_time, DECAY_TIMES),
        ("parameter", parameter, tuple(UNITS)),
    ):
        if choice is not None and choice not in choices:
            raise DataError(f'{name} = "{choice}" is none of {", ".join(choices)}')
    rows, delimiter = _rows(content, path)
    (line, header), body = rows[0], rows[1:]
    if len(header) > MAX_COLUMNS:
        raise DataError(f"{path}, line {line}: {len(header)} columns; at most {MAX_COLUMNS}")
    columns = [column_of(c, f"{path}, line {line}", decay_time) for c in header]
    kinds = [c.kind for c in columns]
    for kind in set(kinds) - {"of"}:
        if kinds.count(kind) > 1:
            raise DataError(f"{path}, line {line}: two columns are the {kind}")
    comma = _decimal_comma(body, columns, path)
    values: dict[tuple[str, str, str, float], float] = {}
    for at, cells in body:
        place = f"{path}, line {at}"
        if len(cells) != len(header):
            raise DataError(f"{place}: {len(cells)} cells; the header has {len(header)}")
        for key, value in _row(cells, columns, place, comma, decay_time, parameter):
            if key in values:
                raise DataError(
                    f"{place}: {key[2].upper()} of {key[0]}, {key[1]} at {bands.label(key[3])} is "
                    "given twice"
                )
            values[key] = value
    if not values:
        raise DataError(f"{path}, line {line}: no row with a value below the header")
    report = [
        f"columns separated by {delimiter!r}, decimal {'comma' if comma else 'point'}",
        *(c.description(h, parameter) for c, h in zip(columns, header, strict=True)),
    ]
    try:
        return Table(_assembled(values), tuple(report))
    except DataError as error:
        raise DataError(f"{path}, from line {line} on: {error}") from error


def _rows(content: bytes, path: str) -> tuple[list[tuple[int, list[str]]], str]:
    text = decode(content, path).characters
    numbered = [
        (at, line)
        for at, line in enumerate(text.replace("\r\n", "\n").split("\n"), start=1)
        if line.strip(" \t;,\r") and not line.lstrip().startswith("#")
    ]
    if len(numbered) < 2:
        raise DataError(f"{path}, line 1: a header and at least one row are needed")
    first = numbered[0][1]
    delimiter = next((d for d in (";", "\t") if d in first), ",")
    rows = []
    for at, line in numbered:
        try:
            cells = next(csv.reader([line], delimiter=delimiter, strict=True))
        except (csv.Error, StopIteration) as error:
            raise DataError(f"{path}, line {at}: not a row of cells: {error}") from error
        rows.append((at, [c.strip() for c in cells]))
    while all(r[1] and not r[1][-1] for r in rows):  # a delimiter at the end of every line
        rows = [(at, cells[:-1]) for at, cells in rows]
    return rows, delimiter


def _decimal_comma(body: list[tuple[int, list[str]]], columns: list[Column], path: str) -> bool:
    commas = points = 0
    for at, cells in body:
        for cell, column in zip(cells, columns, strict=False):
            if column.kind in ("of", "value") and _NUMBER.fullmatch(cell):
                commas += "," in cell
                points += "." in cell
        if commas and points:
            raise DataError(f"{path}, line {at}: decimal commas and decimal points in one table")
    return commas > 0


def _row(
    cells: list[str],
    columns: list[Column],
    place: str,
    comma: bool,
    decay_time: str | None,
    stated: str | None,
) -> list[tuple[tuple[str, str, str, float], float]]:
    cell_of = {c.kind: cell for c, cell in zip(columns, cells, strict=True) if c.kind != "of"}
    source, receiver = cell_of.get("source") or "S1", cell_of.get("receiver") or "R1"
    text_name(f"{place}: a position", source + receiver)
    row_parameter, row_band = stated, None
    if "parameter" in cell_of:
        row_parameter = parameter_of(cell_of["parameter"], place, decay_time)
        if row_parameter is None:
            raise DataError(f'{place}: parameter "{shown(cell_of["parameter"])}" is unknown')
    if "band" in cell_of:
        row_band = frequency_of(cell_of["band"])
        if row_band is None:
            raise DataError(f'{place}: band "{shown(cell_of["band"])}" is no frequency in Hz')
        row_band = nominal_band(row_band, place)
    keyed = []
    for column, cell in zip(columns, cells, strict=True):
        if column.kind not in ("of", "value") or cell.lower() in _MISSING:
            continue
        parameter = column.parameter or row_parameter
        band = column.band if np.isfinite(column.band) else row_band
        if parameter is None:
            raise DataError(
                f'{place}: the table does not say what "{shown(cell)}" is; state parameter'
            )
        if band is None:
            raise DataError(f'{place}: no band for the value "{shown(cell)}"')
        scale = column.scale
        if not column.parameter:
            scale = scale_of(parameter, cell_of.get("unit", ""), place)
        value = scale * number(cell.replace(",", ".") if comma else cell, place)
        if parameter in DECAY_TIMES and not value > 0:
            raise DataError(f"{place}: {parameter.upper()} = {value:g} s is not above 0")
        if parameter in DECAY_TIMES:
            plausible_time(f"{place}: {parameter.upper()}", value, parameter)
        if parameter == "d50" and not 0 <= value <= 1:
            raise DataError(f"{place}: D50 = {value:g} is not in [0, 1]; percent need their unit")
        keyed.append(((source, receiver, parameter, float(band)), value))
    return keyed


def _assembled(values: Mapping[tuple[str, str, str, float], float]) -> Measurement:
    pairs = {pair: i for i, pair in enumerate(dict.fromkeys(key[:2] for key in values))}
    frequencies = {f: k for k, f in enumerate(sorted({key[3] for key in values}))}
    if len(pairs) > MAX_PAIRS or len(frequencies) > MAX_COLUMNS:
        raise DataError(
            f"{len(pairs)} positions, {len(frequencies)} bands; at most {MAX_PAIRS}, {MAX_COLUMNS}"
        )
    tables: dict[str, Array] = {}
    for (source, receiver, parameter, band), value in values.items():
        if parameter not in tables:
            tables[parameter] = np.full((len(pairs), len(frequencies)), np.nan)
        tables[parameter][pairs[source, receiver], frequencies[band]] = value
    return Measurement(
        centre_frequencies=np.array(list(frequencies)), pairs=tuple(pairs), values=tables
    )
