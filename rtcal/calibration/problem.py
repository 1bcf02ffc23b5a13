"""`Calibration` states a problem, `build` compiles it once, `solve` solves it for a measurement.

`CalibrationProblem.solve` has the whole path from a measurement to a certified answer in one function.
`fit` takes Gauss-Newton steps around that QP, for models that are not linear in alpha.

    minimise ½ (y - f(a) - J (alpha - a))' C⁻¹ (y - f(a) - J (alpha - a)) + the other terms,

with y the data, f the model, J its derivatives at a, and C the covariance of the errors of both: an
`Observation`. alpha becomes the next a, or a point on the way to it where the objective with the model
itself would rise. So no fit ends at a larger objective than it began with, and a result tells whether
its last step settled. The QP certifies its own answer, and the last step's is that of the whole.

`fit` serves the calibration to every position (`rtcal.loop.positions`), to modes
(`rtcal.modes.calibrate`), of a case with effects (`rtcal.finder.means.recalibration`), and a user's own
data.

References
----------
Nocedal & Wright 2006, Numerical Optimization, Sect. 10.3 (Gauss-Newton) and 3.1 (backtracking).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar, cast, overload

import numpy as np
from scipy.linalg import solve_triangular

from rtcal.acoustics import bands
from rtcal.acoustics.equations import Equation, Eyring, LinearEquation
from rtcal.acoustics.marks import of_input
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.calibration import feasibility, qp
from rtcal.calibration.composition import Composition
from rtcal.calibration.measured import MeasuredTimes, no_times, times_in_room
from rtcal.calibration.qp import Active, Iterate
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.terms import (
    AddedAbsorption,
    Bounds,
    ExactMatch,
    LinearObservations,
    Objective,
    Observed,
    Shared,
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
    SimulatorError,
    SolverError,
)
from rtcal.support.text import as_sentence
from rtcal.support.types import Array, put

Times = Measurement | Sequence[float] | Array
R = TypeVar("R", CalibrationResult, JointResult)
_EYRING = Eyring()


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration that is composed of terms and constraints, for any room.

    Parameters
    ----------
    objective : term or sum of terms
        Sum to be minimised: terms of `rtcal.terms`, or functions of a `rtcal.terms.Model` that return a
        cvxpy expression. Exactly one must be `rtcal.terms.PriorDeviation` or
        `rtcal.terms.HuberDeviation`, which keep coefficients near the input and make the answer unique.
    constraints : sequence, optional
        Constraints of `rtcal.terms`, or functions of a model that return cvxpy constraints. By default
        `rtcal.terms.ExactMatch`, or none if the objective has a `rtcal.terms.SoftMatch`.

    Raises
    ------
    ModelError
        If not exactly one term is a deviation from the input, or if a term occurs twice.
    """

    objective: Any
    constraints: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        objective = as_objective(self.objective)
        terms, constraints = objective.terms, self.constraints
        priors = [t for t in terms if getattr(t, "is_prior", False)]
        if len(priors) != 1:
            raise ModelError(
                f"the objective has {len(priors)} prior deviations; it must have exactly one, "
                "which makes the answer unique"
            )
        soft = sum(isinstance(t, SoftMatch) for t in terms)
        if constraints is None:
            constraints = () if soft else (ExactMatch(),)
        if not np.iterable(constraints):
            raise ModelError(f"constraints = {constraints!r} must be a list of constraints")
        constraints = tuple(constraints)
        for constraint in constraints:
            if isinstance(constraint, type):
                name = constraint.__name__
                raise ModelError(f"{name} is a class, not a term: write {name}()")
            narrows = isinstance(constraint, Bounds | Shared)
            if not (narrows or callable(constraint)) or isinstance(constraint, Term | Objective):
                raise ModelError(
                    f"{constraint!r} is neither a constraint of rtcal.terms nor a function of an "
                    "rtcal.terms.Model that returns one"
                )
        for place, parts in (("objective", terms), ("constraints", constraints)):
            for i, term in enumerate(parts):
                if any(term == other for other in parts[:i]):
                    raise ModelError(f"{place}: {term!r} is given twice; give it once")
        if soft > 1:
            raise ModelError(
                "the objective has two soft matches; give only one, because T has one "
                "uncertainty per band"
            )
        further = [t.name for t in terms if isinstance(t, AddedAbsorption)]
        if len(set(further)) < len(further):
            raise ModelError(f"two further unknowns have the same name: {', '.join(further)}")
        for term, weight in zip(terms, objective.weights, strict=True):
            if weight == 0 and (term is priors[0] or isinstance(term, AddedAbsorption)):
                raise ModelError(
                    f"{term!r} has weight 0; give a weight above 0, because without this term "
                    "the answer is not unique"
                )
        put(self, objective=objective, constraints=constraints)

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
        """Return the calibration compiled for a room, or for several configurations of one room.

        The compiled calibration can be solved for all rooms with the same materials and bands.
        ``equation`` is the reverberation equation; None stands for `rtcal.Eyring` with the room's air.

        Raises
        ------
        DataError
            If a term names a material or a band that the room lacks.
        ModelError
            If a term is not convex and quadratic or a constraint not linear; if one of them multiplies
            two quantities that depend on room or measurement, which cvxpy cannot compile; or if T of
            the equation does not depend on the mean absorption coefficient alone.

        Warns
        -----
        MissingAirWarning
            If a room has no air.
        """
        if not isinstance(room, Room | Configurations):
            raise DataError(f"room = {room!r} must be an rtcal.Room or Configurations of one")
        equation = _EYRING if equation is None else equation
        if not isinstance(equation, LinearEquation):
            if not isinstance(equation, Equation) or isinstance(equation, type):
                raise ModelError(
                    f"equation = {equation!r} must be an equation such as rtcal.Eyring()"
                )
            raise ModelError(
                f"{equation.name} is not a function of the mean absorption coefficient, so it gives "
                "no linear target; calibrate it in the closed loop with calibrate_simulator"
            )
        constraints = cast(tuple[Any, ...], self.constraints)
        problem = CalibrationProblem[Any](self.objective, constraints, room, equation)
        if without := [one.name for one in problem.configurations.rooms if one.air is None]:
            warnings.warn(
                f'room "{without[0]}" has no air, so the absorption of the air is added to '
                "its surfaces. Give the room air=rtcal.Air(temperature, humidity)",
                MissingAirWarning,
                stacklevel=checks.stack_level(),
            )
        _ = problem.compiled  # cvxpy compiles: terms that make no QP are refused at once
        return problem


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationProblem(Composition, Generic[R]):
    """Calibration that `rtcal.Calibration.build` compiled; `solve` calibrates the room to its T.

    If it was compiled for a room, `solve` returns a `CalibrationResult`; if for `Configurations`, a
    `JointResult`.

    ``room`` is that room, or these configurations; ``objective``, ``constraints`` and ``equation`` are
    those of the `rtcal.Calibration`.
    """

    def __repr__(self) -> str:
        return f"<CalibrationProblem with {self.equation.name}'s equation for {self.room!r}>"

    def solve(
        self,
        measured: Any,
        room: Room | Configurations | None = None,
        *,
        observed: Mapping[LinearObservations, Observed] | None = None,
        method: str = "composed",
        solver: str = "clarabel",
        unreachable: str = "raise",
        warm_start: bool = True,
        settings: Mapping[str, Any] | None = None,
    ) -> R:
        """Return the calibration to one measurement, without compiling again.

        Parameters
        ----------
        measured : Measurement, or T in s, (n_bands,), or None
            Measured T; coefficients in a band with NaN do not change. None if no T was measured. For
            several configurations, a list with one entry for each.
        room : Room or Configurations, optional
            Room with other numbers for the same materials and bands; by default the room of `build`.
        observed : mapping of `rtcal.terms.LinearObservations` to `rtcal.terms.Observed`, optional
            Observed values of each such term.
        method : str
            Name of the method in the result.
        solver, unreachable, warm_start
            Solver, treatment of unreachable T, and start of OSQP, as in `rtcal.calibrate`.
        settings : mapping, optional
            Settings of the solver by name, which override `rtcal.calibration.qp.SETTINGS`.

        Raises
        ------
        DataError, ModelError
            If the measurement, the room or an option does not fit the problem.
        InfeasibleError
            If no coefficients give T in a band, with ``unreachable="raise"``, or if the constraints
            contradict each other; the message then names the smallest change of them that helps.
        SolverError
            If no answer is accurate enough.
        """
        if not (isinstance(solver, str) and solver in qp.SETTINGS):
            raise ModelError(f'solver = {solver!r} must be "clarabel" or "osqp"')
        checks.choice("unreachable", unreachable, ("raise", "nearest"))
        checks.flag("warm_start", warm_start)
        if settings is not None and not (
            isinstance(settings, Mapping) and all(isinstance(key, str) for key in settings)
        ):
            raise ModelError(f"settings = {settings!r} must be a mapping from name to value")
        problem, alone = self._for(room), isinstance(self.room, Room)
        rooms = problem.configurations
        times = measured_times(rooms, [measured] if alone else measured)
        for one, measured_there in zip(rooms.rooms, times, strict=True):
            if one.calibration is not None:
                refuse_repeated_data(one, measured_there.fingerprint)
        _refuse_equal_states(rooms, times)
        numbers = problem.numbers(times, observed)
        try:
            limits = [match.target_limits(numbers) for match in problem.matches]
            numbers, held_at, beyond = feasibility.restrict_to_reach(numbers, limits, unreachable)
            program = problem.compiled.filled(numbers)
            at = np.zeros(len(program.c), dtype=np.int8)
            at[problem.compiled.places] = held_at
            try:
                raw = qp.solve(program, at, solver, settings, warm_start)
            except SolverError as error:
                # It was asked for a guess of the active set alone. Polishing begins at the prior, with
                # what is held and what the prior violates as the active set.
                none = np.zeros(len(program.b)), np.zeros(len(at))
                raw = Iterate(program.at_bounds(at), *none, at, status=str(error))
            convexity = problem.convexity(numbers)
            for point in _candidates(program, at, raw):
                certificate = qp.certify(program, point, convexity)
                if certificate.accepted:
                    break
            else:
                feasibility.explain(problem, numbers, program)
                raise SolverError(
                    f'solver "{solver}" returned {raw.status}, but its answer fails the '
                    f"optimality check: primal residual {certificate.primal_residual:.1e}, dual "
                    f"residual {certificate.dual_residual:.1e}, gap {certificate.duality_gap:.1e}"
                )
        except InfeasibleError as error:
            said: list[str] = [
                as_sentence(doubt.sentence)
                for one, there in zip(rooms.rooms, times, strict=True)
                for doubt in of_input(one, there.reverberation_time, there.mistyped)
            ]
            why = str(error)
            if said and why.startswith("the "):
                why = "T" + why[1:]
            error.args = (" ".join([*dict.fromkeys(said), why]),)
            raise
        u = program.unknowns(numbers, point.v)
        active = problem.unknowns_at(numbers, point.at)
        # Exactly at its bound, and within it in spite of the rounding of mu + sigma x.
        u = np.where(active < 0, numbers.lower, np.where(active > 0, numbers.upper, u))
        joint = JointResult(
            composition=problem,
            unknowns=np.clip(u, *numbers.box),
            target=numbers.target,
            point=replace(point, system=None),
            certificate=certificate,
            raw=raw,
            polished=point is not raw,
            unreachable=beyond,
            method=method,
            solver=solver,
            measured_times=tuple(times),
            observed=observed,
        )
        return cast(R, joint.results[0] if alone else joint)

    def _for(self, room: Room | Configurations | None) -> CalibrationProblem[R]:
        """Return the problem for other numbers of a room; DataError unless it has the same shape."""
        if room is None:
            return self
        checks.instance("room", room, Room if isinstance(self.room, Room) else Configurations)
        asked = replace(self, room=room)
        old, new = self.configurations.rooms, asked.configurations.rooms
        if len(old) != len(new):
            raise DataError(
                f"{len(new)} configurations are given; the problem was built with {len(old)}"
            )
        for before, after in zip(old, new, strict=True):
            if after.materials != before.materials:
                raise DataError(
                    f"room has the materials {after.materials}; the problem was built with "
                    f"{before.materials}"
                )
            if not np.array_equal(after.centre_frequencies, before.centre_frequencies):
                has = ", ".join(bands.labels(after.centre_frequencies))
                raise DataError(f"room has other bands than the problem was built with: {has}")
        vars(asked)["compiled"] = self.compiled
        return asked


def measured_times(
    configurations: Configurations, measured: Sequence[Times | None]
) -> list[MeasuredTimes]:
    """Return the measured T of each configuration in its room's bands."""
    if isinstance(measured, str | Measurement) or not np.iterable(measured):
        raise DataError(
            f"measured = {measured!r} must be a list of measurements, one per configuration"
        )
    measured = list(measured)
    if len(measured) != len(configurations.rooms):
        raise DataError(
            f"{len(measured)} measurements for {len(configurations.rooms)} configurations; give "
            "one for each"
        )
    return [
        no_times(r) if t is None else times_in_room(r, t)
        for r, t in zip(configurations.rooms, measured, strict=True)
    ]


def _refuse_equal_states(rooms: Configurations, times: Sequence[MeasuredTimes]) -> None:
    """Raise DataError if two configurations have the same areas and the same measured T."""
    given = [(t.fingerprint, areas.tobytes()) for t, areas in zip(times, rooms.areas, strict=True)]
    for i, each in enumerate(given):
        if each[0] and each in given[:i]:
            raise DataError(
                f'configurations "{rooms.names[given.index(each)]}" and "{rooms.names[i]}" have the '
                "same areas and the same measured T: leave one out, because its T would count twice"
            )


def _candidates(program: qp.QP, at: Active, raw: Iterate) -> Iterator[Iterate]:
    """Yield the polished answer of the solver, that of the closed form, and the solver's own."""
    guessed, tight = raw.active(program)
    polished = qp.polish(program, np.where(at != 0, at, guessed).astype(np.int8), tight)
    if polished is not None:
        yield polished
    started = qp.closed_form(program, at)
    if started is not None:
        yield started
    yield raw


class Observation(Protocol):
    """Measured data of a room, with a model that predicts them, as `fit` needs them.

    An object with ``values``, ``covariance``, ``predict`` and ``jacobian`` is one.
    """

    @property
    def values(self) -> Array:
        """Measured values, (n,)."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance of the errors of data and model, (n, n)."""
        ...

    def predict(self, alpha: Array) -> Array:
        """Return the data that the model predicts, (n,), in the order of ``values``.

        ``alpha`` (n_materials, n_bands) are the coefficients. Raises DataError or SimulatorError if the
        model has no values for them; `fit` then does not make the step to these coefficients.
        """
        ...

    def jacobian(self, alpha: Array) -> Array:
        """Return the derivatives of what `predict` returns by alpha, (n, n_materials * n_bands)."""
        ...


@dataclass(frozen=True, eq=False)
class GaussNewtonStep:
    """Step of a fit: one calibration, with the model linearised at the coefficients before the step.

    ``alpha`` (n_materials, n_bands) are the coefficients before the step, and ``matrix`` (n,
    n_materials * n_bands) are the derivatives of the model's n values by them. ``answer`` is the
    calibration. ``share`` is the part of the way from ``alpha`` to the coefficients of ``answer`` that
    the fit went: 1 for the whole step, 0 if no part of it lowered the objective.
    """

    alpha: Array
    matrix: Array
    share: float
    answer: CalibrationResult


@dataclass(frozen=True, eq=False)
class GaussNewtonFit:
    """Result of `fit`: the coefficients at its end, (n_materials, n_bands), and its steps.

    ``settled`` is False if the fit ended before a step was as small as `fit` requires.
    """

    alpha: Array
    steps: tuple[GaussNewtonStep, ...]
    settled: bool

    @property
    def answer(self) -> CalibrationResult:
        """Calibration of the last step."""
        return self.steps[-1].answer


@dataclass(frozen=True, eq=False)
class ModelObjective:
    """Objective that `fit` minimises, calculated with the model and not with its linearisation.

    ``answer`` is the calibration with the linearised model, and ``term`` the `LinearObservations` of
    this calibration that has the data. ``factor`` (n, n) is the lower Cholesky factor of the data's
    covariance.
    """

    answer: CalibrationResult
    term: LinearObservations
    factor: Array

    @cached_property
    def others(self) -> Composition:
        """Objective and constraints without the term of the data."""
        return self.answer.joint.composition.without(self.term)

    def value(self, alpha: Array, residual: Array) -> float:
        """Return the objective, a negative logarithm of probability, for given coefficients.

        ``alpha`` (n_materials, n_bands) are the coefficients, and ``residual`` (n,) is the measured
        values minus the model's values. The objective is infinite if the coefficients violate a bound
        or a constraint.
        """
        white = solve_triangular(self.factor, residual, lower=True)
        layout, u = self.others.layout, self.answer.joint.unknowns.copy()
        u[: layout.n_alpha] = alpha[layout.first].ravel()
        return 0.5 * float(white @ white) + self.others.value(self.answer.joint.numbers, u)


SETTLED = 0.05
"""Change of alpha in prior standard deviations below which a step is the last."""
_HALVINGS = 6
"""Largest number of halvings of a step, before none is taken."""


def fit(
    problem: CalibrationProblem[CalibrationResult],
    data: Observation,
    start: Array,
    *,
    term: LinearObservations,
    method: str,
    times: Times | None = None,
    most: int = 6,
    covariance: Array | None = None,
    allowed: Callable[[Array], bool] = lambda end: True,
    settled: Callable[[GaussNewtonStep, Array], bool] | None = None,
) -> GaussNewtonFit:
    """Return the coefficients that fit measured data by a nonlinear model, in Gauss-Newton steps.

    Each step linearises the model at the present coefficients and solves the calibration. A step that
    raises the objective is halved, up to six times. If ``start`` satisfies the bounds and constraints,
    the objective at the end is at most that at the start.

    Parameters
    ----------
    problem : CalibrationProblem
        Calibration of one room whose objective has ``term``.
    data : Observation
        Measured values (n,) with their covariance and the model.
    start : array (n_materials, n_bands)
        Coefficients before the first step.
    term : LinearObservations
        Term of the objective that gets the data and the linearised model in each step.
    method : str
        Name of the method in the result.
    times : Measurement, or T in s, (n_bands,), optional
        Measured T for the other terms; None if these use no T.
    most : int
        Largest number of steps.
    covariance : array (n, n), optional
        Covariance of the data for the direction of the steps; by default that of ``data``, by which
        the objective is always calculated.
    allowed : function
        Function of coefficients that returns whether the fit may go there; everywhere by default.
    settled : function, optional
        Function of a step and the coefficients after it that returns whether the step is the last. By
        default a step is the last if no coefficient changes by 0.05 of its prior sigma or more.

    Raises
    ------
    InfeasibleError, SolverError
        For the reasons of `CalibrationProblem.solve`.
    """
    factor = np.asarray(np.linalg.cholesky(data.covariance))
    in_qp = data.covariance if covariance is None else covariance
    steps, last = list[GaussNewtonStep](), False
    while len(steps) < most and not last:
        left, matrix = data.values - data.predict(start), data.jacobian(start)
        observed = Observed(matrix=matrix, values=left + matrix @ start.ravel(), covariance=in_qp)
        answer = problem.solve(times, observed={term: observed}, method=method)
        objective = ModelObjective(answer, term, factor)
        now = objective.value(start, left)

        def worse(end: Array, objective: ModelObjective = objective, now: float = now) -> bool:
            try:
                off = data.values - data.predict(end)
            except (DataError, SimulatorError):
                return True
            return objective.value(end, off) > now or (np.isfinite(now) and not allowed(end))

        # The whole step counts: one that was shortened to little may be far from the minimum.
        sigma, moved = answer.prior.sigma, np.abs(answer.alpha - start)
        small = bool((moved[sigma > 0] < SETTLED * sigma[sigma > 0]).all())
        halvings = 0 if small and settled is None else _HALVINGS
        for share in (*0.5 ** np.arange(halvings + 1.0), 0.0):
            end = np.asarray(start + share * (answer.alpha - start))
            if not share or not worse(end):
                break
        step = GaussNewtonStep(start, matrix, float(share), answer)
        steps.append(step)
        last = small if settled is None else settled(step, end)
        start = end
        if not share:
            break
    return GaussNewtonFit(start, tuple(steps), last)
