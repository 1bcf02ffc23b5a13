"""The truth of the position rooms: rays in rooms of any shape, bounded by convex polygons.

It shares no code with rtcal. A ray's energy is lost at walls and in the air; a receiver is a sphere,
whose energy density is energy times chord over volume. The direct sound is computed, not traced.
A wall scatters by one of two published meanings of its coefficient s: with probability s the
reflection follows Lambert's law, else it is specular ("random"); or every reflection is the sum of both
directions, s Lambert + (1 - s) specular ("vector").

All columns of alpha weigh the same paths: here the bands of two sets of coefficients.
"""

# ruff: noqa: NPY002 - numba seeds its generator, inside compiled code, by the legacy names

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

MOST_CORNERS = 8


@dataclass(frozen=True)
class Scene:
    """A room with its sources and receivers."""

    polygons: list[np.ndarray]  # one (n, 3) per surface, convex
    alpha: np.ndarray  # (n_surfaces, n_columns)
    scattering: np.ndarray  # (n_surfaces,)
    air: np.ndarray  # energy attenuation in 1/m, (n_columns,)
    c: float  # m/s
    receivers: np.ndarray  # (n, 3)
    radius: float  # of the receivers, m
    vectors: bool


def planes(polygons: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit normals (n, 3), offsets (n,) and edges (n, MOST_CORNERS, 4).

    A point x of the plane is in the polygon where edge . (x, 1) >= 0 for all of its edges.
    """
    normals, offsets = np.zeros((len(polygons), 3)), np.zeros(len(polygons))
    edges = np.zeros((len(polygons), MOST_CORNERS, 4))
    for i, p in enumerate(polygons):
        spokes = p[1:] - p[0]
        n = np.cross(spokes[:-1], spokes[1:]).sum(0)
        normals[i] = n / np.linalg.norm(n)
        offsets[i] = normals[i] @ p.mean(0)
        for k in range(len(p)):
            inward = np.cross(normals[i], p[(k + 1) % len(p)] - p[k])
            inward /= np.linalg.norm(inward)
            edges[i, k] = [*inward, 1e-9 - inward @ p[k]]
    return normals, offsets, edges


@numba.njit(cache=True)
def _uniform_direction(out):
    while True:
        x, y, z = (
            2 * np.random.random() - 1,
            2 * np.random.random() - 1,
            2 * np.random.random() - 1,
        )
        square = x * x + y * y + z * z
        if 1e-6 < square <= 1.0:
            r = np.sqrt(square)
            out[0], out[1], out[2] = x / r, y / r, z / r
            return


@numba.njit(cache=True)
def _leave(u, n, s, vectors, lambert):
    """Turn the direction u into one that leaves a surface with the normal n."""
    across = n[0] * u[0] + n[1] * u[1] + n[2] * u[2]
    if not vectors:
        s = 1.0 if np.random.random() < s else 0.0
    if s > 0:
        _uniform_direction(lambert)
        side = -1.0 if across > 0 else 1.0
        x, y, z = lambert[0] + side * n[0], lambert[1] + side * n[1], lambert[2] + side * n[2]
        length = np.sqrt(x * x + y * y + z * z) + 1e-12
        lambert[0], lambert[1], lambert[2] = x / length, y / length, z / length
    for a in range(3):
        u[a] = s * lambert[a] + (1 - s) * (u[a] - 2 * across * n[a])
    length = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    for a in range(3):
        u[a] /= length


@numba.njit(cache=True)
def _next_surface(p, u, normals, offsets, edges, corners, last):
    """Return the surface that a ray from p meets first, and its distance; -1 if it meets none."""
    nearest, surface = np.inf, -1
    for i in range(normals.shape[0]):
        if i == last:
            continue
        across = normals[i, 0] * u[0] + normals[i, 1] * u[1] + normals[i, 2] * u[2]
        if abs(across) < 1e-12:
            continue
        d = (
            offsets[i] - normals[i, 0] * p[0] - normals[i, 1] * p[1] - normals[i, 2] * p[2]
        ) / across
        if d <= 1e-9 or d >= nearest:
            continue
        x, y, z = p[0] + d * u[0], p[1] + d * u[1], p[2] + d * u[2]
        within = True
        for k in range(corners[i]):
            if edges[i, k, 0] * x + edges[i, k, 1] * y + edges[i, k, 2] * z + edges[i, k, 3] < 0:
                within = False
                break
        if within:
            nearest, surface = d, i
    return surface, nearest


@numba.njit(cache=True)
def _trace(
    seed,
    n_rays,
    normals,
    offsets,
    edges,
    corners,
    kept,
    scattering,
    air,
    source,
    receivers,
    radius,
    vectors,
    c,
    width,
    n_bins,
):
    np.random.seed(seed)
    n_receivers, n_columns = receivers.shape[0], air.size
    echogram = np.zeros((n_receivers, n_bins, n_columns))
    direct = np.zeros(n_receivers)
    for r in range(n_receivers):
        direct[r] = np.sqrt(((receivers[r] - source) ** 2).sum())
    p, u, scattered = np.zeros(3), np.zeros(3), np.zeros(3)
    energy, longest, lost = np.zeros(n_columns), c * width * n_bins, 0
    share = 1.0 / (4 / 3 * np.pi * radius**3 * n_rays)
    for _ in range(n_rays):
        p[:] = source
        _uniform_direction(u)
        energy[:] = share
        path, last, loudest = 0.0, -1, share
        while path < longest and loudest > 1e-8 * share:
            surface, free = _next_surface(p, u, normals, offsets, edges, corners, last)
            if surface < 0:
                lost += 1
                break
            if last >= 0:
                for r in range(n_receivers):
                    x, y, z = (
                        receivers[r, 0] - p[0],
                        receivers[r, 1] - p[1],
                        receivers[r, 2] - p[2],
                    )
                    foot = x * u[0] + y * u[1] + z * u[2]
                    square = radius * radius - (x * x + y * y + z * z - foot * foot)
                    if square <= 0:
                        continue
                    half = np.sqrt(square)
                    enter, leave = max(foot - half, 0.0), min(foot + half, free)
                    if leave > enter:
                        middle = path + (enter + leave) / 2
                        k = max(int((middle - direct[r]) / (c * width)), 0)
                        if k < n_bins:
                            for b in range(n_columns):
                                echogram[r, k, b] += (
                                    energy[b] * np.exp(-air[b] * middle) * (leave - enter)
                                )
            for a in range(3):
                p[a] += u[a] * free
            path += free
            loudest = 0.0
            for b in range(n_columns):
                energy[b] *= kept[surface, b]
                loudest = max(loudest, energy[b])
            last = surface
            _leave(u, normals[surface], scattering[surface], vectors, scattered)
    return echogram, lost


def sees(scene: Scene, source: np.ndarray) -> np.ndarray:
    """Return for each receiver whether no surface stands between it and the source."""
    normals, offsets, edges = planes(scene.polygons)
    corners = np.array([len(p) for p in scene.polygons])
    free = []
    for receiver in scene.receivers:
        u = receiver - source
        d = np.linalg.norm(u)
        _, nearest = _next_surface(source, u / d, normals, offsets, edges, corners, -1)
        free.append(nearest > d)
    return np.array(free)


def trace(
    scene: Scene, source: np.ndarray, n_rays: int, seed: int, *, width: float, length: float
) -> np.ndarray:
    """Return energy density times c of a source of unit energy: (n_receivers, n_columns, n_bins).

    It is the time integral of the squared pressure, scaled so that the direct sound at d has
    1 / (4 pi d²). The first bin starts with the direct sound. RuntimeError if rays leave the room.
    """
    normals, offsets, edges = planes(scene.polygons)
    echogram, lost = _trace(
        seed,
        n_rays,
        normals,
        offsets,
        edges,
        np.array([len(p) for p in scene.polygons]),
        1 - scene.alpha,
        scene.scattering,
        scene.air,
        source,
        scene.receivers,
        scene.radius,
        scene.vectors,
        scene.c,
        width,
        int(length / width),
    )
    if lost > 1e-4 * n_rays:
        raise RuntimeError(f"{lost} of {n_rays} rays left the room")
    distance = np.linalg.norm(scene.receivers - source, axis=1)[:, np.newaxis]
    direct = np.exp(-scene.air * distance) / (4 * np.pi * distance**2)
    echogram[:, 0] += direct * sees(scene, source)[:, np.newaxis]
    return np.moveaxis(echogram, 1, 2)
