"""The closed loop between two simulations: what was simulated, and what to simulate next.

The equation's absorption coefficients give the simulator another T than the equation's, but T moves
with the target (Bellows & Katz 2025, Sects. 4.2 and 4.3). So the target rate is moved, band by band,
by one of the rules of `rtcal.loop.rules`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.quality import JND, TrustMark, gap_jnd
from rtcal.acoustics.room import Room
from rtcal.calibration.measured import data_history, refuse_repeated_data, times_in_room
from rtcal.calibration.presets import preset
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.result import CalibrationResult
from rtcal.errors import DataError, ModelError
from rtcal.loop import files
from rtcal.loop.rules import RULES, Rule
from rtcal.support import checks
from rtcal.support.files import json_numbers, write_text
from rtcal.support.types import Array

STATUSES = ("converged", "no measured T", "unreachable", "not converging", "not confirmed")
"""What is said of a band at the end; the last one of a `LoopResult` alone."""


_NEAR = np.log(1.1)  # of a target with a T20 and one without: nearer is not worth a simulation


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One simulation: target, simulated T20 and its noise in s, (n_bands,), alpha as simulated.

    T20 is NaN where the simulator had none at this alpha. The noise is the standard error of the
    mean over pairs: 0 where the simulator states none, NaN where it cannot tell.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """A closed loop between two simulations: what is known, and what to simulate next.

    Immutable: `record` returns the loop after a simulation. `start` makes one; `save` and `load`
    keep it between runs of a program.

    Attributes
    ----------
    room : Room
    wanted : array (n_bands,)
        Measured T in s, NaN where there is none.
    measured : str
        Fingerprints of the data, for the calibrated room's record.
    rule : "secant", "safeguarded" or "regression"
    method : str
        Of the equation's calibration; see `rtcal.calibrate`.
    equation : LinearEquation or None
    decimals : int, optional
        Decimals of alpha that the program reads; simulated is what it will read.
    tolerance : float
        JND.
    steps : tuple of Step
    """

    room: Room
    wanted: Array
    measured: str
    rule: Rule
    method: str = "mle"
    equation: LinearEquation | None = None
    decimals: int | None = None
    tolerance: float = 1.0
    steps: tuple[Step, ...] = ()
    _built: list[CalibrationProblem] = field(default_factory=list, repr=False)

    def calibrated(self, target: Array) -> CalibrationResult:
        """Return the equation's calibration to a target T in s, (n_bands,); the nearest it can.

        Built at the first call; the loops that `record` returns solve the same one again.
        """
        if not self._built:
            self._built.append(preset(self.method, self.room).build(self.room, self.equation))
        return self._built[0].solve(target, unreachable="nearest", method=self.method)

    def rounded(self, alpha: Array) -> Array:
        """Return alpha as the program reads it."""
        return alpha if self.decimals is None else np.round(alpha, self.decimals)

    @property
    def gap(self) -> Array:
        """Gap of the best step of each band in JND, (n_bands,), NaN without a measured T."""
        return np.asarray(self._gaps[self.best, np.arange(self.room.n_bands)])

    @property
    def best(self) -> NDArray[np.int64]:
        """Which step came nearest, by band, (n_bands,)."""
        return np.asarray(np.argmin(np.nan_to_num(np.abs(self._gaps), nan=np.inf), axis=0))

    @property
    def best_target(self) -> Array:
        """The target T in s of each band's nearest step, (n_bands,)."""
        return np.array([self.steps[b].target[k] for k, b in enumerate(self.best)])

    @cached_property
    def outcome(self) -> CalibrationResult:
        """The equation's calibration that each band's nearest step simulated."""
        return self.calibrated(self.best_target)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Bands whose coefficients are at a bound, or contradict the prior (z over 2).

        Of the `outcome`: the simulator has the wanted T with any coefficients that give it.
        """
        kinds = ("at_bound", "implausible")
        return tuple(mark for mark in self.outcome.trust_marks if mark.kind in kinds)

    @property
    def _gaps(self) -> Array:
        """Gap of every step in JND, (n_steps, n_bands)."""
        if not self.steps:
            raise DataError("the loop has no simulation yet: there is no gap to tell")
        return np.array([gap_jnd(step.simulated, self.wanted) for step in self.steps])

    @property
    def goal(self) -> Array:
        """The gap in JND to stop at, (n_bands,): the tolerance less the simulator's noise.

        At least half the tolerance, since no simulator with more noise could be shown to be there.
        """
        noise = self.steps[-1].noise / (JND["t20"] * self.wanted)
        return np.fmax(self.tolerance - noise, self.tolerance / 2)

    @property
    def status(self) -> tuple[str, ...]:
        """One of `STATUSES` for each band, as things stand."""
        ends, near = self._ends(), np.abs(np.log(self._without / self.best_target)) < _NEAR
        found = []
        for k, (gap, goal) in enumerate(zip(self.gap, self.goal, strict=True)):
            if np.isnan(self.wanted[k]):
                found.append("no measured T")
            elif abs(gap) <= goal:
                found.append("converged")
            elif near[k]:
                found.append("unreachable")
            else:
                target = self.steps[-1].target[k]
                short = gap < 0 and target >= ends[1][k] * (1 - 1e-9)
                long = gap > 0 and target <= ends[0][k] * (1 + 1e-9)
                found.append("unreachable" if short or long else "not converging")
        return tuple(found)

    @property
    def finished(self) -> bool:
        """Whether no band is left that another simulation could bring nearer."""
        return bool(self.steps) and "not converging" not in self.status

    def confirmed(self, found: Measurement) -> tuple[str, ...]:
        """Return `status`, but "not confirmed" where a run with the best coefficients denies it.

        To confirm a band, T20 has to be within the tolerance and the run's noise, and the noise
        within the tolerance, since more of it would confirm anything.
        """
        unit = JND["t20"] * self.wanted
        gap, noise = np.abs(gap_jnd(found.mean("t20"), self.wanted)), _noise(found) / unit
        good = (noise <= self.tolerance) & (gap <= self.tolerance + noise)
        return tuple(
            "not confirmed" if status == "converged" and not kept else status
            for status, kept in zip(self.status, good, strict=True)
        )

    @property
    def next_target(self) -> Array:
        """The T in s to calibrate the equation to next, (n_bands,); NaN where there is none.

        While some band needs another simulation, bands that are done but not within half of the
        goal are moved with it: that costs no simulation, and each band ends at its best step.
        """
        if not self.steps:
            return self.wanted.copy()
        shortest, longest = self._ends()
        target, without = self.best_target, self._without
        for k in np.flatnonzero(self._moving):
            low, high = 1 / longest[k], 1 / shortest[k]
            known = [step for step in self.steps if np.isfinite(step.simulated[k])]
            if not known:
                prior = (self.equation or Eyring()).reverberation_time(self.room)[k]
                target[k] = np.clip(prior, shortest[k], longest[k])
                continue
            targets = np.array([1 / step.target[k] for step in known])
            rates = np.array([1 / step.simulated[k] for step in known])
            rate = RULES[self.rule](targets, rates, 1 / self.wanted[k], low, high)
            if self.rule == "secant" and rate <= 0:
                rate = targets[-1]  # the paper's rule has no next target
            aim, half = 1 / np.clip(rate, low, high), np.sqrt(target[k] * without[k])
            beyond = (aim - half) * (without[k] - target[k]) > 0  # not without a T20 so far
            target[k] = half if beyond else aim
        return target

    @property
    def next_alpha(self) -> Array:
        """The coefficients to simulate next, (n_materials, n_bands), as the program reads them."""
        alpha = self.rounded(self.calibrated(self.next_target).alpha)
        if self.steps:  # a band that is done keeps what did it
            for k in np.flatnonzero(~self._moving):
                alpha[:, k] = self.steps[self.best[k]].alpha[:, k]
        return alpha

    @property
    def _moving(self) -> NDArray[np.bool_]:
        """The bands whose target the next step moves, (n_bands,)."""
        status = np.array(self.status)
        rough = (np.abs(self.gap) > self.goal / 2) & np.isnan(self._without)
        needed = status == "not converging"
        return np.asarray(needed | ((status == "converged") & rough & needed.any()))

    @property
    def _without(self) -> Array:
        """The target nearest to the best one at which there was no T20, (n_bands,), else NaN."""
        gaps, targets = self._gaps, np.array([step.target for step in self.steps])
        none = np.isnan(gaps) & np.isfinite(self.wanted)
        far = np.where(none, np.abs(np.log(targets / self.best_target)), np.inf)
        nearest = targets[np.argmin(far, axis=0), np.arange(self.room.n_bands)]
        known = np.isfinite(gaps).any(axis=0)
        return np.asarray(np.where(none.any(axis=0) & known, nearest, np.nan))

    def repeats(self, alpha: Array, found: Measurement) -> bool:
        """Whether T20 is the last step's in every band although ``alpha`` is another one.

        Then the outcome is most likely the last step's, handed in twice.
        """
        if not self.steps or np.array_equal(alpha, self.steps[-1].alpha):
            return False
        last = self.steps[-1].simulated
        return np.array_equal(found.mean("t20"), last, equal_nan=True)

    def back(self) -> Loop:
        """Return the loop as it was before its last step."""
        if not self.steps:
            raise DataError("the loop has no simulation yet: there is none to take back")
        return replace(self, steps=self.steps[:-1])

    def record(self, alpha: Array, found: Measurement, without: Sequence[int] = ()) -> Loop:
        """Return the loop after ``alpha``, its `next_alpha`, was simulated with this outcome.

        A band that had a T20 before and has none now (in some pair, or it is among ``without``) is
        brought back towards where it had one.

        Raises DataError if the loop is done, or if the outcome has other bands or lacks a T20 where
        T was measured, at the first step or in every band: a mean over the other pairs would hide it.
        """
        if self.finished:
            raise DataError("the loop is done: no band is left that another simulation helps")
        bands = self.room.centre_frequencies
        checks.instance("what was simulated", found, Measurement)
        if not np.array_equal(found.centre_frequencies, bands):
            raise DataError("what was simulated has other bands than the room")
        if "t20" not in found.values:
            raise DataError("what was simulated has no T20")
        wanted = np.isfinite(self.wanted)
        missing = np.isnan(found.values["t20"]) & wanted
        lost = np.asarray(missing.any(axis=0))
        before = np.zeros(lost.shape, dtype=bool)
        for step in self.steps:
            before |= np.isfinite(step.simulated)
        refused = lost if lost[wanted].all() else lost & ~before
        if refused.any():
            pair, k = (int(i) for i in np.argwhere(missing & refused)[0])
            raise DataError(
                f"simulated T20[{' to '.join(found.pairs[pair])}, {label(bands[k])}] is missing, "
                "but T was measured there"
            )
        simulated = np.where(lost, np.nan, found.mean("t20"))
        simulated[np.array(without, dtype=int)] = np.nan
        step = Step(target=self.next_target, alpha=alpha, simulated=simulated, noise=_noise(found))
        return replace(self, steps=(*self.steps, step))

    def _ends(self) -> tuple[Array, Array]:
        """Shortest and longest T in s that the equation can give within the bounds."""
        equation = self.equation or Eyring()
        room = self.room
        floor = np.zeros(room.alpha.shape) if room.alpha_min is None else room.alpha_min
        fixed = room.sigma == 0
        least = np.where(fixed, room.alpha, floor)
        most = np.where(fixed, room.alpha, 1.0)
        # Not the ends themselves: there T is 0 or, without air, infinite.
        share = 1e-3
        low = room.areas @ least + share * (room.areas @ (most - least))
        high = room.areas @ most - share * (room.areas @ (most - least))
        high = np.minimum(high, 0.999 * equation.largest_mean * room.total_area)
        return equation.time(room, high), equation.time(room, low)

    def to_dict(self) -> dict[str, Any]:
        """Return the loop as plain values for JSON: what `from_dict` reads."""
        equation = self.equation or Eyring()
        return {
            "room": self.room.to_text(),
            "measured": self.measured,
            "wanted": json_numbers(self.wanted),
            "rule": self.rule,
            "method": self.method,
            "equation": {"name": equation.name, **asdict(equation)},
            "decimals": self.decimals,
            "tolerance": self.tolerance,
            "steps": [
                {name: json_numbers(values) for name, values in vars(step).items()}
                for step in self.steps
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], equation: LinearEquation | None = None) -> Loop:
        """Return the loop of plain values, as `to_dict` gives them.

        ``equation`` takes the place of the dict's, which has to be Sabine's, Eyring's or Kuttruff's.
        Raises DataError or ModelError for an entry that breaks a rule.
        """
        attributes, steps = files.attributes(data, equation)
        return cls(**attributes, steps=tuple(Step(**step) for step in steps))

    def to_json(self) -> str:
        """Return the loop, its room included, as JSON text, which `load` reads."""
        return files.text(self.to_dict())

    def save(self, path: str) -> None:
        """Write the loop, its room included, to a JSON file, whole or not at all."""
        write_text(path, self.to_json())

    @classmethod
    def load(
        cls, path: str, room: Room | None = None, equation: LinearEquation | None = None
    ) -> Loop:
        """Read a loop from its file; ``equation`` as in `from_dict`.

        Raises DataError if the file is no loop, or if a room is given and the loop is another's.
        """
        data = files.read(path)
        try:
            loop = cls.from_dict(data, equation)
        except (DataError, ModelError) as error:
            raise DataError(f"{path} is no state of a loop: {error}") from error
        if room is None:
            return loop
        if files.fingerprint(room) != files.fingerprint(loop.room):
            raise DataError(
                f'{path} is the state of another room, or room "{room.name}" was changed since'
            )
        return replace(loop, room=room)


def start(
    room: Room,
    measured: Measurement,
    *,
    rule: Rule = "safeguarded",
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
) -> Loop:
    """Return a loop that nothing has been simulated in yet; see `Loop`."""
    if not isinstance(rule, str) or rule not in RULES:
        raise DataError(f'rule = "{rule}" is not one of {", ".join(RULES)}')
    checks.instance("room", room, Room)
    files.checked_decimals(decimals)
    checks.positive("tolerance", tolerance, "JND")
    data = times_in_room(room, measured)
    refuse_repeated_data(room, data)
    return Loop(
        room=room,
        wanted=data.reverberation_time,
        measured=data_history(room, data),
        rule=rule,
        method=method,
        equation=equation,
        decimals=decimals,
        tolerance=tolerance,
    )


def _noise(found: Measurement) -> Array:
    """The simulator's standard error of the mean T20 in s, as `Step` has it."""
    stated = found.uncertainty.get("t20", np.zeros((1, len(found.centre_frequencies))))
    return np.asarray(np.sqrt(np.sum(stated**2, axis=0)) / len(stated))
