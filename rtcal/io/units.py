"""Units of length in files of meshes and in sides of a box, and sizes that another unit explains.

Sources: 3MF Consortium, "3D Manufacturing Format, Core Specification" 1.3, ST_Unit; Autodesk, "DXF
Reference" 2018, header variable $INSUNITS; US survey foot: 1200/3937 m (NIST Handbook 44, Appendix C).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from rtcal.io.text import numbers, shown
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import rounded

OF_3MF = {
    "micron": 1e-6,
    "millimeter": 0.001,
    "centimeter": 0.01,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
"""Lengths in m of 3MF's units by name; a model that names none is in millimeter."""

_SURVEY_FOOT = 1200 / 3937
OF_DXF: dict[int, float | None] = {
    0: None,  # unitless
    1: 0.0254,
    2: 0.3048,
    3: 1609.344,
    4: 0.001,
    5: 0.01,
    6: 1.0,
    7: 1000.0,
    8: 2.54e-8,
    9: 2.54e-5,
    10: 0.9144,
    11: 1e-10,
    12: 1e-9,
    13: 1e-6,
    14: 0.1,
    15: 10.0,
    16: 100.0,
    17: 1e9,
    18: 149_597_870_700.0,
    19: 9_460_730_472_580_800.0,
    20: 3.0856775814913673e16,
    21: _SURVEY_FOOT,
    22: _SURVEY_FOOT / 12,
    23: 3 * _SURVEY_FOOT,
    24: 5280 * _SURVEY_FOOT,
}
"""Lengths in m of DXF's units by the number in $INSUNITS; None where there is none."""

_METRES = ("metre", "metres", "meter", "meters")
_WRITTEN = {
    **dict.fromkeys(("m", *_METRES), 1.0),
    **dict.fromkeys(("cm", *(f"centi{m}" for m in _METRES)), 0.01),
    **dict.fromkeys(("mm", *(f"milli{m}" for m in _METRES)), 0.001),
    **dict.fromkeys(("ft", "feet", "foot", "'"), 0.3048),
    **dict.fromkeys(("in", "inch", "inches", '"'), 0.0254),
}
_UNIT = rf"(?<=[\d.,\s])({'|'.join(sorted(_WRITTEN, key=len, reverse=True))})(?![a-z])"
_FEET_AND_INCHES = re.compile(
    r"([\d.]+)\s*(?:'|ft|feet)\s*([\d.]+)\s*(?:\"|in|inch|inches)(?![a-z])"
)

_WORD = re.compile(r"(?!e[+-]?\d)[a-z/]+[\d²³]*")
"""What is no number and no known unit; the e of 9e3 is a number's."""


def sides(text: str) -> tuple[tuple[float, float, float], float]:
    r"""Return the length, width and height in m that a text gives, and the length of its unit in m.

    >>> sides("9,7,3"), sides("7 x 8 x 3,75 m"), sides("10' x 20' x 8'6\"")
    (((9.0, 7.0, 3.0), 1.0), ((7.0, 8.0, 3.75), 1.0), ((3.048, 6.096, 2.5908), 0.3048))
    """
    plain = re.sub("[\u2019\u2032]", "'", re.sub("[\u201d\u2033]", '"', text.strip().lower()))
    plain = re.sub(r"\s*(?:[x×*]|by)\s*", ";", plain)
    plain = _FEET_AND_INCHES.sub(lambda m: f"{float(m[1]) + float(m[2]) / 12:.10g}'", plain)
    units = {_WRITTEN[unit] for unit in re.findall(_UNIT, plain)}
    if len(units) > 1:
        raise DataError(
            f'"{shown(text)}" has sides in different units; write all sides in one unit'
        )
    bare = re.sub(_UNIT, " ", plain)
    if word := _WORD.search(bare):
        raise DataError(
            f'"{shown(word[0])}" is neither a number nor one of the units m, cm, mm, ft and in'
        )
    unit = units.pop() if units else 1.0
    x, y, z = (
        checks.positive("side", round(side * unit, 9), "m") for side in numbers(bare, [3], "sides")
    )
    return (x, y, z), unit


_COMMENT = re.compile(
    r"(?:^[ \t]*(?:#|comment\b|solid\b).*|\A.{0,70})"
    r"\b(units?(?:[ \t]*([:=])[ \t]*([\d.,]*)|(?:[ \t]+(?:are|in)\b)*)[ \t]*[\[(\"']?([a-z]+))\b"
    r"(?![ \t]*[:=])",
    re.I | re.M,
)
"""A unit that SketchUp and others write into a comment of OBJ, OFF or PLY, or into the head of STL."""
_BEGINNING = 10_000
_NO_UNIT = frozenset(("none", "generic", "unknown", "unitless", "no"))


def in_comments(content: bytes, path: str = "mesh") -> float | None:
    r"""Return the length in m of the unit that comments at the start of a mesh state, or None.

    Raises DataError for a unit behind a colon or an equals sign that is not known.

    >>> in_comments(b"# File units = inches\nv 1 2 3"), in_comments(b"v 1 2 3\nv 4 5 6")
    (0.0254, None)
    """
    lengths, beginning = set[float](), content[:_BEGINNING].decode("latin-1")
    for found in _COMMENT.finditer(beginning):
        words, mark, factor, name = found.groups()
        length = _WRITTEN.get(name.lower()) if factor in (None, "", "1") else None
        if length is not None:
            lengths.add(length)
        elif mark and name.lower() not in _NO_UNIT:
            line = beginning.count("\n", 0, found.end()) + 1
            raise DataError(
                f'{path}, line {line}: the unit of "{shown(words)}" is none of m, cm, mm, ft and in. '
                "Give its length in m, such as unit = 0.001"
            )
    return lengths.pop() if len(lengths) == 1 else None


VOLUME_LIMITS = (1e-3, 2e7)
"""Accepted volumes in m³, from a scale model of a litre. The largest building by volume, Boeing's in
Everett, has 1.33e7 m³."""


def notes(length: float, in_file: float | None, stated: float | None) -> list[str]:
    """Return the notes on the unit in m that was taken, and on one that the file contradicts."""
    if stated is not None and in_file is not None and stated != in_file:
        return [f"the file gives a unit of {in_file:g} m, but {stated:g} m was given and is used"]
    return [f"the file's unit is {length:g} m"] if length != 1.0 else []


def in_words(size: Sequence[float]) -> str:
    """Return the lengths of a box in m in words."""
    return f"{' × '.join(rounded(x, 3) for x in size)} m"


class UnitError(DataError):
    """A mesh whose unit is not the stated one."""


class Advice(NamedTuple):
    """Texts that advise on a doubtful size: how to state another unit, all units, or the height."""

    unit: str
    units: str
    height: str


OF_MESH = Advice(" (unit = {:g})", "", "check whether all walls are drawn, and the unit")
OF_SIDES = Advice(
    "",
    ': write the unit behind the sides, as in "9000 x 7000 x 3000 mm"',
    "the last side is the height, in m unless a unit stands behind the sides",
)


def check_volume(volume: float, unit: float, path: str, advice: Advice = OF_MESH) -> None:
    """Raise UnitError for a volume in m³ that no room has; the message has it in other units."""
    low, high = VOLUME_LIMITS
    if low <= volume <= high:
        return
    others = _in_other_units(volume, unit, VOLUME_LIMITS, advice)
    raise UnitError(
        f"{path}: V = {volume:.3g} m³ must be from {low:g} to {high:g} m³; check the unit{others}"
    )


_USUAL = 5.0, 1_000_000.0  # Volume in m³ of rooms: a bathroom, and the largest hall
_LOWEST = 1.5  # Least height of a room in m
_LARGE = 30_000.0
"""Volume in m³ of nearly all concert halls at most. One that is drawn in feet has 35 times its own."""


def size_doubt(
    volume: float,
    size: Sequence[float],
    unit: float,
    *,
    is_stated: bool = False,
    advice: Advice = OF_MESH,
) -> str:
    """Return a sentence that few rooms have this size, with the size in other units, or "".

    ``volume`` is in m³, ``size`` (x, y, z) in m, () if not known; ``unit`` is the file's in m, which is
    certain if ``is_stated``.

    >>> size_doubt(1.644e7, (), 1.0)
    'V = 16440000 m³ is more than nearly any room has; it is 269 m³ in inches (unit = 0.0254)'
    >>> size_doubt(21.2, (8.4, 8.4, 0.3), 1.0)
    'a height of 0.3 m is less than any room has; check whether all walls are drawn, and the unit'
    """
    said = ""
    if volume < _USUAL[0]:
        said = "less than nearly any room has"
    elif volume > _USUAL[1]:
        said = "more than nearly any room has"
    others = _in_other_units(volume, unit, (20.0, 20_000.0), advice)
    if not said and volume > _LARGE and others and not is_stated:
        said = "more than most halls have"
    if said:
        return f"V = {rounded(volume, 4)} m³ is {said}{others}"
    if size and size[2] < _LOWEST:
        return f"a height of {rounded(size[2], 3)} m is less than any room has; {advice.height}"
    return ""


def _in_other_units(volume: float, unit: float, limits: tuple[float, float], advice: Advice) -> str:
    """Return the volume in each unit in which it lies within the limits, for a message's end, or ""."""
    others = [
        f"{rounded(volume * (scale / unit) ** 3, 3)} m³ in {name}{advice.unit.format(scale)}"
        for name, scale in _UNITS.items()
        if scale != unit and limits[0] <= volume * (scale / unit) ** 3 <= limits[1]
    ]
    return f"; it is {' or '.join(others)}{advice.units}" if others else ""


_UNITS = {"mm": 0.001, "cm": 0.01, "inches": 0.0254, "feet": 0.3048, "m": 1.0}
