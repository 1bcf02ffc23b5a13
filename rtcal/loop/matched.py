"""The target of the loop on mean values in each band: T20, or a compromise of T20 and EDT.

One target per band can match one number. The compromise is the weighted geometric mean of the decay
times, T_c = product of T_p to the power of p's share. Where the times follow the target alike, matching
T_c leaves the smallest weighted sum of squares of log(T_p / measured T_p). The shares decide how
the disagreement of T20 and EDT is divided.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import band_conversion
from rtcal.acoustics.bands import label
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import EARLY, TARGET
from rtcal.acoustics.parameters import parameter_label
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

PARAMETERS = (TARGET.key, EARLY.key)
Weights = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Matched:
    """Decay times that are matched at once, means over the pairs.

    Attributes
    ----------
    measured : dict of parameter to array (n_bands,)
        In s, NaN where it is missing; T20 (or T30 in its place) first.
    shares : dict of parameter to array (n_bands,)
        Weights, divided by their sum in each band.
    """

    measured: Mapping[str, Array]
    shares: Mapping[str, Array]

    def __post_init__(self) -> None:
        for name in ("measured", "shares"):
            values = {p: read_only(v) for p, v in getattr(self, name).items()}
            object.__setattr__(self, name, values)

    @classmethod
    def t20(cls, measured: Array) -> Matched:
        """Return that T20 alone is matched."""
        return cls(measured={TARGET.key: measured}, shares={TARGET.key: np.ones(len(measured))})

    @property
    def label(self) -> str:
        """The matched parameters, in words."""
        names = " and ".join(parameter_label(p) for p in self.shares)
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
        return Matched.t20(t20)
    stated = checks.mapped("weights", weights)
    if unknown := [name for name in stated if name not in PARAMETERS]:
        raise DataError(
            f"weights has {checks.shown(unknown[0])}, which is not one of {', '.join(PARAMETERS)}"
        )
    frequencies = room.centre_frequencies
    by_parameter = {p: _weight(p, stated.get(p, 0.0), frequencies) for p in PARAMETERS}
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
        measured={p: times[p] for p in kept}, shares={p: by_parameter[p] / total for p in kept}
    )


def _weight(parameter: str, value: object, frequencies: Array) -> Array:
    place = f"weights[{parameter!r}]"
    weight = checks.array(place, value)
    if weight.shape not in ((), frequencies.shape):
        raise DataError(
            f"{place} has shape {weight.shape}; one number, or one per band, is needed: "
            f"({len(frequencies)},)"
        )
    weight = np.broadcast_to(weight, frequencies.shape)
    if (bad := ~(np.isfinite(weight) & (weight >= 0))).any():
        k = int(np.argmax(bad))
        raise DataError(
            f"{place} at {label(frequencies[k])} = {weight[k]:g} is not a finite number of at least 0"
        )
    return weight
