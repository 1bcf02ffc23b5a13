"""What a cluster costs and gives, beside threads of this machine: python -m benchmarks.cluster

Each row is run with two threads and with two workers of a LocalCluster on this machine, in turns, and
the medians are printed with their ratio. On one machine a cluster can only cost: what it costs is to
start, to send and to fetch. The rate of `rtcal study` is in processor time, so that other programs on
the machine do not count. Times of many rooms follow from it on paper: the larger of rooms over rate and
workers, and of what it takes to hand out the tasks, by the last row.
"""

from __future__ import annotations

import argparse
import statistics
import time
import timeit
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from distributed import LocalCluster

import rtcal as rt
from rtcal import studies
from rtcal.finder import control_rooms
from rtcal.loop.measured_pairs import simulated_controls
from rtcal.support.workers import workforce

WORKERS = 2
ON_PAPER = (1, 64, 1000)
"""Workers of a study of 10^10 rooms."""


def study(trials: int, **where: Any) -> None:
    studies.run(studies.paper.SHOEBOX, 0.05, 2000, trials, **where)


def reference_rooms(**where: Any) -> None:
    control_rooms(rt.datasets.hidden_room()[0], **where)


def reference_simulations(**where: Any) -> None:
    hall = rt.datasets.halls.corridor()
    tracer = rt.simulators.PathTracing(
        room=hall.room, geometry=hall.geometry, sources=hall.sources, receivers=hall.receivers
    )
    simulated_controls(tracer, hall.room, ("t20", "edt", "c80"), **where)


def learn(**where: Any) -> None:
    """Learn from rooms whose T differ by 10 %."""
    room, _ = rt.datasets.bras_cr2()
    times, rng = rt.Eyring().reverberation_time(room), np.random.default_rng(1)
    off = np.exp(0.1 * rng.standard_normal((20, len(times))))
    rooms = [rt.calibrate(room.replace(name=f"{n}"), t) for n, t in enumerate(times * off)]
    rt.learn(rooms, **where)


def nothing(job: int) -> int:
    return job


def empty(**where: Any) -> None:
    with workforce(**where) as workers:
        for _ in workers.in_order(nothing, range(1000)):
            pass


ROWS: dict[str, Callable[..., None]] = {
    "study, 2000 x 10,000 rooms": partial(study, 10_000),
    "study, 2000 x 100 rooms": partial(study, 100),
    "find, 38 reference rooms": reference_rooms,
    "fit and find, 16 reference simulations": reference_simulations,
    "learn, 20 rooms": learn,
    "1000 tasks of nothing": empty,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=3)
    times = parser.parse_args().times
    settings = {"threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(n_workers=WORKERS, **settings) as cluster:
        there = {"scheduler": cluster.scheduler_address}
        print(f"{'':40}{'threads / s':>12}{'cluster / s':>12}{'ratio':>7}")
        for name, call in ROWS.items():
            both: list[list[float]] = []
            for turn in range(times + 1):  # the first loads modules and compiled loops
                made = [timeit.timeit(partial(call, **w), number=1) for w in ({}, there)]
                both += [made] if turn else []
            threads, workers = (statistics.median(each) for each in zip(*both, strict=True))
            ratio = statistics.median(b / a for a, b in both)
            print(f"{name:40}{threads:12.2f}{workers:12.2f}{ratio:7.2f}", flush=True)
    began = time.process_time()
    study(10_000, workers=1)
    rate = 2000 * 10_000 / (time.process_time() - began)
    print(f"\nstudy: {rate:.2g} rooms per second of a core")
    tasks = 1e10 / 10_000 / studies.study.PIECE
    print(f"10^10 rooms: handing out {tasks:g} tasks takes {tasks * workers / 1000 / 60:.3g} min")
    for number in ON_PAPER:
        print(f"10^10 rooms, {number} workers: {1e10 / rate / number / 60:.3g} min at least")


if __name__ == "__main__":
    main()
