"""The page of a calibration: what its text has, for readers without Python."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.marks import MET
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.room import LARGEST_PIECE, MAX_BYTES
from rtcal.calibration import table
from rtcal.calibration.methods import METHODS
from rtcal.calibration.result import CalibrationResult
from rtcal.report import figures, room_view
from rtcal.report.document import (
    MOST_MATERIALS,
    Box,
    Code,
    Files,
    Items,
    Page,
    Picture,
    Section,
    SideBySide,
    cautions,
    coefficients,
)
from rtcal.support.blocks import Note, Row, Table

_PRINTED = 0.05
"""Deviation in JND that is not 0.0 when it is printed."""
_AGREEMENT = (
    "The calibrated model agrees with the measurement by construction, also if a wall, the air or an "
    "opening were missing from it. How far the coefficients had to move shows whether to trust it."
)
_GAP_REMAINS = (
    "A simulation with these coefficients keeps the deviation that remains. Find its cause first, "
    "correct the room's file, and calibrate again."
)
SOLVED = "These numbers show that the problem was solved, not that it was the right one."
_METHODS = {
    "mle": "the likeliest coefficients that give the measured reverberation time exactly; "
    "coefficients with a larger sigma move more (maximum likelihood).",
    "lse": "the nearest coefficients that give the measured reverberation time exactly, however "
    "well each was known (least squares).",
    "soft": "the most probable coefficients when the measured reverberation time has its own "
    "uncertainty; a deviation may remain.",
    "smooth": "as soft, and changes should vary slowly over frequency.",
    "robust": "as soft, and a few coefficients may be far from their input.",
    "joint": "one set of coefficients for several configurations of the room; a deviation may remain.",
}


def page(result: CalibrationResult) -> Page:
    """Return the page of a calibration, without links or scripts other than the room view's."""
    room, verdict = result.prior, result.verdict
    first = Box(verdict.level, f"{verdict.heading}.", [verdict.text])
    subject = "calibration of the absorption coefficients"
    return Page(room.name, room.author, subject, [first, *blocks(result)])


def blocks(result: CalibrationResult) -> list[Any]:
    """Return the content of the page below the verdict."""
    room, record = result.prior, result.to_dict()
    size = np.max(room.areas[:, np.newaxis] * result.alpha, axis=1)
    rows = np.sort(np.argsort(-size, kind="stable")[:MOST_MATERIALS]).tolist()
    of_all = f"; the {len(rows)} of {len(size)} materials that absorb most"
    title = (
        f"{{}}: input → calibrated, below it the 90 % "
        f"interval; * at a bound{of_all if len(rows) < len(size) else ''}"
    )
    kinds = {
        "Absorption coefficients": np.flatnonzero(room.is_surface).tolist(),
        "Absorption area of one piece in m²": np.flatnonzero(~room.is_surface).tolist(),
    }
    left = np.abs(result.gap_after) >= MET
    marked = {m.frequency for m in result.trust_marks if m.frequency is not None}
    marked |= {*room.centre_frequencies[left].tolist()}
    clean = [f for f in room.centre_frequencies.tolist() if f not in marked]
    reserved = f"Bands without a caution: {bands.hertz(clean) or 'none'}."
    sources = [(m, room.sources[m]) for m in room.materials if room.sources.get(m)]
    known = np.isfinite(result.gap_before)
    compared = bands.span(room.centre_frequencies[known]) if known.any() else "no band"
    gap = Picture(
        lambda: figures.gap(result),
        "How far the model's reverberation time was from the measured one: before (bars) and after "
        f"calibration (dots), in {compared}. One JND, the just noticeable difference, is 5 %.",
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
    posterior = (
        "the exact posterior distribution, within the bounds, with the uncertainty of T where it "
        "is known"
        if result.joint.is_exact
        else "the linear estimate, a normal density within the bounds for each coefficient by itself: "
        "bands or rooms share errors here, or the method has no posterior distribution"
    )
    return [
        Section("Summary", "summary"),
        SideBySide([[Note(s, kind="lead") for s in _summary(result)], [gap]], "summary"),
        *room_view.of_calibration(result),
        Section("Cautions", "cautions"),
        Note(_GAP_REMAINS if left.any() else _AGREEMENT),
        Note(reserved),
        *cautions(result.trust_marks),
        Items(table.remarks(record)),
        Section("Tables", "tables"),
        *(
            coefficients(
                title.format(what),
                room,
                result.alpha,
                result.interval,
                result.active != 0,
                rows,
                of,
            )
            for what, of in kinds.items()
            if of
        ),
        Note(
            f"The intervals are those of {posterior}. The calibrated coefficient lies within its "
            "interval.",
            kind="note",
        ),
        Table(
            bands.labels(room.centre_frequencies),
            table.shift_rows(record),
            table.SHIFT,
            "Material",
            most=rows,
        ),
        Table(
            bands.labels(room.centre_frequencies),
            table.band_rows(record),
            "By band",
            note=table.SIGNS,
        ),
        Table(
            bands.labels(room.centre_frequencies),
            table.share_rows(record),
            f"{table.SHARE} / %",
            "Material",
            most=range(len(record["absorption_share"]))[:MOST_MATERIALS],
        ),
        Section("Pictures", "pictures"),
        SideBySide([[times], [alphas]], "pictures"),
        Section("What was assumed", "assumed"),
        Items(assumed(result)),
        Table(
            ["source"],
            [Row(m, [source]) for m, source in sources],
            "Where the input coefficients come from",
        ),
        Section("Certificate", "certificate"),
        Note(
            f"{table.certificate(record)} Both are computed from the problem's own numbers, not taken "
            f"from the solver (status {result.raw.status}). {SOLVED}"
        ),
        Section("How to reproduce", "reproduce"),
        *_reproduced(result),
    ]


def _summary(result: CalibrationResult) -> list[str]:
    """Return the calibration in two sentences: before and after."""
    f, gap = result.prior.centre_frequencies, np.abs(result.gap_before)
    after = np.abs(result.gap_after[np.isfinite(result.gap_after)])
    if not np.isfinite(gap).any():
        return ["Model and measurement could be compared in no band."]
    k, n, count = int(np.nanargmax(gap)), len(result.prior.materials), len(after)
    met = int(np.sum(after < MET))
    within = f", to within {after.max():.1f} JND" if after.max() >= _PRINTED else ""
    remains = f"; the largest deviation that remains is {after.max():.1f} JND"
    return [
        "Before calibration the model's reverberation time was off by "
        f"{np.nanmean(gap):.1f} JND on average and by {gap[k]:.1f} JND at worst: at {f[k]:g} Hz it "
        f"had {result.reverberation_time_before[k]:.2f} s where {result.measured[k]:.2f} s were "
        "measured.",
        f"The absorption coefficients of {n} material{'s' * (n > 1)} were then changed as "
        "little as their sigma allows, and now the model has the measured T in "
        + (f"all {count} bands{within}." if met == count else f"{met} of {count} bands{remains}."),
    ]


def assumed(result: CalibrationResult) -> list[str]:
    """Return the assumptions of the calibration, one sentence each."""
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
    floors = ", or above the lower limits of the room's file" if room.alpha_min is not None else ""
    sentences = [
        f"Volume {room.volume:g} m³ and areas of {room.total_area:g} m² in all.",
        *(
            f'{room.material(name).area:g} pieces "{name}", which add absorption and no area.'
            for name in room.pieces
        ),
        "No air, so the surfaces are made to absorb what the air does."
        if air is None
        else f"Air of {air.temperature:g} °C, {air.humidity:g} % relative humidity and "
        f"{air.pressure:g} kPa (absorption after ISO 9613-1).",
        f"{result.equation.name}'s reverberation equation{parameters and f' with {parameters}'}: a "
        "diffuse sound field.",
        _method(result),
        f"The input coefficients and their standard deviations, whose errors {errors}. One measured T "
        "per band determines one number, the sum of all absorption: how it is shared among the "
        "materials follows from these standard deviations alone.",
        _measured(result),
        f"Coefficients lie between 0 and 1{floors}.",
        *([f"One piece absorbs at most {LARGEST_PIECE:g} m²."] if room.pieces else []),
    ]
    if result.effects:
        sizes = ", ".join(f"{name} = {size:.4g}" for name, size in result.effects.items())
        sentences.append(f"Further effects in the model, with their calibrated sizes: {sizes}.")
    return sentences


def _method(result: CalibrationResult) -> str:
    if result.method == "mle" and result.joint.matches_uncertain_room:
        u = result.measured_uncertainty[result.matched]
        own = "T has its own uncertainty" if np.isfinite(u).any() else "T is exact"
        return (
            f"mle: the likeliest coefficients when {own} and the room is uncertain; what this "
            "uncertainty explains of the measured T remains as a deviation (maximum likelihood)."
        )
    if result.method in _METHODS:
        return f"{result.method}: {_METHODS[result.method]}"
    return f"A composed calibration: {_composed(result)}."


def _composed(result: CalibrationResult) -> str:
    composed = result.joint.composition
    return "; ".join(map(repr, (*composed.objective.terms, *composed.row_constraints)))


def _measured(result: CalibrationResult) -> str:
    parameters = dict.fromkeys(parameter_label(p) for p in result.measured_data.parameter if p)
    text = (
        f"Measured: {' and '.join(parameters)}, the arithmetic mean over the source-receiver pairs"
    )
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


def _reproduced(result: CalibrationResult) -> Sequence[Any]:
    """Return the two input files with the command, and the versions."""
    of, repeated = result.joint.versions, command(result)
    texts = table.inputs(result.prior, result.measured_data)
    contents = {"room.toml": texts["room"].encode(), "t.csv": texts["measured"].encode()}
    of_files = f" (the mean T of each band with its uncertainty), and install rtcal {of['rtcal']}."
    if len(contents["room.toml"]) > MAX_BYTES:
        said: list[Any] = [
            Note(
                "The room is too large for this page; its file and the measurement are in result.json."
            )
        ]
    elif repeated:
        said = [Files(contents, f"{of_files} Then run"), Code(repeated)]
    else:
        composed = f" This calibration was composed in Python: {_composed(result)}."
        said = [Files(contents, of_files + composed)]
    versions = ", ".join(f"{name} {version}" for name, version in of.items())
    return [
        *said,
        Note(f"{versions}. Fingerprint of the measured T: {result.measured_data.fingerprint}."),
    ]
