"""Case studies of the closed loop in invented halls.

    python benchmarks/studies/loops/closed_loop_halls.py

What is calibrated is `PathTracing` with random scattering. What was "measured" comes from another
engine, pyroomacoustics, with vector scattering, half as much scattering again, receivers moved by half
a metre, and coefficients drawn from the prior. One simulation is one call of the simulator, all bands,
sources and receivers; that `PathTracing` traces for the first alone and then weighs the same paths
anew is not made use of in the count. Afterwards the calibrated coefficients are confirmed with four
times the paths and another seed, at receivers that the calibration did not see.

Printed per trial: simulations to the end of the loop, without the confirming one; the largest gap of
T20 over the bands in JND with the prior, with the equation's calibration (the first simulation),
after the loop with a fresh seed, and at the held-out receivers; there also the largest gaps of EDT, C50
and C80, which were not fitted; and the largest standard error of the measurement's own T20 in JND.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import rtcal as rt
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.observables import TARGET
from rtcal.datasets import halls
from rtcal.loop.closed import calibrate_simulator
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.ray_tracing import RayTracing


@dataclass(frozen=True)
class Case:
    """Paths and rays to trace per source, how many sources, whether sigma is made relative."""

    n_paths: int
    n_rays: int
    n_sources: int
    relative: bool


CASES = {
    "lecture_hall": Case(128000, 24000, 2, relative=False),
    "hard_hall": Case(16000, 12000, 1, relative=True),
    "theatre": Case(32000, 25600, 2, relative=True),
}
TOLERANCE = 0.5  # JND: the other half is left to the noise of simulator and measurement
RELATIVE_SIGMA = 0.3  # large hard walls would hit alpha = 0 with absolute sigma
COLUMNS = (
    "simulations", "prior", "equation", "after", "held out", "EDT", "C50", "C80", "own noise",
)  # fmt: skip
Points = dict[str, Sequence[float]]


def moved(points: Points, rng: np.random.Generator) -> Points:
    """Each point half a metre to the side."""
    found = {}
    for name, (x, y, z) in points.items():
        angle = rng.uniform(0, 2 * np.pi)
        found[name] = (x + 0.5 * np.cos(angle), y + 0.5 * np.sin(angle), z)
    return found


def only(measured: rt.Measurement, receivers: Points) -> rt.Measurement:
    """The measurement at some receivers."""
    rows = [i for i, (_, r) in enumerate(measured.pairs) if r in receivers]
    return replace(
        measured,
        values={k: v[rows] for k, v in measured.values.items()},
        pairs=[measured.pairs[i] for i in rows],
        uncertainty={k: v[rows] for k, v in measured.uncertainty.items()},
    )


def largest(model: rt.Measurement, measured: rt.Measurement, parameter: str = "t20") -> float:
    gaps = gap_jnd(model.mean(parameter), measured.mean(parameter), parameter)
    return float(np.abs(gaps).max())


@dataclass(frozen=True)
class Trial:
    """Numbers of one trial in the order of `COLUMNS`; what was measured; first and last simulation."""

    numbers: list[float]
    measured: rt.Measurement
    first: rt.Measurement
    after: rt.Measurement


def run(name: str, case: Case, trial: int) -> Trial:
    """Calibrate a hall to what the other engine finds in it with the coefficients of this trial."""
    hall = getattr(halls, name)()
    room = hall.room.replace(sigma=RELATIVE_SIGMA * hall.room.alpha) if case.relative else hall.room
    sources = dict(list(hall.sources.items())[: case.n_sources])
    rng = np.random.default_rng([2, trial])
    off = room.sigma * rng.standard_normal((room.n_materials, 1))
    measured = RayTracing(
        geometry=hall.geometry,
        room=room,
        sources=sources,
        receivers=moved({**hall.receivers, **hall.held_out}, rng),
        n_rays=case.n_rays,
        scattering=np.minimum(1.5 * room.scattering, 1),
    ).simulate(np.clip(room.alpha + off, 0.01, 0.95), seed=trial)

    def tracer(receivers: Points, n_paths: int) -> PathTracing:
        return PathTracing(
            geometry=hall.geometry,
            room=room,
            sources=sources,
            receivers=dict(receivers),
            n_paths=n_paths,
        )

    seen, unseen = only(measured, hall.receivers), only(measured, hall.held_out)
    simulator = tracer(hall.receivers, case.n_paths)
    with_prior = simulator.simulate(room.alpha, seed=trial)
    result = calibrate_simulator(simulator, room, seen, seed=trial, tolerance=TOLERANCE)
    after = simulator.simulate(result.alpha, seed=100 + trial)
    held_out = tracer(hall.held_out, 4 * case.n_paths)
    confirmed = held_out.simulate(result.alpha, seed=200 + trial)
    noise = seen.mean_uncertainty("t20") / seen.mean("t20") / TARGET.jnd
    numbers = [
        float(len(result.steps)),
        *(largest(made, seen) for made in (with_prior, result.before, after)),
        *(largest(confirmed, unseen, p) for p in ("t20", "edt", "c50", "c80")),
        float(noise.max()),
    ]
    return Trial(numbers, seen, result.before, after)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--hall", choices=CASES, action="append")
    arguments = parser.parse_args()

    def show(name: str, trial: str, row: Sequence[float]) -> None:
        cells = "".join(
            f"{v:{len(c) + 2}.{2 * (i > 0)}f}"
            for i, (c, v) in enumerate(zip(COLUMNS, row, strict=True))
        )
        print(f"{name:14}{trial:>7}{cells}", flush=True)

    columns = "".join(f"  {c}" for c in COLUMNS)
    print(f"{'hall':14}{'trial':>7}{columns}   (largest gap over bands, JND)")
    for name in arguments.hall or CASES:
        rows = []
        for trial in range(arguments.trials):
            rows.append(run(name, CASES[name], trial).numbers)
            show(name, str(trial), rows[-1])
        show(name, "median", np.median(rows, axis=0))
        show(name, "worst", np.max(rows, axis=0))


if __name__ == "__main__":
    main()
