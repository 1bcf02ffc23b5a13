"""Simulators: absorption coefficients in, a `Measurement` out.

`PathTracing` and `RayTracing` take rooms with plane walls, a `Polyhedron`. `ScatteringDelayNetwork`
and `ImageSource` take shoeboxes. `of_equation` evaluates an equation. `External` calls a
function, `command` another program. `Simulator` is the protocol that all of them follow.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.simulators.base import Simulator as Simulator
    from rtcal.simulators.external import External as External
    from rtcal.simulators.external import command as command
    from rtcal.simulators.external import of_equation as of_equation
    from rtcal.simulators.geometry import Polyhedron as Polyhedron
    from rtcal.simulators.path_tracing import PathTracing as PathTracing
    from rtcal.simulators.ray_tracing import RayTracing as RayTracing
    from rtcal.simulators.shoebox import ImageSource as ImageSource
    from rtcal.simulators.shoebox import ScatteringDelayNetwork as ScatteringDelayNetwork
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
