"""The standard uncertainty of measured parameters, where it is not stated: theory and round robins."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rtcal.acoustics import bands
from rtcal.support.types import Array

OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
REPRODUCIBILITY: Mapping[str, tuple[float, ...]] = {
    "t20": (0.046, 0.036, 0.028, 0.022, 0.017, 0.013),
    "edt": (0.100, 0.080, 0.064, 0.051, 0.041, 0.033),
    "t30": (0.046, 0.036, 0.028, 0.022, 0.017, 0.013),
    "c80": (0.83, 0.70, 0.59, 0.49, 0.42, 0.35),
    "g": (2.0, 1.55, 1.20, 0.92, 0.72, 0.55),
}
"""Standard deviation between teams at one pair of positions, by octave from 125 Hz to 4 kHz: relative,
and in dB. Ends from the music studio of the PTB (round robin III, Bork 2005; medians over pairs),
geometric between them; T20 as T30. All pairs of a team have this error in common."""
ONE_DECAY: Mapping[str, float] = {"t20": 0.88, "t30": 0.55, "edt": 1.6}
"""Relative standard deviation of one decay's time, times sqrt(B T), B the bandwidth in Hz:
T20 and T30 as in ISO 3382-2, Eqs. 4 and 5. Decays of octave-filtered Gaussian noise (400 at 500 Hz
and 400 at 1 kHz, T = 1 s) have 0.88 for T20 and 1.7 for EDT."""
ISO_3382_2: Mapping[str, tuple[float, float]] = {"t20": (0.88, 1.90), "t30": (0.55, 1.52)}
"""a and b of ISO 3382-2:2008, Eqs. 4 and 5. The standard was not at hand; the numbers are those of RWTH
Aachen's ITA-Toolbox, ita_roomacoustics_uncertainty.m (P. Dietrich, 2009), which names EN ISO 3382."""
_DECAYS = 10  # ISO 3382-2, 6.2: an integrated impulse response counts as 10 averaged decays
LIMITS = {"c50": 0.05, "c80": 0.08}
"""End of the early sound in s."""


def between_teams(parameter: str, frequencies: Array) -> Array:
    """Return the standard deviation between teams, (n_bands,): relative, or in dB."""
    table = REPRODUCIBILITY[parameter]
    return np.asarray(np.interp(np.log(frequencies), np.log(OCTAVES), table))


def iso_3382_2(parameter: str, frequencies: Array, times: Array, positions: Array) -> Array:
    """Return the variance in s² of a mean T20 or T30 over positions, (n_bands,), by ISO 3382-2.

    sigma(T) = a T sqrt((1 + b/n) / (N B T)), N positions of n = 10 decays; B = 0.71 f in octaves and
    0.23 f in thirds. ``times`` in s and ``positions`` are (n_bands,).
    """
    a, b = ISO_3382_2[parameter]
    bandwidth = bands.bandwidth_factor(frequencies) * frequencies
    return np.asarray(a**2 * times * (1 + b / _DECAYS) / (np.maximum(positions, 1) * bandwidth))


def of_one_decay(parameter: str, frequencies: Array, times: Array) -> Array:
    """Return the standard deviation of one decay's parameter, as the field is noise.

    Relative for T20, T30 and EDT: `ONE_DECAY` / sqrt(B T).

    In dB for C50 and C80. In a window the energy of noise of bandwidth B has the relative variance
    1 / (B t), where t = (∫ e)² / ∫ e² of the decaying energy e. For the early sound of an exponential
    decay t is 2 (1 - a) / (k (1 + a)), for the late one 2 / k; k = 6 ln 10 / T, a = exp(-k t_early).

    Parameters
    ----------
    parameter : str
    frequencies : array (n_bands,)
        Centre frequencies in Hz.
    times : array (..., n_bands)
        Decay time in s.
    """
    bandwidth = bands.bandwidth_factor(frequencies) * frequencies
    with np.errstate(invalid="ignore"):
        if parameter in ONE_DECAY:
            return np.asarray(ONE_DECAY[parameter] / np.sqrt(bandwidth * times))
        rate = 6 * np.log(10) / times
        end = np.exp(-rate * LIMITS[parameter])
        variance = rate / (2 * bandwidth) * ((1 + end) / (1 - end) + 1)
        return np.asarray(10 / np.log(10) * np.sqrt(variance))
