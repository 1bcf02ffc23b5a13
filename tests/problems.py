"""Random calibration problems of one band, of every kind that has tripped a solver."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

KINDS = (
    "inside",
    "near an end",
    "at an end",
    "beyond an end",
    "some sigma 0",
    "one left free",
    "one bound active",
)


@dataclass(frozen=True)
class Problem:
    """mu, sigma, areas (n,), and the target b in m²."""

    kind: str
    mu: np.ndarray
    sigma: np.ndarray
    areas: np.ndarray
    target: float

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the most S'alpha, in floats."""
        still = self.sigma == 0
        return (
            float(self.areas @ np.where(still, self.mu, 0.0)),
            float(self.areas @ np.where(still, self.mu, 1.0)),
        )

    @property
    def well_inside(self) -> bool:
        """Whether b is at least 1e-3 of the range from either end."""
        low, high = self.ends
        return min(self.target - low, high - self.target) >= 1e-3 * (high - low)


def problem(kind: str, n: int, rng: np.random.Generator) -> Problem:
    """Return one problem: areas over a ratio of 1000, sigma over 100."""
    areas = 10 ** rng.uniform(-0.5, 2.5, n)
    sigma = 10 ** rng.uniform(-2.7, -0.7, n)
    mu = rng.uniform(0, 1, n) ** rng.choice([1, 3])
    if kind == "some sigma 0":
        sigma[rng.permutation(n)[: rng.integers(1, n)]] = 0.0
    still = sigma == 0
    low = float(areas @ np.where(still, mu, 0.0))
    high = float(areas @ np.where(still, mu, 1.0))
    side = rng.integers(2)
    near = 10 ** rng.uniform(-9, -3)
    share = {
        "near an end": abs(side - near),
        "at an end": float(side),
        "beyond an end": side + (2 * side - 1) * 10 ** rng.uniform(-8, 0),
    }.get(kind, rng.uniform(0.001, 0.999))
    target = low + share * (high - low)
    if kind == "at an end":
        target = high if side else low
    if kind in ("one left free", "one bound active"):
        # mu - D S sigma² crosses the bound for all but one, or for one.
        mu = rng.uniform(0.02, 0.3, n)
        order = np.sort(mu / (areas * sigma**2))
        place = n - 1 if kind == "one left free" else 1
        d = order[place - 1] + rng.uniform(0.05, 0.95) * (order[place] - order[place - 1])
        target = float(areas @ np.clip(mu - d * areas * sigma**2, 0, 1))
    return Problem(kind, mu, sigma, areas, target)


def problems(count: int, seed: int = 20250412) -> Iterator[Problem]:
    """Yield ``count`` problems over all kinds and n = 6, 23, 40, the same for a seed."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        yield problem(KINDS[i % len(KINDS)], (6, 23, 40)[i // len(KINDS) % 3], rng)
