"""A certified answer, and what follows of it: multipliers, densities, derivatives, uncertainties.

`JointSolution` has the answer over the unknowns with its rooms and measurements. The rest is derived
from the numbers and the QP that it belongs to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.stats import truncnorm

from rtcal.acoustics.equations import LinearEquation
from rtcal.calibration import qp, table
from rtcal.calibration.composition import Composition
from rtcal.calibration.feasibility import Unreachable
from rtcal.calibration.measured import MeasuredTimes
from rtcal.calibration.posterior import Densities, Density
from rtcal.calibration.qp import QP, Active, Certificate, Iterate, System
from rtcal.calibration.terms import (
    ExactMatch,
    LinearObservations,
    Observed,
    PriorDeviation,
    SoftMatch,
)
from rtcal.calibration.unknowns import Configurations, Flags, Numbers
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

_STEP = 1e-5
"""Relative step of T in central differences: their error is of the order of its square."""
_UNCOUPLED = 1e-13
"""Curvature between two unknowns, of the root of the product of their own, that is rounding."""
_SHARE_OF_ROUNDING = 1e-7
"""Of the prior's sigma: what the difference of equal variances leaves. As an uncertainty it would let a
coefficient that T alone determines contradict the next T by millions of standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointSolution:
    """The calibrated coefficients of all configurations of a room, over one set of unknowns.

    Attributes
    ----------
    composition : Composition
        The objective, the constraints, the rooms and the equation.
    unknowns : array (size,)
        The answer.
    target : array (n_configurations, n_bands)
        b in m²; the nearest within reach where the measured T is beyond it.
    point : Iterate
        The answer over the variables of the QP, with its multipliers.
    certificate : Certificate
        Error bounds of the answer: its distance from the optimum.
    raw : Iterate
        The solver's own answer, before polishing.
    polished : bool
        Whether the answer is that of the active-set method (from the solver's guess, or from the closed
        form); else the solver's own passed the certificate.
    unreachable : tuple of Unreachable
    method, solver : str
        As stated in the call.
    measured_times : tuple of MeasuredTimes
        One per configuration.
    observed : mapping, optional
        The numbers of linear observations.
    versions : mapping of str to str
        Of rtcal, Python and the libraries that made it.
    """

    composition: Composition
    unknowns: Array
    target: Array
    point: Iterate
    certificate: Certificate
    raw: Iterate
    polished: bool
    unreachable: tuple[Unreachable, ...]
    method: str
    solver: str
    measured_times: tuple[MeasuredTimes, ...]
    observed: Mapping[LinearObservations, Observed] | None = None
    versions: Mapping[str, str] = field(default_factory=table.versions)

    @property
    def configurations(self) -> Configurations:
        """The rooms before the calibration."""
        return self.composition.configurations

    @property
    def equation(self) -> LinearEquation:
        """The equation that turned T into b."""
        return self.composition.equation

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material of any configuration."""
        return self.configurations.materials

    @cached_property
    def numbers(self) -> Numbers:
        """The numbers of the solve, made anew: a saved result has its inputs and its answer alone."""
        return replace(self.numbers_of(self.measured_times), target=self.target)

    def numbers_of(self, measured: Sequence[MeasuredTimes]) -> Numbers:
        """Return the numbers of the same problem for other measurements."""
        return self.composition.numbers(measured, self.observed)

    @cached_property
    def qp(self) -> QP:
        """The QP that was solved."""
        return self.composition.qp(self.numbers)

    @cached_property
    def raw_alpha(self) -> Array:
        """The solver's own coefficients, (n_materials, n_bands)."""
        u = self.qp.unknowns(self.numbers, self.raw.v)
        return self.composition.layout.expand(u)

    @cached_property
    def raw_certificate(self) -> Certificate:
        """That of the solver's own answer; its error is at most its distance from the final one's."""
        if not self.polished:
            return self.certificate
        bound = np.abs(self.raw_alpha - self.alpha) + self.certificate.alpha_error_bound
        return replace(qp.certify(self.qp, self.raw, 0.0), alpha_error_bound=bound)

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.composition.layout.expand(self.unknowns)

    @cached_property
    def at_bounds(self) -> Active:
        """-1 for an unknown at its lower bound, 1 at the upper, 0 for a free one, (size,)."""
        return self.composition.unknowns_at(self.numbers, self.point.at)

    @cached_property
    def active(self) -> Active:
        """The same of the coefficients, (n_materials, n_bands)."""
        return self.composition.layout.expand(self.at_bounds)

    @cached_property
    def match_multipliers(self) -> Array:
        """D of the match, (n_configurations, n_bands) in 1/m²; NaN where nothing was matched."""
        matched = np.isfinite(self.target)
        for term, stated in self.composition.compiled.rows_of:
            if term in self.composition.matches:
                # An equality, or a lower and an upper limit.
                y = [self.point.y[rows] for rows in stated]
                values = y[0] if len(y) == 1 else y[1] - y[0]
                return np.where(matched, values.reshape(matched.shape), np.nan)
        return np.full(matched.shape, np.nan)

    @property
    def asks_for_measured_time(self) -> bool:
        """Whether a constraint or a term of weight above 0 ties alpha to the measured T."""
        composed = self.composition
        terms = zip(composed.objective.terms, composed.weights, strict=True)
        return bool(composed.matches) or any(t is composed.soft_match and w > 0 for t, w in terms)

    @cached_property
    def effects(self) -> dict[str, float]:
        """The sizes of the further unknowns, by name."""
        layout = self.composition.layout
        sizes = self.unknowns[layout.n_alpha :]
        return dict(zip(layout.further, sizes.tolist(), strict=True))

    @property
    def matches_uncertain_room(self) -> bool:
        """Whether T was matched within the uncertainty of volume, areas and climate."""
        match = self.composition.soft_match
        return match is not None and match.room

    def gap_shares(self, configuration: int) -> dict[str, float]:
        """Return the shares of the remaining b - S'alpha that each uncertainty takes up, 1 in all.

        By "volume", "areas", "climate" and "T". With C = U + D'D the difference is C times its pull:
        U pull is what T's own uncertainty takes up, D' D pull what volume, areas and climate do. {}
        where no room is uncertain, or nothing remains.
        """
        data = self.numbers
        if not self.matches_uncertain_room:
            return {}
        left = np.nan_to_num(data.target).ravel() - data.match_matrix @ self.unknowns
        pull = data.match_whitener.T @ (data.match_whitener @ left)
        d = data.room_changes
        n = 2 + len(self.configurations.materials)
        of_time = np.nan_to_num(data.target_uncertainty).ravel() ** 2 * pull
        groups = {"volume": d[:1], "areas": d[1:n], "climate": d[n:]}
        parts = {name: g.T @ (g @ pull) for name, g in groups.items()} | {"T": of_time}
        k = data.layout.n_bands
        own = slice(configuration * k, (configuration + 1) * k)
        total = np.sum([part[own] for part in parts.values()], axis=0)
        square = float(total @ total)
        return (
            {name: float(part[own] @ total) / square for name, part in parts.items()}
            if square
            else {}
        )

    @property
    def has_shared_errors(self) -> bool:
        """Whether T was matched with errors that all bands share: of the room, or of the tables."""
        return getattr(self.composition.prior, "common", False) or self.matches_uncertain_room

    @property
    def has_density(self) -> bool:
        """Whether the objective is a log-density: not of `lse` and `robust`."""
        prior = self.composition.prior
        return isinstance(prior, PriorDeviation) and prior.sigma is None

    def density(self) -> Densities:
        """Return the density of the unknowns, for `rtcal.posterior.distribution`.

        Raises ModelError if the objective is no log-density (`lse`, `robust`).
        """
        prior, numbers, layout = self.composition.prior, self.numbers, self.composition.layout
        if not self.has_density:
            raise ModelError(
                f"{prior!r} is no log-density of what is known of alpha: it has no posterior. Use "
                'method "soft" or "mle"'
            )

        def unmeasured() -> Density:
            missing = np.full_like(numbers.target, np.nan)
            return self._density(replace(numbers, target=missing, time=missing))

        return Densities(
            rows=layout.alpha_rows,
            n_bands=layout.n_bands,
            further=layout.further,
            separate=self._independent(prior),
            posterior=self._density(numbers),
            prior=unmeasured,
        )

    def by_time(self) -> Array:
        """Return d alpha / dT in 1/s, (n_materials, n_bands, n_configurations, n_bands).

        Coefficients at a bound stay there.
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
            before, after = (self.composition.qp(_at_one(numbers, end, place)) for end in ends)
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
        """Standard deviation of the linear estimate's error, (size,) over the unknowns.

        The prior's covariance is the room's, also if the method assumes another covariance. An unknown
        uncertainty of T counts as 0. With linear observations it is the Gaussian posterior's, with the
        objective's prior.
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

    def estimate_covariance(self) -> Array:
        """Return the covariance of that error, (n_bands, n_materials, n_materials)."""
        layout, gain = self.composition.layout, self._gain
        sigma, shift, prior = self._room_prior
        _, cross, innovation = self._covariances
        n = layout.n_alpha
        columns = np.eye(len(sigma), n) * sigma[:n]
        whole = sigma[:n, np.newaxis] * prior.correlate(columns, layout)[:n]
        whole = whole + np.outer(shift[:n], shift[:n])
        change = gain[:n] @ cross[:n].T
        whole = whole - change - change.T + gain[:n] @ innovation @ gain[:n].T
        rows = np.array(layout.alpha_rows) * layout.n_bands
        return np.array([whole[np.ix_(rows + k, rows + k)] for k in range(layout.n_bands)])

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

    @cached_property
    def gaussian_interval(self) -> tuple[Array, Array]:
        """Ends of the coefficients' normal 90 % interval within the box, (n_materials, n_bands) each.

        Each interval holds the answer.
        """
        u, numbers, sigma = self.unknowns, self.numbers, self.estimate_sigma
        free = sigma > 0
        spread = np.where(free, sigma, 1.0)
        mean = self.unbounded(spread)
        low, high = (numbers.lower - mean) / spread, (numbers.upper - mean) / spread
        ends = [truncnorm.ppf(share, low, high) for share in (0.05, 0.95)]
        lower, upper = (np.where(free, mean + spread * end, u) for end in ends)
        expand = self.composition.layout.expand
        return expand(np.minimum(lower, u)), expand(np.maximum(upper, u))

    def unbounded(self, sigma: Array) -> Array:
        """Return where the unknowns would be without the box, (size,): m sigma² beyond a bound.

        m is the bound's multiplier, ``sigma`` (size,) the standard deviation without the box.
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
        """b - S'mu in m², (n_configurations * n_bands,), and its covariance S'KS + U.

        K is the prior's covariance with the room's sigma and correlations. U is that of b through T (0
        where unknown) and through the volume, areas and climate that the room calls uncertain. The
        sizes of effects have their own prior. b is NaN in a band without a match. An unreachable band
        counts with the b of its measured T, or with the nearest reachable b if no b has that T.
        """
        numbers = self.numbers
        target = numbers.target.copy()
        for band in self.unreachable:
            if np.isfinite(band.target):
                place = numbers.layout.centre_frequencies.index(band.frequency)
                target[band.configuration, place] = band.target
        *_, covariance = self._covariances
        return target.ravel() - numbers.match_matrix @ numbers.mu, covariance

    def _independent(self, prior: PriorDeviation) -> bool:
        """Whether no term couples bands and each band has at most one matched sum."""
        composed = self.composition
        parts = composed.objective.terms + tuple(composed.row_constraints)
        return (
            composed.layout.n_configurations == 1
            and not composed.layout.further
            and not prior.correlated
            and not self.matches_uncertain_room
            and all(type(t) in (PriorDeviation, SoftMatch) for t in composed.objective.terms)
            and all(type(r) is ExactMatch for r in composed.row_constraints)
            and len(parts) <= 2
        )

    def _density(self, numbers: Numbers) -> Density:
        """The density of the unknowns: a match with an uncertain b gives its sum to within u_b."""
        program, u, layout = self.composition.qp(numbers), self.unknowns, numbers.layout
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
