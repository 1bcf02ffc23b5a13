"""`Calibration` states a problem, `build` compiles it once, `solve` solves it for a measurement.

`CalibrationProblem.solve` brings T into the room's bands (`measured_times`). `certified_answer` makes
the numbers of the solve (`Composition.numbers`) and of them the result.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast, overload

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Equation, Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.calibration import feasibility, qp
from rtcal.calibration.composition import Composition
from rtcal.calibration.measured import MeasuredTimes, no_times, times_in_room
from rtcal.calibration.qp import Iterate, SolveOptions
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.terms import (
    AddedAbsorption,
    BoundConstraint,
    ExactMatch,
    LinearObservations,
    Objective,
    Observed,
    SharedMaterials,
    SoftMatch,
    Term,
    as_objective,
)
from rtcal.calibration.unknowns import Configurations
from rtcal.support import checks
from rtcal.support.errors import (
    DataError,
    InfeasibleError,
    MissingAirWarning,
    ModelError,
    SolverError,
)
from rtcal.support.types import Array

Times = Measurement | Sequence[float] | Array
R = TypeVar("R", CalibrationResult, JointResult)


@dataclass(frozen=True, eq=False)
class Calibration:
    """An objective and constraints, not yet tied to a room.

    Parameters
    ----------
    objective : term or sum of terms
        Terms of `rtcal.terms`, or functions of a `rtcal.terms.Model` that return a cvxpy expression.
        One of them is a prior (`rtcal.terms.PriorDeviation` or `rtcal.terms.HuberDeviation`), which
        makes the answer unique.
    constraints : sequence, optional
        Constraints of `rtcal.terms`, or functions of a model that return cvxpy constraints. If not
        given, `ExactMatch`, unless the objective has a `SoftMatch`, which an exact match would make
        useless.

    Raises
    ------
    ModelError
        If there is no prior or more than one, or if a term occurs twice.
    """

    objective: Any
    constraints: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        objective = as_objective(self.objective)
        priors = [t for t in objective.terms if getattr(t, "is_prior", False)]
        if len(priors) != 1:
            raise ModelError(
                f"the objective has {len(priors)} prior deviations; it needs one: without it the "
                "answer is not unique"
            )
        _refuse_repeated(objective.terms, "objective")
        if sum(isinstance(t, SoftMatch) for t in objective.terms) > 1:
            raise ModelError("the objective has two soft matches; T has one uncertainty per band")
        for term, weight in zip(objective.terms, objective.weights, strict=True):
            if weight == 0 and (term is priors[0] or isinstance(term, AddedAbsorption)):
                raise ModelError(
                    f"{term!r} has weight 0; without it the answer is not unique. Leave the term out "
                    "instead"
                )
        constraints = self.constraints
        if constraints is None:
            soft = any(isinstance(t, SoftMatch) for t in objective.terms)
            constraints = () if soft else (ExactMatch(),)
        if not isinstance(constraints, Iterable):
            raise ModelError(f"constraints = {constraints!r} is not a list of constraints")
        for constraint in constraints:
            if isinstance(constraint, type):
                name = constraint.__name__
                raise ModelError(f"{name} is a class and no term: write {name}()")
            if isinstance(constraint, (BoundConstraint, SharedMaterials)):
                continue
            if not callable(constraint) or isinstance(constraint, Term | Objective):
                raise ModelError(
                    f"{constraint!r} is no constraint of rtcal.terms, and no function of a "
                    "rtcal.terms.Model that returns one"
                )
        _refuse_repeated(tuple(constraints), "constraints")
        object.__setattr__(self, "objective", objective)
        object.__setattr__(self, "constraints", tuple(constraints))

    @overload
    def build(
        self, room: Room, equation: Equation | None = None
    ) -> CalibrationProblem[CalibrationResult]: ...

    @overload
    def build(
        self, room: Configurations, equation: Equation | None = None
    ) -> CalibrationProblem[JointResult]: ...

    def build(
        self, room: Room | Configurations, equation: Equation | None = None
    ) -> CalibrationProblem[CalibrationResult] | CalibrationProblem[JointResult]:
        """Compile the calibration for rooms of this shape, or for several configurations of one.

        Raises
        ------
        DataError
            If a term names a material or a band that the room lacks.
        ModelError
            If the problem is not DPP (then every solve would compile anew), or the equation is
            not a function of the mean absorption coefficient.

        Warns
        -----
        MissingAirWarning
            If a room states no air.
        """
        for one in _configurations(room).rooms:
            if one.air is None:
                warnings.warn(
                    f'room "{one.name}" states no air: its surfaces are made to absorb what the air '
                    "does. Give it air=rtcal.Air(temperature, humidity)",
                    MissingAirWarning,
                    stacklevel=checks.stack_level(),
                )
                break
        return CalibrationProblem(self, room, Eyring() if equation is None else equation)


def _refuse_repeated(terms: Sequence[object], place: str) -> None:
    """Raise ModelError for a term that occurs twice."""
    for i, term in enumerate(terms):
        if any(term == other for other in terms[:i]):
            raise ModelError(f"{place}: {term!r} stands there twice; give it once")


class CalibrationProblem(Generic[R]):
    """A calibration that is compiled for rooms of one shape: solve it for many measurements.

    Built for a room it returns a `CalibrationResult`, built for `Configurations` of one a
    `JointResult`. One room is one of several: only the arguments of `solve` differ.
    """

    def __init__(
        self, calibration: Calibration, room: Room | Configurations, equation: Equation
    ) -> None:
        checks.instance("calibration", calibration, Calibration)
        if not isinstance(equation, LinearEquation):
            if not isinstance(equation, Equation) or isinstance(equation, type):
                raise ModelError(
                    f"equation = {equation!r} is not an equation such as rtcal.Eyring()"
                )
            raise ModelError(
                f"{equation.name} is not a function of the mean absorption coefficient, so it gives "
                "no linear target; calibrate it in the closed loop with calibrate_simulator"
            )
        self.room = room
        self.equation = equation
        self.composition = Composition.of(
            _configurations(room), equation, calibration.objective, calibration.constraints or ()
        )
        _ = self.composition.compiled  # here, so that terms that make no QP are refused at once

    def __repr__(self) -> str:
        return f"<CalibrationProblem with {self.equation.name}'s equation for {self.room!r}>"

    def solve(
        self,
        measured: Any,
        room: Room | Configurations | None = None,
        *,
        observed: Mapping[LinearObservations, Observed] | None = None,
        method: str = "composed",
        **options: Any,
    ) -> R:
        """Solve for one measurement, without compiling again.

        Parameters
        ----------
        measured : Measurement, or T in s, (n_bands,), or None
            A band with NaN keeps its prior. None if no T was measured. Of several configurations, a
            list with one entry for each.
        room : Room or Configurations, optional
            Other numbers for the same materials and bands; by default the room built with.
        observed : mapping of `rtcal.terms.LinearObservations` to `rtcal.terms.Observed`, optional
            The numbers of each such term.
        method : str
            The name that the result carries.
        **options
            ``solver``, ``unreachable``, ``warm_start`` and ``settings``; see
            `rtcal.calibration.qp.SolveOptions`.

        Raises
        ------
        DataError
            If the measurement or the room does not fit.
        InfeasibleError
            If a band cannot be reached, with ``unreachable="raise"``, or the constraints contradict
            each other: then the message names the smallest relaxation that removes it.
        SolverError
            If no answer passes the certificate.
        """
        chosen = SolveOptions(**options)
        alone = isinstance(self.room, Room)
        used = built = _configurations(self.room)
        if room is not None:
            checks.instance("room", room, Room if alone else Configurations)
            used = _configurations(room)
            _require_same_shape(built, used)
        times = measured_times(used, [measured] if alone else measured)
        for one, measured_there in zip(used.rooms, times, strict=True):
            if one.calibration is not None:
                refuse_repeated_data(one, measured_there.fingerprint)
        try:
            joint = certified_answer(self.composition, used, times, observed, chosen, method)
        except InfeasibleError as error:
            doubted = [doubt for measured_there in times for doubt in measured_there.mistyped]
            if doubted:
                error.args = (f"{doubted[0].sentence}. {error}",)
            raise
        return cast(R, joint.results[0] if alone else joint)


def _configurations(room: Room | Configurations) -> Configurations:
    """Return a room as one of several; DataError for anything else."""
    if isinstance(room, Room):
        return Configurations([room])
    if not isinstance(room, Configurations):
        raise DataError(f"room = {room!r} is not a rtcal.Room, nor Configurations of one")
    return room


def _require_same_shape(built: Configurations, asked: Configurations) -> None:
    """Raise DataError unless ``asked`` has the shape that the problem was built with."""
    old, new = built.rooms, asked.rooms
    if len(old) != len(new):
        raise DataError(f"{len(new)} configurations; the problem was built with {len(old)}")
    for before, after in zip(old, new, strict=True):
        if after.materials != before.materials:
            raise DataError(f"room has materials {after.materials}; built with {before.materials}")
        if not np.array_equal(after.centre_frequencies, before.centre_frequencies):
            has = ", ".join(bands.labels(after.centre_frequencies))
            raise DataError(f"room has other bands than the one built with: {has}")


def measured_times(
    configurations: Configurations, measured: Sequence[Times | None]
) -> list[MeasuredTimes]:
    """Return one measurement per configuration, each in its room's bands."""
    if isinstance(measured, str | Measurement) or not isinstance(measured, Iterable):
        raise DataError(
            f"measured = {measured!r} is not a list of measurements, one per configuration"
        )
    measured = list(measured)
    if len(measured) != len(configurations.rooms):
        raise DataError(
            f"{len(measured)} measurements for {len(configurations.rooms)} configurations; each "
            "needs one"
        )
    return [
        no_times(r) if t is None else times_in_room(r, t)
        for r, t in zip(configurations.rooms, measured, strict=True)
    ]


def certified_answer(
    composition: Composition,
    configurations: Configurations,
    times: Sequence[MeasuredTimes],
    observed: Mapping[LinearObservations, Observed] | None,
    options: SolveOptions,
    method: str,
) -> JointResult:
    """Return the certified answer for some rooms and what was measured in them.

    1. `feasibility.restrict_to_reach`: is T within reach, and which unknowns does a T at an end hold?
    2. `Composition.qp` fills the compiled matrices; `qp.solve` asks the solver.
    3. The first of `_candidates` that `qp.certify` accepts is the answer.

    Raises
    ------
    InfeasibleError
        If a band cannot be reached, or the constraints contradict each other.
    SolverError
        If no answer passes the certificate.
    """
    numbers = composition.numbers(configurations, times, observed)
    matches = [match.target_limits(numbers) for match in composition.matches]
    numbers, held_at, beyond = feasibility.restrict_to_reach(numbers, matches, options.unreachable)
    program = composition.qp(numbers)
    at = np.zeros(len(program.c), dtype=np.int8)
    at[composition.compiled.places] = held_at
    try:
        raw = qp.solve(program, at, options)
    except SolverError as error:
        # It was asked for a guess of the active set alone; without one, polishing begins at the prior.
        raw = replace(Iterate.of(program, at), status=str(error))
    convexity = composition.convexity(numbers)
    for point in _candidates(program, at, raw):
        certificate = qp.certify(program, point, convexity)
        if certificate.accepted:
            break
    else:
        feasibility.explain(composition, numbers, program)
        raise SolverError(
            f'solver "{options.solver}" says {raw.status}, but its answer does not pass: primal '
            f"residual {np.max(certificate.primal_residual):.1e}, dual residual "
            f"{np.max(certificate.dual_residual):.1e}, gap {np.max(certificate.duality_gap):.1e}"
        )
    u = program.unknowns(numbers, point.v)
    active = composition.unknowns_at(numbers, point.at)
    # Exactly at its bound, and within it in spite of the rounding of mu + sigma x.
    u = np.where(active < 0, numbers.lower, np.where(active > 0, numbers.upper, u))
    return JointResult(
        configurations=configurations,
        composition=composition,
        unknowns=np.clip(u, *numbers.box),
        target=numbers.target,
        point=replace(point, system=None),
        certificate=certificate,
        raw=raw,
        polished=point is not raw,
        unreachable=beyond,
        method=method,
        solver=options.solver,
        measured_times=tuple(times),
        observed=observed,
    )


def _candidates(program: qp.QP, at: qp.Active, raw: Iterate) -> Iterator[Iterate]:
    """Yield the polished answer of the solver, that of the closed form, and the solver's own."""
    guessed, tight = raw.active(program)
    polished = qp.polish(program, np.where(at != 0, at, guessed).astype(np.int8), tight)
    if polished is not None:
        yield polished
    started = qp.closed_form(program, at)
    if started is not None:
        yield started
    yield raw
