"""What is measured at each position and how it may err, and how the simulator may.

Stated uncertainties are taken. Where a measurement states none, two are assumed: in a band of bandwidth
B a response is noise-like, so that the energy within dt scatters by 1 / sqrt(B dt), differently at each
pair; and equipment and evaluation add an error that is common to all pairs of a band.

The simulator's own error is that of reference simulations in the room's own geometry. Each is a path
tracing of the room in which everything differs that is not known: how the walls scatter, where sources
and receivers stand, the random numbers, and alpha, which is drawn from the prior. Its values less the
simulator's for the same alpha are an error as the simulator may have against the real room.

No input states how a room scatters as a tracer takes it. The traced paths give the dependence of every
observation on the scattering of each material (`PathTracing.scattering_jacobian`), so the scattering
coefficients are unknowns as alpha is, with a wide prior around the input. A first linear step fits them
to the measurement, the room is traced once more with them, and the calibration goes on from there.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from rtcal.acoustics import bands, observables
from rtcal.acoustics.bands import label
from rtcal.acoustics.equations import Eyring
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
from rtcal.acoustics.room import (
    POSITION,
    Room,
    checked_uncertainty,
    fingerprint,
    of_pairs,
    plain_directivities,
    refuse_repeated_data,
)
from rtcal.calibration.measured import copied, times_in_room
from rtcal.files import disk
from rtcal.files.disk import json_numbers
from rtcal.simulators.base import Observations, Simulator, checked_parameters, complete, observe
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import DENSER, PathTracing, ScatteringModel, eyring_seconds
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError, RtcalError
from rtcal.support.speed import Progress
from rtcal.support.text import as_sentence
from rtcal.support.types import Array, put, read_only
from rtcal.support.workers import workforce

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
    """Hold the measurement at the simulator's source-receiver pairs, in the room's bands.

    ``observations`` are NaN where missing or left out. The reference of a relative level is unknown.
    Therefore the measured level is shifted so that its mean over each source's pairs equals that of the
    simulated level in each band. ``fingerprints`` are texts with which a calibrated room identifies the
    data to which it was calibrated: one for all matched values, and one for the mean T.

    ``covariance`` (n_used, n_used) is that of the errors of the values used. ``level`` is "absolute"
    for G, "relative" for levels with one reference per source, "" without a level. ``notes`` are
    sentences on what was left out.
    """

    observations: Observations
    covariance: Array
    level: str
    notes: tuple[str, ...]
    fingerprints: tuple[str, ...]

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Whether a value was measured and is used, (n_parameters, n_pairs, n_bands)."""
        return np.isfinite(self.observations.values)

    def among(self, pairs: Sequence[Pair]) -> NDArray[np.int64]:
        """Return the indices of the used values among all values of a simulator, (n_used,).

        The simulator's values are counted by parameter, by its ``pairs`` and by band, in this order.
        """
        n_parameters, _, n_bands = self.used.shape
        used = np.zeros((n_parameters, len(pairs), n_bands), dtype=bool)
        used[:, [pairs.index(pair) for pair in self.observations.pairs]] = self.used
        return np.flatnonzero(used)

    def residual(self, simulated: Observations) -> Array:
        """Return the measured minus the simulated values that are used, (n_used,)."""
        off = self.observations.values - simulated.at(self.observations).values
        return np.asarray(off[self.used])

    def gap(self, simulated: Array) -> Array:
        """Return the simulated minus the measured values in JND, as `gap_at_pairs` does."""
        return gap_at_pairs(simulated, self.observations, relative=self.level == "relative")


def gap_at_pairs(simulated: Array, measured: Observations, *, relative: bool) -> Array:
    """Return simulated minus measured values in JND, (n_parameters, n_pairs, n_bands).

    Both contain the logarithms of decay times. If the level is ``relative``, the mean of its deviation
    over each source's pairs is subtracted.
    """
    gaps = []
    for name, values in zip(measured.parameters, simulated, strict=True):
        model, wanted = observable(name).natural(values), measured.natural(name)
        if name == LEVEL.key and relative:
            model = _with_reference(model, wanted, measured.pairs)
        gaps.append(gap_jnd(model, wanted, name))
    return np.reshape(gaps, measured.values.shape)


def with_t30(match: Sequence[str], *data: Measurement) -> tuple[str, ...]:
    """Return the parameters, with T30 in place of T20 if all ``data`` have T30 but not all have T20."""
    names = checked_parameters(match)
    known = [o.key for o in REVERBERATION if all(np.isfinite(m.mean(o.key)).any() for m in data)]
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
    """Return the measurement at the simulator's pairs, without the pairs of ``exclude``.

    ``match`` are the parameters. ``simulated`` are the values with the input coefficients, from which
    the pairs and the reference of the level are taken. Raises DataError for means over pairs, if no
    pair or no parameter is shared with the simulator, for a pair of ``exclude`` that was not measured,
    and for an uncertainty below a millionth.
    """
    if measured.is_summary:
        raise DataError(
            "the measurement is a mean over pairs, but matching every position needs a row for "
            'each source and receiver. Use match=("t20",) to match the mean'
        )
    measured.refuse_other_units()
    refuse_unknown(exclude, measured)
    kept = tuple(p for p in simulated.pairs if p in measured.pairs and p not in exclude)
    if not kept:
        raise DataError(
            "no pair is both measured and simulated: the measurement has "
            f"{_names(measured.pairs)}, the simulator {_names(simulated.pairs)}"
            + (f", and {_names(exclude)} is excluded" if exclude else "")
        )
    notes, wanted = [left_out(exclude)] if exclude else [], room.centre_frequencies
    what = "T" if any(observable(name).logarithmic for name in match) else "What was measured"
    notes += map(as_sentence, bands.notes(measured.centre_frequencies, wanted, what))
    in_room = measured.in_bands(wanted)
    every = Observations.of_measurement(in_room, match, kept)
    present = [p for p in match if np.isfinite(every.natural(p)).any()]
    absent = [p for p in match if p not in present]
    of_absent = ", ".join(map(parameter_label, absent))
    if not present:
        raise DataError(f"the measurement has none of {of_absent} at the simulator's pairs")
    if absent:
        notes.append(f"Not matched, because it was not measured: {of_absent}.")
    observations = Observations.of_measurement(in_room, present, kept)
    if missing := np.count_nonzero(np.isnan(observations.values)):
        notes.append(f"Of {observations.values.size} values {missing} are missing, and left out.")
    if all(o.key in present for o in REVERBERATION) and (copy := copied(measured)):
        notes.append(f"{copy}. Both are matched, and count twice: leave one out of match.")
    level, identified = "", observations
    if LEVEL.key in present:
        level = "relative" if LEVEL.key in measured.values else "absolute"
    if level == "relative":
        row = present.index(LEVEL.key)
        levels, like = (of.values[row] for of in (observations, simulated.at(observations)))
        observations = _with_level(observations, _with_reference(levels, like, kept))
        # Whatever the reference, the same data have the same name: by distances from their own mean.
        own = _with_reference(levels, np.zeros_like(levels), kept)
        identified = _with_level(identified, np.abs(own))
    return MeasuredPairs(
        observations=observations,
        covariance=_covariance(observations, in_room, level, simulated),
        level=level,
        notes=tuple(notes),
        fingerprints=fingerprints(room, identified, measured),
    )


def without_place(measured: Measurement, pairs: Sequence[Pair]) -> list[str]:
    """Return a note on measured pairs that the simulator lacks; an empty list without any."""
    names = _names([pair for pair in measured.pairs if pair not in pairs])
    return [f"Measured, but left out as pairs that the simulator lacks: {names}."] if names else []


def refuse_unknown(exclude: Sequence[Pair], measured: Measurement) -> None:
    """Raise DataError if a pair that is to be left out was not measured."""
    for pair in exclude:
        if pair not in measured.pairs:
            raise DataError(f"exclude has {' to '.join(pair)}, which is not in the measurement")


def left_out(exclude: Sequence[Pair]) -> str:
    """Return a note on the pairs that were left out."""
    return f"Left out, as asked for: {_names(exclude)}."


def _with_reference(levels: Array, like: Array, pairs: Sequence[Pair]) -> Array:
    """Return levels (n_pairs, n_bands) in dB with the same reference as the levels ``like``.

    The levels are shifted so that both means over each source's pairs, where both are known, are equal
    in each band.
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
    """Return texts that identify the matched data: ``observations`` at pairs, and the mean T.

    Raises DataError if the room was already calibrated to some of the data. A single pair's relative
    level has no text of its own, because its value depends on which pairs are used.
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
    """Raise DataError if the room was already calibrated to the matched values at the kept pairs."""
    if room.calibration is None or not kept or measured.is_summary:
        return
    in_room = measured.in_bands(room.centre_frequencies)
    named = [p for p in match if p in in_room.values and p != LEVEL.key]
    fingerprints(room, Observations.of_measurement(in_room, named, kept), measured)


def history(room: Room) -> list[str]:
    """Return the fingerprints of the data to which a room was calibrated."""
    return [] if room.calibration is None else room.calibration.measured.split()


def _names(pairs: Sequence[Pair]) -> str:
    return ", ".join(" to ".join(pair) for pair in pairs)


def _covariance(
    observations: Observations, measured: Measurement, level: str, simulated: Observations
) -> Array:
    """Return the covariance of the measurement's errors, over the values that are there."""
    parameters, pairs = observations.parameters, observations.pairs
    frequencies, shape = observations.centre_frequencies, observations.values.shape
    n_parameters, n_pairs, n_bands = shape
    alone = stated_uncertainty(observations, measured, measured.uncertainty)
    common = stated_uncertainty(observations, measured, measured.common_uncertainty)
    if (small := alone < _LEAST).any():
        p, i, k = np.argwhere(small)[0]
        raise DataError(
            f"the uncertainty of {parameter_label(parameters[p])} at "
            f"{' to '.join(pairs[i])}, {bands.label(frequencies[k])}, is "
            f"{alone[p, i, k]:.1g} (of the value, or in dB), but no measurement has less "
            f"than {_LEAST:g}; give the measured uncertainty"
        )
    times = np.full(n_bands, np.nan)
    for name, kind in OBSERVABLES.items():  # the first that has one
        times = np.where(np.isfinite(times), times, kind.decay_time(measured.mean(name)))
    times = np.where(np.isfinite(times), times, 1.0)
    assumed = _COMMON * np.array([observable(p).between_teams(frequencies) for p in parameters])
    of_team = np.where(np.isfinite(alone), 0.0, assumed[:, np.newaxis])
    shared = np.where(np.isfinite(common), common, of_team)
    direct = np.zeros((n_pairs, n_bands))
    if simulated.direct is not None:
        direct = simulated.direct[[simulated.pairs.index(pair) for pair in pairs]]
    widths = bands.bandwidth_factor(frequencies) * frequencies
    same_source = np.equal.outer(*[np.array([source for source, _ in pairs])] * 2)
    is_level = np.array([level == "relative" and p == LEVEL.key for p in parameters])
    full = np.zeros((*shape, *shape))
    for k in range(n_bands):
        noise = response_noise(parameters, times[k], float(widths[k]), direct[:, k])
        own = np.einsum("ipq,ij->piqj", noise, np.eye(n_pairs))
        stated = np.isfinite(alone[:, :, k])
        own[stated] = own[:, :, stated] = 0.0
        own[stated, stated] = alone[stated, k] ** 2
        between = np.einsum("pi,pj->pij", shared[:, :, k], shared[:, :, k])
        between += np.multiply.outer(is_level, _OFFSET**2 * same_source)
        own += np.einsum("pij,pq->piqj", between, np.eye(n_parameters))
        full[:, :, k, :, :, k] = own
    used = np.isfinite(observations.values).ravel()
    size = observations.values.size
    return np.asarray(full.reshape(size, size)[np.ix_(used, used)])


def stated_uncertainty(
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
    """Return the covariance of parameters of noise-like responses, (..., n_parameters, n_parameters).

    A response is the direct sound, with the share ``direct`` (...) of the energy, and an exponential
    decay with ``decay_time`` in s. In a band of ``bandwidth`` in Hz, the energy of the decay in a time
    interval has the relative variance 1 / (bandwidth times length of the interval). The standard
    deviation of T20 is nearly that of ISO 3382-2.
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
    """Return derivatives by alpha as a matrix, (p * i * k, m * k).

    ``slopes`` (p, i, k, m) are the derivatives of p parameters at i pairs in k bands by the alpha of m
    materials in the same band; those by other bands are 0.
    """
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
_POSSIBLE = 0.9
"""Largest mean coefficient that a room may have, for the advice of a sentence."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BeyondPrior:
    """Hold a measured T that the input coefficients cannot explain within their sigma.

    ``parameter`` is the name of T, and ``frequency`` in Hz is the band in which T is farthest from the
    input. ``measured``, ``simulated`` and ``reached`` are means of T over the pairs in s: measured,
    simulated with the input coefficients, and simulated with all coefficients two sigma nearer to the
    measured T. ``stated`` is the area-weighted mean of the input coefficients, and ``needed`` the mean
    that gives the measured T. ``z`` is their difference over its standard deviation. ``bands`` is the
    number of bands whose T the input cannot explain, out of ``of_bands`` bands with T.
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
        name, sigma = parameter_label(self.parameter), abs(self.z)
        needed = f"of {self.needed:.2f} instead of the input's {self.stated:.2f}"
        larger = f"{sigma / _REACH:.0f} times as large"
        if self.reached == self.simulated:  # a sigma of 0, which no factor makes larger
            larger = "above 0"
        advice = f"Enter a sigma {larger} if the coefficients are guesses"
        if not 0 < self.needed < _POSSIBLE:
            needed = "below 0" if self.needed <= 0 else f"above {_POSSIBLE}"
            advice = "Check the unit of T and the size of the room"
        return (
            f"The input coefficients and their sigma cannot explain the measured {name} in "
            f"{self.bands} of {self.of_bands} bands. At {label(self.frequency)} the measured {name} is "
            f"{self.measured:.2f} s. The simulation with the input coefficients has "
            f"{self.simulated:.2f} s, and coefficients within {_REACH:g} sigma of the input reach "
            f"{self.reached:.2f} s. The measured {name} requires a mean coefficient {needed}, which is "
            f"{sigma:.0f} sigma away. {advice}, or look for what is missing from the model "
            "(`rtcal find`)."
        )


def beyond_prior(model: Any, room: Room, prior: Array, error: Array) -> BeyondPrior | None:
    """Return the T that deviates most from the input, or None if the input explains every measured T.

    T is T20 or T30, or else EDT. ``model`` is a `rtcal.loop.positions.PairsModel`, and ``room`` has the
    input coefficients. ``prior`` (n_unknowns, n_unknowns) is their covariance, and ``error`` (n, n) is
    that of the simulator's values.
    """
    data, parameters = model.data, model.data.observations.parameters
    known = [o.key for o in (*REVERBERATION, EARLY) if o.key in parameters]
    if not known:
        return None
    parameter, _, band = np.nonzero(data.used)
    rows = np.flatnonzero(parameter == parameters.index(known[0]))
    bands = np.unique(band[rows])
    weight = (band[rows] == bands[:, np.newaxis]).astype(float)
    weight /= weight.sum(axis=1, keepdims=True)  # means over the pairs of each band
    goal, has = (
        np.exp(weight @ values[data.used][rows])
        for values in (data.observations.values, model.values(room.alpha))
    )
    more = has / goal - 1
    slopes, own = weight @ model.jacobian(room.alpha)[rows], model.used[rows]
    errors = data.covariance[np.ix_(rows, rows)] + error[np.ix_(own, own)]
    of_stated = np.sqrt(np.einsum("ku,uv,kv->k", slopes, prior, slopes))
    of_mean = np.sqrt(np.einsum("kr,rs,ks->k", weight, errors, weight))
    z = more / np.hypot(of_stated, (1 + more) * of_mean)
    beyond = np.abs(z) > -ndtri(CONTRADICTION / 2 / max(len(bands), 1))
    if not beyond.any():
        return None
    worst = int(np.argmax(np.abs(z)))
    k = bands[worst]
    stated = float(room.areas @ room.alpha[:, k] / room.total_area)
    # By the equation, whose T changes by the factor by which the simulated T must.
    times = Eyring().time(room, room.areas @ room.alpha) / (1 + more[worst])
    limit = 1 + np.sign(more[worst]) * _REACH * of_stated[worst]
    return BeyondPrior(
        parameter=known[0],
        frequency=float(room.centre_frequencies[k]),
        measured=float(goal[worst]),
        simulated=float(has[worst]),
        reached=float(has[worst] / limit),
        stated=stated,
        needed=float(Eyring().target(room, times)[k] / room.total_area),
        z=float(z[worst]),
        bands=int(beyond.sum()),
        of_bands=len(bands),
    )


SHOWN = tuple(key for key, kind in OBSERVABLES.items() if kind.shown)
"""Names of the parameters that are shown before and after, matched or not."""
_LEFT = 1.0
"""JND by which a gap grows in some band where a parameter left what was measured."""

Gaps = Mapping[str, tuple[Array, Array]]
"""Deviations before and after in JND by parameter, (n_bands,) each."""


def means(measurement: Measurement) -> dict[str, Array]:
    """Return the means over pairs of the measured parameters that are shown, (n_bands,) each."""
    found = {p: read_only(measurement.mean(p)) for p in SHOWN}
    return {p: mean for p, mean in found.items() if np.isfinite(mean).any()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Compared:
    """Hold values at the same pairs: measured, and simulated before and after a calibration.

    ``measured``, ``before`` and ``after`` are `Observations` with the same parameters, pairs and bands.
    ``relative`` is True if the reference of the measured level is unknown.
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
        """Return the values of some parameters at some pairs, if measured and simulated there.

        ``measured`` is the measurement, ``parameters`` are keys such as "t20", and ``pairs`` are
        (source, receiver). ``before`` and ``after`` are the simulated values before and after the
        calibration.
        """
        kept = [pair for pair in pairs if pair in before.pairs]
        values = Observations.of_measurement(measured, parameters, kept)
        there = [p for p in parameters if np.isfinite(values.natural(p)).any()]
        wanted = Observations.of_measurement(measured, there, kept)
        return cls(measured=wanted, before=before.at(wanted), after=after.at(wanted))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that were measured."""
        return self.measured.parameters

    @property
    def gap_before(self) -> Array:
        """Simulated minus measured in JND before, (n_parameters, n_pairs, n_bands)."""
        return gap_at_pairs(self.before.values, self.measured, relative=self.relative)

    @property
    def gap_after(self) -> Array:
        """Simulated minus measured in JND after, (n_parameters, n_pairs, n_bands)."""
        return gap_at_pairs(self.after.values, self.measured, relative=self.relative)

    @property
    def gaps(self) -> Gaps:
        """Root mean square deviations in JND over the pairs, before and after, by parameter."""
        ends = zip(self.parameters, self.gap_before, self.gap_after, strict=True)
        return {p: (rms(before, axis=0), rms(after, axis=0)) for p, before, after in ends}

    def to_dict(self) -> dict[str, Any]:
        """Return parameters, pairs, values in their units, and deviations, as plain values for JSON."""
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
    """Return the names of the parameters whose deviation grew by more than one JND in some band."""
    return tuple(
        parameter
        for parameter, (before, after) in gaps.items()
        if (np.abs(after) > np.abs(before) + _LEFT).any()
    )


def sentences(gaps: Gaps, frequencies: Array) -> Iterator[str]:
    """Yield a sentence on how the deviation of each parameter of `left` grew in its worst band."""
    for parameter in left(gaps):
        before, after = (np.abs(gap) for gap in gaps[parameter])
        k = int(np.nanargmax(after - before))
        yield (
            f"{parameter_label(parameter)}, which was not fitted, now deviates more from the "
            f"measurement: by {after[k]:.1f} JND instead of {before[k]:.1f} JND at "
            f"{label(frequencies[k])}. Match {parameter_label(parameter)} at every position, or look "
            "for what is missing from the model (rtcal find)."
        )


RUNS = 16
"""Number of reference simulations."""
SCATTERING = (0.1, 0.85)
"""Scattering coefficients of the reference simulations: those of ordinary walls and furniture."""
MODELS: tuple[ScatteringModel, ...] = ("random", "vector")
_BETWEEN_MATERIALS = 0.12
"""Standard deviation of the materials' scattering coefficients around the level of a run."""
_PATHS = 6000
"""Most paths of a reference simulation, per source, `DENSER` times as many where they are thinned."""

Simulated = Callable[[Simulator, Array, int], Array]
"""The values of a simulator in another state of the room, (n_parameters, n_pairs, n_bands): for alpha
(n_materials, n_bands) before the change, and a seed."""
AHEAD = 3.0
"""How many times Eyring's T of the prior the paths of a simulator are followed. In ten development
rooms T20 of the reference simulations' draws needed up to 2.2 times as much, in 40 rooms of other seeds
at most 3 times but for one."""
_FIRST = 8.0
"""How many times Eyring's T the first run of each model follows the decays; it scatters least. The
others scatter more and more, and follow them for as long as the four before needed."""
_SPARE = 1.5
"""By how much longer, since T differs between runs; also the least that is followed."""
_LEFT_OUT = 4
"""Most runs that are left out because their decays are longer still. They would be traced twice. In two
of 20 boxes with little scattering T20 of a run was above 12 times Eyring's T."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlRuns:
    """Hold the errors that a simulator has in reference simulations of a room.

    A reference simulation traces a similar room with other scattering, positions and coefficients,
    so that its differences from the simulator show how far the simulator may err.
    `rtcal.calibrate_positions` makes them, and uses their covariance as the error of the simulator.

    ``errors`` (n_runs, n_parameters, n_pairs, n_bands) are the values of each reference simulation
    minus those of the simulator, for the keys ``parameters`` and the (source, receiver) ``pairs``.
    ``levels`` (n_runs,) are its mean scattering coefficients, ``models`` its scattering models, and
    ``more_paths`` is the factor on its number of paths.
    """

    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    errors: Array
    levels: Array | None = None
    models: tuple[ScatteringModel, ...] = ()
    more_paths: int = 1

    def __post_init__(self) -> None:
        put(self, parameters=checks.texts("parameters", self.parameters))
        put(self, pairs=checks.pairs("pairs", self.pairs))
        put(self, models=checks.texts("models", self.models))
        checks.whole("more_paths", self.more_paths, 1)
        shape = ("n_runs", len(self.parameters), len(self.pairs), "n_bands")
        errors = checks.shaped("errors", self.errors, *shape)
        if len(errors) < 2 or not np.isfinite(errors).all():
            raise DataError(
                f"the errors of {len(errors)} runs are given; they must be finite, and of at "
                "least 2 runs"
            )
        put(self, errors=errors)
        if self.levels is not None:
            put(self, levels=checks.shaped("levels", self.levels, len(errors)))
            if len(self.models) != len(errors):
                raise DataError(
                    f"models has {len(self.models)} texts; give one for each of the "
                    f"{len(errors)} runs"
                )

    def __repr__(self) -> str:
        return f"<ControlRuns: {len(self.errors)} runs, {len(self.pairs)} pairs>"

    def at(self, parameters: Sequence[str], pairs: Sequence[tuple[str, str]]) -> ControlRuns:
        """Return the errors of the given ``parameters`` at the given ``pairs`` (source, receiver) only.

        Raises DataError if the reference simulations lack one of them.
        """
        if missing := [p for p in parameters if p not in self.parameters] or [
            " to ".join(p) for p in pairs if p not in self.pairs
        ]:
            raise DataError(
                f"the reference simulations have no {missing[0]}, so they are of another "
                "simulator; make them with this one"
            )
        rows = [self.parameters.index(p) for p in parameters]
        columns = [self.pairs.index(p) for p in pairs]
        errors = self.errors[:, rows][:, :, columns]
        return replace(self, parameters=tuple(parameters), pairs=tuple(pairs), errors=errors)

    def covariance(self) -> Array:
        """Return the covariance of the simulator's error, (n, n) for n = parameters x pairs x bands.

        It is taken about 0, so that it includes the mean error. Because there are far fewer simulations
        than values, the covariance of the simulations has the weight 0.3, and `alike` has 0.7.
        """
        rows = self.errors.reshape(len(self.errors), -1)
        return np.asarray(_SHRINKAGE * self.alike() + (1 - _SHRINKAGE) * rows.T @ rows / len(rows))

    def alike(self) -> Array:
        """Return the covariance of the errors, (n, n), as if all pairs had the same variance.

        n and the order are those of `covariance`. The variance is that of an error that all pairs have
        in common, plus that of each pair's own error.
        """
        _, n_parameters, n_pairs, n_bands = self.errors.shape
        common = self.errors.mean(axis=2, keepdims=True)
        between = _product(common)
        within = _product((self.errors - common) * np.sqrt(n_pairs / max(n_pairs - 1, 1)))
        every, each = np.ones((n_pairs, n_pairs)), np.eye(n_pairs)
        full = np.einsum("pkql,ij->pikqjl", between, every)
        # The mean over the pairs holds 1 / n_pairs of each pair's part.
        full += np.einsum("pkql,ij->pikqjl", within, each - every / n_pairs)
        return np.asarray(full.reshape(n_parameters * n_pairs * n_bands, -1))

    def without_noise(self, noise: Array) -> ControlRuns:
        """Return the errors, reduced to the variance that they would have without noise of the paths.

        ``noise`` (n_parameters, n_bands) is the variance of the values of one pair in one reference
        simulation by its finite number of paths.
        """
        noise = noise / self.more_paths
        n_pairs = self.errors.shape[2]
        common = self.errors.mean(axis=2)
        own = self.errors - common[:, :, np.newaxis]
        of_common = share_of_signal((common**2).mean(axis=0), noise / n_pairs)
        of_own = share_of_signal((own**2).mean(axis=(0, 2)), noise * (1 - 1 / n_pairs))
        left = [np.sqrt(np.maximum(of, _LEAST_LEFT))[:, np.newaxis] for of in (of_common, of_own)]
        return replace(self, errors=common[:, :, np.newaxis] * left[0] + own * left[1])

    def with_common(self, factor: float) -> ControlRuns:
        """Return the errors, with their mean over the pairs multiplied by ``factor``.

        What each pair differs by from this mean stays.
        """
        common = self.errors.mean(axis=2, keepdims=True)
        return replace(self, errors=self.errors - (1 - factor) * common)


_LEAST_LEFT = 0.1
"""Share of a variance that is left at least where noise is taken off."""


def share_of_signal(square: Array, noise: Array) -> Array:
    """Return the share of mean squares that is signal and not noise; 0 where there is only noise.

    ``square`` is the mean square of signal and noise, and ``noise`` that of the noise alone (James &
    Stein 1961, with the variances estimated).
    """
    share = np.divide(noise, square, out=np.ones_like(square), where=square > noise)
    return np.asarray(1 - share)


_SHRINKAGE = 0.7
"""Share of the covariance in which all pairs are alike. From 0.5 to 1 the median error of alpha in
twelve development rooms changed by 4 %, the coverage of the interval by 0.5 %."""


def _product(errors: Array) -> Array:
    """Return the separable covariance, (parameters, bands, parameters, bands), of (runs, p, i, k)."""
    deviation = np.sqrt((errors**2).mean(axis=(0, 2)))  # (p, k)
    z = errors / np.where(deviation > 0, deviation, 1.0)[:, np.newaxis]
    samples = z.shape[0] * z.shape[2]
    parameters = np.einsum("npik,nqik->pq", z, z) / (samples * z.shape[3])
    of_bands = np.einsum("npik,npil->kl", z, z) / (samples * z.shape[1])
    return np.asarray(np.einsum("pk,pq,kl,ql->pkql", deviation, parameters, of_bands, deviation))


def simulated_controls(
    simulator: Simulator,
    room: Room,
    match: Sequence[str],
    *,
    seed: int = 0,
    position_uncertainty: float = POSITION,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    after: Sequence[tuple[Sequence[str], Simulated]] = (),
    more_paths: int = 1,
    scheduler: str | None = None,
) -> ControlRuns | None:
    """Return the errors of a simulator in `RUNS` reference simulations; None if it has no geometry.

    `PathTracing`, `ScatteringDelayNetwork` and `ImageSource` have a geometry. ``match`` are keys of the
    parameters. Alpha is drawn at random from the input alpha and sigma of ``room``, in the same way for
    every ``seed``, which is that of the paths. ``position_uncertainty`` is the standard uncertainty of
    the positions in m. ``after`` has, for each further state of the room, the parameters and a function
    that simulates them; their errors follow those of ``match``. The folder ``cache`` keeps the errors
    for the next call if ``after`` is empty. ``more_paths`` is a factor on the number of paths.
    ``scheduler`` is the address of a Dask scheduler whose workers simulate; None for this machine.
    """
    uncertainty = checked_uncertainty(position_uncertainty)
    tracing = complete(simulator).tracing
    if tracing is None:
        return None
    base: PathTracing = tracing.denser()
    n_paths = more_paths * paths_of_a_run(base)
    base = base.denser(more_paths)
    traced = tracing is simulator
    if traced:
        simulator = base
    # What is not known is drawn alike for every seed, as the nodes of a quadrature: the paths alone
    # depend on the seed.
    rng = np.random.default_rng(20)
    correlation = bands.correlation(room.centre_frequencies, room.band_correlation)
    root = np.linalg.cholesky(correlation + 1e-10 * np.eye(room.n_bands)).T
    drawn = []
    for run in range(RUNS):
        varied = _varied(base, rng, run, uncertainty, n_paths)
        alpha = room.alpha + room.sigma * (rng.standard_normal(room.alpha.shape) @ root)
        drawn.append((varied, np.clip(alpha, 0.001, 0.99)))
    names = (*match, *(name for named, _ in after for name in named))
    shape = (len(names), len(base.pairs), base.room.n_bands)

    def runs(errors: Array) -> ControlRuns:
        kept = [i for i, of_run in enumerate(errors) if not np.isnan(of_run).all()]
        scattering = np.array([drawn[i][0]["scattering"] for i in kept])
        return ControlRuns(
            parameters=names,
            pairs=base.pairs,
            errors=errors[kept],
            levels=np.average(scattering, axis=1, weights=room.areas),
            models=tuple(drawn[i][0]["scattering_model"] for i in kept),
            more_paths=more_paths,
        )

    path = None
    if cache is not None and not after:
        numbers = [seed, uncertainty, RUNS, n_paths]
        path = checks.path("cache", cache) / _kept_as(base, simulator, room, match, numbers)
        kept = disk.read(path)
        if kept is not None and kept.shape == (RUNS, *shape):
            with suppress(RtcalError):  # another's file
                return runs(kept)

    def own(alpha: Array, again: bool) -> Array:
        """Return the simulator's own values for the alpha of a run."""
        if traced:
            values = base.observe(alpha, match, seed=seed, again=again).values
        else:
            values = observe(simulator, alpha, match, seed=seed).values
        return np.concatenate([values, *(of(simulator, alpha, seed) for _, of in after)])

    trace_ahead(simulator, room.alpha, seed)
    errors, factors = list[Array](), list[float]()
    task = partial(_of_run, base, match, [values_of for _, values_of in after], seed)

    def again() -> bool:
        """Return whether as many runs were left out as may be."""
        return sum(np.isnan(of_run).all() for of_run in errors) == _LEFT_OUT

    with workforce(scheduler, threads=1) as workers:  # a run's paths are traced on all cores

        def error(job: _Job, made: _Made | None) -> Array:
            """Return the errors of a run, (n_parameters, n_pairs, n_bands); NaN if it is left out."""
            while made is not None:
                number, values, factor = made
                try:
                    difference = values - own(job.alphas[number], job.again)
                except DataError:
                    if job.again and number == len(job.alphas) - 1:
                        raise
                    job = job._replace(first=number + 1)
                    (made,) = workers.in_order(task, [job])
                else:
                    factors.append(factor)
                    return difference
            return np.full(shape, np.nan)

        while (done := len(errors)) < RUNS:
            # How long the later ones of these runs must be depends on the earlier ones. They begin as
            # if those needed no more than the last, and are run anew where they did.
            most = min(workers.size, RUNS - done if errors else len(MODELS))
            jobs = [
                _Job(run, varied, (alpha, room.alpha), _length(run, factors, run - done), again())
                for run, (varied, alpha) in enumerate(drawn[done : done + most], done)
            ]
            for job, made in zip(jobs, workers.in_order(task, jobs), strict=False):
                if (job.ahead, job.again) != (_length(job.run, factors), again()):
                    break
                errors.append(error(job, made))
                if progress is not None:
                    progress(len(errors), RUNS)
    if path is not None:
        disk.write(path, np.array(errors))
    return runs(np.array(errors))


def _kept_as(
    base: PathTracing, simulator: Simulator, room: Room, match: Sequence[str], numbers: list[float]
) -> str:
    """Return the name of the file that keeps reference simulations: a hash of all they depend on."""
    simple = int, float, str, bool, type(None)
    settings = {name: v for name, v in vars(simulator).items() if isinstance(v, simple)}
    tables = (room.alpha, room.sigma, room.centre_frequencies)
    of_room = [*(each.tolist() for each in tables), room.air and asdict(room.air)]
    numbers = [*numbers, room.band_correlation]
    return f"{key_of(base, simulator.name, settings, of_room, list(match), numbers)}.array"


class _Job(NamedTuple):
    """A reference simulation, as a worker takes it.

    ``varied`` is what differs in it. Of the ``alphas`` the first counts for which there are all values,
    from the number ``first`` on. Paths are followed for ``ahead`` times Eyring's T, and longer ones
    only traced if ``again``.
    """

    run: int
    varied: dict[str, Any]
    alphas: tuple[Array, ...]
    ahead: float
    again: bool
    first: int = 0


_Made = tuple[int, Array, float]
"""Number of the alpha that counts, the values for it, and `ahead_factor`."""


def _of_run(
    base: PathTracing, match: Sequence[str], after: Sequence[Simulated], seed: int, job: _Job
) -> _Made | None:
    """Return what a reference simulation gives; None where no alpha gives all values."""
    control, of_run = replace(base, **job.varied), seed + 1 + job.run
    control.trace_ahead(job.alphas[0], job.ahead, seed=of_run)
    last = len(job.alphas) - 1
    for number in range(job.first, last + 1):
        alpha = job.alphas[number]
        try:
            found = control.observe(alpha, match, seed=of_run, again=job.again).values
            values = np.concatenate([found, *(of(control, alpha, of_run) for of in after)])
        except DataError:
            # Some draws leave a decay without a parameter. The paths of a run may be too few, or a
            # place too near a source for an EDT.
            if job.again and number == last:
                raise
        else:
            return number, values, ahead_factor(match, found, control, alpha)
    return None


def _length(run: int, factors: Sequence[float], unknown: int = 0) -> float:
    """Return for how many times Eyring's T a run is followed, by what the runs before it needed.

    Of these ``factors`` the last ``unknown`` are still to come.
    """
    known = factors[min(unknown, 3) - 4 :]
    return _FIRST if run < len(MODELS) else max(known, default=_FIRST)


GROUPS = 4
"""Groups of paths whose differences tell the noise of a reference simulation."""


def noise_of_a_run(simulator: Any, groups: Array | None) -> Array:
    """Return the variance of simulated values by the finite number of paths, (n_parameters, n_bands).

    ``groups`` (n_groups, n_parameters, n_pairs, n_bands) are the values of groups of the simulator's
    paths; None for a simulator without paths.
    """
    if groups is None:
        return np.zeros(1)
    of_group = groups.var(axis=0, ddof=1).mean(axis=1)
    return np.asarray(of_group * simulator.n_paths / GROUPS / paths_of_a_run(simulator))


def ahead_factor(
    parameters: Sequence[str], values: Array, tracer: PathTracing, alpha: Array
) -> float:
    """Return for how many reverberation times paths must be followed so that decays have T20 or T30.

    ``values`` (n_parameters, n_pairs, n_bands) are the expected values. The result is relative to
    Eyring's T with the coefficients ``alpha``.
    """
    times = [
        kind.natural(of).max() * (observables.MARGIN_DB - kind.lower) / 60
        for name, of in zip(parameters, values, strict=True)
        for kind in REVERBERATION
        if kind.key == name
    ]
    return _SPARE * max(max(times, default=0.0) / eyring_seconds(tracer.room, alpha), 1.0)


def trace_ahead(simulator: Simulator, alpha: Array, seed: int) -> None:
    """Trace paths that are long enough for other draws of alpha, too."""
    complete(simulator).trace_ahead(alpha, AHEAD, seed=seed)


def _varied(
    base: PathTracing, rng: np.random.Generator, run: int, uncertainty: float, n_paths: int
) -> dict[str, Any]:
    """Return what differs in a run: scattering and its model, positions, and the number of paths."""
    low, high = SCATTERING
    mean = low + (high - low) * (run // 2 + rng.uniform()) / (RUNS / 2)
    stated = base.scattering.mean(axis=1, keepdims=True)
    around = np.clip(stated + mean - mean_scattering(stated, base.room.areas), 0.0, 1.0)[:, 0]
    by_material = around + _BETWEEN_MATERIALS * rng.standard_normal(base.room.n_materials)
    sources, receivers = (
        {
            name: _moved(base.geometry, np.array(point), rng, uncertainty)
            for name, point in points.items()
        }
        for points in (base.sources, base.receivers)
    )
    return {
        "scattering": np.clip(by_material, low, high),
        "scattering_model": MODELS[run % 2],
        "sources": sources,
        "receivers": receivers,
        "n_paths": n_paths,
    }


def paths_of_a_run(tracer: PathTracing) -> int:
    """Return the number of paths per source of the reference simulations of a tracing."""
    return min(_PATHS if tracer.thinned is None else DENSER * _PATHS, tracer.n_paths)


def mean_scattering(scattering: Array, areas: Array) -> float:
    """Return the mean of scattering coefficients (n_materials, n_bands) over the areas."""
    return float(np.average(scattering.mean(axis=1), weights=areas))


def _moved(
    geometry: Polyhedron, point: Array, rng: np.random.Generator, uncertainty: float
) -> Array:
    """Return the point moved by about ``uncertainty``, within the room."""
    for _ in range(20):
        trial = point + uncertainty / np.sqrt(3) * rng.standard_normal(3)
        if geometry.contains([trial])[0] and geometry.wall_distance([trial])[0] > 0.01:
            return np.asarray(trial)
    return point


def key_of(tracer: PathTracing, *content: object) -> str:
    """Return a hash of a tracing's geometry, positions and scattering, and of further content."""
    geometry, points = tracer.geometry, {**tracer.sources, **tracer.receivers}
    every = [
        __version__,
        geometry.vertices.tolist(),
        [list(map(int, face)) for face in geometry.faces],
        list(geometry.materials),
        {name: list(map(float, point)) for name, point in points.items()},
        np.asarray(tracer.scattering).tolist(),
        plain_directivities(tracer.directivity),
        *content,
    ]
    return hashlib.sha256(json.dumps(every, sort_keys=True).encode()).hexdigest()[:32]


OWN, COMMON = 0.8, 1.0
"""Standard deviations of the log odds ln(s / (1 - s)): of a material's from the mean of all, and of
that mean from what is stated. Around 0.4 each leaves 0.23 to 0.60 within one deviation."""
_MOST = 3.0
"""Largest change of the log odds: from 0.4 to 0.03 or 0.93."""
COMMON_LEFT = 0.2
"""Share of the variance common to all pairs that is left, as materials' scattering counts apart. In
thirteen rooms the gap at held-out pairs was 0.73 times that of T20 alone with all of it, 0.68 with 0.4
and 0.66 with 0.2; the median error of alpha 0.92, 0.92 and 0.88 times."""
DIGITS = 1
"""To which log odds are rounded before the room is traced: nearly the same data then have the same
paths."""
_COEFFICIENTS = 3
"""Of every value's dependence on scattering: a constant, one for the other model, and a slope. In ten
development rooms polynomials of degree 2 for each model predicted unfitted pairs less well."""
_PASSES = 2
"""Times that the weights of the reference simulations are found anew."""
_POWERS = (-4.0, 0.5)
"""Limits of the power of the level that a variance is proportional to."""
_RIDGE = 0.3
"""Draws the powers towards 0: variance of ln of a run's mean square (1.2) over that of a power (4)."""
_FREEDOM = 4
"""Degrees of freedom of Student's t distribution."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattering:
    """Hold the scattering coefficients that were fitted with alpha; they are not a measurement.

    ``coefficients`` (n_materials, n_bands) are those of the scattering ``model`` (see
    `rtcal.simulators.path_tracing.ScatteringModel`). ``sigma`` is their standard uncertainty, 0 where a
    coefficient is 0 or 1. ``mean`` is the mean over the surfaces, weighted by area. ``limited`` are the
    numbers of the materials whose coefficients reached their limit.
    """

    model: ScatteringModel
    coefficients: Array
    sigma: Array
    mean: float
    limited: tuple[int, ...]

    def notes(self, materials: Sequence[str]) -> list[str]:
        """Return notes on the fitted scattering.

        ``materials`` are the names of the room's materials.
        """
        notes = [
            f"Scattering was fitted with alpha: {self.in_words}. Of the two ways of tracing "
            f'scattering, "random" and "vector", the measurement is more probable with "{self.model}". '
            "Fitted scattering is no measurement: another seed or more paths may give other "
            "coefficients."
        ]
        if self.limited:
            names = ", ".join(materials[i] for i in self.limited)
            notes.append(
                f"The scattering of {names} moved to the end of its range: the data do not determine "
                "it."
            )
        return notes

    @property
    def in_words(self) -> str:
        """Mean and range of the scattering coefficients, and their model, as text."""
        low, high = self.coefficients.min(), self.coefficients.max()
        return f"{self.mean:.2f} in the mean, {low:.2f} to {high:.2f} ({self.model})"


@dataclass(frozen=True, kw_only=True, eq=False)
class MaterialScattering:
    """Hold how all simulated values depend on the scattering coefficient of each material.

    ``slope`` (n, n_materials) are the derivatives of all values, n = parameters x pairs x bands, by the
    log odds of the scattering coefficients. ``traced`` (n_materials,) are the log odds that were
    traced, with the scattering ``model``, minus those of the input.
    """

    slope: Array
    traced: Array
    model: ScatteringModel = "random"

    @property
    def prior(self) -> Array:
        """Covariance of the changes of the log odds, (n_materials, n_materials)."""
        n = len(self.traced)
        return np.asarray(OWN**2 * np.eye(n) + COMMON**2)

    @property
    def covariance(self) -> Array:
        """Covariance of the values by the unknown scattering, (n, n)."""
        return np.asarray(self.slope @ self.prior @ self.slope.T)

    @property
    def back(self) -> Array:
        """Change of the values from the traced scattering to the input scattering, (n,)."""
        return np.asarray(-self.slope @ self.traced)

    def likely(self, pull: Array) -> Array:
        """Return the most probable change of the scattering log odds from the input, (n_materials,).

        ``pull`` (n,) is the inverse covariance of the measured values times their deviation from those
        with the input scattering; 0 where nothing was measured.
        """
        likeliest = self.prior @ (self.slope.T @ pull)
        return np.asarray(np.clip(likeliest, -_MOST, _MOST))

    def posterior(self, used: NDArray[np.int64], covariance: Array) -> Array:
        """Return the standard deviations of the log odds after the measurement, (n_materials,).

        ``used`` are the numbers of the measured values, and ``covariance`` (n_used, n_used) is their
        covariance if alpha and scattering are unknown.
        """
        across = self.slope[used] @ self.prior
        left = self.prior - across.T @ np.linalg.solve(covariance, across)
        return np.asarray(np.sqrt(np.maximum(np.diag(left), 0.0)))


def material_scattering(
    tracer: PathTracing, alpha: Array, parameters: Sequence[str], seed: int
) -> MaterialScattering:
    """Return how the values of a tracer depend on the scattering coefficient of each material.

    ``parameters`` are the keys of the values, and ``seed`` is that of the paths. As far as derivatives
    at single pairs are noise, they are replaced by their mean over the pairs. Raises DataError for a
    tracer whose scattering model is not "random".
    """
    groups = tracer.scattering_jacobian(alpha, parameters, number=2, seed=seed)
    slope = groups.mean(axis=0)
    common = slope.mean(axis=1, keepdims=True)
    off = (groups[0] - groups[1]) / 2
    noise = ((off - off.mean(axis=1, keepdims=True)) ** 2).mean(axis=(1, 2, 3), keepdims=True)
    share = share_of_signal(((slope - common) ** 2).mean(axis=(1, 2, 3), keepdims=True), noise)
    return MaterialScattering(
        slope=(common + share * (slope - common)).reshape(-1, slope.shape[-1]),
        traced=np.zeros(slope.shape[-1]),
    )


def scattered(tracer: PathTracing, log_odds: Array, model: ScatteringModel) -> PathTracing:
    """Return the tracer with other scattering coefficients, and with a scattering ``model``.

    ``log_odds`` (n_materials,) are the changes of the coefficients' log odds, the same in all bands.
    Coefficients of 0 and 1 do not change.
    """
    s = tracer.scattering
    odds = np.exp(log_odds)[:, np.newaxis]
    return replace(tracer, scattering=s * odds / (1 - s + s * odds), scattering_model=model)


def fitted(tracer: PathTracing, log_odds: Array, posterior: Array) -> Scattering:
    """Return the scattering of a tracer after the fit, with its uncertainty.

    ``log_odds`` (n_materials,) are the changes by the fit, ``posterior`` their standard deviations.
    """
    s = tracer.scattering
    return Scattering(
        model=tracer.scattering_model,
        coefficients=s,
        sigma=s * (1 - s) * posterior[:, np.newaxis],
        mean=mean_scattering(s, tracer.room.areas),
        limited=tuple(np.flatnonzero(np.abs(log_odds) >= _MOST).tolist()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorsByScattering:
    """Hold how a simulator's errors in reference simulations depend on the level of scattering.

    For each scattering model the errors are a straight line over the level, with ``coefficients`` (3,
    n_parameters, n_pairs, n_bands) of the columns that `basis` returns. ``spread`` (3, 3) is the
    covariance of these coefficients over the residual variance. The residual variance is proportional
    to the level to the ``power`` (n_parameters,), relative to the level ``middle``. At that level the
    residuals of all values have the covariance ``left`` (n, n). ``of_coefficients`` (n, n) is the
    residual covariance that, times ``spread``, gives the uncertainty of the coefficients.
    """

    coefficients: Array
    spread: Array
    power: Array
    middle: float
    left: Array
    of_coefficients: Array

    @property
    def of_model(self) -> Array:
        """Change of every value by the scattering model "vector", (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.coefficients[1])

    def covariance(self, level: float, model: ScatteringModel) -> Array:
        """Return the covariance of all values at a level of scattering, (n, n)."""
        at = np.clip(level, *SCATTERING)
        row = basis([at], [MODELS.index(model)])[0]
        # What a few runs leave uncertain of the coefficients: the leverage of the level.
        covariance = self.left + row @ self.spread @ row * self.of_coefficients
        deviation = (at / self.middle) ** (self.power / 2)
        each = np.repeat(deviation, len(covariance) // len(deviation))
        return np.asarray(each[:, np.newaxis] * covariance * each)


def errors_by_scattering(controls: ControlRuns, noise: Array) -> ErrorsByScattering | None:
    """Return how the errors of reference simulations depend on scattering, by weighted least squares.

    The result is None if the simulations are too few, or have the same scattering. ``noise``
    (n_parameters, n_bands) is the variance of a simulation's values by its finite number of paths.

    The less a room scatters, the more its errors differ from a straight line: the variance of the error
    of T20 is about inverse to the square of the level, while that of C80 hardly depends on it.
    Therefore each parameter's variance is a power of the level. Simulations far from the line count
    less, as under Student's t distribution.
    """
    errors, levels = controls.errors, controls.levels
    (runs, n_parameters), n = errors.shape[:2], _COEFFICIENTS
    if levels is None or runs < 4 * n:
        return None
    columns = basis(levels, [MODELS.index(m) for m in controls.models])
    if np.linalg.matrix_rank(columns) < n:
        return None
    middle = float(np.exp(np.mean(np.log(levels))))
    log_level = np.log(levels / middle)
    power, weight = np.zeros(n_parameters), np.ones((runs, n_parameters))
    coefficients, left = np.empty((n, *errors.shape[1:])), np.empty_like(errors)
    for last in (False,) * _PASSES + (True,):
        root = np.sqrt(weight) * np.exp(-0.5 * np.outer(log_level, power))
        spread = np.zeros((n, n))
        for p in range(n_parameters):
            weighted = root[:, p, np.newaxis] * columns
            values = errors[:, p].reshape(runs, -1)
            solved = np.linalg.lstsq(weighted, root[:, p, np.newaxis] * values, rcond=None)[0]
            off = root[:, p, np.newaxis] * (values - columns @ solved)
            coefficients[:, p] = solved.reshape(coefficients[:, p].shape)
            left[:, p] = np.sqrt(runs / (runs - n)) * off.reshape(left[:, p].shape)
            spread += np.linalg.inv(weighted.T @ weighted) / n_parameters
        if last:
            break
        deviation = np.sqrt((left**2).mean(axis=(0, 2), keepdims=True))
        square = ((left / np.where(deviation > 0, deviation, 1.0)) ** 2).mean(axis=(2, 3))
        logs = np.log(np.maximum(square / root**2, 1e-12))
        power = log_level @ (logs - logs.mean(axis=0)) / (log_level @ log_level + _RIDGE)
        power = np.clip(power, *_POWERS)
        weight = (_FREEDOM + 1) / (_FREEDOM + square / weight)
    # Coefficients of all pairs are drawn towards their mean, as far as noise makes them differ.
    common, mean = coefficients.mean(axis=2, keepdims=True), left.mean(axis=2, keepdims=True)
    own_noise = ((left - mean) ** 2).mean(axis=0).sum(axis=(1, 2))
    off = np.diag(spread)[:, np.newaxis] * own_noise
    share = share_of_signal(((coefficients - common) ** 2).sum(axis=(2, 3)), off)
    own = np.sqrt(share.mean(axis=0))[:, np.newaxis, np.newaxis]
    of_left = replace(controls, errors=left)
    return ErrorsByScattering(
        coefficients=common + share[..., np.newaxis, np.newaxis] * (coefficients - common),
        spread=spread,
        power=power,
        middle=middle,
        left=of_left.without_noise(noise).with_common(COMMON_LEFT**0.5).covariance(),
        of_coefficients=replace(of_left, errors=mean + (left - mean) * own).covariance(),
    )


def log_likelihood(residual: Array, covariance: Array) -> float:
    """Return the normal log-likelihood without its constant."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, residual, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(factor)).sum())


def basis(levels: ArrayLike, models: ArrayLike) -> Array:
    """Return the columns that a value depends on, (n, 3): nearly orthogonal over the simulations."""
    level, model = np.asarray(levels, dtype=float), np.asarray(models, dtype=float)
    return np.stack([np.ones_like(level), model - 0.5, level - np.mean(SCATTERING)], axis=1)
