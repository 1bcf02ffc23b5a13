"""Frequency bands: nominal octave and third-octave centres (IEC 61260-1), labels, and other bands.

Also T at mid frequencies, and the Schroeder frequency that follows from it.

Thirds become octaves and back by one rule for every format, table and measurement. An octave consists
of its three thirds, each with the same weight:

- Absorption coefficients and areas average.
- Decay times average by their rate: 1/T_octave = mean of 1/T_third, since T is the inverse of an
  absorption area.
- C50 and C80 average as the early share of the energy, D50 and Ts as they are, G as energy.

A third takes the value of its octave, so that the thirds average to the octave again. An octave
with a missing value in one of its thirds is missing. An octave without all of its three thirds cannot
be had.

Standard deviations follow from what the errors share. The errors of the tabulated coefficients of a
material are fully correlated within an octave, so sigma averages like alpha. The errors of measured
values are independent between thirds, since their variance is inversely proportional to the
bandwidth (ISO 3382-2:2008, Eqs. 4 and 5): a third has sqrt(3) times the octave's uncertainty.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["OCTAVES", "THIRD_OCTAVES", "nominal", "octaves", "schroeder_frequency", "third_octaves"]
__dir__ = __all__.copy

OCTAVES: tuple[float, ...] = (31.5, 63, 125, 250, 500, 1000, 2000, 4000, 8000, 16000)
"""Nominal octave centre frequencies in Hz."""

THIRD_OCTAVES: tuple[float, ...] = (
    *(20, 25, 31.5, 40, 50, 63, 80, 100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000),
    *(1250, 1600, 2000, 2500, 3150, 4000, 5000, 6300, 8000, 10000, 12500, 16000, 20000),
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
_LEAST = 10.0  # Hz, least band that is measured beside those above


@lru_cache(maxsize=1024)
def nominal(frequency: float) -> float:
    """Return the nominal third-octave centre within 1.5 % of a frequency in Hz, else the frequency.

    Examples
    --------
    >>> nominal(1584.893), nominal(440.0)
    (1600.0, 440.0)
    """
    nearest = min(THIRD_OCTAVES, key=lambda centre: abs(frequency / centre - 1))
    return float(nearest) if abs(frequency / nearest - 1) <= _TOLERANCE else float(frequency)


def octaves(lowest: float = 125, highest: float = 4000) -> tuple[float, ...]:
    """Return the nominal octave centre frequencies in Hz from ``lowest`` to ``highest``.

    Examples
    --------
    >>> octaves(250, 1000)
    (250, 500, 1000)
    """
    return tuple(f for f in OCTAVES if lowest <= f <= highest)


def third_octaves(lowest: float = 100, highest: float = 5000) -> tuple[float, ...]:
    """Return the nominal third-octave centre frequencies in Hz from ``lowest`` to ``highest``.

    Examples
    --------
    >>> third_octaves(400, 630)
    (400, 500, 630)
    """
    return tuple(f for f in THIRD_OCTAVES if lowest <= f <= highest)


def hertz(frequencies: Sequence[float] | Array) -> str:
    """Return centre frequencies in Hz as words of a sentence; "" if there is none.

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
    """Return the name of a band in tables and messages, from its centre frequency in Hz.

    Examples
    --------
    >>> label(31.5), label(1000.0)
    ('31.5 Hz', '1000 Hz')
    """
    return f"{frequency:g} Hz"


def labels(frequencies: Iterable[float]) -> list[str]:
    """Return the names of bands in tables and messages, from their centre frequencies in Hz.

    Examples
    --------
    >>> labels([500, 1000])
    ['500 Hz', '1000 Hz']
    """
    return [label(frequency) for frequency in frequencies]


def span(frequencies: Sequence[float] | Array) -> str:
    """Return the number of bands, and the first and the last of them in Hz, as words of a sentence.

    ``frequencies`` are the bands' centre frequencies in Hz, rising.

    Examples
    --------
    >>> span([125, 250, 500]), span([1000])
    ('3 bands, 125 to 500 Hz', '1 band, 1000 Hz')
    """
    frequencies = checks.array("frequencies", frequencies)
    if frequencies.ndim != 1 or not frequencies.size:
        raise DataError(
            f"frequencies = {checks.shown(frequencies)} must be a list of numbers in Hz"
        )
    first, last = (f"{f:g}" for f in (frequencies[0], frequencies[-1]))
    if len(frequencies) == 1:
        return f"1 band, {last} Hz"
    return f"{len(frequencies)} bands, {first} to {last} Hz"


def where(f: Array, chosen: NDArray[np.bool_], known: NDArray[np.bool_]) -> str:
    """Return in words which of the known bands are chosen.

    ``f`` (n_bands,) are the centre frequencies in Hz. ``chosen`` (n_bands,) is True for the bands to
    name. ``known`` (n_bands,) is True for the bands with a value, which could be chosen.

    Examples
    --------
    >>> f, every = np.array([125.0, 250.0, 500.0]), np.ones(3, dtype=bool)
    >>> [where(f, np.array(some), every) for some in ([1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1])]
    ['at 250 Hz and below', 'at 250 Hz and above', 'at 125 and 500 Hz', 'in all bands']
    """
    at, among = np.flatnonzero(chosen), np.flatnonzero(known)
    if len(at) > 1 and np.array_equal(at, among):
        return "in all bands"
    if len(at) > 1 and np.array_equal(at, among[: len(at)]):
        return f"at {f[at[-1]]:g} Hz and below"
    if len(at) > 1 and np.array_equal(at, among[-len(at) :]):
        return f"at {f[at[0]]:g} Hz and above"
    return f"at {hertz(f[at])}"


def as_bands(frequencies: Iterable[float], place: str = "centre_frequencies") -> Array:
    """Return centre frequencies as an array (n_bands,) in Hz, checked and made nominal.

    ``place`` is the name of the frequencies in error messages. A frequency within 1.5 % of a nominal
    third-octave centre is replaced by it.

    Raises
    ------
    DataError
        If there is no frequency, or if one is not a finite positive number; if the frequencies do not
        increase; if all are below 20 Hz or some below 10 Hz, as if they were in kHz; or if one is 1.5
        to 5 % off a nominal third-octave centre. The last rule does not apply to bands narrower than
        third-octaves, which have a neighbouring band within a ratio of 1.2.
    """
    try:
        stated = [float(v) for v in frequencies]
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{place}: {error}; give each band as a number in Hz") from error
    f = np.array([nominal(v) if v > 0 else v for v in stated])
    if f.ndim != 1 or f.size == 0:
        raise DataError(f"{place} is empty; give at least one band")
    for value in f:
        if not (np.isfinite(value) and value > 0):
            raise DataError(
                f"{place} has {value:g} Hz; a centre frequency must be finite and above 0 Hz"
            )
    if f.max() < _LOWEST:
        raise DataError(
            f"{place} = {', '.join(f'{v:g}' for v in stated[:8])} is probably in kHz. Give "
            f"centre frequencies in Hz; at least one must be {_LOWEST:g} Hz or more"
        )
    low, high = f[f < _LEAST], f[f >= _LEAST]
    if low.size and high.size and 1000 * low.min() > high.max() and high.min() > 4 * low.max():
        raise DataError(
            f"{place} has {hertz(low)} and also {hertz(high)}, so some are probably in "
            "kHz. Give all centre frequencies in Hz"
        )
    for i, (below, above) in enumerate(itertools.pairwise(f)):
        if above <= below:
            raise DataError(
                f"{place} has {label(stated[i + 1])} after {label(stated[i])}; centre "
                "frequencies must increase, and two within 1.5 % count as the same band"
            )
    centres = np.array(THIRD_OCTAVES)
    for i, value in enumerate(
        f
    ):  # a band beside a nominal one, as 120 Hz, would match no measured band
        nearest = centres[np.argmin(np.abs(value / centres - 1))]
        near = f[max(i - 1, 0) : i + 2]
        narrow = (near[1:] / near[:-1]).min(initial=np.inf) < _NARROW
        if value != nearest and abs(value / nearest - 1) <= _MISTYPED and not narrow:
            raise DataError(
                f"{place} has {label(float(value))}, which is not a nominal band (ISO 266); the "
                f"nearest is {label(float(nearest))}"
            )
    return f


def index(frequencies: Array, frequency: float) -> int | None:
    """Return the number of the band, from 0, that is within 1.5 % of a frequency in Hz, else None.

    Examples
    --------
    >>> index(np.array([500.0, 1000.0]), 1000), index(np.array([500.0]), 125)
    (1, None)
    """
    near = np.flatnonzero(np.abs(frequencies / frequency - 1) <= _TOLERANCE)
    return int(near[0]) if near.size else None


def is_middle(frequencies: Array) -> NDArray[np.bool_]:
    """Return True for each band from 500 Hz to 2 kHz, (n_bands,); True for all if no band is there.

    Examples
    --------
    >>> print(is_middle(np.array([250.0, 500.0, 2000.0, 4000.0])))
    [False  True  True False]
    """
    low, high = _MIDDLE
    middle = (frequencies > low) & (frequencies < high)
    return np.asarray(middle if middle.any() else ~middle)


def correlation(frequencies: Array, per_octave: float) -> Array:
    """Return the correlation of errors between bands, (n_bands, n_bands), by their distance in octaves.

    ``frequencies`` (n_bands,) are in Hz. ``per_octave``, 0 to below 1, is the correlation of two bands
    an octave apart; bands n octaves apart have the correlation per_octave ** n.
    """
    octave = np.log2(np.asarray(frequencies, dtype=float))
    apart = np.abs(octave[:, np.newaxis] - octave)
    return np.asarray(np.where(apart == 0, 1.0, per_octave**apart))


def bandwidth_factor(frequencies: Array) -> float:
    """Return the bandwidth over the centre frequency: 0.71 for octaves, 0.23 for third-octaves.

    ``frequencies`` (n_bands,) are centre frequencies in Hz. Neighbouring bands less than half an octave
    apart count as third-octaves. A single band counts as an octave, the more common width.
    """
    if len(frequencies) < 2:
        return 0.71
    return 0.23 if float(np.min(frequencies[1:] / frequencies[:-1])) < np.sqrt(2) else 0.71


def schroeder_frequency(t: Array, volume: float) -> Array:
    """Return the Schroeder frequency 2000 sqrt(T / V) in Hz (Schroeder & Kuttruff 1962).

    ``t`` is the reverberation time in s, ``volume`` the room's volume in m³.

    Examples
    --------
    >>> print(schroeder_frequency(np.array([2.0]), 200.0))
    [200.]
    """
    return np.asarray(2000 * np.sqrt(np.asarray(t, dtype=float) / volume))


def mid_frequency_time(t: Array, centre_frequencies: Array) -> float:
    """Return the mean reverberation time T in s at middle frequencies.

    The mean is over the octaves 500 and 1000 Hz or their third-octaves. If T is missing in all of
    these, the mean is over all bands with T. ``t`` (n_bands,) is T in s, NaN where missing.

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


@dataclass(frozen=True)
class Scale:
    """Scale on which the values of three third-octaves are averaged, to give the value of the octave.

    ``forward`` gives the averaged quantity for a value, such as 1 / T for T, ``inverse`` the value for
    that quantity, and ``slope`` the derivative of ``forward``.
    """

    forward: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    slope: Callable[[Array], Array]


ITSELF = Scale(lambda x: x, lambda x: x, np.ones_like)


class Conversion:
    """Conversion of values from third-octaves to octaves, or from octaves to third-octaves.

    Parameters
    ----------
    frequencies, wanted : sequence
        Centre frequencies in Hz of the bands that have values, and of the bands to convert them to.
    missing : bool
        Whether the value in a wanted band is NaN if a band that the conversion needs is missing.

    Raises
    ------
    DataError
        If ``missing`` is False, and ``frequencies`` lack a third-octave of a wanted octave or the
        octave of a wanted third-octave. `obtainable` returns the wanted bands without this error.

    Examples
    --------
    >>> print(Conversion([400, 500, 630], [500]).mean(np.array([0.1, 0.2, 0.6])))
    [0.3]
    """

    def __init__(
        self, frequencies: Iterable[float], wanted: Iterable[float], *, missing: bool = False
    ) -> None:
        self.old, self.new = as_bands(frequencies, "frequencies"), as_bands(wanted, "wanted")
        parts = _parts(self.old, self.new)
        place = {f: i for i, f in enumerate(self.old.tolist())}
        for frequency, part in zip(self.new.tolist(), parts, strict=True):
            lacking = [f for f in part if f not in place]
            if lacking and not missing:
                raise DataError(
                    f"the band {label(frequency)} cannot be made from {hertz(self.old)}: it "
                    f"needs {hertz(part)}, and {hertz(lacking)} {'are' if lacking[1:] else 'is'} "
                    "missing"
                )
        self._index = np.array([[place.get(f, -1) for f in part] for part in parts])

    def _taken(self, values: Array) -> Array:
        """Return the old bands' values that make up each new band, (..., n_wanted, 1 or 3)."""
        if values.ndim == 0 or values.shape[-1] != len(self.old):
            raise DataError(
                f"values has shape {values.shape}; its last axis must have {len(self.old)} "
                "values, one per band"
            )
        return np.where(self._index < 0, np.nan, values[..., self._index])

    def mean(self, values: Array, scale: Scale = ITSELF) -> Array:
        """Return values converted to the wanted bands, (..., n_wanted), NaN where a value is missing.

        ``values`` (..., n_bands) are in the bands ``frequencies``. A third-octave gets the value of its
        octave. An octave gets the mean of its third-octaves on a ``scale``, such as 1 / T for T
        (`Observable.averaging`). By default the values themselves are averaged, as for absorption
        coefficients and their sigma.
        """
        parts = self._taken(checks.array("values", values))
        if parts.shape[-1] == 1:
            return parts[..., 0]
        return np.asarray(scale.inverse(scale.forward(parts).mean(-1)))

    def uncertainty(self, uncertainty: Array, values: Array, scale: Scale) -> Array:
        """Return the standard uncertainty of values after their conversion, (..., n_wanted).

        ``values`` (..., n_bands) are the values before the conversion, and ``uncertainty`` (...,
        n_bands) is their standard uncertainty. Errors of third-octaves count as independent, so that a
        third-octave has sqrt(3) times the uncertainty of its octave. ``scale`` is that of `mean`.
        """
        if _in_thirds(self.new) and not _in_thirds(self.old):
            return np.asarray(np.sqrt(3) * self._taken(uncertainty)[..., 0])
        by_third = self._taken(scale.slope(values) * uncertainty)
        total = np.sqrt((by_third**2).sum(-1)) / by_third.shape[-1]
        return np.asarray(total / np.abs(scale.slope(self.mean(values, scale))))


def obtainable(frequencies: Iterable[float], wanted: Iterable[float]) -> Array:
    """Return the ``wanted`` bands in Hz to which values in the bands ``frequencies`` can be converted.

    Examples
    --------
    >>> print(obtainable([400, 500, 630, 800], [250, 500, 1000]))
    [500.]
    """
    old, new = as_bands(frequencies), as_bands(wanted)
    centres = set(old.tolist())
    parts = _parts(old, new)
    return np.array([f for f, part in zip(new, parts, strict=True) if set(part) <= centres])


def unused(frequencies: Iterable[float], wanted: Iterable[float]) -> Array:
    """Return the bands of ``frequencies``, in Hz, that no conversion to a ``wanted`` band uses.

    An octave is converted only from all three of its thirds.

    Examples
    --------
    >>> print(unused([400, 500, 630, 800], [250, 500, 1000]))
    [800.]
    """
    old = as_bands(frequencies)
    new = obtainable(old, wanted)
    used = {f for part in _parts(old, new) for f in part} if new.size else set()
    return np.array([f for f in old if f not in used])


def rule(frequencies: Iterable[float], wanted: Iterable[float], quantity: str) -> str:
    """Return a sentence on how a quantity is converted to the wanted bands; "" without a conversion.

    Examples
    --------
    >>> rule([400, 500, 630], [500], "alpha")
    'alpha is converted from third-octaves to octaves: the mean of the three thirds'
    """
    old, new = _in_thirds(as_bands(frequencies)), _in_thirds(as_bands(wanted))
    if old == new:
        return ""
    if new:
        return f"{quantity} is converted from octaves to third-octaves: that of the octave"
    mean = "the mean of 1/T over" if quantity == "T" else "the mean of"
    return f"{quantity} is converted from third-octaves to octaves: {mean} the three thirds"


def notes(measured: Iterable[float], wanted: Iterable[float], quantity: str = "T") -> list[str]:
    """Return sentences for the user on measured bands that are converted to wanted bands, or left out.

    ``measured`` and ``wanted`` are centre frequencies in Hz; ``quantity`` is the name in the sentences.

    Examples
    --------
    >>> notes([500, 1000], [500])
    ['T at 1000 Hz is left out, because the room does not have this band']
    """
    stated = as_bands(measured)
    found = [rule(stated, wanted, quantity)]
    if (left := unused(stated, wanted)).size:
        these = "these bands" if len(left) > 1 else "this band"
        found.append(
            f"{quantity} at {', '.join(labels(left))} is left out, because the room does "
            f"not have {these}"
        )
    return [note for note in found if note]


def _parts(old: Array, new: Array) -> list[list[float]]:
    """Return for each new band the old bands that it is made from, present or not."""
    if _in_thirds(old) == _in_thirds(new):
        return [[f] for f in new.tolist()]
    if _in_thirds(old):
        return [thirds_of(f) for f in new.tolist()]
    octave = {f: float(o) for o in OCTAVES for f in thirds_of(o)}
    return [[octave.get(f, f)] for f in new.tolist()]


def _in_thirds(centres: Array) -> bool:
    """Return whether the bands are third-octaves: whether one of them is no octave's centre."""
    return any(f in THIRD_OCTAVES and f not in OCTAVES for f in centres.tolist())


def thirds_of(octave: float) -> list[float]:
    """Return the centre frequencies in Hz of an octave's third-octaves, or [octave] if it is none."""
    if octave not in OCTAVES:
        return [octave]
    place = THIRD_OCTAVES.index(octave)
    return [float(f) for f in THIRD_OCTAVES[place - 1 : place + 2]]
