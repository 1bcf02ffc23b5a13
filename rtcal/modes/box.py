"""Modes of a box in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rtcal.modes.room_modes import RoomModes
from rtcal.support.errors import DataError
from rtcal.support.types import Array

BEYOND = 1.1
"""Modes up to this times the largest wanted frequency complete the shapes of those wanted."""
MOST = 600
"""Largest number of modes, about."""
_LARGEST_SIDE = 500.0
"""m. A longer room is likely in mm."""
_SUMMED = 200
"""Modes of a pair of orders that stand for an infinite number."""


def box_modes(sides: Array, materials: Sequence[str], largest: float, c: float) -> RoomModes:
    """Return the modes of a box from the origin to ``sides`` (3,) in m; see `modes_of`.

    phi = prod cos(n_i pi x_i / L_i) / norm, f = c / 2 |n / L| (Kuttruff 2009, Eq. 3.15 and 3.17).

    ``materials`` (6,) are of west (x = 0), east, south, north, floor and ceiling; ``c`` is the speed of
    sound in m/s. Raises DataError for too many modes up to ``largest``.
    """
    top = BEYOND * largest
    counts = np.floor(2 * top * sides / c).astype(int)
    # About half of these orders lie within the ellipsoid.
    refuse_many(float(np.prod(counts + 1.0)) / 2, largest, sides)
    orders = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), -1)
    orders = orders.reshape(-1, 3)
    frequencies = c / 2 * np.linalg.norm(orders / sides, axis=1)
    # The constant one, of frequency 0, stands last.
    order = np.roll(np.flatnonzero(frequencies <= top), -1)
    own, frequencies = orders[order], frequencies[order]
    beyond = [_beyond(own, sides, axis) for axis in range(3)]
    orders = np.concatenate([own[:-1], *(pairs for pairs, _, _ in beyond), own[-1:]])
    more = [wavenumbers * c / (2 * np.pi) for _, _, wavenumbers in beyond]
    frequencies = np.concatenate([frequencies[:-1], *more])
    rows = np.split(np.arange(len(own) - 1, len(orders) - 1), np.cumsum([len(f) for f in more])[:2])
    norms = np.sqrt(np.where(orders == 0, 1.0, 2.0) / sides)

    def along(points: Array) -> Array:
        """Return the factor of each axis, (n_points, n_modes + 1, 3)."""
        angle = np.pi * np.asarray(points)[:, np.newaxis, :] / sides
        out = np.cos(angle * orders)
        for axis, (_, series, _) in enumerate(beyond):
            waves = np.cos(angle[:, :, axis] * np.arange(series.shape[1]))
            out[:, rows[axis], axis] = waves @ series.T
        return np.asarray(out * norms)

    def shapes(points: Array) -> Array:
        if ((points < 0) | (points > sides)).any():
            raise DataError("a position lies outside the room's walls")
        return np.asarray(along(points).prod(axis=2))

    at_walls = along(np.array([np.zeros(3), sides]))
    coupling = np.empty((6, len(orders), len(orders)))
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        same = (orders[:, np.newaxis, others] == orders[np.newaxis, :, others]).all(axis=2)
        for end, values in enumerate(at_walls[:, :, axis]):
            coupling[2 * axis + end] = np.outer(values, values) * same
    rising = np.argsort(frequencies, kind="stable")
    every = np.append(rising, len(rising))
    return RoomModes(
        frequencies=frequencies[rising],
        coupling=coupling[:, every[:, np.newaxis], every],
        materials=tuple(materials),
        speed_of_sound=c,
        largest=float(largest),
        shapes=lambda points: shapes(points)[:, every],
    )


def refuse_many(count: float, largest: float, sides: Array) -> None:
    """Raise DataError for more than `MOST` modes up to ``largest`` in Hz; ``sides`` in m."""
    if count > MOST:
        size = " x ".join(f"{side:.3g}" for side in sides)
        raise DataError(
            f"the room of {size} m has some {count:.0f} modes up to {largest:g} Hz, and at most {MOST} "
            "are calculated: leave out modes above a lower frequency"
            + (", or is it in mm?" if np.max(sides) > _LARGEST_SIDE else "")
        )


def _beyond(
    orders: NDArray[np.int64], sides: Array, axis: int
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return what the walls across an axis excite beyond the modes of these orders.

    For each pair of orders along the other axes these are two static answers, an even and an odd one:
    sums of all higher modes of the pair, weighed by 1 / wavenumber². Returned are orders, of which the
    axis' own is -2 (even) or -1 (odd), the series over the axis' modes, and wavenumbers in 1/m.
    """
    others = [a for a in range(3) if a != axis]
    pairs, place = np.unique(orders[:, others], axis=0, return_inverse=True)
    last = np.zeros(len(pairs), dtype=int)
    np.maximum.at(last, place.ravel(), orders[:, axis])
    along = np.arange(_SUMMED)
    squares = (along / sides[axis]) ** 2 + ((pairs / sides[others]) ** 2).sum(axis=1)[:, np.newaxis]
    higher = (along > last[:, np.newaxis]) / np.maximum(squares, 1e-9)
    series = np.concatenate([higher * (along % 2 == 0), higher * (along % 2 == 1)])
    series /= np.linalg.norm(series, axis=1)[:, np.newaxis]
    own = np.repeat([-2, -1], len(pairs))
    wavenumbers = np.pi * np.sqrt((series**2 * np.tile(squares, (2, 1))).sum(axis=1))
    return np.insert(np.tile(pairs, (2, 1)), axis, own, axis=1), series, wavenumbers
