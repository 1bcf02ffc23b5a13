"""Where sources and receivers stand: a TOML file with two tables of points in m.

::

    [sources]
    S1 = [1.2, 3.4, 1.5]

    [receivers]
    R1 = [4.0, 2.2, 1.2]
    R2 = [5.1, 4.6, 1.2]

The names are those of the measurement's pairs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence

from rtcal.acoustics.materials import text_name
from rtcal.errors import DataError
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries, toml_table
from rtcal.support.files import read_text

MAX_BYTES = 2**20

Points = dict[str, tuple[float, float, float]]


@checked
def read(path: str | os.PathLike[str]) -> tuple[Points, Points]:
    """Return sources and receivers by name; DataError names the file, the entry and the rule."""
    try:
        entries = Entries("", toml_table(read_text(path, MAX_BYTES)), ("sources", "receivers"))
        return _points(entries, "sources"), _points(entries, "receivers")
    except DataError as error:
        raise DataError(f"{os.fspath(path)}: {error}") from error


@checked
def text(sources: Mapping[str, Sequence[float]], receivers: Mapping[str, Sequence[float]]) -> str:
    """Return the text of a file; reading it back gives the same points."""
    lines = []
    for kind, points in (("sources", sources), ("receivers", receivers)):
        lines += [f"[{kind}]"]
        for name, point in points.items():
            lines += [
                f"{json.dumps(name, ensure_ascii=False)} = [{', '.join(repr(float(x)) for x in point)}]"
            ]
        lines += [""]
    return "\n".join(lines)


def _points(entries: Entries, kind: str) -> Points:
    names = entries.mapping(kind)
    if not names:
        raise DataError(f"{kind} is empty; there is at least one")
    table = entries.entries(kind, (), names)
    points = {}
    for name in names:
        x, y, z = table.array(text_name(kind, name), (3,)).tolist()
        points[name] = (x, y, z)
    return points
