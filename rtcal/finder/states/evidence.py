"""The kinds of change between two states, and how well each explains their differences.

Absorption was added or removed, or the air is another.

ln T of a pair shifts by m + e. m is the shift of all pairs: the predicted one, with the errors of the
spectrum and of the equation, and what a remeasurement adds by itself. e is what the pair has alone:
noise of both states, and a share of the shift. The noise of each pair has a scale of its own, so that e
follows a multivariate t distribution over the pair's bands; all pairs together have a further one. The
integral over m is Laplace's at the mode that Gauss-Newton steps find.

The change is not small: it is no shift on a linear scale, as positions have it, and it has no prior of
coefficients, as means have it. So neither likelihood of theirs serves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from rtcal.acoustics.air import Air
from rtcal.acoustics.bands import is_middle
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
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
_HUMIDITIES = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
_WARMER = (-4.0, 0.0, 4.0)
AIR_ODDS = 0.5
"""Prior odds that the climate changed and nothing else, against an effect of odds 1 on either side."""
_AIR_ERROR = 0.03


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


def shapes(room: Room, effects: Sequence[Effect]) -> list[Shape]:
    """Return the spectra of all effects that add absorption, and one that no effect has."""
    frequencies = room.centre_frequencies
    base = RoomState.of_room(room, np.zeros(len(room.areas)))
    out = []
    for effect in effects:
        if not effect.family.startswith(f"{_FAMILY}, "):
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
    """Every hypothesis: a spectrum with a size, added or removed; or another climate.

    Attributes
    ----------
    names, families : tuple of str (n,)
    log_weight : array (n,)
        Log prior probabilities, given that something changed; they sum to 1.
    size : array (n, n_bands)
        Absorption area in m² before saturation, above 0 where added and below 0 where removed. Of the
        climate, what the air absorbs more.
    covariance : array (n, n_bands, n_bands)
        Of the error of ln |size|.
    of_air : array (n,) of bool
    """

    names: tuple[str, ...]
    families: tuple[str, ...]
    log_weight: Array
    size: Array
    covariance: Array
    of_air: NDArray[np.bool_]


def grid(room: Room, before: Array, bands: NDArray[np.bool_], effects: Sequence[Effect]) -> Grid:
    """Return every hypothesis of a room with this absorption area before, in these bands.

    Parameters
    ----------
    room : Room
    before : array (n_bands,)
        The surfaces' absorption area in m²; NaN where unknown.
    bands : array (n_bands,) of bool
        Bands to take.
    """
    middle = bands & is_middle(room.centre_frequencies)
    area = float(before[middle if middle.any() else bands].mean())
    names, families, weights, sizes, covariances, of_air = [], [], [], [], [], []
    levels = area * np.geomspace(LEAST, MOST, SIZES)
    of_room = shapes(room, effects)
    odds = sum(shape.weight for shape in of_room)
    n = int(bands.sum())
    for side, sign in ((ADDED, 1.0), (REMOVED, -1.0)):
        for shape in of_room:
            spectrum = shape.spectrum[bands]
            for level in levels:
                names.append(f"{side} {shape.name}")
                families.append(", ".join(filter(None, [f"{side} absorption", shape.family])))
                weights.append(shape.weight / len(levels))
                sizes.append(sign * level * spectrum / spectrum.mean())
                covariances.append(shape.covariance[np.ix_(bands, bands)])
                of_air.append(False)
    climates = [4 * room.volume * m[bands] for m in _other_air(room)]
    for more in climates:
        names.append(AIR)
        families.append("climate")
        weights.append(2 * odds * AIR_ODDS / odds / len(climates))
        sizes.append(more)
        covariances.append(_AIR_ERROR**2 * np.eye(n))
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


def _other_air(room: Room) -> Iterator[Array]:
    """Yield by how much the attenuation of other climates differs in 1/m, (n_bands,)."""
    stated = room.air or Air()
    frequencies = room.centre_frequencies
    here = stated.attenuation(frequencies)
    for warmer in _WARMER:
        for humidity in _HUMIDITIES:
            temperature = float(np.clip(stated.temperature + warmer, -20, 50))
            other = Air(temperature, humidity, stated.pressure)
            if other != stated:
                yield other.attenuation(frequencies) - here


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
    """

    equation: LinearEquation
    total_area: float
    area: Array
    air: Array

    @classmethod
    def of(
        cls, room: Room, equation: LinearEquation, times: Array, bands: NDArray[np.bool_]
    ) -> Baseline:
        """Return the baseline of a room with T ``times`` in s, (n_bands,), in some of its bands.

        Raises InfeasibleError where no coefficients give T.
        """
        area = equation.absorption_area(room, np.where(bands, times, np.nan))[bands]
        return cls(equation, room.total_area, area, 4 * room.air_attenuation[bands] * room.volume)

    def after(self, size: Array) -> Array:
        """Return the surfaces' absorption area after a change in m², (..., n_bands).

        What is added covers surfaces: b + (S - b) (1 - exp(-size / (S - b))). What is removed, of a
        size below 0, leaves b exp(size / b). To first order both are b + size.
        """
        left = self._left(size)
        return np.asarray(self.area + np.sign(size) * left * -np.expm1(-np.abs(size) / left))

    def shift(self, size: Array, of_air: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the shift of ln T and its derivative by ln |size|, both (..., n_bands).

        Parameters
        ----------
        size : array (..., n_bands)
            Absorption area in m², before it saturates: of surfaces, or of the air.
        of_air : array (..., 1) of bool
            Of which it is.
        """
        mean = self.after(np.where(of_air, 0.0, size)) / self.total_area
        whole = self.whole(mean * self.total_area) + np.where(of_air, size, 0.0)
        before = self.whole(self.area)
        by_area = size * np.exp(-np.abs(size) / self._left(size)) * self.equation.slope(mean)
        slope = -np.where(of_air, size, by_area) / whole
        return np.asarray(-np.log(whole / before)), np.asarray(slope)

    def whole(self, area: Array) -> Array:
        """Return S a + 4 m V in m², of the surfaces' absorption area in m²."""
        exponent = self.equation.exponent(area / self.total_area)
        return np.asarray(self.total_area * exponent + self.air)

    def _left(self, size: Array) -> Array:
        """The area to cover, or to remove, in m²."""
        left = np.where(size > 0, self.total_area - self.area, self.area)
        return np.maximum(left, 1e-6 * self.total_area)


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
    """

    log_evidence: Array
    mean: Array
    covariance: Array


def none(change: Array, variance: Array, errors: Errors) -> float:
    """Return the log evidence that nothing changed.

    ``change`` and ``variance`` are (n_pairs, n_bands), NaN where nothing was measured.
    """
    n = change.shape[1]
    zero, noise = np.zeros((1, n)), np.zeros((1, n, n)) + errors.remeasured**2 * np.eye(n)
    by_scale = [
        _settled(change, scale**2 * variance[np.newaxis], zero, noise, errors)
        for scale in errors.scales
    ]
    return float(logsumexp(np.array(by_scale) + np.log(errors.weights)))


def fits(change: Array, variance: Array, baseline: Baseline, grid: Grid, errors: Errors) -> Fits:
    """Return the evidence of each hypothesis of the grid, and the sizes that each would have."""
    n, k = grid.size.shape
    evidence = np.full((n, len(errors.scales)), -np.inf)
    mean, covariance = np.zeros((*evidence.shape, k)), np.zeros((*evidence.shape, k, k))

    def evaluate(rows: Rows, j: int, steps: int) -> None:
        for some in np.array_split(rows, -(-len(rows) * len(change) // _MOST_AT_ONCE)):
            found = _fitted(change, variance, baseline, grid, some, errors, errors.scales[j], steps)
            evidence[some, j] = found[0] + np.log(errors.weights[j])
            mean[some, j], covariance[some, j] = found[1], found[2]

    usual = int(np.argmax(errors.weights))
    evaluate(np.arange(n), usual, _FIRST)
    likely = np.flatnonzero(evidence[:, usual] > evidence[:, usual].max() - _NEGLIGIBLE)
    evidence[:, usual] = np.where(np.isin(np.arange(n), likely), evidence[:, usual], -np.inf)
    for j in range(len(errors.scales)):
        evaluate(likely, j, _STEPS)
    return Fits(evidence, mean, covariance)


def _fitted(
    change: Array,
    variance: Array,
    baseline: Baseline,
    grid: Grid,
    rows: Rows,
    errors: Errors,
    scale: float,
    steps: int,
) -> tuple[Array, Array, Array]:
    """Return log evidence, and mean and covariance of the error of ln size, of some hypotheses."""
    size, prior, of_air = grid.size[rows], grid.covariance[rows], grid.of_air[rows, np.newaxis]
    stated, _ = baseline.shift(size, of_air)
    spread = scale**2 * variance + ((errors.pair * stated) ** 2)[:, np.newaxis]
    other = errors.remeasured**2 + (errors.common * stated) ** 2
    z, weight = np.zeros_like(size), np.ones((len(size), len(change)))
    for _ in range(steps):
        shift, slope = baseline.shift(size * np.exp(z), of_air)
        centre = shift - slope * z
        of_shift = slope[:, :, None] * prior * slope[:, None, :]
        whole = of_shift + other[:, :, None] * np.eye(size.shape[1])
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
    return log_evidence, z, covariance


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


def _settled(change: Array, spread: Array, centre: Array, prior: Array, errors: Errors) -> float:
    """Return the log evidence of one shift whose error is normal."""
    weight = np.ones((1, len(change)))
    for _ in range(_STEPS):
        found = _integrated(change, spread, centre, prior, errors, weight)
        weight = found[3]
    return float(found[0][0])
