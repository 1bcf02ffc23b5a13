"""The simulator's values at every position with their own error, and Gauss-Newton steps to them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import observable
from rtcal.acoustics.quality import rms
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import heard_changes
from rtcal.calibration.methods import Steps, Taken, gauss_newton
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, PriorDeviation, as_objective
from rtcal.loop.control_runs import MODELS, ControlRuns, ahead_factor, level, paths_of_a_run
from rtcal.loop.measured_pairs import MeasuredPairs
from rtcal.loop.scattering import (
    DIGITS,
    ErrorsByScattering,
    MaterialScattering,
    errors_by_scattering,
    log_likelihood,
    material_scattering,
    scattered,
)
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import Observations, jacobian, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.tracer import ScatteringModel
from rtcal.support.errors import DataError, SimulatorError, TooShortError
from rtcal.support.types import Array

_LEAST = 0.02
"""Scattering below which paths are followed for no longer."""
_AHEAD = 2.0
"""How many times Eyring's T the paths with another scattering are followed at least, where as much is
scattered as stated. Where less is, they are followed for longer in proportion: in one of ten judged
rooms they were traced three times with 2.0 alone."""


@dataclass
class Listener:
    """A simulator's values at ``alpha``, in the order of the measured ones; its calls are counted.

    Attributes
    ----------
    simulator : Simulator
    data : MeasuredPairs
    heard : Observations
        At all pairs of the simulator.
    alpha : array (n_materials, n_bands)
    seed, calls : int
    used : int array (n_used,)
        Which of the values were measured, counted over the measured parameters at all pairs.
    """

    simulator: Simulator
    data: MeasuredPairs
    heard: Observations
    alpha: Array
    seed: int
    calls: int = 1
    used: NDArray[np.int64] = field(init=False)
    _slopes: tuple[Array, Array] | None = field(init=False, default=None)
    _rows: list[int] = field(init=False)
    _columns: list[int] = field(init=False)

    def __post_init__(self) -> None:
        parameters, pairs = self.data.observations.parameters, self.heard.pairs
        self._rows = [self.heard.parameters.index(p) for p in parameters]
        self._columns = [pairs.index(p) for p in self.data.observations.pairs]
        shape = (len(parameters), *self.heard.values.shape[1:])
        used = np.zeros(shape, dtype=bool)
        used[:, self._columns] = self.data.used
        # The measured pairs stand in the simulator's order, so the values used do, too.
        self.used = np.flatnonzero(used)

    def move(self, alpha: Array) -> None:
        """Hear another alpha."""
        self.calls += 1
        parameters = self.heard.parameters
        self.heard = observe(self.simulator, alpha, parameters, seed=self.seed)
        self.alpha = alpha

    def scattered(self, tracer: PathTracing, expected: Array) -> Listener:
        """Return a listener to a tracer with another scattering, at this alpha.

        ``expected`` (n_parameters, n_pairs, n_bands) is the change of every value that is expected; it
        says for how long the paths are followed.
        """
        likely = Observations(
            parameters=self.data.observations.parameters,
            pairs=self.heard.pairs,
            centre_frequencies=self.heard.centre_frequencies,
            values=self.everywhere() + expected,
        )
        ahead = max(_AHEAD * self._less_scattered(tracer), ahead_factor(likely, tracer, self.alpha))
        tracer.trace_ahead(self.alpha, ahead, seed=self.seed)
        heard = tracer.observe(self.alpha, self.heard.parameters, seed=self.seed)
        return Listener(tracer, self.data, heard, self.alpha, self.seed, calls=self.calls + 1)

    def _less_scattered(self, tracer: PathTracing) -> float:
        """Return how many times less a tracer scatters than that which is heard, at least 1."""
        if not isinstance(self.simulator, PathTracing):
            return 1.0
        now, then = (level(of.scattering, of.room.areas) for of in (self.simulator, tracer))
        return max(now / max(then, _LEAST), 1.0)

    def everywhere(self) -> Array:
        """Return the values at all pairs of the simulator, (n_parameters, n_all_pairs, n_bands)."""
        return np.asarray(self.heard.values[self._rows])

    def values(self) -> Array:
        """Return the values, (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.everywhere()[:, self._columns])

    def residual(self) -> Array:
        """Return measured less heard, (n_used,)."""
        return np.asarray((self.data.observations.values - self.values())[self.data.used])

    def gaps(self) -> Array:
        """Return root mean square gaps in JND: of all that is matched, and of each parameter."""
        gap = self.data.gap(replace(self.data.observations, values=self.values()))
        return np.array([rms(gap), *rms(gap, axis=(1, 2))])

    @property
    def of_level(self) -> NDArray[np.bool_]:
        """Which of the values used are levels, (n_used,)."""
        levels = [observable(p).part == "level" for p in self.data.observations.parameters]
        return np.broadcast_to(np.array(levels)[:, None, None], self.data.used.shape)[
            self.data.used
        ]

    def linearised(self) -> Array:
        """Return the derivatives of the values used, (n_used, n_materials * n_bands)."""
        if self._slopes is not None and self._slopes[0] is self.alpha:
            return self._slopes[1]
        self.calls += 1
        parameters = self.data.observations.parameters
        full = jacobian(self.simulator, self.alpha, parameters, seed=self.seed)[:, self._columns]
        n_bands, n_materials = full.shape[2:]
        matrix = np.zeros((*full.shape[:3], n_materials, n_bands))
        for k in range(n_bands):
            matrix[:, :, k, :, k] = full[:, :, k]
        used = np.asarray(matrix[self.data.used].reshape(-1, n_materials * n_bands))
        self._slopes = self.alpha, used
        return used


GROUPS = 4
"""Groups of paths whose differences tell the noise of a control run."""


def groups_of_paths(
    simulator: Simulator,
    alpha: Array,
    parameters: Sequence[str],
    seed: int,
    shape: tuple[int, int, int],
) -> Array:
    """Return what groups of the paths hear, (n_groups, p, i, k): their differences are noise.

    It is 0 but for a `PathTracing`; ``shape`` is (n_parameters, n_pairs, n_bands).
    """
    if not isinstance(simulator, PathTracing):
        return np.zeros((GROUPS, *shape))
    return simulator.observe_in_groups(alpha, GROUPS, parameters, seed=seed)


def noise_of_a_run(simulator: Simulator, groups: Array) -> Array:
    """Return the variance of a control run's values by its finite paths, (n_parameters, n_bands).

    ``groups`` (n_groups, p, i, k) are the simulator's `groups_of_paths`.
    """
    of_group = groups.var(axis=0, ddof=1).mean(axis=1)
    if not isinstance(simulator, PathTracing):
        return np.asarray(of_group)
    return np.asarray(of_group * simulator.n_paths / GROUPS / paths_of_a_run(simulator))


def _noise(listener: Listener) -> Array:
    simulator, parameters = listener.simulator, listener.data.observations.parameters
    shape = (len(parameters), *listener.heard.values.shape[1:])
    groups = groups_of_paths(simulator, listener.alpha, parameters, listener.seed, shape)
    return noise_of_a_run(simulator, groups)


def simulator_error(
    listener: Listener, controls: ControlRuns | None, fit_scattering: bool
) -> tuple[Array, ErrorsByScattering | None]:
    """Return the covariance of the simulator's error, and its errors by scattering.

    The covariance is (n, n) with n all values: measured parameters at all pairs of the simulator. The
    second is None where the scattering stated is kept, as by every simulator but a `PathTracing` with
    the model "random". Only its paths tell what scattering does. Coefficients of 0 and 1 are kept, too.
    """
    heard, parameters = listener.heard, listener.data.observations.parameters
    if controls is None:
        error = np.array([observable(p).unknown_error for p in parameters])
        shape = (len(parameters), *heard.values.shape[1:])
        variance = error[:, np.newaxis, np.newaxis] ** 2
        return np.diag(np.broadcast_to(variance, shape).ravel()), None
    controls = controls.at(parameters, heard.pairs)
    noise, tracer = _noise(listener), listener.simulator
    whole = controls.without_noise(noise).covariance()
    if (
        not fit_scattering
        or not isinstance(tracer, PathTracing)
        or tracer.scattering_model != "random"
        or np.isin(tracer.scattering, (0.0, 1.0)).all()
    ):
        return whole, None
    return whole, errors_by_scattering(controls, noise)


@dataclass(frozen=True, eq=False)
class FitErrors:
    """The errors of what is compared.

    Attributes
    ----------
    simulator : array (n, n)
        Covariance of the simulator's error at all values, with that of an unknown scattering.
    unexplained : array (n_parameters,)
        Standard deviation in JND by which each value differs beyond the other errors.
    covariance : array (n_used, n_used)
        Of measurement, room, simulator and what is unexplained, of the values used.
    factor : array (n_used, n_used)
        Its Cholesky factor.
    """

    simulator: Array
    unexplained: Array
    covariance: Array
    factor: Array


_MOST_UNEXPLAINED = 100.0
"""JND beyond which nothing is matched."""


def unexplained_errors(
    innovation: Array, expected: Array, unit: Array, parameter: NDArray[np.int64]
) -> Array:
    """Return each parameter's unexplained error in JND under which what was measured is likeliest.

    The error differs from value to value: control runs vary what all pairs have in common, but no
    furniture and no directivity that a pair alone meets. A common factor of the simulator's error would
    also explain a T that is off at every pair, so that T would not be fitted.

    Parameters
    ----------
    innovation : array (n,)
        What was measured less what the simulator gives with the prior.
    expected : array (n, n)
        Its covariance without the unexplained errors.
    unit : array (n,)
        One JND of each value.
    parameter : int array (n,)
        Number of each value's parameter.

    Returns
    -------
    array (n_parameters,)

    References
    ----------
    Variance components by maximum likelihood (Harville 1977, JASA 72, 320-338).
    """
    square = unit**2
    number = int(parameter.max()) + 1

    def loss(deviation: Array) -> tuple[float, Array]:
        covariance = expected + np.diag(deviation[parameter] ** 2 * square)
        factor = cho_factor(covariance, lower=True)
        pull = cho_solve(factor, innovation)
        of_variance = np.diag(cho_solve(factor, np.eye(len(square)))) - pull**2
        slope = np.bincount(parameter, of_variance * square, minlength=number) * deviation
        return 0.5 * float(innovation @ pull) + float(np.log(np.diag(factor[0])).sum()), slope

    found = minimize(
        loss,
        np.ones(number),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, _MOST_UNEXPLAINED)] * number,
    )
    return np.asarray(found.x)


STEPS = 6
"""Largest number of Gauss-Newton steps with the same errors."""
_PASSES = 3
"""Most times that the unexplained errors are found anew, where the last steps ended."""
_ALIKE = 0.1
"""JND by which unexplained errors differ that are the same."""
_ROUNDS = 3
"""Most times that the room is traced with another scattering."""
_GAP_WEIGHTS = (0.1, 1.0, 10.0)
"""Weights of the squared gap that are tried where the objective's own steps would raise it."""
_SETTLED_ODDS = 0.15
"""Change of the log odds, rounded to tenths, for which the room is not traced again: 0.02 to 0.04 of a
coefficient."""
_HALVINGS = 6
_TRIALS = 3
"""Most lengths of the last step, which lowers the gap."""
_INDISTINCT = 0.5
"""Rise of the objective in nats within which coefficients are indistinct from those of its minimum: one
standard deviation."""
FITS = 0.5
"""Gap in JND, root mean square over all that is matched, below which a start needs no fit: the noise of
a tracing."""
_SETTLED = 0.05
"""Change of alpha in prior sigmas after which no further step is taken."""

POSITIONS = LinearObservations("positions")


@dataclass(frozen=True, eq=False)
class LinearisationPoint:
    """A point of the path: alpha, and what the simulator hears there; None where it gives nothing."""

    alpha: Array
    heard: Observations | None


@dataclass(frozen=True, eq=False)
class LinearisedSimulator:
    """The simulator, linearised at ``start``, and the answer of the QP.

    ``offset`` (n_used,) is what the values used would rise by with the scattering as traced in place of
    that stated, ``now`` the objective at ``start``, ``limit`` the largest gaps in JND.
    """

    listener: Listener
    start: LinearisationPoint
    matrix: Array
    errors: FitErrors
    offset: Array
    answer: CalibrationResult
    now: float
    limit: Array

    def towards(self, share: Array) -> LinearisationPoint:
        """Return what is heard at these shares of the way to the answer."""
        start = self.start.alpha
        alpha = start + float(share[0]) * (self.answer.alpha - start)
        try:
            self.listener.move(alpha)
        except (DataError, SimulatorError):  # no decay time with so much absorption, or so little
            return LinearisationPoint(alpha, None)
        return LinearisationPoint(alpha, self.listener.heard)

    def worse(self, end: LinearisationPoint) -> NDArray[np.bool_]:
        """Return whether the simulator's own objective rises, or its gap exceeds the limit."""
        if end.heard is None:
            return np.array([True])
        residual = self.listener.residual() + self.offset
        value = _misfit(self.errors.factor, residual) + _others(self.answer, end.alpha)
        return np.array([value > self.now or (self.listener.gaps() > self.limit).any()])


Path = Steps[LinearisationPoint, LinearisedSimulator]


@dataclass(frozen=True, eq=False)
class FittedScattering:
    """A tracer with a scattering that is fitted, and what is known of it.

    ``materials`` says what the scattering does, ``errors`` which error is left beside it.
    """

    tracer: PathTracing
    materials: MaterialScattering
    errors: ErrorsByScattering

    @property
    def covariance(self) -> Array:
        """Covariance of the simulator's error with the scattering not known, (n, n)."""
        tracer, model = self.tracer, self.materials.model
        at = level(tracer.scattering, tracer.room.areas)
        return self.errors.covariance(at, model) + self.materials.covariance


@dataclass(frozen=True, eq=False)
class Fitted:
    """Where a fit ended.

    Attributes
    ----------
    listener : Listener
        The simulator with the fitted scattering, at the fitted alpha.
    path : Steps
        The last Gauss-Newton steps.
    errors : FitErrors
        With which they were taken.
    scattering : FittedScattering or None
        None where the scattering stated is kept.
    refused : bool
        Whether no step led nearer, so that the start is returned.
    """

    listener: Listener
    path: Path
    errors: FitErrors
    scattering: FittedScattering | None
    refused: bool = False

    @property
    def residual(self) -> Array:
        """Measured less simulated with the scattering stated, by derivatives, (n_used,)."""
        return self.listener.residual() + _offset(self.listener, self.scattering)

    @property
    def pull(self) -> Array:
        """Inverse covariance times the residual, (n,): 0 where nothing was measured."""
        pull = np.zeros(len(self.errors.simulator))
        pull[self.listener.used] = np.linalg.solve(self.errors.covariance, self.residual)
        return pull


def _offset(listener: Listener, scattering: FittedScattering | None) -> Array:
    """Return by how much less is heard with the scattering stated than with that traced, (n_used,)."""
    if scattering is None:
        return np.zeros(len(listener.used))
    return -scattering.materials.back[listener.used]


class PositionsFit:
    """A fit of alpha, and of the scattering of a `PathTracing`, to what every position heard.

    No step is taken unless the simulator itself shows that the objective falls, and that the gap over
    all that is matched stays below that of the start. The errors belong to where the steps ended: the
    unexplained ones (`unexplained_errors`) are found there, and further steps are taken from there.

    Parameters
    ----------
    listener : Listener
        At the room's coefficients.
    room : Room
    calibration : Calibration, optional
        Prior, further terms and constraints.
    measured : Measurement
        Its T enters where the calibration's own terms match it.
    prior : array (n_materials * n_bands, n_materials * n_bands)
    error : array (n, n)
        Covariance of the simulator's error, with the scattering kept.
    by_scattering : ErrorsByScattering or None
        The errors by scattering, where it is fitted.
    """

    def __init__(
        self,
        listener: Listener,
        room: Room,
        calibration: Calibration | None,
        measured: Measurement,
        prior: Array,
        error: Array,
        by_scattering: ErrorsByScattering | None,
    ) -> None:
        self.listener, self.room, self.prior = listener, room, prior
        self.error, self.by_scattering = error, by_scattering
        self._problem = _composed(_plain(room) if calibration is None else calibration).build(room)
        self._times = None if calibration is None else measured
        self._heard = listener.heard
        self._residual, self._gaps = listener.residual(), listener.gaps()
        self._no_limit = np.full(len(self._gaps), np.inf)
        # No parameter is given up for the others, but for what is no more than noise.
        self._limit = np.array([self._gaps[0], *np.maximum(self._gaps[1:], FITS)])
        self._unit = listener.data.in_values(np.ones(len(listener.data.used)))
        self._parameter = np.nonzero(listener.data.used)[0]
        self._inverse_sigma = np.divide(
            1.0, room.sigma, out=np.zeros_like(room.sigma), where=room.sigma > 0
        )

    def run(self) -> Fitted:
        """Return where the fit ends."""
        fit = self._nearest()
        if not fit.refused and fit.listener.gaps()[0] > FITS:
            self._close(fit)
        return fit

    def _close(self, fit: Fitted) -> None:
        """Move to a smaller gap where the objective is indistinct from its minimum.

        An error of the simulator that all bands have in common counts once, and the deviation of every
        coefficient by itself: so coefficients that all are off by the same factor leave a part of the
        gap at the minimum.
        """
        listener, errors, model = fit.listener, fit.errors, fit.path.steps[-1].model
        offset, start = _offset(listener, fit.scattering), listener.alpha
        heard, gaps = listener.heard, listener.gaps()

        def objective(residual: Array, alpha: Array) -> float:
            return _misfit(errors.factor, residual) + _others(model.answer, alpha)

        residual, matrix = listener.residual() + offset, listener.linearised()
        least = objective(residual, start)
        most = least + _INDISTINCT
        if _keeps(model.answer, self.room.alpha):
            most = min(most, objective(self._residual, self.room.alpha))
        covariance = self._weighted(errors, _GAP_WEIGHTS[0])
        way = self._answer(start, matrix, residual, covariance).alpha - start
        rise = objective(residual - matrix @ way.ravel(), start + way) - least
        share = np.sqrt(_INDISTINCT / max(rise, _INDISTINCT))
        limit = np.maximum(gaps, FITS)
        for _ in range(_TRIALS):
            alpha = start + share * way
            try:
                listener.move(alpha)
            except (DataError, SimulatorError):
                pass  # a decay without a time
            else:
                inside = objective(listener.residual() + offset, alpha) <= most
                now = listener.gaps()
                if inside and now[0] < gaps[0] and (now <= limit).all():
                    return
            share /= 2
        listener.alpha, listener.heard = start, heard

    def _nearest(self) -> Fitted:
        """Return where the objective is least."""
        if self.by_scattering is not None:
            free = self._with_stated_scattering(guarded=False)
            if free.scattering is not None:
                found = self._with_other_scattering(free, free.scattering)
                if found is not None:
                    return found
            self.listener.alpha, self.listener.heard = self.room.alpha, self._heard
        return self._with_stated_scattering(guarded=True)

    def _with_stated_scattering(self, *, guarded: bool) -> Fitted:
        """Return where alpha ends with the scattering stated.

        If ``guarded``, no farther than the start. Else the scattering is still to be fitted.
        """
        listener, scattering = self.listener, self._stated_scattering()
        errors = self._errors(listener, scattering, np.zeros(len(listener.data.used)))
        # The first steps only lead near: with errors that were found at the start, where a simulator
        # is far from what was measured, its curvature would count as an error.
        path = self._steps(listener, errors, scattering, self._no_limit)
        for _ in range(_PASSES):
            scattering, before = self._stated_scattering(), errors.unexplained
            errors, answer = self._errors(listener, scattering), path.steps[-1].model.answer
            begins_right = guarded and _keeps(answer, self.room.alpha)
            if begins_right and not self._is_nearer(listener, errors, answer):
                listener.alpha, listener.heard = self.room.alpha, self._heard
            limit = self._limit if begins_right else self._no_limit
            path = self._steps(listener, errors, scattering, limit)
            if np.abs(errors.unexplained - before).max() < _ALIKE:
                break
        misses = self._gaps[0] > FITS
        for weight in _GAP_WEIGHTS:
            if not (guarded and misses and np.array_equal(path.end.alpha, self.room.alpha)):
                break
            # The objective falls along its own step and the gap rises: a step may lower both.
            self._steps(listener, errors, scattering, self._limit, weight)
            path = self._steps(listener, errors, scattering, self._limit)
        refused = guarded and misses and np.array_equal(path.end.alpha, self.room.alpha)
        return Fitted(listener, path, errors, scattering, refused)

    def _with_other_scattering(self, free: Fitted, stated: FittedScattering) -> Fitted | None:
        """Return the nearest of the fits with scattering fitted, too; None if none is near."""
        best, listener, path = self._better(None, free, stated), free.listener, free.path
        model, change, log_odds = self._first_scattering(free, stated)
        if model == stated.materials.model and not log_odds.any():
            return best
        for _ in range(_ROUNDS):
            tracer = scattered(stated.tracer, log_odds, model)
            try:
                listener = listener.scattered(tracer, change.reshape(listener.everywhere().shape))
            except TooShortError:  # with so little scattering no decay ends
                break
            # Only paths of the model "random" tell the slopes; those of the other serve for both.
            materials = stated.materials
            if model == "random":
                materials = self._materials(listener, tracer)
            materials = replace(materials, traced=log_odds, model=model)
            scattering = FittedScattering(tracer, materials, stated.errors)
            errors = self._errors(listener, scattering)
            best = self._better(best, Fitted(copy(listener), path, errors, scattering), scattering)
            path = self._steps(listener, errors, scattering, self._no_limit)
            ended = Fitted(listener, path, errors, scattering)
            best = self._better(best, ended, scattering)
            likely = materials.likely(ended.pull).round(DIGITS)
            if np.abs(likely - log_odds).max() < _SETTLED_ODDS:
                break
            change, log_odds = materials.slope @ (likely - log_odds), likely
        if best is not None:
            best.listener.calls = listener.calls
        return best

    def _first_scattering(
        self, kept: Fitted, stated: FittedScattering
    ) -> tuple[ScatteringModel, Array, Array]:
        """Return the likelier model, the change of all values that is expected, and the log odds."""
        listener, materials, used = kept.listener, stated.materials, kept.listener.used
        matrix = listener.linearised()
        innovation = listener.residual() + matrix @ (listener.alpha - self.room.alpha).ravel()
        of_data = kept.errors.covariance - kept.errors.simulator[np.ix_(used, used)]
        found = []
        for model in MODELS:
            added = np.zeros(len(materials.slope))
            if model == "vector":
                added = stated.errors.of_model.ravel()
            error = replace(stated, materials=replace(materials, model=model)).covariance
            left = innovation - added[used]
            whole = matrix @ self.prior @ matrix.T + of_data + error[np.ix_(used, used)]
            pull = np.zeros(len(added))
            pull[used] = np.linalg.solve(whole, left)
            log_odds = materials.likely(pull).round(DIGITS)
            found.append((log_likelihood(left, whole), model, added, log_odds))
        _, model, added, log_odds = max(found, key=lambda of: of[0])
        return model, added + materials.slope @ log_odds, log_odds

    def _stated_scattering(self) -> FittedScattering | None:
        """Return what the scattering stated does where the listener is; None where it is not fitted."""
        tracer = self.listener.simulator
        if self.by_scattering is None or not isinstance(tracer, PathTracing):
            return None
        return FittedScattering(tracer, self._materials(self.listener, tracer), self.by_scattering)

    @staticmethod
    def _materials(listener: Listener, tracer: PathTracing) -> MaterialScattering:
        parameters = listener.data.observations.parameters
        stated = np.zeros(tracer.room.n_materials)
        return material_scattering(tracer, listener.alpha, parameters, stated, listener.seed)

    def _errors(
        self,
        listener: Listener,
        scattering: FittedScattering | None,
        unexplained: Array | None = None,
    ) -> FitErrors:
        """Return the errors where the listener is; the ``unexplained`` ones are found if None."""
        error = self.error if scattering is None else scattering.covariance
        matrix = listener.linearised()
        of_room = heard_changes(self.room, matrix, listener.of_level)
        known = listener.data.covariance + of_room.T @ of_room
        known = known + error[np.ix_(listener.used, listener.used)]
        if unexplained is None:
            innovation = listener.residual() + _offset(listener, scattering)
            innovation = innovation + matrix @ (listener.alpha - self.room.alpha).ravel()
            expected = matrix @ self.prior @ matrix.T + known
            unexplained = unexplained_errors(innovation, expected, self._unit, self._parameter)
        covariance = known + np.diag((unexplained[self._parameter] * self._unit) ** 2)
        return FitErrors(error, unexplained, covariance, np.asarray(np.linalg.cholesky(covariance)))

    def _steps(
        self,
        listener: Listener,
        errors: FitErrors,
        scattering: FittedScattering | None,
        limit: Array,
        weight: float = 0.0,
    ) -> Path:
        """Take Gauss-Newton steps from where the listener is; it is left where they end.

        ``weight`` is that of the squared gap in JND, which the steps lower beside the objective.
        """
        offset, covariance = _offset(listener, scattering), self._weighted(errors, weight)

        def linearised(at: LinearisationPoint) -> LinearisedSimulator:
            matrix = listener.linearised()
            residual = listener.residual() + offset
            answer = self._answer(at.alpha, matrix, residual, covariance)
            now, most = np.inf, self._no_limit
            if _keeps(answer, at.alpha):  # else the objective is no measure, nor is the gap
                now = _misfit(errors.factor, residual) + _others(answer, at.alpha)
                most = limit
            return LinearisedSimulator(listener, at, matrix, errors, offset, answer, now, most)

        def settled(step: Taken[LinearisedSimulator]) -> bool:
            # The whole step counts: one that was shortened to little may be far from the minimum.
            moved = np.abs(step.model.answer.alpha - step.model.start.alpha)
            return bool(np.max(moved * self._inverse_sigma) < _SETTLED)

        path = gauss_newton(
            LinearisationPoint(listener.alpha, listener.heard),
            linearised,
            most=STEPS,
            halvings=_HALVINGS,
            settled=settled,
            refuse=True,
        )
        if path.end.heard is not None:  # steps that give nothing are refused
            listener.alpha, listener.heard = path.end.alpha, path.end.heard
        return path

    def _weighted(self, errors: FitErrors, weight: float) -> Array:
        """Return the errors' covariance where the squared gap in JND has a ``weight`` beside it."""
        if not weight:
            return errors.covariance
        information = np.linalg.inv(errors.covariance) + np.diag(weight / self._unit**2)
        return np.asarray(np.linalg.inv(information))

    def _answer(
        self, at: Array, matrix: Array, residual: Array, covariance: Array
    ) -> CalibrationResult:
        """Return the QP's answer with the simulator linearised at coefficients."""
        values = residual + matrix @ at.ravel()
        numbers = Observed(matrix=matrix, values=values, covariance=covariance)
        return self._problem.solve(self._times, observed={POSITIONS: numbers}, method="positions")

    def _is_nearer(self, listener: Listener, errors: FitErrors, answer: CalibrationResult) -> bool:
        """Return whether a listener with the scattering stated is nearer than the start."""
        values = [
            _misfit(errors.factor, residual) + _others(answer, alpha)
            for residual, alpha in (
                (listener.residual(), listener.alpha),
                (self._residual, self.room.alpha),
            )
        ]
        return values[0] <= values[1] and bool((listener.gaps() <= self._limit).all())

    def _better(
        self, best: Fitted | None, other: Fitted, scattering: FittedScattering
    ) -> Fitted | None:
        """Return the one with the lower objective, in which both have the errors of the second.

        The scattering's own deviations count, and its uncertainty does not. The second, with its
        ``scattering``, is not taken if its objective or its gap is above the start's.
        """
        listener, materials = other.listener, scattering.materials
        used, answer = listener.used, other.path.steps[-1].model.answer
        unknown = materials.covariance[np.ix_(used, used)]
        factor = np.asarray(np.linalg.cholesky(other.errors.covariance - unknown))

        def objective(residual: Array, alpha: Array, log_odds: Array) -> float:
            of_scattering = 0.5 * log_odds @ np.linalg.solve(materials.prior, log_odds)
            return _misfit(factor, residual) + _others(answer, alpha) + float(of_scattering)

        none = np.zeros(len(materials.traced))
        value = objective(listener.residual(), listener.alpha, materials.traced)
        if _keeps(answer, self.room.alpha):
            start = objective(self._residual, self.room.alpha, none)
            if value > start or (listener.gaps() > self._limit).any():
                return best
        if best is None or best.scattering is None:
            return other
        traced = best.scattering.materials.traced
        old = objective(best.listener.residual(), best.listener.alpha, traced)
        return other if value < old else best


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


def _misfit(factor: Array, residual: Array) -> float:
    """Return half the squares of a residual over its errors; ``factor`` is their Cholesky factor."""
    white = solve_triangular(factor, residual, lower=True)
    return 0.5 * float(white @ white)


def _unknowns(answer: CalibrationResult, alpha: Array) -> Array:
    """Return the unknowns of a problem with other coefficients."""
    layout = answer.joint.solution.model.data.layout
    u = answer.joint.solution.unknowns.copy()
    u[: layout.n_alpha] = alpha[layout.first].ravel()
    return np.asarray(u)


def _others(answer: CalibrationResult, alpha: Array) -> float:
    """Return the value of the objective's terms other than the positions."""
    model, u = answer.joint.solution.model, _unknowns(answer, alpha)
    terms = zip(model.objective.terms, model.data.weights, strict=True)
    return sum(w * t.value(u, model.data) for t, w in terms if t != POSITIONS)


_KEPT = 1e-9
"""By how much coefficients may miss a constraint that they keep, over the size of its row."""


def _keeps(answer: CalibrationResult, alpha: Array) -> bool:
    """Return whether coefficients keep the bounds and constraints of a problem."""
    model, u = answer.joint.solution.model, _unknowns(answer, alpha)
    slack = _KEPT * (1 + np.abs(u))
    if (u < model.lower - slack).any() or (u > model.upper + slack).any():
        return False
    values = np.asarray(model.matrix @ u)
    slack = _KEPT * (1 + np.abs(values))
    inside = (values >= model.row_lower - slack) & (values <= model.row_upper + slack)
    return bool(inside.all())
