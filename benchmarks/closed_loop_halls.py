"""Case studies of the closed loop in invented halls: `python benchmarks/closed_loop_halls.py`.

What is calibrated is `PathTracing` with random scattering. What was "measured" comes from another
engine, pyroomacoustics, with vector scattering, half as much scattering again, receivers moved by half
a metre, and coefficients drawn from the prior. Afterwards the calibrated coefficients are confirmed
with four times the paths and another seed, at receivers that the calibration did not see. Printed per
trial: simulations used; the largest gap of T20 over the bands in JND before, after, and at the
held-out receivers; and there the largest gaps of C50 and C80, which were not fitted.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

import rtcal as rt
from rtcal.acoustics.quality import gap_jnd
from rtcal.closed_loop import calibrate_simulator
from rtcal.datasets import halls
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.ray_tracing import RayTracing


@dataclass(frozen=True)
class Case:
    """Paths and rays to trace, and whether sigma is made proportional to alpha."""

    n_paths: int
    n_rays: int
    relative: bool


CASES = {
    "lecture_hall": Case(16000, 6000, relative=False),
    "hard_hall": Case(8000, 3000, relative=True),
    "theatre": Case(8000, 1600, relative=True),
}
RELATIVE_SIGMA = 0.3  # large hard walls would hit alpha = 0 with absolute sigma


def moved(points: dict[str, halls.Point], rng: np.random.Generator) -> dict[str, halls.Point]:
    """Each point half a metre to the side."""
    found = {}
    for name, (x, y, z) in points.items():
        angle = rng.uniform(0, 2 * np.pi)
        found[name] = (x + 0.5 * np.cos(angle), y + 0.5 * np.sin(angle), z)
    return found


def only(measured: rt.Measurement, receivers: dict[str, halls.Point]) -> rt.Measurement:
    """The measurement at some receivers."""
    rows = [i for i, (_, r) in enumerate(measured.pairs) if r in receivers]
    return rt.Measurement(
        centre_frequencies=measured.centre_frequencies,
        values={k: v[rows] for k, v in measured.values.items()},
        pairs=[measured.pairs[i] for i in rows],
    )


def largest(model: rt.Measurement, measured: rt.Measurement, parameter: str) -> float:
    gaps = gap_jnd(model.mean(parameter), measured.mean(parameter), parameter)
    return float(np.abs(gaps).max())


def run(name: str, case: Case, trial: int) -> list[float]:
    rng = np.random.default_rng([2, trial])
    hall = getattr(halls, name)()
    room, sources = hall.room, {"S1": hall.sources["S1"]}
    if case.relative:
        room = room.replace(sigma=RELATIVE_SIGMA * room.alpha)
    truth = np.clip(
        hall.room.alpha + room.sigma * rng.standard_normal((room.n_materials, 1)), 0.01, 0.95
    )
    everywhere = {**hall.receivers, **hall.held_out}
    measured = RayTracing(
        geometry=hall.geometry, room=room, sources=sources, receivers=moved(everywhere, rng),
        n_rays=case.n_rays, scattering=np.minimum(1.5 * room.scattering, 1),
    ).simulate(truth, seed=trial)  # fmt: skip

    def tracer(receivers: dict[str, halls.Point], n_paths: int) -> PathTracing:
        return PathTracing(
            geometry=hall.geometry, room=room, sources=sources, receivers=receivers,
            n_paths=n_paths,
        )  # fmt: skip

    seen, unseen = only(measured, hall.receivers), only(measured, hall.held_out)
    simulator = tracer(dict(hall.receivers), case.n_paths)
    before = simulator.simulate(room.alpha, seed=trial)
    result = calibrate_simulator(simulator, room, seen)
    after = simulator.simulate(result.room.alpha, seed=100 + trial)
    confirmed = tracer(dict(hall.held_out), 4 * case.n_paths).simulate(
        result.room.alpha, seed=200 + trial
    )
    return [
        result.simulations, largest(before, seen, "t20"), largest(after, seen, "t20"),
        largest(confirmed, unseen, "t20"), largest(confirmed, unseen, "c50"),
        largest(confirmed, unseen, "c80"),
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--hall", choices=CASES, action="append")
    arguments = parser.parse_args()
    print(f"{'hall':14}{'trial':>6}{'simulations':>12}{'T before':>10}{'after':>8}{'held out':>10}"
          f"{'C50':>7}{'C80':>7}   largest gap over bands, JND")  # fmt: skip
    for name in arguments.hall or CASES:
        rows = []
        for trial in range(arguments.trials):
            rows.append(run(name, CASES[name], trial))
            print(f"{name:14}{trial:6d}{rows[-1][0]:12.0f}{rows[-1][1]:10.2f}{rows[-1][2]:8.2f}"
                  f"{rows[-1][3]:10.2f}{rows[-1][4]:7.2f}{rows[-1][5]:7.2f}", flush=True)  # fmt: skip
        middle = np.median(rows, axis=0)
        print(f"{name:14}{'median':>6}{middle[0]:12.0f}{middle[1]:10.2f}{middle[2]:8.2f}"
              f"{middle[3]:10.2f}{middle[4]:7.2f}{middle[5]:7.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
