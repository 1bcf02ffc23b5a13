"""Several files written as one: all of them new, or all of them as they were.

The new files and links to the old ones are staged in a hidden folder ``.rtcal-*`` beside the files.
Then a journal is written and the new files are moved into place. Deleting the journal commits them.
After an error the old files are restored from the journal; after a kill or a power cut, the next
command does so. Writers lock their folders, so an unlocked ``.rtcal-*`` belongs to no running command.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import stat
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType

from rtcal.errors import DataError

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

_thread_lock = threading.RLock()
_locked: dict[Path, int] = {}  # folders that this process has locked, and how often


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold Ctrl-C back until the files are in place and nothing is left beside them.

    An exception may come between any two steps, also between those that undo and tidy up. Signals
    reach the main thread only, so that other threads need no protection.
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
        for folder in sorted({Path(os.path.realpath(folder)) for folder in folders}):
            stack.enter_context(_folder_lock(folder))
        yield


@contextmanager
def _folder_lock(folder: Path) -> Iterator[None]:
    handle = None
    if fcntl is not None and not _locked.get(folder):
        handle = _opened(folder)
    try:
        if handle is not None:
            _wait_for(handle, folder)
        _locked[folder] = _locked.get(folder, 0) + 1
        try:
            yield
        finally:
            _locked[folder] -= 1
    finally:
        if handle is not None:
            _let_go(handle)


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDONLY)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error


def _let_go(handle: int) -> None:
    with suppress(OSError):  # nothing was written to it: there is nothing to lose
        os.close(handle)


def _wait_for(handle: int, folder: Path) -> None:
    for _ in range(int(LONGEST_WAIT / _PAUSE)):
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            time.sleep(_PAUSE)
        except OSError:
            return  # a file system without locks
    raise DataError(f"{folder}: another process is writing here")


@contextmanager
def held(file: Path) -> Iterator[None]:
    """Lock a file while a command works on it; DataError if another process has locked it."""
    handle = _opened(file)
    try:
        try:
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DataError(
                f"{file.parent} is in use: another process works on {file.name}"
            ) from error
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        _let_go(handle)


def recover(folders: Iterable[Path]) -> None:
    """Undo an interrupted write in these folders, and delete its staged files.

    Raises DataError if that fails.
    """
    for folder in {Path(os.path.realpath(folder)) for folder in folders}:
        for left in _transactions(folder):
            dirs = _directories(left)
            with locked(*(d.parent for d in dirs if d.parent.is_dir())):
                if not left.is_dir():
                    continue  # its writer was alive, and has finished
                try:
                    _roll_back(dirs)
                except (OSError, ValueError, TypeError) as error:
                    reason = getattr(error, "strerror", None) or error
                    raise DataError(
                        f"{folder}: a write was interrupted, and what was there before cannot be put "
                        f"back: {reason} ({left.name})"
                    ) from error


def _transactions(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return [
                Path(e.path)
                for e in entries
                if e.name.startswith(PREFIX) and e.is_dir(follow_symlinks=False)
            ]
    except OSError:
        return []


def _directories(transaction: Path) -> list[Path]:
    """Return a transaction's hidden folders, starting with that of the journal."""
    try:
        names = json.loads((transaction / _FOLDERS).read_bytes())
        dirs = [Path(os.path.normpath(transaction.parent / name)) for name in names]
    except (OSError, ValueError, TypeError):
        return [transaction]  # killed before it was written: nothing was moved yet
    alike = transaction in dirs and all(d.name == transaction.name and d.is_dir() for d in dirs)
    return dirs if alike else [transaction]


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


def write(targets: Mapping[Path, bytes]) -> None:
    """Write all files or none. Raises OSError if that fails.

    The paths are as `target` returns them, in existing folders. Existing files keep their mode.
    """
    parents = list(dict.fromkeys(path.parent for path in targets))
    with locked(*parents), _undisturbed():
        recover(parents)
        name = f"{PREFIX}{uuid.uuid4().hex[:12]}"
        dirs = [parent / name for parent in parents]
        try:
            _move_in(targets, dict(zip(parents, dirs, strict=True)))
        except BaseException as error:
            try:
                _roll_back(dirs)
            except OSError as failed:
                raise OSError(
                    f"{getattr(error, 'strerror', None) or error}; the next command puts back what was "
                    f"there, which failed now: {failed.strerror or failed}"
                ) from error
            raise
        with suppress(OSError):  # the files are in place; the next command tidies up
            for parent in parents:
                _sync_folder(parent)
            _remove(dirs)


def _move_in(targets: Mapping[Path, bytes], dirs: Mapping[Path, Path]) -> None:
    primary = next(iter(dirs.values()))
    for directory in dirs.values():
        os.mkdir(directory, 0o700)
        names = [os.path.relpath(d, directory.parent) for d in dirs.values()]
        _write_file(directory / _FOLDERS, json.dumps(names).encode())
    journal = []
    for i, (target, content) in enumerate(targets.items()):
        new, old = (dirs[target.parent] / f"{i}.{end}" for end in ("new", "old"))
        _write_file(new, content, target)
        if existed := target.exists():
            _link(target, old)
        paths = [os.path.relpath(p, primary.parent) for p in (target, new, old)]
        journal.append([*paths, existed])
    if len(targets) == 1:  # one rename is whole by itself
        os.replace(new, target)
        return
    draft = primary / f"{_JOURNAL}.new"
    _write_file(draft, json.dumps(journal).encode())
    for directory in dirs.values():
        _sync_folder(directory)
        _sync_folder(directory.parent)
    os.replace(draft, primary / _JOURNAL)
    _sync_folder(primary)
    for i, target in enumerate(targets):
        os.replace(dirs[target.parent] / f"{i}.new", target)
    for parent in dirs:
        _sync_folder(parent)
    os.unlink(primary / _JOURNAL)


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


def _link(file: Path, link: Path) -> None:
    try:
        os.link(file, link)
    except OSError:  # a file system without links
        shutil.copy2(file, link)


def _sync_folder(folder: Path) -> None:
    """Write a folder's entries through to the disk, if the system supports it."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _roll_back(dirs: list[Path]) -> None:
    """Restore the old files if the journal exists; remove the hidden folders."""
    journal = dirs[0] / _JOURNAL
    if journal.exists():
        for *names, existed in json.loads(journal.read_bytes()):
            target, new, old = (Path(os.path.normpath(dirs[0].parent / name)) for name in names)
            if target.parent / dirs[0].name not in dirs or {new.parent, old.parent} - {*dirs}:
                raise ValueError("the journal names files elsewhere")  # rtcal did not write it
            if existed and old.exists():
                os.replace(old, target)
            elif not existed and not new.exists():
                target.unlink(missing_ok=True)
        for directory in dirs:
            if directory.parent.is_dir():
                _sync_folder(directory.parent)
        os.unlink(journal)
    _remove(dirs)


def _remove(dirs: Iterable[Path]) -> None:
    for directory in [*dirs][::-1]:  # that with the journal last: the others lead to it
        if directory.is_dir():
            shutil.rmtree(directory)
