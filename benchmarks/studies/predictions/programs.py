"""Changes that a user's program simulated before and after: is T after within its interval?

Reality is pyroomacoustics' ray tracer and the program rtcal's path tracer, with another scattering and
the stated coefficients. README.md has the rule.

python -m benchmarks.studies.predictions.programs draw 0 20 --seed 1 --out drawn.jsonl
python -m benchmarks.studies.predictions.programs count drawn.jsonl
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.prediction import Change
from rtcal.simulators import PathTracing, Polyhedron, RayTracing
from rtcal.simulators.geometry import SHOEBOX_WALLS

F = 125.0 * 2.0 ** np.arange(6)
JND = 0.05


def draw(seed: int, number: int) -> dict[str, Any]:
    """Return T of a drawn box and change: of reality and program, before and after."""
    rng = np.random.default_rng([62, 2, seed, number])
    size = rng.uniform([5, 4, 2.6], [11, 8, 5])
    x, y, z = size.tolist()
    all_on_one = number % 3 == 0
    walls = [*SHOEBOX_WALLS]
    low, high = (0.03, 0.08) if all_on_one else (0.04, 0.3)
    base = np.exp(rng.uniform(np.log(low), np.log(high), (6, 1)))
    stated = np.clip(base * (F / 500) ** rng.uniform(-0.15, 0.25, (6, 1)), 0.02, 0.8)
    panel = np.array([0.3, 0.55, 0.8, 0.85, 0.85, 0.8]) * rng.uniform(0.7, 1.1)
    sigma_panel = float(rng.choice([0.05, 0.1]))
    off = 0.1 * rng.standard_normal() + 0.2 * rng.standard_normal((6, 1))
    true = np.clip(stated * np.exp(off), 0.01, 0.95)
    true_panel = np.clip(panel + sigma_panel * rng.standard_normal(), 0.02, 0.98)
    shares = np.zeros(6)
    if all_on_one:
        shares[5] = rng.uniform(0.6, 1.0)
    else:
        shares[[rng.integers(2), 2 + rng.integers(2), 4 + rng.integers(2)]] = rng.uniform(
            0.05, 0.5, 3
        )
    s = float(rng.uniform(0.1, 0.5))
    guess = float(np.clip(s * np.exp(0.5 * rng.standard_normal()), 0.05, 0.9))
    point = size * rng.uniform(0.15, 0.85, (5, 3))
    receivers = {f"R{i}": tuple(p.tolist()) for i, p in enumerate(point[1:], 1)}
    geometry = Polyhedron.shoebox((x, y, z), dict(zip(walls, walls, strict=True)))
    areas = np.array([geometry.areas[w] for w in walls])
    room = room_of(size, walls, areas, stated)
    source = {"S": tuple(point[0].tolist())}
    at: dict[str, Any] = {
        "room": room, "geometry": geometry, "sources": source, "receivers": receivers
    }  # fmt: skip
    reality = RayTracing(**at, scattering=s, n_rays=12000, n_batches=2)
    program = PathTracing(**at, scattering=guess, n_paths=12000, n_batches=2, workers=1)
    part = shares[:, None]
    kept: dict[str, Any] = {}
    for name, of, alpha, cover in (
        ("reality", reality, true, true_panel), ("program", program, stated, panel)
    ):  # fmt: skip
        for when, a in (("before", alpha), ("after", (1 - part) * alpha + part * cover)):
            made = of.simulate(a, seed=int(rng.integers(2**31)))
            kept[f"{name} {when}"] = made.mean("t20").tolist()
    return {
        "number": number, "size": size.tolist(), "areas": areas.tolist(), "alpha": stated.tolist(),
        "panel": panel.tolist(), "sigma": sigma_panel, "shares": shares.tolist(),
        "scattering": [s, guess], **kept,
    }  # fmt: skip


def room_of(size: Any, walls: Any, areas: Any, alpha: Any) -> rt.Room:
    """Return the box as the user states it: coefficients are known within 30 %."""
    alpha = np.array(alpha)
    return rt.Room(
        name="box", volume=float(np.prod(size)), materials=list(walls), areas=list(areas), alpha=alpha,
        sigma=np.maximum(0.3 * alpha, 0.02), centre_frequencies=F, air=rt.Air(20, 50),
        dimensions=tuple(size), band_correlation=0.7,
        surfaces=[rt.Surface(name=w, material=w, area=float(a), axis="xxyyzz"[i])
                  for i, (w, a) in enumerate(zip(walls, areas, strict=True))],
    )  # fmt: skip


def judged(drawn: dict[str, Any]) -> dict[str, Any]:
    """Return error, half width in JND and coverage of a change, by program and by the equation."""
    walls, areas = [*SHOEBOX_WALLS], drawn["areas"]
    room = room_of(drawn["size"], walls, areas, drawn["alpha"])
    panel = rt.Material("panel", drawn["panel"], [drawn["sigma"]] * len(F))
    changes = [
        Change(cover=w, by=panel, area=s * a * (1 - 1e-6))
        for w, s, a in zip(walls, drawn["shares"], areas, strict=True)
        if s
    ]
    of = {
        name: rt.Measurement.from_values(F, t20=drawn[name])
        for name in ("reality before", "reality after", "program before", "program after")
    }
    known = rt.calibrate(room, of["reality before"])
    run = rt.Run(room, of["program before"])
    true = of["reality after"].mean("t20")
    naive = of["reality before"].mean("t20") * of["program after"].mean("t20")
    found: dict[str, Any] = {"one surface": drawn["number"] % 3 == 0}
    for name, made in (
        ("equation", known.predict(changes)),
        ("program", known.predict(changes, run=run, run_after=of["program after"])),
    ):
        low, high = made.interval
        found[name] = (
            np.log(made.mean / true) / np.log1p(JND),
            np.log(high / low) / 2 / np.log1p(JND),
            (low <= true) & (true <= high),
        )
    found["ratio alone"] = np.log(naive / of["program before"].mean("t20") / true) / np.log1p(JND)
    return found


def count(path: Path) -> None:
    """Print the counts of README.md."""
    every = [judged(json.loads(line)) for line in path.read_text("utf-8").splitlines()]
    for label, some in (
        ("all on one surface", [e for e in every if e["one surface"]]),
        ("spread over three", [e for e in every if not e["one surface"]]),
        ("all", every),
    ):
        print(f"{label}: {len(some)} changes, {len(some) * len(F)} values")
        for name in ("equation", "program"):
            off, half, inside = (np.array([e[name][i] for e in some]) for i in range(3))
            print(
                f"  {name}: error {np.sqrt(np.mean(off**2)):.1f} JND, bias {off.mean():+.1f}, "
                f"coverage {inside.mean():.2f}, median half width {np.median(half):.1f} JND"
            )
        off = np.array([e["ratio alone"] for e in some])
        print(f"  measured T times the program's ratio: error {np.sqrt(np.mean(off**2)):.1f} JND")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(dest="what", required=True)
    drawing, counting = commands.add_parser("draw"), commands.add_parser("count")
    drawing.add_argument("first", type=int)
    drawing.add_argument("last", type=int)
    drawing.add_argument("--seed", type=int, default=0)
    drawing.add_argument("--out", type=Path, required=True)
    counting.add_argument("drawn", type=Path)
    args = parser.parse_args()
    if args.what == "count":
        count(args.drawn)
    else:
        for number in range(args.first, args.last):
            try:
                made = json.dumps(draw(args.seed, number))
            except rt.errors.DataError as error:  # a decay without T20
                print(f"{number} is left out: {error}")
                continue
            with args.out.open("a") as file:
                file.write(made + "\n")
