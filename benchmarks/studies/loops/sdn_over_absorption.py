"""The paper's Figs. 6 and 7 anew: `python benchmarks/studies/loops/sdn_over_absorption.py`.

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
from rtcal.loop.closed import Rule, calibrate_simulator
from rtcal.simulators.shoebox import ScatteringDelayNetwork
from rtcal.support.errors import DataError

ALPHAS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
SIDES = (5.0, 7.0, 3.0)
RULES: tuple[Rule, ...] = ("secant", "safeguarded")
CENTRES = np.array([31.5, 63, 125, 250, 500, 1000, 2000, 4000, 8000, 16000])


def box(sides: tuple[float, float, float] = SIDES) -> rt.Room:
    """The room, one "band" for each alpha."""
    x, y, z = sides
    return rt.Room(
        name="shoebox",
        volume=x * y * z,
        materials=["wall"],
        areas=[2 * (x * y + y * z + z * x)],
        alpha=ALPHAS[np.newaxis],
        sigma=np.full((1, len(ALPHAS)), 0.1),
        centre_frequencies=CENTRES,
        dimensions=sides,
    )


def errors(rule: Rule, receivers: dict[str, tuple[float, ...]], rate: float) -> np.ndarray:
    """Error of T20 in %, (n_simulations, n_alphas)."""
    room = box()
    wanted = rt.Sabine().reverberation_time(room)
    network = ScatteringDelayNetwork(
        room=room, sources={"S1": (4.5, 3.5, 2.0)}, receivers=receivers, sampling_rate=rate
    )
    result = calibrate_simulator(
        network,
        room,
        rt.Measurement.from_values(CENTRES, t20=wanted),
        rule,
        method="lse",
        equation=rt.Sabine(),
        max_simulations=7,
        tolerance=1e-6 if rule == "secant" else 1.0,
    )
    return np.array([100 * (step.simulated / wanted - 1) for step in result.steps])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--positions", type=int, default=4)
    parser.add_argument("--rate", type=float, default=16000.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--singly", type=int, default=0, help="also single positions, how many")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)

    def position() -> tuple[float, ...]:
        return tuple(rng.uniform(0.7, np.array(SIDES) - 0.7).tolist())

    receivers = {"R1": (2.0, 2.0, 1.5)}  # the paper's, then random ones
    receivers |= {f"R{i + 1}": position() for i in range(1, arguments.positions)}
    paper, own = (errors(rule, receivers, arguments.rate) for rule in RULES)
    print(f"{arguments.positions} positions; error of T20 in %")
    print("alpha  uncorrected    one    two   safeguarded  corrections")
    for alpha, first, best in zip(ALPHAS, paper[:3].T, own.T, strict=True):
        within = np.flatnonzero(np.abs(best) <= 5)
        corrections = str(within[0]) if within.size else "not within 1 JND"
        print(
            f"{alpha:5.2f}  {first[0]:11.1f}{first[1]:7.1f}{first[2]:7.1f}"
            f"{best[np.argmin(np.abs(best))]:14.1f}  {corrections}"
        )
    missed, refused = dict.fromkeys(RULES, 0), 0
    for _ in range(arguments.singly):
        one = {"R": position()}
        for rule in RULES:
            try:
                best = np.abs(errors(rule, one, arguments.rate)).min(axis=0)
                missed[rule] += int(np.count_nonzero(best > 5))
            except DataError:  # the decay has no T20: the direct sound is all of it
                refused += 1
    if refused:
        print(f"{refused} runs at single positions refused: a decay there has no T20")
    for rule, count in missed.items() if arguments.singly else ():
        print(
            f"{rule}: {count} of {arguments.singly * len(ALPHAS)} single positions and alphas "
            "not within 1 JND after 6 corrections"
        )


if __name__ == "__main__":
    main()
