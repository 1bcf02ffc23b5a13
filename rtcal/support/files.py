"""Text files: read as UTF-8, written whole or not at all (`rtcal.support.transaction`)."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rtcal.support import transaction
from rtcal.support.errors import DataError
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


def read_bytes(path: str | os.PathLike[str], limit: int) -> bytes:
    """Return a file's bytes; DataError if it is missing, no regular file, or above ``limit``.

    It first restores the old files if a write in the folder was interrupted.
    """
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise DataError(f"{path}: not a file")
        transaction.recover([Path(path).parent])
        with open(path, "rb") as stream:
            content = stream.read(limit + 1)
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:  # a path with a NUL, or no path
        raise DataError(f"{path!r}: not a path: {error}") from error
    if len(content) > limit:
        raise DataError(f"{path}: more than {limit} bytes; a file of this kind has at most that")
    return content


def read_text(path: str | os.PathLike[str], limit: int) -> str:
    """Return a file's text; DataError if it cannot be read, is above ``limit`` bytes or no UTF-8."""
    content = read_bytes(path, limit)
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not UTF-8 text: byte {error.start} ({error.reason})") from error


def spare(
    written: Sequence[str | os.PathLike[str]], read: Sequence[str | os.PathLike[str]]
) -> None:
    """Raise DataError if a path to be written is also read, or is to be written twice."""
    taken = {Path(path).resolve(): path for path in read}
    for path in written:
        place = Path(path).resolve()
        if place in taken:
            raise DataError(f"{path}: would be written over {taken[place]}; choose another name")
        taken[place] = path


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file whole or not at all."""
    write_all({path: text.encode("utf-8", errors="backslashreplace")})


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes whole or not at all; DataError if the place cannot be written."""
    write_all({path: content})


def write_all(contents: Mapping[Any, bytes]) -> None:
    """Write several files as one: all of them new, or all as they were.

    That also holds if the process is killed or the disk is full: the next command that reads or
    writes in the folder restores the old files. Links are followed, and existing files keep their
    mode. The keys are paths. Raises DataError, naming the file, if a place cannot be written.
    """
    path: Any = ""
    try:
        targets = {}
        for path, content in contents.items():
            targets[transaction.target(Path(path))] = content
        if len(targets) > 1:
            path = os.path.commonpath([target.parent for target in targets])
        if targets:
            transaction.write(targets)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path!r} is not a path: {error}") from error


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder, with those above it, unless it exists; DataError if that fails."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:  # a path with a NUL, or no path
        raise DataError(f"{path!r}: not a path: {error}") from error


def json_numbers(values: ArrayLike) -> Any:
    """Return numbers as nested lists for JSON, None for NaN, which JSON lacks."""
    array = np.asarray(values, dtype=float)
    if array.ndim:
        return [json_numbers(v) for v in array]
    return float(array) if np.isfinite(array) else None
