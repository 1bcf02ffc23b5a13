"""The folder of a finding in a geometry: the finding, the corrected room, the figures."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rtcal.errors import MissingDependencyError
from rtcal.report import where_figures
from rtcal.report.figures import rendered
from rtcal.support.encode import json_text
from rtcal.support.files import make_folder, write_all
from rtcal.where.finding import Finding
from rtcal.where.verification import Verification

NUMBERS, MAP, SURFACES, GAP = "finding.json", "map.png", "surfaces.png", "gap.png"
FILES = (NUMBERS, MAP, SURFACES, GAP)


def write(finding: Finding, verification: Verification | None, folder: Path) -> list[Path]:
    """Write numbers and figures, all or none, and return their paths.

    Without matplotlib there are no figures, and a warning says so.
    """
    record = finding.to_dict()
    if verification is not None:
        record["verification"] = verification.to_dict()
    contents = {folder / NUMBERS: (json_text(record) + "\n").encode()}
    draw: dict[str, Callable[[], Any]] = {
        MAP: lambda: where_figures.disagreement(finding),
        SURFACES: lambda: where_figures.surfaces(finding),
    }
    if verification is not None:
        draw[GAP] = lambda: where_figures.bars(verification)
    try:
        contents |= {folder / name: rendered(figure(), "png") for name, figure in draw.items()}
    except MissingDependencyError as error:
        warnings.warn(f"no figures: {error}", stacklevel=2)
    make_folder(folder)
    write_all(contents)
    return list(contents)
