"""The Gauss-Newton steps of a calibration to every position, each a QP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.calibration.nonlinear import Steps, Taken, gauss_newton
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, PriorDeviation, as_objective
from rtcal.loop.simulator_error import Listener, ScaledErrors
from rtcal.simulators.observations import Observations
from rtcal.support.types import Array

STEPS = 4
"""Largest number of Gauss-Newton steps."""
_HALVINGS = 3
_SETTLED = 0.05
"""Change of alpha in prior sigmas after which no further step is taken."""


POSITIONS = LinearObservations("positions")


@dataclass(frozen=True, eq=False)
class LinearisationPoint:
    """A point of the path: alpha, and what the simulator hears there."""

    alpha: Array
    heard: Observations


@dataclass(frozen=True, eq=False)
class LinearisedSimulator:
    """The simulator, linearised at ``start``, and the answer of the QP."""

    listener: Listener
    start: LinearisationPoint
    matrix: Array
    errors: ScaledErrors
    answer: CalibrationResult
    now: float

    def towards(self, share: Array) -> LinearisationPoint:
        """Return what is heard at these shares of the way to the answer."""
        start = self.start.alpha
        alpha = start + float(share[0]) * (self.answer.alpha - start)
        self.listener.move(alpha)
        return LinearisationPoint(alpha, self.listener.heard)

    def worse(self, end: LinearisationPoint) -> NDArray[np.bool_]:
        """Return whether the objective with the simulator itself rises."""
        residual = self.listener.residual()
        rises = _objective(self.errors.factor, residual, self.answer, end.alpha) > self.now
        return np.array([rises])


def steps_to_positions(
    listener: Listener,
    calibration: Calibration | None,
    measured: Measurement,
    room: Room,
    errors: ScaledErrors,
) -> Steps[LinearisationPoint, LinearisedSimulator]:
    """Take at most `STEPS` Gauss-Newton steps; the ``listener`` is left where they end."""
    problem = _composed(_plain(room) if calibration is None else calibration).build(room)
    # T enters where the user's own terms match it.
    times = None if calibration is None else measured
    inverse_sigma = np.divide(1.0, room.sigma, out=np.zeros_like(room.sigma), where=room.sigma > 0)

    def linearised(at: LinearisationPoint) -> LinearisedSimulator:
        matrix = listener.linearised()
        residual = listener.residual()
        values = residual + matrix @ at.alpha.ravel()
        numbers = Observed(matrix=matrix, values=values, covariance=errors.covariance)
        answer = problem.solve(times, observed={POSITIONS: numbers}, method="positions")
        # The prior may break the constraints, and then its objective is no measure.
        now = np.inf
        if at.alpha is not room.alpha:
            now = _objective(errors.factor, residual, answer, at.alpha)
        return LinearisedSimulator(listener, at, matrix, errors, answer, now)

    def settled(step: Taken[LinearisedSimulator]) -> bool:
        # A step that is refused says as much as the smallest that was tried.
        share = float(step.share[0]) or 2.0 ** -(_HALVINGS + 1)
        moved = np.abs(step.model.answer.alpha - step.model.start.alpha) * share
        return bool(np.max(moved * inverse_sigma) < _SETTLED)

    path = gauss_newton(
        LinearisationPoint(room.alpha, listener.heard),
        linearised,
        most=STEPS,
        halvings=_HALVINGS,
        settled=settled,
        refuse=True,
    )
    listener.alpha, listener.heard = path.end.alpha, path.end.heard
    return path


def _plain(room: Room) -> Calibration:
    return Calibration(
        PriorDeviation(
            band_correlation=room.band_correlation,
            material_correlation=room.material_correlation,
            common=room.common_alpha_sigma > 0,
        ),
        [],
    )


def _composed(calibration: Calibration) -> Calibration:
    """Return the calibration with the positions in its objective."""
    return Calibration(as_objective(calibration.objective) + POSITIONS, calibration.constraints)


def _objective(factor: Array, residual: Array, answer: CalibrationResult, alpha: Array) -> float:
    """Return the objective at alpha, whose residual is the simulator's own."""
    white = solve_triangular(factor, residual, lower=True)
    return 0.5 * float(white @ white) + _others(answer, alpha)


def _others(answer: CalibrationResult, alpha: Array) -> float:
    """Return the value of the objective's terms other than the positions."""
    model = answer.joint.solution.model
    layout = model.data.layout
    u = answer.joint.solution.unknowns.copy()
    u[: layout.n_alpha] = alpha[layout.first].ravel()
    terms = zip(model.objective.terms, model.data.weights, strict=True)
    return sum(w * t.value(u, model.data) for t, w in terms if t != POSITIONS)
