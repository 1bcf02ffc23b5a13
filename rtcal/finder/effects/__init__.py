"""The library of effects that a model may lack: one file per effect or family of effects."""

from rtcal.discrepancy.effects.air import OmittedAir
from rtcal.discrepancy.effects.audience import Audience
from rtcal.discrepancy.effects.base import Absorber, Effect, Limits, Parameters
from rtcal.discrepancy.effects.coupled_room import CoupledRoom
from rtcal.discrepancy.effects.covered import CoveredSurface
from rtcal.discrepancy.effects.curtain import Curtain
from rtcal.discrepancy.effects.direct_sound import DirectSound
from rtcal.discrepancy.effects.furniture import Furniture
from rtcal.discrepancy.effects.membrane import Membrane
from rtcal.discrepancy.effects.noise_floor import NoiseFloor
from rtcal.discrepancy.effects.non_diffuse import NonDiffuse
from rtcal.discrepancy.effects.opening import Opening
from rtcal.discrepancy.effects.people import People
from rtcal.discrepancy.effects.porous import Porous
from rtcal.discrepancy.effects.resonator import Resonator
from rtcal.discrepancy.effects.stated import WrongArea, WrongFormula, WrongVolume

__all__ = ["Absorber", "Effect", "Limits", "Parameters", "library"]


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
