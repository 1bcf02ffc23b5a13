"""A geometric room as rtcal takes it, in which something may be where nobody stated it.

Population 0 and 2 are for development, 1, 3 and 4 for judging; `benchmarks/studies/pairs` describes
the rooms.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from benchmarks.studies import stored as files
from benchmarks.studies.position_rooms.load import PositionRoom, as_measurement
from rtcal.acoustics.measurement import Measurement

SEED = 20261122
EMPTY = "nothing"
ON_A_SURFACE = ("opening", "porous", "curtain", "resonator", "audience", "covered surface")
HIDDEN = (*ON_A_SURFACE, "coupled room", "receiver")
"""What may be hidden. "covered surface": a stated absorber is not there; "receiver": one receiver
stands 0.8 to 2 m from where it is stated."""
HANDBOOK, IN_SITU = "handbook", "in situ"
"""How the coefficients are stated."""


@lru_cache(maxsize=4)
def stored(population: int, part: str) -> dict[int, files.Row]:
    return files.numbered(files.path("geometric_world", population, part))


def truth(population: int, index: int) -> files.Row:
    """Return what is true of a room; "surface" is the number of a face, -1 for none."""
    values: files.Row = stored(population, "truth")[index]["truth"]
    return values


def in_situ(population: int, index: int, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients as a measurement in the room states them, and their sigma.

    The true ones err by independent normal errors of sigma = 0.01 + 0.07 alpha.
    """
    rng = np.random.default_rng([SEED, population, index, 2000])
    drawn = true + (0.01 + 0.07 * true) * rng.standard_normal(true.shape)
    alpha = np.clip(drawn, 0.01, 0.95)
    return alpha, 0.01 + 0.07 * alpha


def load(population: int, index: int, statement: str = HANDBOOK) -> PositionRoom:
    """Return room ``index`` of a population with its coefficients from a handbook or "in situ"."""
    data = stored(population, "rooms")[index]
    alpha, name = np.array(data["stated"]["alpha"]), f"geometric room {population}.{index}"
    sigma = np.maximum(0.3 * alpha, 0.02)
    if statement == IN_SITU:
        name += ", in situ"
        alpha, sigma = in_situ(population, index, np.array(truth(population, index)["alpha"]))
    return PositionRoom.of(name, data, data["stated"]["names"], alpha, sigma)


def without_noise(population: int, index: int) -> Measurement:
    """Return what the true positions hear, without the measurement's noise."""
    bands = stored(population, "rooms")[index]["stated"]["bands"]
    return as_measurement(bands, truth(population, index)["values"])
