"""``rtcal study``: the paper's stochastic study beside the paper's numbers."""

from __future__ import annotations

import click

from rtcal.command.console import (
    bar_wanted,
    errors_name_options,
    json_option,
    output_folder,
    quiet_option,
    seed_option,
    tell,
)


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
@json_option
@quiet_option
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
    as_json: bool,
    quiet: bool,
) -> None:
    """Simulate random rooms and score every calibration method, beside the paper's tables.

    The same --seed gives the same tables.

    Example: rtcal study --kind shoebox --sampling sigma_n --out study
    """
    from rtcal.report import study_report
    from rtcal.support.files import make_folder, write_all

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
            progress=bar_wanted(quiet),
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
    tell(str(report), record, quiet=quiet, as_json=as_json)
