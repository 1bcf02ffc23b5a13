"""The page of a calibration: its printed text with figures, intervals and what repeats it."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.room import LARGEST_PIECE, MAX_BYTES
from rtcal.calibration import table
from rtcal.calibration.methods import METHODS
from rtcal.calibration.result import CalibrationResult
from rtcal.report import figures, room_view
from rtcal.report.document import (
    Box,
    Code,
    Files,
    Items,
    Page,
    Picture,
    Section,
    SideBySide,
    coefficients,
    notes,
)
from rtcal.support.blocks import Note, Row, Table

SOLVED = "These numbers show that the problem was solved, not that it was the right one."
_COLUMNS = "input → calibrated, below it the 90 % interval; * at a bound"


def page(result: CalibrationResult) -> Page:
    """Return the page of a calibration, without links or scripts other than the room view's."""
    room, record, verdict = result.prior, result.to_dict(), result.verdict
    kinds = {
        "Absorption coefficients": np.flatnonzero(room.is_surface).tolist(),
        "Absorption area of one piece in m²": np.flatnonzero(~room.is_surface).tolist(),
    }
    at_bound = result.active != 0
    sources = [Row(m, [room.sources[m]]) for m in room.materials if room.sources.get(m)]
    gap = Picture(
        lambda: figures.gap(result),
        f"How far T of the model is from the measured T{_before(result)}: before (bars) and after "
        "calibration (dots). One JND, the just noticeable difference, is 5 %. After calibration, model "
        "and measurement agree by construction, also if a wall, the air or an opening is missing.",
    )
    times = Picture(
        lambda: figures.reverberation_time(result),
        "Reverberation time by band, with the band of one JND around the measured one.",
    )
    alphas = Picture(
        lambda: figures.coefficients(result),
        "Absorption coefficients before and after, with 90 % intervals. Where the two intervals are "
        "alike, the measurement does not determine the material.",
        tall=True,
    )
    blocks = [
        Box(verdict.level, f"{verdict.heading}.", [verdict.text]),
        SideBySide([[Items(notes(result.blocks())[1:])], [gap]], "summary"),
        *room_view.of_calibration(result),
        Section("Tables", "tables"),
        *(
            coefficients(f"{what}: {_COLUMNS}", room, result.alpha, result.interval, at_bound, of)
            for what, of in kinds.items()
            if of
        ),
        replace(table.of_bands(record), title="By band"),
        table.shifts(record),
        table.shares(record),
        Section("Figures", "pictures"),
        SideBySide([[times], [alphas]], "pictures"),
        Section("Technical details", "details"),
        Items(assumed(result)),
        Table(["source"], sources, "Where the input coefficients come from"),
        Note(
            f"{table.certificate(record)} Both are computed from the problem's own numbers, not taken "
            f"from the solver (status {result.raw.status}). {SOLVED}"
        ),
        *_reproduced(result),
    ]
    return Page(room.name, room.author, "calibration of the absorption coefficients", blocks)


def _before(result: CalibrationResult) -> str:
    """Return the mean deviation before calibration, and in how many bands; "" without any."""
    known = np.isfinite(result.gap_before)
    if not known.any():
        return ""
    mean, compared = np.abs(result.gap_before[known]).mean(), result.prior.centre_frequencies[known]
    return f" ({mean:.1f} JND before, mean over {bands.span(compared)})"


def assumed(result: CalibrationResult) -> list[str]:
    """Return the assumptions of the calibration that its text does not state, one sentence each."""
    room, air = result.prior, result.prior.air
    parameters = ", ".join(
        f"{k} = {v:g}" for k, v in table.equation_parameters(result.equation).items()
    )
    correlated = [
        f"correlate by {room.band_correlation:g} over an octave" if room.band_correlation else "",
        "correlate between some materials" if room.material_correlation else "",
        f"have {100 * room.common_alpha_sigma:g} % in common" if room.common_alpha_sigma else "",
    ]
    errors = " and ".join(filter(None, correlated)) or "are independent of each other"
    posterior = (
        "the exact posterior distribution, with the uncertainty of T where it is known"
        if result.joint.is_exact
        else "the linear estimate, a normal density for each coefficient by itself: bands or rooms "
        "share errors here, or the method has no posterior distribution"
    )
    floors = ", or above the lower limits of the room's file" if room.alpha_min is not None else ""
    pieces = f"; one piece absorbs at most {LARGEST_PIECE:g} m²" if room.pieces else ""
    sentences = [
        f"{result.equation.name}'s reverberation equation{parameters and f' with {parameters}'}: a "
        "diffuse sound field.",
        "No air, so the surfaces are made to absorb what the air does."
        if air is None
        else f"Absorption of the air after ISO 9613-1, at {air.pressure:g} kPa.",
        _measured(result),
        f"Errors of the input coefficients {errors}. One measured T per band determines one number, "
        "the sum of all absorption: how it is shared among the materials follows from the standard "
        "deviations of the input alone.",
        f"Coefficients lie between 0 and 1{floors}{pieces}.",
        f"The intervals are those of {posterior}, within these bounds.",
    ]
    if result.effects:
        sizes = ", ".join(f"{name} = {size:.4g}" for name, size in result.effects.items())
        sentences.append(f"Further effects in the model, with their calibrated sizes: {sizes}.")
    return sentences


def _measured(result: CalibrationResult) -> str:
    parameters = dict.fromkeys(parameter_label(p) for p in result.measured_data.parameter if p)
    text = f"{' and '.join(parameters)} is the arithmetic mean over the source-receiver pairs"
    stated = np.isfinite(result.measured_uncertainty) & np.isfinite(result.measured)
    if not stated.any():
        return f"{text}; its uncertainty is not known."
    share = 100 * result.measured_uncertainty[stated] / result.measured[stated]
    ends = dict.fromkeys([f"{share.min():.1f}", f"{share.max():.1f}"])
    return f"{text}; its standard uncertainty is {' to '.join(ends)} %."


def command(result: CalibrationResult) -> str | None:
    """Return the shell command that repeats a calibration from the two files of its page.

    None if no command can: for a method composed of terms, or an equation that is not rtcal's or has
    other than the default parameters.
    """
    keys = {equation.name: key for key, equation in EQUATIONS.items()}
    equation, method = keys.get(result.equation.name), result.method
    if method not in METHODS or table.equation_parameters(result.equation) or equation is None:
        return None
    chosen = ["--method", method, "--equation", equation, "--solver", result.joint.solver]
    if result.unreachable:
        chosen += ["--unreachable", "nearest"]
    return shlex.join(["rtcal", "calibrate", "room.toml", "t.csv", *chosen, "--out", "calibrated"])


def _reproduced(result: CalibrationResult) -> list[Any]:
    """Return the two input files with the command or the terms, and the versions."""
    of, repeated = result.joint.versions, command(result)
    texts = table.inputs(result.prior, result.measured_data)
    contents = {"room.toml": texts["room"].encode(), "t.csv": texts["measured"].encode()}
    of_files = f" (the mean T of each band with its uncertainty), and install rtcal {of['rtcal']}."
    if len(contents["room.toml"]) > MAX_BYTES:
        said: list[Any] = [Note("Room and measurement are in result.json.")]
    elif repeated:
        said = [Files(contents, f"{of_files} Then run"), Code(repeated)]
    else:
        composed = result.joint.composition
        terms = "; ".join(map(repr, (*composed.objective.terms, *composed.row_constraints)))
        said = [Files(contents, f"{of_files} The calibration was composed in Python: {terms}.")]
    versions = ", ".join(f"{name} {version}" for name, version in of.items())
    return [
        *said,
        Note(f"{versions}. Fingerprint of the measured T: {result.measured_data.fingerprint}."),
    ]
