"""Frequency bands: nominal octave and third-octave centres (IEC 61260-1), labels and matching.

Also T at mid frequencies, and the Schroeder frequency that follows from it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = [
    "OCTAVES",
    "THIRD_OCTAVES",
    "as_bands",
    "bandwidth_factor",
    "correlation",
    "index",
    "is_middle",
    "label",
    "mid_frequency_time",
    "nominal",
    "octaves",
    "schroeder_frequency",
    "span",
    "third_octaves",
]
__dir__ = __all__.copy

OCTAVES: tuple[float, ...] = (31.5, 63, 125, 250, 500, 1000, 2000, 4000, 8000, 16000)
"""Nominal octave centre frequencies in Hz."""

THIRD_OCTAVES: tuple[float, ...] = (
    20,
    25,
    31.5,
    40,
    50,
    63,
    80,
    100,
    125,
    160,
    200,
    250,
    315,
    400,
    500,
    630,
    800,
    1000,
    1250,
    1600,
    2000,
    2500,
    3150,
    4000,
    5000,
    6300,
    8000,
    10000,
    12500,
    16000,
    20000,
)
"""Nominal third-octave centre frequencies in Hz."""

# Exact base-ten centres differ from the nominal ones by at most 1 % (1584.9 Hz is called 1600 Hz),
# and neighbouring thirds by 26 %, so 1.5 % separates them.
_TOLERANCE = 0.015
_MISTYPED = 0.05
"""Relative distance from a nominal centre within which a band is taken for a mistake, as 120 Hz for
125 Hz. Half a third octave is 12 %."""
_NARROW = 1.2
"""Ratio of neighbours below which bands are narrower than thirds, whose ratio is 1.26."""
_MIDDLE = 440.0, 2300.0  # Hz, just outside the third octaves of 500 Hz and 2 kHz
_LOWEST = 20.0  # Hz, the limit of hearing. Frequencies in kHz, at most 20, lie below


def nominal(frequency: float) -> float:
    """Return the nominal third-octave centre within 1.5 % of ``frequency`` (Hz), else itself.

    Examples
    --------
    >>> nominal(1584.893), nominal(440.0)
    (1600.0, 440.0)
    """
    return _nominal(frequency)


@lru_cache(maxsize=1024)
def _nominal(frequency: float) -> float:
    """Return `nominal`, without a check for each band of many rooms."""
    nearest = min(THIRD_OCTAVES, key=lambda centre: abs(frequency / centre - 1))
    return float(nearest) if abs(frequency / nearest - 1) <= _TOLERANCE else float(frequency)


def octaves(lowest: float = 125, highest: float = 4000) -> tuple[float, ...]:
    """Return the nominal octave centres from ``lowest`` to ``highest`` (Hz).

    Examples
    --------
    >>> octaves(250, 1000)
    (250, 500, 1000)
    """
    return tuple(f for f in OCTAVES if lowest <= f <= highest)


def third_octaves(lowest: float = 100, highest: float = 5000) -> tuple[float, ...]:
    """Return the nominal third-octave centres from ``lowest`` to ``highest`` (Hz).

    Examples
    --------
    >>> third_octaves(400, 630)
    (400, 500, 630)
    """
    return tuple(f for f in THIRD_OCTAVES if lowest <= f <= highest)


def hertz(frequencies: Sequence[float]) -> str:
    """Return bands for a sentence, "" of none.

    Examples
    --------
    >>> hertz([125, 250, 500])
    '125, 250 and 500 Hz'
    """
    if not len(frequencies):
        return ""
    texts = [f"{f:g}" for f in frequencies]
    return (", ".join(texts[:-1]) + " and " if len(texts) > 1 else "") + texts[-1] + " Hz"


def label(frequency: float) -> str:
    """Return the band's name in tables and messages.

    Examples
    --------
    >>> label(31.5), label(1000.0)
    ('31.5 Hz', '1000 Hz')
    """
    return f"{frequency:g} Hz"


def labels(frequencies: Iterable[float]) -> list[str]:
    """Return the bands' names, as `label`.

    Examples
    --------
    >>> labels([500, 1000])
    ['500 Hz', '1000 Hz']
    """
    return [label(frequency) for frequency in frequencies]


def span(frequencies: Sequence[float] | Array) -> str:
    """Return the number of bands with the first and the last, as part of a sentence.

    Examples
    --------
    >>> span([125, 250, 500]), span([1000])
    ('3 bands, 125 to 500 Hz', '1 band, 1000 Hz')
    """
    frequencies = checks.array("frequencies", frequencies)
    if frequencies.ndim != 1 or not frequencies.size:
        raise DataError(f"frequencies = {checks.shown(frequencies)} is not a list of numbers")
    first, last = (f"{f:g}" for f in (frequencies[0], frequencies[-1]))
    if len(frequencies) == 1:
        return f"1 band, {last} Hz"
    return f"{len(frequencies)} bands, {first} to {last} Hz"


def as_bands(frequencies: Iterable[float], place: str = "centre_frequencies") -> Array:
    """Return centre frequencies as an array (n_bands,) in Hz, checked and made nominal.

    Raises
    ------
    DataError
        If there is none, or one is not a finite positive number, or they do not increase, or all
        are below 20 Hz, as if in kHz. Also if one lies 1.5 to 5 % beside a nominal third-octave centre,
        unless a band next to it is within a ratio of 1.2, as in narrower bands than thirds.
    """
    try:
        stated = [float(v) for v in frequencies]
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{place}: {error}; a band is a number in Hz") from error
    f = np.array([_nominal(v) if v > 0 else v for v in stated])
    if f.ndim != 1 or f.size == 0:
        raise DataError(f"{place} is empty; at least one band is needed")
    for value in f:
        if not (np.isfinite(value) and value > 0):
            raise DataError(
                f"{place} has {value:g} Hz; a centre frequency is finite and above 0 Hz"
            )
    if f.max() < _LOWEST:
        raise DataError(
            f"{place} = {', '.join(f'{v:g}' for v in stated[:8])} looks like kHz; a centre frequency "
            f"is in Hz, and at least one is {_LOWEST:g} Hz or more"
        )
    for i, (below, above) in enumerate(itertools.pairwise(f)):
        if above <= below:
            raise DataError(
                f"{place} has {label(stated[i + 1])} after {label(stated[i])}; bands must increase, "
                "each once (within 1.5 % they are the same nominal band)"
            )
    _refuse_mistyped(f, place)
    return f


def _refuse_mistyped(f: Array, place: str) -> None:
    """Raise DataError for a band beside a nominal one, as 120 Hz: it would match no measured band."""
    nominal_centres = np.array(THIRD_OCTAVES)
    for i, value in enumerate(f):
        nearest = nominal_centres[np.argmin(np.abs(value / nominal_centres - 1))]
        near = f[max(i - 1, 0) : i + 2]
        narrow = (near[1:] / near[:-1]).min(initial=np.inf) < _NARROW
        if value != nearest and abs(value / nearest - 1) <= _MISTYPED and not narrow:
            raise DataError(
                f"{place} has {label(float(value))}, which is no nominal band (ISO 266); the nearest "
                f"is {label(float(nearest))}"
            )


def index(frequencies: Array, frequency: float) -> int | None:
    """Return where ``frequency`` (Hz) stands in ``frequencies`` (within 1.5 %), or None.

    Examples
    --------
    >>> index(np.array([500.0, 1000.0]), 1000), index(np.array([500.0]), 125)
    (1, None)
    """
    near = np.flatnonzero(np.abs(frequencies / frequency - 1) <= _TOLERANCE)
    return int(near[0]) if near.size else None


def is_middle(frequencies: Array) -> NDArray[np.bool_]:
    """Return which bands are octaves or thirds from 500 Hz to 2 kHz, (n_bands,).

    Examples
    --------
    >>> print(is_middle(np.array([250.0, 500.0, 2000.0, 4000.0])))
    [False  True  True False]
    """
    low, high = _MIDDLE
    return np.asarray((frequencies > low) & (frequencies < high))


def correlation(frequencies: Array, per_octave: float) -> Array:
    """Return the correlation of errors between bands, (n_bands, n_bands): per_octave ** octaves.

    Parameters
    ----------
    frequencies : array (n_bands,)
        Hz.
    per_octave : float
        The correlation of two bands an octave apart, 0 to below 1.

    Examples
    --------
    >>> print(correlation(np.array([500.0, 1000.0, 2000.0]), 0.5))
    [[1.   0.5  0.25]
     [0.5  1.   0.5 ]
     [0.25 0.5  1.  ]]
    """
    octave = np.log2(np.asarray(frequencies, dtype=float))
    apart = np.abs(octave[:, np.newaxis] - octave)
    return np.asarray(np.where(apart == 0, 1.0, per_octave**apart))


def bandwidth_factor(frequencies: Array) -> float:
    """Return bandwidth / centre frequency: 0.71 for octaves, 0.23 for third-octaves.

    Neighbouring bands less than half an octave apart count as third-octaves. A single band counts
    as an octave, the more common width.
    """
    if len(frequencies) < 2:
        return 0.71
    return 0.23 if float(np.min(frequencies[1:] / frequencies[:-1])) < np.sqrt(2) else 0.71


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
    has_t = np.isfinite(t)
    middle = has_t & (f > 500 / np.sqrt(2)) & (f < 1000 * np.sqrt(2))
    used = middle if middle.any() else has_t
    return float(np.mean(t[used])) if used.any() else float("nan")
