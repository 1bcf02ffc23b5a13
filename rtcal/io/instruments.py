"""The text of Room EQ Wizard (REW), NTi Audio's XL2, Dirac and Aurora: more than a header and cells.

Of REW's measurements, each a block of lines, the parameters that rtcal knows are read, and not its own
Topt and T60M or its row "full". A time of 0 is missing: REW writes it where it found no decay.

Of the XL2's report (``..._RT60_..._Report.txt``) the averages by band are read. "MeasUnct" is the
standard uncertainty of ISO 3382-2:2008, Eq. 3, with N = 1 position and n decays: so it is in the four
published reports of firmware 4.94 that were at hand. No manual was at hand.

Aurora has a row per parameter, and tables of several channels below each other; or a row per file, in
which D50 is in percent and Ts in ms without saying so. Dirac has a table per parameter, with a row for
each position and rows of statistics below.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PureWindowsPath

from rtcal.acoustics.observables import D50, Ts
from rtcal.io.table_columns import OPEN, column_of, position_in
from rtcal.io.text import Row, Sheet, Text, decode, lines, number, sheets_of_text, shown
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

_START = re.compile(r"\W*RT60 data (?:saved|measured) by REW", re.I)
_FORMAT = re.compile(r"\W*Format is\s+(.*)", re.I)
_WIDTH = "BW (octaves)"
_LONGEST_START = 8000
"""Characters within which a text shows which program wrote it."""
_STRAIGHT = 0.98
"""Magnitude of the correlation coefficient below which REW calls a decay time unreliable."""
_MOST_BENT = 6


def recognises(content: bytes) -> bool:
    """Return whether a file is a text that one of the known measuring programs has exported."""
    # These beginnings are ASCII: without the zeros of UTF-16 they are alike in all encodings.
    start = content[: 2 * _LONGEST_START].replace(b"\0", b"")[:_LONGEST_START].decode("latin-1")
    of_others = _XL2 in start[:200] or _is_of_aurora(start) or _is_of_dirac(start)
    return _is_of_rew(start) or of_others


def _is_of_rew(text: str) -> bool:
    return "RT60 data saved by REW" in text[:4000] or "Format is freq" in text[:_LONGEST_START]


def _is_of_aurora(text: str) -> bool:
    return _AURORA in text[:200] or bool(_HEAD_OF_AURORA.search(text[:_LONGEST_START]))


def sheets(content: bytes, path: str, where: Mapping[str, str]) -> list[Sheet]:
    """Return the tables in the text that an instrument exported, one per measurement.

    ``where={"BW (octaves)": "1/3"}`` selects the third-octaves in a text of REW that has octaves, too.
    """
    text = decode(content, path)
    if _is_of_aurora(text.characters):
        return [_of_aurora(sheets_of_text(text, path)[0])]
    if _is_of_dirac(text.characters):
        # A sheet for each of Dirac's tables, with the parameter in the header of each band.
        sheet = sheets_of_text(text, path)[0]
        tables: list[list[Row]] = []
        for line, cells in sheet.rows:
            if _is_head(cells):
                tables.append(
                    [(line, ["position", *(f"{cells[0]} {b} Hz" if b else "" for b in cells[1:])])]
                )
            else:
                tables[-1].append((line, cells))
        return [Sheet(sheet.place, tuple(rows), f"Dirac's table, {sheet.note}") for rows in tables]
    numbered = [(n, raw.strip()) for n, _, raw in lines(text.characters)]
    if not _is_of_rew(text.characters):
        return [_averages(numbered, path, text)]
    starts = [i for i, (_, line) in enumerate(numbered) if _START.match(line)] or [0]
    ends = [*starts[1:], len(numbered)]
    return [
        _measurement(numbered[a:b], path, where, text) for a, b in zip(starts, ends, strict=True)
    ]


def _measurement(
    block: Sequence[tuple[int, str]], path: str, where: Mapping[str, str], text: Text
) -> Sheet:
    """Return the sheet of one measurement's lines."""
    at = next((i for i, (_, line) in enumerate(block) if _FORMAT.match(line)), None)
    if at is None:
        raise DataError(
            f'{path}, line {block[0][0]}: REW\'s line "Format is freq (Hz), ..." is missing'
        )
    place = f"{path}, line {block[at][0]}"
    titles = dict(
        line.lstrip("* ").split(":", 1) for _, line in block[:at] if ":" in line
    )  # the last of lines alike
    name = titles.get("Measurement", "").strip()
    columns = [c.strip() for c in _FORMAT.sub(r"\1", block[at][1]).split(",")]
    if len(columns) < 3 or not columns[1].startswith("BW"):
        raise DataError(f"{place}: REW's format line must begin with freq, BW and a parameter")
    rows: list[Row] = [
        (n, _cells(line, columns, f"{path}, line {n}"))
        for n, line in block[at + 1 :]
        if re.match(r"[\d.,]+\s*[\s,;]\s*\d+/\d+", line)
    ]
    widths = {cells[1] for _, cells in rows}
    if len(widths) > 1 and _WIDTH not in where:
        raise DataError(
            f"{place}: the file has bands of {' and '.join(sorted(widths))} octave; select one "
            f'width with where={{"{_WIDTH}": "{min(widths)}"}}'
        )
    if not rows:
        raise DataError(f"{place}: the header is not followed by a row for a band")
    kept = [
        0,
        *([1] if _WIDTH in where else []),
        *filter(lambda i: _is_known(columns[i]), range(2, len(columns))),
    ]
    header = ["Frequency (Hz)", _WIDTH, *columns[2:]]
    return Sheet(
        place=path,
        rows=tuple((n, [cells[i] for i in kept]) for n, cells in [(block[at][0], header), *rows]),
        note=f'REW\'s decay times of "{shown(name)}", text in {text.encoding}',
        position=position_in(name) or ("", shown(name, 60)),
        notes=tuple(_bent(columns, rows)),
    )


def _is_known(name: str) -> bool:
    column = column_of(name)
    return column is not None and column.parameter not in ("", OPEN) and not column.wrong


def _cells(line: str, columns: Sequence[str], place: str) -> list[str]:
    """Return the cells of a row, which REW separates by what was chosen at the export."""
    n = len(columns)
    separator = next((s for s in "\t;" if line.count(s) >= n - 1), None)
    if separator is None and line.count(",") == n - 1:
        separator = ","
    if separator is None:
        line = re.sub(r"zero phase", "zero-phase", line, flags=re.I)
    cells = [c.strip() for c in line.split(separator)]
    while len(cells) > n and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != n:
        raise DataError(
            f"{place}: this row has {len(cells)} cells, but REW's format line names {n} columns"
        )
    return [
        "" if column.endswith("(s)") and re.fullmatch(r"0+(?:[.,]0*)?", cell) else cell
        for column, cell in zip(columns, cells, strict=True)
    ]


def _bent(columns: Sequence[str], rows: Sequence[Row]) -> list[str]:
    """Return a note on decay times whose line fits badly, by the column r behind each."""
    bent = []
    for _, cells in rows:
        for name, following, time, r in zip(columns, columns[1:], cells, cells[1:], strict=False):
            fit = re.fullmatch(r"[-\u2212]?(\d*[.,]?\d+)", r)
            correlation = float(fit[1].replace(",", ".")) if fit else 1.0
            if following == "r" and time and correlation < _STRAIGHT and _is_known(name):
                bent.append(f"{name.removesuffix(' (s)')} at {cells[0]} Hz")
    if not bent:
        return []
    return [f"REW calls unreliable (r below {_STRAIGHT:g}): {first_of(bent, _MOST_BENT)}"]


_XL2 = "XL2 RT60 Reporting"
_AVERAGES = "# rt60 average results"
_HEADER = re.compile(r"Band\s+RT60\((T[23]0)\)\s+MeasUnct", re.I)
_ROW = re.compile(r"(\d[\d.,]*)\s+(-[.,]--|\d[\d.,]*)\s+(-[.,]--|\d[\d.,]*)")


def _averages(numbered: Sequence[tuple[int, str]], path: str, text: Text) -> Sheet:
    """Return the averages of the XL2's report as one sheet."""
    at = next((i for i, (_, line) in enumerate(numbered) if line.lower() == _AVERAGES), None)
    header = next(
        ((n, m[1]) for n, line in numbered[at or 0 :] if (m := _HEADER.fullmatch(line))), None
    )
    if at is None or header is None:
        raise DataError(
            f'{path}, line 1: the XL2\'s "RT60 Average Results" with Band, RT60(T20) and MeasUnct are '
            "missing"
        )
    rows: list[Row] = [(header[0], ["Frequency [Hz]", header[1].upper(), "uncertainty"])]
    for n, line in numbered[at + 1 :]:
        if line.startswith("#"):
            break
        if m := _ROW.fullmatch(line):
            band, value, percent = (cell.replace(",", ".") for cell in m.groups())
            rows.append((n, _averaged(band, value, percent, f"{path}, line {n}")))
    if len(rows) < 2:
        raise DataError(f"{path}, line {header[0]}: the header is not followed by a row for a band")
    name = PureWindowsPath(numbered[0][1].partition(":")[2].strip()).stem
    return Sheet(
        place=path,
        rows=tuple(rows),
        note=f"the XL2's report {name}, text in {text.encoding}",
        position=position_in(name) or ("", name),
        notes=(
            f"{header[1].upper()} is the average over the report's decays; its uncertainty is "
            "MeasUnct (ISO 3382-2)",
        ),
    )


def _averaged(band: str, value: str, percent: str, place: str) -> list[str]:
    """Return a band, its value and the uncertainty in the value's unit; empty if they are missing."""
    if value.startswith("-") or not number(value, place):
        return [band, "", ""]
    if percent.startswith("-"):
        return [band, value, ""]
    return [band, value, repr(number(value, place) * number(percent, place) / 100)]


_AURORA = "ISO3382 Acoustical Parameter File"
_HEAD_OF_AURORA = re.compile(r"^Filename[\t;,]Frq\.band \[Hz\][\t;,]", re.M)
"""Its own header, which shows it where the title was cut off."""
_CHANNEL = re.compile(r"(?:.*\s)?(?:ch|channel)\s*(\d+)(?:\s.*)?", re.I)
_WITHOUT_UNIT = {D50.key: "[%]", Ts.key: "[ms]"}


def _of_aurora(sheet: Sheet) -> Sheet:
    """Return Aurora's tables as one, with a column of channels where there are several."""
    rows: list[Row] = []
    channels: list[str] = []
    channel = ""
    for line, cells in sheet.rows:
        while cells and not cells[-1]:
            cells = cells[:-1]
        if named := _CHANNEL.fullmatch(cells[0]):
            channel = named[1]
        if cells[0] == "Filename" and not rows:
            columns = [column_of(name) for name in cells]
            units = [
                _WITHOUT_UNIT.get(c.parameter, "") if c and not c.unit else "" for c in columns
            ]
            both = zip(cells, units, strict=True)  # such as D50_500
            rows.append((line, [n.replace("_", f" {u}_", 1) if u else n for n, u in both]))
        elif rows and len(cells) == len(rows[0][1]) and cells[0] != "Filename":
            rows.append((line, cells))
            channels.append(channel)
    if len(rows) < 2:
        raise DataError(
            f'{sheet.place}, line 1: Aurora\'s line "Filename" and rows below it are missing'
        )
    if len({*channels}) > 1:
        named_rows = zip(rows, ["channel number", *channels], strict=True)
        rows = [(line, [*cells, number]) for (line, cells), number in named_rows]
    return Sheet(sheet.place, tuple(rows), f"Aurora's parameters, {sheet.note}")


def _is_of_dirac(text: str) -> bool:
    first = text[:2000].lstrip("\ufeff\xef\xbb\xbf\xff\xfe").splitlines()
    return bool(first) and "\t" in first[0] and _is_head(first[0].split("\t"))


def _is_head(cells: Sequence[str]) -> bool:
    """Return whether a row is a parameter and the bands in Hz."""
    column = column_of(cells[0].strip())
    bands = [cell.strip() for cell in cells[1:] if cell.strip()]
    named = column is not None and column.parameter and not column.has_band
    return bool(named and len(bands) > 1 and all(re.fullmatch(r"[\d.,]+", b) for b in bands))
