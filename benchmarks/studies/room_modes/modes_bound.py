"""The bound of what modes can tell, and what the fit refuses.

# exchanged receivers, late, wrong sides
python -m benchmarks.studies.room_modes.modes_bound refused 1003 1010
python -m benchmarks.studies.room_modes.modes_bound costs 0 20  # what errors of the model cost
python -m benchmarks.studies.room_modes.modes_bound observer 0 60  # rooms of 5 to 12 surfaces
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

import rtcal as rt
from benchmarks.studies.room_modes import modes_world as w
from benchmarks.studies.room_modes.modes import (
    HIGHEST,
    LIMIT,
    bound,
    room_of,
    world_lowest,
)
from rtcal.acoustics.bands import schroeder_frequency
from rtcal.modes.model import RoomPoles
from rtcal.modes.responses import Spectra, fitted
from rtcal.modes.room_modes import box_modes
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron


def refused(seed):
    """Shares of power and of amplitudes that the modes leave: right, and with what is wrong."""
    world = w.world(seed)
    room, geometry = room_of(world)
    highest = min(HIGHEST, LIMIT * world_lowest(world))
    sides = np.array([1.01, 1 / 1.01, 1.0])
    stretched = Polyhedron(
        vertices=geometry.vertices * sides,
        faces=geometry.faces,
        materials=geometry.materials,
        names=geometry.names,
    )
    cases = {
        "right": (world.responses, geometry),
        "1 % longer and narrower": (world.responses, stretched),
        "receivers exchanged": (world.responses[[1, 0, 3, 2]], geometry),
        "20 ms late": (np.roll(world.responses, round(0.02 * world.rate), axis=1), geometry),
    }
    pairs = [("S", r) for r in world.receivers]
    out = {}
    for name, (responses, told) in cases.items():
        model = RoomPoles.of(room, 1.08 * highest, geometry=told)
        heard = Spectra.of(responses, world.rate, 20.0, highest)
        fit = fitted(heard, model.calculated, model.amplitudes(pairs))
        out[name] = (fit.unexplained, fit.strange)
    return out


def costs(seed):
    """Mean error of alpha over that of the stated one, by what the model does not know.

    A box with modes to 110 Hz, whose decays are known within 5 %. Stated coefficients err by 40 %.
    """
    rng = np.random.default_rng(seed)
    sides = rng.uniform(0.9, 1.1, 3) * np.array([5.5, 4.3, 2.7])
    true = np.exp(rng.uniform(np.log(0.03), np.log(0.5), 6))
    stated = np.clip(true / np.clip(1 + 0.4 * rng.standard_normal(6), 0.3, None), 0.01, 0.7)
    noise = rng.standard_normal(200)
    box = Polyhedron.shoebox(sides, dict(zip(SHOEBOX_WALLS, SHOEBOX_WALLS, strict=True)))
    materials = [
        rt.Material(n, [a] * 2, [0.4 * a] * 2) for n, a in zip(SHOEBOX_WALLS, stated, strict=True)
    ]
    room = rt.Room.from_geometry(
        box,
        name="box",
        materials=materials,
        dimensions=sides,
        centre_frequencies=[63, 125],
        air=rt.Air(20, 50),
    )

    def error(modes, beta):
        poles = modes.poles(lambda f: beta)
        n = int((poles.frequencies < 110).sum())
        heard = rt.modes.MeasuredModes(
            frequencies=np.sort(poles.frequencies[:n]) + 1e-6 * np.arange(n),
            decays=poles.decays[:n] * np.exp(0.05 * noise[:n]),
            decay_uncertainty=0.05 * poles.decays[:n],
            calculated=np.arange(n),
        )
        found = rt.calibrate_modes(room, heard, geometry=box)
        return float(np.abs(found.alpha[:, 0] - true).mean() / np.abs(stated - true).mean())

    top, c = 125.0, room.air.speed_of_sound
    plain, beta = rt.modes.modes_of(box, top, c), rt.modes.admittance(true)
    long = box_modes(sides * [1.01, 0.99, 1.0], SHOEBOX_WALLS, top, c)
    phase = np.exp(1j * np.radians(45))
    # The same alpha at each wall, with a mass or a spring beside the resistance.
    reactive = np.array([b * phase ** rng.choice([-1, 1]) for b in _with_phase(true)])
    return {
        "none": error(plain, beta),
        "1 % longer and narrower": error(long, beta),
        "1 K warmer": error(rt.modes.modes_of(box, top, c + 0.6), beta),
        "admittance with a phase of 45°": error(plain, reactive),
        "floor and ceiling absorb on one half alone": error(_halved(plain, sides), beta),
    }


OUTLINES = {
    "wedge": [(0, 0), (1, 0), (0.2, 0.8)],
    "box": [(0, 0), (1, 0), (1, 0.8), (0, 0.8)],
    "slanted ceiling": [(0, 0), (1, 0), (1, 0.8), (0, 0.8)],
    "L": [(0, 0), (1, 0), (1, 0.4), (0.5, 0.4), (0.5, 0.9), (0, 0.9)],
    "T": [(0, 0), (1, 0), (1, 0.4), (0.7, 0.4), (0.7, 0.9), (0.3, 0.9), (0.3, 0.4), (0, 0.4)],
    "three steps": [
        *((0, 0), (1, 0), (1, 0.3), (0.75, 0.3), (0.75, 0.5)),
        *((0.5, 0.5), (0.5, 0.7), (0.25, 0.7), (0.25, 0.9), (0, 0.9)),
    ],
}
"""Plans of rooms with walls that stand upright: n corners are n + 2 surfaces."""


def observer(seed):
    """Kind, surfaces, and the errors below Schroeder that a linear Gaussian observer expects.

    Of what is stated, of T within 5 %, and of T and all modes within 10 %; last the share of draws in
    which the third is no worse than the first. None without a band below the Schroeder frequency.
    """
    rng = np.random.default_rng(seed)
    kind = list(OUTLINES)[seed % len(OUTLINES)]
    plan, n = np.array(OUTLINES[kind]), len(OUTLINES[kind])
    volume, height = np.exp(rng.uniform(np.log(15), np.log(300))), rng.uniform(2.3, 3.2)
    x, y = plan.T
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    plan = plan * np.sqrt(volume / height / area)
    top = np.full(n, height)
    if kind == "slanted ceiling":
        top += 0.3 * height * (plan[:, 0] / plan[:, 0].max() - 0.5)
    floor, ceiling = np.c_[plan, np.zeros(n)], np.c_[plan, top]
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    walls = [f"wall {i + 1}" for i in range(n)] + ["floor", "ceiling"]
    geometry = Polyhedron(
        vertices=np.vstack([floor, ceiling]),
        faces=[*sides, list(range(n)), list(range(n, 2 * n))],
        materials=walls,
        names=walls,
    )
    alpha = np.exp(rng.uniform(np.log(0.03), np.log(0.5), (n + 2, 1)))
    alpha = np.clip(alpha * np.exp(0.3 * rng.standard_normal((n + 2, 2))), 0.02, 0.6)
    materials = [rt.Material(m, a, w.SHARE * a) for m, a in zip(walls, alpha, strict=True)]
    room = rt.Room.from_geometry(
        geometry, name=kind, materials=materials, centre_frequencies=w.BANDS, air=rt.Air(20, 50)
    )
    t = rt.Eyring().time(room, room.areas @ room.alpha)
    low = schroeder_frequency(t.mean(), room.volume) > w.BANDS
    if not low.any():
        return None
    longest = np.linalg.norm(plan[:, np.newaxis] - plan, axis=-1).max()
    c = room.air.speed_of_sound
    highest = min(HIGHEST, LIMIT * c / 2 / longest)
    modes = rt.modes.modes_of(geometry, float(10 * np.ceil(1.08 * highest / 10)), c)
    alone, both, share = bound(room, modes, t, low)
    return (kind, n + 2, *(float(e[:, low].mean()) for e in (room.sigma, alone, both)), share)


def _observed(seeds):
    """Print a row for each kind of room, and one for all."""
    found = [f for f in map(observer, seeds) if f is not None]
    print("| plan | rooms | surfaces | T / stated | T and modes / T | no worse |")
    print("|" + "---|" * 6)
    for kind in [*OUTLINES, "all"]:
        chosen = [f for f in found if kind in ("all", f[0])]
        stated, alone, both, share = np.array([f[2:] for f in chosen]).mean(0)
        surfaces = sorted({f[1] for f in chosen})
        print(
            f"| {kind} | {len(chosen)} | {' to '.join(map(str, surfaces[:: len(surfaces) - 1 or 1]))} "
            f"| {alone / stated:.2f} | {both / alone:.2f} | {share:.2f} |"
        )


def _with_phase(alpha):
    """Sizes of admittances of a phase of 45° with these coefficients."""
    turn = np.exp(1j * np.radians(45))
    return [brentq(lambda b, a=a: rt.modes.absorption(b * turn) - a, 0.0, 0.6) for a in alpha]


def _halved(modes, sides):
    """The modes of the box whose floor and ceiling have all their admittance on the half x < L / 2."""
    points = [np.polynomial.legendre.leggauss(24) for _ in range(2)]
    x, y = (
        (p + 1) / 2 * side for (p, _), side in zip(points, (sides[0] / 2, sides[1]), strict=True)
    )
    weights = np.outer(points[0][1] * sides[0] / 4, points[1][1] * sides[1] / 2).ravel()
    coupling = modes.coupling.copy()
    for wall, z in ((4, 0.0), (5, sides[2])):
        grid = np.stack(
            [*(a.ravel() for a in np.meshgrid(x, y, indexing="ij")), np.full(576, z)], 1
        )
        at = modes.shapes(grid)
        coupling[wall] = 2 * at.T @ (weights[:, None] * at)
    return replace(modes, coupling=coupling)


def main(arguments):
    """Print one table."""
    warnings.simplefilter("ignore", RuntimeWarning)
    seeds = range(int(arguments[1]), int(arguments[2]))
    if arguments[0] == "observer":
        _observed(seeds)
        return
    if arguments[0] == "costs":
        found = [costs(seed) for seed in seeds]
        print("| what the model does not know | error / stated | no worse |\n|---|---|---|")
        for name in found[0]:
            ratio = np.array([f[name] for f in found])
            print(f"| {name} | {ratio.mean():.2f} | {(ratio <= 1).mean():.2f} |")
        return
    found = [refused(seed) for seed in seeds]
    print("| | power left, largest | amplitudes left, least | largest |\n|---|---|---|---|")
    for name in found[0]:
        power, amplitudes = np.array([f[name] for f in found]).T
        print(f"| {name} | {power.max():.3f} | {amplitudes.min():.3f} | {amplitudes.max():.3f} |")


if __name__ == "__main__":
    main(sys.argv[1:])
