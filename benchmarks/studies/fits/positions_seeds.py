"""The move of a calibration to every position by another seed, beside the sigma that it states.

    python -m benchmarks.studies.fits.positions_seeds

The lecture hall that ships, with coefficients drawn from a prior of 30 %. What was measured is traced
with another scattering and 32,000 paths.
"""

from __future__ import annotations

import numpy as np

import rtcal as rt
from rtcal.datasets import halls
from rtcal.loop.control_runs import simulated_controls
from rtcal.simulators import PathTracing
from rtcal.support.types import Array

MATCH = ("t20", "edt", "c80", "ts", "level")
SEEDS = 5
CASES = ((1200, True), (1200, False), (8000, True))


def tracing(scattering: float, n_paths: int) -> PathTracing:
    hall = halls.lecture_hall()
    return PathTracing(
        geometry=hall.geometry,
        room=hall.room.replace(sigma=0.3 * hall.room.alpha),
        sources=hall.sources,
        receivers=hall.receivers,
        scattering=scattering,
        n_paths=n_paths,
    )


def heard() -> rt.Measurement:
    """Return what another tracing of the hall measures."""
    room = tracing(0.5, 1200).room
    truth = np.clip(np.random.default_rng(100).normal(room.alpha, room.sigma), 0.01, 0.99)
    seen = tracing(0.35, 32000).observe(truth, MATCH, seed=77)
    return rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        pairs=seen.pairs,
        values={("g" if p == "level" else p): seen.natural(p) for p in MATCH},
    )


def ratio(values: list[Array], sigma: list[Array]) -> str:
    """Standard deviation over seeds, over the stated one: the largest and the median."""
    over = np.std(values, axis=0, ddof=1) / np.sqrt(np.mean(np.square(sigma), axis=0))
    return f"{over.max():.2f}, {np.median(over):.2f}"


def main() -> None:
    measured = heard()
    print("| paths | control runs | α: largest, median | scattering: largest, median |")
    print("|---|---|---|---|")
    for n_paths, same in CASES:
        simulator = tracing(0.5, n_paths)
        controls = simulated_controls(tracing(0.5, 1200), simulator.room, MATCH) if same else None
        fits = [
            rt.calibrate_positions(
                simulator, simulator.room, measured, match=MATCH, controls=controls, seed=seed
            )
            for seed in range(SEEDS)
        ]
        scattering = [fit.scattering for fit in fits if fit.scattering is not None]
        alpha = ratio([fit.alpha for fit in fits], [fit.sigma for fit in fits])
        scattered = ratio([s.coefficients for s in scattering], [s.sigma for s in scattering])
        print(f"| {n_paths} | {'the same' if same else 'of each seed'} | {alpha} | {scattered} |")


if __name__ == "__main__":
    main()
