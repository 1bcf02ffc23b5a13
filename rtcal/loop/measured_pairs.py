"""The measured values of each position, ready to be matched, and their uncertainty.

What a measurement states is taken. Where it states no uncertainty, two parts are assumed. In a band
of bandwidth B a response is noise-like: the energy within dt scatters by 1 / sqrt(B dt), differently at
each pair, and every parameter follows. The second part is common to all pairs of a band: equipment and
evaluation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from rtcal.acoustics import bands
from rtcal.acoustics.bands import label
from rtcal.acoustics.marks import gap_jnd, rms
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import (
    EARLY,
    LEVEL,
    OBSERVABLES,
    REVERBERATION,
    TARGET,
    gradients,
    observable,
    parameter_label,
)
from rtcal.acoustics.room import Room, fingerprint, of_pairs, refuse_repeated_data
from rtcal.calibration.measured import copied, times_in_room
from rtcal.files.disk import json_numbers
from rtcal.simulators.base import Observations, checked_parameters
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence
from rtcal.support.types import Array, read_only

Pair = tuple[str, str]

_COMMON = 0.5
"""Share that all pairs of a team have in common, of what teams differ by at one pair
(`rtcal.acoustics.observables.Observable.between_teams`). Positions differed between teams, too."""
_LEAST = 1e-6
"""Least standard uncertainty that is taken, of a value's share or in dB. Covariances of smaller ones
cannot be factored."""
_OFFSET = 100.0
"""Standard deviation in dB of a source's unknown power: far more than any, so that it says nothing."""
T30_ALONE = "T30 is matched in place of T20, which was not measured."
_BINS = 4000
"""Bins of the exponential decay that stands for a noise-like response, over twice its T."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredPairs:
    """Measured observations in the simulator's pairs and the room's bands.

    Attributes
    ----------
    observations : Observations
        NaN where missing or left out. A relative level has the mean of the simulated one over each
        source's pairs, band by band: its own reference says nothing.
    covariance : array (n_used, n_used)
        Of the errors of the values that are there, in the order of ``values[used]``.
    level : {"absolute", "relative", ""}
        Whether G was measured, or levels that one source's positions share a reference of.
    notes : tuple of str
        What was left out, and why.
    fingerprints : tuple of str
        Names of the data, as a room's calibration keeps them: of all that was matched, and of the
        mean T.
    """

    observations: Observations
    covariance: Array
    level: str
    notes: tuple[str, ...]
    fingerprints: tuple[str, ...]

    @property
    def used(self) -> NDArray[np.bool_]:
        """Where there is a value, (n_parameters, n_pairs, n_bands)."""
        return np.isfinite(self.observations.values)

    def among(self, pairs: Sequence[Pair]) -> NDArray[np.int64]:
        """Return which of the values at all of a simulator's pairs are used, (n_used,).

        The pairs stand in the simulator's order, so the values used do, too.
        """
        n_parameters, _, n_bands = self.used.shape
        used = np.zeros((n_parameters, len(pairs), n_bands), dtype=bool)
        used[:, [pairs.index(pair) for pair in self.observations.pairs]] = self.used
        return np.flatnonzero(used)

    def residual(self, simulated: Observations) -> Array:
        """Return measured less simulated, (n_used,)."""
        off = self.observations.values - simulated.at(self.observations).values
        return np.asarray(off[self.used])

    def gap(self, simulated: Array) -> Array:
        """Return simulated less measured in JND, as `gap_at_pairs` does."""
        return gap_at_pairs(simulated, self.observations, relative=self.level == "relative")


def gap_at_pairs(simulated: Array, measured: Observations, *, relative: bool) -> Array:
    """Return simulated values, as observed, less measured in JND, (n_parameters, n_pairs, n_bands).

    A relative level has its mean over each source's pairs taken off.
    """
    gaps = []
    for name, values in zip(measured.parameters, simulated, strict=True):
        model, wanted = observable(name).natural(values), measured.natural(name)
        if name == LEVEL.key and relative:
            model = with_reference(model, wanted, measured.pairs)
        gaps.append(gap_jnd(model, wanted, name))
    return np.reshape(gaps, measured.values.shape)


def with_t30(match: Sequence[str], measured: Measurement) -> tuple[str, ...]:
    """Return the parameters, with T30 in place of T20 where T30 alone was measured."""
    names = checked_parameters(match)
    known = [o.key for o in REVERBERATION if np.isfinite(measured.mean(o.key)).any()]
    if TARGET.key in known or not known or known[0] in names:
        return names
    return tuple(known[0] if p == TARGET.key else p for p in names)


def pairs_to_match(
    room: Room,
    measured: Measurement,
    match: Sequence[str],
    simulated: Observations,
    exclude: Sequence[Pair] = (),
) -> MeasuredPairs:
    """Return what was measured at the simulator's pairs, without those of ``exclude``.

    ``simulated`` is the simulated values with the prior: its pairs, the direct sound, and the
    reference of the level.

    Raises
    ------
    DataError
        If the measurement is a summary over pairs, if no pair is the simulator's, if none of the
        parameters was measured, if ``exclude`` names a pair that was not measured, or for a stated
        uncertainty below a millionth.
    """
    if measured.is_summary:
        raise DataError(
            "the measurement is a mean over pairs; to match every position it needs a row for each "
            'source and receiver. match=("t20",) matches the mean'
        )
    measured.refuse_large_uncertainty()
    notes, pairs = [], simulated.pairs
    refuse_unknown(exclude, measured)
    kept = tuple(p for p in pairs if p in measured.pairs and p not in exclude)
    if not kept:
        raise DataError(
            f"no pair is left: the measurement has {_names(measured.pairs)}, the simulator "
            f"{_names(pairs)}" + (f", and {_names(exclude)} is excluded" if exclude else "")
        )
    if exclude:
        notes.append(left_out(exclude))
    wanted = room.centre_frequencies
    in_room = measured.in_bands(wanted)
    times = any(observable(name).logarithmic for name in match)
    what = "T" if times else "What was measured"
    notes += map(as_sentence, bands.notes(measured.centre_frequencies, wanted, what))
    level = ""
    if LEVEL.key in match:
        level = "relative" if LEVEL.key in measured.values else "absolute"
        if LEVEL.key_in(measured.values) not in measured.values:
            level = ""
    observations = Observations.of_measurement(in_room, match, kept)
    absent = [
        p
        for p, of_parameter in zip(match, observations.values, strict=True)
        if np.isnan(of_parameter).all()
    ]
    if len(absent) == len(match):
        raise DataError(
            f"the measurement has none of {', '.join(map(parameter_label, match))} at the "
            "simulator's pairs"
        )
    if absent:
        notes.append(
            f"Left out, since it was not measured: {', '.join(map(parameter_label, absent))}."
        )
        present = [p for p in match if p not in absent]
        observations = Observations.of_measurement(in_room, present, kept)
    missing = np.count_nonzero(np.isnan(observations.values))
    if missing:
        notes.append(f"Left out, since missing: {missing} of {observations.values.size} values.")
    if all(o.key in observations.parameters for o in REVERBERATION) and (copy := copied(measured)):
        notes.append(f"{copy}. Both are matched, and count twice: leave one out of match.")
    if LEVEL.key in absent:
        level = ""
    compared = observations
    if level == "relative":
        row = observations.parameters.index(LEVEL.key)
        columns = [simulated.pairs.index(pair) for pair in kept]
        levels = simulated.values[simulated.parameters.index(LEVEL.key)][columns]
        compared = _with_level(observations, with_reference(observations.values[row], levels, kept))
        # Whatever the reference, the same data have the same name: by distances from their own mean.
        own = with_reference(observations.values[row], np.zeros_like(levels), kept)
        observations = _with_level(observations, np.abs(own))
    return MeasuredPairs(
        observations=compared,
        covariance=_covariance(compared, in_room, level, simulated),
        level=level,
        notes=tuple(notes),
        fingerprints=fingerprints(room, observations, measured),
    )


def without_place(measured: Measurement, pairs: Sequence[Pair]) -> list[str]:
    """Return a note of the measured pairs that the simulator lacks; none without any."""
    unknown = [p for p in measured.pairs if p not in pairs]
    if not unknown:
        return []
    return [f"Left out, since the simulator has no such pair: {_names(unknown)}."]


def refuse_unknown(exclude: Sequence[Pair], measured: Measurement) -> None:
    """Raise DataError if a pair that is to be left out was not measured."""
    for pair in exclude:
        if pair not in measured.pairs:
            raise DataError(f"exclude has {' to '.join(pair)}, which the measurement lacks")


def left_out(exclude: Sequence[Pair]) -> str:
    """Return a note of the pairs that were left out."""
    return f"Left out, as asked for: {_names(exclude)}."


def with_reference(levels: Array, like: Array, pairs: Sequence[Pair]) -> Array:
    """Return levels (n_pairs, n_bands) with the mean of others over each source's pairs.

    The mean of a band counts the pairs at which both are known.
    """
    off = levels - like
    out = levels.copy()
    for source in {s for s, _ in pairs}:
        rows = [i for i, (s, _) in enumerate(pairs) if s == source]
        known = np.isfinite(off[rows])
        total = np.where(known, off[rows], 0.0).sum(axis=0)
        out[rows] -= total / np.maximum(known.sum(axis=0), 1)
    return out


def _with_level(observations: Observations, levels: Array) -> Observations:
    values = observations.values.copy()
    values[observations.parameters.index(LEVEL.key)] = levels
    return replace(observations, values=values)


def fingerprints(room: Room, observations: Observations, measured: Measurement) -> tuple[str, ...]:
    """Return the names of the data; DataError if the room was calibrated on some of them.

    A relative level has no name at every pair: alone it is 0, and its mean changes with the pairs.
    """
    means = {
        f"{p}-{f:g}": float(np.nanmean(values)) if np.isfinite(values).any() else np.nan
        for p, of_parameter in zip(observations.parameters, observations.values, strict=True)
        for f, values in zip(observations.centre_frequencies, of_parameter.T, strict=True)
    }
    names = [fingerprint("pairs", means)]
    if {o.key for o in REVERBERATION} & set(measured.values):
        names += times_in_room(room, measured).fingerprint.split()
    names += [
        of_pairs(p, observations.pairs, of_parameter, observations.centre_frequencies)
        for p, of_parameter in zip(observations.parameters, observations.values, strict=True)
        if p != LEVEL.key
    ]
    names = list(dict.fromkeys(names))
    refuse_repeated_data(room, *names)
    return tuple(names)


def refuse_known(
    room: Room, measured: Measurement, match: Sequence[str], kept: Sequence[Pair]
) -> None:
    """Raise DataError if the room was calibrated on what is matched at the kept pairs."""
    if room.calibration is None or not kept or measured.is_summary:
        return
    in_room = measured.in_bands(room.centre_frequencies)
    named = [p for p in match if p in in_room.values and p != LEVEL.key]
    fingerprints(room, Observations.of_measurement(in_room, named, kept), measured)


def history(room: Room) -> list[str]:
    """Return the names of the data that a room was calibrated on."""
    return [] if room.calibration is None else room.calibration.measured.split()


def _names(pairs: Sequence[Pair]) -> str:
    return ", ".join(" to ".join(pair) for pair in pairs)


def _covariance(
    observations: Observations, measured: Measurement, level: str, simulated: Observations
) -> Array:
    """Return the covariance of the measurement's errors, over the values that are there."""
    parameters, pairs = observations.parameters, observations.pairs
    frequencies = observations.centre_frequencies
    shape = observations.values.shape
    _, n_pairs, n_bands = shape
    full = np.zeros((*shape, *shape))
    times = np.full(n_bands, np.nan)
    for name, kind in OBSERVABLES.items():  # the first that tells it
        times = np.where(np.isfinite(times), times, kind.decay_time(measured.mean(name)))
    times = np.where(np.isfinite(times), times, 1.0)
    assumed = _COMMON * np.array([observable(p).between_teams(frequencies) for p in parameters])
    alone = _stated(observations, measured, measured.uncertainty)
    common = _stated(observations, measured, measured.common_uncertainty)
    if (small := alone < _LEAST).any():
        p, i, k = np.argwhere(small)[0]
        raise DataError(
            f"the uncertainty of {parameter_label(parameters[p])} at {' to '.join(pairs[i])}, "
            f"{bands.label(frequencies[k])}, is {alone[p, i, k]:.1g} of the value or dB, below "
            f"{_LEAST:g}: no measurement is so sure"
        )
    of_team = np.where(np.isfinite(alone), 0.0, assumed[:, np.newaxis])
    shared = np.where(np.isfinite(common), common, of_team)
    direct = np.zeros((n_pairs, n_bands))
    if simulated.direct is not None:
        direct = simulated.direct[[simulated.pairs.index(pair) for pair in pairs]]
    for k in range(n_bands):
        bandwidth = float(bands.bandwidth_factor(frequencies) * frequencies[k])
        noise = response_noise(parameters, times[k], bandwidth, direct[:, k])
        for i in range(n_pairs):
            full[:, i, k, :, i, k] = noise[i]
    for p, i, k in np.argwhere(np.isfinite(alone)):
        full[p, i, k] = 0.0
        full[:, :, :, p, i, k] = 0.0
        full[p, i, k, p, i, k] = alone[p, i, k] ** 2
    for p, k in np.ndindex(len(parameters), n_bands):
        full[p, :, k, p, :, k] += np.outer(shared[p, :, k], shared[p, :, k])
    if level == "relative" and LEVEL.key in parameters:
        p = parameters.index(LEVEL.key)
        sources = np.array([s for s, _ in pairs])
        same = (sources[:, np.newaxis] == sources).astype(float)
        for k in range(n_bands):
            full[p, :, k, p, :, k] += _OFFSET**2 * same
    used = np.isfinite(observations.values).ravel()
    size = observations.values.size
    return np.asarray(full.reshape(size, size)[np.ix_(used, used)])


def _stated(
    observations: Observations, measured: Measurement, uncertainty: Mapping[str, Array]
) -> Array:
    """Return stated standard uncertainties in the observations' units and shape; NaN where none is."""
    rows = [measured.pairs.index(pair) for pair in observations.pairs]
    stated = np.full(observations.values.shape, np.nan)
    for p, name in enumerate(observations.parameters):
        kind = observable(name)
        key = kind.key_in(measured.values)
        if key in uncertainty:
            each = uncertainty[key]  # per pair and band, or per band
            each = each[rows] if each.ndim == 2 else each
            stated[p] = kind.of_observed(each, measured.values[key][rows])
    return stated


def response_noise(
    parameters: Sequence[str],
    decay_time: float,
    bandwidth: float,
    direct: ArrayLike = 0.0,
) -> Array:
    """Return the covariance of the parameters of noise-like responses, (..., n_parameters twice).

    A response is the direct sound, with the share ``direct`` (...) of the energy, and an exponential
    decay with ``decay_time`` in s. In a band of ``bandwidth`` in Hz the energy of the decay in a bin
    has the relative variance 1 / (bandwidth width). ISO 3382-2's standard deviation of T20 is nearly
    the same as this one.

    Examples
    --------
    >>> noise = response_noise(["t20", "level"], 1.0, 710.0)
    >>> print(np.sqrt(np.diag(noise)).round(3))
    [0.033 0.428]
    """
    width = 2 * decay_time / _BINS
    share = np.asarray(direct, dtype=float)[..., np.newaxis]
    decay = np.asarray(10.0 ** (-6 * np.arange(_BINS) * width / decay_time))
    reverberant = (1 - share) * decay / decay.sum()
    energy = reverberant.copy()
    energy[..., :1] += share
    by_bin = gradients(energy, width, parameters) * reverberant
    return np.asarray(np.einsum("p...b,q...b->...pq", by_bin, by_bin)) / (bandwidth * width)


def of_level(parameters: Sequence[str], n_pairs: int, n_bands: int) -> NDArray[np.bool_]:
    """Return which values are levels, (n_parameters * n_pairs * n_bands,)."""
    return np.repeat([observable(p).part == "level" for p in parameters], n_pairs * n_bands)


def by_band(slopes: Array) -> Array:
    """Return derivatives (p, i, k, m) by alpha of the same band as (p * i * k, m * k)."""
    full = np.einsum("pikm,kl->pikml", slopes, np.eye(slopes.shape[2]))
    return np.asarray(full.reshape(slopes[..., 0].size, -1))


CONTRADICTION = 0.001
"""Probability, divided among the pairs, below which a pair contradicts all others; and, divided among
the bands, of a T that is farther than the stated coefficients explain."""


def rows_of_pairs(used: NDArray[np.bool_]) -> list[Any]:
    """Return the rows of each pair among the values used; ``used`` (n_parameters, n_pairs, n_bands)."""
    pair = np.broadcast_to(np.arange(used.shape[1])[:, np.newaxis], used.shape)[used]
    return [np.flatnonzero(pair == i) for i in range(used.shape[1])]


_REACH = 2.0
"""Standard deviations of the stated coefficients that a sentence counts as within reach."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BeyondPrior:
    """A measured T that the stated coefficients, within their sigma, do not explain.

    Attributes
    ----------
    parameter : str
        Which T: that which was matched.
    frequency : float
        Band in Hz in which it is farthest.
    measured, simulated, reached : float
        Means over the pairs in s: measured, simulated with the stated coefficients, and with all of
        them two sigma towards what was measured.
    stated, needed : float
        Mean coefficient over the areas, as stated, and with the absorption that gives the measured T.
    z : float
        The difference over its standard deviation.
    bands, of_bands : int
        Bands that are as far, and bands with a measured T.
    """

    parameter: str
    frequency: float
    measured: float
    simulated: float
    reached: float
    stated: float
    needed: float
    z: float
    bands: int
    of_bands: int

    def __str__(self) -> str:
        name = parameter_label(self.parameter)
        ratio = self.simulated / self.measured
        times = f"{ratio:.1f} times as long" if ratio > 1 else f"{1 / ratio:.1f} times shorter"
        sigma = abs(self.z) / _REACH
        needed = (
            f"a mean coefficient of {self.needed:.2f} where {self.stated:.2f} is stated"
            if self.needed > 0
            else "a mean coefficient below 0"
        )
        return (
            f"The stated coefficients and their sigma cannot explain the measured {name}: at "
            f"{label(self.frequency)} it is {self.measured:.2f} s, the simulation of the stated room "
            f"has {self.simulated:.2f} s, {times}, and coefficients within {_REACH:g} sigma reach "
            f"{self.reached:.2f} s ({self.bands} of {self.of_bands} bands are beyond). Needed would be "
            f"{needed}, {abs(self.z):.0f} standard deviations away: state a sigma "
            f"{sigma:.0f} times as large where the coefficients are guesses, or look for what the room "
            "lacks (rtcal find)."
        )


def beyond_prior(model: Any, room: Room, prior: Array, error: Array) -> BeyondPrior | None:
    """Return how far the measured T is from the stated coefficients; None if they explain it.

    T20 or T30 is judged, else EDT. Absorption is inverse to T, so that T itself says how much more is
    needed, also where the derivatives at the stated coefficients do not reach so far. They say how
    uncertain the stated absorption is.

    Parameters
    ----------
    model : rtcal.loop.positions.PairsModel
    room : Room
        With the stated coefficients.
    prior : array (n_unknowns, n_unknowns)
    error : array (n, n)
        Covariance of the simulator's error, of all values.
    """
    data, parameters = model.data, model.data.observations.parameters
    known = [o.key for o in (*REVERBERATION, EARLY) if o.key in parameters]
    if not known:
        return None
    parameter, _, band = np.nonzero(data.used)
    rows = np.flatnonzero(parameter == parameters.index(known[0]))
    bands = np.unique(band[rows])
    weight = (band[rows] == bands[:, np.newaxis]).astype(float)
    weight /= weight.sum(axis=1, keepdims=True)
    goal = np.exp(weight @ data.observations.values[data.used][rows])
    has = np.exp(weight @ model.values(room.alpha)[data.used][rows])
    more = has / goal - 1
    slopes, own = weight @ model.jacobian(room.alpha)[rows], model.used[rows]
    errors = data.covariance[np.ix_(rows, rows)] + error[np.ix_(own, own)]
    of_stated = np.sqrt(np.einsum("ku,uv,kv->k", slopes, prior, slopes))
    of_mean = np.sqrt(np.einsum("kr,rs,ks->k", weight, errors, weight))
    z = more / np.hypot(of_stated, (1 + more) * of_mean)
    beyond = np.abs(z) > norm.isf(CONTRADICTION / 2 / max(len(bands), 1))
    if not beyond.any():
        return None
    worst = int(np.argmax(np.abs(z)))
    k = bands[worst]
    area = room.areas @ room.alpha[:, k]
    whole = area + 4 * room.air_attenuation[k] * room.volume
    limit = 1 + np.sign(more[worst]) * _REACH * of_stated[worst]
    return BeyondPrior(
        parameter=known[0],
        frequency=float(room.centre_frequencies[k]),
        measured=float(goal[worst]),
        simulated=float(has[worst]),
        reached=float(has[worst] / limit),
        stated=float(area / room.total_area),
        needed=float((area + more[worst] * whole) / room.total_area),
        z=float(z[worst]),
        bands=int(beyond.sum()),
        of_bands=len(bands),
    )


SHOWN = tuple(key for key, kind in OBSERVABLES.items() if kind.shown)
"""Parameters that are shown before and after, fitted or not."""
_LEFT = 1.0
"""JND by which a gap grows in some band where a parameter left what was measured."""

Gaps = Mapping[str, tuple[Array, Array]]
"""Gaps before and after in JND by parameter, each (n_bands,)."""


def means(measurement: Measurement) -> dict[str, Array]:
    """Return the means over pairs of the parameters that are shown and there, each (n_bands,)."""
    found = {p: read_only(measurement.mean(p)) for p in SHOWN}
    return {p: mean for p, mean in found.items() if np.isfinite(mean).any()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Compared:
    """Parameters at positions, matched or not: measured, before and after.

    Attributes
    ----------
    measured, before, after : Observations
        Of the same parameters and pairs.
    relative : bool
        Whether the measured level has a reference of its own.
    """

    measured: Observations
    before: Observations
    after: Observations
    relative: bool = False

    @classmethod
    def of(
        cls,
        measured: Measurement,
        parameters: Sequence[str],
        pairs: Sequence[Pair],
        before: Observations,
        after: Observations,
    ) -> Compared:
        """Return some parameters at some pairs, where they were measured and simulated."""
        kept = [pair for pair in pairs if pair in before.pairs]
        values = Observations.of_measurement(measured, parameters, kept)
        there = [p for p in parameters if np.isfinite(values.natural(p)).any()]
        wanted = Observations.of_measurement(measured, there, kept)
        return cls(measured=wanted, before=before.at(wanted), after=after.at(wanted))

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were measured."""
        return self.measured.parameters

    @property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return gap_at_pairs(self.before.values, self.measured, relative=self.relative)

    @property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return gap_at_pairs(self.after.values, self.measured, relative=self.relative)

    @property
    def gaps(self) -> Gaps:
        """Root mean squares over the pairs."""
        ends = zip(self.parameters, self.gap_before, self.gap_after, strict=True)
        return {p: (rms(before, axis=0), rms(after, axis=0)) for p, before, after in ends}

    def to_dict(self) -> dict[str, Any]:
        """Return parameters, pairs, values in their units, and gaps, as plain numbers and text."""
        ends = {"measured": self.measured, "before": self.before, "after": self.after}
        found: dict[str, Any] = json_numbers(
            {
                "parameters": self.parameters,
                "pairs": self.measured.pairs,
                **{n: [of.natural(p) for p in self.parameters] for n, of in ends.items()},
                "gap_before_jnd": self.gap_before,
                "gap_after_jnd": self.gap_after,
            }
        )
        return found


def left(gaps: Gaps) -> tuple[str, ...]:
    """Return the parameters that left what was measured, in some band by more than one JND."""
    return tuple(
        parameter
        for parameter, (before, after) in gaps.items()
        if (np.abs(after) > np.abs(before) + _LEFT).any()
    )


def sentences(gaps: Gaps, frequencies: Array) -> Iterator[str]:
    """Yield by how much each parameter of `left` left what was measured, in its worst band."""
    for parameter in left(gaps):
        before, after = (np.abs(gap) for gap in gaps[parameter])
        k = int(np.nanargmax(after - before))
        yield (
            f"{parameter_label(parameter)}, which was not fitted, left what was measured: by "
            f"{before[k]:.1f} JND before and {after[k]:.1f} JND after, at {label(frequencies[k])}. "
            "Match it at every position, or look for what the model misses (rtcal find)."
        )
