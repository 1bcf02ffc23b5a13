"""``rtcal calibrate``, ``fit``, ``learn``, ``study``: one room, an archive of rooms, random rooms."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import click

from rtcal.acoustics.observables import MATCH
from rtcal.command import console
from rtcal.files.disk import make_folder, spare, write_all
from rtcal.support import text
from rtcal.support.errors import DataError


@click.command(short_help="Calibrate a room to measured reverberation times.")
@console.takes(
    "ROOM",
    "MEASURED?",
    "t20",
    "t30",
    "method",
    "equation",
    console.choice("solver", ("clarabel", "osqp"), "The solver of the QP.", default="clarabel"),
    console.choice(
        "unreachable",
        ("raise", "nearest"),
        "If no coefficients give the measured T: stop, or use the nearest T.",
        default="raise",
    ),
    "modes",
    console.folder(
        "Folder for the calibrated room (room.toml), all numbers (result.json) and T(f) "
        "(reverberation_time.png, not with --modes). Nothing is written without it."
    ),
)
def calibrate(args: Namespace) -> None:
    """Calibrate ROOM (TOML) to MEASURED (CSV, xlsx) and print T and coefficients per band.

    \b
    Example: rtcal calibrate room.toml t20.csv --out calibrated

    \b
    Example: rtcal calibrate room.toml --t20 "0.9 0.8 0.7 0.7 0.6 0.6"

    `rtcal report calibrated` makes a page of the results. With the calibrated coefficients, the
    reverberation equation gives the measured T. If your simulation program then gives another T,
    calibrate with `rtcal loop start --simulated`.
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.calibration import methods
    from rtcal.report import figures

    read = [args.room, args.measured, args.modes]
    spare([args.out / name for name in figures.FILES] if args.out else [], read)
    solving = args.method, args.solver, args.unreachable
    if args.modes is not None and solving != ("mle", "clarabel", "raise"):
        raise DataError(
            "--method, --solver and --unreachable cannot be given with --modes, which has a method of "
            "its own. Leave them out"
        )
    prior = console.read_room(args.room)
    data = console.measured(prior, args.measured, t20=args.t20, t30=args.t30)
    pictures: dict[str, Any] = {}
    if args.modes is not None:
        result: Any = console.told_by_modes(prior, args.modes, data, args.equation)
    else:
        options = console.rest(args, "room", "measured", "t20", "t30", "modes", "out")
        result = methods.calibrate(prior, data, **options)
        pictures = {figures.FIGURE: lambda: figures.reverberation_time(result)}
    if args.out is not None:
        figures.write_folder(result, args.out, pictures)
    console.tell(str(result), result.to_dict)


NOT_NEARER = 7
"""Exit code of a fit that returns its start."""
_START = 0.1
"""Scattering coefficient at which a fit starts where the room has none: a choice, which matters."""


@click.command(short_help="Calibrate to the measurement at every position, in the room's mesh.")
@console.takes(
    "ROOM",
    "MEASURED",
    "match",
    "exclude",
    "scattering",
    "paths",
    console.choice(
        "scattering-model",
        ["random", "vector"],
        "Meaning of the coefficients, if not the room's; fitted with random alone.",
    ),
    console.flag("keep-scattering", "Keep the room's scattering; by default it is fitted too."),
    "seed",
    "scheduler",
    "modes",
    console.folder(
        "Folder for the calibrated room (room.toml), all numbers (result.json) and a plan (plan.png). "
        "Nothing is written without it."
    ),
)
def fit(args: Namespace) -> None:
    """Calibrate ROOM (TOML) to every source-receiver pair of MEASURED (CSV) by path tracing.

    ROOM must have a mesh, sources and receivers (docs/files.md). If neither ROOM nor --scattering gives
    a scattering coefficient, the fit starts at 0.1.

    If no step improves the fit, the exit code is 7, and nothing is written without --force.

    Reference simulations take most of the time. They are kept beside ROOM, in .rtcal_cache, for later.

    Example: rtcal fit room.toml pairs.csv --out fitted
    """
    from rtcal.acoustics.room import Room
    from rtcal.finder.means.engines import FOLDER
    from rtcal.io import geometry_files
    from rtcal.loop.positions import calibrate_positions
    from rtcal.report import figures

    stated = Room.from_file(args.room)
    read = [args.room, args.measured, stated.scene.mesh, args.modes]
    spare([args.out / name for name in figures.POSITION_FILES] if args.out else [], read)
    data = console.read_measured(args.measured)
    if stated.scattering is None and args.scattering is None and not args.keep_scattering:
        args.scattering = _START
        console.note(
            f"{args.room} has no scattering coefficients, so the fit starts with {_START:g} for every "
            "material and band. Give another start with --scattering"
        )
    prior = stated if args.modes is None else console.told_by_modes(stated, args.modes)
    with console.errors_name_options("scattering", "n_paths"):
        tracer = geometry_files.path_tracing(
            stated,
            scattering=args.scattering,
            scattering_model=args.scattering_model,
            n_paths=args.paths or console.PATHS,
        )
        with console.control_bar() as progress:
            result = calibrate_positions(
                tracer,
                prior,
                data,
                args.match or MATCH,
                exclude=console.pairs("--exclude", args.exclude),
                cache=Path(args.room).parent / FOLDER,
                position_uncertainty=stated.scene.position_uncertainty,
                fit_scattering=not args.keep_scattering,
                seed=args.seed,
                progress=progress,
                scheduler=args.scheduler,
            )
    if args.out is not None and (console.has("force") or not result.refused):
        at = tracer.geometry, tracer.sources, tracer.receivers
        pictures = {figures.PLAN: lambda: figures.position_gaps(result, *at)}
        figures.write_folder(result, args.out, pictures)
    console.tell(str(result), result.to_dict)
    if result.refused:
        raise click.exceptions.Exit(NOT_NEARER)


LIBRARY_ROOM = "room.toml"


@click.command(short_help="A library of materials from a folder of calibrated rooms.")
@console.takes(
    "FOLDER",
    "as",
    console.option(
        "apply",
        click.Path(),
        "A room (TOML) that gets the library's coefficients: room.toml of --out.",
        "room",
    ),
    "scheduler",
    console.folder(
        "Folder for the archive (result.json), and with --apply for the room (room.toml)."
    ),
)
def learn(args: Namespace) -> None:
    """Make a library of materials from the results of rtcal calibrate below FOLDER.

    Example: rtcal learn rooms --apply new.toml --out library

    Prints each material's coefficients, how each room compares with the others, and which material is
    likely misnamed. Nothing leaves this machine without --scheduler.
    """
    from rtcal.acoustics.room import Room
    from rtcal.calibration import archive
    from rtcal.files.saved import NUMBERS

    if args.room is not None and args.out is None:
        raise DataError("--apply needs --out, the file of the room that it writes")
    saved = [*map(str, Path(args.folder).rglob(NUMBERS))]
    spare([args.out / NUMBERS, args.out / LIBRARY_ROOM] if args.out else [], [*saved, args.room])
    called = console.texts("--as", args.entries, "MATERIAL=ENTRY")
    calibrated = archive.read_folder(args.folder)
    new = None if args.room is None else Room.from_file(args.room)
    of_room = {} if new is None else {m: e for m, e in called.items() if m in new.materials}
    known = {m for result in calibrated for m in archive.materials(result)}
    library = archive.learn(
        calibrated,
        {m: entry for m, entry in called.items() if m in known or m not in of_room},
        scheduler=args.scheduler,
    )
    said, record = str(library), library.to_dict()
    if others := len(saved) - len(calibrated):
        said += f"\nLeft out, results of other kinds: {others}"
    if args.out is not None:
        files = {args.out / NUMBERS: library.to_json(args.out).encode()}
        if new is not None:
            applied, left = library.apply(new, of_room), library.left_as_stated(new, of_room)
            record["left_as_stated"] = list(left)
            said = "\n".join([said, *(line for each in left for line in text.wrapped(each))])
            files[args.out / LIBRARY_ROOM] = applied.to_text(args.out).encode()
        write_all(files, args.out)
    console.tell(said, record)


@click.command(short_help="The paper's stochastic study beside its numbers.")
@console.takes(
    console.option(
        "kind",
        click.Choice(("shoebox", "lecture-hall", "halls")),
        "shoebox: Tables 1 and 2. lecture-hall: Table 3, with a stand-in, since the paper does "
        "not state the areas. halls: five random halls, analytic. The option may be repeated.",
        "rooms",
        multiple=True,
        default=("shoebox",),
    ),
    console.option(
        "sigma-r",
        float,
        "Parameter of the Rayleigh distribution of sigma. The option may be repeated.",
        multiple=True,
        default=(0.01, 0.05, 0.1),
    ),
    console.choice(
        "sampling",
        ("sigma_r", "sigma_n"),
        "How far the input coefficients keep from 0 and 1. sigma_r: twice the Rayleigh parameter, "
        "which gives the paper's Table 2. sigma_n: twice each surface's uncertainty, as its text "
        "reads.",
        default="sigma_r",
    ),
    console.whole("realisations", 1, "Rooms drawn.", default=10_000),
    console.whole(
        "trials",
        0,
        "Draws of the true coefficients per room; 0 for the analytic study only.",
        default=10_000,
    ),
    "seed",
    console.whole("workers", 1, "Threads; default: all cores."),
    "scheduler",
    console.folder("Folder for the tables (CSV) and figures (PNG)."),
)
def study(args: Namespace) -> None:
    """Score every calibration method in random rooms, beside the tables of Bellows & Katz (2025).

    The same --seed gives the same tables.

    Example: rtcal study --kind shoebox --sampling sigma_n --out study
    """
    from rtcal.report import study_report

    stated = console.rest(args, "out")
    if args.out is not None:
        make_folder(args.out)
    with console.errors_name_options("sigma_r"):
        report = study_report.report(
            **stated, progress=console.bar_wanted(), with_files=args.out is not None
        )
    if args.out is not None:
        write_all({args.out / name: content for name, content in report.files.items()})
    settings = ("sampling", "realisations", "trials", "seed")
    console.tell(str(report), {**{k: stated[k] for k in settings}, "studies": report.records})
