"""Tables with labels: their order is that of the labels, not that of the rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators.base import check_alpha
from rtcal.support.errors import DataError

pandas = pytest.importorskip("pandas", reason="needs pandas")

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


def table(**labels: Any) -> Any:
    return pandas.DataFrame([[0.4, 0.3], [0.2, 0.1]], **labels)


@pytest.mark.parametrize("columns", [[1000, 500], ["1000 Hz", "500"], [1000.0, 501.0]])
def test_a_table_in_another_order_is_put_in_the_room_s(columns: list[Any]) -> None:
    """The labels were ignored: the floor had the coefficients of the walls."""
    alpha = table(index=["walls", "floor"], columns=columns)
    areas = pandas.Series([74.0, 20.0], index=["walls", "floor"])
    labelled = room(alpha=alpha, areas=areas)
    np.testing.assert_array_equal(labelled.alpha, ALPHA)
    np.testing.assert_array_equal(labelled.areas, [20, 74])
    np.testing.assert_array_equal(check_alpha(labelled, alpha), ALPHA)


def test_a_table_without_labels_is_taken_as_it_stands() -> None:
    """Also rows that were selected from a longer table, whose numbers say nothing of materials."""
    assert room(alpha=table()).alpha[0, 0] == 0.4
    assert room(alpha=table(index=[7, 3])).alpha[0, 0] == 0.4


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"index": ["wals", "floor"]}, "alpha: rows are wals, floor; the room has floor, walls"),
        ({"index": ["floor", "floor"]}, "alpha: rows are floor, floor"),
        ({"columns": [250, 500]}, "alpha: columns are 250.0, 500.0; the room has 500.0, 1000.0"),
        ({"columns": ["low", "high"]}, "alpha: columns are low, high"),
    ],
)
def test_labels_of_another_room_are_refused(labels: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        room(alpha=table(**labels))
