"""D50."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.observables.base import DB, Observable, register
from rtcal.acoustics.observables.clarity import C50, divided, early_share
from rtcal.support.types import Array

_C50 = C50()
_HALF = 0.25 / DB
"""d D50 / d C50 where half of the energy is early: nowhere else it is larger."""


@register
class D50(Observable):
    """Definition: the share of the energy before 50 ms (ISO 3382-1:2009, A.11)."""

    key, label, rank = "d50", "D50", 60
    spellings = (
        "definition",
        "definitiond50",
        "deutlichkeitd50",
        "d",
        "deutlichkeit",
        "deutlichkeitsgrad",
        "deutlichkeitsgradd50",
    )
    unit = ""
    decimals = 2
    jnd = 0.05
    limits = 0.0, 1.0
    doubt = "is it in percent? D50 is a fraction"
    reaches = C50.limit
    rises = True
    teams = tuple(_HALF * x for x in C50.teams)
    unknown_error = _HALF * C50.unknown_error
    predicted = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the early share; NaN without energy."""
        early, late = divided(energy, bin_width, C50.limit)
        with np.errstate(invalid="ignore"):
            return np.asarray(early / (early + late))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return (share - D50) / sum of E, share the part of a bin before 50 ms."""
        share = early_share(energy.shape[-1], bin_width, C50.limit)
        total = energy.sum(-1, keepdims=True)
        return np.asarray((share - (energy @ share)[..., np.newaxis] / total) / total)

    def linear(self, values: Array, stated: Array) -> Array:
        """Return the relative change of the decay rate k of D50 = 1 - exp(-50 ms k)."""
        return np.asarray(np.log1p(-values) / np.log1p(-stated) - 1)

    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by D50."""
        return np.asarray(-1 / ((1 - values) * np.log1p(-stated)))

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return that of C50 times d D50 / d C50 = D50 (1 - D50) / DB, of an exponential decay."""
        with np.errstate(invalid="ignore"):
            late = np.exp(-6 * np.log(10) * C50.limit / times)
        return np.asarray(_C50.scatter(frequencies, times) * late * (1 - late) / DB)
