"""Arrays kept in files between two runs. A file that is damaged, or another's, counts as missing."""

from __future__ import annotations

import hashlib
import io
from contextlib import suppress
from pathlib import Path

import numpy as np

from rtcal.errors import DataError
from rtcal.support.files import make_folder, read_bytes, write_bytes
from rtcal.support.types import Array

MAX_BYTES = 2**28
"""Largest size of a file; errors of 60 control rooms in 60 configurations have 1 MB."""


def read(path: Path) -> Array | None:
    """Return the array that `write` kept under this name; None if there is none."""
    try:
        head, _, content = read_bytes(path, MAX_BYTES).partition(b"\n")
    except DataError:
        return None
    if head + b"\n" != _head(path, content):
        return None
    array: Array = np.load(io.BytesIO(content), allow_pickle=False)
    return array


def write(path: Path, array: Array) -> None:
    """Keep an array of numbers. The name is to tell what it depends on, such as a hash of that.

    Where the folder cannot be written, nothing is kept.
    """
    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    with suppress(DataError):
        make_folder(path.parent)
        write_bytes(path, _head(path, content.getvalue()) + content.getvalue())


def _head(path: Path, content: bytes) -> bytes:
    """Return a file's first line: what it is, its name and its checksum."""
    said = f"rtcal array {path.name}, sha256 "
    return f"{said}{hashlib.sha256(said.encode() + content).hexdigest()}\n".encode()
