"""The same rooms, their coefficients stated as a model has them that was measured in situ.

Geometry, hidden things, true coefficients and measurements are those of `rooms`; nothing is traced
anew. What is stated is the true coefficient with an independent normal error per material and band, of
sigma = 0.01 + 0.07 alpha. It was frozen on 2026-11-22 before any finder was tried on it.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.studies.geometric_world.rooms import SEED

FROZEN = {
    0: "b577e1279222860b0142cadf7afe9e9cd4b324220e7f73fc2d2eb7dc7fa1b62d",
    1: "287b2e6b1a26827a54d406c1aae5611daf07e28bcdd2183bd364dd1db7ce4c79",
    2: "07528e68a9398c18e4d3fe6be550da3421f844c2f1c10ad039b07e0ed98872ab",
    3: "93cb3e889586549e9ce1ccafbcf6528c02896a9b74c6dfbdc31775c5ccaf863e",
    4: "3ee5445db8e5dcd24889961c3c71000fc8d17f5fdfff96cdde32527c330cbf5c",
}
"""`digest` of what is stated in the first twelve rooms of each population."""


def sigma(alpha: np.ndarray) -> np.ndarray:
    """Return the standard deviation of coefficients."""
    return 0.01 + 0.07 * alpha


def stated(population: int, index: int, true: ArrayLike) -> np.ndarray:
    """Return the stated coefficients, given the true ones (n_materials, n_bands)."""
    alpha = np.asarray(true, dtype=float)
    rng = np.random.default_rng([SEED, population, index, 2000])
    return np.clip(alpha + sigma(alpha) * rng.standard_normal(alpha.shape), 0.01, 0.95)


def digest(population: int, true: list[ArrayLike]) -> str:
    """Return the SHA-256 of what is stated in the first rooms, of their true coefficients."""
    whole = hashlib.sha256()
    for index, alpha in enumerate(true):
        whole.update(np.round(stated(population, index, alpha), 6).tobytes())
    return whole.hexdigest()
