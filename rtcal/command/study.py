"""``rtcal study``: the paper's stochastic study beside the paper's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command.console import bar_wanted, json_option, json_text, quiet_option
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.studies import Study
    from rtcal.studies.study import Table

ROOMS = ("shoebox", "lecture-hall", "halls")
NAMES = {"none": "BASE", "scaling": "REF", "lse": "LSE", "mle": "MLE"}


@click.command(short_help="The paper's stochastic study beside its numbers.")
@click.option(
    "--room",
    "rooms",
    type=click.Choice(ROOMS),
    multiple=True,
    default=("shoebox",),
    show_default=True,
    help="shoebox: Tables 1 and 2. lecture-hall: Table 3 with a stand-in for the hall, whose areas "
    "the paper does not give. halls: five halls at random, analytic. May be given several times.",
)
@click.option(
    "--sigma-r",
    multiple=True,
    type=float,
    default=(0.01, 0.05, 0.1),
    show_default=True,
    help="Parameter of the Rayleigh distribution of sigma. May be given several times.",
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
    help="Draws of the true coefficients for each room; 0: the analytic study only.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the random numbers: the same seed, the same tables.",
)
@click.option("--workers", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    help="Keep finished pieces here and go on from them after an interruption.",
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

    Example: rtcal study --room shoebox --room halls --out study
    """
    from rtcal import studies
    from rtcal.studies import paper

    for option, value in (("--out", out), ("--folder", folder)):
        if value == "":
            raise DataError(f"{option} is empty; it is a folder")

    def say(text: str) -> None:
        if not quiet and not as_json:
            click.echo(text)

    found: list[dict[str, Any]] = []
    target = None
    if out is not None:
        from rtcal.report import figures

        figures.new_figure()  # without matplotlib, stop here and not after the study
        target = _folder(out)
    areas = {
        "shoebox": list(studies.rooms.SHOEBOX),
        "lecture-hall": list(studies.rooms.LECTURE_HALL.values()),
    }
    for name in dict.fromkeys(rooms):
        if name == "halls":
            text, tables = _halls(sigma_r, realisations, seed)
            say(text)
            found += tables
            continue
        printed = paper.TABLE_2 if name == "shoebox" else paper.TABLE_3
        say(_heading(name))
        for level in sigma_r:
            index = paper.SIGMA_R.index(level) if level in paper.SIGMA_R else None
            reference = None if index is None else {m: v[index] for m, v in printed.items()}
            if trials == 0:
                table = studies.analytic_scores(areas[name], level, realisations, seed)
                say(_scores(level, table, reference))
                found.append({"room": name, "sigma_r": level, "scores": table})
                if target is not None:
                    studies.write_table(table, target / f"{name}-{level:g}-analytic-scores.csv")
                continue
            place = None if folder is None else Path(folder) / f"{name}-{level:g}"
            done = studies.run(
                areas[name],
                level,
                realisations,
                trials,
                seed,
                workers=workers,
                folder=place,
                progress=bar_wanted(quiet),
            )
            say(_scores(level, done.scores(), reference))
            say(_bounds(done))
            found.append(
                {
                    "room": name,
                    "sigma_r": level,
                    "scores": done.scores(),
                    "bound_effects": done.bound_effects(),
                }
            )
            if target is not None:
                _write(done, target, f"{name}-{level:g}")
        if name == "shoebox":
            say(_table_1())
    if target is not None:
        _write_priors(target)
    if as_json and not quiet:
        click.echo(
            json_text(
                {
                    "realisations": realisations,
                    "trials": trials,
                    "seed": seed,
                    "studies": found,
                }
            )
        )


def _heading(name: str) -> str:
    if name == "shoebox":
        return "Shoebox, N = 6, V = 105 m³; calibration scores in %; paper: Table 2"
    return (
        "Lecture hall, N = 23, V = 334 m³: a stand-in with the paper's N, V and ratio of areas, not\n"
        "the paper's hall; calibration scores in %; paper: Table 3"
    )


def _scores(sigma_r: float, table: Table, paper: dict[str, float] | None) -> str:
    from rtcal.studies.sampling import redrawn_share

    lines = [
        f"\nsigma_R = {sigma_r:g} ({100 * redrawn_share(sigma_r):.4f} % of sigma drawn again)",
        f"{'method':<8}{'bounds':<8}{'AACE':>9}{'score':>9}{'± s.e.':>9}{'paper':>8}",
    ]
    for row in table:
        method = str(row.method)
        known = "" if paper is None or row.bounded else f"{paper[method]:.1f}"
        lines.append(
            f"{NAMES[method]:<8}{'0 to 1' if row.bounded else 'none':<8}{row.aace:>9.5f}"
            f"{100 * row.score:>9.3f}{100 * row.standard_error:>9.3f}{known:>8}"
        )
    return "\n".join(lines)


def _bounds(done: Study) -> str:
    lines = ["What exact bounds change, in points (unbounded as control variate):"]
    for row in done.bound_effects():
        lines.append(
            f"{NAMES[str(row.method)]:<8}{100 * row.difference:>+11.5f} ± "
            f"{100 * row.standard_error:.5f}   active in "
            f"{100 * row.active_share:.3f} % of trials"
        )
    return "\n".join(lines)


def _halls(
    sigma_r: tuple[float, ...], realisations: int, seed: int
) -> tuple[str, list[dict[str, Any]]]:
    from rtcal import studies

    lines = [
        "Five halls at random with the paper's N, V and ratio of areas (analytic, unbounded; %)",
        f"{'hall':<6}{'sigma_R':>8}"
        + "".join(f"{NAMES[m]:>16}" for m in ("scaling", "lse", "mle")),
    ]
    found: list[dict[str, Any]] = []
    for hall in studies.rooms.HALL_SEEDS:
        for level in sigma_r:
            areas = studies.rooms.random_hall(hall)
            table = studies.analytic_scores(areas, level, realisations, seed)
            found.append({"room": f"hall {hall}", "sigma_r": level, "scores": table})
            cells = "".join(
                f"{100 * row.score:>9.2f} ± {100 * row.standard_error:.2f}" for row in table[1:]
            )
            lines.append(f"{hall:<6}{level:>8g}{cells}")
    return "\n".join(lines), found


def _table_1() -> str:
    import numpy as np

    from rtcal.studies import paper, rooms

    low, high = paper.table_1_range(np.array(rooms.SHOEBOX))
    lines = ["\nTable 1, EMSE x 1e4: printed, and the 98 % range that its rounded mu, sigma allow"]
    for i, (method, value) in enumerate(paper.TABLE_1_EMSE.items()):
        lines.append(
            f"{NAMES[method]:<8}{1e4 * value:>6.1f}   {1e4 * low[i]:.1f} to {1e4 * high[i]:.1f}"
        )
    return "\n".join(lines)


def _folder(out: str) -> Path:
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{out}: {error.strerror or error}") from error
    return folder


def _write(done: Study, folder: Path, stem: str) -> None:
    from rtcal import studies
    from rtcal.report import figures, study_figures

    tables = {
        "scores": done.scores(),
        "controlled-scores": done.controlled_scores(),
        "bound-effects": done.bound_effects(),
        "spread": done.spread(),
    }
    for name, table in tables.items():
        studies.write_table(table, folder / f"{stem}-{name}.csv")
    title = f"{stem}: {done.realisations:,} realisations of {done.trials:,} trials"
    figure = study_figures.spread(done.spread(), done.scores().aace.tolist(), title)
    figures.save(figure, folder / f"{stem}-spread.png")


def _write_priors(folder: Path) -> None:
    from rtcal.report import figures, study_figures
    from rtcal.studies import paper

    three = study_figures.priors((0.2, 0.5, 0.7), (0.02, 0.05, 0.1), "Truncated normals (Fig. 2)")
    figures.save(three, folder / "priors.png")
    one = study_figures.priors(paper.TABLE_1_MU, paper.TABLE_1_SIGMA, "Table 1's room (Fig. 4a)")
    figures.save(one, folder / "table-1-priors.png")
