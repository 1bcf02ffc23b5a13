"""``rtcal example``, ``measure``, ``table``, ``export`` and ``report``: files in and out."""

from __future__ import annotations

import shlex
from argparse import Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from rtcal.acoustics.observables import OBSERVABLES
from rtcal.command import console
from rtcal.files import disk
from rtcal.files.disk import spare, write_all, write_text
from rtcal.files.schema import ROOM, OtherKindError, kind_of
from rtcal.io.table_columns import DECAY_TIMES_OF_RT60
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.io.impulse_responses import Analysis
    from rtcal.io.tables import MeasuredTable


_TABLES = (".csv", ".xlsx")
PROGRAMS = ("catt", "odeon", "pyroomacoustics", "bras")


_OUT = console.file("out", "Measurement (CSV, xlsx) to write.")


@click.command(short_help="Impulse responses (sound, SOFA) to T20, EDT, C80 and others.")
@console.takes(
    click.argument("responses", type=click.Path(), nargs=-1, required=True),
    "bands",
    console.several(
        "minimum-range",
        "PARAMETER=DB",
        "Impulse-to-noise ratio in dB that a parameter needs, if not ISO 3382's: t30=38.",
        "ranges",
    ),
    console.option(
        "channels",
        None,
        "In files of several channels: the one to read, or 'receivers' if each is a receiver.",
        metavar="N|receivers",
    ),
    console.file(
        "sweep", "Signal that was played: RESPONSES are recordings of it, and are deconvolved."
    ),
    console.flag(
        "interrupted",
        "RESPONSES are recordings of noise that is stopped, once or several times: T20, T30 and their "
        "uncertainty.",
    ),
    console.flag(
        "uncertainty",
        "Also write the standard uncertainty of T20, T30, EDT, C50 and C80: per value that of one "
        "decay, in common the reproducibility between measuring teams.",
    ),
    console.flag(
        "level",
        "Also write the relative level. The power of each source and the gain must have been the same "
        "in all files, and no file normalised.",
    ),
    "repeats",
    console.file(
        "positions",
        "File (TOML) to write: [sources] and [receivers] of one SOFA file, for the room's file.",
    ),
    _OUT,
)
def measure(args: Namespace) -> None:
    """Measure T20, T30, EDT, C50, C80, D50, STI and Ts of RESPONSES (WAV, FLAC, AIFF, SOFA, ...).

    Prints why values are missing.

    Example: rtcal measure *.wav --out t.csv

    Example: rtcal measure recorded.wav --sweep played.wav --out t.csv

    Example: rtcal measure stopped.wav --interrupted --out t.csv
    """
    from rtcal.acoustics.marks import given_twice, in_measurement
    from rtcal.io import impulse_responses, recordings, sofa

    whys = {
        "--sweep": (args.sweep, "a recording holds either a sweep or stopped noise"),
        "--uncertainty": (args.uncertainty, "it is then given anyway, by the stops and ISO 3382-2"),
        "--level": (args.level, "stopped noise has the level of a steady sound"),
    }
    for other, (stated, why) in whys.items() if args.interrupted else ():
        if stated:
            raise DataError(f"{other} cannot be given with --interrupted: {why}. Leave {other} out")
    given = args.responses if args.sweep is None else (*args.responses, args.sweep)
    spare([args.out, args.positions], given)
    console.fit_ending("--out", args.out, *_TABLES)
    if args.positions is not None and len(args.responses) != 1:
        raise DataError(
            "--positions needs exactly one SOFA file, because several files use the same "
            "names for different positions. Give one SOFA file, or leave --positions out"
        )
    channels = args.channels
    if channels and channels.isdecimal():
        channels = int(channels)
    scene = None if args.positions is None else sofa.read(args.responses[0]).positions_text()
    with (
        console.errors_name_options("channels", "repeats", "level"),
        console.progress_bar(len(args.responses), "response") as shown,
    ):
        read: Any = partial(impulse_responses.read, level=args.level)
        if args.interrupted:
            read = recordings.interrupted
        if args.sweep is not None:
            read = partial(recordings.from_sweep, sweep=args.sweep, level=args.level)
        analysis = read(
            args.responses,
            bands="octave" if args.bands is None else args.bands,
            channels=channels,
            minimum_range=console.numbers("--minimum-range", args.ranges, "PARAMETER=DB"),
            repeats=args.repeats,
            progress=lambda: shown.update(1),
        )
    if args.uncertainty:
        analysis = replace(
            analysis, measurement=impulse_responses.with_uncertainty(analysis.measurement)
        )
    nothing = all(np.isnan(v).all() for v in analysis.measurement.values.values())
    if nothing and args.out is not None:
        raise DataError(
            f"{args.out} was not written, because no parameter could be determined. "
            f"{analysis.missing[0]} For all reasons run the command without --out"
        )
    if nothing:
        console.note("no parameter could be determined; the reasons are listed")
    if args.positions is not None and scene is not None:
        write_text(args.positions, scene)
    odd = [
        f"{error.frequency:g} Hz: {error.text}: hardly the decay of a room. Check this response before "
        "anything else"
        for error in in_measurement(analysis.measurement)
    ]
    odd += given_twice(analysis.measurement)
    for sentence in odd:
        console.note(sentence)
    _write_and_tell(
        analysis,
        args.out,
        impulse_to_noise_ratio_db=analysis.impulse_to_noise_ratio,
        minimum_range_db=analysis.minimum_range,
        missing=analysis.missing,
        notes=(*odd, *analysis.notes),
    )


@click.command(short_help="A measuring system's table (CSV, xlsx, REW) to a measurement.")
@console.takes(
    click.argument("paths", type=click.Path(), nargs=-1, required=True),
    console.option(
        "decay-time",
        click.Choice(DECAY_TIMES_OF_RT60, case_sensitive=False),
        "The decay time in a column RT60 or T60.",
    ),
    console.option(
        "parameter",
        click.Choice(tuple(OBSERVABLES), case_sensitive=False),
        "The parameter of the values, if the table does not name it.",
    ),
    console.several("where", "COLUMN=ENTRY", "Read only rows with this entry."),
    "columns",
    console.option(
        "sources", click.IntRange(1), "The values are means over N sources.", "n_sources"
    ),
    console.option("receivers", click.IntRange(1), "And over N receivers.", "n_receivers"),
    "repeats",
    console.several("sheets", "SHEET", "Read only this sheet of a workbook."),
    _OUT,
)
def table(args: Namespace) -> None:
    """Read measuring systems' tables (CSV, Excel's xlsx, REW's and Dirac's text) as one measurement.

    Prints how each column was read.

    Example: rtcal table dirac.csv --decay-time t20 --out t.csv

    Example: rtcal table rew_S1R1.txt rew_S1R2.txt --out t.csv
    """
    from rtcal.io import tables

    spare([args.out], args.paths)
    console.fit_ending("--out", args.out, *_TABLES)
    with console.errors_name_options(*console.ARGUMENTS):
        entries = console.texts("--where", args.where, "NAME=ENTRY")
        options = console.rest(args, "paths", "where", "out")
        table_read = tables.read(args.paths, where=entries, **options)
    columns = tuple(console.as_options(line, console.ARGUMENTS) for line in table_read.columns)
    table_read = replace(table_read, columns=columns)
    _write_and_tell(table_read, args.out, columns=columns, doubts=table_read.doubts)


def _write_and_tell(analysis: Analysis | MeasuredTable, out: str | None, **notes: Any) -> None:
    """Write the file and print the text."""
    from rtcal.io import tables

    measurement = analysis.measurement
    if out is not None:
        tables.write(measurement, out)
    of = ("centre_frequencies", "pairs", "values")
    console.tell(str(analysis), {**{name: getattr(measurement, name) for name in of}, **notes})


@click.command(short_help="A calibrated room into a program's material list, changed or new.")
@console.takes(
    click.argument("program", type=click.Choice(PROGRAMS)),
    "ROOM",
    "MATERIALS",
    console.option(
        "template",
        click.Path(),
        "Program's file whose changed copy is MATERIALS; by default MATERIALS itself.",
    ),
    "decimals",
    "as",
    console.choice(
        "missing-bands",
        ("refuse", "nearest"),
        "If the room lacks a band of a new list (CATT, ODEON): refuse, or use the nearest band.",
        default="refuse",
    ),
)
def export(args: Namespace) -> None:
    """Write ROOM's coefficients into a program's MATERIALS; print the effect of the rounding on T.

    Numbers in the file MATERIALS are changed. If there is no such file, a new list of the room's
    materials is written, without geometry. The first printed line says which was done.

    Example: rtcal export catt calibrated/room.toml hall.geo
    """
    from rtcal import io
    from rtcal.acoustics.room import Room

    module = getattr(io, args.program)
    called = console.texts("--as", args.entries, "MATERIAL=ENTRY")
    options = {"template": args.template, "decimals": args.decimals, "entries": called}
    if args.program in ("catt", "odeon"):
        options["missing_bands"] = args.missing_bands
    elif args.missing_bands != "refuse":
        raise DataError(
            f"--missing-bands: {args.program}'s list has the bands of the room. Leave it out"
        )
    if args.template is None:
        disk.may_replace(args.materials)  # its numbers are what is asked to be changed
    if kind_of(args.materials) == ROOM and not kind_of(args.room):
        other = OtherKindError(f"{args.room} is not a file of rtcal, but a room is needed here")
        other.path, other.needed = args.room, ROOM
        raise other
    with console.errors_name_options("missing_bands", "decimals"):
        done = module.write(Room.from_file(args.room), args.materials, **options)
    record = {
        "new_list": done.template is None,
        "template": done.template,
        "equation": done.equation,
        "centre_frequencies": done.room.centre_frequencies,
        "reverberation_time": done.reverberation_time,
        "reverberation_time_as_read": done.reverberation_time_as_read,
        "change_jnd": done.change,
        "bands_not_written": done.bands_not_written,
        "notes": done.notes,
        "not_in_file": done.lost,
    }
    console.tell(str(done), record)


_PURPOSES = {
    "room": "a room and a measured T",
    "change": "variants to predict, a target to design to",
    "responses": "impulse responses and a mesh",
    "recordings": "a recorded sweep and stopped noise",
    "program": "a CATT list and a table of T",
    "simulator": "a simulator in Python",
    "optimisation": "terms, solvers and the certificate",
    "compare": "a simulation of your own and a measurement",
    "missing-effect": "a model that may lack something",
    "identified": "two rooms: one effect identified, one not",
    "where": "a mesh and twelve pairs: on which surface?",
    "diagnose": "a mesh and eight pairs: where, what, added, calibrated",
}
_LIST = "\b\n" + "\n".join(f"    {name:16s}{text}" for name, text in _PURPOSES.items())


@click.command(
    short_help="Write files to start from.",
    help=f"""Write the files of a small project, and print the commands that use them.

    {_LIST}

    Example: rtcal example room --out my-room
    """,
)
@console.takes(
    click.argument("name", type=click.Choice(tuple(_PURPOSES))),
    console.folder("Folder to write; NAME if not given."),
)
def example(args: Namespace) -> None:
    """Write an example; the help of the command lists them."""
    from rtcal.datasets import examples
    from rtcal.support.text import shell

    project = examples.example(args.name)
    into = args.out or Path(args.name)
    targets = {into / file: content for file, content in project.files.items()}
    if present := [path for path in targets if path.exists()]:
        raise DataError(
            f"{present[0]} exists, and `rtcal example` does not overwrite files. Give "
            "another folder with --out"
        )
    write_all(targets, into)
    commands = [f"cd {shlex.quote(str(into))}", *project.commands]
    lines = ["\nNext:", *(line for command in commands for line in shell(command, "  "))]
    console.tell("", {"commands": list(project.commands)}, "\n".join(lines))


_FIGURES = 3


@click.command(short_help="Write a saved result as one HTML page.")
@console.takes(
    "RESULT",
    console.file(
        "out",
        "Page (HTML) to write, by default report.html beside the result; or, as tables.xlsx, a "
        "workbook of all its tables.",
    ),
    *console.HEADING,
)
def report(args: Namespace) -> None:
    """Write RESULT as one HTML page with summary, cautions, tables and figures, or as a workbook.

    RESULT is the folder that --out of `rtcal calibrate`, `fit`, `find`, `predict` or `design` wrote,
    its result.json, or the --state of an `rtcal loop`. The page needs no network and no other file.

    \b
    Example: rtcal report calibrated \\
        --author "A. Consultant" --out hall.html

    \b
    Example: rtcal report calibrated --out hall.xlsx
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.io import workbook
    from rtcal.report import figures, pages

    if args.out == "":
        raise DataError("--out is empty; give the name of a file")
    beside = Path(args.result) if Path(args.result).is_dir() else Path(args.result).parent
    kept = [beside / name for name in figures.FILES if (beside / name).exists()]
    target = Path(args.out) if args.out is not None else beside / "report.html"
    spare([target], [args.result, *kept])
    console.fit_ending("--out", args.out, ".html", ".htm", workbook.ENDING)
    if target.suffix.lower() == workbook.ENDING:
        pages.write_workbook(args.result, target)
        console.tell("", {})
        return
    with console.progress_bar(_FIGURES, "figure") as shown:
        text = pages.page_of(
            args.result, heading=console.heading(args), progress=lambda: shown.update(1)
        )
    write_text(target, text)
    console.tell("", {"bytes": len(text.encode())})
