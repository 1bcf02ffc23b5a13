"""Observables: what is heard at a position, by band. Reading, measuring, fitting and finding ask here.

A new observable is one new module of this package. Its class registers itself in `OBSERVABLES`, where
files, tables, impulse responses, simulators, calibrations, finders, pages and checks look it up: its
value from an energy decay, its derivative, the scale on which it is linear in the absorption, its JND,
its uncertainty, its unit, its limits and its names. docs/extending.md adds one from outside.

Examples
--------
>>> print(observable("c80").label, isinstance(observable("t20"), DecaySlope), TARGET.key)
C80 True t20
"""

import importlib
import pkgutil

from rtcal.acoustics.observables.base import DB as DB
from rtcal.acoustics.observables.base import (
    OBSERVABLES,
    SUMMARY,
    Observable,
    observable,
    of_kind,
    parameter_label,
    register,
)
from rtcal.acoustics.observables.decay_times import DecaySlope, longest

__all__ = [
    "EARLY",
    "LEVEL",
    "MATCH",
    "OBSERVABLES",
    "REVERBERATION",
    "SUMMARY",
    "TARGET",
    "DecaySlope",
    "Observable",
    "longest",
    "observable",
    "of_kind",
    "parameter_label",
    "register",
]
__dir__ = __all__.copy

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

REVERBERATION = tuple(o for o in of_kind(DecaySlope).values() if o.averages is not None)
"""The reverberation times. Coefficients are calibrated to the first one that was measured, never to
EDT: it depends on early sound and the source's directivity, which coefficients must not compensate."""
TARGET = REVERBERATION[0]
"""The decay time that every simulator gives, and that a loop on mean values matches."""
EARLY = max(of_kind(DecaySlope).values(), key=lambda o: o.lower)
"""The early decay time, of the first levels."""
LEVEL = OBSERVABLES["level"]
"""The level, whose reference is a source's own where G was not measured."""
MATCH = tuple(key for key, o in OBSERVABLES.items() if o.matched)
"""Keys of what is matched at every position where nothing else is asked for."""
