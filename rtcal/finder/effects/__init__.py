"""The library of effects that a model may lack: one file per kind of effects."""

from rtcal.finder.effects.base import Absorber, Effect, Limits, Parameters
from rtcal.finder.effects.checks import library

__all__ = ["Absorber", "Effect", "Limits", "Parameters", "library"]
__dir__ = __all__.copy
