"""The closed loop: calibrate an equation, and move its target until a simulator has the measured T.

Coefficients that give the measured T by an equation give another T in a simulator. But the simulator's
T changes with the equation's target T (Bellows & Katz 2025, Sects. 4.2 and 4.3). The loop therefore
changes the target of each band by a rule of `rtcal.loop.rules`.

One target per band can match one number: T20, or a compromise with EDT, the weighted geometric mean of
the decay times, T_c = product of T_p to the power of p's share. Where the times follow the target
alike, matching T_c leaves the smallest weighted sum of squares of log(T_p / measured T_p).

`calibrate_simulator` runs the `Loop` with a simulator that Python can call. For a program that a user
runs, there are `start`, `Loop.next_alpha` and `Loop.record`, or ``rtcal loop``. Each step by hand
leaves two files: the state of the loop, and the room to simulate. The room states the digest of its
coefficients, so that a table simulated with other coefficients is refused.
"""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label, labels, notes, span
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import TrustMark, explained, gap_jnd, in_room, of_row, rms
from rtcal.acoustics.measurement import MAX_BYTES, Measurement
from rtcal.acoustics.observables import EARLY, TARGET, observable, parameter_label
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.acoustics.room_errors import in_words
from rtcal.calibration.measured import data_history, tell_data, times_in_room
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.result import CalibrationResult
from rtcal.files.disk import json_numbers, read_text, write_all
from rtcal.files.saved import NOT_SAVED, Result, load
from rtcal.loop import rules
from rtcal.loop.measured_pairs import (
    SHOWN,
    Gaps,
    Pair,
    left,
    left_out,
    means,
    refuse_unknown,
    sentences,
)
from rtcal.loop.rules import RULES, Rule
from rtcal.modes.calibrate import ModesResult, above_schroeder, of_room
from rtcal.simulators.base import Simulator, at_places, check_alpha, check_fits, lost_paths, run
from rtcal.support import blocks, checks, text
from rtcal.support.blocks import Block, Note, Table
from rtcal.support.errors import DataError, OtherBandsWarning, RtcalError, SimulatorError
from rtcal.support.text import as_sentence, shortened
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
    in_room = measured.in_bands(frequencies)
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


STATUSES = (
    "converged",
    "no measured T",
    "by modes",
    "too few modes",
    "unreachable",
    "not converging",
    "not confirmed",
)
"""Status of a band. Only a `LoopResult` has the last one: the loop itself has no confirmation."""
LEFT_ALONE = STATUSES[:4]
"""Statuses of bands of which the loop asks nothing more."""
MAX_DECIMALS = 12
"""Largest number of decimals of alpha that a program reads."""
_CLOSE_TARGETS = np.log(1.1)
"""If log targets with and without a simulated T20 are closer, another simulation gains little: T is
then known within 10 %, two JND."""
_STUCK_STEPS = 3
"""Steps with different coefficients and the same T20 after which T does not depend on alpha."""
_AT_LIMIT = 1e-9  # relative; rounding of a target that was set to the limit
_FROM_BOUNDS = 1e-3
"""Share of the range of S'alpha that a target keeps from its ends: at the bounds T may be 0, or
infinite without air."""
_BELOW_LARGEST_MEAN = 0.999  # of the mean coefficient at which the equation ends


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One simulation.

    Attributes
    ----------
    target : array (n_bands,)
        T in s that the equation was calibrated to, NaN without a measured T.
    alpha : array (n_materials, n_bands)
        Coefficients as simulated.
    simulated : array (n_bands,)
        Simulated T in s of what is matched, NaN if these coefficients give none.
    noise : array (n_bands,)
        Standard error of it in s; 0 if the simulator states none, NaN if it is unknown.
    means : dict of parameter to array (n_bands,)
        Means of all parameters that are shown, as simulated, matched or not.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array
    means: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        alpha = checks.shaped("step: alpha", self.alpha, "n_materials", "n_bands")
        n_bands = alpha.shape[1]
        object.__setattr__(self, "alpha", alpha)
        for name in ("target", "simulated", "noise"):
            values = checks.shaped(f"step: {name}", getattr(self, name), n_bands)
            object.__setattr__(self, name, values)
        means = {
            checks.text("step: a parameter of means", p): checks.shaped(
                f"step: means[{checks.shown(p)}]", values, n_bands
            )
            for p, values in checks.mapped("step: means", self.means).items()
        }
        object.__setattr__(self, "means", means)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Loop(Result):
    """A closed loop between two simulations.

    A loop does not change: `record` returns the loop after a simulation. `start` returns a new
    loop. `save`, given a file's name, and `load` keep it between two runs of a program.

    Attributes
    ----------
    room : Room
        Its alpha and sigma are the prior.
    matched : Matched
        What is matched: the measured T20, or its compromise with EDT.
    measured : str
        Fingerprints of the data, for the record of the calibrated room.
    rule : {"secant", "safeguarded"}
        See `rtcal.loop.rules`.
    method : str
        Method of the equation's calibration; see `rtcal.calibrate`.
    equation : LinearEquation
    decimals : int, optional
        Decimals of alpha that the program reads. The loop simulates the rounded coefficients.
    tolerance : float
        In JND.
    steps : tuple of Step
    bent : tuple of TrustMark
        Bands whose measured decay is not straight.
    beside : dict of parameter to array (n_bands,)
        Measured means of what is shown and not matched.
    low : ModesResult, optional
        What room modes tell of the bands below the Schroeder frequency.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> loop = start(room, measured)
    >>> times = 1.2 * rt.Eyring().time(room, room.areas @ loop.next_alpha)  # the program
    >>> simulated = rt.Measurement.from_values(room.centre_frequencies, t20=times)
    >>> loop.record(loop.next_alpha, simulated)
    <Loop "BRAS CR2, seminar room": 1 simulation, 0 of 6 bands converged>
    """

    record_kind: ClassVar[str] = "loop"

    room: Room
    matched: Matched
    measured: str
    rule: Rule
    method: str = "mle"
    equation: LinearEquation = field(default_factory=Eyring)
    decimals: int | None = None
    tolerance: float = 1.0
    steps: tuple[Step, ...] = ()
    bent: tuple[TrustMark, ...] = ()
    beside: Mapping[str, Array] = field(default_factory=dict)
    low: ModesResult | None = None
    _problems: list[CalibrationProblem[CalibrationResult]] = field(
        default_factory=list, metadata=NOT_SAVED
    )

    def __post_init__(self) -> None:
        if not isinstance(self.rule, str) or self.rule not in RULES:
            raise DataError(f'rule = "{self.rule}" is not one of {", ".join(RULES)}')
        preset(self.method)
        if self.decimals is not None and checks.whole("decimals", self.decimals, 1) > MAX_DECIMALS:
            raise DataError(f"decimals = {self.decimals} is more than {MAX_DECIMALS}")
        checks.positive("tolerance", self.tolerance, "JND")

    def __repr__(self) -> str:
        n, measured = len(self.steps), np.isfinite(self.wanted).sum()
        converged = self.status.count("converged") if self.steps else 0
        return (
            f'<Loop "{shortened(self.room.name)}": {n} simulation{"s" * (n != 1)}, {converged} of '
            f"{measured} bands converged>"
        )

    @cached_property
    def wanted(self) -> Array:
        """Measured T in s of what is matched, (n_bands,), NaN where it is missing."""
        return self.matched.wanted

    def calibrated(self, target: Array) -> CalibrationResult:
        """Return the equation's calibration to a target T in s, (n_bands,).

        Where the bounds forbid it, to the nearest T within reach. The problem is built once, and shared
        with the loops that `record` returns. Volume, areas and climate count as exact: else the
        coefficients would carry the share of each target that the loop tries.
        """
        return self._problem().solve(target, unreachable="nearest", method=self.method)

    def _problem(self) -> CalibrationProblem[CalibrationResult]:
        if not self._problems:
            room = self.room.as_exact
            self._problems.append(preset(self.method, room).build(room, self.equation))
        return self._problems[0]

    @property
    def gap(self) -> Array:
        """Gap of each band's best step in JND, (n_bands,), NaN without a measured T."""
        return np.asarray(self._gaps[self.best, np.arange(self.room.n_bands)])

    @property
    def best(self) -> NDArray[np.int64]:
        """Number of the step with the smallest gap, per band, (n_bands,)."""
        return np.asarray(np.argmin(np.nan_to_num(np.abs(self._gaps), nan=np.inf), axis=0))

    @property
    def compromise(self) -> dict[str, ParameterGap]:
        """Gaps of each matched parameter in the first and each band's best step, and what it lost."""
        return self.matched.compromise(self.first, self.nearest)

    @property
    def gaps_beside(self) -> Gaps:
        """Gaps of what is not matched in JND: in the first and each band's best step."""
        return {
            p: (gap_jnd(self.first(p), wanted, p), gap_jnd(self.nearest(p), wanted, p))
            for p, wanted in self.beside.items()
        }

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters that are not matched and left what was measured by more than one JND."""
        return left(self.gaps_beside)

    def first(self, parameter: str) -> Array:
        """Return a parameter's mean in the first simulation, (n_bands,), NaN where it has none."""
        return np.asarray(self._means(parameter)[0])

    def nearest(self, parameter: str) -> Array:
        """Return a parameter's mean in each band's best simulation, (n_bands,)."""
        return np.asarray(self._means(parameter)[self.best, np.arange(self.room.n_bands)])

    def _means(self, parameter: str) -> Array:
        checks.text("parameter", parameter)
        if not self.steps:
            raise DataError("the loop has no simulation yet, and so no means")
        none = np.full(self.room.n_bands, np.nan)
        return np.stack([step.means.get(parameter, none) for step in self.steps])

    @property
    def best_alpha(self) -> Array:
        """Coefficients of each band's best step, (n_materials, n_bands)."""
        return np.stack([self.steps[b].alpha[:, k] for k, b in enumerate(self.best)], axis=1)

    @property
    def best_target(self) -> Array:
        """Target T of each band's best step in s, (n_bands,)."""
        return np.array([self.steps[b].target[k] for k, b in enumerate(self.best)])

    @cached_property
    def outcome(self) -> CalibrationResult:
        """The equation's calibration to the targets of each band's best step."""
        return self.calibrated(self.best_target)

    @cached_property
    def of_uncertain_room(self) -> CalibrationResult | None:
        """The calibration to the targets of `outcome`, with the room as uncertain as it states.

        Its coefficients leave their share to volume, areas and climate. The simulator, which
        has the stated room, does not have the measured T with them. None for an exact room.
        """
        if not self.room.is_uncertain or not self.steps:
            return None
        problem = preset(self.method, self.room).build(self.room, self.equation)
        return problem.solve(self.best_target, unreachable="nearest", method=self.method)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Likely typing errors, and bands of the `outcome` at a bound or against the prior (z over 2).

        Also bands whose measured decay is bent, and those of `low` that no modes carry.
        A simulator can be brought to almost any T: a small gap confirms nothing.
        """
        marks = [m for m in self.outcome.trust_marks if m.kind in ("at_bound", "implausible")]
        label = self.matched.label.removeprefix("the ")
        mistyped = of_row(self.room.centre_frequencies, self.wanted, label, " s")
        return (
            *mistyped,
            *in_room(self.room),
            *marks,
            *self.bent,
            *(self.low.loop_marks if self.low else ()),
        )

    @property
    def goal(self) -> Array:
        """Gap in JND at which each band is done, (n_bands,): the tolerance less the simulator's noise.

        At least half the tolerance, since no gap below a large noise can be shown. Unknown noise counts
        as large.
        """
        noise = self.steps[-1].noise / TARGET.jnd_of(self.wanted)
        return np.fmax(self.tolerance - noise, self.tolerance / 2)

    @property
    def status(self) -> tuple[str, ...]:
        """Status of each band before a confirmation: one of `STATUSES`."""
        close = np.abs(np.log(self._target_without_t20 / self.best_target)) < _CLOSE_TARGETS
        (shortest, longest), target = self._target_limits, self.steps[-1].target
        at_limit = ((self.gap < 0) & (target >= longest * (1 - _AT_LIMIT))) | (
            (self.gap > 0) & (target <= shortest * (1 + _AT_LIMIT))
        )
        blocked = close | at_limit
        if len(last := self.steps[-_STUCK_STEPS:]) == _STUCK_STEPS:
            changed = np.diff([step.alpha for step in last], axis=0) != 0
            same = np.diff([step.simulated for step in last], axis=0) == 0
            blocked |= changed.any(axis=1).all(axis=0) & same.all(axis=0)
        status = np.select(
            [np.isnan(self.wanted), np.abs(self.gap) <= self.goal, blocked],
            ["no measured T", "converged", "unreachable"],
            "not converging",
        )
        if self.low is not None:
            own = np.where(self.low.carried, "by modes", "too few modes")
            status = np.where(self.low.below, own, status)
        return tuple(status.tolist())

    @property
    def finished(self) -> bool:
        """Whether no band would gain from another simulation."""
        return bool(self.steps) and "not converging" not in self.status

    def confirmed(self, measurement: Measurement) -> tuple[str, ...]:
        """Return the status of each band after a simulation of `best_alpha` with another seed.

        A converged band is confirmed if the noise is within the tolerance, and the gap within tolerance
        plus noise. A larger noise would confirm any gap.
        """
        noise = self.matched.noise(measurement) / TARGET.jnd_of(self.wanted)
        gap = np.abs(self.matched.gap(measurement))
        kept = (noise <= self.tolerance) & (gap <= self.tolerance + noise)
        lost = (np.array(self.status) == "converged") & ~kept
        return tuple(np.where(lost, "not confirmed", self.status).tolist())

    @property
    def next_target(self) -> Array:
        """T in s to calibrate the equation to next, (n_bands,), NaN without a measured T.

        If any band needs another simulation, converged bands with a gap above half their goal are
        moved too. That costs no simulation, and each band keeps its best step. A band without any T20
        so far takes the equation's T for the prior. A target goes at most halfway towards one without
        a T20.
        """
        if not self.steps:
            return self.wanted.copy()
        target, without_t20 = self.best_target, self._target_without_t20
        for k in np.flatnonzero(self._moving):
            shortest, longest = (limit[k] for limit in self._target_limits)
            known = [step for step in self.steps if np.isfinite(step.simulated[k])]
            if not known:
                stated = self.equation.reverberation_time(self.room)[k]
                target[k] = np.clip(stated, shortest, longest)
                continue
            proposed = rules.next_target(
                self.rule,
                np.array([step.target[k] for step in known]),
                np.array([step.simulated[k] for step in known]),
                self.wanted[k],
                shortest,
                longest,
            )
            halfway = np.sqrt(target[k] * without_t20[k])
            # Without such a target, NaN makes the comparison False and the proposal stands.
            beyond = (proposed - halfway) * (without_t20[k] - target[k]) > 0
            target[k] = halfway if beyond else proposed
        return target

    @property
    def next_alpha(self) -> Array:
        """Coefficients to simulate next, (n_materials, n_bands), as the program reads them.

        Bands that are done keep the coefficients of their best step.
        """
        alpha = self._rounded(self.calibrated(self.next_target).alpha)
        return np.where(self._moving, alpha, self.best_alpha) if self.steps else alpha

    def prior_alpha(self) -> Array:
        """Return the room's coefficients, (n_materials, n_bands), as the program reads them."""
        return self._rounded(self.room.alpha)

    def _rounded(self, alpha: Array) -> Array:
        """Return a copy with ``decimals`` decimals, rounded up if it would fall below alpha_min."""
        if self.decimals is None:
            return alpha.copy()
        rounded = np.round(alpha, self.decimals)
        if self.room.alpha_min is None:
            return rounded
        up = np.round(rounded + 10.0**-self.decimals, self.decimals)
        return np.where(rounded < self.room.alpha_min, up, rounded)

    def repeats(self, alpha: Array, simulated: Measurement) -> bool:
        """Whether T is that of the last step in every band, although alpha is not.

        The program then most likely simulated the coefficients of the last step.
        """
        if not self.steps or np.array_equal(alpha, self.steps[-1].alpha):
            return False
        return self.matched.gives(simulated, self.steps[-1].simulated)

    def back(self) -> Loop:
        """Return the loop before its last step; DataError if it has none."""
        if not self.steps:
            raise DataError("the loop has no simulation yet: there is none to take back")
        return replace(self, steps=self.steps[:-1])

    def record(
        self,
        alpha: Array,
        simulated: Measurement,
        without_t20: Sequence[int] = (),
        *,
        stated: bool = False,
    ) -> Loop:
        """Return the loop after a simulation of `next_alpha`, or of the stated coefficients.

        A band may lack a T20 that it had in an earlier step. Its target then moves back towards one
        with a T20.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
            The coefficients that were simulated: `next_alpha`.
        simulated : Measurement
            In the room's bands, with T20.
        without_t20 : sequence of int, optional
            Bands whose T20 in ``simulated`` belongs to other coefficients.
        stated : bool
            Whether ``alpha`` is `prior_alpha`. Its target is the equation's own T.

        Raises
        ------
        DataError
            If the loop is finished, alpha does not fit the room, or the measurement has other bands
            or lacks a T20: for some pair in the first step, or in every measured band.
        """
        if self.finished:
            raise DataError("the loop is done: no band is left that another simulation helps")
        time = self._simulated_time(simulated)
        for band in checks.listed("without_t20", without_t20):
            if checks.whole("without_t20", band, 0) >= len(time):
                raise DataError(f"without_t20 has {band}; the bands are 0 to {len(time) - 1}")
            time[band] = np.nan
        target = self.next_target
        if checks.flag("stated", stated):
            own = np.clip(self.equation.reverberation_time(self.room), *self._target_limits)
            target = np.where(np.isfinite(self.wanted), own, np.nan)
        step = Step(
            target=target,
            alpha=check_alpha(self.room, alpha),
            simulated=time,
            noise=self.matched.noise(simulated),
            means=means(simulated),
        )
        return replace(self, steps=(*self.steps, step))

    @property
    def _gaps(self) -> Array:
        """Gap of every step in JND, (n_steps, n_bands)."""
        if not self.steps:
            raise DataError("the loop has no simulation yet, and so no gap")
        return np.array([gap_jnd(step.simulated, self.wanted) for step in self.steps])

    @property
    def _moving(self) -> NDArray[np.bool_]:
        """Whether the next step moves the band's target, (n_bands,)."""
        band_status = np.array(self.status)
        needed = band_status == "not converging"
        rough = (np.abs(self.gap) > self.goal / 2) & np.isnan(self._target_without_t20)
        return np.asarray(needed | ((band_status == "converged") & rough & needed.any()))

    def _simulated_time(self, measurement: Measurement) -> Array:
        """Return the simulated T of what is matched in s, (n_bands,), NaN where some pair has none.

        Raises DataError for other bands, or a matched parameter that is missing. A measured band may
        lack it only if it has one in an earlier step, and some measured band has one now.
        """
        frequencies = self.room.centre_frequencies
        checks.instance("what was simulated", measurement, Measurement)
        if not np.array_equal(measurement.centre_frequencies, frequencies):
            raise DataError(
                f"what was simulated has {span(measurement.centre_frequencies)}; the room has "
                f"{span(frequencies)}"
            )
        for parameter in self.matched.shares:
            if parameter not in measurement.values:
                raise DataError(f"what was simulated has no {parameter_label(parameter)}")
        measured = np.isfinite(self.matched.wanted)
        missing = {
            parameter: np.isnan(measurement.values[parameter]) & measured & (share > 0)
            for parameter, share in self.matched.shares.items()
        }
        lost = np.any([absent.any(axis=0) for absent in missing.values()], axis=0)
        earlier = np.zeros(lost.shape, dtype=bool)
        for step in self.steps:
            earlier |= np.isfinite(step.simulated)
        refused = lost if lost[measured].all() else lost & ~earlier
        for parameter, absent in missing.items():
            for pair, k in np.argwhere(absent & refused)[:1].tolist():
                raise DataError(
                    f"simulated {parameter_label(parameter)}[{' to '.join(measurement.pairs[pair])}, "
                    f"{label(frequencies[k])}] is missing, but T was measured there"
                )
        return np.where(lost, np.nan, self.matched.combined(measurement.mean))

    @property
    def _target_without_t20(self) -> Array:
        """The target without a simulated T20 that is nearest to the best one, (n_bands,).

        NaN for a band with a T20 in every step or in none.
        """
        targets = np.array([step.target for step in self.steps])
        simulated = np.isfinite(self._gaps)
        missing = ~simulated & np.isfinite(self.wanted)
        distance = np.where(missing, np.abs(np.log(targets / self.best_target)), np.inf)
        nearest = targets[np.argmin(distance, axis=0), np.arange(self.room.n_bands)]
        both = missing.any(axis=0) & simulated.any(axis=0)
        return np.asarray(np.where(both, nearest, np.nan))

    @cached_property
    def _target_limits(self) -> tuple[Array, Array]:
        """The shortest and the longest T in s that the equation can give within the bounds."""
        room, fixed = self.room, self.room.sigma == 0
        floor = 0.0 if room.alpha_min is None else room.alpha_min
        least = room.areas @ np.where(fixed, room.alpha, floor)
        most = room.areas @ np.where(fixed, room.alpha, 1.0)
        margin = _FROM_BOUNDS * (most - least)
        largest = _BELOW_LARGEST_MEAN * self.equation.largest_mean * room.total_area
        high = np.minimum(most - margin, largest)
        return self.equation.time(room, high), self.equation.time(room, least + margin)

    def to_dict(self) -> dict[str, Any]:
        """Return the loop as plain values."""
        stated = {f.name: getattr(self, f.name) for f in fields(self) if f.metadata != NOT_SAVED}
        return stated | {
            "room": self.room.to_text(),
            "matched": vars(self.matched),
            "wanted": self.wanted,
            "equation": {"name": self.equation.name, **asdict(self.equation)},
            "bent": [vars(band) for band in self.bent],
            "low": None if self.low is None else self.low.to_dict(),
            "steps": [vars(step) for step in self.steps],
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str], room: Room | None = None) -> Loop:
        """Read a loop from the file that `save` wrote.

        Raises DataError if the file holds no loop, or if the loop belongs to another room.
        """
        loop = load(path)
        if not isinstance(loop, Loop):
            raise DataError(f"{path} is no state of a loop: it holds a {type(loop).__name__}")
        own = loop.low.prior if loop.low else loop.room
        if room is not None and of_room(room) != of_room(own):
            raise DataError(f'{path} is of another room, or room "{room.name}" was changed since')
        return loop if room is None or loop.low else replace(loop, room=room)


def start(
    room: Room,
    measured: Measurement,
    *,
    rule: Rule = "safeguarded",
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
    weights: Weights | None = None,
    modes: ModesResult | None = None,
) -> Loop:
    """Return a loop before its first simulation; see `Loop` for the parameters.

    ``weights`` and ``modes`` are those of `calibrate_simulator`. Raises DataError if an argument breaks
    its rule, or the room was calibrated to these data. Warns of other bands and no air.
    """
    checks.instance("room", room, Room)
    stated, low = measured, None
    if modes is not None:
        low = checks.instance("modes", modes, ModesResult).in_loop(room, measured)
        room, measured = low.room, above_schroeder(measured, room, low.below)
    data = times_in_room(room, measured)
    refuse_repeated_data(room, data.fingerprint)
    tell_data(room, stated)
    what = matched_times(room, measured, data.reverberation_time, weights)
    measured_means = means(measured.in_bands(room.centre_frequencies))
    loop = Loop(
        room=room,
        matched=what,
        measured=data_history(room, data),
        rule=rule,
        method=method,
        equation=equation or Eyring(),
        decimals=decimals,
        tolerance=tolerance,
        bent=data.bent,
        beside={p: mean for p, mean in measured_means.items() if p not in what.shares},
        low=low,
    )
    loop._problem()  # warns of a room without air
    return loop


_STRONGEST_SHADE = 5.0  # JND


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopResult(Result):
    """A calibrated simulator.

    Attributes
    ----------
    room : Room
        The room with the coefficients for the simulator, and a record of the calibration.
    simulator : str
        Name of the simulator. The coefficients belong to no other.
    loop : Loop
        All steps, and the `status` and `gap` of each band.
    simulations : int
        Number of all calls of the simulator.
    before : Measurement
        Simulated with the stated coefficients. If some band has no T20 with them, or fewer than three
        simulations were allowed, with those of the equation's calibration.
    after : Measurement
        Simulated with the coefficients returned. What is matched was fitted, by default T20.
    confirmation : Measurement or None
        Simulated with the coefficients returned and another seed. None for a deterministic
        simulator, and if no band converged.
    measured : Measurement or None
        What was measured, in the room's bands, also what was not fitted.
    notes : tuple of str
        What is to be known of the simulations, such as paths that left through gaps of the mesh.
    """

    record_kind: ClassVar[str] = "loop result 1"

    room: Room
    simulator: str
    loop: Loop
    simulations: int
    before: Measurement
    after: Measurement
    confirmation: Measurement | None
    measured: Measurement | None = None
    notes: tuple[str, ...] = ()

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def final(self) -> Measurement:
        """The simulation that judges the result: `confirmation` if there is one, else `after`."""
        return self.confirmation or self.after

    @property
    def status(self) -> tuple[str, ...]:
        """Status of each band: one of `STATUSES`."""
        return self.loop.confirmed(self.final)

    @property
    def gap(self) -> Array:
        """Gap of what is matched, of `final`, in JND, (n_bands,), NaN without a measured T."""
        return self.loop.matched.gap(self.final)

    @property
    def compromise(self) -> dict[str, ParameterGap]:
        """Each matched parameter's share, its gaps before and after, and what it lost, in JND."""
        return self.loop.matched.compromise(self.before.mean, self.final.mean)

    def gaps(self, parameter: str) -> tuple[Array, Array]:
        """Return simulated less measured before and after in JND, each (n_bands,).

        Of the means over pairs; NaN where the parameter was not measured or not simulated.
        """
        observable(parameter)
        if self.measured is None:
            return np.full(self.loop.wanted.shape, np.nan), np.full(self.loop.wanted.shape, np.nan)
        wanted = self.measured.mean(parameter)
        return (
            gap_jnd(self.before.mean(parameter), wanted, parameter),
            gap_jnd(self.final.mean(parameter), wanted, parameter),
        )

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters that are not fitted and whose gap grew by more than one JND, in some band.

        The mean T20 is fitted; what it costs in EDT, C50 and C80 stands here; `compromise` has that
        of what is matched.
        """
        return left(self.gaps_beside)

    @property
    def of_uncertain_room(self) -> CalibrationResult | None:
        """The calibration to the same targets with volume, areas and climate uncertain.

        None for an exact room. See `Loop.of_uncertain_room`.
        """
        return self.loop.of_uncertain_room

    @property
    def gaps_beside(self) -> Gaps:
        """`gaps` of each parameter that is shown and was not matched."""
        return {p: self.gaps(p) for p in SHOWN if p not in self.loop.matched.shares}

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Reasons to doubt the coefficients of a band; see `Loop.trust_marks`."""
        return self.loop.trust_marks

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        measured = int(np.isfinite(self.loop.wanted).sum())
        converged = self.status.count("converged")
        return (
            f'LoopResult of "{text.shortened(self.simulator)}": {self.simulations} '
            f"simulation{'s' * (self.simulations != 1)}, {converged} of {measured} bands converged"
        )

    def ends(self) -> dict[str, Any]:
        """Return the parameters before and after, means by parameter and band, as plain values."""
        return {
            "simulator": self.simulator,
            "confirmed": self.confirmation is not None,
            "status": list(self.status),
            **{
                name: {} if of is None else {p: json_numbers(of.mean(p)) for p in of.values}
                for name, of in (
                    ("measured", self.measured),
                    ("before", self.before),
                    ("after", self.final),
                )
            },
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the loop and the parameters before and after as plain values."""
        return {**self.loop.to_dict(), "result": self.ends()}

    def __str__(self) -> str:
        return "\n".join(blocks.lines(self.blocks()))

    def _repr_html_(self) -> str:
        """Return the tables with shaded gaps: orange for a T that is too long, blue for too short."""
        return blocks.notebook(self._description, self.blocks()[1:])

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        shades = np.nan_to_num(self.gap) / _STRONGEST_SHADE
        outcome = {
            "T wanted / s": text.numbers(self.loop.wanted, ".3f"),
            "simulated / s": text.numbers(self.loop.matched.combined(self.final.mean), ".3f"),
            "gap / JND": text.numbers(self.gap, "+.2f"),
            "z": text.numbers(self.loop.outcome.plausibility.z, "+.1f"),
            "status": self.status,
        }
        compromise: dict[str, Sequence[str]] = {}  # of what is matched together
        for parameter, part in self.compromise.items() if len(self.compromise) > 1 else ():
            name = parameter_label(parameter)
            compromise[f"{name} gap / JND before"] = text.numbers(part.before, "+.1f")
            compromise[f"{name} gap / JND after"] = text.numbers(part.after, "+.1f")
            compromise[f"{name} lost / JND"] = text.numbers(part.lost, ".1f")
        beside: dict[str, Sequence[str]] = {}  # EDT, C50 and C80
        for parameter in (p for p in SHOWN if p != TARGET.key and p in self.before.values):
            name = f"{parameter_label(parameter)} / {observable(parameter).unit}"
            measured = self.measured and self.measured.values
            for when, of in (
                ("measured", self.measured if measured and parameter in measured else None),
                ("before", self.before),
                ("after", self.final),
            ):
                if of is not None:
                    beside[f"{name} {when}"] = text.numbers(of.mean(parameter), ".2f")
        by_band = labels(self.room.centre_frequencies)
        return [
            Note(f"Coefficients only for {self.simulator}; {self.simulations} simulations"),
            *(
                Table.of_columns(by_band, columns, {"gap / JND": shades})
                for columns in (outcome, compromise, beside)
                if columns
            ),
            *(Note(n, hanging="       " if n.startswith(" ") else "    ") for n in self._notes()),
        ]

    def _notes(self) -> list[str]:
        notes = explained(self.trust_marks)
        if "not confirmed" in self.status:
            notes.insert(
                0,
                "Not confirmed: with another seed the gap exceeds tolerance plus noise, or the noise "
                "exceeds the tolerance. Simulate with less noise (more paths).",
            )
        notes[:0] = sentences(self.gaps_beside, self.room.centre_frequencies)
        if self.loop.room.is_uncertain:
            notes.append(
                f"The room is uncertain ({in_words(self.loop.room)}). These coefficients serve the "
                "simulator in the room as stated, and carry the room's error, too. Those of the "
                "materials are in result.of_uncertain_room."
            )
        if self.loop.low is not None:
            notes.append(self.loop.low.loop_note)
        return [*notes, *self.notes]


def calibrate_simulator(
    simulator: Simulator,
    room: Room | ModesResult,
    measured: Measurement,
    rule: Rule = "safeguarded",
    *,
    exclude: Sequence[tuple[str, str]] = (),
    weights: Weights | None = None,
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
    max_simulations: int = 12,
    seed: int = 0,
    after_step: Callable[[Loop], None] | None = None,
) -> LoopResult:
    """Calibrate a room's coefficients so that a simulator has the measured mean T20.

    The stated coefficients are simulated first, so that no band ends farther away than it began.
    `calibrate_positions` matches the values at every position.

    Parameters
    ----------
    simulator : Simulator
    room : Room or ModesResult
        Its alpha and sigma are the prior. A result of ``calibrate_modes(room, ...)`` without T stands
        in place of T below the Schroeder frequency: coefficients stay there as it left them. In large
        rooms with hard walls, sigma should be
        proportional to alpha: equal sigmas drive large hard walls to alpha = 0.
    measured : Measurement
    rule : {"secant", "safeguarded"}
        See `rtcal.loop.rules`.
    exclude : sequence of (source, receiver)
        Measured pairs that are left out, of what is simulated, too.
    weights : mapping of "t20" and "edt" to a number or one per band, optional
        A compromise of the mean T20 and the mean EDT: each band's target is moved until their weighted
        geometric mean is the measured one. ``result.compromise`` states what each lost. By default
        T20 alone is matched.
    method, equation
        Of the equation's calibration; see `rtcal.calibrate`.
    decimals : int, optional
        Decimals of alpha that the program reads.
    tolerance : float
        In JND. A band is done if its gap is within the tolerance less the simulator's noise. It is
        confirmed if its gap with another seed is within the tolerance plus the noise.
    max_simulations : int
        Limit of all calls of the simulator, at least 2 for a simulator with random numbers. One
        call is kept for the coefficients returned: for the confirmation with another seed, or for
        bands whose best steps differ.
    seed : int
        Seed of all steps, so that they differ by alpha only. The confirmation uses ``seed + 1``.
    after_step : callable, optional
        Called with the loop after every step, for example to `Loop.save` it.

    Returns
    -------
    LoopResult
        Its ``status`` says for each band whether it converged and was confirmed.

    Raises
    ------
    SimulatorError, TooShortError
        From the simulator. The error's ``loop`` is the `Loop` with all steps so far. A band that
        has a T20 for some coefficients only does not raise, but ends as unreachable.
    DataError
        If simulator and room differ in materials or bands, or an argument breaks its rule.

    References
    ----------
    Bellows & Katz 2025, Sects. 4.2 and 4.3, Eqs. 38 to 40.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> program = rt.simulators.External(
    ...     room=room, name="reverb 3000",
    ...     run=lambda alpha, seed: 1.2 * rt.Eyring().time(room, room.areas @ alpha))
    >>> rt.calibrate_simulator(program, room, measured)
    <LoopResult of "reverb 3000": 2 simulations, 6 of 6 bands converged>
    """
    modes = room if isinstance(room, ModesResult) else None
    room = room.prior if isinstance(room, ModesResult) else room
    check_fits(simulator, room)
    exclude = checks.pairs("exclude", exclude)
    checks.whole("seed", seed, 0)
    measured, repeated = at_places(simulator, measured)
    if exclude:
        refuse_unknown(exclude, measured)
        measured = _without(measured, exclude)
        repeated = (*repeated, left_out(exclude))
    # The result's notes and marks say it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OtherBandsWarning)
        loop = start(
            room,
            measured,
            modes=modes,
            rule=rule,
            method=method,
            equation=equation,
            decimals=decimals,
            tolerance=tolerance,
            weights=weights,
        )
    result = _run(simulator, loop, max_simulations, seed, after_step, exclude)
    of_bands = notes(measured.centre_frequencies, room.centre_frequencies)
    notes_of_data = [*map(as_sentence, of_bands)]
    parameters = times_in_room(room, measured).parameter
    named = zip(room.centre_frequencies, parameters, strict=True)
    if in_place := [label(f) for f, p in named if p not in ("", TARGET.key)]:
        where = f" at {', '.join(in_place)}" if TARGET.key in parameters else ""
        notes_of_data.append(f"T30 is matched{where} in place of T20, which was not measured.")
    return replace(
        result,
        measured=measured.in_bands(room.centre_frequencies),
        notes=(*repeated, *notes_of_data, *result.notes),
    )


def _run(
    simulator: Simulator,
    loop: Loop,
    max_simulations: int,
    seed: int,
    after_step: Callable[[Loop], None] | None,
    exclude: Sequence[Pair],
) -> LoopResult:
    """Simulate and step until the loop is finished or no call is left; see `calibrate_simulator`."""
    if after_step is not None and not callable(after_step):
        raise DataError(f"after_step = {after_step!r} cannot be called")
    checks.whole("max_simulations", max_simulations, 1 if simulator.deterministic else 2)
    calls = _Calls(simulator, max(max_simulations - 1, 1), exclude)
    try:
        if calls.left > 1:
            loop = _with_stated(calls, loop, seed)
            if loop.steps and after_step is not None:
                after_step(loop)
        while not loop.finished and calls.left:
            step = _simulate_step(calls, loop, seed)
            if step is None:
                break
            loop = loop.record(*step)
            if after_step is not None:
                after_step(loop)
        calls.limit = max_simulations
        return _result(calls, loop, seed)
    except RtcalError as error:
        error.loop = loop
        raise


def _without(measurement: Measurement, exclude: Sequence[Pair]) -> Measurement:
    """Return a measurement without some pairs, so that means are over the same ones."""
    kept = [pair for pair in measurement.pairs if pair not in exclude]
    if not kept:
        raise DataError("exclude has every pair: none is left")
    return measurement if len(kept) == len(measurement.pairs) else measurement.select(kept)


@dataclass
class _Calls:
    """The calls of a simulator, with their coefficients and measurements, and their limit."""

    simulator: Simulator
    limit: int
    exclude: Sequence[Pair]
    number: int = 0
    answers: list[tuple[Array, int, Measurement]] = field(default_factory=list)

    @property
    def left(self) -> int:
        return self.limit - self.number

    def simulate(self, alpha: Array, seed: int) -> Measurement:
        self.number += 1
        measurement = _without(run(self.simulator, alpha, seed=seed), self.exclude)
        self.answers.append((alpha, seed, measurement))
        return measurement


def _with_stated(calls: _Calls, loop: Loop, seed: int) -> Loop:
    """Return the loop after a simulation of the stated coefficients, so that none ends farther away.

    Coefficients that some band has no T20 for are no start: the equation's are simulated first.
    """
    alpha = loop.prior_alpha()
    try:
        return loop.record(alpha, calls.simulate(alpha, seed), stated=True)
    except RtcalError as error:
        if not error.bands and not isinstance(error, DataError):
            raise
        return loop


def _simulate_step(
    calls: _Calls, loop: Loop, seed: int
) -> tuple[Array, Measurement, tuple[int, ...]] | None:
    """Simulate the next coefficients: return them, the measurement, and the bands without a T20.

    If some bands have no T20, they are simulated again with coefficients that gave one, before the
    first step with the prior; None if no call is left for that. An error in every band is raised,
    and so is NaN in the first step.
    """
    alpha = loop.next_alpha
    try:
        return alpha, calls.simulate(alpha, seed), ()
    except RtcalError as error:
        nan_at_first = isinstance(error, SimulatorError) and not loop.steps
        if not error.bands or nan_at_first or 1 < len(alpha[0]) == len(error.bands):
            raise
        if not calls.left and not loop.steps:
            raise
        without_t20 = error.bands
    if not calls.left:
        return None
    with_t20 = alpha.copy()
    for k in without_t20:
        steps = [step for step in loop.steps if np.isfinite(step.simulated[k])]
        with_t20[:, k] = steps[-1].alpha[:, k] if steps else loop.prior_alpha()[:, k]
    return alpha, calls.simulate(with_t20, seed), without_t20


def _result(calls: _Calls, loop: Loop, seed: int) -> LoopResult:
    """Return the result: the coefficients of each band's best step, simulated together.

    If bands differ in their best step, their coefficients were never simulated together. Where bands
    depend on each other and are farther together than a step was, those of that step are returned.
    """
    simulator, alpha = calls.simulator, loop.best_alpha
    confirmation = None
    if not simulator.deterministic and "converged" in loop.status:
        confirmation = calls.simulate(alpha, seed + 1)
    simulated = [m for a, s, m in calls.answers if s == seed and np.array_equal(a, alpha)]
    after = simulated[-1] if simulated else confirmation or calls.simulate(alpha, seed)
    if simulator.deterministic:
        nearest = rms(loop.matched.gap(after)) - _AS_NEAR
        for tried, _, measurement in calls.answers:
            if (gap := rms(loop.matched.gap(measurement))) < nearest:
                nearest, alpha, after = gap, tried, measurement
    calibrated = loop.outcome.room
    record = calibrated.calibration and replace(
        calibrated.calibration,
        measured=loop.measured,
        equation=f"{calibrated.calibration.equation}, in the loop with {simulator.name}",
    )
    return LoopResult(
        room=calibrated.replace(alpha=alpha, calibration=record),
        simulator=simulator.name,
        loop=loop,
        simulations=calls.number,
        before=calls.answers[0][2],  # the stated coefficients, where they have a T20
        after=after,
        confirmation=confirmation,
        notes=lost_paths(simulator),
    )


_AS_NEAR = 1e-6
"""JND by which gaps differ that are the same."""
_COEFFICIENTS = re.compile(r"^#\s*Coefficients ([0-9a-f]{12})\b", re.M)


def refuse_progress(state: str) -> None:
    """Raise DataError if the state at this path already holds simulations."""
    if Path(state).exists() and (n := len(Loop.load(state).steps)):
        raise DataError(
            f"{state} holds {n} simulation{'s' * (n > 1)} of a loop: delete it to begin anew, or name "
            "another state"
        )


def record(loop: Loop, table: str, state: str, out: str, *, again: bool = False) -> Loop:
    """Return the loop after the simulation that the file ``table`` holds.

    Parameters
    ----------
    loop : Loop
        As read from the file ``state``.
    table, state, out : str
        Paths of the simulated table, the state and the room that was to be simulated.
    again : bool
        Whether to accept a table with the same T20 as the last step's, or at first as the measured T.

    Raises
    ------
    DataError
        If the loop is finished, the table is no measurement, or it repeats the last step's or has the
        measured T itself. Also if the table belongs to other coefficients, as far as the files show.
    """
    if loop.finished:
        raise DataError(
            f"{state}: the loop is done, so {table} was not taken in; the room that `rtcal loop "
            "next` wrote last has the coefficients, and `rtcal report` shows the path"
        )
    simulated = Measurement.from_file(table)
    alpha = loop.next_alpha
    # Two files may show that a table belongs to other coefficients: it may repeat the room's line
    # "# Coefficients ...", and the room at ``out`` holds the coefficients themselves.
    asked = _digest(alpha)
    stated = _COEFFICIENTS.search(read_text(table, MAX_BYTES))
    if stated is not None and stated[1] != asked:
        raise DataError(f"{table}: it is of the coefficients {stated[1]}; {state} asks for {asked}")
    written = None
    with suppress(DataError):  # another name than last time, or no room: it shows nothing
        written = Room.from_file(out)
    if written is not None and _digest(written.alpha) != asked:
        raise DataError(
            f"{out}: it has other coefficients than {state} asks for, so {table} may be of those: "
            f"rtcal loop back writes what to simulate; or delete {out} if it was not simulated"
        )
    if not again and not loop.steps and loop.matched.gives(simulated, loop.wanted):
        raise DataError(
            f"{table}: every T20 is the measured one to the last digit: is it the measurement itself, "
            "and not what was simulated? (--again takes it all the same)"
        )
    if not again and loop.repeats(alpha, simulated):
        raise DataError(
            f"{table}: the table is the last step's, though alpha changed: was the room that was "
            "written last simulated? (--again takes it all the same)"
        )
    try:
        return loop.record(alpha, simulated)
    except DataError as error:
        raise DataError(f"{table}: {error}") from error


def write(loop: Loop, state: str, out: str) -> None:
    """Write the state and the room to simulate: both files or none.

    A state without its room would accept a table that belongs to the room of the step before.
    """
    room = loop.room.replace(alpha=loop.next_alpha, calibration=None)
    digest = _digest(room.alpha)
    n, of = len(loop.steps), f"of the loop in {Path(state).name!r}"
    note = f"# To simulate: run {n + 1} {of}.\n"
    if n and loop.finished:
        note = f"# Calibrated for the program simulated: the end {of}, after {n} runs.\n"
    note += f"# Coefficients {digest}.\n"
    content = note + room.to_text(Path(out).parent)
    write_all({out: content.encode(), state: loop.to_json(Path(state).parent).encode()})


def conclusion(loop: Loop, out: str) -> str:
    """Return what a user does with the last room written, for a finished loop."""
    left = len([s for s in loop.status if s not in LEFT_ALONE])
    missed = f", but {left} of {loop.room.n_bands} bands were not reached" if left else ""
    return (
        f"Done{missed}. {out} has the coefficients, those of each band's best step: give it to the "
        "program a last time."
    )


def _digest(alpha: Array) -> str:
    """Return a short identifier of coefficients, (n_materials, n_bands), to nine decimals."""
    rounded = np.round(alpha, 9) + 0.0  # no -0
    return hashlib.sha256(repr(rounded.shape).encode() + rounded.tobytes()).hexdigest()[:12]
