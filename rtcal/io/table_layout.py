"""The layout of a table: lines before the header, headers of two lines, units, what columns hold."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from rtcal.io.table_columns import (
    DOUBTFUL,
    UNIT_WORDS,
    WHOLE_RANGES,
    Column,
    column_of,
    frequency_of,
    is_count,
    is_missing,
    is_unused,
    name_and_unit,
    parameter_of,
    plain,
    position_of,
    repeat_of,
    statistic_of,
)
from rtcal.io.text import shown
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

MAX_COLUMNS = 1000
MAX_LINES_BEFORE_HEADER = 40

_KNOWN_START = re.compile(r"[A-Za-z]")
_BARE_NUMBER = re.compile(r"[\d.,]+")
_INDEX = re.compile(r"Unnamed: \d+")
"""The header of a column of row numbers that pandas has written and read again."""
_MOST_NAMED = 6
"""Largest number of unknown columns that a message names."""

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


def layout_of(
    sheet: Sheet, *, decay_time: str | None, extra_columns: Collection[str] = ()
) -> list[TableLayout]:
    """Return the tables of a sheet: one, or several below each other.

    They are several if each names its parameter in its header's corner, or if the header is repeated.

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
    headers = Headers(sheet.place, decay_time, extra_columns)
    rows = list(sheet.rows)
    starts = headers.corners(rows) or headers.repeated(rows)
    blocks = [rows[a:b] for a, b in pairwise([0, *starts[1:], len(rows)])]
    layouts = [headers.layout(block, [sheet.note]) for block in blocks]
    return [replace(layouts[0], notes=(*layouts[0].notes, *sheet.notes)), *layouts[1:]]


def has_header(sheet: Sheet, decay_time: str | None) -> bool:
    """Return whether a row names a column by more than a number."""
    headers = Headers(sheet.place, decay_time, ())
    return any(headers.names(cells)[0] > 1 for _, cells in sheet.rows[:MAX_LINES_BEFORE_HEADER])


class Headers:
    """Finds the header of a table and reads its columns."""

    def __init__(self, path: str, decay_time: str | None, extra_columns: Collection[str]) -> None:
        self.path, self.decay_time = path, decay_time
        self.extra_columns = extra_columns

    def column(self, header: str, place: str, among: Sequence[str] = ()) -> Column | None:
        """Return the column of a header, None for an unknown one.

        "R2" is a correlation, or a receiver ``among`` headers of which another is one.
        """
        if header in self.extra_columns:
            return Column("", header)
        own = position_of(header) if is_unused(header) else None
        if own and any(position_of(other) and not is_unused(other) for other in among):
            return Column("data", header, source=own[0], receiver=own[1])
        return column_of(header, place, self.decay_time)

    def names(self, cells: list[str]) -> tuple[int, bool]:
        """Return the number of cells that name a column by more than a number, and whether all do."""
        count, complete = 0, True
        placed = any(map(position_of, cells))
        for cell in filter(None, cells):
            if placed and statistic_of(cell) is not None:
                continue
            if (
                "\t" in cell or ";" in cell
            ):  # several cells, where a comma is taken to separate them
                complete = False
                continue
            try:
                column = self.column(cell, "", cells)
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
        named = {
            i: self.names(rows[i][1])[0]
            for i in several
            if len(rows[i][1]) <= MAX_COLUMNS
            and not frequency_of(rows[i][1][0])  # a band that begins a row of values
        }
        most = max(named, key=lambda i: named[i], default=None)
        return most if most is not None and named[most] else (several or [0])[0]

    def corners(self, rows: list[Row]) -> list[int]:
        """Return the rows whose first cell names a parameter, and all others bands or positions."""
        return [
            i
            for i, (_, cells) in enumerate(rows)
            if cells[0] and _KNOWN_START.match(cells[0]) and self.is_corner(cells)
        ]

    def repeated(self, rows: list[Row]) -> list[int]:
        """Return the rows at which tables with one header begin, with the titles above each."""
        header = rows[self.header(rows)][1]
        starts = []
        for i, (_, cells) in enumerate(rows):
            if cells == header:
                while i and sum(map(bool, rows[i - 1][1])) == 1:
                    i -= 1
                starts.append(i)
        return starts

    def is_corner(self, cells: list[str]) -> bool:
        """Return whether a row is a header whose first cell names the parameter."""
        if len(cells) > MAX_COLUMNS:
            return False
        while cells and not cells[-1]:
            cells = cells[:-1]
        try:
            columns = [
                Column("", cell)
                if i and statistic_of(cell) is not None
                else self.column(cell, "", cells)
                for i, cell in enumerate(cells)
            ]
        except DataError:
            return False
        return len(columns) > 1 and all(columns) and _has_corner([c for c in columns if c])

    def layout(self, rows: list[Row], notes: list[str]) -> TableLayout:
        """Return a table, with its header and what stands before it."""
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
            self.check_above(rows[at - 1] if at else (0, []), columns)
        if columns[0] == _ROW_NUMBERS:
            notes.append("the first column has the rows' numbers, and is left out")
        if below := _text_below(columns, body):
            body = body[: -len(below)]
            first = next(filter(None, below[0][1]))
            notes.append(
                f'from line {below[0][0]} on it is no table: "{shown(first, 60)}"; left out'
            )
        rows_of_width = [(at, self.of_width(cells, len(columns), at)) for at, cells in body]
        titles = [next(filter(None, c)) for _, c in rows[:at] if sum(map(bool, c)) == 1]
        return TableLayout(tuple(columns), line, tuple(rows_of_width), tuple(notes), tuple(titles))

    def of_width(self, cells: list[str], width: int, line: int) -> list[str]:
        """Return a row's cells; DataError unless there are as many as columns."""
        while len(cells) > width and not cells[-1]:
            cells = cells[:-1]
        if len(cells) != width:
            raise DataError(
                f"{self.path}, line {line}: {len(cells)} cells; the header has {width}; "
                "what stands below a table is to be deleted"
            )
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
        columns, name, n_completed, unplaced = [], "", 0, list[str]()
        of_positions = any(map(position_of, top))
        try:
            for upper, lower in zip(top, below, strict=True):
                name = upper or name
                if of_positions and not (statistic_of(name) in (None, DOUBTFUL) or is_count(name)):
                    columns.append(Column("", name))
                    continue
                over = self.column(name, f"{self.path}, line {line}", top) if name else None
                under = (
                    self.column(lower, f"{self.path}, line {below_line}", below) if lower else None
                )
                both = over.completed(under) if over and under else None
                if of_positions and name and not both and under and under.kind == "data":
                    unplaced.append(name)
                column = both or (under if lower else over if upper else None)
                if column is None:
                    return None
                n_completed += both is not None
                columns.append(column)
        except DataError:
            return None
        if n_completed > 1 and unplaced:
            raise DataError(
                f'{self.path}, line {line}: "{shown(unplaced[0])}" is no position as those beside '
                "it are: delete its columns; or, if it is a position, name its receiver, as R7"
            )
        return columns if n_completed > 1 else None

    def with_units(
        self, header: list[str], body: list[Row], words: Collection[str] = UNIT_WORDS
    ) -> tuple[list[str], list[Row], int | None]:
        """Return the header with the units of the line below it, the rows after it, and its number."""
        if not body:
            return header, body, None
        line, cells = body[0]
        units = (cells + [""] * len(header))[: len(header)]
        is_unit = [u.strip("[]()").lower() in words for u in units]
        named = [u for u, is_word in zip(units, is_unit, strict=True) if is_word and u not in "-1"]
        if not named or not all(
            is_word or not u for u, is_word in zip(units, is_unit, strict=True)
        ):
            return header, body, None
        units = [u.strip("[]()") for u in units]
        with_unit = [
            f"{h} [{u}]" if u and name_and_unit(h)[1].lower() != u.lower() else h
            for h, u in zip(header, units, strict=True)
        ]
        return with_unit, body[1:], line

    def columns(self, header: list[str], body: list[Row], line: int) -> list[Column]:
        """Return what each column holds; DataError names those that hold nothing known."""
        place = f"{self.path}, line {line}"
        header = ["" if _INDEX.fullmatch(name) else name for name in header]
        columns, unknown = [], []
        of_positions, of_bands = any(map(position_of, header)), any(map(frequency_of, header))
        for i, name in enumerate(header):
            statistic = statistic_of(name) if of_positions and i else None
            if statistic is not None:
                cells = [row[i] for _, row in body if len(row) > i and not is_missing(row[i])]
                counts = not is_count(name) or all(cell.isdecimal() for cell in cells)
                if statistic == DOUBTFUL or not counts:
                    raise DataError(
                        f'{place}: column "{shown(name)}" may be a statistic or a position: delete it; '
                        "or, if it is a position, name its receiver, as R7"
                    )
                columns.append(Column("", name))
                continue
            cells = [row[i] for _, row in body if len(row) > i and row[i]]
            column = self.column(name, place, header) if name else Column("") if not cells else None
            if column is None and plain(name) in WHOLE_RANGES and of_bands:
                column = Column("", name)
            if column is None and i == 0 and not name:
                column = Column("first")
            if column is None and not name:
                raise DataError(
                    f"{place}: column {i + 1} has values and no name; name it, or delete it"
                )
            if column is None:
                unknown.append(name)
            columns.append(column or Column("", name))
        if not any(c.kind for c in columns) and all(map(_BARE_NUMBER.fullmatch, unknown)):
            raise DataError(
                f"{place}: no line names columns by a parameter, a band or a position; put one above "
                'the values, such as "Frequency [Hz];T20 [s]"'
            )
        if unknown:
            raise DataError(f"{place}: {_unknown(unknown)}")
        first = [r[0] for _, r in body if r and r[0]]
        if columns and columns[0].kind == "first":
            columns[0] = self.unnamed(columns[1:], first)
        across = [i for i, c in enumerate(columns) if c.kind == "band"]
        if across and any(c.has_band for c in columns):
            names = [r[across[0]] for _, r in body if len(r) > across[0] and r[across[0]]]
            if any(map(self.is_parameter, names)):  # "Band (Hz)" is said of the header
                columns[across[0]] = replace(columns[across[0]], kind="parameter")
        if _has_corner(columns):
            columns = _without_corner(columns)
        placed = {"source", "receiver"} & {c.kind for c in columns}
        of_files = "" if placed else "receiver"
        columns = [replace(c, kind=of_files) if c.kind == "file" else c for c in columns]
        self.check_twice(columns, place)
        return columns

    def check_above(self, above: Row, columns: Sequence[Column]) -> None:
        """Raise DataError for positions above a header without any, if they are not read with it."""
        line, cells = above
        placed = any(c.receiver or c.kind in ("source", "receiver") for c in columns)
        several = sum(map(bool, cells[1:])) > 1
        if several and not placed and (named := next(filter(position_of, cells), "")):
            other = next((c for c in cells if c and not position_of(c)), named)
            raise DataError(
                f'{self.path}, line {line}: "{shown(named)}" is a position, and "{shown(other)}" none; '
                "name one above the columns of each, and delete the others"
            )

    def check_twice(self, columns: list[Column], place: str) -> None:
        """Raise DataError for two columns of one meaning."""
        for kind in {c.kind for c in columns} - {"data", ""}:
            if [c.kind for c in columns].count(kind) > 1:
                raise DataError(f"{place}: two columns are the {kind}")
        headers = [c.header for c in columns if c.kind == "data" and c.receiver]
        for header in headers:
            if headers.count(header) > 1:
                raise DataError(
                    f'{place}: column "{shown(header)}" is there {headers.count(header)} times; if '
                    "they are repeats of one place, state repeats=True; if tables stand beside each "
                    "other, keep each on a sheet or in a file of its own"
                )

    def unnamed(self, others: list[Column], cells: list[str]) -> Column:
        """Return the meaning of a first column without header, which follows from its cells."""
        kinds = {c.kind for c in others}
        numbers = [str(n) for n in range(len(cells))]
        if cells == numbers and len(cells) > 1 and kinds & {"band", "receiver", "source"}:
            return _ROW_NUMBERS
        named = any(c.parameter or c.receiver for c in others)
        if named and all(frequency_of(c) for c in cells):
            return Column("band")
        if any(c.has_band for c in others) and all(self.is_parameter(c) for c in cells):
            return Column("parameter")
        return Column("receiver")

    def is_parameter(self, cell: str) -> bool:
        """Return whether a cell names a parameter."""
        try:
            return parameter_of(name_and_unit(cell)[0], "", self.decay_time) is not None
        except DataError:
            return True


_ROW_NUMBERS = Column("", "")


def _unknown(names: list[str]) -> str:
    """Return what is said of columns that are none, with what can be done about them."""
    some = names[:_MOST_NAMED]
    quoted = first_of([f'"{shown(name)}"' for name in names], _MOST_NAMED)
    options = " ".join(f'ignore="{shown(name)}"' for name in some)
    one = len(names) == 1
    are, them = ("is", "it") if one else ("are", "them")
    if any(map(repeat_of, names)):
        return (
            f"column{'' if one else 's'} {quoted} {are} no parameter, band, source or receiver; "
            "if they are repeats of one place, state repeats=True"
        )
    return (
        f"column{'' if one else 's'} {quoted} {are} no parameter, band, source or receiver; "
        f"leave {them} out with {options}, or delete {them}; or read the rows of one room or state "
        f'only: where={{"{shown(names[0])}": "..."}}'
    )


def _text_below(columns: list[Column], body: list[Row]) -> list[Row]:
    """Return the last rows of a table, if they are no part of it and begin with a word.

    In a table of bands down they are no bands. Else they have one cell, which is no position's name.
    """
    if columns[0].kind != "band":
        end = len(body)
        while end and len(columns) > 2 and _is_remark(body[end - 1][1], len(columns)):
            end -= 1
        return body[end:]
    bands = [
        i for i, (_, c) in enumerate(body) if frequency_of(c[0]) or plain(c[0]) in WHOLE_RANGES
    ]
    below = body[bands[-1] + 1 :] if bands else []
    return below if below and _KNOWN_START.match(below[0][1][0]) else []


def _is_remark(cells: list[str], width: int) -> bool:
    """Return whether a row is a text alone, which a separator in it may divide into few cells."""
    only = [cell for cell in cells if cell]
    whole = len(only) == 1 or (len(cells) < width and not any(map(_is_entry, only)))
    return whole and only[0] == cells[0] and " " in only[0] and not position_of(only[0])


def _is_entry(cell: str) -> bool:
    """Return whether a cell is a number or says that there is none."""
    return is_missing(cell) or bool(_BARE_NUMBER.fullmatch(cell.lstrip("+-")))


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
