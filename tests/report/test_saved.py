"""A loop is read as it was saved."""

from __future__ import annotations

import numpy as np

import rtcal as rt
from rtcal.loop import Loop


def test_a_loops_file_holds_its_room_and_equation(loop, tmp_path) -> None:
    path = str(tmp_path / "loop.json")
    loop.save(path)
    again = Loop.load(path)
    assert again.prior.name == loop.prior.name
    np.testing.assert_array_equal(again.prior.sigma, loop.prior.sigma)
    assert again.status == loop.status
    assert again.equation == rt.Eyring()
    other = rt.loop.start(*rt.datasets.bras_cr2(), equation=rt.Kuttruff(path_variance=0.3))
    other.save(path)
    assert Loop.load(path).equation == rt.Kuttruff(path_variance=0.3)
