"""C50."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.clarity import Clarity


@register
class C50(Clarity):
    """Clarity of speech: the energy before 50 ms over that after, in dB."""

    key, label, rank = "c50", "C50", 40
    spellings = ("clarityc50", "deutlichkeitsmaß", "deutlichkeitsmaßc50", "deutlichkeitsmassc50")
    limit = reaches = 0.05
    shown = True
