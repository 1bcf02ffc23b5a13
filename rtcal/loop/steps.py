"""The steps of a closed loop, and the T20 and noise of a simulated measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.bands import label, span
from rtcal.acoustics.measurement import Measurement
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array, read_only


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One simulation.

    Attributes
    ----------
    target : array (n_bands,)
        T in s that the equation was calibrated to, NaN without a measured T.
    alpha : array (n_materials, n_bands)
        Coefficients as simulated.
    simulated : array (n_bands,)
        Simulated T20 in s, NaN if these coefficients give none.
    noise : array (n_bands,)
        Standard error in s of the mean T20 over the pairs; 0 if the simulator states none, NaN if
        it is unknown.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array

    def __post_init__(self) -> None:
        for name in ("target", "alpha", "simulated", "noise"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def simulated_t20(
    measurement: Measurement, frequencies: Array, wanted: Array, steps: Sequence[Step]
) -> Array:
    """Return the mean T20 in s over the pairs, (n_bands,), NaN where it is missing for some pair.

    Parameters
    ----------
    measurement : Measurement
    frequencies : array (n_bands,)
        The room's bands in Hz.
    wanted : array (n_bands,)
        Measured T in s, NaN without one.
    steps : sequence of Step
        Earlier steps.

    Raises
    ------
    DataError
        For other bands or no T20. A measured band may lack T20 only if it has one in an earlier
        step, and some measured band has one now.
    """
    checks.instance("what was simulated", measurement, Measurement)
    if not np.array_equal(measurement.centre_frequencies, frequencies):
        raise DataError(
            f"what was simulated has {span(measurement.centre_frequencies)}; the room has "
            f"{span(frequencies)}"
        )
    if "t20" not in measurement.values:
        raise DataError("what was simulated has no T20")
    measured = np.isfinite(wanted)
    missing = np.isnan(measurement.values["t20"]) & measured
    lost = np.asarray(missing.any(axis=0))
    earlier = np.zeros(lost.shape, dtype=bool)
    for step in steps:
        earlier |= np.isfinite(step.simulated)
    refused = lost if lost[measured].all() else lost & ~earlier
    if refused.any():
        pair, k = (int(i) for i in np.argwhere(missing & refused)[0])
        raise DataError(
            f"simulated T20[{' to '.join(measurement.pairs[pair])}, {label(frequencies[k])}] is "
            "missing, but T was measured there"
        )
    return np.where(lost, np.nan, measurement.mean("t20"))


def t20_noise(measurement: Measurement) -> Array:
    """Return the standard error in s of the mean T20 over the pairs, (n_bands,), as `Step` has it."""
    no_noise = np.zeros((1, len(measurement.centre_frequencies)))
    errors = measurement.uncertainty.get("t20", no_noise)
    return np.asarray(np.sqrt(np.sum(errors**2, axis=0)) / len(errors))
