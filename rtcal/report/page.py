"""A self-contained HTML page of a result, for readers without Python.

No other module imports jinja2. Autoescaping makes every name plain text.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics import room_files
from rtcal.acoustics.quality import letters
from rtcal.errors import DataError, MissingDependencyError
from rtcal.loop import files as loop_files
from rtcal.loop.result import LoopResult
from rtcal.loop.state import Loop
from rtcal.report import figures, loop_figures, loop_words, material_figures, words
from rtcal.report.rows import material_rows
from rtcal.report.saved import Saved, from_dict, read_json, saved
from rtcal.support.arguments import checked
from rtcal.support.files import write_text
from rtcal.support.version import __version__

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

MAX_BYTES = 2 * 10**6
"""Largest size of a page in bytes."""
MOST_MATERIALS = 100
"""Largest number of materials in the page's table, which lists those that absorb most."""
_BANDS_ABREAST = 7


@checked
def page(
    result: CalibrationResult | Saved,
    *,
    finding: Mapping[str, Any] | None = None,
    finding_figures: Sequence[tuple[Any, str]] = (),
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a calibration as one HTML page under 2 MB, without scripts and links to the network.

    Parameters
    ----------
    result : CalibrationResult or Saved
    finding : mapping, optional
        A finding about the model: ``summary`` (list of sentences), ``verdict``, ``effect``,
        ``candidates`` (list of names), ``evidence`` (name to nats) and ``notes`` (list of
        sentences), each optional; ``plain`` (title of the tables without the effect),
        ``corrected`` (title, use, effects, materials with their cells), ``unknowable`` (a sentence),
        ``reproduce`` (command, files, seed, engines).
    finding_figures : sequence of (figure, caption)
        Figures of the finding.
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
    step = progress or (lambda: None)
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
    return _render(
        "calibration.html",
        {
            "title": f"{calibration.record['room']}: calibration",
            "calibration": calibration,
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
            "finding": _finding(finding, finding_figures, step),
            "figures": _figures(calibration, step),
            "blocks": _blocks(len(calibration.centre_frequencies)),
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
        },
    )


@checked
def loop_page(
    result: Loop | LoopResult,
    ends: Any = None,
    *,
    place: str = "result",
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a closed loop as one HTML page; DataError if it has no simulation.

    A `Loop` needs ``ends``, as `LoopResult.ends` returns it; a `LoopResult` has its own. Messages name
    it by ``place``.
    """
    loop = result.loop if isinstance(result, LoopResult) else result
    if isinstance(result, LoopResult):
        ends = result.ends()
    simulated = None if ends is None else loop_words.read_ends(loop, ends, place)
    status = loop.status if simulated is None else simulated["status"]
    summary = loop_words.summary(loop, status)
    if simulated is not None:
        summary.append(loop_words.confirmed(loop, simulated))
    figure = loop_figures.path(loop)
    source = _source(figure, progress or (lambda: None))
    return _render(
        "loop.html",
        {
            "title": f"{loop.room.name}: closed loop",
            "loop_state": loop,
            "summary": summary,
            "at_ends": loop_words.at_ends(loop),
            "assumed": loop_words.assumed(loop),
            "figure": {
                "source": source,
                "alt": "T20 wanted and simulated by band; gap by simulation",
                "caption": "Left: T20 by band. Right: how far each simulation was off.",
            },
            "bands": loop_words.bands_table(loop, status),
            "ends": simulated,
            "blocks": _blocks(loop.room.n_bands),
            "labels": [f"{f:g} Hz" for f in loop.room.centre_frequencies],
            "materials": loop_words.materials_table(loop),
            "equation_option": loop_words.equation_option(loop),
        },
    )


@checked
def page_of(path: str | os.PathLike[str], progress: Callable[[], None] | None = None) -> str:
    """Return the page of a saved result: ``result.json``, its folder, a loop's state or result."""
    place = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    record = read_json(place)
    if record.get("rtcal") == loop_files.KIND:
        loop = Loop.load(os.fspath(place))
        return loop_page(loop, record.get("result"), place=os.fspath(place), progress=progress)
    return page(from_dict(record, os.fspath(place)), progress=progress)


@checked
def write(path: str | os.PathLike[str], text: str) -> None:
    """Write a page, whole or not at all."""
    write_text(path, text)


@cache
def _environment() -> Any:
    try:
        import jinja2
    except ImportError as error:
        raise MissingDependencyError(
            "the page needs jinja2: pip install 'rtcal[report]'"
        ) from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rtcal.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = _fixed
    environment.filters["signed"] = _signed
    return environment


def _render(template: str, values: Mapping[str, Any]) -> str:
    text: str = _environment().get_template(template).render(version=__version__, **values)
    if (size := len(text.encode("utf-8", errors="backslashreplace"))) > MAX_BYTES:
        raise DataError(f"the page would have {size} bytes, more than {MAX_BYTES}")
    return text


def _blocks(n_bands: int) -> list[slice]:
    """Return the bands of each part of a table, so that it fits a sheet of paper."""
    return [slice(k, k + _BANDS_ABREAST) for k in range(0, n_bands, _BANDS_ABREAST)]


def _worst(values: Sequence[float | None]) -> str:
    numbers = [v for v in values if v is not None]
    return f"{max(numbers):.1e}" if len(numbers) == len(values) else "unknown"


def _fixed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def _signed(value: float, digits: int) -> str:
    if not np.isfinite(value):
        return "–"
    text = f"{value:+.{digits}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("+-")


def _source(figure: Any, step: Callable[[], None]) -> str:
    """Return a figure as a data URI, a separate document whose ids do not clash with the page's."""
    content = base64.b64encode(figures.rendered(figure, "svg")).decode()
    step()
    return f"data:image/svg+xml;base64,{content}"


def _figures(calibration: Saved, step: Callable[[], None]) -> dict[str, dict[str, str]]:
    room = calibration.record["room"]
    drawn: dict[str, tuple[Any, str, str]] = {
        "gap": (
            figures.gap(calibration),
            "Gap to the measured reverberation time by band, before and after",
            "How far the model's reverberation time was from the measured one: before (bars) and after "
            "calibration (dots).",
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
        name: {"source": _source(figure, step), "alt": f"{room}: {alt}", "caption": caption}
        for name, (figure, alt, caption) in drawn.items()
    }
    return encoded | ({} if "plane" in encoded else {"plane": {}})


def _finding(
    finding: Mapping[str, Any] | None,
    pictures: Sequence[tuple[Any, str]],
    step: Callable[[], None],
) -> dict[str, Any] | None:
    if finding is None and not pictures:
        return None
    entries = dict(finding or {})
    return {
        "summary": list(entries.get("summary", ())),
        "verdict": entries.get("verdict", ""),
        "effect": entries.get("effect", ""),
        "candidates": list(entries.get("candidates", ())),
        "evidence": sorted(dict(entries.get("evidence", {})).items(), key=lambda e: -e[1]),
        "notes": list(entries.get("notes", ())),
        "plain": entries.get("plain", ""),
        "corrected": entries.get("corrected"),
        "unknowable": entries.get("unknowable", ""),
        "reproduce": entries.get("reproduce"),
        "figures": [
            {"source": _source(figure, step), "alt": caption, "caption": caption}
            for figure, caption in pictures
        ],
    }


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
        return "The intervals are those of the exact posterior distribution, within the bounds."
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
