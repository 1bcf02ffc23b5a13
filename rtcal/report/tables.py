"""Every table of a saved result as sheets of a workbook, to which a client's own workbook can refer.

The sheets follow from the record's own shape, so that all results are written alike:

- ``summary``: each single number or text, by its name in the record;
- ``bands``: one row per band, one column per quantity of the bands;
- one sheet per list of entries, such as ``materials``: one row per entry, and one column per quantity,
  or one per band where the quantity has one value per band.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rtcal.acoustics import bands
from rtcal.errors import DataError
from rtcal.io import workbook
from rtcal.support.arguments import checked
from rtcal.support.decode import json_object
from rtcal.support.files import read_text
from rtcal.support.results import MAX_BYTES, NUMBERS

Table = list[list[Any]]

_FOR_PROGRAMS = {"object", "inputs", "settings"}
"""Entries that only rtcal reads: the result's pieces, and the text of its input files."""


@checked
def write(result: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write the tables of a saved result, a folder or its result.json, as a workbook (xlsx).

    Raises DataError for a file that is no result, and MissingDependencyError without openpyxl.
    """
    file = Path(result, NUMBERS) if Path(result).is_dir() else Path(result)
    try:
        record = json_object(read_text(file, MAX_BYTES))
    except DataError as error:
        raise DataError(f"{file}: {error}") from error
    if "rtcal" not in record:
        raise DataError(f'{file}: no result of rtcal, since it lacks the key "rtcal"')
    workbook.write(tables_of(record), path)


def tables_of(record: Mapping[str, Any]) -> dict[str, Table]:
    """Return the tables of a result's record by the name of their sheet, each with its header.

    Examples
    --------
    >>> tables_of({"room": "hall", "centre_frequencies": [125, 250], "gap_jnd": [1.5, -2.0]})
    {'summary': [['quantity', 'value'], ['room', 'hall']], 'bands': [['band / Hz', 'gap_jnd'], \
[125, 1.5], [250, -2.0]]}
    """
    frequencies = list(record.get("centre_frequencies", ()))
    labels = [bands.label(f) for f in frequencies]
    summary: Table = [["quantity", "value"]]
    of_bands: dict[str, Sequence[Any]] = {}
    lists: dict[str, Table] = {}
    for name, value in _entries(record, ""):
        if name == "centre_frequencies":
            continue
        if isinstance(value, (str, int, float, bool)) or value is None:
            summary.append([name, value])
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            lists[name] = _listed(value, labels)
        elif _is_row(value, len(frequencies)):
            of_bands[name] = value
        elif isinstance(value, list) and value and all(map(_is_single, value)):
            summary.append([name, ", ".join(map(str, value))])
        elif isinstance(value, list) and value and all(isinstance(v, list) for v in value):
            lists[name] = [_columns(value, labels), *(list(map(_cell, row)) for row in value)]
    across = [[f, *(column[k] for column in of_bands.values())] for k, f in enumerate(frequencies)]
    tables = {"summary": summary}
    if of_bands:
        tables["bands"] = [["band / Hz", *of_bands], *across]
    return tables | lists


def _entries(record: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    """Return the entries of a record by name; those of a record in it as "outer inner"."""
    found: list[tuple[str, Any]] = []
    for key, value in record.items():
        if not prefix and key in _FOR_PROGRAMS:
            continue
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found += _entries(value, f"{name} ")
        else:
            found.append((name, value))
    return found


def _listed(entries: Sequence[Mapping[str, Any]], labels: Sequence[str]) -> Table:
    """Return a list's table: a row per entry, and a column per band where a value has one per band."""
    flat = [dict(_entries(entry, " ")) for entry in entries]
    names = list(dict.fromkeys(name for entry in flat for name in entry))
    header: list[Any] = []
    rows: Table = [[] for _ in entries]
    for name in names:
        values = [entry.get(name) for entry in flat]
        if labels and all(v is None or _is_row(v, len(labels)) for v in values) and any(values):
            header += [f"{name.strip()} {label}" for label in labels]
            for row, value in zip(rows, values, strict=True):
                row += value if value is not None else [None] * len(labels)
        else:
            header.append(name.strip())
            for row, value in zip(rows, values, strict=True):
                row.append(_cell(value))
    return [header, *rows]


def _columns(rows: Sequence[Sequence[Any]], labels: Sequence[str]) -> list[Any]:
    width = max(map(len, rows))
    return list(labels) if width == len(labels) else [f"column {k + 1}" for k in range(width)]


def _is_single(value: Any) -> bool:
    return isinstance(value, (str, int, float, bool)) or value is None


def _is_row(value: Any, n_bands: int) -> bool:
    return isinstance(value, list) and len(value) == n_bands > 0 and all(map(_is_single, value))


def _cell(value: Any) -> Any:
    """Return a value for one cell: itself, or a list's values in words."""
    if _is_single(value):
        return value
    if isinstance(value, list):
        return "; ".join(str(v) for v in value)
    raise DataError(f"{value!r} is no value of a cell")
