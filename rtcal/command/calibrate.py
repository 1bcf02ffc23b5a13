"""``rtcal calibrate``: a room and a measurement to a calibrated room."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import (
    equation_option,
    json_option,
    method_option,
    output_folder,
    quiet_option,
    read_measured,
    tell,
    without_air_warning,
    written,
)
from rtcal.support.errors import DataError


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
    "--modes",
    type=click.Path(dir_okay=False),
    help="Table (CSV) of measured modes: frequency, decay or T, and its uncertainty; or responses "
    "(SOFA), whose modes are found. Below the Schroeder frequency their decays are matched in place "
    "of T.",
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
    modes: str | None,
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
        result_folder.refuse_inputs(folder, [p for p in (room, measured, modes) if p is not None])
    if modes is not None:
        if (method, solver, unreachable) != ("mle", "clarabel", "raise"):
            raise DataError(
                "--modes has a method of its own: leave out --method, --solver, --unreachable"
            )
        _by_modes(room, measured, modes, equation, folder, quiet=quiet, as_json=as_json)
        return
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


def _by_modes(
    room: str,
    measured: str,
    modes: str,
    equation: LinearEquation,
    folder: Path | None,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    """Calibrate to measured modes and T, and tell the result."""
    from rtcal.acoustics.room import Room
    from rtcal.io import sofa
    from rtcal.modes.calibrate import calibrate_modes
    from rtcal.modes.measured import read
    from rtcal.report import result_folder

    with without_air_warning():
        result = calibrate_modes(
            Room.from_file(room),
            sofa.read(modes) if sofa.claims(modes) else read(modes),
            read_measured(measured, quiet=quiet),
            equation=equation,
        )
    text = str(result)
    if folder is not None:
        text += "\n" + written(result_folder.write_with_figures(result, folder, {}))
    tell(text, result.to_dict(), quiet=quiet, as_json=as_json)
