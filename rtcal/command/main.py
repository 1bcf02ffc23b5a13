"""The command: parse, call, print, exit code.

The exit codes are those of `EXIT_CODES`; one line on standard error says what is wrong.
"""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import rtcal
from rtcal.acoustics.equations import EQUATIONS, LinearEquation, equation_keys
from rtcal.command.console import WRITTEN, json_option, quiet_option
from rtcal.command.files import export, import_room, measure, table
from rtcal.command.gap import NOTHING_TO_ADD, gap
from rtcal.command.loop import loop
from rtcal.command.report import report
from rtcal.command.study import study
from rtcal.errors import (
    DataError,
    MissingAirWarning,
    MissingDependencyError,
    RtcalError,
    SolverError,
)
from rtcal.support.files import spare

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

EXIT_CODES = {
    0: "done",
    2: "the input, the model or the target cannot be used",
    3: "the solver failed",
    4: "an optional library is missing",
    5: "the output cannot be printed",
    NOTHING_TO_ADD: "`rtcal gap apply` only: nothing to add, nothing written",
    130: "interrupted",
}

_EPILOG = "\b\nExit codes:\n" + "\n".join(
    f"  {code:3d}  {text}" for code, text in EXIT_CODES.items()
)


class _MainPathFirst(click.Group):
    """Commands in the order in which a user meets them, not in that of the alphabet."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=_MainPathFirst, context_settings={"help_option_names": ["-h", "--help"]}, epilog=_EPILOG
)
@click.version_option(rtcal.__version__)
def cli() -> None:
    """Calibrate the absorption coefficients of a room-acoustic model.

    \b
    rtcal calibrate room.toml t20.csv --out calibrated
    rtcal report calibrated

    The files: a room in TOML, measurements in CSV. Every command takes --quiet and --json, says in
    one line what is wrong, and writes its files whole or not at all. `rtcal COMMAND --help` has an
    example of each.
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)


@cli.command(short_help="Calibrate a room to measured reverberation times.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option(
    "--method", default="mle", show_default=True, help="mle, lse, soft, smooth or robust."
)
@click.option(
    "--equation",
    type=click.Choice(equation_keys(LinearEquation)),
    default="eyring",
    show_default=True,
    help="The reverberation equation.",
)
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
    help="Where no coefficients give the measured T: stop, or take the nearest.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), everything (result.json) and T(f) "
    "(reverberation_time.png). Nothing is written without it.",
)
@json_option
@quiet_option
def calibrate(
    room: str,
    measured: str,
    method: str,
    equation: str,
    solver: str,
    unreachable: str,
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrate ROOM (TOML) to MEASURED (CSV) and print T, gaps and coefficients per band.

    Example: rtcal calibrate room.toml t20.csv --out calibrated

    `rtcal report calibrated` makes a page of what was written.
    """
    if out is not None:
        if not out:
            raise DataError("--out is empty; it is a folder")
        spare([Path(out) / name for name in WRITTEN], [room, measured])
    with warnings.catch_warnings():  # the page says it where the user looks
        warnings.simplefilter("ignore", MissingAirWarning)
        result = rtcal.calibrate(
            rtcal.Room.from_file(room),
            rtcal.Measurement.from_file(measured),
            method=method,
            equation=EQUATIONS[equation](),
            solver=solver,
            unreachable="nearest" if unreachable == "nearest" else "raise",
        )
    written = [] if out is None else _write(result, Path(out))
    if as_json and not quiet:
        click.echo(result.to_json(), nl=False)
    elif not quiet:
        click.echo(str(result))
        if written:
            click.echo("Written: " + ", ".join(os.fspath(p) for p in written))


def _write(result: CalibrationResult, folder: Path) -> list[Path]:
    """Write room, JSON and figure, all or none; without matplotlib no figure, and that is said."""
    from rtcal.report import figures
    from rtcal.support.files import write_all

    room, numbers, drawing = (folder / name for name in WRITTEN)
    contents = {room: result.room.to_text().encode(), numbers: result.to_json().encode()}
    try:
        figure = figures.rendered(figures.reverberation_time(result), "png")
        contents[drawing] = figure
    except MissingDependencyError as error:
        click.echo(f"rtcal: no figure: {error}", err=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise DataError(f"{folder}: {getattr(error, 'strerror', None) or error}") from error
    write_all(contents)
    return list(contents)


for command in (report, gap, loop, measure, table, import_room, export, study):
    cli.add_command(command)


def _warn(message: Warning | str, *_: object, **__: object) -> None:
    """One line like an error's, in place of Python's with its source; none with ``--quiet``."""
    asked = click.get_current_context(silent=True)
    if asked is None or not asked.params.get("quiet"):
        click.echo(f"rtcal: {' '.join(str(message).split())}", err=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A name that the terminal cannot show is shown as far as it can be.
            stream.reconfigure(errors="replace")
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            code = cli.main(args=arguments, prog_name="rtcal", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.Abort:
        code = 130
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        code = error.exit_code
    except click.ClickException as error:
        click.echo(f"rtcal: {' '.join(error.format_message().split())}", err=True)
        code = error.exit_code
    except OSError as error:  # the standard output is closed or full
        sys.stderr.write(f"rtcal: cannot print: {error.strerror or error}\n")
        code = 5
    except RtcalError as error:
        click.echo(f"rtcal: {' '.join(str(error).split())}", err=True)
        code = 3 if isinstance(error, SolverError) else 2
        if isinstance(error, MissingDependencyError):
            code = 4
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
