"""Path tracing: the paths are traced once per seed, and every alpha weighs the same paths."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from rtcal.errors import DataError
from rtcal.simulators import paths
from rtcal.simulators.base import check_alpha
from rtcal.simulators.tracer import Tracer
from rtcal.support import checks
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PathTracing(Tracer):
    """Traces paths in a room with plane walls, and weighs the same paths for every alpha.

    Parameters
    ----------
    geometry : Polyhedron
        Its walls have the room's materials, and it holds the room's volume within 10 %.
    room : Room
        Alpha has its materials and bands. The simulation takes its air and speed of sound.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, inside the room. Sources are omnidirectional.
    n_paths : int
        Paths per source. 8000 give the mean T20 over four receivers of a 334 m³ hall a standard
        error of about 1 %.
    n_batches : int
        Independent batches of paths; their spread gives the standard errors.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        Scattering coefficients, by default the room's. Bands with equal ones share their paths.
    scattering_model : {"random", "vector"}
        How a wall scatters; see `rtcal.simulators.paths.ScatteringModel`. The two models give
        different decays in long or flat rooms.
    radius : float, optional
        Radius of the receivers in m, by default 0.075 times the cube root of the volume. A receiver
        nearer to a wall has the distance from it as radius. The standard errors depend on the
        radius, the expected energy does not.
    bin_width : float
        Width of the bins of the energy decays in s, at most 0.01.
    workers : int, optional
        Number of threads, by default the number of processors.

    Raises
    ------
    DataError
        For positions outside the room, walls of other materials, another volume, or a number
        outside its range.

    Notes
    -----
    Calibrated coefficients belong to the simulator and its scattering model: T differs under
    another one. `rtcal.simulators.paths` describes the method, docs/path_tracing.md its limits.

    Examples
    --------
    >>> from rtcal.datasets import halls
    >>> hall = halls.corridor()
    >>> tracer = PathTracing(geometry=hall.geometry, room=hall.room, sources=hall.sources,
    ...                      receivers=hall.receivers, n_paths=320)
    >>> tracer.simulate(hall.room.alpha, seed=1).values["t20"].shape
    (4, 7)
    """

    n_paths: int = 8000
    n_batches: int = 16
    scattering_model: paths.ScatteringModel = "random"
    workers: int | None = None
    smooth: ClassVar[bool] = True
    _traced: dict[tuple[int, int], paths.Paths] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_batches("n_paths", self.n_paths)
        if self.scattering_model not in ("random", "vector"):
            raise DataError(
                f'scattering_model = "{self.scattering_model}" is not "random" or "vector"'
            )
        if self.workers is not None:
            checks.whole("workers", self.workers, 1)

    @property
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""
        return f"path tracing of {self.room.name} ({self.scattering_model} scattering)"

    def energy(self, alpha: Array, seconds: float, *, seed: int = 0) -> Array:
        """Return energy decays, (n_batches, n_sources, n_receivers, n_bands, n_bins), in 1/m².

        The source has unit energy. The first bin starts with the first sound. The decays end at
        least ``seconds`` after the emission; see `rtcal.simulators.paths.Paths.energy`.
        """
        alpha = check_alpha(self, alpha)
        groups = self._bands_by_scattering()
        decays = [
            self.traced(int(bands[0]), seconds, seed=seed).energy(
                alpha[:, bands],
                self.room.air_attenuation[bands],
                self.room.speed_of_sound * self.bin_width,
            )
            for bands in groups
        ]
        n_bins = min(decay.shape[-1] for decay in decays)
        energy = np.empty((*decays[0].shape[:3], self.room.n_bands, n_bins))
        for bands, decay in zip(groups, decays, strict=True):
            energy[:, :, :, bands] = decay[..., :n_bins]
        return energy

    def traced(self, band: int, seconds: float, *, seed: int = 0) -> paths.Paths:
        """Return the paths of a band, followed for ``seconds`` or longer.

        The paths of the last seed are kept and returned again.
        """
        checks.whole("seed", seed, 0)
        longest = checks.positive("seconds", seconds, "s") * self.room.speed_of_sound
        columns = [tuple(column) for column in self.scattering.T]
        key = (seed, columns.index(columns[band]))
        if key not in self._traced or self._traced[key].longest < longest:
            if any(other != seed for other, _ in self._traced):
                self._traced.clear()
            self._traced[key] = self._trace(self.scattering[:, band], longest, seed)
        return self._traced[key]

    def _trace(self, scattering: Array, longest: float, seed: int) -> paths.Paths:
        sources, receivers = self._points()
        return paths.trace(
            self.geometry,
            sources,
            receivers,
            materials=np.array([self.room.material_index(m) for m in self.geometry.materials]),
            scattering=scattering,
            radii=self._radii(),
            longest=longest,
            n_paths=self.n_paths,
            n_batches=self.n_batches,
            scattering_model=self.scattering_model,
            seed=seed,
            workers=self.workers,
        )
