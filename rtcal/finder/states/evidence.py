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

import math
from collections.abc import Collection, Iterator, Sequence
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

    @property
    def turned(self) -> Grid:
        """The hypotheses with "added" and "removed" exchanged in their names alone."""
        other = {ADDED: REMOVED, REMOVED: ADDED}

        def turned(name: str) -> str:
            side, space, rest = name.partition(" ")
            return f"{other.get(side, side)}{space}{rest}"

        names, families = (tuple(map(turned, of)) for of in (self.names, self.families))
        return replace(self, names=names, families=families)


def adding(effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that add absorption, whose spectra are tried, in the order of their names."""
    some = [effect for effect in effects if effect.family.startswith(f"{_FAMILY}, ")]
    return sorted(some, key=lambda effect: effect.name)


def tried(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of what is tried between two states with a library of effects."""
    return (*(effect.name for effect in adding(effects)), AIR, UNKNOWN)


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
    levels, n = area * np.geomspace(LEAST, MOST, SIZES), int(bands.sum())
    climates = (
        {False: 1.0} if AIR in without else {False: 1 - ANOTHER_CLIMATE, True: ANOTHER_CLIMATE}
    )
    rows: list[tuple[str, str, float, Array, Array, bool]] = [
        (
            f"{side} {name}",
            ", ".join(filter(None, [f"{side} absorption", kind])),
            probability * weight / len(levels),
            sign * level * spectrum,
            covariance,
            another,
        )
        for side, sign in ((ADDED, 1.0), (REMOVED, -1.0))
        for name, kind, weight, spectra, covariance in _shapes(room, bands, effects, without)
        for spectrum in spectra
        for level in levels
        for another, probability in climates.items()
    ]
    if AIR not in without:
        rows.append((AIR, "climate", 2 * AIR_ODDS, np.zeros(n), np.eye(n), True))
    names, families, weights, sizes, covariances, of_air = zip(*rows, strict=True)
    log_weight = np.log(np.array(weights) / np.sum(weights))
    arrays = log_weight, np.array(sizes), np.array(covariances), np.array(of_air)
    return Grid(names, families, *arrays)


def _shapes(
    room: Room, bands: NDArray[np.bool_], effects: Sequence[Effect], without: Collection[str]
) -> Iterator[tuple[str, str, float, Array, Array]]:
    """Yield name, kind, prior odds of a spectrum, spectra and their error; of "unknown" at last.

    A spectrum (n_bands,) is above 0, and its mean is 1. Its error is the covariance of its logarithm.
    """
    frequencies = room.centre_frequencies
    base = RoomState.of_room(room, np.zeros(len(room.areas)))
    for effect in adding(effects):
        if effect.name in without:
            continue
        every = [alpha for _, alpha in effect.on_surface(frequencies)]
        if not every:  # objects: what one size of them adds in m²
            added = effect.added_absorption(base, effect.change(base, effect.grid(base)[0]))
            every = [np.ones(len(frequencies)) if added is None else added]
        # A coefficient of 0 is a thousandth of the largest.
        raised = [np.maximum(alpha, 1e-3 * alpha.max()) for alpha in every]
        spectra = np.array([alpha / alpha.mean() for alpha in raised])[:, bands]
        kind = effect.family.removeprefix(f"{_FAMILY}, ")
        if kind in KINDS.values() and bands.sum() > 1:
            # By the rule of the change which is found, so that both agree: furniture, of the
            # library's family "flat", rises twofold. A kind that the library does not have stays.
            kind = KINDS[over_frequency(spectra.mean(axis=0))]
        weight = effect.prior_odds(room) / len(every)
        error = effect.error_over_bands(frequencies)[np.ix_(bands, bands)]
        yield effect.name, kind, weight, spectra / spectra.mean(axis=1, keepdims=True), error
    if UNKNOWN not in without:
        octaves = np.log2(frequencies[bands] / 1000)
        far, apart = np.abs(octaves), np.abs(np.subtract.outer(octaves, octaves))
        # A random walk from 0 in both directions.
        walk = WALK**2 * (far[:, np.newaxis] + far - apart) / 2
        yield UNKNOWN, "", UNKNOWN_ODDS, np.ones((1, len(octaves))), walk


KINDS = {
    "rising with frequency": "rising",
    "alike at all frequencies": "flat",
    "falling with frequency": "low",
}
"""Kinds of the families that the library has, by how their spectra go with frequency."""


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


PAIR, COMMON = 0.15, 0.1
"""Error of a pair's shift, and of all pairs' in a band, over the predicted shift; this and what follows
was chosen on the development part, `benchmarks/studies/states`."""
REMEASURED = 0.01
"""Standard deviation of ln T by which a band differs if nothing changed: climate, equipment."""
DEGREES, OF_MEANS = 5.0, 15.0
"""Degrees of freedom of a pair's noise, and of that of means over positions."""
SCALES = {0.7: 0.2, 1.0: 0.5, 1.4: 0.2, 2.0: 0.1}
"""Scales of all pairs' noise and their prior probabilities."""
_USUAL = 1
"""Number of the most probable scale."""
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


def none(change: Array, variance: Array, degrees: float) -> float:
    """Return the log evidence that nothing changed.

    ``change`` and ``variance`` are (n_pairs, n_bands), NaN where nothing was measured. ``degrees`` is
    `DEGREES` or `OF_MEANS`.
    """
    prior = REMEASURED**2 * np.eye(change.shape[1])
    return float(logsumexp([log for log, _ in _by_scale(change, variance, prior, degrees)]))


def chance_of_climate(change: Array, variance: Array, baseline: Baseline, degrees: float) -> float:
    """Return the p-value of the pairs' mean shift if the climate alone is another, by chi-square.

    The covariance is that of the climate, of a remeasurement, and of the pairs' noise with the scale
    and the pairs' weights that make the data most probable; one degree of freedom per band.
    """
    n = change.shape[1]
    prior = baseline.climate + REMEASURED**2 * np.eye(n)
    _, inverse = max(_by_scale(change, variance, prior, degrees), key=lambda each: each[0])
    inverse = np.where(np.isfinite(change), inverse, 0.0)
    precision = inverse.sum(axis=0)
    mean = np.nansum(inverse * change, axis=0) / precision
    square = mean @ np.linalg.solve(prior + np.diag(1 / precision), mean)
    return float(chdtrc(n, square))


def _by_scale(
    change: Array, variance: Array, prior: Array, degrees: float
) -> list[tuple[float, Array]]:
    """Return of each scale the log evidence of a shift of mean 0, and the precision of each pair.

    With the scale's prior probability; the precision is at most that of its noise alone.
    """
    out = []
    for scale, probability in SCALES.items():
        spread, weight = scale**2 * variance[np.newaxis], np.ones((1, len(change)))
        centre = np.zeros((1, len(prior)))
        for _ in range(_STEPS):
            evidence, _, _, weight = _integrated(
                change, spread, centre, prior[np.newaxis], degrees, weight
            )
        precision = np.minimum(weight[0], 1.0)[:, np.newaxis] / spread[0]
        out.append((float(evidence[0]) + math.log(probability), precision))
    return out


def fits(change: Array, variance: Array, baseline: Baseline, grid: Grid, degrees: float) -> Fits:
    """Return the evidence of each hypothesis of the grid, and the sizes that each would have."""
    n, k = grid.size.shape
    shape = n, len(SCALES)
    found = Fits(
        np.full(shape, -np.inf),
        np.zeros((*shape, k)),
        np.zeros((*shape, k, k)),
        np.zeros((*shape, k)),
    )

    def evaluate(rows: Rows, j: int, steps: int) -> None:
        scale, probability = [*SCALES.items()][j]
        for some in np.array_split(rows, -(-len(rows) * len(change) // _MOST_AT_ONCE)):
            evidence, *rest = _fitted(
                change, scale**2 * variance, baseline, grid, some, degrees, steps
            )
            found.log_evidence[some, j] = evidence + math.log(probability)
            for values, of_some in zip(
                (found.mean, found.covariance, found.shift), rest, strict=True
            ):
                values[some, j] = of_some

    evaluate(np.arange(n), _USUAL, _FIRST)
    first = found.log_evidence[:, _USUAL]
    likely = np.flatnonzero(first > first.max() - _NEGLIGIBLE)
    first[np.isin(np.arange(n), likely, invert=True)] = -np.inf
    for j in range(len(SCALES)):
        evaluate(likely, j, _STEPS)
    return found


def _fitted(
    change: Array,
    variance: Array,
    baseline: Baseline,
    grid: Grid,
    rows: Rows,
    degrees: float,
    steps: int,
) -> tuple[Array, Array, Array, Array]:
    """Return the `Fits` of some hypotheses with one scale, without the scale's prior probability."""
    size, prior = grid.size[rows], grid.covariance[rows]
    of_air = grid.of_air[rows, np.newaxis, np.newaxis] * baseline.climate
    stated, _ = baseline.shift(size)
    spread = variance + ((PAIR * stated) ** 2)[:, np.newaxis]
    other = REMEASURED**2 + (COMMON * stated) ** 2
    z, weight = np.zeros_like(size), np.ones((len(size), len(change)))
    for _ in range(steps):
        shift, slope = baseline.shift(size * np.exp(z))
        centre = shift - slope * z
        of_shift = slope[:, :, None] * prior * slope[:, None, :]
        whole = of_shift + of_air + other[:, :, None] * np.eye(size.shape[1])
        log_evidence, mode, precision, weight = _integrated(
            change, spread, centre, whole, degrees, weight
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
    change: Array, spread: Array, centre: Array, prior: Array, degrees: float, weight: Array
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
    degrees : float
    weight : array (n, n_pairs)
        Of the pairs' precision, from which to begin.
    """
    known = np.isfinite(change)
    count = known.sum(axis=1)
    inverse = np.where(known, 1 / spread, 0.0)
    d = np.where(known, change, 0.0)
    of_prior = np.linalg.inv(prior)
    at_prior = np.einsum("nkl,nl->nk", of_prior, centre)
    for _ in range(_WEIGHINGS):
        weighted = weight[:, :, None] * inverse
        precision = of_prior + weighted.sum(axis=1)[:, :, None] * np.eye(change.shape[1])
        pull = at_prior + (weighted * d).sum(axis=1)
        mode = np.linalg.solve(precision, pull[:, :, None])[:, :, 0]
        squares = (inverse * (d - mode[:, None]) ** 2).sum(axis=2)
        weight = (degrees + count) / (degrees + squares)
    log_det = np.where(known, np.log(np.where(known, spread, 1.0)), 0.0).sum(axis=(1, 2))
    constant = gammaln((degrees + count) / 2) - gammaln(degrees / 2)
    constant = constant - count / 2 * np.log(degrees * np.pi)
    by_pair = constant - (degrees + count) / 2 * np.log1p(squares / degrees)
    off = mode - centre
    of_mode = np.einsum("nk,nkl,nl->n", off, of_prior, off)
    determinants = np.linalg.slogdet(prior)[1] + np.linalg.slogdet(precision)[1]
    log_evidence = by_pair.sum(axis=1) - (log_det + of_mode + determinants) / 2
    return log_evidence, mode, precision, weight
