"""The library of effects that a model may lack: one file per effect or family of effects."""

from rtcal.finder.effects.air import OmittedAir
from rtcal.finder.effects.audience import Audience
from rtcal.finder.effects.base import Absorber, Effect, Limits, Parameters
from rtcal.finder.effects.coupled_room import CoupledRoom
from rtcal.finder.effects.covered import CoveredSurface
from rtcal.finder.effects.curtain import Curtain
from rtcal.finder.effects.direct_sound import DirectSound
from rtcal.finder.effects.furniture import Furniture
from rtcal.finder.effects.membrane import Membrane
from rtcal.finder.effects.noise_floor import NoiseFloor
from rtcal.finder.effects.non_diffuse import NonDiffuse
from rtcal.finder.effects.opening import Opening
from rtcal.finder.effects.people import People
from rtcal.finder.effects.porous import Porous
from rtcal.finder.effects.resonator import Resonator
from rtcal.finder.effects.stated import WrongArea, WrongFormula, WrongVolume

__all__ = ["Absorber", "Effect", "Limits", "Parameters", "library"]
__dir__ = __all__.copy


def library() -> tuple[Effect, ...]:
    """Return every effect that rtcal has."""
    return (
        OmittedAir(),
        Opening(),
        Audience(),
        People(),
        Furniture(),
        Porous(),
        Curtain(),
        Resonator(),
        Membrane(),
        CoveredSurface(),
        WrongArea(),
        WrongVolume(),
        WrongFormula(),
        CoupledRoom(),
        NonDiffuse(),
        NoiseFloor(),
        DirectSound(),
    )
