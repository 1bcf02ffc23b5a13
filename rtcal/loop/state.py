"""The closed loop between two simulations: past steps and the next coefficients.

Coefficients that give the measured T by an equation give another T in a simulator. But the simulator's
T changes with the equation's target T (Bellows & Katz 2025, Sects. 4.2 and 4.3). The loop therefore
changes the target of each band by a rule of `rtcal.loop.rules`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.band_conversion import measurement_in_room_bands
from rtcal.acoustics.bands import label, span
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import TrustMark, gap_jnd, in_room, of_row
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET, parameter_label
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.calibration.measured import data_history, tell_data, times_in_room
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.result import CalibrationResult
from rtcal.files.saved import NOT_SAVED, Result, load
from rtcal.loop import rules
from rtcal.loop.matched import (
    BelowSchroeder,
    Gaps,
    Matched,
    ParameterGap,
    Weights,
    left,
    matched_times,
    means,
    of_room,
)
from rtcal.loop.rules import RULES, Rule
from rtcal.modes.result import ModesResult
from rtcal.simulators.base import check_alpha
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array, read_only

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
        for name in ("target", "alpha", "simulated", "noise"):
            values = read_only(checks.array(f"step: {name}", getattr(self, name)))
            object.__setattr__(self, name, values)
        n = self.target.shape
        shapes = {"simulated": self.simulated.shape, "noise": self.noise.shape}
        found = {
            checks.text("step: a parameter of means", parameter): checks.array(
                f"step: means[{checks.shown(parameter)}]", values
            )
            for parameter, values in checks.mapped("step: means", self.means).items()
        }
        shapes |= {f"means[{checks.shown(p)}]": values.shape for p, values in found.items()}
        if len(n) != 1 or self.alpha.ndim != 2 or self.alpha.shape[1:] != n:
            raise DataError(
                f"step: target has shape {n} and alpha {self.alpha.shape}; they are (n_bands,) and "
                "(n_materials, n_bands)"
            )
        for name, shape in shapes.items():
            if shape != n:
                raise DataError(f"step: {name} has shape {shape}; that of target is {n}")
        object.__setattr__(self, "means", found)


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
    low : BelowSchroeder, optional
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
    low: BelowSchroeder | None = None
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
            *(self.low.trust_marks if self.low else ()),
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
        ).tolist()
        return self.low.statuses(status) if self.low else tuple(status)

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
        own = loop.low.modes.prior if loop.low else loop.room
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
    stated, low = measured, None if modes is None else BelowSchroeder.of(modes, room, measured)
    room, measured = (low.room, low.above(measured)) if low else (room, measured)
    data = times_in_room(room, measured)
    refuse_repeated_data(room, data.fingerprint)
    tell_data(room, stated)
    what = matched_times(room, measured, data.reverberation_time, weights)
    measured_means = means(measurement_in_room_bands(measured, room.centre_frequencies))
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
