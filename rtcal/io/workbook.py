"""Workbooks of Excel (xlsx), read and written by openpyxl (``rtcal[tables]``).

A number has the value that the file stores, whatever digits Excel shows. A cell shown in percent is
read with its unit. A cell that is merged over several rows fills them. Hidden sheets, rows and columns
are left out, and said.

Refused by name: xls and other binary formats, a formula without its stored value, a date where Excel
has taken a number for one.
"""

from __future__ import annotations

import datetime
import io
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import zip_longest
from pathlib import Path
from typing import Any

from rtcal.io import budget
from rtcal.io.text import Row, Sheet, shown
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

ENDING = ".xlsx"
MAX_SHEETS = 200
MAX_ROWS, MAX_COLUMNS = 20_000, 400
_MOST_NAMED = 6
MAX_NAME = 31
"""Largest length of a sheet's name in Excel."""

_ZIP = b"PK\x03\x04"
_OTHERS = {
    b"\xd0\xcf\x11\xe0": "Excel's old format (xls); save it as xlsx",
    b"%PDF": "a PDF; copy its table into a workbook (xlsx) or a CSV",
    b"\x89PNG": "a picture; type its table into a workbook (xlsx) or a CSV",
}
_NOT_IN_NAMES = dict.fromkeys(map(ord, "[]:*?/\\"), " ")


def recognises(content: bytes) -> bool:
    """Return whether a file is a workbook, or another format that is no text."""
    return content.startswith((_ZIP, *_OTHERS))


def sheets(content: bytes, path: str, where: Mapping[str, str]) -> list[Sheet]:
    """Return the visible sheets of a workbook that are not empty."""
    for start, is_format in _OTHERS.items():
        if content.startswith(start):
            raise DataError(f"{path}: {is_format}")
    _check_size(content, path)
    values, formulas = (_workbook(content, path, stored) for stored in (True, False))
    visible = [s for s in values.worksheets if s.sheet_state == "visible"]
    budget.require(len(visible), MAX_SHEETS, "sheets", path)
    hidden = [f'"{shown(s.title)}"' for s in values.worksheets if s.sheet_state != "visible"]
    notes = [f"left out, hidden: {', '.join(hidden)}"] if hidden else []
    found = []
    for sheet in visible:
        name, place = sheet.title, f'{path}, sheet "{shown(sheet.title)}"'
        rows, of_sheet = _rows(sheet, formulas[name], place)
        if rows:
            note = f'workbook, sheet "{shown(name)}"'
            found.append(Sheet(place, tuple(rows), note, name, notes=(*notes, *of_sheet)))
            notes = []
    if not found:
        raise DataError(f"{path}: the visible sheets are empty")
    return found


def _check_size(content: bytes, path: str) -> None:
    """Raise DataError for what is no workbook, or declares more than the budget."""
    sizes = budget.members(content, path, "a workbook (xlsx)")
    if "xl/workbook.xml" not in sizes:
        raise DataError(f"{path}: is a zip file, but not a workbook (xlsx); save it as xlsx")
    cells = 0
    with _parsing(path), zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in (n for n in sizes if n.lower().endswith(".xml")):
            part = budget.without_entities(archive.read(name), f"{path}: {name}")
            if "worksheets/" in name:
                cells += len(_CELL.findall(part)) + sum(map(_area, _MERGED.findall(part)))
            elif name.startswith("xl/styles"):
                budget.require(part.count(b"<"), budget.MAX_CELLS, "parts of styles", path)
    budget.require(
        cells, budget.MAX_CELLS, "cells", path, "copy its table into a workbook of its own"
    )


_CELL = re.compile(rb"<(?:\w+:)?c[\s/>]")
_MERGED = re.compile(rb"""<(?:\w+:)?mergeCell\s[^>]*?ref\s*=\s*["']([^"']*)""")


def _area(merged: bytes) -> int:
    """Return the number of cells of a range such as A1:C9."""
    left, top, right, bottom = _library().utils.range_boundaries(merged.decode())
    return int((1 + abs(right - left)) * (1 + abs(bottom - top)))


def _workbook(content: bytes, path: str, stored: bool) -> Any:
    """Return openpyxl's workbook: with the stored values of formulas, or the formulas."""
    openpyxl = _library()
    with _parsing(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on charts and rules of cells, which are not read
        return openpyxl.load_workbook(io.BytesIO(content), data_only=stored)


def _parsing(path: str) -> AbstractContextManager[None]:
    return budget.parsing(path, "a workbook (xlsx)", "Save it as xlsx again", "tables")


def _rows(values: Any, formulas: Any, place: str) -> tuple[list[Row], list[str]]:
    """Return the rows of a sheet that have a cell, as text, and notes."""
    n_rows, n_columns = values.max_row, values.max_column
    budget.require(n_rows, MAX_ROWS, "rows", place)
    budget.require(n_columns, MAX_COLUMNS, "columns", place)
    budget.require(n_rows * n_columns, budget.MAX_CELLS, "cells", place)
    filled = {
        (row, merged.min_col): (merged.min_row, merged.min_col)
        for merged in values.merged_cells.ranges
        for row in range(merged.min_row + 1, merged.max_row + 1)
    }
    hidden_rows = [n for n, row in values.row_dimensions.items() if row.hidden and n <= n_rows]
    of_groups = [c for c in values.column_dimensions.values() if c.hidden]
    hidden_columns = {n for c in of_groups for n in range(c.min, min(c.max, n_columns) + 1)}
    rows: list[Row] = []
    struck = []
    for n, cells in enumerate(values.iter_rows(), start=1):
        struck += [cell.coordinate for cell in cells if cell.font.strike]
        at = [filled.get((n, c.column), (n, c.column)) for c in cells]
        seen = [place_of for place_of in at if place_of[1] not in hidden_columns]
        if n in hidden_rows:
            continue
        texts = [_text(values.cell(*of), formulas.cell(*of), place) for of in seen]
        if any(texts):
            rows.append((n, texts))
    width = max((i + 1 for _, texts in rows for i, text in enumerate(texts) if text), default=0)
    letter = _library().utils.get_column_letter
    names = [str(n) for n in sorted(hidden_rows)], [letter(n) for n in sorted(hidden_columns)]
    notes = [
        f"left out, hidden: {what}{'s' * (len(some) > 1)} {first_of(some, _MOST_NAMED)}"
        for what, some in zip(("row", "column"), names, strict=True)
        if some
    ]
    if struck:
        notes.append(f"struck through, and read: {first_of(struck, 1)}; empty what is withdrawn")
    return [(n, texts[:width]) for n, texts in rows], notes


def _text(cell: Any, formula: Any, place: str) -> str:
    """Return a cell's content as text: a number with all its digits, and with % if shown so."""
    value = cell.value
    if value is None:
        if isinstance(formula.value, str) and formula.value.startswith("="):
            raise DataError(
                f"{place}, cell {cell.coordinate}: the value of this formula is not stored; open "
                "the file in Excel or LibreOffice and save it"
            )
        return ""
    if isinstance(value, bool):
        return str(value).upper()
    if isinstance(value, (int, float)):
        if "%" in (cell.number_format or ""):
            return f"{float(format(100 * value, '.15g'))!r}%"
        return repr(value)
    if isinstance(value, (datetime.datetime, datetime.date, datetime.time)):
        # A title may be a date. As a value it is refused as no number, and this says why.
        return f"{value} (Excel's date)"
    return " ".join(str(value).split())


def content(tables: Mapping[str, Sequence[Sequence[Any]]]) -> bytes:
    """Return the bytes of a workbook with one sheet per table."""
    openpyxl = _library()
    book = openpyxl.Workbook()
    book.remove(book.active)
    names: dict[str, str] = {}
    for title, rows in tables.items():
        name = title.translate(_NOT_IN_NAMES)[:MAX_NAME].strip() or "table"
        if (other := names.setdefault(name.casefold(), title)) != title:
            raise DataError(
                f'tables "{other}" and "{title}" would have the same name in Excel: "{name}"'
            )
        sheet = book.create_sheet(name)
        for i, row in enumerate(rows, start=1):
            for k, value in enumerate(row, start=1):
                cell = sheet.cell(row=i, column=k)
                cell.value = _plain(value)
                if cell.data_type == "f":  # a name that begins with = is no formula
                    cell.data_type = "s"
                if i == 1:
                    cell.font = openpyxl.styles.Font(bold=True)
        sheet.freeze_panes = "A2"
        for k, cells in enumerate(zip_longest(*rows, fillvalue=""), start=1):
            longest = max(len(value) + 2 if isinstance(value, str) else 8 for value in cells)
            letter = openpyxl.utils.get_column_letter(k)
            sheet.column_dimensions[letter].width = min(max(longest, 8), 60)
    stream = io.BytesIO()
    with _Undated(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        openpyxl.writer.excel.ExcelWriter(book, archive).save()
    return stream.getvalue()


class _Undated(zipfile.ZipFile):
    """A zip whose files have no date of their own: it has no place for one before 1980."""

    def writestr(self, zinfo_or_arcname: Any, data: Any, *_: Any, **__: Any) -> None:
        info = zipfile.ZipInfo(getattr(zinfo_or_arcname, "filename", zinfo_or_arcname))
        info.compress_type = self.compression
        super().writestr(info, data)

    def write(self, filename: Any, arcname: Any = None, *_: Any, **__: Any) -> None:
        self.writestr(str(arcname or filename), Path(filename).read_bytes())


def _plain(value: Any) -> Any:
    """Return a number or text as Excel has it; None for a number that is not finite."""
    if isinstance(value, str):
        return "".join(c if c.isprintable() else " " for c in value)
    if value is None or isinstance(value, (bool, int)):
        return value
    number = float(value)
    return number if abs(number) < float("inf") else None


def _library() -> Any:
    needed = "workbooks (xlsx) need openpyxl: pip install 'rtcal[tables]'"
    return library(needed, "openpyxl", "openpyxl.styles", "openpyxl.utils", "openpyxl.writer.excel")
