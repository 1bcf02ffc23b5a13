"""Ctrl-C at the end of a write: the command names what it has written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

STARTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import rtcal.__main__ as m; print('started', flush=True); m.main()
"""
"""The command as a terminal starts it. A shell's background job, and its children, ignore SIGINT."""


WRITTEN = """
import os, signal
from rtcal.files import disk

write = disk._write_set

def written(contents, command):
    write(contents, command)
    os.kill(os.getpid(), signal.SIGINT)

disk._write_set = written
"""
"""An interrupt at the end of a write."""


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ["example", "room", "--out", "made"],
        ["study", "--realisations", "9", "--trials", "9", "--out", "made"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_command_that_has_written_names_its_files(arguments: list[str], tmp_path: Path) -> None:
    """Exporting returned 130, without a word, with its file in place."""
    done = subprocess.run(
        [sys.executable, "-c", WRITTEN + STARTED, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 130
    _, _, names = done.stderr.strip().partition("rtcal: interrupted; written last, or begun: ")
    assert names
    assert {*names.split(", ")} <= {path.name for path in tmp_path.rglob("*")}
