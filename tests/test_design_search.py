"""The search for the cheapest amounts beside exhaustive search, with margins that are formulas."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from rtcal.prediction.designed import Choice
from rtcal.support.types import Array
from tests.conftest import also

N_FINE = 400


def problem(seed: int, bent: float = 0.0) -> Choice:
    """Random treatments: panels, pieces of any area, surfaces that two of them share.

    Margins are those of a normal ln T whose mean falls with what absorbs, for a largest T alone or a
    range, and whose variance grows with the area. With ``bent`` the sd grows as area ** (1 - bent): the
    areas that keep the margins are then no convex set.
    """
    rng = np.random.default_rng([57, 4, seed])
    n, n_bands = int(rng.integers(1, 4)), 4
    largest = rng.uniform(5, 40, n)
    panels = rng.random(n) < 0.7
    unit = np.where(panels, largest / rng.uniform(2, 9, n), np.nan)
    covers = np.zeros((1, n)) + (rng.random(n) < 0.5)
    surfaces = np.array([largest.max() * rng.uniform(0.9, 1.5)])
    base = rng.uniform(8, 20, n_bands)
    gains = rng.uniform(0.1, 0.9, (n_bands, n))
    sds = rng.uniform(0.02, 0.12, (n_bands, n))
    some = largest * rng.uniform(0.2, 0.7, n)
    middle = np.log1p(gains @ some / base)
    wide = rng.uniform(0.15, 0.4)
    one_sided = rng.random() < 0.5

    def margins(x: Array) -> Array:
        fallen = np.log1p(gains @ x / base)
        sd = np.sqrt((sds**2) @ (x**2)) / base + 1e-3
        sd = sd ** (1 - bent) * 0.05**bent
        high = (fallen - middle + wide) / sd
        low = np.full(n_bands, np.inf) if one_sided else (middle + wide - fallen) / sd
        return np.asarray(np.minimum(high, low) - 1.2)

    return Choice(rng.uniform(20, 150, n), largest, unit, covers, surfaces, margins)


def exhaustive(choice: Choice, below: float = np.inf) -> Array | None:
    """Return the cheapest of all whole panels, and of a fine grid of the other areas."""
    each = []
    for most, unit, largest in zip(choice.most, choice.unit, choice.largest, strict=True):
        steps = np.arange(most + 1) * unit
        each.append(np.linspace(0, largest, N_FINE + 1) if np.isnan(unit) else steps)
    if sum(np.isnan(choice.unit)) > 1:
        fine = int(N_FINE ** (1 / sum(np.isnan(choice.unit)))) + 1
        each = [
            e if np.isfinite(u) else np.linspace(0, e[-1], fine)
            for e, u in zip(each, choice.unit, strict=True)
        ]
    points = np.array(list(itertools.product(*each)))
    points = points[(points @ choice.covers.T <= choice.surfaces * (1 + 1e-9)).all(axis=1)]
    points = points[points @ choice.cost < below]
    for x in points[np.argsort(points @ choice.cost, kind="stable")]:
        if choice.margins(x).min() >= 0:
            return np.asarray(x)
    return None


@pytest.mark.parametrize("bent", [0.0, 0.5])
@pytest.mark.parametrize("seed", [*range(12), *also(*range(12, 40))])
def test_nothing_is_cheaper_by_one_percent_and_panels_are_whole(seed: int, bent: float) -> None:
    choice = problem(seed, bent)
    found = choice.cheapest()
    if found is None:
        assert exhaustive(choice) is None
        return
    panels = found[choice.whole] / choice.unit[choice.whole]
    assert panels == pytest.approx(np.round(panels), abs=1e-12)
    assert ((found >= 0) & (found <= choice.largest)).all()
    assert (choice.covers @ found <= choice.surfaces * (1 + 1e-9)).all()
    assert choice.margins(found).min() >= -2e-4
    assert exhaustive(choice, 0.99 * float(choice.cost @ found)) is None
