"""The page of a closed loop: its outcome in words and tables, and the figure of its path."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Eyring
from rtcal.loop.closed import Loop
from rtcal.report import figures
from rtcal.report.document import Code, Items, Page, Picture, Section, coefficients, summary, tables
from rtcal.support import __version__
from rtcal.support.blocks import Note

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
    room, matched, printed = loop.prior, loop.matched.label, loop.blocks()
    first = figures.path(loop)
    picture = Picture(
        lambda: first,
        f"By band: {matched}, and how far each simulation was off. One JND is 5 %.",
    )
    blocks = [
        *summary(printed, picture, _by_status(loop)),
        Section("Tables", "tables"),
        *tables(printed),
        coefficients("Absorption coefficients: input → calibrated", room, loop.alpha),
        Section("Technical details", "details"),
        Items(_assumed(loop)),
        *_reproduced(loop),
    ]
    return Page(room.name, room.author, "calibration of a simulator in the closed loop", blocks)


def _by_status(loop: Loop) -> list[str]:
    """Return which bands ended how, a sentence for each status."""
    f, said = loop.prior.centre_frequencies, list[str]()
    for status, description in _STATUS_IN_WORDS.items():
        some = [float(v) for v, s in zip(f, loop.status_now, strict=True) if s == status]
        if some:
            which = "All bands" if len(some) == len(f) else bands.hertz(some)
            said.append(f"{which} {description}.")
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
    options = ["--method", loop.method, "--rule", loop.rule]
    if loop.equation != Eyring():
        options += ["--equation", loop.equation.key]
    if any(np.ptp(share) > 0 for share in shares.values()):
        options.append("(weights by band: in Python, rtcal.loop.start(…, weights=…))")
    elif len(shares) > 1:
        options += [text for p, s in shares.items() for text in ("--weight", f"{p}={s[0]:.3g}")]
    if loop.decimals:
        options += ["--decimals", str(loop.decimals)]
    files = "--state loop.json --out next.toml"
    return [
        Code(
            f"rtcal loop start room.toml measured.csv {files} {' '.join(options)}\n\n"
            "(simulate next.toml, write simulated.csv, then, until it says Done:)\n"
            f"rtcal loop next room.toml simulated.csv {files}"
        ),
        Note(f"rtcal {__version__}. Fingerprint of the measured T: {loop.data}."),
    ]
