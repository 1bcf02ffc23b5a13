"""A `Room` as a shoebox: image sources, and the scattering delay network.

The position of an image source and the walls it was mirrored in do not depend on absorption. The
images are therefore stored with their hits per wall. For any alpha and band, an image at the
distance d contributes the energy (Allen & Berkley 1979; energies are added, not pressures)

    E = product over walls (1 - alpha)^hits exp(-m d) / (4 pi d²).

The late energy of a shoebox is that of its images' mean over all positions (`mean_energy`). Images
are evenly spread over space, one in each volume V. So there are c dt / V of them, times
4 pi (c t)², between t and t + dt, in all directions u, and (Lehmann & Johansson 2008)

    E(t) = c / V mean over u of exp(-c t (sum over axes |u_i| / L_i (-ln(1 - alpha_i)) + m)).

The scattering delay network has six nodes on the walls of a shoebox.
Each node stands where the first-order reflection from source to receiver meets its wall. Delay lines
join the nodes. First-order reflections are exact. Later ones have the right density and the walls'
losses, and cost much less than image sources.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import observables
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, TARGET
from rtcal.acoustics.room import Room
from rtcal.simulators import base
from rtcal.simulators.base import Observations, RoomSimulator, check_alpha
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, put, read_only_view

Point = Sequence[float]


class Shoebox(NamedTuple):
    """Shoebox-shaped room with sources and receivers; its arrays are read-only."""

    dimensions: Array
    """Length, width and height in m, (3,)."""
    walls: NDArray[np.int64]
    """Number of the material of each wall, (6,), in the order of `SHOEBOX_WALLS`."""
    sources: Array
    receivers: Array
    """Positions of ``sources`` and ``receivers`` in m, (n, 3) each."""
    pairs: tuple[tuple[str, str], ...]
    """Names of source and receiver of each pair, ordered by source."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ShoeboxSimulator(RoomSimulator, ABC):
    """Base of simulators of shoebox-shaped rooms without random numbers.

    Parameters
    ----------
    room : Room
        Room with dimensions, and with a single material or a surface for each of
        `rtcal.simulators.geometry.SHOEBOX_WALLS`. Its bands, air and speed of sound are used, but not
        its coefficients.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room.

    Raises
    ------
    DataError
        If the room is no shoebox, an area differs from that of the walls by over 1 %, a position is
        outside the room, or a source and a receiver are at the same place.
    """

    room: Room
    sources: Mapping[str, Point]
    receivers: Mapping[str, Point]
    box: Shoebox = field(init=False)
    deterministic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        room, box = self.room, box_of(self.room)
        sides = np.ptp(box.vertices, axis=0)
        for material, area in zip(room.materials, room.areas, strict=True):
            if abs(box.areas.get(material, 0.0) - area) > 0.01 * area:
                raise DataError(
                    f'areas["{material}"] = {area:.4g} m², but its walls in the box of '
                    f"{' x '.join(f'{d:g}' for d in sides)} m have "
                    f"{box.areas.get(material, 0.0):.4g} m²"
                )
        of_sources, of_receivers = box.positions(self.sources, self.receivers)
        made = Shoebox(
            dimensions=sides,
            walls=np.array([room.material_index(material) for material in box.materials]),
            sources=of_sources,
            receivers=of_receivers,
            pairs=tuple((s, r) for s in self.sources for r in self.receivers),
        )
        for values in made[:4]:
            values.setflags(write=False)
        put(self, box=made)

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the simulator with the settings that change T; coefficients are valid only for it."""

    @property
    def tracing(self) -> PathTracing:
        """Path tracing of the same box, with scattering coefficients of 0.5."""
        return PathTracing(
            geometry=Polyhedron.shoebox(
                self.box.dimensions.tolist(),
                dict(zip(SHOEBOX_WALLS, (self.materials[w] for w in self.box.walls), strict=True)),
            ),
            room=self.room,
            sources=self.sources,
            receivers=self.receivers,
            scattering=0.5,
        )

    @abstractmethod
    def decays(self, alpha: Array) -> tuple[Array, float]:
        """Return energy decays for coefficients ``alpha``, and the width of their time bins in s.

        The decays are (n_pairs, n_bands, n_bins) in 1/m², from the direct sound on, which is 1 / (4 pi
        d²) for a source of unit energy.
        """

    def observe(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Observations:
        """Return the parameters at each pair as `Observations`, for alpha (n_materials, n_bands).

        ``match`` are keys of the parameters. The level is G of a source of known power. ``seed`` has no
        effect. Raises the errors of `simulate`.
        """
        checks.whole("seed", seed, 0)
        match = base.checked_parameters(match)
        energy, width = self.decays(check_alpha(self, alpha))
        return base.of_decays(energy, width, match, self.box.pairs, self.centre_frequencies)

    def jacobian(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Array:
        """Return the derivatives of `observe` by alpha, from `rtcal.simulators.base.differences`.

        ``alpha`` (n_materials, n_bands) are the coefficients, and ``match`` the keys of the parameters.
        ``seed`` has no effect.
        """
        return base.differences(self, alpha, match, seed=seed)

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the parameters at each pair for coefficients ``alpha`` (n_materials, n_bands).

        The seed has no effect. Raises `TooShortError` if a decay is too short for T20.
        """
        checks.whole("seed", seed, 0)
        return Measurement.from_decays(
            *self.decays(check_alpha(self, alpha)), self.centre_frequencies, self.box.pairs
        )


def box_of(room: Room) -> Polyhedron:
    """Return the box of a room's dimensions, with the material of each wall.

    The walls have the room's single material, or that of the surface with the wall's name. Raises
    DataError for a room without dimensions, and for a wall without a surface of its name.
    """
    checks.instance("room", room, Room).refuse_pieces("a simulation of the shoebox")
    if (sides := room.dimensions) is None:
        raise DataError(
            f'room "{room.name}" has no dimensions, which this simulator needs; give the '
            "room dimensions"
        )
    if room.n_materials == 1:
        return Polyhedron.shoebox(sides, room.materials[0])
    named = {m: m for m in room.materials} | {s.name: s.material for s in room.surfaces}
    walls = {wall: named[wall] for wall in SHOEBOX_WALLS if wall in named}
    if missing := [wall for wall in SHOEBOX_WALLS if wall not in walls]:
        raise DataError(
            f'room "{room.name}" is a box, but has no surface called {", ".join(missing)}: '
            f"give one surface for each wall, called {', '.join(SHOEBOX_WALLS)}, with its "
            "material and area (docs/files.md)"
        )
    return Polyhedron.shoebox(sides, walls)


_MOST_IMAGES = 50_000_000


class Images(NamedTuple):
    """Image sources of one source for one receiver; the arrays are read-only.

    Images are sorted in runs: the images of a run differ only in their position along the last axis.
    """

    hits: tuple[NDArray[np.int64], ...]
    """Numbers of hits on the near and on the far wall, (n_lattice, 2) for each axis."""
    rows: NDArray[np.uint64]
    """Row of ``hits`` of each run's first image, by axis, (n_runs, 3)."""
    starts: NDArray[np.uint64]
    """Index of each run's first image, (n_runs + 1,)."""
    bins: NDArray[np.uint32]
    """Time bin of each image, (n_images,)."""
    weights: Array
    """Energy 1 / (4 pi d²) of each image at the distance d without absorption, in 1/m²."""
    lengths: Array
    """Mean distance of the images in each time bin in m, (n_bins,)."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageSource(ShoeboxSimulator):
    """Simulator of a shoebox by image sources, whose energies are added in time bins.

    Parameters
    ----------
    room : Room
        Room with dimensions, and with one material or a surface for each of its six walls
        (`ShoeboxSimulator` has the rules).
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room.
    duration : float
        Length of the decay in s after the direct sound. Two thirds of T are enough for T20. The number
        of images grows with the cube of the duration.
    bin_width : float
        Width of the time bins in s, at most 0.01.

    Raises
    ------
    DataError
        If the room is no shoebox, an area differs from that of the walls by over 1 %, a position is
        outside the room or at another one, or a pair needs over 50 million images.

    References
    ----------
    J. B. Allen, D. A. Berkley: Image method for efficiently simulating small-room acoustics.
    J. Acoust. Soc. Am. 65, 1979.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=105, materials=["all"], areas=[142], alpha=[[0.3]],
    ...             sigma=[[0.1]], centre_frequencies=[1000], dimensions=(5, 7, 3))
    >>> images = ImageSource(
    ...     room=room, sources={"S": (4.5, 3.5, 2)}, receivers={"R": (2, 2, 1.5)}, duration=0.4)
    >>> print(images.simulate(room.alpha).mean("t20").round(2))
    [0.42]
    """

    duration: float
    bin_width: float = 0.001
    images: tuple[Images, ...] = field(init=False)
    name: ClassVar[str] = "image sources"

    def __post_init__(self) -> None:
        checks.positive("duration", self.duration, "s")
        observables.bins(self.bin_width)
        super().__post_init__()
        radius = self.duration * self.room.speed_of_sound
        with np.errstate(over="ignore"):
            number = 4 / 3 * np.pi * np.float64(radius) ** 3 / np.prod(self.box.dimensions)
        if number > _MOST_IMAGES:
            raise DataError(
                f"duration = {self.duration:g} s needs {number / 1e6:.0f} million image sources "
                f"per pair, more than the {_MOST_IMAGES // 1_000_000} million allowed: give a "
                "shorter duration"
            )
        positions = product(self.box.sources, self.box.receivers)
        put(self, images=tuple(self._images(s, r) for s, r in positions))

    def decays(self, alpha: Array) -> tuple[Array, float]:
        """Return energy decays for coefficients ``alpha``, and the width of their time bins in s.

        The decays are (n_pairs, n_bands, n_bins) in 1/m² for a source of unit energy, from the direct
        sound on. The air attenuates each bin by the mean distance of its images. ``alpha`` is
        (n_materials, n_bands).
        """
        from rtcal.simulators import kernels

        most = max(int(axis.max()) for images in self.images for axis in images.hits)
        # (6, n_bands, n_hits); 0**0 is 1.
        reflected = (1 - check_alpha(self, alpha)[self.box.walls])[..., np.newaxis] ** np.arange(
            most + 1
        )
        out = []
        for images in self.images:
            x, y, z = (
                near[:, hits[:, 0]] * far[:, hits[:, 1]]
                for near, far, hits in zip(
                    reflected[::2], reflected[1::2], images.hits, strict=True
                )
            )
            energy = np.zeros((len(x), self._n_bins))
            kernels.weigh(x, y, z, images.rows, images.starts, images.bins, images.weights, energy)
            out.append(
                energy * np.exp(-np.multiply.outer(self.room.air_attenuation, images.lengths))
            )
        return np.stack(out), self.bin_width

    @property
    def _n_bins(self) -> int:
        return int(np.ceil(self.duration / self.bin_width))

    def _images(self, source: Array, receiver: Array) -> Images:
        direct = float(np.linalg.norm(receiver - source))
        c, width, n_bins = self.room.speed_of_sound, self.bin_width, self._n_bins
        coordinates, hits = lattice(self.box.dimensions, source, direct + n_bins * width * c)
        square = [(x - r) ** 2 for x, r in zip(coordinates, receiver, strict=True)]
        across = square[1][:, np.newaxis] + square[2]
        bins, lengths, rows, sizes = [], [], [], []
        for i, x2 in enumerate(square[0]):
            length = np.sqrt(x2 + across)
            arrival = (length - direct) / (c * width) + 1e-9
            # Coordinates increase, so the images within the duration are contiguous in each row.
            inside = arrival < n_bins
            size = inside.sum(axis=1)
            heard = np.flatnonzero(size)
            first = inside[heard].argmax(axis=1)
            rows.append(np.stack([np.full(heard.size, i), heard, first], axis=1))
            sizes.append(size[heard])
            bins.append(arrival[inside].astype(np.uint32))
            lengths.append(length[inside])
        bin_, length = np.concatenate(bins), np.concatenate(lengths)
        images_per_bin = np.bincount(bin_, minlength=n_bins)
        return Images(
            tuple(map(read_only_view, hits)),
            read_only_view(np.concatenate(rows).astype(np.uint64)),
            read_only_view(np.cumsum(np.concatenate([[0], *sizes]), dtype=np.uint64)),
            read_only_view(bin_),
            read_only_view(1 / (4 * np.pi * length**2)),
            read_only_view(np.bincount(bin_, length, n_bins) / np.maximum(images_per_bin, 1)),
        )


def lattice(
    dimensions: Array, source: Array, radius: float
) -> tuple[list[Array], list[NDArray[np.int64]]]:
    """Return coordinates and wall hits of image sources along each axis, at least up to ``radius`` m.

    The coordinates (n_lattice,) in m increase. The hits (n_lattice, 2) are the numbers of reflections
    at the near and the far wall: for u = 0 or 1 and whole n, the image (-1)^u x + 2 n L was mirrored
    |n - u| times in the wall at 0 and |n| times in the wall at L (Allen & Berkley 1979, Eq. 10).
    ``dimensions`` and ``source`` (3,) are in m.
    """
    coordinates, hits = [], []
    for length, x in zip(dimensions, source, strict=True):
        most = int(np.ceil(radius / (2 * length))) + 1
        n, u = (v.ravel() for v in np.meshgrid(np.arange(-most, most + 1), [0, 1], indexing="ij"))
        coordinate = np.asarray(np.where(u, -x, x) + 2 * n * length)
        order = np.argsort(coordinate)
        coordinates.append(coordinate[order])
        hits.append(np.stack([np.abs(n - u), np.abs(n)], axis=1)[order])
    return coordinates, hits


_DIRECTIONS = 300


def mean_energy(room: Room, alpha: Array, distances: Array, times: Array) -> Array:
    """Return the mean energy per second in a shoebox, (n_distances, n_bands, n_times), in 1/(m² s).

    The source has unit energy: its direct sound is 1 / (4 pi d²) (E. A. Lehmann, A. M. Johansson, J.
    Acoust. Soc. Am. 124, 2008). The room is a shoebox with dimensions; ``alpha`` (3, n_bands), below 1,
    is that of both walls across each axis. ``distances`` from source to receiver are in m, ``times`` in
    s after the direct sound.
    """
    c = room.speed_of_sound
    # Unit vectors, spread evenly over an octant by the golden ratio.
    i = np.arange(_DIRECTIONS) + 0.5
    z, azimuth = i / _DIRECTIONS, np.pi / 2 * (i * (1 + np.sqrt(5)) / 2 % 1)
    across = np.sqrt(1 - z**2)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)
    hits = directions / np.array(room.dimensions)
    lost = hits @ -np.log(1 - alpha) + room.air_attenuation
    before = np.exp(-np.multiply.outer(distances, lost))
    # Even steps in time: exp(-a (t0 + i dt)) = exp(-a t0) exp(-a dt m q) exp(-a dt r), i = m q + r.
    step = np.diff(times)
    even = np.allclose(step, step[:1], rtol=1e-9, atol=0)
    m = max(int(np.sqrt(times.size)), 1) if even else 1
    first, within = times[::m], times[:m] - times[:1]
    # Band by band, since a long decay in all directions and bands would fill the memory.
    of_bands = [
        (
            (before[:, np.newaxis, :, k] * np.exp(-np.multiply.outer(c * first, lost[:, k])))
            @ np.exp(-np.multiply.outer(lost[:, k], c * within))
        ).reshape(len(distances), -1)[:, : times.size]
        for k in range(lost.shape[1])
    ]
    return np.asarray(np.stack(of_bands, axis=1) * (c / (len(hits) * room.volume)))


_NODES = 6
_PORTS = 5
# Per mean free path. Fewer samples change T at alpha = 0.3 by more than one JND
# (test_the_lowest_sampling_rate_has_the_right_t20).
_LEAST_SAMPLES = 10
# Port j of node k leads to node j if j < k, else to node j + 1: no line joins a node to itself.
_NEIGHBOUR = np.array([[j + (j >= k) for j in range(_PORTS)] for k in range(_NODES)])


class Network(NamedTuple):
    """Delays in samples and lengths in m of the delay network of one source-receiver pair.

    ``lines`` and ``line_lengths`` (6, 5) are those from node to node, ``source_delays`` and
    ``source_lengths`` (6,) those from the source to the nodes, and ``tap_delays`` and ``tap_lengths``
    (6,) those from the nodes to the receiver.
    """

    lines: NDArray[np.int64]
    line_lengths: Array
    source_delays: NDArray[np.int64]
    source_lengths: Array
    tap_delays: NDArray[np.int64]
    tap_lengths: Array
    direct_delay: int
    direct_length: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ScatteringDelayNetwork(ShoeboxSimulator):
    """Simulator of a shoebox by a scattering delay network (SDN), which gives impulse responses.

    Each wall has a node, which scatters the waves p+ from its five neighbours and p_S from the source:

        p- = beta (A (p+ + p_S / 2)),   A = (2/5) 1 1' - I,   beta = sqrt(1 - alpha).

    The receiver gets (2/5) sum p-. The gain is 1/d from the source to a node,
    1/(1 + d_nr/d_sn) from a node to the receiver, 1 between nodes, and 1/d along the line of sight.
    Air attenuates every line by exp(-m d / 2). Delays are d fs / c, rounded so that first-order
    reflections arrive within half a sample.

    At high absorption few arrivals determine T20, which then depends on the positions: average at least
    four positions, or leave the line of sight out.

    The method is covered by US patent 8,908,875 B2 (De Sena, Hacihabiboglu, Cvetkovic; granted
    2014). Its use in a product may need a licence.

    Parameters
    ----------
    room : Room
        Room with dimensions, and with one material or a surface for each of its six walls
        (`ShoeboxSimulator` has the rules).
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room.
    sampling_rate : float
        Sampling rate in Hz. Delays are whole samples, so that the mean free path 4V/S must have at
        least 10 samples.
    line_of_sight : bool
        Whether the response contains the direct sound.
    longest : float
        Longest response in s. Responses are as long as T20 needs, up to this limit.

    Raises
    ------
    DataError
        If the room is no shoebox, an area differs from that of the walls by over 1 %, a position is
        outside the room or at another one, or the sampling rate is too low.

    References
    ----------
    E. De Sena, H. Hacihabiboglu, Z. Cvetkovic, J. O. Smith: Efficient synthesis of room acoustics
    via scattering delay networks. IEEE/ACM Trans. Audio Speech Lang. Process. 23(9), 2015.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=105, materials=["all"], areas=[142], alpha=[[0.3]],
    ...             sigma=[[0.1]], centre_frequencies=[1000], dimensions=(5, 7, 3))
    >>> sdn = ScatteringDelayNetwork(
    ...     room=room, sources={"S": (4.5, 3.5, 2)}, receivers={"R": (2, 2, 1.5)})
    >>> print(sdn.simulate(room.alpha).mean("t20").round(2))
    [0.46]
    """

    sampling_rate: float = 44100.0
    line_of_sight: bool = True
    longest: float = 20.0
    networks: tuple[Network, ...] = field(init=False)

    def __post_init__(self) -> None:
        for name, unit in (("sampling_rate", "Hz"), ("longest", "s")):
            checks.positive(name, getattr(self, name), unit)
        checks.flag("line_of_sight", self.line_of_sight)
        super().__post_init__()
        rate = self.sampling_rate / self.room.speed_of_sound
        if (least := _LEAST_SAMPLES / self.mean_free_path) > rate * (1 + 1e-9):
            raise DataError(
                f"sampling_rate = {self.sampling_rate:g} Hz is too low: at least "
                f"{least * self.room.speed_of_sound:.0f} Hz are needed for {_LEAST_SAMPLES} "
                "samples along this room's mean free path"
            )
        positions = product(self.box.sources, self.box.receivers)
        networks = (_network(self.box.dimensions, s, r, rate) for s, r in positions)
        put(self, networks=tuple(networks))

    @property
    def name(self) -> str:
        """Name of the simulator with the settings that change T; coefficients are valid only for it."""
        return f"scattering delay network ({self.sampling_rate:g} Hz)"

    @property
    def mean_free_path(self) -> float:
        """Mean free path 4V/S of the room in m."""
        return 4 * self.room.volume / self.room.total_area

    def impulse_responses(self, alpha: Array, duration: float) -> Array:
        """Return pressure impulse responses from the emission on, (n_pairs, n_bands, n_samples).

        ``alpha`` (n_materials, n_bands) are the coefficients. ``duration`` is in s, at most
        ``longest``. The response of a band is that of walls with the band's coefficients, and is not
        filtered. Raises DataError for a longer ``duration``.
        """
        alpha = check_alpha(self, alpha)
        if checks.positive("duration", duration, "s") > self.longest:
            raise DataError(
                f"duration = {duration:g} s must be at most longest = {self.longest:g} s"
            )
        n = max(int(np.ceil(duration * self.sampling_rate)), 1)
        reflection = np.sqrt(1 - alpha[self.box.walls])
        out = np.empty((len(self.networks), alpha.shape[1], n))
        for response, network in zip(out, self.networks, strict=True):
            self._render(network, reflection, response)
        return out

    def decays(self, alpha: Array) -> tuple[Array, float]:
        """Return energy decays for coefficients ``alpha``, and the width of their time bins in s.

        The decays are (n_pairs, n_bands, n_bins) in 1/m² for a source of unit energy, from the
        direct sound on, with one bin per sample. They are long enough for T20, but not longer than
        ``longest``. ``alpha`` is (n_materials, n_bands).
        """
        # T20 needs two thirds of Eyring's T in the most reverberant band, after the first delay.
        delays = [network.direct_delay for network in self.networks]
        t = Eyring().time(self.room, self.room.areas @ check_alpha(self, alpha)).max()
        duration = min(max(float(t), 0.1) + max(delays) / self.sampling_rate, self.longest)
        while True:
            responses = self.impulse_responses(alpha, duration)
            n = responses.shape[2] - max(delays)
            onsets = zip(responses, delays, strict=True)
            energy = np.stack([r[:, delay : delay + n] for r, delay in onsets]) ** 2
            if duration >= self.longest or not TARGET.too_short(energy).any():
                return energy / (4 * np.pi), 1 / self.sampling_rate
            duration = min(1.6 * duration, self.longest)

    def _render(self, network: Network, reflection: Array, out: Array) -> None:
        """Write one pair's responses, (n_bands, n_samples)."""
        from rtcal.simulators import kernels

        half = self.room.air_attenuation / 2
        lines = np.exp(-half * network.line_lengths[..., np.newaxis])
        source = network.source_lengths[:, np.newaxis]
        tap = network.tap_lengths[:, np.newaxis]
        injected = np.exp(-half * source) / source
        heard = np.exp(-half * tap) / (1 + tap / source)
        out[:] = kernels.blocks(
            network.lines,
            network.source_delays,
            network.tap_delays,
            lines,
            reflection,
            injected,
            heard,
            out.shape[1],
        )
        if self.line_of_sight and network.direct_delay < out.shape[1]:
            r = network.direct_length
            out[:, network.direct_delay] += np.exp(-half * r) / r


def _network(dimensions: Array, source: Array, receiver: Array, rate: float) -> Network:
    """Place the nodes of one pair on the walls; ``rate`` in samples per m."""
    nodes = np.empty((_NODES, 3))
    for wall in range(_NODES):
        axis, far = divmod(wall, 2)
        plane = dimensions[axis] if far else 0.0
        to_source, to_receiver = abs(source[axis] - plane), abs(receiver[axis] - plane)
        share = to_source / (to_source + to_receiver)
        nodes[wall] = source + share * (receiver - source)
        nodes[wall, axis] = plane
    between = np.linalg.norm(nodes[:, np.newaxis] - nodes, axis=-1)
    lengths = np.take_along_axis(between, _NEIGHBOUR, axis=1)
    from_source = np.linalg.norm(nodes - source, axis=1)
    from_nodes = np.linalg.norm(nodes - receiver, axis=1)
    direct = float(np.linalg.norm(receiver - source))
    source_delays = np.rint(rate * from_source).astype(np.int64)
    first_order_delays = np.rint(rate * (from_source + from_nodes)).astype(np.int64)
    made = Network(
        lines=np.maximum(np.rint(rate * lengths).astype(np.int64), 1),
        line_lengths=lengths,
        source_delays=source_delays,
        source_lengths=from_source,
        tap_delays=first_order_delays - source_delays,
        tap_lengths=from_nodes,
        direct_delay=int(np.rint(rate * direct)),
        direct_length=direct,
    )
    for values in made[:6]:
        values.setflags(write=False)
    return made
