"""Where the standard deviation of an absorption coefficient comes from.

Offered to users as part of `rtcal.acoustics.priors`; it stands here because reading a room needs it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics import bands
from rtcal.errors import DataError
from rtcal.support.types import Array

TIERS: dict[str, float] = {"low": 0.01, "moderate": 0.05, "high": 0.1}
"""Standard deviation by degree of uncertainty (Bellows & Katz 2025, Sect. 4.3.1)."""

# ISO 12999-2:2020, Table 1: sigma_R = m alpha + n in third-octaves (as transcribed in the open
# source package phonometry, J. M. Requena Plens; the standard itself was not at hand).
_ISO_12999_2: dict[float, tuple[float, float]] = {
    63: (0.450, 0.015),
    80: (0.330, 0.015),
    100: (0.240, 0.015),
    125: (0.180, 0.015),
    160: (0.140, 0.015),
    200: (0.110, 0.015),
    250: (0.090, 0.015),
    315: (0.075, 0.015),
    400: (0.060, 0.015),
    500: (0.050, 0.015),
    630: (0.045, 0.015),
    800: (0.040, 0.015),
    1000: (0.040, 0.015),
    1250: (0.040, 0.016),
    1600: (0.037, 0.018),
    2000: (0.035, 0.021),
    2500: (0.030, 0.026),
    3150: (0.030, 0.032),
    4000: (0.030, 0.040),
    5000: (0.026, 0.060),
}


def sigma_relative(alpha: Array, fraction: float, minimum: float = 0.0) -> Array:
    """Return max(fraction alpha, minimum), same shape as ``alpha``.

    Examples
    --------
    >>> print(sigma_relative(np.array([0.02, 0.5]), 0.3, 0.01))
    [0.01 0.15]
    """
    for name, value in (("fraction", fraction), ("minimum", minimum)):
        if not (np.isfinite(value) and value >= 0):
            raise DataError(f"sigma_relative: {name} = {value:g} is not finite and 0 or more")
    return np.asarray(np.maximum(fraction * np.asarray(alpha, dtype=float), minimum))


def sigma_iso_12999_2(alpha: Array, centre_frequencies: Sequence[float] | Array) -> Array:
    """Return sigma_R = m alpha + n, the reproducibility of ISO 354 between laboratories.

    Parameters
    ----------
    alpha : array (..., n_bands)
    centre_frequencies : sequence (n_bands,)
        Third-octaves from 63 to 5000 Hz, or octaves from 125 to 4000 Hz: there m and n are the means
        over the three thirds, whose errors are taken as fully correlated.

    Raises
    ------
    DataError
        For a band that the standard does not tabulate.

    References
    ----------
    ISO 12999-2:2020, Eq. 1 and Table 1.

    Examples
    --------
    >>> print(sigma_iso_12999_2(np.array([[0.5, 0.5, 0.5]]), [800, 1000, 1250]).round(4))
    [[0.035 0.035 0.036]]
    """
    f = bands.as_bands(centre_frequencies)
    thirds = bands.bandwidth_factor(f) < 0.5
    constants = []
    for frequency in f:
        wanted = [float(frequency)]
        if not thirds and frequency in bands.THIRD_OCTAVES:
            place = bands.THIRD_OCTAVES.index(frequency)
            wanted = list(bands.THIRD_OCTAVES[max(place - 1, 0) : place + 2])
        if any(w not in _ISO_12999_2 for w in wanted):
            raise DataError(
                f"ISO 12999-2 tabulates third-octaves from 63 to 5000 Hz (octaves from 125 to "
                f"4000 Hz), not {bands.label(frequency)}"
            )
        constants.append(np.mean([_ISO_12999_2[w] for w in wanted], axis=0))
    m, n = np.array(constants).T
    return np.asarray(m * np.asarray(alpha, dtype=float) + n)


def in_situ(sigma: Array, factor: float) -> Array:
    """Return ``factor`` times ``sigma``: another specimen, mounted otherwise, aged and painted.

    Examples
    --------
    >>> print(in_situ(np.array([0.02]), 2.0))
    [0.04]
    """
    if not (np.isfinite(factor) and factor >= 1):
        raise DataError(f"in-situ factor = {factor:g} is not finite and 1 or more")
    return np.asarray(factor * np.asarray(sigma, dtype=float))
