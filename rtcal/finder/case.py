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
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.directions import enough_known, facing
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.repeats import refuse_repeated_data
from rtcal.acoustics.room import PlainRoom, Room, of_plain
from rtcal.calibration.problem_data import times_in_room
from rtcal.finder.configuration import (
    LEVELS,
    PARAMETERS,
    Configuration,
    ConfigurationData,
    ConfigurationTable,
    Uncertainty,
    check_configuration,
    check_room,
    checked_facing,
    in_room_bands,
    measurement_of,
)
from rtcal.finder.effects.checks import AppliedEffect, check_parameters
from rtcal.io import geometry_files
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.files import read_text, write_text
from rtcal.support.schema import FileTable, Number, json_object, read, toml_table
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


class _RoomOfCase(PlainRoom):
    """The room of a saved case: with the directions of its materials."""

    facing: list[list[Number]] | None = None


class _EffectTable(FileTable):
    """An effect that was added to a saved case; see `AppliedEffect`."""

    effect: str
    parameters: dict[str, Number]
    size_interval: tuple[Number, Number] | None = None


class _CaseData(FileTable):
    """A saved case."""

    room: _RoomOfCase
    configurations: list[ConfigurationData]
    equation: str = "eyring"
    uncertainty: Uncertainty = msgspec.field(default_factory=Uncertainty)
    present: list[_EffectTable] = []
    climate_uncertainty: tuple[Number, Number] = CLIMATE_UNCERTAINTY


class _ConfigurationOfFile(ConfigurationTable):
    """A configuration in TOML: the file of its measurement, or what is to be measured."""

    measured: str | None = None
    parameters: list[str] | None = None
    positions: int | None = None


class _CaseFile(FileTable):
    """A case in TOML."""

    room: str
    equation: str = "eyring"
    uncertainty: Uncertainty = msgspec.field(default_factory=Uncertainty)
    configuration: list[_ConfigurationOfFile] = []


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
        case = read(_CaseData, data)
        room = Room(**of_plain(case.room))
        return cls(
            room=room,
            equation=case.equation,
            facing=cast("Any", case.room.facing),
            configurations=[
                Configuration.of(
                    c, measurement_of(c, room.centre_frequencies), planned=c.planned
                ).with_uncertainty(case.uncertainty)
                for c in case.configurations
            ],
            applied=[AppliedEffect(e.effect, e.parameters, e.size_interval) for e in case.present],
            climate_uncertainty=case.climate_uncertainty,
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
        text = read_text(path, MAX_BYTES)
        try:
            if str(path).endswith(".json"):
                return cls.from_dict(json_object(text))
            file = _case_file(text)
            room = Room.from_file(str(Path(path).parent / file.room))
            return cls(
                room=room,
                equation=file.equation,
                configurations=[
                    _configuration(Path(path).parent, room, each).with_uncertainty(file.uncertainty)
                    for each in file.configuration
                ],
            )
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


def _case_file(text: str) -> _CaseFile:
    content = toml_table(text)
    if "material" in content:
        raise DataError("this is a room's file; name what was measured in the room beside it")
    if "geometry" in content:
        raise DataError(
            "a case states no geometry: write [geometry] with mesh, [sources] and [receivers] into "
            "the room's file, and name it and the measurement: room.toml pairs.csv"
        )
    file = read(_CaseFile, content)
    if not file.room.strip():
        raise DataError("room is not the name of a room's file")
    return file


def files_of_case(path: str) -> list[Path]:
    """Return the paths that a valid case file refers to, itself included."""
    case = Path(path)
    if path.endswith(".json"):
        return [case]
    file = _case_file(read_text(path, MAX_BYTES))
    names = [file.room, *(c.measured for c in file.configuration if c.measured is not None)]
    return [case, *(case.parent / name for name in names)]


def _configuration(folder: Path, room: Room, table: _ConfigurationOfFile) -> Configuration:
    """Return a configuration of a TOML file, with its measurement of another file."""
    where = f'configuration "{table.name}"'
    if table.parameters is None:
        if table.positions is not None:
            raise DataError(f"{where}: positions has no meaning beside a measurement")
        if not (table.measured or "").strip():
            raise DataError(f"{where} has no measured = a measurement's file")
        return Configuration.of(table, Measurement.from_file(str(folder / str(table.measured))))
    if table.measured is not None:
        raise DataError(
            f"{where}: measured stands beside parameters; a configuration is measured or planned"
        )
    wanted, n = table.parameters, 4 if table.positions is None else table.positions
    fits = all(p in PARAMETERS for p in wanted) and "t20" in wanted
    if not fits or len(set(wanted)) < len(wanted):
        raise DataError(
            f"{where}: parameters is not a list of {', '.join(PARAMETERS)}, t20 in it, each once"
        )
    if not 1 <= n <= MAX_POSITIONS:
        raise DataError(f"{where}: positions = {n} is not from 1 to {MAX_POSITIONS}")
    values = np.ones((n, room.n_bands))
    of_kind = {p: PLANNED_UNCERTAINTY["level" if p in LEVELS else "time"] for p in wanted}
    measured = Measurement(
        centre_frequencies=room.centre_frequencies,
        values=dict.fromkeys(wanted, values),
        pairs=[("S", f"R{i + 1}") for i in range(n)],
        uncertainty={p: u * values for p, u in of_kind.items()},
    )
    return Configuration.of(table, measured, planned=True)
