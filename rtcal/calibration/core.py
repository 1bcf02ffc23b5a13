"""The compiled problem: filled with an instance's numbers, solved, polished and certified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.calibration import contradiction, feasibility, solvers
from rtcal.calibration.certificate import Certificate, certify
from rtcal.calibration.compiled import Compiled, Whitened
from rtcal.calibration.context import Context
from rtcal.calibration.instance import Flags, Instance
from rtcal.calibration.layout import Layout
from rtcal.calibration.polish import polish, undetermined
from rtcal.calibration.terms import Matching, Objective, RowConstraint
from rtcal.calibration.twin import Multipliers, Twin
from rtcal.calibration.warm_start import from_closed_form
from rtcal.errors import InfeasibleError, ModelError, SolverError
from rtcal.support.types import Array

_ACCEPTED = 1e-9
"""An answer whose certificate is worse than this is not returned: relative primal residual, and
dual residual and gap in units of the prior's own (a shift of one sigma is 1)."""


@dataclass(frozen=True, eq=False)
class RawAnswer:
    """The solver's own answer, before polishing, so that a solver can be judged.

    ``unknowns`` (size,); ``seconds`` is the solver's own time.
    """

    twin: Twin
    unknowns: Array
    multipliers: Multipliers
    status: str
    iterations: int
    seconds: float

    @property
    def alpha(self) -> Array:
        """The absorption coefficients, (n_materials, n_bands)."""
        return self.twin.instance.layout.expand(self.unknowns)

    @cached_property
    def certificate(self) -> Certificate:
        """The raw answer's own certificate."""
        return certify(self.twin, self.unknowns, self.multipliers)


@dataclass(frozen=True, eq=False)
class Solution:
    """An answer over the unknowns: their values, multipliers, and -1, 0, 1 for lower, free, upper."""

    twin: Twin
    unknowns: Array
    multipliers: Multipliers
    active: NDArray[np.int8]
    certificate: Certificate
    raw: RawAnswer
    polished: bool
    unreachable: tuple[feasibility.Unreachable, ...]

    @property
    def match_multipliers(self) -> Array:
        """D of the match, (n_configurations, n_bands) in 1/m²; NaN where nothing was matched."""
        instance = self.twin.instance
        start = 0
        for term in self.twin.row_constraints:
            n_rows = len(term.row_scale(instance))
            if isinstance(term, Matching):
                found = self.multipliers.rows[start : start + n_rows]
                return np.where(instance.matched, found.reshape(instance.matched.shape), np.nan)
            start += n_rows
        return np.full(instance.matched.shape, np.nan)


class Core:
    """An objective and row constraints, compiled for one layout."""

    def __init__(self, layout: Layout, objective: Objective, rows: Sequence[RowConstraint]) -> None:
        self.objective = objective
        self.rows = tuple(rows)
        self._matches = [row for row in self.rows if isinstance(row, Matching)]
        self._context = context = Context(layout)
        expressions = [t.expression(context, i) for i, t in enumerate(objective.terms)]
        row_constraints: list[Any] = []
        signs: list[tuple[int, ...]] = []
        for term in self.rows:
            made = term.constraints(context)
            row_constraints += [constraint for constraint, _ in made]
            signs.append(tuple(sign for _, sign in made))
        self._signs = tuple(signs)
        size, n = layout.size, layout.n_alpha
        scale = context.parameter(size, lambda i: i.scale)
        low = context.parameter(size, lambda i: i.lower - i.centre)
        high = context.parameter(n, lambda i: (i.upper - i.centre)[:n])
        moved = cp.multiply(scale, context.x)
        # Only alpha has an upper side: cvxpy takes no infinite limit.
        lower, upper = moved >= low, (moved[:n] if size > n else moved) <= high
        problem = cp.Problem(cp.Minimize(sum(expressions)), [*row_constraints, lower, upper])
        if not problem.is_dcp(dpp=True):
            raise ModelError(
                "the composed problem is not DPP: cvxpy would compile it anew for every solve. A "
                "term multiplies parameters, or divides by one; let it use the context's derived "
                "parameters"
            )
        self._compiled = Compiled(problem, context.x, tuple(row_constraints), lower, upper)

    def solve(
        self,
        instance: Instance,
        rooms: Sequence[Room],
        equation: LinearEquation,
        *,
        solver: str,
        unreachable: str,
        warm_start: str,
        settings: Mapping[str, Any] | None,
    ) -> Solution:
        """Solve for the instance's numbers.

        Raises
        ------
        InfeasibleError
            If a band cannot be reached, or the constraints contradict each other.
        SolverError
            If the solver's answer does not pass the certificate.
        """
        settled, at_lower, at_upper, beyond = self._settle(instance, rooms, equation, unreachable)
        # The ends are pinned for the solver only: twin and certificate see the problem as asked.
        asked = replace(instance, target=settled.target)
        twin = Twin(asked, self.objective, self.rows)
        self._context.update(settled)
        start = None
        if warm_start not in ("none", "closed_form"):
            raise ModelError(f'warm_start = {warm_start!r} is not "none" or "closed_form"')
        if warm_start == "closed_form":
            if not (len(self.rows) == 1 and len(self.objective.terms) == 1):
                raise ModelError(
                    "the closed form starts only a prior deviation with an exact match"
                )
            start = from_closed_form(settled)
        try:
            answer = solvers.run(self._compiled, solver, settings, start)
        except SolverError as error:
            contradiction.explain(twin)
            raise error
        u = settled.centre + settled.scale * answer.x
        raw = RawAnswer(
            twin=twin,
            unknowns=u,
            multipliers=self._multipliers(settled, twin, u, answer),
            status=answer.status,
            iterations=answer.iterations,
            seconds=answer.seconds,
        )
        unknowns, multipliers, certificate, active, polished = _polished(
            twin, raw, at_lower, at_upper
        )
        if not _passes(twin, unknowns, certificate):
            contradiction.explain(twin)
            raise SolverError(
                f'solver "{solver}" says {answer.status}, but its answer does not pass: primal '
                f"residual {np.max(certificate.primal_residual):.1e}, dual residual "
                f"{np.max(certificate.dual_residual):.1e}, gap {np.max(certificate.duality_gap):.1e}"
            )
        return Solution(
            twin, unknowns, multipliers, active, certificate, raw, polished, tuple(beyond)
        )

    def whitened(self, instance: Instance) -> Whitened:
        """Return the QP of the instance's numbers as they are, whether it has an answer or not."""
        self._context.update(instance)
        matrices = self._compiled.matrices()
        return Whitened(
            matrices, instance.centre, instance.scale, self._compiled.column, instance.layout
        )

    def _settle(
        self,
        instance: Instance,
        rooms: Sequence[Room],
        equation: LinearEquation,
        unreachable: str,
    ) -> tuple[Instance, Flags, Flags, tuple[feasibility.Unreachable, ...]]:
        matches = [row.wanted(instance) for row in self._matches]
        if not matches:
            lost = np.isfinite(instance.time) & ~np.isfinite(instance.target)
            if lost.any():
                row = int(np.flatnonzero(lost.ravel())[0])
                raise InfeasibleError(
                    f"T[{instance.layout.band_label(row)}] = {instance.time.ravel()[row]:.4g} s is "
                    "too short for any absorption"
                )
            nothing = np.zeros(instance.layout.size, dtype=bool)
            return instance, nothing, nothing, ()
        wanted = (
            np.max([low for low, _ in matches], axis=0),
            np.min([high for _, high in matches], axis=0),
        )
        return feasibility.settle(instance, rooms, wanted, equation, unreachable)

    def _multipliers(
        self, settled: Instance, twin: Twin, u: Array, answer: solvers.Answer
    ) -> Multipliers:
        """The solver's duals in the unknowns' units.

        A target at an end pins its coefficients before the solver runs. Those multipliers the
        solver is never asked for: they follow from stationarity.
        """
        duals = iter(answer.row_duals)
        scales = [term.row_scale(settled) for term in self.rows]
        rows = [
            sum(sign * next(duals) for sign in signs) * scale
            for scale, signs in zip(scales, self._signs, strict=True)
        ]
        row_values = np.concatenate(rows) if rows else np.zeros(0)
        lower, upper = answer.lower_dual, np.zeros_like(answer.lower_dual)
        upper[: len(answer.upper_dual)] = answer.upper_dual
        ends = twin.movable & (settled.scale == 0)
        if ends.any():
            at_lower, at_upper = ends & (u == twin.lower), ends & (u == twin.upper)
            starved = (np.concatenate([*scales, np.zeros(0)]) == 0) & (twin.row_norm > 0)
            row_values = undetermined(twin, u, row_values, starved, at_lower, at_upper)
            force = twin.stationarity(u, row_values)
            lower = np.where(at_lower, np.maximum(force, 0.0), lower)
            upper = np.where(at_upper, np.maximum(-force, 0.0), upper)
        return Multipliers(row_values, lower, upper)


def _passes(twin: Twin, u: Array, certificate: Certificate) -> bool:
    """Whether an answer is optimal to `_ACCEPTED`, relative to how steep the objective is there.

    A soft match with a tiny u_b has a gradient that is the difference of huge numbers: it is known
    to eps |H| |u| only, which is then allowed too.
    """
    if certificate.worst <= _ACCEPTED:
        return True
    steepness = 1 + float(np.max(np.abs(twin.sigma * twin.gradient(u)), initial=0.0))
    curvature, size = abs(twin.curvature(u)), np.abs(u)
    terms = curvature @ size if sp.issparse(curvature) else curvature * size
    rounding = 16 * np.finfo(float).eps * float(np.max(twin.sigma * terms, initial=0.0))
    return bool(
        np.max(certificate.primal_residual) <= _ACCEPTED
        and np.max(certificate.dual_residual) <= _ACCEPTED * steepness + rounding
        and np.max(certificate.duality_gap) <= _ACCEPTED * steepness
    )


def _polished(
    twin: Twin, raw: RawAnswer, at_lower: Flags, at_upper: Flags
) -> tuple[Array, Multipliers, Certificate, NDArray[np.int8], bool]:
    """The polished answer where it is better than the raw one, else the raw one."""
    found = polish(twin, raw.unknowns, raw.multipliers, at_lower, at_upper)
    if found is not None:
        certificate = certify(twin, found.alpha, found.multipliers)
        if _passes(twin, found.alpha, certificate) or certificate.worst <= raw.certificate.worst:
            return found.alpha, found.multipliers, certificate, found.active, True
    near = 1e-9
    active = (twin.movable & (raw.unknowns >= twin.upper - near)).astype(np.int8)
    active -= (twin.movable & (raw.unknowns <= twin.lower + near)).astype(np.int8)
    return raw.unknowns, raw.multipliers, raw.certificate, active, False
