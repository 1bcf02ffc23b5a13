"""The files of a finding, the pages at positions and of changes, and the output of ``rtcal apply``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import parameter_label
from rtcal.files.disk import make_folder, write_all
from rtcal.files.saved import NUMBERS
from rtcal.finder.means.corrected import corrected_room, not_in_room
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.recalibration import recalibrate, table
from rtcal.finder.positions.finding import Place, PositionsFinding, strongest
from rtcal.finder.positions.verification import MODELS, TITLES, PositionsVerification
from rtcal.finder.states.finding import StatesFinding, StatesVerification, decimals
from rtcal.finder.states.search import verify
from rtcal.report import document, gap_report, room_view, where_figures
from rtcal.report.document import Heading, blocks, render, source
from rtcal.report.figures import BLACK, BLUE, ORANGE, band_axis, new_figure, rendered
from rtcal.report.page import FINDING_FIGURES
from rtcal.support.blocks import Row

PAGE, MAP, PLAN, ROOM, GAP = (
    "report.html",
    "map.png",
    "plan.png",
    "room.png",
    "gap.png",
)
WRITTEN = (NUMBERS, PAGE, MAP, PLAN, ROOM, GAP, *(f"{name}.png" for name in FINDING_FIGURES))
"""The files of a finding, each kind some of them."""


def page(
    finding: MeansFinding | PositionsFinding | StatesFinding,
    verification: Any,
    heading: Heading,
    reproduction: gap_report.Reproduction | None = None,
    place: Place | None = None,
    step: Callable[[], None] = lambda: None,
) -> tuple[str, dict[str, Any]]:
    """Return the page of a finding of any kind, and its figures by the names of their files.

    ``verification`` is the finding's, or None. ``reproduction`` is printed on the page. ``place`` is a
    further receiver that would tell the surfaces apart. Without jinja2 or matplotlib it raises
    MissingDependencyError.
    """
    if isinstance(finding, MeansFinding):
        drawings = gap_report.figures(finding, verification)
        figures = {f"{name}.png": figure for name, (figure, _) in drawings.items()}
        return gap_report.page(finding, verification, drawings, reproduction, heading), figures
    if isinstance(finding, StatesFinding):
        return states_page(finding, heading, step, verification), {}
    figures = drawn(finding, verification, place)
    command = "" if reproduction is None else reproduction.command
    return where_page(finding, verification, figures, heading, command, place), figures


def write(
    finding: MeansFinding | PositionsFinding | StatesFinding,
    verification: Any,
    folder: Path,
    heading: Heading | None = None,
    reproduction: gap_report.Reproduction | None = None,
    place: Place | None = None,
) -> None:
    """Write `page`, numbers and figures, all or none; the arguments are those of `page`.

    Raises
    ------
    MissingDependencyError
        Without matplotlib or jinja2.
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    text, figures = page(finding, verification, heading or Heading(), reproduction, place)
    # A page of two states is made of the finding alone.
    alone = verification is None or isinstance(finding, StatesFinding)
    saved = finding if alone else verification
    contents = {folder / PAGE: text.encode(), folder / NUMBERS: saved.to_json(folder).encode()}
    contents |= {folder / name: rendered(figure, "png") for name, figure in figures.items()}
    make_folder(folder)
    write_all(contents)


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


def where_page(
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
    values = {
        "finding": finding,
        "verification": verification,
        "level": "" if verification is None else _LEVELS[verification.verdict],
        "models": TITLES,
        "parameters": [parameter_label(p) for p in finding.parameters],
        "pairs": [" to ".join(pair) for pair in finding.pairs],
        "candidates": replace(finding.probable, title="Candidates"),
        "bars": pictures.get(GAP),
        "plan": pictures[PLAN],
        "map": pictures[MAP],
        "place": place,
        "notes": [*finding.reasons, *finding.notes],
        "command": command,
        **room_view.of_finding(finding, verification, place),
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
    some = finding.verdict != "none" and likely
    what = f"coloured are {likely}" if some else "no surface is coloured"
    view = "The plan of the room" if name == PLAN else "The room in an axonometric view"
    return f"{view} with sources and receivers; {what}."


def states_page(
    finding: StatesFinding,
    heading: Heading,
    step: Callable[[], None],
    verification: StatesVerification | None = None,
) -> str:
    """Return the page as HTML; without a ``verification`` it is made. Raises as `page`."""
    if verification is None and finding.can_be_verified:
        verification = verify(finding)
    found = finding.case.differences
    measured = found.measured
    frequencies = found.centre_frequencies[measured]
    mean, low, high = finding.change[:, measured]
    tried, digits = bool(np.isfinite(finding.size.mean)), decimals(finding.change)
    of_change = [
        Row("change / m²", mean, f"+.{digits}f"),
        Row("90 % interval: from / m²", low, f"+.{digits}f"),
        Row("to / m²", high, f"+.{digits}f"),
    ]
    name = finding.case.room.name
    return render(
        "states.html",
        {
            "headline": finding.headline,
            "verified": None if verification is None else verification.sentence,
            "sentences": list(finding.sentences),
            "surfaces": [
                (name, 100 * p, "claimed" if name in finding.claimed_surfaces else "")
                for name, p in finding.surfaces.items()
            ],
            "can_be_added": finding.can_be_added,
            "kinds": [
                (c.effect, 100 * c.probability, c.in_words)
                for c in finding.candidates
                if finding.best is not None
            ],
            "rows": [
                Row("T before / s", found.before[measured], ".2f"),
                Row("T after / s", found.after[measured], ".2f"),
                Row("absorption area before / m²", finding.area[measured], ".1f"),
                *(of_change if tried else ()),
            ],
            "blocks": blocks(len(frequencies)),
            "labels": bands.labels(frequencies),
            "times": {
                "source": source(_times(finding), step),
                "alt": f"{name}: T before and after, by band",
                "caption": "T by band, mean over the pairs that both states have.",
            },
            "change": {
                "source": source(change_figure(finding), step),
                "alt": f"{name}: change of the absorption area, by band",
                "caption": "Change of the absorption area with its 90 % interval, if it changed.",
            },
            "equation": finding.case.equation.name,
            "n_pairs": len(found.pairs),
        },
        heading.completed(name, finding.case.room.author),
    )


def _times(finding: StatesFinding) -> Any:
    """Return T(f) before and after."""
    found = finding.case.differences
    k = found.measured
    figure, axes = new_figure()
    frequencies = found.centre_frequencies[k]
    axes.plot(frequencies, found.before[k], color=BLACK, linestyle="--", marker=".", label="before")
    axes.plot(frequencies, found.after[k], color=ORANGE, marker="o", label="after")
    band_axis(axes, frequencies)
    axes.set_ylim(0, 1.1 * float(max(found.before[k].max(), found.after[k].max())))
    axes.set_ylabel("T / s")
    axes.legend(fontsize="small")
    return figure


def change_figure(finding: StatesFinding) -> Any:
    """Return the change of the absorption area by band, with its interval."""
    k = finding.case.differences.measured
    figure, axes = new_figure()
    frequencies = finding.case.room.centre_frequencies[k]
    mean, low, high = finding.change[:, k]
    ends = np.maximum(np.array([mean - low, high - mean]), 0.0)
    axes.axhline(0, color=BLACK, linewidth=0.8)
    axes.errorbar(frequencies, mean, yerr=ends, color=BLUE, marker="s", capsize=3)
    band_axis(axes, frequencies)
    axes.set_ylabel("change of the absorption area / m²")
    return figure


_KEPT = ("verdict", "effect", "named", "family", "candidates", "sets", "probabilities", "evidence")
"""Entries of a finding that are stored with the correction."""


@dataclass(frozen=True)
class Correction:
    """The text, its record, and the files to write by path; no files if there is nothing to add."""

    text: str
    record: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of the text as plain values and arrays."""
        return dict(self.record)


def correct(
    finding: MeansFinding, case_path: str, room_path: str | None = None, effect: str | None = None
) -> Correction:
    """Add the named effects, or the most probable ones, to a finding's case, and calibrate it.

    Parameters
    ----------
    finding : MeansFinding
    case_path : str
        Path of the case with the effect (JSON).
    room_path : str, optional
        Path of the room with the effect (TOML).
    effect : str, optional
        The candidate to add.

    Raises
    ------
    DataError
        As `MeansFinding.apply`.
    """
    said = finding.to_dict()
    record: dict[str, Any] = {k: said[k] for k in _KEPT if k in said}
    if (nothing := finding.reason_for_none) is not None:
        record |= {"sentence": nothing}
        return Correction(f"{nothing}\nNothing is written.", record)
    members = finding.chosen(effect)
    corrected = finding.with_effects(members=members)
    calibrated = recalibrate(corrected, finding.discrepancy)
    files = {case_path: corrected.to_json().encode()}
    absent: list[str] = []
    if room_path is not None:
        files[room_path] = corrected_room(corrected).to_text(Path(room_path).parent).encode()
        absent = not_in_room(corrected)
    sentence = finding.added(members)
    lines = [
        sentence,
        *table(corrected.room, {"corrected": calibrated}),
        *(f"  note: {note}" for note in finding.notes),
        *(f"  not in {room_path}: {line}" for line in absent),
    ]
    record |= {
        "sentence": sentence,
        "present": [p.to_dict() for p in corrected.applied],
        "calibrated": calibrated.to_dict(),
        "notes": list(finding.notes),
        "not_in_room": absent,
    }
    return Correction("\n".join(lines), record, files)
