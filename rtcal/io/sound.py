"""Sound files by soundfile, and what a response's samples show: silence, onset, clipping, bad values.

Any container and coding that soundfile reads is read, such as WAV, RF64, W64, AIFF, CAF and FLAC. What
the file declares is checked before a sample is loaded, and one channel is loaded at a time, so that a
file needs no more memory than `budget.MAX_CHANNEL_SAMPLES` do.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.io import budget
from rtcal.support import library
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_RATES = 2000, 400_000  # Hz
_BLOCK = 2**16
_LOSSY = re.compile(r"MPEG|VORBIS|OPUS|ADPCM|GSM|G72|[UA]LAW|DWVW|NMS")
_SIZE = re.compile(r": (\d+) \(should be (\d+)\)")
_SLACK = 64  # bytes by which programs miscount the length in a header


@dataclass(frozen=True)
class SoundFile:
    """Declarations of a sound file.

    Parameters
    ----------
    path : str
    n_samples : int
        Of each channel.
    n_channels : int
    sampling_rate : float
        Hz.
    doubts : tuple of str
        A lossy coding, and an end that is missing.
    """

    path: str
    n_samples: int
    n_channels: int
    sampling_rate: float
    doubts: tuple[str, ...]

    def samples(self, channel: int) -> Array:
        """Return the samples of a channel, from 0, (n_samples,); DataError if the file ends before."""
        samples, position = np.empty(self.n_samples), 0
        with _opened(self.path) as file:
            for block in file.blocks(_BLOCK, always_2d=True):
                block = block[: self.n_samples - position, channel]
                samples[position : position + len(block)] = block
                position += len(block)
        if position < self.n_samples:
            raise DataError(
                f"{self.path}: it ends after {position} of the {self.n_samples} samples that it states"
            )
        return samples


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """Yield soundfile's object of a file; DataError, in own words, for what it cannot read."""
    soundfile = library("sound files need soundfile: pip install 'rtcal[measurement]'", "soundfile")
    if not Path(path).is_file():
        raise DataError(f"{path}: {'not a file' if Path(path).exists() else 'no such file'}")
    try:
        # As a stream, since the content and not the name shows the format.
        with open(path, "rb") as stream, soundfile.SoundFile(stream) as file:
            yield file
    except soundfile.SoundFileError as error:
        raise DataError(
            f"{path}: cannot be read as sound: it is damaged, or in none of the formats of soundfile "
            "(WAV, RF64, W64, AIFF, CAF, FLAC and others). Export it as WAV or FLAC"
        ) from error
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error


def opened(path: str | os.PathLike[str]) -> SoundFile:
    """Return what a sound file declares.

    Raises
    ------
    DataError
        For a file that soundfile cannot read, has no samples or more than the budget of a
        channel, or has a sampling rate that is none of 2 to 400 kHz.
    MissingDependencyError
        If soundfile is not installed.
    """
    place = os.fspath(path)
    with _opened(place) as file:
        n, channels, rate = file.frames, file.channels, file.samplerate
        log, coding, name = file.extra_info, file.subtype, file.subtype_info
    if n < 1:
        raise DataError(f"{place}: no samples in it")
    if not _RATES[0] <= rate <= _RATES[1]:
        raise DataError(f"{place}: a sampling rate of {rate} Hz; 2 kHz to 400 kHz are read")
    most = budget.MAX_CHANNEL_SAMPLES
    remedy = f"that is {most / rate:.0f} s at {rate} Hz; keep the part with the decay"
    budget.require(n, most, "samples in each channel", place, remedy)
    doubts = []
    if _LOSSY.search(coding):
        doubts.append(
            f"{place}: its coding, {name}, is lossy, so that the late decay is in doubt: WAV and FLAC "
            "keep it"
        )
    if any(int(a) > int(b) + _SLACK and int(a) < 2**32 - 1 for a, b in _SIZE.findall(log)):
        doubts.append(f"{place}: it is shorter than its header states, so that its end is missing")
    return SoundFile(place, n, channels, float(rate), tuple(doubts))


LEAST_SILENCE = 0.01
"""Duration in s from which a note mentions the digital silence at the end of a response."""
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
class ResponseSamples:
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


def check_usable(responses: Iterable[tuple[str, Array]]) -> None:
    """Raise DataError for responses (n_samples,), with their names, that are silent or broken."""
    silent = []
    for place, time in responses:
        budget.require(len(time), budget.MAX_CHANNEL_SAMPLES, "samples", place)
        if (bad := ~(np.abs(time) < _LARGEST)).any():  # the square of a larger one may overflow
            first = int(np.argmax(bad))
            below = f" below {_LARGEST:g}" if np.isfinite(time[first]) else ""
            raise DataError(
                f"{place}: sample {first + 1} of {len(time)} is {time[first]:g}, not a finite "
                f"number{below}"
            )
        if not np.any(time):
            silent.append(place)
    if silent:
        them = "it" if len(silent) == 1 else "them"
        raise DataError(f"{', '.join(silent)}: silent, every sample is 0; leave {them} out")


def prepared(time: Array, sampling_rate: float) -> ResponseSamples:
    """Return the samples of a usable response, (n_samples,).

    Digital silence at the end, a run of equal samples, is left out. It is no noise, and would
    mislead the search for the noise. A constant offset is taken off, since the band filters answer
    the step at its end.
    """
    changes = np.flatnonzero(time != time[-1])
    n_silent = len(time) - 1 - int(changes[-1]) if changes.size else 0
    if n_silent > 1 and np.any(time[: len(time) - n_silent]):  # silence only after a sound
        time = time[: len(time) - n_silent]
    clipped = clipped_samples(time)
    time = time - np.mean(time[-max(len(time) // 10, 1) :])
    peak = np.max(np.abs(time))
    time = time / (peak if peak > 0 else 1.0)
    onset = int(np.argmax(np.abs(time) >= 0.1))
    return ResponseSamples(time, onset, n_silent / sampling_rate, clipped)


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
