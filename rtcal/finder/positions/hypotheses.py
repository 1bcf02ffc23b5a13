"""Hypotheses by place: a surface or part of one, the whole room, one material, the measurement.

An effect gives its alpha here, and its whole state to means (`rtcal.finder.means.problem`): what
stands on a surface is traced, not calculated.

A hypothesis spreads an absorber over its surface. In truth it hangs somewhere: receivers near it
lose more than others, and T changes by more or less. Neither is known before the place is, so it is
an error of the hypothesis, in proportion to its change of the absorption. The shares come from
patches on walls of development boxes, which are weighed on the same paths (`python -m
benchmarks.studies.pairs.where_patches`). They are over sqrt(1 / s - 1), s being the part of the
surface that is covered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.observables import observable
from rtcal.finder.effects import (
    HARD,
    CoupledRoom,
    Effect,
    OmittedAir,
    Parameters,
    WrongVolume,
    middle_absorption,
)
from rtcal.finder.model import RoomState
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.weighing import AIR, MOVE, OPEN, SECOND_ROOMS, SHARES, VOLUME
from rtcal.finder.prior import (
    COEFFICIENTS,
    NO_EFFECT,
    NONE,
    UNKNOWN,
    grid_weights,
    relative_sigma,
)
from rtcal.loop.measured_pairs import Pair
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
class ShiftHypothesis:
    """Hypotheses of one effect in one place, with their sizes.

    Attributes
    ----------
    effect, family : str
    response : str
        Which of the responses is interpolated.
    weights : array (n_hypotheses, n_bands, n_nodes)
        Shift of band k is weights[:, k] @ the response's nodes of band k.
    odds : array (n_hypotheses,)
        Prior odds of each within its effect; over all surfaces they are normalised to 1.
    sizes : array (n_hypotheses,)
    unit : str
    parameters : sequence of mapping
    error : array (n_bands, n_bands)
        Covariance of the relative error of the change, band by band.
    spectra : array (n_hypotheses, n_bands)
        Alpha of what stands on the surface; empty for the whole room.
    uneven : array (n_hypotheses,)
        How far pairs may hear more or less of it; see `rtcal.finder.positions.hypotheses`.
    size_error : float
        Standard deviation of ln size that the effect's description leaves open.
    surface : int or None
        Number of the surface; None for the whole room.
    place : str
        The material whose coefficients are off.
    part : int or None
        Number of the part of the surface; None for all of it.
    divisible : bool
        Whether it may stand on a part of its surface alone.
    """

    effect: str
    family: str
    response: str
    weights: Array
    odds: Array
    sizes: Array
    unit: str
    parameters: Sequence[Parameters]
    error: Array
    spectra: Array
    uneven: Array
    size_error: float = 0.0
    surface: int | None = None
    place: str = ""
    part: int | None = None
    divisible: bool = False

    def some(self, which: Any) -> ShiftHypothesis:
        """Return some of the hypotheses, by a slice or by flags."""
        by_row = ("weights", "odds", "sizes", "spectra", "uneven")
        parameters = np.array(self.parameters, dtype=object)[which].tolist()
        return replace(self, parameters=parameters, **{n: getattr(self, n)[which] for n in by_row})


@dataclass(frozen=True, eq=False)
class SpreadHypothesis:
    """Hypotheses that some values err by more, with their sizes.

    The covariance grows by ``scales**2 columns columns'``. ``rows`` are the values' numbers in the
    order (band, parameter, pair), ``columns`` (n_rows, n_errors) their errors, one standard deviation
    each at a scale of 1. ``sizes``, ``scales`` and ``odds`` are (n_hypotheses,). ``place`` names the
    source, receiver or pair.
    """

    effect: str
    place: str
    sizes: Array
    unit: str
    rows: NDArray[np.int64]
    columns: Array
    scales: Array
    odds: Array
    family: str = field(default=MEASUREMENT, init=False)
    surface: None = field(default=None, init=False)


@dataclass(frozen=True, eq=False)
class PositionsHypotheses:
    """All hypotheses as one table; evidence and posterior weights are arrays (n, n_draws) of its rows.

    The rows are "none", coefficients that are off together, something that no effect explains, each
    spread and each shift with each of its sizes, and, where something may be ``unknown``, each shift
    once more with it beside. ``off`` is the probability of coefficients that are off together.
    """

    shifts: Sequence[ShiftHypothesis]
    spreads: Sequence[SpreadHypothesis]
    off: float
    unknown: bool = True

    def by_row(self, attribute: str) -> list[Any]:
        """Return "effect", "family" or "surface" of each row; the first three have no surface."""
        groups: list[Any] = [*self.spreads, *self.shifts]
        groups += self.shifts if self.unknown else ()
        first = [None] * 3 if attribute == "surface" else [NONE, COEFFICIENTS, UNKNOWN]
        return [*first, *(getattr(group, attribute) for group in groups for _ in group.odds)]

    def of_groups(self, values: Array) -> tuple[list[Array], list[Array], list[Array]]:
        """Return the rows of each spread, of each shift, and of each shift with "unknown" beside."""
        n = len(self.spreads)
        groups: list[Any] = [*self.spreads, *self.shifts, *self.shifts]
        ends = 3 + np.cumsum([0, *(len(group.odds) for group in groups)])
        rows = [values[first:end] for first, end in pairwise(ends)]
        return rows[:n], rows[n : n + len(self.shifts)], rows[n + len(self.shifts) :]

    @cached_property
    def log_prior(self) -> Array:
        """Log prior probability of each row, (n,); those of all rows but the first two sum to 1 - p.

        p is that of no effect. "none" has the rest of it beside coefficients that are off together.
        """
        of_shifts, of_spreads = (
            np.concatenate([np.zeros(0), *(group.odds for group in groups)])
            for groups in (self.shifts, self.spreads)
        )
        unknown = ODDS[UNKNOWN] if self.unknown else 0.0
        total, of_effects = unknown + of_spreads.sum() + of_shifts.sum(), of_shifts.sum()
        # Over all effects that nothing explains everything is as probable as something unknown alone,
        # but no more than a half.
        beside = min(unknown / of_effects, 0.5) if of_effects > 0 else 0.0
        both = [(1 - beside) * of_shifts, *([beside * of_shifts] if self.unknown else [])]
        odds = np.concatenate([[unknown], of_spreads, *both])
        off = max(self.off, 1e-300)
        nothing = NO_EFFECT * np.array([1 - off, off])
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.concatenate([nothing, (1 - NO_EFFECT) * odds / total])))


def interpolation(nodes: Sequence[float], at: Array) -> Array:
    """Return the nodes' weights (..., n_nodes) in a linear interpolation that is 0 at 0.

    Beyond the nodes the value at the last one is taken.
    """
    every = np.array(sorted([*nodes, 0.0]))
    position = np.clip(at, every[0], every[-1])
    right = np.clip(np.searchsorted(every, position), 1, len(every) - 1)
    share = (position - every[right - 1]) / (every[right] - every[right - 1])
    out = np.zeros((*np.shape(at), len(every)))
    np.put_along_axis(out, right[..., np.newaxis], share[..., np.newaxis], -1)
    np.put_along_axis(out, right[..., np.newaxis] - 1, (1 - share)[..., np.newaxis], -1)
    return np.asarray(out[..., np.searchsorted(every, nodes)])


def towards(moved: Array, stated: Array) -> Array:
    """Return the weights of `SHARES` for changes of alpha (..., n_bands), (..., n_bands, n_nodes).

    A change is a share of the way to 1, or (below 0) to a hard wall.
    """
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
    """Return the weights of a mean change of the absorption, (n_parameters n_pairs,)."""
    return np.repeat(_signs(parameters), n_pairs) / (len(parameters) * n_pairs)


def _signs(parameters: Sequence[str]) -> Array:
    """Return whether each parameter's linear scale rises or falls with the absorption, 1 or -1."""
    return np.array([1.0 if observable(name).rises else -1.0 for name in parameters])


def uneven_columns(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the deviations at a change of 1, (n_parameters n_pairs, n_columns)."""
    signs, groups = _signs(parameters), [observable(name).part for name in parameters]

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


def _anywhere(**of: Any) -> ShiftHypothesis:
    """Return what stands on no surface: it has no spectrum, and no place that is not known."""
    n = len(of["sizes"])
    return ShiftHypothesis(**of, spectra=np.zeros((n, 0)), uneven=np.zeros(n))


def materials(case: PositionsCase) -> list[ShiftHypothesis]:
    """Return each material's coefficients off by a factor.

    Its surfaces then hear what an absorber on all of them would do, with the material's own spectrum.
    """
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
            _anywhere(
                effect=COEFFICIENTS,
                family=COEFFICIENTS,
                place=room.materials[row],
                response=f"material {row}",
                weights=np.tile(towards(moved, alpha), (1, 1, len(members))),
                odds=density / density.sum() * absorbed[row] / absorbed.sum() * odds,
                sizes=factors,
                unit="of what is stated",
                parameters=[{"factor": float(factor)} for factor in factors],
                error=0.1**2 + 0.15**2 * over_bands,
            )
        )
    return made


def stated_room(case: PositionsCase) -> RoomState:
    """Return the room as it is stated; which way its materials face changes no whole-room effect."""
    return RoomState.of_room(case.room, np.full((case.room.n_materials, 3), 1 / 3))


def _whole(
    effect: Effect,
    nodes: Sequence[float],
    at: Array,
    grid: Sequence[Parameters],
    odds: Array,
    sizes: Array,
    error: Array,
) -> ShiftHypothesis:
    """Return an effect of the whole room, whose response has the effect's name."""
    return _anywhere(
        effect=effect.name,
        family=effect.family,
        response=effect.name,
        weights=interpolation(nodes, at),
        odds=odds * ODDS[effect.name] / odds.sum(),
        sizes=sizes,
        unit=effect.unit,
        parameters=grid,
        error=error,
    )


def air(case: PositionsCase) -> ShiftHypothesis:
    """Return other climates, or air where none is stated."""
    effect, room, stated = OmittedAir(), case.room, stated_room(case)
    f = room.centre_frequencies
    grid = effect.grid(stated)
    attenuation = np.array([state.air for state in effect.changes(stated, grid)])
    more = (attenuation - room.air_attenuation) / Air(20, 50).attenuation(f)
    odds = grid_weights(effect, grid, stated) * effect.prior_odds(room)
    sizes = np.array([p["humidity"] for p in grid])
    return _whole(effect, AIR, more, grid, odds, sizes, effect.error_over_bands(f))


def volume(case: PositionsCase) -> ShiftHypothesis:
    """Return other volumes, the geometry scaled."""
    effect, n_bands, stated = WrongVolume(), case.room.n_bands, stated_room(case)
    # A geometry that is traced has no gross mistake in its volume.
    grid = effect.near(stated)
    logs = np.log([p["ratio"] for p in grid])
    at = np.repeat(logs[:, np.newaxis], n_bands, axis=1)
    error = 0.02**2 * (1 + np.eye(n_bands))
    odds = grid_weights(effect, grid, stated)
    return _whole(effect, VOLUME, at, grid, odds, np.exp(logs), error)


COUPLED = CoupledRoom()
LEAST = 0.05
"""Least area that is tried, over the room's absorption area at 500 to 2000 Hz."""
RATIO = 28.0 ** (1 / 13)
"""Of an area that is tried to the one before it. The last is the largest that the surface holds."""
WHOLE = {"air": air, "volume": volume}
"""Effects of the whole room that change what is traced, by name."""
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
    out = [each for effect in on_surfaces([*tried.values()]) for each in _covering(case, effect)]
    out += _apertures(case) if COUPLED.name in tried else []
    out += materials(case) if COEFFICIENTS not in without else []
    return out + [make(case) for name, make in WHOLE.items() if name in tried]


def _covering(case: PositionsCase, effect: Effect) -> list[ShiftHypothesis]:
    """Return an effect on each surface that can have it."""
    frequencies, areas = case.room.centre_frequencies, np.array(list(case.areas.values()))
    possible = np.array([k in effect.stands_on for k in case.kinds])
    spectra = effect.on_surface(frequencies)
    middle = middle_absorption(stated_room(case))
    covers = bool(effect.shares)
    made = []
    for j in np.flatnonzero(possible):
        stated = case.surface_alpha[j]
        tried = np.array(effect.shares) * areas[j] if covers else areas_tried(middle, areas[j])
        every = [  # change of alpha, spectrum and parameters of each
            (area / areas[j] * (spectrum - stated), spectrum, {**settings, "area": float(area)})
            for settings, spectrum in spectra
            for area in tried
        ]
        if covers:
            every = [(np.minimum(moved, 0.0), *rest) for moved, *rest in every]
            least = _LEAST_TAKEN * np.maximum(stated, 1e-6)
            every = [each for each in every if (-each[0] >= least).any()]
        if not every:
            continue
        moved, alpha, parameters = zip(*every, strict=True)
        used = np.array([p["area"] for p in parameters])
        fitting = [areas[possible & (areas >= (0 if covers else area))].sum() for area in used]
        made.append(
            ShiftHypothesis(
                effect=effect.name,
                family=effect.family,
                surface=int(j),
                response=f"surface {j}",
                weights=towards(np.array(moved), stated),
                odds=areas[j] / np.array(fitting) / len(spectra),
                sizes=used,
                unit="m²",
                parameters=parameters,
                spectra=np.array(alpha),
                error=effect.error_over_bands(frequencies),
                uneven=unevenness(used / areas[j]),
                size_error=effect.size_error,
                divisible=not covers,
            )
        )
    return _normalised(made, effect.prior_odds(case.room))


def _normalised(shifts: Sequence[ShiftHypothesis], odds: float) -> list[ShiftHypothesis]:
    """Return an effect's hypotheses with odds whose sum is the effect's."""
    total = sum(s.odds.sum() for s in shifts)
    return [replace(s, odds=s.odds * odds / total) for s in shifts]


def _apertures(case: PositionsCase) -> list[ShiftHypothesis]:
    """Return an aperture to a second room on each wall and ceiling."""
    room, areas = case.room, np.array(list(case.areas.values()))
    middle, n_bands, n_rooms = (
        middle_absorption(stated_room(case)),
        room.n_bands,
        len(SECOND_ROOMS),
    )
    possible = np.array([k in COUPLED.stands_on for k in case.kinds])
    made = []
    for j in np.flatnonzero(possible):
        area = areas_tried(middle, areas[j])
        if not len(area):
            continue
        share = interpolation(OPEN, np.repeat(area[:, np.newaxis] / areas[j], n_bands, axis=1))
        odds = areas[j] / np.array([areas[possible & (areas >= a)].sum() for a in area])
        sizes = np.tile(area, n_rooms)
        made.append(
            ShiftHypothesis(
                effect=COUPLED.name,
                family=COUPLED.family,
                surface=int(j),
                response=f"aperture {j}",
                weights=np.vstack([np.kron(row, share) for row in np.eye(n_rooms)]),
                odds=np.tile(odds, n_rooms),
                sizes=sizes,
                unit=COUPLED.unit,
                parameters=[
                    {"aperture": float(a), "volume": volume * room.volume, "alpha": alpha}
                    for volume, alpha in SECOND_ROOMS
                    for a in area
                ],
                spectra=np.ones((len(sizes), n_bands)),
                error=COUPLED.error_over_bands(room.centre_frequencies),
                uneven=unevenness(sizes / areas[j]),
                size_error=COUPLED.size_error,
            )
        )
    return _normalised(made, COUPLED.odds)


def on_parts(case: PositionsCase, shifts: Sequence[ShiftHypothesis]) -> list[ShiftHypothesis]:
    """Return the hypotheses with those of each part beside those of its surface.

    `LOCATED` of the odds of a size go to the parts that hold it. The others stay with what is spread
    over the surface. So the odds of a surface do not depend on the number of its parts. What covers a
    stated absorber is a share of the whole surface, and has no parts; nor has an aperture.
    """
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
    """Return the hypotheses of the measurement.

    Parameters
    ----------
    measured : sequence of (source, receiver)
    moved : mapping of str to array (n_parameters, n_pairs, n_bands, n_displacements)
        Shifts of the measured parameters where a source or receiver is displaced; see `PairShifts`.
    errors : array (n_bands, n_parameters, n_pairs, same three)
        Covariance of the errors of simulator and measurement.
    """
    shape = errors.shape[:3]
    number = np.arange(math.prod(shape)).reshape(shape)
    full = errors.reshape(number.size, number.size)
    out = []
    for place, shift in moved.items():
        pairs = np.flatnonzero(np.abs(shift).max(axis=(0, 2, 3)))
        if not len(pairs):
            continue
        rows = number[:, :, pairs].ravel()
        # The displacements along an axis and back have nearly opposite shifts: three free directions.
        columns = np.moveaxis(shift[:, pairs], 2, 0).reshape(len(rows), -1) / np.sqrt(6)
        odds = np.full(len(DISPLACEMENTS), ODDS[POSITION] / (len(moved) * len(DISPLACEMENTS)))
        scales = DISPLACEMENTS / MOVE
        out.append(
            SpreadHypothesis(POSITION, place, DISPLACEMENTS, "m", rows, columns, scales, odds)
        )
    for i, pair in enumerate(measured):
        rows = number[:, :, i].ravel()
        root = np.asarray(np.linalg.cholesky(full[np.ix_(rows, rows)]))
        odds = np.full(len(NOISES), ODDS[NOISE] / (len(measured) * len(NOISES)))
        scales = np.sqrt(NOISES**2 - 1)
        name = " to ".join(pair)
        out.append(
            SpreadHypothesis(NOISE, name, NOISES, "times as uncertain", rows, root, scales, odds)
        )
    return out
