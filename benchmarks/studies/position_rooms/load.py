"""A position room as rtcal takes it: a room whose truth comes from a tracer that is not rtcal's.

Population 0, ten rooms, is for development. Populations 1 and 2 are for judging; of 2 49 were judged.
Even rooms are boxes of six surfaces, odd ones polyhedra of 10 to 30, each of a material of its own.
`benchmarks/studies/fits` describes the rooms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies import stored as files
from rtcal.acoustics.measurement import Measurement
from rtcal.simulators import PathTracing, Polyhedron

PARAMETERS = ("t20", "edt", "c80", "ts", "g")
PRIORS = ("wide", "narrow")
SCATTERING = 0.4
"""Assumed of every surface, since nothing is stated. The truth has 0.1 to 0.8."""
SOURCES = ("S1", "S2")
RECEIVERS = ("R1", "R2", "R3", "R4", "R5", "R6")


def sigma_of(prior: str, alpha: np.ndarray) -> np.ndarray:
    return 0.3 * alpha if prior == "wide" else 0.01 + 0.07 * alpha


@dataclass(frozen=True)
class PositionRoom:
    """A room as a user knows and measured it. The pairs run over receivers first."""

    room: rt.Room
    geometry: Polyhedron
    sources: dict[str, np.ndarray]
    receivers: dict[str, np.ndarray]
    measured: Measurement

    @classmethod
    def of(
        cls, name: str, data: files.Row, names: list[str], alpha: np.ndarray, sigma: np.ndarray
    ) -> PositionRoom:
        """Return the room of what is stored, with its materials' names and coefficients."""
        stated = data["stated"]
        geometry = Polyhedron(
            vertices=np.array(stated["vertices"]),
            faces=stated["faces"],
            materials=stated.get("materials", names),
        )
        room = rt.Room(
            name=name,
            volume=geometry.volume,
            materials=names,
            areas=[geometry.areas[m] for m in names],
            alpha=alpha,
            sigma=sigma,
            centre_frequencies=stated["bands"],
            air=rt.Air(temperature=stated["air"][0], humidity=stated["air"][1]),
            scattering=np.full(alpha.shape, SCATTERING),
        )
        return cls(
            room,
            geometry,
            dict(zip(SOURCES, np.array(stated["sources"]), strict=True)),
            dict(zip(RECEIVERS, np.array(stated["receivers"]), strict=True)),
            as_measurement(stated["bands"], data["measured"]),
        )

    def without_level(self) -> Measurement:
        """Return the measurement without G."""
        values = {p: v for p, v in self.measured.values.items() if p != "g"}
        return replace(self.measured, values=values)

    def simulator(self, receivers: Sequence[str] = RECEIVERS, **options: Any) -> PathTracing:
        """Return a path tracer with these receivers."""
        return PathTracing(
            geometry=self.geometry,
            room=self.room,
            sources=self.sources,
            receivers={r: self.receivers[r] for r in receivers},
            **options,
        )


@lru_cache(maxsize=4)
def stored(population: int, part: str) -> dict[int, files.Row]:
    return files.numbered(files.path("position_rooms", population, part))


def as_measurement(bands: Any, values: dict[str, Any]) -> Measurement:
    return Measurement(
        centre_frequencies=bands,
        values={p: np.array(values[p], dtype=float) for p in PARAMETERS},
        pairs=[(s, r) for s in SOURCES for r in RECEIVERS],
    )


def load(population: int, index: int, prior: str) -> PositionRoom:
    """Return room ``index`` of a population with its "wide" or "narrow" prior."""
    data = stored(population, "rooms")[index]
    alpha = np.array(data["stated"]["alpha"])
    names = [f"surface {i + 1}" for i in range(len(alpha))]
    of_prior = {**data, "measured": data["measured"][prior]}
    name = f"position room {population}.{index}"
    return PositionRoom.of(name, of_prior, names, alpha, sigma_of(prior, alpha))


def true_alpha(population: int, index: int, prior: str) -> np.ndarray:
    """Return the true coefficients (n_materials, n_bands)."""
    return np.array(stored(population, "truth")[index]["truth"]["alpha"][prior])


def without_noise(population: int, index: int, prior: str) -> Measurement:
    """Return what the true positions hear, without the measurement's noise."""
    bands = stored(population, "rooms")[index]["stated"]["bands"]
    return as_measurement(bands, stored(population, "truth")[index]["truth"]["values"][prior])
