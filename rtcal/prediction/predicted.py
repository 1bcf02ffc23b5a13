"""T after a change, and several variants side by side.

Of each: mean, 90 % interval, what the interval is made of, and how probable a range is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import Variant, refuse_repeated_names
from rtcal.acoustics.changes import Change, changed
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.states import Estimate, Rooms, State, estimated_change, near_bounds, samples
from rtcal.acoustics.targets import Target
from rtcal.prediction import words
from rtcal.support import checks, text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.results import Result
from rtcal.support.sampler import probability_within
from rtcal.support.text import shortened
from rtcal.support.types import Array

JND = float(np.log(1.05))
"""One just noticeable difference of T, in ln T."""
LEVEL = 0.9
SAMPLES = 4000
"""Number of samples of a band whose bounds matter."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Prediction(Result):
    """T of a changed room per band, with its interval; `predict` makes it.

    Attributes
    ----------
    name : str
    states : tuple of State
        What was measured.
    before, after : Room
        With the prior's coefficients.
    changes : tuple of Change
        What leads from one to the other; empty if the changed room itself was given.
    equation : LinearEquation
    assumptions : Assumptions
    """

    record_kind: ClassVar[str] = "prediction 1"

    name: str
    states: tuple[State, ...]
    before: Room
    after: Room
    changes: tuple[Change, ...]
    equation: LinearEquation
    assumptions: Assumptions

    @cached_property
    def rooms(self) -> Rooms:
        """The measured states, the room before and the room after, on common unknowns."""
        every = [*(state.room for state in self.states), self.before, self.after]
        return Rooms(every, self.equation, self.assumptions)

    @cached_property
    def estimate(self) -> Estimate:
        """The posterior of the unknowns."""
        return estimated_change(self.rooms, self.states)

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """ln T after the change at the mode, (n_bands,), and its gradient (n_bands, size)."""
        return self.rooms.log_time(len(self.rooms.rooms) - 1, self.estimate.mode)

    @cached_property
    def linear_mean(self) -> Array:
        """ln T of the most probable unknowns, T in s, (n_bands,)."""
        return self._linear[0]

    @cached_property
    def linear_sigma(self) -> Array:
        """Standard deviation of ln T of the linear estimate, (n_bands,)."""
        gradient = self._linear[1]
        variance = np.einsum("ks,kst,kt->k", gradient, self.estimate.covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(variance, 0) + self.assumptions.own**2))

    @cached_property
    def sampled(self) -> NDArray[np.bool_]:
        """Which bands are sampled, (n_bands,) of bool: a coefficient that matters is near a bound.

        Elsewhere ln T is normal.
        """
        n = len(self.rooms.materials)
        return near_bounds(self.rooms, self.estimate, self._linear[1][:, :n], self.linear_sigma)

    @cached_property
    def _draws(self) -> dict[int, Array]:
        """Samples of ln T without the equation's own error, by the index of a sampled band."""
        last, n_bands = len(self.rooms.rooms) - 1, self.after.n_bands
        drawn = {}
        for k in np.flatnonzero(self.sampled).tolist():
            unknowns = samples(self.rooms, self.estimate, k, SAMPLES)
            every = np.repeat(unknowns[:, np.newaxis], n_bands, axis=1)
            drawn[k] = self.rooms.log_time(last, every)[0][:, k]
        return drawn

    @cached_property
    def log_mean(self) -> Array:
        """Mean of ln T, T in s, (n_bands,)."""
        mean = self.linear_mean.copy()
        for k, draws in self._draws.items():
            mean[k] = draws.mean()
        return mean

    @property
    def mean(self) -> Array:
        """T in s, (n_bands,): the exponential of the mean of ln T."""
        return np.exp(self.log_mean)

    @cached_property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 90 % interval of T in s, each (n_bands,), for a measurement without error."""
        return self.quantile((1 - LEVEL) / 2), self.quantile((1 + LEVEL) / 2)

    def quantile(self, probability: float) -> Array:
        """Return the quantile of T in s, (n_bands,); DataError unless it is between 0 and 1."""
        if not 0 < checks.number("probability", probability) < 1:
            raise DataError(f"probability = {probability:g} is not between 0 and 1")
        out = self.linear_mean + ndtri(probability) * self.linear_sigma
        for k, draws in self._draws.items():
            # The own error's normal density is added as its quantiles, one to each sample.
            own = ndtri((np.random.default_rng(k).permutation(len(draws)) + 0.5) / len(draws))
            out[k] = np.quantile(draws + self.assumptions.own * own, probability)
        return np.asarray(np.exp(out))

    @property
    def half_width(self) -> Array:
        """Half of the 90 % interval in JND, ln(T ratio) / ln 1.05, (n_bands,)."""
        low, high = self.interval
        return np.asarray(np.log(high / low) / 2 / JND)

    @cached_property
    def time_before(self) -> Array:
        """T before the change in s, (n_bands,): measured, or the model's where it was not."""
        model = np.exp(self.rooms.log_time(len(self.rooms.rooms) - 2, self.estimate.mode)[0])
        for state in self.states:
            if state.room is self.before:
                measured = state.reverberation_time
                return np.where(np.isfinite(measured), measured, model)
        return model

    @property
    def change(self) -> Array:
        """Effect of the change on T in JND, ln(T ratio) / ln 1.05, (n_bands,)."""
        return np.asarray((self.log_mean - np.log(self.time_before)) / JND)

    @cached_property
    def parts(self) -> dict[str, Array]:
        """Shares of the variance of ln T by what they come from, each (n_bands,), the largest first.

        They are those of the linear estimate and add up to 1. A material whose area changes stands
        alone; the other coefficients stand together.
        """
        rooms, found, gradient = self.rooms, self.estimate, self._linear[1]
        n, own = len(rooms.materials), self.assumptions.own
        by_measured = np.einsum("ks,ksc->kc", gradient, found.gain)
        left = gradient - np.einsum("kc,kcs->ks", by_measured, found.gradient)
        by_unknown = left * np.einsum("kst,kt->ks", rooms.prior[1], left)
        parts = {
            words.ALPHA.format(m): by_unknown[:, i]
            for i, m in enumerate(rooms.materials)
            if rooms.changing[i]
        }
        stays = by_unknown[:, :n][:, ~rooms.changing]
        known = (found.gradient != 0).any(axis=2)
        parts[words.STAYS] = stays.sum(axis=1)
        parts[words.EQUATION] = by_unknown[:, -1] + own**2 * (
            1 + (by_measured**2 * known).sum(axis=1)
        )
        parts[words.SIZES] = by_unknown[:, n:-1].sum(axis=1)
        parts[words.MEASUREMENT] = (by_measured**2 * found.noise).sum(axis=1)
        shares = {name: share / self.linear_sigma**2 for name, share in parts.items()}
        return dict(sorted(shares.items(), key=lambda each: -float(each[1].mean())))

    @cached_property
    def uncalibrated(self) -> Prediction:
        """The same prediction from the stated coefficients alone, without any measurement."""
        return replace(self, states=())

    def probability(self, low: Array, high: Array) -> Array:
        """Return the probability that T is from ``low`` to ``high`` in s, (n_bands,).

        NaN at an end leaves it open. DataError for another shape, and as `Target`.
        """
        below, above = self._levels(low, high)
        return np.asarray(above - below)

    def probability_together(self, low: Array, high: Array) -> float:
        """Return the probability that T is within the range in all bands at once.

        Errors of neighbouring bands correlate: see `Assumptions.band_correlation`.
        """
        below, above = (ndtri(level) for level in self._levels(low, high))
        errors = bands.correlation(self.after.centre_frequencies, self.assumptions.band_correlation)
        return probability_within(below, above, errors)

    def _levels(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Probabilities of a T below each end, (n_bands,) each."""
        every = np.ones(self.after.n_bands)
        for name, ends in (("low", low), ("high", high)):
            if np.shape(ends) not in ((), every.shape):
                raise DataError(f"{name} has shape {np.shape(ends)}; it is {every.shape}")
        target = Target(every * low, every * high)
        with np.errstate(divide="ignore"):
            logs = np.log([np.nan_to_num(target.low), np.nan_to_num(target.high, nan=np.inf)])
        levels = ndtr((logs - self.linear_mean) / self.linear_sigma)
        for k, draws in self._draws.items():
            own = max(self.assumptions.own, 1e-12)
            levels[:, k] = ndtr((logs[:, k, np.newaxis] - draws) / own).mean(axis=1)
        return levels[0], levels[1]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text."""
        low, high = self.interval
        return {
            "room": self.before.name,
            "name": self.name,
            "changes": [str(change) for change in self.changes],
            "measured_states": len(self.states),
            "equation": self.equation.name,
            "assumptions": asdict(self.assumptions),
            "centre_frequencies": json_numbers(self.after.centre_frequencies),
            "reverberation_time_before": json_numbers(self.time_before),
            "reverberation_time": json_numbers(self.mean),
            "interval_90": [json_numbers(low), json_numbers(high)],
            "change_jnd": json_numbers(self.change),
            "half_width_jnd": json_numbers(self.half_width),
            "uncalibrated": {
                "reverberation_time": json_numbers(self.uncalibrated.mean),
                "half_width_jnd": json_numbers(self.uncalibrated.half_width),
            },
            "sampled": self.sampled.tolist(),
            "parts": {name: json_numbers(share) for name, share in self.parts.items()},
            "sentences": words.sentences(
                self.parts,
                self.half_width,
                self.uncalibrated.half_width if self.states else None,
                len(self.states),
            ),
        }

    def __repr__(self) -> str:
        return (
            f'<Prediction "{shortened(self.name)}" of "{shortened(self.before.name)}": '
            f"{bands.span(self.after.centre_frequencies)}, T {self.change.mean():+.1f} JND, "
            f"± {np.median(self.half_width):.1f} JND>"
        )

    def __str__(self) -> str:
        return words.text_of(self.to_dict())


@checked
def predict(
    states: Sequence[State],
    changes: Change | Sequence[Change] | Room,
    *,
    before: Room | None = None,
    equation: LinearEquation | None = None,
    assumptions: Assumptions | None = None,
    name: str = "",
) -> Prediction:
    """Predict T after a change from the measured states of a room, which are taken jointly.

    Parameters
    ----------
    states : sequence of State
        May be empty if ``before`` is given: the stated coefficients alone then predict.
    changes : Change, sequence of Change, or Room
        A Room is the changed room itself.
    before : Room, optional
        The room that is changed; that of the first state if not given.
    equation : LinearEquation, optional
        `rtcal.Eyring` if not given.
    assumptions : Assumptions, optional
        By default the usual ones.
    name : str
        By default what is changed.

    Raises
    ------
    DataError
        If a change does not fit the room, the rooms do not fit each other, or no room is given.
    ModelError
        If the equation gives no T for the changed room.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> panel = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> after = result.predict(rt.prediction.Cover("ceiling", panel, 20))
    >>> low, high = after.interval
    >>> print(after.mean.round(1), bool((low < after.mean).all() and (after.mean < high).all()))
    [1.3 1.  0.8 0.8 0.8 0.8] True
    """
    listed = tuple(states)
    if before is None and not listed:
        raise DataError("states is empty, and no room before the change is given")
    before = listed[0].room if before is None else before
    made: tuple[Change, ...] = ()
    if isinstance(changes, Room):
        after, default = changes, changes.name
    else:
        made = (changes,) if isinstance(changes, Change) else tuple(changes)
        after, default = changed(before, made), "; ".join(map(str, made)) or "no change"
    prediction = Prediction(
        name=name or default,
        states=listed,
        before=before,
        after=after,
        changes=made,
        equation=equation or Eyring(),
        assumptions=assumptions or Assumptions(),
    )
    _ = prediction.linear_mean  # raises where the equation gives no T
    return prediction


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Predictions(Result):
    """Predictions of several variants of one room; `compare` makes it.

    Attributes
    ----------
    predictions : tuple of Prediction
        One per variant.
    costs : tuple of float or None
        Of each variant.
    target : Target or None
        The range of T that they are compared with.
    """

    record_kind: ClassVar[str] = "predictions 1"

    predictions: tuple[Prediction, ...]
    costs: tuple[float | None, ...]
    target: Target | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `Prediction.to_dict`, its cost, and the probability of the target."""
        record: dict[str, Any] = {
            "variants": [prediction.to_dict() for prediction in self.predictions],
            "costs": list(self.costs),
        }
        if self.target is not None:
            ends = self.target.low, self.target.high
            record["target"] = {
                **self.target.to_dict(),
                "probability": [json_numbers(p.probability(*ends)) for p in self.predictions],
                "probability_together": [p.probability_together(*ends) for p in self.predictions],
            }
        return record

    def __str__(self) -> str:
        return "\n\n\n".join([*map(str, self.predictions), *self._side_by_side()])

    def _side_by_side(self) -> list[str]:
        """Return a table of the variants' T, and of cost and probability where they are known."""
        if len(self.predictions) == 1 and self.target is None:
            return []
        labels = bands.labels(self.predictions[0].after.centre_frequencies)
        rows = [(p.name, [f"{t:.2f}" for t in p.mean]) for p in self.predictions]
        lines = ["side by side: T / s", *text.table(rows, header=("", labels))]
        columns = {"cost": ["-" if c is None else f"{c:.0f}" for c in self.costs]}
        if self.target is not None:
            lines += ["", *text.wrapped(f"Target: {self.target.source}")]
            least, together = zip(*self.chances(), strict=True)
            columns["least band"] = [f"{p:.2f}" for p in least]
            columns["all bands"] = [f"{p:.2f}" for p in together]
        elif all(cost is None for cost in self.costs):
            return ["\n".join(lines)]
        each = [(p.name, [c[i] for c in columns.values()]) for i, p in enumerate(self.predictions)]
        return ["\n".join([*lines, *text.table(each, header=("", list(columns)))])]

    def chances(self) -> list[tuple[float, float]]:
        """Return of each variant the least probability of a band of the target, and that of all.

        Empty without a target.
        """
        if self.target is None:
            return []
        ends, bounded = (self.target.low, self.target.high), self.target.bounded
        return [
            (float(p.probability(*ends)[bounded].min()), p.probability_together(*ends))
            for p in self.predictions
        ]

    def __repr__(self) -> str:
        return f"<Predictions: {', '.join(p.name for p in self.predictions)}>"


@checked
def compare(
    states: Sequence[State],
    variants: Sequence[Variant],
    *,
    before: Room | None = None,
    equation: LinearEquation | None = None,
    assumptions: Assumptions | None = None,
    target: Target | None = None,
) -> Predictions:
    """Predict T of several variants; the arguments and errors are those of `predict`.

    A ``target`` is a range of T that they are compared with. Raises DataError also where two variants
    have one name, and for a target of other bands.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Open, State, Variant
    >>> room, measured = rt.datasets.bras_cr2()
    >>> state = State(room, measured.mean("t30"))
    >>> compare([state], [Variant("window open", (Open("windows", 2.0),))])
    <Predictions: window open>
    """
    refuse_repeated_names(variants)
    given: dict[str, Any] = {"before": before, "equation": equation, "assumptions": assumptions}
    made = tuple(predict(states, v.changes, name=v.name, **given) for v in variants)
    n_bands = made[0].after.n_bands if made else 0
    if target is not None and target.low.shape != (n_bands,):
        raise DataError(f"target has {len(target.low)} bands; the room has {n_bands}")
    return Predictions(predictions=made, costs=tuple(v.cost for v in variants), target=target)
