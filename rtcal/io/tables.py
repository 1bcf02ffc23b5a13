"""Tables of measured values, as measuring systems and spreadsheets write them.

A format is one module that turns a file into `Sheet`s of cells: text with separators (CSV,
`table_layout`), workbooks (`workbook`, xlsx), and REW's and the XL2's text (`instruments`). What the
cells mean is decided here, in all formats alike. The header decides between five shapes:

- *long*: one value per row, in the columns of the native file or their usual spellings;
- *bands across*: one row per parameter or position, one column per band;
- *bands down*: one row per band, one column per parameter;
- *positions across*: one row per band, one column per position (``S1R1``, ``S1R1#2`` for a repeat);
- *corner*: as the last two, and the first header names the parameter of all values.

A parameter or a position that neither rows nor columns name may be the name of the sheet, or a title
above the header. Columns of text are separated by ``;``, tab or ``,``. Decimals may have a comma if
columns are not separated by commas, or if the cell is quoted. Nothing is guessed: the result describes
how each column was read, and an error names what the user must state.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import (
    Measurement,
    csv_rows,
    names_of_repeats,
    note_of_repeats,
    of_single_values,
    places_of,
    require_repeats,
)
from rtcal.acoustics.observables import OBSERVABLES, SUMMARY, TARGET, parameter_label
from rtcal.files.disk import read_bytes, write_bytes
from rtcal.io import instruments, workbook
from rtcal.io.analysis import means, unusual
from rtcal.io.table_columns import (
    DECAY_TIMES_OF_RT60,
    DOUBTFUL,
    FORMULA_ERRORS,
    OPEN,
    WHOLE_RANGES,
    Column,
    channel_in,
    column_of,
    frequency_of,
    is_doubtful,
    is_missing,
    is_unused,
    name_and_unit,
    nearest_band,
    no_band,
    parameter_of,
    parameters,
    plain,
    position_in,
    position_of,
    scale_of,
    statistic_of,
    with_repeats,
    wrong_unit,
)
from rtcal.io.table_layout import (
    CellTable,
    Sheet,
    has_header,
    open_decay_time,
    sheet_of_text,
    tables_of,
)
from rtcal.io.text import decode, number, shown, unit_of
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

__all__ = ["FORMATS", "MeasuredTable", "measurement", "parse", "read", "write"]
__dir__ = __all__.copy

MAX_PAIRS = 5000
MAX_BYTES = 2**22
"""Largest size of a table in bytes; a workbook of 5000 positions, compressed, is a tenth of it."""
_MOST_COLUMNS = 20
"""Largest number of columns that a message names."""
_MOST_STATISTICS = 6
"""Largest number of rows of statistics that a message names."""
_LEAST_VALUES = 3
"""Of a parameter without a unit, that tell it."""
_OTHER_UNITS = {"s": "ms", "": "%"}
"""The unit in which programs write a parameter, too."""
_SPREADS = ("uncertainty", "common_uncertainty", "standard_deviation")
_NUMBER = re.compile(
    r"[+\-\u2212\u2013]?(\d+([.,]\d*)?|[.,]\d+)([eE][+\-\u2212]?\d{1,3})?", re.ASCII
)

FORMATS: list[Any] = [workbook, instruments]
"""Formats beside text with separators. Each has ``claims(content)`` and
``sheets(content, path, where)``; one of your own is appended (docs/extending.md)."""

Key = tuple[str, str, str, float]
"""Source, receiver, parameter and band in Hz of a value."""

Values = dict[Key, dict[str, float]]
"""The numbers of each value: "value", "uncertainty", "standard_deviation", "sources", "receivers"."""


@dataclass(frozen=True)
class MeasuredTable:
    """A measurement read from a table, and how each column was read."""

    measurement: Measurement
    columns: tuple[str, ...]

    def __str__(self) -> str:
        """Return what is in doubt, how each column was read, and the means of what was read."""
        return "\n".join([*self.doubts, *self.columns, "", *means(self.measurement)])

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on values that are read all the same, and that a typing error may explain."""
        return unusual(self.measurement)


@dataclass(frozen=True, kw_only=True)
class _Options:
    """What the user states of tables; see `read`."""

    decay_time: str | None = None
    parameter: str | None = None
    where: Mapping[str, str] = field(default_factory=dict)
    ignore: Collection[str] = ()
    n_sources: int | None = None
    n_receivers: int | None = None
    repeats: bool = False
    sheets: Collection[str] = ()

    def __post_init__(self) -> None:
        for name, choices in (("decay_time", DECAY_TIMES_OF_RT60), ("parameter", (*OBSERVABLES,))):
            if getattr(self, name) is not None:
                checks.choice(name, getattr(self, name), choices)
        for name in ("n_sources", "n_receivers"):
            if getattr(self, name) is not None:
                checks.whole(name, getattr(self, name), 1)
        checks.flag("repeats", self.repeats)
        object.__setattr__(self, "where", checks.text_by_name("where", self.where))
        for name in ("ignore", "sheets"):
            texts = getattr(self, name)
            texts = (texts,) if isinstance(texts, str) else checks.texts(name, texts)
            object.__setattr__(self, name, texts)

    @property
    def counts(self) -> dict[str, float]:
        """The stated numbers of sources and receivers of means."""
        stated = {"sources": self.n_sources, "receivers": self.n_receivers}
        return {name: float(n) for name, n in stated.items() if n is not None}


def read(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    decay_time: str | None = None,
    parameter: str | None = None,
    where: Mapping[str, str] | None = None,
    ignore: Collection[str] = (),
    n_sources: int | None = None,
    n_receivers: int | None = None,
    repeats: bool = False,
    sheets: Collection[str] = (),
) -> MeasuredTable:
    """Return the measurement of a table, or of several: one per position, as REW exports them.

    Parameters
    ----------
    path : path or sequence of paths
    decay_time : {"t20", "t30"}, optional
        The decay time in a column "RT60" or "T60".
    parameter : str, optional
        The parameter of values for which the table names none. It is refused, as ``decay_time``,
        where the table's own names leave nothing open.
    where : mapping of str to str, optional
        Selects rows by the entry of a column: ``{"room": "CR2"}``.
    ignore : collection of str, optional
        Columns to ignore.
    n_sources, n_receivers : int, optional
        Numbers of sources and receivers, if the values are means over several pairs.
    repeats : bool
        Whether several values of one pair, parameter and band are repeats, and averaged. Else they are
        refused, unless their names are ``R1``, ``R1#2`` and so on. Refused where nothing is repeated.
    sheets : collection of str, optional
        Sheets of a workbook to read; by default all that have a header.

    Raises
    ------
    DataError
        Naming file, sheet, line and rule.
    MissingDependencyError
        For a workbook (xlsx) without openpyxl.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else checks.listed("path", path)
    return parse(
        {os.fspath(checks.path("path", p)): read_bytes(p, MAX_BYTES) for p in paths},
        decay_time=decay_time,
        parameter=parameter,
        where=where,
        ignore=ignore,
        n_sources=n_sources,
        n_receivers=n_receivers,
        repeats=repeats,
        sheets=sheets,
    )


def parse(
    content: bytes | Mapping[str, bytes], path: str = "table", **stated: Any
) -> MeasuredTable:
    """Return the measurement of a table's content, or of several by their names.

    ``stated`` are the options of `read`.
    """
    checks.text("path", path)
    contents = {path: content} if isinstance(content, bytes) else checks.mapped("content", content)
    if not contents:
        raise DataError("no table is given")
    options = _Options(**{name: value for name, value in stated.items() if value is not None})
    found: list[CellTable] = []
    notes: list[str] = []
    for path, content in contents.items():
        checks.content(checks.text("content: a name", path), content)
        of_file, left_out = _tables(content, path, options)
        found += of_file
        notes += left_out
    if not options.sheets:
        found, left_out = _of_places(found)
        notes += left_out
    _check_options(found, options)
    names = [t for table in found for t in table.titles]
    names += [n for table in found for n in table.cells("receiver") if position_in(n)]
    several = len({*filter(None, map(channel_in, names))}) > 1
    return _measured([_Reader(table, options, several) for table in found], notes, options)


def measurement(path: str | os.PathLike[str]) -> MeasuredTable:
    """Return the measurement of a native CSV file, of a workbook or of REW's text.

    Text of any other kind is refused as `rtcal.Measurement.from_file` refuses it: its columns are to
    be looked at first, with ``rtcal table``. ``columns`` is empty for the native file.
    """
    content = read_bytes(path, MAX_BYTES)
    if any(module.claims(content) for module in FORMATS):
        return read(path)
    return MeasuredTable(Measurement.from_file(os.fspath(path)), ())


def write(measurement: Measurement, path: str | os.PathLike[str]) -> None:
    """Write the native table, one value per row: CSV, or a workbook if the name ends in .xlsx."""
    checks.instance("measurement", measurement, Measurement)
    if checks.path("path", path).suffix.lower() == workbook.ENDING:
        write_bytes(path, workbook.content({"measurement": csv_rows(measurement.to_dict())}))
    else:
        measurement.save(os.fspath(path))


def sheets_of(
    content: bytes,
    path: str,
    where: Mapping[str, str] | None = None,
    extra_columns: Collection[str] = (),
) -> list[Sheet]:
    """Return the sheets of a file by the first of `FORMATS` that claims it, else of its text.

    ``where`` selects the widths of bands of REW's text, ``extra_columns`` are columns without values.
    """
    for module in FORMATS:
        if module.claims(content):
            sheets: list[Sheet] = module.sheets(content, path, where or {})
            return sheets
    return [sheet_of_text(decode(content, path), path, extra_columns)]


def _tables(content: bytes, path: str, options: _Options) -> tuple[list[CellTable], list[str]]:
    """Return the tables of a file that are to be read, and a note on sheets that are left out.

    An error of a sheet names those that are tables.
    """
    extra = {*options.where, *options.ignore}
    of_file = sheets_of(content, path, options.where, extra)
    if options.repeats:
        of_file = [
            replace(s, rows=tuple((at, with_repeats(cells)) for at, cells in s.rows))
            for s in of_file
        ]
    there = [sheet.name for sheet in of_file]
    if missing := [name for name in options.sheets if name not in there]:
        raise DataError(
            f'{path}: sheets="{shown(missing[0])}" is no sheet; they are '
            + (", ".join(f'"{shown(n)}"' for n in there if n) or "without a name")
        )
    chosen = [s for s in of_file if s.name in options.sheets]
    if not options.sheets:
        chosen = [s for s in of_file if len(of_file) == 1 or has_header(s)] or of_file
    tables: list[CellTable] = []
    errors = []
    for sheet in chosen:
        try:
            tables += tables_of(sheet, decay_time=options.decay_time, extra_columns=extra)
        except DataError as error:
            errors.append(error)
    if errors:
        names = dict.fromkeys(table.sheet.name for table in tables if table.sheet.name)
        only = " or ".join(f'sheets="{shown(name)}"' for name in names)
        raise DataError(f"{errors[0]}; or read only {only}" if only else str(errors[0]))
    left_out = [f'"{shown(s.name)}"' for s in of_file if s not in chosen]
    if options.sheets or not left_out:
        return tables, []
    return tables, [f"left out, without a header: {', '.join(left_out)}"]


def _of_places(found: list[CellTable]) -> tuple[list[CellTable], list[str]]:
    """Return the tables without those called after a statistic beside others of a position each."""
    named = [(table, table.sheet.position[1] or table.sheet.name) for table in found]
    kept = [table for table, name in named if statistic_of(name) is None]
    if not any(any(_position(table.sheet)) for table in kept) or len(kept) == len(found):
        return found, []
    for table, name in named:
        if statistic_of(name) == DOUBTFUL:
            raise DataError(
                f'{table.sheet.place}: "{shown(name)}" may be a statistic or a position: leave it out; '
                "or, if it is a position, name its receiver, as R7"
            )
    left_out = dict.fromkeys(f'"{shown(n)}"' for _, n in named if statistic_of(n) is not None)
    which = first_of([*left_out], _MOST_STATISTICS)
    return kept, [f"tables of means and deviations beside single positions are left out: {which}"]


def _check_options(found: Sequence[CellTable], options: _Options) -> None:
    """Raise DataError for an option that changes nothing in any table.

    That is a parameter where the tables name those of all values, a column to ignore that is not there,
    and a decay time where nothing is called RT60.
    """
    place, first = found[0].place, found[0].columns
    if options.parameter is not None and all(map(_names_parameters, found)):
        named = [c.header for c in first if c.parameter or c.kind == "parameter"]
        raise DataError(
            f'{place}: parameter="{options.parameter}" is not used, since the table names its own '
            f"({_quoted(named)}); leave it out"
        )
    headers = {c.header for table in found for c in table.columns}
    if missing := [name for name in options.ignore if name not in headers]:
        raise DataError(
            f'{place}: ignore="{shown(missing[0])}" is no column; they are '
            f"{_quoted([c.header for c in first])}"
        )
    if options.decay_time is not None and not any(
        any(c.is_open for c in table.columns)
        or any(named.is_open for named, _ in _titles(table))
        or any(parameter_of(cell) == OPEN for cell in table.cells("parameter"))
        for table in found
    ):
        raise DataError(
            f'{place}: decay_time="{options.decay_time}" is not used, since nothing in the table is '
            "called RT60 or T60; leave it out"
        )


def _names_parameters(table: CellTable) -> bool:
    """Return whether a table names the parameters of all its values."""
    rows_name = any(c.kind == "parameter" for c in table.columns)
    return rows_name or all(c.parameter for c in table.columns if c.has_values)


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f'"{shown(name)}"' for name in names[:_MOST_COLUMNS])


def _named(text: str) -> Column | None:
    """Return the parameter that a sheet's name, a title or an entry is; None for another text."""
    column = column_of(text) if text else None
    alone = column is not None and column.parameter and not column.has_band and not column.wrong
    return column if alone else None


def _titles(table: CellTable) -> list[tuple[Column, str]]:
    """Return the parameters that a table is called after, and these names."""
    texts = (table.sheet.name, *table.titles)
    return [(column, text) for text in texts if (column := _named(text)) is not None]


def _parameter(table: CellTable, options: _Options) -> Column | None:
    """Return the parameter of a table's values that name none.

    It is stated, or named by the sheet, by a title or by the rows that ``where`` selects; DataError
    where two of them contradict each other.
    """
    place, stated = table.sheet.place, options.parameter
    rows = _named_by_rows(table, options)
    if _names_parameters(table):
        for row, selection in rows:
            other = next((c for c in table.columns if c.parameter not in ("", row.parameter)), None)
            if other is not None:
                raise DataError(
                    f"{place}: {selection} selects rows of {parameter_label(row.parameter)}, and "
                    f'the column "{shown(other.header)}" is {parameter_label(other.parameter)}'
                )
        return None
    named = [*rows]
    for column, text in _titles(table):
        if column.is_open and stated is None and options.decay_time is None:
            raise DataError(f"{place}: {open_decay_time(text)}")
        if column.is_open:
            column = replace(column, parameter=options.decay_time or TARGET.key)
        named.append((column, f'the table\'s name "{shown(text)}"'))
    if stated is not None:
        for column, origin in named:
            if column.parameter != stated:
                raise DataError(
                    f'{place}: parameter="{stated}" is stated, and {origin} says '
                    f"{parameter_label(column.parameter)}; state only what is so"
                )
        return Column("data", stated, stated, unit=rows[0][0].unit if rows else "")
    return named[0][0] if len({column.parameter for column, _ in named}) == 1 else None


def _named_by_rows(table: CellTable, options: _Options) -> list[tuple[Column, str]]:
    """Return the parameters that the entries of ``where`` are, and how each was stated.

    An entry is one only if its column has several parameters, or nothing else: a room may be called
    D50. Raises DataError for an entry that is a parameter without use.
    """
    found = []
    for header, entry in options.where.items():
        at = next((i for i, c in enumerate(table.columns) if c.header == header), None)
        if at is None:
            continue
        entries = dict.fromkeys(cells[at] for _, cells in table.rows)
        names = [e for e in entries if is_unused(e) or _named(e)]
        if not names or (len(names) < 2 and len(names) < len(entries)) or entry not in names:
            continue
        selection = f'where={{"{shown(header)}": "{shown(entry)}"}}'
        column = _named(entry)
        if column is None:
            used = ", ".join(f"{shown(n)!r}" for n in names if not is_unused(n))
            raise DataError(
                f"{table.sheet.place}: {selection} selects rows of a parameter that rtcal has no use "
                f"for; select one of {used}"
            )
        if column.is_open:
            if options.decay_time is None:
                raise DataError(f"{table.sheet.place}: {selection}: {open_decay_time(entry)}")
            column = replace(column, parameter=options.decay_time)
        found.append((column, selection))
    return found


def _position(sheet: Sheet) -> tuple[str, str]:
    """Return the source and receiver that a table is called after; a mean has none."""
    if not sheet.position[0] and statistic_of(sheet.position[1]) not in (None, DOUBTFUL):
        return "", ""
    return sheet.position if any(sheet.position) else position_of(sheet.name) or ("", "")


@dataclass
class _Value:
    """The numbers of one value of a row, of single positions unless it is a ``statistic``."""

    place: str
    key: Key
    numbers: dict[str, float]
    statistic: str | None
    has_unit: bool


class _Reader:
    """Reads the rows of a table.

    A row has a value for each column of values. It may also have an uncertainty, a statistic (mean or
    standard deviation), and the number of positions of a mean. ``several_channels`` says whether titles
    or positions name several channels, each a receiver.
    """

    def __init__(self, table: CellTable, options: _Options, several_channels: bool) -> None:
        self.table, self.options = table, options
        self.path, self.columns = table.sheet.place, table.columns
        self.parameter = _parameter(table, options)
        self.channels = several_channels and not options.repeats
        self.channel = next(filter(None, map(channel_in, reversed(table.titles))), None)
        self.notes = list(table.notes)
        self.formula_errors: list[str] = []  # the places of values that are missing for it
        self.statistics: dict[str, None] = {}  # names of the rows of statistics over positions
        self.unnamed_means = False  # whether a mean without a parameter or band was left out
        kinds = [c.kind for c in self.columns]
        across = [c for c in self.columns if c.receiver]
        placed = {"source", "receiver"} & {*kinds} or across
        position = ("", "") if placed else _position(table.sheet)
        self.has_positions = bool(placed or position[1])
        if options.counts and self.has_positions:
            raise DataError(
                f"{table.place}: numbers of sources and receivers are stated for means, but the table "
                "has single positions"
            )
        is_summary = options.counts or {"sources", "receivers", "standard_deviation"} & {*kinds}
        self.pair = (position[0] or "S1", position[1] or "R1")
        if is_summary and not self.has_positions:
            self.pair = (SUMMARY, SUMMARY)
        if {*_SPREADS} & {*kinds} and sum(c.has_values for c in self.columns) > 1:
            raise DataError(
                f"{table.place}: a column of uncertainties needs one value per row; there are several"
            )
        self.comma = self._decimal_comma()
        self.example_of_both = self._example_of_both() if "source" not in kinds else None
        if not self.has_positions:
            of_positions = [
                "no positions: taken as source S1 and receiver R1; if the values are means, state "
                "n_sources and n_receivers"
            ]
        elif self.example_of_both:
            source, receiver = self._pair_of({"receiver": self.example_of_both})
            of_positions = [
                f'positions name both: "{self.example_of_both}" is source {source}, receiver {receiver}'
            ]
        elif position[1]:
            of_positions = [f"all values are of {self.pair[0]} to {self.pair[1]}, the table's name"]
        else:
            of_positions = []
            if "source" not in kinds and not (across and all(c.source for c in across)):
                only = "all positions are taken as receivers of source S1"
                of_positions.append(f"no source is named: {only}")
            if "receiver" not in kinds and not across:
                of_positions.append("no receiver is named: taken as receiver R1 of each source")
        self.of_positions = of_positions

    def _cells_of_values(self, cells: Sequence[str]) -> list[str]:
        """Return the cells of a row that have values."""
        pairs = zip(self.columns, cells, strict=True)
        return [cell for column, cell in pairs if column.has_values and not is_missing(cell)]

    def _decimal_comma(self) -> bool:
        """Return whether decimals have a comma; DataError if they have commas and points."""
        commas = points = False
        for line, cells in self.table.rows:
            for cell in self._cells_of_values(cells):
                digits = cell.removesuffix(unit_of(cell)).strip()
                if _NUMBER.fullmatch(digits):
                    commas |= "," in digits
                    points |= "." in digits
            if commas and points:
                raise DataError(
                    f"{self.path}, line {line}: decimal commas and decimal points in one table"
                )
        return commas

    def _example_of_both(self) -> str | None:
        """Return the first position that names source and receiver; None if none does.

        Raises DataError for a row of values among such positions that is none of them.
        """
        at = next((i for i, column in enumerate(self.columns) if column.kind == "receiver"), None)
        if at is None:
            return None
        rows = [
            (line, cells[at])
            for line, cells in self.table.rows
            if statistic_of(cells[at]) in (None, DOUBTFUL) and self._cells_of_values(cells)
        ]
        both = [bool((p := position_of(name) or position_in(name)) and p[0]) for _, name in rows]
        if 2 * sum(both) <= len(both):  # few may be receivers that are called so
            return None
        first = rows[both.index(True)][1]
        if not all(both):
            line, name = rows[both.index(False)]
            raise DataError(
                f'{self.path}, line {line}: "{shown(name)}" is no position as "{shown(first)}" is; if '
                "the row is no position, delete it; else name its source and receiver"
            )
        return first

    def values(self) -> list[_Value]:
        """Return the values of the rows that ``where`` selects."""
        headers, where = [c.header for c in self.columns], self.options.where
        for name in where:
            if headers.count(name) != 1:
                raise DataError(f'{self.table.place}: column "{shown(name)}" is not there once')
        chosen = [
            (line, cells)
            for line, cells in self.table.rows
            if all(cells[headers.index(name)] == entry for name, entry in where.items())
        ]
        if not chosen and where:
            selection = ", ".join(f"{name} = {entry}" for name, entry in where.items())
            raise DataError(f'{self.table.place}: no row has "{shown(selection)}"')
        values = [
            v for line, cells in chosen for v in self._of_row(cells, f"{self.path}, line {line}")
        ]
        other = self._other_units([value for value in values if not value.has_unit])
        for value in values:
            parameter = value.key[2]
            if not value.has_unit:
                for name in {*_SPREADS, "value"} & {*value.numbers}:
                    value.numbers[name] *= other.get(parameter, 1.0)
            if "value" in value.numbers:
                self._check(parameter, value.numbers["value"], value.place)
        return values

    def _other_units(self, values: Sequence[_Value]) -> dict[str, float]:
        """Return the factor of each parameter of which no value is possible but in another unit.

        Programs write D50 in percent and Ts in ms without saying so. A few values may be errors of
        typing, and are refused.
        """
        of_parameter: dict[str, list[float]] = {}
        for value in values:
            if "value" in value.numbers:
                of_parameter.setdefault(value.key[2], []).append(value.numbers["value"])
        factors = {}
        for parameter, found in of_parameter.items():
            unit = _OTHER_UNITS.get(OBSERVABLES[parameter].unit)
            if unit is None or len(found) < _LEAST_VALUES:
                continue
            factor = scale_of(parameter, unit)
            possible = [_is_accepted(parameter, value) for value in found]
            if not any(possible) and all(_is_accepted(parameter, factor * v) for v in found):
                factors[parameter] = factor
                self.notes.append(
                    f"{parameter_label(parameter)} has no unit, and is read in {unit}: no other fits"
                )
        return factors

    def _of_row(self, cells: Sequence[str], place: str) -> Iterator[_Value]:
        """Yield the values of a row."""
        entries = {
            column.kind: cell
            for column, cell in zip(self.columns, cells, strict=True)
            if column.kind and not column.has_values
        }
        statistic = self._statistic(entries, self._cells_of_values(cells), place)
        if statistic == "" or self._is_unused(entries):
            return
        if (
            statistic is not None
            and self.has_positions
            and not all(entries.get(name, "?") for name in ("parameter", "band"))
        ):
            self.unnamed_means = True
            return
        of_row = (SUMMARY, SUMMARY) if statistic is not None else self._pair_of(entries)
        row_band = self._row_band(entries, place)
        for column, cell in zip(self.columns, cells, strict=True):
            if column.has_values and cell.lower() in FORMULA_ERRORS:
                self.formula_errors.append(f"{cell} in line {place.rpartition(' ')[2]}")
            if not column.has_values or is_missing(cell):
                continue
            source, receiver = of_row
            if column.receiver:
                source, receiver = column.source or source, column.receiver
            text_name(f"{place}: a position", source + receiver)
            parameter = column.parameter or self._row_parameter(entries, place)
            if "parameter" in entries and parameter != (
                self._row_parameter(entries, place) if column.is_open else parameter
            ):
                raise DataError(
                    f'{place}: the row says "{shown(entries["parameter"])}", and "'
                    f'{shown(column.header)}" is stated to be {parameter_label(column.parameter)}; '
                    'name the column "value"'
                )
            if not parameter:
                raise DataError(
                    f'{place}: no heading says which parameter the value "{shown(cell)}" is; '
                    f"state it: {self._likely_parameter()}"
                )
            band = column.band if column.has_band else row_band
            if band is None:
                raise DataError(f'{place}: no band for the value "{shown(cell)}"')
            unit = column.unit
            if not column.parameter:  # its row may state one, by itself or as "TS/ms"
                of_name = name_and_unit(entries.get("parameter", ""))[1]
                unit = entries.get("unit", "") or of_name or unit
                if self.parameter is not None and "parameter" not in entries:
                    unit = unit or self.parameter.unit
            stated = {name: entries[name] for name in _SPREADS if name in entries}
            numbers = {
                name: self._number(text, parameter, unit, place)
                for name, text in {statistic or "value": cell, **stated}.items()
                if not is_missing(text)
            }
            for name in ("sources", "receivers"):
                if not is_missing(entries.get(name, "")):
                    numbers[name] = number(entries[name], place)
            if min(numbers.get(name, 0.0) for name in _SPREADS) < 0:
                raise DataError(f"{place}: an uncertainty or standard deviation is below 0")
            key = (source, receiver, parameter, band)
            yield _Value(place, key, numbers, statistic, bool(unit or unit_of(cell)))

    def _statistic(
        self, entries: Mapping[str, str], values: Sequence[str], place: str
    ) -> str | None:
        """Return the statistic of a row of means or deviations; None for single values.

        A mean over the sources at one receiver is no value of this table's, and is left out.
        """
        if "statistic" in entries:
            word = entries["statistic"]
            found = statistic_of(word)
            if found in (None, DOUBTFUL):
                raise DataError(
                    f'{place}: statistic "{shown(word)}" is no known one, as mean, standard deviation, '
                    "minimum, median and count are"
                )
            return found
        receiver, source = (entries.get(name, "") for name in ("receiver", "source"))
        statistics = [n for n in (receiver, source) if n and statistic_of(n) is not None]
        if not statistics:
            return None
        for name in statistics:
            if values and is_doubtful(name, values):
                raise DataError(
                    f'{place}: "{shown(name)}" may be a statistic or a remark, or a position: delete '
                    "the row; or, if it is a position, give it another name"
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
        self._note(f"left out, since rtcal has no use for it as {note}")
        return True

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def _pair_of(self, entries: Mapping[str, str]) -> tuple[str, str]:
        """Return the source and the receiver of a row."""
        source, receiver = entries.get("source"), entries.get("receiver")
        channel = self.channel
        if self.example_of_both and receiver:
            channel = channel_in(receiver) or channel
            source, receiver = position_of(receiver) or position_in(receiver) or (source, receiver)
        receiver = receiver or self.pair[1]
        if self.channels and channel:
            place, mark, repeat = receiver.partition("#")
            receiver = f"{place}-{channel}{mark}{repeat}"
        return source or self.pair[0], receiver

    def _likely_parameter(self) -> str:
        """Return the option for a table whose title has other words beside its parameter."""
        words = re.findall(r"[A-Za-z]+\d*", " ".join(self.table.titles))
        likely = {p for word in words if word.isupper() and (p := parameters().get(plain(word)))}
        if len(likely) != 1:
            return 'parameter="t20", for instance'
        return f'parameter="{likely.pop()}", if the title means this table'

    def _row_parameter(self, entries: Mapping[str, str], place: str) -> str:
        """Return the parameter of a row, else of the table; empty if neither names one."""
        if "parameter" not in entries:
            return "" if self.parameter is None else self.parameter.parameter
        text = entries["parameter"]
        parameter = parameter_of(text) or parameter_of(name_and_unit(text)[0])
        if not parameter:
            raise DataError(f'{place}: parameter "{shown(text)}" is unknown')
        if parameter == OPEN and self.options.decay_time is None:
            raise DataError(f"{place}: {open_decay_time(text)}")
        return self.options.decay_time or "" if parameter == OPEN else parameter

    def _row_band(self, entries: Mapping[str, str], place: str) -> float | None:
        if "band" not in entries:
            return None
        frequency = frequency_of(entries["band"])
        if frequency is None:
            raise DataError(f'{place}: band "{shown(entries["band"])}" is no frequency in Hz')
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
            raise DataError(f'{place}: "{shown(cell)}" is a limit and no value: empty the cell')
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
            text = str(error) if str(error).endswith("?") else f"{error}."
            unit = _OTHER_UNITS.get(observed.unit)
            if unit and _is_accepted(parameter, value * scale_of(parameter, unit)):
                raise DataError(
                    f'{text} If so, write "{label} [{unit}]" as the name of the column, the row or '
                    "the sheet"
                ) from error
            raise DataError(f"{text} If it is no measurement, empty the cell") from error

    def report(self, of_means: bool) -> list[str]:
        """Return how each column was read; ``of_means`` says that the file has no positions."""
        mark = "comma" if self.comma else "point"
        report = [f"{self.notes[0]}, decimal {mark}", *self.notes[1:]]
        stated = self.parameter.parameter if self.parameter is not None else None
        report += [column.description(stated) for column in self.columns]
        if errors := self.formula_errors:
            are = "value is" if len(errors) == 1 else "values are"
            report.append(
                f"{len(errors)} {are} missing, since a formula has an error: {', '.join(errors[:3])}"
                + (", ..." if len(errors) > 3 else "")
            )
        if of_means:
            return report
        if self.channels:
            report.append(
                "several channels: each is a receiver, named after it; if they are repeats of one "
                "place, state repeats=True"
            )
        return report + self.of_positions


def _is_accepted(parameter: str, value: float) -> bool:
    try:
        OBSERVABLES[parameter].refuse("", value)
    except DataError:
        return False
    return True


def _values(readers: Sequence[_Reader], options: _Options) -> tuple[Values, Values]:
    """Return the values of all tables: of single positions, and of several.

    Raises DataError for a value that another row, or another table, has given.
    """
    single: Values = {}
    of_several: Values = {}
    given: dict[Key, list[Sheet]] = {}
    for reader in readers:
        sheet = reader.table.sheet
        file = sheet.place.split(", sheet")[0]
        for value in reader.values():
            key = value.key
            at = f"{key[0]}, {key[1]} at {bands.label(key[3])}"
            twice = f"{value.place}: {parameter_label(key[2])} of {at} is given twice"
            for other in given.get(key, ()):
                of_file = other.place.split(", sheet")[0] == file and other.name != sheet.name
                if of_file and not options.sheets:  # those that are named are meant together
                    raise DataError(
                        f"{twice}, first by {other.place}. Which parameter does each sheet hold? Give "
                        "the sheets their parameters as names in the workbook, such as T20, EDT and "
                        "C80; or read one alone, with its parameter: "
                        f'sheets="{shown(other.name)}"'
                    )
            given.setdefault(key, []).append(sheet)
            values = single if value.statistic is None else of_several
            if value.statistic is None and options.repeats:
                repeats = ((key[0], n, *key[2:]) for n in names_of_repeats(key[1]))
                key = next(k for k in repeats if k not in values)
            held = values.setdefault(key, options.counts)
            if held.keys() & value.numbers.keys() & {"value", "standard_deviation"}:
                hint = "" if SUMMARY in key else "; if they are repeats, state repeats=True"
                raise DataError(f"{twice}{hint}")
            held.update(value.numbers)
    return single, of_several


def _measured(readers: Sequence[_Reader], notes: list[str], options: _Options) -> MeasuredTable:
    """Return the measurement of all tables' values, and the reports of how they were read."""
    single, of_several = _values(readers, options)
    values = single or of_several
    places = ", ".join(dict.fromkeys(r.table.place for r in readers))
    if not values and any(reader.unnamed_means for reader in readers):
        raise DataError(
            f"{places}: no row of a position, and only of means: delete the column that names them, "
            "and state n_sources and n_receivers"
        )
    if not values:
        raise DataError(f"{places}: no row with a value below the header")
    pairs = list(dict.fromkeys(key[:2] for key in values))
    if len(pairs) > MAX_PAIRS:
        raise DataError(f"{places}: {len(pairs)} positions; at most {MAX_PAIRS}")
    try:
        placed = places_of(pairs)
    except DataError as error:
        raise DataError(f"{places}: {error}") from error
    if options.repeats:
        require_repeats(placed, places)
    for (_, _, parameter, band), numbers in values.items():
        if "value" not in numbers:
            raise DataError(
                f"{places} on: {parameter_label(parameter)} at {bands.label(band)} has a standard "
                "deviation and no mean"
            )
        if "standard_deviation" in numbers and not {"sources", "receivers"} <= {*numbers}:
            raise DataError(
                f"{places} on: a standard deviation over positions needs the numbers of sources and "
                "receivers; state n_sources and n_receivers"
            )
    report: list[str] = []
    for reader in readers:
        if len(readers) > 1:
            report.append(f"{reader.table.place}:")
        report += reader.report((SUMMARY, SUMMARY) in pairs)
    named = [*dict.fromkeys(name for reader in readers for name in reader.statistics)]
    left_out = ""
    if single and (of_several or named):
        left_out = "rows of means and deviations beside single positions are left out"
    elif named := [name for name in named if statistic_of(name) == ""]:
        left_out = "rows of other statistics are left out"
    if left_out and named:
        quoted = [f'"{shown(name)}"' for name in named]
        left_out += f": {first_of(quoted, _MOST_STATISTICS)}"
    notes = [*filter(None, [left_out]), *notes]
    # What stands after the first line of a single table's report is about the columns.
    at = 1 if len(readers) == 1 else len(report)
    report[at:at] = notes
    report += note_of_repeats(placed)
    try:
        return MeasuredTable(Measurement(**of_single_values(values)), tuple(report))
    except DataError as error:
        raise DataError(f"{places} on: {error}") from error
