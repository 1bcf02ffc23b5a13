"""STI."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from rtcal.acoustics.observables.base import DB, Observable, register
from rtcal.acoustics.observables.decay_times import EDT
from rtcal.support.types import Array

MODULATIONS = np.array([0.63, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5])
"""Modulation frequencies in Hz (IEC 60268-16:2020, A.2.2)."""
_OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
_WEIGHTS = np.array([0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173])
_REDUNDANCY = np.array([0.085, 0.078, 0.065, 0.011, 0.047, 0.095])
"""Octave weights alpha, and beta of neighbours (IEC 60268-16:2011, Table A.3, male speech)."""
_RANGE = 15.0
"""Signal-to-noise ratios in dB beyond which speech is not understood better or worse."""
_BY_LN_T = 0.2
"""Largest change of STI by ln T of an exponential decay."""


@register
class STI(Observable):
    """Speech transmission index, noise-free, by the indirect method (IEC 60268-16:2020, 5.3.2 and A.5).

    In one octave it is the modulation transfer index, the mean transmission index over the modulation
    frequencies; `overall` is the STI of all octaves. Masking and noise are not in it: speech in a
    noisy room is understood less well than it says.
    """

    key, label, rank = "sti", "STI", 65
    spellings = ("speechtransmissionindex", "mti", "modulationtransferindex")
    unit = ""
    decimals = 2
    jnd = 0.03  # Bradley, Reich and Norcross 1999
    limits = 0.0, 1.0
    doubt = "is it in percent? STI is a fraction"
    rises = True
    teams = tuple(_BY_LN_T * x for x in EDT.teams)
    unknown_error = jnd / 2
    predicted = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the mean transmission index; NaN without energy."""
        return np.asarray(_index(np.abs(_transfer(energy, bin_width))).mean(-1))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return d STI / d E_j = mean of d TI / d m (Re(m* w_j) / |m| - |m|) over F, over sum(E)."""
        ratio = _transfer(energy, bin_width)
        waves = np.stack([_wave(f, energy.shape[-1], bin_width) for f in MODULATIONS])
        m = np.abs(ratio)
        by_ratio = _slope(m) / len(MODULATIONS)
        wave = ((by_ratio / m * np.conj(ratio)) @ waves).real
        rest = np.sum(by_ratio * m, axis=-1, keepdims=True)
        return np.asarray((wave - rest) / energy.sum(-1, keepdims=True))

    def linear(self, values: Array, stated: Array) -> Array:
        """Return the relative change of the rate k of an exponential decay with this STI."""
        return np.asarray(self._rate(values) / self._rate(stated) - 1)

    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by STI."""
        logarithms, table = self._table
        at = np.log(self._rate(values))
        by_logarithm = np.interp(at, logarithms, np.gradient(table, logarithms))
        return np.asarray(self._rate(values) / (by_logarithm * self._rate(stated)))

    def overall(self, values: Array, frequencies: Array) -> Array:
        """Return the STI of all octaves from 125 Hz to 8 kHz, (...); NaN if one is missing.

        Sum of alpha_k M_k - sum of beta_k sqrt(M_k M_k+1) (IEC 60268-16:2011, A.5.6), M by octave.

        Examples
        --------
        >>> octaves = np.array([125, 250, 500, 1000, 2000, 4000, 8000])
        >>> print(STI().overall(np.full(7, 0.6), octaves).round(3))
        0.6
        """
        listed = np.asarray(frequencies, dtype=float).tolist()
        if not set(_OCTAVES) <= set(listed):
            return super().overall(values, frequencies)
        m = np.asarray(values, dtype=float)[..., [listed.index(f) for f in _OCTAVES]]
        return np.asarray(m @ _WEIGHTS - np.sqrt(m[..., :-1] * m[..., 1:]) @ _REDUNDANCY)

    def _rate(self, values: Array) -> Array:
        """Return the k in 1/s of an exponential decay with this STI."""
        logarithms, table = self._table
        return np.asarray(np.exp(np.interp(values, table, logarithms)))

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Ln of the rates in 1/s and STI of exponential decays, T from 0.005 to 200 s: both rise.

        m = 1 / sqrt(1 + (2 pi F / k)²) (Houtgast and Steeneken 1973).
        """
        logarithms = np.linspace(np.log(0.06), np.log(3000.0), 4000)
        angle = 2 * np.pi * MODULATIONS / np.exp(logarithms)[:, np.newaxis]
        table = _index(1 / np.sqrt(1 + angle**2)).mean(-1)
        # Beyond the range of ratios it is flat: kept rising, so that it has an inverse.
        return logarithms, np.asarray(table + 1e-9 * np.arange(len(table)))


def _transfer(energy: Array, bin_width: float) -> Array:
    """Return the complex modulation transfer, (..., n_modulations).

    m(F) = sum E exp(-2 pi i F t) / sum E (Schroeder 1981), t the middle of each bin. The frequencies
    are taken one by one, since a response has a million bins.
    """
    n_bins = np.shape(energy)[-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.asarray(energy).sum(-1)
        each = [energy @ _wave(f, n_bins, bin_width) / total for f in MODULATIONS]
    return np.stack(each, axis=-1)


def _wave(frequency: float, n_bins: int, bin_width: float) -> Array:
    """Return exp(-2 pi i F t) at the middle of each bin, (n_bins,)."""
    return np.asarray(np.exp(-2j * np.pi * frequency * (np.arange(n_bins) + 0.5) * bin_width))


def _index(m: Array) -> Array:
    """Return the transmission index of a modulation transfer, 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 10 * np.log10(m / (1 - m))
    return np.asarray((np.clip(ratio, -_RANGE, _RANGE) + _RANGE) / (2 * _RANGE))


def _slope(m: Array) -> Array:
    """Return d index / d m; 0 where the ratio is cut off."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.abs(10 * np.log10(m / (1 - m))) < _RANGE
        return np.asarray(np.where(inside, DB / (2 * _RANGE) / (m * (1 - m)), 0.0))
