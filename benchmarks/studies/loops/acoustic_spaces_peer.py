"""acoustic-spaces beside the comparators: `python benchmarks/studies/loops/acoustic_spaces_peer.py`.

acoustic-spaces (GPL-3, PyPI) calibrates the absorption of its own ray tracer, by weighing its rays
anew and tracing again at what it found. It cannot drive another simulator; so here it gets the truths
and tasks of `comparators.py` in its own one: the lecture hall at 1 kHz, "measured" by its own tracer
with the truth and the same seed, calibrated from the prior or from a random point of the search box.
Its search box is 0.01 to 0.99; what it takes for the prior is where it starts. One simulation is one
trace.

Run it where acoustic-spaces and rtcal are installed side by side; rtcal does not depend on it.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path

import acoustic_spaces as peer
import comparators
import numpy as np
from acoustic_spaces import calibration
from acoustic_spaces.calibration import with_absorption
from acoustic_spaces.engine.simulate import simulate
from acoustic_spaces.scene import Scene

BAND = 4  # 1 kHz of its eight octaves from 63 Hz
FITTED = {"T": ("t20",), "P": ("t20", "edt", "c80")}


def obj(geometry: comparators.halls.Polyhedron) -> str:
    """The hall as a Wavefront file, a group a material."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in geometry.triangles.reshape(-1, 3)]
    for i, face in enumerate(geometry.triangle_faces):
        lines.append(f"g {named(geometry.materials[face])}")
        lines.append(f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}")
    return "\n".join(lines) + "\n"


def named(material: str) -> str:
    return material.replace(" ", "_")


def scene(ours: comparators.Scene, rays: int, folder: str) -> Scene:
    """Their scene of our hall: the same materials, places, air and meaning of scattering."""
    path = Path(folder, "hall.obj")
    path.write_text(obj(ours.tracer.geometry), encoding="utf-8")
    room = ours.room
    return Scene.model_validate(
        {
            "name": "lecture hall",
            "geometry": {"file": str(path), "units": "m", "up_axis": "z"},
            "materials": {
                named(m): {"absorption": [float(a)] * 8, "scattering": float(s)}
                for m, a, s in zip(room.materials, ours.prior, room.scattering[:, 0], strict=True)
            },
            "assignments": {named(m): named(m) for m in room.materials},
            "sources": [{"name": n, "position": p} for n, p in ours.tracer.sources.items()],
            "listeners": [{"name": n, "position": p} for n, p in ours.tracer.receivers.items()],
            "air": {"temperature_c": room.air.temperature, "humidity_percent": room.air.humidity},
            "simulation": {
                "seed": 0,
                "ir_length_s": 3.0,
                "early": {"diffraction": "none"},
                "late": {"rays": rays},
                "scattering": {"method": "random", "from_size": False},
            },
        }
    )


def gaps(found: dict, measured: dict, task: str) -> np.ndarray:
    """Return what the task asks to be small, in JND; as in `comparators`."""

    def values(name: str, of: dict) -> np.ndarray:
        return np.array([getattr(p, name)[BAND] for p in of.values()])

    if task == "T":
        ratio = values("t20", found).mean() / values("t20", measured).mean()
        return np.array([(ratio - 1) / comparators.JND[0]])
    parts = [(values(n, found) / values(n, measured) - 1) / 0.05 for n in ("t20", "edt")]
    return np.concatenate([*parts, values("c80", found) - values("c80", measured)])


class Counter:
    """Its tracer, counting the traces until the goal is met; takes the place of its `simulate`."""

    def __init__(self, measured: dict, task: str, materials: list[str]) -> None:
        self.measured, self.task, self.materials = measured, task, materials
        self.calls, self.met, self.alpha = 0, np.inf, np.zeros(len(materials))

    def __call__(self, room: peer.Room, **options: object) -> peer.SimulationResult:
        self.calls += 1
        traced = simulate(room, **options)
        self.alpha = np.array([room.scene.materials[m].absorption[BAND] for m in self.materials])
        found = {p: traced[p].parameters() for p in self.measured}
        if np.abs(gaps(found, self.measured, self.task)).max() <= 1:
            self.met = self.calls
            raise comparators.BudgetSpent
        return traced


def only_band(parameters: peer.RoomParameters) -> peer.RoomParameters:
    """The parameters at 1 kHz; the other bands are left as they are where nothing was measured."""
    kept = np.arange(8) == BAND
    return replace(
        parameters, **{n: np.where(kept, getattr(parameters, n), np.nan) for n in FITTED["P"]}
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--rays", type=int, default=5000)
    parser.add_argument("--paths", type=int, default=2000, help="that the truths are drawn with")
    arguments = parser.parse_args()
    ours = comparators.Scene.of(arguments.paths)
    materials = [named(m) for m in ours.room.materials]
    pairs = [(s, r) for s in ours.tracer.sources for r in ours.tracer.receivers]

    def absorbing(base: Scene, alpha: np.ndarray) -> Scene:
        return with_absorption(base, materials, np.tile(alpha[:, np.newaxis], 8))

    def measure(base: Scene, trial: int) -> tuple[np.ndarray, dict]:
        truth = ours.draw(np.random.default_rng([1, trial]))
        traced = simulate(absorbing(base, truth))
        return truth, {p: traced[p].parameters() for p in pairs}

    print(
        f"acoustic-spaces {peer.__version__}; {arguments.trials} trials, at most "
        f"{arguments.rounds + 1} traces of {arguments.rays} rays each"
    )
    print(f"{'task':5}{'start':8}{'simulations to the goal':26}{'mean |alpha error|'}")
    with tempfile.TemporaryDirectory() as folder:
        base = scene(ours, arguments.rays, folder)
        cases = [measure(base, trial) for trial in range(arguments.trials)]
        for task in ("T", "P"):
            for start in ("prior", "random"):
                needed, errors = [], []
                for trial, (truth, measured) in enumerate(cases):
                    rng = np.random.default_rng([3, trial])
                    x0 = ours.prior if start == "prior" else rng.uniform(ours.lo, ours.hi)
                    calibration.simulate = counter = Counter(measured, task, materials)
                    with contextlib.suppress(comparators.BudgetSpent):
                        calibration.calibrate(
                            absorbing(base, np.clip(x0, ours.lo, ours.hi)),
                            {p: only_band(m) for p, m in measured.items()},
                            materials,
                            parameters=FITTED[task],
                            rounds=arguments.rounds,
                        )
                    needed.append(counter.met)
                    errors.append(np.abs(counter.alpha - truth).mean())
                print(
                    f"{task:5}{start:8}{comparators.shown(needed):26}{np.mean(errors):.4f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
