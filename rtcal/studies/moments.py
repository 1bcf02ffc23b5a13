"""Sums over realisations, from which scores, standard errors and box plots are calculated.

Their size does not depend on the number of rooms, so neither does the study's memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from rtcal.studies.estimators import CALIBRATIONS, METHODS
from rtcal.support.types import Array

SAMPLED = METHODS + tuple(f"{m} bounded" for m in CALIBRATIONS)
ANALYTIC = tuple(f"{m} analytic" for m in METHODS)
SERIES = SAMPLED + ANALYTIC
"""Names of the eleven EMSE that each realisation has."""

EDGES = np.linspace(0.0, 0.5, 4001)  # of sqrt(EMSE); the last bin holds all larger values


@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Sums over realisations.

    ``count`` is the number of realisations, ``active`` the number of trials with an active bound,
    by calibration. ``sums`` are those of the series, ``products`` those of each pair of series. The
    sampled series also have a histogram of sqrt(EMSE) and its extremes.
    """

    count: int
    sums: Array
    products: Array
    active: Array
    histogram: Array
    least: Array
    most: Array

    @classmethod
    def of(cls, emse: Array, active: Array) -> ScoreMoments:
        """Sum up the series of some realisations, (r, 11), and their active trials, (r, 3)."""
        root = np.sqrt(emse[:, : len(SAMPLED)])
        bins = np.minimum(np.searchsorted(EDGES, root, side="right") - 1, EDGES.size - 2)
        histogram = np.stack([np.bincount(b, minlength=EDGES.size - 1) for b in bins.T])
        return cls(
            count=len(emse),
            sums=emse.sum(0),
            products=np.einsum("ri,rj->ij", emse, emse),
            active=active.sum(0).astype(float),
            histogram=histogram.astype(float),
            least=root.min(0),
            most=root.max(0),
        )

    def __add__(self, other: ScoreMoments) -> ScoreMoments:
        return ScoreMoments(
            self.count + other.count,
            self.sums + other.sums,
            self.products + other.products,
            self.active + other.active,
            self.histogram + other.histogram,
            np.minimum(self.least, other.least),
            np.maximum(self.most, other.most),
        )

    def to_bytes(self) -> bytes:
        """Return the sums as bytes: always the same number of them, little-endian floats."""
        values = [np.ravel(getattr(self, f.name)).astype("<f8") for f in fields(self)]
        return np.concatenate(values).tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> ScoreMoments:
        """Return what `to_bytes` wrote; ValueError if it is something else."""
        values = np.frombuffer(content, "<f8")
        if values.size != sum(math.prod(shape) for shape in _SHAPES.values()):
            raise ValueError("not the size of a piece")
        if not np.isfinite(values).all() or values[0] < 1 or values[0] % 1:
            raise ValueError("not the values of a piece")
        arrays: dict[str, Any] = {}
        start = 0
        for name, shape in _SHAPES.items():
            end = start + math.prod(shape)
            arrays[name], start = values[start:end].reshape(shape).astype(float), end
        return cls(**{**arrays, "count": int(arrays["count"])})

    def mean(self, weights: dict[str, float]) -> float:
        """Return the mean over realisations of a weighted sum of series."""
        return float(_vector(weights) @ self.sums / self.count)

    def score(self, method: dict[str, float], baseline: dict[str, float]) -> tuple[float, Array]:
        """Return 1 - sqrt(mean method / mean baseline) and its gradient by the series' means."""
        top, bottom = self.mean(method), self.mean(baseline)
        if top == 0:  # exact in every realisation: there is no error to propagate
            return 1.0, np.zeros(len(SERIES))
        ratio = np.sqrt(top / bottom)
        gradient = -ratio / 2 * (_vector(method) / top - _vector(baseline) / bottom)
        return float(1 - ratio), gradient

    def standard_error(self, gradient: Array) -> float:
        """Return the standard error of a smooth function of the means with that gradient.

        The delta method on independent realisations; NaN for a single one.
        """
        if self.count < 2:
            return float("nan")
        means = self.sums / self.count
        covariance = self.products / self.count - np.outer(means, means)
        variance = float(gradient @ covariance @ gradient) / (self.count - 1)
        return float(max(variance, 0.0) ** 0.5)

    def quantile(self, series: int, share: float) -> float:
        """Return a quantile of sqrt(EMSE) of a sampled series, to a histogram bin (1.25e-4)."""
        running = np.cumsum(self.histogram[series])
        return float(np.interp(share * running[-1], np.concatenate([[0.0], running]), EDGES))


_SHAPES: dict[str, tuple[int, ...]] = {
    "count": (),
    "sums": (len(SERIES),),
    "products": (len(SERIES), len(SERIES)),
    "active": (len(CALIBRATIONS),),
    "histogram": (len(SAMPLED), EDGES.size - 1),
    "least": (len(SAMPLED),),
    "most": (len(SAMPLED),),
}


def _vector(weights: dict[str, float]) -> Array:
    return np.array([weights.get(name, 0.0) for name in SERIES])
