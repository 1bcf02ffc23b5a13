"""A case: a room, and what was measured in it, which decides what is compared (`case_of`).

Means over positions in one or more configurations (`Case`), every position (`PositionsCase`), or two
states (`StatesCase`). The first has a file, with the same keys in TOML and in JSON. The room is the
name of a room's file, or a table as `rtcal.Room.to_dict` returns it, and so is each measurement:
`Case.save` writes one JSON file. What a user writes names files::

    room = "room.toml"
    equation = "eyring"                  # or sabine, kuttruff, millington
    program = "geometrical"              # optional, of runs: it traces rays or image sources

    [uncertainty]                        # optional, for values without one
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
    simulated = "run.csv"                # optional, what a program gave of this configuration
    at = "calibrated.toml"               # optional, the room with the coefficients of that run
    air = { temperature = 21, humidity = 60 }     # optional, in another climate than the room's
    [configuration.changes."west wall"]  # optional: coefficients that differ from the room's
    alpha = [0.1, 0.3]
    sigma = [0.02, 0.04]
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.changes import enough_known
from rtcal.acoustics.equations import Eyring, LinearEquation, mean_equation
from rtcal.acoustics.measurement import Measurement, MeasurementTable
from rtcal.acoustics.observables import MATCH, REVERBERATION, observable, parameter_label
from rtcal.acoustics.room import (
    LARGEST_PIECE,
    POSITION,
    Room,
    RoomFile,
    checked_uncertainty,
    refuse_repeated_data,
)
from rtcal.acoustics.run import Run
from rtcal.calibration.measured import notes_of_bands, times_in_room
from rtcal.files.disk import json_numbers, read_text, write_text
from rtcal.files.schema import FileTable, Number, expecting, json_object, read, toml_table
from rtcal.finder.effects import AppliedEffect, check_parameters, library
from rtcal.finder.model import FEATURES, LEVELS
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.surfaces import Divided, Faces
from rtcal.io import geometry_files
from rtcal.loop.measured_pairs import Pair, history, refuse_unknown, with_t30
from rtcal.simulators.base import at_places
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError, OtherBandsWarning
from rtcal.support.text import as_sentence, first_of, shortened
from rtcal.support.types import Array, put, read_only

GEOMETRICAL = "geometrical"
"""Kind of a program that traces rays or image sources, as the field ``program`` of a case has it."""
MAX_BYTES = 50_000_000
MAX_POSITIONS = 1000
PLANNED_UNCERTAINTY = {"time": 0.02, "level": 0.3}
"""Uncertainty assumed for planned measurements: 2 % of a decay time, 0.3 dB of C80 and G."""
CLIMATE_UNCERTAINTY = (2.0, 10.0)
"""Standard uncertainty of a room's input climate: 2 K and 10 % of relative humidity. A thermometer and
a hygrometer on a wall leave this much open in a room. The values are a judgement, without a study."""


def _checked_climate_uncertainty(value: object) -> tuple[float, float]:
    """Return standard uncertainties in K and in % of humidity; DataError for any below 0."""
    climate = checks.array("climate_uncertainty", value)
    if climate.shape != (2,) or not (np.isfinite(climate) & (climate >= 0)).all():
        raise DataError(
            f"climate_uncertainty = {value!r} must be two numbers of 0 or more, in K and %"
        )
    kelvin, percent = climate.tolist()
    return kelvin, percent


class _ChangedTable(FileTable):
    """Hold a table of a file with the coefficients of a material in one configuration."""

    alpha: list[Number]
    sigma: list[Number]


class _ConfigurationTable(FileTable):
    """Hold the table of one configuration in a case's file; the text of this module has its keys."""

    name: str | None = None
    measured: str | MeasurementTable | None = None
    parameters: list[str] | None = None
    positions: int | None = None
    planned: bool = False
    changes: dict[str, _ChangedTable] = {}
    suspect_removed: bool = False
    air: Air | None = None
    distances: list[Number] | None = None
    simulated: str | MeasurementTable | None = None
    at: str | list[list[Number]] | None = None


class _Uncertainty(FileTable):
    """Hold the uncertainty of measured values without one: of a time as a ratio, of a level in dB."""

    time: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None
    level: Annotated[float, msgspec.Meta(gt=0, le=20)] | None = None


class _CaseTable(FileTable):
    """Hold the content of a case's file; ``room`` is the name of a room's file, or its values."""

    room: str | RoomFile
    configuration: list[_ConfigurationTable] = []
    equation: str = "eyring"
    uncertainty: _Uncertainty = msgspec.field(default_factory=_Uncertainty)
    facing: list[list[Number | None]] | None = None
    applied: list[AppliedEffect] = []
    climate_uncertainty: tuple[Number, Number] = CLIMATE_UNCERTAINTY
    program: str = ""
    caution: str = ""  # for whoever opens the file


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Name the place of a DataError."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{where}: {error}") from error


@dataclass(frozen=True)
class ChangedMaterial:
    """Hold alpha and sigma of a material in one configuration of a room, (n_bands,) each.

    For pieces such as persons, both are absorption areas in m² per piece. Raises DataError for a value
    that is not from 0 to 1; for pieces from 0 to the largest area that rtcal allows for a piece.

    ``alpha`` are the coefficients and ``sigma`` their standard deviations.
    """

    alpha: Array
    sigma: Array

    def __post_init__(self) -> None:
        for name in ("alpha", "sigma"):
            array = checks.shaped(f"change: {name}", getattr(self, name), "n_bands")
            # `Configuration.in_room`: 1, of a wall
            if not array.size or not ((array >= 0) & (array <= LARGEST_PIECE)).all():
                raise DataError(f"change: {name} must be an array (n_bands,) of values from 0 to 1")
            put(self, **{name: array})


@dataclass(frozen=True, kw_only=True, eq=False)
class Configuration:
    """Hold one measurement of a room, and what was changed in the room for this measurement.

    ``name`` is its name in messages. Raises DataError for a value of the wrong kind; the message
    names the place and the value.
    """

    name: str
    measured: Measurement
    """Means over positions of any of T20, EDT, T30, C80 and G."""
    changes: Mapping[str, ChangedMaterial] = field(default_factory=dict)
    """Coefficients of the materials for which they differ from the room's in this configuration."""
    suspect_removed: bool = False
    """Whether the object that may be missing from the model was taken out for this measurement."""
    air: Air | None = None
    """Climate of the air during this measurement, if it differed from the room's."""
    distances: Array | None = None
    """Distances from source to receiver in m, (n_pairs,); by default 0.66 times cube root of volume."""
    planned: bool = False
    """Whether ``measured`` holds placeholders for a measurement that is only planned."""
    simulated: Run | None = None
    """Values that a simulation program gave for this configuration. They are then the model, and the
    equation gives only their change with coefficients and effects."""
    left_out: Sequence[str] = ()
    """Sentences on values that `in_room` leaves out, because run or measurement lacks them."""

    def __post_init__(self) -> None:
        where = f'configuration "{text_name("configuration: name", self.name)}"'
        if not self.name.strip():
            raise DataError(f"configuration: name = {self.name!r} must not be blank")
        checks.instance(f"{where}: measured", self.measured, Measurement)
        self.measured.refuse_other_units()
        changes = checks.mapped(f"{where}: changes", self.changes)
        for material, change in changes.items():
            text_name(f"{where}: changes: material", material)
            checks.instance(f"{where}: changes[{material!r}]", change, ChangedMaterial)
        put(self, changes=changes)
        for name in ("suspect_removed", "planned"):
            checks.flag(f"{where}: {name}", getattr(self, name))
        for name, kind in (("air", Air), ("simulated", Run)):
            if getattr(self, name) is not None:
                checks.instance(f"{where}: {name}", getattr(self, name), kind)
        if self.distances is not None:
            n = len(self.measured.pairs)
            distances = checks.array(f"{where}: distances", self.distances)
            if distances.shape != (n,) or not ((distances > 0) & np.isfinite(distances)).all():
                raise DataError(f"{where}: distances must be {n} values above 0, one per pair")
            put(self, distances=read_only(distances))

    def coefficients(self, room: Room) -> tuple[Array, Array]:
        """Return the room's alpha and its sigma in this configuration, (n_materials, n_bands) each."""
        checks.instance("room", room, Room)
        alpha, sigma = np.array(room.alpha), np.array(room.sigma)
        for material, change in self.changes.items():
            row = room.material_index(material)
            alpha[row], sigma[row] = change.alpha, change.sigma
        return alpha, sigma

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain values for JSON, with the keys of a case's file."""
        run: dict[str, Any] = {}
        if self.simulated is not None:
            run["simulated"] = self.simulated.simulated.to_dict()
            run["at"] = json_numbers(self.simulated.room.alpha)
        return {
            "name": self.name,
            "measured": self.measured.to_dict(),
            "planned": self.planned,
            "changes": json_numbers(self.changes),
            "suspect_removed": self.suspect_removed,
            "air": None if self.air is None else asdict(self.air),
            "distances": json_numbers(self.distances),
            **run,
        }

    def in_room(self, room: Room) -> Configuration:
        """Return the configuration with its measurement converted to the bands of a room.

        If the configuration has the result of a simulation program, measured parameters that the
        program did not calculate are left out. Warns if bands are converted or left out. Raises
        DataError if the configuration does not fit the room, or if a measured value is physically
        impossible.
        """
        where, wanted = f'configuration "{self.name}"', room.centre_frequencies
        with _named(where):
            whole = self.measured.in_bands(wanted)
            measured, made = self._beside_run(whole, room)
        if notes := bands.notes(self.measured.centre_frequencies, wanted):
            said = f"{where}: {'; '.join(notes)}"
            warnings.warn(said, OtherBandsWarning, stacklevel=checks.stack_level())
        if not {"t20", "t30"} & measured.values.keys():
            if self.simulated is None or self.planned:
                raise DataError(f"{where}: the measurement has neither T20 nor T30")
            raise DataError(f"{where}: {self.simulated.nothing_common(whole, 'T20 or T30')}")
        for material, change in self.changes.items():
            most = float(room.most_alpha[room.material_index(material)].max())
            for name in ("alpha", "sigma"):
                values = getattr(change, name)
                if values.shape != (room.n_bands,) or values.max() > most:
                    unit = "" if most == 1 else " m² per piece"
                    raise DataError(
                        f'{where}: {name} of "{material}" must be {room.n_bands} values from 0 to '
                        f"{most:g}{unit}"
                    )
        if self.distances is not None:
            # A convex room of volume V and surface S is at most S²/(3 pi V) long, as a double cone is.
            # Three times that is allowed, since the stated area or volume may be wrong.
            longest = room.total_area**2 / (np.pi * room.volume)
            rule = "the largest length of a room with this volume and area"
            if room.dimensions is not None:
                longest, rule = float(np.linalg.norm(room.dimensions)), "the room's diagonal"
            if (most := self.distances.max()) > longest:
                at_most = f"at most {longest:.3g} m is possible, {rule}"
                raise DataError(f"{where}: distances has {most:g} m, but {at_most}")
        for name in FEATURES:
            kind, values = observable(name), measured.values.get(name, np.zeros((0, 0)))
            least, most = LEVEL_LIMITS.get(name, kind.limits)
            for i, k in np.argwhere((values < least) | (values > most)):
                place = f"{where}: {name} at {bands.label(wanted[k])}"
                if name in LEVEL_LIMITS:
                    checks.between(place, values[i, k], least, most, "dB", ", the range in rooms")
                kind.refuse(place, values[i, k])
        return replace(self, measured=measured, **made)

    def _beside_run(self, measured: Measurement, room: Room) -> tuple[Measurement, dict[str, Any]]:
        """Return what was measured and simulated, and the run, distances and names that go with it."""
        if self.simulated is None or self.planned:
            return measured, {}
        self.simulated.refuse_other(room)
        both = self.simulated.beside(measured)
        made: dict[str, Any] = {"simulated": replace(self.simulated, simulated=both.run)}
        made["left_out"] = tuple(dict.fromkeys([*self.left_out, *both.left_out(FEATURES)]))
        if self.distances is not None:
            rows = [measured.pairs.index(p) for p in both.measured.pairs]
            made["distances"] = self.distances[rows]
        return both.measured, made


def _configuration(
    table: _ConfigurationTable, room: Room, folder: Path, stated: _Uncertainty
) -> Configuration:
    """Return the configuration of a table, whose values without uncertainty get that of ``stated``."""
    where = f'configuration "{table.name}"'
    planned = table.planned or table.parameters is not None
    if (table.measured is None) == (table.parameters is None):
        lacks = (
            "missing; give" if table.measured is None else "given beside parameters; give either"
        )
        raise DataError(
            f"{where}: measured is {lacks} the measurement, or parameters if it is only planned"
        )
    if table.parameters is not None:
        measured = _placeholders(where, table, room)
    elif table.positions is not None:
        raise DataError(f"{where}: positions can be given only for a planned configuration")
    else:
        measured = _read(where, table.measured, room, folder)
    added = dict(measured.uncertainty)
    for parameter, values in measured.values.items():
        level = parameter in LEVELS
        size = stated.level if level else stated.time
        if size is not None and parameter not in added:
            added[parameter] = np.full_like(values, size) if level else size * values
    run = None
    if table.simulated is not None:
        with _named(where):
            if isinstance(table.at, str):
                at = Room.from_file(str(folder / table.at))
            else:
                at = room if table.at is None else room.replace(alpha=table.at)
        given = _read(where, table.simulated, room, folder)
        with _named(where):
            run = Run(at, given)
    elif table.at is not None:
        raise DataError(f"{where}: at has the coefficients of a simulation; add simulated")
    return Configuration(
        name=table.name or ("planned" if planned else "measured"),
        measured=replace(measured, uncertainty=added),
        changes={
            name: ChangedMaterial(np.array(c.alpha), np.array(c.sigma))
            for name, c in table.changes.items()
        },
        suspect_removed=table.suspect_removed,
        air=table.air,
        distances=None if table.distances is None else np.array(table.distances),
        planned=planned,
        simulated=run,
    )


def _placeholders(where: str, table: _ConfigurationTable, room: Room) -> Measurement:
    """Return placeholders for a measurement that is planned: its parameters and uncertainties."""
    wanted, n = table.parameters or [], 4 if table.positions is None else table.positions
    if "t20" not in wanted or not {*wanted} <= {*FEATURES} or len({*wanted}) < len(wanted):
        raise DataError(
            f"{where}: parameters = {wanted} must have t20, and may have each of "
            f"{', '.join(p for p in FEATURES if p != 't20')} once"
        )
    checks.between(f"{where}: positions", n, 1, MAX_POSITIONS)
    values = np.ones((n, room.n_bands))
    kinds = {p: PLANNED_UNCERTAINTY["level" if p in LEVELS else "time"] for p in wanted}
    return Measurement(
        centre_frequencies=room.centre_frequencies,
        values=dict.fromkeys(wanted, values),
        pairs=[("S", f"R{i + 1}") for i in range(n)],
        uncertainty={p: u * values for p, u in kinds.items()},
    )


def _read(where: str, stated: Any, room: Room, folder: Path) -> Measurement:
    """Return the measurement of a file's name, or of plain values in the room's bands."""
    if isinstance(stated, str):
        return Measurement.from_file(str(folder / stated))
    plain = msgspec.structs.asdict(stated)
    if not stated.centre_frequencies:
        plain["centre_frequencies"] = room.centre_frequencies
    with _named(where):
        return Measurement(**plain)


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Describe a room, its reverberation equation and the configurations in which it was measured.

    rtcal compares means over positions with this case. To compare every position see
    `PositionsCase`; to compare measurements before and after a change of the room see `StatesCase`.
    Raises DataError if a value breaks a rule; the message names the place, the value and the rule.
    """

    kind: ClassVar[str] = "means"

    room: Room
    """Room as you enter it: volume, materials with area, alpha and sigma, and the air if it counts."""
    configurations: Sequence[Configuration]
    """Configurations in which the room was measured, at least one."""
    equation: str = "eyring"
    """Reverberation equation of your model: the key of a `MeanEquation`, such as "eyring", "sabine",
    "kuttruff" or "millington"."""
    facing: Array = None  # type: ignore[assignment]  # filled in when made
    """Share of each material's area whose normal is along x, y and z, (n_materials, 3); NaN where it is
    unknown. By default `rtcal.acoustics.changes.facing` derives it from the room."""
    applied: Sequence[AppliedEffect] = ()
    """Effects that `Finding.apply` has added to the room's model."""
    climate_uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY
    """Standard uncertainties of the room's climate: temperature in K, and relative humidity in %."""
    program: str = ""
    """Kind of the program that made the simulated values: "geometrical", whose sound field may be
    uneven without an error of the room's model, or ""."""

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        mean_equation(self.equation)
        for name, kind in (("configurations", Configuration), ("applied", AppliedEffect)):
            every = checks.listed(name, getattr(self, name))
            for i, member in enumerate(every):
                checks.instance(f"{name}[{i}]", member, kind)
            put(self, **{name: every})
        if not self.configurations:
            raise DataError("configurations is empty; a case must have at least one measurement")
        names = [c.name for c in self.configurations]
        if len(set(names)) < len(names):
            raise DataError(f"configurations = {names}: give each configuration a name of its own")
        put(self, facing=read_only(_checked_facing(self.room, self.facing)))
        climate = _checked_climate_uncertainty(self.climate_uncertainty)
        put(self, climate_uncertainty=climate)
        _check_size(self.room)
        for added in self.applied:
            check_parameters(added.effect, added.parameters, self.room, added.size_interval)
        configurations = tuple(c.in_room(self.room) for c in self.configurations)
        put(self, configurations=configurations)
        if checks.text("program", self.program) not in ("", GEOMETRICAL):
            raise DataError(f'program = {checks.shown(self.program)} must be "{GEOMETRICAL}"')
        if self.program and not self.has_run:
            raise DataError(f'program = "{self.program}" needs its simulation: add it as simulated')

    def __repr__(self) -> str:
        names = ", ".join(c.name for c in self.configurations)
        return f'<Case "{shortened(self.room.name)}": {shortened(names)}>'

    @property
    def has_run(self) -> bool:
        """Whether a simulation program's values replace the equation in any configuration."""
        return any(c.simulated is not None for c in self.configurations)

    @cached_property
    def directions_known(self) -> bool:
        """Whether it is known where the surfaces face that absorb most, as some effects need."""
        return enough_known(self.room, self.facing)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: str | os.PathLike[str] = "") -> Case:
        """Return the case that a mapping describes, in the form of `to_dict`.

        ``data`` has the keys of a case's file, which `rtcal.finder.case` lists. Names of files in
        ``data`` are relative to ``folder``. Raises DataError for an unknown key, for a value of the
        wrong kind, and as `Case` does.
        """
        table, folder = _table(data), Path(folder)
        if isinstance(table.room, str):
            room = Room.from_file(str(folder / table.room))
        else:
            room = Room.of_table(table.room)
        return cls(
            room=room,
            equation=table.equation,
            facing=table.facing,  # type: ignore[arg-type]  # checked there
            configurations=[
                _configuration(c, room, folder, table.uncertainty) for c in table.configuration
            ],
            applied=table.applied,
            climate_uncertainty=table.climate_uncertainty,
            program=table.program,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the case as plain values for `from_dict`; DataError for an effect of your own."""
        if custom := [p.name for p in self.applied if p.effect not in library()]:
            raise DataError(
                f'effect "{custom[0]}" is not in rtcal\'s library, so a case with it cannot be saved'
            )
        return {
            "room": self.room.to_dict(),
            "configuration": [c.to_dict() for c in self.configurations],
            "equation": self.equation,
            "facing": json_numbers(self.facing),
            "applied": [p.to_dict() for p in self.applied],
            "climate_uncertainty": list(self.climate_uncertainty),
            **({"program": self.program} if self.program else {}),
        }

    @classmethod
    def from_file(cls, path: str) -> Case:
        """Return the case of a TOML or JSON file; a DataError names the file and the broken rule."""
        with expecting("a case", path):
            return cls.from_dict(_content(path), Path(path).parent)

    def save(self, path: str) -> None:
        """Write the case as a JSON file, whole or not at all; raises DataError as `to_dict` does."""
        write_text(path, self.to_json())

    def to_json(self, caution: str = "") -> str:
        """Return the text that `save` writes, with ``caution`` as its first entry if there is one."""
        head = {"caution": caution} if caution else {}
        return json.dumps(head | self.to_dict(), indent=1, allow_nan=False) + "\n"

    def require_fresh(self) -> None:
        """Raise DataError if a measurement would be used twice, or if a configuration is only planned.

        The room must not have been calibrated to the measured T of any configuration, and no two
        configurations may have the same measurement.
        """
        for c in self.configurations:
            if c.planned:
                raise DataError(
                    f'configuration "{c.name}" has parameters but no measurement (`rtcal plan`)'
                )
        for one, other in combinations(self.configurations, 2):
            tables = one.measured.values, other.measured.values
            both = [[table[p] for table in tables] for p in tables[0].keys() & tables[1].keys()]
            known = any(np.isfinite(a).any() for a, _ in both)
            if known and all(np.array_equal(a, b, equal_nan=True) for a, b in both):
                names = f'"{one.name}" and "{other.name}"'
                raise DataError(f"the configurations {names} have the same measurement")
        if self.room.calibration is None:
            return
        for c in self.configurations:
            if np.isfinite(c.measured.reverberation_time).any():
                refuse_repeated_data(self.room, times_in_room(self.room, c.measured).fingerprint)

    def only(self, *parameters: str, configurations: Sequence[str] | None = None) -> Case:
        """Return the case with only the named parameters and, if given, the named configurations."""
        if configurations is not None:
            configurations = checks.texts("configurations", configurations)
        kept = []
        for c in self.configurations:
            if configurations is not None and c.name not in configurations:
                continue
            run = c.simulated
            if run is not None:
                run = replace(run, simulated=run.simulated.only(parameters))
            kept.append(replace(c, measured=c.measured.only(parameters), simulated=run))
        return replace(self, configurations=kept)


def _checked_facing(room: Room, stated: Any) -> Array:
    """Return shares of area along x, y and z, (n_materials, 3), by default the room's."""
    if stated is None:
        return geometry_files.directions(room)
    array = checks.shaped("facing", stated, room.n_materials, 3)
    total = array.sum(1, keepdims=True)
    if np.isinf(array).any() or (array < 0).any() or (total <= 0).any():
        raise DataError("facing must be 0 or more, and above 0 on one axis for each material")
    # Shares from a file already sum to 1; a further division would change their last digit.
    return np.where(np.abs(total - 1) < 1e-12, array, array / total)


LEVEL_LIMITS = {"c80": (-30.0, 60.0), "g": (-40.0, 60.0)}
"""Limits in dB that no room exceeds. C80: -30 is 10 dB below that of T = 120 s, and 60 is the range of
a good decay. G: -40 is 20 dB below the direct sound at 100 m, and 60 is 20 dB above that at 10 cm."""
VOLUMES = (1e-3, 1e8)
"""Smallest and largest accepted volume in m³: a litre for scale models; the largest halls have some
1e7."""
_OFF_BOX = 0.1  # share by which the volume may differ from that of the stated dimensions


def _check_size(room: Room) -> None:
    """Refuse impossible volumes, and dimensions of another volume."""
    checks.between("room: volume", room.volume, *VOLUMES, "m³")
    if room.dimensions is not None:
        box = float(np.prod(room.dimensions))
        if abs(room.volume / box - 1) > _OFF_BOX:
            sides = " x ".join(f"{side:g}" for side in room.dimensions)
            raise DataError(
                f"room: volume = {room.volume:g} m³ must be within {100 * _OFF_BOX:.0f} % of the "
                f"{box:g} m³ of a box of dimensions = {sides} m"
            )


def _content(path: str) -> dict[str, Any]:
    """Return the content of a case's file as plain values."""
    text = read_text(path, MAX_BYTES)
    return json_object(text) if str(path).endswith(".json") else toml_table(text)


def _table(content: Mapping[str, Any]) -> _CaseTable:
    content = checks.mapped("case", content)
    if "geometry" in content:
        raise DataError(
            "a case file cannot contain a geometry. Write [geometry], [sources] and [receivers] into "
            "the room's file, and give room and measurement instead of the case: room.toml pairs.csv"
        )
    return read(_CaseTable, content)


def files_of_case(path: str) -> list[Path]:
    """Return the paths of a valid case file and of every file that it refers to."""
    with expecting("a case", path):
        table = _table(_content(path))
    of = [(c.measured, c.simulated, c.at) for c in table.configuration]
    names = [table.room, *(name for each in of for name in each)]
    return [Path(path), *(Path(path).parent / name for name in names if isinstance(name, str))]


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionsCase:
    """Describe a room by its simulator, and the measurement at each source-receiver pair.

    `rtcal.find` compares every pair with the simulator. Raises DataError if the measurement is a mean
    over pairs; if ``simulated``, the values of another program, have none of the measured parameters;
    if the room has already been calibrated; if a pair in ``exclude`` was not measured; or if another
    value is not allowed.
    """

    kind: ClassVar[str] = "positions"

    simulator: PathTracing
    """Simulator with the room's geometry, sources, receivers, and materials with their input
    coefficients."""
    measured: Measurement
    """Measurement with a row per pair, named as the simulator names sources and receivers. Repeated
    measurements of one pair are averaged."""
    match: Sequence[str] = MATCH
    """Names of the parameters that are compared; T30 in place of T20 where only T30 was measured. Where
    a source's directivity is unknown, only reverberation times are compared. The level is G where ``g``
    was measured; ``level`` may have any reference that all receivers of a source share."""
    simulated: Measurement | None = None
    """Values of another program for the input coefficients, in the room's bands. The simulator then
    only gives their change with each surface. Measured values without one are left out, with a note."""
    exclude: Sequence[Pair] = ()
    """Measured source-receiver pairs that are left out."""
    surfaces: Mapping[str, Sequence[str]] | None = None
    """Names of the faces of each surface; by default coplanar faces of one material are a surface."""
    position_uncertainty: float = POSITION
    """Standard uncertainty of the positions of sources and receivers, in m."""
    notes: Sequence[str] = ()
    """Sentences on the data, which the finding prints, such as on repeated measurements."""
    faces: dict[str, Faces] = field(init=False)
    """Numbers of the faces of each surface."""

    def __post_init__(self) -> None:
        checks.instance("simulator", self.simulator, PathTracing)
        checks.instance("measured", self.measured, Measurement)
        checked_uncertainty(self.position_uncertainty)
        both = [m for m in (self.measured, self.simulated) if isinstance(m, Measurement)]
        put(self, match=self.simulator.trusted(with_t30(self.match, *both)))
        put(self, exclude=checks.pairs("exclude", self.exclude))
        repeated: tuple[str, ...] = ()
        for name in ("simulated", "measured"):
            if (values := getattr(self, name)) is None:
                continue
            values, repeated = at_places(self.simulator, checks.instance(name, values, Measurement))
            put(self, **{name: values})
            if values.is_summary:
                raise DataError(
                    f"{name} has means over pairs; a search by positions needs values of each pair. "
                    "Search without the geometry: it shows what is missing, but not where"
                )
        refuse_unknown(self.exclude, self.measured)
        absent = () if self.simulated is None else self._leave_out(self.simulated)
        notes = (*checks.listed("notes", self.notes), *repeated, *absent)
        put(self, notes=tuple(dict.fromkeys(notes)))
        if history(self.room):
            raise DataError(
                f'room "{self.room.name}" is already calibrated, and calibrated coefficients hide '
                "what is missing from the model. Use the room as it was before the calibration"
            )
        if not self.room.sigma.any():
            raise DataError(
                f'room "{self.room.name}" has sigma = 0 everywhere; one must be above 0'
            )
        put(self, faces=of_room.of_geometry(self.geometry, self.surfaces))

    def _leave_out(self, run: Measurement) -> list[str]:
        """Leave out what run or measurement lacks (`Run.beside`); return notes of it."""
        whole, frequencies = self.measured, self.room.centre_frequencies
        if not np.array_equal(run.centre_frequencies, frequencies):
            own, of_room = bands.span(run.centre_frequencies), bands.span(frequencies)
            raise DataError(f"simulated has {own}; it must have those of the room, {of_room}")
        both = Run(self.room, run).beside(whole, by_pair=True)
        keys = {name: observable(name).key_in(whole.values) for name in self.match}
        if not set(keys.values()) & both.measured.values.keys():
            raise Run(self.room, run).nothing_common(whole)
        of_either = whole.values.keys() | run.values.keys()
        kept = [
            name
            for name, key in keys.items()
            if key in both.measured.values or key not in of_either  # which a later note says
        ]
        put(self, match=tuple(kept))
        put(self, measured=both.measured)
        put(self, simulated=both.run)
        put(self, exclude=tuple(pair for pair in self.exclude if pair in both.measured.pairs))
        of_bands = bands.notes(whole.centre_frequencies, frequencies, "What was measured")
        return [*both.left_out((*keys.values(),)), *map(as_sentence, of_bands)]

    @property
    def has_run(self) -> bool:
        """Whether the values of another program replace those of the simulator."""
        return self.simulated is not None

    @property
    def room(self) -> Room:
        """Room of the simulator: its materials with their input coefficients."""
        return self.simulator.room

    @property
    def geometry(self) -> Polyhedron:
        """Geometry of the simulator."""
        return self.simulator.geometry

    @cached_property
    def divided(self) -> Divided:
        """Geometry of the simulator, in which long surfaces are divided into parts."""
        return of_room.divided(self.geometry, self.faces)

    @cached_property
    def surfaces_of_materials(self) -> dict[int, list[int]]:
        """Numbers of the surfaces that consist of one material, by the number of this material."""
        made_of = self.simulator.made_of
        out: dict[int, list[int]] = {}
        for j, faces in enumerate(self.faces.values()):
            if (made_of[faces] == made_of[faces[0]]).all():
                out.setdefault(int(made_of[faces[0]]), []).append(j)
        return dict(sorted(out.items()))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kind of each surface: "floor", "wall" or "ceiling"."""
        return tuple(of_room.kind(self.geometry, faces) for faces in self.faces.values())

    @cached_property
    def surface_alpha(self) -> Array:
        """Mean alpha of each surface, (n_surfaces, n_bands)."""
        alpha = self.room.alpha[self.simulator.made_of]
        areas = self.geometry.face_areas
        faces = self.faces.values()
        return np.array([np.average(alpha[f], axis=0, weights=areas[f]) for f in faces])

    @property
    def areas(self) -> dict[str, float]:
        """Area of each surface in m²."""
        return {n: float(self.geometry.face_areas[f].sum()) for n, f in self.faces.items()}

    @cached_property
    def in_room(self) -> Measurement:
        """Measurement in the room's bands, NaN in bands that were not measured."""
        return self.measured.in_bands(self.room.centre_frequencies)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Measured source-receiver pairs that are used, in the simulator's order."""
        return tuple(
            p for p in self.simulator.pairs if p in self.measured.pairs and p not in self.exclude
        )

    def only(self, pairs: Sequence[Pair]) -> PositionsCase:
        """Return the case with only the given source-receiver pairs; DataError for one not measured."""
        wanted = checks.pairs("pairs", pairs)
        if lacking := [p for p in wanted if p not in self.pairs]:
            raise DataError(f"pairs has {' to '.join(lacking[0])}, which is not in the case")
        left = tuple(p for p in self.measured.pairs if p not in wanted)
        return replace(self, exclude=left)

    def __repr__(self) -> str:
        return (
            f'<PositionsCase "{shortened(self.room.name)}": {len(self.faces)} surfaces, '
            f"{len(self.pairs)} pairs, {bands.span(self.room.centre_frequencies)}>"
        )


_OTHER_ROOM = "simulator was made with another room; make it with the room that is given"
_LEAST = 1e-6
"""Least standard uncertainty that is taken of a stated mean, of its share: none is exact."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StatesCase:
    """Hold two measurements of a room at the same positions, before and after the room changed.

    Both measurements must be made with the same equipment. The room's input coefficients are not used,
    because the model is calibrated to the measurement before the change. Raises DataError if the
    measurements have no pair in common, or no T20 or T30 in a band of the room; if the simulator is of
    another room or does not have a measured pair; or if ``climate_uncertainty`` is given for a room
    without air.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> before = rt.Measurement.from_values([500, 1000], t20=[1.5, 1.4])
    >>> after = rt.Measurement.from_values([500, 1000], t20=[1.1, 0.9])
    >>> case = rt.finder.StatesCase(room=room, before=before, after=after)
    >>> print(case.change.round(2))
    [[-0.31 -0.44]]
    """

    kind: ClassVar[str] = "states"

    room: Room
    """Room whose volume, areas and air are used."""
    before: Measurement
    after: Measurement
    """Measurements before and after, as means over positions or for each source-receiver pair. Pairs
    that both have are compared, source by source."""
    equation: LinearEquation = field(default_factory=Eyring)
    """Equation that turns T into an absorption area, by default Eyring's. Sabine's overstates the
    change in a room that absorbs much."""
    simulator: PathTracing | None = None
    """Simulator of the same room, with the directivity of every source. With it each surface is tried,
    by the parameters of `MATCH` that both states have. The levels of both must have the same
    reference."""
    climate_uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY
    """Standard uncertainties of the climate in K and in % of relative humidity, in each of the two
    states. If the room has no air, the climate in either state may be any indoor climate."""
    states: tuple[Measurement, Measurement] = field(init=False)
    """Both measurements, at the pairs that both have, in the room's bands."""
    times: Array = field(init=False)
    """Mean over these pairs of T20, or else of T30, in s, before and after, (2, n_bands)."""
    change: Array = field(init=False)
    """Natural logarithm ln(T after / T before), (n_pairs, n_bands); NaN where either T is missing."""
    variance: Array = field(init=False)
    """Noise variance of ``change``, from both states, (n_pairs, n_bands). For each pair it is the
    larger of the given variance and that expected of one decay: for T20 a relative standard deviation
    of 0.88 / sqrt(B T), with the bandwidth B in Hz and T in s."""
    notes: tuple[str, ...] = field(init=False)
    """Sentences on what only one state has, on converted values, and on origins of uncertainties."""

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("before", self.before, Measurement).refuse_other_units()
        checks.instance("after", self.after, Measurement).refuse_other_units()
        checks.instance("equation", self.equation, LinearEquation)
        put(self, climate_uncertainty=_checked_climate_uncertainty(self.climate_uncertainty))
        if self.room.air is None and self.climate_uncertainty != CLIMATE_UNCERTAINTY:
            raise DataError("climate_uncertainty is given, but the room has no air")
        notes = self._compare_pairs()
        put(self, notes=(*notes, *self._compare_times()))
        if self.simulator is not None:
            checks.instance("simulator", self.simulator, PathTracing)
            if self.simulator.room is not self.room:
                raise DataError(_OTHER_ROOM)
            if lacking := [p for p in self.pairs if p not in self.simulator.pairs]:
                pair = " to ".join(lacking[0])
                raise DataError(f"the pair {pair} was measured, but the simulator does not have it")

    def _compare_pairs(self) -> list[str]:
        """Set ``states``; return notes on bands and pairs that one lacks."""
        two = {"before": self.before, "after": self.after}
        states = {n: m.in_bands(self.room.centre_frequencies) for n, m in two.items()}
        pairs = [p for p in states["before"].pairs if p in states["after"].pairs]
        if not pairs:
            each = (
                "means over positions"
                if m.is_summary
                else first_of([*map(" to ".join, m.pairs)], 1)
                for m in two.values()
            )
            raise DataError(
                "before and after have no source-receiver pair in common: they have "
                f"{' and '.join(each)}. Name the same positions alike"
            )
        put(self, states=tuple(m.select(pairs) for m in states.values()))
        of_bands = {n: "; ".join(notes_of_bands(self.room, m)) for n, m in two.items()}
        if of_bands["before"] == of_bands["after"]:
            of_bands = {"before and after": of_bands["before"]}
        notes = [as_sentence(f"{name}: {note}") for name, note in of_bands.items() if note]
        for name, state in states.items():
            if others := [" to ".join(p) for p in state.pairs if p not in pairs]:
                notes.append(f"Only {name} has {first_of(others, 1)}: left out.")
        return notes

    def _compare_times(self) -> list[str]:
        """Set ``times``, ``change`` and ``variance``; return notes on pairs and uncertainties."""
        frequencies, shape = self.room.centre_frequencies, (len(self.pairs), self.room.n_bands)
        change, variance = np.full((2, *shape), np.nan)
        times, unstated = np.full((2, self.room.n_bands), np.nan), False
        for o in reversed(REVERBERATION):  # the first replaces the others
            if not all(o.key in m.values for m in self.states):
                continue
            values = np.array([m.values[o.key] for m in self.states])
            both = np.isfinite(values).all(axis=0)
            some, count = both.any(axis=0), np.maximum(both.sum(axis=0), 1)
            means = np.where(both, values, 0.0).sum(axis=1) / count
            relative = np.zeros(shape)
            for m, v, mean in zip(self.states, values, means, strict=True):
                if m.is_summary:
                    u = np.fmax(m.mean_uncertainty(o.key)[np.newaxis] / v, _LEAST)
                    unstated |= o.key not in m.uncertainty and m.n_sources is None
                else:
                    theory = o.scatter(frequencies, np.where(some, mean, np.nan))
                    u = np.fmax(theory, m.uncertainty.get(o.key, np.zeros(shape)) / v)
                relative = relative + u**2
            # Of states that are exchanged it is the same to the last digit, of the other sign.
            of_log = np.log(values[1]) - np.log(values[0])
            times[:, some] = means[:, some]
            change[:, some] = np.where(both, of_log, np.nan)[:, some]
            variance[:, some] = np.where(both, relative, np.nan)[:, some]
        if not np.isfinite(change).any():
            labels = " or ".join(parameter_label(o.key) for o in REVERBERATION)
            raise DataError(f"before and after have no {labels} in a common band of the room")
        for name, of in (("times", times), ("change", change), ("variance", variance)):
            put(self, **{name: read_only(of)})
        notes = []
        if empty := np.flatnonzero(np.isnan(change).all(axis=1)).tolist():
            without = first_of([" to ".join(self.pairs[i]) for i in empty], 3)
            notes.append(f"No T of both states at {without}: left out.")
        if unstated:
            notes.append(
                "A mean T has neither an uncertainty nor a number of positions, so it is treated "
                "as the T of one position (ISO 3382-2). Give either of them, or the T of each "
                "pair."
            )
        return notes

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Source-receiver pairs measured in both states; ``(("*", "*"),)`` for means over positions."""
        return tuple(self.states[0].pairs)

    @property
    def of_means(self) -> bool:
        """Whether means over positions are compared."""
        return self.states[0].is_summary

    @property
    def same(self) -> bool:
        """Whether every pair has the same T in both states, as when one file is given twice."""
        return not np.nan_to_num(self.change).any()

    @property
    def falls(self) -> bool:
        """Whether T is shorter after the change, by the mean of ln(T after / T before).

        Values are weighted by the inverse of their noise variance; if the mean is 0, the first
        ratio other than 1 decides.
        """
        mean = np.nansum(self.change / self.variance)
        if mean == 0 and not self.same:
            mean = self.change[np.nan_to_num(self.change) != 0][0]
        return bool(mean <= 0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Bands in which ``change`` is known, (n_bands,) of bool."""
        return np.asarray(np.isfinite(self.change).any(axis=0))


AnyCase: TypeAlias = Case | PositionsCase | StatesCase


def case_of(
    room: Room,
    measured: Measurement,
    simulator: PathTracing | None = None,
    before: Measurement | None = None,
    *,
    tracing: Mapping[str, Any] | None = None,
    simulated: Run | None = None,
    program: str = "",
    **stated: Any,
) -> AnyCase:
    """Return a room and its measurement as the kind of case that `rtcal.find` compares.

    With a measurement ``before``, it is a `StatesCase`. With a measurement of each source-receiver
    pair, and a simulator or a room that has its mesh, sources and receivers, it is a `PositionsCase`.
    Otherwise it is a `Case`, which compares means over positions.

    Parameters
    ----------
    room, measured, simulator, before, tracing, program
        As for `rtcal.find`.
    simulated : Run, optional
        Result of a simulation program, which replaces that of the reverberation equation or of the path
        tracing. At positions, the program must have used the room's input coefficients.
    **stated
        Further fields of a `PositionsCase`, such as ``exclude``.

    Raises
    ------
    DataError
        If the simulator is of another room; if ``tracing`` is given, but positions are not compared;
        for an argument that this kind of case does not have; and if the case does not accept a value.

    Examples
    --------
    >>> import rtcal as rt
    >>> type(case_of(*rt.datasets.bras_cr2())).__name__
    'Case'
    """
    checks.instance("room", room, Room)
    of_pairs = not checks.instance("measured", measured, Measurement).is_summary
    if simulated is not None:
        checks.instance("simulated", simulated, Run)
    if before is not None:
        of_pairs &= not checks.instance("before", before, Measurement).is_summary
    if simulator is not None and simulator.room is not room:
        raise DataError(_OTHER_ROOM)
    if simulator is not None and tracing:
        raise DataError("tracing and simulator are both given: make the simulator with tracing")
    needs = (
        "needs positions: a room with sources and receivers, and a measurement with values of pairs"
    )
    of_scene: dict[str, Any] = {}
    if simulator is None and of_pairs and room.scene.sources:
        if room.pieces:
            raise DataError(
                f'room "{room.name}" has the [[object]] "{room.pieces[0]}", which has no surface to '
                "trace. Search by means over positions: delete [sources] and [receivers] from its file"
            )
        options = checks.mapped("tracing", {} if tracing is None else tracing)
        checks.texts("tracing: names", options)
        simulator = geometry_files.path_tracing(room, **options)
        of_scene["surfaces"] = room.scene.surfaces or None
        of_scene["position_uncertainty"] = room.scene.position_uncertainty
    elif tracing:
        raise DataError(f"tracing {needs}{'' if before is None else ' before and after'}")
    if before is not None:
        for name, value in {**stated, "simulated": simulated}.items():
            if value:
                raise DataError(
                    f"{name} cannot be used in a search between two states: leave it out"
                )
        return StatesCase(room=room, before=before, after=measured, simulator=simulator)
    if simulator is not None and of_pairs:
        if program:
            raise DataError("program can be used only with means over positions: leave it out")
        if simulated is not None:
            simulated.refuse_other(room)
            if not np.array_equal(simulated.room.alpha, room.alpha):
                raise DataError(
                    "at positions, the simulation must have the room's own coefficients: leave at out"
                )
            stated["simulated"] = simulated.simulated
        return PositionsCase(simulator=simulator, measured=measured, **{**of_scene, **stated})
    for name in stated:
        raise DataError(f"{name} {needs}")
    whole = Configuration(name="as measured", measured=measured, simulated=simulated)
    return Case(room=room, configurations=[whole], program=program)
