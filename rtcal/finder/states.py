"""What changed between two states of one room: added or removed absorption, the climate, and where.

ln T of a pair shifts by m + e. m is the shift of all pairs: the predicted one, with the errors of the
spectrum and of the equation, what a remeasurement adds by itself, and what another climate adds, which
is as uncertain as both climates. e is what the pair has alone: noise of both states, and a share of
the shift. The noise of each pair has a scale of its own, so that e follows a multivariate t
distribution over the pair's bands; all pairs together have a further one. The integral over m is
Laplace's at the mode that Gauss-Newton steps find (docs/two_states.md).

Two states that are exchanged have the same answer, with "added" and "removed" exchanged and all changes
of the other sign. So the state of the longer T is the first in every search. Where both are the same,
the answer is half of each.

For the surfaces, coefficients are scaled to T before. Then sets of surfaces absorb more, each with a
share of the way to alpha = 1 that goes through the bands as a random walk, and the same paths are
weighed with them, so that the simulator's error cancels to first order. Each set is weighed with the
same climate in both states and with another one. A source whose level shifts otherwise than T says has
another gain in the two states, and its level is left out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, expit, gammaln, logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import DB, EARLY, LEVEL, MATCH, OBSERVABLES, TARGET, gradients
from rtcal.acoustics.room import Directivity, Room
from rtcal.finder.case import CLIMATE_UNCERTAINTY, StatesCase
from rtcal.finder.claim import (
    CLAIMED,
    SAID,
    Candidate,
    Detection,
    Reason,
    Size,
    conclude,
    most_probable_first,
    over_frequency,
    summed,
)
from rtcal.finder.effects import Effect, checked_effects
from rtcal.finder.evidence import (
    NO_EFFECT,
    NONE,
    UNKNOWN,
    UNKNOWN_ODDS,
    left_out_of,
    log_priors,
    with_columns,
)
from rtcal.finder.finding import Finding
from rtcal.finder.model import RoomState
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.weighing import Weighing, interpolation
from rtcal.simulators import base
from rtcal.simulators.base import Observations
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import DataError
from rtcal.support.normal import symmetric_root
from rtcal.support.types import Array

ADDED, REMOVED, AIR = "added", "removed", "air"
_FAMILY = "added absorption"
WALK = 0.5
"""Standard deviation per octave of ln absorption, for a spectrum that no effect of the library has."""
LEAST, MOST = 0.02, 6.0
"""Sizes that are tried, over the absorption area before at 500 to 2000 Hz."""
SIZES = 25
INDOORS = (15.0, 30.0), (20.0, 70.0)
"""Temperatures in °C and relative humidities in % that are assumed for a room without an input
climate."""
AIR_ODDS = 0.5
"""Odds before the measurement that only the climate changed, relative to an effect of odds 1."""
ANOTHER_CLIMATE = 0.5
"""Probability before the measurement that the climate changed as well, if absorption changed."""
THRESHOLD = float(np.log(20))
"""Score from which a change is detected: ln 20, which is exceeded in at most one of twenty cases in
which nothing changed, because the mean Bayes factor is then 1 (Markov's inequality)."""
_SAMPLES = 4000
_INTERVAL = (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hold the possible changes between two states of a room: none, or absorption added or removed."""

    names: tuple[str, ...]
    families: tuple[str, ...]
    log_weight: Array  # prior, (n,)
    size: Array  # change of the absorption area in m² before saturation, (n, n_bands)
    covariance: Array  # of ln |size|, (n, n_bands, n_bands)
    of_air: NDArray[np.bool_]  # whether the climate differs, too

    @classmethod
    def of(
        cls,
        room: Room,
        before: Array,
        where: NDArray[np.bool_],
        effects: Sequence[Effect],
        without: Collection[str],
        more: str,
    ) -> Hypotheses:
        """Return the changes by ``effects`` but those ``without``, in the bands ``where`` T is known.

        ``more`` is the word for a size above 0, "added" or "removed".
        """
        area = float(before[bands.is_middle(room.centre_frequencies[where])].mean())
        levels, n = area * np.geomspace(LEAST, MOST, SIZES), int(where.sum())
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
            for side, sign in ((more, 1.0), (_OTHER[more], -1.0))
            for name, kind, weight, spectra, covariance in _shapes(room, where, effects, without)
            for spectrum in spectra
            for level in levels
            for another, probability in climates.items()
        ]
        if AIR not in without:
            rows.append((AIR, "climate", 2 * AIR_ODDS, np.zeros(n), np.eye(n), True))
        none, _, *log_weight = log_priors([row[2] for row in rows], off=0.0).tolist()
        rows.insert(0, (NONE, NONE, 0.0, np.zeros(n), np.eye(n), False))
        names, families, _, sizes, covariances, of_air = zip(*rows, strict=True)
        weights = np.array([none, *log_weight])
        arrays = weights, np.array(sizes), np.array(covariances), np.array(of_air)
        return cls(names, families, *arrays)


_OTHER = {ADDED: REMOVED, REMOVED: ADDED}


def _turned(name: str) -> str:
    """Return the name of an effect or a family with "added" and "removed" exchanged."""
    side, space, rest = name.partition(" ")
    return f"{_OTHER.get(side, side)}{space}{rest}"


def adding(effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that add absorption, sorted by name; their spectra are tried for a change."""
    some = [effect for effect in effects if effect.family.startswith(f"{_FAMILY}, ")]
    return sorted(some, key=lambda effect: effect.name)


def tried(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of the changes that are tried between two states with a library of effects."""
    return (*(effect.name for effect in adding(effects)), AIR, UNKNOWN)


def _shapes(
    room: Room, where: NDArray[np.bool_], effects: Sequence[Effect], without: Collection[str]
) -> Iterator[tuple[str, str, float, Array, Array]]:
    """Yield name, kind, odds, spectra of mean 1, and the covariance of their logarithm."""
    frequencies = room.centre_frequencies
    base = RoomState.of_room(room, np.zeros(len(room.areas)))
    for effect in adding(effects):
        if effect.name in without:
            continue
        every = [alpha for _, alpha in effect.on_surface(frequencies)]
        if not every:  # objects: what one size of them adds in m²
            after = effect.change(base, effect.grid(base)[0])
            added = after.surface_absorption - base.surface_absorption
            every = [np.asarray(added + after.objects - base.objects)]
        # A coefficient of 0 is a thousandth of the largest.
        raised = [np.maximum(alpha, 1e-3 * alpha.max()) for alpha in every]
        spectra = np.array([alpha / alpha.mean() for alpha in raised])[:, where]
        kind = effect.family.removeprefix(f"{_FAMILY}, ")
        if kind in KINDS.values() and where.sum() > 1:
            # By the rule of the change which is found, so that both agree: furniture, of the
            # library's family "flat", rises twofold. A kind that the library does not have stays.
            kind = KINDS[over_frequency(spectra.mean(axis=0))]
        weight = effect.prior_odds(room) / len(every)
        error = effect.error_over_bands(frequencies)[np.ix_(where, where)]
        yield effect.name, kind, weight, spectra / spectra.mean(axis=1, keepdims=True), error
    if UNKNOWN not in without:
        octaves = np.log2(frequencies[where] / 1000)
        far, apart = np.abs(octaves), np.abs(np.subtract.outer(octaves, octaves))
        # A random walk from 0 in both directions.
        walk = WALK**2 * (far[:, np.newaxis] + far - apart) / 2
        yield UNKNOWN, "", UNKNOWN_ODDS, np.ones((1, len(octaves))), walk


KINDS = {
    "rising with frequency": "rising",
    "alike at all frequencies": "flat",
    "falling with frequency": "low",
}
"""Names of the groups of effects by the trend of their spectra over frequency."""


def _climate_covariance(
    room: Room, uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY
) -> Array:
    """Return the covariance in m⁴ of the difference of 4 m V between two climates, (n_bands, n_bands).

    Both are normal about the room's climate; if the room has none, each is any indoor one.
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


_NODES = 4  # nodes of a quadrature over temperatures, and over humidities


@dataclass(frozen=True, eq=False)
class Baseline:
    """Hold the absorption of a room before a change, in the bands that both states have."""

    equation: LinearEquation
    total_area: float
    area: Array  # absorption area of the surfaces in m², (n_bands,)
    air: Array  # 4 m V in m²
    climate: Array  # covariance of ln T by the climate, (n_bands, n_bands)

    @classmethod
    def of(cls, case: StatesCase, times: Array) -> Baseline:
        """Return the absorption before a change; InfeasibleError if no coefficients give T before."""
        room, where = case.room, case.known
        area = case.equation.absorption_area(room, np.where(where, times[0], np.nan))[where]
        air = 4 * room.air_attenuation[where] * room.volume
        made = cls(case.equation, room.total_area, area, air, np.zeros((len(area), len(area))))
        whole = made.whole(area) * np.sqrt(times[0][where] / times[1][where])
        of_air = _climate_covariance(room, case.climate_uncertainty)[np.ix_(where, where)]
        return replace(made, climate=of_air / np.outer(whole, whole))

    def after(self, size: Array) -> Array:
        """Return the absorption area of the surfaces in m² after a change, (..., n_bands).

        Added absorption covers surfaces: b + (S - b) (1 - exp(-size / (S - b))). Removed absorption
        leaves b exp(size / b). A small change is therefore equal to its size.
        """
        left = self._left(size)
        covered = -np.expm1(-np.minimum(np.abs(size) / left, _MOST_COVERED))
        return np.asarray(self.area + np.sign(size) * left * covered)

    def shift(self, size: Array) -> tuple[Array, Array]:
        """Return the change of ln T by a change of absorption, and its derivative by ln |size|."""
        mean = self.after(size) / self.total_area
        whole, before = self.whole(mean * self.total_area), self.whole(self.area)
        by_area = size * np.exp(-np.abs(size) / self._left(size)) * self.equation.slope(mean)
        return np.asarray(-np.log(whole / before)), np.asarray(-by_area / whole)

    def whole(self, area: Array) -> Array:
        """Return the absorption area of surfaces and air in m², from that of the surfaces in m²."""
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
_USUAL = 1  # number of the most probable scale
_STEPS = 12  # most Gauss-Newton steps
_SETTLED = 1e-3  # largest last step of ln size
_WEIGHINGS = 5  # steps of the pairs' weights at each of them
_FIRST = 3  # Gauss-Newton steps before the hypotheses that explain the data badly are dropped
_NEGLIGIBLE = 25.0  # evidence in nats below the best hypothesis', from which one is dropped
_MOST_AT_ONCE = 20_000  # pairs times hypotheses that are computed at once


@dataclass(frozen=True, eq=False)
class Fits:
    """Hold how well each change fits the data with each scale of the noise, and its best size."""

    log: Array  # density of the data times prior, (n, n_scales)
    mean: Array  # of ln(best size / size), (n, n_scales, n_bands)
    covariance: Array
    shift: Array  # mean change of ln T by size and climate, (n, n_scales, n_bands)


def _chance_of_climate(change: Array, variance: Array, baseline: Baseline, degrees: float) -> float:
    """Return the p-value, by chi-square, of the mean change of ln T if only the climate differs."""
    n = change.shape[1]
    prior, best, inverse = baseline.climate + REMEASURED**2 * np.eye(n), -np.inf, variance
    for scale, probability in SCALES.items():
        spread, weight = scale**2 * variance[np.newaxis], np.ones((1, len(change)))
        for _ in range(_STEPS):
            evidence, _, _, weight = _integrated(
                change, spread, np.zeros((1, n)), prior[np.newaxis], degrees, weight
            )
        if (log := float(evidence[0]) + math.log(probability)) > best:
            best, inverse = log, np.minimum(weight[0], 1.0)[:, np.newaxis] / spread[0]
    inverse = np.where(np.isfinite(change), inverse, 0.0)
    precision = inverse.sum(axis=0)
    mean = np.nansum(inverse * change, axis=0) / precision
    square = mean @ np.linalg.solve(prior + np.diag(1 / precision), mean)
    return float(chdtrc(n, square))


def fits(
    change: Array, variance: Array, baseline: Baseline, of: Hypotheses, degrees: float
) -> Fits:
    """Return the log evidence of each change, and its best size, from ln T (n_pairs, n_bands)."""
    n, k = of.size.shape
    shape = n, len(SCALES)
    found = Fits(
        np.full(shape, -np.inf),
        np.zeros((*shape, k)),
        np.zeros((*shape, k, k)),
        np.zeros((*shape, k)),
    )

    def evaluate(rows: NDArray[np.intp], j: int, steps: int) -> None:
        scale, probability = [*SCALES.items()][j]
        for some in np.array_split(rows, -(-len(rows) * len(change) // _MOST_AT_ONCE)):
            evidence, *rest = _fitted(
                change, scale**2 * variance, baseline, of, some, degrees, steps
            )
            found.log[some, j] = evidence + math.log(probability)
            for values, of_some in zip(
                (found.mean, found.covariance, found.shift), rest, strict=True
            ):
                values[some, j] = of_some

    evaluate(np.arange(n), _USUAL, _FIRST)
    first = found.log[:, _USUAL]
    kept = first > first.max() - _NEGLIGIBLE
    kept[0] = True  # that nothing changed
    first[~kept] = -np.inf
    for j in range(len(SCALES)):
        evaluate(np.flatnonzero(kept), j, _STEPS)
    found.log[:] += of.log_weight[:, np.newaxis]
    return found


def _fitted(
    change: Array,
    variance: Array,
    baseline: Baseline,
    of: Hypotheses,
    rows: NDArray[np.intp],
    degrees: float,
    steps: int,
) -> tuple[Array, Array, Array, Array]:
    """Return the `Fits` of some hypotheses with one scale, without the scale's prior probability."""
    size, prior = of.size[rows], of.covariance[rows]
    of_air = of.of_air[rows, np.newaxis, np.newaxis] * baseline.climate
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

    Of each pair's own variance ``spread`` (n or 1, n_pairs, n_bands), and mean ``centre`` (n,
    n_bands) and covariance ``prior`` of the shift before the measurement.
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


def find(
    case: StatesCase,
    *,
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Finding:
    """Return what changed between two states of a room, from T20 or T30; see `rtcal.find`."""
    of_library = checked_effects(effects)
    if not adding(of_library):
        raise DataError(
            "between two measurements only a change of absorption can be found, but none "
            "of the effects adds absorption; name other effects"
        )
    left_out = left_out_of(only, without, tried(of_library), [UNKNOWN])
    room, where, degrees = case.room, case.known, OF_MEANS if case.of_means else DEGREES
    sign, more, times = 1.0, ADDED, case.times
    if not case.falls:
        sign, more, times = -1.0, REMOVED, case.times[::-1]
    change, variance = sign * case.change[:, where], case.variance[:, where]
    baseline = Baseline.of(case, times)
    every = Hypotheses.of(room, baseline.area, where, of_library, left_out, more)
    found = fits(change, variance, baseline, every, degrees)
    nothing, something = float(logsumexp(found.log[0])), float(logsumexp(found.log[1:]))
    score = something - nothing - float(np.log(1 / NO_EFFECT - 1))
    none = float(expit(nothing - something))
    chances = np.exp(found.log - something)  # given that something changed
    chances[0] = 0.0
    given = chances.sum(axis=1)
    names, families = [every.names], [every.families]
    if case.same:  # half of each order
        names, families = ([of, tuple(map(_turned, of))] for of in (every.names, every.families))
    shares = (np.tile(given / len(names), len(names)) * (1 - none)).tolist()
    probabilities, of_kinds = (
        summed([(NONE, none), *zip(chain(*of), shares, strict=True)]) for of in (names, families)
    )
    of_families = dict(of_kinds)
    for whole in (f"{side} absorption" for side in (ADDED, REMOVED)):
        of_families[whole] = sum(p for kind, p in of_kinds.items() if kind.startswith(whole))
    of_families = most_probable_first(of_families)
    detection = Detection(score, THRESHOLD)
    reasons = [Reason("one file")] if case.same else []
    if detection.verdict is None and probabilities.get(AIR, 0.0) >= CLAIMED:
        chance = _chance_of_climate(change, variance, baseline, degrees)
        if chance < _LEAST_CHANCE:
            reasons.append(Reason("not the climate alone", {"chance": chance}))
    asked = [name for name in tried(of_library) if name not in (*left_out, UNKNOWN)]
    known = sum(p for name, p in probabilities.items() if not name.endswith(UNKNOWN)) - none
    if left_out and asked and detection.verdict is None and known < SAID:
        reasons.insert(0, Reason("not as asked", {"effects": asked, "probability": known}))
    by_family_alone = [name for name in probabilities if name != AIR]
    claim = conclude(detection.verdict, probabilities, of_families, by_family_alone, reasons)
    family = claim.family
    of_surfaces = given * every.size.any(axis=1)
    frequencies = room.centre_frequencies[where]
    changes, shift = np.full((3, room.n_bands), np.nan), np.full(room.n_bands, np.nan)
    middle, of_sample, climate = np.zeros(0), np.zeros(0, dtype=str), 0.0
    inside = bands.is_middle(frequencies)
    if of_surfaces.any():
        drawn, rows = _samples(found, every, baseline, of_surfaces, seed)
        # Of one state twice, each beside its mirror image: their mean is 0 to the last digit.
        samples = np.stack([sign * drawn, -sign * drawn][: len(names)], axis=1)
        samples = samples.reshape(-1, drawn.shape[1])
        of_sample = np.stack([np.array(of)[rows] for of in names], axis=1).ravel()
        changes[0, where] = samples.mean(axis=0)
        changes[1:, where] = np.quantile(samples, _INTERVAL, axis=0)
        middle = samples[:, inside].mean(axis=1)
        # What is removed from a surface saturates: the change goes less, or more, than the spectrum.
        whole, _, kind = (family or "").partition(", ")
        if kind in KINDS.values() and where.sum() > 1:
            family = family if KINDS[over_frequency(changes[0, where])] == kind else whole
        climate = float((of_surfaces * every.of_air).sum() / of_surfaces.sum())
    shift[where] = 0.0 if case.same else sign * np.einsum("ns,nsk->k", chances, found.shift)
    probable = [n for n, p in probabilities.items() if n != NONE and p >= SAID]
    probable = [name for name in probable if name == AIR or (of_sample == name).any()]
    surfaces, sets, gains, note = _located(
        case, family, of_families, change, variance, degrees, seed, AIR not in left_out
    )
    area = case.equation.absorption_area(room, np.where(where, case.times[0], np.nan))
    kind_of = dict(zip(chain(*names), chain(*families), strict=True))
    return Finding(
        case=case,
        verdict=claim.verdict,
        family=family,
        named=claim.named,
        probabilities=probabilities,
        families=of_families,
        detection=detection,
        effects={effect.name: effect for effect in of_library},
        candidates=tuple(
            Candidate(
                effect=name,
                family=kind_of[name],
                probability=probabilities[name],
                **_size(middle[of_sample == name]).fields,
            )
            for name in probable
        ),
        area=area,
        change=changes,
        shift=shift,
        size=_size(middle),
        middle=tuple(frequencies[inside].tolist()),
        surfaces=surfaces,
        sets=sets,
        climate=climate,
        left_out=left_out,
        reasons=(*([Reason("gains differ", {"gains": gains})] if gains else []), *reasons),
        notes=(*case.notes, *([] if note is None else [note])),
    )


_LEAST_CHANCE = 0.05
"""Least p-value of what is named: of true changes of the climate one in twenty is not."""


def _samples(
    found: Fits, every: Hypotheses, baseline: Baseline, given: Array, seed: int
) -> tuple[Array, NDArray[np.intp]]:
    """Return samples of the change of the absorption area in m², (n, n_bands), and their hypotheses."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(given), _SAMPLES, p=given / given.sum())
    of_rows = found.log[rows]
    by_scale = np.exp(of_rows - logsumexp(of_rows, axis=1, keepdims=True))
    beyond = rng.random(_SAMPLES)[:, np.newaxis] > np.cumsum(by_scale, axis=1)
    scale = np.minimum(beyond.sum(axis=1), by_scale.shape[1] - 1)
    mean, root = found.mean[rows, scale], symmetric_root(found.covariance[rows, scale])
    z = mean + np.einsum("nkl,nl->nk", root, rng.standard_normal(mean.shape))
    return baseline.after(every.size[rows] * np.exp(z)) - baseline.area, rows


def _size(samples: Array) -> Size:
    """Return the size of samples in m²; NaN of none, where no surface is taken to have changed."""
    if not len(samples):
        return Size(math.nan, math.nan, math.nan, "m²")
    low, high = np.quantile(samples, _INTERVAL)
    return Size(float(samples.mean()), float(low), float(high), "m²")


MOST_SURFACES = 8
"""Largest number of surfaces of which combinations are tried; the largest surfaces are taken."""
NODES = (0.08, 0.25, 0.55, 1.0)
"""Shares of the way to alpha = 1 that are weighed; between them the shifts are interpolated."""
SHARES = np.geomspace(0.02, 0.95, 30)
POWER = 0.5
"""Power of the likelihood, below 1 because pairs and parameters share errors that are not modelled."""
MOST_DIRECT = 0.76
"""Share of the direct sound in the energy, 5 dB above the rest, from which EDT is not used."""
ANOTHER_GAIN = 0.3
"""Prior probability that sources have another gain in the second state. In three boxes of another's
tracer, two draws each, gains of 1.0 to 1.2 dB made 5 of 12 answers wrong without it, none with it."""
GAIN = 1.5
"""Standard deviation in dB, per band, of a source's change of gain between two states, if it has
one."""
MOST_GAIN = 1.5
"""Shift in dB of a source's level, relative to that from T, above which its level is left out."""
_MISSING = 1e6
_TINY = 1e-8


def _located(
    case: StatesCase,
    family: str | None,
    families: Mapping[str, float],
    change: Array,
    variance: Array,
    degrees: float,
    seed: int,
    climate: bool,
) -> tuple[
    Mapping[str, float], Mapping[tuple[str, ...], float], Mapping[str, float], Reason | None
]:
    """Return probabilities of surfaces and of sets of them, gains, and why no surface is identified.

    A gain is of a source whose level is left out. Without absorption only gains are found.
    """
    tracer = case.simulator
    if tracer is None:
        return {}, {}, {}, Reason("no geometry")
    absorption = family is not None and "absorption" in family
    sources = [*dict.fromkeys(source for source, _ in case.pairs)]
    stated = tracer.directivity
    if unstated := tuple(s for s in sources if not isinstance(stated.get(s), Directivity)):
        why = Reason("no directivity", {"sources": unstated}) if absorption else None
        return {}, {}, {}, why
    states, sign = case.states, 1.0  # the second absorbs more
    forth = families[f"{ADDED} absorption"] > families[f"{REMOVED} absorption"]
    if not (forth if absorption else case.falls):
        states, sign = (states[1], states[0]), -1.0
    wanted = dict.fromkeys((TARGET.key, *tracer.trusted(MATCH)))
    match = [n for n in wanted if all(OBSERVABLES[n].key_in(m.values) in m.values for m in states)]
    level = match.index(LEVEL.key) if LEVEL.key in match else None
    if not absorption and level is None:
        return {}, {}, {}, None
    pairs, frequencies = case.pairs, tracer.centre_frequencies
    rows = [tracer.pairs.index(p) for p in pairs]
    two = [Observations.of_measurement(m, match, pairs).values for m in states]
    moved = two[1] - two[0]
    weighing = _scaled_to(tracer, states[0], match, rows, seed)
    energy = weighing.energy(weighing.alpha)[0]
    gains = dict[str, float]()
    if level is not None:
        times = [m.reverberation_time for m in states]
        gains = _gains(tracer, pairs, energy[rows], times, moved[level])
        moved[level][[source in gains for source, _ in pairs]] = np.nan
    of_gains = {source: sign * gain for source, gain in gains.items()}
    if not absorption:
        return {}, {}, of_gains, None
    direct = energy[rows, :, 0] / energy[rows].sum(axis=-1)
    if EARLY.key in match:
        moved[match.index(EARLY.key)][direct > MOST_DIRECT] = np.nan
    # How far each pair's differences of ln T lie from the pairs' mean tells how noisy the pair is.
    mean = np.nansum(change / variance, axis=0) / np.nansum(1 / variance, axis=0)
    squares = np.nansum((change - mean) ** 2 / variance, axis=1)
    weights = np.minimum(1.0, (degrees + np.isfinite(change).sum(axis=1)) / (degrees + squares))
    shorter = np.nanmean(np.exp(two[0][0] - two[1][0]), axis=0) if match[0] == TARGET.key else 1.0
    noise = _noise(energy[rows], tracer, match) * (1 + np.asarray(shorter))[:, None, None]
    noise = noise / weights[:, None, None, None]
    faces = of_room.of_geometry(tracer.geometry)
    # One, two, three walls, and all walls.
    area = {n: float(tracer.geometry.face_areas[f].sum()) for n, f in faces.items()}
    largest = sorted(sorted(area, key=lambda n: -area[n])[:MOST_SURFACES])
    upright = [n for n in largest if of_room.kind(tracer.geometry, faces[n]) == "wall"]
    tried: list[tuple[str, ...]] = [(n,) for n in largest]
    tried += [*combinations(largest, 2), *combinations(upright, 3)]
    tried += [tuple(upright)] if len(upright) > 3 else []
    groups = [np.concatenate([faces[n] for n in names]) for names in tried]
    base = _observed(energy, tracer, match)
    shifts = np.array(
        [
            [_observed(decay, tracer, match) - base for decay in decays]
            for decays in weighing.of_groups(groups, NODES)
        ]
    )[:, :, :, rows]
    # What a decay lacks under any set counts for none: EDT, where the direct sound is all there is.
    moved[~np.isfinite(shifts).all(axis=(0, 1))] = np.nan
    shifts = np.where(np.isfinite(shifts), shifts, 0.0)
    # What pairs may err by together: columns (n_pairs, n_bands, n_parameters, n_errors), variances.
    shape = len(pairs), len(frequencies), len(match)
    shared = np.broadcast_to(np.eye(len(match)), (*shape, len(match)))
    again = np.array([OBSERVABLES[name].remeasured for name in match]) ** 2
    others: list[tuple[float, Array, Array]] = []
    if level is not None:
        own = np.array([[source == name for name in sources] for source, _ in pairs], dtype=float)
        columns = np.zeros((*shape, len(sources)))
        columns[:, :, level] = own[:, np.newaxis]
        others.append((ANOTHER_GAIN, columns, np.full(len(sources), GAIN**2)))
    if climate:
        of_two = np.diag(_climate_covariance(case.room, case.climate_uncertainty))
        attenuation = tracer.room.air_attenuation + np.sqrt(of_two) / (4 * case.room.volume)
        in_it = _observed(weighing.energy(weighing.alpha, attenuation)[0], tracer, match)
        by_air = np.nan_to_num(np.moveaxis((in_it - base)[:, rows], 0, -1))
        others.append((ANOTHER_CLIMATE, by_air[..., np.newaxis], np.ones(1)))
    evidence = np.full(len(shifts), -np.inf)
    for taken in product((False, True), repeat=len(others)):
        some = [other for other, there in zip(others, taken, strict=True) if there]
        columns = np.concatenate([shared, *(of for _, of, _ in some)], axis=3)
        least = np.concatenate([again, *(of for _, _, of in some)])
        log = [_evidence(moved, s, noise, match, frequencies, (columns, least)) for s in shifts]
        odds = [p if there else 1 - p for (p, _, _), there in zip(others, taken, strict=True)]
        evidence = np.logaddexp(evidence, np.log(np.prod(odds)) + np.array(log))
    chances = dict(zip(tried, np.exp(evidence - logsumexp(evidence)).tolist(), strict=True))
    by_surface = {n: sum(p for names, p in chances.items() if n in names) for n in faces}
    return most_probable_first(by_surface), most_probable_first(chances), of_gains, None


def _gains(
    simulator: PathTracing,
    pairs: Sequence[tuple[str, str]],
    energy: Array,
    times: Sequence[Array],
    change: Array,
) -> dict[str, float]:
    """Return by how many dB a source's level shifts beside what T says, if by `MOST_GAIN` or more.

    By T every path but the direct one, in the first bin, loses in proportion to its length.
    """
    ends = np.array([(simulator.sources[s], simulator.receivers[r]) for s, r in pairs], dtype=float)
    arrival = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / simulator.room.speed_of_sound
    seconds = arrival[:, np.newaxis] + simulator.bin_width * np.arange(energy.shape[-1])
    faster = 6 * np.log(10) * (1 / times[1] - 1 / times[0])
    kept = np.exp(-faster[:, np.newaxis] * seconds[:, np.newaxis])
    kept[..., 0] = 1.0
    off = change - DB * np.log((energy * kept).sum(axis=-1) / energy.sum(axis=-1))
    means = {}
    for source in dict.fromkeys(s for s, _ in pairs):
        own = off[[s == source for s, _ in pairs]]
        if np.isfinite(own).any() and abs(mean := float(np.nanmean(own))) >= MOST_GAIN:
            means[source] = mean
    return means


def _scaled_to(
    simulator: PathTracing, before: Measurement, match: Sequence[str], rows: list[int], seed: int
) -> Weighing:
    """Return a weighing whose coefficients have T before: the stated ones, scaled band by band."""
    wanted = before.reverberation_time
    tracer = simulator
    factor = np.ones(simulator.room.n_bands)
    for _ in range(3):
        weighing = Weighing(tracer, match, seed)
        (of_t20,) = _observed(weighing.energy(weighing.alpha)[0], simulator, (TARGET.key,))
        simulated = np.exp(of_t20[rows])
        room = tracer.room
        air = 4 * room.air_attenuation * room.volume
        constant = 24 * np.log(10) / room.speed_of_sound * room.volume
        damped = np.maximum(constant / np.array([wanted, simulated.mean(axis=0)]) - air, 1e-3)
        factor = np.where(np.isfinite(wanted), damped[0] / damped[1], 1.0)
        alpha = -np.expm1(factor * np.log1p(-np.minimum(room.alpha, base.LARGEST_ALPHA)))
        scaled = replace(tracer, room=room.replace(alpha=np.clip(alpha, 1e-4, 0.99)))
        scaled._traced.update(tracer._traced)  # alpha weighs the same paths
        tracer = scaled
    return Weighing(tracer, match, seed)


def _observed(energy: Array, simulator: PathTracing, match: Sequence[str]) -> Array:
    """Return the parameters of decays as observed, (n_parameters, n_pairs, n_bands); NaN without."""
    kinds = [OBSERVABLES[name] for name in match]
    return np.array([k.observed(k.value(energy, simulator.bin_width)) for k in kinds])


def _noise(energy: Array, simulator: PathTracing, match: Sequence[str]) -> Array:
    """Return the covariance of the parameters of noise-like responses, (n_pairs, n_bands, n, n).

    A bin of width w has the relative variance 1 / (B w) in a band of bandwidth B.
    """
    width = simulator.bin_width
    by_bin = gradients(energy, width, match) * energy[None]
    by_bin[..., 0] = 0.0
    f = simulator.centre_frequencies
    bandwidth = bands.bandwidth_factor(f) * f
    covariance = np.einsum("prkb,qrkb->rkpq", by_bin, by_bin)
    return np.asarray(np.nan_to_num(covariance / (bandwidth * width)[:, None, None]))


def _evidence(
    change: Array,
    shifts: Array,
    noise: Array,
    match: Sequence[str],
    frequencies: Array,
    common: tuple[Array, Array],
) -> float:
    """Return the log evidence of a set of surfaces, over random walks of ln share through the bands.

    Of a ``change`` (n_parameters, n_pairs, n_bands), ``shifts`` (n_nodes, same), ``noise``
    (n_pairs, n_bands, n_parameters, n_parameters), and errors in ``common`` with their variance.
    """
    predicted = np.einsum("jn,nprk->jrkp", interpolation(NODES, SHARES), shifts)
    mean = predicted.mean(axis=1)  # over the pairs: (n_shares, n_bands, n_parameters)
    observed = np.moveaxis(change, 0, -1)
    known = np.isfinite(observed)
    off = np.where(known, observed - predicted, 0.0)
    one = np.eye(len(match))
    own = np.where(known, 0.0, _MISSING)[None] + (PAIR * mean[:, None]) ** 2
    own_covariance = noise[None] + (own[..., None] + _TINY) * one
    inverse = np.linalg.inv(own_covariance)
    pulled = np.einsum("jrkpq,jrkq->jrkp", inverse, off)
    columns, least = common
    variance = np.broadcast_to(least, (*mean.shape[:2], len(least))).copy()
    variance[..., : len(match)] += (COMMON * mean) ** 2
    b = np.einsum("rkpc,jrkp->jkc", columns, pulled)
    held = np.einsum("rkpc,jrkpq,rkqd->jkcd", columns, inverse, columns, optimize=True)
    squares = np.einsum("jrkp,jrkp->jk", off, pulled)
    half = np.linalg.slogdet(own_covariance)[1].sum(axis=1) / 2
    root = np.sqrt(variance)[..., None]
    square, half = with_columns(
        squares[..., None], half[..., None], root * b[..., None], root * held * root.swapaxes(2, 3)
    )
    log_likelihood = (-POWER * (square / 2 + half)[..., 0]).T  # (n_bands, n_shares)
    steps = np.subtract.outer(np.log(SHARES), np.log(SHARES))
    at = np.full(len(SHARES), -np.log(len(SHARES)))
    last = None
    for k in np.flatnonzero(known.any(axis=(0, 2))).tolist():
        if last is not None:
            spread = WALK**2 * abs(float(np.log2(frequencies[k] / frequencies[last])))
            move = -(steps**2) / (2 * spread)
            move = move - logsumexp(move, axis=0)
            at = logsumexp(move + at, axis=1)
        at = at + log_likelihood[k]
        last = k
    return float(logsumexp(at))
