"""The late energy of a shoebox's image sources, by its mean over all positions.

Images are evenly spread over space, one in each volume V. So there are c dt / V of them, times
4 pi (c t)², between t and t + dt, in all directions u, and (Lehmann & Johansson 2008)

    E(t) = c / V mean over u of exp(-c t (sum over axes |u_i| / L_i (-ln(1 - alpha_i)) + m)).
"""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.support.types import Array

_DIRECTIONS = 300


def mean_energy(room: Room, alpha: Array, distances: Array, times: Array) -> Array:
    """Return the energy per second, (n_distances, n_bands, n_times), in 1/(m² s).

    The source has unit energy: its direct sound is 1 / (4 pi d²).

    Parameters
    ----------
    room : Room
        A shoebox with dimensions.
    alpha : array (3, n_bands)
        Coefficients of both walls across each axis, below 1.
    distances : array (n_distances,)
        Source-receiver distances in m.
    times : array (n_times,)
        In s after the direct sound.

    References
    ----------
    E. A. Lehmann, A. M. Johansson: Prediction of energy decay in room impulse responses simulated with
    an image-source model. J. Acoust. Soc. Am. 124, 2008.

    Examples
    --------
    At t = 0 every image counts in full, so that the energy is c / V.

    >>> import numpy as np
    >>> room = Room(name="box", volume=105, materials=["all"], areas=[142], alpha=[[0.3]],
    ...             sigma=[[0.1]], centre_frequencies=[1000], dimensions=(5, 7, 3))
    >>> mean_energy(room, np.full((3, 1), 0.3), np.zeros(1), np.zeros(1)) * 105 / room.speed_of_sound
    array([[[1.]]])
    """
    c = room.speed_of_sound
    hits = _directions(_DIRECTIONS) / np.array(room.dimensions)
    lost = hits @ -np.log(1 - alpha) + room.air_attenuation
    before = np.exp(-np.multiply.outer(distances, lost))
    # Band by band, since a long decay in all directions and bands would fill the memory.
    of_bands = [
        before[:, :, k] @ np.exp(-np.multiply.outer(lost[:, k], c * times))
        for k in range(lost.shape[1])
    ]
    return np.asarray(np.stack(of_bands, axis=1) * (c / (len(hits) * room.volume)))


def _directions(n: int) -> Array:
    """Return unit vectors (n, 3), spread evenly over an octant by the golden ratio."""
    i = np.arange(n) + 0.5
    z, azimuth = i / n, np.pi / 2 * (i * (1 + np.sqrt(5)) / 2 % 1)
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)
