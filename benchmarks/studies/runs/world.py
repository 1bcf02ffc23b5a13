"""Draw the rooms, search each with and without the run, and count; README.md has the rule.

python -m benchmarks.studies.runs.world find 0 90 --out judged.jsonl   # goes on where it stopped
python -m benchmarks.studies.runs.world count          # the stored rooms that judged this code
python -m benchmarks.studies.runs.world count judged.jsonl
"""

from __future__ import annotations

import argparse
import gzip
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.finder import Case, Configuration, recalibrate
from rtcal.finder.claim import wide
from rtcal.finder.finding import Finding
from rtcal.finder.means.engines import ControlRoom, _image_sources, box
from rtcal.finder.means.problem import observe
from rtcal.finder.means.recalibration import plain
from rtcal.simulators import PathTracing, Polyhedron, RayTracing
from rtcal.simulators.geometry import SHOEBOX_WALLS

F = 125.0 * 2.0 ** np.arange(6)
KINDS = ("ordinary", "hard box", "long hall", "coupled")
HIDDEN = {
    "porous": ("added absorption, rising", [0.15, 0.5, 0.85, 0.95, 0.95, 0.9]),
    "audience": ("added absorption, rising", [0.4, 0.55, 0.7, 0.8, 0.85, 0.85]),
    "opening": ("added absorption, flat", [1.0] * 6),
    "panel": ("added absorption, low", [0.5, 0.35, 0.15, 0.1, 0.08, 0.06]),
    "covered": ("less absorption", [0.04] * 6),
    "air": ("climate", []),
}
STORED = Path(__file__).parent / "judged_seed3.jsonl.gz"
"""Rooms that judged the code as it is; those of seed 2 judged the code before."""
FOUND = ("named", "family", "ambiguous", "unknown")
NOISE, LEVEL_NOISE = 0.02, 0.3


@dataclass(frozen=True)
class World:
    """A room as the user states it, and reality: its alpha, air, simulator and scattering."""

    kind: str
    hidden: str
    room: rt.Room
    alpha: Any
    geometry: Polyhedron
    source: tuple[float, ...]
    receivers: dict[str, tuple[float, ...]]
    simulators: tuple[str, str]
    scattering: tuple[float, float]

    def simulate(self, side: int, room: rt.Room, alpha: Any, seed: int) -> rt.Measurement:
        """Return the means of reality (side 0) or of the program (side 1)."""
        if self.simulators[side] == "images":
            values = dict.fromkeys(["t20"], np.ones(6))
            dummy = Configuration(name="x", measured=rt.Measurement.from_values(F, **values))
            control, geometry, share = box(Case(room=room, configurations=[dummy]))
            pairs = ControlRoom(
                control, geometry, share, self.source, self.receivers, 0.0, "random"
            )
            longest = float(rt.Eyring().reverberation_time(room.replace(alpha=alpha)).max())
            made = _image_sources(pairs, 0)(pairs.by_axis(alpha), 2 * longest)
            ln_t20, edt, t30, c80, g = made
            t = np.exp(ln_t20)
            values = {"t20": t, "edt": t * np.exp(edt), "t30": t * np.exp(t30), "c80": c80, "g": g}
            return rt.Measurement.from_values(F, **values)
        made = self.simulator(side, room).simulate(alpha, seed=seed)
        used = [p for p in ("t20", "edt", "t30", "c80", "g") if p in made.values]
        return rt.Measurement.from_values(F, **{p: made.mean(p) for p in used})

    def simulator(self, side: int, room: rt.Room) -> Any:
        """Return the simulator of a side; image sources have none of this kind."""
        name, s = self.simulators[side], self.scattering[side]
        at: dict[str, Any] = {"room": room, "geometry": self.geometry, "scattering": s,
                              "sources": {"S": self.source}, "receivers": self.receivers}  # fmt: skip
        if name == "pyroomacoustics":
            return RayTracing(**at, n_rays=4000, n_batches=2)
        return PathTracing(**at, n_paths=4000, n_batches=2, scattering_model="random", workers=1)


def draw(seed: int, number: int) -> World:
    """Return room ``number``; every third hides nothing."""
    rng = np.random.default_rng([62, seed, number])
    kind = "ordinary" if rng.uniform() < 0.6 else str(rng.choice(KINDS[1:]))
    hidden = "" if number % 3 == 0 else [*HIDDEN][(number - number // 3 - 1) % len(HIDDEN)]
    names = ["paths", "pyroomacoustics"] + ["images"] * (kind == "ordinary")
    first, second = rng.permutation(names)[:2]
    even = "images" in (first, second)
    size = {"long hall": (rng.uniform(25, 40), rng.uniform(6, 9), rng.uniform(3, 5)),
            "hard box": (rng.uniform(8, 15), rng.uniform(6, 10), rng.uniform(2.8, 4))}  # fmt: skip
    x, y, z = size.get(kind, (rng.uniform(7, 16), rng.uniform(6, 12), rng.uniform(3, 6)))
    geometry = coupled(x, y, z, rng) if kind == "coupled" else Polyhedron.shoebox(
        (x, y, z), dict(zip(SHOEBOX_WALLS, SHOEBOX_WALLS, strict=True)))  # fmt: skip
    materials = list(dict.fromkeys(geometry.materials))
    n = len(materials)
    low, high = (0.1, 0.2) if even else (0.04, 0.3)
    base = np.exp(rng.uniform(np.log(low), np.log(high), n))
    if kind == "hard box":
        base = np.array([rng.uniform(0.6, 0.8) if m == "ceiling" else rng.uniform(0.03, 0.08)
                         for m in materials])  # fmt: skip
    tilt = rng.uniform(-0.15, 0.25, (n, 1))
    alpha = np.clip(base[:, None] * (F / 500) ** tilt, 0.02, 0.9)
    relative = rng.uniform(0.1, 0.3)
    rho = 0.7 ** np.abs(np.subtract.outer(range(6), range(6)))
    z_of = rng.standard_normal((n, 6)) @ np.linalg.cholesky(rho).T
    areas = np.array([geometry.areas[m] for m in materials])
    air = rt.Air(rng.uniform(18, 24), rng.uniform(30, 60))
    room = rt.Room(
        name=f"{kind} {number}", volume=geometry.volume, materials=materials, areas=areas,
        alpha=alpha, sigma=relative * alpha, centre_frequencies=F, band_correlation=0.7,
        air=None if hidden == "air" else air,
        dimensions=None if kind == "coupled" else (x, y, z),
        surfaces=() if kind == "coupled" else [
            rt.Surface(name=m, material=m, area=float(a)) for m, a in zip(materials, areas, strict=True)
        ],
    )  # fmt: skip
    true = np.clip(alpha * (1 + relative * z_of), 0.005, 0.97)
    if hidden not in ("", "air"):
        true = with_hidden(rng, hidden, materials, areas, true)
    point = np.array([x, y, z]) * rng.uniform(0.15, 0.85, (5, 3))
    while (np.linalg.norm(point[1:] - point[0], axis=1) < 0.2 * (x * y * z) ** (1 / 3)).any():
        point = np.array([x, y, z]) * rng.uniform(0.15, 0.85, (5, 3))
    s = rng.uniform(0.3, 0.6) if kind == "ordinary" else rng.uniform(0.1, 0.3)
    guess = float(np.clip(s * np.exp(0.3 * rng.standard_normal()), 0.05, 0.9))
    receivers = {f"R{i}": tuple(p.tolist()) for i, p in enumerate(point[1:], 1)}
    return World(kind, hidden, room, true, geometry, tuple(point[0].tolist()), receivers,
                 (str(first), str(second)), (float(s), guess))  # fmt: skip


def with_hidden(rng: Any, hidden: str, materials: Sequence[str], areas: Any, alpha: Any) -> Any:
    """Return alpha with a patch on one surface that changes the absorption area by a share."""
    spectrum = np.array(HIDDEN[hidden][1])
    on = (
        int(np.argmax(areas * alpha.mean(1)))
        if hidden == "covered"
        else int(rng.integers(len(areas)))
    )
    if hidden == "audience":
        on = list(materials).index("floor")
    total, gain = (areas @ alpha)[2:5].mean(), (spectrum - alpha[on])
    wanted = rng.uniform(0.15, 0.6) * total / max(abs(gain).max(), 0.05)
    share = min(wanted / areas[on], 0.9)
    out = alpha.copy()
    out[on] = alpha[on] + share * gain
    return out


def coupled(x: float, y: float, z: float, rng: Any) -> Polyhedron:
    """Return two rooms with a neck of full height between them; the second one's walls are its own."""
    w, a, b = 0.15 * y, 0.4 * y, rng.uniform(0.5, 1.0) * x
    plan = [(0, 0), (x, 0), (x, a), (x + 0.3, a), (x + 0.3, 0), (x + b, 0), (x + b, y), (x + 0.3, y),
            (x + 0.3, a + w), (x, a + w), (x, y), (0, y)]  # fmt: skip
    walls = list(zip(plan, [*plan[1:], plan[0]], strict=True))
    faces = [("floor", "floor", [(*p, 0.0) for p in plan[::-1]]),
             ("ceiling", "ceiling", [(*p, z) for p in plan])]  # fmt: skip
    for i, (p, q) in enumerate(walls):
        side = "second walls" if p[0] > x or q[0] > x else f"wall {i % 4}"
        faces.append((f"w{i}", side, [(*p, 0.0), (*q, 0.0), (*q, z), (*p, z)]))
    return Polyhedron.from_polygons(faces)


def judge(seed: int, number: int) -> dict[str, Any]:
    """Return what was claimed of a room with and without the run, and the gaps after `apply`."""
    world, rng = draw(seed, number), np.random.default_rng([63, seed, number])
    air = world.room.air or rt.Air(20, 40)
    real = world.simulate(0, world.room.replace(air=air), world.alpha, 1)
    values, u = {}, {}
    for p in real.values:
        mean, time = real.mean(p), p in ("t20", "edt", "t30")
        noise = rng.standard_normal(6)
        values[p] = (mean * (1 + NOISE * noise) if time else mean + LEVEL_NOISE * noise)[None]
        u[p] = NOISE * values[p] if time else np.full((1, 6), LEVEL_NOISE)
    measured = rt.Measurement(centre_frequencies=F, values=values, uncertainty=u)
    run = rt.Run(world.room, world.simulate(1, world.room, world.room.alpha, 2))
    out: dict[str, Any] = {"number": number, "kind": world.kind, "hidden": world.hidden,
                           "simulators": world.simulators}  # fmt: skip
    conf = Configuration(name="as measured", measured=measured, simulated=run)
    case = Case(room=world.room, configurations=[conf], program="geometrical")
    eyring = rt.Eyring().reverberation_time(world.room)
    out["equation_off"] = float(np.log(eyring / run.simulated.mean("t20")).mean())
    with_run = rt.find(case)
    out["with"], out["without"] = row(with_run, world), row(rt.find(world.room, measured), world)
    if with_run.verdict in ("named", "family") and world.simulators[1] != "images":
        out["gap"], out["values"] = gaps(with_run, world)
    return out


def row(f: Finding, world: World) -> dict[str, Any]:
    """Return the claim, and whether it is right."""
    truth = HIDDEN[world.hidden][0] if world.hidden else ""
    claimed = f.family if f.verdict in ("named", "family") else None
    held = {f.effects[n].family if n in f.effects else n for n in f.names}
    every = [f.detection, *f.detection.parts.values()]
    return {"verdict": f.verdict, "family": claimed, "best": f.best_effect, "score": f.score,
            "threshold": f.threshold, "over": max(d.score - d.threshold for d in every),
            "right": claimed in (truth, wide(truth)) if claimed else None,
            "in_set": truth in held, "none": f.probabilities["none"]}  # fmt: skip


def gaps(f: Finding, world: World) -> tuple[list[float], list[float]]:
    """Return the mean gaps in JND of what was not fitted.

    First those of EDT / T20, T30 / T20, C80 and G: calibrated (by the run's ratio), and
    corrected and run again. Then those of EDT, T30, C80 and G themselves: as simulated, calibrated
    and corrected, the last two run again.
    """
    made = f.apply(effect=f.best_effect)
    make: Callable[[rt.Room], Any] = lambda room: world.simulator(1, room)  # noqa: E731
    fitted = recalibrate(made.model.case, f.discrepancy)  # type: ignore[union-attr]
    alpha = np.array(made.room.alpha)
    alpha[: len(fitted.room.alpha)] = fitted.room.alpha[: len(alpha)]
    second = made.simulator(make).simulate(alpha, seed=3)
    conf, calibrated = f.case.configurations[0], plain(f.case)
    both = {p: second.mean(p) for p in conf.measured.values if p in second.values}
    measured = rt.Measurement.from_values(F, **both)
    again = Case(room=f.case.room, configurations=[Configuration(name="x", measured=measured)])
    seen, simulated = observe(f.case)[0], observe(again)[0].features
    left = np.array([calibrated.features[0], simulated[0]]) - seen.features[0]
    jnd = np.array([np.log(1.05)] * 3 + [1.0, 1.0])[:, None]
    program = world.simulator(1, f.case.room).simulate(calibrated.room.alpha, seed=3)
    values = []
    for run in (conf.simulated.simulated, program, second):  # type: ignore[union-attr]
        off = [
            (run.mean(p) - conf.measured.mean(p)) / (0.05 * conf.measured.mean(p) if t else 1.0)
            for p, t in (("edt", True), ("t30", True), ("c80", False), ("g", False))
            if p in both and p in run.values
        ]
        values.append(float(np.nanmean(np.abs(off))))
    return [float(np.nanmean(np.abs(g / jnd)[1:])) for g in left], values


def stored() -> list[dict[str, Any]]:
    """Return the rooms that judged the code, as `judge` returned them."""
    return rows_of(STORED)


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Return the rooms of a file of rows, which may be compressed."""
    data = path.read_bytes()
    lines = (gzip.decompress(data) if path.suffix == ".gz" else data).splitlines()
    return [json.loads(line) for line in lines]


def count(rows: Sequence[dict[str, Any]]) -> None:
    """Print the table of the rule."""

    def share(name: str, some: Sequence[Any]) -> None:
        print(f"{name:58} {sum(map(bool, some)):3d} of {len(some)}")

    def group(r: Any) -> str:
        if r["kind"] != "ordinary":
            return "not ordinary"
        return "image sources" if "images" in r["simulators"] else "ordinary, two tracers"

    for side in ("with", "without"):
        print(f"-- {side} the run")
        nothing, some = ([r for r in rows if bool(r["hidden"]) == k] for k in (False, True))
        fails = [r for r in rows if r["kind"] != "ordinary"]
        share("flagged, nothing hidden", [r[side]["verdict"] in FOUND for r in nothing])
        for name in ("ordinary, two tracers", "image sources", "not ordinary"):
            for of, those in (("flagged, nothing hidden", nothing), ("detected", some)):
                flags = [r[side]["verdict"] in FOUND for r in those if group(r) == name]
                share(f"{of}, {name}", flags)
        over = [np.array([r[side]["over"] for r in rs]) for rs in (some, nothing)]
        greater = np.sign(np.subtract.outer(*over)) / 2 + 0.5
        print(f"probability that a room with something exceeds by more: {greater.mean():.2f}")
        share("family right where claimed", [r[side]["right"] for r in rows if r[side]["family"]])
        share("truth in the set where ambiguous",
              [r[side]["in_set"] for r in some if r[side]["verdict"] == "ambiguous"])  # fmt: skip
        share("wrong claims where Eyring fails", [r[side]["right"] is False for r in fails])
    run_again = [r for r in rows if "gap" in r]
    for before, gaps in (
        ("calibrated alone", [r["gap"] for r in run_again]),
        ("as simulated", [(r["values"][0], r["values"][2]) for r in run_again]),
    ):
        then, now = np.reshape(gaps, (-1, 2)).T
        share(f"gap smaller after apply and a second run than {before}", list(now < then))
        if len(now):
            print(f"median ratio of the gap: {np.median(now / then):.2f}")
    for r in rows:
        if "values" in r:
            text = ", ".join(f"{of:.2f}" for of in r["values"])
            print(
                f"room {r['number']}, EDT, T30, C80, G: {text} JND as simulated, calibrated, corrected"
            )


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("find", "count"))
    parser.add_argument("args", nargs="*")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.what == "count":
        count(rows_of(Path(given.args[0])) if given.args else stored())
        return
    done = given.out.read_text().splitlines() if given.out.exists() else []
    numbers = {json.loads(line)["number"] for line in done}
    warnings.simplefilter("ignore")
    for number in range(*map(int, given.args)):
        if number not in numbers:
            text = json.dumps(judge(given.seed, number))
            with given.out.open("a") as file:
                file.write(text + "\n")
            print(text, flush=True)


if __name__ == "__main__":
    main()
