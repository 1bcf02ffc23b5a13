"""A law: Ctrl-C at any step of a write leaves all files new or all old, and no hidden file."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from rtcal.support import files
from rtcal.support.files import write_all

OWN = files.__file__


class Interrupter:
    """Send SIGINT before the n-th line that runs in the module that writes."""

    def __init__(self, n: int) -> None:
        self.left, self.sent = n, False

    def __call__(self, frame: FrameType, event: str, _: Any) -> Any:
        if frame.f_code.co_filename != OWN:
            return None
        if event == "line":
            self.left -= 1
            if self.left == 0:
                self.sent = True
                os.kill(os.getpid(), signal.SIGINT)
        return self


def interrupted(folder: Path, n: int) -> bool:
    """Write three files, one of them new, and interrupt at line n; return whether there was one."""
    for name in ("a", "b"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    old = {folder / "a" / "x": b"old x", folder / "b" / "y": b"old y"}
    for path, content in old.items():
        path.write_bytes(content)
    new = {**dict.fromkeys(old, b"new"), folder / "b" / "z": b"new"}
    (folder / "b" / "z").unlink(missing_ok=True)
    tracer, before = Interrupter(n), sys.gettrace()
    sys.settrace(tracer)
    try:
        write_all(new)
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    assert not [*folder.rglob(f"{files.PREFIX}*")], n
    there = {path: path.read_bytes() for path in new if path.exists()}
    assert there in (old, new), n
    return tracer.sent


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_at_every_line_of_a_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # it takes most of the time
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        n = 1
        while interrupted(tmp_path, n):
            n += 1
    finally:
        signal.signal(signal.SIGINT, handler)
    assert n > 100
