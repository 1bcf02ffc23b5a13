"""The growth of time and memory with materials and configurations: exponents of `find` and `calibrate`.

    python -m benchmarks.growth                  # a few minutes

Each size runs in a process of its own. Memory is the peak of the process less what it has before the
call. An exponent is the slope of a line through the logarithms; it should be at most 1.2.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

MATERIALS = (10, 30, 100, 300)
CONFIGURATIONS = (1, 4, 15, 60)
LARGEST = 1.2


def child(name: str, n_materials: int, n_configurations: int) -> None:
    """Print seconds and MB of one call."""
    import rtcal as rt
    from rtcal.finder import Case, ChangedMaterial, Configuration
    from rtcal.finder.means.engines import ControlRooms
    from rtcal.finder.search import find

    rng = np.random.default_rng(0)
    bands = 250.0 * 2.0 ** np.arange(4)
    alpha = rng.uniform(0.05, 0.3, (n_materials, 4))
    room = rt.Room(
        name="growing",
        volume=300.0,
        materials=[f"material {i}" for i in range(n_materials)],
        areas=np.full(n_materials, 300.0 / n_materials),
        alpha=alpha,
        sigma=np.full((n_materials, 4), 0.05),
        centre_frequencies=bands,
        air=rt.Air(20, 50),
    )
    t20 = 0.9 * rt.Eyring().reverberation_time(room)
    configurations = [
        Configuration(
            name=f"configuration {i}",
            measured=rt.Measurement(
                centre_frequencies=bands,
                values={
                    p: (t20 * (1 + 0.01 * rng.standard_normal(4)))[None] for p in ("t20", "edt")
                },
                uncertainty=dict.fromkeys(("t20", "edt"), 0.02 * t20[None]),
            ),
            changes={}
            if i == 0
            else {"material 0": ChangedMaterial(alpha[0] * 1.1, np.full(4, 0.05))},
        )
        for i in range(n_configurations)
    ]
    case = Case(room=room, configurations=configurations)
    shape = (20, n_configurations, 5, 4)
    scale = np.array([0.02, 0.02, 0.01, 0.4, 0.4])[:, None]
    controls = [
        ControlRooms(engine, scale * rng.standard_normal(shape))
        for engine in ("path tracing", "image sources")
    ]

    def call() -> object:
        if name == "find":
            return find(case, controls=controls)
        if n_configurations == 1:
            return rt.calibrate(room, configurations[0].measured, method="soft")
        rooms = [room.replace(name=c.name) for c in configurations]
        data = [c.measured for c in configurations]
        return rt.calibrate(rt.Configurations(rooms), data, method="soft")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    call()
    taken = time.process_time() - begin
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(taken, grown / 1024)


def measured(name: str, n_materials: int, n_configurations: int) -> tuple[float, float]:
    words = ["--child", name, str(n_materials), str(n_configurations)]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.growth", *words],
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, megabytes = map(float, done.stdout.split())
    return seconds, megabytes


def exponent(sizes: tuple[int, ...], values: list[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(values, 1e-3)), 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=["find", "calibrate"])
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        name, n_materials, n_configurations = given.child
        child(name, int(n_materials), int(n_configurations))
        return
    for name in given.tasks:
        for label, sizes in (("materials", MATERIALS), ("configurations", CONFIGURATIONS)):
            rows = [measured(name, *((n, 1) if label == "materials" else (10, n))) for n in sizes]
            for quantity, unit, values in (
                ("time", "s", [r[0] for r in rows]),
                ("memory", "MB", [r[1] for r in rows]),
            ):
                cells = "  ".join(
                    f"{n}: {v:.2f} {unit}" for n, v in zip(sizes, values, strict=True)
                )
                print(
                    f"{name:10} {quantity:7} by {label:15} exponent {exponent(sizes, values):5.2f} "
                    f"(at most {LARGEST})   {cells}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
