"""Configurations of one room, and how they become the numbers of one solve.

With the curtain open or drawn, with or without an audience: they share their materials' coefficients.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.changed_time import refuse_other_priors
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import target_changes
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
from rtcal.support.text import shortened
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Configurations:
    """Several configurations of one room, which share their materials' coefficients.

    Parameters
    ----------
    rooms : sequence of Room
        One per configuration, each with its volume, air and areas. Materials of the same name are
        one unknown, so all rooms must state the same alpha and sigma for them.
    names : sequence of str, optional
        Names of the configurations; the rooms' names if not stated.

    Raises
    ------
    DataError
        If the bands differ, or a material's prior does.

    Examples
    --------
    >>> import numpy as np
    >>> room = Room(name="bare", volume=60, materials=["wall", "floor"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> covered = Room(name="mat on floor", volume=60, materials=["wall", "mat"], areas=[74, 20],
    ...             alpha=[[0.1], [0.6]], sigma=[[0.02], [0.01]], centre_frequencies=[1000])
    >>> Configurations([room, covered]).areas.tolist()
    [[74.0, 20.0, 0.0], [74.0, 0.0, 20.0]]
    """

    rooms: Sequence[Room]
    names: Sequence[str] = ()

    def __repr__(self) -> str:
        materials = {material for room in self.rooms for material in room.materials}
        return (
            f"<Configurations: {shortened(', '.join(self.names))}, {len(materials)} materials, "
            f"{bands.span(self.rooms[0].centre_frequencies)}>"
        )

    def __post_init__(self) -> None:
        if not isinstance(self.rooms, Iterable):
            raise DataError(f"rooms = {self.rooms!r} is not a list of rtcal.Room")
        rooms = tuple(self.rooms)
        if not rooms:
            raise DataError("rooms is empty; there is at least one configuration")
        for i, room in enumerate(rooms):
            if not isinstance(room, Room):
                raise DataError(f"rooms[{i}] = {room!r} is not a rtcal.Room")
        if isinstance(self.names, str) or not isinstance(self.names, Iterable):
            raise DataError(f"names = {self.names!r} is not a list of texts")
        names = tuple(str(n) for n in self.names) or tuple(r.name for r in rooms)
        if len(names) != len(rooms):
            raise DataError(f"{len(names)} names for {len(rooms)} configurations")
        object.__setattr__(self, "rooms", rooms)
        object.__setattr__(self, "names", names)
        refuse_other_priors(rooms, [f'configuration "{name}"' for name in names])
        if len(rooms) > 1:
            self._compare_priors()

    def _compare_priors(self) -> None:
        pairs = self._pairs()
        for name, room in zip(self.names, self.rooms, strict=True):
            if room.band_correlation != self.rooms[0].band_correlation:
                raise DataError(
                    f'configuration "{name}": band_correlation = {room.band_correlation:g}, but '
                    f'"{self.names[0]}" says {self.rooms[0].band_correlation:g}'
                )
            for key in ("volume_sigma", "common_area_sigma", "common_alpha_sigma"):
                stated, other = getattr(room, key), getattr(self.rooms[0], key)
                if stated != other:
                    raise DataError(
                        f'configuration "{name}": {key} = {stated:g}, but "{self.names[0]}" says '
                        f"{other:g}; it is one room"
                    )
            for (a, b), value in pairs.items():
                stated = room.material_correlation.get(
                    (a, b), room.material_correlation.get((b, a), 0.0)
                )
                if a in room.materials and b in room.materials and stated != value:
                    raise DataError(
                        f'configuration "{name}": material_correlation["{a}", "{b}"] = {stated:g}, but '
                        f"another configuration says {value:g}"
                    )

    def _pairs(self) -> dict[tuple[str, str], float]:
        """The correlations of two materials, from all configurations."""
        pairs: dict[tuple[str, str], float] = {}
        for room in self.rooms:
            for (a, b), value in room.material_correlation.items():
                pairs.setdefault((b, a) if (b, a) in pairs else (a, b), value)
        return pairs

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material of any configuration, in order of appearance."""
        return tuple(dict.fromkeys(m for room in self.rooms for m in room.materials))

    @cached_property
    def areas(self) -> Array:
        """Areas in m², (n_configurations, n_materials); 0 where a configuration lacks a material."""
        if len(self.rooms) == 1:
            return self.rooms[0].areas[np.newaxis]
        materials = self.materials
        areas = np.zeros((len(self.rooms), len(materials)))
        for c, room in enumerate(self.rooms):
            areas[c, [materials.index(m) for m in room.materials]] = room.areas
        return areas

    def target_changes(self, equation: LinearEquation, times: Array) -> Array:
        """Return `rtcal.acoustics.room_errors.target_changes`, (n_changes, n_configurations n_bands).

        Configurations share the volume and the areas; each has a climate of its own. Without any change
        where no room is uncertain. ``times`` is (n_configurations, n_bands) in s.
        """
        checks.instance("equation", equation, LinearEquation)
        times = checks.array("times", times)
        if times.shape != (shape := (len(self.rooms), self.rooms[0].n_bands)):
            raise DataError(
                f"times has shape {times.shape}; (n_configurations, n_bands) is {shape}"
            )
        if not any(room.is_uncertain for room in self.rooms):
            return np.zeros((0, times.size))
        n, (c, k) = len(self.materials), times.shape
        changes = np.zeros((2 + n + 2 * c, c, k))
        for i, (room, t) in enumerate(zip(self.rooms, times, strict=True)):
            of_room = target_changes(equation, room, t)
            changes[:2, i] = of_room[:2]
            changes[[2 + self.materials.index(m) for m in room.materials], i] = of_room[2:-2]
            changes[2 + n + 2 * i : 4 + n + 2 * i, i] = of_room[-2:]
        return changes.reshape(len(changes), c * k)

    @cached_property
    def union(self) -> Room:
        """A room with every material once: its prior, its largest area and the largest error of it."""
        if len(self.rooms) == 1:
            return self.rooms[0]
        first = self.rooms[0]
        owners = [next(r for r in self.rooms if m in r.materials) for m in self.materials]
        rows = [r.materials.index(m) for r, m in zip(owners, self.materials, strict=True)]
        floors = [
            np.max(
                [
                    np.zeros(first.n_bands)
                    if r.alpha_min is None
                    else r.alpha_min[r.materials.index(m)]
                    for r in self.rooms
                    if m in r.materials
                ],
                axis=0,
            )
            for m in self.materials
        ]
        return Room(
            name=first.name,
            volume=first.volume,
            materials=self.materials,
            areas=self.areas.max(axis=0),
            alpha=np.array([r.alpha[i] for r, i in zip(owners, rows, strict=True)]),
            sigma=np.array([r.sigma[i] for r, i in zip(owners, rows, strict=True)]),
            centre_frequencies=first.centre_frequencies,
            air=next((r.air for r in self.rooms if r.air is not None), None),
            alpha_min=np.array(floors),
            band_correlation=first.band_correlation,
            material_correlation=self._pairs(),
            volume_sigma=first.volume_sigma,
            area_sigma=np.array(
                [
                    max(r.area_sigma[r.materials.index(m)] for r in self.rooms if m in r.materials)
                    for m in self.materials
                ]
            ),
            common_area_sigma=first.common_area_sigma,
            common_alpha_sigma=first.common_alpha_sigma,
            climate_sigma=tuple(np.max([r.climate_sigma for r in self.rooms], axis=0).tolist()),
        )


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
        pairs = zip(configurations.rooms, times, strict=True)
        sensitivity = np.abs([self.equation.target_sensitivity(r, t) for r, t in pairs])
        with np.errstate(invalid="ignore"):
            uncertainty = np.array([d.uncertainty for d in measured]) * sensitivity
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
            target=np.array(
                [
                    self.equation.target(r, t)
                    for r, t in zip(configurations.rooms, times, strict=True)
                ]
            ),
            target_uncertainty=uncertainty,
            target_sensitivity=sensitivity,
            largest_target=np.array(
                [[self.equation.largest_mean * r.total_area] for r in configurations.rooms]
            ),
            equation=self.equation,
            rooms=tuple(configurations.rooms),
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
    for room in checks.instance("configurations", asked, Configurations).rooms:
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
            has = ", ".join(bands.labels(new.centre_frequencies))
            raise DataError(f"room has other bands than the one built with: {has}")
    return asked
