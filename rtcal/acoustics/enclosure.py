"""Whether the stated surfaces can enclose the stated volume."""

from __future__ import annotations

from rtcal.acoustics.room import Room
from rtcal.support.arguments import checked

_SHORT_PATH = 0.3
"""m. A reverberation chamber full of furniture keeps about 1 m."""


@checked
def surface_doubt(room: Room) -> tuple[str, str] | None:
    """Return the kind of mark and a sentence if areas and volume do not fit, else None.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> surface_doubt(room.replace(volume=4000))[1]
    '202.5 m² of surface cannot enclose 4000 m³, which takes at least 1220 m²'
    """
    area, volume = room.total_area, room.volume
    smallest = 4.84 * volume ** (2 / 3)  # the surface of the sphere of this volume
    if area < smallest:
        return (
            "surface_missing",
            f"{area:.4g} m² of surface cannot enclose {volume:.4g} m³, which takes at least "
            f"{smallest:.4g} m²",
        )
    if (path := 4 * volume / area) < _SHORT_PATH:
        return (
            "surface_beyond_sense",
            f"{area:.4g} m² of surface in {volume:.4g} m³ leave a mean free path of {path:.2g} m",
        )
    return None
