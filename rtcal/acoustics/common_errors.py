"""Errors that coefficients from one source have in common: a factor and a tilt over frequency.

The stated sigma of a coefficient is that of an error of its own. Errors that all coefficients of a room
have in common, or all bands of a material, come on top of it: the table is of another product, or the
mounting differs. `rtcal.calibrate`, `rtcal.finder` and `rtcal.finder.positions` take them from here.
"""

from __future__ import annotations

import numpy as np

from rtcal.support.types import Array

HANDBOOK_SIGMA = 0.3
"""Relative sigma of coefficients from a handbook."""
COMMON, TILT = 0.15, 0.10
"""Usual standard deviations of ln alpha, of coefficients from a handbook (sigma 30 %): of a factor
common to all materials, and of a tilt per octave from 1 kHz. Development rooms of
tests/second_world have 0.13 and 0.05. In a measured room (BRAS CR2, T of seven octaves) the tilt is
-0.18."""
OWN, OWN_TILT = 0.25, 0.07
"""The same of each material's own factor and tilt: what two catalogues differ by. Carpets, plasters
and glass of one name differ by 20 to 60 % between tables (`rtcal.datasets.catalogue` and its
sources)."""
POWER = 2.0
"""These errors fall with this power of the stated relative sigma over a handbook's, since a small sigma
means measured coefficients."""


def common_error_columns(
    alpha: Array, sigma: Array, frequencies: Array, power: float = POWER
) -> tuple[Array, Array]:
    """Return the changes of alpha by one standard deviation each, two of (2, n_materials, n_bands).

    First factor and tilt of all materials, then those of each material. ``alpha`` and ``sigma`` have
    shape (n_materials, n_bands), ``frequencies`` (n_bands,) in Hz.

    Examples
    --------
    >>> alpha, sigma = np.full((1, 1), 0.2), np.full((1, 1), 0.06)
    >>> both, own = common_error_columns(alpha, sigma, np.array([2000.0]))
    >>> both[:, 0, 0].round(3), own[:, 0, 0].round(3)
    (array([0.03, 0.02]), array([0.05 , 0.014]))
    """
    octaves = np.log2(frequencies / 1000)
    # alpha, less where its sigma is smaller than a handbook's: it was measured.
    stated = sigma / np.maximum(alpha, 1e-6) / HANDBOOK_SIGMA
    level = alpha * np.minimum(1.0, stated) ** power
    both = np.stack([COMMON * level, TILT * level * octaves])
    return both, np.stack([OWN * level, OWN_TILT * level * octaves])


def of_absorption(areas: Array, alpha: Array, sigma: Array, frequencies: Array) -> Array:
    """Return the changes of S'alpha in m² by one standard deviation each, (n_errors, n_bands)."""
    both, own = common_error_columns(alpha, sigma, frequencies)
    each = areas[:, np.newaxis] * own
    return np.concatenate([np.einsum("m,tmb->tb", areas, both), *each])
