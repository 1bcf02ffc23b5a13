"""An aperture to a second room, on the weighed paths.

The aperture takes energy as an opening of its area does. The second room gives a part of it back, late
and everywhere: two energy balances (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982),

    dE1/dt = -k1 E1 + b1 E2,   dE2/dt = -k2 E2 + b2 E1,   b = c S / 4V.

The paths, weighed with the opening, give what is heard without a return. Its mean over the receivers of
a source, convolved with h(t), is what comes back to all of them:

    h(t) = b1 b2 (exp(s1 t) - exp(s2 t)) / (s1 - s2),   s = -(k1 + k2)/2 ± sqrt((k1 - k2)²/4 + b1 b2).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

from rtcal.acoustics import decay
from rtcal.acoustics.room import Room
from rtcal.simulators.tracer import LONGEST
from rtcal.support.types import Array

VOLUMES = (0.3, 0.9, 2.7)
"""Volumes of the second room that are tried, over that of the first."""
ALPHAS = (0.03, 0.08, 0.2)
"""Its mean absorption coefficients."""
SECOND_ROOMS = tuple(product(VOLUMES, ALPHAS))
"""Volume over that of the first room, and mean alpha, of each second room."""
_NEPERS = 6 * np.log(10)
"""ln of the energy's decay in a reverberation time."""
_LARGEST_SHARE = 0.95
"""Of what a room loses, through an aperture."""
_FOLLOWED = 0.9
"""Of the slow reverberation time: 54 dB. T30 needs 50 dB with its margin."""


@dataclass(frozen=True)
class Aperture:
    """An aperture of ``area`` in m² to a second room of ``volume`` in m³ and mean ``alpha``.

    The second room has the surface of a cube.
    """

    area: float
    volume: float
    alpha: float

    def second_rate(self, room: Room) -> Array:
        """Return the rate in 1/s at which the second room's energy decays, (n_bands,)."""
        absorbed = -np.log1p(-self.alpha) * 6 * self.volume ** (2 / 3) + self.area
        air = 4 * self.volume * room.air_attenuation
        return np.asarray(room.speed_of_sound * (absorbed + air) / (4 * self.volume))

    def returned_to(self, energy: Array, room: Room, bin_width: float, n_sources: int) -> Array:
        """Return what is heard with the second room.

        Parameters
        ----------
        energy : array (n_pairs, n_bands, n_bins)
            Decays with an opening in place of the aperture, source by source.
        room : Room
        bin_width : float
            In s.
        n_sources : int

        Returns
        -------
        array (n_pairs, n_bands, n_bins)
            With as many more bins as the slower decay needs.
        """
        first = _NEPERS / decay.decay_time(energy.mean(axis=0), bin_width)
        second = self.second_rate(room)
        c = room.speed_of_sound
        # No more can go through it than the room loses: a field that is not diffuse decays more slowly.
        out = np.minimum(c * self.area / (4 * room.volume), _LARGEST_SHARE * first)
        exchange = out * c * self.area / (4 * self.volume)
        root = np.sqrt((first - second) ** 2 / 4 + exchange)
        slow, fast = (first + second) / 2 - root, (first + second) / 2 + root
        seconds = min(_FOLLOWED * _NEPERS / float(slow.min()), LONGEST)
        heard = _followed(energy, first, int(seconds / bin_width), bin_width)
        reverberant = heard.copy()
        reverberant[..., 0] = 0.0  # the direct sound is not what the whole room hears
        shape = (n_sources, -1, *heard.shape[1:])
        mean = reverberant.reshape(shape).mean(axis=1)
        back = np.empty_like(mean)
        for k in range(heard.shape[1]):
            both = [
                lfilter([1.0], [1.0, -np.exp(-rate * bin_width)], mean[:, k])
                for rate in (slow[k], fast[k])
            ]
            back[:, k] = exchange[k] * bin_width * (both[0] - both[1]) / (fast[k] - slow[k])
        return np.asarray((heard.reshape(shape) + back[:, np.newaxis]).reshape(heard.shape))


def _followed(energy: Array, rate: Array, n_bins: int, bin_width: float) -> Array:
    """Return decays that go on exponentially up to a number of bins."""
    missing = n_bins - energy.shape[-1]
    if missing <= 0:
        return energy
    last = max(energy.shape[-1] // 5, 1)
    steps = np.arange(missing + last) - (last - 1)
    course = np.exp(-rate[:, np.newaxis] * bin_width * steps)  # 1 in the last bin that there is
    level = energy[..., -last:].sum(axis=-1) / course[:, :last].sum(axis=-1)
    return np.concatenate([energy, level[..., np.newaxis] * course[:, last:]], axis=-1)
