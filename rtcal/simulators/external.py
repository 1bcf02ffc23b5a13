"""A Python function, another program that exchanges files, or an equation as a simulator."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.equations import Equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.room import Room
from rtcal.files import disk
from rtcal.simulators.base import RoomSimulator, check_alpha
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError, SimulatorError, of_bands
from rtcal.support.text import printable
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class External(RoomSimulator):
    """Simulator that calls your function, for example to run another simulation program.

    Parameters
    ----------
    room : Room
        Room whose materials and bands the coefficients have.
    run : callable
        Function ``run(alpha, seed)`` that returns a `Measurement` in the room's bands, or T20 in s,
        (n_bands,). ``alpha`` are the coefficients, (n_materials, n_bands), read-only.
    name : str
        Name of the program; calibrated coefficients are valid only for it.
    deterministic : bool
        Whether the result does not depend on the seed.

    Raises
    ------
    DataError
        For an argument of a wrong type, or an empty name.

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

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        if not callable(self.run):
            raise DataError(f"run = {self.run!r} must be a function")
        if not text_name("name", self.name).strip():
            raise DataError(
                'name = "" is empty: give the name of the program, to which the coefficients belong'
            )
        checks.flag("deterministic", self.deterministic)

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return what the function ``run`` gives for ``alpha`` (n_materials, n_bands) and ``seed``.

        Raises
        ------
        DataError
            For coefficients of a wrong shape or not from 0 to 1, or a negative seed.
        SimulatorError
            If the function calls ``sys.exit``, or returns neither a `Measurement` nor n_bands finite
            times above 0. Other exceptions of the function are not changed.
        """
        alpha, seed = check_alpha(self, alpha), checks.whole("seed", seed, 0)
        try:
            answer = self.run(alpha, seed)
        except SystemExit as error:
            raise SimulatorError(f"{self.name} called sys.exit({error.code!r})") from error
        if isinstance(answer, Measurement):
            return answer
        return Measurement.from_values(self.centre_frequencies, **{TARGET.key: self._times(answer)})

    def _times(self, answer: object) -> Array:
        """Return the answer as T20 in s, (n_bands,); SimulatorError if it is anything else."""
        try:
            times = checks.shaped(f"{self.name} returned T20, which", answer, self.room.n_bands)
        except DataError as error:
            raise SimulatorError(
                f"{error}; it must return a Measurement, or a time in s per band"
            ) from error
        if not (valid := np.isfinite(times) & (times > 0)).all():
            bad = SimulatorError(
                f"{self.name} returned T20 = {times.tolist()} s; each must be a finite time above 0"
            )
            raise of_bands(bad, np.flatnonzero(~valid))
        for frequency, seconds in zip(self.centre_frequencies, times, strict=True):
            try:
                TARGET.refuse(f"{TARGET.label}[{label(frequency)}]", float(seconds))
            except DataError as error:
                raise SimulatorError(f"{self.name} returned {error}") from error
        return times


KEPT_ERRORS = 2**16
"""Largest number of bytes that are read from the end of a program's error output."""
QUOTED_ERRORS = 300
"""Largest number of characters of the last line of error output in a message."""


def command(
    arguments: Sequence[str], room: Room, time_limit: float | None = None
) -> Callable[[Array, int], Measurement]:
    r"""Return a function for `External` that runs a program, which reads and writes files.

    The program is started as ``arguments + [room file, measurement file, seed]``. It must read the room
    with the new coefficients (TOML) and write the measurement (CSV), both in rtcal's formats.

    Parameters
    ----------
    arguments : sequence of str
        The program and its first arguments.
    room : Room
        Room whose coefficients change.
    time_limit : float, optional
        Longest time in s that the program may take. After it the program is ended, and all processes
        that it started, except daemons and others that have a separate session.

    Raises
    ------
    DataError
        For arguments that are no texts, or a time limit that is not above 0.
    SimulatorError
        By the returned function, if the program cannot be started, ends with a status other than 0,
        exceeds the time limit, or writes no measurement.

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
            raise DataError(f"arguments has {argument!r}; every argument must be a text")
    if not started or not started[0]:
        raise DataError(f"arguments = {started!r} is empty: give the program first")
    if time_limit is not None:
        checks.positive("time_limit", time_limit, "s")

    def run(alpha: Array, seed: int) -> Measurement:
        with disk.at_once(), tempfile.TemporaryDirectory(prefix="rtcal-") as folder:
            room_file, measured_file = Path(folder, "room.toml"), Path(folder, "measured.csv")
            room.replace(alpha=alpha, calibration=None).save(str(room_file))
            line = [*map(os.fspath, started), str(room_file), str(measured_file), str(seed)]
            status, errors = _run(line, time_limit)
            if status:
                raise SimulatorError(f"{line[0]} ended with status {status}: {errors}")
            if not measured_file.exists():
                raise SimulatorError(f"{line[0]} did not write {measured_file.name}")
            try:
                return Measurement.from_file(str(measured_file))
            except DataError as error:
                reason = str(error).replace(str(measured_file), measured_file.name)
                raise SimulatorError(f"{line[0]} did not write a measurement: {reason}") from error

    return run


def _run(line: list[str], time_limit: float | None) -> tuple[int, str]:
    """Run a program to its end; return its status and the last line of its error output."""
    with tempfile.TemporaryFile() as output:
        try:
            program = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=output,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise SimulatorError(f"{line[0]} cannot be started: {error}") from error
        try:
            status = program.wait(time_limit)
        except BaseException as error:  # the limit, or the user interrupts
            _end(program)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            raise SimulatorError(f"{line[0]} ran for longer than {time_limit:g} s") from error
        return status, _last_line(output)


def _last_line(output: IO[bytes]) -> str:
    """Return the last line of a program's error output, shortened."""
    output.seek(max(output.seek(0, os.SEEK_END) - KEPT_ERRORS, 0))
    lines = output.read().decode(errors="replace").strip().splitlines()
    text = printable(lines[-1]).strip() if lines else "nothing on its error output"
    return text if len(text) <= QUOTED_ERRORS else text[:QUOTED_ERRORS] + " ..."


def _end(program: subprocess.Popen[bytes]) -> None:
    """End a program and the processes of its session."""
    if sys.platform == "win32":
        tree = ["taskkill", "/F", "/T", "/PID", str(program.pid)]
        subprocess.run(tree, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(program.pid, signal.SIGKILL)
    program.wait()


def of_equation(equation: Equation, room: Room) -> External:
    """Return a simulator whose T is that of a reverberation equation.

    With it `rtcal.calibrate_simulator` can use equations that `rtcal.calibrate` cannot, such as
    Fitzroy's. Raises DataError if nothing absorbs, and for an object that is no equation.

    Examples
    --------
    >>> from rtcal.acoustics.equations import Eyring
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(of_equation(Eyring(speed_of_sound=343), room).simulate(room.alpha).values["t20"].round(4))
    [[0.5484]]
    """
    if isinstance(equation, type) or not isinstance(equation, Equation):
        raise DataError(f"equation = {equation!r} must be an Equation")
    name = f"{equation.name}'s equation for {checks.instance('room', room, Room).name}"

    def run(alpha: Array, seed: int) -> Measurement:
        times = equation.reverberation_time(room.replace(alpha=alpha, calibration=None))
        if not (finite := np.isfinite(times)).all():
            error = DataError(f"{name} has no finite T: nothing absorbs")
            raise of_bands(error, np.flatnonzero(~finite))
        return Measurement.from_values(room.centre_frequencies, **{TARGET.key: times})

    return External(room=room, run=run, name=name)
