"""The page of a closed loop: its outcome in words and tables, and the figure of its path."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import gap_jnd
from rtcal.loop.closed import Loop
from rtcal.loop.measured_pairs import sentences
from rtcal.report import figures
from rtcal.report.document import (
    Code,
    Items,
    Page,
    Picture,
    Section,
    cautions,
    coefficients,
    tables,
)
from rtcal.support import __version__
from rtcal.support.blocks import Note
from rtcal.support.text import as_sentence

_STATUS_IN_WORDS = {
    "converged": "came within the goal",
    "unreachable": "cannot come nearer, because no coefficients within the equation's range give a "
    "smaller deviation",
    "not converging": "did not come within the goal",
    "not yet": "did not come within the goal yet",
    "no measured T": "had no measured T and keeps the input coefficients",
    "by modes": "lay below the Schroeder frequency, where room modes are used instead of T",
    "too few modes": "lay below the Schroeder frequency, where fewer than three room modes were used",
    "not confirmed": "came within the goal, but not with fresh random numbers, or the simulator's "
    "noise is too large to decide: simulate with less of it (more paths)",
}


def page(loop: Loop) -> Page:
    """Return the page of a closed loop; DataError if it has no simulation."""
    room, matched = loop.prior, loop.matched.label
    first = figures.path(loop)
    return Page(
        room.name,
        room.author,
        "calibration of a simulator in the closed loop",
        [
            Section("Summary", "summary"),
            *map(Note, _summary(loop)),
            *map(Note, sentences(loop.gaps_beside, room.centre_frequencies)),
            Picture(
                lambda: first,
                f"By band: {matched}, and how far each simulation was off. One JND is 5 %.",
            ),
            Section("Tables", "tables"),
            Note(
                f"Only {matched} was fitted. Means over the positions, in the first simulation "
                "and with the best coefficients of each band."
            ),
            *tables(loop.blocks()),
            coefficients("Absorption coefficients: input → calibrated", room, loop.alpha),
            Section("Cautions", "cautions"),
            *cautions(loop.trust_marks),
            Section("What was assumed", "assumed"),
            Items(_assumed(loop)),
            Section("How to reproduce", "reproduce"),
            *_reproduced(loop),
        ],
    )


def _summary(loop: Loop) -> list[str]:
    """Return the loop as a few sentences."""
    f, first = loop.prior.centre_frequencies, gap_jnd(loop.ends[0].simulated, loop.wanted)
    n = loop.simulations
    said = [as_sentence(mark.sentence) for mark in loop.trust_marks if "typing_error" in mark.kind]
    said.append(
        f"{loop.simulator or 'A simulator'} was run {n} time{'s' * (n != 1)}, and after each run the "
        f"absorption coefficients were changed so that {loop.matched.label} comes nearer to what "
        "was measured."
    )
    if (compared := np.isfinite(first) & np.isfinite(loop.gap)).any():
        gap = np.where(compared, np.abs(loop.gap), -np.inf)
        how = "in the best run of each band"
        if loop.final is not None:
            how = "with the returned coefficients in all bands"
        if loop.confirmation is not None:
            how += " and random numbers that the calibration did not use"
        k = int(np.argmax(gap))
        said.append(
            f"The first run was off by {np.abs(first[compared]).max():.1f} JND in the worst band; "
            f"{how}, {loop.matched.label} is off by {gap[k]:.1f} JND at most, at {f[k]:g} Hz."
        )
    status_of_bands = loop.status_now
    for status, description in _STATUS_IN_WORDS.items():
        some = [float(v) for v, s in zip(f, status_of_bands, strict=True) if s == status]
        if some:
            which = "All bands" if len(some) == len(f) else bands.hertz(some)
            said.append(f"{which} {description}.")
    said += [] if loop.low is None else loop.low.doubts
    if "not yet" in status_of_bands:
        said.append("The loop is not finished: simulate again and run `rtcal loop next`.")
    return said


def _assumed(loop: Loop) -> list[str]:
    """Return the assumptions of the loop, and the use for which its coefficients are valid."""
    return [
        "The coefficients belong to the simulator that they were calibrated with, with the same "
        "geometry, positions and scattering model, and to no other.",
        "How the absorption is shared among the materials follows from the input coefficients "
        f"and their standard deviations, by the calibration of {loop.equation.name}'s equation "
        f"(method {loop.method}); the loop changes only the total absorption.",
        f"Rule {loop.rule}; a band is finished when its deviation is below "
        f"{loop.tolerance:g} JND minus the simulator's noise.",
        "The coefficients were not rounded."
        if loop.decimals is None
        else f"Coefficients rounded to {loop.decimals} decimals, as the program reads them.",
        f"Only {loop.matched.label} was fitted. Its agreement proves nothing about other "
        "parameters or positions.",
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
        " (weights that differ between bands are given in Python: rtcal.loop.start(…, weights=…))"
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
        Note(f"rtcal {__version__}. Fingerprint of the measured T: {loop.data}."),
    ]
