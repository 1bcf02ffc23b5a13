"""A law: names that the eye does not tell apart are refused, of materials, sources and receivers."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import new_name
from rtcal.support.errors import DataError

LOOKS = {
    "upper case": "wall1",
    "a blank after it": "Wall1 ",
    "a blank within it": "Wall 1",
    "a full width": "\uff37all1",
    "no width": "Wall\u200b1",
    "a blank without a break": "Wall\u00a01",
}


@pytest.mark.parametrize("name", LOOKS.values(), ids=LOOKS)
class TestBeside:
    def test_a_material(self, name):
        with pytest.raises(DataError, match=r"materials has .* differ only in"):
            rt.Room(name="box", volume=60, materials=["Wall1", name], areas=[20, 74],
                    alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])  # fmt: skip

    @pytest.mark.parametrize("kind", ["source", "receiver"])
    def test_a_place(self, kind, name):
        pairs = [("Wall1", "R"), (name, "R")] if kind == "source" else [("S", "Wall1"), ("S", name)]
        with pytest.raises(DataError, match=rf"pairs has the {kind} .* differ only in"):
            rt.Measurement(centre_frequencies=[500], values={"t20": np.ones((2, 1))}, pairs=pairs)

    def test_a_new_name(self, name):
        assert new_name([name], "Wall1") == "Wall1 (2)"
