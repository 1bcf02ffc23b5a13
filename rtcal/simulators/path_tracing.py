"""Path tracing: the paths are traced once per seed, and every alpha weighs the same paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.directivity import Directivity, DirectivityFile, directivities
from rtcal.acoustics.observables import MATCH, OBSERVABLES, longest
from rtcal.simulators import base, paths
from rtcal.simulators.base import Observations, check_alpha
from rtcal.simulators.tracer import (
    LONGEST,
    Tracer,
    check_seconds,
    decay_long_enough,
    equal_columns,
    eyring_seconds,
    of_all_bands,
)
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_REFLECTING = 0.7
"""Mean alpha below which enough is reflected for every parameter: 25 dB take five reflections."""
DENSER = 3
"""Factor of the number of paths where they are thinned (`PathTracing.denser`). In a development room of
200 m³ with T from 0.4 to 1.1 s this and `LARGER` leave a seventh of the noise's variance."""
LARGER = 0.15
"""Radius of their receivers over the cube root of the volume. In that room parameters differ from those
with half the radius by 0.3 % (Ts), 0.2 % (EDT), 0.03 dB (C80) and less than 0.1 % (T20)."""
_THINNED = 0.25
"""Time after which every second path ends, over Eyring's T of the band with the longest."""

_Weighing = tuple[Array, Array, float]
_Gradient = Callable[[paths.Paths, int, _Weighing], tuple[Array, Array]]
"""Energies of a source's paths and gradients of groups of them, for alpha, air and bin length."""


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
        Positions in m, inside the room.
    directivity : mapping of str to Directivity or "unknown"
        By source: a lobe, or a balloon (`rtcal.io.balloon.read`). Sources that are not stated, and
        unknown ones, radiate alike in all directions.
    n_paths : int
        Paths per source. 8000 give the mean T20 over four receivers of a 334 m³ hall a standard
        error of about 1 %.
    n_batches : int
        Independent batches of paths; their spread gives the standard errors.
    scattering : float, array (n_materials,) or (n_materials, n_bands), optional
        Scattering coefficients, by default the room's. Bands with equal ones share their paths.
    scattering_model : {"random", "vector"}, optional
        How a wall scatters, by default as the room states; see
        `rtcal.simulators.tracer.ScatteringModel`. The two models give different decays in long or
        flat rooms.
    radius : float, optional
        Radius of the receivers in m, by default 0.075 times the cube root of the volume. A receiver
        nearer to a wall has the distance from it as radius. The standard errors depend on the
        radius, the expected energy does not.
    bin_width : float
        Width of the bins of the energy decays in s, at most 0.01.
    workers : int, optional
        Number of threads, by default the number of processors.
    thinned : float, optional
        Time in s after which every second path ends, and again after each further such time; those left
        weigh twice as much. See `rtcal.simulators.paths.trace`.

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

    directivity: Mapping[str, Any] = field(default_factory=dict)
    n_paths: int = 8000
    n_batches: int = 16
    scattering_model: Any = None
    workers: int | None = None
    thinned: float | None = None
    _traced: dict[tuple[int, ...], paths.Paths] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_batches("n_paths", self.n_paths)
        if self.scattering_model is None:
            object.__setattr__(self, "scattering_model", self.room.scattering_model)
        checks.choice("scattering_model", self.scattering_model, ("random", "vector"))
        stated = directivities(self.directivity, self.sources)
        for name, of in stated.items():
            if isinstance(of, DirectivityFile):
                raise DataError(f'directivity["{name}"] is a file; rtcal.io.balloon.read reads it')
            if isinstance(of, Directivity):
                stated[name] = of.for_bands(self.room.n_bands, f'directivity["{name}"]')
        object.__setattr__(self, "directivity", stated)
        if self.workers is not None:
            checks.whole("workers", self.workers, 1)
        if self.thinned is not None:
            checks.positive("thinned", self.thinned, "s")

    @property
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""
        return f"path tracing of {self.room.name} ({self.scattering_model} scattering)"

    @property
    def tracing(self) -> PathTracing:
        """The tracing itself, in which control runs are traced."""
        return self

    @property
    def fits_scattering(self) -> bool:
        """Whether paths of the model "random" hit materials that scatter in part."""
        return self.scattering_model == "random" and not np.isin(self.scattering, (0.0, 1.0)).all()

    @property
    def unknown_sources(self) -> tuple[str, ...]:
        """The sources whose directivity is stated to be unknown."""
        return tuple(name for name, of in self.directivity.items() if isinstance(of, str))

    @cached_property
    def aimed_sources(self) -> dict[int, Directivity]:
        """The directivities that are known, by the number of the source."""
        stated = {s: self.directivity.get(name) for s, name in enumerate(self.sources)}
        return {s: of for s, of in stated.items() if isinstance(of, Directivity)}

    def trusted(self, match: Sequence[str]) -> tuple[str, ...]:
        """Return those parameters that say as much where a source's directivity is unknown.

        Early sound depends on where a loudspeaker aims, and so does the level near it. T20 and T30
        depend on it little. DataError where none is left.
        """
        names = base.checked_parameters(match)
        if not self.unknown_sources:
            return names
        kept = tuple(name for name in names if OBSERVABLES[name].part == "late")
        if not kept:
            raise DataError(
                f"match = {', '.join(names)} depends on the directivity of a source, which is unknown"
            )
        return kept

    @property
    def notes(self) -> tuple[str, ...]:
        """Areas that the geometry contradicts, and the assumption on the sources' directivities."""
        notes = [*super().notes]
        if unknown := ", ".join(self.unknown_sources):
            notes.append(
                f"The directivity of {unknown} is unknown. So reverberation times alone are used: the "
                "level and early parameters depend on where a loudspeaker aims."
            )
        if taken := ", ".join(name for name in self.sources if name not in self.directivity):
            notes.append(f"Taken as omnidirectional: {taken}.")
        return tuple(notes)

    def with_air(self, air: Air) -> PathTracing:
        """Return the tracing with another air."""
        return replace(self, room=self.room.with_air(air))

    def denser(self, factor: int = 1, n_batches: int | None = None) -> PathTracing:
        """Return the tracing with `DENSER` times ``factor`` as many paths, whose noise is lower.

        Paths are thinned as the sound dies away, so that they take about as long, and receivers without
        a stated radius have one of `LARGER` times the cube root of the volume. Where the tracing is
        thinned already, it has ``factor`` times its paths; with a factor of 1 it is this one, with the
        paths that it has traced. ``n_batches`` is another number of batches.
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
        """Return the tracing with other directivities of some sources, and the paths it has traced.

        They have a value per band.
        """
        for name, of in checks.mapped("directivity", directivity).items():
            checks.instance(f"directivity[{checks.shown(name)}]", of, Directivity)
        changed = copy(self)
        for name in ("aimed_sources", "_bands_of_paths"):
            vars(changed).pop(name, None)
        # A key with a band, too, has the paths of its directivity.
        kept = {key: of for key, of in self._traced.items() if len(key) == 2}
        object.__setattr__(changed, "_traced", kept)
        object.__setattr__(changed, "directivity", {**self.directivity, **directivity})
        return changed

    def trace_ahead(self, alpha: Array, factor: float, *, seed: int = 0) -> None:
        """Trace the paths for ``factor`` times Eyring's T for alpha (n_materials, n_bands).

        Simulations with this seed then trace none, unless a decay needs longer paths.
        """
        alpha = check_alpha(self, alpha)
        seconds = min(checks.positive("factor", factor) * eyring_seconds(self.room, alpha), LONGEST)
        for bands in self.bands_of_paths():
            self.traced(int(bands[0]), seconds, seed=seed)

    @property
    def lost_share(self) -> float:
        """Largest share of the paths of a trace that left through gaps of the geometry.

        They are dropped. Of the traces that are kept; 0 before the first.
        """
        return max((traced.lost_share for traced in self._traced.values()), default=0.0)

    def energy(
        self, alpha: Array, seconds: float, *, seed: int = 0, number: int | None = None
    ) -> Array:
        """Return energy decays, (number, n_sources, n_receivers, n_bands, n_bins), in 1/m².

        ``number`` is of groups of batches, by default ``n_batches``, which it divides.
        The source has unit energy. The first bin starts with the first sound. The decays end at
        least ``seconds`` after the emission; see `rtcal.simulators.paths.Paths.energy`. DataError
        for ``seconds`` above `rtcal.simulators.tracer.LONGEST`, or another ``number``.
        """
        alpha = check_alpha(self, alpha)
        self._check_number(number)
        groups = self.bands_of_paths()
        decays = [
            self.traced(int(bands[0]), seconds, seed=seed).energy(
                *self._weighing(alpha, bands), number
            )
            for bands in groups
        ]
        return of_all_bands(groups, decays)

    def observe(
        self,
        alpha: Array,
        match: Sequence[str] = MATCH,
        *,
        seed: int = 0,
        again: bool = True,
    ) -> Observations:
        """Return what each position hears for alpha (n_materials, n_bands).

        The level is G of a source whose power is known. Raises as `simulate` does, and
        `TooShortError` where paths that were traced end too early and are not to be traced ``again``.
        """
        alpha, match = check_alpha(self, alpha), base.checked_parameters(match)
        again = checks.flag("again", again)
        (energy,) = self._groups(alpha, match, 1, seed, None if again else self._followed(seed))
        return self._observed(energy, alpha, match)

    def _followed(self, seed: int) -> float:
        """Return for how many seconds the paths of a seed were followed; `LONGEST` if for none."""
        lengths = [paths.longest for (of, *_), paths in self._traced.items() if of == seed]
        # Rounded down, so that no path is too short for it.
        seconds = min(lengths, default=np.inf) / self.room.speed_of_sound
        return float(min(seconds * (1 - 1e-9), LONGEST))

    def observe_in_groups(
        self, alpha: Array, number: int, match: Sequence[str] = MATCH, *, seed: int = 0
    ) -> Array:
        """Return what groups of the paths hear, (number, n_parameters, n_pairs, n_bands).

        Their differences are the noise of as many paths. ``number`` divides ``n_batches``.
        """
        alpha, match = check_alpha(self, alpha), base.checked_parameters(match)
        groups = self._groups(alpha, match, number, seed)
        return np.array([self._observed(energy, alpha, match).values for energy in groups])

    def _groups(
        self, alpha: Array, match: Sequence[str], number: int, seed: int, most: float | None = None
    ) -> Array:
        """Return the energy decays of groups of the paths, each long enough for ``match``."""
        # Each group is to hold the decay times, so no mean over the groups is asked.
        (groups,) = decay_long_enough(
            lambda seconds: self.energy(alpha, seconds, seed=seed, number=number)[np.newaxis],
            self.room,
            alpha,
            longest(match),
            most,
        )
        return np.asarray(groups)

    def _check_number(self, number: int | None) -> None:
        if number is not None and self.n_batches % checks.whole("number", number, 1):
            raise DataError(f"number = {number} does not divide n_batches = {self.n_batches}")

    def _observed(self, energy: Array, alpha: Array, match: Sequence[str]) -> Observations:
        """Return the observations of energy (n_sources, n_receivers, n_bands, n_bins)."""
        cause = "too little is reflected"
        if np.max(self.room.areas @ alpha) < _REFLECTING * self.room.areas.sum():
            cause = f"{self.n_paths} paths per source are too few. Take a larger n_paths"
        return base.of_decays(
            energy.reshape(len(self.pairs), *energy.shape[2:]),
            self.bin_width,
            match,
            self.pairs,
            self.centre_frequencies,
            cause,
        )

    def jacobian(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Array:
        """Return the derivatives of `observe`, (n_parameters, n_pairs, n_bands, n_materials).

        One sweep of the paths gives those by all materials, because a path that hit material j n times
        has dE / d alpha_j = -n E / (1 - alpha_j). Coefficients above 0.999 count as 0.999. Decay times
        of few paths are staircases in alpha, since the range of levels is fitted bin by bin. Their
        derivatives are those of the mean over the steps: with one seed a difference departs from them,
        in the mean over seeds it does not. Raises as `simulate` does.
        """
        alpha, match = check_alpha(self, alpha), base.checked_parameters(match)
        alpha = np.minimum(alpha, base.LARGEST_ALPHA)
        derivatives = self._derivatives(
            alpha,
            match,
            seed,
            lambda traced, source, by: traced.energy_gradient(source, *by),
        )
        return np.asarray(derivatives[0])

    def scattering_jacobian(
        self, alpha: Array, match: Sequence[str] = MATCH, *, number: int = 2, seed: int = 0
    ) -> Array:
        """Return the derivatives of `observe` by the scattering of each material.

        By its log odds ln(s / (1 - s)), which are changed by as much in all bands. They come from the
        paths of `observe`, of ``number`` independent groups: their mean is the derivative, their
        differences its noise. Materials with s = 0 or 1 have 0. See
        `rtcal.simulators.paths.Paths.scattering_gradient`.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
        match : sequence of str
        number : int
            Divides ``n_batches``.
        seed : int

        Returns
        -------
        array (number, n_parameters, n_pairs, n_bands, n_materials)

        Raises
        ------
        DataError, TooShortError
            As `observe` does, for a ``number`` that does not divide, and if ``scattering_model`` is
            not "random".
        """
        alpha, match = check_alpha(self, alpha), base.checked_parameters(match)
        checks.whole("number", number, 1)
        self._check_number(number)
        return self._derivatives(
            alpha,
            match,
            seed,
            lambda traced, source, by: traced.scattering_gradient(source, *by, number),
        )

    def _weighing(self, alpha: Array, bands: NDArray[np.int64]) -> _Weighing:
        """Return what the paths of some bands are weighed with."""
        bin_length = self.room.speed_of_sound * self.bin_width
        return alpha[:, bands], self.room.air_attenuation[bands], bin_length

    def _derivatives(
        self,
        alpha: Array,
        match: Sequence[str],
        seed: int,
        gradient: _Gradient,
    ) -> Array:
        """Return the derivatives of `observe`, (number, n_parameters, n_pairs, n_bands, n_materials).

        ``gradient`` gives those of the energies in ``number`` groups. Materials that no face has are 0.
        """
        sweeps: list[list[tuple[Array, Array]]] = []
        groups, sources = self.bands_of_paths(), range(len(self.sources))

        def trace(seconds: float) -> Array:
            sweeps.clear()
            with ThreadPoolExecutor(self.workers) as pool:
                for bands in groups:
                    traced = self.traced(int(bands[0]), seconds, seed=seed)
                    by = self._weighing(alpha, bands)
                    sweeps.append([*pool.map(gradient, repeat(traced), sources, repeat(by))])
            decays = [np.stack([energy for energy, _ in sweep]) for sweep in sweeps]
            return of_all_bands(groups, decays)[np.newaxis]

        (decays,) = decay_long_enough(trace, self.room, alpha, longest(match))
        number, n_unknowns = len(sweeps[0][0][1]), self.room.n_materials
        out = np.zeros((number, len(match), *decays.shape[:3], n_unknowns))
        for bands, sweep in zip(groups, sweeps, strict=True):
            for s, (_, of_groups) in enumerate(sweep):
                for of_group, by_bin in zip(out, of_groups, strict=True):
                    of_group[:, s][:, :, bands, : by_bin.shape[2]] = base.chained(
                        decays[s][:, bands], by_bin[:, : decays.shape[-1]], self.bin_width, match
                    )
        return out.reshape(number, len(match), len(self.pairs), self.room.n_bands, n_unknowns)

    def traced(self, band: int, seconds: float, *, seed: int = 0) -> paths.Paths:
        """Return the paths of a band, followed for ``seconds`` or longer.

        The paths of the last seed are kept and returned again. DataError for ``seconds`` above
        `rtcal.simulators.tracer.LONGEST`.
        """
        if checks.whole("band", band, 0) >= self.room.n_bands:
            raise DataError(f"band = {checks.shown(band)} is not from 0 to {self.room.n_bands - 1}")
        longest = check_seconds(seconds) * self.room.speed_of_sound
        columns = [tuple(column) for column in self.scattering.T]
        key = (checks.whole("seed", seed, 0), columns.index(columns[band]))
        if key not in self._traced or self._traced[key].longest < longest:
            if any(other != seed for other, *_ in self._traced):
                self._traced.clear()
            self._traced[key] = self._trace(self.scattering[:, band], longest, seed)
        return self._aimed(key, band) if self.aimed_sources else self._traced[key]

    def bands_of_paths(self) -> list[NDArray[np.int64]]:
        """Return the bands' numbers in groups whose scattering and directivity are the same."""
        return self._bands_of_paths

    @cached_property
    def _bands_of_paths(self) -> list[NDArray[np.int64]]:
        aimed = [of.pattern for of in self.aimed_sources.values()]
        return equal_columns(np.vstack([self.scattering, *aimed]))

    def _aimed(self, key: tuple[int, int], band: int) -> paths.Paths:
        """Return the paths of ``key`` as the sources' directivities in a band weigh them."""
        traced = self._traced[key]
        aimed = self._traced.get((*key, band))
        if aimed is None or aimed.longest != traced.longest:
            lobes = {s: of.in_band(band) for s, of in self.aimed_sources.items()}
            aimed = traced.aimed(lobes, self.to_receivers)
            self._traced[(*key, band)] = aimed
        return aimed

    def _trace(self, scattering: Array, longest: float, seed: int) -> paths.Paths:
        sources, receivers = self._points()
        return paths.trace(
            self.geometry,
            sources,
            receivers,
            materials=self.room.material_rows(self.geometry.materials),
            scattering=scattering,
            radii=self._radii(),
            longest=longest,
            n_paths=self.n_paths,
            n_batches=self.n_batches,
            scattering_model=self.scattering_model,
            seed=seed,
            workers=self.workers,
            thinned=np.inf if self.thinned is None else self.thinned * self.room.speed_of_sound,
        )
