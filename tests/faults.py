"""A file layer that fails: the nth event raises, or the process is killed there.

Events are the calls of the operating system that `rtcal.files.disk` makes to write.
"""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rtcal.files import disk
from rtcal.support.errors import DataError

EVENTS = ("open", "write", "fsync", "replace", "chmod", "close")
KILLED = 77


class FaultyOs:
    """The module ``os``; the nth event fails, and ``count`` events there were."""

    def __init__(self, nth: int | None, fault: Callable[[str], None]) -> None:
        self.count, self.nth, self.fault = 0, nth, fault

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in EVENTS:
            return real

        def event(*arguments: Any) -> Any:
            self.count += 1
            if self.count == self.nth:
                if name == "write":  # half of it arrives
                    real(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
                if name == "close":  # Linux closes also where it says that it failed
                    real(*arguments)
                self.fault(name)
            return None if name == "fsync" else real(*arguments)  # the tests need no real disk

        return event


def full(name: str) -> None:
    raise OSError(errno.ENOSPC, f"No space left on device, in {name}")


def kill(name: str) -> None:
    os._exit(KILLED)


def interrupt(name: str) -> None:
    raise KeyboardInterrupt


@contextmanager
def faulty(nth: int | None, fault: Callable[[str], None] = full) -> Iterator[FaultyOs]:
    """Let the nth event fail in this process."""
    with pytest.MonkeyPatch.context() as patch:
        layer = FaultyOs(nth, fault)
        patch.setattr(disk, "os", layer)
        yield layer


def killed(act: Callable[[], object], nth: int) -> bool:
    """Act in a process of its own that is killed at the nth event; whether it got that far."""
    child = os.fork()
    if child == 0:
        try:
            with faulty(nth, kill):
                act()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == KILLED


def snapshot(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, without records and temporary files."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != disk.RECORD and not path.name.endswith(disk.NEW)
    }


def refused(folder: Path) -> str:
    """Return the message of a reader that refuses a file below a folder as written in part, or ""."""
    for name in snapshot(folder):
        try:
            disk.read_bytes(folder / name, 2**28)
        except DataError as error:
            if "was interrupted while it wrote" not in str(error):
                raise
            return str(error)
    return ""
