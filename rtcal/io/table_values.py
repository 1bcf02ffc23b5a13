"""The values of one table: positions, parameters, bands, units and decimals of its rows."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence

from rtcal.acoustics import bands
from rtcal.acoustics.observables import OBSERVABLES, SUMMARY, parameter_label
from rtcal.acoustics.repeats import names_of_repeats
from rtcal.io.table_columns import (
    Column,
    channel_in,
    frequency_of,
    is_unused,
    name_and_unit,
    nominal_band,
    parameter_of,
    position_in,
    position_of,
    scale_of,
)
from rtcal.io.table_layout import Row, TableLayout
from rtcal.io.table_words import (
    DOUBTFUL,
    FORMULA_ERRORS,
    WHOLE_RANGES,
    is_count,
    is_missing,
    parameters,
    plain,
    statistic_of,
)
from rtcal.io.text import number, shown, unit_of
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError

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
