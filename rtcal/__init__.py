"""rtcal: calibrate the absorption coefficients of a room-acoustic model by convex optimisation.

    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> print(abs(result.gap_after).max() < 1e-9)
    True

Each name is imported when it is first used.
"""

from typing import TYPE_CHECKING

from rtcal import support
from rtcal.support import __version__ as __version__

if TYPE_CHECKING:
    from rtcal import acoustics as acoustics
    from rtcal import calibration as calibration
    from rtcal import datasets as datasets
    from rtcal import finder as finder
    from rtcal import io as io
    from rtcal import loop as loop
    from rtcal import modes as modes
    from rtcal import prediction as prediction
    from rtcal import report as report
    from rtcal import simulators as simulators
    from rtcal import studies as studies
    from rtcal.acoustics import priors as priors
    from rtcal.acoustics.air import Air as Air
    from rtcal.acoustics.comparison import compare as compare
    from rtcal.acoustics.equations import ArauPuchades as ArauPuchades
    from rtcal.acoustics.equations import Eyring as Eyring
    from rtcal.acoustics.equations import Fitzroy as Fitzroy
    from rtcal.acoustics.equations import Kuttruff as Kuttruff
    from rtcal.acoustics.equations import Millington as Millington
    from rtcal.acoustics.equations import Sabine as Sabine
    from rtcal.acoustics.measurement import Measurement as Measurement
    from rtcal.acoustics.room import Directivity as Directivity
    from rtcal.acoustics.room import Material as Material
    from rtcal.acoustics.room import Room as Room
    from rtcal.acoustics.room import Scene as Scene
    from rtcal.acoustics.room import Surface as Surface
    from rtcal.acoustics.run import Run as Run
    from rtcal.calibration import archive as archive
    from rtcal.calibration import exact as exact
    from rtcal.calibration import posterior as posterior
    from rtcal.calibration import terms as terms
    from rtcal.calibration.archive import learn as learn
    from rtcal.calibration.methods import calibrate as calibrate
    from rtcal.calibration.problem import Calibration as Calibration
    from rtcal.calibration.unknowns import Configurations as Configurations
    from rtcal.files.saved import load as load
    from rtcal.finder.diagnosis import diagnose as diagnose
    from rtcal.finder.search import find as find
    from rtcal.loop.closed import calibrate_simulator as calibrate_simulator
    from rtcal.loop.positions import calibrate_positions as calibrate_positions
    from rtcal.modes.calibrate import calibrate_modes as calibrate_modes
    from rtcal.prediction.designed import design as design
    from rtcal.support import errors as errors
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
