"""The difference of a patch on a part of a surface from one that is spread over all of it.

    python -m benchmarks.studies.pairs.where_patches --number 6

Walls of development boxes (population 0 of studies/geometric_world) are divided into nine. A patch
covers one to three adjoining ninths, and the same paths are weighed with it and with the same
absorption spread over its wall. Printed are the deviation of a shift per pair from the spread one's,
over the mean shift: its part common to all pairs, and each pair's own, by parameter.
`rtcal.finder.positions.problem` has them.
"""

from __future__ import annotations

import argparse
import warnings
from itertools import product

import numpy as np

from benchmarks.studies.geometric_world.load import IN_SITU, load, stored
from benchmarks.studies.pairs.where import case_of
from rtcal.acoustics.observables import MATCH, observable
from rtcal.finder.positions.weighing import Weighing
from rtcal.simulators import Polyhedron

PARTS, PATHS, SHARE, PATCHES = 3, 12_000, 0.8, 12
"""Parts of a wall along each axis, paths per source, the step of alpha towards 1, patches per room."""
SIGNS = np.array([1.0 if name == "c80" else -1.0 for name in MATCH])[:, np.newaxis, np.newaxis]
"""Of the linear scales' shifts by more absorption."""


def divided(box: Polyhedron) -> tuple[Polyhedron, np.ndarray, np.ndarray]:
    """Return a box with every wall in `PARTS`² parts; each part's wall, and its place on it (n, 2)."""
    low, high = box.vertices.min(axis=0), box.vertices.max(axis=0)
    number = {n: i for i, n in enumerate(product(range(PARTS + 1), repeat=3))}
    vertices = low + (high - low) * np.array(list(number)) / PARTS
    faces, owner, place = [], [], []
    middles = np.array([box.vertices[list(face)].mean(axis=0) for face in box.faces])
    for axis, end in product(range(3), (0, PARTS)):
        u, v = ((1, 2), (2, 0), (0, 1))[axis]
        at = low[axis] if end == 0 else high[axis]
        wall = int(np.argmin(np.abs(middles[:, axis] - at)))
        for a, b in product(range(PARTS), repeat=2):
            corners = []
            for da, db in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = [0, 0, 0]
                corner[axis], corner[u], corner[v] = end, a + da, b + db
                corners.append(number[(corner[0], corner[1], corner[2])])
            faces.append(corners if end else corners[::-1])
            owner.append(wall)
            place.append((a, b))
    made = Polyhedron(
        vertices=vertices, faces=faces, materials=[box.materials[wall] for wall in owner]
    )
    return made, np.array(owner), np.array(place)


def deviations(index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return relative deviations, (n, n_parameters, n_pairs, n_bands), and shares of the wall."""
    case = case_of(load(0, index, IN_SITU), "level")
    geometry, owner, place = divided(case.geometry)
    tracer = case.simulator
    weighing = Weighing(
        type(tracer)(
            geometry=geometry,
            room=case.room,
            sources=tracer.sources,
            receivers=tracer.receivers,
            scattering=tracer.scattering,
            n_paths=PATHS,
        ),
        MATCH,
    )
    rng = np.random.default_rng(index)
    patches, walls, shares = [], [], []
    for n in range(PATCHES):
        wall, size = int(rng.integers(6)), 1 + n % 3
        along, (a, b) = int(rng.integers(2)), rng.integers(PARTS, size=2)
        rows = [((m, b) if along else (a, m)) for m in range(PARTS)]
        start = int(rng.integers(PARTS - size + 1))
        chosen = rows[start : start + size]
        members = [i for i in np.flatnonzero(owner == wall) if tuple(place[i]) in chosen]
        patches.append(np.array(members))
        walls.append(np.flatnonzero(owner == wall))
        shares.append(SHARE * size / PARTS**2)
    base = weighing.observe(weighing.alpha)

    def linear(energy: np.ndarray) -> np.ndarray:
        values = weighing.parameters(energy)
        rows = zip(MATCH, values, base, strict=True)
        return np.array([observable(name).linear(value, at) for name, value, at in rows])

    here = np.array([linear(e[0]) for e in weighing.of_groups(patches, [SHARE])])
    steps = sorted(set(shares))
    spread = [
        linear(e[steps.index(s)])
        for e, s in zip(weighing.of_groups(walls, steps), shares, strict=True)
    ]
    amount = (np.array(spread) * SIGNS).mean(axis=(1, 2), keepdims=True)
    return (here - np.array(spread)) * SIGNS / amount, np.array(shares) / SHARE


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--number", type=int, default=6)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    rooms = stored(0, "rooms")
    boxes = [i for i, r in rooms.items() if r["stated"]["shape"] == "box"][: given.number]
    every, shares = [], []
    for index in boxes:
        deviation, share = deviations(index)
        every.append(deviation.mean(axis=-1))  # over bands: their paths are the same
        shares.append(share)
        print(index, np.round(every[-1].std(axis=(0, 2)), 2), flush=True)
    table, share = np.concatenate(every), np.concatenate(shares)
    common = table.mean(axis=2)
    own = (table - common[:, :, np.newaxis]) * np.sqrt(table.shape[2] / (table.shape[2] - 1))
    print(f"{'parameters':44}", *MATCH)
    for size in sorted(set(share)):
        near = share == size
        print(f"share of the wall {size:.2f}: common deviation", end=" ")
        print(np.round(np.sqrt((common[near] ** 2).mean(axis=0)), 2), end=" each pair's own ")
        print(np.round(np.sqrt((own[near] ** 2).mean(axis=(0, 2))), 2))
    open_wall = np.sqrt(1 / share - 1)
    common, own = common / open_wall[:, np.newaxis], own / open_wall[:, np.newaxis, np.newaxis]
    print(
        "over sqrt(1 / share - 1): common", np.round(np.sqrt((common**2).mean(axis=0)), 3), end=""
    )
    print(" own", np.round(np.sqrt((own**2).mean(axis=(0, 2))), 3))
    print("correlation of the common ones\n", np.round(np.corrcoef(common.T), 2))
    own_rows = np.moveaxis(own, 1, 0).reshape(len(MATCH), -1)
    print("correlation of a pair's own\n", np.round(np.corrcoef(own_rows), 2))


if __name__ == "__main__":
    main()
