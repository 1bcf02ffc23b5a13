"""From rooms, measurements and terms to the numbers of one solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.layout import Layout, Observed, Whitened
from rtcal.calibration.problem_data import MeasuredTimes, ProblemData
from rtcal.calibration.terms import (
    BoundConstraint,
    LinearObservations,
    Objective,
    ObjectiveTerm,
    SharedMaterials,
    SoftMatch,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Assembler:
    """The data common to all solves of one compiled problem."""

    layout: Layout
    equation: LinearEquation
    objective: Objective
    boxes: tuple[BoundConstraint, ...]
    prior: int
    """Index of the prior among the objective terms."""
    sigma: float | None
    """Standard deviation of every coefficient, if the prior states one in place of the rooms'."""

    def weights(self, stated: Mapping[ObjectiveTerm, float] | None) -> tuple[float, ...]:
        """Return the terms' weights, divided by the prior's, which changes no answer."""
        chosen = list(self.objective.weights)
        for term, weight in checks.mapped("weights", {} if stated is None else stated).items():
            if term not in self.objective.terms:
                raise DataError(f"weights has {term!r}, which is no term of the objective")
            checks.number(f"weights[{term!r}]", weight)
            if not (np.isfinite(weight) and weight >= 0):
                raise DataError(f"weights[{term!r}] = {weight:g} is not finite and 0 or more")
            chosen[self.objective.terms.index(term)] = float(weight)
        prior = chosen[self.prior]
        if prior == 0:
            raise DataError("the prior deviation has weight 0; the answer would not be unique")
        for further in self.objective.further:
            if chosen[self.objective.terms.index(further)] == 0:
                raise DataError(
                    f'{type(further).__name__}("{further.name}") has weight 0: then nothing keeps '
                    "its size, and the answer would not be unique. Leave the term out instead"
                )
        return tuple(w / prior for w in chosen)

    def problem_data(
        self,
        configurations: Configurations,
        measured: Sequence[MeasuredTimes],
        weights: Mapping[ObjectiveTerm, float] | None,
        observed: Mapping[LinearObservations, Observed] | None = None,
    ) -> ProblemData:
        """Return the numbers; DataError where priors, bounds or data break a rule."""
        room = configurations.union
        shape = room.alpha.shape
        sigma = room.sigma
        if self.sigma is not None:  # a coefficient with sigma = 0 stays fixed
            sigma = np.where(room.sigma > 0, self.sigma, 0.0)
        lower = np.zeros(shape) if room.alpha_min is None else room.alpha_min
        upper = np.ones(shape)
        for box in self.boxes:
            lower, upper = box.box(room, lower, upper)
        if self._shares:
            self._check_shared(room)
        lower, upper = self._tightest(lower, np.maximum), self._tightest(upper, np.minimum)
        alpha = room.alpha
        if self._shares:
            alpha, sigma = alpha[self.layout.first], sigma[self.layout.first]
        self._check_box(room, alpha, sigma, lower, upper)
        further = self.objective.further
        c, k = len(measured), shape[1]
        gains = np.zeros((c, k, len(further)))
        for p, term in enumerate(further):
            gains[:, :, p] = term.gains(c, k)

        def flat(values: Array, more: list[float]) -> Array:
            return np.concatenate([values.ravel(), more]) if more else values.ravel()

        times = np.array([d.reverberation_time for d in measured])
        uncertainty = np.array([d.uncertainty for d in measured])
        if np.isfinite(uncertainty).any():
            pairs = zip(configurations.rooms, times, strict=True)
            uncertainty *= np.abs([self.equation.target_sensitivity(r, t) for r, t in pairs])
        held = (sigma == 0) | (lower == upper)
        data = ProblemData(
            layout=self.layout,
            mu=flat(alpha, [t.mean for t in further]),
            sigma=flat(sigma, [t.sigma for t in further]),
            lower=flat(lower, [0.0] * len(further)),
            upper=flat(upper, [np.inf] * len(further)),
            areas=self._summed(configurations.areas),
            gains=gains,
            time=times,
            target=self.target(configurations.rooms, times),
            target_uncertainty=uncertainty,
            largest_target=np.array(
                [[self.equation.largest_mean * r.total_area] for r in configurations.rooms]
            ),
            target_of=partial(self.target, configurations.rooms),  # a lambda cannot be pickled
            weights=self.weights(weights),
            pinned=np.concatenate([held.ravel(), np.zeros(len(further), dtype=bool)]),
            centre=flat(
                np.where(lower == upper, lower, alpha), [max(t.mean, 0.0) for t in further]
            ),
            observed=self._observed(observed or {}),
            room_changes=configurations.target_changes(self.equation, times),
            common=room.common_alpha_sigma,
        )
        for soft in self._soft:
            data = replace(data, target_uncertainty=soft.uncertainty(data))
        return data

    def _observed(self, observed: Mapping[LinearObservations, Observed]) -> dict[object, Whitened]:
        """Return the numbers of each term of linear observations; DataError unless each has some."""
        terms = [t for t in self.objective.terms if isinstance(t, LinearObservations)]
        for term, numbers in checks.mapped("observed", observed).items():
            if term not in terms:
                raise DataError(f"observed has {term!r}, which is no term of the objective")
            checks.instance(f"observed[{term!r}]", numbers, Observed)
        if missing := [t for t in terms if t not in observed]:
            raise DataError(f"observed lacks {missing[0]!r}: it needs its numbers to be solved")
        return {term: observed[term].over(self.layout) for term in terms}

    def target(self, rooms: Sequence[Room], times: Array) -> Array:
        """Return b in m² for T in s, both (n_configurations, n_bands)."""
        return np.array(
            [self.equation.target(room, t) for room, t in zip(rooms, times, strict=True)]
        )

    @cached_property
    def _soft(self) -> list[SoftMatch]:
        return [t for t in self.objective.terms if isinstance(t, SoftMatch)]

    @cached_property
    def _shares(self) -> bool:
        return self.layout.n_rows < len(self.layout.materials)

    def _tightest(self, values: Array, narrower: np.ufunc) -> Array:
        if not self._shares:
            return values
        out = values[self.layout.first].copy()
        for material, row in enumerate(self.layout.rows):
            out[row] = narrower(out[row], values[material])
        return out

    def _summed(self, areas: Array) -> Array:
        if not self._shares:
            return areas
        out = np.zeros((len(areas), self.layout.n_rows))
        for material, row in enumerate(self.layout.rows):
            out[:, row] += areas[:, material]
        return out

    def _check_shared(self, room: Room) -> None:
        for material, row in enumerate(self.layout.rows):
            first = int(self.layout.first[row])
            for name in ("alpha", "sigma"):
                values = getattr(room, name)
                if not np.array_equal(values[material], values[first]):
                    k = int(np.flatnonzero(values[material] != values[first])[0])
                    raise DataError(
                        f"{room.place(name, material, k)} = {values[material, k]:g}, but "
                        f"{room.place(name, first, k)} = {values[first, k]:g}; materials that "
                        "share their coefficients have one prior"
                    )

    def _check_box(
        self, room: Room, alpha: Array, sigma: Array, lower: Array, upper: Array
    ) -> None:
        outside = (alpha < lower) | (alpha > upper)
        for bad, rule in (
            (lower > upper, "the bounds contradict each other"),
            (outside & (sigma == 0), "sigma is 0, but alpha is outside its bounds"),
        ):
            if bad.any():
                i, k = (int(v) for v in np.argwhere(bad)[0])
                set_by = self._set_by(room, i, k, lower[i, k], upper[i, k])
                raise DataError(
                    f"{self.layout.place(i * alpha.shape[1] + k)} = {alpha[i, k]:g}, bounds "
                    f"{lower[i, k]:g} to {upper[i, k]:g}: {rule}; they come from {set_by}"
                )

    def _set_by(self, room: Room, row: int, band: int, lower: float, upper: float) -> str:
        """Name the terms that set a coefficient's bounds."""
        materials = [m for m, r in enumerate(self.layout.rows) if r == row]
        zeros, ones = np.zeros(room.alpha.shape), np.ones(room.alpha.shape)
        names = []
        if room.alpha_min is not None and room.alpha_min[materials, band].max() == lower > 0:
            names.append("the room's alpha_min")
        for box in self.boxes:
            low, high = (b[materials, band] for b in box.box(room, zeros, ones))
            if low.max() == lower > 0 or high.min() == upper < 1:
                names.append(repr(box))
        return " and ".join(names)


def layout_of(
    configurations: Configurations,
    objective: Objective,
    shared: Sequence[SharedMaterials],
) -> Layout:
    """Return the order of the unknowns; ModelError for terms that do not fit the rooms."""
    materials = configurations.materials
    row_of = {m: m for m in materials}
    for term in shared:
        for group in term.groups(materials):
            for name in group:
                if name not in materials:
                    raise DataError(
                        f'"{name}" is no material of the room; it has {", ".join(materials)}'
                    )
            merged = {row_of[m] for m in group}
            head = next(m for m in materials if row_of[m] in merged)
            row_of = {m: head if r in merged else r for m, r in row_of.items()}
    heads = list(dict.fromkeys(row_of.values()))
    further = tuple(t.name for t in objective.further)
    if len(set(further)) < len(further):
        raise ModelError(f"two further unknowns have one name: {', '.join(further)}")
    return Layout(
        materials=materials,
        rows=tuple(heads.index(row_of[m]) for m in materials),
        centre_frequencies=tuple(float(f) for f in configurations.union.centre_frequencies),
        n_configurations=len(configurations.rooms),
        further=further,
    )


def require_same_shape(built: Configurations, asked: Configurations) -> Configurations:
    """Return ``asked`` if it has the shape that the problem was built with, else DataError."""
    for room in asked.rooms:
        if not isinstance(room, Room):
            raise DataError(f"room = {room!r} is not a rtcal.Room")
    if len(built.rooms) != len(asked.rooms):
        raise DataError(
            f"{len(asked.rooms)} configurations; the problem was built with {len(built.rooms)}"
        )
    for old, new in zip(built.rooms, asked.rooms, strict=True):
        if new.materials != old.materials:
            raise DataError(f"room has materials {new.materials}; built with {old.materials}")
        if not np.array_equal(new.centre_frequencies, old.centre_frequencies):
            has = ", ".join(bands.label(f) for f in new.centre_frequencies)
            raise DataError(f"room has other bands than the one built with: {has}")
    return asked
