"""Room acoustics: air, bands, rooms, measurements, reverberation equations, decays, priors."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.acoustics import bands as bands
    from rtcal.acoustics import marks as marks
    from rtcal.acoustics import observables as observables
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
