"""The shoebox simulators' speed, in one run: `python benchmarks/shoebox_simulators.py`.

Scattering delay network at 44.1 kHz: seconds of response per second of computing, one band and eight.
Image sources: counting (which images, how many hits on each wall) against weighting the counted ones
for a new alpha; and pyroomacoustics' counting of the same images, where it is installed, which every
new alpha would ask for again there. Times are the processor's; the quickest of several runs counts,
since what else the machine does only adds.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable
from functools import partial

import numpy as np

import rtcal as rt
from rtcal.simulators.shoebox import ImageSource, ScatteringDelayNetwork

SIDES = (5.0, 7.0, 3.0)
POINTS = {"sources": {"S": (4.5, 3.5, 2.0)}, "receivers": {"R": (2.0, 2.0, 1.5)}}
LIMITS = {1: 60, 8: 20}  # times real time that are promised, by bands
REPEATS = 7


def room(n_bands: int) -> rt.Room:
    centres = (63, 125, 250, 500, 1000, 2000, 4000, 8000)
    return rt.Room(
        name="shoebox",
        volume=float(np.prod(SIDES)),
        materials=["wall"],
        areas=[142.0],
        alpha=np.full((1, n_bands), 0.2),
        sigma=np.full((1, n_bands), 0.1),
        centre_frequencies=np.array(centres[-n_bands:], dtype=float),
        dimensions=SIDES,
        air=rt.Air(),
    )


def quickest(call: Callable[[], object], times: int = REPEATS) -> float:
    """Processor time: what else a shared machine does is not in it. Nothing here has two threads."""
    return min(timeit.repeat(call, timer=time.process_time, number=1, repeat=times))


def pyroomacoustics_seconds(duration: float) -> float | None:
    """Its time to count every image within ``duration`` after the direct sound; None without it."""
    try:
        import pyroomacoustics as pra
    except ImportError:
        return None
    # Hits along a side exceed distance / side by at most 1; summed up by Cauchy-Schwarz.
    reach = 343.0 * duration + np.linalg.norm(SIDES)
    order = int(np.ceil(reach * np.linalg.norm(1 / np.array(SIDES))))
    box = pra.ShoeBox(SIDES, fs=8000, materials=pra.Material(0.2), max_order=order)
    box.add_source(POINTS["sources"]["S"])
    box.add_microphone(POINTS["receivers"]["R"])
    return quickest(box.image_source_model, 1)


def main() -> None:
    duration = 1.0
    for n_bands, limit in LIMITS.items():
        network = ScatteringDelayNetwork(room=room(n_bands), sampling_rate=44100.0, **POINTS)
        render = partial(network.impulse_responses, network.room.alpha, duration)
        render()  # compiles
        took = quickest(render)
        print(f"network, {n_bands} bands: {duration / took:.0f} times real time (at least {limit})")
    for n_bands in LIMITS:
        made = partial(ImageSource, room=room(n_bands), duration=0.5, **POINTS)
        images = made()
        weighting = partial(images.decays, images.room.alpha)
        weighting()[0]  # compiles
        count, weigh = quickest(made), quickest(weighting, REPEATS**2)
        ratio = count / weigh
        print(
            f"image sources, {len(images.images[0].bins)} of them, 0.5 s, {n_bands} bands: "
            f"counting {1e3 * count:.1f} ms, weighting {1e3 * weigh:.2f} ms, "
            f"ratio {ratio:.0f}, {n_bands * ratio:.0f} a band (asked for: 50)"
        )
        if (theirs := pyroomacoustics_seconds(0.5)) is not None:
            print(
                f"  pyroomacoustics counts in {1e3 * theirs:.0f} ms, "
                f"{theirs / weigh:.0f} times the weighting of all bands"
            )


if __name__ == "__main__":
    main()
