"""The paper's Figs. 6 and 7 anew: `python benchmarks/sdn_over_absorption.py`.

A scattering delay network of a 5 x 7 x 3 m room of uniform alpha, no air, calibrated through Sabine's
equation to that equation's own T; T20 averaged over several positions of source and receiver. Printed
by alpha: error of T20 in % before a correction, after one and after two with the paper's rule, and
with the safeguarded rule the error and its corrections. Every alpha is a "band" of one network, so
that all are simulated at once.
"""

from __future__ import annotations

import argparse

import numpy as np

import rtcal as rt
from rtcal.closed_loop import calibrate_simulator
from rtcal.simulators.sdn import ScatteringDelayNetwork

ALPHAS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
SIDES = (5.0, 7.0, 3.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--positions", type=int, default=4)
    parser.add_argument("--rate", type=float, default=16000.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    low, high = np.full(3, 0.7), np.array(SIDES) - 0.7
    # The paper's position first, then random ones.
    sources = {"S1": (4.5, 3.5, 2.0)}
    receivers = {"R1": (2.0, 2.0, 1.5)}
    for i in range(1, arguments.positions):
        receivers[f"R{i + 1}"] = tuple(rng.uniform(low, high))
    room = rt.Room(
        name="shoebox", volume=float(np.prod(SIDES)), materials=["wall"], areas=[142.0],
        alpha=ALPHAS[np.newaxis], sigma=np.full((1, len(ALPHAS)), 0.1),
        centre_frequencies=np.array([31.5, 63, 125, 250, 500, 1000, 2000, 4000, 8000, 16000]),
        dimensions=SIDES,
    )  # fmt: skip
    wanted = rt.Sabine().reverberation_time(room)
    measured = rt.Measurement.from_values(room.centre_frequencies, t20=wanted)
    network = ScatteringDelayNetwork(
        room=room, sources=sources, receivers=receivers, sampling_rate=arguments.rate
    )
    runs = {
        rule: calibrate_simulator(
            network, room, measured, rule, method="lse", equation=rt.Sabine(), max_simulations=7,
            tolerance=tolerance,
        ).loop.steps
        for rule, tolerance in (("secant", 1e-6), ("safeguarded", 1.0))
    }  # fmt: skip
    print(f"{arguments.positions} positions; error of T20 in %")
    print("alpha  uncorrected  one  two   safeguarded  corrections")
    for k, alpha in enumerate(ALPHAS):
        paper = [100 * (step.simulated[k] / wanted[k] - 1) for step in runs["secant"][:3]]
        own = np.array([100 * (step.simulated[k] / wanted[k] - 1) for step in runs["safeguarded"]])
        within = np.flatnonzero(np.abs(own) <= 5)
        corrections = str(within[0]) if within.size else "not within 1 JND"
        print(f"{alpha:5.2f}  {paper[0]:11.1f}{paper[1]:5.1f}{paper[2]:5.1f}"
              f"{own[np.argmin(np.abs(own))]:14.1f}  {corrections}")  # fmt: skip


if __name__ == "__main__":
    main()
