"""``rtcal loop start`` and ``next``: the closed loop with a program that is run by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

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

    begun = closed_loop.start(
        Room.from_file(room), Measurement.from_file(measured), rule=rule,  # type: ignore[arg-type]
        method=method, decimals=decimals,
    )  # fmt: skip
    _write(begun, state, out)


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

    going = Loop.load(state, Room.from_file(room))
    found = Measurement.from_file(simulated)
    if list(found.centre_frequencies) != list(going.room.centre_frequencies):
        raise DataError(f"{simulated} has other bands than {room}")
    if "t20" not in found.values:
        raise DataError(f"{simulated} has no t20")
    going = going.record(going.next_alpha, found)
    for frequency, gap, status in zip(
        going.room.centre_frequencies, going.gap, going.status, strict=True
    ):
        open_still = not going.finished and status == "not converging"
        click.echo(f"{frequency:7g} Hz  {gap:+6.2f} JND  {'not yet' if open_still else status}")
    click.echo("Done." if going.finished else f"Simulate {out} next.")
    _write(going, state, out)


def _write(going: Loop, state: str, out: str) -> None:
    going.room.replace(alpha=going.next_alpha, calibration=None).save(out)
    going.save(state)
