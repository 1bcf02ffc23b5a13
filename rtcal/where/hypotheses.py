"""What may be other than stated, and where: effect and surface, the whole room, or the measurement.

A hypothesis of the room shifts the parameters at every pair: `Shift`. One of the measurement widens the
errors of some pairs: `Spread`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.discrepancy.effects.air import OmittedAir
from rtcal.discrepancy.effects.audience import SEATED_ALPHA, Audience
from rtcal.discrepancy.effects.base import Absorber, Effect, Parameters, interpolate_octaves
from rtcal.discrepancy.effects.coupled_room import CoupledRoom
from rtcal.discrepancy.effects.covered import HARD, CoveredSurface
from rtcal.discrepancy.effects.curtain import Curtain
from rtcal.discrepancy.effects.membrane import Membrane
from rtcal.discrepancy.effects.opening import Opening
from rtcal.discrepancy.effects.porous import Porous
from rtcal.discrepancy.effects.resonator import Resonator
from rtcal.discrepancy.effects.stated import WrongVolume
from rtcal.discrepancy.hypotheses import spectrum_errors
from rtcal.discrepancy.prior import COEFFICIENTS, grid_weights
from rtcal.loop.measured_pairs import Pair
from rtcal.support.types import Array
from rtcal.where import unevenness
from rtcal.where.aperture import SECOND_ROOMS
from rtcal.where.case import Case
from rtcal.where.responses import AIR, MOVE, OPEN, SHARES, VOLUME
from rtcal.where.surfaces import kind

COUPLED = CoupledRoom()
POSITION, NOISE, SCATTERING, UNKNOWN = "position", "noise", "scattering", "unknown"
MEASUREMENT = "measurement"
SIZES = tuple(np.geomspace(0.05, 1.4, 14))
"""Areas that are tried, over the room's absorption area at 500 to 2000 Hz."""
ODDS = {
    POSITION: 0.5,
    NOISE: 0.5,
    SCATTERING: 0.3,
    UNKNOWN: 0.5,
    "air": 1.0,
    "volume": 1.0,
    COEFFICIENTS: 1.0,
}
"""Prior odds against an effect of odds 1; those of the absorbers are their classes'."""
FACTORS = np.array([-1.2, -0.9, -0.65, -0.45, -0.3, 0.3, 0.45, 0.65, 0.9, 1.2])
"""ln of the factors by which one material's coefficients may be off."""
FACTOR_SCALE = 0.35
"""Mean size of that logarithm. Carpets, plasters and glass of one name differ by 20 to 60 % between
tables, and now and then by a factor of three."""
DISPLACEMENTS = (0.5, 1.0, 2.0)
"""Distances in m by which a source or receiver may stand elsewhere."""
NOISES = (3.0, 10.0)
"""Factors of the standard deviation of a pair whose measurement failed."""


@dataclass(frozen=True, eq=False)
class Shift:
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
        How far pairs may hear more or less of it; see `rtcal.where.unevenness.factor`.
    size_error : float
        Standard deviation of ln size that the effect's description leaves open.
    place : str
        The material whose coefficients are off.
    part : int or None
        Number of the part of the surface; None for all of it.
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

    def some(self, which: slice) -> Shift:
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
class Spread:
    """A hypothesis that some values err by more: their covariance grows by ``covariance``.

    ``rows`` are the values' numbers in the order (band, parameter, pair). ``place`` names the
    source, receiver or pair.
    """

    effect: str
    place: str
    size: float
    unit: str
    rows: NDArray[np.int64]
    covariance: Array
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


def library() -> tuple[Effect, ...]:
    """Return the effects that stand on a surface."""
    return (
        Opening(),
        Porous(),
        Curtain(),
        Resonator(),
        Membrane(),
        Audience(),
        CoveredSurface(),
    )


def error_over_bands(effect: Effect, frequencies: Array) -> Array:
    """Return the covariance of the relative error of an effect's change, (n_bands, n_bands)."""
    factor = spectrum_errors(effect, frequencies)
    return np.asarray(factor @ factor.T)


def surface_alpha(case: Case) -> Array:
    """Return the mean alpha of each surface, (n_surfaces, n_bands)."""
    rows = np.array([case.room.material_index(m) for m in case.geometry.materials])
    areas = case.geometry.face_areas
    return np.array(
        [
            np.average(case.room.alpha[rows[f]], axis=0, weights=areas[f])
            for f in case.faces.values()
        ]
    )


def shifts(case: Case, without: Sequence[str] = ()) -> list[Shift]:
    """Return the hypotheses of the room, but for some effects."""
    out: list[Shift] = []
    for effect in library():
        if effect.name not in without:
            out += _on_surfaces(case, effect)
    if COUPLED.name not in without:
        out += _apertures(case)
    out += _materials(case) if COEFFICIENTS not in without else []
    whole = [_air(case), _volume(case), _scattering(case)]
    return out + [shift for shift in whole if shift.effect not in without]


def _on_surfaces(case: Case, effect: Effect) -> list[Shift]:
    """Return an effect on each surface that can have it."""
    frequencies, areas = case.room.centre_frequencies, np.array(list(case.areas.values()))
    stated = surface_alpha(case)
    kinds = [kind(case.geometry, f) for f in case.faces.values()]
    possible = np.array([_may_have(effect, k) for k in kinds])
    spectra = _spectra(effect, frequencies)
    middle = _middle_absorption(case)
    covering = isinstance(effect, CoveredSurface)
    sizes = np.array(CoveredSurface.SHARES if covering else SIZES)
    made = []
    for j in np.flatnonzero(possible):
        weights, odds, used, parameters, alpha = [], [], [], [], []
        for settings, spectrum in spectra:
            for size in sizes:
                area = size * areas[j] if covering else size * middle
                share = min(area / areas[j], 1.0)
                if not covering and area > areas[j]:
                    continue
                moved = share * (spectrum - stated[j])
                if covering:
                    moved = np.minimum(moved, 0.0)
                    if (-moved / np.maximum(stated[j], 1e-6)).max() < _LEAST_COVERED:
                        continue
                weights.append(interpolation(SHARES, towards(moved, stated[j])))
                fitting = areas[possible & (areas >= (0 if covering else area))]
                odds.append(areas[j] / fitting.sum() / (len(spectra) * len(sizes)))
                used.append(area)
                parameters.append({**settings, "area": float(area)})
                alpha.append(spectrum)
        if weights:
            made.append(
                Shift(
                    effect=effect.name,
                    family=effect.family,
                    surface=int(j),
                    response=f"surface {j}",
                    weights=np.array(weights),
                    odds=np.array(odds),
                    sizes=np.array(used),
                    unit="m²",
                    parameters=parameters,
                    spectra=np.array(alpha),
                    error=error_over_bands(effect, frequencies),
                    uneven=unevenness.factor(np.array(used) / areas[j]),
                    size_error=effect.size_error,
                )
            )
    return _normalised(made, effect.prior_odds(case.room))


def _normalised(shifts: Sequence[Shift], odds: float) -> list[Shift]:
    """Return an effect's hypotheses with odds whose sum is the effect's."""
    total = sum(s.odds.sum() for s in shifts)
    return [replace(s, odds=s.odds * odds / total) for s in shifts]


def towards(moved: Array, stated: Array) -> Array:
    """Return changes of alpha as shares of the way to 1, or (below 0) to a hard wall; see `SHARES`."""
    up = moved / np.maximum(1 - stated, 1e-6)
    down = moved / np.maximum(stated - HARD, 1e-6)
    return np.asarray(np.where(moved >= 0, up, np.maximum(down, -1.0)))


_LEAST_COVERED = 0.1
"""A cover that takes less than this share of a surface's absorption is no hypothesis."""


def _apertures(case: Case) -> list[Shift]:
    """Return an aperture to a second room on each wall and ceiling."""
    room, areas = case.room, np.array(list(case.areas.values()))
    middle, n_bands = _middle_absorption(case), case.room.n_bands
    possible = np.array([kind(case.geometry, f) != "floor" for f in case.faces.values()])
    made = []
    for j in np.flatnonzero(possible):
        area = np.array([size * middle for size in SIZES if size * middle <= areas[j]])
        if not len(area):
            continue
        share = interpolation(OPEN, np.repeat(area[:, np.newaxis] / areas[j], n_bands, axis=1))
        weights = np.zeros((len(SECOND_ROOMS), len(area), n_bands, len(SECOND_ROOMS), len(OPEN)))
        for n in range(len(SECOND_ROOMS)):
            weights[n, :, :, n] = share
        odds = areas[j] / np.array([areas[possible & (areas >= a)].sum() for a in area])
        made.append(
            Shift(
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
                error=error_over_bands(COUPLED, room.centre_frequencies),
                uneven=np.tile(unevenness.factor(area / areas[j]), len(SECOND_ROOMS)),
                size_error=COUPLED.size_error,
            )
        )
    return _normalised(made, COUPLED.odds)


def _may_have(effect: Effect, where: str) -> bool:
    """Return whether a floor, a wall or a ceiling may have the effect."""
    if isinstance(effect, Audience):
        return where == "floor"
    if isinstance(effect, Curtain):
        return where == "wall"
    return isinstance(effect, CoveredSurface | Porous) or where != "floor"


def _spectra(effect: Effect, frequencies: Array) -> list[tuple[dict[str, float], Array]]:
    """Return the effect's kinds: their parameters and alpha, (n_bands,)."""
    if isinstance(effect, Absorber):
        return [(dict(k), effect.spectrum(frequencies, k)) for k in effect.kinds()]
    if isinstance(effect, Audience):
        alpha = SEATED_ALPHA * interpolate_octaves(frequencies, effect.SEATED)
        return [({}, np.minimum(alpha, 1.0))]
    return [({}, np.full(len(frequencies), HARD))]


def _materials(case: Case) -> list[Shift]:
    """Return each material's coefficients off by a factor.

    Its surfaces then hear what an absorber on all of them would do, with the material's own spectrum.
    """
    room = case.room
    made_of = np.array([room.material_index(m) for m in case.geometry.materials])
    octaves = np.abs(np.subtract.outer(*(2 * [np.log2(room.centre_frequencies)])))
    density = np.exp(-np.abs(FACTORS) / FACTOR_SCALE)
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
            Shift(
                effect=COEFFICIENTS,
                family=COEFFICIENTS,
                surface=None,
                response=f"material {row}",
                weights=np.tile(every, (1, 1, len(members))),
                odds=density / density.sum() * absorbed[row] / absorbed.sum() * ODDS[COEFFICIENTS],
                sizes=np.exp(FACTORS),
                unit="of what is stated",
                parameters=[{"factor": float(np.exp(f))} for f in FACTORS],
                spectra=np.zeros((len(FACTORS), 0)),
                error=0.1**2 + 0.15**2 * 0.7**octaves,
                uneven=np.zeros(len(FACTORS)),
                place=material,
            )
        )
    return made


def _middle_absorption(case: Case) -> float:
    """Return the room's absorption area at 500 to 2000 Hz in m², over all bands if it has none."""
    area = case.room.areas @ case.room.alpha
    f = case.room.centre_frequencies
    middle = (f > 440) & (f < 2300)
    return float(area[middle].mean() if middle.any() else area.mean())


def _whole(
    effect: str,
    family: str,
    at: Array,
    nodes: Sequence[float],
    *,
    odds: Array,
    sizes: Array,
    unit: str,
    parameters: Sequence[Parameters],
    error: Array,
) -> Shift:
    odds = odds * ODDS[effect] / odds.sum()
    return Shift(
        effect=effect,
        family=family,
        surface=None,
        response=effect,
        weights=interpolation(nodes, at),
        odds=odds,
        sizes=sizes,
        unit=unit,
        parameters=parameters,
        spectra=np.zeros((len(sizes), 0)),
        error=error,
        uneven=np.zeros(len(sizes)),
    )


def _air(case: Case) -> Shift:
    """Return other climates, or air where none is stated."""
    effect, room = OmittedAir(), case.room
    f = room.centre_frequencies
    reference = Air(20, 50).attenuation(f)
    grid = effect.grid(None)  # type: ignore[arg-type]  # the climates do not depend on the room
    attenuation = np.array([Air(p["temperature"], p["humidity"]).attenuation(f) for p in grid])
    density = grid_weights(effect, grid, None)  # type: ignore[arg-type]
    return _whole(
        "air",
        effect.family,
        (attenuation - room.air_attenuation) / reference,
        AIR,
        odds=density * effect.prior_odds(room),
        sizes=np.array([p["humidity"] for p in grid]),
        unit=effect.unit,
        parameters=grid,
        error=error_over_bands(effect, f),
    )


def _volume(case: Case) -> Shift:
    effect, n_bands = WrongVolume(), case.room.n_bands
    grid = effect.grid(None)  # type: ignore[arg-type]  # the ratios do not depend on the room
    logs = np.log([p["ratio"] for p in grid])
    density = grid_weights(effect, grid, None)  # type: ignore[arg-type]
    return _whole(
        "volume",
        effect.family,
        np.repeat(logs[:, np.newaxis], n_bands, axis=1),
        VOLUME,
        odds=density,
        sizes=np.exp(logs),
        unit=effect.unit,
        parameters=grid,
        error=np.full((n_bands, n_bands), 0.02**2) + 0.02**2 * np.eye(n_bands),
    )


def _scattering(case: Case) -> Shift:
    """Return too little and too much scattering, as far as tracings at both ends show it."""
    n_bands = case.room.n_bands
    ends = np.array([-2.0, -1.0, 1.0, 2.0])
    octaves = np.abs(np.subtract.outer(*(2 * [np.log2(case.room.centre_frequencies)])))
    shift = _whole(
        SCATTERING,
        "field",
        np.repeat(np.clip(ends, -1, 1)[:, np.newaxis], n_bands, axis=1),
        (-1.0, 1.0),
        odds=np.ones(4),
        sizes=ends,
        unit="of the way to 0.05 or 0.95",
        parameters=[{"scattering": float(e)} for e in ends],
        error=0.3**2 * 0.7**octaves,
    )
    return replace(shift, weights=shift.weights * np.abs(ends)[:, np.newaxis, np.newaxis])


def spreads(
    measured: Sequence[Pair],
    moved: Mapping[str, Array],
    errors: Array,
    columns: Sequence[int],
) -> list[Spread]:
    """Return the hypotheses of the measurement.

    Parameters
    ----------
    measured : sequence of (source, receiver)
    moved : mapping of str to array (n_displacements, n_parameters, n_pairs, n_bands)
        Shifts of the measured parameters where a source or receiver is displaced; see `Responses`.
    errors : array (n_bands, n_parameters, n_pairs, same three)
        Covariance of the errors of simulator and measurement.
    columns : sequence of int
        Number of each measured pair among the simulator's.
    """
    n_bands, n_parameters, n_pairs = errors.shape[:3]
    number = np.arange(n_bands * n_parameters * n_pairs).reshape(errors.shape[:3])
    full = errors.reshape(number.size, number.size)
    out = []
    for place, shift in moved.items():
        pairs = [i for i, c in enumerate(columns) if np.abs(shift[:, :, c]).max() > 0]
        if not pairs:
            continue
        rows = number[:, :, pairs].ravel()
        steps = np.moveaxis(shift[:, :, [columns[i] for i in pairs]], 3, 1)
        samples = steps.reshape(len(shift), -1)
        # The displacements along an axis and back have nearly opposite shifts: three free directions.
        covariance = samples.T @ samples / 6
        for distance in DISPLACEMENTS:
            odds = ODDS[POSITION] / (len(moved) * len(DISPLACEMENTS))
            scaled = (distance / MOVE) ** 2 * covariance
            out.append(Spread(POSITION, place, distance, "m", rows, scaled, odds))
    for i, pair in enumerate(measured):
        rows = number[:, :, i].ravel()
        for factor in NOISES:
            odds = ODDS[NOISE] / (n_pairs * len(NOISES))
            scaled = (factor**2 - 1) * full[np.ix_(rows, rows)]
            name = " to ".join(pair)
            out.append(Spread(NOISE, name, factor, "times as uncertain", rows, scaled, odds))
    return out


def family_of(effect: str, every: Sequence[Shift]) -> str:
    """Return the family of an effect."""
    if effect in (POSITION, NOISE):
        return MEASUREMENT
    return next((s.family for s in every if s.effect == effect), effect)
