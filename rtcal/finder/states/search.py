"""The search for what changed between two states, and whether it predicts T at pairs not fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.finder.claim import SAID, claimed, most_probable_first
from rtcal.finder.effects import Effect
from rtcal.finder.effects.checks import checked_effects
from rtcal.finder.finding import Candidate, Detection, Size, check_pairs
from rtcal.finder.prior import NO_EFFECT, NONE
from rtcal.finder.states import evidence
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import ADDED, AIR, REMOVED, Baseline, Errors, Fits, Grid, grid
from rtcal.finder.states.finding import StatesFinding, StatesVerification
from rtcal.finder.states.surfaces import Located, locate, other_gains, trusted
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.text import first_of
from rtcal.support.types import Array

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
    checks.whole("seed", seed, 0)
    assumed = Errors() if errors is None else checks.instance("errors", errors, Errors)
    found, room = case.differences, case.room
    if found.of_means:
        assumed = replace(assumed, degrees=assumed.of_means)
    measured = found.measured
    change, variance = found.change[:, measured], found.variance[:, measured]
    baseline = Baseline.of(room, case.equation, found.before, measured)
    area = np.full(room.n_bands, np.nan)
    area[measured] = baseline.area
    of_library = checked_effects(effects)
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
    gains: Mapping[str, float] = {}
    if located is not None:
        gains = {s: gain if added else -gain for s, gain in located.gains.items()}
    elif case.simulator is not None and not case.sources_unstated:
        gains = other_gains(case.simulator, *found.states, case.match, seed)
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
        reasons=_of_gains(gains),
        notes=(*found.notes, *filter(None, [why])),
    )


_OF_MEANS = "T alone does not tell on which surface something changed."


def _of_gains(gains: Mapping[str, float]) -> tuple[str, ...]:
    """Return what to know of sources whose level has another gain after than before; () of none."""
    if not gains:
        return ()
    each = first_of([f"{source} by {gain:+.1f} dB" for source, gain in gains.items()], 3)
    return (
        f"The level is off beside what T says of the change: {each}. That is another gain, so the "
        "level is left out there. Measure both states with one reference.",
    )


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
    states = case.differences.states
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


_LEAST_NEW = 2
"""Fewest pairs that a finding had not: their scatter tells how sure the gain is."""


@checked
def verify(
    finding: StatesFinding,
    *,
    before: Measurement | None = None,
    after: Measurement | None = None,
    seed: int = 0,
) -> StatesVerification:
    """Verify a finding at pairs that were not fitted.

    Parameters
    ----------
    finding : StatesFinding
    before, after : Measurement, optional
        Of both states. The finding predicts the pairs that it had not. Without them each half of the
        finding's pairs predicts the other.
    seed : int
        Of the samples from which the intervals come.

    Raises
    ------
    DataError
        If nothing was detected; for fewer than four pairs, or fewer than two that are new; if one of
        the states is missing.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> pairs = [("S1", "R1"), ("S1", "R2"), ("S2", "R1"), ("S2", "R2")]
    >>> before, after = (
    ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": t}, pairs=pairs)
    ...     for t in ([[1.5, 1.4], [1.4, 1.4], [1.5, 1.3], [1.6, 1.5]],
    ...               [[0.8, 0.7], [0.8, 0.7], [0.7, 0.7], [0.8, 0.7]])
    ... )
    >>> print(verify(rt.find(room, after, before=before)).verdict)
    supported
    """
    checks.whole("seed", seed, 0)
    case, found = finding.case, finding.case.differences
    if not finding.detected:
        raise DataError(f'the verdict is "{finding.verdict}"; there is no change to verify')
    if (before is None) != (after is None):
        lacking = "before" if before is None else "after"
        raise DataError(f"{lacking} is missing: the change is verified in both states")
    if before is not None and after is not None:
        case = _at_new_pairs(finding, before, after)
        found = case.differences
        gaps = _gaps(found.change, _shift(finding))
        return StatesVerification(finding=finding, gaps=gaps, case=case)
    check_pairs(found.pairs)
    predicted = np.full(found.change.shape, np.nan)
    for half in range(2):
        fitted = [i for i in range(len(found.pairs)) if i % 2 == half]
        held_out = [i for i in range(len(found.pairs)) if i % 2 != half]
        predicted[held_out] = _predicted(case, [found.pairs[i] for i in fitted], seed)
    gaps = _gaps(found.change, predicted)
    return StatesVerification(finding=finding, gaps=gaps)


def _gaps(change: Array, predicted: Array) -> Array:
    """Return the gaps in JND, (2, n_pairs, n_bands): as if nothing had changed, and as predicted."""
    jnd = np.log1p(TARGET.jnd)
    return np.stack([-change / jnd, (predicted - change) / jnd])


def _at_new_pairs(finding: StatesFinding, before: Measurement, after: Measurement) -> StatesCase:
    """Return the case of the pairs that a finding had not; DataError for fewer than two."""
    fitted = finding.case.differences.pairs
    if finding.case.differences.of_means or before.is_summary or after.is_summary:
        raise DataError("means over positions have no pairs that were not fitted")
    new = [p for p in before.pairs if p in after.pairs and p not in fitted]
    if len(new) < _LEAST_NEW:
        raise DataError(
            f"{len(new)} pairs of before and after are not among the {len(fitted)} that were fitted; "
            f"{_LEAST_NEW} are needed"
        )
    case = finding.case
    return StatesCase(
        room=case.room, before=before.select(new), after=after.select(new), equation=case.equation
    )


def _predicted(case: StatesCase, pairs: list[tuple[str, str]], seed: int) -> Array:
    """Return the shift of ln T that these pairs alone tell, (n_bands,); NaN where they have no T."""
    of_half = StatesCase(
        room=case.room,
        before=case.before.select(pairs),
        after=case.after.select(pairs),
        equation=case.equation,
    )
    return _shift(find(of_half, seed=seed))


def _shift(finding: StatesFinding) -> Array:
    """Return the shift of ln T that a finding states, (n_bands,); NaN where it has no T."""
    case = finding.case
    found, measured = case.differences, case.differences.measured
    baseline = Baseline.of(case.room, case.equation, found.before, measured)
    shift = np.full(len(measured), np.nan)
    shift[measured] = np.log(
        baseline.whole(baseline.area) / baseline.whole(baseline.area + finding.change[0, measured])
    )
    return shift
