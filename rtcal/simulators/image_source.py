"""Image sources of a shoebox: counted once, weighed for any absorption afterwards.

Where an image source stands and which walls it was mirrored in does not depend on what the walls
absorb. So the images are counted once and kept, with their hits per wall, and weighed by

    E = product over walls (1 - alpha)^hits exp(-m d) / (4 pi d²)

for any alpha and band (Allen & Berkley 1979; energies are added, not pressures).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import decay
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.simulators.base import check_alpha
from rtcal.simulators.shoebox import Shoebox, shoebox
from rtcal.support import checks, jit
from rtcal.support.types import Array

Point = Sequence[float]
_MOST_IMAGES = 50_000_000


@dataclass(frozen=True, eq=False)
class Images:
    """The images of one source as one receiver hears them, in the order of their lattice.

    ``hits`` by axis, (n_lattice, 2), of the near and the far wall. Images that differ along the last
    axis alone are a run: ``rows`` (n_runs, 3) its first image's row in each axis' hits, ``starts``
    (n_runs + 1,) where its images begin. By image, (n_images,): its time bin in ``bins`` and
    1 / (4 pi d²) in 1/m² in ``weights``. ``lengths`` (n_bins,) is the mean d of a bin's images in m.
    """

    hits: tuple[NDArray[np.int64], ...]
    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    bins: NDArray[np.uint32]
    weights: Array
    lengths: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageSource:
    """The image sources of a shoebox, energies added in time bins.

    Parameters
    ----------
    room : Room
        A shoebox, as for `ScatteringDelayNetwork`.
    sources, receivers : mapping of name to (x, y, z)
        In m, inside the room.
    duration : float
        s after the direct sound; two thirds of the longest T that is to be simulated. The number
        of images grows with its cube.
    bin_width : float
        s, at most 0.01.

    Raises
    ------
    DataError
        If the room is no shoebox, a place is outside it, or there would be over 50 million images.

    References
    ----------
    J. B. Allen, D. A. Berkley: Image method for efficiently simulating small-room acoustics.
    J. Acoust. Soc. Am. 65, 1979.

    Examples
    --------
    >>> room = Room(name="box", volume=105, materials=["all"], areas=[142], alpha=[[0.3]],
    ...             sigma=[[0.1]], centre_frequencies=[1000], dimensions=(5, 7, 3))
    >>> images = ImageSource(
    ...     room=room, sources={"S": (4.5, 3.5, 2)}, receivers={"R": (2, 2, 1.5)}, duration=0.4)
    >>> print(images.simulate(room.alpha).mean("t20").round(2))
    [0.42]
    """

    room: Room
    sources: Mapping[str, Point]
    receivers: Mapping[str, Point]
    duration: float
    bin_width: float = 0.001
    name: ClassVar[str] = "image sources"
    deterministic: ClassVar[bool] = True
    smooth: ClassVar[bool] = True
    box: Shoebox = field(init=False)
    images: tuple[Images, ...] = field(init=False)
    attenuation: Array = field(init=False)

    def __post_init__(self) -> None:
        checks.positive("duration", self.duration, "s")
        decay.bins(self.bin_width)
        box = shoebox(self.room, self.sources, self.receivers)
        radius = self.duration * self.room.speed_of_sound
        number = 4 / 3 * np.pi * radius**3 / np.prod(box.dimensions)
        if number > _MOST_IMAGES:
            raise DataError(
                f"duration = {self.duration:g} s asks for {number / 1e6:.0f} million image sources a "
                f"pair; at most {_MOST_IMAGES // 1_000_000} million are counted"
            )
        object.__setattr__(self, "box", box)
        object.__setattr__(
            self, "images", tuple(self._count(s, r) for s, r in product(box.sources, box.receivers))
        )
        object.__setattr__(self, "attenuation", self.room.air_attenuation)

    @property
    def materials(self) -> Sequence[str]:
        """What the rows of alpha are."""
        return self.room.materials

    @property
    def centre_frequencies(self) -> Array:
        """What the columns of alpha are, in Hz."""
        return self.room.centre_frequencies

    def energy(self, alpha: Array) -> Array:
        """Return the energy in each bin after the direct sound, (n_pairs, n_bands, n_bins), in 1/m².

        Of a source of unit energy: the direct sound is 1 / (4 pi d²). The air takes from a bin what
        it takes over the mean length of the bin's images.
        """
        alpha = check_alpha(self, alpha)
        out = np.zeros((len(self.images), alpha.shape[1], self._n_bins))
        # What any number of hits on a wall leaves, (6, n_bands, n_hits); 0**0 is 1.
        most = max(int(axis.max()) for found in self.images for axis in found.hits)
        near_far = (1 - alpha[self.box.walls])[..., np.newaxis] ** np.arange(most + 1)
        weigh = _weigh
        if jit.available():
            from rtcal.simulators import image_numba

            weigh = image_numba.weigh
        for to, found in zip(out, self.images, strict=True):
            x, y, z = (
                near[:, hits[:, 0]] * far[:, hits[:, 1]]
                for near, far, hits in zip(near_far[::2], near_far[1::2], found.hits, strict=True)
            )
            to[:] = weigh(
                x, y, z, found.rows, found.starts, found.bins, found.weights, self._n_bins
            )
            to *= np.exp(-np.multiply.outer(self.attenuation, found.lengths))
        return out

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return EDT, T20, T30, C50, C80, D50 and Ts by pair; ``seed`` changes nothing.

        Raises
        ------
        TooShortError
            If ``duration`` does not hold T20.
        """
        return decay.measurement(
            self.energy(alpha), self.bin_width, self.centre_frequencies, self.box.pairs
        )

    @property
    def _n_bins(self) -> int:
        return int(np.ceil(self.duration / self.bin_width))

    def _count(self, source: Array, receiver: Array) -> Images:
        direct = float(np.linalg.norm(receiver - source))
        if direct == 0:
            raise DataError("a source and a receiver are at the same place")
        c, width = self.room.speed_of_sound, self.bin_width
        places, hits = lattice(self.box.dimensions, source, direct + self._n_bins * width * c)
        square = [(p - r) ** 2 for p, r in zip(places, receiver, strict=True)]
        beside = square[1][:, np.newaxis] + square[2]
        bins, lengths, rows, sizes = [], [], [], []
        for i, x2 in enumerate(square[0]):
            length = np.sqrt(x2 + beside)
            when = (length - direct) / (c * width) + 1e-9
            # The last axis is in order, so those near enough are one stretch of each row.
            inside = when < self._n_bins
            size = inside.sum(axis=1)
            here = np.flatnonzero(size)
            rows.append(
                np.stack([np.full(here.size, i), here, inside[here].argmax(axis=1)], axis=1)
            )
            sizes.append(size[here])
            bins.append(when[inside].astype(np.uint32))
            lengths.append(length[inside])
        bin_, length = np.concatenate(bins), np.concatenate(lengths)
        number = np.bincount(bin_, minlength=self._n_bins)
        return Images(
            hits=tuple(hits),
            rows=np.concatenate(rows),
            starts=np.concatenate([[0], np.cumsum(np.concatenate(sizes))]),
            bins=bin_,
            weights=1 / (4 * np.pi * length**2),
            lengths=np.bincount(bin_, length, self._n_bins) / np.maximum(number, 1),
        )


def _weigh(
    x: Array,
    y: Array,
    z: Array,
    rows: NDArray[np.int64],
    starts: NDArray[np.int64],
    bins: NDArray[np.uint32],
    weights: Array,
    n_bins: int,
) -> Array:
    """Return the energy of each bin, (n_bands, n_bins).

    ``x``, ``y`` and ``z``, (n_bands, n_lattice): what an image's hits along each axis leave.
    """
    size = np.diff(starts)
    last = np.arange(len(bins)) + np.repeat(rows[:, 2] - starts[:-1], size)
    first = np.repeat(np.arange(len(rows)), size)
    left = x[:, rows[:, 0]] * y[:, rows[:, 1]]
    return np.array(
        [
            np.bincount(bins, b[first] * c[last] * weights, n_bins)
            for b, c in zip(left, z, strict=True)
        ]
    )


def lattice(
    dimensions: Array, source: Array, radius: float
) -> tuple[list[Array], list[NDArray[np.int64]]]:
    """Return, by axis, where images within ``radius`` m stand and how often both walls are hit.

    Coordinates (n_images,) in m, increasing, and hits (n_images, 2) of the near and the far wall:
    the image (-1)^u x + 2 n L was mirrored |n - u| times in the wall at 0 and |n| times in that at L
    (Allen & Berkley 1979, Eq. 10).
    """
    places, hits = [], []
    for length, x in zip(dimensions, source, strict=True):
        most = int(np.ceil(radius / (2 * length))) + 1
        n, u = (v.ravel() for v in np.meshgrid(np.arange(-most, most + 1), [0, 1], indexing="ij"))
        place = np.asarray(np.where(u, -x, x) + 2 * n * length)
        order = np.argsort(place)
        places.append(place[order])
        hits.append(np.stack([np.abs(n - u), np.abs(n)], axis=1)[order])
    return places, hits
