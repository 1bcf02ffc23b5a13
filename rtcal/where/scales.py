"""Scales on which every parameter is linear in the room's absorption.

The energy density of a diffuse field decays at the rate k, in proportion to the absorption area A; its
level falls as 1 / A. So 1 / T, 1 / Ts and the inverse of the energy are linear in A, and so is the k
that belongs to a clarity: C = 10 lg(exp(k t) - 1). Coefficients that are twice what is stated halve T.
Linear in ln T, they would change it by the factor exp(-1).
"""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.decay_gradients import DB, LIMITS
from rtcal.simulators.observations import LOGARITHMIC
from rtcal.support.types import Array


def linear(parameter: str, values: Array, stated: Array) -> Array:
    """Return how far values are from what is stated, on the linear scale; 0 at ``stated``.

    Values as in `rtcal.simulators.Observations`. The slope at ``stated`` is 1 for ln T and ln Ts, and
    1 / DB for the level: a change of the scale is one of absorption, relative to what is stated.
    """
    if parameter in LIMITS:
        return np.asarray(_rate(parameter, values) / _rate(parameter, stated) - 1)
    return np.asarray(1 - np.exp(-(values - stated) * _per_neper(parameter)))


def slope(parameter: str, values: Array, stated: Array) -> Array:
    """Return the derivative of `linear` by the values."""
    if parameter in LIMITS:
        rate = _rate(parameter, values)
        by_rate = DB * LIMITS[parameter] / -np.expm1(-rate * LIMITS[parameter])
        return np.asarray(1 / (by_rate * _rate(parameter, stated)))
    unit = _per_neper(parameter)
    return np.asarray(unit * np.exp(-(values - stated) * unit))


def _per_neper(parameter: str) -> float:
    return 1.0 if parameter in LOGARITHMIC else 1 / DB


def _rate(parameter: str, clarity: Array) -> Array:
    """Return the k of an exponential decay with this clarity in dB, in 1/s."""
    return np.asarray(np.log1p(np.exp(clarity / DB)) / LIMITS[parameter])
