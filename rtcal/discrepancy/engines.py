"""Control rooms: the case's room with nothing hidden in it, through independent simulators.

What the simulators give beside the model is the model's own error, for this room. A control is a
box of the case's volume whose walls absorb, along each axis, what the case's materials that face
along it absorb; alpha is drawn from the prior, positions and scattering at random.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands, decay
from rtcal.acoustics.equations import Eyring, mean_equation
from rtcal.acoustics.materials import Surface
from rtcal.acoustics.room import Room
from rtcal.discrepancy.case import Case
from rtcal.discrepancy.model import FEATURES, State, predict
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.paths import ScatteringModel
from rtcal.simulators.ray_tracing import RayTracing
from rtcal.simulators.sdn import ScatteringDelayNetwork
from rtcal.support.types import Array

_AXIS_OF_WALL = (0, 0, 1, 1, 2, 2)
SCATTERING: Mapping[ScatteringModel, tuple[float, float]] = {
    "random": (0.4, 0.9),
    "vector": (0.5, 0.9),
}
"""Of a control room's walls, by what is meant by it: what is taken for an ordinary room.

Up to 0.3 of the paths is the effect "non-diffuse field". A sum of vectors with less than half of it
scattered turns paths towards the walls' normals, hit by hit: in a flat room T falls to a fifth under
any equation's.
"""
RELATIVE: Mapping[str, tuple[str, ...]] = {"network": FEATURES, "rays": ("g",)}
"""Features of which an engine tells how they scatter, not where they lie.

A network's nodes count alike, however large their walls: in a flat room its T is up to half as long
again as any equation's and its decay is bent, and its reverberation is some 3 dB too weak everywhere.
pyroomacoustics hears twice what walls scatter.
"""
_RECEIVERS = 4
_PATHS = 6000
_RAYS = 4000
_RATE = 4000.0
Report = Callable[[str, int, int], None]
"""Called with an engine's name, how many rooms are done and of how many."""


def no_report(engine: str, done: int, of: int) -> None:
    """Ignore the progress."""


@dataclass(frozen=True, eq=False)
class ControlRooms:
    """What one engine's control rooms showed.

    ``errors`` (n_controls, n_configurations, n_features, n_bands): the engine's features less the
    model's for the same alpha.
    """

    engine: str
    errors: Array

    @property
    def mean(self) -> Array:
        """Mean error of the rooms where it could be evaluated, 0 where it could in none."""
        there = np.isfinite(self.errors)
        found = np.where(there, self.errors, 0).sum(0)
        return np.asarray(found / np.maximum(there.sum(0), 1))


def bias_estimates(controls: Sequence[ControlRooms]) -> Array:
    """Return each engine's estimate of the model's bias, (n_engines + 1, *one room's shape).

    NaN where an engine cannot estimate it (`RELATIVE`). The last row is the model's own
    estimate, 0: a second simulator confirms only part of what the first shows.
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
    return [FEATURES.index(f) for f in RELATIVE.get(controls.engine, ())]


def draw_alpha(case: Case, rng: np.random.Generator, n: int) -> Array:
    """Draw coefficients from the prior: (n, n_configurations, n_materials, n_bands), in [0.001, 0.99].

    Bands are correlated as the room says; a configuration's changes are drawn apart.
    """
    room = case.room
    correlation = bands.correlation(room.centre_frequencies, room.band_correlation)
    factor = np.linalg.cholesky(correlation + 1e-10 * np.eye(room.n_bands))

    def drawn(mean: Array, sigma: Array) -> Array:
        z = rng.standard_normal((n, *mean.shape)) @ factor.T
        return np.asarray(np.clip(mean + sigma * z, 0.001, 0.99))

    base = drawn(room.alpha, room.sigma)
    out = np.repeat(base[:, None], len(case.configurations), axis=1)
    for c, configuration in enumerate(case.configurations):
        for material, change in configuration.changes.items():
            out[:, c, room.material_index(material)] = drawn(change.alpha, change.sigma)
    return out


def box(case: Case) -> tuple[Room, Array]:
    """Return the control room, with one material an axis, and its areas by material and axis.

    The second is (n_materials, 3) and turns the case's alpha into an axis' mean.
    """
    room = case.room
    towards = room.areas[:, None] * case.facing
    total = np.maximum(towards.sum(0), 1e-3 * room.total_area)
    if room.dimensions is not None:
        sides = np.array(room.dimensions)
    else:
        sides = 1 / total
        # As long, wide and high as the areas along the axes say, but no corridor.
        sides = np.clip(sides / np.exp(np.log(sides).mean()), 0.4, 2.5)
        sides *= (room.volume / np.prod(sides)) ** (1 / 3)
    x, y, z = sides
    areas = np.repeat([y * z, x * z, x * y], 2)
    names = ("x", "y", "z")
    share = towards / total
    k = room.n_bands
    made = Room(
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
    return made, share


def path_tracing(
    case: Case, seed: int, *, setups: int = 8, draws: int = 4, report: Report = no_report
) -> ControlRooms:
    """Trace ``setups`` rooms once, each re-weighted for ``draws`` priors of alpha.

    Half of them scatter as a share of the paths, half as a sum of vectors: the literature means
    both by a scattering coefficient, and a decay is some percent longer by the second.
    """
    rng = np.random.default_rng([seed, 1])
    meanings = [tuple(SCATTERING)[number // 2 % 2] for number in range(setups)]
    scattering = _scattering(meanings, rng)
    errors = []
    for number in range(setups):
        room, share, source, receivers = _setup(case, rng)
        tracer = PathTracing(
            geometry=_geometry(room),
            room=room,
            sources={"S": source},
            receivers=receivers,
            n_paths=_PATHS,
            n_batches=2,
            scattering=scattering[number],
            scattering_model=meanings[number],
            workers=1,
        )
        alphas = draw_alpha(case, rng, draws)
        longest = 1.15 * float(_time(room, share, case.room.alpha).max())
        here = []
        for alpha in alphas:
            found = []
            for one in alpha:
                energy = tracer.energy(_by_axis(share, one), longest, seed=number + 1)
                found.append(_features(energy.mean((0, 1)), tracer.bin_width, 400 * np.pi))
            here.append(found - _theory(case, room, share, alpha, source, receivers))
        errors.append(here)
        report("path tracing", number + 1, setups)
    # Every other row is of other rooms, of both meanings: the bootstrap halves them so.
    table = np.swapaxes(np.array(errors), 0, 1)
    return ControlRooms("path tracing", table.reshape(-1, *table.shape[2:]))


def network(
    case: Case, seed: int, *, setups: int = 6, draws: int = 1, report: Report = no_report
) -> ControlRooms:
    """Run scattering delay networks, which tell only how features scatter (`RELATIVE`)."""
    rng = np.random.default_rng([seed, 2])
    errors = []
    for number in range(setups):
        room, share, source, receivers = _setup(case, rng)
        sdn = ScatteringDelayNetwork(
            room=room, sources={"S": source}, receivers=receivers, sampling_rate=_RATE
        )
        first = [
            round(float(np.linalg.norm(np.subtract(source, r))) * _RATE / room.speed_of_sound)
            for r in receivers.values()
        ]
        longest = 2.0 * float(_time(room, share, case.room.alpha).max())
        for alpha in draw_alpha(case, rng, draws):
            found = []
            for one in alpha:
                energy = sdn.impulse_responses(_by_axis(share, one), longest) ** 2
                cut = energy.shape[-1] - max(first)
                aligned = np.stack([e[:, s : s + cut] for e, s in zip(energy, first, strict=True)])
                found.append(_features(aligned, 1 / _RATE, 100.0))
            errors.append(found - _theory(case, room, share, alpha, source, receivers))
        report("network", number + 1, setups)
    return ControlRooms("network", np.array(errors))


def rays(
    case: Case, seed: int, *, setups: int = 6, draws: int = 1, report: Report = no_report
) -> ControlRooms:
    """Trace rays with pyroomacoustics (extra ``geometry``), which do not tell G (`RELATIVE`)."""
    rng = np.random.default_rng([seed, 4])
    scattering = _scattering(["vector"] * setups, rng)
    errors = []
    for number in range(setups):
        room, share, source, receivers = _setup(case, rng)
        tracer = RayTracing(
            geometry=_geometry(room),
            room=room,
            sources={"S": source},
            receivers=receivers,
            n_rays=_RAYS,
            n_batches=2,
            scattering=scattering[number],
        )
        longest = 1.15 * float(_time(room, share, case.room.alpha).max())
        for alpha in draw_alpha(case, rng, draws):
            found = []
            for one in alpha:
                energy = tracer.energy(_by_axis(share, one), longest, seed=seed + number)
                found.append(_features(energy.mean((0, 1)), tracer.bin_width, 400 * np.pi))
            errors.append(found - _theory(case, room, share, alpha, source, receivers))
        report("rays", number + 1, setups)
    return ControlRooms("rays", np.array(errors))


def _scattering(meanings: Sequence[ScatteringModel], rng: np.random.Generator) -> list[float]:
    """A coefficient for each control room, those of one meaning spread evenly over its range."""
    seen = dict.fromkeys(SCATTERING, 0)
    out = []
    for meaning in meanings:
        low, high = SCATTERING[meaning]
        part = (seen[meaning] + rng.uniform()) / meanings.count(meaning)
        seen[meaning] += 1
        out.append(low + (high - low) * part)
    return out


def _geometry(room: Room) -> Polyhedron:
    return Polyhedron.shoebox(
        room.dimensions or (),
        dict(zip(SHOEBOX_WALLS, [room.materials[a] for a in _AXIS_OF_WALL], strict=True)),
    )


def _setup(
    case: Case, rng: np.random.Generator
) -> tuple[Room, Array, tuple[float, ...], dict[str, tuple[float, ...]]]:
    """A control room with a source and receivers somewhere in it."""
    room, share = box(case)
    sides = np.array(room.dimensions)
    least = 0.2 * room.volume ** (1 / 3)
    source = sides * rng.uniform(0.15, 0.85, 3)
    receivers: dict[str, tuple[float, ...]] = {}
    while len(receivers) < _RECEIVERS:
        place = sides * rng.uniform(0.15, 0.85, 3)
        if np.linalg.norm(place - source) > least:
            receivers[f"R{len(receivers) + 1}"] = tuple(place.tolist())
    return room, share, tuple(source.tolist()), receivers


def _by_axis(share: Array, alpha: Array) -> Array:
    return np.clip(share.T @ alpha, 0.0, 0.999)


def _time(room: Room, share: Array, alpha: Array) -> Array:
    """Eyring's T of the control room, (n_bands,)."""
    mean = np.clip(room.areas @ _by_axis(share, alpha) / room.total_area, 1e-3, 0.99)
    return Eyring().time(room, room.total_area * mean)


def _features(energy: Array, width: float, level: float) -> Array:
    """Features (n_features, n_bands) of decays (n_pairs, n_bands, n_bins); ``level`` makes them G."""
    found = decay.parameters(energy, width)
    t20, edt, t30 = (found[p].mean(0) for p in ("t20", "edt", "t30"))
    g = 10 * np.log10(level * energy.sum(-1)).mean(0)
    return np.stack([np.log(t20), np.log(edt / t20), np.log(t30 / t20), found["c80"].mean(0), g])


def _theory(
    case: Case,
    room: Room,
    share: Array,
    alpha: Array,
    source: Sequence[float],
    receivers: Mapping[str, Sequence[float]],
) -> Array:
    """What the model says of the control room, (n_configurations, n_features, n_bands)."""
    distance = np.array([np.linalg.norm(np.subtract(source, r)) for r in receivers.values()])
    out = []
    for one in alpha:
        made = State(
            volume=room.volume,
            areas=room.areas,
            alpha=_by_axis(share, one),
            facing=np.eye(3),
            air=room.air_attenuation,
            frequencies=room.centre_frequencies,
            speed_of_sound=room.speed_of_sound,
            equation=mean_equation(case.equation).diffuse_field().key,
        )
        out.append(predict([made], distance).features[0])
    return np.array(out)


ENGINES: Mapping[str, Callable[..., ControlRooms]] = {
    "path tracing": path_tracing,
    "network": network,
    "rays": rays,
}
