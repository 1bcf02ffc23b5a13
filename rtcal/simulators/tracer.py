"""Base of the tracers: geometry, sources, scattering in, energy decays with their noise out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import decay
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import OFF_VOLUME
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import OBSERVABLES, TARGET, DecaySlope
from rtcal.acoustics.room import Room
from rtcal.simulators.base import RoomSimulator, check_alpha
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

ScatteringModel = Literal["random", "vector"]
"""How a wall with the scattering coefficient s reflects a path.

``"random"``: with probability s in a random direction after Lambert's law, else specularly (Heinz
1993; Vorlaender 2008, Sect. 11.3). ``"vector"``: along s·Lambert + (1 - s)·specular, both unit
vectors (Christensen & Rindel 2005, Forum Acusticum; also pyroomacoustics). The two models agree at
s = 0 and s = 1 only.
"""


LONGEST = 60.0
"""Longest decay in s that a tracer follows. A decay that then holds no T20 is a `TooShortError`.

It holds the T20 of a reverberation time of 144 s. The longest that was measured is 112 s (Inchindown
oil tank, 125 Hz; Cox 2014). At 343 m/s a path of 60 s has 5,100 reflections in 300 m³, whose mean free
path is 4 m: 80 MB for 8000 paths. Memory grows in proportion."""

RADIUS_SHARE = 0.075
"""A receiver's default radius over the cube root of the volume: 0.5 m in 300 m³, 1.6 m in 10,000 m³."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tracer(RoomSimulator, ABC):
    """A simulator that follows rays or paths through a `Polyhedron`, in independent batches.

    The parameters are described by `PathTracing` and `RayTracing`.
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Any]
    receivers: Mapping[str, Any]
    scattering: Any = None
    radius: float | None = None
    bin_width: float = 0.002
    n_batches: int = 8
    deterministic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("geometry", self.geometry, Polyhedron)
        for kind in ("sources", "receivers"):
            points = checks.mapped(kind, getattr(self, kind))
            self.geometry.require_inside(kind[:-1], points)
            places = {str(name): tuple(map(float, point)) for name, point in points.items()}
            object.__setattr__(self, kind, places)
        checks.whole("n_batches", self.n_batches, 1)
        decay.bins(self.bin_width)
        if self.radius is not None:
            checks.positive("radius", self.radius, "m")
        check_walls(self.geometry, self.room)
        scattering = scattering_coefficients(self.room, self.scattering)
        object.__setattr__(self, "scattering", scattering)

    @property
    def notes(self) -> tuple[str, ...]:
        """Areas that the geometry contradicts."""
        doubt = area_doubt(self.geometry, self.room)
        return (doubt,) if doubt else ()

    def _check_batches(self, name: str, number: int) -> None:
        """Raise DataError unless ``number`` rays or paths fill at least two batches."""
        checks.whole(name, number, 1)
        if self.n_batches < 2 or number < self.n_batches:
            raise DataError(
                f"{name} = {number} in n_batches = {self.n_batches}: the noise needs at least two "
                "batches, with one or more in each"
            )

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of source and receiver of each pair, source by source."""
        return tuple((s, r) for s in self.sources for r in self.receivers)

    @abstractmethod
    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays, (n_batches, n_sources, n_receivers, n_bands, n_bins), in 1/m².

        DataError for ``seconds`` above `LONGEST`.
        """

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the parameters of a response for alpha (n_materials, n_bands), by pair.

        The uncertainty of EDT, T20, C50 and C80 is the standard error that tracing causes. The
        decay is traced for longer until it holds T20.

        Raises
        ------
        DataError
            For an alpha that is not (n_materials, n_bands) or not in [0, 1], or a negative seed.
        TooShortError
            If a decay of `LONGEST` does not hold T20.
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

    def _radii(self) -> Array:
        """Return each receiver's radius in m, at most its distance from the nearest wall."""
        radius = self.radius or RADIUS_SHARE * self.geometry.volume ** (1 / 3)
        return np.minimum(radius, self.geometry.wall_distance(self._points()[1]))

    def bands_of_paths(self) -> list[NDArray[np.int64]]:
        """Return the bands' numbers in groups whose paths carry the same energy but for absorption."""
        return equal_columns(self.scattering)


def equal_columns(rows: Array) -> list[NDArray[np.int64]]:
    """Return the numbers of the columns in groups that are equal, (n_rows, n_columns)."""
    columns, group = np.unique(rows, axis=1, return_inverse=True)
    return [np.asarray(np.flatnonzero(group.reshape(-1) == g)) for g in range(columns.shape[1])]


def of_all_bands(groups: Sequence[NDArray[np.int64]], decays: Sequence[Array]) -> Array:
    """Return decays of groups of bands, (..., n_bands, n_bins), as those of all bands.

    They have as many bins as every group has.
    """
    n_bins = min(group.shape[-1] for group in decays)
    out = np.empty((*decays[0].shape[:-2], sum(map(len, groups)), n_bins))
    for bands, group in zip(groups, decays, strict=True):
        out[..., bands, :] = group[..., :n_bins]
    return out


def check_seconds(seconds: float) -> float:
    """Return the length of a decay in s; DataError unless it is above 0 and at most `LONGEST`."""
    if checks.positive("seconds", seconds, "s") > LONGEST:
        raise DataError(
            f"seconds = {seconds:g} s is above {LONGEST:g} s, the longest decay that is traced"
        )
    return seconds


def check_walls(geometry: Polyhedron, room: Room) -> None:
    """Raise DataError for a wall material that the room lacks, or a volume off by `OFF_VOLUME`."""
    room.material_rows(geometry.materials)
    if doubt := volume_doubt(geometry, room):
        raise DataError(doubt)


def volume_doubt(geometry: Polyhedron, room: Room) -> str:
    """Return what is said of a volume that differs by more than `OFF_VOLUME`; "" of none."""
    if abs(room.volume / geometry.volume - 1) <= OFF_VOLUME:
        return ""
    return (
        f"room: volume = {room.volume:g} m³, but the geometry holds {geometry.volume:g} m³; they "
        f"may differ by at most {100 * OFF_VOLUME:.0f} %"
    )


def area_doubt(geometry: Polyhedron, room: Room) -> str:
    """Return what is said of areas that differ by more than `OFF_VOLUME` in a geometry; "" of none.

    Of materials that the geometry lacks, such as small objects, nothing is said.
    """
    rows = np.array(room.material_rows(geometry.materials))
    own = np.bincount(rows, geometry.face_areas, room.n_materials)
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
    """Return read-only scattering coefficients (n_materials, n_bands), by default the room's."""
    shape = (room.n_materials, room.n_bands)
    if scattering is None:
        if room.scattering is None:
            raise DataError(
                f'room "{room.name}" states no scattering coefficients; give scattering=NUMBER'
            )
        return room.scattering
    values = checks.array("scattering", scattering)
    try:
        values = np.broadcast_to(values[:, np.newaxis] if values.ndim == 1 else values, shape)
    except ValueError as error:
        raise DataError(
            f"scattering: {error}; it is a number, (n_materials,) or (n_materials, n_bands) = {shape}"
        ) from error
    if (outside := ~((values >= 0) & (values <= 1))).any():
        i, k = (int(v) for v in np.argwhere(outside)[0])
        raise DataError(f"{room.place('scattering', i, k)} = {values[i, k]:g} is not in [0, 1]")
    return read_only(values)


def jackknife(estimate: Callable[[Array], Array], batches: Array) -> Array:
    """Return the standard error of ``estimate(mean over batches)``; batches on axis 0.

    Leave-one-out (Efron & Stein 1981): sqrt((n - 1)/n sum (estimate_i - mean)²). The standard error is
    NaN, that is unknown, if an estimate without one of the batches is not finite.
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
    """Return the parameters of energy decays in batches, (n_batches, n_pairs, n_bands, n_bins).

    The parameters belong to the mean over batches. The uncertainty of EDT, T20, C50 and C80 is the
    batches' jackknife standard error.
    """
    noise = {
        key: jackknife(partial(o.value, bin_width=bin_width), energy)
        for key, o in OBSERVABLES.items()
        if o.shown
    }
    return decay.measurement(
        energy.mean(axis=0), bin_width, centre_frequencies, pairs, uncertainty=noise
    )


def eyring_seconds(room: Room, alpha: Array) -> float:
    """Return the longest of Eyring's T over the bands in s, from 0.2 to `LONGEST`."""
    return float(np.clip(np.max(Eyring().time(room, room.areas @ alpha)), 0.2, LONGEST))


def decay_long_enough(
    trace: Callable[[float], Array],
    room: Room,
    alpha: Array,
    parameter: DecaySlope = TARGET,
    most: float = LONGEST,
) -> Array:
    """Return ``trace(seconds)``, (n_batches, ...), with seconds doubled until it holds the parameter.

    Starts with Eyring's T for alpha, and stops at ``most``.
    """
    most = min(most, LONGEST)
    seconds = min(eyring_seconds(room, alpha), most)
    while True:
        energy = trace(seconds)
        if seconds >= most or not parameter.too_short(energy.mean(axis=0)).any():
            return energy
        seconds = min(2 * seconds, most)
