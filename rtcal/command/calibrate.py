"""``rtcal calibrate``, ``fit``, ``learn``, ``study``: one room, an archive of rooms, random rooms."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.observables import MATCH
from rtcal.command.console import (
    PATHS,
    bar_wanted,
    entries_option,
    equation_option,
    errors_name_options,
    exclude_option,
    is_forced,
    is_quiet,
    match_option,
    method_option,
    modes_option,
    numbers,
    output_folder,
    pairs,
    paths_option,
    read_measured,
    said,
    scattering_option,
    seed_option,
    tell,
    texts,
    told_by_modes,
    warn,
    without_air_warning,
    writing_options,
)
from rtcal.files.disk import make_folder, spare, write_all
from rtcal.support import text
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
    help="clarabel, osqp or another solver of cvxpy's.",
)
@click.option(
    "--unreachable",
    type=click.Choice(("raise", "nearest")),
    default="raise",
    show_default=True,
    help="If no coefficients give the measured T: stop, or use the nearest T.",
)
@modes_option
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), all numbers (result.json) and T(f) "
    "(reverberation_time.png, not with --modes). Nothing is written without it.",
)
@writing_options
def calibrate(
    room: str,
    measured: str,
    method: str,
    equation: LinearEquation,
    solver: str,
    unreachable: Literal["raise", "nearest"],
    modes: str | None,
    out: str | None,
) -> None:
    """Calibrate ROOM (TOML) to MEASURED (CSV, xlsx) and print T, gaps and coefficients per band.

    Example: rtcal calibrate room.toml t20.csv --out calibrated

    `rtcal report calibrated` makes a page of the results.
    """
    from rtcal.acoustics.directions import facing
    from rtcal.acoustics.room import Room
    from rtcal.calibration import methods
    from rtcal.io import geometry_files
    from rtcal.report import figures

    folder = output_folder("--out", out)
    if folder is not None:
        read = [room, measured, *([] if modes is None else [modes])]
        spare([folder / name for name in figures.FILES], read)
    if modes is not None:
        if (method, solver, unreachable) != ("mle", "clarabel", "raise"):
            raise DataError(
                "--modes has a method of its own: leave out --method, --solver, --unreachable"
            )
        _by_modes(room, measured, modes, equation, folder)
        return
    stated = Room.from_file(room)
    if not is_quiet() and (doubt := geometry_files.mesh_doubt(stated)):
        warn(doubt)
    with without_air_warning():
        result = methods.calibrate(
            stated,
            read_measured(measured),
            method=method,
            equation=equation,
            solver=solver,
            unreachable=unreachable,
        )
    if stated.scene.mesh is not None:
        with suppress(DataError):  # told by the mesh's doubt
            result = replace(result, shares=facing(stated, geometry_files.read(stated)))
    if folder is not None:
        figures.write_folder(result, folder)
    tell(str(result), result.to_dict())


def _by_modes(
    room: str, measured: str, modes: str, equation: LinearEquation, folder: Path | None
) -> None:
    """Calibrate to measured modes and T, and tell the result."""
    from rtcal.acoustics.room import Room
    from rtcal.report import figures

    with without_air_warning():
        heard = read_measured(measured)
        result = told_by_modes(Room.from_file(room), modes, heard, equation)
    if folder is not None:
        figures.write_with_figures(result, folder, {})
    tell(str(result), result.to_dict())


NOT_NEARER = 7
"""Exit code of a fit that returns its start."""
_START = 0.1
"""Scattering coefficient at which a fit starts where none is stated. No source says so: it is a choice,
and it matters. In one simulated room, 4,000 paths, starts of 0.05, 0.1 and 0.2 ended at 0.28, 0.27 and
0.54 in the mean. Against 0.1 alpha moved by up to 0.38 and 1.13 of the stated sigma."""


@click.command(short_help="Calibrate to what every position heard, in the room's mesh.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@match_option
@exclude_option
@scattering_option
@paths_option
@click.option(
    "--scattering-model",
    type=click.Choice(["random", "vector"]),
    help="Meaning of the coefficients, if not the room's; fitted with random alone.",
)
@click.option(
    "--keep-scattering",
    is_flag=True,
    help="Keep the stated scattering; by default it is fitted too.",
)
@seed_option
@modes_option
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), all numbers (result.json), a plan (plan.png) and "
    "the coefficients' shifts (shifts.png). Nothing is written without it.",
)
@writing_options
def fit(
    room: str,
    measured: str,
    match: tuple[str, ...],
    exclude: tuple[str, ...],
    scattering: float | None,
    scattering_model: str | None,
    keep_scattering: bool,
    paths: int | None,
    seed: int,
    modes: str | None,
    out: str | None,
) -> None:
    """Calibrate ROOM (TOML) to every pair of MEASURED (CSV) by path tracing.

    ROOM states its mesh, sources and receivers (docs/files.md). Where neither it nor --scattering
    states a scattering coefficient, the fit starts at 0.1.

    No fit ends farther from MEASURED than it began. Where no step leads nearer, the start is returned,
    the exit code is 7, and nothing is written without --force.

    Four times as many paths as --paths are weighed. The control runs take most of the time. They are
    kept beside ROOM, in .rtcal_cache, so that a second calibration is quicker.

    Example: rtcal fit room.toml pairs.csv --out fitted
    """
    from rtcal.acoustics.room import Room
    from rtcal.finder.means.engines import FOLDER
    from rtcal.io import geometry_files
    from rtcal.loop.control_runs import RUNS
    from rtcal.loop.positions import calibrate_positions
    from rtcal.report import figures
    from rtcal.support.speed import bar, following

    folder = output_folder("--out", out)
    stated = Room.from_file(room)
    if folder is not None:
        mesh = [] if stated.scene.mesh is None else [stated.scene.mesh]
        read = [room, measured, *mesh, *([] if modes is None else [modes])]
        spare([folder / name for name in figures.POSITION_FILES], read)
    heard = read_measured(measured)
    if stated.scattering is None and scattering is None and not keep_scattering:
        scattering = _START
        if not is_quiet():
            warn(
                f"{room} states no scattering: the fit starts at {_START:g} for every material and "
                "band, and --scattering states another start"
            )
    told = None
    if modes is not None:
        with without_air_warning():
            told = told_by_modes(stated, modes)
    with errors_name_options("scattering", "n_paths"), without_air_warning():
        tracer = geometry_files.path_tracing(
            stated, scattering=scattering, scattering_model=scattering_model, n_paths=paths or PATHS
        )
        with bar(RUNS, "control run", bar_wanted(), said()) as shown:
            result = calibrate_positions(
                tracer,
                stated if told is None else told,
                heard,
                match or MATCH,
                exclude=pairs("--exclude", exclude),
                cache=Path(room).parent / FOLDER,
                position_uncertainty=stated.scene.position_uncertainty,
                fit_scattering=not keep_scattering,
                seed=seed,
                progress=following(shown),
            )
    if folder is not None and (is_forced() or not result.refused):
        figures.write_positions(result, folder, tracer.geometry, tracer.sources, tracer.receivers)
    tell(str(result), result.to_dict())
    if result.refused:
        raise click.exceptions.Exit(NOT_NEARER)


LIBRARY_ROOM = "room.toml"


@click.command(short_help="A library of materials from a folder of calibrated rooms.")
@click.argument("folder", type=click.Path())
@entries_option
@click.option(
    "--room-weight",
    "weights",
    multiple=True,
    metavar="ROOM=WEIGHT",
    help="How far a room counts, from 0 (left out) to 1. The option may be repeated.",
)
@click.option(
    "--apply",
    "room",
    type=click.Path(),
    help="A room (TOML) that gets the library's coefficients: room.toml of --out.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the archive (result.json), and with --apply for the room (room.toml).",
)
@writing_options
def learn(
    folder: str,
    entries: tuple[str, ...],
    weights: tuple[str, ...],
    room: str | None,
    out: str | None,
) -> None:
    """Learn from the results below FOLDER, as rtcal calibrate --out writes them.

    Example: rtcal learn rooms --apply new.toml --out library

    It prints each material's coefficients, what each room says beside the others, and which material is
    likely misnamed. Nothing leaves this machine.
    """
    from rtcal.acoustics.room import Room
    from rtcal.calibration import archive
    from rtcal.files.saved import NUMBERS

    target = output_folder("--out", out)
    if room is not None and target is None:
        raise DataError("--apply writes a room: say where with --out")
    if target is not None:
        read = [*map(str, Path(folder).rglob(NUMBERS)), *([] if room is None else [room])]
        spare([target / NUMBERS, target / LIBRARY_ROOM], read)
    called = texts("--as", entries, "MATERIAL=ENTRY")
    calibrated = archive.read_folder(folder)
    new = None if room is None else Room.from_file(room)
    of_room = {} if new is None else {m: e for m, e in called.items() if m in new.materials}
    known = {m for result in calibrated for m in archive.materials(result)}
    library = archive.learn(
        calibrated,
        {m: entry for m, entry in called.items() if m in known or m not in of_room},
        numbers("--room-weight", weights, "ROOM=WEIGHT, such as hall=0.5"),
    )
    said, record = str(library), library.to_dict()
    if others := len([*Path(folder).rglob(NUMBERS)]) - len(calibrated):
        said += f"\nLeft out, results of other kinds: {others}"
    files: dict[Path, bytes] = {}
    if target is not None:
        files = {target / NUMBERS: library.to_json(target).encode()}
        if new is not None:
            applied, left = library.apply(new, of_room), library.left_as_stated(new, of_room)
            record["left_as_stated"] = list(left)
            said = "\n".join([said, *(line for each in left for line in text.wrapped(each))])
            files[target / LIBRARY_ROOM] = applied.to_text(target).encode()
        make_folder(target)
        write_all(files)
    tell(said, record)


@click.command(short_help="The paper's stochastic study beside its numbers.")
@click.option(
    "--kind",
    "rooms",
    type=click.Choice(("shoebox", "lecture-hall", "halls")),
    multiple=True,
    default=("shoebox",),
    show_default=True,
    help="shoebox: Tables 1 and 2. lecture-hall: Table 3, with a stand-in, since the paper does not "
    "state the areas. halls: five random halls, analytic. The option may be repeated.",
)
@click.option(
    "--sigma-r",
    multiple=True,
    type=float,
    default=(0.01, 0.05, 0.1),
    show_default=True,
    help="Parameter of the Rayleigh distribution of sigma. The option may be repeated.",
)
@click.option(
    "--sampling",
    type=click.Choice(("sigma_r", "sigma_n")),
    default="sigma_r",
    show_default=True,
    help="How far the stated coefficients keep from 0 and 1. sigma_r: twice the Rayleigh parameter, "
    "which gives the paper's Table 2. sigma_n: twice each surface's uncertainty, as its text reads.",
)
@click.option(
    "--realisations",
    type=click.IntRange(1),
    default=10_000,
    show_default=True,
    help="Rooms drawn.",
)
@click.option(
    "--trials",
    type=click.IntRange(0),
    default=10_000,
    show_default=True,
    help="Draws of the true coefficients per room; 0 for the analytic study only.",
)
@seed_option
@click.option("--workers", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    help="Folder of finished pieces, from which an interrupted study resumes.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the tables (CSV) and figures (PNG).",
)
@writing_options
def study(
    rooms: tuple[str, ...],
    sigma_r: tuple[float, ...],
    sampling: str,
    realisations: int,
    trials: int,
    seed: int,
    workers: int | None,
    folder: str | None,
    out: str | None,
) -> None:
    """Simulate random rooms and score every calibration method, beside the paper's tables.

    The same --seed gives the same tables.

    Example: rtcal study --kind shoebox --sampling sigma_n --out study
    """
    from rtcal.report import study_report

    target = output_folder("--out", out)
    if target is not None:
        make_folder(target)
    with errors_name_options("sigma_r"):
        report = study_report.report(
            rooms,
            sigma_r,
            realisations,
            trials,
            seed,
            sampling=sampling,  # type: ignore[arg-type]
            workers=workers,
            folder=output_folder("--folder", folder),
            progress=bar_wanted(),
            with_files=target is not None,
        )
    if target is not None:
        write_all({target / name: content for name, content in report.files.items()})
    record = {
        "sampling": sampling,
        "realisations": realisations,
        "trials": trials,
        "seed": seed,
        "studies": report.records,
    }
    tell(str(report), record)
