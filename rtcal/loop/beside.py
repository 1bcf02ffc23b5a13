"""What was measured beside what is fitted: how far it was off before and after, and whether it left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import OBSERVABLES
from rtcal.acoustics.parameters import parameter_label
from rtcal.support.types import Array, read_only

SHOWN = tuple(key for key, kind in OBSERVABLES.items() if kind.shown)
"""Parameters that are shown before and after, fitted or not."""
_LEFT = 1.0
"""JND by which a gap grows in some band where a parameter left what was measured."""

Gaps = Mapping[str, tuple[Array, Array]]
"""Gaps before and after in JND by parameter, each (n_bands,)."""


def means(measurement: Measurement) -> dict[str, Array]:
    """Return the means over pairs of the parameters that are shown, each (n_bands,)."""
    return {p: read_only(measurement.mean(p)) for p in SHOWN if p in measurement.values}


def left(gaps: Gaps) -> tuple[str, ...]:
    """Return the parameters that left what was measured, in some band by more than one JND."""
    return tuple(
        parameter
        for parameter, (before, after) in gaps.items()
        if (np.abs(after) > np.abs(before) + _LEFT).any()
    )


def sentences(gaps: Gaps, frequencies: Array) -> Iterator[str]:
    """Yield by how much each parameter of `left` left what was measured, in its worst band."""
    for parameter in left(gaps):
        before, after = (np.abs(gap) for gap in gaps[parameter])
        k = int(np.nanargmax(after - before))
        yield (
            f"{parameter_label(parameter)}, which was not fitted, left what was measured: by "
            f"{before[k]:.1f} JND before and {after[k]:.1f} JND after, at {label(frequencies[k])}. "
            "Match it at every position, or look for what the model misses (rtcal gap)."
        )
