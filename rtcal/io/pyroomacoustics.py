"""pyroomacoustics: its material dictionaries, and its JSON data base of them.

A material is an object with ``coeffs``; its name is its key. Its bands are its own ``center_freqs``,
else those of the file's outermost object::

    {"center_freqs": [125, 250, 500, 1000, 2000],
     "absorption": {"Walls": {"brick": {"description": "", "coeffs": [0.02, 0.03, 0.03, 0.04, 0.05]}}},
     "scattering": {"diffuser": {"coeffs": [0.1, 0.2, 0.3, 0.4, 0.5]}}}

A single object, ``{"description": ..., "coeffs": [...], "center_freqs": [...]}``, is read as a material
named "material". Objects below an outermost ``scattering`` are the scattering of the material of the
same name and bands.
`dictionaries` returns the arguments of pyroomacoustics' ``Material``; the library is not imported.

Source: pyroomacoustics 0.10.1, ``data/materials.json`` and ``parameters.Material``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.io import material_list
from rtcal.io.material_list import Format, ListedMaterial, MaterialList
from rtcal.io.text import decode, line_of, shown
from rtcal.support.errors import DataError

__all__ = ["parse", "read", "write"]
__dir__ = __all__.copy

MAX_DEPTH = 32

_TOKEN = re.compile(r'[ \t\r\n]*("(?:[^"\\]|\\.)*"|[{}\[\]:,]|[^\s{}\[\]:,"]+)', re.S)
Keys = tuple[str | int, ...]
"""The path to a value: keys of objects and indices of lists."""


def dictionaries(room: Room) -> dict[str, dict[str, Any]]:
    """Return the arguments of ``pyroomacoustics.Material`` by material.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1, 0.2]],
    ...             sigma=[[0.01, 0.02]], centre_frequencies=[500, 1000])
    >>> dictionaries(room)["wall"]["energy_absorption"]["coeffs"]
    [0.1, 0.2]
    """
    frequencies = [float(f) for f in room.centre_frequencies]
    result: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(room.materials):
        absorption = {"description": name, "coeffs": [float(a) for a in room.alpha[i]]}
        result[name] = {"energy_absorption": {**absorption, "center_freqs": frequencies}}
        if room.scattering is not None:
            result[name]["scattering"] = {
                "description": name,
                "coeffs": [float(s) for s in room.scattering[i]],
                "center_freqs": frequencies,
            }
    return result


def parse(content: bytes, path: str = "JSON file") -> MaterialList:
    """Return the materials of a JSON file's content; DataError names the line and the rule."""
    text = decode(content, path)
    lists: dict[Keys, list[material_list.Token]] = {}
    for where, token, begin, end in _scalars(text.characters, path):
        if (
            len(where) > 1
            and isinstance(where[-1], int)
            and where[-2] in ("coeffs", "center_freqs")
        ):
            lists.setdefault(where[:-1], []).append((token, begin, end))
    try:
        json.loads(text.characters)
    except (ValueError, RecursionError) as error:
        line = getattr(error, "lineno", 1)
        raise DataError(f"{path}, line {line}: not valid JSON: {error}") from error
    materials, scattering = [], dict[str, ListedMaterial]()
    for where, numbers in lists.items():
        if where[-1] != "coeffs":
            continue
        line = line_of(text.characters, numbers[0][1])
        place = f"{path}, line {line}"
        of_scattering = where[0] == "scattering"
        values = material_list.coefficients(
            material_list.numbers(numbers, place),
            place,
            name="scattering" if of_scattering else "alpha",
        )
        beside = (*where[:-1], "center_freqs")
        centres = lists.get(beside) or lists.get(("center_freqs",))
        if centres is None:
            raise DataError(f"{place}: these coefficients have no center_freqs")
        frequencies = bands.as_bands(
            material_list.numbers(centres, place), f"{place}: center_freqs"
        )
        if len(values) != len(frequencies) and not (
            beside not in lists and len(values) < len(frequencies)
        ):
            raise DataError(
                f"{place}: {len(values)} coefficients for {len(frequencies)} center_freqs"
            )
        listed = ListedMaterial(
            name=str(where[-2]) if len(where) > 1 else "material",
            line=line,
            alpha=values,
            # In pyroomacoustics, a shorter list begins at the lowest band of its data base.
            centre_frequencies=tuple(float(f) for f in frequencies[: len(values)]),
            spans=material_list.spans(numbers),
        )
        if of_scattering:
            scattering.setdefault(listed.name, listed)
        else:
            materials.append(listed)
    return MaterialList(
        path=path,
        text=text,
        materials=tuple(_with_scattering(m, scattering.get(m.name)) for m in materials),
    )


def _with_scattering(material: ListedMaterial, scattering: ListedMaterial | None) -> ListedMaterial:
    """Return the material with the scattering of its name, if that has the same bands."""
    if scattering is None or scattering.centre_frequencies != material.centre_frequencies:
        return material
    return replace(material, scattering=scattering.alpha, scattering_spans=scattering.spans)


def _scalars(text: str, path: str) -> Iterator[tuple[Keys, str, int, int]]:
    """Yield each value that is no object or list: its keys, its characters, its start and end."""
    keys: list[str | int] = []
    seen: list[set[str]] = []
    expect_key = False
    position, end = 0, len(text.rstrip(" \t\r\n"))
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None:
            raise DataError(f"{path}, line {line_of(text, position)}: not valid JSON")
        token, begin = match.group(1), match.start(1)
        position = match.end()
        if token in "{[":
            keys.append("" if token == "{" else 0)
            seen.append(set())
            expect_key = token == "{"
            if len(keys) > MAX_DEPTH:
                raise DataError(
                    f"{path}, line {line_of(text, begin)}: nested deeper than {MAX_DEPTH} levels"
                )
        elif token in "}]":
            if not keys:
                raise DataError(f"{path}, line {line_of(text, begin)}: {token} closes nothing")
            keys.pop()
            seen.pop()
            expect_key = False
        elif token == ",":
            if keys and isinstance(keys[-1], int):
                keys[-1] += 1
            expect_key = bool(keys) and isinstance(keys[-1], str)
        elif token == ":":
            expect_key = False
        elif expect_key and token.startswith('"'):
            key = _key(token, f"{path}, line {line_of(text, begin)}")
            if key in seen[-1]:
                raise DataError(
                    f'{path}, line {line_of(text, begin)}: the key "{shown(token[1:-1])}" is given '
                    "twice"
                )
            seen[-1].add(key)
            keys[-1] = key
        else:
            yield tuple(keys), token, begin, match.end(1)


def _key(token: str, place: str) -> str:
    try:
        return str(json.loads(token))
    except ValueError as error:
        raise DataError(f'{place}: "{shown(token)}" is not a JSON string') from error


def _new(room: Room) -> bytes:
    entries = dictionaries(room)
    content: dict[str, Any] = {
        "center_freqs": [float(f) for f in room.centre_frequencies],
        "absorption": {
            "Calibrated": {name: entry["energy_absorption"] for name, entry in entries.items()}
        },
    }
    if room.scattering is not None:
        content["scattering"] = {
            "Calibrated": {name: entry["scattering"] for name, entry in entries.items()}
        }
    return (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode("utf-8")


_FORMAT = Format(parse=parse, new=_new)
read, write = _FORMAT.read, _FORMAT.write
