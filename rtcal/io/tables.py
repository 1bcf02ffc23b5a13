"""Tables of measured values in CSV, as measuring systems and spreadsheets write them.

Three shapes are read, told by the header: *long*, one value a row, in the columns of the native file or
their usual spellings; *bands across*, one row for each parameter or position, one column a band;
*bands down*, one row for each band, one column a parameter. Columns are parted by ``;``, tab or ``,``;
decimals may have a comma where columns are not parted by one (or the cell is quoted). `read` says
how it took each column; nothing is guessed: what cannot be told is an error that says what to state.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands as _bands
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import DECAY_TIMES, UNITS, Measurement, plausible_time
from rtcal.errors import DataError
from rtcal.io.source import MAX_TEXT, number, shown
from rtcal.support.files import read_bytes
from rtcal.support.types import Array

MAX_COLUMNS, MAX_PAIRS = 200, 5000
_LEAST_BAND = 10.0  # Hz: a smaller number at the head of a column is a value

_PARAMETERS = {
    "t20": "t20",
    "rt20": "t20",
    "t60(20)": "t20",
    "t_20": "t20",
    "t30": "t30",
    "rt30": "t30",
    "t_30": "t30",
    "t60(30)": "t30",
    "edt": "edt",
    "t10": "edt",
    "earlydecaytime": "edt",
    "c50": "c50",
    "clarityc50": "c50",
    "c80": "c80",
    "clarityc80": "c80",
    "d50": "d50",
    "definition": "d50",
    "deutlichkeit": "d50",
    "ts": "ts",
    "centretime": "ts",
    "centertime": "ts",
    "schwerpunktzeit": "ts",
    "g": "g",
    "strength": "g",
    "soundstrength": "g",
}
_UNSTATED = {"rt", "rt60", "t60", "t", "reverberationtime", "nachhallzeit", "tr"}
_COLUMNS = {
    "source": "source",
    "src": "source",
    "quelle": "source",
    "sourceposition": "source",
    "receiver": "receiver",
    "rec": "receiver",
    "mic": "receiver",
    "microphone": "receiver",
    "position": "receiver",
    "pos": "receiver",
    "empfänger": "receiver",
    "mikrofon": "receiver",
    "receiverposition": "receiver",
    "measurement": "receiver",
    "parameter": "parameter",
    "quantity": "parameter",
    "metric": "parameter",
    "band": "band",
    "frequency": "band",
    "freq": "band",
    "f": "band",
    "frequenz": "band",
    "octaveband": "band",
    "centrefrequency": "band",
    "centerfrequency": "band",
    "value": "value",
    "wert": "value",
    "mean": "value",
    "unit": "unit",
    "einheit": "unit",
}
_SCALES: dict[str, dict[str, float]] = {
    "s": {"s": 1, "sec": 1, "ms": 1e-3},
    "dB": {"db": 1},
    "": {"%": 0.01, "percent": 0.01, "-": 1},
}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_MISSING = {"", "-", "--", "n/a", "na", "nan", "---"}


@dataclass(frozen=True)
class Table:
    """A measurement read from a table, and how each column was taken."""

    measurement: Measurement
    columns: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(self.columns)


@dataclass(frozen=True)
class _Column:
    kind: str  # source, receiver, parameter, band, value, unit, or a value's: "of"
    parameter: str = ""
    band: float = np.nan
    scale: float = 1.0


def read(
    path: str | os.PathLike[str], *, decay_time: str | None = None, parameter: str | None = None
) -> Table:
    """Read a table; DataError names file, line and rule.

    ``decay_time``, "t20" or "t30", says what a column "RT60" or "T60" holds; ``parameter`` what the
    values are where the table does not say it.
    """
    return parse(
        read_bytes(path, MAX_TEXT), os.fspath(path), decay_time=decay_time, parameter=parameter
    )


def write(measurement: Measurement, path: str | os.PathLike[str]) -> None:
    """Write the native CSV: long, one value a row."""
    measurement.save(os.fspath(path))


def parse(
    content: bytes,
    path: str = "table",
    *,
    decay_time: str | None = None,
    parameter: str | None = None,
) -> Table:
    """Return the measurement of a table's content; see `read`."""
    for name, choice, known in (
        ("decay_time", decay_time, DECAY_TIMES),
        ("parameter", parameter, tuple(UNITS)),
    ):
        if choice is not None and choice not in known:
            raise DataError(f'{name} = "{choice}" is none of {", ".join(known)}')
    rows, delimiter = _rows(content, path)
    (line, header), body = rows[0], rows[1:]
    if len(header) > MAX_COLUMNS:
        raise DataError(f"{path}, line {line}: {len(header)} columns; at most {MAX_COLUMNS}")
    columns = [_column(c, f"{path}, line {line}", decay_time) for c in header]
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
                    f"{place}: {key[2].upper()} of {key[0]}, {key[1]} at {_bands.label(key[3])} is "
                    "given twice"
                )
            values[key] = value
    if not values:
        raise DataError(f"{path}, line {line}: no row with a value below the header")
    report = [
        f"columns parted by {delimiter!r}, decimal {'comma' if comma else 'point'}",
        *(_told(c, h, parameter) for c, h in zip(columns, header, strict=True)),
    ]
    try:
        return Table(_assembled(values), tuple(report))
    except DataError as error:
        raise DataError(f"{path}, from line {line} on: {error}") from error


def _rows(content: bytes, path: str) -> tuple[list[tuple[int, list[str]]], str]:
    for encoding in ("utf-8-sig", "cp1252", "latin-1"):
        try:
            text = content.decode(encoding)
            break
        except UnicodeDecodeError:
            continue
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


def _parameter(text: str, place: str, decay_time: str | None) -> str | None:
    """Return the parameter that a spelling means, None if none; DataError for "RT60"."""
    key = re.sub(r"[\s_]+", "", text.lower())
    if key in _PARAMETERS:
        return _PARAMETERS[key]
    if key in _UNSTATED:
        if decay_time is None:
            raise DataError(
                f'{place}: "{_shown(text)}" does not say which decay time it is; state '
                'decay_time="t20" or "t30"'
            )
        return decay_time
    return None


def _frequency(text: str) -> float | None:
    match = re.fullmatch(r"(\d{1,6}(?:[.,]\d{1,3})?)\s*(k?)(?:Hz)?", text.strip(), re.I | re.ASCII)
    if not match:
        return None
    value = float(match.group(1).replace(",", ".")) * (1000 if match.group(2) else 1)
    return _bands.nominal(value) if value > 0 else None


def _band(frequency: float, place: str) -> float:
    """Return a nominal centre; DataError where there is none: a typing error, or no band at all."""
    if frequency not in (12.5, 16.0, *_bands.THIRD_OCTAVES):
        raise DataError(f"{place}: {frequency:g} Hz is no octave or third-octave (IEC 61260-1)")
    return frequency


def _column(cell: str, place: str, decay_time: str | None) -> _Column:
    match = re.fullmatch(r"([^\[\](]*(?:\(\d+\))?)\s*[\[(]?\s*([^\])]*?)\s*[\])]?", cell)
    name, unit = (match.group(1).strip(), match.group(2)) if match else (cell, "")
    frequency = _frequency(name if not unit or unit.lower() in ("hz", "khz") else cell)
    if frequency is not None:
        frequency *= 1000 if unit.lower() == "khz" else 1
        if frequency < _LEAST_BAND:
            raise DataError(
                f'{place}: column "{_shown(cell)}" is no band; is the line with the names of the '
                "columns missing?"
            )
        return _Column("of", band=_band(frequency, place))
    key = re.sub(r"[\s_]+", "", name.lower())
    if key in _COLUMNS:
        if unit and not (_COLUMNS[key] == "band" and unit.lower() == "hz"):
            raise DataError(f'{place}: column "{_shown(cell)}": the unit is not known')
        return _Column(_COLUMNS[key])
    parameter = _parameter(name, place, decay_time)
    if parameter is None:
        raise DataError(
            f'{place}: column "{_shown(cell)}" is no parameter, band, source or receiver'
        )
    return _Column("of", parameter, scale=_scale(parameter, unit, place))


def _scale(parameter: str, unit: str, place: str) -> float:
    scales = _SCALES[UNITS[parameter]]
    if unit and unit.lower() not in scales:
        raise DataError(
            f'{place}: {parameter.upper()} in "{_shown(unit)}"; known are {", ".join(scales)}'
        )
    return scales[unit.lower()] if unit else 1.0


def _decimal_comma(body: list[tuple[int, list[str]]], columns: list[_Column], path: str) -> bool:
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
    columns: list[_Column],
    place: str,
    comma: bool,
    decay_time: str | None,
    stated: str | None,
) -> list[tuple[tuple[str, str, str, float], float]]:
    held = {c.kind: cell for c, cell in zip(columns, cells, strict=True) if c.kind != "of"}
    source, receiver = held.get("source") or "S1", held.get("receiver") or "R1"
    text_name(f"{place}: a position", source + receiver)
    row_parameter, row_band = stated, None
    if "parameter" in held:
        row_parameter = _parameter(held["parameter"], place, decay_time)
        if row_parameter is None:
            raise DataError(f'{place}: parameter "{_shown(held["parameter"])}" is unknown')
    if "band" in held:
        row_band = _frequency(held["band"])
        if row_band is None:
            raise DataError(f'{place}: band "{_shown(held["band"])}" is no frequency in Hz')
        row_band = _band(row_band, place)
    found = []
    for column, cell in zip(columns, cells, strict=True):
        if column.kind not in ("of", "value") or cell.lower() in _MISSING:
            continue
        parameter = column.parameter or row_parameter
        band = column.band if np.isfinite(column.band) else row_band
        if parameter is None:
            raise DataError(
                f'{place}: the table does not say what "{_shown(cell)}" is; state parameter'
            )
        if band is None:
            raise DataError(f'{place}: no band for the value "{_shown(cell)}"')
        scale = column.scale
        if not column.parameter:
            scale = _scale(parameter, held.get("unit", ""), place)
        value = scale * number(cell.replace(",", ".") if comma else cell, place)
        if parameter in DECAY_TIMES and not value > 0:
            raise DataError(f"{place}: {parameter.upper()} = {value:g} s is not above 0")
        if parameter in DECAY_TIMES:
            plausible_time(f"{place}: {parameter.upper()}", value, parameter)
        if parameter == "d50" and not 0 <= value <= 1:
            raise DataError(f"{place}: D50 = {value:g} is not in [0, 1]; percent need their unit")
        found.append(((source, receiver, parameter, float(band)), value))
    return found


def _told(column: _Column, header: str, stated: str | None) -> str:
    if column.kind != "of":
        meaning = column.kind
    else:
        known = column.parameter or stated
        meaning = known.upper() if known else "the row's parameter"
        if np.isfinite(column.band):
            meaning += f" at {_bands.label(column.band)}"
        if column.scale != 1:
            meaning += f", times {column.scale:g}"
    return f'"{header}": {meaning}'


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


def _shown(text: str) -> str:
    return shown(text.encode("utf-8", "replace").decode("latin-1"))
