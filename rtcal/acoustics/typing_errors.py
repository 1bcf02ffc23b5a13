"""Values that are most likely typed wrong: far from those of the bands beside them.

A shifted decimal point changes a value by ten, a lost digit by more. T differs between neighbouring
bands by much less. Such a value is named before anything else, since all that follows from it is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import OBSERVABLES, REVERBERATION
from rtcal.acoustics.room import Room
from rtcal.support.types import Array

FAR = 4.0
"""Ratio of T20 or T30 to both neighbouring bands from which on it counts as mistyped."""
FAR_AT_END = 6.0
"""The same of the first and of the last band, which have one neighbour."""
FAR_ELSE = 10.0
"""The same of EDT and Ts, which direct sound makes short, and of alpha: a resonator is a peak."""


@dataclass(frozen=True)
class TypingError:
    """A value that is likely mistyped: its band in Hz, and the value with those beside it in words."""

    frequency: float
    text: str

    @property
    def sentence(self) -> str:
        """The error with what to do, for messages."""
        return (
            f"likely a typing error at {self.frequency:g} Hz: {self.text}. Check this value before "
            "anything else"
        )


def far_from_neighbours(values: Array, *, late: bool = True) -> NDArray[np.bool_]:
    """Return which values (n_bands,) are far above or below those of the bands beside them.

    Each jump between neighbouring bands begins a new group, unless it leads back to an earlier one. The
    largest group is right. None is flagged where two groups are equally large.

    Parameters
    ----------
    values : array (n_bands,)
        Above 0; others, and NaN, are missing.
    late : bool
        Whether they are T20 or T30. Others are not judged in the first and in the last band.

    Examples
    --------
    >>> far_from_neighbours(np.array([1.4, 1.72, 2.02, 1.94, 0.05, 1.57])).tolist()
    [False, False, False, False, True, False]
    """
    found = np.zeros(len(values), dtype=bool)
    with np.errstate(invalid="ignore"):
        places = np.flatnonzero(np.isfinite(values) & (values > 0))
    level, far = np.log(values[places]), np.log(FAR if late else FAR_ELSE)
    group = np.zeros(len(level), dtype=int)
    last: list[float] = []
    for i, value in enumerate(level):
        near = [g for g, latest in enumerate(last) if abs(value - latest) < far]
        group[i] = min(near, key=lambda g: abs(value - last[g])) if near else len(last)
        last[group[i] : group[i] + 1] = [value]
    sizes = np.bincount(group)
    if len(sizes) < 2 or np.count_nonzero(sizes == sizes.max()) > 1:
        return found
    right = np.flatnonzero(group == np.argmax(sizes))
    wrong = group != np.argmax(sizes)
    for end, nearest in ((slice(right[0]), right[0]), (slice(right[-1] + 1, None), right[-1])):
        jump = np.abs(level[end] - level[nearest])
        wrong[end] &= late and bool((jump > np.log(FAR_AT_END)).all())
    found[places[wrong]] = True
    return found


def of_row(
    frequencies: Array, values: Array, name: str, unit: str = "", *, late: bool = True
) -> list[TypingError]:
    """Return the mistyped values of one row (n_bands,).

    ``name`` is what is printed: "T30 (S1 to R2)", "alpha of floor".

    Examples
    --------
    >>> of_row(np.array([500, 1000, 2000]), np.array([1.9, 19.4, 1.6]), "T20", " s")[0].text
    'T20 = 19.4 s, beside 1.9 s at 500 Hz and 1.6 s at 2000 Hz'
    """
    wrong = far_from_neighbours(values, late=late)
    right = np.flatnonzero(np.isfinite(values) & ~wrong)
    out = []
    for k in np.flatnonzero(wrong):
        beside = [*right[right < k][-1:], *right[right > k][:1]]
        told = [f"{values[j]:.3g}{unit} at {bands.label(frequencies[j])}" for j in beside]
        text = f"{name} = {values[k]:.3g}{unit}, beside {' and '.join(told)}"
        out.append(TypingError(float(frequencies[k]), text))
    return out


def in_measurement(measured: Measurement) -> list[TypingError]:
    """Return the mistyped times of a measurement, T20 and T30 first."""
    late = [o for o in REVERBERATION if o.key in measured.values]
    others = [
        o
        for o in OBSERVABLES.values()
        if o.key in measured.values and o not in late and o.unit == "s"
    ]
    out = []
    for o in (*late, *others):
        for pair, row in zip(measured.pairs, measured.values[o.key], strict=True):
            name = o.label if measured.is_summary else f"{o.label} ({' to '.join(pair)})"
            out += of_row(measured.centre_frequencies, row, name, " s", late=o in late)
    return out


def in_room(room: Room) -> list[TypingError]:
    """Return the mistyped coefficients of a room."""
    return [
        error
        for name, row in zip(room.materials, room.alpha, strict=True)
        for error in of_row(room.centre_frequencies, row, f'alpha of "{name}"', late=False)
    ]
