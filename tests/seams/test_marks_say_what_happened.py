"""Law: a mark claims no more than the answer shows: a bound is no lack of absorption where T is met."""

import numpy as np
import pytest

import rtcal as rt
from tests.conftest import room_of

EYRING = rt.Eyring()
LACKS = "more absorption than these materials can have"


def room(fixed: bool = False) -> rt.Room:
    stone = (20, 0.02, 0.0 if fixed else 0.001)
    materials = {"wall": (150, 0.3, 0.002), "panel": (4, 0.9, 0.1), "stone": stone}
    return room_of(materials, [1000], 200, air=rt.Air(20, 50))


def advice(result) -> list[str]:
    return [m.advice for m in result.trust_marks if m.kind == "at_bound"]


def test_one_small_material_at_one_where_t_is_met():
    stated = room()
    result = rt.calibrate(stated, EYRING.time(stated, stated.absorption_area + 1.0))
    assert result.active.ravel().tolist() == [0, 1, 0]
    assert np.abs(result.gap_after).max() < 1e-9
    (said,) = advice(result)
    assert LACKS not in said
    assert "the other materials supply" in said
    assert LACKS not in str(result)


@pytest.mark.parametrize("fixed", [False, True])
def test_every_material_at_one(fixed):
    """A fixed material can supply nothing."""
    stated = room(fixed)
    t = rt.Sabine().time(stated, np.array([200.0]))
    result = rt.calibrate(stated, t, equation=rt.Sabine(), unreachable="nearest")
    assert (result.active > 0).sum() == 3 - fixed
    assert all(LACKS in said for said in advice(result))
