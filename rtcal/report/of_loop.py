"""The page of a closed loop: its outcome in words and tables, and the figure of its path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.loop.closed import Loop, LoopResult
from rtcal.loop.measured_pairs import sentences
from rtcal.report import figures
from rtcal.report.document import Code, Items, Page, Picture, Section, coefficients, doubts, tables
from rtcal.support import __version__
from rtcal.support.blocks import Note, Row, Table

_STATUS_IN_WORDS = {
    "converged": "came within the goal",
    "unreachable": "cannot come nearer: no coefficients within the equation's range do better",
    "not converging": "did not come within the goal",
    "not yet": "did not come within the goal yet",
    "no measured T": "had no measured T and keeps the stated coefficients",
    "by modes": "lay below the Schroeder frequency: room modes stand there in place of T",
    "too few modes": "lay below the Schroeder frequency, where fewer than three room modes were used",
    "not confirmed": "came within the goal, but not with fresh random numbers, or the simulator's "
    "noise is too large to tell: simulate with less of it (more paths)",
}


def statuses(loop: Loop) -> tuple[str, ...]:
    """Return the status of each band as a user reads it: while the loop goes on, nothing has failed."""
    unfinished = not loop.finished
    return tuple("not yet" if unfinished and s == "not converging" else s for s in loop.status)


def band_rows(loop: Loop) -> list[Row]:
    """Return the rows of T by band: measured, first, nearest, their gaps, z, and which is nearest."""
    first = loop.steps[0].simulated
    nearest = np.array([loop.steps[b].simulated[k] for k, b in enumerate(loop.best)])
    return [
        Row("measured T / s", loop.wanted, ".3f"),
        Row("first simulated / s", first, ".3f"),
        Row("nearest simulated / s", nearest, ".3f"),
        Row("first gap / JND", gap_jnd(first, loop.wanted), "+.1f"),
        Row("gap left / JND", loop.gap, "+.2f"),
        Row("z", loop.outcome.plausibility.z, "+.1f"),
        Row("nearest simulation", [int(b) + 1 for b in loop.best], "d"),
    ]


def other_rows(loop: Loop) -> list[Row]:
    """Return what each parameter lost in a compromise, and what was measured and not matched."""
    rows = []
    for parameter, part in loop.compromise.items() if len(loop.compromise) > 1 else ():
        name = parameter_label(parameter)
        rows += [
            Row(f"{name}, share of the weights", part.share, ".2f"),
            Row(f"{name}, first gap / JND", part.before, "+.1f"),
            Row(f"{name}, gap left / JND", part.after, "+.1f"),
            Row(f"{name}, lost / JND", part.lost, ".1f"),
        ]
    for p, wanted in loop.beside.items():
        name, of, form = parameter_label(p), observable(p).unit, f".{observable(p).decimals}f"
        rows += [
            Row(f"{name}, measured / {of}", wanted, form),
            Row(f"{name}, first / {of}", loop.first(p), form),
            Row(f"{name}, nearest simulated / {of}", loop.nearest(p), form),
        ]
    return rows


def page(result: Loop | LoopResult) -> Page:
    """Return the page of a closed loop; DataError if it has no simulation."""
    final = result if isinstance(result, LoopResult) else None
    loop = result.loop if isinstance(result, LoopResult) else result
    room, label = loop.room, loop.matched.label
    status = statuses(loop) if final is None else final.status
    first = figures.path(loop)
    labels = bands.labels(room.centre_frequencies)
    more = other_rows(loop) if final is None else []
    rows = [*band_rows(loop), *more, Row("status", list(status))]
    ends = _at_ends(loop)
    return Page(
        room.name,
        room.author,
        "calibration of a simulator in the closed loop",
        [
            Section("Summary", "summary"),
            *map(Note, _summary(loop, status)),
            *([] if final is None else [Note(_confirmed(final))]),
            *map(Note, sentences(result.gaps_beside, room.centre_frequencies)),
            Picture(
                lambda: first,
                f"By band: {label}, and how far each simulation was off. One JND is 5 %.",
            ),
            Section("Tables", "tables"),
            Table(labels, rows, "By band"),
            coefficients(
                "Absorption coefficients: stated → of each band's nearest simulation",
                room,
                loop.best_alpha,
            ),
            Section("What not to believe", "doubts"),
            *doubts(loop.trust_marks),
            *_warned(ends),
            *([] if final is None else _before_and_after(final)),
            Section("What was assumed", "assumed"),
            Items(_assumed(loop)),
            Section("How to reproduce", "reproduce"),
            *_reproduced(loop),
        ],
    )


def _summary(loop: Loop, status_of_bands: Sequence[str]) -> list[str]:
    """Return the loop as a few sentences; ``status_of_bands`` is each band's status."""
    f, first = loop.room.centre_frequencies, gap_jnd(loop.steps[0].simulated, loop.wanted)
    n = len(loop.steps)
    sentences = [
        f"Likely a typing error at {mark.frequency:g} Hz: {mark.text}. Check this value before "
        "anything else."
        for mark in loop.trust_marks
        if "typing_error" in mark.kind
    ]
    sentences += [
        f"A simulator was run {n} time{'' if n == 1 else 's'}, and after each run the absorption "
        f"coefficients were changed so that {loop.matched.label} comes nearer to what was measured."
    ]
    compared = np.isfinite(first)
    if compared.any():
        sentences.append(
            f"The first run was off by {np.abs(first[compared]).max():.1f} JND in the worst band; in "
            f"each band's nearest run {np.abs(loop.gap[compared]).max():.1f} JND are left."
        )
    for status, description in _STATUS_IN_WORDS.items():
        some = [float(v) for v, s in zip(f, status_of_bands, strict=True) if s == status]
        if some:
            which = "All bands" if len(some) == len(f) else bands.hertz(some)
            sentences.append(f"{which} {description}.")
    sentences += [] if loop.low is None else loop.low.doubts
    if not loop.finished:
        sentences.append("The loop is not finished: simulate again and run `rtcal loop next`.")
    return sentences


def _confirmed(result: LoopResult) -> str:
    """Return the gap with the coefficients returned, as a sentence."""
    gap, f = np.abs(result.gap), result.loop.room.centre_frequencies
    if not np.isfinite(gap).any():
        return "What the coefficients returned give was not simulated."
    k = int(np.nanargmax(gap))
    how = "With all the coefficients returned"
    if result.confirmation is not None:
        how = "With random numbers that the calibration did not use"
    return f"{how}, {result.loop.matched.label} is off by {gap[k]:.1f} JND at most, at {f[k]:g} Hz."


def _at_ends(loop: Loop) -> list[str]:
    """Return which coefficients moved to 0 or 1, in each band's best simulation, by material."""
    f, before, after = loop.room.centre_frequencies, loop.room.alpha, loop.best_alpha
    sentences = []
    for i, name in enumerate(loop.room.materials):
        for end in (0.0, 1.0):
            moved = (after[i] == end) & (before[i] != end)
            if moved.any():
                sentences.append(f"{name}: α = {end:g} at {bands.hertz(f[moved])}")
    return sentences


def _warned(ends: Sequence[str]) -> list[Any]:
    if not ends:
        return []
    return [
        Note(
            "At an end of what is possible. This is a warning and no finding: its or another's stated "
            "standard deviation is too small, an effect is missing, or the simulator is too noisy."
        ),
        Items(ends),
    ]


def _before_and_after(result: LoopResult) -> list[Any]:
    """Return the tables that the result prints."""
    again = "; what is simulated, with random numbers that the calibration has not seen"
    return [
        Section("Before and after", "ends"),
        Note(
            f"Simulated by {result.simulator}{again if result.confirmation else ''}. Only "
            f"{result.loop.matched.label} was fitted. Means over the positions."
        ),
        *tables(result.blocks()),
    ]


def _assumed(loop: Loop) -> list[str]:
    """Return the assumptions of the loop, and the use for which its coefficients are valid."""
    return [
        "The coefficients belong to the simulator that they were calibrated with, to its geometry, its "
        "positions and its meaning of scattering, and to no other.",
        "How the absorption is shared among the materials follows from the stated coefficients and "
        f"their standard deviations, by the calibration of {loop.equation.name}'s equation (method "
        f"{loop.method}); the loop moves only how much there is in all.",
        f"Rule {loop.rule}; a band is done within {loop.tolerance:g} JND less the simulator's noise.",
        "Coefficients as stated to full precision."
        if loop.decimals is None
        else f"Coefficients rounded to {loop.decimals} decimals, as the program reads them.",
        f"Only {loop.matched.label} was fitted. That it agrees proves nothing of other parameters or "
        "positions.",
    ]


def _reproduced(loop: Loop) -> list[Any]:
    """Return the commands of the loop."""
    shares = loop.matched.shares
    uneven = any(np.ptp(share) > 0 for share in shares.values())
    options = ["--method", loop.method, "--rule", loop.rule]
    if loop.equation != Eyring():
        options += ["--equation", loop.equation.key]
    if len(shares) > 1 and not uneven:
        options += [text for p, s in shares.items() for text in ("--weight", f"{p}={s[0]:.3g}")]
    if loop.decimals:
        options += ["--decimals", str(loop.decimals)]
    in_python = (
        " (weights that differ between bands are stated in Python: rtcal.loop.start(…, weights=…))"
    )
    files = "--state loop.json --out next.toml"
    return [
        Note(
            "The state of the loop holds the room, the target and the outcome of every simulation. "
            "With the room's file and the measurement that it was started with, and the same "
            f"simulator{in_python if uneven else ''}:"
        ),
        Code(
            f"rtcal loop start room.toml measured.csv {files} {' '.join(options)}\n\n"
            "(simulate next.toml, write simulated.csv, then, until it says Done:)\n"
            f"rtcal loop next room.toml simulated.csv {files}"
        ),
        Note(f"rtcal {__version__}. Fingerprint of the measured T: {loop.measured}."),
    ]
