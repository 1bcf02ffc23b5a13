"""``rtcal predict``: T after changes of a room, with its interval."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import (
    equation_option,
    json_option,
    output_folder,
    quiet_option,
    tell,
    written,
)
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.acoustics.room import Room
    from rtcal.prediction.estimate import State

MAX_BYTES = 2**18
"""Largest size of a file of variants or treatments in bytes."""

also_option = click.option(
    "--also",
    nargs=2,
    type=click.Path(),
    multiple=True,
    metavar="ROOM MEASURED",
    help="A further measured state: the same room with other areas. It narrows the interval most.",
)


@click.command(short_help="Predict T after changes of a room, and how sure that is.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path(), required=False)
@click.option(
    "--change",
    type=click.Path(),
    required=True,
    help="File of variants (TOML); see docs/files.md.",
)
@also_option
@equation_option
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for all numbers (result.json), of which `rtcal report` makes a page.",
)
@json_option
@quiet_option
def predict(
    room: str,
    measured: str | None,
    change: str,
    also: tuple[tuple[str, str], ...],
    equation: LinearEquation,
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Predict T of ROOM (TOML), MEASURED (CSV) as it is, after the changes of a file.

    Without MEASURED the stated coefficients alone predict. JND here is ln(T ratio) / ln 1.05.

    Example: rtcal predict room.toml t20.csv --change variants.toml
    """
    from rtcal.acoustics.change_files import read_variants
    from rtcal.datasets import catalogue
    from rtcal.prediction.compared import compare
    from rtcal.support.files import read_text

    folder = output_folder("--out", out)
    before, states = measured_states(room, measured, also)
    try:
        variants = read_variants(read_text(change, MAX_BYTES), before, catalogue.material)
    except DataError as error:
        raise DataError(f"{change}: {error}") from error
    found = compare(states, variants, before=before, equation=equation)
    text = str(found)
    if folder is not None:
        text += "\n" + written([found.save(folder)])
    tell(text, found.to_dict(), quiet=quiet, as_json=as_json)


def measured_states(
    room: str, measured: str | None, also: tuple[tuple[str, str], ...]
) -> tuple[Room, tuple[State, ...]]:
    """Return the room, and its measured states: none, one or several."""
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.calibration.measured import times_in_room
    from rtcal.prediction.estimate import State

    def state(stated: Room, path: str) -> State:
        times = times_in_room(stated, Measurement.from_file(path))
        return State(stated, times.reverberation_time, times.uncertainty)

    if Path(room).is_dir():
        raise DataError(f"{room} is a folder; give the room (TOML) that was calibrated and its T")
    before = Room.from_file(room)
    states = [] if measured is None else [state(before, measured)]
    return before, (*states, *(state(Room.from_file(r), m) for r, m in also))
