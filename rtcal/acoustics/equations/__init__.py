"""Reverberation equations: they predict T from volume, areas, absorption and air.

A new equation is one new module of this package. Its class registers itself in `EQUATIONS`, where
commands, cases, saved loops and the discrepancy model look it up.

There are three kinds, each a special case of the one before:

- `Equation` predicts the T of a `Room`.
- `MeanEquation` has one absorption exponent per room, a function of a mean over the walls.
- `LinearEquation` takes the mean of alpha itself, so a measured T is one linear equality in alpha,
  which `rtcal.calibrate` solves.
"""

import importlib
import pkgutil

from rtcal.acoustics.equations.base import EQUATIONS as EQUATIONS
from rtcal.acoustics.equations.base import PAPER_SPEED_OF_SOUND as PAPER_SPEED_OF_SOUND
from rtcal.acoustics.equations.base import Equation as Equation
from rtcal.acoustics.equations.base import LinearEquation as LinearEquation
from rtcal.acoustics.equations.base import MeanEquation as MeanEquation
from rtcal.acoustics.equations.base import equation_keys as equation_keys
from rtcal.acoustics.equations.base import mean_equation as mean_equation
from rtcal.acoustics.equations.base import register as register
from rtcal.acoustics.equations.formulas import ArauPuchades as ArauPuchades
from rtcal.acoustics.equations.formulas import Eyring as Eyring
from rtcal.acoustics.equations.formulas import Fitzroy as Fitzroy
from rtcal.acoustics.equations.formulas import Kuttruff as Kuttruff
from rtcal.acoustics.equations.formulas import Millington as Millington
from rtcal.acoustics.equations.formulas import Sabine as Sabine

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
