"""Files: text is read as UTF-8; several are written as one, all new, or all as they were.

The new files are staged in a hidden folder ``.rtcal-*`` beside their targets. Then a journal is
written, which commits them, and they are moved into place. After an error, a kill or a power cut, the
next command that reads or writes in the folder goes on from there: with a journal it moves in what is
left, and without one it deletes what was staged. Writers lock their folders, so an unlocked
``.rtcal-*`` belongs to no running command.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import signal
import stat
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rtcal.support.errors import DataError
from rtcal.support.types import Array

try:
    import fcntl
except (
    ImportError
):  # Windows has no flock: there two commands must not write the same folder at once
    fcntl = None  # type: ignore[assignment]

PREFIX = ".rtcal-"
LONGEST_WAIT = 10.0
"""Longest wait in s for another command that writes into the same folder."""
_PAUSE = 0.02
_FOLDERS, _JOURNAL = "folders", "journal"

begun: list[Path] = []
"""Files that this process has written, or begun to write: without any, nothing was written."""
_thread_lock = threading.RLock()
_locked: set[Path] = set()  # folders that this process has locked


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold Ctrl-C back until the files are in place and nothing is left beside them.

    Signals reach the main thread only, so that other threads need no protection.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *signalled: came.append(signalled))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if came:
            handler(*came[0])


@contextmanager
def locked(*folders: Path) -> Iterator[None]:
    """Lock folders for this process; wait while another process has locked one of them.

    Raises DataError after `LONGEST_WAIT`, or if a folder cannot be opened.
    """
    with _thread_lock, ExitStack() as stack:
        for folder in sorted({Path(os.path.realpath(folder)) for folder in folders} - _locked):
            busy = f"{folder}: another process is writing here"
            stack.enter_context(_lock(folder, LONGEST_WAIT, busy))
            stack.callback(_locked.discard, folder)
            _locked.add(folder)
        yield


def held(file: Path) -> AbstractContextManager[None]:
    """Lock a file while a command works on it; DataError if another process has locked it."""
    return _lock(file, 0, f"{file.parent} is in use: another process works on {file.name}")


@contextmanager
def _lock(path: Path, wait: float, busy: str) -> Iterator[None]:
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error
    try:
        for left in range(int(wait / _PAUSE), -1, -1):
            try:
                if fcntl is not None:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if not left:
                    raise DataError(busy) from error
                time.sleep(_PAUSE)
            except OSError:
                break  # a file system without locks
        yield
    finally:
        with suppress(OSError):  # nothing was written to it: there is nothing to lose
            os.close(handle)


def target(path: Path) -> Path:
    """Return the file that a path, perhaps a link, refers to; OSError if it is no file."""
    try:
        file = path.resolve()
        kind = file.stat().st_mode
    except FileNotFoundError:
        return file
    except RuntimeError as error:  # Python 3.11 and 3.12
        raise OSError("a loop of links") from error
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(None, "Is a directory")
    if not stat.S_ISREG(kind):
        raise OSError("not a regular file")
    return file


def write_set(targets: Mapping[Path, bytes]) -> None:
    """Write all files or none. Raises OSError if that fails.

    The paths are as `target` returns them, in existing folders. Existing files keep their mode.
    """
    parents = list(dict.fromkeys(path.parent for path in targets))
    with locked(*parents), _undisturbed():
        begun.extend(targets)
        for parent in parents:
            _go_on(parent)
        name = f"{PREFIX}{uuid.uuid4().hex[:12]}"
        folders = [parent / name for parent in parents]
        try:
            _stage(targets, folders)
            _finish(folders)
        except BaseException:
            if not (folders[0] / _JOURNAL).exists():  # else the next command goes on
                with suppress(OSError):
                    _remove(folders)
            raise


def recover(folders: Iterable[Path]) -> None:
    """Go on with an interrupted write in these folders; DataError if that fails."""
    for folder in {Path(os.path.realpath(folder)) for folder in folders}:
        if _interrupted(folder):
            with locked(folder):
                _go_on(folder)


def _go_on(folder: Path) -> None:
    """Finish what was committed in a locked folder, and delete what was not."""
    for left in _interrupted(folder):
        try:
            _finish(_folders(left))
        except (OSError, ValueError, TypeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise DataError(
                f"{folder}: a write was interrupted, and cannot be finished: {reason} ({left.name})"
            ) from error


def _interrupted(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return [
                Path(e.path)
                for e in entries
                if e.name.startswith(PREFIX) and e.is_dir(follow_symlinks=False)
            ]
    except OSError:
        return []


def _folders(left: Path) -> list[Path]:
    """Return the hidden folders of an interrupted write, starting with that of the journal."""
    try:
        names = json.loads((left / _FOLDERS).read_bytes())
        folders = [Path(os.path.normpath(left.parent / name)) for name in names]
    except (OSError, ValueError, TypeError):
        return [left]  # killed before it was written: nothing was committed yet
    whole = left in folders and all(f.name == left.name and f.is_dir() for f in folders)
    return folders if whole else [left]


def _stage(targets: Mapping[Path, bytes], folders: list[Path]) -> None:
    """Write the new files into hidden folders, and then the journal."""
    journal = []
    for folder in folders:
        os.mkdir(folder, 0o700)
        names = [os.path.relpath(f, folder.parent) for f in folders]
        _write_file(folder / _FOLDERS, json.dumps(names).encode())
    for i, (place, content) in enumerate(targets.items()):
        new = place.parent / folders[0].name / f"{i}.new"
        _write_file(new, content, place)
        journal.append([os.path.relpath(path, folders[0].parent) for path in (new, place)])
    for folder in folders:
        _sync_folder(folder)
        _sync_folder(folder.parent)
    draft = folders[0] / f"{_JOURNAL}.new"
    _write_file(draft, json.dumps(journal).encode())
    os.replace(draft, folders[0] / _JOURNAL)
    _sync_folder(folders[0])


def _finish(folders: list[Path]) -> None:
    """Move the staged files into place if the journal exists, and remove the hidden folders."""
    journal = folders[0] / _JOURNAL
    if journal.exists():
        for names in json.loads(journal.read_bytes()):
            new, place = (Path(os.path.normpath(folders[0].parent / name)) for name in names)
            if new.parent not in folders or place.parent != new.parent.parent:
                raise ValueError("the journal names files elsewhere")  # rtcal did not write it
            with suppress(FileNotFoundError):  # moved before the interruption
                os.replace(new, place)
        for folder in folders:
            _sync_folder(folder.parent)
        os.unlink(journal)
    with suppress(OSError):  # the files are in place; the next command tidies up
        _remove(folders)


def _write_file(path: Path, content: bytes, like: Path | None = None) -> None:
    """Write a new file through to the disk, with the mode of the file that it replaces."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
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


def _remove(folders: Iterable[Path]) -> None:
    for folder in [*folders][::-1]:  # that with the journal last: the others lead to it
        if folder.is_dir():
            shutil.rmtree(folder)


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
        recover([Path(path).parent])
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
            targets[target(Path(path))] = content
        if len(targets) > 1:
            path = os.path.commonpath([target.parent for target in targets])
        if targets:
            write_set(targets)
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


def json_text(record: Mapping[str, Any], *, ascii_only: bool = False) -> str:
    """Return a record as JSON: arrays as lists, tables as one object per row, NaN as null.

    Parameters
    ----------
    record : mapping
        Of numbers, texts, arrays, lists, mappings and None.
    ascii_only : bool
        Whether to write other characters as escapes.

    Examples
    --------
    >>> print(json_text({"t": np.array([1.5, np.nan])}))
    {
     "t": [
      1.5,
      null
     ]
    }
    """
    return json.dumps(_plain(record), indent=1, ensure_ascii=ascii_only, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype.names:  # a table
            return [dict(zip(value.dtype.names, _plain(list(row)), strict=True)) for row in value]
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
