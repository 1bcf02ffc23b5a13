"""Clarity, C50 and C80: the early energy over the late, in dB (ISO 3382-1:2009, A.10)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables.base import DB, Observable, Scale, register
from rtcal.support.types import Array


def divided(energy: Array, bin_width: float, limit: float) -> tuple[Array, Array]:
    """Return the energy before and after ``limit`` s; a bin that it divides counts in proportion.

    Both are summed, since the later energy as a difference could round to a value below 0.
    """
    share = early_share(energy.shape[-1], bin_width, limit)
    return energy @ share, energy @ (1 - share)


def early_share(n_bins: int, bin_width: float, limit: float) -> Array:
    """Return the part of each bin that is before ``limit`` s, (n_bins,)."""
    return np.clip(limit / bin_width - np.arange(n_bins), 0.0, 1.0)


def _early_share(clarity: Array) -> Array:
    return np.asarray(1 / (1 + 10 ** (-clarity / 10)))


class Clarity(Observable):
    """10 lg(early / late) in dB; ``limit`` in s ends the early sound."""

    limit: ClassVar[float]
    unit = "dB"
    decimals = 1
    jnd = 1.0
    # C80 of T = 0.03 s is 160 dB.
    limits = -200.0, 200.0
    doubt = "is it in dB?"
    # C80 of T = 0.1 s is 48 dB; of 1 m from a source in a long T it is some 20 dB.
    usual = -40.0, 45.0
    rises = True
    # Of C80 between teams, in dB; see `rtcal.acoustics.observables.decay_times.TEAMS`.
    teams = (0.83, 0.70, 0.59, 0.49, 0.42, 0.35)
    unknown_error = 0.5
    remeasured = 0.1
    averaging = Scale(
        _early_share,
        lambda share: 10 * np.log10(share / (1 - share)),
        lambda c: np.log(10) / 10 * _early_share(c) * (1 - _early_share(c)),
    )

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the clarity in dB; infinite without late energy, NaN without any."""
        early, late = divided(energy, bin_width, self.limit)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(10 * np.log10(early / late))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return DB (share / early - (1 - share) / late), share the part of a bin before the limit."""
        share = early_share(energy.shape[-1], bin_width, self.limit)
        early, late = energy @ share, energy @ (1 - share)
        return np.asarray(
            DB * (share / early[..., np.newaxis] - (1 - share) / late[..., np.newaxis])
        )

    def linear(self, values: Array, stated: Array) -> Array:
        """Return the relative change of the decay rate k of C = 10 lg(exp(k limit) - 1)."""
        return np.asarray(self._rate(values) / self._rate(stated) - 1)

    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by the clarity."""
        rate = self._rate(values)
        by_rate = DB * self.limit / -np.expm1(-rate * self.limit)
        return np.asarray(1 / (by_rate * self._rate(stated)))

    def _rate(self, clarity: Array) -> Array:
        """Return the k of an exponential decay with this clarity in dB, in 1/s."""
        return np.asarray(np.log1p(np.exp(clarity / DB)) / self.limit)

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the standard deviation in dB of one response, whose field is noise.

        In a window the energy of noise of bandwidth B has the relative variance 1 / (B t), where
        t = (∫ e)² / ∫ e² of the decaying energy e. For the early sound of an exponential decay t is
        2 (1 - a) / (k (1 + a)), for the late one 2 / k; k = 6 ln 10 / T, a = exp(-k limit).
        """
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        with np.errstate(invalid="ignore"):
            rate = 6 * np.log(10) / times
            end = np.exp(-rate * self.limit)
            variance = rate / (2 * bandwidth) * ((1 + end) / (1 - end) + 1)
            return np.asarray(10 / np.log(10) * np.sqrt(variance))


@register
class C50(Clarity):
    """Clarity of speech: the energy before 50 ms over that after, in dB."""

    key, label, rank = "c50", "C50", 40
    spellings = ("clarityc50", "deutlichkeitsmaß", "deutlichkeitsmaßc50", "deutlichkeitsmassc50")
    limit = reaches = 0.05
    shown = True


@register
class C80(Clarity):
    """Clarity of music: the energy before 80 ms over that after, in dB."""

    key, label, rank = "c80", "C80", 50
    spellings = ("clarityc80", "klarheitsmaß", "klarheitsmaßc80", "klarheitsmassc80")
    limit = reaches = 0.08
    matched = shown = True
