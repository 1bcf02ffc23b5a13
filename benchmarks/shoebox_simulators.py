"""The shoebox simulators' speed, in one run: `python benchmarks/shoebox_simulators.py`.

Scattering delay network at 44.1 kHz: seconds of response per second of computing, one band and eight.
Image sources: counting (which images, how many hits on each wall) against weighting the counted ones
for a new alpha.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import numpy as np

import rtcal as rt
from rtcal.simulators.image_source import ImageSource
from rtcal.simulators.sdn import ScatteringDelayNetwork

SIDES = (5.0, 7.0, 3.0)
POINTS = {"sources": {"S": (4.5, 3.5, 2.0)}, "receivers": {"R": (2.0, 2.0, 1.5)}}
LIMITS = {1: 60, 8: 20}  # from the issue: times real time, by bands
REPEATS = 7


def room(n_bands: int) -> rt.Room:
    centres = (63, 125, 250, 500, 1000, 2000, 4000, 8000)
    return rt.Room(
        name="shoebox", volume=float(np.prod(SIDES)), materials=["wall"], areas=[142.0],
        alpha=np.full((1, n_bands), 0.2), sigma=np.full((1, n_bands), 0.1),
        centre_frequencies=np.array(centres[-n_bands:], dtype=float), dimensions=SIDES, air=rt.Air(),
    )  # fmt: skip


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    duration = 1.0
    for n_bands, limit in LIMITS.items():
        network = ScatteringDelayNetwork(room=room(n_bands), sampling_rate=44100.0, **POINTS)
        alpha = room(n_bands).alpha
        network.impulse_responses(alpha, duration)  # compiles
        took = median(
            seconds(lambda n=network, a=alpha: n.impulse_responses(a, duration))
            for _ in range(REPEATS)
        )
        print(f"network, {n_bands} bands: {duration / took:.0f} times real time (at least {limit})")
    for n_bands in LIMITS:
        alpha = room(n_bands).alpha

        def made(n_bands: int = n_bands) -> ImageSource:
            return ImageSource(room=room(n_bands), duration=0.5, **POINTS)

        images = made()
        images.energy(alpha)  # compiles
        count, weigh = [], []
        for _ in range(REPEATS):
            count.append(seconds(made))
            weigh.append(seconds(lambda i=images, a=alpha: i.energy(a)))
        ratio = median(count) / median(weigh)
        print(f"image sources, {n_bands} bands, .5 s: counting {1e3 * median(count):.1f} ms, "
              f"weighting {1e3 * median(weigh):.1f} ms, ratio {ratio:.0f} (asked for: 50)")  # fmt: skip


if __name__ == "__main__":
    main()
