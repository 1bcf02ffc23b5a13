"""Mixing and time of the posterior's sampler on random rooms whose bands are coupled.

`python benchmarks/studies/calibrations/posterior_sampler.py [--rooms 60]`. Priors and sigmas span
decades, bounds are active, T is up to twice or half its prediction. It fails where fewer than an
eighth of the samples are worth an independent one.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

import rtcal as rt
from rtcal import terms
from rtcal.calibration.posterior.density import CoupledBands
from rtcal.support.sampler import sample
from tests.test_sampler import hard_room

N_SAMPLES = 4000


def density(seed: int) -> tuple[CoupledBands, int]:
    """The posterior of a random room with coupled bands, and how many bounds are active."""
    rng = np.random.default_rng(seed)
    room, t = hard_room(rng, int(rng.integers(3, 8)), int(rng.integers(2, 5)))
    t = t * 10 ** rng.uniform(-0.2, 0.2)
    prior = terms.PriorDeviation(band_correlation=float(rng.uniform(0.3, 0.95)))
    calibration = rt.Calibration(prior, [terms.ExactMatch()])
    if seed % 3 == 1:
        calibration = rt.Calibration(prior + terms.SoftMatch(10 ** rng.uniform(-4, -1)), [])
    if seed % 3 == 2:
        objective = prior + terms.SoftMatch(0.02) + terms.BandSmoothness()
        calibration = rt.Calibration(objective, [terms.AtMost("m0", "m1")])
    result = calibration.build(room).solve(t, unreachable="nearest")
    bands = result.density()
    if not isinstance(bands, CoupledBands):
        raise TypeError("the bands are independent: nothing is sampled")
    return bands, int(np.count_nonzero(result.active))


def main() -> int:
    """Print the worst and the usual effective sample size and time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=60)
    rooms = parser.parse_args().rooms
    warnings.simplefilter("ignore")
    effective, seconds, unknowns, active = [], [], [], []
    for seed in range(rooms):
        bands, at_bound = density(seed)
        free = bands.posterior.scale > 0
        start = time.process_time()
        drawn = sample(bands.posterior, N_SAMPLES, 0)
        seconds.append(time.process_time() - start)
        effective.append(drawn.effective[free].min())
        unknowns.append(int(free.sum()))
        active.append(at_bound)
    worst, slowest = int(np.argmin(effective)), int(np.argmax(seconds))
    print(f"{rooms} rooms of {min(unknowns)} to {max(unknowns)} unknowns, {N_SAMPLES} samples each")
    print(
        f"effective sample size: median {np.median(effective):.0f}, least {effective[worst]:.0f} "
        f"(seed {worst}, {unknowns[worst]} unknowns, {active[worst]} bounds active)"
    )
    print(
        f"CPU time: median {np.median(seconds):.2f} s, most {seconds[slowest]:.2f} s "
        f"(seed {slowest}, {unknowns[slowest]} unknowns)"
    )
    return int(effective[worst] < N_SAMPLES / 8)


if __name__ == "__main__":
    sys.exit(main())
