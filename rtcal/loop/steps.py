"""The steps of a closed loop, and the T of a simulated measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rtcal.acoustics.bands import label, span
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import parameter_label
from rtcal.errors import DataError
from rtcal.loop.matched import Matched
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
        Simulated T in s of what is matched, NaN if these coefficients give none.
    noise : array (n_bands,)
        Standard error of it in s; 0 if the simulator states none, NaN if it is unknown.
    heard : dict of parameter to array (n_bands,)
        Means of all parameters that are shown, as simulated, matched or not.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array
    heard: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("target", "alpha", "simulated", "noise"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def simulated_time(
    measurement: Measurement, frequencies: Array, matched: Matched, steps: Sequence[Step]
) -> Array:
    """Return the simulated T of what is matched in s, (n_bands,), NaN where some pair has none.

    Parameters
    ----------
    measurement : Measurement
    frequencies : array (n_bands,)
        The room's bands in Hz.
    matched : Matched
    steps : sequence of Step
        Earlier steps.

    Raises
    ------
    DataError
        For other bands, or a matched parameter that is missing. A measured band may lack it only if
        it has one in an earlier step, and some measured band has one now.
    """
    checks.instance("what was simulated", measurement, Measurement)
    if not np.array_equal(measurement.centre_frequencies, frequencies):
        raise DataError(
            f"what was simulated has {span(measurement.centre_frequencies)}; the room has "
            f"{span(frequencies)}"
        )
    for parameter in matched.shares:
        if parameter not in measurement.values:
            raise DataError(f"what was simulated has no {parameter_label(parameter)}")
    measured = np.isfinite(matched.wanted)
    missing = {
        parameter: np.isnan(measurement.values[parameter]) & measured & (share > 0)
        for parameter, share in matched.shares.items()
    }
    lost = np.any([absent.any(axis=0) for absent in missing.values()], axis=0)
    earlier = np.zeros(lost.shape, dtype=bool)
    for step in steps:
        earlier |= np.isfinite(step.simulated)
    refused = lost if lost[measured].all() else lost & ~earlier
    for parameter, absent in missing.items():
        for pair, k in np.argwhere(absent & refused)[:1].tolist():
            raise DataError(
                f"simulated {parameter_label(parameter)}[{' to '.join(measurement.pairs[pair])}, "
                f"{label(frequencies[k])}] is missing, but T was measured there"
            )
    return np.where(lost, np.nan, matched.combined(measurement.mean))
