"""Control rooms: rooms like the case's, without a missing effect, in independent simulators.

The difference between simulator and model is the model's error. A control room is a box of the case's
volume. Its walls along each axis absorb as much as the case's materials that face along this axis.
alpha is drawn from the prior; positions and scattering are drawn at random.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands, decay
from rtcal.acoustics.equations import Eyring, mean_equation
from rtcal.acoustics.room import Room, Surface
from rtcal.files import disk
from rtcal.finder.case import Case
from rtcal.finder.model import FEATURES, RoomState, predict
from rtcal.finder.prior import by_name
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.ray_tracing import RayTracing
from rtcal.simulators.shoebox import ImageSource, mean_energy
from rtcal.simulators.tracer import LONGEST, ScatteringModel, Tracer
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.types import Array

_AXIS_OF_WALL = (0, 0, 1, 1, 2, 2)
SCATTERING: Mapping[ScatteringModel, tuple[float, float]] = {
    "random": (0.4, 0.9),
    "vector": (0.5, 0.9),
}
"""Scattering coefficients of an ordinary room, by scattering model.

The effect "non-diffuse field" begins at coefficients below 0.3. With the vector model, coefficients
below 0.5 turn the paths towards the walls' normals at each reflection. In a flat room T is then up to
a fifth shorter than by any equation.
"""
_RECEIVERS = 4
_PATHS = 3000
_RAYS = 4000
_IMAGES = 300_000
"""Image sources of a pair that are counted one by one. Of later ones the mean is taken."""
_BIN = 0.001
"""Width in s of the bins that image sources are counted in."""


@dataclass(frozen=True, eq=False)
class ControlRooms:
    """The model's errors in the control rooms of one engine.

    ``errors`` (n_controls, n_configurations, n_features, n_bands) are the engine's features minus the
    model's for the same alpha.
    """

    engine: str
    errors: Array

    @property
    def mean(self) -> Array:
        """Mean error over the rooms with a finite value; 0 without any."""
        finite = np.isfinite(self.errors)
        total = np.where(finite, self.errors, 0).sum(0)
        return np.asarray(total / np.maximum(finite.sum(0), 1))


def bias_estimates(controls: Sequence[ControlRooms]) -> Array:
    """Return each engine's estimate of the model's bias, (n_engines + 1, *one room's shape).

    NaN where an engine cannot estimate it (`Engine.relative`). The last row is 0, the model's own
    estimate. It draws the mean over the rows towards 0, since a second simulator confirms only a part
    of the bias that the first one shows.
    """
    out = []
    for c in controls:
        mean = c.mean
        mean[:, _relative(c)] = np.nan
        out.append(mean)
    return np.array([*out, np.zeros_like(out[0])])


def recentred(controls: Sequence[ControlRooms]) -> list[ControlRooms]:
    """Replace each mean that an engine cannot estimate by the mean over the others."""
    bias = np.nanmean(bias_estimates(controls), axis=0)
    out = []
    for c in controls:
        rows, errors = _relative(c), c.errors.copy()
        errors[:, :, rows] += (bias - c.mean)[:, rows]
        out.append(ControlRooms(c.engine, errors))
    return out


def _relative(controls: ControlRooms) -> list[int]:
    """Return the rows of the features whose scatter the engine estimates, but not their mean.

    Control rooms from outside rtcal belong to no engine of `ENGINES`, and estimate every mean.
    """
    if controls.engine not in ENGINES:
        return []
    return [FEATURES.index(f) for f in ENGINES[controls.engine].relative]


def draw_alpha(case: Case, rng: np.random.Generator, n: int) -> Array:
    """Draw coefficients from the prior: (n, n_configurations, n_materials, n_bands), in [0.001, 0.99].

    The bands have the room's correlation. A configuration's changes are independent draws. Each
    material's draws belong to its name, so that their order changes nothing.
    """
    room = case.room
    correlation = bands.correlation(room.centre_frequencies, room.band_correlation)
    factor = np.linalg.cholesky(correlation + 1e-10 * np.eye(room.n_bands))

    def drawn(of_name: np.random.Generator, mean: Array, sigma: Array) -> Array:
        z = of_name.standard_normal((n, room.n_bands)) @ factor.T
        return np.asarray(np.clip(mean + sigma * z, 0.001, 0.99))

    each = zip(by_name(rng, room.materials), room.alpha, room.sigma, strict=True)
    base = np.stack([drawn(*of_material) for of_material in each], axis=1)
    out = np.repeat(base[:, None], len(case.configurations), axis=1)
    for c, configuration in enumerate(case.configurations):
        changes = configuration.changes
        names = [f"{material} in {configuration.name}" for material in changes]
        for of_name, (material, change) in zip(by_name(rng, names), changes.items(), strict=True):
            row = room.material_index(material)
            out[:, c, row] = drawn(of_name, change.alpha, change.sigma)
    return out


def box(case: Case) -> tuple[Room, Polyhedron, Array]:
    """Return the control room, with one material per axis, and the share of each material by axis.

    With the shares (n_materials, 3), the case's alpha gives the mean alpha of the walls of an axis.
    """
    room = case.room
    towards = room.areas[:, None] * case.facing
    total = np.maximum(towards.sum(0), 1e-3 * room.total_area)
    if room.dimensions is not None:
        sides = np.array(room.dimensions)
    else:
        sides = 1 / total
        # Sides from the areas along the axes, with limited ratios: no corridor.
        sides = np.clip(sides / np.exp(np.log(sides).mean()), 0.4, 2.5)
        sides *= (room.volume / np.prod(sides)) ** (1 / 3)
    x, y, z = sides
    areas = np.repeat([y * z, x * z, x * y], 2)
    names = ("x", "y", "z")
    share = towards / total
    k = room.n_bands
    control = Room(
        name="control",
        volume=float(np.prod(sides)),
        materials=list(names),
        areas=2 * areas[::2],
        alpha=np.full((3, k), 0.1),
        sigma=np.zeros((3, k)),
        air=room.air,
        centre_frequencies=room.centre_frequencies,
        dimensions=(float(x), float(y), float(z)),
        surfaces=[
            Surface(name=wall, material=names[a], area=float(area))
            for wall, a, area in zip(SHOEBOX_WALLS, _AXIS_OF_WALL, areas, strict=True)
        ],
    )
    walls = dict(zip(SHOEBOX_WALLS, (names[a] for a in _AXIS_OF_WALL), strict=True))
    return control, Polyhedron.shoebox(control.dimensions or (), walls), share


@dataclass(frozen=True)
class Setup:
    """A control room with source and receivers; ``share`` (n_materials, 3) as `box` returns it."""

    room: Room
    geometry: Polyhedron
    share: Array
    source: tuple[float, ...]
    receivers: Mapping[str, tuple[float, ...]]
    scattering: float
    scattering_model: ScatteringModel
    number: int
    seed: int

    @property
    def positions(self) -> dict[str, Any]:
        """Arguments common to all simulators: the room, the source and the receivers."""
        return {"room": self.room, "sources": {"S": self.source}, "receivers": self.receivers}

    @property
    def traced(self) -> dict[str, Any]:
        """Arguments common to the tracers."""
        return {
            **self.positions,
            "geometry": self.geometry,
            "n_batches": 2,
            "scattering": self.scattering,
        }


Simulation = Callable[[Array, float], Array]
"""Simulate alpha (3, n_bands) for a duration in s: features (n_features, n_bands)."""


def _path_tracing(setup: Setup) -> Simulation:
    """Trace the paths once; other coefficients only change their weights."""
    tracer = PathTracing(
        **setup.traced, n_paths=_PATHS, scattering_model=setup.scattering_model, workers=1
    )
    return _tracer_features(tracer, setup.number + 1)


def _rays(setup: Setup) -> Simulation:
    """Trace rays with pyroomacoustics (extra ``geometry``)."""
    return _tracer_features(RayTracing(**setup.traced, n_rays=_RAYS), setup.seed + setup.number)


def _tracer_features(tracer: Tracer, seed: int) -> Simulation:
    def simulate(alpha: Array, duration: float) -> Array:
        energy = tracer.energy(alpha, min(duration, LONGEST), seed=seed)
        return _features(energy.mean((0, 1)), tracer.bin_width, 400 * np.pi)

    return simulate


def _image_sources(setup: Setup) -> Simulation:
    """Count image sources; walls scatter nothing. Of later images the mean is taken."""
    direct, c = _distances(setup), setup.room.speed_of_sound
    radius = (3 * _IMAGES * setup.room.volume / (4 * np.pi)) ** (1 / 3)
    duration_counted = (radius - direct.max()) / c
    images = ImageSource(**setup.positions, duration=duration_counted, bin_width=_BIN)

    def simulate(alpha: Array, duration: float) -> Array:
        early = images.energy(alpha)
        times: Array = (np.arange(early.shape[-1], duration / _BIN) + 0.5) * _BIN
        late = mean_energy(setup.room, alpha, direct, times) * _BIN
        return _features(np.concatenate([early, late], axis=-1), _BIN, 400 * np.pi)

    return simulate


@dataclass(frozen=True)
class Engine:
    """An independent simulator, and the control rooms that it simulates.

    Attributes
    ----------
    name : str
    simulator : function
        Prepares one control room.
    stream : int
        Stream of the random numbers, so that engines draw different rooms.
    setups, draws : int
        Control rooms, and draws of alpha from the prior in each.
    duration : float
        Simulated time, in reverberation times.
    models : sequence of str
        Scattering models, two setups with each in turn. Both have a scattering coefficient, but their
        decays differ by some percent.
    scatters : bool
        Whether the simulator takes a scattering coefficient.
    relative : tuple of str
        Features whose scatter the engine estimates, but not their mean.
    """

    name: str
    simulator: Callable[[Setup], Simulation]
    stream: int
    setups: int
    draws: int
    duration: float
    models: Sequence[ScatteringModel]
    scatters: bool = True
    relative: tuple[str, ...] = ()

    def run(self, case: Case, seed: int, progress: TaskProgress | None = None) -> ControlRooms:
        """Simulate the control rooms of a case."""
        rng = np.random.default_rng([seed, self.stream])
        places = _spread_evenly(rng, self.setups, 3 * (1 + _RECEIVERS))
        alphas = draw_alpha(case, rng, self.setups * self.draws)
        models = [self.models[n // 2 % len(self.models)] for n in range(self.setups)]
        scattering = _scattering(models, rng) if self.scatters else [0.0] * self.setups
        errors, of_box = [], box(case)
        for number in range(self.setups):
            setup = _setup(of_box, places[number], number, seed, scattering[number], models[number])
            simulate = self.simulator(setup)
            duration = self.duration * float(_time(setup, case.room.alpha).max())
            rows = []
            for alpha in alphas[number :: self.setups]:
                simulated = [simulate(_by_axis(setup.share, a), duration) for a in alpha]
                rows.append(simulated - _theory(case, setup, alpha))
            errors.append(rows)
            if progress is not None:
                progress(self.name, number + 1, self.setups)
        # Adjacent rows belong to different rooms and models, since the bootstrap takes every second
        # row.
        table = np.swapaxes(np.array(errors), 0, 1)
        return ControlRooms(self.name, table.reshape(-1, *table.shape[2:]))


def _scattering(models: Sequence[ScatteringModel], rng: np.random.Generator) -> list[float]:
    """Return a coefficient per control room, spread evenly over the range of its scattering model."""
    count = dict.fromkeys(SCATTERING, 0)
    out = []
    for model in models:
        low, high = SCATTERING[model]
        part = (count[model] + rng.uniform()) / models.count(model)
        count[model] += 1
        out.append(low + (high - low) * part)
    return out


def _spread_evenly(rng: np.random.Generator, n: int, dimensions: int) -> Array:
    """Return points in the unit cube, (n, dimensions), evenly over each coordinate.

    A Latin hypercube (McKay, Beckman & Conover 1979).
    """
    cells = np.stack([rng.permutation(n) for _ in range(dimensions)], axis=1)
    return np.asarray((cells + rng.uniform(size=cells.shape)) / n)


def _setup(
    of_box: tuple[Room, Polyhedron, Array],
    places: Array,
    number: int,
    seed: int,
    scattering: float,
    model: ScatteringModel,
) -> Setup:
    """Return a control room; ``places``, from 0 to 1, give its source and receivers."""
    room, geometry, share = of_box
    sides = np.array(room.dimensions)
    source, *others = sides * (0.15 + 0.7 * places.reshape(-1, 3))
    receivers = {
        f"R{i}": tuple(_apart(source, place, sides).tolist()) for i, place in enumerate(others, 1)
    }
    return Setup(
        room, geometry, share, tuple(source.tolist()), receivers, scattering, model, number, seed
    )


def _apart(source: Array, place: Array, sides: Array) -> Array:
    """Return a receiver's place; where it is too near the source, one towards the farthest corner."""
    least = 0.2 * float(np.prod(sides)) ** (1 / 3)
    if np.linalg.norm(place - source) > least:
        return place
    way = np.where(source < sides / 2, 0.85, 0.15) * sides - source
    return np.asarray(source + 1.001 * least / float(np.linalg.norm(way)) * way)


def _distances(setup: Setup) -> Array:
    """Return the source-receiver distances in m, (n_receivers,)."""
    return np.array(
        [np.linalg.norm(np.subtract(setup.source, r)) for r in setup.receivers.values()]
    )


def _by_axis(share: Array, alpha: Array) -> Array:
    return np.clip(share.T @ alpha, 0.0, 0.999)


def _time(setup: Setup, alpha: Array) -> Array:
    """Return Eyring's T of the control room, (n_bands,)."""
    room = setup.room
    mean = room.areas @ _by_axis(setup.share, alpha) / room.total_area
    return Eyring().time(room, room.total_area * np.clip(mean, 1e-3, 0.99))


def _features(energy: Array, width: float, level: float) -> Array:
    """Return features (n_features, n_bands) of decays (n_pairs, n_bands, n_bins).

    10 log10 of ``level`` times the energy is G.
    """
    values = decay.parameters(energy, width, ("t20", "edt", "t30", "c80"))
    t20, edt, t30 = (values[p].mean(0) for p in ("t20", "edt", "t30"))
    g = 10 * np.log10(level * energy.sum(-1)).mean(0)
    return np.stack([np.log(t20), np.log(edt / t20), np.log(t30 / t20), values["c80"].mean(0), g])


def _theory(case: Case, setup: Setup, alpha: Array) -> Array:
    """Return the model's features of the control room, (n_configurations, n_features, n_bands)."""
    room = setup.room
    states = [
        RoomState(
            volume=room.volume,
            areas=room.areas,
            alpha=_by_axis(setup.share, values),
            facing=np.eye(3),
            air=room.air_attenuation,
            frequencies=room.centre_frequencies,
            speed_of_sound=room.speed_of_sound,
            equation=mean_equation(case.equation).diffuse_field().key,
        )
        for values in alpha
    ]
    return predict(states, _distances(setup)).features


ENGINES: Mapping[str, Engine] = {
    engine.name: engine
    for engine in (
        Engine(
            name="path tracing",
            simulator=_path_tracing,
            stream=1,
            setups=32,
            draws=1,
            duration=1.15,
            models=tuple(SCATTERING),
        ),
        # Without scattering slow decays along an axis stay. Its T is up to 2.3 times as long as by any
        # equation, and its decay is bent.
        Engine(
            name="image sources",
            simulator=_image_sources,
            stream=5,
            setups=6,
            draws=1,
            duration=2.0,
            models=("random",),
            scatters=False,
            relative=FEATURES,
        ),
        # Its receivers count twice the energy that walls scatter.
        Engine(
            name="rays",
            simulator=_rays,
            stream=4,
            setups=6,
            draws=1,
            duration=1.15,
            models=("vector",),
            relative=("g",),
        ),
    )
}


def checked_engines(engines: object) -> list[str]:
    """Return the names of at least two engines, each once; DataError otherwise."""
    names = list(dict.fromkeys(map(str, checks.listed("engines", engines))))
    if unknown := sorted(set(names) - set(ENGINES)):
        raise DataError(f'engine "{unknown[0]}" is not one of {", ".join(ENGINES)}')
    if len(names) < 2:
        raise DataError(f"engines = {names}: a threshold needs at least two engines")
    return names


def checked_controls(case: Case, controls: object, least: int = 2) -> tuple[ControlRooms, ...]:
    """Return control rooms of this case's shape and of ``least`` engines; DataError otherwise."""
    every = tuple(
        checks.instance("controls", c, ControlRooms) for c in checks.listed("controls", controls)
    )
    if len({c.engine for c in every}) < least:
        raise DataError(
            f"controls are of {', '.join(c.engine for c in every) or 'no engine'}: a threshold needs "
            "at least two engines"
        )
    shape = len(case.configurations), len(FEATURES), case.room.n_bands
    for c in every:
        if c.errors.shape[1:] != shape or not len(c.errors):
            raise DataError(
                f'controls of "{c.engine}" have shape {c.errors.shape}; this case\'s are (n_controls, '
                f"{', '.join(map(str, shape))}): they are of another case"
            )
    return every


DEFAULT_ENGINES = ("path tracing", "image sources")
"""Engines of the control rooms, unless others are stated."""
FOLDER = ".rtcal_cache"
"""Name of the folder beside a case's file."""


@single_threaded_blas()
def control_rooms(
    case: Case,
    seed: int = 0,
    engines: Sequence[str] = DEFAULT_ENGINES,
    progress: TaskProgress | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> tuple[ControlRooms, ...]:
    """Simulate the case's control rooms with at least two engines, or read them from a folder.

    They are a fixed sequence: positions and scattering are spread evenly, and what is drawn for a
    material belongs to its name. `rtcal.find` takes that of the seed 0. Another one shows how much a
    verdict depends on it: ``find(case, controls=control_rooms(case, seed=1))``.

    A file of the folder ``cache`` holds the rooms of one engine. Its name is a hash of everything that
    they depend on: the case, the seed, the engine and the version of rtcal. The folder can be deleted
    at any time. If a file cannot be read or written, the rooms are simulated without an error.

    Raises
    ------
    DataError
        For fewer than two engines, or an engine that rtcal lacks.
    """
    checks.whole("seed", seed, 0)
    where, rooms = None if cache is None else checks.path("cache", cache), []
    for name in checked_engines(engines):
        path = None if where is None else where / f"{_key(case, seed, name)}.array"
        controls = None if path is None else _kept(path, case, name)
        if controls is None:
            controls = ENGINES[name].run(case, seed, progress)
            if path is not None:
                disk.write(path, controls.errors)
        rooms.append(controls)
    return tuple(rooms)


def _key(case: Case, seed: int, engine: str) -> str:
    content = json.dumps([case.to_dict(), seed, engine, __version__], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def _kept(path: Path, case: Case, engine: str) -> ControlRooms | None:
    errors = disk.read(path)
    if errors is None:
        return None
    try:
        return checked_controls(case, [ControlRooms(engine, errors)], least=1)[0]
    except DataError:
        return None
