"""Path tracing: sound paths in a polyhedron are traced once per seed, and weighed for any alpha.

The walls that a path hits do not depend on their absorption. A path is therefore stored as the
sequence of faces it hits and receivers that hear it. A receiver hears the energy

    E = w product over hits (1 - alpha) exp(-m L),

where L is the length travelled, m the attenuation of air, and w the path's share of the source energy
per cross-section of the receiver. The same paths give E for every alpha, band and air. A path that hit
material j n times has dE / d alpha_j = -n E / (1 - alpha_j), so they give the derivatives too.

`Tracer` is the base of both tracers: geometry, sources and scattering in, energy decays with their
noise out.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import observables
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import OFF_VOLUME
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, OBSERVABLES, TARGET, DecaySlope, gradients, longest
from rtcal.acoustics.room import Directivity, Room, directivities
from rtcal.simulators import base
from rtcal.simulators.base import Observations, RoomSimulator, check_alpha
from rtcal.simulators.geometry import Polyhedron, first_hit
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import thread_pool
from rtcal.support.text import rounded
from rtcal.support.types import Array, put, read_only

ScatteringModel = Literal["random", "vector"]
"""Model of the reflection of a path at a wall with the scattering coefficient s.

``"random"``: with probability s in a random direction after Lambert's law, else specular (Heinz
1993; Vorlaender 2008, Sect. 11.3). ``"vector"``: along s·Lambert + (1 - s)·specular, both unit
vectors (Christensen & Rindel 2005, Forum Acusticum; also pyroomacoustics). The two models agree only
for s = 0 and s = 1.
"""


LONGEST = 60.0
"""Longest decay in s that is traced. It gives T20 up to a reverberation time of 144 s.

A longer decay raises `TooShortError`. The longest measured T is 112 s (Inchindown oil tank, 125 Hz; Cox
2014). In 300 m³ a path of 60 s has 5,100 reflections, so that 8000 paths take 80 MB of memory."""

RADIUS_SHARE = 0.075
"""Default radius of a receiver over the cube root of the volume: 0.5 m in 300, 1.6 m in 10,000 m³."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tracer(RoomSimulator, ABC):
    """Base of simulators that trace rays or paths through a `Polyhedron`, in independent batches.

    `PathTracing` and `RayTracing` describe the parameters. ``made_of`` (n_faces,) is, for each face,
    the row of its material in the room.

    ``geometry`` is the room's mesh. ``sources`` and ``receivers`` map names to positions (x, y, z) in
    m. ``scattering`` coefficients are by default the room's. ``radius`` is that of the receivers in m,
    and ``bin_width`` (default 0.002) that of the time bins in s. ``n_batches`` is the number of
    batches.
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Any]
    receivers: Mapping[str, Any]
    scattering: Any = None
    radius: float | None = None
    bin_width: float = 0.002
    n_batches: int = 8
    made_of: NDArray[np.int64] = field(init=False, repr=False)
    deterministic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("geometry", self.geometry, Polyhedron)
        of_kinds = {k: checks.mapped(k, getattr(self, k)) for k in ("sources", "receivers")}
        self.geometry.positions(**of_kinds)
        for kind, points in of_kinds.items():
            places = {str(name): tuple(map(float, point)) for name, point in points.items()}
            put(self, **{kind: places})
        checks.whole("n_batches", self.n_batches, 1)
        observables.bins(self.bin_width)
        if self.radius is not None:
            checks.positive("radius", self.radius, "m")
        put(
            self,
            made_of=check_walls(self.geometry, self.room),
            scattering=scattering_coefficients(self.room, self.scattering),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Cautions about areas of the room that differ from those of the geometry."""
        doubt = area_doubt(self.geometry, self.room)
        return (doubt,) if doubt else ()

    def _check_batches(self, name: str, number: int) -> None:
        """Raise DataError unless ``number`` rays or paths fill at least two batches."""
        checks.whole(name, number, 1)
        if self.n_batches < 2 or number < self.n_batches:
            raise DataError(
                f"{name} = {number} is too small for n_batches = {self.n_batches}: the noise "
                "estimate needs at least two batches, each with at least one ray or path"
            )

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the simulator with the settings that change T; coefficients are valid only for it."""

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of source and receiver of each pair, ordered by source."""
        return tuple((s, r) for s in self.sources for r in self.receivers)

    @abstractmethod
    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays of ``seconds`` s for coefficients ``alpha``, by batch of paths, in 1/m².

        Their shape is (n_batches, n_sources, n_receivers, n_bands, n_bins). ``alpha`` is (n_materials,
        n_bands). Raises DataError for ``seconds`` above `LONGEST`.

        ``seed`` is that of the random numbers, by default 0.
        """

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the parameters at each pair for coefficients ``alpha`` (n_materials, n_bands).

        EDT, T20, C50 and C80 have the standard uncertainty that follows from the number of paths.
        Decays are traced until they are long enough for T20. Raises TooShortError if a decay of the
        length `LONGEST` is too short for T20, DataError for a negative seed, and the errors of
        `rtcal.simulators.base.check_alpha`.
        """
        alpha = check_alpha(self, alpha)
        energy = decay_long_enough(
            lambda seconds: self.energy(alpha, seconds, seed=seed), self.room, alpha
        )
        by_pair = energy.reshape(len(energy), len(self.pairs), *energy.shape[3:])
        return measurement(by_pair, self.bin_width, self.centre_frequencies, self.pairs)

    def _points(self) -> tuple[Array, Array]:
        """Return the positions of sources and receivers in m, each (n, 3)."""
        return np.array(list(self.sources.values())), np.array(list(self.receivers.values()))

    @property
    def to_receivers(self) -> Array:
        """Vector from each source to each receiver in m, (n_sources, n_receivers, 3)."""
        sources, receivers = self._points()
        return np.asarray(receivers - sources[:, np.newaxis])

    @property
    def _alike(self) -> Array:
        """Numbers of each band, (n_numbers, n_bands), of which bands with equal ones share paths."""
        return np.asarray(self.scattering)

    @cached_property
    def bands_of_paths(self) -> list[NDArray[np.int64]]:
        """Numbers of the bands, in groups that share their paths and differ in absorption only."""
        columns, group = np.unique(self._alike, axis=1, return_inverse=True)
        return [np.flatnonzero(group.reshape(-1) == g) for g in range(columns.shape[1])]

    def _radii(self) -> Array:
        """Return each receiver's radius in m, at most its distance from the nearest wall."""
        radius = self.radius or RADIUS_SHARE * self.geometry.volume ** (1 / 3)
        return np.minimum(radius, self.geometry.wall_distance(self._points()[1]))


def of_all_bands(groups: Sequence[NDArray[np.int64]], decays: Sequence[Array]) -> Array:
    """Return the decays of all bands, (..., n_bands, n_bins), from those of groups of bands.

    ``groups`` has the numbers of the bands of each group, and ``decays`` the energy decays of each
    group, (..., n_bands of the group, n_bins). The result is cut to the time bins that all groups have.
    """
    n_bins = min([group.shape[-1] for group in decays])
    out = np.empty((*decays[0].shape[:-2], sum(map(len, groups)), n_bins))
    for bands, group in zip(groups, decays, strict=True):
        out[..., bands, :] = group[..., :n_bins]
    return out


def check_seconds(seconds: float) -> float:
    """Return the length of a decay in s; DataError unless it is above 0 and at most `LONGEST`."""
    if checks.positive("seconds", seconds, "s") > LONGEST:
        raise DataError(f"seconds = {seconds:g} s must be at most {LONGEST:g} s")
    return seconds


def check_walls(geometry: Polyhedron, room: Room) -> NDArray[np.int64]:
    """Return the row in the room of each face's material, (n_faces,), once both are compared.

    Raises DataError if the room lacks the material of a face, if the volumes of geometry and room
    differ by more than `OFF_VOLUME`, and for the reasons of `refuse_other_unit`.
    """
    room.refuse_pieces("a tracing")
    rows = room.material_rows(geometry.materials)
    refuse_other_unit(geometry, room)
    if doubt := volume_doubt(geometry, room):
        raise DataError(doubt)
    return read_only(rows)


_UNITS = (*(10.0**k for k in range(-6, 4)), 0.0254, 0.3048, 0.9144)
"""Lengths in m of the units that meshes are drawn in: powers of ten of a metre, inch, foot, yard."""


def refuse_other_unit(geometry: Polyhedron, room: Room) -> None:
    """Raise DataError if the room's volume or an area is that of the geometry in another unit.

    A value that differs by a power of ten counts as one in another unit, or with a wrong decimal point.
    """
    owned = _face_areas(geometry, room)
    length = float(np.cbrt(room.volume / geometry.volume))
    surface = float(room.areas[owned > 0].sum() / owned.sum())
    if abs(surface / length**2 - 1) < OFF_VOLUME < abs(length**3 - 1):
        meant = room.scene.unit * length
        near = min(_UNITS, key=lambda unit: abs(np.log(unit / meant)))
        if abs((meant / near) ** 3 - 1) < OFF_VOLUME:
            raise DataError(
                f"volume = {room.volume:.4g} m³, and the mesh has {geometry.volume:.4g} m³: with "
                f"unit = {near:g} in [geometry] both agree, and so do the areas"
            )
    sizes = [("volume", "m³", room.volume, geometry.volume)]
    sizes += [
        (f'area of "{room.materials[i]}"', "m²", float(room.areas[i]), own)
        for i, own in enumerate(owned.tolist())
    ]
    for name, unit, stated, own in sizes:
        power = round(float(np.log10(stated / own))) if stated and own else 0
        if not power or abs(stated / own / 10.0**power - 1) > OFF_VOLUME:
            continue
        raise DataError(
            f"{name} = {stated:.4g} {unit} is {10.0**power:g} times the {own:.4g} {unit} "
            "of the mesh: check its decimal point and unit"
        )


def _face_areas(geometry: Polyhedron, room: Room) -> Array:
    """Return the area of each material in a geometry, (n_materials,)."""
    rows = np.array(room.material_rows(geometry.materials))
    return np.asarray(np.bincount(rows, geometry.face_areas, room.n_materials), dtype=float)


def volume_doubt(geometry: Polyhedron, room: Room) -> str:
    """Return a sentence on a volume that differs by more than `OFF_VOLUME`; "" if it does not."""
    if abs(room.volume / geometry.volume - 1) <= OFF_VOLUME:
        return ""
    return (
        f"room: volume = {room.volume:g} m³, but the geometry has {geometry.volume:g} m³. "
        f"They may differ by at most {100 * OFF_VOLUME:.0f} %: check the volume, and the "
        "unit of the geometry"
    )


def area_doubt(geometry: Polyhedron, room: Room) -> str:
    """Return a sentence on the room's areas that differ from the geometry's by more than `OFF_VOLUME`.

    It is "" if there are none. Materials that the geometry lacks, such as small objects, do not count.
    """
    own = _face_areas(geometry, room)
    off = [i for i in np.flatnonzero(own).tolist() if abs(room.areas[i] / own[i] - 1) > OFF_VOLUME]
    if not off:
        return ""
    named = "; ".join(
        f"{room.materials[i]} has {room.areas[i]:.4g} m², but {own[i]:.4g} m² in the geometry"
        for i in off
    )
    return (
        f"room: {named}. They may differ by at most {100 * OFF_VOLUME:.0f} %: check the areas, and "
        "which side of the geometry is which"
    )


def scattering_coefficients(room: Room, scattering: Any) -> Array:
    """Return scattering coefficients (n_materials, n_bands), by default the room's, read-only."""
    shape = (room.n_materials, room.n_bands)
    if scattering is None:
        if room.scattering is None:
            raise DataError(
                f'room "{room.name}" has no scattering coefficients; give scattering=NUMBER'
            )
        return room.scattering
    values = checks.array("scattering", scattering)
    try:
        values = np.broadcast_to(values[:, np.newaxis] if values.ndim == 1 else values, shape)
    except ValueError as error:
        raise DataError(
            f"scattering: {error}; it must be a number or have shape (n_materials,) or "
            f"(n_materials, n_bands) = {shape}"
        ) from error
    place = partial(room.place, "scattering")
    checks.entries(place, values, (values >= 0) & (values <= 1), "from 0 to 1")
    return read_only(values)


def jackknife(estimate: Callable[[Array], Array], batches: Array) -> Array:
    """Return the standard error of an estimate from the mean over n independent batches.

    ``estimate`` is a function of this mean, and the first axis of ``batches`` is that of the batches.
    The error is sqrt((n - 1)/n sum (estimate_i - mean)²), where estimate_i leaves out batch i (Efron &
    Stein 1981), and NaN (unknown) if an estimate_i is not finite.
    """
    n = len(batches)
    total = batches.sum(axis=0)
    left_out = np.stack([estimate((total - batch) / (n - 1)) for batch in batches])
    left_out[~np.isfinite(left_out)] = np.nan
    spread = left_out - left_out.mean(axis=0)
    return np.asarray(np.sqrt((n - 1) / n * np.sum(spread**2, axis=0)))


def measurement(
    energy: Array, bin_width: float, centre_frequencies: Array, pairs: Sequence[tuple[str, str]]
) -> Measurement:
    """Return the room-acoustic parameters of energy decays (n_batches, n_pairs, n_bands, n_bins).

    The parameters are those of the mean decay over the batches. The uncertainty of EDT, T20, C50 and
    C80 is the standard error from the batches (`jackknife`). ``bin_width`` is in s, the frequencies are
    in Hz.
    """
    noise = {
        key: jackknife(partial(o.value, bin_width=bin_width), energy)
        for key, o in OBSERVABLES.items()
        if o.shown
    }
    return Measurement.from_decays(
        energy.mean(axis=0), bin_width, centre_frequencies, pairs, uncertainty=noise
    )


_EYRING = Eyring()


def eyring_seconds(room: Room, alpha: Array) -> float:
    """Return the longest of Eyring's T over the bands in s, from 0.2 to `LONGEST`."""
    return float(np.clip(np.max(_EYRING.time(room, room.areas @ alpha)), 0.2, LONGEST))


def decay_long_enough(
    trace: Callable[[float], Array],
    room: Room,
    alpha: Array,
    parameter: DecaySlope = TARGET,
    most: float = LONGEST,
) -> Array:
    """Return energy decays that are long enough for a parameter, (n_batches, ...).

    ``trace`` is a function that returns decays of a given length in s. The length is first Eyring's T
    for ``alpha`` (n_materials, n_bands), and is doubled until the mean decay is long enough for
    ``parameter``, but not beyond ``most`` in s.
    """
    most = min(most, LONGEST)
    seconds = min(eyring_seconds(room, alpha), most)
    while True:
        energy = trace(seconds)
        if seconds >= most or not parameter.too_short(energy.mean(axis=0)).any():
            return energy
        seconds = min(2 * seconds, most)


_LARGEST_POWER = 600.0
"""Largest ln of a factor of the energy: its product with an energy that is 0 is 0, not NaN."""


LARGEST_CODE = int(np.iinfo(np.uint16).max)
"""Largest code of an event of a path (wall hit or reception)."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Paths from one source, with their wall hits and their receptions in order.

    ``events[starts[i]:starts[i + 1]]`` are the hits and receptions of path i, as codes. The code of a
    wall hit is the number of the face, plus n_faces if the path was scattered in the model "random".
    The code of a reception is 2 n_faces plus the number of the receiver. ``lengths`` in m and
    ``weights`` in 1/m² have one value per reception. All arrays are read-only.
    """

    events: NDArray[np.uint16]
    starts: NDArray[np.int64]
    heard: NDArray[np.int64]  # number of receptions of each path
    lengths: NDArray[np.float32]
    weights: NDArray[np.float32]
    directions: Array  # (n_paths, 3), in which they left the source
    lost: int  # paths that left through a gap; they have no events
    free_paths: tuple[float, float, float]  # number, sum in m, sum of squares in m²

    def __post_init__(self) -> None:
        for values in (*self.arrays, self.heard, self.directions):
            values.setflags(write=False)

    @cached_property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Events, starts, lengths and weights, as the compiled functions take them."""
        return self.events, self.starts, self.lengths, self.weights


@dataclass(frozen=True, kw_only=True, eq=False)
class Paths:
    """Paths from every source to every receiver, in independent batches of equal size.

    `trace` returns these paths, and the methods return energies and derivatives. ``alpha``
    (n_materials, n_bands) are the coefficients, ``air_attenuation`` (n_bands,) is in 1/m, and
    ``bin_length`` in m is the width of the time bins times the speed of sound. The first bin starts
    with the first sound of a pair; bins that not all pairs have are cut off. Energy is per area, in
    1/m², for a source of unit energy, so that the direct sound is 1/(4 pi r²). The scatter of the
    batches gives the standard error.
    """

    batches: tuple[tuple[Batch, ...], ...]  # by source
    materials: NDArray[np.int64]  # number of each face's material, (n_faces,)
    scattering: Array  # (n_materials,)
    scattering_model: ScatteringModel
    n_materials: int
    n_paths: int  # per source, with those that were lost
    longest: float  # length in m to which every path is followed
    direct: (
        Array  # length of the direct sound in m, (n_sources, n_receivers), NaN where it is hidden
    )
    direct_gain: Array  # its energy over an omnidirectional source's
    first: Array  # length of the first sound in m: the direct sound, else the first path heard
    workers: int | None = None  # threads that weigh them; None for the number of processors

    def __post_init__(self) -> None:
        # The paths do not depend on alpha, so every simulation reads the same arrays.
        for name in ("materials", "scattering", "direct", "direct_gain", "first"):
            getattr(self, name).setflags(write=False)

    def aimed(self, lobes: Mapping[int, Directivity], to_receivers: Array) -> Paths:
        """Return the same paths, weighted by the directivities of the sources.

        ``lobes`` are the directivities in one band, by the number of the source. ``to_receivers``
        (n_sources, n_receivers, 3) are the directions from source to receiver.
        """
        batches, direct_gain = list(self.batches), self.direct_gain.copy()
        for s, lobe in lobes.items():
            # The gain of all paths at once: its last digits may depend on the number of directions.
            every = lobe.gain(np.concatenate([batch.directions for batch in batches[s]]))[:, 0]
            ends = np.cumsum([len(batch.directions) for batch in batches[s]])[:-1]
            made = []
            for batch, gain in zip(batches[s], np.split(every, ends), strict=True):
                by_reception = np.repeat(gain.astype(np.float32), batch.heard)
                made.append(replace(batch, weights=batch.weights * by_reception))
            batches[s] = tuple(made)
            direct_gain[s] = lobe.gain(to_receivers[s])[:, 0]
        return replace(self, batches=tuple(batches), direct_gain=direct_gain)

    def cut(self, longest: float) -> Paths | None:
        """Return the paths as if traced to the length ``longest`` in m; None if they are shorter.

        They are None, too, if some of them are lost: it is unknown where.
        """
        if longest > self.longest or self.lost_share > 0:
            return None
        return replace(self, longest=longest, first=np.minimum(self.first, longest))

    @property
    def nbytes(self) -> int:
        """Memory of all paths in bytes."""
        return sum(x.nbytes for source in self.batches for batch in source for x in batch.arrays)

    @property
    def lost_share(self) -> float:
        """Share of the paths that left through gaps between the faces."""
        lost = sum(batch.lost for source in self.batches for batch in source)
        return lost / (self.n_paths * len(self.batches))

    @cached_property
    def _kept(self) -> list[int]:
        """Numbers of each source's paths that were not lost."""
        return [self.n_paths - sum([b.lost for b in source]) for source in self.batches]

    @property
    def free_paths(self) -> tuple[float, float]:
        """Mean in m and relative variance of the free paths between two reflections.

        In a diffuse field the mean is 4V/S. The relative variance is Kuttruff's gamma².
        """
        every = np.sum([b.free_paths for source in self.batches for b in source], axis=0)
        number, total, squares = map(float, every)
        return total / number, squares / number / (total / number) ** 2 - 1

    def by_source(self, weigh: Callable[[int], Any]) -> list[Any]:
        """Return a result for each source, by its number; sources are computed in parallel."""
        with thread_pool(self.workers) as pool:
            return list(pool.map(weigh, range(len(self.batches))))

    def energy(
        self, alpha: Array, air_attenuation: Array, bin_length: float, number: int | None = None
    ) -> Array:
        """Return the energy at each receiver in 1/m², from groups of the batches.

        The energy is (number, n_sources, n_receivers, n_bands, n_bins), and its mean over the groups is
        the estimate. ``number`` is the number of groups, which must divide that of the batches; None
        for one group per batch. `Paths` describes the other arguments.
        """
        from rtcal.simulators import kernels

        log_reflection, attenuation, n_bins = self._weights(alpha, air_attenuation, bin_length)
        n_batches = len(self.batches[0])
        number = n_batches if number is None else number
        out = np.zeros((number, *self.first.shape, len(attenuation), n_bins))

        def weigh(s: int) -> None:
            weighing = log_reflection, attenuation, self.first[s], float(bin_length)
            every, each = [batch.arrays for batch in self.batches[s]], n_batches // number
            for group, heard in enumerate(out[:, s]):
                kernels.histogram(every[group * each : (group + 1) * each], weighing, heard)
            out[:, s] *= number / self._kept[s]

        self.by_source(weigh)
        out[..., 0] += self._direct_sound(attenuation)
        return out

    def gradient(
        self,
        source: int,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        number: int | None = None,
    ) -> tuple[Array, Array]:
        """Return the energies of one source in 1/m², and their derivatives by absorption or scattering.

        ``source`` is the number of the source. The energy (n_receivers, n_bands, n_bins) is the mean
        over the batches. The derivatives are (number, n_receivers, n_bins, n_materials, n_bands),
        without materials after the last that a face has. If ``number`` is None, they are by alpha,
        which must be below 1, and their first axis has the length 1. If ``number`` is given, they are
        by the log odds ln(s / (1 - s)) of each material's scattering s, for this number of independent
        groups of the batches, and 0 where s is 0 or 1. ``number`` must divide the number of batches.
        Raises DataError for a ``number`` if the scattering model is not "random". `Paths` describes the
        other arguments.

        A path that a material scattered d times and reflected r times without scattering has a
        probability proportional to s^d (1 - s)^r, so that the derivative by the log odds is its energy
        times (1 - s) d - s r (Glynn 1990, likelihood ratios).
        """
        from rtcal.simulators import kernels

        log_reflection, attenuation, n_bins = self._weights(alpha, air_attenuation, bin_length)
        batches, n_groups = self.batches[source], number or 1
        counts = np.ones(2 * len(self.materials))
        if number is not None:
            if self.scattering_model != "random":
                raise DataError(
                    f'the paths were traced with scattering_model = "{self.scattering_model}"; '
                    'derivatives by the scattering need "random"'
                )
            s = self.scattering[self.materials]
            counts = np.concatenate([-s, 1 - s])
        n_receivers, n_bands = self.first.shape[1], len(attenuation)
        n_materials = int(self.materials.max()) + 1
        energy = np.zeros((n_groups, n_receivers, n_bands, n_bins))
        gradient = np.zeros((n_groups, n_receivers, n_bins, n_materials, n_bands))
        weighing = log_reflection, attenuation, self.first[source], float(bin_length)
        materials = np.tile(self.materials, 2)
        for group in range(n_groups):
            some, out = batches[group::n_groups], (energy[group], gradient[group])
            every = [batch.arrays for batch in some]
            kernels.histogram_gradient(every, weighing, materials, counts, *out)
            kept = len(some) * self.n_paths // len(batches) - sum(batch.lost for batch in some)
            energy[group] /= kept
            gradient[group] /= kept
        energy[..., 0] += self._direct_sound(attenuation)[source]
        if number is None:
            # The kernel sums n E, n being the number of hits on the material's faces.
            gradient /= -(1 - np.asarray(alpha, dtype=float)[:n_materials])
        return energy.mean(axis=0), gradient

    def energy_changed(
        self,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        groups: NDArray[np.bool_],
        changed: Array,
    ) -> Array:
        """Return the energy at receivers in 1/m² if the coefficients of one group of materials change.

        The energy is (n_groups, n_changes, n_sources, n_receivers, n_bands, n_bins), the mean over the
        batches. ``groups`` (n_groups, n_materials) is True for the materials of a group. ``changed``
        (n_changes, n_materials, n_bands) are the coefficients, below 1, that the materials of the group
        have after each change; all other materials keep ``alpha``. The computation is fast if 1 - alpha
        changes by one factor in all materials of a group. `Paths` describes the other arguments.
        """
        weights = self._weights(alpha, air_attenuation, bin_length)
        ratio = (1 - changed) / (1 - alpha)
        alike = np.array([not np.ptp(ratio[:, held], axis=1).any() for held in groups], dtype=bool)
        out = np.empty((len(groups), len(changed), *self.first.shape, alpha.shape[1], weights[2]))
        if alike.any():
            factor = np.array([ratio[:, np.argmax(held)] for held in groups[alike]])
            held = np.tile(groups[alike][:, self.materials], 2).T
            out[alike] = self._by_hits(weights, bin_length, held, factor)
        for j in np.flatnonzero(~alike):
            for c, other in enumerate(np.where(groups[j][:, np.newaxis], changed, alpha)):
                out[j, c] = self.energy(other, air_attenuation, bin_length, number=1)[0]
        return out

    def _by_hits(
        self,
        weights: tuple[Array, Array, int],
        bin_length: float,
        held: NDArray[np.int64],
        factor: Array,
    ) -> Array:
        """Return the energies with a factor for each hit on a group; see `energy_changed`.

        ``held`` (2 n_faces, n_groups) as in the kernels, ``factor`` (n_groups, n_changes, n_bands).
        """
        from rtcal.simulators import kernels

        log_reflection, attenuation, n_bins = weights
        n_groups, n_changes, n_bands = factor.shape
        out = np.empty((n_groups, n_changes, *self.first.shape, n_bands, n_bins))
        # No path hits a group more often than it has events.
        most = max(int(np.diff(b.starts).max()) for source in self.batches for b in source)
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.arange(most + 1)[:, np.newaxis, np.newaxis] * np.log(factor)[:, np.newaxis]
        logs[:, 0] = 0.0
        powers = np.exp(np.minimum(logs, _LARGEST_POWER))

        def weigh(s: int) -> None:
            source = self.batches[s]
            heard = np.zeros((n_groups, self.first.shape[1], n_bins, n_changes, n_bands))
            weighing = log_reflection, attenuation, self.first[s], float(bin_length)
            every = [batch.arrays for batch in source]
            kernels.histogram_changed(every, weighing, held, powers, heard)
            out[:, :, s] = np.moveaxis(heard, (1, 2, 3, 4), (2, 4, 1, 3)) / self._kept[s]

        self.by_source(weigh)
        out[..., 0] += self._direct_sound(attenuation)
        return out

    def _weights(
        self, alpha: Array, air_attenuation: Array, bin_length: float
    ) -> tuple[Array, Array, int]:
        """Return ln(1 - alpha) of every wall hit's code, (2 n_faces, n_bands), m, and the n_bins."""
        alpha = np.asarray(alpha, dtype=float)
        attenuation = np.ascontiguousarray(air_attenuation, dtype=float)
        if alpha.ndim != 2 or alpha.shape != (self.n_materials, len(attenuation)):
            raise DataError(
                f"alpha has shape {alpha.shape}; it must be (n_materials, n_bands) = "
                f"({self.n_materials}, {len(attenuation)})"
            )
        with np.errstate(divide="ignore"):
            by_code = np.log1p(-alpha)[np.tile(self.materials, 2)]
        return by_code, attenuation, max(int((self.longest - self.first.max()) / bin_length), 1)

    def _direct_sound(self, attenuation: Array) -> Array:
        """Return the direct sound's energy, (n_sources, n_receivers, n_bands); 0 where hidden."""
        length = self.direct[..., np.newaxis]
        gain = self.direct_gain[..., np.newaxis]
        return np.nan_to_num(gain * np.exp(-attenuation * length) / (4 * np.pi * length**2))


MOST_LOST = 0.01
"""Largest share of paths that may leave through gaps between the faces; these paths are left out.

Surveyed meshes have gaps: in CR2 of BRAS (503 triangles) 1 to 2 of 8000 paths are lost. A path has some
100 reflections during T20, so that 1 % are lost through gaps of 1/10,000 of the surface, which would
change a mean alpha by 0.0001. Through a missing face far more are lost."""


MOST_LEAKED = 0.02
"""Largest share of paths that may leave through the holes of a geometry with ``leaks``; they are left
out. 2 % leave through 1/5,000 of the surface."""


_LARGEST_ALPHA = 0.99
"""Largest mean alpha that is printed as one with which a mesh can be traced; no room has it."""


class Chords(NamedTuple):
    """Estimates of volume and surface of a geometry with holes, from rays between its walls.

    ``volume`` in m³ and ``area`` in m² include the parts that the holes cut off, and have standard
    uncertainties. ``lost`` is the share of the rays that leave through holes.
    """

    volume: float
    volume_uncertainty: float
    area: float
    area_uncertainty: float
    lost: float

    @property
    def least_alpha(self) -> float:
        """Least mean alpha of a room at which at most `MOST_LEAKED` of the paths leave through holes.

        A path is followed until its energy has fallen by 60 dB. By Eyring's equation this takes
        ln(10⁻⁶) / ln(1 - alpha) reflections, 130 at alpha = 0.1. The share of rays that leave counts
        with its standard uncertainty.
        """
        lost = self.lost + self.area_uncertainty / self.area
        if lost == 0:
            return 0.0
        return 1 - 10 ** (-6 * math.log1p(-min(lost, 1 - 1e-9)) / math.log1p(-MOST_LEAKED))

    def __str__(self) -> str:
        head = (
            f"by rays V = {rounded(self.volume, 4)} ± {rounded(self.volume_uncertainty, 2)} m³, S = "
            f"{rounded(self.area, 4)} ± {rounded(self.area_uncertainty, 2)} m²; "
            f"{100 * self.lost:.2g} % of the rays leave through holes, and of the paths of a tracing "
        )
        if self.least_alpha > _LARGEST_ALPHA:
            return (
                f"{head}more than {100 * MOST_LEAKED:g} %, whatever the absorption coefficients: the "
                "mesh cannot be traced"
            )
        return (
            f"{head}at most {100 * MOST_LEAKED:g} % where the mean alpha of the room is at least "
            f"{self.least_alpha:.2g} in every band"
        )


def by_chords(geometry: Polyhedron, number: int = 100_000, seed: int = 0) -> Chords:
    """Return estimates of volume and surface of a geometry with holes, from rays between its faces.

    ``number`` rays start evenly on the faces, in directions by Lambert's law with random numbers of
    this ``seed``, so that their mean length is 4 V / S (Kuttruff 2009, Eq. 5.4). The share of rays that
    leave is the area of the holes over that of the faces, if no hole is seen from another. Rays that
    leave count with the mean length of all other rays, and with its standard deviation as uncertainty.

    Examples
    --------
    >>> box = Polyhedron.shoebox((5, 7, 3), "plaster")
    >>> found = by_chords(box, 20_000)
    >>> bool(abs(found.volume - 105) < 3 * found.volume_uncertainty), found.area, found.lost
    (True, 142.0, 0.0)
    """
    rng = np.random.default_rng(seed)
    a, b, c = np.moveaxis(geometry.triangles, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    chosen = rng.choice(len(areas), number, p=areas / areas.sum())
    u, v = np.sqrt(rng.random(number))[:, np.newaxis], rng.random((number, 1))
    points = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]
    inward = -geometry.normals[geometry.triangle_faces[chosen]]
    directions = inward + sphere(number, rng)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    _, length = first_hit(points, directions, *planes_of(geometry))
    met = length[np.isfinite(length)]
    lost = 1 - len(met) / number
    if not len(met):
        raise DataError(
            "the faces do not bound a room, because no ray from a face meets another "
            "face: check the mesh"
        )
    whole, mean, spread = float(areas.sum()), float(met.mean()), float(met.std())
    chance = np.sqrt(lost * (1 - lost) / number)
    return Chords(
        volume=whole * (1 + lost) * mean / 4,
        volume_uncertainty=whole
        / 4
        * float(np.hypot(spread / np.sqrt(len(met)), 2 * lost * spread)),
        area=whole * (1 + lost),
        area_uncertainty=whole * float(chance),
        lost=lost,
    )


HALVINGS = 4
"""Largest number of times that the number of paths is halved as the sound decays."""
_LEFT = 32
"""Least number of paths of a batch that are left."""


def trace(
    geometry: Polyhedron,
    sources: Array,
    receivers: Array,
    *,
    materials: NDArray[np.int64],
    scattering: Array,
    radii: Array,
    longest: float,
    n_paths: int,
    n_batches: int,
    scattering_model: ScatteringModel,
    seed: int,
    workers: int | None = None,
    thinned: float = np.inf,
) -> Paths:
    """Return ``n_paths`` paths from each source, traced in independent batches.

    A path that leaves through a gap between faces is left out, and the other paths of its source count
    more. Receivers are spheres of radius r. A path of length L without a diffuse reflection has the
    weight 1 / (L² omega), where omega is the solid angle of the sphere seen from the image source;
    every other path has the weight 1 / (pi r²). The expected energy is then that at the receiver's
    centre for any radius, unless an edge hides a part of the sphere. Direct sound is calculated.

    ``sources`` and ``receivers`` (n, 3) are inside the room, in m; ``radii`` (n_receivers,) in m are at
    most the distance to the nearest wall. ``materials`` (n_faces,) is the number of each face's
    material, and ``scattering`` (n_materials,) its coefficient. Each path is followed to the length
    ``longest`` in m. ``workers`` is the number of threads, None for that of the processors.

    The same seed gives the same paths for any ``longest`` and ``workers``. After the length ``thinned``
    in m, and after each further such length, every second path ends, until 1 in 2**`HALVINGS` or few
    paths are left. Each time the remaining paths count twice (Russian roulette, Spanier & Gelbard
    1969), so that the expected energy is the same.

    Raises DataError if more than `MOST_LOST` of the paths, or `MOST_LEAKED` in a geometry with
    ``leaks``, hit no wall, because the faces leave gaps or cut each other; also for too many faces and
    receivers.
    """
    from rtcal.simulators import kernels

    if 2 * len(materials) + len(receivers) > LARGEST_CODE:
        raise DataError(
            f"{len(materials)} faces and {len(receivers)} receivers are too many: twice the "
            f"faces plus the receivers must be at most {LARGEST_CODE}"
        )
    planes, sides = planes_of(geometry)
    together = by_plane(planes)
    by_face = np.ascontiguousarray(np.asarray(scattering, dtype=float)[materials])
    per_batch = -(-n_paths // n_batches)
    # A batch whose number of paths no power of two divides keeps a little more than its share.
    halvings = [i for i in range(HALVINGS + 1) if i == 0 or per_batch >= _LEFT * 2**i]
    shares = np.array([-(-per_batch // 2**i) / per_batch for i in halvings])

    def trace_batch(job: tuple[int, int]) -> Batch:
        s, b = job
        sequence = np.random.SeedSequence([seed, s, b])
        seeds = sequence.generate_state(per_batch, np.uint64)
        directions = sphere(per_batch, np.random.default_rng(sequence.spawn(1)[0]))
        codes, starts, heard, lengths, weights, counts = kernels.trace(
            sources[s],
            directions,
            seeds,
            float(longest),
            planes,
            *together,
            sides,
            geometry.triangle_faces,
            by_face,
            scattering_model == "vector",
            receivers,
            np.ascontiguousarray(radii, dtype=float),
            float(thinned),
            shares,
        )
        free = (float(counts[1]), float(counts[2]), float(counts[3]))
        return Batch(codes, starts, heard, lengths, weights, directions, int(counts[0]), free)

    jobs = [(s, b) for s in range(len(sources)) for b in range(n_batches)]
    with thread_pool(workers) as pool:
        done = list(pool.map(trace_batch, jobs))
    lost = sum([batch.lost for batch in done])
    most = MOST_LEAKED if geometry.leaks else MOST_LOST
    if lost > max(1, most * per_batch * len(jobs)):
        raise DataError(
            f"{lost} of {per_batch * len(jobs)} paths hit no wall, but at most "
            f"{100 * most:g} % may, because the faces of the room leave gaps or cut "
            "through each other. Repair the mesh with `rtcal import check`; or use only "
            "reverberation equations, with `rtcal import ... --open`"
        )
    batches = tuple(tuple(done[s * n_batches : (s + 1) * n_batches]) for s in range(len(sources)))
    direct = direct_lengths(geometry, sources, receivers)
    return Paths(
        batches=batches,
        materials=materials.copy(),
        scattering=np.array(scattering, dtype=float),
        scattering_model=scattering_model,
        n_materials=len(scattering),
        n_paths=per_batch * n_batches,
        longest=float(longest),
        direct=direct,
        direct_gain=np.ones(direct.shape),
        first=_first(batches, direct, 2 * len(materials), longest),
        workers=workers,
    )


def _first(
    batches: tuple[tuple[Batch, ...], ...], direct: Array, n_codes: int, longest: float
) -> Array:
    """Return the length of the first sound: direct, else first heard, else ``longest``."""
    first = direct.copy()
    for s, r in np.argwhere(np.isnan(direct)):
        heard = [b.lengths[b.events[b.events >= n_codes] == n_codes + r] for b in batches[s]]
        first[s, r] = min((float(x.min()) for x in heard if x.size), default=longest)
    return first


def planes_of(geometry: Polyhedron) -> tuple[Array, Array]:
    """Return the plane of each triangle (inward normal, offset in m) and two functions of its sides.

    A point x of the plane is in the triangle if n·x - d is 0 or more for both rows (n, d) of the
    triangle's functions, (n_triangles, 2, 4), and their sum is at most 1 (Havel & Herout 2010).
    """
    a, b, c = np.moveaxis(geometry.triangles, 1, 0)
    u, v = b - a, c - a
    normal = np.cross(u, v)
    square = np.sum(normal**2, axis=1, keepdims=True)
    rows = np.stack([np.cross(v, normal) / square, np.cross(normal, u) / square], axis=1)
    offsets = np.einsum("tij,tj->ti", rows, a)[..., np.newaxis]
    inward = -normal / np.sqrt(square)
    equations = np.hstack([inward, np.sum(inward * a, axis=1, keepdims=True)])
    return equations, np.ascontiguousarray(np.concatenate([rows, offsets], axis=2))


def by_plane(planes: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triangles' numbers ordered by plane, and the index at which each plane begins."""
    left, groups = np.arange(len(planes)), []
    while len(left):
        same = np.abs(planes[left] - planes[left[0]]).max(axis=1) < 1e-12
        groups.append(left[same])
        left = left[~same]
    return np.concatenate(groups), np.cumsum([0, *map(len, groups)])


def sphere(n: int, rng: np.random.Generator) -> Array:
    """Return n evenly spread directions (Fibonacci lattice on the sphere), rotated at random."""
    height = 1 - (2 * np.arange(n) + 1) / n
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    across = np.sqrt(1 - height**2)
    lattice = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    rotation, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    return np.ascontiguousarray(lattice @ (rotation * np.sign(np.diag(upper))))


def direct_lengths(geometry: Polyhedron, sources: Array, receivers: Array) -> Array:
    """Return the length of each direct sound in m, (n_sources, n_receivers), NaN where it is hidden."""
    walls, sides = planes_of(geometry)
    lengths = np.empty((len(sources), len(receivers)))
    for s, source in enumerate(sources):
        vectors = receivers - source
        lengths[s] = np.linalg.norm(vectors, axis=1)
        directions = vectors / lengths[s][:, np.newaxis]
        origins = np.tile(source, (len(vectors), 1))
        _, t = first_hit(origins, directions, walls, sides)
        lengths[s, t < lengths[s]] = np.nan
    return lengths


_REFLECTING = 0.7
"""Mean alpha below which enough is reflected for every parameter: 25 dB take five reflections."""
DENSER = 3
"""Factor of the number of paths in a simulation with less noise (`PathTracing.denser`). In a
development room of 200 m³ with T from 0.4 to 1.1 s this and `LARGER` leave a seventh of the noise's
variance."""
LARGER = 0.15
"""Radius of the receivers in such a simulation, over the cube root of the volume. In that room
parameters differ from those with half the radius by 0.3 % (Ts), 0.2 % (EDT), 0.03 dB (C80) and less
than 0.1 % (T20)."""
_THINNED = 0.25
"""Time after which every second path ends, over Eyring's T of the band with the longest."""

_Weighing = tuple[Array, Array, float]
"""Alpha, air attenuation and bin length, as the methods of `Paths` take them."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PathTracing(Tracer):
    """Simulator that traces paths in a room with plane walls, and reuses them for all coefficients.

    Parameters
    ----------
    geometry : Polyhedron
        Geometry whose walls have the room's materials, and whose volume is the room's within 10 %.
    room : Room
        Room with the materials, the bands, the air and the speed of sound.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room.
    directivity : mapping of str to Directivity or "unknown"
        Directivity of each source (`rtcal.io.balloon.read` reads a balloon). A source without one, or
        with an unknown one, is omnidirectional.
    n_paths : int
        Number of paths per source. With 8000 the mean T20 over four receivers of a 334 m³ hall has a
        standard error of about 1 %.
    n_batches : int
        Number of independent batches into which the paths are divided, at least 2; their spread gives
        the standard errors.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        Scattering coefficients, by default the room's. Bands with equal coefficients share their paths.
    scattering_model : {"random", "vector"}, optional
        Model of scattering at a wall, by default the room's. "random": with the probability s, the
        scattering coefficient, in a direction by Lambert's law, otherwise specular. "vector": along
        s·Lambert + (1 - s)·specular. The models give different decays in long or flat rooms.
    radius : float, optional
        Radius of the receivers in m, by default 0.075 times the cube root of the volume, but at most
        the distance of a receiver from the nearest wall. It changes the standard errors, not the
        expected energy.
    bin_width : float
        Width of the time bins of the energy decays in s, at most 0.01.
    workers : int, optional
        Number of threads; that of the processors by default.
    thinned : float, optional
        Time in s after which, and after each further such time, every second path ends and the others
        count twice, up to four times. This saves time, and leaves the expected energy as it is. By
        default no path ends before the decay.

    Raises
    ------
    DataError
        For positions outside the room, a source at a receiver, a geometry with other materials or
        another volume than the room, or a number outside its range.

    Notes
    -----
    Calibrated coefficients belong to the simulator and its scattering model, because others give
    another T. `rtcal.simulators.path_tracing` describes the method, docs/path_tracing.md its limits.

    Examples
    --------
    >>> from rtcal.datasets import halls
    >>> hall = halls.corridor()
    >>> tracer = PathTracing(geometry=hall.geometry, room=hall.room, sources=hall.sources,
    ...                      receivers=hall.receivers, n_paths=320)
    >>> tracer.simulate(hall.room.alpha, seed=1).values["t20"].shape
    (4, 7)
    """

    directivity: Mapping[str, Any] = field(default_factory=dict)
    n_paths: int = 8000
    n_batches: int = 16
    scattering_model: Any = None
    workers: int | None = None
    thinned: float | None = None
    _traced: dict[tuple[int, ...], Paths] = field(default_factory=dict, init=False, repr=False)
    _ready: dict[tuple[int, ...], Paths] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_batches("n_paths", self.n_paths)
        if self.scattering_model is None:
            put(self, scattering_model=self.room.scattering_model)
        checks.choice("scattering_model", self.scattering_model, ("random", "vector"))
        stated = directivities(self.directivity, self.sources)
        for name, of in stated.items():
            if isinstance(of, Directivity):
                if of.file is not None:
                    raise DataError(
                        f'directivity["{name}"] is a file; read it with rtcal.io.balloon.read first'
                    )
                stated[name] = of.for_bands(self.room.n_bands, f'directivity["{name}"]')
        put(self, directivity=stated)
        if self.workers is not None:
            checks.whole("workers", self.workers, 1)
        if self.thinned is not None:
            checks.positive("thinned", self.thinned, "s")

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the paths, which the seed gives: they are long to send."""
        return {**vars(self), "_traced": {}, "_ready": {}}

    @property
    def name(self) -> str:
        """Name of the simulator with the settings that change T; coefficients are valid only for it."""
        return f"path tracing of {self.room.name} ({self.scattering_model} scattering)"

    @property
    def tracing(self) -> PathTracing:
        """Tracer that makes the reference simulations of this simulator: itself."""
        return self

    @property
    def fits_scattering(self) -> bool:
        """Whether scattering can be fitted: the model is "random", and a material has 0 < s < 1."""
        return self.scattering_model == "random" and not np.isin(self.scattering, (0.0, 1.0)).all()

    @property
    def unknown_sources(self) -> tuple[str, ...]:
        """Names of the sources whose directivity is "unknown"."""
        return tuple(name for name, of in self.directivity.items() if isinstance(of, str))

    @cached_property
    def aimed_sources(self) -> dict[int, Directivity]:
        """Known directivities, by the number of the source."""
        stated = {s: self.directivity.get(name) for s, name in enumerate(self.sources)}
        return {s: of for s, of in stated.items() if isinstance(of, Directivity)}

    def trusted(self, match: Sequence[str]) -> tuple[str, ...]:
        """Return the parameters of ``match`` that can be compared with a measurement.

        ``match`` are keys of parameters, such as ``"c80"``. If the directivity of a source is
        "unknown", these are only the reverberation times: early sound and the level near a loudspeaker
        depend on its directivity, but T20 and T30 hardly do. Raises DataError if none is left.
        """
        names = base.checked_parameters(match)
        kept = tuple(n for n in names if not self.unknown_sources or OBSERVABLES[n].part == "late")
        if not kept:
            raise DataError(
                f"match has {', '.join(names)}, which depends on the directivity of a "
                "source, and that directivity is given as unknown. Give the directivity, "
                f"or leave {', '.join(names)} out"
            )
        return kept

    @property
    def notes(self) -> tuple[str, ...]:
        """Cautions about areas that differ from the geometry, and assumptions about directivities."""
        notes = [*super().notes]
        if unknown := ", ".join(self.unknown_sources):
            notes.append(
                f"The directivity of {unknown} is unknown, so only reverberation times are used: the "
                "level and early parameters depend on where a loudspeaker aims."
            )
        if taken := ", ".join(name for name in self.sources if name not in self.directivity):
            notes.append(f"Sources without a directivity are taken as omnidirectional: {taken}.")
        return tuple(notes)

    def with_air(self, air: Air) -> PathTracing:
        """Return the path tracing of the room with other air."""
        return replace(self, room=self.room.with_air(air))

    def denser(self, factor: int = 1, n_batches: int | None = None) -> PathTracing:
        """Return the path tracing with 3 times ``factor`` as many paths, and so less noise.

        With the factor 1, the default, it takes about as long as this tracing, because most paths are
        no longer followed to the end. After each quarter of Eyring's T, half of the paths end and the
        others count twice, up to four times (``thinned``). The default radius of the receivers becomes
        0.15 times the cube root of the volume. If paths end in this tracing already, the new one has
        ``factor`` times as many. ``n_batches`` is the new number of batches, by default the present
        one.
        """
        checks.whole("factor", factor, 1)
        n_batches = n_batches or self.n_batches
        if self.thinned is not None:
            if factor == 1 and n_batches == self.n_batches:
                return self
            return replace(self, n_paths=factor * self.n_paths, n_batches=n_batches)
        return replace(
            self,
            n_paths=DENSER * factor * self.n_paths,
            n_batches=n_batches,
            radius=self.radius or LARGER * self.geometry.volume ** (1 / 3),
            thinned=_THINNED * eyring_seconds(self.room, self.room.alpha),
        )

    def aimed(self, directivity: Mapping[str, Directivity]) -> PathTracing:
        """Return the path tracing with other directivities of some sources, without tracing again.

        ``directivity`` has the new directivities by the name of the source, each with a value per band.
        """
        for name, of in checks.mapped("directivity", directivity).items():
            checks.instance(f"directivity[{checks.shown(name)}]", of, Directivity)
        changed = copy(self)
        for name in ("aimed_sources", "bands_of_paths"):
            vars(changed).pop(name, None)
        # A key with a band, too, has the paths of its directivity.
        kept = {key: of for key, of in self._traced.items() if len(key) == 2}
        put(changed, _traced=kept, directivity={**self.directivity, **directivity})
        return changed

    def afresh(self) -> PathTracing:
        """Return the path tracing as if it had traced nothing, but quicker.

        The paths in memory are cut where they would have been traced anew, so that its results do not
        depend on what was simulated before.
        """
        fresh = replace(self)
        fresh._ready.update({key: of for key, of in self._traced.items() if len(key) == 2})
        return fresh

    def trace_ahead(self, alpha: Array, factor: float, *, seed: int = 0) -> None:
        """Trace paths as long as ``factor`` times Eyring's T, for later simulations with this seed.

        T is the longest of all bands for the coefficients ``alpha`` (n_materials, n_bands); the length
        is at most 60 s. A later simulation that needs longer paths traces again.
        """
        alpha = check_alpha(self, alpha)
        seconds = min(checks.positive("factor", factor) * eyring_seconds(self.room, alpha), LONGEST)
        for bands in self.bands_of_paths:
            self.traced(int(bands[0]), seconds, seed=seed)

    @property
    def lost_share(self) -> float:
        """Largest share of paths that left through gaps of the geometry, and are left out.

        The share is that of the paths in memory, and 0 before the first simulation.
        """
        return max((traced.lost_share for traced in self._traced.values()), default=0.0)

    def energy(
        self, alpha: Array, seconds: float, *, seed: int = 0, number: int | None = None
    ) -> Array:
        """Return energy decays for coefficients ``alpha`` and a source of unit energy, in 1/m².

        For each pair of source and receiver, the first bin starts when the first sound arrives: the
        direct sound or, if it is hidden, the shortest path. The mean over the groups of paths is the
        estimate.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
            Absorption coefficients.
        seconds : float
            Least time in s for which paths are followed after their emission, above 0 and at most 60.
            Longer paths in memory are used to their end. All pairs have equally many bins; the decay of
            the pair with the latest first sound ends with the paths, the others end earlier.
        seed : int
            Seed of the random numbers, by default 0.
        number : int, optional
            Number of groups into which the batches of paths are divided; it must divide ``n_batches``.
            By default each batch is a group.

        Returns
        -------
        array (number, n_sources, n_receivers, n_bands, n_bins)
            Energy in each time bin, of ``bin_width``.

        Raises
        ------
        DataError
            For ``seconds`` above 60, and for a ``number`` that does not divide ``n_batches``.
        """
        self._check_groups(1 if number is None else number)
        alpha = check_alpha(self, alpha)

        def sweep(paths: Paths, bands: NDArray[np.int64]) -> Array:
            return paths.energy(*self._weighing(alpha, bands), number)

        return self.swept(sweep, seconds, seed=seed)

    def swept(
        self, sweep: Callable[[Paths, NDArray[np.int64]], Array], seconds: float, *, seed: int = 0
    ) -> Array:
        """Return the decays of all bands, (..., n_bands, n_bins), which a function computes by group.

        Bands of one group have the same scattering, and so the same paths. ``sweep`` is called with the
        paths of a group, traced for ``seconds`` s or longer, and the numbers of its bands, from 0. It
        must return their decays, (..., n_bands of the group, n_bins). ``seed`` is that of the random
        numbers.
        """
        groups = self.bands_of_paths
        decays = [sweep(self.traced(int(b[0]), seconds, seed=seed), b) for b in groups]
        return of_all_bands(groups, decays)

    def _check_groups(self, number: int) -> None:
        """Raise DataError unless the batches can be divided into so many groups."""
        if self.n_batches % checks.whole("number", number, 1):
            raise DataError(f"number = {number} must divide n_batches = {self.n_batches}")

    def observe(
        self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0, again: bool = True
    ) -> Observations:
        """Return the parameters at each pair as `Observations`, for alpha (n_materials, n_bands).

        ``match`` are keys of the parameters. "level" is G, as of a source of known power. If ``again``
        is False, only the paths in memory are used, and TooShortError is raised if they are too short;
        otherwise longer paths are traced if necessary. Also raises the errors of `simulate`.

        ``seed`` is that of the random numbers, by default 0.
        """
        most = LONGEST
        if not checks.flag("again", again):
            lengths = [paths.longest for (of, *_), paths in self._traced.items() if of == seed]
            # Rounded down, so that no path is too short for it.
            most = min(lengths, default=np.inf) / self.room.speed_of_sound * (1 - 1e-9)
        return self._observed(alpha, match, 1, seed, most)[0]

    def observe_in_groups(
        self, alpha: Array, number: int, match: Sequence[str] = MATCH, *, seed: int = 0
    ) -> Array:
        """Return the parameters from each group of paths, (number, n_parameters, n_pairs, n_bands).

        The groups are independent, so that their differences show the noise. ``number`` is the number
        of groups, which must divide ``n_batches``. ``alpha``, ``match``, ``seed``, the scale of the
        values and the errors are those of `observe`.
        """
        return np.array([of.values for of in self._observed(alpha, match, number, seed)])

    def _observed(
        self,
        alpha: Array,
        match: Sequence[str],
        number: int,
        seed: int,
        most: float = LONGEST,
    ) -> list[Observations]:
        """Return the observations of groups of the paths, each long enough for ``match``."""
        self._check_groups(number)
        alpha, match = check_alpha(self, alpha), base.checked_parameters(match)
        # Each group is to hold the decay times, so no mean over the groups is asked.
        (groups,) = decay_long_enough(
            lambda seconds: self.energy(alpha, seconds, seed=seed, number=number)[np.newaxis],
            self.room,
            alpha,
            longest(match),
            most,
        )
        cause = "too little sound is reflected"
        if np.max(self.room.areas @ alpha) < _REFLECTING * self.room.areas.sum():
            cause = f"{self.n_paths} paths per source are too few. Take a larger n_paths"
        of_room = match, self.pairs, self.centre_frequencies, cause
        by_pair = groups.reshape(number, len(self.pairs), *groups.shape[3:])
        return [base.of_decays(energy, self.bin_width, *of_room) for energy in by_pair]

    def jacobian(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Array:
        """Return the derivatives of `observe` by alpha, (n_parameters, n_pairs, n_bands, n_materials).

        Derivatives of decay times are those of their logarithms, as in `Observations`. They follow from
        the paths, because the energy E of a path that hit material j n times has dE / d alpha_j = -n E
        / (1 - alpha_j). Coefficients above 0.999 count as 0.999. Decay times from few paths change with
        alpha in small steps, and the derivatives are those of the mean over the steps. ``alpha``,
        ``match``, ``seed`` and the errors are those of `observe`.
        """
        alpha = np.minimum(check_alpha(self, alpha), base.LARGEST_ALPHA)
        return np.asarray(self._derivatives(alpha, match, seed, Paths.gradient)[0])

    def scattering_jacobian(
        self, alpha: Array, match: Sequence[str] = MATCH, *, number: int = 2, seed: int = 0
    ) -> Array:
        """Return the derivatives of `observe` by the scattering coefficient s of each material.

        The derivatives are by the log odds ln(s / (1 - s)), and 0 for s = 0 or 1. They follow from the
        numbers of hits with and without scattering (`Paths.gradient`).

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
            Absorption coefficients.
        match : sequence of str
            Keys of the parameters, such as "t20".
        number : int
            Number of independent groups of paths, which must divide ``n_batches``.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        array (number, n_parameters, n_pairs, n_bands, n_materials)
            Derivatives from each group of paths: their mean is the estimate, and their differences show
            the noise.

        Raises
        ------
        DataError, TooShortError
            As `observe`, for a ``number`` that does not divide ``n_batches``, and if
            ``scattering_model`` is not "random".
        """
        self._check_groups(number)
        gradient = partial(Paths.gradient, number=number)
        return self._derivatives(check_alpha(self, alpha), match, seed, gradient)

    def _weighing(self, alpha: Array, bands: NDArray[np.int64]) -> _Weighing:
        """Return what the paths of some bands are weighed with."""
        bin_length = self.room.speed_of_sound * self.bin_width
        return alpha[:, bands], self.room.air_attenuation[bands], bin_length

    def _derivatives(
        self,
        alpha: Array,
        match: Sequence[str],
        seed: int,
        gradient: Callable[..., tuple[Array, Array]],
    ) -> Array:
        """Return the derivatives of `observe`, (number, n_parameters, n_pairs, n_bands, n_materials).

        ``gradient`` gives those of the energies in ``number`` groups, for paths, a source and its
        `_weighing`. Materials that no face has are 0.
        """
        match = base.checked_parameters(match)
        found: list[tuple[NDArray[np.int64], list[tuple[Array, Array]]]] = []

        def sweep(paths: Paths, bands: NDArray[np.int64]) -> Array:
            by = self._weighing(alpha, bands)
            every = paths.by_source(lambda s: gradient(paths, s, *by))
            found.append((bands, every))
            return np.stack([energy for energy, _ in every])

        def trace(seconds: float) -> Array:
            found.clear()
            return self.swept(sweep, seconds, seed=seed)[np.newaxis]

        (decays,) = decay_long_enough(trace, self.room, alpha, longest(match))
        number, n_unknowns = len(found[0][1][0][1]), self.room.n_materials
        out = np.zeros((number, len(match), *decays.shape[:3], n_unknowns))
        for bands, every in found:
            for s, (_, of_groups) in enumerate(every):
                by_energy = gradients(decays[s][:, bands], self.bin_width, match)
                for of_group, by_bin in zip(out, of_groups, strict=True):
                    by_bin = by_bin[:, : decays.shape[-1]]
                    of_group[:, s][:, :, bands, : by_bin.shape[2]] = np.einsum(
                        "prkb,rbjk->prkj", by_energy, by_bin, optimize=True
                    )
        return out.reshape(number, len(match), len(self.pairs), self.room.n_bands, n_unknowns)

    def traced(self, band: int, seconds: float, *, seed: int = 0) -> Paths:
        """Return the paths of a band, traced for ``seconds`` s or longer.

        ``band`` is the number of the band, from 0. Paths in memory are used if they are long enough and
        of the same ``seed``. Raises DataError for ``seconds`` above 60.
        """
        if checks.whole("band", band, 0) >= self.room.n_bands:
            raise DataError(
                f"band = {checks.shown(band)} must be from 0 to {self.room.n_bands - 1}"
            )
        longest = check_seconds(seconds) * self.room.speed_of_sound
        columns = [tuple(column) for column in self.scattering.T]
        key = (checks.whole("seed", seed, 0), columns.index(columns[band]))
        if key not in self._traced or self._traced[key].longest < longest:
            if any(other != seed for other, *_ in self._traced):
                self._traced.clear()
            sources, receivers = self._points()
            ready = self._ready.get(key)
            cut = None if ready is None else ready.cut(longest)
            self._traced[key] = cut or trace(
                self.geometry,
                sources,
                receivers,
                materials=self.made_of,
                scattering=self.scattering[:, band],
                radii=self._radii(),
                longest=longest,
                n_paths=self.n_paths,
                n_batches=self.n_batches,
                scattering_model=self.scattering_model,
                seed=seed,
                workers=self.workers,
                thinned=np.inf if self.thinned is None else self.thinned * self.room.speed_of_sound,
            )
        traced = self._traced[key]
        if not self.aimed_sources:
            return traced
        # As the sources' directivities in this band weigh the paths.
        aimed = self._traced.get((*key, band))
        if aimed is None or aimed.longest != traced.longest:
            lobes = {s: of.in_band(band) for s, of in self.aimed_sources.items()}
            aimed = self._traced[(*key, band)] = traced.aimed(lobes, self.to_receivers)
        return aimed

    @property
    def _alike(self) -> Array:
        """Scattering and directivities, with which the paths of a band carry its energy."""
        return np.vstack([self.scattering, *(of.pattern for of in self.aimed_sources.values())])
