"""Ts."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.decay_times import EDT, Relative
from rtcal.support.types import Array


@register
class Ts(Relative):
    """Centre time: the energy's centre of gravity in s (ISO 3382-1:2009, A.13)."""

    key, label, rank = "ts", "Ts", 70
    spellings = ("centretime", "centertime", "schwerpunktzeit")
    jnd = 0.010
    # Ts of an exponential decay is T / 13.8: 8.7 s for T = 120 s.
    limits = 0.0, 10.0
    doubt = "is it in ms?"
    # Ts of T = 0.05 s and of T = 28 s.
    usual = 0.0036, 2.0
    teams = EDT.teams
    matched = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the centre time in s; NaN without energy."""
        middle = (np.arange(energy.shape[-1]) + 0.5) * bin_width
        with np.errstate(invalid="ignore"):
            return np.asarray(energy @ middle / energy.sum(axis=-1))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return d ln Ts / d E_k = k / sum(E k) - 1 / sum(E)."""
        k = np.arange(energy.shape[-1]) + 0.5
        return np.asarray(k / (energy @ k)[..., np.newaxis] - 1 / energy.sum(-1, keepdims=True))

    def decay_time(self, values: Array) -> Array:
        """Return 6 ln 10 Ts."""
        return np.asarray(values * (6 * np.log(10)))
