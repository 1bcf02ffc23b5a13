"""A geometric room as rtcal takes it. It is the one module of this folder that imports rtcal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.geometric_world import in_situ
from benchmarks.studies.geometric_world.generate import read
from benchmarks.studies.position_rooms.load import (
    RECEIVERS,
    SCATTERING,
    SOURCES,
    PositionRoom,
    as_measurement,
)
from rtcal.acoustics.measurement import Measurement
from rtcal.simulators import Polyhedron


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
    return read(population, part)


def truth(population: int, index: int) -> dict[str, Any]:
    """Return what is true of a room; "surface" is the number of a face, -1 for none."""
    values: dict[str, Any] = stored(population, "truth")[index]["truth"]
    return values


HANDBOOK, IN_SITU = "handbook", "in situ"
"""How the coefficients are stated."""


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
        alpha = in_situ.stated(population, index, truth(population, index)["alpha"])
        sigma = in_situ.sigma(alpha)
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
