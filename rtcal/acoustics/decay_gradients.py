"""Derivatives of room-acoustic parameters with respect to the energy in each bin of a decay.

A simulator that knows how each bin's energy changes with a coefficient gets the change of every
parameter from them by one sum over the bins. Decay times and Ts are taken as logarithms, so that
equal relative changes are equal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.decay import RANGES, decay_curve_db, slope_time
from rtcal.errors import DataError
from rtcal.support.arguments import checked
from rtcal.support.types import Array

DB = 10 / np.log(10)
LIMITS = {"c50": 0.05, "c80": 0.08}
"""End of the early sound in s."""
PARAMETERS = (*RANGES, *LIMITS, "ts", "level")
"""Parameters that have derivatives: ln T20, ln T30, ln EDT and ln Ts; C50, C80 and level in dB."""


@checked
def gradients(energy: Array, bin_width: float, parameters: Sequence[str]) -> Array:
    """Return d parameter / d energy of each bin, (n_parameters, ..., n_bins).

    A decay time jumps a little where a bin enters its range of levels; the derivative is that of the
    mean over the jumps.

    Parameters
    ----------
    energy : array (..., n_bins)
        Energy per bin, 0 or more; the first bin starts with the direct sound.
    bin_width : float
        s.
    parameters : sequence of str
        Of `PARAMETERS`.

    Returns
    -------
    array (n_parameters, ..., n_bins)
        In 1 or dB over the unit of ``energy``; NaN where the decay lacks the parameter.

    Raises
    ------
    DataError
        For an unknown parameter, energy that is negative or not finite, a width not above 0.

    Examples
    --------
    >>> decay = 10 ** (-6 * np.arange(1000) * 0.001 / 0.5)
    >>> gradient = gradients(decay, 0.001, ["level"])
    >>> print((gradient @ decay).round(3))  # 1 % more energy is 0.043 dB more
    [4.343]
    """
    level = decay_curve_db(energy)
    energy = np.asarray(energy, dtype=float)
    out = np.empty((len(parameters), *energy.shape))
    for row, name in zip(out, parameters, strict=True):
        if name not in PARAMETERS:
            raise DataError(f'"{name}" has no derivative; those that do: {", ".join(PARAMETERS)}')
        with np.errstate(divide="ignore", invalid="ignore"):
            if name in RANGES:
                row[:] = _of_decay_time(energy, level, bin_width, name)
            elif name in LIMITS:
                row[:] = _of_clarity(energy, bin_width, LIMITS[name])
            elif name == "ts":
                k = np.arange(energy.shape[-1]) + 0.5
                row[:] = k / (energy @ k)[..., np.newaxis] - 1 / energy.sum(-1, keepdims=True)
            else:
                row[:] = DB / energy.sum(-1, keepdims=True)
    return out


def _of_decay_time(energy: Array, level: Array, bin_width: float, name: str) -> Array:
    """Return d ln T / d E_j.

    T is -60 / slope, the slope that of the regression of L_k = DB ln(B_k / B_0) on k within the
    range, with B_k the energy from bin k on. So d ln T = -sum c_k dL_k / (slope sum c_k²), where c_k
    is k less its mean. The range's ends move too: at an end that lies r off the line, points enter
    or leave at the rate of dL / slope bins, and each has the weight c r / (slope sum c_k²).
    """
    upper, lower = RANGES[name]
    within = (level <= upper) & (level >= lower)
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
    if upper < 0:  # the curve begins at 0 dB, whatever the energy
        by_level -= np.where(k == first, leverage, 0.0)
    left = np.flip(np.cumsum(np.flip(energy, -1), axis=-1), -1)
    share = np.where(within, by_level / np.where(left > 0, left, 1.0), 0.0)
    whole = by_level.sum(-1, keepdims=True) / left[..., :1]
    gradient = DB * (np.cumsum(share, axis=-1) - whole)
    return np.where(np.isnan(slope_time(level, bin_width, name))[..., np.newaxis], np.nan, gradient)


def _of_clarity(energy: Array, bin_width: float, limit: float) -> Array:
    """Return DB (share / early - (1 - share) / late), share the part of a bin before the limit."""
    share = np.clip(limit / bin_width - np.arange(energy.shape[-1]), 0.0, 1.0)
    early, late = energy @ share, energy @ (1 - share)
    return np.asarray(DB * (share / early[..., np.newaxis] - (1 - share) / late[..., np.newaxis]))
