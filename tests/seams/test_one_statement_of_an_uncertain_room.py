"""A room's statement of its volume and areas is one statement, wherever the room goes."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators.external import of_equation

STATED = {"volume_sigma": 0.08, "area_sigma": 0.05}


@pytest.fixture(scope="module")
def room():
    return rt.datasets.bras_cr2()[0].replace(surfaces=())


def measured(room: rt.Room) -> rt.Measurement:
    t = 1.15 * rt.Eyring().reverberation_time(room)
    return rt.Measurement.from_values(room.centre_frequencies, t20=t)


def test_a_loop_takes_it_as_exact_and_does_not_push_the_target(room):
    """The simulator is brought to T all the same, so the room's share must not drift into alpha."""
    loops = []
    for each in (room, room.replace(**STATED)):
        simulator = of_equation(rt.Kuttruff(), each)
        loops.append(rt.calibrate_simulator(simulator, each, measured(each)))
    np.testing.assert_allclose(loops[1].room.alpha, loops[0].room.alpha, rtol=0, atol=1e-12)
    assert np.abs(loops[0].room.alpha - room.alpha).max() > 0.001


def test_an_archive_counts_it(room):
    shapes = {"A": [1, 1, 1, 1, 1], "B": [1, 2, 1, 0.5, 1], "C": [2, 1, 1, 1, 0.5]}
    exact = [room.replace(name=n, areas=room.areas * np.array(s)) for n, s in shapes.items()]
    sure, unsure = (
        rt.learn([rt.calibrate(r.replace(**stated), measured(r)) for r in exact])
        for stated in ({}, {"volume_sigma": 0.3})
    )
    assert unsure.mean_sigma.mean() > 1.05 * sure.mean_sigma.mean()
    shift = [np.abs(a.alpha - a.table).mean() for a in (sure, unsure)]
    assert shift[1] < shift[0]
