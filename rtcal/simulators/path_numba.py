"""The path tracer's inner loops, compiled. `rtcal.simulators.path_numpy` does the same in NumPy.

Both modules have `trace`, `histogram`, `histogram_gradient`, `histogram_changed` and `most_hits` with
the same arguments, and trace the same paths up to rounding. Only `rtcal.simulators.paths` imports them,
inside a function.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtcal.support.speed import compiled
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
def by_plane(planes: Array) -> tuple[Any, Any]:
    """Return the triangles' numbers, those of a plane together, and where each plane begins."""
    n = len(planes)
    order, begins = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    taken = np.zeros(n, np.bool_)
    n_planes = n_taken = 0
    for i in range(n):
        if taken[i]:
            continue
        begins[n_planes] = n_taken
        n_planes += 1
        for other in range(i, n):
            if not taken[other] and np.abs(planes[other] - planes[i]).max() < 1e-12:
                taken[other] = True
                order[n_taken] = other
                n_taken += 1
    begins[n_planes] = n
    return order, begins[: n_planes + 1].copy()


@compiled(reorder=False)
def nearest(
    px: float,
    py: float,
    pz: float,
    vx: float,
    vy: float,
    vz: float,
    planes: Array,
    sides: Array,
    order: Any,
    begins: Any,
) -> tuple[int, float]:
    """Return the first triangle that a ray from p along v hits, and its distance; else (-1, inf).

    ``order`` and ``begins`` are those of `by_plane`: a plane's triangles share its distance.
    """
    distance, triangle = np.inf, -1
    for plane in range(len(begins) - 1):
        first = order[begins[plane]]
        approach = -(planes[first, 0] * vx + planes[first, 1] * vy + planes[first, 2] * vz)
        if approach <= 0.0:  # from behind, or parallel to the wall
            continue
        height = planes[first, 0] * px + planes[first, 1] * py + planes[first, 2] * pz
        t = (height - planes[first, 3]) / approach
        if t >= distance or t < -1e-9:
            continue
        x, y, z = px + t * vx, py + t * vy, pz + t * vz
        for number in range(begins[plane], begins[plane + 1]):
            i = order[number]
            a = sides[i, 0, 0] * x + sides[i, 0, 1] * y + sides[i, 0, 2] * z - sides[i, 0, 3]
            if a < -1e-9 or a > 1.0 + 1e-9:
                continue
            b = sides[i, 1, 0] * x + sides[i, 1, 1] * y + sides[i, 1, 2] * z - sides[i, 1, 3]
            if b < -1e-9 or a + b > 1.0 + 1e-9:
                continue
            distance, triangle = t, i
            break
    return triangle, distance


@compiled(reorder=False)
def grown(array: Any, needed: int) -> Any:
    """Return a copy with space for ``needed`` elements, at least twice as large."""
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
    thinned: float,
    shares: Array,
) -> tuple[Any, Any, Any, Any, Array]:
    """Trace paths: events, starts, lengths, weights (see `rtcal.simulators.path_batch.Batch`), counts.

    ``owners`` has the face of each triangle, ``scattering`` the coefficient of each face. Paths whose
    number 2^i does not divide end at i times the length ``thinned``; what is heard after it weighs 1 /
    ``shares[i]`` times as much.
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
    state = np.empty(1, np.uint64)
    order, begins = by_plane(planes)
    for path in range(n_paths):
        first_event, first_heard = n_events, n_heard
        px, py, pz = origin[0], origin[1], origin[2]
        vx, vy, vz = directions[path, 0], directions[path, 1], directions[path, 2]
        state[0] = seeds[path]
        travelled, reflections, diffuse = 0.0, 0, False
        end, stage = longest, 1
        while stage < len(shares):
            if path % (1 << stage) != 0:
                end = min(longest, stage * thinned)
                break
            stage += 1
        while travelled < end:
            triangle, t = nearest(px, py, pz, vx, vy, vz, planes, sides, order, begins)
            if triangle < 0:
                counts[0] += 1
                n_events, n_heard = first_event, first_heard
                break
            if n_events + n_receivers + 1 > events.size:
                events = grown(events, n_events + n_receivers + 1)
            if n_heard + n_receivers > lengths.size:
                lengths = grown(lengths, n_heard + n_receivers)
                weights = grown(weights, n_heard + n_receivers)
            if reflections > 0:
                counts[1] += 1
                counts[2] += t
                counts[3] += t * t
                for r in range(n_receivers):
                    x, y, z = receivers[r, 0] - px, receivers[r, 1] - py, receivers[r, 2] - pz
                    along = x * vx + y * vy + z * vz
                    square = radii[r] * radii[r]
                    if x * x + y * y + z * z - along * along >= square:
                        continue
                    length = travelled + along
                    if 0.0 < along < t and length < end:
                        stage = min(int(length / thinned), len(shares) - 1)
                        weight = 1.0 / (math.pi * square * shares[stage])
                        if not diffuse:
                            weight *= 0.5 * (1.0 + math.sqrt(max(1 - square / length**2, 0.0)))
                        events[n_events] = 2 * n_faces + r
                        lengths[n_heard] = length
                        weights[n_heard] = weight
                        n_events += 1
                        n_heard += 1
            travelled += t
            if travelled >= end:
                break
            face = owners[triangle]
            events[n_events] = face
            n_events += 1
            reflections += 1
            choice, u, w = uniform(state), uniform(state), uniform(state)
            s = scattering[face]
            nx, ny, nz = planes[triangle, 0], planes[triangle, 1], planes[triangle, 2]
            across = vx * nx + vy * ny + vz * nz
            px, py, pz = px + t * vx, py + t * vy, pz + t * vz
            vx, vy, vz = vx - 2 * across * nx, vy - 2 * across * ny, vz - 2 * across * nz
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
                vx = share * lx + specular * vx
                vy = share * ly + specular * vy
                vz = share * lz + specular * vz
            norm = math.sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx / norm, vy / norm, vz / norm
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
def most_hits(events: Any, starts: Any, held: Any) -> int:
    """Return the most hits of a path on the faces of one group; ``held`` as in `histogram_changed`."""
    n_codes, n_groups = held.shape
    hits = np.zeros(n_groups, dtype=np.int64)
    most = 0
    for path in range(len(starts) - 1):
        hits[:] = 0
        for e in range(starts[path], starts[path + 1]):
            code = np.int64(events[e])
            if code < n_codes:
                for j in range(n_groups):
                    hits[j] += held[code, j]
        for j in range(n_groups):
            most = max(most, int(hits[j]))
    return most


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
    held: Any,
    powers: Array,
    out: Array,
) -> None:
    """Add to ``out`` the energy with each group of faces changed, in one sweep of the paths.

    ``held`` (n_codes, n_groups) is 1 where the face of a code belongs to a group, else 0. ``powers``
    (n_groups, n_hits, n_changes, n_bands) multiply the energy after as many hits on a group. ``out``
    (n_groups, n_receivers, n_bins, n_changes, n_bands).
    """
    n_codes, n_bands = log_reflection.shape
    n_groups, n_receivers, n_bins, n_changes, _ = out.shape
    n_hits = powers.shape[1]
    # Sorted by receiver and bin: what is summed after one another stands together in memory.
    heard = 0
    keys = np.empty(len(lengths), dtype=np.int64)
    begins = np.zeros(n_receivers * n_bins + 1, dtype=np.int64)
    for code in events:
        receiver = np.int64(code) - n_codes
        if receiver >= 0:
            place = math.floor((np.float64(lengths[heard]) - first[receiver]) / bin_length)
            keys[heard] = receiver * n_bins + place if 0 <= place < n_bins else -1
            if keys[heard] >= 0:
                begins[keys[heard] + 1] += 1
            heard += 1
    begins = np.cumsum(begins)
    slots = begins.copy()
    level, hits = np.empty(n_bands), np.zeros(n_groups, dtype=np.int64)
    counted = np.empty((begins[-1], n_groups), dtype=np.uint16)
    energy = np.empty((begins[-1], n_bands))
    heard = 0
    for path in range(len(starts) - 1):
        level[:] = 0.0
        hits[:] = 0
        for e in range(starts[path], starts[path + 1]):
            code = np.int64(events[e])
            if code < n_codes:
                for k in range(n_bands):
                    level[k] += log_reflection[code, k]
                for j in range(n_groups):
                    hits[j] += held[code, j]
                continue
            if keys[heard] >= 0:
                slot, length = slots[keys[heard]], np.float64(lengths[heard])
                slots[keys[heard]] += 1
                for k in range(n_bands):
                    energy[slot, k] = weights[heard] * math.exp(level[k] - attenuation[k] * length)
                for j in range(n_groups):
                    counted[slot, j] = hits[j]
            heard += 1
    # Energies of as many hits are summed before they are multiplied.
    sums = np.zeros((n_hits, n_bands))
    for key in range(n_receivers * n_bins):
        receiver, place = key // n_bins, key % n_bins
        for j in range(n_groups):
            least, most = n_hits, -1
            for slot in range(begins[key], begins[key + 1]):
                number = int(counted[slot, j])
                least, most = min(least, number), max(most, number)
                for k in range(n_bands):
                    sums[number, k] += energy[slot, k]
            for number in range(least, most + 1):
                for c in range(n_changes):
                    for k in range(n_bands):
                        out[j, receiver, place, c, k] += sums[number, k] * powers[j, number, c, k]
                sums[number] = 0.0
