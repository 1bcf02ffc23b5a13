"""One budget for every reader, checked on what a file declares, before anything of it is loaded.

A file of a few kilobytes can declare gigabytes: zip members that unpack, cells that merge, counts of
accessors, shapes of arrays, instances of instances. What is declared above these limits is refused, so
that no reader takes more than some 300 MB and a few seconds.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager

from rtcal.support.errors import DataError, MissingDependencyError, RtcalError

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
    """Raise DataError if a file declares more of something than the budget has."""
    if number > most:
        advice = f": {remedy}" if remedy else ""
        raise DataError(f"{path}: has {number:.0f} {of}, but at most {most:.0f} are read{advice}")


@contextmanager
def parsing(path: str, kind: str, remedy: str, extra: str = "all") -> Iterator[None]:
    """Raise DataError for whatever the parser of a library raises."""
    try:
        yield
    except RtcalError:
        raise
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: needs another library ({error}): pip install 'rtcal[{extra}]'"
        ) from error
    except Exception as error:
        why = " ".join(str(error).split())
        raise DataError(f"{path}: cannot be read as {kind}: {why}. {remedy}") from error


def without_entities(content: bytes, path: str) -> bytes:
    """Return an XML text; DataError if it declares entities, a few of which unpack to gigabytes."""
    plain = content.replace(b"\0", b"")  # of UTF-16
    at = plain.find(b"<!ENTITY")
    if at >= 0:
        line = plain.count(b"\n", 0, at) + 1
        raise DataError(
            f"{path}, line {line}: declares an XML entity, which no export needs and rtcal does not "
            "read. Export it again"
        )
    return content


def members(content: bytes, path: str, kind: str) -> dict[str, int]:
    """Return the sizes in bytes of a zip file's members by name."""
    with parsing(path, kind, "Export it again"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        sizes = {part.filename: part.file_size for part in archive.infolist()}
    require(sum(sizes.values()), MAX_UNPACKED, "bytes when unpacked", path)
    return sizes
