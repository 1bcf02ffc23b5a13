"""A wave world for `benchmarks.studies.room_modes.modes`: rooms and responses that are not rtcal's.

Pressure on a cubic grid, leapfrog in time (second order), walls of locally reacting admittance: a
resistance, or a mass, a spring and a resistance in series. A slanted ceiling is a staircase whose faces
share the true area. Code of its own: nothing here is rtcal's but the shape of what it returns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

C = 343.2  # m/s, air of 20 °C
H = 0.12  # m
RATE = 700.0  # Hz of the responses that are returned
BANDS = np.array([63.0, 125.0])
SHARE = 0.4  # standard deviation of a stated coefficient, of itself
CORRELATION = 0.8  # of its errors an octave apart


@dataclass
class World:
    """A room of the wave world: corners and faces (names, corner lists), truth, and what was heard."""

    name: str
    vertices: np.ndarray
    faces: list
    walls: list
    sources: dict
    receivers: dict
    alpha: np.ndarray  # (n_walls, 2) of the octaves
    stated: np.ndarray
    rate: float
    responses: np.ndarray  # (4, n)
    times: np.ndarray  # T20 of the octaves in s
    times_uncertainty: np.ndarray
    temperature: float
    parameters: list  # (R, M, K) of each wall


def admittance(wall, f):
    """Specific admittance of a wall (R, M, K) at f in Hz."""
    r, m, k = wall
    w = 2 * np.pi * f
    return 1 / (r + 1j * (w * m - k / w))


def paris(beta, n=400):
    """Random-incidence alpha of admittances (n_f,), by quadrature over the angle."""
    x = (np.arange(n) + 0.5) / n * np.pi / 2
    cosine = np.cos(x)
    at = 4 * beta.real[:, None] * cosine / np.abs(cosine + beta[:, None]) ** 2
    return (at * np.sin(2 * x)).sum(1) * np.pi / 2 / n


def octave_alpha(wall):
    """Mean alpha over each octave, and so what is true."""
    edges = 2 ** np.linspace(-0.5, 0.5, 13)
    return np.array([paris(admittance(wall, f * edges)).mean() for f in BANDS])


def _wall(rng):
    """A wall with alpha at 125 Hz drawn evenly over its logarithm, half of them resonant."""
    wanted = np.exp(rng.uniform(np.log(0.03), np.log(0.5)))
    resonant = rng.random() < 0.5
    f0, q = (
        np.exp(rng.uniform(np.log(40), np.log(250))),
        np.exp(rng.uniform(np.log(0.4), np.log(1.2))),
    )
    best = None
    for r in np.geomspace(2.0, 2000, 400):
        m = q * r / (2 * np.pi * f0) if resonant else 0.0
        wall = (r, m, m * (2 * np.pi * f0) ** 2)
        off = abs(np.log(paris(admittance(wall, np.array([125.0])))[0] / wanted))
        if best is None or off < best[0]:
            best = (off, wall)
    return best[1]


def _grid(value):
    return max(round(value / H), 8)


def _shape(rng, kind):
    """Columns: heights in cells over a grid (nx, ny), with 0 outside; corners and faces in m."""
    volume = np.exp(rng.uniform(np.log(15), np.log(300)))
    ratio = np.array([1.0, rng.uniform(0.6, 0.95), rng.uniform(0.4, 0.7)])
    scale = (volume / ratio.prod()) ** (1 / 3)
    nx, ny, nz = (_grid(scale * r) for r in ratio)
    lx, ly, lz = nx * H, ny * H, nz * H
    heights = np.full((nx, ny), nz)
    ceiling = (0.0, lz)  # slope along x, height at x = 0
    if kind == "box":
        plan = [(0, 0), (lx, 0), (lx, ly), (0, ly)]
    elif kind == "L":
        cx, cy = round(nx * rng.uniform(0.4, 0.65)), round(ny * rng.uniform(0.4, 0.65))
        heights[cx:, cy:] = 0
        a, b = cx * H, cy * H
        plan = [(0, 0), (lx, 0), (lx, b), (a, b), (a, ly), (0, ly)]
    else:
        rise = rng.uniform(0.1, 0.3) * lz
        ceiling = (2 * rise / lx, lz - rise)
        x = (np.arange(nx) + 0.5) * H
        heights[:] = np.round((ceiling[1] + ceiling[0] * x) / H).astype(int)[:, None]
        plan = [(0, 0), (lx, 0), (lx, ly), (0, ly)]
    n = len(plan)
    top = [ceiling[1] + ceiling[0] * x for x, _ in plan]
    vertices = np.array(
        [(x, y, 0.0) for x, y in plan] + [(x, y, z) for (x, y), z in zip(plan, top, strict=True)]
    )
    faces = [list(range(n)), list(range(n, 2 * n))]
    faces += [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    names = ["floor", "ceiling", *(f"wall {k + 1}" for k in range(n))]
    return heights, vertices, faces, names, plan


def _area(vertices, face):
    p = vertices[face]
    return (
        np.linalg.norm(sum(np.cross(p[i] - p[0], p[i + 1] - p[0]) for i in range(1, len(p) - 1)))
        / 2
    )


def _cells(heights, plan):
    """Numbers of air cells, their neighbours (self at a wall), and wall faces (cell, wall)."""
    nz = heights.max()
    air = np.arange(nz) < heights[:, :, None]
    padded = np.pad(air, 1)
    number = np.full(padded.shape, -1)
    number[padded] = np.arange(air.sum())
    where = np.argwhere(padded)
    own = number[tuple(where.T)]
    around = np.empty((len(own), 6), dtype=np.int64)
    cells, owners = [], []
    for k, (axis, step) in enumerate([(a, s) for a in range(3) for s in (-1, 1)]):
        shift = np.zeros(3, int)
        shift[axis] = step
        other = number[tuple((where + shift).T)]
        wall = other < 0
        around[:, k] = np.where(wall, own, other)
        middle = (where[wall] - 1 + 0.5 + 0.5 * shift) * H
        if axis == 2:
            owner = np.full(wall.sum(), 0 if step < 0 else 1)
        else:
            owner = np.array([_side(m, plan, axis) for m in middle], dtype=int)
        cells.append(own[wall])
        owners.append(owner)
    return around, np.concatenate(cells), np.concatenate(owners), where - 1


def _side(middle, plan, axis):
    """The wall of the plan on which a vertical face stands; a stair's riser belongs to the ceiling."""
    for k, (a, b) in enumerate(zip(plan, plan[1:] + plan[:1], strict=True)):
        a, b = np.array(a), np.array(b)
        along = 1 - axis
        if abs(a[axis] - b[axis]) < 1e-9 and abs(middle[axis] - a[axis]) < 1e-6:
            low, high = sorted((a[along], b[along]))
            if low < middle[along] < high:
                return k + 2
    return 1


@numba.njit(fastmath=True)
def _run(around, cells, share, r, m, k, source, pulse, receivers, steps, dt, h, c):
    n = around.shape[0]
    lam = (c * dt / h) ** 2
    p, old, new = np.zeros(n), np.zeros(n), np.zeros(n)
    v, x = np.zeros(len(cells)), np.zeros(len(cells))
    damp, force = np.zeros(n), np.zeros(n)
    g = c * dt / h
    for w in range(len(cells)):
        if m[w] == 0.0:
            damp[cells[w]] += g / 2 * share[w] / r[w]
    out = np.zeros((len(receivers), steps))
    for t in range(steps):
        force[:] = 0.0
        for w in range(len(cells)):
            if m[w] > 0.0:
                a = r[w] * dt / (2 * m[w])
                now = (v[w] * (1 - a) + dt / m[w] * (p[cells[w]] - k[w] * x[w])) / (1 + a)
                x[w] += dt * now
                force[cells[w]] += g * share[w] * (now - v[w])
                v[w] = now
        for i in range(n):
            s = 0.0
            for j in range(6):
                s += p[around[i, j]]
            new[i] = (2 * p[i] - (1 - damp[i]) * old[i] + lam * (s - 6 * p[i]) - force[i]) / (
                1 + damp[i]
            )
        if t < len(pulse):
            new[source] += pulse[t]
        old, p, new = p, new, old
        for i in range(len(receivers)):
            out[i, t] = p[receivers[i]]
    return out


def _octave_times(responses, rate):
    """T20 of each octave, mean over the positions, and its standard uncertainty."""
    from scipy.signal import butter, sosfilt

    out = np.full((2, len(responses)), np.nan)
    for b, f in enumerate(BANDS):
        sos = butter(4, [f / 2**0.5, f * 2**0.5], "band", fs=rate, output="sos")
        for i, h in enumerate(responses):
            energy = sosfilt(sos, h[::-1])[::-1] ** 2
            energy = energy - energy[-len(energy) // 10 :].mean()
            level = 10 * np.log10(np.maximum(np.cumsum(energy[::-1])[::-1], 1e-30))
            level -= level[0]
            end = np.argmax(level < -25)
            start = np.argmax(level < -5)
            if end > start + 5:
                t = np.arange(start, end) / rate
                out[b, i] = -60 / np.polyfit(t, level[start:end], 1)[0]
    times = np.nanmean(out, 1)
    spread = np.nanstd(out, 1, ddof=1) / np.sqrt(np.isfinite(out).sum(1))
    unsure = ~(spread < 0.25 * times)  # no mode in the band, or one that is not heard
    return np.where(unsure, np.nan, times), np.where(unsure, np.nan, spread)


def world(seed, seconds=2.2, noise=50.0):
    """Return a room of this seed. ``noise`` is dB below the largest sample."""
    rng = np.random.default_rng(seed)
    kind = ("box", "L", "slanted")[seed % 3]
    heights, vertices, faces, names, plan = _shape(rng, kind)
    around, cells, owners, where = _cells(heights, plan)
    walls = [_wall(rng) for _ in names]
    alpha = np.array([octave_alpha(w) for w in walls])
    count = np.bincount(owners, minlength=len(names))
    true = np.array([_area(vertices, f) for f in faces])
    share = (true / np.maximum(count * H**2, 1e-9))[owners]
    r, m, k = (np.array([w[i] for w in walls])[owners] for i in range(3))
    dt = 0.92 * H / (C * 3**0.5)
    steps = int(seconds / dt)

    def cell(point):
        return int(np.argmin(np.abs((where + 0.5) * H - point).sum(1)))

    low, high = vertices.min(0), vertices.max(0)
    inside = (where + 0.5) * H
    source = cell([0.3, 0.4, 0.3])
    receivers = []
    while len(receivers) < 4:
        point = low + (high - low) * rng.random(3)
        i = cell(point)
        apart = all(np.abs(inside[i] - inside[j]).sum() > 1.0 for j in receivers)
        if apart and np.abs(inside[i] - point).max() < H and inside[i][2] < 2.0:
            receivers.append(i)
    tau = np.arange(int(0.012 / dt)) * dt
    pulse = np.exp(-(((tau - 0.006) / 0.0014) ** 2))
    pulse = np.diff(pulse, append=0.0)
    heard = _run(around, cells, share, r, m, k, source, pulse, np.array(receivers), steps, dt, H, C)
    from scipy.signal import firwin, oaconvolve

    step = int(1 / (dt * RATE))
    taps = firwin(161, 240, fs=1 / dt)
    heard = oaconvolve(heard, taps[None], mode="full", axes=1)[:, 80 + int(0.006 / dt) :: step]
    rate = 1 / (dt * step)
    heard = heard[:, : int(seconds * rate)]
    heard += 10 ** (-noise / 20) * np.abs(heard).max() * rng.standard_normal(heard.shape)
    times, uncertainty = _octave_times(heard, rate)
    root = np.linalg.cholesky([[1, CORRELATION], [CORRELATION, 1]])
    stated = np.zeros_like(alpha)
    for i in range(len(walls)):
        while stated[i].min() < 0.005 or stated[i].max() > 0.7:
            stated[i] = alpha[i] / (1 + SHARE * root @ rng.standard_normal(2))
    return World(
        name=f"{kind} {seed}",
        vertices=vertices,
        faces=faces,
        walls=names,
        sources={"S": inside[source].tolist()},
        receivers={f"R{i + 1}": inside[j].tolist() for i, j in enumerate(receivers)},
        alpha=alpha,
        stated=stated,
        rate=rate,
        responses=heard,
        times=times,
        times_uncertainty=uncertainty,
        temperature=20.0 + rng.standard_normal(),
        parameters=walls,
    )
