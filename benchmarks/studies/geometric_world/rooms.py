"""The hidden geometric world: rooms with positions, in which something may be where nobody stated it.

It imports nothing of rtcal. A room is drawn from the seed (population, index). Population 0 is for
development, population 1 for judging: 150 rooms with something hidden and 100 without, in an order in
which the kinds are mixed, so that the first N rooms are a fair sample. It was frozen on 2026-11-22,
before the finder that it judges was tried on it. Population 2 has further rooms for development,
drawn as those for judging; the first 40 are built. Population 3 is for judging again: its first 150
rooms were frozen on 2026-11-23, before any finder was tried on them. Population 4 is for judging the
rule that other scattering lacks nothing, at 8,000 paths: frozen on 2026-11-23, not built yet.

- Shapes: half are boxes, the others polyhedra of 6 to 10 surfaces (`studies.position_rooms.shapes`), 90
  to 3,000 m³. In half of the rooms every surface has a material of its own; in the others walls share.
- Coefficients: a catalogue's (`tables`), stated with a handbook's sigma: 30 %, at least 0.02. The true
  ones differ by a factor and a tilt common to all, by a heavy-tailed factor per material, and by a
  smooth and a rough part over the bands.
- Scattering 0.1 to 0.8 of either published meaning, not stated. In half of the judging rooms the
  surfaces' coefficients have nothing in common.
- Two sources and six receivers, each 0.05 m from where it is stated.
- Measurement: `studies.position_rooms.parameters`; T20, EDT, C80, Ts and G per pair. No uncertainty is
  stated. The errors common to all pairs are 0.3 to 0.8 of those between teams.
- Hidden (`KINDS`, `hidden`): their absorption in the three bands where they absorb most is 0.08 to 0.6
  of the room's, log-uniform, as far as the surface is large enough. Spectra are rows of tables, with a
  smooth factor of 12 % and a rough one of 5 %.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.studies.geometric_world import hidden, tables
from benchmarks.studies.position_rooms import parameters, shapes
from benchmarks.studies.position_rooms.rooms import WIDTH, attenuation, eyring, moved, scattering
from benchmarks.studies.position_rooms.tracer import Scene, planes, sees, trace
from benchmarks.studies.position_rooms.tracer import _next_surface as next_surface

SEED = 20261122
NOTHING = "nothing"
KINDS = {
    "opening": 22,
    "porous": 22,
    "curtain": 22,
    "resonator": 22,
    "audience": 20,
    "covered surface": 18,
    "coupled room": 14,
    "receiver": 10,
    NOTHING: 100,
}
"""Rooms in population 1 by what is hidden. "covered surface": a stated absorber is not there;
"receiver": one receiver stands 0.8 to 2 m from where it is stated."""
ON_A_SURFACE = ("opening", "porous", "curtain", "resonator", "audience", "covered surface")
COUNTS = {
    0: {**dict.fromkeys(KINDS, 3), NOTHING: 16},
    1: KINDS,
    2: {**dict.fromkeys(KINDS, 5), NOTHING: 40},
    3: KINDS,
    4: KINDS,
}
SHARES = 0.08, 0.6
REFLECTIONS = 1.2e7
"""Traced per source: the noise of T20 and EDT is then about 1.3 % per pair, below a measurement's."""
FROZEN = {
    0: "64c5406e47457c82b6d097a89b9d02532f379aefb02eeb797bdf443dc52fe124",
    1: "142d07bf4fe2b6cb7ff03a59c911005adadf08eea830cba33a9999d50feed5be",
    2: "5679c802cb9e5c983f535eb50e63462c4d34a465f05267790f08b137d485a141",
    3: "853d857976c1f5e67e587daa9fc294eeb48e5c045bbd9f6e55a8beaa5b1818d6",
    4: "e34d9b315afbae29afe2d0cba0806b20acaf967928ba738d6e39faf764b9de0f",
}
"""`benchmarks.studies.geometric_world.generate.digest` of the first twelve rooms of each population."""
LARGEST = 0.9  # share of a surface that something may take


@dataclass
class Room:
    """A room while it is drawn."""

    solid: hidden.Solid
    shell: list[np.ndarray]  # the stated surfaces
    kind_of_shape: str
    materials: list[str]
    owner: list[int]  # material of each surface
    mu: np.ndarray  # stated, (n_materials, n_bands)
    rows: np.ndarray  # true alpha of each row that a polygon may have, (n_rows, n_bands)
    bands: np.ndarray
    truth: dict[str, Any] = field(default_factory=dict)

    @property
    def areas(self) -> np.ndarray:
        return np.array([shapes.area(p) for p in self.shell])

    @property
    def absorption(self) -> np.ndarray:
        """True S alpha in m² before anything is hidden, (n_bands,)."""
        return np.asarray(self.areas @ self.rows[self.owner])


def order(population: int) -> list[str]:
    """Return the kind of each room: in every first part of the list the kinds have their shares."""
    rng = np.random.default_rng([SEED, population])
    keys = [
        ((i + rng.random()) / n, kind) for kind, n in COUNTS[population].items() for i in range(n)
    ]
    return [kind for _, kind in sorted(keys)]


def smooth(rng: np.random.Generator, n: int, spread: float) -> np.ndarray:
    """Return a factor per band whose logarithm has this spread and changes smoothly."""
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return np.asarray(np.exp(spread * np.linalg.cholesky(0.8**lag) @ rng.standard_normal(n)))


def spectrum(rng: np.random.Generator, row: tuple[float, ...], bands: np.ndarray) -> np.ndarray:
    """Return a table's row as another laboratory would have measured it."""
    n = len(bands)
    factor = smooth(rng, n, 0.12) * np.exp(0.05 * rng.standard_normal(n))
    return np.clip(tables.at(row, bands) * factor, 0.005, 1.0)


def true_rows(rng: np.random.Generator, mu: np.ndarray, bands: np.ndarray) -> np.ndarray:
    """Return the coefficients that a room has where the catalogue says mu, (n_materials, n_bands)."""
    octave = np.log2(bands / 1000)
    common = np.exp(0.10 * rng.standard_normal() + 0.04 * rng.standard_normal() * octave)
    out = np.empty_like(mu)
    for i in range(len(mu)):
        level = np.exp(0.12 * np.clip(rng.standard_t(3), -5, 5))
        rough = np.exp(0.04 * rng.standard_normal(len(bands)))
        out[i] = mu[i] * common * level * smooth(rng, len(bands), 0.12) * rough
    return np.clip(out, 0.005, 0.99)


def shell_of(rng: np.random.Generator, kind: str) -> tuple[str, list[np.ndarray]]:
    """Return the shape's name and surfaces. A second room needs free space behind every wall."""
    cube_root = (90.0 * (3000 / 90) ** rng.random()) ** (1 / 3)
    if rng.random() < 0.5:
        return "box", shapes.box(rng, cube_root)
    of_shape = int(rng.integers(len(shapes.KINDS) - (kind == "coupled room")))
    return shapes.KINDS[of_shape].__name__, shapes.polyhedron(rng, of_shape, cube_root, 0)


def furnished(rng: np.random.Generator, kind: str) -> Room:
    """Return a room with its materials and nothing hidden."""
    name, shell = shell_of(rng, kind)
    bands = parameters.OCTAVES if rng.random() < 0.3 else parameters.OCTAVES[1:7]
    shared = rng.random() < 0.5
    up = np.array([hidden.axes(p)[2][2] for p in shell])
    usual = [str(x) for x in rng.choice(list(tables.WALLS), 2, replace=False)]
    finishes = {"floor": str(rng.choice(list(tables.FLOORS)))}
    finishes["ceiling"] = str(rng.choice(list(tables.CEILINGS)))
    rows = {**tables.FLOORS, **tables.CEILINGS, **tables.WALLS, **tables.ABSORBING}
    materials: list[str] = []
    stated: list[tuple[float, ...]] = []
    owner: list[int] = []
    absorbing = int(rng.integers(len(shell))) if rng.random() < 0.3 else -1
    if kind == "covered surface":
        absorbing = int(rng.choice(np.flatnonzero(np.array([hidden.takes(p) for p in shell]))))
    for i, z in enumerate(up):
        part = "floor" if z < -0.7 else "ceiling" if z > 0.7 else "wall"
        finish = finishes.get(part) or usual[int(rng.random() < 0.3)]
        if i == absorbing:
            part, finish = "absorber", str(rng.choice(list(tables.ABSORBING)))
        label = f"{part}: {finish}" if shared else f"surface {i + 1}: {finish}"
        if label not in materials:
            materials.append(label)
            stated.append(rows[finish])
        owner.append(materials.index(label))
    mu = np.array([np.clip(tables.at(row, bands), 0.01, 0.95) for row in stated])
    solid = hidden.Solid([p.copy() for p in shell], list(owner))
    made = Room(solid, shell, name, materials, owner, mu, true_rows(rng, mu, bands), bands)
    made.truth = {"kind": kind, "absorber": absorbing, "surface": -1, "effect_on_t": 0.0}
    return made


def candidates(made: Room, kind: str) -> list[int]:
    """Return the surfaces on which something of this kind may be."""
    up = [hidden.axes(p)[2][2] for p in made.shell]
    usable = [i for i, p in enumerate(made.shell) if hidden.takes(p)]
    if kind == "covered surface":
        return [made.truth["absorber"]]
    if kind == "audience":
        return [i for i in usable if up[i] < -0.99]
    if kind in ("curtain", "coupled room"):
        return [i for i in usable if abs(up[i]) < 0.05]
    return [i for i in usable if up[i] > -0.7]


def hide(rng: np.random.Generator, made: Room) -> bool:
    """Hide something of the room's kind; False if it finds no place."""
    kind = made.truth["kind"]
    if kind in (NOTHING, "receiver"):
        return True
    surface = int(rng.choice(candidates(made, kind)))
    low, high = SHARES
    share = low * (high / low) ** rng.random()
    if kind == "coupled room":
        row, name = (1.0,) * 6, "aperture"
    else:
        name = str(rng.choice(list(tables.HIDDEN[kind])))
        row = tables.HIDDEN[kind][name]
    alpha = spectrum(rng, row, made.bands)
    if kind in ("opening", "coupled room"):
        alpha = np.ones(len(made.bands))
    instead = made.rows[made.owner[surface]]
    gained = (alpha - instead) / made.absorption  # per m²
    strongest = float(np.sort(np.abs(gained))[-3:].mean())
    area = min(share / strongest, LARGEST * float(made.areas[surface]))
    made.rows = np.vstack([made.rows, alpha])
    new = len(made.rows) - 1
    placed = True
    if kind == "curtain":
        gap = float(rng.uniform(0.1, 0.3))
        made.truth["gap"] = gap
        placed = hidden.hang(rng, made.solid, surface, area, new, gap)
    elif kind == "audience" and rng.random() < 0.5:
        made.truth["block"] = placed = hidden.seat(rng, made.solid, surface, area, new)
    elif kind == "coupled room":
        area = min(area, 0.4 * float(made.areas[surface]))
        volume = shapes.volume(made.shell) * 0.3 * (2 / 0.3) ** rng.random()
        level = 0.03 * (0.2 / 0.03) ** rng.random()
        made.rows = np.vstack([made.rows[:-1], np.full(len(made.bands), level)])
        placed = hidden.open_to_a_second_room(rng, made.solid, surface, area, volume, new)
        made.truth |= {"second_volume": volume, "second_alpha": level}
    else:
        hidden.replace_part(rng, made.solid, surface, area, new)
    change = area * gained
    made.truth |= {
        "surface": surface,
        "size": area,
        "row": name,
        "alpha_of_it": alpha,
        "effect_on_t": float(np.mean(np.abs(1 / (1 + change) - 1))),
    }
    return placed


def floor_below(shell: list[np.ndarray], x: float, y: float) -> float | None:
    """Return the height of the floor under a point of the plan; None outside the room."""
    for p in shell:
        n = hidden.axes(p)[2]
        if n[2] < -0.5:
            at = np.array([x, y, p[0][2] - (n[:2] @ (np.array([x, y]) - p[0][:2])) / n[2]])
            if hidden.within(p, at[np.newaxis], 0.0):
                return float(at[2])
    return None


def places(
    rng: np.random.Generator, made: Room, radius: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Draw two sources 1.2 to 1.8 m and six receivers 1.3 to 1.5 m above the floor.

    They are clear of walls and bodies, apart, and each pair is in sight. None if that fails.
    """
    corners = np.concatenate(made.shell)
    low, high = corners.min(0), corners.max(0)
    size = shapes.volume(made.shell) ** (1 / 3)
    walls = planes(made.shell)
    count = np.array([len(p) for p in made.shell])
    solids = [*made.shell, *made.solid.bodies]

    def point(heights: tuple[float, float], margin: float) -> np.ndarray | None:
        for _ in range(200):
            x, y = rng.uniform(low[:2], high[:2])
            ground = floor_below(made.shell, float(x), float(y))
            if ground is None:
                continue
            at = np.array([x, y, ground + rng.uniform(*heights)])
            u = rng.standard_normal(3)
            u /= np.linalg.norm(u)
            surface, _ = next_surface(at, u, *walls, count, -1)
            inside = surface >= 0 and walls[0][surface] @ u > 0
            if inside and min(shapes.distance(at, p) for p in solids) > margin:
                return at
        return None

    for attempt in range(60):
        tight = 0.97**attempt
        both = [point((1.2, 1.8), 0.5) for _ in range(2)]
        if both[0] is None or both[1] is None:
            continue
        sources = np.array(both)
        if np.linalg.norm(sources[0] - sources[1]) < 0.35 * size * tight:
            continue
        receivers: list[np.ndarray] = []
        for _ in range(300):
            x = point((1.3, 1.5), radius + 0.06)
            if x is None:
                break
            far = np.linalg.norm(sources - x, axis=1).min() > max(1.2, 0.25 * size) * tight
            apart = all(np.linalg.norm(x - r) > 0.22 * size * tight for r in receivers)
            scene = bare(made.solid.polygons, x[np.newaxis], radius)
            if far and apart and all(sees(scene, s)[0] for s in sources):
                receivers.append(x)
            if len(receivers) == 6:
                return sources, np.array(receivers)
    return None


def bare(polygons: list[np.ndarray], receivers: np.ndarray, radius: float) -> Scene:
    return Scene(polygons, *[np.zeros(1)] * 3, 343.0, receivers, radius, False)


def misplaced(
    rng: np.random.Generator, made: Room, stated: np.ndarray, radius: float
) -> tuple[np.ndarray, int]:
    """Return the stated receivers, one of them 0.8 to 2 m from the truth and within the room."""
    out, which = stated.copy(), int(rng.integers(len(stated)))
    walls = planes(made.shell)
    count = np.array([len(p) for p in made.shell])
    for _ in range(500):
        angle, off = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.0)
        step = np.array([np.cos(angle), np.sin(angle), 0.0])
        surface, free = next_surface(stated[which], step, *walls, count, -1)
        place = stated[which] + off * step
        clear = min(shapes.distance(place, p) for p in made.shell) > radius + 0.06
        if surface >= 0 and free > off and clear:
            out[which] = np.round(place, 3)
            return out, which
    raise RuntimeError("no other place for a receiver")


def draw(population: int, index: int) -> tuple[dict[str, Any], Scene, np.ndarray, Room]:
    """Return what is stated, the true scene, its sources, and the room."""
    kind = order(population)[index]
    for attempt in range(50):
        rng = np.random.default_rng([SEED, population, index, attempt])
        made = furnished(rng, kind)
        if kind != NOTHING and kind != "receiver" and not candidates(made, kind):
            continue
        if not hide(rng, made):
            continue
        radius = float(np.clip(0.065 * shapes.volume(made.shell) ** (1 / 3), 0.3, 0.6))
        if (found := places(rng, made, radius)) is not None:
            break
    else:
        raise RuntimeError(f"room {population}.{index} finds no place for a {kind}")
    sources, receivers = found
    climate = (float(np.round(rng.uniform(17, 25), 1)), float(np.round(rng.uniform(30, 60))))
    rough = scattering(rng, min(population, 1), len(made.rows) + len(made.shell))
    # One coefficient per stated surface, and per row of alpha for the polygons that came later.
    n = len(made.shell)
    later = [n + row for row in made.solid.owner[n:]]
    of_polygon = rough[[*range(n), *later]]
    scene = Scene(
        made.solid.polygons,
        made.rows[made.solid.owner],
        of_polygon,
        attenuation(*climate, made.bands),
        331.3 * np.sqrt(1 + climate[0] / 273.15),
        receivers,
        radius,
        bool(rng.random() < 0.5),
    )
    stated_receivers = moved(rng, receivers)
    if kind == "receiver":
        stated_receivers, made.truth["receiver"] = misplaced(rng, made, stated_receivers, radius)
    corners = np.unique(np.round(np.concatenate(made.shell), 6), axis=0)
    stated = {
        "shape": made.kind_of_shape,
        "vertices": corners,
        "faces": [[int(((corners - x) ** 2).sum(1).argmin()) for x in p] for p in made.shell],
        "materials": [made.materials[o] for o in made.owner],
        "volume": round(shapes.volume(made.shell), 3),
        "areas": np.round(made.areas, 4),
        "bands": made.bands,
        "names": made.materials,
        "alpha": made.mu,
        "air": climate,
        "sources": moved(rng, sources),
        "receivers": stated_receivers,
    }
    return stated, scene, sources, made


def build(population: int, index: int, work: float = REFLECTIONS) -> dict[str, Any]:
    """Return {"stated", "measured", "truth"} of a room; pairs run over receivers first."""
    stated, scene, sources, made = draw(population, index)
    length = float(np.clip(1.3 * decay_time(scene, made).max(), 0.5, 10.0))
    free_path = 4 * stated["volume"] / float(made.areas.sum())
    n_rays = int(np.clip(work * free_path / (scene.c * length), 15_000, 500_000))
    energy = np.concatenate(
        [
            trace(scene, x, n_rays, 1000 * index + k, width=WIDTH, length=length)
            for k, x in enumerate(sources)
        ]
    )
    rng = np.random.default_rng([SEED, population, index, 1000])
    common = float(rng.uniform(0.3, 0.8))
    exact = parameters.evaluate(energy, WIDTH)
    truth = made.truth | {
        "alpha": made.rows[: len(made.materials)],
        "values": exact,
        "scattering": scene.scattering[: len(made.shell)],
        "vectors": scene.vectors,
        "common": common,
        "sources": sources,
        "receivers": scene.receivers,
        "n_rays": n_rays,
    }
    measured = parameters.measure(rng, energy, WIDTH, made.bands, common)
    return {"stated": stated, "measured": measured, "truth": truth}


def decay_time(scene: Scene, made: Room) -> np.ndarray:
    """Return the longest T to expect per band in s: the room's as stated, or the second room's."""
    alpha = made.rows[made.owner]
    if made.truth["kind"] == "covered surface":
        alpha[made.truth["surface"]] = made.rows[-1]
    times = eyring(replace(scene, polygons=made.shell, alpha=alpha))
    if made.truth["kind"] == "coupled room":
        surface = 2 * sum(shapes.area(p) for p in made.solid.polygons[-5:-2])
        exponent = -surface * np.log(1 - made.truth["second_alpha"])
        v = made.truth["second_volume"]
        times = np.maximum(times, 24 * np.log(10) / scene.c * v / (exponent + 4 * scene.air * v))
    return times
