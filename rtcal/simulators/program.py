"""Another program as the function of an `External`: it exchanges files with rtcal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError, SimulatorError
from rtcal.support.text import printable
from rtcal.support.types import Array

KEPT_ERRORS = 2**16
"""Number of bytes at the end of a program's error output that are kept."""
QUOTED_ERRORS = 300
"""Number of characters of the last line of error output that a message quotes."""
MARK = "RTCAL_PROGRAM"
"""Environment variable of a started program. The processes it starts inherit the variable."""

_LAST_OUTPUT = 1.0  # s; longest wait for a pipe that a child of the ended program keeps open
_PASSES = 20  # a process may start another one while it is being ended
_BETWEEN_PASSES = 0.02  # s


def command(
    arguments: Sequence[str], room: Room, time_limit: float | None = None
) -> Callable[[Array, int], Measurement]:
    r"""Return a ``run`` for `External` that starts a program and exchanges files with it.

    The program is started as ``arguments + [room file, measurement file, seed]``. It reads the room
    with the new coefficients (TOML) and writes the measurement (CSV), both in rtcal's own formats.

    Parameters
    ----------
    arguments : sequence of str
        The program and its first arguments.
    room : Room
    time_limit : float, optional
        Limit in s. A program that exceeds it is ended together with the processes it started. On
        Linux these are all that inherited its environment. Elsewhere a process that left the
        program's session (macOS) or process tree (Windows) runs on.

    Raises
    ------
    DataError
        For arguments that are not texts, or a limit that is not above 0.
    SimulatorError
        From the returned function: if the program cannot be started, ends with a status other than
        0, exceeds the limit, or writes no measurement.

    Examples
    --------
    >>> import sys
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> script = '''import sys, pathlib
    ... table = "source,receiver,parameter,band,value\\nS1,R1,T20,1000,0.55"
    ... pathlib.Path(sys.argv[2]).write_text(table)'''
    >>> run = command([sys.executable, "-c", script], room, time_limit=60)
    >>> print(run(room.alpha, 0).values["t20"])
    [[0.55]]
    """
    checks.instance("room", room, Room)
    started = list(checks.listed("arguments", arguments))
    for argument in started:
        if not isinstance(argument, str | os.PathLike):
            raise DataError(f"arguments has {argument!r}, which is not a text")
    if not started or not started[0]:
        raise DataError(f"arguments = {started!r} names no program")
    if time_limit is not None:
        checks.positive("time_limit", time_limit, "s")

    def run(alpha: Array, seed: int) -> Measurement:
        with tempfile.TemporaryDirectory(prefix="rtcal-") as folder:
            room_file, measured_file = Path(folder, "room.toml"), Path(folder, "measured.csv")
            room.replace(alpha=alpha, calibration=None).save(str(room_file))
            line = [*map(os.fspath, started), str(room_file), str(measured_file), str(seed)]
            status, errors = _run(line, time_limit)
            if status:
                raise SimulatorError(f"{line[0]} ended with status {status}: {errors}")
            if not measured_file.exists():
                raise SimulatorError(f"{line[0]} wrote no {measured_file.name}")
            try:
                return Measurement.from_file(str(measured_file))
            except DataError as error:
                reason = str(error).replace(str(measured_file), measured_file.name)
                raise SimulatorError(f"{line[0]} wrote no measurement: {reason}") from error

    return run


def _run(line: list[str], time_limit: float | None) -> tuple[int, str]:
    """Run a program to its end; return its status and the last line of its error output."""
    mark = uuid.uuid4().hex
    try:
        program = subprocess.Popen(
            line,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, MARK: mark},
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        raise SimulatorError(f"{line[0]} cannot be started: {error}") from error
    errors = _Tail(program)
    try:
        status = program.wait(time_limit)
    except BaseException as error:  # the limit, or the user interrupts
        survivors = _end(program, mark)
        if not isinstance(error, subprocess.TimeoutExpired):
            raise
        left = f"; processes {survivors} could not be ended" if survivors else ""
        raise SimulatorError(f"{line[0]} ran for longer than {time_limit:g} s{left}") from error
    return status, errors.last_line()


class _Tail:
    """The end of a program's error output. A thread reads all of it, so no program blocks."""

    def __init__(self, program: subprocess.Popen[bytes]) -> None:
        self._bytes = b""
        self._thread = threading.Thread(target=self._read, args=(program.stderr,), daemon=True)
        self._thread.start()

    def _read(self, stream: IO[bytes]) -> None:
        with stream:
            while block := os.read(stream.fileno(), KEPT_ERRORS):
                self._bytes = (self._bytes + block)[-KEPT_ERRORS:]

    def last_line(self) -> str:
        """Return the last line, shortened; a child of the ended program may keep the stream open."""
        self._thread.join(_LAST_OUTPUT)
        lines = self._bytes.decode(errors="replace").strip().splitlines()
        text = printable(lines[-1]).strip() if lines else "nothing on its error output"
        return text if len(text) <= QUOTED_ERRORS else text[:QUOTED_ERRORS] + " ..."


def _end(program: subprocess.Popen[bytes], mark: str) -> list[int]:
    """End a program and the processes it started; return the numbers of those that remain."""
    if sys.platform == "win32":
        subprocess.run(
            ["taskkill", "/F", "/T", "/PID", str(program.pid)], capture_output=True, check=False
        )
        program.wait()
        return []
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(program.pid, signal.SIGKILL)
    program.wait()
    for _ in range(_PASSES):
        remaining = _marked(mark)
        if not remaining:
            return []
        for number in remaining:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(number, signal.SIGKILL)
        time.sleep(_BETWEEN_PASSES)
    return _marked(mark)


def _marked(mark: str) -> list[int]:
    """Return the processes with the mark in their environment (Linux; elsewhere none)."""
    variable = f"{MARK}={mark}".encode()
    numbers = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if variable in environment.read_bytes().split(b"\0"):
                numbers.append(int(environment.parent.name))
    return numbers
