"""A case as TOML, which refers to files of the room and the measurements, or as one JSON file.

The codec of `rtcal.finder.case.Case`: both become the dict that `Case.from_dict` reads. In TOML,
the room and the measurements are files in their native formats::

    room = "room.toml"
    equation = "eyring"                  # or sabine, kuttruff, millington

    [uncertainty]                        # optional, for values that state none
    time = 0.02                          # relative, of T20, T30, EDT
    level = 0.3                          # dB, of C80 and G

    [[configuration]]
    name = "empty"
    measured = "empty.csv"               # with any of T20, EDT, T30, C80, G; or, before it is
                                         # measured, parameters = ["t20", "edt"], positions = 4
    distances = [6.1, 8.3]               # optional, m from source to receiver, one value per pair

    [[configuration]]
    name = "with the curtain drawn"
    measured = "drawn.csv"
    suspect_removed = false              # optional: true if the suspected object was removed
    air = { temperature = 21, humidity = 60 }     # optional, in another climate than the room's
    [configuration.changes."west wall"]  # optional: coefficients that differ from the room's
    alpha = [0.1, 0.3]
    sigma = [0.02, 0.04]
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.finder.configuration import LEVELS, PARAMETERS
from rtcal.support import checks
from rtcal.support.decode import Entries, json_object, toml_table
from rtcal.support.errors import DataError
from rtcal.support.files import read_text

MAX_BYTES = 50_000_000
MAX_POSITIONS = 1000
PLANNED_UNCERTAINTY = {"time": 0.02, "level": 0.3}
"""Uncertainty assumed for planned measurements: 2 % of a decay time, 0.3 dB of C80 and G."""

_KEYS = ("uncertainty", "equation", "configuration")


def read(path: str) -> dict[str, Any]:
    """Return the dict that `Case.from_dict` reads; DataError names the file and the rule."""
    text = read_text(path, MAX_BYTES)
    try:
        if str(path).endswith(".json"):
            return json_object(text)
        content = toml_table(text)
        if "material" in content:
            raise DataError("this is a room's file; name what was measured in the room beside it")
        if "geometry" in content:
            raise DataError(
                "a case states no geometry: write [geometry] with mesh, [sources] and [receivers] into "
                "the room's file, and name it and the measurement: room.toml pairs.csv"
            )
        file = Entries("", content, ("room",), _KEYS)
        configurations = [
            (checks.mapped(f"configuration[{i}]", each))
            for i, each in enumerate(file.listed("configuration", []))
        ]
        if not file.text("room").strip():
            raise DataError("room is not the name of a room's file")
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    folder = Path(path).parent
    room = Room.from_file(str(folder / content["room"]))
    data: dict[str, Any] = {
        key: content[key] for key in ("equation", "uncertainty") if key in content
    }
    data["room"] = room.to_dict()
    try:
        data["configurations"] = [_configuration(folder, room, each) for each in configurations]
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    return data


def files(path: str) -> list[Path]:
    """Return the paths that a valid case file refers to, itself included."""
    case = Path(path)
    if path.endswith(".json"):
        return [case]
    content = toml_table(read_text(path, MAX_BYTES))
    names = [content["room"], *(c.get("measured") for c in content.get("configuration", ()))]
    return [case, *(case.parent / name for name in names if name is not None)]


def _configuration(folder: Path, room: Room, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration of a TOML file with its measurement in place of the file's name."""
    if "parameters" in entry:
        return _planned(room, entry)
    if not isinstance(entry.get("measured"), str) or not entry["measured"].strip():
        raise DataError("a configuration has no measured = a measurement's file")
    measured = Measurement.from_file(str(folder / entry["measured"]))
    return {**entry, "measured": measured.to_dict()}


def _planned(room: Room, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration of a planned measurement, with 1 in place of each value."""
    where = f'configuration "{text_name("configuration: name", entry.get("name", "planned"))}"'
    if beside := [k for k in ("measured", *PARAMETERS, "uncertainty") if k in entry]:
        raise DataError(
            f"{where}: {beside[0]} stands beside parameters; a configuration is measured or planned"
        )
    wanted = entry["parameters"]
    fits = isinstance(wanted, list) and all(p in PARAMETERS for p in wanted) and "t20" in wanted
    if not fits or len(set(wanted)) < len(wanted):
        raise DataError(
            f"{where}: parameters is not a list of {', '.join(PARAMETERS)}, t20 in it, each once"
        )
    n_pairs = checks.whole(f"{where}: positions", entry.get("positions", 4), 1)
    if n_pairs > MAX_POSITIONS:
        raise DataError(f"{where}: positions = {n_pairs} is not at most {MAX_POSITIONS}")

    def rows(value: float) -> list[list[float]]:
        return [[value] * room.n_bands] * n_pairs

    return {
        "name": "planned",
        **{k: v for k, v in entry.items() if k not in ("parameters", "positions")},
        **{p: rows(1.0) for p in wanted},
        "uncertainty": {
            p: rows(PLANNED_UNCERTAINTY["level" if p in LEVELS else "time"]) for p in wanted
        },
        "planned": True,
    }
