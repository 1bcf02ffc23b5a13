"""Energy decays: the decay curve, its slope, and the energy before and after a time.

An energy decay is the energy per time bin, from the arrival of the direct sound on: a tracer's
histogram, or a squared impulse response (one bin per sample). Bins are the last axis; results keep
the shape of the axes before it. Searches call these functions many thousand times: `checked_decay`
checks a decay once, where it comes in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MARGIN_DB = 15.0
"""Least distance in dB from a range's lower end down to the truncation. Truncating an exponential decay
there lowers T20 by 0.4 %."""

MAX_BIN = 0.01
"""Largest bin width of a simulator in s; five such bins fill the 50 ms of C50."""


def bins(bin_width: float) -> float:
    """Return a simulator's bin width in s; DataError unless above 0 and at most `MAX_BIN`."""
    if checks.positive("bin_width", bin_width, "s") > MAX_BIN:
        raise DataError(f"bin_width = {bin_width:g} s is more than {MAX_BIN:g} s, too wide for C50")
    return float(bin_width)


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


def slope_time(level: Array, bin_width: float, upper: float, lower: float) -> Array:
    """Return -60 dB over the slope of a decay curve between two levels, in s, (...).

    Parameters
    ----------
    level : array (..., n_bins)
        Decay curve in dB at the start of each bin; 0 at the direct sound.
    bin_width : float
        s.
    upper, lower : float
        The range in dB.

    Returns
    -------
    array (...)
        NaN where fewer than two points lie within the range, or the curve does not fall.
    """
    with np.errstate(invalid="ignore"):
        within = (level <= upper) & (level >= lower)
    k = np.arange(level.shape[-1], dtype=float)
    n = within.sum(axis=-1)
    many = np.maximum(n, 1)
    centred_k = np.where(within, k - (np.where(within, k, 0).sum(-1) / many)[..., np.newaxis], 0.0)
    y = np.where(within, level, 0.0)
    spread = np.sum(centred_k**2, axis=-1)
    fall = -np.sum(centred_k * y, axis=-1)
    holds = (n >= 2) & (fall > 0)
    return np.where(holds, 60 * bin_width * spread / np.where(holds, fall, 1.0), np.nan)


def decay_time(energy: Array, bin_width: float, upper: float, lower: float) -> Array:
    """Return `slope_time` of energy decays, NaN where one `ends_above` the lower level too, (...)."""
    time = slope_time(decay_curve_db(energy), bin_width, upper, lower)
    return np.where(ends_above(energy, lower), np.nan, time)


def ends_above(energy: Array, level: float) -> NDArray[np.bool_]:
    """Return whether a decay is cut off less than `MARGIN_DB` below a level in dB, (...)."""
    return np.asarray(cut_off_db(energy) > level - MARGIN_DB)


def early_energy(energy: Array, bin_width: float, limit: float) -> Array:
    """Return the share of the energy within ``limit`` s of the direct sound, (...), 0 to 1.

    A bin that the limit divides counts in proportion.
    """
    early, late = _divided(energy, bin_width, limit)
    return _share(early, early + late)


def clarity(energy: Array, bin_width: float, limit: float) -> Array:
    """Return C50 (``limit`` 0.05 s) or C80 (0.08 s) in dB, (...): 10 lg(early / late).

    ISO 3382-1:2009, A.10. Infinite where nothing comes after the limit, NaN without any energy.
    """
    early, late = _divided(energy, bin_width, limit)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10 * np.log10(early / late))


def centre_time(energy: Array, bin_width: float) -> Array:
    """Return Ts in s, (...): the energy's centre of gravity (ISO 3382-1:2009, A.13)."""
    middle = (np.arange(energy.shape[-1]) + 0.5) * bin_width
    total = energy.sum(axis=-1)
    return _share(energy @ middle, total)


def _divided(energy: Array, bin_width: float, limit: float) -> tuple[Array, Array]:
    """Energy before and after ``limit`` s; a bin that it divides counts in proportion.

    Both are summed, since the later energy as a difference could round to a value below 0.
    """
    position = min(limit / bin_width, energy.shape[-1])
    share = np.clip(position - np.arange(energy.shape[-1]), 0.0, 1.0)
    return energy @ share, energy @ (1 - share)


def _share(part: Array, total: Array) -> Array:
    blank = np.full(np.shape(total), np.nan)
    return np.asarray(np.divide(part, total, out=blank, where=total > 0))


def checked_decay(energy: Array, bin_width: float = 1.0) -> Array:
    """Return energy decays (..., n_bins), of bins in s; DataError for what is none."""
    checks.positive("bin_width", bin_width, "s")
    energy = checks.array("energy", energy)
    if energy.ndim == 0 or energy.shape[-1] == 0:
        raise DataError(
            f"energy has shape {energy.shape}; it needs at least one bin, on its last axis"
        )
    if (bad := ~np.isfinite(energy) | (energy < 0)).any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise DataError(
            f"energy{list(where)} = {energy[where]:g} is not a finite value of 0 or more"
        )
    return energy
