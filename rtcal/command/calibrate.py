"""``rtcal calibrate``: a room and a measurement to a calibrated room."""

from __future__ import annotations

from typing import Literal

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import (
    equation_option,
    json_option,
    method_option,
    output_folder,
    quiet_option,
    tell,
    without_air_warning,
    written,
)
from rtcal.command.measured import read_measured


@click.command(short_help="Calibrate a room to measured reverberation times.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@method_option
@equation_option
@click.option(
    "--solver",
    default="clarabel",
    show_default=True,
    help="clarabel, osqp, another solver of cvxpy's, or qpsolvers:NAME.",
)
@click.option(
    "--unreachable",
    type=click.Choice(("raise", "nearest")),
    default="raise",
    show_default=True,
    help="If no coefficients give the measured T: stop, or use the nearest T.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), all numbers (result.json) and T(f) "
    "(reverberation_time.png). Nothing is written without it.",
)
@json_option
@quiet_option
def calibrate(
    room: str,
    measured: str,
    method: str,
    equation: LinearEquation,
    solver: str,
    unreachable: Literal["raise", "nearest"],
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrate ROOM (TOML) to MEASURED (CSV, xlsx) and print T, gaps and coefficients per band.

    Example: rtcal calibrate room.toml t20.csv --out calibrated

    `rtcal report calibrated` makes a page of the results.
    """
    from rtcal.acoustics.room import Room
    from rtcal.calibration import presets
    from rtcal.report import result_folder

    folder = output_folder("--out", out)
    if folder is not None:
        result_folder.refuse_inputs(folder, [room, measured])
    with without_air_warning():
        result = presets.calibrate(
            Room.from_file(room),
            read_measured(measured, quiet=quiet),
            method=method,
            equation=equation,
            solver=solver,
            unreachable=unreachable,
        )
    text = str(result)
    if folder is not None:
        text += "\n" + written(result_folder.write(result, folder))
    tell(text, result.to_dict(), quiet=quiet, as_json=as_json)
