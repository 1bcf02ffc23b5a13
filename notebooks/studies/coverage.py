"""Do 90 % intervals hold the truth in 90 % of rooms? `python notebooks/studies/coverage.py [--quick]`.

Four kinds of rooms, 2,000 each: (1) mu in (2 sigma, 1 - 2 sigma), exact match; (2) mu in (0, 2 sigma)
with no bound active at the optimum; (3) the same with a bound active; (4) as (1) with 5 % noise in T
and the soft match. A room is one band here: with independent priors bands do not speak to each
other, so eight bands are solved at a time. The truth is drawn from the prior, truncated to the box.
The Gaussian interval, alpha ± 1.645 sigma of the linear estimate, is printed beside it.
"""

from __future__ import annotations

import argparse

import numpy as np

import rtcal as rt
from rtcal.calibration.posterior import posterior

KINDS = {
    1: "mu in (2 sigma, 1 - 2 sigma)",
    2: "mu in (0, 2 sigma), no bound active",
    3: "mu in (0, 2 sigma), a bound active",
    4: "as the first, 5 % noise in T",
}
N, K, NOISE = 6, 8, 0.05
BANDS = [63, 125, 250, 500, 1000, 2000, 4000, 8000]


def drawn_room(rng: np.random.Generator, kind: int) -> tuple[rt.Room, np.ndarray]:
    """A room of bands of that kind and the truth, drawn from its prior within the box.

    Where the closed form leaves the box a bound is active: bands are chosen by that.
    """
    areas = rng.uniform(10, 60, N)
    chosen: list[tuple[np.ndarray, ...]] = []
    while len(chosen) < K:
        shape = (N, 200)
        sigma = rng.rayleigh(0.05, shape)
        while (sigma >= 0.25).any():
            sigma = np.where(sigma >= 0.25, rng.rayleigh(0.05, shape), sigma)
        u = rng.uniform(size=shape)
        mu = 2 * sigma * u if kind in (2, 3) else 2 * sigma + (1 - 4 * sigma) * u
        truth = mu + sigma * rng.standard_normal(shape)
        while (out := (truth < 0) | (truth > 1)).any():
            truth = np.where(out, mu + sigma * rng.standard_normal(shape), truth)
        estimate = rt.closed_form.maximum_likelihood(mu, sigma, areas, areas @ truth)
        active = ((estimate < 0) | (estimate > 1)).any(axis=0)
        wanted = active if kind == 3 else ~active if kind == 2 else np.ones(200, dtype=bool)
        chosen += [(mu[:, k], sigma[:, k], truth[:, k]) for k in np.flatnonzero(wanted)]
    mu, sigma, truth = (np.stack(part, axis=1) for part in zip(*chosen[:K], strict=True))
    room = rt.Room(
        name="drawn", volume=200, materials=[f"m{i}" for i in range(N)], areas=areas, alpha=mu,
        sigma=sigma, centre_frequencies=BANDS, air=rt.Air(),
    )  # fmt: skip
    return room, truth


def coverage(kind: int, rooms: int, seed: int = 0) -> tuple[float, float, float, int]:
    """Return the share of coefficients within the exact interval and its standard error (over
    rooms), that of the Gaussian interval, and the number of rooms."""
    rng = np.random.default_rng([seed, kind])
    method = "soft" if kind == 4 else "mle"
    inside, gaussian = [], []
    while len(inside) < rooms:
        room, truth = drawn_room(rng, kind)
        t = rt.Eyring().time(room, room.areas @ truth)
        if kind == 4:
            t = t * (1 + NOISE * rng.standard_normal(K))
        result = rt.calibrate(room, t, method=method)
        active = (result.active != 0).any(axis=0)
        if (kind == 3 and not active.all()) or (kind == 2 and active.any()):
            raise RuntimeError("the closed form and the calibration disagree on what is active")
        low, high = posterior(result).interval(0.9)
        inside += ((low <= truth) & (truth <= high)).mean(axis=0).tolist()
        near = np.abs(result.alpha - truth) <= 1.6449 * result.posterior_sigma
        gaussian += near.mean(axis=0).tolist()
    share = np.array(inside[:rooms])
    error = float(share.std(ddof=1) / np.sqrt(rooms))
    return float(share.mean()), error, float(np.mean(gaussian[:rooms])), rooms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="200 rooms each in place of 2,000")
    rooms = 200 if parser.parse_args().quick else 2000
    print(f"coverage of 90 % intervals, {rooms} rooms of {N} coefficients each")
    for kind, what in KINDS.items():
        share, error, gaussian, _ = coverage(kind, rooms)
        print(f"{what:38} exact {share:.1%} ± {error:.1%}   Gaussian {gaussian:.1%}")


if __name__ == "__main__":
    main()
