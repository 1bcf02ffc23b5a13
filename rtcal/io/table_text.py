"""Text with separators (CSV, or columns aligned by blanks) as cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection

from rtcal.io.table_layout import Headers, Row, Sheet
from rtcal.io.text import Text, lines
from rtcal.support.errors import DataError

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
        chosen = next((s for s in likely if s in first), likely[0])
    rows = tables[chosen] if chosen in tables else _rows(characters, chosen, path)
    by = "blanks" if aligned and chosen == "\t" else repr(chosen)
    note = f"text in {text.encoding}, columns separated by {by}"
    return Sheet(path, tuple(rows), note)


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
