"""What each position hears when one surface, the air or the size of the room changes.

The paths of a `PathTracing` do not depend on what the walls absorb. So every change weighs the same
paths anew, and their random numbers cancel in the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import decay
from rtcal.simulators import observations, paths
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.tracer import LONGEST, decay_long_enough
from rtcal.support.types import Array


@dataclass(eq=False)
class Weighing:
    """The paths of a tracing, weighed with one alpha per face."""

    tracer: PathTracing
    match: Sequence[str]
    seed: int = 0
    seconds: float = 0.0

    @property
    def alpha(self) -> Array:
        """Alpha of each face, (n_faces, n_bands)."""
        rows = [self.tracer.room.material_index(m) for m in self.tracer.geometry.materials]
        return np.asarray(self.tracer.room.alpha[rows])

    def observe(
        self, alpha: Array, attenuation: Array | None = None, stretch: float = 1.0
    ) -> Array:
        """Return what the positions hear, (n_parameters, n_pairs, n_bands); see `Observations`.

        Parameters
        ----------
        alpha : array (n_faces, n_bands)
        attenuation : array (n_bands,), optional
            Of the air, in 1/m; by default the room's.
        stretch : float
            Factor of all lengths of the room.
        """
        return self.parameters(self.energy(alpha, attenuation, stretch)[0])

    def in_groups(self, alpha: Array, number: int) -> Array:
        """Return what groups of the paths hear, (number, n_parameters, n_pairs, n_bands)."""
        return np.array([self.parameters(group) for group in self.energy(alpha, number=number)])

    def parameters(self, energy: Array) -> Array:
        """Return the parameters of decays, (n_pairs, n_bands, n_bins), as `observe` does."""
        tracer = self.tracer
        heard = observations.of_decays(
            energy, tracer.bin_width, self.match, tracer.pairs, tracer.centre_frequencies
        )
        return heard.values

    def energy(
        self,
        alpha: Array,
        attenuation: Array | None = None,
        stretch: float = 1.0,
        number: int = 1,
    ) -> Array:
        """Return the decays of groups of paths, (number, n_pairs, n_bands, n_bins), as T20 needs."""
        room = self.tracer.room
        air = room.air_attenuation if attenuation is None else attenuation
        if not self.seconds:
            decay_long_enough(self._probe, room, room.alpha, self._longest)
        while True:
            batches = self._energy(alpha, air, stretch)
            energy = batches.reshape(number, -1, *batches.shape[1:]).mean(axis=1)
            if self.seconds >= LONGEST or not decay.too_short(energy, self._longest).any():
                return np.asarray(energy)
            self.seconds = min(1.5 * self.seconds, LONGEST)

    @property
    def _longest(self) -> str:
        return "t30" if "t30" in self.match else "t20"

    def _probe(self, seconds: float) -> Array:
        self.seconds = seconds
        return self._energy(self.alpha, self.tracer.room.air_attenuation, 1.0)

    def _energy(self, alpha: Array, attenuation: Array, stretch: float) -> Array:
        tracer = self.tracer
        width = tracer.room.speed_of_sound * tracer.bin_width
        decays = [
            # Lengths that grow by a factor: bins that are shorter by it, and air that absorbs more.
            self._by_face(int(bands[0])).energy(
                alpha[:, bands], stretch * attenuation[bands], width / stretch
            )
            for bands in self._bands
        ]
        n_bins = min(d.shape[-1] for d in decays)
        out = np.empty((len(decays[0]), len(tracer.pairs), tracer.room.n_bands, n_bins))
        for bands, of_bands in zip(self._bands, decays, strict=True):
            cut = of_bands[..., :n_bins]
            out[:, :, bands] = cut.reshape(len(cut), len(tracer.pairs), len(bands), n_bins)
        return out / stretch**2

    @property
    def _bands(self) -> list[NDArray[np.int64]]:
        """The bands' numbers in groups that share their scattering coefficients, so their paths."""
        columns, group = np.unique(self.tracer.scattering, axis=1, return_inverse=True)
        return [np.asarray(np.flatnonzero(group.reshape(-1) == g)) for g in range(columns.shape[1])]

    def _by_face(self, band: int) -> paths.Paths:
        """Return the band's paths with each face as a material of its own."""
        traced = self.tracer.traced(band, self.seconds, seed=self.seed)
        n_faces = len(traced.materials)
        return replace(traced, materials=np.arange(n_faces), n_materials=n_faces)
