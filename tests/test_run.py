"""A run of the user's own program beside the measurement: what is compared, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.support.errors import DataError

F = [500.0, 1000.0]
PAIRS = [("S1", "R1"), ("S1", "R2")]


def box(**changes: object) -> rt.Room:
    stated = {
        "name": "box",
        "volume": 120,
        "materials": ["wall", "floor"],
        "areas": [120, 38],
        "alpha": [[0.1, 0.1], [0.2, 0.3]],
        "sigma": [[0.02, 0.02], [0.05, 0.05]],
        "centre_frequencies": F,
        "air": rt.Air(20.0, 50.0),
    }
    return rt.Room(**(stated | changes))


def of_pairs(pairs: list[tuple[str, str]] = PAIRS, **values: object) -> rt.Measurement:
    return rt.Measurement(centre_frequencies=F, values=values, pairs=pairs)


def test_the_same_parameters_pairs_and_values_are_compared() -> None:
    run = rt.Run(box(), of_pairs(t20=[[1.0, 1.1], [1.2, 1.3]], c80=[[1, 2], [3, 4]]))
    measured = of_pairs(
        [*PAIRS[::-1], ("S1", "R3")], t20=[[2, 2.2], [1, np.nan], [9, 9]], t30=[[1, 1]] * 3
    )
    for one in run.beside(measured):
        assert one.pairs == (("S1", "R2"), ("S1", "R1"))
        assert [*one.values] == ["t20"]
        assert np.isnan(one.values["t20"]).tolist() == [[False, False], [False, True]]
    assert run.beside(measured)[0].mean("t20").tolist() == [1.1, 1.3]
    assert run.lacking(measured) == {"t30": "run", "c80": "measurement"}


def test_means_are_compared_where_no_pair_is_common() -> None:
    run = rt.Run(box(), rt.Measurement.from_values(F, t20=[1.0, 1.1]))
    ours, theirs = run.beside(of_pairs(t20=[[1, 1], [3, 3]]))
    assert ours.mean("t20").tolist() == [1.0, 1.1]
    assert theirs.mean("t20").tolist() == [2, 2]


def test_bands_are_converted_and_t20_is_not_t30() -> None:
    thirds = rt.Measurement.from_values([400, 500, 630], t20=[1.0, 1.0, 1.0])
    run = rt.Run(box(), thirds)
    assert run.simulated.centre_frequencies.tolist() == F
    for other in (
        rt.Measurement.from_values(F, t30=[1, 1]),
        rt.Measurement.from_values(F[1:], t20=[1]),
    ):
        with pytest.raises(DataError, match="nothing in common"):
            run.beside(other)
    with pytest.raises(DataError, match=r"simulated: .* no band in common"):
        rt.Run(box(), rt.Measurement.from_values([8000], t20=[1]))


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"materials": ["wall", "carpet"]}, "carpet"),
        ({"areas": [120, 39]}, r'area\["floor"\]'),
        ({"volume": 121}, "volume"),
        ({"centre_frequencies": [1000, 2000]}, "2000 Hz"),
        ({"air": None}, "no air"),
    ],
)
def test_a_run_of_another_room_is_refused(changed: dict[str, object], named: str) -> None:
    run = rt.Run(box(alpha=[[0.5, 0.5], [0.5, 0.5]]), rt.Measurement.from_values(F, t20=[1.0, 1.1]))
    run.refuse_other(box())
    with pytest.raises(DataError, match=named):
        run.refuse_other(box(**changed))
