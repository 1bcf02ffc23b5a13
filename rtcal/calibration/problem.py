"""`Calibration` says what is wanted, `build` compiles it once, `solve` fills in numbers and solves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import Equation, Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.calibration import feasibility, solvers
from rtcal.calibration.certificate import Certificate, certify
from rtcal.calibration.compiled import Compiled
from rtcal.calibration.context import Context
from rtcal.calibration.instance import Flags, Instance
from rtcal.calibration.measured import Measured, refuse_twice, times_in_room
from rtcal.calibration.polish import polish
from rtcal.calibration.result import CalibrationResult, RawAnswer
from rtcal.calibration.terms import (
    BoundConstraint,
    ExactMatch,
    Objective,
    ObjectiveTerm,
    PriorDeviation,
    RowConstraint,
    as_objective,
)
from rtcal.calibration.twin import Multipliers, Twin
from rtcal.calibration.warm_start import from_closed_form
from rtcal.errors import DataError, ModelError, SolverError
from rtcal.types import Array

_ACCEPTED = 1e-9
"""An answer whose certificate is worse than this is not returned: relative primal residual, and
dual residual and gap in units of the prior's own (a shift of one sigma is 1)."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is wanted: an objective and constraints, not yet tied to a room.

    Parameters
    ----------
    objective : term or sum of terms
        It holds a `rtcal.terms.PriorDeviation`, which makes the answer unique.
    constraints : sequence
        Constraints of `rtcal.terms`.

    Raises
    ------
    ModelError
        If there is no prior deviation, more than one, or something that is no term.
    """

    objective: ObjectiveTerm | Objective
    constraints: Sequence[RowConstraint | BoundConstraint] = (ExactMatch(),)

    def __post_init__(self) -> None:
        objective = as_objective(self.objective)
        priors = [t for t in objective.terms if isinstance(t, PriorDeviation)]
        if len(priors) != 1:
            raise ModelError(
                f"the objective has {len(priors)} prior deviations; it needs one: without it the "
                "answer is not unique"
            )
        if objective.weights[objective.terms.index(priors[0])] == 0:
            raise ModelError(
                "the prior deviation has weight 0; without it the answer is not unique"
            )
        for constraint in self.constraints:
            if not isinstance(constraint, (RowConstraint, BoundConstraint)):
                raise ModelError(f"{constraint!r} is no constraint of rtcal.terms")
        object.__setattr__(self, "objective", objective)
        object.__setattr__(self, "constraints", tuple(self.constraints))

    def build(self, room: Room, equation: Equation | None = None) -> CalibrationProblem:
        """Compile the calibration for rooms of this shape.

        Raises
        ------
        ModelError
            If the problem is not DPP (then every solve would compile anew), or the equation is
            not a function of the mean absorption coefficient.
        """
        return CalibrationProblem(self, room, equation or Eyring())


class CalibrationProblem:
    """A calibration that is compiled for a room's shape: solve it for many measurements."""

    def __init__(self, calibration: Calibration, room: Room, equation: Equation) -> None:
        if not isinstance(equation, LinearEquation):
            raise ModelError(
                f"{equation.name} is not a function of the mean absorption coefficient, so it gives "
                "no linear target; calibrate it in the closed loop with calibrate_simulator"
            )
        self.room = room
        self.equation = equation
        objective = as_objective(calibration.objective)
        self._objective = objective
        self._prior, prior = next(
            (i, t) for i, t in enumerate(objective.terms) if isinstance(t, PriorDeviation)
        )
        self._sigma = prior.sigma
        rows: list[RowConstraint] = []
        self._boxes: list[BoundConstraint] = []
        for constraint in calibration.constraints:
            if isinstance(constraint, RowConstraint):
                rows.append(constraint)
            else:
                self._boxes.append(constraint)
        self._rows = tuple(rows)
        self._exact = any(isinstance(r, ExactMatch) for r in rows)
        self._context = Context(1, room.n_materials, room.n_bands)
        self._compiled, self._signs = self._compile()

    def _compile(self) -> tuple[Compiled, tuple[tuple[int, ...], ...]]:
        context = self._context
        size = context.size
        expressions = [t.expression(context, i) for i, t in enumerate(self._objective.terms)]
        row_constraints: list[Any] = []
        signs: list[tuple[int, ...]] = []
        for term in self._rows:
            made = term.constraints(context)
            row_constraints += [constraint for constraint, _ in made]
            signs.append(tuple(sign for _, sign in made))
        scale = context.parameter(size, lambda i: i.scale.ravel())
        low = context.parameter(size, lambda i: (i.lower - i.centre).ravel())
        high = context.parameter(size, lambda i: (i.upper - i.centre).ravel())
        moved = cp.multiply(scale, context.x)
        lower, upper = moved >= low, moved <= high
        problem = cp.Problem(cp.Minimize(sum(expressions)), [*row_constraints, lower, upper])
        if not problem.is_dcp(dpp=True):
            raise ModelError(
                "the composed problem is not DPP: cvxpy would compile it anew for every solve. A "
                "term multiplies parameters, or divides by one; let it use the context's derived "
                "parameters"
            )
        compiled = Compiled(problem, context.x, tuple(row_constraints), lower, upper)
        return compiled, tuple(signs)

    def solve(
        self,
        measured: Measurement | Sequence[float] | Array,
        room: Room | None = None,
        weights: Mapping[ObjectiveTerm, float] | None = None,
        *,
        solver: str = "clarabel",
        unreachable: Literal["raise", "nearest"] = "raise",
        warm_start: Literal["none", "closed_form"] = "none",
        settings: Mapping[str, Any] | None = None,
        method: str = "composed",
    ) -> CalibrationResult:
        """Solve for one measurement, without compiling again.

        Parameters
        ----------
        measured : Measurement, or T in s, (n_bands,)
            NaN where missing: that band keeps its prior.
        room : Room, optional
            Other numbers for the same materials and bands; the room built with if not given.
        weights : mapping of objective term to weight, optional
            In place of those built with.
        solver : str
            A solver of cvxpy's, or ``"qpsolvers:NAME"``.
        unreachable : {"raise", "nearest"}
            What to do where no coefficients within the bounds give T: raise, or take the nearest
            end and say so.
        warm_start : {"none", "closed_form"}
            Start OSQP from the paper's closed form, primal and dual. Clarabel has no warm start.
        settings : mapping, optional
            The solver's own settings.
        method : str
            The name that the result carries.

        Raises
        ------
        DataError
            If the measurement or the room does not fit.
        InfeasibleError
            If a band cannot be reached, with ``unreachable="raise"``.
        SolverError
            If the solver's answer does not pass the certificate.
        """
        if unreachable not in ("raise", "nearest"):
            raise DataError(f'unreachable = "{unreachable}" is not "raise" or "nearest"')
        room = self._fitting(room)
        data = times_in_room(room, measured)
        refuse_twice(room, data)
        instance = self._instance(room, data, weights)
        nothing = np.zeros(instance.mu.shape, dtype=bool)
        at_lower, at_upper = nothing, nothing
        beyond: tuple[feasibility.Unreachable, ...] = ()
        settled = instance
        if self._exact:
            settled, at_lower, at_upper, beyond = feasibility.settle(
                instance, (room,), data.reverberation_time[np.newaxis], self.equation, unreachable
            )
        self._context.update(settled)
        start = None
        if warm_start == "closed_form":
            if not (self._exact and len(self._rows) == 1 and len(self._objective.terms) == 1):
                raise ModelError(
                    "the closed form starts only a prior deviation with an exact match"
                )
            start = from_closed_form(settled)
        answer = solvers.run(self._compiled, solver, settings, start)
        raw_alpha = settled.centre + settled.scale * answer.x.reshape(instance.mu.shape)
        multipliers = self._multipliers(settled, answer)
        # The ends are pinned for the solver only: twin and certificate see the problem as asked.
        asked = replace(instance, target=settled.target)
        twin = Twin(asked, self._objective, self._rows)
        raw = RawAnswer(
            twin=twin,
            alpha=raw_alpha,
            multipliers=multipliers,
            status=answer.status,
            iterations=answer.iterations,
            seconds=answer.seconds,
        )
        alpha, multipliers, certificate, active, polished = _polished(
            twin, raw, at_lower.ravel(), at_upper.ravel()
        )
        if not certificate.worst <= _ACCEPTED:
            raise SolverError(
                f'solver "{solver}" says {answer.status}, but its answer does not pass: primal '
                f"residual {np.max(certificate.primal_residual):.1e}, dual residual "
                f"{np.max(certificate.dual_residual):.1e}, gap {np.max(certificate.duality_gap):.1e}"
            )
        return CalibrationResult(
            prior=room,
            equation=self.equation,
            method=method,
            solver=solver,
            measured_data=data,
            alpha=alpha,
            target=asked.target[0],
            target_uncertainty=asked.target_uncertainty[0],
            gain_sigma=instance.sigma,
            multipliers=self._reported(multipliers, instance),
            active=active,
            certificate=certificate,
            raw=raw,
            polished=polished,
            unreachable=beyond,
        )

    def _fitting(self, room: Room | None) -> Room:
        if room is None:
            return self.room
        if room.materials != self.room.materials:
            raise DataError(
                f"room has materials {room.materials}; built with {self.room.materials}"
            )
        if not np.array_equal(room.centre_frequencies, self.room.centre_frequencies):
            raise DataError("room has other bands than the one that the problem was built with")
        return room

    def _instance(
        self, room: Room, data: Measured, weights: Mapping[ObjectiveTerm, float] | None
    ) -> Instance:
        shape = room.alpha.shape
        sigma = room.sigma if self._sigma is None else np.full(shape, self._sigma)
        lower = np.zeros(shape) if room.alpha_min is None else room.alpha_min
        upper = np.ones(shape)
        for box in self._boxes:
            lower, upper = box.box(room, lower, upper)
        outside = (room.alpha < lower) | (room.alpha > upper)
        for bad, rule in (
            (lower > upper, "the bounds contradict each other"),
            (outside & (sigma == 0), "sigma is 0, but alpha is outside its bounds"),
        ):
            if bad.any():
                i, k = (int(v) for v in np.argwhere(bad)[0])
                raise DataError(
                    f"{room.place('alpha', i, k)} = {room.alpha[i, k]:g}, bounds {lower[i, k]:g} "
                    f"to {upper[i, k]:g}: {rule}"
                )
        target = self.equation.target(room, data.reverberation_time)
        slope = self.equation.target_sensitivity(room, data.reverberation_time)
        chosen = list(self._objective.weights)
        for term, weight in (weights or {}).items():
            if term not in self._objective.terms:
                raise DataError(f"weights has {term!r}, which is no term of the objective")
            if not (np.isfinite(weight) and weight >= 0):
                raise DataError(f"weights[{term!r}] = {weight:g} is not finite and 0 or more")
            chosen[self._objective.terms.index(term)] = float(weight)
        prior = chosen[self._prior]
        if prior == 0:
            raise DataError("the prior deviation has weight 0; the answer would not be unique")
        return Instance(
            mu=room.alpha,
            sigma=np.asarray(sigma),
            lower=lower,
            upper=upper,
            areas=room.areas[np.newaxis],
            target=target[np.newaxis],
            target_uncertainty=(np.abs(slope) * data.uncertainty)[np.newaxis],
            # Scaled so that the prior's weight is 1, which changes no answer.
            weights=tuple(w / prior for w in chosen),
            pinned=sigma == 0,
            centre=room.alpha,
        )

    def _multipliers(self, instance: Instance, answer: solvers.Answer) -> Multipliers:
        """The solver's duals in alpha's units."""
        duals = iter(answer.row_duals)
        rows = [
            sum(sign * next(duals) for sign in signs) * term.row_scale(instance)
            for term, signs in zip(self._rows, self._signs, strict=True)
        ]
        return Multipliers(
            np.concatenate(rows) if rows else np.zeros(0), answer.lower_dual, answer.upper_dual
        )

    def _reported(self, multipliers: Multipliers, instance: Instance) -> Array:
        """The multiplier D of the exact match per band; NaN where nothing was matched."""
        start = 0
        for term in self._rows:
            n_rows = len(term.row_scale(instance))
            if isinstance(term, ExactMatch):
                found = multipliers.rows[start : start + n_rows]
                return np.where(instance.matched.ravel(), found, np.nan)
            start += n_rows
        return np.full(instance.mu.shape[1], np.nan)


def _polished(
    twin: Twin, raw: RawAnswer, at_lower: Flags, at_upper: Flags
) -> tuple[Array, Multipliers, Certificate, NDArray[np.int8], bool]:
    """The polished answer where it is better than the raw one, else the raw one."""
    shape = raw.alpha.shape
    found = polish(twin, raw.alpha.ravel(), raw.multipliers, at_lower, at_upper)
    if found is not None:
        alpha = found.alpha.reshape(shape)
        certificate = certify(twin, alpha, found.multipliers, 1.0)
        if certificate.worst <= _ACCEPTED or certificate.worst <= raw.certificate.worst:
            return alpha, found.multipliers, certificate, found.active.reshape(shape), True
    near = 1e-9
    active = (raw.alpha >= twin.instance.upper - near).astype(np.int8)
    active -= (raw.alpha <= twin.instance.lower + near).astype(np.int8)
    return raw.alpha, raw.multipliers, raw.certificate, active, False
