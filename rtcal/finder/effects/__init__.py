"""The library of effects that a model may lack: one file per family of effects."""

from rtcal.finder.effects.base import Absorber, Effect, Limits, Parameters
from rtcal.finder.effects.coupled_room import CoupledRoom, Opening
from rtcal.finder.effects.measuring import DirectSound, NoiseFloor
from rtcal.finder.effects.people import Audience, Furniture, People
from rtcal.finder.effects.porous import Curtain, Porous
from rtcal.finder.effects.resonator import Membrane, Resonator
from rtcal.finder.effects.stated import CoveredSurface, WrongArea, WrongFormula, WrongVolume
from rtcal.finder.effects.whole_room import NonDiffuse, OmittedAir

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
