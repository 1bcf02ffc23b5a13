"""Modes of a box in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.errors import DataError
from rtcal.modes.room_modes import RoomModes
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array

BEYOND = 1.2
"""Modes up to this times the largest wanted frequency complete the shapes of those wanted."""
MOST = 600
"""Largest number of modes."""


@checked
def box_modes(
    dimensions: Sequence[float],
    materials: Sequence[str],
    largest: float,
    speed_of_sound: float = 343.2,
) -> RoomModes:
    """Return the modes of a box from the origin to ``dimensions`` (x, y, z) in m.

    phi = prod cos(n_i pi x_i / L_i) / norm, f = c / 2 |n / L| (Kuttruff 2009, Eq. 3.15 and 3.17).

    Parameters
    ----------
    dimensions : (x, y, z)
        m.
    materials : sequence of str (6,)
        Of the walls west, east (x = 0 and its opposite), south, north, floor and ceiling.
    largest : float
        Frequency in Hz up to which modes are wanted.
    speed_of_sound : float
        m/s.

    Raises
    ------
    DataError
        For a length that is not above 0, another number of materials, or too many modes.

    Examples
    --------
    >>> modes = box_modes((5, 4, 2.5), ["wall"] * 6, largest=60)
    >>> print(modes.frequencies[: modes.wanted].round(2))
    [34.32 42.9  54.94]
    """
    sides = checks.array("dimensions", dimensions)
    if sides.shape != (3,) or not (np.isfinite(sides) & (sides > 0)).all():
        raise DataError(f"dimensions = {dimensions!r} is not three finite lengths above 0 m")
    if len(materials) != 6:
        raise DataError(f"materials has {len(materials)} names; a box has 6 walls")
    top = BEYOND * checks.positive("largest", largest, "Hz")
    c = checks.positive("speed_of_sound", speed_of_sound, "m/s")
    counts = np.floor(2 * top * sides / c).astype(int)
    if np.prod(counts + 1.0) > 20 * MOST:
        raise DataError(
            f"largest = {largest:g} Hz: the box has over {MOST} modes; state a lower one"
        )
    orders = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), -1)
    orders = orders.reshape(-1, 3)
    frequencies = c / 2 * np.linalg.norm(orders / sides, axis=1)
    order = np.argsort(frequencies, kind="stable")
    order = order[(frequencies[order] > 0) & (frequencies[order] <= top)]
    if len(order) > MOST:
        raise DataError(
            f"largest = {largest:g} Hz: the box has over {MOST} modes; state a lower one"
        )
    orders, frequencies = orders[order], frequencies[order]
    norms = np.sqrt(np.where(orders > 0, 2.0, 1.0) / sides)

    def shapes(points: Array) -> Array:
        if ((points < 0) | (points > sides)).any():
            raise DataError("a position lies outside the room's walls")
        angle = np.pi * np.asarray(points)[:, np.newaxis, :] * orders / sides
        return np.asarray((np.cos(angle) * norms).prod(axis=2))

    coupling = np.empty((6, len(orders), len(orders)))
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        same = (orders[:, np.newaxis, others] == orders[np.newaxis, :, others]).all(axis=2)
        near = np.outer(norms[:, axis], norms[:, axis]) * same
        sign = np.where(orders[:, axis] % 2, -1.0, 1.0)
        coupling[2 * axis], coupling[2 * axis + 1] = near, near * np.outer(sign, sign)
    return RoomModes(
        frequencies=frequencies,
        coupling=coupling,
        walls=SHOEBOX_WALLS,
        materials=tuple(materials),
        speed_of_sound=c,
        largest=float(largest),
        shapes=shapes,
        error=np.zeros(len(frequencies)),
    )
