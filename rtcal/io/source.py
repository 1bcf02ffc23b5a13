"""A foreign file's text: a character a byte, so that what is found has its place in the file."""

from __future__ import annotations

import re

from rtcal.errors import DataError

MAX_TEXT = 2**18
"""Bytes that a material list or a table may have: twice ODEON's own library."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?\Z", re.ASCII)


def as_text(content: bytes) -> str:
    """Return one character a byte (Latin-1): places in the text are places in the file."""
    return content.decode("latin-1")


def readable(text: str) -> str:
    """Return text from `as_text` as it was meant: UTF-8 if it is that, else Windows' code page."""
    raw = text.encode("latin-1")
    for encoding in ("utf-8", "cp1252"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return text


def line_of(text: str, position: int) -> int:
    """Return the line, from 1, that a position of the text is on."""
    return text.count("\n", 0, position) + 1


def number(token: str, place: str) -> float:
    """Return a plain decimal number; DataError for anything else, also for what is not finite."""
    value = float(token) if len(token) <= 40 and NUMBER.match(token) else float("nan")
    if not abs(value) < 1e300:
        raise DataError(f'{place}: "{shown(token)}" is not a finite number')
    return value


def shown(text: str, length: int = 40) -> str:
    """Return text for a message: printable and short."""
    text = readable(text)
    text = text if text.isprintable() else repr(text)[1:-1]
    return text if len(text) <= length else text[:length] + "..."
