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
from dataclasses import dataclass, replace
from functools import cached_property

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
from rtcal.finder.evidence import Label
from rtcal.finder.model import RoomState
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.surfaces import Part
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


@dataclass(frozen=True, eq=False)
class PositionsHypotheses:
    """All hypotheses as one table; evidence and posterior weights are arrays (n, n_draws) of its rows.

    The rows are "none", coefficients that are off together, something that no effect explains, each
    spread, each shift with each of its sizes, and, where something may be ``unknown``, each of these
    once more with it beside. ``off`` is the probability of coefficients that are off together.
    """

    shifts: Sequence[ShiftHypothesis]
    spreads: Sequence[SpreadHypothesis]
    off: float
    unknown: bool = True

    @cached_property
    def effects(self) -> list[str]:
        """The effect of each row."""
        of_spreads, of_shifts = [s.effect for s in self.spreads], [s.effect for s in self.shifts]
        return self._by_row((NONE, COEFFICIENTS, UNKNOWN), of_spreads, of_shifts)

    @cached_property
    def families(self) -> list[str]:
        """The family of each row."""
        of_spreads, of_shifts = [MEASUREMENT] * len(self.spreads), [s.family for s in self.shifts]
        return self._by_row((NONE, COEFFICIENTS, UNKNOWN), of_spreads, of_shifts)

    @cached_property
    def surfaces(self) -> list[int]:
        """The number of the surface of each row; -1 where it is of none."""
        of_shifts = [-1 if s.surface is None else s.surface for s in self.shifts]
        return self._by_row((-1, -1, -1), [-1] * len(self.spreads), of_shifts)

    def _by_row(
        self, first: Sequence[Label], of_spreads: Sequence[Label], of_shifts: Sequence[Label]
    ) -> list[Label]:
        sizes = zip(of_shifts, self.shifts, strict=True)
        each = [label for label, shift in sizes for _ in shift.odds]
        return [*first, *of_spreads, *each, *(each if self.unknown else ())]

    def of_shifts(self, values: Array) -> tuple[Array, Array]:
        """Return the rows of the shifts, and those of the shifts with something unknown beside."""
        first = 3 + len(self.spreads)
        second = first + sum(len(s.odds) for s in self.shifts)
        return values[first:second], values[second:]

    @cached_property
    def log_prior(self) -> Array:
        """Log prior probability of each row, (n,); those of all rows but the first two sum to 1 - p.

        p is that of no effect. "none" has the rest of it beside coefficients that are off together.
        """
        of_shifts = np.concatenate([np.zeros(0), *(s.odds for s in self.shifts)])
        of_spreads = [s.odds for s in self.spreads]
        unknown = ODDS[UNKNOWN] if self.unknown else 0.0
        total, of_effects = unknown + sum(of_spreads) + of_shifts.sum(), of_shifts.sum()
        # Over all effects that nothing explains everything is as probable as something unknown alone,
        # but no more than a half.
        beside = min(unknown / of_effects, 0.5) if of_effects > 0 else 0.0
        both = [(1 - beside) * of_shifts, *([beside * of_shifts] if self.unknown else [])]
        odds = np.concatenate([[unknown], of_spreads, *both])
        off = max(self.off, 1e-300)
        nothing = NO_EFFECT * np.array([1 - off, off])
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.concatenate([nothing, (1 - NO_EFFECT) * odds / total])))


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


@dataclass(frozen=True, eq=False)
class ShiftHypothesis:
    """Hypotheses of one effect in one place, with their sizes.

    Attributes
    ----------
    effect, family : str
    surface : int or None
        Number of the surface; None for the whole room.
    response : str
        Which of the responses is interpolated.
    weights : array (n_hypotheses, n_bands, n_nodes)
        Shift of band k is weights[:, k] @ the response's nodes of band k.
    odds : array (n_hypotheses,)
        Prior odds of each within its effect; over all surfaces they are normalised to 1.
    sizes : array (n_hypotheses,)
    unit : str
    parameters : sequence of mapping
    spectra : array (n_hypotheses, n_bands)
        Alpha of what stands on the surface; empty for the whole room.
    error : array (n_bands, n_bands)
        Covariance of the relative error of the change, band by band.
    uneven : array (n_hypotheses,)
        How far pairs may hear more or less of it; see `rtcal.finder.positions.hypotheses`.
    size_error : float
        Standard deviation of ln size that the effect's description leaves open.
    place : str
        The material whose coefficients are off.
    part : int or None
        Number of the part of the surface; None for all of it.
    divisible : bool
        Whether it may stand on a part of its surface alone.
    """

    effect: str
    family: str
    surface: int | None
    response: str
    weights: Array
    odds: Array
    sizes: Array
    unit: str
    parameters: Sequence[Parameters]
    spectra: Array
    error: Array
    uneven: Array
    size_error: float = 0.0
    place: str = ""
    part: int | None = None
    divisible: bool = False

    def some(self, which: slice) -> ShiftHypothesis:
        """Return some of the hypotheses."""
        return replace(
            self,
            weights=self.weights[which],
            odds=self.odds[which],
            sizes=self.sizes[which],
            parameters=self.parameters[which],
            spectra=self.spectra[which],
            uneven=self.uneven[which],
        )


@dataclass(frozen=True, eq=False)
class SpreadHypothesis:
    """A hypothesis that some values err by more: their covariance grows by ``columns columns'``.

    ``rows`` are the values' numbers in the order (band, parameter, pair), ``columns`` (n_rows,
    n_errors) are their errors, one standard deviation each. ``place`` names the source, receiver or
    pair.
    """

    effect: str
    place: str
    size: float
    unit: str
    rows: NDArray[np.int64]
    columns: Array
    odds: float


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
    kept = [int(np.flatnonzero(every == node)[0]) for node in nodes]
    return np.asarray(out[..., kept])


def towards(moved: Array, stated: Array) -> Array:
    """Return changes of alpha as shares of the way to 1, or (below 0) to a hard wall; see `SHARES`."""
    up = moved / np.maximum(1 - stated, 1e-6)
    down = moved / np.maximum(stated - HARD, 1e-6)
    return np.asarray(np.where(moved >= 0, up, np.maximum(down, -1.0)))


LEAST_COVERED = 1 / 9
"""Least part of a surface for which the shares were found; smaller ones have its error."""


COMMON_UNEVENNESS = {"late": 0.05, "early": 0.06, "level": 0.14}
"""Relative deviation that all pairs share, by `Observable.part`. That of T and of the early parameters
is the same one."""


OWN_UNEVENNESS = {"late": 0.06, "early": 0.06, "level": 0.24}
"""Relative deviation of each pair: one for T, one for all early parameters, one for the level."""


def sign(parameter: str) -> float:
    """Return whether a parameter's linear scale rises or falls with the absorption."""
    return 1.0 if observable(parameter).rises else -1.0


def uneven_amount(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the weights of a mean change of the absorption, (n_parameters n_pairs,)."""
    signs = np.array([sign(name) for name in parameters])
    return np.repeat(signs, n_pairs) / (len(parameters) * n_pairs)


def uneven_columns(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the deviations at a change of 1, (n_parameters n_pairs, n_columns)."""
    signs = np.array([sign(name) for name in parameters])
    groups = [observable(name).part for name in parameters]
    out = []
    for shared in (("late", "early"), ("level",)):
        row = [COMMON_UNEVENNESS[g] if g in shared else 0.0 for g in groups]
        out.append(np.repeat(signs * row, n_pairs))
    for group in OWN_UNEVENNESS:
        own = np.array([OWN_UNEVENNESS[g] if g == group else 0.0 for g in groups])
        for pair in np.eye(n_pairs):
            out.append(np.outer(signs * own, pair).ravel())
    every = np.array(out).T
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
    """Return each material's coefficients off by a factor.

    Its surfaces then hear what an absorber on all of them would do, with the material's own spectrum.
    """
    room = case.room
    made_of = room.material_rows(case.geometry.materials)
    over_bands = bands.correlation(room.centre_frequencies, 0.7)
    density = np.exp(-np.abs(FACTORS) / FACTOR_SCALE)
    # Who states a small sigma knows the coefficients from a measurement (`probability_off`).
    odds = ODDS[COEFFICIENTS] * relative_sigma(room) ** 2
    absorbed = room.areas * room.alpha.mean(axis=1)
    made = []
    for row, material in enumerate(room.materials):
        members = [
            j for j, faces in enumerate(case.faces.values()) if (made_of[faces] == row).all()
        ]
        if not members:
            continue
        alpha = room.alpha[row]
        moved = np.minimum(np.exp(FACTORS)[:, np.newaxis] * alpha, 1.0) - alpha
        every = interpolation(SHARES, towards(moved, alpha))
        made.append(
            ShiftHypothesis(
                effect=COEFFICIENTS,
                family=COEFFICIENTS,
                surface=None,
                response=f"material {row}",
                weights=np.tile(every, (1, 1, len(members))),
                odds=density / density.sum() * absorbed[row] / absorbed.sum() * odds,
                sizes=np.exp(FACTORS),
                unit="of what is stated",
                parameters=[{"factor": float(np.exp(f))} for f in FACTORS],
                spectra=np.zeros((len(FACTORS), 0)),
                error=0.1**2 + 0.15**2 * over_bands,
                uneven=np.zeros(len(FACTORS)),
                place=material,
            )
        )
    return made


def _whole(
    effect: Effect,
    at: Array,
    nodes: Sequence[float],
    *,
    odds: Array,
    sizes: Array,
    parameters: Sequence[Parameters],
    error: Array,
) -> ShiftHypothesis:
    """Return an effect of the whole room, whose response has the effect's name."""
    return ShiftHypothesis(
        effect=effect.name,
        family=effect.family,
        surface=None,
        response=effect.name,
        weights=interpolation(nodes, at),
        odds=odds * ODDS[effect.name] / odds.sum(),
        sizes=sizes,
        unit=effect.unit,
        parameters=parameters,
        spectra=np.zeros((len(sizes), 0)),
        error=error,
        uneven=np.zeros(len(sizes)),
    )


def stated_room(case: PositionsCase) -> RoomState:
    """Return the room as it is stated; which way its materials face changes no whole-room effect."""
    return RoomState.of_room(case.room, np.full((case.room.n_materials, 3), 1 / 3))


def air(case: PositionsCase) -> ShiftHypothesis:
    """Return other climates, or air where none is stated."""
    effect, room = OmittedAir(), case.room
    f = room.centre_frequencies
    reference = Air(20, 50).attenuation(f)
    stated = stated_room(case)
    grid = effect.grid(stated)
    attenuation = np.array([state.air for state in effect.changes(stated, grid)])
    density = grid_weights(effect, grid, stated)
    return _whole(
        effect,
        (attenuation - room.air_attenuation) / reference,
        AIR,
        odds=density * effect.prior_odds(room),
        sizes=np.array([p["humidity"] for p in grid]),
        parameters=grid,
        error=effect.error_over_bands(f),
    )


def volume(case: PositionsCase) -> ShiftHypothesis:
    """Return other volumes, the geometry scaled."""
    effect, n_bands = WrongVolume(), case.room.n_bands
    stated = stated_room(case)
    # A geometry that is traced has no gross mistake in its volume.
    grid = effect.near(stated)
    logs = np.log([p["ratio"] for p in grid])
    density = grid_weights(effect, grid, stated)
    return _whole(
        effect,
        np.repeat(logs[:, np.newaxis], n_bands, axis=1),
        VOLUME,
        odds=density,
        sizes=np.exp(logs),
        parameters=grid,
        error=np.full((n_bands, n_bands), 0.02**2) + 0.02**2 * np.eye(n_bands),
    )


COUPLED = CoupledRoom()
LEAST = 0.05
"""Least area that is tried, over the room's absorption area at 500 to 2000 Hz."""
RATIO = 28.0 ** (1 / 13)
"""Of an area that is tried to the one before it. The last is the largest that the surface holds."""
WHOLE = {"air": air, "volume": volume}
"""Effects of the whole room that change what is traced, by name."""
DISPLACEMENTS = (0.5, 1.0, 2.0)
"""Distances in m by which a source or receiver may stand elsewhere."""
NOISES = (3.0, 10.0)
"""Factors of the standard deviation of a pair whose measurement failed."""
LOCATED = 0.5
"""Prior probability that something which fits on a part of its surface stands on one alone."""


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
    out: list[ShiftHypothesis] = []
    tried = [effect for effect in effects if effect.name not in without]
    for effect in on_surfaces(tried):
        out += _on_surfaces(case, effect)
    if COUPLED.name in [effect.name for effect in tried]:
        out += _apertures(case)
    out += materials(case) if COEFFICIENTS not in without else []
    whole = [make(case) for name, make in WHOLE.items() if name in [e.name for e in tried]]
    return [*out, *whole]


def _on_surfaces(case: PositionsCase, effect: Effect) -> list[ShiftHypothesis]:
    """Return an effect on each surface that can have it."""
    frequencies, areas = case.room.centre_frequencies, np.array(list(case.areas.values()))
    stated = case.surface_alpha
    possible = np.array([k in effect.stands_on for k in case.kinds])
    spectra = effect.on_surface(frequencies)
    middle = middle_absorption(stated_room(case))
    covering = bool(effect.shares)
    made = []
    for j in np.flatnonzero(possible):
        changes, odds, used, parameters, alpha = [], [], [], [], []
        tried = np.array(effect.shares) * areas[j] if covering else areas_tried(middle, areas[j])
        for settings, spectrum in spectra:
            for area in tried:
                moved = area / areas[j] * (spectrum - stated[j])
                if covering:
                    moved = np.minimum(moved, 0.0)
                    if (-moved / np.maximum(stated[j], 1e-6)).max() < _LEAST_TAKEN:
                        continue
                changes.append(moved)
                fitting = areas[possible & (areas >= (0 if covering else area))]
                odds.append(areas[j] / fitting.sum() / len(spectra))
                used.append(area)
                parameters.append({**settings, "area": float(area)})
                alpha.append(spectrum)
        if changes:
            made.append(
                ShiftHypothesis(
                    effect=effect.name,
                    family=effect.family,
                    surface=int(j),
                    response=f"surface {j}",
                    weights=interpolation(SHARES, towards(np.array(changes), stated[j])),
                    odds=np.array(odds),
                    sizes=np.array(used),
                    unit="m²",
                    parameters=parameters,
                    spectra=np.array(alpha),
                    error=effect.error_over_bands(frequencies),
                    uneven=unevenness(np.array(used) / areas[j]),
                    size_error=effect.size_error,
                    divisible=not covering,
                )
            )
    return _normalised(made, effect.prior_odds(case.room))


def _normalised(shifts: Sequence[ShiftHypothesis], odds: float) -> list[ShiftHypothesis]:
    """Return an effect's hypotheses with odds whose sum is the effect's."""
    total = sum(s.odds.sum() for s in shifts)
    return [replace(s, odds=s.odds * odds / total) for s in shifts]


_LEAST_TAKEN = 0.1
"""A cover that takes less than this share of a surface's absorption is no hypothesis."""


def _apertures(case: PositionsCase) -> list[ShiftHypothesis]:
    """Return an aperture to a second room on each wall and ceiling."""
    room, areas = case.room, np.array(list(case.areas.values()))
    middle, n_bands = middle_absorption(stated_room(case)), case.room.n_bands
    possible = np.array([k in COUPLED.stands_on for k in case.kinds])
    made = []
    for j in np.flatnonzero(possible):
        area = areas_tried(middle, areas[j])
        if not len(area):
            continue
        share = interpolation(OPEN, np.repeat(area[:, np.newaxis] / areas[j], n_bands, axis=1))
        weights = np.zeros((len(SECOND_ROOMS), len(area), n_bands, len(SECOND_ROOMS), len(OPEN)))
        for n in range(len(SECOND_ROOMS)):
            weights[n, :, :, n] = share
        odds = areas[j] / np.array([areas[possible & (areas >= a)].sum() for a in area])
        made.append(
            ShiftHypothesis(
                effect=COUPLED.name,
                family=COUPLED.family,
                surface=int(j),
                response=f"aperture {j}",
                weights=weights.reshape(len(SECOND_ROOMS) * len(area), n_bands, -1),
                odds=np.tile(odds, len(SECOND_ROOMS)),
                sizes=np.tile(area, len(SECOND_ROOMS)),
                unit=COUPLED.unit,
                parameters=[
                    {"aperture": float(a), "volume": volume * room.volume, "alpha": alpha}
                    for volume, alpha in SECOND_ROOMS
                    for a in area
                ],
                spectra=np.ones((len(SECOND_ROOMS) * len(area), n_bands)),
                error=COUPLED.error_over_bands(room.centre_frequencies),
                uneven=np.tile(unevenness(area / areas[j]), len(SECOND_ROOMS)),
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
    stated, every = case.surface_alpha, list(enumerate(case.divided.parts))
    out = []
    for shift in shifts:
        own = [(p, part) for p, part in every if part.surface == shift.surface]
        if not own or not shift.divisible:
            out.append(shift)
            continue
        holds = np.array([shift.sizes <= part.area for _, part in own])
        number = holds.sum(axis=0)
        out.append(replace(shift, odds=np.where(number > 0, 1 - LOCATED, 1.0) * shift.odds))
        for (p, part), rows in zip(own, holds, strict=True):
            if rows.any():
                out.append(_on_part(shift, p, part, stated[part.surface], rows, number))
    return out


def _on_part(
    shift: ShiftHypothesis,
    p: int,
    part: Part,
    stated: Array,
    rows: NDArray[np.bool_],
    number: Array,
) -> ShiftHypothesis:
    spectra = shift.spectra[rows]
    moved = shift.sizes[rows, np.newaxis] / part.area * (spectra - stated)
    return replace(
        shift,
        part=p,
        response=f"part {p}",
        weights=interpolation(SHARES, towards(moved, stated)),
        odds=LOCATED * shift.odds[rows] / number[rows],
        sizes=shift.sizes[rows],
        parameters=[q for q, holds in zip(shift.parameters, rows, strict=True) if holds],
        spectra=spectra,
        uneven=unevenness(shift.sizes[rows] / part.area),
    )


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
    n_bands, n_parameters, n_pairs = errors.shape[:3]
    number = np.arange(n_bands * n_parameters * n_pairs).reshape(errors.shape[:3])
    full = errors.reshape(number.size, number.size)
    out = []
    for place, shift in moved.items():
        pairs = np.flatnonzero(np.abs(shift).max(axis=(0, 2, 3)))
        if not len(pairs):
            continue
        rows = number[:, :, pairs].ravel()
        steps = np.moveaxis(shift[:, pairs], 2, 0).reshape(len(rows), -1)
        # The displacements along an axis and back have nearly opposite shifts: three free directions.
        columns = steps / np.sqrt(6)
        for distance in DISPLACEMENTS:
            odds = ODDS[POSITION] / (len(moved) * len(DISPLACEMENTS))
            scaled = distance / MOVE * columns
            out.append(SpreadHypothesis(POSITION, place, distance, "m", rows, scaled, odds))
    for i, pair in enumerate(measured):
        rows = number[:, :, i].ravel()
        root = np.linalg.cholesky(full[np.ix_(rows, rows)])
        for factor in NOISES:
            odds = ODDS[NOISE] / (n_pairs * len(NOISES))
            scaled = np.sqrt(factor**2 - 1) * root
            name = " to ".join(pair)
            out.append(
                SpreadHypothesis(NOISE, name, factor, "times as uncertain", rows, scaled, odds)
            )
    return out
