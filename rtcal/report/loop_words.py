"""The outcome of a closed loop, in words and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.observables import OBSERVABLES, TARGET, observable, parameter_label
from rtcal.acoustics.quality import gap_jnd
from rtcal.report.document import material_rows
from rtcal.report.words import hertz

if TYPE_CHECKING:
    from rtcal.loop.matched import ParameterGap
    from rtcal.loop.result import LoopResult
    from rtcal.loop.state import Loop

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


def summary(loop: Loop, status_of_bands: Sequence[str]) -> list[str]:
    """Return the loop as a few sentences; ``status_of_bands`` is each band's status."""
    f, first = loop.room.centre_frequencies, gap_jnd(loop.steps[0].simulated, loop.wanted)
    n = len(loop.steps)
    sentences = [
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
        bands = [float(v) for v, s in zip(f, status_of_bands, strict=True) if s == status]
        if bands:
            which = "All bands" if len(bands) == len(f) else hertz(bands)
            sentences.append(f"{which} {description}.")
    sentences += [] if loop.low is None else loop.low.doubts
    if not loop.finished:
        sentences.append("The loop is not finished: simulate again and run `rtcal loop next`.")
    return sentences


def assumed(loop: Loop) -> list[str]:
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


def equation_option(loop: Loop) -> str:
    """Return the equation as an option of `rtcal loop start`; empty for Eyring's, the default."""
    if loop.equation == Eyring():
        return ""
    return f" --equation {loop.equation.key}"


def weights_option(loop: Loop) -> str | None:
    """Return the weights as options of `rtcal loop start`; None where they differ between bands."""
    shares = loop.matched.shares
    if len(shares) == 1:
        return ""
    if any(np.ptp(share) > 0 for share in shares.values()):
        return None
    return "".join(f" --weight {p}={share[0]:.3g}" for p, share in shares.items())


def lost_rows(compromise: Mapping[str, ParameterGap]) -> list[tuple[str, Any, int, bool]]:
    """Return the rows of what each parameter lost in a compromise; none for T20 alone."""
    if len(compromise) == 1:
        return []
    return [
        row
        for parameter, part in compromise.items()
        for row in (
            (f"{parameter_label(parameter)}, share of the weights", part.share, 2, False),
            (f"{parameter_label(parameter)}, first gap / JND", part.before, 1, True),
            (f"{parameter_label(parameter)}, gap left / JND", part.after, 1, True),
            (f"{parameter_label(parameter)}, lost / JND", part.lost, 1, False),
        )
    ]


def beside_rows(loop: Loop) -> list[tuple[str, Any, int, bool]]:
    """Return the rows of what was measured and not matched: measured, in the first and nearest run."""
    return [
        (
            f"{parameter_label(p)}, {when} / {observable(p).unit}",
            values,
            observable(p).decimals,
            False,
        )
        for p, wanted in loop.beside.items()
        for when, values in (
            ("measured", wanted),
            ("first", loop.first(p)),
            ("nearest simulated", loop.nearest(p)),
        )
    ]


def bands_table(loop: Loop, status: Sequence[str]) -> dict[str, Any]:
    """Return the rows of the table by band."""
    nearest = np.array([loop.steps[b].simulated[k] for k, b in enumerate(loop.best)])
    return {
        "numbers": [
            ("measured T / s", loop.wanted, 3, False),
            ("first simulated / s", loop.steps[0].simulated, 3, False),
            ("nearest simulated / s", nearest, 3, False),
            ("first gap / JND", gap_jnd(loop.steps[0].simulated, loop.wanted), 1, True),
            ("gap left / JND", loop.gap, 2, True),
            ("z", loop.outcome.plausibility.z, 1, True),
        ],
        "nearest": [int(b) + 1 for b in loop.best],
        "status": status,
    }


def at_ends(loop: Loop) -> list[str]:
    """Return sentences on coefficients that moved to 0 or 1, in each band's best simulation."""
    sentences = []
    for row in materials_table(loop):
        for end in (0.0, 1.0):
            bands = [
                float(frequency)
                for frequency, cell in zip(loop.room.centre_frequencies, row["cells"], strict=True)
                if cell["after"] == end != cell["before"]
            ]
            if bands:
                sentences.append(f"{row['name']}: α = {end:g} at {hertz(bands)}")
    return sentences


def confirmed(loop: Loop, ends: dict[str, Any]) -> str:
    """Return the gap with the coefficients returned, as a sentence."""
    gap = np.abs(ends["gap"])
    if not np.isfinite(gap).any():
        return "What the coefficients returned give was not simulated."
    k = int(np.nanargmax(gap))
    how = (
        "With random numbers that the calibration did not use"
        if ends["confirmed"]
        else ("With all the coefficients returned")
    )
    return (
        f"{how}, {loop.matched.label} is off by {gap[k]:.1f} JND at most, at "
        f"{loop.room.centre_frequencies[k]:g} Hz."
    )


def ends(result: LoopResult) -> dict[str, Any]:
    """Return the simulator's name, the gap, and the rows of the parameters before and after."""
    columns = (
        ("measured", result.measured),
        ("first", result.before),
        ("with the coefficients returned", result.final),
    )
    rows = [
        (
            f"{parameter_label(name)}, {when} / {kind.unit}",
            measurement.mean(name),
            kind.decimals,
            False,
        )
        for name, kind in OBSERVABLES.items()
        for when, measurement in columns
        if kind.shown
        and measurement is not None
        and name in measurement.values
        and not (kind is TARGET and when == "measured")
    ]
    matched = result.loop.matched
    of = "its gap" if len(matched.shares) == 1 else f"gap of {matched.label}"
    rows.insert(2, (f"{of} / JND", result.gap, 1, True))
    return {
        "simulator": result.simulator,
        "confirmed": result.confirmation is not None,
        "status": result.status,
        "rows": rows,
        "gap": result.gap,
    }


def materials_table(loop: Loop) -> list[dict[str, Any]]:
    """Return name, area and coefficients, stated and in each band's best run."""
    room = loop.room
    after = loop.best_alpha
    return material_rows(room.materials, room.areas, room.alpha, after)
