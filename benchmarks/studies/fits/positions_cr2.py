"""A real room: CR2 of BRAS with its mesh and ten measured pairs, fitted on five, predicted on five.

    python -m benchmarks.studies.fits.positions_cr2 --data DIRECTORY

DIRECTORY holds ``measured.json`` (T20, EDT, C80 and Ts of ten pairs, from the public repository
emmettl/RoomCAD, Validation/bras-cr2; CC BY-SA 4.0) and ``scene9.ac`` (the mesh of BRAS, from
krzysztofarendt/building3d-rs; CC BY-NC-SA, not shipped). Positions: the same publication, RAVEN's
project file of CR2. Each source's five pairs are fitted in turn, the other source's five predicted. No
level was measured. Nobody knows the true alpha: only the gaps at the other source can be judged.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np

import rtcal as rt
from benchmarks.studies.fits.positions import JUDGING_PATHS, PATHS, calibrated
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.measurement import Measurement
from rtcal.loop.positions import precise
from rtcal.simulators import PathTracing, Polyhedron

MATCH = ("t20", "edt", "c80", "ts")
SOURCES = {"LS1": (0.931, -2.547, 0.723), "LS2": (0.119, 2.880, 0.723)}
RECEIVERS = {
    "MP1": (-0.993, 1.426, 1.230),
    "MP2": (0.439, -0.147, 1.230),
    "MP3": (1.361, -0.603, 1.230),
    "MP4": (-1.110, -0.256, 1.230),
    "MP5": (-0.998, -1.409, 1.230),
}
SLIVER = 1e-4
"""Area in m² of triangles left out; the mesh has five that are thinner than its coordinates."""


def mesh(path: Path) -> Polyhedron:
    """Read an AC3D file, y up, as a polyhedron with z up."""
    lines = iter(path.read_text(encoding="utf-8").splitlines())
    names: list[str] = []
    corners: list[list[float]] = []
    faces: list[list[int]] = []
    materials: list[str] = []
    first = 0
    for line in lines:
        word, *values = line.split() or [""]
        if word == "MATERIAL":
            names.append(line.split('"')[1].rsplit("_", 1)[-1])
        elif word == "numvert":
            first = len(corners)
            corners += [[float(x) for x in next(lines).split()] for _ in range(int(values[0]))]
        elif word == "mat":
            material = names[int(values[0])]
        elif word == "refs":
            faces.append([first + int(next(lines).split()[0]) for _ in range(int(values[0]))])
            materials.append(material)
    x, y, z = np.array(corners).T
    vertices = np.column_stack([x, -z, y])
    kept = [i for i, face in enumerate(faces) if area(vertices[face]) > SLIVER]
    return Polyhedron(
        vertices=vertices,
        faces=[faces[i] for i in kept],
        materials=[materials[i] for i in kept],
    )


def area(polygon: np.ndarray) -> float:
    spokes = polygon[1:] - polygon[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(0)) / 2)


def measured_pairs(path: Path, frequencies: np.ndarray, source: str) -> Measurement:
    """Return the five pairs of a source."""
    stored = json.loads(path.read_text(encoding="utf-8"))
    bands = [stored["bandCentres"].index(f) for f in frequencies]
    names = {"t20": "t20", "edt": "edt", "c80": "c80", "ts": "centreTime"}
    pairs = [(source, r) for r in RECEIVERS]
    rows = [stored["pairs"]["-".join(pair)]["parameters"] for pair in pairs]
    return Measurement(
        centre_frequencies=frequencies,
        values={
            p: np.array([[row[k][n] for k in bands] for row in rows]) for p, n in names.items()
        },
        pairs=pairs,
    )


def print_spread(path: Path, frequencies: np.ndarray) -> None:
    """Print how the ten pairs scatter, and how a noise-like response does."""
    both = [measured_pairs(path, frequencies, s).values for s in SOURCES]
    edt, c80 = (np.concatenate([values[p] for values in both]) for p in ("edt", "c80"))
    theory = 1.6 / np.sqrt(0.71 * frequencies * edt.mean(0))
    for name, row in (
        ("sd of EDT over pairs, %", 100 * edt.std(0, ddof=1) / edt.mean(0)),
        ("1.6 / sqrt(B T), %", 100 * theory),
        ("sd of C80 over pairs, dB", c80.std(0, ddof=1)),
    ):
        print(f"{name:26}", *(f"{x:6.2f}" for x in row))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, help="directory of measured.json and scene9.ac")
    folder = parser.parse_args().data
    if folder is None or not all((folder / n).exists() for n in ("measured.json", "scene9.ac")):
        print(
            "skipped: --data has no measured.json and scene9.ac; see the module for where they are"
        )
        return
    warnings.simplefilter("ignore")
    room, _ = rt.datasets.bras_cr2()
    geometry = mesh(folder / "scene9.ac")
    room = room.replace(scattering=np.full(room.alpha.shape, 0.4))
    print(f"CR2: {geometry.volume:.1f} m³, {len(geometry.faces)} faces, {room.n_bands} octaves")
    print_spread(folder / "measured.json", room.centre_frequencies)
    total: dict[str, list[np.ndarray]] = {}
    for fitted, predicted in (("LS1", "LS2"), ("LS2", "LS1")):
        tracer, judge = (
            PathTracing(
                geometry=geometry,
                room=room,
                sources={s: SOURCES[s]},
                receivers=RECEIVERS,
                n_paths=n_paths,
            )
            for s, n_paths in ((fitted, PATHS), (predicted, JUDGING_PATHS))
        )
        data, other = (
            measured_pairs(folder / "measured.json", room.centre_frequencies, s)
            for s in (fitted, predicted)
        )
        alphas = {"stated": room.alpha}
        clock = time.process_time()
        alphas["T20 alone"] = rt.calibrate_simulator(precise(tracer), room, data).alpha
        print(f"T20 alone, fitted on {fitted}: {time.process_time() - clock:.0f} s of processor")
        clock = time.process_time()
        every = rt.calibrate_positions(tracer, room, data, match=MATCH)
        alphas["every position"] = every.alpha
        print(
            f"every position, fitted on {fitted}: {time.process_time() - clock:.0f} s of processor"
        )
        print(every, flush=True)
        for name, alpha in alphas.items():
            heard = calibrated(judge, every) if name == "every position" else judge
            heard = heard.simulate(alpha, seed=100)
            gaps = [
                np.nanmean(np.abs(gap_jnd(heard.values[p], other.values[p], p)), axis=0)
                for p in MATCH
            ]
            total.setdefault(name, []).append(np.array(gaps))
    print(f"\nmean |gap| in JND at the other source's five pairs, both ways\n{'':16}", end="")
    print(*(f"{p.upper():>7}" for p in MATCH), f"{'all':>7}", "  by band, EDT and C80")
    for name, gaps in total.items():
        mean = np.mean(gaps, axis=0)
        print(f"{name:16}", *(f"{g:7.2f}" for g in mean.mean(1)), f"{mean.mean():7.2f}  ", end="")
        print(*(f"{g:.2f}" for g in mean[[1, 2]].mean(0)))
    print("\nalpha, fitted on LS2")
    for name, alpha in alphas.items():
        print(name)
        for material, row in zip(room.materials, alpha, strict=True):
            print(f"  {material:10}", *(f"{a:6.3f}" for a in row))


if __name__ == "__main__":
    main()
