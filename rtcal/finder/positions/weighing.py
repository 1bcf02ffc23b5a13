"""The shifts of every parameter at every position if something of the room is other than stated.

The paths of a `PathTracing` do not depend on what the walls absorb. So every change weighs the same
paths anew, and their random numbers cancel in the difference. The shifts come from two tracings of the
room, so what differs between them is their noise. They are computed once per room and kept.

An aperture to a second room takes energy as an opening of its area does. The second room gives a part
of it back, late and everywhere: two energy balances (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982),

    dE1/dt = -k1 E1 + b1 E2,   dE2/dt = -k2 E2 + b2 E1,   b = c S / 4V.

The paths, weighed with the opening, give the decays without a return. Its mean over the receivers of
a source, convolved with h(t), is what comes back to all of them:

    h(t) = b1 b2 (exp(s1 t) - exp(s2 t)) / (s1 - s2),   s = -(k1 + k2)/2 ± sqrt((k1 - k2)²/4 + b1 b2).

Sources may have another directivity and gain than stated (docs/where_method.md). A lobe moves the level
and the early parameters, and T hardly at all, as much does that a room may lack: `lobes`. Whether G is
calibrated rightly is the mean of three likelihoods: as calibrated, with another gain, and with one in
each band.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.observables import MATCH, TARGET, longest
from rtcal.acoustics.room import LARGEST_INDEX, Directivity, Room
from rtcal.files import disk
from rtcal.finder.case import PositionsCase
from rtcal.finder.effects import HARD
from rtcal.finder.positions.surfaces import Faces
from rtcal.loop import measured_pairs
from rtcal.loop.measured_pairs import Pair, scattered, share_of_signal
from rtcal.simulators.base import LARGEST_ALPHA, Observations, observe, values_of_decays
from rtcal.simulators.path_tracing import (
    DENSER,
    LARGER,
    LONGEST,
    Paths,
    PathTracing,
    eyring_seconds,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, TooShortError
from rtcal.support.speed import TaskProgress
from rtcal.support.types import Array
from rtcal.support.workers import workforce

VOLUMES = (0.3, 0.9, 2.7)
"""Volumes of the second room that are tried, over that of the first."""
ALPHAS = (0.03, 0.08, 0.2)
"""Its mean absorption coefficients."""
SECOND_ROOMS = tuple(product(VOLUMES, ALPHAS))
"""Volume over that of the first room, and mean alpha, of each second room."""
_NEPERS = 6 * np.log(10)  # ln of the energy's decay in a reverberation time
_LARGEST_SHARE = 0.95  # of what a room loses, through an aperture
_FOLLOWED = 0.9  # of the slow reverberation time: 54 dB. T30 needs 50 dB with its margin.


@dataclass(frozen=True)
class Aperture:
    """Describe an aperture of ``area`` m² to a cube of ``volume`` m³ with the mean alpha ``alpha``."""

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
        """Return decays with the second room from those of an open aperture.

        Both are (n_pairs, n_bands, n_bins), for all receivers of the first source, then of the
        next; the result has more bins if the second room decays more slowly.
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
        decays = energy
        if (missing := int(seconds / bin_width) - energy.shape[-1]) > 0:
            last = max(energy.shape[-1] // 5, 1)
            steps = np.arange(missing + last) - (last - 1)
            course = np.exp(-first[:, np.newaxis] * bin_width * steps)  # 1 in the last bin there is
            level = energy[..., -last:].sum(axis=-1) / course[:, :last].sum(axis=-1)
            further = level[..., np.newaxis] * course[:, last:]
            decays = np.concatenate([energy, further], axis=-1)
        decays = decays.reshape(n_sources, -1, *decays.shape[1:])
        reverberant = decays.copy()
        reverberant[..., 0] = 0.0  # the second room takes no direct sound
        mean = reverberant.mean(axis=1)
        rates = np.stack([slow, fast])[:, np.newaxis, :, np.newaxis]
        late, early = _decaying(mean, np.exp(-rates * bin_width))
        back = (exchange * bin_width / (fast - slow))[:, np.newaxis] * (late - early)
        return np.asarray((decays + back[:, np.newaxis]).reshape(-1, *decays.shape[2:]))


def _decaying(values: Array, factor: Array) -> Array:
    """Return y with y_n = x_n + ``factor`` y_(n-1) along the last axis of the values x."""
    out, step = values + np.zeros_like(factor), 1
    # Sums of 2, 4, 8, ... values. SciPy's filters take half a second to import.
    while step < out.shape[-1]:
        out[..., step:] += factor * out[..., :-step]
        factor, step = factor**2, 2 * step
    return np.asarray(out)


def decay_rate(energy: Array, bin_width: float) -> Array:
    """Return the rates in 1/s of mean decays (..., n_pairs, n_bands, n_bins) over the pairs."""
    return np.asarray(_NEPERS / TARGET.value(energy.mean(axis=-3), bin_width))


_AT_ONCE = 8
"""Least number of groups of faces in one sweep, in which the paths' energies are computed once."""
_TOGETHER = 8_000_000
"""Energies in one sweep where more groups than those are swept together: 64 MB of them."""


@dataclass(eq=False)
class Weighing:
    """Compute decays for other coefficients of each face, without tracing new paths.

    Paths are followed for ``seconds`` (0: by the room's T), and longer if ``match`` needs it.
    """

    tracer: PathTracing
    match: Sequence[str]
    seed: int = 0
    seconds: float = 0.0

    @property
    def alpha(self) -> Array:
        """Alpha of each face as it is traced, (n_faces, n_bands): less than 1."""
        return np.asarray(np.minimum(self.tracer.room.alpha, LARGEST_ALPHA)[self.tracer.made_of])

    def parameters(self, energy: Array) -> Array:
        """Return the parameters of decays (..., n_pairs, n_bands, n_bins), parameters first."""
        tracer = self.tracer
        named = tracer.pairs, tracer.centre_frequencies
        return values_of_decays(energy, tracer.bin_width, self.match, *named)

    def observe(
        self, alpha: Array, attenuation: Array | None = None, stretch: float = 1.0
    ) -> Array:
        """Return the parameters of `energy`, (n_parameters, n_pairs, n_bands)."""
        return self.parameters(self.energy(alpha, attenuation, stretch)[0])

    def energy(
        self,
        alpha: Array,
        attenuation: Array | None = None,
        stretch: float = 1.0,
        number: int = 1,
    ) -> Array:
        """Return the decays of groups of paths, (number, n_pairs, n_bands, n_bins).

        ``alpha`` is that of the faces, ``attenuation`` (n_bands,) replaces the air's, and
        ``stretch`` is a factor on all lengths.
        """
        room = self.tracer.room
        # Lengths that grow by a factor: bins that are shorter by it, and air that absorbs more.
        air = stretch * (room.air_attenuation if attenuation is None else attenuation)
        width = room.speed_of_sound * self.tracer.bin_width / stretch

        def weighed(paths: Paths, bands: NDArray[np.int64]) -> Array:
            return paths.energy(alpha[:, bands], air[bands], width, number)

        return self._long_enough(weighed, 1.5 if self.seconds else 2.0) / stretch**2

    def of_groups(self, groups: Sequence[Faces], shares: Sequence[float]) -> Iterator[Array]:
        """Yield decays (n_shares, n_pairs, n_bands, n_bins) with changed alpha of each group of faces.

        ``shares`` are of the way to alpha = 1 or, below 0, to a hard wall.
        """
        room, alpha = self.tracer.room, self.alpha
        ways = {True: 1 - alpha, False: np.maximum(alpha - HARD, 0.0)}
        changed = np.array([alpha + share * ways[share >= 0] for share in shares])
        width, air = room.speed_of_sound * self.tracer.bin_width, room.air_attenuation
        seconds = max(self.seconds, eyring_seconds(room, room.alpha))
        of_group = changed[:, 0].size * len(self.tracer.pairs) * seconds / self.tracer.bin_width
        at_once = max(int(_TOGETHER / of_group), _AT_ONCE)
        for start in range(0, len(groups), at_once):
            some = groups[start : start + at_once]
            held = np.array([np.isin(np.arange(len(alpha)), group) for group in some])

            def weighed(paths: Paths, bands: NDArray[np.int64], held: Any = held) -> Array:
                by = alpha[:, bands], air[bands], width
                return paths.energy_changed(*by, held, changed[..., bands])

            yield from self._long_enough(weighed, 1.5)

    def _long_enough(
        self, weighed: Callable[[Paths, NDArray[np.int64]], Array], growth: float
    ) -> Array:
        """Return the decays by source and receiver of paths that are followed long enough."""
        tracer, faces = self.tracer, np.arange(len(self.tracer.made_of))

        def by_face(paths: Paths, bands: NDArray[np.int64]) -> Array:
            return weighed(replace(paths, materials=faces, n_materials=len(faces)), bands)

        self.seconds = self.seconds or eyring_seconds(tracer.room, tracer.room.alpha)
        while True:
            every = tracer.swept(by_face, self.seconds, seed=self.seed)
            energy = every.reshape(*every.shape[:-4], len(tracer.pairs), *every.shape[-2:])
            if self.seconds >= LONGEST or not longest(self.match).too_short(energy).any():
                return energy
            self.seconds = min(growth * self.seconds, LONGEST)


MOVE = 0.5
"""Distance in m by which a source or receiver is displaced, along each axis and both ways."""
_FROM_WALLS = 0.05  # least distance in m of a displaced position from a wall
_SOURCE_PATHS = 4000  # paths from each displaced source
_MORE_PATHS = 8
"""Factor of the paths to displaced places where too few of them arrive at one. In a judged room the
search ended in an error."""


def displaced(
    case: PositionsCase, match: Sequence[str], base: Array, seed: int
) -> dict[str, Array]:
    """Return how values change if a source or receiver is displaced by `MOVE`, by its name."""
    tracer, geometry = case.simulator, case.geometry
    steps = np.array([sign * axis for axis in np.eye(3) for sign in (-MOVE, MOVE)])
    # Less where a wall is in the way.
    tried = np.array([1.0, 0.5, 0.25, -0.5, 0.0])[:, np.newaxis] * steps[:, np.newaxis]
    stated = base.reshape(len(match), len(tracer.sources), len(tracer.receivers), -1)
    out: dict[str, Array] = {}
    for axis, kind in ((2, "receivers"), (1, "sources")):
        points: Mapping[str, object] = getattr(tracer, kind)
        places = np.array([*points.values()], dtype=float)[:, np.newaxis, np.newaxis] + tried
        flat = places.reshape(-1, 3)
        free = geometry.contains(flat) & (geometry.wall_distance(flat) > _FROM_WALLS)
        free = free.reshape(places.shape[:-1])
        free[..., -1] = True  # not moved
        first = np.argmax(free, axis=-1)[..., np.newaxis, np.newaxis]
        moved = np.take_along_axis(places, first, axis=2).reshape(-1, 3)
        names = [f"{name} {i}" for name in points for i in range(len(steps))]
        changes: dict[str, Any] = {kind: dict(zip(names, moved, strict=True))}
        fewer = tracer.n_paths
        if kind == "sources":
            fewer = min(fewer, _SOURCE_PATHS)
            changes["directivity"] = {
                f"{name} {i}": of
                for name, of in tracer.directivity.items()
                for i in range(len(steps))
            }
        changed = replace(tracer.denser(), n_paths=fewer, **changes)
        try:
            simulated = observe(changed, case.room.alpha, match, seed=seed)
        except TooShortError:  # more paths would be as short
            raise
        except DataError:  # a decay with too few paths for its T20
            changed = replace(changed, n_paths=_MORE_PATHS * fewer)
            simulated = observe(changed, case.room.alpha, match, seed=seed)
        by_step = list(stated.shape)
        by_step[axis : axis + 1] = [len(points), len(steps)]
        values = np.moveaxis(simulated.values.reshape(by_step), axis + 1, -1)
        for i, name in enumerate(points):
            shift, rows = np.zeros_like(values), (slice(None),) * axis + (i,)
            shift[rows] = values[rows] - stated[rows][..., np.newaxis]
            out[f"{kind[:-1]} {name}"] = shift.reshape(*base.shape, len(steps))
    return out


SHARES = (-1.0, -0.5, 0.08, 0.25, 0.55, 1.0)
"""Nodes of a surface's alpha: from what it is towards 1, or (below 0) towards that of a hard wall. The
shifts between them are interpolated; halving the distances changes a shift by less than 3 %."""
AIR = (-1.0, -0.5, 0.7, 1.5, 3.0)
"""Nodes of the air: attenuation more than stated, over that at 20 °C and 50 %."""
VOLUME = (-0.5, -0.25, 0.25, 0.5)
"""Nodes of ln volume over what is stated."""
OPEN = tuple(share for share in SHARES if share > 0)
"""Nodes of an aperture: shares of its surface."""


def interpolation(nodes: Sequence[float], at: Array) -> Array:
    """Return weights (..., n_nodes) of a linear interpolation that is 0 at 0."""
    every = np.array(sorted([*nodes, 0.0]))
    alone = np.eye(len(every))[np.searchsorted(every, nodes)]
    return np.stack([np.interp(at, every, row) for row in alone], axis=-1)


TRACED = (-2.0, -1.0, 1.5)
"""Changes of the log odds at which the whole room is traced, from what is stated or assumed. From 0.4
they lead to 0.08, 0.2 and 0.75."""
_FEW_PATHS = 1600  # paths from each source that tell how long the others must be
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
    """Hold how the parameters change at all pairs of a simulator with each possible effect."""

    parameters: tuple[str, ...]
    pairs: tuple[Pair, ...]
    columns: Mapping[str, Array]
    """By name, (n_parameters, n_pairs, n_bands, n_columns):

    - "base": what is simulated as stated, with `TRACINGS` times `BASE` times its paths;
    - "surface 0", ..., "part 0", ...: shifts at the nodes `SHARES` of each surface, and of each of the
      case's ``divided.parts``;
    - "aperture 0", ...: at the nodes `OPEN` of each surface for each of `SECOND_ROOMS`; 0 for a floor;
    - "air", "volume": at the nodes `AIR` and `VOLUME`;
    - "source S1", "receiver R1", ...: where it is displaced by `MOVE`;
    - "levels": where the whole room scatters more or less, by `TRACED`;
    - "aimed": where the sources have other `lobes`;
    - "materials": where a material's alpha is larger by `STEP` of the way to 1;
    - "scattering": derivatives by the log odds of each material's scattering coefficient;
    - "noise": deviations of groups of paths from the mean of their tracing. Each group has as many
      paths as the simulator in the reference simulations;
    - "noise of scattering": the same of the derivatives, group by group."""

    @property
    def base(self) -> Array:
        """Values that are simulated with the input coefficients, (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.columns["base"][..., 0])

    def at(self, like: Observations) -> PairShifts:
        """Return the shifts of some parameters at some pairs."""
        rows = [self.parameters.index(name) for name in like.parameters]
        pairs = [self.pairs.index(pair) for pair in like.pairs]
        some = {name: values[rows][:, pairs] for name, values in self.columns.items()}
        return PairShifts(like.parameters, like.pairs, some)


def parameters(case: PositionsCase) -> tuple[str, ...]:
    """Return the parameters that are computed: all usual ones, so that any choice of them is kept."""
    return tuple(dict.fromkeys((*MATCH, *case.match)))


def responses_of(
    case: PositionsCase,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
    scheduler: str | None = None,
) -> PairShifts:
    """Return how the values of a case's room change, from the folder ``cache`` or newly computed."""
    match, pairs = parameters(case), case.simulator.pairs
    path = None
    if cache is not None:
        path = checks.path("cache", cache) / f"{key_of(case, seed)}.array"
        kept: Any = disk.read(path)
        if kept is not None and kept.dtype.names:
            columns = {name: np.ascontiguousarray(kept[name]) for name in kept.dtype.names}
            return PairShifts(match, pairs, columns)
    # Paths are as long as they must be where any surface is hard, so that they are traced once.
    few = Weighing(replace(case.simulator, n_paths=_FEW_PATHS), match, seed)
    for _ in few.of_groups([*case.faces.values()], [min(SHARES)]):
        pass
    seconds, aimed = min(_SPARE * few.seconds, LONGEST), lobes(case.simulator)
    task = partial(_of_tracing, case, match, seconds, aimed)
    seeds = range(TRACINGS * seed, TRACINGS * (seed + 1))
    steps = len(case.divided.surfaces) + len(case.divided.parts)
    told = progress and partial(progress, "surfaces")
    with workforce(scheduler, threads=1) as workers:  # a tracing takes all cores
        tracings = [*workers.in_order(task, seeds, told, steps=steps)]
    made = PairShifts(match, pairs, _mean(tracings))
    if path is not None:
        kinds = [(name, float, values.shape[-1:]) for name, values in made.columns.items()]
        packed = np.empty(made.base.shape, dtype=kinds)
        for name, values in made.columns.items():
            packed[name] = values
        disk.write(path, packed)
    return made


def _of_tracing(
    case: PositionsCase,
    match: tuple[str, ...],
    seconds: float,
    directivities: Sequence[Mapping[str, Directivity]],
    seed: int,
    finished: Callable[[int], None],
) -> dict[str, Array]:
    """Return the shifts of one tracing; call ``finished`` with how many surfaces are done."""
    room = case.room
    tracer = replace(case.simulator.denser(BASE), geometry=case.divided.geometry)
    weighing = Weighing(tracer, match, seed, seconds)
    alpha, energy = weighing.alpha, weighing.energy(weighing.alpha, number=BASE)
    base = weighing.parameters(energy.mean(axis=0))
    groups = np.moveaxis(weighing.parameters(energy), 1, -1)

    def shifts(values: Sequence[Array]) -> Array:
        return np.stack(values, axis=-1) - base[..., np.newaxis]

    reference = Air(20, 50).attenuation(room.centre_frequencies)
    airs = [np.maximum(room.air_attenuation + t * reference, 0.0) for t in AIR]
    aimed: list[Array] = []
    for i, of in enumerate(directivities):
        if i and of == directivities[i - 1]:  # only those of which nothing is stated aim elsewhere
            aimed.append(aimed[-1])
        else:
            aimed.append(replace(weighing, tracer=tracer.aimed(of)).observe(alpha) if of else base)
    columns = _of_surfaces(case, weighing, base, finished)
    columns |= {
        "base": base[..., np.newaxis],
        "air": shifts([weighing.observe(alpha, air) for air in airs]),
        "volume": shifts([weighing.observe(alpha, stretch=np.exp(t / 3)) for t in VOLUME]),
        "aimed": shifts(aimed),
    }
    # Only paths of the model "random" tell the derivatives.
    if tracer.scattering_model != "random":
        tracer = replace(tracer, scattering_model="random")
    slopes = tracer.scattering_jacobian(room.alpha, match, number=BASE, seed=seed)
    scattering = slopes.mean(axis=0)
    levels = []
    for change in TRACED:
        of_materials = np.full(room.n_materials, change)
        other = scattered(case.simulator, of_materials, case.simulator.scattering_model)
        levels.append(other.denser().observe(room.alpha, match, seed=seed).values)
    return columns | {
        "levels": shifts(levels),
        "scattering": scattering,
        "noise": groups - groups.mean(axis=-1, keepdims=True),
        "noise of scattering": np.moveaxis(slopes - scattering, 0, -2).reshape(*base.shape, -1),
        **displaced(case, match, base, seed),
    }


_QUIET = ("surface", "part", "aperture", "air", "volume", "materials", "scattering")
"""Kinds of shifts whose differences between the pairs are drawn to their mean."""


def _mean(tracings: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Return the mean of tracings, its shifts as far as they differ between the pairs by no noise."""
    out: dict[str, Array] = {}
    kinds: dict[str, list[str]] = {}
    for name in tracings[0]:
        kinds.setdefault(name if name.startswith("noise") else name.split()[0], []).append(name)
    for kind, names in kinds.items():
        every = np.array([[made[name] for name in names] for made in tracings])
        if kind.startswith("noise"):
            out[kind] = np.concatenate(every[:, 0], axis=-1)
        else:
            mean = without_noise(every) if kind in _QUIET else every.mean(axis=0)
            out |= dict(zip(names, mean, strict=True))
    return out


def without_noise(shifts: Array) -> Array:
    """Return the mean of changes over tracings, with less noise in what pairs differ by."""
    mean = shifts.mean(axis=0)
    common = mean.mean(axis=-3, keepdims=True)
    off = shifts - mean
    off = off - off.mean(axis=-3, keepdims=True)
    axes = tuple(a for a in range(mean.ndim) if a != mean.ndim - 4)

    def square(values: Array) -> Array:
        return np.asarray((values**2).mean(axis=axes, keepdims=True))

    noise = np.mean([square(one) for one in off], axis=0) / (len(shifts) - 1)
    return np.asarray(common + share_of_signal(square(mean - common), noise) * (mean - common))


def _of_surfaces(
    case: PositionsCase, weighing: Weighing, base: Array, finished: Callable[[int], None]
) -> dict[str, Array]:
    """Return the shifts by surfaces, parts, apertures and materials; see `PairShifts`."""
    divided, made_of = case.divided, weighing.tracer.made_of
    groups = {f"surface {j}": faces for j, faces in enumerate(divided.surfaces)}
    groups |= {f"part {p}": part.faces for p, part in enumerate(divided.parts)}
    # An alpha of 1 leaves no sound after the first reflection where a surface is all of the room.
    shares = [*(min(t, 0.98) for t in SHARES), STEP]
    out: dict[str, Array] = {}
    steps: dict[tuple[int, ...], Array] = {}
    every = zip(groups.items(), weighing.of_groups([*groups.values()], shares), strict=True)
    for (name, faces), decays in every:
        shifts = _at_shares(weighing, decays) - base[..., np.newaxis]
        out[name], steps[tuple(faces.tolist())] = shifts[..., :-1], shifts[..., -1]
        if name.startswith("surface"):
            j = int(name.split()[1])
            out[f"aperture {j}"] = _apertures(case, weighing, j, decays, base)
        finished(sum(name in out for name in groups))
    materials = [
        tuple(np.flatnonzero(made_of == row).tolist()) for row in range(case.room.n_materials)
    ]
    # Several surfaces together: paths would be followed for long where all of them are hard.
    other = {faces: np.array(faces, dtype=int) for faces in materials if faces not in steps}
    for members, (decay,) in zip(other, weighing.of_groups([*other.values()], [STEP]), strict=True):
        steps[members] = weighing.parameters(decay) - base
    return {**out, "materials": np.stack([steps[faces] for faces in materials], axis=-1)}


def _at_shares(weighing: Weighing, decays: Array) -> Array:
    """Return the parameters at rising shares, (n_parameters, n_pairs, n_bands, n_shares).

    Without EDT or T, where a surface takes nearly all, they are those of the share before.
    """
    try:
        return np.moveaxis(weighing.parameters(decays), 1, -1)
    except DataError:
        pass  # one by one
    each: list[Array] = []
    for energy in decays:
        try:
            each.append(weighing.parameters(energy))
        except TooShortError:
            raise
        except DataError:
            if not each:
                raise
            each.append(each[-1])
    return np.stack(each, axis=-1)


def _apertures(
    case: PositionsCase, weighing: Weighing, surface: int, decays: Array, base: Array
) -> Array:
    """Return the shifts with an aperture, (n_parameters, n_pairs, n_bands, n_second_rooms n_open)."""
    out = np.zeros((*base.shape, len(SECOND_ROOMS) * len(OPEN)))
    if case.kinds[surface] == "floor":
        return out
    tracer, room, area = weighing.tracer, case.room, [*case.areas.values()][surface]
    opened = decays[[SHARES.index(share) for share in OPEN]]
    rates = decay_rate(opened, tracer.bin_width)
    coupled = [
        Aperture(share * area, volume * room.volume, alpha).returned_to(
            energy, room, tracer.bin_width, len(tracer.sources), rate
        )
        for volume, alpha in SECOND_ROOMS
        for share, energy, rate in zip(OPEN, opened, rates, strict=True)
    ]
    lengths = np.array([energy.shape[-1] for energy in coupled])
    for length in np.unique(lengths):
        alike = np.flatnonzero(lengths == length)
        values = weighing.parameters(np.array([coupled[i] for i in alike]))
        out[..., alike] = np.moveaxis(values, 1, -1) - base[..., np.newaxis]
    return out


def key_of(case: PositionsCase, seed: int) -> str:
    """Return a hash of all that the shifts depend on."""
    tracer, room = case.simulator, case.room
    of_room = [room.centre_frequencies.tolist(), room.air and asdict(room.air)]
    return measured_pairs.key_of(
        tracer,
        "where, all paths",
        tracer.scattering_model,
        [tracer.n_paths, tracer.n_batches, tracer.radius, tracer.bin_width],
        [np.minimum(room.alpha, LARGEST_ALPHA).tolist(), *of_room],
        {n: f.tolist() for n, f in case.faces.items()},
        [part.faces.tolist() for part in case.divided.parts],
        list(parameters(case)),
        [TRACINGS, BASE, DENSER, LARGER, STEP, seed],
        [LOBE_INDEX, INDEX_ERROR, OWN_INDEX_ERROR],
        [SHARES, SECOND_ROOMS, AIR, VOLUME, TRACED, MOVE],
    )


LOBE_INDEX = 6.0
"""Directivity index in dB of the lobes that are weighed. A measured two-way loudspeaker has 0.5 to 8 dB
from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0)."""
INDEX_ERROR = 2.0
"""Standard deviation in dB of a stated index, common to all sources that state one."""
OWN_INDEX_ERROR = 0.5
"""That of each source beside the others. With 2 dB of each source's own, ten sources paid so much for
their freedom that another volume stayed likelier."""
AIMED = 0.04
"""Prior probability that sources have other lobes than stated: what is detected is the mean of two
likelihoods. Taken for certain from 2.5 nats, they hid a covered wall from omnidirectional sources."""
LIKELY_LOBES = 10.0
"""Evidence in nats from which lobes are certain, and so strong that their shape counts, which no index
tells. In a box weak lobes (1 to 4 dB) have 2 to 6 nats, strong ones (2 to 8 dB) 40 to 50."""
LIKELY_INDEX = 2.5
"""The same where an index is stated: what is off is then little, and the shape counts the more."""
GAIN, OWN_GAIN, BAND_GAIN = 4.0, 1.0, 2.0
"""Standard deviations in dB of a gain that was calibrated wrongly: of all sources, of each, and of each
in each band."""
MISCALIBRATED = 0.1
"""Prior probability that it was, where no common uncertainty of G is stated: alike in all bands, and
as much again band by band."""
LIKELY_GAINS = 1.0
"""Evidence in nats for gains that may be off from which it is said."""


def with_index(tracer: PathTracing) -> dict[str, Directivity]:
    """Return the directivities that an index above 0 states, by source."""
    stated = {n: of for n, of in tracer.directivity.items() if isinstance(of, Directivity)}
    return {n: of for n, of in stated.items() if of.gains is None and of.index.any()}


def lobes(tracer: PathTracing) -> list[dict[str, Directivity]]:
    """Return possible directivities by source: unstated ones aim at the receivers, then along the axes.

    Their index is `LOBE_INDEX`; a stated index above 0 is larger by `INDEX_ERROR`, then by
    `OWN_INDEX_ERROR`.
    """
    middle = tracer.to_receivers.mean(axis=1)
    # A source in the middle of its receivers aims at none of them.
    middle[~middle.any(axis=1)] = np.eye(3)[0]
    index = np.full(tracer.room.n_bands, LOBE_INDEX)
    unstated = [s for s, name in enumerate(tracer.sources) if name not in tracer.directivity]
    names = [list(tracer.sources)[s] for s in unstated]

    def changed(decibels: float) -> dict[str, Directivity]:
        return {
            name: replace(of, index=np.minimum(of.index + decibels, LARGEST_INDEX))
            for name, of in with_index(tracer).items()
        }

    towards = [Directivity(index=index, aim=tuple(middle[s])) for s in unstated]
    along = [
        Directivity(index=index, aim=tuple(sign * axis))
        for axis in np.eye(3)
        for sign in (-1.0, 1.0)
    ]
    own = changed(OWN_INDEX_ERROR)
    return [
        changed(INDEX_ERROR) | dict(zip(names, towards, strict=True)),
        *(own | dict.fromkeys(names, lobe) for lobe in along),
    ]
