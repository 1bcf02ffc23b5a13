"""A configuration of a room: a measurement, and the changes of the room for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rtcal.acoustics import room_files
from rtcal.acoustics.air import Air
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.measurement_files import OPTIONAL
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.types import Array, read_only

PARAMETERS = ("t20", "edt", "t30", "c80", "g")
"""Parameters that are compared, in the order of a saved case."""
LEVELS = ("c80", "g")
"""Parameters in dB. The uncertainty of the other parameters is relative."""
MAX_UNCERTAINTY = {"time": (1.0, " (relative: 0.02 is 2 %)"), "level": (20.0, " dB")}

_KEYS = ("name", "changes", "suspect_removed", "air", "distances", "distance", "planned")


@checked
@dataclass(frozen=True)
class Change:
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


@checked
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
    changes: Mapping[str, Change] = field(default_factory=dict)
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
            if not isinstance(change, Change):
                raise DataError(f"{where}: changes[{material!r}] is not a rtcal.finder.Change")
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
        alpha, sigma = np.array(room.alpha), np.array(room.sigma)
        for material, change in self.changes.items():
            row = room.material_index(material)
            alpha[row], sigma[row] = change.alpha, change.sigma
        return alpha, sigma

    def with_uncertainty(self, stated: Mapping[str, float]) -> Configuration:
        """Return the configuration with uncertainties for the values that state none.

        ``stated`` as `checked_uncertainty` returns it.
        """
        measured = self.measured
        added = dict(measured.uncertainty)
        for parameter, values in measured.values.items():
            if parameter not in added and "level" in stated and parameter in LEVELS:
                added[parameter] = np.full_like(values, stated["level"])
            elif parameter not in added and "time" in stated and parameter not in LEVELS:
                added[parameter] = stated["time"] * values
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
    @checked
    def from_dict(cls, data: Mapping[str, Any], centre_frequencies: Array) -> Configuration:
        """Return the configuration of plain values, measured in these bands in Hz.

        ``data`` holds either the values, by parameter, or ``measured`` as `Measurement.to_dict`
        returns it. Raises DataError for an unknown key, and for a value of the
        wrong kind.
        """
        name = text_name("configuration: name", data.get("name", "measured"))
        where = f'configuration "{name}"'
        inline = (*PARAMETERS, *OPTIONAL)
        entries = Entries(f"{where}: ", data, (), (*_KEYS, "measured", *inline))
        if "measured" in data:
            if beside := [key for key in inline if key in data]:
                raise DataError(
                    f"{where}: {beside[0]} stands beside measured; values come from one of them"
                )
            measured = Measurement.from_dict(entries.mapping("measured"))
        else:
            measured = _inline(where, data, centre_frequencies)
        distances = "distances" if "distances" in entries else "distance"
        return cls(
            name=name,
            measured=measured,
            changes={
                material: _change(f'{where}: changes: "{material}"', change)
                for material, change in (
                    entries.mapping("changes") if data.get("changes") is not None else {}
                ).items()
            },
            suspect_removed=entries.flag("suspect_removed", False),
            air=room_files.air(f"{where}: air", data.get("air")),
            distances=entries.array(distances, (None,)) if distances in entries else None,
            planned=entries.flag("planned", False),
        )


def checked_uncertainty(stated: Mapping[str, Any]) -> dict[str, float]:
    """Return the uncertainty of values that state none: ``time`` relative, ``level`` in dB.

    Raises DataError unless it is above 0 and at most `MAX_UNCERTAINTY`.
    """
    entries = Entries("uncertainty: ", stated, (), MAX_UNCERTAINTY)
    numbers = {key: checks.positive(f"uncertainty: {key}", entries.number(key)) for key in stated}
    for key, number in numbers.items():
        most, unit = MAX_UNCERTAINTY[key]
        if number > most:
            raise DataError(f"uncertainty: {key} = {number:g} is not at most {most:g}{unit}")
    return numbers


def _in_order(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables in the order of `from_dict`: a case that is read and saved keeps its bytes."""
    return {p: tables[p] for p in PARAMETERS if p in tables}


def _inline(where: str, data: Mapping[str, Any], centre_frequencies: Array) -> Measurement:
    """Return the measurement whose values the configuration holds by parameter."""
    values = {p: _rows(f"{where}: {p}", data[p]) for p in PARAMETERS if p in data}
    if not values:
        raise DataError(f"{where} has none of {', '.join(PARAMETERS)}")
    n_pairs = len(next(iter(values.values())))
    pairs = data.get("pairs")
    measurement = {
        "centre_frequencies": centre_frequencies,
        "values": values,
        "pairs": [["S", f"R{i + 1}"] for i in range(n_pairs)] if pairs is None else pairs,
        **{key: data[key] for key in OPTIONAL[2:] if data.get(key) is not None},
    }
    if data.get("uncertainty") is not None:
        stated = checks.mapped(f"{where}: uncertainty", data["uncertainty"])
        measurement["uncertainty"] = {
            p: _rows(f"{where}: uncertainty: {p}", u) for p, u in stated.items()
        }
    try:
        return Measurement.from_dict(measurement)
    except DataError as error:
        raise DataError(f"{where}: {error}") from error


def _rows(place: str, values: Any) -> list[Any]:
    """Return nested lists; the values of a single pair become a list with one row."""
    rows = list(checks.listed(place, values))
    return rows if rows and isinstance(rows[0], list | tuple | np.ndarray) else [rows]


def _change(place: str, data: Any) -> Change:
    change = Entries(f"{place}: ", data, ("alpha", "sigma"))
    return Change(change.array("alpha", (None,)), change.array("sigma", (None,)))
