"""The search for what changed between two states.

Two states that are exchanged have the same answer, with "added" and "removed" exchanged and all changes
of the other sign. So the state of the longer T is the first in every search, and the answer is turned
round where it was measured second (`Grid.turned`). Where both are the same, the answer is half of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import bands
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
from rtcal.finder.finding import Finding
from rtcal.finder.prior import NO_EFFECT, NONE, UNKNOWN, left_out_of
from rtcal.finder.states import evidence
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import ADDED, AIR, REMOVED, Baseline, Fits, Grid, grid
from rtcal.finder.states.surfaces import Located, locate
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
    located, gains, why = _located(
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
        surfaces={} if located is None else located.surfaces,
        sets={} if located is None else located.sets,
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
) -> tuple[Located | None, Mapping[str, float], str]:
    """Return on which surfaces something changed, other gains of the sources, and a note.

    None where no surface is told; the note is why, where one was asked for. ``climate`` is whether
    another one is tried.
    """
    found, simulator = case.differences, case.simulator
    if simulator is None:
        return None, {}, _OF_MEANS
    absorption = family is not None and "absorption" in family
    if unstated := case.sources_unstated:
        why = (
            f"The directivity of {first_of(unstated, 1)} is not stated, so no surface is told. An "
            "omnidirectional source has the index 0."
        )
        return None, {}, why if absorption else ""
    if not absorption:
        sign, states = (1.0, found.states) if found.falls else (-1.0, found.states[::-1])
        gains = locate(simulator, *states, case.match, seed).gains
        return None, {source: sign * gain for source, gain in gains.items()}, ""
    added, removed = (families.get(f"{side} absorption", 0.0) for side in (ADDED, REMOVED))
    sign, states = (1.0, found.states) if added > removed else (-1.0, found.states[::-1])
    # How far each pair's differences lie from the pairs' mean tells how noisy the pair is.
    mean = np.nansum(change / variance, axis=0) / np.nansum(1 / variance, axis=0)
    squares = np.nansum((change - mean) ** 2 / variance, axis=1)
    count = np.isfinite(change).sum(axis=1)
    weights = np.minimum(1.0, (degrees + count) / (degrees + squares))
    of_air = None
    if climate:
        of_two = np.diag(evidence.climate_covariance(case.room, case.climate_uncertainty))
        of_air = np.sqrt(of_two) / (4 * case.room.volume)
    located = locate(simulator, *states, case.match, seed, weights, of_air)
    return located, {source: sign * gain for source, gain in located.gains.items()}, ""


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
