"""``rtcal loop start`` and ``next``: the closed loop with a program that is run by hand."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import (
    equation_option,
    json_option,
    method_option,
    quiet_option,
    tell,
)
from rtcal.errors import DataError
from rtcal.support.files import spare
from rtcal.support.transaction import locked

if TYPE_CHECKING:
    from rtcal.loop.state import Loop
    from rtcal.support.types import Array


def _holding_state(command: Callable[..., None]) -> Callable[..., None]:
    """Hold the state's folder from reading to writing: two commands at once would lose a step."""

    @functools.wraps(command)
    def held(*, state: str, **arguments: Any) -> None:
        folder = Path(state).resolve().parent
        with locked(folder) if folder.is_dir() else nullcontext():
            command(state=state, **arguments)

    return held


@click.group(short_help="The closed loop with a program that is run by hand.")
def loop() -> None:
    """Calibrate a program run by hand (CATT, ODEON): start, simulate, next, simulate, ..."""


@loop.command(short_help="Begin: write what to simulate first.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option("--state", type=click.Path(dir_okay=False), required=True, help="State to write.")
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@method_option
@equation_option
@click.option(
    "--rule",
    type=click.Choice(("secant", "safeguarded", "regression")),
    default="safeguarded",
    show_default=True,
    help="How the next target is found; see docs/closed_loop.md.",
)
@click.option(
    "--decimals", type=click.IntRange(1), help="Decimals of alpha that the program reads."
)
@json_option
@quiet_option
@_holding_state
def start(
    room: str,
    measured: str,
    state: str,
    out: str,
    method: str,
    equation: LinearEquation,
    rule: str,
    decimals: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write ROOM (TOML) with the coefficients to simulate first, for MEASURED (CSV).

    A state that holds simulations is not written over: delete it to begin anew.

    Example: rtcal loop start room.toml t.csv --state loop.json --out next.toml --decimals 2
    """
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.calibration.measured import times_in_room
    from rtcal.loop.state import start as begin

    spare([state, out], [room, measured])
    _refuse_progress(state)
    data = Measurement.from_file(measured)
    begun = begin(
        Room.from_file(room),
        data,
        rule=rule,  # type: ignore[arg-type]
        method=method,
        equation=equation,
        decimals=decimals,
    )
    first = begun.calibrated(begun.wanted)
    _write(begun, state, out)
    beyond = [f"{band} (the nearest is taken)" for band in first.unreachable]
    taken = [p.upper() for p in sorted(set(times_in_room(begun.room, data).parameter)) if p]
    record = {"state": state, "simulate": out, "unreachable": beyond, "measured": taken}
    lines = [f"Measured T: {' and '.join(taken)}.", *beyond, f"Simulate {out} first."]
    tell("\n".join(lines), record, quiet=quiet, as_json=as_json)


@loop.command(name="next", short_help="Go on: take in what was simulated.")
@click.argument("room", type=click.Path())
@click.argument("simulated", type=click.Path())
@click.option(
    "--state", type=click.Path(dir_okay=False), required=True, help="State to go on from."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@click.option(
    "--again", is_flag=True, help="Take a table that is the last step's: T depends not on alpha."
)
@json_option
@quiet_option
@_holding_state
def next_(
    room: str, simulated: str, state: str, out: str, again: bool, as_json: bool, quiet: bool
) -> None:
    """Take in what the program SIMULATED (CSV) and write what to simulate next.

    ROOM is the file that `start` was given. `rtcal report STATE` shows the path so far, `rtcal loop
    back` takes the last step back.

    Example: rtcal loop next room.toml simulated.csv --state loop.json --out next.toml
    """
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.quality import explained
    from rtcal.acoustics.room import Room
    from rtcal.loop.state import Loop

    spare([state, out], [room, simulated])
    going = Loop.load(state, Room.from_file(room))
    if going.finished:
        raise DataError(
            f"{state}: the loop is done, so {simulated} was not taken in; the room that `rtcal loop "
            "next` wrote last has the coefficients, and `rtcal report` shows the path"
        )
    found = Measurement.from_file(simulated)
    alpha = going.next_alpha
    _refuse_other_coefficients(alpha, simulated, state, out)
    if not again and going.repeats(alpha, found):
        raise DataError(
            f"{simulated}: the table is the last step's, though alpha changed: was the room that was "
            "written last simulated? (--again takes it all the same)"
        )
    try:
        going = going.record(alpha, found)
    except DataError as error:
        raise DataError(f"{simulated}: {error}") from error
    _write(going, state, out)
    finished, frequencies = going.finished, going.room.centre_frequencies
    said = ["not yet" if s == "not converging" and not finished else s for s in going.status]
    lines = [
        f"{frequency:7g} Hz  {'-' if gap != gap else format(gap, '+.2f'):>6} JND  {status}"
        for frequency, gap, status in zip(frequencies, going.gap, said, strict=True)
    ]
    lines += explained(going.trust_marks)
    lines.append(_end(going, out) if finished else f"Simulate {out} next.")
    record = {
        "finished": finished,
        "state": state,
        "simulate": out,
        "centre_frequencies": frequencies,
        "gap_jnd": going.gap,
        "status": said,
        "trust_marks": [vars(mark) for mark in going.trust_marks],
    }
    tell("\n".join(lines), record, quiet=quiet, as_json=as_json)


@loop.command(short_help="Take the last step back.")
@click.argument("room", type=click.Path())
@click.option(
    "--state", type=click.Path(dir_okay=False), required=True, help="State to go back from."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@json_option
@quiet_option
@_holding_state
def back(room: str, state: str, out: str, as_json: bool, quiet: bool) -> None:
    """Forget the table that `next` took in last, and write what it should have been simulated with.

    Example: rtcal loop back room.toml --state loop.json --out next.toml
    """
    from rtcal.acoustics.room import Room
    from rtcal.loop.state import Loop

    spare([state, out], [room])
    going = Loop.load(state, Room.from_file(room)).back()
    _write(going, state, out)
    record = {"simulations": len(going.steps), "state": state, "simulate": out}
    text = f"{len(going.steps)} simulations left in {state}. Simulate {out} next."
    tell(text, record, quiet=quiet, as_json=as_json)


def _refuse_other_coefficients(alpha: Array, simulated: str, state: str, out: str) -> None:
    """Raise DataError where what was simulated belongs to other coefficients, as far as is known.

    The state says what it asked for, the room at ``out`` what was to be simulated, and a table may
    repeat the room's line "# Coefficients ...".
    """
    from rtcal.acoustics.room import Room
    from rtcal.loop import files
    from rtcal.support.files import read_text

    asked = files.coefficients_digest(alpha)
    if files.read(state).get("coefficients", asked) != asked:
        raise DataError(
            f"{state}: it asked for other coefficients than this version of rtcal does: take the last "
            "table back (rtcal loop back) and in again, or begin anew"
        )
    stated = re.search(r"^#\s*Coefficients ([0-9a-f]{12})\b", read_text(simulated, 2**21), re.M)
    if stated is not None and stated[1] != asked:
        raise DataError(
            f"{simulated}: it is of the coefficients {stated[1]}; {state} asks for {asked}"
        )
    try:
        there = Room.from_file(out)
    except DataError:
        return  # another name than last time, or no room: nothing is known
    if files.coefficients_digest(there.alpha) != asked:
        raise DataError(
            f"{out}: it has other coefficients than {state} asks for, so {simulated} may be of those: "
            f"rtcal loop back writes what to simulate; or delete {out} if it was not simulated"
        )


def _refuse_progress(state: str) -> None:
    """Raise DataError instead of overwriting a state that already holds simulations."""
    from rtcal.loop.state import Loop

    if Path(state).exists() and (n := len(Loop.load(state).steps)):
        raise DataError(
            f"{state} holds {n} simulation{'s' * (n > 1)} of a loop: delete it to begin anew, or name "
            "another state"
        )


def _end(going: Loop, out: str) -> str:
    """What to do with the last room that is written."""
    left = len([s for s in going.status if s not in ("converged", "no measured T")])
    missed = f", but {left} of {going.room.n_bands} bands were not reached" if left else ""
    return (
        f"Done{missed}. {out} has the coefficients, those of each band's best step: give it to the "
        "program a last time."
    )


def _write(going: Loop, state: str, out: str) -> None:
    """Both files or none: a state without its room would take in what was not simulated."""
    from rtcal.loop import files
    from rtcal.support.files import write_all

    room = going.room.replace(alpha=going.next_alpha, calibration=None)
    digest = files.coefficients_digest(room.alpha)
    n, of = len(going.steps), f"of the loop in {Path(state).name!r}"
    note = f"# To simulate: run {n + 1} {of}.\n"
    if n and going.finished:
        note = f"# Calibrated for the program simulated: the end {of}, after {n} runs.\n"
    note += f"# Coefficients {digest}.\n"
    content = files.text({**going.to_dict(), "coefficients": digest})
    write_all({out: (note + room.to_text()).encode(), state: content.encode()})
