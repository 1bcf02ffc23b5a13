"""WAV files: the header, checked before a library reads the samples."""

from __future__ import annotations

import os
import struct
from pathlib import Path

from rtcal.errors import DataError

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
