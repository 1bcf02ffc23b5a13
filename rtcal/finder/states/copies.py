"""A second measurement may hold copies of the first: what was not measured anew tells no change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.acoustics.repeats import CHANCE, beyond_chance, chance_of_near, equal_rounded
from rtcal.support.text import first_of

_PRECISE = 0.1
"""Largest chance of being measured again to the last digit, of a value that is told a copy alone."""


def without_copies(
    before: Measurement, after: Measurement
) -> tuple[Measurement, Measurement, list[str]]:
    """Return two measurements without what the second has copied of the first, and notes of it.

    A pair is left out if all values that both have are equal, and hardly by chance: alone, or together
    with the other pairs that are. Values are compared as the coarser is rounded. Of the other pairs,
    equal times are left out if they are stated precisely, and more are equal than chance allows.
    Measurements in different bands have no copies. Where nothing but copies is in both, all are kept:
    nothing changed (`Differences.same`).
    """
    pairs = [pair for pair in before.pairs if pair in after.pairs]
    shared = [p for p in before.values if p in after.values]
    same_bands = np.array_equal(before.centre_frequencies, after.centre_frequencies)
    if not (pairs and shared and same_bands):
        return before, after, []
    one, other = (
        np.stack([m.select(pairs).values[p] for p in shared], axis=1) for m in (before, after)
    )
    known = np.isfinite(one) & np.isfinite(other)
    # Each row has its own decimals: copied rows may stand beside others that are rounded otherwise.
    equal, as_rounded = np.zeros_like(known), np.ones_like(one)
    for at in np.ndindex(known.shape[:2]):
        equal[at], as_rounded[at] = equal_rounded(one[at], other[at])
    whole = known.any(axis=(1, 2)) & (equal | ~known).all(axis=(1, 2))
    # Where the measurement repeats closely, values are often equal: what is not tells how often.
    apart = np.where(equal, np.nan, one)
    near = [chance_of_near(apart[:, j], other[:, j]) for j in range(len(shared))]
    chance = np.maximum(as_rounded, np.array(near))
    of_pair = np.where(known, chance, 1.0).prod(axis=(1, 2))
    together = beyond_chance(int(whole.sum()), of_pair)
    copied = whole & (together | (of_pair < CHANCE / len(pairs)))
    names = [pair for pair, is_copy in zip(pairs, copied, strict=True) if is_copy]
    if len(names) == len(pairs):
        return before, after, []
    notes = []
    if names:
        notes.append(
            f"{first_of([*map(' to '.join, names)], 3)}: the same values before and after, as if "
            "copied. Left out."
        )
        before, after = (m.select([p for p in m.pairs if p not in names]) for m in (before, after))
    # A level may well be the same to 0.1 dB again.
    times = np.array([observable(p).logarithmic for p in shared])[:, np.newaxis]
    told = known & times & (as_rounded < _PRECISE) & ~copied[:, np.newaxis, np.newaxis]
    cells = np.argwhere(told & equal)
    if not beyond_chance(len(cells), chance[told]):
        return before, after, notes
    values = {p: table.copy() for p, table in after.values.items()}
    for i, j, k in cells:
        values[shared[j]][after.pairs.index(pairs[i]), k] = np.nan
    each = [
        f"{parameter_label(shared[j])} of {' to '.join(pairs[i])} at "
        f"{bands.label(after.centre_frequencies[k])}"
        for i, j, k in cells
    ]
    notes.append(
        f"{first_of(each, 3)}: the same before and after to the last digit, as if copied. Left out."
    )
    return before, replace(after, values=values), notes
