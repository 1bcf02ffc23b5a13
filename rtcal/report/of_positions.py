"""The words and the page of a calibration to every position."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import DecaySlope, of_kind, parameter_label
from rtcal.loop.measured_pairs import Compared, Pair
from rtcal.loop.positions import PositionsResult
from rtcal.report import room_view
from rtcal.report.document import (
    MOST_MATERIALS,
    Box,
    Code,
    Items,
    Page,
    Section,
    coefficients,
    tables,
)
from rtcal.simulators.base import Observations
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import listed, numbers, with_uncertainty
from rtcal.support.types import Array

_LEARNED = 0.9
"""Posterior over prior sigma up to which a material counts as learned in the summary."""
_MISFIT = (
    "Misfit: squared deviation from what the other pairs predict, over its variance; 1 is usual."
)
_DEVIATION = "deviation / JND, before to after the fit"
_REMAINS = 1.0
"""Root mean square deviation in JND, audible, from which the page begins with what remains."""


def _gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = f"Root mean square {_DEVIATION}",
    misfit: Array | None = None,
) -> Table:
    """Return the table of deviations before and after calibration, for each pair and for all pairs.

    A deviation is a root mean square over bands. ``before`` and ``after`` are (n_parameters, n_pairs,
    n_bands) in JND. ``misfit`` (n_pairs,) gets a column of its own; None leaves it out.
    """
    columns = [parameter_label(p) for p in parameters]
    own: list[list[str]] = [[]] * (len(pairs) + 1)
    if misfit is not None:
        columns, own = (
            [*columns, "misfit"],
            [[m] for m in (*numbers(misfit, ".1f"), "-")],
        )
    rows = []
    for i, more in enumerate(own):
        name, chosen = ("all", slice(None)) if i == len(pairs) else (" to ".join(pairs[i]), [i])
        ends = zip(*(rms(gap[:, chosen], axis=(1, 2)) for gap in (before, after)), strict=True)
        rows.append(Row(name, [*(" to ".join(numbers(e, ".1f")) for e in ends), *more]))
    note = "" if misfit is None else _MISFIT
    return Table(columns, rows, title, "pair", note)


def blocks(result: PositionsResult) -> list[Block]:
    """Return the blocks that a calibration prints."""
    ends = result.beside.gap_before, result.beside.gap_after
    more = result.beside.parameters
    before, after = rms(result.gap_before), rms(result.gap_after)
    verb = "reduces" if after < before else "changes"
    fitted = listed([parameter_label(p) for p in result.parameters])
    n = len(result.pairs)
    last = len(result.every_note) - len(result.doubts)
    said = [
        f"The fit {verb} the deviation from the measurement from {before:.1f} to {after:.1f} "
        f"JND (root mean square over {fitted} at {n} pair{'s' * (n != 1)})."
    ]
    if result.warning:
        first = bool(result.refused or result.of_input or result.beyond)
        said.insert(0 if first else 1, f"{'' if first else 'Caution: '}{result.warning}")
    return [
        *map(Note, said),
        *(Note(f"Caution: {caution}") for caution in result.every_note[last:]),
        _gap_table(
            result.parameters,
            result.pairs,
            result.gap_before,
            result.gap_after,
            misfit=result.misfit,
        ),
        *([_gap_table(more, result.pairs, *ends, f"Not matched: {_DEVIATION}")] if more else []),
        _material_table(result),
        Note(f"The coefficients are valid only for {result.simulator}."),
        *(Note(f"Note: {note}") for note in result.every_note[bool(result.warning) : last]),
    ]


def _material_table(result: PositionsResult) -> Table:
    """Return what was learned of each material, most first, shaded by how much."""
    columns = ["sigma before", "sigma after", "shift / sigma", "most informative pair"]
    strength = np.abs(result.pulls).mean(axis=2)
    moved = np.sqrt((result.shift**2).mean(axis=1))
    rows = []
    for name, before, after in result.learned:
        i = result.prior.material_index(name)
        pair = "-"
        if strength[:, i].any():
            pair = " to ".join(result.pairs[int(np.argmax(strength[:, i]))])
        cells = [f"{before:.3f}", f"{after:.3f}", f"{moved[i]:.1f}", pair]
        if (fitted := result.scattering) is not None:
            s, sigma = (a[i].mean() for a in (fitted.coefficients, fitted.sigma))
            cells.append(with_uncertainty(s, sigma, 2))
        share = max(1 - after / before, 0.0) if before > 0 else 0.0
        rows.append(Row(name, cells, shade=[0.0, share, *[0.0] * (len(cells) - 2)]))
    columns += ["scattering"] * (result.scattering is not None)
    return Table(columns, rows, "Standard deviation (sigma) of alpha, before and after the fit")


def page(result: PositionsResult) -> Page:
    """Return the page of a calibration to every position."""
    room, interval = result.prior, result.interval
    order = [room.material_index(name) for name, _, _ in result.learned[:MOST_MATERIALS]]
    *gaps, materials = tables(result.blocks())
    headline = _headline(result)
    left = len(room.materials) - len(order)
    labels, at_bound = bands.labels(room.centre_frequencies), np.isin(result.alpha, (0.0, 1.0))
    intervals = ", with 90 % intervals" if interval is not None else ""
    runs = 0 if result.controls is None else len(result.controls.errors)
    return Page(
        room.name,
        room.author,
        "calibration of a simulator to what was measured at every position",
        [
            *([Box("contradicts", result.warning)] if result.warning else []),
            *([Box("open", headline)] if headline else []),
            Section("Summary", "summary"),
            *(Note(sentence, kind="lead") for sentence in _summary(result)),
            Table(
                labels,
                _times(result.matched),
                "Decay times: means over the pairs that were fitted",
            ),
            *room_view.of_positions(result),
            Section("Cautions", "cautions"),
            Table(["Where and what", "What to do"], result.doubts, corner="Caution"),
            *(
                []
                if result.doubts
                else [Note("None of rtcal's checks found a reason for caution.")]
            ),
            Section("What was learned", "learned"),
            Note(
                "Sigma is the standard deviation of a coefficient, the root mean square over the "
                "bands. The materials that the measurement determines best are first."
            ),
            replace(materials, corner="Material", most=range(len(order))),
            Table(
                labels,
                [
                    Row(room.materials[i], result.shift[i], "+.1f", result.shift[i] / 2)
                    for i in order
                ],
                "Shift of each coefficient in prior standard deviations",
                "Material",
                "Above 2 either the prior sigma was too small, or something is missing.",
            ),
            coefficients(
                f"Absorption coefficients: input → calibrated{intervals}",
                room,
                result.alpha,
                interval,
                at_bound,
                order,
            ),
            *(
                [
                    Note(
                        f"{left} further materials, which the measurement determines less, are in "
                        "result.json."
                    )
                ]
                if left
                else []
            ),
            Section("Deviations by pair", "gaps"),
            Note(
                "Misfit is the deviation of a pair divided by what the other pairs lead to expect."
            ),
            *gaps,
            *_held_out(result),
            Section("What was assumed", "assumed"),
            Note(
                f"The coefficients are valid only for {result.simulator}. The interval "
                "is that of a normal distribution. The simulator's error was learned from "
                f"{runs} reference simulations."
            ),
            Items(result.every_note),
            Section("How to reproduce", "reproduce"),
            *_reproduced(result),
            Note(f"rtcal {__version__}."),
        ],
    )


def _headline(result: PositionsResult) -> str:
    """Return what the calibrated simulator lacks of what was matched; "" where all is within 1 JND."""
    left = {p: rms(gap) for p, gap in zip(result.parameters, result.gap_after, strict=True)}
    far = sorted((p for p in left if left[p] >= _REMAINS), key=lambda p: -left[p])
    if not far:
        return ""
    gaps = ", ".join(f"{parameter_label(p)} {left[p]:.1f} JND" for p in far)
    said = (
        "The calibrated simulator does not agree with the measurement. Remaining deviations, "
        f"root mean square over pairs and bands: {gaps}."
    )
    measured = result.measured.observations
    for key in (p for p in far if p in of_kind(DecaySlope)):
        goal, time = (_mean(measured, of, key) for of in (measured, result.matched.after))
        k = int(np.nanargmax(np.abs(time / goal - 1)))
        said += (
            f" {parameter_label(key)} is {time[k]:.2f} s instead of the measured {goal[k]:.2f} "
            f"s, mean over the pairs at {bands.label(result.prior.centre_frequencies[k])}."
        )
    return said


def _summary(result: PositionsResult) -> list[str]:
    n, tested = len(result.pairs), ""
    if result.held_out is not None:
        before, after = rms(result.held_out.gap_before), rms(result.held_out.gap_after)
        tested = f"; at the pairs that were held out it went from {before:.1f} to {after:.1f}"
    learned = [name for name, old, new in result.learned if old and new <= _LEARNED * old]
    most = ", ".join(f"“{name}”" for name in learned[:3])
    return [
        "The absorption coefficients were fitted to "
        f"{', '.join(map(parameter_label, result.parameters))} at {n} pair{'s' * (n > 1)} of a "
        "source and a receiver.",
        f"The root mean square deviation went from {rms(result.gap_before):.1f} to "
        f"{rms(result.gap_after):.1f} just noticeable differences (JND){tested}.",
        f"The measurement determines {len(learned)} of {result.prior.n_materials} materials, most of "
        f"{most}."
        if learned
        else "The measurement determines hardly any single material.",
    ]


def _times(found: Compared) -> list[Row]:
    """Return each decay time by band in s, the means over the pairs: measured, before, after."""
    return [
        Row(f"{parameter_label(key)} {name} / s", _mean(found.measured, of, key), ".2f")
        for key in of_kind(DecaySlope)
        if key in found.parameters
        for name, of in (
            ("measured", found.measured),
            ("before", found.before),
            ("after", found.after),
        )
    ]


def _mean(measured: Observations, of: Observations, key: str) -> Array:
    """Return a parameter's mean (n_bands,) over the pairs that have a measured value in the band."""
    known = np.isfinite(measured.natural(key))
    number = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.asarray(np.where(known, of.natural(key), 0.0).sum(axis=0) / number)


def _held_out(result: PositionsResult) -> list[Any]:
    """Return the pairs that were left out: gaps of each, and the decay times."""
    left = result.held_out
    if left is None:
        said = (
            "No measured pair was held out. To test the fit, exclude a few: --exclude "
            "SOURCE:RECEIVER."
        )
        return [Note(said, kind="note")]
    return [
        Section("Positions that were held out", "held-out"),
        Note(
            "These pairs were measured and excluded from the fit, so they test it. Their root mean "
            f"square deviation went from {rms(left.gap_before):.1f} to {rms(left.gap_after):.1f} JND."
        ),
        _gap_table(left.parameters, left.measured.pairs, left.gap_before, left.gap_after),
        Table(
            bands.labels(result.prior.centre_frequencies),
            _times(left),
            "Decay times: means over the pairs that were held out",
        ),
    ]


def command(result: PositionsResult) -> str | None:
    """Return the shell command that gives the same result; None for another simulator or terms."""
    tracer: Any = result.tracer
    if result.start is None:
        return None
    chosen = [text for p in result.parameters for text in ("--match", p)]
    chosen += ["--paths", str(tracer.n_paths), "--seed", str(result.seed)]
    if result.held_out is not None:
        for source, receiver in result.held_out.measured.pairs:
            chosen += ["--exclude", f"{source}:{receiver}"]
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


def _reproduced(result: PositionsResult) -> list[Any]:
    repeated = command(result)
    if repeated is None:
        said = (
            "This calibration was made in Python with a simulator that the command does not have."
        )
        return [Note(said)]
    stated = "S is the scattering coefficient used by the simulator."
    more = [Note(stated)] if " S " in repeated else []
    return [Code(f"{repeated}\nrtcal report fitted"), *more]
