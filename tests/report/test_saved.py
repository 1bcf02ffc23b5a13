"""Saved results are read alike, and broken files are refused."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop import Loop
from rtcal.report import (
    pages,
)
from rtcal.support.errors import DataError


def test_what_is_no_result_is_refused(tmp_path) -> None:
    path = tmp_path / "x.json"
    for content, said in (
        ("{", "not JSON"),
        ("[1]", "not a JSON object"),
        ("{}", "no saved result"),
        ("[" * 100_000, "not JSON"),
    ):
        path.write_text(content)
        with pytest.raises(DataError, match=said):
            pages.page_of(path)
    with pytest.raises(DataError, match=r"has no result\.json"):
        pages.page_of(tmp_path)


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
