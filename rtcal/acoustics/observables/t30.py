"""T30."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.decay_slope import Bend, DecaySlope


@register
class T30(DecaySlope):
    """T30: -5 to -35 dB (ISO 3382-1:2009, 5.3)."""

    key, label, rank = "t30", "T30", 20
    spellings = (
        "rt30",
        "tr30",
        "rt60t30",
        "t60t30",
        "t60(30)",
        "reverberationtimet30",
        "nachhallzeitt30",
    )
    upper, lower = -5.0, -35.0
    minimum_range = 45.0
    one_decay = 0.55
    averages = (0.55, 1.52)
    # ISO 3382-2:2008, B.3: above 10 % a decay is far from straight. The scatter is 0.70 to 0.77.
    bend = Bend("curvature T30/T20 - 1", 10.0, 0.75)
