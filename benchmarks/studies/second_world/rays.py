"""The second measured world: rays in convex rooms of any shape, alone or joined.

It shares no code with rtcal or with `benchmarks/studies/hidden_world`. A room is a set of half-spaces
n . x <= d. A wall may hold two strips beside its main material, each beyond a straight cut: one of
a second material, one of whatever was hidden. Boxes stand on the floor for people and furniture.
Scattering is either drawn (probability s, Lambert) or mixed as vectors, with its own s per wall.
A receiver is a sphere; its energy density is energy times chord over volume.
"""

# ruff: noqa: NPY002 - numba seeds its own generator, inside compiled code, by the legacy names

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np

MAIN, SECOND, HIDDEN = 0, 1, 2


@dataclass(frozen=True)
class Walls:
    """The walls of one convex room, n of them.

    ``normals`` (n, 3) point outward and ``offsets`` (n,) are their distances. ``cuts``
    (n, 2, 4) are two half-spaces a . x >= b per wall, (ax, ay, az, b): where one holds, the wall is
    of its second material, or of what was hidden. b is infinite where there is none. ``alpha``
    (n, 3, n_bands) is the coefficient of main material, second material and hidden strip.
    """

    normals: np.ndarray
    offsets: np.ndarray
    cuts: np.ndarray
    alpha: np.ndarray
    scattering: np.ndarray  # (n,)


@dataclass(frozen=True)
class Scene:
    """One configuration of the world. The hidden strip of ``aperture`` (a wall's number in the first
    room) is open to the second room, whose wall 0 is its other side.
    """

    walls: Walls
    air: np.ndarray  # 1/m, (n_bands,)
    source: np.ndarray
    receivers: np.ndarray  # (n, 3)
    volume: float
    vectors: bool  # scattering mixes directions as vectors
    boxes: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))  # low and high corners
    box_alpha: np.ndarray | None = None  # (n_bands,)
    second: Walls | None = None
    aperture: int = -1


@numba.njit(cache=True)
def _uniform_direction():
    while True:
        x, y, z = 2 * np.random.random(3) - 1
        r = x * x + y * y + z * z
        if 1e-6 < r <= 1.0:
            return np.array([x, y, z]) / np.sqrt(r)


@numba.njit(cache=True)
def _leave(u, n, s, vectors):
    """Direction after a wall of inward normal n: specular, scattered after Lambert, or between."""
    scattered = n + _uniform_direction()
    scattered /= np.sqrt(scattered @ scattered) + 1e-12
    mirrored = u - 2 * (u @ n) * n
    if vectors:
        out = (1 - s) * mirrored + s * scattered
        return out / np.sqrt(out @ out)
    return scattered if np.random.random() < s else mirrored


@numba.njit(cache=True)
def _box(p, u, low, high):
    """Distance at which a ray enters a box, and the axis of the face; infinite if it does not."""
    near, far, axis = 0.0, np.inf, -1
    for a in range(3):
        if abs(u[a]) < 1e-12:
            if p[a] < low[a] or p[a] > high[a]:
                return np.inf, -1
            continue
        first, last = (low[a] - p[a]) / u[a], (high[a] - p[a]) / u[a]
        if first > last:
            first, last = last, first
        if first > near:
            near, axis = first, a
        far = min(far, last)
    if axis < 0 or near >= far:
        return np.inf, -1
    return near, axis


@numba.njit(cache=True)
def _trace(
    seed,
    n_rays,
    normals,
    offsets,
    cuts,
    alpha,
    scattering,
    count,
    air,
    source,
    receivers,
    radius,
    vectors,
    boxes,
    box_alpha,
    aperture,
    c,
    width,
    n_bins,
):
    np.random.seed(seed)
    n_bands = air.size
    echogram = np.zeros((receivers.shape[0], n_bands, n_bins))
    sphere = 4 / 3 * np.pi * radius**3
    for _ in range(n_rays):
        p, u = source.copy(), _uniform_direction()
        energy = np.full(n_bands, 1.0 / n_rays)
        room, path = 0, 0.0
        while path < c * width * n_bins and energy.max() * n_rays > 1e-8:
            free, wall = np.inf, -1
            for w in range(count[room]):
                towards = normals[room, w] @ u
                if towards > 1e-9:
                    d = (offsets[room, w] - normals[room, w] @ p) / towards
                    if d < free:
                        free, wall = max(d, 0.0), w
            if wall < 0:
                break
            face = -1
            if room == 0:
                for k in range(boxes.shape[0]):
                    d, axis = _box(p, u, boxes[k, :3], boxes[k, 3:])
                    if d < free:
                        free, face = d, axis
                for r in range(receivers.shape[0]):
                    to = receivers[r] - p
                    foot = to @ u
                    square = radius * radius - (to @ to - foot * foot)
                    if square <= 0:
                        continue
                    enter, leave = (
                        max(foot - np.sqrt(square), 0.0),
                        min(foot + np.sqrt(square), free),
                    )
                    if leave > enter:
                        middle = (enter + leave) / 2
                        k = int((path + middle) / (c * width))
                        if k < n_bins:
                            echogram[r, :, k] += (
                                energy * np.exp(-air * middle) * (leave - enter) / sphere
                            )
            p = p + u * free
            path += free
            energy = energy * np.exp(-air * free)
            if face >= 0:
                inward = np.zeros(3)
                inward[face] = -1.0 if u[face] > 0 else 1.0
                energy = energy * (1 - box_alpha)
                u = _leave(u, inward, 0.7, False)
                p = p + 1e-9 * inward
                continue
            part = 0
            for k in range(2):
                if cuts[room, wall, k, :3] @ p >= cuts[room, wall, k, 3]:
                    part = k + 1
            if part == 2 and aperture >= 0 and wall == (aperture if room == 0 else 0):
                room = 1 - room
                p = p + 1e-9 * u
                continue
            energy = energy * (1 - alpha[room, wall, part])
            u = _leave(u, -normals[room, wall], scattering[room, wall], vectors)
    return echogram


def trace(
    scene: Scene, n_rays: int, seed: int, *, radius: float, width: float, length: float, c: float
) -> np.ndarray:
    """Return energy density times path of a source of energy 1: (n_receivers, n_bands, n_bins)."""
    rooms = [scene.walls] + ([scene.second] if scene.second else [])
    most = max(len(w.offsets) for w in rooms)

    def stacked(name: str, fill: float) -> np.ndarray:
        parts = [getattr(w, name) for w in rooms]
        out = np.full((len(rooms), most, *parts[0].shape[1:]), fill)
        for i, part in enumerate(parts):
            out[i, : len(part)] = part
        return out

    none = np.zeros(scene.air.size)
    return _trace(
        seed,
        n_rays,
        stacked("normals", 0.0),
        stacked("offsets", 0.0),
        stacked("cuts", np.inf),
        stacked("alpha", 0.0),
        stacked("scattering", 0.0),
        np.array([len(w.offsets) for w in rooms]),
        scene.air,
        scene.source,
        scene.receivers,
        radius,
        scene.vectors,
        scene.boxes,
        none if scene.box_alpha is None else scene.box_alpha,
        scene.aperture if scene.second else -1,
        c,
        width,
        int(length / width),
    )
