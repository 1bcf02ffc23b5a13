"""Room EQ Wizard's text of decay times (File, Export, RT60 data as text), also of several measurements.

Each measurement is a block: "RT60 data saved by REW", lines such as "Measurement: S1R1", a line
"Format is freq (Hz), BW (octaves), EDT (s), r, ...", and one row per band. Columns are separated by
blanks, tabs, commas or semicolons, as chosen at the export.

Read are the parameters that rtcal knows. REW's own Topt and T60M, and its row "full" of the whole
frequency range, are left out. A time of 0 is missing: REW writes it where it found no decay.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from rtcal.io.table_columns import column_of, position_in
from rtcal.io.table_layout import Row, Sheet
from rtcal.io.text import Text, decode, lines, shown
from rtcal.support.errors import DataError

_START = re.compile(r"\W*RT60 data (?:saved|measured) by REW", re.I)
_FORMAT = re.compile(r"\W*Format is\s+(.*)", re.I)
_WIDTH = "BW (octaves)"
_STRAIGHT = 0.98
"""Magnitude of the correlation coefficient below which REW calls a decay time unreliable."""
_MOST_BENT = 6


def claims(content: bytes) -> bool:
    """Return whether a file is REW's text of decay times."""
    return b"RT60 data saved by REW" in content[:4000] or b"Format is freq" in content[:8000]


def sheets(content: bytes, path: str, where: Mapping[str, str]) -> list[Sheet]:
    """Return one sheet per measurement; DataError names file and line.

    A file that has octaves and third-octaves needs ``where={"BW (octaves)": "1/3"}``.
    """
    text = decode(content, path)
    numbered = [(n, raw.strip()) for n, _, raw in lines(text.characters)]
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
    more = f" and {len(bent) - _MOST_BENT} more" if len(bent) > _MOST_BENT else ""
    return [f"REW calls unreliable (r below {_STRAIGHT:g}): {', '.join(bent[:_MOST_BENT])}{more}"]
