"""rtcal: calibrate the absorption coefficients of a room-acoustic model, by convex optimisation.

    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> print(abs(result.gap_after).max() < 1e-9)
    True

Everything is imported when it is first used: ``import rtcal`` costs little more than NumPy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from rtcal.support.version import __version__ as __version__

if TYPE_CHECKING:
    from rtcal import datasets, discrepancy, errors, exact, io, simulators
    from rtcal.acoustics import priors
    from rtcal.acoustics.air import Air
    from rtcal.acoustics.equations import Eyring, Kuttruff, Sabine
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.other_equations import ArauPuchades, Fitzroy, Millington
    from rtcal.acoustics.room import Material, Room, Surface
    from rtcal.calibration import closed_form, terms
    from rtcal.calibration.presets import calibrate
    from rtcal.calibration.problem import Calibration
    from rtcal.loop.calibrate import calibrate_simulator
    from rtcal.simulators.sdn import ScatteringDelayNetwork


# name -> (module, attribute or None for the module itself); at most 20, the rest in the modules.
_EXPORTS: dict[str, tuple[str, str | None]] = {
    "Air": ("rtcal.acoustics.air", "Air"),
    "ArauPuchades": ("rtcal.acoustics.other_equations", "ArauPuchades"),
    "Calibration": ("rtcal.calibration.problem", "Calibration"),
    "Eyring": ("rtcal.acoustics.equations", "Eyring"),
    "Fitzroy": ("rtcal.acoustics.other_equations", "Fitzroy"),
    "Kuttruff": ("rtcal.acoustics.equations", "Kuttruff"),
    "Millington": ("rtcal.acoustics.other_equations", "Millington"),
    "priors": ("rtcal.acoustics.priors", None),
    "Material": ("rtcal.acoustics.room", "Material"),
    "Measurement": ("rtcal.acoustics.measurement", "Measurement"),
    "Room": ("rtcal.acoustics.room", "Room"),
    "Sabine": ("rtcal.acoustics.equations", "Sabine"),
    "ScatteringDelayNetwork": ("rtcal.simulators.sdn", "ScatteringDelayNetwork"),
    "Surface": ("rtcal.acoustics.room", "Surface"),
    "calibrate": ("rtcal.calibration.presets", "calibrate"),
    "calibrate_simulator": ("rtcal.loop", "calibrate_simulator"),
    "closed_form": ("rtcal.calibration.closed_form", None),
    "datasets": ("rtcal.datasets", None),
    "discrepancy": ("rtcal.discrepancy", None),
    "errors": ("rtcal.errors", None),
    "exact": ("rtcal.exact", None),
    "io": ("rtcal.io", None),
    "studies": ("rtcal.studies", None),
    "simulators": ("rtcal.simulators", None),
    "terms": ("rtcal.calibration.terms", None),
}

__all__ = [
    "Air",
    "ArauPuchades",
    "Calibration",
    "Eyring",
    "Fitzroy",
    "Kuttruff",
    "Material",
    "Measurement",
    "Millington",
    "Room",
    "Sabine",
    "ScatteringDelayNetwork",
    "Surface",
    "calibrate",
    "calibrate_simulator",
    "closed_form",
    "datasets",
    "discrepancy",
    "errors",
    "exact",
    "io",
    "priors",
    "simulators",
    "studies",
    "terms",
]


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module 'rtcal' has no attribute '{name}'")
    module, attribute = _EXPORTS[name]
    value = importlib.import_module(module)
    if attribute is not None:
        value = getattr(value, attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
