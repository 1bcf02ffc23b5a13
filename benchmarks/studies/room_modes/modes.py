"""The quality of the calibration to room modes, in a wave world that is not rtcal's (`modes_world`).

    python -m benchmarks.studies.room_modes.modes dev FILE  # rooms 1000 to 1023, for development
    python -m benchmarks.studies.room_modes.modes judge FILE  # rooms 5000 to 5059, judged once
    python -m benchmarks.studies.room_modes.modes judge FILE 5000 5030  # some of them
    python -m benchmarks.studies.room_modes.modes show FILE
    # of one core: a slanted room of 95 m³, modes to 200 Hz
    python -m benchmarks.studies.room_modes.modes time

Each room has responses at 4 positions with noise, T20 of the octaves 63 and 125 Hz from them, and
stated coefficients that are off by 40 %. The temperature told is off by 1 K.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np

import rtcal as rt
from benchmarks.studies.room_modes import modes_world as w
from rtcal.acoustics.bands import schroeder_frequency
from rtcal.acoustics.room_errors import prior_covariance
from rtcal.modes.room_modes import AtFrequencies, RoomPoles, admittance, admittance_slope
from rtcal.simulators.geometry import Polyhedron

HIGHEST = 140.0
SHAPE_ROWS = (
    "rooms",
    "error, modes / T alone",
    "no worse than stated, modes",
    "90 % intervals",
    "found and rightly matched",
    "wrong of those used",
)
LIMIT = 7.5
"""Modes that are counted lie below 1.5 times the lowest axial mode's fifth multiple."""


def room_of(world):
    """The room as it is told to rtcal."""
    geometry = Polyhedron(
        vertices=world.vertices, faces=world.faces, materials=world.walls, names=world.walls
    )
    sigma = w.SHARE * world.stated
    materials = [
        rt.Material(n, m.tolist(), s.tolist())
        for n, m, s in zip(world.walls, world.stated, sigma, strict=True)
    ]
    room = rt.Room.from_geometry(
        geometry,
        name=world.name,
        materials=materials,
        centre_frequencies=w.BANDS,
        air=rt.Air(world.temperature, 50),
    )
    scene = rt.Scene(sources=world.sources, receivers=world.receivers)
    return room.replace(scene=scene), geometry


def bound(room, modes, t, low, relative=0.1):
    """Expected errors of linear Gaussian observers: of T alone, and of T with all modes too.

    Third is the share of draws in which the second is no worse than what was stated.
    """
    correlation = w.CORRELATION ** np.abs(
        np.subtract.outer(*[np.log2(room.centre_frequencies)] * 2)
    )
    sigma = room.sigma.ravel()
    prior = sigma[:, None] * np.kron(np.eye(room.n_materials), correlation) * sigma
    correlated = room.replace(band_correlation=w.CORRELATION)
    at = AtFrequencies.of(correlated, modes.frequencies[: modes.wanted])
    g = np.einsum("imm->im", modes.coupling)[:, : modes.wanted] * modes.speed_of_sound / 2
    rows = [room.material_index(m) for m in modes.materials]
    by_material = np.zeros((room.n_materials, modes.wanted))
    np.add.at(by_material, rows, g)
    slope = by_material * admittance_slope(at.mean).real
    decays = (by_material * admittance(at.mean).real).sum(0)
    matrix = (slope.T[:, :, None] * at.slope().transpose(1, 0, 2)).reshape(modes.wanted, -1)
    in_sigmas = slope * at.sigma
    error = (in_sigmas.T @ in_sigmas) * at.remainder + np.diag((relative * decays) ** 2)
    of_t = np.kron(room.areas, np.eye(room.n_bands)).reshape(room.n_materials, -1, room.n_bands)
    of_t = np.moveaxis(of_t.reshape(-1, room.n_bands), 0, 1)[np.isfinite(t)]
    b = of_t @ room.alpha.ravel()

    def sigma_after(matrix, error):
        gain = np.linalg.solve(matrix @ prior @ matrix.T + error, matrix @ prior)
        return np.sqrt(np.diag(prior - prior @ matrix.T @ gain)).reshape(room.alpha.shape)

    alone = sigma_after(of_t, np.diag((0.05 * b) ** 2)) if len(b) else room.sigma
    both = np.vstack([matrix, of_t])
    noise = np.zeros((len(both),) * 2)
    noise[: len(error), : len(error)] = error
    noise[len(error) :, len(error) :] = np.diag((0.05 * b) ** 2)
    return alone, sigma_after(both, noise), no_worse(prior, both, noise, low)


def no_worse(prior, matrix, noise, low):
    """Share of draws in which a linear Gaussian observer is no worse than what was stated."""
    rng, draws = np.random.default_rng(0), 4000
    off = np.linalg.cholesky(prior) @ rng.standard_normal((len(prior), draws))
    heard = matrix @ off + np.linalg.cholesky(noise) @ rng.standard_normal((len(noise), draws))
    after = off - prior @ matrix.T @ np.linalg.solve(matrix @ prior @ matrix.T + noise, heard)
    mean = [np.abs(e.T.reshape(draws, -1, len(low)))[:, :, low].mean((1, 2)) for e in (off, after)]
    return float((mean[1] <= mean[0]).mean())


def true_poles(world, modes, like=None):
    """The room's poles with the true admittances, by rtcal's modes: they say which mode is which.

    ``like`` are the shapes that they are numbered by.
    """
    sets = [world.parameters[world.walls.index(m)] for m in modes.materials]
    return modes.poles(lambda f: np.array([w.admittance(s, f) for s in sets]), like)


def judge_room(seed):
    """Everything that is asked of one room."""
    world = w.world(seed)
    room, geometry = room_of(world)
    out = {"seed": seed, "name": world.name, "volume": room.volume, "walls": len(world.walls)}
    lowest = world_lowest(world)
    highest = min(HIGHEST, LIMIT * lowest)
    t = world.times
    known = t[np.isfinite(t)]
    limit = float(schroeder_frequency(known.mean(), room.volume)) if known.size else 1e9
    low = limit > w.BANDS
    out["below"] = low.tolist()
    if not low.any():
        return {**out, "skipped": "no band below the Schroeder frequency"}
    measured = None
    if known.size:
        measured = rt.Measurement(
            centre_frequencies=w.BANDS,
            values={"t20": t[None]},
            uncertainty={"t20": world.times_uncertainty[None]},
        )
    start = time.perf_counter()
    try:
        pairs = [("S", r) for r in world.receivers]
        heard = rt.modes.find_modes(
            room, world.responses, world.rate, pairs, highest=highest, geometry=geometry
        )
        result = rt.calibrate_modes(room, heard, measured, geometry=geometry)
    except rt.errors.RtcalError as error:
        return {**out, "failed": str(error)[:200]}
    out["seconds"] = time.perf_counter() - start
    start = time.perf_counter()
    rt.calibrate_modes(room, heard, measured, geometry=geometry)
    out["seconds_after"] = time.perf_counter() - start
    alone = room.alpha
    if measured is not None:
        alone = rt.calibrate(room, measured, unreachable="nearest").alpha
    error = {
        name: float(np.abs(a - world.alpha)[:, low].mean())
        for name, a in (("prior", room.alpha), ("t", alone), ("modes", result.alpha))
    }
    ends = result.interval
    inside = (ends[0] <= world.alpha) & (world.alpha <= ends[1])
    out |= {"error": error, "inside": int(inside[:, low].sum()), "of": int(inside[:, low].size)}
    top = 10 * np.ceil(1.08 * max(heard.frequencies[-1], highest) / 10)
    modes = rt.modes.modes_of(geometry, float(top), room.air.speed_of_sound)
    of_t, of_both, share = bound(room, modes, t, low)
    out["bound"] = {
        "t": float(of_t[:, low].mean()),
        "modes": float(of_both[:, low].mean()),
        "no_worse": share,
    }
    out["sigma"] = float(result.sigma[:, low].mean())
    out["promised"] = no_worse(
        prior_covariance(result.answer.prior),
        result.linearised.matrix,
        result.linearised.covariance,
        low,
    )
    out |= matches(world, modes, heard, result, highest)
    out |= held_out(room, geometry, heard, measured, alone, result)
    return out


def world_lowest(world):
    """The lowest axial mode's frequency in Hz: half a wave along the longest side."""
    return w.C / 2 / float(np.ptp(world.vertices, axis=0).max())


def matches(world, modes, heard, result, highest):
    """Return how many modes were found and rightly matched, and how many used matches are wrong.

    Modes are numbered by the shapes that they have with the stated coefficients.
    """
    stated = RoomPoles(result.answer.prior, modes).calculated.mixtures
    poles = true_poles(world, modes, stated)
    at = [
        modes.shapes(np.array(list(of.values()))) @ poles.mixtures
        for of in (world.sources, world.receivers)
    ]
    patterns = (at[0] * at[1]).T
    right = nearest = 0
    for k, i in enumerate(result.used):
        if poles.frequencies[result.matched[k]] >= highest:
            continue
        a = heard.amplitudes[i]
        mac = np.abs(patterns.conj() @ a) ** 2 / (
            (np.abs(patterns) ** 2).sum(1) * (np.abs(a) ** 2).sum()
        )
        off = (poles.frequencies - heard.frequencies[i]) / np.hypot(0.01 * poles.frequencies, 0.2)
        right += int(np.argmin(off**2 + (1 - mac) / 0.1) == result.matched[k])
        pole = -heard.decays[i] + 2j * np.pi * heard.frequencies[i]
        nearest += int(np.argmin(np.abs(poles.values - pole)) == result.matched[k])
    used = int((poles.frequencies[result.matched] < highest).sum())
    there = int((poles.frequencies < highest).sum())
    return {
        "there": there,
        "found": len(heard.frequencies),
        "used": used,
        "right": right,
        "nearest": nearest,
    }


def held_out(room, geometry, heard, measured, alone, result):
    """Errors of held-out modes' decays, by the other modes and by T's coefficients."""
    used = result.used
    out = used[1::3]
    keep = np.setdiff1d(np.arange(len(heard.frequencies)), out)
    if not len(out) or len(used) - len(out) < 2:
        return {}
    place = dict(zip(result.used, result.matched, strict=True))
    n = np.array([place[i] for i in out])
    try:
        other = rt.calibrate_modes(room, heard.only(keep), measured, geometry=geometry)
        by_t = rt.calibrate_modes(
            room.replace(alpha=alone), heard.only(keep), measured, geometry=geometry
        )
    except rt.errors.RtcalError as error:
        return {"held_failed": str(error)[:200]}
    if n.max() >= min(len(other.decays_after), len(by_t.decays_before)):
        n_ok = n < min(len(other.decays_after), len(by_t.decays_before))
        n, out = n[n_ok], out[n_ok]
    off = [
        float(np.abs(np.log(d[n] / heard.decays[out])).mean())
        for d in (other.decays_after, by_t.decays_before, other.decays_before)
    ]
    return {"held": {"modes": off[0], "t": off[1], "prior": off[2], "n": len(n)}}


def summary(rows):
    """Return what the issue asks, by name."""
    good = [r for r in rows if "error" in r]
    error = {k: np.array([r["error"][k] for r in good]) for k in ("prior", "t", "modes")}
    limit = {k: np.mean([r["bound"][k] for r in good]) for k in ("t", "modes")}
    there, right, used = (sum(r[k] for r in good) for k in ("there", "right", "used"))
    held = [r["held"] for r in good if "held" in r]
    n = np.array([h["n"] for h in held])
    off = {k: (n * [h[k] for h in held]).sum() / n.sum() for k in ("modes", "t", "prior")}
    return {
        "rooms": len(rows),
        "judged": len(good),
        "failed": sum("failed" in r for r in rows),
        "without a band below Schroeder": sum("skipped" in r for r in rows),
        "mean error, stated": round(float(error["prior"].mean()), 4),
        "mean error, T alone": round(float(error["t"].mean()), 4),
        "mean error, modes": round(float(error["modes"].mean()), 4),
        "error, modes / T alone": round(float(error["modes"].mean() / error["t"].mean()), 3),
        "median of the rooms' ratios": round(float(np.median(error["modes"] / error["t"])), 3),
        "bound of it, all modes with 10 %": round(float(limit["modes"] / limit["t"]), 3),
        "no worse than stated, modes": round(float((error["modes"] <= error["prior"]).mean()), 3),
        "no worse than stated, bound": round(
            float(np.mean([r["bound"]["no_worse"] for r in good])), 3
        ),
        "no worse than stated, promised by the intervals": round(
            float(np.mean([r["promised"] for r in good])), 3
        ),
        "no worse than stated, T alone": round(float((error["t"] <= error["prior"]).mean()), 3),
        "90 % intervals": round(sum(r["inside"] for r in good) / sum(r["of"] for r in good), 3),
        "modes there": there,
        "found and rightly matched": round(right / there, 3),
        "wrong of those used": round(1 - right / used, 3),
        "of those used, nearest to their own pole": round(
            sum(r["nearest"] for r in good) / used, 3
        ),
        "held-out modes": int(n.sum()),
        "their decays' error, modes": round(float(off["modes"]), 3),
        "their decays' error, T alone": round(float(off["t"]), 3),
        "their decays' error, stated": round(float(off["prior"]), 3),
        "held-out error, modes / T alone": round(float(off["modes"] / off["t"]), 3),
        "seconds, median of the first time": round(
            float(np.median([r["seconds"] for r in good])), 1
        ),
        "seconds, median of the second": round(
            float(np.median([r["seconds_after"] for r in good])), 2
        ),
    }


def show(rows):
    """Print what the issue asks, as a table, and some of it by the shape of the room."""
    print("| | |\n|---|---|")
    for name, value in summary(rows).items():
        print(f"| {name} | {value} |")
    names = list(by_shape(rows))
    print(f"\n| | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for name in SHAPE_ROWS:
        print(f"| {name} | {' | '.join(str(by_shape(rows)[s][name]) for s in names)} |")


def by_shape(rows):
    """Return the rows of `SHAPE_ROWS` of `summary` by shape: boxes, L-shapes and slanted rooms."""
    shapes = dict.fromkeys(r["name"].split()[0] for r in rows)
    return {s: summary([r for r in rows if r["name"].startswith(s)]) for s in sorted(shapes)}


def seconds():
    """Print what finding and calibrating take of one core, the first time and after it."""
    world = w.world(1001)
    room, geometry = room_of(world)
    pairs = [("S", r) for r in world.receivers]
    for name in ("first", "after"):
        start = time.process_time()
        heard = rt.modes.find_modes(
            room, world.responses, world.rate, pairs, highest=200.0, geometry=geometry
        )
        found = time.process_time()
        rt.calibrate_modes(room, heard, geometry=geometry)
        end = time.process_time()
        print(f"{name}: {found - start:.1f} s to find, {end - found:.1f} s to calibrate")


def main(arguments):
    """Run, or show what was run."""
    if arguments[0] == "time":
        seconds()
        return
    if arguments[0] == "show":
        show([json.loads(line) for line in Path(arguments[1]).read_text().splitlines()])
        return
    seeds = range(1000, 1024) if arguments[0] == "dev" else range(5000, 5060)
    if arguments[2:]:
        seeds = range(*map(int, arguments[2:4]))
    path = Path(arguments[1])
    done = (
        {json.loads(x)["seed"] for x in path.read_text().splitlines()} if path.exists() else set()
    )
    warnings.simplefilter("ignore", RuntimeWarning)
    for seed in seeds:
        if seed not in done:
            row = judge_room(seed)
            with path.open("a") as file:
                file.write(json.dumps(row) + "\n")
    show([json.loads(line) for line in path.read_text().splitlines()])


if __name__ == "__main__":
    main(sys.argv[1:])
