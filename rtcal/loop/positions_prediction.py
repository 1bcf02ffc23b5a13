"""The prediction at every position: what it takes of a calibration, and the intervals that it gives.

And the tables that a calibration to every position prints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.changes import Change
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.acoustics.quality import rms
from rtcal.acoustics.room import Room
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.measured_pairs import MeasuredPairs, Pair
from rtcal.loop.scattering import Scattering
from rtcal.prediction import words
from rtcal.prediction.predicted import LEVEL
from rtcal.simulators.base import Simulator
from rtcal.support import text
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.saved import Result
from rtcal.support.text import number, shortened
from rtcal.support.types import Array

Z = float(ndtri((1 + LEVEL) / 2))
"""Half of a normal interval, in standard deviations."""


_SAMPLES = 2000
_BENT = 0.1
"""Departure from a straight line at the interval's ends, in standard deviations, from which the
interval is that of samples."""


class CalibratedAtPositions(Protocol):
    """A calibration to every position, as far as a prediction takes it: a `PositionsResult`."""

    @property
    def prior(self) -> Room:
        """The room as it was given."""

    @property
    def room(self) -> Room:
        """The room with the calibrated coefficients."""

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""

    @property
    def prior_covariance(self) -> Array:
        """The covariance of the prior, (n_materials * n_bands,) squared."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were matched."""

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The pairs that were matched."""

    @property
    def measured(self) -> MeasuredPairs:
        """The measured values there, and their covariance."""

    @property
    def simulator(self) -> str:
        """The name of the calibrated simulator."""

    @property
    def weighed(self) -> Simulator:
        """The calibrated simulator, with as many paths as are weighed."""

    @property
    def seed(self) -> int:
        """The seed of all its simulations."""

    @property
    def scattering(self) -> Scattering | None:
        """The scattering that was fitted; None where the one stated was kept."""

    @property
    def controls(self) -> ControlRuns | None:
        """The control runs; None where no error is known."""

    @property
    def unexplained(self) -> Array:
        """Standard deviation in JND of what the other errors do not explain, (n_parameters,)."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPrediction(Result):
    """A prediction at every position after a change; `PositionsResult.predict` makes it.

    Rows are the pairs in their order, and then their mean.

    Attributes
    ----------
    name : str
    changes : tuple of Change
    before : Room
        With the prior's coefficients.
    simulator : str
    parameters : tuple of str (n_parameters,)
        Keys of `rtcal.acoustics.observables`.
    pairs : tuple of (source, receiver) (n_pairs,)
    heard_before : array (n_parameters, n_pairs + 1, n_bands)
        Before the change, predicted in the same way; as observed: times are logarithms.
    middle, sigma : array (n_parameters, n_pairs + 1, n_bands)
        Mean and standard deviation after the change, as observed.
    uncalibrated_sigma : array (n_parameters, n_pairs + 1, n_bands)
        Standard deviation of the same prediction without what was measured.
    low, high : array (n_parameters, n_pairs + 1, n_bands)
        Ends of the 90 % interval, as observed.
    sampled : array of bool (n_parameters, n_pairs + 1, n_bands)
        Where the interval is that of samples, since the simulator departs from its linear model.
    shares : mapping of str to array (n_parameters, n_bands)
        Of the variance of the mean over the pairs, by what it comes from.

    Examples
    --------
    >>> from rtcal.prediction import Open
    >>> room = Room(name="box", volume=60, materials=["plaster"], areas=[94], alpha=[[0.2]],
    ...             sigma=[[0.04]], centre_frequencies=[1000])
    >>> t = np.log([[[0.5], [0.5]]])  # one pair and the mean
    >>> found = PositionsPrediction(
    ...     name="window", changes=(Open("plaster", 2.0),), before=room, simulator="a simulator",
    ...     parameters=("t20",), pairs=(("S1", "R1"),), heard_before=t + 0.1, middle=t,
    ...     sigma=0 * t + 0.05, uncalibrated_sigma=0 * t + 0.2,
    ...     low=t - 0.08, high=t + 0.08, sampled=t > 1,
    ...     shares={"alpha of what stays": np.ones((1, 1))})
    >>> found.mean("t20"), found.change("t20")[-1].round(2)
    (array([0.5]), array([-1.9]))
    """

    record_kind: ClassVar[str] = "prediction at positions 1"

    name: str
    changes: tuple[Change, ...]
    before: Room
    simulator: str
    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    heard_before: Array
    middle: Array
    sigma: Array
    uncalibrated_sigma: Array
    low: Array
    high: Array
    sampled: NDArray[np.bool_]
    shares: dict[str, Array]

    def mean(self, parameter: str) -> Array:
        """Return the mean over the pairs in its unit, (n_bands,): the geometric mean of times."""
        return np.asarray(self.at_pairs(parameter)[-1])

    def interval(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % interval of the mean over the pairs, each (n_bands,)."""
        low, high = self.interval_at_pairs(parameter)
        return low[-1], high[-1]

    def at_pairs(self, parameter: str) -> Array:
        """Return each pair's value in its unit and then the mean, (n_pairs + 1, n_bands)."""
        return np.asarray(observable(parameter).natural(self.middle[self._row(parameter)]))

    def interval_at_pairs(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % intervals, each (n_pairs + 1, n_bands)."""
        row, of = self._row(parameter), observable(parameter)
        return of.natural(self.low[row]), of.natural(self.high[row])

    def before_change(self, parameter: str) -> Array:
        """Return each pair's value before the change in its unit and then the mean."""
        row = self._row(parameter)
        return np.asarray(observable(parameter).natural(self.heard_before[row]))

    def change(self, parameter: str) -> Array:
        """Return the effect on each pair and on the mean in JND, (n_pairs + 1, n_bands).

        One JND is that of the value before: 5 % of a time.
        """
        before = self.before_change(parameter)
        return (self.at_pairs(parameter) - before) / observable(parameter).jnd_of(before)

    def half_width(self, parameter: str) -> Array:
        """Return half of the 90 % interval in JND of the value after, (n_pairs + 1, n_bands)."""
        return self._half_in_jnd(parameter, self.low, self.high)

    def _half_in_jnd(self, parameter: str, low: Array, high: Array) -> Array:
        """Return half of the distance of values as observed, in JND of the value after."""
        of, row = observable(parameter), self._row(parameter)
        one = np.asarray(of.jnd_of(self.at_pairs(parameter)))
        return np.asarray((of.natural(high[row]) - of.natural(low[row])) / (2 * one))

    def _row(self, parameter: str) -> int:
        if parameter not in self.parameters:
            raise DataError(f'parameter = "{parameter}" is not one of {", ".join(self.parameters)}')
        return self.parameters.index(parameter)

    def parts(self, parameter: str) -> dict[str, Array]:
        """Return shares of the variance of the mean over the pairs, (n_bands,), the largest first."""
        row = self._row(parameter)
        found = {name: share[row] for name, share in self.shares.items()}
        return dict(sorted(found.items(), key=lambda each: -float(each[1].mean())))

    @property
    def sentences(self) -> list[str]:
        """The parts of the first parameter's interval, and what to measure next."""
        first = self.parameters[0]
        middle, half = self.middle, Z * self.uncalibrated_sigma
        without = self._half_in_jnd(first, middle - half, middle + half)[-1]
        return [
            words.gained(without, self.half_width(first)[-1]),
            words.to_narrow(self.parts(first), 1),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text."""
        return {
            "room": self.before.name,
            "name": self.name,
            "changes": [str(change) for change in self.changes],
            "simulator": self.simulator,
            "centre_frequencies": json_numbers(self.before.centre_frequencies),
            "pairs": [list(pair) for pair in self.pairs],
            "sentences": self.sentences,
            "parameters": {
                p: {
                    "unit": observable(p).unit,
                    "before": json_numbers(observable(p).natural(self.heard_before[i])),
                    "after": json_numbers(self.at_pairs(p)),
                    "interval_90": [json_numbers(end) for end in self.interval_at_pairs(p)],
                    "change_jnd": json_numbers(self.change(p)),
                    "half_width_jnd": json_numbers(self.half_width(p)),
                    "sampled": self.sampled[i].tolist(),
                    "parts": {name: json_numbers(v) for name, v in self.parts(p).items()},
                }
                for i, p in enumerate(self.parameters)
            },
        }

    def __repr__(self) -> str:
        first = self.parameters[0]
        return (
            f'<PositionsPrediction "{shortened(self.name)}" of "{shortened(self.before.name)}": '
            f"{len(self.pairs)} pairs, {parameter_label(first)} {self.change(first)[-1].mean():+.1f} "
            f"JND, ± {np.median(self.half_width(first)[-1]):.1f} JND>"
        )

    def __str__(self) -> str:
        labels = bands.labels(self.before.centre_frequencies)
        rows = []
        for i, p in enumerate(self.parameters):
            of, (low, high) = observable(p), self.interval(p)
            unit = f" / {of.unit}" if of.unit else ""
            before = of.natural(self.heard_before[i, -1])
            for name, values in (
                ("before", before),
                ("after", self.mean(p)),
                ("90 %: from", low),
                ("to", high),
            ):
                shown = text.numbers(values, f".{of.decimals}f")
                rows.append((f"{of.label} {name}{unit}", shown))
        first = self.parameters[0]
        return "\n".join(
            [
                *text.wrapped(f"{self.before.name}: {self.name}"),
                *text.wrapped(f"Mean over {len(self.pairs)} pairs, by {self.simulator}"),
                "",
                *text.table(rows, header=("", labels)),
                "",
                *words.made_of(
                    f"the interval of {parameter_label(first)}", self.parts(first), labels
                ),
                "",
                *(line for sentence in self.sentences for line in text.wrapped(sentence)),
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPredictions(Result):
    """Predictions of several variants at every position.

    Attributes
    ----------
    predictions : tuple of PositionsPrediction
        One per variant.

    Examples
    --------
    >>> PositionsPredictions(predictions=())
    <PositionsPredictions: >
    """

    record_kind: ClassVar[str] = "predictions at positions 1"

    predictions: tuple[PositionsPrediction, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `PositionsPrediction.to_dict`."""
        return {"variants": [prediction.to_dict() for prediction in self.predictions]}

    def __str__(self) -> str:
        return "\n\n\n".join(map(str, self.predictions))

    def __repr__(self) -> str:
        return f"<PositionsPredictions: {', '.join(p.name for p in self.predictions)}>"


@dataclass(frozen=True)
class PairsAndMean:
    """Values (n_parameters, n_pairs, n_bands), and the mean over the pairs behind them."""

    shape: tuple[int, int, int]

    @property
    def with_mean(self) -> tuple[int, int, int]:
        """The shape with the mean, (n_parameters, n_pairs + 1, n_bands)."""
        p, i, k = self.shape
        return p, i + 1, k

    def values(self, values: Array) -> Array:
        """Return values with their mean over the pairs, (n_parameters, n_pairs + 1, n_bands)."""
        return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)

    def variances(self, covariance: Array) -> Array:
        """Return the variances of values and of their mean, of the covariance of all values."""
        of_mean = np.einsum("pikpjk->pk", covariance.reshape(*self.shape, *self.shape))
        own = np.diag(covariance).reshape(self.shape)
        return np.concatenate([own, of_mean[:, np.newaxis] / self.shape[1] ** 2], axis=1)


def quantiles(
    middle: Array, sigma: Array, slope: Array, bend: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the ends of the 90 % intervals, and where they are those of samples."""
    sampled = np.abs(bend) * Z**2 > _BENT * sigma
    low, high = middle - Z * sigma, middle + Z * sigma
    rest = np.sqrt(np.maximum(sigma**2 - slope**2, 0.0))
    z = ndtri((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    other = np.random.default_rng(0).permutation(z)
    for at in np.argwhere(sampled):
        a, b, c, d = (each[tuple(at)] for each in (middle, slope, bend, rest))
        drawn = a + b * z + c * z**2 + d * other
        low[tuple(at)], high[tuple(at)] = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return low, high, sampled


Table = tuple[list[str], list[list[str]]]
"""Header and rows."""


def gap_rows(
    pairs: Sequence[Pair], before: Array, after: Array
) -> list[tuple[str, list[tuple[float, float]]]]:
    """Return the name of each pair and of all, with the rms gap before and after by parameter.

    Gaps are (n_parameters, n_pairs, n_bands) in JND.
    """
    every = [(" to ".join(pair), [i]) for i, pair in enumerate(pairs)]
    every.append(("all", list(range(len(pairs)))))
    ends = [
        [rms(gap[:, some], axis=(1, 2)).tolist() for gap in (before, after)] for _, some in every
    ]
    return [
        (name, list(zip(*of_some, strict=True)))
        for (name, _), of_some in zip(every, ends, strict=True)
    ]


def gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = "rms gap / JND",
) -> Table:
    """Return the header and rows of `gap_rows`."""
    rows = [
        [name, *(" to ".join(number(x, ".1f") for x in ends) for ends in cells)]
        for name, cells in gap_rows(pairs, before, after)
    ]
    return [title, *(parameter_label(p) for p in parameters)], rows


def material_table(
    room: Room,
    learned: Sequence[tuple[str, float, float]],
    shift: Array,
    pulls: Array,
    pairs: Sequence[Pair],
    scattering: Scattering | None,
) -> Table:
    """Return what was learned of each material, in the order of ``learned``.

    ``shift`` (n_materials, n_bands) and ``pulls`` (n_pairs, n_materials, n_bands) are in prior sigmas.
    """
    header = ["", "sigma before", "after", "shift / sigma", "pulled most by"]
    if scattering is not None:
        header.append("scattering")
    strength = np.abs(pulls).mean(axis=2)
    moved = np.sqrt((shift**2).mean(axis=1))
    rows = []
    for name, before, after in learned:
        i = room.material_index(name)
        pair = "-"
        if strength[:, i].any():
            pair = " to ".join(pairs[int(np.argmax(strength[:, i]))])
        row = [name, f"{before:.3f}", f"{after:.3f}", f"{moved[i]:.1f}", pair]
        if scattering is not None:
            s, sigma = (a[i].mean() for a in (scattering.coefficients, scattering.sigma))
            row.append(f"{s:.2f} ± {sigma:.2f}")
        rows.append(row)
    return header, rows


def farther_in_words(gaps: Sequence[tuple[str, float, float]], *, fitted: bool) -> str:
    """Return that a calibrated simulator is not to be used, by parameter with its gaps in JND.

    ``fitted`` says whether its scattering was fitted.
    """
    names = ", ".join(f"{parameter_label(p)} ({old:.1f} to {new:.1f} JND)" for p, old, new in gaps)
    start = "The"
    if fitted:
        start = (
            "The fitted scattering may have ended at a poor fit: try another seed, or state other "
            "scattering. Else the"
        )
    return (
        f"In {names} the calibrated simulator is farther from what was measured than before: do not "
        f"simulate with it. {start} model misses something, or a constraint keeps alpha away."
    )
