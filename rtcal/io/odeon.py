"""ODEON: a material library (.Li8), two lines for each material.

::

    103 Rough concrete
        0.02000 0.03000 0.03000 0.03000 0.04000 0.07000 0.07000 0.07000

The first line is a number and a description, parted by blanks or a tab; the second has eight
absorption coefficients for the octaves 63 Hz to 8 kHz, parted by blanks or tabs. Lines may end
either way; empty lines between materials are kept. A material's name is its number and description;
the description alone will do where no other material has it.

Sources: ODEON Room Acoustics Software User's Manual, "Materials" (Odeon A/S), and the reader of
Just4RIR (Sorbonne Universite, 2018), which takes ODEON's own library; `docs/io.md` says what could
not be checked in the program.
"""

from __future__ import annotations

import os
import re
from collections import Counter

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.io import materials
from rtcal.io.materials import ListedMaterial, MaterialList, Written
from rtcal.io.source import MAX_TEXT, as_text, number, readable, shown
from rtcal.support.files import read_bytes

BANDS = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
DECIMALS = 5
LARGEST_NUMBER = 2**31 - 1

_HEAD = re.compile(r"[ \t]*(\d{1,10})[ \t]+(\S(?:.*\S)?)[ \t]*\r?", re.ASCII)


def read(path: str | os.PathLike[str]) -> MaterialList:
    """Read an ODEON material library; DataError names file, line and rule."""
    return parse(read_bytes(path, MAX_TEXT), os.fspath(path))


def write(
    room: Room,
    path: str | os.PathLike[str],
    *,
    template: str | os.PathLike[str] | None = None,
    equation: LinearEquation | None = None,
    decimals: int | None = None,
) -> Written:
    """Write the room's coefficients into ``template``, else into ``path`` if it is there.

    Without either a new library is made, of materials "number description" (others are numbered
    from 10001); it needs all eight octaves. Returns what the rounding does to T, as `catt.write`.
    """
    return materials.write(
        room,
        path,
        read=read,
        fresh=_fresh,
        template=template,
        equation=equation,
        decimals=decimals,
    )


def parse(content: bytes, path: str = "ODEON file") -> MaterialList:
    """Return the materials of a library's content; see `read`."""
    found: list[ListedMaterial] = []
    numbers: dict[int, int] = {}
    head: re.Match[str] | None = None
    start = 0
    for line, raw in enumerate(as_text(content).split("\n"), start=1):
        place = f"{path}, line {line}"
        if not raw.strip():
            if head is not None:
                raise DataError(f"{place}: empty; the line after a description has 8 coefficients")
        elif head is None:
            head = _HEAD.fullmatch(raw)
            if head is None or int(head.group(1)) > LARGEST_NUMBER:
                raise DataError(
                    f'{place}: "{shown(raw)}" is not a number, up to {LARGEST_NUMBER}, and a '
                    "description"
                )
            identity = int(head.group(1))
            if identity in numbers:
                raise DataError(
                    f"{place}: number {identity} is given twice, first on line {numbers[identity]}"
                )
            numbers[identity] = line
        else:
            tokens = list(re.finditer(r"\S+", raw))
            if len(tokens) != len(BANDS):
                raise DataError(
                    f"{place}: {len(tokens)} values; there are 8, for the octaves 63 Hz to 8 kHz"
                )
            values = [number(t.group(), place) for t in tokens]
            materials.checked(values, 1.0, place)
            found.append(
                ListedMaterial(
                    name=f"{int(head.group(1))} {readable(head.group(2))}",
                    line=line - 1,
                    alpha=tuple(values),
                    centre_frequencies=BANDS,
                    spans=tuple((start + t.start(), start + t.end()) for t in tokens),
                    decimals=DECIMALS,
                )
            )
            head = None
        start += len(raw) + 1
    if head is not None:
        raise DataError(f"{path}, line {len(content.splitlines())}: its 8 coefficients are missing")
    called = [m.name.split(" ", 1)[1] for m in found]
    alone = {name for name, times in Counter(called).items() if times == 1}
    return MaterialList(
        path=path,
        content=content,
        materials=tuple(found),
        aliases={c: m.name for c, m in zip(called, found, strict=True) if c in alone},
    )


def _fresh(room: Room) -> MaterialList:
    columns = materials.octaves(room, BANDS, "ODEON")
    lines = []
    for i, name in enumerate(room.materials):
        numbered = re.match(r"\d{1,10} \S", name, re.ASCII)
        lines.append(name if numbered else f"{10001 + i} {name}")
        lines.append("\t" + "\t".join(f"{room.alpha[i, c]:.{DECIMALS}f}" for c in columns))
        if not (name.isprintable() and name.strip() == name and name):
            raise DataError(f"material {name!r}: an ODEON description is one line of text")
        try:
            name.encode("cp1252")
        except UnicodeEncodeError as error:
            raise DataError(
                f'material "{name}": "{error.object[error.start]}" is not in Windows\' code page'
            ) from error
    return parse(("\r\n".join(lines) + "\r\n").encode("cp1252"))
