"""The base of every observable, and the registry that the whole package asks.

An observable is heard at a position, in a band. Three scales belong to it. Its values have its unit.
What is *observed* is nearly linear in alpha: the logarithm of a time, or the value itself. And one
function of what is observed is linear in the room's absorption.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

DB = 10 / np.log(10)
"""dB per neper of energy."""
OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""Centre frequencies in Hz of `Observable.between_teams`."""
_BINS = 4000
"""Bins of the exponential decay that stands for a noise-like response, over twice its T."""


Part = Literal["late", "early", "level"]


@dataclass(frozen=True)
class Scale:
    """A quantity that averages over the thirds of an octave, as a function of the value."""

    forward: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    slope: Callable[[Array], Array]


ITSELF = Scale(lambda x: x, lambda x: x, np.ones_like)


class Observable(ABC):
    """A room-acoustic parameter: its names, its units, and how it follows from an energy decay.

    Attributes
    ----------
    key : str
        Name in files, in JSON and in Python.
    label : str
        Name as it is printed.
    spellings : tuple of str
        Further names in tables of other programs, in lower case without spaces.
    unit : str
    decimals : int
        Digits after the point as it is printed.
    rank : int
        Place in lists, the smallest first.
    jnd : float
        Just noticeable difference, in the unit or, where ``relative_jnd``, of the value.
    limits : (float, float)
        Least and largest value that is accepted.
    doubt : str
        The likely mistake behind a value beyond them.
    usual : (float, float)
        Least and largest value that hardly any room is beyond; one that is, is read and told.
    minimum_range : float or None
        Impulse-to-noise ratio in dB that a response needs to hold it. None where a response alone does
        not: its level needs a calibrated source.
    reaches : float
        Time in s that a response must be longer than to hold it.
    logarithmic : bool
        Whether the logarithm is observed. Uncertainties are then relative.
    rises : bool
        Whether it rises with the absorption.
    part : {"late", "early", "level"}
        Part of the decay that it hears. What stands near a position changes each part by a share of its
        own.
    teams : tuple of float
        Standard deviation between teams at one pair of positions, by octave of `OCTAVES`, as observed.
    unknown_error : float
        Standard deviation of a simulator's error that no control run tells, as observed.
    remeasured : float
        Standard deviation by which all pairs of a band differ, as observed, if it is measured anew and
        nothing changed.
    matched : bool
        Whether it is matched at every position where nothing else is asked for.
    predicted : bool
        Whether a prediction at positions gives it beside what is matched.
    shown : bool
        Whether a loop on mean values shows it, and a tracer states its noise.
    stand_in : str or None
        Key of an observable that serves in its place where it was not measured.
    averaging : Scale
        The quantity that averages over the thirds of an octave.
    """

    key: ClassVar[str]
    label: ClassVar[str]
    spellings: ClassVar[tuple[str, ...]] = ()
    unit: ClassVar[str]
    decimals: ClassVar[int]
    rank: ClassVar[int]
    jnd: ClassVar[float]
    relative_jnd: ClassVar[bool] = False
    limits: ClassVar[tuple[float, float]]
    doubt: ClassVar[str]
    usual: ClassVar[tuple[float, float]] = (-np.inf, np.inf)
    minimum_range: ClassVar[float | None] = 20.0
    reaches: ClassVar[float] = 0.0
    logarithmic: ClassVar[bool] = False
    rises: ClassVar[bool] = False
    part: ClassVar[Part] = "early"
    teams: ClassVar[tuple[float, ...]]
    unknown_error: ClassVar[float]
    remeasured: ClassVar[float] = 0.01
    matched: ClassVar[bool] = False
    predicted: ClassVar[bool] = False
    shown: ClassVar[bool] = False
    stand_in: ClassVar[str | None] = None
    averaging: ClassVar[Scale] = ITSELF

    @abstractmethod
    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the value of energy decays (..., n_bins), (...); not finite where one lacks it."""

    @abstractmethod
    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return d observed / d energy of each bin, (..., n_bins), in 1 or dB over the energy's unit.

        ``level`` is the decay curve in dB, `rtcal.acoustics.decay.decay_curve_db`.
        """

    @abstractmethod
    def linear(self, values: Array, stated: Array) -> Array:
        """Return how far what is observed is from what is stated, linear in the absorption.

        0 at ``stated``; a relative change of the absorption near it, up to the sign.
        """

    @abstractmethod
    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by what is observed."""

    def too_short(self, energy: Array) -> NDArray[np.bool_]:
        """Return whether energy decays (..., n_bins) are cut off too early to hold it, (...)."""
        return np.zeros(np.shape(energy)[:-1], dtype=bool)

    def key_in(self, values: Container[str]) -> str:
        """Return under which key a table has it: its own, or else its stand-in's."""
        return self.key if self.stand_in is None or self.key in values else self.stand_in

    def observed(self, values: Array) -> Array:
        """Return what is observed, of values in the unit; NaN where there is no logarithm."""
        if not self.logarithmic:
            return values
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.log(values))

    def natural(self, observed: Array) -> Array:
        """Return values in the unit, of what is observed."""
        return np.asarray(np.exp(observed)) if self.logarithmic else observed

    def of_observed(self, uncertainty: Array, values: Array) -> Array:
        """Return the uncertainty of what is observed, of that of the values."""
        return np.asarray(uncertainty / values) if self.logarithmic else uncertainty

    def of_value(self, uncertainty: Array, values: Array) -> Array:
        """Return the uncertainty of the values, of that of what is observed."""
        return np.asarray(uncertainty * values) if self.logarithmic else uncertainty

    def jnd_of(self, values: Array) -> Array | float:
        """Return one JND of values, in the unit."""
        return self.jnd * values if self.relative_jnd else self.jnd

    def decay_time(self, values: Array) -> Array:
        """Return the T in s of an exponential decay with these values; NaN if they do not tell it."""
        return np.full(np.shape(values), np.nan)

    def between_teams(self, frequencies: Array) -> Array:
        """Return the standard deviation between teams as observed, (n_bands,)."""
        return np.asarray(np.interp(np.log(frequencies), np.log(OCTAVES), self.teams))

    def scatter(self, frequencies: Array, times: Array) -> Array:
        """Return the standard deviation as observed of one response, whose field is noise.

        In a band of bandwidth B the energy of a bin of width w has the relative variance 1 / (B w).

        Parameters
        ----------
        frequencies : array (n_bands,)
            Centre frequencies in Hz.
        times : array (..., n_bands)
            Decay time in s of an exponential decay.
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
        """Return the one number of all bands, (...), of values (..., n_bands); NaN if it has none."""
        return np.full(np.shape(values)[:-1], np.nan)

    def variance_of_mean(self, frequencies: Array, mean: Array, positions: Array) -> Array:
        """Return the variance of a mean over ``positions`` that theory expects; NaN without one."""
        return np.full(np.shape(mean), np.nan)

    @property
    def rule(self) -> str:
        """The values that are accepted, in words.

        Examples
        --------
        >>> from rtcal.acoustics.observables import observable
        >>> observable("d50").rule
        'from 0 to 1: is it in percent? D50 is a fraction'
        """
        unit = f" {self.unit}".rstrip()
        return f"from {self.limits[0]:g} to {self.limits[1]:g}{unit}: {self.doubt}"

    @property
    def value_rule(self) -> str:
        """The rule that no `Measurement` breaks, in words: a simulated value may be implausible."""
        return self.rule

    def broken(self, values: Array) -> NDArray[np.bool_]:
        """Return where values break the ``value_rule``, rounding included."""
        least, most = self.limits
        with np.errstate(invalid="ignore"):
            return np.asarray((values < least) | (values > most * (1 + 1e-9)))

    def largest_uncertainty(self, values: Array) -> tuple[Array, str]:
        """Return the largest uncertainty that says anything, and what it is, in words."""
        least, most = self.limits
        return np.full(np.shape(values), most - least), "the parameter's range"

    def refuse(self, place: str, value: float) -> None:
        """Raise DataError for a value that no room has; ``place`` says whose it is. NaN is missing."""
        if self.broken(np.asarray(value)):
            raise DataError(f"{place} = {value:g} is not {self.rule}")


OBSERVABLES: dict[str, Observable] = {}
"""Every observable by its key, in the order of their ranks."""

O = TypeVar("O", bound=Observable)  # noqa: E741


def register(kind: type[O]) -> type[O]:
    """Name an observable in `OBSERVABLES`; a class decorator.

    Raises
    ------
    DataError
        If another class has the key, ``teams`` are not one per octave of `OCTAVES`, or the gradient is
        not the derivative of what is observed.
    """
    new: Observable = kind()
    place = f'observable "{new.key}"'
    old = type(OBSERVABLES.get(new.key, new))
    if (old.__module__, old.__qualname__) != (kind.__module__, kind.__qualname__):
        raise DataError(f"{place}: {old.__qualname__} has this key; each observable has its own")
    if len(new.teams) != len(OCTAVES):
        octaves = ", ".join(f"{f:g}" for f in OCTAVES)
        raise DataError(
            f"{place}: teams has {len(new.teams)} values; it has one for each of {octaves} Hz"
        )
    if not kind.__module__.startswith(f"{__package__}."):  # tests check the package's own
        check_gradient(new)
    every = [*(o for o in OBSERVABLES.values() if o.key != new.key), new]
    OBSERVABLES.clear()
    OBSERVABLES.update({o.key: o for o in sorted(every, key=lambda o: o.rank)})
    return kind


def check_gradient(observable: Observable) -> None:
    """Raise DataError unless the gradient is the derivative of what is observed of a decay.

    The decay is exponential, of 1 s, in 200 bins of 10 ms. Each bin's energy is changed by a share of
    1e-6 and by -1e-6. Differences above 1 % of the largest are errors.
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
            f'observable "{observable.key}": gradient at {width * k:g} s = {stated[k] / energy[k]:g}; '
            f"differences of value give {found[k] / energy[k]:g}"
        )


def observable(key: str) -> Observable:
    """Return an observable by its key; DataError for a name that is none.

    Examples
    --------
    >>> from rtcal.acoustics.observables import observable
    >>> observable("ts").label, observable("ts").unit
    ('Ts', 's')
    """
    if not isinstance(key, str) or key not in OBSERVABLES:
        raise DataError(f'parameter "{key}" is unknown; known are {", ".join(OBSERVABLES)}')
    return OBSERVABLES[key]


def of_kind(kind: type[O]) -> dict[str, O]:
    """Return the observables that are of one class, by key."""
    return {key: o for key, o in OBSERVABLES.items() if isinstance(o, kind)}


SUMMARY = "*"
"""Name of the source and of the receiver in a row that holds means over several pairs."""


def parameter_label(parameter: str) -> str:
    """Return a parameter as it is printed; a name that is none in capitals.

    Examples
    --------
    >>> [parameter_label(parameter) for parameter in ("t20", "ts", "level")]
    ['T20', 'Ts', 'level']
    """
    known = OBSERVABLES.get(checks.text("parameter", parameter))
    return parameter.upper() if known is None else known.label
