"""The closed loop: calibrate an equation, and move its target until a simulator has the measured T.

Coefficients that give the measured T by an equation give another T in a simulator, which changes with
the equation's target T (Bellows & Katz 2025, Sects. 4.2 and 4.3). So each step calibrates the equation
to a target, simulates the coefficients, and sets the next target of each band by a rule (`RULES`).

One target per band can match one number: T20, or the weighted geometric mean of T20 and EDT, T_c =
product of T_p to the power of p's share. Where the times follow the target alike, matching T_c leaves
the smallest weighted sum of squares of log(T_p / measured T_p).

`calibrate_simulator` runs the `Loop` with a simulator that Python can call. For a program that a user
runs, there are `start`, `Loop.next_alpha` and `Loop.record`, or ``rtcal loop``. Each step by hand
leaves two files: the state of the loop, and the room to simulate.

"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label, labels, span
from rtcal.acoustics.bands import notes as notes_of_bands
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import TrustMark, cautions, gap_jnd, of_input, of_row, of_unit, rms
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import EARLY, REVERBERATION, TARGET, observable, parameter_label
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.acoustics.room_errors import in_words
from rtcal.acoustics.run import Run, contents
from rtcal.calibration.measured import MeasuredTimes, data_history, tell_data, times_in_room
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.result import CalibrationResult
from rtcal.files.disk import json_numbers, write_all
from rtcal.files.saved import Result, load
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
from rtcal.modes.calibrate import ModesResult, above_schroeder
from rtcal.simulators.base import Simulator, at_places, check_alpha, check_fits, lost_paths, run
from rtcal.support import checks, text
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError, OtherBandsWarning, RtcalError, SimulatorError
from rtcal.support.text import as_sentence, shortened
from rtcal.support.types import Array, put, read_only

PARAMETERS = (TARGET.key, EARLY.key)
Weights = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Matched:
    """Hold the mean decay times over the pairs that a loop matches: T20 alone, or T20 and EDT together.

    ``measured`` has the measured times of each parameter in s, (n_bands,), NaN where missing; the first
    is T20, or T30 if T20 was not measured. ``shares`` are the weights of the parameters, which sum to 1
    in each band. ``time_label`` is the name of the measured reverberation time, such as "T20", and
    ``kinds`` has its key in each band.
    """

    measured: Mapping[str, Array]
    shares: Mapping[str, Array]
    time_label: str = TARGET.label
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("measured", "shares"):
            values = {p: read_only(v) for p, v in getattr(self, name).items()}
            put(self, **{name: values})

    @property
    def label(self) -> str:
        """Names of the matched parameters, as text."""
        names = " and ".join(map(self.name_of, self.shares))
        return names if len(self.shares) == 1 else f"the weighted mean of {names}"

    def name_of(self, parameter: str) -> str:
        """Return the name of a parameter as it was measured, such as T30 in place of T20."""
        return self.time_label if parameter == TARGET.key else parameter_label(parameter)

    @property
    def wanted(self) -> Array:
        """Measured time in s to match, (n_bands,): T20, or its weighted geometric mean with EDT."""
        return read_only(self.combined(self.measured.__getitem__))

    def combined(self, time: Callable[[str], Array]) -> Array:
        """Return the weighted geometric mean in s of the parameters' times, which ``time`` returns."""
        return np.asarray(np.prod([time(p) ** s for p, s in self.shares.items()], axis=0))

    def of(self, simulated: Measurement) -> Measurement:
        """Return the simulation, with its T30 as T20 if only T30 was measured."""
        t20, t30 = (o.key for o in REVERBERATION)
        if t30 not in self.kinds or t30 not in simulated.values:
            return simulated
        here = np.array([kind == t30 for kind in self.kinds]) & np.isfinite(simulated.mean(t30))
        none = np.full(simulated.values[t30].shape, np.nan)
        tables = {"values": simulated.values, "uncertainty": simulated.uncertainty}
        merged: dict[str, Any] = {
            name: {**of, t20: np.where(here, of.get(t30, none), of.get(t20, none))}
            for name, of in tables.items()
            if {t20, t30} & of.keys()
        }
        return replace(simulated, **merged)

    def noise(self, measurement: Measurement) -> Array:
        """Return the standard error in s of the simulated time that is compared, (n_bands,).

        It is 0 if ``measurement``, the simulated values, states no uncertainty, and NaN where it states
        NaN. T20 and EDT come from the same paths, so their errors are added as if fully correlated.
        """
        time = self.combined(measurement.mean)
        total = np.zeros(len(time))
        for parameter, share in self.shares.items():
            if (errors := measurement.uncertainty.get(parameter)) is not None:
                error = np.sqrt(np.sum(errors**2, axis=0)) / len(errors)
                part = share * error * (time / measurement.mean(parameter))
                total = total + np.where(share > 0, part, 0.0)
        return total


def _matched_times(
    room: Room, measured: Measurement, data: MeasuredTimes, weights: Weights | None
) -> Matched:
    """Return the decay times to match; ``data`` is the measured T in the room's bands."""
    stated = {TARGET.key: 1.0} if weights is None else checks.mapped("weights", weights)
    for name in stated:
        checks.choice("weights: a parameter", name, PARAMETERS)
    edt = measured.in_bands(room.centre_frequencies).mean(EARLY.key)
    times = {TARGET.key: data.reverberation_time, EARLY.key: edt}
    some = np.isfinite([*times.values()]).any(axis=0) & (weights is not None)
    weight = np.zeros((len(PARAMETERS), room.n_bands))

    def refuse(bad: NDArray[np.bool_], place: str, why: str) -> None:
        if bad.any():
            where = label(room.centre_frequencies[int(np.argmax(bad))])
            raise DataError(f"{place} at {where} {why}")

    for p, row in zip(PARAMETERS, weight, strict=True):
        place = f"weights[{p!r}]"
        given = checks.array(place, stated.get(p, 0.0))
        row[:] = checks.shaped(place, given, room.n_bands) if given.ndim else given
        refuse(~(np.isfinite(row) & (row >= 0)), place, "must be finite and 0 or more")
        lacking = (row > 0) & np.isnan(times[p]) & some
        refuse(lacking, place, f"is above 0, and the measurement has no {parameter_label(p)}")
    largest = weight.max(axis=0)
    refuse(largest == 0, "weights are 0 for every parameter", "so that nothing is matched there")
    weight /= largest  # so that their sum is finite, and none is too small to count
    shares = dict(zip(PARAMETERS, weight / weight.sum(axis=0), strict=True))
    kept = [p for p in PARAMETERS if p == TARGET.key or shares[p].any()]
    return Matched(
        measured={p: times[p] for p in kept},
        shares={p: shares[p] for p in kept},
        time_label=measured.time_label,
        kinds=data.parameter,
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
"""Names of a band's status. The loop leaves bands of the first four alone."""
_COMPARED = tuple(dict.fromkeys([*(o.key for o in REVERBERATION), *SHOWN]))
MAX_DECIMALS = 12
"""Largest number of decimals of alpha that a simulation program can be said to read."""
_CLOSE_TARGETS = np.log(1.1)
"""If log targets with and without a simulated T20 are closer, another simulation gains little: T is
then known within 10 %, two JND."""
_STUCK_STEPS = 3
"""Steps with different coefficients and the same T20 after which T does not depend on alpha."""
_JND = 0.05
"""One JND of T, as a share of it."""
_LEAST_SLOPE = 0.1
"""Change of ln T over the equation's below which a table is hardly of the coefficients written last."""
_AT_LIMIT = 1e-9  # relative; rounding of a target that was set to the limit
_FROM_BOUNDS = 1e-3
"""Share of the range of S'alpha that a target keeps from its ends: at the bounds T may be 0, or
infinite without air."""
_BELOW_LARGEST_MEAN = 0.999  # of the mean coefficient at which the equation ends
_STRONGEST_SHADE = 5.0  # JND
_AS_NEAR = 1e-6  # JND by which gaps differ that are the same


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """Hold one simulation of a loop: the coefficients, and the T that the simulator gave with them."""

    target: Array
    """T in s to which the equation was calibrated, (n_bands,); NaN without a measured T."""
    alpha: Array
    """Coefficients that were simulated, (n_materials, n_bands)."""
    simulated: Array
    """Simulated T20, or its weighted mean with EDT, in s, (n_bands,); NaN if there is none."""
    noise: Array
    """Standard error of ``simulated`` in s, (n_bands,); 0 if none is stated, NaN if it is unknown."""
    means: Mapping[str, Array] = field(default_factory=dict)
    """Simulated means over the pairs of all parameters that are shown, by key, (n_bands,) each."""

    def __post_init__(self) -> None:
        alpha = checks.shaped("step: alpha", self.alpha, "n_materials", "n_bands")
        put(self, alpha=alpha)

        def by_band(name: str, values: object) -> Array:
            return checks.shaped(f"step: {name}", values, alpha.shape[1])

        for name in ("target", "simulated", "noise"):
            put(self, **{name: by_band(name, getattr(self, name))})
        means = checks.mapped("step: means", self.means)
        named = {checks.text("step: a parameter of means", p): v for p, v in means.items()}
        means = {p: by_band(f"means[{checks.shown(p)}]", v) for p, v in named.items()}
        put(self, means=means)


@dataclass(frozen=True, eq=False)
class ParameterGap:
    """Hold the deviations of one parameter before and after a loop, as means over the pairs.

    Arrays are (n_bands,). ``means`` has the values "measured", "before" and "after", NaN where there is
    none. ``before`` and ``after`` are simulated minus measured values in JND. If the loop matches the
    parameter, ``share`` is the parameter's weight as a share of all weights, and ``lost`` the number of
    JND by which its deviation exceeds that of the weighted mean of the matched parameters.
    """

    means: Mapping[str, Array]
    before: Array
    after: Array
    share: Array
    lost: Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Loop(Result):
    """Hold a closed loop with a simulator: its simulations, the next coefficients and the result.

    Do not make a Loop yourself: `start` returns a new loop, and `record` returns the loop after a
    further simulation; a loop itself does not change. `save` and `load` keep the loop in a file between
    two runs of a simulation program. `rtcal.calibrate_simulator` runs a whole loop with a simulator
    that rtcal can call.

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

    record_kind: ClassVar[str] = "loop 2"
    in_file: ClassVar[str] = (
        "room=prior.name centre_frequencies=prior.centre_frequencies matched=matched.label "
        "shares=matched.shares simulations alpha finished status=status_now gap_jnd=gap goal_jnd=goal "
        "parameters farther trust_marks notes=every_note"
    )

    prior: Room
    """Room as it was given, with your input alpha and sigma."""
    matched: Matched
    """Measured times that the loop matches: T20 alone, or T20 and EDT together."""
    data: str
    """Fingerprint of the measurement, which the calibrated room keeps, so that data cannot count
    twice."""
    rule: Rule
    """Rule for the next target: a key of `RULES`."""
    method: str = "mle"
    """Method of the equation's calibration: see `rtcal.calibrate`."""
    equation: LinearEquation = field(default_factory=Eyring)
    decimals: int | None = None
    """Number of decimals of alpha that the program reads. The loop rounds the coefficients to them."""
    tolerance: float = 1.0
    """Largest deviation in JND with which a band is converged."""
    steps: tuple[Step, ...] = ()
    bent: tuple[TrustMark, ...] = ()
    """Cautions for bands whose measured decay is curved."""
    beside: Mapping[str, Array] = field(default_factory=dict)
    """Measured means over the pairs of parameters that are shown and not matched, (n_bands,)."""
    low: ModesResult | None = None
    """Result of room modes, which replaces T in the bands below the Schroeder frequency."""
    simulator: str = ""
    """Name of the simulator that Python called; "" for a program that is run by hand. The coefficients
    belong to no other."""
    simulations: int = 0
    """Number of simulations so far, including those before and after the loop."""
    returned: Array | None = None
    """Calibrated coefficients of a finished loop, (n_materials, n_bands); see `alpha`."""
    before: Measurement | None = None
    """Simulation with your input coefficients. If some band has no T20 with them, or fewer than three
    simulations were allowed, simulation with the coefficients of the equation's calibration. None if
    the loop began with a run that you made, which is the first step."""
    after: Measurement | None = None
    """Simulation with the calibrated coefficients."""
    confirmation: Measurement | None = None
    """Simulation with the calibrated coefficients and another seed. None for a simulator without random
    numbers, and if no band converged."""
    notes: tuple[str, ...] = ()
    """Notes on data and simulations, such as paths that left through gaps of the mesh."""

    def __post_init__(self) -> None:
        checks.choice("rule", self.rule, RULES)
        self.prior.refuse_pieces("a loop with a simulation program")
        preset(self.method)
        if self.decimals is not None and checks.whole("decimals", self.decimals, 1) > MAX_DECIMALS:
            raise DataError(f"decimals = {self.decimals} is more than {MAX_DECIMALS}")
        checks.positive("tolerance", self.tolerance, "JND")

    @cached_property
    def wanted(self) -> Array:
        """Measured T in s that the loop matches, (n_bands,), NaN where it is missing."""
        return self.matched.wanted

    def calibrated(self, target: Array) -> CalibrationResult:
        """Return the calibration of the reverberation equation to a target T in s, (n_bands,).

        If no coefficients from 0 to 1 give the target, those with the nearest possible T are returned.
        Volume, areas and climate count as exact, so that a target changes only the coefficients.
        """
        problem = _exact_problem(self.method, self.prior, self.equation)
        return problem.solve(target, unreachable="nearest", method=self.method)

    # The steps, and each band's best one

    @cached_property
    def _gaps(self) -> Array:
        """Gap of every step in JND, (n_steps, n_bands)."""
        if not self.steps:
            raise DataError(
                "the loop has no simulation yet, so there is no deviation; simulate and report "
                "the result first"
            )
        return np.array([gap_jnd(step.simulated, self.wanted) for step in self.steps])

    @property
    def best(self) -> NDArray[np.int64]:
        """Number of the step in ``steps``, from 0, with the smallest deviation, (n_bands,)."""
        return np.asarray(np.argmin(np.nan_to_num(np.abs(self._gaps), nan=np.inf), axis=0))

    @cached_property
    def _best(self) -> Step:
        """What each band has in its best step, which were perhaps never simulated together."""
        chosen = [self.steps[b] for b in self.best]
        none = np.full(self.prior.n_bands, np.nan)

        def of_best(by_band: Sequence[Array]) -> Array:
            return np.stack([values[..., k] for k, values in enumerate(by_band)], axis=-1)

        every = {p for step in self.steps for p in step.means}
        return Step(
            target=of_best([step.target for step in chosen]),
            alpha=of_best([step.alpha for step in chosen]),
            simulated=of_best([step.simulated for step in chosen]),
            noise=of_best([step.noise for step in chosen]),
            means={p: of_best([step.means.get(p, none) for step in chosen]) for p in every},
        )

    @property
    def best_alpha(self) -> Array:
        """Coefficients of the step with the smallest deviation in each band, (n_materials, n_bands)."""
        return self._best.alpha

    @property
    def goal(self) -> Array:
        """Largest deviation in JND at which a band is done, (n_bands,): the tolerance minus the noise.

        The noise is the standard error of the last simulated T. The goal is at least half the
        tolerance, and exactly half if the noise is unknown.
        """
        noise = self.steps[-1].noise / TARGET.jnd_of(self.wanted)
        return np.fmax(self.tolerance - noise, self.tolerance / 2)

    @property
    def finished(self) -> bool:
        """Whether no band would improve with another simulation."""
        return bool(self.steps) and "not converging" not in self.status

    # What came of it

    @property
    def final(self) -> Measurement | None:
        """Simulation whose T is the result: ``confirmation`` if there is one, otherwise ``after``.

        None before the calibrated coefficients of all bands have been simulated together.
        """
        return self.confirmation or self.after

    @property
    def alpha(self) -> Array:
        """Calibrated coefficients, (n_materials, n_bands)."""
        return self.best_alpha if self.returned is None else self.returned

    @cached_property
    def ends(self) -> tuple[Step, Step]:
        """First step, and last step: that of `final`, or a step with the best values of each band."""
        last = self._best if self.final is None else self._step(self.final, self.alpha)
        if self.before is None:
            return self.steps[0], last
        return self._step(self.before, self.prior.alpha), last

    def _step(self, of: Measurement, alpha: Array, target: Array | None = None) -> Step:
        of = self.matched.of(of)
        return Step(
            target=np.full(self.prior.n_bands, np.nan) if target is None else target,
            alpha=alpha,
            simulated=self.matched.combined(of.mean),
            noise=self.matched.noise(of),
            means=means(of),
        )

    @cached_property
    def outcome(self) -> CalibrationResult:
        """Calibration of the reverberation equation to the targets of each band's best step."""
        return self.calibrated(self._best.target)

    @cached_property
    def room(self) -> Room:
        """Room with the calibrated coefficients, their uncertainty sigma, and a record of the loop."""
        found, by = self.outcome.room, self.simulator or "a program run by hand"
        record = found.calibration and replace(
            found.calibration,
            measured=self.data,
            equation=f"{found.calibration.equation}, in the loop with {by}",
        )
        return found.replace(alpha=self.alpha, calibration=record)

    @cached_property
    def of_uncertain_room(self) -> CalibrationResult | None:
        """Calibration to the targets of `outcome` that also adjusts volume, areas and climate.

        Its coefficients change less than those of the loop. The simulator would not give the measured T
        with these coefficients, because it simulates the input volume, areas and climate. The result is
        None if volume, areas and climate of the room are exact.
        """
        if not self.prior.is_uncertain or not self.steps:
            return None
        problem = preset(self.method, self.prior).build(self.prior, self.equation)
        return problem.solve(self._best.target, unreachable="nearest", method=self.method)

    @property
    def gap(self) -> Array:
        """Simulated minus measured value of the matched T in JND, (n_bands,); NaN without a measured T.

        The simulated T is that of `final` or, before it exists, of each band's best step.
        """
        return gap_jnd(self.ends[1].simulated, self.wanted)

    @cached_property
    def status(self) -> tuple[str, ...]:
        """Status of each band, (n_bands,): one of `STATUSES`, such as "converged".

        "converged": the deviation of the best step is within `goal`. "unreachable": no other target
        brings T nearer, for example because the equation can give no longer one. "not converging":
        the band needs another simulation. "not confirmed": the band converged, but in the
        simulation `final` the noise is above the tolerance, or the deviation above the tolerance
        plus the noise. "by modes", "too few modes": the band is below the Schroeder frequency
        (``low``).
        """
        gap, last = gap_jnd(self._best.simulated, self.wanted), self.steps[-1]
        within = np.abs(gap) <= self.goal
        noise = self.ends[1].noise / TARGET.jnd_of(self.wanted)
        kept = (noise <= self.tolerance) & (np.abs(self.gap) <= self.tolerance + noise)
        shortest, longest = self._target_limits
        blocked = np.abs(np.log(self._target_without_t20 / self._best.target)) < _CLOSE_TARGETS
        blocked |= (gap < 0) & (last.target >= longest * (1 - _AT_LIMIT))
        blocked |= (gap > 0) & (last.target <= shortest * (1 + _AT_LIMIT))
        if len(steps := self.steps[-2:]) == 2:  # the next target would be the same once more
            blocked |= (steps[0].target == steps[1].target) & (
                steps[0].simulated == steps[1].simulated
            )
        if len(steps := self.steps[-_STUCK_STEPS:]) == _STUCK_STEPS:
            changed = np.diff([step.alpha for step in steps], axis=0) != 0
            same = np.diff([step.simulated for step in steps], axis=0) == 0
            blocked |= changed.any(axis=1).all(axis=0) & same.all(axis=0)
        rows = {
            "no measured T": np.isnan(self.wanted),
            "not confirmed": within & ~kept & (self.final is not None),
            "converged": within,
            "unreachable": blocked,
        }
        if self.low is not None:
            of_modes = {True: "by modes", False: "too few modes"}
            by = {name: self.low.below & (self.low.carried == c) for c, name in of_modes.items()}
            rows = by | rows
        return tuple(np.select([*rows.values()], [*rows], "not converging").tolist())

    @property
    def status_now(self) -> tuple[str, ...]:
        """Status of each band as printed: "not yet" for "not converging" in an unfinished loop."""
        on = self.final is None and not self.finished
        return tuple("not yet" if on and s == "not converging" else s for s in self.status)

    @cached_property
    def gaps(self) -> dict[str, ParameterGap]:
        """Means, deviations and weight of each parameter that is shown, by name."""
        none = np.full(self.prior.n_bands, np.nan)
        measured, of_mean, found = {**self.beside, **self.matched.measured}, np.abs(self.gap), {}
        for p in SHOWN:
            values = [measured.get(p, none), *(step.means.get(p, none) for step in self.ends)]
            before, after = (gap_jnd(v, values[0], p) for v in values[1:])
            if p in measured or np.isfinite(values[1]).any():
                found[p] = ParameterGap(
                    means=dict(zip(("measured", "before", "after"), values, strict=True)),
                    before=before,
                    after=after,
                    share=self.matched.shares.get(p, np.zeros_like(none)),
                    lost=np.maximum(np.abs(after) - of_mean, 0.0),
                )
        return found

    @property
    def compromise(self) -> dict[str, ParameterGap]:
        """Deviations of each matched parameter: one target per band cannot match two exactly."""
        return {p: self.gaps[p] for p in self.matched.shares}

    @property
    def gaps_beside(self) -> Gaps:
        """Deviations (before, after) in JND, (n_bands,), of measured parameters not matched, by key."""
        return {p: (self.gaps[p].before, self.gaps[p].after) for p in self.beside}

    @property
    def farther(self) -> tuple[str, ...]:
        """Keys of parameters that are not matched, and whose deviation grew by over 1 JND in a band."""
        return left(self.gaps_beside)

    @property
    def parameters(self) -> dict[str, Mapping[str, Array]]:
        """Means "measured", "before" and "after", (n_bands,), of each simulated parameter, by key."""
        return {p: g.means for p, g in self.gaps.items() if np.isfinite(g.means["before"]).any()}

    @cached_property
    def doubts(self) -> tuple[TrustMark, ...]:
        """Cautions about the input: likely typing errors in the room and in the matched data."""
        name = self.matched.label.removeprefix("the ")
        mistyped = of_row(self.prior.centre_frequencies, self.wanted, name, " s")
        return of_input(self.prior, self.wanted, mistyped)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Cautions about input and result, such as coefficients at 0 or 1 or far from your input.

        Also a simulated T in a wrong unit, curved measured decays, and bands with too few room modes. A
        small deviation alone does not confirm the result, because coefficients can be found with which
        a simulator gives almost any T.
        """
        return self._marks_of(self.outcome)

    @property
    def marks_of_next(self) -> tuple[TrustMark, ...]:
        """Cautions, as `trust_marks`, about the coefficients to simulate next."""
        return self._marks_of(self.calibrated(self.next_target))

    def _marks_of(self, outcome: CalibrationResult) -> tuple[TrustMark, ...]:
        return (
            *self.doubts,
            *(self._unit_of(self.steps[0], None) if self.steps else ()),
            *(m for m in outcome.trust_marks if m.kind in ("at_bound", "implausible")),
            *self.bent,
            *(self.low.loop_marks if self.low else ()),
        )

    def _expected(self, step: Step, last: Step | None) -> Array:
        """Return T in s for a step's coefficients: the equation's, or as it changes the ``last`` T."""
        own = self._time(step.alpha)
        return own if last is None else last.simulated * own / self._time(last.alpha)

    def _unit_of(self, step: Step, last: Step | None) -> list[TrustMark]:
        """Return a caution if a step's T is off by a power of ten from `_expected`; else none."""
        of = "the one that the coefficients give by the equation"
        return of_unit(step.simulated, self._expected(step, last), "simulated T", of)

    def _follows(self, step: Step, last: Step) -> bool:
        """Return whether ln T changed by at least a tenth of the equation's change, over all bands.

        True if the equation's T changes by less than one JND. In halls with concentrated absorption,
        the simulated T changes by about half as much as the equation's.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            wanted = np.log(self._expected(step, last) / last.simulated)
            got = np.log(step.simulated / last.simulated)
        both = np.isfinite(wanted) & np.isfinite(got)
        if not both.any() or rms(wanted[both]) < _JND:
            return True
        return bool(got[both] @ wanted[both] >= _LEAST_SLOPE * (wanted[both] @ wanted[both]))

    # The next simulation

    @property
    def next_target(self) -> Array:
        """T in s to which the equation is calibrated next, (n_bands,), NaN without a measured T.

        Before the first simulation it is the measured T. Later, ``rule`` gives the targets of the bands
        that need another simulation, and of converged bands with a deviation above half of `goal`. All
        other bands keep the target of their best step. A band in which no simulation had a T20 gets the
        equation's T of the input coefficients. A target moves at most halfway, in ln T, towards a
        target with which the simulation had no T20.
        """
        if not self.steps:
            return self.wanted.copy()
        target, without_t20 = self._best.target.copy(), self._target_without_t20
        stated, halfway = self._own_target(self.prior.alpha), np.sqrt(target * without_t20)
        shortest, longest = self._target_limits
        shortest = np.where(without_t20 < target, np.maximum(shortest, halfway), shortest)
        longest = np.where(without_t20 > target, np.minimum(longest, halfway), longest)
        for k in np.flatnonzero(self._moving):
            known = [s for s in self.steps if np.isfinite(s.simulated[k])]
            targets = np.array([step.target[k] for step in known])
            times = np.array([step.simulated[k] for step in known])
            ends = self.wanted[k], shortest[k], longest[k]
            target[k] = next_target(self.rule, targets, times, *ends) if known else stated[k]
        return target

    @property
    def next_alpha(self) -> Array:
        """Coefficients to simulate next, (n_materials, n_bands), rounded to ``decimals`` decimals.

        Bands that need no other simulation keep the coefficients of their best step.
        """
        alpha = self._rounded(self.calibrated(self.next_target).alpha)
        return np.where(self._moving, alpha, self.best_alpha) if self.steps else alpha

    def _rounded(self, alpha: Array) -> Array:
        """Return coefficients rounded to ``decimals``, up where they would fall below ``alpha_min``."""
        if self.decimals is None:
            return alpha.copy()
        rounded = np.round(alpha, self.decimals)
        up = np.round(rounded + 10.0**-self.decimals, self.decimals)
        return np.where(rounded < self.prior.least_alpha, up, rounded)

    @property
    def _moving(self) -> NDArray[np.bool_]:
        """Whether the next step moves the band's target, (n_bands,)."""
        status, gap = np.array(self.status), gap_jnd(self._best.simulated, self.wanted)
        needed = status == "not converging"
        rough = (np.abs(gap) > self.goal / 2) & np.isnan(self._target_without_t20)
        return np.asarray(needed | ((status == "converged") & rough & needed.any()))

    @property
    def _target_without_t20(self) -> Array:
        """The target without a simulated T20 that is nearest to the best one, (n_bands,).

        NaN for a band with a T20 in every step or in none.
        """
        targets = np.array([step.target for step in self.steps])
        simulated = np.isfinite(self._gaps)
        missing = ~simulated & np.isfinite(self.wanted)
        distance = np.where(missing, np.abs(np.log(targets / self._best.target)), np.inf)
        nearest = targets[np.argmin(distance, axis=0), np.arange(self.prior.n_bands)]
        both = missing.any(axis=0) & simulated.any(axis=0)
        return np.asarray(np.where(both, nearest, np.nan))

    @cached_property
    def _target_limits(self) -> tuple[Array, Array]:
        """The shortest and the longest T in s that the equation can give within the bounds."""
        room, fixed = self.prior, self.prior.sigma == 0
        least = room.areas @ np.where(fixed, room.alpha, room.least_alpha)
        most = room.areas @ np.where(fixed, room.alpha, 1.0)
        margin = _FROM_BOUNDS * (most - least)
        largest = _BELOW_LARGEST_MEAN * self.equation.largest_mean * room.total_area
        high = np.minimum(most - margin, largest)
        return self.equation.time(room, high), self.equation.time(room, least + margin)

    def _own_target(self, alpha: Array) -> Array:
        """Return the equation's T in s of any coefficients, (n_bands,), NaN without a measured T."""
        own = np.clip(self._time(alpha), *self._target_limits)
        return np.where(np.isfinite(self.wanted), own, np.nan)

    def _time(self, alpha: Array) -> Array:
        return self.equation.time(self.prior, self.prior.areas @ alpha)

    def record(
        self,
        alpha: Array,
        simulated: Measurement,
        without_t20: Sequence[int] = (),
        *,
        stated: bool = False,
    ) -> Loop:
        """Return the loop after a simulation of `next_alpha`, or of coefficients of your own.

        A band may lack a T20 that it had in an earlier step: its target then moves back towards the
        target of that step. A simulation that is recorded once no band needs another one (``finished``)
        becomes ``after``: it shows the T of all bands' calibrated coefficients together.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
            Coefficients that were simulated.
        simulated : Measurement
            Values that the simulator gave, in the room's bands, with T20 of every pair.
        without_t20 : sequence of int, optional
            Numbers, from 0, of bands in which ``alpha`` gave no T20, so that you simulated other
            coefficients there; their T20 in ``simulated`` is ignored. None by default.
        stated : bool
            True if ``alpha`` are coefficients of your own, such as the input, in place of `next_alpha`.

        Raises
        ------
        DataError
            If ``after`` exists already, if alpha does not fit the room, or if ``simulated`` has other
            bands or lacks the T20 of a pair: in a band in which no earlier step had it, or in every
            measured band.
        """
        if self.after is not None:
            raise DataError(
                "the loop is finished and its last room was simulated; there is nothing "
                "left to simulate"
            )
        lost = self._lost(simulated)
        for band in checks.listed("without_t20", without_t20):
            if checks.whole("without_t20", band, 0) >= len(lost):
                raise DataError(
                    f"without_t20 has {band}; the bands are numbered 0 to {len(lost) - 1}"
                )
            lost[band] = True
        alpha = check_alpha(self.prior, alpha)
        target = self._own_target(alpha) if checks.flag("stated", stated) else self.next_target
        step, number = self._step(simulated, alpha, target), self.simulations + 1
        if self.finished:
            return replace(self, returned=step.alpha, after=simulated, simulations=number)
        step = replace(step, simulated=np.where(lost, np.nan, step.simulated))
        return replace(self, steps=(*self.steps, step), simulations=number)

    def _lost(self, simulation: Measurement) -> NDArray[np.bool_]:
        """Return in which bands some pair of a simulation lacks what is matched, (n_bands,).

        Raises DataError for other bands, or a matched parameter that is missing. A measured band may
        lack it only if it has one in an earlier step, and some measured band has one now.
        """
        frequencies = self.prior.centre_frequencies
        checks.instance("what was simulated", simulation, Measurement)
        if not np.array_equal(simulation.centre_frequencies, frequencies):
            raise DataError(
                f"the simulation has {span(simulation.centre_frequencies)}, but the room "
                f"has {span(frequencies)}. Simulate in the bands of the room"
            )
        simulation, measured = self.matched.of(simulation), np.isfinite(self.wanted)
        missing = {}
        for parameter, share in self.matched.shares.items():
            if parameter not in simulation.values:
                name = self.matched.name_of(parameter)
                raise DataError(
                    f"the simulation has no {name}, but {name} was measured. The simulation has "
                    f"{contents(simulation)}. Export {name} from your program, too"
                )
            missing[parameter] = np.isnan(simulation.values[parameter]) & measured & (share > 0)
        lost = np.any([absent.any(axis=0) for absent in missing.values()], axis=0)
        earlier = np.isfinite([lost * np.nan, *(step.simulated for step in self.steps)]).any(axis=0)
        refused = lost if lost[measured].all() else lost & ~earlier
        for parameter, absent in missing.items():
            for pair, k in np.argwhere(absent & refused)[:1].tolist():
                of = "" if simulation.is_summary else f"{' to '.join(simulation.pairs[pair])}, "
                raise DataError(
                    f"simulated {parameter_label(parameter)} at {of}{label(frequencies[k])} is "
                    "missing, but T was measured there. Simulate this band, too"
                )
        return np.asarray(lost)

    def back(self) -> Loop:
        """Return the loop without its last simulation; raises DataError if none was recorded."""
        if not self.steps:
            raise DataError("the loop has no simulation yet, so there is no step to take back")
        steps = self.steps if self.after is not None else self.steps[:-1]
        number = self.simulations - 1
        return replace(self, steps=steps, returned=None, after=None, simulations=number)

    @classmethod
    def load(cls, path: str | os.PathLike[str], room: Room | None = None) -> Loop:
        """Return the loop from the file ``path`` that `save` wrote.

        If ``room`` is given, it must have the same numbers as the room with which the loop was started.
        Raises DataError otherwise, and if the file contains no loop.
        """
        loop = load(path)
        if not isinstance(loop, Loop):
            raise DataError(
                f"{path} is not the state of a loop, but a {type(loop).__name__}. Give the "
                "file that `rtcal loop start` wrote"
            )
        if room is None:
            return loop
        own = loop.low.prior if loop.low else loop.prior
        if not all(np.array_equal(getattr(room, n), getattr(own, n)) for n in _OF_ROOM):
            raise DataError(
                f'{path} belongs to another room, or room "{room.name}" was changed after '
                "the loop was started. Give the room with which the loop was started"
            )
        return loop if loop.low else replace(loop, prior=room)

    # What is shown

    def __repr__(self) -> str:
        of = shortened(self.simulator or self.prior.name)
        converged = self.status.count("converged") if self.steps else 0
        n_bands = np.isfinite(self.wanted).sum()
        return f'<Loop "{of}": {_simulations(self)}, {converged} of {n_bands} bands converged>'

    def blocks(self) -> list[Block]:
        """Return the notes and tables that `print` shows: deviation, status and parameters by band.

        Raises DataError for a loop without a simulation.
        """
        best = [int(b) + 1 for b in self.best]
        first, last = (step.simulated for step in self.ends)
        gaps, goals = zip(*map(_apart, self.gap, self.goal), strict=True)
        shade = np.nan_to_num(self.gap) / _STRONGEST_SHADE
        rows = [
            Row("T wanted / s", self.wanted, ".3f"),
            Row("T of first run / s", first, ".3f"),
            Row("T simulated / s", last, ".3f"),
            Row("first deviation / JND", gap_jnd(first, self.wanted), "+.1f"),
            Row("deviation / JND", self.gap, shade=shade, shown=gaps),
            Row("required within / JND", self.goal, shown=goals),
            Row("missing absorption / σ", self.outcome.plausibility.z, "+.1f"),
            Row("number of nearest run", best, "d"),
            Row("status", self.status_now),
        ]
        for parameter, part in self.compromise.items() if len(self.matched.shares) > 1 else ():
            name = parameter_label(parameter)
            rows += [
                Row(f"{name}, share of the weights", part.share, ".2f"),
                Row(f"{name} deviation / JND before", part.before, "+.1f"),
                Row(f"{name} deviation / JND after", part.after, "+.1f"),
                Row(f"{name} lost / JND", part.lost, ".1f"),
            ]
        others = [
            Row(f"{parameter_label(p)} / {of.unit} {when}", value, f".{of.decimals}f")
            for p, means in self.parameters.items()
            if p != TARGET.key  # EDT, C50 and C80
            for of in (observable(p),)
            for when, value in means.items()
        ]
        names = labels(self.prior.centre_frequencies)
        of, worst = self.simulator or "the program that was run by hand", "was compared in no band"
        if np.isfinite(self.gap).any():
            k = int(np.nanargmax(np.abs(self.gap)))
            worst = f"deviates from the measured T by up to {abs(self.gap[k]):.1f} JND ({names[k]})"
        said = f"After {_simulations(self)}, the simulated T {worst}. The coefficients are valid "
        tables = [Table(names, rows, "By band")]
        if others:
            title = "Other parameters, means over pairs: first run (before), nearest run (after)"
            tables.append(Table(names, others, title))
        return [
            Note(f"{said}only for {of}."),
            *map(Note, cautions(self.trust_marks, lettered=False)),
            *tables,
            *(Note(n, hanging="       " if n.startswith(" ") else "    ") for n in self._notes),
        ]

    @property
    def every_note(self) -> list[str]:
        """Notes on data and simulations, and cautions about the loop itself."""
        return [*cautions(self.trust_marks, lettered=False), *self._notes]

    @property
    def _notes(self) -> list[str]:
        notes = [*sentences(self.gaps_beside, self.prior.centre_frequencies)]
        if "not confirmed" in self.status:
            notes.append(
                "Not confirmed: in one more simulation the deviation exceeds the tolerance plus the "
                "noise, or the noise alone exceeds the tolerance. Simulate with less noise (more "
                "paths)."
            )
        if self.prior.is_uncertain:
            notes.append(
                f"The room is uncertain ({in_words(self.prior)}). These coefficients are for the "
                "simulator with the volume and areas of the room's file, so they also make up for the "
                "errors of both. The coefficients of the materials are in result.of_uncertain_room."
            )
        return [*notes, *([] if self.low is None else [self.low.loop_note]), *self.notes]

    def to_dict(self) -> dict[str, Any]:
        """Return the steps and their results as plain values for JSON."""
        found = {name: json_numbers(getattr(self, name)) for name in _SETTINGS}
        found["equation"] = {"name": self.equation.name, **asdict(self.equation)}
        return found | super().to_dict() if self.steps else found


_SETTINGS = ("simulator", "wanted", "rule", "method", "decimals", "tolerance", "steps")
_OF_ROOM = (
    *("materials", "volume", "areas", "centre_frequencies"),
    *("speed_of_sound", "air_attenuation", "alpha", "sigma"),
)
"""Numbers of a room that stay the same in a loop."""


@lru_cache(8)
def _exact_problem(
    method: str, room: Room, equation: LinearEquation
) -> CalibrationProblem[CalibrationResult]:
    """Return the compiled calibration of a room whose volume, areas and climate count as exact."""
    return preset(method, room.as_exact).build(room.as_exact, equation)


def _simulations(loop: Loop) -> str:
    return f"{loop.simulations} simulation{'s' * (loop.simulations != 1)}"


def _apart(gap: float, goal: float) -> tuple[str, str]:
    """Return a gap and its goal in JND with digits enough to show on which side of it the gap is.

    Examples
    --------
    >>> _apart(-0.998, 1.0), _apart(-1.002, 1.0), _apart(-0.998, 0.996)
    (('-1.00', '1.00'), ('-1.002', '1.000'), ('-0.998', '0.996'))
    """
    same = (d for d in range(2, 8) if (round(abs(gap), d) <= round(goal, d)) == (abs(gap) <= goal))
    n = next(same, 8)
    return text.number(gap, f"+.{n}f"), text.number(goal, f".{n}f")


def start(
    room: Room | ModesResult,
    measured: Measurement,
    *,
    rule: Rule = "safeguarded",
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
    weights: Weights | None = None,
    run: Run | None = None,
) -> Loop:
    """Return a new loop that calibrates a room's coefficients with a simulation program.

    Parameters
    ----------
    room : Room or ModesResult
        Room with your input alpha and sigma. In a result of ``calibrate_modes(room, ...)`` without T,
        the measured modes replace T below the Schroeder frequency, and the loop keeps their
        coefficients. In large rooms with hard walls, make sigma proportional to alpha: equal sigmas
        drive hard walls to alpha = 0.
    measured : Measurement
        Measurement of the room, whose mean T20, or T30, over the pairs is matched.
    rule : {"secant", "safeguarded"}
        Rule for the next target T of a band. "secant": straight line through the last two simulations,
        in 1/T. "safeguarded": the same in ln T, with a limited slope, and between the targets with too
        long and too short a T.
    method : str
        Method of the equation's calibration in each step, such as "mle"; see `rtcal.calibrate`.
    equation : LinearEquation, optional
        Reverberation equation that is calibrated in each step; `rtcal.Eyring` by default.
    decimals : int, optional
        Number of decimals of alpha that the program reads, from 1 to 12; by default alpha is not
        rounded.
    tolerance : float
        Largest deviation in JND. A band is done if its deviation is within the tolerance minus the
        simulator's noise. It is confirmed if its deviation with another seed is within the tolerance
        plus the noise.
    weights : mapping of "t20" and "edt" to a number or an array (n_bands,), optional
        Weights, 0 or more, with which the mean T20 and the mean EDT are matched together, by their
        weighted geometric mean. `Loop.compromise` shows how far each of them then is from its measured
        value. By default T20 alone is matched.
    run : Run, optional
        Room and values of a simulation that you have already made, with any coefficients. It becomes
        the first simulation of the loop. The next target is then scaled by the equation's T over the
        program's T (Bellows & Katz 2025, Eq. 39).

    Returns
    -------
    Loop
        Loop whose ``next_alpha`` you simulate next, and give back to `Loop.record`.

    Raises
    ------
    DataError
        If an argument breaks its rule, if the room was already calibrated to these data, or if the run
        is of another room or lacks a T20. Other bands, and a room without air, give a warning.
    """
    low = room.in_loop(measured) if isinstance(room, ModesResult) else None
    prior = room.prior if isinstance(room, ModesResult) else checks.instance("room", room, Room)
    tell_data(prior, measured)
    if low is not None:
        prior, measured = low.room, above_schroeder(measured, prior, low.below)
    whole = times_in_room(prior, measured)
    refuse_repeated_data(prior, whole.fingerprint)
    both = None
    if run is not None:
        checks.instance("run", run, Run).refuse_other(prior)
        both = run.beside(measured)
        for needed in (REVERBERATION, (EARLY,) if EARLY.key in (weights or ()) else ()):
            if needed and not {o.key for o in needed} & both.measured.values.keys():
                raise run.nothing_common(measured, " or ".join(o.label for o in needed))
        measured = both.measured
    data = times_in_room(prior, measured)
    matched = _matched_times(prior, measured, data, weights)
    shown = means(measured.in_bands(prior.centre_frequencies))
    loop = Loop(
        prior=prior,
        matched=matched,
        data=data_history(prior, whole),
        rule=rule,
        method=method,
        equation=equation or Eyring(),
        decimals=decimals,
        tolerance=tolerance,
        bent=data.bent,
        beside={p: mean for p, mean in shown.items() if p not in matched.shares},
        low=low,
        notes=() if both is None else tuple(both.left_out(_COMPARED)),
    )
    loop.calibrated(loop.wanted)  # warns of a room without air
    if run is None or both is None:
        return loop
    # Bands without T keep their input, or what the room modes say.
    alpha = np.where(np.isfinite(loop.wanted), run.room.alpha, prior.alpha)
    return loop.record(alpha, both.run, stated=True)


def calibrate_simulator(
    simulator: Simulator,
    room: Room | ModesResult,
    measured: Measurement,
    rule: Rule = "safeguarded",
    *,
    exclude: Sequence[tuple[str, str]] = (),
    max_simulations: int = 12,
    seed: int = 0,
    after_step: Callable[[Loop], None] | None = None,
    **options: Any,
) -> Loop:
    """Calibrate a room's coefficients so that a simulator gives the measured T20, averaged over pairs.

    The input coefficients are simulated first, and a band that does not come nearer to the measured T
    keeps them. `calibrate_positions` matches the values at every position instead of the mean.

    Parameters
    ----------
    simulator : Simulator
        Simulator of the room.
    room, measured, rule
        Room, its measurement, and the rule for the next target: see `rtcal.loop.start`.
    exclude : sequence of (source, receiver)
        Names of the pairs that are left out of the measurement and of the simulation.
    max_simulations : int
        Largest number of simulations, at least 2 for a simulator with random numbers. One of them is
        kept for the final coefficients: to confirm them with another seed, or to simulate together the
        coefficients of bands whose best steps differ.
    seed : int
        Seed of the simulator's random numbers in all steps. The confirmation uses ``seed + 1``.
    after_step : callable, optional
        Function that is called with the loop after every step, for example to `Loop.save` it.
    options
        ``weights``, ``method``, ``equation``, ``decimals``, ``tolerance`` and ``run``: see
        `rtcal.loop.start`. With a ``run`` the input coefficients are not simulated.

    Returns
    -------
    Loop
        Finished loop: ``room`` has the calibrated coefficients, ``status`` says for each band whether
        it converged and was confirmed, and ``steps`` has all simulations.

    Raises
    ------
    SimulatorError, TooShortError
        If the simulator raises them. The error's ``loop`` is the `Loop` with all steps so far. If a
        band has a T20 only for some of the coefficients, no error is raised: the band ends as
        "unreachable".
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
    <Loop "reverb 3000": 2 simulations, 6 of 6 bands converged>
    """
    check_fits(simulator, room.prior if isinstance(room, ModesResult) else room)
    exclude = checks.pairs("exclude", exclude)
    checks.whole("seed", seed, 0)
    checks.whole("max_simulations", max_simulations, 1 if simulator.deterministic else 2)
    if after_step is not None and not callable(after_step):
        raise DataError(f"after_step = {after_step!r} cannot be called")
    measured, notes = at_places(simulator, measured)
    if exclude:
        refuse_unknown(exclude, measured)
        measured, notes = _without(measured, exclude), (*notes, left_out(exclude))
    # The result's notes and marks say it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OtherBandsWarning)
        loop = start(room, measured, rule=rule, **options)
    frequencies, kinds = loop.prior.centre_frequencies, loop.matched.kinds
    notes += tuple(map(as_sentence, notes_of_bands(measured.centre_frequencies, frequencies)))
    other = [p not in ("", TARGET.key) for p in kinds]
    if any(other):
        where = f" at {', '.join(labels(frequencies[other]))}" if TARGET.key in kinds else ""
        notes += (f"T30 is matched{where} in place of T20, which was not measured.",)
    calls = _Calls(simulator, exclude, max(max_simulations - 1, 1))
    try:
        for loop in _steps(loop, calls, seed):  # noqa: B020 (each is the loop after one more step)
            if after_step is not None:
                after_step(loop)
        calls.left += max_simulations - max(max_simulations - 1, 1)
        loop = _judged(calls, loop, seed)
    except RtcalError as error:
        error.loop = loop
        raise
    before = loop.before if options.get("run") is None else None
    return replace(loop, before=before, notes=(*loop.notes, *notes, *lost_paths(simulator)))


def _without(measurement: Measurement, exclude: Sequence[Pair]) -> Measurement:
    """Return a measurement without some pairs, so that means are over the same ones."""
    kept = [pair for pair in measurement.pairs if pair not in exclude]
    if not kept:
        raise DataError("exclude has every pair; at least one must be left")
    return measurement if len(kept) == len(measurement.pairs) else measurement.select(kept)


@dataclass
class _Calls:
    """The calls of a simulator: how many are left, and what they gave."""

    simulator: Simulator
    exclude: Sequence[Pair]
    left: int
    number: int = 0
    answers: list[tuple[Array, int, Measurement]] = field(default_factory=list)

    def __call__(self, alpha: Array, seed: int) -> Measurement:
        self.left, self.number = self.left - 1, self.number + 1
        measurement = _without(run(self.simulator, alpha, seed=seed), self.exclude)
        self.answers.append((alpha, seed, measurement))
        return measurement


def _steps(loop: Loop, calls: _Calls, seed: int) -> Iterator[Loop]:
    """Yield the loop after each step, until it is finished or no call is left.

    The input coefficients come first, so that no band ends farther away, unless some band has no T20
    with them. Where `Loop.next_alpha` gives some bands no T20, these are simulated once more with
    coefficients that gave one. An error in every band is raised, and so is NaN in the first step.
    """
    stated = loop._rounded(loop.prior.alpha)
    if calls.left > 1 and not loop.steps:
        try:
            loop = loop.record(stated, calls(stated, seed), stated=True)
        except RtcalError as error:
            if not error.bands and not isinstance(error, DataError):
                raise
        else:
            yield loop
    while calls.left and not loop.finished:
        alpha = loop.next_alpha
        try:
            loop = loop.record(alpha, calls(alpha, seed))
        except RtcalError as error:
            nan_at_first = isinstance(error, SimulatorError) and not loop.steps
            if not error.bands or nan_at_first or 1 < len(alpha[0]) == len(error.bands):
                raise
            if not calls.left and not loop.steps:
                raise
            without_t20 = error.bands
        else:
            yield loop
            continue
        if not calls.left:
            return
        with_t20 = alpha.copy()
        for k in without_t20:
            known = [stated, *(s.alpha for s in loop.steps if np.isfinite(s.simulated[k]))]
            with_t20[:, k] = known[-1][:, k]
        loop = loop.record(alpha, calls(with_t20, seed), without_t20)
        yield loop


def _judged(calls: _Calls, loop: Loop, seed: int) -> Loop:
    """Return the loop with the coefficients of each band's best step, simulated together.

    If bands differ in their best step, their coefficients were never simulated together. Where bands
    depend on each other and are farther together than a step was, those of that step are returned.
    """
    simulator, alpha = calls.simulator, loop.best_alpha
    confirmation = None
    if not simulator.deterministic and "converged" in loop.status:
        confirmation = calls(alpha, seed + 1)
    simulated = [m for a, s, m in calls.answers if s == seed and np.array_equal(a, alpha)]
    after = simulated[-1] if simulated else confirmation or calls(alpha, seed)

    def off(of: Measurement) -> float:
        return float(rms(gap_jnd(loop.matched.combined(loop.matched.of(of).mean), loop.wanted)))

    for tried, _, measurement in calls.answers if simulator.deterministic else ():
        if off(measurement) < off(after) - _AS_NEAR:
            alpha, after = tried, measurement
    return replace(
        loop,
        simulator=simulator.name,
        simulations=calls.number,
        returned=alpha,
        before=calls.answers[0][2],  # the stated coefficients, where they have a T20
        after=after,
        confirmation=confirmation,
    )


# The files of a loop by hand: its state, the room to simulate, and the tables that are read


def refuse_progress(state: str) -> None:
    """Raise DataError if the loop's file at this path already holds simulations."""
    if Path(state).exists() and (loop := Loop.load(state)).steps:
        raise DataError(
            f"{state} already has {_simulations(loop)} of a loop. To start again, "
            "delete this file, or give another file with --state"
        )


def refuse_doubtful(loop: Loop, step: Step, table: str) -> None:
    """Raise DataError if the simulated T of a step was probably read from the wrong file.

    The file is probably wrong if its T equals the measured T or that of an earlier step to the last
    digit, differs by a power of ten from the expected T, or does not change as the coefficients do.
    ``table`` is the name of the file.
    """
    last = loop.steps[-1] if loop.steps else None
    same = [
        n
        for n, earlier in enumerate(loop.steps, 1)
        if np.array_equal(step.simulated, earlier.simulated, equal_nan=True)
        and not np.array_equal(step.alpha, earlier.alpha)
    ]
    if marks := loop._unit_of(step, last):
        doubt = marks[0].sentence
    elif last is None and np.array_equal(step.simulated, loop.wanted, equal_nan=True):
        of = loop.matched.time_label
        doubt = (
            f"every simulated {of} equals the measured {of} to the last digit. Probably "
            "this table is the measurement, and not the simulation"
        )
    elif same or (last is not None and not loop._follows(step, last)):
        of = f"the same as in run {same[-1]}" if same else "about the same as in the last run"
        doubt = (
            f"T is {of}, although the coefficients have changed since. Check that the program used "
            "the room that `rtcal loop` wrote last, with its coefficients"
        )
    else:
        return
    raise DataError(f"{table}: {as_sentence(doubt)} If the table is right, add --again")


def record(
    loop: Loop, simulated: Measurement, table: str, state: str, out: str, *, again: bool = False
) -> Loop:
    """Return the loop after a simulation that was read from the file ``table``.

    ``loop`` was read from the file ``state``, and ``out`` is the file of the room to simulate. Raises
    DataError for a table that is probably the wrong one (`refuse_doubtful`), unless ``again`` is True;
    also for a finished loop, and if the room in ``out`` is not the one to simulate.
    """
    if loop.after is not None:
        raise DataError(
            f"{state}: the loop is finished and its last room was simulated, so {table} "
            f"was not used. The coefficients are in {out}; `rtcal report {state}` shows "
            "how they changed"
        )
    alpha = written = loop.next_alpha
    with suppress(DataError):  # another name than last time, or no room: it shows nothing
        written = Room.from_file(out).alpha
    if not np.array_equal(np.round(written, 9), np.round(alpha, 9)):
        anew = "`rtcal loop start`"
        if loop.steps:
            anew = "`rtcal loop back`, and then `rtcal loop next` with the table before,"
        raise DataError(
            f"{table} was not read, because {out} no longer has the coefficients that "
            f"{state} asked to be simulated: one of the two files was changed. If {table} "
            f"was simulated with the right coefficients, delete {out} and repeat the "
            f"command. Otherwise {anew} writes the right coefficients, to be simulated "
            "again"
        )
    try:
        after = loop.record(alpha, simulated)
    except DataError as error:
        raise DataError(f"{table}: {error}") from error
    if not again:
        refuse_doubtful(loop, after.steps[-1] if after.after is None else after.ends[1], table)
    return after


def write(loop: Loop, state: str, out: str) -> str:
    """Write the loop and the room to simulate into two files, and return the next step in words.

    ``state`` is the name of the loop's file, ``out`` that of the room's. Both files are written, or
    none.
    """
    n, of = loop.simulations, f"of the loop in {Path(state).name!r}"
    if n and loop.finished:
        note = f"Calibrated for the program simulated: the end {of}, after {n} runs."
        off = [s not in (*STATUSES[:4], "not confirmed") for s in loop.status]
        missed = f", but {sum(off)} of {len(off)} bands were not reached" if any(off) else ""
        end = (
            f"Done{missed}. {out} has the coefficients of each band's nearest run. Next: simulate them "
            "together, then give the result to `rtcal loop next`, which checks it."
        )
        if any(np.array_equal(step.alpha, loop.best_alpha) for step in loop.steps):
            end = (
                f"Done{missed}. {out} has the calibrated coefficients, which were simulated together. "
                "If your program uses random numbers, simulate them once more: `rtcal loop next` then "
                "checks them."
            )
        if loop.after is not None:
            end = f"Done{missed}. {out} has the calibrated coefficients, which were simulated together."
        denied = [s == "not confirmed" for s in loop.status]
        if any(denied):
            where = ", ".join(labels(loop.prior.centre_frequencies[denied]))
            end += (
                f" Not confirmed at {where}: simulate with less noise (more paths) after "
                "`rtcal loop back`."
            )
    else:
        note = f"To simulate: run {n + 1} {of}."
        end = f"Next: simulate with the coefficients in {out}, then give the result to "
        end += "`rtcal loop next`."
    room = loop.prior.replace(alpha=loop.next_alpha, calibration=None)
    content = f"# {note}\n{room.to_text(Path(out).parent)}"
    write_all({out: content.encode(), state: loop.to_json(Path(state).parent).encode()})
    return end


Rule = Literal["secant", "safeguarded"]

# Limits of d log(rate) / d log(target). The slope is 1 if the simulator is proportional to the
# equation, and about 0.5 in halls with concentrated absorption (docs/closed_loop.md). Other slopes are
# mostly noise of two close points. Over 60 random shoeboxes with Fitzroy's, Arau-Puchades' and
# Millington's equations as simulators, 98 % of the slopes are 0.82 to 9.6. Limits twice as wide, and no
# limits, give the same mean number of simulations, 2.75. Limits of 0.6 to 1.5 give 2.58, but 0.6 is
# above the slopes of those halls.
_SLOPES = (0.3, 3.0)


def secant(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return a band's next target, as a rate 1/T in 1/s, by the secant through the last two targets.

    All arguments are such rates: ``targets`` those of the steps so far, ``rates`` those simulated for
    them, ``wanted`` the measured one, and ``low`` and ``high`` the ends of the equation's range. The
    result may be outside this range, and may be negative.

    References
    ----------
    Bellows & Katz 2025, Eqs. 38 to 40.
    """
    if len(targets) == 1:
        return float(2 * wanted - rates[-1])
    rise = rates[-1] - rates[-2]
    if rise == 0:
        return float(targets[-1])
    return float(targets[-1] - (rates[-1] - wanted) * (targets[-1] - targets[-2]) / rise)


def safeguarded(targets: Array, rates: Array, wanted: float, low: float, high: float) -> float:
    """Return a band's next target, as a rate 1/T in 1/s, by a secant step in logarithms within limits.

    The arguments are those of `secant`. The slope is 1 in the first step, and limited in later ones.
    The target must be above every target for which too low a rate (too long a T) was simulated, and
    below every target for which too high a rate was simulated. Otherwise the middle between these two
    limits is returned, or the end of the equation's range in place of a limit that no step has set.
    """
    u, v, w = np.log(targets), np.log(rates), np.log(wanted)
    slope = 1.0
    if len(u) > 1 and u[-1] != u[-2]:
        slope = float(np.clip((v[-1] - v[-2]) / (u[-1] - u[-2]), *_SLOPES))
    step = float(u[-1] + (w - v[-1]) / slope)
    below = float(np.max(u[v < w], initial=np.log(low)))
    above = float(np.min(u[v > w], initial=np.log(high)))
    if below < above and not below < step < above:
        at_end = (step <= below == np.log(low)) or (step >= above == np.log(high))
        step = min(max(step, below), above) if at_end else (below + above) / 2
    return float(np.exp(step))


RULES: dict[str, Callable[[Array, Array, float, float, float], float]] = {
    "secant": secant,
    "safeguarded": safeguarded,
}


def next_target(
    rule: str, targets: Array, times: Array, wanted: float, shortest: float, longest: float
) -> float:
    """Return the next target T in s of a band, within the range of the equation.

    ``rule`` is a key of `RULES`. ``targets`` are the targets so far in s, and ``times`` the T in s that
    were simulated for them, (n_steps,) each. ``wanted`` is the measured T. ``shortest`` and ``longest``
    are the ends of the equation's range of T in s.
    """
    rate = RULES[rule](1 / targets, 1 / times, 1 / wanted, 1 / longest, 1 / shortest)
    if rate <= 0:  # the secant rule leads beyond every T: twice the last target
        rate = 0.5 / float(targets[-1])
    return float(np.clip(1 / rate, shortest, longest))
