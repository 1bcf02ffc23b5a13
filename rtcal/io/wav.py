"""WAV files: the header is checked before a library reads the samples, and then the samples are.

The samples show silence at the end, the onset, clipping, and values that cannot be used.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.support.errors import DataError
from rtcal.support.types import Array

MAX_SAMPLES = 2**22
"""Largest number of samples of a file, all channels together."""

MAX_CHANNEL_SAMPLES = 900_000
"""Largest number of samples of a channel: 18 s at 48 kHz."""

_FORMATS = {1: (16, 24, 32), 3: (32, 64)}  # PCM and float; the range of 8 bits is too small for T20


def check_header(path: str | os.PathLike[str]) -> None:
    """Raise DataError unless a WAV file's format, channels, rate and length can be read.

    Libraries that read sound trust the header, so a broken one may exhaust the memory.
    """
    try:
        if not Path(path).is_file():
            raise DataError(f"{path}: {'not a file' if Path(path).exists() else 'no such file'}")
        with open(path, "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            head = stream.read(12)
            if head[:4] != b"RIFF" or head[8:] != b"WAVE":
                raise DataError(f"{path}, byte 0: not a WAV file (RIFF ... WAVE)")
            sample_format, position = None, 12
            for _ in range(1000):
                stream.seek(position)
                chunk = stream.read(8)
                if len(chunk) < 8:
                    break
                name, length = struct.unpack("<4sI", chunk)
                if position + 8 + length > size:
                    raise DataError(
                        f"{path}, byte {position}: chunk {name.decode('latin-1')!r} is longer than "
                        "the file"
                    )
                if name == b"fmt ":
                    sample_format = _format(
                        stream.read(min(length, 40)), f"{path}, byte {position}"
                    )
                elif name == b"data" and sample_format is not None:
                    samples = length // sample_format[0]
                    if not (
                        samples <= MAX_SAMPLES
                        and samples // sample_format[1] <= MAX_CHANNEL_SAMPLES
                    ):
                        raise DataError(
                            f"{path}, byte {position}: {samples // sample_format[1]} samples in "
                            f"{sample_format[1]} channels; at most {MAX_CHANNEL_SAMPLES}, "
                            f"{MAX_SAMPLES} in all"
                        )
                    return
                position += 8 + length + length % 2
    except (OSError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    raise DataError(f"{path}: no samples (chunk 'data' after 'fmt ') in it")


def _format(head: bytes, place: str) -> tuple[int, int]:
    """Return the bytes per sample and the number of channels of a format chunk."""
    if len(head) < 16:
        raise DataError(f"{place}: the format chunk has {len(head)} bytes; 16 are needed")
    tag, channels, rate, _, _, bits = struct.unpack("<HHIIHH", head[:16])
    if tag == 0xFFFE and len(head) >= 26:
        tag = struct.unpack("<H", head[24:26])[0]
    if bits not in _FORMATS.get(tag, ()):
        raise DataError(
            f"{place}: format {tag} of {bits} bits is none of PCM of 16, 24, 32 and float"
        )
    if not (1 <= channels <= 64 and 2000 <= rate <= 400_000):
        raise DataError(
            f"{place}: {channels} channels at {rate} Hz; 1 to 64 at 2 kHz to 400 kHz are read"
        )
    return bits // 8, channels


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


def prepared(signal: Any) -> ResponseSamples:
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
    return ResponseSamples(time, onset, n_silent / float(signal.sampling_rate), clipped)


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
