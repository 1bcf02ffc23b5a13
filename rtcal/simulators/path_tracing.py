"""Path tracing as a simulator: the paths are traced once, every alpha weighs them anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rtcal.acoustics import decay
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.simulators import energies, paths
from rtcal.simulators.base import check_alpha
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.types import Array

RADIUS_SHARE = 0.075
"""A receiver's default radius over the cube root of the volume: 0.5 m in 300 m³, 1.6 m in 10,000."""
OFF_VOLUME = 0.1
"""Share by which the room's volume may differ from the geometry's, as a case's from its dimensions':
plans are no better, T is proportional to it, and beyond that one of the two is another room's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PathTracing:
    """Traces paths in a room with plane walls; any alpha re-weights the paths of the last seed.

    Parameters
    ----------
    geometry : Polyhedron
    room : Room
        Whose materials and bands the rows and columns of alpha are; its air attenuates.
    sources, receivers : mapping of str to (x, y, z)
        In m, inside the room. Sources radiate alike in all directions.
    n_paths : int
        Per source. T20 over four receivers of a 334 m³ hall then has a noise of about 1 %.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        Scattering coefficients; the room's if not given. Bands with the same ones share paths.
    meaning : {"random", "vector"}
        What they mean; see `rtcal.simulators.paths.Scattering`. In long or flat rooms the two give
        different decays.
    radius : float, optional
        Of the receivers in m; `RADIUS_SHARE` of the cube root of the volume if not given. Both are
        cut to the distance to the nearest wall. The mean energy does not depend on it, its noise
        does.
    bin_width : float
        Of the energy decays in s, at most 0.01.
    n_batches : int
        Independent parts that the noise is estimated from.
    workers : int, optional
        Threads; as many as there are processors if not given.

    Raises
    ------
    DataError
        For points outside the room, walls that are not the room's or hold another volume (by over
        `OFF_VOLUME`), coefficients outside [0, 1], numbers that do not fit.

    Notes
    -----
    Calibrated coefficients belong to the simulator and to its meaning of scattering: another one
    needs others for the same T. `rtcal.simulators.paths` has the method, docs/path_tracing.md what
    it leaves out.

    Examples
    --------
    >>> from rtcal.datasets import halls
    >>> hall = halls.corridor()
    >>> tracer = PathTracing(geometry=hall.geometry, room=hall.room, sources=hall.sources,
    ...                      receivers=hall.receivers, n_paths=320)
    >>> tracer.simulate(hall.room.alpha, seed=1).values["t20"].shape
    (4, 7)
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Any]
    receivers: Mapping[str, Any]
    n_paths: int = 8000
    scattering: Any = None
    meaning: paths.Scattering = "random"
    radius: float | None = None
    bin_width: float = 0.002
    n_batches: int = 16
    workers: int | None = None
    deterministic: bool = field(default=False, init=False)
    smooth: bool = field(default=True, init=False)
    _kept: dict[tuple[int, int], paths.Paths] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        checks.instance("room", self.room, Room)
        checks.instance("geometry", self.geometry, Polyhedron)
        for kind in ("sources", "receivers"):
            points = getattr(self, kind)
            self.geometry.require_inside(kind[:-1], points)
            put(kind, {str(name): tuple(map(float, point)) for name, point in points.items()})
        if self.meaning not in ("random", "vector"):
            raise DataError(f'meaning = "{self.meaning}" is not "random" or "vector"')
        for name in ("n_paths", "n_batches", "workers"):
            if name != "workers" or self.workers is not None:
                checks.whole(name, getattr(self, name), 1)
        if self.n_batches < 2 or self.n_paths < self.n_batches:
            raise DataError(
                f"n_paths = {self.n_paths} in n_batches = {self.n_batches}: at least two batches "
                "with a path each are needed to tell the noise"
            )
        decay.bins(self.bin_width)
        if self.radius is not None:
            checks.positive("radius", self.radius, "m")
        check_walls(self.geometry, self.room)
        put("scattering", scattering_coefficients(self.room, self.scattering))

    @property
    def name(self) -> str:
        """What calibrated coefficients belong to."""
        return f"path tracing of {self.room.name} ({self.meaning} scattering)"

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials: rows of alpha."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """The room's bands in Hz: columns of alpha."""
        return self.room.centre_frequencies

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return EDT, T20, T30, C50, C80, D50 and Ts for alpha (n_materials, n_bands).

        T20 and its fellows carry the noise of the paths as their uncertainty. Paths are traced
        where this seed has none yet, or too short ones.
        """
        alpha = check_alpha(self, alpha)
        energy = energies.decay_long_enough(
            lambda seconds: self.energy(alpha, seconds, seed=seed), self.room, alpha
        )
        pairs = [(s, r) for s in self.sources for r in self.receivers]
        flat = energy.reshape(len(energy), len(pairs), *energy.shape[3:])
        return energies.measurement(flat, self.bin_width, self.centre_frequencies, pairs)

    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays, (n_batches, n_sources, n_receivers, n_bands, n_bins), 1/m².

        By `bin_width` from the first sound on, of a source of unit energy; see
        `rtcal.simulators.paths.Paths.energy`. At least ``seconds`` long, less the first sound.
        """
        alpha = check_alpha(self, alpha)
        columns, group = np.unique(self.scattering, axis=1, return_inverse=True)
        parts: list[tuple[Any, Array]] = []
        for g in range(columns.shape[1]):
            bands = np.flatnonzero(group.reshape(-1) == g)
            traced = self.traced(int(bands[0]), seconds, seed=seed)
            parts.append(
                (
                    bands,
                    traced.energy(
                        alpha[:, bands],
                        self.room.air_attenuation[bands],
                        self.room.speed_of_sound * self.bin_width,
                    ),
                )
            )
        n_bins = min(part.shape[-1] for _, part in parts)
        energy = np.empty((*parts[0][1].shape[:3], self.room.n_bands, n_bins))
        for bands, part in parts:
            energy[:, :, :, bands] = part[..., :n_bins]
        return energy

    def traced(self, band: int, seconds: float, *, seed: int = 0) -> paths.Paths:
        """Return the paths that a band is heard by, ``seconds`` long or longer.

        The paths of one seed are kept; another seed's replace them.
        """
        checks.whole("seed", seed, 0)
        longest = checks.positive("seconds", seconds, "s") * self.room.speed_of_sound
        columns = [tuple(column) for column in self.scattering.T]
        key = (seed, columns.index(columns[band]))
        if key not in self._kept or self._kept[key].longest < longest:
            if any(other != seed for other, _ in self._kept):
                self._kept.clear()
            self._kept[key] = self._trace(self.scattering[:, band], longest, seed)
        return self._kept[key]

    def _trace(self, scattering: Array, longest: float, seed: int) -> paths.Paths:
        receivers = np.array(list(self.receivers.values()))
        radius = self.radius or RADIUS_SHARE * self.geometry.volume ** (1 / 3)
        return paths.trace(
            self.geometry,
            np.array(list(self.sources.values())),
            receivers,
            materials=np.array([self.room.material_index(m) for m in self.geometry.materials]),
            scattering=scattering,
            radii=np.minimum(radius, self.geometry.wall_distance(receivers)),
            longest=longest,
            n_paths=self.n_paths,
            n_batches=self.n_batches,
            meaning=self.meaning,
            seed=seed,
            workers=self.workers,
        )


def check_walls(geometry: Polyhedron, room: Room) -> None:
    """Refuse walls of materials that the room has not, or that hold another volume than it states."""
    for material in geometry.materials:
        room.material_index(material)
    if abs(room.volume / geometry.volume - 1) > OFF_VOLUME:
        raise DataError(
            f"room: volume = {room.volume:g} m³, but the geometry holds {geometry.volume:g} m³; they "
            f"differ by at most {100 * OFF_VOLUME:.0f} %"
        )


def scattering_coefficients(room: Room, scattering: Any) -> Array:
    """Return scattering coefficients (n_materials, n_bands), the room's if none are given."""
    shape = (room.n_materials, room.n_bands)
    if scattering is None:
        if room.scattering is None:
            raise DataError(
                f'room "{room.name}" states no scattering coefficients, and none were given'
            )
        return room.scattering
    try:
        given = np.array(scattering, dtype=float)
        given = np.broadcast_to(given[:, np.newaxis] if given.ndim == 1 else given, shape)
    except (TypeError, ValueError) as error:
        raise DataError(
            f"scattering: {error}; it is a number, (n_materials,) or (n_materials, n_bands) = "
            f"{shape}"
        ) from error
    if (bad := ~((given >= 0) & (given <= 1))).any():
        i, k = (int(v) for v in np.argwhere(bad)[0])
        raise DataError(f"{room.place('scattering', i, k)} = {given[i, k]:g} is not in [0, 1]")
    return given.copy()
