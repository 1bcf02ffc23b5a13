"""A configuration of a room: a measurement, and the changes of the room for it.

A case is checked here, too: its parts fit each other, and its values are physically possible.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import msgspec
import numpy as np

from rtcal.acoustics import band_conversion, bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.measurement_files import MeasurementData
from rtcal.acoustics.observables import observable
from rtcal.acoustics.room import AirTable, Room, air
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError, OtherBandsWarning
from rtcal.support.files import json_numbers
from rtcal.support.schema import FileTable, Number
from rtcal.support.types import Array, read_only

PARAMETERS = ("t20", "edt", "t30", "c80", "g")
"""Parameters that are compared, in the order of a saved case."""
LEVELS = ("c80", "g")
"""Parameters in dB. The uncertainty of the other parameters is relative."""


class ChangedTable(FileTable):
    """The coefficients of a material in a configuration; see `ChangedMaterial`."""

    alpha: list[Number]
    sigma: list[Number]


class ConfigurationTable(FileTable):
    """A configuration but for its measurement; see `Configuration`."""

    name: str | None = None
    changes: dict[str, ChangedTable] | None = None
    suspect_removed: bool = False
    air: AirTable | None = None
    distances: list[Number] | None = None
    distance: list[Number] | None = None


_Values = list[list[Number | None] | Number | None]
"""A list (n_pairs, n_bands), or (n_bands,) for a single pair; None is missing."""


class ConfigurationData(ConfigurationTable):
    """A configuration as plain values: its measurement, or the values by parameter."""

    measured: MeasurementData | None = None
    planned: bool = False
    t20: _Values | None = None
    edt: _Values | None = None
    t30: _Values | None = None
    c80: _Values | None = None
    g: _Values | None = None
    pairs: list[tuple[str, str]] | None = None
    uncertainty: dict[str, _Values] | None = None
    common_uncertainty: dict[str, list[Number | None]] | None = None
    standard_deviation: dict[str, list[Number | None]] | None = None
    n_sources: int | None = None
    n_receivers: int | None = None


class Uncertainty(FileTable):
    """The uncertainty of values that state none: relative of a time, in dB of a level."""

    time: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None
    level: Annotated[float, msgspec.Meta(gt=0, le=20)] | None = None


@dataclass(frozen=True)
class ChangedMaterial:
    """Coefficients of one material in one configuration: alpha and sigma, (n_bands,).

    Raises
    ------
    DataError
        If one of them is not an array of numbers from 0 to 1.
    """

    alpha: Array
    sigma: Array

    def __post_init__(self) -> None:
        for name in ("alpha", "sigma"):
            array = checks.array(f"change: {name}", getattr(self, name))
            if array.ndim != 1 or not array.size or not ((array >= 0) & (array <= 1)).all():
                raise DataError(f"change: {name} is not an array (n_bands,) of values from 0 to 1")
            object.__setattr__(self, name, read_only(array))


@dataclass(frozen=True, kw_only=True, eq=False)
class Configuration:
    """One measurement of the room, and the changes of the room for it.

    Parameters
    ----------
    name : str
    measured : Measurement
        Any of T20, EDT, T30, C80, G.
    changes : mapping of str to Change
        Materials whose coefficients differ from the room's.
    suspect_removed : bool
        Whether the suspected object had been removed.
    air : Air, optional
        If the climate differed from the room's.
    distances : array (n_pairs,), optional
        From source to receiver in m; by default 0.66 times the cube root of the volume.
    planned : bool
        Whether ``measured`` holds placeholders for a measurement that is only planned.

    Raises
    ------
    DataError
        For a value of the wrong kind; the message names place and value.
    """

    name: str
    measured: Measurement
    changes: Mapping[str, ChangedMaterial] = field(default_factory=dict)
    suspect_removed: bool = False
    air: Air | None = None
    distances: Array | None = None
    planned: bool = False

    def __post_init__(self) -> None:
        where = f'configuration "{text_name("configuration: name", self.name)}"'
        checks.instance(f"{where}: measured", self.measured, Measurement)
        self.measured.refuse_large_uncertainty()
        changes = checks.mapped(f"{where}: changes", self.changes)
        for material, change in changes.items():
            text_name(f"{where}: changes: material", material)
            if not isinstance(change, ChangedMaterial):
                raise DataError(
                    f"{where}: changes[{material!r}] is not a rtcal.finder.ChangedMaterial"
                )
        object.__setattr__(self, "changes", changes)
        for name in ("suspect_removed", "planned"):
            checks.flag(f"{where}: {name}", getattr(self, name))
        if self.air is not None:
            checks.instance(f"{where}: air", self.air, Air)
        if self.distances is not None:
            distances = checks.array(f"{where}: distances", self.distances)
            if distances.ndim != 1 or not distances.size or not np.isfinite(distances).all():
                raise DataError(f"{where}: distances is not an array (n_pairs,) of finite values")
            object.__setattr__(self, "distances", read_only(distances))

    def coefficients(self, room: Room) -> tuple[Array, Array]:
        """Return alpha and sigma of the room in this configuration, (n_materials, n_bands)."""
        checks.instance("room", room, Room)
        alpha, sigma = np.array(room.alpha), np.array(room.sigma)
        for material, change in self.changes.items():
            row = room.material_index(material)
            alpha[row], sigma[row] = change.alpha, change.sigma
        return alpha, sigma

    def with_uncertainty(self, stated: Uncertainty) -> Configuration:
        """Return the configuration with uncertainties for the values that state none."""
        measured = self.measured
        added = dict(measured.uncertainty)
        for parameter, values in measured.values.items():
            if parameter in added:
                continue
            if parameter in LEVELS and stated.level is not None:
                added[parameter] = np.full_like(values, stated.level)
            elif parameter not in LEVELS and stated.time is not None:
                added[parameter] = stated.time * values
        return replace(self, measured=replace(measured, uncertainty=added))

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain values for JSON, as `from_dict` reads them."""
        measured = self.measured.to_dict()
        more: dict[str, Any] = {"pairs": measured["pairs"]}
        for name in ("common_uncertainty", "standard_deviation"):
            if measured.get(name):
                more[name] = _in_order(measured[name])
        more |= {k: v for k in ("n_sources", "n_receivers") if (v := measured[k]) is not None}
        if self.planned:
            more["planned"] = True
        return {
            "name": self.name,
            **_in_order(measured["values"]),
            "uncertainty": _in_order(measured["uncertainty"]),
            "changes": {
                material: {"alpha": json_numbers(c.alpha), "sigma": json_numbers(c.sigma)}
                for material, c in self.changes.items()
            },
            "suspect_removed": self.suspect_removed,
            "air": None if self.air is None else vars(self.air).copy(),
            "distances": None if self.distances is None else json_numbers(self.distances),
            **more,
        }

    @classmethod
    def of(
        cls, table: ConfigurationTable, measured: Measurement, *, planned: bool = False
    ) -> Configuration:
        """Return the configuration of a table and its measurement; DataError as the class."""
        changes = table.changes or {}
        default = "planned" if planned else "measured"
        distances = table.distance if table.distances is None else table.distances
        return cls(
            name=default if table.name is None else table.name,
            measured=measured,
            changes={
                name: ChangedMaterial(np.array(c.alpha), np.array(c.sigma))
                for name, c in changes.items()
            },
            suspect_removed=table.suspect_removed,
            air=air(table.air),
            distances=None if distances is None else np.array(distances),
            planned=planned,
        )


def measurement_of(table: ConfigurationData, centre_frequencies: Array) -> Measurement:
    """Return the measurement of a configuration's plain values, measured in these bands in Hz.

    Raises DataError for values by parameter beside a measurement, and for none of both.
    """
    where = f'configuration "{table.name}"'
    stated = {k: v for k, v in msgspec.structs.asdict(table).items() if v is not None}
    values: dict[str, Any] = {p: _rows(stated[p]) for p in PARAMETERS if p in stated}
    more = {k: stated[k] for k in MeasurementData.__struct_fields__[2:] if k in stated}
    if table.measured is not None:
        if beside := [*values, *more]:
            raise DataError(
                f"{where}: {beside[0]} stands beside measured; values come from one of them"
            )
        return Measurement(**msgspec.structs.asdict(table.measured))
    if not values:
        raise DataError(f"{where} has none of {', '.join(PARAMETERS)}")
    if "uncertainty" in more:
        more["uncertainty"] = {p: _rows(u) for p, u in more["uncertainty"].items()}
    n_pairs = len(next(iter(values.values())))
    pairs = [("S", f"R{i + 1}") for i in range(n_pairs)]
    try:
        return Measurement(
            centre_frequencies=centre_frequencies, values=values, **{"pairs": pairs, **more}
        )
    except DataError as error:
        raise DataError(f"{where}: {error}") from error


def _rows(values: Any) -> list[Any]:
    """Return nested lists; the values of a single pair become a list with one row."""
    return values if values and isinstance(values[0], list) else [values]


def _in_order(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables in the order of `from_dict`: a case that is read and saved keeps its bytes."""
    return {p: tables[p] for p in PARAMETERS if p in tables}


LEVEL_LIMITS = {"c80": (-30.0, 60.0), "g": (-40.0, 60.0)}
"""Limits that no room exceeds, in dB. C80: -30 is 10 dB below that of T = 120 s, and 60 is the range of
a good decay. G: -40 is 20 dB below the direct sound at 100 m, and 60 is 20 dB above that at 10 cm."""
VOLUMES = (1e-3, 1e8)
"""Accepted volumes in m³, from a scale model of a litre; the largest halls have some 1e7."""
LARGEST_AREA = 1e8
"""Largest area of one material in m²."""
_OFF_BOX = 0.1
"""Share by which the volume may differ from that of the stated dimensions."""


def check_room(room: Room) -> None:
    """Refuse impossible volumes, areas and sigma, and dimensions of another volume."""
    least, most = VOLUMES
    if not least <= room.volume <= most:
        raise DataError(f"room: volume = {room.volume:g} m³ is not from {least:g} to {most:g} m³")
    for material, area in zip(room.materials, room.areas, strict=True):
        if area > LARGEST_AREA:
            raise DataError(
                f'room: areas["{material}"] = {area:g} m² is not at most {LARGEST_AREA:g} m²'
            )
    if (room.sigma > 1).any():
        i, k = (int(v) for v in np.argwhere(room.sigma > 1)[0])
        raise DataError(
            f"room: {room.place('sigma', i, k)} = {room.sigma[i, k]:g} is not in [0, 1]"
        )
    if room.dimensions is not None:
        box = float(np.prod(room.dimensions))
        if abs(room.volume / box - 1) > _OFF_BOX:
            sides = " x ".join(f"{side:g}" for side in room.dimensions)
            raise DataError(
                f"room: volume = {room.volume:g} m³, but dimensions = {sides} m hold {box:g} m³; they "
                f"differ by at most {100 * _OFF_BOX:.0f} %"
            )


def checked_facing(room: Room, facing: Any) -> Array:
    """Return each material's stated shares of area along x, y and z, (n_materials, 3)."""
    n = room.n_materials
    array = checks.array("facing", facing)
    if array.shape != (n, 3):
        raise DataError(f"facing has shape {array.shape}; it is (n_materials, 3) = ({n}, 3)")
    total = array.sum(1, keepdims=True)
    if not np.isfinite(array).all() or (array < 0).any() or (total <= 0).any():
        raise DataError("facing has a value below 0, or a row that sums to 0")
    # Shares from a file already sum to 1; a further division would change their last digit.
    normalised: Array = np.where(np.abs(total - 1) < 1e-12, array, array / total)
    normalised.setflags(write=False)
    return normalised


def in_room_bands(room: Room, c: Configuration) -> Configuration:
    """Return the configuration with its measurement in the room's bands, as `calibrate` takes it.

    Warns if bands are converted or left out.
    """
    stated, wanted = c.measured.centre_frequencies, room.centre_frequencies
    if stated.tolist() == wanted.tolist():
        return c
    where = f'configuration "{c.name}"'
    try:
        measured = band_conversion.measurement_in_room_bands(c.measured, wanted)
    except DataError as error:
        raise DataError(f"{where}: {error}") from error
    if notes := band_conversion.notes(stated, wanted):
        warnings.warn(
            f"{where}: {'; '.join(notes)}",
            OtherBandsWarning,
            stacklevel=checks.stack_level(),
        )
    return replace(c, measured=measured)


def check_configuration(room: Room, c: Configuration) -> None:
    """Refuse a configuration that does not fit its room, or with impossible values."""
    if not text_name("configuration: name", c.name).strip():
        raise DataError(f"configuration: name = {c.name!r} is blank")
    where = f'configuration "{c.name}"'
    if "t20" not in c.measured.values and "t30" not in c.measured.values:
        raise DataError(f"{where} has neither t20 nor t30")
    for material, change in c.changes.items():
        room.material_index(material)
        for name in ("alpha", "sigma"):
            value = getattr(change, name)
            if value.shape != (room.n_bands,) or not ((value >= 0) & (value <= 1)).all():
                raise DataError(
                    f'{where}: {name} of "{material}" is not {room.n_bands} values from 0 to 1'
                )
    if c.distances is not None:
        n = len(c.measured.pairs)
        if c.distances.shape != (n,) or not (c.distances > 0).all():
            raise DataError(f"{where}: distances is not {n} values above 0, one per pair")
        _check_distances(where, room, c.distances)
    for name, value in c.measured.values.items():
        if name in PARAMETERS:
            _check_values(where, room, name, value)


def _check_distances(where: str, room: Room, distances: Array) -> None:
    if room.dimensions is not None:
        longest, rule = float(np.linalg.norm(room.dimensions)), "the room's diagonal"
    else:
        # A convex room of volume V and surface S is at most S²/(3 pi V) long, as a double cone is.
        # Three times that is allowed, since the stated area or volume may be wrong.
        longest = room.total_area**2 / (np.pi * room.volume)
        rule = "the longest that a room of this volume and area can be"
    if distances.max() > longest:
        raise DataError(
            f"{where}: distances has {distances.max():g} m; at most {longest:.3g} m, {rule}"
        )


def _check_values(where: str, room: Room, name: str, values: Array) -> None:
    kind = observable(name)
    least, most = LEVEL_LIMITS.get(name, kind.limits)
    with np.errstate(invalid="ignore"):
        outside = np.isfinite(values) & ~((values >= least) & (values <= most))
    for i, k in np.argwhere(outside):
        place, value = f"{where}: {name} at {bands.label(room.centre_frequencies[k])}", values[i, k]
        if name not in LEVEL_LIMITS:
            kind.refuse(place, value)
        else:
            raise DataError(
                f"{place} = {value:g} dB is not from {least:g} to {most:g} dB, which no room exceeds"
            )
