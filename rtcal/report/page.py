"""The HTML pages of a calibration, also to room modes, and of a finding, for readers without Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import MAX_BYTES
from rtcal.calibration import table
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.verdict import CalibrationVerdict
from rtcal.modes.result import ModesResult
from rtcal.modes.room_modes import DECAY
from rtcal.report import (
    figures,
    material_figures,
    room_view,
    words,
)
from rtcal.report.document import Heading, blocks, data_of, material_rows, render, source
from rtcal.report.figures import BLACK, BLUE, ORANGE, new_figure
from rtcal.support.blocks import Row
from rtcal.support.types import Array

__all__ = ["calibration_page", "finding_page"]
__dir__ = __all__.copy

MOST_MATERIALS = 100
"""Largest number of materials in the page's table, which lists those that absorb most."""
FINDING_FIGURES = (
    "evidence",
    "probabilities",
    "residuals",
    "reverberation_time",
    "decay",
    "shifts",
)
"""Names of a finding's figures; those that a finding lacks are left out of its page."""


def calibration_page(
    result: CalibrationResult,
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a calibration as one HTML page under 2 MB, without scripts and links to the network.

    Parameters
    ----------
    result : CalibrationResult
    heading : Heading, optional
        Title, author and date; by default the room's name and author.
    progress : callable, optional
        Called after each figure.

    Raises
    ------
    MissingDependencyError
        Without jinja2 or matplotlib.
    DataError
        If the page would be larger than 2 MB.
    """
    values = _calibration(result, progress or (lambda: None), result.verdict)
    return render("calibration.html", values, _heading(heading, result))


def finding_page(
    result: CalibrationResult,
    finding: Mapping[str, Any],
    pictures: Mapping[str, tuple[Any, str]],
    *,
    heading: Heading | None = None,
) -> str:
    """Return a finding as one HTML page: finding, corrected result, and last the plain one.

    Parameters
    ----------
    result : CalibrationResult
        The plain result.
    finding : mapping
        As `rtcal.report.gap_report.summary` returns it.
    pictures : mapping of str to (figure, caption)
        Figures of the finding by name, as `rtcal.report.gap_report.figures` returns them.
    heading : Heading, optional
        As for `calibration_page`.

    Raises
    ------
    MissingDependencyError
        Without jinja2 or matplotlib.
    DataError
        If the page would be larger than 2 MB.
    """
    drawn = {
        name: {"source": source(figure, lambda: None), "alt": caption, "caption": caption}
        for name, (figure, caption) in pictures.items()
    }
    values = {
        **_calibration(result, lambda: None, _beside(result.verdict, finding["level"])),
        "finding": {**finding, "figures": dict.fromkeys(FINDING_FIGURES) | drawn},
    }
    return render("finding.html", values, _heading(heading, result))


def _beside(plain: CalibrationVerdict, of_finding: str) -> CalibrationVerdict:
    """Return the plain calibration's verdict on the page of a finding that says more than it."""
    if plain.level != "agrees" or of_finding == "agrees":
        return plain
    return CalibrationVerdict(
        "open",
        "By T alone, nothing contradicts what was stated of the materials",
        f"{plain.text} The finding above rests on more than this, and comes first.",
    )


def _heading(heading: Heading | None, calibration: CalibrationResult) -> Heading:
    return (heading or Heading()).completed(calibration.prior.name, calibration.prior.author)


def _calibration(
    calibration: CalibrationResult, step: Callable[[], None], agreed: CalibrationVerdict
) -> dict[str, Any]:
    """Return what the template of a calibration shows."""
    clean, marked = words.usable(calibration)
    shifts, shift_count = words.large_shifts(calibration)
    certified = calibration.certificate
    certificate = {
        "primal": _worst(certified.primal_residual),
        "dual": _worst(certified.dual_residual),
        "gap": _worst(certified.duality_gap),
        "error": _worst(certified.alpha_error_bound),
    }
    return {
        "calibration": calibration,
        **words.lead(calibration, agreed),
        "summary": words.summary(calibration, agreed),
        "verdict": agreed,
        "hertz": words.hertz,
        "clean": clean,
        "marked": marked,
        "doubts": words.doubts(calibration.trust_marks),
        "shifts": shifts,
        "shift_count": shift_count,
        "large_shift": f"{words.LARGE_SHIFT:g}",
        "not_met": words.not_met(calibration),
        "figures": _figures(calibration, step),
        "blocks": blocks(len(calibration.prior.centre_frequencies)),
        "labels": bands.labels(calibration.prior.centre_frequencies),
        "band_rows": _band_rows(calibration),
        "materials": _materials(calibration),
        "interval_note": _interval_note(calibration),
        "assumed": words.assumed(calibration),
        "sources": [
            (m, calibration.prior.sources[m])
            for m in calibration.prior.materials
            if calibration.prior.sources.get(m)
        ],
        "certificate": certificate,
        **room_view.of_calibration(calibration),
        "inputs": _inputs(calibration),
        "command": words.command(calibration),
        "composed": words.composed(calibration),
    }


def _worst(values: Array) -> str:
    return f"{values.max():.1e}" if np.isfinite(values).all() else "unknown"


def _figures(calibration: CalibrationResult, step: Callable[[], None]) -> dict[str, dict[str, str]]:
    drawn: dict[str, tuple[Any, str, str]] = {
        "gap": (
            figures.gap(calibration),
            "Gap to the measured reverberation time by band, before and after",
            "How far the model's reverberation time was from the measured one: before (bars) and after "
            f"calibration (dots), in {words.compared(calibration)}. One JND, the just noticeable "
            "difference, is 5 %.",
        ),
        "reverberation_time": (
            figures.reverberation_time(calibration),
            "Reverberation time by band: measured, before, after",
            "Reverberation time by band, with the band of one JND around the measured one.",
        ),
        "coefficients": (
            material_figures.coefficients(calibration),
            "Absorption coefficients by material and band",
            "Absorption coefficients before and after, with 90 % intervals. Where the two intervals "
            "are alike, the measurement taught nothing about the material.",
        ),
        "shares": (
            material_figures.shares(calibration),
            "Share of each material in the absorption by band",
            "Who absorbs: each material's share of the room's whole absorption, after calibration.",
        ),
    }
    if len(calibration.prior.materials) > 1 and calibration.matched.any():
        drawn["plane"] = (
            material_figures.plane_of(calibration),
            "The calibration in the plane of two materials",
            "The step that the calibration takes, shown for two materials: from what was stated "
            "to what the method chose. On the line lie all coefficients that give the measured "
            "reverberation time.",
        )
    encoded = {
        name: {
            "source": source(figure, step),
            "alt": f"{calibration.prior.name}: {alt}",
            "caption": caption,
        }
        for name, (figure, alt, caption) in drawn.items()
    }
    return encoded | ({} if "plane" in encoded else {"plane": {}})


def _band_rows(calibration: CalibrationResult) -> list[Row]:
    """Return the rows of the table by band: those that are printed, and the absorption area."""
    rows = table.band_rows(calibration.to_dict())
    area = calibration.prior.areas @ calibration.alpha
    return [*rows[:-2], Row("absorption area of the surfaces / m²", area, ".2f"), *rows[-2:]]


def _materials(calibration: CalibrationResult) -> list[dict[str, Any]]:
    low, high = material_figures.intervals(calibration)
    size = np.max(calibration.prior.areas[:, np.newaxis] * calibration.alpha, axis=1)
    rows = np.sort(np.argsort(-size, kind="stable")[:MOST_MATERIALS])
    return material_rows(
        [calibration.prior.materials[i] for i in rows],
        calibration.prior.areas[rows],
        calibration.prior.alpha[rows],
        calibration.alpha[rows],
        (low[rows], high[rows]),
        calibration.active[rows] != 0,
    )


def _interval_note(calibration: CalibrationResult) -> str:
    if calibration.interval is not None and calibration.joint.has_shared_errors:
        return (
            "The intervals are those of a normal density within the bounds, for each coefficient by "
            "itself: all bands share what the room states of its uncertainty, and the exact posterior "
            "distribution would need samples. The calibrated coefficient lies within its interval."
        )
    if calibration.interval is not None:
        return (
            "The intervals are those of the exact posterior distribution, within the bounds, with the "
            "uncertainty of T where it is known. The calibrated coefficient lies within its interval."
        )
    return (
        "The intervals are those of the linear estimate, alpha ± 1.645 standard deviations cut to 0 to "
        "1: exact ones would need samples here, or the method has no posterior distribution."
    )


def _inputs(calibration: CalibrationResult) -> dict[str, str] | None:
    """Return the two files as data URIs; None if the room exceeds the largest size of a file."""
    inputs = table.inputs(calibration.prior, calibration.measured_data)
    texts = {key: text.encode() for key, text in inputs.items()}
    if len(texts["room"]) > MAX_BYTES:
        return None
    return {key: data_of(text) for key, text in texts.items()}


def modes_page(result: ModesResult, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.calibration_page`."""
    room = result.prior
    measured = np.isfinite(result.data.reverberation_time)
    carries = np.where(result.below, np.where(result.carried, "modes", "–"), "T")
    return render(
        "modes.html",
        {
            "result": result,
            "decays": {
                "source": source(_decays(result), step),
                "alt": f"{room.name}: decay times of the modes, measured, before and after",
                "caption": "Decay time of each mode used: measured, with the stated coefficients, and "
                "after the calibration.",
            },
            "rows": result.mode_rows,
            "remarks": [*result.every_note[:2], *result.notes],
            "command": "rtcal calibrate room.toml t.csv --modes modes.csv --out calibrated"
            if measured.any()
            else "rtcal.calibrate_modes(room, modes)",
            "labels": bands.labels(room.centre_frequencies),
            "blocks": blocks(room.n_bands),
            "carries": [
                Row("carried by", np.where(result.below | measured, carries, "–").tolist())
            ],
            "materials": material_rows(
                room.materials,
                room.areas,
                room.alpha,
                result.alpha,
                result.interval,
                np.isin(result.alpha, (0.0, 1.0)),
            ),
            "doubts": words.doubts(result.trust_marks),
        },
        heading.completed(room.name, room.author),
    )


def _decays(result: ModesResult) -> Any:
    """Return the decay times of the modes used over their frequencies."""
    figure, axes = new_figure()
    f = result.modes.frequencies[result.used]
    t, relative = DECAY / result.measured, result.modes.decay_uncertainty[result.used]
    axes.errorbar(f, t, t * relative / result.measured, fmt="o", color=BLACK, label="measured")
    axes.plot(f, DECAY / result.before, "x", color=ORANGE, label="before")
    axes.plot(f, DECAY / result.after, "s", color=BLUE, fillstyle="none", label="after")
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("T / s")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure
