"""The samples of an impulse response: what cannot be used, silence at the end, onset, clipping."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.errors import DataError
from rtcal.io.wav import MAX_CHANNEL_SAMPLES
from rtcal.support.types import Array

LEAST_CLIPPED = 4
"""Number of samples at the largest value from which a response is clipped.

A decay has one such sample, and by rounding a few at most. tests/test_impulse_responses.py
tries both: decays of 10 to 24 bits, and the same clipped at half of the peak.
"""

_SMOOTH = 5.0
"""Largest step beside a smooth maximum, in the file's smallest step.

Samples of a parabola's top that are rounded to one value lie within one step of each other. At most
three times as far from the top, and for a run of three at twice, are their neighbours: 4 steps lower,
and 1 more by their own rounding.
"""

_LARGEST = 1e150
"""Largest sample whose square is finite, with a margin for sums."""


@dataclass(frozen=True)
class Samples:
    """A response with a peak of 1, without the silence at its end.

    Parameters
    ----------
    time : array (n_samples,)
    onset : int
        The first sample within 20 dB of the peak (ISO 3382-1:2009, 5.3.2).
    silence : float
        Duration in s of the digital silence that was left out at the end.
    clipped : int
        Number of clipped samples; 0 for a response that is not clipped.
    """

    time: Array
    onset: int
    silence: float
    clipped: int


def check_usable(signals: Iterable[tuple[str, Any]]) -> None:
    """Raise DataError for responses, with their names, that are silent, broken or too long."""
    silent = []
    for place, signal in signals:
        time = np.asarray(signal.time, dtype=float)
        if time.ndim != 2 or time.shape[0] != 1:
            raise DataError(f"{place}: shape {time.shape}; one channel is needed")
        time = time[0]
        if len(time) > MAX_CHANNEL_SAMPLES:
            raise DataError(f"{place}: {len(time)} samples; at most {MAX_CHANNEL_SAMPLES}")
        check_finite(place, time)
        if not np.any(time):
            silent.append(place)
    if silent:
        raise DataError(
            f"{', '.join(silent)}: silent, every sample is 0; leave "
            f"{'it' if len(silent) == 1 else 'them'} out"
        )


def check_finite(place: str, time: Array) -> None:
    """Raise DataError for a sample that is not finite, or whose square may not be."""
    if (bad := ~(np.abs(time) < _LARGEST)).any():
        first = int(np.argmax(bad))
        raise DataError(
            f"{place}: sample {first + 1} of {len(time)} is {time[first]:g}, not a finite number"
            + (f" below {_LARGEST:g}" if np.isfinite(time[first]) else "")
        )


def prepared(signal: Any) -> Samples:
    """Return the samples of a usable response.

    Digital silence at the end, a run of equal samples, is left out. It is no noise, and would
    mislead the search for the noise.
    """
    time = np.asarray(signal.time, dtype=float)[0]
    changes = np.flatnonzero(time != time[-1])
    n_silent = len(time) - 1 - int(changes[-1]) if changes.size else 0
    if n_silent > 1 and np.any(time[: len(time) - n_silent]):  # silence only after a sound
        time = time[: len(time) - n_silent]
    clipped = clipped_samples(time)
    time = time / np.max(np.abs(time))
    onset = int(np.argmax(np.abs(time) >= 0.1))
    return Samples(time, onset, n_silent / float(signal.sampling_rate), clipped)


def clipped_samples(time: Array) -> int:
    """Return the number of clipped samples, 0 unless there are `LEAST_CLIPPED`.

    They are exactly at the largest positive or negative value. A smooth maximum that rounding has
    flattened is not counted: its neighbours are a few of the file's steps lower.

    Examples
    --------
    >>> loud = 5 * np.exp(-np.arange(100) / 20) * np.cos(np.arange(100))
    >>> clipped_samples(np.clip(loud, -1, 1)), clipped_samples(loud)
    (19, 0)
    """
    steps = np.abs(np.diff(time))
    if not steps.any():
        return 0
    step, peak = float(np.min(steps[steps > 0])), float(np.max(np.abs(time)))
    count = 0
    for signed in (time, -time):
        top = float(signed.max())
        if top < peak / 2:
            continue
        at_top = np.concatenate([[False], signed == top, [False]]).astype(np.int8)
        starts, ends = np.flatnonzero(np.diff(at_top) == 1), np.flatnonzero(np.diff(at_top) == -1)
        outside = np.concatenate([[top], signed, [top]])
        drop = top - np.minimum(outside[starts], outside[ends + 1])
        n = int((ends - starts)[drop > _SMOOTH * step].sum())
        count += n if n >= LEAST_CLIPPED else 0
    return count
