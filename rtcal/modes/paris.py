"""Specific admittance of a locally reacting wall, and its random-incidence absorption coefficient.

At the angle of incidence t a wall of specific admittance beta = 1 / z absorbs

    alpha(t) = 4 Re(beta) cos t / |cos t + beta|²,

and Paris' integral of alpha(t) sin 2t over t from 0 to 90° is the random-incidence coefficient. A real
beta reaches at most 0.951, at beta = 0.638. Along a phase of beta alpha rises up to a largest value;
`admittance` returns the smaller of the two admittances that have an alpha.

References
----------
Paris 1928, Phil. Mag. 5; Kuttruff 2009, Room Acoustics, Eq. 2.41 and 2.42.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array

Complex = NDArray[np.complex128]

LARGEST = 0.9
"""alpha above which beta follows its tangent: near the largest alpha, beta says nothing of alpha."""
LARGEST_PHASE = 75.0
"""Largest phase of beta in degrees: beyond it no alpha above 0.44 has an admittance."""


@checked
def absorption(beta: Complex | Array) -> Array:
    """Return the random-incidence absorption coefficient of specific admittances, same shape.

    Raises DataError for an admittance that is not finite or whose real part is below 0.

    Examples
    --------
    >>> print(absorption([0.01, 0.638, 0.02 + 0.05j]).round(3))
    [0.073 0.951 0.133]
    """
    value = np.asarray(beta, dtype=complex)
    if not np.isfinite(value).all() or (value.real < 0).any():
        raise DataError(f"beta = {checks.shown(beta)} is not finite with a real part of 0 or more")
    # The integral is even in b, and has its limit where b is 0.
    g, b = value.real, np.maximum(np.abs(value.imag), 1e-12)
    # With cos t = x it is 8 g times that of x² / ((x + g)² + b²) over x from 0 to 1.
    log = np.log(((1 + g) ** 2 + b**2) / (g**2 + b**2))
    arc = np.arctan2(b, g * (1 + g) + b**2) / b
    return np.asarray(8 * g * (1 - g * log + (g**2 - b**2) * arc))


@checked
def admittance(alpha: Array, phase: float = 0.0) -> Complex:
    """Return the specific admittance of this random-incidence absorption coefficient, same shape.

    Parameters
    ----------
    alpha : array
        0 to 1. Above `LARGEST`, or nine tenths of the largest alpha of this phase, beta follows its
        tangent.
    phase : float
        Of beta in degrees: 0 is a real admittance.

    Raises
    ------
    DataError
        For an alpha outside 0 to 1, or a phase beyond `LARGEST_PHASE`.

    Examples
    --------
    >>> print(admittance(0.1).round(4), absorption(admittance(0.5)).round(6))
    (0.014+0j) 0.5
    """
    value = checks.array("alpha", alpha)
    if not ((value >= 0) & (value <= 1)).all():
        raise DataError(f"alpha = {checks.shown(alpha)} is not within 0 and 1")
    return _along(value, phase)[0]


def admittance_slope(alpha: Array, phase: float = 0.0) -> Complex:
    """Return d beta / d alpha, same shape; errors as `admittance`."""
    return _along(alpha, phase)[1]


def _along(alpha: Array, phase: float) -> tuple[Complex, Complex]:
    """Return beta and its slope over alpha along a phase."""
    if abs(checks.number("phase", phase)) > LARGEST_PHASE:
        raise DataError(f"phase = {phase:g}° is beyond {LARGEST_PHASE:g}°")
    turn: Any = np.exp(1j * np.radians(phase))
    top, table, sizes = _table(turn)
    alpha = np.asarray(alpha, dtype=float)
    inside = np.minimum(alpha, top)
    size = np.exp(np.interp(inside, table, np.log(sizes)))
    size = np.where(inside < table[0], inside * sizes[0] / table[0], size)
    for _ in range(4):  # Newton; the table is within 1 %
        size = size - (absorption(size * turn) - inside) / _rise(size, turn)
    slope = 1 / _rise(size, turn)
    return np.asarray(turn * (size + (alpha - inside) * slope)), np.asarray(turn * slope)


@lru_cache(maxsize=8)
def _table(turn: Any) -> tuple[float, Array, Array]:
    """Return the largest alpha before the tangent, and alpha up to it with |beta|, (n,) each."""
    sizes = np.geomspace(1e-5, 4.0, 1200)
    table = absorption(sizes * turn)
    top = min(LARGEST, 0.9 * float(table.max()))
    rising = int(np.argmax(table > top)) + 1
    return top, table[:rising], sizes[:rising]


def _rise(size: Array, turn: Any) -> Array:
    """Return d alpha / d |beta| along a phase."""
    near = np.maximum(size, 1e-10)
    ends = [absorption(near * (1 + step) * turn) for step in (1e-4, -1e-4)]
    return np.asarray((ends[0] - ends[1]) / (2e-4 * near))
