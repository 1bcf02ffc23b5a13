"""The bound of modes that responses of `modes_world` can tell, and what the fit refuses.

    python -m benchmarks.modes_bound resolved 1000 1012    # Cramer-Rao bounds, room by room
    python -m benchmarks.modes_bound refused 1003 1010     # exchanged receivers, late, wrong sides

A mode counts as resolved where the bound of its decay's uncertainty is below 35 %: with amplitudes that
are free at each of the four positions, or with the pattern of the true poles and one free factor for
each mode. The noise is the world's. `apart` are modes that no other is closer to than half both widths.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np

import rtcal as rt
from benchmarks import modes_world as w
from benchmarks.modes import HIGHEST, LIMIT, room_of, true_poles, world_lowest
from rtcal.modes.fit import Spectra, fitted
from rtcal.modes.model import RoomPoles
from rtcal.simulators.geometry import Polyhedron

SURE = 0.35
NAMES = ("there", "apart", "free amplitudes", "free and apart", "known patterns")


def resolved(seed):
    """Number of modes that are there, and that each bound resolves."""
    world = w.world(seed)
    _, geometry = room_of(world)
    highest = min(HIGHEST, LIMIT * world_lowest(world))
    modes = rt.modes.modes_of(geometry, float(10 * np.ceil(1.15 * highest / 10)), w.C)
    poles = true_poles(world, modes)
    at = [
        modes.shapes(np.array(list(of.values()))) @ poles.mixtures
        for of in (world.sources, world.receivers)
    ]
    f, delta = poles.frequencies, poles.decays
    # The pulse of the world is the derivative of a Gaussian of 1.4 ms.
    a = (at[0] * at[1] / poles.norms).T * (f * np.exp(-((np.pi * f * 0.0014) ** 2)))[:, None]
    n = world.responses.shape[1]
    waves = np.exp(np.arange(n)[:, None] / world.rate * poles.values)
    a *= _scale(world, waves @ a, highest)
    noise = 10 ** (-50 / 20) * np.abs(world.responses).max()
    there = f < highest
    distance = np.abs(f[:, None] - f) + np.diag(np.full(len(f), np.inf))
    apart = (distance > (delta[:, None] + delta) / (4 * np.pi)).all(1)
    free, known = (
        _bound(world.rate, waves, a, noise, each) < SURE * delta for each in (True, False)
    )
    return [int((there & x).sum()) for x in (there, apart, free, free & apart, known)]


def _scale(world, synthetic, highest):
    """Size of the source: that of the responses over those of the poles, within the band."""
    f = np.fft.rfftfreq(len(synthetic), 1 / world.rate)
    band = (f > 15) & (f < highest)
    parts = [np.fft.rfft(x.T, axis=1)[:, band] for x in (synthetic.real, synthetic.imag)]
    heard = np.fft.rfft(world.responses, axis=1)[:, band].ravel()
    columns = np.stack([p.ravel() for p in parts], axis=1)
    solved = np.linalg.lstsq(
        np.vstack([columns.real, columns.imag]), np.append(heard.real, heard.imag), rcond=None
    )[0]
    return float(np.hypot(*solved))


def _bound(rate, waves, a, noise, free):
    """Least standard deviation of each decay in 1/s, (n_modes,)."""
    n, count = waves.shape
    time = np.arange(n)[:, None] / rate
    slopes = [np.hstack([(time * waves * r).real, -(time * waves * r).imag]) for r in a.T]
    if free:
        base = np.linalg.qr(np.hstack([waves.real, -waves.imag]))[0]
        rows = np.vstack([s - base @ (base.T @ s) for s in slopes])
    else:
        all_pairs = np.vstack([np.hstack([(waves * r).real, -(waves * r).imag]) for r in a.T])
        base = np.linalg.qr(all_pairs)[0]
        rows = np.vstack(slopes)
        rows -= base @ (base.T @ rows)
    information = rows.T @ rows / noise**2
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-13, hermitian=True)
    return (np.sqrt(np.diag(inverse)) / size)[:count]


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


def main(arguments):
    """Print one table."""
    warnings.simplefilter("ignore", RuntimeWarning)
    seeds = range(int(arguments[1]), int(arguments[2]))
    if arguments[0] == "resolved":
        rows = np.array([resolved(seed) for seed in seeds])
        print("| room | " + " | ".join(NAMES) + " |\n|" + "---|" * (len(NAMES) + 1))
        for seed, row in zip(seeds, rows, strict=True):
            print(f"| {seed} | " + " | ".join(map(str, row)) + " |")
        total = rows.sum(0) / rows[:, 0].sum()
        print("| share | " + " | ".join(f"{x:.2f}" for x in total) + " |")
        return
    found = [refused(seed) for seed in seeds]
    print("| | power left, largest | amplitudes left, least | largest |\n|---|---|---|---|")
    for name in found[0]:
        power, amplitudes = np.array([f[name] for f in found]).T
        print(f"| {name} | {power.max():.3f} | {amplitudes.min():.3f} | {amplitudes.max():.3f} |")


if __name__ == "__main__":
    main(sys.argv[1:])
