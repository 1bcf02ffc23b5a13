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

import os
import re
from collections import Counter
from collections.abc import Mapping

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.io import material_list
from rtcal.io.material_export import ExportReport, write_list
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.io.text import MAX_TEXT, Text, decode, lines, number, shown
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import read_bytes

__all__ = ["parse", "read", "write"]
__dir__ = __all__.copy

BANDS = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
DECIMALS = 5
LARGEST_NUMBER = 2**31 - 1

_HEAD = re.compile(r"[ \t]*(\d{1,10})[ \t]+(\S(?:.*\S)?)[ \t]*", re.ASCII)


def read(path: str | os.PathLike[str]) -> MaterialList:
    """Return the materials of a library; DataError names file, line and rule."""
    return parse(read_bytes(path, MAX_TEXT), os.fspath(path))


@checked
def write(
    room: Room,
    path: str | os.PathLike[str],
    *,
    template: str | os.PathLike[str] | None = None,
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    missing_bands: str = "refuse",
    entries: Mapping[str, str] | None = None,
) -> ExportReport:
    """Write the room's coefficients into ``template``, else into ``path`` if it exists.

    If neither exists, the file is a new library. It has all eight octaves; with
    ``missing_bands="nearest"``, octaves that the room lacks have the coefficients of the nearest
    one. A material's name is "number description"; names without a number get numbers from 10001
    on. Returns the effect of the rounding on T, as `catt.write`.
    """
    return write_list(
        room,
        path,
        read=read,
        new_list=_new_list,
        template=template,
        equation=equation,
        decimals=decimals,
        entries=entries,
        new_bands=BANDS,
        missing_bands=missing_bands,
    )


@checked
def parse(content: bytes, path: str = "ODEON file") -> MaterialList:
    """Return the materials of a library's content; see `read`."""
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
    tokens = list(re.finditer(r"\S+", raw))
    if len(tokens) != len(BANDS):
        raise DataError(
            f"{place}: {len(tokens)} values; there are 8, for the octaves 63 Hz to 8 kHz"
        )
    values = [number(t.group(), place) for t in tokens]
    material_list.check_coefficients(values, 1.0, place)
    return ListedMaterial(
        name=f"{int(head.group(1))} {head.group(2)}",
        line=line,
        alpha=tuple(values),
        centre_frequencies=BANDS,
        spans=tuple((start + t.start(), start + t.end()) for t in tokens),
        decimals=DECIMALS,
    )


def _new_list(room: Room) -> MaterialList:
    rows = []
    for i, name in enumerate(room.materials):
        if not (name.isprintable() and name.strip() == name and name):
            raise DataError(f"material {name!r}: an ODEON description is one line of text")
        numbered = re.match(r"\d{1,10} \S", name, re.ASCII)
        rows.append(name if numbered else f"{10001 + i} {name}")
        rows.append("\t" + "\t".join(f"{a:.{DECIMALS}f}" for a in room.alpha[i]))
    return parse(Text("", codec="cp1252").encode("\r\n".join(rows) + "\r\n"))
