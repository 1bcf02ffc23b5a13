"""Reverberation equations: what predicts T from volume, areas, absorption and air.

One module per equation, and one registry that names them, `EQUATIONS`. Every module of this package
is imported and every equation in it registers itself, so a new equation is one new file: commands,
cases, saved loops and the model of a gap find it in the registry and ask it for the rest.

Three kinds, each with more abilities than the one before:

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
from rtcal.acoustics.equations.base import equation_keys as equation_keys
from rtcal.acoustics.equations.base import register as register
from rtcal.acoustics.equations.by_axis import ArauPuchades as ArauPuchades
from rtcal.acoustics.equations.by_axis import Fitzroy as Fitzroy
from rtcal.acoustics.equations.eyring import Eyring as Eyring
from rtcal.acoustics.equations.kuttruff import Kuttruff as Kuttruff
from rtcal.acoustics.equations.mean import LinearEquation as LinearEquation
from rtcal.acoustics.equations.mean import MeanEquation as MeanEquation
from rtcal.acoustics.equations.mean import linear_equation as linear_equation
from rtcal.acoustics.equations.mean import mean_equation as mean_equation
from rtcal.acoustics.equations.millington import Millington as Millington
from rtcal.acoustics.equations.sabine import Sabine as Sabine

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
