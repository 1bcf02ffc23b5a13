"""What does a second configuration tell? `python notebooks/studies/configurations.py [--quick]`.

A room with 5 m² of an uncertain curtain (sigma .1) and walls known to .02. In the second
configuration the curtain is replaced by a panel known to .01. RMSE of the curtain's alpha from the
first configuration alone, and from both with the joint preset's terms, at 0, 2 and 5 % noise in T;
for comparison both matched exactly, which amplifies the noise.
"""

from __future__ import annotations

import argparse

import numpy as np

import rtcal as rt
from rtcal import terms
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.presets import preset

WALLS = 4
FREQUENCY = [1000]
NOISES = (0.0, 0.02, 0.05)


def drawn(
    rng: np.random.Generator, area: float
) -> tuple[tuple[rt.Room, rt.Room], dict[str, float]]:
    """The two configurations, and every material's true coefficient."""
    names = [f"wall {i}" for i in range(WALLS)]
    areas = rng.uniform(10, 40, WALLS)
    mu = dict(zip(names, rng.uniform(0.1, 0.4, WALLS), strict=True))
    mu |= {"curtain": 0.5, "panel": 0.2}
    sigma = dict.fromkeys(names, 0.02) | {"curtain": 0.1, "panel": 0.01}
    truth = {m: float(np.clip(mu[m] + sigma[m] * rng.standard_normal(), 0, 1)) for m in mu}
    rooms = []
    for name, last in (("curtain", "curtain"), ("panel", "panel")):
        used = [*names, last]
        rooms.append(rt.Room(
            name=name, volume=100, materials=used, areas=[*areas, area],
            alpha=[[mu[m]] for m in used], sigma=[[sigma[m]] for m in used],
            centre_frequencies=FREQUENCY, air=rt.Air(),
        ))  # fmt: skip
    return (rooms[0], rooms[1]), truth


def errors(rooms: int, noise: float, area: float = 5.0, seed: int = 0) -> np.ndarray:
    """Return the error of the curtain's alpha, (rooms, 3): one, joint, two matched exactly."""
    rng = np.random.default_rng(seed)
    out = np.empty((rooms, 3))
    problems = None
    for i in range(rooms):
        pair, truth = drawn(rng, area)
        both = Configurations(pair)
        if problems is None:
            problems = (
                preset("soft").build(pair[0]),
                preset("joint").build(both),
                rt.Calibration(terms.PriorDeviation()).build(both),
            )
        measured = []
        for room in pair:
            t = rt.Eyring().time(room, np.atleast_1d(
                sum(a * truth[m] for m, a in zip(room.materials, room.areas, strict=True))
            ))  # fmt: skip
            t = t * (1 + noise * rng.standard_normal(1))
            measured.append(rt.Measurement(
                centre_frequencies=np.array(FREQUENCY), values={"t20": t[np.newaxis]},
                uncertainty={"t20": (noise or 1e-5) * t[np.newaxis]},
            ))  # fmt: skip
        found = [
            problems[0].solve(measured[0], pair[0]).alpha[WALLS, 0],
            problems[1].solve(measured, both).alpha[WALLS, 0],
        ]
        try:
            exact = problems[2].solve(measured, both, unreachable="nearest").alpha[WALLS, 0]
        except rt.errors.InfeasibleError:  # the noise asks for more than the box allows
            exact = np.nan
        out[i] = np.array([*found, exact]) - truth["curtain"]
    return out


def rmse(error: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the RMSE of each estimate, and the standard error of joint minus one, paired."""
    squares = error**2
    total = np.nanmean(squares, axis=0)
    n = len(squares)
    left = (np.nansum(squares[:, :2], axis=0) - squares[:, :2]) / (n - 1)
    difference = np.sqrt(left[:, 1]) - np.sqrt(left[:, 0])
    jackknife = (n - 1) * np.mean((difference - difference.mean()) ** 2)
    return np.sqrt(total), float(np.sqrt(jackknife))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="40 rooms in place of 500")
    rooms = 40 if parser.parse_args().quick else 500
    print(f"RMSE of the curtain's alpha (5 m², sigma .1), {rooms} rooms")
    print("noise of T   one    joint  (se of the difference)   both exact   impossible")
    for noise in NOISES:
        error = errors(rooms, noise)
        (one, joint, exact), spread = rmse(error)
        lost = np.mean(np.isnan(error[:, 2]))
        print(f"{noise:8.0%} {one:9.4f} {joint:8.4f}  ({spread:.4f}) {exact:24.4f} {lost:10.0%}")


if __name__ == "__main__":
    main()
