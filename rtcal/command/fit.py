"""``rtcal fit``: coefficients from what every position heard, by path tracing in the room's mesh."""

from __future__ import annotations

from pathlib import Path

import click

from rtcal.acoustics.observables import MATCH
from rtcal.command.console import (
    PATHS,
    bar_wanted,
    errors_name_options,
    exclude_option,
    json_option,
    match_option,
    output_folder,
    pairs,
    paths_option,
    quiet_option,
    read_measured,
    said,
    scattering_option,
    seed_option,
    tell,
    warn,
    without_air_warning,
    written,
)

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
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the calibrated room (room.toml), all numbers (result.json), a plan (plan.png) and "
    "the coefficients' shifts (shifts.png). Nothing is written without it.",
)
@json_option
@quiet_option
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
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrate ROOM (TOML) to every pair of MEASURED (CSV) by path tracing.

    ROOM states its mesh, sources and receivers (docs/files.md). Where neither it nor --scattering
    states a scattering coefficient, the fit starts at 0.1.

    Four times as many paths as --paths are weighed. The control runs take most of the time. They are
    kept beside ROOM, in .rtcal_cache, so that a second calibration is quicker.

    Example: rtcal fit room.toml pairs.csv --out fitted
    """
    from rtcal.acoustics.room import Room
    from rtcal.finder.means.bootstrap import FOLDER
    from rtcal.io import geometry_files
    from rtcal.loop.control_runs import RUNS
    from rtcal.loop.positions import calibrate_positions
    from rtcal.report import result_folder
    from rtcal.support.files import spare
    from rtcal.support.progress import bar

    folder = output_folder("--out", out)
    stated = Room.from_file(room)
    if folder is not None:
        mesh = [] if stated.scene.mesh is None else [stated.scene.mesh]
        spare([folder / name for name in result_folder.POSITION_FILES], [room, measured, *mesh])
    heard = read_measured(measured, quiet=quiet)
    if stated.scattering is None and scattering is None and not keep_scattering:
        scattering = _START
        if not quiet:
            warn(
                f"{room} states no scattering: the fit starts at {_START:g} for every material and "
                "band, and --scattering states another start"
            )
    with errors_name_options("scattering", "n_paths"), without_air_warning():
        tracer = geometry_files.path_tracing(
            stated, scattering=scattering, scattering_model=scattering_model, n_paths=paths or PATHS
        )
        with bar(RUNS, "control run", bar_wanted(quiet), said(quiet)) as shown:
            result = calibrate_positions(
                tracer,
                stated,
                heard,
                match or MATCH,
                exclude=pairs("--exclude", exclude),
                cache=Path(room).parent / FOLDER,
                position_uncertainty=stated.scene.position_uncertainty,
                fit_scattering=not keep_scattering,
                seed=seed,
                progress=lambda done, total: shown.update(1),
            ).traced()
    text = str(result)
    if folder is not None:
        paths_written = result_folder.write_positions(
            result, folder, tracer.geometry, tracer.sources, tracer.receivers
        )
        text += "\n" + written(paths_written)
    tell(text, result.to_dict(), quiet=quiet, as_json=as_json)
