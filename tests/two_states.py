"""Two states of a room, of another equation than the finder's, with the noise of decays."""

import numpy as np

import rtcal as rt
from rtcal.support.types import Array
from tests.conftest import measurement_of

BANDS = np.array([125.0, 250, 500, 1000, 2000, 4000])
BANDWIDTH = BANDS / np.sqrt(2)
AREAS = np.array([60.0, 60, 100])
ALPHA = np.array(
    [
        [0.02, 0.03, 0.04, 0.05, 0.06, 0.07],
        [0.30, 0.25, 0.20, 0.18, 0.16, 0.15],
        [0.08, 0.08, 0.09, 0.10, 0.11, 0.12],
    ]
)
PANEL = np.array([0.10, 0.30, 0.65, 0.90, 0.95, 0.95])
"""Coefficients of a porous panel."""


def room() -> rt.Room:
    """Return what the user states: its coefficients are wrong by a half, and do not count."""
    return rt.Room(
        name="classroom",
        volume=200.0,
        materials=["floor", "ceiling", "walls"],
        areas=AREAS,
        alpha=np.clip(1.5 * ALPHA, 0, 1),
        sigma=np.full(ALPHA.shape, 0.05),
        centre_frequencies=BANDS,
        air=rt.Air(),
    )


def times(panels: float = 0.0, air: rt.Air | None = None) -> Array:
    """Return T in s by Millington's equation with so many m² of the panels on a wall, (n_bands,)."""
    areas = np.append(AREAS - [0, 0, panels], panels)
    alpha = np.vstack([ALPHA, PANEL])
    damped = areas @ -np.log(1 - alpha)
    attenuation = (air or rt.Air()).attenuation(BANDS)
    return np.asarray(24 * np.log(10) / 343.2 * 200.0 / (damped + 4 * attenuation * 200.0))


def measured(
    t: Array, seed: int, *, pairs: int = 6, noisy: int = 0, uneven: float = 0.0
) -> rt.Measurement:
    """Return T20 of so many sources, each with one decay's noise; of ``noisy`` three times as much."""
    rng = np.random.default_rng(seed)
    scale = np.where(np.arange(pairs) < noisy, 3.0, 1.0)[:, np.newaxis]
    noise = scale * rng.standard_normal((pairs, len(t))) * 0.88 / np.sqrt(BANDWIDTH * t)
    own = uneven * rng.standard_normal((pairs, 1))
    return measurement_of(
        BANDS, [(f"S{i}", "R1") for i in range(pairs)], t20=t * np.exp(noise + own)
    )
