"""The simulators' inner loops, compiled: of traced paths, image sources and scattering delay networks.

Importing this module takes numba, so simulators import it where they run. `tests/reference` has the
same in NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.support.speed import compiled
from rtcal.support.types import Array

# splitmix64 (Steele, Lea & Flood 2014) with one 64-bit state per path: a path does not depend on the
# number of other paths or threads.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = (np.uint64(s) for s in (30, 27, 31, 11))
_ONCE, _TWICE, _THRICE = (np.uint64(n) for n in (1, 2, 3))
Batch = tuple[Any, Any, Any, Any]
"""Events, starts, lengths and weights of paths, as in `rtcal.simulators.path_tracing.Batch`."""
Weighing = tuple[Array, Array, Array, float]
"""Numbers that give paths their energy: ln(1 - alpha) for each code of a wall hit, (n_codes, n_bands);
air attenuation in 1/m, (n_bands,); lengths in m of each receiver's first sound, (n_receivers,), and of
a bin."""

_DISTANCES = 2048
"""Distances from paths to planes that are computed together, by vector instructions; 16 kB of them."""


@compiled(reorder=False, inner=True)
def uniform(state: Any, step: Any) -> float:
    """Return the random number in [0, 1) that a state of 64 bits has after some steps."""
    z = state + step * _GOLDEN
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    z = z ^ (z >> _S31)
    return float(z >> _S11) * 2.0**-53


@compiled(reorder=False, inner=True)
def hit(order: Any, begins: Any, plane: Any, sides: Array, x: float, y: float, z: float) -> int:
    """Return the triangle of a plane that contains a point of the plane, -1 if none does."""
    for number in range(begins[plane], begins[plane + 1]):
        i = order[number]
        a = sides[i, 0, 0] * x + sides[i, 0, 1] * y + sides[i, 0, 2] * z - sides[i, 0, 3]
        b = sides[i, 1, 0] * x + sides[i, 1, 1] * y + sides[i, 1, 2] * z - sides[i, 1, 3]
        if (a >= -1e-9) & (a <= 1.0 + 1e-9) & (b >= -1e-9) & (a + b <= 1.0 + 1e-9):
            return int(i)
    return -1


@compiled(reorder=False, inner=True)
def to_planes(rays: Array, n: int, planes: Array, out: Array, least: Array, row_of: Any) -> None:
    """Write the distance of each ray to each plane, the least of a ray's, and the row that has it.

    The distance is infinite from behind or parallel to a plane.
    """
    for j in range(n):
        least[j], row_of[j] = np.inf, 0
    for k in range(len(planes)):
        a, b, c, offset = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        for j in range(n):
            approach = -(a * rays[3, j] + b * rays[4, j] + c * rays[5, j])
            t = (a * rays[0, j] + b * rays[1, j] + c * rays[2, j] - offset) / approach
            t = t if (approach > 0.0) & (t >= -1e-9) else np.inf
            out[k, j] = t
            less = t < least[j]
            least[j] = t if less else least[j]
            row_of[j] = k if less else row_of[j]


@compiled(reorder=False, inner=True)
def to_receivers(rays: Array, n: int, spheres: Array, out: Array, least: Array) -> None:
    """Write where each ray is nearest to each receiver, and the least of these distances of a ray.

    The distance is infinite to a receiver that the ray does not pass. ``spheres`` (n_receivers, 4) are
    the receivers' centres and the squares of their radii.
    """
    for j in range(n):
        least[j] = np.inf
    for r in range(len(spheres)):
        a, b, c, square = spheres[r, 0], spheres[r, 1], spheres[r, 2], spheres[r, 3]
        for j in range(n):
            x, y, z = a - rays[0, j], b - rays[1, j], c - rays[2, j]
            along = x * rays[3, j] + y * rays[4, j] + z * rays[5, j]
            near = x * x + y * y + z * z - along * along < square
            along = along if near & (along > 0.0) else np.inf
            out[r, j] = along
            least[j] = along if along < least[j] else least[j]


@compiled(reorder=False, inner=True)
def draw(states: Any, n: int, out: Array) -> None:
    """Write a random number for each state, and a random point of the unit sphere.

    The point's three rows are its distance from the vertical axis, its angle, and its height.
    """
    for j in range(n):
        out[0, j] = uniform(states[j], _ONCE)
        up = 1.0 - 2.0 * uniform(states[j], _TWICE)
        flat = 1.0 - up * up
        round_ = math.sqrt(flat if flat > 0.0 else 0.0)
        out[1, j], out[3, j] = round_, up
        out[2, j] = 2.0 * math.pi * uniform(states[j], _THRICE)


@compiled(reorder=False, inner=True)
def reflect(rays: Array, n: int, hits: Array, drawn: Array) -> None:
    """Move rays to the points that they hit, and reflect them there.

    ``hits`` (6, n) are the distances, the walls' normals, and the parts of the specular and of the
    scattered direction in the new one. The scattered direction is that of the normal plus a random
    point of the unit sphere, which follows Lambert's law; ``drawn`` has the point in its last rows.
    """
    for j in range(n):
        t, nx, ny, nz = hits[0, j], hits[1, j], hits[2, j], hits[3, j]
        specular, diffuse = hits[4, j], hits[5, j]
        vx, vy, vz = rays[3, j], rays[4, j], rays[5, j]
        rays[0, j] += t * vx
        rays[1, j] += t * vy
        rays[2, j] += t * vz
        across = 2.0 * (vx * nx + vy * ny + vz * nz)
        lx, ly, lz = nx + drawn[1, j], ny + drawn[2, j], nz + drawn[3, j]
        share = diffuse / math.sqrt(lx * lx + ly * ly + lz * lz + 1e-30)
        vx = share * lx + specular * (vx - across * nx)
        vy = share * ly + specular * (vy - across * ny)
        vz = share * lz + specular * (vz - across * nz)
        norm = math.sqrt(vx * vx + vy * vy + vz * vz)
        rays[3, j], rays[4, j], rays[5, j] = vx / norm, vy / norm, vz / norm


@compiled(reorder=False)
def place_by_path(events: Any, heard: Any, lost: Any, n_codes: int, slots: Any, out: Any) -> None:
    """Write codes, lengths and weights to ``out`` path by path, without those of lost paths.

    ``events`` are the codes and paths of all events, and ``heard`` the lengths and weights of the
    receptions among them, whose codes are from ``n_codes`` up. ``slots`` (2, n_paths) is where the
    codes and the receptions of each path begin in ``out``, and is overwritten.
    """
    n_heard = 0
    for e in range(len(events[0])):
        code, path = events[0][e], events[1][e]
        if not lost[path]:
            out[0][slots[0, path]] = code
            slots[0, path] += 1
        if code >= n_codes:
            if not lost[path]:
                out[1][slots[1, path]] = heard[0][n_heard]
                out[2][slots[1, path]] = heard[1][n_heard]
                slots[1, path] += 1
            n_heard += 1


def trace(
    origin: Array,
    directions: Array,
    seeds: Any,
    longest: float,
    planes: Array,
    order: Any,
    begins: Any,
    sides: Array,
    owners: Any,
    scattering: Array,
    vector: bool,
    receivers: Array,
    radii: Array,
    thinned: float,
    shares: Array,
) -> tuple[Any, Any, Any, Any, Any, Array]:
    """Return the wall hits and receptions of traced paths for `path_tracing.Batch`, and counts.

    The first three values are the codes of the events (hits and receptions) of path after path, the
    place at which each path begins among these, and the number of its receptions. The next two are the
    lengths in m and the weights of the receptions of path after path. The last are four counts: lost
    paths; free paths, and the sums of their lengths and of the squares of these. A path that hits no
    wall is lost, and none of its events is kept.

    ``order`` has the triangles' numbers, those of a plane together, and ``begins`` where each plane
    begins (`rtcal.simulators.path_tracing.by_plane`). ``owners`` has the face of each triangle,
    ``scattering`` the coefficient of each face. At i times the length ``thinned`` in m, paths end whose
    number is no multiple of 2^i; receptions of the others then count 1 / ``shares[i]`` times.
    """
    # Arrays are made here: making one in the compiled function takes numba a tenth of a second.
    n_paths, n_receivers, n_planes = len(directions), len(receivers), len(begins) - 1
    first_planes = planes[order[begins[:-1]]]
    spheres = np.column_stack([receivers, radii**2])
    lanes = max(_DISTANCES // n_planes, 16)
    events = np.empty(64 * n_paths, np.uint16), np.empty(64 * n_paths, np.int32)
    heard = np.empty(4 * n_paths, np.float32), np.empty(4 * n_paths, np.float32)
    walls = planes, order, begins, sides, owners, scattering, first_planes
    of_rays = (
        np.empty((6, lanes)),
        np.empty((2, lanes)),
        np.empty(lanes, np.uint64),
        np.empty(lanes, np.int32),
        np.empty(lanes, np.bool_),
    )
    of_step = (
        np.empty((n_planes, lanes)),
        np.empty((n_receivers, lanes)),
        np.empty((2, lanes)),
        np.empty(lanes, np.int64),
        np.zeros((6, lanes)),
        np.empty((4, lanes)),
        np.empty(lanes, np.int64),
    )
    state = of_rays, of_step
    lost, number = np.zeros(n_paths, np.bool_), np.zeros((2, n_paths), np.int64)
    counts, at = np.zeros(4), np.zeros(4, np.int64)
    of_paths = origin, directions, seeds, longest, thinned, shares
    while not _advance(
        of_paths, walls, vector, spheres, state, events, heard, lost, number, counts, at
    ):
        events = tuple(_grown(of, at[2] + lanes * (n_receivers + 1)) for of in events)
        heard = tuple(_grown(of, at[3] + lanes * n_receivers) for of in heard)
    number[:, lost] = 0
    ends = np.cumsum(number, axis=1)
    out = tuple(
        np.empty(ends[row, -1], of.dtype)
        for row, of in ((0, events[0]), (1, heard[0]), (1, heard[1]))
    )
    traced = tuple(of[: at[2]] for of in events), tuple(of[: at[3]] for of in heard)
    place_by_path(*traced, lost, 2 * len(scattering), ends - number, out)
    codes, lengths, weights = out
    return codes, np.concatenate([[0], ends[0]]), number[1], lengths, weights, counts


def _grown(array: Any, needed: int) -> Any:
    """Return an array with space for ``needed`` elements, at least twice as large if it has none."""
    if needed <= array.size:
        return array
    larger = np.empty(max(2 * array.size, needed), array.dtype)
    larger[: array.size] = array
    return larger


@compiled(reorder=False)
def _advance(
    of_paths: Any,
    walls: Any,
    vector: bool,
    spheres: Array,
    state: Any,
    events: Any,
    heard: Any,
    lost: Any,
    number: Any,
    counts: Array,
    at: Any,
) -> bool:
    """Trace paths until all have ended or the arrays are full; return whether all have ended.

    `trace` makes the paths, the walls and the arrays. ``number`` (2, n_paths) has the numbers of each
    path's events and receptions. ``at`` has four numbers: paths that have begun, paths that have not
    ended, events, and receptions.
    """
    origin, directions, seeds, longest, thinned, shares = of_paths
    planes, order, begins, sides, owners, scattering, first_planes = walls
    (rays, along_path, states, paths, diffuse), of_step = state
    at_planes, at_receivers, first, row_of, hits, drawn, ended = of_step
    codes, of_path = events
    lengths, weights = heard
    n_paths, n_receivers, n_faces = len(directions), len(spheres), len(scattering)
    n_planes, lanes, n_shares = len(begins) - 1, len(paths), len(shares)
    begun, n, n_events, n_heard = at[0], at[1], at[2], at[3]
    while n > 0 or begun < n_paths:
        # New rays begin where half have ended: loops over few rays take longer for each.
        if 2 * n < lanes and begun < n_paths:
            more = min(lanes - n, n_paths - begun)
            for j in range(n, n + more):
                path = begun
                begun += 1
                paths[j] = path
                for axis in range(3):
                    rays[axis, j], rays[3 + axis, j] = origin[axis], directions[path, axis]
                states[j], diffuse[j] = seeds[path], False
                along_path[0, j], along_path[1, j] = 0.0, longest
                for stage in range(1, n_shares):
                    if path % (1 << stage) != 0:
                        if stage * thinned < longest:
                            along_path[1, j] = stage * thinned
                        break
            n += more
        if n_events + n * (n_receivers + 1) > len(codes) or n_heard + n * n_receivers > len(
            lengths
        ):
            at[0], at[1], at[2], at[3] = begun, n, n_events, n_heard
            return False
        to_planes(rays, n, first_planes, at_planes, first[0], row_of)
        to_receivers(rays, n, spheres, at_receivers, first[1])
        draw(states, n, drawn)
        n_ended = 0
        for j in range(n):
            path, end = paths[j], along_path[1, j]
            px, py, pz = rays[0, j], rays[1, j], rays[2, j]
            vx, vy, vz = rays[3, j], rays[4, j], rays[5, j]
            t, nearest = first[0, j], row_of[j]
            # In a convex room the nearest plane is hit; in others the nearest that holds the point.
            triangle = hit(order, begins, nearest, sides, px + t * vx, py + t * vy, pz + t * vz)
            while triangle < 0 and t < np.inf:
                at_planes[nearest, j] = np.inf
                t = np.inf
                for plane in range(n_planes):
                    nearer = at_planes[plane, j] < t
                    t = at_planes[plane, j] if nearer else t
                    nearest = plane if nearer else nearest
                triangle = hit(order, begins, nearest, sides, px + t * vx, py + t * vy, pz + t * vz)
            if triangle < 0:
                lost[path] = True
                counts[0] += 1
                ended[n_ended] = j
                n_ended += 1
                continue
            travelled = along_path[0, j]
            if travelled > 0.0:
                counts[1] += 1
                counts[2] += t
                counts[3] += t * t
                for r in range(n_receivers if first[1, j] < t else 0):
                    along, square = at_receivers[r, j], spheres[r, 3]
                    length = travelled + along
                    if along < t and length < end:
                        stage = int(length / thinned)
                        if stage > n_shares - 1:
                            stage = n_shares - 1
                        weight = 1.0 / (math.pi * square * shares[stage])
                        if not diffuse[j]:
                            seen = 1 - square / (length * length)
                            weight *= 0.5 * (1.0 + math.sqrt(seen if seen > 0.0 else 0.0))
                        codes[n_events], of_path[n_events] = 2 * n_faces + r, path
                        lengths[n_heard], weights[n_heard] = length, weight
                        number[0, path] += 1
                        number[1, path] += 1
                        n_events += 1
                        n_heard += 1
            length = travelled + t
            if length >= end:
                ended[n_ended] = j
                n_ended += 1
                continue
            face = owners[triangle]
            s = scattering[face]
            spread = s > 0.0 if vector else drawn[0, j] < s
            hits[0, j] = t
            for axis in range(3):
                hits[1 + axis, j] = planes[triangle, axis]
            if spread:  # sine and cosine take longer than all else that is drawn
                round_, angle = drawn[1, j], drawn[2, j]
                drawn[1, j], drawn[2, j] = round_ * math.cos(angle), round_ * math.sin(angle)
            part = s if vector else (1.0 if spread else 0.0)
            hits[4, j], hits[5, j] = 1.0 - part, part
            codes[n_events] = n_faces + face if spread and not vector else face
            of_path[n_events] = path
            number[0, path] += 1
            n_events += 1
            along_path[0, j] = length
            states[j] += _THRICE * _GOLDEN
            diffuse[j] |= spread
        reflect(rays, n, hits, drawn)
        for last in range(n_ended, 0, -1):  # the last ray takes the place of one that ended
            j = ended[last - 1]
            n -= 1
            for row in range(6):
                rays[row, j] = rays[row, n]
            along_path[0, j], along_path[1, j] = along_path[0, n], along_path[1, n]
            states[j], paths[j], diffuse[j] = states[n], paths[n], diffuse[n]
    at[0], at[1], at[2], at[3] = begun, n, n_events, n_heard
    return True


BANDS = 4
"""Bands that are computed in one loop over the paths: their levels stay in registers."""
_RECEPTIONS = 4096
"""Receptions whose energies are computed together by vector instructions; more if a path has more."""


def _in_blocks(weighing: Weighing) -> Iterator[tuple[slice, tuple[Array, Array]]]:
    """Yield some bands with reflection factors (n_codes, `BANDS`) and attenuations (`BANDS`,)."""
    log_reflection, attenuation, *_ = weighing
    for begin in range(0, len(attenuation), BANDS):
        some = slice(begin, min(begin + BANDS, len(attenuation)))
        reflection, air = np.zeros((len(log_reflection), BANDS)), np.zeros(BANDS)
        reflection[:, : some.stop - begin] = np.exp(log_reflection[:, some])
        air[: some.stop - begin] = attenuation[some]
        yield some, (reflection, air)


def _far(weighing: Weighing, bands: slice, n_bins: int) -> Array:
    """Return what air leaves up to the middle of each bin, (n_receivers, n_bins, n_bands)."""
    _, attenuation, first, bin_length = weighing
    middle = first[:, np.newaxis] + bin_length * (np.arange(n_bins) + 0.5)
    return np.asarray(np.exp(-attenuation[bands] * middle[..., np.newaxis]))


def histogram(batches: Sequence[Batch], weighing: Weighing, out: Array) -> None:
    """Add the energy at the receivers to ``out``, (n_receivers, n_bands, n_bins), in 1/m².

    ``batches`` are paths, and ``weighing`` has the logarithms of the reflection factors, the air's
    attenuation in 1/m and the time bins as lengths in m.
    """
    none = np.zeros((len(out), out.shape[2], 0, out.shape[1]))
    n_codes = len(weighing[0])
    histogram_gradient(batches, weighing, np.zeros(n_codes, np.int64), np.zeros(n_codes), out, none)


def histogram_gradient(
    batches: Sequence[Batch],
    weighing: Weighing,
    groups: Any,
    counts: Array,
    out: Array,
    gradient: Array,
) -> None:
    """Add the energy at receivers to ``out``, and to ``gradient`` that energy weighted by wall hits.

    ``batches`` and ``weighing`` are as in `histogram`. ``groups`` (n_codes,) is the group of each code
    of a wall hit, and ``counts`` (n_codes,) the number that a hit adds to the group's weight. ``out``
    is (n_receivers, n_bands, n_bins), and ``gradient`` (n_receivers, n_bins, n_groups, n_bands).
    """
    n_receivers, n_bins, n_groups, _ = gradient.shape
    together = max([_RECEPTIONS, *[int(np.diff(starts).max()) for _, starts, *_ in batches]])
    scratch = np.empty(together), np.empty(together, np.int64), np.empty((BANDS, together))
    hits = np.empty((together + 1, n_groups))
    for bands, of_bands in _in_blocks(weighing):
        sums = np.zeros((n_receivers * n_bins, 1 + n_groups, BANDS))
        for batch in batches:
            add_energy(batch, of_bands, weighing[2:], n_bins, groups, counts, scratch, hits, sums)
        # Air attenuates up to the middle of a bin here, and by a series within it.
        far = _far(weighing, bands, n_bins)[:, :, np.newaxis]
        energy = sums.reshape(n_receivers, n_bins, -1, BANDS)[..., : far.shape[-1]] * far
        out[:, bands] += np.moveaxis(energy[:, :, 0], 2, 1)
        gradient[..., bands] += energy[:, :, 1:]


@compiled(reorder=True)
def add_energy(
    batch: Batch,
    of_bands: Any,
    bins: Any,
    n_bins: int,
    groups: Any,
    counts: Array,
    scratch: Any,
    hits: Array,
    sums: Array,
) -> None:
    """Add energies and weighted ones to ``sums`` for `histogram_gradient`, which makes the arrays."""
    events, starts, lengths, weights = batch
    (reflection, attenuation), (first, bin_length) = of_bands, bins
    beyond, places, energy = scratch
    n_codes, n_groups = len(reflection), sums.shape[1] - 1
    n_paths, path, heard = len(starts) - 1, 0, 0
    while path < n_paths:
        n = 0
        while path < n_paths and n + starts[path + 1] - starts[path] <= len(beyond):
            a, b, c, d = 1.0, 1.0, 1.0, 1.0
            for j in range(n_groups):
                hits[n, j] = 0.0
            for e in range(starts[path], starts[path + 1]):
                code = events[e]  # unsigned: an index that needs no check for negative values
                if code < n_codes:
                    a *= reflection[code, 0]
                    b *= reflection[code, 1]
                    c *= reflection[code, 2]
                    d *= reflection[code, 3]
                    if n_groups > 0:
                        hits[n, groups[code]] += counts[code]
                    continue
                receiver = np.int64(code) - n_codes
                after = (np.float64(lengths[heard]) - first[receiver]) / bin_length
                place = math.floor(after)
                if 0 <= place < n_bins:
                    beyond[n] = bin_length * (after - place - 0.5)
                    places[n] = receiver * n_bins + place
                    weight = np.float64(weights[heard])
                    energy[0, n], energy[1, n] = weight * a, weight * b
                    energy[2, n], energy[3, n] = weight * c, weight * d
                    for j in range(n_groups):
                        hits[n + 1, j] = hits[n, j]
                    n += 1
                heard += 1
            path += 1
        for k in range(BANDS):
            for i in range(n):
                x = attenuation[k] * beyond[i]
                higher = 1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120)))
                energy[k, i] *= 1.0 - x * (1.0 - x * higher)
        for i in range(n):
            place = places[i]
            a, b, c, d = energy[0, i], energy[1, i], energy[2, i], energy[3, i]
            sums[place, 0, 0] += a
            sums[place, 0, 1] += b
            sums[place, 0, 2] += c
            sums[place, 0, 3] += d
            for j in range(n_groups):
                number = hits[i, j]
                if number != 0.0:
                    sums[place, j + 1, 0] += number * a
                    sums[place, j + 1, 1] += number * b
                    sums[place, j + 1, 2] += number * c
                    sums[place, j + 1, 3] += number * d


_TOGETHER = 400_000
"""Receptions that are sorted at once: their energies fill some 20 MB."""


def histogram_changed(
    batches: Sequence[Batch],
    weighing: Weighing,
    held: Any,
    powers: Array,
    out: Array,
) -> None:
    """Add to ``out`` the energy at receivers if the absorption of a group of faces is changed.

    ``batches`` and ``weighing`` are as in `histogram`. ``held`` (n_codes, n_groups) is True if the face
    of a code belongs to a group. ``powers`` (n_groups, n_hits, n_changes, n_bands) are the factors of
    the energy after 0, 1, 2, ... hits on a group. ``out`` is (n_groups, n_receivers, n_bins, n_changes,
    n_bands).
    """
    n_groups, n_receivers, n_bins, n_changes, _ = out.shape
    # The groups of each code; the last number stands for none.
    most = int(held.sum(axis=1).max(initial=1))
    members = np.argsort(~held, axis=1, kind="stable")[:, :most].astype(np.uint16)
    members[~np.take_along_axis(held, members.astype(np.int64), axis=1)] = n_groups
    joined = [*_joined(batches)]
    n = max(len(lengths) for _, _, lengths, _ in joined)
    n_keys = n_receivers * n_bins
    scratch = (
        np.empty(n, np.int64),
        np.empty(n_keys + 1, np.int64),
        np.empty(n_keys, np.int64),
        np.empty((n, n_groups), np.uint16),
        np.empty((n, BANDS)),
        np.zeros((powers.shape[1], BANDS)),
        np.empty(n_groups + 1, np.uint16),
    )
    for bands, of_bands in _in_blocks(weighing):
        some = np.zeros((*powers.shape[:3], BANDS))
        some[..., : bands.stop - bands.start] = powers[..., bands]
        sums = np.zeros((n_groups, n_keys, n_changes, BANDS))
        for batch in joined:
            add_changed(batch, of_bands, weighing[2:], n_bins, members, some, scratch, sums)
        far = _far(weighing, bands, n_bins)
        energy = sums.reshape(*out.shape[:-1], BANDS)[..., : far.shape[-1]]
        out[..., bands] += energy * far[:, :, np.newaxis]


def _joined(batches: Sequence[Batch]) -> Iterator[Batch]:
    """Yield batches that have up to `_TOGETHER` receptions together as one."""
    receptions = sum(len(lengths) for _, _, lengths, _ in batches)
    together = max(len(batches) * _TOGETHER // max(receptions, 1), 1)
    for begin in range(0, len(batches), together):
        events, starts, *heard = zip(*batches[begin : begin + together], strict=True)
        before = np.cumsum([0, *map(len, events)])
        each = [of[:-1] + first for of, first in zip(starts, before, strict=False)]
        lengths, weights = map(np.concatenate, heard)
        yield np.concatenate(events), np.concatenate([*each, before[-1:]]), lengths, weights


@compiled(reorder=True)
def add_changed(
    batch: Batch,
    of_bands: Any,
    bins: Any,
    n_bins: int,
    members: Any,
    powers: Array,
    scratch: Any,
    out: Array,
) -> None:
    """Add energies as `histogram_changed` does, which makes the arrays that are overwritten."""
    events, starts, lengths, weights = batch
    (reflection, attenuation), (first, bin_length) = of_bands, bins
    keys, begins, slots, counted, energy, sums, hits = scratch
    n_codes, n_members = members.shape
    n_groups, n_keys, n_changes, _ = out.shape
    # Sorted by receiver and bin: what is summed after one another stands together in memory.
    for key in range(n_keys + 1):
        begins[key] = 0
    heard = 0
    for e in range(len(events)):
        receiver = np.int64(events[e]) - n_codes
        if receiver >= 0:
            place = math.floor((np.float64(lengths[heard]) - first[receiver]) / bin_length)
            keys[heard] = receiver * n_bins + place if 0 <= place < n_bins else -1
            if keys[heard] >= 0:
                begins[keys[heard] + 1] += 1
            heard += 1
    for key in range(n_keys):
        begins[key + 1] += begins[key]
        slots[key] = begins[key]
    heard = 0
    for path in range(len(starts) - 1):
        a, b, c, d = 1.0, 1.0, 1.0, 1.0
        for j in range(n_groups):
            hits[j] = 0
        for e in range(starts[path], starts[path + 1]):
            code = events[e]
            if code < n_codes:
                a *= reflection[code, 0]
                b *= reflection[code, 1]
                c *= reflection[code, 2]
                d *= reflection[code, 3]
                for j in range(n_members):
                    hits[members[code, j]] += 1
                continue
            key = keys[heard]
            if key >= 0:
                slot, weight = slots[key], np.float64(weights[heard])
                slots[key] += 1
                after = (np.float64(lengths[heard]) - first[np.int64(code) - n_codes]) / bin_length
                beyond = bin_length * (after - math.floor(after) - 0.5)
                for k in range(BANDS):
                    x = attenuation[k] * beyond
                    higher = 1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120)))
                    energy[slot, k] = weight * (1.0 - x * (1.0 - x * higher))
                energy[slot, 0] *= a
                energy[slot, 1] *= b
                energy[slot, 2] *= c
                energy[slot, 3] *= d
                for j in range(n_groups):
                    counted[slot, j] = hits[j]
            heard += 1
    # Energies of as many hits are summed before they are multiplied.
    for key in range(n_keys):
        for j in range(n_groups):
            least, most = np.int64(len(sums)), np.int64(-1)
            for slot in range(begins[key], begins[key + 1]):
                number = np.int64(counted[slot, j])
                least = number if number < least else least
                most = number if number > most else most
                sums[number, 0] += energy[slot, 0]
                sums[number, 1] += energy[slot, 1]
                sums[number, 2] += energy[slot, 2]
                sums[number, 3] += energy[slot, 3]
            for hit_by in range(least, most + 1):
                a, b, c, d = sums[hit_by, 0], sums[hit_by, 1], sums[hit_by, 2], sums[hit_by, 3]
                for change in range(n_changes):
                    out[j, key, change, 0] += a * powers[j, hit_by, change, 0]
                    out[j, key, change, 1] += b * powers[j, hit_by, change, 1]
                    out[j, key, change, 2] += c * powers[j, hit_by, change, 2]
                    out[j, key, change, 3] += d * powers[j, hit_by, change, 3]
                for k in range(BANDS):
                    sums[hit_by, k] = 0.0


@compiled(reorder=True)
def weigh(
    x: Array,
    y: Array,
    z: Array,
    rows: NDArray[np.uint64],
    starts: NDArray[np.uint64],
    bins: NDArray[np.uint32],
    weights: Array,
    out: Array,
) -> None:
    """Add the energy of image sources in each time bin to ``out``, (n_bands, n_bins).

    ``x``, ``y`` and ``z`` (n_bands, n_lattice) are the products of (1 - alpha) over the hits along each
    axis. ``rows``, ``starts``, ``bins`` and ``weights`` are those of `rtcal.simulators.shoebox.Images`.
    """
    # Unsigned indices need no check for negative values, which would take half of the time.
    for run in range(len(rows)):
        begin, first = starts[run], rows[run, 2]
        for band in range(len(x)):  # the inner loops stay within the run: its images are cached
            reflected = x[band, rows[run, 0]] * y[band, rows[run, 1]]
            for i in range(starts[run + 1] - begin):
                out[band, bins[begin + i]] += reflected * z[band, first + i] * weights[begin + i]


@compiled(reorder=True)
def blocks(
    delays: NDArray[np.int64],
    source_delays: NDArray[np.int64],
    tap_delays: NDArray[np.int64],
    lines: Array,
    reflection: Array,
    injected: Array,
    heard: Array,
    n: int,
) -> Array:
    """Return the response (n_bands, n) of a delay network, computed in blocks of its smallest delay.

    Delays are in samples: ``delays`` (6, 5) from node to node, ``source_delays`` (6,) from the source
    and ``tap_delays`` (6,) to the receiver. The other arrays are gains per band: ``lines`` (6, 5,
    n_bands) between nodes, ``reflection`` at a node, ``injected`` from the source and ``heard`` at the
    receiver, (6, n_bands) each.
    """
    n_bands = lines.shape[2]
    block, longest = delays.min(), delays.max()
    # Incoming waves by port. The buffer fits the processor's cache. It is shifted to its start when
    # full, so that no block wraps around and the loops over samples vectorise.
    kept = 2 * longest + block
    incoming = np.empty((6, 5, kept))
    pressure = np.empty(block)
    out = np.zeros((n_bands, n + tap_delays.max() + block))
    for b in range(n_bands):
        incoming[:] = 0.0
        base = 0
        for start in range(0, n, block):
            if start + block + longest - base > kept:
                left = kept - (start - base)
                for k in range(6):
                    for j in range(5):
                        for i in range(left):
                            incoming[k, j, i] = incoming[k, j, i + start - base]
                        for i in range(left, kept):
                            incoming[k, j, i] = 0.0
                base = start
            offset = start - base
            for k in range(6):
                waves = incoming[k, :, offset : offset + block]
                for i in range(block):
                    pressure[i] = 0.4 * (
                        waves[0, i] + waves[1, i] + waves[2, i] + waves[3, i] + waves[4, i]
                    )
                beta = reflection[k, b]
                tapped = out[b, start + tap_delays[k] : start + tap_delays[k] + block]
                gain = heard[k, b] * beta
                if start <= source_delays[k] < start + block:
                    # A (p+ + p_S / 2) adds p_S / 2 at each port, and p_S to the node's pressure.
                    pressure[source_delays[k] - start] += injected[k, b] / 2
                    tapped[source_delays[k] - start] += gain * injected[k, b] / 2
                for i in range(block):
                    tapped[i] += gain * pressure[i]
                for j in range(5):
                    to = j + 1 if j >= k else j
                    port = k - 1 if k > to else k
                    arrival = offset + delays[k, j]
                    leaving = incoming[to, port, arrival : arrival + block]
                    loss = beta * lines[k, j, b]
                    for i in range(block):
                        leaving[i] = loss * (pressure[i] - waves[j, i])
    return out[:, :n]
