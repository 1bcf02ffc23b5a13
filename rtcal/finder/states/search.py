"""The search for what changed between two states.

On which surface it changed, every pair's differences say, on the same paths. The coefficients are
scaled to T before. Then sets of surfaces absorb more, each with a share of the way to alpha = 1
that goes through the bands as a random walk, and the same paths are weighed with them. In the
difference of two weighings the simulator's error and the coefficients' cancel to first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import band_conversion, bands
from rtcal.acoustics.decay import gradients
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import EARLY, OBSERVABLES, TARGET
from rtcal.finder.candidate import Candidate, Size
from rtcal.finder.claim import SAID, claimed, most_probable_first
from rtcal.finder.effects import Effect, library
from rtcal.finder.finding import Detection
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.surfaces import Faces
from rtcal.finder.positions.weighing import Weighing
from rtcal.finder.prior import NO_EFFECT, NONE
from rtcal.finder.states import evidence
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import ADDED, AIR, REMOVED, Baseline, Errors, Fits, Grid, grid
from rtcal.finder.states.finding import StatesFinding
from rtcal.simulators import observations
from rtcal.simulators.observations import Observations
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.text import first_of
from rtcal.support.types import Array

MOST_SURFACES = 8
"""Largest number of surfaces of which sets are tried: the largest ones."""
NODES = (0.08, 0.25, 0.55, 1.0)
"""Shares of the way to alpha = 1 that are weighed; between them the shifts are interpolated."""
SHARES = np.geomspace(0.02, 0.95, 30)
WALK = 0.5
"""Standard deviation per octave of ln share."""
PAIR, COMMON = 0.15, 0.1
"""Error of a pair's shift, and of all pairs', over the mean shift of a parameter and band."""
POWER = 0.5
"""Power of the likelihood: pairs and parameters share errors that no covariance of this module has."""
MOST_DIRECT = 0.76
"""Share of the direct sound in the energy, 5 dB above the rest, from which EDT says nothing."""
_MISSING = 1e6
_TINY = 1e-8


@dataclass(frozen=True, eq=False)
class Located:
    """On which surfaces something changed.

    Attributes
    ----------
    surfaces : mapping of str to float
        Probability of each surface, the most probable first.
    sets : mapping of (names of surfaces) to float
        Of the sets that were tried, the most probable first.
    """

    surfaces: Mapping[str, float]
    sets: Mapping[tuple[str, ...], float]


def sets_of(simulator: PathTracing, surfaces: Mapping[str, Faces]) -> list[tuple[str, ...]]:
    """Return the sets of surfaces that are tried: one, two, three walls, and all walls."""
    area = {n: float(simulator.geometry.face_areas[f].sum()) for n, f in surfaces.items()}
    largest = sorted(sorted(area, key=lambda n: -area[n])[:MOST_SURFACES])
    upright = [n for n in largest if of_room.kind(simulator.geometry, surfaces[n]) == "wall"]
    out: list[tuple[str, ...]] = [(n,) for n in largest]
    out += combinations(largest, 2)
    out += combinations(upright, 3)
    if len(upright) > 3:
        out.append(tuple(upright))
    return out


def locate(
    simulator: PathTracing,
    before: Measurement,
    after: Measurement,
    match: Sequence[str],
    weights: Array,
    surfaces: Mapping[str, Faces] | None = None,
    seed: int = 0,
) -> Located:
    """Return the probability of each surface that it absorbs more after than before.

    Parameters
    ----------
    simulator : PathTracing
        With every source's directivity.
    before, after : Measurement
        Of the same pairs of the simulator, in the room's bands; before absorbs less.
    match : sequence of str
        Parameters that are compared.
    weights : array (n_pairs,)
        Precision of each pair's noise over the expected one.
    """
    faces = of_room.of_geometry(simulator.geometry) if surfaces is None else surfaces
    pairs = before.pairs
    rows = [simulator.pairs.index(p) for p in pairs]
    two = [Observations.of_measurement(m, match, pairs).values for m in (before, after)]
    change = two[1] - two[0]
    weighing = _scaled_to(simulator, before, match, rows, seed)
    energy = weighing.energy(weighing.alpha)[0]
    base = _heard(energy, simulator, match)
    noise = _noise(energy[rows], simulator, match)
    direct = energy[rows, :, 0] / energy[rows].sum(axis=-1)
    if EARLY.key in match:
        change[list(match).index(EARLY.key)][direct > MOST_DIRECT] = np.nan
    shorter = np.nanmean(np.exp(two[0][0] - two[1][0]), axis=0) if match[0] == TARGET.key else 1.0
    noise = noise * (1 + np.asarray(shorter))[:, None, None] / weights[:, None, None, None]
    tried = sets_of(simulator, faces)
    groups = [np.concatenate([faces[n] for n in names]) for names in tried]
    shifts = np.array(
        [
            [np.zeros_like(base), *(_heard(decay, simulator, match) - base for decay in decays)]
            for decays in weighing.of_groups(groups, NODES)
        ]
    )[:, :, :, rows]
    # What a decay lacks under any set counts for none: EDT, where the direct sound is all there is.
    change[~np.isfinite(shifts).all(axis=(0, 1))] = np.nan
    shifts = np.where(np.isfinite(shifts), shifts, 0.0)
    frequencies = simulator.centre_frequencies
    evidence = [_evidence(change, of_set, noise, match, frequencies) for of_set in shifts]
    log_p = np.array(evidence) - logsumexp(evidence)
    order = np.argsort(-log_p)
    sets = {tried[i]: float(np.exp(log_p[i])) for i in order}
    by_surface = {n: sum(p for names, p in sets.items() if n in names) for n in faces}
    return Located(most_probable_first(by_surface), sets)


def _scaled_to(
    simulator: PathTracing, before: Measurement, match: Sequence[str], rows: list[int], seed: int
) -> Weighing:
    """Return a weighing whose coefficients have T before: the stated ones, scaled band by band."""
    wanted = before.decay_time().mean
    tracer = simulator
    factor = np.ones(simulator.room.n_bands)
    for _ in range(3):
        weighing = Weighing(tracer, match, seed)
        (of_t20,) = _heard(weighing.energy(weighing.alpha)[0], simulator, (TARGET.key,))
        simulated = np.exp(of_t20[rows])
        room = tracer.room
        air = 4 * room.air_attenuation * room.volume
        constant = 24 * np.log(10) / room.speed_of_sound * room.volume
        damped = np.maximum(constant / np.array([wanted, simulated.mean(axis=0)]) - air, 1e-3)
        factor = np.where(np.isfinite(wanted), damped[0] / damped[1], 1.0)
        alpha = -np.expm1(factor * np.log1p(-np.minimum(room.alpha, observations.LARGEST_ALPHA)))
        scaled = replace(tracer, room=room.replace(alpha=np.clip(alpha, 1e-4, 0.99)))
        scaled._traced.update(tracer._traced)  # alpha weighs the same paths
        tracer = scaled
    return Weighing(tracer, match, seed)


def _heard(energy: Array, simulator: PathTracing, match: Sequence[str]) -> Array:
    """Return the parameters of decays as observed, (n_parameters, n_pairs, n_bands); NaN without."""
    kinds = [OBSERVABLES[name] for name in match]
    return np.array([k.observed(k.value(energy, simulator.bin_width)) for k in kinds])


def _noise(energy: Array, simulator: PathTracing, match: Sequence[str]) -> Array:
    """Return the covariance of the parameters of one noise-like response.

    (n_pairs, n_bands, n_parameters, n_parameters). A bin of width w has the relative variance
    1 / (B w) in a band of bandwidth B; the direct sound in the first bin has none.
    """
    width = simulator.bin_width
    by_bin = gradients(energy, width, match) * energy[None]
    by_bin[..., 0] = 0.0
    f = simulator.centre_frequencies
    bandwidth = bands.bandwidth_factor(f) * f
    covariance = np.einsum("prkb,qrkb->rkpq", by_bin, by_bin)
    return np.asarray(np.nan_to_num(covariance / (bandwidth * width)[:, None, None]))


def _evidence(
    change: Array, shifts: Array, noise: Array, match: Sequence[str], frequencies: Array
) -> float:
    """Return the log evidence of a set of surfaces.

    Parameters
    ----------
    change : array (n_parameters, n_pairs, n_bands)
    shifts : array (n_nodes, n_parameters, n_pairs, n_bands)
        At a share of 0 and those of `NODES`.
    noise : array (n_pairs, n_bands, n_parameters, n_parameters)
    """
    nodes = np.array([0.0, *NODES])
    to = np.array([np.interp(SHARES, nodes, row) for row in np.eye(len(nodes))]).T
    predicted = np.einsum("jn,nprk->jrkp", to, shifts)
    mean = predicted.mean(axis=1)  # over the pairs: (n_shares, n_bands, n_parameters)
    observed = np.moveaxis(change, 0, -1)
    known = np.isfinite(observed)
    off = np.where(known, observed - predicted, 0.0)
    one = np.eye(len(match))
    own = np.where(known, 0.0, _MISSING)[None] + (PAIR * mean[:, None]) ** 2
    own_covariance = noise[None] + (own[..., None] + _TINY) * one
    inverse = np.linalg.inv(own_covariance)
    pulled = np.einsum("jrkpq,jrkq->jrkp", inverse, off)
    again = np.array([OBSERVABLES[name].remeasured for name in match])
    common = (again**2 + (COMMON * mean) ** 2)[..., None] * one
    held = np.linalg.inv(common) + inverse.sum(axis=1)
    b = pulled.sum(axis=1)
    squares = np.einsum("jrkp,jrkp->jk", off, pulled)
    squares = squares - np.einsum("jkp,jkp->jk", b, np.linalg.solve(held, b[..., None])[..., 0])
    determinants = np.linalg.slogdet(own_covariance)[1].sum(axis=1)
    determinants = determinants + np.linalg.slogdet(common)[1] + np.linalg.slogdet(held)[1]
    log_likelihood = -POWER * (squares + determinants) / 2
    used = np.asarray(known.any(axis=(0, 2)))
    return _through_bands(log_likelihood.T, frequencies, used)


def _through_bands(log_likelihood: Array, frequencies: Array, used: NDArray[np.bool_]) -> float:
    """Return the log of the mean over all random walks of ln share through the bands.

    ``log_likelihood`` is (n_bands, n_shares).
    """
    steps = np.subtract.outer(np.log(SHARES), np.log(SHARES))
    at = np.full(len(SHARES), -np.log(len(SHARES)))
    last = None
    for k in np.flatnonzero(used).tolist():
        if last is not None:
            variance = WALK**2 * abs(float(np.log2(frequencies[k] / frequencies[last])))
            move = -(steps**2) / (2 * variance)
            move = move - logsumexp(move, axis=0)
            at = logsumexp(move + at, axis=1)
        at = at + log_likelihood[k]
        last = k
    return float(logsumexp(at))


def trusted(
    simulator: PathTracing, match: Sequence[str], before: Measurement, after: Measurement
) -> tuple[str, ...]:
    """Return T20, and what both states have of the parameters that the directivities allow."""
    wanted = dict.fromkeys((TARGET.key, *simulator.trusted(match)))
    return tuple(
        name
        for name in wanted
        if all(OBSERVABLES[name].key_in(m.values) in m.values for m in (before, after))
    )


THRESHOLD = float(np.log(20))
"""Score from which a change is claimed: it exceeds ln 20 in at most one of twenty cases in which
nothing changed, since the likelihood ratio then has the mean 1 (Markov's inequality)."""
_SAMPLES = 4000
_INTERVAL = (0.05, 0.95)


@checked
def find(
    case: StatesCase,
    *,
    effects: Sequence[Effect] | None = None,
    errors: Errors | None = None,
    seed: int = 0,
) -> StatesFinding:
    """Find what changed between two states of a room, from T20 (or T30) alone.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        Those that add absorption give the spectra that are tried, added and removed; the whole library
        if not given. A spectrum that none of them has is tried as well.
    errors : Errors, optional
        What is assumed of noise and prediction.
    seed : int
        Of the samples from which the intervals come.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> pairs = [("S1", "R1"), ("S1", "R2"), ("S2", "R1"), ("S2", "R2")]
    >>> before, after = (
    ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": t}, pairs=pairs)
    ...     for t in ([[1.5, 1.4], [1.4, 1.4], [1.5, 1.3], [1.6, 1.5]],
    ...               [[1.1, 0.9], [1.2, 1.0], [1.1, 1.0], [1.0, 0.9]])
    ... )
    >>> finding = rt.find(room, after, before=before)
    >>> print(finding.verdict, finding.family)
    family added absorption
    """
    checks.instance("case", case, StatesCase)
    assumed = Errors() if errors is None else checks.instance("errors", errors, Errors)
    found, room = case.differences, case.room
    if found.of_means:
        assumed = replace(assumed, degrees=assumed.of_means)
    measured = found.measured
    change, variance = found.change[:, measured], found.variance[:, measured]
    baseline = Baseline.of(room, case.equation, found.before, measured)
    area = np.full(room.n_bands, np.nan)
    area[measured] = baseline.area
    of_library = library() if effects is None else tuple(effects)
    tried = grid(room, area, measured, of_library)
    nothing = evidence.none(change, variance, assumed)
    fits = evidence.fits(change, variance, baseline, tried, assumed)
    by_hypothesis = logsumexp(fits.log_evidence, axis=1) + tried.log_weight
    score = float(logsumexp(by_hypothesis)) - nothing
    # log(1 + odds) without overflow, of odds that may be e^700.
    odds = score + float(np.log1p(-NO_EFFECT) - np.log(NO_EFFECT))
    none = float(np.exp(-np.logaddexp(0.0, odds)))
    given = np.exp(by_hypothesis - logsumexp(by_hypothesis))
    probabilities = _summed(tried.names, given, none)
    families = _with_sums(_summed(tried.families, given, none))
    detection = Detection(score, THRESHOLD)
    by_family_alone = [name for name in probabilities if name != AIR]
    verdict, family = claimed(detection.verdict, probabilities, families, by_family_alone)
    samples, drawn = _samples(fits, tried, baseline, given, seed)
    changes = np.full((3, room.n_bands), np.nan)
    changes[0, measured] = samples.mean(axis=0)
    changes[1:, measured] = np.quantile(samples, _INTERVAL, axis=0)
    frequencies = room.centre_frequencies[measured]
    inside = bands.is_middle(frequencies)
    inside = inside if inside.any() else np.ones_like(inside)
    middle = samples[:, inside].mean(axis=1)
    names = np.array(tried.names)[drawn]
    candidates = [
        _candidate(name, tried, p, middle[names == name])
        for name, p in probabilities.items()
        if name != NONE and p >= SAID and (names == name).any()
    ]
    if not candidates:  # nothing changed
        best = max((n for n in probabilities if n != NONE), key=lambda n: probabilities[n])
        candidates = [_candidate(best, tried, probabilities[best], middle)]
    located: Located | None = None
    why = _OF_MEANS if case.simulator is None else ""
    added = families.get(f"{ADDED} absorption", 0.0) > families.get(f"{REMOVED} absorption", 0.0)
    if family is not None and "absorption" in family:
        located, why = _located(case, change, variance, added, assumed, seed)
    return StatesFinding(
        case=case,
        verdict=verdict,
        family=family,
        probabilities=probabilities,
        families=families,
        detection=detection,
        effects={effect.name: effect for effect in of_library},
        candidates=tuple(candidates),
        area=area,
        change=changes,
        size=_size(middle),
        middle=tuple(frequencies[inside].tolist()),
        surfaces={} if located is None else located.surfaces,
        sets={} if located is None else located.sets,
        reasons=(),
        notes=(*found.notes, *filter(None, [why])),
    )


_OF_MEANS = "T alone does not tell on which surface something changed."


def _located(
    case: StatesCase, change: Array, variance: Array, added: bool, errors: Errors, seed: int
) -> tuple[Located | None, str]:
    """Return on which surfaces something changed; or None, and why no surface is told."""
    if case.simulator is None:
        return None, _OF_MEANS
    if unstated := case.sources_unstated:
        return None, (
            f"The directivity of {first_of(unstated, 1)} is not stated, so no surface is told. An "
            "omnidirectional source has the index 0."
        )
    states = [
        band_conversion.measurement_in_room_bands(m, case.room.centre_frequencies).select(
            case.differences.pairs
        )
        for m in (case.before, case.after)
    ]
    less, more_absorbing = states if added else states[::-1]
    match = trusted(case.simulator, case.match, less, more_absorbing)
    # How far each pair's differences lie from the pairs' mean tells how noisy the pair is.
    mean = np.nansum(change / variance, axis=0) / np.nansum(1 / variance, axis=0)
    squares = np.nansum((change - mean) ** 2 / variance, axis=1)
    count = np.isfinite(change).sum(axis=1)
    weights = np.minimum(1.0, (errors.degrees + count) / (errors.degrees + squares))
    located = locate(case.simulator, less, more_absorbing, match, weights, seed=seed)
    return located, ""


def _summed(names: Sequence[str], given: Array, none: float) -> dict[str, float]:
    """Return the probability of "none" and of each name, the most probable first."""
    out = {NONE: none}
    for name, p in zip(names, (given * (1 - none)).tolist(), strict=True):
        out[name] = out.get(name, 0.0) + p
    return most_probable_first(out)


def _with_sums(families: dict[str, float]) -> dict[str, float]:
    """Return the families with the sums of all added and of all removed absorption."""
    out = dict(families)
    for side in (ADDED, REMOVED):
        whole = f"{side} absorption"
        out[whole] = sum(p for family, p in families.items() if family.startswith(whole))
    return most_probable_first(out)


def _samples(
    fits: Fits, tried: Grid, baseline: Baseline, given: Array, seed: int
) -> tuple[Array, NDArray[np.intp]]:
    """Return samples of the change of the absorption area in m², (n, n_bands), and their hypotheses."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(given), _SAMPLES, p=given / given.sum())
    of_rows = fits.log_evidence[rows]
    by_scale = np.exp(of_rows - logsumexp(of_rows, axis=1, keepdims=True))
    beyond = rng.random(_SAMPLES)[:, np.newaxis] > np.cumsum(by_scale, axis=1)
    scale = np.minimum(beyond.sum(axis=1), by_scale.shape[1] - 1)
    value, vector = np.linalg.eigh(fits.covariance[rows, scale])
    normal = rng.standard_normal(value.shape) * np.sqrt(np.maximum(value, 0.0))
    z = fits.mean[rows, scale] + np.einsum("nkl,nl->nk", vector, normal)
    size = np.where(tried.of_air[rows, np.newaxis], 0.0, tried.size[rows] * np.exp(z))
    return baseline.after(size) - baseline.area, rows


def _size(samples: Array) -> Size:
    low, high = np.quantile(samples, _INTERVAL)
    return Size(float(samples.mean()), float(low), float(high), "m²")


def _candidate(name: str, tried: Grid, probability: float, samples: Array) -> Candidate:
    size = _size(samples)
    return Candidate(
        effect=name,
        family=tried.families[tried.names.index(name)],
        probability=probability,
        size=size.mean,
        low=size.low,
        high=size.high,
        unit=size.unit,
    )
