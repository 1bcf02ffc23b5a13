"""The target of the loop in each band, T20 or a compromise with EDT; bands that modes carry.

One target per band can match one number. The compromise is the weighted geometric mean of the decay
times, T_c = product of T_p to the power of p's share. Where the times follow the target alike, matching
T_c leaves the smallest weighted sum of squares of log(T_p / measured T_p). The shares decide how
the disagreement of T20 and EDT is divided.

No simulator of rays has room modes, and below the Schroeder frequency T is no equation's. With room
modes the loop does not match what was measured there: coefficients stay as the modes' decays left them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import band_conversion
from rtcal.acoustics.bands import label, labels
from rtcal.acoustics.marks import TrustMark, gap_jnd, rms
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import EARLY, OBSERVABLES, TARGET, parameter_label
from rtcal.acoustics.room import Room
from rtcal.calibration.measured import times_in_room
from rtcal.modes.calibrate import ModesResult, above_schroeder, below_schroeder
from rtcal.simulators.base import Observations
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

PARAMETERS = (TARGET.key, EARLY.key)
Weights = Mapping[str, float | Sequence[float]]


def of_room(room: Room) -> list[bytes]:
    """Return a room's materials, areas, bands, air and prior as one comparable value."""
    numbers = (
        [room.volume, room.speed_of_sound],
        room.areas,
        room.centre_frequencies,
        room.air_attenuation,
        room.alpha,
        room.sigma,
    )
    return [*(m.encode() for m in room.materials), *(np.asarray(n).tobytes() for n in numbers)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Matched:
    """Decay times that are matched at once, means over the pairs.

    Attributes
    ----------
    measured : dict of parameter to array (n_bands,)
        In s, NaN where it is missing; T20 (or T30 in its place) first.
    shares : dict of parameter to array (n_bands,)
        Weights, divided by their sum in each band.
    time_label : str
        Name of the measured reverberation time, as `rtcal.acoustics.measurement.Measurement` has it.
    """

    measured: Mapping[str, Array]
    shares: Mapping[str, Array]
    time_label: str = TARGET.label

    def __post_init__(self) -> None:
        for name in ("measured", "shares"):
            values = {p: read_only(v) for p, v in getattr(self, name).items()}
            object.__setattr__(self, name, values)

    @classmethod
    def time(cls, measured: Array, time_label: str) -> Matched:
        """Return that the reverberation time alone is matched."""
        shares = {TARGET.key: np.ones(len(measured))}
        return cls(measured={TARGET.key: measured}, shares=shares, time_label=time_label)

    @property
    def label(self) -> str:
        """The matched parameters, in words."""
        names = " and ".join(
            self.time_label if p == TARGET.key else parameter_label(p) for p in self.shares
        )
        return names if len(self.shares) == 1 else f"the weighted mean of {names}"

    @property
    def wanted(self) -> Array:
        """The measured compromise in s, (n_bands,), NaN where it is missing."""
        return read_only(self.combined(self.measured.__getitem__))

    def combined(self, time: Callable[[str], Array]) -> Array:
        """Return the compromise of the times in s that ``time`` gives for each parameter."""
        total = np.ones(len(self.shares[TARGET.key]))
        for parameter, share in self.shares.items():
            total = total * time(parameter) ** share
        return total

    def noise(self, measurement: Measurement) -> Array:
        """Return the compromise's standard error in s, (n_bands,): 0 if none is stated, NaN if unknown.

        T20 and EDT come from the same paths. Their errors are added, which no correlation exceeds.
        """
        checks.instance("measurement", measurement, Measurement)
        time = self.combined(measurement.mean)
        total = np.zeros(len(time))
        for parameter, share in self.shares.items():
            errors = measurement.uncertainty.get(parameter, np.zeros((1, len(time))))
            error = np.sqrt(np.sum(errors**2, axis=0)) / len(errors)
            part = share * error * (time / measurement.mean(parameter))
            total = total + np.where(share > 0, part, 0.0)
        return total

    def gives(self, measurement: Measurement, times: Array) -> bool:
        """Return whether a measurement has exactly these times in s, (n_bands,)."""
        if len(measurement.centre_frequencies) != len(times):
            return False
        return np.array_equal(self.combined(measurement.mean), times, equal_nan=True)

    def gap(self, measurement: Measurement) -> Array:
        """Return the gap of the compromise in JND, (n_bands,)."""
        return gap_jnd(self.combined(measurement.mean), self.wanted)

    def compromise(
        self, before: Callable[[str], Array], after: Callable[[str], Array]
    ) -> dict[str, ParameterGap]:
        """Return the gaps of each parameter in two simulations, and what the compromise cost it.

        ``before`` and ``after`` give the mean (n_bands,) of a parameter.
        """
        left = gap_jnd(self.combined(after), self.wanted)
        found = {}
        for parameter, share in self.shares.items():
            first, last = (
                gap_jnd(mean(parameter), self.measured[parameter], parameter)
                for mean in (before, after)
            )
            lost = np.maximum(np.abs(last) - np.abs(left), 0.0)
            found[parameter] = ParameterGap(share, first, last, lost)
        return found


@dataclass(frozen=True, eq=False)
class ParameterGap:
    """The gaps of a parameter in a compromise, each (n_bands,).

    ``share`` is its weight over the sum of the weights. ``before`` and ``after`` are its gaps in JND
    with the equation's coefficients and with those returned. ``lost`` is by how many JND its gap
    exceeds that of the weighted mean: what it gave up for the others. Matched alone, it is 0.
    """

    share: Array
    before: Array
    after: Array
    lost: Array


def matched_times(
    room: Room, measured: Measurement, t20: Array, weights: Weights | None = None
) -> Matched:
    """Return what is matched for these weights; ``t20`` is the measured T in the room's bands.

    Raises
    ------
    DataError
        For a weight that is no number of at least 0, or of another parameter. Also if all
        weights of a band are 0, or the measurement lacks a parameter that has a weight.
    """
    if weights is None:
        return Matched.time(t20, measured.time_label)
    stated = checks.mapped("weights", weights)
    if unknown := [name for name in stated if name not in PARAMETERS]:
        raise DataError(
            f"weights has {checks.shown(unknown[0])}, which is not one of {', '.join(PARAMETERS)}"
        )
    frequencies = room.centre_frequencies
    by_parameter = {}
    for p in PARAMETERS:
        place, weight = f"weights[{p!r}]", checks.array(f"weights[{p!r}]", stated.get(p, 0.0))
        if weight.shape not in ((), frequencies.shape):
            raise DataError(
                f"{place} has shape {weight.shape}; one number, or one per band, is needed: "
                f"({len(frequencies)},)"
            )
        by_parameter[p] = weight = np.broadcast_to(weight, frequencies.shape)
        if (bad := ~(np.isfinite(weight) & (weight >= 0))).any():
            k = int(np.argmax(bad))
            raise DataError(
                f"{place} at {label(frequencies[k])} = {weight[k]:g} is not a finite number of at "
                "least 0"
            )
    largest = np.max(list(by_parameter.values()), axis=0)
    by_parameter = {
        p: np.divide(w, largest, out=np.zeros_like(w), where=largest > 0)
        for p, w in by_parameter.items()
    }  # so that their sum is finite, and none is too small to count
    total = np.sum(list(by_parameter.values()), axis=0)
    if (total == 0).any():
        band = label(frequencies[int(np.argmin(total))])
        raise DataError(f"weights are 0 for every parameter at {band}: nothing is matched there")
    in_room = band_conversion.measurement_in_room_bands(measured, frequencies)
    times = {TARGET.key: t20, EARLY.key: in_room.mean(EARLY.key)}
    anything = np.isfinite(t20) | np.isfinite(times[EARLY.key])
    for parameter, weight in by_parameter.items():
        lacking = np.isnan(times[parameter]) & (weight > 0) & anything
        if lacking.any():
            raise DataError(
                f"weights[{parameter!r}] is above 0 at {label(frequencies[int(np.argmax(lacking))])}, "
                f"where the measurement has no {parameter_label(parameter)}"
            )
    kept = [p for p in PARAMETERS if p == TARGET.key or by_parameter[p].any()]
    return Matched(
        measured={p: times[p] for p in kept},
        shares={p: by_parameter[p] / total for p in kept},
        time_label=measured.time_label,
    )


SHOWN = tuple(key for key, kind in OBSERVABLES.items() if kind.shown)
"""Parameters that are shown before and after, fitted or not."""
_LEFT = 1.0
"""JND by which a gap grows in some band where a parameter left what was measured."""

Pair = tuple[str, str]

Gaps = Mapping[str, tuple[Array, Array]]
"""Gaps before and after in JND by parameter, each (n_bands,)."""


def means(measurement: Measurement) -> dict[str, Array]:
    """Return the means over pairs of the parameters that are shown and there, each (n_bands,)."""
    found = {p: read_only(measurement.mean(p)) for p in SHOWN}
    return {p: mean for p, mean in found.items() if np.isfinite(mean).any()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Beside:
    """Parameters at positions that are not matched: measured, before and after.

    Attributes
    ----------
    measured, before, after : Observations
        Of the same parameters and pairs.
    """

    measured: Observations
    before: Observations
    after: Observations

    @classmethod
    def of(
        cls,
        measured: Measurement,
        parameters: Sequence[str],
        pairs: Sequence[Pair],
        before: Observations,
        after: Observations,
    ) -> Beside:
        """Return some parameters at some pairs, where they were measured and simulated."""
        kept = [pair for pair in pairs if pair in before.pairs]
        values = Observations.of_measurement(measured, parameters, kept)
        there = [p for p in parameters if np.isfinite(values.natural(p)).any()]
        wanted = Observations.of_measurement(measured, there, kept)
        return cls(measured=wanted, before=before.at(wanted), after=after.at(wanted))

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were measured and not matched."""
        return self.measured.parameters

    @property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.before)

    @property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.after)

    @property
    def gaps(self) -> Gaps:
        """Root mean squares over the pairs."""
        ends = zip(self.parameters, self.gap_before, self.gap_after, strict=True)
        return {p: (rms(before, axis=0), rms(after, axis=0)) for p, before, after in ends}

    def _gap(self, simulated: Observations) -> Array:
        gaps = [gap_jnd(simulated.natural(p), self.measured.natural(p), p) for p in self.parameters]
        return np.reshape(gaps, self.measured.values.shape)


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


@dataclass(frozen=True, eq=False)
class BelowSchroeder:
    """The bands below the Schroeder frequency, in a loop that was given room modes.

    ``modes`` were calibrated without T. ``below`` (n_bands,) says which bands lie below the Schroeder
    frequency of the measured T.
    """

    modes: ModesResult
    below: NDArray[np.bool_]

    @classmethod
    def of(cls, modes: ModesResult, room: Room, measured: Measurement) -> BelowSchroeder:
        """Return the bands of a room and its measurement.

        Raises DataError if the modes are another room's or were calibrated to T, too, or if every
        measured band lies below the Schroeder frequency.
        """
        checks.instance("modes", modes, ModesResult)
        if of_room(modes.prior) != of_room(room):
            raise DataError(
                f'modes is of room "{modes.prior.name}" as it was; it is calibrated for the room '
                f'"{room.name}" as given here'
            )
        if np.isfinite(modes.data.reverberation_time).any():
            raise DataError(
                "modes was calibrated to T as well, which would count twice: leave T out, "
                "calibrate_modes(room, modes)"
            )
        times = times_in_room(room, measured)
        below = below_schroeder(room, times)
        if not np.isfinite(times.reverberation_time[~below]).any():
            raise DataError(
                "every measured band lies below the Schroeder frequency, so that nothing is left to "
                "simulate: `rtcal calibrate ROOM MEASURED --modes MODES` (rt.calibrate_modes) has the "
                "coefficients"
            )
        return cls(modes, below)

    @property
    def room(self) -> Room:
        """The room as the modes left it: the loop's prior."""
        return self.modes.room

    @property
    def carried(self) -> NDArray[np.bool_]:
        """Bands that at least three modes carry, (n_bands,)."""
        return np.asarray(self.below & self.modes.carried)

    def above(self, measured: Measurement) -> Measurement:
        """Return a measurement without the bands below the Schroeder frequency."""
        return above_schroeder(measured, self.room, self.below)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Marks of the modes themselves, and of the bands that no modes carry."""
        return (*self.modes.own_marks, *self.modes.uncarried(self.below & ~self.carried))

    def statuses(self, status: Sequence[str]) -> tuple[str, ...]:
        """Return the loop's statuses with those of the bands below the Schroeder frequency."""
        own = np.where(self.carried, "by modes", "too few modes")
        return tuple(np.where(self.below, own, status).tolist())

    def to_dict(self) -> dict[str, Any]:
        """Return the bands and the modes as plain values."""
        return {"below": self.below, "carried": self.carried, "modes": self.modes.to_dict()}

    @property
    def doubts(self) -> list[str]:
        """Reasons to doubt the modes' matches, as the modes' own result tells them."""
        return [note for note in self.modes.notes if note.startswith("Doubtful")]

    @property
    def note(self) -> str:
        """Sentences: the room modes stand in place of what was measured, and their doubts."""
        said = "No band lies below the Schroeder frequency; the modes are part of the prior."
        if self.below.any():
            bands = labels(self.room.centre_frequencies[self.below])
            said = (
                f"Below the Schroeder frequency ({', '.join(bands)}) {len(self.modes.used)} room "
                "modes stand in place of what was measured there."
            )
            if without := [label(mark.frequency) for mark in self.trust_marks if mark.frequency]:
                said += f" Fewer than three carry {', '.join(without)}: do not use these."
        return " ".join([said, *self.doubts])
