"""The closed loop with a program that a user runs by hand, from one command to the next.

Each step leaves two files: the state of the loop, and the room to simulate. The room states the digest
of its coefficients, so that a table simulated with other coefficients is refused.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.measurement_files import MAX_BYTES
from rtcal.acoustics.room import Room
from rtcal.loop.state import Loop
from rtcal.support.errors import DataError
from rtcal.support.files import read_text, write_all
from rtcal.support.types import Array

_COEFFICIENTS = re.compile(r"^#\s*Coefficients ([0-9a-f]{12})\b", re.M)


def refuse_progress(state: str) -> None:
    """Raise DataError if the state at this path already holds simulations."""
    if Path(state).exists() and (n := len(Loop.load(state).steps)):
        raise DataError(
            f"{state} holds {n} simulation{'s' * (n > 1)} of a loop: delete it to begin anew, or name "
            "another state"
        )


def record(loop: Loop, table: str, state: str, out: str, *, again: bool = False) -> Loop:
    """Return the loop after the simulation that the file ``table`` holds.

    Parameters
    ----------
    loop : Loop
        As read from the file ``state``.
    table, state, out : str
        Paths of the simulated table, the state and the room that was to be simulated.
    again : bool
        Whether to accept a table with the same T20 as the last step's, or at first as the measured T.

    Raises
    ------
    DataError
        If the loop is finished, the table is no measurement, or it repeats the last step's or has the
        measured T itself. Also if the table belongs to other coefficients, as far as the files show.
    """
    if loop.finished:
        raise DataError(
            f"{state}: the loop is done, so {table} was not taken in; the room that `rtcal loop "
            "next` wrote last has the coefficients, and `rtcal report` shows the path"
        )
    simulated = Measurement.from_file(table)
    alpha = loop.next_alpha
    _refuse_other_coefficients(alpha, table, state, out)
    if not again and not loop.steps and loop.matched.gives(simulated, loop.wanted):
        raise DataError(
            f"{table}: every T20 is the measured one to the last digit: is it the measurement itself, "
            "and not what was simulated? (--again takes it all the same)"
        )
    if not again and loop.repeats(alpha, simulated):
        raise DataError(
            f"{table}: the table is the last step's, though alpha changed: was the room that was "
            "written last simulated? (--again takes it all the same)"
        )
    try:
        return loop.record(alpha, simulated)
    except DataError as error:
        raise DataError(f"{table}: {error}") from error


def write(loop: Loop, state: str, out: str) -> None:
    """Write the state and the room to simulate: both files or none.

    A state without its room would accept a table that belongs to the room of the step before.
    """
    room = loop.room.replace(alpha=loop.next_alpha, calibration=None)
    digest = _digest(room.alpha)
    n, of = len(loop.steps), f"of the loop in {Path(state).name!r}"
    note = f"# To simulate: run {n + 1} {of}.\n"
    if n and loop.finished:
        note = f"# Calibrated for the program simulated: the end {of}, after {n} runs.\n"
    note += f"# Coefficients {digest}.\n"
    content = note + room.to_text(Path(out).parent)
    write_all({out: content.encode(), state: loop.to_json().encode()})


def conclusion(loop: Loop, out: str) -> str:
    """Return what a user does with the last room written, for a finished loop."""
    left = len([s for s in loop.status if s not in ("converged", "no measured T")])
    missed = f", but {left} of {loop.room.n_bands} bands were not reached" if left else ""
    return (
        f"Done{missed}. {out} has the coefficients, those of each band's best step: give it to the "
        "program a last time."
    )


def _refuse_other_coefficients(alpha: Array, table: str, state: str, out: str) -> None:
    """Raise DataError if the table belongs to other coefficients, as far as the files show.

    Two files may show it: the room at ``out`` holds the coefficients themselves, and a table may repeat
    the room's line "# Coefficients ...".
    """
    asked = _digest(alpha)
    stated = _COEFFICIENTS.search(read_text(table, MAX_BYTES))
    if stated is not None and stated[1] != asked:
        raise DataError(f"{table}: it is of the coefficients {stated[1]}; {state} asks for {asked}")
    try:
        last_written = Room.from_file(out)
    except DataError:
        return  # another name than last time, or no room: it shows nothing
    if _digest(last_written.alpha) != asked:
        raise DataError(
            f"{out}: it has other coefficients than {state} asks for, so {table} may be of those: "
            f"rtcal loop back writes what to simulate; or delete {out} if it was not simulated"
        )


def _digest(alpha: Array) -> str:
    """Return a short identifier of coefficients, (n_materials, n_bands), to nine decimals."""
    rounded = np.round(alpha, 9) + 0.0  # no -0
    return hashlib.sha256(repr(rounded.shape).encode() + rounded.tobytes()).hexdigest()[:12]
