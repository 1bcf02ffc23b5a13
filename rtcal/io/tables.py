"""Tables of measured values in CSV, as measuring systems and spreadsheets write them.

The header decides between three shapes:

- *long*: one value per row, in the columns of the native file or their usual spellings;
- *bands across*: one row per parameter or position, one column per band;
- *bands down*: one row per band, one column per parameter.

Columns are separated by ``;``, tab or ``,``. Decimals may have a comma if columns are not separated by
commas, or if the cell is quoted. Nothing is guessed: the result describes how each column was read, and
an error names what the user must state.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from rtcal.acoustics import bands
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.measurement_files import of_single_values
from rtcal.acoustics.observables import OBSERVABLES
from rtcal.acoustics.parameters import SUMMARY, parameter_label
from rtcal.acoustics.repeats import in_words, names_of_repeats, places_of
from rtcal.errors import DataError
from rtcal.io.analysis import means
from rtcal.io.table_columns import (
    DECAY_TIMES_OF_RT60,
    frequency_of,
    nominal_band,
    parameter_of,
    scale_of,
)
from rtcal.io.table_layout import Layout, Row, layout_of
from rtcal.io.table_options import check_options
from rtcal.io.text import MAX_TEXT, decode, number, shown
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.files import read_bytes

MAX_PAIRS = 5000
MAX_CELL = 60
"""Largest length of a cell in characters; the pattern for number and unit is slow on longer ones."""

_NUMBER = re.compile(
    r"[+\-\u2212\u2013]?(\d+([.,]\d*)?|[.,]\d+)([eE][+\-\u2212]?\d{1,3})?", re.ASCII
)
_POSITION = re.compile(
    r"(L?S\d+)[\s_-]*((?:MP|M|R)\d+(?:\s*#\d+)?)", re.I | re.ASCII
)  # source and receiver
_WITH_UNIT = re.compile(r"([^%a-z]*\d[\d.,]*(?:e[+-]?\d+)?)\s*(%|m?s|db)", re.I)
_MISSING = {
    "",
    "-",
    "--",
    "---",
    "\u2212",
    "\u2013",
    "\u2014",
    "*",
    "nan",
    "na",
    "n/a",
    "n.a.",
    "k.a.",
    "k. a.",
    "#n/a",
    "#nv",
    "#div/0!",
    "#wert!",
    "#value!",
}
_STATISTICS = {
    **dict.fromkeys(("mean", "average", "avg", "avg.", "mittel", "mittelwert", "mw"), "value"),
    **dict.fromkeys(
        ("sd", "std", "std.", "stdev", "stdabw", "standard deviation", "standardabweichung"),
        "standard_deviation",
    ),
    **dict.fromkeys(("min", "max", "median", "minimum", "maximum"), ""),
}

Key = tuple[str, str, str, float]
"""Source, receiver, parameter and band in Hz of a value."""


@dataclass(frozen=True)
class Table:
    """A measurement read from a table, and how each column was read."""

    measurement: Measurement
    columns: tuple[str, ...]

    def __str__(self) -> str:
        """Return how each column was read, and the means of what was read."""
        return "\n".join([*self.columns, "", *means(self.measurement)])


@checked
def read(
    path: str | os.PathLike[str],
    *,
    decay_time: str | None = None,
    parameter: str | None = None,
    where: Mapping[str, str] | None = None,
    ignore: Collection[str] = (),
    n_sources: int | None = None,
    n_receivers: int | None = None,
    repeats: bool = False,
) -> Table:
    """Return a table's measurement.

    Parameters
    ----------
    path : path
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
        refused, unless their names are ``R1``, ``R1#2`` and so on.

    Raises
    ------
    DataError
        Naming file, line and rule.
    """
    return parse(
        read_bytes(path, MAX_TEXT),
        os.fspath(path),
        decay_time=decay_time,
        parameter=parameter,
        where=where,
        ignore=ignore,
        n_sources=n_sources,
        n_receivers=n_receivers,
        repeats=repeats,
    )


@checked
def write(measurement: Measurement, path: str | os.PathLike[str]) -> None:
    """Write the native CSV: one value per row."""
    measurement.save(os.fspath(path))


@checked
def parse(
    content: bytes,
    path: str = "table",
    *,
    decay_time: str | None = None,
    parameter: str | None = None,
    where: Mapping[str, str] | None = None,
    ignore: Collection[str] = (),
    n_sources: int | None = None,
    n_receivers: int | None = None,
    repeats: bool = False,
) -> Table:
    """Return the measurement of a table's content; see `read`."""
    for name, choice, choices in (
        ("decay_time", decay_time, DECAY_TIMES_OF_RT60),
        ("parameter", parameter, tuple(OBSERVABLES)),
    ):
        if choice is not None and choice not in choices:
            raise DataError(f'{name} = "{choice}" is none of {", ".join(choices)}')
    stated: dict[str, float] = {}
    for name, count in (("sources", n_sources), ("receivers", n_receivers)):
        if count is not None:
            stated[name] = checks.whole(f"n_{name}", count, 1)
    checks.flag("repeats", repeats)
    where, ignore = where or {}, [ignore] if isinstance(ignore, str) else ignore
    layout = layout_of(
        decode(content, path), path, decay_time=decay_time, extra_columns={*where, *ignore}
    )
    check_options(layout, path, parameter=parameter, decay_time=decay_time, ignore=ignore)
    return _Reader(path, layout, decay_time, parameter, stated, repeats).table(where)


class _Reader:
    """Reads the rows of a table.

    A row has a value for each column of values. It may also have an uncertainty, a statistic (mean or
    standard deviation), and the number of positions of a mean.
    """

    def __init__(
        self,
        path: str,
        layout: Layout,
        decay_time: str | None,
        parameter: str | None,
        counts: Mapping[str, float],
        repeats: bool,
    ) -> None:
        self.path, self.layout, self.counts, self.repeats = path, layout, counts, repeats
        self.decay_time, self.parameter = decay_time, parameter
        self.header_place = f"{path}, line {layout.header_line}"
        self.notes = list(layout.notes)
        kinds = [c.kind for c in layout.columns]
        self.has_positions = "source" in kinds or "receiver" in kinds
        if counts and self.has_positions:
            raise DataError(
                f"{self.header_place}: numbers of sources and receivers are stated for means, but "
                "the table has single positions"
            )
        is_summary = bool(counts) or {"sources", "receivers", "standard_deviation"} & {*kinds}
        self.pair = (SUMMARY, SUMMARY) if is_summary and not self.has_positions else ("S1", "R1")
        if {"uncertainty", "standard_deviation"} & {*kinds} and (
            kinds.count("data") + kinds.count("value") > 1
        ):
            raise DataError(
                f"{self.header_place}: a column of uncertainties needs one value per row; there "
                "are several"
            )
        self.comma = self._decimal_comma()
        positions = layout.cells("receiver") if "source" not in kinds else []
        positions = [p for p in positions if p.lower() not in _STATISTICS]
        self.example_of_both = (
            positions[0] if positions and all(map(_POSITION.fullmatch, positions)) else None
        )

    def table(self, where: Mapping[str, str]) -> Table:
        """Return the measurement of the rows that ``where`` selects."""
        single: dict[Key, dict[str, float]] = {}
        of_several: dict[Key, dict[str, float]] = {}
        for line, cells in self._selected(where):
            place = f"{self.path}, line {line}"
            entries = {
                column.kind: cell
                for column, cell in zip(self.layout.columns, cells, strict=True)
                if column.kind not in ("data", "")
            }
            statistic = self._statistic(entries, place)
            values = single if statistic is None else of_several
            for key, numbers in self._values(cells, entries, statistic, place):
                if statistic is None and self.repeats:
                    named = ((key[0], n, *key[2:]) for n in names_of_repeats(key[1]))
                    key = next(k for k in named if k not in values)
                held = values.setdefault(key, dict(self.counts))
                if held.keys() & numbers.keys() & {"value", "standard_deviation"}:
                    hint = "" if SUMMARY in key else "; if they are repeats, state repeats=True"
                    raise DataError(
                        f"{place}: {parameter_label(key[2])} of {key[0]}, {key[1]} at "
                        f"{bands.label(key[3])} is given twice{hint}"
                    )
                held.update(numbers)
        if single and of_several:
            self.notes.append("rows of means and deviations beside single positions are left out")
        values = single or of_several
        if not values:
            raise DataError(f"{self.header_place}: no row with a value below the header")
        return Table(self._measurement(values), self._report(values))

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

    def _statistic(self, entries: Mapping[str, str], place: str) -> str | None:
        """Return the statistic of a row of means or deviations; None for single values."""
        if "statistic" in entries:
            word = entries["statistic"].lower()
            if word not in _STATISTICS:
                raise DataError(
                    f'{place}: statistic "{shown(word)}" is none of {", ".join(_STATISTICS)}'
                )
            return _STATISTICS[word]
        return _STATISTICS.get(entries.get("receiver", "").lower())

    def _values(
        self, cells: list[str], entries: Mapping[str, str], statistic: str | None, place: str
    ) -> Iterator[tuple[Key, dict[str, float]]]:
        """Yield the key and the numbers of each value of a row."""
        if statistic == "":
            return
        pair = (SUMMARY, SUMMARY) if statistic is not None else self._pair_of(entries)
        text_name(f"{place}: a position", "".join(pair))
        row_parameter, row_band = (
            self._row_parameter(entries, place),
            self._row_band(entries, place),
        )
        for column, cell in zip(self.layout.columns, cells, strict=True):
            if column.kind not in ("data", "value") or cell.lower() in _MISSING:
                continue
            parameter = column.parameter or row_parameter
            band = column.band if column.has_band else row_band
            if parameter is None:
                raise DataError(
                    f'{place}: the table does not say what "{shown(cell)}" is; state it: '
                    'parameter="t20", for instance'
                )
            if band is None:
                raise DataError(f'{place}: no band for the value "{shown(cell)}"')
            unit = column.unit if column.parameter else entries.get("unit", "") or column.unit
            kind = statistic or "value"
            numbers = {kind: self._number(cell, parameter, unit, place)}
            if kind == "value":
                label = parameter_label(parameter)
                OBSERVABLES[parameter].refuse(f"{place}: {label}", numbers["value"])
            for name in ("uncertainty", "standard_deviation"):
                if entries.get(name, "").lower() not in _MISSING:
                    numbers[name] = self._number(entries[name], parameter, unit, place)
            for name in ("sources", "receivers"):
                if entries.get(name, "").lower() not in _MISSING:
                    numbers[name] = number(entries[name], place)
            if min(numbers.get(n, 0.0) for n in ("uncertainty", "standard_deviation")) < 0:
                raise DataError(f"{place}: an uncertainty or standard deviation is below 0")
            yield (*pair, parameter, band), numbers

    def _pair_of(self, entries: Mapping[str, str]) -> tuple[str, str]:
        """Return the source and the receiver of a row."""
        source, receiver = entries.get("source"), entries.get("receiver")
        if self.example_of_both and receiver and (both := _POSITION.fullmatch(receiver)):
            source, receiver = both.groups()
        return source or self.pair[0], receiver or self.pair[1]

    def _row_parameter(self, entries: Mapping[str, str], place: str) -> str | None:
        if "parameter" not in entries:
            return self.parameter
        parameter = parameter_of(entries["parameter"], place, self.decay_time)
        if parameter is None:
            raise DataError(f'{place}: parameter "{shown(entries["parameter"])}" is unknown')
        return parameter

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
        match = _WITH_UNIT.fullmatch(cell[: MAX_CELL + 1])
        if match and len(cell) <= MAX_CELL:
            cell, unit = match[1].strip(), match[2]
        scale = scale_of(parameter, unit, place)
        return scale * number(cell.replace(",", ".") if self.comma else cell, place)

    def _decimal_comma(self) -> bool:
        """Return whether decimals have a comma; DataError if they have commas and points."""
        commas = points = 0
        for line, cells in self.layout.rows:
            for column, cell in zip(self.layout.columns, cells, strict=True):
                if column.kind in ("data", "value"):
                    match = _WITH_UNIT.fullmatch(cell[: MAX_CELL + 1])
                    digits = match[1].strip() if match else cell
                    if _NUMBER.fullmatch(digits):
                        commas += "," in digits
                        points += "." in digits
            if commas and points:
                raise DataError(
                    f"{self.path}, line {line}: decimal commas and decimal points in one table"
                )
        return commas > 0

    def _report(self, values: Mapping[Key, object]) -> tuple[str, ...]:
        mark = "comma" if self.comma else "point"
        report = [f"{self.notes[0]}, decimal {mark}", *self.notes[1:]]
        for column in self.layout.columns:
            report.append(column.description(self.parameter))
        pairs = {key[:2] for key in values}
        if pairs == {("S1", "R1")} and not self.has_positions:
            report.append(
                "no positions: taken as source S1 and receiver R1; if the values are means, state "
                "n_sources and n_receivers"
            )
        elif self.example_of_both and (SUMMARY, SUMMARY) not in pairs:
            source, receiver = self._pair_of({"receiver": self.example_of_both})
            report.append(
                f'positions name both: "{self.example_of_both}" is source {source}, receiver {receiver}'
            )
        elif self.has_positions and (SUMMARY, SUMMARY) not in pairs:
            kinds = {c.kind for c in self.layout.columns}
            if "source" not in kinds:
                report.append(
                    "no source is named: all positions are taken as receivers of source S1"
                )
            if "receiver" not in kinds:
                report.append("no receiver is named: taken as receiver R1 of each source")
        return (*report, *in_words(places_of([*dict.fromkeys(key[:2] for key in values)])))

    def _measurement(self, values: Mapping[Key, dict[str, float]]) -> Measurement:
        pairs = {key[:2] for key in values}
        if len(pairs) > MAX_PAIRS:
            raise DataError(f"{self.path}: {len(pairs)} positions; at most {MAX_PAIRS}")
        for key, numbers in values.items():
            place = f"{self.path}, from line {self.layout.header_line} on"
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
        try:
            return Measurement.from_dict(of_single_values(values))
        except DataError as error:
            raise DataError(
                f"{self.path}, from line {self.layout.header_line} on: {error}"
            ) from error
