"""What a room's volume, areas and climate may be off by, as absorption area that T asks for.

With the stated volume V and areas S the equation asks a measured T for b. The true room is a little
different, so that S'alpha of the true coefficients differs from b. To first order the difference is a
sum of changes, each with an independent standard normal size. `target_changes` returns them. All bands
share these sizes, which is why several bands tell them from errors of the coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.types import Array, read_only

if TYPE_CHECKING:
    from rtcal.acoustics.equations import LinearEquation
    from rtcal.acoustics.room import Room

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
    else:
        listed = list(stated)
    if len(listed) != len(materials):
        raise DataError(f"area_sigma has {len(listed)} values; there are {len(materials)} materials")
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
    if not unit or not 0 <= square_metres < area:
        raise DataError(
            f'{place} = "{value[:40]}" is not a text such as "1.5 m²", from 0 to below {area:g} m²'
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


def in_words(room: Room) -> str:
    """Return what the room states of its uncertainty: "volume 5 %, areas 3 %"; "" for nothing.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.05]], centre_frequencies=[1000], volume_sigma=0.05, area_sigma=0.03)
    >>> in_words(room)
    'volume 5 %, areas 3 %'
    """
    least, most = 100 * room.area_sigma.min(), 100 * room.area_sigma.max()
    kelvin, percent = room.climate_sigma
    stated = (
        (room.volume_sigma, f"volume {100 * room.volume_sigma:.3g} %"),
        (most, f"areas {least:.3g} to {most:.3g} %" if least < most else f"areas {most:.3g} %"),
        (room.common_area_sigma, f"areas together {100 * room.common_area_sigma:.3g} %"),
        (kelvin, f"temperature {kelvin:.3g} K"),
        (percent, f"humidity {percent:.3g} %"),
        (room.common_alpha_sigma, f"coefficients together {100 * room.common_alpha_sigma:.3g} %"),
    )
    return ", ".join(words for value, words in stated if value)


def target_changes(equation: LinearEquation, room: Room, t: Array) -> Array:
    """Return the changes of b - S'alpha by one standard deviation each, (n_changes, n_bands), in m².

    In this order: the volume, what the areas have in common, the area of each material, temperature
    and humidity. With the exponent a, b = S E^-1(a) and a = (k V / T - 4 m V) / S, at the stated room
    and measured T

        V db/dV = S a / E',  db/dS = b / S - a / E',  d(S'alpha)/dS_i = mu_i.

    In Sabine's equation E' = 1 and db/dS = 0, so that only the products of two errors are neglected:
    (alpha - mu) times the error of an area. In Eyring's and Kuttruff's, b is linearised as well.
    Bands without T, or whose T no absorption gives, have 0.

    Parameters
    ----------
    equation : LinearEquation
    room : Room
        Its stated standard deviations and mu.
    t : array (n_bands,)
        Measured T in s.

    Examples
    --------
    A volume of 60 m³ ± 5 % asks for 5 % more or less in Sabine's equation.

    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.05]], centre_frequencies=[1000], volume_sigma=0.05)
    >>> sabine = rt.Sabine()
    >>> change = target_changes(sabine, room, np.array([0.5]))
    >>> print((change[0] / sabine.target(room, [0.5])).round(3))
    [-0.05]
    """
    t = np.asarray(t, dtype=float)
    b, total = equation.target(room, t), room.total_area
    with np.errstate(invalid="ignore"):
        mean = b / total
        reach = equation.exponent(mean) / equation.slope(mean)
    of_volume = -total * reach
    of_areas = room.areas[:, np.newaxis] * (room.alpha - (mean - reach))
    changes = np.vstack(
        [
            room.volume_sigma * of_volume,
            room.common_area_sigma * of_areas.sum(axis=0),
            room.area_sigma[:, np.newaxis] * of_areas,
            *_of_climate(equation, room, t),
        ]
    )
    return np.where(np.isfinite(b), changes, 0.0)


def _of_climate(equation: LinearEquation, room: Room, t: Array) -> tuple[Array, Array]:
    """Half the difference of b between the climates one standard deviation below and above."""
    air, (kelvin, percent) = room.air, room.climate_sigma
    none = np.zeros(room.n_bands)
    if air is None or not (kelvin or percent):
        return none, none

    def change(name: str, sigma: float, low: float, high: float) -> Array:
        if not sigma:
            return none
        stated = getattr(air, name)
        ends = max(stated - sigma, low), min(stated + sigma, high)
        first, last = (
            equation.target(room.with_air(replace(air, **{name: end})), t) for end in ends
        )
        return np.asarray((first - last) * sigma / (ends[1] - ends[0]))

    return change("temperature", kelvin, -20, 50), change("humidity", percent, 1.01, 100)
