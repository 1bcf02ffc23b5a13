"""A geometric room as rtcal takes it, in which something may be where nobody stated it.

Population 0 and 2 are for development, 1, 3 and 4 for judging; `benchmarks/studies/pairs` describes
the rooms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies import stored as files
from benchmarks.studies.position_rooms.load import (
    RECEIVERS,
    SCATTERING,
    SOURCES,
    PositionRoom,
    as_measurement,
)
from rtcal.acoustics.measurement import Measurement
from rtcal.simulators import Polyhedron

SEED = 20261122
EMPTY = "nothing"
ON_A_SURFACE = ("opening", "porous", "curtain", "resonator", "audience", "covered surface")
HIDDEN = (*ON_A_SURFACE, "coupled room", "receiver")
"""What may be hidden. "covered surface": a stated absorber is not there; "receiver": one receiver
stands 0.8 to 2 m from where it is stated."""
HANDBOOK, IN_SITU = "handbook", "in situ"
"""How the coefficients are stated."""


@dataclass(frozen=True)
class GeometricRoom(PositionRoom):
    """A room as a user knows and measured it. Its scattering is assumed, since none is stated."""

    def without_level(self) -> Measurement:
        """Return the measurement without G."""
        values = {p: v for p, v in self.measured.values.items() if p != "g"}
        return Measurement(
            centre_frequencies=self.measured.centre_frequencies,
            values=values,
            pairs=self.measured.pairs,
        )

    @property
    def distances(self) -> np.ndarray:
        """From source to receiver, by pair, as stated, in m."""
        return np.array(
            [np.linalg.norm(self.sources[s] - self.receivers[r]) for s, r in self.measured.pairs]
        )


@lru_cache(maxsize=4)
def stored(population: int, part: str) -> dict[int, dict[str, Any]]:
    return files.numbered("geometric_world", population, part)


def truth(population: int, index: int) -> dict[str, Any]:
    """Return what is true of a room; "surface" is the number of a face, -1 for none."""
    values: dict[str, Any] = stored(population, "truth")[index]["truth"]
    return values


def in_situ(population: int, index: int, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients as a measurement in the room states them, and their sigma.

    The true ones err by independent normal errors of sigma = 0.01 + 0.07 alpha.
    """
    rng = np.random.default_rng([SEED, population, index, 2000])
    drawn = true + (0.01 + 0.07 * true) * rng.standard_normal(true.shape)
    alpha = np.clip(drawn, 0.01, 0.95)
    return alpha, 0.01 + 0.07 * alpha


def load(population: int, index: int, statement: str = HANDBOOK) -> GeometricRoom:
    """Return room ``index`` of a population with its coefficients from a handbook or "in situ"."""
    data = stored(population, "rooms")[index]
    stated = data["stated"]
    geometry = Polyhedron(
        vertices=np.array(stated["vertices"]),
        faces=stated["faces"],
        materials=stated["materials"],
    )
    alpha, name = np.array(stated["alpha"]), f"geometric room {population}.{index}"
    sigma = np.maximum(0.3 * alpha, 0.02)
    if statement == IN_SITU:
        name += ", in situ"
        alpha, sigma = in_situ(population, index, np.array(truth(population, index)["alpha"]))
    room = rt.Room(
        name=name,
        volume=geometry.volume,
        materials=stated["names"],
        areas=[geometry.areas[m] for m in stated["names"]],
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=stated["bands"],
        air=rt.Air(temperature=stated["air"][0], humidity=stated["air"][1]),
        scattering=np.full(alpha.shape, SCATTERING),
    )
    return GeometricRoom(
        room,
        geometry,
        dict(zip(SOURCES, np.array(stated["sources"]), strict=True)),
        dict(zip(RECEIVERS, np.array(stated["receivers"]), strict=True)),
        as_measurement(stated["bands"], data["measured"]),
    )


def without_noise(population: int, index: int) -> Measurement:
    """Return what the true positions hear, without the measurement's noise."""
    bands = stored(population, "rooms")[index]["stated"]["bands"]
    return as_measurement(bands, truth(population, index)["values"])
