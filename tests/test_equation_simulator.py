"""An equation as a simulator."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.equations import Kuttruff
from rtcal.simulators import base
from rtcal.simulators.external import of_equation
from rtcal.support.errors import DataError


def test_it_returns_the_equations_times(cr2):
    room, _ = cr2
    simulator = of_equation(Kuttruff(), room)
    assert isinstance(simulator, base.Simulator)
    assert simulator.deterministic
    alpha = np.minimum(1.5 * room.alpha, 1)
    found = base.run(simulator, alpha)
    expected = Kuttruff().reverberation_time(room.replace(alpha=alpha))
    assert found.mean("t20") == pytest.approx(expected)
    assert (found.mean("t20") < Kuttruff().reverberation_time(room)).all()


def test_nothing_that_absorbs_is_refused(cr2):
    room = cr2[0].replace(air=None)
    with pytest.raises(DataError, match="nothing absorbs"):
        of_equation(rt.Eyring(), room).simulate(np.zeros_like(room.alpha))
