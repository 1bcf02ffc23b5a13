"""Tables in text (CSV) whose columns have names of their own, and hold numbers above 0.

Columns are separated as in `rtcal.io.tables`, and lines that begin with # are comments. Decimals may
have a comma if columns are not separated by commas, or if the cell is quoted. Headers may state units.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rtcal.io.table_columns import name_and_unit
from rtcal.io.table_text import rows_of_text
from rtcal.io.text import MAX_TEXT, decode, number, shown
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.files import read_bytes
from rtcal.support.types import Array


class ColumnKind(NamedTuple):
    """A column: its spellings in small letters, and the factor of each unit; "" is that of none."""

    spellings: tuple[str, ...]
    units: Mapping[str, float]


@dataclass(frozen=True)
class NamedColumns:
    """Values of the columns that were found, (n_rows,) each, by name.

    ``headers`` and ``units`` are those of the file, and ``lines`` the number of each row's line.
    """

    place: str
    values: Mapping[str, Array]
    headers: Mapping[str, str]
    units: Mapping[str, str]
    lines: tuple[int, ...]

    def at(self, name: str, row: int) -> str:
        """Return the place of a value for messages."""
        return f'{self.place}, line {self.lines[row]}, column "{self.headers[name]}"'


def read(path: str | os.PathLike[str], kinds: Mapping[str, ColumnKind]) -> NamedColumns:
    """Return the columns of a file that are of these kinds; others are left out.

    Raises DataError, with line and column, for a unit that is not known, a column that stands there
    twice, a row of more cells than the header, and a value that is no number above 0.
    """
    place = os.fspath(checks.path("path", path))
    (first, header), *rows = rows_of_text(decode(read_bytes(path, MAX_TEXT), place), place)
    for line, cells in rows:
        if any(cells[len(header) :]):
            raise DataError(
                f"{place}, line {line}: {len(cells)} cells; the header has {len(header)}. If decimals "
                "have a comma, separate columns by ;"
            )
    columns: dict[str, tuple[int, str]] = {}
    for k, cell in enumerate(header):
        word, unit = _word_and_unit(cell)
        name = next((n for n, kind in kinds.items() if word in kind.spellings), None)
        if name in columns:
            raise DataError(f'{place}, line {first}: the column "{name}" stands there twice')
        if name is not None:
            known = {u.lower(): u for u in kinds[name].units}
            if unit not in known:
                raise DataError(
                    f'{place}, line {first}: the unit of "{shown(cell)}" is not known; known are '
                    f"{', '.join(filter(None, known.values()))}"
                )
            columns[name] = k, known[unit]
    used = [cells[k] if k < len(cells) else "" for _, cells in rows for k, _ in columns.values()]
    comma = any("," in cell for cell in used)
    if comma and any("." in cell for cell in used):
        raise DataError(f"{place}: decimal commas and decimal points in one table")
    table = NamedColumns(
        place,
        {n: np.zeros(len(rows)) for n in columns},
        {n: header[k] for n, (k, _) in columns.items()},
        {n: unit for n, (_, unit) in columns.items()},
        tuple(line for line, _ in rows),
    )
    for name, (k, unit) in columns.items():
        for i, (_, cells) in enumerate(rows):
            cell, at = cells[k] if k < len(cells) else "", table.at(name, i)
            value = number(cell.replace(",", ".") if comma else cell, at)
            if not value > 0:
                raise DataError(f"{at}: {value:g} is not above 0")
            table.values[name][i] = value * kinds[name].units[unit]
    return table


def _word_and_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header in small letters, as "decay / 1/s" has them, too."""
    bracketed = header.endswith((")", "]"))
    parts = name_and_unit(header) if bracketed or "/" not in header else header.split("/", 1)
    return parts[0].strip().lower(), parts[1].strip().lower()
