"""``rtcal loop start`` and ``next``: the closed loop with a program that is run by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rtcal.acoustics.files import spare
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.closed_loop import Loop


@click.group()
def loop() -> None:
    """Calibrate a program run by hand (CATT, ODEON): start, simulate, next, simulate, ..."""


@loop.command()
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option("--state", type=click.Path(dir_okay=False), required=True, help="State to write.")
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
@click.option("--method", default="mle", show_default=True)
@click.option(
    "--rule", type=click.Choice(("secant", "safeguarded", "regression")), default="safeguarded",
    show_default=True,
)  # fmt: skip
@click.option(
    "--decimals", type=click.IntRange(1, 12), help="Decimals of alpha that the program reads."
)
def start(
    room: str, measured: str, state: str, out: str, method: str, rule: str, decimals: int | None
) -> None:
    """Write ROOM (TOML) with the coefficients to simulate first, for MEASURED (CSV)."""
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
    for beyond in first.unreachable:
        click.echo(f"{beyond} (the nearest is taken)")
    click.echo(f"Simulate {out} first.")


@loop.command(name="next")
@click.argument("room", type=click.Path())
@click.argument("simulated", type=click.Path())
@click.option(
    "--state", type=click.Path(dir_okay=False), required=True, help="State to go on from."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room to simulate.")
def next_(room: str, simulated: str, state: str, out: str) -> None:
    """Take in what the program SIMULATED (CSV) and write what to simulate next.

    ROOM is the file that `start` was given.
    """
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.closed_loop import Loop

    spare([state, out], [room, simulated])
    going = Loop.load(state, Room.from_file(room))
    found = Measurement.from_file(simulated)
    try:
        going = going.record(going.next_alpha, found)
    except DataError as error:
        raise DataError(f"{simulated}: {error}") from error
    _write(going, state, out)
    for frequency, gap, status in zip(
        going.room.centre_frequencies, going.gap, going.status, strict=True
    ):
        open_still = not going.finished and status == "not converging"
        click.echo(f"{frequency:7g} Hz  {gap:+6.2f} JND  {'not yet' if open_still else status}")
    click.echo("Done." if going.finished else f"Simulate {out} next.")


def _write(going: Loop, state: str, out: str) -> None:
    """Both files or none: a state without its room would take in what was not simulated."""
    from rtcal.acoustics.files import write_all
    from rtcal.acoustics.room_files import room_text

    room = going.room.replace(alpha=going.next_alpha, calibration=None)
    write_all({out: room_text(room).encode(), state: going.to_json().encode()})
