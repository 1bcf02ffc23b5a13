"""The stated uncertainty of a room's areas and its climate, checked and in one unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.types import Array, read_only

_AREA_UNIT = "m²"


def relative(place: str, value: object) -> float:
    """Return a relative standard deviation; DataError unless it is 0 or more and below 1."""
    stated = checks.number(place, value)
    if not 0 <= stated < 1:
        percent = ": is it in percent?" if 1 <= stated <= 100 else ""
        raise DataError(f"{place} = {stated:g} is not a relative value from 0 to below 1{percent}")
    return stated


def by_material(stated: Any, materials: Sequence[str], areas: Array) -> Array:
    """Return the relative standard deviation of each area, (n_materials,), from any way to state it.

    Raises DataError for a value that is no relative one nor a text in m², and for an unknown material.
    """
    if isinstance(stated, Mapping):
        if unknown := [name for name in stated if name not in materials]:
            raise DataError(
                f'area_sigma["{unknown[0]}"]: no material of the room has that name; it has '
                f"{', '.join(materials)}"
            )
        listed = [stated.get(name, 0.0) for name in materials]
    elif isinstance(stated, str) or np.ndim(stated) == 0:
        listed = [stated] * len(materials)
    elif not np.any(listed := list(stated)):
        for value in listed:
            relative("area_sigma", value)
        listed = [0.0] * len(materials)  # nothing stated, also of a room that had other materials
    if len(listed) != len(materials):
        raise DataError(
            f"area_sigma has {len(listed)} values; there are {len(materials)} materials"
        )
    values = [
        _of_area(f'area_sigma["{name}"]', value, float(area))
        for name, value, area in zip(materials, listed, areas, strict=True)
    ]
    return read_only(np.array(values))


def _of_area(place: str, value: Any, area: float) -> float:
    if not isinstance(value, str):
        return relative(place, value)
    number, unit = value.strip().removesuffix(_AREA_UNIT), value.strip().endswith(_AREA_UNIT)
    try:
        square_metres = float(number)
    except ValueError:
        square_metres = np.nan
    if not unit or np.isnan(square_metres):
        raise DataError(
            f'{place} = "{value[:40]}" is no number with the unit m² (written with ²), such as '
            '"1.5 m²"; a share of the area is a number without quotes, such as 0.1'
        )
    if not 0 <= square_metres < area:
        raise DataError(
            f'{place} = "{value[:40]}" is not from 0 to below the area, which is {area:g} m²'
        )
    return square_metres / area


def climate(stated: Any, air: Air | None) -> tuple[float, float]:
    """Return the standard deviations of temperature in K and humidity in %; DataError if unfit."""
    pair = checks.listed("climate_sigma", stated)
    if len(pair) != 2:
        raise DataError(f"climate_sigma has {len(pair)} values; it has K and % of humidity")
    kelvin, percent = (checks.number("climate_sigma", value) for value in pair)
    for value, unit, most in ((kelvin, "K", 20), (percent, "%", 50)):
        if not 0 <= value <= most:
            raise DataError(f"climate_sigma = {value:g} {unit} is not from 0 to {most} {unit}")
    if air is None and (kelvin or percent):
        raise DataError("climate_sigma is stated, but no air that it belongs to")
    return kelvin, percent
