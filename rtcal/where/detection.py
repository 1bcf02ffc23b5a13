"""Whether something is other than stated. Means over positions decide, where they can be asked.

`rtcal.discrepancy.find` compares the means with equations. Of rooms that lack nothing, fewer pass for
others with it than with the positions, as many effects being detected (docs/where_study.md). So the
positions say what and where.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.discrepancy.case import Case as MeansCase
from rtcal.discrepancy.configuration import PARAMETERS, Configuration
from rtcal.discrepancy.search import find as find_by_means
from rtcal.errors import DataError
from rtcal.support.types import Array
from rtcal.where.case import Case

MEANS = 2.4
"""Least threshold of the means in nats. In situ 2 (without level) and 4 (with it) of 60 rooms with
nothing hidden exceed it: 25 for development, 35 that had been judged (`benchmarks.where_decides`)."""
POSITIONS = 13.0
"""Threshold of the positions alone, in nats: 4 and 1 of the same rooms exceed it. Of control rooms a
twentieth exceeds 2.5 nats in situ: they err as is assumed, and other rooms do not."""


@dataclass(frozen=True)
class Means:
    """What means over positions say.

    Attributes
    ----------
    score, threshold : float
        As `rtcal.discrepancy.find` has them, in nats.
    families : mapping of str to float
        Probability of each family, and of "none".
    """

    score: float
    threshold: float
    families: Mapping[str, float]


@dataclass(frozen=True)
class Detection:
    """Evidence in nats that something is other than stated.

    Attributes
    ----------
    positions : float
    means : float or None
        Of means over positions; None where they were not asked.
    threshold_of_means : float
        As `rtcal.discrepancy.find` has it.
    """

    positions: float
    means: float | None = None
    threshold_of_means: float = MEANS

    @property
    def score(self) -> float:
        """What is compared with the threshold."""
        return self.positions if self.means is None else self.means

    @property
    def threshold(self) -> float:
        """Score that few rooms exceed in which nothing is other than stated."""
        return POSITIONS if self.means is None else max(MEANS, self.threshold_of_means)

    @property
    def verdict(self) -> str | None:
        """What is said where nothing is detected, "none" or "hint"; None where something is."""
        if self.score > self.threshold:
            return None
        return "hint" if max(self.score, self.positions) > 0 else "none"

    @property
    def in_words(self) -> str:
        """The score and its threshold in a sentence or two."""
        limit = f"{self.score:+.1f} nats; threshold {self.threshold:.1f}."
        if self.means is None:
            return f"Evidence that something is other than stated, of the positions: {limit}"
        return (
            f"Evidence that something is other than stated, of means over positions: {limit} "
            f"The positions say what and where; their own evidence is {self.positions:+.1f} nats."
        )


def evidence_of_means(
    case: Case, seed: int = 0, cache: str | os.PathLike[str] | None = None
) -> Means | None:
    """Return what `rtcal.discrepancy.find` says of the means over positions.

    None where that finder has nothing to compare: no T, or none that can be trusted.
    """
    try:
        found = find_by_means(of_means(case), seed=seed, cache=cache)
    except DataError:
        return None
    return Means(found.score, found.threshold, found.families)


def of_means(case: Case) -> MeansCase:
    """Return the case without its geometry; DataError where it has no T that can be trusted."""
    measured, tracer = case.measured, case.simulator
    names = ["g" if name == "level" else name for name in case.match]
    rows = [measured.pairs.index(pair) for pair in case.pairs]

    def some(table: dict[str, Array]) -> dict[str, Array]:
        return {n: np.asarray(v)[rows] for n, v in table.items() if n in PARAMETERS and n in names}

    kept = Measurement(
        centre_frequencies=measured.centre_frequencies,
        values=some(dict(measured.values)),
        pairs=case.pairs,
        uncertainty=some(dict(measured.uncertainty)),
        common_uncertainty={
            n: v for n, v in measured.common_uncertainty.items() if n in PARAMETERS and n in names
        },
    )
    distances = [math.dist(tracer.sources[s], tracer.receivers[r]) for s, r in case.pairs]
    return MeansCase(
        room=case.room,
        configurations=[
            Configuration(name="measured", measured=kept, distances=np.array(distances))
        ],
        facing=_facing(case),
    )


def _facing(case: Case) -> Array:
    """Return the share of each material's area whose normal is along x, y and z."""
    geometry = case.geometry
    rows = np.array([case.room.material_index(m) for m in geometry.materials])
    along = geometry.face_areas[:, np.newaxis] * geometry.normals**2
    facing = np.array([along[rows == row].sum(axis=0) for row in range(case.room.n_materials)])
    total = facing.sum(axis=1, keepdims=True)
    return np.where(total > 0, facing / np.where(total > 0, total, 1.0), 1 / 3)
