"""A case: the stated data of a room and its measurements.

It is read as TOML, which refers to files of the room and the measurements, or as one JSON file. Both
become the dict that `Case.from_dict` reads. In TOML, the room and the measurements are files in their
native formats::

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

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.directions import enough_known, facing
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.repeats import refuse_repeated_data
from rtcal.acoustics.room import Room
from rtcal.calibration.problem_data import times_in_room
from rtcal.finder.configuration import (
    LEVELS,
    PARAMETERS,
    Configuration,
    check_configuration,
    check_room,
    checked_facing,
    checked_uncertainty,
    in_room_bands,
)
from rtcal.finder.effects.checks import AppliedEffect, check_parameters
from rtcal.io import geometry_files
from rtcal.support import checks
from rtcal.support.checks import Entries, json_object, toml_table
from rtcal.support.errors import DataError
from rtcal.support.files import read_text, write_text
from rtcal.support.text import shortened
from rtcal.support.types import Array, read_only

CLIMATE_UNCERTAINTY = (2.0, 10.0)
"""Standard uncertainty of a stated climate: 2 K and 10 % of relative humidity. That is what a
thermometer and a hygrometer on a wall leave open in a room. A judgement, without a study."""


def checked_climate_uncertainty(value: object) -> tuple[float, float]:
    """Return standard uncertainties in K and % of humidity; DataError unless they are 0 or more."""
    climate = checks.array("climate_uncertainty", value)
    if climate.shape != (2,) or not (np.isfinite(climate) & (climate >= 0)).all():
        raise DataError(
            f"climate_uncertainty = {value!r} is not two numbers of 0 or more: K, and % of humidity"
        )
    kelvin, percent = climate.tolist()
    return kelvin, percent


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A room, its equation and the configurations in which it was measured.

    Parameters
    ----------
    room : Room
        Volume, materials with area, alpha and sigma, band correlation, air or none.
    configurations : sequence of Configuration
        At least one.
    equation : str
        The equation with which the user's model calculates T: the key of a `MeanEquation`, such as
        "eyring", "sabine", "kuttruff" or "millington".
    facing : array (n_materials, 3), optional
        Share of each material's area whose normal is along x, y and z. By default it follows from what
        the room states (`rtcal.acoustics.directions.facing`); a material of which nothing says it
        has a third each.
    applied : sequence of AppliedEffect
        Effects that `MeansFinding.apply` has added.
    climate_uncertainty : (float, float)
        Standard uncertainties of a stated climate: K, and % of relative humidity.

    Raises
    ------
    DataError
        If a value breaks a rule; the message names place, value and rule.
    """

    room: Room
    configurations: Sequence[Configuration]
    equation: str = "eyring"
    facing: Array = None  # type: ignore[assignment]  # filled in when made
    applied: Sequence[AppliedEffect] = ()
    climate_uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        mean_equation(self.equation)
        for name, kind in (("configurations", Configuration), ("applied", AppliedEffect)):
            every = checks.listed(name, getattr(self, name))
            for i, member in enumerate(every):
                checks.instance(f"{name}[{i}]", member, kind)
            object.__setattr__(self, name, every)
        if not self.configurations:
            raise DataError("configurations is empty; a case has at least one measurement")
        names = [c.name for c in self.configurations]
        if len(set(names)) < len(names):
            raise DataError(f"configurations = {names}: each has a name of its own")
        stated = None if self.facing is None else checked_facing(self.room, self.facing)
        if stated is None or _evenly(stated).all():
            stated = read_only(spread_where_unknown(_facing(self.room)))
        object.__setattr__(self, "facing", stated)
        climate = checked_climate_uncertainty(self.climate_uncertainty)
        object.__setattr__(self, "climate_uncertainty", climate)
        check_room(self.room)
        for added in self.applied:
            check_parameters(added.effect, added.parameters, self.room, added.size_interval)
        configurations = tuple(in_room_bands(self.room, c) for c in self.configurations)
        object.__setattr__(self, "configurations", configurations)
        for c in self.configurations:
            check_configuration(self.room, c)

    def __repr__(self) -> str:
        names = ", ".join(c.name for c in self.configurations)
        return (
            f'<Case "{shortened(self.room.name)}": {self.room.n_materials} materials, '
            f"{bands.span(self.room.centre_frequencies)}, {len(self.configurations)} "
            f"configurations: {shortened(names)}>"
        )

    @property
    def directions_known(self) -> bool:
        """Whether the directions of most of the room's absorption are known.

        Without them an effect that needs them is not judged (`Effect.needs_directions`).
        """
        evenly = _evenly(self.facing)
        found = np.where(evenly[:, np.newaxis], np.nan, self.facing)
        return enough_known(self.room, _facing(self.room) if evenly.all() else found)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Case:
        """Return the case of nested plain values, as `to_dict` gives them.

        ``room`` is as `Room.to_dict` returns it, and may hold ``facing``. A configuration holds
        ``name`` and its parameters, lists (n_pairs, n_bands) or (n_bands,) with None for missing
        values. ``uncertainty`` holds ``time`` (relative) and ``level`` (dB), for values that state
        none.

        Raises DataError for an unknown key, for a value of the wrong kind, and as `Case` does.
        """
        optional = ("equation", "uncertainty", "present", "climate_uncertainty")
        case = Entries("", data, ("room", "configurations"), optional)
        room_data = case.mapping("room")
        stated_facing = room_data.pop("facing", None)
        room = Room.from_dict(room_data)
        stated = checked_uncertainty(case.mapping("uncertainty", {}))
        return cls(
            room=room,
            equation=case.text("equation", "eyring"),
            facing=stated_facing,
            configurations=[
                Configuration.from_dict(
                    checks.mapped(f"configurations[{i}]", each), room.centre_frequencies
                ).with_uncertainty(stated)
                for i, each in enumerate(case.listed("configurations"))
            ],
            applied=[
                AppliedEffect.from_dict(checks.mapped(f"present[{i}]", each), f"present[{i}]")
                for i, each in enumerate(case.listed("present", []))
            ],
            climate_uncertainty=tuple(case.listed("climate_uncertainty", CLIMATE_UNCERTAINTY)),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain values, as `from_dict` reads them.

        Raises DataError for an added effect that is not in the library.
        """
        if custom := [p.name for p in self.applied if p.custom is not None]:
            raise DataError(
                f'effect "{custom[0]}" is not in the library: a case that holds it cannot be saved, '
                "since whoever reads it does not know the effect"
            )
        return {
            "room": {**self.room.to_dict(), "facing": self.facing.tolist()},
            "equation": self.equation,
            "configurations": [c.to_dict() for c in self.configurations],
            "present": [p.to_dict() for p in self.applied],
            "climate_uncertainty": list(self.climate_uncertainty),
        }

    @classmethod
    def from_file(cls, path: str) -> Case:
        """Read a case: TOML as `rtcal.finder.case` says, or the JSON that `save` writes.

        Raises DataError naming the file and the rule.
        """
        data = read_case(path)
        try:
            return cls.from_dict(data)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error

    def save(self, path: str) -> None:
        """Write the case as JSON, whole or not at all; DataError as `to_dict`."""
        write_text(path, self.to_json())

    def to_json(self) -> str:
        """Return the text that `save` writes."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"

    def require_fresh(self) -> None:
        """Raise DataError for data that would count twice, and for a configuration only planned.

        The room must not have been calibrated to their T, and no two configurations may have one
        measurement.
        """
        for c in self.configurations:
            if c.planned:
                raise DataError(
                    f'configuration "{c.name}" states parameters but no measurement: it can only be '
                    "planned"
                )
        for one, other in combinations(self.configurations, 2):
            if _same_values(one.measured, other.measured):
                raise DataError(
                    f'one measurement is given twice, in the configurations "{one.name}" and '
                    f'"{other.name}"; its values would count twice'
                )
        if self.room.calibration is None:
            return
        for c in self.configurations:
            if np.isfinite(c.measured.decay_time().mean).any():
                refuse_repeated_data(self.room, times_in_room(self.room, c.measured).fingerprint)

    def only(self, *parameters: str, configurations: Sequence[str] | None = None) -> Case:
        """Return the case with some of its parameters, and some of its configurations."""
        if configurations is not None:
            configurations = checks.texts("configurations", configurations)
        kept = []
        for c in self.configurations:
            if configurations is not None and c.name not in configurations:
                continue
            tables: dict[str, Any] = {
                name: {p: v for p, v in getattr(c.measured, name).items() if p in parameters}
                for name in ("values", "uncertainty", "common_uncertainty", "standard_deviation")
            }
            kept.append(replace(c, measured=replace(c.measured, **tables)))
        return replace(self, configurations=kept)


def _facing(room: Room) -> Array:
    """Return `facing` of a room, by its mesh where nothing else says the directions."""
    found = facing(room)
    if room.scene.mesh is None or np.isfinite(found).all():
        return found
    try:
        return facing(room, geometry_files.read(room))
    except DataError:  # a search by means reads no mesh where it need not
        return found


def _evenly(shares: Array) -> NDArray[np.bool_]:
    """Return which materials have a third along each axis, as those of unknown directions."""
    return np.asarray(np.isclose(shares, 1 / 3).all(axis=1))


def spread_where_unknown(shares: Array) -> Array:
    """Return shares as of `facing`, a third each where they are not known."""
    return np.where(np.isnan(shares), 1 / 3, shares)


def _same_values(one: Measurement, other: Measurement) -> bool:
    """Whether two measurements have the same values of all parameters that both have."""
    shared = one.values.keys() & other.values.keys()
    return any(np.isfinite(one.values[p]).any() for p in shared) and all(
        np.array_equal(one.values[p], other.values[p], equal_nan=True) for p in shared
    )


MAX_BYTES = 50_000_000
MAX_POSITIONS = 1000
PLANNED_UNCERTAINTY = {"time": 0.02, "level": 0.3}
"""Uncertainty assumed for planned measurements: 2 % of a decay time, 0.3 dB of C80 and G."""

_TABLES = ("uncertainty", "equation", "configuration")


def read_case(path: str) -> dict[str, Any]:
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
        file = Entries("", content, ("room",), _TABLES)
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


def files_of_case(path: str) -> list[Path]:
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
