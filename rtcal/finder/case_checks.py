"""The rules of a case: its parts fit each other, and its values are physically possible."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from rtcal.acoustics import band_conversion, bands
from rtcal.acoustics.observables import observable
from rtcal.acoustics.room import AXES, Room, text_name
from rtcal.finder.configuration import PARAMETERS, Configuration
from rtcal.support import checks
from rtcal.support.errors import DataError, OtherBandsWarning
from rtcal.support.types import Array

LEVELS = {"c80": (-30.0, 60.0), "g": (-40.0, 60.0)}
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


def shares(room: Room, facing: Any) -> Array:
    """Return each material's shares of area along x, y and z, (n_materials, 3)."""
    n = room.n_materials
    if facing is None:
        sums = np.zeros((n, 3))
        for surface in room.surfaces:
            if surface.axis is not None:
                row = room.material_index(surface.material)
                sums[row, AXES.index(surface.axis)] += surface.area
        sums[sums.sum(1) == 0] = 1.0
        facing = sums
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
    notes = [band_conversion.rule(stated, wanted, "T")]
    unused = band_conversion.unused(stated, wanted)
    if unused.size:
        notes.append(f"left out, not in the room: {', '.join(bands.label(f) for f in unused)}")
    if any(notes):
        warnings.warn(
            f"{where}: {'; '.join(filter(None, notes))}",
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
    for i, k in np.argwhere(np.isfinite(values)):
        place, value = f"{where}: {name} at {bands.label(room.centre_frequencies[k])}", values[i, k]
        if name not in LEVELS:
            observable(name).refuse(place, value)
        elif not LEVELS[name][0] <= value <= LEVELS[name][1]:
            least, most = LEVELS[name]
            raise DataError(
                f"{place} = {value:g} dB is not from {least:g} to {most:g} dB, which no room exceeds"
            )
