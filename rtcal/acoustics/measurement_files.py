"""A measurement in CSV, the native format. The codec of `rtcal.acoustics.measurement.Measurement`.

One row per value. An empty value is missing. Lines that begin with # are notes::

    source,receiver,parameter,band,value
    S1,R1,T20,500,1.92

Parameters: T20, T30, EDT, Ts in s; C50, C80, G in dB; D50 and STI as fractions; the band in Hz.
Optional columns: ``uncertainty`` (standard uncertainty of the value) and ``common_uncertainty``
(beside it, the part that all pairs of a band have in common, the same in each of their rows). A row
over several pairs has source and receiver ``*``, and may have ``standard_deviation`` over the pairs,
``sources`` and ``receivers``. A receiver ``R1#2`` is a repeat of
``R1``: one position, with the repeats' mean.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import OBSERVABLES, SUMMARY, parameter_label
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers, read_text
from rtcal.support.schema import FileTable, Number
from rtcal.support.types import Array

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_COLUMNS = ("source", "receiver", "parameter", "band", "value")
_OPTIONAL_COLUMNS = (
    "uncertainty",
    "common_uncertainty",
    "standard_deviation",
    "sources",
    "receivers",
)

Rows = list[list[Number | None]]
PerBand = list[Number | None]


class MeasurementData(FileTable):
    """A measurement as plain values, as `rtcal.Measurement.to_dict` returns them; None is missing."""

    centre_frequencies: list[Number]
    values: dict[str, Rows]
    pairs: tuple[tuple[str, str], ...] = ((SUMMARY, SUMMARY),)
    uncertainty: dict[str, Rows] = {}
    common_uncertainty: dict[str, PerBand] = {}
    standard_deviation: dict[str, PerBand] = {}
    n_sources: int | None = None
    n_receivers: int | None = None


MAX_BYTES = 2**21
MAX_CELLS = 2**20
"""Largest number of values in a file, pairs times bands times parameters; most may be empty."""


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the arguments of `Measurement` of a CSV file; DataError names file, line and rule."""
    if os.fspath(checks.path("path", path)).lower().endswith((".xlsx", ".xls")):
        raise DataError(
            f"{path}: a workbook, and no CSV: `rtcal table {path} --out t.csv` makes one of it"
        )
    # Not splitlines: it would also split at separators that may stand in a name.
    lines = read_text(path, MAX_BYTES).split("\n")
    numbered = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise DataError(f"{path}: no rows; the first must name the columns {', '.join(_COLUMNS)}")
    header = _header(numbered[0][1], f"{path}, line {numbered[0][0]}")
    rows: dict[tuple[str, str, str, float], dict[str, float]] = {}
    for number, line in numbered[1:]:
        place = f"{path}, line {number}"
        cells = _cells(line, place)
        if len(cells) != len(header):
            raise DataError(f"{place}: {len(cells)} cells; the header has {len(header)}")
        cell = dict(zip(header, (c.strip() for c in cells), strict=True))
        key, numbers = _row(cell, place)
        if key in rows:
            raise DataError(
                f"{place}: {parameter_label(key[2])} of {key[0]}, {key[1]} at "
                f"{bands.label(key[3])} is given twice; repeats at one place are {key[1]} and "
                f"{key[1]}#2"
            )
        rows[key] = numbers
    if not rows:
        raise DataError(f"{path}: no row with a value below the header")
    try:
        return of_single_values(rows)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _header(line: str, place: str) -> list[str]:
    header = [cell.strip().lower() for cell in _cells(line, place)]
    if repeated := next((c for c, n in Counter(header).items() if n > 1), None):
        raise DataError(f'{place}: column "{repeated}" is given twice')
    for column in _COLUMNS:
        if column not in header:
            raise DataError(
                f'{place}: column "{column}" is missing{_separator_note(line)}; `rtcal table` reads '
                "other tables"
            )
    for column in header:
        if column not in _COLUMNS + _OPTIONAL_COLUMNS:
            allowed = ", ".join(_COLUMNS + _OPTIONAL_COLUMNS)
            raise DataError(f'{place}: column "{column}" is not one of {allowed}')
    return header


def _separator_note(header: str) -> str:
    """Return words on a header that another character than the comma separates; "" else."""
    for separator, name in ((";", '";"'), ("\t", "tabs")):
        if header.count(separator) > header.count(","):
            return f', since columns are separated by {name} and not by ","'
    return ""


def _cells(line: str, place: str) -> list[str]:
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        raise DataError(f"{place}: not a line of comma-separated values: {error}") from error


def _row(
    cell: Mapping[str, str], place: str
) -> tuple[tuple[str, str, str, float], dict[str, float]]:
    parameter = cell["parameter"].lower()
    if parameter not in OBSERVABLES:
        allowed = ", ".join(OBSERVABLES)
        raise DataError(f'{place}: parameter "{cell["parameter"]}" is unknown; known: {allowed}')
    band = _cell(cell, "band", place)
    if not band > 0:
        raise DataError(f'{place}: band = "{cell["band"]}" is not a frequency above 0 Hz')
    numbers = {c: _cell(cell, c, place) for c in ("value", *_OPTIONAL_COLUMNS) if c in cell}
    OBSERVABLES[parameter].refuse(f"{place}: {cell['parameter']}", numbers["value"])
    for column in _OPTIONAL_COLUMNS:
        if numbers.get(column, 0.0) < 0:
            raise DataError(f"{place}: {column} = {numbers[column]:g} is below 0")
    return (cell["source"], cell["receiver"], parameter, bands.nominal(band)), numbers


def _cell(cell: Mapping[str, str], column: str, place: str) -> float:
    if not cell[column]:
        return float("nan")
    text = cell[column]
    if text.lower().lstrip("+-") in ("inf", "infinity", "nan"):
        raise DataError(f'{place}: {column} = "{text}" is not finite; leave it empty')
    if not _NUMBER.fullmatch(text) or not np.isfinite(float(text)):
        raise DataError(f'{place}: {column} = "{text[:40]}" is not a number')
    return float(text)


def of_single_values(
    rows: Mapping[tuple[str, str, str, float], Mapping[str, float]],
) -> dict[str, Any]:
    """Return the arguments of `Measurement`, from values by source, receiver, parameter and band.

    Each row has ``value`` and those optional columns of the file that it states; NaN is missing.
    """
    frequencies = {f: k for k, f in enumerate(sorted({key[3] for key in rows}))}
    pairs = {pair: i for i, pair in enumerate(dict.fromkeys(key[:2] for key in rows))}
    parameters = list(dict.fromkeys(key[2] for key in rows))
    if (SUMMARY, SUMMARY) in pairs and len(pairs) > 1:
        raise DataError(f'summary rows (source and receiver "{SUMMARY}") stand beside single pairs')
    shape = (len(pairs), len(frequencies))
    if shape[0] * shape[1] * len(parameters) > MAX_CELLS:
        raise DataError(
            f"{shape[0]} pairs, {shape[1]} bands and {len(parameters)} parameters are more than "
            f"{MAX_CELLS} values"
        )
    tables: dict[str, dict[str, Array]] = {c: {} for c in ("value", *_OPTIONAL_COLUMNS)}
    for (source, receiver, parameter, band), numbers in rows.items():
        for column, number in numbers.items():
            if column == "value" or np.isfinite(number):
                table = tables[column].setdefault(parameter, np.full(shape, np.nan))
                table[pairs[source, receiver], frequencies[band]] = number
    counts = {}
    for name in ("sources", "receivers"):
        stated = {n for table in tables[name].values() for n in table[np.isfinite(table)].tolist()}
        if len(stated) > 1:
            raise DataError(f"column {name} has several values; all rows must be over the same")
        for count in stated:
            if count != int(count) or count < 1:
                raise DataError(f"column {name} = {count:g} is not a whole number above 0")
        counts[f"n_{name}"] = int(stated.pop()) if stated else None
    of_bands: dict[str, dict[str, Array]] = {}
    for name in ("common_uncertainty", "standard_deviation"):
        of_bands[name] = {p: np.fmax.reduce(table) for p, table in tables[name].items()}
        for p, table in tables[name].items():
            if (differing := np.fmin.reduce(table) < of_bands[name][p]).any():
                label = bands.label(list(frequencies)[int(np.argmax(differing))])
                raise DataError(
                    f"{name} of {parameter_label(p)} at {label} has several values; all pairs of a "
                    "band share one"
                )
    return {
        "centre_frequencies": np.array(list(frequencies)),
        "pairs": list(pairs),
        "values": tables["value"],
        "uncertainty": tables["uncertainty"],
        **of_bands,
        **counts,
    }


def plain(measurement: Any) -> dict[str, Any]:
    """Return a `Measurement` as plain values for JSON, None where one is missing."""
    tables = ("values", "uncertainty", "common_uncertainty", "standard_deviation")
    return {
        "centre_frequencies": json_numbers(measurement.centre_frequencies),
        "pairs": [list(pair) for pair in measurement.pairs],
        **{
            name: {p: json_numbers(values) for p, values in getattr(measurement, name).items()}
            for name in tables
            if name != "common_uncertainty" or measurement.common_uncertainty
        },
        "n_sources": measurement.n_sources,
        "n_receivers": measurement.n_receivers,
    }


def rows(data: Mapping[str, Any]) -> list[list[Any]]:
    """Return the table of `Measurement.to_dict`'s dict: the header, and a row per value."""
    counts = {name: data[f"n_{name}"] for name in ("sources", "receivers")}
    used = [c for c in _OPTIONAL_COLUMNS if data.get(c) or counts.get(c) is not None]
    table: list[list[Any]] = [[*_COLUMNS, *used]]
    for parameter, values in data["values"].items():
        for i, (source, receiver) in enumerate(data["pairs"]):
            for k, band in enumerate(data["centre_frequencies"]):
                cells = [source, receiver, parameter.upper(), band, values[i][k]]
                for column in used:
                    of = data.get(column, {}).get(parameter)
                    per_pair = of[i] if of and column == "uncertainty" else of
                    cells.append(counts[column] if column in counts else per_pair and per_pair[k])
                table.append(cells)
    return table


def text(data: Mapping[str, Any]) -> str:
    """Return `Measurement.to_dict`'s dict as the text of its CSV file."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    for row in rows(data):
        writer.writerow([_cell_text(value) for value in row])
    return stream.getvalue()


def _cell_text(value: Any) -> Any:
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@")):
        return (
            f" {value}"  # a name, which Excel would take for a formula; readers leave the blank out
        )
    return repr(value) if isinstance(value, float) else "" if value is None else value
