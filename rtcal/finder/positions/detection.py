"""Whether something is other than stated. The positions decide; means over them tell the family, too.

A noisy pair is no evidence that the room is other than stated. In rooms that lack nothing, one pair
often errs by more than is assumed, and the other pairs do not.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import observable
from rtcal.finder.case import Case as MeansCase
from rtcal.finder.configuration import PARAMETERS, Configuration
from rtcal.finder.effects import Effect
from rtcal.finder.finding import Detection
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.search import find as find_by_means
from rtcal.finder.positions.case import Case
from rtcal.support.errors import DataError
from rtcal.support.types import Array

THRESHOLD = 2.5
"""Of the evidence of the positions, in nats. In situ 1 of 23 rooms for development with nothing hidden
exceeds it without level, and 1 with it (`python -m benchmarks.where_decides`)."""
BY_SEED = 0.9
"""Standard deviation in nats of the score by random numbers, in a development room in which something
is detected (`python -m benchmarks.where_seeds --rooms 0.7 --seeds 0,1,2,3`)."""
OF_PROGRAMS = 13.0
"""The same where another program's values are compared, which errs in ways that control runs do not
show. Of 17 participants' models of PTB's studio as it was, an earlier version flagged one."""


def in_words(detection: Detection) -> str:
    """Return the score and its threshold in a sentence or two."""
    score, threshold = detection.score, detection.threshold
    said = f"Evidence that something is other than stated: {score:+.1f} nats; "
    said += f"threshold {threshold:.1f}."
    if abs(score - threshold) < BY_SEED:
        said += (
            f" In one room random numbers gave it a standard deviation of {BY_SEED:.1f} nats: look "
            "whether another seed says the same."
        )
    if detection.verdict is not None and detection.noise is not None and detection.noise > 0:
        said += f" That one pair is noisier than assumed: {detection.noise:+.1f} nats."
    if detection.means is None:
        return said
    return f"{said} Means over positions alone give {detection.means:+.1f} nats."


def evidence_of_means(
    case: Case,
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
) -> MeansFinding | None:
    """Return what `rtcal.finder.find` says of the means over positions.

    None where that finder has nothing to compare: no T, or none that can be trusted.
    """
    try:
        return find_by_means(of_means(case), effects, seed=seed, cache=cache)
    except DataError:
        return None


def of_means(case: Case) -> MeansCase:
    """Return the case without its geometry; DataError where it has no T that can be trusted."""
    measured, tracer = case.measured, case.simulator
    names = [observable(name).stand_in or name for name in case.match]
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
