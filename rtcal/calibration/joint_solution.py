"""The calibrated coefficients of all configurations of a room, over one set of unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.changed_time import (
    KnownRoom,
    MeasuredState,
    correlation_of,
    normal_quantiles,
)
from rtcal.acoustics.equations import LinearEquation
from rtcal.calibration import table
from rtcal.calibration.certificate import Certificate
from rtcal.calibration.configurations import Assembler, Configurations
from rtcal.calibration.convex_program import Solution
from rtcal.calibration.feasibility import where_valid
from rtcal.calibration.posterior import Densities, Optimality, correlations, intervals
from rtcal.calibration.problem_data import MeasuredTimes, ProblemData
from rtcal.calibration.terms import (
    LinearObservations,
    MatchConstraint,
    ObjectiveTerm,
    Observed,
    PriorDeviation,
    RoomMatch,
    SoftMatch,
)
from rtcal.calibration.uncertainty import (
    density,
    estimate_covariance,
    estimate_sigma,
    gaussian_interval,
    innovation,
    optimality,
    unbounded,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.truncated import Draws, draws
from rtcal.support.types import Array

_SAME_TIME = 1e-6
"""Relative difference of T below which the calibrated T is the measured one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointSolution:
    """The calibrated coefficients of all configurations of a room, with solution and measurement.

    Attributes
    ----------
    configurations : Configurations
    solution : Solution
        The answer over the unknowns, its multipliers and its certificate.
    equation, method, solver
        As stated in the call.
    measured_times : tuple of MeasuredTimes
        One per configuration.
    assembler, weights, observed
        With which `assemble` repeats the problem for other measurements.
    versions : mapping of str to str
        Of rtcal, Python and the libraries that made it.
    """

    configurations: Configurations
    solution: Solution
    equation: LinearEquation
    method: str
    solver: str
    measured_times: tuple[MeasuredTimes, ...]
    assembler: Assembler
    weights: Mapping[ObjectiveTerm, float] | None = None
    observed: Mapping[LinearObservations, Observed] | None = None
    versions: Mapping[str, str] = field(default_factory=table.versions)

    def assemble(self, measured: Sequence[MeasuredTimes]) -> ProblemData:
        """Return the numbers of the same problem for other measurements."""
        return self.assembler.problem_data(
            self.configurations, measured, self.weights, self.observed
        )

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material of any configuration."""
        return self.configurations.materials

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.solution.model.data.layout.expand(self.solution.unknowns)

    @cached_property
    def active(self) -> NDArray[np.int8]:
        """-1 at the lower bound, 1 at the upper, 0 free, (n_materials, n_bands)."""
        layout = self.solution.model.data.layout
        return layout.expand(self.solution.active.astype(float)).astype(np.int8)

    @property
    def certificate(self) -> Certificate:
        """Error bounds of the answer: its distance from the optimum."""
        return self.solution.certificate

    @property
    def asks_for_measured_time(self) -> bool:
        """Whether a constraint or a term of weight above 0 ties alpha to the measured T."""
        model = self.solution.model
        terms = zip(model.objective.terms, model.data.weights, strict=True)
        return any(isinstance(r, MatchConstraint) for r in model.row_constraints) or any(
            isinstance(t, SoftMatch) and w > 0 for t, w in terms
        )

    @cached_property
    def effects(self) -> dict[str, float]:
        """The sizes of the further unknowns, by name."""
        data = self.solution.model.data
        sizes = data.further(self.solution.unknowns)
        return dict(zip(data.layout.further, sizes.tolist(), strict=True))

    def density(self) -> Densities:
        """Return the density of the unknowns, for `rtcal.posterior.distribution`.

        Raises ModelError if the method has none (`lse`, `robust`).
        """
        return density(self.solution)

    def optimality(self) -> Optimality:
        """Return the optimality conditions at the answer, for `rtcal.posterior.sensitivity`."""
        return optimality(self.solution, self.measured_times, self.assemble, bounds=True)

    @cached_property
    def innovation(self) -> tuple[Array, Array]:
        """b - S'mu and its covariance, over configurations and bands."""
        return innovation(self.solution, self.configurations)

    @cached_property
    def _estimate_sigma(self) -> Array:
        return estimate_sigma(
            self.solution, self.configurations, self.equation, self.measured_times, self.assemble
        )

    @cached_property
    def gaussian_interval(self) -> tuple[Array, Array]:
        """Ends of the coefficients' normal 90 % interval, (n_materials, n_bands) each."""
        layout = self.solution.model.data.layout
        low, high = gaussian_interval(self.solution, self._estimate_sigma, 0.9)
        return layout.expand(low), layout.expand(high)

    @property
    def matches_uncertain_room(self) -> bool:
        """Whether T was matched within the uncertainty of volume, areas and climate."""
        return any(isinstance(t, RoomMatch) for t in self.solution.model.objective.terms)

    def gap_shares(self, configuration: int) -> dict[str, float]:
        """Return the shares of the remaining b - S'alpha that each uncertainty takes up, 1 in all.

        By "volume", "areas", "climate" and "T". With C = U + D'D the difference is C times its pull:
        U pull is what T's own uncertainty takes up, D' D pull what volume, areas and climate do. {}
        where no room is uncertain, or nothing remains.
        """
        data = self.solution.model.data
        pulls = [
            t.pull(self.solution.unknowns, data)
            for t in self.solution.model.objective.terms
            if isinstance(t, RoomMatch)
        ]
        if not pulls:
            return {}
        pull, d = np.nan_to_num(pulls[0]).ravel(), data.room_changes
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
        terms = self.solution.model.objective.terms
        tables = any(isinstance(t, PriorDeviation) and t.common for t in terms)
        return tables or self.matches_uncertain_room

    def known_room(self, configuration: int) -> KnownRoom:
        """Return what is known of a configuration before it is changed, for `rtcal.prediction`.

        Raises DataError for a configuration that there is not, and ModelError if the calibration has
        further unknowns or observations, which a prediction does not know of, or if its equation gives
        no T for the calibrated room.
        """
        last = len(self.configurations.rooms) - 1
        if checks.whole("configuration", configuration, 0) > last:
            raise DataError(
                f"configuration = {checks.shown(configuration)} is not from 0 to {last}"
            )
        if configuration not in self._known_rooms:
            self._known_rooms[configuration] = self._known_room(configuration)
        return self._known_rooms[configuration]

    @cached_property
    def _known_rooms(self) -> dict[int, KnownRoom]:
        """One of each configuration: what is drawn of it is kept by its identity."""
        return {}

    def _known_room(self, configuration: int) -> KnownRoom:
        terms = self.solution.model.objective.terms
        if self.effects or any(isinstance(t, LinearObservations) for t in terms):
            raise ModelError(
                "a prediction knows of T alone: calibrate without effects and other observations, such "
                "as the corrected room of `rtcal apply`"
            )
        rooms = self.configurations.rooms
        room = rooms[configuration]
        rows = [self.materials.index(m) for m in room.materials]
        time = where_valid(self.equation.time, room, room.areas @ self.alpha[rows])
        if not np.isfinite(time).all():
            raise ModelError(f"{self.equation.name}'s equation gives no T for the calibrated room")
        states = [
            MeasuredState(name, other, m.reverberation_time, m.uncertainty / m.reverberation_time)
            for name, other, m in zip(
                self.configurations.names, rooms, self.measured_times, strict=True
            )
        ]
        own = states.pop(configuration)
        with np.errstate(invalid="ignore"):
            same = np.abs(time / own.time - 1) < _SAME_TIME
        measured = np.isfinite(own.time) & self.asks_for_measured_time
        quantiles, correlation = self._distribution
        return KnownRoom(
            room=room,
            equation=self.equation,
            materials=self.materials,
            alpha=self.alpha,
            quantiles=quantiles,
            correlation=correlation,
            time=time,
            measured=measured,
            exact=bool(same[measured].all()),
            log_uncertainty=own.log_uncertainty,
            others=tuple(states),
        )

    @cached_property
    def _separate(self) -> tuple[Densities, list[Draws]] | None:
        """The density and its draws where each band stands for itself; None else."""
        try:
            known = self.density()
        except ModelError:  # lse, robust
            return None
        return (known, draws(known.posterior)) if known.separate else None

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """Ends of the coefficients' 90 % interval where each band stands for itself; None else."""
        if self._separate is None:
            return None
        known, parts = self._separate
        return intervals(self.alpha, known.quantiles(parts), 0.9)

    @cached_property
    def _distribution(self) -> tuple[Array, Array]:
        """Quantiles of the coefficients at `NORMAL`, and their correlation per band.

        The posterior's where each band stands for itself; else that of the linear estimate's error, cut
        at the bounds, which every method has.
        """
        if self._separate is not None:
            known, parts = self._separate
            return known.quantiles(parts), correlations(known, parts)
        solution, layout = self.solution, self.solution.model.data.layout
        covariance = estimate_covariance(
            solution, self.configurations, self.equation, self.measured_times, self.assemble
        )
        centre = layout.expand(unbounded(solution, self._estimate_sigma))
        lower = layout.expand(solution.model.lower)
        sigma, correlation = correlation_of(covariance)
        quantiles = normal_quantiles(centre, sigma, lower)
        return np.where(
            sigma[:, :, np.newaxis] > 0, quantiles, self.alpha[:, :, np.newaxis]
        ), correlation

    @property
    def posterior_sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands)."""
        return self.solution.model.data.layout.expand(self._estimate_sigma)
