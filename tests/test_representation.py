"""The display in an interpreter and a notebook: one line, or a table with the numbers."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import rtcal as rt
from tests.conftest import measurement_of, room_of


def box(**changes):
    room = room_of(
        {"floor": (20, [0.4, 0.5], 0.1), "wall": (74, [0.02, 0.03], 0.01)}, [500, 1000], 60
    )
    return room.replace(**changes)


def shown_objects():
    room, measured = rt.datasets.bras_cr2()
    hall = rt.datasets.halls.lecture_hall()
    case, _ = rt.datasets.hidden_room()
    configurations = rt.Configurations([room, room.replace(name="in winter")])
    result = rt.calibrate(room, measured)
    made = [result, result.joint, result.certificate]
    return [room, measured, case, hall, hall.geometry, configurations, *made]


@pytest.mark.parametrize("value", shown_objects(), ids=lambda v: type(v).__name__)
def test_a_repr_is_one_short_line(value):
    assert "\n" not in repr(value)
    assert len(repr(value)) < 160


def cells(html):
    """Text of each row's cells; the parser refuses what is not well formed."""
    table = ElementTree.fromstring(f"<div>{html}</div>").find("table")
    return [["".join(c.itertext()) for c in row] for row in table.iter("tr")]


def test_a_notebook_shows_a_room_as_a_table():
    assert cells(box()._repr_html_()) == [
        ["α ± σ", "S / m²", "500 Hz", "1000 Hz"],
        ["floor", "20", "0.400 ± 0.100", "0.500 ± 0.100"],
        ["wall", "74", "0.020 ± 0.010", "0.030 ± 0.010"],
    ]


def test_a_notebook_shows_means_and_what_is_missing():
    measured = measurement_of(
        [500, 1000],
        [("S", "R")],
        u={"t20": [[0.1, np.nan]]},
        t20=[[2.0, np.nan]],
        c80=[[1.25, -3.0]],
    )
    assert cells(measured._repr_html_()) == [
        ["mean ± u", "500 Hz", "1000 Hz"],
        ["T20 / s", "2 ± 0.1", "–"],
        ["C80 / dB", "1.25", "-3"],
    ]
