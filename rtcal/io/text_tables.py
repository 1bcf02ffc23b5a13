"""Tables in text as cells: with separators, and as Room EQ Wizard and NTi Audio's XL2 export them.

With separators (CSV), or columns aligned by blanks: the header decides what separates.

REW's (File, Export, RT60 data as text) is also of several measurements. Each is a block: "RT60 data
saved by REW", lines such as "Measurement: S1R1", a line "Format is freq (Hz), BW (octaves), EDT (s), r,
...", and one row per band. Columns are separated by blanks, tabs, commas or semicolons, as chosen at
the export. Read are the parameters that rtcal knows. REW's own Topt and T60M, and its row "full" of the
whole frequency range, are left out. A time of 0 is missing: REW writes it where it found no decay.

The XL2's (``..._RT60_..._Report.txt``) is of one position: its averages over some decays by band, then
every decay. Read are the averages. "MeasUnct" is the standard uncertainty of ISO 3382-2:2008, Eq. 3
with N = 1 position and n decays, 0.88 sqrt((1 + 1.90 / n) / (B T)) for T20: so it is in the four
reports of firmware 4.94 that were at hand, which their owner has published. No manual was at hand.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import PureWindowsPath

from rtcal.io.table_columns import column_of, position_in
from rtcal.io.table_layout import Headers, Row, Sheet
from rtcal.io.text import Text, decode, lines, number, shown
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

SEPARATORS = (";", "\t", "|", ",")
_GAP = re.compile(r"(?<=\S)(?: {2,}|\t[ \t]*)")
"""What separates columns that are aligned by blanks."""


def sheet_of_text(
    text: Text, path: str, *, decay_time: str | None, extra_columns: Collection[str] = ()
) -> Sheet:
    """Return the cells of a table's text; the separator is the one with which a header is complete.

    Raises DataError for a text that is no table of cells. The arguments are those of `layout_of`.
    """
    stated, characters = _stated_separator(text.characters)
    aligned = not stated and not any(s in characters for s in SEPARATORS)
    if aligned:
        characters = _GAP.sub("\t", characters)
    first = next((raw for _, _, raw in lines(characters) if _has_cells(raw)), "")
    candidates = [stated] if stated else [s for s in SEPARATORS if s in characters] or [","]
    headers = Headers(path, decay_time, extra_columns)
    tables: dict[str, list[Row]] = {}
    for separator in candidates:
        try:
            tables[separator] = _rows(characters, separator, path)
        except DataError:
            if len(candidates) == 1:
                raise
    chosen = next((s for s, rows in tables.items() if headers.complete(rows) is not None), None)
    if chosen is None:
        # The separator that names most columns, so that the message is of the header, not of a title.
        named = {s: headers.names(rows[headers.header(rows)][1])[0] for s, rows in tables.items()}
        best = max(named.values(), default=0)
        likely = [s for s in candidates if named.get(s, 0) == best]
        # A title and decimals may have commas, where most lines have equally many semicolons.
        even = (s for s in likely if s in tables and _is_even(tables[s]))
        chosen = next(even, None) or next((s for s in likely if s in first), likely[0])
    rows = tables[chosen] if chosen in tables else _rows(characters, chosen, path)
    by = "blanks" if aligned and chosen == "\t" else repr(chosen)
    note = f"text in {text.encoding}, columns separated by {by}"
    return Sheet(path, tuple(rows), note)


def _is_even(rows: Sequence[Row]) -> bool:
    """Return whether half of the rows or more have equally many cells, and more than one."""
    widths = Counter(len(cells) for _, cells in rows if len(cells) > 1)
    return bool(widths) and 2 * max(widths.values()) >= max(len(rows), 4)


def _stated_separator(characters: str) -> tuple[str | None, str]:
    """Return the separator that Excel's first line "sep=;" states; the line is left empty."""
    head, _, tail = characters.partition("\n")
    line = head.strip().strip('"').lower()
    if line.startswith("sep=") and len(line) == 5:
        return line[-1], "\n" + tail
    if line == "sep=":  # a tab is stripped with the blanks
        return "\t", "\n" + tail
    return None, characters


def _has_cells(raw: str) -> bool:
    return bool(raw.strip(" \t;,")) and not raw.lstrip().startswith("#")


def _rows(characters: str, separator: str, path: str) -> list[Row]:
    """Return the rows with the number of their first line; comments and empty rows are left out."""
    raw_lines = [raw if _has_cells(raw) else "" for _, _, raw in lines(characters)]
    reader = csv.reader((f"{raw}\n" for raw in raw_lines), delimiter=separator, strict=True)
    rows: list[Row] = []
    line = 0
    while True:
        line = reader.line_num + 1
        try:
            cells = next(reader)
        except StopIteration:
            break
        except csv.Error as error:
            raise DataError(f"{path}, line {line}: not a row of cells: {error}") from error
        cells = [" ".join(part.strip() for part in c.strip().split("\n")) for c in cells]
        if any(cells):
            rows.append((line, cells))
    if len(rows) < 2:
        raise DataError(f"{path}, line 1: a header and at least one row are needed")
    return rows


_START = re.compile(r"\W*RT60 data (?:saved|measured) by REW", re.I)
_FORMAT = re.compile(r"\W*Format is\s+(.*)", re.I)
_WIDTH = "BW (octaves)"
_STRAIGHT = 0.98
"""Magnitude of the correlation coefficient below which REW calls a decay time unreliable."""
_MOST_BENT = 6


def claims(content: bytes) -> bool:
    """Return whether a file is REW's text of decay times, or the XL2's report of them."""
    return _is_of_rew(content) or _XL2 in content[:200]


def _is_of_rew(content: bytes) -> bool:
    return b"RT60 data saved by REW" in content[:4000] or b"Format is freq" in content[:8000]


def sheets(content: bytes, path: str, where: Mapping[str, str]) -> list[Sheet]:
    """Return one sheet per measurement; DataError names file and line.

    A file of REW's that has octaves and third-octaves needs ``where={"BW (octaves)": "1/3"}``.
    """
    text = decode(content, path)
    numbered = [(n, raw.strip()) for n, _, raw in lines(text.characters)]
    if not _is_of_rew(content):
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
    at, names = next(
        ((i, m[1]) for i, (_, line) in enumerate(block) if (m := _FORMAT.match(line))), (None, "")
    )
    if at is None:
        raise DataError(
            f'{path}, line {block[0][0]}: REW\'s line "Format is freq (Hz), ..." is missing'
        )
    line_of_header = block[at][0]
    titles = dict(
        line.lstrip("* ").split(":", 1) for _, line in block[:at] if ":" in line
    )  # the last of lines alike
    name = titles.get("Measurement", "").strip()
    columns = [c.strip() for c in names.split(",")]
    if len(columns) < 3 or not columns[1].startswith("BW"):
        raise DataError(
            f"{path}, line {line_of_header}: REW's format line names freq, BW and a parameter first"
        )
    rows: list[Row] = [
        (n, _cells(line, len(columns), f"{path}, line {n}"))
        for n, line in block[at + 1 :]
        if re.match(r"[\d.,]+\s*[\s,;]\s*\d+/\d+", line)
    ]
    widths = {cells[1] for _, cells in rows}
    if len(widths) > 1 and _WIDTH not in where:
        raise DataError(
            f"{path}, line {line_of_header}: bands of {' and '.join(sorted(widths))} octave; "
            f'state where={{"{_WIDTH}": "{min(widths)}"}} for one of them'
        )
    kept = [i for i, c in enumerate(columns) if i == 0 or i == 1 or _is_known(c)]
    times = [i for i in kept if i > 1 and columns[i].endswith("(s)")]
    for _, cells in rows:
        for i in times:
            if re.fullmatch(r"0+(?:[.,]0*)?", cells[i]):
                cells[i] = ""
    if _WIDTH not in where:
        kept.remove(1)
    header = ["Frequency (Hz)" if i == 0 else _WIDTH if i == 1 else columns[i] for i in kept]
    table: list[Row] = [(line_of_header, header)]
    table += [(n, [cells[i] for i in kept]) for n, cells in rows]
    if len(table) < 2:
        raise DataError(f"{path}, line {line_of_header}: no row of a band below the header")
    of_name = position_in(name) or ("", shown(name, 60) if len(name) else "")
    return Sheet(
        place=path,
        rows=tuple(table),
        note=f'REW\'s decay times of "{shown(name)}", text in {text.encoding}',
        position=of_name,
        notes=tuple(_bent(columns, rows)),
    )


def _is_known(name: str) -> bool:
    try:
        column = column_of(name, "", None)
    except DataError:  # a unit that rtcal does not know
        return False
    return column is not None and bool(column.parameter)


def _cells(line: str, n_columns: int, place: str) -> list[str]:
    """Return the cells of a row, which REW separates by what was chosen at the export."""
    separators = [s for s in ("\t", ";") if line.count(s) >= n_columns - 1]
    if not separators and line.count(",") == n_columns - 1:
        separators = [","]
    joined = re.sub(r"zero phase", "zero-phase", line, flags=re.I)
    cells = line.split(separators[0]) if separators else joined.split()
    while len(cells) > n_columns and not cells[-1].strip():
        cells = cells[:-1]
    if len(cells) != n_columns:
        raise DataError(f"{place}: {len(cells)} cells; REW's format line names {n_columns}")
    return [c.strip() for c in cells]


def _bent(columns: Sequence[str], rows: Sequence[Row]) -> list[str]:
    """Return a note on decay times whose line fits badly, by the column r behind each."""
    bent = []
    for _, cells in rows:
        for name, following, time, r in zip(columns, columns[1:], cells, cells[1:], strict=False):
            if following == "r" and time and _is_known(name):
                fit = r.replace(",", ".")
                if (
                    re.fullmatch(r"[-\u2212]?\d*\.?\d+", fit)
                    and abs(float(fit.replace("\u2212", "-"))) < _STRAIGHT
                ):
                    bent.append(f"{name.removesuffix(' (s)')} at {cells[0]} Hz")
    if not bent:
        return []
    return [f"REW calls unreliable (r below {_STRAIGHT:g}): {first_of(bent, _MOST_BENT)}"]


_XL2 = b"XL2 RT60 Reporting"
_AVERAGES = "# rt60 average results"
_HEADER = re.compile(r"Band\s+RT60\((T[23]0)\)\s+MeasUnct", re.I)
_BANDS = re.compile(r"Band \[Hz\]:\s+(.*)")
_DECAY = re.compile(r"\d+((?:\s+(?:-\.--|\d[\d.]*))+)")
_ROUNDING = 0.0105
"""Largest difference of an average and its decays' mean in s: both are rounded to a hundredth."""
_ROW = re.compile(r"(\d[\d.]*)\s+(-\.--|\d[\d.]*)\s+(-\.--|\d[\d.]*)")


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
            rows.append((n, [m[1], *_with_uncertainty(m[2], m[3], f"{path}, line {n}")]))
    if len(rows) < 2:
        raise DataError(f"{path}, line {header[0]}: no row of a band below the header")
    lines_after = [line for _, line in numbered[at + 1 :]]
    name = PureWindowsPath(numbered[0][1].partition(":")[2].strip()).stem
    return Sheet(
        place=path,
        rows=tuple(rows),
        note=f"the XL2's report {name}, text in {text.encoding}",
        position=position_in(name) or ("", name),
        notes=(
            f"{header[1].upper()} is the average over the report's decays; its uncertainty is "
            "MeasUnct (ISO 3382-2)",
            *_contradictions(rows[1:], _decays(lines_after)),
        ),
    )


def _with_uncertainty(value: str, percent: str, place: str) -> tuple[str, str]:
    """Return a value and its uncertainty in its own unit; empty if they are missing."""
    if value.startswith("-") or not number(value, place):
        return "", ""
    if percent.startswith("-"):
        return value, ""
    return value, repr(number(value, place) * number(percent, place) / 100)


def _decays(after: list[str]) -> dict[str, list[float]]:
    """Return the times in s of every decay by band; empty without the list of decays."""
    bands = next((m[1].split() for line in after if (m := _BANDS.fullmatch(line))), [])
    times: dict[str, list[float]] = {band: [] for band in bands}
    for line in after:
        m = _DECAY.fullmatch(line)
        cells = m[1].split() if m else []
        if len(cells) == 2 * len(bands):  # a time and its correlation for every band
            for band, cell in zip(bands, cells[::2], strict=True):
                if not cell.startswith("-"):
                    times[band].append(number(cell, band))
    return times


def _contradictions(rows: list[Row], decays: dict[str, list[float]]) -> list[str]:
    """Return a note on averages that are not the mean of their decays."""
    off = []
    for _, (band, value, _u) in rows:
        times = decays.get(band, [])
        if value and decays and not times:
            off.append(f"{band} Hz (no decay)")
        elif value and times and abs(sum(times) / len(times) - float(value)) > _ROUNDING:
            off.append(
                f"{band} Hz ({value} s, of decays with a mean of {sum(times) / len(times):.2f} s)"
            )
    if not off:
        return []
    return [f"averages that are not the mean of the report's decays: {', '.join(off)}"]
