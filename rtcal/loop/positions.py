"""Calibrate a simulator to what every position heard, by Gauss-Newton steps that are each a QP.

    minimise ½ (y - f(a) - J (alpha - a))' C⁻¹ (y - f(a) - J (alpha - a)) + the other terms,

with y what was measured, f what the simulator hears, J its derivatives at a, and C the covariance of
the errors of measurement and simulator. alpha becomes the next a, or a point on the way to it where
the objective with the simulator itself would rise.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq

from rtcal.acoustics import bands
from rtcal.acoustics.materials import CalibrationRecord
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, PriorDeviation, as_objective
from rtcal.errors import DataError, SimulatorError
from rtcal.loop.control_runs import POSITION, ControlRuns, Report, control_runs
from rtcal.loop.measured_pairs import MeasuredPairs, Pair, history, measured_pairs
from rtcal.loop.positions_result import PositionsResult, Step
from rtcal.simulators import base, observations
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import Observable, Observations, jacobian, observe
from rtcal.support import checks
from rtcal.support.types import Array
from rtcal.support.version import __version__

STEPS = 4
"""Largest number of Gauss-Newton steps."""
_HALVINGS = 4
_SETTLED = 0.05
"""Change of alpha in prior sigmas after which no further step is taken."""
_UNKNOWN_ERROR = 0.05
"""Standard deviation of a simulator's error that no control run tells: one JND of T, and 0.5 dB."""

_LARGEST_SCALE = 1000.0
"""Largest factor of the simulator's error: then it is some 30 times as large as in the control runs."""

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
    cache: str | os.PathLike[str] | None = None,
    position_uncertainty: float = POSITION,
    seed: int = 0,
    report: Report | None = None,
) -> PositionsResult:
    """Calibrate to every position; see `rtcal.calibrate_simulator`."""
    checks.positive("position_uncertainty", position_uncertainty, "m")
    match, notes = _given(simulator, room.alpha, match, seed)
    first = observe(simulator, room.alpha, match, seed=seed)
    data = measured_pairs(room, measured, match, first, exclude)
    _refuse_one_place(simulator, data.observations.pairs, position_uncertainty)
    if controls is None:
        controls = control_runs(
            simulator,
            room,
            match,
            seed=seed,
            position_uncertainty=position_uncertainty,
            cache=cache,
            report=report,
        )
    listener = _Listener(simulator, data, first.pairs, seed)
    before = listener.chosen(first)
    used = data.used.ravel()
    error = _simulator_error(controls, data)[np.ix_(used, used)]

    def residual(values: Array) -> Array:
        return np.asarray((data.observations.values - values)[data.used])

    composed = _composed(calibration or _plain(room))
    problem = composed.build(room)
    # T enters where the user's own terms match it.
    times = None if calibration is None else measured
    prior = prior_covariance(room)
    inverse_sigma = np.divide(1.0, room.sigma, out=np.zeros_like(room.sigma), where=room.sigma > 0)
    alpha, heard, steps, settled = room.alpha, before, list[Step](), False
    scale, covariance, factor = 1.0, data.covariance, np.eye(0)
    while len(steps) < STEPS and not settled:
        matrix = listener.linearised(alpha)
        values = residual(heard) + matrix @ alpha.ravel()
        if not steps:
            expected = matrix @ prior @ matrix.T + data.covariance
            scale = error_scale(values - matrix @ room.alpha.ravel(), expected, error)
            covariance = data.covariance + scale * error
            factor = np.asarray(np.linalg.cholesky(covariance))
        numbers = Observed(matrix=matrix, values=values, covariance=covariance)
        answer = problem.solve(times, observed={POSITIONS: numbers}, method="positions")
        start, start_heard = alpha, heard
        now, share = _objective(factor, residual(heard), answer, alpha), 1.0
        for _ in range(_HALVINGS):
            alpha = start + share * (answer.alpha - start)
            heard = listener.values(alpha)
            # The prior may break the constraints, and then its objective is no measure.
            if not steps or _objective(factor, residual(heard), answer, alpha) <= now:
                break
            share /= 2
        else:
            alpha, heard, share = start, start_heard, 0.0
        steps.append(Step(start, matrix, share, answer))
        settled = bool(np.max(np.abs(alpha - start) * inverse_sigma) < _SETTLED)
    last = steps[-1]
    everywhere = observe(simulator, alpha, data.observations.parameters, seed=seed)
    return PositionsResult(
        prior=room,
        room=_calibrated(room, alpha, last, simulator, data, controls),
        simulator=simulator.name,
        simulations=listener.calls + 1,
        measured=data,
        before=_with(data.observations, before),
        after=_with(data.observations, heard),
        predicted=_predicted(
            everywhere,
            controls,
            data,
            scale * np.asarray(np.linalg.solve(covariance, residual(heard))),
        ),
        controls=controls,
        error_scale=scale,
        innovation=residual(heard) + last.matrix @ (alpha - room.alpha).ravel(),
        covariance=covariance,
        prior_covariance=prior,
        steps=tuple(steps),
        settled=settled,
        notes=(*notes, *data.notes, *_lost_paths(simulator)),
    )


def error_scale(innovation: Array, expected: Array, error: Array) -> float:
    """Return the factor of the simulator's error with which chi-square is its degrees of freedom.

    At least 1, and at most `_LARGEST_SCALE`. ``innovation`` (n,) is what was measured less what the
    simulator hears with the prior, ``expected`` (n, n) its covariance without the simulator's error,
    ``error`` (n, n) that of the simulator's error.
    """

    def excess(scale: float) -> float:
        white = np.linalg.solve(expected + scale * error, innovation)
        return float(innovation @ white) - len(innovation)

    if excess(1.0) <= 0:
        return 1.0
    if excess(_LARGEST_SCALE) >= 0:
        return _LARGEST_SCALE
    return float(brentq(excess, 1.0, _LARGEST_SCALE, rtol=1e-3))


def prior_covariance(room: Room) -> Array:
    """Return the covariance of the room's prior, (n_materials * n_bands,) squared."""
    between = np.eye(room.n_materials)
    for (a, b), r in room.material_correlation.items():
        i, j = room.material_index(a), room.material_index(b)
        between[i, j] = between[j, i] = r
    of_bands = bands.correlation(room.centre_frequencies, room.band_correlation)
    sigma = room.sigma.ravel()
    return np.asarray(sigma[:, np.newaxis] * np.kron(between, of_bands) * sigma)


def _simulator_error(controls: ControlRuns | None, data: MeasuredPairs) -> Array:
    """Return the covariance of the simulator's error over all values."""
    wanted = data.observations
    if controls is not None:
        return controls.at(wanted.parameters, wanted.pairs).covariance()
    factor = [1.0 if p in observations.LOGARITHMIC else 10.0 for p in wanted.parameters]
    variance = (_UNKNOWN_ERROR * np.array(factor)[:, np.newaxis, np.newaxis]) ** 2
    return np.diag(np.broadcast_to(variance, wanted.values.shape).ravel())


def _predicted(
    everywhere: Observations, controls: ControlRuns | None, data: MeasuredPairs, pull: Array
) -> Observations:
    """Return what every position hears, with the simulator's error as the measured pairs tell it.

    The error's mean given the residual r at the measured pairs: D_all (R + D)⁻¹ r, D_all its
    covariance between all values and those used. ``pull`` (n_used,) is the product (R + D)⁻¹ r.
    """
    if controls is None:
        return everywhere
    parameters, pairs = everywhere.parameters, everywhere.pairs
    error = controls.at(parameters, pairs).covariance()
    used = np.zeros(everywhere.values.shape, dtype=bool)
    used[:, [pairs.index(p) for p in data.observations.pairs]] = data.used
    # The measured pairs stand in the simulator's order, so the values used do, too.
    correction = error[:, used.ravel()] @ pull
    return _with(everywhere, everywhere.values + correction.reshape(everywhere.values.shape))


def _calibrated(
    room: Room,
    alpha: Array,
    last: Step,
    simulator: Simulator,
    data: MeasuredPairs,
    controls: ControlRuns | None,
) -> Room:
    """Return the room with its coefficients, their sigma where it is known, and a record."""
    record = CalibrationRecord(
        method="positions",
        equation=f"every position heard by {simulator.name}",
        measured=" ".join([*history(room), *data.fingerprints]),
        solver=last.answer.solver,
        version=__version__,
    )
    sigma = room.sigma if controls is None else np.minimum(last.answer.posterior_sigma, 1.0)
    return room.replace(alpha=np.clip(alpha, 0.0, 1.0), sigma=sigma, calibration=record)


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


def _lost_paths(simulator: Simulator) -> tuple[str, ...]:
    """Return a note of the paths that left through gaps of the geometry."""
    share = getattr(simulator, "lost_share", 0.0)
    if not share:
        return ()
    return (
        f"{100 * share:.2g} % of the paths left through gaps between the faces. They were dropped, and "
        "the others weigh the more.",
    )


def _refuse_one_place(simulator: Simulator, pairs: Sequence[Pair], uncertainty: float) -> None:
    """Raise DataError if several pairs stand where one does: they tell no more than one."""
    sources, receivers = (getattr(simulator, kind, None) for kind in ("sources", "receivers"))
    if len(pairs) < 2 or not isinstance(sources, Mapping) or not isinstance(receivers, Mapping):
        return
    places = np.array([[*sources[s], *receivers[r]] for s, r in pairs], dtype=float)
    if np.max(np.linalg.norm(places - places[0], axis=1)) <= uncertainty:
        raise DataError(
            f"all {len(pairs)} pairs stand at one place, within the {uncertainty:g} m that positions "
            "are uncertain by; every position needs several"
        )


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


def _with(like: Observations, values: Array) -> Observations:
    return Observations(
        parameters=like.parameters,
        pairs=like.pairs,
        centre_frequencies=like.centre_frequencies,
        values=values,
    )
