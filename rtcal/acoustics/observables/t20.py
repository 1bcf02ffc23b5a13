"""T20."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.decay_slope import DecaySlope


@register
class T20(DecaySlope):
    """T20: -5 to -25 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t20", "T20", 10
    spellings = (
        "rt20",
        "tr20",
        "rt60t20",
        "t60t20",
        "t60(20)",
        "reverberationtimet20",
        "nachhallzeitt20",
    )
    upper, lower = -5.0, -25.0
    minimum_range = 35.0
    one_decay = 0.88
    averages = (0.88, 1.90)
    matched = shown = True
