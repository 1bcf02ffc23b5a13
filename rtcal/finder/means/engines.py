"""Reference rooms: simulated rooms like the case's, from which nothing is missing.

The difference between two independent simulators and the reverberation equation in these rooms is the
equation's error. A reference room is a box of the case's volume. Its walls along each axis absorb as
much as the case's materials that face along this axis. Coefficients, positions and scattering are
random.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from rtcal.acoustics import bands, observables
from rtcal.acoustics.equations import Eyring, mean_equation
from rtcal.acoustics.room import Room
from rtcal.files import disk
from rtcal.finder.case import Case
from rtcal.finder.evidence import by_name
from rtcal.finder.model import FEATURES, RoomState, predict
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import LONGEST, PathTracing, ScatteringModel
from rtcal.simulators.shoebox import ImageSource, mean_energy
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.types import Array
from rtcal.support.workers import workforce

SCATTERING: Mapping[ScatteringModel, tuple[float, float]] = {
    "random": (0.4, 0.9),
    "vector": (0.5, 0.9),
}
"""Scattering coefficients of an ordinary room, by scattering model.

The effect "non-diffuse field" begins at coefficients below 0.3. With the vector model, coefficients
below 0.5 turn the paths towards the walls' normals at each reflection. In a flat room T is then up to
a fifth shorter than by any equation.
"""
OF_PROGRAMS = (0.1, 0.9)
"""Scattering coefficients of reference rooms where a geometrical program's run is the model, for either
scattering model. Neither the program's scattering nor the room's is known."""
GUESSED = 2.0
"""Factor within which a program's scattering agrees with the room's, because users guess it from
walls."""
_RECEIVERS = 4
_PATHS = 3000
_IMAGES = 300_000
"""Image sources of a pair that are counted one by one. Of later ones the mean is taken."""
_BIN = 0.001  # width in s of the bins that image sources are counted in


@dataclass(frozen=True, eq=False)
class ControlRooms:
    """Hold the errors of a reverberation equation in reference rooms, simulated by one simulator.

    Reference rooms are boxes like the room, with random coefficients, from which nothing is missing.
    ``errors`` (n_rooms, n_configurations, 5, n_bands) are simulated minus predicted values of ln T20,
    ln EDT/T20, ln T30/T20, and C80 and G in dB, for the same coefficients. If the result of a
    simulation program replaces the equation, they are the differences between the simulator and a path
    tracing of the same box. ``engine`` is the simulator's name.
    """

    engine: str
    errors: Array

    @property
    def estimates_bias(self) -> bool:
        """Whether the mean of these errors counts: not of image sources, which have no scattering."""
        return self.engine not in ENGINES or ENGINES[self.engine].estimates_bias

    @property
    def mean(self) -> Array:
        """Mean of the finite errors over the reference rooms, (n_configurations, 5, n_bands)."""
        finite = np.isfinite(self.errors)
        total = np.where(finite, self.errors, 0).sum(0)
        return np.asarray(total / np.maximum(finite.sum(0), 1))


def bias_estimates(controls: Sequence[ControlRooms]) -> Array:
    """Return estimates of the equation's mean error, (n, n_configurations, 5, n_bands).

    One per simulator that gives one, and a last one of 0, which halves an estimate by a single
    simulator: a second one usually confirms only a part of it.
    """
    means = [c.mean for c in controls if c.estimates_bias]
    return np.array([*means, np.zeros_like(controls[0].mean)])


def recentred(controls: Sequence[ControlRooms]) -> list[ControlRooms]:
    """Return the errors, moved to the mean of `bias_estimates` where a simulator has no estimate."""
    bias = bias_estimates(controls).mean(axis=0)
    return [
        c if c.estimates_bias else ControlRooms(c.engine, c.errors + (bias - c.mean))
        for c in controls
    ]


def draw_alpha(case: Case, rng: np.random.Generator, n: int) -> Array:
    """Draw coefficients of a case's room, (n, n_configurations, n_materials, n_bands).

    They are normal, from 0.001 to 0.99 of the largest possible. A material that a configuration
    changes is drawn by itself, and the order of materials has no effect on the numbers from
    ``rng``.
    """
    room = case.room
    correlation = bands.correlation(room.centre_frequencies, room.band_correlation)
    factor = np.linalg.cholesky(correlation + 1e-10 * np.eye(room.n_bands))

    def drawn(of_name: np.random.Generator, mean: Array, sigma: Array, most: Array) -> Array:
        z = of_name.standard_normal((n, room.n_bands)) @ factor.T
        return np.asarray(np.clip(mean + sigma * z, 0.001, most))

    highest = 0.99 * room.most_alpha
    each = zip(by_name(rng, room.materials), room.alpha, room.sigma, highest, strict=True)
    base = np.stack([drawn(*of_material) for of_material in each], axis=1)
    out = np.repeat(base[:, None], len(case.configurations), axis=1)
    for c, configuration in enumerate(case.configurations):
        changes = configuration.changes
        names = [f"{material} in {configuration.name}" for material in changes]
        for of_name, (material, change) in zip(by_name(rng, names), changes.items(), strict=True):
            row = room.material_index(material)
            out[:, c, row] = drawn(of_name, change.alpha, change.sigma, highest[row])
    return out


def box(case: Case) -> tuple[Room, Polyhedron, Array]:
    """Return a box with the volume and absorption of a case's room, its geometry, and shares.

    Shares (n_materials, 3) times the case's alpha are the alpha of each pair of walls. What pieces
    such as persons add to the mean alpha is added to every wall.
    """
    room = case.room
    walls = np.where(room.is_surface, room.areas, 0.0)
    towards = walls[:, None] * np.where(np.isfinite(case.facing), case.facing, 1 / 3)
    total = np.maximum(towards.sum(0), 1e-3 * room.total_area)
    if room.dimensions is not None:
        sides = np.array(room.dimensions)
    else:
        sides = 1 / total
        # Sides from the areas along the axes, with limited ratios: no corridor.
        sides = np.clip(sides / np.exp(np.log(sides).mean()), 0.4, 2.5)
        sides *= (room.volume / np.prod(sides)) ** (1 / 3)
    x, y, z = sides.tolist()
    geometry = Polyhedron.shoebox((x, y, z), dict(zip(SHOEBOX_WALLS, "xxyyzz", strict=True)))
    control = Room(
        name="control",
        volume=float(np.prod(sides)),
        materials=[*"xyz"],
        areas=2 * np.array([y * z, x * z, x * y]),
        alpha=np.full((3, room.n_bands), 0.1),
        sigma=np.zeros((3, room.n_bands)),
        air=room.air,
        centre_frequencies=room.centre_frequencies,
        dimensions=(x, y, z),
        surfaces=geometry.surfaces,
    )
    share = towards / total
    share[~room.is_surface] = room.areas[~room.is_surface, np.newaxis] / room.total_area
    return control, geometry, share


@dataclass(frozen=True)
class ControlRoom:
    """Hold a reference room with a source and receivers; `box` gives the shares of its alpha."""

    room: Room
    geometry: Polyhedron
    share: Array
    source: tuple[float, ...]
    receivers: Mapping[str, tuple[float, ...]]
    scattering: float
    scattering_model: ScatteringModel

    @property
    def positions(self) -> dict[str, Any]:
        """Arguments that all simulators take: the room, its source and its receivers."""
        return {"room": self.room, "sources": {"S": self.source}, "receivers": self.receivers}

    @property
    def distances(self) -> Array:
        """The source-receiver distances in m, (n_receivers,)."""
        places = np.array([*self.receivers.values()])
        return np.asarray(np.linalg.norm(self.source - places, axis=1))

    def by_axis(self, alpha: Array) -> Array:
        """Return alpha of the walls across each axis, (3, n_bands), from that of the materials."""
        return np.clip(self.share.T @ alpha, 0.0, 0.999)

    def time(self, alpha: Array) -> Array:
        """Return Eyring's T, (n_bands,), for the case's alpha."""
        room = self.room
        mean = room.areas @ self.by_axis(alpha) / room.total_area
        return Eyring().time(room, room.total_area * np.clip(mean, 1e-3, 0.99))

    def errors(self, case: Case, alphas: Array, simulate: Simulation, duration: float) -> Array:
        """Return simulated minus predicted features, (n_configurations, n_features, n_bands)."""
        equation = mean_equation(case.equation).diffuse_field().key
        stated = RoomState.of_room(self.room, np.eye(3), equation)
        states = [replace(stated, alpha=self.by_axis(alpha)) for alpha in alphas]
        simulated = [simulate(self.by_axis(alpha), duration) for alpha in alphas]
        return np.asarray(simulated - predict(states, self.distances).features)


Simulation = Callable[[Array, float], Array]
"""Simulate alpha (3, n_bands) for a duration in s: features (n_features, n_bands)."""


def _path_tracing(control: ControlRoom, number: int) -> Simulation:
    """Trace the paths once; other coefficients only change their weights."""
    tracer = PathTracing(
        **control.positions,
        geometry=control.geometry,
        n_batches=2,
        scattering=control.scattering,
        n_paths=_PATHS,
        scattering_model=control.scattering_model,
        workers=1,
    )

    def simulate(alpha: Array, duration: float) -> Array:
        energy = tracer.energy(alpha, min(duration, LONGEST), seed=number + 1)
        return _features(energy.mean((0, 1)), tracer.bin_width)

    return simulate


def _image_sources(control: ControlRoom, number: int) -> Simulation:
    """Count image sources; walls scatter nothing. Of later images the mean is taken."""
    direct, c = control.distances, control.room.speed_of_sound
    radius = (3 * _IMAGES * control.room.volume / (4 * np.pi)) ** (1 / 3)
    counted = (radius - direct.max()) / c
    images = ImageSource(**control.positions, duration=counted, bin_width=_BIN)

    def simulate(alpha: Array, duration: float) -> Array:
        early = images.decays(alpha)[0]
        times: Array = (np.arange(early.shape[-1], duration / _BIN) + 0.5) * _BIN
        late = mean_energy(control.room, alpha, direct, times) * _BIN
        return _features(np.concatenate([early, late], axis=-1), _BIN)

    return simulate


def _features(energy: Array, width: float) -> Array:
    """Return features of decays (n_pairs, n_bands, n_bins); the source has unit energy."""
    values = observables.parameters(energy, width, ("t20", "edt", "t30", "c80"))
    t20, edt, t30 = (values[p].mean(0) for p in ("t20", "edt", "t30"))
    g = 10 * np.log10(400 * np.pi * energy.sum(-1)).mean(0)
    return np.stack([np.log(t20), np.log(edt / t20), np.log(t30 / t20), values["c80"].mean(0), g])


@dataclass(frozen=True)
class Engine:
    """Describe a simulator of reference rooms: how many rooms it simulates, for how long, and how."""

    name: str
    simulator: Callable[[ControlRoom, int], Simulation]  # of a room and its number
    stream: int  # of random numbers, which no two simulators share
    setups: int  # number of rooms
    duration: float  # of the decays, in reverberation times
    models: Sequence[ScatteringModel] = ()  # used in turn; none without scattering
    estimates_bias: bool = True  # or only the scatter of the errors counts

    def run(
        self,
        case: Case,
        seed: int,
        progress: TaskProgress | None = None,
        scheduler: str | None = None,
    ) -> ControlRooms:
        """Simulate the reference rooms of a case, and return the errors of the equation in these rooms.

        If a program's result is the model of a configuration, a path tracing with the program's
        coefficients takes its place, so that the errors are differences between two simulations.
        """
        rng = np.random.default_rng([seed, self.stream])
        # A Latin hypercube (McKay, Beckman & Conover 1979) of source and receivers.
        cells = [rng.permutation(self.setups) for _ in range(3 * (1 + _RECEIVERS))]
        places = (
            np.stack(cells, axis=1) + rng.uniform(size=(self.setups, len(cells)))
        ) / self.setups
        alphas = draw_alpha(case, rng, self.setups)
        ranges = dict.fromkeys(SCATTERING, OF_PROGRAMS) if case.program else SCATTERING
        scattering = self._scattering(rng, ranges)
        room, geometry, share = box(case)
        programs = self._of_programs(rng, scattering)
        jobs = []
        for number, (coefficient, model) in enumerate(scattering):
            source, receivers = _places(np.array(room.dimensions), places[number])
            control = ControlRoom(room, geometry, share, source, receivers, coefficient, model)
            coefficient, model = programs[number]
            program = replace(control, scattering=coefficient, scattering_model=model)
            jobs.append((number, control, program, alphas[number]))
        told = progress and partial(progress, self.name)
        with workforce(scheduler) as workers:
            errors = [*workers.in_order(partial(self._errors, case), jobs, told)]
        return ControlRooms(self.name, np.array(errors))

    def _errors(self, case: Case, job: tuple[int, ControlRoom, ControlRoom, Array]) -> Array:
        """Return the errors in a reference room, (n_configurations, n_features, n_bands)."""
        number, control, program, alphas = job
        simulate = self.simulator(control, number)
        duration = self.duration * float(control.time(case.room.alpha).max())
        made = control.errors(case, alphas, simulate, duration)
        of = [
            (c, case.room if c.simulated is None else c.simulated.room) for c in case.configurations
        ]
        by_run = np.array([c.simulated is not None for c, _ in of])
        if by_run.any():
            at_runs = np.array([c.coefficients(room)[0] for c, room in of])
            tracing = _path_tracing(program, number)
            made[by_run] -= program.errors(case, at_runs, tracing, duration)[by_run]
        return made

    def _scattering(
        self, rng: np.random.Generator, ranges: Mapping[ScatteringModel, tuple[float, float]]
    ) -> list[tuple[float, ScatteringModel]]:
        """Return each room's coefficient and model; coefficients are even over the model's range."""
        if not self.models:
            return [(0.0, "random")] * self.setups
        models = [self.models[n // 2 % len(self.models)] for n in range(self.setups)]
        out, count = list[tuple[float, ScatteringModel]](), dict.fromkeys(models, 0)
        for model in models:
            low, high = ranges[model]
            part = (count[model] + rng.uniform()) / models.count(model)
            count[model] += 1
            out.append((low + (high - low) * part, model))
        return out

    def _of_programs(
        self, rng: np.random.Generator, scattering: Sequence[tuple[float, ScatteringModel]]
    ) -> list[tuple[float, ScatteringModel]]:
        """Return each program's coefficient, guessed from the room's, and the next room's model."""
        low, high = OF_PROGRAMS
        even = (rng.permutation(self.setups) + 0.5) / self.setups
        if not self.models:
            return [(low + (high - low) * part, "random") for part in even]
        guessed = np.array([s for s, _ in scattering]) * GUESSED ** (2 * even - 1)
        models = [model for _, model in scattering]
        return list(zip(np.minimum(guessed, high).tolist(), [*models[1:], models[0]], strict=True))


def _places(sides: Array, places: Array) -> tuple[tuple[float, ...], dict[str, tuple[float, ...]]]:
    """Return a source and receivers that are not near it, by numbers from 0 to 1."""
    source, *others = sides * (0.15 + 0.7 * places.reshape(-1, 3))
    least, receivers = 0.2 * float(np.prod(sides)) ** (1 / 3), {}
    for i, place in enumerate(others, 1):
        if np.linalg.norm(place - source) <= least:
            way = np.where(source < sides / 2, 0.85, 0.15) * sides - source
            place = source + 1.001 * least / float(np.linalg.norm(way)) * way
        receivers[f"R{i}"] = tuple(place.tolist())
    return tuple(source.tolist()), receivers


ENGINES: Mapping[str, Engine] = {
    engine.name: engine
    for engine in (
        Engine("path tracing", _path_tracing, 1, 32, 1.15, tuple(SCATTERING)),
        # Without scattering slow decays along an axis stay. Its T is up to 2.3 times as long as by any
        # equation, and its decay is bent.
        Engine("image sources", _image_sources, 5, 6, 2.0, estimates_bias=False),
    )
}


def checked_controls(case: Case, controls: object, least: int = 2) -> tuple[ControlRooms, ...]:
    """Return reference rooms that fit the case, of at least ``least`` simulators, else DataError."""
    every = tuple(
        checks.instance("controls", c, ControlRooms) for c in checks.listed("controls", controls)
    )
    if len({c.engine for c in every}) < least:
        raise DataError(
            "the reference simulations are from "
            f"{', '.join(c.engine for c in every) or 'no simulator'}, but a threshold "
            "needs those of at least two simulators"
        )
    shape = len(case.configurations), len(FEATURES), case.room.n_bands
    for c in every:
        if c.errors.shape[1:] != shape or not len(c.errors):
            raise DataError(
                f'the reference simulations of "{c.engine}" have shape {c.errors.shape}, but '
                f"this case needs (n_controls, {', '.join(map(str, shape))}): they belong to "
                "another case"
            )
    return every


FOLDER = ".rtcal_cache"
"""Name of the folder beside a case's file."""


@single_threaded_blas()
def control_rooms(
    case: Case,
    seed: int = 0,
    progress: TaskProgress | None = None,
    cache: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
) -> tuple[ControlRooms, ...]:
    """Simulate reference rooms for a case, which show how far its reverberation equation errs.

    Reference rooms are boxes with the volume and absorption of the case's room and random coefficients,
    from which nothing is missing. Two simulators are used. `rtcal.find` makes the reference rooms of
    seed 0; with another seed you see how much a verdict depends on them: ``rt.find(case,
    controls=control_rooms(case, seed=1))``.

    Parameters
    ----------
    case : Case
        Room and configurations for which reference rooms are made.
    seed : int
        Seed of the random numbers.
    progress, scheduler
        As for `rtcal.find`.
    cache : path, optional
        Folder in which the errors are kept for this case, seed and version of rtcal. You can delete it
        at any time. If a file in it cannot be read or written, the rooms are simulated.

    Returns
    -------
    tuple of ControlRooms
        Errors of the equation, one item per simulator.
    """
    checks.whole("seed", seed, 0)
    where, rooms = None if cache is None else checks.path("cache", cache), []
    for name in ENGINES:
        controls = None
        if where is not None:
            content = json.dumps([case.to_dict(), seed, name, __version__], sort_keys=True)
            path = where / f"{hashlib.sha256(content.encode()).hexdigest()[:32]}.array"
            with suppress(DataError):  # a file of another shape is simulated anew
                if (errors := disk.read(path)) is not None:
                    (controls,) = checked_controls(case, [ControlRooms(name, errors)], least=1)
        if controls is None:
            controls = ENGINES[name].run(case, seed, progress, scheduler)
            if where is not None:
                disk.write(path, controls.errors)
        rooms.append(controls)
    return tuple(rooms)
