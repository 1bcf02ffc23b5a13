"""What a calibration comes to, in words that a client can read."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.quality import JND, TrustMark, agreement
from rtcal.calibration.presets import METHODS
from rtcal.report.saved import Saved

LARGE_SHIFT = 2.0
"""Standard deviations of the prior: a larger shift contradicts what was stated of a material."""
_MOST_SHIFTS = 20
_MET = 0.05
"""JND: a band this near is said to have been met."""

_AGAINST = "The measurement contradicts what was stated of the materials"

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


@dataclass(frozen=True)
class Doubt:
    """Trust marks of one kind: title, letter, where and what (one text each), what to do."""

    title: str
    letter: str
    found: tuple[str, ...]
    advice: str


@dataclass(frozen=True)
class Shift:
    """A coefficient that moved far: by how many of the prior's standard deviations."""

    material: str
    frequency: float
    before: float
    after: float
    sigmas: float


def hertz(frequencies: Sequence[float]) -> str:
    """Return bands as they stand in a sentence.

    Examples
    --------
    >>> hertz([125, 250, 500])
    '125, 250 and 500 Hz'
    """
    texts = [f"{f:g}" for f in frequencies]
    return (", ".join(texts[:-1]) + " and " if len(texts) > 1 else "") + texts[-1] + " Hz"


def summary(seen: Saved) -> list[str]:
    """Return the calibration as a few sentences."""
    f, here = seen.centre_frequencies, np.isfinite(seen.gap_before)
    found = [
        f"The reverberation time T of the model was compared with the measured one in "
        f"{bands.span(f[here]) if here.any() else 'no band'}. Differences are given in just "
        f"noticeable differences: one JND is {100 * JND['t20']:g} % of the measured T."
    ]
    if here.any():
        gap = np.where(here, np.abs(seen.gap_before), -1.0)
        k = int(np.argmax(gap))
        found.append(
            f"Before calibration the model was off by {gap[here].mean():.1f} JND on average and by "
            f"{gap[k]:.1f} JND at worst: at {f[k]:g} Hz it had {seen.before[k]:.2f} s where "
            f"{seen.measured[k]:.2f} s were measured."
        )
        found.append(_after(seen))
    found.append(
        "That the model agrees with the measurement now proves nothing. It agrees by construction, and "
        "would do so too if a wall, the air or an opening were missing from it. Whether to "
        "believe it shows in how far the coefficients had to move."
    )
    return found


def _after(seen: Saved) -> str:
    gap = np.abs(seen.gap_after[np.isfinite(seen.gap_after)])
    met, count = int(np.sum(gap < _MET)), len(gap)
    n = len(seen.materials)
    text = (
        f"The absorption coefficients of {n} material{'' if n == 1 else 's'} were then changed, as "
        "little as what was known of them allows. "
    )
    if met == count:
        return text + f"Now the model has the measured T in all {count} bands."
    return text + (
        f"Now the model has the measured T in {met} of {count} bands; the largest gap that remains is "
        f"{gap.max():.1f} JND."
    )


def verdict(seen: Saved) -> tuple[str, str, str]:
    """Return agrees, contradicts or open (measurement and prior); a heading; a sentence."""
    known = seen.record["plausibility"]
    numbers = f"Q = {known['q']:.1f}, {known['degrees_of_freedom']:.0f} degrees of freedom"
    p = known["p_value"]
    far = [float(f) for f, z in zip(seen.centre_frequencies, seen.z, strict=True) if abs(z) > 2]
    asks = (
        f"at {hertz(far)} the measurement asks for an absorption more than two standard deviations "
        "from the stated one"
        if far
        else "no band asks for an absorption more than two standard deviations from the stated one"
    )
    if p is None:
        level, heading = ("contradicts", _AGAINST) if far else ("open", "No overall verdict")
        return (
            level,
            heading,
            (
                f"{asks[0].upper()}{asks[1:]}. There is no p-value for all bands together, because a "
                f"coefficient stands at a bound ({numbers})."
            ),
        )
    if agreement(p) == "too good":
        return (
            "agrees",
            "Too good to be true",
            (
                "Over all bands the coefficients moved less than their stated uncertainty makes "
                f"likely ({numbers}, p = {p:.2g}); {asks}. A sigma or the uncertainty of T is stated "
                "too large, or T was calculated from these coefficients."
            ),
        )
    if agreement(p) == "contradicts":
        return (
            "contradicts",
            _AGAINST,
            (
                "The coefficients had to move further than their stated uncertainty explains "
                f"({numbers}, p = {p:.2g}); {asks}. Something is missing from the model, or is stated "
                "wrongly, or is less certain than stated."
            ),
        )
    return (
        "open" if far else "agrees",
        ("In keeping with what was stated" + (", with exceptions" if far else "")),
        (
            "Over all bands the coefficients moved no further than their stated uncertainty explains "
            f"({numbers}, p = {p:.2g}); {asks}."
        ),
    )


def usable(seen: Saved) -> tuple[list[float], list[float]]:
    """Return the bands (Hz) without any trust mark, and those with one."""
    marked = {m.frequency for m in seen.trust_marks if m.frequency is not None}
    every = [float(f) for f in seen.centre_frequencies]
    return [f for f in every if f not in marked], [f for f in every if f in marked]


def doubts(marks: Sequence[TrustMark]) -> list[Doubt]:
    """Return the trust marks, those of one kind together."""
    out = []
    for kind in dict.fromkeys(mark.kind for mark in marks):
        of_kind = [mark for mark in marks if mark.kind == kind]
        told = []
        for text in dict.fromkeys(mark.text for mark in of_kind):
            where = [m.frequency for m in of_kind if m.text == text and m.frequency is not None]
            told.append(f"{hertz(where)}: {text}" if where else text)
        out.append(Doubt(of_kind[0].title, of_kind[0].letter, tuple(told), of_kind[0].advice))
    return out


def large_shifts(seen: Saved) -> tuple[list[Shift], int]:
    """Return the shifts beyond `LARGE_SHIFT`, largest first and 20 at most, and how many there are."""
    sigmas = np.nan_to_num(seen.shift_in_sigmas)
    places = [(int(i), int(k)) for i, k in np.argwhere(np.abs(sigmas) > LARGE_SHIFT)]
    places.sort(key=lambda at: -abs(sigmas[at]))
    found = [
        Shift(
            seen.materials[i],
            float(seen.centre_frequencies[k]),
            float(seen.alpha_before[i, k]),
            float(seen.alpha_after[i, k]),
            float(sigmas[i, k]),
        )
        for i, k in places[:_MOST_SHIFTS]
    ]
    return found, len(places)


def not_met(seen: Saved) -> list[str]:
    """Return what the calibration could not meet, band by band."""
    found = [
        f"{text}. The nearest that the bounds allow was taken."
        for text in seen.record["unreachable"]
    ]
    missing = [
        float(f)
        for f, m in zip(seen.centre_frequencies, seen.measured, strict=True)
        if not np.isfinite(m)
    ]
    if missing:
        found.append(f"{hertz(missing)}: no T was measured, the coefficients are the stated ones.")
    left = [
        f"{f:g} Hz ({g:+.1f} JND)"
        for f, g in zip(seen.centre_frequencies, seen.gap_after, strict=True)
        if abs(g) >= _MET
    ]
    if left:
        found.append(f"A gap remains at {', '.join(left)}.")
    ignored = seen.record["measured"]["bands_not_in_room"]
    if ignored:
        found.append(f"Measured, but no band of the model: {hertz(ignored)}.")
    return found


def assumed(seen: Saved) -> list[str]:
    """Return what the calibration takes for granted."""
    record = seen.record
    air = record["air"]
    found = [
        f"Volume {record['volume']:g} m³ and areas of {seen.areas.sum():g} m² in all, taken as exact.",
        "Air: none stated, so the surfaces are made to absorb what the air does."
        if air is None
        else f"Air of {air['temperature']:g} °C, {air['humidity']:g} % relative humidity and "
        f"{air['pressure']:g} kPa (absorption after ISO 9613-1).",
        f"{record['equation']}'s reverberation equation{_parameters(seen)}: a diffuse sound field.",
        _METHODS.get(record["method"], f"A calibration of its own: {composed(seen)}."),
        "The coefficients that were stated before, their standard deviations, and that these errors "
        + _correlated(seen)
        + " One measured T a band tells one number, the sum of all absorption: "
        "how it is shared among the materials follows from these standard deviations alone.",
        _measured(seen),
    ]
    floors = [m["name"] for m in record["materials"] if m["alpha_min"] is not None]
    found.append(
        "Coefficients lie between 0 and 1"
        + (", or above the floors that the room states." if floors else ".")
    )
    if record["measured"]["caution"]:
        found.append(record["measured"]["caution"] + ".")
    if record["effects"]:
        sizes = ", ".join(f"{name} = {size:.4g}" for name, size in record["effects"].items())
        found.append(f"Further effects in the model, with their calibrated sizes: {sizes}.")
    return found


def _parameters(seen: Saved) -> str:
    own = seen.record["equation_parameters"]
    return " with " + ", ".join(f"{k} = {v:g}" for k, v in own.items()) if own else ""


def composed(seen: Saved) -> str:
    """Return what the calibration is composed of: terms and constraints."""
    return "; ".join([*seen.record["objective"], *seen.record["constraints"]])


def _correlated(seen: Saved) -> str:
    record, parts = seen.record, []
    if record["band_correlation"]:
        parts.append(f"correlate by {record['band_correlation']:g} over an octave")
    if record["material_correlation"]:
        parts.append("correlate between some materials")
    return (" and ".join(parts) if parts else "are independent of each other") + "."


def _measured(seen: Saved) -> str:
    parameters = dict.fromkeys(p.upper() for p in seen.record["measured"]["parameter"] if p)
    text = (
        f"Measured: {' and '.join(parameters)}, the arithmetic mean over the source-receiver pairs"
    )
    known = np.isfinite(seen.uncertainty) & np.isfinite(seen.measured)
    if not known.any():
        return text + "; its uncertainty is not known."
    share = 100 * seen.uncertainty[known] / seen.measured[known]
    ends = dict.fromkeys([f"{share.min():.1f}", f"{share.max():.1f}"])
    return text + f"; its standard uncertainty is {' to '.join(ends)} %."


def command(seen: Saved) -> str | None:
    """Return the shell command that gives the same result from the two files of the page.

    None where the shell cannot: a composed calibration, an equation with other parameters than its
    usual ones, or one that is not rtcal's.
    """
    record = seen.record
    keys = {equation.name: key for key, equation in EQUATIONS.items()}
    equation = keys.get(record["equation"])
    if record["method"] not in METHODS or record["equation_parameters"] or equation is None:
        return None
    chosen = [
        "--method",
        record["method"],
        "--equation",
        equation,
        "--solver",
        record["solver"]["name"],
    ]
    if record["unreachable"]:
        chosen += ["--unreachable", "nearest"]
    return shlex.join(["rtcal", "calibrate", "room.toml", "t.csv", *chosen, "--out", "calibrated"])


def band_labels(seen: Saved) -> list[str]:
    """Return the bands' names for a table's head."""
    return [bands.label(f) for f in seen.centre_frequencies]
