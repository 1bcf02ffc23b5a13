"""Tables of sigma by material, in CSV: one number per material, or one per band.

::

    material,sigma           material,125,250,500
    brick,0.02               brick,0.02,0.02,0.03
"""

from __future__ import annotations

import os

from rtcal.io import bras
from rtcal.io.material_list import ListedMaterial
from rtcal.io.text import MAX_TEXT, decode, lines, number
from rtcal.support.errors import DataError
from rtcal.support.files import read_bytes


def read(path: str | os.PathLike[str]) -> dict[str, ListedMaterial | float]:
    """Return sigma by material; its bands may differ from the room's.

    Raises
    ------
    DataError
        Naming file, line and rule.
    """
    content, place = read_bytes(path, MAX_TEXT), os.fspath(path)
    rows = [
        (line, [cell.strip() for cell in raw.split(",")])
        for line, _, raw in lines(decode(content, place).characters)
        if raw.strip()
    ]
    if not rows or rows[0][1] != ["material", "sigma"]:
        return {m.name: m for m in bras.parse(content, place).materials}
    sigma: dict[str, ListedMaterial | float] = {}
    for line, cells in rows[1:]:
        if len(cells) != 2:
            raise DataError(f"{place}, line {line}: {len(cells)} cells; the header has 2")
        if cells[0] in sigma:
            raise DataError(f'{place}, line {line}: "{cells[0]}" is given twice')
        value = number(cells[1], f"{place}, line {line}")
        if not 0 <= value <= 1:
            raise DataError(f"{place}, line {line}: sigma {value:g} is not in [0, 1]")
        sigma[cells[0]] = value
    return sigma
