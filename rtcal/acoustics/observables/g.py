"""G."""

from __future__ import annotations

from rtcal.acoustics.observables.base import register
from rtcal.acoustics.observables.level import OfEnergy


@register
class G(OfEnergy):
    """Sound strength: the level relative to 10 m in the free field (ISO 3382-1:2009, A.2.1)."""

    key, label, rank = "g", "G", 80
    spellings = ("strength", "soundstrength")
    # Far outdoors, and at 0.1 m from a source.
    usual = -40.0, 45.0
