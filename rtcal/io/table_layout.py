"""Text as rows of cells, and the layout of a table: lines before the header, units, merged headers.

Columns of text are separated by one of `SEPARATORS` or aligned by blanks: the header decides which.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from rtcal.io.table_columns import (
    OPEN,
    UNIT_WORDS,
    WHOLE_RANGES,
    Column,
    column_of,
    frequency_of,
    is_doubtful,
    is_missing,
    is_unused,
    name_and_unit,
    parameter_of,
    plain,
    position_of,
    repeat_of,
    statistic_of,
)
from rtcal.io.text import Text, lines, shown
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

MAX_COLUMNS = 1000
MAX_LINES_BEFORE_HEADER = 40
SEPARATORS = (";", "\t", "|", ",")

_GAP = re.compile(r"(?<=\S)(?: {2,}|\t[ \t]*)")
"""What separates columns that are aligned by blanks."""
_WORD = re.compile(r"[A-Za-z]")
_BARE_NUMBER = re.compile(r"[\d.,]+")
_INDEX = re.compile(r"Unnamed: \d+")
"""The header of a column of row numbers that pandas has written and read again."""
_MOST_NAMED = 6
"""Largest number of unknown columns that a message names."""
_ROW_NUMBERS = Column("", "")
OF_POSITIONS = "of positions"
"""Kind of a column of a statistic over the positions beside it, which is left out."""

Row = tuple[int, list[str]]
"""The number of a line, and its cells."""


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


@dataclass(frozen=True)
class CellTable:
    """A table of a sheet, divided into columns and rows.

    Parameters
    ----------
    sheet : Sheet
    columns : sequence of Column (n_columns,)
    line : int
        Line of the header in the file, from 1.
    rows : sequence of (line, cells)
        Each with n_columns cells.
    notes : sequence of str
        How the text differs from a plain table.
    titles : sequence of str
        What stands alone in its row before the header.
    """

    sheet: Sheet
    columns: tuple[Column, ...]
    line: int
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    titles: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The header's name in messages."""
        return f"{self.sheet.place}, line {self.line}"

    def cells(self, kind: str) -> list[str]:
        """Return the cells of the columns of a kind (`Column.kind`)."""
        columns = [i for i, c in enumerate(self.columns) if c.kind == kind]
        return [cells[i] for i in columns for _, cells in self.rows]


def sheet_of_text(text: Text, path: str, extra_columns: Collection[str] = ()) -> Sheet:
    """Return the cells of a table's text; the separator is the one with which a header is complete.

    ``extra_columns`` are headers of columns that hold no values. Raises DataError for a text that is no
    table of cells.
    """
    stated, characters = _stated_separator(text.characters)
    aligned = not stated and not any(s in characters for s in SEPARATORS)
    if aligned:
        characters = _GAP.sub("\t", characters)
    first = next((raw for _, _, raw in lines(characters) if _has_cells(raw)), "")
    tables: dict[str, list[Row]] = {}
    ranks, errors = {}, []
    for separator in [stated] if stated else [s for s in SEPARATORS if s in characters] or [","]:
        try:
            rows = tables[separator] = _rows(characters, separator, path)
        except DataError as error:
            errors.append(error)
            continue
        at, complete = _header(rows, extra_columns)
        # Without a complete header, the message is to be of the header and not of a title: a title and
        # decimals may have commas, where most lines have equally many semicolons.
        n_named = _named(rows[at][1], extra_columns)[0]
        even = _is_even(rows)
        ranks[separator] = (9,) if complete else (0, n_named, even, even or separator in first)
    if not tables:
        raise errors[0]
    chosen = max(ranks, key=lambda separator: ranks[separator])
    by = "blanks" if aligned and chosen == "\t" else repr(chosen)
    note = f"text in {text.encoding}, columns separated by {by}"
    return Sheet(path, tuple(tables[chosen]), note)


def _is_even(rows: Sequence[Row]) -> bool:
    """Return whether half of the rows or more have equally many cells, and more than one."""
    widths = Counter(len(cells) for _, cells in rows if len(cells) > 1)
    return bool(widths) and 2 * max(widths.values()) >= max(len(rows), 4)


def _stated_separator(characters: str) -> tuple[str | None, str]:
    """Return the separator that Excel's first line "sep=;" states; the line is left empty."""
    head, _, tail = characters.partition("\n")
    line = head.strip().strip('"').lower()
    if line.startswith("sep=") and len(line) <= 5:  # a tab is stripped with the blanks
        return line[4:] or "\t", "\n" + tail
    return None, characters


def _has_cells(raw: str) -> bool:
    return bool(raw.strip(" \t;,")) and not raw.lstrip().startswith("#")


def _rows(characters: str, separator: str, path: str) -> list[Row]:
    """Return the rows with the number of their first line; comments and empty rows are left out."""
    raw_lines = [raw if _has_cells(raw) else "" for _, _, raw in lines(characters)]
    reader = csv.reader((f"{raw}\n" for raw in raw_lines), delimiter=separator, strict=True)
    rows: list[Row] = []
    line = 1
    try:
        for cells in reader:
            cells = [" ".join(part.strip() for part in c.strip().split("\n")) for c in cells]
            if any(cells):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise DataError(f"{path}, line {line}: not a row of cells: {error}") from error
    if len(rows) < 2:
        raise DataError(f"{path}, line 1: a header and at least one row are needed")
    return rows


def tables_of(
    sheet: Sheet, *, decay_time: str | None, extra_columns: Collection[str] = ()
) -> list[CellTable]:
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
    rows = list(sheet.rows)
    starts = [i for i, (_, cells) in enumerate(rows) if _is_corner(cells, extra_columns)]
    if not starts:
        header = rows[_header(rows, extra_columns)[0]][1]
        for i in (i for i, (_, cells) in enumerate(rows) if cells == header):
            while i and sum(map(bool, rows[i - 1][1])) == 1 and rows[i - 1][1] != header:  # a title
                i -= 1
            starts.append(i)
    blocks = [rows[a:b] for a, b in pairwise([0, *starts[1:], len(rows)])]
    tables = [_table(sheet, block, decay_time, extra_columns) for block in blocks]
    return [replace(tables[0], notes=(*tables[0].notes, *sheet.notes)), *tables[1:]]


def has_header(sheet: Sheet) -> bool:
    """Return whether a row names a column by more than a number."""
    return any(_named(cells)[0] > 1 for _, cells in sheet.rows[:MAX_LINES_BEFORE_HEADER])


def with_units(
    header: list[str], body: list[Row], words: Collection[str] = UNIT_WORDS
) -> tuple[list[str], list[Row], int | None]:
    """Return the header with the units of the line below it, the rows after it, and its number."""
    line, cells = body[0] if body else (0, [])
    cells = (cells + [""] * len(header))[: len(header)]
    units = [cell.strip("[]()") for cell in cells]
    if any(u and u.lower() not in words for u in units) or all(cell in "-1" for cell in cells):
        return header, body, None
    with_unit = [
        f"{h} [{u}]" if u and name_and_unit(h)[1].lower() != u.lower() else h
        for h, u in zip(header, units, strict=True)
    ]
    return with_unit, body[1:], line


def of_width(cells: list[str], width: int, place: str) -> list[str]:
    """Return a row's cells; DataError unless there are as many as columns."""
    while len(cells) > width and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != width:
        raise DataError(
            f"{place}: {len(cells)} cells; the header has {width}; what stands below a table is to be "
            "deleted"
        )
    return cells


def _columns_in(header: Sequence[str], extra: Collection[str] = ()) -> list[Column | None]:
    """Return the column of each cell of a header, None for an unknown one.

    "R2" is a correlation, or a receiver among headers of which another is one. Among positions, a
    statistic such as "Mean" is of the kind `OF_POSITIONS`.
    """
    places = [position_of(name) for name in header]
    several = any(p and not is_unused(name) for p, name in zip(places, header, strict=True))
    columns: list[Column | None] = []
    for i, (name, place) in enumerate(zip(header, places, strict=True)):
        if name in extra:
            columns.append(Column("", name))
        elif place and several:
            columns.append(Column("data", name, source=place[0], receiver=place[1]))
        elif i and any(places) and statistic_of(name) is not None:
            columns.append(Column(OF_POSITIONS, name))
        else:
            columns.append(column_of(name) if name else None)
    return columns


def _named(cells: Sequence[str], extra: Collection[str] = ()) -> tuple[int, bool]:
    """Return the number of cells that name a column by more than a number, and whether all do."""
    named = [
        (column, not _BARE_NUMBER.fullmatch(cell))
        for cell, column in zip(cells, _columns_in(cells, extra), strict=True)
        if cell and not (column and column.kind == OF_POSITIONS)
    ]
    count = sum(by_word for column, by_word in named if column)
    return count, all(column is not None and not column.wrong for column, _ in named)


def _header(rows: Sequence[Row], extra: Collection[str]) -> tuple[int, bool]:
    """Return the header's row, and whether all of its cells name columns; else most do."""
    counts: dict[int, int] = {}
    several = []
    complete = True
    for i, (_, cells) in enumerate(rows[:MAX_LINES_BEFORE_HEADER]):
        filled = sum(map(bool, cells))
        if filled > 1:
            several.append(i)
        if len(cells) > MAX_COLUMNS or filled + (not cells[0]) < 2:
            continue
        count, all_named = _named(cells, extra)
        if complete and all_named and count:
            return i, True
        complete &= count < 2
        if filled > 1 and not frequency_of(cells[0]):  # a band begins a row of values
            counts[i] = count
    most = max(counts, key=lambda i: counts[i], default=None)
    return (most if most is not None and counts[most] else (several or [0])[0]), False


def _is_corner(cells: list[str], extra: Collection[str]) -> bool:
    """Return whether a row is a header whose first cell names the parameter of bands or positions."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    if not 1 < len(cells) <= MAX_COLUMNS or not _WORD.match(cells[0]):
        return False
    columns = _columns_in(cells, extra)
    return not any(c is None or c.wrong for c in columns) and _has_corner([c for c in columns if c])


def _table(
    sheet: Sheet, rows: list[Row], decay_time: str | None, extra: Collection[str]
) -> CellTable:
    """Return a table, with its header and what stands before it."""
    at, notes = _header(rows, extra)[0], [sheet.note]
    line, header = rows[at]
    place = f"{sheet.place}, line {line}"
    if at:
        notes.append(f"the header is line {line}; what stands before it is left out")
    while header and not header[-1]:  # a separator at the end of every line
        header = header[:-1]
    if len(header) > MAX_COLUMNS:
        raise DataError(f"{place}: {len(header)} columns; at most {MAX_COLUMNS}")
    body = rows[at + 1 :]
    columns = _merged(header, body, place, extra)
    if columns is not None:
        notes.append(f"lines {line} and {body[0][0]} are one header of merged cells")
        body = body[1:]
    else:
        header, body, unit_line = with_units(header, body)
        if unit_line:
            notes.append(f"line {unit_line} has the units")
        columns = _columns(header, body, place, extra)
        _refuse_positions_above(rows[at - 1] if at else (0, []), columns, sheet.place)
    columns = _resolved(columns, decay_time, place)
    if columns[0] == _ROW_NUMBERS:
        notes.append("the first column has the rows' numbers, and is left out")
    if below := _text_below(columns, body):
        body = body[: -len(below)]
        first = next(filter(None, below[0][1]))
        notes.append(f'from line {below[0][0]} on it is no table: "{shown(first, 60)}"; left out')
    return CellTable(
        sheet=sheet,
        columns=tuple(columns),
        line=line,
        rows=tuple(
            (n, of_width(cells, len(columns), f"{sheet.place}, line {n}")) for n, cells in body
        ),
        notes=tuple(notes),
        titles=tuple(next(filter(None, c)) for _, c in rows[:at] if sum(map(bool, c)) == 1),
    )


def _resolved(columns: list[Column], decay_time: str | None, place: str) -> list[Column]:
    """Return the columns with the decay time of those called RT60."""
    for column in columns:
        if column.is_open and decay_time is None:
            raise DataError(f"{place}: {open_decay_time(column.header)}")
    return [replace(c, parameter=decay_time or OPEN) if c.is_open else c for c in columns]


def open_decay_time(name: str) -> str:
    """Return what a name such as "RT60" leaves open."""
    named = shown(name_and_unit(name)[0])
    states = 'state decay_time="t20" or decay_time="t30"'
    return f'"{named}" does not say which decay time it is; {states}'


def _merged(
    top: list[str], body: list[Row], place: str, extra: Collection[str]
) -> list[Column] | None:
    """Return the columns of a header of two lines, None if the header has one.

    A cell of the upper line extends over several columns: in CSV the first has the name and the
    others are empty. The cells of the lower line add the band or the parameter.
    """
    below = body[0][1] if body else []
    width = max(len(top), max((i + 1 for i, c in enumerate(below) if c), default=0))
    below, top = ((cells + [""] * width)[:width] for cells in (below, top))
    first = next((i for i, c in enumerate(top) if c), width)
    if all(top[i] or not below[i] for i in range(first, width)):
        return None
    for i in range(first + 1, width):
        top[i] = top[i] or top[i - 1]
    columns, unplaced, n_completed = [], list[str](), 0
    of_positions = any(map(position_of, top))
    for name, lower, over, under in zip(
        top, below, _columns_in(top, extra), _columns_in(below, extra), strict=True
    ):
        if over and over.kind == OF_POSITIONS and not is_doubtful(name, [name]):
            columns.append(Column("", name))
            continue
        if over and over.kind == OF_POSITIONS:
            over = column_of(name)
        both = over.completed(under) if over and under else None
        if of_positions and name and not both and under and under.kind == "data":
            unplaced.append(name)
        column = both or (under if lower else over)
        if column is None or column.wrong or column.kind == OF_POSITIONS:
            return None
        n_completed += both is not None
        columns.append(column)
    if n_completed > 1 and unplaced:
        raise DataError(
            f'{place}: "{shown(unplaced[0])}" is no position as those beside it are: delete its '
            "columns; or, if it is a position, name its receiver, as R7"
        )
    return columns if n_completed > 1 else None


def _columns(
    header: list[str], body: list[Row], place: str, extra: Collection[str]
) -> list[Column]:
    """Return what each column holds; DataError names those that hold nothing known."""
    header = ["" if _INDEX.fullmatch(name) else name for name in header]
    columns, unknown = [], []
    of_bands = any(map(frequency_of, header))
    for i, (name, column) in enumerate(zip(header, _columns_in(header, extra), strict=True)):
        cells = [row[i] for _, row in body if len(row) > i and row[i]]
        if column and column.kind == OF_POSITIONS:
            if is_doubtful(name, [cell for cell in cells if not is_missing(cell)]):
                raise DataError(
                    f'{place}: column "{shown(name)}" may be a statistic or a position: delete it; '
                    "or, if it is a position, name its receiver, as R7"
                )
            column = Column("", name)
        elif column and column.wrong:
            raise DataError(f"{place}: {column.wrong}")
        elif not name and not (cells and i):
            column = Column("first" if cells else "")
        elif not name:
            raise DataError(
                f"{place}: column {i + 1} has values and no name; name it, or delete it"
            )
        elif column is None:
            if not (plain(name) in WHOLE_RANGES and of_bands):
                unknown.append(name)
            column = Column("", name)
        columns.append(column)
    if not any(c.kind for c in columns) and all(map(_BARE_NUMBER.fullmatch, unknown)):
        raise DataError(
            f"{place}: no line names columns by a parameter, a band or a position; put one above the "
            'values, such as "Frequency [Hz];T20 [s]"'
        )
    if unknown:
        raise DataError(f"{place}: {_unknown(unknown)}")
    if columns[0].kind == "first":
        columns[0] = _unnamed(columns[1:], [r[0] for _, r in body if r[0]])
    across = [i for i, c in enumerate(columns) if c.kind == "band"]
    if across and any(c.has_band for c in columns):
        names = [r[across[0]] for _, r in body if len(r) > across[0] and r[across[0]]]
        if any(map(_names_parameter, names)):  # "Band (Hz)" is said of the header
            columns[across[0]] = replace(columns[across[0]], kind="parameter")
    if _has_corner(columns):
        columns = _without_corner(columns)
    of_files = "" if {"source", "receiver"} & {c.kind for c in columns} else "receiver"
    columns = [replace(c, kind=of_files) if c.kind == "file" else c for c in columns]
    _refuse_twice(columns, place)
    return columns


def _refuse_positions_above(above: Row, columns: Sequence[Column], path: str) -> None:
    """Raise DataError for positions above a header without any, if they are not read with it."""
    line, cells = above
    placed = any(c.receiver or c.kind in ("source", "receiver") for c in columns)
    several = sum(map(bool, cells[1:])) > 1
    if several and not placed and (named := next(filter(position_of, cells), "")):
        other = next((c for c in cells if c and not position_of(c)), named)
        raise DataError(
            f'{path}, line {line}: "{shown(named)}" is a position, and "{shown(other)}" none; name one '
            "above the columns of each, and delete the others"
        )


def _refuse_twice(columns: Sequence[Column], place: str) -> None:
    """Raise DataError for two columns of one meaning."""
    for kind, times in Counter(c.kind for c in columns).items():
        if kind not in ("data", "") and times > 1:
            raise DataError(f"{place}: two columns are the {kind}")
    for header, times in Counter(c.header for c in columns if c.receiver).items():
        if times > 1:
            raise DataError(
                f'{place}: column "{shown(header)}" is there {times} times; if they are repeats of one '
                "place, state repeats=True; if tables stand beside each other, keep each on a sheet or "
                "in a file of its own"
            )


def _unnamed(others: Sequence[Column], cells: list[str]) -> Column:
    """Return the meaning of a first column without header, which follows from its cells."""
    kinds = {c.kind for c in others}
    numbers = [str(n) for n in range(len(cells))]
    if cells == numbers and len(cells) > 1 and kinds & {"band", "receiver", "source"}:
        return _ROW_NUMBERS
    if any(c.parameter or c.receiver for c in others) and all(map(frequency_of, cells)):
        return Column("band")
    if any(c.has_band for c in others) and all(map(_names_parameter, cells)):
        return Column("parameter")
    return Column("receiver")


def _names_parameter(cell: str) -> bool:
    return bool(parameter_of(name_and_unit(cell)[0]))


def _unknown(names: list[str]) -> str:
    """Return what is said of columns that are none, with what can be done about them."""
    quoted = first_of([f'"{shown(name)}"' for name in names], _MOST_NAMED)
    columns, them = ("column", "it") if len(names) == 1 else ("columns", "them")
    are = "is" if len(names) == 1 else "are"
    none = f"{columns} {quoted} {are} no parameter, band, source or receiver; "
    if any(map(repeat_of, names)):
        return f"{none}if they are repeats of one place, state repeats=True"
    options = " ".join(f'ignore="{shown(name)}"' for name in names[:_MOST_NAMED])
    return (
        f"{none}leave {them} out with {options}, or delete {them}; or read the rows of one room or "
        f'state only: where={{"{shown(names[0])}": "..."}}'
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
    of_bands = [
        i for i, (_, c) in enumerate(body) if frequency_of(c[0]) or plain(c[0]) in WHOLE_RANGES
    ]
    below = body[of_bands[-1] + 1 :] if of_bands else []
    return below if below and _WORD.match(below[0][1][0]) else []


def _is_remark(cells: list[str], width: int) -> bool:
    """Return whether a row is a text alone, which a separator in it may divide into few cells."""
    only = [cell for cell in cells if cell]
    of_entries = any(is_missing(c) or _BARE_NUMBER.fullmatch(c.lstrip("+-")) for c in only)
    whole = len(only) == 1 or (len(cells) < width and not of_entries)
    return whole and only[0] == cells[0] and " " in only[0] and not position_of(only[0])


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
        replace(c, parameter=first.parameter, unit=first.unit, is_open=first.is_open)
        if c.kind == "data"
        else c
        for c in columns[1:]
    ]
    return [Column("receiver" if across.has_band else "band", first.header), *named]
