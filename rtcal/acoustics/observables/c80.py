"""C80."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.clarity import Clarity


@register
class C80(Clarity):
    """Clarity of music: the energy before 80 ms over that after, in dB."""

    key, label, rank = "c80", "C80", 50
    spellings = ("clarityc80", "klarheitsmaß", "klarheitsmaßc80", "klarheitsmassc80")
    limit = reaches = 0.08
    matched = shown = True
