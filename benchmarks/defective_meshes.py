"""200 rooms with the defects of real models: V and S within 1 %.

    python -m benchmarks.defective_meshes [number]

Each room is a prism over a random footprint with a flat or a pitched roof, drawn as a person would, and
then damaged: joints rounded to a centimetre, slivers, windows on walls, doors to the floor, flipped
faces, faces drawn twice, free panels, tables without a bottom, small holes, fins, closed objects on the
floor and on a wall, stages that are open to the floor and to a wall; and what cannot be mended: a
missing wall, a wall 15 cm beside its place, a sheet instead of a room. V and S of the room as meant are
known. A free panel counts on both sides, a window takes the area of its wall, and where an object
stands neither it nor the wall counts.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from rtcal.io.mend import Faces, MeshError, mended
from rtcal.simulators.geometry import triangulate, vector_area

Array = np.ndarray
MENDED = (
    "joint", "sliver", "overlay", "door", "block", "cupboard", "stage", "turned", "twice", "panel",
    "open bottom", "hole", "fin", "triangles",
)  # fmt: skip
REFUSED = {
    "missing wall": "hole",
    "wall beside": "hole",
    "sheet": "the faces do not enclose a volume",
}


@dataclass
class Drawn:
    """A room as it is drawn, and as it is meant."""

    polygons: list[Array]
    names: list[str]
    volume: float
    areas: Counter[str]
    defects: list[str] = field(default_factory=list)
    walls: int = 0
    taken: set[int] = field(default_factory=set)

    def faces(self) -> Faces:
        names = [f"{n} {i}" for i, n in enumerate(self.names)]
        return Faces("mesh", self.polygons, self.names, names)


def size(polygon: Array) -> float:
    return float(np.linalg.norm(vector_area(polygon)))


def room(rng: np.random.Generator) -> Drawn:
    """Return a closed prism: a star-shaped footprint of 4 to 8 corners, its roof flat or oblique."""
    n = int(rng.integers(4, 9))
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n
    radii = rng.uniform(5, 14) * rng.uniform(0.75, 1.25, n)
    flat = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    height = rng.uniform(3, 9)
    slope = rng.uniform(-0.15, 0.15, 2) * (rng.random() < 0.5)
    top = height + flat @ slope
    low = np.hstack([flat, np.zeros((n, 1))])
    high = np.hstack([flat, top[:, np.newaxis]])
    polygons = [low[::-1].copy(), high.copy()]
    names = ["floor", "ceiling"]
    for i in range(n):
        j = (i + 1) % n
        polygons.append(np.array([low[i], low[j], high[j], high[i]]))
        names.append("wall")
    volume = sum(float(p[0] @ vector_area(p)) for p in polygons) / 3
    areas = Counter[str]()
    for polygon, name in zip(polygons, names, strict=True):
        areas[name] += size(polygon)
    return Drawn(polygons, names, abs(volume), areas, walls=n)


def on_wall(
    drawn: Drawn,
    rng: np.random.Generator,
    bottom: float,
    heights: tuple[float, float] = (0.6, 1.6),
    starts: tuple[float, float] = (0.15, 0.4),
    widths: tuple[float, float] = (0.1, 0.4),
) -> tuple[int, Array]:
    """Return a wall that is free, and a rectangle on it that begins at this height."""
    i = int(rng.choice([i for i in range(2, 2 + drawn.walls) if i not in drawn.taken]))
    drawn.taken.add(i)
    a, b, _, _ = drawn.polygons[i]
    along = b - a
    start, width = rng.uniform(*starts), rng.uniform(*widths)
    top = bottom + rng.uniform(*heights)
    foot = [a + along * start, a + along * (start + width)]
    up = np.array([0, 0, 1.0])
    return i, np.array(
        [foot[0] + bottom * up, foot[1] + bottom * up, foot[1] + top * up, foot[0] + top * up]
    )


def prism(base: Array, shift: Array) -> list[Array]:
    """Return the faces of a prism: its base, its sides, its top."""
    top = base + shift
    n = len(base)
    sides = [np.array([base[i], base[i - 1], top[i - 1], top[i]]) for i in range(n)]
    return [base, *sides, top[::-1]]


def place(drawn: Drawn, kind: str, rng: np.random.Generator) -> None:
    """Add an object that touches the floor or a wall, flat or high, up to 1 mm beside its place."""
    beside = float(rng.choice([-0.001, 0.0, 0.001]))
    if kind == "block":
        x, y = rng.uniform(0.1, 0.2, 2)
        w, d = rng.uniform(0.4, 1.0, 2)
        h = rng.uniform(0.08, 0.2) if rng.random() < 0.5 else rng.uniform(0.5, 1.6)
        base = np.array([[x, y, 0], [x + w, y, 0], [x + w, y + d, 0], [x, y + d, 0]])
        faces = prism(base + np.array([0, 0, beside]), np.array([0, 0, h]))
        covered = {"floor": size(base)}
    else:
        bottom = 0.0 if kind == "stage" or rng.random() < 0.5 else 0.8
        low, high = (0.15, 0.8) if kind == "stage" else (0.5, 1.2)
        i, base = on_wall(drawn, rng, bottom, (low, high), (0.35, 0.45), (0.1, 0.2))
        normal = vector_area(drawn.polygons[i])
        inwards = -normal / np.linalg.norm(normal)
        depth = rng.uniform(0.15, 0.4)
        faces = prism(base + beside * inwards, inwards * depth)
        covered = {"wall": size(base)}
        if bottom == 0:
            covered["floor"] = depth * float(np.linalg.norm(base[1] - base[0]))
    own = sum(map(size, faces)) - sum(covered.values())
    solid = size(faces[0]) * float(np.linalg.norm(faces[-1][::-1][0] - faces[0][0]))
    if kind == "stage":
        foot = [np.ptp(f[:, 2]) < 1e-9 and f[:, 2].max() < 0.01 for f in faces]
        faces = [f for k, f in enumerate(faces) if k and not foot[k]]
    drawn.polygons += faces
    drawn.names += [kind] * len(faces)
    drawn.volume -= solid
    drawn.areas[kind] += own
    for name, area in covered.items():
        drawn.areas[name] -= area


def damage(drawn: Drawn, kind: str, rng: np.random.Generator) -> None:
    """Damage a room by one defect, and change what is meant where it adds something."""
    drawn.defects.append(kind)
    polygons, names = drawn.polygons, drawn.names
    if kind == "joint":
        for k, polygon in enumerate(polygons):
            polygons[k] = polygon + rng.uniform(-0.0025, 0.0025, polygon.shape)
    elif kind == "sliver":  # two walls drawn with a strip of 4 mm between them
        i = 2 + int(rng.integers(drawn.walls))
        a, b, c, d = polygons[i]
        step = 0.004 * (b - a) / np.linalg.norm(b - a)
        middle, over = (a + b) / 2, (c + d) / 2
        polygons[i] = np.array([a, middle, over, d])
        polygons += [np.array([middle, middle + step, over + step, over]),
                     np.array([middle + step, b, c, over + step])]  # fmt: skip
        names += ["wall", "wall"]
    elif kind in ("overlay", "door"):
        i, window = on_wall(drawn, rng, 0.0 if kind == "door" else rng.uniform(0.5, 1.2))
        normal = vector_area(polygons[i])
        polygons.append(window - normal / np.linalg.norm(normal) * rng.uniform(0, 0.03))
        names.append("glass" if kind == "overlay" else "door")
        drawn.areas[names[-1]] += size(window)
        drawn.areas["wall"] -= size(window)
    elif kind in ("block", "cupboard", "stage"):
        place(drawn, kind, rng)
    elif kind == "turned":
        for k in rng.choice(len(polygons), max(1, len(polygons) // 3), replace=False):
            polygons[k] = polygons[k][::-1]
    elif kind == "twice":
        k = int(rng.integers(2, 2 + drawn.walls))
        polygons.append(np.roll(polygons[k], 1, axis=0)[::-1])
        names.append(names[k])
    elif kind == "panel":
        centre = np.array([*rng.uniform(-1, 1, 2), rng.uniform(1.8, 2.6)])
        u, v = rng.normal(size=3), rng.normal(size=3)
        u /= np.linalg.norm(u) / rng.uniform(0.2, 0.5)
        v -= u * (u @ v) / (u @ u)
        v /= np.linalg.norm(v) / rng.uniform(0.2, 0.5)
        panel = np.array([centre - u - v, centre + u - v, centre + u + v, centre - u + v])
        polygons.append(panel)
        names.append("reflector")
        drawn.areas["reflector"] += 2 * size(panel)
    elif kind == "open bottom":
        x, y = rng.uniform(-1.5, -1.2), rng.uniform(-1.5, -1.2)
        w, d, h = rng.uniform(0.4, 1.2, 3)
        h *= 0.2 if rng.random() < 0.5 else 1
        low = np.array([[x, y, 0], [x + w, y, 0], [x + w, y + d, 0], [x, y + d, 0]])
        high = low + np.array([0, 0, h])
        polygons += [np.array([low[i], low[i - 1], high[i - 1], high[i]]) for i in range(4)]
        polygons.append(high)
        names += ["table"] * 5
        drawn.volume -= w * d * h
        drawn.areas["table"] += 2 * (w + d) * h + w * d
        drawn.areas["floor"] -= w * d
    elif kind == "hole":  # a wall in four parts around a hole
        i = 2 + int(rng.integers(drawn.walls))
        a, b, c, d = polygons[i]
        share = np.sqrt(0.004 * drawn.areas.total() / size(polygons[i]))
        at = np.array([0.5 - share / 2, 0.5 + share / 2])

        def point(s: float, t: float) -> Array:
            return (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * d + s * c)

        inner = [point(at[0], at[0]), point(at[1], at[0]), point(at[1], at[1]), point(at[0], at[1])]
        outer = [a, b, c, d]
        polygons[i] = np.array([outer[0], outer[1], inner[1], inner[0]])
        for k in range(1, 4):
            j = (k + 1) % 4
            polygons.append(np.array([outer[k], outer[j], inner[j], inner[k]]))
            names.append("wall")
    elif kind == "fin":
        a = polygons[0][0]
        d = next(c for c in polygons[1] if np.allclose(c[:2], a[:2]))
        inwards = -(a + d) / 2 * np.array([1, 1, 0])
        inwards *= rng.uniform(0.5, 1.0) / np.linalg.norm(inwards)
        fin = np.array([a, a + inwards, d + inwards - [0, 0, 0.8], d])
        polygons.append(fin)
        names.append("fin")
        drawn.areas["fin"] += 2 * size(fin)
    elif kind == "triangles":
        new = [
            (p[list(t)], n) for p, n in zip(polygons, names, strict=True) for t in triangulate(p)
        ]
        drawn.polygons, drawn.names = [p for p, _ in new], [n for _, n in new]
    elif kind == "missing wall":
        k = int(np.argmax([size(p) for p in polygons]))
        del polygons[k], names[k]
    elif kind == "wall beside":
        normal = vector_area(polygons[2])
        polygons[2] = polygons[2] + 0.15 * normal / np.linalg.norm(normal)
    elif kind == "sheet":
        drawn.polygons, drawn.names = polygons[:1], names[:1]


def example(seed: int) -> Drawn:
    """Return a damaged room: every fifth cannot be mended, the others have one to four defects."""
    rng = np.random.default_rng(seed)
    drawn = room(rng)
    if seed % 5 == 4:
        damage(drawn, list(REFUSED)[(seed // 5) % len(REFUSED)], rng)
        return drawn
    first = MENDED[seed % len(MENDED)]
    more = rng.choice(MENDED, int(rng.integers(0, 4)), replace=False)
    chosen = {first, *map(str, more)}
    for kind in MENDED[1:-1]:  # in an order in which each finds the walls as they were drawn
        if kind in chosen and not (
            kind == "hole" and chosen & {"overlay", "door", "sliver", "twice", "cupboard", "stage"}
        ):
            damage(drawn, kind, rng)
    for kind in ("triangles", "joint"):
        if kind in chosen:
            damage(drawn, kind, rng)
    return drawn


def judged(seed: int) -> tuple[str, str]:
    """Return what came of a mesh, "right", "refused right", "refused wrong" or "silent", and why."""
    drawn = example(seed)
    unmendable = [REFUSED[d] for d in drawn.defects if d in REFUSED]
    try:
        done = mended(drawn.faces())
    except MeshError as error:
        right = any(name in str(error) for name in unmendable)
        return ("refused right" if right else "refused wrong"), f"{drawn.defects}: {error}"
    volume = done.geometry.volume / drawn.volume - 1
    area = float(np.sum(done.geometry.face_areas)) / drawn.areas.total() - 1
    within = abs(volume) <= 0.01 and abs(area) <= 0.01 and not unmendable
    said = f"{drawn.defects}: V {100 * volume:+.2f} %, S {100 * area:+.2f} %, {done}"
    return ("right" if within else "silent"), said


def areas_held(seed: int) -> list[bool]:
    """Whether each material's area is right within twice its standard uncertainty, or 0.1 %."""
    drawn = example(seed)
    try:
        done = mended(drawn.faces())
    except MeshError:
        return []
    u = done.area_uncertainty
    return [
        abs(area - drawn.areas[m]) <= max(2 * u.get(m, 0.0), 1e-3 * drawn.areas[m])
        for m, area in done.areas.items()
    ]


def main() -> None:
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    results = [judged(seed) for seed in range(number)]
    for seed, (what, why) in enumerate(results):
        if what in ("silent", "refused wrong"):
            print(f"{seed}: {what}: {why}\n")
    print(dict(Counter(what for what, _ in results)))
    held = [h for seed in range(number) for h in areas_held(seed)]
    print(f"{sum(held)} of {len(held)} areas within twice their uncertainty, or 0.1 %")


if __name__ == "__main__":
    main()
