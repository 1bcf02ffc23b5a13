"""The result of a calibration to every position, and what every position has after a change.

With alpha the coefficients, f what the simulator gives before the change and h after it, e and e' its
errors in the two states, u the errors of the room's volume, areas and climate, d what it does that a
cover lies in one place, and r the errors of the measurement,

    measured = f(alpha, u) + e + r,    predicted = h(alpha, u) + e' + d.

Control runs are simulated in both states, so they tell the covariance of e and e' together: what is
common to both states was measured, and what is each state's own was not. Given what was measured,
alpha, u, e and e' are jointly normal. h is linear around the calibrated coefficients, but along the
change of alpha that T20 depends on most: there it is a parabola through three evaluations of the same
paths.

What was covered is another mixture of materials on the same walls. Where the new material lies on a
surface is not known to the room: it is spread evenly over all walls of the material that it covers, so
every wall's coefficient is a mean by area, and a tracer re-evaluates the paths that it has. How the
walls scatter stays.

In truth the cover lies somewhere, most often in one piece. The places that are tried are the ends of
the surface: the cover fills it from either side along each of its axes. A cover in the middle departs
less from an even one, so these are the cautious ones. The surface is cut where the cover would end. Its
pieces lie in the same planes and scatter alike. So the same paths are traced, and only the difference
between a place and the even cover counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import chi2

from rtcal.acoustics import bands
from rtcal.acoustics.changes import (
    Change,
    Variant,
    changed,
    name_of,
)
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import (
    LEVEL,
    MATCH,
    OBSERVABLES,
    TARGET,
    observable,
    parameter_label,
)
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Room, refuse_repeats
from rtcal.acoustics.room_errors import Assumptions, value_changes
from rtcal.acoustics.scene import POSITION, checked_uncertainty
from rtcal.calibration.fit import GaussNewtonStep
from rtcal.calibration.qp import Certificate
from rtcal.calibration.table import coefficients
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.loop.control_runs import (
    GROUPS,
    ControlRuns,
    MaterialScattering,
    Scattering,
    Simulated,
    errors_by_scattering,
    level,
    material_scattering,
    noise_of_a_run,
    simulated_controls,
)
from rtcal.loop.measured_pairs import (
    CONTRADICTION,
    Beside,
    BeyondPrior,
    Linearisation,
    MeasuredPairs,
    Pair,
    by_band,
    left,
    of_level,
    rows_of_pairs,
    sentences,
)
from rtcal.prediction import words
from rtcal.prediction.predicted import COVERAGE
from rtcal.simulators import facets
from rtcal.simulators.base import (
    Observations,
    Simulator,
    checked_parameters,
    complete,
    jacobian,
    observe,
)
from rtcal.simulators.facets import WELD
from rtcal.simulators.geometry import Plane, Polyhedron, convex_parts
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks, text
from rtcal.support.blocks import Block, Note, Row, Table, lines, notebook
from rtcal.support.errors import DataError
from rtcal.support.speed import Progress
from rtcal.support.types import Array

Z = float(ndtri((1 + COVERAGE) / 2))
"""Half of a normal interval, in standard deviations."""


_SAMPLES = 2000
_BENT = 0.1
"""Departure from a straight line at the interval's ends, in standard deviations, from which the
interval is that of samples."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPrediction(Result):
    """A prediction at every position after a change; `PositionsResult.predict` makes it.

    Rows are the pairs in their order, and then their mean.

    Attributes
    ----------
    name : str
    changes : tuple of Change
    before : Room
        With the prior's coefficients.
    simulator : str
    parameters : tuple of str (n_parameters,)
        Keys of `rtcal.acoustics.observables`.
    pairs : tuple of (source, receiver) (n_pairs,)
    simulated_before : array (n_parameters, n_pairs + 1, n_bands)
        Before the change, predicted in the same way; as observed: times are logarithms.
    middle, sigma : array (n_parameters, n_pairs + 1, n_bands)
        Mean and standard deviation after the change, as observed.
    uncalibrated_sigma : array (n_parameters, n_pairs + 1, n_bands)
        Standard deviation of the same prediction without what was measured.
    low, high : array (n_parameters, n_pairs + 1, n_bands)
        Ends of the 90 % interval, as observed.
    sampled : array of bool (n_parameters, n_pairs + 1, n_bands)
        Where the interval is that of samples, since the simulator departs from its linear model.
    shares : mapping of str to array (n_parameters, n_bands)
        Of the variance of the mean over the pairs, by what it comes from.

    Examples
    --------
    >>> from rtcal.prediction import Change
    >>> room = Room(name="box", volume=60, materials=["plaster"], areas=[94], alpha=[[0.2]],
    ...             sigma=[[0.04]], centre_frequencies=[1000])
    >>> t = np.log([[[0.5], [0.5]]])  # one pair and the mean
    >>> found = PositionsPrediction(
    ...     name="window", changes=(Change(open="plaster", area=2.0),), before=room,
    ...     simulator="a simulator",
    ...     parameters=("t20",), pairs=(("S1", "R1"),), simulated_before=t + 0.1, middle=t,
    ...     sigma=0 * t + 0.05, uncalibrated_sigma=0 * t + 0.2,
    ...     low=t - 0.08, high=t + 0.08, sampled=t > 1,
    ...     shares={"alpha of what stays": np.ones((1, 1))})
    >>> found.mean("t20"), found.change("t20")[-1].round(2)
    (array([0.5]), array([-1.9]))
    """

    record_kind: ClassVar[str] = "prediction at positions 1"

    name: str
    changes: tuple[Change, ...]
    before: Room
    simulator: str
    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    simulated_before: Array
    middle: Array
    sigma: Array
    uncalibrated_sigma: Array
    low: Array
    high: Array
    sampled: NDArray[np.bool_]
    shares: dict[str, Array]

    def mean(self, parameter: str) -> Array:
        """Return the mean over the pairs in its unit, (n_bands,): the geometric mean of times."""
        return np.asarray(self.at_pairs(parameter)[-1])

    def interval(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % interval of the mean over the pairs, each (n_bands,)."""
        low, high = self.interval_at_pairs(parameter)
        return low[-1], high[-1]

    def at_pairs(self, parameter: str) -> Array:
        """Return each pair's value in its unit and then the mean, (n_pairs + 1, n_bands)."""
        return np.asarray(observable(parameter).natural(self.middle[self._row(parameter)]))

    def interval_at_pairs(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % intervals, each (n_pairs + 1, n_bands)."""
        row, of = self._row(parameter), observable(parameter)
        return of.natural(self.low[row]), of.natural(self.high[row])

    def before_change(self, parameter: str) -> Array:
        """Return each pair's value before the change in its unit and then the mean."""
        row = self._row(parameter)
        return np.asarray(observable(parameter).natural(self.simulated_before[row]))

    def change(self, parameter: str) -> Array:
        """Return the effect on each pair and on the mean in JND, (n_pairs + 1, n_bands).

        One JND is that of the value before: 5 % of a time.
        """
        before = self.before_change(parameter)
        return (self.at_pairs(parameter) - before) / observable(parameter).jnd_of(before)

    def half_width(self, parameter: str) -> Array:
        """Return half of the 90 % interval in JND of the value after, (n_pairs + 1, n_bands)."""
        return self._half_in_jnd(parameter, self.low, self.high)

    def _half_in_jnd(self, parameter: str, low: Array, high: Array) -> Array:
        """Return half of the distance of values as observed, in JND of the value after."""
        of, row = observable(parameter), self._row(parameter)
        one = np.asarray(of.jnd_of(self.at_pairs(parameter)))
        return np.asarray((of.natural(high[row]) - of.natural(low[row])) / (2 * one))

    def _row(self, parameter: str) -> int:
        if parameter not in self.parameters:
            raise DataError(f'parameter = "{parameter}" is not one of {", ".join(self.parameters)}')
        return self.parameters.index(parameter)

    def parts(self, parameter: str) -> dict[str, Array]:
        """Return shares of the variance of the mean over the pairs, (n_bands,), the largest first."""
        row = self._row(parameter)
        found = {name: share[row] for name, share in self.shares.items()}
        return dict(sorted(found.items(), key=lambda each: -float(each[1].mean())))

    @property
    def sentences(self) -> list[str]:
        """The parts of the first parameter's interval, and what to measure next."""
        first = self.parameters[0]
        middle, half = self.middle, Z * self.uncalibrated_sigma
        without = self._half_in_jnd(first, middle - half, middle + half)[-1]
        return [
            words.gained(without, self.half_width(first)[-1]),
            words.to_narrow(self.parts(first), 1),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text."""
        return {
            "room": self.before.name,
            "name": self.name,
            "changes": [str(change) for change in self.changes],
            "simulator": self.simulator,
            "centre_frequencies": json_numbers(self.before.centre_frequencies),
            "pairs": [list(pair) for pair in self.pairs],
            "sentences": self.sentences,
            "parameters": {
                p: {
                    "unit": observable(p).unit,
                    "before": json_numbers(observable(p).natural(self.simulated_before[i])),
                    "after": json_numbers(self.at_pairs(p)),
                    "interval_90": [json_numbers(end) for end in self.interval_at_pairs(p)],
                    "change_jnd": json_numbers(self.change(p)),
                    "half_width_jnd": json_numbers(self.half_width(p)),
                    "sampled": self.sampled[i].tolist(),
                    "parts": {name: json_numbers(v) for name, v in self.parts(p).items()},
                }
                for i, p in enumerate(self.parameters)
            },
        }

    def __repr__(self) -> str:
        first = self.parameters[0]
        return (
            f'<PositionsPrediction "{text.shortened(self.name)}" of '
            f'"{text.shortened(self.before.name)}": {len(self.pairs)} pairs, '
            f"{parameter_label(first)} {self.change(first)[-1].mean():+.1f} "
            f"JND, ± {np.median(self.half_width(first)[-1]):.1f} JND>"
        )

    def __str__(self) -> str:
        return "\n".join(lines(self.blocks()))

    def blocks(self) -> list[Block]:
        """Return what the prediction says."""
        labels = bands.labels(self.before.centre_frequencies)
        first = self.parameters[0]
        return [
            Note(f"{self.before.name}: {self.name}"),
            Note(f"Mean over {len(self.pairs)} pairs, by {self.simulator}"),
            Table(labels, self.rows),
            words.made_of(f"the interval of {parameter_label(first)}", self.parts(first), labels),
            *map(Note, self.sentences),
        ]

    @property
    def rows(self) -> list[Row]:
        """Each parameter before and after with its interval, means over the pairs by band."""
        rows = []
        for i, p in enumerate(self.parameters):
            of, (low, high) = observable(p), self.interval(p)
            unit, form = f" / {of.unit}" if of.unit else "", f".{of.decimals}f"
            rows += [
                Row(f"{of.label} before{unit}", of.natural(self.simulated_before[i, -1]), form),
                Row(f"{of.label} after{unit}", self.mean(p), form),
                Row(f"{of.label} 90 %: from{unit}", low, form),
                Row(f"{of.label} to{unit}", high, form),
            ]
        return rows


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPredictions(Result):
    """Predictions of several variants at every position.

    Attributes
    ----------
    predictions : tuple of PositionsPrediction
        One per variant.

    Examples
    --------
    >>> PositionsPredictions(predictions=())
    <PositionsPredictions: >
    """

    record_kind: ClassVar[str] = "predictions at positions 1"

    predictions: tuple[PositionsPrediction, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `PositionsPrediction.to_dict`."""
        return {"variants": [prediction.to_dict() for prediction in self.predictions]}

    def __str__(self) -> str:
        return "\n\n\n".join(map(str, self.predictions))

    def __repr__(self) -> str:
        return f"<PositionsPredictions: {', '.join(p.name for p in self.predictions)}>"


def _with_mean(values: Array) -> Array:
    """Return values with their mean over the pairs, (n_parameters, n_pairs + 1, n_bands)."""
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def quantiles(
    middle: Array, sigma: Array, slope: Array, bend: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the ends of the 90 % intervals, and where they are those of samples."""
    sampled = np.abs(bend) * Z**2 > _BENT * sigma
    low, high = middle - Z * sigma, middle + Z * sigma
    rest = np.sqrt(np.maximum(sigma**2 - slope**2, 0.0))
    z = ndtri((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    other = np.random.default_rng(0).permutation(z)
    for at in np.argwhere(sampled):
        a, b, c, d = (each[tuple(at)] for each in (middle, slope, bend, rest))
        drawn = a + b * z + c * z**2 + d * other
        low[tuple(at)], high[tuple(at)] = np.quantile(
            drawn, [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2]
        )
    return low, high, sampled


def gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = "rms gap / JND",
    misfit: Array | None = None,
) -> Table:
    """Return the rms gap before and after by parameter, of each pair and of all.

    Gaps are (n_parameters, n_pairs, n_bands) in JND; ``misfit`` (n_pairs,) has a column of its own.
    """
    columns = [parameter_label(p) for p in parameters]
    own: list[list[str]] = [[]] * (len(pairs) + 1)
    if misfit is not None:
        columns, own = [*columns, "misfit"], [[m] for m in (*text.numbers(misfit, ".1f"), "-")]
    rows = []
    for i, more in enumerate(own):
        name, chosen = ("all", slice(None)) if i == len(pairs) else (" to ".join(pairs[i]), [i])
        ends = zip(*(rms(gap[:, chosen], axis=(1, 2)) for gap in (before, after)), strict=True)
        rows.append(Row(name, [*(" to ".join(text.numbers(e, ".1f")) for e in ends), *more]))
    return Table(columns, rows, corner=title)


_FLAT = 0.05
"""Extent of a surface along an axis, over its largest, below which it has no ends along it."""
_TILT = (0.1, 0.03)
"""By how much the axes of a surface of several planes are tilted towards each other."""
_LEAST_AREA = 1e-5
"""Least relative error of a covered area."""
_HALVINGS = 40
"""Of the interval that holds the edge of a cover: to the last digit."""

Move = tuple[int, int, Array]
"""What a partial cover moved: the numbers of the material below and of the new one, and the share
that it takes of what was each of the room's materials, (n_before,)."""
HalfSpace = tuple[Array, float]
"""A direction and an offset in m: the points x with x @ direction at most the offset."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """A tracing whose surfaces are cut where covers may end, each piece with coefficients of its own.

    Attributes
    ----------
    tracer : PathTracing
    parent : int array (n_pieces,)
        Number of the room's material of each piece.
    moves : tuple of Move
        The partial covers; where each lies has nothing to do with the others.
    places : tuple of array (n_places, n_pieces)
        Which pieces each of them covers, for every place.
    """

    tracer: PathTracing
    parent: NDArray[np.int64]
    moves: tuple[Move, ...]
    places: tuple[Array, ...]

    @classmethod
    def of(cls, tracer: PathTracing, moves: Sequence[Move]) -> Pieces:
        """Return the tracing with the covered surfaces cut."""
        geometry, room = tracer.geometry, tracer.room
        owner = room.material_rows(geometry.materials)
        ends = [_ends(geometry, owner, moved) for _, _, moved in moves]
        cut: list[tuple[str, str, Array]] = []
        parent: list[int] = []
        for face, own in enumerate(owner.tolist()):
            sides = [
                s for of, (*_, moved) in zip(ends, moves, strict=True) if moved[own] for s in of
            ]
            for piece in _cut(geometry, face, sides):
                cut.append((f"{len(cut)}", f"{room.materials[own]} ({len(cut)})", piece))
                parent.append(own)
        numbers = np.array(parent)
        solid = Polyhedron.from_polygons(cut)
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
        places = tuple(
            np.array([(middles @ along < offset) & (moved[numbers] > 0) for along, offset in of])
            for of, (*_, moved) in zip(ends, moves, strict=True)
        )
        scattering = tracer.scattering[numbers]
        by_piece = replace(tracer, geometry=solid, room=pieces, scattering=scattering)
        return cls(by_piece, numbers, tuple(moves), places)

    def differences(self, walls: Array, alpha: Array, match: Sequence[str], seed: int) -> Array:
        """Return what places of covers change, (n_places, n_values): its square is their covariance.

        Parameters
        ----------
        walls : array (n_before, n_bands)
            Coefficients of the room's surfaces with the covers spread evenly.
        alpha : array (n_materials, n_bands)
            Of all materials.
        match : sequence of str
        seed : int
        """

        def simulated(alpha: Array) -> Array:
            return observe(self.tracer, np.clip(alpha, 0.0, 1.0), match, seed=seed).values.ravel()

        even = walls[self.parent]
        middle = simulated(even)
        rows = []
        for (below, new, moved), places in zip(self.moves, self.places, strict=True):
            for covered in places:
                more = (covered - moved[self.parent])[:, np.newaxis] * (alpha[new] - alpha[below])
                rows.append((simulated(even + more) - middle) / np.sqrt(len(places)))
        return np.array(rows).reshape(-1, middle.size)


def _ends(geometry: Polyhedron, owner: NDArray[np.int64], moved: Array) -> list[HalfSpace]:
    """Return the half spaces that hold a cover at either end of its surface, along each axis.

    ``moved`` (n_before,) is the share that is covered of each of the room's materials.
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


def _cut(geometry: Polyhedron, face: int, sides: Sequence[HalfSpace]) -> list[Array]:
    """Return the pieces of a face on either side of every edge; the face itself without any."""
    if not sides:
        return [geometry.vertices[list(geometry.faces[face])]]
    pieces = convex_parts(geometry, face)
    for along, offset in sides:
        both = [
            piece
            for whole in pieces
            # What lies in the edge's own plane is on one side of it.
            for piece in (
                facets.cut(whole, along, offset) if np.ptp(whole @ along) > WELD else [whole]
            )
        ]
        pieces = [piece for piece in both if facets.is_face(piece)]
    return pieces


@dataclass(frozen=True, eq=False)
class ChangedRoom:
    """A room, what is changed in it, and which materials its walls then have.

    Raises DataError for a change that a simulator does not know the place of.

    Attributes
    ----------
    before : Room
        With the prior's coefficients.
    changes : tuple of Change
    assumptions : Assumptions
    """

    before: Room
    changes: tuple[Change, ...]
    assumptions: Assumptions

    def __post_init__(self) -> None:
        for change in self.changes:
            if change.kind not in ("cover", "open", "air"):
                raise DataError(
                    f"{change}: a simulator does not know where; state the changed room's own mesh, or "
                    "predict T by an equation"
                )
        _ = self._mixed  # raises where the room does not allow a change

    @cached_property
    def after(self) -> Room:
        """The changed room, with the prior's coefficients."""
        return changed(self.before, self.changes)

    @cached_property
    def _new(self) -> list[int]:
        """Rows of the new materials in the changed room."""
        return [i for i, m in enumerate(self.after.materials) if m not in self.before.materials]

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials, and then the new ones."""
        return (*self.before.materials, *(self.after.materials[i] for i in self._new))

    @cached_property
    def _mixed(self) -> tuple[Array, tuple[Move, ...]]:
        """Shares of the materials in what each was, and what each partial cover moved of them."""
        mixture = np.eye(self.before.n_materials, len(self.materials))
        moves = []
        for change in self.changes:
            if change.surface is None:
                continue
            old, new = map(self.materials.index, (change.surface, name_of(change.material)))
            has = float(self.before.areas @ mixture[:, old])
            share = 1.0 if change.area is None else min(change.area / has, 1.0)
            moved = share * mixture[:, old]
            mixture[:, new] += moved
            mixture[:, old] -= moved
            if share < 1:
                moves.append((old, new, moved))
        return mixture, tuple(moves)

    @property
    def moves(self) -> tuple[Move, ...]:
        """Each partial cover: from which material, to which, and its share of each wall."""
        return self._mixed[1]

    @property
    def mixture(self) -> Array:
        """Share of each material in what was each of the room's, (n_before, n_materials)."""
        return self._mixed[0]

    def all_alpha(self, alpha: Array) -> Array:
        """Return coefficients of all materials for those of the room's, (n_materials, n_bands)."""
        return np.vstack([alpha, self.after.alpha[self._new]])

    def by_areas(self, alpha: Array) -> Array:
        """Return d(alpha of the walls) / d ln(each partly covered area), (n_covers, n_before, n_bands).

        ``alpha`` is that of all materials.
        """
        rows = [moved[:, np.newaxis] * (alpha[new] - alpha[old]) for old, new, moved in self.moves]
        return np.array(rows).reshape(-1, self.before.n_materials, self.before.n_bands)

    @property
    def cover_sigma(self) -> Array:
        """Relative error of each partial cover's area, (n_covers,): that of the surface below it."""
        if self.before.area_sigma.any() or self.before.common_area_sigma:
            stated = [*self.before.area_sigma, *self.after.area_sigma[self._new]]
        else:
            stated = [self.assumptions.areas] * len(self.materials)
        return np.maximum(stated, _LEAST_AREA)[[old for old, *_ in self.moves]]

    @property
    def new_sigma(self) -> Array:
        """Sigma of the new materials, (n_new, n_bands), at least the assumed one but where it is 0."""
        stated = self.after.sigma[self._new]
        return np.where(stated > 0, np.maximum(stated, self.assumptions.changed), stated)

    def simulator(self, simulator: Any) -> Any:
        """Return the simulator with the air after the change."""
        if self.after.air is None or self.after.air == self.before.air:
            return simulator
        return complete(simulator).with_air(self.after.air)


@dataclass(frozen=True, eq=False)
class Before:
    """The measurement before the change, against the calibrated simulator."""

    result: PositionsResult
    pairs: tuple[Pair, ...]

    @cached_property
    def at(self) -> Linearisation:
        """The calibrated simulator's values at the calibrated coefficients."""
        result = self.result
        values = observe(result.weighed, result.alpha, result.parameters, seed=result.seed)
        return Linearisation(result.weighed, result.measured, values, result.alpha, result.seed)

    @cached_property
    def by_room(self) -> Array:
        """Change of the values used by errors of volume, areas and climate, (n_errors, n_used)."""
        return value_changes(self.result.prior, self.at.linearised(), self.at.of_level)

    @cached_property
    def innovation(self) -> Array:
        """The measured values less those simulated with the prior, linearly, (n_used,)."""
        change = (self.result.alpha - self.result.prior.alpha).ravel()
        return np.asarray(self.at.residual() + self.at.linearised() @ change)

    def error(
        self, of: Any, alpha: Array, match: Sequence[str]
    ) -> tuple[Array | None, Array | None]:
        """Return the values of groups of paths, and the derivatives by each material's scattering.

        (n_groups, p, i, k), None without paths; and (n, n_materials), None where the scattering stated
        was kept.
        """
        result = self.result
        groups = complete(of).observe_in_groups(alpha, GROUPS, match, seed=result.seed)
        if result.scattering is None:
            return groups, None
        random = replace(of, scattering_model="random")
        stated = np.zeros(result.prior.n_materials)
        return groups, material_scattering(random, alpha, match, stated, result.seed).slope

    @cached_property
    def own_error(self) -> tuple[Array | None, Array | None]:
        """The same of what was measured."""
        return self.error(self.result.weighed, self.result.alpha, self.result.parameters)


@dataclass(frozen=True, eq=False)
class Changed:
    """One change: the simulated values after it, and the covariances of errors before and after."""

    known: Before
    room: ChangedRoom
    match: tuple[str, ...]
    names: tuple[str, ...]
    controls: ControlRuns

    @property
    def result(self) -> PositionsResult:
        """The calibration before the change."""
        return self.known.result

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, and those stated of the new materials."""
        return self.room.all_alpha(self.result.alpha)

    def simulated(self, alpha: Array) -> Array:
        """Return the simulated values after the change for coefficients of all materials, (p, i, k)."""
        walls = self.room.mixture @ np.clip(alpha, 0.0, 1.0)
        return observe(self.after, walls, self.match, seed=self.result.seed).values

    @cached_property
    def after(self) -> Any:
        """The simulator with the air after the change."""
        return self.room.simulator(self.result.weighed)

    @cached_property
    def walls(self) -> Array:
        """Coefficients of what was each of the room's materials, (n_before, n_bands)."""
        return np.asarray(self.room.mixture @ self.alpha)

    @cached_property
    def by_wall(self) -> Array:
        """Derivatives of all rows by these, (p, i, k, n_before)."""
        return jacobian(self.after, self.walls, self.match, seed=self.result.seed)

    @cached_property
    def by_alpha(self) -> Array:
        """Derivatives of all rows by alpha of all materials, (rows, n_materials * n_bands)."""
        return by_band(np.einsum("pikm,me->pike", self.by_wall, self.room.mixture))

    @cached_property
    def by_covers(self) -> Array:
        """Change of all rows by the error of each partial cover's area, (n_covers, rows)."""
        by_areas = self.room.cover_sigma[:, np.newaxis, np.newaxis] * self.room.by_areas(self.alpha)
        rows = np.einsum("pikm,cmk->cpik", self.by_wall, by_areas)
        return np.asarray(rows.reshape(len(by_areas), self.by_alpha.shape[0]))

    @cached_property
    def by_room(self) -> Array:
        """Change of all rows by errors of volume, areas and climate, (n_errors, rows)."""
        room = self.room.before.replace(alpha=self.walls, calibration=None)
        levels = of_level(self.match, len(self.known.pairs), room.n_bands)
        return value_changes(room, by_band(self.by_wall), levels)

    @cached_property
    def by_places(self) -> Array:
        """Change of all rows by the places of the covers, (n_places, rows)."""
        if not self.room.moves or complete(self.after).tracing is not self.after:
            return np.zeros((0, self.by_alpha.shape[0]))
        pieces = Pieces.of(self.after, self.room.moves)
        return pieces.differences(self.walls, self.alpha, self.match, self.result.seed)

    @cached_property
    def prior(self) -> Array:
        """Covariance of alpha of all materials, the calibrated room's first."""
        room, old = self.result.prior, self.result.prior_covariance
        sigma = self.room.new_sigma.ravel()
        of_bands = bands.correlation(room.centre_frequencies, room.band_correlation)
        new = np.kron(np.eye(len(self.room.new_sigma)), of_bands) * np.outer(sigma, sigma)
        out = np.zeros((len(old) + len(new), len(old) + len(new)))
        out[: len(old), : len(old)], out[len(old) :, len(old) :] = old, new
        return out

    @cached_property
    def errors(self) -> Array:
        """Covariance of the simulator's errors before and after, of all values, (n, n).

        What control runs tell, what the materials' scattering does, and the noise of the paths that
        are weighed: all control runs have the same, so they do not tell it.
        """
        result, tracer = self.result, self.known.at.simulator
        names = (*result.parameters, *self.names)
        controls = self.controls.at(names, self.controls.pairs)
        states = (self.known.own_error, self.known.error(self.after, self.walls, self.match))
        of_states = [groups for groups, _ in states if groups is not None]
        if not of_states:  # without paths there is no noise
            return controls.covariance()
        groups = np.concatenate(of_states, axis=1)
        noise = noise_of_a_run(tracer, groups)
        off = groups - groups.mean(axis=0)
        own = replace(controls, errors=off / np.sqrt(GROUPS - 1), levels=None, models=())
        slopes = [slope for _, slope in states if slope is not None]
        by_scattering = errors_by_scattering(controls, noise) if slopes else None
        if by_scattering is None:
            return controls.without_noise(noise).covariance() + own.covariance()
        of_materials = MaterialScattering(
            slope=np.vstack(slopes), traced=np.zeros(slopes[0].shape[1])
        )
        at = level(tracer.scattering, tracer.room.areas)
        of_runs = by_scattering.covariance(at, tracer.scattering_model)
        return of_runs + of_materials.covariance + own.covariance()

    @property
    def _unexplained(self) -> Array:
        """The covariance of the calibration's unexplained errors before and after, (n, n).

        Such an error stays with its pair: that of a matched parameter is the same after the change.
        """
        result, at = self.result, self.known.at.simulated
        deviation = dict.fromkeys((*result.parameters, *self.match), np.zeros(at.values[0].size))
        for name, error in zip(result.parameters, result.unexplained, strict=True):
            kind, own = observable(name), at.natural(name)
            unit = np.broadcast_to(kind.jnd_of(own), own.shape)
            deviation[name] = error * kind.of_observed(unit, own).ravel()
        rows = (*result.parameters, *self.match)
        return np.block(
            [[np.diag(deviation[p] * deviation[q] * (p == q)) for q in rows] for p in rows]
        )

    def predicted(self, variant: Variant) -> PositionsPrediction:
        """Return the prediction, whose ``simulated_before`` is its own middle."""
        result, used = self.result, self.known.at.used
        matrix, measured = self.known.at.linearised(), result.measured.covariance
        whole = self.errors + self._unexplained
        shape = (len(self.match), len(self.controls.pairs), result.prior.n_bands)
        first = len(result.parameters) * len(self.controls.pairs) * result.prior.n_bands
        before, across, own = (
            whole[np.ix_(used, used)],
            whole[first:][:, used],
            whole[first:, first:],
        )
        n_old = matrix.shape[1]
        prior, by_alpha, by_room = self.prior, self.by_alpha, self.known.by_room
        of_alpha = prior[:, :n_old] @ matrix.T
        unknown = matrix @ of_alpha[:n_old] + by_room.T @ by_room + before + measured
        shared = by_alpha @ of_alpha + self.by_room.T @ by_room + across
        gain = np.asarray(np.linalg.solve(unknown, shared.T).T, dtype=np.float64)

        values = self.simulated(self.alpha)
        at_prior = by_alpha[:, :n_old] @ (result.prior.alpha - result.alpha).ravel()
        shift = at_prior + gain @ self.known.innovation
        middle = _with_mean(values + shift.reshape(values.shape))

        old, new = by_alpha[:, :n_old], by_alpha[:, n_old:]
        alike = across @ np.linalg.pinv(before, hermitian=True)

        def variances(covariance: Array) -> Array:
            """Return the variances of values and of their mean, of the covariance of all values."""
            of_mean = np.einsum("pikpjk->pk", covariance.reshape(*shape, *shape)) / shape[1] ** 2
            own = np.diag(covariance).reshape(shape)
            return np.concatenate([own, of_mean[:, np.newaxis]], axis=1)

        def parts(gain: Array) -> dict[str, Array]:
            """Return the variances that are left where the measurement counts with a gain."""
            stays, kept = old - gain @ matrix, alike - gain
            found = {
                words.STAYS: stays @ prior[:n_old, :n_old] @ stays.T,
                **self._by_material(new, prior[n_old:, n_old:]),
                words.COVERS: self.by_covers.T @ self.by_covers,
                words.PLACES: self.by_places.T @ self.by_places,
                words.ALIKE: kept @ before @ kept.T,
                words.CHANGED_ALONE: own - alike @ across.T,
                words.MEASUREMENT: gain @ measured @ gain.T,
            }
            if result.prior.is_uncertain:
                of_room = self.by_room - by_room @ gain.T
                found[words.SIZES] = of_room.T @ of_room
            return {name: variances(each) for name, each in found.items()}

        variance, without = parts(gain), parts(np.zeros(gain.shape))
        total, uncalibrated = (
            np.sqrt(np.maximum(np.sum([*each.values()], axis=0), 0.0))
            for each in (variance, without)
        )
        posterior = prior - of_alpha @ np.linalg.solve(unknown, of_alpha.T)
        bend, ends = self._bend(values, posterior, by_alpha)
        slope, curved = _with_mean(ends), _with_mean(bend)
        low, high, sampled = quantiles(middle, total, slope, curved)
        means = np.where(total[:, -1] > 0, total[:, -1], 1.0) ** 2
        return PositionsPrediction(
            name=variant.name,
            changes=self.room.changes,
            before=result.prior,
            simulator=result.simulator,
            parameters=self.match,
            pairs=self.controls.pairs,
            simulated_before=middle,
            middle=np.where(sampled, middle + curved, middle),
            sigma=total,
            uncalibrated_sigma=uncalibrated,
            low=low,
            high=high,
            sampled=sampled,
            shares={name: each[:, -1] / means for name, each in variance.items()},
        )

    def _by_material(self, by_new: Array, prior: Array) -> dict[str, Array]:
        """Return the covariance by each new material's coefficients."""
        names, n_bands = self.room.materials[self.result.prior.n_materials :], self.alpha.shape[1]
        found = {}
        for i, name in enumerate(names):
            own = slice(i * n_bands, (i + 1) * n_bands)
            if prior[own, own].any():
                found[words.ALPHA.format(name)] = (
                    by_new[:, own] @ prior[own, own] @ by_new[:, own].T
                )
        return found

    def _bend(self, values: Array, posterior: Array, by_alpha: Array) -> tuple[Array, Array]:
        """Return curvature and slope of all values along the direction of alpha that matters most.

        Per band it is the one along which T20, as mean over the pairs, spreads most. Values are
        middle + slope z + curvature z² for a standard normal z; (p, i, k) each.
        """
        n_bands = values.shape[2]
        row = by_alpha.reshape(*values.shape, -1, n_bands)[0].mean(axis=0)  # (k, e, l)
        blocks = posterior.reshape(-1, n_bands, len(self.alpha), n_bands)
        direction = np.zeros_like(self.alpha)
        for k in range(n_bands):
            spread = blocks[:, k, :, k] @ row[k, :, k]
            size = float(np.sqrt(max(row[k, :, k] @ spread, 0.0)))
            direction[:, k] = spread / size if size > 0 else 0.0
        below, above = (self.simulated(self.alpha + z * direction) for z in (-Z, Z))
        return (above + below - 2 * values) / (2 * Z**2), (above - below) / (2 * Z)


WANTED = (*MATCH, *(key for key, each in OBSERVABLES.items() if each.predicted))
"""What is predicted where nothing else is asked for."""
_BEFORE = "before the change"


def predict_positions(
    result: PositionsResult,
    variants: Sequence[Variant],
    *,
    wanted: Sequence[str] = WANTED,
    assumptions: Assumptions | None = None,
    position_uncertainty: float = POSITION,
    progress: Progress | None = None,
) -> PositionsPredictions:
    """Predict the values at every position after changes, which share the control runs.

    Parameters
    ----------
    result : PositionsResult
    variants : sequence of Variant
        Covers, openings and another climate.
    wanted : sequence of str
        Keys of `rtcal.acoustics.observables`.
    assumptions : Assumptions, optional
        Its ``changed`` is the least sigma of a new material, ``areas`` the relative error of the area
        of a partial cover. The others are the equation's.
    position_uncertainty : float
        As of `rtcal.calibrate_positions`.
    progress : callable, optional
        Called with the number of finished control runs and their total.

    Raises
    ------
    DataError
        For a change that the simulator does not know the place of, two variants of one name, or a
        simulator whose error no control run tells.

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
    ...     result, [Variant("panels", (Change(cover="plaster", by=panel, area=15),)),
    ...              Variant("window", (Change(open="plaster", area=2),))], wanted=("t20", "c80"))
    >>> for prediction in after.predictions:
    ...     low, high = prediction.interval("t20")
    ...     print(prediction.name, bool((low < high).all()), bool((prediction.change("c80") > 0).all()))
    panels True True
    window True True
    """
    if not hasattr(result, "weighed"):
        raise DataError(
            f"result = {checks.shown(result)} is no result of rtcal.calibrate_positions"
        )
    variants = checks.listed("variants", variants)
    for i, variant in enumerate(variants):
        checks.instance(f"variants[{i}]", variant, Variant)
    refuse_repeats("variants", variants)
    assumed = Assumptions() if assumptions is None else assumptions
    every = (Variant(_BEFORE, ()), *variants)
    rooms = [ChangedRoom(result.prior, tuple(v.changes), assumed) for v in every]
    simulator, seed = result.weighed, result.seed
    for room in rooms:
        room.simulator(simulator)  # raises where it cannot take the change, before anything is run
    match = tuple(dict.fromkeys([TARGET.key, *checked_parameters(wanted)]))
    checked_uncertainty(position_uncertainty)
    match = complete(simulator).trusted(match)

    def after(room: ChangedRoom) -> Simulated:
        at_alpha: dict[bytes, Array] = {}

        def simulated(of: Simulator, alpha: Array, seed: int) -> Array:
            walls = room.mixture @ room.all_alpha(alpha)
            if of is not simulator:
                return observe(room.simulator(of), walls, match, seed=seed).values
            if walls.tobytes() not in at_alpha:
                values = observe(room.simulator(of), walls, match, seed=seed).values
                at_alpha[walls.tobytes()] = values
            return at_alpha[walls.tobytes()]

        return simulated

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
            after=[(_names(match, i), after(room)) for i, room in enumerate(rooms)],
        )
    if controls is None:
        raise DataError(
            f"no control run tells the error of {result.simulator}: predict with a simulator that "
            "has a geometry, or T by an equation"
        )
    known = Before(result, controls.pairs)
    before, *after_each = (
        Changed(known, room, match, _names(match, i), controls).predicted(variant)
        for i, (room, variant) in enumerate(zip(rooms, every, strict=True))
    )
    return PositionsPredictions(
        predictions=tuple(replace(each, simulated_before=before.middle) for each in after_each)
    )


def _names(match: Sequence[str], variant: int) -> tuple[str, ...]:
    return tuple(f"{parameter}, variant {variant + 1}" for parameter in match)


KIND = "positions 1"
"""Value of the key ``rtcal`` in a saved result."""
_REFUSED = (
    "No step led nearer to what was measured: the start is returned, and nothing was fitted. State "
    "larger sigmas or more paths, or look for what the room lacks (rtcal find)."
)
_FARTHER = 0.5
"""JND: the noise of a tracing. A larger rise of the mean gap is the calibration's."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsResult(Result):
    """A simulator calibrated to the values at every position.

    Attributes
    ----------
    prior : Room
        The room as it was given.
    room : Room
        With the coefficients for the simulator, their posterior sigma, and a record.
    simulator : str
        Name of the simulator and its scattering. The coefficients belong to no other.
    tracer : Simulator
        The simulator that the coefficients belong to: the one given, with the scattering fitted. Do not
        calibrate it on the same data again: its scattering comes from them.
    weighed : Simulator
        The same with as many paths as were weighed.
    seed : int
    scattering : Scattering or None
        The scattering that was fitted; None where the one stated was kept.
    simulations : int
        Number of all evaluations of the simulator or its derivatives, without control runs.
        `PathTracing` weighs the same traced paths in each.
    measured : MeasuredPairs
        What was matched; its ``observations`` name parameters and pairs.
    beside : Beside
        What was measured and not matched, before and after.
    held_out : Beside or None
        What was measured at the pairs that were excluded, before and after; without the level.
    before, after : Observations
        What the simulator given and its ``tracer`` give, with the prior and with the coefficients
        returned, with as many paths as were weighed.
    predicted : Observations
        The values at all positions of the simulator with the coefficients returned, also those that
        were not measured. Where control runs tell the simulator's error, its mean given what was
        measured is added: what all pairs have in common, such as other scattering.
    controls : ControlRuns or None
        The simulator's error, to be given to a second calibration. None if it is not known.
    unexplained : array (n_parameters,)
        Standard deviation in JND by which each value of a parameter differs from the simulator beyond
        all stated errors, under which what was measured is likeliest.
    innovation, covariance : array (n_used,), (n_used, n_used)
        What was measured less the simulated values at ``steps[-1].alpha``, linearly
        extrapolated to the prior; covariance of the errors of measurement and simulator.
    prior_covariance : array (n_materials * n_bands, n_materials * n_bands)
    steps : tuple of GaussNewtonStep
    settled : bool
        Whether the last step, before any shortening, changed alpha by less than 0.05 of its prior
        sigma.
    notes : tuple of str
        What was left out, and why.
    start : array (n_materials, n_bands) or None
        The scattering at which the fit started; None of a simulator that has none.
    refused : bool
        Whether no step led nearer to what was measured, so that the room is the one that was given.
    beyond : BeyondPrior or None
        The measured T, where the stated coefficients and their sigma cannot explain it.
    """

    record_kind: ClassVar[str] = KIND

    prior: Room
    room: Room
    simulator: str
    tracer: Simulator
    weighed: Simulator
    seed: int
    scattering: Scattering | None
    simulations: int
    measured: MeasuredPairs
    beside: Beside
    before: Observations
    after: Observations
    predicted: Observations
    controls: ControlRuns | None
    unexplained: Array
    innovation: Array
    covariance: Array
    prior_covariance: Array
    steps: tuple[GaussNewtonStep, ...]
    settled: bool
    notes: tuple[str, ...]
    refused: bool = False
    beyond: BeyondPrior | None = None
    held_out: Beside | None = None
    start: Array | None = None

    def predict(
        self,
        changes: Change | Sequence[Change],
        *,
        wanted: Sequence[str] = WANTED,
        name: str = "",
        assumptions: Assumptions | None = None,
        position_uncertainty: float = POSITION,
    ) -> PositionsPrediction:
        """Predict the values at every position after a change of this room.

        The arguments and errors are those of `rtcal.loop.positions_result.predict_positions`, which
        takes several variants at once.
        """
        made = (changes,) if isinstance(changes, Change) else tuple(changes)
        variant = Variant(name or "; ".join(map(str, made)) or "no change", made)
        return predict_positions(
            self,
            [variant],
            wanted=wanted,
            assumptions=assumptions,
            position_uncertainty=position_uncertainty,
        ).predictions[0]

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def sigma(self) -> Array:
        """Posterior standard deviation of alpha, (n_materials, n_bands); it does not count bounds."""
        return self.steps[-1].answer.posterior_sigma

    @property
    def certificate(self) -> Certificate:
        """Error bounds of the last step's QP."""
        return self.steps[-1].answer.certificate

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """Ends of the 90 % interval of alpha within [0, 1], each (n_materials, n_bands).

        None if the simulator's error is not known: no control runs.
        """
        if self.controls is None:
            return None
        half = NORMAL_90 * self.sigma
        return np.clip(self.alpha - half, 0, 1), np.clip(self.alpha + half, 0, 1)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were matched."""
        return self.measured.observations.parameters

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The pairs that were matched."""
        return self.measured.observations.pairs

    @cached_property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.measured.gap(self.before)

    @cached_property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.measured.gap(self.after)

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters in which ``tracer`` is farther from what was measured than the simulator given.

        Of what was matched, the root mean square gap over pairs and bands is larger by over half a JND.
        Of what was not, that over the pairs is larger by over a JND in some band.
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
        """Change of alpha, in prior sigmas, (n_materials, n_bands); 0 where sigma is 0."""
        sigma = np.where(self.prior.sigma > 0, self.prior.sigma, np.inf)
        return np.asarray((self.alpha - self.prior.alpha) / sigma)

    @cached_property
    def pulls(self) -> Array:
        """Change of each coefficient by each pair, in prior sigmas, (n_pairs, n_materials, n_bands).

        Of the linear estimate without bounds: the sum over the pairs is its whole shift. The change by
        the values is K J' (J K J' + C)⁻¹, with K the prior's covariance, J their derivatives and C that
        of their errors (Tarantola 2005, Inverse Problem Theory, Sect. 3.2).
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
        """Misfit of each pair with what all others let expect, (n_pairs,): 1 is usual.

        chi-square over its degrees of freedom, relative to the upper quartile over the pairs where that
        is above 1. What the simulator misses differs between pairs; up to a quarter may be wrong.
        """
        square, degrees = self._chi_square
        ratio = square / degrees
        return np.asarray(ratio / max(1.0, float(np.quantile(ratio, 0.75, method="lower"))))

    @property
    def contradictions(self) -> tuple[Pair, ...]:
        """Pairs that contradict all others. Check their positions and names, or ``exclude`` them."""
        degrees = self._chi_square[1]
        chance = chi2.sf(self.misfit * degrees, degrees)
        worst_first = np.argsort(-self.misfit).tolist()
        return tuple(self.pairs[i] for i in worst_first if chance[i] < CONTRADICTION / len(chance))

    @cached_property
    def _chi_square(self) -> tuple[Array, Array]:
        """The chi-square of each pair given all others, and its degrees of freedom, (n_pairs,)."""
        matrix = self.steps[-1].matrix
        # One wrong pair makes the unexplained error larger, and would then be explained by it.
        deviation = self.measured.in_values(self.unexplained)
        stated = self.covariance - np.diag(deviation**2)
        expected = matrix @ self.prior_covariance @ matrix.T + stated
        precision, rows = np.linalg.inv(expected), rows_of_pairs(self.measured.used)
        pull = precision @ self.innovation
        values = [float(pull[r] @ np.linalg.solve(precision[np.ix_(r, r)], pull[r])) for r in rows]
        return np.array(values), np.array([max(len(r), 1) for r in rows])

    @cached_property
    def learned(self) -> tuple[tuple[str, float, float], ...]:
        """Materials with prior and posterior sigma (rms over bands), most learned first."""
        before, after = (rms(s, axis=1) for s in (self.prior.sigma, self.sigma))
        share = np.divide(after, before, out=np.ones_like(after), where=before > 0)
        return tuple(
            (self.prior.materials[i], float(before[i]), float(after[i]))
            for i in np.argsort(share, kind="stable")
        )

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        return (
            f'PositionsResult of "{text.shortened(self.simulator)}": {len(self.pairs)} pairs, '
            f"{', '.join(map(parameter_label, self.parameters))}, {len(self.steps)} steps"
        )

    def __str__(self) -> str:
        return "\n".join(lines(self.blocks()))

    def _repr_html_(self) -> str:
        """Return the tables; that of the materials is darker where more was learned."""
        return notebook(self._description, self.blocks()[bool(self.warning) :])

    def blocks(self) -> list[Block]:
        """Return what the calibration says."""
        ends = self.beside.gap_before, self.beside.gap_after
        more = self.beside.parameters
        return [
            *([Note(self.warning, hanging="    "), Note("")] if self.warning else []),
            Note(f"Coefficients only for {self.simulator}"),
            gap_table(
                self.parameters, self.pairs, self.gap_before, self.gap_after, misfit=self.misfit
            ),
            *([gap_table(more, self.pairs, *ends, "not matched: gap / JND")] if more else []),
            self._material_table(),
            *(Note(note, hanging="    ") for note in self.every_note[bool(self.warning) :]),
        ]

    def _material_table(self) -> Table:
        """Return what was learned of each material, most first, shaded by how much."""
        columns = ["sigma before", "after", "shift / sigma", "pulled most by"]
        strength = np.abs(self.pulls).mean(axis=2)
        moved = np.sqrt((self.shift**2).mean(axis=1))
        rows = []
        for name, before, after in self.learned:
            i = self.prior.material_index(name)
            pair = "-"
            if strength[:, i].any():
                pair = " to ".join(self.pairs[int(np.argmax(strength[:, i]))])
            cells = [f"{before:.3f}", f"{after:.3f}", f"{moved[i]:.1f}", pair]
            if (fitted := self.scattering) is not None:
                s, sigma = (a[i].mean() for a in (fitted.coefficients, fitted.sigma))
                cells.append(f"{s:.2f} ± {sigma:.2f}")
            share = max(1 - after / before, 0.0) if before > 0 else 0.0
            rows.append(Row(name, cells, shade=[0.0, share, *[0.0] * (len(cells) - 2)]))
        return Table(columns + ["scattering"] * (self.scattering is not None), rows)

    @property
    def warning(self) -> str:
        """Sentences that stand first: start returned, T beyond the prior, gap grown; "" if none."""
        said = [_REFUSED] if self.refused else []
        if self.beyond:
            said.append(str(self.beyond))
        if farther := self._farther_matched:
            names = ", ".join(
                f"{parameter_label(p)} ({old:.1f} to {new:.1f} JND)" for p, old, new in farther
            )
            said.append(
                f"In {names} the calibrated simulator is farther from what was measured than before: "
                "do not simulate with it."
            )
            start = "The"
            if self.scattering is not None:
                start = (
                    "The fitted scattering may have ended at a poor fit: try another seed, or state "
                    "other scattering. Else the"
                )
            said.append(f"{start} model misses something, or a constraint keeps alpha away.")
        return " ".join(said)

    @property
    def every_note(self) -> list[str]:
        """The ``notes``, and what the result says against itself."""
        notes = list(self.notes)
        notes[:0] = sentences(self.beside.gaps, self.prior.centre_frequencies)
        if self.warning:
            notes.insert(0, self.warning)
        if LEVEL.key in self.parameters:
            notes.append(
                "Level: absolute, G of a calibrated source."
                if self.measured.level == "absolute"
                else "Level: relative between the positions of a source. The measured one is shown "
                "with the mean of the simulated one."
            )
        if self.scattering is not None:
            notes += self.scattering.notes(self.prior.materials)
        if self.controls is None:
            notes.append(
                "No interval: no control run tells this simulator's error. It is assumed to be 5 % of "
                "a time and 0.5 dB of a level."
            )
        if unexplained := self.unexplained_in_words:
            notes.append(
                "Simulator and prior miss what was measured by more than their errors let expect. A "
                f"value differs by a further {unexplained} (standard deviation)."
            )
        for pair in self.contradictions:
            notes.append(
                f"{' to '.join(pair)} contradicts all other pairs: check its names and positions, or "
                "leave it out (exclude)."
            )
        if not self.settled:
            notes.append(
                "Not settled: the last step moved alpha, or was refused. Calibrate with more paths."
            )
        return notes

    @property
    def unexplained_in_words(self) -> str:
        """The unexplained errors of half a JND and more, by parameter; "" without any."""
        return ", ".join(
            f"{of:.1f} JND of {parameter_label(p)}"
            for p, of in zip(self.parameters, self.unexplained, strict=True)
            if of >= _FARTHER
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text; None where a value is missing."""
        entries = coefficients(self.prior, self.alpha, self.sigma, self.interval)
        return {
            "rtcal": KIND,
            "room": self.prior.name,
            "author": self.prior.author,
            "simulator": self.simulator,
            "simulations": self.simulations,
            "scattering": self.scattering and self.scattering.to_dict(),
            "centre_frequencies": json_numbers(self.prior.centre_frequencies),
            "parameters": list(self.parameters),
            "units": [observable(p).unit for p in self.parameters],
            "level": self.measured.level,
            "pairs": [list(pair) for pair in self.pairs],
            "measured": [json_numbers(v) for v in self._natural(self.measured.observations)],
            "before": [json_numbers(v) for v in self._natural(self.before)],
            "after": [json_numbers(v) for v in self._natural(self.after)],
            "gap_before_jnd": json_numbers(self.gap_before),
            "gap_after_jnd": json_numbers(self.gap_after),
            "not_matched": {
                "parameters": list(self.beside.parameters),
                "gap_before_jnd": json_numbers(self.beside.gap_before),
                "gap_after_jnd": json_numbers(self.beside.gap_after),
            },
            "held_out": self.held_out
            and {
                "parameters": list(self.held_out.parameters),
                "pairs": [list(pair) for pair in self.held_out.measured.pairs],
                "gap_before_jnd": json_numbers(self.held_out.gap_before),
                "gap_after_jnd": json_numbers(self.held_out.gap_after),
            },
            "materials": [
                {
                    "name": entry["name"],
                    "area": float(self.prior.areas[i]),
                    **entry,
                    "pulls": json_numbers(self.pulls[:, i]),
                }
                for i, entry in enumerate(entries)
            ],
            "misfit": json_numbers(self.misfit),
            "contradictions": [list(pair) for pair in self.contradictions],
            "control_runs": 0 if self.controls is None else len(self.controls.errors),
            "unexplained_jnd": json_numbers(self.unexplained),
            "refused": self.refused,
            "beyond_prior": self.beyond and vars(self.beyond),
            "steps": [step.share for step in self.steps],
            "settled": self.settled,
            "worst_certificate": self.certificate.worst,
            "notes": self.every_note,
        }

    def _natural(self, values: Observations) -> list[Array]:
        return [values.natural(p) for p in self.parameters]
