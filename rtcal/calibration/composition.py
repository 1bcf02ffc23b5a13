"""A calibration composed of terms for given rooms: order of the unknowns, values and programme.

`Composition.numbers` brings the values of the room and its T into the order of the unknowns. They are
inserted in the compiled problem, which rooms with the same materials and bands share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.calibration.measured import MeasuredTimes
from rtcal.calibration.qp import Active, CompiledProblem, closed_form, compile_once
from rtcal.calibration.terms import (
    AddedAbsorption,
    Bounds,
    ExactMatch,
    LinearObservations,
    Objective,
    Observed,
    Shared,
    SoftMatch,
)
from rtcal.calibration.unknowns import Configurations, Layout, Numbers
from rtcal.support import checks
from rtcal.support.errors import DataError, SolverError
from rtcal.support.types import Array

_KEPT = 1e-9
"""By how much coefficients may miss a constraint that they keep, over the size of its row."""


@dataclass(frozen=True, eq=False, repr=False)
class Composition:
    """Objective and constraints of a calibration, for one room or several configurations of it.

    ``objective`` is the sum of terms to be minimised. ``constraints`` are those of `rtcal.terms`, or
    functions of a `rtcal.terms.Model`. ``equation`` is the reverberation equation, by which the
    measured T gives the absorption area b of the surfaces.
    """

    objective: Objective
    constraints: tuple[Any, ...]
    room: Room | Configurations
    equation: LinearEquation

    @cached_property
    def configurations(self) -> Configurations:
        """Rooms of the calibration, as configurations; one room is a single configuration."""
        return Configurations([self.room]) if isinstance(self.room, Room) else self.room

    @cached_property
    def compiled(self) -> CompiledProblem:
        """Compiled problem of this composition.

        Compositions with equal terms, materials and bands share one compiled problem. Raises DataError
        or ModelError if the terms do not fit the rooms.
        """
        rooms = self.configurations
        frequencies = tuple(rooms.rooms[0].centre_frequencies.tolist())
        return compile_once(
            (rooms.materials, frequencies, len(rooms.rooms)),
            self.objective.terms,
            self.weights,
            [c for c in self.constraints if c not in self.boxes],
        )

    @property
    def layout(self) -> Layout:
        """Order of the unknowns of the calibration."""
        return self.compiled.layout

    @property
    def boxes(self) -> list[Bounds]:
        """Constraints that are lower and upper bounds of single unknowns."""
        return [c for c in self.constraints if isinstance(c, Bounds)]

    @property
    def row_constraints(self) -> list[Any]:
        """Constraints other than `Bounds` and `Shared`: the rows of the quadratic programme (QP)."""
        return [c for c in self.constraints if not isinstance(c, Bounds | Shared)]

    @property
    def matches(self) -> list[ExactMatch]:
        """Constraints `ExactMatch` and `MatchWithin`, which match the measured T."""
        return [c for c in self.constraints if isinstance(c, ExactMatch)]

    @cached_property
    def soft_match(self) -> SoftMatch | None:
        """Term for the squared deviation from the measured T; None without one."""
        return next((t for t in self.objective.terms if isinstance(t, SoftMatch)), None)

    @cached_property
    def observations(self) -> list[LinearObservations]:
        """Terms for linear observations of the coefficients."""
        return [t for t in self.objective.terms if isinstance(t, LinearObservations)]

    @cached_property
    def effects(self) -> list[AddedAbsorption]:
        """Terms that add a further unknown, the size of an effect."""
        return [t for t in self.objective.terms if isinstance(t, AddedAbsorption)]

    @cached_property
    def prior(self) -> Any:
        """Term for the deviation from the input coefficients, which makes the answer unique."""
        return next(t for t in self.objective.terms if getattr(t, "is_prior", False))

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """Weights of the terms over that of the prior; this division changes no answer."""
        every = self.objective.weights
        prior = every[self.objective.terms.index(self.prior)]
        return tuple(w / prior for w in every)

    def unknowns_at(self, numbers: Numbers, at: Active) -> Active:
        """Return for each unknown -1 at its lower bound, 1 at its upper bound, else 0, (size,).

        ``at`` (n_variables,) has the same states for all variables of the quadratic programme, of which
        some are auxiliary. ``numbers`` are the values of room and measurement.
        """
        return np.where(numbers.movable, at[self.compiled.places], 0).astype(np.int8)

    def without(self, term: Any) -> Composition:
        """Return the composition without one term of the objective."""
        pairs = zip(self.objective.terms, self.objective.weights, strict=True)
        left = [(t, w) for t, w in pairs if t != term]
        terms, weights = zip(*left, strict=True)
        return replace(self, objective=Objective(terms, weights))

    def value(self, numbers: Numbers, u: Array) -> float:
        """Return the objective's value for given unknowns, or infinity where these break a constraint.

        ``u`` (size,) are the coefficients and, after these, the sizes of further effects. ``numbers``
        are the values of room and measurement. Auxiliary variables of the terms take their optimal
        values. Bounds count as constraints.
        """
        low, high = (u - end for end in numbers.box)
        slack = _KEPT * (1 + np.abs(u))
        if (low < -slack).any() or (high > slack).any():
            return np.inf
        program, places = self.compiled.filled(numbers), self.compiled.places[numbers.sigma > 0]
        lower, upper = program.lower.copy(), program.upper.copy()
        lower[places] = upper[places] = ((u - numbers.mu) * numbers.inverse_sigma)[
            numbers.sigma > 0
        ]
        program = replace(program, lower=lower, upper=upper)
        point = closed_form(program)
        if point is None:
            raise SolverError("the objective has no value at these coefficients")
        left = program.b - program.row_sums(point.v)
        slack = _KEPT * (1 + program.absolute.row_sums(np.abs(point.v)))
        if (left < -slack).any() or (left > slack)[program.equal].any():
            return np.inf
        return float(point.v @ (program.gradient(point.v) + program.c)) / 2

    def convexity(self, numbers: Numbers) -> float:
        """Return a lower limit m of the objective's curvature: f - m |x|² / 2 is convex.

        f is the objective, and x are the deviations of the unknowns from their input in sigmas. m is 0
        if the term that keeps the coefficients near the input has no method ``convexity``. ``numbers``
        are the values of room and measurement.
        """
        of_prior = getattr(self.prior, "convexity", None)
        pairs = zip(self.objective.terms, self.weights, strict=True)
        weights = [w for t, w in pairs if isinstance(t, AddedAbsorption)]
        return min([of_prior(numbers) if of_prior else 0.0, *weights])

    def numbers(
        self,
        measured: Sequence[MeasuredTimes],
        observed: Mapping[LinearObservations, Observed] | None = None,
    ) -> Numbers:
        """Return the values of room and measurement in the order of the unknowns, ready to be solved.

        ``measured`` has the measured T of each configuration. ``observed`` has the measured values of
        each term for linear observations (`LinearObservations`); None if the objective has no such
        term. Raises DataError if bounds contradict each other or exclude a coefficient with sigma = 0,
        if materials with shared coefficients have different input values, or if ``observed`` does not
        fit the terms.
        """
        configurations, layout, equation = self.configurations, self.layout, self.equation
        room = configurations.union
        alpha, sigma = room.alpha, room.sigma
        # The sigma of a `PriorDeviation` acts here: it is in x, not in the term.
        stated: float | None = getattr(self.prior, "sigma", None)
        if stated is not None:  # a coefficient with sigma = 0 stays fixed
            sigma = np.where(sigma > 0, stated, 0.0)
        areas, floors = configurations.areas, room.least_alpha
        if layout.n_alpha_rows < len(layout.materials):
            self._check_shared(room)
            alpha, sigma = alpha[layout.first], sigma[layout.first]
            rows = [
                np.flatnonzero(np.array(layout.alpha_rows) == row)
                for row in range(layout.n_alpha_rows)
            ]
            floors = np.array([floors[r].max(axis=0) for r in rows])
            areas = np.stack([areas[:, r].sum(axis=1) for r in rows], axis=1)
        mu, lower = alpha.ravel(), floors.ravel().copy()
        upper = room.most_alpha[layout.first].ravel()
        for box in self.boxes:
            where = layout.index(box.material, box.band)
            low, high = box.of(mu[where])
            lower[where] = np.maximum(lower[where], low)
            upper[where] = np.minimum(upper[where], high)
        self._check_box(mu, sigma.ravel(), lower, upper, floors.ravel())
        further = self.effects
        times = np.array([d.reverberation_time for d in measured])
        c, k = times.shape
        gains = np.zeros((c, k, len(further)))
        for p, term in enumerate(further):
            gains[:, :, p] = term.gains(c, k)
        pairs = [*zip(configurations.rooms, times, strict=True)]
        sensitivity = np.abs([equation.target_sensitivity(r, t) for r, t in pairs])
        with np.errstate(invalid="ignore"):
            uncertainty = np.array([d.uncertainty for d in measured]) * sensitivity

        def flat(values: Array, more: list[float]) -> Array:
            return np.concatenate([values.ravel(), more])

        numbers = Numbers(
            layout=layout,
            mu=flat(mu, [t.mean for t in further]),
            sigma=flat(sigma, [t.sigma for t in further]),
            lower=flat(lower, [0.0] * len(further)),
            upper=flat(upper, [np.inf] * len(further)),
            areas=areas,
            gains=gains,
            time=times,
            target=np.array([equation.target(r, t) for r, t in pairs]),
            target_uncertainty=uncertainty,
            target_sensitivity=sensitivity,
            equation=equation,
            rooms=tuple(configurations.rooms),
            observed=self._observed(observed or {}, mu, sigma.ravel()),
            room_changes=configurations.target_changes(equation, times),
            common=room.common_alpha_sigma,
        )
        if self.soft_match is None:
            return numbers
        return replace(numbers, target_uncertainty=self.soft_match.uncertainty(numbers))

    def _observed(
        self, observed: Mapping[LinearObservations, Observed], mu: Array, sigma: Array
    ) -> dict[object, Array]:
        """Return the numbers of each term of linear observations; DataError unless each has some."""
        terms = self.observations
        for term, given in checks.mapped("observed", observed).items():
            if term not in terms:
                raise DataError(f"observed has {term!r}, which is not a term of the objective")
            checks.instance(f"observed[{term!r}]", given, Observed)
        if missing := [t for t in terms if t not in observed]:
            raise DataError(
                f"observed has no numbers for {missing[0]!r}, which is in the objective: give them"
            )
        return {term: observed[term].over(self.layout, mu, sigma) for term in terms}

    def _check_shared(self, room: Room) -> None:
        for material, row in enumerate(self.layout.alpha_rows):
            first = int(self.layout.first[row])
            for name in ("alpha", "sigma"):
                values = getattr(room, name)
                if not np.array_equal(values[material], values[first]):
                    k = int(np.flatnonzero(values[material] != values[first])[0])
                    raise DataError(
                        f"{room.place(name, material, k)} = {values[material, k]:g}, but "
                        f"{room.place(name, first, k)} = {values[first, k]:g}; materials that "
                        "share their coefficients must have the same prior"
                    )

    def _check_box(
        self, mu: Array, sigma: Array, lower: Array, upper: Array, floors: Array
    ) -> None:
        outside = (mu < lower) | (mu > upper)
        for bad, rule in (
            (lower > upper, "the lower bound is above the upper one"),
            (outside & (sigma == 0), "sigma is 0, so alpha cannot move into its bounds"),
        ):
            if not bad.any():
                continue
            u = int(np.argmax(bad))
            names = ["the room's alpha_min"] if floors[u] == lower[u] > 0 else []
            for box in self.boxes:
                low, high = box.of(mu[u])
                if u in self.layout.index(box.material, box.band) and (
                    low == lower[u] > 0 or high == upper[u] < 1
                ):
                    names.append(repr(box))
            raise DataError(
                f"{self.layout.place(u)} = {mu[u]:g}, bounds {lower[u]:g} to {upper[u]:g}: "
                f"{rule}. The bounds come from {' and '.join(names)}"
            )
