"""The report of a finding: figures, JSON and the page, all written or none."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.files import write_all
from rtcal.calibration.presets import calibrate
from rtcal.discrepancy.corrected import EQUATIONS
from rtcal.discrepancy.finding import Finding
from rtcal.discrepancy.recalibration import table
from rtcal.discrepancy.verification import Verification, verify
from rtcal.errors import DataError, MissingAirWarning
from rtcal.report import gap_figures
from rtcal.report.figures import rendered
from rtcal.report.page import page


def figures(finding: Finding, verification: Verification | None) -> dict[str, tuple[Any, str]]:
    """Return the figures by name, each with its caption."""
    drawn = {"evidence": (
        gap_figures.evidence(finding),
        "Evidence of every effect over the model as it stands; a finding must exceed the threshold.",
    )}  # fmt: skip
    if verification is None:
        drawn["residuals"] = (
            gap_figures.residuals(finding),
            "Where measurement and model differ, in standard deviations.",
        )  # fmt: skip
        return drawn
    drawn |= {
        "residuals": (
            gap_figures.residuals(finding, verification),
            "Where measurement and model differ, in standard deviations: before and after.",
        ),
        "reverberation_time": (
            gap_figures.reverberation_time(verification),
            "T(f). Plain calibration meets T whatever is missing: that proves nothing.",
        ),
        "decay": (
            gap_figures.decay(verification),
            "The decay in the band whose shape differs most. Alpha cannot change this shape.",
        ),
        "shifts": (
            gap_figures.shifts(verification),
            "How far the coefficients had to move, with and without the effect in the model, and "
            "their 90 % intervals: a plain calibration's count on a model that lacks nothing.",
        ),
    }
    return drawn


def write(finding: Finding, folder: Path) -> list[Path]:
    """Write finding.json, the figures (PNG) and report.html; return their paths.

    Raises DataError if the folder cannot be made, MissingDependencyError without matplotlib or jinja2.
    """
    verified = verify(finding) if finding.verdict in ("named", "ambiguous") else None
    drawn = figures(finding, verified)
    record = finding.to_dict()
    if verified is not None:
        record["verification"] = verified.to_dict()
    first = finding.case.configurations[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # among the finding's notes
        usual = calibrate(
            finding.case.room, first.measured, unreachable="nearest",
            equation=EQUATIONS.get(finding.case.equation, Eyring()),
        )  # fmt: skip
    text = page(usual, finding=summary(finding, verified), finding_figures=list(drawn.values()))
    contents = {
        folder / "finding.json": (json.dumps(record, indent=1) + "\n").encode(),
        folder / "report.html": text.encode(),
        **{folder / f"{name}.png": rendered(figure, "png") for name, (figure, _) in drawn.items()},
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: {error.strerror or error}") from error
    write_all(contents)
    return list(contents)


def summary(finding: Finding, verification: Verification | None) -> dict[str, Any]:
    """Return what the page says of a finding."""
    lines = str(finding).splitlines()
    sentences = [lines[0], *(x.strip() for x in lines[1:] if x.startswith("  ") and ":" in x[:20])]
    if verification is not None:
        sentences += [
            str(verification).splitlines()[0],
            "What alpha cannot absorb: nothing of it was measured."
            if np.isnan(verification.before)
            else f"What alpha cannot absorb: {verification.before:.2f} JND with plain calibration, "
            f"{verification.after:.2f} JND with the effect.",
            *table(verification.finding.case.room, {"corrected": verification.corrected})[-1:],
        ]
    return {
        "summary": [s for s in sentences if not s.startswith(("note:", "residuals"))],
        "verdict": finding.verdict, "effect": finding.effect or "",
        "candidates": list(finding.candidates), "evidence": dict(finding.evidence),
        "notes": list(finding.notes),
    }  # fmt: skip
