"""A law: a constructor names an argument of another kind, and no function takes it in silence."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop import start
from rtcal.support.errors import RtcalError
from tests.conftest import in_hall


@pytest.mark.parametrize(
    "wrong",
    [
        {"method": np.ones(3)},
        {"rule": np.ones(3)},
        {"tolerance": [None]},
    ],
    ids=str,
)
def test_of_a_loop(wrong):
    room, measured = rt.datasets.bras_cr2()
    with pytest.raises(RtcalError, match=next(iter(wrong))):
        start(room, measured, **wrong)


ARRAYS = (np.ones(3), np.array([]), np.array(["a", "b"]))


@pytest.mark.parametrize("array", ARRAYS, ids=str)
@pytest.mark.parametrize("option", ["solver", "unreachable", "warm_start", "settings"])
def test_an_array_in_place_of_an_option(option, array):
    with pytest.raises(RtcalError, match=option):
        rt.calibrate(*rt.datasets.bras_cr2(), **{option: array})


def test_arguments_of_a_program():
    room, _ = rt.datasets.bras_cr2()
    with pytest.raises(RtcalError, match="arguments has"):
        rt.simulators.command(np.ones((2, 2)), room)


def test_a_flag_of_a_tracer():
    hall = rt.datasets.halls.corridor()
    tracer = in_hall(hall, n_paths=160)
    tracer.observe(hall.room.alpha, ("edt",))
    with pytest.raises(RtcalError, match="again"):
        tracer.observe(hall.room.alpha, ("edt",), again=np.ones(3))


CHANGES = (
    {"open": "ceiling", "area": 2},
    {"cover": "ceiling", "by": "floor", "area": 2},
    {"add": "floor", "area": 2},
    {"remove": "floor", "area": 2},
    {"volume": 180},
    {"air": rt.Air()},
)


@pytest.mark.parametrize(
    ("stated", "field"),
    [(stated, field) for stated in CHANGES for field in stated],
    ids=lambda x: x if isinstance(x, str) else next(iter(x)),
)
def test_a_field_of_a_change(stated, field):
    for wrong in (np.array([1, 2]), (x for x in [2]), True, [2.0]):
        with pytest.raises(RtcalError, match=f"^change: {field} = "):
            rt.prediction.Change(**stated | {field: wrong})
