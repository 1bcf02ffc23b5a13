"""Observables: room-acoustic parameters at a position, by band, that readers and fits share.

A new observable is one class. It registers itself in `OBSERVABLES`, where files, tables, impulse
responses, simulators, calibrations, finders, pages and checks look it up: its value from an energy
decay, its derivative, the scale on which it is linear in the absorption, its JND, its uncertainty, its
unit, its limits and its names. docs/extending.md adds one from outside.

An energy decay is the energy per time bin, from the arrival of the direct sound on: a tracer's
histogram, or a squared impulse response (one bin per sample). Bins are the last axis; results keep the
shape of the axes before it.

Three scales belong to an observable. Its values have its unit. What is *observed* is nearly linear in
alpha: the logarithm of a time, or the value itself. And one function of what is observed is linear in
the room's absorption.

Examples
--------
>>> print(observable("c80").label, isinstance(observable("t20"), DecaySlope), TARGET.key)
C80 True t20
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Iterable, Sequence
from functools import cached_property
from operator import attrgetter
from typing import ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.bands import ITSELF, Scale
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["MATCH", "OBSERVABLES", "Observable", "observable", "register"]
__dir__ = __all__.copy

DB = 10 / np.log(10)
"""Decibels per neper of energy."""
OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""Centre frequencies in Hz of the values in `Observable.teams`."""
_STEP = 1e-5
"""Relative step of a derivative by differences, whose error is its square."""
_BINS = 4000
"""Bins of the exponential decay that stands for a noise-like response, over twice its T."""

_DECAYS = 10
"""Decays that an integrated impulse response counts as (ISO 3382-2:2008, 6.2)."""


Part = Literal["late", "early", "level"]


class Observable(ABC):
    """Room-acoustic parameter, such as T20 or C80, and its calculation from an energy decay.

    An energy decay is the energy in each time bin. The methods use an "observed quantity", which is
    nearly linear in the absorption coefficients and has normal errors: ln T for T20, T30 and EDT, ln Ts
    for Ts, and the value itself for any other parameter.
    """

    key: ClassVar[str]
    """Name of the parameter in files, in JSON and in Python, such as "t20"."""
    label: ClassVar[str]
    """Name of the parameter as it is printed, such as "T20"."""
    spellings: ClassVar[str] = ""
    """Names in tables of other programs, in lower case without spaces, separated by blanks."""
    unit: ClassVar[str]
    """Unit of the value, such as "s"; "" without one."""
    decimals: ClassVar[int]
    """Number of decimals with which the value is printed."""
    rank: ClassVar[int]
    """Place in lists of parameters, the smallest first."""
    jnd: ClassVar[float]
    """Just noticeable difference: a share of the value if `relative_jnd` is True, else in its unit."""
    relative_jnd: ClassVar[bool] = False
    """Whether `jnd` is a share of the value; else it has the value's unit."""
    limits: ClassVar[tuple[float, float]]
    """Least and largest value that is accepted; ``doubt`` names the likely mistake beyond them."""
    doubt: ClassVar[str]
    """Words on the likely mistake behind a value beyond `limits`."""
    simulated: ClassVar[tuple[float, float] | None] = None
    """Limits in place of ``limits`` for a `Measurement` with simulated values."""
    usual: ClassVar[tuple[float, float]] = (-np.inf, np.inf)
    """Least and largest value of nearly all rooms; a value beyond them is read with a warning."""
    minimum_range: ClassVar[float | None] = 20.0
    """Impulse-to-noise ratio in dB that an impulse response needs for the parameter. None if a response
    alone does not suffice, because the level needs a calibrated source."""
    reaches: ClassVar[float] = 0.0
    """Time in s; a response must be longer to have the parameter."""
    logarithmic: ClassVar[bool] = False
    """Whether the observed quantity is the logarithm of the value (with a relative uncertainty)."""
    rises: ClassVar[bool] = False
    """Whether the value rises with the absorption."""
    part: ClassVar[Part] = "early"
    """Part of the decay that determines the value. Absorption near a position differs between parts."""
    teams: ClassVar[tuple[float, ...]]
    """Standard deviation of the observed quantity between teams at one pair, by `OCTAVES`."""
    unknown_error: ClassVar[float]
    """Standard deviation of a simulator's error that reference simulations do not show, in the observed
    quantity."""
    remeasured: ClassVar[float] = 0.01
    """Standard deviation of the observed quantity, common to all pairs of a band, when an unchanged
    room is measured again."""
    matched: ClassVar[bool] = False
    """Whether a calibration at positions matches the parameter by default."""
    predicted: ClassVar[bool] = False
    """Whether it is predicted at positions by default, in addition to those that are matched."""
    shown: ClassVar[bool] = False
    """Whether a closed loop on mean values prints it, and a simulator states its noise."""
    label_of_band: ClassVar[str] = ""
    """Name of the value in one band, if it is not the parameter's."""
    stand_in: ClassVar[str | None] = None
    """Key of the parameter that is used instead where this one was not measured."""
    averaging: ClassVar[Scale] = ITSELF
    """Quantity whose mean over third-octaves gives the octave's value."""

    @abstractmethod
    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the parameter's value for each energy decay, (...); NaN if a decay gives none.

        ``energy`` (..., n_bins) is the energy in time bins of the width ``bin_width`` in s.
        """

    @abstractmethod
    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of the observed quantity by the energy of each time bin, (..., n_bins).

        ``energy`` (..., n_bins) is the energy decay. ``level`` (..., n_bins) is its decay curve in dB,
        as `decay_curve_db` returns it. ``bin_width`` is the width of a time bin in s.
        """

    @abstractmethod
    def rate(self, observed: Array) -> Array:
        """Return a quantity, such as -1 / T, that is linear in the absorption area in a diffuse field.

        It rises with the observed quantity, such as ln T, of which ``observed`` are values.
        """

    def linear(self, observed: Array, stated: Array) -> Array:
        """Return the relative deviation of the quantity `rate` from its value at a reference.

        ``observed`` are values of the observed quantity, such as ln T, and ``stated`` is its value at
        the reference. In a diffuse field the size of the result is the relative change of the
        absorption area: for T it is 1 - T_ref / T.
        """
        at = self.rate(stated)
        return np.asarray((self.rate(observed) - at) / np.abs(at))

    def linear_slope(self, observed: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by the observed quantity, from small differences.

        ``observed`` and ``stated`` are the arguments of `linear`.
        """
        step = _STEP * np.maximum(np.abs(observed), 0.1)
        rise = self.rate(observed + step) - self.rate(observed - step)
        return np.asarray(rise / (2 * step * np.abs(self.rate(stated))))

    def too_short(self, energy: Array) -> NDArray[np.bool_]:
        """Return whether energy decays (..., n_bins) are too short for the parameter, (...) of bool."""
        return np.zeros(np.shape(energy)[:-1], dtype=bool)

    def key_in(self, values: Container[str]) -> str:
        """Return the key under which ``values``, a table by parameter, has this parameter.

        The key is `stand_in` (for the relative level: G) if the table lacks the parameter's own key.
        """
        return self.key if self.stand_in is None or self.key in values else self.stand_in

    def observed(self, values: Array) -> Array:
        """Return the observed quantity for values, such as ln T for T; NaN without a logarithm."""
        if not self.logarithmic:
            return values
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.log(values))

    def natural(self, observed: Array) -> Array:
        """Return the values for the observed quantity, such as T for ln T (inverse of `observed`)."""
        return np.asarray(np.exp(observed)) if self.logarithmic else observed

    def of_observed(self, uncertainty: Array, values: Array) -> Array:
        """Return the standard uncertainty of the observed quantity from that of ``values``.

        For a decay time T, whose observed quantity is ln T, it is ``uncertainty`` / T.
        """
        return np.asarray(uncertainty / values) if self.logarithmic else uncertainty

    def of_value(self, uncertainty: Array, values: Array) -> Array:
        """Return the standard uncertainty of ``values`` from that of the observed quantity.

        For a decay time T, whose observed quantity is ln T, it is ``uncertainty`` times T.
        """
        return np.asarray(uncertainty * values) if self.logarithmic else uncertainty

    def jnd_of(self, values: Array) -> Array | float:
        """Return one just noticeable difference (JND) of values, in their unit."""
        return self.jnd * values if self.relative_jnd else self.jnd

    def decay_time(self, values: Array) -> Array:
        """Return T in s of the exponential decay that has these values; NaN if unknown."""
        return np.full(np.shape(values), np.nan)

    def between_teams(self, frequencies: Array) -> Array:
        """Return by how much teams that measure the same room and pair differ, (n_bands,).

        The values are standard deviations, of the logarithm for decay times and Ts, and of the
        parameter itself for all others. ``frequencies`` (n_bands,) are in Hz; between octaves the
        values are interpolated.
        """
        return np.asarray(np.interp(np.log(frequencies), np.log(OCTAVES), self.teams))

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the standard deviation of the observed quantity in one response of decaying noise.

        In a band of bandwidth B the energy of a time bin of width w has the relative variance 1 / (B
        w). ``frequencies`` (n_bands,) are in Hz, ``times`` (..., n_bands) are the decay times T in s.
        """
        times = np.asarray(times, dtype=float)
        bandwidth = np.broadcast_to(bands.bandwidth_factor(frequencies) * frequencies, times.shape)
        decay = 10.0 ** (-12 * np.arange(_BINS) / _BINS)
        out = np.full(times.shape, np.nan)
        for place in zip(*np.nonzero(np.isfinite(times)), strict=True):
            width = 2 * float(times[place]) / _BINS
            energy = decay / decay.sum()
            level = 10 * np.log10(np.flip(np.cumsum(np.flip(energy))))
            by_bin = self.gradient(energy, level - level[0], width) * energy
            out[place] = np.sqrt(by_bin @ by_bin / (bandwidth[place] * width))
        return out

    def overall(self, values: Array, frequencies: Array) -> Array:
        """Return the single-number value of a parameter from its values by band, such as the STI.

        ``values`` are (..., n_bands), ``frequencies`` (n_bands,) are in Hz. The result is (...), NaN
        for a parameter without a single-number value.
        """
        return np.full(np.shape(values)[:-1], np.nan)

    def variance_of_mean(
        self, frequencies: Array, mean: Array, positions: Array, decays: int = _DECAYS
    ) -> Array:
        """Return the theoretical variance of a mean over positions, (n_bands,).

        It is NaN for parameters other than T20 and T30; see `DecaySlope.variance_of_mean`.
        ``frequencies`` are in Hz, ``mean`` is the mean in the parameter's unit, and ``positions`` the
        number of positions, (n_bands,) each. ``decays`` is the number of decays per position.
        """
        return np.full(np.shape(mean), np.nan)

    @property
    def rule(self) -> str:
        """Words for error messages: which values are accepted, and the likely mistake beyond them.

        Examples
        --------
        >>> observable("d50").rule
        'from 0 to 1; D50 is a fraction, not a percentage'
        """
        unit = f" {self.unit}".rstrip()
        return f"from {self.limits[0]:g} to {self.limits[1]:g}{unit}; {self.doubt}"

    def broken(self, values: Array) -> NDArray[np.bool_]:
        """Return True for values that a `Measurement` does not accept, allowing for rounding."""
        least, most = self.simulated or self.limits
        with np.errstate(invalid="ignore"):
            return np.asarray((values < least) | (values > most * (1 + 1e-9)))

    def largest_uncertainty(self, values: Array) -> Array:
        """Return the largest uncertainty that is accepted for each value: the range of `limits`."""
        least, most = self.limits
        return np.full(np.shape(values), most - least)

    def refuse(self, place: str, value: float) -> None:
        """Raise DataError, which names ``place``, for a value that no room can have. NaN is valid."""
        least, most = self.limits
        if not (np.isnan(value) or least <= value <= most * (1 + 1e-9)):
            unit = f" {self.unit}".rstrip()
            raise DataError(f"{place} = {value:g}{unit} must be {self.rule}")


OBSERVABLES: dict[str, Observable] = {}
"""Room-acoustic parameters by their keys, in the order in which they are listed."""

O = TypeVar("O", bound=Observable)  # noqa: E741


def register(kind: type[O]) -> type[O]:
    """Add a room-acoustic parameter, the class ``kind``, to `OBSERVABLES` (a class decorator).

    Raises
    ------
    DataError
        If another class has the key, ``teams`` (standard deviations between measuring teams) has not
        one value for each octave from 125 Hz to 4 kHz, or ``gradient`` is not the derivative of the
        observed quantity.
    """
    new: Observable = kind()
    place = f'observable "{new.key}"'
    old = type(OBSERVABLES.get(new.key, new))
    if (old.__module__, old.__qualname__) != (kind.__module__, kind.__qualname__):
        raise DataError(
            f"{place}: {old.__qualname__} already has this key; give each observable a key of "
            "its own"
        )
    if len(new.teams) != len(OCTAVES):
        octaves = ", ".join(f"{f:g}" for f in OCTAVES)
        raise DataError(
            f"{place}: teams has {len(new.teams)} values; give one for each of {octaves} Hz"
        )
    if kind.__module__ != __name__:  # tests check the package's own
        _check_gradient(new)
    every = [*(o for o in OBSERVABLES.values() if o.key != new.key), new]
    OBSERVABLES.clear()
    OBSERVABLES.update({o.key: o for o in sorted(every, key=lambda o: o.rank)})
    return kind


def _check_gradient(observable: Observable) -> None:
    """Raise DataError unless `Observable.gradient` is the derivative of the observed quantity.

    The derivative is compared with differences in an exponential decay with T = 1 s in 200 bins of 10
    ms, in which the energy of each bin is changed by 1e-6 and by -1e-6 of it. Deviations above 1 % of
    the largest derivative are errors.
    """
    width, step = 0.01, 1e-6
    energy = np.exp(-13.8 * width * np.arange(200.0))
    left = np.flip(np.cumsum(np.flip(energy)))
    stated = np.asarray(observable.gradient(energy, 10 * np.log10(left / left[0]), width)) * energy
    up, down = (
        observable.observed(observable.value(energy * (1 + sign * step * np.eye(200)), width))
        for sign in (1, -1)
    )
    found = (up - down) / (2 * step)
    k = int(np.argmax(np.abs(stated - found)))
    if not abs(stated[k] - found[k]) <= 0.01 * np.abs(found).max():
        raise DataError(
            f'observable "{observable.key}": gradient by the energy of the time bin at '
            f"{width * k:g} s = {stated[k] / energy[k]:g}, but if this energy changes a little, "
            f"{'ln value' if observable.logarithmic else 'value'} changes by "
            f"{found[k] / energy[k]:g} per unit of energy. Correct the method gradient, or value"
        )


def observable(key: str) -> Observable:
    """Return the room-acoustic parameter with this key; DataError for an unknown key.

    Examples
    --------
    >>> observable("ts").label, observable("ts").unit
    ('Ts', 's')
    """
    if not isinstance(key, str) or key not in OBSERVABLES:
        raise DataError(f'parameter "{key}" is unknown; known are {", ".join(OBSERVABLES)}')
    return OBSERVABLES[key]


def of_kind(kind: type[O]) -> dict[str, O]:
    """Return the room-acoustic parameters that are of a given class, by key."""
    return {key: o for key, o in OBSERVABLES.items() if isinstance(o, kind)}


SUMMARY = "*"
"""Name of source and receiver in a row that has means over several pairs."""


def parameter_label(parameter: str) -> str:
    """Return the printed name of a parameter; an unknown name is returned in capitals.

    Examples
    --------
    >>> [parameter_label(parameter) for parameter in ("t20", "ts", "level")]
    ['T20', 'Ts', 'level']
    """
    known = OBSERVABLES.get(checks.text("parameter", parameter))
    return parameter.upper() if known is None else known.label


LIMITS = (0.01, 120.0)
"""Shortest and longest T20 and T30 in s that are accepted. A lined box of a litre has 0.01 s or more.
The longest published T is 112 s, at 125 Hz in the oil tanks of Inchindown (T. Cox, Sonic
Wonderland, 2014)."""
TEAMS = (0.046, 0.036, 0.028, 0.022, 0.017, 0.013)
"""Relative standard deviation of T between measuring teams, by octave. The first and the last value are
from the music studio of the PTB (round robin III, Bork 2005; medians over pairs), with geometric
steps between. All pairs of a team have this error in common."""

MARGIN_DB = 15.0
"""Least distance in dB from the lower end of the evaluation range to the end of the decay. An
exponential decay that ends there has a T20 that is 0.4 % too low."""


def decay_curve_db(energy: Array) -> Array:
    """Return the normalised decay curve of an energy decay in dB at the start of each time bin.

    ``energy`` (..., n_bins) is the energy per bin. L_k = 10 lg(sum over j >= k of E_j / sum over all of
    E_j), so that L_0 = 0 (Schroeder 1965). L is minus infinity where no energy is left, and NaN for a
    decay without energy.
    """
    # Summed from the end, where the numbers are small: a difference of large sums would round them.
    left = np.flip(np.cumsum(np.flip(energy, -1), axis=-1), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10 * np.log10(left / left[..., :1]))


def cut_off_db(energy: Array) -> Array:
    """Return the level of the energy that would follow the end of a decay, in dB re the whole energy.

    ``energy`` (..., n_bins) is the energy per bin; the levels are (...). The energy after the end is
    extrapolated from the energies A and B of the last two quarters of the time: B r / (1 - r), r = B /
    A. The level is infinite where the energy does not fall, and minus infinity where the last quarter
    has no energy. If the decay has two slopes, the late one counts.
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
    """Base of parameters that are times in s, whose logarithm is the observed quantity."""

    unit = "s"
    decimals = 3
    logarithmic = True
    unknown_error = 0.05

    def rate(self, observed: Array) -> Array:
        """Return -1 / T or -1 / Ts, which is linear in the absorption area."""
        return np.asarray(-np.exp(-observed))


class DecaySlope(Relative):
    """Base class of decay times in s: -60 dB over the slope of the decay curve's regression line.

    The line is fitted where the decay curve is between ``upper`` and ``lower`` in dB.
    """

    upper: ClassVar[float]  # of the range, in dB
    lower: ClassVar[float]
    one_decay: ClassVar[float]
    """Relative standard deviation of T from one decay, times sqrt(B T), with the bandwidth B in Hz."""
    averages: ClassVar[tuple[float, float] | None] = None
    """Constants a and b of the uncertainty of a mean over positions (ISO 3382-2:2008, Eqs. 4 and 5)."""
    bend: ClassVar[tuple[str, float, float] | None] = None
    """Test for a curved decay by the ratio of this parameter to T20, minus 1: name of the ratio, its
    limit in percent, and its standard deviation times sqrt(B T) in straight decays (4,000 exponential
    decays of Gaussian noise, B T = 44 to 355)."""
    jnd = 0.05
    relative_jnd = True
    limits = LIMITS
    simulated = 1e-300, np.inf  # a decay of any length
    # An anechoic room for speech and a mausoleum.
    usual = 0.05, 30.0
    doubt = "check that the value is in seconds"
    part: ClassVar[Part] = "late"
    teams = TEAMS
    averaging = Scale(lambda t: 1 / t, lambda rate: 1 / rate, lambda t: -1 / t**2)

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the decay times of energy decays in s; NaN for one too short or not falling."""
        return self.of_decay(energy, decay_curve_db(energy), bin_width)

    def of_decay(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the decay times of energy decays in s, from their decay curves ``level`` in dB.

        A decay time is NaN if the decay is `too_short`, and for the reasons of `of_curve`.
        """
        return np.where(self.too_short(energy), np.nan, self.of_curve(level, bin_width))

    def of_curve(self, level: Array, bin_width: float) -> Array:
        """Return the decay times in s of decay curves, (...), even of curves that end too early.

        ``level`` (..., n_bins) are the decay curves in dB, ``bin_width`` the width of a time bin in s.
        A decay time is NaN if fewer than two points lie within the range of levels, or if the curve
        does not fall.
        """
        within = self._within(level)
        level = level[..., : within.shape[-1]]
        k, every = np.arange(level.shape[-1], dtype=float), within.astype(float)
        y, n = np.where(within, level, 0.0), every.sum(axis=-1)
        centred = (k - (every @ k / np.maximum(n, 1))[..., np.newaxis]) * every
        spread = np.einsum("...k,...k->...", centred, centred)
        fall = -np.einsum("...k,...k->...", centred, y)
        holds = (n >= 2) & (fall > 0)
        return np.where(holds, 60 * bin_width * spread / np.where(holds, fall, 1.0), np.nan)

    def too_short(self, energy: Array) -> NDArray[np.bool_]:
        """Return whether energy decays (..., n_bins) are too short, (...) of bool.

        A decay must fall to 15 dB below the range of levels: T20 needs 40 dB.
        """
        return np.asarray(cut_off_db(energy) > self.lower - MARGIN_DB)

    def _within(self, level: Array) -> NDArray[np.bool_]:
        """Return where levels are within the range, up to the last bin of any curve that is."""
        with np.errstate(invalid="ignore"):
            within = (level <= self.upper) & (level >= self.lower)
        # Of a decay that is followed for longer than its range, most bins are after it.
        held = np.flatnonzero(within.any(axis=tuple(range(level.ndim - 1))))
        return within[..., : held[-1] + 1 if held.size else 1]

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative d ln T / d E_j by the energy of each time bin.

        T is -60 / slope, where the slope is that of the regression of L_k = 10 lg(B_k / B_0) on k
        within the range, and B_k is the energy from bin k on. With c_k = k - mean(k) it follows that
        d ln T = -sum c_k dL_k / (slope sum c_k²). The ends of the range move, too: if the curve at an
        end is r dB off the line, points enter or leave there at the rate of dL / slope bins, and each
        has the weight c r / (slope sum c_k²). The arguments are those of `Observable.gradient`.
        """
        within = self._within(level)
        left = np.flip(np.cumsum(np.flip(energy, -1), axis=-1), -1)
        level, left = (of[..., : within.shape[-1]] for of in (level, left))
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
        share = np.where(within, by_level / np.where(left > 0, left, 1.0), 0.0)
        whole = by_level.sum(-1, keepdims=True) / left[..., :1]
        gradient = np.empty(energy.shape)
        gradient[..., : level.shape[-1]] = DB * (np.cumsum(share, axis=-1) - whole)
        gradient[..., level.shape[-1] :] = gradient[..., level.shape[-1] - 1, np.newaxis]
        gradient[np.isnan(self.of_curve(level, bin_width))] = np.nan
        return gradient

    def decay_time(self, values: Array) -> Array:
        """Return the values themselves, which are decay times in s."""
        return values

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the relative standard deviation of T from one decay, c / sqrt(B T).

        B is the bandwidth in Hz. The constant c (`one_decay`) is 0.88 for T20 and 0.55 for T30 (ISO
        3382-2:2008, Eqs. 4 and 5), and 1.6 for EDT (simulated noise). ``frequencies`` (n_bands,) are in
        Hz, ``times`` (..., n_bands) are T in s.
        """
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        with np.errstate(invalid="ignore"):
            return np.asarray(self.one_decay / np.sqrt(bandwidth * times))

    def variance_of_mean(
        self, frequencies: Array, mean: Array, positions: Array, decays: int = _DECAYS
    ) -> Array:
        """Return the variance a² T (1 + b / n) / (N B) of a mean T over N positions with n decays.

        The variance is in s², NaN for EDT. B is the bandwidth in Hz. ``frequencies`` (n_bands,) are in
        Hz, ``mean`` (n_bands,) is T in s, ``positions`` (n_bands,) is N and ``decays`` is n. The
        constants a and b (`averages`) are those of RWTH Aachen's ITA-Toolbox (P. Dietrich, 2009),
        ita_roomacoustics_uncertainty.m, which names EN ISO 3382 as its source. They were not compared
        with the standard (ISO 3382-2:2008, Eqs. 4 and 5).
        """
        if self.averages is None:
            return super().variance_of_mean(frequencies, mean, positions, decays)
        a, b = self.averages
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        return np.asarray(a**2 * mean * (1 + b / decays) / (np.maximum(positions, 1) * bandwidth))

    def largest_uncertainty(self, values: Array) -> Array:
        """Return the largest meaningful uncertainty of each decay time in s: the time itself."""
        return values


@register
class T20(DecaySlope):
    """Reverberation time T20 in s, from -5 to -25 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t20", "T20", 10
    spellings = "rt20 tr20 rt60t20 t60t20 t60(20) reverberationtimet20 nachhallzeitt20"
    upper, lower = -5.0, -25.0
    minimum_range = 35.0
    one_decay = 0.88
    averages = (0.88, 1.90)
    matched = shown = True


@register
class T30(DecaySlope):
    """Reverberation time T30 in s, from -5 to -35 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t30", "T30", 20
    spellings = "rt30 tr30 rt60t30 t60t30 t60(30) reverberationtimet30 nachhallzeitt30"
    upper, lower = -5.0, -35.0
    minimum_range = 45.0
    one_decay = 0.55
    averages = (0.55, 1.52)
    # ISO 3382-2:2008, B.3: a straight decay has 0 to 5 %; above 10 % it is far from straight.
    bend = "curvature T30/T20 - 1", 10.0, 0.75


@register
class EDT(DecaySlope):
    """Early decay time in s, from 0 to -10 dB (ISO 3382-1:2009, A.2.2)."""

    key, label, rank = "edt", "EDT", 30
    spellings = "earlydecaytime"
    upper, lower = 0.0, -10.0
    # Strong direct sound makes it arbitrarily short.
    limits = 0.0, LIMITS[1]
    usual = 0.005, 30.0
    # 400 decays of octave-filtered Gaussian noise at 500 Hz and 400 at 1 kHz, T = 1 s, have 1.7.
    one_decay = 1.6
    part = "early"
    bend = "EDT/T20 - 1", 20.0, 2.25  # four JND, in the mean over positions
    teams = (0.100, 0.080, 0.064, 0.051, 0.041, 0.033)
    matched = shown = True


def longest(keys: Iterable[str]) -> DecaySlope:
    """Return the parameter that needs the longest decay, among T20 and the decay times in ``keys``.

    Examples
    --------
    >>> longest(["edt", "t30", "c80"]).label, longest(["edt"]).label
    ('T30', 'T20')
    """
    asked = {T20.key, *checks.texts("keys", keys)}
    return min([o for k, o in of_kind(DecaySlope).items() if k in asked], key=attrgetter("lower"))


def _divided(energy: Array, bin_width: float, limit: float) -> tuple[Array, Array]:
    """Return the energy before and after ``limit`` s; a bin across the limit is divided."""
    share = _share_before(energy.shape[-1], bin_width, limit)
    return energy @ share, energy @ (1 - share)  # the late energy as a difference could be below 0


def _share_before(n_bins: int, bin_width: float, limit: float) -> Array:
    """Return the share of each time bin that is before ``limit`` s, (n_bins,)."""
    return np.clip(limit / bin_width - np.arange(n_bins), 0.0, 1.0)


def _early_share(clarity: Array) -> Array:
    return np.asarray(1 / (1 + 10 ** (-clarity / 10)))


class Clarity(Observable):
    """Base of clarity in dB, 10 lg(early / late energy); ``limit`` in s ends the early sound."""

    limit: ClassVar[float]
    unit = "dB"
    decimals = 1
    jnd = 1.0
    # C80 of T = 0.03 s is 160 dB.
    limits = -200.0, 200.0
    doubt = "check that the value is in dB"
    # C80 of T = 0.1 s is 48 dB; of 1 m from a source in a long T it is some 20 dB.
    usual = -40.0, 45.0
    rises = True
    # Of C80 between teams, in dB; see `TEAMS`.
    teams = (0.83, 0.70, 0.59, 0.49, 0.42, 0.35)
    unknown_error = 0.5
    remeasured = 0.1
    averaging = Scale(
        _early_share,
        lambda share: 10 * np.log10(share / (1 - share)),
        lambda c: np.log(10) / 10 * _early_share(c) * (1 - _early_share(c)),
    )

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the clarity of energy decays in dB; infinite without late energy, NaN without any."""
        early, late = _divided(energy, bin_width, self.limit)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(10 * np.log10(early / late))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of the clarity in dB by the energy of each time bin, (..., n_bins).

        The derivative is 10 / ln 10 times (share / early - (1 - share) / late), where share is the part
        of the bin before the limit, such as 80 ms, and early and late are the energies before and after
        it. The arguments are those of `Observable.gradient`.
        """
        share = _share_before(energy.shape[-1], bin_width, self.limit)
        early, late = energy @ share, energy @ (1 - share)
        return np.asarray(
            DB * (share / early[..., np.newaxis] - (1 - share) / late[..., np.newaxis])
        )

    def rate(self, observed: Array) -> Array:
        """Return k in 1/s of the decay exp(-k t) with this clarity, C = 10 lg(exp(k limit) - 1)."""
        return np.asarray(np.log1p(np.exp(observed / DB)) / self.limit)

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the standard deviation of clarity in one noise-like impulse response, in dB.

        ``frequencies`` (n_bands,) are in Hz, ``times`` (..., n_bands) are T in s. In a time window, the
        energy of noise of bandwidth B has the relative variance 1 / (B t), where t = (∫ e)² / ∫ e² of
        the decaying energy e. In an exponential decay t is 2 (1 - a) / (k (1 + a)) for the early sound
        and 2 / k for the late sound, with k = 6 ln 10 / T and a = exp(-k limit).
        """
        bandwidth = bands.bandwidth_factor(frequencies) * frequencies
        with np.errstate(invalid="ignore"):
            rate = 6 * np.log(10) / times
            end = np.exp(-rate * self.limit)
            variance = rate / (2 * bandwidth) * ((1 + end) / (1 - end) + 1)
            return np.asarray(10 / np.log(10) * np.sqrt(variance))


@register
class C50(Clarity):
    """Clarity of speech C50: the energy before 50 ms over the energy after, in dB."""

    key, label, rank = "c50", "C50", 40
    spellings = "clarityc50 deutlichkeitsmaß deutlichkeitsmaßc50 deutlichkeitsmassc50"
    limit = reaches = 0.05
    shown = True


@register
class C80(Clarity):
    """Clarity of music C80: the energy before 80 ms over the energy after, in dB."""

    key, label, rank = "c80", "C80", 50
    spellings = "clarityc80 klarheitsmaß klarheitsmaßc80 klarheitsmassc80"
    limit = reaches = 0.08
    matched = shown = True


_C50 = C50()
_HALF = 0.25 / DB
"""d D50 / d C50 where half of the energy is early: nowhere else it is larger."""


@register
class D50(Observable):
    """Definition D50: the share of the energy that arrives before 50 ms (ISO 3382-1:2009, A.11)."""

    key, label, rank = "d50", "D50", 60
    spellings = (
        "definition definitiond50 deutlichkeitd50 d deutlichkeit deutlichkeitsgrad "
        "deutlichkeitsgradd50"
    )
    unit = ""
    decimals = 2
    jnd = 0.05
    limits = 0.0, 1.0
    doubt = "D50 is a fraction, not a percentage"
    reaches = C50.limit
    rises = True
    teams = tuple(_HALF * x for x in C50.teams)
    unknown_error = _HALF * C50.unknown_error
    predicted = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return D50 of energy decays, 0 to 1; NaN without energy."""
        early, late = _divided(energy, bin_width, C50.limit)
        with np.errstate(invalid="ignore"):
            return np.asarray(early / (early + late))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of D50 by the energy of each time bin, (..., n_bins).

        It is (share - D50) / sum(E), where share is the part of the bin before 50 ms. The arguments are
        those of `Observable.gradient`.
        """
        share = _share_before(energy.shape[-1], bin_width, C50.limit)
        total = energy.sum(-1, keepdims=True)
        return np.asarray((share - (energy @ share)[..., np.newaxis] / total) / total)

    def rate(self, observed: Array) -> Array:
        """Return 50 ms times the decay rate k of the decay exp(-k t) with this D50, -ln(1 - D50)."""
        return np.asarray(-np.log1p(-observed))

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the standard deviation of D50 in one response of decaying noise, (..., n_bands).

        It is that of C50 in dB, times D50 (1 - D50) ln(10) / 10. The arguments are those of
        `Observable.scatter`.
        """
        with np.errstate(invalid="ignore"):
            late = np.exp(-6 * np.log(10) * C50.limit / times)
        return np.asarray(_C50.scatter(frequencies, times) * late * (1 - late) / DB)


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
    """Speech transmission index without noise, from the decay (IEC 60268-16:2020, 5.3.2 and A.5).

    The value in one octave is the modulation transfer index, the mean transmission index over the
    modulation frequencies; `overall` returns the STI of all octaves. Masking and noise are not
    included, so that speech in a noisy room is less intelligible than this STI says.
    """

    key, label, rank = "sti", "STI", 65
    label_of_band = "MTI"
    spellings = "speechtransmissionindex mti modulationtransferindex"
    unit = ""
    decimals = 2
    jnd = 0.03  # Bradley, Reich and Norcross 1999
    limits = 0.0, 1.0
    doubt = "STI is a fraction, not a percentage"
    rises = True
    teams = tuple(_BY_LN_T * x for x in EDT.teams)
    unknown_error = jnd / 2
    predicted = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the mean transmission index of energy decays; NaN without energy."""
        return np.asarray(_index(np.abs(_transfer(energy, bin_width))).mean(-1))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of STI by the energy of each time bin, (..., n_bins).

        For the energy E_j of bin j it is the mean over the modulation frequencies of (dTI / dm) (Re(m*
        w_j) / |m| - |m|), divided by sum(E). m is the complex modulation transfer, TI the transmission
        index, and w_j = exp(-2 pi i F t_j) at the time t_j of bin j, with the modulation frequency F.
        The arguments are those of `Observable.gradient`.
        """
        ratio = _transfer(energy, bin_width)
        waves = np.stack([_wave(f, energy.shape[-1], bin_width) for f in MODULATIONS])
        m = np.abs(ratio)
        by_ratio = _slope(m) / len(MODULATIONS)
        wave = ((by_ratio / m * np.conj(ratio)) @ waves).real
        rest = np.sum(by_ratio * m, axis=-1, keepdims=True)
        return np.asarray((wave - rest) / energy.sum(-1, keepdims=True))

    def rate(self, observed: Array) -> Array:
        """Return the decay rate k in 1/s of an exponential decay with this STI."""
        logarithms, table = self._table
        return np.asarray(np.exp(np.interp(observed, table, logarithms)))

    def overall(self, values: Array, frequencies: Array) -> Array:
        """Return the STI over the octaves from 125 Hz to 8 kHz, (...); NaN if one octave is missing.

        It is the sum of alpha_k M_k minus that of beta_k sqrt(M_k M_k+1), where M_k is the modulation
        transfer index of octave k, with the weights alpha and beta of male speech (IEC 60268-16:2011,
        A.5.6 and Table A.3). ``values`` (..., n_bands) are the indices, ``frequencies`` (n_bands,) are
        in Hz.
        """
        listed = np.asarray(frequencies, dtype=float).tolist()
        if not set(_OCTAVES) <= set(listed):
            return super().overall(values, frequencies)
        m = np.asarray(values, dtype=float)[..., [listed.index(f) for f in _OCTAVES]]
        return np.asarray(m @ _WEIGHTS - np.sqrt(m[..., :-1] * m[..., 1:]) @ _REDUNDANCY)

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


@register
class Level(Observable):
    """Relative level in dB, with a reference that is the same for all receivers of a source.

    The relative level differs from sound strength G by a constant that only a calibrated source gives.
    If G was measured, G is used in its place.
    """

    key, label, rank = "level", "level", 90
    stand_in: ClassVar[str | None] = "g"
    matched = True
    unit = "dB"
    decimals = 1
    jnd = 1.0
    limits = -200.0, 200.0
    doubt = "check that the value is in dB"
    minimum_range = None
    part = "level"
    # In dB, of G; see `TEAMS`.
    teams = (2.0, 1.55, 1.20, 0.92, 0.72, 0.55)
    unknown_error = 0.5
    remeasured = 0.2
    averaging = Scale(
        lambda level: 10 ** (level / 10),
        lambda energy: 10 * np.log10(energy),
        lambda level: np.log(10) / 10 * 10 ** (level / 10),
    )

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the level of energy decays, for unit source energy, in dB re 10 m in free field."""
        with np.errstate(divide="ignore"):
            return np.asarray(10 * np.log10(400 * np.pi * energy.sum(-1)))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of the level in dB by the energy of each time bin, (..., n_bins).

        It is 10 / (ln 10 sum(E)). The arguments are those of `Observable.gradient`.
        """
        return np.broadcast_to(DB / energy.sum(-1, keepdims=True), energy.shape)

    def rate(self, observed: Array) -> Array:
        """Return -1 / E, the inverse energy, which is linear in the absorption area."""
        return np.asarray(-np.exp(-observed / DB))


@register
class G(Level):
    """Sound strength G in dB: the level relative to 10 m in the free field (ISO 3382-1:2009, A.2.1)."""

    key, label, rank = "g", "G", 80
    spellings = "strength soundstrength"
    stand_in = None
    matched = False
    # Far outdoors, and at 0.1 m from a source.
    usual = -40.0, 45.0


@register
class Ts(Relative):
    """Centre time Ts in s, the centre of gravity of the energy (ISO 3382-1:2009, A.13)."""

    key, label, rank = "ts", "Ts", 70
    spellings = (
        "centretime centertime ctcentretime ctcentertime tscentretime tscentertime "
        "schwerpunktzeit schwerpunktzeitts tempocentrale centrotempo tempobaricentrico"
    )
    jnd = 0.010
    # Ts of an exponential decay is T / 13.8: 8.7 s for T = 120 s.
    limits = 0.0, 10.0
    doubt = "check that the value is in s, not in ms"
    # Ts of T = 0.05 s and of T = 28 s.
    usual = 0.0036, 2.0
    teams = EDT.teams
    matched = True

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the centre time of energy decays in s; NaN without energy."""
        middle = (np.arange(energy.shape[-1]) + 0.5) * bin_width
        with np.errstate(invalid="ignore"):
            return np.asarray(energy @ middle / energy.sum(axis=-1))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return the derivative of ln Ts by the energy of each time bin, (..., n_bins).

        For bin k, whose energy is E_k, it is (k + 1/2) / sum(E_k (k + 1/2)) - 1 / sum(E_k). The
        arguments are those of `Observable.gradient`.
        """
        k = np.arange(energy.shape[-1]) + 0.5
        return np.asarray(k / (energy @ k)[..., np.newaxis] - 1 / energy.sum(-1, keepdims=True))

    def decay_time(self, values: Array) -> Array:
        """Return T in s of an exponential decay with this centre time, 6 ln 10 Ts."""
        return np.asarray(values * (6 * np.log(10)))


REVERBERATION = tuple(o for o in of_kind(DecaySlope).values() if o.averages is not None)
"""Reverberation times T20 and T30. A calibration matches the first that was measured, and never EDT,
which depends on early sound and the source's directivity."""
TARGET = REVERBERATION[0]
"""Decay time that every simulator returns, and that a calibration of mean values matches."""
EARLY = max(of_kind(DecaySlope).values(), key=lambda o: o.lower)
"""Early decay time EDT, of the first 10 dB."""
LEVEL = OBSERVABLES["level"]
"""Relative level, which has a reference for each source where G was not measured."""
MATCH = tuple(key for key, o in OBSERVABLES.items() if o.matched)
"""Keys of the parameters that are matched at every position by default."""


MAX_BIN = 0.01
"""Largest width of a simulator's time bins in s, a fifth of the 50 ms of C50."""


def bins(bin_width: float) -> float:
    """Return the width of a simulator's time bins in s, once it is checked.

    Raises DataError unless it is above 0 and at most 0.01 s (`MAX_BIN`).
    """
    if checks.positive("bin_width", bin_width, "s") > MAX_BIN:
        raise DataError(f"bin_width = {bin_width:g} s is more than {MAX_BIN:g} s, too wide for C50")
    return float(bin_width)


def checked_decay(energy: Array, bin_width: float = 1.0) -> Array:
    """Return energy decays (..., n_bins) as an array, once they are checked.

    ``energy`` (..., n_bins) is the energy per time bin, ``bin_width`` the width of the bins in s.
    Raises DataError for a negative or infinite energy, and for a width that is not above 0.
    """
    checks.positive("bin_width", bin_width, "s")
    energy = checks.array("energy", energy)
    if energy.ndim == 0 or energy.shape[-1] == 0:
        raise DataError(
            f"energy has shape {energy.shape}; its last axis must have at least one bin"
        )
    checks.entries("energy", energy, np.isfinite(energy) & (energy >= 0), "finite and 0 or more")
    return energy


def parameters(
    energy: Array, bin_width: float, names: Sequence[str] | None = None
) -> dict[str, Array]:
    """Return room-acoustic parameters of energy decays by key, each (...), in the parameters' units.

    A value is NaN where the decay is too short for the parameter.

    Parameters
    ----------
    energy : array (..., n_bins)
        Energy per bin, 0 or more; the first bin starts with the direct sound.
    bin_width : float
        Width of the time bins in s.
    names : sequence of str, optional
        Keys of the parameters, such as "t20"; by default all parameters of `OBSERVABLES` that need no
        calibrated source.

    Raises
    ------
    DataError
        For an unknown parameter, a negative or infinite energy, or a width that is not above 0.

    Examples
    --------
    >>> time = np.arange(20000) * 1e-4
    >>> print(parameters(10 ** (-6 * time / 0.8), 1e-4)["t20"].round(6))
    0.8
    """
    if names is None:
        names = [key for key, o in OBSERVABLES.items() if o.minimum_range is not None]
    energy = checked_decay(energy, bin_width)
    values, level = dict[str, Array](), None
    for o in [observable(name) for name in names]:
        if isinstance(o, DecaySlope) and type(o).value is DecaySlope.value:
            level = decay_curve_db(energy) if level is None else level  # one curve for all of them
            values[o.key] = o.of_decay(energy, level, bin_width)
        else:
            values[o.key] = o.value(energy, bin_width)
    return {name: np.where(np.isfinite(v), v, np.nan) for name, v in values.items()}


def gradients(energy: Array, bin_width: float, parameters: Sequence[str]) -> Array:
    """Return the derivatives of parameters by the energy of each bin, (n_parameters, ..., n_bins).

    ``energy`` (..., n_bins) is the energy per time bin, ``bin_width`` the width of the bins in s, and
    ``parameters`` are keys, such as ``"t20"``. For decay times and Ts they are derivatives of the
    logarithm; the unit is 1 or dB over that of ``energy``. A decay time jumps a little where a bin
    enters its range of levels; the derivative is that of the mean over the jumps. A derivative is NaN
    where the decay is too short for the parameter. Errors are those of the function `parameters`.
    """
    energy = checked_decay(energy, bin_width)
    level = decay_curve_db(energy)
    out = np.empty((len(parameters), *energy.shape))
    for row, kind in zip(out, map(observable, parameters), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            row[:] = kind.gradient(energy, level, bin_width)
    return out
