"""The text of another program's file: its encoding, lines, numbers, and the cells of a table in it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import decimal_comma

MAX_TEXT = 2**18
"""Largest size in bytes of a material list, a table or a mesh: twice ODEON's own library."""

_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_NAMES = {"cp1252": "Windows-1252", "latin-1": "ISO 8859-1"}
_LINE = re.compile(r"([^\r\n]*)(\r\n|\r|\n|\Z)")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?\Z", re.ASCII)
MAX_CELL = 60
"""Largest length of a cell in characters; the pattern for number and unit is slow on longer ones."""
_WITH_UNIT = re.compile(r"[^%a-z]*\d[\d.,]*(?:e[+-]?\d+)?\s*(%|m?s|db)", re.I)
_TYPOGRAPHIC_MINUS = re.compile("[\u2212\u2013](?=[\\d.,])")  # a minus sign, or a dash in its place


@dataclass(frozen=True)
class Text:
    """The characters of a file, with its encoding and byte order mark, to write it back."""

    characters: str
    codec: str = "utf-8"
    byte_order_mark: bytes = b""

    @property
    def encoding(self) -> str:
        """The encoding's name in messages."""
        return _NAMES.get(self.codec, self.codec.upper())

    def encode(self, characters: str) -> bytes:
        """Return other characters in this file's encoding; DataError if it lacks one of them."""
        try:
            return self.byte_order_mark + characters.encode(self.codec)
        except UnicodeEncodeError as error:
            lacking = error.object[error.start]
            raise DataError(
                f'"{shown(lacking)}" cannot be written in the file\'s encoding {self.encoding}: '
                "use other characters"
            ) from error


def decode(content: bytes, path: str = "file") -> Text:
    """Return a file's text, by its byte order mark, or else as UTF-8, or else as Windows-1252."""
    checks.content(path, content)
    for mark, codec in _BYTE_ORDER_MARKS.items():
        if content.startswith(mark):
            try:
                return Text(content[len(mark) :].decode(codec), codec, mark)
            except UnicodeDecodeError as error:
                line = content.count(b"\n", 0, len(mark) + error.start) + 1
                at = f"{path}, line {line}: byte {len(mark) + error.start}"
                raise DataError(
                    f"{at} is not valid {codec.upper()} (byte order mark); save the file as UTF-8"
                ) from error
    for codec in ("utf-8", "cp1252"):
        with suppress(UnicodeDecodeError):
            return Text(content.decode(codec), codec)
    return Text(content.decode("latin-1"), "latin-1")


def lines(characters: str) -> Iterator[tuple[int, int, str]]:
    r"""Yield the number of each line from 1, the position where it starts, and its characters.

    >>> list(lines("a\r\nbc\rd"))
    [(1, 0, 'a'), (2, 3, 'bc'), (3, 6, 'd')]
    """
    for number_of_line, match in enumerate(_LINE.finditer(characters), start=1):
        if match.group() or match.start() < len(characters):
            yield number_of_line, match.start(), match.group(1)


def number(token: str, place: str) -> float:
    """Return the decimal number in a text, also with a typographic minus.

    >>> number("−1.5", "line 1")
    -1.5
    """
    plain = _TYPOGRAPHIC_MINUS.sub("-", token, count=1) if token else token
    value = float(plain) if len(plain) <= 40 and _NUMBER.match(plain) else float("nan")
    if not abs(value) < 1e300:
        advice = decimal_comma(token) if token.count(",") == 1 else ""
        raise DataError(f'{place}: "{shown(token)}" must be a finite number{advice}')
    return value


def numbers(text: str, counts: Collection[int], place: str) -> list[float]:
    """Return the numbers of a line that a person wrote, with decimal points or decimal commas.

    Commas alone separate numbers if the line then has one of the ``counts``, and are decimal commas if
    it then has twice such a count.

    >>> numbers("9,7,3", [3], "sides"), numbers("0,9; 0,8", [2], "T"), numbers("0,9,0,8", [2], "T")
    ([9.0, 7.0, 3.0], [0.9, 0.8], [0.9, 0.8])
    """
    cells = re.sub(r"\s*[;\s]\s*,?\s*|,\s+", ";", text.strip()).strip(";").split(";")
    if len(cells) == 1 and "," in text:
        single = cells[0].split(",")
        if "." not in text and len(single) not in counts and len(single) / 2 in counts:
            single = [".".join(pair) for pair in zip(single[::2], single[1::2], strict=True)]
        cells = single if "." in text or len(single) > 2 or 2 in counts else cells
    values = [number(cell.replace(",", ".", 1), place) for cell in cells]
    if len(values) not in counts:
        wanted = " or ".join(map(str, sorted(counts)))
        n = f"{len(values)} number{'s' * (len(values) > 1)}"
        raise DataError(f'{place}: "{shown(text)}" has {n}, but must have {wanted}')
    return values


def unit_of(cell: str) -> str:
    """Return the unit that follows the number in a cell; "" without a unit.

    >>> unit_of("1.2 s"), unit_of("55 %"), unit_of("1.2")
    ('s', '%', '')
    """
    match = _WITH_UNIT.fullmatch(cell) if len(cell) <= MAX_CELL else None
    return match[1] if match else ""


def shown(text: str, length: int = 40) -> str:
    """Return text for a message: printable and at most ``length`` characters."""
    text = text if text.isprintable() else repr(text)[1:-1]
    return text if len(text) <= length else text[:length] + "..."


Row = tuple[int, list[str]]
"""The number of a line, and its cells."""

SEPARATORS = (";", "\t", "|", ",")
_GAP = re.compile(r"(?<=\S)(?: {2,}|\t[ \t]*)")  # What separates columns that are aligned by blanks


@dataclass(frozen=True)
class Sheet:
    """Hold the cells of one table of a file.

    ``rows`` are the lines with their numbers and cells. ``place`` is the name of the table in messages:
    the file, and its sheet. ``note`` says how the cells were read; ``notes`` are further notes.
    ``name`` is the table's own name. ``position`` is the source and receiver of values for which rows
    and columns name none. ``separator`` is that of the cells in a text.
    """

    place: str
    rows: tuple[Row, ...]
    note: str
    name: str = ""
    position: tuple[str, str] = ("", "")
    notes: tuple[str, ...] = ()
    separator: str = ""


def sheets_of_text(text: Text, path: str) -> list[Sheet]:
    """Return the table in a text, once for each possible separator of its cells, the likeliest first.

    The likeliest separator divides most lines into equally many cells. A text without a separator is
    divided into columns that are aligned by blanks. ``path`` is the file's name in messages. Raises
    DataError for a text that is no table.
    """
    head, _, tail = text.characters.partition("\n")
    stated = head.strip().strip('"').lower()
    characters, separators = text.characters, [s for s in SEPARATORS if s in text.characters]
    if stated.startswith("sep=") and len(stated) <= 5:  # Excel's first line; a tab is stripped
        characters, separators = "\n" + tail, [stated[4:] or "\t"]
    elif {*separators} <= {","}:  # which may be decimal marks
        separators.append("")
    found: list[tuple[int, Sheet]] = []
    errors = []
    for separator in separators:
        try:
            aligned = characters if separator else _GAP.sub("\t", characters)
            rows = _rows(aligned, separator or "\t", path)
        except DataError as error:
            errors.append(error)
            continue
        widths = Counter(len(cells) for _, cells in rows if len(cells) > 1)
        by = repr(separator or ",") if separator or not widths else "blanks"
        note = f"text in {text.encoding}, columns separated by {by}"
        sheet = Sheet(path, tuple(rows), note, separator=separator)
        found.append((max(widths.values(), default=0), sheet))
    if not found:
        raise errors[0]
    return [sheet for _, sheet in sorted(found, key=lambda item: -item[0])]


def _rows(characters: str, separator: str, path: str) -> list[Row]:
    """Return the rows with the number of their first line; comments and empty rows are left out."""
    kept = [
        raw if raw.strip(" \t;,") and not raw.lstrip().startswith("#") else ""
        for _, _, raw in lines(characters)
    ]
    reader = csv.reader((f"{raw}\n" for raw in kept), delimiter=separator, strict=True)
    rows: list[Row] = []
    line = 1
    try:
        for cells in reader:
            cells = [" ".join(part.strip() for part in c.strip().split("\n")) for c in cells]
            if any(cells):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise DataError(f"{path}, line {line}: is not a row of cells: {error}") from error
    if len(rows) < 2:
        raise DataError(f"{path}, line 1: the table needs a header and at least one row")
    return rows
