"""The gap between model and measurement in JND, its plausibility, and reasons to doubt a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtcal.acoustics.curvature import BentDecay
from rtcal.acoustics.enclosure import surface_doubt
from rtcal.acoustics.observables import TARGET, observable
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array

__all__ = [
    "Plausibility",
    "TrustMark",
    "agreement",
    "bent_marks",
    "explained",
    "gap_jnd",
    "mid_frequency_time",
    "plausibility",
    "schroeder_frequency",
    "trust_marks",
]
__dir__ = __all__.copy


@checked
def gap_jnd(model: Array, measured: Array, parameter: str = TARGET.key) -> Array:
    """Return (model - measured) in JND, signed, same shape; NaN where either is missing.

    One JND of a decay time is 5 % of the measured one (ISO 3382-1:2009, Table A.1).

    Examples
    --------
    >>> print(gap_jnd(np.array([1.05, 0.9]), np.array([1.0, 1.0])).round(6))
    [ 1. -2.]
    """
    unit_of = observable(parameter).jnd_of
    model, measured = checks.array("model", model), checks.array("measured", measured)
    return np.asarray((model - measured) / unit_of(measured))


P_CONTRADICTION = 0.05
"""Below this p-value, prior and measurement contradict each other: the usual level of 5 %."""
P_TOO_GOOD = 0.99
"""Above this p-value, prior and measurement agree too well to be true.

If prior and measurement are right, the p-value is uniform, so 1 room in 100 is marked by chance. If
all standard deviations are f times too large, P(chi² < f² chi²_0.01) of the rooms are marked. In
six octaves these are 25 % for f = 2 and 75 % for f = 3, in 18 thirds 94 % for f = 2."""


@dataclass(frozen=True, eq=False)
class Plausibility:
    """Whether prior and measurement agree. The gap does not show it, since a calibration closes it.

    Attributes
    ----------
    z : array (n_bands,)
        b - S'mu over its standard deviation; NaN where nothing was matched.
    q : float
        z'R^-1 z, R the correlation of z between bands; the sum of z² where the bands are independent.
    degrees_of_freedom : int
        One per matched band, not one per coefficient.
    p_value : float or None
        The probability of a larger q if prior and measurement are right. None where a bound is
        active, because then q is not chi-square.
    p_together : float or None
        The same if the coefficients may also be off together, as `rtcal.finder` assumes
        (`rtcal.acoustics.common_errors`). None where these errors are not known.
    """

    z: Array
    q: float
    degrees_of_freedom: int
    p_value: float | None
    p_together: float | None = None

    @property
    def agreement(self) -> Agreement | None:
        """The agreement that the p-values show: see `agreement`."""
        return agreement(self.p_value, self.p_together)


Agreement = Literal["contradicts", "agrees", "too good"]


@checked
def agreement(p_value: float | None, p_together: float | None = None) -> Agreement | None:
    """Return whether measurement and prior contradict, agree, or agree too well to be true.

    Too well: S'mu is nearer to b than the stated uncertainties make likely. Then a sigma or u_T is
    too large, or T was calculated from these coefficients. None without a p-value. What coefficients
    that are off together explain (``p_together``, of `Plausibility`) is no contradiction.

    Examples
    --------
    >>> agreement(0.001), agreement(0.4), agreement(1.0)
    ('contradicts', 'agrees', 'too good')
    >>> agreement(0.001, 0.2)
    'agrees'
    """
    if p_value is None:
        return None
    if max(p_value, p_together or 0.0) < P_CONTRADICTION:
        return "contradicts"
    return "too good" if p_value > P_TOO_GOOD else "agrees"


@checked
def together_in_words(p_value: float, p_together: float | None) -> str:
    """Return the sentence on errors that coefficients have in common; "" where they change little.

    Examples
    --------
    >>> print(together_in_words(1.7e-5, 0.011))
    With errors that coefficients have in common p = 0.011. find assumes these too, and adds \
those of the model and between measuring teams.
    >>> together_in_words(0.001, None)
    ''
    """
    if p_together is None or p_together < 2 * p_value:
        return ""
    return (
        f"With errors that coefficients have in common p = {p_together:.2g}. find assumes these "
        "too, and adds those of the model and between measuring teams."
    )


LARGE_GAP = 3.0
"""A gap before calibration, in JND, that anyone hears. Agreement says little where it is allowed."""


@checked
def weak_agreement(gap_before: ArrayLike) -> str:
    """Return the reservation of an agreement in spite of large gaps (n_bands,); "" without one.

    Examples
    --------
    >>> print(weak_agreement([0.5, -6.6]))
    The stated uncertainty allows even the gap of 6.6 JND before, so this does not confirm the model.
    """
    gap = np.abs(np.asarray(gap_before, dtype=float))
    largest = float(np.max(gap, where=np.isfinite(gap), initial=0.0))
    if largest < LARGE_GAP:
        return ""
    return (
        f"The stated uncertainty allows even the gap of {largest:.1f} JND before, so this does not "
        "confirm the model."
    )


@checked
def plausibility(
    difference: Array, covariance: Array, bound_active: bool, together: Array | None = None
) -> Plausibility:
    """Return z per band and Q over bands.

    Parameters
    ----------
    difference : array (n_bands,)
        b - S'mu in m², NaN where nothing was measured.
    covariance : array (n_bands, n_bands)
        Covariance of ``difference``, if prior and measurement are right.
    bound_active : bool
        Whether a coefficient stands at a bound: then there is no p-value.
    together : array (n_errors, n_bands), optional
        Changes of ``difference`` by one standard deviation each of what coefficients are off by
        together.

    Raises
    ------
    DataError
        If the covariance is not finite or of another size.

    Examples
    --------
    >>> result = plausibility(np.array([2.0, np.nan]), np.eye(2), bound_active=False)
    >>> result.q, result.degrees_of_freedom, round(result.p_value, 4)
    (4.0, 1, 0.0455)
    """
    difference, covariance = (
        checks.array("difference", difference),
        checks.array("covariance", covariance),
    )
    n = difference.size
    if difference.shape != (n,) or covariance.shape != (n, n):
        raise DataError(
            f"difference has shape {difference.shape} and covariance {covariance.shape}; they are "
            "(n_bands,) and (n_bands, n_bands)"
        )
    if not np.isfinite(covariance).all():
        raise DataError("covariance has a value that is not finite: is a sigma far too large?")
    spread = np.sqrt(np.diag(covariance))
    used = np.isfinite(difference) & (spread > 0)
    z = np.full(n, np.nan)
    z[used] = difference[used] / spread[used]
    count, p_value, p_together = int(used.sum()), None, None
    q = _chi_square(difference[used], covariance[np.ix_(used, used)])
    if not bound_active and count:
        from scipy.special import chdtrc

        p_value = float(chdtrc(count, q))
        if together is not None:
            wider = (covariance + together.T @ together)[np.ix_(used, used)]
            p_together = float(chdtrc(count, _chi_square(difference[used], wider)))
    return Plausibility(z, q, count, p_value, p_together)


def _chi_square(difference: Array, covariance: Array) -> float:
    """Return d'C^-1 d, by way of the correlation; 0 of no value."""
    spread = np.sqrt(np.diag(covariance))
    z = difference / spread
    return float(z @ np.linalg.solve(covariance / np.outer(spread, spread), z)) if len(z) else 0.0


@dataclass(frozen=True)
class TrustMark:
    """A reason to doubt one band, with its ``frequency`` in Hz, or the whole room, with None.

    ``kind`` names it, ``letter`` stands for it in tables, ``text`` states the fact and ``advice``
    says what to do.
    """

    kind: str
    letter: str
    frequency: float | None
    text: str
    advice: str

    @property
    def title(self) -> str:
        """Name of the kind in words."""
        return self.kind.replace("_", " ").replace("schroeder", "Schroeder")


_ADVICE: dict[str, tuple[str, str]] = {
    "unreachable": (
        "n",
        "its coefficients are the ends of their bounds, which says nothing of the materials: check T, "
        "volume and areas, give the materials wider bounds, or look for an effect that the model lacks",
    ),
    "missing": (
        "m",
        "alpha stays as stated there, unless other bands, terms or observations move it: measure the "
        "band, or draw no conclusion from it",
    ),
    "below_schroeder": (
        "s",
        "a few room modes determine the decay, which no reverberation equation describes: do not use "
        "these coefficients at other positions or in other rooms",
    ),
    "air": (
        "a",
        "an error of T, or of the stated climate, counts several times in alpha: measure "
        "temperature and humidity with T",
    ),
    "uncertain": (
        "u",
        "the gap says nothing of the model: measure at more positions, or calibrate with method soft",
    ),
    "at_bound": (
        "b",
        "its sigma or another's is too small, or an effect is missing: state a lower limit (alpha_min) "
        "for hard materials and look for the effect",
    ),
    "at_upper_bound": (
        "b",
        "the other materials supply what T asks for beyond it: its sigma, another's or its area is too "
        "small, or an effect is missing",
    ),
    "all_at_upper_bound": (
        "b",
        "T asks for more absorption than these materials can have: look for absorption that the "
        "model lacks, for a surface that is missing or too small, or a sigma that is too small",
    ),
    "implausible": (
        "z",
        "the measurement contradicts what was stated of the materials: check areas and volume, "
        "then look for an effect that the model lacks, before using these coefficients",
    ),
    "bent": (
        "c",
        "one T does not describe the decay, and these coefficients follow T20: look for coupled "
        "spaces or absorption on one side, and do not use them at other positions or in other rooms",
    ),
    "no_air": (
        "",
        "the surfaces are made to absorb what the air does, most of all above 1 kHz: state "
        "temperature and humidity",
    ),
    "no_uncertainty": (
        "",
        "z and Q may be too large: state T per source and receiver, or its uncertainty",
    ),
    "surface_missing": ("", "a surface is missing, or the volume is wrong: check both"),
    "surface_beyond_sense": ("", "are the areas in m² and the volume in m³?"),
    "clipped": (
        "",
        "a laboratory value above 1 counts the specimen's edges too, so the true one is not known: "
        "state a larger sigma for these materials",
    ),
    "dimensions": (
        "",
        "one of them is wrong: the absorption that T asks for is proportional to the volume",
    ),
    "wide_sigma": (
        "",
        "any T agrees with so large a sigma: is it relative to alpha, or in percent?",
    ),
}

_AIR_SHARE = 0.5
_LARGE_Z = 2.0
"""z of a band that contradicts what was stated of the materials."""
_ODD_UNCERTAINTY = 0.3
"""Of T, relative. Single decays of 0.3 s at 63 Hz, the least certain, scatter by 0.24."""
OFF_VOLUME = 0.1
"""Relative difference of the volume from that of the stated dimensions: plans are no more precise."""
_WIDE_SIGMA = 0.5
"""The standard deviation of a coefficient of which nothing is known, uniform from 0 to 1, is 0.29."""


@checked
def schroeder_frequency(t: Array, volume: float) -> Array:
    """Return 2000 sqrt(T / V) in Hz, T in s and V in m³ (Schroeder & Kuttruff 1962).

    Examples
    --------
    >>> print(schroeder_frequency(np.array([2.0]), 200.0))
    [200.]
    """
    return np.asarray(2000 * np.sqrt(np.asarray(t, dtype=float) / volume))


@checked
def mid_frequency_time(t: Array, centre_frequencies: Array) -> float:
    """Return the mean of T over the octaves 500 and 1000 Hz, or their thirds; else over all bands.

    T in s, (n_bands,), NaN where missing; NaN if every band is.

    Examples
    --------
    >>> mid_frequency_time(np.array([1.4, 2.0, 1.8]), np.array([125, 500, 1000]))
    1.9
    """
    t, f = np.asarray(t, dtype=float), np.asarray(centre_frequencies, dtype=float)
    has_t = np.isfinite(t)
    middle = has_t & (f > 500 / np.sqrt(2)) & (f < 1000 * np.sqrt(2))
    used = middle if middle.any() else has_t
    return float(np.mean(t[used])) if used.any() else float("nan")


@checked
def bent_marks(bent: Sequence[BentDecay]) -> tuple[TrustMark, ...]:
    """Return the trust marks of bands whose decay is bent."""
    letter, advice = _ADVICE["bent"]
    return tuple(TrustMark("bent", letter, band.frequency, band.text, advice) for band in bent)


@checked
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
    """Return every reason to doubt single bands or the room.

    Parameters
    ----------
    room : Room
    measured, uncertainty : array (n_bands,)
        T and its standard uncertainty in s; NaN where missing or unknown.
    air_share : array (n_bands,)
        The air's share of the whole absorption.
    active : array (n_materials, n_bands)
        Where a coefficient stands at a bound: -1 for the lower, 1 for the upper one, else 0.
    z : array (n_bands,)
        See `Plausibility`.
    unreachable : sequence of float
        Centre frequencies in Hz of bands that were moved to the nearest end.
    bent : sequence of BentDecay
        Bands whose measured decay is not straight.
    """
    marks: list[TrustMark] = []

    def mark(kind: str, frequency: float | None, text: str, advised: str = "") -> None:
        letter, advice = _ADVICE[advised or kind]
        marks.append(TrustMark(kind, letter, frequency, text, advice))

    if room.air is None:
        mark("no_air", None, "no air is stated")
    if (doubt := surface_doubt(room)) is not None:
        mark(doubt[0], None, doubt[1])
    if room.dimensions is not None:
        box = float(np.prod(room.dimensions))
        if abs(room.volume / box - 1) > OFF_VOLUME:
            sides = " x ".join(f"{side:g}" for side in room.dimensions)
            text = f"volume = {room.volume:g} m³, but the dimensions {sides} m hold {box:g} m³"
            mark("dimensions", None, text)
    wide = np.argwhere(room.sigma > _WIDE_SIGMA)
    if len(wide):
        i, k = wide[0].tolist()
        text = f"{room.place('sigma', i, k)} = {room.sigma[i, k]:g} is above {_WIDE_SIGMA:g}"
        others = f", and {len(wide) - 1} more" if len(wide) > 1 else ""
        mark("wide_sigma", None, text + others)
    if room.clipped:
        mark("clipped", None, f"cut to 1: {'; '.join(room.clipped)}")
    has_t = np.isfinite(measured)
    if has_t.any() and not np.isfinite(uncertainty[has_t]).any():
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
        marks += bent_marks([band for band in bent if band.frequency == f])
        if air_share[k] > _AIR_SHARE:
            mark("air", f, "the air absorbs more than the surfaces")
        if uncertainty[k] > _ODD_UNCERTAINTY * measured[k]:
            over = f"{100 * _ODD_UNCERTAINTY:.0f} %"
            mark("uncertain", f, f"T is uncertain by over {over}: is it stated in percent, not s?")
        elif uncertainty[k] > TARGET.jnd_of(measured[k]) and not abs(z[k]) > _LARGE_Z:
            mark("uncertain", f, "T is uncertain by more than one JND")
        # A single coefficient at 1 says nothing of the others, which may still give the T.
        spent = bool((active[:, k] > 0)[room.sigma[:, k] > 0].all())
        upper = "all_at_upper_bound" if spent else "at_upper_bound"
        for i in np.flatnonzero(active[:, k]).tolist():
            side, advised = ("lower", "") if active[i, k] < 0 else ("upper", upper)
            mark("at_bound", f, f"{room.materials[i]} stands at its {side} bound", advised)
        if abs(z[k]) > _LARGE_Z:
            side = "more" if z[k] > 0 else "less"
            mark("implausible", f, f"T asks for {side} absorption than was stated, |z| over 2")
    return tuple(marks)


@checked
def letters(marks: Sequence[TrustMark], frequency: float) -> str:
    """Return the letters of a band's marks, without repeats; empty if it has none."""
    return "".join(dict.fromkeys(m.letter for m in marks if m.frequency == frequency))


@checked
def explained(marks: Sequence[TrustMark]) -> list[str]:
    """Return the marks as lines of text, grouped by advice: the facts, then the advice."""
    lines = []
    for advice in dict.fromkeys(mark.advice for mark in marks):
        alike = [mark for mark in marks if mark.advice == advice]
        letter = f"[{alike[0].letter}] " if alike[0].letter else ""
        texts = []
        for text in dict.fromkeys(mark.text for mark in alike):
            where = [f"{m.frequency:g}" for m in alike if m.text == text and m.frequency]
            texts.append(f"{', '.join(where)} Hz: {text}" if where else text)
        lines += [f"{letter}{'; '.join(texts)}", f"    -> {advice}"]
    return lines
