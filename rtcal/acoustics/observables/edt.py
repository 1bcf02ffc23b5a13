"""EDT."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.decay_slope import LIMITS, Bend, DecaySlope


@register
class EDT(DecaySlope):
    """Early decay time: 0 to -10 dB (ISO 3382-1:2009, A.2.2)."""

    key, label, rank = "edt", "EDT", 30
    spellings = ("earlydecaytime",)
    upper, lower = 0.0, -10.0
    # Strong direct sound makes it arbitrarily short.
    limits = 0.0, LIMITS[1]
    usual = 0.005, 30.0
    # 400 decays of octave-filtered Gaussian noise at 500 Hz and 400 at 1 kHz, T = 1 s, have 1.7.
    one_decay = 1.6
    part = "early"
    # Four JND, in the mean over positions. The scatter is 2.2 to 2.3.
    bend = Bend("EDT/T20 - 1", 20.0, 2.25)
    teams = (0.100, 0.080, 0.064, 0.051, 0.041, 0.033)
    matched = shown = True
