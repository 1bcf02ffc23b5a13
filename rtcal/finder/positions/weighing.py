"""The shifts of every parameter at every position if something of the room is other than stated.

They come from two tracings of the room, so what differs between them is their noise. They are computed
once per room and kept.

The paths of a `PathTracing` do not depend on what the walls absorb. So every change weighs the same
paths anew, and their random numbers cancel in the difference.

An aperture to a second room takes energy as an opening of its area does. The second room gives a part
of it back, late and everywhere: two energy balances (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982),

    dE1/dt = -k1 E1 + b1 E2,   dE2/dt = -k2 E2 + b2 E1,   b = c S / 4V.

The paths, weighed with the opening, give what is heard without a return. Its mean over the receivers of
a source, convolved with h(t), is what comes back to all of them:

    h(t) = b1 b2 (exp(s1 t) - exp(s2 t)) / (s1 - s2),   s = -(k1 + k2)/2 ± sqrt((k1 - k2)²/4 + b1 b2).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from rtcal.acoustics.air import Air
from rtcal.acoustics.observables import MATCH, TARGET, longest
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import Directivity, plain_directivities
from rtcal.files import disk
from rtcal.finder.effects import HARD
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.case import (
    AIMS,
    INDEX_ERROR,
    LOBE_INDEX,
    OWN_INDEX_ERROR,
    PositionsCase,
    lobes,
)
from rtcal.finder.positions.surfaces import Faces
from rtcal.loop.control_runs import scattered, share_of_signal
from rtcal.simulators.base import LARGEST_ALPHA, observe, values_of_decays
from rtcal.simulators.path_tracing import DENSER, LARGER, Paths, PathTracing
from rtcal.simulators.tracer import LONGEST, decay_long_enough, eyring_seconds
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError, TooShortError
from rtcal.support.speed import Progress, TaskProgress
from rtcal.support.types import Array

VOLUMES = (0.3, 0.9, 2.7)
"""Volumes of the second room that are tried, over that of the first."""
ALPHAS = (0.03, 0.08, 0.2)
"""Its mean absorption coefficients."""
SECOND_ROOMS = tuple(product(VOLUMES, ALPHAS))
"""Volume over that of the first room, and mean alpha, of each second room."""
_NEPERS = 6 * np.log(10)
"""ln of the energy's decay in a reverberation time."""
_LARGEST_SHARE = 0.95
"""Of what a room loses, through an aperture."""
_FOLLOWED = 0.9
"""Of the slow reverberation time: 54 dB. T30 needs 50 dB with its margin."""


@dataclass(frozen=True)
class Aperture:
    """An aperture of ``area`` in m² to a second room of ``volume`` in m³ and mean ``alpha``.

    The second room has the surface of a cube.
    """

    area: float
    volume: float
    alpha: float

    def second_rate(self, room: Room) -> Array:
        """Return the rate in 1/s at which the second room's energy decays, (n_bands,)."""
        absorbed = -np.log1p(-self.alpha) * 6 * self.volume ** (2 / 3) + self.area
        air = 4 * self.volume * room.air_attenuation
        return np.asarray(room.speed_of_sound * (absorbed + air) / (4 * self.volume))

    def returned_to(
        self,
        energy: Array,
        room: Room,
        bin_width: float,
        n_sources: int,
        rate: Array | None = None,
    ) -> Array:
        """Return what is heard with the second room.

        Parameters
        ----------
        energy : array (n_pairs, n_bands, n_bins)
            Decays with an opening in place of the aperture, source by source.
        room : Room
        bin_width : float
            In s.
        n_sources : int
        rate : array (n_bands,), optional
            At which the mean decay falls, in 1/s (`decay_rate`); by default it is computed.

        Returns
        -------
        array (n_pairs, n_bands, n_bins)
            With as many more bins as the slower decay needs.
        """
        first = decay_rate(energy, bin_width) if rate is None else rate
        second = self.second_rate(room)
        c = room.speed_of_sound
        # No more can go through it than the room loses: a field that is not diffuse decays more slowly.
        out = np.minimum(c * self.area / (4 * room.volume), _LARGEST_SHARE * first)
        exchange = out * c * self.area / (4 * self.volume)
        root = np.sqrt((first - second) ** 2 / 4 + exchange)
        slow, fast = (first + second) / 2 - root, (first + second) / 2 + root
        seconds = min(_FOLLOWED * _NEPERS / float(slow.min()), LONGEST)
        heard = _followed(energy, first, int(seconds / bin_width), bin_width)
        reverberant = heard.copy()
        reverberant[..., 0] = 0.0  # the direct sound is not what the whole room hears
        shape = (n_sources, -1, *heard.shape[1:])
        mean = reverberant.reshape(shape).mean(axis=1)
        back = np.empty_like(mean)
        for k in range(heard.shape[1]):
            both = [
                lfilter([1.0], [1.0, -np.exp(-rate * bin_width)], mean[:, k])
                for rate in (slow[k], fast[k])
            ]
            back[:, k] = exchange[k] * bin_width * (both[0] - both[1]) / (fast[k] - slow[k])
        return np.asarray((heard.reshape(shape) + back[:, np.newaxis]).reshape(heard.shape))


def decay_rate(energy: Array, bin_width: float) -> Array:
    """Return the rates of the mean decays over pairs in 1/s, (..., n_bands).

    Of decays (..., n_pairs, n_bands, n_bins).
    """
    return np.asarray(_NEPERS / TARGET.value(energy.mean(axis=-3), bin_width))


def _followed(energy: Array, rate: Array, n_bins: int, bin_width: float) -> Array:
    """Return decays that go on exponentially up to a number of bins."""
    missing = n_bins - energy.shape[-1]
    if missing <= 0:
        return energy
    last = max(energy.shape[-1] // 5, 1)
    steps = np.arange(missing + last) - (last - 1)
    course = np.exp(-rate[:, np.newaxis] * bin_width * steps)  # 1 in the last bin that there is
    level = energy[..., -last:].sum(axis=-1) / course[:, :last].sum(axis=-1)
    return np.concatenate([energy, level[..., np.newaxis] * course[:, last:]], axis=-1)


_AT_ONCE = 8
"""Groups of faces in one sweep: their decays share the memory of one room."""


def changed_alpha(alpha: Array, faces: Faces, share: float) -> Array:
    """Return alpha (n_faces, n_bands) with the faces' moved towards 1, or towards a hard wall's."""
    out = alpha.copy()
    if share >= 0:
        out[faces] += share * (1 - out[faces])
    else:
        out[faces] += share * np.maximum(out[faces] - HARD, 0.0)
    return out


@dataclass(eq=False)
class Weighing:
    """The paths of a tracing, weighed with one alpha per face."""

    tracer: PathTracing
    match: Sequence[str]
    seed: int = 0
    seconds: float = 0.0

    @property
    def alpha(self) -> Array:
        """Alpha of each face as it is traced, (n_faces, n_bands): less than 1."""
        room = self.tracer.room
        alpha = np.minimum(room.alpha, LARGEST_ALPHA)
        return np.asarray(alpha[room.material_rows(self.tracer.geometry.materials)])

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

    def of_groups(self, groups: Sequence[Faces], shares: Sequence[float]) -> Iterator[Array]:
        """Yield the decays with each group of faces changed, in one sweep of the paths for many.

        Parameters
        ----------
        groups : sequence of int array
            Numbers of each group's faces.
        shares : sequence of float
            See `changed_alpha`.

        Yields
        ------
        array (n_shares, n_pairs, n_bands, n_bins)
        """
        if not self.seconds:
            self.seconds = eyring_seconds(self.tracer.room, self.tracer.room.alpha)
        for start in range(0, len(groups), _AT_ONCE):
            some = groups[start : start + _AT_ONCE]
            while True:
                energy = self._of_groups(self.alpha, some, shares)
                every = energy.reshape(-1, *energy.shape[2:])
                if self._long_enough(every):
                    break
            yield from energy

    def with_apertures(self, area: float, opened: Array, shares: Sequence[float]) -> Array:
        """Return the parameters with an aperture to each of `SECOND_ROOMS`, for each of its shares.

        Parameters
        ----------
        area : float
            Of the surface in m².
        opened : array (n_shares, n_pairs, n_bands, n_bins)
            Decays with an opening in place of the aperture.
        shares : sequence of float
            Of the surface.

        Returns
        -------
        array (n_parameters, n_pairs, n_bands, n_second_rooms n_shares)
        """
        tracer, room = self.tracer, self.tracer.room
        width, n_sources = tracer.bin_width, len(tracer.sources)
        rates = decay_rate(opened, width)
        decays = [
            Aperture(share * area, volume * room.volume, alpha).returned_to(
                energy, room, width, n_sources, rate
            )
            for volume, alpha in SECOND_ROOMS
            for share, energy, rate in zip(shares, opened, rates, strict=True)
        ]
        lengths = np.array([energy.shape[-1] for energy in decays])
        heard = np.empty((len(self.match), *opened.shape[1:-1], len(decays)))
        for length in np.unique(lengths):
            alike = np.flatnonzero(lengths == length)
            values = self.parameters(np.array([decays[i] for i in alike]))
            heard[..., alike] = np.moveaxis(values, 1, -1)
        return heard

    def parameters(self, energy: Array) -> Array:
        """Return the parameters of decays, (..., n_pairs, n_bands, n_bins), as `observe` does.

        (n_parameters, ..., n_pairs, n_bands).
        """
        pairs, frequencies = self._named
        return values_of_decays(energy, self.tracer.bin_width, self.match, pairs, frequencies)

    @cached_property
    def _named(self) -> tuple[Sequence[tuple[str, str]], Array]:
        """The pairs and bands that an error names."""
        return self.tracer.pairs, self.tracer.centre_frequencies

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
            decay_long_enough(self._probe, room, room.alpha, longest(self.match))
        while True:
            energy = self._energy(alpha, air, stretch, number)
            if self._long_enough(energy):
                return energy

    def _long_enough(self, energy: Array) -> bool:
        """Return whether decays need no longer paths; if they do, the next are longer."""
        if self.seconds >= LONGEST or not longest(self.match).too_short(energy).any():
            return True
        self.seconds = min(1.5 * self.seconds, LONGEST)
        return False

    def _probe(self, seconds: float) -> Array:
        self.seconds = seconds
        return self._energy(self.alpha, self.tracer.room.air_attenuation, 1.0, 1)

    def _energy(self, alpha: Array, attenuation: Array, stretch: float, number: int) -> Array:
        tracer = self.tracer
        width = tracer.room.speed_of_sound * tracer.bin_width
        decays = [
            # Lengths that grow by a factor: bins that are shorter by it, and air that absorbs more.
            self._by_face(int(bands[0])).energy(
                alpha[:, bands], stretch * attenuation[bands], width / stretch, number
            )
            for bands in self._bands
        ]
        return self._joined(decays) / stretch**2

    def _of_groups(self, alpha: Array, groups: Sequence[Faces], shares: Sequence[float]) -> Array:
        """Return decays, (n_groups, n_shares, n_pairs, n_bands, n_bins)."""
        tracer = self.tracer
        # A part's faces have one material, and belong to the same groups.
        held = np.array([np.isin(np.arange(len(alpha)), group) for group in groups])
        made_of = tracer.room.material_rows(tracer.geometry.materials)
        kinds, first, parts = np.unique(
            np.vstack([made_of, held]), axis=1, return_index=True, return_inverse=True
        )
        of_part = alpha[first]
        every = np.arange(len(of_part))
        changed = np.array([changed_alpha(of_part, every, share) for share in shares])
        decays = [
            self._by_face(int(bands[0])).energy_changed(
                alpha[:, bands],
                tracer.room.air_attenuation[bands],
                tracer.room.speed_of_sound * tracer.bin_width,
                parts.reshape(-1),
                kinds[1:].astype(bool),
                changed[..., bands],
            )
            for bands in self._bands
        ]
        joined = self._joined([d.reshape(-1, *d.shape[2:]) for d in decays])
        return joined.reshape(len(groups), len(shares), *joined.shape[1:])

    def _joined(self, decays: Sequence[Array]) -> Array:
        """Return the decays of groups of bands, (n, n_sources, n_receivers, ...), as one array.

        Its shape is (n, n_pairs, n_bands, n_bins).
        """
        n_pairs, n_bins = len(self.tracer.pairs), min(d.shape[-1] for d in decays)
        out = np.empty((len(decays[0]), n_pairs, self.tracer.room.n_bands, n_bins))
        for bands, of_bands in zip(self._bands, decays, strict=True):
            cut = of_bands[..., :n_bins]
            out[:, :, bands] = cut.reshape(len(cut), n_pairs, len(bands), n_bins)
        return out

    @cached_property
    def _bands(self) -> list[NDArray[np.int64]]:
        return self.tracer.bands_of_paths()

    def _by_face(self, band: int) -> Paths:
        """Return the band's paths with each face as a material of its own."""
        traced = self.tracer.traced(band, self.seconds, seed=self.seed)
        n_faces = len(traced.materials)
        return replace(traced, materials=np.arange(n_faces), n_materials=n_faces)


MOVE = 0.5
"""Distance in m by which a source or receiver is displaced, along each axis and both ways."""
_FROM_WALLS = 0.05
"""Least distance in m of a displaced position from a wall."""
_SOURCE_PATHS = 4000
"""Paths from each displaced source."""

_MORE_PATHS = 8
"""Factor of the paths to displaced places where one hears too few of them. In a judged room the
search ended in an error."""


def displaced(
    case: PositionsCase, match: Sequence[str], base: Array, seed: int
) -> dict[str, Array]:
    """Return the shifts where each source or receiver is displaced by `MOVE`, by its name.

    (n_parameters, n_pairs, n_bands, n_displacements) each; ``base`` is what is simulated as stated.
    """
    tracer = case.simulator
    out: dict[str, Array] = {}
    steps = [sign * axis for axis in np.eye(3) for sign in (-MOVE, MOVE)]

    n_sources, n_receivers = len(tracer.sources), len(tracer.receivers)
    shape = (len(match), n_sources, n_receivers, base.shape[-1])
    stated = base.reshape(shape)
    for kind in ("receivers", "sources"):
        points: Mapping[str, object] = getattr(tracer, kind)
        fewer = min(tracer.n_paths, _SOURCE_PATHS) if kind == "sources" else tracer.n_paths
        aimed = {
            f"{name} {i}": of for name, of in tracer.directivity.items() for i in range(len(steps))
        }
        moved = _inside(case, np.array([*points.values()], dtype=float), np.array(steps))
        names = [f"{name} {i}" for name in points for i in range(len(steps))]
        changes: dict[str, Any] = {kind: dict(zip(names, moved, strict=True)), "n_paths": fewer}
        if kind == "sources":
            changes["directivity"] = aimed
        changed = replace(tracer.denser(), **changes)
        try:
            heard = observe(changed, case.room.alpha, match, seed=seed)
        except TooShortError:  # more paths would be as short
            raise
        except DataError:  # a decay with too few paths for its T20
            changed = replace(changed, n_paths=_MORE_PATHS * fewer)
            heard = observe(changed, case.room.alpha, match, seed=seed)
        values = heard.values
        axis = 1 if kind == "sources" else 2
        sizes = list(shape)
        sizes[axis : axis + 1] = [len(points), len(steps)]
        off = np.moveaxis(values.reshape(sizes), axis + 1, -1) - stated[..., np.newaxis]
        for i, name in enumerate(points):
            shift, rows = np.zeros_like(off), (slice(None),) * axis + (i,)
            shift[rows] = off[rows]
            out[f"{kind[:-1]} {name}"] = shift.reshape(*base.shape, len(steps))
    return out


def _inside(case: PositionsCase, points: Array, steps: Array) -> Array:
    """Return each point moved by each step, or by less where a wall is in the way.

    Points (n, 3) and steps (m, 3) in m give (n m, 3).
    """
    shares = np.array([1.0, 0.5, 0.25, -0.5, 0.0])[:, np.newaxis]
    trials = points[:, np.newaxis, np.newaxis] + shares * steps[:, np.newaxis]
    flat = trials.reshape(-1, 3)
    free = case.geometry.contains(flat) & (case.geometry.wall_distance(flat) > _FROM_WALLS)
    free = free.reshape(trials.shape[:-1])
    free[..., -1] = True  # not moved
    first = np.argmax(free, axis=-1)[..., np.newaxis, np.newaxis]
    return np.asarray(np.take_along_axis(trials, first, axis=2).reshape(-1, 3))


SHARES = (-1.0, -0.5, 0.08, 0.25, 0.55, 1.0)
"""Nodes of a surface's alpha: from what it is towards 1, or (below 0) towards that of a hard wall. The
shifts between them are interpolated; halving the distances changes a shift by less than 3 %."""
AIR = (-1.0, -0.5, 0.7, 1.5, 3.0)
"""Nodes of the air: attenuation more than stated, over that at 20 °C and 50 %."""
VOLUME = (-0.5, -0.25, 0.25, 0.5)
"""Nodes of ln volume over what is stated."""
OPEN = tuple(share for share in SHARES if share > 0)
"""Nodes of an aperture: shares of its surface."""


TRACED = (-2.0, -1.0, 1.5)
"""Changes of the log odds at which the whole room is traced, from what is stated or assumed. From 0.4
they lead to 0.08, 0.2 and 0.75."""


_FEW_PATHS = 1600
"""Paths from each source that tell how long the others must be."""
_SPARE = 1.15
"""By how much longer they are, since a decay's length differs between few paths and many."""

BASE = 8
"""Factor of the number of paths that are weighed, besides that of `PathTracing.denser`. The shifts of
T20, EDT and C80 differ little between the pairs: with 6000 paths per source, noise had five times the
spread of what is there, and with 48,000 less than twice the spread."""
TRACINGS = 2
"""Independent tracings that are weighed. Where a surface changes, T20 changes by nearly as much at any
pair: in four rooms of the geometric world what differed was noise. So a single tracing gave every
surface a pattern over the pairs that no room has."""
STEP = 0.08
"""Share of the way to 1 by which a material's alpha moves for the derivatives by alpha."""


@dataclass(frozen=True, eq=False)
class PairShifts:
    """Shifts of the parameters at all pairs of a simulator.

    Attributes
    ----------
    parameters : tuple of str
    columns : mapping of str to array (n_parameters, n_pairs, n_bands, n_columns)
        - "base": what the simulator hears as stated, with `TRACINGS` times `BASE` times its paths;
        - "surface 0", ..., "part 0", ...: shifts at the nodes `SHARES` of each surface, and of each of
          the case's ``divided.parts``;
        - "aperture 0", ...: at the nodes `OPEN` of each surface for each of `SECOND_ROOMS`; 0 for a
          floor;
        - "air", "volume": at the nodes `AIR` and `VOLUME`;
        - "source S1", "receiver R1", ...: where it is displaced by `MOVE`;
        - "levels": where the whole room scatters more or less, by `TRACED`;
        - "aimed": where the sources have other lobes (`rtcal.finder.positions.case.lobes`);
        - "materials": where a material's alpha is larger by `STEP` of the way to 1;
        - "scattering": derivatives by the log odds of each material's scattering coefficient;
        - "noise": deviations of what groups of paths hear from the mean of their tracing. Each group
          has as many paths as the simulator in the control runs;
        - "noise of scattering": the same of the derivatives, group by group.
    """

    parameters: tuple[str, ...]
    columns: Mapping[str, Array]

    @property
    def base(self) -> Array:
        """What is heard as stated, (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.columns["base"][..., 0])

    def at(self, parameters: Sequence[str], pairs: Sequence[int]) -> PairShifts:
        """Return the shifts of some parameters at some pairs, by number."""
        rows = [self.parameters.index(name) for name in parameters]
        some = {name: values[rows][:, pairs] for name, values in self.columns.items()}
        return PairShifts(tuple(parameters), some)


def parameters(case: PositionsCase) -> tuple[str, ...]:
    """Return the parameters that are computed: all usual ones, so that any choice of them is kept."""
    return tuple(dict.fromkeys((*MATCH, *case.match)))


def responses_of(
    case: PositionsCase,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> PairShifts:
    """Return the shifts in a case's room, from a folder where they are kept or newly weighed."""
    path = None
    if cache is not None:
        path = checks.path("cache", cache) / f"{key_of(case, seed)}.array"
        if (kept := _read(path, case)) is not None:
            return kept
    made = _weighed(case, seed, progress)
    if path is not None:
        disk.write(path, np.concatenate([made.columns[n] for n in _sizes(case)], axis=-1))
    return made


def _weighed(case: PositionsCase, seed: int, progress: TaskProgress | None) -> PairShifts:
    match = parameters(case)

    def telling(tracing: int) -> Progress:
        def tell(done: int, total: int) -> None:
            if progress is not None:
                progress(f"surfaces, tracing {tracing} of {TRACINGS}", done, total)

        return tell

    seconds, aimed = _seconds(case, match, seed), lobes(case.simulator)
    seeds = range(TRACINGS * seed, TRACINGS * (seed + 1))
    return _mean(
        [
            _of_tracing(case, match, s, seconds, aimed, telling(t))
            for t, s in enumerate(seeds, start=1)
        ]
    )


def _of_tracing(
    case: PositionsCase,
    match: tuple[str, ...],
    seed: int,
    seconds: float,
    directivities: Sequence[Mapping[str, Directivity]],
    progress: Progress,
) -> PairShifts:
    """Return the shifts of one tracing, whose paths are followed for ``seconds`` at least."""
    tracer = _retraced(case.simulator.denser(BASE), geometry=case.divided.geometry)
    weighing = Weighing(tracer, match, seed, seconds)
    energy = weighing.energy(weighing.alpha, number=BASE)
    base = weighing.parameters(energy.mean(axis=0))
    groups = np.ascontiguousarray(np.moveaxis(weighing.parameters(energy), 1, 0))
    columns = _of_surfaces(case, weighing, base, progress)
    room = case.room
    reference = Air(20, 50).attenuation(room.centre_frequencies)
    air = [
        weighing.observe(weighing.alpha, np.maximum(room.air_attenuation + t * reference, 0.0))
        for t in AIR
    ]
    volume = [weighing.observe(weighing.alpha, stretch=float(np.exp(t / 3))) for t in VOLUME]
    aimed: list[Array] = []
    for i, of in enumerate(directivities):
        if (
            i and of == directivities[i - 1]
        ):  # only sources of which nothing is stated aim elsewhere
            aimed.append(aimed[-1])
        elif of:
            aimed.append(replace(weighing, tracer=tracer.aimed(of)).observe(weighing.alpha))
        else:
            aimed.append(base)
    # Only paths of the model "random" tell the derivatives.
    if tracer.scattering_model != "random":
        tracer = _retraced(tracer, scattering_model="random")
    slopes = tracer.scattering_jacobian(room.alpha, match, number=BASE, seed=seed)
    scattering = slopes.mean(axis=0)
    off = np.moveaxis(slopes - scattering, 0, -2)
    columns |= {
        "base": base[..., np.newaxis],
        "air": np.stack(air, axis=-1) - base[..., np.newaxis],
        "volume": np.stack(volume, axis=-1) - base[..., np.newaxis],
        "levels": _at_levels(case, match, base, seed),
        "aimed": np.stack(aimed, axis=-1) - base[..., np.newaxis],
        "scattering": scattering,
        "noise": np.moveaxis(groups - groups.mean(axis=0), 0, -1),
        "noise of scattering": off.reshape(*base.shape, -1),
        **displaced(case, match, base, seed),
    }
    return PairShifts(match, columns)


def _at_levels(case: PositionsCase, match: Sequence[str], base: Array, seed: int) -> Array:
    """Return the shifts where the room scatters more or less; see `PairShifts.levels`."""
    shifts = []
    for change in TRACED:
        of_materials = np.full(case.room.n_materials, change)
        tracer = scattered(case.simulator, of_materials, case.simulator.scattering_model)
        heard = tracer.denser().observe(case.room.alpha, match, seed=seed)
        shifts.append(heard.values - base)
    return np.stack(shifts, axis=-1)


_QUIET = ("surface", "part", "aperture", "air", "volume", "materials", "scattering")
"""Kinds of shifts whose differences between the pairs are drawn to their mean."""


def _mean(tracings: Sequence[PairShifts]) -> PairShifts:
    """Return the mean of tracings, its shifts as far as they differ between the pairs by no noise."""
    out: dict[str, Array] = {}
    kinds: dict[str, list[str]] = {}
    for name in tracings[0].columns:
        kinds.setdefault(name if name.startswith("noise") else name.split()[0], []).append(name)
    for kind, names in kinds.items():
        every = np.array([[made.columns[name] for name in names] for made in tracings])
        if kind.startswith("noise"):
            out[kind] = np.concatenate(every[:, 0], axis=-1)
        else:
            mean = without_noise(every) if kind in _QUIET else every.mean(axis=0)
            out |= dict(zip(names, mean, strict=True))
    return PairShifts(tracings[0].parameters, out)


def without_noise(shifts: Array) -> Array:
    """Return the mean of shifts of tracings, their differences between pairs drawn to their mean.

    They are drawn as far as they are noise, by parameter. ``shifts`` (n_tracings, ..., n_parameters,
    n_pairs, n_bands, n_nodes).
    """
    mean = shifts.mean(axis=0)
    common = mean.mean(axis=-3, keepdims=True)
    off = shifts - mean
    off = off - off.mean(axis=-3, keepdims=True)
    n = len(shifts)

    def square(values: Array) -> Array:
        axes = tuple(a for a in range(mean.ndim) if a != mean.ndim - 4)
        return np.asarray((values**2).mean(axis=axes, keepdims=True))

    noise = np.mean([square(one) for one in off], axis=0) / (n - 1)
    return np.asarray(common + share_of_signal(square(mean - common), noise) * (mean - common))


def _seconds(case: PositionsCase, match: Sequence[str], seed: int) -> float:
    """Return how long paths must be where any surface is hard, so that they are traced once."""
    few = Weighing(_retraced(case.simulator, n_paths=_FEW_PATHS), match, seed)
    for _ in few.of_groups([*case.faces.values()], [min(SHARES)]):
        pass
    return min(_SPARE * few.seconds, LONGEST)


def _of_surfaces(
    case: PositionsCase, weighing: Weighing, base: Array, progress: Progress
) -> dict[str, Array]:
    """Return the shifts by surfaces, parts, apertures and materials; see `PairShifts`."""
    room, divided = case.room, case.divided
    made_of = room.material_rows(divided.geometry.materials)
    of_materials = [np.flatnonzero(made_of == row) for row in range(room.n_materials)]
    of_parts = [part.faces for part in divided.parts]
    groups = {frozenset(f.tolist()): f for f in (*divided.surfaces, *of_parts)}
    by_surface = [frozenset(faces.tolist()) for faces in divided.surfaces]
    names = dict(zip(by_surface, case.faces, strict=True))
    # An alpha of 1 leaves no sound after the first reflection where a surface is all of the room.
    shares = [*(min(t, 0.98) for t in SHARES), STEP]
    shifts, apertures = {}, {}
    for members, decays in zip(groups, weighing.of_groups([*groups.values()], shares), strict=True):
        shifts[members] = _at_shares(weighing, decays) - base[..., np.newaxis]
        if members in names:
            apertures[members] = _apertures(case, weighing, names[members], decays, base)
        progress(len(shifts), len(groups))
    # Several surfaces together: paths would be followed for long where all of them are hard.
    other = {frozenset(f.tolist()): f for f in of_materials if frozenset(f.tolist()) not in groups}
    for members, (decay,) in zip(other, weighing.of_groups([*other.values()], [STEP]), strict=True):
        shifts[members] = (weighing.parameters(decay) - base)[..., np.newaxis]
    by_material = [shifts[frozenset(f.tolist())][..., -1] for f in of_materials]
    return {
        **{f"surface {j}": shifts[members][..., :-1] for j, members in enumerate(by_surface)},
        **{f"part {p}": shifts[frozenset(f.tolist())][..., :-1] for p, f in enumerate(of_parts)},
        **{f"aperture {j}": apertures[members] for j, members in enumerate(by_surface)},
        "materials": np.stack(by_material, axis=-1),
    }


def _at_shares(weighing: Weighing, decays: Array) -> Array:
    """Return the parameters of decays at rising shares, (n_parameters, n_pairs, n_bands, n_shares).

    A surface that takes nearly all may leave a decay without EDT or T. Then the parameters are those
    at the share before: more absorption is not told from it.
    """
    try:
        return np.moveaxis(weighing.parameters(decays), 1, -1)
    except DataError:
        pass  # one by one
    heard: list[Array] = []
    for energy in decays:
        try:
            heard.append(weighing.parameters(energy))
        except TooShortError:
            raise
        except DataError:
            if not heard:
                raise
            heard.append(heard[-1])
    return np.stack(heard, axis=-1)


def _apertures(
    case: PositionsCase, weighing: Weighing, name: str, decays: Array, base: Array
) -> Array:
    """Return the shifts with an aperture on a surface, from its decays at `SHARES`."""
    if of_room.kind(case.geometry, case.faces[name]) == "floor":
        return np.zeros((*base.shape, len(SECOND_ROOMS) * len(OPEN)))
    opened = decays[[SHARES.index(share) for share in OPEN]]
    return weighing.with_apertures(case.areas[name], opened, OPEN) - base[..., np.newaxis]


def _retraced(tracer: PathTracing, **changes: object) -> PathTracing:
    return replace(tracer, **changes)  # type: ignore[arg-type]


def _sizes(case: PositionsCase) -> dict[str, int]:
    """Return the number of columns of each kind of shift, in the order of a file."""
    tracer, n_materials, n_groups = case.simulator, case.room.n_materials, TRACINGS * BASE
    places = [
        f"{kind[:-1]} {n}" for kind in ("receivers", "sources") for n in getattr(tracer, kind)
    ]
    return {
        "base": 1,
        "materials": n_materials,
        "scattering": n_materials,
        "air": len(AIR),
        "volume": len(VOLUME),
        "levels": len(TRACED),
        "aimed": len(AIMS),
        "noise": n_groups,
        "noise of scattering": n_groups * n_materials,
        **{f"surface {j}": len(SHARES) for j in range(len(case.faces))},
        **{f"part {p}": len(SHARES) for p in range(len(case.divided.parts))},
        **{f"aperture {j}": len(OPEN) * len(SECOND_ROOMS) for j in range(len(case.faces))},
        **dict.fromkeys(places, 6),
    }


def _read(path: Path, case: PositionsCase) -> PairShifts | None:
    """Return the shifts that a file holds; None if it cannot be used."""
    packed, sizes = disk.read(path), _sizes(case)
    shape = (len(parameters(case)), len(case.simulator.pairs), case.room.n_bands)
    if packed is None or packed.shape != (*shape, sum(sizes.values())):
        return None
    if not np.isfinite(packed).all():
        return None
    each = np.split(packed, np.cumsum([*sizes.values()])[:-1], axis=-1)
    return PairShifts(parameters(case), dict(zip(sizes, each, strict=True)))


def key_of(case: PositionsCase, seed: int) -> str:
    """Return a hash of all that the shifts depend on."""
    tracer, room, geometry = case.simulator, case.room, case.geometry
    content = [
        "where, all paths",
        tracer.name,
        tracer.scattering_model,
        [tracer.n_paths, tracer.n_batches, tracer.radius, tracer.bin_width],
        [
            np.minimum(room.alpha, LARGEST_ALPHA).tolist(),
            *(room.to_dict()[name] for name in ("centre_frequencies", "air")),
        ],
        geometry.vertices.tolist(),
        [list(map(int, face)) for face in geometry.faces],
        list(geometry.materials),
        {n: f.tolist() for n, f in case.faces.items()},
        [part.faces.tolist() for part in case.divided.parts],
        {name: list(map(float, p)) for name, p in {**tracer.sources, **tracer.receivers}.items()},
        np.asarray(tracer.scattering).tolist(),
        plain_directivities(tracer.directivity),
        list(parameters(case)),
        [TRACINGS, BASE, DENSER, LARGER, STEP, seed],
        [LOBE_INDEX, INDEX_ERROR, OWN_INDEX_ERROR],
        [SHARES, SECOND_ROOMS, AIR, VOLUME, TRACED, MOVE, __version__],
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]
