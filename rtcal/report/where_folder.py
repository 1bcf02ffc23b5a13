"""The folder of a finding in a geometry: the page, the finding's numbers, the figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rtcal.acoustics.parameters import parameter_label
from rtcal.finder.claim import SAID
from rtcal.finder.positions.advice import Place
from rtcal.finder.positions.finding import PositionsFinding, strongest
from rtcal.finder.positions.verification import MODELS, TITLES, PositionsVerification
from rtcal.report import document, room_section, where_figures
from rtcal.report.document import Heading
from rtcal.report.figures import rendered
from rtcal.support.arguments import checked
from rtcal.support.files import make_folder, write_all
from rtcal.support.results import NUMBERS

PAGE, MAP, PLAN, ROOM, GAP = (
    "report.html",
    "map.png",
    "plan.png",
    "room.png",
    "gap.png",
)
FILES = (PAGE, MAP, PLAN, ROOM, GAP)


@checked
def write(
    finding: PositionsFinding,
    verification: PositionsVerification | None,
    folder: Path,
    heading: Heading | None = None,
    command: str = "",
    place: Place | None = None,
) -> list[Path]:
    """Write page, numbers and figures, all or none, and return their paths.

    ``place`` is a further receiver that would tell the surfaces apart.

    Raises
    ------
    MissingDependencyError
        Without matplotlib or jinja2.
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    figures = drawn(finding, verification, place)
    saved = finding if verification is None else verification
    text = page(finding, verification, figures, heading or Heading(), command, place)
    contents = {folder / PAGE: text.encode(), folder / NUMBERS: saved.to_json().encode()}
    contents |= {folder / name: rendered(figure, "png") for name, figure in figures.items()}
    make_folder(folder)
    write_all(contents)
    return list(contents)


@checked
def drawn(
    finding: PositionsFinding,
    verification: PositionsVerification | None,
    place: Place | None = None,
) -> dict[str, Any]:
    """Return the figures of the page by the names of their files."""
    out = {
        ROOM: where_figures.room(finding, place),
        PLAN: where_figures.plan(finding, place),
        MAP: where_figures.disagreement(finding),
    }
    if verification is not None:
        out[GAP] = where_figures.bars(verification)
    return out


_CAPTIONS = {
    MAP: "Residuals in standard deviations of what prior, simulator and measurement leave open: root "
    "mean squares by pair and parameter, and by parameter and band. About 1 is what is expected.",
    PLAN: "The plan. A line joins source (triangle) and receiver (circle); it is as dark as the pair "
    "disagrees. Walls are as orange as they are probable.",
    ROOM: "Each surface is as orange as it is probable, given that something stands on a surface. "
    "Those towards the reader are dashed outlines.",
    GAP: "Mean gap at pairs that were not fitted; whiskers are the range over the simulator's seeds. "
    "The dotted line is 1 JND.",
}
_LEVELS = {"supported": "agrees", "withdrawn": "contradicts", "unproven": "open"}
"""Class of the box that a verdict stands in."""


@checked
def page(
    finding: PositionsFinding,
    verification: PositionsVerification | None,
    figures: dict[str, Any],
    heading: Heading,
    command: str = "",
    place: Place | None = None,
) -> str:
    """Return the page; the three gaps stand in front.

    ``figures`` are those of `drawn`.
    """
    pictures = {
        name: {
            "alt": _said(name, finding, verification),
            "caption": _CAPTIONS[name],
            "source": document.source(figure, lambda: None),
        }
        for name, figure in figures.items()
    }
    said = [c for c in finding.candidates if c.probability >= SAID][:8]
    values = {
        "finding": finding,
        "verification": verification,
        "level": "" if verification is None else _LEVELS[verification.verdict],
        "models": TITLES,
        "parameters": [parameter_label(p) for p in finding.parameters],
        "pairs": [" to ".join(pair) for pair in finding.pairs],
        "candidates": said if finding.verdict != "none" else [],
        "bars": pictures.get(GAP),
        "plan": pictures[PLAN],
        "map": pictures[MAP],
        "place": place,
        "notes": [*finding.reasons, *finding.notes],
        "command": command,
        **room_section.of_finding(finding, verification, place),
    }
    return document.render(
        "where.html", values, heading.completed(finding.case.room.name, finding.case.room.author)
    )


def _said(name: str, finding: PositionsFinding, verification: PositionsVerification | None) -> str:
    """Return what a figure shows, in words, with its numbers."""
    if name == GAP and verification is not None:
        before, plain, after = (f"{verification.gap(m).mean():.2f}" for m in MODELS)
        return (
            f"Three bars of the mean gap at pairs that were not fitted: {before} JND as stated, "
            f"{plain} calibrated, {after} corrected and calibrated."
        )
    if name == MAP:
        p, i, k = strongest(finding.map)
        pair = " to ".join(finding.pairs[i])
        frequency = finding.case.room.centre_frequencies[k]
        return (
            "Two tables of the disagreement in standard deviations. The largest single one is "
            f"{abs(finding.map[p, i, k]):.1f}: {parameter_label(finding.parameters[p])} from {pair} at "
            f"{frequency:g} Hz."
        )
    likely = "; ".join(f"{n} {100 * finding.surfaces[n]:.0f} %" for n in finding.likely_surfaces)
    what = "no surface is coloured" if finding.verdict == "none" else f"coloured are {likely}"
    view = "The plan of the room" if name == PLAN else "The room in an axonometric view"
    return f"{view} with sources and receivers; {what}."
