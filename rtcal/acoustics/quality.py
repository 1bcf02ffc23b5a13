"""How far a model is from a measurement (JND), how plausible that is, and where not to believe it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.curvature import BentDecay
from rtcal.acoustics.parameters import DECAY_TIMES
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.support.types import Array

# ISO 3382-1:2009, Table A.1: relative for decay times, absolute for the others.
JND: dict[str, float] = {
    "t20": 0.05,
    "t30": 0.05,
    "edt": 0.05,
    "c50": 1.0,
    "c80": 1.0,
    "g": 1.0,
    "d50": 0.05,
    "ts": 0.010,
}
"""One JND: 5 % of the measured decay time; 1 dB; 0.05 for D50; 10 ms for Ts."""


def gap_jnd(model: Array, measured: Array, parameter: str = "t20") -> Array:
    """Return (model - measured) in JND, signed, same shape; NaN where either is missing.

    Examples
    --------
    >>> print(gap_jnd(np.array([1.05, 0.9]), np.array([1.0, 1.0])).round(6))
    [ 1. -2.]
    """
    if parameter not in JND:
        raise DataError(f'parameter "{parameter}" has no JND; known are {", ".join(JND)}')
    model, measured = np.asarray(model, dtype=float), np.asarray(measured, dtype=float)
    unit = JND[parameter] * measured if parameter in DECAY_TIMES else JND[parameter]
    return np.asarray((model - measured) / unit)


@dataclass(frozen=True, eq=False)
class Plausibility:
    """Whether to believe a calibration: it always fits.

    Attributes
    ----------
    z : array (n_bands,)
        The miss of S'alpha before calibration in standard deviations of what was known of it; NaN
        where nothing was matched.
    q : float
        z'R^-1 z, R the correlation of z between bands; the sum of z² where the bands are independent.
    degrees_of_freedom : int
        One a matched band, not one a coefficient.
    p_value : float or None
        The chance of a larger q if prior and measurement are right; None where a bound is active,
        because then q is not chi-square.
    """

    z: Array
    q: float
    degrees_of_freedom: int
    p_value: float | None


def plausibility(miss: Array, covariance: Array, bound_active: bool) -> Plausibility:
    """Return z per band and Q over bands.

    Parameters
    ----------
    miss : array (n_bands,)
        b - S'mu in m², NaN where nothing was measured.
    covariance : array (n_bands, n_bands)
        Of ``miss``, if prior and measurement are right.
    bound_active : bool
        Whether a coefficient stands at a bound: then there is no p-value.

    Examples
    --------
    >>> found = plausibility(np.array([2.0, np.nan]), np.eye(2), bound_active=False)
    >>> found.q, found.degrees_of_freedom, round(found.p_value, 4)
    (4.0, 1, 0.0455)
    """
    spread = np.sqrt(np.diag(covariance))
    used = np.isfinite(miss) & (spread > 0)
    z = np.full(len(miss), np.nan)
    z[used] = miss[used] / spread[used]
    correlation = covariance[np.ix_(used, used)] / np.outer(spread[used], spread[used])
    q = float(z[used] @ np.linalg.solve(correlation, z[used])) if used.any() else 0.0
    count = int(used.sum())
    p_value = None
    if not bound_active and count:
        from scipy.special import chdtrc

        p_value = float(chdtrc(count, q))
    return Plausibility(z, q, count, p_value)


@dataclass(frozen=True)
class TrustMark:
    """A reason not to believe a band (``frequency`` in Hz) or the whole room (None).

    ``kind`` names it, ``letter`` stands for it in tables, ``text`` says what is so and ``advice``
    what to do.
    """

    kind: str
    letter: str
    frequency: float | None
    text: str
    advice: str

    @property
    def title(self) -> str:
        """The kind in words."""
        return self.kind.replace("_", " ").replace("schroeder", "Schroeder")


_ADVICE: dict[str, tuple[str, str]] = {
    "unreachable": (
        "n",
        "its coefficients are the ends of their bounds, not a finding: check T, volume and areas, "
        "and give the materials wider bounds or look for an effect that the model lacks",
    ),
    "missing": (
        "m",
        "alpha keeps its prior there: measure the band, or draw no conclusion from it",
    ),
    "below_schroeder": (
        "s",
        "single modes rule, which no reverberation equation describes: do not carry these "
        "coefficients to other positions or rooms",
    ),
    "air": (
        "a",
        "an error of T, or of the stated climate, counts several times in alpha: measure "
        "temperature and humidity with T",
    ),
    "uncertain": (
        "u",
        "no verdict on the gap: measure at more positions, or calibrate with method soft",
    ),
    "at_bound": (
        "b",
        "its sigma or another's is too small, or an effect is missing: state a floor (alpha_min) "
        "for hard materials and look for the effect",
    ),
    "implausible": (
        "z",
        "the measurement contradicts what was stated of the materials: check areas and volume, "
        "then look for an effect that the model lacks, before using these coefficients",
    ),
    "bent": (
        "c",
        "one T does not describe the decay, and these coefficients follow T20: look for coupled "
        "spaces or absorption on one side, and do not carry them to other positions or rooms",
    ),
    "no_air": (
        "",
        "the surfaces are made to absorb what the air does, most of all above 1 kHz: state "
        "temperature and humidity",
    ),
    "no_uncertainty": (
        "",
        "z and Q may be overstated: give T per source and receiver, or its uncertainty",
    ),
    "surface_missing": ("", "a surface is missing, or the volume is wrong: check both"),
    "clipped": (
        "",
        "a laboratory value above 1 counts the specimen's edges too, so the true one is not known: "
        "state a larger sigma for these materials",
    ),
}

_AIR_SHARE = 0.5


def schroeder_frequency(t: Array, volume: float) -> Array:
    """Return 2000 sqrt(T / V) in Hz, T in s and V in m³ (Schroeder & Kuttruff 1962).

    Examples
    --------
    >>> print(schroeder_frequency(np.array([2.0]), 200.0))
    [200.]
    """
    return np.asarray(2000 * np.sqrt(np.asarray(t, dtype=float) / volume))


def mid_frequency_time(t: Array, centre_frequencies: Array) -> float:
    """Return the mean of T over the octaves 500 and 1000 Hz, or their thirds; else over all bands.

    T in s, (n_bands,), NaN where missing; NaN if every band is.

    Examples
    --------
    >>> mid_frequency_time(np.array([1.4, 2.0, 1.8]), np.array([125, 500, 1000]))
    1.9
    """
    t, f = np.asarray(t, dtype=float), np.asarray(centre_frequencies, dtype=float)
    here = np.isfinite(t)
    middle = here & (f > 500 / np.sqrt(2)) & (f < 1000 * np.sqrt(2))
    used = middle if middle.any() else here
    return float(np.mean(t[used])) if used.any() else float("nan")


def trust_marks(
    room: Room,
    measured: Array,
    uncertainty: Array,
    air_share: Array,
    active: NDArray[Any],
    z: Array,
    unreachable: Sequence[float] = (),
    bent: Sequence[BentDecay] = (),
) -> tuple[TrustMark, ...]:
    """Return every reason not to believe a band or the room.

    Parameters
    ----------
    room : Room
    measured, uncertainty : array (n_bands,)
        T and its standard uncertainty in s; NaN where missing or unknown.
    air_share : array (n_bands,)
        The air's share of the whole absorption.
    active : array (n_materials, n_bands)
        Not 0 where a coefficient stands at a bound.
    z : array (n_bands,)
    unreachable : sequence of float
        Centre frequencies in Hz of bands that were moved to the nearest end.
    bent : sequence of BentDecay
        Bands whose measured decay is not straight.
    """
    found: list[TrustMark] = []

    def mark(kind: str, frequency: float | None, text: str) -> None:
        letter, advice = _ADVICE[kind]
        found.append(TrustMark(kind, letter, frequency, text, advice))

    if room.air is None:
        mark("no_air", None, "no air is stated")
    smallest = 4.84 * room.volume ** (2 / 3)  # the surface of the sphere of this volume
    if room.total_area < smallest:
        mark(
            "surface_missing",
            None,
            f"{room.total_area:.4g} m² of surface cannot enclose "
            f"{room.volume:.4g} m³, which takes at least {smallest:.4g} m²",
        )
    if room.clipped:
        mark("clipped", None, f"cut to 1: {'; '.join(room.clipped)}")
    here = np.isfinite(measured)
    if here.any() and not np.isfinite(uncertainty[here]).any():
        mark("no_uncertainty", None, "the uncertainty of T is not known")
    middle = mid_frequency_time(measured, room.centre_frequencies)
    limit = float(schroeder_frequency(np.array(middle), room.volume))
    for k, frequency in enumerate(room.centre_frequencies):
        f = float(frequency)
        if np.isnan(measured[k]):
            mark("missing", f, "not calibrated, no T was measured")
        elif f < limit:
            mark("below_schroeder", f, f"below the Schroeder frequency, {limit:.0f} Hz")
        if f in unreachable:
            mark("unreachable", f, "no coefficients within the bounds give this T")
        for decay in bent:
            if decay.frequency == f:
                mark("bent", f, decay.text)
        if air_share[k] > _AIR_SHARE:
            mark("air", f, "the air absorbs more than the surfaces")
        if uncertainty[k] > JND["t20"] * measured[k]:
            mark("uncertain", f, "T is uncertain by more than one JND")
        for i in np.flatnonzero(active[:, k]).tolist():
            side = "lower" if active[i, k] < 0 else "upper"
            mark("at_bound", f, f"{room.materials[i]} stands at its {side} bound")
        if abs(z[k]) > 2:
            side = "more" if z[k] > 0 else "less"
            mark("implausible", f, f"T asks for {side} absorption than was stated, |z| over 2")
    return tuple(found)


def letters(marks: Sequence[TrustMark], frequency: float) -> str:
    """Return the letters of a band's marks, each once; empty where there is none."""
    return "".join(dict.fromkeys(m.letter for m in marks if m.frequency == frequency))


def explained(marks: Sequence[TrustMark]) -> list[str]:
    """Return the marks as lines of text, those of one kind together, with what to do."""
    lines = []
    for kind in dict.fromkeys(mark.kind for mark in marks):
        of_kind = [mark for mark in marks if mark.kind == kind]
        letter = f"[{of_kind[0].letter}] " if of_kind[0].letter else ""
        told = []
        for text in dict.fromkeys(mark.text for mark in of_kind):
            where = [f"{m.frequency:g}" for m in of_kind if m.text == text and m.frequency]
            told.append(f"{', '.join(where)} Hz: {text}" if where else text)
        lines += [f"{letter}{'; '.join(told)}", f"    -> {of_kind[0].advice}"]
    return lines
