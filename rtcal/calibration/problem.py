"""`Calibration` states a problem, `build` compiles it once, `solve` solves it for a measurement."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Unpack, overload

from rtcal.acoustics.equations import Equation, Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.repeats import refuse_repeated_data
from rtcal.acoustics.room import Room
from rtcal.calibration.compiled_qp import WhitenedQP
from rtcal.calibration.configurations import (
    Assembler,
    Configurations,
    layout_of,
    require_same_shape,
)
from rtcal.calibration.convex_program import ConvexProgram
from rtcal.calibration.layout import Layout
from rtcal.calibration.problem_data import MeasuredTimes, no_times, times_in_room
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.solvers import SolveKeywords, SolveOptions
from rtcal.calibration.terms import (
    BoundConstraint,
    ExactMatch,
    LinearObservations,
    Objective,
    ObjectiveTerm,
    Observed,
    RowConstraint,
    SharedMaterials,
    SoftMatch,
    as_objective,
    lacking,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, InfeasibleError, MissingAirWarning, ModelError
from rtcal.support.types import Array

Constraint = RowConstraint | BoundConstraint | SharedMaterials
Times = Measurement | Sequence[float] | Array


_MOST_PAIRS = 20_000_000
"""Largest number of curvature entries of linear observations. Polishing holds six copies of them; at
12 bytes each these take 1.5 GB."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """An objective and constraints, not yet tied to a room.

    Parameters
    ----------
    objective : term or sum of terms
        It holds one prior (`rtcal.terms.PriorDeviation` or `rtcal.terms.HuberDeviation`), which
        makes the answer unique.
    constraints : sequence, optional
        Constraints of `rtcal.terms`. If not given, `ExactMatch`, unless the objective has a
        `SoftMatch`, which an exact match would make useless.

    Raises
    ------
    ModelError
        If there is no prior or more than one, if a term lacks a method, or if a term occurs twice.
    """

    objective: ObjectiveTerm | Objective
    constraints: Sequence[Constraint] | None = None

    def __post_init__(self) -> None:
        _refuse_classes([self.objective])
        objective = as_objective(self.objective)
        _refuse_classes(objective.terms)
        priors = [t for t in objective.terms if t.is_prior]
        if len(priors) != 1:
            raise ModelError(
                f"the objective has {len(priors)} prior deviations; it needs one: without it the "
                "answer is not unique"
            )
        _refuse_repeated(objective.terms, "objective")
        if sum(isinstance(t, SoftMatch) for t in objective.terms) > 1:
            raise ModelError("the objective has two soft matches; T has one uncertainty per band")
        if objective.weights[objective.terms.index(priors[0])] == 0:
            raise ModelError(
                "the prior deviation has weight 0; without it the answer is not unique"
            )
        constraints = self.constraints
        if constraints is None:
            soft = any(isinstance(t, SoftMatch) for t in objective.terms)
            constraints = () if soft else (ExactMatch(),)
        if not isinstance(constraints, Iterable):
            raise ModelError(f"constraints = {constraints!r} is not a list of constraints")
        _refuse_classes(constraints)
        for constraint in constraints:
            if not isinstance(constraint, (RowConstraint, BoundConstraint, SharedMaterials)):
                raise ModelError(
                    f"{constraint!r} is no constraint of rtcal.terms"
                    f"{lacking(constraint, RowConstraint, BoundConstraint, SharedMaterials)}"
                )
        _refuse_repeated(tuple(constraints), "constraints")
        object.__setattr__(self, "objective", objective)
        object.__setattr__(self, "constraints", tuple(constraints))

    @overload
    def build(self, room: Room, equation: Equation | None = None) -> CalibrationProblem: ...

    @overload
    def build(self, room: Configurations, equation: Equation | None = None) -> JointProblem: ...

    def build(
        self, room: Room | Configurations, equation: Equation | None = None
    ) -> CalibrationProblem | JointProblem:
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
        if not isinstance(room, Room | Configurations):
            raise DataError(f"room = {room!r} is not a rtcal.Room, nor Configurations of one")
        rooms = [room] if isinstance(room, Room) else room.rooms
        if airless := [r.name for r in rooms if r.air is None]:
            warnings.warn(
                f'room "{airless[0]}" states no air: its surfaces are made to absorb what the air '
                "does. Give it air=rtcal.Air(temperature, humidity)",
                MissingAirWarning,
                stacklevel=checks.stack_level(),
            )
        if isinstance(room, Configurations):
            return JointProblem(self, room, Eyring() if equation is None else equation)
        return CalibrationProblem(self, room, Eyring() if equation is None else equation)


def _refuse_classes(terms: Iterable[object]) -> None:
    for term in terms:
        if isinstance(term, type):
            raise ModelError(f"{term.__name__} is a class and no term: write {term.__name__}()")


def _refuse_repeated(terms: Sequence[object], place: str) -> None:
    """Raise ModelError for a term that occurs twice: ``weights`` could not distinguish the two."""
    for i, term in enumerate(terms):
        if any(term == other for other in terms[:i]):
            raise ModelError(f"{place}: {term!r} stands there twice; give it once")


def _compiled(
    calibration: Calibration, configurations: Configurations, equation: Equation
) -> tuple[Assembler, ConvexProgram]:
    checks.instance("calibration", calibration, Calibration)
    checks.instance("configurations", configurations, Configurations)
    if not isinstance(equation, LinearEquation):
        if not isinstance(equation, Equation) or isinstance(equation, type):
            raise ModelError(f"equation = {equation!r} is not an equation such as rtcal.Eyring()")
        raise ModelError(
            f"{equation.name} is not a function of the mean absorption coefficient, so it gives "
            "no linear target; calibrate it in the closed loop with calibrate_simulator"
        )
    objective = as_objective(calibration.objective)
    constraints = calibration.constraints or ()
    rows = [c for c in constraints if isinstance(c, RowConstraint)]
    boxes = [c for c in constraints if isinstance(c, BoundConstraint)]
    shared = [c for c in constraints if isinstance(c, SharedMaterials)]
    layout = layout_of(configurations, objective, shared)
    _refuse_too_large(layout, objective)
    place, prior = next((i, t) for i, t in enumerate(objective.terms) if t.is_prior)
    sigma: float | None = getattr(prior, "sigma", None)
    assembler = Assembler(layout, equation, objective, tuple(boxes), place, sigma)
    return assembler, ConvexProgram(layout, objective, rows)


def _refuse_too_large(layout: Layout, objective: Objective) -> None:
    """Raise ModelError if linear observations would not fit into memory."""
    pairs = layout.n_alpha**2
    if pairs > _MOST_PAIRS and any(isinstance(t, LinearObservations) for t in objective.terms):
        raise ModelError(
            f"LinearObservations couple every two of {layout.n_rows} materials in {layout.n_bands} "
            f"bands: {pairs:.2g} pairs, and at most {_MOST_PAIRS:.2g} fit. Merge materials, use fewer "
            "bands, or match T alone"
        )


def _measured_times(
    configurations: Configurations, measured: Sequence[Times | None]
) -> list[MeasuredTimes]:
    """One measurement per configuration, each in its room's bands."""
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


class CalibrationProblem:
    """A calibration that is compiled for a room's shape: solve it for many measurements."""

    def __init__(self, calibration: Calibration, room: Room, equation: Equation) -> None:
        self.room = room
        self.equation = equation
        self._joint = JointProblem(calibration, Configurations([room]), equation)

    def __repr__(self) -> str:
        return f"<CalibrationProblem with {self.equation.name}'s equation for {self.room!r}>"

    def solve(
        self,
        measured: Times | None,
        room: Room | None = None,
        weights: Mapping[ObjectiveTerm, float] | None = None,
        *,
        observed: Mapping[LinearObservations, Observed] | None = None,
        method: str = "composed",
        **options: Unpack[SolveKeywords],
    ) -> CalibrationResult:
        """Solve for one measurement, without compiling again.

        Parameters
        ----------
        measured : Measurement, or T in s, (n_bands,), or None
            A band with NaN keeps its prior. None if no T was measured.
        room : Room, optional
            Other numbers for the same materials and bands; by default the room built with.
        weights : mapping of objective term to weight, optional
            In place of the weights built with.
        observed : mapping of `rtcal.terms.LinearObservations` to `rtcal.terms.Observed`, optional
            The numbers of each such term.
        method : str
            The name that the result carries.
        **options
            ``solver``, ``unreachable``, ``warm_start`` and ``settings``; see
            `rtcal.calibration.solvers.SolveOptions`.

        Raises
        ------
        DataError
            If the measurement or the room does not fit.
        InfeasibleError
            If a band cannot be reached, with ``unreachable="raise"``, or the constraints contradict
            each other: then the message names the smallest relaxation that removes it.
        SolverError
            If the solver's answer does not pass the certificate.
        """
        room = self.room if room is None else room
        return self._joint.solve(
            [measured],
            Configurations([room]),
            weights,
            observed=observed,
            method=method,
            **options,
        ).results[0]

    def whitened(self, measured: Times, room: Room | None = None) -> WhitenedQP:
        """Return the QP of one measurement, as `JointProblem.whitened` does."""
        rooms = Configurations([self.room if room is None else room])
        return self._joint.whitened([measured], rooms)


class JointProblem:
    """A calibration that is compiled for several configurations of one room."""

    def __init__(
        self, calibration: Calibration, configurations: Configurations, equation: Equation
    ) -> None:
        self.configurations = configurations
        self.equation = equation
        self._assembler, self._program = _compiled(calibration, configurations, equation)

    def __repr__(self) -> str:
        return f"<JointProblem with {self.equation.name}'s equation for {self.configurations!r}>"

    def solve(
        self,
        measured: Sequence[Times | None],
        configurations: Configurations | None = None,
        weights: Mapping[ObjectiveTerm, float] | None = None,
        *,
        observed: Mapping[LinearObservations, Observed] | None = None,
        method: str = "composed",
        **options: Unpack[SolveKeywords],
    ) -> JointResult:
        """Solve for one measurement per configuration, without compiling again.

        Parameters and errors as in `CalibrationProblem.solve`; ``measured`` and ``configurations``
        have one entry per configuration.
        """
        chosen = SolveOptions(**options)
        used = self.configurations
        if configurations is not None:
            used = require_same_shape(self.configurations, configurations)
        times = _measured_times(used, measured)
        for room, of_room in zip(used.rooms, times, strict=True):
            refuse_repeated_data(room, of_room.fingerprint)
        assembler = self._assembler
        data = assembler.problem_data(used, times, weights, observed)
        try:
            solution = self._program.solve(data, used.rooms, assembler.equation, chosen)
        except InfeasibleError as error:
            mistyped = [e for of_room in times for e in of_room.mistyped]
            if mistyped:
                error.args = (f"{mistyped[0].sentence}. {error}",)
            raise
        return JointResult(
            configurations=used,
            solution=solution,
            equation=assembler.equation,
            method=method,
            solver=chosen.solver,
            measured_times=tuple(times),
            assembler=assembler,
            weights=weights,
            observed=observed,
        )

    def whitened(
        self, measured: Sequence[Times], configurations: Configurations | None = None
    ) -> WhitenedQP:
        """Return the QP of the measurements, unsolved and unchecked: it may have no answer.

        minimise ½ x'Px + q'x  subject to  A x = b (the first n_equal rows), A x <= b (the others);
        x = (alpha - mu) / sigma. It serves to compare another solver with `solve`.

        Raises
        ------
        DataError
            If a measurement or a room does not fit.
        """
        used = self.configurations
        if configurations is not None:
            used = require_same_shape(self.configurations, configurations)
        times = _measured_times(used, measured)
        return self._program.whitened(self._assembler.problem_data(used, times, None))
