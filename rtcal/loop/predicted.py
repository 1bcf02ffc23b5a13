"""Values of every position after a change, predicted by a calibrated simulator.

With alpha the coefficients, f what the simulator gives before the change and h after it, e and e' its
errors in the two states, u the errors of the room's volume, areas and climate, d what it does that a
cover lies in one place, and r the errors of the measurement,

    measured = f(alpha, u) + e + r,    predicted = h(alpha, u) + e' + d.

Reference simulations are simulated in both states, so they show the covariance of e and e' together.
Given what was measured, alpha, u, e and e' are jointly normal. h is linear around the calibrated
coefficients, but along the change of alpha that T20 depends on most: there it is a parabola through
three evaluations of the same paths.

What was covered is another mixture of materials on the same walls, which scatter as before. The new
material is spread evenly over all walls of the material that it covers, so that a tracer re-evaluates
the paths that it has. In truth the cover lies somewhere, most often in one piece. The places that are
tried are the ends of the surface, which depart most from an even cover: the cover fills the surface
from either side along each of its axes. The surface is cut where the cover would end, so that the same
paths are traced, and only the difference between a place and the even cover counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.changes import Change, Variant, changed, name_of, uncovering
from rtcal.acoustics.observables import MATCH, OBSERVABLES, TARGET, observable, parameter_label
from rtcal.acoustics.room import POSITION, Room, checked_uncertainty
from rtcal.acoustics.room_errors import Assumptions, value_changes
from rtcal.files.saved import Result
from rtcal.loop.measured_pairs import (
    GROUPS,
    ControlRuns,
    MaterialScattering,
    Simulated,
    by_band,
    errors_by_scattering,
    material_scattering,
    mean_scattering,
    noise_of_a_run,
    of_level,
    simulated_controls,
)
from rtcal.prediction import words
from rtcal.prediction.predicted import COVERAGE, Predictions
from rtcal.simulators import geometry as facets
from rtcal.simulators.base import (
    Observations,
    Simulator,
    checked_parameters,
    complete,
    jacobian,
    observe,
)
from rtcal.simulators.geometry import Plane, Polyhedron, convex_parts, cut_face
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks, text
from rtcal.support.blocks import Block, Note, Row
from rtcal.support.errors import DataError
from rtcal.support.speed import Progress
from rtcal.support.types import Array

Z = float(ndtri((1 + COVERAGE) / 2))
"""Half width of a 90 % interval of a normal distribution, in standard deviations."""
_SAMPLES = 2000
_BENT = 0.1
"""Departure from a straight line at the interval's ends, in standard deviations, from which the
interval is that of samples."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPrediction(Result):
    """Hold predicted values at every position after a change, which `PositionsResult.predict` returns.

    Arrays are (n_parameters, n_pairs + 1, n_bands): first the pairs, then their mean. They contain the
    logarithms of times; the methods return values in their units, for the keys of ``parameters``.

    ``name`` is that of the variant, ``changes`` are the changes of the room, and ``simulator`` is the
    name of the simulator. ``middle`` are the predicted values after the change, with the 90 % interval
    from ``low`` to ``high``. ``pairs`` are (source, receiver).
    """

    record_kind: ClassVar[str] = "prediction at positions 1"
    in_file: ClassVar[str] = (
        "room=before.name name changes simulator centre_frequencies=before.centre_frequencies pairs "
        "sentences sampled parameters=of_parameters"
    )

    name: str
    changes: tuple[Change, ...]
    before: Room
    """Room before the change, with your input coefficients."""
    simulator: str
    parameters: tuple[str, ...]
    """Names of the predicted parameters: keys of `rtcal.acoustics.observables`."""
    pairs: tuple[tuple[str, str], ...]
    simulated_before: Array
    """Predicted values before the change."""
    middle: Array
    sigma: Array
    """Predicted values after the change, and their standard deviation."""
    uncalibrated_sigma: Array
    """Standard deviation that the prediction would have without the measurement."""
    low: Array
    high: Array
    """Lower and upper end of the 90 % interval."""
    sampled: NDArray[np.bool_]
    """Whether the interval comes from random samples, because the simulator is not linear enough
    there."""
    shares: dict[str, Array]
    """Causes of the uncertainty of the mean over the pairs, by name, as shares of its variance,
    (n_parameters, n_bands)."""

    def _natural(self, parameter: str, observed: Array) -> Array:
        """Return a parameter's values in its unit, (n_pairs + 1, n_bands)."""
        row = self.parameters.index(checks.choice("parameter", parameter, self.parameters))
        return np.asarray(observable(parameter).natural(observed[row]))

    def at_pairs(self, parameter: str) -> Array:
        """Return a predicted ``parameter``, such as "t20", in its unit, (n_pairs + 1, n_bands)."""
        return self._natural(parameter, self.middle)

    def interval_at_pairs(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % interval of a ``parameter``, (n_pairs + 1, n_bands) each."""
        return self._natural(parameter, self.low), self._natural(parameter, self.high)

    def mean(self, parameter: str) -> Array:
        """Return a ``parameter`` as mean over the pairs, (n_bands,); the geometric one for times."""
        return np.asarray(self.at_pairs(parameter)[-1])

    def interval(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % interval of a ``parameter``'s mean, (n_bands,) each."""
        low, high = self.interval_at_pairs(parameter)
        return low[-1], high[-1]

    def before_change(self, parameter: str) -> Array:
        """Return a ``parameter`` before the change in its unit, (n_pairs + 1, n_bands)."""
        return self._natural(parameter, self.simulated_before)

    def change(self, parameter: str) -> Array:
        """Return the change of a ``parameter`` in JND, (n_pairs + 1, n_bands).

        One JND is that of the value before the change, for example 5 % of a decay time.
        """
        before = self.before_change(parameter)
        return (self.at_pairs(parameter) - before) / observable(parameter).jnd_of(before)

    def half_width(
        self, parameter: str, low: Array | None = None, high: Array | None = None
    ) -> Array:
        """Return half the width of a ``parameter``'s 90 % interval in JND, (n_pairs + 1, n_bands).

        One JND is that of the value after the change. ``low`` and ``high`` replace the ends of the
        interval; None keeps them.
        """
        low, high = (own if of is None else of for of, own in ((low, self.low), (high, self.high)))
        one = np.asarray(observable(parameter).jnd_of(self.at_pairs(parameter)))
        ends = self._natural(parameter, high) - self._natural(parameter, low)
        return np.asarray(ends / (2 * one))

    def parts(self, parameter: str) -> dict[str, Array]:
        """Return causes of the uncertainty of a ``parameter``'s mean, as shares of its variance.

        They are (n_bands,) each, largest first.
        """
        row = self.parameters.index(checks.choice("parameter", parameter, self.parameters))
        found = {name: share[row] for name, share in self.shares.items()}
        return dict(sorted(found.items(), key=lambda each: -float(each[1].mean())))

    @property
    def sentences(self) -> list[str]:
        """Sentences on the causes of the first parameter's uncertainty, and what to measure next."""
        first, half = self.parameters[0], Z * self.uncalibrated_sigma
        of = observable(first)
        # In the parameter's unit; those of a time over the time.
        without = of.jnd * self.half_width(first, self.middle - half, self.middle + half)[-1]
        known = of.jnd * self.half_width(first)[-1]
        unit = "" if of.relative_jnd else of.unit or " "
        return [
            words.gained(without, known, parameter_label(first), unit),
            words.to_narrow(self.parts(first), 1),
        ]

    @property
    def of_parameters(self) -> dict[str, dict[str, Any]]:
        """Predicted values of each parameter by name, for the pairs and their mean."""
        return {
            p: {
                "unit": observable(p).unit,
                "before": self.before_change(p),
                "after": self.at_pairs(p),
                "interval_90": self.interval_at_pairs(p),
                "change_jnd": self.change(p),
                "half_width_jnd": self.half_width(p),
                "parts": self.parts(p),
            }
            for p in self.parameters
        }

    def __repr__(self) -> str:
        first = self.parameters[0]
        return (
            f'<PositionsPrediction "{text.shortened(self.name)}" of '
            f'"{text.shortened(self.before.name)}": {len(self.pairs)} pairs, '
            f"{parameter_label(first)} {self.change(first)[-1].mean():+.1f} "
            f"JND, ± {np.median(self.half_width(first)[-1]):.1f} JND>"
        )

    def blocks(self) -> list[Block]:
        """Return the tables that are printed: means over the pairs in each band."""
        rows, first = [], self.parameters[0]
        labels, before = bands.labels(self.before.centre_frequencies), self.before_change(first)[-1]
        after, ends = self.mean(first), self.interval(first)
        said = f"{parameter_label(first)} after the change, with its 90 % interval, stands below."
        if np.array_equal(before, after):
            said = words.NOTHING_CHANGES
        elif observable(first).unit == "s":
            said = words.headline(labels, before, after, ends, parameter_label(first))
        for p in self.parameters:
            of, (low, high) = observable(p), self.interval(p)
            unit, form = f" / {of.unit}" if of.unit else "", f".{of.decimals}f"
            name = of.label_of_band or of.label
            start = f"{name}, 90 % interval: "
            rows += [
                Row(f"{name} before{unit}", self.before_change(p)[-1], form),
                Row(f"{name} after{unit}", self.mean(p), form),
                Row(f"{start}from{unit}", low, form),
                Row(f"{' ' * len(start)}to{unit}", high, form),
            ]
        return words.blocks_of(
            [
                f"{self.before.name}, {self.name}: {said}",
                f"The values are means over {len(self.pairs)} pairs, simulated by {self.simulator}. "
                "Those before the change are estimated from this simulation and the measurement.",
            ],
            labels,
            rows,
            (f"the interval of {parameter_label(first)}", self.parts(first)),
            self.sentences,
        )

    # What a table of variants and a page show of the first parameter

    @property
    def shown(self) -> words.Shown:
        """Mean of the first parameter over the pairs, before and after, with its interval."""
        p, n = self.parameters[0], len(self.pairs)
        return words.Shown(
            f"{parameter_label(p)} / {observable(p).unit}",
            f"the mean of {parameter_label(p)} over the {n} pairs",
            self.before_change(p)[-1],
            self.mean(p),
            self.interval(p),
            self.parts(p),
        )

    @property
    def assumed(self) -> list[Block | list[str]]:
        """Assumptions of the prediction, as sentences and a list."""
        said = (
            f"{self.simulator}, {len(self.pairs)} pairs of source and receiver. Its error is that of "
            "its reference simulations, evaluated before and after the change."
        )
        return [Note(said), Note(words.REMARK.format(""))]


def quantiles(
    middle: Array, sigma: Array, slope: Array, bend: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return lower and upper ends of 90 % intervals, and whether they are those of random samples."""
    sampled = np.abs(bend) * Z**2 > _BENT * sigma
    low, high = middle - Z * sigma, middle + Z * sigma
    rest = np.sqrt(np.maximum(sigma**2 - slope**2, 0.0))
    z = ndtri((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    other = np.random.default_rng(0).permutation(z)
    for at in map(tuple, np.argwhere(sampled)):
        drawn = middle[at] + slope[at] * z + bend[at] * z**2 + rest[at] * other
        low[at], high[at] = np.quantile(drawn, [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2])
    return low, high, sampled


Move = tuple[int, int, Array]
"""What a partial cover moved: the numbers of the material below and of the new one, and the share
that it takes of what was each of the room's materials, (n_before,)."""


class ChangedRoom:
    """Hold a room after changes, and the materials that its walls then have.

    ``materials`` (n_materials,) are the materials of the room, followed by the new ones, whose rows in
    the changed room ``after`` are ``new``. ``mixture`` (n_before, n_materials) is the share that each
    material has, after the changes, in the area that a material of the room had before. ``moves`` are
    the covers that leave a part of a material uncovered. Both rooms have the input coefficients.

    Raises DataError for a change whose place the simulator does not know.
    """

    def __init__(self, before: Room, changes: Sequence[Change]) -> None:
        changes = uncovering(before, changes)
        for change in changes:
            if change.kind not in ("cover", "open", "air"):
                raise DataError(
                    f"{change}: the simulator needs to know where the change is; give a mesh of "
                    "the changed room, or predict T with an equation"
                )
        self.before, self.changes = before, tuple(changes)
        self.after = changed(before, self.changes)
        self.new = [i for i, m in enumerate(self.after.materials) if m not in before.materials]
        self.materials = (*before.materials, *(self.after.materials[i] for i in self.new))
        self.mixture = np.eye(before.n_materials, len(self.materials))
        self.moves: list[Move] = []
        for change in self.changes:
            if change.surface is None:
                continue
            old, new = map(self.materials.index, (change.surface, name_of(change.material)))
            has = float(before.areas @ self.mixture[:, old])
            share = 1.0 if change.area is None else min(change.area / has, 1.0)
            moved = share * self.mixture[:, old]
            self.mixture[:, new] += moved
            self.mixture[:, old] -= moved
            if share < 1:
                self.moves.append((old, new, moved))

    def walls(self, alpha: Array) -> Array:
        """Return the mean coefficients after the change on the area that each material had before.

        The shape is (n_before, n_bands). ``alpha`` has a row for each material, or only for the room's
        materials; the new materials then have their input coefficients.
        """
        if len(alpha) < len(self.materials):
            alpha = np.vstack([alpha, self.after.alpha[self.new]])
        return np.asarray(self.mixture @ alpha)

    def simulator(self, simulator: Any) -> Any:
        """Return the simulator with the air after the change."""
        if self.after.air is None or self.after.air == self.before.air:
            return simulator
        return complete(simulator).with_air(self.after.air)


class State:
    """Hold a calibrated simulator's values in a state of the room, and their derivatives.

    Results have one row for each value, in the order of the parameters ``match``, pairs and bands.
    ``room`` has the changes; without changes, the state is the measured one.
    """

    def __init__(self, result: Any, room: ChangedRoom, match: Sequence[str]) -> None:
        self.room, self.match, self.seed = room, tuple(match), result.seed
        self.simulator = room.simulator(result.weighed)
        # Calibrated, and as stated of the new materials, (n_materials, n_bands).
        self.alpha = np.vstack([result.alpha, room.after.alpha[room.new]])
        self.walls = room.walls(self.alpha)  # of what was each of the room's, (n_before, n_bands)
        self.values = self.simulated(self.alpha)
        # By the walls' alpha, (n_parameters, n_pairs, n_bands, n_before), and by that of all materials,
        # (rows, n_materials * n_bands).
        self.by_wall = jacobian(self.simulator, self.walls, match, seed=self.seed)
        self.by_alpha = by_band(np.einsum("pikm,me->pike", self.by_wall, room.mixture))
        there = room.before.replace(alpha=np.clip(self.walls, 0, 1), calibration=None)
        levels = of_level(match, *self.by_wall.shape[1:3])
        # By errors of volume, areas and climate, (n_errors, rows).
        self.by_room = value_changes(there, by_band(self.by_wall), levels)
        able = complete(self.simulator)
        self.groups = able.observe_in_groups(self.walls, GROUPS, match, seed=self.seed)
        self.by_scattering = None  # by each material's, (rows, n_materials), where it was fitted
        if result.scattering is not None:
            random = replace(self.simulator, scattering_model="random")
            of_materials = material_scattering(random, self.walls, match, self.seed)
            self.by_scattering = of_materials.slope

    def simulated(self, alpha: Array) -> Observations:
        """Return the observations for coefficients of all materials."""
        walls = self.room.walls(np.clip(alpha, 0.0, 1.0))
        return observe(self.simulator, walls, self.match, seed=self.seed)

    def by_covers(self, assumed: float) -> Array:
        """Return the change of all values by the error of each partial cover's area.

        The shape is (n_covers, n_values). The relative error is that of the area of the surface below,
        or ``assumed`` if the room has no uncertainty of its areas.
        """
        before, after, a = self.room.before, self.room.after, self.alpha
        stated = [*before.area_sigma, *after.area_sigma[self.room.new]]
        if not before.area_sigma.any() and not before.common_area_sigma:
            stated = [assumed] * len(stated)
        rows = [
            max(stated[old], _LEAST_AREA)
            * np.einsum("pikm,mk->pik", self.by_wall, moved[:, np.newaxis] * (a[new] - a[old]))
            for old, new, moved in self.room.moves
        ]
        return np.reshape(rows, (-1, len(self.by_alpha)))

    def by_places(self) -> Array:
        """Return the change of all values by the unknown place of each partial cover.

        The shape is (n_places, n_values). The outer products of the rows add up to a covariance, as
        the places of the covers are independent.
        """
        if not self.room.moves or complete(self.simulator).tracing is not self.simulator:
            return np.zeros((0, len(self.by_alpha)))
        by_piece, parent, places = _in_pieces(self.simulator, self.room.moves)

        def simulated(alpha: Array) -> Array:
            alpha = np.clip(alpha, 0.0, 1.0)
            return observe(by_piece, alpha, self.match, seed=self.seed).values.ravel()

        even = self.walls[parent]
        middle, rows = simulated(even), []
        for (below, new, moved), of_move in zip(self.room.moves, places, strict=True):
            other = self.alpha[new] - self.alpha[below]
            for covered in of_move:
                more = (covered - moved[parent])[:, np.newaxis] * other
                rows.append((simulated(even + more) - middle) / np.sqrt(len(of_move)))
        return np.array(rows)

    def new_prior(self, least: float) -> Array:
        """Return the covariance of alpha of the new materials; sigma is 0, or at least ``least``."""
        room, sigma = self.room.before, self.room.after.sigma[self.room.new]
        sigma = np.where(sigma > 0, np.maximum(sigma, least), sigma)
        of_bands = bands.correlation(room.centre_frequencies, room.band_correlation)
        blocks = np.kron(np.eye(len(sigma)), of_bands)
        return np.asarray(blocks * np.outer(sigma.ravel(), sigma.ravel()))


_FLAT = 0.05
"""Extent of a surface along an axis, over its largest, below which it has no ends along it."""
_TILT = (0.1, 0.03)
"""By how much the axes of a surface of several planes are tilted towards each other."""
_LEAST_AREA = 1e-5
"""Least relative error of a covered area."""
_HALVINGS = 40
"""Of the interval that holds the edge of a cover: to the last digit."""


def _in_pieces(
    tracer: PathTracing, moves: Sequence[Move]
) -> tuple[PathTracing, NDArray[np.int64], list[NDArray[np.bool_]]]:
    """Return a path tracing whose surfaces are cut into pieces where partial covers may end.

    Each piece has coefficients of its own. Also returned are the number of the room's material of each
    piece, (n_pieces,), and, for each cover, the pieces that it covers at each possible place,
    (n_places, n_pieces) of bool. ``moves`` are the covers.
    """
    geometry, room = tracer.geometry, tracer.room
    ends = [_ends(geometry, tracer.made_of, moved) for _, _, moved in moves]
    cut: list[tuple[str, str, Array]] = []
    parent: list[int] = []
    for face, own in enumerate(tracer.made_of.tolist()):
        sides = [s for of, (*_, moved) in zip(ends, moves, strict=True) if moved[own] for s in of]
        for piece in cut_face(geometry, face, sides):
            cut.append((f"{len(cut)}", f"{room.materials[own]} ({len(cut)})", piece))
            parent.append(own)
    numbers, solid = np.array(parent), Polyhedron.from_polygons(cut)
    pieces = Room(
        name=room.name,
        volume=room.volume,
        materials=solid.materials,
        areas=solid.face_areas,
        alpha=room.alpha[numbers],
        sigma=room.sigma[numbers],
        centre_frequencies=room.centre_frequencies,
        air=room.air,
    )
    middles = np.array([solid.vertices[list(f)].mean(axis=0) for f in solid.faces])
    places = [
        np.array([(middles @ along < offset) & (moved[numbers] > 0) for along, offset in of])
        for of, (*_, moved) in zip(ends, moves, strict=True)
    ]
    scattering = tracer.scattering[numbers]
    return replace(tracer, geometry=solid, room=pieces, scattering=scattering), numbers, places


def _ends(
    geometry: Polyhedron, owner: NDArray[np.int64], moved: Array
) -> list[tuple[Array, float]]:
    """Return the half spaces that hold a cover at either end of its surface, along each axis.

    They are the points x with x @ direction at most an offset in m. ``moved`` (n_before,) is the share
    that is covered of each of the room's materials.
    """
    faces = np.flatnonzero(moved[owner] > 0)
    faces = faces[np.argsort(-geometry.face_areas[faces], kind="stable")]
    area = float(geometry.face_areas[faces] @ moved[owner[faces]])
    parts = [part for i in faces.tolist() for part in convex_parts(geometry, i)]
    corners = np.concatenate(parts)
    plane = Plane.of(geometry, faces.tolist())
    axes = [plane.along, plane.across, geometry.normals[faces[0]]]
    size = [float(np.ptp(corners @ axis)) for axis in axes]
    axes = [axis for axis, of in zip(axes, size, strict=True) if of > _FLAT * max(size)]
    if len(axes) > 2:
        # A wall across an axis is filled from one of its sides, not at once.
        axes = [a + _TILT[0] * axes[i - 1] + _TILT[1] * axes[i - 2] for i, a in enumerate(axes)]
    found = []
    for axis in axes:
        for along in (axis, -axis):
            first, last = float((corners @ along).min()), float((corners @ along).max())
            for _ in range(_HALVINGS):
                edge = (first + last) / 2
                within = sum(facets.area(facets.cut(p, along, edge)[0]) for p in parts)
                first, last = (edge, last) if within < area else (first, edge)
            found.append((along, (first + last) / 2))
    return found


def _errors(before: State, after: State, controls: ControlRuns) -> Array:
    """Return the covariance of the simulator's errors before and after, of all values, (n, n).

    What reference simulations tell, what the materials' scattering does, and the noise of the paths
    that are weighed: all reference simulations have the same, so they do not tell it.
    """
    tracer, of_states = before.simulator, [s.groups for s in (before, after)]
    known = [groups for groups in of_states if groups is not None]
    if not known:  # without paths there is no noise
        return controls.covariance()
    groups = np.concatenate(known, axis=1)
    noise = noise_of_a_run(tracer, groups)
    off = groups - groups.mean(axis=0)
    own = replace(controls, errors=off / np.sqrt(GROUPS - 1), levels=None, models=()).covariance()
    by_scattering = None
    if before.by_scattering is not None and after.by_scattering is not None:
        by_scattering = errors_by_scattering(controls, noise)
        slope = np.vstack([before.by_scattering, after.by_scattering])
    if by_scattering is None:
        return controls.without_noise(noise).covariance() + own
    of_materials = MaterialScattering(slope=slope, traced=np.zeros(slope.shape[1])).covariance
    at = mean_scattering(tracer.scattering, tracer.room.areas)
    return by_scattering.covariance(at, tracer.scattering_model) + of_materials + own


def _unexplained(before: State, after: State, errors: Array) -> Array:
    """Return the covariance of the calibration's unexplained errors before and after, (n, n).

    Such an error stays with its pair: that of a matched parameter is the same after the change.
    """
    rows = (*before.match, *after.match)
    own = dict.fromkeys(rows, np.zeros(before.values.values[0].size))
    for name, error, unit in zip(before.match, errors, before.values.one_jnd, strict=True):
        own[name] = error * unit.ravel()
    return np.block([[np.diag(own[p] * own[q] * (p == q)) for q in rows] for p in rows])


def _predicted(
    result: Any,
    name: str,
    before: State,
    after: State,
    controls: ControlRuns,
    assumed: Assumptions,
) -> PositionsPrediction:
    """Return the prediction, whose ``simulated_before`` is its own middle."""
    data = result.measured
    used, measured = data.among(before.values.pairs), data.covariance
    matrix, by_room = before.by_alpha[used], before.by_room[:, used]
    values = after.values.values
    shape, first = values.shape, len(before.by_alpha)
    whole = _errors(before, after, controls) + _unexplained(before, after, result.unexplained)
    own, across, of_used = whole[first:, first:], whole[first:][:, used], whole[np.ix_(used, used)]
    prior, new_prior = result.prior_covariance, after.new_prior(assumed.changed)
    n_old = matrix.shape[1]
    old, new = after.by_alpha[:, :n_old], after.by_alpha[:, n_old:]
    of_alpha = prior @ matrix.T
    unknown = matrix @ of_alpha + by_room.T @ by_room + of_used + measured
    shared = old @ of_alpha + after.by_room.T @ by_room + across
    gain = np.asarray(np.linalg.solve(unknown, shared.T).T, dtype=np.float64)
    moved = (result.alpha - result.prior.alpha).ravel()
    innovation = data.residual(before.values) + matrix @ moved
    middle = _with_mean(values + (gain @ innovation - old @ moved).reshape(shape))
    alike = across @ np.linalg.pinv(of_used, hermitian=True)

    of_covers, of_places = after.by_covers(assumed.areas), after.by_places()

    def variances(covariance: Array) -> Array:
        """Return the variances of values and of their mean, of the covariance of all values."""
        of_mean = np.einsum("pikpjk->pk", covariance.reshape(*shape, *shape)) / shape[1] ** 2
        alone = np.diag(covariance).reshape(shape)
        return np.concatenate([alone, of_mean[:, np.newaxis]], axis=1)

    def parts(gain: Array) -> dict[str, Array]:
        """Return the variances that are left where the measurement counts with a gain."""
        stays, kept = old - gain @ matrix, alike - gain
        found = {words.STAYS: stays @ prior @ stays.T}
        for i, material in enumerate(after.room.materials[result.prior.n_materials :]):
            rows = slice(i * shape[2], (i + 1) * shape[2])
            if new_prior[rows, rows].any():
                of_new = new[:, rows] @ new_prior[rows, rows] @ new[:, rows].T
                found[words.ALPHA.format(material)] = of_new
        found |= {
            words.COVERS: of_covers.T @ of_covers,
            words.PLACES: of_places.T @ of_places,
            words.ALIKE: kept @ of_used @ kept.T,
            words.CHANGED_ALONE: own - alike @ across.T,
            words.MEASUREMENT: gain @ measured @ gain.T,
        }
        if result.prior.is_uncertain:
            of_room = after.by_room - by_room @ gain.T
            found[words.SIZES] = of_room.T @ of_room
        return {name: variances(each) for name, each in found.items()}

    variance, without = parts(gain), parts(np.zeros(gain.shape))
    total, uncalibrated = (
        np.sqrt(np.maximum(np.sum([*each.values()], axis=0), 0.0)) for each in (variance, without)
    )
    posterior = np.zeros((n_old + len(new_prior),) * 2)
    posterior[:n_old, :n_old] = prior - of_alpha @ np.linalg.solve(unknown, of_alpha.T)
    posterior[n_old:, n_old:] = new_prior
    bend, slope = map(_with_mean, _bend(after, values, posterior))
    low, high, sampled = quantiles(middle, total, slope, bend)
    means = np.where(total[:, -1] > 0, total[:, -1], 1.0) ** 2
    return PositionsPrediction(
        name=name,
        changes=after.room.changes,
        before=result.prior,
        simulator=result.simulator,
        parameters=after.match,
        pairs=controls.pairs,
        simulated_before=middle,
        middle=np.where(sampled, middle + bend, middle),
        sigma=total,
        uncalibrated_sigma=uncalibrated,
        low=low,
        high=high,
        sampled=sampled,
        shares={name: each[:, -1] / means for name, each in variance.items()},
    )


def _with_mean(values: Array) -> Array:
    """Return values with their mean over the pairs, (n_parameters, n_pairs + 1, n_bands)."""
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def _bend(after: State, values: Array, posterior: Array) -> tuple[Array, Array]:
    """Return curvature and slope of all values along the direction of alpha that matters most.

    Per band it is the one along which T20, as mean over the pairs, spreads most. Values are
    middle + slope z + curvature z² for a standard normal z; (p, i, k) each.
    """
    n_bands, alpha = values.shape[2], after.alpha
    row = after.by_alpha.reshape(*values.shape, -1, n_bands)[0].mean(axis=0)  # (k, e, l)
    blocks = posterior.reshape(-1, n_bands, len(alpha), n_bands)
    direction = np.zeros_like(alpha)
    for k in range(n_bands):
        spread = blocks[:, k, :, k] @ row[k, :, k]
        size = float(np.sqrt(max(row[k, :, k] @ spread, 0.0)))
        direction[:, k] = spread / size if size > 0 else 0.0
    below, above = (after.simulated(alpha + z * direction).values for z in (-Z, Z))
    return (above + below - 2 * values) / (2 * Z**2), (above - below) / (2 * Z)


WANTED = (*MATCH, *(key for key, each in OBSERVABLES.items() if each.predicted))
"""Names of the parameters that are predicted by default."""
_BEFORE = "before the change"


def predict_positions(
    result: Any,
    variants: Sequence[Variant],
    *,
    wanted: Sequence[str] = WANTED,
    assumptions: Assumptions | None = None,
    position_uncertainty: float = POSITION,
    progress: Progress | None = None,
) -> Predictions:
    """Predict the values at every position of a room after each of several changes.

    Parameters
    ----------
    result : PositionsResult
        Calibration of the room, from `rtcal.calibrate_positions`.
    variants : sequence of Variant
        Changes to predict: covers, openings and another climate.
    wanted : sequence of str
        Parameters to predict: keys of `rtcal.acoustics.observables`.
    assumptions : Assumptions, optional
        Assumed uncertainties, of which two are used: ``changed``, the smallest sigma of a new material,
        and ``areas``, the relative uncertainty of the area of a partial cover. None means usual values.
    position_uncertainty : float
        Standard uncertainty of the positions of sources and receivers in m.
    progress : callable, optional
        Function that is called with the numbers of finished and of all reference simulations.

    Raises
    ------
    DataError
        For a change whose place the simulator does not know, for two variants with one name, for a
        variant that another program simulated, or for a simulator without reference simulations.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Change
    >>> room = rt.Room(name="box", volume=60, materials=["plaster"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.04]], centre_frequencies=[1000], air=rt.Air(20, 50),
    ...                scattering=[[0.5]])
    >>> tracer = rt.simulators.PathTracing(
    ...     room=room, geometry=rt.simulators.Polyhedron.shoebox((4, 5, 3), "plaster"),
    ...     sources={"S1": (1, 1, 1.5)}, receivers={"R1": (3, 4, 1.2), "R2": (2.8, 1.3, 1.3)},
    ...     n_paths=400)
    >>> measured = tracer.simulate([[0.18]], seed=1)
    >>> result = rt.calibrate_positions(tracer, room, measured, ("t20", "c80"), more_paths=1)
    >>> panel = rt.Material("panel", [0.8], [0.1])
    >>> after = predict_positions(
    ...     result, [Variant("panels", (Change(cover="plaster", by=panel, area=15),))],
    ...     wanted=("t20", "c80"))
    >>> low, high = after.predictions[0].interval("t20")
    >>> print(bool((low < high).all()), bool((after.predictions[0].change("c80") > 0).all()))
    True True
    """
    if not hasattr(result, "weighed"):
        raise DataError(
            f"result = {checks.shown(result)} is not a result of rtcal.calibrate_positions"
        )
    variants = checks.listed("variants", variants)
    for i, variant in enumerate(variants):
        if checks.instance(f"variants[{i}]", variant, Variant).simulated is not None:
            raise DataError(
                f"variants[{i}] has simulated, but a fit predicts by its own simulator: leave it out"
            )
    checks.distinct("variants", [variant.name for variant in variants])
    assumed = Assumptions() if assumptions is None else assumptions
    every = (Variant(_BEFORE, ()), *variants)
    rooms = [ChangedRoom(result.prior, v.changes) for v in every]
    simulator, seed = result.weighed, result.seed
    for room in rooms:
        room.simulator(simulator)  # raises where it cannot take the change, before anything is run
    match = tuple(dict.fromkeys([TARGET.key, *checked_parameters(wanted)]))
    checked_uncertainty(position_uncertainty)
    match = complete(simulator).trusted(match)

    def after(room: ChangedRoom) -> Simulated:
        of_simulator: dict[bytes, Array] = {}

        def simulated(of: Simulator, alpha: Array, seed: int) -> Array:
            walls = room.walls(alpha)
            known = of_simulator if of is simulator else {}
            if (key := walls.tobytes()) not in known:
                known[key] = observe(room.simulator(of), walls, match, seed=seed).values
            return known[key]

        return simulated

    names = [tuple(f"{p}, variant {i + 1}" for p in match) for i in range(len(rooms))]
    controls = None
    if result.controls is not None:
        # The runs stand at the calibrated coefficients: those are known far better than the prior.
        controls = simulated_controls(
            simulator,
            result.room.replace(sigma=np.zeros_like(result.alpha), calibration=None),
            result.parameters,
            seed=seed,
            position_uncertainty=position_uncertainty,
            progress=progress,
            after=[(own, after(room)) for own, room in zip(names, rooms, strict=True)],
        )
    if controls is None:
        raise DataError(
            f"the error of {result.simulator} is unknown, because it has no reference "
            "simulations: predict with a simulator that has a geometry, or predict T with an "
            "equation"
        )
    before = State(result, rooms[0], result.parameters)
    as_it_is, *after_each = (
        _predicted(
            result,
            variant.name,
            before,
            State(result, room, match),
            controls.at((*result.parameters, *own), controls.pairs),
            assumed,
        )
        for variant, room, own in zip(every, rooms, names, strict=True)
    )
    return Predictions(
        predictions=tuple(replace(each, simulated_before=as_it_is.middle) for each in after_each),
        costs=tuple(variant.cost for variant in variants),
    )
