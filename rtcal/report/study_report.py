"""The stochastic study as printed text, tables and figures, beside the paper's numbers.

The figures are like Figs. 2 and 4 of Bellows & Katz (2025).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rtcal.report.figures import new_figure, rendered
from rtcal.studies import paper
from rtcal.studies.paper import (
    HALL_SEEDS,
    LECTURE_HALL,
    SHOEBOX,
    Sampling,
    random_hall,
    redrawn_share,
)
from rtcal.studies.study import Study, analytic_scores, run, table_csv
from rtcal.studies.study import Table as Scores
from rtcal.support import checks
from rtcal.support.blocks import Block, Note, Row, Table, lines

__all__ = ["priors", "report", "spread"]
__dir__ = __all__.copy


_STYLES = ("-", "--", "-.", ":", (0, (9, 3)), (0, (7, 2, 1, 2, 1, 2)))
_MARKERS = "os^Dv*"
NAMES = {"none": "BASE", "scaling": "REF", "lse": "LSE", "mle": "MLE"}


def priors(mu: Sequence[float], sigma: Sequence[float], title: str) -> Any:
    """Return the figure of the probability densities of input coefficients.

    The densities are normal, truncated at 0 and 1, as in Figs. 2 and 4a of Bellows & Katz (2025).
    ``mu`` and ``sigma`` are their parameters, one per material, and ``title`` is the title of the
    figure, a matplotlib Figure.
    """
    from scipy.stats import truncnorm

    figure, axes = new_figure()
    alpha = np.linspace(0, 1, 1001)
    for i, (m, s) in enumerate(zip(mu, sigma, strict=True)):
        density = truncnorm.pdf(alpha, -m / s, (1 - m) / s, m, s)
        label = f"μ = {m:g}, σ = {s:g}"
        axes.plot(
            alpha,
            density,
            linestyle=_STYLES[i % len(_STYLES)],
            marker=_MARKERS[(i + i // len(_STYLES)) % len(_MARKERS)],
            markevery=[int(density.argmax())],
            label=label,
        )
    axes.set_xlabel("Absorption coefficient α")
    axes.set_ylabel("Probability density")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.set_title(title)
    axes.legend()
    return figure


def spread(table: Scores, aace: Sequence[float], title: str) -> Any:
    """Return the box plot of the error of alpha over random rooms, for each calibration method.

    The error is the root of the expected mean square error (EMSE), as in Fig. 4b of Bellows & Katz
    (2025).
    ``table`` comes from `Study.spread`. ``aace`` has the average coefficient error (AACE) of each row
    of the table, which is drawn as a dashed line. ``title`` is the title of the matplotlib Figure.
    """
    figure, axes = new_figure()
    boxes = [
        {
            "label": NAMES[str(r.method)] + ("\nbounded" if r.bounded else ""),
            "whislo": r.least,
            "q1": r.first_quartile,
            "med": r.median,
            "q3": r.third_quartile,
            "whishi": r.most,
            "mean": mean,
        }
        for r, mean in zip(table, aace, strict=True)
    ]
    axes.bxp(boxes, showfliers=False, showmeans=True, meanline=True)
    axes.set_ylabel("Root of EMSE of α, over realisations")
    axes.set_ylim(bottom=0)
    axes.set_title(title + " (dashed: AACE)")
    axes.set_xlabel("Calibration method")
    return figure


AREAS = {"shoebox": list(SHOEBOX), "lecture-hall": list(LECTURE_HALL.values())}
"""Surface areas in m² of the rooms with random true coefficients, by the name of the room."""

_LEGEND = (
    "Calibration methods in random rooms. Each room has uncertain input coefficients alpha, and each "
    "trial draws the true ones.",
    "BASE: not calibrated. REF: all coefficients scaled by the same factor. LSE: the smallest changes. "
    "MLE: the likeliest changes.",
    "error: root mean square error of a coefficient over all rooms and trials (the paper's AACE).",
    "score: by how much the error is smaller than that of BASE. ±: its standard error.",
    "bounded: alpha is kept from 0 to 1, which the paper does not do.",
    "paper: the score in Bellows & Katz (2025).",
)
_SAMPLINGS: dict[Sampling, str] = {
    "sigma_r": "sampling: the input alpha lie between 2 sigma_R and 1 - 2 sigma_R, which gives the "
    "paper's Table 2. The paper's text has 2 sigma_n in place of 2 sigma_R: for this give --sampling "
    "sigma_n.",
    "sigma_n": "sampling: the input alpha lie between 2 sigma_n and 1 - 2 sigma_n, with the surface's "
    "own sigma_n, as the paper's text reads. Its Table 2 agrees with --sampling sigma_r.",
}
_HEADINGS = {
    "shoebox": "Shoebox: 6 surfaces, 105 m³; paper: Table 2",
    "lecture-hall": "Lecture hall: 23 surfaces, 334 m³; paper: Table 3. It is a stand-in with the "
    "paper's number of surfaces, volume and ratio of areas, not the paper's hall.",
}
_PAPER_SCORES = {"shoebox": paper.TABLE_2, "lecture-hall": paper.TABLE_3}


@dataclass(frozen=True)
class StudyReport:
    """Hold the printed text of a study, its tables as plain records, and its files by name.

    ``blocks`` are the printed paragraphs and tables, ``records`` the rows of the tables as plain
    values, and ``files`` maps names to contents in bytes.
    """

    blocks: list[Block] = field(default_factory=list)
    records: list[dict[str, Any]] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)

    def __str__(self) -> str:
        return "\n".join(lines(self.blocks))


def report(
    rooms: Sequence[str],
    sigma_r: Sequence[float],
    realisations: int,
    trials: int,
    seed: int,
    *,
    sampling: Sampling = "sigma_r",
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = False,
    with_files: bool = False,
) -> StudyReport:
    """Return the report of how much calibration improves alpha, for each room at each sigma_r.

    Parameters
    ----------
    rooms : sequence of str
        Names of the rooms: "shoebox" and "lecture-hall" (keys of `AREAS`), or "halls" for five halls
        with random areas (`rtcal.studies.paper.random_hall`), computed by a formula only.
    sigma_r : sequence of float
        Scales of the Rayleigh distribution of sigma, the uncertainty of the input coefficients.
    realisations, trials, seed, sampling, scheduler, workers, progress
        Sizes, seed and computation of the study, as for `rtcal.studies.run`. With 0 trials, only the
        scores by formula are computed.
    with_files : bool
        Whether to make the files of the tables (CSV) and figures (PNG), too.

    Returns
    -------
    StudyReport
        Report whose text is printed, with the tables as ``records`` and the ``files`` by name.

    Raises
    ------
    DataError
        As `rtcal.studies.run` does.
    MissingDependencyError
        If files are wanted and matplotlib is not installed.
    """
    for room in (rooms := checks.texts("rooms", rooms)):
        checks.choice("rooms", room, (*_HEADINGS, "halls"))
    sigma_r = checks.array("sigma_r", sigma_r).ravel().tolist()
    checks.choice("sampling", sampling, _SAMPLINGS)
    result = StudyReport([*map(Note, (*_LEGEND, _SAMPLINGS[sampling]))])
    if checks.flag("with_files", with_files):
        new_figure()
    for room in dict.fromkeys(rooms):
        if room == "halls":
            _add_halls(result, sigma_r, realisations, seed, sampling)
            continue
        result.blocks.extend([Note(""), Note(_HEADINGS[room])])
        for level in sigma_r:
            stem, record = f"{room}-{level:g}", {"room": room, "sigma_r": level}
            if trials == 0:
                scores = analytic_scores(AREAS[room], level, realisations, seed, sampling=sampling)
                result.blocks.append(_scores(room, level, sampling, scores))
                result.records.append({**record, "scores": scores})
                if with_files:
                    result.files[f"{stem}-analytic-scores.csv"] = table_csv(scores)
                continue
            study = run(
                AREAS[room],
                level,
                realisations,
                trials,
                seed,
                sampling=sampling,
                scheduler=scheduler,
                workers=workers,
                progress=progress,
            )
            scores, effects = study.scores(), study.bound_effects()
            result.blocks.extend([_scores(room, level, sampling, scores), _bound_effects(effects)])
            result.records.append({**record, "scores": scores, "bound_effects": effects})
            if with_files:
                result.files.update(_study_files(study, stem))
        if room == "shoebox":
            result.blocks.append(_table_1())
    if with_files:
        figure_2 = priors((0.2, 0.5, 0.7), (0.02, 0.05, 0.1), "Truncated normals (Fig. 2)")
        figure_4a = priors(paper.TABLE_1_MU, paper.TABLE_1_SIGMA, "Table 1's room (Fig. 4a)")
        result.files["priors.png"] = rendered(figure_2, "png")
        result.files["table-1-priors.png"] = rendered(figure_4a, "png")
    return result


def _scores(room: str, sigma_r: float, sampling: Sampling, table: Scores) -> Table:
    """Return the scores of each method, with the paper's if it states this sigma_r."""
    rows = []
    for row in table:
        method = str(row.method)
        printed = "-"
        if sigma_r in paper.SIGMA_R and not row.bounded:
            printed = f"{_PAPER_SCORES[room][method][paper.SIGMA_R.index(sigma_r)]:.1f}"
        score = [f"{100 * row.score:.3f}", f"{100 * row.standard_error:.3f}"]
        label = NAMES[method] + (", bounded" if row.bounded else "")
        rows.append(Row(label, [f"{row.aace:.5f}", *score, printed]))
    title = (
        f"sigma_R = {sigma_r:g}: the Rayleigh parameter from which the uncertainty of each coefficient "
        "is drawn."
    )
    if share := redrawn_share(sigma_r, sampling):
        title += f" {100 * share:.4f} % of them are 0.25 or more and drawn again."
    return Table(["error", "score / %", "± / %", "paper / %"], rows, title, "method")


def _bound_effects(effects: Scores) -> Table:
    rows = [
        Row(
            NAMES[str(row.method)],
            [
                f"{100 * row.difference:+.5f}",
                f"{100 * row.standard_error:.5f}",
                f"{100 * row.active_share:.3f}",
            ],
        )
        for row in effects
    ]
    title = (
        "What bounds change: the score with bounds less the score without, in percentage points, and "
        "the trials in which a coefficient is at a bound."
    )
    return Table(["change", "±", "trials at a bound / %"], rows, title, "method")


def _add_halls(
    result: StudyReport,
    sigma_r: Sequence[float],
    realisations: int,
    seed: int,
    sampling: Sampling,
) -> None:
    rows = []
    for hall in HALL_SEEDS:
        for level in sigma_r:
            table = analytic_scores(random_hall(hall), level, realisations, seed, sampling=sampling)
            result.records.append({"room": f"hall {hall}", "sigma_r": level, "scores": table})
            cells = [f"{100 * r.score:.2f} ± {100 * r.standard_error:.2f}" for r in table[1:]]
            rows.append(Row(f"{hall}", [f"{level:g}", *cells]))
    title = (
        "Five random halls with the paper's number of surfaces, volume and ratio of areas: scores in "
        "% ± standard error, computed without trials, not bounded."
    )
    columns = ["sigma_R", *(NAMES[m] for m in ("scaling", "lse", "mle"))]
    result.blocks.append(Table(columns, rows, title, "hall"))


def _table_1() -> Table:
    low, high = paper.table_1_range(np.array(SHOEBOX))
    rows = [
        Row(NAMES[method], [f"{1e4 * value:.1f}", f"{1e4 * low[i]:.1f} to {1e4 * high[i]:.1f}"])
        for i, (method, value) in enumerate(paper.TABLE_1_EMSE.items())
    ]
    title = (
        "Table 1: expected mean squared error of a coefficient in one room, times 10,000. The paper "
        "prints mu and sigma of this room rounded, so the error has a range: it contains the error of "
        "98 % of the mu and sigma that round to the printed ones."
    )
    return Table(["paper", "range"], rows, title, "method")


def _study_files(study: Study, stem: str) -> dict[str, bytes]:
    tables = {
        "scores": study.scores(),
        "controlled-scores": study.controlled_scores(),
        "bound-effects": study.bound_effects(),
        "spread": study.spread(),
    }
    title = f"{stem}: {study.realisations:,} realisations of {study.trials:,} trials"
    figure = spread(study.spread(), study.scores().aace.tolist(), title)
    files = {f"{stem}-{name}.csv": table_csv(table) for name, table in tables.items()}
    return files | {f"{stem}-spread.png": rendered(figure, "png")}
