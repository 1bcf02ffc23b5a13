"""The outcome of a calibration, in sentences for a reader who is no acoustician."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands, room_errors
from rtcal.acoustics.bands import hertz as hertz
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.marks import MET, TrustMark, grouped
from rtcal.acoustics.observables import parameter_label
from rtcal.calibration.methods import METHODS
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.table import equation_parameters
from rtcal.calibration.verdict import CalibrationVerdict, remaining_gap

LARGE_SHIFT = 2.0
"""Shift in standard deviations of the prior above which T contradicts a material's stated alpha."""
_MOST_SHIFTS = 20
_PRINTED = 0.05
"""Gap in JND that is not 0.0 when it is printed."""

PROVES_NOTHING = (
    "That the model agrees with the measurement now proves nothing. It agrees by construction, and "
    "would do so too if a wall, the air or an opening were missing from it. Whether to believe it "
    "shows in how far the coefficients had to move."
)
_GAP_REMAINS = (
    "A simulation with these coefficients keeps the gap that remains. What takes it up is checked "
    "first, corrected in the room's file, and the calibration repeated."
)

_METHODS = {
    "mle": "mle: the likeliest coefficients that give the measured reverberation time exactly; "
    "coefficients that were stated as uncertain move more (maximum likelihood).",
    "lse": "lse: the nearest coefficients that give the measured reverberation time exactly, however "
    "well each was known (least squares).",
    "soft": "soft: the most probable coefficients when the measured reverberation time has its own "
    "uncertainty; a gap may remain.",
    "smooth": "smooth: as soft, and changes should vary slowly over frequency.",
    "robust": "robust: as soft, and a few coefficients may be far from what was stated.",
    "joint": "joint: one set of coefficients for several configurations of the room; a gap may remain.",
}

_MLE_UNCERTAIN_ROOM = (
    "mle: the likeliest coefficients when {time} and the room has the stated errors; what these "
    "explain of the measured T remains as a gap (maximum likelihood)."
)


@dataclass(frozen=True)
class Doubt:
    """Trust marks of one kind: title, letter, one text per fact, and the advice."""

    title: str
    letter: str
    texts: tuple[str, ...]
    advice: str


@dataclass(frozen=True)
class Shift:
    """A coefficient with a large shift, in standard deviations of the prior."""

    material: str
    frequency: float
    before: float
    after: float
    sigmas: float


def compared(calibration: CalibrationResult) -> str:
    """Return the bands in which model and measurement were compared."""
    has_gap = np.isfinite(calibration.gap_before)
    return bands.span(calibration.prior.centre_frequencies[has_gap]) if has_gap.any() else "no band"


def lead(calibration: CalibrationResult, agreed: CalibrationVerdict) -> dict[str, str]:
    """Return what a reader who is no acoustician reads first.

    "headline" is the result as one sentence. "level" is that of the verdict ``agreed``.
    "proves_nothing" is what the agreement, or what is left of the gap, says of the model.
    """
    level, heading, _ = agreed
    gap = np.abs(calibration.gap_after[np.isfinite(calibration.gap_after)])
    met, count = int(np.sum(gap < MET)), len(gap)
    proves = PROVES_NOTHING
    typed = any(mark.kind == "typing_error" for mark in calibration.trust_marks)
    if not count:
        said = "Model and measurement could be compared in no band."
    elif not typed and (left := remaining_gap(calibration.to_dict())):
        said, proves = left, _GAP_REMAINS
    elif typed or met < count:
        said, proves = f"{heading}.", PROVES_NOTHING if met == count else _GAP_REMAINS
    else:
        said = "The model has the measured reverberation time, " + {
            "agrees": "with its materials within what was stated of them.",
            "contradicts": "but not with its materials as they were stated.",
        }.get(level, "and it is open whether its materials are as stated.")
    return {"headline": said, "level": level, "proves_nothing": proves}


def summary(calibration: CalibrationResult, agreed: CalibrationVerdict) -> list[str]:
    """Return the calibration in three sentences: before, after, and whether to believe it."""
    f, has_gap = calibration.prior.centre_frequencies, np.isfinite(calibration.gap_before)
    if not has_gap.any():
        return [
            "Model and measurement could be compared in no band.",
            _believable(calibration, agreed),
        ]
    gap = np.where(has_gap, np.abs(calibration.gap_before), -1.0)
    k = int(np.argmax(gap))
    return [
        "Before calibration the model's reverberation time was off by "
        f"{gap[has_gap].mean():.1f} JND on average and by {gap[k]:.1f} JND at worst: at {f[k]:g} Hz it "
        f"had {calibration.reverberation_time_before[k]:.2f} s where {calibration.measured[k]:.2f} s "
        "were measured.",
        _after(calibration),
        _believable(calibration, agreed),
    ]


def _believable(calibration: CalibrationResult, agreed: CalibrationVerdict) -> str:
    """Return whether measurement and prior agree, and the bands that carry a reservation."""
    level, heading, _ = agreed
    clean, marked = usable(calibration)
    if not marked:
        doubtful = "in no band did a check find a reason for doubt"
    elif not clean:
        doubtful = "every band carries a reservation"
    else:
        one = len(marked) == 1
        doubtful = f"{hertz(marked)} carr{'ies' if one else 'y'} a reservation"
    if level == "contradicts":
        return f"{heading}, so find out why before you use the coefficients; {doubtful}."
    return f"{heading}; {doubtful}."


def _after(calibration: CalibrationResult) -> str:
    gap = np.abs(calibration.gap_after[np.isfinite(calibration.gap_after)])
    met, count = int(np.sum(gap < MET)), len(gap)
    n = len(calibration.prior.materials)
    text = (
        f"The absorption coefficients of {n} material{'' if n == 1 else 's'} were then changed as "
        "little as what was known of them allows, and now the model has the measured T in "
    )
    if met == count:
        within = f", to within {gap.max():.1f} JND" if gap.max() >= _PRINTED else ""
        return text + f"all {count} bands{within}."
    some = f"{met} of {count} bands" if met else "no band"
    return text + f"{some}; the largest gap that remains is {gap.max():.1f} JND."


def usable(calibration: CalibrationResult) -> tuple[list[float], list[float]]:
    """Return the bands (Hz) without any trust mark or remaining gap, and those with one."""
    marked = {m.frequency for m in calibration.trust_marks if m.frequency is not None}
    frequencies = calibration.prior.centre_frequencies
    marked |= {*frequencies[np.abs(calibration.gap_after) >= MET].tolist()}
    every = frequencies.tolist()
    return [f for f in every if f not in marked], [f for f in every if f in marked]


def doubts(marks: Sequence[TrustMark]) -> list[Doubt]:
    """Return the trust marks, grouped by kind."""
    return [Doubt(m.title, m.letter, tuple(facts), m.advice) for m, facts in grouped(marks)]


def large_shifts(calibration: CalibrationResult) -> tuple[list[Shift], int]:
    """Return the shifts beyond `LARGE_SHIFT`, the 20 largest in order, and the number of all."""
    sigmas = np.nan_to_num(calibration.shift_in_sigmas)
    places = [(int(i), int(k)) for i, k in np.argwhere(np.abs(sigmas) > LARGE_SHIFT)]
    places.sort(key=lambda at: -abs(sigmas[at]))
    shifts = [
        Shift(
            calibration.prior.materials[i],
            float(calibration.prior.centre_frequencies[k]),
            float(calibration.prior.alpha[i, k]),
            float(calibration.alpha[i, k]),
            float(sigmas[i, k]),
        )
        for i, k in places[:_MOST_SHIFTS]
    ]
    return shifts, len(places)


def not_met(calibration: CalibrationResult) -> list[str]:
    """Return the targets that the calibration could not meet, band by band."""
    sentences = [
        f"{band}. The nearest that the bounds allow was taken." for band in calibration.unreachable
    ]
    missing = [
        float(f)
        for f, m in zip(calibration.prior.centre_frequencies, calibration.measured, strict=True)
        if not np.isfinite(m)
    ]
    if missing:
        sentences.append(
            f"{hertz(missing)}: no T was measured, the coefficients are the stated ones."
        )
    left = [
        f"{f:g} Hz ({g:+.1f} JND)".replace("-", "−")
        for f, g in zip(calibration.prior.centre_frequencies, calibration.gap_after, strict=True)
        if abs(g) >= MET
    ]
    if left:
        sentences.append(f"A gap remains at {', '.join(left)}.")
    ignored = calibration.measured_data.ignored
    if ignored:
        sentences.append(f"Measured, but no band of the model: {hertz(ignored)}.")
    return sentences


def _method(calibration: CalibrationResult) -> str:
    if calibration.method == "mle" and calibration.joint.matches_uncertain_room:
        u = calibration.measured_uncertainty[calibration.matched]
        own = "T has its own uncertainty" if np.isfinite(u).any() else "T is exact"
        return _MLE_UNCERTAIN_ROOM.format(time=own)
    return _METHODS.get(calibration.method, f"A composed calibration: {composed(calibration)}.")


def assumed(calibration: CalibrationResult) -> list[str]:
    """Return the assumptions of the calibration."""
    room, air = calibration.prior, calibration.prior.air
    sentences = [
        f"Volume {room.volume:g} m³ and areas of {room.areas.sum():g} m² in all, "
        + (
            f"uncertain (standard deviations): {room_errors.in_words(room)}; T is matched within this."
            if calibration.joint.matches_uncertain_room
            else "taken as exact."
        ),
        "Air: none stated, so the surfaces are made to absorb what the air does."
        if air is None
        else f"Air of {air.temperature:g} °C, {air.humidity:g} % relative humidity and "
        f"{air.pressure:g} kPa (absorption after ISO 9613-1).",
        f"{calibration.equation.name}'s reverberation equation{_parameters(calibration)}: a diffuse "
        "sound field.",
        _method(calibration),
        "The stated coefficients and their standard deviations, and that these errors "
        + _correlated(calibration)
        + " One measured T per band tells one number, the sum of all absorption: "
        "how it is shared among the materials follows from these standard deviations alone.",
        _measured(calibration),
    ]
    sentences.append(
        "Coefficients lie between 0 and 1"
        + (", or above the floors that the room states." if room.alpha_min is not None else ".")
    )
    if calibration.measured_data.caution:
        sentences.append(calibration.measured_data.caution + ".")
    if calibration.effects:
        sizes = ", ".join(f"{name} = {size:.4g}" for name, size in calibration.effects.items())
        sentences.append(f"Further effects in the model, with their calibrated sizes: {sizes}.")
    return sentences


def _parameters(calibration: CalibrationResult) -> str:
    parameters = equation_parameters(calibration.equation)
    return " with " + ", ".join(f"{k} = {v:g}" for k, v in parameters.items()) if parameters else ""


def composed(calibration: CalibrationResult) -> str:
    """Return the terms and constraints of the calibration."""
    composed = calibration.joint.composition
    return "; ".join(map(repr, (*composed.objective.terms, *composed.rows)))


def _correlated(calibration: CalibrationResult) -> str:
    room, parts = calibration.prior, []
    if room.band_correlation:
        parts.append(f"correlate by {room.band_correlation:g} over an octave")
    if room.material_correlation:
        parts.append("correlate between some materials")
    if room.common_alpha_sigma:
        parts.append(f"have {100 * room.common_alpha_sigma:g} % in common")
    return (" and ".join(parts) if parts else "are independent of each other") + "."


def _measured(calibration: CalibrationResult) -> str:
    parameters = dict.fromkeys(parameter_label(p) for p in calibration.measured_data.parameter if p)
    text = (
        f"Measured: {' and '.join(parameters)}, the arithmetic mean over the source-receiver pairs"
    )
    stated = np.isfinite(calibration.measured_uncertainty) & np.isfinite(calibration.measured)
    if not stated.any():
        return text + "; its uncertainty is not known."
    share = 100 * calibration.measured_uncertainty[stated] / calibration.measured[stated]
    ends = dict.fromkeys([f"{share.min():.1f}", f"{share.max():.1f}"])
    return text + f"; its standard uncertainty is {' to '.join(ends)} %."


def command(calibration: CalibrationResult) -> str | None:
    """Return the shell command that gives the same result from the two files of the page.

    None for a calibration that the command cannot repeat: a composed one, or an equation that is not
    rtcal's or whose parameters are not the default ones.
    """
    keys = {equation.name: key for key, equation in EQUATIONS.items()}
    equation, method = keys.get(calibration.equation.name), calibration.method
    if method not in METHODS or equation_parameters(calibration.equation) or equation is None:
        return None
    chosen = [
        "--method",
        method,
        "--equation",
        equation,
        "--solver",
        calibration.solver,
    ]
    if calibration.unreachable:
        chosen += ["--unreachable", "nearest"]
    return shlex.join(["rtcal", "calibrate", "room.toml", "t.csv", *chosen, "--out", "calibrated"])
