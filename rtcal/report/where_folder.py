"""The folder of a finding in a geometry: the page, the finding's numbers, the figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rtcal.report import document, where_figures
from rtcal.report.document import Heading
from rtcal.report.figures import rendered
from rtcal.support.arguments import checked
from rtcal.support.encode import json_text
from rtcal.support.files import make_folder, write_all
from rtcal.where.finding import Finding
from rtcal.where.verification import Verification

PAGE, NUMBERS, MAP, SURFACES, GAP = (
    "report.html",
    "finding.json",
    "map.png",
    "surfaces.png",
    "gap.png",
)
FILES = (PAGE, NUMBERS, MAP, SURFACES, GAP)
_SAID = 0.03
"""Probability below which a candidate is not printed."""


@checked
def write(
    finding: Finding,
    verification: Verification | None,
    folder: Path,
    heading: Heading | None = None,
    command: str = "",
) -> list[Path]:
    """Write page, numbers and figures, all or none, and return their paths.

    Raises
    ------
    MissingDependencyError
        Without matplotlib or jinja2.
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    record = finding.to_dict()
    drawn = {
        MAP: where_figures.disagreement(finding),
        SURFACES: where_figures.surfaces(finding),
    }
    if verification is not None:
        record["verification"] = verification.to_dict()
        drawn[GAP] = where_figures.bars(verification)
    contents = {
        folder / PAGE: page(finding, verification, drawn, heading or Heading(), command).encode(),
        folder / NUMBERS: (json_text(record) + "\n").encode(),
    }
    contents |= {folder / name: rendered(figure, "png") for name, figure in drawn.items()}
    make_folder(folder)
    write_all(contents)
    return list(contents)


_CAPTIONS = {
    MAP: "Residuals in standard deviations of what prior, simulator and measurement leave open: by "
    "pair on the plan, and by parameter and band.",
    SURFACES: "Each surface is as orange as it is probable, given that something stands on a surface.",
    GAP: "Mean gap at pairs that were not fitted; whiskers are the range over the simulator's seeds. "
    "The dotted line is 1 JND.",
}


@checked
def page(
    finding: Finding,
    verification: Verification | None,
    drawn: dict[str, Any],
    heading: Heading,
    command: str = "",
) -> str:
    """Return the page; the three gaps stand in front.

    ``drawn`` are the figures by the names of their files.
    """
    pictures = {
        name: {
            "alt": _CAPTIONS[name],
            "caption": _CAPTIONS[name],
            "source": document.source(figure, lambda: None),
        }
        for name, figure in drawn.items()
    }
    said = [c for c in finding.candidates if c.probability >= _SAID][:8]
    values = {
        "finding": finding,
        "verification": verification,
        "parameters": [p.upper() for p in finding.parameters],
        "candidates": said if finding.verdict != "none" else [],
        "bars": pictures.get(GAP),
        "surfaces": pictures[SURFACES],
        "map": pictures[MAP],
        "notes": [*finding.reasons, *finding.notes],
        "command": command,
    }
    return document.render("where.html", values, heading.or_title(finding.case.room.name))
