"""The command `rtcal`: its subcommands, its exit codes, and the printing of errors."""

from __future__ import annotations

import io
import os
import shlex
import sys
import warnings
from collections.abc import Sequence

import click

from rtcal.command.calibrate import NOT_NEARER, calibrate, fit, learn, study
from rtcal.command.console import CannotPrint, printing, shown_warnings, warn
from rtcal.command.files import example, export, measure, report, table
from rtcal.command.finder import NOTHING_TO_ADD, apply, compare, diagnose, find, plan, verify
from rtcal.command.import_room import import_room
from rtcal.command.loop import loop
from rtcal.command.predict import design, predict
from rtcal.command.room import materials, room
from rtcal.files import disk
from rtcal.files.schema import OtherKindError, kind_of
from rtcal.support import __version__
from rtcal.support.errors import MissingAirWarning, MissingDependencyError, RtcalError, SolverError
from rtcal.support.text import decimal_comma, shortened

EXIT_CODES = {
    0: "done",
    2: "unusable input, T beyond reach, or a wrong command",
    3: "the solver failed",
    4: "an optional library is missing",
    CannotPrint.exit_code: "the output cannot be printed",
    NOTHING_TO_ADD: "nothing to add, nothing written (`rtcal apply`)",
    NOT_NEARER: "no step led nearer, the start stays (`rtcal fit`)",
    130: "interrupted",
}

_EPILOG = "\b\nExit codes:\n" + "\n".join(
    f"  {code:3d}  {text}" for code, text in EXIT_CODES.items()
)

_WIDEST_HELP = (
    100  # largest width of a help text in characters: longer lines of prose are hard to read
)


class _InOrderOfUse(click.Group):
    """Lists the commands in the order in which a user meets them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=_InOrderOfUse,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": _WIDEST_HELP},
    epilog=_EPILOG,
)
@click.version_option(__version__)
def cli() -> None:
    """Calibrate the absorption coefficients of a room-acoustic model.

    \b
    rtcal calibrate room.toml t20.csv --out calibrated
    rtcal report calibrated

    A room is a TOML file, a measurement a CSV file. Every command takes --quiet and --json. It prints
    an error in one line, and writes all its files or none. `rtcal COMMAND --help` shows an example.
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)


for command in (
    example,
    room,
    materials,
    compare,
    calibrate,
    report,
    predict,
    design,
    loop,
    fit,
    find,
    verify,
    apply,
    diagnose,
    plan,
    measure,
    table,
    import_room,
    export,
    learn,
    study,
):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with one of `EXIT_CODES`."""
    # Where the shell has closed a stream (``>&-``), the next opened file would get its number, and
    # libraries that print would write into this file.
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A character that the terminal lacks is printed as a question mark.
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # the printed text contains it
        warnings.showwarning = shown_warnings()
        sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    """Run the command, print what is wrong, and return the exit code."""
    stated = sys.argv[1:] if arguments is None else arguments
    try:
        with printing(), disk.one_set(shlex.join(["rtcal", *map(str, stated)])):
            code = cli.main(args=arguments, prog_name="rtcal", standalone_mode=False)
    except click.exceptions.Abort:
        return 130
    except SystemExit:  # click exits by itself if the reader of a help text has closed the pipe
        return CannotPrint.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        message = error.format_message()
        warn(message.removesuffix(".") + decimal_comma(message) if "float" in message else message)
        return error.exit_code
    except RtcalError as error:
        warn(_with_exchange(error, [*map(str, stated)]))
        if isinstance(error, SolverError):
            return 3
        return 4 if isinstance(error, MissingDependencyError) else 2
    except OSError as error:  # of a path that the system refuses, such as a name of 300 characters
        warn(f"{shortened(str(error.filename), 200)}: {disk.reason(error)}")
        return 2
    return code if isinstance(code, int) else 0


def _with_exchange(error: BaseException, stated: Sequence[str]) -> str:
    """Return an error's message; the exchange of two files, if each is of the other's kind, ends it."""
    message = str(error)
    while error.__cause__ is not None and not isinstance(error, OtherKindError):
        error = error.__cause__
    if not isinstance(error, OtherKindError):
        return message
    own = [i for i, text in enumerate(stated) if text == error.path]
    others = [i for i, text in enumerate(stated) if kind_of(text) == error.needed]
    if len(own) != 1 or not others:
        return message
    i, k = own[0], min(others, key=lambda k: (abs(k - own[0]), -k))
    right = [*stated]
    right[i], right[k] = right[k], right[i]
    command = shlex.join(["rtcal", *right])
    return f"{message.removesuffix(error.hint)}. Exchange the two files: {command}"
