"""A case's files: TOML beside a room and a measurement, and the JSON that holds all of it.

In a file (TOML), beside a room and a measurement in rtcal's own formats::

    room = "room.toml"
    equation = "eyring"                  # or sabine, kuttruff, millington

    [uncertainty]                        # optional, of single values that state none
    time = 0.02                          # relative, of T20, T30, EDT
    level = 0.3                          # dB, of C80 and G

    [[configuration]]
    name = "empty"
    measured = "empty.csv"               # any of T20, EDT, T30, C80, G; or, before measuring,
                                         # parameters = ["t20", "edt"] and positions = 4
    distances = [6.1, 8.3]               # optional, m from source to receiver, a value a pair

    [[configuration]]
    name = "with the curtain drawn"
    measured = "drawn.csv"
    suspect_removed = false              # optional: true where what is suspected was taken away
    air = { temperature = 21, humidity = 60 }     # optional, where it was another climate
    [configuration.changes."west wall"]  # optional: coefficients that differ from the room's
    alpha = [0.1, 0.3]
    sigma = [0.02, 0.04]
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import CalibrationRecord, Room, text_name
from rtcal.discrepancy.case import AppliedEffect, Case, Change, Configuration
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.files import json_numbers, read_text
from rtcal.support.types import Array

PARAMETERS = ("t20", "edt", "t30", "c80", "g")
_LARGEST = 50_000_000  # bytes
_MOST = {"time": (1.0, " (relative: 0.02 is 2 %)"), "level": (20.0, " dB")}
_MOST_POSITIONS = 1000


def from_dict(data: Mapping[str, Any]) -> Case:
    """See `Case.from_dict`."""
    where = "case"
    room_data = dict(_mapping(where, data, "room"))
    facing = room_data.pop("facing", None)
    climate = room_data.pop("air", None)
    record = room_data.pop("calibration", None)
    try:
        room = Room(
            **{"name": "room", **room_data},
            air=_air(f"{where}: room: air", climate),
            calibration=_record(f"{where}: room: calibration", record),
        )
    except TypeError as error:
        raise DataError(f"{where}: room: {error}") from error
    uncertainty = _uncertainty(where, data.get("uncertainty"))
    configurations = data.get("configurations")
    if not isinstance(configurations, Sequence) or not configurations:
        raise DataError(f"{where}: configurations is missing or empty")
    return Case(
        room=room,
        equation=str(data.get("equation", "eyring")),
        facing=facing,
        configurations=[
            _configuration(room, checks.mapped(f"{where}: configurations", c), uncertainty)
            for c in configurations
        ],
        applied=[
            _applied(checks.mapped(f"{where}: present", p))
            for p in checks.listed(f"{where}: present", data.get("present", ()))
        ],
    )


def to_dict(case: Case) -> dict[str, Any]:
    """See `Case.to_dict`."""
    room = case.room
    if own := [p.name for p in case.applied if p.custom is not None]:
        raise DataError(
            f'effect "{own[0]}" is not in the library: a case that holds it cannot be saved, since '
            "whoever reads it does not know the effect"
        )
    more: dict[str, Any] = {
        name: np.asarray(value).tolist()
        for name in ("alpha_min", "scattering", "dimensions")
        if (value := getattr(room, name)) is not None
    }
    if room.calibration is not None:
        more["calibration"] = vars(room.calibration).copy()
    return {
        "room": {
            "name": room.name,
            "volume": room.volume,
            "materials": list(room.materials),
            "areas": room.areas.tolist(),
            "alpha": room.alpha.tolist(),
            "sigma": room.sigma.tolist(),
            "band_correlation": room.band_correlation,
            "centre_frequencies": room.centre_frequencies.tolist(),
            "air": _air_dict(room.air),
            "facing": case.facing.tolist(),
            **more,
        },
        "equation": case.equation,
        "configurations": [_configuration_dict(c) for c in case.configurations],
        "present": [p.to_dict() for p in case.applied],
    }


def read(path: str) -> Case:
    """See `Case.from_file`."""
    text = read_text(path, _LARGEST)
    try:
        if str(path).endswith(".json"):
            return from_dict(checks.mapped(str(path), json.loads(text)))
        data = tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataError(f"{path}: {error}") from error
    folder = Path(path).parent
    known = {"room", "equation", "uncertainty", "configuration"}
    if unknown := sorted(set(data) - known):
        raise DataError(f'{path}: "{unknown[0]}" is not one of {", ".join(sorted(known))}')
    if not isinstance(data.get("room"), str) or not data["room"].strip():
        raise DataError(f"{path}: room is not the name of a room's file")
    room = Room.from_file(str(folder / data["room"]))
    uncertainty = _uncertainty(path, data.get("uncertainty"))
    configurations = []
    entries = data.get("configuration", ())
    for each in checks.listed(f"{path}: configuration", entries):
        entry = checks.mapped(f"{path}: configuration", each)
        if "parameters" in entry:
            configurations.append(_planned(room, entry))
            continue
        if not isinstance(entry.get("measured"), str) or not entry["measured"].strip():
            raise DataError(f"{path}: a configuration has no measured = a measurement's file")
        measured = Measurement.from_file(str(folder / entry["measured"]))
        rest = {k: v for k, v in entry.items() if k != "measured"}
        configurations.append(_configuration(room, rest, uncertainty, measured))
    return Case(room=room, equation=data.get("equation", "eyring"), configurations=configurations)


def files(path: str) -> list[Path]:
    """Return the files that a case is read from, of one that can be read."""
    found = [Path(path)]
    if not path.endswith(".json"):
        data = tomllib.loads(read_text(path, _LARGEST))
        names = [data["room"], *(c.get("measured") for c in data.get("configuration", ()))]
        found += [found[0].parent / name for name in names if name is not None]
    return found


def _stated(where: str, data: Mapping[str, Any], name: str) -> Any:
    if name not in data:
        raise DataError(f"{where}: {name} is missing")
    return data[name]


def _mapping(where: str, data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return checks.mapped(f"{where}: {name}", _stated(where, data, name))


def _configuration(
    room: Room,
    data: Mapping[str, Any],
    uncertainty: Mapping[str, float],
    measured: Measurement | None = None,
) -> Configuration:
    name = _name(data, "measured")
    known = {"name", "changes", "suspect_removed", "air", "distances", "distance"}
    inline = (*PARAMETERS, "uncertainty", *_SAVED)
    if unknown := sorted(set(data) - known - set(inline)):
        raise DataError(f'configuration "{name}": "{unknown[0]}" is not known')
    if measured is not None and (beside := [p for p in inline if p in data]):
        raise DataError(
            f'configuration "{name}": {beside[0]} stands beside measured; values come from one of them'
        )
    if measured is None:
        values = {p: _table(name, p, data[p], room.n_bands) for p in PARAMETERS if p in data}
        if not values:
            raise DataError(f'configuration "{name}" has none of {", ".join(PARAMETERS)}')
        n = {len(v) for v in values.values()}
        if len(n) > 1:
            raise DataError(f'configuration "{name}": parameters for different numbers of pairs')
        pairs = data.get("pairs", [("S", f"R{i + 1}") for i in range(n.pop())])
        spread = _optional(
            f'configuration "{name}": standard_deviation', data.get("standard_deviation")
        )
        stated = {
            str(p): _table(name, p, v, room.n_bands)
            for p, v in _optional(
                f'configuration "{name}": uncertainty', data.get("uncertainty")
            ).items()
        }
        measured = Measurement(
            centre_frequencies=room.centre_frequencies,
            values=values,
            pairs=pairs,
            uncertainty=stated,
            n_sources=data.get("n_sources"),
            n_receivers=data.get("n_receivers"),
            standard_deviation={
                str(p): _table(name, p, v, room.n_bands)[0] for p, v in spread.items()
            },
        )
    extra = dict(measured.uncertainty)
    for p, v in measured.values.items():
        kind = "level" if p in ("c80", "g") else "time"
        if p not in extra and kind in uncertainty:
            scale = v if kind == "time" else np.ones_like(v)
            extra[p] = scale * float(uncertainty[kind])
    changes = _optional(f'configuration "{name}": changes', data.get("changes"))
    distances = data.get("distances", data.get("distance"))
    return Configuration(
        name=name,
        measured=replace(measured, uncertainty=extra),
        changes={
            str(m): _change(f'configuration "{name}": changes: "{m}"', v)
            for m, v in changes.items()
        },
        suspect_removed=checks.flag(
            f'configuration "{name}": suspect_removed', data.get("suspect_removed", False)
        ),
        air=_air(f'configuration "{name}": air', data.get("air")),
        planned=checks.flag(f'configuration "{name}": planned', data.get("planned", False)),
        distances=(
            None
            if distances is None
            else checks.array(f'configuration "{name}": distances', distances)
        ),
    )


def _applied(data: Mapping[str, Any]) -> AppliedEffect:
    where = "case: present"
    parameters = _mapping(where, data, "parameters")
    values = {str(k): checks.number(f"{where}: {k}", v) for k, v in parameters.items()}
    ends = data.get("size_interval")
    if ends is not None:
        ends = checks.array(f"{where}: size_interval", ends)
        if ends.shape != (2,):
            raise DataError(f"{where}: size_interval is not two numbers")
        ends = (float(ends[0]), float(ends[1]))
    return AppliedEffect(str(data.get("effect")), values, ends)


def _record(where: str, record: Any) -> CalibrationRecord | None:
    if record is None:
        return None
    entry = checks.mapped(where, record)
    known = [f.name for f in fields(CalibrationRecord)]
    for name, value in entry.items():
        if name not in known or not isinstance(value, str):
            raise DataError(f"{where}: {name} = {value!r} is not a text for {', '.join(known)}")
    for name in ("method", "equation", "measured"):
        _stated(where, entry, name)
    return CalibrationRecord(**entry)


def _name(data: Mapping[str, Any], default: str) -> str:
    return text_name("configuration: name", data.get("name", default))


def _optional(where: str, value: Any) -> dict[Any, Any]:
    return {} if value is None else checks.mapped(where, value)


def _air(where: str, climate: Any) -> Air | None:
    if climate is None:
        return None
    stated, known = checks.mapped(where, climate), [f.name for f in fields(Air)]
    if unknown := sorted(set(map(str, stated)) - set(known)):
        raise DataError(f'{where}: "{unknown[0]}" is not one of {", ".join(known)}')
    return Air(**stated)


def _change(where: str, value: Any) -> Change:
    entry = checks.mapped(where, value)
    for name in ("alpha", "sigma"):
        _stated(where, entry, name)
    return Change(*(checks.array(f"{where}: {name}", entry[name]) for name in ("alpha", "sigma")))


def _uncertainty(where: str, value: Any) -> dict[str, float]:
    """Stated for values that state none: ``time`` relative, ``level`` in dB."""
    table = _optional(f"{where}: uncertainty", value)
    out = {}
    for name, stated in table.items():
        if name not in ("time", "level"):
            raise DataError(f'{where}: uncertainty: "{name}" is not time or level')
        place = f"{where}: uncertainty: {name}"
        out[name] = checks.positive(place, stated)
        most, unit = _MOST[name]
        if out[name] > most:
            raise DataError(f"{place} = {out[name]:g} is not at most {most:g}{unit}")
    return out


def _planned(room: Room, data: Mapping[str, Any]) -> Configuration:
    """A configuration that states which parameters will be measured, and at how many positions."""
    name = _name(data, "planned")
    if beside := [k for k in ("measured", *PARAMETERS, "uncertainty") if k in data]:
        raise DataError(
            f'configuration "{name}": {beside[0]} stands beside parameters; a configuration is '
            "measured or planned"
        )
    wanted = data["parameters"]
    fits = isinstance(wanted, list) and all(p in PARAMETERS for p in wanted) and "t20" in wanted
    if not fits or len(set(wanted)) < len(wanted):
        raise DataError(
            f'configuration "{name}": parameters is not a list of {", ".join(PARAMETERS)}, '
            "t20 in it, each once"
        )
    n = checks.whole(f'configuration "{name}": positions', data.get("positions", 4), 1)
    if n > _MOST_POSITIONS:
        raise DataError(f'configuration "{name}": positions = {n} is not at most {_MOST_POSITIONS}')
    rows = {p: np.ones((n, room.n_bands)).tolist() for p in wanted}
    rest = {k: v for k, v in data.items() if k not in ("parameters", "positions")}
    stated = {"time": 0.02, "level": 0.3}
    return replace(_configuration(room, {**rest, **rows}, stated), planned=True)


def _table(name: str, parameter: str, values: Any, n_bands: int) -> Array:
    try:
        rows = np.array([[np.nan if v is None else float(v) for v in row] for row in _rows(values)])
    except (TypeError, ValueError) as error:
        raise DataError(f'configuration "{name}": {parameter}: {error}') from error
    if rows.ndim != 2 or rows.shape[1] != n_bands:
        raise DataError(
            f'configuration "{name}": {parameter} has shape {rows.shape}; it is '
            f"(n_pairs, n_bands = {n_bands})"
        )
    return rows


def _rows(values: Any) -> list[Any]:
    values = list(values)
    return values if values and isinstance(values[0], list | tuple | np.ndarray) else [values]


def _air_dict(air: Air | None) -> dict[str, float] | None:
    if air is None:
        return None
    return {"temperature": air.temperature, "humidity": air.humidity, "pressure": air.pressure}


_SAVED = ("pairs", "standard_deviation", "n_sources", "n_receivers", "planned")
"""What a configuration in JSON may have beside its parameters."""


def _configuration_dict(c: Configuration) -> dict[str, Any]:
    m = c.measured
    more: dict[str, Any] = {"pairs": [list(pair) for pair in m.pairs]}
    if m.standard_deviation:
        more["standard_deviation"] = {
            p: json_numbers(m.standard_deviation[p])
            for p in PARAMETERS
            if p in m.standard_deviation
        }
    more |= {k: v for k in ("n_sources", "n_receivers") if (v := getattr(m, k)) is not None}
    if c.planned:
        more["planned"] = True
    return {
        "name": c.name,
        # In the order that a reader of the file puts them in: to save again gives the same bytes.
        **{p: json_numbers(m.values[p]) for p in PARAMETERS if p in m.values},
        "uncertainty": {
            p: json_numbers(m.uncertainty[p]) for p in PARAMETERS if p in m.uncertainty
        },
        "changes": {
            material: {"alpha": v.alpha.tolist(), "sigma": v.sigma.tolist()}
            for material, v in c.changes.items()
        },
        "suspect_removed": c.suspect_removed,
        "air": _air_dict(c.air),
        "distances": None if c.distances is None else c.distances.tolist(),
        **more,
    }
