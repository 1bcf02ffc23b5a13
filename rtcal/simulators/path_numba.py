"""The path tracer's inner loops, compiled. `rtcal.simulators.path_numpy` does the same in NumPy.

Both modules have `trace`, `histogram`, `histogram_gradient` and `histogram_changed` with the same
arguments, and trace the same paths up to rounding. Only `rtcal.simulators.paths` imports them, inside a
function.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtcal.support.jit import compiled
from rtcal.support.types import Array

# splitmix64 (Steele, Lea & Flood 2014) with one 64-bit state per path: a path does not depend on the
# number of other paths or threads.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = (np.uint64(s) for s in (30, 27, 31, 11))


@compiled(reorder=False)
def uniform(state: Any) -> float:
    """Return a random number in [0, 1) and step the state, (1,) of 64 bits."""
    state[0] += _GOLDEN
    z = state[0]
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    z = z ^ (z >> _S31)
    return float(z >> _S11) * 2.0**-53


@compiled(reorder=False)
def nearest(p: Array, v: Array, planes: Array, sides: Array) -> tuple[int, float]:
    """Return the first triangle that the ray hits and its distance; (-1, inf) if it hits none."""
    distance, triangle = np.inf, -1
    for i in range(planes.shape[0]):
        approach = -(planes[i, 0] * v[0] + planes[i, 1] * v[1] + planes[i, 2] * v[2])
        if approach <= 0.0:  # from behind, or parallel to the wall
            continue
        height = planes[i, 0] * p[0] + planes[i, 1] * p[1] + planes[i, 2] * p[2] - planes[i, 3]
        t = height / approach
        if t >= distance or t < -1e-9:
            continue
        x, y, z = p[0] + t * v[0], p[1] + t * v[1], p[2] + t * v[2]
        a = sides[i, 0, 0] * x + sides[i, 0, 1] * y + sides[i, 0, 2] * z - sides[i, 0, 3]
        if a < -1e-9 or a > 1.0 + 1e-9:
            continue
        b = sides[i, 1, 0] * x + sides[i, 1, 1] * y + sides[i, 1, 2] * z - sides[i, 1, 3]
        if b < -1e-9 or a + b > 1.0 + 1e-9:
            continue
        distance, triangle = t, i
    return triangle, distance


@compiled(reorder=False)
def grown(array: Any, needed: int) -> Any:
    """Return the array with space for ``needed`` elements; it grows at least to twice its size."""
    if needed <= array.size:
        return array
    larger = np.empty(max(2 * array.size, needed), array.dtype)
    larger[: array.size] = array
    return larger


@compiled(reorder=False)
def trace(
    origin: Array,
    directions: Array,
    seeds: Any,
    longest: float,
    planes: Array,
    sides: Array,
    owners: Any,
    scattering: Array,
    vector: bool,
    receivers: Array,
    radii: Array,
) -> tuple[Any, Any, Any, Any, Array]:
    """Trace paths: events, starts, lengths, weights (see `rtcal.simulators.path_batch.Batch`), counts.

    ``owners`` has the face of each triangle, ``scattering`` the coefficient of each face.
    ``counts``: paths lost; free paths, their sum and their sum of squares. A path that hits no wall is
    lost: none of its events is kept.
    """
    n_paths, n_receivers, n_faces = len(directions), len(receivers), len(scattering)
    starts = np.zeros(n_paths + 1, np.int64)
    events = np.empty(64 * n_paths + 64, np.uint16)
    lengths = np.empty(4 * n_paths + 64, np.float32)
    weights = np.empty(4 * n_paths + 64, np.float32)
    counts = np.zeros(4)
    n_events = n_heard = 0
    p, v, state = np.empty(3), np.empty(3), np.empty(1, np.uint64)
    for path in range(n_paths):
        first_event, first_heard = n_events, n_heard
        p[:] = origin
        v[:] = directions[path]
        state[0] = seeds[path]
        travelled, reflections, diffuse = 0.0, 0, False
        while travelled < longest:
            triangle, t = nearest(p, v, planes, sides)
            if triangle < 0:
                counts[0] += 1
                n_events, n_heard = first_event, first_heard
                break
            events = grown(events, n_events + n_receivers + 1)
            lengths = grown(lengths, n_heard + n_receivers)
            weights = grown(weights, n_heard + n_receivers)
            if reflections > 0:
                counts[1] += 1
                counts[2] += t
                counts[3] += t * t
                for r in range(n_receivers):
                    x, y, z = receivers[r, 0] - p[0], receivers[r, 1] - p[1], receivers[r, 2] - p[2]
                    along = x * v[0] + y * v[1] + z * v[2]
                    length = travelled + along
                    square = radii[r] * radii[r]
                    if (
                        0.0 < along < t
                        and length < longest
                        and x * x + y * y + z * z - along * along < square
                    ):
                        weight = 1.0 / (math.pi * square)
                        if not diffuse:
                            weight *= 0.5 * (1.0 + math.sqrt(max(1 - square / length**2, 0.0)))
                        events[n_events] = 2 * n_faces + r
                        lengths[n_heard] = length
                        weights[n_heard] = weight
                        n_events += 1
                        n_heard += 1
            travelled += t
            if travelled >= longest:
                break
            face = owners[triangle]
            events[n_events] = face
            n_events += 1
            reflections += 1
            choice, u, w = uniform(state), uniform(state), uniform(state)
            s = scattering[face]
            nx, ny, nz = planes[triangle, 0], planes[triangle, 1], planes[triangle, 2]
            across = v[0] * nx + v[1] * ny + v[2] * nz
            for i in range(3):
                p[i] += t * v[i]
                v[i] -= 2.0 * across * planes[triangle, i]
            if (vector and s > 0.0) or (not vector and choice < s):
                diffuse = True
                if not vector:
                    events[n_events - 1] = n_faces + face
                # The normal plus a random point of the unit sphere follows Lambert's law.
                up = 1.0 - 2.0 * u
                round_ = math.sqrt(max(1.0 - up * up, 0.0))
                lx = nx + round_ * math.cos(2.0 * math.pi * w)
                ly = ny + round_ * math.sin(2.0 * math.pi * w)
                lz = nz + up
                share = (s if vector else 1.0) / math.sqrt(lx * lx + ly * ly + lz * lz + 1e-30)
                specular = 1.0 - s if vector else 0.0
                v[0] = share * lx + specular * v[0]
                v[1] = share * ly + specular * v[1]
                v[2] = share * lz + specular * v[2]
            norm = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
            for i in range(3):
                v[i] /= norm
        starts[path + 1] = n_events
    return (
        events[:n_events].copy(),
        starts,
        lengths[:n_heard].copy(),
        weights[:n_heard].copy(),
        counts,
    )


@compiled(reorder=False)
def histogram(
    events: Any,
    starts: Any,
    lengths: Any,
    weights: Any,
    log_reflection: Array,
    attenuation: Array,
    first: Array,
    bin_length: float,
    out: Array,
) -> None:
    """Add the energy that the receivers hear to ``out``, (n_receivers, n_bands, n_bins)."""
    n_codes, n_bands = log_reflection.shape
    n_bins = out.shape[2]
    level = np.empty(n_bands)
    heard = 0
    for path in range(len(starts) - 1):
        level[:] = 0.0
        for e in range(starts[path], starts[path + 1]):
            code = np.int64(events[e])
            if code < n_codes:
                for k in range(n_bands):
                    level[k] += log_reflection[code, k]
                continue
            receiver, length = code - n_codes, np.float64(lengths[heard])
            place = math.floor((length - first[receiver]) / bin_length)
            if 0 <= place < n_bins:
                for k in range(n_bands):
                    out[receiver, k, place] += weights[heard] * math.exp(
                        level[k] - attenuation[k] * length
                    )
            heard += 1


@compiled(reorder=False)
def histogram_gradient(
    events: Any,
    starts: Any,
    lengths: Any,
    weights: Any,
    log_reflection: Array,
    attenuation: Array,
    first: Array,
    bin_length: float,
    groups: Any,
    counts: Array,
    out: Array,
    gradient: Array,
) -> None:
    """Add the energy to ``out``, and its products with sums over each group's hits to ``gradient``.

    ``groups`` (n_codes,) is the group of each code of a wall hit, and ``counts`` (n_codes,) what a hit
    adds to the sum. ``out`` (n_receivers, n_bands, n_bins), ``gradient`` (n_receivers, n_bins,
    n_groups, n_bands).
    """
    n_codes, n_bands = log_reflection.shape
    n_bins, n_groups = out.shape[2], gradient.shape[2]
    level, energy, sums = np.empty(n_bands), np.empty(n_bands), np.empty(n_groups)
    heard = 0
    for path in range(len(starts) - 1):
        level[:] = 0.0
        sums[:] = 0.0
        for e in range(starts[path], starts[path + 1]):
            code = np.int64(events[e])
            if code < n_codes:
                for k in range(n_bands):
                    level[k] += log_reflection[code, k]
                sums[groups[code]] += counts[code]
                continue
            receiver, length = code - n_codes, np.float64(lengths[heard])
            place = math.floor((length - first[receiver]) / bin_length)
            if 0 <= place < n_bins:
                for k in range(n_bands):
                    energy[k] = weights[heard] * math.exp(level[k] - attenuation[k] * length)
                    out[receiver, k, place] += energy[k]
                for j in range(n_groups):
                    if sums[j] != 0.0:
                        for k in range(n_bands):
                            gradient[receiver, place, j, k] += sums[j] * energy[k]
            heard += 1


@compiled(reorder=False)
def histogram_changed(
    events: Any,
    starts: Any,
    lengths: Any,
    weights: Any,
    log_reflection: Array,
    attenuation: Array,
    first: Array,
    bin_length: float,
    parts: Any,
    members: Any,
    factors: Array,
    out: Array,
) -> None:
    """Add to ``out`` the energy with each group of faces changed, in one sweep of the paths.

    ``parts`` (n_codes,) is the number of the part that the face of each code belongs to. ``members``
    (n_groups, n_parts) says which parts a group has. ``factors`` (n_parts, n_hits, n_changes n_bands)
    multiply the energy after as many hits on a part. ``out`` (n_receivers, n_bins, n_groups,
    n_changes n_bands).
    """
    n_codes, n_bands = log_reflection.shape
    n_bins, n_groups, width = out.shape[1:]
    n_parts, most = factors.shape[0], factors.shape[1] - 1
    level, energy = np.empty(n_bands), np.empty(width)
    hits = np.zeros(n_parts, dtype=np.int64)
    changed = np.empty(width)
    heard = 0
    for path in range(len(starts) - 1):
        level[:] = 0.0
        hits[:] = 0
        for e in range(starts[path], starts[path + 1]):
            code = np.int64(events[e])
            if code < n_codes:
                for k in range(n_bands):
                    level[k] += log_reflection[code, k]
                hits[parts[code]] = min(hits[parts[code]] + 1, most)
                continue
            receiver, length = code - n_codes, np.float64(lengths[heard])
            place = math.floor((length - first[receiver]) / bin_length)
            if 0 <= place < n_bins:
                for k in range(n_bands):
                    energy[k] = weights[heard] * math.exp(level[k] - attenuation[k] * length)
                for m in range(n_bands, width):
                    energy[m] = energy[m - n_bands]
                for j in range(n_groups):
                    changed[:] = energy
                    for u in range(n_parts):
                        if members[j, u] and hits[u] > 0:
                            for m in range(width):
                                changed[m] *= factors[u, hits[u], m]
                    for m in range(width):
                        out[receiver, place, j, m] += changed[m]
            heard += 1
