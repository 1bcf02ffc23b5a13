"""The columns of a table of measured values, and the meanings of their headers.

A header names a parameter, a band, a position or a value, with or without its unit, in the usual
English and German spellings. "RT60" may be T20 or T30, which the user must state.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import REVERBERATION, observable, parameter_label
from rtcal.io.table_words import (
    COLUMNS,
    MEASURED,
    OPEN_DECAY_TIMES,
    REMARKS,
    UNCALIBRATED,
    UNUSED_PARAMETERS,
    WHOLE_RANGES,
    parameters,
    plain,
)
from rtcal.io.text import shown
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MAX_HEADER = 200
"""Largest length of a header in characters; the patterns are slow on longer ones."""

LEAST_BAND = 10.0
"""Least centre frequency in Hz. A smaller number is no band but a value, so the line is no header."""

BAND_TOLERANCE = 0.03
"""Largest relative difference of a stated frequency from the exact centre of its band. Neighbouring
thirds are 26 % apart. BRAS's published tables write 155 Hz for the third of 158.5 Hz, which is
called 160 Hz."""

DECAY_TIMES_OF_RT60 = tuple(o.key for o in REVERBERATION)
"""What a column RT60 may hold (ISO 3382-2). An early decay time is never called so."""

_SCALES: dict[str, dict[str, float]] = {
    "s": {"s": 1, "sec": 1, "ms": 1e-3},
    "dB": {"db": 1},
    "": {"%": 0.01, "percent": 0.01, "-": 1, "1": 1},
}
UNIT_WORDS = {"hz", "khz", "s", "sec", "ms", "db", "%", "percent", "-", "1"}

_POSITION = re.compile(
    r"(L?S\d+|[FQ]\d+|(?:src|source|quelle|lautsprecher)[\s_.]*\d+)[\s_,-]*"
    r"((?:(?:MP|M|R|P)|(?:rec|receiver|mic|microphone|mikrofon|pos|position)[\s_.]*)\d+"
    r"(?:\s*#\d+)?)",
    re.I | re.ASCII,
)  # source and receiver; F1-P1 is Spanish, Q1-M1 German
_RECEIVER = re.compile(
    r"(?:MP|M|R|P|rec|receiver|mic|microphone|pos|position|mikrofon|messposition)"
    r"[\s_.-]*\d+(?:\s*#\d+)?",
    re.I | re.ASCII,
)
_REPEAT = re.compile(
    r"(.*?\d)(?:\s*\((\d+)\)|_(\d+)|[\s_]+(?:sweep|take|run|rep|repeat|messung|wdh)[\s_.-]*(\d+))",
    re.I | re.ASCII,
)
_CHANNEL = re.compile(r"(?<![A-Za-z])(?:ch|channel)[\s._]*(\d+)(?!\w)", re.I | re.ASCII)
_BRACKETS = re.compile(r"([^\[\](]*(?:\(\d+\))?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
_UNIT_WITHIN = re.compile(r"([^\[\](]*\S)\s*[\[(]\s*(%|percent|m?s|sec|db)\s*[\])]\s*(\S.*)", re.I)
_SUFFIX = re.compile(r"(.*?\S)(?:\s*/\s*|\s+in\s+|\s+|_)(%|percent|k?hz|m?s|sec|db)", re.I)
_BOTH = re.compile(r"(\S.*?)[\s_@:,]+(?:at\s+)?(\d[\d.,]*\s*k?(?:hz)?)", re.I)
_CORRELATION = re.compile(r"-?\s*r[\s(]*T\d+\s*\)?")
"""Of a decay with a straight line, as "r(T20)", "-r T30" and "rT30"; "RT30" is T30."""
_OF_WHOLE_RANGE = re.compile(rf"(\S.*?)[\s_@:,]+(?:{'|'.join(sorted(WHOLE_RANGES))})", re.I)
_FREQUENCY = re.compile(r"(\d{1,6}(?:[.,]\d{1,6})?)\s*(k?)(?:Hz)?", re.I | re.ASCII)


@dataclass(frozen=True)
class Column:
    """The meaning of a column.

    Parameters
    ----------
    kind : str
        "data" for a column of values of the ``parameter``, the ``band`` or both. Other columns hold:
        "source", "receiver", "parameter", "band", "value", "unit", "statistic", "uncertainty",
        "common_uncertainty", "standard_deviation", "sources", "receivers" or "file", whose name may
        have source and receiver in it; "" for an ignored column.
    header : str
    parameter : str
        Empty if each row names it.
    band : float
        In Hz; NaN if each row names it.
    unit : str
        Empty if the header has none.
    decay_time_open : bool
        Whether the header, such as "RT60", does not say which decay time it is.
    source, receiver : str
        The position of all values of the column, such as "S1R2"; empty if each row names it.
    """

    kind: str
    header: str = ""
    parameter: str = ""
    band: float = np.nan
    unit: str = ""
    decay_time_open: bool = False
    source: str = ""
    receiver: str = ""

    @property
    def has_band(self) -> bool:
        """Whether the header names a band."""
        return bool(np.isfinite(self.band))

    def completed(self, below: Column) -> Column | None:
        """Return the column of two merged headers, such as one with the parameter, one with the band.

        None for headers that are no values, that state the same, or of which one states nothing.
        """
        if self.kind != "data" or below.kind != "data":
            return None
        both = [
            (bool(c.parameter), c.has_band, bool(c.receiver)) for c in (self, below)
        ]  # what each states
        if not all(map(any, both)) or any(a and b for a, b in zip(*both, strict=True)):
            return None
        named = self if self.parameter else below
        placed = self if self.receiver else below
        return replace(
            self,
            header=f"{self.header}, {below.header}",
            parameter=named.parameter,
            band=self.band if self.has_band else below.band,
            unit=named.unit,
            decay_time_open=named.decay_time_open,
            source=placed.source,
            receiver=placed.receiver,
        )

    def description(self, stated: str | None) -> str:
        """Return the meaning of the column in words; ``stated`` is the user's parameter."""
        content = self.kind.replace("_", " ") or "left out"
        if self.kind == "data":
            name = self.parameter or stated
            content = parameter_label(name) if name else "the row's parameter"
            if self.has_band:
                content += f" at {bands.label(self.band)}"
            if self.receiver:
                content += f" of {self.source or 'S1'} to {self.receiver}"
            scale = scale_of(self.parameter, self.unit, "") if self.parameter else 1
            if scale != 1:
                content += f", times {scale:g}"
        return f'"{self.header}": {content}'


def position_of(text: str) -> tuple[str, str] | None:
    """Return source and receiver of a position's name, "" for no source; None for another text.

    Examples
    --------
    >>> position_of("S1R2#2"), position_of("Src1 Mic2"), position_of("Mic 3"), position_of("T20")
    (('S1', 'R2#2'), ('Src1', 'Mic2'), ('', 'Mic 3'), None)
    """
    text = text.strip()
    if len(text) <= MAX_HEADER:
        if both := _POSITION.fullmatch(text):
            return both[1], both[2]
        if _RECEIVER.fullmatch(text):
            return "", text
    return None


def repeat_of(text: str) -> str | None:
    """Return the name of a repeat that is named in another usual way; None for another text.

    Examples
    --------
    >>> [repeat_of(name) for name in ("S1R3 (1)", "S1R3_2", "S1R3 sweep 3", "S1R3")]
    ['S1R3#1', 'S1R3#2', 'S1R3#3', None]
    """
    match = _REPEAT.fullmatch(text.strip()) if len(text) <= MAX_HEADER else None
    if not match or "#" in match[1] or not position_of(match[1]):
        return None
    return f"{match[1].strip()}#{match[2] or match[3] or match[4]}"


def with_repeats(cells: Sequence[str]) -> list[str]:
    """Return a row's cells with the names of repeats as ``S1R3#2``: numbered, where they are alike.

    Examples
    --------
    >>> with_repeats(["Hz", "S1R1", "S1R3", "S1R3"]), with_repeats(["Hz", "S1R3 (1)", "S1R3 (2)"])
    (['Hz', 'S1R1', 'S1R3', 'S1R3#2'], ['Hz', 'S1R3#1', 'S1R3#2'])
    """
    named = [repeat_of(cell) or cell for cell in cells]
    of_place: dict[str, int] = {}
    for i, name in enumerate(named):
        if position_of(name):
            of_place[name] = of_place.get(name, 0) + 1
            if of_place[name] > 1:
                named[i] = f"{name}#{of_place[name]}"
    return named


def position_in(text: str) -> tuple[str, str] | None:
    """Return source and receiver that stand within a text, such as a file's name.

    Examples
    --------
    >>> position_in("hall S1_R2 06/11"), position_in("hall")
    (('S1', 'R2'), None)
    """
    both = re.search(rf"(?<![A-Za-z0-9]){_POSITION.pattern}(?![A-Za-z0-9])", text, _POSITION.flags)
    return (both[1], both[2]) if both else None


def channel_in(text: str) -> str | None:
    """Return the channel's number in a title or a position's name; None without one.

    Examples
    --------
    >>> channel_in("S1_R1 Ch 2"), channel_in("Channel 1 Parameters"), channel_in("Church 2")
    ('2', '1', None)
    """
    match = _CHANNEL.search(text) if len(text) <= MAX_HEADER else None
    return match[1] if match else None


def parameter_of(text: str, place: str, decay_time: str | None) -> str | None:
    """Return the parameter of a spelling, None for an unknown one; DataError for "RT60"."""
    if (word := _parameter_word(text)) in (known := parameters()):
        return known[word]
    if word in OPEN_DECAY_TIMES:
        if decay_time is None:
            raise DataError(
                f'{place}: "{shown(text)}" does not say which decay time it is; state '
                'decay_time="t20" or decay_time="t30"'
            )
        return decay_time
    return None


def leaves_decay_time_open(text: str) -> bool:
    """Return whether a spelling, such as "RT60", does not say which decay time it is."""
    return _parameter_word(text) in OPEN_DECAY_TIMES


def is_unused(text: str) -> bool:
    """Return whether a spelling is a parameter that rtcal has no use for, such as IACC.

    Examples
    --------
    >>> is_unused("IACC"), is_unused("T10 [s]"), is_unused("T10_500"), is_unused("T20")
    (True, True, True, False)
    """
    name = name_and_unit(text)[0]
    both = _BOTH.fullmatch(name)
    if name.partition(" ")[0] == UNCALIBRATED:
        return True
    if plain(name) in UNUSED_PARAMETERS or _CORRELATION.fullmatch(text.strip()):
        return True
    return bool(both and plain(both[1]) in UNUSED_PARAMETERS)


def _is_of_whole_range(name: str) -> bool:
    """Return whether a header is of a parameter over the whole range, such as "T20_A"."""
    of = _OF_WHOLE_RANGE.fullmatch(name)
    return bool(of and (is_unused(of[1]) or _parameter_word(of[1]) in parameters()))


def _parameter_word(text: str) -> str:
    word = plain(text)
    return MEASURED.sub("", word, count=1) if MEASURED.match(word) else word


def frequency_of(text: str) -> float | None:
    """Return a frequency in Hz, with or without its unit; None if the text is none."""
    match = _FREQUENCY.fullmatch(text.strip())
    if not match:
        return None
    value = float(match.group(1).replace(",", ".")) * (1000 if match.group(2) else 1)
    return value if value > 0 else None


def nearest_band(frequency: float) -> float | None:
    """Return the nominal band whose exact centre is within 3 % of a frequency, None without one.

    Examples
    --------
    >>> nearest_band(155), nearest_band(440)
    (160.0, None)
    """
    steps = np.arange(-19, 14)  # thirds from 12.5 Hz to 20 kHz
    exact: Array = 1000 * 10 ** (steps / 10)  # IEC 61260-1, Eq. 2
    nominal = [12.5, 16.0, *bands.THIRD_OCTAVES]
    nearest = int(np.argmin(np.abs(np.log(exact / frequency))))
    if frequency not in nominal and abs(frequency / exact[nearest] - 1) > BAND_TOLERANCE:
        return None
    return float(nominal[nearest])


def nominal_band(frequency: float, place: str) -> float:
    """Return the nominal band of a frequency; DataError if it is none within 3 %."""
    band = nearest_band(frequency)
    if band is None:
        raise DataError(f"{place}: {frequency:g} Hz is no octave or third-octave (IEC 61260-1)")
    return band


def column_of(header: str, place: str, decay_time: str | None) -> Column | None:
    """Return the column of a header, None if the header is unknown.

    Raises
    ------
    DataError
        If the header is incomplete: an unknown unit, "RT60", a frequency that is no band.
    """
    if len(header) > MAX_HEADER:
        return None
    name, unit = name_and_unit(header)
    if unit.lower() not in UNIT_WORDS and plain(header) in parameters():  # as in "RT60 (T20)"
        name, unit = header, ""
    frequency = frequency_of(name if unit.lower() in ("", "hz", "khz") else header)
    if frequency is not None:
        frequency *= 1000 if unit.lower() == "khz" else 1
        if frequency < LEAST_BAND:
            raise DataError(
                f'{place}: column "{shown(header)}" is no band; is the line with the names of the '
                "columns missing?"
            )
        return Column("data", header, band=nominal_band(frequency, place))
    if plain(name) in COLUMNS:
        kind = COLUMNS[plain(name)]
        units = {"band": ("", "hz", "khz"), "value": UNIT_WORDS | {""}}
        if unit.lower() not in units.get(kind, ("",)):
            raise DataError(f'{place}: column "{shown(header)}": the unit is not known')
        return Column(kind, header, unit=unit)
    if is_unused(header) or _is_of_whole_range(name) or plain(header) in REMARKS:
        return Column("", header)
    if position := position_of(header):
        return Column("data", header, source=position[0], receiver=position[1])
    parameter = parameter_of(name, place, decay_time)
    if parameter is not None:
        scale_of(parameter, unit, place)
        open_time = leaves_decay_time_open(name)
        return Column("data", header, parameter, unit=unit, decay_time_open=open_time)
    both = _BOTH.fullmatch(name)
    if both:
        parameter, frequency = parameter_of(both[1], place, decay_time), frequency_of(both[2])
        if parameter is not None and frequency is not None:
            frequency *= 1000 if unit.lower() == "khz" else 1
            unit = unit if unit.lower() not in ("hz", "khz") else ""
            scale_of(parameter, unit, place)
            band, open_time = nominal_band(frequency, place), leaves_decay_time_open(both[1])
            return Column("data", header, parameter, band, unit, decay_time_open=open_time)
    return None


def name_and_unit(header: str) -> tuple[str, str]:
    """Return the parts of "T20 [s]", "T20 (s)", "T20 / s", "T20 in s", "T20 s" or "T20_s".

    Of "T20 [s] 500 Hz" they are "T20 500 Hz" and "s".
    """
    if within := _UNIT_WITHIN.fullmatch(header):
        return f"{within[1]} {within[3].strip('_ ')}", within[2]
    match = _BRACKETS.fullmatch(header) or _SUFFIX.fullmatch(header)
    if not match or (match[2].isdigit() and len(match[2]) > 1):  # "D(50)" has no unit
        return header, ""
    return match[1].strip(), match[2]


def scale_of(parameter: str, unit: str, place: str) -> float:
    """Return the factor from a unit to the parameter's own; DataError for another unit."""
    scales = _SCALES[observable(parameter).unit]
    if unit and unit.lower() not in scales:
        raise DataError(
            f'{place}: {parameter_label(parameter)} in "{shown(unit)}"; known are {", ".join(scales)}'
        )
    return scales[unit.lower()] if unit else 1.0
