"""Any program as a simulator: a Python callable, or a command that exchanges files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement, plausible_time
from rtcal.acoustics.room import Room
from rtcal.errors import DataError, SimulatorError, of_bands
from rtcal.simulators.base import check_alpha
from rtcal.support import checks
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class External:
    """Calls a function that knows how to run another program.

    Parameters
    ----------
    room : Room
        Whose materials and bands the rows and columns of alpha are.
    run : callable
        Alpha (n_materials, n_bands) and a seed in; out comes a `Measurement` in the room's bands,
        or T20 in s, (n_bands,).
    name : str
        Calibrated coefficients belong to the program of this name.
    deterministic : bool
        Whether the seed changes nothing.
    time_limit : float, optional
        s; beyond it `SimulatorError`. Python cannot end the function: a thread stays behind until
        it returns. Give a `command` its own limit, which ends the program.

    Examples
    --------
    >>> import numpy as np
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> program = External(room=room, run=lambda alpha, seed: 0.11 / alpha[0], name="reverb 3000")
    >>> print(program.simulate(room.alpha).values["t20"])
    [[0.55]]
    """

    room: Room
    run: Callable[[Array, int], Measurement | Array | Sequence[float]]
    name: str
    deterministic: bool = True
    time_limit: float | None = None

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        if not callable(self.run):
            raise DataError(f"run = {self.run!r} cannot be called")
        if not text_name("name", self.name).strip():
            raise DataError('name = "" is empty: coefficients belong to the program of this name')
        if not isinstance(self.deterministic, bool):
            raise DataError(f"deterministic = {self.deterministic!r} is not True or False")
        if self.time_limit is not None:
            checks.positive("time_limit", self.time_limit, "s")

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials: rows of alpha."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """The room's bands in Hz: columns of alpha."""
        return self.room.centre_frequencies

    @property
    def smooth(self) -> bool:
        """Taken for smooth where it is deterministic."""
        return self.deterministic

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return what the program makes of alpha.

        Raises
        ------
        SimulatorError
            If it outlives the time limit, or returns anything but a `Measurement` or n_bands finite
            times above 0. What it raises itself is passed on.
        """
        alpha = check_alpha(self, alpha)
        found = self._within_time_limit(lambda: self.run(alpha.copy(), seed))
        if isinstance(found, Measurement):
            return found
        try:
            times = np.array(found)
        except (TypeError, ValueError) as error:
            raise SimulatorError(
                f"{self.name} returned {type(found).__name__}, neither a Measurement nor times"
            ) from error
        if times.dtype.kind not in "iuf":
            raise SimulatorError(
                f"{self.name} returned {type(found).__name__} of {times.dtype}, neither a "
                "Measurement nor times"
            )
        times = times.astype(float)
        if times.shape != (self.room.n_bands,):
            raise SimulatorError(
                f"{self.name} returned T20 of shape {times.shape}; the room's bands ask for "
                f"({self.room.n_bands},)"
            )
        if not (good := np.isfinite(times) & (times > 0)).all():
            none = SimulatorError(
                f"{self.name} returned T20 = {times.tolist()} s; each is a finite time above 0"
            )
            raise of_bands(none, np.flatnonzero(~good))
        for f, time in zip(self.centre_frequencies, times, strict=True):
            try:
                plausible_time(f"T20[{label(f)}]", float(time))
            except DataError as error:
                raise SimulatorError(f"{self.name} returned {error}") from error
        return Measurement.from_values(self.centre_frequencies, t20=times)

    def _within_time_limit(self, call: Callable[[], object]) -> object:
        if self.time_limit is None:
            return call()
        outcome: list[object] = []
        failure: list[BaseException] = []

        def work() -> None:
            try:
                outcome.append(call())
            except BaseException as error:  # raised again where the caller can see it
                failure.append(error)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        thread.join(self.time_limit)
        if failure:
            raise failure[0]
        if not outcome:
            raise SimulatorError(f"{self.name} ran for longer than {self.time_limit:g} s")
        return outcome[0]


def command(
    arguments: Sequence[str], room: Room, time_limit: float | None = None
) -> Callable[[Array, int], Measurement]:
    """Return a ``run`` for `External` that starts a program and exchanges files with it.

    The program is started as ``arguments + [room file, measurement file, seed]``: it reads the room
    with the new coefficients (TOML) and writes the measurement (CSV; both in rtcal's own formats).

    Parameters
    ----------
    arguments : sequence of str
        The program and what comes before the files.
    room : Room
    time_limit : float, optional
        s; beyond it the program is ended, and whatever it started itself with it.

    Raises
    ------
    DataError
        For arguments that are no texts, or a limit that is not above 0.
    SimulatorError
        From the returned function: if the program cannot be started, ends with another status than
        0, outlives ``time_limit``, or writes no measurement or one that cannot be read.
    """
    checks.instance("room", room, Room)
    started = list(checks.listed("arguments", arguments))
    if not started or not started[0]:
        raise DataError(f"arguments = {started!r} names no program")
    for argument in started:
        if not isinstance(argument, str | os.PathLike):
            raise DataError(f"arguments has {argument!r}, which is not a text")
    if time_limit is not None:
        checks.positive("time_limit", time_limit, "s")

    def run(alpha: Array, seed: int) -> Measurement:
        with tempfile.TemporaryDirectory(prefix="rtcal-") as folder:
            given, found = Path(folder, "room.toml"), Path(folder, "measured.csv")
            room.replace(alpha=alpha, calibration=None).save(str(given))
            line = [*map(os.fspath, started), str(given), str(found), str(seed)]
            status, errors = _ended(line, time_limit)
            if status:
                said = errors.strip().splitlines()[-1:] or ["nothing on its error output"]
                raise SimulatorError(f"{line[0]} ended with status {status}: {said[0]}")
            if not found.exists():
                raise SimulatorError(f"{line[0]} wrote no {found.name}")
            try:
                return Measurement.from_file(str(found))
            except DataError as error:
                why = str(error).replace(str(found), found.name)
                raise SimulatorError(f"{line[0]} wrote no measurement: {why}") from error

    return run


def _ended(line: list[str], time_limit: float | None) -> tuple[int, str]:
    """Run a program to its end; return its status and error output.

    In a session of its own, so that it can be ended together with what it started: else a program
    behind a shell script would run on.
    """
    try:
        program = subprocess.Popen(
            line,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        raise SimulatorError(f"{line[0]} cannot be started: {error}") from error
    with program:
        try:
            errors = program.communicate(timeout=time_limit)[1]
        except BaseException as error:  # too long, or the user interrupts
            _end(program)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            raise SimulatorError(f"{line[0]} ran for longer than {time_limit:g} s") from error
    return program.returncode, errors


def _end(program: subprocess.Popen[str]) -> None:
    """End a program and what it started."""
    if sys.platform == "win32":
        subprocess.run(
            ["taskkill", "/F", "/T", "/PID", str(program.pid)], capture_output=True, check=False
        )
    else:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
