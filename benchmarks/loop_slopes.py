"""Slopes in the closed loop, and the effect of its rules' numbers: `python benchmarks/loop_slopes.py`.

The slope is d log(rate) / d log(target) between two calibrations whose targets differ by 10 %, with
Fitzroy's, Arau-Puchades' and Millington's equations as simulators of random shoeboxes. Below, the
simulations that `calibrate_simulator` needs, and the share of bands that converge, for other limits of
the slope (`rules._SLOPES`) and standard deviations in the regression.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np

import rtcal as rt
from rtcal.loop import rules
from rtcal.simulators.equation import EquationSimulator
from rtcal.simulators.geometry import SHOEBOX_WALLS

SIMULATORS = (rt.Fitzroy(), rt.ArauPuchades(), rt.Millington())
LIMITS = ((0.3, 3.0), (0.15, 6.0), (0.6, 1.5), (1e-3, 1e3))
DEVIATIONS = (0.3, 0.15, 0.6)


def shoebox(rng: np.random.Generator) -> rt.Room:
    x, y, z = rng.uniform((4, 4, 2.5), (30, 20, 10))
    names = ["walls", "ends", "floor", "ceiling"]
    materials = dict(zip(SHOEBOX_WALLS, [*["ends"] * 2, *["walls"] * 2, *names[2:]], strict=True))
    areas = (y * z, y * z, x * z, x * z, x * y, x * y)
    return rt.Room.from_surfaces(
        name="random",
        volume=x * y * z,
        surfaces=[
            rt.Surface(name=wall, material=material, area=area, axis="xxyyzz"[i])
            for i, ((wall, material), area) in enumerate(zip(materials.items(), areas, strict=True))
        ],
        materials=[
            rt.Material(name=name, alpha=rng.uniform(0.02, 0.7, 4), sigma=[0.1] * 4)
            for name in names
        ],
        centre_frequencies=[250, 500, 1000, 2000],
    )


def slopes(room: rt.Room, simulator: EquationSimulator) -> np.ndarray:
    t = rt.Eyring().reverberation_time(room)
    targets = [t, 1.1 * t]
    alpha = [rt.calibrate(room, v, unreachable="nearest").alpha for v in targets]
    times = [simulator.simulate(a).mean("t20") for a in alpha]
    return np.log(times[1] / times[0]) / np.log(1.1)


def needed(rooms: list[rt.Room], rule: str, rng: np.random.Generator) -> tuple[float, float]:
    simulations, converged = [], []
    for i, room in enumerate(rooms):
        simulator = EquationSimulator(SIMULATORS[i % len(SIMULATORS)], room)
        measured = rt.Measurement.from_values(
            room.centre_frequencies,
            t20=rt.Eyring().reverberation_time(room) * np.exp(rng.normal(0, 0.2, room.n_bands)),
        )
        result = rt.calibrate_simulator(simulator, room, measured, rule=rule)
        simulations.append(result.simulations)
        converged += [s == "converged" for s in result.status]
    return float(np.mean(simulations)), float(np.mean(converged))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=60)
    count = parser.parse_args().rooms
    warnings.simplefilter("ignore", rt.errors.MissingAirWarning)
    rng = np.random.default_rng(20261122)
    rooms = [shoebox(rng) for _ in range(count)]
    for equation in SIMULATORS:
        values = np.concatenate([slopes(r, EquationSimulator(equation, r)) for r in rooms])
        low, middle, high = np.quantile(values, (0.01, 0.5, 0.99))
        print(f"slope, {equation.name}: 1 % {low:.2f}, median {middle:.2f}, 99 % {high:.2f}")
    limits, deviation = rules._SLOPES, rules._SLOPE_SD
    for rule, name, choices in (
        ("safeguarded", "_SLOPES", LIMITS),
        ("regression", "_SLOPES", LIMITS),
        ("regression", "_SLOPE_SD", DEVIATIONS),
    ):
        for choice in choices:
            setattr(rules, name, choice)
            simulations, converged = needed(rooms, rule, np.random.default_rng(1))
            print(
                f"{rule} with {name} = {choice}: {simulations:.2f} simulations, "
                f"{100 * converged:.1f} % of bands converged"
            )
        rules._SLOPES, rules._SLOPE_SD = limits, deviation


if __name__ == "__main__":
    main()
