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
from rtcal.io.material_list import Format, ListedMaterial, MaterialList, Token
from rtcal.io.text import decode, line_of, shown
from rtcal.support.errors import DataError

__all__ = ["parse", "read", "write"]
__dir__ = __all__.copy

MAX_DEPTH = 32

_LITERAL = re.compile(r'"(?:[^"\\]|\\.)*"|-?(?:Infinity|\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)|NaN', re.S)
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
    whole = _located(text.characters, path)
    of_file = whole.get("center_freqs") if isinstance(whole, dict) else None
    found: list[tuple[int, bool, ListedMaterial]] = []
    for keys, entry in _objects(whole, (), path):
        coefficients = entry.get("coeffs")
        if not isinstance(coefficients, list) or not coefficients:
            continue
        tokens = [_token(c, path, text.characters) for c in coefficients]
        line = line_of(text.characters, tokens[0][1])
        place = f"{path}, line {line}"
        of_scattering = keys[:1] == ("scattering",)
        values, spans = material_list.coefficients(
            tokens, place, name="scattering" if of_scattering else "alpha"
        )
        centres = entry.get("center_freqs", of_file)
        if not isinstance(centres, list) or not centres:
            raise DataError(f"{place}: these coefficients have no center_freqs")
        frequencies = bands.as_bands(
            material_list.numbers([_token(c, path, text.characters) for c in centres], place),
            f"{place}: center_freqs",
        )
        # In pyroomacoustics, a shorter list begins at the lowest band of its data base.
        shorter = "center_freqs" not in entry and len(values) < len(frequencies)
        if len(values) != len(frequencies) and not shorter:
            raise DataError(
                f"{place}: {len(values)} coefficients for {len(frequencies)} center_freqs"
            )
        listed = ListedMaterial(
            name=str(keys[-1]) if keys else "material",
            line=line,
            alpha=values,
            centre_frequencies=tuple(float(f) for f in frequencies[: len(values)]),
            spans=spans,
        )
        found.append((tokens[0][1], of_scattering, listed))
    found.sort(key=lambda one: one[0])
    scattering: dict[str, ListedMaterial] = {}
    for _, of_scattering, listed in found:
        if of_scattering:
            scattering.setdefault(listed.name, listed)
    materials = [listed for _, of_scattering, listed in found if not of_scattering]
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


def _located(text: str, path: str) -> Any:
    """Return what a JSON text holds; its numbers are tokens, with their place in the text.

    json asks for a number's value in the order of the text, in which the pattern finds them, too.
    """
    numbers = (m for m in _LITERAL.finditer(text) if not m[0].startswith('"'))
    last = 0

    def token(characters: str) -> Token:
        nonlocal last
        match = next(numbers)
        last = match.start()
        return characters, match.start(), match.end()

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entries = dict(pairs)
        if len(entries) < len(pairs):
            twice = next(k for i, (k, _) in enumerate(pairs) if k in dict(pairs[:i]))
            line = line_of(text, last)
            raise DataError(f'{path}, line {line}: the key "{shown(twice)}" is given twice')
        return entries

    try:
        return json.loads(
            text, parse_float=token, parse_int=token, parse_constant=token, object_pairs_hook=once
        )
    except RecursionError as error:
        raise DataError(f"{path}, line 1: nested deeper than {MAX_DEPTH} levels") from error
    except (ValueError, StopIteration) as error:
        line = getattr(error, "lineno", 1)
        raise DataError(f"{path}, line {line}: not valid JSON: {error}") from error


def _token(value: Any, path: str, text: str) -> Token:
    """Return the token of a number; DataError for another value."""
    if not isinstance(value, tuple):
        first = text.find(json.dumps(value))
        line = line_of(text, max(first, 0))
        raise DataError(f"{path}, line {line}: {shown(json.dumps(value))!r} is not a finite number")
    return value


def _objects(value: Any, keys: Keys, path: str) -> Iterator[tuple[Keys, dict[str, Any]]]:
    """Yield each object with its path."""
    if len(keys) > MAX_DEPTH:
        raise DataError(f"{path}, line 1: nested deeper than {MAX_DEPTH} levels")
    if isinstance(value, dict):
        yield keys, value
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    for key, entry in entries:
        if isinstance(entry, (dict, list)):
            yield from _objects(entry, (*keys, key), path)


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
