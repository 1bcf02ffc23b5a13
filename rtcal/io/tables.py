"""Tables of measured values, as measuring systems and spreadsheets write them.

A format makes `rtcal.io.text.Sheet`s of cells of a file: text with separators (CSV), workbooks
(`workbook`, xlsx), and the text of REW, the XL2, Dirac and Aurora (`instruments`). What the cells mean
is decided here, in all formats alike. A header names every column, in one line: a parameter, a band, a
position, or what stands beside the values of a row (`table_columns`). So tables may be

- *long*: one value per row, in the columns of the native file or their usual spellings;
- *wide*: bands, parameters or positions (``S1R1``, ``S1R1#2`` for a repeat) across.

A parameter or a position that neither rows nor columns name may be the name of the sheet. Columns of
text are separated by ``;``, tab or ``,``. Decimals may have a comma if columns are not separated by
commas, or if the cell is quoted. Any other table is refused: the message proposes ``columns``, the
meaning of each column in their order, as far as headers and cells show it. With it the file is read.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, takewhile
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.marks import given_twice, in_measurement
from rtcal.acoustics.measurement import (
    Measurement,
    names_of_repeats,
    note_of_repeats,
    of_single_values,
    places_of,
    require_repeats,
)
from rtcal.acoustics.observables import (
    OBSERVABLES,
    REVERBERATION,
    SUMMARY,
    observable,
    parameter_label,
)
from rtcal.files.disk import read_bytes, write_bytes
from rtcal.files.schema import TABLE, expecting
from rtcal.io import budget, instruments, workbook
from rtcal.io.table_columns import (
    BARE_NUMBER,
    DECAY_TIMES_OF_RT60,
    DOUBTFUL,
    FORMULA_ERRORS,
    LEAST_BAND,
    OPEN,
    UNIT_WORDS,
    WHOLE_RANGES,
    Column,
    column_of,
    columns_of,
    frequency_of,
    is_missing,
    is_unused,
    name_and_unit,
    nearest_band,
    no_band,
    parameter_of,
    plain,
    position_in,
    position_of,
    repeat_of,
    scale_of,
    stated,
    statistic_of,
    wrong_unit,
)
from rtcal.io.text import Row, Sheet, decode, number, sheets_of_text, shown, unit_of
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import first_of, wrapped
from rtcal.support.text import table as table_lines
from rtcal.support.types import Array, Paths, put

__all__ = ["measurement", "read", "write"]
__dir__ = __all__.copy

MAX_PAIRS = 5000
MAX_BYTES = 2**22
"""Largest size of a table in bytes; a compressed workbook of 5000 positions has a tenth of it."""
MAX_COLUMNS = 1000
MAX_LINES_BEFORE_HEADER = 40
_MOST_NAMED = 6  # Largest number of columns or statistics that a message names
_MOST_SEEN = 200  # Largest number of rows whose cells a proposal of columns rests on
_OTHER_UNITS = {"s": "ms", "": "%"}  # The unit in which programs write a parameter, too
_SPREADS = ("uncertainty", "common_uncertainty", "standard_deviation")
_NUMBER = re.compile(
    r"[+\-\u2212\u2013]?(\d+([.,]\d*)?|[.,]\d+)([eE][+\-\u2212]?\d{1,3})?", re.ASCII
)
_PLAIN_NUMBER = re.compile(r"\d+(?:[.,]\d+)?", re.ASCII)
_GIVEN_TWICE = "is given twice"
_UNUSED = "left out, because rtcal does not use it"
_LINES = re.compile(r"\s*from line (\d+)(?: to (\d+))?:(.*)", re.DOTALL)

FORMATS: list[Any] = [workbook, instruments]
"""Formats beside text with separators. Each has ``recognises(content)`` and
``sheets(content, path, where)``; one of your own is appended (docs/extending.md)."""

Key = tuple[str, str, str, float]
"""Source, receiver, parameter and band in Hz that identify a value."""

Values = dict[Key, dict[str, float]]
"""Numbers of each value: "value", "uncertainty", "standard_deviation", "sources", "receivers"."""


@dataclass(frozen=True)
class MeasuredTable:
    """Hold a measurement that was read from a table, and how each column was read.

    ``measurement`` has the values, and ``columns`` one line per column that says how it was read.
    """

    measurement: Measurement
    columns: tuple[str, ...]

    def __str__(self) -> str:
        """Return the means of what was read, what is in doubt, and how each column was read."""
        doubts = (f"Caution: {doubt}" for doubt in self.doubts)
        how = ["How the table was read:", *self.columns] if self.columns else []
        return "\n".join([*means(self.measurement), "", *doubts, *how])

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on values that are used, but that may be typing errors or given twice."""
        return *unusual(self.measurement), *given_twice(self.measurement)


@dataclass(frozen=True, kw_only=True)
class _Options:
    """What the user states of tables, as `read` takes it."""

    decay_time: str | None = None
    parameter: str | None = None
    where: Mapping[str, str] = field(default_factory=dict)
    columns: str = ""
    n_sources: int | None = None
    n_receivers: int | None = None
    repeats: bool = False
    sheets: Collection[str] = ()
    on_trial: bool = False
    """Whether a refusal needs no proposal, since the table is read to try one."""

    def __post_init__(self) -> None:
        for name, choices in (("decay_time", DECAY_TIMES_OF_RT60), ("parameter", (*OBSERVABLES,))):
            if getattr(self, name) is not None:
                checks.choice(name, getattr(self, name), choices)
        for name in ("n_sources", "n_receivers"):
            if getattr(self, name) is not None:
                checks.whole(name, getattr(self, name), 1)
        checks.flag("repeats", self.repeats)
        checks.text("columns", self.columns)
        put(self, where=checks.text_by_name("where", self.where))
        sheets = [self.sheets] if isinstance(self.sheets, str) else self.sheets
        put(self, sheets=checks.texts("sheets", sheets))

    @property
    def counts(self) -> dict[str, float]:
        """The stated numbers of sources and receivers of means."""
        stated = {"sources": self.n_sources, "receivers": self.n_receivers}
        return {name: float(n) for name, n in stated.items() if n is not None}


def read(path: Paths, **options: Any) -> MeasuredTable:
    """Return the measurement in a table of any program, or in several tables with one position each.

    Columns are recognised by their headers: source, receiver, band, and parameters such as "T20 [s]".

    The `MeasuredTable` has the ``measurement``, sentences on doubtful values (``doubts``), and how each
    column was read. Raises DataError for a table that cannot be read; the message names the file, the
    sheet, the line and the rule. Raises MissingDependencyError for a workbook (xlsx), if openpyxl is
    not installed.

    Parameters
    ----------
    path : path or sequence of paths
        Path of the table, or paths of several tables, for example exports of REW.

    Other Parameters
    ----------------
    decay_time : {"t20", "t30"}, optional
        Parameter that a column "RT60" or "T60" means; it must be given only for such a column.
    parameter : str, optional
        Key of the parameter, such as "t20", of values for which the table has no name; it must be given
        only for such values.
    where : mapping of str to str, optional
        Selection of rows by the entry in a column: ``{"room": "CR2"}`` reads the rows with CR2 in the
        column "room". By default all rows are read.
    columns : str, optional
        Meaning of each column in order, for a table without usual headers, with the first line of
        values (by default the second) and optionally the last: ``"from line 3 to 9: receiver; T20 [ms]
        at 500 Hz; -"``. An error message proposes this text.
    n_sources, n_receivers : int, optional
        Numbers of sources and receivers, if the values are means over several pairs.
    repeats : bool, optional
        Whether several values of one pair, parameter and band are repeats, to be averaged. If True, it
        is an error if nothing is repeated. If False, the default, several values are an error; repeats
        are then averaged only if their receivers are named ``R1``, ``R1#2``, ``R1#3`` and so on.
    sheets : collection of str, optional
        Names of the sheets of a workbook to read; by default all with a header.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else checks.listed("path", path)
    names = [os.fspath(checks.path("path", p)) for p in paths]
    files = [os.path.realpath(name) for name in names]
    for i, file in enumerate(files):
        if file in files[:i]:
            raise DataError(f"{names[i]} {_GIVEN_TWICE}: give each table once")
    return parse({name: _content(name) for name in names}, **options)


def _content(path: str | os.PathLike[str]) -> bytes:
    with expecting(TABLE, path):  # a sound may be larger than any table
        return read_bytes(path, MAX_BYTES)


def parse(
    content: bytes | Mapping[str, bytes], path: str = "table", **options: Any
) -> MeasuredTable:
    """Return the measurement in the content of a table, or of several by their names; see `read`.

    ``content`` is the content in bytes, or maps names to contents. ``path`` is the name of a single
    table in messages. ``options`` are the other parameters of `read`.
    """
    checks.text("path", path)
    contents = {path: content} if isinstance(content, bytes) else checks.mapped("content", content)
    if not contents:
        raise DataError("no table is given; give at least one")
    stated = _Options(**{name: value for name, value in options.items() if value is not None})
    found: list[_Table] = []
    notes: list[str] = []
    for path, content in contents.items():
        checks.content(checks.text("content: a name", path), content)
        with expecting(TABLE, path):
            of_file, left_out = _of_file(content, path, stated)
        found += of_file
        notes += left_out
    if not stated.sheets:
        found, left_out = _of_places(found)
        notes += left_out
    read = _measured(found, notes, stated)
    place, own = found[0].place, {*read.measurement.values} - {stated.parameter}
    if stated.parameter is not None and own and not any(table.parameter for table in found):
        raise DataError(
            f'{place}: parameter="{stated.parameter}" is given, but the table names its own '
            f"parameters ({', '.join(map(parameter_label, own))}). Leave this option out"
        )
    if stated.decay_time is not None and not any(table.was_open for table in found):
        raise DataError(
            f'{place}: decay_time="{stated.decay_time}" is given, but nothing in the table '
            "is called RT60 or T60. Leave this option out"
        )
    return read


def measurement(path: str | os.PathLike[str]) -> MeasuredTable:
    """Return the measurement in a file that needs no check: rtcal's CSV, a workbook, or a text of REW.

    Raises DataError for any other text: read it with `read`, or convert it with ``rtcal table``, and
    check how its columns were read.

    ``path`` is the path of the file.
    """
    content = _content(path)
    if any(module.recognises(content) for module in FORMATS):
        return read(path)
    return MeasuredTable(Measurement.from_file(os.fspath(path)), ())


def write(measurement: Measurement, path: str | os.PathLike[str]) -> None:
    """Write a measurement as rtcal's table: a CSV file, or a workbook if the path ends in .xlsx.

    A row has one value, with the columns source, receiver, parameter, band and value.

    ``measurement`` is what to write, and ``path`` the path of the new file.
    """
    checks.instance("measurement", measurement, Measurement)
    if checks.path("path", path).suffix.lower() == workbook.ENDING:
        write_bytes(path, workbook.content({"measurement": measurement.rows()}))
    else:
        measurement.save(os.fspath(path))


def sheets_of(
    content: bytes,
    path: str,
    where: Mapping[str, str] | None = None,
    extra: Collection[str] = (),
) -> list[Sheet]:
    """Return the tables in a file: those of an instrument or a workbook, or else of a plain text."""
    for module in FORMATS:
        if module.recognises(content):
            sheets: list[Sheet] = module.sheets(content, path, where or {})
            return sheets
    likely = sheets_of_text(decode(content, path), path)
    return [next((s for s in likely if _header(s.rows, extra)[2]), likely[0])]


# -- cells to columns


def _of_file(content: bytes, path: str, options: _Options) -> tuple[list[_Table], list[str]]:
    """Return the tables of a file that are to be read, and a note on sheets that are left out."""
    of_file = sheets_of(content, path, options.where, options.where)
    if options.repeats:
        of_file = [
            replace(s, rows=tuple((n, [repeat_of(c) or c for c in cells]) for n, cells in s.rows))
            for s in of_file
        ]
    there = [sheet.name for sheet in of_file]
    if missing := [name for name in options.sheets if name not in there]:
        raise DataError(
            f'{path}: sheets="{shown(missing[0])}" is not a sheet; the sheets are '
            + (", ".join(f'"{shown(n)}"' for n in there if n) or "without a name")
        )
    chosen = [s for s in of_file if s.name in options.sheets]
    if not options.sheets:
        chosen = [s for s in of_file if _header(s.rows, ())[1] > 1] or of_file
    tables = [(_stated_table if options.columns else _table)(sheet, options) for sheet in chosen]
    left_out = [f'"{shown(s.name)}"' for s in of_file if s not in chosen]
    if options.sheets or not left_out:
        return tables, []
    return tables, [f"left out, without a header: {', '.join(left_out)}"]


def _of_places(found: list[_Table]) -> tuple[list[_Table], list[str]]:
    """Return the tables without those called after a statistic beside others of a position each."""
    named = [(table, table.sheet.position[1] or table.sheet.name) for table in found]
    kept = [table for table, name in named if statistic_of(name) is None]
    if not any(any(table.position) for table in kept) or len(kept) == len(found):
        return found, []
    for table, name in named:
        if statistic_of(name) == DOUBTFUL:
            raise DataError(
                f'{table.sheet.place}: "{shown(name)}" may be a statistic or a position. If it is a '
                "position, give it another name, such as R7; otherwise leave it out"
            )
    left_out = dict.fromkeys(name for _, name in named if statistic_of(name) is not None)
    return kept, [
        f"tables of means and deviations beside single positions are left out: {_quoted([*left_out])}"
    ]


def _quoted(names: Sequence[str]) -> str:
    return first_of([f'"{shown(name)}"' for name in names], _MOST_NAMED)


def _header(rows: Sequence[Row], extra: Collection[str]) -> tuple[int, int, bool]:
    """Return the row that is the header, how many of its cells name columns, and whether all do.

    It is the first row whose cells all do, else the one with most that has no numbers but bands.
    """
    best = next((i for i, (_, cells) in enumerate(rows) if sum(map(bool, cells)) > 1), 0), 0
    for i, (_, cells) in enumerate(rows[:MAX_LINES_BEFORE_HEADER]):
        filled = [pair for pair in zip(cells, columns_of(cells, extra), strict=True) if pair[0]]
        unclear = [cell for cell, column in filled if column is None or column.wrong]
        count = sum(c is not None and not BARE_NUMBER.fullmatch(cell) for cell, c in filled)
        if len(filled) > 1 and count and not unclear:
            return i, count, True
        if count > best[1] and not any(map(BARE_NUMBER.fullmatch, unclear)):
            best = i, count
    return *best, False


def _table(sheet: Sheet, options: _Options) -> _Table:
    """Return a table by its header; DataError proposes ``columns`` for one that says too little."""
    rows = list(sheet.rows)
    at = _header(rows, options.where)[0]
    (line, header), body, notes = rows[at], rows[at + 1 :], [sheet.note]
    if at:
        before = _quoted(_titles(rows[:at]))
        notes.append(f"the header is line {line}; what stands before it is left out: {before}")
    while header and not header[-1]:  # a separator at the end of every line
        header = header[:-1]
    place = f"{sheet.place}, line {line}"
    budget.require(len(header), MAX_COLUMNS, "columns", place)
    found = columns_of(header, options.where)
    if _has_split_decimals(found, header, body, sheet.separator):
        raise DataError(
            f"{place}: the comma probably stands both for the decimal point and between cells. "
            "Save the table with semicolons or tabs between columns, or with decimal points"
        )
    for k, column in enumerate(found):
        cells = [row[k] for _, row in body if len(row) > k and row[k]]
        if not (column or header[k] or cells):
            found[k] = Column("", header[k])
        elif column and not column.kind and _selects_parameter(header[k], cells, options):
            found[k] = replace(column, kind="parameter")
        elif column and not (k or column.kind) and cells and all(map(position_of, cells)):
            found[k] = replace(column, kind="receiver")  # "R" above R1, R2
    if problem := _problem(found, header, body):
        is_advised = any(advice in problem for advice in (". ", "; write", "; check"))
        before = ". Otherwise give" if is_advised else ". Give"
        raise DataError(f"{place}: {problem}{_proposed(sheet, at, options, before)}")
    columns = [column for column in found if column]
    return _Table(sheet, columns, at, body, _titles(rows[:at]), [*notes, *sheet.notes], options)


def _selects_parameter(name: str, cells: Sequence[str], options: _Options) -> bool:
    """Return whether rows are selected by their parameter: one of several, or of all, in a column."""
    named = [entry for entry in dict.fromkeys(cells) if _names_parameter(entry)]
    return options.where.get(name) in named and (len(named) > 1 or len({*cells}) == 1)


def _names_parameter(cell: str) -> bool:
    return bool(parameter_of(name_and_unit(cell)[0])) or is_unused(cell)


def _has_split_decimals(
    columns: Sequence[Column | None],
    header: Sequence[str],
    body: Sequence[Row],
    separator: str,
) -> bool:
    """Return whether numbers such as 1,62 were likely divided into two cells, at their commas.

    No number has a decimal mark, and rows are longer than their header; or, where commas separate
    cells, a number stands behind that of a value, or in the place of a band.
    """
    rows = [cells for _, cells in body]
    if any(_is_number(cell) and {*".,"} & {*cell} for cells in rows for cell in cells):
        return False
    below = [len(cells) for cells in takewhile(lambda cells: not any(map(_is_number, cells)), rows)]
    n = max(len(header), *below, 0)
    if any(cell.isdecimal() for cells in rows for cell in cells[n : n + 1]):
        return True
    if separator != ",":
        return False
    if any(c and c.wrong and BARE_NUMBER.fullmatch(c.header) for c in columns):
        return True
    behind = [
        k
        for k, (value, column) in enumerate(pairwise(columns), start=1)
        if value and value.has_values and header[k] and not (column and column.has_values)
        if (column and column.kind) or statistic_of(header[k]) is None
    ]
    return any(cells[k].isdecimal() for cells in rows for k in behind if k < len(cells))


def _problem(columns: Sequence[Column | None], header: Sequence[str], body: Sequence[Row]) -> str:
    """Return what a header leaves open; "" if it says what every column holds."""
    unknown = [name for name, c in zip(header, columns, strict=True) if c is None and name]
    if all(map(BARE_NUMBER.fullmatch, unknown or header)):
        return "no line has names of columns, such as a parameter, a band or a position"
    if unknown:
        are = f"{_quoted(unknown)} {'is' if len(unknown) == 1 else 'are'}"
        problem = (
            f"column{'s' * (len(unknown) > 1)} {are} not a parameter, band, source or receiver"
        )
        repeats = ". If they are repeats at one position, use repeats=True"
        return problem + repeats * any(map(repeat_of, unknown))
    if wrong := next((c.wrong for c in columns if c and c.wrong), ""):
        return wrong
    known = [column for column in columns if column]
    if len(known) < len(columns):
        return f"column {columns.index(None) + 1} has values and no name"
    values, kinds = [c for c in known if c.has_values], {c.kind for c in known}
    if without := [c for c in values if c.has_band == ("band" in kinds)]:
        which = "two headers give" if "band" in kinds else "no header gives"
        return f'{which} the band of "{shown(without[0].header)}"'
    alike = Counter(c.meaning for c in values)
    if twice := next((c for c in values if alike[c.meaning] > 1 and not c.receiver), None):
        return f'{alike[twice.meaning]} columns are "{shown(twice.header)}"'
    below = (
        [cell for cell, c in zip(body[0][1], known, strict=False) if c.has_values] if body else []
    )
    if below and all(cell.strip("[]()").lower() in {*UNIT_WORDS} - {"-", "1"} for cell in below):
        return f"line {body[0][0]} has units; write them into the header"
    return ""


def stated_columns(sheet: Sheet, stated_text: str, *kinds: str) -> tuple[range, list[Column]]:
    """Return the lines of a table that have values, and its columns, as the user states them."""
    found, lines = _LINES.fullmatch(stated_text), [line for line, _ in sheet.rows]
    first = int(found[1]) if found else lines[min(1, len(lines) - 1)]
    columns = []
    for k, text in enumerate((found[3] if found else stated_text).split(";"), start=1):
        try:
            own = text.strip() in kinds
            columns.append(Column(text.strip(), text) if own else stated(text))
        except DataError as error:
            raise DataError(f"{sheet.place}: columns, {k}: {error}") from error
    return range(first, int(found[2] or lines[-1]) + 1 if found else lines[-1] + 1), columns


def _stated_table(sheet: Sheet, options: _Options) -> _Table:
    """Return the table whose columns are stated; its rows stand in the lines that are stated."""
    lines, columns = stated_columns(sheet, options.columns)
    above = [cells for line, cells in sheet.rows if line < lines.start]
    names = [*(above[-1] if above else []), *[""] * len(columns)]
    for column, own in zip(columns, columns_of(names), strict=False):
        if own and column.has_values and (says := _contradiction(column, own)):
            raise DataError(
                f'{sheet.place}: columns: "{shown(own.header)}" is stated as "{column.meaning}", but '
                f"its header says {says}. Correct what is wrong, or state - to leave the column out"
            )
    columns = [replace(c, header=n or c.header) for c, n in zip(columns, names, strict=False)]
    body = [row for row in sheet.rows if row[0] in lines]
    notes = [sheet.note, "columns are as given", *sheet.notes]
    return _Table(sheet, columns, max(len(above) - 1, 0), body, [], notes, options)


def _contradiction(column: Column, own: Column) -> str:
    """Return what a column's own header says otherwise than what is stated; "" if nothing."""
    parameter = own.parameter
    if parameter not in ("", OPEN) and column.parameter not in ("", parameter):
        return parameter_label(parameter)
    if own.has_band and column.has_band and own.band != column.band:
        return bands.label(own.band)
    known = parameter and own.unit and column.unit
    of_both = [scale_of(parameter, unit) for unit in (own.unit, column.unit)] if known else [1.0]
    return f"[{own.unit}]" if len({*of_both}) > 1 else ""


# -- a proposal of columns


_FILL_IN = (
    ". Replace each ? by a parameter with its unit, a band or a position, as in T20 [s] at 500 Hz of "
    "S1 to R1; R1#2 is a repeat at R1"
)


def _refusal(sheet: Sheet, options: _Options) -> str:
    """Return why a table is not read with some options; "" if it is, and they may be proposed."""
    options = replace(options, on_trial=True)
    try:
        table = (_stated_table if options.columns else _table)(sheet, options)
        return "" if any(_values([table], options)) else "no row has a value"
    except DataError as error:
        return str(error).removeprefix(sheet.place).lstrip(",: ")


def _proposed(sheet: Sheet, at: int, options: _Options, before: str) -> str:
    """Return how to state ``columns`` of a table that row ``at`` names best, behind ``before``.

    What neither headers nor cells show stands as ?; without any it is why the table is not read so.
    Headers above each other name a column together; an upper one may be merged over several columns.
    """
    if options.on_trial:
        return ""
    rows = sheet.rows
    first = at
    while first < len(rows) - 1 and not _are_values(rows[first][1], [c for _, c in rows[at:first]]):
        first += 1
    top = at
    while (
        first > at and top and rows[top - 1][0] == rows[top][0] - 1 and _is_header(rows[top - 1][1])
    ):
        top -= 1
    above, body = [cells for _, cells in rows[top:first]], rows[first:]
    body = body[: _last_of(body) + 1]
    width = max(len(cells) for cells in [*above, body[0][1]])
    headers = [[*cells, *[""] * width][:width] for cells in above]
    for upper in headers[:-1]:
        start = next((k for k, cell in enumerate(upper) if cell), width)
        for k in range(max(start, 1) + 1, width):
            upper[k] = upper[k] or upper[k - 1]
    several = [row for _, row in body[:_MOST_SEEN] if sum(map(bool, row)) > 1]
    cells = [[row[k] for row in several if len(row) > k and row[k]] for k in range(width)]
    found = [columns_of(texts) for texts in headers]
    labels = [
        [(row[k], c[k]) for row, c in zip(headers, found, strict=True) if row[k]]
        for k in range(width)
    ]
    columns = [_named_together(of_column) for of_column in labels]
    known = [column for column in columns if column]
    for k in (k for k in range(1 - bool(labels[0]), width) if columns[k] is None):
        columns[k] = _of_cells(labels[k][-1][0] if labels[k] else "", cells[k], known)
    own, others = columns[0], [c for c in columns[1:] if c and c.has_values]
    over = own and own.parameter and not own.has_band and not any(c.parameter for c in others)
    across = any(c.has_band for c in others)
    if over or not labels[0] or (across and own and own.kind == "band"):
        columns[0] = _of_first(cells[0], across, {c.kind for c in columns[1:] if c})
    title = next((c for t in (sheet.name, *_titles(rows[:top])) if (c := _name_of(t))), None)
    shared = own if over else title
    if shared and not any(c and (c.parameter or c.kind == "parameter") for c in columns):
        columns = [c and next(_completed([c], shared)) for c in columns]
    for k, column in enumerate(columns):
        if column and column.parameter in OBSERVABLES and not column.unit:
            numbers = [float(c.replace(",", ".")) for c in cells[k] if _PLAIN_NUMBER.fullmatch(c)]
            if any(not _is_accepted(column.parameter, number) for number in numbers):
                columns[k] = replace(column, unit="?")
    lines = f"{body[0][0]} to {body[-1][0]}"
    text, reason = _tried(sheet, lines, columns, options)
    if _GIVEN_TWICE in reason:  # a column of texts may be where the rows were measured
        asked = [
            None if c and not c.kind and len({*own}) > 1 and not any(map(_is_number, own)) else c
            for c, own in zip(columns, cells, strict=True)
        ]
        text, reason = _tried(sheet, lines, asked, options)
    if reason:
        return f"; and {reason}" if reason.startswith("line ") and "state " not in reason else ""
    what = f" the content of each column, with - for a column to leave out: {text}"
    return before + what + _FILL_IN * ("?" in text)


def _tried(
    sheet: Sheet, lines: str, columns: Sequence[Column | None], options: _Options
) -> tuple[str, str]:
    """Return the text that proposes columns, and why the table is not read with it; "" if it is."""
    text = columns_text(lines, _meanings(columns, options))
    stated = replace(options, columns=text.partition('"')[2][:-1])
    return text, "" if "?" in text else _refusal(sheet, stated)


def _meanings(columns: Sequence[Column | None], options: _Options) -> list[str]:
    """Return what each column holds; in place of what is not known stands ?."""
    kinds, meanings = {c.kind for c in columns if c}, list[str]()
    open_names = ["value"] * ("parameter" not in kinds and not options.parameter)
    open_names += ["RT60"] * (options.decay_time is None)
    for column in columns:
        meaning = "?" if column is None else column.meaning if column.kind else "-"
        if column and column.has_values:
            name, of, place = meaning.partition(" of ")
            name = (
                f"? {name.partition(' ')[2]}".strip() if name.split(" ")[0] in open_names else name
            )
            name += " at ?" * (not column.has_band and "band" not in kinds)
            if not place and "receiver" not in kinds and any(c and c.receiver for c in columns):
                of, place = " of ", "?"
            if options.parameter:  # which is stated beside
                name = name.replace(f"{parameter_label(options.parameter)} ", "value ")
            meaning = name + of + place
        meanings.append(meaning)
    alike = Counter([] if options.repeats else meanings)
    return [
        f"{m.partition(' of ')[0]} of ?" if alike[m] > 1 and c and c.has_values else m
        for m, c in zip(meanings, columns, strict=True)
    ]


def columns_text(line: str, meanings: Sequence[str]) -> str:
    """Return the option ``columns`` as text for a message, from the first line and the meanings."""
    return f'columns="from line {line}: {"; ".join(meanings)}"'.replace('\\"', "'")


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.removesuffix(unit_of(cell)).strip()))


def _are_values(cells: Sequence[str], above: Sequence[Sequence[str]]) -> bool:
    """Return whether a row has values below some headers: numbers that are no bands of theirs."""
    numbers = [c for c in cells[1:] if _is_number(c)]
    texts = [cell for cell in cells if not BARE_NUMBER.fullmatch(cell)]
    if not above and (named := [column for column in map(column_of, texts) if column]):
        in_khz = any(name_and_unit(cell)[1].lower() == "khz" for cell in texts)
        fractions = [frequency_of(n) for n in numbers if not n.isdecimal()]
        is_band = in_khz or all(f and nearest_band(f) for f in fractions)
        return not is_band and all(column.has_values for column in named)
    known = [column for row in above for column in map(column_of, row) if column]
    if any(column.kind == "band" or column.has_band for column in known):
        return bool(numbers)
    found = map(column_of, numbers)
    are_bands = len(numbers) > 1 and all(c and c.has_band and not c.wrong for c in found)
    return bool(numbers) and not are_bands


def _is_header(cells: Sequence[str]) -> bool:
    """Return whether a row above a header may be a part of it: it names more than the first column."""
    others, first = [cell for cell in cells[1:] if cell], column_of(cells[0])
    of_rows = not cells[0] or (first is not None and not first.has_values)
    return bool(others) and (of_rows or any(map(column_of, others)))


def _last_of(body: Sequence[Row]) -> int:
    """Return the number of the last row of a table: with as many cells, and a band, as its first."""
    width, of_band = len(body[0][1]), frequency_of(body[0][1][0])
    for i, (_, cells) in enumerate(body):
        has_band = not of_band or frequency_of(cells[0]) or plain(cells[0]) in WHOLE_RANGES
        if sum(map(bool, cells)) > 1 and not (has_band and len(cells) >= width):
            return max(i - 1, 0)
    return len(body) - 1


def _named_together(labels: Sequence[tuple[str, Column | None]]) -> Column | None:
    """Return the column that headers above each other name, each with its own column if it is known."""
    texts = [text for text, _ in labels]
    if beside := [c for _, c in labels if c and not c.has_values]:
        of_rows = beside[-1]
        unit = "kHz" if "khz" in map(str.lower, texts) else of_rows.unit
        return None if of_rows.wrong else replace(of_rows, unit=unit)
    made, places, is_known = Column("value", " ".join(texts)), list[str](), False
    for text, column in labels:
        words = [] if column else text.split()
        units = [
            w.strip("[]()") for w in words if w.strip("[]()").lower() in UNIT_WORDS - {"-", "1"}
        ]
        words = [w for w in words if w.strip("[]()") not in units]
        parameter = next((w for w in words if parameter_of(w)), "")
        band = next((w for w in words if (frequency_of(w) or 0) >= LEAST_BAND), "")
        column = column or column_of(f"{parameter} {band}".strip())
        place = "" if band else " ".join(word for word in words if word != parameter)
        if statistic_of(place) is not None:
            return Column("", text)
        places += [text] if column and column.receiver else [place] if place else []
        made = replace(made, unit=units[0] if units else made.unit)
        if column and not column.wrong:
            is_known = True
            made = replace(
                made,
                parameter=column.parameter or made.parameter,
                band=column.band if column.has_band else made.band,
                unit=column.unit or made.unit,
            )
    place = places[-1] if places else ""
    source, receiver = position_of(" ".join(places)) or position_of(place) or ("", place)
    return replace(made, source=source, receiver=receiver) if is_known else None


def _of_cells(name: str, cells: Sequence[str], known: Sequence[Column]) -> Column | None:
    """Return what an unknown column may hold beside the known ones; None if it is to be asked."""
    kinds = {column.kind for column in known}
    if cells and all(map(_is_number, cells)):
        is_place = "band" in kinds and "value" not in kinds and statistic_of(name) is None
        return Column("value", name, receiver=name) if is_place and name else None
    if cells and all(map(_names_parameter, cells)) and "parameter" not in kinds:
        return Column("parameter", name)
    is_receiver = bool(cells) and all(map(position_of, cells)) and "receiver" not in kinds
    return Column("receiver" if is_receiver else "", name)


def _of_first(cells: Sequence[str], across: bool, kinds: Collection[str]) -> Column:
    """Return what the first column holds by its cells; ``across`` says that others name bands."""
    if [*cells] == [str(n) for n in range(len(cells))] and {"band", "receiver", "source"} & {
        *kinds
    }:
        return Column("", "")
    if any(frequency_of(c) for c in cells) and not across:
        return Column("band", "")
    is_parameter = bool(cells) and all(map(_names_parameter, cells))
    return Column("parameter" if is_parameter else "receiver", "")


def _completed(columns: Iterable[Column], named: Column) -> Iterator[Column]:
    """Yield columns, with the parameter and unit of a title for values that have none."""
    for c in columns:
        bare = c.has_values and not c.parameter
        yield replace(c, parameter=named.parameter, unit=c.unit or named.unit) if bare else c


def _titles(rows: Sequence[Row]) -> list[str]:
    return [cell for _, cells in rows for cell in cells if cell]


def _name_of(text: str) -> Column | None:
    """Return the parameter that a sheet's name or a title is; None for another text."""
    column = column_of(text) if text else None
    alone = column is not None and column.parameter and not column.has_band and not column.wrong
    return column if alone else None


# -- columns to values


_Value = tuple[str, Key, dict[str, float], str | None]
"""The place and the numbers of one value of a row, of single positions unless it is a statistic."""


class _Table:
    """The columns of a header, and the values of the rows below it."""

    def __init__(
        self,
        sheet: Sheet,
        columns: Sequence[Column],
        at: int,
        body: Sequence[Row],
        titles: Sequence[str],
        notes: list[str],
        options: _Options,
    ) -> None:
        self.sheet, self.titles, self.notes, self.options = sheet, titles, notes, options
        self.at = at
        self.place = f"{sheet.place}, line {sheet.rows[at][0]}"
        self.was_open = False  # whether a name such as RT60 was found
        self.formula_errors: list[str] = []  # the places of values that are missing for it
        self.statistics: dict[str, None] = {}  # names of the rows of statistics over positions
        kinds = {c.kind for c in columns}
        of_files = "" if {"source", "receiver"} & kinds else "receiver"
        self.columns = [
            replace(
                c,
                kind=of_files if c.kind == "file" else c.kind,
                parameter=self._closed(c, self.place),
            )
            for c in columns
        ]
        for kind, times in Counter(c.kind for c in self.columns).items():
            if kind not in ("value", "") and times > 1:
                raise DataError(f"{self.place}: two columns are the {kind}; leave one out")
        self.rows = self._rows(body)
        self.first = self.rows[0][0] if self.rows else sheet.rows[at][0] + 1
        self.parameter = None if "parameter" in kinds else self._of_table()
        if self.parameter is not None:
            self.columns = [*_completed(self.columns, self.parameter)]
        commas = points = False
        for line, cells in self.rows:
            for cell in self._cells_of_values(cells):
                digits = cell.removesuffix(unit_of(cell)).strip()
                if _NUMBER.fullmatch(digits):
                    commas |= "," in digits
                    points |= "." in digits
            if commas and points:
                raise DataError(
                    f"{self.sheet.place}, line {line}: the table has both decimal commas "
                    "and decimal points; use one of them"
                )
        self.comma = commas
        self._set_positions({c.kind for c in self.columns})

    @property
    def position(self) -> tuple[str, str]:
        """The source and receiver that the sheet is called after; a mean has none."""
        source, receiver = self.sheet.position
        if not source and statistic_of(receiver) not in (None, DOUBTFUL):
            return "", ""
        return (
            self.sheet.position if source or receiver else position_of(self.sheet.name) or ("", "")
        )

    def _rows(self, body: Sequence[Row]) -> list[Row]:
        """Return the rows with a cell per column; a text alone is left out."""
        width, rows = len(self.columns), []
        for line, cells in body:
            while len(cells) > width and not cells[-1]:
                cells = cells[:-1]
            if width > 2 and [cell for cell in cells if cell] == cells[:1]:
                self._note(f'left out, a text alone in its line: "{shown(cells[0], 60)}"')
                continue
            if len(cells) != width:
                raise DataError(
                    f"{self.sheet.place}, line {line}: this row has {len(cells)} cells, "
                    f"but the header has {width}. {self._other_lines}"
                )
            rows.append((line, cells))
        return rows

    @property
    def _other_lines(self) -> str:
        """How to leave out lines that are no part of the table."""
        cure = "Delete the lines that are not part of the table"
        if self.options.columns:
            return cure
        proposal = _proposed(self.sheet, self.at, self.options, ". Or give")
        return cure if proposal.startswith("; and ") else cure + proposal

    def _set_positions(self, kinds: set[str]) -> None:
        """Set the position of values whose rows name none, and the sentences on positions."""
        across = [c for c in self.columns if c.receiver]
        placed = {"source", "receiver"} & kinds or across
        position = ("", "") if placed else self.position
        self.has_positions = bool(placed or position[1])
        if self.options.counts and self.has_positions:
            raise DataError(
                f"{self.place}: numbers of sources and receivers can be given only for "
                "means, but the table has single positions; leave the numbers out"
            )
        self.pair = (position[0] or "S1", position[1] or "R1")
        is_summary = self.options.counts or {"sources", "receivers", "standard_deviation"} & kinds
        if is_summary and not self.has_positions:
            self.pair = (SUMMARY, SUMMARY)
        if {*_SPREADS} & kinds and sum(c.has_values for c in self.columns) > 1:
            raise DataError(
                f"{self.place}: a column of uncertainties needs rows with one value each, "
                "but these rows have several values"
            )
        self.example_of_both = None if "source" in kinds else self._example_of_both()
        says = self.of_positions = list[str]()
        if not self.has_positions:
            says.append(
                "no positions: treated as source S1 and receiver R1; if the values are means, "
                "give n_sources and n_receivers"
            )
        elif self.example_of_both:
            source, receiver = self._pair_of({"receiver": self.example_of_both})
            both = f"source {source}, receiver {receiver}"
            says.append(f'positions name both: "{self.example_of_both}" is {both}')
        elif position[1]:
            says.append(f"all values are of {self.pair[0]} to {self.pair[1]}, the table's name")
        elif "source" not in kinds and not (across and all(c.source for c in across)):
            says.append("no source is named, so all positions are receivers of source S1")
        elif "receiver" not in kinds and not across:
            says.append("no receiver is named: treated as receiver R1 of each source")
        if "channel" in kinds and not self.options.repeats:
            says.append(
                "several channels: each is a receiver, named after it; if they are repeats at "
                "one position, use repeats=True"
            )

    def _closed(self, named: Column, place: str) -> str:
        """Return the parameter of a name; the stated decay time of one that leaves it open."""
        if named.parameter != OPEN:
            return named.parameter
        self.was_open = True
        if self.options.decay_time is None:
            raise DataError(
                f'{place}: "{shown(name_and_unit(named.header)[0])}" does not say which decay time it '
                'is; state decay_time="t20" or decay_time="t30"'
            )
        return self.options.decay_time

    def _of_table(self) -> Column | None:
        """Return the parameter of values that name none: it is stated, or the sheet's name."""
        if all(c.parameter for c in self.columns if c.has_values):
            return None
        place, stated = self.sheet.place, self.options.parameter
        named = _name_of(self.sheet.name)
        if named is None:
            return Column("value", stated, stated) if stated else None
        if named.parameter == OPEN and stated in DECAY_TIMES_OF_RT60:
            named = replace(named, parameter=stated)
        key = self._closed(named, place)
        if stated not in (None, key):
            raise DataError(
                f'{place}: parameter="{stated}" is given, but the table\'s name '
                f'"{shown(self.sheet.name)}" means {parameter_label(key)}. Leave this option out'
            )
        return replace(named, parameter=key)

    def _cells_of_values(self, cells: Sequence[str]) -> list[str]:
        """Return the cells of a row that have values."""
        pairs = zip(self.columns, cells, strict=True)
        return [cell for column, cell in pairs if column.has_values and not is_missing(cell)]

    def _example_of_both(self) -> str | None:
        """Return the first position that names source and receiver; None if none does."""
        at = next((i for i, column in enumerate(self.columns) if column.kind == "receiver"), None)
        if at is None:
            return None
        rows = [
            (line, cells[at])
            for line, cells in self.rows
            if statistic_of(cells[at]) in (None, DOUBTFUL) and self._cells_of_values(cells)
        ]
        both = [bool((p := position_of(name) or position_in(name)) and p[0]) for _, name in rows]
        if 2 * sum(both) <= len(both):  # few may be receivers that are called so
            return None
        first = rows[both.index(True)][1]
        if not all(both):
            line, name = rows[both.index(False)]
            raise DataError(
                f'{self.sheet.place}, line {line}: "{shown(name)}" does not name a source and a '
                f'receiver as "{shown(first)}" does. Name both, or delete the row'
            )
        return first

    def values(self) -> Iterator[_Value]:
        """Yield the values of the rows that ``where`` selects."""
        headers, where = [c.header for c in self.columns], self.options.where
        for name in where:
            if headers.count(name) != 1:
                raise DataError(f'{self.place}: column "{shown(name)}" must occur exactly once')
        chosen = [
            (line, cells)
            for line, cells in self.rows
            if all(cells[headers.index(name)] == entry for name, entry in where.items())
        ]
        if not chosen and where:
            selection = ", ".join(f"{name} = {entry}" for name, entry in where.items())
            raise DataError(f'{self.place}: no row has "{shown(selection)}"')
        named = self._naming_parameters()
        for line, cells in chosen:
            words = [cells[k] for k in named]
            yield from self._of_row(cells, words, f"{self.sheet.place}, line {line}")

    def _naming_parameters(self) -> list[int]:
        """Return the columns that are not stated as parameters, though each of their cells is one."""
        return [
            k
            for k, column in enumerate(self.columns)
            if not (column.has_values or column.kind == "parameter")
            and (filled := [cells[k] for _, cells in self.rows if cells[k]])
            and all(map(_names_parameter, filled))
        ]

    def _of_row(self, cells: Sequence[str], words: Sequence[str], place: str) -> Iterator[_Value]:
        """Yield the values of a row; ``words`` are its cells of columns that name parameters."""
        entries = {
            column.kind: cell
            for column, cell in zip(self.columns, cells, strict=True)
            if column.kind and not column.has_values
        }
        errors = [cell for cell in cells if cell.lower() in FORMULA_ERRORS]
        self.formula_errors += [f"{e} in line {place.rpartition(' ')[2]}" for e in errors]
        filled = self._cells_of_values(cells)
        statistic = self._statistic(entries, filled, place)
        if statistic == "" or self._is_unused(entries) or not filled:
            return
        named = entries.get("parameter"), entries.get("band")
        if statistic is not None and self.has_positions and "" in named:
            return  # a mean over more than one parameter or band
        of_row = (SUMMARY, SUMMARY) if statistic is not None else self._pair_of(entries)
        row_band = self._row_band(entries, place)
        row_parameter = self._row_parameter(entries, place)
        for column, cell in zip(self.columns, cells, strict=True):
            if not column.has_values or is_missing(cell):
                continue
            source, receiver = of_row
            if column.receiver:
                source, receiver = column.source or source, column.receiver
            parameter = column.parameter or row_parameter
            if not parameter:
                if "parameter" in entries:
                    raise DataError(
                        f'{place}: parameter "{shown(entries["parameter"])}" is unknown; '
                        "write a name such as T20, EDT or C80"
                    )
                titled = (c.parameter for t in self.titles if (c := _name_of(t)))
                likely = next(titled, REVERBERATION[0].key)
                raise DataError(
                    f'{place}: no header names the parameter of the value "{shown(cell)}". '
                    f'Name it, for instance with parameter="{likely}"'
                )
            for word in words:
                if parameter_of(name_and_unit(word)[0]) not in ("", OPEN, parameter):
                    raise DataError(
                        f'{place}: this row says "{shown(word)}", but its values are stated as '
                        f"{parameter_label(parameter)}. State its column as parameter, and the "
                        "columns of its values as value"
                    )
            band = column.band if column.has_band else row_band
            if band is None:
                raise DataError(
                    f'{place}: the value "{shown(cell)}" has no band; give the band in its '
                    "row or in the header of its column"
                )
            unit = column.unit
            if not column.parameter:  # its row may state one, by itself or as "TS/ms"
                of_name = name_and_unit(entries.get("parameter", ""))[1]
                unit = entries.get("unit", "").strip("[]() ") or of_name or unit
            stated = {name: entries[name] for name in _SPREADS if name in entries}
            numbers = {
                name: self._number(text, parameter, unit, place)
                for name, text in {statistic or "value": cell, **stated}.items()
                if not is_missing(text)
            }
            for name in ("sources", "receivers"):
                if not is_missing(entries.get(name, "")):
                    numbers[name] = number(entries[name], place)
            if "value" in numbers:
                self._check(parameter, numbers["value"], place)
            yield place, (source, receiver, parameter, band), numbers, statistic

    def _statistic(
        self, entries: Mapping[str, str], values: Sequence[str], place: str
    ) -> str | None:
        """Return the statistic of a row of means or deviations; None for single values."""
        if "statistic" in entries:
            word = entries["statistic"]
            found = statistic_of(word)
            if found in (None, DOUBTFUL):
                raise DataError(
                    f'{place}: statistic "{shown(word)}" is not known; known are mean, standard '
                    "deviation, minimum, median and count"
                )
            return found
        receiver, source = (entries.get(name, "") for name in ("receiver", "source"))
        statistics = [n for n in (receiver, source) if n and statistic_of(n) is not None]
        if not statistics:
            return None
        for name in statistics:
            if values and statistic_of(name) == DOUBTFUL:
                raise DataError(
                    f'{place}: "{shown(name)}" may be a statistic, a remark or a position. If it is '
                    "a position, give it another name, such as R7; otherwise delete the row"
                )
        self.statistics[statistics[0]] = None
        return "" if receiver and receiver not in statistics else statistic_of(statistics[0])

    def _is_unused(self, entries: Mapping[str, str]) -> bool:
        """Return whether a row is of the whole range, or of a parameter without use; it is noted."""
        parameter, band = entries.get("parameter", ""), entries.get("band", "")
        if is_unused(parameter):
            note = f'a parameter: "{shown(parameter)}"'
        elif plain(band) in WHOLE_RANGES:
            note = f'a band: "{shown(band)}"'
        else:
            return False
        self._note(f"{_UNUSED} as {note}")
        return True

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def _pair_of(self, entries: Mapping[str, str]) -> tuple[str, str]:
        """Return the source and the receiver of a row."""
        source, receiver = entries.get("source"), entries.get("receiver")
        if self.example_of_both and receiver:
            source, receiver = position_of(receiver) or position_in(receiver) or (source, receiver)
        receiver = receiver or self.pair[1]
        if (channel := entries.get("channel")) and not self.options.repeats:
            place, mark, repeat = receiver.partition("#")
            receiver = f"{place}-{channel}{mark}{repeat}"
        return source or self.pair[0], receiver

    def _row_parameter(self, entries: Mapping[str, str], place: str) -> str:
        """Return the parameter of a row; empty if it names none, or one that is not known."""
        text = entries.get("parameter", "")
        name = text if parameter_of(text) else name_and_unit(text)[0]
        parameter = self._closed(Column("parameter", text, parameter_of(name)), place)
        own = [c.parameter for c in self.columns if c.has_values]
        if parameter and "" not in own and parameter not in own:
            named = " and ".join(map(parameter_label, dict.fromkeys(own)))
            raise DataError(
                f'{place}: this row has the parameter "{shown(text)}", but the columns are '
                f'{named}. Name the column with its values "value"'
            )
        return parameter

    def _row_band(self, entries: Mapping[str, str], place: str) -> float | None:
        if "band" not in entries:
            return None
        frequency = frequency_of(entries["band"])
        if frequency is None:
            raise DataError(
                f'{place}: the band "{shown(entries["band"])}" is not a frequency in Hz. '
                f"{self._other_lines}"
            )
        column = next(c for c in self.columns if c.kind == "band")
        frequency *= 1000 if column.unit.lower() == "khz" else 1
        band = nearest_band(frequency)
        if band is None:
            raise DataError(f"{place}: {no_band(frequency)}")
        if abs(frequency / band - 1) > 0.015:
            self._note(f"{bands.label(frequency)} is read as {bands.label(band)}")
        return band

    def _number(self, cell: str, parameter: str, unit: str, place: str) -> float:
        """Return a cell's number in the unit of its parameter."""
        if cell.startswith(("<", ">", "\u2264", "\u2265")):
            raise DataError(
                f'{place}: "{shown(cell)}" is a limit, not a measured value; empty the cell'
            )
        own = unit_of(cell)
        cell, unit = cell.removesuffix(own).strip(), own or unit
        scale = scale_of(parameter, unit)
        if not scale:
            raise DataError(f"{place}: {wrong_unit(parameter, unit)}")
        return scale * number(cell.replace(",", ".") if self.comma else cell, place)

    def _check(self, parameter: str, value: float, place: str) -> None:
        """Raise DataError for a value that no room has, with the cure if another unit explains it."""
        observed, label = OBSERVABLES[parameter], parameter_label(parameter)
        try:
            observed.refuse(f"{place}: {label}", value)
        except DataError as error:
            unit = _OTHER_UNITS.get(observed.unit)
            if unit and _is_accepted(parameter, value * scale_of(parameter, unit)):
                columns = [
                    replace(c, unit=unit) if c.parameter == parameter and not c.unit else c
                    for c in self.columns
                ]
                named = f'"{label} [{unit}]" as the name of the column, the row or the sheet'
                lines = f"{self.first} to {self.rows[-1][0]}"
                cure = columns_text(lines, [c.meaning if c.kind else "-" for c in columns])
                stated = replace(self.options, columns=cure.partition('"')[2][:-1])
                is_cure = not (self.options.on_trial or _refusal(self.sheet, stated))
                cure = f", or give {cure}" * is_cure
                raise DataError(
                    f"{error}. If the values are in {unit}, write {named}{cure}"
                ) from error
            raise DataError(f"{error}. If this cell holds no measured value, empty it") from error

    def report(self, of_means: bool) -> list[str]:
        """Return how each column was read; ``of_means`` says that the file has no positions."""
        mark = "comma" if self.comma else "point"
        report = [f"{self.notes[0]}, decimal {mark}", *self.notes[1:]]
        for k, column in enumerate(self.columns, start=1):
            name = f'"{column.header}"' if column.header else f"column {k}"
            report.append(f"{name}: {column.meaning}")
        if errors := self.formula_errors:
            report.append(
                f"missing, because a formula has an error: {first_of(errors, _MOST_NAMED)}"
            )
        return report if of_means else report + self.of_positions


def _is_accepted(parameter: str, value: float) -> bool:
    try:
        OBSERVABLES[parameter].refuse("", value)
    except DataError:
        return False
    return True


def _values(tables: Sequence[_Table], options: _Options) -> tuple[Values, Values]:
    """Return the values of all tables: of single positions, and of several."""
    single: Values = {}
    of_several: Values = {}
    given: dict[Key, list[Sheet]] = {}
    for table in tables:
        sheet = table.sheet
        file = sheet.place.split(", sheet")[0]
        for place, key, numbers, statistic in table.values():
            at = f"{key[0]}, {key[1]} at {bands.label(key[3])}"
            twice = f"{place}: {parameter_label(key[2])} of {at} {_GIVEN_TWICE}"
            for other in given.get(key, ()):
                of_file = other.place.split(", sheet")[0] == file and other.name != sheet.name
                if of_file and not options.sheets:  # those that are named are meant together
                    raise DataError(
                        f"{twice}, first in {other.place}. Name each sheet after its parameter, such "
                        f'as T20 and EDT, or read one alone with sheets="{shown(other.name)}"'
                    )
            given.setdefault(key, []).append(sheet)
            values = single if statistic is None else of_several
            if statistic is None and options.repeats and SUMMARY not in key:
                repeats = ((key[0], n, *key[2:]) for n in names_of_repeats(key[1]))
                key = next(k for k in repeats if k not in values)
            held = values.setdefault(key, options.counts)
            if held.keys() & numbers.keys() & {"value", "standard_deviation"}:
                hint = ". If they are repeats at one position, use repeats=True"
                hint = ". Delete one of the means" if SUMMARY in key else hint
                raise DataError(f"{twice}{hint}")
            held.update(numbers)
    return single, of_several


def _measured(tables: Sequence[_Table], notes: list[str], options: _Options) -> MeasuredTable:
    """Return the measurement of all tables' values, and the reports of how they were read."""
    single, of_several = _values(tables, options)
    values = single or of_several
    places = ", ".join(dict.fromkeys(t.place for t in tables))
    if not values:
        unused = (note for t in tables for note in t.notes if note.startswith(_UNUSED))
        raise DataError("; ".join([f"{places}: no row with a value below the header", *unused]))
    pairs = list(dict.fromkeys(key[:2] for key in values))
    budget.require(len(pairs), MAX_PAIRS, "positions", places)
    if any(
        "standard_deviation" in v and not {"sources", "receivers"} <= {*v} for v in values.values()
    ):
        raise DataError(
            f"{places} on: a standard deviation over positions needs the numbers of sources and "
            "receivers; state n_sources and n_receivers"
        )
    report: list[str] = []
    for table in tables:
        if len(tables) > 1:
            report.append(f"{table.place}:")
        report += table.report((SUMMARY, SUMMARY) in pairs)
    named = [*dict.fromkeys(name for table in tables for name in table.statistics)]
    left_out = ""
    if single and (of_several or named):
        left_out = "rows of means and deviations beside single positions are left out"
    elif named := [name for name in named if statistic_of(name) == ""]:
        left_out = "rows of other statistics are left out"
    if left_out and named:
        left_out += f": {_quoted(named)}"
    notes = [*filter(None, [left_out]), *notes]
    # What stands after the first line of a single table's report is about the columns.
    at = 1 if len(tables) == 1 else len(report)
    report[at:at] = notes
    try:
        measured = Measurement(**of_single_values(values))
    except DataError as error:
        raise DataError(f"{places} on: {error}") from error
    placed = places_of(pairs)
    if options.repeats:
        require_repeats(placed, places)
    return MeasuredTable(measured, (*report, *note_of_repeats(placed)))


# -- what was read

MOST_NAMED = 4
"""Largest number of pairs or files that a sentence names."""
_FAR = 3.0
"""Ratio of a time to the median over the pairs above which it is told as a likely typing error."""


def means(measurement: Measurement) -> list[str]:
    """Return the means over the pairs as the lines of a printed table, one row per parameter."""
    n, rows, of_all = len(measurement.pairs), [], []
    for parameter in measurement.values:
        kind, mean = observable(parameter), measurement.mean(parameter)
        cells = [format(v, f".{kind.decimals}f") if np.isfinite(v) else "-" for v in mean]
        name = kind.label_of_band or kind.label
        rows.append((f"{name} / {kind.unit}".removesuffix(" / "), cells))
        if name != kind.label:
            of_all += wrapped(
                f"{name} is the modulation transfer index of one band. {kind.label} follows from all "
                "octaves, 125 to 8000 Hz."
            )
        overall = kind.overall(mean, measurement.centre_frequencies)
        if np.isfinite(overall):
            of_all.append(f"{kind.label} of all bands: {overall:.{kind.decimals}f}")
    title = f"Means over {n} pairs of source and receiver:" if n > 1 else "Values by band:"
    header = ("", bands.labels(measurement.centre_frequencies))
    return [title, *table_lines(rows, header=header), *of_all]


def spread(values: Sequence[float] | Array, form: str) -> str:
    """Return the least and the largest value as text; one number if both are printed alike."""
    ends = dict.fromkeys(format(v, form) for v in (np.min(values), np.max(values)))
    return " to ".join(ends)


def unusual(measurement: Measurement) -> tuple[str, ...]:
    """Return notes on likely typing errors, and on values that hardly any room or other pair has."""
    notes = [error.sentence for error in in_measurement(measurement)]
    pairs, frequencies = measurement.pairs, measurement.centre_frequencies
    for parameter, table in measurement.values.items():
        kind = observable(parameter)
        odd = np.argwhere((table < kind.usual[0]) | (table > kind.usual[1]))
        if not odd.size:
            notes += _far_from_others(measurement, parameter) if kind.unit == "s" else []
            continue
        i, k = odd[0]
        place = "" if measurement.is_summary else f"{' to '.join(pairs[i])} "
        more = f", and {len(odd) - 1} more" if len(odd) > 1 else ""
        notes.append(
            f"hardly any room has {kind.label} of {table[i, k]:g} {kind.unit} ({place}at "
            f"{bands.label(frequencies[k])}{more}): check the column, the unit and the decimal "
            "point"
        )
    return tuple(notes)


def _far_from_others(measurement: Measurement, parameter: str) -> list[str]:
    """Return a note on times far from the median over the pairs of their band (`_FAR`)."""
    table, pairs, label = measurement.values[parameter], measurement.pairs, bands.label
    counts = np.isfinite(table).sum(axis=0)
    median = np.full(len(counts), np.inf)
    median[counts > 2] = np.nanmedian(table[:, counts > 2], axis=0)
    # Early parameters are short near a source.
    late = np.isfinite(median) & (observable(parameter) in REVERBERATION)
    least = np.where(late, median, 0.0) / _FAR
    found = [
        f"{table[i, k]:g} s ({' to '.join(pairs[i])} at {label(measurement.centre_frequencies[k])}; "
        f"median over the pairs {median[k]:.3g} s)"
        for i, k in np.argwhere((table > _FAR * median) | (table < least))
    ]
    if not found:
        return []
    return [
        f"{parameter_label(parameter)} is {_FAR:g} times as long as at the other pairs, or as "
        f"short: {first_of(found, MOST_NAMED)}. Check the decimal point, and whether the row is "
        "a position"
    ]
