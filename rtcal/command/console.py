"""Options and output common to all commands."""

from __future__ import annotations

import functools
import os
import re
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.acoustics.bands import hertz, span
from rtcal.acoustics.equations import EQUATIONS, LinearEquation, equation_keys
from rtcal.acoustics.observables import MATCH, OBSERVABLES
from rtcal.files import disk
from rtcal.files.disk import json_text
from rtcal.files.schema import TABLE, expecting
from rtcal.io.table_columns import frequency_of
from rtcal.io.text import numbers as numbers_of
from rtcal.support.errors import DataError, FewPathsWarning
from rtcal.support.text import decimal_comma, fitted, printable, width

if TYPE_CHECKING:
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.acoustics.run import Run
    from rtcal.modes.calibrate import ModesResult
    from rtcal.report.document import Heading


def as_options(text: str, arguments: Sequence[str], named: Mapping[str, str] | None = None) -> str:
    """Return a message with the options of a command in place of Python's arguments.

    ``named`` has the option of an argument with another name.

    Examples
    --------
    >>> as_options('state decay_time="t20" or n_sources', ["decay_time", "n_sources"])
    'state --decay-time t20 or --sources'
    >>> as_options('read where={"room": "CR2"}', [])
    'read --where "room=CR2"'
    >>> as_options("state repeats=True", ["repeats"])
    'state --repeats'
    """
    for argument, option in (("where", "--where"), ("entries", "--as")):
        text = re.sub(rf'\b{argument}=\{{"([^"]+)": "([^"]+)"\}}', rf'{option} "\1=\2"', text)
        text = re.sub(rf"^{argument}:", f"{option}:", text)
    for argument in arguments:
        option = "--" + (named or {}).get(argument, argument.removeprefix("n_").replace("_", "-"))
        text = text.replace(f"{argument}=True", option)
        text = re.sub(rf'\b{argument} ?= ?(?:"(\w+)"|("[^"]*"|[\w.]+))', rf"{option} \1\2", text)
        if "_" in argument:
            text = re.sub(rf"(?<!-)\b{argument}\b", option, text)
    return text


@contextmanager
def errors_name_options(*arguments: str, **named: str) -> Iterator[None]:
    """Replace Python's arguments by the command's options in the message of a DataError."""
    try:
        yield
    except DataError as error:
        raise DataError(as_options(str(error), (*arguments, *named), named)) from error


def pairs(option: str, stated: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of a source and a receiver; DataError for another form than SOURCE:RECEIVER."""
    found = []
    for text in stated:
        source, colon, receiver = text.partition(":")
        if not (source and colon and receiver):
            raise DataError(f'{option}: "{text}" must have the form SOURCE:RECEIVER, such as S1:R3')
        found.append((source, receiver))
    return found


def texts(option: str, stated: Sequence[str], form: str, *, last: bool = False) -> dict[str, str]:
    """Return the texts that a repeated option gives as NAME=VALUE, by name.

    The name ends at the first =, or at the last one if ``last`` is True. Raises DataError for another
    form, and for a name that is given twice.
    """
    by_name: dict[str, str] = {}
    for text in stated:
        name, _, value = text.rpartition("=") if last else text.partition("=")
        if not name or not value:
            raise DataError(f'{option}: "{text}" must have the form {form}')
        if name in by_name:
            raise DataError(f'{option}: "{name}" is given twice')
        by_name[name] = value
    return by_name


def numbers(option: str, stated: Sequence[str], form: str) -> dict[str, float]:
    """Return the numbers by name; DataError as `texts`, and for a value that is no number."""
    by_name = {}
    for name, value in texts(option, stated, form, last=True).items():
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if number != number:
            raise DataError(
                f'{option}: "{name}={value}" must have the form {form}{decimal_comma(value)}'
            )
        by_name[name] = number
    return by_name


_LABEL = re.compile(r"[,;\s]*(?<![\d.])(\d+(?:\.\d+)?\s?(?:k\d*)?\s?(?:hz)?)\s*:", re.I | re.ASCII)


def spectrum(
    option: str, text: str, bands: Sequence[float], *, alone: bool = False
) -> dict[float, float]:
    """Return the values of an option by band in Hz, from a text like "0.9 0.8" or "500:0.9 1000:0.8".

    The first form has one value for each of ``bands`` in Hz, the second has values for some of them. If
    ``alone`` is True, a single number is the value of every band. Decimals may have commas. Raises
    DataError for another number of values, and for a text that is no band or no number.
    """
    before, *labelled = _LABEL.split(text.strip())
    if not text.strip():
        raise DataError(f'{option} is empty. Give values such as "500:0.8 1000:0.7"')
    if not labelled:
        try:
            values = numbers_of(text, {len(bands), *([1] if alone else [])}, option)
        except DataError as error:
            raise DataError(
                f"{error}. The room has {span(bands)}. To give values for some bands only, "
                'write them as "500:0.8 1000:0.7"'
            ) from error
        return dict(zip(bands, values * (len(bands) // len(values)), strict=True))
    found: dict[float, float] = {}
    for label, value in zip(labelled[::2], labelled[1::2], strict=True):
        band = frequency_of(label)
        if before or band is None or band in found:
            raise DataError(
                f'{option}: "{text}" must be BAND:VALUE for each band, with the band in Hz '
                'and no band twice, such as "500:0.8 1000:0.7"'
            )
        if not value.strip():
            raise DataError(f'{option}: "{text}" has no value after "{label}:"')
        (found[band],) = numbers_of(value, [1], f"{option}, {label}")
    return found


ARGUMENTS = (
    "decay_time",
    "parameter",
    "columns",
    "n_sources",
    "n_receivers",
    "repeats",
    "sheets",
)
"""Arguments of `rtcal.io.tables.read` that its messages name, and `rtcal table` has as options."""


def read_measured(path: str | os.PathLike[str], *, quietly: bool = False) -> Measurement:
    """Return the measurement in the file that a command takes."""
    from rtcal.io import tables

    try:
        table = tables.measurement(path)
    except DataError as error:
        text = as_options(str(error), ARGUMENTS)
        if text != str(error):
            text += f". Give the option to `rtcal table {path} --out FILE`, and then use FILE"
        raise DataError(text) from error
    measured, notes = table.measurement, [*table.doubts]
    if table.columns:
        n = len(measured.pairs)
        of = "means" if measured.is_summary else f"{n} pair{'s' * (n > 1)}"
        notes.insert(
            0,
            f"{', '.join(p.upper() for p in measured.values)} of {of} in "
            f"{len(measured.centre_frequencies)} bands; `rtcal table {path}` shows how it was read",
        )
    for said in () if quietly else notes:
        note(f"{path}: {said}")
    return measured


def stated_times(name: str, text: str, bands: Sequence[float]) -> Measurement:
    """Return the measurement of --t20 or --t30, in ``bands`` or some; DataError for other texts."""
    from rtcal.acoustics.measurement import Measurement

    in_seconds = re.sub(r"(?<=\d)\s*s(?![a-z])", "", text)
    by_band = spectrum(f"--{name}", in_seconds, bands)
    for f, seconds in by_band.items():
        OBSERVABLES[name].refuse(f"--{name} at {hertz([f])}", seconds)
    ordered = sorted(by_band)
    return Measurement.from_values(ordered, **{name: [by_band[f] for f in ordered]})


def measured(
    room: Room, path: str | None, *, quietly: bool = False, **times: str | None
) -> Measurement:
    """Return the measurement of a file, or of --t20 or --t30; DataError for several of them."""
    stated = {name: text for name, text in times.items() if text is not None}
    given = [*(["MEASURED"] if path is not None else []), *(f"--{name}" for name in stated)]
    if len(given) > 1:
        raise DataError(f"{' and '.join(given)} are both given; give only one measurement")
    if path is not None:
        return read_measured(path, quietly=quietly)
    for name, text in stated.items():
        return stated_times(name, text, room.centre_frequencies.tolist())
    raise click.MissingParameter(param_type="argument", param_hint="MEASURED (or --t20, --t30)")


def read_run(room: Room, simulated: str | None, at: str | None) -> Run | None:
    """Return the run of --simulated and --at, or None without it."""
    from rtcal.acoustics.room import Room
    from rtcal.acoustics.run import Run

    if simulated is None:
        if at is not None:
            raise DataError(
                f"--at {at} gives the coefficients of a simulation, but the simulation is "
                "missing. Add it with --simulated"
            )
        return None
    data, own = read_measured(simulated), room if at is None else Room.from_file(at)
    try:
        run = Run(own, data)
        run.refuse_other(room)
    except DataError as error:
        files = " --at ".join(filter(None, (simulated, at)))
        raise DataError(f"{files}: {error}") from error
    return run


def read_room(path: str) -> Room:
    """Return the room that a command takes; where its mesh has other areas or volume is told once."""
    from rtcal.acoustics.room import Room

    room = Room.from_file(path)
    if room.scene.mesh is None:
        return room  # importing the simulators takes longer than reading it
    from rtcal.io import geometry_files

    if doubt := geometry_files.mesh_doubt(room):
        note(doubt)
    return room


PATHS = 8000
"""Paths from each source, by default; the number of `PathTracing`."""


def told_by_modes(
    room: Room,
    path: str,
    measured: Measurement | None = None,
    equation: LinearEquation | None = None,
) -> ModesResult:
    """Return the calibration to a table of modes or a SOFA file's responses; T is ``measured``."""
    from rtcal.io import sofa
    from rtcal.modes import measured as tables
    from rtcal.modes.calibrate import calibrate_modes

    with expecting(TABLE, path):
        modes = sofa.read(path) if sofa.recognises(path) else tables.read(path)
    with progress_bar(1, "calculation", wanted=False) as shown:
        shown.set_description("room modes, minutes where a mesh has hundreds of them")
        return calibrate_modes(room, modes, measured, equation=equation)


def _kept(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Keep a flag with the call of the command, for `has`; --force lets it replace foreign files."""
    context.meta[f"rtcal.{parameter.name}"] = value
    if value and parameter.name == "force":
        disk.may_replace()


def has(name: str) -> bool:
    """Return whether the running command was called with a flag that all have; False outside one."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(f"rtcal.{name}"))


def is_quiet() -> bool:
    """Return whether the running command was called with ``--quiet``."""
    return has("quiet")


Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def option(name: str, of: Any, help: str, *names: str, **more: Any) -> Decorator:
    """Return an option whose value is ``of`` a type; its default is shown, if there is one."""
    default = "default" in more
    return click.option(f"--{name}", *names, type=of, help=help, show_default=default, **more)


def _address(context: click.Context, parameter: click.Parameter, text: str | None) -> str | None:
    """Return a scheduler's address, checked also where kept simulations leave nothing to do."""
    from rtcal.support.workers import checked_address  # asyncio, which few commands need

    return None if text is None else checked_address(text)


def flag(name: str, help: str, *names: str, **more: Any) -> Decorator:
    """Return an option without a value; ``names`` are further names of the option."""
    return click.option(f"--{name}", *names, is_flag=True, help=help, **more)


def file(name: str, help: str, *names: str, **more: Any) -> Decorator:
    """Return an option of a file."""
    return option(name, click.Path(dir_okay=False), help, *names, **more)


def folder(help: str, name: str = "out") -> Decorator:
    """Return an option of a folder, which the command gets as a path or None; "" is a DataError."""

    def path(context: click.Context, parameter: click.Parameter, text: str | None) -> Path | None:
        if text == "":
            raise DataError(f"--{name} is empty; give the name of a folder")
        return None if text is None else Path(text)

    return click.option(f"--{name}", type=click.Path(file_okay=False), callback=path, help=help)


def choice(name: str, of: Sequence[str], help: str, **more: Any) -> Decorator:
    """Return an option of one of several values."""
    return option(name, click.Choice(of), help, **more)


def several(name: str, metavar: str, help: str, into: str = "") -> Decorator:
    """Return an option that may be repeated; the command gets all of its values, by ``into``."""
    return option(name, None, help, *filter(None, [into]), multiple=True, metavar=metavar)


def whole(name: str, least: int, help: str, **more: Any) -> Decorator:
    """Return an option of a whole number."""
    return option(name, click.IntRange(least), help, **more)


_T = 'a value for each of the room\'s bands, "0.9 0.8", or for some, "500:0.9 1000:0.8"'

OPTIONS: dict[str, Decorator] = {
    "t20": option("t20", None, f"T20 in s, without a file: {_T}."),
    "t30": option("t30", None, f"T30 in s, without a file: {_T}."),
    "quiet": flag(
        "quiet", "Print nothing but errors, and the JSON.", "-q", expose_value=False, callback=_kept
    ),
    "json": flag(
        "json", "Print JSON in place of text.", "as_json", expose_value=False, callback=_kept
    ),
    "force": flag(
        "force",
        "Replace files of these names that rtcal did not write, or that were changed since.",
        expose_value=False,
        is_eager=True,
        callback=_kept,
    ),
    "method": choice(
        "method",
        ("mle", "lse", "soft", "smooth", "robust"),
        "mle: by the input sigmas; lse: all sigmas alike; soft: T within its uncertainty; smooth: "
        "soft, with neighbouring bands alike; robust: soft, and a single sigma may be wrong.",
        default="mle",
    ),
    "equation": choice(
        "equation",
        equation_keys(LinearEquation),
        "The reverberation equation.",
        default="eyring",
        callback=lambda context, parameter, key: EQUATIONS[key](),
    ),
    "scheduler": option(
        "scheduler",
        None,
        "Address of a Dask scheduler, whose workers share the work (docs/cluster.md); by default the "
        "cores of this machine do. Not worth it for less than a minute.",
        metavar="tcp://HOST:PORT",
        callback=_address,
    ),
    "seed": whole("seed", 0, "Seed of the random numbers.", default=0),
    "exclude": several(
        "exclude", "SOURCE:RECEIVER", "Leave a pair out. The option may be repeated."
    ),
    "match": click.option(
        "--match",
        multiple=True,
        type=click.Choice(tuple(OBSERVABLES)),
        help="What is compared at every position. The option may be repeated; by default "
        f"{', '.join(MATCH)}.",
    ),
    "paths": option(
        "paths",
        click.IntRange(100, 10_000_000),
        f"Paths that are traced from each source; by default {PATHS}.",
    ),
    "scattering": option("scattering", float, "Scattering coefficient where the room has none."),
    "bands": click.option(
        "--bands",
        metavar="octave|third-octave|HZ,HZ...",
        callback=lambda context, parameter, text: bands(text),
        help="The bands; by default octaves where responses are measured, and the list's for a room.",
    ),
    "decimals": option(
        "decimals",
        click.IntRange(1, 15),
        "Decimals of a coefficient in the program (3 for CATT: 0.1 %).",
    ),
    "as": several(
        "as",
        "MATERIAL=ENTRY",
        "Name of a material in the list or library, if another. The option may be repeated.",
        "entries",
    ),
    "columns": option(
        "columns",
        None,
        "What each column of a table holds, where its header does not say it, and its lines: 'from "
        "line 3 to 9: band; T20 [ms] of R1; -'. A refusal proposes it.",
    ),
    "simulated": file(
        "simulated",
        "Results of your simulation program (CSV, xlsx) with ROOM's coefficients.",
    ),
    "at": file(
        "at",
        "Room file (TOML) with the coefficients that the program used, if they are not ROOM's.",
    ),
    "repeats": flag("repeats", "Several values of one source and receiver are repeats: average."),
    "modes": file(
        "modes",
        "Table (CSV) of measured modes: frequency, decay or T, and its uncertainty; or responses "
        "(SOFA), whose modes are found. Below the Schroeder frequency they stand in place of T.",
    ),
    "before": file(
        "before",
        "Measurement (CSV) at the same positions before the room was changed: the search is then "
        "for what changed.",
    ),
}
"""The options that several commands have."""
HEADING = (
    click.option("--title", default="", help="Title of the page; the room's name if not given."),
    click.option(
        "--author",
        default="",
        envvar="RTCAL_AUTHOR",
        show_envvar=True,
        help="Who made the page, as the page names it.",
    ),
    click.option("--date", help="Date on the page; today if not given."),
)
"""The options of a page's heading."""


def rest(args: Namespace, *others: str) -> dict[str, Any]:
    """Return the arguments and options of a command by name, without some ``others``."""
    return {name: value for name, value in vars(args).items() if name not in others}


def takes(*given: str | Decorator, writes: bool = True) -> Decorator:
    """Return the decorator that adds arguments and options to a command, in this order.

    The command gets them as attributes of one object. A name in ``given`` in upper case is the path of
    a file, optional if the name ends in a question mark. Any other name is an option of `OPTIONS`.
    --json and --quiet follow, and --force if the command ``writes`` files.
    """
    last = ("json", "quiet", "force") if writes else ("json", "quiet")

    def decorator(one: str | Decorator) -> Decorator:
        if not isinstance(one, str):
            return one
        if not one.isupper():
            return OPTIONS[one]
        name = one.rstrip("?")
        return click.argument(name.lower(), type=click.Path(), required=name == one)

    def decorated(command: Callable[[Namespace], None]) -> Callable[..., Any]:
        @functools.wraps(command)
        def with_options(**options: Any) -> None:
            command(Namespace(**options))

        made: Callable[..., Any] = with_options
        for one in reversed((*given, *last)):
            made = decorator(one)(made)
        return made

    return decorated


def bands(text: str | None) -> str | list[float] | None:
    """Return what --bands states: a width in words, or frequencies in Hz; DataError for others."""
    if text is None or text in ("octave", "third-octave"):
        return text
    stated = [frequency_of(f) for f in text.split(",")]
    if None in stated:
        raise DataError(
            f'--bands: "{text}" must be octave, third-octave or centre frequencies as HZ,HZ...'
        )
    return [f for f in stated if f]


def heading(args: Namespace) -> Heading:
    """Return the heading of a page by the options of `HEADING`."""
    from rtcal.report.document import Heading

    today = time.strftime("%Y-%m-%d")
    return Heading(args.title, args.author, today if args.date is None else args.date)


_STANDARD_OUTPUT = 1  # POSIX's number of the stream


class CannotPrint(click.ClickException):
    """The standard output is closed or full."""

    exit_code = 5


def tell(
    text: str, record: Mapping[str, Any] | Callable[[], Mapping[str, Any]], then: str = ""
) -> None:
    """Write the files of a command, then print ``text`` and their names, or with ``--json`` a record.

    ``record`` may be a function, which is called only if the record is printed. ``then`` is printed
    below the files' names. With ``--quiet`` no text is printed. Raises CannotPrint if the output is
    closed.
    """
    made = disk.commit()
    as_json = has("as_json")
    if is_quiet() and not as_json:
        return
    if sys.stdout is None:
        raise CannotPrint("cannot print: the standard output is closed")
    if as_json:
        whole = dict(record() if callable(record) else record)
        said = json_text(whole | ({"written": made} if made else {}))
    else:
        names = f"Written: {', '.join(map(str, made))}"
        names = names if len(names) <= width() else "\n  ".join(["Written:", *map(str, made)])
        parts = [text, names, then] if made else [text]
        said = printable(fitted("\n".join(filter(None, parts))))
    with printing():
        click.echo(said)


@contextmanager
def printing() -> Iterator[None]:
    """Flush the standard output at the end; CannotPrint where it is closed or full."""
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        if error.filename is not None:  # of a file, and not of the output
            raise
        if sys.stdout is sys.__stdout__:
            # Python flushes again at its end, where the error could not be caught.
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STANDARD_OUTPUT)
        raise CannotPrint(f"cannot print: {error.strerror or error}") from error


def warn(message: object) -> None:
    """Print a message on standard error, unless standard error is closed or full."""
    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    parts = [printable(" ".join(part.split())) for part in f"rtcal: {message}".split("\n")]
    wrapped = on_terminal or "COLUMNS" in os.environ
    with suppress(OSError):
        click.echo("\n".join(map(fitted, parts)) if wrapped else " ".join(parts), err=True)


def note(message: object) -> None:
    """Print a message as `warn` does, but not with ``--quiet``."""
    if not is_quiet():
        warn(message)


def shown_warnings() -> Callable[..., None]:
    """Return the function that prints warnings during a command, each as one line."""
    few = False

    def show(message: Warning | str, *_: object, **__: object) -> None:
        nonlocal few
        of_paths = isinstance(message, FewPathsWarning)
        if not (few and of_paths):
            note(message)
        few = few or of_paths

    return show


def fit_ending(option: str, path: str | None, *written: str) -> None:
    """Raise DataError if a file's ending names another format than those that are written."""
    ending = "" if path is None else Path(path).suffix.lower()
    if ending not in ("", *written):
        raise DataError(
            f'{option} {path}: a file that ends in "{ending}" cannot be written here. Use '
            f"{' or '.join(written)}"
        )


def progress_bar(total: int, unit: str, *, wanted: bool = True) -> Any:
    """Return a bar on a terminal if it is ``wanted``, else lines; neither with ``--quiet``."""
    from rtcal.support.speed import bar

    return bar(total, unit, wanted and bar_wanted(), None if is_quiet() else warn)


def bar_wanted() -> bool:
    """Whether to show a progress bar: on a terminal."""
    return not is_quiet() and sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def control_bar() -> Iterator[Callable[[int, int], None]]:
    """Show a bar of the simulator's reference simulations, and yield the function that counts them."""
    from rtcal.loop.measured_pairs import RUNS
    from rtcal.support.speed import following

    with progress_bar(RUNS, "reference simulation") as shown:
        yield following(shown)
