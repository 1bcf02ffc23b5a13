"""Bent decays: bands whose decay is not described by a single decay time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET, DecaySlope, of_kind
from rtcal.support.types import Array

_ALLOWED = 2.0
"""Standard deviations of a straight decay's ratio that are allowed."""


@dataclass(frozen=True)
class BentDecay:
    """A band whose decay is not straight: its centre in Hz, and the evidence in words."""

    frequency: float
    text: str


def curvature_percent(t20: Array, t30: Array) -> Array:
    """Return C = 100 (T30 / T20 - 1) in percent, same shape (ISO 3382-2:2008, Annex B).

    A straight decay has 0 to 5 %; above 10 % it is far from straight.

    Examples
    --------
    >>> print(curvature_percent(np.array([0.73]), np.array([1.01])).round(1))
    [38.4]
    """
    return np.asarray(100 * (np.asarray(t30, dtype=float) / np.asarray(t20, dtype=float) - 1))


def bent_decays(measured: Measurement) -> tuple[BentDecay, ...]:
    """Return the bands whose mean decay over the positions is bent.

    A band is bent if T30/T20 or EDT/T20 leaves 1 by more than its limit and twice the scatter of
    the ratio in straight decays. Only positions that have both parameters count.

    Examples
    --------
    >>> bent = Measurement.from_values([1000], edt=[0.42], t20=[0.73], t30=[1.01])
    >>> [b.frequency for b in bent_decays(bent)]
    [1000.0]
    """
    texts: dict[float, list[str]] = {}
    for parameter, slope in of_kind(DecaySlope).items():
        bend = slope.bend
        if bend is None or not {TARGET.key, parameter} <= {*measured.values}:
            continue
        t20, other = measured.values[TARGET.key], measured.values[parameter]
        both = np.isfinite(t20) & np.isfinite(other)
        n_positions = np.sum(both, axis=0)
        if measured.is_summary:
            n_positions = n_positions * (measured.n_sources or 1) * (measured.n_receivers or 1)
        width = bands.bandwidth_factor(measured.centre_frequencies) * measured.centre_frequencies
        for k in np.flatnonzero(n_positions).tolist():
            t, ratio = t20[both[:, k], k].mean(), other[both[:, k], k].mean()
            percent = float(curvature_percent(t, ratio))
            scatter = 100 * bend.scatter / np.sqrt(width[k] * t * n_positions[k])
            if abs(percent) > bend.limit + _ALLOWED * scatter:
                texts.setdefault(float(measured.centre_frequencies[k]), []).append(
                    f"{bend.name} = {percent:+.0f} %"
                )
    return tuple(BentDecay(f, f"the decay is bent, {', '.join(texts[f])}") for f in sorted(texts))
