"""Whether the change between two states predicts T at pairs that were not fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, TARGET
from rtcal.acoustics.priors import NORMAL_90
from rtcal.files.disk import json_numbers
from rtcal.finder.states.case import Differences, StatesCase
from rtcal.finder.states.finding import StatesFinding
from rtcal.finder.states.search import find
from rtcal.finder.verification import (
    Verification,
    check_pairs,
    gain_over_pairs,
    misses_over_pairs,
)
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_LEAST_NEW = 2
"""Fewest pairs that a finding had not: their scatter tells how sure the gain is."""


def verify(
    finding: StatesFinding,
    *,
    before: Measurement | None = None,
    after: Measurement | None = None,
    seed: int = 0,
) -> Verification:
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
        if seed:
            raise DataError("seed is of halves of the pairs: what was found predicts further pairs")
        case = _at_new_pairs(finding, before, after)
        found = case.differences
        return _concluded(finding, found, _gaps(found.change, finding.shift), "the other pairs")
    check_pairs(found.pairs)
    predicted = np.full(found.change.shape, np.nan)
    for half in range(2):
        fitted = [i for i in range(len(found.pairs)) if i % 2 == half]
        held_out = [i for i in range(len(found.pairs)) if i % 2 != half]
        predicted[held_out] = _predicted(finding, [found.pairs[i] for i in fitted], seed)
    gaps = _gaps(found.change, predicted)
    return _concluded(finding, found, gaps, "the other half of the pairs")


def _concluded(finding: StatesFinding, held: Differences, gaps: Array, fitted: str) -> Verification:
    """Return what the gaps of T after, (2, n_pairs, n_bands) in JND, say of a finding.

    ``held`` are the differences at the pairs that ``fitted`` pairs predict.
    """
    found = finding.case.differences
    # In steps of 1 JND each (ln T), so that states that are exchanged have the same means, gains and
    # misses: a JND of the longer T is another one than of the shorter.
    without, with_change = np.abs(np.log1p(TARGET.jnd * gaps) / np.log1p(TARGET.jnd))
    left = (finding.shift - found.change) / np.log1p(TARGET.jnd)
    return Verification(
        finding=finding,
        models=("if nothing changed", f"with what {fitted} found"),
        held_out=(f"pairs that {fitted} predict",),
        before=float(np.nanmean(without)),
        after=float(np.nanmean(with_change)),
        **gain_over_pairs(np.nanmean(without - with_change, axis=1)[np.newaxis]),
        misses=misses_over_pairs(
            {TARGET.key: (found.after, left)},
            found.pairs,
            found.centre_frequencies,
            # The geometric mean is the same of two states that are exchanged.
            np.sqrt(found.before * found.after),
            _prediction_error(finding),
        ),
        notes=() if found is held else held.notes,
        gaps=gaps[:, np.newaxis, np.newaxis],
        details={
            "pairs": [list(pair) for pair in held.pairs],
            "centre_frequencies": json_numbers(held.centre_frequencies),
            "before": json_numbers(gaps[0]),
            "after": json_numbers(gaps[1]),
        },
    )


def _prediction_error(finding: StatesFinding) -> Array:
    """Return the standard deviation in JND of T after, by the interval of the change, (n_bands,).

    The state of the longer T is the first: two states that are exchanged have the same one.
    """
    case, total = finding.case, finding.case.room.total_area
    air = 4 * case.room.air_attenuation * case.room.volume
    area, sign = finding.area, 1.0
    if not case.differences.falls:
        area, sign = case.equation.absorption_area(case.room, case.differences.after), -1.0
    areas = np.clip(area + sign * finding.change[1:], 0.0, 0.999 * total)
    low, high = total * case.equation.exponent(areas / total) + air
    out = np.abs(np.log(high / low)) / (2 * NORMAL_90 * np.log1p(TARGET.jnd))
    return np.asarray(np.nan_to_num(out))


def _gaps(change: Array, predicted: Array) -> Array:
    """Return the gaps in JND, (2, n_pairs, n_bands): as if nothing had changed, and as predicted.

    ``change`` and ``predicted`` are logarithms of T after over T before.
    """
    ratio = np.exp(change)
    return np.stack([gap_jnd(np.ones_like(ratio), ratio), gap_jnd(np.exp(predicted), ratio)])


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
    return replace(
        case, before=before.select(new), after=after.select(new), simulator=None, match=MATCH
    )


def _predicted(finding: StatesFinding, pairs: list[tuple[str, str]], seed: int) -> Array:
    """Return the shift of ln T that these pairs alone tell, (n_bands,); NaN where they have no T."""
    case = finding.case
    of_half = replace(
        case,
        before=case.before.select(pairs),
        after=case.after.select(pairs),
        simulator=None,
        match=MATCH,
    )
    effects = tuple(finding.effects.values())
    return find(of_half, effects=effects, seed=seed, without=finding.left_out).shift
