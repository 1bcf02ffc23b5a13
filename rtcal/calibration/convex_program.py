"""The compiled problem: filled with a problem's data, solved, polished and certified.

Where the solver fails, the exact dual of a separable problem (`rtcal.calibration.optimum`) answers.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.calibration import feasibility, solvers
from rtcal.calibration.certificate import Certificate, certify
from rtcal.calibration.compiled_qp import CompiledQP, Context, WhitenedQP, from_closed_form
from rtcal.calibration.layout import Layout
from rtcal.calibration.numpy_model import Multipliers, NumpyModel, require_agreement
from rtcal.calibration.optimum import dual_solution, polish_answer, undetermined
from rtcal.calibration.problem_data import Flags, ProblemData
from rtcal.calibration.solvers import SolveOptions
from rtcal.calibration.terms import (
    HuberDeviation,
    LinearObservations,
    MatchConstraint,
    Objective,
    ObjectiveTerm,
    RowConstraint,
)
from rtcal.calibration.terms.base import BaseTerm
from rtcal.support.errors import InfeasibleError, ModelError, SolverError
from rtcal.support.types import Array

_ACCEPTED = 1e-9
"""Largest residual of an answer that is returned. The primal residual is relative. In the dual residual
and the gap, a shift of one sigma counts as 1."""


_FAR = 1e-3
"""Shift by polishing in sigmas above which the terms are checked: solvers' errors are smaller."""


@dataclass(frozen=True, eq=False, repr=False)
class RawSolution:
    """The solver's answer before polishing, to compare solvers.

    ``unknowns`` (size,); ``seconds`` is the solver's own time; ``settings`` are those that it ran with,
    beside its defaults.
    """

    model: NumpyModel
    unknowns: Array
    multipliers: Multipliers
    status: str
    iterations: int
    seconds: float
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def alpha(self) -> Array:
        """The absorption coefficients, (n_materials, n_bands)."""
        return self.model.data.layout.expand(self.unknowns)

    @cached_property
    def certificate(self) -> Certificate:
        """The certificate of the raw answer."""
        return certify(self.model, self.unknowns, self.multipliers)

    def __repr__(self) -> str:
        return (
            f"<RawSolution: {len(self.unknowns)} unknowns, status {self.status}, "
            f"{self.iterations} iterations>"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """An answer over the unknowns: their values, multipliers, and -1, 0, 1 for lower, free, upper."""

    model: NumpyModel
    unknowns: Array
    multipliers: Multipliers
    active: NDArray[np.int8]
    certificate: Certificate
    raw: RawSolution
    polished: bool
    unreachable: tuple[feasibility.Unreachable, ...]

    @property
    def match_multipliers(self) -> Array:
        """D of the match, (n_configurations, n_bands) in 1/m²; NaN where nothing was matched."""
        data = self.model.data
        start = 0
        for term in self.model.row_constraints:
            n_rows = len(term.row_scale(data))
            if isinstance(term, MatchConstraint):
                of_match = self.multipliers.rows[start : start + n_rows]
                return np.where(data.matched, of_match.reshape(data.matched.shape), np.nan)
            start += n_rows
        return np.full(data.matched.shape, np.nan)

    def __repr__(self) -> str:
        return (
            f"<Solution: {len(self.unknowns)} unknowns, {np.count_nonzero(self.active)} at a bound, "
            f"{self.certificate!r}>"
        )


class _Compilation:
    """The terms' cvxpy problem for one layout, compiled when it is first solved.

    It holds one set of numbers, so only one thread at a time may use it: the one that holds ``lock``.
    """

    def __init__(
        self, layout: Layout, terms: Sequence[ObjectiveTerm], rows: Sequence[RowConstraint]
    ) -> None:
        self.lock = threading.RLock()
        self.context = context = Context(layout)
        self.expressions = [t.expression(context, i) for i, t in enumerate(terms)]
        parts = [term.constraints(context) for term in rows]
        self.constraints = [[constraint for constraint, _ in of_term] for of_term in parts]
        self.signs = [[sign for _, sign in of_term] for of_term in parts]
        row_constraints = [constraint for of_term in self.constraints for constraint in of_term]
        size, n = layout.size, layout.n_alpha
        low = context.parameter(size, lambda i: i.lower - i.centre)
        high = context.parameter(n, lambda i: (i.upper - i.centre)[:n])
        moved = context.multiply(context.x, lambda i: i.scale)
        # Only alpha has an upper side: cvxpy takes no infinite limit.
        lower, upper = moved >= low, (moved[:n] if size > n else moved) <= high
        problem = cp.Problem(cp.Minimize(sum(self.expressions)), [*row_constraints, lower, upper])
        if not problem.is_dcp(dpp=True):
            raise ModelError(
                "the composed problem is not DPP: cvxpy would compile it anew for every solve. A "
                "term multiplies parameters, or divides by one; let it use the context's derived "
                "parameters"
            )
        self.qp = CompiledQP(problem, context.x, tuple(row_constraints), lower, upper)


_KEPT = 16
"""Number of compiled problems that are kept; the one not used for longest is forgotten."""
_LARGEST_KEPT = 1_000_000
"""Largest number of coefficients of a problem that is kept: it takes some 100 MB."""
_kept = functools.lru_cache(_KEPT)(_Compilation)
_keeping = threading.Lock()


def forget() -> None:
    """Forget the compiled problems that later calibrations of equal shape would use again.

    A problem that was built before keeps its own.

    Examples
    --------
    >>> import rtcal as rt
    >>> rt.calibration.forget()
    """
    _kept.cache_clear()


def _forget_after_fork() -> None:
    """Forget what another thread of the parent process may hold at that moment."""
    global _keeping
    _keeping = threading.Lock()
    forget()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget_after_fork)


def _compilation(
    layout: Layout, objective: Objective, rows: Sequence[RowConstraint]
) -> _Compilation:
    """Return the compiled problem of these terms, an earlier one if nothing it depends on differs."""
    terms = tuple(t.compiled_as() if isinstance(t, BaseTerm) else t for t in objective.terms)
    coupled = any(isinstance(t, LinearObservations) for t in terms)
    size = layout.n_alpha**2 if coupled else layout.size
    if size > _LARGEST_KEPT or not all(_unchanging(t) for t in (*terms, *rows)):
        return _Compilation(layout, terms, rows)
    with _keeping:  # two threads that ask at once share one
        return _kept(layout, terms, tuple(rows))


def _unchanging(term: object) -> bool:
    """Whether a term is told by its values: a frozen dataclass of hashable ones."""
    parameters = vars(type(term)).get("__dataclass_params__")
    if parameters is None or not (parameters.frozen and parameters.eq):
        return False
    try:
        hash(term)
    except TypeError:
        return False
    return True


class ConvexProgram:
    """An objective and row constraints, compiled for one layout."""

    def __init__(self, layout: Layout, objective: Objective, rows: Sequence[RowConstraint]) -> None:
        self.objective = objective
        self.rows = tuple(rows)
        self._matches = [row for row in self.rows if isinstance(row, MatchConstraint)]
        self._compilation = _compilation(layout, objective, self.rows)

    def solve(
        self,
        data: ProblemData,
        rooms: Sequence[Room],
        equation: LinearEquation,
        options: SolveOptions,
    ) -> Solution:
        """Solve the problem for its data.

        Raises
        ------
        InfeasibleError
            If a band cannot be reached, or the constraints contradict each other.
        SolverError
            If the solver's answer does not pass the certificate.
        TermError
            If that is because a term's NumPy description disagrees with its cvxpy expression.
        """
        reachable, at_lower, at_upper, beyond = self._within_reach(
            data, rooms, equation, options.unreachable
        )
        # Coefficients at an end are pinned only for the solver; the certificate judges the original
        # problem.
        if reachable is not data:
            data = replace(data, target=reachable.target)
        model = NumpyModel(data, self.objective, self.rows)
        for tried in _attempts(model, options):
            try:
                raw = self._solver_answer(model, reachable, tried)
            except SolverError as error:
                failure = str(error)
                continue
            solution = _polished(model, raw, at_lower, at_upper)
            failure = _failure(solution, options.solver)
            if failure:
                continue
            moved = np.abs(solution.unknowns - raw.unknowns) > _FAR * model.sigma
            far = bool((moved & model.movable).any())
            if tried is options and far:
                self._require_agreement(reachable)
            if tried is options or (solution.polished and not far):
                return replace(solution, unreachable=beyond) if beyond else solution
        feasibility.explain(model)
        self._require_agreement(reachable)
        if options == SolveOptions(unreachable=options.unreachable):
            dual = _dual_answer(model, failure)
            if dual is not None:
                solution = _polished(model, dual, at_lower, at_upper)
                if not _failure(solution, options.solver):
                    return replace(solution, unreachable=tuple(beyond))
        raise SolverError(failure)

    def _solver_answer(
        self, model: NumpyModel, data: ProblemData, options: SolveOptions
    ) -> RawSolution:
        """Fill the compiled problem with the data, solve it and read the answer."""
        start = None
        if options.takes_start and options.warm_start != "none":
            # OSQP does not check the sizes of a start: another problem's would be read beyond its end.
            if model.has_closed_form:
                start = from_closed_form(data)
            elif options.warm_start == "closed_form":
                raise ModelError(
                    "the closed form starts only an independent prior deviation with an exact "
                    "match, in one configuration"
                )
        compilation = self._compilation
        with compilation.lock:
            compilation.context.update(data)
            output = solvers.run(compilation.qp, options, start)
        u = data.centre + data.scale * output.x
        return RawSolution(
            model=model,
            unknowns=u,
            multipliers=self._multipliers(data, model, u, output),
            status=output.status,
            iterations=output.iterations,
            seconds=output.seconds,
            settings=solvers.settings_of(options),
        )

    def _require_agreement(self, data: ProblemData) -> None:
        """Raise TermError if a term that contradicts itself has caused the wrong answer."""
        model = NumpyModel(data, self.objective, self.rows)
        compilation = self._compilation
        with compilation.lock:
            compilation.context.update(data)
            require_agreement(
                compilation.context, model, compilation.expressions, compilation.constraints
            )

    def whitened(self, data: ProblemData) -> WhitenedQP:
        """Return the QP of the data, whether it has an answer or not."""
        compilation = self._compilation
        with compilation.lock:
            compilation.context.update(data)
            matrices = compilation.qp.matrices()
        return WhitenedQP(matrices, data.centre, data.scale, compilation.qp.column, data.layout)

    def _within_reach(
        self,
        data: ProblemData,
        rooms: Sequence[Room],
        equation: LinearEquation,
        unreachable: str,
    ) -> tuple[ProblemData, Flags, Flags, tuple[feasibility.Unreachable, ...]]:
        matches = [row.target_limits(data) for row in self._matches]
        if not matches:
            lost = np.isfinite(data.time) & ~np.isfinite(data.target)
            if lost.any():
                row = int(np.flatnonzero(lost.ravel())[0])
                raise InfeasibleError(
                    f"T[{data.layout.band_label(row)}] = {data.time.ravel()[row]:.4g} s is "
                    "too short for any absorption"
                )
            nothing = np.zeros(data.layout.size, dtype=bool)
            return data, nothing, nothing, ()
        wanted = (
            np.max([low for low, _ in matches], axis=0),
            np.min([high for _, high in matches], axis=0),
        )
        return feasibility.restrict_to_reach(data, rooms, wanted, equation, unreachable)

    def _multipliers(
        self, data: ProblemData, model: NumpyModel, u: Array, answer: solvers.SolverOutput
    ) -> Multipliers:
        """The solver's duals in the unknowns' units.

        A target at an end pins its coefficients before the solver runs. Their multipliers follow
        from stationarity.
        """
        duals = iter(answer.row_duals)
        scales = [term.row_scale(data) for term in self.rows]
        rows = [
            sum(sign * next(duals) for sign in signs) * scale
            for scale, signs in zip(scales, self._compilation.signs, strict=True)
        ]
        row_values = np.concatenate(rows) if rows else np.zeros(0)
        lower, upper = answer.lower_dual, np.zeros_like(answer.lower_dual)
        upper[: len(answer.upper_dual)] = answer.upper_dual
        ends = model.movable & (data.scale == 0)
        if ends.any():
            at_lower, at_upper = ends & (u == model.lower), ends & (u == model.upper)
            without_free = (np.concatenate([*scales, np.zeros(0)]) == 0) & (model.row_norm > 0)
            row_values = undetermined(model, u, row_values, without_free, at_lower, at_upper)
            force = model.stationarity(u, row_values)
            lower = np.where(at_lower, np.maximum(force, 0.0), lower)
            upper = np.where(at_upper, np.maximum(-force, 0.0), upper)
        return Multipliers(row_values, lower, upper)


def _attempts(model: NumpyModel, options: SolveOptions) -> Iterator[SolveOptions]:
    """The options to solve with, until an answer passes.

    Of a quadratic objective polishing asks for the active bounds alone, so Clarabel first runs with
    looser settings. Its full ones follow if that answer cannot be polished, does not pass, or was
    far off.
    """
    pieces = any(isinstance(t, HuberDeviation) for t in model.objective.terms)
    if not pieces and options.settings is None and options.solver.lower() == "clarabel":
        yield replace(options, settings=solvers.QUICK)
    yield options


def _failure(solution: Solution, solver: str) -> str:
    """Return why an answer is not optimal to `_ACCEPTED`; empty text if it is.

    The dual residual of a band is relative to the objective's steepness there. A soft match with a
    tiny u_b has a gradient that is a difference of huge numbers. Its rounding error is allowed as well:
    16 eps |H| |u|, the error of a sum of 1000 products whose roundings of eps / 2 have random signs.
    """
    model, u, certificate = solution.model, solution.unknowns, solution.certificate
    if certificate.worst <= _ACCEPTED:
        return ""
    n_bands = model.data.layout.n_bands
    steepness = _ACCEPTED * model.steepness(u)[:n_bands]
    products = model.sigma * model.curvature(u).magnitude(np.abs(u))
    rounding = 16 * np.finfo(float).eps * model.data.layout.by_band(products, np.max)
    if not model.separate(u):
        rounding = np.full(n_bands, np.max(rounding))
    if (
        np.all(certificate.primal_residual <= _ACCEPTED)
        and np.all(certificate.dual_residual <= steepness + rounding)
        and np.all(certificate.duality_gap <= steepness)
    ):
        return ""
    return (
        f'solver "{solver}" says {solution.raw.status}, but its answer does not pass: primal residual '
        f"{np.max(certificate.primal_residual):.1e}, dual residual "
        f"{np.max(certificate.dual_residual):.1e}, gap {np.max(certificate.duality_gap):.1e}"
    )


def _dual_answer(model: NumpyModel, failure: str) -> RawSolution | None:
    """Return the exact dual's answer in place of the solver's; None if the problem is not separable."""
    answer = dual_solution(model)
    if answer is None:
        return None
    u, multipliers = answer
    status = f"exact dual, since the solver failed: {failure}"
    return RawSolution(model, u, multipliers, status, iterations=0, seconds=np.nan)


def _polished(model: NumpyModel, raw: RawSolution, at_lower: Flags, at_upper: Flags) -> Solution:
    """Return the polished answer if it is better than the raw one, else the raw one."""
    answer = polish_answer(model, raw.unknowns, raw.multipliers, at_lower, at_upper)
    if answer is not None:
        certificate = certify(model, answer.alpha, answer.multipliers)
        polished = Solution(
            model, answer.alpha, answer.multipliers, answer.active, certificate, raw, True, ()
        )
        if not _failure(polished, "") or certificate.worst <= raw.certificate.worst:
            return polished
    near = 1e-9
    active = (model.movable & (raw.unknowns >= model.upper - near)).astype(np.int8)
    active -= (model.movable & (raw.unknowns <= model.lower + near)).astype(np.int8)
    return Solution(model, raw.unknowns, raw.multipliers, active, raw.certificate, raw, False, ())
