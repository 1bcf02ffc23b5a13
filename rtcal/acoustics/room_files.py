"""A room in TOML, the native format.

One ``[[material]]`` for each material::

    name = "Seminar room"
    above_one = "clip"                  # optional: cut ISO 354 coefficients above 1, and say so
    volume = 146.1                      # m³
    centre_frequencies = [500, 1000]    # Hz

    [air]                               # left out: the air absorbs nothing
    temperature = 19.5                  # °C
    humidity = 41.7                     # %
    pressure = 101.325                  # kPa

    [prior]                             # for materials that state no sigma of their own:
    relative = 0.3                      # sigma = in_situ_factor * max(relative * alpha, minimum,
    minimum = 0.01                      #                              ISO 12999-2's if asked for)
    iso_12999_2 = true                  # optional: the spread between laboratories as the least
    in_situ_factor = 1.5                # optional, 1 or more: another specimen, mounted otherwise
    band_correlation = 0.7              # optional: of one material's errors an octave apart

    [[material]]
    name = "plaster"
    area = 34.93                        # m²; or leave it out and give [[surface]]s
    alpha = [0.052, 0.052]              # 0 to 1, one a band
    sigma = 0.05                        # optional: one number, one a band, or a degree of
                                        # uncertainty: "low" 0.01, "moderate" 0.05, "high" 0.1
    alpha_min = 0.01                    # optional: the least that calibration may give
    scattering = [0.1, 0.1]             # optional, for simulators
    source = "where alpha comes from"   # optional

    [[correlation]]                     # optional: of two materials' errors in the same band
    materials = ["plaster", "concrete"]
    value = 0.5

    [[surface]]                         # optional: areas of a material are summed
    name = "north wall"
    material = "plaster"
    area = 12.0                         # m²
    axis = "x"                          # optional: the direction of its normal
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.priors import TIERS, in_situ, sigma_iso_12999_2, sigma_relative
from rtcal.acoustics.room import CalibrationRecord, Material, Room, Surface
from rtcal.errors import DataError
from rtcal.support.files import read_text, write_text
from rtcal.support.types import Array

_ROOM_KEYS = {
    "": {
        "name",
        "volume",
        "centre_frequencies",
        "dimensions",
        "air",
        "prior",
        "material",
        "surface",
        "correlation",
        "calibration",
        "above_one",
        "clipped",
    },
    "air": {"temperature", "humidity", "pressure"},
    "prior": {"relative", "minimum", "iso_12999_2", "in_situ_factor", "band_correlation"},
    "material": {"name", "area", "alpha", "sigma", "alpha_min", "scattering", "source"},
    "surface": {"name", "material", "area", "axis"},
    "correlation": {"materials", "value"},
    "calibration": {"method", "equation", "measured", "solver", "version"},
}

_NEEDED = ("method", "equation", "measured")
_RECORD = (*_NEEDED, "solver", "version")

MAX_BYTES = 2**18
"""Bytes that a room's file may have: thirty times a usual one."""
_MAX_ENTRIES = {"material": 500, "surface": 5000, "correlation": 5000}
_MAX_DOTS = 500


def read_room(path: str | os.PathLike[str]) -> Room:
    """Read a room from TOML. DataError names the file, the place, the value and the rule."""
    return parse_room(read_text(path, MAX_BYTES), os.fspath(path))


def parse_room(text: str, path: str) -> Room:
    """Return the room of a TOML text; ``path`` names it in messages."""
    if any(line.count(".") > _MAX_DOTS for line in text.split("\n") if "=" not in line[:_MAX_DOTS]):
        raise DataError(f"{path}: a key of more than {_MAX_DOTS} parts")
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not valid TOML: {error}") from error
    try:
        return _room(content)
    except OverflowError as error:
        raise DataError(f"{path}: a number is too large: {error}") from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _room(content: Mapping[str, Any]) -> Room:
    _known(content, "", "the file")
    listed = _get(content, "centre_frequencies", list, "the file")
    frequencies = bands.as_bands(
        _values(content, "centre_frequencies", len(listed), "the file", scalar=False)
    )
    prior = _table(content, "prior")
    air = _table(content, "air")
    surfaces = [
        Surface(
            name=_get(entry, "name", str, f"[[surface]] {i + 1}", f"surface {i + 1}"),
            material=str(_get(entry, "material", str, f"[[surface]] {i + 1}")),
            area=_get(entry, "area", (int, float), f"[[surface]] {i + 1}"),
            axis=_get(entry, "axis", str, f"[[surface]] {i + 1}") if "axis" in entry else None,
        )
        for i, entry in enumerate(_entries(content, "surface"))
    ]
    covered = {s.material for s in surfaces}
    names: set[str] = set()
    materials: list[Material] = []
    for i, entry in enumerate(_entries(content, "material")):
        material = _material(entry, f"[[material]] {i + 1}", frequencies, prior)
        if material.name in names:
            raise DataError(f'material "{material.name}" is given twice')
        names.add(material.name)
        materials.append(material)
        drawn = material.name in covered
        if "area" in entry and drawn:
            raise DataError(f'area["{material.name}"] is given, and its surfaces too; give one')
        if "area" in entry:
            area = _get(entry, "area", (int, float), f'material "{material.name}"')
            surfaces.append(Surface(name=material.name, material=material.name, area=area))
        elif not drawn:
            raise DataError(f'area["{material.name}"] is missing, and no [[surface]] has it')
    if not materials:
        raise DataError("no [[material]]; a room has at least one")
    record = _table(content, "calibration")
    if record is not None:
        record = {
            k: _get(record, k, str, "[calibration]") for k in _RECORD if k in record or k in _NEEDED
        }
    dimensions = content.get("dimensions")
    if dimensions is not None:
        if not isinstance(dimensions, list) or len(dimensions) != 3:
            said = str(dimensions)[:40]
            raise DataError(f"dimensions = {said} is not the three lengths of a shoebox in m")
        dimensions = _values(content, "dimensions", 3, "the file", scalar=False).tolist()
    room = Room.from_surfaces(
        name=_get(content, "name", str, "the file", "room"),
        volume=_get(content, "volume", (int, float), "the file"),
        surfaces=surfaces,
        materials=materials,
        centre_frequencies=frequencies,
        air=None if air is None else Air(**_numbers(air, "air")),
        dimensions=dimensions,
        band_correlation=_numbers(prior or {}, "prior").get("band_correlation", 0.0),
        material_correlation=dict(
            _correlation(entry, f"[[correlation]] {i + 1}")
            for i, entry in enumerate(_entries(content, "correlation"))
        ),
        calibration=None if record is None else CalibrationRecord(**record),
        above_one=content.get("above_one", "refuse"),
    )
    clipped = content.get("clipped", [])
    if not isinstance(clipped, list):
        raise DataError("clipped must be a list of texts")
    return room.replace(clipped=(*map(str, clipped), *room.clipped))


def _correlation(entry: Mapping[str, Any], place: str) -> tuple[tuple[str, str], float]:
    pair = _get(entry, "materials", list, place)
    if len(pair) != 2 or not all(isinstance(name, str) for name in pair):
        raise DataError(f"{place}: materials = {pair!r} is not two names")
    return (pair[0], pair[1]), _float(_get(entry, "value", (int, float), place), place)


def _material(
    entry: Mapping[str, Any], place: str, frequencies: Array, prior: Mapping[str, Any] | None
) -> Material:
    n_bands = len(frequencies)
    name = _get(entry, "name", str, place)
    place = f'material "{name}"'
    alpha = _values(entry, "alpha", n_bands, place, scalar=False)
    stated = entry.get("sigma")
    if isinstance(stated, str):
        if stated not in TIERS:
            raise DataError(f'{place}: sigma = "{stated}" is not one of {", ".join(TIERS)}')
        sigma = np.full(n_bands, TIERS[stated])
    elif stated is not None:
        sigma = _values(entry, "sigma", n_bands, place)
    elif prior is not None:
        sigma = _prior_sigma(prior, alpha, frequencies)
    else:
        raise DataError(f"{place} states no sigma, and the file has no [prior] to derive it from")
    return Material(
        name=name,
        alpha=alpha.tolist(),
        sigma=sigma.tolist(),
        alpha_min=_values(entry, "alpha_min", n_bands, place).tolist()
        if "alpha_min" in entry
        else 0.0,
        scattering=_values(entry, "scattering", n_bands, place).tolist()
        if "scattering" in entry
        else None,
        source=_get(entry, "source", str, place, ""),
    )


def _prior_sigma(prior: Mapping[str, Any], alpha: Array, frequencies: Array) -> Array:
    """Return sigma by the file's rule for materials that state none of their own."""
    rule = _numbers(prior, "prior")
    sigma = sigma_relative(alpha, rule.get("relative", 0.0), rule.get("minimum", 0.0))
    if prior.get("iso_12999_2", False):
        sigma = np.maximum(sigma, sigma_iso_12999_2(alpha, frequencies))
    return in_situ(sigma, rule.get("in_situ_factor", 1.0))


def _known(table: Mapping[str, Any], kind: str, place: str) -> None:
    for key in table:
        if key not in _ROOM_KEYS[kind]:
            allowed = ", ".join(sorted(_ROOM_KEYS[kind]))
            raise DataError(
                f'{place} has the key "{key}", which means nothing; known are {allowed}'
            )


def _table(content: Mapping[str, Any], key: str) -> Mapping[str, Any] | None:
    table = content.get(key)
    if table is None:
        return None
    if not isinstance(table, dict):
        raise DataError(f"[{key}] must be a table")
    _known(table, key, f"[{key}]")
    return table


def _entries(content: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    entries = content.get(key, [])
    if not (isinstance(entries, list) and all(isinstance(e, dict) for e in entries)):
        raise DataError(f"[[{key}]] must be a list of tables")
    if len(entries) > _MAX_ENTRIES[key]:
        raise DataError(f"{len(entries)} [[{key}]]; a room has at most {_MAX_ENTRIES[key]}")
    for i, entry in enumerate(entries):
        _known(entry, key, f"[[{key}]] {i + 1}")
    return entries


def _get(
    table: Mapping[str, Any], key: str, kind: Any, place: str, otherwise: object = None
) -> Any:
    if key not in table and otherwise is not None:
        return otherwise
    if key not in table:
        raise DataError(f"{place} lacks {key}")
    value = table[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise DataError(f"{place}: {key} = {str(value)[:40]!r} is of the wrong kind")
    return value


def _numbers(table: Mapping[str, Any], place: str) -> dict[str, float]:
    switches = {"iso_12999_2"}
    for key in switches & table.keys():
        if not isinstance(table[key], bool):
            raise DataError(f"[{place}] {key} = {table[key]!r} is not true or false")
    table = {key: value for key, value in table.items() if key not in switches}
    for key, value in table.items():
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise DataError(f"[{place}] {key} = {value!r} is not a number")
        if place == "prior" and not 0 <= value < float("inf"):
            raise DataError(f"[{place}] {key} = {value:g} is not finite and 0 or more")
    return {key: _float(value, f"[{place}] {key}") for key, value in table.items()}


def _float(value: float, place: str) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise DataError(f"{place} is too large a number") from error


def _values(
    entry: Mapping[str, Any], key: str, n_bands: int, place: str, scalar: bool = True
) -> Array:
    value = entry.get(key)
    if value is None:
        raise DataError(f"{place} lacks {key}")
    listed = value if isinstance(value, list) else [value] * n_bands
    if not isinstance(value, list) and not scalar:
        raise DataError(f"{place}: {key} = {value!r} is not a list of one number a band")
    if len(listed) != n_bands:
        raise DataError(f"{place}: {key} has {len(listed)} values; the room has {n_bands} bands")
    for v in listed:
        if not isinstance(v, (int, float)) or isinstance(v, bool):
            raise DataError(f"{place}: {key} has {v!r}, which is not a number")
    return np.array([_float(v, f"{place}: {key}") for v in listed])


def write_room(room: Room, path: str | os.PathLike[str]) -> None:
    """Write a room to TOML, whole or not at all; reading it back gives the same numbers."""
    write_text(path, room_text(room))


def room_text(room: Room) -> str:
    """Return a room as the text of its TOML file."""
    lines = [f"name = {_quoted(room.name)}", f"volume = {room.volume!r}"]
    lines.append(f"centre_frequencies = {_listed(room.centre_frequencies)}")
    if room.dimensions is not None:
        lines.append(f"dimensions = {_listed(room.dimensions)}")
    if room.clipped:
        lines.append("clipped = [" + ", ".join(_quoted(c) for c in room.clipped) + "]")
    if room.band_correlation:
        lines += ["", "[prior]", f"band_correlation = {float(room.band_correlation)!r}"]
    if room.air is not None:
        lines += ["", "[air]"]
        lines += [f"{key} = {float(getattr(room.air, key))!r}" for key in sorted(_ROOM_KEYS["air"])]
    if room.calibration is not None:
        lines += ["", "[calibration]"]
        record = vars(room.calibration)
        lines += [f"{key} = {_quoted(str(record[key]))}" for key in record]
    drawn = {s.material for s in room.surfaces}
    for i, material in enumerate(room.materials):
        lines += ["", "[[material]]", f"name = {_quoted(material)}"]
        if material not in drawn:
            lines.append(f"area = {float(room.areas[i])!r}")
        for key in ("alpha", "sigma", "alpha_min", "scattering"):
            if (value := getattr(room, key)) is not None:
                lines.append(f"{key} = {_listed(value[i])}")
        if material in room.sources:
            lines.append(f"source = {_quoted(room.sources[material])}")
    for (first, second), value in room.material_correlation.items():
        lines += ["", "[[correlation]]", f"materials = [{_quoted(first)}, {_quoted(second)}]"]
        lines.append(f"value = {float(value)!r}")
    for surface in room.surfaces:
        lines += ["", "[[surface]]", f"name = {_quoted(surface.name)}"]
        lines += [f"material = {_quoted(surface.material)}", f"area = {float(surface.area)!r}"]
        if surface.axis is not None:
            lines.append(f"axis = {_quoted(surface.axis)}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    # A JSON string is a TOML basic string but for DEL, which TOML wants escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _listed(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
