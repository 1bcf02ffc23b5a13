"""The pages of a calibration to every position, and of one to room modes."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import DecaySlope, of_kind, parameter_label
from rtcal.acoustics.quality import rms
from rtcal.loop.positions_result import PositionsResult
from rtcal.modes.result import ModesResult
from rtcal.modes.room_modes import DECAY
from rtcal.report import loop_figures, room_view, words
from rtcal.report.document import Heading, blocks, material_rows, render, source
from rtcal.report.figures import BLACK, BLUE, ORANGE, new_figure
from rtcal.simulators.observations import Observations
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.text import first_of
from rtcal.support.types import Array

MOST_MATERIALS = 100
"""Largest number of materials in the page's tables, which list those of which most was learned."""
_LEARNED = 0.9
"""Posterior over prior sigma up to which a material counts as learned in the summary."""
_REMAINS = 1.0
"""Root mean square gap in JND from which the page says first what remains: a difference is heard."""
_MISFIT = 2.0
"""Misfit from which a pair is named: twice the chi-square that is usual in this room."""


def page(result: PositionsResult, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.calibration_page`."""
    order = _most_learned_first(result)
    return render(
        "positions.html",
        {
            "result": result,
            "headline": _headline(result),
            "summary": _summary(result, order),
            "shifts": {
                "source": source(
                    loop_figures.draw_shifts(
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
                _interval(result, order),
                np.isin(result.alpha[order], (0.0, 1.0)),
            ),
            **room_view.of_positions(result),
            "left_out": len(result.prior.materials) - len(order),
        },
        heading.completed(result.prior.name, result.prior.author),
    )


def _share(result: PositionsResult) -> Array:
    """Return posterior over prior sigma of each material, 1 where sigma was 0."""
    before, after = (rms(s, axis=1) for s in (result.prior.sigma, result.sigma))
    return np.asarray(np.divide(after, before, out=np.ones_like(after), where=before > 0))


def _most_learned_first(result: PositionsResult) -> list[int]:
    return [int(i) for i in np.argsort(_share(result), kind="stable")[:MOST_MATERIALS]]


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


def _summary(result: PositionsResult, order: list[int]) -> list[str]:
    parameters = ", ".join(parameter_label(p) for p in result.parameters)
    n_pairs = len(result.pairs)
    share = _share(result)
    learned = [result.prior.materials[i] for i in order if share[i] <= _LEARNED]
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
            rows.append((f"{parameter_label(key)} {name} / s", _mean(values), 2, False))
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
    return {
        "parameters": [parameter_label(p) for p in left.parameters],
        "rows": [
            {
                "name": " to ".join(pair),
                "cells": [
                    (float(rms(b[i])), float(rms(a[i])))
                    for b, a in zip(left.gap_before, left.gap_after, strict=True)
                ],
            }
            for i, pair in enumerate(left.measured.pairs)
        ],
        "before": float(rms(left.gap_before)),
        "after": float(rms(left.gap_after)),
        "times": _times(left.before, left.after, left.measured),
    }


def _command(result: PositionsResult) -> str | None:
    """Return the shell command that gives the same result; None for another simulator or terms."""
    tracer: Any = result.tracer
    if not isinstance(tracer, PathTracing):
        return None
    chosen = [text for p in result.parameters for text in ("--match", p)]
    chosen += ["--paths", str(tracer.n_paths), "--seed", str(result.seed)]
    if result.held_out is not None:
        for source_name, receiver in result.held_out.measured.pairs:
            chosen += ["--exclude", f"{source_name}:{receiver}"]
    if result.scattering is None:
        chosen.append("--keep-scattering")
    start = result.start if result.start is not None else tracer.scattering
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


def _interval(result: PositionsResult, order: list[int]) -> tuple[Array, Array] | None:
    """Return the ends of the intervals of some materials, if there are any."""
    if result.interval is None:
        return None
    low, high = result.interval
    return low[order], high[order]


def _scattering(result: PositionsResult, i: int) -> tuple[float, float] | None:
    """Return a material's mean scattering coefficient and sigma, if they were fitted."""
    if result.scattering is None:
        return None
    fitted = result.scattering
    return float(fitted.coefficients[i].mean()), float(fitted.sigma[i].mean())


def _gaps(result: PositionsResult) -> list[dict[str, Any]]:
    """Return a row per pair and one for all: gap before and after of each parameter, and the misfit."""
    rows = [(" to ".join(p), [i], float(result.misfit[i])) for i, p in enumerate(result.pairs)]
    before = (*result.gap_before, *result.beside.gap_before)
    after = (*result.gap_after, *result.beside.gap_after)
    rows.append(("all", list(range(len(result.pairs))), float("nan")))
    return [
        {
            "name": name,
            "cells": [
                (float(rms(b[pairs])), float(rms(a[pairs])))
                for b, a in zip(before, after, strict=True)
            ],
            "misfit": misfit,
        }
        for name, pairs, misfit in rows
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
    if result.error_scale > 1:
        add(
            "Misses more than expected",
            f"Variance of the simulator's error: {result.error_scale:.1f} times as large.",
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
            "carries": np.where(result.below | measured, carries, "–"),
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
