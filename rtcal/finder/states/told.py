"""Two states tell of their data: bands, pairs without T, and copies within a state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.repeats import Pair, beyond_chance, chances_at_pairs
from rtcal.acoustics.room import Room
from rtcal.calibration.problem_data import notes_of_bands
from rtcal.support.text import as_sentence, first_of
from rtcal.support.types import Array


def of_bands(room: Room, before: Measurement, after: Measurement) -> list[str]:
    """Return notes of the bands that are converted, left out, or without T, state by state."""
    return _by_state(*("; ".join(notes_of_bands(room, m)) for m in (before, after)))


def of_copies(before: Measurement, after: Measurement) -> list[str]:
    """Return notes of the pairs that have all values of another of the same state."""
    return _by_state(*("; ".join(m.copies) for m in (before, after)))


def of_names(before: Measurement, after: Measurement) -> list[str]:
    """Return a note of pairs that have after what another pair had before, if hardly by chance.

    Both have the same pairs. Names that are exchanged and measured anew are not told.
    """
    shared = [name for name in before.values if name in after.values]
    same_bands = np.array_equal(before.centre_frequencies, after.centre_frequencies)
    if not (shared and same_bands):
        return []
    tables = [before.values[name] for name in shared]
    chances = chances_at_pairs(tables)
    one, other = np.hstack(tables), np.hstack([after.values[name] for name in shared])
    rows = {row.tobytes(): i for i, row in enumerate(np.nan_to_num(one, nan=-np.inf))}
    exchanged = []
    for j, row in enumerate(np.nan_to_num(other, nan=-np.inf)):
        i, known = rows.get(row.tobytes(), j), np.isfinite(other[j])
        n = int(known.sum())
        if i != j and beyond_chance(n, chances[i, known], compared=len(one) ** 2):
            own, another = (" to ".join(before.pairs[k]) for k in (j, i))
            exchanged.append(f"{own} has those of {another}")
    if not exchanged:
        return []
    return [
        f"Values after are those of another pair before: {first_of(exchanged, 3)}. Are the names of "
        "pairs exchanged?"
    ]


def _by_state(before: str, after: str) -> list[str]:
    """Return what is told of each state as sentences; one, if it is the same of both.

    >>> _by_state("no T", "no T"), _by_state("", "no T")
    (['Before and after: no T.'], ['After: no T.'])
    """
    each = {"before and after": before} if before == after else {"before": before, "after": after}
    return [as_sentence(f"{state}: {note}") for state, note in each.items() if note]


def named(measured: Measurement) -> str:
    """Return what was measured at in words: means, or its first pair and how many more."""
    if measured.is_summary:
        return "means over positions"
    return first_of([*map(" to ".join, measured.pairs)], 1)


def alone(before: Measurement, after: Measurement, pairs: Sequence[Pair]) -> list[str]:
    """Return notes of the pairs that one state alone has."""
    out = []
    for name, state in (("before", before), ("after", after)):
        if others := [p for p in state.pairs if p not in pairs]:
            out.append(f"Only {name} has {first_of([*map(' to '.join, others)], 1)}: left out.")
    return out


def without_times(pairs: Sequence[Pair], change: Array) -> list[str]:
    """Return a note of the pairs that have no T of both states in any band.

    ``change`` is (n_pairs, n_bands), NaN where T of a state is missing.
    """
    empty = np.flatnonzero(np.isnan(change).all(axis=1)).tolist()
    each = [" to ".join(pairs[i]) for i in empty]
    return [f"No T of both states at {first_of(each, 3)}: left out."] if each else []
