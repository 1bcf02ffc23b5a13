"""The page of a closed loop: its outcome in words and tables, and the figure of its path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.observables import OBSERVABLES, TARGET, observable, parameter_label
from rtcal.loop import matched
from rtcal.loop.calibrate import LoopResult
from rtcal.loop.matched import ParameterGap
from rtcal.loop.state import Loop
from rtcal.report import words
from rtcal.report.document import Heading, blocks, material_rows, render, source
from rtcal.report.figures import AFTER, BEFORE, BLACK, band_axis, jnd_band, new_figure, shown
from rtcal.report.words import hertz
from rtcal.support.blocks import Row
from rtcal.support.errors import DataError

__all__ = ["page", "path"]
__dir__ = __all__.copy

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
    typed = [mark for mark in loop.trust_marks if "typing_error" in mark.kind]
    sentences = [
        f"Likely a typing error at {mark.frequency:g} Hz: {mark.text}. Check this value before "
        "anything else."
        for mark in typed
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


def lost_rows(compromise: Mapping[str, ParameterGap]) -> list[Row]:
    """Return the rows of what each parameter lost in a compromise; none for T20 alone."""
    if len(compromise) == 1:
        return []
    return [
        row
        for parameter, part in compromise.items()
        for row in (
            Row(f"{parameter_label(parameter)}, share of the weights", part.share, ".2f"),
            Row(f"{parameter_label(parameter)}, first gap / JND", part.before, "+.1f"),
            Row(f"{parameter_label(parameter)}, gap left / JND", part.after, "+.1f"),
            Row(f"{parameter_label(parameter)}, lost / JND", part.lost, ".1f"),
        )
    ]


def beside_rows(loop: Loop) -> list[Row]:
    """Return the rows of what was measured and not matched: measured, in the first and nearest run."""
    return [
        Row(
            f"{parameter_label(p)}, {when} / {observable(p).unit}",
            values,
            f".{observable(p).decimals}f",
        )
        for p, wanted in loop.beside.items()
        for when, values in (
            ("measured", wanted),
            ("first", loop.first(p)),
            ("nearest simulated", loop.nearest(p)),
        )
    ]


def band_rows(loop: Loop) -> list[Row]:
    """Return the rows of the table by band."""
    nearest = np.array([loop.steps[b].simulated[k] for k, b in enumerate(loop.best)])
    return [
        Row("measured T / s", loop.wanted, ".3f"),
        Row("first simulated / s", loop.steps[0].simulated, ".3f"),
        Row("nearest simulated / s", nearest, ".3f"),
        Row("first gap / JND", gap_jnd(loop.steps[0].simulated, loop.wanted), "+.1f"),
        Row("gap left / JND", loop.gap, "+.2f"),
        Row("z", loop.outcome.plausibility.z, "+.1f"),
    ]


def nearest_simulations(loop: Loop) -> list[int]:
    """Return the number of each band's nearest simulation, from 1."""
    return [int(b) + 1 for b in loop.best]


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
        Row(
            f"{parameter_label(name)}, {when} / {kind.unit}",
            measurement.mean(name),
            f".{kind.decimals}f",
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
    rows.insert(2, Row(f"{of} / JND", result.gap, "+.1f"))
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


_MARKERS = "o^vDPX<>"
_STYLES = ("-", "--", "-.", ":")


def path(loop: Loop) -> Any:
    """Return the figure of a loop's path, like Fig. 7 of Bellows & Katz (2025).

    Above: the measured T20 with its band of one JND, and the simulated T20 of the first, the
    intermediate and each band's best step. Below: each band's gap in JND over the simulations.

    Raises
    ------
    DataError
        If nothing has been simulated yet.
    """
    if not loop.steps:
        raise DataError("the loop has no simulation yet: there is no path to show")
    figure, (above, below) = new_figure(6.2, 7.6, 2, 1)
    f, wanted = loop.room.centre_frequencies, loop.wanted
    jnd_band(above, f, wanted)
    above.plot(f, wanted, color=BLACK, marker="o", markersize=4, label="measured")
    simulated = np.array([step.simulated for step in loop.steps])
    for number, times in enumerate(simulated[1:-1], start=2):
        label = "in between" if number == 2 else None
        above.plot(f, times, color="0.45", linestyle=":", linewidth=1, label=label)
    above.plot(f, simulated[0], **BEFORE, label="first simulation")
    nearest = simulated[loop.best, np.arange(len(f))]
    above.plot(f, nearest, **AFTER, label="nearest, by band")
    band_axis(above, f)
    above.set_ylabel(f"{loop.matched.label.removeprefix('the ')} / s")
    above.set_ylim(bottom=0)
    above.set_title(shown(loop.room.name, 45))
    above.legend(fontsize=9)
    gaps = np.array([gap_jnd(times, wanted) for times in simulated])
    steps = np.arange(1, len(gaps) + 1)
    below.axhspan(-1, 1, color="0.85")
    below.axhline(0, color=BLACK, linewidth=0.8)
    greys = np.linspace(0.0, 0.6, len(f))
    for k, frequency in enumerate(f):
        blue = (greys[k], 0.25 + 0.65 * greys[k], 0.45 + 0.35 * greys[k])
        marker = _MARKERS[k % len(_MARKERS)]
        line = {"linestyle": _STYLES[(k + k // len(_MARKERS)) % len(_STYLES)], "marker": marker}
        below.plot(steps, gaps[:, k], color=blue, **line, label=f"{frequency:g} Hz")
    below.set_xticks(steps)
    below.set_xlim(0.7, len(steps) + 0.3)
    reach = 1.2 * max(1.5, float(np.nanmax(np.abs(gaps), initial=0.0)))
    below.set_ylim(-reach, reach)
    below.set_xlabel("Simulation number")
    below.set_ylabel("Gap (simulated - measured) / JND")
    below.set_title("Gap by simulation (grey: within 1 JND)")
    below.legend(fontsize=9, ncols=2 if len(f) > 8 else 1)
    return figure


def page(
    result: Loop | LoopResult,
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a closed loop as one HTML page; DataError if it has no simulation.

    Only a `LoopResult` has other parameters before and after. ``heading`` is as for `calibration_page`.
    """
    final = ends(result) if isinstance(result, LoopResult) else None
    loop = result.loop if isinstance(result, LoopResult) else result
    status = statuses(loop) if final is None else final["status"]
    said = summary(loop, status)
    if final is not None:
        said.append(confirmed(loop, final))
    said += matched.sentences(result.gaps_beside, loop.room.centre_frequencies)
    by_band = [*band_rows(loop), *lost_rows(result.compromise)]
    if final is None:
        by_band += beside_rows(loop)
    by_band.append(Row("nearest simulation", [str(n) for n in nearest_simulations(loop)]))
    by_band.append(Row("status", list(status)))
    figure = path(loop)
    drawn = source(figure, progress or (lambda: None))
    return render(
        "loop.html",
        {
            "loop_state": loop,
            "doubts": words.doubts(loop.trust_marks),
            "summary": said,
            "at_ends": at_ends(loop),
            "assumed": assumed(loop),
            "figure": {
                "source": drawn,
                "alt": f"{loop.matched.label}, wanted and simulated, by band; gap by simulation",
                "caption": f"By band: {loop.matched.label}, and how far each simulation was off. "
                "One JND is 5 %.",
            },
            "by_band": by_band,
            "ends": final,
            "blocks": blocks(loop.room.n_bands),
            "labels": bands.labels(loop.room.centre_frequencies),
            "materials": materials_table(loop),
            "equation_option": equation_option(loop),
            "weights_option": weights_option(loop),
        },
        (heading or Heading()).completed(loop.room.name, loop.room.author),
    )
