"""Energy decays: decay times, clarity, definition and centre time.

An energy decay is the energy per time bin, from the arrival of the direct sound on: a tracer's
histogram, or a squared impulse response (one bin per sample). Bins are the last axis; results keep
the shape of the axes before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.errors import DataError, TooShortError, of_bands
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array

RANGES: dict[str, tuple[float, float]] = {
    "edt": (0.0, -10.0),
    "t20": (-5.0, -25.0),
    "t30": (-5.0, -35.0),
}
"""Levels in dB between which each decay time is fitted (ISO 3382-1:2009, 5.3 and A.2.2)."""

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
    energy = _checked(energy)
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
    energy = _checked(energy)
    quarter = energy.shape[-1] // 4
    if quarter == 0:
        return np.full(energy.shape[:-1], np.inf)
    last = energy[..., -quarter:].sum(axis=-1)
    before = energy[..., -2 * quarter : -quarter].sum(axis=-1)
    falls = before > last
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = np.where(last == 0, 0.0, np.where(falls, last**2 / (before - last), np.inf))
        return np.asarray(10 * np.log10(beyond / energy.sum(axis=-1)))


@checked
def decay_time(energy: Array, bin_width: float, parameter: str = "t20") -> Array:
    """Return a decay time in s, (...): -60 dB over the slope of the decay curve within its range.

    Parameters
    ----------
    energy : array (..., n_bins)
        Energy per bin, 0 or more; the first bin starts with the direct sound.
    bin_width : float
        s.
    parameter : {"t20", "t30", "edt"}

    Returns
    -------
    array (...)
        NaN where the decay is `too_short`, or fewer than two points lie within the range.

    Raises
    ------
    DataError
        For an unknown parameter, energy that is negative or not finite, a width not above 0.

    References
    ----------
    ISO 3382-1:2009, 5.3.3 (line fitted by least squares).

    Examples
    --------
    >>> time = np.arange(20000) * 1e-4
    >>> print(decay_time(10 ** (-6 * time / 0.8), 1e-4).round(6))
    0.8
    """
    time = slope_time(decay_curve_db(energy), bin_width, parameter)
    return np.where(too_short(energy, parameter), np.nan, time)


@checked
def slope_time(level: Array, bin_width: float, parameter: str = "t20") -> Array:
    """Return -60 dB over the slope of a decay curve within a parameter's range, in s, (...).

    Parameters
    ----------
    level : array (..., n_bins)
        Decay curve in dB at the start of each bin; 0 at the direct sound.
    bin_width : float
        s.
    parameter : {"t20", "t30", "edt"}

    Returns
    -------
    array (...)
        NaN where fewer than two points lie within the range, or the curve does not fall.

    Raises
    ------
    DataError
        For an unknown parameter or a width not above 0.
    """
    _check_decay_time(parameter)
    width = _width(bin_width)
    upper, lower = RANGES[parameter]
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
    return np.where(holds, 60 * width * spread / np.where(holds, fall, 1.0), np.nan)


@checked
def too_short(energy: Array, parameter: str = "t20") -> NDArray[np.bool_]:
    """Return whether the decay is cut off too early to hold a decay time, (...)."""
    _check_decay_time(parameter)
    return np.asarray(cut_off_db(energy) > RANGES[parameter][1] - MARGIN_DB)


def _check_decay_time(parameter: str) -> None:
    if parameter not in RANGES:
        raise DataError(f'"{parameter}" is no decay time; known are {", ".join(RANGES)}')


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
    energy = _checked(energy)
    middle = (np.arange(energy.shape[-1]) + 0.5) * _width(bin_width)
    total = energy.sum(axis=-1)
    return _share(energy @ middle, total)


@checked
def parameters(
    energy: Array,
    bin_width: float,
    names: Sequence[str] = ("edt", "t20", "t30", "c50", "c80", "d50", "ts"),
) -> dict[str, Array]:
    """Return room-acoustic parameters by name, each (...), in the units of `Measurement`.

    NaN where the decay does not hold the parameter; see `decay_time`.
    """
    functions = {
        "c50": lambda: clarity(energy, bin_width, 0.05),
        "c80": lambda: clarity(energy, bin_width, 0.08),
        "d50": lambda: early_energy(energy, bin_width, 0.05),
        "ts": lambda: centre_time(energy, bin_width),
    }
    values = {}
    for name in names:
        if name not in RANGES and name not in functions:
            raise DataError(
                f'"{name}" is no parameter; known are {", ".join([*RANGES, *functions])}'
            )
        value = decay_time(energy, bin_width, name) if name in RANGES else functions[name]()
        values[name] = np.where(np.isfinite(value), value, np.nan)
    return values


@checked
def measurement(
    energy: Array,
    bin_width: float,
    centre_frequencies: Array,
    pairs: Sequence[tuple[str, str]],
    uncertainty: Mapping[str, Array] | None = None,
) -> Measurement:
    """Return the `Measurement` of energy decays (n_pairs, n_bands, n_bins).

    ``uncertainty`` states the standard uncertainty of parameters, by name, (n_pairs, n_bands).

    Raises
    ------
    TooShortError
        If a decay is cut off before it holds T20: a mean over the other pairs would hide it.
    DataError
        If a decay has no T20 at all, since nothing is reflected.
    """
    values = parameters(energy, bin_width)
    lost = np.isnan(values["t20"])
    if lost.any():
        short = too_short(energy)
        bad = lost & short if (lost & short).any() else lost
        pair, band = (int(i) for i in np.argwhere(bad)[0])
        where = f"{' to '.join(pairs[pair])}, {bands.label(np.asarray(centre_frequencies)[band])}"
        if short[pair, band]:
            raise TooShortError(
                f"the decay from {where} is too short to hold T20: {energy.shape[-1] * bin_width:.3g}"
                f" s end {max(0.0, -float(cut_off_db(energy)[pair, band])):.0f} dB down, "
                f"{-RANGES['t20'][1] + MARGIN_DB:.0f} dB are needed. The room is more reverberant "
                "than the decay is long: simulate longer"
            )
        error = DataError(f"the decay from {where} has no T20: too little is reflected")
        raise of_bands(error, np.flatnonzero(lost.any(axis=0)))
    return Measurement(
        centre_frequencies=np.asarray(centre_frequencies, dtype=float),
        values=values,
        pairs=pairs,
        uncertainty=uncertainty or {},
    )


def _divided(energy: Array, bin_width: float, limit: float) -> tuple[Array, Array]:
    """Energy before and after ``limit`` s; a bin that it divides counts in proportion.

    Both are summed, since the later energy as a difference could round to a value below 0.
    """
    energy = _checked(energy)
    position = min(checks.positive("limit", limit, "s") / _width(bin_width), energy.shape[-1])
    share = np.clip(position - np.arange(energy.shape[-1]), 0.0, 1.0)
    return energy @ share, energy @ (1 - share)


def _share(part: Array, total: Array) -> Array:
    blank = np.full(np.shape(total), np.nan)
    return np.asarray(np.divide(part, total, out=blank, where=total > 0))


def _checked(energy: Array) -> Array:
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


def _width(bin_width: float) -> float:
    return checks.positive("bin_width", bin_width, "s")
