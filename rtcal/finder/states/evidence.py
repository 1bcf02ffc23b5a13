"""The kinds of change between two states, and how well each explains their differences.

Absorption was added or removed, the climate of the air is another, or both.

ln T of a pair shifts by m + e. m is the shift of all pairs: the predicted one, with the errors of the
spectrum and of the equation, what a remeasurement adds by itself, and what another climate adds, which
is as uncertain as both climates (`climate_covariance`). e is what the pair has alone: noise of both
states, and a share of the shift. The noise of each pair has a scale of its own, so that e
follows a multivariate t distribution over the pair's bands; all pairs together have a further one. The
integral over m is Laplace's at the mode that Gauss-Newton steps find.

The change is not small: it is no shift on a linear scale, as positions have it, and it has no prior of
coefficients, as means have it. So neither likelihood of theirs serves.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaln, logsumexp

from rtcal.acoustics.air import Air
from rtcal.acoustics.bands import is_middle
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.finder.case import CLIMATE_UNCERTAINTY
from rtcal.finder.claim import over_frequency
from rtcal.finder.effects import Effect
from rtcal.finder.model import RoomState
from rtcal.finder.prior import UNKNOWN, UNKNOWN_ODDS
from rtcal.support.types import Array

ADDED, REMOVED, AIR = "added", "removed", "air"
_FAMILY = "added absorption"
WALK = 0.5
"""Standard deviation per octave of ln absorption, of a spectrum that no effect of the library has."""
LEAST, MOST = 0.02, 6.0
"""Sizes that are tried, over the absorption area before at 500 to 2000 Hz."""
SIZES = 25
INDOORS = (15.0, 30.0), (20.0, 70.0)
"""Temperatures in °C and relative humidities in % of rooms whose climate is not stated."""
AIR_ODDS = 0.5
"""Prior odds that the climate changed and nothing else, against an effect of odds 1 on either side."""
ANOTHER_CLIMATE = 0.5
"""Prior probability that the climate changed as well, where absorption was added or removed."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A spectrum of what changed: relative absorption area by band, and its errors.

    Attributes
    ----------
    name : str
        Of the effect; "unknown" of a spectrum that no effect has.
    family : str
        As the effect's, after "added absorption, ": "rising", "flat", "low"; "" of none.
    weight : float
        Prior odds.
    spectrum : array (n_bands,)
        Above 0; its mean over the bands is 1.
    covariance : array (n_bands, n_bands)
        Of the error of ln spectrum.
    """

    name: str
    family: str
    weight: float
    spectrum: Array
    covariance: Array


def adding(effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that add absorption, whose spectra are tried, in the order of their names."""
    some = [effect for effect in effects if effect.family.startswith(f"{_FAMILY}, ")]
    return sorted(some, key=lambda effect: effect.name)


def tried(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of what is tried between two states with a library of effects."""
    return (*(effect.name for effect in adding(effects)), AIR, UNKNOWN)


def shapes(room: Room, effects: Sequence[Effect], without: Collection[str] = ()) -> list[Shape]:
    """Return the spectra of all effects that add absorption, and one that no effect has.

    Those of names ``without`` are left out.
    """
    frequencies = room.centre_frequencies
    base = RoomState.of_room(room, np.zeros(len(room.areas)))
    out = []
    for effect in adding(effects):
        if effect.name in without:
            continue
        spectra = [alpha for _, alpha in effect.on_surface(frequencies)] or [
            _of_objects(effect, base)
        ]
        error = effect.error_over_bands(frequencies)
        for alpha in spectra:
            out.append(
                Shape(
                    effect.name,
                    effect.family.removeprefix(f"{_FAMILY}, "),
                    effect.prior_odds(room) / len(spectra),
                    _scaled(alpha),
                    error,
                )
            )
    if UNKNOWN not in without:
        free = WALK**2 * _walk(np.log2(frequencies / 1000))
        out.append(Shape(UNKNOWN, "", UNKNOWN_ODDS, np.ones(len(frequencies)), free))
    return out


def _of_objects(effect: Effect, base: RoomState) -> Array:
    """Return what one size of an effect of objects adds in m², (n_bands,)."""
    added = effect.added_absorption(base, effect.change(base, effect.grid(base)[0]))
    return np.ones(len(base.frequencies)) if added is None else added


def _scaled(spectrum: Array) -> Array:
    """Return a spectrum with mean 1; a coefficient of 0 is a thousandth of the largest."""
    raised = np.maximum(spectrum, 1e-3 * spectrum.max())
    return np.asarray(raised / raised.mean())


def _walk(octaves: Array) -> Array:
    """Return the covariance of a random walk from 0 in both directions, of variance 1 per octave."""
    far = np.abs(octaves)
    return np.asarray((far[:, None] + far - np.abs(np.subtract.outer(octaves, octaves))) / 2)


@dataclass(frozen=True, eq=False)
class Grid:
    """Every hypothesis: a spectrum with a size, added or removed, with another climate or without.

    Attributes
    ----------
    names, families : tuple of str (n,)
    log_weight : array (n,)
        Log prior probabilities, given that something changed; they sum to 1.
    size : array (n, n_bands)
        Absorption area in m² before saturation, above 0 where added and below 0 where removed; 0 where
        the climate changed and nothing else.
    covariance : array (n, n_bands, n_bands)
        Of the error of ln |size|.
    of_air : array (n,) of bool
        Where the climate of the air is another.
    """

    names: tuple[str, ...]
    families: tuple[str, ...]
    log_weight: Array
    size: Array
    covariance: Array
    of_air: NDArray[np.bool_]

    @property
    def of_surfaces(self) -> NDArray[np.bool_]:
        """Where absorption was added or removed, (n,)."""
        return np.asarray(self.size.any(axis=1))


def grid(
    room: Room,
    before: Array,
    bands: NDArray[np.bool_],
    effects: Sequence[Effect],
    without: Collection[str] = (),
) -> Grid:
    """Return every hypothesis of a room with this absorption area before, in these bands.

    Parameters
    ----------
    room : Room
    before : array (n_bands,)
        The surfaces' absorption area in m²; NaN where unknown.
    bands : array (n_bands,) of bool
        Bands to take.
    effects : sequence of Effect
    without : collection of str
        Names of `tried` that are left out.
    """
    middle = bands & is_middle(room.centre_frequencies)
    area = float(before[middle if middle.any() else bands].mean())
    levels = area * np.geomspace(LEAST, MOST, SIZES)
    n = int(bands.sum())
    every = shapes(room, effects, without)
    kinds = _kinds(every, bands)
    names, families, weights, sizes, covariances, of_air = [], [], [], [], [], []
    climates = (
        {False: 1.0} if AIR in without else {False: 1 - ANOTHER_CLIMATE, True: ANOTHER_CLIMATE}
    )
    for side, sign in ((ADDED, 1.0), (REMOVED, -1.0)):
        for shape in every:
            spectrum = shape.spectrum[bands] / shape.spectrum[bands].mean()
            covariance = shape.covariance[np.ix_(bands, bands)]
            for level in levels:
                for another, probability in climates.items():
                    names.append(f"{side} {shape.name}")
                    families.append(
                        ", ".join(filter(None, [f"{side} absorption", kinds[shape.name]]))
                    )
                    weights.append(probability * shape.weight / len(levels))
                    sizes.append(sign * level * spectrum)
                    covariances.append(covariance)
                    of_air.append(another)
    if AIR not in without:
        names.append(AIR)
        families.append("climate")
        weights.append(2 * AIR_ODDS)
        sizes.append(np.zeros(n))
        covariances.append(np.eye(n))
        of_air.append(True)
    weight = np.array(weights)
    return Grid(
        tuple(names),
        tuple(families),
        np.log(weight / weight.sum()),
        np.array(sizes),
        np.array(covariances),
        np.array(of_air),
    )


KINDS = {
    "rising with frequency": "rising",
    "alike at all frequencies": "flat",
    "falling with frequency": "low",
}
"""Kinds of the families that the library has, by how their spectra go with frequency."""


def _kinds(every: Sequence[Shape], bands: NDArray[np.bool_]) -> dict[str, str]:
    """Return the kind of absorption of each effect, by its mean spectrum in these bands.

    The rule is that of the change which is found (`over_frequency`), so that both agree: furniture, of
    the library's family "flat", rises twofold. A kind that the library does not have stays.
    """
    out = {shape.name: shape.family for shape in every}
    for name, kind in out.items():
        if kind in KINDS.values() and bands.sum() > 1:
            mean = np.mean([shape.spectrum[bands] for shape in every if shape.name == name], axis=0)
            out[name] = KINDS[over_frequency(mean)]
    return out


def climate_covariance(room: Room, uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY) -> Array:
    """Return the covariance in m⁴ of the difference of the air's 4 m V, (n_bands, n_bands).

    Both climates are independent of each other: normal about the stated one, with ``uncertainty`` in K
    and in percent of relative humidity; any indoor one (`INDOORS`) where none is stated. So the
    covariance is twice that of one state, by quadrature over the climates.
    """
    if room.air is None:
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        (low, high), (dry, damp) = INDOORS
        temperatures = (low + high) / 2 + (high - low) / 2 * nodes
        humidities = (dry + damp) / 2 + (damp - dry) / 2 * nodes
    else:
        nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
        kelvin, percent = uncertainty
        temperatures = np.clip(room.air.temperature + kelvin * nodes, -20.0, 50.0)
        humidities = np.clip(room.air.humidity + percent * nodes, 1.0, 100.0)
    pressure = (room.air or Air()).pressure
    of_climate = np.array(
        [
            4 * room.volume * Air(float(t), float(h), pressure).attenuation(room.centre_frequencies)
            for t in temperatures
            for h in humidities
        ]
    )
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    off = of_climate - weight @ of_climate
    return np.asarray(2 * (off * weight[:, np.newaxis]).T @ off)


_NODES = 4
"""Nodes of a quadrature over temperatures, and over humidities."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """The absorption of the first state, in the bands in which both states were measured.

    Attributes
    ----------
    equation : LinearEquation
    total_area : float
        S in m².
    area : array (n_bands,)
        The surfaces' absorption area b in m², by the equation from T before.
    air : array (n_bands,)
        4 m V in m².
    climate : array (n_bands, n_bands)
        Covariance of ln T by another climate, at the mean of ln T of both states.
    """

    equation: LinearEquation
    total_area: float
    area: Array
    air: Array
    climate: Array

    @classmethod
    def of(
        cls,
        room: Room,
        equation: LinearEquation,
        times: tuple[Array, Array],
        bands: NDArray[np.bool_],
        uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY,
    ) -> Baseline:
        """Return the baseline of a room with T before and after in s, (n_bands,), in some of its bands.

        ``uncertainty`` is that of a stated climate, as of `climate_covariance`. Raises InfeasibleError
        where no coefficients give T before.
        """
        area = equation.absorption_area(room, np.where(bands, times[0], np.nan))[bands]
        air = 4 * room.air_attenuation[bands] * room.volume
        base = cls(equation, room.total_area, area, air, np.zeros((len(area), len(area))))
        whole = base.whole(area) * np.sqrt(times[0][bands] / times[1][bands])
        of_air = climate_covariance(room, uncertainty)[np.ix_(bands, bands)]
        return replace(base, climate=of_air / np.outer(whole, whole))

    def after(self, size: Array) -> Array:
        """Return the surfaces' absorption area after a change in m², (..., n_bands).

        What is added covers surfaces: b + (S - b) (1 - exp(-size / (S - b))). What is removed, of a
        size below 0, leaves b exp(size / b). To first order both are b + size.
        """
        left = self._left(size)
        covered = -np.expm1(-np.minimum(np.abs(size) / left, _MOST_COVERED))
        return np.asarray(self.area + np.sign(size) * left * covered)

    def shift(self, size: Array) -> tuple[Array, Array]:
        """Return the shift of ln T and its derivative by ln |size|, both (..., n_bands).

        ``size`` (..., n_bands) is an absorption area in m², before it saturates.
        """
        mean = self.after(size) / self.total_area
        whole, before = self.whole(mean * self.total_area), self.whole(self.area)
        by_area = size * np.exp(-np.abs(size) / self._left(size)) * self.equation.slope(mean)
        return np.asarray(-np.log(whole / before)), np.asarray(-by_area / whole)

    def whole(self, area: Array) -> Array:
        """Return S a + 4 m V in m², of the surfaces' absorption area in m²."""
        exponent = self.equation.exponent(area / self.total_area)
        return np.asarray(self.total_area * exponent + self.air)

    def _left(self, size: Array) -> Array:
        """The area to cover, or to remove, in m²."""
        left = np.where(size > 0, self.total_area - self.area, self.area)
        return np.maximum(left, 1e-6 * self.total_area)


_MOST_COVERED = 30.0
"""Largest size over the area that is left to cover or to remove: all but e^-30 of it is."""


@dataclass(frozen=True)
class Errors:
    """Assumptions on the errors; chosen on the development part, `docs/two_states_study.md`.

    Attributes
    ----------
    pair, common : float
        Error of a pair's shift, and of all pairs' in a band, over the predicted shift.
    remeasured : float
        Standard deviation of ln T by which a band differs if nothing changed: climate, equipment.
    degrees, of_means : float
        Degrees of freedom of a pair's noise, and of that of means over positions.
    scales, weights : tuple of float
        Scales of all pairs' noise and their prior probabilities.
    """

    pair: float = 0.15
    common: float = 0.1
    remeasured: float = 0.01
    degrees: float = 5.0
    of_means: float = 15.0
    scales: tuple[float, ...] = (0.7, 1.0, 1.4, 2.0)
    weights: tuple[float, ...] = (0.2, 0.5, 0.2, 0.1)


_STEPS = 12
"""Most Gauss-Newton steps."""
_SETTLED = 1e-3
"""Largest last step of ln size."""
_WEIGHINGS = 5
"""Steps of the pairs' weights at each of them."""
_FIRST = 3
"""Gauss-Newton steps before the hypotheses that explain the data badly are dropped."""
_NEGLIGIBLE = 25.0
"""Evidence in nats below the best hypothesis', from which one is dropped."""
_MOST_AT_ONCE = 20_000
"""Pairs times hypotheses that are computed at once."""
Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Fits:
    """Each hypothesis with each scale: its evidence, and what it makes of the sizes.

    Attributes
    ----------
    log_evidence : array (n, n_scales)
        Log probability density of the data, with the scale's prior probability.
    mean : array (n, n_scales, n_bands)
        Of ln |size| less that of the grid.
    covariance : array (n, n_scales, n_bands, n_bands)
    shift : array (n, n_scales, n_bands)
        Mean of the shift of ln T by what changed: that of the size, and that of the climate.
    """

    log_evidence: Array
    mean: Array
    covariance: Array
    shift: Array


def none(change: Array, variance: Array, errors: Errors) -> float:
    """Return the log evidence that nothing changed.

    ``change`` and ``variance`` are (n_pairs, n_bands), NaN where nothing was measured.
    """
    n = change.shape[1]
    zero, noise = np.zeros((1, n)), np.zeros((1, n, n)) + errors.remeasured**2 * np.eye(n)
    by_scale = [
        _settled(change, scale**2 * variance[np.newaxis], zero, noise, errors)[0]
        for scale in errors.scales
    ]
    return float(logsumexp(np.array(by_scale) + np.log(errors.weights)))


def chance_of_climate(change: Array, variance: Array, baseline: Baseline, errors: Errors) -> float:
    """Return the p-value of the pairs' mean shift if the climate alone is another, by chi-square.

    The covariance is that of the climate, of a remeasurement, and of the pairs' noise with the scale
    and the pairs' weights that make the data most probable; one degree of freedom per band.
    """
    n = change.shape[1]
    prior = (baseline.climate + errors.remeasured**2 * np.eye(n))[np.newaxis]
    found = []
    for scale, weight in zip(errors.scales, errors.weights, strict=True):
        spread = scale**2 * variance[np.newaxis]
        evidence, of_pairs = _settled(change, spread, np.zeros((1, n)), prior, errors)
        found.append(
            (evidence + np.log(weight), np.minimum(of_pairs, 1.0)[:, np.newaxis] / spread[0])
        )
    _, inverse = max(found, key=lambda each: each[0])
    inverse = np.where(np.isfinite(change), inverse, 0.0)
    precision = inverse.sum(axis=0)
    mean = np.nansum(inverse * change, axis=0) / precision
    square = mean @ np.linalg.solve(prior[0] + np.diag(1 / precision), mean)
    return float(chdtrc(n, square))


def fits(change: Array, variance: Array, baseline: Baseline, grid: Grid, errors: Errors) -> Fits:
    """Return the evidence of each hypothesis of the grid, and the sizes that each would have."""
    n, k = grid.size.shape
    evidence = np.full((n, len(errors.scales)), -np.inf)
    mean, covariance = np.zeros((*evidence.shape, k)), np.zeros((*evidence.shape, k, k))
    shift = np.zeros_like(mean)

    def evaluate(rows: Rows, j: int, steps: int) -> None:
        for some in np.array_split(rows, -(-len(rows) * len(change) // _MOST_AT_ONCE)):
            found = _fitted(change, variance, baseline, grid, some, errors, errors.scales[j], steps)
            evidence[some, j] = found[0] + np.log(errors.weights[j])
            mean[some, j], covariance[some, j], shift[some, j] = found[1:]

    usual = int(np.argmax(errors.weights))
    evaluate(np.arange(n), usual, _FIRST)
    likely = np.flatnonzero(evidence[:, usual] > evidence[:, usual].max() - _NEGLIGIBLE)
    evidence[:, usual] = np.where(np.isin(np.arange(n), likely), evidence[:, usual], -np.inf)
    for j in range(len(errors.scales)):
        evaluate(likely, j, _STEPS)
    return Fits(evidence, mean, covariance, shift)


def _fitted(
    change: Array,
    variance: Array,
    baseline: Baseline,
    grid: Grid,
    rows: Rows,
    errors: Errors,
    scale: float,
    steps: int,
) -> tuple[Array, Array, Array, Array]:
    """Return the `Fits` of some hypotheses with one scale, without the scale's prior probability."""
    size, prior = grid.size[rows], grid.covariance[rows]
    of_air = grid.of_air[rows, np.newaxis, np.newaxis] * baseline.climate
    stated, _ = baseline.shift(size)
    spread = scale**2 * variance + ((errors.pair * stated) ** 2)[:, np.newaxis]
    other = errors.remeasured**2 + (errors.common * stated) ** 2
    z, weight = np.zeros_like(size), np.ones((len(size), len(change)))
    for _ in range(steps):
        shift, slope = baseline.shift(size * np.exp(z))
        centre = shift - slope * z
        of_shift = slope[:, :, None] * prior * slope[:, None, :]
        whole = of_shift + of_air + other[:, :, None] * np.eye(size.shape[1])
        log_evidence, mode, precision, weight = _integrated(
            change, spread, centre, whole, errors, weight
        )
        gain = np.linalg.solve(whole, slope[:, :, None] * prior).swapaxes(1, 2)
        after = np.einsum("nkl,nl->nk", gain, mode - centre)
        step = np.clip(after - z, -1.0, 1.0)
        z = z + step
        if np.abs(step).max() < _SETTLED:
            break
    # Var z = prior - gain (whole - var m) gain', with var m of the posterior.
    of_mode = np.linalg.inv(precision)
    covariance = prior - gain @ (whole - of_mode) @ gain.swapaxes(1, 2)
    by_air = of_air @ np.linalg.solve(whole, (mode - centre)[:, :, np.newaxis])
    return log_evidence, z, covariance, baseline.shift(size * np.exp(z))[0] + by_air[:, :, 0]


def _integrated(
    change: Array, spread: Array, centre: Array, prior: Array, errors: Errors, weight: Array
) -> tuple[Array, Array, Array, Array]:
    """Return log evidence, mode and precision of the shift of all pairs, and the pairs' weights.

    Parameters
    ----------
    change : array (n_pairs, n_bands)
    spread : array (n or 1, n_pairs, n_bands)
        Variance of each pair alone.
    centre : array (n, n_bands)
        Mean of the shift before the measurement.
    prior : array (n, n_bands, n_bands)
        Its covariance.
    weight : array (n, n_pairs)
        Of the pairs' precision, from which to begin.
    """
    known = np.isfinite(change)
    count = known.sum(axis=1)
    inverse = np.where(known, 1 / spread, 0.0)
    d = np.where(known, change, 0.0)
    nu = errors.degrees
    of_prior = np.linalg.inv(prior)
    at_prior = np.einsum("nkl,nl->nk", of_prior, centre)
    for _ in range(_WEIGHINGS):
        weighted = weight[:, :, None] * inverse
        precision = of_prior + weighted.sum(axis=1)[:, :, None] * np.eye(change.shape[1])
        pull = at_prior + (weighted * d).sum(axis=1)
        mode = np.linalg.solve(precision, pull[:, :, None])[:, :, 0]
        squares = (inverse * (d - mode[:, None]) ** 2).sum(axis=2)
        weight = (nu + count) / (nu + squares)
    log_det = np.where(known, np.log(np.where(known, spread, 1.0)), 0.0).sum(axis=(1, 2))
    constant = gammaln((nu + count) / 2) - gammaln(nu / 2) - count / 2 * np.log(nu * np.pi)
    likelihood = (constant - (nu + count) / 2 * np.log1p(squares / nu)).sum(axis=1) - log_det / 2
    off = mode - centre
    of_mode = np.einsum("nk,nkl,nl->n", off, of_prior, off)
    determinants = np.linalg.slogdet(prior)[1] + np.linalg.slogdet(precision)[1]
    return likelihood - (of_mode + determinants) / 2, mode, precision, weight


def _settled(
    change: Array, spread: Array, centre: Array, prior: Array, errors: Errors
) -> tuple[float, Array]:
    """Return the log evidence of one shift whose error is normal, and the pairs' weights."""
    weight = np.ones((1, len(change)))
    for _ in range(_STEPS):
        found = _integrated(change, spread, centre, prior, errors, weight)
        weight = found[3]
    return float(found[0][0]), weight[0]
