"""acoustic-spaces beside the calibration to every position.

    python -m benchmarks.studies.fits.positions_peer run

acoustic-spaces 4.0.0 (GPL-3, PyPI) fits T20, EDT and C80 of every pair in JND by weighing its rays
anew. It takes at most 16 materials: of the judging rooms (studies/position_rooms), the first six
boxes and the first six polyhedra that have no more, in the order in which they were built. Both
programs get the same room, the wide prior and scattering 0.4. Its search box is 0.01 to 0.99, and
what it takes for the prior is where it starts: the stated alpha. The processor time includes all
traces, and for every position the control runs. `table` joins the results of `python -m
benchmarks.studies.fits.positions run`.

Run it where acoustic-spaces and rtcal are installed side by side; rtcal does not depend on it.
`python -m benchmarks.studies.fits.positions_peer table` reads what was stored.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.fits.positions import error, rounded
from benchmarks.studies.fits.positions_table import median_ratio, read, share, stored_run
from benchmarks.studies.position_rooms.generate import HERE, order
from benchmarks.studies.position_rooms.load import (
    SCATTERING,
    PositionRoom,
    load,
    stored,
    true_alpha,
)
from benchmarks.studies.position_rooms.parameters import OCTAVES

STORED = HERE / "population_1_peer.jsonl"
FITTED = ("t20", "edt", "c80")
MOST_MATERIALS = 16
RAYS = 5000
"""As in benchmarks/studies/loops/acoustic_spaces_peer.py; its default is more."""


def rooms() -> list[int]:
    """Return the first six boxes, and the first six polyhedra by the limit, as they were built."""
    built = [i for i in order(1) if i in stored(1, "rooms")]
    boxes = [i for i in built if i % 2 == 0][:6]
    small = [i for i in built if i % 2 and load(1, i, "wide").room.n_materials <= MOST_MATERIALS]
    return [i for pair in zip(boxes, small[:6], strict=False) for i in pair]


def obj(case: PositionRoom) -> str:
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


def scene_of(case: Any, folder: str, rays: int, scattering: float) -> tuple[Any, list[str]]:
    """Return the scene of a case in acoustic-spaces, and its materials' names there.

    ``case`` has a room, geometry, sources, receivers and what was measured.
    """
    from acoustic_spaces.scene import Scene

    bands, measured = case.room.centre_frequencies, case.measured
    path = Path(folder, "room.obj")
    path.write_text(obj(case), encoding="utf-8")
    stated = eight(case.room.alpha, bands, edges=True)
    names = [underscored(m) for m in case.room.materials]
    scene = Scene.model_validate(
        {
            "name": "position room",
            "geometry": {"file": str(path), "units": "m", "up_axis": "z"},
            "materials": {
                n: {"absorption": a.tolist(), "scattering": scattering}
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
                "late": {"rays": rays},
                "scattering": {"method": "random", "from_size": False},
            },
        }
    )
    return scene, names


def values_of(room: Any, measured: Any, fitted: tuple[str, ...]) -> dict[tuple[str, str], Any]:
    """Return the measured parameters that are fitted in acoustic-spaces' form, by pair."""
    from acoustic_spaces.parameters import PARAMETERS, RoomParameters

    missing = np.full(len(OCTAVES), np.nan)
    return {
        pair: RoomParameters(
            **{
                p: eight(measured.values[p][i], room.centre_frequencies, edges=False)
                if p in fitted
                else missing
                for p in PARAMETERS
            }
        )
        for i, pair in enumerate(measured.pairs)
    }


def fit_peer(case: PositionRoom, folder: str) -> np.ndarray:
    """Return what acoustic-spaces makes of a room, (n_materials, n_bands)."""
    from acoustic_spaces import calibration

    scene, names = scene_of(case, folder, RAYS, SCATTERING)
    values = values_of(case.room, case.measured, FITTED)
    found = calibration.calibrate(scene, values, names, parameters=FITTED, threads=1)
    return np.asarray(found.absorption[:, np.isin(OCTAVES, case.room.centre_frequencies)])


def fit(index: int) -> dict[str, Any]:
    """Return error and processor time of acoustic-spaces in one room."""
    case, truth = load(1, index, "wide"), true_alpha(1, index, "wide")
    clock = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        alpha = fit_peer(case, folder)
    return {
        "index": index,
        "processor": time.process_time() - clock,
        "error": error(case.room, alpha, truth),
        "prior_error": error(case.room, case.room.alpha, truth),
    }


def table(peer: list[dict[str, Any]], results: list[dict[str, Any]]) -> None:
    """Print both programs' figures in the rooms that both fitted."""
    every = [r for r in results if (r["method"], r["prior"]) == ("positions", "wide")]
    by = {
        name: {r["index"]: r for r in rows}
        for name, rows in (("rtcal", every), ("acoustic-spaces", peer))
    }
    both = [i for i in by["acoustic-spaces"] if i in by["rtcal"]]

    def column(program: str, name: str) -> np.ndarray:
        return np.array([by[program][i][name] for i in both])

    ours, theirs = column("rtcal", "error"), column("acoustic-spaces", "error")
    time_ratio = column("rtcal", "processor"), column("acoustic-spaces", "processor")
    print(f"{len(both)} rooms: {both}")
    value, low, high = share(int((ours < theirs).sum()), len(both))
    print(f"error of alpha lower in {value * len(both):.0f} rooms; share {low:.3f} to {high:.3f}")
    for name, a, b in (
        ("error, every position / acoustic-spaces", ours, theirs),
        ("error, every position / prior", ours, column("rtcal", "prior_error")),
        ("error, acoustic-spaces / prior", theirs, column("rtcal", "prior_error")),
        ("processor time, every position / acoustic-spaces", *time_ratio),
    ):
        value, low, high = median_ratio(a, b)
        print(f"{name:50} median {value:.3f}  {low:.3f} to {high:.3f}, largest {np.max(a / b):.2f}")
    print(f"processor: {time_ratio[0].sum():.0f} s and {time_ratio[1].sum():.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=["run", "table"])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--number", type=int, default=12)
    arguments = parser.parse_args()
    folder = arguments.folder
    target = folder / "peer.jsonl" if folder else STORED
    if arguments.command == "run":
        done = {r["index"] for r in read(target)}
        for index in rooms()[: arguments.number]:
            if index not in done:
                row = rounded(fit(index))
                with target.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
                print(row, flush=True)
    table(read(target), read(folder / "results.jsonl" if folder else stored_run(1, "beside_peer")))


if __name__ == "__main__":
    main()
