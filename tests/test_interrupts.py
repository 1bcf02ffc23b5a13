"""Ctrl-C at random moments of a study: no traceback, and what was written is whole."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

STARTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import rtcal.__main__ as m; print('started', flush=True); m.main()
"""
"""The command as a terminal starts it. A shell's background job, and its children, ignore SIGINT."""
NOTHING = "rtcal: interrupted; nothing was written\n"


def interrupted(folder: Path, seconds: float) -> int:
    """Return the exit code of a study that is interrupted after some seconds."""
    there = files_below(folder)
    size = ["--realisations", "300", "--trials", "100", "--sigma-r", "0.05"]
    places = ["--out", str(folder / "made")]
    process = subprocess.Popen(
        [sys.executable, "-c", STARTED, "study", "--kind", "shoebox", *size, *places],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    # Python prints one of its own where the signal falls into an import lock's clean-up.
    ours = said if "Exception ignored in: <function _get_module_lock" not in said else ""
    assert "Traceback" not in ours, said
    # The signal itself where Python is already on its way out.
    assert process.returncode in (0, 130, -signal.SIGINT), (process.returncode, said)
    if process.returncode == 130:  # one line, and "nothing" alone where nothing was written
        assert ours.splitlines()[-1].startswith("rtcal: interrupted; "), said
        assert not ours.endswith(NOTHING) or files_below(folder) == there
    written = sorted(p.name for p in (folder / "made").glob("[!.]*"))
    assert len(written) in (0, 7), written
    return process.returncode


def files_below(folder: Path) -> dict[Path, float]:
    """Return when each file below a folder was written."""
    return {path: path.stat().st_mtime for path in folder.rglob("*") if path.is_file()}


def check(tmp_path: Path, times: int, longest: float) -> list[int]:
    rng = random.Random(5)
    codes = [interrupted(tmp_path, rng.uniform(0, longest)) for _ in range(times)]
    return codes


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


@pytest.mark.long
def test_interrupts_at_random_moments(tmp_path: Path) -> None:
    assert 130 in check(tmp_path, 3, 0.8)
