"""Search at positions beside a program's run, in rooms in which reality is another simulator.

python -m benchmarks.studies.pairs.beside_a_run find 300 316 --out rows.jsonl
python -m benchmarks.studies.pairs.beside_a_run count          # the stored rows
python -m benchmarks.studies.pairs.beside_a_run count rows.jsonl

README.md says what is drawn. A room is a shoebox with one material per wall. Reality and program are
rtcal's tracer (scattering model "random") and pyroomacoustics' (without G), each once as either.
"""

from __future__ import annotations

import argparse
import gzip
import json
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.acoustics.bands import bandwidth_factor
from rtcal.acoustics.observables import observable
from rtcal.finder.effects import library
from rtcal.finder.positions.search import controls_of, find_by_positions
from rtcal.finder.positions.surfaces import patched
from rtcal.loop.measured_pairs import response_noise
from rtcal.simulators import PathTracing, Polyhedron, RayTracing
from rtcal.simulators.geometry import SHOEBOX_WALLS

F = np.array([250.0, 500.0, 1000.0, 2000.0])
MATCH = ("t20", "edt", "c80", "ts")
SPECTRA = {
    "porous": [0.5, 0.85, 0.95, 0.95],
    "opening": [1.0] * 4,
    "audience": [0.55, 0.7, 0.8, 0.85],
    "panel": [0.35, 0.15, 0.1, 0.08],
}
FOUND = ("named", "family", "ambiguous", "unknown")
STORED = Path(__file__).parent / "beside_a_run.jsonl.gz"


def draw(number: int) -> dict[str, Any]:
    """Return a room as stated, its true coefficients, scattering, positions, and what is hidden."""
    rng = np.random.default_rng([621, number])
    size = (rng.uniform(6, 13), rng.uniform(5, 9), rng.uniform(2.7, 4.5))
    box = Polyhedron.shoebox(size, {wall: wall for wall in SHOEBOX_WALLS})
    names = list(dict.fromkeys(box.materials))
    areas = np.array([box.areas[name] for name in names])
    base = np.exp(rng.uniform(np.log(0.05), np.log(0.3), 6))
    alpha = np.clip(base[:, None] * (F / 500) ** rng.uniform(-0.15, 0.25, (6, 1)), 0.02, 0.9)
    relative = rng.uniform(0.1, 0.3)
    root = np.linalg.cholesky(0.7 ** np.abs(np.subtract.outer(range(4), range(4)))).T
    scattering = float(rng.uniform(0.3, 0.6))
    guess = float(np.clip(scattering * np.exp(0.3 * rng.standard_normal()), 0.05, 0.9))

    def points() -> Any:
        made = np.array(size) * rng.uniform(0.15, 0.85, (6, 3))
        made[:, 2] = rng.uniform(1.1, 1.7, 6)
        return made

    places = points()
    least = 0.2 * np.prod(size) ** (1 / 3)
    while np.linalg.norm(places[:2, None] - places[None, 2:], axis=2).min() < least:
        places = points()
    room = rt.Room(
        name=f"box {number}", volume=box.volume, materials=names, areas=areas, alpha=alpha,
        sigma=relative * alpha, centre_frequencies=F, band_correlation=0.7, air=rt.Air(20, 50),
        dimensions=size, scattering=np.full((6, 4), guess),
        surfaces=[
            rt.Surface(name=n, material=n, area=float(a)) for n, a in zip(names, areas, strict=True)
        ],
    )  # fmt: skip
    truth = [
        np.clip(alpha * (1 + relative * rng.standard_normal((6, 4)) @ root), 0.005, 0.97)
        for _ in range(2)
    ]
    kind = [*SPECTRA][number % 4]
    spectrum = np.array(SPECTRA[kind])
    on = int(rng.integers(6)) if kind != "audience" else names.index("floor")
    wanted = rng.uniform(0.2, 0.6) * (areas @ alpha).mean() / np.abs(spectrum - alpha[on]).max()
    hidden = (kind, names[on], float(min(wanted, 0.85 * areas[on])), spectrum)
    at = {
        "sources": {f"S{i + 1}": tuple(map(float, p)) for i, p in enumerate(places[:2])},
        "receivers": {f"R{i + 1}": tuple(map(float, p)) for i, p in enumerate(places[2:])},
    }
    return {"box": box, "room": room, "at": at, "truth": truth, "hidden": hidden,
            "scattering": (scattering, guess)}  # fmt: skip


def simulated(name: str, of: Any, alpha: Any, seed: int, **at: Any) -> rt.Measurement:
    """Return what one of the two simulators gives at every pair."""
    if name == "pyroomacoustics":
        return RayTracing(room=of, **at, n_rays=8000).simulate(alpha, seed=seed)
    tracer = PathTracing(room=of, **at, n_paths=10_000, scattering_model="random")
    made = tracer.observe(alpha, MATCH, seed=seed)
    values = {p: made.natural(p) for p in MATCH}
    return rt.Measurement(centre_frequencies=F, pairs=made.pairs, values=values)


def with_noise(real: rt.Measurement, rng: Any) -> rt.Measurement:
    """Return values with the noise of one response, and a quarter of what teams differ by in common."""
    times, values = real.mean("t20"), {p: real.values[p].copy() for p in MATCH}
    for k, f in enumerate(F):
        covariance = response_noise(MATCH, float(times[k]), float(bandwidth_factor(F) * f))
        drawn = rng.multivariate_normal(np.zeros(4), covariance, len(real.pairs))
        for j, p in enumerate(MATCH):
            off = drawn[:, j] + 0.25 * observable(p).between_teams(F)[k] * rng.standard_normal()
            values[p][:, k] = values[p][:, k] + off if p == "c80" else values[p][:, k] * np.exp(off)
    return rt.Measurement(centre_frequencies=F, pairs=real.pairs, values=values)


def judge(number: int, folder: Path) -> list[dict[str, Any]]:
    """Return the findings with and without the run, of each simulator as reality."""
    world = draw(number)
    room, box, at, (scattering, guess) = (world[k] for k in ("room", "box", "at", "scattering"))
    kind, wall, size, spectrum = world["hidden"]
    hole = patched(box, [box.materials.index(wall)], size, "hidden", "hidden")
    if hole is None:
        raise ValueError(f"room {number}: the patch does not fit")
    areas = np.append(room.areas, hole.areas["hidden"])
    areas[room.materials.index(wall)] -= hole.areas["hidden"]
    names, rows, rng = ("paths", "pyroomacoustics"), [], np.random.default_rng([622, number])
    tracer = PathTracing(geometry=box, room=room, **at, scattering=guess, n_paths=4800)
    controls = None
    runs = {
        n: simulated(n, room, room.alpha, 11, geometry=box, scattering=guess, **at) for n in names
    }
    for name in names:
        other = names[name == names[0]]
        for i, alpha in enumerate(world["truth"]):
            reality = [("", room, box, alpha, 21 + i)]
            if i == 0:
                every = np.vstack([alpha, spectrum])
                with_it = room.replace(
                    dimensions=None, surfaces=(), materials=[*room.materials, "hidden"],
                    areas=areas, alpha=every, scattering=np.full((7, 4), scattering),
                    sigma=np.vstack([room.sigma, 0.1 * spectrum]),
                )  # fmt: skip
                reality.append((kind, with_it, hole, every, 31))
            for hidden, of, geometry, true, seed in reality:
                given = {"geometry": geometry, "scattering": scattering, **at}
                measured = with_noise(simulated(name, of, true, seed, **given), rng)
                row = {"room": number, "reality": name, "draw": i, "hidden": hidden}
                for key, run in (("with", runs[other]), ("without", None)):
                    case = rt.finder.PositionsCase(
                        simulator=tracer, measured=measured, match=MATCH, simulated=run
                    )
                    controls = controls or controls_of(case, 0, folder)
                    f = find_by_positions(case, library(), controls, folder, 0, ())
                    row[key] = {"verdict": f.verdict, "score": round(f.score, 2)}
                rows.append(row)
    return rows


def count(rows: list[dict[str, Any]]) -> None:
    """Print in how many rooms something was found."""
    for key in ("with", "without"):
        for what, some in (
            ("nothing hidden, flagged", False),
            ("something hidden, detected", True),
        ):
            those = [r[key] for r in rows if bool(r["hidden"]) == some]
            found = sum(r["verdict"] in FOUND for r in those)
            most = max(r["score"] for r in those)
            print(f"{key} the run, {what}: {found} of {len(those)}; largest score {most:.2f}")


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("find", "count"))
    parser.add_argument("args", nargs="*")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    if given.what == "count":
        data = (
            Path(given.args[0]).read_bytes() if given.args else gzip.decompress(STORED.read_bytes())
        )
        count([json.loads(line) for line in data.splitlines()])
        return
    warnings.simplefilter("ignore")
    for number in range(*map(int, given.args)):
        with tempfile.TemporaryDirectory() as folder, given.out.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in judge(number, Path(folder)))


if __name__ == "__main__":
    main()
