"""Calibrate a simulator to the values at every position, by Gauss-Newton steps that are each a QP.

The steps are those of `rtcal.calibration.problem.fit`, with y what was measured, f what the simulator
gives, and C the covariance of the errors of both. No fit ends farther from what was measured than it
began: then the start is returned, and ``refused`` says so.

`PositionsResult` has what was fitted, what was learned, and its doubts.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotri
from scipy.special import chdtrc

from rtcal.acoustics.changes import Change, Variant
from rtcal.acoustics.marks import TrustMark, gap_jnd, of_input, rms
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import LEVEL, MATCH, REVERBERATION, observable, parameter_label
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import POSITION, CalibrationRecord, Room, checked_uncertainty
from rtcal.acoustics.room_errors import Assumptions, in_words, prior_covariance, value_changes
from rtcal.calibration.problem import Calibration, GaussNewtonStep, ModelObjective, fit
from rtcal.calibration.qp import Certificate
from rtcal.calibration.table import coefficients
from rtcal.calibration.terms import LinearObservations, Observed, PriorDeviation
from rtcal.files.saved import Result
from rtcal.loop.measured_pairs import (
    CONTRADICTION,
    DIGITS,
    GROUPS,
    MODELS,
    T30_ALONE,
    BeyondPrior,
    Compared,
    ControlRuns,
    ErrorsByScattering,
    MaterialScattering,
    MeasuredPairs,
    Pair,
    Scattering,
    ahead_factor,
    beyond_prior,
    by_band,
    errors_by_scattering,
    fitted,
    history,
    left,
    log_likelihood,
    material_scattering,
    mean_scattering,
    means,
    noise_of_a_run,
    of_level,
    pairs_to_match,
    refuse_known,
    rows_of_pairs,
    scattered,
    sentences,
    simulated_controls,
    trace_ahead,
    with_t30,
    without_place,
)
from rtcal.loop.predicted import WANTED, PositionsPrediction, predict_positions
from rtcal.modes.calibrate import ModesResult, above_schroeder
from rtcal.simulators import base
from rtcal.simulators.base import (
    Observations,
    Simulator,
    complete,
    jacobian,
    observe,
)
from rtcal.simulators.path_tracing import PathTracing, ScatteringModel
from rtcal.support import __version__, checks, text
from rtcal.support.blocks import Row
from rtcal.support.errors import DataError, FewPathsWarning, SimulatorError, TooShortError
from rtcal.support.speed import Progress
from rtcal.support.types import Array


def simulator_error(
    model: PairsModel,
    alpha: Array,
    controls: ControlRuns | None,
    groups: Array | None,
    fit_scattering: bool,
) -> tuple[Array, ErrorsByScattering | None]:
    """Return the covariance of the simulator's error, (n, n), and the errors by level of scattering.

    The n values are the measured parameters at all pairs of the simulator. ``controls`` are the errors
    in reference simulations; None if they are unknown. ``groups`` (n_groups, n_parameters, n_pairs,
    n_bands) are the values of groups of paths; None for a simulator without paths. The second result is
    None if the input scattering is kept: only the paths of a `PathTracing` with the model "random" show
    the effect of scattering.
    """
    parameters = model.data.observations.parameters
    if controls is None:
        error = np.array([observable(p).unknown_error for p in parameters])
        number = model.everywhere(alpha)[0].size
        return np.diag(np.repeat(error**2, number)), None
    controls = controls.at(parameters, model.pairs)
    noise = noise_of_a_run(model.simulator, groups)
    whole = controls.without_noise(noise).covariance()
    fitted = fit_scattering and complete(model.simulator).fits_scattering
    return whole, errors_by_scattering(controls, noise) if fitted else None


_MOST_UNEXPLAINED = 100.0
"""JND beyond which nothing is matched."""


def unexplained_errors(
    innovation: Array, expected: Array, unit: Array, parameter: NDArray[np.int64]
) -> Array:
    """Return each parameter's unexplained error in JND with which the data are most probable.

    This error is independent at each pair, because reference simulations vary what all pairs have in
    common, but neither furniture nor directivity, which affect single pairs. An error common to all
    pairs would also explain a T that deviates at every pair, so that T would not be fitted.

    ``innovation`` (n,) is measured minus simulated with the prior, ``expected`` (n, n) its covariance
    without the unexplained errors, ``unit`` (n,) one JND of each value, and ``parameter`` (n,) the
    number of its parameter. Variance components by maximum likelihood (Harville 1977, JASA 72,
    320-338).
    """
    from scipy.optimize import minimize

    square = unit**2
    number = int(parameter.max()) + 1

    def loss(variance: Array) -> tuple[float, Array]:
        covariance = expected + np.diag(variance[parameter] * square)
        factor = cho_factor(covariance, lower=True)
        pull = cho_solve(factor, innovation)
        of_variance = np.diag(dpotri(factor[0], lower=True)[0]) - pull**2
        slope = np.bincount(parameter, of_variance * square, minlength=number) / 2
        return 0.5 * float(innovation @ pull) + float(np.log(np.diag(factor[0])).sum()), slope

    # In variances: by a deviation the slope is 0 at 0, so that a search that came there would stay.
    found = minimize(
        loss,
        np.ones(number),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, _MOST_UNEXPLAINED**2)] * number,
    )
    return np.asarray(np.sqrt(found.x))


STEPS = 6
"""Largest number of steps of a fit with the same assumed errors."""
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
_TRIALS = 3
"""Most lengths of the last step, which lowers the gap."""
_INDISTINCT = 0.5
"""Rise of the objective in nats within which coefficients are indistinct from those of its minimum: one
standard deviation."""
FITS = 0.5
"""Deviation in JND, as root mean square over all matched values, below which no fit is needed: it is
within the noise of the path tracing."""

POSITIONS = LinearObservations("positions")


_LEAST_SCATTERING = 0.02
"""Scattering below which paths are followed for no longer."""
_AHEAD = 2.0
"""How many times Eyring's T the paths with another scattering are followed at least, where as much is
scattered as stated. Where less is, they are followed for longer in proportion: in one of ten judged
rooms they were traced three times with 2.0 alone."""


class PairsModel:
    """Compute a simulator's values at the measured pairs, and their derivatives, for any alpha.

    Results are kept, so that nothing is simulated twice; ``calls`` is the number of simulations and
    derivatives so far. ``used`` (n_used,) are the numbers of the used values among the measured
    parameters at all pairs. ``of_level`` (n_used,) is True for values that are levels.
    """

    def __init__(
        self, simulator: Any, data: MeasuredPairs, alpha: Array, first: Observations, seed: int
    ) -> None:
        """Begin with what is simulated for an alpha, also of parameters that are not matched."""
        self.simulator, self.data, self.seed, self.calls = simulator, data, seed, 1
        self.pairs, matched = first.pairs, data.observations
        self.used, self.unit = data.among(first.pairs), matched.one_jnd[data.used]
        self.of_level = of_level(matched.parameters, *data.used.shape[1:])[data.used.ravel()]
        self._rows = [first.parameters.index(p) for p in matched.parameters]
        self._columns = [first.pairs.index(pair) for pair in matched.pairs]
        self._parameters = first.parameters
        self._values, self._slopes = {alpha.tobytes(): first}, dict[bytes, Array]()

    def simulated(self, alpha: Array) -> Observations:
        """Return the simulated values at all pairs, including parameters that are not matched."""
        key = alpha.tobytes()
        if key not in self._values:
            self.calls += 1
            found = observe(self.simulator, alpha, self._parameters, seed=self.seed)
            self._values[key] = found
        return self._values[key]

    def everywhere(self, alpha: Array) -> Array:
        """Return the matched parameters at all pairs, (n_parameters, n_all_pairs, n_bands)."""
        return np.asarray(self.simulated(alpha).values[self._rows])

    def values(self, alpha: Array) -> Array:
        """Return the simulated values at the measured pairs, (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.everywhere(alpha)[:, self._columns])

    def residual(self, alpha: Array) -> Array:
        """Return measured less simulated, (n_used,)."""
        return np.asarray((self.data.observations.values - self.values(alpha))[self.data.used])

    def gaps(self, alpha: Array) -> Array:
        """Return root mean square deviations in JND: of all matched values, and of each parameter."""
        gap = self.data.gap(self.values(alpha))
        return np.array([rms(gap), *rms(gap, axis=(1, 2))])

    def jacobian(self, alpha: Array) -> Array:
        """Return the derivatives of the values used, (n_used, n_materials * n_bands)."""
        key = alpha.tobytes()
        if key not in self._slopes:
            self.calls += 1
            of = self.data.observations.parameters
            slopes = jacobian(self.simulator, alpha, of, seed=self.seed)[:, self._columns]
            self._slopes[key] = by_band(slopes)[self.data.used.ravel()]
        return self._slopes[key]

    def scattered(self, alpha: Array, tracer: PathTracing, change: Array) -> PairsModel:
        """Return a model of this kind for ``tracer``, which differs from its simulator in scattering.

        It begins at the coefficients ``alpha``. ``change`` (n,) is the expected change of all values,
        from which the necessary length of the paths follows.
        """
        likely = self.everywhere(alpha)
        likely = likely + change.reshape(likely.shape)
        now, then = (
            mean_scattering(of.scattering, of.room.areas) for of in (self.simulator, tracer)
        )
        less = max(now / max(then, _LEAST_SCATTERING), 1.0)  # times that it scatters less than now
        needed = ahead_factor(self.data.observations.parameters, likely, tracer, alpha)
        tracer.trace_ahead(alpha, max(_AHEAD * less, needed), seed=self.seed)
        first = tracer.observe(alpha, self._parameters, seed=self.seed)
        return PairsModel(tracer, self.data, alpha, first, self.seed)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Hold a point of a fit, with the model there and its errors, as an `Observation`.

    ``materials`` has the effect of each material's scattering, and no materials if the input scattering
    is kept. ``error`` (n, n) is the covariance of the simulator's error at all values, including that
    by unknown scattering. ``unexplained`` (n_parameters,) is the standard deviation in JND of the
    unexplained error. ``covariance`` (n_used, n_used) is that of all errors: of measurement, room and
    simulator, and unexplained. ``path`` has the last steps of the fit; None before the first step.
    ``refused`` is True if no step decreased the deviation, so that the point is the start.
    """

    model: PairsModel
    alpha: Array
    materials: MaterialScattering
    error: Array
    unexplained: Array
    covariance: Array
    path: Any = None
    refused: bool = False

    @property
    def offset(self) -> Array:
        """Values with the traced scattering minus those with the input scattering, (n_used,)."""
        return np.asarray(-self.materials.back[self.model.used])

    @property
    def values(self) -> Array:
        """The measured values used, (n_used,), corrected to the traced scattering."""
        data = self.model.data
        return np.asarray(data.observations.values[data.used] + self.offset)

    def predict(self, alpha: Array) -> Array:
        """Return the simulated values used, (n_used,)."""
        return np.asarray(self.model.values(alpha)[self.model.data.used])

    def jacobian(self, alpha: Array) -> Array:
        """Return the derivatives of the used values by alpha, (n_used, n_materials * n_bands)."""
        return self.model.jacobian(alpha)

    @property
    def residual(self) -> Array:
        """Measured minus simulated values with the input scattering, by derivatives, (n_used,)."""
        return self.model.residual(self.alpha) + self.offset

    @property
    def gaps(self) -> Array:
        """Root mean square deviations in JND: of all matched values, and of each parameter."""
        return self.model.gaps(self.alpha)

    @property
    def pull(self) -> Array:
        """Inverse covariance times the residual, (n,): 0 where nothing was measured."""
        pull = np.zeros(len(self.error))
        pull[self.model.used] = np.linalg.solve(self.covariance, self.residual)
        return pull

    def objective(self, unknown: Array | float = 0.0) -> ModelObjective:
        """Return the objective with the simulator itself, without a covariance that is not known."""
        factor = np.asarray(np.linalg.cholesky(self.covariance - unknown))
        return ModelObjective(self.path.answer, POSITIONS, factor)


class PositionsFit:
    """Fit alpha, and the scattering of a `PathTracing`, to the values at every position.

    The fit starts at the coefficients of ``room``. ``calibration`` has the prior, further terms and
    constraints. T of ``measured`` is used only by terms of the calibration that match T. ``error`` (n,
    n) is the covariance of the simulator's error with the input scattering. ``by_scattering`` has the
    errors by level of scattering; None if the scattering is not fitted.

    A step is taken only if a simulation shows that the objective decreases, and that the deviation of
    all matched values remains below that of the start. The unexplained errors (`unexplained_errors`)
    are determined where these steps end, and further steps follow with these errors.
    """

    def __init__(
        self,
        model: PairsModel,
        room: Room,
        calibration: Calibration | None,
        measured: Measurement,
        prior: Array,
        error: Array,
        by_scattering: ErrorsByScattering | None,
    ) -> None:
        self.model, self.start, self.room, self.prior = model, room.alpha, room, prior
        self.error, self.by_scattering = error, by_scattering
        objective: Any = PriorDeviation(
            band_correlation=room.band_correlation,
            material_correlation=room.material_correlation,
            common=room.common_alpha_sigma > 0,
        )
        constraints: Any = ()
        if calibration is not None:
            objective, constraints = calibration.objective, calibration.constraints
        self._problem = Calibration(objective + POSITIONS, constraints).build(room)
        self._times = None if calibration is None else measured
        self._residual, self._gaps = model.residual(self.start), model.gaps(self.start)
        # No parameter is given up for the others, but for what is no more than noise.
        self._limit = np.array([self._gaps[0], *np.maximum(self._gaps[1:], FITS)])
        self._parameter = np.nonzero(model.data.used)[0]
        self._others: list[PairsModel] = []

    @property
    def calls(self) -> int:
        """Number of simulations and derivatives."""
        return sum(model.calls for model in (self.model, *self._others))

    def run(self) -> Fitted:
        """Return where the fit ends."""
        ended = None
        if self.by_scattering is not None:
            ended = self._with_other_scattering(self._with_stated_scattering(guarded=False))
        ended = ended or self._with_stated_scattering(guarded=True)
        return ended if ended.refused or ended.gaps[0] <= FITS else self._closer(ended)

    def _closer(self, ended: Fitted) -> Fitted:
        """Return a point with a smaller gap where the objective is indistinct from its minimum.

        An error of the simulator that all bands have in common counts once, and the deviation of every
        coefficient by itself: so coefficients that all are off by the same factor leave a part of the
        gap at the minimum.
        """
        objective, alpha, gaps = ended.objective(), ended.alpha, ended.gaps
        residual, matrix = ended.residual, ended.jacobian(alpha)
        least = objective.value(alpha, residual)
        most = min(least + _INDISTINCT, objective.value(self.start, self._residual))
        nearer = Observed(
            matrix=matrix,
            values=residual + matrix @ alpha.ravel(),
            covariance=self._weighted(ended, _GAP_WEIGHTS[0]),
        )
        answer = self._problem.solve(self._times, observed={POSITIONS: nearer}, method="positions")
        way = answer.alpha - alpha
        rise = objective.value(alpha + way, residual - matrix @ way.ravel()) - least
        share = np.sqrt(_INDISTINCT / max(rise, _INDISTINCT))
        limit = np.maximum(gaps, FITS)
        for _ in range(_TRIALS):
            moved = replace(ended, alpha=alpha + share * way)
            with suppress(DataError, SimulatorError):  # a decay without a time
                now = moved.gaps
                inside = objective.value(moved.alpha, moved.residual) <= most
                if inside and now[0] < gaps[0] and (now <= limit).all():
                    return moved
            share /= 2
        return ended

    def _with_stated_scattering(self, *, guarded: bool) -> Fitted:
        """Return where alpha ends with the scattering stated.

        If ``guarded``, no farther than the start. Else the scattering is still to be fitted.
        """
        # The first steps only lead near: with errors that were found at the start, where a simulator
        # is far from what was measured, its curvature would count as an error.
        nothing = np.zeros(len(self.model.data.used))
        at = self._steps(self._point(self.model, self.start, unexplained=nothing), np.inf)
        for _ in range(_PASSES):
            before, path = at.unexplained, at.path
            at = replace(self._point(self.model, at.alpha), path=path)
            objective = at.objective()
            now = objective.value(at.alpha, at.residual)
            start = objective.value(self.start, self._residual)
            begins_right = guarded and bool(np.isfinite(start))
            if begins_right and not (now <= start and (at.gaps <= self._limit).all()):
                at = replace(at, alpha=self.start)
            at = self._steps(at, self._limit if begins_right else np.inf)
            if np.abs(at.unexplained - before).max() < _ALIKE:
                break
        misses = guarded and self._gaps[0] > FITS
        for weight in _GAP_WEIGHTS if misses else ():
            if not np.array_equal(at.alpha, self.start):
                break
            # The objective falls along its own step and the gap rises: a step may lower both.
            at = self._steps(self._steps(at, self._limit, weight), self._limit)
        return replace(at, refused=misses and np.array_equal(at.alpha, self.start))

    def _with_other_scattering(self, free: Fitted) -> Fitted | None:
        """Return the nearest of the fits with scattering fitted, too; None if none is near."""
        best, at, model = self._better(None, free), free, free.model
        stated, tracer = free.materials, model.simulator
        meaning, change, log_odds = self._first_scattering(free, stated)
        if meaning == stated.model and not log_odds.any():
            return best
        for _ in range(_ROUNDS):
            other = scattered(tracer, log_odds, meaning)
            try:
                model = model.scattered(at.alpha, other, change)
            except TooShortError:  # with so little scattering no decay ends
                break
            self._others.append(model)
            # Only paths of the model "random" tell the slopes; those of the other serve for both.
            materials = self._materials(model, at.alpha) if meaning == "random" else stated
            materials = replace(materials, traced=log_odds, model=meaning)
            at = replace(self._point(model, at.alpha, materials), path=at.path)
            best = self._better(best, at)
            at = self._steps(at, np.inf)
            best = self._better(best, at)
            likely = materials.likely(at.pull).round(DIGITS)
            if np.abs(likely - log_odds).max() < _SETTLED_ODDS:
                break
            change, log_odds = materials.slope @ (likely - log_odds), likely
        return best

    def _first_scattering(
        self, kept: Fitted, materials: MaterialScattering
    ) -> tuple[ScatteringModel, Array, Array]:
        """Return the likelier model, the change of all values that is expected, and the log odds."""
        used, matrix = kept.model.used, kept.jacobian(kept.alpha)
        innovation = kept.model.residual(kept.alpha) + matrix @ (kept.alpha - self.start).ravel()
        of_data = kept.covariance - kept.error[np.ix_(used, used)]
        found = []
        for meaning in MODELS:
            added = np.zeros(len(materials.slope))
            if meaning == "vector" and self.by_scattering is not None:
                added = self.by_scattering.of_model.ravel()
            error = self._error(kept.model, replace(materials, model=meaning))
            left = innovation - added[used]
            whole = matrix @ self.prior @ matrix.T + of_data + error[np.ix_(used, used)]
            pull = np.zeros(len(added))
            pull[used] = np.linalg.solve(whole, left)
            log_odds = materials.likely(pull).round(DIGITS)
            found.append((log_likelihood(left, whole), meaning, added, log_odds))
        _, meaning, added, log_odds = max(found, key=lambda of: of[0])
        return meaning, added + materials.slope @ log_odds, log_odds

    def _materials(self, model: PairsModel, alpha: Array) -> MaterialScattering:
        """Return what the scattering of a tracing does; of no materials where it is kept."""
        if self.by_scattering is None:
            return MaterialScattering(slope=np.zeros((len(self.error), 0)), traced=np.zeros(0))
        parameters = model.data.observations.parameters
        return material_scattering(model.simulator, alpha, parameters, model.seed)

    def _error(self, model: PairsModel, materials: MaterialScattering) -> Array:
        """Return the covariance of the simulator's error, with the scattering not known, (n, n)."""
        if self.by_scattering is None:
            return self.error
        at = mean_scattering(model.simulator.scattering, model.simulator.room.areas)
        return self.by_scattering.covariance(at, materials.model) + materials.covariance

    def _point(
        self,
        model: PairsModel,
        alpha: Array,
        materials: MaterialScattering | None = None,
        unexplained: Array | None = None,
    ) -> Fitted:
        """Return a point and its errors; the ``unexplained`` ones are found if None.

        ``materials`` is by default what the scattering stated does there.
        """
        materials = materials or self._materials(model, alpha)
        error, matrix = self._error(model, materials), model.jacobian(alpha)
        of_room = value_changes(self.room, matrix, model.of_level)
        known = model.data.covariance + of_room.T @ of_room
        known = known + error[np.ix_(model.used, model.used)]
        at = Fitted(model, alpha, materials, error, np.zeros(0), known)
        if unexplained is None:
            innovation = at.residual + matrix @ (alpha - self.start).ravel()
            expected = matrix @ self.prior @ matrix.T + known
            unexplained = unexplained_errors(innovation, expected, model.unit, self._parameter)
        own = np.diag((unexplained[self._parameter] * model.unit) ** 2)
        return replace(at, unexplained=unexplained, covariance=known + own)

    def _steps(self, at: Fitted, limit: Array | float, weight: float = 0.0) -> Fitted:
        """Return where Gauss-Newton steps from a point end.

        ``weight`` is that of the squared gap in JND, which the steps lower beside the objective.
        """
        path = fit(
            self._problem,
            at,
            at.alpha,
            term=POSITIONS,
            method="positions",
            times=self._times,
            most=STEPS,
            covariance=self._weighted(at, weight),
            allowed=lambda end: not (at.model.gaps(end) > limit).any(),
        )
        return replace(at, alpha=path.alpha, path=path)

    def _weighted(self, at: Fitted, weight: float) -> Array:
        """Return the errors' covariance where the squared gap in JND has a ``weight`` beside it."""
        if not weight:
            return at.covariance
        information = np.linalg.inv(at.covariance) + np.diag(weight / at.model.unit**2)
        found = np.linalg.inv(information)
        # Rounding, which large references make large, leaves it asymmetric.
        return np.asarray(found + found.T) / 2

    def _better(self, best: Fitted | None, other: Fitted) -> Fitted | None:
        """Return the one with the lower objective, in which both have the errors of the second.

        The scattering's own deviations count, and its uncertainty does not. The second is not taken if
        its objective or its gap is above the start's.
        """
        used = other.model.used
        objective = other.objective(other.materials.covariance[np.ix_(used, used)])

        def value(at: Fitted) -> float:
            log_odds = at.materials.traced
            of_scattering = log_odds @ np.linalg.solve(at.materials.prior, log_odds)
            residual = at.model.residual(at.alpha)
            return objective.value(at.alpha, residual) + 0.5 * float(of_scattering)

        start, now = objective.value(self.start, self._residual), value(other)
        if np.isfinite(start) and (now > start or (other.gaps > self._limit).any()):
            return best
        return other if best is None or now < value(best) else best


MORE_PATHS = 4
"""Factor on the number of paths in a fit: with 6000 paths, EDT of a pair has a noise of 2 to 9 %."""
_BATCHES = 16
"""Batches of the paths that are weighed; a multiple of `simulator_error.GROUPS`."""


def calibrate_positions(
    simulator: Simulator,
    room: Room | ModesResult,
    measured: Measurement,
    match: Sequence[str] = MATCH,
    *,
    exclude: Sequence[Pair] = (),
    calibration: Calibration | None = None,
    controls: ControlRuns | None = None,
    cache: str | os.PathLike[str] | None = None,
    position_uncertainty: float = POSITION,
    fit_scattering: bool = True,
    more_paths: int = MORE_PATHS,
    seed: int = 0,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> PositionsResult:
    """Calibrate a room's coefficients so that a simulator gives the measured values at every position.

    If no coefficients with a smaller mean deviation are found than the input ones, these are returned,
    and the result's ``refused`` is True. If a deviation above 0.5 JND is left, nearly optimal
    coefficients with a smaller deviation are returned.

    Parameters
    ----------
    simulator : Simulator
        Simulator of the room. A `PathTracing` is run with more paths.
    room : Room or ModesResult
        Room with your input alpha and sigma. In a result of ``calibrate_modes(room, ...)`` without T,
        the measured modes replace the measurement below the Schroeder frequency, and their coefficients
        are kept.
    measured : Measurement
        Measurement of source-receiver pairs that the simulator has, too.
    match : sequence of str
        Keys of the parameters to match at every pair (`rtcal.acoustics.observables`), by default T20,
        EDT, C80, Ts and level. "g" is the measured G, and "level" is a level with a common reference at
        all positions of a source. Of these, those are matched that were measured.
    exclude : sequence of (source, receiver)
        Names of measured pairs that are left out.
    calibration : Calibration, optional
        Further terms and constraints for the coefficients. By default only your input alpha and sigma
        count, besides the measurement.
    controls : ControlRuns, optional
        Error of the simulator, for example ``result.controls`` of an earlier calibration. By default
        rtcal simulates it for a simulator that has a geometry (`rtcal.loop.measured_pairs`). For other
        simulators the error is unknown, and the result has no interval.
    cache : path, optional
        Folder in which the reference simulations are kept.
    position_uncertainty : float
        Standard uncertainty of the positions of sources and receivers in m, at most 1.
    fit_scattering : bool
        Whether the scattering coefficients of a `PathTracing` with the model "random" are fitted, too.
        If not, the input scattering is kept and counts as uncertain.
    more_paths : int
        Factor on the number of paths of a `PathTracing`, in addition to the factor 3 of
        `PathTracing.denser`.
    seed : int
        Seed of all simulations.
    progress : callable, optional
        Function that is called with the numbers of finished and of all reference simulations.
    scheduler : str, optional
        Address of a Dask scheduler whose workers run the reference simulations; default: this machine.

    Returns
    -------
    PositionsResult
        Result whose ``room`` has the calibrated coefficients, with the values before and after.

    Raises
    ------
    SimulatorError, TooShortError
        If the simulator raises them.
    ClusterError
        If the scheduler fails.
    DataError
        If simulator and room differ in materials or bands, if an argument breaks its rule, or if the
        measurement has no pair in common with the simulator, or none of the parameters.

    Examples
    --------
    >>> import rtcal as rt
    >>> hall = rt.datasets.halls.corridor()
    >>> tracer = rt.simulators.PathTracing(
    ...     room=hall.room, geometry=hall.geometry, sources=hall.sources,
    ...     receivers=hall.receivers, n_paths=800)
    >>> measured = tracer.simulate(0.8 * hall.room.alpha, seed=1)
    >>> controls = rt.loop.ControlRuns(
    ...     parameters=("t20",), pairs=tracer.pairs,
    ...     errors=0.1 * np.ones((4, 1, len(tracer.pairs), hall.room.n_bands)))
    >>> result = rt.calibrate_positions(
    ...     tracer, hall.room, measured, ("t20",), controls=controls)
    >>> len(result.pairs)
    4
    """
    modes = room if isinstance(room, ModesResult) else None
    room = room.prior if isinstance(room, ModesResult) else room
    base.check_fits(simulator, room)
    match = base.checked_parameters(match)
    exclude = checks.pairs("exclude", exclude)
    checks.whole("seed", seed, 0)
    checks.flag("fit_scattering", fit_scattering)
    checked_uncertainty(position_uncertainty)
    if calibration is not None:
        checks.instance("calibration", calibration, Calibration)
    measured, repeated = base.at_places(simulator, measured)
    if modes is not None:
        low = modes.in_loop(measured)
        room, measured = low.room, above_schroeder(measured, room, low.below)
        repeated = (*repeated, low.loop_note)
    given, wanted = simulator, with_t30(match, measured)
    of_t30 = [T30_ALONE] if wanted != tuple(match) else []
    tracer = simulator if complete(simulator).tracing is simulator else None
    if tracer is not None:
        # Data that were used before are refused before the paths are traced.
        kept = [p for p in measured.pairs if p in tracer.pairs and p not in exclude]
        refuse_known(room, measured, wanted, kept)
    simulator = precise(simulator, more_paths)
    trace_ahead(simulator, room.alpha, seed)
    able = complete(simulator)
    match, first, not_given = _first(simulator, room.alpha, able.trusted(wanted), measured, seed)
    data = pairs_to_match(room, measured, match, first, exclude)
    notes = [*without_place(measured, first.pairs), *of_t30, *not_given, *able.notes, *repeated]
    if stated := in_words(room):
        notes.append(f"The uncertainty of the room counts: {stated}.")
    matched = data.observations
    _refuse_one_place(simulator, matched.pairs, position_uncertainty)
    # Of too few paths a warning comes before the reference simulations.
    groups = able.observe_in_groups(room.alpha, GROUPS, match, seed=seed)
    if groups is not None and tracer is not None:
        _tell_noise(groups, match, tracer)
    if controls is None:
        controls = simulated_controls(
            simulator,
            room,
            match,
            seed=seed,
            position_uncertainty=position_uncertainty,
            cache=cache,
            progress=progress,
            scheduler=scheduler,
        )
    model = PairsModel(simulator, data, room.alpha, first, seed)
    prior = prior_covariance(room)
    if groups is not None:
        groups = groups[:, [match.index(p) for p in matched.parameters]]
    error, by_scattering = simulator_error(model, room.alpha, controls, groups, fit_scattering)
    beyond = beyond_prior(model, room, prior, error)
    by_scattering = None if beyond else by_scattering
    of_fit = PositionsFit(model, room, calibration, measured, prior, error, by_scattering)
    ended = of_fit.run()
    alpha, path, matrix = ended.alpha, ended.path, ended.path.steps[-1].matrix
    scattering, start = None, None if tracer is None else tracer.scattering
    weighed = None
    if by_scattering is not None and tracer is not None:
        weighed = ended.model.simulator.afresh()
        of_weighed = {n: getattr(weighed, n) for n in ("scattering", "scattering_model")}
        given = tracer = weighed if tracer is simulator else replace(tracer, **of_weighed)
        unknown = ended.covariance + matrix @ prior @ matrix.T
        posterior = ended.materials.posterior(ended.model.used, unknown)
        scattering = fitted(tracer, ended.materials.traced, posterior)
    elif fit_scattering and tracer is not None:
        notes.append(_kept(tracer, beyond))
    name = given.name + ("" if scattering is None else f", scattering {scattering.mean:.2f}")
    after = ended.model.simulated(alpha)

    def compared(parameters: Sequence[str], pairs: Sequence[Pair]) -> Compared:
        in_room = measured.in_bands(room.centre_frequencies)
        return Compared.of(in_room, parameters, pairs, first, after)

    # A relative level has no reference at a pair that is left out.
    held_out = compared([p for p in matched.parameters if p != LEVEL.key], exclude)
    return PositionsResult(
        prior=room,
        room=room if ended.refused else _calibrated(room, given, name, ended, data, controls),
        simulator=name,
        tracer=given,
        weighed=weighed or precise(given, more_paths),
        seed=seed,
        scattering=scattering,
        start=start,
        simulations=of_fit.calls,
        measured=data,
        matched=Compared(
            measured=matched,
            before=first.at(matched),
            after=after.at(matched),
            relative=data.level == "relative",
        ),
        beside=compared(
            [p for p in first.parameters if p not in matched.parameters], matched.pairs
        ),
        held_out=held_out if held_out.parameters else None,
        predicted=_predicted(ended, with_error=controls is not None),
        controls=controls,
        unexplained=ended.unexplained,
        innovation=ended.residual + matrix @ (alpha - room.alpha).ravel(),
        covariance=ended.covariance,
        prior_covariance=prior,
        steps=path.steps,
        settled=path.settled,
        refused=ended.refused,
        beyond=beyond,
        notes=(*notes, *data.notes, *base.lost_paths(simulator)),
    )


def _predicted(ended: Fitted, *, with_error: bool) -> Observations:
    """Return the values at every position, with the simulator's error as the measured pairs tell it.

    The error's mean given the residual r at the measured pairs: D_all (R + D)⁻¹ r, D_all its
    covariance between all values and those used.
    """
    values = ended.model.everywhere(ended.alpha)
    if with_error:
        error = ended.error @ ended.pull + ended.materials.back
        values = values + error.reshape(values.shape)
    matched = ended.model.data.observations
    return replace(matched, pairs=ended.model.pairs, values=values)


def _calibrated(
    room: Room,
    simulator: Simulator,
    name: str,
    ended: Fitted,
    data: MeasuredPairs,
    controls: ControlRuns | None,
) -> Room:
    """Return the room with its coefficients, their sigma where it is known, and a record.

    It has the scattering coefficients of a `PathTracing` and their meaning, too.
    """
    answer = ended.path.answer
    record = CalibrationRecord(
        method="positions",
        equation=f"every position of {name}",
        measured=" ".join([*history(room), *data.fingerprints]),
        solver=answer.joint.solver,
        version=__version__,
    )
    sigma = room.sigma if controls is None else np.minimum(answer.posterior_sigma, 1.0)
    if complete(simulator).tracing is simulator:
        room = room.replace(
            scattering=simulator.scattering, scattering_model=simulator.scattering_model
        )
    return room.replace(alpha=np.clip(ended.alpha, 0.0, 1.0), sigma=sigma, calibration=record)


def _first(
    simulator: Simulator, alpha: Array, match: tuple[str, ...], measured: Measurement, seed: int
) -> tuple[tuple[str, ...], Observations, tuple[str, ...]]:
    """Return the parameters that are matched, and the simulated values with the prior.

    Those are also of what was measured and is not matched. Notes name what the simulator does not give.
    """
    more = [p for p in means(measured) if p not in match]
    if base.derivatives(simulator) is not None:
        try:
            return match, observe(simulator, alpha, (*match, *more), seed=seed), ()
        except DataError:
            if not more:
                raise
        names = ", ".join(map(parameter_label, more))
        note = f"The simulated decays do not hold {names}, which cannot be shown."
        return match, observe(simulator, alpha, match, seed=seed), (note,)
    simulated = base.run(simulator, alpha, seed=seed)
    given = base.given(simulated)
    kept = tuple(p for p in match if p in given)
    if not kept:
        raise SimulatorError(
            f"{simulator.name} calculates none of "
            f"{', '.join(map(parameter_label, match))}; match other parameters"
        )
    shown = (*kept, *(p for p in more if p in given))
    first = Observations.of_measurement(simulated, shown, simulated.pairs)
    absent = ", ".join(parameter_label(p) for p in match if p not in given)
    note = f"The simulator does not give {absent}, which cannot be matched."
    return kept, first, (note,) if absent else ()


def _refuse_one_place(simulator: Simulator, pairs: Sequence[Pair], uncertainty: float) -> None:
    """Raise DataError if several pairs stand where one does: they tell no more than one."""
    sources, receivers = (getattr(simulator, kind, None) for kind in ("sources", "receivers"))
    if len(pairs) < 2 or not isinstance(sources, Mapping) or not isinstance(receivers, Mapping):
        return
    places = np.array([[*sources[s], *receivers[r]] for s, r in pairs], dtype=float)
    if np.max(np.linalg.norm(places - places[0], axis=1)) <= uncertainty:
        raise DataError(
            f"all {len(pairs)} pairs are at the same position, within the position uncertainty "
            f"of {uncertainty:g} m; calibrating to every position needs at least two different "
            "ones"
        )


def precise(simulator: Any, more_paths: int = MORE_PATHS) -> Any:
    """Return the simulator with as many paths as the fit uses."""
    return complete(simulator).denser(more_paths, _BATCHES)


NOISE = 0.5
"""Largest accepted noise in JND of the paths of a fit, as root mean square over pairs and bands."""


def _tell_noise(groups: Array, match: Sequence[str], tracer: PathTracing) -> None:
    """Warn where the paths are so few that the noise of a parameter is above `NOISE`.

    ``groups`` (n_groups, n_parameters, n_pairs, n_bands) are those of all paths.
    """
    spread = groups.std(axis=0, ddof=1) / len(groups) ** 0.5
    noise = {}
    for name, middle, error in zip(match, groups.mean(axis=0), spread, strict=True):
        kind = observable(name)
        ends = gap_jnd(kind.natural(middle + error), kind.natural(middle), name)
        noise[name] = float(rms(ends))
    worst = max(noise, key=lambda name: noise[name])
    if noise[worst] <= NOISE:
        return
    enough = math.ceil(tracer.n_paths * (noise[worst] / NOISE) ** 2 / 100) * 100
    warnings.warn(
        f"{tracer.n_paths} paths from each source are too few: {parameter_label(worst)} of "
        f"a source-receiver pair has a noise of {noise[worst]:.2g} JND, but it should be "
        f"at most {NOISE:g} JND. Use {enough} paths or more",
        FewPathsWarning,
        stacklevel=checks.stack_level(),
    )


def _kept(tracer: PathTracing, beyond: BeyondPrior | None) -> str:
    """Return why the scattering was not fitted."""
    why = "there are too few reference simulations"
    if beyond is not None:
        why = "no scattering can correct wrong coefficients"
    elif tracer.scattering_model != "random":
        why = 'rtcal fits it with the model "random" only'
    elif np.isin(tracer.scattering, (0.0, 1.0)).all():
        why = "coefficients of 0 and 1 are not changed"
    return f"The input scattering was kept, because {why}."


_REFUSED = (
    "No step reduced the deviation from the measurement, so the start is returned and nothing was "
    "fitted. Enter larger sigmas or more paths, or look for what is missing from the model "
    "(rtcal find)."
)
_MISFIT = 2.0
"""Misfit from which a pair is named: twice the chi-square that is usual in this room."""
_FARTHER = 0.5
"""JND: the noise of a tracing. A larger rise of the mean gap is the calibration's."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsResult(Result):
    """Hold the coefficients with which a simulator fits the measured values at every position.

    ``seed`` is that of the random numbers of the simulator, and ``steps`` are the steps of the fit.
    """

    record_kind: ClassVar[str] = "positions 1"
    words_in: ClassVar[str] = "rtcal.report.of_positions"
    in_file: ClassVar[str] = (
        "room=prior.name author=prior.author simulator simulations scattering "
        "centre_frequencies=prior.centre_frequencies parameters pairs level=measured.level matched "
        "not_matched=beside held_out materials pulls misfit contradictions "
        "unexplained_jnd=unexplained refused beyond_prior=beyond settled "
        "worst_certificate=certificate.worst notes=every_note"
    )

    prior: Room
    """Room as it was given, with your input alpha and sigma."""
    room: Room
    """Room with the calibrated coefficients, their uncertainty sigma, and a record of the
    calibration."""
    simulator: str
    """Name of the simulator and its scattering. The coefficients are valid only for this simulator."""
    tracer: Simulator
    """Simulator for which the coefficients are valid: the one that was given, with the fitted
    scattering. Do not calibrate it to the same data again, because its scattering comes from them."""
    weighed: Simulator
    """Same simulator with as many paths as the fit used."""
    seed: int
    scattering: Scattering | None
    """Scattering that was fitted; None if the input scattering was kept."""
    simulations: int
    """Number of evaluations of the simulator or its derivatives, without reference simulations. A
    `PathTracing` re-weights the same traced paths in each."""
    measured: MeasuredPairs
    """Measured values that were matched; ``observations`` has their parameters and pairs."""
    matched: Compared
    """Values of the matched parameters: measured, simulated with the input coefficients, and simulated
    by ``tracer`` with the calibrated coefficients."""
    beside: Compared
    """Values of the measured parameters that were not matched, before and after the calibration."""
    predicted: Observations
    """Simulated values at all positions with the calibrated coefficients, including pairs that were not
    measured. If reference simulations give the simulator's error, the part of it that all pairs have in
    common is corrected."""
    controls: ControlRuns | None
    """Error of the simulator, which you can give to another calibration. None if it is unknown."""
    unexplained: Array
    """Standard deviation in JND of the differences between simulator and measurement beyond all known
    errors, estimated for each parameter, (n_parameters,)."""
    innovation: Array
    covariance: Array
    """Measured minus simulated values, extrapolated to the input coefficients, (n_used,), and the
    covariance of their errors by measurement and simulator, (n_used, n_used)."""
    prior_covariance: Array
    """Covariance of the input alpha, (n_materials * n_bands, n_materials * n_bands)."""
    steps: tuple[GaussNewtonStep, ...]
    settled: bool
    """Whether the fit has converged: the last step changed alpha by less than 0.05 of its input
    sigma."""
    notes: tuple[str, ...]
    """Notes on what was left out, and why."""
    refused: bool = False
    """Whether no step came nearer to the measurement, so that the room is returned as it was given."""
    beyond: BeyondPrior | None = None
    """Measured T that your input coefficients cannot explain within their sigma; None if they can."""
    held_out: Compared | None = None
    """Values at the pairs that were excluded, measured, before and after the calibration; without the
    level."""
    start: Array | None = None
    """Scattering coefficients at which the fit started, (n_materials, n_bands); None for a simulator
    without scattering."""

    def predict(
        self,
        changes: Change | Sequence[Change],
        *,
        wanted: Sequence[str] = WANTED,
        name: str = "",
        assumptions: Assumptions | None = None,
    ) -> PositionsPrediction:
        """Predict the values at every position after a change of this room.

        For the arguments and errors see `rtcal.loop.predict_positions`, which predicts several variants
        at once.

        ``changes`` are made in the given order. ``wanted`` are the keys of the parameters to predict,
        ``name`` is the name of the variant, by default the words of its changes, and ``assumptions``
        are what is assumed about the changes.
        """
        made = (changes,) if isinstance(changes, Change) else tuple(changes)
        variant = Variant(name or "; ".join(map(str, made)) or "no change", made)
        predicted: PositionsPrediction = predict_positions(
            self, [variant], wanted=wanted, assumptions=assumptions
        ).predictions[0]
        return predicted

    @property
    def alpha(self) -> Array:
        """Calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def sigma(self) -> Array:
        """Standard uncertainty of the calibrated alpha, (n_materials, n_bands), ignoring the bounds."""
        return self.steps[-1].answer.posterior_sigma

    @property
    def certificate(self) -> Certificate:
        """Numerical error bounds of the last step's optimum."""
        return self.steps[-1].answer.certificate

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """Lower and upper end of alpha's 90 % interval within 0 and 1, (n_materials, n_bands) each.

        The result is None if there are no reference simulations, because the simulator's error is then
        unknown.
        """
        if self.controls is None:
            return None
        half = NORMAL_90 * self.sigma
        return np.clip(self.alpha - half, 0, 1), np.clip(self.alpha + half, 0, 1)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that were matched."""
        return self.measured.observations.parameters

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Source-receiver pairs that were matched."""
        return self.measured.observations.pairs

    @property
    def gap_before(self) -> Array:
        """Deviation with the input coefficients, simulated minus measured, in JND.

        The shape is (n_parameters, n_pairs, n_bands).
        """
        return self.matched.gap_before

    @property
    def gap_after(self) -> Array:
        """Deviation with the calibrated coefficients, simulated minus measured, in JND.

        The shape is (n_parameters, n_pairs, n_bands).
        """
        return self.matched.gap_after

    @property
    def materials(self) -> list[dict[str, Any]]:
        """Alpha and sigma of each material before and after, with the 90 % interval."""
        return coefficients(self.prior, self.alpha, self.sigma, self.interval)

    @property
    def farther(self) -> tuple[str, ...]:
        """Names of the parameters whose deviation from the measurement grew by the calibration.

        A matched parameter is listed if its root mean square deviation over pairs and bands grew by
        more than half a JND. Any other parameter is listed if its root mean square deviation over the
        pairs grew by more than one JND in some band.
        """
        return (*(name for name, _, _ in self._farther_matched), *left(self.beside.gaps))

    @property
    def _farther_matched(self) -> list[tuple[str, float, float]]:
        """Those of them that were matched, with the gap before and after."""
        ends = (rms(gap, axis=(1, 2)) for gap in (self.gap_before, self.gap_after))
        every = zip(self.parameters, *ends, strict=True)
        return [(name, old, new) for name, old, new in every if new > old + _FARTHER]

    @property
    def shift(self) -> Array:
        """Change of alpha in units of the input sigma, (n_materials, n_bands); 0 where sigma is 0."""
        sigma = np.where(self.prior.sigma > 0, self.prior.sigma, np.inf)
        return np.asarray((self.alpha - self.prior.alpha) / sigma)

    @cached_property
    def pulls(self) -> Array:
        """Change of alpha that each pair causes, in input sigmas, (n_pairs, n_materials, n_bands).

        The sum over the pairs is the change of the linear estimate without the bounds 0 and 1. The gain
        of this estimate is K J' (J K J' + C)⁻¹, with K the covariance of the input alpha, J the
        derivatives of the values by alpha, and C the covariance of their errors (Tarantola 2005,
        Inverse Problem Theory, Sect. 3.2).
        """
        matrix = self.steps[-1].matrix
        across, n = self.prior_covariance @ matrix.T, len(matrix)
        of_values = across @ np.linalg.solve(matrix @ across + self.covariance, np.eye(n))
        sigma = np.where(self.prior.sigma > 0, self.prior.sigma, np.inf).ravel()
        shape = self.prior.alpha.shape
        return np.stack(
            [
                (of_values[:, rows] @ self.innovation[rows] / sigma).reshape(shape)
                for rows in rows_of_pairs(self.measured.used)
            ]
        )

    @cached_property
    def misfit(self) -> Array:
        """Misfit of each pair to the values expected from all other pairs, (n_pairs,): 1 is usual.

        The misfit is chi-square over its degrees of freedom. If the upper quartile over the pairs is
        above 1, all misfits are divided by it, so that up to a quarter of the pairs may be wrong.
        """
        square, degrees = self._chi_square
        ratio = square / degrees
        return np.asarray(ratio / max(1.0, float(np.quantile(ratio, 0.75, method="lower"))))

    @property
    def contradictions(self) -> tuple[Pair, ...]:
        """Pairs that contradict all others. Check their positions and names, or ``exclude`` them."""
        degrees = self._chi_square[1]
        chance = chdtrc(degrees, self.misfit * degrees)
        worst_first = np.argsort(-self.misfit).tolist()
        return tuple(self.pairs[i] for i in worst_first if chance[i] < CONTRADICTION / len(chance))

    @cached_property
    def _chi_square(self) -> tuple[Array, Array]:
        """The chi-square of each pair given all others, and its degrees of freedom, (n_pairs,)."""
        matrix = self.steps[-1].matrix
        # One wrong pair makes the unexplained error larger, and would then be explained by it.
        unit = self.measured.observations.one_jnd
        deviation = (self.unexplained[:, np.newaxis, np.newaxis] * unit)[self.measured.used]
        stated = self.covariance - np.diag(deviation**2)
        expected = matrix @ self.prior_covariance @ matrix.T + stated
        precision, rows = np.linalg.inv(expected), rows_of_pairs(self.measured.used)
        pull = precision @ self.innovation
        values = [float(pull[r] @ np.linalg.solve(precision[np.ix_(r, r)], pull[r])) for r in rows]
        return np.array(values), np.array([max(len(r), 1) for r in rows])

    @cached_property
    def learned(self) -> tuple[tuple[str, float, float], ...]:
        """Materials with input and calibrated sigma (rms over bands), most reduced first."""
        before, after = (rms(s, axis=1) for s in (self.prior.sigma, self.sigma))
        share = np.divide(after, before, out=np.ones_like(after), where=before > 0)
        return tuple(
            (self.prior.materials[i], float(before[i]), float(after[i]))
            for i in np.argsort(share, kind="stable")
        )

    def __repr__(self) -> str:
        return (
            f'<PositionsResult of "{text.shortened(self.simulator)}": {len(self.pairs)} pairs, '
            f"{', '.join(map(parameter_label, self.parameters))}, {len(self.steps)} steps>"
        )

    @cached_property
    def of_input(self) -> tuple[TrustMark, ...]:
        """Cautions about likely typing errors in the room, and in the mean T over the pairs."""
        measured = self.matched.measured
        late = [o.key for o in REVERBERATION if o.key in measured.parameters]
        if not late:
            return of_input(self.prior)
        time = measured.natural(late[0])
        known = np.isfinite(time)
        total = np.where(known, time, 0.0).sum(axis=0)
        return of_input(self.prior, total / np.where(known.any(axis=0), known.sum(axis=0), np.nan))

    @property
    def warning(self) -> str:
        """Sentences that are printed first, such as likely typing errors or a deviation that grew."""
        said = [_REFUSED] if self.refused else []
        said += [text.as_sentence(doubt.sentence) for doubt in self.of_input]
        said += [str(self.beyond)] if self.beyond else []
        if farther := self._farther_matched:
            names = ", ".join(
                f"{parameter_label(p)} ({old:.1f} to {new:.1f} JND)" for p, old, new in farther
            )
            start = "The"
            if self.scattering is not None:
                start = (
                    "The fit of the scattering may have found a poor optimum: try another seed, or "
                    "enter other scattering. Otherwise the"
                )
            said.append(
                f"In {names} the calibrated simulator deviates more from the measurement than before: "
                f"do not simulate with it. {start} model lacks something, or a constraint limits alpha."
            )
        return " ".join(said)

    @property
    def further(self) -> list[str]:
        """Notes on the data and on the fit, without `warning` and `doubts`."""
        said = [*sentences(self.beside.gaps, self.prior.centre_frequencies), *self.notes]
        if LEVEL.key in self.parameters:
            said.append(
                "The level is taken as absolute: as G, measured with a calibrated source."
                if self.measured.level == "absolute"
                else "The level is relative between the positions of a source: the measured one is "
                "shown with the mean of the simulated one."
            )
        return said + (
            [] if self.scattering is None else self.scattering.notes(self.prior.materials)
        )

    @property
    def every_note(self) -> list[str]:
        """Notes on the data, and cautions about the result itself."""
        doubts = [f"{row.name}: {' '.join(row.values)}" for row in self.doubts]
        return [*filter(None, [self.warning]), *self.further, *doubts]

    @property
    def doubts(self) -> list[Row]:
        """Cautions as rows of a table: the subject, the place, and what to do."""
        contradicting = [" to ".join(pair) for pair in self.contradictions]
        named = zip(map(" to ".join, self.pairs), self.misfit.tolist(), strict=True)
        odd = [f"{p} ({m:.1f})" for p, m in named if m > _MISFIT and p not in contradicting]
        bound = [
            f"{self.prior.materials[i]} at {self.prior.centre_frequencies[k]:g} Hz"
            for i, k in np.argwhere((self.alpha <= 0) | (self.alpha >= 1))
        ]
        more = [
            f"{of:.1f} JND of {parameter_label(p)}"
            for p, of in zip(self.parameters, self.unexplained, strict=True)
            if of >= _FARTHER
        ]
        beyond = "beyond all known errors, model and measurement differ by"
        found = {
            "Pair that contradicts all others": (
                ", ".join(contradicting),
                "Check the names and positions of the pair, or exclude the pair.",
            ),
            "Pair that fits the others badly": (
                ", ".join(odd),
                "A misfit of 1 is usual. Look at the decays of these pairs.",
            ),
            "More deviation than expected": (
                f"{beyond} {', '.join(more)} (standard deviation)" if more else "",
                "Check volume, mesh and sigma. If they are right, something may be missing from the "
                "model: `rtcal find` looks for it.",
            ),
            "No interval": (
                "" if self.controls else "no reference simulation shows this simulator's error",
                "The assumed error is 5 % of a time and 0.5 dB of a level. Use a simulator with a "
                "geometry.",
            ),
            "Coefficient at a bound": (
                text.first_of(bound, 5),
                "A bound is a warning and not a result. Enter a smaller sigma or a lower limit "
                "(alpha_min).",
            ),
            "Not settled": (
                "" if self.settled else "the last step moved alpha, or was refused",
                "Calibrate again with more paths.",
            ),
        }
        return [Row(title, [f"{what}.", advice]) for title, (what, advice) in found.items() if what]
