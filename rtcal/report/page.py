"""The HTML pages of a calibration, a finding and a closed loop, for readers without Python."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics import room_files
from rtcal.acoustics.quality import letters
from rtcal.discrepancy.wording import NATS
from rtcal.errors import DataError
from rtcal.loop import files as loop_files
from rtcal.loop.positions_result import KIND as POSITIONS
from rtcal.loop.result import LoopResult
from rtcal.loop.state import Loop
from rtcal.report import (
    figures,
    loop_figures,
    loop_words,
    material_figures,
    positions_page,
    saved_positions,
    words,
)
from rtcal.report.document import Heading, blocks, render, source
from rtcal.report.rows import material_rows
from rtcal.report.saved import Saved, from_dict, read_json, saved
from rtcal.support.arguments import checked

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

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


@checked
def page(
    result: CalibrationResult | Saved,
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a calibration as one HTML page under 2 MB, without scripts and links to the network.

    Parameters
    ----------
    result : CalibrationResult or Saved
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
    calibration = saved(result)
    values = _calibration(calibration, progress or (lambda: None))
    return render("calibration.html", values, _heading(heading, calibration))


@checked
def finding_page(
    result: CalibrationResult | Saved,
    finding: Mapping[str, Any],
    pictures: Mapping[str, tuple[Any, str]],
    *,
    heading: Heading | None = None,
) -> str:
    """Return a finding as one HTML page: finding, corrected calibration, and last the plain one.

    Parameters
    ----------
    result : CalibrationResult or Saved
        The plain calibration.
    finding : mapping
        As `rtcal.report.gap_report.summary` returns it.
    pictures : mapping of str to (figure, caption)
        Figures of the finding by name, as `rtcal.report.gap_report.figures` returns them.
    heading : Heading, optional
        As for `page`.

    Raises
    ------
    MissingDependencyError
        Without jinja2 or matplotlib.
    DataError
        If the page would be larger than 2 MB.
    """
    calibration = saved(result)
    drawn = {
        name: {"source": source(figure, lambda: None), "alt": caption, "caption": caption}
        for name, (figure, caption) in pictures.items()
    }
    values = {
        **_calibration(calibration, lambda: None),
        "finding": {**finding, "figures": dict.fromkeys(FINDING_FIGURES) | drawn},
        "nats": NATS,
    }
    return render("finding.html", values, _heading(heading, calibration))


def _heading(heading: Heading | None, calibration: Saved) -> Heading:
    author = room_files.author(calibration.record["inputs"]["room"])
    return (heading or Heading()).completed(calibration.record["room"], author)


def _calibration(calibration: Saved, step: Callable[[], None]) -> dict[str, Any]:
    """Return what the template of a calibration shows."""
    clean, marked = words.usable(calibration)
    shifts, shift_count = words.large_shifts(calibration)
    certificate = {
        short: _worst(calibration.record["certificate"][key])
        for short, key in (
            ("primal", "primal_residual"),
            ("dual", "dual_residual"),
            ("gap", "duality_gap"),
        )
    }
    bounds = [v for m in calibration.record["materials"] for v in m["error_bound"]]
    certificate["error"] = _worst(bounds)
    return {
        "calibration": calibration,
        "headline": words.headline(calibration),
        "summary": words.summary(calibration),
        "verdict": words.verdict(calibration),
        "hertz": words.hertz,
        "clean": clean,
        "marked": marked,
        "doubts": words.doubts(calibration.trust_marks),
        "shifts": shifts,
        "shift_count": shift_count,
        "large_shift": f"{words.LARGE_SHIFT:g}",
        "not_met": words.not_met(calibration),
        "proves_nothing": words.PROVES_NOTHING,
        "figures": _figures(calibration, step),
        "blocks": blocks(len(calibration.centre_frequencies)),
        "labels": words.band_labels(calibration),
        "band_rows": _band_rows(calibration),
        "band_letters": [
            letters(calibration.trust_marks, f) for f in calibration.centre_frequencies
        ],
        "materials": _materials(calibration),
        "interval_note": _interval_note(calibration),
        "assumed": words.assumed(calibration),
        "sources": [
            (m["name"], m["source"]) for m in calibration.record["materials"] if m["source"]
        ],
        "certificate": certificate,
        "inputs": _inputs(calibration),
        "command": words.command(calibration),
        "composed": words.composed(calibration),
    }


@checked
def loop_page(
    result: Loop | LoopResult,
    ends: Any = None,
    *,
    place: str = "result",
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a closed loop as one HTML page; DataError if it has no simulation.

    A `Loop` needs ``ends``, as `LoopResult.ends` returns it; a `LoopResult` has its own. Messages name
    it by ``place``. ``heading`` is as for `page`.
    """
    loop = result.loop if isinstance(result, LoopResult) else result
    if isinstance(result, LoopResult):
        ends = result.ends()
    simulated = None if ends is None else loop_words.read_ends(loop, ends, place)
    status = loop_words.statuses(loop) if simulated is None else simulated["status"]
    summary = loop_words.summary(loop, status)
    if simulated is not None:
        summary.append(loop_words.confirmed(loop, simulated))
    figure = loop_figures.path(loop)
    drawn = source(figure, progress or (lambda: None))
    return render(
        "loop.html",
        {
            "loop_state": loop,
            "doubts": words.doubts(loop.trust_marks),
            "summary": summary,
            "at_ends": loop_words.at_ends(loop),
            "assumed": loop_words.assumed(loop),
            "figure": {
                "source": drawn,
                "alt": f"{loop.matched.label} wanted and simulated by band; gap by simulation",
                "caption": f"{loop.matched.label} by band, and how far each simulation was off. "
                "One JND is 5 %.",
            },
            "bands": loop_words.bands_table(loop, status),
            "ends": simulated,
            "blocks": blocks(loop.room.n_bands),
            "labels": [f"{f:g} Hz" for f in loop.room.centre_frequencies],
            "materials": loop_words.materials_table(loop),
            "equation_option": loop_words.equation_option(loop),
        },
        (heading or Heading()).completed(loop.room.name, loop.room.author),
    )


@checked
def page_of(
    path: str | os.PathLike[str],
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return the page of a saved result: ``result.json``, its folder, a loop's state or result.

    Raises
    ------
    DataError
        For a folder that has no result, or a file that is none.
    """
    place = Path(path)
    if place.is_dir():
        place /= "result.json"
        if not place.exists():
            raise DataError(
                f"folder {Path(path).resolve()} has no result.json; `rtcal calibrate --out` and "
                "`rtcal fit --out` write one"
            )
    record = read_json(place)
    if record.get("rtcal") == loop_files.KIND:
        loop = Loop.load(os.fspath(place))
        return loop_page(
            loop, record.get("result"), place=os.fspath(place), heading=heading, progress=progress
        )
    if record.get("rtcal") == POSITIONS:
        return positions_page.page(
            saved_positions.read(record, os.fspath(place)),
            heading or Heading(),
            progress or (lambda: None),
        )
    return page(from_dict(record, os.fspath(place)), heading=heading, progress=progress)


def _worst(values: Sequence[float | None]) -> str:
    numbers = [v for v in values if v is not None]
    return f"{max(numbers):.1e}" if len(numbers) == len(values) else "unknown"


def _figures(calibration: Saved, step: Callable[[], None]) -> dict[str, dict[str, str]]:
    room = calibration.record["room"]
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
    if len(calibration.materials) > 1 and calibration.matched.any():
        drawn["plane"] = (
            material_figures.plane_of(calibration),
            "The calibration in the plane of two materials",
            "The step that the calibration takes, shown for two materials: from what was stated "
            "to what the method chose. On the line lie all coefficients that give the measured "
            "reverberation time.",
        )
    encoded = {
        name: {"source": source(figure, step), "alt": f"{room}: {alt}", "caption": caption}
        for name, (figure, alt, caption) in drawn.items()
    }
    return encoded | ({} if "plane" in encoded else {"plane": {}})


def _band_rows(calibration: Saved) -> list[tuple[str, Any, int, bool]]:
    """Return each row of the band table: name, values, decimals, and whether to show the sign."""
    return [
        ("measured T / s", calibration.measured, 3, False),
        ("its uncertainty / s", calibration.uncertainty, 3, False),
        ("T before / s", calibration.before, 3, False),
        ("T after / s", calibration.after, 3, False),
        ("gap before / JND", calibration.gap_before, 1, True),
        ("gap after / JND", calibration.gap_after, 1, True),
        ("z", calibration.z, 1, True),
        (
            "absorption area of the surfaces / m²",
            calibration.areas @ calibration.alpha_after,
            2,
            False,
        ),
        ("air's share / %", 100 * calibration.air_share, 0, False),
    ]


def _materials(calibration: Saved) -> list[dict[str, Any]]:
    low, high = material_figures.intervals(calibration)
    size = np.max(calibration.areas[:, np.newaxis] * calibration.alpha_after, axis=1)
    rows = np.sort(np.argsort(-size, kind="stable")[:MOST_MATERIALS])
    return material_rows(
        [calibration.materials[i] for i in rows],
        calibration.areas[rows],
        calibration.alpha_before[rows],
        calibration.alpha_after[rows],
        (low[rows], high[rows]),
        calibration.at_bound[rows] != "",
    )


def _interval_note(calibration: Saved) -> str:
    if calibration.interval is not None:
        return (
            "The intervals are those of the exact posterior distribution, within the bounds, with the "
            "uncertainty of T where it is known. Each holds its calibrated coefficient."
        )
    return (
        "The intervals are those of the linear estimate, alpha ± 1.645 standard deviations cut to 0 to "
        "1: exact ones would need samples here, or the method has no posterior distribution."
    )


def _inputs(calibration: Saved) -> dict[str, str] | None:
    """Return the two files as data URIs; None if the room exceeds the largest size of a file."""
    texts = {key: calibration.record["inputs"][key].encode() for key in ("room", "measured")}
    if len(texts["room"]) > room_files.MAX_BYTES:
        return None
    return {
        key: "data:text/plain;base64," + base64.b64encode(text).decode()
        for key, text in texts.items()
    }
