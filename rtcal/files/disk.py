"""Files: text is read as UTF-8; each file is written whole; a set of files is whole, or refused.

A file is replaced by a temporary one beside it that was written through to the disk, so that at any
moment it is the old one or the new one. What one command, or one call, writes is a set: a record in
each folder, ``.rtcal_files.json``, has the digest of each file and the command that wrote it. It is
written before the first file of a set is replaced and once more after the last. If a command is killed
in between, readers refuse every file of that set by name, and say which command makes the set anew.

Commands replace no file that rtcal did not write, or that was changed since, unless they are told to
(``--force``): the record says which are rtcal's own.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

import msgspec
import numpy as np

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

RECORD = ".rtcal_files.json"
"""Name of the file that records which files of a folder rtcal wrote; others are only replaced with
--force."""
NEW = ".rtcal-new"
"""Ending of a file while it is written."""
_MOST_RECORD = 2**22
_CALL = "the call that wrote it"
_UNWRITTEN = "cannot be written: "


def reason(error: OSError) -> str:
    """Return why the system refuses a path, in the words that all commands use."""
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return "no such file or folder"
    return error.strerror or str(error)


@contextmanager
def _naming(path: Any, what: str = "") -> Iterator[None]:
    """Raise a DataError that names the path in place of what the system or Python raises."""
    try:
        yield
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {what}{reason(error)}") from error
    except (ValueError, TypeError) as error:  # a path with a NUL, or no path
        raise DataError(f"{path!r} must be a path: {error}") from error


@dataclass
class _Set:
    """Files of the running command, until they are written as one set."""

    command: str
    replaced: set[Path] | None = field(default_factory=set)
    """Files of the user's that it may replace; None for every one (``--force``)."""
    contents: dict[Path, bytes] = field(default_factory=dict)
    stated: dict[Path, str] = field(default_factory=dict)
    """The files' paths as they were stated."""
    written: list[str] = field(default_factory=list)


_current: _Set | None = None


@contextmanager
def one_set(command: str) -> Iterator[None]:
    """Collect the files that are written in the block as one set of a command, for `commit`."""
    global _current
    outer, _current = _current, _Set(command)
    try:
        yield
        commit()
    finally:
        _current = outer


def command() -> str:
    """Return the running command as it was typed; "" outside one."""
    return "" if _current is None else _current.command


@contextmanager
def at_once() -> Iterator[None]:
    """Write the files of the block at once, apart from the running command's set."""
    global _current
    outer, _current = _current, None
    try:
        yield
    finally:
        _current = outer


def may_replace(path: str | os.PathLike[str] | None = None) -> None:
    """Let the running command replace a file that rtcal did not write; None for any such file."""
    if _current is None or _current.replaced is None:
        return
    if path is None:
        _current.replaced = None
    else:
        _current.replaced.add(Path(os.path.realpath(path)))


def commit() -> list[str]:
    """Write the files of the running command as one set, and return the names of all it has written."""
    if _current is None:
        return []
    contents, _current.contents = _current.contents, {}
    if contents:
        _write_set(contents, _current.command)
        _current.written += [_current.stated[path] for path in contents]
    return list(dict.fromkeys(_current.written))


def target(path: Path) -> Path:
    """Return the path of the file that a path or link refers to; OSError if there is another thing."""
    try:
        file = path.resolve()
        kind = file.stat().st_mode
    except FileNotFoundError:
        return file
    except RuntimeError as error:  # Python 3.11 and 3.12
        raise OSError("the links form a loop") from error
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(None, "it is a folder; give the name of a file")
    if not stat.S_ISREG(kind):
        raise OSError("it is not a regular file")
    return file


def _digest_of(path: Path) -> str | None:
    """Return the digest of a file on the disk; None if there is none, or it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def _write_set(contents: Mapping[Path, bytes], command: str) -> None:
    """Write files of existing folders, each whole; raises DataError, naming what cannot be written."""
    folders = list(dict.fromkeys(path.parent for path in contents))
    news = {path: path.with_name(f".{path.name}{NEW}") for path in contents}
    digests = {path: hashlib.sha256(content).hexdigest() for path, content in contents.items()}
    try:
        for path, content in contents.items():
            with _naming(path, _UNWRITTEN):
                _write_file(news[path], content, path)
        for folder in folders:
            _put(folder, command, digests, whole=False)
    except BaseException:  # nothing is replaced yet
        for new in (*news.values(), *(folder / f"{RECORD}{NEW}" for folder in folders)):
            with suppress(OSError):
                new.unlink(missing_ok=True)
        raise
    for path, new in news.items():
        with _naming(path, _UNWRITTEN):
            os.replace(new, path)
    for folder in folders:
        _put(folder, command, digests, whole=True)


def _put(folder: Path, command: str, digests: Mapping[Path, str], *, whole: bool) -> None:
    """Add the files of a set to a folder's record."""
    files = _files(folder)
    for path, digest in digests.items():
        name = os.path.relpath(path, folder)
        files[name] = {"sha256": digest, "command": command, "whole": whole}
    new = folder / f"{RECORD}{NEW}"
    with _naming(folder, _UNWRITTEN):
        if whole:
            _sync_folder(folder)
        _write_file(new, json.dumps({"rtcal": "files 3", "files": files}, indent=1).encode())
        os.replace(new, folder / RECORD)
        _sync_folder(folder)


class _Written(TypedDict):
    """A file: its digest, the command of its set, and whether that set was written whole."""

    sha256: str
    command: str
    whole: bool


class _Record(TypedDict):
    files: dict[str, _Written]


def _files(folder: Path) -> dict[str, _Written]:
    """Return the files of a folder's record by name; none if there is no record that can be read."""
    try:
        with open(folder / RECORD, "rb") as stream:
            return msgspec.json.decode(stream.read(_MOST_RECORD), type=_Record)["files"]
    except (OSError, msgspec.MsgspecError, RecursionError):
        return {}


def _require_whole(path: Path) -> None:
    """Raise DataError if a file is of a set that was written in part, with how to make it anew."""
    every = _files(path.parent)
    own = every.get(path.name)
    if own is None or own["whole"]:
        return
    torn = {n: f for n, f in every.items() if not f["whole"] and f["command"] == own["command"]}
    new = [name for name, f in torn.items() if _digest_of(path.parent / name) == f["sha256"]]
    repeated = _current is not None and _current.command == own["command"]
    # Nothing was replaced, or all; or an old file, from which the command makes the set anew.
    if len(new) in (0, len(torn)) or (repeated and path.name not in new):
        return
    raise DataError(
        f"{path}: `{own['command']}` was interrupted while it wrote {', '.join(torn)}; "
        f"only {', '.join(new)} is new, so the files do not belong together. Repeat that "
        "command"
    )


def refuse_foreign(path: str | os.PathLike[str]) -> None:
    """Raise DataError if the running command would replace a file that rtcal did not write."""
    if _current is None or _current.replaced is None:
        return
    known = _current.replaced | _current.contents.keys()
    try:
        file = target(Path(path))
        stated = _files(file.parent).get(file.name)
        # It is rtcal's own as it was written, or of a set in part.
        own = stated and (not stated["whole"] or stated["sha256"] == _digest_of(file))
        foreign = file.exists() and file not in known and not own
    except OSError:
        return  # where it is written, the reason is said
    if foreign:
        raise DataError(
            f"{path}: this file exists, and rtcal did not write it, or it was changed "
            "afterwards. Choose another name, or replace the file with --force"
        )


def _write_file(path: Path, content: bytes, like: Path | None = None) -> None:
    """Write a file through to the disk, with the mode of the file that it replaces."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        view = memoryview(content)
        while view:
            view = view[os.write(handle, view) :]
        with suppress(FileNotFoundError):
            if like is not None:
                os.chmod(path, stat.S_IMODE(os.stat(like).st_mode))
        os.fsync(handle)
    finally:
        os.close(handle)


def _sync_folder(folder: Path) -> None:
    """Write a folder's entries through to the disk, if the system supports it."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file outside a set (`write_all`), so that it is replaced as a whole or not at all."""
    new = path.with_name(f".{path.name}.{os.getpid()}{NEW}")
    with _naming(path, _UNWRITTEN):
        _write_file(new, content)
        os.replace(new, path)


MAX_BYTES = 2**28
"""Largest size of a kept array's file in bytes; errors of 60 rooms in 60 configurations have 1 MB."""


def read(path: Path, limit: int = MAX_BYTES) -> Array | None:
    """Return the array that `write` kept under this path; None if there is none."""
    try:
        kept = read_bytes(path, limit)
    except DataError:
        return None
    content = kept[hashlib.sha256().digest_size :]
    if kept != _sealed(path, content):
        return None
    array: Array = np.load(io.BytesIO(content), allow_pickle=False)
    return array


def write(path: Path, array: Array) -> None:
    """Write an array of numbers into a cache; if the folder cannot be written, nothing is written."""
    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    with suppress(DataError):
        make_folder(path.parent)
        replace_file(path, _sealed(path, content.getvalue()))


def _sealed(path: Path, content: bytes) -> bytes:
    """Return a content below its checksum, in which the file's name counts."""
    return hashlib.sha256(path.name.encode() + content).digest() + content


def read_bytes(path: str | os.PathLike[str], limit: int) -> bytes:
    """Return the bytes of a file.

    Raises DataError if it is no regular file, has more than ``limit`` bytes, or is of a torn set.
    """
    with _naming(path):
        if Path(path).exists() and not Path(path).is_file():
            room = Path(path) / "room.toml"
            found = f". Did you mean {room}?" if room.is_file() else ""
            raise DataError(f"{path}: this is not a file{found}")
        file = Path(os.path.realpath(path))
        if _current is not None and file in _current.contents:
            content = _current.contents[file]
        else:
            _require_whole(file)
            with open(path, "rb") as stream:
                content = stream.read(limit + 1)
    if len(content) > limit:
        raise DataError(
            f"{path}: the file has more than {limit} bytes, the largest size of a file of "
            "this kind that rtcal reads"
        )
    return content


def read_text(path: str | os.PathLike[str], limit: int) -> str:
    """Return the text of a file in UTF-8."""
    content = read_bytes(path, limit)
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise DataError(
            f"{path}: the file is not UTF-8 text (first wrong byte: {error.start}). Save "
            "it as UTF-8"
        ) from error


def spare(
    written: Sequence[str | os.PathLike[str] | None], read: Sequence[str | os.PathLike[str] | None]
) -> None:
    """Raise DataError if a path to be written is also read, or would be written twice; None is none."""
    # As Path.resolve, but a loop of symbolic links is left to the reader, which names it.
    taken = {os.path.realpath(path): path for path in read if path is not None}
    for path in (path for path in written if path is not None):
        place = os.path.realpath(path)
        if place in taken:
            raise DataError(
                f"{path}: this output would overwrite {taken[place]}. Choose another name "
                "for the output"
            )
        taken[place] = path
        refuse_foreign(path)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file whole or not at all."""
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file's bytes whole or not at all; raises DataError if the file cannot be written."""
    write_all({checks.path("path", path): content})


def write_all(contents: Mapping[Any, bytes], folder: str | os.PathLike[str] | None = None) -> None:
    """Write several files as one set: if one cannot be written, all stay as they were.

    Paths are relative to ``folder``. Within a command, the files are written when it ends. Links are
    followed, and existing files keep their mode. Raises DataError, which names the file.
    """
    if folder is not None:
        make_folder(folder)
    targets, stated = {}, {}
    for path, content in contents.items():
        with _naming(path, _UNWRITTEN):
            file = target(Path(path))
            targets[file], stated[file] = content, os.fspath(path)
            if not file.parent.is_dir():
                raise FileNotFoundError(None, "no such file or folder")
            refuse_foreign(path)
    if _current is not None:
        _current.contents.update(targets)
        _current.stated.update(stated)
    elif targets:
        _write_set(targets, _CALL)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder and those above it, unless it exists; raises DataError if that fails."""
    with _naming(path):
        Path(path).mkdir(parents=True, exist_ok=True)


def json_numbers(value: Any) -> Any:
    """Return a value as plain numbers, texts, lists and objects for JSON; NaN becomes None.

    An array with named columns becomes a list with an object per row; other dataclasses become what
    ``to_dict`` returns, or their own text, or else their fields.
    """
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        numbers = value.astype(object)
        numbers[~np.isfinite(value)] = None
        return numbers.tolist()
    if isinstance(value, Mapping):
        return {str(key): json_numbers(each) for key, each in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.names:
        return [dict(zip(value.dtype.names, map(json_numbers, row), strict=True)) for row in value]
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [json_numbers(each) for each in value]
    if isinstance(value, int | float):
        return value if math.isfinite(value) else None
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if dataclasses.is_dataclass(value) and type(value).__str__ is object.__str__:
        return {f.name: json_numbers(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return str(value)


def json_text(record: Mapping[str, Any]) -> str:
    """Return a record as JSON text; characters that are not ASCII are escapes."""
    return json.dumps(json_numbers(record), indent=1, allow_nan=False)
