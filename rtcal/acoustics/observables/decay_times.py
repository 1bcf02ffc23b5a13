"""Decay times, T20, T30 and EDT: the slope of the decay curve between two levels.

ISO 3382-1:2009, 5.3 and A.2.2.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.observables.base import DB, Observable, Part, Scale, of_kind, register
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

LIMITS = (0.01, 120.0)
"""Shortest and longest T20 and T30 in s that are accepted. A lined box of a litre has 0.01 s or more.
The longest published T is 112 s, at 125 Hz in the oil tanks of Inchindown (T. Cox, Sonic
Wonderland, 2014)."""
TEAMS = (0.046, 0.036, 0.028, 0.022, 0.017, 0.013)
"""Of T, relative. The ends are from the music studio of the PTB (round robin III, Bork 2005; medians
over pairs), geometric between them. All pairs of a team have this error in common."""

MARGIN_DB = 15.0
"""Least distance in dB from a range's lower end down to the truncation. Truncating an exponential decay
there lowers T20 by 0.4 %."""
_DECAYS = 10
"""Decays that an integrated impulse response counts as (ISO 3382-2:2008, 6.2)."""


def decay_curve_db(energy: Array) -> Array:
    """Return the normalised decay curve at the start of each bin, in dB, same shape.

    L_k = 10 lg(sum over j >= k of E_j / sum over all of E_j), so that L_0 = 0 (Schroeder 1965).
    Minus infinity where no energy is left, NaN for a decay without energy.
    """
    # Summed from the end, where the numbers are small: a difference of large sums would round them.
    left = np.flip(np.cumsum(np.flip(energy, -1), axis=-1), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10 * np.log10(left / left[..., :1]))


def cut_off_db(energy: Array) -> Array:
    """Return the level of the energy that the end of the decay cuts off, (...).

    In dB relative to the whole energy. It is extrapolated from the energies A and B of the last two
    quarters of the time: B r / (1 - r), r = B / A. Infinite where the energy does not fall, minus
    infinity where none is left at the end. A double slope is judged by its late part.
    """
    quarter = energy.shape[-1] // 4
    if quarter == 0:
        return np.full(energy.shape[:-1], np.inf)
    last = energy[..., -quarter:].sum(axis=-1)
    before = energy[..., -2 * quarter : -quarter].sum(axis=-1)
    falls = before > last
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = np.where(last == 0, 0.0, np.where(falls, last**2 / (before - last), np.inf))
        return np.asarray(10 * np.log10(beyond / energy.sum(axis=-1)))


class Relative(Observable):
    """A time in s, whose logarithm is observed."""

    unit = "s"
    decimals = 3
    logarithmic = True
    unknown_error = 0.05

    def linear(self, values: Array, stated: Array) -> Array:
        """Return 1 - stated / value: 1 / T and 1 / Ts are linear in the absorption area."""
        return np.asarray(1 - np.exp(-(values - stated)))

    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by the logarithm."""
        return np.asarray(np.exp(-(values - stated)))


@dataclass(frozen=True)
class Bend:
    """The difference of a decay time from T20 in straight decays.

    Attributes
    ----------
    name : str
        Of the ratio less 1.
    limit : float
        Its largest size in percent.
    scatter : float
        Standard deviation of the ratio times sqrt(B T), over 4,000 exponential decays of Gaussian noise
        (B T = 44 to 355).
    """

    name: str
    limit: float
    scatter: float


class DecaySlope(Relative):
    """A decay time in s: -60 dB over the slope of the decay curve within a range of levels.

    Attributes
    ----------
    upper, lower : float
        The range in dB.
    one_decay : float
        Relative standard deviation of one decay's time, times sqrt(B T), B the bandwidth in Hz.
    averages : (float, float) or None
        a and b of the uncertainty of a mean over positions (ISO 3382-2:2008, Eqs. 4 and 5).
    bend : Bend or None
        Where the ratio to T20 tells whether a decay is bent.
    """

    upper: ClassVar[float]
    lower: ClassVar[float]
    one_decay: ClassVar[float]
    averages: ClassVar[tuple[float, float] | None] = None
    bend: ClassVar[Bend | None] = None
    jnd = 0.05
    relative_jnd = True
    limits = LIMITS
    # An anechoic room for speech and a mausoleum.
    usual = 0.05, 30.0
    doubt = "is it in seconds?"
    part: ClassVar[Part] = "late"
    teams = TEAMS
    averaging = Scale(lambda t: 1 / t, lambda rate: 1 / rate, lambda t: -1 / t**2)

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the decay times in s; NaN for a decay that is too short or does not fall."""
        times = self.of_curve(decay_curve_db(energy), bin_width)
        return np.where(self.too_short(energy), np.nan, times)

    def of_curve(self, level: Array, bin_width: float) -> Array:
        """Return the decay times in s of decay curves in dB, wherever they end, (...).

        NaN where fewer than two points lie within the range, or the curve does not fall.
        """
        with np.errstate(invalid="ignore"):
            within = (level <= self.upper) & (level >= self.lower)
        k = np.arange(level.shape[-1], dtype=float)
        n = within.sum(axis=-1)
        many = np.maximum(n, 1)
        mean = np.where(within, k, 0).sum(-1) / many
        centred_k = np.where(within, k - mean[..., np.newaxis], 0.0)
        y = np.where(within, level, 0.0)
        spread = np.sum(centred_k**2, axis=-1)
        fall = -np.sum(centred_k * y, axis=-1)
        holds = (n >= 2) & (fall > 0)
        return np.where(holds, 60 * bin_width * spread / np.where(holds, fall, 1.0), np.nan)

    def too_short(self, energy: Array) -> NDArray[np.bool_]:
        """Return whether the decays are cut off too early to hold the range of levels."""
        return np.asarray(cut_off_db(energy) > self.lower - MARGIN_DB)

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return d ln T / d E_j.

        T is -60 / slope, the slope that of the regression of L_k = DB ln(B_k / B_0) on k within the
        range, with B_k the energy from bin k on. So d ln T = -sum c_k dL_k / (slope sum c_k²), where
        c_k is k less its mean. The range's ends move too: at an end that lies r off the line, points
        enter or leave at the rate of dL / slope bins, and each has the weight c r / (slope sum c_k²).
        """
        within = (level <= self.upper) & (level >= self.lower)
        k = np.arange(level.shape[-1], dtype=float)
        n = np.maximum(within.sum(axis=-1, keepdims=True), 1)
        centred = np.where(within, k - np.where(within, k, 0.0).sum(-1, keepdims=True) / n, 0.0)
        inside = np.where(within, level, 0.0)
        spread = np.sum(centred**2, axis=-1, keepdims=True)
        slope = np.sum(centred * inside, axis=-1, keepdims=True) / spread
        residual = inside - inside.sum(-1, keepdims=True) / n - slope * centred
        by_level = -centred / (slope * spread)
        leverage = centred * residual / (slope**2 * spread)
        first = np.argmax(within, axis=-1)[..., np.newaxis]
        last = level.shape[-1] - 1 - np.argmax(np.flip(within, -1), axis=-1)[..., np.newaxis]
        by_level += np.where(k == last, leverage, 0.0)
        if self.upper < 0:  # the curve begins at 0 dB, whatever the energy
            by_level -= np.where(k == first, leverage, 0.0)
        left = np.flip(np.cumsum(np.flip(energy, -1), axis=-1), -1)
        share = np.where(within, by_level / np.where(left > 0, left, 1.0), 0.0)
        whole = by_level.sum(-1, keepdims=True) / left[..., :1]
        gradient = DB * (np.cumsum(share, axis=-1) - whole)
        lacking = np.isnan(self.of_curve(level, bin_width))[..., np.newaxis]
        return np.where(lacking, np.nan, gradient)

    def decay_time(self, values: Array) -> Array:
        """Return the values."""
        return values

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return `one_decay` / sqrt(B T) (ISO 3382-2:2008, Eqs. 4 and 5 for T20 and T30)."""
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        with np.errstate(invalid="ignore"):
            return np.asarray(self.one_decay / np.sqrt(bandwidth * times))

    def variance_of_mean(self, frequencies: Array, mean: Array, positions: Array) -> Array:
        """Return a² T (1 + b / n) / (N B), n the decays of an average, N the positions.

        The standard was not at hand; a and b are those of RWTH Aachen's ITA-Toolbox,
        ita_roomacoustics_uncertainty.m (P. Dietrich, 2009), which names EN ISO 3382.
        """
        if self.averages is None:
            return super().variance_of_mean(frequencies, mean, positions)
        a, b = self.averages
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        return np.asarray(a**2 * mean * (1 + b / _DECAYS) / (np.maximum(positions, 1) * bandwidth))

    @property
    def value_rule(self) -> str:
        """A simulated decay may be of any length."""
        return "finite and above 0 s"

    def broken(self, values: Array) -> NDArray[np.bool_]:
        """Return where values are not above 0."""
        with np.errstate(invalid="ignore"):
            return np.asarray(values <= 0)

    def largest_uncertainty(self, values: Array) -> tuple[Array, str]:
        """Return the values."""
        return values, "the value itself"

    def refuse(self, place: str, value: float) -> None:
        """Raise DataError for a T that no room has: it is most likely in another unit."""
        if value <= 0:
            raise DataError(f"{place} = {value:g} s is not above 0")
        low, high = self.limits
        if value > high or value < low:
            low, high = LIMITS
            raise DataError(
                f"{place} = {value:g} s is not from {low:g} to {high:g} s, as in any room: {self.doubt}"
            )


@register
class T20(DecaySlope):
    """T20: -5 to -25 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t20", "T20", 10
    spellings = (
        "rt20",
        "tr20",
        "rt60t20",
        "t60t20",
        "t60(20)",
        "reverberationtimet20",
        "nachhallzeitt20",
    )
    upper, lower = -5.0, -25.0
    minimum_range = 35.0
    one_decay = 0.88
    averages = (0.88, 1.90)
    matched = shown = True


@register
class T30(DecaySlope):
    """T30: -5 to -35 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t30", "T30", 20
    spellings = (
        "rt30",
        "tr30",
        "rt60t30",
        "t60t30",
        "t60(30)",
        "reverberationtimet30",
        "nachhallzeitt30",
    )
    upper, lower = -5.0, -35.0
    minimum_range = 45.0
    one_decay = 0.55
    averages = (0.55, 1.52)
    # ISO 3382-2:2008, B.3: above 10 % a decay is far from straight. The scatter is 0.70 to 0.77.
    bend = Bend("curvature T30/T20 - 1", 10.0, 0.75)


@register
class EDT(DecaySlope):
    """Early decay time: 0 to -10 dB (ISO 3382-1:2009, A.2.2)."""

    key, label, rank = "edt", "EDT", 30
    spellings = ("earlydecaytime",)
    upper, lower = 0.0, -10.0
    # Strong direct sound makes it arbitrarily short.
    limits = 0.0, LIMITS[1]
    usual = 0.005, 30.0
    # 400 decays of octave-filtered Gaussian noise at 500 Hz and 400 at 1 kHz, T = 1 s, have 1.7.
    one_decay = 1.6
    part = "early"
    # Four JND, in the mean over positions. The scatter is 2.2 to 2.3.
    bend = Bend("EDT/T20 - 1", 20.0, 2.25)
    teams = (0.100, 0.080, 0.064, 0.051, 0.041, 0.033)
    matched = shown = True


def longest(keys: Iterable[str]) -> DecaySlope:
    """Return the decay time that needs the longest decay, of these observables and T20.

    Examples
    --------
    >>> longest(["edt", "t30", "c80"]).label, longest(["edt"]).label
    ('T30', 'T20')
    """
    asked = {T20.key, *checks.texts("keys", keys)}
    return min((o for k, o in of_kind(DecaySlope).items() if k in asked), key=lambda o: o.lower)
