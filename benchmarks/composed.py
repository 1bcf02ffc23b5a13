"""Composed problems from 120 to 5,000 unknowns: `python benchmarks/composed.py [--quick]`.

For each size the seconds to build and solve for the first time (cvxpy compiles then), to re-solve
with other data, and the solver's own; the slope of each on log-log axes; and the worst certificate.
The machine's load moves all of them alike: read the slopes and the ratios.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import rtcal as rt
from rtcal import terms
from rtcal.acoustics.bands import third_octaves
from rtcal.calibration.methods import METHODS, preset

THIRDS = third_octaves(50, 10_000)
SIZES = (5, 10, 20, 40, 80, 208)
COMPOSED = {
    "correlated": lambda: rt.Calibration(terms.PriorDeviation(band_correlation=0.5)),
    "ordered": lambda: rt.Calibration(
        terms.PriorDeviation(), [terms.ExactMatch(), terms.AtMost("m0", "m1")]
    ),
}


def room_of(n: int, rng: np.random.Generator) -> tuple[rt.Room, np.ndarray]:
    shape = (n, len(THIRDS))
    room = rt.Room(
        name="bench",
        volume=100.0 * n,
        materials=[f"m{i}" for i in range(n)],
        areas=rng.uniform(5, 60, n),
        alpha=rng.uniform(0.1, 0.6, shape),
        sigma=rng.uniform(0.02, 0.1, shape),
        centre_frequencies=THIRDS,
        air=rt.Air(),
    )
    drawn = room.alpha + room.sigma * rng.standard_normal(shape)
    return room, rt.Eyring().time(room, room.areas @ np.clip(drawn, 0.01, 0.99))


def run(sizes: tuple[int, ...], repeats: int) -> dict[str, list[tuple[float, ...]]]:
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name in [*(m for m in METHODS if m not in ("lse", "joint")), *COMPOSED]:
        for n in sizes:
            rng = np.random.default_rng(n)
            room, t = room_of(n, rng)
            calibration = COMPOSED[name]() if name in COMPOSED else preset(name)
            began = time.perf_counter()
            problem = calibration.build(room)
            result = problem.solve(t)
            first = time.perf_counter() - began
            again, own = [], []
            for i in range(repeats):
                began = time.perf_counter()
                result = problem.solve(t * (1 + 0.01 * (i + 1)))
                again.append(time.perf_counter() - began)
                own.append(result.raw.seconds)
            rows.setdefault(name, []).append(
                (
                    n * len(THIRDS),
                    first,
                    float(np.median(again)),
                    float(np.median(own)),
                    result.certificate.worst,
                    float(result.certificate.alpha_error_bound.max()),
                )
            )
    return rows


def slope(sizes: np.ndarray, seconds: np.ndarray) -> float:
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to 480 unknowns")
    quick = parser.parse_args().quick
    rows = run(SIZES[:3] if quick else SIZES, 3)
    print("             unknowns  build + first  re-solve  solver's own   (seconds)")
    for name, found in rows.items():
        for size, first, again, own, worst, bound in found:
            print(
                f"{name:12} {size:8.0f} {first:14.3f} {again:9.3f} {own:13.4f}"
                f"   certificate {worst:.0e}, alpha within {bound:.0e}"
            )
        table = np.array(found)
        slopes = ", ".join(
            f"{what} {slope(table[:, 0], table[:, column]):.2f}"
            for what, column in (("first", 1), ("re-solve", 2), ("solver", 3))
        )
        print(f"{name:12} slopes on log-log axes: {slopes}")


if __name__ == "__main__":
    main()
