"""How far a model is from a measurement, in just noticeable differences (JND)."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.measurement import DECAY_TIMES
from rtcal.errors import DataError
from rtcal.types import Array

# ISO 3382-1:2009, Table A.1: relative for decay times, absolute for the others.
JND: dict[str, float] = {
    "t20": 0.05, "t30": 0.05, "edt": 0.05, "c50": 1.0, "c80": 1.0, "g": 1.0, "d50": 0.05,
    "ts": 0.010,
}  # fmt: skip
"""One JND: 5 % of the measured decay time; 1 dB; .05 for D50; 10 ms for Ts."""


def gap_jnd(model: Array, measured: Array, parameter: str = "t20") -> Array:
    """Return (model - measured) in JND, signed, same shape; NaN where either is missing.

    >>> print(gap_jnd(np.array([1.05, 0.9]), np.array([1.0, 1.0])).round(6))
    [ 1. -2.]
    """
    if parameter not in JND:
        raise DataError(f'parameter "{parameter}" has no JND; known are {", ".join(JND)}')
    model, measured = np.asarray(model, dtype=float), np.asarray(measured, dtype=float)
    unit = JND[parameter] * measured if parameter in DECAY_TIMES else JND[parameter]
    return np.asarray((model - measured) / unit)
