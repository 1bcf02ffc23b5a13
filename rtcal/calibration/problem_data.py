"""The measured T in a room's bands, and all numbers that fill a compiled problem before a solve."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.acoustics import band_conversion, bands, repeats, trust
from rtcal.acoustics.decay import BentDecay, bent_decays
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import REVERBERATION, TARGET, parameter_label
from rtcal.acoustics.room import Room
from rtcal.acoustics.trust import TypingError
from rtcal.calibration.layout import Layout, Whitened
from rtcal.support import checks
from rtcal.support.errors import CopiedPairsWarning, DataError, OtherBandsWarning
from rtcal.support.kkt import DENSE
from rtcal.support.text import shortened
from rtcal.support.types import Array, read_only_view

_FEW_VALUES = 4
"""Fewer values of T20 and T30 may be equal by rounding."""


@dataclass(frozen=True, repr=False)
class MeasuredTimes:
    """Measured T in the room's bands.

    ``reverberation_time`` and ``uncertainty`` in s, (n_bands,), NaN where missing or unknown;
    ``parameter`` is ``"t20"``, ``"t30"`` or ``""`` per band. ``ignored`` are the measured bands in Hz
    that the room lacks. ``fingerprint`` identifies the data. ``caution`` is a sentence if T was
    converted from bands of another width, or if T30 is a copy of T20 or a pair one of another, else
    empty. ``bent`` are the bands whose decay is not straight. ``mistyped`` are values that are likely
    typing errors, with the room's nearest band.
    """

    reverberation_time: Array
    uncertainty: Array
    parameter: tuple[str, ...]
    ignored: tuple[float, ...]
    fingerprint: str
    caution: str
    bent: tuple[BentDecay, ...] = ()
    mistyped: tuple[TypingError, ...] = ()

    def __repr__(self) -> str:
        n, data = np.count_nonzero(np.isfinite(self.reverberation_time)), self.fingerprint
        return f"<MeasuredTimes: {n} of {len(self.parameter)} bands, data {shortened(data)}>"


def times_in_room(room: Room, measured: Measurement | Sequence[float] | Array) -> MeasuredTimes:
    """Return the measured T in the room's bands; NaN where a band has none.

    Raises
    ------
    DataError
        For a wrong shape, a T that is not above 0, an uncertainty above the value, or no band in
        common.
    """
    if isinstance(measured, Measurement):
        measured.refuse_large_uncertainty()
        in_room = band_conversion.measurement_in_room_bands(measured, room.centre_frequencies)
        decay = in_room.decay_time()
        mean = decay.mean
        if not np.isfinite(mean).any():
            parameters = ", ".join(parameter_label(p) for p in measured.values)
            raise DataError(
                f"the measurement has {parameters}, but no T20 and no T30 in any band of the room"
            )
        stated, wanted = measured.centre_frequencies, room.centre_frequencies
        rule, of_pairs = band_conversion.rule(stated, wanted, "T"), measured.copies
        cautions = (rule, copied(measured), *of_pairs)
        return MeasuredTimes(
            reverberation_time=mean,
            uncertainty=decay.uncertainty,
            parameter=decay.parameter,
            ignored=tuple(band_conversion.unused(stated, wanted).tolist()),
            fingerprint=" ".join([repeats.of_times(room, mean), *_at_pairs(in_room)]),
            caution=". ".join(filter(None, cautions)),
            bent=bent_decays(in_room),
            mistyped=_mistyped(room, measured, mean, decay.parameter),
        )
    try:
        times = checks.array("measured", measured).copy()
    except DataError as error:
        raise DataError(f"measured is not a list of T in s: {error}") from error
    if times.shape != (room.n_bands,):
        raise DataError(f"measured T has shape {times.shape}; the room asks for ({room.n_bands},)")
    if (bad := np.isinf(times) | (times <= 0)).any():
        k = int(np.argmax(bad))
        band = bands.label(room.centre_frequencies[k])
        raise DataError(f"T[{band}] = {times[k]:g} s is not finite and above 0")
    if not np.isfinite(times).any():
        raise DataError("measured T is missing in every band; there is nothing to calibrate to")
    return MeasuredTimes(
        times,
        np.full(times.shape, np.nan),
        tuple(TARGET.key if finite else "" for finite in np.isfinite(times)),
        (),
        repeats.of_times(room, times),
        "",
        mistyped=tuple(trust.of_row(room.centre_frequencies, times, "T", " s")),
    )


def _mistyped(
    room: Room, measured: Measurement, mean: Array, parameter: Sequence[str]
) -> tuple[TypingError, ...]:
    """Return the likely typing errors in T: of single values, or else of their mean."""
    matched = {p for p in parameter if p}
    values = {p: v for p, v in measured.values.items() if p in matched}
    places = np.log(room.centre_frequencies)
    found = [
        replace(error, frequency=float(room.centre_frequencies[k]))
        for error in trust.in_measurement(
            Measurement(
                centre_frequencies=measured.centre_frequencies, values=values, pairs=measured.pairs
            )
        )
        for k in [int(np.argmin(np.abs(places - np.log(error.frequency))))]
    ]
    return tuple(found) or tuple(trust.of_row(room.centre_frequencies, mean, "the mean T", " s"))


def notes_of_bands(room: Room, measured: Measurement) -> list[str]:
    """Return what bands are converted or left out, and in which bands of the room no T was measured.

    Raises DataError without a band in common.
    """
    wanted = room.centre_frequencies
    in_room = band_conversion.measurement_in_room_bands(measured, wanted)
    told = band_conversion.notes(measured.centre_frequencies, wanted)
    lacking = wanted[np.isnan(in_room.decay_time().mean)]
    if lacking.size:
        told.append(f"no T was measured at {', '.join(bands.labels(lacking))}")
    return told


def tell_data(room: Room, measured: Measurement) -> None:
    """Warn of bands that are converted, left out or without T, and of pairs that are copies."""
    if told := notes_of_bands(room, measured):
        warnings.warn("; ".join(told), OtherBandsWarning, stacklevel=checks.stack_level())
    for note in measured.copies:
        warnings.warn(note, CopiedPairsWarning, stacklevel=checks.stack_level())


def _at_pairs(measured: Measurement) -> list[str]:
    """Return the names of T20 and T30 at every pair; [] of a mean, which T itself names."""
    if measured.is_summary:
        return []
    f = measured.centre_frequencies
    tables = {o.key: measured.values[o.key] for o in REVERBERATION if o.key in measured.values}
    return [repeats.of_pairs(key, measured.pairs, table, f) for key, table in tables.items()]


def copied(measured: Measurement) -> str:
    """Return a caution if T20 and T30 are the same numbers; "" else."""
    t20, t30 = (measured.values.get(o.key, np.full(1, np.nan)) for o in REVERBERATION)
    both = (
        np.isfinite(t20) & np.isfinite(t30) if t20.shape == t30.shape else np.zeros(1, dtype=bool)
    )
    if both.sum() < _FEW_VALUES or not np.array_equal(t20[both], t30[both]):
        return ""
    return (
        "T30 is T20 in every value, so one of them is a copy: whether the decay is bent is unknown"
    )


def no_times(room: Room) -> MeasuredTimes:
    """Return that no T was measured in any band: other observations alone are matched."""
    nothing = np.full(room.n_bands, np.nan)
    return MeasuredTimes(nothing, nothing, ("",) * room.n_bands, (), "", "")


def data_history(room: Room, data: MeasuredTimes) -> str:
    """Return the fingerprints of all data that the room was calibrated to, with these data."""
    before = [] if room.calibration is None else [room.calibration.measured]
    return " ".join([*before, data.fingerprint])


Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, repr=False)
class ProblemData:
    """One set of numbers for a problem of a fixed shape.

    The unknowns u are alpha, flattened row by row with the bands last, and then the further unknowns.
    The solver's unknowns x are whitened: u = centre + scale x. By default centre = mu and
    scale = sigma. A pinned unknown has its value as centre, and scale 0.

    Attributes
    ----------
    layout : Layout
    mu, sigma : array (size,)
        The prior.
    lower, upper : array (size,)
        The box.
    areas : array (n_configurations, n_rows)
        m²; 0 if a configuration lacks the material.
    gains : array (n_configurations, n_bands, n_further)
        m² of absorption that one unit of each further unknown adds.
    time : array (n_configurations, n_bands)
        Measured T in s, NaN where missing.
    target, target_uncertainty : array (n_configurations, n_bands)
        b and its standard uncertainty in m², NaN where missing.
    target_sensitivity : array (n_configurations, n_bands)
        |db/dT| in m²/s, infinite where T does not determine b (the peak of Kuttruff's equation).
    largest_target : array (n_configurations, 1)
        The largest b in m² that the equation can invert.
    equation : LinearEquation
        It turned T into b.
    rooms : tuple of Room
        The configurations.
    weights : tuple of float
        One per objective term.
    pinned : array (size,) of bool
        Unknowns fixed at ``centre`` for this solve.
    centre : array (size,)
    observed : mapping of term to Whitened
        The numbers of each `rtcal.terms.LinearObservations`.
    room_changes : array (n_changes, n_configurations * n_bands)
        `rtcal.acoustics.room_errors.target_changes` of all configurations, in m².
    common : float
        Relative standard deviation that all coefficients have in common.
    """

    layout: Layout
    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    areas: Array
    gains: Array
    time: Array
    target: Array
    target_uncertainty: Array
    target_sensitivity: Array
    largest_target: Array
    equation: LinearEquation
    rooms: tuple[Room, ...]
    weights: tuple[float, ...]
    pinned: Flags
    centre: Array
    observed: Mapping[object, Whitened] = field(default_factory=dict)
    room_changes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    common: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and value.flags.writeable:
                vars(self)[name] = read_only_view(value)

    def target_of(self, times: Array) -> Array:
        """Return b in m² for any T in s, both (n_configurations, n_bands)."""
        return np.array(
            [self.equation.target(room, t) for room, t in zip(self.rooms, times, strict=True)]
        )

    @cached_property
    def matched(self) -> Flags:
        """Where there is a target, (n_configurations, n_bands)."""
        return np.isfinite(self.target)

    @cached_property
    def scale(self) -> Array:
        """d u / d x, (size,)."""
        return np.where(self.pinned, 0.0, self.sigma)

    @cached_property
    def inverse_sigma(self) -> Array:
        """1 / sigma, 0 where sigma = 0, (size,)."""
        inverse = np.divide(1.0, self.sigma, out=np.zeros_like(self.sigma), where=self.sigma > 0)
        inverse.setflags(write=False)
        return inverse

    @cached_property
    def reachable_box(self) -> tuple[Array, Array]:
        """The box, (size,) each, in which a fixed unknown has its centre as both sides."""
        moves = self.scale > 0
        return (
            np.where(moves, self.lower, self.centre),
            np.where(moves, self.upper, self.centre),
        )

    @cached_property
    def match_scale(self) -> Array:
        """1 / |S sigma| over the unknowns that can move, (n_matches,); 0 where nothing is matched."""
        alpha, further = self.alpha(self.scale), self.further(self.scale)
        square = self.areas**2 @ alpha**2
        if self.gains.size:
            square = square + self.gains**2 @ further**2
        size = np.sqrt(square)
        inverse = np.divide(1.0, size, out=np.zeros_like(size), where=self.matched & (size > 0))
        inverse.setflags(write=False)
        return inverse.ravel()

    @cached_property
    def match_rows(self) -> Any:
        """S' over the unknowns, one row per configuration and band, 0 without T.

        An array where that is small, without scipy's overhead; else sparse.
        """
        layout = self.layout
        c, n, k = layout.n_configurations, layout.n_rows, layout.n_bands
        if not layout.further and (c * k) * (n * k) <= DENSE:
            matrix = np.zeros((c, k, n, k))
            values = np.where(self.matched[:, np.newaxis, :], self.areas[:, :, np.newaxis], 0.0)
            np.einsum("cknk->cnk", matrix)[...] = values  # a view of each band's own columns
            return matrix.reshape(c * k, n * k)
        areas = np.where(self.matched[:, :, np.newaxis], self.areas[:, np.newaxis, :], 0.0)
        columns = np.arange(n) * k + np.arange(k)[:, np.newaxis]
        columns = np.broadcast_to(columns, (c, k, n))
        starts = np.arange(0, c * k * n + 1, n)
        matrix = sp.csr_array((areas.ravel(), columns.ravel(), starts), shape=(c * k, n * k))
        if not layout.further:
            return matrix
        gains = np.where(self.matched[:, :, np.newaxis], self.gains, 0.0)
        return sp.csr_array(sp.hstack([matrix, sp.csr_array(gains.reshape(c * k, -1))]))

    @cached_property
    def target_covariance(self) -> Array:
        """Covariance of b - S'alpha in m⁴, (n_matches, n_matches); an unknown u_b counts as 0.

        The sum of that of b, through T, and of that through volume, areas and climate.
        """
        noise = np.diag(np.nan_to_num(self.target_uncertainty).ravel() ** 2)
        changes = self.room_changes
        return noise + changes.T @ changes if changes.size else noise

    @cached_property
    def match_whitener(self) -> Array:
        """W, lower triangular, with W'W the inverse of `target_covariance` over what is matched.

        Rows and columns without a match are 0. (n_matches, n_matches) in 1/m².
        """
        used = np.flatnonzero(self.matched.ravel())
        whitener = np.zeros_like(self.target_covariance)
        block = np.ix_(used, used)
        factor = np.linalg.cholesky(self.target_covariance[block])
        whitener[block] = np.tril(np.linalg.inv(factor))
        whitener.setflags(write=False)
        return whitener

    @cached_property
    def common_shift(self) -> Array:
        """Change of the unknowns by one standard deviation of all coefficients together, (size,)."""
        shift = np.where(self.sigma > 0, self.common * self.mu, 0.0)
        shift[self.layout.n_alpha :] = 0.0
        shift.setflags(write=False)
        return shift

    def __repr__(self) -> str:
        return f"<ProblemData: {self.layout!r}>"

    def alpha(self, u: Array) -> Array:
        """Return the absorption coefficients among the unknowns, (n_rows, n_bands)."""
        return u[: self.layout.n_alpha].reshape(self.layout.n_rows, self.layout.n_bands)

    def further(self, u: Array) -> Array:
        """Return the further unknowns, (n_further,)."""
        return u[self.layout.n_alpha :]

    def absorption_area(self, u: Array) -> Array:
        """Return S'alpha with the effects' absorption area in m², (n_configurations, n_bands)."""
        area = self.areas @ self.alpha(u)
        return np.asarray(area + self.gains @ self.further(u)) if self.gains.size else area

    def pin(self, where: Flags, values: Array) -> ProblemData:
        """Return the data with the unknowns at ``where`` fixed at ``values``."""
        return replace(
            self,
            pinned=self.pinned | where,
            centre=np.where(where, values, self.centre),
        )
