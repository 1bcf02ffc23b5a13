"""A laboratory, mostly a box, whose absorbing panels were turned to their hard side.

The world is that of `benchmarks/studies/hidden_world`: another tracer than any in rtcal. Nothing is
chosen but the room: true coefficients are drawn from the stated prior, and one seed draws all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.studies.hidden_world.populations import (
    BANDS,
    Hidden,
    air,
    draw_alpha,
    known,
    measure,
    plain,
    wall_areas,
)
from benchmarks.studies.hidden_world.tracer import World
from rtcal.finder import Case

SIZE = np.array([8.4, 6.2, 3.6])
MATERIALS = ("concrete", "linoleum", "panels")
PRIOR = np.array(
    [
        [0.02, 0.03, 0.03, 0.04, 0.05, 0.06, 0.07],
        [0.02, 0.03, 0.03, 0.03, 0.04, 0.04, 0.05],
        [0.20, 0.45, 0.75, 0.80, 0.80, 0.75, 0.70],
    ]
)
# Shares of the materials on the walls x0, x1, y0, y1, the floor and the ceiling.
WHERE = np.array(
    [[0.6, 0, 0.4], [0.6, 0, 0.4], [0.55, 0, 0.45], [0.65, 0, 0.35], [0, 1, 0], [0.6, 0, 0.4]]
)


def laboratory(turned: float = 0.9, seed: int = 1, *, turned_back: bool = False) -> Case:
    """Return the case in which a share of the panels is turned, and the model knows of none.

    With ``turned_back`` it was measured once more as the model has it.
    """
    rng = np.random.default_rng(seed)
    sigma = known(PRIOR)
    alpha = draw_alpha(rng, PRIOR, sigma)
    real = alpha.copy()
    real[2] = (1 - turned) * alpha[2] + turned * rng.uniform(0.02, 0.1)
    walls = wall_areas(SIZE)
    world = World(
        size=SIZE,
        alpha=WHERE @ real,
        air=air(BANDS, 20.0, 45.0),
        scattering=0.6,
        source=np.array([2.1, 1.7, 1.5]),
        receivers=np.array([[6.6, 4.4, 1.2], [4.5, 5.0, 1.7], [6.9, 1.6, 1.4], [1.6, 4.9, 1.3]]),
    )
    areas, volume = walls @ WHERE, float(np.prod(SIZE))
    hidden = Hidden(world, areas, volume, WHERE, real, PRIOR, sigma)
    sides = walls[:, None] * WHERE
    facing = np.stack([sides[2 * a] + sides[2 * a + 1] for a in range(3)], 1)
    configurations = [{"name": "A", **measure(hidden, world, int(rng.integers(2**31)), rng)}]
    if turned_back:
        world = replace(world, alpha=WHERE @ alpha)
        again = measure(hidden, world, int(rng.integers(2**31)), rng)
        configurations.append({"name": "turned back", "suspect_removed": True, **again})
    return Case.from_dict(
        plain(
            {
                "room": {
                    "name": "laboratory",
                    "volume": volume,
                    "centre_frequencies": BANDS,
                    "material": [
                        {"name": n, "area": area, "alpha": mu, "sigma": s}
                        for n, area, mu, s in zip(MATERIALS, areas, PRIOR, sigma, strict=True)
                    ],
                    "prior": {"band_correlation": 0.7},
                    "air": {"temperature": 20.0, "humidity": 45.0},
                },
                "facing": facing / facing.sum(1, keepdims=True),
                "uncertainty": {"time": 0.02, "level": 0.3},
                "configuration": configurations,
            }
        )
    )
