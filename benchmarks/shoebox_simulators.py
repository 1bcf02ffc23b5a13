"""The shoebox simulators' speed, in one run: `python benchmarks/shoebox_simulators.py`.

Scattering delay network at 44.1 kHz: seconds of response per second of computing, one band and eight.
Image sources: counting (which images, how many hits on each wall) against weighting the counted ones
for a new alpha; and pyroomacoustics' counting of the same images, where it is installed, which every
new alpha would ask for again there. Times are the processor's; the quickest of several runs counts,
since what else the machine does only adds.
"""

from __future__ import annotations

import time
from collections.abc import Callable

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


def seconds(call: Callable[[], object]) -> float:
    """Processor time: what else a shared machine does is not in it. Nothing here has two threads."""
    start = time.process_time()
    call()
    return time.process_time() - start


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
    return seconds(box.image_source_model)


def main() -> None:
    duration = 1.0
    for n_bands, limit in LIMITS.items():
        network = ScatteringDelayNetwork(room=room(n_bands), sampling_rate=44100.0, **POINTS)
        alpha = room(n_bands).alpha
        network.impulse_responses(alpha, duration)  # compiles
        took = min(
            seconds(lambda n=network, a=alpha: n.impulse_responses(a, duration))
            for _ in range(REPEATS)
        )
        print(f"network, {n_bands} bands: {duration / took:.0f} times real time (at least {limit})")
    for n_bands in LIMITS:
        alpha = room(n_bands).alpha

        def made(n_bands: int = n_bands) -> ImageSource:
            return ImageSource(room=room(n_bands), duration=0.5, **POINTS)

        images = made()
        images.decays(alpha)[0]  # compiles
        count, weigh = [], []
        for _ in range(REPEATS):
            count.append(seconds(made))
            weigh += [seconds(lambda i=images, a=alpha: i.decays(a)) for _ in range(REPEATS)]
        ratio = min(count) / min(weigh)
        print(
            f"image sources, {len(images.images[0].bins)} of them, 0.5 s, {n_bands} bands: "
            f"counting {1e3 * min(count):.1f} ms, weighting {1e3 * min(weigh):.2f} ms, "
            f"ratio {ratio:.0f}, {n_bands * ratio:.0f} a band (asked for: 50)"
        )
        if (theirs := pyroomacoustics_seconds(0.5)) is not None:
            print(
                f"  pyroomacoustics counts in {1e3 * theirs:.0f} ms, "
                f"{theirs / min(weigh):.0f} times the weighting of all bands"
            )


if __name__ == "__main__":
    main()
