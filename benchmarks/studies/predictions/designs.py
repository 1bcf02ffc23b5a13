"""Designs beside exhaustive search: the numbers of benchmarks/studies/predictions/README.md.

    python -m benchmarks.studies.predictions.designs --rooms 40

A problem is a room of 20 to 1000 m³ with a measured T, two or three treatments (most of them whole
panels, some of them free-standing) and a range of T, or a largest T alone. Every number of whole panels
is tried, with a fine search over what may be had in any area. Its probabilities are those of
`rtcal.prediction.predict`, which do not know how the design was found.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

import numpy as np

import rtcal as rt
from rtcal.prediction import Target, Treatment
from rtcal.prediction.designed import DesignModel, design_model
from rtcal.support.types import Array

BANDS = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
ASKED = (0.8, 0.85, 0.9, 0.95)
_SHARES = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0])
"""Of what a cost leaves for a treatment of any area."""


def problem(
    index: int, stream: int = 57
) -> tuple[rt.CalibrationResult, tuple[Treatment, ...], Target, float]:
    """Return a random room's calibration, treatments, a range of T that some areas reach, and p."""
    rng = np.random.default_rng([stream, index])
    volume = float(np.exp(rng.uniform(np.log(20), np.log(1000))))
    x, y, z = volume ** (1 / 3) * np.array([1.5, 1.15, 0.58])
    areas = {"floor": x * y, "ceiling": x * y}
    areas |= {"walls": 1.4 * (x + y) * z, "windows": 0.6 * (x + y) * z}
    level = np.exp(rng.uniform(np.log(0.03), np.log(0.2), (4, 1)))
    slope = rng.uniform(-0.2, 0.3, (4, 1))
    alpha = np.clip(level * np.exp(slope * np.log2(BANDS / 1000)), 0.01, 0.5)
    room = rt.Room(
        name=f"room {index}",
        volume=volume,
        materials=list(areas),
        areas=list(areas.values()),
        alpha=alpha,
        sigma=np.maximum(0.2 * alpha, 0.01),
        air=rt.Air(20, 50),
        centre_frequencies=BANDS,
        volume_sigma=0.03,
        area_sigma=0.03,
    )
    equation = (rt.Eyring(), rt.Sabine())[index % 2]
    t = equation.reverberation_time(room) * np.exp(0.1 * rng.standard_normal())
    measured = rt.Measurement(
        centre_frequencies=BANDS,
        values={"t20": t[np.newaxis]},
        uncertainty={"t20": 0.03 * t[np.newaxis]},
    )
    result = rt.calibrate(room, measured, equation=equation, unreachable="nearest")
    treatments = tuple(_treatments(rng, areas))
    some = np.array([each.largest for each in treatments]) * rng.uniform(0.2, 0.7, len(treatments))
    put = [each.change(area) for each, area in zip(treatments, some.tolist(), strict=True)]
    middle = result.predict(put).mean
    wide = rng.uniform(0.12, 0.4)
    low = middle / (1 + wide) if rng.random() < 0.5 else np.full(6, np.nan)
    return result, treatments, Target(low, middle * (1 + wide)), float(rng.choice(ASKED))


def _treatments(rng: np.random.Generator, areas: dict[str, float]) -> Iterator[Treatment]:
    """Yield broad panels on the ceiling, bass traps on the walls, and in half of the rooms screens."""
    places = [("ceiling", 0.8, np.ones(6)), ("walls", 0.4, np.linspace(1.2, 0.3, 6))]
    if rng.random() < 0.5:
        places.append(("", 0.3, np.linspace(0.7, 1.0, 6)))
    for place, share, form in places:
        material = rt.Material(
            f"for {place or 'the room'}", rng.uniform(0.3, 0.75, 6) * form, [0.05] * 6
        )
        largest = share * areas.get(place, areas["floor"])
        unit = largest / rng.uniform(3, 9) if rng.random() < 0.7 else None
        cost = float(rng.uniform(30, 150))
        yield Treatment(material.name, material, largest, cost, place or None, unit)


def exhaustive(
    model: DesignModel, promised: float, below: float = np.inf
) -> tuple[float, Array | None]:
    """Return the least cost below a given one that keeps the promise, and its areas; None if none do.

    Every number of whole panels is tried; of a treatment of any area, what the cost leaves for it, and
    shares of that.
    """
    best, bounded = None, model.target.bounded
    panels = [
        np.array([np.nan]) if t.unit is None else np.arange(t.largest // t.unit + 1) * t.unit
        for t in model.treatments
    ]
    for counted in itertools.product(*panels):
        for x in _filled(model, np.array(counted), below):
            cost = float(model.prices @ x)
            if cost < below and (model.probability(x)[bounded] >= promised).all():
                below, best = cost, x
    return below, best


def _filled(model: DesignModel, x: Array, most: float) -> Iterator[Array]:
    """Yield areas whose free ones, NaN in ``x``, are shares of what a cost leaves for them."""
    left = most - float(model.prices @ np.nan_to_num(x))
    if left <= 0:
        return
    free = np.flatnonzero(np.isnan(x))
    if not len(free):
        yield x
        return
    j = int(free[0])
    largest = min(model.treatments[j].largest, left * (1 - 1e-9) / model.prices[j])
    for area in (_SHARES * largest).tolist():
        yield from _filled(model, np.where(np.arange(len(x)) == j, area, x), most)


def judged(rooms: int, stream: int) -> None:
    """Print how designs compare with exhaustive search."""
    ratios, lacking, seconds, none, falsely, parts = [], [], [], 0, 0, 0
    for index in range(rooms):
        result, treatments, target, p = problem(index, stream)
        began = time.process_time()
        try:
            found = rt.design(result, treatments, target, p)
        except rt.errors.InfeasibleError:
            none += 1
            model = design_model(result, treatments, target)
            falsely += exhaustive(model, p)[1] is not None
            continue
        seconds.append(time.process_time() - began)
        turned = rt.design(result, treatments[::-1], target, p)
        if not np.allclose(turned.areas[::-1], found.areas, atol=1e-9):
            print(f"room {index}: {found.areas}, in another order {turned.areas[::-1]}")
        for t, area in zip(treatments, found.areas.tolist(), strict=True):
            parts += t.unit is not None and abs(area / t.unit - round(area / t.unit)) > 1e-9
        lacking.append(float((found.probability - p)[target.bounded].min()))
        best = exhaustive(found.model, p, found.cost)[0]
        ratios.append(found.cost / best if found.cost else 1.0)
        print(
            f"room {index}: {found.cost:.0f}, over exhaustive search {ratios[-1]:.4f}", flush=True
        )
    print(f"{rooms} rooms: {len(ratios)} with a design, {none} without, {falsely} of these falsely")
    print(f"parts of panels {parts}; probability less the promised at least {min(lacking):+.5f}")
    print(
        f"cost over that of exhaustive search: {np.median(ratios):.4f}, at most {max(ratios):.4f}; "
        f"a design takes {np.median(seconds):.2f} s of processor time, at most {max(seconds):.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=40)
    parser.add_argument("--stream", type=int, default=57)
    stated = parser.parse_args()
    judged(stated.rooms, stated.stream)


if __name__ == "__main__":
    main()
