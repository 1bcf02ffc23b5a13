"""One budget for every reader, checked on what a file declares, before anything of it is loaded.

A file of a few kilobytes can declare gigabytes: zip members that unpack, cells that merge, counts of
accessors, shapes of arrays, instances of instances. What is declared above these limits is refused, so
that no reader takes more than some 300 MB and a few seconds.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence

from rtcal.support.errors import DataError

MAX_UNPACKED = 2**24
"""Largest size in bytes of the unpacked members of a zip file (xlsx, 3MF)."""
MAX_CELLS = 100_000
"""Largest number of cells of a workbook, merged ones counted one by one."""
MAX_FACES = 100_000
"""Largest number of faces of a mesh as it is drawn; those in one plane are joined later."""
MAX_CORNERS = 4 * MAX_FACES
MAX_CHANNEL_SAMPLES = 2**22
"""Largest number of samples of a response: 87 s at 48 kHz. Its analysis takes some 400 MB."""
MAX_SAMPLES = 2**24
"""Largest number of samples of the responses in one file: 128 MB as numbers of 8 bytes."""


def require(number: float, most: float, of: str, path: str, remedy: str = "") -> None:
    """Raise DataError if a file declares more of something than the budget has.

    Examples
    --------
    >>> require(2e6, MAX_FACES, "faces", "hall.ply")
    Traceback (most recent call last):
    ...
    rtcal.support.errors.DataError: hall.ply: declares 2000000 faces; at most 100000 are read
    """
    if number > most:
        advice = f": {remedy}" if remedy else ""
        raise DataError(f"{path}: declares {number:.0f} {of}; at most {most:.0f} are read{advice}")


def members(content: bytes, path: str, kind: str) -> dict[str, int]:
    """Return the sizes in bytes of a zip file's members by name.

    Raises DataError for what is no zip file, and for members that unpack to more than `MAX_UNPACKED`.
    Python's zipfile unpacks no more of a member than is declared.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            sizes = {part.filename: part.file_size for part in archive.infolist()}
    except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError) as error:
        raise DataError(f"{path}: not {kind}: {error}") from error
    require(sum(sizes.values()), MAX_UNPACKED, "bytes when unpacked", path)
    return sizes


def instances(
    own: Mapping[str, int], parts: Mapping[str, Sequence[str]], roots: Iterable[str], path: str
) -> int:
    """Return how many faces, or instances of parts without any, the roots have in all.

    Parameters
    ----------
    own : mapping of str to int
        Number of faces that stand in a part itself.
    parts : mapping of str to sequence of str
        The parts that a part has instances of.
    roots : iterable of str
        The parts that are drawn.
    path : str
        The file, for messages.

    Raises
    ------
    DataError
        If a part has an instance of itself.
    """
    total: dict[str, int] = {}
    waiting = [*roots]
    begun: set[str] = set()
    while waiting:
        name = waiting[-1]
        further = [part for part in parts.get(name, ()) if part in own and part not in total]
        if name in total or not further:
            inner = sum(total.get(part, 1) for part in parts.get(name, ()))
            total.setdefault(name, max(1, own.get(name, 0) + inner))
            begun.discard(name)
            waiting.pop()
            continue
        begun.add(name)
        if any(part in begun for part in further):
            raise DataError(f'{path}: part "{name}" has an instance of itself')
        waiting += further
    return sum(total[name] for name in roots)
