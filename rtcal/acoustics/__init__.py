"""Room acoustics: air, bands, rooms, measurements, reverberation equations, decays, priors."""

from typing import TYPE_CHECKING

from rtcal.support import lazy

if TYPE_CHECKING:
    from rtcal.acoustics import band_conversion as band_conversion
    from rtcal.acoustics import bands as bands
    from rtcal.acoustics import decay as decay
    from rtcal.acoustics import observables as observables
    from rtcal.acoustics import priors as priors
    from rtcal.acoustics import quality as quality
    from rtcal.acoustics import trust as trust
    from rtcal.acoustics.air import Air as Air
    from rtcal.acoustics.directivity import Directivity as Directivity
    from rtcal.acoustics.directivity import DirectivityFile as DirectivityFile
    from rtcal.acoustics.equations import ArauPuchades as ArauPuchades
    from rtcal.acoustics.equations import Eyring as Eyring
    from rtcal.acoustics.equations import Fitzroy as Fitzroy
    from rtcal.acoustics.equations import Kuttruff as Kuttruff
    from rtcal.acoustics.equations import Millington as Millington
    from rtcal.acoustics.equations import Sabine as Sabine
    from rtcal.acoustics.materials import Material as Material
    from rtcal.acoustics.materials import Surface as Surface
    from rtcal.acoustics.measurement import Measurement as Measurement
    from rtcal.acoustics.room import Room as Room
    from rtcal.acoustics.scene import Scene as Scene
else:
    __getattr__, __dir__, __all__ = lazy.exports(__name__, __file__)
