"""Traces the sound paths of a polyhedron."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators import paths, tracer
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_numpy import LARGEST_CODE, Batch
from rtcal.simulators.tracer import ScatteringModel
from rtcal.support.errors import DataError
from rtcal.support.speed import thread_pool
from rtcal.support.types import Array

MOST_LOST = 0.01
"""Largest share of paths that may leave through gaps between the faces; they are dropped.

Surveyed meshes have gaps: in CR2 of BRAS (503 triangles) 1 to 2 of 8000 paths are lost. A path has some
100 reflections in the time of a T20. So 1 % are lost through gaps of 1/10,000 of the surface, which
would change a mean alpha by 0.0001 if the paths were not dropped. A missing face loses far more."""


HALVINGS = 4
"""How often the number of paths is halved at most where it is thinned."""
_LEFT = 32
"""Least number of paths of a batch that are left."""


def trace(
    geometry: Polyhedron,
    sources: Array,
    receivers: Array,
    *,
    materials: NDArray[np.int64],
    scattering: Array,
    radii: Array,
    longest: float,
    n_paths: int,
    n_batches: int,
    scattering_model: ScatteringModel,
    seed: int,
    workers: int | None = None,
    thinned: float = np.inf,
) -> paths.Paths:
    """Trace ``n_paths`` from each source.

    A path that leaves through a gap between faces is dropped whole, and the others of its source weigh
    the more. Receivers are spheres of radius r. A path without a diffuse reflection is weighed by
    1 / (L² solid angle), with the sphere's solid angle at its image source, every other path by
    1 / (pi r²). The expected energy is then that at the receiver's centre for any radius, exactly
    if no edge shades a part of the sphere. The direct sound is not traced but calculated.

    Parameters
    ----------
    geometry : Polyhedron
    sources, receivers : array (n, 3)
        In m, inside the room.
    materials : int array (n_faces,)
        Number of each face's material.
    scattering : array (n_materials,)
    radii : array (n_receivers,)
        In m; no more than the distance to the nearest wall.
    longest : float
        Length in m to which each path is followed.
    n_paths, n_batches : int
        Paths per source, and number of independent batches.
    scattering_model : "random" or "vector"
        See `ScatteringModel`.
    seed : int
        The same seed gives the same paths for any ``longest`` and ``workers``: longer paths start
        as the shorter ones do.
    workers : int, optional
        Number of threads, by default the number of processors.
    thinned : float
        Length in m after which every second path ends, and again after each further such length, until
        1 in 2**`HALVINGS` is left, or few. Those left weigh as many times more (Russian roulette,
        Spanier & Gelbard 1969), so that the expected energy is the same.

    Raises
    ------
    DataError
        If more than `MOST_LOST` of the paths hit no wall: the faces leave gaps or cut each other. For
        more faces and receivers than the events' codes can tell.
    """
    if 2 * len(materials) + len(receivers) > LARGEST_CODE:
        raise DataError(
            f"{len(materials)} faces and {len(receivers)} receivers are too many: twice the faces and "
            f"the receivers are at most {LARGEST_CODE}"
        )
    planes, sides = tracer.planes(geometry)
    by_face = np.ascontiguousarray(np.asarray(scattering, dtype=float)[materials])
    per_batch = -(-n_paths // n_batches)
    run = paths.kernels().trace
    # A batch whose number of paths no power of two divides keeps a little more than its share.
    halvings = [i for i in range(HALVINGS + 1) if i == 0 or per_batch >= _LEFT * 2**i]
    shares = np.array([-(-per_batch // 2**i) / per_batch for i in halvings])

    def trace_batch(job: tuple[int, int]) -> Batch:
        s, b = job
        sequence = np.random.SeedSequence([seed, s, b])
        seeds = sequence.generate_state(per_batch, np.uint64)
        directions = tracer.sphere(per_batch, np.random.default_rng(sequence.spawn(1)[0]))
        events, starts, lengths, weights, counts = run(
            sources[s],
            directions,
            seeds,
            float(longest),
            planes,
            sides,
            geometry.triangle_faces,
            by_face,
            scattering_model == "vector",
            receivers,
            np.ascontiguousarray(radii, dtype=float),
            float(thinned),
            shares,
        )
        free = (float(counts[1]), float(counts[2]), float(counts[3]))
        return Batch(events, starts, lengths, weights, directions, int(counts[0]), free)

    jobs = [(s, b) for s in range(len(sources)) for b in range(n_batches)]
    with thread_pool(workers) as pool:
        done = list(pool.map(trace_batch, jobs))
    lost = sum(batch.lost for batch in done)
    if lost > max(1, MOST_LOST * per_batch * len(jobs)):
        raise DataError(
            f"{lost} of {per_batch * len(jobs)} paths hit no wall, at most {100 * MOST_LOST:g} % may: "
            "the room's faces leave gaps or cut through each other"
        )
    batches = tuple(tuple(done[s * n_batches : (s + 1) * n_batches]) for s in range(len(sources)))
    direct = tracer.direct_lengths(geometry, sources, receivers)
    return paths.Paths(
        batches=batches,
        materials=materials.copy(),
        scattering=np.array(scattering, dtype=float),
        scattering_model=scattering_model,
        n_materials=len(scattering),
        n_paths=per_batch * n_batches,
        longest=float(longest),
        direct=direct,
        direct_gain=np.ones(direct.shape),
        first=_first(batches, direct, 2 * len(materials), longest),
    )


def _first(
    batches: tuple[tuple[Batch, ...], ...], direct: Array, n_codes: int, longest: float
) -> Array:
    """Return the length of the first sound: direct, else first heard, else ``longest``."""
    first = direct.copy()
    for s, r in np.argwhere(np.isnan(direct)):
        heard = [b.lengths[b.events[b.events >= n_codes] == n_codes + r] for b in batches[s]]
        first[s, r] = min((float(x.min()) for x in heard if x.size), default=longest)
    return first
