"""Path tracing: times as ratios within one run, memory: `python benchmarks/path_tracing.py`.

8,000 paths in the invented lecture hall of 23 surfaces, followed for 1.5 s, heard by 4 receivers in
7 bands: tracing them, and weighting the traced ones for a new alpha, in turn on one thread, medians.
"Measured" is a whole `simulate` on traced paths, as long as T20 needs them: energies, EDT to Ts, and
the noise by jackknife.
"""

from __future__ import annotations

import argparse
import sys
import timeit
from functools import partial
from statistics import median

import numpy as np

from rtcal.datasets import halls
from rtcal.simulators.path_tracing import PathTracing

SECONDS = 1.5
LIMIT = 20  # promised: re-weighting at least this many times quicker than tracing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--paths", type=int, default=8000)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    hall = halls.lecture_hall()
    rng = np.random.default_rng(0)

    def tracer(workers: int | None) -> PathTracing:
        return PathTracing(
            geometry=hall.geometry,
            room=hall.room,
            sources={"S1": hall.sources["S1"]},
            receivers=hall.receivers,
            n_paths=arguments.paths,
            workers=workers,
        )

    kept, whole = tracer(1), tracer(1)
    kept.energy(hall.room.alpha, SECONDS)  # compiles, traces
    whole.simulate(hall.room.alpha)  # traces as long as T20 asks for
    traced = kept.traced(0, SECONDS)
    times: dict[str, list[float]] = {}
    for _ in range(arguments.repeats):
        alpha = np.clip(hall.room.alpha * rng.uniform(0.8, 1.2, hall.room.alpha.shape), 0, 1)
        for label, call in (
            ("trace, one thread", partial(tracer(1).traced, 0, SECONDS)),
            ("trace, all threads", partial(tracer(None).traced, 0, SECONDS)),
            ("weight for a new alpha", partial(kept.energy, alpha, SECONDS)),
            ("weight, measured with noise", partial(whole.simulate, alpha)),
        ):
            times.setdefault(label, []).append(timeit.timeit(call, number=1))
    middle = {label: median(values) for label, values in times.items()}
    one = middle["trace, one thread"]
    print(
        f"{traced.n_paths} paths, {len(hall.geometry.faces)} surfaces "
        f"({len(hall.geometry.triangles)} triangles), {SECONDS} s, "
        f"{hall.room.n_bands} bands, {len(hall.receivers)} receivers"
    )
    for label, value in middle.items():
        print(f"  {label:30} {1000 * value:9.1f} ms   {one / value:8.2f} times as quick as tracing")
    hits = SECONDS * hall.room.speed_of_sound / traced.free_paths[0]
    heard = sum(len(b.lengths) for source in traced.batches for b in source) / traced.n_paths
    print(
        f"  memory: {traced.nbytes / traced.n_paths:.0f} bytes a path = 2 a hit ({hits:.0f} hits)"
        f" + 10 a time heard ({heard:.1f}) + 8"
    )
    ratio = one / middle["weight for a new alpha"]
    print(
        f"{'ok' if ratio >= LIMIT else 'FAILED'}: weighting is {ratio:.0f} times quicker than "
        f"tracing; at least {LIMIT} are asked for"
    )
    return 0 if ratio >= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
