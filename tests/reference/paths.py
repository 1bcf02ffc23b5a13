"""The path tracer's inner loops in NumPy, against which the compiled ones are tested.

They trace all paths together, step by step, and have the arguments of `rtcal.simulators.kernels`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators.geometry import first_hit
from rtcal.simulators.kernels import Batch, Weighing
from rtcal.support.types import Array

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = (np.uint64(s) for s in (30, 27, 31, 11))


def _uniform(state: NDArray[np.uint64]) -> Array:
    state += _GOLDEN
    z = (state ^ (state >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    z = z ^ (z >> _S31)
    return np.asarray((z >> _S11) * 2.0**-53)


def _kept(which: NDArray[np.bool_], *columns: Any) -> tuple[Any, ...]:
    return tuple(column[which] for column in columns)


def trace(
    origin: Array,
    directions: Array,
    seeds: NDArray[np.uint64],
    longest: float,
    planes: Array,
    order: NDArray[np.int64],
    begins: NDArray[np.int64],
    sides: Array,
    owners: NDArray[np.int64],
    scattering: Array,
    vector: bool,
    receivers: Array,
    radii: Array,
    thinned: float,
    shares: Array,
) -> tuple[Any, ...]:
    """Trace paths; returns the same as `rtcal.simulators.kernels.trace`."""
    n_paths, n_faces = len(directions), len(scattering)
    p, v = np.broadcast_to(origin, directions.shape).copy(), directions.copy()
    state, travelled = seeds.copy(), np.zeros(n_paths)
    diffuse = np.zeros(n_paths, dtype=bool)
    alive = np.arange(n_paths)
    ends = np.full(n_paths, longest)
    for stage in range(len(shares) - 1, 0, -1):
        ends[alive % 2**stage != 0] = min(longest, stage * thinned)
    lost = np.zeros(n_paths, dtype=bool)
    counts = np.zeros(4)
    events: list[tuple[Any, Any, Any, Any]] = []  # path, code, length and weight, by step
    step = 0
    while alive.size:
        triangle, t = first_hit(p, v, planes, sides)
        hits_wall = np.isfinite(t)
        lost[alive[~hits_wall]] = True
        alive, p, v, travelled, state, diffuse, triangle, t = _kept(
            hits_wall, alive, p, v, travelled, state, diffuse, triangle, t
        )
        if step:
            counts[1:] += t.size, t.sum(), (t * t).sum()
            for r, (centre, radius) in enumerate(zip(receivers, radii, strict=True)):
                to = centre - p
                along = np.sum(to * v, axis=1)
                length = travelled + along
                hit = (along > 0) & (along < t) & (length < ends[alive])
                hit &= np.sum(to * to, axis=1) - along**2 < radius**2
                ratio = radius**2 / np.maximum(length[hit], radius) ** 2
                weight = np.where(diffuse[hit], 1.0, 0.5 * (1 + np.sqrt(1 - ratio)))
                stage = np.minimum((length[hit] / thinned).astype(int), len(shares) - 1)
                weight = weight / shares[stage]
                events.append(
                    (
                        alive[hit],
                        np.full(hit.sum(), 2 * n_faces + r),
                        length[hit],
                        weight / (np.pi * radius**2),
                    )
                )
        travelled = travelled + t
        on = travelled < ends[alive]
        alive, p, v, travelled, state, diffuse, triangle, t = _kept(
            on, alive, p, v, travelled, state, diffuse, triangle, t
        )
        face, normal = owners[triangle], planes[triangle, :3]
        nothing = np.full(alive.size, np.nan)
        choice, u, w = _uniform(state), _uniform(state), _uniform(state)
        p = p + t[:, np.newaxis] * v
        v = v - 2 * np.sum(v * normal, axis=1, keepdims=True) * normal
        up = 1 - 2 * u
        round_ = np.sqrt(np.maximum(1 - up * up, 0))
        lambert = normal + np.stack(
            [round_ * np.cos(2 * np.pi * w), round_ * np.sin(2 * np.pi * w), up], axis=1
        )
        lambert /= np.sqrt(np.sum(lambert**2, axis=1, keepdims=True) + 1e-30)
        s = scattering[face]
        spread = s > 0 if vector else choice < s
        scattered = np.zeros(alive.size, dtype=bool) if vector else spread
        events.append((alive, face + n_faces * scattered, nothing, nothing))
        share = np.where(spread, s if vector else 1.0, 0.0)[:, np.newaxis]
        v = share * lambert + (1 - share) * v
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        diffuse = diffuse | spread
        step += 1
    counts[0] = np.count_nonzero(lost)
    path, code, length, weight = (np.concatenate(column) for column in zip(*events, strict=True))
    path, code, length, weight = _kept(~lost[path], path, code, length, weight)
    entries = np.argsort(path, kind="stable")  # keeps the order of the steps of each path
    heard = entries[code[entries] >= 2 * n_faces]
    starts = np.concatenate([[0], np.cumsum(np.bincount(path, minlength=n_paths))])
    number = np.bincount(path[heard], minlength=n_paths)
    single = (each[heard].astype(np.float32) for each in (length, weight))
    return code[entries].astype(np.uint16), starts, number, *single, counts


def histogram(batches: Sequence[Batch], weighing: Weighing, out: Array) -> None:
    """Add the energy that the receivers hear to ``out``, (n_receivers, n_bands, n_bins)."""
    shape = (out.shape[0], out.shape[2])
    for batch in batches:
        _, _, energy, flat, in_bins = _heard(batch, weighing, shape)
        out += np.moveaxis(_sums(flat, energy, in_bins, shape), 2, 1)


def histogram_gradient(
    batches: Sequence[Batch],
    weighing: Weighing,
    groups: NDArray[np.int64],
    counts: Array,
    out: Array,
    gradient: Array,
) -> None:
    """Add energy and derivatives as `rtcal.simulators.kernels.histogram_gradient` does."""
    shape = (out.shape[0], out.shape[2])
    histogram(batches, weighing, out)
    for batch in batches:
        heard, begin, energy, flat, in_bins = _heard(batch, weighing, shape)
        events = batch[0]
        wall = events < len(weighing[0])
        code = np.where(wall, events, 0)
        group = np.where(wall, groups[code], -1)
        for j in range(gradient.shape[2]):
            hits = np.concatenate([[0], np.cumsum(np.where(group == j, counts[code], 0.0))])
            counted = (hits[heard] - hits[begin])[:, np.newaxis]
            gradient[:, :, j] += _sums(flat, counted * energy, in_bins, shape)


def _sums(
    flat: NDArray[np.int64], energy: Array, in_bins: NDArray[np.bool_], shape: tuple[int, int]
) -> Array:
    """Return the energy of each receiver's bins, (n_receivers, n_bins, n_bands)."""
    size = shape[0] * shape[1]
    sums = [np.bincount(flat[in_bins], column[in_bins], minlength=size) for column in energy.T]
    return np.stack(sums, axis=1).astype(float).reshape(*shape, energy.shape[1])


def _heard(
    batch: Batch, weighing: Weighing, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Return each reception's event, its path's first event, energy, bin, and whether it has a bin.

    Energies are (n, n_bands). Bins are counted over all receivers. ``shape`` is (n_receivers, n_bins).
    """
    events, starts, lengths, weights = batch
    log_reflection, attenuation, first, bin_length = weighing
    n_codes, n_bands = log_reflection.shape
    heard = np.flatnonzero(events >= n_codes)
    receiver = events[heard].astype(np.int64) - n_codes
    length = lengths.astype(float)
    place = np.floor((length - first[receiver]) / bin_length).astype(np.int64)
    begin = starts[np.searchsorted(starts, heard, side="right") - 1]
    # -inf for a wall that reflects nothing would make a difference of sums NaN; exp(-800) is 0 too.
    steps = np.vstack([np.maximum(log_reflection, -800), np.zeros((shape[0], n_bands))])
    energy = np.empty((len(heard), n_bands))
    for k in range(n_bands):
        level = np.concatenate([[0.0], np.cumsum(steps[events, k])])
        energy[:, k] = weights * np.exp(level[heard] - level[begin] - attenuation[k] * length)
    return heard, begin, energy, receiver * shape[1] + place, (place >= 0) & (place < shape[1])
