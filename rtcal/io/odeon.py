"""ODEON: a material library (.Li8), two lines for each material.

::

    103 Rough concrete
        0.02000 0.03000 0.03000 0.03000 0.04000 0.07000 0.07000 0.07000

The first line is a number and a description, separated by blanks or a tab. The second has eight
absorption coefficients for the octaves 63 Hz to 8 kHz, separated by blanks or tabs. Empty lines
between materials are kept. A material's name is its number and description; the description alone
suffices where no other material has it.

Sources: ODEON Room Acoustics Software User's Manual, "Materials" (Odeon A/S), and the reader of
Just4RIR (Sorbonne Universite, 2018), which reads ODEON's own library. `docs/io.md` lists what was
not checked in the program.
"""

from __future__ import annotations

import re
from collections import Counter

from rtcal.acoustics.room import Room
from rtcal.io import material_list
from rtcal.io.material_list import Format, ListedMaterial, MaterialList
from rtcal.io.text import Text, decode, lines, shown
from rtcal.support.errors import DataError

__all__ = ["parse", "read", "write"]
__dir__ = __all__.copy

BANDS = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
DECIMALS = 5
LARGEST_NUMBER = 2**31 - 1

_HEAD = re.compile(r"[ \t]*(\d{1,10})[ \t]+(\S(?:.*\S)?)[ \t]*", re.ASCII)


def parse(content: bytes, path: str = "ODEON file") -> MaterialList:
    """Return the materials of a library's content. DataError names file, line and rule."""
    text = decode(content, path)
    materials: list[ListedMaterial] = []
    line_of_number: dict[int, int] = {}
    head: re.Match[str] | None = None
    line = 1
    for line, start, raw in lines(text.characters):
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
            if identity in line_of_number:
                raise DataError(
                    f"{place}: number {identity} is given twice, first on line "
                    f"{line_of_number[identity]}"
                )
            line_of_number[identity] = line
        else:
            materials.append(_material(head, raw, start, place, line - 1))
            head = None
    if head is not None:
        raise DataError(f"{path}, line {line}: its 8 coefficients are missing")
    descriptions = [m.name.split(" ", 1)[1] for m in materials]
    unique = {d for d, times in Counter(descriptions).items() if times == 1}
    return MaterialList(
        path=path,
        text=text,
        materials=tuple(materials),
        aliases={d: m.name for d, m in zip(descriptions, materials, strict=True) if d in unique},
    )


def _material(head: re.Match[str], raw: str, start: int, place: str, line: int) -> ListedMaterial:
    row = material_list.tokens(r"\S+", raw, start)
    if len(row) != len(BANDS):
        raise DataError(f"{place}: {len(row)} values; there are 8, for the octaves 63 Hz to 8 kHz")
    alpha, spans = material_list.coefficients(row, place)
    return ListedMaterial(
        name=f"{int(head.group(1))} {head.group(2)}",
        line=line,
        alpha=alpha,
        centre_frequencies=BANDS,
        spans=spans,
        decimals=DECIMALS,
    )


def _new(room: Room) -> bytes:
    """Return a new library; names without a number get numbers from 10001 on."""
    rows = []
    for i, name in enumerate(room.materials):
        if not (name.isprintable() and name.strip() == name and name):
            raise DataError(f"material {name!r}: an ODEON description is one line of text")
        numbered = re.match(r"\d{1,10} \S", name, re.ASCII)
        rows.append(name if numbered else f"{10001 + i} {name}")
        rows.append("\t" + "\t".join(f"{a:.{DECIMALS}f}" for a in room.alpha[i]))
    return Text("", codec="cp1252").encode("\r\n".join(rows) + "\r\n")


_FORMAT = Format(parse=parse, new=_new, bands=lambda _: BANDS)
read, write = _FORMAT.read, _FORMAT.write
