"""``rtcal loop start`` and ``next``: the closed loop with a program that is run by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rtcal.acoustics.files import spare
from rtcal.console import json_option, quiet_option, tell
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.closed_loop import Loop


@click.group(short_help="The closed loop with a program that is run by hand.")
def loop() -> None:
    """Calibrate a program run by hand (CATT, ODEON): start, simulate, next, simulate, ..."""


@loop.command(short_help="Begin: write what to simulate first.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option("--state", type=click.Path(dir_okay=False), required=True, help="State to write.")
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@click.option(
    "--method", default="mle", show_default=True, help="mle, lse, soft, smooth or robust."
)
@click.option(
    "--rule", type=click.Choice(("secant", "safeguarded", "regression")), default="safeguarded",
    show_default=True, help="How the next target is found; see docs/closed_loop.md.",
)  # fmt: skip
@click.option(
    "--decimals", type=click.IntRange(1), help="Decimals of alpha that the program reads."
)
@json_option
@quiet_option
def start(
    room: str,
    measured: str,
    state: str,
    out: str,
    method: str,
    rule: str,
    decimals: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write ROOM (TOML) with the coefficients to simulate first, for MEASURED (CSV).

    Example: rtcal loop start room.toml t.csv --state loop.json --out next.toml --decimals 2
    """
    from rtcal import closed_loop
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room

    spare([state, out], [room, measured])
    begun = closed_loop.start(
        Room.from_file(room), Measurement.from_file(measured), rule=rule,  # type: ignore[arg-type]
        method=method, decimals=decimals,
    )  # fmt: skip
    first = begun.calibrated(begun.wanted)
    _write(begun, state, out)
    beyond = [f"{band} (the nearest is taken)" for band in first.unreachable]
    record = {"state": state, "simulate": out, "unreachable": beyond}
    tell("\n".join([*beyond, f"Simulate {out} first."]), record, quiet=quiet, as_json=as_json)


@loop.command(name="next", short_help="Go on: take in what was simulated.")
@click.argument("room", type=click.Path())
@click.argument("simulated", type=click.Path())
@click.option(
    "--state", type=click.Path(dir_okay=False), required=True, help="State to go on from."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@json_option
@quiet_option
def next_(room: str, simulated: str, state: str, out: str, as_json: bool, quiet: bool) -> None:
    """Take in what the program SIMULATED (CSV) and write what to simulate next.

    ROOM is the file that `start` was given. `rtcal report STATE` shows the path so far.

    Example: rtcal loop next room.toml simulated.csv --state loop.json --out next.toml
    """
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.closed_loop import Loop

    spare([state, out], [room, simulated])
    going = Loop.load(state, Room.from_file(room))
    if going.finished:
        raise DataError(
            f"{state}: the loop is done, so {simulated} was not taken in; the room that `rtcal loop "
            "next` wrote last has the coefficients, and `rtcal report` shows the path"
        )
    found = Measurement.from_file(simulated)
    try:
        going = going.record(going.next_alpha, found)
    except DataError as error:
        raise DataError(f"{simulated}: {error}") from error
    _write(going, state, out)
    finished, frequencies = going.finished, going.room.centre_frequencies
    said = ["not yet" if s == "not converging" and not finished else s for s in going.status]
    lines = [
        f"{frequency:7g} Hz  {gap:+6.2f} JND  {status}"
        for frequency, gap, status in zip(frequencies, going.gap, said, strict=True)
    ]
    lines.append("Done." if finished else f"Simulate {out} next.")
    record = {
        "finished": finished, "state": state, "simulate": out,
        "centre_frequencies": frequencies, "gap_jnd": going.gap, "status": said,
    }  # fmt: skip
    tell("\n".join(lines), record, quiet=quiet, as_json=as_json)


def _write(going: Loop, state: str, out: str) -> None:
    """Both files or none: a state without its room would take in what was not simulated."""
    from rtcal.acoustics.files import write_all
    from rtcal.acoustics.room_files import room_text

    room = going.room.replace(alpha=going.next_alpha, calibration=None)
    write_all({out: room_text(room).encode(), state: going.to_json().encode()})
