"""Tables of measured values, as measuring systems and spreadsheets write them.

A format is one module that turns a file into `Sheet`s of cells: text with separators (CSV), workbooks
(`workbook`, xlsx), and REW's and the XL2's text (both `text_tables`). What the cells mean is decided
here, in all formats alike. The header decides between five shapes:

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
from dataclasses import dataclass, replace
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
from rtcal.files.disk import read_bytes
from rtcal.io import text_tables, workbook
from rtcal.io.analysis import means, unusual
from rtcal.io.table_columns import (
    DECAY_TIMES_OF_RT60,
    DOUBTFUL,
    FORMULA_ERRORS,
    WHOLE_RANGES,
    Column,
    channel_in,
    column_of,
    frequency_of,
    is_count,
    is_missing,
    is_unused,
    leaves_decay_time_open,
    name_and_unit,
    nominal_band,
    parameter_of,
    parameters,
    plain,
    position_in,
    position_of,
    scale_of,
    statistic_of,
    with_repeats,
)
from rtcal.io.table_layout import Row, Sheet, TableLayout, has_header, layout_of
from rtcal.io.text import decode, number, shown, unit_of
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

__all__ = ["FORMATS", "MeasuredTable", "measurement", "parse", "read", "write"]
__dir__ = __all__.copy

_NUMBER = re.compile(
    r"[+\-\u2212\u2013]?(\d+([.,]\d*)?|[.,]\d+)([eE][+\-\u2212]?\d{1,3})?", re.ASCII
)
_OTHER_UNITS = {"s": "ms", "": "%"}
"""The unit in which programs write a parameter, too."""
_LEAST_VALUES = 3
"""Of a parameter without a unit, that tell it."""
_SPREADS = ("uncertainty", "common_uncertainty", "standard_deviation")

Key = tuple[str, str, str, float]
"""Source, receiver, parameter and band in Hz of a value."""

Values = dict[Key, dict[str, float]]
"""The numbers of each value: "value", "uncertainty", "standard_deviation", "sources", "receivers"."""


class Reader:
    """Reads the rows of a table.

    A row has a value for each column of values. It may also have an uncertainty, a statistic (mean or
    standard deviation), and the number of positions of a mean.

    Parameters
    ----------
    path : str
        The table's name in messages.
    layout : Layout
    decay_time : str or None
        The decay time that is called RT60.
    parameter : Column or None
        The parameter of values for which neither row nor column names one, with its unit.
    position : (str, str)
        Source and receiver of values whose rows and columns name none; empty if not known.
    counts : mapping of str to float
        The stated numbers of sources and receivers of means.
    repeats : bool
        Whether several values of one place are repeats.
    channels : bool
        Whether titles or positions name several channels, each a receiver.
    """

    def __init__(
        self,
        path: str,
        layout: TableLayout,
        *,
        decay_time: str | None,
        parameter: Column | None,
        position: tuple[str, str],
        counts: Mapping[str, float],
        repeats: bool,
        channels: bool = False,
    ) -> None:
        self.path, self.layout, self.counts, self.repeats = path, layout, counts, repeats
        self.channels = channels
        self.channel = next(filter(None, map(channel_in, reversed(layout.titles))), None)
        self.decay_time, self.parameter = decay_time, parameter
        self.header_place = f"{path}, line {layout.header_line}"
        self.notes = list(layout.notes)
        self.given: set[Key] = set()
        self.beside: Sequence[Reader] = ()
        kinds = [c.kind for c in layout.columns]
        across = any(c.receiver for c in layout.columns)
        if across or {"source", "receiver"} & {*kinds}:
            position = ("", "")  # of values that name none
        self.has_positions = bool({"source", "receiver"} & {*kinds} or across or position[1])
        if counts and self.has_positions:
            raise DataError(
                f"{self.header_place}: numbers of sources and receivers are stated for means, but "
                "the table has single positions"
            )
        is_summary = bool(counts) or {"sources", "receivers", "standard_deviation"} & {*kinds}
        self.named = bool(position[1])
        self.formula_errors: list[str] = []  # the places of values that are missing for it
        self.statistics: dict[str, None] = {}  # names of the rows of statistics over positions
        self.unnamed_means = False  # whether a mean without a parameter or band was left out
        self.pair = (position[0] or "S1", position[1] or "R1")
        if is_summary and not self.has_positions:
            self.pair = (SUMMARY, SUMMARY)
        if {*_SPREADS} & {*kinds} and (kinds.count("data") + kinds.count("value") > 1):
            raise DataError(
                f"{self.header_place}: a column of uncertainties needs one value per row; there "
                "are several"
            )
        self.comma = self._decimal_comma()
        self.example_of_both = self._example_of_both() if "source" not in kinds else None

    def _example_of_both(self) -> str | None:
        """Return the first position that names source and receiver; None if none does.

        Raises DataError for a row of values among such positions that is none of them.
        """
        columns = self.layout.columns
        at = [i for i, column in enumerate(columns) if column.kind == "receiver"]
        rows = [
            (line, cells[at[0]])
            for line, cells in self.layout.rows
            if at
            and statistic_of(cells[at[0]]) in (None, DOUBTFUL)
            and any(
                column.kind in ("data", "value") and not is_missing(cell)
                for column, cell in zip(columns, cells, strict=True)
            )
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

    def add_to(self, single: Values, of_several: Values, where: Mapping[str, str]) -> None:
        """Add the values of the rows that ``where`` selects: of positions, and of several.

        Raises DataError for a value that another row, or another table of the file, has given.
        """
        rows = []
        for line, cells in self._selected(where):
            place = f"{self.path}, line {line}"
            entries = {
                column.kind: cell
                for column, cell in zip(self.layout.columns, cells, strict=True)
                if column.kind not in ("data", "")
            }
            statistic = self._statistic(entries, cells, place)
            rows += [
                (statistic, place, *value)
                for value in self._values(cells, entries, statistic, place)
            ]
        other = self._other_units([(key, numbers) for *_, key, numbers, named in rows if not named])
        for statistic, place, key, numbers, named in rows:
            values = single if statistic is None else of_several
            if not named:
                scaled = {*_SPREADS, "value"} & {*numbers}
                numbers |= {name: numbers[name] * other.get(key[2], 1.0) for name in scaled}
            if "value" in numbers:
                self._check(key[2], numbers["value"], f"{place}: {parameter_label(key[2])}")
            self.given.add(key)
            self._refuse_other_sheet(key, place)
            if statistic is None and self.repeats:
                repeats = ((key[0], n, *key[2:]) for n in names_of_repeats(key[1]))
                key = next(k for k in repeats if k not in values)
            held = values.setdefault(key, dict(self.counts))
            if held.keys() & numbers.keys() & {"value", "standard_deviation"}:
                hint = "" if SUMMARY in key else "; if they are repeats, state repeats=True"
                raise DataError(
                    f"{place}: {parameter_label(key[2])} of {key[0]}, {key[1]} at "
                    f"{bands.label(key[3])} is given twice{hint}"
                )
            held.update(numbers)

    def _other_units(self, values: Sequence[tuple[Key, Mapping[str, float]]]) -> dict[str, float]:
        """Return the factor of each parameter of which no value is possible but in another unit.

        Programs write D50 in percent and Ts in ms without saying so. A few values may be errors of
        typing, and are refused.
        """
        of_parameter: dict[str, list[float]] = {}
        for key, numbers in values:
            if "value" in numbers:
                of_parameter.setdefault(key[2], []).append(numbers["value"])
        factors = {}
        for parameter, found in of_parameter.items():
            unit = _OTHER_UNITS.get(OBSERVABLES[parameter].unit)
            if unit is None or len(found) < _LEAST_VALUES:
                continue
            factor = scale_of(parameter, unit, self.header_place)
            possible = [_is_accepted(parameter, value) for value in found]
            if not any(possible) and all(_is_accepted(parameter, factor * v) for v in found):
                factors[parameter] = factor
                self.notes.append(
                    f"{parameter_label(parameter)} has no unit, and is read in {unit}: no other fits"
                )
        return factors

    def _refuse_other_sheet(self, key: Key, place: str) -> None:
        """Raise DataError for a value that another sheet of the file has: of another kind, likely."""
        other = next((reader for reader in self.beside if key in reader.given), None)
        if other is not None:
            name = shown(other.path.partition(', sheet "')[2].rstrip('"'))
            raise DataError(
                f"{place}: {parameter_label(key[2])} of {key[0]}, {key[1]} at {bands.label(key[3])} is "
                f"given twice, first by {other.path}. Which parameter does each sheet hold? Give the "
                "sheets their parameters as names in the workbook, such as T20, EDT and C80; or read "
                f'one alone, with its parameter: sheets="{name}"'
            )

    def _selected(self, where: Mapping[str, str]) -> list[Row]:
        headers = [c.header for c in self.layout.columns]
        for name in where:
            if headers.count(name) != 1:
                raise DataError(f'{self.header_place}: column "{shown(name)}" is not there once')
        rows = [
            (line, cells)
            for line, cells in self.layout.rows
            if all(cells[headers.index(name)] == entry for name, entry in where.items())
        ]
        if not rows and where:
            selection = ", ".join(f"{name} = {entry}" for name, entry in where.items())
            raise DataError(f'{self.header_place}: no row has "{shown(selection)}"')
        return rows

    def _statistic(
        self, entries: Mapping[str, str], cells: Sequence[str], place: str
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
        named = {name: statistic_of(name) for name in (receiver, source) if name}
        statistics = {name: kind for name, kind in named.items() if kind is not None}
        if not statistics:
            return None
        values = [
            cell
            for column, cell in zip(self.layout.columns, cells, strict=True)
            if column.kind in ("data", "value") and not is_missing(cell)
        ]
        for name, kind in statistics.items():
            counts = not is_count(name) or all(cell.isdecimal() for cell in values)
            if values and (kind == DOUBTFUL or not counts):
                raise DataError(
                    f'{place}: "{shown(name)}" may be a statistic or a remark, or a position: delete '
                    "the row; or, if it is a position, give it another name"
                )
        name, kind = next(iter(statistics.items()))
        self.statistics[name] = None
        if receiver and receiver not in statistics:
            return ""
        return kind

    def _values(
        self, cells: list[str], entries: Mapping[str, str], statistic: str | None, place: str
    ) -> Iterator[tuple[Key, dict[str, float], bool]]:
        """Yield the key and the numbers of each value of a row, and whether its unit is stated."""
        if statistic == "" or self._is_unused(entries):
            return
        named = all(entries.get(name, "?") for name in ("parameter", "band"))
        if statistic is not None and self.has_positions and not named:
            self.unnamed_means = True
            return
        of_row = (SUMMARY, SUMMARY) if statistic is not None else self._pair_of(entries)
        row_band = self._row_band(entries, place)
        for column, cell in zip(self.layout.columns, cells, strict=True):
            if column.kind in ("data", "value") and cell.lower() in FORMULA_ERRORS:
                self.formula_errors.append(f"{cell} in line {place.rpartition(' ')[2]}")
            if column.kind not in ("data", "value") or is_missing(cell):
                continue
            pair = of_row
            if column.receiver:
                pair = (column.source or of_row[0], column.receiver)
            text_name(f"{place}: a position", "".join(pair))
            parameter = column.parameter or self._row_parameter(entries, place)
            of_the_row = (
                self._row_parameter(entries, place) if column.decay_time_open else parameter
            )
            if "parameter" in entries and of_the_row != parameter:
                raise DataError(
                    f'{place}: the row says "{shown(entries["parameter"])}", and "'
                    f'{shown(column.header)}" is stated to be {parameter_label(column.parameter)}; '
                    'name the column "value"'
                )
            band = column.band if column.has_band else row_band
            if parameter is None:
                raise DataError(
                    f'{place}: no heading says which parameter the value "{shown(cell)}" is; '
                    f"state it: {self._likely_parameter()}"
                )
            if band is None:
                raise DataError(f'{place}: no band for the value "{shown(cell)}"')
            unit = column.unit if column.parameter else self._row_unit(entries) or column.unit
            if self.parameter is not None and not (column.parameter or "parameter" in entries):
                unit = unit or self.parameter.unit
            kind = statistic or "value"
            numbers = {kind: self._number(cell, parameter, unit, place)}
            for name in _SPREADS:
                if not is_missing(entries.get(name, "")):
                    numbers[name] = self._number(entries[name], parameter, unit, place)
            for name in ("sources", "receivers"):
                if not is_missing(entries.get(name, "")):
                    numbers[name] = number(entries[name], place)
            if min(numbers.get(n, 0.0) for n in _SPREADS) < 0:
                raise DataError(f"{place}: an uncertainty or standard deviation is below 0")
            yield (*pair, parameter, band), numbers, bool(unit or unit_of(cell))

    def _is_unused(self, entries: Mapping[str, str]) -> bool:
        """Return whether a row is of the whole range, or of a parameter without use; it is noted."""
        for kind, what in (("parameter", "a parameter"), ("band", "a band")):
            word = entries.get(kind, "")
            if plain(word) in WHOLE_RANGES if kind == "band" else is_unused(word):
                note = f'left out, since rtcal has no use for it as {what}: "{shown(word)}"'
                if note not in self.notes:
                    self.notes.append(note)
                return True
        return False

    def _pair_of(self, entries: Mapping[str, str]) -> tuple[str, str]:
        """Return the source and the receiver of a row."""
        source, receiver = entries.get("source"), entries.get("receiver")
        channel = self.channel
        if self.example_of_both and receiver:
            channel = channel_in(receiver) or channel
            source, receiver = position_of(receiver) or position_in(receiver) or (source, receiver)
        receiver = receiver or self.pair[1]
        if self.channels and channel and not self.repeats:
            place, mark, repeat = receiver.partition("#")
            receiver = f"{place}-{channel}{mark}{repeat}"
        return source or self.pair[0], receiver

    def _likely_parameter(self) -> str:
        """Return the option for a table whose title has other words beside its parameter."""
        words = re.findall(r"[A-Za-z]+\d*", " ".join(self.layout.titles))
        known = parameters()
        likely = {p for word in words if word.isupper() and (p := known.get(plain(word)))}
        if len(likely) != 1:
            return 'parameter="t20", for instance'
        return f'parameter="{likely.pop()}", if the title means this table'

    def _row_parameter(self, entries: Mapping[str, str], place: str) -> str | None:
        if "parameter" not in entries:
            return None if self.parameter is None else self.parameter.parameter
        text = entries["parameter"]
        parameter = parameter_of(text, place, self.decay_time)
        if parameter is None:
            parameter = parameter_of(name_and_unit(text)[0], place, self.decay_time)
        if parameter is None:
            raise DataError(f'{place}: parameter "{shown(entries["parameter"])}" is unknown')
        return parameter

    def _row_unit(self, entries: Mapping[str, str]) -> str:
        """Return the unit that a row states by itself or behind its parameter ("TS/ms")."""
        return entries.get("unit", "") or name_and_unit(entries.get("parameter", ""))[1]

    def _row_band(self, entries: Mapping[str, str], place: str) -> float | None:
        if "band" not in entries:
            return None
        frequency = frequency_of(entries["band"])
        if frequency is None:
            raise DataError(f'{place}: band "{shown(entries["band"])}" is no frequency in Hz')
        column = next(c for c in self.layout.columns if c.kind == "band")
        frequency *= 1000 if column.unit.lower() == "khz" else 1
        band = nominal_band(frequency, place)
        self._note_band(frequency, band)
        return band

    def _note_band(self, frequency: float, band: float) -> None:
        note = f"{bands.label(frequency)} is read as {bands.label(band)}"
        if abs(frequency / band - 1) > 0.015 and note not in self.notes:
            self.notes.append(note)

    def _number(self, cell: str, parameter: str, unit: str, place: str) -> float:
        """Return a cell's number in the unit of its parameter."""
        if cell.startswith(("<", ">", "\u2264", "\u2265")):
            raise DataError(f'{place}: "{shown(cell)}" is a limit and no value: empty the cell')
        own = unit_of(cell)
        cell, unit = cell.removesuffix(own).strip(), own or unit
        scale = scale_of(parameter, unit, place)
        return scale * number(cell.replace(",", ".") if self.comma else cell, place)

    def _check(self, parameter: str, value: float, place: str) -> None:
        """Raise DataError for a value that no room has, with the cure if another unit explains it."""
        observed = OBSERVABLES[parameter]
        try:
            observed.refuse(place, value)
        except DataError as error:
            label = parameter_label(parameter)
            text = str(error) if str(error).endswith("?") else f"{error}."
            unit = _OTHER_UNITS.get(observed.unit)
            if unit and _is_accepted(parameter, value * scale_of(parameter, unit, place)):
                raise DataError(
                    f'{text} If so, write "{label} [{unit}]" as the name of the column, the row or '
                    "the sheet"
                ) from error
            raise DataError(f"{text} If it is no measurement, empty the cell") from error

    def _decimal_comma(self) -> bool:
        """Return whether decimals have a comma; DataError if they have commas and points."""
        commas = points = 0
        for line, cells in self.layout.rows:
            for column, cell in zip(self.layout.columns, cells, strict=True):
                if column.kind in ("data", "value"):
                    digits = cell.removesuffix(unit_of(cell)).strip()
                    if _NUMBER.fullmatch(digits):
                        commas += "," in digits
                        points += "." in digits
            if commas and points:
                raise DataError(
                    f"{self.path}, line {line}: decimal commas and decimal points in one table"
                )
        return commas > 0

    def report(self, pairs: Collection[tuple[str, str]]) -> list[str]:
        """Return how each column was read; ``pairs`` are those of the file."""
        mark = "comma" if self.comma else "point"
        report = [f"{self.notes[0]}, decimal {mark}", *self.notes[1:]]
        stated = self.parameter.parameter if self.parameter is not None else None
        report += [column.description(stated) for column in self.layout.columns]
        if errors := self.formula_errors:
            are = "value is" if len(errors) == 1 else "values are"
            report.append(
                f"{len(errors)} {are} missing, since a formula has an error: {', '.join(errors[:3])}"
                + (", ..." if len(errors) > 3 else "")
            )
        if (SUMMARY, SUMMARY) in pairs:
            return report
        if self.channels and not self.repeats:
            report.append(
                "several channels: each is a receiver, named after it; if they are repeats of one "
                "place, state repeats=True"
            )
        if not self.has_positions:
            report.append(
                "no positions: taken as source S1 and receiver R1; if the values are means, state "
                "n_sources and n_receivers"
            )
        elif self.example_of_both:
            source, receiver = self._pair_of({"receiver": self.example_of_both})
            report.append(
                f'positions name both: "{self.example_of_both}" is source {source}, receiver {receiver}'
            )
        elif self.named:
            report.append(f"all values are of {self.pair[0]} to {self.pair[1]}, the table's name")
        else:
            kinds = {c.kind for c in self.layout.columns}
            across = [c for c in self.layout.columns if c.receiver]
            if "source" not in kinds and not all(c.source for c in across or [Column("data")]):
                report.append(
                    "no source is named: all positions are taken as receivers of source S1"
                )
            if "receiver" not in kinds and not across:
                report.append("no receiver is named: taken as receiver R1 of each source")
        return report


def _is_accepted(parameter: str, value: float) -> bool:
    try:
        OBSERVABLES[parameter].refuse("", value)
    except DataError:
        return False
    return True


MAX_PAIRS = 5000
MAX_BYTES = 2**22
"""Largest size of a table in bytes; a workbook of 5000 positions, compressed, is a tenth of it."""
_MOST_COLUMNS = 20
"""Largest number of columns that a message names."""
_MOST_STATISTICS = 6
"""Largest number of rows of statistics that a message names."""

FORMATS: list[Any] = [workbook, text_tables]
"""Formats beside text with separators. Each has ``claims(content)`` and
``sheets(content, path, where)``; one of your own is appended (docs/extending.md)."""


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
    content: bytes | Mapping[str, bytes],
    path: str = "table",
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
    """Return the measurement of a table's content, or of several by their names; see `read`."""
    checks.text("path", path)
    contents = {path: content} if isinstance(content, bytes) else checks.mapped("content", content)
    if not contents:
        raise DataError("no table is given")
    for name, choice, choices in (
        ("decay_time", decay_time, DECAY_TIMES_OF_RT60),
        ("parameter", parameter, tuple(OBSERVABLES)),
    ):
        if choice is not None:
            checks.choice(name, choice, choices)
    stated: dict[str, float] = {}
    for name, count in (("sources", n_sources), ("receivers", n_receivers)):
        if count is not None:
            stated[name] = checks.whole(f"n_{name}", count, 1)
    checks.flag("repeats", repeats)
    where = checks.text_by_name("where", where)
    ignore = (ignore,) if isinstance(ignore, str) else checks.texts("ignore", ignore)
    sheets = (sheets,) if isinstance(sheets, str) else checks.texts("sheets", sheets)
    columns = {*where, *ignore}
    found: list[tuple[Sheet, TableLayout]] = []
    notes: list[str] = []
    for path, content in contents.items():
        checks.content(checks.text("content: a name", path), content)
        of_file = _sheets(content, path, where, decay_time, columns)
        if repeats:
            of_file = [
                replace(s, rows=tuple((at, with_repeats(cells)) for at, cells in s.rows))
                for s in of_file
            ]
        chosen, left_out = _chosen(of_file, sheets, path, decay_time)
        notes += left_out
        found += _layouts(chosen, decay_time, columns)
    if not sheets:
        found, left_out = _of_places(found)
        notes += left_out
    _check_options(found, parameter=parameter, decay_time=decay_time, ignore=ignore)
    of_titles = [t for _, layout in found for t in layout.titles]
    of_names = [n for _, layout in found for n in layout.cells("receiver") if position_in(n)]
    readers = [
        Reader(
            sheet.place,
            layout,
            decay_time=decay_time,
            parameter=_parameter(sheet, layout, parameter, decay_time, where),
            position=_position(sheet),
            counts=stated,
            repeats=repeats,
            channels=len({*filter(None, map(channel_in, of_titles + of_names))}) > 1,
        )
        for sheet, layout in found
    ]
    for i, ((sheet, _), reader) in enumerate(zip(found, readers, strict=True)):
        if not sheets:  # those that are named are meant together
            reader.beside = [
                other for (s, _), other in zip(found[:i], readers, strict=False) if _alike(s, sheet)
            ]
    return _table(readers, where, notes, repeats)


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
        workbook.write({"measurement": csv_rows(measurement.to_dict())}, path)
    else:
        measurement.save(os.fspath(path))


def _alike(one: Sheet, other: Sheet) -> bool:
    """Whether two tables are sheets of one file."""
    return (
        one.name != other.name and one.place.split(", sheet")[0] == other.place.split(", sheet")[0]
    )


def _sheets(
    content: bytes,
    path: str,
    where: Mapping[str, str],
    decay_time: str | None,
    columns: Collection[str],
) -> list[Sheet]:
    """Return the sheets of a file, by the first format that claims its content."""
    for module in FORMATS:
        if module.claims(content):
            sheets: list[Sheet] = module.sheets(content, path, where)
            return sheets
    text = decode(content, path)
    return [text_tables.sheet_of_text(text, path, decay_time=decay_time, extra_columns=columns)]


def _chosen(
    of_file: list[Sheet], names: Collection[str], path: str, decay_time: str | None
) -> tuple[list[Sheet], list[str]]:
    """Return the sheets to read, and a note on those that are left out."""
    if names:
        there = [sheet.name for sheet in of_file]
        if missing := [name for name in names if name not in there]:
            raise DataError(
                f'{path}: sheets="{shown(missing[0])}" is no sheet; they are '
                + (", ".join(f'"{shown(n)}"' for n in there if n) or "without a name")
            )
        return [sheet for sheet in of_file if sheet.name in names], []
    chosen = [
        sheet for sheet in of_file if len(of_file) == 1 or has_header(sheet, decay_time)
    ] or of_file
    left_out = [f'"{shown(s.name)}"' for s in of_file if s not in chosen]
    return chosen, [f"left out, without a header: {', '.join(left_out)}"] if left_out else []


def _of_places(
    found: list[tuple[Sheet, TableLayout]],
) -> tuple[list[tuple[Sheet, TableLayout]], list[str]]:
    """Return the tables without those called after a statistic beside others of a position each."""
    names = {id(sheet): sheet.position[1] or sheet.name for sheet, _ in found}
    kinds = {key: statistic_of(name) for key, name in names.items()}
    if not any(any(_position(sheet)) for sheet, _ in found if kinds[id(sheet)] is None):
        return found, []
    for sheet, _ in found:
        if kinds[id(sheet)] == DOUBTFUL:
            raise DataError(
                f'{sheet.place}: "{shown(names[id(sheet)])}" may be a statistic or a position: leave '
                "it out; or, if it is a position, name its receiver, as R7"
            )
    left_out = [f'"{shown(names[key])}"' for key, kind in kinds.items() if kind is not None]
    kept = [(sheet, layout) for sheet, layout in found if kinds[id(sheet)] is None]
    if not left_out:
        return kept, []
    which = first_of(left_out, _MOST_STATISTICS)
    return kept, [f"tables of means and deviations beside single positions are left out: {which}"]


def _layouts(
    chosen: Sequence[Sheet], decay_time: str | None, columns: Collection[str]
) -> list[tuple[Sheet, TableLayout]]:
    """Return the tables of the sheets; an error names the sheets that are tables."""
    found: list[tuple[Sheet, TableLayout]] = []
    errors = []
    for sheet in chosen:
        try:
            layouts = layout_of(sheet, decay_time=decay_time, extra_columns=columns)
        except DataError as error:
            errors.append(error)
        else:
            found += [(sheet, layout) for layout in layouts]
    if errors:
        tables = dict.fromkeys(sheet.name for sheet, _ in found if sheet.name)
        only = " or ".join(f'sheets="{shown(name)}"' for name in tables)
        raise DataError(f"{errors[0]}; or read only {only}" if only else str(errors[0]))
    return found


def _check_options(
    found: Sequence[tuple[Sheet, TableLayout]],
    *,
    parameter: str | None,
    decay_time: str | None,
    ignore: Collection[str],
) -> None:
    """Raise DataError for an option that changes nothing in any table.

    That is a parameter where the tables name those of all values, a column to ignore that is not there,
    and a decay time where nothing is called RT60.
    """
    place = f"{found[0][0].place}, line {found[0][1].header_line}"
    first, layouts = found[0][1].columns, [layout for _, layout in found]
    if parameter is not None and all(map(_names_parameters, layouts)):
        named = [c.header for c in first if c.parameter or c.kind == "parameter"]
        raise DataError(
            f'{place}: parameter="{parameter}" is not used, since the table names its own '
            f"({_quoted(named)}); leave it out"
        )
    headers = {c.header for layout in layouts for c in layout.columns}
    if missing := [name for name in ignore if name not in headers]:
        raise DataError(
            f'{place}: ignore="{shown(missing[0])}" is no column; they are '
            f"{_quoted([c.header for c in first])}"
        )
    names = [text for sheet, layout in found for text in (sheet.name, *layout.titles)]
    if decay_time is not None and not (
        any(map(_leaves_open, names))
        or any(c.decay_time_open for layout in layouts for c in layout.columns)
        or any(leaves_decay_time_open(c) for layout in layouts for c in layout.cells("parameter"))
    ):
        raise DataError(
            f'{place}: decay_time="{decay_time}" is not used, since nothing in the table is called '
            "RT60 or T60; leave it out"
        )


def _names_parameters(layout: TableLayout) -> bool:
    """Return whether a table names the parameters of all its values."""
    values = [c for c in layout.columns if c.kind in ("data", "value")]
    rows_name = any(c.kind == "parameter" for c in layout.columns)
    return rows_name or all(c.parameter for c in values)


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f'"{shown(name)}"' for name in names[:_MOST_COLUMNS])


def _leaves_open(text: str) -> bool:
    named = _named(text, TARGET.key)
    return named is not None and named.decay_time_open


def _named(text: str, decay_time: str) -> Column | None:
    """Return the parameter that a sheet's name or a title is; None for another text."""
    try:
        column = column_of(text, "", decay_time) if text else None
    except DataError:  # an unknown unit, or a number that is no band
        return None
    only = column is not None and column.kind == "data" and column.parameter
    return column if only and column and not column.has_band else None


def _parameter(
    sheet: Sheet,
    layout: TableLayout,
    stated: str | None,
    decay_time: str | None,
    where: Mapping[str, str],
) -> Column | None:
    """Return the parameter of a table's values that name none.

    It is stated, or named by the sheet, by a title or by the rows that ``where`` selects; DataError
    where two of them contradict each other.
    """
    rows = _named_by_rows(sheet, layout, decay_time, where)
    if _names_parameters(layout):
        for row, selection in rows:
            other = next(
                (c for c in layout.columns if c.parameter not in ("", row.parameter)), None
            )
            if other is not None:
                raise DataError(
                    f"{sheet.place}: {selection} selects rows of {parameter_label(row.parameter)}, and "
                    f'the column "{shown(other.header)}" is {parameter_label(other.parameter)}'
                )
        return None
    texts = [t for t in (sheet.name, *layout.titles) if _named(t, decay_time or TARGET.key)]
    if stated is None and decay_time is None:
        for text in filter(_leaves_open, texts):
            column_of(text, sheet.place, None)  # says which decay time is to be stated
    named = [*rows]
    for text in texts:
        column = _named(text, decay_time or TARGET.key)
        if column is not None:
            named.append((column, f'the table\'s name "{shown(text)}"'))
    if stated is not None:
        for column, origin in named:
            if column.parameter != stated:
                raise DataError(
                    f'{sheet.place}: parameter="{stated}" is stated, and {origin} says '
                    f"{parameter_label(column.parameter)}; state only what is so"
                )
        return Column("data", stated, stated, unit=rows[0][0].unit if rows else "")
    own = {column.parameter for column, _ in named}
    return named[0][0] if len(own) == 1 else None


def _named_by_rows(
    sheet: Sheet, layout: TableLayout, decay_time: str | None, where: Mapping[str, str]
) -> list[tuple[Column, str]]:
    """Return the parameters that the entries of ``where`` are, and how each was stated.

    An entry is one only if its column has several parameters, or nothing else: a room may be called
    D50. Raises DataError for an entry that is a parameter without use.
    """
    found = []
    for header, entry in where.items():
        at = next((i for i, c in enumerate(layout.columns) if c.header == header), None)
        if at is None:
            continue
        entries = dict.fromkeys(cells[at] for _, cells in layout.rows)
        names = [e for e in entries if is_unused(e) or _named(e, decay_time or TARGET.key)]
        if not names or (len(names) < 2 and len(names) < len(entries)) or entry not in names:
            continue
        selection = f'where={{"{shown(header)}": "{shown(entry)}"}}'
        if is_unused(entry):
            raise DataError(
                f"{sheet.place}: {selection} selects rows of a parameter that rtcal has no use for; "
                f"select one of {', '.join(f'{shown(n)!r}' for n in names if not is_unused(n))}"
            )
        column = column_of(entry, f"{sheet.place}: {selection}", decay_time)
        if column is not None:
            found.append((column, selection))
    return found


def _position(sheet: Sheet) -> tuple[str, str]:
    """Return the source and receiver that a table is called after; a mean has none."""
    if not sheet.position[0] and statistic_of(sheet.position[1]) not in (None, DOUBTFUL):
        return "", ""
    return sheet.position if any(sheet.position) else position_of(sheet.name) or ("", "")


def _table(
    readers: Sequence[Reader], where: Mapping[str, str], notes: list[str], repeats: bool
) -> MeasuredTable:
    """Return the measurement of all tables' values, and the reports of how they were read."""
    single: Values = {}
    of_several: Values = {}
    for reader in readers:
        reader.add_to(single, of_several, where)
    values = single or of_several
    places = ", ".join(dict.fromkeys(r.header_place for r in readers))
    if not values:
        if any(reader.unnamed_means for reader in readers):
            raise DataError(
                f"{places}: no row of a position, and only of means: delete the column that names "
                "them, and state n_sources and n_receivers"
            )
        raise DataError(f"{places}: no row with a value below the header")
    pairs = list(dict.fromkeys(key[:2] for key in values))
    try:
        placed = places_of(pairs)
    except DataError as error:
        raise DataError(f"{places}: {error}") from error
    if repeats:
        require_repeats(placed, places)
    report: list[str] = []
    for reader in readers:
        if len(readers) > 1:
            report.append(f"{reader.header_place}:")
        report += reader.report(pairs)
    if single and (of_several or any(reader.statistics for reader in readers)):
        named = dict.fromkeys(n for reader in readers for n in reader.statistics)
        which = first_of([f'"{shown(n)}"' for n in named], _MOST_STATISTICS)
        left_out = "rows of means and deviations beside single positions are left out"
        notes = [f"{left_out}: {which}" if named else left_out, *notes]
    elif unused := [n for r in readers for n in r.statistics if statistic_of(n) == ""]:
        which = first_of([f'"{shown(n)}"' for n in unused], _MOST_STATISTICS)
        notes = [f"rows of other statistics are left out: {which}", *notes]
    # What stands after the first line of a single table's report is about the columns.
    report[1:1] = notes if len(readers) == 1 else []
    report += [] if len(readers) == 1 else notes
    report += note_of_repeats(placed)
    return MeasuredTable(_measurement(values, places), tuple(report))


def _measurement(values: Values, place: str) -> Measurement:
    pairs = {key[:2] for key in values}
    if len(pairs) > MAX_PAIRS:
        raise DataError(f"{place}: {len(pairs)} positions; at most {MAX_PAIRS}")
    for key, numbers in values.items():
        _check_statistics(key, numbers, f"{place} on")
    try:
        return Measurement(**of_single_values(values))
    except DataError as error:
        raise DataError(f"{place} on: {error}") from error


def _check_statistics(key: Key, numbers: Mapping[str, float], place: str) -> None:
    if "value" not in numbers:
        raise DataError(
            f"{place}: {parameter_label(key[2])} at {bands.label(key[3])} has a standard "
            "deviation and no mean"
        )
    if "standard_deviation" in numbers and not {"sources", "receivers"} <= {*numbers}:
        raise DataError(
            f"{place}: a standard deviation over positions needs the numbers of sources "
            "and receivers; state n_sources and n_receivers"
        )
