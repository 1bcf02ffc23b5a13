"""Whether something is other than stated: the positions decide."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.claim import Detection
from rtcal.finder.effects import library
from rtcal.finder.positions.problem import PositionsHypotheses, shifts
from rtcal.finder.positions.search import (
    LEAST_BY_MEANS,
    MEANS_POWER,
    THRESHOLD,
    TOLD_TEMPER,
    of_means,
    weights,
    with_families,
)
from tests.test_where import measured, stated, tracing


@pytest.fixture(scope="module")
def case():
    return rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(True))


def test_the_positions_decide():
    above, below = THRESHOLD + 0.1, THRESHOLD - 0.1
    assert Detection(above, THRESHOLD).verdict is None
    assert Detection(above, THRESHOLD, means=-1.0).verdict is None
    assert Detection(below, THRESHOLD, means=9.0).verdict == "hint"
    assert Detection(-0.1, THRESHOLD).verdict == "none"


@pytest.mark.parametrize("ceiling", [0.2, 0.9])
def test_what_is_called_added_absorption_adds_some(ceiling):
    """A panel all over a ceiling of mineral wool lengthens T: it is no added absorption."""
    room = stated()
    alpha = np.array(room.alpha)
    alpha[-1] = ceiling
    simulator = tracing(room.replace(alpha=alpha))
    case = rt.finder.PositionsCase(simulator=simulator, measured=measured(True))
    tried = [s for s in shifts(case, library()) if s.family.startswith("added absorption")]
    for hypothesis in tried:
        changes = hypothesis.spectra - case.surface_alpha[hypothesis.surface]
        assert (changes.max(axis=1) > -changes.min(axis=1)).all()
    assert {s.surface for s in tried} == set(range(6))


def test_the_means_have_the_pairs_and_the_geometry_of_the_case(case):
    less = replace(case, exclude=[("S1", "R2")], match=("t20", "c80", "ts"))
    (configuration,) = of_means(less).configurations
    assert set(configuration.measured.values) == {"t20", "c80"}
    assert tuple(configuration.measured.pairs) == less.pairs
    kept = [case.measured.pairs.index(pair) for pair in less.pairs]
    np.testing.assert_array_equal(
        configuration.measured.uncertainty["t20"], case.measured.uncertainty["t20"][kept]
    )
    away = np.subtract(case.simulator.sources["S2"], case.simulator.receivers["R3"])
    assert configuration.distances[less.pairs.index(("S2", "R3"))] == pytest.approx(
        np.linalg.norm(away)
    )
    along = dict(zip(case.room.materials, of_means(case).facing, strict=True))
    np.testing.assert_allclose(along["east wall"], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along["floor wall"], [0, 0, 1], atol=1e-12)


def test_the_families_of_the_means_are_multiplied_in(case):
    some = [
        s.some(slice(0, 1))
        for s in shifts(case, library())
        if s.effect in ("opening", "covered surface")
    ]
    pair = [some[0], next(s for s in some if s.family != some[0].family)]
    every = PositionsHypotheses(pair, [], off=0.1)
    before = weights(np.zeros(len(every.log_prior)), every, TOLD_TEMPER)
    after = with_families(before, every, {"none": 1e-9, pair[0].family: 0.64})
    changed = np.exp(after - before)
    for of_shifts in every.of_groups(changed)[1:]:
        assert np.concatenate(of_shifts) == pytest.approx(
            [0.64**MEANS_POWER, LEAST_BY_MEANS**MEANS_POWER]
        )
    assert changed[0] == pytest.approx(LEAST_BY_MEANS**MEANS_POWER)
