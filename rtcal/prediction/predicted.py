"""T after a change, and several variants side by side.

The predicted thing is the change: T before is given, and the interval is that of T after. Of each:
mean, 90 % interval, what the interval is made of, and how probable a range is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.changes import Change, Target, Variant, placed
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import TrustMark, of_surface
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room, is_calibrated, refuse_other_equation
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.run import Run
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.prediction import words
from rtcal.prediction.changed_time import (
    DRAWS,
    Flags,
    KnownRoom,
    TimeChange,
    Unknowns,
    directions,
    normal_of,
    probability_within,
)
from rtcal.prediction.simulated_change import SimulatedChange
from rtcal.support import blocks, checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, shortened
from rtcal.support.types import Array

JND = 0.05
"""One just noticeable difference of T, as a share of T."""
COVERAGE = 0.9
"""Probability that a value is within its printed interval."""
_POINTS = 20_000
"""Most points of the probability that T is within a range in all bands; its error is below 0.001."""
_HARD = 0.1
"""Absorption coefficient below which a surface is called hard."""
_SURE = 1e-12
"""Standard deviation of ln T from which on T is not known exactly."""
_ROUNDING = 1e-9
"""Part of T by which an end of a range is moved outwards, so that a T that equals it is within."""


Known = Any
"""Argument of `predict`: a result with a room, such as a `CalibrationResult`, or a `Room`."""


def known_room(known: Known, equation: LinearEquation | None = None) -> KnownRoom:
    """Return a room before a change, with its coefficients and T from a calibration or from its input.

    ``known`` is the calibration or the room. ``equation`` is the reverberation equation for a room; for
    None it is Eyring's. Raises DataError for another object, and for another equation than that of the
    calibration.
    """
    if isinstance(known, Room):
        equation = equation or Eyring()
        refuse_other_equation(known, equation.name)
        return KnownRoom.stated(known, equation)
    found = known if isinstance(known, KnownRoom) else getattr(known, "known", None)
    if found is None:
        raise DataError(
            f"known = {checks.shown(known)} must be a Room or the result of a calibration"
        )
    if equation is not None and equation != found.equation:
        raise DataError(
            f"equation = {equation.name}, but the room was calibrated with "
            f"{found.equation.name}: leave equation out"
        )
    return found


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Prediction(TimeChange, Result):
    """Hold the predicted T of a changed room in each band, with its interval; `predict` returns it.

    ``name`` is that of the variant, ``changes`` are the changes of the room, and ``assumptions`` are
    what is assumed about them. ``known`` is the room before and ``state`` the room after the change.
    ``simulated`` is T of a program, None without one.
    """

    record_kind: ClassVar[str] = "prediction 3"
    in_file: ClassVar[str] = (
        "room=before.name name changes measured_states=known.n_measured equation=known.equation.name "
        "assumptions centre_frequencies=after.centre_frequencies before_is "
        "reverberation_time_before=time_before uncertainty_before reverberation_time=mean "
        "interval_90=interval change_jnd=change half_width_jnd=half_width "
        "directions_known=is_placed by_equation uncalibrated=uncalibrated.mean "
        "uncalibrated_half_width_jnd=uncalibrated.half_width simulated_times parts sentences"
    )

    name: str
    changes: tuple[Change, ...]
    """Changes of the room that are predicted; empty if the changed room itself was given."""
    simulated: SimulatedChange | None = None
    """T that a program gave before and after the change, in place of the equation's."""

    @cached_property
    def by_program(self) -> Flags:
        """Bands that the program predicts, because both of its runs and the measurement have a T."""
        if self.simulated is None:
            return np.zeros(self.before.n_bands, dtype=bool)
        return np.asarray(self.known.measured & np.isfinite(self.simulated.log_ratio))

    @property
    def simulated_times(self) -> dict[str, Array]:
        """T of the program's runs in s, (n_bands,) each, "before" and "after"; {} without runs."""
        of = self.simulated
        return {} if of is None else {"before": of.before, "after": of.after}

    @property
    def doubts(self) -> tuple[TrustMark, ...]:
        """Cautions about the input, and about areas that fit the volume only before the change."""
        after = [] if of_surface(self.before) else of_surface(self.state.room)
        changed = (replace(each, text=f"after the change, {each.text}") for each in after)
        return *self.known.doubts, *changed

    @property
    def by_equation_alone(self) -> Prediction:
        """Return the same prediction by the equation, without the program's runs."""
        return replace(self, simulated=None)

    @property
    def _sigma_of_new(self) -> Array:
        """As stated; where the program predicts, at least what is assumed of a new material."""
        stated = super()._sigma_of_new
        wider = np.maximum(stated, self.assumptions.changed)
        return np.where(self.by_program & (stated > 0), wider, stated)

    @cached_property
    def _by_program(self) -> Array | None:
        if self.simulated is None or not self.by_program.any():
            return None
        return self.possible(self.simulated.draws(self))

    def log_ratio(self, unknowns: Unknowns | None = None) -> Array:
        """Return random samples of ln(T after / T before), (n_bands, n_draws).

        ``unknowns`` are the random values of what is not known, by default those of this prediction.
        """
        own, simulated = super().log_ratio(unknowns), self._by_program
        return (
            own if simulated is None else np.where(self.by_program[:, np.newaxis], simulated, own)
        )

    @cached_property
    def samples(self) -> Array:
        """Random values of ln T after the change, with T in s, (n_bands, n_draws).

        A measured T before the change counts as exact. Otherwise T before is the model's, with its
        uncertainty.
        """
        given = np.log(self.time_before)[:, np.newaxis] + self.log_ratio()
        if self.known.measured.all():
            return given
        return np.asarray(given + self.log_before())

    @property
    def before_is(self) -> str:
        """Source of T before: "measured", "calibrated model", "calibrated room", "stated coefficients".

        "calibrated room" means that nothing was measured and that the coefficients are calibrated.
        """
        if not self.known.measured.any():
            return words.CALIBRATED if is_calibrated(self.before) else words.STATED
        return words.MEASURED if self.known.exact else words.MODEL

    @cached_property
    def uncertainty_before(self) -> Array:
        """Standard uncertainty of T before in s, (n_bands,); NaN if the measurement has none.

        The uncertainty of a measured T is not part of the interval. If T was not measured, the result
        is the uncertainty of the model, which is part of the interval.
        """
        measured = self.known.log_uncertainty
        if self.known.measured.all():
            return measured * self.time_before
        of_model = self.log_before().std(axis=1)
        return np.where(self.known.measured, measured, of_model) * self.time_before

    @cached_property
    def log_mean(self) -> Array:
        """Mean of ln T after the change, with T in s, (n_bands,)."""
        return np.asarray(self.samples.mean(axis=1))

    @cached_property
    def log_sigma(self) -> Array:
        """Standard deviation of ln T after the change, (n_bands,)."""
        return np.asarray(self.samples.std(axis=1))

    @property
    def mean(self) -> Array:
        """Predicted T after the change in s, (n_bands,): the exponential of the mean of ln T."""
        return np.exp(self.log_mean)

    @cached_property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 90 % interval of T after the change in s, (n_bands,) each, given T before."""
        return self.quantile((1 - COVERAGE) / 2), self.quantile((1 + COVERAGE) / 2)

    def quantile(self, probability: float) -> Array:
        """Return the quantile of T after the change in s, (n_bands,), at a probability.

        Raises DataError unless ``probability`` is between 0 and 1.
        """
        if not 0 < checks.number("probability", probability) < 1:
            raise DataError(f"probability = {probability:g} must be between 0 and 1")
        return np.exp(np.quantile(self.samples, probability, axis=1))

    @property
    def half_width(self) -> Array:
        """Half the width of the 90 % interval in JND, (n_bands,); one JND is 5 % of T after."""
        low, high = self.interval
        return np.asarray((high - low) / (2 * JND * self.mean))

    @property
    def change(self) -> Array:
        """T after minus T before in JND, (n_bands,); one JND is 5 % of T before."""
        return np.asarray((self.mean / self.time_before - 1) / JND)

    @cached_property
    def parts(self) -> dict[str, Array]:
        """Causes of the uncertainty, as shares of the variance of ln T, (n_bands,) each, largest first.

        The shares add up to 1, or are 0 in a band in which nothing changes. ln T is taken as a linear
        function of the causes. Each material whose area changes is one cause; all other coefficients
        together are another.
        """
        unknowns, n_bands = self.unknowns, self.after.n_bands
        columns: dict[str, list[Array]] = {}
        for i, material in enumerate(self.materials):
            part = words.ALPHA.format(material) if self.changing[i] else words.STAYS
            columns.setdefault(part, []).append(np.log(np.maximum(unknowns.alpha[:, i], 1e-6)))
            columns.setdefault(words.EQUATION, []).append(unknowns.factor[:, i])
        columns[words.EQUATION] += [unknowns.evenness, unknowns.alone.astype(float)]
        columns[words.SIZES] = [unknowns.air, unknowns.volume]
        if self.by_program.any():
            columns[words.PROGRAM] = [
                np.broadcast_to(normal_of(words.PROGRAM, DRAWS), unknowns.air.shape)
            ]
        if not self.known.measured.all():
            columns[words.BEFORE] = [self.log_before()]
        shares = {part: np.zeros(n_bands) for part in columns}
        for k in np.flatnonzero(self.log_sigma > _SURE).tolist():
            y = self.samples[k] - self.log_mean[k]
            x = np.array([column[k] for group in columns.values() for column in group])
            x = x - x.mean(axis=1, keepdims=True)
            weights = np.linalg.lstsq(x @ x.T, x @ y, rcond=1e-10)[0]
            own, first = {}, 0
            for part, group in columns.items():
                rows = slice(first, first + len(group))
                own[part] = max(float((weights[rows] @ x[rows]) @ y), 0.0)
                first += len(group)
            total = sum(own.values())
            for part, share in own.items():
                shares[part][k] = share / total if total > 0 else 0.0
        used = {part: share for part, share in shares.items() if share.any()} or {
            words.EQUATION: np.zeros(n_bands)
        }
        return dict(sorted(used.items(), key=lambda each: -float(each[1].mean())))

    @cached_property
    def uncalibrated(self) -> Prediction:
        """Same prediction from the input coefficients alone, without any measurement."""
        known = KnownRoom.stated(self.before, self.known.equation)
        return replace(self, known=known, simulated=None)

    def probability(self, low: Array, high: Array) -> Array:
        """Return the probability that T after the change is within a range, (n_bands,).

        The range is from ``low`` to ``high`` in s, (n_bands,) each; NaN means no limit. Raises
        DataError for another shape, and as `Target` does.
        """
        return probability_within(self.samples, *self._logs(low, high))

    def probability_together(self, low: Array, high: Array) -> float:
        """Return the probability that T after the change is within the range in all bands at once.

        For ``low`` and ``high`` see `probability`. Errors of neighbouring bands are correlated: see
        `Assumptions.band_correlation`.
        """
        from scipy.stats import multivariate_normal

        least, most = self._logs(low, high)
        open_ended = np.full_like(least, np.nan)
        below = 1 - probability_within(self.samples, least, open_ended)
        above = probability_within(self.samples, open_ended, most)
        if (above <= below).any():
            return 0.0
        bounded = (above < 1) | (below > 0)  # the others are in range for certain
        if not bounded.any():
            return 1.0
        errors = bands.correlation(self.after.centre_frequencies, self.assumptions.band_correlation)
        together = multivariate_normal(
            cov=errors[np.ix_(bounded, bounded)], seed=0, maxpts=_POINTS, abseps=1e-4
        )
        return float(together.cdf(ndtri(above[bounded]), lower_limit=ndtri(below[bounded])))

    def _logs(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return the logarithms of a range's ends, (n_bands,) each."""
        every = np.ones(self.after.n_bands)
        for name, ends in (("low", low), ("high", high)):
            if np.shape(ends) not in ((), every.shape):
                raise DataError(f"{name} has shape {np.shape(ends)}; it must be {every.shape}")
        target = Target(every * low, every * high)
        # Where nothing changes, T before may be an end of the range itself.
        return np.log(target.low) - _ROUNDING, np.log(target.high) + _ROUNDING

    @property
    def headline(self) -> str:
        """Change of T in a sentence, for the band that changes most."""
        if not self.log_ratio().any():
            return words.NOTHING_CHANGES
        labels = bands.labels(self.after.centre_frequencies)
        return words.headline(labels, self.time_before, self.mean, self.interval)

    @property
    def heads(self) -> list[str]:
        """Sentences that are printed first: likely typing errors, and the change of T."""
        doubts = [as_sentence(each.sentence) for each in self.doubts]
        return [*doubts, f"{self.before.name}, {self.name}: {self.headline}"]

    @property
    def sentences(self) -> list[str]:
        """Sentences on what the interval contains, what it leaves out, and what to measure next."""
        known = self.known
        if not self.half_width.any():
            return []
        labels = bands.labels(known.room.centre_frequencies)
        stated = words.CALIBRATED_BEFORE if is_calibrated(known.room) else words.NOTHING_MEASURED
        said = [words.GIVEN if known.measured.any() else stated]
        if known.measured.any() and not known.measured.all():
            said.append(words.not_measured([labels[k] for k in np.flatnonzero(~known.measured)]))
        if self.simulated is not None:
            change = np.log(self.mean / self.time_before)
            k = int(np.argmax(np.abs(np.where(self.by_program, change, 0.0))))
            runs, alone = self.simulated, self.by_equation_alone
            both = (float(runs.before[k]), float(runs.after[k])), float(alone.mean[k])
            wide, narrow = (JND * float(np.median(p.half_width)) for p in (alone, self))
            left = [labels[i] for i in np.flatnonzero(known.measured & ~self.by_program)]
            said.append(words.by_program(labels[k], *both, (wide, narrow), left))
        elif not self.is_placed:
            said.append(words.UNPLACED)
        elif len(self.by_equation) > 1:
            own, arau, _ = self.by_equation.values()
            apart = np.abs(arau / own - 1)
            k = int(np.argmax(apart))
            two = dict(zip(self.by_equation, (float(own[k]), float(arau[k])), strict=False))
            low, high = self.interval
            if apart[k] >= JND:
                ends = float(low[k]), float(high[k])
                said.append(words.uneven(labels[k], float(self.mean[k]), two, ends))
        if self.simulated is None:
            said += self._of_coefficients
        if known.measured.any() and self.simulated is None:
            said.insert(0, words.gained(JND * self.uncalibrated.half_width, JND * self.half_width))
        said.append(words.to_narrow(self.parts, known.n_measured))
        return said

    @property
    def _of_coefficients(self) -> list[str]:
        """Sentences on T that changes although the input coefficients of old and new are alike."""
        known, room, said = self.known, self.before, []
        labels = bands.labels(room.centre_frequencies)
        rows = [known.materials.index(material) for material in room.materials]
        calibrated = known.alpha[rows]
        # What the calibration added to the absorption area of what leaves, over that of the room.
        moved = self.exchanged[0, rows, np.newaxis] * (calibrated - room.alpha)
        share = moved.sum(axis=0) / known.equation.target(room, known.time)
        share = np.where(known.measured & np.isfinite(share), share / (1 - share), 0.0)
        k = int(np.argmax(np.abs(share)))
        least = max(JND, abs(float(self.mean[k] / self.time_before[k]) - 1) / 4)
        if self._new and abs(share[k]) >= least:
            i = int(np.argmax(np.abs(moved[:, k])))
            old = room.materials[i], float(room.alpha[i, k]), float(calibrated[i, k])
            new = [self.after.materials[i] for i in self._new]
            said.append(words.of_calibrated(labels[k], old, new, float(share[k])))
        (name, alone), *others = self.by_equation.items()
        comes = self.known_alpha.alpha[:, self.exchanged[1] > 0, 0].min(axis=1, initial=1.0)
        below = np.where(known.measured & (comes < _HARD), 1 - self.mean / alone, 0.0)
        k = int(np.argmax(below))
        # Where Arau-Puchades' T differs too, `words.uneven` says why.
        if below[k] >= JND and all(abs(t[k] / alone[k] - 1) < JND for _, t in others[:1]):
            said.append(words.of_hard(labels[k], float(below[k]), name))
        return said

    def __repr__(self) -> str:
        return (
            f'<Prediction "{shortened(self.name)}" of "{shortened(self.before.name)}": '
            f"{bands.span(self.after.centre_frequencies)}, T {100 * JND * self.change.mean():+.0f} %, "
            f"± {100 * JND * np.median(self.half_width):.0f} %>"
        )

    @property
    def rows(self) -> list[Row]:
        """Rows of a table: T before and after, with interval and change, by band."""
        low, high = self.interval
        return [
            Row(f"T before ({self.before_is}) / s", self.time_before, ".2f"),
            Row("its standard uncertainty / s", self.uncertainty_before, ".3f"),
            Row("T after / s", self.mean, ".2f"),
            Row("90 % interval: from / s", low, ".2f"),
            Row("               to / s", high, ".2f"),
            Row("change / s", self.mean - self.time_before, "+.2f"),
            Row("change / %", 100 * JND * self.change, "+.1f"),
            Row("half the interval / % of T", 100 * JND * self.half_width, ".1f"),
            *([self._of_equation] if self.log_ratio().any() else []),
        ]

    @property
    def _of_equation(self) -> Row:
        """Row of a table: T after by the equation with alpha as calibrated, without other errors."""
        name, after = next(iter(self.by_equation.items()))
        return Row(f"{name}'s equation alone / s", after, ".2f")

    def within(self, target: Target) -> list[Row]:
        """Return rows of a table: a range of T, and the probability that T is within it, by band.

        ``target`` has the ends of the range in s.
        """
        return [
            Row("target: from / s", target.low, ".2f"),
            Row("        to / s", target.high, ".2f"),
            Row("probability of target", self.probability(target.low, target.high), ".2f"),
        ]

    def blocks(self) -> list[Block]:
        """Return the tables and sentences that the prediction prints."""
        labels = bands.labels(self.after.centre_frequencies)
        parts = ("the interval", self.parts)
        return words.blocks_of(self.heads, labels, self.rows, parts, self.sentences)

    # What a table of variants and a page show

    @property
    def shown(self) -> words.Shown:
        """T before and after, with its interval."""
        return words.Shown("T / s", "ln T", self.time_before, self.mean, self.interval, self.parts)

    @property
    def assumed(self) -> list[Block | list[str]]:
        """Assumptions of the prediction, as sentences and a list."""
        n = self.known.n_measured
        return [
            Note(
                f"{self.known.equation.name}'s equation, {n} measured state{'s' * (n != 1)}. Standard "
                "deviations, unless said otherwise:"
            ),
            [f"{words.ASSUMED[k]}: {v:g}" for k, v in asdict(self.assumptions).items()],
            Note(words.REMARK.format(" and for the T before that is given")),
        ]


def predict(
    known: Known,
    changes: Change | Sequence[Change] | Room,
    *,
    equation: LinearEquation | None = None,
    assumptions: Assumptions | None = None,
    name: str = "",
    run: Run | None = None,
    run_after: Measurement | None = None,
) -> Prediction:
    """Return the T of a room after a change, in each band, with its 90 % interval.

    Parameters
    ----------
    known : CalibrationResult or Room
        Calibration of the room before the change, or a room without a measurement, whose input
        coefficients are then used. After a calibration of several measured states of a room
        (`rtcal.Configurations`), give the entry of its ``results`` for the state that changes.
    changes : Change, sequence of Change, or Room
        Change or changes of the room, or the changed room itself.
    equation : LinearEquation, optional
        Reverberation equation for a Room, by default `rtcal.Eyring`; a calibration keeps its equation.
    assumptions : Assumptions, optional
        Assumed uncertainties, such as that of the new materials; by default usual values.
    name : str
        Name of the change in printed text; by default the names of its materials.
    run : Run, optional
        Room before the change as a simulation program had it, with the program's values. The program's
        ratio of T after to T before then replaces that of the equation, and multiplies the measured T.
    run_after : Measurement, optional
        Values of the same program after the change; needed with ``run``.

    Returns
    -------
    Prediction
        Prediction with the ``mean`` T and the 90 % ``interval`` in s, (n_bands,) each.

    Raises
    ------
    DataError
        If a change does not fit the room, or the changed room does not fit the room before. With
        ``run``: if ``run_after`` is missing, if no T was measured, if the run is of another room, or if
        the two simulations have no T20 or T30 in common.
    ModelError
        If the equation gives no T for the changed room.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> panel = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> after = predict(result, rt.prediction.Change(cover="ceiling", by=panel, area=20))
    >>> low, high = after.interval
    >>> print(bool((low < after.mean).all() and (after.mean < high).all()))
    True
    """
    room_known = known_room(known, equation)
    made: tuple[Change, ...] = ()
    if isinstance(changes, Room):
        default = changes.name
    else:
        if isinstance(changes, str):
            raise DataError(
                f"changes = {changes!r} must be an rtcal.prediction.Change or a list of them"
            )
        made = (changes,) if isinstance(changes, Change) else checks.listed("changes", changes)
        default = "; ".join(map(str, made)) or "no change"
    simulated = None
    if run is not None or run_after is not None:
        if run is None or run_after is None:
            lacking = "run" if run is None else "run_after"
            raise DataError(
                f"{lacking} is missing: give the program's results both before and after the change"
            )
        if not (room_known.measured.any() and room_known.exact):
            raise DataError(
                "run needs a calibration to a measured T, because this T is multiplied by "
                "the program's ratio of T after to T before"
            )
        simulated = SimulatedChange.of(room_known.room, run, run_after)
    prediction = Prediction(
        simulated=simulated,
        name=name or default,
        known=room_known,
        state=placed(
            room_known.room,
            changes if isinstance(changes, Room) else made,
            shares=directions(room_known.room),
        ),
        changes=made,
        assumptions=assumptions or Assumptions(),
    )
    prediction.refuse()
    by_program = simulated is not None and np.nan_to_num(simulated.log_ratio).any()
    if by_program and not prediction.by_equation_alone.log_ratio().any():
        raise DataError(
            f'"{prediction.name}": the program has another T after the change, but nothing of the '
            "room changes: state the change ([[variant.change]])"
        )
    return prediction


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Predictions(Result):
    """Hold the predictions of several changes of one room, of T or at every position."""

    record_kind: ClassVar[str] = "predictions 3"

    predictions: tuple[Any, ...]
    """Predictions, one per variant."""
    costs: tuple[float | None, ...]
    """Cost of each variant, None where it is unknown."""
    target: Target | None = None
    """Range of T with which the variants are compared; None without one."""

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's prediction, cost, and probability of the target as plain values."""
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
        beside, several = self.side_by_side(), self.predictions
        if len(several) > 1 and all(isinstance(p, Prediction) for p in several):
            return "\n".join(blocks.lines(self._together(beside)))
        return "\n\n\n".join(
            [*map(str, several), *(["\n".join(blocks.lines(beside))] if beside else [])]
        )

    def _together(self, beside: Sequence[Block]) -> list[Block]:
        """Return the sentences of all variants, common ones once, T ``beside``, and intervals."""
        every, labels = (
            self.predictions,
            bands.labels(self.predictions[0].before.centre_frequencies),
        )
        common = [said for said in every[0].sentences if all(said in p.sentences for p in every)]
        own = [(p.name, s) for p in every for s in p.sentences if s not in common]
        found: list[Block] = [*map(Note, dict.fromkeys(head for p in every for head in p.heads))]
        found += map(Note, words.in_order([*words.joined(own), *common]))
        found += [Table(labels, every[0].rows[:2]), *beside]
        chosen = ("90 %", "      ", "change / %", f"{every[0].known.equation.name}'s")
        for p in every:
            rows = [row for row in p.rows if row.name.startswith(chosen)]
            found.append(Table(labels, rows, f"{p.name}: interval and change of T"))
        return found

    def side_by_side(self) -> list[Block]:
        """Return a table of the variants' T, with cost and probability where they are known."""
        if len(self.predictions) == 1 and self.target is None:
            return []
        labels = bands.labels(self.predictions[0].before.centre_frequencies)
        shown = [p.shown for p in self.predictions]
        rows = [Row(p.name, s.after, ".2f") for p, s in zip(self.predictions, shown, strict=True)]
        found: list[Block] = [Table(labels, rows, f"{shown[0].name} after each change")]
        if self.target is not None:
            found += [Note(said) for said in words.of_target(self.target)]
        elif all(cost is None for cost in self.costs):
            return found
        costs = ["-" if c is None else f"{c:.0f}" for c in self.costs]
        chances = [[f"{chance:.2f}" for chance in each] for each in self.chances()]
        rows = [
            Row(p.name, [cost, *each])
            for p, cost, each in zip(
                self.predictions, costs, chances or [[]] * len(costs), strict=True
            )
        ]
        columns = ["cost", "probability of the worst band", "of all bands"][: len(rows[0].values)]
        return [*found, Table(columns, rows, corner="variant")]

    def chances(self) -> list[tuple[float, float]]:
        """Return each variant's probability to meet the target: in its worst band, and in all bands.

        The list is empty without a target.
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


def predict_variants(
    known: Known,
    variants: Sequence[Variant],
    *,
    equation: LinearEquation | None = None,
    assumptions: Assumptions | None = None,
    target: Target | None = None,
    run: Run | None = None,
) -> Predictions:
    """Return the T of a room after each of several changes, with 90 % intervals.

    Parameters
    ----------
    known, equation, assumptions
        Room before the change and how it is calculated, as for `predict`.
    variants : sequence of Variant
        Changes to compare, each with its name.
    target : Target, optional
        Range of T; the result then has each variant's probability of it.
    run : Run, optional
        Values of a simulation program before the changes. Variants that have ``simulated`` values are
        then predicted with the program's ratio of T, all others with the equation.

    Returns
    -------
    Predictions
        The ``predictions``, one for each variant, and the ``costs``.

    Raises
    ------
    DataError
        As `predict`; also if two variants have the same name, for a target in other bands, and for a
        ``run`` if no variant has ``simulated``.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Change, Variant
    >>> result = rt.calibrate(*rt.datasets.bras_cr2())
    >>> predict_variants(result, [Variant("window open", (Change(open="windows", area=2.0),))])
    <Predictions: window open>
    """
    checks.distinct("variants", [variant.name for variant in variants])
    room_known = known_room(known, equation)
    if run is not None and all(v.simulated is None for v in variants):
        raise DataError(
            "a simulation before the change is given, but no variant has simulated, the "
            "simulation after the change. Add simulated to a variant, or leave the "
            "simulation before the change out"
        )
    made = tuple(
        predict(
            room_known,
            v.changes,
            assumptions=assumptions,
            name=v.name,
            run=None if v.simulated is None else run,
            run_after=v.simulated,
        )
        for v in variants
    )
    n_bands = made[0].after.n_bands if made else 0
    if target is not None and target.low.shape != (n_bands,):
        raise DataError(f"target has {len(target.low)} bands; it must have the room's {n_bands}")
    return Predictions(predictions=made, costs=tuple(v.cost for v in variants), target=target)
