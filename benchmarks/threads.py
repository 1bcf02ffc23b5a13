"""The cost of BLAS's threads: the default number against one, while other processes use every core.

    python -m benchmarks.threads                 # prints seconds and ratios; a few minutes
    python -m benchmarks.threads --idle          # without the other processes

The child processes take turns, so that both settings see the same machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from statistics import median

VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
TASKS = ("find", "calibrate", "posterior", "study")
LARGEST_RATIO = 1.2


def task(name: str) -> Callable[[], object]:
    """Return what is timed; whatever it needs is ready."""
    import numpy as np

    import rtcal as rt

    if name == "find":
        from rtcal.finder.means.engines import ControlRooms

        case, _ = rt.datasets.hidden_room()
        rng = np.random.default_rng(0)
        shape = (30, len(case.configurations), 5, case.room.n_bands)
        scale = np.array([0.02, 0.02, 0.01, 0.4, 0.4])[:, None]
        controls = [
            ControlRooms(engine, scale * rng.standard_normal(shape))
            for engine in ("path tracing", "image sources")
        ]
        return lambda: rt.find(case, controls=controls)
    room, measured = rt.datasets.bras_cr2()
    if name == "calibrate":
        return lambda: [rt.calibrate(room, measured) for _ in range(20)]
    if name == "posterior":
        result = rt.calibrate(room, measured, method="soft")
        return lambda: [rt.posterior.distribution(result) for _ in range(20)]
    return lambda: rt.studies.run(room.areas, 0.05, 500, 500).scores()


def child(name: str, runs: int) -> None:
    run = task(name)
    run()
    for _ in range(runs):
        begin = time.perf_counter()
        run()
        print(time.perf_counter() - begin, flush=True)


def seconds(name: str, one_thread: bool, runs: int) -> list[float]:
    environment = {k: v for k, v in os.environ.items() if k not in VARIABLES}
    if one_thread:
        environment |= dict.fromkeys(VARIABLES, "1")
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.threads", "--child", name, "--runs", str(runs)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(line) for line in done.stdout.split()]


def spin() -> None:
    while True:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=TASKS)
    parser.add_argument("--idle", action="store_true", help="without other processes")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.child, given.runs)
        return
    load = [
        multiprocessing.Process(target=spin, daemon=True)
        for _ in range(0 if given.idle else os.cpu_count() or 1)
    ]
    for process in load:
        process.start()
    try:
        for name in given.tasks:
            table: dict[bool, list[float]] = {True: [], False: []}
            for _ in range(given.rounds):
                for one_thread in table:
                    table[one_thread] += seconds(name, one_thread, given.runs)
            one, default = median(table[True]), median(table[False])
            print(
                f"{name:10} one thread {one:7.2f} s   default {default:7.2f} s   ratio "
                f"{default / one:5.2f} (at most {LARGEST_RATIO})",
                flush=True,
            )
    finally:
        for process in load:
            process.terminate()


if __name__ == "__main__":
    main()
