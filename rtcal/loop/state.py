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
from rtcal.acoustics.decay import BentDecay
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.repeats import refuse_repeated_data
from rtcal.acoustics.room import Room
from rtcal.acoustics.trust import TrustMark, bent_marks, typing_marks
from rtcal.acoustics.typing_errors import of_row
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.problem_data import data_history, tell_data, times_in_room
from rtcal.calibration.result import CalibrationResult
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
from rtcal.loop.rules import RULES, Rule, Step
from rtcal.modes.result import ModesResult
from rtcal.simulators.base import check_alpha
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.saved import NOT_SAVED, Result, load
from rtcal.support.text import shortened
from rtcal.support.types import Array


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
    rule : {"secant", "safeguarded", "regression"}
        See `rtcal.loop.rules`.
    method : str
        Method of the equation's calibration; see `rtcal.calibrate`.
    equation : LinearEquation
    decimals : int, optional
        Decimals of alpha that the program reads. The loop simulates the rounded coefficients.
    tolerance : float
        In JND.
    steps : tuple of Step
    bent : tuple of BentDecay
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
    bent: tuple[BentDecay, ...] = ()
    beside: Mapping[str, Array] = field(default_factory=dict)
    low: BelowSchroeder | None = None
    _problems: list[CalibrationProblem] = field(default_factory=list, metadata=NOT_SAVED)

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

    def _problem(self) -> CalibrationProblem:
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
        return np.asarray(self._heard(parameter)[0])

    def nearest(self, parameter: str) -> Array:
        """Return a parameter's mean in each band's best simulation, (n_bands,)."""
        return np.asarray(self._heard(parameter)[self.best, np.arange(self.room.n_bands)])

    def _heard(self, parameter: str) -> Array:
        checks.text("parameter", parameter)
        if not self.steps:
            raise DataError("the loop has no simulation yet, and so no means")
        none = np.full(self.room.n_bands, np.nan)
        return np.stack([step.heard.get(parameter, none) for step in self.steps])

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
            *typing_marks(self.room, mistyped),
            *marks,
            *bent_marks(self.bent),
            *(self.low.trust_marks if self.low else ()),
        )

    @property
    def goal(self) -> Array:
        """Gap in JND at which each band is done, (n_bands,); see `rtcal.loop.rules.band_goals`."""
        return rules.band_goals(self.tolerance, self.steps[-1].noise / self._jnd)

    @property
    def status(self) -> tuple[str, ...]:
        """Status of each band: one of `rtcal.loop.rules.STATUSES`."""
        close = np.abs(np.log(self._target_without_t20 / self.best_target)) < rules.CLOSE_TARGETS
        alpha = np.array([step.alpha for step in self.steps])
        simulated = np.array([step.simulated for step in self.steps])
        stuck = rules.stuck_bands(alpha, simulated)
        every = rules.band_statuses(
            self.gap,
            self.goal,
            self.steps[-1].target,
            self._target_limits,
            close | stuck,
            np.isfinite(self.wanted),
        )
        return self.low.statuses(every) if self.low else every

    @property
    def finished(self) -> bool:
        """Whether no band would gain from another simulation."""
        return bool(self.steps) and "not converging" not in self.status

    def confirmed(self, measurement: Measurement) -> tuple[str, ...]:
        """Return the status of each band after a simulation of `best_alpha` with another seed.

        See `rtcal.loop.rules.confirmed_statuses`.
        """
        noise = self.matched.noise(measurement) / self._jnd
        return rules.confirmed_statuses(
            self.status, self.matched.gap(measurement), noise, self.tolerance
        )

    @property
    def next_target(self) -> Array:
        """T in s to calibrate the equation to next, (n_bands,), NaN without a measured T.

        If any band needs another simulation, converged bands with a gap above half their goal are
        moved too. That costs no simulation, and each band keeps its best step.
        """
        if not self.steps:
            return self.wanted.copy()
        return rules.next_targets(
            self.rule,
            self.steps,
            self.wanted,
            self.best_target,
            self._moving,
            self._target_limits,
            self.equation.reverberation_time(self.room),
        )

    @property
    def stated_target(self) -> Array:
        """T in s that the equation gives for the stated coefficients, (n_bands,), as `next_target`."""
        target = np.clip(self.equation.reverberation_time(self.room), *self._target_limits)
        return np.where(np.isfinite(self.wanted), target, np.nan)

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
        time = rules.simulated_time(
            simulated, self.room.centre_frequencies, self.matched, self.steps
        )
        for band in checks.listed("without_t20", without_t20):
            if checks.whole("without_t20", band, 0) >= len(time):
                raise DataError(f"without_t20 has {band}; the bands are 0 to {len(time) - 1}")
            time[band] = np.nan
        step = Step(
            target=self.stated_target if checks.flag("stated", stated) else self.next_target,
            alpha=check_alpha(self.room, alpha),
            simulated=time,
            noise=self.matched.noise(simulated),
            heard=means(simulated),
        )
        return replace(self, steps=(*self.steps, step))

    @property
    def _jnd(self) -> Array:
        """One JND of the measured T in s, (n_bands,)."""
        return np.asarray(TARGET.jnd_of(self.wanted))

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

    @property
    def _target_without_t20(self) -> Array:
        return rules.target_without_t20(self.steps, self.wanted, self.best_target)

    @property
    def _target_limits(self) -> tuple[Array, Array]:
        return rules.target_limits(self.room, self.equation)

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
    its rule, or the room was calibrated to these data. Warns of other bands, copies and no air.
    """
    if not isinstance(rule, str) or rule not in RULES:
        raise DataError(f'rule = "{rule}" is not one of {", ".join(RULES)}')
    checks.instance("room", room, Room)
    preset(method)
    rules.check_decimals(decimals)
    checks.positive("tolerance", tolerance, "JND")
    stated, low = measured, None if modes is None else BelowSchroeder.of(modes, room, measured)
    room, measured = (low.room, low.above(measured)) if low else (room, measured)
    data = times_in_room(room, measured)
    refuse_repeated_data(room, data.fingerprint)
    tell_data(room, stated)
    what = matched_times(room, measured, data.reverberation_time, weights)
    heard = means(measurement_in_room_bands(measured, room.centre_frequencies))
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
        beside={p: mean for p, mean in heard.items() if p not in what.shares},
        low=low,
    )
    loop._problem()  # warns of a room without air
    return loop
