"""The search for what changed between two states.

Two states that are exchanged have the same answer, with "added" and "removed" exchanged and all changes
of the other sign. So the state of the longer T is the first in every search, and the answer is turned
round where it was measured second (`_turned`). Where both are the same, the answer is half of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.finder.claim import SAID, claimed, most_probable_first, over_frequency, unexplained
from rtcal.finder.effects import Effect, checked_effects
from rtcal.finder.finding import Candidate, Detection, Size
from rtcal.finder.prior import NO_EFFECT, NONE, UNKNOWN, left_out_of
from rtcal.finder.states import evidence
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import ADDED, AIR, REMOVED, Baseline, Errors, Fits, Grid, grid
from rtcal.finder.states.finding import StatesFinding
from rtcal.finder.states.surfaces import Located, locate, other_gains, trusted
from rtcal.support import checks
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
    errors: Errors | None = None,
    seed: int = 0,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
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
    only, without : sequence of str
        Names of what is tried alone, or not at all: effects that add absorption, "air" for the climate,
        and "unknown" for a spectrum that no effect has, which stays beside ``only``.

    Raises
    ------
    DataError
        For a name that is not tried between two states, and where none of the effects adds absorption.

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
    checks.whole("seed", seed, 0)
    assumed = Errors() if errors is None else checks.instance("errors", errors, Errors)
    of_library = checked_effects(effects)
    if not evidence.adding(of_library):
        raise DataError(
            "none of the effects adds absorption, which is what may change between two states"
        )
    left_out = left_out_of(only, without, evidence.tried(of_library), [UNKNOWN])
    found, room = case.differences, case.room
    if found.of_means:
        assumed = replace(assumed, degrees=assumed.of_means)
    measured, frequencies = found.measured, room.centre_frequencies[found.measured]
    variance = found.variance[:, measured]
    sign, times = (1.0, (found.before, found.after))
    if not found.falls:
        sign, times = -1.0, times[::-1]
    change = sign * found.change[:, measured]
    of_air = case.climate_uncertainty
    baseline = Baseline.of(room, case.equation, times, measured, of_air)
    area = np.full(room.n_bands, np.nan)
    area[measured] = baseline.area
    tried = grid(room, area, measured, of_library, left_out)
    if not found.falls:
        tried = _turned(tried)
        area[measured] = Baseline.of(room, case.equation, times[::-1], measured, of_air).area
    nothing = evidence.none(change, variance, assumed)
    fits = evidence.fits(change, variance, baseline, tried, assumed)
    by_scale = fits.log_evidence + tried.log_weight[:, np.newaxis]
    something = float(logsumexp(by_scale))
    score = something - nothing
    # log(1 + odds) without overflow, of odds that may be e^700.
    odds = score + float(np.log1p(-NO_EFFECT) - np.log(NO_EFFECT))
    none = float(np.exp(-np.logaddexp(0.0, odds)))
    chances = np.exp(by_scale - something)
    given = chances.sum(axis=1)
    of_names, of_families, shares = tried.names, tried.families, given
    if found.same:
        other_way = _turned(tried)
        of_names, of_families = of_names + other_way.names, of_families + other_way.families
        shares = np.tile(given / 2, 2)
    probabilities = _summed(of_names, shares, none)
    families = _with_sums(_summed(of_families, shares, none))
    detection = Detection(score, THRESHOLD)
    by_family_alone = [name for name in probabilities if name != AIR]
    verdict, family = claimed(detection.verdict, probabilities, families, by_family_alone)
    reasons = (_ONE_FILE,) if found.same else ()
    if verdict == "named":  # the climate alone
        chance = evidence.chance_of_climate(change, variance, baseline, assumed)
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
        samples, drawn = _samples(fits, tried, baseline, of_surfaces, seed)
        samples, names = sign * samples, np.array(tried.names)[drawn]
        if found.same:  # each beside its mirror image, so that their mean is 0 to the last digit
            samples = np.stack([samples, -samples], axis=1).reshape(-1, samples.shape[1])
            names = np.stack([names, np.array(other_way.names)[drawn]], axis=1).ravel()
        changes[0, measured] = samples.mean(axis=0)
        changes[1:, measured] = np.quantile(samples, _INTERVAL, axis=0)
        middle = samples[:, inside].mean(axis=1)
        family = _as_changed(family, changes[0, measured])
    candidates = [
        _candidate(name, tried, p, middle[names == name])
        for name, p in probabilities.items()
        if name != NONE and p >= SAID and (name == AIR or (names == name).any())
    ]
    if not candidates:  # nothing changed
        best = max((n for n in probabilities if n != NONE), key=lambda n: probabilities[n])
        candidates = [_candidate(best, tried, probabilities[best], middle)]
    shift = np.full(room.n_bands, np.nan)
    if found.same:
        shift[measured] = 0.0
    else:
        shift[measured] = sign * np.einsum("ns,nsk->k", chances, fits.shift)
    located: Located | None = None
    why = _OF_MEANS if case.simulator is None else ""
    if family is not None and "absorption" in family:
        added = families.get(f"{ADDED} absorption", 0.0) > families.get(
            f"{REMOVED} absorption", 0.0
        )
        climate = None
        if AIR not in left_out:
            of_two = np.diag(evidence.climate_covariance(room, of_air))
            climate = np.sqrt(of_two) / (4 * room.volume)
        located, why = _located(case, change, variance, added, assumed, seed, climate)
    gains: Mapping[str, float] = {}
    if located is not None:
        gains = {s: gain if added else -gain for s, gain in located.gains.items()}
    elif case.simulator is not None and not case.sources_unstated:
        in_order = found.states if found.falls else found.states[::-1]
        gains = other_gains(case.simulator, *in_order, case.match, seed)
        gains = {s: sign * gain for s, gain in gains.items()}
    with_air = float((of_surfaces * tried.of_air).sum() / of_surfaces.sum()) if len(middle) else 0.0
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


def _turned(tried: Grid) -> Grid:
    """Return the hypotheses with "added" and "removed" exchanged in their names alone."""
    other = {ADDED: REMOVED, REMOVED: ADDED}

    def turned(name: str) -> str:
        side, _, rest = name.partition(" ")
        return f"{other[side]} {rest}" if side in other else name

    return replace(
        tried,
        names=tuple(map(turned, tried.names)),
        families=tuple(map(turned, tried.families)),
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
    change: Array,
    variance: Array,
    added: bool,
    errors: Errors,
    seed: int,
    climate: Array | None,
) -> tuple[Located | None, str]:
    """Return on which surfaces something changed; or None, and why no surface is told."""
    if case.simulator is None:
        return None, _OF_MEANS
    if unstated := case.sources_unstated:
        return None, (
            f"The directivity of {first_of(unstated, 1)} is not stated, so no surface is told. An "
            "omnidirectional source has the index 0."
        )
    states = case.differences.states
    less, more_absorbing = states if added else states[::-1]
    match = trusted(case.simulator, case.match, less, more_absorbing)
    # How far each pair's differences lie from the pairs' mean tells how noisy the pair is.
    mean = np.nansum(change / variance, axis=0) / np.nansum(1 / variance, axis=0)
    squares = np.nansum((change - mean) ** 2 / variance, axis=1)
    count = np.isfinite(change).sum(axis=1)
    weights = np.minimum(1.0, (errors.degrees + count) / (errors.degrees + squares))
    located = locate(
        case.simulator, less, more_absorbing, match, weights, seed=seed, climate=climate
    )
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
        size=size.mean,
        low=size.low,
        high=size.high,
        unit=size.unit,
    )
