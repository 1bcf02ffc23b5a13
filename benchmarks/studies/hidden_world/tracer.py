"""The measured world: a Monte-Carlo tracer of its own for one box, or two joined by an aperture.

It stands apart on purpose: nothing of rtcal is imported (`tests/test_worlds.py` reads the imports),
so that a finding cannot owe its success to sharing the finder's physics. Particles carry their
energy per band; walls absorb, and scatter after Lambert with probability ``scattering``; objects
spread through the first box are met at the rate c S / 4V and scatter to all sides. A receiver is a
sphere: its energy density is the sum of energy times chord over its volume.
"""

# ruff: noqa: NPY002 - numba seeds its own generator, inside compiled code, by the legacy names

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np


@dataclass(frozen=True)
class World:
    """One configuration. Walls in the order x0, x1, y0, y1, z0, z1; alpha is (6, n_bands)."""

    size: np.ndarray
    alpha: np.ndarray
    air: np.ndarray  # energy attenuation, 1/m, (n_bands,)
    scattering: float
    source: np.ndarray
    receivers: np.ndarray  # (n, 3)
    # A rectangle that replaces wall: wall number, and its two ranges along the other two axes.
    patch_wall: int = -1
    patch: np.ndarray = field(default_factory=lambda: np.zeros(4))
    patch_alpha: np.ndarray | None = None
    objects_area: float = 0.0
    objects_alpha: np.ndarray | None = None
    # A second box behind the patch on wall x1; its own wall x0 holds the same aperture.
    second_size: np.ndarray | None = None
    second_alpha: np.ndarray | None = None


@numba.njit(cache=True)
def _sphere_direction() -> np.ndarray:
    z = 2 * np.random.random() - 1
    phi = 2 * np.pi * np.random.random()
    r = np.sqrt(1 - z * z)
    return np.array([r * np.cos(phi), r * np.sin(phi), z])


@numba.njit(cache=True)
def _trace(
    n,
    seed,
    sizes,
    alphas,
    air,
    scattering,
    source,
    receivers,
    radius,
    wall,
    patch,
    patch_alpha,
    rate,
    objects_alpha,
    joined,
    c,
    width,
    bins,
):
    np.random.seed(seed)
    bands = air.size
    found = np.zeros((receivers.shape[0], bands, bins))
    volume = 4 / 3 * np.pi * radius**3
    for _ in range(n):
        p = source.copy()
        u = _sphere_direction()
        energy = np.full(bands, 1.0 / n)
        room = 0
        t = 0.0
        while t < width * bins and energy.max() * n > 1e-9:
            # The nearest wall of this box.
            step, hit = np.inf, 0
            for a in range(3):
                if u[a] > 0:
                    d = (sizes[room, a] - p[a]) / u[a]
                    side = 2 * a + 1
                elif u[a] < 0:
                    d = -p[a] / u[a]
                    side = 2 * a
                else:
                    continue
                if d < step:
                    step, hit = d, side
            step = max(step, 0.0)
            met = False
            if rate > 0 and room == 0:
                d = -np.log(1 - np.random.random()) / rate
                if d < step:
                    step, met = d, True
            if room == 0:
                for r in range(receivers.shape[0]):
                    q = receivers[r] - p
                    along = q @ u
                    off = radius * radius - (q @ q - along * along)
                    if off > 0:
                        half = np.sqrt(off)
                        first, last = max(along - half, 0.0), min(along + half, step)
                        if last > first:
                            middle = 0.5 * (first + last)
                            k = int((t + middle / c) / width)
                            if k < bins:
                                for b in range(bands):
                                    there = energy[b] * np.exp(-air[b] * middle)
                                    found[r, b, k] += there * (last - first) / volume
            p += u * step
            t += step / c
            energy *= np.exp(-air * step)
            if met:
                energy *= 1 - objects_alpha
                u = _sphere_direction()
                continue
            axis = hit // 2
            one, two = (axis + 1) % 3, (axis + 2) % 3
            if axis == 1:
                one, two = 0, 2
            if axis == 2:
                one, two = 0, 1
            within = (
                ((room == 0 and hit == wall) or (room == 1 and hit == 0))
                and patch[0] < p[one] < patch[1]
                and patch[2] < p[two] < patch[3]
            )
            if within and joined:
                room = 1 - room
                p[0] = 0.0 if room == 1 else sizes[0, 0]
                continue
            p[axis] = 0.0 if hit % 2 == 0 else sizes[room, axis]
            energy *= 1 - (patch_alpha if within else alphas[room, hit])
            if np.random.random() < scattering:
                u = _sphere_direction()
                # A unit normal plus a point on the unit sphere is Lambert's law.
                u[axis] += 1.0 if hit % 2 == 0 else -1.0
                u /= np.sqrt(u @ u)
            else:
                u[axis] = -u[axis]
    return found


def trace(
    world: World,
    n: int,
    seed: int,
    *,
    width: float = 0.002,
    length: float = 2.0,
    radius: float = 0.5,
    speed_of_sound: float = 343.2,
) -> np.ndarray:
    """Return the energy density times path, (n_receivers, n_bands, n_bins); source energy 1.

    Times 4 pi 10² it is the energy relative to the free field at 10 m, as G has it.
    """
    joined = world.second_size is not None
    second_size = world.second_size if joined else world.size
    second_alpha = world.second_alpha if joined else world.alpha
    nothing = np.zeros(world.air.size)
    volume = float(np.prod(world.size))
    return _trace(
        n,
        seed,
        np.stack([world.size, second_size]),
        np.stack([world.alpha, second_alpha]),
        world.air,
        world.scattering,
        world.source,
        world.receivers,
        radius,
        world.patch_wall,
        world.patch,
        nothing if world.patch_alpha is None else world.patch_alpha,
        world.objects_area / (4 * volume),
        nothing if world.objects_alpha is None else world.objects_alpha,
        joined,
        speed_of_sound,
        width,
        int(length / width),
    )
