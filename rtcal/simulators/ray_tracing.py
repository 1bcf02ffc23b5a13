"""pyroomacoustics' ray tracer as a simulator: an engine that shares no code with ours.

The one module that imports pyroomacoustics (extra ``geometry``). Facts about version 0.10 that
shaped it, all but the last shown by tests/test_ray_tracing.py:

- Decays come from ``rt_histograms``; ``compute_rir()`` would add Poisson noise and filters.
- ``set_air_absorption`` acts on the impulse response only and never reaches the histograms, and its
  own table is coarse: the histograms are weighted with exp(-m c t), m after ISO 9613-1, here.
- ``energy_thres`` is 1e-16; the default 1e-7 cuts the tail off.
- Ray directions are a fixed lattice. Every batch of rays is therefore traced in a room that is
  turned at random, so that batches are independent and their spread is the noise.
- Scattering is vector scattering ("vector" of `rtcal.simulators.paths.Scattering`) with the mean
  coefficient over bands, and what walls scatter is heard twice: by a ray shot to the receiver and
  by the ray that goes on. Levels are therefore not returned; bands with different scattering
  coefficients are traced apart.
- A ray in an edge may be reflected to and fro for ever without getting on; only absorption ends
  it. At least `LEAST_ALPHA` is passed to the engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import decay
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.errors import DataError, MissingDependencyError
from rtcal.simulators import energies, paths
from rtcal.simulators.base import check_alpha
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import RADIUS_SHARE, check_walls, scattering_coefficients
from rtcal.support import checks
from rtcal.support.types import Array

ENERGY_THRESHOLD = 1e-16
LEAST_ALPHA = 1e-4
_RATE = 16000  # Hz; at this rate the engine has seven bands
_BANDS = 7
_FINE = 8 / _RATE  # s; the engine's bins start with the emission, ours with the direct sound


@dataclass(frozen=True, kw_only=True, eq=False)
class RayTracing:
    """Traces rays with pyroomacoustics; every alpha is traced anew.

    Parameters
    ----------
    geometry : Polyhedron
    room : Room
        Whose materials and bands the rows and columns of alpha are; its air attenuates.
    sources, receivers : mapping of str to (x, y, z)
        In m, inside the room.
    n_rays : int
        Per source.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        The room's if not given. Bands with the same ones are traced together.
    radius : float, optional
        Of all receivers in m; as in `PathTracing`, the smallest for all.
    bin_width : float
        Of the energy decays in s, at most 0.01, a multiple of half a millisecond.
    n_batches : int
        Independent parts that the noise is estimated from.

    Raises
    ------
    DataError
        For points outside the room, walls that are not the room's or hold another volume (by over
        `rtcal.simulators.path_tracing.OFF_VOLUME`), coefficients outside [0, 1], numbers that do
        not fit.
    MissingDependencyError
        Where pyroomacoustics is not installed.

    Notes
    -----
    pyroomacoustics has one random generator for the whole process: `simulate` seeds it.
    """

    geometry: Polyhedron
    room: Room
    sources: Mapping[str, Any]
    receivers: Mapping[str, Any]
    n_rays: int = 8000
    scattering: Any = None
    radius: float | None = None
    bin_width: float = 0.002
    n_batches: int = 8
    deterministic: bool = field(default=False, init=False)
    smooth: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        _engine()
        checks.instance("room", self.room, Room)
        checks.instance("geometry", self.geometry, Polyhedron)
        for kind in ("sources", "receivers"):
            points = getattr(self, kind)
            self.geometry.require_inside(kind[:-1], points)
            put(kind, {str(name): tuple(map(float, point)) for name, point in points.items()})
        for name in ("n_rays", "n_batches"):
            checks.whole(name, getattr(self, name), 1)
        if self.n_batches < 2 or self.n_rays < self.n_batches:
            raise DataError(
                f"n_rays = {self.n_rays} in n_batches = {self.n_batches}: at least two batches "
                "with a ray each are needed to tell the noise"
            )
        if not np.isclose(decay.bins(self.bin_width) / _FINE % 1, 0):
            raise DataError(f"bin_width = {self.bin_width:g} s is not a multiple of {_FINE:g} s")
        if self.radius is not None:
            checks.positive("radius", self.radius, "m")
        check_walls(self.geometry, self.room)
        put("scattering", scattering_coefficients(self.room, self.scattering))

    @property
    def name(self) -> str:
        """What calibrated coefficients belong to."""
        return f"pyroomacoustics' ray tracing of {self.room.name}"

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials: rows of alpha."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """The room's bands in Hz: columns of alpha."""
        return self.room.centre_frequencies

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return EDT, T20, T30, C50, C80, D50 and Ts for alpha (n_materials, n_bands)."""
        alpha = check_alpha(self, alpha)
        energy = energies.decay_long_enough(
            lambda seconds: self.energy(alpha, seconds, seed=seed), self.room, alpha
        )
        pairs = [(s, r) for s in self.sources for r in self.receivers]
        flat = energy.reshape(len(energy), len(pairs), *energy.shape[3:])
        return energies.measurement(flat, self.bin_width, self.centre_frequencies, pairs)

    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays, (n_batches, n_sources, n_receivers, n_bands, n_bins).

        From the direct sound on, in the engine's units over 4 pi: the direct sound is 1/(4 pi r²)
        in the mean, the rest is up to twice what it should be (see the module).
        """
        alpha = np.maximum(check_alpha(self, alpha), LEAST_ALPHA)
        columns, group = np.unique(self.scattering, axis=1, return_inverse=True)
        chunks = [
            (columns[:, g], chunk)
            for g in range(columns.shape[1])
            for bands in [np.flatnonzero(group.reshape(-1) == g)]
            for chunk in np.split(bands, range(_BANDS, len(bands), _BANDS))
        ]
        rng = np.random.default_rng(seed)
        direct = paths.direct_lengths(self.geometry, *self._points())
        parts = [
            [
                self._part(alpha, scattering, chunk, seconds, direct, rng)
                for scattering, chunk in chunks
            ]
            for _ in range(self.n_batches)
        ]
        n_bins = min(part.shape[-1] for batch in parts for part in batch)
        energy = np.empty((self.n_batches, *direct.shape, self.room.n_bands, n_bins))
        for b, batch in enumerate(parts):
            for (_, chunk), part in zip(chunks, batch, strict=True):
                energy[b][:, :, chunk] = part[..., :n_bins]
        return energy

    def _part(
        self,
        alpha: Array,
        scattering: Array,
        chunk: NDArray[np.int64],
        seconds: float,
        direct: Array,
        rng: np.random.Generator,
    ) -> Array:
        """One batch of the bands in ``chunk``: traced, attenuated by the air, in our bins."""
        fine = self._trace(alpha[:, chunk], scattering, seconds, rng)
        length = self.room.speed_of_sound * _FINE * (np.arange(fine.shape[-1]) + 0.5)
        fine = fine * np.exp(-self.room.air_attenuation[chunk][:, np.newaxis] * length)
        return self._from_direct_sound(fine, direct, round(self.bin_width / _FINE))

    def _points(self) -> tuple[Array, Array]:
        return np.array(list(self.sources.values())), np.array(list(self.receivers.values()))

    def _radius(self, receivers: Array) -> float:
        radius = self.radius or RADIUS_SHARE * self.geometry.volume ** (1 / 3)
        return min(radius, float(self.geometry.wall_distance(receivers).min()))

    def _trace(
        self, alpha: Array, scattering: Array, seconds: float, rng: np.random.Generator
    ) -> Array:
        """One batch in a room turned at random, (n_sources, n_receivers, n_bands, n_fine_bins)."""
        engine = _engine()
        sources, receivers = self._points()
        rotation = np.asarray(np.linalg.qr(rng.standard_normal((3, 3)))[0])
        rotation[:, 0] *= np.linalg.det(rotation)  # turned, not mirrored: that flips the normals
        n_bands = alpha.shape[1]
        absorption = np.hstack([alpha, np.tile(alpha[:, -1:], (1, _BANDS - n_bands))])
        walls = []
        for corners, material in self._walls():
            row = self.room.material_index(material)
            walls.append(
                engine.wall_factory(
                    rotation @ corners.T, absorption[row], np.full(_BANDS, scattering[row]), ""
                )
            )
        room = engine.Room(walls, fs=_RATE, max_order=-1, ray_tracing=True)
        room.set_sound_speed(self.room.speed_of_sound)
        room.set_ray_tracing(
            n_rays=-(-self.n_rays // self.n_batches),
            receiver_radius=self._radius(receivers),
            energy_thres=ENERGY_THRESHOLD,
            time_thres=seconds,
            hist_bin_size=_FINE,
        )
        for source in sources:
            room.add_source(rotation @ source)
        room.add_microphone_array(rotation @ receivers.T)
        number = int(rng.integers(2**63))
        engine.random.seed(numpy=number, libroom=number)
        room.ray_tracing()
        energy = np.zeros((len(sources), len(receivers), n_bands, int(seconds / _FINE)))
        for s, r in np.ndindex(energy.shape[:2]):
            heard = np.asarray(room.rt_histograms[r][s][0])[:n_bands, : energy.shape[-1]]
            energy[s, r, :, : heard.shape[1]] = heard  # ends with the last ray heard
        return energy / (4 * np.pi)

    def _walls(self) -> list[tuple[Array, str]]:
        """Corners and material of each wall: convex faces whole, the others as triangles."""
        hall, walls = self.geometry, []
        for i, (face, material) in enumerate(zip(hall.faces, hall.materials, strict=True)):
            corners = hall.vertices[list(face)]
            edges = np.roll(corners, -1, axis=0) - corners
            if (np.cross(edges, np.roll(edges, -1, axis=0)) @ hall.normals[i] >= 0).all():
                walls.append((corners, material))
            else:
                walls += [(t, material) for t in hall.triangles[hall.triangle_faces == i]]
        return walls

    def _from_direct_sound(self, fine: Array, direct: Array, per_bin: int) -> Array:
        """Sum fine bins from the direct sound on, as many as every pair has."""
        c, radius = self.room.speed_of_sound, self._radius(self._points()[1])
        starts = np.zeros(direct.shape, dtype=np.int64)
        for s, r in np.ndindex(starts.shape):
            if np.isnan(direct[s, r]):
                heard = np.flatnonzero(fine[s, r].sum(axis=0))
                starts[s, r] = heard[0] if heard.size else 0
            else:  # a ray is noted where it is nearest to the centre: a little before it
                nearest = float(np.sqrt(np.maximum(direct[s, r] ** 2 - radius**2, 0.0)))
                starts[s, r] = int(nearest / (c * _FINE))
        n_bins = (fine.shape[-1] - int(starts.max())) // per_bin
        binned = np.empty((*fine.shape[:3], n_bins))
        for s, r in np.ndindex(starts.shape):
            piece = fine[s, r][:, starts[s, r] : starts[s, r] + n_bins * per_bin]
            binned[s, r] = piece.reshape(len(piece), n_bins, per_bin).sum(axis=-1)
        return binned


def _engine() -> Any:
    try:
        import pyroomacoustics
    except ImportError as error:
        raise MissingDependencyError(
            'RayTracing needs pyroomacoustics: pip install "rtcal[geometry]"'
        ) from error
    return pyroomacoustics
