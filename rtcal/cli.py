"""The command: parse, call, print, exit code.

Exit codes: 0 done; 2 the input, the model or the target cannot be used (one line on standard error
says why); 3 the solver failed; 4 an optional library is missing.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import click

import rtcal
from rtcal.errors import (
    DataError,
    MissingAirWarning,
    MissingDependencyError,
    RtcalError,
    SolverError,
)
from rtcal.study_command import study

EQUATIONS = {
    "eyring": "Eyring", "sabine": "Sabine", "kuttruff": "Kuttruff", "millington": "Millington",
    "fitzroy": "Fitzroy", "arau": "ArauPuchades",
}  # fmt: skip


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(rtcal.__version__)
def cli() -> None:
    """Calibrate the absorption coefficients of a room-acoustic model."""


@cli.command()
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option("--method", default="mle", show_default=True, help="mle or lse.")
@click.option(
    "--equation", type=click.Choice(tuple(EQUATIONS)), default="eyring", show_default=True,
    help="The reverberation equation; the last three only predict, and are calibrated in the loop.",
)  # fmt: skip
@click.option(
    "--solver", default="clarabel", show_default=True,
    help="clarabel, osqp, another solver of cvxpy's, or qpsolvers:NAME.",
)  # fmt: skip
@click.option(
    "--unreachable", type=click.Choice(("raise", "nearest")), default="raise", show_default=True,
    help="Where no coefficients give the measured T: stop, or take the nearest.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), everything (result.json) and T(f) "
    "(reverberation_time.png). Nothing is written without it.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON in place of the tables.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
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
    """
    from rtcal.acoustics.files import write_text

    chosen = getattr(rtcal, EQUATIONS[equation])()
    with warnings.catch_warnings():  # the page says it where the user looks
        warnings.simplefilter("ignore", MissingAirWarning)
        result = rtcal.calibrate(
            rtcal.Room.from_file(room),
            rtcal.Measurement.from_file(measured),
            method=method,
            equation=chosen,
            solver=solver,
            unreachable="nearest" if unreachable == "nearest" else "raise",
        )
    written = []
    if out is not None:
        from rtcal.report import figures

        folder = Path(out)
        figure = figures.reverberation_time(result)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"{out}: {error.strerror or error}") from error
        written = [folder / n for n in ("room.toml", "result.json", "reverberation_time.png")]
        result.room.save(os.fspath(written[0]))
        write_text(written[1], result.to_json())
        figures.save(figure, written[2])
    if as_json and not quiet:
        click.echo(result.to_json(), nl=False)
    elif not quiet:
        click.echo(str(result))
        if written:
            click.echo("Written: " + ", ".join(os.fspath(p) for p in written))


cli.add_command(study)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code."""
    try:
        code = cli.main(args=arguments, prog_name="rtcal", standalone_mode=False)
    except click.exceptions.Abort:
        code = 130
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except RtcalError as error:
        click.echo(f"rtcal: {' '.join(str(error).split())}", err=True)
        code = 3 if isinstance(error, SolverError) else 2
        if isinstance(error, MissingDependencyError):
            code = 4
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
