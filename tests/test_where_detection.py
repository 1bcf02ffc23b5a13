"""Whether something is other than stated: positions and means over them in one score."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.where.detection import MEANS, POSITIONS, Detection, evidence_of_means, of_means
from tests.test_where import MATCH, measured, stated, tracing

pytest.importorskip("numba", reason="the paths are traced by compiled code (extra fast)")


@pytest.fixture(scope="module")
def case() -> rt.where.Case:
    return rt.where.Case(simulator=tracing(stated()), measured=measured(True))


def test_the_means_decide_where_they_are_asked() -> None:
    alone = Detection(positions=20.0)
    assert (alone.score, alone.threshold, alone.verdict) == (20.0, POSITIONS, None)
    assert Detection(positions=20.0, means=-1.0).verdict == "hint"
    assert Detection(positions=-1.0, means=-1.0).verdict == "none"
    assert Detection(positions=-1.0, means=3.0).verdict is None
    assert Detection(positions=-1.0, means=3.0, threshold_of_means=4.0).verdict == "hint"
    assert Detection(positions=9.0, means=2.0, threshold_of_means=1.6).threshold == MEANS


def test_the_means_have_the_pairs_and_the_geometry_of_the_case(case: rt.where.Case) -> None:
    less = replace(case, exclude=[("S1", "R2")], match=("t20", "c80", "ts"))
    (configuration,) = of_means(less).configurations
    assert set(configuration.measured.values) == {"t20", "c80"}
    assert tuple(configuration.measured.pairs) == less.pairs
    kept = [case.measured.pairs.index(pair) for pair in less.pairs]
    np.testing.assert_array_equal(
        configuration.measured.uncertainty["t20"], case.measured.uncertainty["t20"][kept]
    )
    away = np.subtract(case.simulator.sources["S2"], case.simulator.receivers["R3"])
    assert configuration.distances is not None
    assert configuration.distances[less.pairs.index(("S2", "R3"))] == pytest.approx(
        np.linalg.norm(away)
    )
    along = dict(zip(case.room.materials, of_means(case).facing, strict=True))
    np.testing.assert_allclose(along["east wall"], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along["floor wall"], [0, 0, 1], atol=1e-12)


def test_the_means_say_nothing_without_a_decay_time(case: rt.where.Case) -> None:
    assert evidence_of_means(replace(case, match=("c80", "ts", "level"))) is None


@pytest.mark.parametrize("options", [{"without": ["air"]}, {"only": ["opening", "porous"]}])
def test_fewer_effects_are_asked_of_the_positions_alone(
    case: rt.where.Case, options: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The means know neither those effects nor their names."""
    module = sys.modules["rtcal.where.find"]
    monkeypatch.setattr(module, "evidence_of_means", lambda *_: pytest.fail("asked"))
    monkeypatch.setattr(module, "find_by_positions", lambda *arguments: arguments[-1])
    assert rt.where.find(case, **options) is None


def test_a_finding_tells_what_means_and_positions_say(case: rt.where.Case) -> None:
    finding = rt.where.find(replace(case, match=MATCH))
    assert finding.detection.means is not None
    assert finding.detected == (finding.score > finding.threshold)
    assert finding.to_dict()["nats_of_means"] == finding.detection.means
