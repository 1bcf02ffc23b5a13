"""Gauss-Newton steps around the one QP, for models that are not linear in alpha.

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

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular

from rtcal.calibration.composition import Composition
from rtcal.calibration.problem import CalibrationProblem, Times
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed
from rtcal.support.errors import DataError, SimulatorError
from rtcal.support.types import Array


class Observation(Protocol):
    """Data of a room, and the model that predicts them from its coefficients.

    Attributes
    ----------
    values : array (n,)
        The data.
    covariance : array (n, n)
        Of the errors of data and model.
    """

    @property
    def values(self) -> Array:
        """The data, (n,)."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance of the errors of data and model, (n, n)."""
        ...

    def predict(self, alpha: Array) -> Array:
        """Return the model's values for alpha (n_materials, n_bands), (n,).

        DataError or SimulatorError where it has none: a step there is refused.
        """
        ...

    def jacobian(self, alpha: Array) -> Array:
        """Return their derivatives by alpha, (n, n_materials * n_bands)."""
        ...


@dataclass(frozen=True, eq=False)
class GaussNewtonStep:
    """A Gauss-Newton step.

    ``alpha`` (n_materials, n_bands) is where the model was linearised, ``matrix`` (n, n_materials *
    n_bands) are the derivatives there, ``share`` is how much of the way to the ``answer`` of the QP was
    gone: 0 where the step was refused.
    """

    alpha: Array
    matrix: Array
    share: float
    answer: CalibrationResult


@dataclass(frozen=True, eq=False)
class GaussNewtonFit:
    """Where the steps ended, the steps, and whether the last one settled."""

    alpha: Array
    steps: tuple[GaussNewtonStep, ...]
    settled: bool

    @property
    def answer(self) -> CalibrationResult:
        """The answer of the last step's QP."""
        return self.steps[-1].answer


@dataclass(frozen=True, eq=False)
class ModelObjective:
    """The objective with a model itself in place of the linearised one.

    ``answer`` is that of a QP of the problem, ``term`` the one of the data, and ``factor`` the Cholesky
    factor of their covariance.
    """

    answer: CalibrationResult
    term: LinearObservations
    factor: Array

    @cached_property
    def others(self) -> Composition:
        """The problem without the data."""
        return self.answer.joint.composition.without(self.term)

    def value(self, alpha: Array, residual: Array) -> float:
        """Return the objective in nats, for the data less the model's values, (n,).

        Infinite where the coefficients do not keep the bounds and the constraints.
        """
        white = solve_triangular(self.factor, residual, lower=True)
        layout, u = self.others.layout, self.answer.joint.unknowns.copy()
        u[: layout.n_alpha] = alpha[layout.first].ravel()
        return 0.5 * float(white @ white) + self.others.value(self.answer.joint.numbers, u)


SETTLED = 0.05
"""Change of alpha in prior sigmas after which no further step is taken."""


def fit(
    problem: CalibrationProblem[CalibrationResult],
    data: Observation,
    start: Array,
    *,
    term: LinearObservations,
    method: str,
    times: Times | None = None,
    most: int = 6,
    halvings: int = 6,
    covariance: Array | None = None,
    allowed: Callable[[Array], bool] = lambda end: True,
    settled: Callable[[GaussNewtonStep, Array], bool] | None = None,
) -> GaussNewtonFit:
    """Return where Gauss-Newton steps end: at no larger objective than that of the start.

    The start counts where it keeps the problem's bounds and constraints; from elsewhere the first step
    is taken.

    Parameters
    ----------
    problem : CalibrationProblem
        Built with ``term``, whose numbers are the linearised data.
    data : Observation
    start : array (n_materials, n_bands)
    term : LinearObservations
    method : str
        Name of the result's method.
    times : Times, optional
        The measured T of the problem's other terms.
    most, halvings : int
        Largest numbers of steps, and of halvings of a step.
    covariance : array (n, n), optional
        In the QP in place of that of the data, which judges the steps all the same.
    allowed : callable
        Whether a point may be an end, whatever its objective.
    settled : callable, optional
        Whether a step, and the alpha at which it ended, is the last; by default where the whole step
        changes no coefficient by more than `SETTLED` of its prior sigma.

    Raises
    ------
    InfeasibleError, SolverError
        As `CalibrationProblem.solve`.
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

        for share in (*0.5 ** np.arange(halvings + 1.0), 0.0):
            end = np.asarray(start + share * (answer.alpha - start))
            if not share or not worse(end):
                break
        step = GaussNewtonStep(start, matrix, float(share), answer)
        steps.append(step)
        if settled is not None:
            last = settled(step, end)
        else:
            # The whole step counts: one that was shortened to little may be far from the minimum.
            sigma, moved = answer.prior.sigma, np.abs(answer.alpha - start)
            last = bool((moved[sigma > 0] < SETTLED * sigma[sigma > 0]).all())
        start = end
        if not share:
            break
    return GaussNewtonFit(start, tuple(steps), last)
