"""The columns of a table of measured values, and the words of their headers, rows and cells.

A header names a parameter, a band, a position or a value, with or without its unit. A word is compared
without case, blanks and punctuation (`plain`); the words are in ``words.toml``. "RT60" may be T20 or
T30, which the user must state.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import (
    OBSERVABLES,
    REVERBERATION,
    Observable,
    observable,
    parameter_label,
)
from rtcal.io.text import shown
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_WORDS: dict[str, dict[str, frozenset[str]]] = {
    table: {name: frozenset(words.split()) for name, words in of_table.items()}
    for table, of_table in tomllib.loads(
        resources.files("rtcal.io").joinpath("words.toml").read_text("utf-8")
    ).items()
}
COLUMNS = {word: kind for kind, words in _WORDS["columns"].items() for word in words}
"""What a column holds (`Column.kind`) by its header."""
OPEN_DECAY_TIMES = _WORDS["parameters"]["open"]
"""Names of a decay time that leave its evaluation range open."""
UNUSED_PARAMETERS = _WORDS["parameters"]["unused"]
"""Parameters and signs of quality that exports have beside those that are read."""
WHOLE_RANGES = _WORDS["bands"]["whole"]
"""What stands in a column of bands for the whole range."""
_STATISTICS = _WORDS["statistics"]

UNCALIBRATED = "strenGth"
"""Aurora's spelling of its strength, whose file does not say whether the level was calibrated."""
MEASURED = re.compile(r"measured|gemessene?|medido|mesuré|mesure")
"""A word before a parameter's name, as in "measured T30"."""
FORMULA_ERRORS = ("#div/0!", "#wert!", "#value!")
"""What a spreadsheet shows for a formula that has no result."""
_MISSING = frozenset(["k. a.", *["na", "n/a", "n.a.", "k.a.", "#n/a", "#nv"], *FORMULA_ERRORS])
_NO_DIGIT = re.compile(r"[-*.,\s\u2212\u2013\u2014]*")

BARE_NUMBER = re.compile(r"[\d.,]+")
MAX_HEADER = 200
"""Largest length of a header in characters; the patterns are slow on longer ones."""
_LONGEST_STATISTIC = 80
LEAST_BAND = 10.0
"""Least centre frequency in Hz. A smaller number is no band but a value, so the line is no header."""
BAND_TOLERANCE = 0.03
"""Largest relative difference of a stated frequency from the exact centre of its band. Neighbouring
thirds are 26 % apart. BRAS's published tables write 155 Hz for the third of 158.5 Hz, which is
called 160 Hz."""
OPEN = "rt60"
"""Value of `Column.parameter` for a decay time whose range is unknown."""
DECAY_TIMES_OF_RT60 = tuple(o.key for o in REVERBERATION)
"""Decay times that a column RT60 may hold (ISO 3382-2); an early decay time is never called so."""
DOUBTFUL = "?"
"""`statistic_of` a name that may be a statistic's, and may be a place's."""

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
_BRACKETS = re.compile(
    r"([^\[\](]*(?:\((?:T?\d+|cent(?:er|re) time)\))?)\s*[\[(]\s*([^\])]*?)\s*[\])]", re.I
)
_UNIT_WITHIN = re.compile(r"([^\[\](]*\S)\s*[\[(]\s*(%|percent|m?s|sec|db)\s*[\])]\s*(\S.*)", re.I)
_SUFFIX = re.compile(r"(.*?\S)(?:\s*/\s*|\s+in\s+|\s+|_)(%|percent|k?hz|m?s|sec|db)", re.I)
_BOTH = re.compile(r"(\S.*?)[\s_@:,]+(?:at\s+)?(\d[\d.,]*\s*k?(?:hz)?)", re.I)
_CORRELATION = re.compile(r"-?\s*r[\s(]*T\d+\s*\)?")
"""Of a decay with a straight line, as "r(T20)", "-r T30" and "rT30"; "RT30" is T30."""
_OF_WHOLE_RANGE = re.compile(rf"(\S.*?)[\s_@:,]+(?:{'|'.join(sorted(WHOLE_RANGES))})", re.I)
_FREQUENCY = re.compile(
    r"(\d{1,6}(?:[.,]\d{1,6})?)\s*(k?)(?:Hz)?|(\d{1,2})(k)(\d{1,3})(?:\s*Hz)?", re.I | re.ASCII
)
_THOUSANDS = re.compile(
    r"(?<=^\d)[ \u00a0\u202f'](?=\d{3}\b)|(?<=^\d\d)[ \u00a0\u202f'](?=\d{3}\b)"
)
_SEPARATORS = re.compile(r"[\s()\[\]{},;:=/_+.\-\u2013]+")
_IN_BRACKETS = re.compile(r"[(\[]\s*(\d+)\s*[)\]]")
_EXPANDED = re.compile(r"u\w?\s*[(\[]?\s*k\s*=.*")


def plain(text: str) -> str:
    """Return a word for comparison: in lower case, without blanks and signs.

    >>> plain("Octave band"), plain("T-30"), plain("T60(20)")
    ('octaveband', 't30', 't6020')
    """
    return re.sub(r"[\W_]+", "", text.lower())


def parameters() -> Mapping[str, str]:
    """Return the key of each registered parameter by each of its spellings."""
    return _by_spelling(tuple(OBSERVABLES.values()))


@lru_cache(maxsize=1)  # every cell of a table asks
def _by_spelling(observables: tuple[Observable, ...]) -> Mapping[str, str]:
    return {
        plain(word): o.key for o in observables for word in (o.key, o.label, *o.spellings.split())
    }


def parameter_of(text: str) -> str:
    """Return the name of the parameter for a spelling; "" for an unknown spelling.

    >>> parameter_of("measured T30"), parameter_of("RT60"), parameter_of("Lw")
    ('t30', 'rt60', '')
    """
    word = plain(text)
    word = MEASURED.sub("", word, count=1) if MEASURED.match(word) else word
    return parameters().get(word) or (OPEN if word in OPEN_DECAY_TIMES else "")


def statistic_of(name: str) -> str | None:
    """Return the kind of statistic that the name of a row, column or sheet means, or None.

    "" is a statistic that is not read, such as the median; `DOUBTFUL` may also be a position.

    >>> [statistic_of(n) for n in ("Mean (n=2)", "T20 mean", "Mittel (alle)", "écart-type", "Max of 6")]
    ['value', 'value', 'value', 'standard_deviation', '']
    >>> [statistic_of(n) for n in ("Mean stalls", "Mean 2", "Soll", "Mittelgang", "R2")]
    ['?', '?', '?', None, None]
    """
    name = name.strip().lower()
    if not name or len(name) > _LONGEST_STATISTIC:
        return None
    if _EXPANDED.fullmatch(name):
        return ""
    of, words = _STATISTICS, [word for word in _SEPARATORS.split(name) if word]
    named = {*words} & (of["mean"] | of["deviation"] | of["other"])
    if not named:
        others = {w for w in words if not _is_parameter(w)} - of["beside"] - of["no_position"]
        return DOUBTFUL if {*words} & of["no_position"] and not others else None
    known, in_brackets = named | of["beside"] | of["before_count"], _IN_BRACKETS.findall(name)
    for before, word, after in zip(["", *words], words, [*words[1:], ""], strict=False):
        counts = word in in_brackets or before in of["before_count"] or after in of["beside"]
        if not (word.isdecimal() and counts) and word not in known and not _is_parameter(word):
            return None if named <= of["other"] else DOUBTFUL
    if named & of["other"]:
        return ""
    return "standard_deviation" if named & of["deviation"] else "value"


def _is_parameter(word: str) -> bool:
    return word in parameters() or word in OPEN_DECAY_TIMES or word in UNUSED_PARAMETERS


def is_missing(cell: str) -> bool:
    """Return whether a cell has no value: it is empty, a dash, or a word such as "N/A".

    >>> is_missing("--.--"), is_missing("N/A"), is_missing("-1.5")
    (True, True, False)
    """
    return bool(_NO_DIGIT.fullmatch(cell)) or cell.lower() in _MISSING


@dataclass(frozen=True)
class Column:
    """Hold the meaning of a table's column, from its header.

    ``kind`` is "value" for a column of values, "" for a column that is left out, and otherwise the word
    for what its cells name, such as "band". For a column of values, ``parameter``, ``source``,
    ``receiver``, ``unit`` and ``band`` in Hz are those in the header; "" or NaN if it has none, and
    `OPEN` if it does not say which decay time it has. ``wrong`` is an error of the header, or "".
    """

    kind: str
    header: str = ""
    parameter: str = ""
    band: float = np.nan
    unit: str = ""
    source: str = ""
    receiver: str = ""
    wrong: str = ""

    @property
    def has_band(self) -> bool:
        """Whether the header names a band."""
        return bool(np.isfinite(self.band))

    @property
    def has_values(self) -> bool:
        """Whether the column's cells are measured values."""
        return self.kind == "value"

    @property
    def meaning(self) -> str:
        """Meaning of the column in words, which `stated` reads: "T20 [ms] at 500 Hz of S1 to R1"."""
        if not self.kind:
            return "left out"
        name = self.kind.replace("_", " ")
        if self.parameter:
            name = "RT60" if self.parameter == OPEN else parameter_label(self.parameter)
        unit = f" [{self.unit}]" if self.unit else ""
        band = f" at {bands.label(self.band)}" if self.has_band else ""
        position = " to ".join(filter(None, (self.source, self.receiver)))
        return name + unit + band + (f" of {position}" if position else "")


def stated(text: str) -> Column:
    """Return the meaning of a column that a text describes, as `Column.meaning` or a usual header does.

    >>> stated("T20 [ms] at 500 Hz of S1 to Row 5").receiver, stated("band [kHz]").kind
    ('Row 5', 'band')
    """
    text = text.strip()
    if text in ("", "-", "left out"):
        return Column("", text)
    of = None if "?" in text.split() else _OF.fullmatch(text)
    name = (of[1] if of else text) or "value"
    value = _VALUE.fullmatch(name)
    column = column_of(value[2] if value else name)
    if value and column:
        column = replace(column, unit=value[1] or "")
    if column is None or column.wrong or (of and not column.has_values):
        raise DataError(
            f'"{shown(text)}" does not describe a column{": " * bool(column and column.wrong)}'
            f"{column.wrong if column else ''}; write for example {_EXAMPLES}"
        )
    return replace(column, header=text, source=of[2] or "", receiver=of[3]) if of else column


_OF = re.compile(r"(?:(.*?)\s+)?of\s+(?:(.+?)\s+to\s+)?(.+)")
_VALUE = re.compile(r"value\s+(?:\[(.*?)\]\s+)?at\s+(.+)")
_EXAMPLES = (
    '"band", "receiver", "T20 [s]", "T20 [ms] at 500 Hz of S1 to R1", or "-" for a column that '
    "is left out; ? marks what you must fill in"
)


def columns_of(header: Sequence[str], extra: Collection[str] = ()) -> list[Column | None]:
    """Return the meaning of each column of a table, from its header; None for an unknown header.

    "R2" is a correlation, or a receiver if another column is one. ``extra`` are headers to leave out.
    """
    in_khz = any(name_and_unit(name)[1].lower() == "khz" for name in header)
    if in_khz and any((frequency_of(name) or 1) < 1 for name in header):
        header = [f"{name} kHz" if BARE_NUMBER.fullmatch(name) else name for name in header]
    places = [position_of(name) for name in header]
    several = any(p and not is_unused(name) for p, name in zip(places, header, strict=True))
    columns: list[Column | None] = []
    for i, (name, place) in enumerate(zip(header, places, strict=True)):
        if place and several:
            columns.append(Column("value", name, source=place[0], receiver=place[1]))
        elif i and any(places) and statistic_of(name) is not None:
            doubt = f'column "{shown(name)}" may be a statistic or a position'
            columns.append(Column("", name, wrong=doubt if statistic_of(name) == DOUBTFUL else ""))
        else:
            column = column_of(name) if name else None
            columns.append(column or (Column("", name) if name in extra else None))
    if any(column and column.has_band for column in columns):
        for i, name in enumerate(header):
            if columns[i] is None and plain(name) in WHOLE_RANGES:
                columns[i] = Column("", name)
    return columns


def with_units(
    header: Sequence[str], below: Sequence[str], words: Collection[str] = UNIT_WORDS
) -> list[str] | None:
    """Return the headers with the units below them; None if a cell below is none of the words."""
    units = [cell.strip("[]()") for cell in below]
    if any(u and u.lower() not in words for u in units) or all(cell in "-1" for cell in below):
        return None
    return [
        f"{h} [{u}]" if u and name_and_unit(h)[1].lower() != u.lower() else h
        for h, u in zip(header, units, strict=True)
    ]


def column_of(header: str) -> Column | None:
    """Return the meaning of one column of a table, from its header; None for an unknown header.

    >>> column_of("T20 [s] 500 Hz").parameter, column_of("T20 [min]").wrong, column_of("Volume")
    ('t20', 'T20 cannot have the unit "min"; its units are s, sec, ms', None)
    """
    if len(header) > MAX_HEADER or "\t" in header or ";" in header:  # several cells
        return None
    if header.lower() == "khz":
        return Column("band", header, unit=header)
    name, unit = name_and_unit(header)
    if unit.lower() not in UNIT_WORDS and plain(header) in parameters():  # as in "RT60 (T20)"
        name, unit = header, ""
    of_band = unit.lower() in ("hz", "khz")
    in_hz = 1000 if unit.lower() == "khz" else 1
    frequency = frequency_of(name if of_band or not unit else header)
    if frequency is not None:
        if in_hz * frequency < LEAST_BAND:
            wrong = "is not a band; check whether the line with the names of the columns is missing"
            return Column("value", header, wrong=f'column "{shown(header)}" {wrong}')
        return _of_values(header, band=in_hz * frequency)
    if plain(name) in COLUMNS:
        kind = COLUMNS[plain(name)]
        units = {
            "band": ("", "hz", "khz"),
            "parameter": ("", "hz"),  # as in Aurora's "Frq.band [Hz]"
            "value": UNIT_WORDS | {""},
            "": (unit.lower(),),
        }
        known = unit.lower() in units.get(kind, ("",))
        wrong = "" if known else f'column "{shown(header)}": the unit is not known'
        return Column(kind, header, unit=unit, wrong=wrong)
    whole = _OF_WHOLE_RANGE.fullmatch(name)  # such as "T20_A"
    of_whole = whole and (is_unused(whole[1]) or parameter_of(whole[1]) not in ("", OPEN))
    if of_whole or is_unused(header):
        return Column("", header)
    if position := position_of(header):
        return Column("value", header, source=position[0], receiver=position[1])
    if parameter := parameter_of(name):
        return _of_values(header, parameter, unit="" if of_band else unit)
    both = _BOTH.fullmatch(name)
    if both and (parameter := parameter_of(both[1])) and (frequency := frequency_of(both[2])):
        return _of_values(header, parameter, in_hz * frequency, "" if of_band else unit)
    return None


def _of_values(header: str, parameter: str = "", band: float = np.nan, unit: str = "") -> Column:
    """Return a column of values, and what is wrong with its unit or its band in Hz."""
    wrong = "" if not parameter or scale_of(parameter, unit) else wrong_unit(parameter, unit)
    if np.isfinite(band):
        nearest = nearest_band(band)
        wrong = wrong or ("" if nearest else no_band(band))
        band = nearest or band
    return Column("value", header, parameter, band, unit, wrong=wrong)


def wrong_unit(parameter: str, unit: str) -> str:
    """Return the message on a unit that a parameter cannot have."""
    label = parameter_label(parameter) if parameter != OPEN else "a decay time"
    units = ", ".join(_scales(parameter))
    return f'{label} cannot have the unit "{shown(unit)}"; its units are {units}'


def no_band(frequency: float) -> str:
    """Return the message on a frequency in Hz that is not the centre of a band."""
    in_khz = frequency < LEAST_BAND and nearest_band(1000 * frequency)
    hint = '. If it is in kHz, name the column "band [kHz]"' * bool(in_khz)
    return (
        f"{frequency:g} Hz is not the centre of an octave or one-third octave (IEC 61260-1){hint}"
    )


def name_and_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header such as "T20 [s]", "T20 / s", "T20 in s" or "T20_s"."""
    if within := _UNIT_WITHIN.fullmatch(header):
        return f"{within[1]} {within[3].strip('_ ')}", within[2]
    match = _BRACKETS.fullmatch(header) or _SUFFIX.fullmatch(header)
    if not match or (match[2].isdigit() and len(match[2]) > 1):  # "D(50)" has no unit
        return header, ""
    return match[1].strip(), match[2]


def _scales(parameter: str) -> Mapping[str, float]:
    return _SCALES["s" if parameter == OPEN else observable(parameter).unit]


def scale_of(parameter: str, unit: str) -> float:
    """Return the factor from a unit to the parameter's own; 0 for a unit that it cannot have."""
    return _scales(parameter).get(unit.lower(), 0.0) if unit else 1.0


def position_of(text: str) -> tuple[str, str] | None:
    """Return the source and receiver that a text names; None if it names no receiver.

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
    """Return rtcal's name of a repeat, such as ``S1R3#2``, for another usual name, or None.

    >>> [repeat_of(name) for name in ("S1R3 (1)", "S1R3_2", "S1R3 sweep 3", "S1R3")]
    ['S1R3#1', 'S1R3#2', 'S1R3#3', None]
    """
    match = _REPEAT.fullmatch(text.strip()) if len(text) <= MAX_HEADER else None
    if not match or "#" in match[1] or not position_of(match[1]):
        return None
    return f"{match[1].strip()}#{match[2] or match[3] or match[4]}"


def position_in(text: str) -> tuple[str, str] | None:
    """Return the source and receiver within a text, such as a file's name; None if there are none.

    >>> position_in("hall S1_R2 06/11"), position_in("hall")
    (('S1', 'R2'), None)
    """
    both = re.search(rf"(?<![A-Za-z0-9]){_POSITION.pattern}(?![A-Za-z0-9])", text, _POSITION.flags)
    return (both[1], both[2]) if both else None


def is_unused(text: str) -> bool:
    """Return whether a spelling is a parameter that rtcal has no use for, such as IACC.

    >>> is_unused("IACC"), is_unused("T10 [s]"), is_unused("T10_500"), is_unused("T20")
    (True, True, True, False)
    """
    name = name_and_unit(text)[0]
    both = _BOTH.fullmatch(name)
    if name.partition(" ")[0] == UNCALIBRATED or _CORRELATION.fullmatch(text.strip()):
        return True
    if {plain(text), plain(name)} & {*parameters()}:  # as "CT (Center Time)"
        return False
    return any(plain(word) in UNUSED_PARAMETERS for word in (name, *([both[1]] if both else [])))


def frequency_of(text: str) -> float | None:
    """Return a frequency in Hz, with or without its unit; None if the text is no frequency.

    >>> [frequency_of(text) for text in ("500", "0,125 kHz", "1k25", "1 000", "R1")]
    [500.0, 125.0, 1250.0, 1000.0, None]
    """
    match = _FREQUENCY.fullmatch(_THOUSANDS.sub("", text.strip()))
    if not match:
        return None
    number = match[1].replace(",", ".") if match[1] else f"{match[3]}.{match[5]}"
    value = float(number) * (1000 if match[2] or match[4] else 1)
    return value if value > 0 else None


def nearest_band(frequency: float) -> float | None:
    """Return the nominal band whose exact centre is within 3 % of a frequency in Hz, or None.

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
