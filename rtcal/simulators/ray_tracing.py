"""pyroomacoustics' ray tracer as a simulator: an engine independent of rtcal's own tracer.

No other module imports pyroomacoustics (extra ``geometry``). Properties of version 0.10 that this
module depends on:

- Decays are taken from ``rt_histograms``. ``compute_rir()`` would add Poisson noise and filters.
- ``set_air_absorption`` changes the impulse response only, not the histograms, and its table is
  coarse. This module weighs the histograms by exp(-m c t), with m after ISO 9613-1.
- ``energy_thres`` is 1e-16, since the default 1e-7 cuts the late decay off.
- Ray directions are a fixed lattice. This module rotates the room at random for every batch of
  rays, so that batches are independent and their spread is the noise.
- Scattering follows the model "vector" of `rtcal.simulators.path_tracing.ScatteringModel`, with the
  mean coefficient over bands. Bands with other coefficients are therefore traced separately.
- A receiver hears scattered energy twice: by a ray sent to it, and by the ray that continues. The
  measurement therefore has no level G.
- A ray in an edge may be reflected to and fro without end. Only absorption ends it, so the engine
  gets at least `LEAST_ALPHA`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.simulators.base import check_alpha
from rtcal.simulators.geometry import convex_parts
from rtcal.simulators.path_tracing import Tracer, check_seconds, direct_lengths, of_all_bands
from rtcal.support import checks, library
from rtcal.support.errors import DataError
from rtcal.support.types import Array

ENERGY_THRESHOLD = 1e-16
LEAST_ALPHA = 1e-4
_RATE = 16000  # Hz; the engine has seven bands at this rate
_BANDS = 7
_FINE = 8 / _RATE  # s; the engine's bins start at the emission, rtcal's at the direct sound


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RayTracing(Tracer):
    """Simulator that traces rays with pyroomacoustics, anew for all coefficients.

    Parameters
    ----------
    geometry : Polyhedron
        Geometry whose walls have the room's materials, and whose volume is the room's within 10 %.
    room : Room
        Room with the materials, the bands, the air and the speed of sound.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room. Sources are omnidirectional.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        Scattering coefficients, by default the room's. Bands with equal coefficients are traced
        together.
    n_batches : int
        Number of independent tracings, at least 2; their spread gives the standard errors.
    n_rays : int
        Number of rays per source, in all batches together.
    radius : float, optional
        Radius of all receivers in m, by default 0.075 times the cube root of the volume, but at most
        the distance of any receiver from the nearest wall.
    bin_width : float
        Width of the time bins of the energy decays in s: a multiple of 0.0005, at most 0.01.

    Raises
    ------
    DataError
        For positions outside the room, a geometry with other materials or another volume than the
        room, or a number outside its range.
    MissingDependencyError
        If pyroomacoustics is not installed.

    Notes
    -----
    pyroomacoustics has one random generator for the whole process, which `simulate` seeds.
    """

    n_rays: int = 8000

    def __post_init__(self) -> None:
        _engine()
        super().__post_init__()
        self._check_batches("n_rays", self.n_rays)
        bins = self.bin_width / _FINE
        if not np.isclose(bins, max(round(bins), 1)):
            raise DataError(f"bin_width = {self.bin_width:g} s must be a multiple of {_FINE:g} s")

    @property
    def name(self) -> str:
        """Name of the simulator with the settings that change T; coefficients are valid only for it."""
        return f"pyroomacoustics' ray tracing of {self.room.name}"

    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays for coefficients ``alpha`` and a source of unit energy, in 1/m².

        Their shape is (n_batches, n_sources, n_receivers, n_bands, n_bins), and they last ``seconds``
        s, at most 60. ``alpha`` is (n_materials, n_bands). The first bin starts with the direct sound,
        whose mean energy is 1/(4 pi r²) at the distance r. Later energy is too high by a factor of up
        to 2, because pyroomacoustics counts scattered sound twice.

        ``seed`` is that of the random numbers, by default 0.
        """
        alpha = np.maximum(check_alpha(self, alpha), LEAST_ALPHA)
        check_seconds(seconds)
        rng = np.random.default_rng(checks.whole("seed", seed, 0))
        groups = [
            group
            for bands in self.bands_of_paths
            for group in np.split(bands, range(_BANDS, len(bands), _BANDS))
        ]
        direct = direct_lengths(self.geometry, *self._points())
        per_bin, batches = round(self.bin_width / _FINE), []
        for _ in range(self.n_batches):
            batch = []
            for bands in groups:
                fine = self._trace(alpha[:, bands], self.scattering[:, bands[0]], seconds, rng)
                length = self.room.speed_of_sound * _FINE * (np.arange(fine.shape[-1]) + 0.5)
                air = np.exp(-self.room.air_attenuation[bands][:, np.newaxis] * length)
                batch.append(self._from_direct_sound(fine * air, direct, per_bin))
            batches.append(batch)
        n_bins = min(decay.shape[-1] for batch in batches for decay in batch)
        return np.stack([of_all_bands(groups, batch)[..., :n_bins] for batch in batches])

    def _radius(self) -> float:
        return float(self._radii().min())

    def _trace(
        self, alpha: Array, scattering: Array, seconds: float, rng: np.random.Generator
    ) -> Array:
        """Trace in a room rotated at random: (n_sources, n_receivers, n_bands, n_fine_bins)."""
        engine = _engine()
        sources, receivers = self._points()
        rotation = np.asarray(np.linalg.qr(rng.standard_normal((3, 3)))[0])
        rotation[:, 0] *= np.linalg.det(rotation)  # no reflection: it would flip the normals
        n_bands = alpha.shape[1]
        absorption = np.hstack([alpha, np.tile(alpha[:, -1:], (1, _BANDS - n_bands))])
        walls = []
        for face, row in enumerate(self.made_of):
            walls += [
                engine.wall_factory(
                    rotation @ corners.T, absorption[row], np.full(_BANDS, scattering[row]), ""
                )
                for corners in convex_parts(self.geometry, face)
            ]
        room = engine.Room(walls, fs=_RATE, max_order=-1, ray_tracing=True)
        room.set_sound_speed(self.room.speed_of_sound)
        room.set_ray_tracing(
            n_rays=-(-self.n_rays // self.n_batches),
            receiver_radius=self._radius(),
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

    def _from_direct_sound(self, fine: Array, direct: Array, per_bin: int) -> Array:
        """Sum fine bins from the direct sound on, as many as every pair has."""
        c, radius = self.room.speed_of_sound, self._radius()
        starts = np.zeros(direct.shape, dtype=np.int64)
        for s, r in np.ndindex(starts.shape):
            if np.isnan(direct[s, r]):
                heard = np.flatnonzero(fine[s, r].sum(axis=0))
                starts[s, r] = heard[0] if heard.size else 0
            else:  # a ray is counted at its point nearest to the receiver, before the direct sound
                nearest = float(np.sqrt(np.maximum(direct[s, r] ** 2 - radius**2, 0.0)))
                starts[s, r] = int(nearest / (c * _FINE))
        n_bins = (fine.shape[-1] - int(starts.max())) // per_bin
        binned = np.empty((*fine.shape[:3], n_bins))
        for s, r in np.ndindex(starts.shape):
            piece = fine[s, r][:, starts[s, r] : starts[s, r] + n_bins * per_bin]
            binned[s, r] = piece.reshape(len(piece), n_bins, per_bin).sum(axis=-1)
        return binned


def _engine() -> Any:
    needed = 'RayTracing needs pyroomacoustics: pip install "rtcal[geometry]"'
    return library(needed, "pyroomacoustics")
