"""Calibrate a simulator to what every position heard, by Gauss-Newton steps that are each a QP.

    minimise ½ (y - f(a) - J (alpha - a))' C⁻¹ (y - f(a) - J (alpha - a)) + the other terms,

with y what was measured, f what the simulator hears, J its derivatives at a, and C the covariance of
the errors of measurement and simulator. alpha becomes the next a, or a point on the way to it where
the objective with the simulator itself would rise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, PriorDeviation, as_objective
from rtcal.errors import SimulatorError
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.measured_pairs import MeasuredPairs, Pair, measured_pairs
from rtcal.loop.positions_result import Linearised, PositionsResult
from rtcal.simulators import base, observations
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import Observable, Observations, jacobian, observe
from rtcal.support.types import Array

STEPS = 4
"""Largest number of Gauss-Newton steps."""
_HALVINGS = 4
_SETTLED = 0.05
"""Change of alpha in prior sigmas after which no further step is taken."""
_UNKNOWN_ERROR = 0.05
"""Standard deviation of a simulator's error that no control run tells: one JND of T, and 0.5 dB."""

POSITIONS = LinearObservations("positions")


def calibrate_positions(
    simulator: Simulator,
    room: Room,
    measured: Measurement,
    match: Sequence[str],
    *,
    exclude: Sequence[Pair] = (),
    calibration: Calibration | None = None,
    controls: ControlRuns | None = None,
    seed: int = 0,
) -> PositionsResult:
    """Calibrate to every position; see `rtcal.calibrate_simulator`."""
    match, notes = _given(simulator, room.alpha, match, seed)
    first = observe(simulator, room.alpha, match, seed=seed)
    data = measured_pairs(room, measured, match, first.pairs, exclude)
    listener = _Listener(simulator, data, first.pairs, seed)
    before = listener.chosen(first)
    if controls is None:
        bias = np.zeros_like(data.observations.values)
        error = np.diag(_unknown_error(data.observations))
    else:
        controls = controls.at(data.observations.parameters, data.observations.pairs)
        bias, error = controls.bias, controls.covariance()
    covariance = data.covariance + error[np.ix_(data.used.ravel(), data.used.ravel())]

    def residual(values: Array) -> Array:
        return np.asarray((data.observations.values - values - bias)[data.used])

    calibration = _composed(calibration or _plain(room))
    problem = calibration.build(room)
    plain = not calibration.constraints and len(as_objective(calibration.objective).terms) == 2
    times = None if plain else measured
    inverse_sigma = np.divide(1.0, room.sigma, out=np.zeros_like(room.sigma), where=room.sigma > 0)
    factor = np.asarray(np.linalg.cholesky(covariance), dtype=float)
    alpha, heard = room.alpha, before
    steps: list[Linearised] = []
    while len(steps) < STEPS:
        matrix = listener.linearised(alpha)
        values = residual(heard) + matrix @ alpha.ravel()
        numbers = Observed(matrix=matrix, values=values, covariance=covariance)
        answer = problem.solve(times, observed={POSITIONS: numbers}, method="positions")
        start, now, share = alpha, _objective(factor, residual(heard), answer, alpha), 1.0
        for _ in range(_HALVINGS):
            alpha = start + share * (answer.alpha - start)
            heard = listener.values(alpha)
            # The prior may break the constraints, and then its objective is no measure.
            if not steps or _objective(factor, residual(heard), answer, alpha) <= now:
                break
            share /= 2
        steps.append(Linearised(start, matrix, share, answer))
        if np.max(np.abs(alpha - start) * inverse_sigma) < _SETTLED:
            break
    return PositionsResult(
        prior=room,
        simulator=simulator.name,
        simulations=listener.calls,
        alpha=alpha,
        data=data,
        before=_with(data.observations, before),
        after=_with(data.observations, heard),
        controls=controls,
        covariance=covariance,
        innovation=residual(before),
        steps=tuple(steps),
        notes=(*notes, *data.notes),
    )


@dataclass
class _Listener:
    """What the simulator hears of the measured parameters and pairs; its calls are counted."""

    simulator: Simulator
    data: MeasuredPairs
    pairs: tuple[Pair, ...]
    seed: int
    calls: int = 1

    def values(self, alpha: Array) -> Array:
        """Return the values, (n_parameters, n_pairs, n_bands)."""
        self.calls += 1
        parameters = self.data.observations.parameters
        return self.chosen(observe(self.simulator, alpha, parameters, seed=self.seed))

    def chosen(self, heard: Observations) -> Array:
        """Return the values of the measured parameters and pairs."""
        rows = [heard.parameters.index(p) for p in self.data.observations.parameters]
        return np.asarray(heard.values[rows][:, self._columns])

    def linearised(self, alpha: Array) -> Array:
        """Return the derivatives of the values used, (n_used, n_materials * n_bands)."""
        self.calls += 1
        parameters = self.data.observations.parameters
        full = jacobian(self.simulator, alpha, parameters, seed=self.seed)[:, self._columns]
        n_bands, n_materials = full.shape[2:]
        matrix = np.zeros((*full.shape[:3], n_materials, n_bands))
        for k in range(n_bands):
            matrix[:, :, k, :, k] = full[:, :, k]
        return np.asarray(matrix[self.data.used].reshape(-1, n_materials * n_bands))

    @property
    def _columns(self) -> list[int]:
        return [self.pairs.index(p) for p in self.data.observations.pairs]


def _given(
    simulator: Simulator, alpha: Array, match: Sequence[str], seed: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parameters that the simulator gives, and a note of those that it does not."""
    match = observations.checked_parameters(match)
    if isinstance(simulator, Observable):
        return match, ()
    simulated = base.run(simulator, alpha, seed=seed)
    given = tuple(p for p in match if p in observations.given(simulated))
    if not given:
        raise SimulatorError(
            f"{simulator.name} gives none of {', '.join(p.upper() for p in match)}"
        )
    absent = [p.upper() for p in match if p not in given]
    note = f"Left out, since the simulator does not give it: {', '.join(absent)}."
    return given, (note,) if absent else ()


def _plain(room: Room) -> Calibration:
    return Calibration(
        PriorDeviation(
            band_correlation=room.band_correlation, material_correlation=room.material_correlation
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


def _unknown_error(observed: Observations) -> Array:
    """Return the variance of a simulator's error where no control run tells it."""
    factor = [1.0 if p in observations.LOGARITHMIC else 10.0 for p in observed.parameters]
    by_parameter = (_UNKNOWN_ERROR * np.array(factor)) ** 2
    return np.broadcast_to(by_parameter[:, None, None], observed.values.shape).ravel()


def _with(like: Observations, values: Array) -> Observations:
    return Observations(
        parameters=like.parameters,
        pairs=like.pairs,
        centre_frequencies=like.centre_frequencies,
        values=values,
    )
