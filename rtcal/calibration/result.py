"""The result of a calibration: the certified answer, and all that follows of it.

`JointResult` has the answer over the unknowns of all configurations of a room, with their measurements;
multipliers, densities, derivatives and uncertainties are derived from the numbers and the QP that it
belongs to. `CalibrationResult` is its view of one room.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from rtcal.acoustics import bands, room_errors
from rtcal.acoustics.changes import Change, facing
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.marks import (
    Plausibility,
    TrustMark,
    gap_jnd,
    likely_slips,
    mark,
    of_input,
    plausibility,
    trust_marks,
    uneven_marks,
    z_within_bounds,
)
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.acoustics.room_errors import Assumptions, of_absorption
from rtcal.acoustics.run import Run
from rtcal.calibration import qp, table
from rtcal.calibration.composition import Composition
from rtcal.calibration.feasibility import Unreachable, where_valid
from rtcal.calibration.measured import MeasuredTimes, data_history
from rtcal.calibration.posterior import (
    Density,
    Draws,
    correlations,
    draws,
    intervals,
    quantiles,
)
from rtcal.calibration.qp import QP, Active, Certificate, Iterate, System
from rtcal.calibration.table import CalibrationVerdict, blocks_of, verdict
from rtcal.calibration.terms import (
    ExactMatch,
    LinearObservations,
    Observed,
    PriorDeviation,
    SoftMatch,
)
from rtcal.calibration.unknowns import Configurations, Flags, Numbers
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.prediction.changed_time import (
    KnownRoom,
    MeasuredState,
    correlation_of,
    directions,
    normal_quantiles,
)
from rtcal.prediction.predicted import Prediction, predict
from rtcal.support import __version__
from rtcal.support.blocks import Block
from rtcal.support.errors import ModelError
from rtcal.support.text import shortened
from rtcal.support.types import Array, read_only_view

_SAME_TIME = 1e-6
"""Relative difference of T below which the calibrated T is the measured one."""


_STEP = 1e-5
"""Relative step of T in central differences: their error is of the order of its square."""
_UNCOUPLED = 1e-13
"""Curvature between two unknowns, of the root of the product of their own, that is rounding."""
_SHARE_OF_ROUNDING = 1e-7
"""Of the prior's sigma: what the difference of equal variances leaves. As an uncertainty it would let a
coefficient that T alone determines contradict the next T by millions of standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointResult(Result):
    """Calibration of several configurations of a room, which share their coefficients.

    ``unreachable`` are the bands whose measured T no coefficients within their bounds give, ``method``
    is the name of the method, and ``solver`` the name of the solver.
    """

    record_kind: ClassVar[str] = "joint 1"

    composition: Composition
    """Objective, constraints, rooms and equation of the calibration."""
    unknowns: Array
    """Calibrated values of all unknowns, (size,): coefficients, then sizes of effects."""
    target: Array
    """Absorption area b in m² that the measured T needs, (n_configurations, n_bands); the nearest that
    can be reached where T cannot."""
    point: Iterate
    """Answer as a point of the QP, with its multipliers."""
    certificate: Certificate
    """Residuals of the answer, and a bound of its distance from the optimum."""
    raw: Iterate
    """Answer that the solver returned, before it was refined to numerical precision."""
    polished: bool
    """Whether the answer was refined by the active-set method, from the solver's answer or from the
    closed form; otherwise it is the solver's, which was accurate enough."""
    unreachable: tuple[Unreachable, ...]
    method: str
    solver: str
    """Name of the solver, as in the call."""
    measured_times: tuple[MeasuredTimes, ...]
    """Measured T of each configuration."""
    observed: Mapping[LinearObservations, Observed] | None = None
    """Numbers of the terms of linear observations."""
    versions: Mapping[str, str] = field(default_factory=table.versions)
    """Versions of rtcal, Python and the libraries that made the result."""

    @property
    def configurations(self) -> Configurations:
        """Rooms before the calibration, as configurations."""
        return self.composition.configurations

    @property
    def equation(self) -> LinearEquation:
        """Reverberation equation of the calibration."""
        return self.composition.equation

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials of all configurations."""
        return self.configurations.materials

    @cached_property
    def numbers(self) -> Numbers:
        """Numbers of the solve, which are calculated again from the inputs."""
        return replace(self.numbers_of(self.measured_times), target=self.target)

    def numbers_of(self, measured: Sequence[MeasuredTimes]) -> Numbers:
        """Return the numbers of the same problem for other measurements."""
        return self.composition.numbers(measured, self.observed)

    @cached_property
    def qp(self) -> QP:
        """Quadratic programme (QP) that was solved."""
        return self.composition.compiled.filled(self.numbers)

    @cached_property
    def raw_alpha(self) -> Array:
        """Coefficients that the solver returned, before refinement, (n_materials, n_bands)."""
        u = self.qp.unknowns(self.numbers, self.raw.v)
        return self.composition.layout.expand(u)

    @cached_property
    def raw_certificate(self) -> Certificate:
        """Residuals of the solver's answer before refinement, and its distance from ``alpha``."""
        if not self.polished:
            return self.certificate
        bound = np.abs(self.raw_alpha - self.alpha) + self.certificate.alpha_error_bound
        return replace(qp.certify(self.qp, self.raw, 0.0), alpha_error_bound=bound)

    @cached_property
    def alpha(self) -> Array:
        """Calibrated coefficients, (n_materials, n_bands)."""
        return self.composition.layout.expand(self.unknowns)

    @cached_property
    def at_bounds(self) -> Active:
        """State of each unknown: -1 at its lower bound, 1 at its upper bound, 0 between, (size,)."""
        return self.composition.unknowns_at(self.numbers, self.point.at)

    @cached_property
    def active(self) -> Active:
        """State of each coefficient, (n_materials, n_bands): -1 at lower, 1 at upper bound, else 0."""
        return self.composition.layout.expand(self.at_bounds)

    @property
    def asks_for_measured_time(self) -> bool:
        """Whether the calibration uses the measured T, in a constraint or a term of weight above 0."""
        composed = self.composition
        terms = zip(composed.objective.terms, composed.weights, strict=True)
        return bool(composed.matches) or any(t is composed.soft_match and w > 0 for t, w in terms)

    @cached_property
    def effects(self) -> dict[str, float]:
        """Calibrated size of each `rtcal.terms.AddedAbsorption`, by its name."""
        layout = self.composition.layout
        sizes = self.unknowns[layout.n_alpha :]
        return dict(zip(layout.further, sizes.tolist(), strict=True))

    @property
    def matches_uncertain_room(self) -> bool:
        """Whether T was matched within the uncertainty of volume, areas and climate."""
        match = self.composition.soft_match
        return match is not None and match.room

    @property
    def has_density(self) -> bool:
        """Whether the method has a probability distribution: not `lse` and `robust`."""
        prior = self.composition.prior
        return isinstance(prior, PriorDeviation) and prior.sigma is None

    def density(self, *, measured: bool = True) -> Density:
        """Return the probability density of the unknowns given the measured T, or before T is known.

        It is a normal density within bounds (`rtcal.calibration.posterior.Density`). ``measured`` is
        True for the density given T, and False for that of the input alone. With an exact match, the
        density still allows for the uncertainty of T. Raises ModelError for the methods ``lse`` and
        ``robust``, which have no distribution.
        """
        prior, numbers, layout = self.composition.prior, self.numbers, self.composition.layout
        if not self.has_density:
            raise ModelError(
                f"{prior!r} is not the logarithm of a prior density of alpha, so there is "
                'no posterior. Calibrate with method "soft" or "mle"'
            )
        if not measured:
            missing = np.full_like(numbers.target, np.nan)
            numbers = replace(numbers, target=missing, time=missing)
        program, u = self.composition.compiled.filled(numbers), self.unknowns
        unit, places = numbers.inverse_sigma, self.composition.compiled.places
        x = np.where(numbers.sigma > 0, (u - numbers.mu) * unit, self.point.v[places])
        gradient, curvature, kept = _reduced(program, x)
        # What rounding leaves of unknowns that nothing couples would make one part of them.
        size = np.sqrt(np.abs(np.diag(curvature)))
        curvature = np.where(np.abs(curvature) > _UNCOUPLED * np.outer(size, size), curvature, 0.0)
        own = sp.csr_array(program.matrices[1][:, places] @ sp.diags_array(unit))[kept]
        limit = program.b[kept] + own @ numbers.mu
        noise = self._row_noise[kept]
        names = np.argsort(np.argsort([layout.materials[i] for i in layout.first]))
        rank = (names[:, np.newaxis] * layout.n_bands + np.arange(layout.n_bands)).ravel()
        return Density(
            point=u,
            gradient=gradient * unit,
            curvature=sp.csr_array(curvature * np.outer(unit, unit)),
            scale=np.where(numbers.movable, numbers.sigma, 0.0),
            lower=numbers.lower,
            upper=numbers.upper,
            matrix=own,
            row_lower=np.where(program.equal[kept], limit, -np.inf),
            row_upper=limit,
            row_noise=noise,
            rank=np.append(rank, np.arange(layout.n_alpha, len(u))),
        )

    def by_time(self) -> Array:
        """Return the derivatives of the calibrated coefficients by the measured T in 1/s.

        Their shape is (n_materials, n_bands, n_configurations, n_bands): the first two axes are those
        of the coefficients, the last two those of T. Coefficients at a bound stay there.
        """
        layout = self.composition.layout
        slopes = self._slopes(bounds=True)[: layout.n_alpha]
        shape = (layout.n_alpha_rows, layout.n_bands, layout.n_configurations, layout.n_bands)
        return np.asarray(slopes.reshape(shape)[list(layout.alpha_rows)])

    def _slopes(self, *, bounds: bool) -> Array:
        """Return du / dT in 1/s, (size, n_times), one T per configuration and band.

        Without ``bounds``, no unknown counts as being at a bound and the covariance of b does not
        depend on T, as the error of a linear estimate requires. With them u_b = |db/dT| u_T does.

        The optimality conditions on the active set are differentiated: the matrices by differences.
        """
        program, point, numbers = self.qp, self.point, self.numbers
        at = point.at.copy()
        if not bounds:
            at[program.compiled.places] = 0
        free = (at == 0) & ~program.fixed
        system = System(program, free, program.equal | (point.y > 0))
        ends = [self._with_times(factor, bounds) for factor in (1 - _STEP, 1 + _STEP)]
        slopes = np.zeros((len(program.compiled.places), numbers.time.size))
        for place, time in enumerate(numbers.time.ravel()):
            if not all(np.isfinite(end.target.ravel()[place]) for end in ends):
                continue
            at_ends = (_at_one(numbers, end, place) for end in ends)
            before, after = map(self.composition.compiled.filled, at_ends)
            force = before.force(point.v, point.y) - after.force(point.v, point.y)
            limit = after.b - after.row_sums(point.v) - (before.b - before.row_sums(point.v))
            dv, _ = system.solve(force, limit)
            slopes[:, place] = numbers.sigma * dv[program.compiled.places] / (2 * _STEP * time)
        return slopes

    def _with_times(self, factor: float, noise_follows: bool) -> Numbers:
        """Return the same numbers with every T multiplied by ``factor``."""
        measured: Sequence[MeasuredTimes] = [
            replace(m, reverberation_time=factor * m.reverberation_time)
            for m in self.measured_times
        ]
        numbers = self.numbers_of(measured)
        if not noise_follows:
            own = self.numbers
            numbers = replace(
                numbers, target_uncertainty=own.target_uncertainty, room_changes=own.room_changes
            )
        return numbers

    @cached_property
    def estimate_sigma(self) -> Array:
        """Standard deviation of the error of each unknown, (size,), if bounds are left out.

        The error is that of the unknown's linear estimate from T. The input has the covariance that the
        room states, even if the method uses another. An unknown uncertainty of T counts as 0. If the
        calibration has a `LinearObservations` term, the standard deviation is that of the normal
        distribution given all data, and the input has the covariance that the objective uses.
        """
        if self.composition.observations:
            return self._gaussian_sigma()
        # The estimate is mu + G (b - S'mu), its error (1 - G S')(mu - u) + G e with e the error of b.
        # Its covariance (1 - G S') K (1 - G S')' + G U G' holds for any G, also of another sigma.
        gain, (sigma, cross, innovation) = self._gain, self._covariances
        variance = (
            sigma**2 - 2 * np.sum(gain * cross, axis=1) + np.sum((gain @ innovation) * gain, axis=1)
        )
        left = np.sqrt(np.maximum(variance, 0.0))
        return np.where(left > _SHARE_OF_ROUNDING * sigma, left, 0.0)

    @property
    def posterior_sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands)."""
        return self.composition.layout.expand(self.estimate_sigma)

    @cached_property
    def _gain(self) -> Array:
        """d u / d b in 1/m², (size, n_matches), without bounds."""
        pairs = zip(self.configurations.rooms, self.measured_times, strict=True)
        slopes = [self.equation.target_sensitivity(r, m.reverberation_time) for r, m in pairs]
        by_target = np.nan_to_num(np.ravel(slopes))
        return self._slopes(bounds=False) / np.where(by_target != 0, by_target, 1.0)

    def _gaussian_sigma(self) -> Array:
        """Return the square root of the diagonal of the inverse curvature, within the equalities.

        An uncertain target of an equality adds its share.
        """
        program, numbers = self.qp, self.numbers
        places = program.compiled.places
        at = self.point.at.copy()
        at[places] = 0
        system = System(program, (at == 0) & ~program.fixed, program.equal)
        exact = np.flatnonzero(self._row_noise > 0)
        force = np.zeros((len(program.c), len(places) + len(exact)))
        limit = np.zeros((len(program.b), force.shape[1]))
        force[places, np.arange(len(places))] = 1.0
        limit[exact, len(places) + np.arange(len(exact))] = self._row_noise[exact]
        change = system.solve(force, limit)[0][places]
        variance = np.diag(change) + np.sum(change[:, len(places) :] ** 2, axis=1)
        return np.where(numbers.movable, numbers.sigma * np.sqrt(np.maximum(variance, 0.0)), 0.0)

    def unbounded(self, sigma: Array) -> Array:
        """Return the values that the unknowns would have without bounds, (size,).

        ``sigma`` (size,) is the standard deviation of each unknown without bounds. An unknown at a
        bound would lie m sigma² beyond this bound, where m is the bound's multiplier.
        """
        held = self.point.z[self.qp.compiled.places] * self.numbers.inverse_sigma
        return np.asarray(self.unknowns + held * sigma**2)

    @cached_property
    def _row_noise(self) -> Array:
        """Standard uncertainty of what each row is equal to in m², (n_rows,); 0 where it is unknown."""
        noise = np.zeros(len(self.qp.b))
        of_target = np.nan_to_num(self.numbers.target_uncertainty).ravel()
        for term, stated in self.composition.compiled.rows_of:
            if isinstance(term, ExactMatch) and len(stated) == 1:
                noise[stated[0]] = of_target
        return np.where(self.qp.row_size > 0, noise, 0.0)

    @cached_property
    def innovation(self) -> tuple[Array, Array]:
        """Absorption area that T needs minus that of the input coefficients, and its covariance.

        The difference b - S'mu in m² is (n_configurations * n_bands,), NaN in a band without a match.
        Its covariance in m⁴ is S'KS + U. K is the covariance of the input coefficients, from the room's
        sigma and correlations. U is the covariance of b, from the uncertainties of T (0 where unknown),
        volume, areas and climate. If no coefficients reach T, b is still the area that T needs; only if
        no area gives T, b is the nearest area that can be reached.
        """
        numbers = self.numbers
        target = numbers.target.copy()
        for band in self.unreachable:
            if np.isfinite(band.target):
                place = numbers.layout.centre_frequencies.index(band.frequency)
                target[band.configuration, place] = band.target
        *_, covariance = self._covariances
        return target.ravel() - numbers.match_matrix @ numbers.mu, covariance

    @cached_property
    def _room_prior(self) -> tuple[Array, Array, PriorDeviation]:
        """The prior's sigma, what all unknowns have in common, (size,) each, and their correlation."""
        numbers, room, prior = self.numbers, self.configurations.union, self.composition.prior
        of_alpha = room.sigma[numbers.layout.first].ravel()
        sigma = np.concatenate([of_alpha, numbers.further(numbers.sigma)])
        if not (isinstance(prior, PriorDeviation) and prior.correlated):
            # The plausibility uses the room's correlations, also for a method without them (lse).
            prior = PriorDeviation(
                band_correlation=room.band_correlation,
                material_correlation=room.material_correlation,
            )
        return sigma, np.where(sigma > 0, numbers.common_shift, 0.0), prior

    @cached_property
    def _covariances(self) -> tuple[Array, Array, Array]:
        """The prior's sigma over the unknowns (size,), K S (size, n_rows), and S'KS + U."""
        numbers = self.numbers
        sigma, shift, prior = self._room_prior
        match = numbers.match_matrix
        columns = sigma[:, np.newaxis] * match.T.toarray()
        if prior.correlated:
            columns = prior.correlate(columns, numbers.layout)
        cross = sigma[:, np.newaxis] * columns + np.outer(shift, match @ shift)
        total = np.hypot(sigma, shift)
        return total, cross, np.asarray(match @ cross + numbers.target_covariance)

    @cached_property
    def results(self) -> tuple[CalibrationResult, ...]:
        """Calibration result of each configuration."""
        return tuple(
            CalibrationResult(joint=self, configuration=c)
            for c in range(len(self.configurations.rooms))
        )

    @cached_property
    def _separate(self) -> tuple[Density, list[Draws]] | None:
        """The density and its draws where each band stands for itself; None else.

        So it is without a term that couples bands, and with at most one matched sum in each.
        """
        composed = self.composition
        parts = composed.objective.terms + tuple(composed.row_constraints)
        if (
            self.has_density
            and composed.layout.n_configurations == 1
            and not composed.layout.further
            and not composed.prior.correlated
            and not self.matches_uncertain_room
            and all(type(t) in (PriorDeviation, SoftMatch) for t in composed.objective.terms)
            and all(type(r) is ExactMatch for r in composed.row_constraints)
            and len(parts) <= 2
        ):
            density = self.density()
            return density, draws(density)
        return None

    @property
    def is_exact(self) -> bool:
        """Whether `interval` follows from the exact distribution, and not from a normal approximation.

        That needs a method with a distribution (`has_density`) and bands that are independent.
        """
        return self._separate is not None

    @cached_property
    def points(self) -> Array:
        """Quantiles of each coefficient at 201 probabilities, (n_materials, n_bands, 201).

        The probabilities are those of a standard normal variable at `rtcal.support.normal.NORMAL`. If
        the bands are independent, the quantiles are those of the distribution given T. Otherwise they
        are those of a normal distribution about the linear estimate, cut at the bounds.
        """
        layout = self.composition.layout
        if self._separate is not None:
            return quantiles(layout, *self._separate)
        sigma = self.estimate_sigma
        of_all = (self.unbounded(sigma), sigma, self.numbers.lower)
        unbounded, spread, lower = map(layout.expand, of_all)
        upper = self.composition.configurations.union.most_alpha
        points = normal_quantiles(unbounded, spread, lower, upper)
        free = layout.expand(sigma)[:, :, np.newaxis] > 0
        return np.where(free, points, self.alpha[:, :, np.newaxis])

    @cached_property
    def correlation(self) -> Array:
        """Correlation between the coefficients in each band, (n_bands, n_materials, n_materials)."""
        layout = self.composition.layout
        if self._separate is not None:
            return correlations(layout, *self._separate)
        # Of the linear estimate's error, as in `estimate_sigma`.
        gain, n = self._gain[: layout.n_alpha], layout.n_alpha
        sigma, shift, prior = self._room_prior
        _, cross, innovation = self._covariances
        whole = (
            sigma[:n, np.newaxis] * prior.correlate(np.eye(len(sigma), n) * sigma[:n], layout)[:n]
        )
        change = gain @ cross[:n].T
        whole = whole + np.outer(shift[:n], shift[:n])
        whole = whole - change - change.T + gain @ innovation @ gain.T
        rows = np.array(layout.alpha_rows) * layout.n_bands
        each = [whole[np.ix_(rows + k, rows + k)] for k in range(layout.n_bands)]
        return correlation_of(np.array(each))[1]

    @cached_property
    def interval(self) -> tuple[Array, Array]:
        """Lower and upper end of the 90 % interval of each coefficient, (n_materials, n_bands) each.

        The interval follows from the quantiles `points` and contains the calibrated coefficient. It
        includes the uncertainty of T if one is stated.
        """
        return intervals(self.alpha, self.points, 0.9)

    def to_dict(self) -> dict[str, Any]:
        """Return the `CalibrationResult.to_dict` of each configuration by its name."""
        names = self.configurations.names
        by_name = zip(names, self.results, strict=True)
        return {"configurations": [{"name": n, **r.to_dict()} for n, r in by_name]}

    def __str__(self) -> str:
        parts = zip(self.configurations.names, self.results, strict=True)
        return "\n\n".join(f"configuration: {name}\n{result}" for name, result in parts)

    def __repr__(self) -> str:
        rooms = self.configurations.rooms
        return (
            f'<JointResult of "{shortened(rooms[0].name)}": {len(rooms)} '
            f"configuration{'s' * (len(rooms) > 1)}, method {self.method}>"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CalibrationResult(Result):
    """Result of the calibration of a room: its coefficients, their uncertainty, and cautions.

    `alpha` are the calibrated coefficients, `posterior_sigma` and `interval` their uncertainty, and
    `room` is the calibrated room. `plausibility` is the agreement of the measured T with the input,
    `trust_marks` are the cautions, and `certificate` is the numerical accuracy.

    Attributes
    ----------
    joint : JointResult
        Calibration of all configurations of the room; a single room is one configuration.
    configuration : int
        Number, from 0, of the configuration to which this result belongs.
    """

    record_kind: ClassVar[str] = table.KIND

    joint: JointResult
    configuration: int

    @property
    def prior(self) -> Room:
        """Room before the calibration."""
        return self.joint.configurations.rooms[self.configuration]

    @property
    def states(self) -> tuple[CalibrationResult, ...]:
        """Results of all measured configurations, for `rtcal.prediction.predict`."""
        return self.joint.results

    @property
    def equation(self) -> LinearEquation:
        """Reverberation equation of the calibration."""
        return self.joint.equation

    @property
    def method(self) -> str:
        """Name of the calibration method."""
        return self.joint.method

    @property
    def measured_data(self) -> MeasuredTimes:
        """Measured T with its uncertainty, in the room's bands."""
        return self.joint.measured_times[self.configuration]

    @cached_property
    def _rows(self) -> list[int]:
        """Indices of the room's materials among those of all configurations."""
        every = self.joint.materials
        return [every.index(m) for m in self.prior.materials]

    @cached_property
    def alpha(self) -> Array:
        """Calibrated coefficients, (n_materials, n_bands)."""
        return read_only_view(self.joint.alpha[self._rows])

    @property
    def target(self) -> Array:
        """Absorption area that the measured T needs, in m², (n_bands,); NaN where T is missing."""
        return np.asarray(self.joint.numbers.target[self.configuration])

    @property
    def target_uncertainty(self) -> Array:
        """Standard uncertainty of the absorption area `target` in m², (n_bands,); NaN where unknown."""
        return np.asarray(self.joint.numbers.target_uncertainty[self.configuration])

    @property
    def multipliers(self) -> Array:
        """Lagrange multiplier D of S'alpha = b in 1/m², (n_bands,); NaN without this constraint.

        Coefficients at no bound are mu - D S sigma², with the input mu and the areas S (Bellows & Katz
        2025, Eq. 25).
        """
        composed, matched = self.joint.composition, np.isfinite(self.joint.target)
        found = np.full(matched.shape, np.nan)
        for term, stated in composed.compiled.rows_of:
            if term in composed.matches:
                # An equality, or a lower and an upper limit.
                y = [self.joint.point.y[rows] for rows in stated]
                values = y[0] if len(y) == 1 else y[1] - y[0]
                found = np.where(matched, values.reshape(matched.shape), np.nan)
                break
        return read_only_view(found[self.configuration])

    @cached_property
    def active(self) -> Active:
        """State of each coefficient, (n_materials, n_bands): -1 at lower, 1 at upper bound, else 0."""
        return read_only_view(self.joint.active[self._rows])

    @cached_property
    def certificate(self) -> Certificate:
        """Residuals of the answer, and a bound of its distance from the optimum."""
        of_all = self.joint.certificate
        return replace(of_all, alpha_error_bound=of_all.alpha_error_bound[self._rows])

    @property
    def raw(self) -> Iterate:
        """Answer that the solver returned, before the refinement that gives ``alpha``."""
        return self.joint.raw

    @property
    def unreachable(self) -> tuple[Unreachable, ...]:
        """Bands whose measured T could not be reached, so that the nearest possible T was matched."""
        every = self.joint.unreachable
        return tuple(u for u in every if u.configuration == self.configuration)

    @property
    def effects(self) -> dict[str, float]:
        """Calibrated size of each `rtcal.terms.AddedAbsorption`, by its name."""
        return self.joint.effects

    @cached_property
    def added_absorption(self) -> Array:
        """Absorption area in m² that `rtcal.terms.AddedAbsorption` terms add, (n_bands,)."""
        data = self.joint.numbers
        sizes = data.further(self.joint.unknowns)
        return read_only_view(np.asarray(data.gains[self.configuration] @ sizes))

    @property
    def measured(self) -> Array:
        """Measured T in s, (n_bands,), NaN where missing."""
        return read_only_view(self.measured_data.reverberation_time)

    @property
    def measured_uncertainty(self) -> Array:
        """Standard uncertainty of the measured T in s, (n_bands,), NaN where unknown."""
        return read_only_view(self.measured_data.uncertainty)

    @property
    def matched(self) -> Array:
        """Whether the calibration used the measured T of each band, (n_bands,) of bool."""
        return np.asarray(np.isfinite(self.target) & self.joint.asks_for_measured_time)

    @cached_property
    def reverberation_time_before(self) -> Array:
        """T of the input coefficients in s, (n_bands,); NaN where the equation does not hold."""
        times = where_valid(self.equation.time, self.prior, self.prior.absorption_area)
        return read_only_view(times)

    @cached_property
    def reverberation_time_after(self) -> Array:
        """T of the calibrated coefficients in s, (n_bands,); NaN where the equation does not hold."""
        area = self.prior.areas @ self.alpha + self.added_absorption
        return read_only_view(where_valid(self.equation.time, self.prior, area))

    @property
    def gap_before(self) -> Array:
        """T of the input minus the measured T, (n_bands,), in JND: 5 % of the measured T."""
        return gap_jnd(self.reverberation_time_before, self.measured)

    @property
    def gap_after(self) -> Array:
        """Calibrated T minus the measured T, (n_bands,), in JND: 5 % of the measured T."""
        return gap_jnd(self.reverberation_time_after, self.measured)

    @property
    def shift(self) -> Array:
        """Change of each coefficient by the calibration, (n_materials, n_bands)."""
        return self.alpha - self.prior.alpha

    @property
    def shift_in_sigmas(self) -> Array:
        """`shift` divided by the input sigma, (n_materials, n_bands); 0 where sigma = 0."""
        sigma = self.prior.sigma
        return np.divide(self.shift, sigma, out=np.zeros_like(sigma), where=sigma > 0)

    @cached_property
    def plausibility(self) -> Plausibility:
        """Agreement of the measured T with the input coefficients, as a `Plausibility`."""
        deviation, covariance = self.joint.innovation
        bands = slice(
            self.configuration * self.prior.n_bands, (self.configuration + 1) * self.prior.n_bands
        )
        further = self.joint.at_bounds[self.joint.numbers.layout.n_alpha :]
        at_bound = bool(self.active[:, self.matched].any() or further.any())
        room = self.prior
        together = of_absorption(room.areas, room.alpha, room.sigma, room.centre_frequencies)
        return plausibility(deviation[bands], covariance[bands, bands], at_bound, together)

    @property
    def _z_within_bounds(self) -> Array:
        """`Plausibility.z`, but within the bounds where a matched band has a coefficient at one."""
        n, (deviation, covariance) = self.prior.n_bands, self.joint.innovation
        bands = slice(self.configuration * n, (self.configuration + 1) * n)
        variance, active = np.diag(covariance)[bands], np.where(self.matched, self.active, 0)
        bounded = z_within_bounds(self.prior, deviation[bands], variance, self.shift, active)
        return np.where(np.isnan(bounded), self.plausibility.z, bounded)

    @cached_property
    def air_share(self) -> Array:
        """Share of the air in the whole absorption of the calibrated room, (n_bands,)."""
        area = self.prior.areas @ self.alpha + self.added_absorption
        return read_only_view(where_valid(self.equation.air_share, self.prior, area))

    @cached_property
    def doubts(self) -> tuple[TrustMark, ...]:
        """Cautions about the input: likely typing errors of the room and of T."""
        return of_input(self.prior, self.measured, self.measured_data.mistyped)

    @cached_property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Cautions about single bands or the whole room, with advice; `doubts` first."""
        calibrated = self.prior.replace(alpha=self.alpha)
        uneven = uneven_marks(calibrated, directions(self.prior))
        for _, likely in likely_slips(self.prior)[:1]:
            uneven = uneven or uneven_marks(likely, facing(likely))
        return (
            *self.doubts,
            *uneven,
            *trust_marks(
                self.prior,
                self.measured,
                self.measured_uncertainty,
                self.air_share,
                self.active,
                self._z_within_bounds,
                [u.frequency for u in self.unreachable],
                self.measured_data.bent,
            ),
        )

    @cached_property
    def posterior_sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands).

        It follows from the room's sigma and the uncertainty of T, without the effect of bounds, so that
        it can be compared with the input sigma.
        """
        return read_only_view(self.joint.posterior_sigma[self._rows])

    @cached_property
    def room(self) -> Room:
        """Room with the calibrated coefficients, their standard deviations and the `record`."""
        return self.prior.replace(
            alpha=self.alpha, sigma=self.posterior_sigma, calibration=self.record
        )

    @property
    def record(self) -> CalibrationRecord:
        """Record of the calibration, which `room` has: method, equation, data, solver and version."""
        return CalibrationRecord(
            method=self.method,
            equation=self.equation.name,
            measured=data_history(self.prior, self.measured_data),
            solver=self.joint.solver,
            version=__version__,
        )

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 90 % interval of each coefficient, (n_materials, n_bands) each."""
        low, high = self.joint.interval
        return low[self._rows], high[self._rows]

    @cached_property
    def known(self) -> KnownRoom:
        """Calibrated room before a change, as `rtcal.prediction` needs it.

        Raises ModelError if the calibration has further unknowns or observations, which a prediction
        cannot use, or if its equation gives no T for the calibrated room.
        """
        joint, room = self.joint, self.prior
        if joint.effects or joint.composition.observations:
            raise ModelError(
                "a prediction uses T only, but this calibration has effects or other "
                "observations. Calibrate without them, for example the corrected room of "
                "`rtcal apply`"
            )
        time = where_valid(self.equation.time, room, room.areas @ self.alpha)
        if not np.isfinite(time).all():
            raise ModelError(f"{self.equation.name}'s equation gives no T for the calibrated room")
        rooms = joint.configurations
        states = [
            MeasuredState(name, other, m.reverberation_time, m.uncertainty / m.reverberation_time)
            for name, other, m in zip(rooms.names, rooms.rooms, joint.measured_times, strict=True)
        ]
        own = states.pop(self.configuration)
        with np.errstate(invalid="ignore"):
            same = np.abs(time / own.time - 1) < _SAME_TIME
        measured = np.isfinite(own.time) & joint.asks_for_measured_time
        gap = np.nan_to_num(np.abs(gap_jnd(time, own.time)))
        unstated = room_errors.Assumptions().time
        u = np.where(np.isnan(own.log_uncertainty), unstated, own.log_uncertainty)
        allowed = np.maximum(1.0, np.nan_to_num(gap_jnd(own.time * (1 + 2 * u), own.time)))
        doubts, far = self.doubts, measured & (gap > allowed)
        if far.any():
            k = int(np.argmax(np.where(far, gap, 0.0)))
            text = (
                f"at {bands.label(room.centre_frequencies[k])} the calibrated model has a T of "
                f"{time[k]:.2f} s in place of the measured {own.time[k]:.2f} s"
            )
            doubts = (*doubts, mark("gap_before", None, text))
        return KnownRoom(
            room=room,
            equation=self.equation,
            materials=rooms.materials,
            alpha=joint.alpha,
            quantiles=joint.points,
            correlation=joint.correlation,
            time=time,
            measured=measured,
            exact=bool(same[measured].all()),
            log_uncertainty=own.log_uncertainty,
            others=tuple(states),
            doubts=doubts,
        )

    def predict(
        self,
        changes: Change | Sequence[Change] | Room,
        *,
        name: str = "",
        assumptions: Assumptions | None = None,
        run: Run | None = None,
        run_after: Measurement | None = None,
    ) -> Prediction:
        """Return T after a change of this room, with its uncertainty.

        T after the change is the calibrated T times the ratio of T after to T before the change. The
        ratio is that of the equation. If ``run`` (a simulation program's results before the change) and
        ``run_after`` (those after it) are given, the ratio is that of the program.

        ``changes`` are changes in the given order, or the changed room itself. ``name`` is the name of
        the planned change in the output. ``assumptions`` are the uncertainties that the prediction
        assumes; None stands for `rtcal.prediction.Assumptions()`. Raises ModelError if the calibration
        has an `AddedAbsorption` or `LinearObservations` term, and the errors of
        `rtcal.prediction.predict`.
        """
        return predict(
            self, changes, assumptions=assumptions, name=name, run=run, run_after=run_after
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and text for JSON; None where a value is missing.

        The entry ``inputs`` has the text of the room's file and of a file of the mean T, from which the
        calibration can be repeated.
        """
        return self._record(whole=True)

    def _record(self, *, whole: bool) -> dict[str, Any]:
        """Return `to_dict`; if not ``whole`` what the words need: no sigma, intervals and inputs."""
        room, composed = self.prior, self.joint.composition
        record = {
            "rtcal": table.KIND,
            "versions": dict(self.joint.versions),
            "room": room.name,
            "method": self.method,
            "equation": self.equation.name,
            "equation_parameters": table.equation_parameters(self.equation),
            "objective": [repr(term) for term in composed.objective.terms],
            "constraints": [repr(row) for row in composed.row_constraints],
            "matches_measured_time": self.joint.asks_for_measured_time,
            "volume": room.volume,
            "air": None if room.air is None else asdict(room.air),
            "room_taken_as_exact": not self.joint.matches_uncertain_room,
            **({"room_uncertainty": words} if (words := room_errors.in_words(room)) else {}),
            "centre_frequencies": json_numbers(room.centre_frequencies),
            "measured": table.measurement(self.measured_data),
            "reverberation_time_before": json_numbers(self.reverberation_time_before),
            "reverberation_time_after": json_numbers(self.reverberation_time_after),
            "gap_before_jnd": json_numbers(self.gap_before),
            "gap_after_jnd": json_numbers(self.gap_after),
            "target": json_numbers(self.target),
            "target_uncertainty": json_numbers(self.target_uncertainty),
            "materials": table.materials(
                room,
                self.alpha,
                self.posterior_sigma if whole else None,
                self.shift_in_sigmas,
                self.interval if whole else None,
                self.active,
                self.certificate.alpha_error_bound,
            ),
            "material_correlation": [
                {"materials": list(pair), "value": value}
                for pair, value in room.material_correlation.items()
            ],
            "band_correlation": room.band_correlation,
            "plausibility": {
                "z": json_numbers(self.plausibility.z),
                "q": self.plausibility.q,
                "degrees_of_freedom": self.plausibility.degrees_of_freedom,
                "p_value": self.plausibility.p_value,
                "p_together": self.plausibility.p_together,
            },
            "effects": self.effects,
            "added_absorption": json_numbers(self.added_absorption),
            "air_share": json_numbers(self.air_share),
            "trust_marks": [vars(mark) for mark in self.trust_marks],
            "multipliers": json_numbers(self.multipliers),
            "unreachable": [str(band) for band in self.unreachable],
            "certificate": table.residuals(self.certificate),
            "solver": {
                "name": self.joint.solver,
                "status": self.raw.status,
                "iterations": self.raw.iterations,
                "polished": self.joint.polished,
                "raw_certificate": table.residuals(self.joint.raw_certificate),
                "raw_alpha": json_numbers(self.joint.raw_alpha[self._rows]),
            },
            **({"inputs": table.inputs(room, self.measured_data)} if whole else {}),
            "stated_by": room.calibration and room.calibration.method,
        }
        record["absorption_share"] = table.absorption_share(record)
        return {**record, "verdict": verdict(record)._asdict()}

    @cached_property
    def verdict(self) -> CalibrationVerdict:
        """Statement on whether model and measurement agree, for text, page and JSON."""
        return CalibrationVerdict(**self._record(whole=False)["verdict"])

    def __repr__(self) -> str:
        gaps = [np.nanmax(np.abs(gap)) for gap in (self.gap_before, self.gap_after)]
        return (
            f'<CalibrationResult of "{shortened(self.prior.name)}": method {self.method}, '
            f"{self.equation.name}'s equation, largest gap {gaps[0]:.1f} JND before, "
            f"{gaps[1]:.1f} JND after>"
        )

    def blocks(self) -> list[Block]:
        """Return the parts of the printed result and of the HTML page, in order: texts and tables."""
        return blocks_of(self._record(whole=False))


def _at_one(numbers: Numbers, other: Numbers, place: int) -> Numbers:
    """Return the numbers with what depends on one T of other numbers."""
    changed = {}
    for name in ("time", "target", "target_uncertainty", "target_sensitivity"):
        values = getattr(numbers, name).copy()
        values.ravel()[place] = getattr(other, name).ravel()[place]
        changed[name] = values
    if numbers.room_changes.size:
        changes = numbers.room_changes.copy()
        changes[:, place] = other.room_changes[:, place]
        changed["room_changes"] = changes
    return replace(numbers, **changed)


def _reduced(program: QP, x: Array) -> tuple[Array, Array, Flags]:
    """Return gradient and curvature by the unknowns' deviations at x, and the rows that remain.

    The other variables take their best value: those that a row defines, and those that are free.
    """
    places = program.compiled.places
    other = np.ones(len(program.c), dtype=bool)
    other[places] = False
    defining = program.absolute.row_sums(1.0 * other) > 0
    v = np.zeros(len(program.c))
    v[places] = x
    system = System(program, other, defining)
    dv, y = system.solve(-program.gradient(v), program.b - program.row_sums(v))
    gradient = program.force(v + dv, y)[places]
    P, A = program.matrices
    across, rows = P[:, places].toarray(), A[:, places].toarray()
    change, pull = system.solve(-across, -rows)
    curvature = across[places] + P[places] @ change + A[:, places].T @ pull
    return gradient, (curvature + curvature.T) / 2, ~defining & (program.row_size > 0)
