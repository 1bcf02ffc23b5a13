"""The prior of alpha: where its sigma comes from.

Which sigma to state:

- `TIERS`, the paper's three: 0.01 for a painted wall or linoleum, 0.05 for wood panels or a door,
  0.1 for seats and perforated ceilings (Bellows & Katz 2025, Sect. 4.3.1).
- `sigma_iso_12999_2`: the standard deviation between laboratories for the same specimen, which is the
  least for a handbook value.
- `SigmaRule`: a fraction of alpha with a minimum, or ISO 12999-2's, enlarged for another specimen in
  another mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["SigmaRule", "sigma_iso_12999_2"]
__dir__ = __all__.copy

TIERS: dict[str, float] = {"low": 0.01, "moderate": 0.05, "high": 0.1}
"""Standard deviations of coefficients by degree of uncertainty (Bellows & Katz 2025, Sect. 4.3.1)."""

NORMAL_90 = 1.6449
"""Half-width of the interval that holds 90 % of a normal distribution, in standard deviations."""

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


def sigma_iso_12999_2(alpha: Array, centre_frequencies: Sequence[float] | Array) -> Array:
    """Return the standard deviation of coefficients measured by ISO 354 in different laboratories.

    It is the reproducibility standard deviation sigma_R = m alpha + n of ISO 12999-2.

    Parameters
    ----------
    alpha : array (..., n_bands)
        Absorption coefficients, 0 to 2.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz: third-octaves from 63 to 5000 Hz, or octaves from 125 to 4000 Hz. m
        and n of an octave are the means over its third-octaves, whose errors count as fully correlated.

    Raises
    ------
    DataError
        For a band that the standard does not tabulate, or a coefficient that is not from 0 to 2.

    References
    ----------
    ISO 12999-2:2020, Eq. 1 and Table 1, as transcribed in the package phonometry (J. M. Requena Plens).

    Examples
    --------
    >>> print(sigma_iso_12999_2(np.array([[0.5, 0.5, 0.5]]), [800, 1000, 1250]).round(4))
    [[0.035 0.035 0.036]]
    """
    f = bands.as_bands(centre_frequencies)
    thirds = bands.bandwidth_factor(f) < 0.5
    constants = []
    for frequency in f:
        wanted = [float(frequency)] if thirds else bands.thirds_of(float(frequency))
        if any(w not in _ISO_12999_2 for w in wanted):
            raise DataError(
                f"ISO 12999-2 gives no uncertainty at {bands.label(frequency)}, only in "
                "one-third octaves from 63 to 5000 Hz and octaves from 125 to 4000 Hz"
            )
        constants.append(np.mean([_ISO_12999_2[w] for w in wanted], axis=0))
    m, n = np.array(constants).T
    coefficients = _coefficients(alpha)
    if coefficients.ndim == 0 or coefficients.shape[-1] not in (1, len(f)):
        raise DataError(
            f"ISO 12999-2: alpha has shape {coefficients.shape}; its last axis must have "
            f"{len(f)} values, one per band"
        )
    return np.asarray(m * coefficients + n)


@dataclass(frozen=True, kw_only=True)
class SigmaRule:
    """Rule for the standard deviation sigma of coefficients of materials that state none.

    sigma = in_situ_factor * max(relative * alpha, minimum). If ``iso_12999_2`` is True, the maximum
    also includes sigma_R of ISO 12999-2 (default False). ``relative`` (default 0.3) is a share of
    alpha, and ``minimum`` (default 0.01) a coefficient. ``in_situ_factor`` (default 1) allows for
    another specimen, mounting, age or paint than that of the stated coefficients.

    Raises
    ------
    DataError
        If ``relative`` or ``minimum`` is not from 0 to 1, or the factor is below 1 or not finite.

    Examples
    --------
    >>> print(SigmaRule(minimum=0.01).sigma(np.array([0.02, 0.5]), np.array([500, 1000])))
    [0.01 0.15]
    """

    relative: float = 0.3
    minimum: float = 0.01
    iso_12999_2: bool = False
    in_situ_factor: float = 1.0

    def __post_init__(self) -> None:
        for name in ("relative", "minimum"):
            value = checks.number(f"sigma: {name}", getattr(self, name))
            percent = checks.IN_PERCENT if 1 < value <= 100 else ""
            checks.between(f"sigma: {name}", value, 0, 1, why=percent)
        if not 1 <= checks.number("in_situ_factor", self.in_situ_factor) < np.inf:
            raise DataError(
                f"in_situ_factor = {self.in_situ_factor:g} must be finite and 1 or more"
            )

    def sigma(self, alpha: Array, centre_frequencies: Array) -> Array:
        """Return the standard deviation of each coefficient by this rule, (n_bands,).

        ``alpha`` (n_bands,) are the coefficients, ``centre_frequencies`` (n_bands,) are in Hz. Raises
        DataError for a coefficient that is not from 0 to 2.
        """
        sigma = np.maximum(self.relative * _coefficients(alpha), self.minimum)
        if self.iso_12999_2:
            sigma = np.maximum(sigma, sigma_iso_12999_2(alpha, centre_frequencies))
        return np.asarray(self.in_situ_factor * sigma)

    def __str__(self) -> str:
        rules = [f"{self.relative:g} alpha", f"{self.minimum:g}"]
        rules += ["ISO 12999-2's"] if self.iso_12999_2 else []
        factor = "" if self.in_situ_factor == 1 else f"{self.in_situ_factor:g} "
        return f"sigma = {factor}max({', '.join(rules)})"


def _coefficients(alpha: Array) -> Array:
    """Return checked alpha; laboratories report values above 1 (ISO 354: edges absorb too)."""
    array = checks.array("alpha", alpha)
    if (bad := ~((array >= 0) & (array <= 2))).any():
        raise DataError(f"alpha has {array[bad][0]:g}, but a coefficient must be from 0 to 2")
    return array
