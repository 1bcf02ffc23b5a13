"""Values with labels: a mapping is put in the room's order, a table with labels is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators.base import check_alpha
from rtcal.support.errors import DataError

ALPHA = [[0.1, 0.2], [0.3, 0.4]]


def room(**changes: Any) -> rt.Room:
    stated = {
        "name": "box",
        "volume": 60,
        "materials": ["floor", "walls"],
        "areas": [20, 74],
        "alpha": ALPHA,
        "sigma": [[0.1, 0.1], [0.1, 0.1]],
        "centre_frequencies": [500, 1000],
    }
    return rt.Room(**{**stated, **changes})


def test_a_mapping_in_another_order_is_put_in_the_room_s() -> None:
    alpha = {"walls": ALPHA[1], "floor": ALPHA[0]}
    labelled = room(alpha=alpha, areas={"walls": 74, "floor": 20})
    np.testing.assert_array_equal(labelled.alpha, ALPHA)
    np.testing.assert_array_equal(labelled.areas, [20, 74])
    np.testing.assert_array_equal(check_alpha(labelled, alpha), ALPHA)


@pytest.mark.parametrize(
    ("alpha", "message"),
    [
        ({"wals": ALPHA[1], "floor": ALPHA[0]}, "keys wals, floor; they must be floor, walls"),
        (SimpleNamespace(to_numpy=lambda: np.array(ALPHA)), "alpha is a table with labels"),
    ],
)
def test_labels_of_another_room_or_of_a_table_are_refused(alpha: Any, message: str) -> None:
    with pytest.raises(DataError, match=message):
        room(alpha=alpha)
