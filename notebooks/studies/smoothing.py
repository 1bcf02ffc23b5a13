"""Where does knowing that bands go together help? `python notebooks/studies/smoothing.py [--quick]`.

Six materials, eight octaves. The truth is drawn with a correlation over bands (0.8 an octave) or
without one. Estimates of the same rooms, each with and without the correlation or the smoothness;
the RMSE of alpha with it over that without, and the standard error of that ratio over paired rooms
(jackknife). Below 1 it helps.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

import rtcal as rt
from rtcal import terms
from rtcal.calibration.presets import preset

N, K = 6, 8
BANDS = [63, 125, 250, 500, 1000, 2000, 4000, 8000]
OWN = {f"m{i}": 0.18 * i for i in range(N)}
PRIOR, EXACT = terms.PriorDeviation, [terms.ExactMatch()]


def drawn(
    rng: np.random.Generator, correlation: object, separable: bool
) -> tuple[rt.Room, np.ndarray]:
    """A room well within the box and the truth, drawn from its prior with that correlation."""
    u, v = rng.uniform(0.02, 0.08, N), rng.uniform(0.5, 1.25, K)
    sigma = np.outer(u, v) if separable else rng.uniform(0.01, 0.1, (N, K))
    room = rt.Room(
        name="drawn", volume=200, materials=[f"m{i}" for i in range(N)],
        areas=rng.uniform(5, 60, N), alpha=rng.uniform(0.35, 0.6, (N, K)), sigma=sigma,
        centre_frequencies=BANDS, air=rt.Air(),
    )  # fmt: skip
    octaves = np.abs(np.subtract.outer(np.arange(K), np.arange(K)))
    own = correlation if isinstance(correlation, dict) else dict.fromkeys(OWN, correlation)
    x = [
        np.linalg.cholesky(np.where(octaves == 0, 1.0, r**octaves)) @ rng.standard_normal(K)
        if r else rng.standard_normal(K)
        for r in own.values()
    ]  # fmt: skip
    return room, np.clip(room.alpha + sigma * np.array(x), 0, 1)


def compared(
    rooms: int,
    correlation: object,
    noise: float,
    pair: tuple[Callable[[], rt.Calibration], Callable[[], rt.Calibration]],
    *,
    separable: bool = True,
    missing: int = 0,
    seed: int = 0,
) -> tuple[float, float]:
    """Return RMSE of the second calibration over that of the first, and its standard error."""
    rng = np.random.default_rng(seed)
    squares = np.empty((rooms, 2))
    problems = None
    for i in range(rooms):
        room, truth = drawn(rng, correlation, separable)
        problems = problems or [make().build(room) for make in pair]
        t = rt.Eyring().time(room, room.areas @ truth) * (1 + noise * rng.standard_normal(K))
        t[rng.permutation(K)[:missing]] = np.nan
        measured = rt.Measurement(
            centre_frequencies=np.array(BANDS), values={"t20": t[np.newaxis]},
            uncertainty={"t20": (noise or 1e-4) * t[np.newaxis]},
        )  # fmt: skip
        for j, problem in enumerate(problems):
            alpha = problem.solve(measured, room).alpha
            squares[i, j] = np.mean((alpha - truth) ** 2)
    total = squares.sum(axis=0)
    ratio = np.sqrt(total[1] / total[0])
    left = total - squares
    jackknife = np.sqrt(left[:, 1] / left[:, 0])
    error = np.sqrt((rooms - 1) * np.mean((jackknife - jackknife.mean()) ** 2))
    return float(ratio), float(error)


def exact(**kwargs: object) -> Callable[[], rt.Calibration]:
    return lambda: rt.Calibration(PRIOR(**kwargs), EXACT)


def soft(**kwargs: object) -> Callable[[], rt.Calibration]:
    return lambda: rt.Calibration(PRIOR(**kwargs) + terms.SoftMatch(), [])


def smooth() -> rt.Calibration:
    return preset("smooth")


CASES: dict[str, tuple[object, float, tuple, dict[str, object]]] = {
    "separable sigma, exact (the theorem)": (
        0.8, 0.0, (exact(), exact(band_correlation=0.8)), {}),
    "non-separable sigma, exact": (
        0.8, 0.0, (exact(), exact(band_correlation=0.8)), {"separable": False}),
    "own correlation per material, exact": (
        OWN, 0.0, (exact(), exact(band_correlation=OWN)), {}),
    "soft, 2 % noise": (0.8, 0.02, (soft(), soft(band_correlation=0.8)), {}),
    "soft, 5 % noise": (0.8, 0.05, (soft(), soft(band_correlation=0.8)), {}),
    "soft, 10 % noise": (0.8, 0.10, (soft(), soft(band_correlation=0.8)), {}),
    "soft, 2 % noise, 2 bands without T": (
        0.8, 0.02, (soft(), soft(band_correlation=0.8)), {"missing": 2}),
    "preset smooth, 2 % noise": (0.8, 0.02, (soft(), smooth), {}),
    "preset smooth, 10 % noise": (0.8, 0.10, (soft(), smooth), {}),
    "preset smooth, 10 % noise, 2 without T": (0.8, 0.10, (soft(), smooth), {"missing": 2}),
    # Against the plain method, mle, where the truth is uncorrelated:
    "smooth / mle, uncorrelated, 2 % noise": (0.0, 0.02, (exact(), smooth), {}),
    "smooth / mle, uncorrelated, 5 % noise": (0.0, 0.05, (exact(), smooth), {}),
    "smooth / mle, uncorrelated, 10 % noise": (0.0, 0.10, (exact(), smooth), {}),
    "smooth / soft, uncorrelated, 5 % noise": (0.0, 0.05, (soft(), smooth), {}),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="20 rooms a case in place of 300")
    rooms = 20 if parser.parse_args().quick else 300
    print(f"RMSE of alpha with / without, {rooms} paired rooms each")
    for name, (correlation, noise, pair, options) in CASES.items():
        ratio, error = compared(rooms, correlation, noise, pair, **options)
        print(f"{name:42} {ratio:.4f} ± {error:.4f}")


if __name__ == "__main__":
    main()
