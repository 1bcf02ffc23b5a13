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
from rtcal.report.document import Box, Code, Items, Page, Section, coefficients, notes, tables
from rtcal.simulators.base import Observations
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import listed, numbers, with_uncertainty
from rtcal.support.types import Array

_MISFIT = (
    "Misfit: squared deviation from what the other pairs predict, over its variance; 1 is usual."
)
_DEVIATION = "deviation / JND, before to after the fit"
_AUDIBLE = 1.0
"""Root mean square deviation in JND of a parameter from which model and measurement differ."""
_STRONG = 2.0  # shift in standard deviations at which the ground of a number saturates


def _gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = f"Root mean square {_DEVIATION}",
    misfit: Array | None = None,
) -> Table:
    """Return the table of deviations before and after calibration, for each pair and for all pairs."""
    columns = [parameter_label(p) for p in parameters]
    every = [*([i] for i in range(len(pairs))), [*range(len(pairs))]]
    names = [*(" to ".join(pair) for pair in pairs), "all"]
    cells = [
        [
            " to ".join(numbers(ends, ".1f"))
            for ends in zip(*(rms(g[:, of], axis=(1, 2)) for g in (before, after)), strict=True)
        ]
        for of in every
    ]
    if misfit is not None:
        columns.append("misfit")
        own = [*numbers(misfit, ".1f"), "-"]
        cells = [[*row, each] for row, each in zip(cells, own, strict=True)]
    rows = [Row(name, row) for name, row in zip(names, cells, strict=True)]
    return Table(columns, rows, title, "pair", "" if misfit is None else _MISFIT)


def blocks(result: PositionsResult) -> list[Block]:
    """Return the blocks that a calibration prints."""
    ends = result.beside.gap_before, result.beside.gap_after
    more = result.beside.parameters
    before, after = rms(result.gap_before), rms(result.gap_after)
    verb = "reduces" if after < before else "changes"
    fitted = listed([parameter_label(p) for p in result.parameters])
    n = len(result.pairs)
    said = [
        f"The fit {verb} the deviation from the measurement from {before:.1f} to {after:.1f} "
        f"JND (root mean square over {fitted} at {n} pair{'s' * (n != 1)})."
    ]
    if result.warning:
        first = bool(result.refused or result.of_input or result.beyond)
        said.insert(0 if first else 1, f"{'' if first else 'Caution: '}{result.warning}")
    return [
        *map(Note, said),
        *(Note(f"Caution: {row.name}: {' '.join(row.values)}") for row in result.doubts),
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
        *(Note(f"Note: {note}") for note in result.further),
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
    room, printed = result.prior, result.blocks()
    *gaps, materials = tables(printed)
    lead, *further = notes(printed)
    audible = any(rms(gap) >= _AUDIBLE for gap in result.gap_after)
    level = "contradicts" if result.warning else "open" if audible else "agrees"
    order = [room.material_index(name) for name, _, _ in result.learned]
    labels = bands.labels(room.centre_frequencies)
    shifts = [
        Row(room.materials[i], result.shift[i], "+.1f", result.shift[i] / _STRONG) for i in order
    ]
    runs = 0 if result.controls is None else len(result.controls.errors)
    blocks = [
        Box(level, lead),
        Items(further),
        *room_view.of_positions(result),
        Section("What was learned", "learned"),
        Note(
            "Sigma is the standard deviation of a coefficient, the root mean square over the bands. "
            "The materials that the measurement determines best are first."
        ),
        replace(materials, corner="Material"),
        Table(
            labels,
            shifts,
            "Shift of each coefficient in prior standard deviations",
            "Material",
            "Above 2 either the prior sigma was too small, or something is missing.",
        ),
        coefficients(
            "Absorption coefficients: input → calibrated, below it the 90 % interval, of a normal "
            "distribution",
            room,
            result.alpha,
            result.interval,
            np.isin(result.alpha, (0.0, 1.0)),
            order,
        ),
        Section("Deviations by pair", "gaps"),
        Table(labels, _times(result.matched), "Decay times: means over the pairs that were fitted"),
        *gaps,
        *_held_out(result),
        Section("Technical details", "details"),
        Note(f"The simulator's error was learned from {runs} reference simulations."),
        *_reproduced(result),
        Note(f"rtcal {__version__}."),
    ]
    subject = "calibration of a simulator to what was measured at every position"
    return Page(room.name, room.author, subject, blocks)


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
        return [
            Note("To test the fit, exclude a few pairs: --exclude SOURCE:RECEIVER.", kind="note")
        ]
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
        return [Note("The simulator was made in Python.")]
    more = [Note("S is the scattering coefficient used by the simulator.")]
    return [Code(f"{repeated}\nrtcal report fitted"), *more * (" S " in repeated)]
