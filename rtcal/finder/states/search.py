"""The search for what changed between two states.

Two states that are exchanged have the same answer, with "added" and "removed" exchanged and all changes
of the other sign. So the state of the longer T is the first in every search, and the answer is turned
round where it was measured second (`Grid.turned`). Where both are the same, the answer is half of each.

Every pair's differences say on which surface something changed, where the directivities are known. The
coefficients are scaled to T before. Then sets of surfaces absorb more, each with a share of the
way to alpha = 1 that goes through the bands as a random walk, and the same paths are weighed with them.
In the difference of two weighings the simulator's error and the coefficients' cancel to first order.

Each set is weighed with the same climate in both states and with another one, whose error is taken as
independent from band to band.

T and an absolute level are tied. A source whose level shifts otherwise than T says has another gain in
the two states, and its level is left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import DB, EARLY, LEVEL, OBSERVABLES, TARGET, gradients
from rtcal.finder.claim import (
    SAID,
    Candidate,
    Detection,
    Size,
    claimed,
    most_probable_first,
    over_frequency,
    unexplained,
)
from rtcal.finder.effects import Effect, checked_effects
from rtcal.finder.evidence import log_mixture, with_columns
from rtcal.finder.finding import Finding
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.surfaces import Faces
from rtcal.finder.positions.weighing import Weighing
from rtcal.finder.prior import NO_EFFECT, NONE, UNKNOWN, left_out_of
from rtcal.finder.states import evidence
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import (
    ADDED,
    AIR,
    ANOTHER_CLIMATE,
    COMMON,
    PAIR,
    REMOVED,
    WALK,
    Baseline,
    Fits,
    Grid,
    grid,
)
from rtcal.simulators import base
from rtcal.simulators.base import Observations
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import DataError
from rtcal.support.text import first_of
from rtcal.support.types import Array

THRESHOLD = float(np.log(20))
"""Score from which a change is claimed: it exceeds ln 20 in at most one of twenty cases in which
nothing changed, since the likelihood ratio then has the mean 1 (Markov's inequality)."""
_SAMPLES = 4000
_INTERVAL = (0.05, 0.95)


def find(
    case: StatesCase,
    *,
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Finding:
    """Return what changed between two states of a room, from T20 (or T30) alone; see `rtcal.find`.

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
    of_library = checked_effects(effects)
    if not evidence.adding(of_library):
        raise DataError(
            "none of the effects adds absorption, which is what may change between two states"
        )
    left_out = left_out_of(only, without, evidence.tried(of_library), [UNKNOWN])
    found, room = case.differences, case.room
    degrees = evidence.OF_MEANS if found.of_means else evidence.DEGREES
    measured, frequencies = found.measured, room.centre_frequencies[found.measured]
    sign, times = (1.0, (found.before, found.after))
    if not found.falls:
        sign, times = -1.0, times[::-1]
    change, variance = sign * found.change[:, measured], found.variance[:, measured]
    of_air = case.climate_uncertainty
    baseline = Baseline.of(room, case.equation, times, measured, of_air)
    area = np.full(room.n_bands, np.nan)
    area[measured] = baseline.area
    tried = grid(room, area, measured, of_library, left_out)
    if not found.falls:
        tried = tried.turned
        area[measured] = Baseline.of(room, case.equation, times[::-1], measured, of_air).area
    fits = evidence.fits(change, variance, baseline, tried, degrees)
    by_scale = fits.log_evidence + tried.log_weight[:, np.newaxis]
    something = float(logsumexp(by_scale))
    score = something - evidence.none(change, variance, degrees)
    # log(1 + odds) without overflow, of odds that may be e^700.
    odds = score + float(np.log1p(-NO_EFFECT) - np.log(NO_EFFECT))
    none = float(np.exp(-np.logaddexp(0.0, odds)))
    chances = np.exp(by_scale - something)
    given = chances.sum(axis=1)
    grids = (tried, tried.turned) if found.same else (tried,)
    shares = np.tile(given / len(grids), len(grids))
    probabilities = _summed([n for each in grids for n in each.names], shares, none)
    families = _with_sums(_summed([f for each in grids for f in each.families], shares, none))
    detection = Detection(score, THRESHOLD)
    by_family_alone = [name for name in probabilities if name != AIR]
    verdict, family = claimed(detection.verdict, probabilities, families, by_family_alone)
    reasons = (_ONE_FILE,) if found.same else ()
    if verdict == "named":  # the climate alone
        chance = evidence.chance_of_climate(change, variance, baseline, degrees)
        if chance < _LEAST_CHANCE:
            verdict, family, reasons = "ambiguous", None, (_unlike_air(chance),)
    asked = [name for name in evidence.tried(of_library) if name not in (*left_out, UNKNOWN)]
    known = sum(p for name, p in probabilities.items() if not name.endswith(UNKNOWN)) - none
    if left_out and asked and detection.verdict is None and known < SAID:
        reasons = (_as_asked(asked, known), *reasons)
    of_surfaces = given * tried.of_surfaces
    changes, middle, names = np.full((3, room.n_bands), np.nan), np.zeros(0), np.zeros(0, dtype=str)
    inside = bands.is_middle(frequencies)
    inside = inside if inside.any() else np.ones_like(inside)
    if of_surfaces.any():
        drawn, rows = _samples(fits, tried, baseline, of_surfaces, seed)
        # Of one state twice, each beside its mirror image: their mean is 0 to the last digit.
        samples = np.stack([sign * drawn, -sign * drawn][: len(grids)], axis=1)
        samples = samples.reshape(-1, drawn.shape[1])
        names = np.stack([np.array(each.names)[rows] for each in grids], axis=1).ravel()
        changes[0, measured] = samples.mean(axis=0)
        changes[1:, measured] = np.quantile(samples, _INTERVAL, axis=0)
        middle = samples[:, inside].mean(axis=1)
        family = _as_changed(family, changes[0, measured])
    some = [n for n, p in probabilities.items() if n != NONE and p >= SAID]
    some = [name for name in some if name == AIR or (names == name).any()]
    shift = np.full(room.n_bands, np.nan)
    of_chances = np.einsum("ns,nsk->k", chances, fits.shift)
    shift[measured] = 0.0 if found.same else sign * of_chances
    (surfaces, sets, gains), why = _located(
        case, family, families, change, variance, degrees, seed, AIR not in left_out
    )
    with_air = float((of_surfaces * tried.of_air).sum() / of_surfaces.sum()) if len(middle) else 0.0
    return Finding(
        case=case,
        verdict=verdict,
        family=family,
        probabilities=probabilities,
        families=families,
        detection=detection,
        effects={effect.name: effect for effect in of_library},
        candidates=tuple(
            _candidate(name, tried, probabilities[name], middle[names == name] if some else middle)
            # Without any, nothing changed.
            for name in some or [next(n for n in probabilities if n != NONE)]
        ),
        area=area,
        change=changes,
        shift=shift,
        size=_size(middle),
        middle=tuple(frequencies[inside].tolist()),
        surfaces=surfaces,
        sets=sets,
        climate=with_air,
        left_out=left_out,
        reasons=(*_of_gains(gains), *reasons),
        notes=(*found.notes, *filter(None, [why])),
    )


_ONE_FILE = "Before and after have the same T at every pair: are they one file?"
_LEAST_CHANCE = 0.05
"""Least p-value of what is named: of true changes of the climate one in twenty is not."""


def _unlike_air(chance: float) -> str:
    return (
        "Another climate of the air is the most probable single change, but alone it does not explain "
        f"T (p = {chance:.2g} by chi-square over the bands)."
    )


def _as_changed(family: str | None, change: Array) -> str | None:
    """Return the family, without its kind where the change goes otherwise with frequency.

    What is removed from a surface saturates, so the change goes less, or more, than the spectrum.
    """
    whole, _, kind = (family or "").partition(", ")
    if kind not in evidence.KINDS.values() or len(change) < 2:
        return family
    return family if evidence.KINDS[over_frequency(change)] == kind else whole


def _as_asked(names: Sequence[str], probability: float) -> str:
    return (
        f"{unexplained(names)} ({100 * probability:.0f} %): a spectrum that no effect has does, which "
        "is tried in any case."
    )


_OF_MEANS = "T alone does not tell on which surface something changed."


def _of_gains(gains: Mapping[str, float]) -> tuple[str, ...]:
    """Return what to know of sources whose level has another gain after than before; () of none."""
    if not gains:
        return ()
    each = first_of([f"{source} by {gain:+z.1f} dB" for source, gain in gains.items()], 3)
    return (
        f"The level is off beside what T says of the change: {each}. That is another gain, so the "
        "level is left out there. Measure both states with one reference.",
    )


def _located(
    case: StatesCase,
    family: str | None,
    families: Mapping[str, float],
    change: Array,
    variance: Array,
    degrees: float,
    seed: int,
    climate: bool,
) -> tuple[Located, str]:
    """Return on which surfaces something changed, with other gains, and a note why none is told.

    ``climate`` is whether another one is tried.
    """
    found, simulator = case.differences, case.simulator
    if simulator is None:
        return ({}, {}, {}), _OF_MEANS
    absorption = family is not None and "absorption" in family
    if unstated := case.sources_unstated:
        why = (
            f"The directivity of {first_of(unstated, 1)} is not stated, so no surface is told. An "
            "omnidirectional source has the index 0."
        )
        return ({}, {}, {}), why if absorption else ""
    of_air, weights, forth = None, None, found.falls
    if absorption:
        forth = families[f"{ADDED} absorption"] > families[f"{REMOVED} absorption"]
        # How far each pair's differences lie from the pairs' mean tells how noisy the pair is.
        mean = np.nansum(change / variance, axis=0) / np.nansum(1 / variance, axis=0)
        squares = np.nansum((change - mean) ** 2 / variance, axis=1)
        count = np.isfinite(change).sum(axis=1)
        weights = np.minimum(1.0, (degrees + count) / (degrees + squares))
        if climate:
            of_two = np.diag(evidence.climate_covariance(case.room, case.climate_uncertainty))
            of_air = np.sqrt(of_two) / (4 * case.room.volume)
    states, sign = (found.states, 1.0) if forth else (found.states[::-1], -1.0)
    surfaces, sets, gains = locate(simulator, *states, case.match, seed, weights, of_air)
    return (surfaces, sets, {source: sign * gain for source, gain in gains.items()}), ""


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
    return baseline.after(tried.size[rows] * np.exp(z)) - baseline.area, rows


def _size(samples: Array) -> Size:
    """Return the size of samples in m²; NaN of none, where no surface is taken to have changed."""
    if not len(samples):
        return Size(math.nan, math.nan, math.nan, "m²")
    low, high = np.quantile(samples, _INTERVAL)
    return Size(float(samples.mean()), float(low), float(high), "m²")


def _candidate(name: str, tried: Grid, probability: float, samples: Array) -> Candidate:
    size = _size(samples if name != AIR else samples[:0])
    return Candidate(
        effect=name,
        family=tried.families[tried.names.index(name)],
        probability=probability,
        **size.fields,
    )


MOST_SURFACES = 8
"""Largest number of surfaces of which sets are tried: the largest ones."""
NODES = (0.08, 0.25, 0.55, 1.0)
"""Shares of the way to alpha = 1 that are weighed; between them the shifts are interpolated."""
SHARES = np.geomspace(0.02, 0.95, 30)
POWER = 0.5
"""Power of the likelihood: pairs and parameters share errors that no covariance of this module has."""
MOST_DIRECT = 0.76
"""Share of the direct sound in the energy, 5 dB above the rest, from which EDT says nothing."""
ANOTHER_GAIN = 0.3
"""Prior probability that sources have another gain in the second state. In three boxes of another's
tracer, two draws each, gains of 1.0 to 1.2 dB made 5 of 12 answers wrong without it, none with it."""
GAIN = 1.5
"""Standard deviation in dB, per band, by which a source has another gain in two states, if it has."""
MOST_GAIN = 1.5
"""Shift in dB of a source's level beside what T says, from which its level is left out."""
_MISSING = 1e6
_TINY = 1e-8


Located = tuple[Mapping[str, float], Mapping[tuple[str, ...], float], Mapping[str, float]]
"""Probabilities of the surfaces and of the sets of surfaces, the most probable first; and by how many
dB the level of a source shifts beside what T says, where it was left out."""


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
    seed: int = 0,
    weights: Array | None = None,
    climate: Array | None = None,
) -> Located:
    """Return the probability of each surface that it absorbs more after than before.

    Parameters
    ----------
    simulator : PathTracing
        With every source's directivity.
    before, after : Measurement
        Of the same pairs of the simulator, in the room's bands; before absorbs less.
    match : sequence of str
        Parameters that are compared: those that both states have and the directivities allow, and T20.
    weights : array (n_pairs,), optional
        Precision of each pair's noise over the expected one. Without it no surface is told, and the
        gains alone are found.
    climate : array (n_bands,), optional
        Standard deviation in 1/m by which the air's attenuation differs in two states, if it does; None
        where another climate is not tried.
    """
    wanted = dict.fromkeys((TARGET.key, *simulator.trusted(match)))
    states = (before, after)
    match = [n for n in wanted if all(OBSERVABLES[n].key_in(m.values) in m.values for m in states)]
    level = match.index(LEVEL.key) if LEVEL.key in match else None
    if weights is None and level is None:
        return {}, {}, {}
    pairs, frequencies = before.pairs, simulator.centre_frequencies
    rows = [simulator.pairs.index(p) for p in pairs]
    two = [Observations.of_measurement(m, match, pairs).values for m in states]
    change = two[1] - two[0]
    weighing = _scaled_to(simulator, before, match, rows, seed)
    energy = weighing.energy(weighing.alpha)[0]
    gains = dict[str, float]()
    if level is not None:
        times = [m.reverberation_time for m in states]
        gains = _gains(simulator, pairs, energy[rows], times, change[level])
        change[level][[source in gains for source, _ in pairs]] = np.nan
    if weights is None:
        return {}, {}, gains
    direct = energy[rows, :, 0] / energy[rows].sum(axis=-1)
    if EARLY.key in match:
        change[match.index(EARLY.key)][direct > MOST_DIRECT] = np.nan
    shorter = np.nanmean(np.exp(two[0][0] - two[1][0]), axis=0) if match[0] == TARGET.key else 1.0
    noise = _noise(energy[rows], simulator, match) * (1 + np.asarray(shorter))[:, None, None]
    noise = noise / weights[:, None, None, None]
    faces = of_room.of_geometry(simulator.geometry)
    tried = sets_of(simulator, faces)
    groups = [np.concatenate([faces[n] for n in names]) for names in tried]
    base = _heard(energy, simulator, match)
    shifts = np.array(
        [
            [np.zeros_like(base), *(_heard(decay, simulator, match) - base for decay in decays)]
            for decays in weighing.of_groups(groups, NODES)
        ]
    )[:, :, :, rows]
    # What a decay lacks under any set counts for none: EDT, where the direct sound is all there is.
    change[~np.isfinite(shifts).all(axis=(0, 1))] = np.nan
    shifts = np.where(np.isfinite(shifts), shifts, 0.0)

    def evidence_of(sources: Sequence[str], by_air: Array | None) -> Array:
        common = _common_errors(pairs, match, sources, by_air, len(frequencies))
        return np.array([_evidence(change, s, noise, match, frequencies, common) for s in shifts])

    def in_climate(by_air: Array | None) -> Array:
        as_calibrated = evidence_of((), by_air)
        if level is None:
            return as_calibrated
        every = [*dict.fromkeys(source for source, _ in pairs)]
        return log_mixture(as_calibrated, evidence_of(every, by_air), ANOTHER_GAIN)

    evidence = in_climate(None)
    if climate is not None:
        attenuation = simulator.room.air_attenuation + climate
        in_it = _heard(weighing.energy(weighing.alpha, attenuation)[0], simulator, match)
        by_air = np.nan_to_num(np.moveaxis((in_it - base)[:, rows], 0, -1))
        evidence = log_mixture(evidence, in_climate(by_air), ANOTHER_CLIMATE)
    chances = dict(zip(tried, np.exp(evidence - logsumexp(evidence)).tolist(), strict=True))
    by_surface = {n: sum(p for names, p in chances.items() if n in names) for n in faces}
    return most_probable_first(by_surface), most_probable_first(chances), gains


def _gains(
    simulator: PathTracing,
    pairs: Sequence[tuple[str, str]],
    energy: Array,
    times: Sequence[Array],
    change: Array,
) -> dict[str, float]:
    """Return by how many dB a source's level shifts beside what T says, if by `MOST_GAIN` or more.

    By T every path but the direct one loses in proportion to its length. The mean is over a source's
    pairs and bands.

    Parameters
    ----------
    energy : array (n_pairs, n_bands, n_bins)
        Decays of the state before; the direct sound is in the first bin.
    times : two arrays (n_bands,)
        Mean T in s before and after.
    change : array (n_pairs, n_bands)
        Of the level in dB.
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
        (of_t20,) = _heard(weighing.energy(weighing.alpha)[0], simulator, (TARGET.key,))
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


def _common_errors(
    pairs: Sequence[tuple[str, str]],
    match: Sequence[str],
    sources: Sequence[str],
    climate: Array | None,
    n_bands: int,
) -> tuple[Array, Array]:
    """Return what several pairs err by together, and its variance where nothing changes.

    All pairs share an error of each parameter, those of each of ``sources`` a gain of the level, and
    all another climate, whose standard deviation shifts them by ``climate`` (n_pairs, n_bands,
    n_parameters).

    Returns
    -------
    columns : array (n_pairs, n_bands, n_parameters, n_errors)
    variance : array (n_errors,)
    """
    again = np.array([OBSERVABLES[name].remeasured for name in match])
    shared = np.broadcast_to(np.eye(len(match)), (len(pairs), len(match), len(match)))
    gain = np.zeros((len(pairs), len(match), len(sources)))
    for r, (source, _) in enumerate(pairs):
        if source in sources:
            gain[r, list(match).index(LEVEL.key), sources.index(source)] = 1.0
    variance = np.concatenate([again**2, np.full(len(sources), GAIN**2)])
    columns = np.repeat(np.concatenate([shared, gain], axis=2)[:, np.newaxis], n_bands, axis=1)
    if climate is None:
        return columns, variance
    return np.concatenate([columns, climate[..., np.newaxis]], axis=3), np.append(variance, 1.0)


def _evidence(
    change: Array,
    shifts: Array,
    noise: Array,
    match: Sequence[str],
    frequencies: Array,
    common: tuple[Array, Array],
) -> float:
    """Return the log evidence of a set of surfaces.

    Parameters
    ----------
    change : array (n_parameters, n_pairs, n_bands)
    shifts : array (n_nodes, n_parameters, n_pairs, n_bands)
        At a share of 0 and those of `NODES`.
    noise : array (n_pairs, n_bands, n_parameters, n_parameters)
    common
        As `_common_errors`.
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
    log_likelihood = -POWER * (square / 2 + half)[..., 0]
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
