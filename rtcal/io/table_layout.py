"""The layout of a table: separator, lines before the header, headers of two lines, units."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise

from rtcal.errors import DataError
from rtcal.io.table_columns import (
    STATISTICS,
    UNIT_WORDS,
    Column,
    column_of,
    frequency_of,
    parameter_of,
    position_of,
)
from rtcal.io.text import Text, lines, shown

MAX_COLUMNS = 200
MAX_LINES_BEFORE_HEADER = 40
SEPARATORS = (";", "\t", ",")

_KNOWN_START = re.compile(r"[A-Za-z]")
_BARE_NUMBER = re.compile(r"[\d.,]+")

Row = tuple[int, list[str]]
"""The number of a line, and its cells."""


@dataclass(frozen=True)
class TableLayout:
    """A table, divided into columns and rows.

    Parameters
    ----------
    columns : sequence of Column (n_columns,)
    header_line : int
        Line of the file, from 1.
    rows : sequence of (line, cells)
        Each with n_columns cells.
    notes : sequence of str
        How the text differs from a plain table.
    titles : sequence of str
        What stands alone in its row before the header.
    """

    columns: tuple[Column, ...]
    header_line: int
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    titles: tuple[str, ...] = ()

    def cells(self, kind: str) -> list[str]:
        """Return the cells of the columns of a kind (`Column.kind`)."""
        columns = [i for i, c in enumerate(self.columns) if c.kind == kind]
        return [cells[i] for i in columns for _, cells in self.rows]


@dataclass(frozen=True)
class Sheet:
    """The cells of one table of a file, which a format's module has made of the file's content.

    Parameters
    ----------
    place : str
        The table's name in messages: the file's, and the sheet's of a workbook.
    rows : sequence of (line, cells)
    note : str
        How the cells were read, the first line of the report.
    name : str
        The table's own name, which may state a parameter or a position; empty without one.
    position : (str, str)
        Source and receiver of values whose rows and columns name none; empty if not known.
    notes : sequence of str
        What else is to be told.
    """

    place: str
    rows: tuple[Row, ...]
    note: str
    name: str = ""
    position: tuple[str, str] = ("", "")
    notes: tuple[str, ...] = ()


def sheet_of_text(
    text: Text, path: str, *, decay_time: str | None, extra_columns: Collection[str] = ()
) -> Sheet:
    """Return the cells of a table's text; the separator is the one with which a header is complete.

    Raises DataError for a text that is no table of cells. The arguments are those of `layout_of`.
    """
    stated, characters = _stated_separator(text.characters)
    first = next((raw for _, _, raw in lines(characters) if _has_cells(raw)), "")
    candidates = [stated] if stated else [s for s in SEPARATORS if s in characters] or [","]
    headers = _Headers(path, decay_time, extra_columns)
    tables: dict[str, list[Row]] = {}
    for separator in candidates:
        try:
            tables[separator] = _rows(characters, separator, path)
        except DataError:
            if len(candidates) == 1:
                raise
    chosen = next((s for s, rows in tables.items() if headers.complete(rows) is not None), None)
    if chosen is None:
        # The separator that names most columns, so that the message is of the header, not of a title.
        named = {s: headers.names(rows[headers.header(rows)][1])[0] for s, rows in tables.items()}
        best = max(named.values(), default=0)
        likely = [s for s in candidates if named.get(s, 0) == best]
        chosen = next((s for s in likely if s in first), likely[0])
    rows = tables[chosen] if chosen in tables else _rows(characters, chosen, path)
    note = f"text in {text.encoding}, columns separated by {chosen!r}"
    return Sheet(path, tuple(rows), note)


def layout_of(
    sheet: Sheet, *, decay_time: str | None, extra_columns: Collection[str] = ()
) -> list[TableLayout]:
    """Return the tables of a sheet: one, or several below each other if each names its parameter.

    Parameters
    ----------
    sheet : Sheet
    decay_time : str or None
        The decay time in a column "RT60".
    extra_columns : collection of str
        Headers of columns that hold no values.

    Raises
    ------
    DataError
        If no line is a header, or a row has another number of cells than the header.
    """
    headers = _Headers(sheet.place, decay_time, extra_columns)
    rows = list(sheet.rows)
    starts = headers.corners(rows)
    blocks = [rows[a:b] for a, b in pairwise([0, *starts[1:], len(rows)])]
    layouts = [headers.layout(block, [sheet.note]) for block in blocks]
    return [replace(layouts[0], notes=(*layouts[0].notes, *sheet.notes)), *layouts[1:]]


def has_header(sheet: Sheet, decay_time: str | None) -> bool:
    """Return whether a row names a column by more than a number."""
    headers = _Headers(sheet.place, decay_time, ())
    return any(headers.names(cells)[0] > 1 for _, cells in sheet.rows[:MAX_LINES_BEFORE_HEADER])


def _stated_separator(characters: str) -> tuple[str | None, str]:
    """Return the separator that Excel's first line "sep=;" states; the line is left empty."""
    head, _, tail = characters.partition("\n")
    line = head.strip().strip('"').lower()
    if line.startswith("sep=") and len(line) == 5:
        return line[-1], "\n" + tail
    if line == "sep=":  # a tab is stripped with the blanks
        return "\t", "\n" + tail
    return None, characters


def _has_cells(raw: str) -> bool:
    return bool(raw.strip(" \t;,")) and not raw.lstrip().startswith("#")


def _rows(characters: str, separator: str, path: str) -> list[Row]:
    """Return the rows with the number of their first line; comments and empty rows are left out."""
    raw_lines = [raw if _has_cells(raw) else "" for _, _, raw in lines(characters)]
    reader = csv.reader((f"{raw}\n" for raw in raw_lines), delimiter=separator, strict=True)
    rows: list[Row] = []
    line = 0
    while True:
        line = reader.line_num + 1
        try:
            cells = next(reader)
        except StopIteration:
            break
        except csv.Error as error:
            raise DataError(f"{path}, line {line}: not a row of cells: {error}") from error
        cells = [" ".join(part.strip() for part in c.strip().split("\n")) for c in cells]
        if any(cells):
            rows.append((line, cells))
    if len(rows) < 2:
        raise DataError(f"{path}, line 1: a header and at least one row are needed")
    return rows


class _Headers:
    """Finds the header of a table and reads its columns."""

    def __init__(self, path: str, decay_time: str | None, extra_columns: Collection[str]) -> None:
        self.path, self.decay_time = path, decay_time
        self.extra_columns = extra_columns

    def column(self, header: str, place: str) -> Column | None:
        if header in self.extra_columns:
            return Column("", header)
        return column_of(header, place, self.decay_time)

    def names(self, cells: list[str]) -> tuple[int, bool]:
        """Return the number of cells that name a column by more than a number, and whether all do."""
        count, complete = 0, True
        for cell in filter(None, cells):
            try:
                column = self.column(cell, "")
            except DataError:  # a name with an unknown unit or band
                count += not _BARE_NUMBER.fullmatch(cell)
                complete = False
                continue
            complete &= column is not None
            count += column is not None and not _BARE_NUMBER.fullmatch(cell)
        return count, complete

    def complete(self, rows: list[Row]) -> int | None:
        """Return the row whose cells all name columns, None without such a row."""
        for i, (_, cells) in enumerate(rows[:MAX_LINES_BEFORE_HEADER]):
            if sum(map(bool, cells)) + (not cells[0]) < 2 or len(cells) > MAX_COLUMNS:
                continue
            count, complete = self.names(cells)
            if complete and count:
                return i
            if count >= 2:
                return None
        return None

    def header(self, rows: list[Row]) -> int:
        """Return the header's row: `complete`, or the row in which most cells name columns."""
        complete = self.complete(rows)
        if complete is not None:
            return complete
        several = [
            i
            for i, (_, cells) in enumerate(rows[:MAX_LINES_BEFORE_HEADER])
            if sum(map(bool, cells)) > 1
        ]
        named = [i for i in several if len(rows[i][1]) <= MAX_COLUMNS and self.names(rows[i][1])[0]]
        return (named or several or [0])[0]

    def corners(self, rows: list[Row]) -> list[int]:
        """Return the rows whose first cell names a parameter, and all others bands or positions."""
        return [
            i
            for i, (_, cells) in enumerate(rows)
            if cells[0] and _KNOWN_START.match(cells[0]) and self.is_corner(cells)
        ]

    def is_corner(self, cells: list[str]) -> bool:
        if len(cells) > MAX_COLUMNS:
            return False
        while cells and not cells[-1]:
            cells = cells[:-1]
        try:
            columns = [self.column(cell, "") for cell in cells]
        except DataError:
            return False
        return len(columns) > 1 and all(columns) and _has_corner([c for c in columns if c])

    def layout(self, rows: list[Row], notes: list[str]) -> TableLayout:
        at = self.header(rows)
        if at:
            notes.append(f"the header is line {rows[at][0]}; what stands before it is left out")
        line, header = rows[at]
        while header and not header[-1]:  # a separator at the end of every line
            header = header[:-1]
        if len(header) > MAX_COLUMNS:
            place = f"{self.path}, line {line}"
            raise DataError(f"{place}: {len(header)} columns; at most {MAX_COLUMNS}")
        body = rows[at + 1 :]
        columns = self.merged(header, body, line)
        if columns is not None:
            notes.append(f"lines {line} and {body[0][0]} are one header of merged cells")
            body = body[1:]
        else:
            header, body, unit_line = self.with_units(header, body)
            if unit_line:
                notes.append(f"line {unit_line} has the units")
            columns = self.columns(header, body, line)
        rows_of_width = [(at, self.of_width(cells, len(columns), at)) for at, cells in body]
        titles = [next(filter(None, c)) for _, c in rows[:at] if sum(map(bool, c)) == 1]
        return TableLayout(tuple(columns), line, tuple(rows_of_width), tuple(notes), tuple(titles))

    def of_width(self, cells: list[str], width: int, line: int) -> list[str]:
        while len(cells) > width and not cells[-1]:
            cells = cells[:-1]
        if len(cells) != width:
            raise DataError(f"{self.path}, line {line}: {len(cells)} cells; the header has {width}")
        return cells

    def merged(self, top: list[str], body: list[Row], line: int) -> list[Column] | None:
        """Return the columns of a header of two lines, None if the header has one.

        A cell of the upper line extends over several columns: in CSV the first has the name and the
        others are empty. The cells of the lower line add the band or the parameter.
        """
        if not body or not any(top):
            return None
        below_line, below = body[0]
        width = max(len(top), max((i + 1 for i, c in enumerate(below) if c), default=0))
        below = (below + [""] * width)[:width]
        top = (top + [""] * width)[:width]
        first = next(i for i, c in enumerate(top) if c)
        if not any(not top[i] and below[i] for i in range(first, width)):
            return None
        columns, name, n_completed = [], "", 0
        try:
            for upper, lower in zip(top, below, strict=True):
                name = upper or name
                over = self.column(name, f"{self.path}, line {line}") if name else None
                under = self.column(lower, f"{self.path}, line {below_line}") if lower else None
                both = over.completed(under) if over and under else None
                column = both or (under if lower else over if upper else None)
                if column is None:
                    return None
                n_completed += both is not None
                columns.append(column)
        except DataError:
            return None
        return columns if n_completed > 1 else None

    def with_units(
        self, header: list[str], body: list[Row]
    ) -> tuple[list[str], list[Row], int | None]:
        """Return the header with the units of the line below it, the rows after it, and its number."""
        if not body:
            return header, body, None
        line, cells = body[0]
        units = (cells + [""] * len(header))[: len(header)]
        is_unit = [u.strip("[]()").lower() in UNIT_WORDS for u in units]
        named = [u for u, is_word in zip(units, is_unit, strict=True) if is_word and u not in "-1"]
        if not named or not all(
            is_word or not u for u, is_word in zip(units, is_unit, strict=True)
        ):
            return header, body, None
        with_unit = [
            f"{h} [{u.strip('[]()')}]" if u else h for h, u in zip(header, units, strict=True)
        ]
        return with_unit, body[1:], line

    def columns(self, header: list[str], body: list[Row], line: int) -> list[Column]:
        place = f"{self.path}, line {line}"
        columns = []
        of_positions = any(map(position_of, header))
        for i, name in enumerate(header):
            if of_positions and i and name.lower() in STATISTICS:
                columns.append(Column("", name))
                continue
            cells = [row[i] for _, row in body if len(row) > i and row[i]]
            column = self.column(name, place) if name else Column("") if not cells else None
            if column is None and i == 0 and not name:
                columns.append(Column("first"))
                continue
            if column is None:
                raise DataError(
                    f'{place}: column "{shown(name)}" is no parameter, band, source or receiver; '
                    f'leave it out with ignore="{shown(name)}", or delete it'
                )
            columns.append(column)
        if columns and columns[0].kind == "first":
            columns[0] = self.unnamed(columns[1:], [r[0] for _, r in body if r and r[0]])
        if _has_corner(columns):
            columns = _without_corner(columns)
        for kind in {c.kind for c in columns} - {"data", ""}:
            if [c.kind for c in columns].count(kind) > 1:
                raise DataError(f"{place}: two columns are the {kind}")
        return columns

    def unnamed(self, others: list[Column], cells: list[str]) -> Column:
        """Return the meaning of a first column without header, which follows from its cells."""
        named = any(c.parameter or c.receiver for c in others)
        if named and all(frequency_of(c) for c in cells):
            return Column("band")
        if any(c.has_band for c in others) and all(self.is_parameter(c) for c in cells):
            return Column("parameter")
        return Column("receiver")

    def is_parameter(self, cell: str) -> bool:
        try:
            return parameter_of(cell, "", self.decay_time) is not None
        except DataError:
            return True


def _has_corner(columns: list[Column]) -> bool:
    """Return whether the first column names the parameter of all others, which name none."""
    first, others = columns[0], [c for c in columns[1:] if c.kind == "data"]
    return bool(
        first.kind == "data"
        and first.parameter
        and not first.has_band
        and others
        and not any(c.parameter for c in others)
        and (all(c.has_band for c in others) or all(c.receiver for c in others))
    )


def _without_corner(columns: list[Column]) -> list[Column]:
    """Return the columns with the first one's parameter; its cells are positions or bands."""
    first = columns[0]
    across = next(c for c in columns[1:] if c.kind == "data")
    named = [
        replace(
            c, parameter=first.parameter, unit=first.unit, decay_time_open=first.decay_time_open
        )
        if c.kind == "data"
        else c
        for c in columns[1:]
    ]
    return [Column("receiver" if across.has_band else "band", first.header), *named]
