"""Rooms whose volume and areas are not as stated: what a calibration gains, and whether it tells.

    python -m benchmarks.studies.calibrations.uncertain_room [--rooms 1000]

Six surfaces (the paper's shoebox) and six bands; sigma and mu are drawn as in the paper's study, alpha
from its truncated normal, the true volume and areas about the stated ones. T follows Sabine's equation
in the true room. The score is 1 - the root of the mean squared error of alpha over that of mu.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from scipy.stats import chi2

import rtcal as rt
from benchmarks.studies.rates import markdown
from rtcal.studies import paper
from rtcal.studies.paper import SHOEBOX
from rtcal.support.types import Array

AREAS, VOLUME = np.array(SHOEBOX), 105.0
BANDS = (125, 250, 500, 1000, 2000, 4000)
STATED = {"volume_sigma": 0.05, "area_sigma": 0.03}
COMMON = {**STATED, "common_alpha_sigma": 0.1}
EXACT = {"volume_sigma": 0.0, "area_sigma": 0.0}
ALARM = 0.05

# Name: sigma_R, what the room is off by, what is stated, handbook's true common factor.
CASES: dict[str, tuple[float, dict[str, float], dict[str, float], float]] = {
    **{f"taken as exact, sigma_R {s:.2f}": (s, STATED, EXACT, 0.0) for s in (0.01, 0.05, 0.1)},
    **{f"stated, sigma_R {s:.2f}": (s, STATED, STATED, 0.0) for s in (0.01, 0.05, 0.1)},
    "stated twice as large": (0.05, STATED, {k: 2 * v for k, v in STATED.items()}, 0.0),
    "stated half as large": (0.05, STATED, {k: v / 2 for k, v in STATED.items()}, 0.0),
    "handbook off by 10 % together, not stated": (0.05, STATED, STATED, 0.1),
    "handbook off by 10 % together, stated": (0.05, STATED, COMMON, 0.1),
    "exact room, nothing stated": (0.05, EXACT, EXACT, 0.0),
    "exact room, stated as uncertain": (0.05, EXACT, STATED, 0.0),
}


def room_of(mu: Array, sigma: Array, stated: dict[str, float]) -> rt.Room:
    return rt.Room(
        name="shoebox",
        volume=VOLUME,
        materials=[f"surface {i}" for i in range(len(AREAS))],
        areas=AREAS,
        alpha=mu,
        sigma=sigma,
        centre_frequencies=BANDS,
        air=rt.Air(),
        **stated,  # type: ignore[arg-type]
    )


def drawn(
    rng: np.random.Generator, sigma_r: float, off: dict[str, float], common: float
) -> tuple[Array, Array, Array, Array]:
    """mu, sigma and the true alpha, (n, k) each, and the measured T in s, (k,)."""
    mu, sigma = paper.realisations(rng, len(BANDS), len(AREAS), sigma_r)
    mu, sigma = mu.T, sigma.T
    centre = np.clip(mu * (1 + common * rng.standard_normal()), 0.005, 0.995)
    z = np.empty((mu.size, 1))
    paper.trials(rng, centre.ravel(), sigma.ravel(), z)
    alpha = centre + sigma * z.reshape(mu.shape)
    true = room_of(alpha, sigma, EXACT).replace(
        volume=VOLUME * (1 + off["volume_sigma"] * rng.standard_normal()),
        areas=AREAS * (1 + off["area_sigma"] * rng.standard_normal(len(AREAS))),
    )
    return mu, sigma, alpha, rt.Sabine().reverberation_time(true)


def judge(name: str, rooms: int, seed: int = 1) -> dict[str, Any]:
    """Score, coverage and share of false alarms of Q over ``rooms`` rooms."""
    sigma_r, off, stated, common = CASES[name]
    rng = np.random.default_rng(seed)
    before, after, inside, alarms = [], [], [], []
    # Draws of large sigma reach the bounds, where no p-value is given; Q has its quantile all the same.
    limit = chi2.ppf(1 - ALARM, len(BANDS))
    for _ in range(rooms):
        mu, sigma, alpha, t = drawn(rng, sigma_r, off, common)
        room = room_of(mu, sigma, stated)
        result = rt.calibrate(room, t, "mle", rt.Sabine(), unreachable="nearest")
        low, high = result.interval  # type: ignore[misc]
        before.append(np.mean((mu - alpha) ** 2))
        after.append(np.mean((result.alpha - alpha) ** 2))
        inside.append(np.mean((low <= alpha) & (alpha <= high)))
        alarms.append(result.plausibility.q > limit)
    ratio = np.mean(after) / np.mean(before)
    score = 1 - np.sqrt(ratio)
    slope = (np.array(after) - ratio * np.array(before)) / np.mean(before)
    return {
        "case": name,
        "rooms": rooms,
        "score": round(float(score), 4),
        "standard_error": round(float(np.std(slope) / (2 * np.sqrt(ratio * rooms))), 4),
        "coverage": round(float(np.mean(inside)), 4),
        "false_alarms": round(float(np.mean(alarms)), 4),
    }


def table(rows: list[dict[str, Any]]) -> str:
    return markdown(
        ("rooms", "score / %", "±", "90 % intervals hold", "Q false alarms at 5 %"),
        *(
            (
                r["case"],
                f"{100 * r['score']:.1f}",
                f"{100 * r['standard_error']:.1f}",
                f"{r['coverage']:.3f}",
                f"{r['false_alarms']:.3f}",
            )
            for r in rows
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=1000)
    rooms = parser.parse_args().rooms
    print(table([judge(name, rooms) for name in CASES]))


if __name__ == "__main__":
    main()
