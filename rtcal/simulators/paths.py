"""Sound paths in a polyhedron, traced once and weighed for any alpha.

The walls that a path hits do not depend on their absorption. A path is therefore stored as the
sequence of faces it hits and receivers that hear it. A receiver hears the energy

    E = w product over hits (1 - alpha) exp(-m L),

where L is the length travelled, m the attenuation of air, and w the path's share of the source
energy per cross-section of the receiver. The same paths give E for every alpha, band and air. A path
that hit material j n times has dE / d alpha_j = -n E / (1 - alpha_j), so they give the derivatives too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.directivity import Directivity
from rtcal.simulators import path_numpy
from rtcal.simulators.path_numpy import Batch, aimed, joined
from rtcal.simulators.tracer import ScatteringModel
from rtcal.support import speed
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_LARGEST_POWER = 600.0
"""Largest ln of a factor of the energy: its product with an energy that is 0 is 0, not NaN."""


_TOGETHER = 100_000
"""Receptions that are sorted at once: their energies fill some 10 MB."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Paths:
    """Paths from every source to every receiver, in independent batches of equal size.

    Made by `rtcal.simulators.path_trace.trace`.

    Attributes
    ----------
    batches : tuple of tuples of Batch
        By source and batch. Batches are independent, so their spread gives the standard error.
    materials : int array (n_faces,)
        Number of each face's material.
    scattering : array (n_materials,)
    scattering_model : "random" or "vector"
    n_materials, n_paths : int
        ``n_paths`` per source, with those that were lost.
    longest : float
        Length in m to which every path is followed.
    direct : array (n_sources, n_receivers)
        Length of the direct sound in m, NaN where a wall hides the source.
    direct_gain : array (n_sources, n_receivers)
        Energy of the direct sound over an omnidirectional source's.
    first : array (n_sources, n_receivers)
        Length of the first sound in m: the direct sound, else the first path heard.
    """

    batches: tuple[tuple[Batch, ...], ...]
    materials: NDArray[np.int64]
    scattering: Array
    scattering_model: ScatteringModel
    n_materials: int
    n_paths: int
    longest: float
    direct: Array
    direct_gain: Array
    first: Array

    def __post_init__(self) -> None:
        # The paths do not depend on alpha, so every simulation reads the same arrays.
        for values in (
            self.materials,
            self.scattering,
            self.direct,
            self.direct_gain,
            self.first,
        ):
            values.setflags(write=False)

    def aimed(self, lobes: Mapping[int, Directivity], to_receivers: Array) -> Paths:
        """Return the same paths from sources that are not omnidirectional.

        Parameters
        ----------
        lobes : mapping of int to Directivity
            By a source's number, of one band.
        to_receivers : array (n_sources, n_receivers, 3)
            Direction of the direct sound.
        """
        batches, direct_gain = list(self.batches), self.direct_gain.copy()
        for s, lobe in lobes.items():
            batches[s] = aimed(self.batches[s], lobe, 2 * len(self.materials))
            direct_gain[s] = lobe.gain(to_receivers[s])[:, 0]
        return replace(self, batches=tuple(batches), direct_gain=direct_gain)

    @property
    def nbytes(self) -> int:
        """Memory of all paths in bytes."""
        return sum(batch.nbytes for source in self.batches for batch in source)

    @property
    def lost_share(self) -> float:
        """Share of the paths that left through gaps between the faces."""
        lost = sum(batch.lost for source in self.batches for batch in source)
        return lost / (self.n_paths * len(self.batches))

    def _kept(self, source: int) -> int:
        """Return the number of a source's paths that were not lost."""
        return self.n_paths - sum(batch.lost for batch in self.batches[source])

    @property
    def mean_free_path(self) -> float:
        """Mean length in m between two reflections; 4V/S in a diffuse field."""
        number, total, _ = self._free_paths()
        return total / number

    @property
    def gamma_squared(self) -> float:
        """Variance of the free paths over their squared mean: gamma² of Kuttruff's equation."""
        number, total, squares = self._free_paths()
        return squares / number / (total / number) ** 2 - 1

    def _free_paths(self) -> tuple[float, float, float]:
        sums = np.sum([b.free_paths for source in self.batches for b in source], axis=0)
        return float(sums[0]), float(sums[1]), float(sums[2])

    def energy(
        self,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        number: int | None = None,
    ) -> Array:
        """Return the energy that each receiver hears, in bins of length after the first sound.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
            Absorption coefficients, 0 to 1.
        air_attenuation : array (n_bands,)
            m in 1/m.
        bin_length : float
            Width of a bin in m: the speed of sound times the width in s. The first bin starts with
            the first sound.
        number : int, optional
            Of groups of batches, by default of batches; it divides their number.

        Returns
        -------
        array (number, n_sources, n_receivers, n_bands, n_bins)
            As many bins as every pair fills. Energy per area in 1/m² for a source of unit energy:
            the direct sound is 1/(4 pi r²). The estimate is the mean over groups.
        """
        log_reflection, attenuation = self._weights(alpha, air_attenuation)
        n_sources, n_receivers = self.first.shape
        n_bins = self._n_bins(bin_length)
        n_batches, n_bands = len(self.batches[0]), len(attenuation)
        number = n_batches if number is None else number
        out = np.zeros((number, n_sources, n_receivers, n_bands, n_bins))
        histogram = kernels().histogram
        for s, source in enumerate(self.batches):
            for b, batch in enumerate(source):
                histogram(
                    *batch.arrays,
                    log_reflection,
                    attenuation,
                    self.first[s],
                    float(bin_length),
                    out[b * number // n_batches, s],
                )
            out[:, s] *= number / self._kept(s)
        out[..., 0] += self._direct_sound(attenuation)
        return out

    def energy_gradient(
        self,
        source: int,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        groups: NDArray[np.int64],
    ) -> tuple[Array, Array]:
        """Return the energies of one source, and their derivatives, in one sweep of its paths.

        Parameters
        ----------
        source : int
        alpha, air_attenuation, bin_length
            As for `energy`; no alpha is 1.
        groups : int array (n_faces,)
            Number of the group that each face belongs to. The faces of a group have one material.

        Returns
        -------
        energy : array (n_receivers, n_bands, n_bins)
            Mean over the batches.
        gradient : array (1, n_receivers, n_bins, n_groups, n_bands)
            d energy / d alpha of each group's faces; the first axis is that of `scattering_gradient`.
        """
        energy, gradient = self._swept(
            self.batches[source],
            source,
            (alpha, air_attenuation, bin_length),
            np.tile(groups, 2),
            np.ones(2 * len(groups)),
        )
        material = np.zeros(gradient.shape[2], dtype=np.int64)
        material[groups] = self.materials
        # The kernel sums n E, n being the number of hits on the group's faces.
        return energy, gradient[np.newaxis] / -(1 - np.asarray(alpha, dtype=float)[material])

    def scattering_gradient(
        self,
        source: int,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        number: int,
    ) -> tuple[Array, Array]:
        """Return the energies of one source and their derivatives by the scattering of each material.

        A path that material j scattered d times and reflected r times without scattering has a
        probability proportional to s^d (1 - s)^r. So its energy counts with (1 - s) d - s r in the
        derivative by the log odds ln(s / (1 - s)) (Glynn 1990, likelihood ratios). It is 0 where s is
        0 or 1.

        Parameters
        ----------
        source : int
        alpha, air_attenuation, bin_length
            As for `energy`.
        number : int
            Of independent groups of the batches; it divides their number.

        Returns
        -------
        energy : array (n_receivers, n_bands, n_bins)
            Mean over the batches.
        gradient : array (number, n_receivers, n_bins, n_materials, n_bands)
            Of each group, d energy / d ln(s / (1 - s)).

        Raises
        ------
        DataError
            If the paths were traced with another scattering model than "random".
        """
        if self.scattering_model != "random":
            raise DataError(
                f'the paths were traced with scattering_model = "{self.scattering_model}"; derivatives '
                'by the scattering need "random"'
            )
        s = self.scattering[self.materials]
        batches = self.batches[source]
        swept = [
            self._swept(
                batches[group::number],
                source,
                (alpha, air_attenuation, bin_length),
                np.tile(self.materials, 2),
                np.concatenate([-s, 1 - s]),
            )
            for group in range(number)
        ]
        energy, gradient = zip(*swept, strict=True)
        return np.mean(energy, axis=0), np.array(gradient)

    def _swept(
        self,
        batches: Sequence[Batch],
        source: int,
        weighing: tuple[Array, Array, float],
        groups: NDArray[np.int64],
        counts: Array,
    ) -> tuple[Array, Array]:
        """Return the mean energies of some batches, and what their kernel sums; see `kernels`.

        ``weighing`` is alpha, air attenuation and the length of a bin. ``groups`` and ``counts``
        (2 n_faces,) belong to the codes of wall hits.
        """
        alpha, air_attenuation, bin_length = weighing
        log_reflection, attenuation = self._weights(alpha, air_attenuation)
        n_receivers, n_bands = self.first.shape[1], len(attenuation)
        n_bins = self._n_bins(bin_length)
        energy = np.zeros((n_receivers, n_bands, n_bins))
        gradient = np.zeros((n_receivers, n_bins, int(groups.max()) + 1, n_bands))
        for batch in batches:
            kernels().histogram_gradient(
                *batch.arrays,
                log_reflection,
                attenuation,
                self.first[source],
                float(bin_length),
                groups,
                counts,
                energy,
                gradient,
            )
        kept = len(batches) * self.n_paths // len(self.batches[source])
        kept -= sum(batch.lost for batch in batches)
        energy /= kept
        gradient /= kept
        energy[..., 0] += self._direct_sound(attenuation)[source]
        return energy, gradient

    def energy_changed(
        self,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        parts: NDArray[np.int64],
        members: NDArray[np.bool_],
        changed: Array,
    ) -> Array:
        """Return the energy with each group of faces changed, in one sweep of the paths.

        A path whose group's faces all change alike is worth its energy times a factor to the power of
        its hits on them. So the sweep sums energies by hits, for any number of changes. A group whose
        faces change differently is weighed anew for each change.

        Parameters
        ----------
        alpha, air_attenuation, bin_length
            As for `energy`; no alpha is 1.
        parts : int array (n_faces,)
            Number of the part that each face belongs to. The faces of a part have one material.
        members : bool array (n_groups, n_parts)
            Whether a group holds a part.
        changed : array (n_changes, n_parts, n_bands)
            Alpha of a part whose group is changed.

        Returns
        -------
        array (n_groups, n_changes, n_sources, n_receivers, n_bands, n_bins)
            Mean over the batches.
        """
        n_sources, n_receivers = self.first.shape
        n_changes, n_parts, n_bands = changed.shape
        material = np.zeros(n_parts, dtype=np.int64)
        material[parts] = self.materials
        stated = np.asarray(alpha, dtype=float)[material]
        ratio = (1 - changed) / (1 - stated)
        alike = np.array([not np.ptp(ratio[:, held], axis=1).any() for held in members], dtype=bool)
        n_bins = self._n_bins(bin_length)
        out = np.empty((len(members), n_changes, n_sources, n_receivers, n_bands, n_bins))
        if alike.any():
            factor = np.array([ratio[:, np.argmax(held)] for held in members[alike]])
            held = np.tile(members[alike][:, parts], 2).T.astype(np.int64)
            out[alike] = self._by_hits(alpha, air_attenuation, bin_length, held, factor)
        of_parts = replace(self, materials=parts, n_materials=n_parts)
        for j in np.flatnonzero(~alike):
            for c, other in enumerate(np.where(members[j][:, np.newaxis], changed, stated)):
                out[j, c] = of_parts.energy(other, air_attenuation, bin_length, number=1)[0]
        return out

    def _by_hits(
        self,
        alpha: Array,
        air_attenuation: Array,
        bin_length: float,
        held: NDArray[np.int64],
        factor: Array,
    ) -> Array:
        """Return the energies with a factor for each hit on a group; see `energy_changed`.

        ``held`` (2 n_faces, n_groups) as in the kernels, ``factor`` (n_groups, n_changes, n_bands).
        """
        log_reflection, attenuation = self._weights(alpha, air_attenuation)
        n_sources, n_receivers = self.first.shape
        n_groups, n_changes, n_bands = factor.shape
        n_bins = self._n_bins(bin_length)
        out = np.empty((n_groups, n_changes, n_sources, n_receivers, n_bands, n_bins))
        every = [batch for source in self.batches for batch in source]
        most = max(kernels().most_hits(batch.events, batch.starts, held) for batch in every)
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.arange(most + 1)[:, np.newaxis, np.newaxis] * np.log(factor)[:, np.newaxis]
        logs[:, 0] = 0.0
        powers = np.exp(np.minimum(logs, _LARGEST_POWER))
        for s, source in enumerate(self.batches):
            heard = np.zeros((n_groups, n_receivers, n_bins, n_changes, n_bands))
            receptions = sum(len(batch.lengths) for batch in source)
            together = max(len(source) * _TOGETHER // max(receptions, 1), 1)
            for start in range(0, len(source), together):
                kernels().histogram_changed(
                    *joined(source[start : start + together]),
                    log_reflection,
                    attenuation,
                    self.first[s],
                    float(bin_length),
                    held,
                    powers,
                    heard,
                )
            out[:, :, s] = np.moveaxis(heard, (1, 2, 3, 4), (2, 4, 1, 3)) / self._kept(s)
        out[..., 0] += self._direct_sound(attenuation)
        return out

    def _weights(self, alpha: Array, air_attenuation: Array) -> tuple[Array, Array]:
        """Return ln(1 - alpha) of every wall hit's code, (2 n_faces, n_bands), and m of every band."""
        alpha = np.asarray(alpha, dtype=float)
        attenuation = np.ascontiguousarray(air_attenuation, dtype=float)
        if alpha.ndim != 2 or alpha.shape != (self.n_materials, len(attenuation)):
            raise DataError(
                f"alpha has shape {alpha.shape}; the paths ask for (n_materials, n_bands) = "
                f"({self.n_materials}, {len(attenuation)})"
            )
        with np.errstate(divide="ignore"):
            return np.log1p(-alpha)[np.tile(self.materials, 2)], attenuation

    def _n_bins(self, bin_length: float) -> int:
        return max(int((self.longest - self.first.max()) / bin_length), 1)

    def _direct_sound(self, attenuation: Array) -> Array:
        """Return the direct sound's energy, (n_sources, n_receivers, n_bands); 0 where hidden."""
        length = self.direct[..., np.newaxis]
        gain = self.direct_gain[..., np.newaxis]
        return np.nan_to_num(gain * np.exp(-attenuation * length) / (4 * np.pi * length**2))


def kernels() -> ModuleType:
    """Return the module with the inner loops: numba's, or NumPy's where numba is absent."""
    if speed.available():
        from rtcal.simulators import path_numba

        return path_numba
    return path_numpy
