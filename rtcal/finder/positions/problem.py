"""The numbers of one search: its hypotheses, what was measured, and how it and the simulator may err.

A hypothesis has a place: a surface or part of one, the whole room, one material, the measurement. An
effect gives its alpha here, and its whole state to means (`rtcal.finder.means.problem`): what stands on
a surface is traced, not calculated.

The evidence is linear in the shifts and Gaussian in the errors (docs/where_method.md):

    y - f(mu) = d_h + J (alpha - mu) + e,   e of covariance R + D,

y is what was measured and f(mu) what is simulated as stated, d_h the shift of hypothesis h. The
prior of alpha and the error of d_h are integrated. All values are ordered (band, parameter, pair).

A shift of band k is a mixture of the shifts at the nodes of one response, and no parameter of a band
depends on another band. So each hypothesis needs products of nodes alone: N' K⁻¹ N and N' K⁻¹ r. All
hypotheses share one covariance and differ in a product; those on means have a covariance each.

The error of d_h has two parts. Each band's shift is larger or smaller by a factor
(`ShiftHypothesis.error`), and reaches pairs more or less than if it were spread evenly
(`ShiftHypothesis.uneven`): an absorber hangs somewhere, and receivers near it lose more.

How much the whole room scatters changes too much for a derivative. So the room is traced at several
levels, and every density is the mean over them (`levels`). The traced paths give the changes by each
material's scattering (`PathTracing.scattering_jacobian`), and reference simulations give the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import LEVEL, observable
from rtcal.acoustics.room_errors import (
    alike_alpha,
    common_error_columns,
    of_climate,
    prior_covariance,
)
from rtcal.finder.case import CLIMATE_UNCERTAINTY, PositionsCase
from rtcal.finder.effects import (
    HARD,
    CoupledRoom,
    Effect,
    OmittedAir,
    Parameters,
    WrongVolume,
    middle_absorption,
)
from rtcal.finder.evidence import (
    COEFFICIENTS,
    NONE,
    SCALES,
    UNKNOWN,
    bounded,
    grid_weights,
    log_priors,
    relative_sigma,
    with_columns,
)
from rtcal.finder.model import RoomState
from rtcal.finder.positions.weighing import (
    AIR,
    BAND_GAIN,
    GAIN,
    MOVE,
    OPEN,
    OWN_GAIN,
    SECOND_ROOMS,
    SHARES,
    STEP,
    TRACED,
    TRACINGS,
    VOLUME,
    PairShifts,
    interpolation,
)
from rtcal.loop.measured_pairs import COMMON as OF_ROOM
from rtcal.loop.measured_pairs import OWN as OF_MATERIAL
from rtcal.loop.measured_pairs import (
    ControlRuns,
    MaterialScattering,
    Pair,
    pairs_to_match,
    stated_uncertainty,
)
from rtcal.simulators.base import LARGEST_ALPHA, Observations
from rtcal.support.errors import DataError
from rtcal.support.normal import symmetric_root
from rtcal.support.speed import thread_pool
from rtcal.support.types import Array

POSITION, NOISE, MEASUREMENT = "position", "noise", "measurement"
ODDS = {
    POSITION: 0.5,
    NOISE: 0.5,
    UNKNOWN: 0.5,
    "air": 1.0,
    "volume": 1.0,
    COEFFICIENTS: 1.0,
}
"""Prior odds against an effect of odds 1; those of the absorbers are their classes'."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sizes:
    """Hold an effect in one place, with each of its possible ``sizes`` (n_sizes,) in ``unit``."""

    effect: str
    family: str
    place: str = ""  # name of a source, receiver, pair or material
    surface: int | None = None  # its number
    sizes: Array
    unit: str
    odds: Array  # before the measurement, (n_sizes,)


@dataclass(frozen=True, eq=False, kw_only=True)
class ShiftHypothesis(Sizes):
    """Hold hypotheses that the room differs from the model, which changes the simulated values."""

    response: str  # which of the responses is interpolated
    weights: Array
    """Shift of band k is weights[:, k] @ the response's nodes of band k, (n_hypotheses, n_bands,
    n_nodes)."""
    parameters: Sequence[Parameters]
    error: Array  # covariance of the relative error of the change, band by band, (n_bands, n_bands)
    spectra: Array
    """Alpha of what stands on the surface, (n_hypotheses, n_bands); empty for the whole room."""
    uneven: Array
    """How far it may shift one pair more than another, over an absorber that is spread evenly,
    (n_hypotheses,)."""
    size_error: float = 0.0
    """Standard deviation of ln size that the effect's description leaves open."""
    part: int | None = None  # number of the part of the surface; None for all of it
    divisible: bool = False  # whether it may stand on a part of its surface alone

    def some(self, which: Any) -> ShiftHypothesis:
        """Return some of the hypotheses, by a slice or by flags."""
        by_row = ("weights", "odds", "sizes", "spectra", "uneven")
        parameters = np.array(self.parameters, dtype=object)[which].tolist()
        return replace(self, parameters=parameters, **{n: getattr(self, n)[which] for n in by_row})


@dataclass(frozen=True, eq=False, kw_only=True)
class SpreadHypothesis(Sizes):
    """Describe an error of the measurement that makes some measured values less certain.

    The covariance of the values in ``rows`` grows by ``scales**2 columns columns'``.
    """

    family: str = MEASUREMENT
    rows: NDArray[np.int64]  # in the order of band, parameter and pair
    columns: Array  # additional errors, one standard deviation each, (n_rows, n_errors)
    scales: Array  # factors on them, (n_sizes,)


@dataclass(frozen=True, eq=False)
class PositionsHypotheses:
    """Hold all hypotheses of a search at positions as the rows of one table.

    These are "none", an error of all coefficients, an unknown effect; the sizes of each of
    ``spreads`` and ``shifts``; and, if ``unknown``, the effects once more, each beside an unknown
    one.
    """

    shifts: Sequence[ShiftHypothesis]
    spreads: Sequence[SpreadHypothesis]
    off: float
    unknown: bool = True

    def by_row(self, attribute: str) -> list[Any]:
        """Return the "effect", "family" or "surface" of each row; None for a row without a surface."""
        groups: list[Any] = [*self.spreads, *self.shifts]
        groups += self.shifts if self.unknown else ()
        rows: list[Any] = [None] * 3 if attribute == "surface" else [NONE, COEFFICIENTS, UNKNOWN]
        for group in groups:
            rows += [getattr(group, attribute)] * len(group.odds)
        return rows

    def of_groups(self, values: Array) -> tuple[list[Array], list[Array], list[Array]]:
        """Return rows of ``values`` by spread, by shift, and by shift in combination with "unknown"."""
        n = len(self.spreads)
        groups: list[Any] = [*self.spreads, *self.shifts, *self.shifts]
        ends = 3 + np.cumsum([0, *(len(group.odds) for group in groups)])
        rows = [values[first:end] for first, end in pairwise(ends)]
        return rows[:n], rows[n : n + len(self.shifts)], rows[n + len(self.shifts) :]

    @cached_property
    def log_prior(self) -> Array:
        """Log prior probability of each row, (n,)."""
        of_shifts, of_spreads = (
            np.concatenate([np.zeros(0), *(group.odds for group in groups)])
            for groups in (self.shifts, self.spreads)
        )
        unknown = ODDS[UNKNOWN] if self.unknown else 0.0
        of_effects = of_shifts.sum()
        # Over all effects that nothing explains everything is as probable as something unknown alone,
        # but no more than a half.
        beside = min(unknown / of_effects, 0.5) if of_effects > 0 else 0.0
        both = [(1 - beside) * of_shifts, *([beside * of_shifts] if self.unknown else [])]
        return log_priors(np.concatenate([[unknown], of_spreads, *both]), self.off)


def towards(moved: Array, stated: Array) -> Array:
    """Return weights (..., n_bands, n_nodes) of `SHARES` for changes of alpha (..., n_bands)."""
    up = moved / np.maximum(1 - stated, 1e-6)
    down = moved / np.maximum(stated - HARD, 1e-6)
    return interpolation(SHARES, np.where(moved >= 0, up, np.maximum(down, -1.0)))


LEAST_COVERED = 1 / 9
"""Least part of a surface for which the shares were found; smaller ones have its error."""
COMMON_UNEVENNESS = {"late": 0.05, "early": 0.06, "level": 0.14}
"""Relative deviation that all pairs share, by `Observable.part`. That of T and of the early parameters
is the same one."""
OWN_UNEVENNESS = {"late": 0.06, "early": 0.06, "level": 0.24}
"""Relative deviation of each pair: one for T, one for all early parameters, one for the level."""


def uneven_amount(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the weights (n_parameters * n_pairs,) of a mean change of absorption in a band."""
    rises = [1.0 if observable(name).rises else -1.0 for name in parameters]
    return np.repeat(rises, n_pairs) / (len(parameters) * n_pairs)


def uneven_columns(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the deviations at a change of 1, (n_parameters n_pairs, n_columns)."""
    signs = np.sign(uneven_amount(parameters, 1))
    groups = [observable(name).part for name in parameters]

    def row(of: Mapping[str, float], members: Sequence[str]) -> Array:
        return np.array([of[g] if g in members else 0.0 for g in groups]) * signs

    shared = [row(COMMON_UNEVENNESS, members) for members in (("late", "early"), ("level",))]
    own = [row(OWN_UNEVENNESS, [group]) for group in OWN_UNEVENNESS]
    every = np.hstack(
        [
            *(np.repeat(each, n_pairs)[:, np.newaxis] for each in shared),
            *(np.kron(each[:, np.newaxis], np.eye(n_pairs)) for each in own),
        ]
    )
    return np.asarray(every[:, np.abs(every).max(axis=0) > 0])


def unevenness(covered: Array) -> Array:
    """Return the size of the deviation where these parts of a surface are covered."""
    return np.asarray(np.sqrt(1 / np.clip(covered, LEAST_COVERED, 1.0) - 1))


FACTORS = np.array([-1.2, -0.9, -0.65, -0.45, -0.3, 0.3, 0.45, 0.65, 0.9, 1.2])
"""ln of the factors by which one material's coefficients may be off."""
FACTOR_SCALE = 0.35
"""Mean size of that logarithm. Carpets, plasters and glass of one name differ by 20 to 60 % between
tables, and now and then by a factor of three."""


def materials(case: PositionsCase) -> list[ShiftHypothesis]:
    """Return, for each material, the hypotheses that its coefficients are wrong by a common factor."""
    room = case.room
    over_bands = bands.correlation(room.centre_frequencies, 0.7)
    density = np.exp(-np.abs(FACTORS) / FACTOR_SCALE)
    # Who states a small sigma knows the coefficients from a measurement (`probability_off`).
    odds = ODDS[COEFFICIENTS] * relative_sigma(room) ** 2
    absorbed = room.areas * room.alpha.mean(axis=1)
    factors = np.exp(FACTORS)
    made = []
    for row, members in case.surfaces_of_materials.items():
        alpha = room.alpha[row]
        moved = np.minimum(factors[:, np.newaxis] * alpha, 1.0) - alpha
        made.append(
            ShiftHypothesis(
                effect=COEFFICIENTS,
                family=COEFFICIENTS,
                place=room.materials[row],
                response=f"material {row}",
                weights=np.tile(towards(moved, alpha), (1, 1, len(members))),
                odds=density / density.sum() * absorbed[row] / absorbed.sum() * odds,
                sizes=factors,
                unit="of the input",
                parameters=[{"factor": float(factor)} for factor in factors],
                error=0.1**2 + 0.15**2 * over_bands,
                spectra=np.zeros((len(factors), 0)),
                uneven=np.zeros(len(factors)),
            )
        )
    return made


def stated_room(case: PositionsCase) -> RoomState:
    """Return the room's input as a state; its materials' directions affect no whole-room effect."""
    return RoomState.of_room(case.room, np.full((case.room.n_materials, 3), 1 / 3))


def _whole_room(case: PositionsCase, effect: Any) -> ShiftHypothesis:
    """Return the hypotheses of another climate, or of a volume that scales all lengths."""
    room, stated, f = case.room, stated_room(case), case.room.centre_frequencies
    nodes: Sequence[float]
    if effect.name == OmittedAir.name:
        grid = effect.grid(stated)
        attenuation = np.array([state.air for state in effect.changes(stated, grid)])
        at = (attenuation - room.air_attenuation) / Air(20, 50).attenuation(f)
        nodes, sizes = AIR, np.array([p["humidity"] for p in grid])
        prior, error = effect.prior_odds(room), effect.error_over_bands(f)
    else:
        grid = effect.near(stated)
        sizes = np.array([p["ratio"] for p in grid])
        at = np.repeat(np.log(sizes)[:, np.newaxis], room.n_bands, axis=1)
        nodes, prior, error = VOLUME, 1.0, 0.02**2 * (1 + np.eye(room.n_bands))
    odds = grid_weights(effect, grid, stated) * prior
    return ShiftHypothesis(
        effect=effect.name,
        family=effect.family,
        response=effect.name,
        weights=interpolation(nodes, at),
        odds=odds * ODDS[effect.name] / odds.sum(),
        sizes=sizes,
        unit=effect.unit,
        parameters=grid,
        error=error,
        spectra=np.zeros((len(grid), 0)),
        uneven=np.zeros(len(grid)),
    )


COUPLED = CoupledRoom()
LEAST = 0.05
"""Least area that is tried, over the room's absorption area at 500 to 2000 Hz."""
RATIO = 28.0 ** (1 / 13)
"""Of an area that is tried to the one before it. The last is the largest that the surface holds."""
WHOLE = (OmittedAir.name, WrongVolume.name)
"""Effects of the whole room that change what is traced."""
DISPLACEMENTS = np.array([0.5, 1.0, 2.0])
"""Distances in m by which a source or receiver may stand elsewhere."""
NOISES = np.array([3.0, 10.0])
"""Factors of the standard deviation of a pair whose measurement failed."""
LOCATED = 0.5
"""Prior probability that something which fits on a part of its surface stands on one alone."""
_LEAST_TAKEN = 0.1
"""A cover that takes less than this share of a surface's absorption is no hypothesis."""


def areas_tried(middle: float, area: float) -> Array:
    """Return the areas that are tried on a surface, in m², up to its own."""
    number = 1 + math.floor(math.log(max(area / (LEAST * middle), 1 / RATIO)) / math.log(RATIO))
    return np.asarray(np.minimum(LEAST * middle * RATIO ** np.arange(number), area))


def on_surfaces(effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that have an alpha on a surface, those that cover it last."""
    standing = [e for e in effects if e.stands_on and e.name != COUPLED.name]
    return sorted(standing, key=lambda e: (bool(e.shares), "wall" not in e.stands_on))


def shifts(
    case: PositionsCase, effects: Sequence[Effect], without: Sequence[str] = ()
) -> list[ShiftHypothesis]:
    """Return the hypotheses of the room, but for some effects."""
    tried = {effect.name: effect for effect in effects if effect.name not in without}
    standing = [*on_surfaces([*tried.values()]), *([COUPLED] if COUPLED.name in tried else [])]
    out = [each for effect in standing for each in _standing(case, effect)]
    out += materials(case) if COEFFICIENTS not in without else []
    return out + [_whole_room(case, tried[name]) for name in WHOLE if name in tried]


def _standing(case: PositionsCase, effect: Effect) -> list[ShiftHypothesis]:
    """Return an effect on each surface that can have it; an aperture leads to each second room."""
    room, areas = case.room, np.array(list(case.areas.values()))
    frequencies, middle = room.centre_frequencies, middle_absorption(stated_room(case))
    possible = np.array([k in effect.stands_on for k in case.kinds])
    coupled, covers = effect.name == COUPLED.name, bool(effect.shares)
    spectra = effect.on_surface(frequencies)
    if coupled:
        rooms = [{"aperture": 0.0, "volume": v * room.volume, "alpha": a} for v, a in SECOND_ROOMS]
        spectra = [(of_room, np.ones(room.n_bands)) for of_room in rooms]
    made = []
    for j in np.flatnonzero(possible):
        stated = case.surface_alpha[j]
        tried = np.array(effect.shares) * areas[j] if covers else areas_tried(middle, areas[j])
        every = [  # change of alpha, spectrum, area and parameters of each
            (area / areas[j] * (spectrum - stated), spectrum, area, settings)
            for settings, spectrum in spectra
            for area in tried
        ]
        if covers:
            every = [(np.minimum(moved, 0.0), *rest) for moved, *rest in every]
            least = _LEAST_TAKEN * np.maximum(stated, 1e-6)
            every = [each for each in every if (-each[0] >= least).any()]
        else:  # a panel over mineral wool takes more in one band than it adds in any: that is a cover
            every = [each for each in every if each[0].max() > -each[0].min()]
        if not every:
            continue
        moved, alpha, used, settings = zip(*every, strict=True)
        weights, sizes = towards(np.array(moved), stated), np.array(used)
        if coupled:
            share = np.repeat(tried[:, np.newaxis] / areas[j], room.n_bands, axis=1)
            of_one = interpolation(OPEN, share)
            weights = np.vstack([np.kron(row, of_one) for row in np.eye(len(SECOND_ROOMS))])
        fitting = [areas[possible & (areas >= (0 if covers else area))].sum() for area in used]
        made.append(
            ShiftHypothesis(
                effect=effect.name,
                family=effect.family,
                surface=int(j),
                response=f"{'aperture' if coupled else 'surface'} {j}",
                weights=weights,
                odds=areas[j] / np.array(fitting),
                sizes=sizes,
                unit="m²",
                parameters=[
                    {**of, "aperture" if coupled else "area": float(area)}
                    for of, area in zip(settings, used, strict=True)
                ],
                spectra=np.array(alpha),
                error=effect.error_over_bands(frequencies),
                uneven=unevenness(sizes / areas[j]),
                size_error=effect.size_error,
                divisible=not (covers or coupled),
            )
        )
    total, odds = sum(s.odds.sum() for s in made), effect.prior_odds(room)
    return [replace(s, odds=s.odds * odds / total) for s in made]


def on_parts(case: PositionsCase, shifts: Sequence[ShiftHypothesis]) -> list[ShiftHypothesis]:
    """Return hypotheses on surfaces and on their parts, which have the share `LOCATED` of the odds."""
    out = []
    for shift in shifts:
        parts = {p: t for p, t in enumerate(case.divided.parts) if t.surface == shift.surface}
        if not parts or not shift.divisible:
            out.append(shift)
            continue
        holds = {p: shift.sizes <= part.area for p, part in parts.items()}
        number = np.sum([*holds.values()], axis=0)
        out.append(replace(shift, odds=np.where(number > 0, 1 - LOCATED, 1.0) * shift.odds))
        shared = replace(shift, odds=LOCATED * shift.odds / np.maximum(number, 1))
        for p, part in parts.items():
            if not holds[p].any():
                continue
            some, stated = shared.some(holds[p]), case.surface_alpha[part.surface]
            covered = some.sizes / part.area
            weights = towards(covered[:, np.newaxis] * (some.spectra - stated), stated)
            out.append(
                replace(
                    some,
                    part=p,
                    response=f"part {p}",
                    weights=weights,
                    uneven=unevenness(covered),
                )
            )
    return out


def spreads(
    measured: Sequence[Pair],
    moved: Mapping[str, Array],
    errors: Array,
) -> list[SpreadHypothesis]:
    """Return the hypotheses of errors of the measurement: displaced positions, and noisy pairs."""
    shape = errors.shape[:3]
    number = np.arange(math.prod(shape)).reshape(shape)
    full = errors.reshape(number.size, number.size)
    made: list[tuple[str, str, NDArray[np.int64], Array]] = []
    for place, shift in moved.items():
        if len(pairs := np.flatnonzero(np.abs(shift).max(axis=(0, 2, 3)))):
            rows = number[:, :, pairs].ravel()
            # The displacements along an axis and back have nearly opposite shifts: three directions.
            columns = np.moveaxis(shift[:, pairs], 2, 0).reshape(len(rows), -1) / np.sqrt(6)
            made.append((POSITION, place, rows, columns))
    for i, pair in enumerate(measured):
        rows = number[:, :, i].ravel()
        root = np.asarray(np.linalg.cholesky(full[np.ix_(rows, rows)]))
        made.append((NOISE, " to ".join(pair), rows, root))
    of_kind = {  # sizes, unit, scales and number of places
        POSITION: (DISPLACEMENTS, "m", DISPLACEMENTS / MOVE, len(moved)),
        NOISE: (NOISES, "times as uncertain", np.sqrt(NOISES**2 - 1), len(measured)),
    }
    out = []
    for effect, place, rows, columns in made:
        sizes, unit, scales, places = of_kind[effect]
        odds = np.full(len(sizes), ODDS[effect] / (places * len(sizes)))
        out.append(
            SpreadHypothesis(
                effect=effect,
                place=place,
                sizes=sizes,
                unit=unit,
                odds=odds,
                rows=rows,
                columns=columns,
                scales=scales,
            )
        )
    return out


class ScatteringLevels(NamedTuple):
    """Hold the changes (n, n_levels) of n values by other scattering, and log weights (n_levels,)."""

    shifts: Array
    log_weights: Array


Residuals = tuple[Array, Array]
"""K⁻¹ r and r' K⁻¹ r of the residual r at each level: (n, n_levels) and (n_levels,)."""


@dataclass(eq=False)
class Likelihood:
    """Compute the probability density of measured minus simulated values (n,) under each hypothesis.

    The values are ordered by band, parameter and pair, and ``used`` (n,) is True for those that were
    measured. ``covariance`` (n, n) is that of all errors that do not depend on the hypothesis.
    ``nodes`` has, by the name of a surface or other cause, the changes (n_bands, n_values, n_nodes) of
    a band's values by the amounts of this cause that were simulated. ``uneven`` (n_values, n_columns)
    are deviations of single pairs per unit change of the absorption. ``amount`` (n_values,) are the
    weights that give the mean change of absorption from a band's changes. ``levels`` are the changes if
    the room scatters more or less.
    """

    covariance: Array
    used: NDArray[np.bool_]
    nodes: Mapping[str, Array]
    uneven: Array
    amount: Array
    levels: ScatteringLevels
    inverse: Array = field(init=False)
    half: float = field(init=False)
    _products: dict[str, tuple[Array, Array]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        both = np.outer(self.used, self.used)
        kept = np.where(both, self.covariance, 0.0) + np.diag(np.where(self.used, 0.0, 1.0))
        self.half = float(np.log(np.diag(np.linalg.cholesky(kept))).sum())
        # A value that was not measured has a residual of any size: its row is 0.
        self.inverse = np.where(both, np.linalg.inv(kept), 0.0)

    @property
    def number(self) -> int:
        """Number of values that were measured."""
        return int(self.used.sum())

    def of(self, residual: Array) -> Residuals:
        """Return the products of a residual (n,) that the other methods need."""
        by_level = residual[:, np.newaxis] - self.levels.shifts
        measured = np.where(self.used[:, np.newaxis], by_level, 0.0)
        pull = np.asarray(self.inverse @ measured)
        return pull, np.asarray(np.einsum("nm,nm->m", measured, pull))

    def with_one_level(self) -> Likelihood:
        """Return the normal likelihood whose covariance has that of the levels."""
        weights, shifts = np.exp(self.levels.log_weights), self.levels.shifts
        off = shifts - (shifts @ weights)[:, np.newaxis]
        covariance = self.covariance + (off * weights) @ off.T
        one = ScatteringLevels(np.zeros((len(covariance), 1)), np.zeros(1))
        return replace(self, covariance=covariance, levels=one)

    def stated(self, residuals: Residuals) -> float:
        """Return the log density if the room does not differ from the model."""
        return float(self._log(residuals[1], self.half))

    def spread(self, spread: SpreadHypothesis, residuals: Residuals) -> Array:
        """Return the log density if some values have larger errors, (n_hypotheses,)."""
        kept, scales = self.used[spread.rows], spread.scales[:, np.newaxis, np.newaxis]
        rows, columns, (pull, square) = spread.rows[kept], spread.columns[kept], residuals
        across, inner = columns.T @ pull[rows], self.inverse[np.ix_(rows, rows)]
        inner = scales**2 * (columns.T @ inner @ columns)
        return self._log(*with_columns(square, self.half, scales * across, inner))

    def shifted(self, shifts: Sequence[ShiftHypothesis], residuals: Residuals) -> Array:
        """Return the log densities of each shift's hypotheses one after the other, (n_hypotheses,)."""
        with thread_pool(None) as pool:
            each = pool.map(lambda shift: self._shifted(shift, residuals), shifts)
            return np.concatenate([np.zeros(0), *each])

    def changes(self, shift: ShiftHypothesis) -> Array:
        """Return the shift d of each hypothesis, (n_hypotheses, n_bands, n_values)."""
        every = self.nodes[shift.response] @ np.moveaxis(shift.weights, 0, -1)
        return np.moveaxis(every, -1, 0)

    def _shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        """Return `shifted` of one: an error per band by its `error`, and W by its change."""
        from rtcal.finder.positions.density_kernel import of_own_errors

        (pull, of_stated), (columns, products) = residuals, self._of_response(shift.response)
        (n_bands, n_nodes), by_band = shift.weights.shape[1:], shift.weights.swapaxes(0, 1)
        pulled = columns.swapaxes(1, 2) @ pull.reshape(*columns.shape[:2], -1)
        turned = (by_band @ products).reshape(*by_band.shape[:2], n_bands, -1)  # (l, h, k, a)
        projected = (by_band @ pulled[:, :n_nodes]).swapaxes(0, 1)  # d' K⁻¹ r, by band
        forms = np.einsum("hkn,lhkn->hkl", shift.weights, turned[..., :n_nodes])  # d' K⁻¹ d
        square = of_stated - 2 * projected.sum(1) + forms.sum((1, 2))[:, np.newaxis]
        error = np.asarray(np.linalg.cholesky(shift.error + 1e-9 * np.eye(n_bands)))
        across = error.T @ (projected - forms.sum(2)[..., np.newaxis])
        change, side = np.zeros(shift.weights.shape[:2]), np.zeros((len(square), 0, n_bands))
        products = np.zeros((0, self._of_uneven.shape[1], 0))
        if shift.uneven.any():
            change = shift.uneven[:, np.newaxis] * (self.changes(shift) @ self.amount)
            mixed = np.einsum("hk,lhkc->hcl", change, turned[..., n_nodes:])
            own = np.einsum("hk,kcm->hcm", change, pulled[:, n_nodes:])
            across = np.concatenate([across, own - mixed.sum(2)[..., np.newaxis]], axis=1)
            side, products = mixed @ error, self._of_uneven
        explained, more = of_own_errors(error.T @ forms @ error, side, change, products, across)
        return self._log(square - explained, self.half + more[:, np.newaxis])

    def inverse_with_place(self, shift: ShiftHypothesis, row: int) -> Array:
        """Return the inverse of the covariance with the error of a hypothesis' place, (n, n)."""
        change = shift.uneven[row] * (self.changes(shift)[row] @ self.amount)
        columns = np.kron(change[:, np.newaxis], self.uneven)
        pulled = self.inverse @ columns
        inner = np.eye(columns.shape[1]) + columns.T @ pulled
        return np.asarray(self.inverse - pulled @ np.linalg.solve(inner, pulled.T))

    @property
    def _by_band(self) -> Array:
        """K⁻¹ as (n_bands, n_values, n_bands, n_values)."""
        shape = (len(self.inverse) // len(self.amount), len(self.amount))
        return self.inverse.reshape(*shape, *shape)

    @cached_property
    def _of_uneven(self) -> Array:
        """W' K⁻¹ W of pairs of bands as `of_own_errors` takes it, (n_columns, n_pairs, n_columns)."""
        full = self.uneven.T @ np.moveaxis(self._by_band, 2, 1) @ self.uneven
        one, other = np.tril_indices(len(full))
        both = full[one, other] + np.where(one == other, 0.0, 1.0)[:, None, None] * full[other, one]
        return np.ascontiguousarray(both.swapaxes(0, 1))

    def _of_response(self, response: str) -> tuple[Array, Array]:
        """Return [N W] of each band, (k, v, a), and [N W]' K⁻¹ N, (l, n, k a)."""
        if response not in self._products:
            nodes = self.nodes[response]
            n_bands, _, n_nodes = nodes.shape
            uneven = np.broadcast_to(self.uneven, (n_bands, *self.uneven.shape))
            columns = np.concatenate([nodes, uneven], axis=2)
            half = np.moveaxis(self._by_band, 2, 0) @ nodes[:, np.newaxis]  # (l, k, v, n)
            products = (half.swapaxes(2, 3) @ columns).swapaxes(1, 2)
            self._products[response] = columns, products.reshape(n_bands, n_nodes, -1)
        return self._products[response]

    def _log(self, square: Array, half: Array | float) -> Array:
        """Return the mean log density over the levels, (..., n_levels) to (...)."""
        by_level = bounded(square, half, self.number) + self.levels.log_weights
        return np.asarray(np.logaddexp.reduce(by_level, axis=-1))


Likelihoods = tuple[Likelihood, list[Likelihood], list[Likelihood]]
"""With coefficients as stated, off together, and of something that no effect explains."""


def flat(values: NDArray[Any]) -> NDArray[Any]:
    """Return values (n_parameters, n_pairs, n_bands) in the order (band, parameter, pair), (n,)."""
    return np.asarray(np.moveaxis(values, 2, 0).reshape(-1))


UNKNOWN_SCALES = (4.0, 16.0)
"""Factors of the variance of the simulator's error if it misses something that no effect explains."""
OWN = 0.1
"""Share of the reference simulations' variance that is each value's own. Without it, combinations of
values decide that hardly differ between so few runs."""
COMMON = 0.25
"""Share of the variance common to all pairs that is assumed. Reference simulations scatter from hardly
at all to nearly everything, by which T of the whole room differs most."""
BETWEEN_OCTAVES = 0.7
"""Correlation of the scattering's part of each band between bands an octave apart. Without that part
what was measured in a flat room that scatters little was less likely by 8 to 11 nats."""


def reordered(covariance: Array, shape: Sequence[int]) -> Array:
    """Return a covariance over (parameter, pair, band) in the order (band, parameter, pair)."""
    order = flat(np.arange(len(covariance)).reshape(*shape))
    return np.asarray(covariance[np.ix_(order, order)])


def simulator_error(
    controls: ControlRuns,
    noise: Array,
    scattering: Array,
    scattering_noise: Array,
    tracings: int,
    centre_frequencies: Array,
    erring: int = 1,
) -> Array:
    """Return the covariance of the error of n values that are the mean of some tracings, (n, n).

    The values are all parameters, pairs and bands. ``controls`` has the errors in reference
    simulations. ``noise`` (n_groups, n_parameters, n_pairs, n_bands) are deviations of groups of paths
    from the mean of their tracing. ``scattering`` (n_parameters, n_pairs, n_bands, n_materials) are
    derivatives by the log odds of each material's scattering coefficient, and ``scattering_noise``
    (n_groups, ...) their deviations in the groups. ``tracings`` is the number of tracings, and
    ``centre_frequencies`` are in Hz. ``erring`` is how many rooms err as the reference simulations do:
    the real one, and that of another program's run.
    """
    free = len(noise) - tracings
    variance = (noise**2).sum(axis=0).mean(axis=1) / free  # (n_parameters, n_bands)
    # What derivatives differ by between pairs is mostly noise.
    slope, alike = (
        np.broadcast_to(of.mean(axis=-3, keepdims=True), of.shape)
        for of in (scattering, scattering_noise)
    )
    slope = slope.reshape(-1, scattering.shape[-1])
    prior = MaterialScattering(slope=slope, traced=np.zeros(slope.shape[1])).prior

    def runs_of(errors: Array) -> ControlRuns:
        return replace(controls, errors=errors, levels=None, models=())

    def of_scattering(prior: Array) -> Array:
        """Return the covariance by other scattering, and by the noise of the derivatives."""
        # What they err by counts as often as the scattering that they belong to may be other.
        by_material = np.moveaxis(alike @ np.linalg.cholesky(prior), -1, 0)
        of_noise = sum(runs_of(errors).covariance() / free for errors in by_material)
        return np.asarray(slope @ prior @ slope.T + of_noise)

    # A reference simulation is the difference of two tracings, whose noise is taken off. Errors as
    # large as the noise of one are assumed instead: without them, what was measured was likelier by 5
    # nats in 27 rooms, and the right surface less likely. In them all pairs are alike, so that no
    # pattern of the paths counts.
    runs = runs_of(controls.without_noise(2 * variance).errors)
    of_paths = runs_of(noise).alike() * len(noise) / free + runs_of(noise).covariance() / free
    between = bands.correlation(centre_frequencies, BETWEEN_OCTAVES)
    between = np.tile(between, 2 * [len(slope) // len(between)])
    # Parameters and bands share the paths, and the pairs of a source, too.
    in_all_bands = of_scattering(OF_MATERIAL**2 * np.eye(len(prior)))
    of_runs = erring * runs.with_common(COMMON**0.5).covariance()
    of_runs = (1 - OWN) * of_runs + OWN * np.diag(np.diag(of_runs))
    return np.asarray(of_runs + of_paths + in_all_bands + of_scattering(prior) * between)


_LEVELS = np.linspace(-2.4, 2.4, 9)
"""Changes that are integrated over, the simulated values interpolated by a cubic spline."""


def levels(traced: Array) -> ScatteringLevels:
    """Return the changes if the room scatters otherwise, by traced ones, alike at all pairs."""
    from scipy.interpolate import CubicSpline

    alike = np.broadcast_to(traced.mean(axis=2, keepdims=True), traced.shape)
    middle = int(np.searchsorted(TRACED, 0.0))
    nodes, known = np.insert(TRACED, middle, 0.0), np.insert(alike, middle, 0.0, axis=-1)
    shifts = CubicSpline(nodes, known, axis=-1, bc_type="natural")(_LEVELS)
    log = -0.5 * (_LEVELS / OF_ROOM) ** 2
    return ScatteringLevels(shifts.reshape(-1, len(_LEVELS)), np.asarray(log - logsumexp(log)))


def covariance_of_lobes(nodes: Array, pairs: Sequence[Pair], frequencies: Array) -> Array:
    """Return the covariance of n values by unknown directivities of the sources, (n, n)."""
    n_bands, n_values, _ = nodes.shape
    of_source = np.array([source for source, _ in pairs] * (n_values // len(pairs)))
    same = of_source[:, np.newaxis] == of_source
    together, own = nodes[..., 0], nodes[..., 1:]
    every = np.einsum("kv,lw->kvlw", together, together)
    every += np.einsum("kva,lwa->kvlw", own, own) / own.shape[-1] * same[:, np.newaxis]
    every *= bands.correlation(frequencies, 0.7)[:, np.newaxis, :, np.newaxis]
    return np.asarray(every.reshape(n_bands * n_values, -1))


class PositionsProblem:
    """Hold what a search at positions compares: the data, their changes by effects, and their errors.

    All n values are ordered by band, parameter and pair. Raises DataError if too little was measured.

    Attributes
    ----------
    residual : array (n,)
        Measured minus simulated with the input coefficients, on a scale that is linear in the change of
        absorption (`Observable.linear`); 0 where nothing was measured. ``used`` (n,) is whether each
        value was measured.
    scale : array (n,)
        Derivative of this scale at each measured value, by which errors are multiplied.
    moved : mapping of str to array (n_parameters, n_pairs, n_bands, n_displacements)
        Changes of the values if a source or receiver is displaced, by its name.
    alpha : array (n, n_unknowns)
        Square root of the covariance of the values by errors of coefficients and climate. ``together``
        (n, n_errors) is its part by errors that coefficients have in common.
    measurement, simulator_error : array (n, n)
        Covariances of the errors of the measurement and of the simulator.
    aimed : array (n, n), optional
        Covariance of the values by other directivities of the sources; None if all are known.
    gains : sequence of array (n, n)
        Covariances of the values by errors of the gains of calibrated sources, alike in all bands and
        in single bands; empty if the level is relative, or if its common uncertainty is given.
    """

    def __init__(self, case: PositionsCase, made: PairShifts, controls: ControlRuns) -> None:
        tracer, room, base = case.simulator, case.room, made.base
        frequencies = room.centre_frequencies
        if case.simulated is not None:
            given = Observations.of_measurement(
                case.simulated, made.parameters, tracer.pairs
            ).values
            base = np.where(np.isfinite(given), given, base)  # the case has all that was measured
        simulated = Observations(
            parameters=made.parameters,
            pairs=tracer.pairs,
            centre_frequencies=frequencies,
            values=base,
        )
        self.data = pairs_to_match(room, case.measured, case.match, simulated, case.exclude)
        self.controls, wanted = controls, self.data.observations
        names, pairs = wanted.parameters, wanted.pairs
        if len(pairs) < 2:
            raise DataError(
                f"{' to '.join(pairs[0])} is the only source-receiver pair, but at least "
                "two are needed to locate an effect"
            )
        stated, shifts = simulated.at(wanted).values, made.at(wanted).columns
        self.shape = stated.shape
        values = {p: simulated.at(wanted).natural(p) for p in names}
        self.stated = Measurement(centre_frequencies=frequencies, values=values, pairs=pairs)
        self.used = flat(np.isfinite(wanted.values - stated)).astype(bool)
        if not self.used.any():
            raise DataError(
                "measurement and simulation have no parameter in common in the same band"
            )
        measured = np.where(np.isfinite(wanted.values), wanted.values, stated)
        kinds = [observable(name) for name in names]
        # What is stated, moved by the mean difference over the pairs: where errors are scaled.
        smooth = stated + (measured - stated).mean(axis=1, keepdims=True)
        slopes = zip(kinds, smooth, stated, strict=True)
        scale = np.array([kind.linear_slope(value, at) for kind, value, at in slopes])
        self.scale = flat(scale)
        scales = np.outer(self.scale, self.scale)

        def linear(values: Array) -> Array:
            """Return values (n_parameters, n_pairs, n_bands, ...) on the linear scales."""
            at = stated.reshape(*stated.shape, *[1] * (values.ndim - 3))
            return np.array([k.linear(v, t) for k, v, t in zip(kinds, values, at, strict=True)])

        def shifted(name: str) -> Array:
            """Return shifts by band, (n_bands, n_values, n_nodes)."""
            by_band = np.moveaxis(linear(stated[..., np.newaxis] + shifts[name]), 2, 0)
            return by_band.reshape(len(by_band), -1, by_band.shape[-1])

        self.residual = np.where(self.used, flat(linear(measured)), 0.0)
        kind_of = {name: name.split()[0] for name in shifts}
        responses = ("surface", "part", "aperture", "air", "volume")
        self.nodes = {name: shifted(name) for name, kind in kind_of.items() if kind in responses}
        for row, members in case.surfaces_of_materials.items():
            every = [self.nodes[f"surface {j}"] for j in members]
            self.nodes[f"material {row}"] = np.concatenate(every, axis=2)
        self.moved = {
            name: values * scale[..., np.newaxis]
            for name, values in shifts.items()
            if kind_of[name] in ("source", "receiver")
        }
        of_groups = shifts["noise of scattering"]
        of_groups = of_groups.reshape(*stated.shape, -1, shifts["scattering"].shape[-1])
        error = simulator_error(
            controls.at(names, pairs),
            np.moveaxis(shifts["noise"], -1, 0),
            shifts["scattering"],
            np.moveaxis(of_groups, -2, 0),
            TRACINGS,
            frequencies,
            1 if case.simulated is None else 2,
        )
        if case.simulated is not None:
            of_run = stated_uncertainty(wanted, case.simulated, case.simulated.uncertainty)
            error[np.diag_indices_from(error)] += np.nan_to_num(of_run).ravel() ** 2
        self.simulator_error = reordered(error, stated.shape) * scales
        step = STEP * (1 - np.minimum(room.alpha, LARGEST_ALPHA).T)  # (n_bands, n_materials)
        by_alpha = shifted("materials") / step[:, np.newaxis]
        self.alpha, self.together = _prior(case, by_alpha, self.nodes["air"])
        self.levels = levels(shifted("levels").reshape(room.n_bands, *stated.shape[:2], -1))
        self.gains: list[Array] = []
        if self.data.level == "absolute" and "g" not in case.measured.common_uncertainty:
            sources = np.array([source for source, _ in pairs])
            same = (sources[:, np.newaxis] == sources).astype(float)
            level = np.diag([float(name == LEVEL.key) for name in names])
            alike = np.kron(level, GAIN**2 + OWN_GAIN**2 * same)
            together = np.kron(np.ones((room.n_bands, room.n_bands)), alike)
            own = np.kron(np.eye(room.n_bands), np.kron(level, BAND_GAIN**2 * same))
            both = (together, together + own)
            self.gains = [np.asarray(of * scales, dtype=np.float64) for of in both]
        self.aimed: Array | None = None
        if made.columns["aimed"].any():
            self.aimed = covariance_of_lobes(shifted("aimed"), pairs, frequencies)
        measurement, there = np.zeros(scales.shape), np.flatnonzero(self.data.used)
        measurement[np.ix_(there, there)] = self.data.covariance
        self.measurement = reordered(measurement, stated.shape) * scales

    def likelihoods(self, sources: Array | float = 0.0) -> Likelihoods:
        """Return the likelihood as stated, with errors in common, and with unexplained ones.

        ``sources`` is a covariance by errors of the sources that is added, `aimed` or one of
        `gains`.
        """
        error = self.simulator_error
        base = self.alpha @ self.alpha.T + self.measurement + error + sources
        common = self.together @ self.together.T
        names, n_pairs = self.data.observations.parameters, self.shape[1]
        uneven, amount = uneven_columns(names, n_pairs), uneven_amount(names, n_pairs)

        def of(more: Array | float) -> Likelihood:
            return Likelihood(base + more, self.used, self.nodes, uneven, amount, self.levels)

        off = [of((scale**2 - 1) * common) for scale, _ in SCALES]
        return of(0.0), off, [of((scale - 1) * error) for scale in UNKNOWN_SCALES]


def _prior(case: PositionsCase, slopes: Array, air: Array) -> tuple[Array, Array]:
    """Return the factors of what alpha and the climate leave open, and of the common errors."""
    room, (n_bands, n_values, _) = case.room, slopes.shape
    frequencies = room.centre_frequencies
    matrix = np.einsum("kvj,kl->kvjl", slopes, np.eye(n_bands)).reshape(n_bands * n_values, -1)
    own = matrix @ symmetric_root(prior_covariance(room))
    # What catalogues err by in common: of all materials, and of each.
    both, each = common_error_columns(room.alpha, room.sigma, frequencies)
    of_each = np.einsum("tmb,mn->tnmb", each, np.eye(room.n_materials))
    together = matrix @ np.concatenate([both.reshape(2, -1), of_each.reshape(-1, both[0].size)]).T
    of_room = alike_alpha(room)[:-2]  # its climate counts by the case's own uncertainty
    of_room = of_room[of_room.any(axis=(1, 2))].reshape(-1, matrix.shape[1])
    if room.air is None:
        return np.hstack([own, matrix @ of_room.T, together]), together
    uncertain = room.replace(climate_sigma=CLIMATE_UNCERTAINTY)
    more = -np.array(of_climate(uncertain, lambda changed: changed.air_attenuation))
    climate = interpolation(AIR, more / Air(20, 50).attenuation(frequencies))
    shifts = np.einsum("krn,tkn->krt", air, climate).reshape(n_bands * n_values, -1)
    return np.hstack([own, shifts, matrix @ of_room.T, together]), together
