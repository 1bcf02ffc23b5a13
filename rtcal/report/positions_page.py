"""The page of a calibration to every position, its figures, and its folder."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import DecaySlope, of_kind, parameter_label
from rtcal.files.saved import NUMBERS
from rtcal.loop.positions_result import PositionsResult, gap_rows
from rtcal.report import room_view
from rtcal.report.document import Heading, blocks, material_rows, render, source
from rtcal.report.figures import (
    BLACK,
    ORANGE,
    ROOM,
    band_places,
    new_figure,
    number_map,
    shown,
    write_with_figures,
)
from rtcal.simulators.base import Observations
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.blocks import Row
from rtcal.support.errors import DataError
from rtcal.support.text import first_of
from rtcal.support.types import Array

__all__ = ["plan", "shifts"]
__dir__ = __all__.copy

MOST_MATERIALS = 100
"""Largest number of materials in the page's tables, which list those of which most was learned."""
PLAN, SHIFTS = "plan.png", "shifts.png"
POSITION_FILES = (ROOM, NUMBERS, PLAN, SHIFTS)
"""Files of the folder of a calibration to every position."""
_MOST_NUMBERS = 200
"""Largest number of coefficients whose shifts are printed in their cells."""
_LEARNED = 0.9
"""Posterior over prior sigma up to which a material counts as learned in the summary."""
_REMAINS = 1.0
"""Root mean square gap in JND from which the page says first what remains: a difference is heard."""
_MISFIT = 2.0
"""Misfit from which a pair is named: twice the chi-square that is usual in this room."""


def page(result: PositionsResult, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.calibration_page`."""
    order = [result.prior.material_index(name) for name, _, _ in result.learned[:MOST_MATERIALS]]
    interval = result.interval
    return render(
        "positions.html",
        {
            "result": result,
            "headline": _headline(result),
            "summary": _summary(result),
            "shifts": {
                "source": source(
                    draw_shifts(
                        result.shift[order],
                        [result.prior.materials[i] for i in order],
                        result.prior.centre_frequencies,
                    ),
                    step,
                ),
                "alt": f"{result.prior.name}: how far each coefficient moved",
                "caption": "How far each coefficient moved, in standard deviations of what was stated. "
                "Above 2 either the stated deviation was too small, or something is missing.",
            },
            "learned": [_learned(result, i) for i in order],
            "gaps": _gaps(result),
            "times": _times(result.before, result.after, result.measured.observations),
            "held_out": _held_out(result),
            "warning": result.warning,
            "command": _command(result),
            "parameters": [
                *(parameter_label(p) for p in result.parameters),
                *(f"{parameter_label(p)}, not matched" for p in result.beside.parameters),
            ],
            "doubts": _doubts(result),
            "blocks": blocks(len(result.prior.centre_frequencies)),
            "labels": bands.labels(result.prior.centre_frequencies),
            "materials": material_rows(
                [result.prior.materials[i] for i in order],
                result.prior.areas[order],
                result.prior.alpha[order],
                result.alpha[order],
                None if interval is None else (interval[0][order], interval[1][order]),
                np.isin(result.alpha[order], (0.0, 1.0)),
            ),
            **room_view.of_positions(result),
            "left_out": len(result.prior.materials) - len(order),
        },
        heading.completed(result.prior.name, result.prior.author),
    )


def _headline(result: PositionsResult) -> str:
    """Return what the calibrated simulator lacks of what was matched; "" where all is within 1 JND."""
    left = {p: rms(gap) for p, gap in zip(result.parameters, result.gap_after, strict=True)}
    far = sorted((p for p in left if left[p] >= _REMAINS), key=lambda p: -left[p])
    if not far:
        return ""
    gaps = ", ".join(f"{parameter_label(p)} {left[p]:.1f} JND" for p in far)
    said = (
        "The calibrated simulator does not have what was measured. There remain, root mean square over "
        f"pairs and bands: {gaps}."
    )
    measured = result.measured.observations
    for key in (p for p in far if p in of_kind(DecaySlope)):
        heard = measured.natural(key)
        has = np.where(np.isfinite(heard), result.after.natural(key), np.nan)
        goal, time = _mean(heard), _mean(has)
        k = int(np.nanargmax(np.abs(time / goal - 1)))
        said += (
            f" {parameter_label(key)} is {time[k]:.2f} s for {goal[k]:.2f} s measured, mean over the "
            f"pairs at {bands.label(result.prior.centre_frequencies[k])}."
        )
    return said


def _summary(result: PositionsResult) -> list[str]:
    parameters = ", ".join(parameter_label(p) for p in result.parameters)
    n_pairs = len(result.pairs)
    learned = [
        name for name, before, after in result.learned if before and after <= _LEARNED * before
    ]
    names = ", ".join(f"“{name}”" for name in learned[:3])
    told = (
        f"The measurement tells of {len(learned)} of {result.prior.n_materials} materials, most of "
        f"{names}."
        if learned
        else "The measurement tells hardly anything of any single material."
    )
    tested = ""
    if result.held_out is not None:
        before, after = rms(result.held_out.gap_before), rms(result.held_out.gap_after)
        tested = f"; at the pairs that were held out it went from {before:.1f} to {after:.1f}"
    return [
        f"The absorption coefficients were fitted to {parameters} at "
        f"{n_pairs} pair{'s' * (n_pairs > 1)} of a source and a receiver.",
        f"The root mean square gap went from {rms(result.gap_before):.1f} to "
        f"{rms(result.gap_after):.1f} just noticeable differences (JND){tested}.",
        told,
    ]


def _times(before: Observations, after: Observations, measured: Observations) -> list[Any]:
    """Return each decay time by band in s, the means over the pairs: measured, before, after.

    The pairs are those that have a measured value in the band.
    """
    rows = []
    for key in (k for k in of_kind(DecaySlope) if k in measured.parameters):
        heard = measured.natural(key)
        for name, model in (("measured", measured), ("before", before), ("after", after)):
            values = np.where(np.isfinite(heard), model.natural(key), np.nan)
            rows.append(Row(f"{parameter_label(key)} {name} / s", _mean(values), ".2f"))
    return rows


def _mean(values: Array) -> Array:
    """Return the mean over pairs of (n_pairs, n_bands), NaN without a value."""
    known = np.isfinite(values)
    number = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / number)


def _held_out(result: PositionsResult) -> dict[str, Any] | None:
    """Return the pairs that were left out: gaps of each, and the reverberation times."""
    left = result.held_out
    if left is None:
        return None
    *of_pairs, _ = gap_rows(left.measured.pairs, left.gap_before, left.gap_after)
    return {
        "parameters": [parameter_label(p) for p in left.parameters],
        "rows": [{"name": name, "cells": cells} for name, cells in of_pairs],
        "before": float(rms(left.gap_before)),
        "after": float(rms(left.gap_after)),
        "times": _times(left.before, left.after, left.measured),
    }


def _command(result: PositionsResult) -> str | None:
    """Return the shell command that gives the same result; None for another simulator or terms."""
    tracer: Any = result.tracer
    if result.start is None:
        return None
    chosen = [text for p in result.parameters for text in ("--match", p)]
    chosen += ["--paths", str(tracer.n_paths), "--seed", str(result.seed)]
    if result.held_out is not None:
        for source_name, receiver in result.held_out.measured.pairs:
            chosen += ["--exclude", f"{source_name}:{receiver}"]
    if result.scattering is None:
        chosen.append("--keep-scattering")
    start = result.start
    if result.prior.scattering is None or (start != result.prior.scattering).any():
        # it was stated to the simulator
        alike = np.ptp(start) == 0
        chosen += ["--scattering", f"{start.flat[0]:g}" if alike else "S"]
    # Scattering is fitted with "random" alone, whatever the fitted tracer has.
    given = tracer.scattering_model if result.scattering is None else "random"
    if given != result.prior.scattering_model:
        chosen += ["--scattering-model", str(given)]
    return shlex.join(["rtcal", "fit", "room.toml", "measured.csv", *chosen, "--out", "fitted"])


def _learned(result: PositionsResult, i: int) -> dict[str, Any]:
    """Return a material's row: sigma before and after, shift, who pulls it most, and scattering."""
    strength = np.abs(result.pulls[:, i]).mean(axis=1)
    return {
        "name": result.prior.materials[i],
        "before": rms(result.prior.sigma[i]),
        "after": rms(result.sigma[i]),
        "shift": rms(result.shift[i]),
        "pair": " to ".join(result.pairs[int(np.argmax(strength))]),
        "scattering": _scattering(result, i),
        "share": float(strength.max() / strength.sum()) if strength.sum() > 0 else 0.0,
    }


def _scattering(result: PositionsResult, i: int) -> tuple[float, float] | None:
    """Return a material's mean scattering coefficient and sigma, if they were fitted."""
    if result.scattering is None:
        return None
    fitted = result.scattering
    return float(fitted.coefficients[i].mean()), float(fitted.sigma[i].mean())


def _gaps(result: PositionsResult) -> list[dict[str, Any]]:
    """Return a row per pair and one for all: gap before and after of each parameter, and the misfit."""
    beside = result.beside
    before = np.concatenate([result.gap_before, beside.gap_before])
    after = np.concatenate([result.gap_after, beside.gap_after])
    rows = gap_rows(result.pairs, before, after)
    misfits = [*result.misfit.tolist(), float("nan")]
    return [
        {"name": name, "cells": cells, "misfit": misfit}
        for (name, cells), misfit in zip(rows, misfits, strict=True)
    ]


def _doubts(result: PositionsResult) -> list[dict[str, Any]]:
    """Return the reservations: title, where, and what to do."""
    doubts: list[dict[str, Any]] = []

    def add(title: str, text: str, advice: str) -> None:
        doubts.append({"title": title, "letter": "", "texts": [text], "advice": advice})

    contradicting = [" to ".join(pair) for pair in result.contradictions]
    for name in contradicting:
        add(
            "Contradicts all other pairs",
            name,
            f"Check its names and positions, or leave it out: --exclude {name.replace(' to ', ':')}.",
        )
    odd = [
        f"{' to '.join(pair)} ({misfit:.1f})"
        for pair, misfit in zip(result.pairs, result.misfit, strict=True)
        if misfit > _MISFIT and " to ".join(pair) not in contradicting
    ]
    if odd:
        add(
            "Fits the others badly",
            ", ".join(odd),
            "1 is usual. Look at the decays of these pairs.",
        )
    if unexplained := result.unexplained_in_words:
        add(
            "Misses more than expected",
            f"A value differs by a further {unexplained} (standard deviation).",
            "Check volume, mesh and stated sigma. Something may be missing in the room.",
        )
    if result.controls is None:
        add(
            "Simulator's error unknown",
            "No control run tells it; no interval is stated.",
            "Use a simulator with a geometry, such as path tracing.",
        )
    bound = [
        f"{result.prior.materials[i]} at {result.prior.centre_frequencies[k]:g} Hz"
        for i, k in np.argwhere((result.alpha <= 0) | (result.alpha >= 1))
    ]
    if bound:
        add(
            "Coefficient at a bound",
            first_of(bound, 5),
            "That is a warning and no result. State a smaller sigma or a floor.",
        )
    if not result.settled:
        add("Not settled", "The last step still moved alpha.", "Calibrate again with more paths.")
    return doubts


def plan(
    result: PositionsResult,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> Any:
    """Return a plan of the room with its receivers coloured by their gap, before and after.

    A receiver's gap is the root mean square over parameters, bands and sources, in JND. It stands
    beside the receiver's name.

    Raises
    ------
    DataError
        If a receiver of the result has no position.
    """
    if missing := [r for _, r in result.pairs if r not in receivers]:
        raise DataError(f'receiver "{missing[0]}" of the result has no position')
    faces = [geometry.vertices[list(face)] for face in geometry.faces]
    return draw_plan(result.pairs, (result.gap_before, result.gap_after), faces, sources, receivers)


def draw_plan(
    pairs: Sequence[tuple[str, str]],
    before_and_after: tuple[Array, Array],
    faces: Sequence[Array],
    sources: Mapping[str, Any],
    receivers: Mapping[str, Any],
) -> Any:
    """Return the figure of `plan` from gaps in JND, each (n_parameters, n_pairs, n_bands)."""
    heard = list(dict.fromkeys(r for _, r in pairs))
    gaps = [_by_receiver(pairs, gap, heard) for gap in before_and_after]
    figure, axes = new_figure(6.2, 8.4, 2, 1)
    most = max(2.0, *(float(np.nanmax(gap)) for gap in gaps))
    points = np.array([receivers[r] for r in heard], dtype=float)
    drawn = None
    for panel, gap, when in zip(axes, gaps, ("before", "after"), strict=True):
        for face in faces:
            corners = np.vstack([face, face[:1]])
            panel.plot(corners[:, 0], corners[:, 1], color="0.75", linewidth=1)
        for name, place in sources.items():
            panel.plot(*place[:2], "^", color=ORANGE, markersize=9, label="source")
            _label(panel, place, shown(name, 12))
        drawn = panel.scatter(
            points[:, 0],
            points[:, 1],
            c=gap,
            cmap="cividis_r",
            vmin=0,
            vmax=most,
            s=110,
            edgecolors=BLACK,
            zorder=3,
            label="receiver: its gap in JND",
        )
        for name, place, value in zip(heard, points, gap, strict=True):
            _label(panel, place, f"{shown(name, 12)}: {value:.1f}")
        panel.set_aspect("equal")
        panel.set_title(f"{when} calibration: gap {rms(gap):.1f} JND")
        panel.set_ylabel("y / m")
    axes[1].set_xlabel("x / m")
    markers = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(markers.values(), markers, loc="outside lower center", ncols=2, fontsize=9)
    figure.colorbar(drawn, ax=list(axes), label="Root mean square gap of a receiver / JND")
    return figure


def shifts(result: PositionsResult) -> Any:
    """Return the figure of how far each coefficient moved, in prior sigmas, by material and band."""
    return draw_shifts(result.shift, result.prior.materials, result.prior.centre_frequencies)


def draw_shifts(moved: Array, materials: Sequence[str], frequencies: Array) -> Any:
    """Return the figure of `shifts` from shifts in prior sigmas, (n_materials, n_bands)."""
    n_materials, n_bands = moved.shape
    figure, axes = new_figure(2.4 + 0.55 * n_bands, 1.6 + 0.32 * n_materials)
    reach = max(2.0, float(np.max(np.abs(moved))))
    form = "+.1f" if moved.size <= _MOST_NUMBERS else ""
    names = [shown(m, 30) for m in materials]
    image = number_map(axes, moved, names, (-reach, reach), "RdBu_r", form)
    band_places(axes, frequencies)
    figure.colorbar(image, ax=axes, label="Shift of α / prior σ")
    return figure


def _by_receiver(pairs: Sequence[tuple[str, str]], gap: Array, receivers: Sequence[str]) -> Array:
    """Return the root mean square gap of each receiver in JND, NaN without a value."""
    rows = [[i for i, (_, r) in enumerate(pairs) if r == name] for name in receivers]
    return np.array([rms(gap[:, row]) for row in rows])


def _label(panel: Any, place: Any, text: str) -> None:
    panel.annotate(
        text, (place[0], place[1]), xytext=(6, 6), textcoords="offset points", fontsize=9
    )


def write_positions(
    result: PositionsResult,
    folder: Path,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> list[Path]:
    """Write room, numbers and figures, all or none, and return their paths.

    Without matplotlib there are no figures, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    draw = {
        PLAN: lambda: plan(result, geometry, sources, receivers),
        SHIFTS: lambda: shifts(result),
    }
    return write_with_figures(result, folder, draw)
