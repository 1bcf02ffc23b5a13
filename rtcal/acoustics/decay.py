"""Energy decays: decay times, clarity, definition and centre time.

An energy decay is the energy per time bin, from the arrival of the direct sound on: a tracer's
histogram, or a squared impulse response (one bin per sample). Bins are the last axis; results keep
the shape of the axes before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MARGIN_DB as MARGIN_DB
from rtcal.acoustics.observables import (
    OBSERVABLES,
    TARGET,
    Observable,
    observable,
)
from rtcal.acoustics.observables import cut_off_db as cut_off_db
from rtcal.acoustics.observables import decay_curve_db as decay_curve_db
from rtcal.support import checks
from rtcal.support.errors import DataError, TooShortError, of_bands
from rtcal.support.types import Array

__all__ = ["gradients", "measurement", "parameters"]
__dir__ = __all__.copy


MAX_BIN = 0.01
"""Largest bin width of a simulator in s; five such bins fill the 50 ms of C50."""


def bins(bin_width: float) -> float:
    """Return a simulator's bin width in s; DataError unless above 0 and at most `MAX_BIN`."""
    if checks.positive("bin_width", bin_width, "s") > MAX_BIN:
        raise DataError(f"bin_width = {bin_width:g} s is more than {MAX_BIN:g} s, too wide for C50")
    return float(bin_width)


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


def parameters(
    energy: Array, bin_width: float, names: Sequence[str] | None = None
) -> dict[str, Array]:
    """Return room-acoustic parameters by name, each (...), in the units of `Measurement`.

    By default all that a response holds without a calibrated source. NaN where the decay does not hold
    the parameter.

    Parameters
    ----------
    energy : array (..., n_bins)
        Energy per bin, 0 or more; the first bin starts with the direct sound.
    bin_width : float
        s.
    names : sequence of str
        Keys of `rtcal.acoustics.observables.OBSERVABLES`.

    Raises
    ------
    DataError
        For an unknown parameter, energy that is negative or not finite, a width not above 0.

    Examples
    --------
    >>> time = np.arange(20000) * 1e-4
    >>> print(parameters(10 ** (-6 * time / 0.8), 1e-4)["t20"].round(6))
    0.8
    """
    if names is None:
        names = [key for key, o in OBSERVABLES.items() if o.minimum_range is not None]
    energy = checked_decay(energy, bin_width)
    values = {o.key: o.value(energy, bin_width) for o in _observables(names)}
    return {name: np.where(np.isfinite(v), v, np.nan) for name, v in values.items()}


def gradients(energy: Array, bin_width: float, parameters: Sequence[str]) -> Array:
    """Return d parameter / d energy of each bin, (n_parameters, ..., n_bins).

    Of what is observed: decay times and Ts are taken as logarithms, so that equal relative changes are
    equal. A decay time jumps a little where a bin enters its range of levels; the derivative is that of
    the mean over the jumps.

    Parameters and errors are those of `parameters`. The unit is 1 or dB over that of ``energy``; NaN
    where the decay lacks the parameter.

    Examples
    --------
    >>> decay = 10 ** (-6 * np.arange(1000) * 0.001 / 0.5)
    >>> gradient = gradients(decay, 0.001, ["level"])
    >>> print((gradient @ decay).round(3))  # 1 % more energy is 0.043 dB more
    [4.343]
    """
    energy = checked_decay(energy, bin_width)
    level = decay_curve_db(energy)
    out = np.empty((len(parameters), *energy.shape))
    for row, kind in zip(out, _observables(parameters), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            row[:] = kind.gradient(energy, level, bin_width)
    return out


def _observables(names: Sequence[str]) -> list[Observable]:
    """Return observables by their keys; DataError for a name that is none."""
    return [OBSERVABLES[name] if name in OBSERVABLES else observable(name) for name in names]


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
    energy = checks.array("energy", energy)
    if energy.ndim != 3:
        raise DataError(f"energy has shape {energy.shape}, not (n_pairs, n_bands, n_bins)")
    values = parameters(energy, bin_width)
    lost = np.isnan(values[TARGET.key])
    if lost.any():
        short = TARGET.too_short(energy)
        bad = lost & short if (lost & short).any() else lost
        pair, band = (int(i) for i in np.argwhere(bad)[0])
        where = f"{' to '.join(pairs[pair])}, {bands.label(np.asarray(centre_frequencies)[band])}"
        if short[pair, band]:
            down = max(0.0, -float(cut_off_db(energy)[pair, band]))
            raise TooShortError(
                f"the decay from {where} is too short to hold {TARGET.label}: "
                f"{energy.shape[-1] * bin_width:.3g} s end {down:.0f} dB down, "
                f"{MARGIN_DB - TARGET.lower:.0f} dB are needed. The room is more reverberant "
                "than the decay is long: simulate longer"
            )
        error = DataError(f"the decay from {where} has no {TARGET.label}: too little is reflected")
        raise of_bands(error, np.flatnonzero(lost.any(axis=0)))
    return Measurement(
        centre_frequencies=np.asarray(centre_frequencies, dtype=float),
        values=values,
        pairs=pairs,
        uncertainty=uncertainty or {},
    )
