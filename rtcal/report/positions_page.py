"""The page of a calibration to every position."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rtcal.acoustics.parameters import parameter_label
from rtcal.report import positions_figures
from rtcal.report.document import Heading, blocks, render, source
from rtcal.report.rows import material_rows
from rtcal.report.saved_positions import SavedPositions
from rtcal.support.types import Array

MOST_MATERIALS = 100
"""Largest number of materials in the page's tables, which list those of which most was learned."""
_LEARNED = 0.9
"""Posterior over prior sigma up to which a material counts as learned in the summary."""
_MISFIT = 2.0
"""Misfit from which a pair is named: twice the chi-square that is usual in this room."""


def page(saved: SavedPositions, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.page`."""
    order = _most_learned_first(saved)
    return render(
        "positions.html",
        {
            "saved": saved,
            "summary": _summary(saved, order),
            "plan": _plan(saved, step),
            "shifts": {
                "source": source(
                    positions_figures.draw_shifts(
                        saved.shift[order],
                        [saved.materials[i] for i in order],
                        saved.centre_frequencies,
                    ),
                    step,
                ),
                "alt": f"{saved.record['room']}: how far each coefficient moved",
                "caption": "How far each coefficient moved, in standard deviations of what was stated. "
                "Above 2 either the stated deviation was too small, or something is missing.",
            },
            "learned": [_learned(saved, i) for i in order],
            "gaps": _gaps(saved),
            "parameters": [parameter_label(p) for p in saved.parameters],
            "doubts": _doubts(saved),
            "blocks": blocks(len(saved.centre_frequencies)),
            "labels": [f"{f:g} Hz" for f in saved.centre_frequencies],
            "materials": material_rows(
                [saved.materials[i] for i in order],
                saved.areas[order],
                saved.alpha_before[order],
                saved.alpha_after[order],
                None if saved.interval is None else tuple(saved.interval[:, order]),
                np.isin(saved.alpha_after[order], (0.0, 1.0)),
            ),
            "left_out": len(saved.materials) - len(order),
        },
        heading.completed(saved.record["room"], saved.record["author"]),
    )


def _rms(values: Array, axis: Any = None) -> Any:
    with np.errstate(invalid="ignore"):
        known = np.isfinite(values)
        squares = np.where(known, values, 0.0) ** 2
        return np.sqrt(squares.sum(axis=axis) / known.sum(axis=axis))


def _share(saved: SavedPositions) -> Array:
    """Return posterior over prior sigma of each material, 1 where sigma was 0."""
    before, after = (_rms(s, axis=1) for s in (saved.sigma_before, saved.sigma_after))
    return np.asarray(np.divide(after, before, out=np.ones_like(after), where=before > 0))


def _most_learned_first(saved: SavedPositions) -> list[int]:
    return [int(i) for i in np.argsort(_share(saved), kind="stable")[:MOST_MATERIALS]]


def _summary(saved: SavedPositions, order: list[int]) -> list[str]:
    parameters = ", ".join(parameter_label(p) for p in saved.parameters)
    n_pairs = len(saved.pairs)
    share = _share(saved)
    learned = [saved.materials[i] for i in order if share[i] <= _LEARNED]
    names = ", ".join(f"“{name}”" for name in learned[:3])
    told = (
        f"The measurement tells of {len(learned)} of {len(saved.materials)} materials, most of {names}."
        if learned
        else "The measurement tells hardly anything of any single material."
    )
    return [
        f"The absorption coefficients were fitted to {parameters} at "
        f"{n_pairs} pair{'s' * (n_pairs > 1)} of a source and a receiver.",
        f"The root mean square gap went from {_rms(saved.gap_before):.1f} to "
        f"{_rms(saved.gap_after):.1f} just noticeable differences (JND).",
        told,
    ]


def _plan(saved: SavedPositions, step: Callable[[], None]) -> dict[str, str] | None:
    if not saved.faces:
        return None
    figure = positions_figures.draw_plan(
        saved.pairs,
        (saved.gap_before, saved.gap_after),
        saved.faces,
        saved.sources,
        saved.receivers,
    )
    return {
        "source": source(figure, step),
        "alt": f"{saved.record['room']}: plan with the gap at each receiver, before and after",
        "caption": "Seen from above: sources (triangles), and receivers coloured by their gap in JND, "
        "the root mean square over parameters, bands and sources.",
    }


def _learned(saved: SavedPositions, i: int) -> dict[str, Any]:
    """Return a material's row: sigma before and after, shift, who pulls it most, and scattering."""
    strength = np.abs(saved.pulls[:, i]).mean(axis=1)
    return {
        "name": saved.materials[i],
        "before": _rms(saved.sigma_before[i]),
        "after": _rms(saved.sigma_after[i]),
        "shift": _rms(saved.shift[i]),
        "pair": " to ".join(saved.pairs[int(np.argmax(strength))]),
        "scattering": saved.scattering and tuple(float(a[i].mean()) for a in saved.scattering),
        "share": float(strength.max() / strength.sum()) if strength.sum() > 0 else 0.0,
    }


def _gaps(saved: SavedPositions) -> list[dict[str, Any]]:
    """Return a row per pair and one for all: gap before and after of each parameter, and the misfit."""
    rows = [(" to ".join(p), [i], float(saved.misfit[i])) for i, p in enumerate(saved.pairs)]
    rows.append(("all", list(range(len(saved.pairs))), float("nan")))
    return [
        {
            "name": name,
            "cells": [
                (float(_rms(b[pairs])), float(_rms(a[pairs])))
                for b, a in zip(saved.gap_before, saved.gap_after, strict=True)
            ],
            "misfit": misfit,
        }
        for name, pairs, misfit in rows
    ]


def _doubts(saved: SavedPositions) -> list[dict[str, Any]]:
    """Return the reservations: title, where, and what to do."""
    record, doubts = saved.record, []

    def add(title: str, text: str, advice: str) -> None:
        doubts.append({"title": title, "letter": "", "texts": [text], "advice": advice})

    contradicting = [" to ".join(pair) for pair in record["contradictions"]]
    for name in contradicting:
        add(
            "Contradicts all other pairs",
            name,
            f"Check its names and positions, or leave it out: --exclude {name.replace(' to ', ':')}.",
        )
    odd = [
        f"{' to '.join(pair)} ({misfit:.1f})"
        for pair, misfit in zip(saved.pairs, saved.misfit, strict=True)
        if misfit > _MISFIT and " to ".join(pair) not in contradicting
    ]
    if odd:
        add(
            "Fits the others badly",
            ", ".join(odd),
            "1 is usual. Look at the decays of these pairs.",
        )
    if record["error_scale"] > 1:
        add(
            "Misses more than expected",
            f"Variance of the simulator's error: {record['error_scale']:.1f} times as large.",
            "Check volume, mesh and stated sigma. Something may be missing in the room.",
        )
    if not record["control_runs"]:
        add(
            "Simulator's error unknown",
            "No control run tells it; no interval is stated.",
            "Use a simulator with a geometry, such as path tracing.",
        )
    bound = [
        f"{saved.materials[i]} at {saved.centre_frequencies[k]:g} Hz"
        for i, k in np.argwhere((saved.alpha_after <= 0) | (saved.alpha_after >= 1))
    ]
    if bound:
        more = f" and {len(bound) - 5} more" if len(bound) > 5 else ""
        add(
            "Coefficient at a bound",
            ", ".join(bound[:5]) + more,
            "That is a warning and no result. State a smaller sigma or a floor.",
        )
    if not record["settled"]:
        add("Not settled", "The last step still moved alpha.", "Calibrate again with more paths.")
    return doubts
