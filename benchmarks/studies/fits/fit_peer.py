"""The fit beside acoustic-spaces at fitted and left-out pairs.

    python -m benchmarks.studies.fits.fit_peer run

Five small boxes whose decays another tracer gives (pyroomacoustics, with its own scattering, rays and
seeds): 30 to 150 m³, a material on each wall, two sources and four receivers. Alpha of each wall and
band is drawn, and what is stated differs from it by a factor, in one room by 3 in all walls. Half of
the pairs are fitted, the others are left out. T20, EDT and C80 are matched. Both programs get the same
room and data, start at the stated coefficients, and are asked for the same number of rays from each
source.
A gap is that of each program's own simulation with the coefficients that it returned.

acoustic-spaces (GPL-3, PyPI) is run where it is installed beside rtcal (`peer`); rtcal does not depend
on it. `--first` chooses other rooms: 100 and above were used to develop, 0 to 4 to judge, once.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.position_rooms.parameters import OCTAVES
from rtcal.acoustics.marks import gap_jnd, rms
from rtcal.simulators.geometry import Polyhedron

MATCH = ("t20", "edt", "c80")
RAYS = 3000
BANDS = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
FACTORS = (1.0, 0.5, 1.5, 1 / 3, 1.0)
"""Factor of what is stated, room by room: in the fourth the stated absorption is a third."""
APART = 1.0
"""Least distance in m between two places."""
SCATTERING = 0.2
"""Scattering that both programs are given; the true one is not known to them."""


@dataclass(frozen=True)
class Case:
    """A room, what was measured, and the pairs that are left out."""

    room: rt.Room
    geometry: Polyhedron
    sources: dict[str, np.ndarray]
    receivers: dict[str, np.ndarray]
    measured: rt.Measurement
    left_out: tuple[tuple[str, str], ...]


def drawn(index: int) -> Case:
    """Return a room whose decays pyroomacoustics' tracer gives."""
    rng = np.random.default_rng([57, index])
    size = np.array([rng.uniform(3.5, 7), rng.uniform(3.5, 6), rng.uniform(2.4, 3.6)])
    level = np.exp(rng.normal(np.log(0.15), 0.4, (6, 1)))
    slope = rng.normal(0, 0.2, (6, 1)) * np.linspace(-1, 1, len(BANDS))
    truth = np.clip(level * np.exp(slope + 0.1 * rng.standard_normal((6, len(BANDS)))), 0.02, 0.8)
    stated = truth * np.exp(0.3 * rng.standard_normal((6, 1)))
    stated = np.clip(stated * FACTORS[index % len(FACTORS)], 0.01, 0.9)
    areas = np.array([size[1] * size[2]] * 2 + [size[0] * size[2]] * 2 + [size[0] * size[1]] * 2)
    room = rt.Room(
        name=f"box {index}",
        volume=float(np.prod(size)),
        materials=list(WALLS),
        areas=areas,
        alpha=stated,
        sigma=np.maximum(0.3 * stated, 0.2),
        centre_frequencies=BANDS,
        air=rt.Air(temperature=20, humidity=50),
    )
    geometry = Polyhedron.shoebox(size.tolist(), {w: w for w in WALLS})
    places: dict[str, np.ndarray] = {}
    for name in ("S1", "S2", "R1", "R2", "R3", "R4"):
        place = size * rng.uniform(0.15, 0.85, 3)
        while any(np.linalg.norm(place - of) < APART for of in places.values()):
            place = size * rng.uniform(0.15, 0.85, 3)
        places[name] = place
    sources = {n: p for n, p in places.items() if n[0] == "S"}
    receivers = {n: p for n, p in places.items() if n[0] == "R"}
    other = rt.simulators.RayTracing(
        geometry=geometry,
        room=room.replace(alpha=truth),
        sources=sources,
        receivers=receivers,
        n_rays=20000,
        scattering=float(rng.uniform(0.1, 0.5)),
    )
    simulated = other.simulate(truth, seed=1000 + index)
    measured = rt.Measurement(
        centre_frequencies=BANDS,
        pairs=simulated.pairs,
        values={name: simulated.values[name] for name in MATCH},
    )
    left_out = tuple(p for p in measured.pairs if p[1] in ("R3", "R4"))
    return Case(room, geometry, sources, receivers, measured, left_out)


def gaps(case: Case, of: dict[str, dict[tuple[str, str], np.ndarray]]) -> dict[str, Any]:
    """Return rms gaps in JND at fitted and left-out pairs, by parameter and of all."""
    found: dict[str, Any] = {}
    fitted = [p for p in case.measured.pairs if p not in case.left_out]
    for name, pairs in (("fitted", fitted), ("left out", case.left_out)):
        rows = [case.measured.pairs.index(p) for p in pairs]
        each = {
            p: gap_jnd(np.array([of[p][pair] for pair in pairs]), case.measured.values[p][rows], p)
            for p in MATCH
        }
        found[name] = {p: float(rms(g)) for p, g in each.items()}
        found[name]["all"] = float(rms(np.stack([*each.values()])))
    return found


def fit(case: Case) -> dict[str, Any]:
    """Return the gaps of rtcal at the start and after the fit, and the processor time in s."""
    clock = time.process_time()
    tracer = rt.simulators.PathTracing(
        geometry=case.geometry,
        room=case.room,
        sources=case.sources,
        receivers=case.receivers,
        n_paths=RAYS,
        scattering=SCATTERING,
    )
    result = rt.calibrate_positions(tracer, case.room, case.measured, MATCH, exclude=case.left_out)
    out = {"processor": time.process_time() - clock, "refused": result.refused}
    for name, alpha, by in (("before", case.room.alpha, tracer), ("after", result.alpha, None)):
        simulator = result.weighed if by is None else rt.loop.positions.precise(by)
        heard = simulator.observe(alpha, MATCH)
        of = {p: dict(zip(heard.pairs, heard.natural(p), strict=True)) for p in MATCH}
        out[name] = gaps(case, of)
    return out


def obj(case: Case) -> str:
    """The room as a Wavefront file, a group per surface."""
    geometry = case.geometry
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in geometry.triangles.reshape(-1, 3)]
    for i, face in enumerate(geometry.triangle_faces):
        lines.append(f"g {underscored(geometry.materials[face])}")
        lines.append(f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}")
    return "\n".join(lines) + "\n"


def underscored(material: str) -> str:
    return material.replace(" ", "_")


def eight(values: np.ndarray, bands: np.ndarray, *, edges: bool) -> np.ndarray:
    """Return values of six or eight octaves in eight: the edges repeated, or missing."""
    at = np.clip(np.searchsorted(bands, OCTAVES), 0, len(bands) - 1)
    out = values[..., at]
    return out if edges else np.where(np.isin(OCTAVES, bands), out, np.nan)


def scene_of(case: Case, folder: str) -> tuple[Any, list[str]]:
    """Return the scene of a case in acoustic-spaces, and its materials' names there."""
    from acoustic_spaces.scene import Scene

    bands, measured = case.room.centre_frequencies, case.measured
    path = Path(folder, "room.obj")
    path.write_text(obj(case), encoding="utf-8")
    stated = eight(case.room.alpha, bands, edges=True)
    names = [underscored(m) for m in case.room.materials]
    scene = Scene.model_validate(
        {
            "name": "box",
            "geometry": {"file": str(path), "units": "m", "up_axis": "z"},
            "materials": {
                n: {"absorption": a.tolist(), "scattering": SCATTERING}
                for n, a in zip(names, stated, strict=True)
            },
            "assignments": {n: n for n in names},
            "sources": [{"name": n, "position": p.tolist()} for n, p in case.sources.items()],
            "listeners": [{"name": n, "position": p.tolist()} for n, p in case.receivers.items()],
            "air": {
                "temperature_c": case.room.air.temperature,
                "humidity_percent": case.room.air.humidity,
            },
            "simulation": {
                "seed": 0,
                "ir_length_s": float(max(0.5, 1.1 * np.nanmax(measured.values["t20"]))),
                "early": {"diffraction": "none"},
                "late": {"rays": RAYS},
                "scattering": {"method": "random", "from_size": False},
            },
        }
    )
    return scene, names


def values_of(room: rt.Room, measured: rt.Measurement) -> dict[tuple[str, str], Any]:
    """Return the measured parameters in acoustic-spaces' form, by pair."""
    from acoustic_spaces.parameters import PARAMETERS, RoomParameters

    missing = np.full(len(OCTAVES), np.nan)
    return {
        pair: RoomParameters(
            **{
                p: eight(measured.values[p][i], room.centre_frequencies, edges=False)
                if p in MATCH
                else missing
                for p in PARAMETERS
            }
        )
        for i, pair in enumerate(measured.pairs)
    }


def fit_peer(case: Case) -> dict[str, Any]:
    """Return the same of acoustic-spaces."""
    from acoustic_spaces import calibration
    from acoustic_spaces.engine.simulate import simulate

    fitted = [p for p in case.measured.pairs if p not in case.left_out]
    clock = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        scene, names = scene_of(case, folder)
        values = values_of(case.room, case.measured.select(fitted))
        found = calibration.calibrate(scene, values, names, parameters=MATCH, threads=1)
        out: dict[str, Any] = {"processor": time.process_time() - clock}
        for name, of_scene in (("before", scene), ("after", found.fitted_scene())):
            simulated = simulate(of_scene)
            columns = np.isin([*found.bands_hz], case.room.centre_frequencies)
            of = {
                p: {
                    pair: getattr(simulated[pair].parameters(), p)[columns]
                    for pair in case.measured.pairs
                }
                for p in MATCH
            }
            out[name] = gaps(case, of)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=["run", "peer", "table"])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--number", type=int, default=5)
    parser.add_argument("--stored", type=Path, default=Path(__file__).with_suffix(".jsonl"))
    arguments = parser.parse_args()
    if arguments.command != "table":
        program = "rtcal" if arguments.command == "run" else "acoustic-spaces"
        for i in range(arguments.first, arguments.first + arguments.number):
            row = {"room": f"box {i}", "program": program}
            row |= (fit if program == "rtcal" else fit_peer)(drawn(i))
            with arguments.stored.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    show(arguments.stored)


def show(stored: Path) -> None:
    """Print the gaps of both programs, room by room."""
    rows = [json.loads(line) for line in stored.read_text(encoding="utf-8").splitlines()]
    print(f"{'rms gap / JND':14}{'':17}{'pairs':10}" + "".join(f"{p:>15}" for p in (*MATCH, "all")))
    for row in rows:
        for pairs, after in row["after"].items():
            before = row["before"][pairs]
            cells = [f"{before[p]:.1f} to {after[p]:.1f}" for p in (*MATCH, "all")]
            print(
                f"{row['room']:14}{row['program']:17}{pairs:10}"
                + "".join(f"{c:>15}" for c in cells)
                + f"{row['processor']:8.0f} s"
            )


if __name__ == "__main__":
    main()
